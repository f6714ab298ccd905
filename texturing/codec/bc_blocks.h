// bc_blocks.h - block compression as GPUs sample it: 4 x 4 texels in 8 or 16 bytes. BC1 (S3TC), BC4 (RGTC; BC5 is two
// of it) and BC7 (BPTC), defined in the Khronos Data Format Specification 1.3, chapters 18 to 20. Decoding accepts any
// bytes. BC7 is exact by its definition; BC1 and BC4 are defined in real numbers, rounded here to the nearest byte, and
// GPUs may differ by a little. Encoding is deterministic and looks at the block alone, so the same 4 x 4 texels give
// the same bits wherever they stand.
#pragma once

#include <cstddef>
#include <cstdint>

namespace relievo {

// A block's texels in an image: texel (x, y) at first + y * row_bytes + x * texel_bytes.
// BC1, BC7: texels are RGBA8, 4 bytes each; BC4: one byte each.
void decodeBc1(const uint8_t* block /* 8 */, uint8_t* first, size_t row_bytes);
void decodeBc4(const uint8_t* block /* 8 */, uint8_t* first, size_t texel_bytes, size_t row_bytes);
void decodeBc7(const uint8_t* block /* 16 */, uint8_t* first, size_t row_bytes);

// Opaque: alpha is ignored. texels: 16 RGBA8, rows top first.
void encodeBc1(const uint8_t* texels, uint8_t* block /* 8 */) noexcept;
void encodeBc4(const uint8_t* values /* 16 */, uint8_t* block /* 8 */) noexcept;
// Modes 6 (one line through all texels), 1 and 3 (two lines, 64 ways to divide the block), 4 and 5 (one channel by
// itself).
void encodeBc7(const uint8_t* texels, uint8_t* block /* 16 */) noexcept;

}  // namespace relievo
