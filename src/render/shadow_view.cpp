#include "src/render/shadow_view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace relievo {
namespace {

using Polygon = std::vector<glm::dvec3>;

glm::dvec3 boxCorner(const Extent& box, int corner) {
  return {corner & 1 ? box.max_mm.x : box.min_mm.x, corner & 2 ? box.max_mm.y : box.min_mm.y,
          corner & 4 ? box.max_mm.z : box.min_mm.z};
}

// The part on the side of the plane where dot(plane, (p, 1)) is not below 0 (Sutherland and Hodgman 1974).
Polygon clipped(const Polygon& polygon, const glm::dvec4& plane) {
  Polygon out;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const glm::dvec3 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
    const double da = glm::dot(plane, glm::dvec4(a, 1)), db = glm::dot(plane, glm::dvec4(b, 1));
    if (da >= 0) out.push_back(a);
    if ((da >= 0) != (db >= 0)) out.push_back(a + (b - a) * (da / (da - db)));
  }
  return out;
}

// The six faces of the cube whose corners these are, bit by bit x, y, z.
std::array<Polygon, 6> facesOf(const std::array<glm::dvec3, 8>& corners) {
  constexpr int kFaces[6][4] = {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}};
  std::array<Polygon, 6> faces;
  for (size_t f = 0; f < 6; ++f)
    for (const int corner : kFaces[f]) faces[f].push_back(corners[static_cast<size_t>(corner)]);
  return faces;
}

// The faces of what lies both in the camera's view and in the artwork's box; those of the box where that is nothing.
std::vector<Polygon> facesInView(const ViewTransform& camera, const Extent& extent) {
  const glm::dmat4 rows = glm::transpose(camera.clip_from_world), world = glm::inverse(camera.clip_from_world);
  std::array<glm::dvec3, 8> box, view;
  for (int corner = 0; corner < 8; ++corner) {
    box[static_cast<size_t>(corner)] = boxCorner(extent, corner);
    const glm::dvec4 p = world * glm::dvec4(corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1, 1);
    view[static_cast<size_t>(corner)] = glm::dvec3(p) / p.w;
  }
  std::array<glm::dvec4, 6> view_planes, box_planes;
  for (int axis = 0; axis < 3; ++axis) {
    const size_t k = 2 * static_cast<size_t>(axis);
    view_planes[k] = rows[3] + rows[axis];
    view_planes[k + 1] = rows[3] - rows[axis];
    glm::dvec4 low(0), high(0);
    low[axis] = 1, low.w = -extent.min_mm[axis];
    high[axis] = -1, high.w = extent.max_mm[axis];
    box_planes[k] = low;
    box_planes[k + 1] = high;
  }
  std::vector<Polygon> faces;
  const auto take = [&](const std::array<glm::dvec3, 8>& of, const std::array<glm::dvec4, 6>& planes) {
    for (Polygon face : facesOf(of)) {
      for (const glm::dvec4& plane : planes) face = clipped(face, plane);
      if (!face.empty()) faces.push_back(std::move(face));
    }
  };
  take(box, view_planes);
  take(view, box_planes);
  if (faces.empty())
    for (const Polygon& face : facesOf(box)) faces.push_back(face);
  return faces;
}

Polygon cornersInView(const ViewTransform& camera, const Extent& extent) {
  Polygon corners;
  for (const Polygon& face : facesInView(camera, extent)) corners.insert(corners.end(), face.begin(), face.end());
  return corners;
}

// The perspective of a light, of what lies between low and high by tangents. holds: of these, what it counts for.
ShadowView perspectiveFrom(const glm::dvec3& place_mm, const glm::dmat3& light_from_world, const Extent& extent,
                           glm::dvec2 low, glm::dvec2 high, double holds) {
  constexpr double kLeastNear = 1e-3, kMargin = 1.02;  // of the far plane; so that what borders on a map lies within
  double far = 0;
  for (int corner = 0; corner < 8; ++corner)
    far = std::max(far, (light_from_world * (boxCorner(extent, corner) - place_mm)).z);
  const glm::dvec3 beside = glm::max(extent.min_mm - place_mm, place_mm - extent.max_mm);
  const double apart = glm::length(glm::max(beside, glm::dvec3(0)));
  const glm::dvec2 widest = glm::max(glm::abs(low), glm::abs(high));
  ShadowView view;
  view.perspective = true;
  view.far_mm = std::max(far, 1e-9) * 1.001;
  view.near_mm = std::max(0.99 * apart / std::sqrt(1 + glm::dot(widest, widest)), kLeastNear * view.far_mm);
  view.near_mm = std::min(view.near_mm, 0.99 * view.far_mm);
  const glm::dvec2 centre = (low + high) / 2.0, half = glm::max((high - low) * 0.5, glm::dvec2(1e-6)) * kMargin;
  const double n = view.near_mm, f = view.far_mm;
  glm::dmat4 clip_from_light(0.0);
  for (int axis = 0; axis < 2; ++axis) {
    clip_from_light[axis][axis] = 1 / half[axis];
    clip_from_light[2][axis] = -centre[axis] / half[axis];
  }
  clip_from_light[2][2] = (f + n) / (f - n);
  clip_from_light[3][2] = -2 * f * n / (f - n);
  clip_from_light[2][3] = 1;
  glm::dmat4 turned(light_from_world);
  turned[3] = glm::dvec4(light_from_world * -place_mm, 1);
  view.clip_from_world = clip_from_light * turned;
  view.mm_per_unit = std::max(half.x, half.y);
  view.low = (glm::dvec2(-holds) - centre) / half;
  view.high = (glm::dvec2(holds) - centre) / half;
  return view;
}

}  // namespace

