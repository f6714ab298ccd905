// vertex_normals.h - the mean normals of a scan's vertices.
// Shape: normals[v] belongs to mesh.positions_mm[v]; of length 1, or 0 if no triangle with an area has the vertex. The
// result is the same for any number of workers. Source: Thuermer and Wuethrich 1998, "Computing vertex normals from
// polygonal facets".
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"
#include "src/base/angle_of.h"

namespace relievo {

// A triangle's contributions to the normals of its corners, its normal times its angle there: nothing if it has no
// area.
std::array<glm::vec3, 3> cornerShares(const TriMesh& mesh, const std::array<uint32_t, 3>& triangle);

// False: the call was interrupted, and the normals are incomplete. workers: 0 is one for each core.
bool makeVertexNormals(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted,
                       std::vector<glm::vec3>& normals);

}  // namespace relievo
