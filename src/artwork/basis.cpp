#include "src/artwork/basis.h"

#include <cmath>

namespace relievo {
namespace {

using Pixel = std::array<double, 3>;

Pixel albedoUnderLight(const double* raw, const std::array<double, 3>& light) {
  using namespace shader;
  double cosine = 0;
  for (size_t c = 0; c < 3; ++c) cosine += (raw[3 + c] / kNormalUnit - 1) * light[c];
  const double gain = std::pow(kAmbientShare + (1 - kAmbientShare) * std::max(0.0, cosine), 1 / kDisplayGamma);
  Pixel rgb{};
  for (size_t c = 0; c < 3; ++c) rgb[c] = raw[c] * gain;
  return rgb;
}

Pixel linearUnderLight(const BasisDescription& basis, const TextureFormat& f, const double* raw,
                       const std::array<double, 3>& light) {
  double functions[kMaxCoefficients];
  basis.functions(light, std::span(functions).first(static_cast<size_t>(basis.coefficients)));
  double sum[4] = {};  // red, green, blue, luminance
  Pixel colour{}, rgb{};
  for (size_t i = 0; i < static_cast<size_t>(3 * basis.planes); ++i) {
    const BasisChannel& c = basis.channels[i];
    const size_t k = c.coefficient;
    if (c.holds == BasisChannel::Holds::kCoefficient) sum[c.of] += (raw[i] - f.bias[k]) * f.scale[k] * functions[k];
    else if (c.holds == BasisChannel::Holds::kColour) colour[c.of] = raw[i];
  }
  for (size_t c = 0; c < 3; ++c)
    rgb[c] = basis.shading == Shading::kLuminance ? colour[c] * sum[BasisChannel::kLuminance] / 255.0 : sum[c];
  return rgb;
}

}  // namespace

std::string textureName(Basis basis, int plane) {
  const BasisDescription& d = describe(basis);
  const auto of_plane = std::span(d.channels).subspan(static_cast<size_t>(3 * plane), 3);
  const BasisChannel& first = of_plane[0];
  if (first.holds == BasisChannel::Holds::kNormal) return "normal";
  if (first.holds == BasisChannel::Holds::kColour) return d.shading == Shading::kAlbedoNormal ? "albedo" : "colour";
  if (first.holds == BasisChannel::Holds::kNothing) return "plane " + std::to_string(plane);
  int last = first.coefficient;
  for (const BasisChannel& c : of_plane)
    if (c.holds == BasisChannel::Holds::kCoefficient) last = std::max<int>(last, c.coefficient);
  std::string name = "a" + std::to_string(first.coefficient);
  if (d.shading == Shading::kColours) return "rgb-" + name;
  return last == first.coefficient ? name : name + "-a" + std::to_string(last);
}

std::array<double, 3> frontLight(double u, double v) {
  const double radius = std::hypot(u, v);
  if (radius > 1) return {u / radius, v / radius, 0};
  return {u, v, std::sqrt(std::max(0.0, 1 - u * u - v * v))};
}

std::array<double, 3> evaluateUnclamped(const TextureFormat& f, const double* raw, const std::array<double, 3>& light) {
  const BasisDescription& basis = describe(f.basis);
  switch (basis.shading) {
    case Shading::kColour:
      break;
    case Shading::kLuminance:
    case Shading::kColours:
      return linearUnderLight(basis, f, raw, light);
    case Shading::kAlbedoNormal:
      return albedoUnderLight(raw, light);
  }
  return {raw[0], raw[1], raw[2]};
}

std::array<double, 3> evaluatePixel(const TextureFormat& f, const double* raw, const std::array<double, 3>& light) {
  auto rgb = evaluateUnclamped(f, raw, light);
  for (double& c : rgb) c = std::clamp(c, 0.0, 255.0);
  return rgb;
}

}  // namespace relievo
