// scene_options.h - the options that render and view share: camera, light, effects and budgets; and their JSON state.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <utility>

#include "src/base/result.h"
#include "src/engine/effect_plan.h"
#include "src/engine/engine.h"
#include "src/render/camera.h"
#include "tools/scene/scene_file.h"

namespace CLI {
class App;
}

namespace relievo {

struct SceneOptions {
  std::optional<double> azimuth, elevation, distance, fov, mm_per_px;
  bool orthographic = false, perspective = false;  // neither: the state's
  std::string scene_file, target, light, lights, state_file, settings_file, shading, show = "none", filter = "exact",
                                                                                     sampling = "auto";
  bool no_relief = false, no_relight = false, unlit = false, wireframe = false, shadows = false;
  double light_size_deg = 0, ambient_occlusion = 0;
  Gloss gloss;
  double exaggerate = 1, error_px = 1, least_cell = 2, detail_bias = 0, page_fade_ms = 0, cache_mib = 256;
  // For what moves; a picture alone is better off without: fewer triangles, and no memory of other views.
  std::string geomorph = "off";
  double hysteresis_percent = 0;
  int workers = 2, anisotropy = 0, samples = 1;

  std::string request_source = "feedback";
  int feedback_scale = 8, feedback_interval = 1;
  std::string upload = "auto", depth = "auto";
  bool prefetch = true;
  ReliefShading scene_shading;               // of the scene's file, where --shading does not say otherwise
  std::vector<SceneLight> scene_lights;      // of the scene's file, where neither --light nor --lights says otherwise
  Pose scene_pose;                           // of the scene's file
  std::vector<SceneArtwork> scene_artworks;  // of the scene's file, where it has several; usually empty
  SceneAnimation animation;                  // of the scene's file, but for what options of the command line hold still
  std::vector<EffectSetting> effects;        // all that have parameters, on or off

  // In groups: camera, light, accuracy, appearance, storage, diagnostics.
  void addTo(CLI::App& command);
  // Where `file`, an input, is a scene: it becomes the scene's artwork, unless it has several, and what else the scene
  // says counts where no option of the command line says it; `size`, of a picture, where it is empty. Empty: it is
  // none. Call it once, before takeSettings().
  Result<std::optional<SceneFile>> takeScene(std::string& file, std::string& size);
  // What --settings says, where no option of the command line says it. Call it once, before the functions below.
  Result<void> takeSettings();
  // After takeScene(), of its `file`: what is shown.
  std::vector<SceneArtwork> artworksOf(const std::string& file) const;
  // These options as a scene, but for the camera and the light. artworks: as the file is to name them.
  SceneFile sceneFile(const std::vector<SceneArtwork>& artworks) const;
  Result<Scene> scene() const;
  // placed: what the camera is to show; not empty.
  Result<OrbitCamera> camera(std::span<const PlacedExtent> placed, int width_px, int height_px) const;
  // The same at a time of the animation. Where neither options nor the scene say how far the eye is, it is so far that
  // all stays in view all the time.
  Result<OrbitCamera> cameraAt(std::span<const PlacedExtent> placed, int width_px, int height_px, double time_s) const;
  // The picture of that camera that holds all of it at mm_per_px, which is given; at most max_side_px wide and high.
  Result<std::pair<int, int>> sizeAtScale(std::span<const PlacedExtent> placed, int max_side_px) const;
  EngineOptions engineOptions() const;

 private:
  void addCamera(CLI::App& command);
  void addLight(CLI::App& command);
  void addAccuracy(CLI::App& command);
  void addAppearance(CLI::App& command);
  void addStorage(CLI::App& command);
  void addDiagnostics(CLI::App& command);
  void addEffects(CLI::App& command);
  bool given(const std::string& option) const;  // on the command line
  // Before the scene's camera and lights are taken: what the command line says holds still.
  void takeAnimation(const SceneFile& scene);
  void takeSettingsOf(const DrawSettings& settings);
  Result<void> checkProjection() const;

  const CLI::App* command_ = nullptr;  // which knows what was given
};

}  // namespace relievo
