// pose_fixture.h - poses for tests, by formulas of their own: a posed artwork is seen as an unposed one is through the
// camera and the lights that are moved the other way.
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include "src/engine/engine.h"

namespace relievo::test {

inline glm::dmat3 rowsOf(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  return glm::transpose(glm::dmat3(a, b, c));
}
inline double radiansOf(double degrees) { return degrees * std::numbers::pi / 180; }

// The camera's axes in the world, by the angles of camera.h.
inline glm::dmat3 axesOfCamera(double azimuth_deg, double elevation_deg) {
  const double a = radiansOf(azimuth_deg), e = radiansOf(elevation_deg);
  const glm::dmat3 about_y = rowsOf({std::cos(a), 0, std::sin(a)}, {0, 1, 0}, {-std::sin(a), 0, std::cos(a)}),
                   about_x = rowsOf({1, 0, 0}, {0, std::cos(e), std::sin(e)}, {0, -std::sin(e), std::cos(e)});
  return about_y * about_x;
}

// Of a rotation Rz Ry Rx.
inline std::array<double, 3> anglesOf(const glm::dmat3& turn) {
  const auto degrees = [](double radians) { return radians * 180 / std::numbers::pi; };
  return {degrees(std::atan2(turn[1][2], turn[2][2])), degrees(std::asin(std::clamp(-turn[0][2], -1.0, 1.0))),
          degrees(std::atan2(turn[0][1], turn[0][0]))};
}

// A pose under which the artwork is seen by `world` as it is by `own` without one: the two cameras share distance,
// field of view and projection.
struct Counter {
  Pose pose;
  glm::dmat3 turn{1};  // world from artwork
  glm::dvec3 moved{0};
  OrbitCamera world, own;

  Counter(const OrbitCamera& own_camera, double azimuth_deg, double elevation_deg, const glm::dvec3& moved_mm)
      : turn(axesOfCamera(azimuth_deg, elevation_deg) *
             glm::transpose(axesOfCamera(own_camera.azimuth_deg, own_camera.elevation_deg))),
        moved(moved_mm),
        world(own_camera),
        own(own_camera) {
    pose.rotate_deg = anglesOf(turn);
    pose.position_mm = {moved.x, moved.y, moved.z};
    world.azimuth_deg = azimuth_deg;
    world.elevation_deg = elevation_deg;
    world.target_mm = turn * own_camera.target_mm + moved;
  }

  // The scene in the world whose lights are those of `own_scene`. turns_with_camera: those far away are of a scan that
  // is relit.
  Scene inWorld(const Scene& own_scene, bool turns_with_camera) const {
    Scene scene = own_scene;
    scene.pose = pose;
    const auto turned = [&](std::array<double, 3>& way) {
      const glm::dvec3 v = turn * glm::dvec3(way[0], way[1], way[2]);
      way = {v.x, v.y, v.z};
    };
    if (!turns_with_camera) turned(scene.light);
    for (SceneLight& light : scene.lights) {
      if (light.near || !turns_with_camera) turned(light.place);
      for (int c = 0; c < 3 && light.near; ++c) light.place[static_cast<size_t>(c)] += moved[c];
    }
    return scene;
  }
};

// Where a place of the world is in the picture: px from the top left, and the distance from the eye along the line of
// sight (orthographic: from the target, away from the viewer). By no function of camera.h.
inline glm::dvec3 pixelOf(const OrbitCamera& camera, const glm::dvec3& place_mm, int width_px, int height_px) {
  const glm::dmat3 axes = axesOfCamera(camera.azimuth_deg, camera.elevation_deg);
  const glm::dvec3 from_target = glm::transpose(axes) * (place_mm - camera.target_mm);
  const double tangent = std::tan(radiansOf(camera.fov_deg) / 2),
               ahead_mm = (camera.orthographic ? 0 : camera.distance_mm) - from_target.z,
               half_mm = tangent * (camera.orthographic ? camera.distance_mm : ahead_mm);
  return {0.5 * width_px + 0.5 * height_px * from_target.x / half_mm,
          0.5 * height_px - 0.5 * height_px * from_target.y / half_mm, ahead_mm};
}

struct PictureDifference {
  int pixels = 0;      // that show something in either picture
  int different = 0;   // of these: by more than 1/255 in a channel or in alpha
  double largest = 0;  // of 255
};
inline PictureDifference differenceOf(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  PictureDifference d;
  EXPECT_EQ(a.size(), b.size());
  for (size_t i = 0; i + 3 < std::min(a.size(), b.size()); i += 4) {
    if (a[i + 3] == 0 && b[i + 3] == 0) continue;
    ++d.pixels;
    int most = 0;
    for (size_t c = 0; c < 4; ++c) most = std::max(most, std::abs(a[i + c] - b[i + c]));
    d.different += most > 1;
    d.largest = std::max(d.largest, 1.0 * most);
  }
  return d;
}

}  // namespace relievo::test
