// baked_heights.h - the heights of a bake in 16 bits, in the order of SampleLayout: height = offset_mm + scale_mm *
// sample.
// Units: mm along the base's interpolated normals. Pure; const functions may be called from any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/grid_error.h"

namespace relievo {

struct BakedHeights {
  int cells_log2 = 0;
  double offset_mm = 0, scale_mm = 0;
  std::vector<uint16_t> samples;
  bool stepped = false;  // they are steppedHeights(): between them lies what its rule says

  BakedHeights() = default;
  // heights: not empty.
  BakedHeights(std::span<const float> heights, int cells_log2);
  int reliefDepth() const { return std::max(cells_log2 - kPageCellsLog2, 0); }
  // The samples of one patch, (2^cells_log2 + 1)^2.
  void gather(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const;
  // The same at the finest drawn grid, 2^(7 + reliefDepth()) cells a side. Coarser samples are interpolated linearly on
  // the cells' triangles.
  void finest(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const;
  // The positions of that grid's vertices, in the scan's coordinates.
  void surface(const BakeContext& context, uint32_t patch, SurfaceGrid& out) const;
};

}  // namespace relievo
