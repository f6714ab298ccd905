// shadow_view.h - the views from a light, for shadow maps (Williams 1978, Casting Curved Shadows on Curved Surfaces).
// Pure; double precision.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "src/render/camera.h"

namespace relievo {

// Right, up and along an axis of length 1, as rows: any of the turns about it, and the same one each time.
glm::dmat3 lookingAlong(const glm::dvec3& axis);

struct ShadowView {
  // Orthographic, along the light: what the camera sees of the artwork fills x and y of -1..1, and whatever of the
  // artwork may stand between that and the light lies within z of -1..1, the nearest to the light at -1.
  glm::dmat4 clip_from_world{1.0};
  // Of a near light, in perspective: w is the distance along the view's axis, mm, and z / w from near_mm at -1 to
  // far_mm at 1. It counts for places whose x / w and y / w lie between low and high.
  bool perspective = false;
  double near_mm = 0, far_mm = 0;
  glm::dvec2 low{-1e9}, high{1e9};
  double mm_per_unit = 1;   // of the larger of x and y, a unit of clip space; in perspective at a distance of 1 mm
  double mm_per_depth = 1;  // a unit of z; orthographic alone
};
// light: towards it, of length 1. An artwork that the camera does not see at all gives a view of all of it.
ShadowView shadowView(const ViewTransform& camera, const Extent& extent, const glm::dvec3& light);

// From a near light: one view where what the camera sees lies within a cone before the light; else those faces of a
// cube around the light that hold some of it. What is nearer to the light than a thousandth of the farthest place of
// the artwork may cast no shadow.
std::vector<ShadowView> nearShadowViews(const ViewTransform& camera, const Extent& extent, const glm::dvec3& place_mm);

// How many times as wide and high as the picture is what can cast a shadow into it: 1 to kWidestCasters. Beyond that,
// where the light is near the horizon, shadows are cut off at the border of what is drawn.
inline constexpr double kWidestCasters = 3;
// half_mm: half of the shorter side of the picture, on the plane through the camera's target.
double casterReach(const Extent& extent, const glm::dvec3& light, double half_mm);
double nearCasterReach(const ViewTransform& camera, const Extent& extent, const glm::dvec3& place_mm, double half_mm);

}  // namespace relievo
