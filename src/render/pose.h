// pose.h - where an artwork stands in the world of a scene: a rigid motion, world from artwork. An artwork's own space
// is that of camera.h, mm; camera and lights are in the world's. The motion turns the artwork about the world's x, then
// y, then z (right-handed: +90 about z takes x to y), as `relievo build --rotate` turns a scan, and then moves it:
//   world = Rz Ry Rx artwork + position
// An engine works in its artwork's space: it takes the camera and the lights there, and what it finds on the surface
// back. So no shader knows of poses. A pose that is off changes no bit. Multiples of 90 degrees turn exactly.
// Pure; double precision.
#pragma once

#include <array>

#include <glm/glm.hpp>

namespace relievo {

struct Pose {
  std::array<double, 3> position_mm{0, 0, 0};  // of the artwork's origin
  std::array<double, 3> rotate_deg{0, 0, 0};   // about x, y and z, one after the other
  bool turns() const { return rotate_deg != std::array<double, 3>{}; }
  bool isOn() const { return turns() || position_mm != std::array<double, 3>{}; }
  friend bool operator==(const Pose&, const Pose&) = default;
};

glm::dmat3 worldFromArtwork(const Pose& pose);  // of directions
glm::dmat3 artworkFromWorld(const Pose& pose);
glm::dvec3 placeInWorld(const Pose& pose, const glm::dvec3& artwork_mm);
glm::dvec3 placeInArtwork(const Pose& pose, const glm::dvec3& world_mm);

}  // namespace relievo
