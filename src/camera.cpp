#include "src/camera.h"

#include <algorithm>
#include <cmath>

#include <glm/gtc/matrix_transform.hpp>

namespace relievo {
namespace {

glm::dmat3 worldFromCamera(const OrbitCamera& camera) {
  double az = glm::radians(camera.azimuth_deg), el = glm::radians(camera.elevation_deg);
  glm::dvec3 back{std::sin(az) * std::cos(el), std::sin(el), std::cos(az) * std::cos(el)};
  glm::dvec3 right{std::cos(az), 0, -std::sin(az)};
  return {right, glm::cross(back, right), back};
}

}  // namespace

glm::dvec3 eyePosition(const OrbitCamera& camera) {
  return camera.target_mm + worldFromCamera(camera)[2] * camera.distance_mm;
}

Extent extentOf(const PlanarDomain& domain, double min_z_mm, double max_z_mm) {
  double half_w = 0.5 * static_cast<double>(domain.width_px) * domain.mm_per_px;
  double half_h = 0.5 * static_cast<double>(domain.height_px) * domain.mm_per_px;
  return {{-half_w, -half_h, min_z_mm}, {half_w, half_h, max_z_mm}, domain.mm_per_px, true};
}

Extent extentOf(const BaseMesh& base, double min_height_mm, double max_height_mm, double texel_mm) {
  Extent extent{glm::dvec3(1e300), glm::dvec3(-1e300), texel_mm, false};
  for (const BaseCorner& corner : base.corners) {
    // A patch lies in the hull of its corners' points at the smallest and the largest height.
    for (double height : {min_height_mm, max_height_mm}) {
      const glm::dvec3 p = glm::dvec3(corner.position_mm) + glm::dvec3(corner.normal) * height;
      extent.min_mm = glm::min(extent.min_mm, p);
      extent.max_mm = glm::max(extent.max_mm, p);
    }
  }
  return extent;
}

ViewTransform viewTransform(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px) {
  ViewTransform view;
  glm::dmat3 world_from_camera = worldFromCamera(camera);
  glm::dmat3 camera_from_world = glm::transpose(world_from_camera);
  view.eye_mm = eyePosition(camera);
  view.world_from_camera = world_from_camera;

  const glm::dvec3 &lo = extent.min_mm, &hi = extent.max_mm;
  double nearest = 1e300, farthest = 0;
  for (int corner = 0; corner < 8; ++corner) {
    glm::dvec3 p{corner & 1 ? hi.x : lo.x, corner & 2 ? hi.y : lo.y, corner & 4 ? hi.z : lo.z};
    double depth = -(camera_from_world * (p - view.eye_mm)).z;
    nearest = std::min(nearest, depth);
    farthest = std::max(farthest, depth);
  }
  double tan_half = std::tan(glm::radians(camera.fov_deg) / 2);
  double aspect = static_cast<double>(width_px) / height_px;
  // Nothing in view is nearer than the artwork's box, nor (of a flat one) than where the steepest line of sight, one of the picture's
  // corners, meets the plane of the greatest height. An eye within the box gets a thousandth of the distance to the target.
  double steepest = -1e300;
  for (double x : {-1.0, 1.0}) {
    for (double y : {-1.0, 1.0}) {
      glm::dvec3 sight = world_from_camera * glm::dvec3{x * tan_half * aspect, y * tan_half, -1};  // one mm of depth
      steepest = std::max(steepest, -sight.z);
    }
  }
  double above = view.eye_mm.z - hi.z;
  double nearest_seen = extent.flat && above > 0 && steepest > 0 ? std::max(nearest, above / steepest) : nearest;
  view.near_mm = std::max(nearest_seen * 0.98, std::max(camera.distance_mm, 1e-6) * 1e-3);
  view.far_mm = std::max(farthest * 1.02, view.near_mm * 2);

  double n = view.near_mm, f = view.far_mm;
  glm::dmat4 clip_from_camera(0.0);
  clip_from_camera[0][0] = 1 / (tan_half * aspect);
  clip_from_camera[1][1] = 1 / tan_half;
  clip_from_camera[2][2] = -(f + n) / (f - n);
  clip_from_camera[2][3] = -1;
  clip_from_camera[3][2] = -2 * f * n / (f - n);
  glm::dmat4 rotation(camera_from_world);
  view.clip_from_world = clip_from_camera * glm::translate(rotation, -view.eye_mm);
  view.pixels_per_radian = height_px / (2 * tan_half);
  return view;
}

ViewTransform viewTransform(const OrbitCamera& camera, const PlanarDomain& domain, double min_z_mm, double max_z_mm,
                            int width_px, int height_px) {
  return viewTransform(camera, extentOf(domain, min_z_mm, max_z_mm), width_px, height_px);
}

double fitDistance(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px) {
  constexpr double kMargin = 1.06;
  double tan_y = std::tan(glm::radians(camera.fov_deg) / 2) / kMargin;
  double tan_x = tan_y * static_cast<double>(width_px) / height_px;
  const glm::dvec3 &lo = extent.min_mm, &hi = extent.max_mm;
  glm::dmat3 camera_from_world = glm::transpose(worldFromCamera(camera));
  double distance = 0;
  for (int corner = 0; corner < 8; ++corner) {
    glm::dvec3 p = camera_from_world * (glm::dvec3{corner & 1 ? hi.x : lo.x, corner & 2 ? hi.y : lo.y, corner & 4 ? hi.z : lo.z} - camera.target_mm);
    distance = std::max({distance, std::abs(p.x) / tan_x + p.z, std::abs(p.y) / tan_y + p.z});
  }
  return distance;
}

double fitDistance(const OrbitCamera& camera, const PlanarDomain& domain, int width_px, int height_px) {
  return fitDistance(camera, extentOf(domain), width_px, height_px);
}

OrbitCamera fitCamera(const Extent& extent, int width_px, int height_px, double fov_deg) {
  OrbitCamera camera;
  camera.fov_deg = fov_deg;
  camera.target_mm = extent.centre();
  camera.distance_mm = fitDistance(camera, extent, width_px, height_px);
  return camera;
}
OrbitCamera fitCamera(const PlanarDomain& domain, int width_px, int height_px, double fov_deg) {
  return fitCamera(extentOf(domain), width_px, height_px, fov_deg);
}

glm::dvec3 pointAtTarget(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px) {
  double tan_half = std::tan(glm::radians(camera.fov_deg) / 2);
  double aspect = static_cast<double>(width_px) / height_px;
  glm::dvec3 in_camera{(2 * x_px / width_px - 1) * tan_half * aspect, (1 - 2 * y_px / height_px) * tan_half, 0};
  return camera.target_mm + worldFromCamera(camera) * (in_camera * camera.distance_mm);
}

bool pointOnPlane(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px, glm::dvec3* point_mm) {
  double tan_half = std::tan(glm::radians(camera.fov_deg) / 2);
  double aspect = static_cast<double>(width_px) / height_px;
  glm::dvec3 in_camera{(2 * x_px / width_px - 1) * tan_half * aspect, (1 - 2 * y_px / height_px) * tan_half, -1};
  glm::dvec3 direction = worldFromCamera(camera) * in_camera;
  glm::dvec3 eye = eyePosition(camera);
  if (direction.z * eye.z >= 0) return false;
  double t = -eye.z / direction.z;
  *point_mm = eye + direction * t;
  return std::isfinite(t);
}

}  // namespace relievo
