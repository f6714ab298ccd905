// patch_vertex.h - the CPU reference of the vertex shader's geometry (shaders/patch.vert): instance and grid vertex in,
// absolute position and height out, all in integers, so that two nodes that share a vertex get the same bits whatever
// their levels and pages are.
//
// The shader has 32-bit integers only. With U = texture_depth + 11, the log2 of a patch's side in units, these must
// fit:
// - Positions x and y stay below 2^31 units, since the artwork's longer side, in whole patches, is below 2^27 texels.
// - Heights: samples are 2^sr units apart, sr = U - page level - 7. Fractions are cut to 15 bits, so that q * 2^15 fits
//   int32. Both sides of an edge lose the same: a vertex with a non-zero fraction is drawn only from pages of the
//   finest level (relief_depth), the same one on both sides.
// - The resulting height is in units of 2^-8 of a 16-bit sample step and below 2^24, hence exact in fp32. Therefore
//   height_mm = offset + scale * (h / 256) has the same bits everywhere (the artwork has one range).
// - Depth: sr >= 0, that is, relief_depth <= texture_depth + 4 (kUnitsPerTexelLog2), since samples are never finer than
//   a unit.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstdint>

#include "geometry/lod/morph.h"
#include "geometry/lod/planar_lod.h"
#include "geometry/lod/snap.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

inline constexpr int kHeightFractionBits = 8;

struct PatchVertex {
  int32_t x = 0, y = 0;    // units, clamped to the artwork's border
  uint32_t height_q8 = 0;  // 16-bit sample step / 256; 0 in a flat view
  friend bool operator==(const PatchVertex&, const PatchVertex&) = default;
};

// log2 of the units between the samples of a relief page of this level.
inline int reliefSpacingLog2(const FlatDomain& domain, uint32_t page_level) {
  return domain.texture_depth + kUnitsPerTexelLog2 - static_cast<int>(page_level);
}

// The height at a place inside a page of 129 x 129 samples (row by row, y down; a span, or anything else with an
// operator[]). local_* in units from the page's corner.
template <class Samples>
uint32_t sampleHeightQ8(const Samples& page, int32_t local_x, int32_t local_y, int spacing_log2) {
  int32_t mask = (1 << spacing_log2) - 1;
  int32_t sx = local_x >> spacing_log2, sy = local_y >> spacing_log2;
  int cut = std::max(0, spacing_log2 - 15);
  int bits = spacing_log2 - cut;
  int32_t fx = (local_x & mask) >> cut, fy = (local_y & mask) >> cut;
  // At the last sample the fraction is 0 and the neighbour's weight too.
  int32_t tx = std::min(sx + 1, kPagePx), ty = std::min(sy + 1, kPagePx);
  auto at = [&](int32_t x, int32_t y) {
    return static_cast<int32_t>(page[static_cast<size_t>(y) * kReliefSamples + x]);
  };
  int32_t q00 = at(sx, sy), q10 = at(tx, sy), q01 = at(sx, ty), q11 = at(tx, ty);
  int32_t value =
      (q00 << bits) + (fx >= fy ? fx * (q10 - q00) + fy * (q11 - q10) : fy * (q01 - q00) + fx * (q11 - q01));
  return static_cast<uint32_t>(bits > kHeightFractionBits ? value >> (bits - kHeightFractionBits)
                                                          : value << (kHeightFractionBits - bits));
}

// Everything clamped onto the border has the height of the first sample on or beyond it (samples there repeat the
// border's).
inline int32_t heightPlace(int32_t place, int64_t border, int spacing_log2, int32_t page_origin) {
  if (place < border) return place - page_origin;
  int32_t mask = (1 << spacing_log2) - 1;
  return (place - page_origin + mask) & ~mask;
}

// Vertex (i, j) of an instance. page(NodeId) gives the 129 x 129 samples of a resident relief page, say as a
// span<const uint16_t>; relief false: a flat view.
template <class PageOf>
PatchVertex patchVertex(const FlatDomain& domain, const PatchInstance& p, uint32_t i, uint32_t j, bool relief,
                        PageOf&& page) {
  std::array<uint32_t, 2> g = snapVertex(i, j, p);
  int32_t x = p.x0 + static_cast<int32_t>(g[0] << p.step_log2), y = p.y0 + static_cast<int32_t>(g[1] << p.step_log2);
  auto width = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
  auto height = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
  PatchVertex v;
  v.x = static_cast<int32_t>(std::min<int64_t>(x, width));
  v.y = static_cast<int32_t>(std::min<int64_t>(y, height));
  if (!relief) return v;
  int spacing_log2 = reliefSpacingLog2(domain, p.relief_page.level);
  assert(spacing_log2 >= 0);
  // The page's corner: the node's place without the low bits, a page is 2^(spacing + 7) units wide and patches are
  // aligned.
  int32_t corner_mask = ~((1 << (spacing_log2 + std::countr_zero(unsigned{kPagePx}))) - 1);
  int32_t page_x = p.x0 & corner_mask, page_y = p.y0 & corner_mask;
  v.height_q8 = sampleHeightQ8(page(p.relief_page), heightPlace(x, width, spacing_log2, page_x),
                               heightPlace(y, height, spacing_log2, page_y), spacing_log2);
  return v;
}

// The same with geomorph: x, y in units and the height in 16-bit sample steps / 256, exact in doubles. The shader mixes
// floats, from the same numbers and in the same order on both sides.
template <class PageOf>
glm::dvec3 morphedPatchVertex(const FlatDomain& domain, const PatchInstance& p, uint32_t i, uint32_t j, bool relief,
                              PageOf&& page) {
  PatchInstance still = p;
  still.edges.fill({p.grid_level, PatchInstance::kWholeEdge});
  auto at = [&](uint32_t x, uint32_t y) {
    const PatchVertex v = patchVertex(domain, still, x, y, relief, page);
    return glm::dvec3(v.x, v.y, v.height_q8);
  };
  return drawnVertex(p, i, j, at, [](const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& own, float weight) {
    if (b.x == own.x && b.y == own.y) return own;  // both on the border: the coarser surface ends there, too
    return 0.5 * (a + b) * (1.0 - double{weight}) + own * double{weight};
  });
}

}  // namespace relievo
