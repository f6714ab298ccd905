// chunk_reduce.h - a scan of millions of triangles down to some hundred thousand, run by run of consecutive triangles:
// each is thinned on its own (base_reduce.h) and all are joined again. In a fraction of the memory that the scan's
// connectivity would take, on all cores, and within caches where triangles near one another in space are near in the
// list (mesh_order.h).
#pragma once

#include <atomic>
#include <functional>
#include <optional>

#include "geometry/mesh/tri_mesh.h"
#include "geometry/remesh/base_topology.h"

namespace relievo {

struct RunOptions {
  size_t run_triangles = 0;  // 0: as many as the scan's size makes best
  size_t triangles = 0;      // about as many are left inside of runs; what lies between them stays
  glm::dvec3 centre{0};      // the result is (positions - centre) / diagonal
  double diagonal = 1;
  int workers = 0;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// Borders stay in full detail. The same for any number of workers. Nothing: interrupted, or not a mesh that keeps
// TriMesh's promises (makeSurface says what is wrong with the whole of it).
std::optional<Surface> thinnedByRuns(const TriMesh& mesh, const RunOptions& options);

}  // namespace relievo
