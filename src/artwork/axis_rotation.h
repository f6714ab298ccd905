// axis_rotation.h - a rotation about x, then y, then z, counter-clockwise as seen from where the axis points; quarter
// turns are exact.
#pragma once

#include <cmath>
#include <numbers>

#include <glm/glm.hpp>

namespace relievo {

inline glm::dmat3 axisRotation(const glm::dvec3& degrees) {
  glm::dmat3 turn(1);
  for (glm::length_t axis = 0; axis < 3; ++axis) {
    const double angle = std::fmod(degrees[axis], 360), radians = angle * std::numbers::pi / 180;
    const double quarters = angle / 90;
    const bool exact = quarters == std::floor(quarters);
    const double c = exact ? std::round(std::cos(radians)) : std::cos(radians),
                 s = exact ? std::round(std::sin(radians)) : std::sin(radians);
    const glm::length_t i = (axis + 1) % 3, k = (axis + 2) % 3;
    glm::dmat3 one(1);
    one[i][i] = one[k][k] = c;
    one[i][k] = s;
    one[k][i] = -s;
    turn = one * turn;
  }
  return turn;
}

}  // namespace relievo
