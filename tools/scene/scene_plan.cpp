#include "tools/scene/scene_plan.h"

#include <algorithm>
#include <functional>

#include "src/base/progress.h"
#include "texturing/stream/cache_budget.h"

namespace relievo {
namespace {

struct Candidate {
  std::string name, meaning;
  std::function<void(Scene&)> leave;
};

void leaveLights(Scene& s) {
  s.light_size_deg = singleLightSize(s);
  s.light = singleLight(s);
  s.lights.clear();
}

std::vector<Candidate> candidates() {
  std::vector<Candidate> all{
      {"relief", "displaced geometry", [](Scene& s) { s.relief = false; }},
      {"light", "light on the colour or the coefficients, against a light that is fixed, or none",
       [](Scene& s) {
         leaveLights(s);
         s.gloss = {};  // which needs it
         s.unlit = s.relight = false;
       }},
      {"lights", "several, near or coloured lights, against a white one that is far away", leaveLights},
      {"near lights", "near lights, against those that are far away alone",
       [](Scene& s) {
         if (std::all_of(s.lights.begin(), s.lights.end(), [](const SceneLight& l) { return l.near; })) return;
         std::erase_if(s.lights, [](const SceneLight& l) { return l.near; });
       }},
      {"normals", "normals, which light the colour", [](Scene& s) { s.unlit = true; }},
      {"shading", "the relief's slope, curvature or depth, in the place of colour and light",
       [](Scene& s) { s.shading = {}; }},
      {"shadows", "those that the relief casts on itself", [](Scene& s) { s.shadows = false; }},
      {"soft shadows", "lights with a size, against shadows with hard edges",
       [](Scene& s) {
         s.light_size_deg = 0;
         for (SceneLight& light : s.lights) light.size_deg = light.size_mm = 0;
       }},
      {"gloss", "highlights under the lights", [](Scene& s) { s.gloss = {}; }},
      {"ambient occlusion", "places that see little of the sky are darker", [](Scene& s) { s.ambient_occlusion = {}; }},
      {"anisotropic", "several taps a pixel, against trilinear",
       [](Scene& s) { s.sampling = s.sampling == Sampling::kAnisotropic ? Sampling::kTrilinear : s.sampling; }},
      {"trilinear", "two levels a pixel, against one",
       [](Scene& s) { s.sampling = s.sampling == Sampling::kTrilinear ? Sampling::kBilinear : s.sampling; }},
      {"exact filter", "full precision, against the texture unit's", [](Scene& s) { s.filter = Filter::kFast; }},
      {"geomorph", "vertices slide between levels", [](Scene& s) { s.geomorph = false; }},
      {"samples", "several a pixel of a still picture, against one", [](Scene& s) { s.samples = 1; }},
      {"page fade", "new pages blend in", [](Scene& s) { s.page_fade_s = 0; }},
      {"wireframe", "the triangles' edges", [](Scene& s) { s.wireframe = false; }}};
  for (const PixelEffect* effect : pixelEffects()) {
    const bool overlay = effect->stage == PixelEffect::Stage::kOverlay;
    all.push_back({std::string(effect->name), std::string(effect->help), [effect, overlay](Scene& s) {
                     if (overlay && s.overlay == effect) s.overlay = nullptr;
                     for (EffectSetting& setting : s.effects)
                       if (setting.effect == effect) setting.values = effect->neutral();
                   }});
  }
  return all;
}

}  // namespace

std::vector<ScenePart> partsOf(const Scene& wanted, const Manifest& manifest) {
  std::vector<ScenePart> parts;
  const EffectPlan whole = planEffects(wanted, manifest);
  Scene scene = wanted;
  if (wanted.sampling == Sampling::kAuto && whole.readsTexture()) scene.sampling = whole.sampling;
  for (const Candidate& candidate : candidates()) {
    ScenePart part{candidate.name, candidate.meaning, scene};
    candidate.leave(part.without);
    if (sceneProblem(part.without, manifest).empty() && !(planEffects(part.without, manifest) == whole) &&
        std::none_of(parts.begin(), parts.end(), [&](const ScenePart& p) {
          return planEffects(p.without, manifest) == planEffects(part.without, manifest);
        }))
      parts.push_back(std::move(part));
  }
  return parts;
}

std::vector<ScenePart> partsOf(const Scene& scene, std::span<const Manifest* const> manifests) {
  std::vector<ScenePart> parts;
  for (const Manifest* manifest : manifests)
    for (ScenePart& part : partsOf(scene, *manifest)) {
      const bool known =
          std::any_of(parts.begin(), parts.end(), [&](const ScenePart& other) { return other.name == part.name; });
      if (!known && std::all_of(manifests.begin(), manifests.end(),
                                [&](const Manifest* other) { return sceneProblem(part.without, *other).empty(); }))
        parts.push_back(std::move(part));
    }
  return parts;
}

PlannedScene together(std::span<const PlannedScene> artworks) {
  PlannedScene all = artworks[0];
  const auto addNames = [](std::vector<std::string>& to, const std::vector<std::string>& from) {
    for (std::string& name : added(from, to)) to.push_back(std::move(name));
  };
  for (const PlannedScene& one : artworks.subspan(1)) {
    addNames(all.passes, one.passes);
    addNames(all.defines, one.defines);
    for (const PlannedPlane& plane : one.planes) {
      const auto same = std::find_if(all.planes.begin(), all.planes.end(),
                                     [&](const PlannedPlane& other) { return other.name == plane.name; });
      if (same == all.planes.end()) {
        all.planes.push_back(plane);
        continue;
      }
      same->stored_bytes = std::max(same->stored_bytes, plane.stored_bytes);
      same->loaded_bytes = std::max(same->loaded_bytes, plane.loaded_bytes);
    }
  }
  if (artworks.size() > 1) all.passes.emplace_back("composition");
  return all;
}

double PlannedScene::storedBytes() const {
  double sum = 0;
  for (const PlannedPlane& p : planes) sum += p.stored_bytes;
  return sum;
}

uint64_t PlannedScene::loadedBytes() const {
  uint64_t sum = 0;
  for (const PlannedPlane& p : planes) sum += p.loaded_bytes;
  return sum;
}

Result<PlannedScene> planScene(const Scene& scene, const Package& package) {
  const Manifest& manifest = package.manifest();
  PlannedScene out;
  out.plan = planEffects(scene, manifest);
  const auto add = [&](Plane plane, bool stored, uint64_t loaded) -> Result<void> {
    PlannedPlane p{out.plan.nameOf(plane), 0, loaded};
    if (stored) {
      auto usage = planeUsage(package, plane, &interruptedFlag());
      if (!usage) return usage.error();
      p.stored_bytes = usage->pages > 0 ? static_cast<double>(usage->bytes) / static_cast<double>(usage->pages) : 0;
    }
    out.planes.push_back(std::move(p));
    return {};
  };
  const uint64_t slot = slotBytes(PageCodec::kLossless, Plane::kTexture0);
  if (out.plan.resolve) {  // the coefficients are read, and only their resolved colour is kept
    for (int k = 0; k < manifest.texture.planes(); ++k)
      if (auto done = add(texturePlane(k), true, 0); !done) return done.error();
  }
  for (const Plane plane : out.plan.texture_planes) {
    const bool made = plane == Plane::kResolved || out.plan.madeOfRelief() ||
                      (out.plan.normals_exaggerate != 0 && plane == kNormalPlane);
    if (auto done = add(plane, !made, slot); !done) return done.error();
  }
  if (out.plan.relief || out.plan.madeOfRelief())  // the latter on the CPU alone
    if (auto done = add(Plane::kRelief, true, out.plan.relief ? kSlotBytes / 2 : 0); !done) return done.error();
  out.passes = out.plan.passes();
  for (const auto& [name, value] : out.plan.defines()) out.defines.push_back(name + " " + value);
  return out;
}

std::vector<std::string> added(const std::vector<std::string>& all, const std::vector<std::string>& some) {
  std::vector<std::string> out;
  for (const std::string& one : all)
    if (std::find(some.begin(), some.end(), one) == some.end()) out.push_back(one);
  return out;
}

}  // namespace relievo
