// relievo render: a picture of an artwork, without a window.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <functional>
#include <memory>
#include <span>
#include <tuple>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/heap.h"
#include "src/base/progress.h"
#include "src/engine/stage.h"
#include "src/gl/context.h"
#include "src/render/over_background.h"
#include "texturing/import/image_io.h"
#include "tools/artwork_cache.h"
#include "tools/bench/frame_timing.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/picture_sequence.h"
#include "tools/scene_artworks.h"
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
  double timeout_s = 120, fps = 0;
  std::optional<double> time_s;
  std::optional<NumberedName> numbered;  // of the pictures, where -o names several
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
FrameTimes timeFrames(Stage& stage, const OrbitCamera& camera, int frames) {
  FrameTimes ms;
  ms.moving = movingFramesMs(stage, camera, frames);
  for (int i = 0; i < 3 && frames > 0; ++i) timedFrameMs(stage);  // the last move's list arrives
  for (int i = 0; i < frames && !interruptedFlag(); ++i) ms.still.push_back(timedFrameMs(stage));
  return ms;
}

// The size of the picture, px, and the camera that it is seen with at --time.
struct Sight {
  int width = 0, height = 0;
  OrbitCamera camera;
};
Result<Sight> sightOf(const RenderOptions& o, std::span<const PlacedExtent> placed, std::pair<int64_t, int64_t> size) {
  Sight sight{static_cast<int>(size.first), static_cast<int>(size.second), {}};
  if (o.scene.mm_per_px && o.size.empty()) {
    auto all = o.scene.sizeAtScale(placed, static_cast<int>(kMaxSidePx));
    if (!all) return all.error();
    std::tie(sight.width, sight.height) = *all;
  }
  auto camera = o.scene.cameraAt(placed, sight.width, sight.height, o.time_s.value_or(0));
  if (!camera) return camera.error();
  sight.camera = *camera;
  return sight;
}

std::vector<double> pictureMoments(const RenderOptions& o) {
  return momentsOf(o.scene.animation.duration_s, o.frames, o.fps);
}

Result<void> checkNumbered(const RenderOptions& o, const std::vector<NamedFile>& inputs) {
  if (!o.numbered) return {};
  const int count = static_cast<int>(pictureMoments(o).size());
  for (const NamedFile& input : inputs)
    if (!input.path.empty() && o.numbered->takesPlaceOf(input.path, count))
      return usageError("a picture of -o " + o.output + " would take the place of " + input.option,
                        "write to another file");
  return {};
}

// Artworks and outputs, none of which may take another's place.
Result<SceneArtworks> openApart(const RenderOptions& o) {
  const std::string output = o.numbered ? o.numbered->at(0) : o.output;
  const std::vector<SceneArtwork> artworks_named = o.scene.artworksOf(o.file);
  std::vector<NamedFile> inputs = inputsOf(artworks_named);
  inputs.push_back({"the scene", o.scene.scene_file});
  inputs.push_back({"--state", o.scene.state_file});
  inputs.push_back({"--settings", o.scene.settings_file});
  if (auto good = checkOutputs({{"-o", output, Content::kPicture}, {"--stats", o.stats_file}}, inputs); !good)
    return good.error();
  if (auto good = checkNumbered(o, inputs); !good) return good.error();
  if (auto format = imageFormatOf(output); !format) return format.error();
  auto artworks = openArtworks(artworks_named, o.cache);
  if (!artworks) return artworks.error();
  const std::vector<NamedFile> named = namedInputsOf(*artworks);
  if (auto good = checkApart({{"-o", output}, {"--stats", o.stats_file}}, named); !good) return good.error();
  if (auto good = checkNumbered(o, named); !good) return good.error();
  return artworks;
}

// --time, --fps, and --frames with several pictures, are of a scene that moves.
Result<void> checkTimes(RenderOptions& o) {
  const double duration_s = o.scene.animation.duration_s;
  auto numbered = NumberedName::parse(o.output);
  if (duration_s == 0) {
    if (o.time_s || o.fps > 0 || (numbered && o.frames > 0))
      return usageError("there is no scene with a duration: with a camera_path, or lights that have keys",
                        "relievo plan --schema prints what a scene may say");
    return {};
  }
  if (o.time_s && (!(*o.time_s >= 0) || *o.time_s > duration_s)) {
    char text[120];
    std::snprintf(text, sizeof text, "expected a --time from 0 to the scene's %g s, found %g", duration_s, *o.time_s);
    return usageError(text);
  }
  if (!numbered) {
    if (o.fps > 0)
      return usageError("--fps writes several pictures, and -o names one", "for example -o frame-%04d.png");
    return {};
  }
  if (o.time_s) return usageError("--time is of one picture, and -o " + o.output + " names several");
  if (!o.stats_file.empty()) return usageError("--stats is of one picture, and -o " + o.output + " names several");
  if ((o.fps > 0) == (o.frames > 0))
    return usageError("-o " + o.output + " names several pictures: say how many", "--frames 100, or --fps 25");
  if (o.fps > 0 && duration_s * o.fps >= kMaxPictures)
    return usageError("--fps asks for more than " + std::to_string(kMaxPictures) + " pictures", "give less of it");
  o.numbered = std::move(numbered);
  return {};
}

