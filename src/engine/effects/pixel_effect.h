// pixel_effect.h - an effect on the colour of every pixel. One file of this folder describes it, and a file of GLSL,
// shaders/effects/NAME.glsl, computes it; registry.cpp lists it. Options, uniforms, the shader variant and the tests
// against the CPU reference follow from the description. An effect that is off adds no line to the variant's source and
// no uniform.
#pragma once

#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <glm/glm.hpp>

#include "src/gl/program.h"
#include "src/render/picture_target.h"

namespace relievo {

// A number that the user sets: an option --NAME.
struct EffectParameter {
  std::string_view name;  // empty: there is no such parameter
  std::string_view help;  // with the unit
  double low = 0, high = 0;
  double neutral = 0;  // where every parameter has this value, the effect is off
};

struct PixelEffect {
  // kTone: applied to the shaded colour, which is never below 0 and over a PTM may exceed 1. The result is clamped to
  // 0..1 after the last effect. kOverlay: drawn over that picture; at most one at a time (--show NAME).
  enum class Stage { kTone, kOverlay };
  static constexpr size_t kMaxParameters = 4;
  using Values = std::array<double, kMaxParameters>;

  // shaders/effects/NAME.glsl defines vec3 effect_NAME(vec3 colour, Shaded at) (Shaded: shaders/shade.frag); the
  // parameters are the components of u_NAME, in their order.
  std::string_view name;
  std::string_view help;
  Stage stage = Stage::kTone;
  std::array<EffectParameter, kMaxParameters> parameters{};
  // The CPU reference: from a colour of 0 or more to another one. Null for overlays, which show levels and not
  // colours.
  glm::dvec3 (*reference)(const glm::dvec3& colour, const Values& values) = nullptr;

  Values neutral() const;
};

// In the order in which they are applied.
std::span<const PixelEffect* const> pixelEffects();
const PixelEffect* findEffect(std::string_view name);  // null: there is none

struct EffectSetting {
  const PixelEffect* effect = nullptr;
  PixelEffect::Values values{};
  bool changesNothing() const { return values == effect->neutral(); }
  friend bool operator==(const EffectSetting&, const EffectSetting&) = default;
};

// The defines of a shading program in which these effects are on, in their order; overlay may be null.
gl::Defines effectDefines(std::span<const PixelEffect* const> tones, const PixelEffect* overlay);
// The uniforms of that program. Effects that are off have none.
std::vector<NamedUniform> effectUniforms(std::span<const EffectSetting> settings);

}  // namespace relievo
