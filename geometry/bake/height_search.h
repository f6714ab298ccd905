// height_search.h - chooses the number of cells of a bake, and the heights of their samples.
#pragma once

#include "geometry/bake/bake_context.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/mesh_bake.h"
#include "src/base/result.h"

namespace relievo {

inline constexpr int kMaxCellsLog2 = 14;

// options: checked by MeshBake::create(); progress runs from 0.3 to 0.9. Fills the report's cells, samples, tolerance,
// deviation and limit. Errors: kUsage if more than 2^32 samples were needed; kInterrupted.
Result<BakedHeights> searchHeights(const BakeContext& context, const BakeOptions& options, BakeReport& report);

}  // namespace relievo
