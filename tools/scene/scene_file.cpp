#include "tools/scene/scene_file.h"

#include <algorithm>
#include <filesystem>

#include <nlohmann/json.hpp>

#include "src/base/file.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint64_t kMaxSceneBytes = 1 << 20;
constexpr double kFarthestMm = 1e12;
constexpr JsonFormat kSceneFormat{"relievo-scene", "scene", kSceneVersion,
                                  "relievo plan --schema prints what a scene may say", "use a newer relievo"};

JsonMembers cameraMembers(SceneCamera& c) {
  return {numberMember("azimuth_deg", "Eye to the right of straight ahead, degrees", -1e6, 1e6, c.azimuth_deg),
          numberMember("elevation_deg", "Eye above straight ahead, degrees", -89, 89, c.elevation_deg),
          numberMember("distance_mm", "Eye to target, mm; without it all is in view", 1e-9, kFarthestMm, c.distance_mm),
          numberMember("fov_deg", "Vertical field of view, degrees; of perspective", kMinFovDeg, kMaxFovDeg, c.fov_deg),
          numberMember("mm_per_px", "Scale of an orthographic picture, mm a px, in place of distance_mm", 1e-12, 1e9,
                       c.mm_per_px),
          boolMember("orthographic", "Parallel lines of sight", c.orthographic),
          tripleMember("target_mm", "What the camera looks at, mm from the artwork's origin", -kFarthestMm, kFarthestMm,
                       c.target_mm)};
}

JsonMembers effectMembers(SceneFile& s, std::vector<std::optional<double>>& values) {
  JsonMembers members;
  values.resize(s.effects.size() * PixelEffect::kMaxParameters);
  for (size_t e = 0; e < s.effects.size(); ++e)
    for (size_t i = 0; i < PixelEffect::kMaxParameters; ++i) {
      const EffectParameter& p = s.effects[e].effect->parameters[i];
      if (p.name.empty()) continue;
      members.push_back(numberMember(std::string(p.name).c_str(), std::string(p.help).c_str(), p.low, p.high,
                                     values[e * PixelEffect::kMaxParameters + i]));
    }
  std::vector<std::string> overlays{"none"};
  for (const PixelEffect* effect : pixelEffects())
    if (effect->stage == PixelEffect::Stage::kOverlay) overlays.emplace_back(effect->name);
  members.push_back(choiceMember("show", "What is drawn over the picture", std::move(overlays), s.show));
  members.push_back(boolMember("wireframe", "Draw the triangles' edges", s.wireframe));
  return members;
}

// values: of the effects' parameters, which outlive the members.
JsonMembers sceneMembers(SceneFile& s, std::string& about, std::vector<std::optional<double>>& values) {
  JsonMember artwork = textMember("artwork", "The artwork's file, from this file's folder on", s.artwork);
  artwork.needed = true;
  return {textMember("about", "Any text", about),
          std::move(artwork),
          objectMember("camera", "Where it is seen from", cameraMembers(s.camera)),
          objectMember("light", "A light that is far away",
                       {tripleMember("towards", "Towards the light: right, up, to the viewer", -1e9, 1e9, s.light),
                        boolMember("fixed", "It stays: coefficients are resolved once a page", s.light_fixed),
                        boolMember("shadows", "The relief casts shadows on itself", s.shadows)}),
          objectMember("surface", "What of the artwork is shown",
                       {boolMember("relief", "Its heights", s.relief),
                        numberMember("exaggerate", "Heights times this", -1e4, 1e4, s.exaggerate),
                        boolMember("unlit", "Its colour as it is, without a light", s.unlit),
                        boolMember("geomorph", "Vertices slide as levels of detail change", s.geomorph)}),
          objectMember("effects", "What is done to the picture", effectMembers(s, values)),
          objectMember("picture", "What is drawn into",
                       {sizeMember("size_px", "Width and height, px", kMaxScenePicturePx, s.size_px),
                        wholeMember("samples", "Samples a pixel of a still picture", {1, 4, 8}, s.samples),
                        tripleMember("background", "Red, green, blue where the artwork is not", 0, 255, s.background)}),
          objectMember("settings", "What stands between accuracy and time", settingsMembers(s.settings))};
}

}  // namespace

SceneFile::SceneFile() {
  for (const PixelEffect* effect : pixelEffects())
    if (effect->stage == PixelEffect::Stage::kTone) effects.push_back({effect, effect->neutral()});
}

