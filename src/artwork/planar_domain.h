// planar_domain.h - how a flat artwork of W x H texels lies on a strip of square patches.
//
// A patch is a square of kPagePx << texture_depth texels, the smallest one that covers the artwork's shorter side; the
// artwork is a strip of them along its longer side, starting at its top left corner. Texels are never resampled: the
// part of a patch beyond the artwork's right and bottom border has no pages, and geometry is clamped to the border.
//
// Coordinates: x to the right, y down, origin at the artwork's top left corner.
//   texels       continuous; texel (i, j) covers [i, i+1) x [j, j+1), its centre is (i + 0.5, j + 0.5)
//   level l      mip level of the texture: one texel of level l is 2^(texture_depth - l) texels wide
//   relief grid  vertex-centred: a node of level l has (kPagePx + 1)^2 samples over its square, both ends included
#pragma once

#include <algorithm>
#include <cstdint>

#include "src/artwork/node_id.h"

namespace relievo {

inline constexpr int kPagePx = 128;      // payload texels (and relief cells) a page side
inline constexpr int kPageBorderPx = 4;  // on every side: bilinear needs 1, anisotropy 4 needs 4
inline constexpr int kPageFullPx = kPagePx + 2 * kPageBorderPx;  // 136
inline constexpr int kReliefSamples = kPagePx + 1;               // 129 a side

struct PlanarDomain {
  uint64_t width_px = 1;
  uint64_t height_px = 1;
  double mm_per_px = 1.0;
  int texture_depth = 0;  // finest texture level; patches are kPagePx << texture_depth texels a side
  int relief_depth = -1;  // finest relief level (may exceed texture_depth); -1: no relief
  // Relief height in mm = relief_offset_mm + q * relief_scale_mm, q the 16-bit sample: one range for the artwork.
  double relief_offset_mm = 0.0;
  double relief_scale_mm = 0.0;

  uint64_t patchPx() const { return uint64_t{kPagePx} << texture_depth; }
  uint32_t patchColumns() const { return static_cast<uint32_t>((width_px + patchPx() - 1) / patchPx()); }
  uint32_t patchRows() const { return static_cast<uint32_t>((height_px + patchPx() - 1) / patchPx()); }
  uint32_t patchCount() const { return patchColumns() * patchRows(); }
  // One of patchColumns, patchRows is 1, so a patch's index is its place along the strip.
  bool alongX() const { return patchColumns() >= patchRows(); }
  uint64_t patchOriginX(uint32_t patch) const { return alongX() ? patch * patchPx() : 0; }
  uint64_t patchOriginY(uint32_t patch) const { return alongX() ? 0 : patch * patchPx(); }
  uint64_t levelWidth(int level) const { return ceilShift(width_px, texture_depth - level); }
  uint64_t levelHeight(int level) const { return ceilShift(height_px, texture_depth - level); }

  // Does the node's (open) square meet the artwork? Only such nodes have pages and are drawn.
  bool nodeExists(const NodeId& n) const {
    if (n.patch >= patchCount() || n.level > kMaxNodeLevel) return false;
    if ((n.x >> n.level) != 0 || (n.y >> n.level) != 0) return false;
    // Compared in units of 2^-level patches, so that nodes deeper than a texel work too.
    auto inside = [&](uint64_t origin, uint32_t i, uint64_t extent) {
      return ((extent - origin) << n.level) > uint64_t{i} * patchPx();
    };
    return patchOriginX(n.patch) < width_px && patchOriginY(n.patch) < height_px &&
           inside(patchOriginX(n.patch), n.x, width_px) && inside(patchOriginY(n.patch), n.y, height_px);
  }

  static uint64_t ceilShift(uint64_t v, int shift) { return (v + (uint64_t{1} << shift) - 1) >> shift; }
  // The depth for which one patch covers the shorter side.
  static int depthFor(uint64_t width_px, uint64_t height_px) {
    uint64_t shorter = std::min(width_px, height_px);
    int depth = 0;
    while ((uint64_t{kPagePx} << depth) < shorter) ++depth;
    return depth;
  }
};

}  // namespace relievo
