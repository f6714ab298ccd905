#include "tools/scene/scene_file.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/engine/effects/soft_shadows.h"
#include "tools/scene/animation_members.h"

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
          tripleMember("target_mm", "What the camera looks at, mm; without a pose from the artwork's origin",
                       -kFarthestMm, kFarthestMm, c.target_mm)};
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
  members.push_back(numberMember("ambient_occlusion",
                                 "Places of the relief that see little of the sky are darker: the strength", 0, 1,
                                 s.ambient_occlusion));
  members.push_back(choiceMember("show", "What is drawn over the picture", std::move(overlays), s.show));
  members.push_back(boolMember("wireframe", "Draw the triangles' edges", s.wireframe));
  return members;
}

// A light as it is written.
struct LightMembers {
  std::optional<std::array<double, 3>> towards, position_mm, color;
  std::optional<double> size_deg, size_mm, intensity, reference_mm;
  std::vector<LightKeyMembers> keys;
};
// Lights while they are read.
struct LightList {
  std::array<LightMembers, kMaxLights> lights;
  size_t count = 0;
};

JsonMember lightsMember(LightList& to) {
  const auto membersOfOne = [&to](size_t i) -> JsonMembers {
    LightMembers& l = to.lights[i];
    JsonMember reference = numberMember("reference_mm",
                                        "Of a near light, the distance at which its intensity is as stated, mm; it "
                                        "falls off with the square of the distance [that of the artwork's middle]",
                                        1e-9, kFarthestMm, l.reference_mm);
    reference.beside = "position_mm";
    JsonMember size = numberMember("size_deg",
                                   "Of a light that is far away, its angular diameter, degrees: with light.shadows how "
                                   "soft these are [0: hard]",
                                   0, kMaxLightSizeDeg, l.size_deg);
    size.beside = "towards";
    JsonMember diameter =
        numberMember("size_mm", "Of a near light, its diameter, mm: with light.shadows how soft these are [0: hard]", 0,
                     kFarthestMm, l.size_mm);
    diameter.beside = "position_mm";
    return {
        tripleMember("towards", "Towards a light that is far away: right, up, to the viewer [0, 0, 1]", -1e9, 1e9,
                     l.towards),
        std::move(size),
        tripleMember("position_mm", "In its place, where a near light is, mm; without a pose from the artwork's origin",
                     -kFarthestMm, kFarthestMm, l.position_mm),
        std::move(diameter),
        std::move(reference),
        numberMember("intensity", "Times this, in linear light [1]", 0, kMaxLightIntensity, l.intensity),
        tripleMember("color", "Red, green, blue of its light, linear [1, 1, 1]", 0, 1, l.color),
        lightKeysMember(l.keys)};
  };
  return objectsMember(
      "lights", "In the place of light.towards: lights that add up in linear light", 1, kMaxLights,
      [&to](size_t count) { to.count = count; }, membersOfOne);
}

// What is wrong with them, beside what their declaration says.
std::string problemOf(const LightList& list, std::optional<double> duration_s) {
  for (size_t i = 0; i < list.count; ++i) {
    const LightMembers& l = list.lights[i];
    const std::string plain = "lights[" + std::to_string(i) + "]", name = "'" + plain + "'";
    if (l.towards && l.position_mm)
      return name + " has both towards (far away) and position_mm (near): leave out one of them";
    if (l.towards && *l.towards == std::array<double, 3>{}) return "the light's direction is zero in " + name;
    if (const auto problem = problemOf(l.keys, plain, l.position_mm.has_value(), duration_s); !problem.empty())
      return problem;
    const auto moves = [](const LightKeyMembers& key) { return key.position_mm.has_value(); };
    if (!l.reference_mm && std::any_of(l.keys.begin(), l.keys.end(), moves))
      return name + " moves and has no reference_mm, the distance at which its intensity is as stated";
  }
  return "";
}

std::vector<SceneLight> lightsOf(const LightList& list) {
  std::vector<SceneLight> lights;
  for (size_t i = 0; i < list.count; ++i) {
    const LightMembers& l = list.lights[i];
    SceneLight light;
    light.near = l.position_mm.has_value();
    light.place = l.position_mm.value_or(l.towards.value_or(light.place));
    light.intensity = l.intensity.value_or(light.intensity);
    light.color = l.color.value_or(light.color);
    light.size_deg = l.size_deg.value_or(light.size_deg);
    light.size_mm = l.size_mm.value_or(light.size_mm);
    light.reference_mm = l.reference_mm.value_or(light.reference_mm);
    lights.push_back(light);
  }
  return lights;
}

