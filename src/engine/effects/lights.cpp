#include "src/engine/effects/lights.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "shaders/shading.h"
#include "src/base/srgb.h"

namespace relievo {
namespace {

NamedUniform element(const char* array, size_t index, const glm::dvec4& value) {
  return {std::string(array) + "[" + std::to_string(index) + "]", glm::vec4(value)};
}

}  // namespace

std::vector<SceneLight> shadedLights(std::span<const SceneLight> lights) {
  std::vector<SceneLight> on;
  for (const bool near : {false, true})
    for (const SceneLight& light : lights)
      if (light.near == near && !light.isOff()) on.push_back(light);
  if (on.empty() && !lights.empty()) on.push_back(lights.front());  // all are off: black
  const bool plain = on.size() == 1 && !on[0].near && on[0].intensity == 1 && on[0].color == SceneLight{}.color;
  if (plain) on.clear();
  return on;
}

int nearCount(std::span<const SceneLight> lights) {
  return static_cast<int>(std::count_if(lights.begin(), lights.end(), [](const SceneLight& l) { return l.near; }));
}

const SceneLight* firstFarLight(std::span<const SceneLight> lights) {
  const SceneLight* first = nullptr;
  for (const SceneLight& light : lights)
    if (!light.near && (!first || (first->isOff() && !light.isOff()))) first = &light;
  return first;
}

PlacedLight placedLight(const SceneLight& light, const glm::dmat3& artwork_from_light, const glm::dvec3& middle_mm) {
  PlacedLight out{.near = light.near,
                  .place = {light.place[0], light.place[1], light.place[2]},
                  .color = light.intensity * glm::dvec3(light.color[0], light.color[1], light.color[2]),
                  .reference_mm = light.reference_mm};
  if (!light.near) {
    const double length = glm::length(out.place);
    out.place = artwork_from_light * (length > 0 && std::isfinite(length) ? out.place / length : glm::dvec3(0, 0, 1));
  } else if (out.reference_mm == 0) {
    out.reference_mm = glm::length(out.place - middle_mm);
  }
  return out;
}

glm::dvec3 litColour(const TextureFormat& format, const double* raw, std::span<const PlacedLight> lights,
                     const glm::dvec3& place_mm) {
  glm::dvec3 sum(0);
  for (const PlacedLight& light : lights) {
    glm::dvec3 towards = light.place;
    double falloff = 1;
    if (light.near) {
      const glm::dvec3 way = light.place - place_mm;
      const double distance = std::max(glm::length(way), shader::kNearestOfReference * light.reference_mm);
      towards = glm::length(way) > 0 ? glm::normalize(way) : glm::dvec3(0, 0, 1);
      falloff = light.reference_mm * light.reference_mm / (distance * distance);
    }
    const auto colour = evaluateUnclamped(format, raw, {towards.x, towards.y, towards.z});
    for (int c = 0; c < 3; ++c)
      sum[c] += light.color[c] * falloff * linearFromSrgb(std::max(colour[static_cast<size_t>(c)], 0.0) / 255.0);
  }
  return {srgbFromLinear(sum.x), srgbFromLinear(sum.y), srgbFromLinear(sum.z)};
}

std::vector<NamedUniform> lightUniforms(std::span<const PlacedLight> lights, const TextureFormat& format,
                                        const glm::dvec3& eye_mm) {
  std::vector<NamedUniform> uniforms;
  const auto coefficients = static_cast<size_t>(format.coefficients());
  std::array<glm::dvec4, kMaxCoefficients> functions{};
  for (size_t i = 0; i < lights.size(); ++i) {
    const PlacedLight& light = lights[i];
    const double reference2 = light.reference_mm * light.reference_mm;
    uniforms.push_back(element(
        "u_lights", i, glm::dvec4(light.near ? light.place - eye_mm : light.place, light.near ? reference2 : 1)));
    uniforms.push_back(element("u_light_colours", i, glm::dvec4(light.color, 0)));
    if (light.near || coefficients == 0) continue;
    std::array<double, kMaxCoefficients> values;
    describe(format.basis)
        .functions({light.place.x, light.place.y, light.place.z}, std::span(values).first(coefficients));
    for (size_t k = 0; k < coefficients; ++k) functions[k][static_cast<int>(i)] = values[k];
  }
  for (size_t k = 0; k < coefficients; ++k) uniforms.push_back(element("u_light_functions", k, functions[k]));
  return uniforms;
}

}  // namespace relievo
