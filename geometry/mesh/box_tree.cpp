#include "geometry/mesh/box_tree.h"

#include <cstring>

#include "src/base/simd_dispatch.h"

namespace relievo {

// p is clamped to the box, which takes two instructions for a vector of boxes; the distance beyond a side takes
// comparisons with 0. Vectors by name: compilers turn loops over so few lanes into branches and single floats.
RELIEVO_SIMD_CLONES BoxGroup::Lanes BoxGroup::squaredDistances(const glm::vec3& p) const noexcept {
  typedef float Vector __attribute__((vector_size(sizeof(Lanes))));
  const std::array<float, 3> place{p.x, p.y, p.z};
  Vector sum{};
  for (size_t axis = 0; axis < 3; ++axis) {
    Vector below, above;
    std::memcpy(&below, low[axis].data(), sizeof below);
    std::memcpy(&above, high[axis].data(), sizeof above);
    const Vector at = place[axis] - Vector{};
    const Vector from = at < below ? below : at, inside = from > above ? above : from, away = inside - at;
    sum += away * away;
  }
  Lanes out;
  std::memcpy(out.data(), &sum, sizeof sum);
  return out;
}

}  // namespace relievo
