#include "tools/scene_options.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "src/base/progress.h"
#include "src/engine/effects/soft_shadows.h"
#include "tools/commands.h"
#include "tools/scene/settings_file.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxStateBytes = 1 << 20;
constexpr std::array kStateKeys{"azimuth_deg",  "elevation_deg", "distance_mm", "fov_deg",
                                "orthographic", "target_mm",     "light"};

Result<nlohmann::ordered_json> readState(const std::string& path) {
  if (path.empty()) return nlohmann::ordered_json::object();
  auto text = readTextFile(path, kMaxStateBytes);
  if (!text) return text.error();
  auto json = parseJson(*text, path);
  if (!json) {
    Error error = json.error();
    error.hint = "see relievo render --help";
    return error;
  }
  if (!json->is_object()) {
    return Error{ErrorKind::kInvalidData,
                 path,
                 "expected a JSON object with the camera and light",
                 "see relievo render --help",
                 {}};
  }
  for (const auto& member : json->items()) {
    const std::string& key = member.key();
    if (std::none_of(kStateKeys.begin(), kStateKeys.end(), [&](const char* known) { return key == known; })) {
      return Error{ErrorKind::kInvalidData,
                   path,
                   "there is no '" + key.substr(0, 40) + "' of a camera or light",
                   "known are azimuth_deg, elevation_deg, distance_mm, fov_deg, orthographic, target_mm and light",
                   {}};
    }
  }
  return json;
}

// A number of the state file where it is given and finite; a named error where it is something else.
Result<void> take(const nlohmann::ordered_json& state, const char* key, const std::string& path, double* value) {
  if (!state.contains(key)) return {};
  if (!state[key].is_number())
    return Error{ErrorKind::kInvalidData, path, std::string("expected a number for '") + key + "'", "", {}};
  *value = state[key].get<double>();
  return {};
}

Result<bool> takeTriple(const nlohmann::ordered_json& state, const char* key, const std::string& path, double* values) {
  if (!state.contains(key)) return false;
  const auto& list = state[key];
  bool good = list.is_array() && list.size() == 3;
  for (size_t i = 0; good && i < 3; ++i) good = list[i].is_number();
  if (!good)
    return Error{ErrorKind::kInvalidData, path, std::string("expected three numbers for '") + key + "'", "", {}};
  for (size_t i = 0; i < 3; ++i) values[i] = list[i].get<double>();
  return true;
}

}  // namespace

void SceneOptions::addTo(CLI::App& c) {
  command_ = &c;
  const std::string before = c.option_defaults()->get_group();
  addCamera(c);
  addLight(c);
  addAccuracy(c);
  addAppearance(c);
  addStorage(c);
  addDiagnostics(c);
  c.option_defaults()->group(before);
}

void SceneOptions::addCamera(CLI::App& c) {
  c.option_defaults()->group("Camera");
  c.add_option("--azimuth", azimuth, "Eye to the right of straight ahead, degrees [0]");
  c.add_option("--elevation", elevation, "Eye above straight ahead, degrees, -89 to 89 [0]");
  c.add_option("--distance", distance, "Eye to target, mm [so that all is in view]");
  c.add_option("--target", target,
               "X,Y,Z that the camera looks at, mm from the artwork's centre (of a scan: from its base mesh's origin; "
               "with poses: in their world) "
               "[its middle]");
  c.add_option("--fov", fov, "Vertical field of view, degrees, 1 to 170; of perspective [35]");
  auto* parallel = c.add_flag(
      "--orthographic", orthographic,
      "Parallel lines of sight: a millimetre is as many pixels wherever it is, so that the picture can be "
      "measured and drawn from; with --distance it shows as much as perspective does of the plane through the target");
  c.add_flag("--perspective", perspective, "Perspective, whatever --state says [on]")->excludes(parallel);
  c.add_option("--mm-per-px", mm_per_px,
               "Scale of an orthographic picture, mm a px, exactly (in a window, as it opens); implies --orthographic "
               "and goes in place of --distance [so that all is in view]");
  c.add_option("--state", state_file,
               "JSON file with azimuth_deg, elevation_deg, distance_mm, fov_deg, orthographic, target_mm, light; "
               "options given beside it win");
}

