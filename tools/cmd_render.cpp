// relievo render: a picture of an artwork, without a window.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <memory>
#include <span>
#include <tuple>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/heap.h"
#include "src/base/progress.h"
#include "src/engine/engine.h"
#include "src/gl/context.h"
#include "src/render/over_background.h"
#include "texturing/import/image_io.h"
#include "tools/artwork_cache.h"
#include "tools/commands.h"
#include "tools/frame_timing.h"
#include "tools/output_files.h"
#include "tools/scene_options.h"
#include "tools/source_options.h"

namespace relievo {
namespace {

std::string usualBackground() {
  return tripleText({1.0 * kPictureGrey[0], 1.0 * kPictureGrey[1], 1.0 * kPictureGrey[2]});
}
constexpr int64_t kMaxSidePx = 16384;  // of a GL framebuffer, on the software driver too

struct RenderOptions {
  std::string file, output, size, stats_file, background;
  bool settle = true, allow_damage = false;
  int frames = 0;
  double timeout_s = 120;
  SceneOptions scene;
  SourceOptions source;
  ArtworkCache cache;
};

// A picture in which stand-ins are drawn where pages are damaged or cannot be read.
Error drawnWithout(const PageFailures& failures, const EngineStats& stats, const std::string& file) {
  uint64_t wanted = failures.pages;
  for (uint64_t resident : stats.streamer.pages[static_cast<size_t>(PageState::kResident)]) wanted += resident;
  return {failures.unreadable > 0 ? ErrorKind::kIo : ErrorKind::kInvalidData,
          file,
          std::to_string(failures.pages) + " of " + std::to_string(wanted) +
              " pages that the picture needs could not be read; the first: " + failures.first,
          "relievo verify names them all; --allow-damage draws stand-ins in their place",
          {}};
}

// A camera that moves has its geometry drawn, a still one is only shaded.
struct FrameTimes {
  std::vector<double> moving, still;  // ms
};
FrameTimes timeFrames(Engine& engine, const OrbitCamera& camera, int frames) {
  FrameTimes ms;
  ms.moving = movingFramesMs(engine, camera, frames);
  for (int i = 0; i < 3 && frames > 0; ++i) timedFrameMs(engine);  // the last move's list arrives
  for (int i = 0; i < frames && !interruptedFlag(); ++i) ms.still.push_back(timedFrameMs(engine));
  return ms;
}

// The size of the picture, px, and the camera that it is seen with.
struct Sight {
  int width = 0, height = 0;
  OrbitCamera camera;
};
Result<Sight> sightOf(const RenderOptions& o, const Extent& extent, std::pair<int64_t, int64_t> size) {
  Sight sight{static_cast<int>(size.first), static_cast<int>(size.second), {}};
  if (o.scene.mm_per_px && o.size.empty()) {
    auto all = o.scene.sizeAtScale(extent, extent, static_cast<int>(kMaxSidePx));
    if (!all) return all.error();
    std::tie(sight.width, sight.height) = *all;
  }
  auto camera = o.scene.camera(extent, sight.width, sight.height);
  if (!camera) return camera.error();
  sight.camera = *camera;
  return sight;
}

// Artwork and outputs, none of which may take another's place.
Result<OpenedArtwork> openApart(const RenderOptions& o) {
  if (auto good = checkOutputs({{"-o", o.output, Content::kPicture}, {"--stats", o.stats_file}},
                               {{"FILE", o.file},
                                {"the scene", o.scene.scene_file},
                                {"--state", o.scene.state_file},
                                {"--settings", o.scene.settings_file}});
      !good)
    return good.error();
  if (auto format = imageFormatOf(o.output); !format) return format.error();
  auto artwork = openArtwork(o.file, o.cache);
  if (!artwork) return artwork.error();
  std::vector<NamedFile> named;
  for (const std::string& path : artwork->named_files) named.push_back({path + ", which FILE names", path});
  if (auto good = checkApart({{"-o", o.output}, {"--stats", o.stats_file}}, named); !good) return good.error();
  return artwork;
}

// A scene in the artwork's place, and --settings.
Result<void> takeFiles(RenderOptions& o) {
  auto scene = o.scene.takeScene(o.file, o.size);
  if (!scene) return scene.error();
  if (*scene && (*scene)->background && o.background.empty()) o.background = tripleText(*(*scene)->background);
  if (o.background.empty()) o.background = usualBackground();
  return o.scene.takeSettings();
}

// Of effects that the scene asks for and this artwork has no use for.
void warnOfNothing(const Scene& scene, const EffectPlan& plan) {
  if (scene.shading.isOn()) return;
  if (scene.ambient_occlusion.isOn() && !plan.ambient_occlusion)
    warn("--ambient-occlusion changes nothing: no relief is shown");
  if (scene.gloss.isOn() && !plan.gloss)
    warn(std::string("--gloss changes nothing: ") + (scene.unlit ? "there is no light" : "no relief is shown"));
}

Result<void> render(RenderOptions& o) {
  double start = steadyNow();
  HeapWarmer heap(kFirstPictureBytes);
  if (auto taken = takeFiles(o); !taken) return taken;
  auto size = parseSize(o.size.empty() ? "1280x720" : o.size);
  if (!size) return size.error();
  if (size->first > kMaxSidePx || size->second > kMaxSidePx) {
    return usageError("expected a --size of at most 16384x16384 px, found " + o.size);
  }
  auto background = parseTriple(o.background, "--background", "R,G,B from 0 to 255: 24,24,26");
  if (!background) return background.error();
  for (const double part : *background)
    if (part < 0 || part > 255)
      return usageError("expected numbers from 0 to 255 for --background, found '" + o.background + "'",
                        "for example R,G,B: 24,24,26");
  auto scene = o.scene.scene();
  if (!scene) return scene.error();
  auto artwork = openApart(o);
  if (!artwork) return artwork.error();
  const std::shared_ptr<const Package>& package = artwork->package;
  const Extent extent = artworkExtent(package->manifest(), scene->relief ? scene->exaggerate : 0);
  auto sight = sightOf(o, extent, *size);
  if (!sight) return sight.error();
  const auto& [width, height, camera] = *sight;

  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();
  heap.finish((*context)->info().software);
  double context_s = steadyNow() - start;
  auto engine = Engine::create(o.source.artwork(package), *scene, o.scene.engineOptions());
  if (!engine) return engine.error();
  Engine& e = **engine;
  e.resize(width, height);
  e.setCamera(camera);
  if (o.settle) {
    if (auto settled = e.settle(o.timeout_s); !settled) return settled;
  } else {
    e.frame(steadyNow());
  }
  double settled_s = steadyNow() - start;
  const std::vector<uint8_t> rgb =
      overBackground(e.readPixels(), {static_cast<uint8_t>((*background)[0]), static_cast<uint8_t>((*background)[1]),
                                      static_cast<uint8_t>((*background)[2])});
  const FrameTimes ms = timeFrames(e, camera, o.frames);
  if (const PageFailures failures = e.failures(); failures.pages > 0) {
    const Error error = drawnWithout(failures, e.stats(), o.file);
    if (!o.allow_damage) return error;
    warn(error.text());
  }
  for (const std::string& notice : e.takeNotices()) warn(notice);
  if (auto written = writeImage(o.output, width, height, 3, rgb,
                                camera.orthographic && extent.size_known ? mmPerPx(camera, height) : 0);
      !written)
    return written;
  if (!(o.scene.light.empty() && scene->lights.empty()) && !scene->unlit && !scene->shading.isOn() && !e.plan().lit())
    warn(std::string(scene->lights.empty() ? "--light changes" : "lights change") + " nothing: an image " +
         (package->manifest().domain.relief_depth < 0 ? "without a height map" : "without its relief") +
         " is shown unlit");

  warnOfNothing(*scene, e.plan());

  if (!o.stats_file.empty()) {
    auto stats = nlohmann::ordered_json::parse(engineStatsJson(e.stats(), e.manifest()));
    stats["context_ms"] = context_s * 1000;
    stats["settled_ms"] = settled_s * 1000;
    stats["settled_at_s"] = start + settled_s;  // of the steady clock, for who started the program
    if (!ms.moving.empty()) {
      stats["frame_ms_median"] = medianOf(ms.moving);
      stats["still_frame_ms_median"] = medianOf(ms.still);
      stats["frame_ms_max"] = *std::max_element(ms.moving.begin(), ms.moving.end());
    }
    stats["renderer"] = (*context)->info().renderer;
    std::string text = stats.dump(2) + "\n";
    return writeFile(o.stats_file, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
  }
  return {};
}

}  // namespace

void addRenderCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<RenderOptions>();
  auto* c = app.add_subcommand("render", "Draw an artwork into a picture, without a window");
  c->footer(
      "Example:\n  relievo render inscription.relievo -o picture.png --size 1280x720 --azimuth 25 --elevation 15 \\\n"
      "      --light -0.8,0.3,0.4 --settle --stats stats.json\n\n"
      "To measure and draw from, all of it at 20 px a mm:\n  relievo render inscription.relievo -o plate.png "
      "--mm-per-px 0.05");
  c->add_option(
       "FILE", o->file,
       "Artwork to draw: a package, a .ptm, an image or a scan (.ply, .obj, .stl, .off, .glb, .gltf); what is "
       "no package "
       "is built into one and kept (--cache-dir); or a scene (.json: relievo plan --schema), whose artwork is drawn as "
       "it says; options given beside it win")
      ->required();
  c->add_option("-o,--output", o->output,
                "Picture to write; its name says the format: .png, .tif, .exr (linear light, half floats) or .jpg. - "
                "for a PNG on standard output")
      ->required();
  c->add_option("--size", o->size,
                "Picture, WIDTHxHEIGHT in px [1280x720; with --mm-per-px as large as all of the artwork takes]");
  o->scene.addTo(*c);
  o->source.addTo(*c);
  o->cache.addTo(*c);
  c->add_flag("--settle,!--no-settle", o->settle,
              "Wait until all wanted pages are resident: the picture is then deterministic [on]");
  c->add_flag("--allow-damage", o->allow_damage,
              "Draw what is there, and stand-ins where pages are damaged or cannot be read: a warning in the place of "
              "exit code 3 or 2");
  c->add_option("--timeout", o->timeout_s, "Give up settling after this time, s; at once where the view needs more than --cache-mib holds")
      ->check(CLI::Range(0.1, 86400.0))
      ->capture_default_str();
  c->add_option("--frames", o->frames,
                "Frames to time once settled, with a moving and with a still camera, for --stats")
      ->check(CLI::Range(0, 100000))
      ->capture_default_str();
  c->add_option("--background", o->background, "R,G,B where the artwork is not, 0 to 255 [" + usualBackground() + "]");
  c->add_option(
      "--stats", o->stats_file,
      "Write counters to this JSON file (- for standard output): planes, pages and bytes read, passes, draw calls, ms");
  c->callback([o, &context] {
    if (auto done = render(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
