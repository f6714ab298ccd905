// relievo view: an artwork in a window.
#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "src/viewer/viewer.h"
#include "texturing/import/image_io.h"
#include "tools/artwork_cache.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/scene_artworks.h"
#include "tools/scene_options.h"
#include "tools/source_options.h"

namespace relievo {
namespace {

constexpr const char* kUsualWindow = "1280x800";

struct ViewOptions {
  std::string file, size, exact_still = "auto";
  SceneOptions scene;
  SourceOptions source;
  ArtworkCache cache;
  ViewerOptions viewer;
};

// What S wrote as a picture. `relievo render` of it draws the same one.
std::string snapshotScene(const ViewOptions& o, const OrbitCamera& camera, const Scene& shown, int width_px,
                          int height_px) {
  std::error_code ignored;
  std::vector<SceneArtwork> artworks = o.scene.artworksOf(o.file);
  for (SceneArtwork& one : artworks)
    one.file = std::filesystem::absolute(one.file, ignored).lexically_normal().string();
  SceneFile s = o.scene.sceneFile(artworks);
  const glm::dvec3& target = camera.target_mm;
  s.camera = {camera.azimuth_deg,
              camera.elevation_deg,
              camera.distance_mm,
              camera.orthographic ? std::nullopt : std::optional(camera.fov_deg),
              {},
              camera.orthographic ? std::optional(true) : std::nullopt,
              std::array{target.x, target.y, target.z}};
  if (!shown.lights.empty()) {
    s.lights = shown.lights;
  } else {
    s.light = shown.light;
    if (shown.light_size_deg != 0) s.light_size_deg = shown.light_size_deg;
  }
  s.ambient_occlusion.reset();
  if (shown.ambient_occlusion.isOn()) s.ambient_occlusion = shown.ambient_occlusion.strength;
  s.shadows.reset();
  if (shown.shadows) s.shadows = true;
  s.gloss = shown.gloss;
  s.shading = shown.shading;
  if (shown.wireframe) s.wireframe = true;
  if (shown.overlay) s.show = std::string(shown.overlay->name);
  s.settings.least_cell = shown.least_cell;
  s.size_px = {width_px, height_px};
  const auto& b = o.viewer.background;
  s.background = {static_cast<double>(b[0]), static_cast<double>(b[1]), static_cast<double>(b[2])};
  return sceneText(s);
}

Result<void> view(ViewOptions& o) {
  auto file = o.scene.takeScene(o.file, o.size);
  if (!file) return file.error();
  if (*file && (*file)->background)
    for (size_t c = 0; c < 3; ++c) o.viewer.background[c] = static_cast<uint8_t>((*(*file)->background)[c]);
  auto size = parseSize(o.size.empty() ? kUsualWindow : o.size);
  if (!size) return size.error();
  if (size->first > 16384 || size->second > 16384)
    return usageError("expected a --size of at most 16384x16384 px, found " + o.size);
  if (auto taken = o.scene.takeSettings(); !taken) return taken;
  auto scene = o.scene.scene();
  if (!scene) return scene.error();
  std::vector<NamedFile> inputs = inputsOf(o.scene.artworksOf(o.file));
  inputs.push_back({"the scene", o.scene.scene_file});
  inputs.push_back({"--state", o.scene.state_file});
  inputs.push_back({"--settings", o.scene.settings_file});
  if (auto good = checkOutputs({{"--snapshot", o.viewer.snapshot_file, Content::kPicture}}, inputs); !good) return good;
  if (auto format = imageFormatOf(o.viewer.snapshot_file); !o.viewer.snapshot_file.empty() && !format)
    return format.error();
  auto artworks = openArtworks(o.scene.artworksOf(o.file), o.cache);
  if (!artworks) return artworks.error();
  if (auto good = checkApart({{"--snapshot", o.viewer.snapshot_file}}, namedInputsOf(*artworks)); !good) return good;
  const std::filesystem::path path(o.file);
  o.viewer.title = path.filename().string() + " - Relievo";
  o.viewer.snapshot_stem = path.stem().string();
  o.viewer.width_px = static_cast<int>(size->first);
  o.viewer.height_px = static_cast<int>(size->second);
  o.viewer.animation = o.scene.animation;
  o.viewer.scene = sceneAt(o.viewer.animation, *scene, 0);
  using ExactStill = ViewerOptions::ExactStill;
  o.viewer.exact_still = o.exact_still == "on"    ? ExactStill::kOn
                         : o.exact_still == "off" ? ExactStill::kOff
                                                  : ExactStill::kAuto;
  o.viewer.engine = o.scene.engineOptions();
  o.viewer.camera = [&](std::span<const PlacedExtent> placed, int width_px, int height_px) {
    return o.scene.cameraAt(placed, width_px, height_px, 0);
  };
  o.viewer.scene_text = [&](const OrbitCamera& camera, const Scene& shown, int width_px, int height_px) {
    return snapshotScene(o, camera, shown, width_px, height_px);
  };
  return runViewer(artworks->staged([&](const auto& package) { return o.source.artwork(package); }), o.viewer);
}

}  // namespace

void addViewCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<ViewOptions>();
  auto* c = app.add_subcommand("view", "Show an artwork in a window");
  c->footer(
      "Left drag turns about the point under the mouse, middle drag (or Shift + left drag) moves it, the wheel zooms "
      "to it; the eye\nstays outside of the artwork. Right drag (or L held) moves the light, of several the first that "
      "is far away; N the next.\nO goes over to an orthographic view and back, R resets, Space plays or pauses a scene "
      "that moves.\nM shows slope, curvature and depth of the relief in turn; H shadows, A ambient occlusion, G gloss, "
      "W "
      "wireframe, P pages.\nS writes a snapshot and its scene into the current folder, F1 help, F2 figures, Esc quits. "
      "Without a display, use relievo render.\n\n"
      "Example:\n  relievo view inscription.relievo --light -0.8,0.3,0.4");
  c->add_option("FILE", o->file,
                "Artwork to show: a package, a .ptm, an image or a scan (.ply, .obj, .stl, .off, .glb, .gltf); what is "
                "no package "
                "is built into one and kept (--cache-dir); or a scene (.json), such as S writes beside each snapshot; "
                "options given "
                "beside it win")
      ->required();
  c->add_option("--size", o->size, std::string("Window, WIDTHxHEIGHT in px [") + kUsualWindow + "]");
  o->scene.geomorph = "on";
  o->scene.hysteresis_percent = 10;
  o->scene.addTo(*c);
  o->source.addTo(*c);
  o->cache.addTo(*c);
  c->add_option("--exact-still", o->exact_still,
                "As --least-cell 0 while the camera stands still: on, off, or auto (on, but not with software OpenGL)")
      ->check(CLI::IsMember({"auto", "on", "off"}))
      ->capture_default_str();
  c->add_option(
       "--frame-ms", o->viewer.frame_ms,
       "Hold a moving frame at about this time, ms, by giving up accuracy where that is cheapest: sampling, then "
       "geometry, then resolution; the first line says which. A still camera gets all of it back; 0 never gives up any")
      ->check(CLI::Range(0.0, 10000.0))
      ->capture_default_str();
  c->add_flag("--print-view", o->viewer.print_view, "On leaving, print camera and light as JSON, for --state");
  // For tests.
  c->add_option("--frames", o->viewer.frames, "")->group("");
  c->add_option("--snapshot", o->viewer.snapshot_file, "")->group("");
  c->callback([o, &context] {
    if (auto done = view(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
