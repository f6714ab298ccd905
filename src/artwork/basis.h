// basis.h - what the channels of an artwork's texture planes mean, and their evaluation in double precision. Package,
// resolver, shader and neutral pages read the description of a basis; no other file knows one of them by name, but for
// what imports it.
//
// A linear basis is N coefficients times N functions of the light, f_k(l), l the unit vector towards the light in the
// artwork's space: L = sum over k of (raw_k - bias_k) scale_k f_k(l), in 0..255 units of display intensity.
//   Shading::kLuminance  one such sum, times a colour: pixel = R G B * L / 255
//   Shading::kColours    such a sum for each colour: pixel_c = L_c
// Pixels are clamped to 0..255. A channel of a plane holds one coefficient of one colour (or of the luminance), or one
// component of the colour, in any order. The functions are evaluated on the CPU, once a frame or page; under lights
// near the artwork on the GPU, once a pixel.
//
// Two bases are not linear. Colour is shown as it is. Albedo and normal (of scans): sRGB albedo, and the surface's
// normal n in the artwork's space, a byte b for b / 127.5 - 1; filtered normals stay short, so that what is rough
// darkens as the mean of its parts does. pixel = RGB * L^(1/2.2), L = 0.04 + 0.96 max(0, n . l), 0.04 the ambient
// share. Where a scan's surface is seen from behind, n is the other side's: -n.
//
// A new linear basis is a file in src/artwork/bases/ that defines its description, and a line in registry.cpp there.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "shaders/shading.h"
#include "src/base/result.h"

