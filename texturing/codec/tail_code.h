// tail_code.h - tails of patches (texturing/package/patch_tails.h) in few bytes, without loss, some hundred patches at
// a time (texturing/PACKAGE.md, "Coded tails", "Tails by grids"). Heights are coded as relief pages have them; texels
// are predicted from their neighbours, coarser levels from the finest, and what they differ by is range coded; models
// learn from patch to patch. Safe for untrusted bytes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace relievo {

inline constexpr int kTailCodeCellsLog2 = 4;  // of the heights' grid
inline constexpr int kTailCodeTexels = 16;    // a side of the finest level

// The corners of patches, as their base mesh has them: of tails by grids (version 10), which code once what patches
// share. None: of coded tails before it (version 6).
using PatchCorners = std::span<const std::array<uint32_t, 4>>;

// heights: 17 x 17 a patch. texels: 340 a channel a patch, patch by patch, in it level by level (16, 8, 4 and 2 texels
// a side), in it channel by channel; channels: a multiple of 3. Appends to out.
void encodeTailCode(std::span<const uint16_t> heights, std::span<const uint8_t> texels, int channels,
                    PatchCorners corners, std::vector<uint8_t>& out);
// False: the bytes are no such tails of so many patches. heights and texels are then of any content.
bool decodeTailCode(std::span<const uint8_t> bytes, int channels, PatchCorners corners, std::span<uint16_t> heights,
                    std::span<uint8_t> texels);
// The heights alone.
bool decodeTailHeights(std::span<const uint8_t> bytes, PatchCorners corners, std::span<uint16_t> heights);

struct TailTolerance {
  bool grids = false;  // for tails by grids: no texel at a patch's border then changes by more than half of most
  int most = 1;        // steps, up to 127
  double rms = 1;      // steps
};
// An encoder's choice among texels that serve as well: those of one plane become others that take far fewer bytes, none
// farther off than `most` steps, and of a patch's finest level no channel farther than `rms` in the root mean square.
void roundTailTexels(std::span<uint8_t> texels, int channels, int plane, TailTolerance within);
// How many of sound tails' bytes the heights take, by the first kTailCodeHeadBytes of them.
inline constexpr size_t kTailCodeHeadBytes = 4;
uint64_t tailCodeHeightBytes(std::span<const uint8_t> bytes);

}  // namespace relievo
