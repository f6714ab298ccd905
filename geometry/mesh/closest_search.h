// closest_search.h - how far places lie from a triangle mesh, by boxes of 16 successive triangles: made in one pass and
// in 1.7 bytes a triangle, where RayScene takes 64. For places fewer than triangles, on meshes whose successive
// triangles lie near one another (mesh_order.h); distances are RayScene::closestPoint()'s, bit for bit.
// Const and thread-safe.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/tri_mesh.h"
#include "geometry/mesh/triangle_point.h"
#include "src/base/parallel_for.h"

namespace relievo {

// The search itself: `distanceTo(part, reach)` is that to what lies in a part's box and within the reach; what lies
// beyond may be left out. The least distance, at most `within`; infinite: nothing is as near. part: where the search
// begins, and receives the nearest; kNoPart: nothing is known.
constexpr size_t kNoPart = ~size_t{0};
template <class DistanceTo>
double closestByBoxes(const BoxTree& boxes, const glm::dvec3& place, double within, size_t& part,
                      DistanceTo distanceTo) {
  double best = std::numeric_limits<double>::infinity();
  SearchReach reach(place);
  reach.set(within);
  const size_t first = part;
  auto visit = [&](size_t i) {
    const double distance = distanceTo(i, reach);
    if (!(distance <= within) || !(distance < best)) return;
    best = distance;
    part = i;
    reach.set(distance);
  };
  if (first != kNoPart) visit(first);
  boxes.nearToFar(reach, [&](size_t i) {
    if (i != first) visit(i);
  });
  return best;
}

class ClosestSearch {
 public:
  // The mesh's arrays are used in place: they must outlive the search unchanged. workers: 0 is one for each core.
  ClosestSearch(const TriMesh& mesh, int workers) : mesh_(&mesh) {
    constexpr size_t kBlocksPerJob = 1024;
    std::vector<Box> boxes((mesh.triangles.size() + kBlock - 1) / kBlock);
    parallelFor((boxes.size() + kBlocksPerJob - 1) / kBlocksPerJob, workers, nullptr, [&](size_t job) {
      for (size_t b = job * kBlocksPerJob; b < std::min(boxes.size(), (job + 1) * kBlocksPerJob); ++b)
        for (size_t t = b * kBlock; t < std::min(mesh.triangles.size(), (b + 1) * kBlock); ++t)
          for (uint32_t v : mesh.triangles[t]) boxes[b].add(mesh.positions_mm[v]);
    });
    boxes_ = BoxTree(boxes);
  }
  // As closestByBoxes() has it.
  double distance(const glm::dvec3& place, double within, size_t& part) const {
    return closestByBoxes(boxes_, place, within, part, [&](size_t block, const SearchReach& reach) {
      const size_t first = block * kBlock, count = std::min(kBlock, mesh_->triangles.size() - first);
      double least = std::numeric_limits<double>::infinity();
      for (size_t from = 0; from < count; from += BoxGroup::kBoxes) {
        // Of a block's triangles few lie as near as its box.
        BoxGroup boxes;
        const size_t triangles = std::min(BoxGroup::kBoxes, count - from);
        for (size_t i = 0; i < triangles; ++i) {
          Box box;
          for (uint32_t v : mesh_->triangles[first + from + i]) box.add(mesh_->positions_mm[v]);
          boxes.set(i, box);
        }
        const BoxGroup::Lanes squared = boxes.squaredDistances(reach.place());
        for (size_t i = 0; i < triangles; ++i) {
          if (squared[i] > reach.squared()) continue;
          const auto triangle = static_cast<uint32_t>(first + from + i);
          least = std::min(least, closestOnTriangle(cornersOf(*mesh_, triangle), place).distance);
        }
      }
      return least;
    });
  }

 private:
  static constexpr size_t kBlock = 16;
  const TriMesh* mesh_;
  BoxTree boxes_;
};

}  // namespace relievo
