// shadow_view.h - the view from a light that is far away, for shadow maps (Williams 1978, Casting Curved Shadows on
// Curved Surfaces). Pure; double precision.
#pragma once

#include <glm/glm.hpp>

#include "src/render/camera.h"

namespace relievo {

struct ShadowView {
  // Orthographic, along the light: what the camera sees of the artwork fills x and y of -1..1, and whatever of the
  // artwork may stand between that and the light lies within z of -1..1, the nearest to the light at -1.
  glm::dmat4 clip_from_world{1.0};
  double mm_per_unit = 1;   // of the larger of x and y, a unit of clip space
  double mm_per_depth = 1;  // a unit of z
};
// light: towards it, of length 1. An artwork that the camera does not see at all gives a view of all of it.
ShadowView shadowView(const ViewTransform& camera, const Extent& extent, const glm::dvec3& light);

// How many times as wide and high as the picture is what can cast a shadow into it: 1 to kWidestCasters. Beyond that,
// where the light is near the horizon, shadows are cut off at the border of what is drawn.
inline constexpr double kWidestCasters = 3;
// half_mm: half of the shorter side of the picture, on the plane through the camera's target.
double casterReach(const Extent& extent, const glm::dvec3& light, double half_mm);

}  // namespace relievo
