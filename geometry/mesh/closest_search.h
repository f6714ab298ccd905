// closest_search.h - how far places lie from a triangle mesh, by boxes of 16 successive triangles: made in one pass and
// in 1.7 bytes a triangle, where RayScene takes 64. For places fewer than triangles. Meshes whose successive triangles
// lie far from one another take 4 bytes more and a sort. Distances are RayScene::closestPoint()'s, bit for bit.
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
#include "geometry/mesh/mesh_order.h"
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
    std::vector<Box> boxes = blockBoxes(workers);
    if (!coherent(boxes)) {
      order_ = orderAlongCurve(mesh, workers);
      boxes = blockBoxes(workers);
    }
    boxes_ = BoxTree(boxes);
  }
  // Whether triangles are searched in another order than the mesh's.
  bool ordered() const { return !order_.empty(); }
  // Part p of distance() holds the triangles at the places from kBlock * p on, kBlock of them or what is left.
  static constexpr size_t kBlock = 16;
  uint32_t triangleAt(size_t place) const { return order_.empty() ? static_cast<uint32_t>(place) : order_[place]; }
  // As closestByBoxes() has it.
  double distance(const glm::dvec3& place, double within, size_t& part) const {
    return closestByBoxes(boxes_, place, within, part, [&](size_t block, const SearchReach& reach) {
      const size_t first = block * kBlock, count = std::min(kBlock, mesh_->triangles.size() - first);
      double least = std::numeric_limits<double>::infinity();
      for (size_t from = 0; from < count; from += BoxGroup::kBoxes) {
        // Of a block's triangles few lie as near as its box.
        BoxGroup boxes;
        const size_t triangles = std::min(BoxGroup::kBoxes, count - from);
        for (size_t i = 0; i < triangles; ++i) boxes.set(i, boxOf(triangleAt(first + from + i)));
        const BoxGroup::Lanes squared = boxes.squaredDistances(reach.place());
        for (size_t i = 0; i < triangles; ++i) {
          if (squared[i] > reach.squared()) continue;
          least = std::min(least, closestOnTriangle(cornersOf(*mesh_, triangleAt(first + from + i)), place).distance);
        }
      }
      return least;
    });
  }

 private:
  Box boxOf(uint32_t triangle) const {
    Box box;
    for (uint32_t v : mesh_->triangles[triangle]) box.add(mesh_->positions_mm[v]);
    return box;
  }
  std::vector<Box> blockBoxes(int workers) const {
    constexpr size_t kBlocksPerJob = 1024;
    const size_t triangles = mesh_->triangles.size();
    std::vector<Box> boxes((triangles + kBlock - 1) / kBlock);
    parallelFor((boxes.size() + kBlocksPerJob - 1) / kBlocksPerJob, workers, nullptr, [&](size_t job) {
      for (size_t b = job * kBlocksPerJob; b < std::min(boxes.size(), (job + 1) * kBlocksPerJob); ++b)
        for (size_t i = b * kBlock; i < std::min(triangles, (b + 1) * kBlock); ++i) boxes[b].add(boxOf(triangleAt(i)));
    });
    return boxes;
  }
  // Whether blocks' boxes are, on average, hardly larger than 16 triangles in a row.
  bool coherent(const std::vector<Box>& boxes) const {
    constexpr double kMostTriangles = 2.0 * kBlock;
    auto size = [](const Box& box) { return static_cast<double>(glm::length(box.high - box.low)); };
    double blocks = 0, triangles = 0;
    for (size_t b = 0; b < boxes.size(); ++b) {
      blocks += size(boxes[b]);
      triangles += size(boxOf(static_cast<uint32_t>(b * kBlock)));
    }
    return blocks <= kMostTriangles * triangles;
  }
  const TriMesh* mesh_;
  std::vector<uint32_t> order_;  // of the triangles; empty: the mesh's
  BoxTree boxes_;
};

}  // namespace relievo
