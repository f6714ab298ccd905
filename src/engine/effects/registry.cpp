#include "src/engine/effects/effects.h"

namespace relievo {

std::span<const PixelEffect* const> pixelEffects() {
  static constexpr std::array kAll{&kExposureEffect, &kPagesEffect, &kLodEffect};
  return kAll;
}

const PixelEffect* findEffect(std::string_view name) {
  for (const PixelEffect* effect : pixelEffects())
    if (effect->name == name) return effect;
  return nullptr;
}

PixelEffect::Values PixelEffect::neutral() const {
  Values values{};
  for (size_t i = 0; i < values.size(); ++i) values[i] = parameters[i].neutral;
  return values;
}

gl::Defines effectDefines(std::span<const PixelEffect* const> tones, const PixelEffect* overlay) {
  std::string files, calls;
  // What a basis or another effect makes may lie below 0, of which powers and ratios have no use.
  auto add = [&](const PixelEffect& effect, std::string& to) {
    const std::string name(effect.name);
    files += "\"effects/" + name + ".glsl\"";
    to += "colour = effect_" + name + "(max(colour, 0.0), at); ";
  };
  for (const PixelEffect* tone : tones) add(*tone, calls);
  std::string over;
  if (overlay) add(*overlay, over);
  gl::Defines defines;
  if (!files.empty()) defines.emplace_back("EFFECT_FILES", files);
  if (!calls.empty()) defines.emplace_back("TONE_EFFECTS", calls);
  if (!over.empty()) defines.emplace_back("OVERLAY_EFFECT", over);
  return defines;
}

std::vector<NamedUniform> effectUniforms(std::span<const EffectSetting> settings) {
  std::vector<NamedUniform> uniforms;
  for (const EffectSetting& setting : settings) {
    if (setting.changesNothing()) continue;
    const glm::vec4 values(setting.values[0], setting.values[1], setting.values[2], setting.values[3]);
    uniforms.push_back({"u_" + std::string(setting.effect->name), values});
  }
  return uniforms;
}

}  // namespace relievo