Json jsonOf(const SceneLight& light) {
  Json json = {{light.near ? "position_mm" : "towards", light.place}};
  if (!light.near && light.size_deg != 0) json["size_deg"] = light.size_deg;
  if (light.near && light.size_mm != 0) json["size_mm"] = light.size_mm;
  if (light.near && light.reference_mm != 0) json["reference_mm"] = light.reference_mm;
  if (light.intensity != 1) json["intensity"] = light.intensity;
  if (light.color != SceneLight{}.color) json["color"] = light.color;
  return json;
}

// A shading as it is written.
struct ShadingMembers {
  std::optional<std::string> kind, map;
  std::optional<double> full_deg, radius_mm, full_per_mm, low_mm, high_mm;
  std::optional<std::array<double, 3>> up;
};
constexpr std::array kShadingKinds{ReliefShading::Kind::kSlope, ReliefShading::Kind::kCurvature,
                                   ReliefShading::Kind::kDepth};

JsonMember shadingMember(ShadingMembers& to) {
  std::vector<std::string> kinds;
  for (const auto kind : kShadingKinds) kinds.emplace_back(shadingName(kind));
  // No member by itself says what is shown.
  const auto besideKind = [](JsonMember member) {
    member.beside = "kind";
    return member;
  };
  return objectMember(
      "shading", "The relief in the place of colour and light",
      {choiceMember("kind", "What of it", std::move(kinds), to.kind),
       besideKind(choiceMember("map", "Scale of greys or colours that appear even [grey]", {"grey", "color"}, to.map)),
       besideKind(
           numberMember("full_deg", "Slope: the angle at the end of the scale, degrees [60]", 0.01, 90, to.full_deg)),
       besideKind(
           numberMember("radius_mm",
                        "Curvature: of the disc that it is measured within, mm [a hundredth of the shorter side, of "
                        "a scan of the longest]",
                        1e-6, 1e6, to.radius_mm)),
       besideKind(numberMember("full_per_mm",
                               "Curvature: the value at the ends of the scale, 1/mm, above 0 on ridges [0.3 / radius]",
                               1e-9, 1e9, to.full_per_mm)),
       besideKind(numberMember("low_mm", "Depth: height at the beginning of the scale, mm [the artwork's lowest]",
                               -kFarthestMm, kFarthestMm, to.low_mm)),
       besideKind(numberMember("high_mm", "Depth: height at the end of the scale, mm [the artwork's highest]",
                               -kFarthestMm, kFarthestMm, to.high_mm)),
       besideKind(
           tripleMember("up", "Of scans, what slope and depth are measured against [0, 0, 1]", -1e9, 1e9, to.up))});
}

// What is wrong with it, beside what its declaration says.
std::string problemOf(const ShadingMembers& m) {
  if (m.low_mm && m.high_mm && *m.low_mm == *m.high_mm) return "'shading.low_mm' and 'shading.high_mm' are the same";
  if (m.up && *m.up == std::array<double, 3>{}) return "the direction 'shading.up' is zero";
  return "";
}

ReliefShading shadingOf(const ShadingMembers& m) {
  ReliefShading s;
  for (const auto kind : kShadingKinds)
    if (m.kind && *m.kind == shadingName(kind)) s.kind = kind;
  if (m.map && *m.map == "color") s.map = ReliefShading::Map::kColour;
  s.full_deg = m.full_deg.value_or(s.full_deg);
  s.radius_mm = m.radius_mm;
  s.full_per_mm = m.full_per_mm;
  s.low_mm = m.low_mm;
  s.high_mm = m.high_mm;
  s.up = m.up.value_or(s.up);
  return s;
}

Json jsonOf(const ReliefShading& s) {
  Json json = {{"kind", shadingName(s.kind)}};
  const ReliefShading usual;
  if (s.map == ReliefShading::Map::kColour) json["map"] = "color";
  if (s.full_deg != usual.full_deg) json["full_deg"] = s.full_deg;
  if (s.radius_mm) json["radius_mm"] = *s.radius_mm;
  if (s.full_per_mm) json["full_per_mm"] = *s.full_per_mm;
  if (s.low_mm) json["low_mm"] = *s.low_mm;
  if (s.high_mm) json["high_mm"] = *s.high_mm;
  if (s.up != usual.up) json["up"] = s.up;
  return json;
}

