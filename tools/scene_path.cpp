#include "tools/scene_path.h"

#include <algorithm>
#include <array>

#include "src/engine/engine.h"
#include "tools/commands.h"
#include "tools/scene/scene_file.h"
#include "tools/scene_options.h"

namespace relievo {

Result<bool> hasCameraPath(const std::string& scene_file) {
  auto scene = readScene(scene_file);
  if (!scene) return scene.error();
  return !scene->animation.camera.empty();
}

Result<std::vector<CompareCamera>> scenePath(const std::string& scene_file, const Manifest& artwork, int frames,
                                             int width_px, int height_px) {
  constexpr double kFrame_s = 1.0 / 60;
  SceneOptions options;
  std::string file = scene_file, size;
  auto scene = options.takeScene(file, size);
  if (!scene) return scene.error();
  if (!*scene || (*scene)->animation.camera.empty())
    return usageError(scene_file + " has no \"camera_path\"", "give it one, or another --path");
  if ((*scene)->pose.isOn())
    return usageError("geometry is compared of an artwork as it is, and the scene has a pose",
                      "leave out its \"pose\", or give another --path");
  const std::array<PlacedExtent, 1> placed{PlacedExtent{artworkExtent(artwork), {}}};
  std::vector<CompareCamera> out;
  for (int k = 0; k < frames; ++k) {
    const double time_s = options.animation.duration_s * (k + 0.5) / frames;
    auto now = options.cameraAt(placed, width_px, height_px, time_s);
    if (!now) return now.error();
    auto before = options.cameraAt(placed, width_px, height_px, std::max(0.0, time_s - kFrame_s));
    if (!before) return before.error();
    out.push_back({*now, *before});
  }
  return out;
}

}  // namespace relievo