void SceneOptions::addLight(CLI::App& c) {
  c.option_defaults()->group("Light");
  auto* one = c.add_option("--light", light,
                           "X,Y,Z towards the light: right, up, to the viewer; of a scan it turns with the camera, but "
                           "for --no-relight [0,0,1]");
  c.add_option("--lights", lights,
               "Up to 4 lights in the place of --light, in JSON, as a scene's \"lights\" has them: near "
               "(position_mm) or far away (towards), each with intensity and color; they add up in linear light. "
               "Example: '[{\"towards\":[-1,0,0.3]},{\"position_mm\":[40,0,25],\"color\":[1,0.6,0.3]}]'")
      ->excludes(one);
  c.add_option(
       "--light-size", light_size_deg,
       "Angular diameter of --light, degrees, which makes --shadows soft (the sun: 0.53); of --lights each has a "
       "size_deg, near ones a size_mm. A camera that moves shows hard ones; 0: they are hard")
      ->check(CLI::Range(0.0, kMaxLightSizeDeg))
      ->capture_default_str();
  c.add_flag(
      "--no-relight", no_relight,
      "Fixed light: coefficients are resolved once per page, not per pixel and frame (of --lights the directions "
      "alone are fixed)");
  c.add_flag(
      "--shadows", shadows,
      "The relief casts shadows on itself, up to the border of what is drawn, in each light. Over a PTM they come "
      "beside those that were measured: they are simulated");
  c.add_flag("--unlit", unlit,
             "Colour as it is, without a light: of an image with a height map, which is lit by its relief otherwise, "
             "and of a scan");
}

void SceneOptions::addAccuracy(CLI::App& c) {
  c.option_defaults()->group("Accuracy");
  c.add_option(
      "--settings", settings_file,
      "JSON file of settings that relievo accuracy recommends: of this group, of cache, prefetch and feedback; "
      "options given beside it win");
  c.add_option("--error-px", error_px,
               "Geometric error to aim at on screen, px. Where levels meet it may be twice that, at steps and cracks "
               "more (--least-cell); what it is at "
               "most is in the window's first line and in --stats (predicted_error_px)")
      ->capture_default_str();
  c.add_option("--least-cell", least_cell,
               "No triangles narrower on screen than so many --error-px (at steps half and a quarter of that), so that "
               "they are not too many; "
               "0: as narrow as the error asks for, which keeps it within about twice --error-px for 1.6 to 9 times "
               "the triangles")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  c.add_option("--detail-bias", detail_bias,
               "Texture levels coarser than the pixels ask for: 1 reads a quarter of the texels and blurs over two "
               "pixels; 0 is exact")
      ->check(CLI::Range(0.0, kMaxSceneDetailBias))
      ->capture_default_str();
  c.add_option("--geomorph", geomorph,
               "Vertices slide to their places as levels of detail change, so that nothing pops: on or off; on takes "
               "up to a third more "
               "triangles for the same error")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  c.add_option("--hysteresis", hysteresis_percent,
               "A level of detail stays until it is finer than needed by this much of --error-px, %, so that a "
               "trembling camera "
               "changes nothing; 0 is off; pictures that are rendered or saved know no other view and use none")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  c.add_option("--sampling", sampling,
               "Texels and levels a pixel reads: nearest (one texel), bilinear (four of the nearest level), trilinear "
               "(two levels), anisotropic (several trilinear taps: sharp at grazing angles) or auto (anisotropic where "
               "a scan's patches are stretched, in a window while nothing moves; else trilinear)")
      ->check(CLI::IsMember({"nearest", "bilinear", "trilinear", "anisotropic", "auto"}))
      ->capture_default_str();
  c.add_option("--anisotropy", anisotropy,
               "Taps a pixel at most, with --sampling anisotropic or auto: " + std::to_string(kUsualAnisotropy) +
                   " if not given, " + std::to_string(kMaxAnisotropy) + " where auto is anisotropic")
      ->check(CLI::Range(1, kMaxAnisotropy));
  c.add_option(
       "--samples", samples,
       "Samples a pixel: 1, 4 or 8. A picture of a still camera is drawn so many times, each time seen through "
       "another place of its pixels, and averaged, which smooths borders and silhouettes; a moving camera draws 1")
      ->check(CLI::IsMember({1, 4, 8}))
      ->capture_default_str();
  c.add_option("--filter", filter, "Texture filter: exact (full precision) or fast (the texture unit's)")
      ->check(CLI::IsMember({"exact", "fast"}))
      ->capture_default_str();
}

