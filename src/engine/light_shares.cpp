#include "src/engine/light_shares.h"

#include <algorithm>
#include <span>

#include "src/engine/effects/ambient_occlusion.h"
#include "src/engine/effects/soft_shadows.h"

namespace relievo {

uint32_t LightShares::hardShadow(size_t caster, const Key& key, const Wanted& wanted, const Drawing& drawing) {
  const ShadowView view = shadowView(*wanted.view, *wanted.extent, key.light.place);
  Key map = key;
  map.surface.clip_from_world = wanted.view->clip_from_world;
  if (casters_[caster].map != map) {
    casters_[caster].map = map;
    pass_.beginMap(caster);
    drawing.draw_map(view);
  }
  pass_.light(caster, drawing.programs->shadow, *drawing.surface, *drawing.screen, key.surface.clip_from_world, view);
  return 1;
}

uint32_t LightShares::nearShadow(size_t caster, const Key& key, const Wanted& wanted, const Drawing& drawing) {
  const auto views = nearShadowViews(*wanted.view, *wanted.extent, key.light.place);
  Key map = key;
  map.surface.clip_from_world = wanted.view->clip_from_world;
  const bool kept = views.size() == 1 && casters_[caster].map == map;  // of several views the map holds the last alone
  casters_[caster].map = views.size() == 1 ? std::optional(map) : std::nullopt;
  pass_.clearShare(caster);
  for (const ShadowView& view : views) {
    if (!kept) {
      pass_.beginMap(caster);
      drawing.draw_map(view);
    }
    pass_.light(caster, drawing.programs->shadow, *drawing.surface, *drawing.screen, key.surface.clip_from_world, view);
  }
  return static_cast<uint32_t>(views.size());
}

uint32_t LightShares::addPlaces(size_t caster, std::span<const glm::dvec3> places, bool first, const Wanted& wanted,
                                const Drawing& drawing) {
  casters_[caster].map.reset();
  uint32_t passes = 0;
  for (const glm::dvec3& place : places)
    for (const ShadowView& view : nearShadowViews(*wanted.view, *wanted.extent, place)) {
      pass_.beginMap(caster);
      drawing.draw_map(view);
      pass_.addView(caster, drawing.programs->shadow_add, *drawing.surface, *drawing.screen,
                    wanted.surface.clip_from_world, view, first && passes == 0);
      ++passes;
    }
  return passes;
}

uint32_t LightShares::addDirections(size_t caster, std::span<const glm::dvec3> directions, bool first,
                                    const Wanted& wanted, const Drawing& drawing) {
  const bool sky = caster == lights_, flat = wanted.extent->flat;
  const auto weight = !sky   ? ShadowPass::Weight::kEven
                      : flat ? ShadowPass::Weight::kCosineOverDark
                             : ShadowPass::Weight::kCosine;
  casters_[caster].map.reset();
  uint32_t passes = 0;
  for (size_t at = 0; at < directions.size(); at += ShadowPass::kDirectionsAPass, ++passes) {
    const auto part = directions.subspan(at, std::min(ShadowPass::kDirectionsAPass, directions.size() - at));
    std::vector<ShadowPass::Direction> some;
    pass_.beginMap(caster);
    for (const glm::dvec3& towards : part) {
      const bool dark = flat && towards.z <= 0;  // it comes from behind the artwork
      some.push_back({towards, shadowView(*wanted.view, *wanted.extent, towards), dark});
      pass_.beginDirection(some.size() - 1);
      if (!dark) drawing.draw_map(some.back().view);
    }
    pass_.addDirections(caster, some, first && at == 0, weight, drawing.programs->shadow_sum, *drawing.surface,
                        *drawing.screen, wanted.surface.clip_from_world, wanted.view->eye_mm);
  }
  return passes;
}

uint32_t LightShares::update(const Wanted& wanted, Directions directions, const Drawing& drawing) {
  lights_ = wanted.lights.size();
  casters_.resize(lights_ + (wanted.sky ? 1 : 0));
  pass_.resize(wanted.surface.width, wanted.surface.height, lights_, wanted.sky);
  uint32_t passes = 0;
  for (size_t c = 0; c < casters_.size(); ++c) {
    Caster& caster = casters_[c];
    const bool sky = c == lights_, flat = wanted.extent->flat;
    const Key key{wanted.surface, sky ? CastingLight{} : wanted.lights[c]};
    const bool same = caster.share == key;
    if (!same) {
      caster.share = key;
      caster.in = 0;
      caster.all.clear();
      if (sky) caster.all = skyDirections(flat, flat ? kSkyDirectionsOfFlat : kSkyDirectionsOfScan);
      else if (key.light.size > 0)
        caster.all = key.light.near ? discPlaces(key.light.place, key.light.axis, key.light.size)
                                    : discDirections(key.light.place, key.light.size);
    }
    const int count = static_cast<int>(caster.all.size());
    if (count == 0 || directions == Directions::kFew) {
      if (same) continue;
      if (sky) pass_.clearShare(c);
      else passes += key.light.near ? nearShadow(c, key, wanted, drawing) : hardShadow(c, key, wanted, drawing);
      continue;
    }
    if (!same && sky) pass_.clearShare(c);
    const int more = std::min(count - caster.in, directions == Directions::kAll ? count : kDirectionsAtATime);
    if (more == 0) continue;
    const auto some = std::span(caster.all).subspan(static_cast<size_t>(caster.in), static_cast<size_t>(more));
    passes += key.light.near ? addPlaces(c, some, caster.in == 0, wanted, drawing)
                             : addDirections(c, some, caster.in == 0, wanted, drawing);
    caster.in += more;
    if (!sky || caster.in >= kLeastSky) {
      pass_.takeMean(c, drawing.programs->shadow_mean, *drawing.screen);
      ++passes;
    }
  }
  return passes;
}

bool LightShares::whole() const {
  return std::all_of(casters_.begin(), casters_.end(),
                     [](const Caster& c) { return c.in == static_cast<int>(c.all.size()); });
}

int LightShares::directions() const {
  int sum = 0;
  for (const Caster& c : casters_) sum += c.in;
  return sum;
}

}  // namespace relievo
