#include "src/render/pose.h"

#include <cmath>

#include <glm/gtc/type_ptr.hpp>

namespace relievo {

glm::dmat3 worldFromArtwork(const Pose& pose) {
  glm::dmat3 turned(1);
  for (glm::length_t axis = 0; axis < 3; ++axis) {
    const double degrees = std::remainder(pose.rotate_deg[static_cast<size_t>(axis)], 360.0);
    if (degrees == 0) continue;
    const bool exact = std::remainder(degrees, 90.0) == 0;
    const auto whole = [exact](double value) { return exact ? std::round(value) : value; };
    const double cosine = whole(std::cos(glm::radians(degrees))), sine = whole(std::sin(glm::radians(degrees)));
    const glm::length_t from = (axis + 1) % 3, to = (axis + 2) % 3;
    glm::dmat3 one(1);
    one[from][from] = one[to][to] = cosine;
    one[from][to] = sine;
    one[to][from] = -sine;
    turned = one * turned;
  }
  return turned;
}

glm::dmat3 artworkFromWorld(const Pose& pose) { return glm::transpose(worldFromArtwork(pose)); }

glm::dvec3 placeInWorld(const Pose& pose, const glm::dvec3& artwork_mm) {
  return pose.isOn() ? worldFromArtwork(pose) * artwork_mm + glm::make_vec3(pose.position_mm.data()) : artwork_mm;
}

glm::dvec3 placeInArtwork(const Pose& pose, const glm::dvec3& world_mm) {
  return pose.isOn() ? artworkFromWorld(pose) * (world_mm - glm::make_vec3(pose.position_mm.data())) : world_mm;
}

}  // namespace relievo
