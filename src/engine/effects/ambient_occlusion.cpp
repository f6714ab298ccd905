#include "src/engine/effects/ambient_occlusion.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "src/base/srgb.h"
#include "src/engine/effects/soft_shadows.h"

namespace relievo {

std::vector<glm::dvec3> skyDirections(bool flat, int count) {
  std::vector<glm::dvec3> directions;
  for (int k = 0; k < count; ++k) {
    const glm::dvec2 at = latticePoint(k, count);
    const double z = flat ? 1 - at.x : 1 - 2 * at.x, aslant = std::sqrt(1 - z * z), turn = 2 * std::numbers::pi * at.y;
    directions.emplace_back(aslant * std::cos(turn), aslant * std::sin(turn), z);
  }
  return directions;
}

double seenShare(const glm::dvec3& normal, std::span<const glm::dvec3> directions,
                 const std::function<bool(size_t)>& seen, bool flat) {
  double sum = 0, all = 0;
  for (size_t k = 0; k < directions.size(); ++k) {
    const double cosine = glm::dot(normal, directions[k]);
    all += flat ? std::abs(cosine) : std::max(cosine, 0.0);
    if (cosine > 0 && seen(k)) sum += cosine;
  }
  return all > 0 ? sum / all : 1;
}

glm::dvec3 occluded(const glm::dvec3& colour, double share, double strength) {
  glm::dvec3 out;
  for (int c = 0; c < 3; ++c)
    out[c] = srgbFromLinear(linearFromSrgb(std::max(colour[c], 0.0)) * (1 - strength * (1 - share)));
  return out;
}

std::vector<NamedUniform> occlusionUniforms(const AmbientOcclusion& occlusion) {
  if (!occlusion.isOn()) return {};
  return {{"u_occlusion", glm::vec4(static_cast<float>(occlusion.strength), 0, 0, 0)}};
}

}  // namespace relievo