void SceneOptions::addAppearance(CLI::App& c) {
  c.option_defaults()->group("Appearance");
  c.add_option("--exaggerate", exaggerate, "Multiply heights by this")->capture_default_str();
  c.add_flag("--no-relief", no_relief, "Flat geometry: no relief page is read");
  c.add_option("--shading", shading,
               "The relief in the place of colour and light: slope, curvature (ridges light, valleys dark), depth or "
               "none; or in JSON, as a scene's \"shading\" has it, with the scale. --stats and relievo plan say which "
               "value is which colour. Example: '{\"kind\":\"curvature\",\"radius_mm\":0.4}' [none]");
  c.add_option(
       "--ambient-occlusion", ambient_occlusion,
       "Strength from 0 to 1 by which places of the relief are darker that see little of the sky, such as joints "
       "and letters; from the drawn surface, of any artwork with relief, once the camera stands still; 0 is off")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  c.add_option("--gloss", gloss.reflectance,
               "Highlights of the lights on a glossy surface, simulated beside the artwork's own: the share of light "
               "from straight ahead that it reflects, 0 to 1 (varnish: 0.04); of a PTM by the normals of its relief; "
               "0 is off")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  c.add_option("--roughness", gloss.roughness, "Of --gloss, from nearly a mirror (0.05) to as good as matt (1)")
      ->check(CLI::Range(kLeastRoughness, 1.0))
      ->capture_default_str();
  c.add_option("--page-fade", page_fade_ms, "Blend new pages in over this time, ms; 0 is off")
      ->check(CLI::Range(0.0, 60000.0))
      ->capture_default_str();
  c.add_flag("--wireframe", wireframe, "Draw the triangles' edges");
  addEffects(c);
}

void SceneOptions::addEffects(CLI::App& c) {
  std::vector<std::string> overlays{"none"};
  std::string help = "Drawn over the picture:";
  for (const PixelEffect* effect : pixelEffects()) {
    if (effect->stage == PixelEffect::Stage::kTone) {
      effects.push_back({effect, effect->neutral()});
      continue;
    }
    overlays.emplace_back(effect->name);
    help += " " + std::string(effect->name) + " (" + std::string(effect->help) + "),";
  }
  for (EffectSetting& setting : effects)  // none is added any more: options keep these places
    for (size_t i = 0; i < setting.values.size(); ++i) {
      const EffectParameter& p = setting.effect->parameters[i];
      if (p.name.empty()) continue;
      c.add_option("--" + std::string(p.name), setting.values[i], std::string(p.help))
          ->check(CLI::Range(p.low, p.high))
          ->capture_default_str();
    }
  c.add_option("--show", show, help + " or none")->check(CLI::IsMember(overlays))->capture_default_str();
}

void SceneOptions::addStorage(CLI::App& c) {
  c.option_defaults()->group("Storage");
  c.add_option(
       "--cache-mib", cache_mib,
       "Page cache for all planes together, and the tails of a scan of many patches, MiB; unless it is given, an "
       "artwork that needs more gets that and 64 MiB, up to 1024")
      ->check(CLI::Range(0.1, 65536.0))
      ->capture_default_str();
  c.add_option("--upload", upload,
               "Texture pages on the GPU: rgba8 (decoded), blocks (as packages of --encoding bc1, bc4, bc5 or bc7 hold "
               "them: 2.7 to 8 "
               "times smaller; other packages stay rgba8) or auto (blocks where the GPU samples them, but not with "
               "software OpenGL)")
      ->check(CLI::IsMember({"auto", "rgba8", "blocks"}))
      ->capture_default_str();
  c.add_flag("!--no-prefetch,--prefetch", prefetch,
             "Read what a moving camera is about to want, after what it wants now; of flat artworks [on]");
  c.add_option("--workers", workers, "Threads that decode pages; while a source is slow, up to 64 reads are under way")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
}

