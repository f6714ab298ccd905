#include "geometry/mesh/box_tree.h"

namespace relievo {

// Not inline: beside other code compilers turn these loops into branches. p is clamped to the box, which takes two
// instructions for four boxes; the distance beyond a side takes comparisons with 0.
BoxGroup::Lanes BoxGroup::squaredDistances(const glm::vec3& p) const noexcept {
  const std::array<float, 3> place{p.x, p.y, p.z};
  Lanes out{};
  for (size_t axis = 0; axis < 3; ++axis) {
    const float at = place[axis];
    for (size_t i = 0; i < kBoxes; ++i) {
      const float from = at < low[axis][i] ? low[axis][i] : at, inside = from > high[axis][i] ? high[axis][i] : from,
                  away = inside - at;
      out[i] += away * away;
    }
  }
  return out;
}

}  // namespace relievo
