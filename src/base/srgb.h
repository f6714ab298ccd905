// srgb.h - the transfer function of sRGB (IEC 61966-2-1) and its inverse, of values from 0 on; 1 is white. Pure.
#pragma once

#include <cmath>

namespace relievo {

inline double linearFromSrgb(double encoded) {
  return encoded <= 0.04045 ? encoded / 12.92 : std::pow((encoded + 0.055) / 1.055, 2.4);
}
inline double srgbFromLinear(double linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

}  // namespace relievo