void SceneOptions::addDiagnostics(CLI::App& c) {
  c.option_defaults()->group("Diagnostics (advanced)");
  c.add_option(
       "--request-source", request_source,
       "How the texture pages that a view needs are found: feedback (a small picture of requests), geometry (from "
       "the view on the CPU, no pass) or both; of scans always by feedback")
      ->check(CLI::IsMember({"feedback", "geometry", "both"}))
      ->capture_default_str();
  c.add_option("--feedback-scale", feedback_scale,
               "Width and height of the picture over those of the feedback pass, 1 to 16; the pass sees "
               "every pixel once in the square of that many frames")
      ->check(CLI::Range(1, kMaxFeedbackScale))
      ->capture_default_str();
  c.add_option("--feedback-interval", feedback_interval,
               "Frames from one feedback pass to the next: pages of a moving view are asked for that much later")
      ->check(CLI::Range(1, kMaxFeedbackInterval))
      ->capture_default_str();
  c.add_option("--depth", depth,
               "Depth buffer: auto (reversed, 32-bit float, where OpenGL has clip control) or conventional (24-bit), "
               "to compare")
      ->check(CLI::IsMember({"auto", "conventional"}))
      ->capture_default_str();
}

bool SceneOptions::given(const std::string& option) const { return command_ && command_->count(option) > 0; }

void SceneOptions::takeSettingsOf(const DrawSettings& settings) {
  auto take = [&](const char* option, const auto& from, auto& to) {
    if (from && !given(option)) to = *from;
  };
  take("--error-px", settings.error_px, error_px);
  take("--least-cell", settings.least_cell, least_cell);
  take("--detail-bias", settings.detail_bias, detail_bias);
  take("--sampling", settings.sampling, sampling);
  take("--anisotropy", settings.anisotropy, anisotropy);
  take("--filter", settings.filter, filter);
  take("--feedback-scale", settings.feedback_scale, feedback_scale);
  take("--feedback-interval", settings.feedback_interval, feedback_interval);
  take("--prefetch", settings.prefetch, prefetch);
  take("--cache-mib", settings.cache_mib, cache_mib);
}

Result<void> SceneOptions::takeSettings() {
  if (settings_file.empty()) return {};
  auto file = readSettings(settings_file);
  if (!file) return file.error();
  takeSettingsOf(*file);
  return {};
}

void SceneOptions::takeAnimation(const SceneFile& scene) {
  animation = scene.animation;
  const auto hold = [&](bool held, auto member) {
    for (CameraKey& key : animation.camera)
      if (held) (key.*member).reset();
  };
  hold(azimuth.has_value(), &CameraKey::azimuth_deg);
  hold(elevation.has_value(), &CameraKey::elevation_deg);
  hold(!target.empty(), &CameraKey::target_mm);
  hold(fov || orthographic || mm_per_px, &CameraKey::fov_deg);
  hold(distance || mm_per_px, &CameraKey::distance_mm);
  hold(distance || mm_per_px || perspective || fov, &CameraKey::mm_per_px);
  std::erase_if(animation.camera, [](const CameraKey& key) { return key == CameraKey{.time_s = key.time_s}; });
  if (!light.empty() || !lights.empty()) animation.lights.clear();
}

