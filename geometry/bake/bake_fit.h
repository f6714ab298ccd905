// bake_fit.h - heights chosen by least squares, so that the baked surface lies close to the scan between samples, too;
// heights taken from the scan at the samples alone do not.
// Shape: heights are ordered as SampleLayout says, with 2^cells_log2 cells a side. Units: mm. The result is the same
// for any number of workers.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/bake_trace.h"

namespace relievo {

struct HeightFitOptions {
  int min_cells_log2 = 0,
      cells_log2 = 0;  // each patch gets the fewest cells a side in this range that keep the tolerance
  double tolerance_mm = 0;
};
struct FittedHeights {
  std::vector<float> heights;
  uint64_t samples = 0;  // inner samples of sides and patches, each counted at its own number of cells
};
// Fits heights to `fine`, which has at least as many cells as the result. Nothing is returned if the bake was
// interrupted.
std::optional<FittedHeights> fitHeights(const BakeContext& context, const TracedHeights& fine,
                                        const HeightFitOptions& options);

}  // namespace relievo
