#include "geometry/mesh/closest_search.h"

#include "geometry/mesh/triangle_point.h"
#include "src/base/simd_dispatch.h"

namespace relievo {

RELIEVO_SIMD_CLONES double ClosestSearch::distance(const glm::dvec3& place, double within, size_t& part,
                                                   double enough) const noexcept {
  const TriangleRuns& runs = *runs_;
  return closestByBoxes(runs.boxes(), place, within, enough, part, [&](size_t run, const SearchReach& reach) {
    const size_t count = runs.sizeOf(run);
    double least = std::numeric_limits<double>::infinity();
    for (size_t from = 0; from < count; from += BoxGroup::kBoxes) {
      // Of a run's triangles few lie as near as its box.
      BoxGroup boxes;
      const size_t triangles = std::min(BoxGroup::kBoxes, count - from);
      for (size_t i = 0; i < triangles; ++i) boxes.set(i, runs.boxOf(runs.triangle(run, from + i)));
      const BoxGroup::Lanes squared = boxes.squaredDistances(reach.place());
      for (size_t i = 0; i < triangles; ++i) {
        if (squared[i] > reach.squared()) continue;
        least =
            std::min(least, closestOnTriangle(cornersOf(runs.mesh(), runs.triangle(run, from + i)), place).distance);
      }
    }
    return least;
  });
}

}  // namespace relievo