Result<std::optional<SceneFile>> SceneOptions::takeScene(std::string& file, std::string& size) {
  if (!namesScene(file)) return std::optional<SceneFile>();
  if (!state_file.empty())
    return usageError("a scene has a camera and a light of its own", "leave out --state, or name the artwork itself");
  auto read = readScene(file);
  if (!read) return read.error();
  const SceneFile& s = *read;
  takeAnimation(s);
  SceneCamera c = s.camera;
  for (const CameraKey& key : animation.camera)
    if (!c.mm_per_px) c.mm_per_px = key.mm_per_px;  // the path's scale is orthographic, as the camera's is
  const auto take = [](const auto& from, auto& to) {
    if (from && !to) to = from;
  };
  take(c.azimuth_deg, azimuth);
  take(c.elevation_deg, elevation);
  // Options that choose a projection choose it against the scene.
  const bool in_perspective = perspective || fov;
  if (!in_perspective && !mm_per_px && !orthographic) orthographic = c.orthographic.value_or(c.mm_per_px.has_value());
  if (!distance && !mm_per_px) {
    take(c.distance_mm, distance);
    if (!in_perspective) take(c.mm_per_px, mm_per_px);
  }
  if (!orthographic && !mm_per_px) take(c.fov_deg, fov);
  if (target.empty() && c.target_mm) target = tripleText(*c.target_mm);
  if (light.empty() && lights.empty()) {
    if (s.light) light = tripleText(*s.light);
    if (s.light_size_deg && !given("--light-size")) light_size_deg = *s.light_size_deg;
    scene_lights = s.lights;
  }
  if (shading.empty()) scene_shading = s.shading;
  const auto takeFlag = [&](const char* option, const std::optional<bool>& from, bool& to) {
    if (from && !given(option)) to = *from;
  };
  takeFlag("--wireframe", s.wireframe, wireframe);
  takeFlag("--unlit", s.unlit, unlit);
  takeFlag("--shadows", s.shadows, shadows);
  takeFlag("--no-relight", s.light_fixed, no_relight);
  takeFlag("--no-relief", s.relief ? std::optional(!*s.relief) : std::nullopt, no_relief);
  if (s.geomorph && !given("--geomorph")) geomorph = *s.geomorph ? "on" : "off";
  if (s.exaggerate && !given("--exaggerate")) exaggerate = *s.exaggerate;
  if (s.gloss.isOn() && !given("--gloss")) gloss.reflectance = s.gloss.reflectance;
  if (s.gloss.isOn() && !given("--roughness")) gloss.roughness = s.gloss.roughness;
  if (s.ambient_occlusion && !given("--ambient-occlusion")) ambient_occlusion = *s.ambient_occlusion;
  if (s.show && !given("--show")) show = *s.show;
  for (size_t e = 0; e < effects.size(); ++e)
    for (size_t i = 0; i < PixelEffect::kMaxParameters; ++i)
      if (const EffectParameter& p = effects[e].effect->parameters[i];
          !p.name.empty() && !given("--" + std::string(p.name)))
        effects[e].values[i] = s.effects[e].values[i];
  takeSettingsOf(s.settings);
  if (s.samples && !given("--samples")) samples = *s.samples;
  if (s.size_px && size.empty()) size = std::to_string((*s.size_px)[0]) + "x" + std::to_string((*s.size_px)[1]);
  scene_pose = s.pose;
  scene_artworks = s.artworks;
  scene_file = file;
  if (s.artworks.empty()) file = s.artwork;
  return std::optional<SceneFile>(std::move(*read));
}

std::vector<SceneArtwork> SceneOptions::artworksOf(const std::string& file) const {
  return scene_artworks.empty() ? std::vector<SceneArtwork>{{file, scene_pose}} : scene_artworks;
}

SceneFile SceneOptions::sceneFile(const std::vector<SceneArtwork>& artworks) const {
  SceneFile s;
  if (artworks.size() == 1) {
    s.artwork = artworks[0].file;
    s.pose = artworks[0].pose;
  } else {
    s.artworks = artworks;
  }
  if (no_relight) s.light_fixed = true;
  if (no_relief) s.relief = false;
  if (unlit) s.unlit = true;
  if (shadows) s.shadows = true;
  s.gloss = gloss;
  if (ambient_occlusion != 0) s.ambient_occlusion = ambient_occlusion;
  if (geomorph == "on") s.geomorph = true;
  if (exaggerate != 1) s.exaggerate = exaggerate;
  if (samples != 1) s.samples = samples;
  s.effects = effects;
  DrawSettings& to = s.settings;
  const SceneOptions usual;
  const auto put = [](auto& member, const auto& value, const auto& otherwise) {
    if (value != otherwise) member = value;
  };
  put(to.error_px, error_px, usual.error_px);
  put(to.least_cell, least_cell, usual.least_cell);
  put(to.detail_bias, detail_bias, usual.detail_bias);
  put(to.sampling, sampling, usual.sampling);
  put(to.anisotropy, anisotropy, usual.anisotropy);
  put(to.filter, filter, usual.filter);
  put(to.feedback_scale, feedback_scale, usual.feedback_scale);
  put(to.feedback_interval, feedback_interval, usual.feedback_interval);
  put(to.prefetch, prefetch, usual.prefetch);
  put(to.cache_mib, cache_mib, usual.cache_mib);
  return s;
}

