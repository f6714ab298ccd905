// relief_compact.h - a relief page's samples without loss in about two thirds of their bytes. Blocks of 8 x 8 samples
// (the last of a row or column has 9) lie near planes: a block is stored as a plane and the residuals of its samples
// above it, each in as many bits as the block's largest residual needs.
//
//   headers    48 bits a block, blocks in rows; three texels hold the headers of two blocks. 32 bits are the plane: the
//              height at the block's first sample, modulo 2^16, and the slopes along x and y, -128..127, in kSlopeStep
//              steps of height a sample. 16 bits are the residuals' width (0..14, or 15 for 16) and where they begin,
//              in pairs of texels from the part's first. These 16 bits lie as a plain page's sample does, high byte
//              first.
//   residuals  sample i of the block, in rows, at bit i * width, lowest bit first; each block begins a new texel
//
// A texel is 32 bits, its red byte lowest. Of two headers the first has its plane in the first texel and its other half
// in the second's lower bits, the second in the third and in the upper bits. Texels follow one another row by row of
// the part (relief_subslots.h). All sums are of integers modulo 2^16: what shaders/compact_relief.glsl computes are the
// samples, whatever plane was chosen. It costs a vertex four fetches where a plain page's costs one. Pure.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace relievo {

inline constexpr int kCompactBlock = 8;
inline constexpr int kSlopeStep = 8;

// The texels that every (128 / cells)-th sample a side of a page takes; none: some block's would begin beyond 2^13.
// texels: kSlotBytes, as page_codec.h decodes relief. cells: 128, 64 or 32.
std::optional<uint32_t> compactTexels(std::span<const uint8_t> texels, int cells);
// out: at least four bytes for each of compactTexels(); what is beyond them is left as it is.
void packCompact(std::span<const uint8_t> texels, int cells, std::span<uint8_t> out);
// Sample (x, y), 0..cells: the CPU reference of reliefSampleOf() in shaders/compact_relief.glsl. packed: as
// packCompact() wrote it.
int compactSample(std::span<const uint8_t> packed, int cells, int x, int y);

}  // namespace relievo
