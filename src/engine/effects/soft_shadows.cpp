#include "src/engine/effects/soft_shadows.h"

#include <cmath>
#include <numbers>

#include "src/render/shadow_view.h"

namespace relievo {

glm::dvec2 latticePoint(int k, int n) {
  int reversed = 0;
  for (int bit = 1, from = k; bit < n; bit *= 2, from /= 2) reversed = 2 * reversed + from % 2;
  const double turns = reversed / std::numbers::phi;
  return {(reversed + 0.5) / n, turns - std::floor(turns)};
}

std::vector<glm::dvec3> discDirections(const glm::dvec3& light, double size_deg, int count) {
  const glm::dmat3 world_from_light = glm::transpose(lookingAlong(light));
  const glm::dvec3 &right = world_from_light[0], &up = world_from_light[1];
  const double half = size_deg / 2 * std::numbers::pi / 180;
  // 1 - cos(half), without cancellation for small discs.
  const double depth = 2 * std::sin(half / 2) * std::sin(half / 2);
  std::vector<glm::dvec3> directions;
  for (int k = 0; k < count; ++k) {
    const glm::dvec2 at = latticePoint(k, count);
    const double below = at.x * depth, aslant = std::sqrt(below * (2 - below)), turn = 2 * std::numbers::pi * at.y;
    directions.push_back((1 - below) * light + aslant * (std::cos(turn) * right + std::sin(turn) * up));
  }
  return directions;
}

std::vector<glm::dvec3> discPlaces(const glm::dvec3& place_mm, const glm::dvec3& towards, double size_mm, int count) {
  const glm::dmat3 world_from_light = glm::transpose(lookingAlong(towards));
  const glm::dvec3 &right = world_from_light[0], &up = world_from_light[1];
  std::vector<glm::dvec3> places;
  for (int k = 0; k < count; ++k) {
    const glm::dvec2 at = latticePoint(k, count);
    const double radius = size_mm / 2 * std::sqrt(at.x), turn = 2 * std::numbers::pi * at.y;
    places.push_back(place_mm + radius * (std::cos(turn) * right + std::sin(turn) * up));
  }
  return places;
}

}  // namespace relievo