Result<Scene> SceneOptions::scene() const {
  Scene s;
  auto state = readState(state_file);
  if (!state) return state.error();
  if (auto t = takeTriple(*state, "light", state_file, s.light.data()); !t) return t.error();
  if (!light.empty()) {
    auto l = parseTriple(light, "--light", "X,Y,Z towards the light: -0.7,0.4,0.6");
    if (!l) return l.error();
    s.light = *l;
  }
  s.light_size_deg = light_size_deg;
  s.lights = scene_lights;
  if (!lights.empty()) {
    auto parsed = parseLights(lights);
    if (!parsed) return usageError("--lights: " + parsed.error().message, parsed.error().hint);
    s.lights = std::move(*parsed);
  }
  if (!s.lights.empty() && given("--light-size"))
    return usageError("--light-size is the size of --light, and there are lights in its place",
                      "give each of them a size_deg");
  if (!s.lights.empty()) s.light = singleLight(s);
  s.shading = scene_shading;
  if (!shading.empty() && shading != "none") {
    auto parsed = parseShading(shading);
    if (!parsed) return usageError("--shading: " + parsed.error().message, parsed.error().hint);
    s.shading = *parsed;
  }
  if (s.light[0] == 0 && s.light[1] == 0 && s.light[2] == 0)
    return usageError("the light's direction is zero", "for example --light -0.7,0.4,0.6");
  if (!std::isfinite(exaggerate) || std::abs(exaggerate) > 1e4)
    return usageError("expected --exaggerate within -10000 to 10000");
  if (!(error_px >= 0) || error_px > 1e4) return usageError("expected --error-px from 0 to 10000 px");
  s.relief = !no_relief;
  s.relight = !no_relight;
  s.unlit = unlit;
  s.shadows = shadows;
  s.gloss = gloss;
  s.ambient_occlusion.strength = ambient_occlusion;
  s.sampling = sampling == "bilinear"      ? Sampling::kBilinear
               : sampling == "nearest"     ? Sampling::kNearest
               : sampling == "anisotropic" ? Sampling::kAnisotropic
               : sampling == "trilinear"   ? Sampling::kTrilinear
                                           : Sampling::kAuto;
  s.anisotropy = anisotropy;
  s.samples = samples;
  s.filter = filter == "fast" ? Filter::kFast : Filter::kExact;
  s.page_fade_s = page_fade_ms / 1000;
  s.exaggerate = exaggerate;
  s.error_px = error_px;
  s.least_cell = least_cell;
  s.detail_bias = detail_bias;
  s.geomorph = geomorph == "on";
  s.hysteresis = hysteresis_percent / 100;
  s.wireframe = wireframe;
  s.effects = effects;
  s.overlay = findEffect(show);
  s.pose = scene_pose;
  return s;
}

Result<void> SceneOptions::checkProjection() const {
  if (mm_per_px && !(*mm_per_px > 0 && std::isfinite(*mm_per_px)))
    return usageError("expected a --mm-per-px above 0", "for example --mm-per-px 0.05");
  if (mm_per_px && perspective)
    return usageError("--mm-per-px is an orthographic picture's scale", "leave out --perspective or --mm-per-px");
  if (mm_per_px && distance)
    return usageError("--mm-per-px and --distance both say how large the artwork is in the picture",
                      "leave out one of them");
  if (fov && (mm_per_px || orthographic)) {
    return usageError("an orthographic picture has no field of view",
                      "leave out --fov; --mm-per-px or --distance says how much is in view");
  }
  return {};
}

