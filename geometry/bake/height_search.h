// height_search.h - how many cells a patch a bake takes, and the heights of their samples.
#pragma once

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/mesh_bake.h"
#include "src/base/result.h"

namespace relievo {

inline constexpr int kMaxCellsLog2 = 14;

// Options as MeshBake::create() checks them; progress from 0.3 to 0.9. Notes cells, samples, tolerance, deviation and
// limit in the report. Errors: kUsage where more than 2^32 samples are asked for; kInterrupted.
Result<BakedHeights> searchHeights(const BakeGround& ground, const BakeOptions& options, BakeReport& report);

}  // namespace relievo
