// base_faces.h - a base mesh whose patches are the scan's own triangles: pairs of them, and single ones with the middle
// of a side as their fourth corner. It passes through the scan, so that heights only make up for pairs that are not
// flat. For scans with sharp edges and thin parts, and coarse ones, whose triangles are about as large as patches.
// Units: those of the surface. Pure; the same input gives the same result.
#pragma once

#include <cstdint>

#include "geometry/remesh/base_topology.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// How much two triangles may fold that make one patch. The less, the less heights must make up for, and the more
// patches there are: without any fold the patches are the scan.
enum class Folds : uint8_t {
  kAny,     // by 20 degrees, and by more only where there would be too many patches
  kSlight,  // by 5
  kNone     // but for rounding
};
// Has at most max_patches patches, or none if that is too few.
BaseMesh facesBase(const Surface& surface, uint32_t max_patches, Folds folds = Folds::kAny);

}  // namespace relievo