Result<OrbitCamera> SceneOptions::camera(std::span<const PlacedExtent> placed, int width_px, int height_px) const {
  if (auto good = checkProjection(); !good) return good.error();
  const bool size_known =
      std::all_of(placed.begin(), placed.end(), [](const PlacedExtent& one) { return one.extent.size_known; });
  if (mm_per_px && !size_known) {
    return usageError("--mm-per-px needs the artwork's size, which its package does not know",
                      "build it with --mm-per-pixel, or give --orthographic with --distance");
  }
  auto state = readState(state_file);
  if (!state) return state.error();
  double fov_deg = 35;
  if (auto r = take(*state, "fov_deg", state_file, &fov_deg); !r) return r.error();
  fov_deg = fov.value_or(fov_deg);
  if (!(fov_deg >= kMinFovDeg && fov_deg <= kMaxFovDeg))
    return usageError("expected a field of view from 1 to 170 degrees", "--fov 35 is a good start");
  OrbitCamera c = fitCamera(placed, width_px, height_px, fov_deg);
  if (state->contains("orthographic")) {
    const auto& parallel = (*state)["orthographic"];
    if (!parallel.is_boolean())
      return Error{ErrorKind::kInvalidData, state_file, "expected true or false for 'orthographic'", "", {}};
    c.orthographic = parallel.get<bool>() && !perspective;
    if (c.orthographic && fov) {
      return usageError("the camera of " + state_file + " is orthographic, which has no field of view",
                        "leave out --fov, or give --perspective, too");
    }
  }
  c.orthographic = c.orthographic || orthographic || mm_per_px;
  if (auto r = take(*state, "azimuth_deg", state_file, &c.azimuth_deg); !r) return r.error();
  if (auto r = take(*state, "elevation_deg", state_file, &c.elevation_deg); !r) return r.error();
  if (auto t = takeTriple(*state, "target_mm", state_file, &c.target_mm.x); !t) return t.error();
  c.azimuth_deg = azimuth.value_or(c.azimuth_deg);
  c.elevation_deg = elevation.value_or(c.elevation_deg);
  if (!target.empty()) {
    auto t = parseTriple(target, "--target", "X,Y,Z in mm: 0,0,0");
    if (!t) return t.error();
    c.target_mm = {(*t)[0], (*t)[1], (*t)[2]};
  }
  if (!std::isfinite(c.azimuth_deg)) return usageError("expected a finite --azimuth in degrees");
  if (!(c.elevation_deg >= -89 && c.elevation_deg <= 89))
    return usageError("expected --elevation from -89 to 89 degrees");
  c.distance_mm = fitDistance(c, placed, width_px, height_px);
  if (auto r = take(*state, "distance_mm", state_file, &c.distance_mm); !r) return r.error();
  c.distance_mm = distance.value_or(c.distance_mm);
  if (mm_per_px) c.distance_mm = distanceForScale(c, *mm_per_px, height_px);
  if (!(c.distance_mm > 0) || !std::isfinite(c.distance_mm)) return usageError("expected a --distance above 0 mm");
  return c;
}

Result<OrbitCamera> SceneOptions::cameraAt(std::span<const PlacedExtent> placed, int width_px, int height_px,
                                           double time_s) const {
  auto base = camera(placed, width_px, height_px);
  const auto says = [](const CameraKey& key) { return key.distance_mm || key.mm_per_px; };
  if (!base || animation.camera.empty()) return base;
  if (!distance && !mm_per_px && std::none_of(animation.camera.begin(), animation.camera.end(), says)) {
    constexpr int kMoments = 256;
    for (int i = 0; i <= kMoments; ++i) {
      const OrbitCamera then = relievo::cameraAt(animation, *base, height_px, animation.duration_s * i / kMoments);
      base->distance_mm = std::max(base->distance_mm, fitDistance(then, placed, width_px, height_px));
    }
  }
  return relievo::cameraAt(animation, *base, height_px, time_s);
}

Result<std::pair<int, int>> SceneOptions::sizeAtScale(std::span<const PlacedExtent> placed, int max_side_px) const {
  auto c = camera(placed, 1, 1);
  if (!c) return c.error();
  // Rounding of what is a whole number of pixels must not add one.
  const glm::dvec2 px = glm::max(glm::ceil(orthographicSize(*c, placed) / *mm_per_px - 1e-6), glm::dvec2(1));
  if (!(std::max(px.x, px.y) <= max_side_px)) {
    char text[120];
    std::snprintf(text, sizeof text, "at %g mm a px all of the artwork is %.0f x %.0f px, at most %d x %d can be drawn",
                  *mm_per_px, px.x, px.y, max_side_px, max_side_px);
    return usageError(text, "give a coarser --mm-per-px, or --size (and --target) for a part of it");
  }
  return std::pair{static_cast<int>(px.x), static_cast<int>(px.y)};
}

EngineOptions SceneOptions::engineOptions() const {
  EngineOptions o;
  const bool chosen = given("--cache-mib") || cache_mib != o.cache_mib;  // or by a scene or settings
  o.cache_mib = cache_mib;
  if (!chosen) o.most_cache_mib = kMostCacheMib;
  o.workers = workers;
  o.feedback_scale = feedback_scale;
  o.feedback_interval = feedback_interval;
  o.request_source = request_source == "geometry" ? RequestSource::kGeometry
                     : request_source == "both"   ? RequestSource::kBoth
                                                  : RequestSource::kFeedback;
  o.upload = *uploadFromName(upload);
  o.reversed_depth = depth == "auto";
  o.prefetch = prefetch;
  o.interrupted = &interruptedFlag();
  return o;
}

}  // namespace relievo
