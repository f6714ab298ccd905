// normal_cone.h - a cone of directions that holds all normals of a piece of surface. Pure.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include <glm/glm.hpp>

namespace relievo {

class NormalCone {
 public:
  // Empty: it holds none.
  NormalCone() = default;
  // axis: of length 1. half_angle: 0 to pi, in radians.
  NormalCone(const glm::dvec3& axis, double half_angle) : axis_(axis), half_angle_(half_angle), empty_(false) {}

  // Becomes the smallest cone that holds both, but for rounding (Barequet, Elber 2005, section 3).
  void add(const NormalCone& other) {
    if (other.empty_) return;
    const double between = empty_ ? 0 : angleTo(other.axis_);
    if (empty_ || between + half_angle_ <= other.half_angle_) {
      *this = other;
      return;
    }
    if (between + other.half_angle_ <= half_angle_) return;
    const glm::dvec3 towards = other.axis_ - axis_ * glm::dot(axis_, other.axis_);
    const double length = glm::length(towards), both = (between + half_angle_ + other.half_angle_) / 2;
    if (!(length > 0) || both >= std::numbers::pi) {
      half_angle_ = std::numbers::pi;
      return;
    }
    const double turn = both - half_angle_;
    axis_ = glm::normalize(axis_ * std::cos(turn) + towards * (std::sin(turn) / length));
    half_angle_ = both;
  }
  // The largest angle, in radians, between n, of length 1, and a direction in the cone; 0 if that is empty.
  double largestAngle(const glm::dvec3& n) const {
    return empty_ ? 0 : std::min(angleTo(n) + half_angle_, std::numbers::pi);
  }

 private:
  double angleTo(const glm::dvec3& n) const { return std::acos(std::clamp(glm::dot(axis_, n), -1.0, 1.0)); }

  glm::dvec3 axis_{0};
  double half_angle_ = 0;
  bool empty_ = true;
};

}  // namespace relievo
