// baked_surface.h - the surface of a bake as triangles, for measuring distances and for pictures. Patches are not
// welded. Units: mm, relative to the base's origin_mm.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// Each patch gets the coarsest grid within 5e-6 of the base's diagonal, or within one quantisation step, of the finest
// (MeshBake::errorOfGrid()), but never coarser than its samples.
class BakedSurface {
 public:
  BakedSurface(const MeshBake& baked, int workers, const std::atomic<bool>* interrupted);
  size_t patches() const { return cells_log2_.size(); }
  size_t triangles(size_t patch) const { return size_t{2} << 2 * cells_log2_[patch]; }
  // The triangles of the patches [first, end). Incomplete if the bake was interrupted.
  TriMesh part(size_t first, size_t end) const;

 private:
  void fill(uint32_t patch, TriMesh& out, size_t first_vertex, size_t first_triangle) const;

  const MeshBake& baked_;
  int workers_;
  const std::atomic<bool>* interrupted_;
  int finest_log2_;
  std::vector<int> cells_log2_;
};

}  // namespace relievo