Result<SceneFile> parseScene(const std::string& text, const std::string& name) {
  SceneFile scene;
  std::string about;
  std::vector<std::optional<double>> values;
  if (auto read = readJsonFile(text, kSceneFormat, sceneMembers(scene, about, values), name); !read)
    return read.error();
  for (size_t i = 0; i < values.size(); ++i)
    if (values[i]) scene.effects[i / PixelEffect::kMaxParameters].values[i % PixelEffect::kMaxParameters] = *values[i];
  const auto invalid = [&](const char* what, const char* hint) {
    return Error{ErrorKind::kInvalidData, name, what, hint, {}};
  };
  if (scene.artwork.empty()) return invalid("expected a file's name for 'artwork'", "");
  if (scene.light && *scene.light == std::array<double, 3>{})
    return invalid("the light's direction is zero", "for example [-0.7, 0.4, 0.6]");
  const SceneCamera& c = scene.camera;
  if (c.mm_per_px && (c.distance_mm || c.fov_deg || (c.orthographic && !*c.orthographic)))
    return invalid("'camera.mm_per_px' is an orthographic picture's scale",
                   "leave out distance_mm, fov_deg and orthographic beside it");
  return scene;
}

Result<SceneFile> readScene(const std::string& path) {
  auto text = readTextFile(path, kMaxSceneBytes);
  if (!text) return text.error();
  auto scene = parseScene(*text, path);
  if (scene) scene->artwork = (std::filesystem::path(path).parent_path() / scene->artwork).string();
  return scene;
}

Result<void> takeArtwork(std::string& file) {
  if (!namesScene(file)) return {};
  auto scene = readScene(file);
  if (!scene) return scene.error();
  file = scene->artwork;
  return {};
}

bool namesScene(const std::string& path) {
  std::string suffix = std::filesystem::path(path).extension().string();
  std::transform(suffix.begin(), suffix.end(), suffix.begin(), [](unsigned char c) { return std::tolower(c); });
  return suffix == ".json";
}

std::string sceneText(const SceneFile& s) {
  Json json = {{"format", kSceneFormat.name}, {"version", kSceneVersion}, {"artwork", s.artwork}};
  const auto put = [](Json& to, const char* name, const auto& value) {
    if (value) to[name] = *value;
  };
  Json camera = Json::object(), light = Json::object(), surface = Json::object(), effects = Json::object(),
       picture = Json::object();
  put(camera, "azimuth_deg", s.camera.azimuth_deg);
  put(camera, "elevation_deg", s.camera.elevation_deg);
  put(camera, "distance_mm", s.camera.distance_mm);
  put(camera, "fov_deg", s.camera.fov_deg);
  put(camera, "mm_per_px", s.camera.mm_per_px);
  put(camera, "orthographic", s.camera.orthographic);
  put(camera, "target_mm", s.camera.target_mm);
  put(light, "towards", s.light);
  put(light, "fixed", s.light_fixed);
  put(light, "shadows", s.shadows);
  put(surface, "relief", s.relief);
  put(surface, "exaggerate", s.exaggerate);
  put(surface, "unlit", s.unlit);
  put(surface, "geomorph", s.geomorph);
  for (const EffectSetting& setting : s.effects)
    for (size_t i = 0; i < PixelEffect::kMaxParameters && !setting.changesNothing(); ++i)
      if (const EffectParameter& p = setting.effect->parameters[i]; !p.name.empty())
        effects[std::string(p.name)] = setting.values[i];
  put(effects, "show", s.show);
  put(effects, "wireframe", s.wireframe);
  put(picture, "size_px", s.size_px);
  put(picture, "samples", s.samples);
  put(picture, "background", s.background);
  for (auto& [name, object] : {std::pair<const char*, Json&>{"camera", camera},
                               {"light", light},
                               {"surface", surface},
                               {"effects", effects},
                               {"picture", picture}})
    if (!object.empty()) json[name] = object;
  if (!(s.settings == DrawSettings{})) {
    Json settings = Json::parse(settingsText(s.settings, ""));
    settings.erase("format");
    settings.erase("version");
    json["settings"] = std::move(settings);
  }
  return json.dump(2) + "\n";
}

std::string sceneSchema() {
  SceneFile scene;
  std::string about;
  std::vector<std::optional<double>> values;
  return jsonSchema(kSceneFormat, sceneMembers(scene, about, values));
}

}  // namespace relievo
