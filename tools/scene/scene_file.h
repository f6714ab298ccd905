// scene_file.h - a scene as a file: an artwork, how it is seen and lit, and the effects on its picture. Every command
// that takes an artwork takes a scene in its place; relievo view writes one beside each snapshot. JSON:
//
//   {"format": "relievo-scene", "version": 1, "artwork": "inscription.relievo",
//    "camera": {"azimuth_deg": 25, "elevation_deg": 15},
//    "light": {"towards": [-0.8, 0.3, 0.4]}, "effects": {"exposure": 0.5}}
//
// In the place of "towards", "lights" is a list of 1 to kMaxLights lights (src/engine/effects/lights.h):
//
//    "lights": [{"towards": [-1, 0, 0.3], "color": [1, 0.6, 0.3]}, {"position_mm": [40, 0, 25], "intensity": 0.5}]
//
// "shading" shows the relief in the place of colour and light (src/engine/effects/relief_shading.h):
//
//    "shading": {"kind": "curvature", "radius_mm": 0.4}
//
// "camera_path" and "keys" of lights say how camera and lights move (src/engine/scene_animation.h):
//
//    "camera_path": [{"time_s": 0, "azimuth_deg": -30}, {"time_s": 4, "azimuth_deg": 30}]
//
// "pose" says where the artwork stands (src/render/pose.h); without one its own space is the world:
//
//    "pose": {"position_mm": [40, 0, 0], "rotate_deg": [0, 180, 0]}
//
// "artworks" is a list of 1 to kMostArtworks of them, each with its pose, in the place of "artwork" and "pose"
// (src/engine/stage.h):
//
//    "artworks": [{"file": "obverse.relievo"}, {"file": "reverse.relievo", "pose": {"position_mm": [35, 0, 0]}}]
//
// `relievo plan --schema` prints its JSON Schema, which says what every member means. What a scene leaves out is as
// without the option of that name; units are those of the options (relievo render --help). Unknown members, other types
// and values out of range are refused. Safe for untrusted text.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/engine/effect_plan.h"
#include "src/engine/scene_animation.h"
#include "src/engine/stage.h"
#include "src/render/camera.h"
#include "tools/scene/settings_file.h"

namespace relievo {

inline constexpr int kSceneVersion = 1;
inline constexpr int kMaxScenePicturePx = 16384;

struct SceneCamera {
  std::optional<double> azimuth_deg, elevation_deg, distance_mm, fov_deg, mm_per_px;
  std::optional<bool> orthographic;
  std::optional<std::array<double, 3>> target_mm;
  friend bool operator==(const SceneCamera&, const SceneCamera&) = default;
};

struct SceneArtwork {
  std::string file;
  Pose pose;
  friend bool operator==(const SceneArtwork&, const SceneArtwork&) = default;
};

struct SceneFile {
  std::string artwork;  // as it is written: from the scene file's folder on, where it is no absolute path
  Pose pose;            // usually off
  std::vector<SceneArtwork> artworks;  // two or more, in their place; usually empty
  SceneCamera camera;
  SceneAnimation animation;                    // camera and lights that move; usually none
  std::optional<std::array<double, 3>> light;  // towards it; of any length above 0
  std::optional<double> light_size_deg;        // its angular diameter, for shadows
  std::vector<SceneLight> lights;              // in its place; empty: there are none
  Gloss gloss;                                 // usually none
  ReliefShading shading;                       // in the place of colour and light; usually none
  std::optional<bool> light_fixed;             // resolved once a page
  std::optional<bool> shadows;                 // cast by the relief on itself
  std::optional<bool> relief, unlit, wireframe, geomorph;
  std::optional<double> exaggerate;
  std::vector<EffectSetting> effects;       // those of Stage::kTone, in the registry's order
  std::optional<double> ambient_occlusion;  // its strength
  std::optional<std::string> show;          // an overlay's name, or "none"
  std::optional<std::array<int, 2>> size_px;
  std::optional<int> samples;                       // a pixel: 1, 4 or 8
  std::optional<std::array<double, 3>> background;  // 0..255
  DrawSettings settings;

  SceneFile();  // every effect is there, and off
  friend bool operator==(const SceneFile&, const SceneFile&) = default;
};

// name: of the file, for errors (kInvalidData; kUnsupported of newer versions).
Result<SceneFile> parseScene(const std::string& text, const std::string& name);
// Artworks become paths that can be opened.
Result<SceneFile> readScene(const std::string& path);
// The one artwork of a scene, for commands that take no more: kUsage where it has several. path: the scene's.
Result<std::string> onlyArtwork(const SceneFile& scene, const std::string& path);
// Where `file` names a scene, it becomes the scene's only artwork.
Result<void> takeArtwork(std::string& file);
// Does the name say that it is a scene (.json)?
bool namesScene(const std::string& path);
std::string sceneText(const SceneFile& scene);
std::string sceneSchema();
// Lights alone, the text of the member "lights": kInvalidData, naming no file.
Result<std::vector<SceneLight>> parseLights(const std::string& text);
// The text of the member "shading", or the name of its kind alone: kInvalidData, naming no file.
Result<ReliefShading> parseShading(const std::string& text);
// "near, at 40 0 25 mm, intensity 0.5 at 46.9 mm, color 1 1 1", for people.
std::string lightText(const SceneLight& light, const glm::dvec3& middle_mm);

}  // namespace relievo
