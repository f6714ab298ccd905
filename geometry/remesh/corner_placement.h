// corner_placement.h - assigns regions of a scan to the corners of its base mesh, and from them the corners' positions
// (on creases, if there are any) and normals. Units: diagonals of the scan.
#pragma once

#include <vector>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

// For each vertex of the surface the corner that is nearest along the surface; not valid: none.
using Regions = std::vector<VertexHandle>;
Regions cornerRegions(const QuadMesh& quads, const TriangleMesh& surface, const ScanSurface& scan);
// Moves corners to the point closest to the planes of their regions, and records the creases that they are on. Source:
void placeCorners(QuadMesh& quads, const TriangleMesh& surface, const Regions& regions, const ScanSurface& scan);
// Assigns the area-weighted mean normal of each corner's region, which is about half a patch wide, so that lines along
// the interpolated normals do not cross. Normals are turned towards parts that would face away from them.
void assignNormals(QuadMesh& quads, const TriangleMesh& surface, const Regions& regions, const ScanSurface& scan);

}  // namespace relievo
