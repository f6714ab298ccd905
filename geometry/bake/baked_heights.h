// baked_heights.h - the heights of a bake in 16 bits, in the order of SampleLayout: height = offset_mm + scale_mm *
// sample.
// Units: mm along the base's interpolated normals. Pure; const functions may be called from any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/between_samples.h"
#include "geometry/bake/grid_error.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

struct BakedHeights {
  int cells_log2 = 0;
  double offset_mm = 0, scale_mm = 0;
  std::vector<uint16_t> samples;
  int step = 1;  // more: they are steppedHeights(), whose rule says what lies between them

  BakedHeights() = default;
  // heights: not empty.
  BakedHeights(std::span<const float> heights, int cells_log2);
  bool allAlike() const;
  int reliefDepth() const { return std::max(cells_log2 - kPageCellsLog2, 0); }
  // The samples of one patch, (2^cells_log2 + 1)^2.
  void gather(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const;
  // Those at the vertices of a grid of 2^log2 cells a side, at most finestLog2(): of the samples, or between them
  // interpolated linearly on the cells' triangles. Where two grids have a vertex, both have the same there.
  void grid(const BakeContext& context, uint32_t patch, int log2, std::span<uint16_t> out) const;
  int finestLog2() const { return kPageCellsLog2 + reliefDepth(); }  // of the cells that are drawn
  void finest(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const {
    grid(context, patch, finestLog2(), out);
  }
  // The positions of the vertices of a grid of out.cells_log2, in the scan's coordinates.
  void surface(const BakeContext& context, uint32_t patch, SurfaceGrid& out) const;
  BetweenSamples betweenSamples(const BakeContext& context, uint32_t patch) const;
};

}  // namespace relievo
