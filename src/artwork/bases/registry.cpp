// registry.cpp - every basis, by its place and by its name.
#include <vector>

#include "src/artwork/bases/bases.h"

namespace relievo {
namespace {

using Registry = std::vector<const BasisDescription*>;

// In the order of the enumeration Basis; others behind.
Registry& registry() {
  static Registry all{&kColourBasis, &kPtmLrgbBasis, &kPtmRgbBasis, &kAlbedoNormalBasis};
  return all;
}

constexpr size_t kMaxNameBytes = 31;  // a package's header has 32, the last one 0

// Empty: nothing is wrong with a linear basis' channels. Each coefficient of each colour, or of the luminance, stands
// in one channel.
std::string channelsProblem(const BasisDescription& d) {
  const bool luminance = d.shading == Shading::kLuminance;
  std::array<std::array<int, kMaxCoefficients>, 4> coefficients{};
  std::array<int, 3> colours{};
  for (size_t i = 0; i < static_cast<size_t>(3 * d.planes); ++i) {
    const BasisChannel& c = d.channels[i];
    const std::string channel = "channel " + std::to_string(i);
    if (c.holds == BasisChannel::Holds::kNormal) return channel + " holds a normal";
    if (c.holds == BasisChannel::Holds::kColour) {
      if (!luminance || c.of > 2) return channel + " holds a colour that nothing is multiplied with";
      ++colours[c.of];
    } else if (c.holds == BasisChannel::Holds::kCoefficient) {
      if ((c.of == BasisChannel::kLuminance) != luminance || c.of > BasisChannel::kLuminance ||
          c.coefficient >= d.coefficients)
        return channel + " holds a coefficient that there is not";
      ++coefficients[c.of][c.coefficient];
    }
  }
  for (int of = 0; of < 4; ++of)
    for (int k = 0; k < d.coefficients; ++k)
      if ((of == BasisChannel::kLuminance) == luminance &&
          coefficients[static_cast<size_t>(of)][static_cast<size_t>(k)] != 1)
        return "coefficient " + std::to_string(k) + " does not stand in one channel for each sum that it is in";
  for (int found : colours)
    if (found != (luminance ? 1 : 0)) return "a component of the colour does not stand in one channel";
  return {};
}

}  // namespace

std::string problemOf(const BasisDescription& d) {
  if (d.name.empty() || d.name.size() > kMaxNameBytes) return "its name has no 1 to 31 bytes";
  if (d.name.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789-") != std::string_view::npos)
    return "its name has other characters than lower case letters, digits and '-'";
  if (d.name.data()[d.name.size()] != '\0') return "its name does not end with a zero byte";
  if (d.shading != Shading::kLuminance && d.shading != Shading::kColours) return "it is not linear";
  if (d.planes < 1 || d.planes > kMaxTexturePlanes)
    return "it has no 1 to " + std::to_string(kMaxTexturePlanes) + " planes";
  if (d.coefficients < 1 || d.coefficients > kMaxCoefficients)
    return "it has no 1 to " + std::to_string(kMaxCoefficients) + " coefficients";
  if (d.functions == nullptr) return "it has no functions of the light";
  return channelsProblem(d);
}

const BasisDescription& describe(Basis basis) {
  assert(static_cast<size_t>(basis) < registry().size());
  return *registry()[static_cast<size_t>(basis)];
}

std::optional<Basis> findBasis(std::string_view name) {
  for (size_t i = 0; i < registry().size(); ++i)
    if (registry()[i]->name == name) return static_cast<Basis>(i);
  return std::nullopt;
}

size_t basisCount() { return registry().size(); }

Result<Basis> registerBasis(const BasisDescription& description) {
  std::string problem = problemOf(description);
  if (problem.empty() && findBasis(description.name)) problem = "there is one of this name";
  if (!problem.empty())
    return Error{ErrorKind::kUsage, "", "the basis '" + std::string(description.name) + "': " + problem, "", {}};
  registry().push_back(&description);
  return static_cast<Basis>(registry().size() - 1);
}

}  // namespace relievo
