// mesh_order.h - triangles near one another in space near one another in the list, too: what works through runs of them
// (ray_scene.h, base_runs.h) finds each in one place.
#pragma once

#include <atomic>

#include "geometry/tri_mesh.h"

namespace relievo {

// By cells of a 128th of the bounding box, along a curve (Morton's); within a cell as they were. Vertices keep their
// order. 16 bytes a triangle beside the mesh. The same for any number of workers. False: interrupted, and nothing was
// changed.
bool orderTriangles(TriMesh& mesh, int workers = 0, const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