// A pose as it is written.
struct PoseMembers {
  std::optional<std::array<double, 3>> position_mm, rotate_deg;
};

JsonMember poseMember(PoseMembers& to) {
  return objectMember(
      "pose", "Where the artwork stands; camera and lights stay",
      {tripleMember("position_mm", "Where its origin is, mm [0, 0, 0]", -kFarthestMm, kFarthestMm, to.position_mm),
       tripleMember("rotate_deg",
                    "It is turned by so much about x, then y, then z, degrees, as build --rotate turns a scan, before "
                    "it is moved; [0, 180, 0] shows its back [0, 0, 0]",
                    -1e6, 1e6, to.rotate_deg)});
}

Pose poseOf(const PoseMembers& m) {
  Pose pose;
  pose.position_mm = m.position_mm.value_or(pose.position_mm);
  pose.rotate_deg = m.rotate_deg.value_or(pose.rotate_deg);
  return pose;
}

Json jsonOf(const Pose& pose) {
  Json json = Json::object();
  if (pose.position_mm != Pose{}.position_mm) json["position_mm"] = pose.position_mm;
  if (pose.turns()) json["rotate_deg"] = pose.rotate_deg;
  return json;
}

// Artworks while they are read.
struct ArtworkList {
  std::array<std::string, kMostArtworks> files;
  std::array<PoseMembers, kMostArtworks> poses;
  size_t count = 0;
};

JsonMember artworksMember(ArtworkList& to) {
  const auto membersOfOne = [&to](size_t i) -> JsonMembers {
    JsonMember file = textMember("file", "Its file, from this file's folder on", to.files[i]);
    file.needed = true;
    return {std::move(file), poseMember(to.poses[i])};
  };
  return objectsMember(
      "artworks", "In the place of artwork and pose: artworks that are seen together", 1, kMostArtworks,
      [&to](size_t count) { to.count = count; }, membersOfOne);
}

// A gloss as it is written.
struct GlossMembers {
  std::optional<double> reflectance, roughness;
};

JsonMember glossMember(GlossMembers& to) {
  JsonMember roughness =
      numberMember("roughness", "From nearly a mirror to as good as matt [0.3]", kLeastRoughness, 1, to.roughness);
  roughness.beside = "reflectance";
  return objectMember(
      "gloss", "Highlights under the lights, simulated beside the artwork's own",
      {numberMember("reflectance", "Of light from straight ahead; varnish: 0.04; 0: no gloss", 0, 1, to.reflectance),
       std::move(roughness)});
}

// What a scene's members are read into before they become the scene's.
struct SceneParts {
  std::string about;
  std::vector<std::optional<double>> values;  // of the effects' parameters
  LightList lights;
  GlossMembers gloss;
  PoseMembers pose;
  ArtworkList artworks;
  ShadingMembers shading;
  std::vector<CameraKeyMembers> path;
  std::optional<double> duration_s;
};

