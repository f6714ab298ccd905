// scene_lights.h - where a scene's lights stand about the artwork, in its own space (src/render/pose.h), for the view
// that is drawn: over a base mesh those that are relit turn with the camera, all others stay in the world. Pure, but
// for the middle of the artwork, which is kept.
#pragma once

#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include "src/engine/effect_plan.h"
#include "src/engine/light_shares.h"
#include "src/render/camera.h"

namespace relievo {

class SceneLights {
 public:
  // The manifest outlives it.
  explicit SceneLights(const Manifest& manifest) : manifest_(manifest) {}
  // Towards the one white light, or the first that is far away; of length 1.
  glm::dvec3 single(const Scene& scene, const ViewTransform& view) const;
  // plan.lights of them.
  std::vector<PlacedLight> placed(const Scene& scene, const EffectPlan& plan, const ViewTransform& view) const;
  // Those that cast shadows, in the shader's order.
  std::vector<CastingLight> casting(const Scene& scene, const EffectPlan& plan, const ViewTransform& view) const;
  // How many times as wide as the picture is what casts a shadow into it, or hides sky from it. half_mm: casterReach().
  double reach(const Scene& scene, const EffectPlan& plan, const ViewTransform& view, const Extent& extent,
               double half_mm) const;

 private:
  glm::dmat3 artworkFromLight(const Scene& scene, const ViewTransform& view) const;

  const Manifest& manifest_;
  mutable std::optional<glm::dvec3> middle_;  // artworkMiddle(): a walk over a mesh's corners
};

}  // namespace relievo
