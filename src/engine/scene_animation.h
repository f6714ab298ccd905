// scene_animation.h - a scene that moves: a camera path and lights with keys, and the scene and camera of a moment.
//
// A key states some values at a time; a value that it leaves out passes through it, and one that no key states stays as
// the scene has it. At a key's time its values are exact, before the first and after the last they stay. Between keys
// - numbers follow monotone cubics (src/base/monotone_cubic.h): their speed is continuous, and they never leave the
//   range of the two keys beside them, so that what is valid at the keys is valid between them. Between two keys alone
//   they are straight lines. Distance and scale do so by their logarithm, so that a zoom appears even.
// - directions of lights follow the sphere: cubic Bezier curves by spherical interpolation (Shoemake 1985, Animating
//   Rotation with Quaternion Curves), whose speed is continuous, too; two keys alone are a great circle at one speed.
// - from one key to the next the azimuth goes the shorter way around where it changes by more than 180 degrees and less
//   than a whole turn, so that keys within -180..180 never turn back at that border. 0 to 360 is a whole turn.
//
// Pure; double precision.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "src/engine/effect_plan.h"
#include "src/render/camera.h"

namespace relievo {

struct CameraKey {
  double time_s = 0;
  std::optional<double> azimuth_deg, elevation_deg, distance_mm, fov_deg, mm_per_px;  // not both of distance and scale
  std::optional<std::array<double, 3>> target_mm;
  friend bool operator==(const CameraKey&, const CameraKey&) = default;
};
struct LightKey {
  double time_s = 0;
  std::optional<std::array<double, 3>> place;  // SceneLight::place
  std::optional<double> intensity;
  std::optional<std::array<double, 3>> color;
  friend bool operator==(const LightKey&, const LightKey&) = default;
};
struct SceneAnimation {
  double duration_s = 0;  // 0: nothing moves. Keys lie within 0..duration_s, one after the other
  std::vector<CameraKey> camera;
  std::vector<std::vector<LightKey>> lights;  // of Scene::lights, in their order; those that have none stay
  bool isOn() const { return duration_s > 0; }
  friend bool operator==(const SceneAnimation&, const SceneAnimation&) = default;
};

// base: of the scene, for what no key states. height_px: of the picture, for mm_per_px.
OrbitCamera cameraAt(const SceneAnimation& animation, const OrbitCamera& base, int height_px, double time_s);
// The scene with its lights as they are then.
Scene sceneAt(const SceneAnimation& animation, const Scene& scene, double time_s);
// Two directions that are (nearly) opposite: no way from one to the other is the shortest.
bool areOpposite(const std::array<double, 3>& a, const std::array<double, 3>& b);

}  // namespace relievo
