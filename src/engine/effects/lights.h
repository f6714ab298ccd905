// lights.h - the lights of a scene that has more than one white light far away: several, near or coloured ones.
//
// Lights add up in linear light. What an artwork's basis gives for a direction is the display-encoded colour (sRGB) of
// the artwork under one white light from there: the photographs that a PTM is fitted to, or Lambert's law on a scan's
// albedo, with its ambient share. For light i, whose direction from the place p is l_i(p), that colour C(l_i) is made
// linear, multiplied by the light's intensity, colour and falloff, and added; the sum is encoded again:
//   colour = encode(sum over i of intensity_i color_i falloff_i(p) decode(max(0, C(l_i(p)))))
// One white light of intensity 1 that is far away gives C itself. It needs none of this and has none of it: no define,
// uniform or pass. A near light falls off with the square of the distance, (reference / distance)^2, so that at
// reference_mm it is as a light far away; no nearer than kNearestOfReference of it
// (shaders/shading.h), so that nothing is infinite. p is the drawn surface, with its heights as they are exaggerated.
//
// Pure; double precision; litColour() is the CPU reference of shaders/lights.glsl.
#pragma once

#include <array>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/basis.h"
#include "src/render/picture_target.h"

namespace relievo {

inline constexpr size_t kMaxLights = 4;  // a component of a vector each: of the basis functions and the shares of light
inline constexpr double kMaxLightIntensity = 1000;

struct SceneLight {
  bool near = false;
  // Towards it, as Scene::light and of any length above 0; of a near one where it is in the world, mm.
  std::array<double, 3> place{0, 0, 1};
  double intensity = 1;
  std::array<double, 3> color{1, 1, 1};  // linear, 0..1
  double size_deg = 0;      // of one far away: its angular diameter (soft_shadows.h); 0: its shadows are hard
  double size_mm = 0;       // of a near one: its diameter; 0: its shadows are hard
  double reference_mm = 0;  // of a near one; 0: its distance from the middle of the artwork (artworkMiddle())
  bool isSoft() const { return near ? size_mm > 0 : size_deg > 0; }
  bool isOff() const { return intensity == 0 || color == std::array<double, 3>{}; }
  friend bool operator==(const SceneLight&, const SceneLight&) = default;
};

// Those that the shader evaluates: without those that are off, those far away before near ones. Empty: one white light
// of intensity 1 that is far away.
std::vector<SceneLight> shadedLights(std::span<const SceneLight> lights);
int nearCount(std::span<const SceneLight> lights);
// The first light that is far away, not looking at those that are off if another one is on; null: all are near.
const SceneLight* firstFarLight(std::span<const SceneLight> lights);

struct PlacedLight {
  bool near = false;
  glm::dvec3 place{0, 0, 1};  // the unit vector towards it, or where it is; in the artwork's space, mm
  glm::dvec3 color{1};        // linear, times the intensity
  double reference_mm = 1;
};
// artwork_from_light: of directions. A near light's place and middle_mm, the artwork's: in the same space.
PlacedLight placedLight(const SceneLight& light, const glm::dmat3& artwork_from_light, const glm::dvec3& middle_mm);

// The colour of a place of the surface, display-encoded, 1 is white, not clamped. raw: the channels as evaluatePixel()
// takes them.
glm::dvec3 litColour(const TextureFormat& format, const double* raw, std::span<const PlacedLight> lights,
                     const glm::dvec3& place_mm);

// Of lights.glsl. Places there count from eye_mm.
std::vector<NamedUniform> lightUniforms(std::span<const PlacedLight> lights, const TextureFormat& format,
                                        const glm::dvec3& eye_mm);

}  // namespace relievo
