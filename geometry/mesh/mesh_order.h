// mesh_order.h - triangles near one another in space near one another in the list, too: what works through runs of them
// (ray_scene.h, chunk_reduce.h) finds each in one place.
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// From so many on a mesh is worked through in parts.
inline constexpr size_t kManyTriangles = 400'000;
// Is a mesh large enough for runs to matter, and are its own no good: do runs of 65,536 triangles share more than an
// eighth of their vertices, or is it so large that not all of it is looked up at a time?
bool needsOrder(const TriMesh& mesh);

// Of the cell of a 128th of the box's longest side that a place is in: how far along Morton's curve it is.
uint32_t placeOnCurve(const glm::vec3& place, const glm::vec3& low, const glm::vec3& high);

// By cells of a 128th of the bounding box, along a curve (Morton's); within a cell as they were. Vertices keep their
// order. 16 bytes a triangle beside the mesh. The same for any number of workers. False: interrupted, and nothing was
// changed.
bool orderTriangles(TriMesh& mesh, int workers = 0, const std::atomic<bool>* interrupted = nullptr);

// The triangles in that order.
std::vector<uint32_t> orderAlongCurve(const TriMesh& mesh, int workers);

}  // namespace relievo