// A scene in the artwork's place, and --settings.
Result<void> takeFiles(RenderOptions& o) {
  auto scene = o.scene.takeScene(o.file, o.size);
  if (!scene) return scene.error();
  if (*scene && (*scene)->background && o.background.empty()) o.background = tripleText(*(*scene)->background);
  if (o.background.empty()) o.background = usualBackground();
  return o.scene.takeSettings();
}

bool anyOf(const Stage& stage, const std::function<bool(const EffectPlan&)>& has) {
  for (size_t i = 0; i < stage.size(); ++i)
    if (has(stage.engine(i).plan())) return true;
  return false;
}

// Of effects that the scene asks for and no artwork has a use for.
void warnOfNothing(const Scene& scene, const Stage& stage) {
  if (scene.shading.isOn()) return;
  if (scene.ambient_occlusion.isOn() && !anyOf(stage, [](const EffectPlan& p) { return p.ambient_occlusion; }))
    warn("--ambient-occlusion changes nothing: no relief is shown");
  if (scene.gloss.isOn() && !anyOf(stage, [](const EffectPlan& p) { return p.gloss; }))
    warn(std::string("--gloss changes nothing: ") + (scene.unlit ? "there is no light" : "no relief is shown"));
}

// What is drawn, and how.
struct Work {
  const RenderOptions& o;
  const SceneArtworks& artworks;
  const Scene& scene;
  std::span<const PlacedExtent> placed;
  const Sight& sight;
  const std::array<double, 3>& background;
};

Result<std::unique_ptr<Stage>> stageFor(const Work& w) {
  auto stage = Stage::create(w.artworks.staged([&](const auto& package) { return w.o.source.artwork(package); }),
                             w.scene, w.o.scene.engineOptions());
  if (stage) (*stage)->resize(w.sight.width, w.sight.height);
  return stage;
}

// Camera and lights at a time.
Result<void> setMoment(const Work& w, Stage& stage, double time_s) {
  auto camera = w.o.scene.cameraAt(w.placed, w.sight.width, w.sight.height, time_s);
  if (!camera) return camera.error();
  stage.setCamera(*camera);
  if (!w.o.scene.animation.isOn()) return {};
  return stage.setScene(sceneAt(w.o.scene.animation, w.scene, time_s));
}

Result<std::vector<uint8_t>> pictureOf(const Work& w, Stage& stage) {
  if (w.o.settle) {
    if (auto settled = stage.settle(w.o.timeout_s); !settled) return settled.error();
  } else {
    stage.frame(steadyNow());
  }
  const auto& b = w.background;
  return overBackground(stage.readPixels(),
                        {static_cast<uint8_t>(b[0]), static_cast<uint8_t>(b[1]), static_cast<uint8_t>(b[2])});
}

Result<void> checkDamage(const Work& w, const Stage& stage) {
  const PageFailures failures = stage.failures();
  if (failures.pages == 0) return {};
  const Error error = drawnWithout(failures, stage.stats(), w.o.file);
  if (!w.o.allow_damage) return error;
  warn(error.text());
  return {};
}

Result<void> writePicture(const Work& w, const std::string& path, const OrbitCamera& camera,
                          std::span<const uint8_t> rgb) {
  return writeImage(path, w.sight.width, w.sight.height, 3, rgb,
                    camera.orthographic && worldExtent(w.placed).size_known ? mmPerPx(camera, w.sight.height) : 0);
}

// Of what the scene asks for and no artwork has a use for.
void warnOfLight(const Work& w, const Stage& stage) {
  const Scene& scene = w.scene;
  if (!(w.o.scene.light.empty() && scene.lights.empty()) && !scene.unlit && !scene.shading.isOn() &&
      !anyOf(stage, [](const EffectPlan& p) { return p.lit(); }))
    warn(std::string(scene.lights.empty() ? "--light changes" : "lights change") + " nothing: an image " +
         (w.artworks.package(0).manifest().domain.relief_depth < 0 ? "without a height map" : "without its relief") +
         " is shown unlit");
  warnOfNothing(scene, stage);
}

