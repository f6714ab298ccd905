// other_bases.h - linear bases beside the PTM's: those that the program is built with, and some that tests register, to
// show that nothing but a description is needed. Hemispherical harmonics (Gautron, Krivanek, Pattanaik, Bouatouch 2004)
// as the relighting of photographs uses them (HSH), and lobes around directions, of more planes than a page table's
// entry has room for.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "src/artwork/basis.h"

namespace relievo::test {

inline constexpr double kPi = std::numbers::pi;

// Of orders 1 to 3: the first 1, 4 or 9, as many as out has room for. Light from behind counts as grazing light.
inline void harmonics(const std::array<double, 3>& light, std::span<double> out) {
  const double z = std::clamp(light[2], 0.0, 1.0), sideways = std::hypot(light[0], light[1]);
  const double cosine = sideways > 0 ? light[0] / sideways : 1, sine = sideways > 0 ? light[1] / sideways : 0;
  const double root = std::sqrt(z - z * z);
  const std::array<double, 9> all{1 / std::sqrt(2 * kPi),
                                  std::sqrt(6 / kPi) * cosine * root,
                                  std::sqrt(3 / (2 * kPi)) * (2 * z - 1),
                                  std::sqrt(6 / kPi) * sine * root,
                                  std::sqrt(30 / kPi) * (cosine * cosine - sine * sine) * (z * z - z),
                                  std::sqrt(30 / kPi) * cosine * (2 * z - 1) * root,
                                  std::sqrt(5 / (2 * kPi)) * (1 - 6 * z + 6 * z * z),
                                  std::sqrt(30 / kPi) * sine * (2 * z - 1) * root,
                                  std::sqrt(30 / kPi) * (2 * sine * cosine) * (z - z * z)};
  std::copy_n(all.begin(), out.size(), out.begin());
}

inline constexpr int kLobes = 13;  // and a constant before them: one more than a page table's second texel
inline void lobes(const std::array<double, 3>& light, std::span<double> out) {
  out[0] = 1;
  for (int k = 1; k < kLobes; ++k) {
    const double angle = 2 * kPi * k / (kLobes - 1);
    const double facing = 0.8 * std::cos(angle) * light[0] + 0.8 * std::sin(angle) * light[1] + 0.6 * light[2];
    out[static_cast<size_t>(k)] = std::pow(std::max(0.0, facing), 2);
  }
}

// A luminance of four coefficients whose channels, and those of its colour, stand in no order, two of them unused.
constexpr BasisChannels scatteredChannels() {
  using enum BasisChannel::Holds;
  constexpr uint8_t kLum = BasisChannel::kLuminance;
  return {{{kColour, 2, 0},
           {kCoefficient, kLum, 3},
           {kNothing},
           {kCoefficient, kLum, 0},
           {kColour, 0, 0},
           {kCoefficient, kLum, 2},
           {kCoefficient, kLum, 1},
           {kNothing},
           {kColour, 1, 0}}};
}

inline constexpr double kConstant = 2.5066282746310002;  // sqrt(2 pi): the first harmonic times this is 1
inline constexpr BasisDescription kHsh4Lrgb{.name = "test-hsh4-lrgb",
                                            .title = "a map of harmonics",
                                            .shading = Shading::kLuminance,
                                            .planes = luminancePlanes(4),
                                            .channels = luminanceChannels(4),
                                            .coefficients = 4,
                                            .functions = harmonics,
                                            .diffuse = {1 / kConstant},
                                            .one = {kConstant}};
inline constexpr BasisDescription kHsh9Rgb{.name = "test-hsh9-rgb",
                                           .title = "a map of harmonics",
                                           .shading = Shading::kColours,
                                           .planes = 9,
                                           .channels = colourChannels(9),
                                           .coefficients = 9,
                                           .functions = harmonics,
                                           .diffuse = {1 / kConstant},
                                           .one = {kConstant}};
inline constexpr BasisDescription kScatteredHsh{.name = "test-hsh4-scattered",
                                                .title = "a map of harmonics",
                                                .shading = Shading::kLuminance,
                                                .planes = 3,
                                                .channels = scatteredChannels(),
                                                .coefficients = 4,
                                                .functions = harmonics,
                                                .diffuse = {1 / kConstant},
                                                .one = {kConstant}};
inline constexpr BasisDescription kLobesRgb{.name = "test-lobes-rgb",
                                            .title = "a map of lobes",
                                            .shading = Shading::kColours,
                                            .planes = kLobes,
                                            .channels = colourChannels(kLobes),
                                            .coefficients = kLobes,
                                            .functions = lobes,
                                            .diffuse = {1},
                                            .one = {1}};

// Those of this file, each registered once a program; then those of src/artwork/bases/, so that a new one is tested as
// soon as the registry lists it.
inline const std::vector<Basis>& otherBases() {
  static const std::vector<Basis> all = [] {
    const size_t built_in = basisCount();
    std::vector<Basis> made;
    for (const BasisDescription* d : {&kHsh4Lrgb, &kHsh9Rgb, &kScatteredHsh, &kLobesRgb})
      made.push_back(registerBasis(*d).value());
    for (size_t place = static_cast<size_t>(Basis::kAlbedoNormal) + 1; place < built_in; ++place)
      made.push_back(static_cast<Basis>(place));
    return made;
  }();
  return all;
}

// Scales and biases that make pictures of middle brightness of channels around 125. A luminance of few coefficients has
// larger ones, so that the light matters.
inline TextureFormat otherFormat(Basis basis) {
  TextureFormat f;
  f.basis = basis;
  const BasisDescription& d = describe(basis);
  const double scale = d.shading == Shading::kLuminance ? 4 : 1.2;
  for (size_t k = 0; k < static_cast<size_t>(d.coefficients); ++k) {
    f.scale[k] = k == 0 ? 1.4 * d.one[0] : scale + 0.1 * static_cast<double>(k % 4);
    f.bias[k] = k == 0 ? 3 : 125 + static_cast<double>(k % 3);
  }
  return f;
}

}  // namespace relievo::test
