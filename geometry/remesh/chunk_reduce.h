// chunk_reduce.h - reduces a scan of millions of triangles to some hundred thousand by chunks of consecutive triangles:
// each is reduced alone (base_reduce.h), then all are joined. This takes a fraction of the memory of the whole scan's
// connectivity, uses all cores, and stays within caches if neighbouring triangles are near in the list (mesh_order.h).
#pragma once

#include <atomic>
#include <functional>
#include <optional>

#include "geometry/mesh/tri_mesh.h"
#include "geometry/remesh/base_topology.h"

namespace relievo {

struct ChunkOptions {
  size_t chunk_triangles = 0;  // 0: chosen by the scan's size
  size_t triangles = 0;        // approximate number left inside of chunks; triangles between chunks stay
  glm::dvec3 centre{0};        // the result is (positions - centre) / diagonal
  double diagonal = 1;
  int workers = 0;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// Borders stay in full detail. The result is the same for any number of workers. Nothing: interrupted, or the mesh is
// invalid (makeSurface() of the whole mesh says why).
std::optional<Surface> reduceByChunks(const TriMesh& mesh, const ChunkOptions& options);

}  // namespace relievo
