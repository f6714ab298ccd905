#include "src/artwork/bases/ptm.h"

#include <algorithm>
#include <cmath>

#include "src/artwork/bases/bases.h"

namespace relievo {

std::array<double, 2> ptmDirection(double x, double y, double z) {
  const double sideways = std::hypot(x, y);
  return z >= 0 || !(sideways > 0) ? std::array<double, 2>{x, y} : std::array<double, 2>{x / sideways, y / sideways};
}

std::array<double, 6> ptmBasis(const std::array<double, 3>& light) {
  const auto [u, v] = ptmDirection(light[0], light[1], light[2]);
  auto basis = ptmBasis(u, v);
  if (light[2] >= 0) return basis;
  constexpr std::array<double, 6> kGrazingMean{0.5, 0.5, 0, 0, 0, 1};
  const double share = std::min(1.0, std::hypot(light[0], light[1]) / shader::kBehind);
  for (size_t k = 0; k < basis.size(); ++k)
    basis[k] = share < 1 ? kGrazingMean[k] + (basis[k] - kGrazingMean[k]) * share : basis[k];
  return basis;
}

namespace {

void ptmFunctions(const std::array<double, 3>& light, std::span<double> out) {
  std::ranges::copy(ptmBasis(light), out.begin());
}

constexpr BasisDescription ptm(std::string_view name, Shading shading, int planes, const BasisChannels& channels) {
  return {.name = name,
          .title = "a polynomial texture map",
          .shading = shading,
          .planes = planes,
          .channels = channels,
          .coefficients = 6,
          .functions = ptmFunctions,
          .functions_file = "bases/ptm.glsl",
          .diffuse = {1.0 / 3, 1.0 / 3, 0, 0, 0, 1},  // u^2 and v^2 average 1/3, the odd terms 0
          .one = {0, 0, 0, 0, 0, 1}};
}

}  // namespace

constinit const BasisDescription kPtmLrgbBasis =
    ptm("ptm-lrgb", Shading::kLuminance, luminancePlanes(6), luminanceChannels(6));
constinit const BasisDescription kPtmRgbBasis = ptm("ptm-rgb", Shading::kColours, 6, colourChannels(6));

}  // namespace relievo
