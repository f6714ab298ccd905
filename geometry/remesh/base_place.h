// base_place.h - what of a scan belongs to which corner of its base mesh, and what follows from it: where the corner
// best lies (on creases, if there are any), and its normal.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/base_topology.h"

namespace relievo {

// The triangles around each vertex: fan[begin[v]] .. fan[begin[v + 1]].
struct Fans {
  std::vector<uint32_t> begin, fan;
  explicit Fans(const Surface& s);
};
// Of each of the surface's vertices the corner that is nearest along the surface; kNoIndex: none.
std::vector<uint32_t> cornerRegions(const QuadMesh& quads, const Surface& s, const Fans& fans, const ScanLookup& scan);
// Corners move to where the planes of their regions meet best, and remember the creases that they are on.
void placeCorners(QuadMesh& quads, const Surface& s, const std::vector<uint32_t>& regions, const ScanLookup& scan);
// The mean normals of the regions, by area: some half a patch wide, so that lines along the interpolated normals do not
// cross. Turned towards what would face away from them.
std::vector<glm::dvec3> cornerNormals(const QuadMesh& quads, const Surface& s, const std::vector<uint32_t>& regions,
                                      const ScanLookup& scan);

}  // namespace relievo
