// crease_gutter.h - where two patches meet along a crease, each has its own side's normals (geometry/bake/
// corner_normals.h), and where their materials differ, its own colours. Filters that blended them would tint a texel's
// width of both sides, which is wide on long patches. So the gutter there repeats the patch's own texels. Pure: any
// thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "src/artwork/basis.h"

namespace relievo {

// The first of three channels that are a normal's components, b / 127.5 - 1 by byte b; of the basis kAlbedoNormal.
inline constexpr size_t kNormalChannel = 3;
inline bool hasNormals(const TextureFormat& format) { return format.basis == Basis::kAlbedoNormal; }

// Do normals differ by more than 40 degrees? Those of coarse levels are means, shorter than 1. In integers, so that
// builders and readers decide alike.
inline bool isCrease(const std::array<uint8_t, 3>& a, const std::array<uint8_t, 3>& b) {
  int64_t along = 0, a_squared = 0, b_squared = 0;
  for (size_t c = 0; c < 3; ++c) {
    const int64_t x = 2 * a[c] - 255, y = 2 * b[c] - 255;
    along += x * y;
    a_squared += x * x;
    b_squared += y * y;
  }
  constexpr int64_t kSquaredCosine = 587, kParts = 1000;
  return along < 0 || kParts * along * along < kSquaredCosine * a_squared * b_squared;
}

// Do colours differ by more than 32 of 255 in a channel, as those of different materials do? Texels that touch in one
// image, a 16th of a patch or more apart, do so along its edges, too: there colours end half a texel earlier.
inline bool isColourEdge(const std::array<uint8_t, 3>& a, const std::array<uint8_t, 3>& b) {
  constexpr int kMost = 32;
  bool edge = false;
  for (size_t c = 0; c < 3; ++c) edge = edge || a[c] > b[c] + kMost || b[c] > a[c] + kMost;
  return edge;
}

// Which channels of a gutter end where the texels across differ.
struct GutterEnds {
  bool colours = false;  // channels 0..2: at colour edges
  bool normals = false;  // from kNormalChannel on: at creases
  // Three channels end alike, from this one on.
  static constexpr size_t firstOf(size_t channel) { return channel / 3 * 3; }
  // Whether between() may say so at all.
  bool anyOf(size_t first) const { return first == 0 ? colours : first == kNormalChannel && normals; }
  bool between(size_t first, const std::array<uint8_t, 3>& own, const std::array<uint8_t, 3>& theirs) const {
    if (first == 0) return colours && isColourEdge(own, theirs);
    return first == kNormalChannel && normals && isCrease(own, theirs);
  }
};

}  // namespace relievo
