// basis.h - what the channels of an artwork's texture planes mean, and their evaluation in double precision.
// Coefficient = (raw - bias) * scale, in 0..255 units of display intensity. With (u, v) = (x, y) of the unit vector
// towards the light, L = a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v + a5 (Malzbender, Gelb, Wolters 2001, eq. 4).
// LRGB: pixel = RGB * L / 255. RGB: pixel_c = L_c. Pixels are clamped to 0..255.
#pragma once

#include <algorithm>
#include <array>
#include <string>

namespace relievo {

enum class Basis { kColour, kPtmLrgb, kPtmRgb };

struct TextureFormat {
  Basis basis = Basis::kColour;
  std::array<double, 6> scale{1, 1, 1, 1, 1, 1};
  std::array<double, 6> bias{};

  int channels() const { return basis == Basis::kColour ? 3 : basis == Basis::kPtmLrgb ? 9 : 18; }
  int planes() const { return channels() / 3; }
};

inline const char* basisName(Basis b) {
  return b == Basis::kColour ? "colour" : b == Basis::kPtmLrgb ? "ptm-lrgb" : "ptm-rgb";
}

// The six basis functions, in .ptm's order.
inline std::array<double, 6> ptmBasis(double u, double v) { return {u * u, v * v, u * v, u, v, 1.0}; }

// One pixel in 0..255 units from its raw channels (channels() of them; they may be filtered, hence double).
// LRGB: raw[0..5] coefficients, raw[6..8] colour. RGB: raw[3 k + c] is coefficient k of colour c.
inline std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw, double u, double v) {
  std::array<double, 3> rgb{};
  if (f.basis == Basis::kColour) return {raw[0], raw[1], raw[2]};
  auto basis = ptmBasis(u, v);
  if (f.basis == Basis::kPtmLrgb) {
    double lum = 0;
    for (int k = 0; k < 6; ++k) lum += (raw[k] - f.bias[k]) * f.scale[k] * basis[k];
    for (int c = 0; c < 3; ++c) rgb[c] = raw[6 + c] * lum / 255.0;
  } else {
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < 6; ++k) rgb[c] += (raw[3 * k + c] - f.bias[k]) * f.scale[k] * basis[k];
  }
  for (double& x : rgb) x = std::clamp(x, 0.0, 255.0);
  return rgb;
}

}  // namespace relievo
