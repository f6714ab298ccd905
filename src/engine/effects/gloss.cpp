#include "src/engine/effects/gloss.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "src/base/srgb.h"

namespace relievo {

double highlight(const Gloss& gloss, const glm::dvec3& normal, const glm::dvec3& light, const glm::dvec3& viewer) {
  const double nl = glm::dot(normal, light), nv = glm::dot(normal, viewer);
  if (nl <= 0 || nv <= 0) return 0;
  const glm::dvec3 half = glm::normalize(light + viewer);
  const double nh = glm::dot(normal, half), hv = std::max(glm::dot(half, viewer), 0.0);
  const double a2 = std::pow(gloss.roughness, 4), spread = nh * nh * (a2 - 1) + 1;
  const double d = a2 / (std::numbers::pi * spread * spread);
  const double v = 0.5 / (nl * std::sqrt(nv * nv * (1 - a2) + a2) + nv * std::sqrt(nl * nl * (1 - a2) + a2));
  const double f = gloss.reflectance + (1 - gloss.reflectance) * std::pow(1 - hv, 5);
  return std::numbers::pi * d * v * f * nl;
}

glm::dvec3 glossed(const glm::dvec3& colour, const glm::dvec3& highlights) {
  glm::dvec3 out;
  for (int c = 0; c < 3; ++c) out[c] = srgbFromLinear(linearFromSrgb(std::max(colour[c], 0.0)) + highlights[c]);
  return out;
}

std::vector<NamedUniform> glossUniforms(const Gloss& gloss) {
  return {{"u_gloss", glm::vec4(gloss.reflectance, std::pow(gloss.roughness, 4), 0, 0)}};
}

}  // namespace relievo
