// viewer.h - artworks in a window: the stage, the controls (view_control.h) and the head-up display (hud.h).
// Redraws while something changes or loads, then until the picture has all of Scene::samples; otherwise sleeps until
// the next event.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/engine/scene_animation.h"
#include "src/engine/stage.h"
#include "src/render/camera.h"
#include "src/render/picture_target.h"

namespace relievo {

struct ViewerOptions {
  std::string title = "Relievo";
  // S writes STEM-0001.png, the first free number, into the current folder, and beside it STEM-0001.json with
  // scene_text, if there is one.
  std::string snapshot_stem = "snapshot";
  std::function<std::string(const OrbitCamera&, const Scene&, int width_px, int height_px)> scene_text;
  int width_px = 1280, height_px = 800;
  std::array<uint8_t, 3> background = kPictureGrey;
  Scene scene;
  // What of it moves by itself, over and over, from the beginning on; usually nothing.
  SceneAnimation animation;
  EngineOptions engine;
  // The view to start with, for the size that the window got: that of the animation's beginning.
  std::function<Result<OrbitCamera>(std::span<const PlacedExtent>, int width_px, int height_px)> camera;
  // Whether a camera that stands still is drawn with Scene::least_cell 0. kAuto: not with software OpenGL, where the
  // next motion would begin with a slow frame, nor where `frames` is set.
  enum class ExactStill { kAuto, kOn, kOff };
  ExactStill exact_still = ExactStill::kAuto;
  // While the camera moves, accuracy is given up so that a frame takes at most about so long (frame_time_control.h); 0:
  // it never is.
  double frame_ms = 0;
  // For tests: after so many frames (0: never) the viewer writes snapshot_file, if it is named, and ends.
  int64_t frames = 0;
  std::string snapshot_file;
  bool print_view = false;  // when the window is closed, camera and light are printed as JSON on standard output
};

// Returns when the window is closed.
Result<void> runViewer(std::vector<StagedArtwork> artworks, const ViewerOptions& options);

// FOLDER/STEM-0001.png, or the first number of which neither it nor the .json is there; empty when there is none below
// 10,000.
std::string freeSnapshotName(const std::string& folder, const std::string& stem);

}  // namespace relievo
