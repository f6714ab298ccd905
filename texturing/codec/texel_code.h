// texel_code.h - a texture page within a tolerance, level by level: each texel is predicted from those of coarser
// grids, and what it differs by is rounded to steps and range coded (texturing/PACKAGE.md, "Hierarchical texels").
// Small where texels are smooth, and at creases, on both sides of which they are: a fifth of a scan's normals without
// loss. All in integers: the same texels on every machine. Safe for untrusted bytes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "texturing/codec/coarse_page.h"

namespace relievo {

// What an encoder or decoder keeps from one page to the next, to spare memory: its content does not matter.
struct TexelCodeScratch {
  static constexpr size_t kRow = kPageFullPx, kChannel = kRow * kRow;
  std::array<uint8_t, 3 * kChannel> texels, sizes;  // texels: an encoder's, what a decoder will give
  std::array<int16_t, 3 * kChannel> planned;
};

// channels: three of kPageFullPx^2, rows top first. Appends to out what a decoder shows within the tolerances, and at
// the page's edge within kEdgeShare of them; exactly, if nothing less is.
void encodeTexelCode(std::span<const uint8_t> channels, std::span<const ChannelTolerance> tolerances /* 3 */,
                     TexelCodeScratch& scratch, std::vector<uint8_t>& out);
// False: the bytes are not such a page. channels are then of any content.
bool decodeTexelCode(std::span<const uint8_t> bytes, TexelCodeScratch& scratch, std::span<uint8_t> channels);

}  // namespace relievo