// parts outlive the members.
JsonMembers sceneMembers(SceneFile& s, SceneParts& parts) {
  JsonMember artwork = textMember("artwork", "The artwork's file, from this file's folder on", s.artwork);
  artwork.or_else = "artworks";
  return {textMember("about", "Any text", parts.about),
          std::move(artwork),
          poseMember(parts.pose),
          artworksMember(parts.artworks),
          objectMember("camera", "Where it is seen from", cameraMembers(s.camera)),
          cameraPathMember(parts.path),
          numberMember("duration_s", "How long camera_path and lights with keys take, seconds [to the last key]", 1e-3,
                       kMaxSceneSeconds, parts.duration_s),
          objectMember(
              "light", "A light that is far away",
              {tripleMember("towards", "Towards the light: right, up, to the viewer", -1e9, 1e9, s.light),
               boolMember("fixed", "It stays: coefficients are resolved once a page; of lights the directions stay",
                          s.light_fixed),
               boolMember("shadows", "The relief casts shadows on itself, in each light", s.shadows),
               numberMember("size_deg",
                            "The light's angular diameter, degrees: how soft its shadows are; 0: hard. Of lights each "
                            "has its own",
                            0, kMaxLightSizeDeg, s.light_size_deg)}),
          lightsMember(parts.lights),
          glossMember(parts.gloss),
          shadingMember(parts.shading),
          objectMember("surface", "What of the artwork is shown",
                       {boolMember("relief", "Its heights", s.relief),
                        numberMember("exaggerate", "Heights times this", -1e4, 1e4, s.exaggerate),
                        boolMember("unlit", "Its colour as it is, without a light", s.unlit),
                        boolMember("geomorph", "Vertices slide as levels of detail change", s.geomorph)}),
          objectMember("effects", "What is done to the picture", effectMembers(s, parts.values)),
          objectMember("picture", "What is drawn into",
                       {sizeMember("size_px", "Width and height, px", kMaxScenePicturePx, s.size_px),
                        wholeMember("samples", "Samples a pixel of a still picture", {1, 4, 8}, s.samples),
                        tripleMember("background", "Red, green, blue where the artwork is not", 0, 255, s.background)}),
          objectMember("settings", "What stands between accuracy and time", settingsMembers(s.settings))};
}

// What is shown, and what is wrong with it. A list of one is that one.
std::string takeArtworks(const ArtworkList& list, SceneFile& scene) {
  if (list.count == 0) return scene.artwork.empty() ? "expected a file's name for 'artwork'" : "";
  if (scene.pose.isOn()) return "'pose' is that of 'artwork': each of 'artworks' has its own";
  for (size_t i = 0; i < list.count; ++i) {
    if (list.files[i].empty()) return "expected a file's name for 'artworks[" + std::to_string(i) + "].file'";
    scene.artworks.push_back({list.files[i], poseOf(list.poses[i])});
  }
  if (list.count > 1) return "";
  scene.artwork = scene.artworks[0].file;
  scene.pose = scene.artworks[0].pose;
  scene.artworks.clear();
  return "";
}

// What moves, and what is wrong with it beside the rest of the scene.
std::string takeAnimation(const SceneParts& parts, SceneFile& scene) {
  std::vector<std::vector<LightKeyMembers>> lights;
  for (size_t i = 0; i < parts.lights.count; ++i) lights.push_back(parts.lights.lights[i].keys);
  scene.animation = animationOf(parts.path, lights, parts.duration_s);
  const SceneCamera& c = scene.camera;
  const bool parallel = c.orthographic.value_or(c.mm_per_px.has_value());
  for (const CameraKey& key : scene.animation.camera) {
    if (key.fov_deg && parallel) return "'camera_path' has fov_deg, and the camera is orthographic";
    if (key.mm_per_px && (c.distance_mm || c.fov_deg || (c.orthographic && !*c.orthographic)))
      return "'camera_path' has mm_per_px, an orthographic picture's scale: leave out distance_mm, fov_deg and "
             "orthographic of 'camera'";
    if (key.distance_mm && c.mm_per_px) return "'camera_path' has distance_mm, and 'camera' has mm_per_px in its place";
  }
  return "";
}

}  // namespace

SceneFile::SceneFile() {
  for (const PixelEffect* effect : pixelEffects())
    if (effect->stage == PixelEffect::Stage::kTone) effects.push_back({effect, effect->neutral()});
}

