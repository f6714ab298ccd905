// bake_fit.h - heights that lie closest to the scan between samples, too (least squares), in place of the scan's at the
// samples.
// Shape: as SampleLayout has them, with 2^cells_log2 cells a side. The same for any number of workers.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/bake_trace.h"

namespace relievo {

struct HeightFitOptions {
  int least_log2 = 0, cells_log2 = 0;  // a patch's cells: as few as keep the tolerance
  double tolerance_mm = 0;
};
struct FittedHeights {
  std::vector<float> heights;
  uint64_t samples = 0;  // inside sides and patches, with each one's own number of cells
};
// fine: at least as many cells. Nothing: interrupted.
std::optional<FittedHeights> fitHeights(const BakeGround& ground, const Traced& fine, const HeightFitOptions& how);

}  // namespace relievo
