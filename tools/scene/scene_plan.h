// scene_plan.h - what the parts of a scene cost: each against the same scene without it. Pure: no GL.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/engine/effect_plan.h"
#include "texturing/package/package.h"

namespace relievo {

// Something that a scene calls for and could do without.
struct ScenePart {
  std::string name;     // "relief", "exposure": of one that is on
  std::string meaning;  // one clause
  Scene without;        // the scene, but for it
};
// Those that change the artwork's plan, in a fixed order.
std::vector<ScenePart> partsOf(const Scene& scene, const Manifest& manifest);
// Of several artworks: those that change the plan of one and can be left out for all.
std::vector<ScenePart> partsOf(const Scene& scene, std::span<const Manifest* const> manifests);

struct PlannedPlane {
  std::string name;
  double stored_bytes = 0;    // a page, on average; 0: it is made of others
  uint64_t loaded_bytes = 0;  // a page in memory of the GPU, at most
};
struct PlannedScene {
  EffectPlan plan;
  std::vector<PlannedPlane> planes;
  std::vector<std::string> passes;
  std::vector<std::string> defines;  // NAME VALUE, of the shader variant
  double storedBytes() const;        // a page of every plane
  uint64_t loadedBytes() const;
};
// Reads the package's index: kIo, kInterrupted.
Result<PlannedScene> planScene(const Scene& scene, const Package& package);

// Of several artworks together: what one of them calls for, each plane once, with the largest of its sizes, and the
// composition. Its plan is that of the first.
PlannedScene together(std::span<const PlannedScene> artworks);

// What is in `all` and not in `some`, in order.
std::vector<std::string> added(const std::vector<std::string>& all, const std::vector<std::string>& some);

}  // namespace relievo