Result<SceneFile> parseScene(const std::string& text, const std::string& name) {
  SceneFile scene;
  SceneParts parts;
  if (auto read = readJsonFile(text, kSceneFormat, sceneMembers(scene, parts), name); !read) return read.error();
  const auto& values = parts.values;
  for (size_t i = 0; i < values.size(); ++i)
    if (values[i]) scene.effects[i / PixelEffect::kMaxParameters].values[i % PixelEffect::kMaxParameters] = *values[i];
  const auto invalid = [&](const std::string& what, const char* hint) {
    return Error{ErrorKind::kInvalidData, name, what, hint, {}};
  };
  scene.pose = poseOf(parts.pose);
  if (const std::string problem = takeArtworks(parts.artworks, scene); !problem.empty()) return invalid(problem, "");
  if (scene.light && *scene.light == std::array<double, 3>{})
    return invalid("the light's direction is zero", "for example [-0.7, 0.4, 0.6]");
  for (const std::string& problem :
       {problemOf(parts.lights, parts.duration_s), problemOf(parts.path, parts.duration_s)})
    if (!problem.empty()) return invalid(problem, kSceneFormat.hint);
  scene.lights = lightsOf(parts.lights);
  if (const std::string problem = problemOf(parts.shading); !problem.empty())
    return invalid(problem, kSceneFormat.hint);
  scene.shading = shadingOf(parts.shading);
  scene.gloss.reflectance = parts.gloss.reflectance.value_or(scene.gloss.reflectance);
  scene.gloss.roughness = parts.gloss.roughness.value_or(scene.gloss.roughness);
  if (scene.light && !scene.lights.empty())
    return invalid("'light.towards' is one light and 'lights' are others", "leave out one of them");
  if (scene.light_size_deg && !scene.lights.empty())
    return invalid("'light.size_deg' is the size of one light and 'lights' are others", "give each of them a size_deg");
  const SceneCamera& c = scene.camera;
  if (const std::string problem = takeAnimation(parts, scene); !problem.empty())
    return invalid(problem, kSceneFormat.hint);
  if (c.mm_per_px && (c.distance_mm || c.fov_deg || (c.orthographic && !*c.orthographic)))
    return invalid("'camera.mm_per_px' is an orthographic picture's scale",
                   "leave out distance_mm, fov_deg and orthographic beside it");
  return scene;
}

Result<SceneFile> readScene(const std::string& path) {
  auto text = readTextFile(path, kMaxSceneBytes);
  if (!text) return text.error();
  auto scene = parseScene(*text, path);
  if (!scene) return scene;
  const auto opened = [&](std::string& file) {
    if (!file.empty()) file = (std::filesystem::path(path).parent_path() / file).string();
  };
  opened(scene->artwork);
  for (SceneArtwork& artwork : scene->artworks) opened(artwork.file);
  return scene;
}

Result<std::string> onlyArtwork(const SceneFile& scene, const std::string& path) {
  if (scene.artworks.empty()) return scene.artwork;
  std::string files;
  for (size_t i = 0; i < scene.artworks.size(); ++i) {
    const auto here = scene.artworks.begin() + static_cast<std::ptrdiff_t>(i);
    const auto same = [&](const SceneArtwork& other) { return other.file == here->file; };
    if (std::none_of(scene.artworks.begin(), here, same)) files += (files.empty() ? "" : ", ") + here->file;
  }
  return Error{ErrorKind::kUsage,
               path,
               "the scene has " + std::to_string(scene.artworks.size()) + " artworks, and this command takes one",
               "give it an artwork: " + files,
               {}};
}

Result<void> takeArtwork(std::string& file) {
  if (!namesScene(file)) return {};
  auto scene = readScene(file);
  if (!scene) return scene.error();
  auto only = onlyArtwork(*scene, file);
  if (!only) return only.error();
  file = *only;
  return {};
}

bool namesScene(const std::string& path) {
  std::string suffix = std::filesystem::path(path).extension().string();
  std::transform(suffix.begin(), suffix.end(), suffix.begin(), [](unsigned char c) { return std::tolower(c); });
  return suffix == ".json";
}