glm::dmat3 lookingAlong(const glm::dvec3& axis) {
  const glm::dvec3 aside = std::abs(axis.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0);
  const glm::dvec3 right = glm::normalize(glm::cross(aside, axis));
  return glm::transpose(glm::dmat3(right, glm::cross(axis, right), axis));
}

ShadowView shadowView(const ViewTransform& camera, const Extent& extent, const glm::dvec3& light) {
  const glm::dmat3 light_from_world = lookingAlong(light);
  glm::dvec3 low(1e300), high(-1e300);
  for (const glm::dvec3& p : cornersInView(camera, extent)) {
    low = glm::min(low, light_from_world * p);
    high = glm::max(high, light_from_world * p);
  }
  for (int corner = 0; corner < 8; ++corner) {  // towards the light all of it
    const double z = (light_from_world * boxCorner(extent, corner)).z;
    low.z = std::min(low.z, z), high.z = std::max(high.z, z);
  }
  // A margin, so that nothing lies on the border by rounding, and no side is 0.
  const glm::dvec3 centre = (low + high) / 2.0;
  const double least = 1e-6 * std::max({high.x - low.x, high.y - low.y, high.z - low.z, 1e-9});
  const glm::dvec3 half = glm::max((high - low) * 0.5, glm::dvec3(least)) * 1.002;
  ShadowView view;
  view.mm_per_unit = std::max(half.x, half.y);
  view.mm_per_depth = half.z;
  const glm::dvec3 scale(1 / half.x, 1 / half.y, -1 / half.z);
  for (int c = 0; c < 3; ++c) view.clip_from_world[c] = glm::dvec4(scale * light_from_world[c], 0);
  view.clip_from_world[3] = glm::dvec4(-scale * centre, 1);
  return view;
}

std::vector<ShadowView> nearShadowViews(const ViewTransform& camera, const Extent& extent, const glm::dvec3& place_mm) {
  // Tangents. Beyond the widest a face of a cube makes more of its texels; faces overlap by rounding and more.
  constexpr double kWidest = 1.5, kAll = 1e9, kFace = 1.0005;
  const std::vector<Polygon> faces = facesInView(camera, extent);
  const auto boundsOf = [&](const glm::dmat3& light_from_world, bool pyramid, glm::dvec2& low, glm::dvec2& high) {
    low = glm::dvec2(1e300), high = glm::dvec2(-1e300);
    bool before = true;
    for (const Polygon& face : faces) {
      Polygon seen;
      for (const glm::dvec3& p : face) seen.push_back(light_from_world * (p - place_mm));
      if (pyramid) {
        seen = clipped(seen, {0, 0, 1, -1e-9});
        for (int axis = 0; axis < 2; ++axis)
          for (const double side : {-1.0, 1.0}) {
            glm::dvec4 plane(0, 0, 1, 0);
            plane[axis] = side;
            seen = clipped(seen, plane);
          }
      }
      for (const glm::dvec3& p : seen) {
        before &= p.z > 0;
        const glm::dvec2 at = glm::dvec2(p) / std::max(p.z, 1e-300);
        low = glm::min(low, at), high = glm::max(high, at);
      }
    }
    return before && low.x <= high.x;
  };
  glm::dvec3 least(1e300), most(-1e300);
  for (const Polygon& face : faces)
    for (const glm::dvec3& p : face) least = glm::min(least, p), most = glm::max(most, p);
  const glm::dvec3 way = (least + most) / 2.0 - place_mm;
  glm::dvec2 low, high;
  if (glm::length(way) > 0) {
    const glm::dmat3 light_from_world = lookingAlong(glm::normalize(way));
    if (boundsOf(light_from_world, false, low, high) && std::max({-low.x, -low.y, high.x, high.y}) <= kWidest)
      return {perspectiveFrom(place_mm, light_from_world, extent, low, high, kAll)};
  }
  std::vector<ShadowView> views;
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {-1.0, 1.0}) {
      glm::dvec3 along(0);
      along[axis] = side;
      const glm::dmat3 light_from_world = lookingAlong(along);
      if (boundsOf(light_from_world, true, low, high))
        views.push_back(perspectiveFrom(place_mm, light_from_world, extent, low, high, kFace));
    }
  return views;
}

double casterReach(const Extent& extent, const glm::dvec3& light, double half_mm) {
  const glm::dvec3 size = extent.max_mm - extent.min_mm;
  // Of a flat artwork, how far its highest place throws a shadow to its lowest; of a body, its length.
  double reach_mm = glm::length(size);
  if (extent.flat && light.z > 0) reach_mm = std::min(reach_mm, size.z * std::hypot(light.x, light.y) / light.z);
  return std::clamp(1 + reach_mm / half_mm, 1.0, kWidestCasters);
}

double nearCasterReach(const ViewTransform& camera, const Extent& extent, const glm::dvec3& place_mm, double half_mm) {
  double reach = 1;
  for (const glm::dvec3& p : cornersInView(camera, extent)) {
    const glm::dvec3 way = place_mm - p;
    const double length = glm::length(way), beside = extent.flat ? glm::length(glm::dvec2(way)) : length;
    if (length > 0)
      reach = std::max(reach, std::min(casterReach(extent, way / length, half_mm),
                                       std::clamp(1 + beside / half_mm, 1.0, kWidestCasters)));
  }
  return reach;
}

}  // namespace relievo
