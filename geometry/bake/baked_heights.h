// baked_heights.h - a bake's heights, quantised, as SampleLayout has them: height = offset_mm + scale_mm * sample.
// Units: mm along the base's interpolated normals. Pure; const: any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/grid_error.h"

namespace relievo {

inline constexpr int kPageCellsLog2 = 7;  // of a relief page: kPagePx cells
static_assert(1 << kPageCellsLog2 == kPagePx);

struct BakedHeights {
  int cells_log2 = 0;
  double offset_mm = 0, scale_mm = 0;
  std::vector<uint16_t> samples;
  bool stepped = false;  // they are steppedHeights(): between them lies what its rule says

  BakedHeights() = default;
  // heights: at least one.
  BakedHeights(std::span<const float> heights, int cells_log2);
  int reliefDepth() const { return std::max(cells_log2 - kPageCellsLog2, 0); }
  // A patch's own grid of (2^cells_log2 + 1)^2.
  void gather(const BakeGround& ground, uint32_t patch, std::span<uint16_t> out) const;
  // A patch's grid of 2^(7 + reliefDepth()) cells a side: fewer samples are interpolated on the cells' triangles.
  void finest(const BakeGround& ground, uint32_t patch, std::span<uint16_t> out) const;
  // The vertices of that grid, in the mesh's coordinates.
  void surface(const BakeGround& ground, uint32_t patch, SurfaceGrid& out) const;
};

}  // namespace relievo