std::string sceneText(const SceneFile& s) {
  Json json = {{"format", kSceneFormat.name}, {"version", kSceneVersion}};
  if (s.artworks.empty()) json["artwork"] = s.artwork;
  for (const SceneArtwork& artwork : s.artworks) {
    Json one = {{"file", artwork.file}};
    if (artwork.pose.isOn()) one["pose"] = jsonOf(artwork.pose);
    json["artworks"].push_back(std::move(one));
  }
  Json camera = Json::object(), light = Json::object(), surface = Json::object(), effects = Json::object(),
       picture = Json::object();
  putKnown(camera, "azimuth_deg", s.camera.azimuth_deg);
  putKnown(camera, "elevation_deg", s.camera.elevation_deg);
  putKnown(camera, "distance_mm", s.camera.distance_mm);
  putKnown(camera, "fov_deg", s.camera.fov_deg);
  putKnown(camera, "mm_per_px", s.camera.mm_per_px);
  putKnown(camera, "orthographic", s.camera.orthographic);
  putKnown(camera, "target_mm", s.camera.target_mm);
  putKnown(light, "towards", s.light);
  putKnown(light, "fixed", s.light_fixed);
  putKnown(light, "shadows", s.shadows);
  putKnown(light, "size_deg", s.light_size_deg);
  putKnown(surface, "relief", s.relief);
  putKnown(surface, "exaggerate", s.exaggerate);
  putKnown(surface, "unlit", s.unlit);
  putKnown(surface, "geomorph", s.geomorph);
  for (const EffectSetting& setting : s.effects)
    for (size_t i = 0; i < PixelEffect::kMaxParameters && !setting.changesNothing(); ++i)
      if (const EffectParameter& p = setting.effect->parameters[i]; !p.name.empty())
        effects[std::string(p.name)] = setting.values[i];
  putKnown(effects, "ambient_occlusion", s.ambient_occlusion);
  putKnown(effects, "show", s.show);
  putKnown(effects, "wireframe", s.wireframe);
  putKnown(picture, "size_px", s.size_px);
  putKnown(picture, "samples", s.samples);
  putKnown(picture, "background", s.background);
  for (auto& [name, object] : {std::pair<const char*, Json&>{"camera", camera},
                               {"light", light},
                               {"surface", surface},
                               {"effects", effects},
                               {"picture", picture}})
    if (!object.empty()) json[name] = object;
  if (s.pose.isOn()) json["pose"] = jsonOf(s.pose);
  for (size_t i = 0; i < s.lights.size(); ++i) {
    Json one = jsonOf(s.lights[i]);
    if (i < s.animation.lights.size())
      for (const LightKey& key : s.animation.lights[i]) one["keys"].push_back(jsonOf(key, s.lights[i].near));
    json["lights"].push_back(std::move(one));
  }
  for (const CameraKey& key : s.animation.camera) json["camera_path"].push_back(jsonOf(key));
  if (s.animation.isOn()) json["duration_s"] = s.animation.duration_s;
  if (s.gloss.isOn()) json["gloss"] = {{"reflectance", s.gloss.reflectance}, {"roughness", s.gloss.roughness}};
  if (s.shading.isOn()) json["shading"] = jsonOf(s.shading);
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
  SceneParts parts;
  return jsonSchema(kSceneFormat, sceneMembers(scene, parts));
}

Result<std::vector<SceneLight>> parseLights(const std::string& text) {
  LightList list;
  if (auto read = readJsonValue(text, lightsMember(list), kSceneFormat.hint); !read) return read.error();
  std::string problem = problemOf(list, {});
  for (const LightMembers& light : list.lights)
    if (!light.keys.empty()) problem = "lights with keys are those of a scene, which has a time";
  if (!problem.empty()) return Error{ErrorKind::kInvalidData, "", problem, kSceneFormat.hint, {}};
  return lightsOf(list);
}

Result<ReliefShading> parseShading(const std::string& text) {
  ShadingMembers members;
  for (const auto kind : kShadingKinds)
    if (text == shadingName(kind)) members.kind = text;
  if (!members.kind)
    if (auto read = readJsonValue(text, shadingMember(members), kSceneFormat.hint); !read) return read.error();
  std::string problem = problemOf(members);
  if (!members.kind) problem = "'shading.kind' is missing";
  if (!problem.empty()) return Error{ErrorKind::kInvalidData, "", problem, kSceneFormat.hint, {}};
  return shadingOf(members);
}

std::string lightText(const SceneLight& light, const glm::dvec3& middle_mm) {
  char text[240];
  const auto& p = light.place;
  if (light.near)
    std::snprintf(text, sizeof text, "near, at %g %g %g mm, intensity %g at %.4g mm, color %g %g %g", p[0], p[1], p[2],
                  light.intensity, placedLight(light, glm::dmat3(1), middle_mm).reference_mm, light.color[0],
                  light.color[1], light.color[2]);
  else
    std::snprintf(text, sizeof text, "far away, towards %g %g %g, intensity %g, color %g %g %g", p[0], p[1], p[2],
                  light.intensity, light.color[0], light.color[1], light.color[2]);
  std::string all = text;
  if (light.isSoft()) {
    std::snprintf(text, sizeof text, light.near ? ", %g mm wide" : ", %g degrees wide",
                  light.near ? light.size_mm : light.size_deg);
    all += text;
  }
  return all;
}

}  // namespace relievo
