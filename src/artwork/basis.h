// basis.h - what the channels of an artwork's texture planes mean, and their evaluation in double precision.
// Coefficient = (raw - bias) * scale, in 0..255 units of display intensity. With (u, v) = (x, y) of the unit vector
// towards the light, L = a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v + a5 (Malzbender, Gelb, Wolters 2001, eq. 4).
// LRGB: pixel = RGB * L / 255. RGB: pixel_c = L_c. Pixels are clamped to 0..255.
// Albedo and normal (of scans): sRGB albedo, and the surface's normal n in the artwork's space, a byte b for b / 127.5
// - 1; filtered normals stay short, so that what is rough darkens as the mean of its parts does. With l the unit vector
// towards the light: pixel = RGB * L^(1/2.2), L = 0.04 + 0.96 max(0, n . l), 0.04 the ambient share.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace relievo {

enum class Basis { kColour, kPtmLrgb, kPtmRgb, kAlbedoNormal };

// Do its planes hold coefficients with scale and bias?
inline bool isPtm(Basis b) { return b == Basis::kPtmLrgb || b == Basis::kPtmRgb; }

inline constexpr double kAmbientShare = 0.04;
inline constexpr double kDisplayGamma = 2.2;  // of L above; the albedo itself is sRGB

struct TextureFormat {
  Basis basis = Basis::kColour;
  std::array<double, 6> scale{1, 1, 1, 1, 1, 1};
  std::array<double, 6> bias{};

  int planes() const {
    switch (basis) {
      case Basis::kColour:
        return 1;
      case Basis::kAlbedoNormal:
        return 2;
      case Basis::kPtmLrgb:
        return 3;
      case Basis::kPtmRgb:
        return 6;
    }
    return 0;
  }
  int channels() const { return 3 * planes(); }
};

inline const char* basisName(Basis b) {
  switch (b) {
    case Basis::kColour:
      return "colour";
    case Basis::kPtmLrgb:
      return "ptm-lrgb";
    case Basis::kPtmRgb:
      return "ptm-rgb";
    case Basis::kAlbedoNormal:
      return "albedo-normal";
  }
  return "";
}

// (u, v) of a light anywhere around a PTM's object, by the unit vector towards it in the frame of its photographs: x
// right, y up, z to the camera. They were lit from the front only: light from behind counts as grazing light from the
// same side.
inline std::array<double, 2> ptmDirection(double x, double y, double z) {
  const double sideways = std::hypot(x, y);
  return z >= 0 || !(sideways > 0) ? std::array<double, 2>{x, y} : std::array<double, 2>{x / sideways, y / sideways};
}

// The six basis functions, in .ptm's order.
inline std::array<double, 6> ptmBasis(double u, double v) { return {u * u, v * v, u * v, u, v, 1.0}; }

// The unit vector towards a light in front of the artwork, by its x and y.
inline std::array<double, 3> frontLight(double u, double v) {
  return {u, v, std::sqrt(std::max(0.0, 1 - u * u - v * v))};
}

// The basis functions under the unit vector towards a light anywhere around the object: the one definition that shader,
// resolver and reference share. A light straight from behind has no side. There the functions take their mean over all
// grazing lights, and they go over to it within kBehind of straight behind, so that a rounding error of the direction
// cannot choose a side.
inline constexpr double kBehind = 0.02;  // sine of the angle between the light and straight behind: 1.1 degrees
inline std::array<double, 6> ptmBasis(const std::array<double, 3>& light) {
  const auto [u, v] = ptmDirection(light[0], light[1], light[2]);
  auto basis = ptmBasis(u, v);
  if (light[2] >= 0) return basis;
  constexpr std::array<double, 6> kGrazingMean{0.5, 0.5, 0, 0, 0, 1};
  const double share = std::min(1.0, std::hypot(light[0], light[1]) / kBehind);
  for (size_t k = 0; k < basis.size(); ++k)
    basis[k] = share < 1 ? kGrazingMean[k] + (basis[k] - kGrazingMean[k]) * share : basis[k];
  return basis;
}

// One pixel in 0..255 units from its raw channels (channels() of them; they may be filtered, hence double).
// LRGB: raw[0..5] coefficients, raw[6..8] colour. RGB: raw[3 k + c] is coefficient k of colour c. Albedo and normal:
// raw[0..2], raw[3..5]. light: the unit vector towards the light, in the artwork's space.
inline std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw,
                                           const std::array<double, 3>& light) {
  std::array<double, 3> rgb{};
  if (f.basis == Basis::kColour) return {raw[0], raw[1], raw[2]};
  if (f.basis == Basis::kAlbedoNormal) {
    double cosine = 0;
    for (int c = 0; c < 3; ++c) cosine += (raw[3 + c] / 127.5 - 1) * light[c];
    const double gain = std::pow(kAmbientShare + (1 - kAmbientShare) * std::max(0.0, cosine), 1 / kDisplayGamma);
    for (int c = 0; c < 3; ++c) rgb[c] = std::clamp(raw[c] * gain, 0.0, 255.0);
    return rgb;
  }
  const auto basis = ptmBasis(light);
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
// The same for a light in front of the artwork, (u, v) the x and y of the vector towards it.
inline std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw, double u, double v) {
  return evaluatePixel(f, raw, frontLight(u, v));
}

}  // namespace relievo