// Each picture is that of its moment alone: settled pictures do not depend on those before. Where the cache is short of
// room they may, and the next picture gets another stage.
Result<void> renderSequence(const Work& w) {
  const std::vector<double> moments = pictureMoments(w.o);
  std::unique_ptr<Stage> stage;
  ProgressLine progress("render");
  for (size_t i = 0; i < moments.size(); ++i) {
    if (interruptedFlag()) return Error{.kind = ErrorKind::kInterrupted, .message = "interrupted"};
    if (!stage) {
      auto made = stageFor(w);
      if (!made) return made.error();
      stage = std::move(*made);
    }
    if (auto set = setMoment(w, *stage, moments[i]); !set) return set;
    auto rgb = pictureOf(w, *stage);
    if (!rgb) return rgb.error();
    if (auto sound = checkDamage(w, *stage); !sound) return sound;
    if (i == 0) warnOfLight(w, *stage);
    for (const std::string& notice : stage->takeNotices()) warn(notice);
    if (auto written = writePicture(w, w.o.numbered->at(static_cast<int>(i)), stage->camera(), *rgb); !written)
      return written;
    progress.update(static_cast<double>(i + 1) / static_cast<double>(moments.size()),
                    "picture " + std::to_string(i + 1) + " of " + std::to_string(moments.size()));
    if (stage->stats().detail_bias > 0) stage.reset();
  }
  return {};
}

Result<void> render(RenderOptions& o) {
  double start = steadyNow();
  HeapWarmer heap(kFirstPictureBytes);
  if (auto taken = takeFiles(o); !taken) return taken;
  if (auto good = checkTimes(o); !good) return good;
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
  auto artworks = openApart(o);
  if (!artworks) return artworks.error();
  const std::vector<PlacedExtent> placed = artworks->placed(*scene);
  auto sight = sightOf(o, placed, *size);
  if (!sight) return sight.error();
  const OrbitCamera& camera = sight->camera;

  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();
  if (!(*context)->info().software) heap.giveBack();
  double context_s = steadyNow() - start;
  const Work work{o, *artworks, *scene, placed, *sight, *background};
  if (o.numbered) return renderSequence(work);
  auto made = stageFor(work);
  if (!made) return made.error();
  Stage& stage = **made;
  if (auto set = setMoment(work, stage, o.time_s.value_or(0)); !set) return set;
  auto rgb = pictureOf(work, stage);
  if (!rgb) return rgb.error();
  double settled_s = steadyNow() - start;
  const FrameTimes ms = timeFrames(stage, camera, o.frames);
  if (auto sound = checkDamage(work, stage); !sound) return sound;
  for (const std::string& notice : stage.takeNotices()) warn(notice);
  if (auto written = writePicture(work, o.output, camera, *rgb); !written) return written;
  warnOfLight(work, stage);

  if (!o.stats_file.empty()) {
    auto stats = nlohmann::ordered_json::parse(stage.statsJson());
    stats["context_ms"] = context_s * 1000;
    stats["settled_ms"] = settled_s * 1000;
    stats["settled_at_s"] = start + settled_s;  // of the steady clock, for who started the program
    if (!ms.moving.empty()) {
      stats["frame_ms_median"] = medianOf(ms.moving);
      stats["still_frame_ms_median"] = medianOf(ms.still);
      stats["frame_ms_max"] = *std::max_element(ms.moving.begin(), ms.moving.end());
    }
    stats["renderer"] = (*context)->info().renderer;
    // Names of artworks need not be UTF-8.
    std::string text = stats.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
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
      "--mm-per-px 0.05\n\n"
      "A scene that moves (camera_path, lights with keys), as pictures of a film:\n  relievo render scene.json -o "
      "frame-%04d.png --fps 25");
  c->add_option("FILE", o->file,
                "Artwork to draw: a package, a .ptm, an image or a scan (.ply, .obj, .stl, .off, .glb, .gltf); what is "
                "no package "
                "is built into one and kept (--cache-dir); or a scene (.json: relievo plan --schema), whose artworks "
                "are drawn as "
                "it says; options given beside it win")
      ->required();
  c->add_option("-o,--output", o->output,
                "Picture to write; its name says the format: .png, .tif, .exr (linear light, half floats) or .jpg. - "
                "for a PNG on standard output. Of a scene that moves frame-%04d.png names several, from 0 on")
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
  c->add_option(
       "--timeout", o->timeout_s,
       "Give up settling after this time, s, of each artwork; at once where the view needs more than --cache-mib holds")
      ->check(CLI::Range(0.1, 86400.0))
      ->capture_default_str();
  c->add_option(
       "--frames", o->frames,
       "Frames to time once settled, with a moving and with a still camera, for --stats; with several pictures "
       "(-o) how many there are, from the scene's beginning to its end")
      ->check(CLI::Range(0, kMaxPictures))
      ->capture_default_str();
  c->add_option("--fps", o->fps, "Several pictures (-o), so many a second of the scene's time")
      ->check(CLI::Range(1e-3, 1000.0));
  c->add_option("--time", o->time_s, "The moment of a scene that moves, seconds from its beginning [0]");
  c->add_option("--background", o->background, "R,G,B where the artwork is not, 0 to 255 [" + usualBackground() + "]");
  c->add_option(
      "--stats", o->stats_file,
      "Write counters to this JSON file (- for standard output): planes, pages and bytes read, passes, draw calls, ms");
  c->callback([o, &context] {
    if (auto done = render(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
