// base_faces.h - a base mesh whose patches are the scan's own triangles: pairs of them, and single ones with the middle
// of a side as their fourth corner. It passes through the scan, so that heights only make up for pairs that are not
// flat. For coarse scans with sharp edges, whose triangles are about as large as patches.
// Units: those of the surface. Pure; the same input gives the same result.
#pragma once

#include <cstdint>

#include "geometry/remesh/base_topology.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// Has at most max_patches patches, or none if that is too few. Pairs lie across edges that fold little, unless only
// more would be too many patches.
BaseMesh facesBase(const Surface& surface, uint32_t max_patches);

}  // namespace relievo
