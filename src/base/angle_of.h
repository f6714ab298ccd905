// angle_of.h - an angle that has the same bits on all machines, in a tenth of the time of std::atan2.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

namespace relievo {

// The angle of the vector (x, y), y not below 0 and not both 0, with an error below 2e-6.
inline float angleOf(float y, float x) {
  const float wide = std::abs(x), t = std::min(wide, y) / std::max(wide, y), s = t * t;
  const float small_angle =
      t *
      (0.99997726f + s * (-0.33262347f + s * (0.19354346f + s * (-0.11643287f + s * (0.05265332f - s * 0.01172120f)))));
  const float first = y > wide ? std::numbers::pi_v<float> / 2 - small_angle : small_angle;
  return x < 0 ? std::numbers::pi_v<float> - first : first;
}

}  // namespace relievo
