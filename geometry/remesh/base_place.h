// base_place.h - what of a scan belongs to which corner of its base mesh, and what follows from it: where the corner
// best lies (on creases, if there are any), and its normal.
#pragma once

#include <vector>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

// Of each of the surface's vertices the corner that is nearest along the surface; not valid: none.
using Regions = std::vector<VertexHandle>;
Regions cornerRegions(const QuadMesh& quads, const TriangleMesh& surface, const ScanLookup& scan);
// Corners move to where the planes of their regions meet best, and remember the creases that they are on.
void placeCorners(QuadMesh& quads, const TriangleMesh& surface, const Regions& regions, const ScanLookup& scan);
// Corners take the mean normals of their regions, by area: some half a patch wide, so that lines along the interpolated
// normals do not cross. Turned towards what would face away from them.
void placeNormals(QuadMesh& quads, const TriangleMesh& surface, const Regions& regions, const ScanLookup& scan);

}  // namespace relievo
