#include "src/engine/scene_lights.h"

#include <algorithm>
#include <cmath>

#include <glm/gtc/type_ptr.hpp>

#include "src/engine/artwork.h"
#include "src/render/shadow_view.h"

namespace relievo {
namespace {

// Of what is lower above the horizon of a flat artwork, where a quarter of the sky's light comes from, casters beyond
// the picture's border are left out.
constexpr glm::dvec3 kLowSky{0.8660254037844386, 0, 0.5};

// The direction of the light's disc that is nearest to the plane of a flat artwork.
glm::dvec3 lowestOf(const CastingLight& light) {
  if (light.size == 0) return light.place;
  const double half = glm::radians(light.size / 2), angle = std::acos(std::clamp(light.place.z, -1.0, 1.0));
  const double lowest = std::min(angle + half, glm::radians(89.9));
  return {std::sin(lowest), 0, std::cos(lowest)};
}

}  // namespace

glm::dmat3 SceneLights::artworkFromLight(const Scene& scene, const ViewTransform& view) const {
  return !manifest_.domain.isFlat() && scene.relight ? view.world_from_camera : artworkFromWorld(scene.pose);
}

glm::dvec3 SceneLights::single(const Scene& scene, const ViewTransform& view) const {
  return artworkFromLight(scene, view) * glm::make_vec3(singleLight(scene).data());
}

std::vector<PlacedLight> SceneLights::placed(const Scene& scene, const EffectPlan& plan,
                                             const ViewTransform& view) const {
  std::vector<PlacedLight> lights;
  if (plan.lights == 0) return lights;
  if (!middle_) middle_ = artworkMiddle(manifest_);
  for (SceneLight light : shadedLights(scene.lights)) {
    if (light.near) {
      const glm::dvec3 place = placeInArtwork(scene.pose, glm::make_vec3(light.place.data()));
      light.place = {place.x, place.y, place.z};
    }
    lights.push_back(placedLight(light, artworkFromLight(scene, view), *middle_));
  }
  return lights;
}

std::vector<CastingLight> SceneLights::casting(const Scene& scene, const EffectPlan& plan,
                                               const ViewTransform& view) const {
  if (plan.lights == 0) return {{.place = single(scene, view), .size = singleLightSize(scene)}};
  const std::vector<SceneLight> shaded = shadedLights(scene.lights);
  const std::vector<PlacedLight> all = placed(scene, plan, view);
  std::vector<CastingLight> lights;
  for (size_t i = 0; i < all.size(); ++i) {
    CastingLight light{.near = all[i].near, .place = all[i].place, .size = shaded[i].size_deg};
    if (light.near) {
      const glm::dvec3 way = light.place - *middle_;
      light.size = shaded[i].size_mm;
      if (glm::length(way) > 0) light.axis = glm::normalize(way);
    }
    lights.push_back(light);
  }
  return lights;
}

double SceneLights::reach(const Scene& scene, const EffectPlan& plan, const ViewTransform& view, const Extent& extent,
                          double half_mm) const {
  double reach = 1;
  if (plan.shadows)
    for (const CastingLight& light : casting(scene, plan, view))
      reach = std::max(reach, light.near ? nearCasterReach(view, extent, light.place, half_mm)
                                         : casterReach(extent, lowestOf(light), half_mm));
  if (plan.ambient_occlusion) reach = std::max(reach, casterReach(extent, kLowSky, half_mm));
  return reach;
}

}  // namespace relievo
