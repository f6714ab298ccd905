// bake_trace.h - heights of the scan along the lines through the samples of a grid.
// Units: mm along the lines. The result is the same for any number of workers.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/bake_probe.h"
#include "src/base/result.h"

namespace relievo {

// Heights where the samples' lines meet the scan, in the order of SampleLayout.
struct TracedHeights {
  int cells_log2 = 0;
  std::vector<float> heights;
  // 0: the line meets nothing. Otherwise 1 + 254 times the cosine between line and surface normal, the weight in the
  // least-squares fit: the squared error in space is the height's times cosine^2, and the surface area over a cell
  // grows with 1 / cosine.
  std::vector<uint8_t> weights;
};

// Traces a grid of 2^cells_log2 cells for each patch. If `probes` is empty, it is filled, too: tracing both at once
// keeps neighbouring lines together. coarser: heights that traceSamples() found on a coarser grid of the same context,
// or none; where lines are rasterised, those that both grids have are not traced again if they met the scan. progress:
// 0 to 1. Error: kInterrupted.
Result<TracedHeights> traceSamples(const BakeContext& context, int cells_log2, std::vector<Probe>& probes,
                                   const std::function<void(double)>& progress, const TracedHeights& coarser = {});

}  // namespace relievo
