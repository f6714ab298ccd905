#include "src/render/pose.h"

#include <glm/gtc/type_ptr.hpp>

#include "src/artwork/axis_rotation.h"

namespace relievo {

glm::dmat3 worldFromArtwork(const Pose& pose) { return axisRotation(glm::make_vec3(pose.rotate_deg.data())); }

glm::dmat3 artworkFromWorld(const Pose& pose) { return glm::transpose(worldFromArtwork(pose)); }

glm::dvec3 placeInWorld(const Pose& pose, const glm::dvec3& artwork_mm) {
  return pose.isOn() ? worldFromArtwork(pose) * artwork_mm + glm::make_vec3(pose.position_mm.data()) : artwork_mm;
}

glm::dvec3 placeInArtwork(const Pose& pose, const glm::dvec3& world_mm) {
  return pose.isOn() ? artworkFromWorld(pose) * (world_mm - glm::make_vec3(pose.position_mm.data())) : world_mm;
}

}  // namespace relievo
