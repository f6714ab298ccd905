#include "src/render/camera.h"

#include <algorithm>
#include <cmath>

#include <glm/gtc/matrix_transform.hpp>

namespace relievo {
namespace {

glm::dvec3 cornerOf(const Extent& extent, int corner) {
  const glm::dvec3 &lo = extent.min_mm, &hi = extent.max_mm;
  return {corner & 1 ? hi.x : lo.x, corner & 2 ? hi.y : lo.y, corner & 4 ? hi.z : lo.z};
}

// Heights of the plane that a flat artwork is framed by: 0, unless it lies elsewhere altogether.
double planeHeight(const Extent& extent) {
  return std::clamp(0.0, std::min(extent.min_mm.z, extent.max_mm.z), std::max(extent.min_mm.z, extent.max_mm.z));
}

double tanHalf(const OrbitCamera& camera) { return std::tan(glm::radians(camera.fov_deg) / 2); }

// A place of the picture, -1..1 across and up, on the plane through the target that faces the eye; camera axes, mm.
glm::dvec3 atTarget(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px) {
  const double half_mm = camera.distance_mm * tanHalf(camera), aspect = static_cast<double>(width_px) / height_px;
  return {(2 * x_px / width_px - 1) * half_mm * aspect, (1 - 2 * y_px / height_px) * half_mm, 0};
}

// Near and far, towards the viewer and away from the target: all of the extent between them, or of a flat one what the
// picture shows of the slab that its heights keep to.
void setOrthographicDepth(const Extent& extent, const glm::dvec3& target_mm, const glm::dvec2& half_mm,
                          ViewTransform& view) {
  const glm::dvec3 &right = view.world_from_camera[0], &up = view.world_from_camera[1],
                   &back = view.world_from_camera[2];
  double nearest = -1e300, farthest = 1e300;
  for (int corner = 0; corner < 8; ++corner) {
    const double towards = glm::dot(back, cornerOf(extent, corner) - target_mm);
    nearest = std::max(nearest, towards);
    farthest = std::min(farthest, towards);
  }
  if (extent.flat && std::abs(back.z) > 1e-9) {
    const double aside = std::abs(right.z) * half_mm.x + std::abs(up.z) * half_mm.y;
    const double above = (extent.max_mm.z - target_mm.z) / back.z, below = (extent.min_mm.z - target_mm.z) / back.z;
    nearest = std::min(nearest, std::max(above, below) + aside / std::abs(back.z));
    farthest = std::max(farthest, std::min(above, below) - aside / std::abs(back.z));
    if (nearest < farthest) std::swap(nearest, farthest);  // nothing of it is in view
  }
  const double room = 0.02 * (nearest - farthest) + 0.01 * std::min(half_mm.x, half_mm.y);
  view.near_mm = -nearest - room;
  view.far_mm = -farthest + room;
}

}  // namespace

glm::dmat3 worldFromCamera(const OrbitCamera& camera) {
  double az = glm::radians(camera.azimuth_deg), el = glm::radians(camera.elevation_deg);
  glm::dvec3 back{std::sin(az) * std::cos(el), std::sin(el), std::cos(az) * std::cos(el)};
  glm::dvec3 right{std::cos(az), 0, -std::sin(az)};
  return {right, glm::cross(back, right), back};
}

glm::dvec3 eyePosition(const OrbitCamera& camera) {
  return camera.target_mm + worldFromCamera(camera)[2] * camera.distance_mm;
}

double mmPerPx(const OrbitCamera& camera, int height_px) {
  return 2 * camera.distance_mm * tanHalf(camera) / height_px;
}

double distanceForScale(const OrbitCamera& camera, double mm_per_px, int height_px) {
  return mm_per_px * height_px / (2 * tanHalf(camera));
}

Extent extentOf(const FlatDomain& domain, double min_z_mm, double max_z_mm) {
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

namespace {

// Where a camera stands, in the space of what it looks at.
struct Stand {
  glm::dmat3 world_from_camera{1.0};
  glm::dvec3 target_mm{0}, eye_mm{0};
};

ViewTransform viewFrom(const OrbitCamera& camera, const Stand& stand, const Extent& extent, int width_px,
                       int height_px) {
  ViewTransform view;
  view.world_from_camera = stand.world_from_camera;
  view.orthographic = camera.orthographic;
  const glm::dmat3& world_from_camera = view.world_from_camera;
  const glm::dmat3 camera_from_world = glm::transpose(world_from_camera);
  const double tan_half = tanHalf(camera), aspect = static_cast<double>(width_px) / height_px;
  glm::dmat4 clip_from_camera(0.0);
  if (camera.orthographic) {
    // Coordinates count from the target, amid what is seen: an eye before all of a large artwork would cost digits.
    const double half_mm = camera.distance_mm * tan_half;
    view.eye_mm = stand.target_mm;
    setOrthographicDepth(extent, stand.target_mm, {half_mm * aspect, half_mm}, view);
    clip_from_camera[0][0] = 1 / (half_mm * aspect);
    clip_from_camera[1][1] = 1 / half_mm;
    clip_from_camera[2][2] = -2 / (view.far_mm - view.near_mm);
    clip_from_camera[3][2] = -(view.far_mm + view.near_mm) / (view.far_mm - view.near_mm);
    clip_from_camera[3][3] = 1;
    view.pixels_per_radian = height_px / (2 * half_mm);
  } else {
    view.eye_mm = stand.eye_mm;
    double nearest = 1e300, farthest = 0;
    for (int corner = 0; corner < 8; ++corner) {
      double depth = -(camera_from_world * (cornerOf(extent, corner) - view.eye_mm)).z;
      nearest = std::min(nearest, depth);
      farthest = std::max(farthest, depth);
    }
    // Nothing in view is nearer than the artwork's box, nor (of a flat one) than where the steepest line of sight, one
    // of the picture's corners, meets the plane of the greatest height. An eye within the box gets a thousandth of the
    // distance to the target.
    double steepest = -1e300;
    for (double x : {-1.0, 1.0}) {
      for (double y : {-1.0, 1.0}) {
        glm::dvec3 sight = world_from_camera * glm::dvec3{x * tan_half * aspect, y * tan_half, -1};  // one mm of depth
        steepest = std::max(steepest, -sight.z);
      }
    }
    double above = view.eye_mm.z - extent.max_mm.z;
    double nearest_seen = extent.flat && above > 0 && steepest > 0 ? std::max(nearest, above / steepest) : nearest;
    view.near_mm = std::max(nearest_seen * 0.98, std::max(camera.distance_mm, 1e-6) * 1e-3);
    view.far_mm = std::max(farthest * 1.02, view.near_mm * 2);

    double n = view.near_mm, f = view.far_mm;
    clip_from_camera[0][0] = 1 / (tan_half * aspect);
    clip_from_camera[1][1] = 1 / tan_half;
    clip_from_camera[2][2] = -(f + n) / (f - n);
    clip_from_camera[2][3] = -1;
    clip_from_camera[3][2] = -2 * f * n / (f - n);
    view.pixels_per_radian = height_px / (2 * tan_half);
  }
  view.clip_from_world = clip_from_camera * glm::translate(glm::dmat4(camera_from_world), -view.eye_mm);
  return view;
}

}  // namespace

ViewTransform viewTransform(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px) {
  return viewFrom(camera, {worldFromCamera(camera), camera.target_mm, eyePosition(camera)}, extent, width_px,
                  height_px);
}

ViewTransform viewTransform(const OrbitCamera& camera, const PlacedExtent& placed, int width_px, int height_px) {
  const Pose& pose = placed.pose;
  if (!pose.isOn()) return viewTransform(camera, placed.extent, width_px, height_px);
  return viewFrom(camera,
                  {artworkFromWorld(pose) * worldFromCamera(camera), placeInArtwork(pose, camera.target_mm),
                   placeInArtwork(pose, eyePosition(camera))},
                  placed.extent, width_px, height_px);
}

ViewTransform viewTransform(const OrbitCamera& camera, const FlatDomain& domain, double min_z_mm, double max_z_mm,
                            int width_px, int height_px) {
  return viewTransform(camera, extentOf(domain, min_z_mm, max_z_mm), width_px, height_px);
}

ViewTransform throughOffset(const ViewTransform& view, const glm::dvec2& offset_px, int width_px, int height_px) {
  ViewTransform moved = view;
  if (offset_px == glm::dvec2(0)) return moved;
  // The place moves to the centre: the picture moves the other way, by 2 / size of clip space's x / w or y / w a pixel.
  for (int column = 0; column < 4; ++column) {
    glm::dvec4& c = moved.clip_from_world[column];
    c.x -= 2 * offset_px.x / width_px * c.w;
    c.y += 2 * offset_px.y / height_px * c.w;
  }
  return moved;
}

Extent worldExtent(std::span<const PlacedExtent> placed) {
  if (placed.size() == 1 && !placed[0].pose.isOn()) return placed[0].extent;
  Extent all{.min_mm = glm::dvec3(1e300), .max_mm = glm::dvec3(-1e300), .texel_mm = 1e300};
  for (const PlacedExtent& one : placed) {
    all.flat = all.flat && one.extent.flat && !one.pose.turns() && one.pose.position_mm[2] == 0;
    all.size_known = all.size_known && one.extent.size_known;
    all.texel_mm = std::min(all.texel_mm, one.extent.texel_mm);
    for (int corner = 0; corner < 8; ++corner) {
      const glm::dvec3 place = placeInWorld(one.pose, cornerOf(one.extent, corner));
      all.min_mm = glm::min(all.min_mm, place);
      all.max_mm = glm::max(all.max_mm, place);
    }
  }
  return all;
}

double fitDistance(const OrbitCamera& camera, std::span<const PlacedExtent> placed, int width_px, int height_px) {
  constexpr double kMargin = 1.06;
  const glm::dmat3 camera_from_world = glm::transpose(worldFromCamera(camera));
  auto fit = [&](const Extent& box, const Pose& pose, double margin) {
    const double tan_y = tanHalf(camera) / margin, tan_x = tan_y * static_cast<double>(width_px) / height_px;
    double distance = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const glm::dvec3 p = camera_from_world * (placeInWorld(pose, cornerOf(box, corner)) - camera.target_mm);
      const double towards = camera.orthographic ? 0 : p.z;
      distance = std::max({distance, std::abs(p.x) / tan_x + towards, std::abs(p.y) / tan_y + towards});
    }
    return distance;
  };
  double distance = 0;
  for (const auto& [extent, pose] : placed) {
    if (!extent.flat) {
      distance = std::max(distance, fit(extent, pose, kMargin));
      continue;
    }
    Extent plane = extent;
    plane.min_mm.z = plane.max_mm.z = planeHeight(extent);
    distance = std::max({distance, fit(plane, pose, kMargin), fit(extent, pose, 1)});
  }
  return distance;
}

double fitDistance(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px) {
  const PlacedExtent placed{extent, {}};
  return fitDistance(camera, std::span(&placed, 1), width_px, height_px);
}

double fitDistance(const OrbitCamera& camera, const FlatDomain& domain, int width_px, int height_px) {
  return fitDistance(camera, extentOf(domain), width_px, height_px);
}

glm::dvec2 orthographicSize(const OrbitCamera& camera, std::span<const PlacedExtent> placed) {
  const glm::dmat3 camera_from_world = glm::transpose(worldFromCamera(camera));
  glm::dvec2 half_mm(0);
  for (const auto& [extent, pose] : placed)
    for (int corner = 0; corner < 8; ++corner)
      half_mm = glm::max(
          half_mm,
          glm::abs(glm::dvec2(camera_from_world * (placeInWorld(pose, cornerOf(extent, corner)) - camera.target_mm))));
  return 2.0 * half_mm;
}

glm::dvec2 orthographicSize(const OrbitCamera& camera, const Extent& extent) {
  const PlacedExtent placed{extent, {}};
  return orthographicSize(camera, std::span(&placed, 1));
}

OrbitCamera fitCamera(std::span<const PlacedExtent> placed, int width_px, int height_px, double fov_deg) {
  const auto middleOf = [](const Extent& extent) {
    glm::dvec3 middle = extent.centre();
    if (extent.flat) middle.z = planeHeight(extent);
    return middle;
  };
  OrbitCamera camera;
  camera.fov_deg = fov_deg;
  camera.target_mm =
      placed.size() == 1 ? placeInWorld(placed[0].pose, middleOf(placed[0].extent)) : middleOf(worldExtent(placed));
  camera.distance_mm = fitDistance(camera, placed, width_px, height_px);
  return camera;
}
OrbitCamera fitCamera(const Extent& extent, int width_px, int height_px, double fov_deg) {
  const PlacedExtent placed{extent, {}};
  return fitCamera(std::span(&placed, 1), width_px, height_px, fov_deg);
}
OrbitCamera fitCamera(const FlatDomain& domain, int width_px, int height_px, double fov_deg) {
  return fitCamera(extentOf(domain), width_px, height_px, fov_deg);
}

glm::dvec3 pointAtTarget(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px) {
  return camera.target_mm + worldFromCamera(camera) * atTarget(camera, width_px, height_px, x_px, y_px);
}

bool pointOnPlane(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px,
                  glm::dvec3* point_mm) {
  const glm::dmat3 world_from_camera = worldFromCamera(camera);
  const glm::dvec3 aside = atTarget(camera, width_px, height_px, x_px, y_px), eye = eyePosition(camera);
  const glm::dvec3 from = camera.orthographic ? camera.target_mm + world_from_camera * aside : eye;
  const glm::dvec3 direction =
      world_from_camera *
      (camera.orthographic ? glm::dvec3(0, 0, -1) : aside / camera.distance_mm - glm::dvec3(0, 0, 1));
  if (camera.orthographic ? direction.z == 0 : direction.z * eye.z >= 0) return false;
  const double t = -from.z / direction.z;
  *point_mm = from + direction * t;
  return std::isfinite(t);
}

}  // namespace relievo
