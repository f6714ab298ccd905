// closest_search.h - how far places lie from a triangle mesh, by boxes of runs of triangles (triangle_runs.h): in 2
// bytes a triangle, where RayScene takes 64. For places fewer than triangles. Distances are RayScene::closestPoint()'s,
// bit for bit. Const and thread-safe.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>

#include <glm/glm.hpp>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/tri_mesh.h"
#include "geometry/mesh/triangle_runs.h"

namespace relievo {

// The search itself: `distanceTo(part, reach)` is that to what lies in a part's box and within the reach; what lies
// beyond may be left out. The least distance, at most `within`; infinite: nothing is as near. part: where the search
// begins, and receives the nearest; kNoPart: nothing is known. A distance of at most `enough` ends the search: the
// least may be less.
constexpr size_t kNoPart = ~size_t{0};
constexpr double kNeverEnough = -1;
template <class DistanceTo>
double closestByBoxes(const BoxTree& boxes, const glm::dvec3& place, double within, double enough, size_t& part,
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
    if (distance <= enough) reach.end();
    else reach.set(distance);
  };
  if (first != kNoPart) visit(first);
  boxes.nearToFar(reach, [&](size_t i) {
    if (i != first) visit(i);
  });
  return best;
}

class ClosestSearch {
 public:
  // runs: may be shared with others.
  explicit ClosestSearch(std::shared_ptr<const TriangleRuns> runs) : runs_(std::move(runs)) {}
  // The mesh's arrays are used in place: they must outlive the search unchanged. workers: 0 is one for each core.
  ClosestSearch(const TriMesh& mesh, int workers)
      : ClosestSearch(std::make_shared<const TriangleRuns>(mesh, workers)) {}
  const TriangleRuns& runs() const { return *runs_; }
  const std::shared_ptr<const TriangleRuns>& sharedRuns() const { return runs_; }
  // As closestByBoxes() has it; parts are runs.
  double distance(const glm::dvec3& place, double within, size_t& part, double enough = kNeverEnough) const noexcept;

 private:
  std::shared_ptr<const TriangleRuns> runs_;
};

}  // namespace relievo
