// baked_surface.h - the finest surface of a bake as triangles, patch by patch, not welded: what it is measured by.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// A patch's grid is the coarsest that lies within 5e-6 of the base's diagonal or one step of the heights of the finest
// (errorOfCells()), never coarser than the samples.
class BakedSurface {
 public:
  BakedSurface(const MeshBake& baked, int workers, const std::atomic<bool>* interrupted);
  size_t patches() const { return cells_log2_.size(); }
  size_t triangles(size_t patch) const { return size_t{2} << 2 * cells_log2_[patch]; }
  // Of the patches [first, end). Interrupted: some of it.
  TriMesh part(size_t first, size_t end) const;

 private:
  void fill(uint32_t patch, TriMesh& out, size_t first_vertex, size_t first_triangle) const;

  const MeshBake& baked_;
  int workers_;
  const std::atomic<bool>* interrupted_;
  int finest_log2_;
  std::vector<int> cells_log2_;
};

// The same with far fewer triangles, in blocks of 8 x 8 cells, each as coarse as lies within that distance of the
// finest; blocks of different grids meet with gaps of as much.
class CoarseBakedSurface {
 public:
  CoarseBakedSurface(const MeshBake& baked, double close_mm) : baked_(baked), close_mm_(close_mm) {}
  size_t patches() const { return baked_.base().patches.size(); }
  void add(uint32_t patch, TriMesh& out) const;

 private:
  const MeshBake& baked_;
  double close_mm_;
};

}  // namespace relievo
