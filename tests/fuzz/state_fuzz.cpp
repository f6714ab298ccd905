// A view's state as `--state` reads it, settings as `--settings` does, and scenes.
#include "tests/fuzz/fuzz_file.h"
#include "tools/commands.h"
#include "tools/scene/settings_file.h"
#include "tools/scene_options.h"

// Of relievo.cpp, which has a main() of its own. No option is given here, so that none is parsed.
namespace relievo {
Error usageError(const std::string& message, const std::string& hint) {
  return {ErrorKind::kUsage, "", message, hint, {}};
}
Result<std::array<double, 3>> parseTriple(const std::string&, const char* option, const char*) {
  return usageError(option);
}
std::string tripleText(const std::array<double, 3>&) { return ""; }
}  // namespace relievo

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  SceneOptions options;
  options.state_file = fuzz::folder().put("state.json", {data, size});
  if (auto scene = options.scene(); !scene) fuzz::requireExplained(scene.error());
  const Extent extent{.min_mm = glm::dvec3(-50, -30, -1), .max_mm = glm::dvec3(50, 30, 2)};
  const PlacedExtent placed{extent, {}};
  auto camera = options.camera(std::span(&placed, 1), 640, 480);
  if (!camera) fuzz::requireExplained(camera.error());
  else fuzz::require(camera->distance_mm > 0, "a camera at no distance");
  if (auto settings = readSettings(fuzz::folder().put("settings.json", {data, size})); !settings)
    fuzz::requireExplained(settings.error());
  if (auto scene = parseScene({reinterpret_cast<const char*>(data), size}, "scene.json"); !scene) {
    fuzz::requireExplained(scene.error());
  } else {
    auto again = parseScene(sceneText(*scene), "scene.json");
    fuzz::require(again && *again == *scene, "a scene comes back otherwise");
  }
  return 0;
}