namespace relievo {

// What a PageId's five bits leave beside the relief, resolved colour, and the slots that relief pages share
// (texturing/codec/page_id.h). GL sets no limit: pages of all planes lie in the slots of one texture.
inline constexpr int kMaxTexturePlanes = 29;
// Of a luminance, with one plane for its colour. Uniforms have room for 224 (ES 3.0).
inline constexpr int kMaxCoefficients = 3 * (kMaxTexturePlanes - 1);

// A place in the registry. Those that code refers to have names; others are found by theirs (findBasis).
enum class Basis : int { kColour, kPtmLrgb, kPtmRgb, kAlbedoNormal };

enum class Shading : int {
  kColour = RV_SHADING_COLOUR,
  kLuminance = RV_SHADING_LUMINANCE,
  kColours = RV_SHADING_COLOURS,
  kAlbedoNormal = RV_SHADING_ALBEDO_NORMAL
};

struct BasisChannel {
  enum class Holds : uint8_t { kNothing, kCoefficient, kColour, kNormal };
  static constexpr uint8_t kLuminance = 3;
  Holds holds = Holds::kNothing;
  uint8_t of = 0;           // 0 red, 1 green, 2 blue, or kLuminance; of a normal 0 x, 1 y, 2 z
  uint8_t coefficient = 0;  // which one
};
using BasisChannels = std::array<BasisChannel, 3 * kMaxTexturePlanes>;  // channel 3 p + c is channel c of plane p

struct BasisDescription {
  std::string_view name;   // in packages, manifests and reports: lower case, digits and '-', at most 31 bytes
  std::string_view title;  // in sentences: "a polynomial texture map"
  Shading shading = Shading::kColour;
  int planes = 0;
  BasisChannels channels{};
  // Of linear bases only:
  int coefficients = 0;  // N
  // Writes the N values f_k(l) for any unit vector l, also one from behind the object. Pure; called from any thread.
  void (*functions)(const std::array<double, 3>& light, std::span<double> out) = nullptr;
  // The file of shaders/ that computes the same for each pixel: void basisFunctions(vec3 light, out float
  // functions[COEFFICIENTS]). Lights near the artwork need it; empty: they are refused (sceneProblem()).
  std::string_view functions_file{};
  // With kLuminance: the functions' means over the lights of the upper hemisphere, evenly by solid angle. They weigh
  // colours at coarser levels (mip.h).
  std::array<double, kMaxCoefficients> diffuse{};
  // Coefficients for which the sum over k of one_k f_k(l) is 1 under every light, or as near to 1 as the functions
  // allow. Pages that cannot be read are shown by them, as grey (neutral_page.h).
  std::array<double, kMaxCoefficients> one{};
};

// The usual packing: coefficient k of the luminance in channel k % 3 of plane k / 3, and the colour in the plane
// behind.
constexpr int luminancePlanes(int coefficients) { return (coefficients + 2) / 3 + 1; }
constexpr BasisChannels luminanceChannels(int coefficients) {
  BasisChannels out{};
  for (int k = 0; k < coefficients; ++k)
    out[static_cast<size_t>(k)] = {BasisChannel::Holds::kCoefficient, BasisChannel::kLuminance,
                                   static_cast<uint8_t>(k)};
  for (int c = 0; c < 3; ++c)
    out[static_cast<size_t>(3 * (luminancePlanes(coefficients) - 1) + c)] = {BasisChannel::Holds::kColour,
                                                                             static_cast<uint8_t>(c), 0};
  return out;
}
// Plane k holds coefficient k of red, green and blue.
constexpr BasisChannels colourChannels(int coefficients) {
  BasisChannels out{};
  for (int i = 0; i < 3 * coefficients; ++i)
    out[static_cast<size_t>(i)] = {BasisChannel::Holds::kCoefficient, static_cast<uint8_t>(i % 3),
                                   static_cast<uint8_t>(i / 3)};
  return out;
}

// ---- the registry (src/artwork/bases/registry.cpp) ----
const BasisDescription& describe(Basis basis);
std::optional<Basis> findBasis(std::string_view name);
size_t basisCount();  // places 0 .. basisCount() - 1 are taken
// Adds a basis to those that the program is built with. The description stays where it is until the program ends. Not
// while other threads use bases. Error: kUsage, with what is wrong with the description, or that its name is taken.
Result<Basis> registerBasis(const BasisDescription& description);
// What registerBasis() would refuse in a description, its name being free; empty: nothing.
std::string problemOf(const BasisDescription& description);
inline const char* basisName(Basis b) { return describe(b).name.data(); }
// Of texture plane k, by what its channels hold: "a0-a2", "rgb-a3", "colour", "albedo", "normal".
std::string textureName(Basis basis, int plane);

// ---- an artwork's texture ----
// A number a coefficient. What a list leaves out has the default, so that equal formats compare equal.
template <int kDefault>
struct PerCoefficient : std::array<double, kMaxCoefficients> {
  constexpr PerCoefficient() { this->fill(kDefault); }
  constexpr PerCoefficient(std::initializer_list<double> first) : PerCoefficient() {
    std::copy(first.begin(), first.end(), this->begin());
  }
};

struct TextureFormat {
  Basis basis = Basis::kColour;
  PerCoefficient<1> scale;
  PerCoefficient<0> bias;

  int planes() const { return describe(basis).planes; }
  int channels() const { return 3 * planes(); }
  int coefficients() const { return describe(basis).coefficients; }
  // Of the coefficients that there are.
  std::span<const double> scales() const { return std::span(scale).first(static_cast<size_t>(coefficients())); }
  std::span<const double> biases() const { return std::span(bias).first(static_cast<size_t>(coefficients())); }
};

// ---- evaluation ----
// The unit vector towards a light in front of the artwork, by its x and y. Beyond the unit circle: on the horizon, in
// the same direction.
std::array<double, 3> frontLight(double u, double v);

// One pixel in 0..255 units from its raw channels (channels() of them; they may be filtered, hence double).
// light: the unit vector towards the light, in the artwork's space. The one definition that shader and resolver share.
std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw, const std::array<double, 3>& light);
// The same before it is clamped: what effects on colour start from (src/engine/effects/pixel_effect.h).
std::array<double, 3> evaluateUnclamped(const TextureFormat& f, const double* raw, const std::array<double, 3>& light);
// evaluatePixel for a light in front of the artwork, (u, v) the x and y of the vector towards it.
inline std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw, double u, double v) {
  return evaluatePixel(f, raw, frontLight(u, v));
}

}  // namespace relievo
