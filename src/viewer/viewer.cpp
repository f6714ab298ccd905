#include "src/viewer/viewer.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <span>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "src/base/heap.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/base/worker_threads.h"
#include "src/engine/eye_guard.h"
#include "src/gl/window.h"
#include "src/viewer/hud.h"
#include "src/viewer/view_control.h"
#include "texturing/import/image_io.h"

namespace relievo {
namespace {

constexpr double kMessageS = 6;       // how long a message stays
constexpr double kLightGaugeS = 1.5;  // and the light's direction after a drag
// Redrawing stops once nothing has changed for this long, in seconds and in frames (the LOD and the feedback answer
// some frames late); longer where pages are missing, which may be on their way.
constexpr double kCalmS = 0.5, kCalmMissingS = 3;
constexpr int kCalmFrames = 12;
// A camera stands still once it has not moved for this long, s; less than kCalmS, so that what follows from it is
// drawn.
constexpr double kStillS = 0.3;
constexpr double kIdleWaitS = 0.25;  // between looks at the clock then
constexpr double kIdleRedrawS = 1;   // and between pictures: a page that failed may be tried again

double nowSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Frame rate over the last second of drawing; pauses in which nothing was drawn do not count.
class FrameMeter {
 public:
  void add(double seconds) {
    times_.push_back(seconds);
    sum_ += seconds;
    while (sum_ > 1 && times_.size() > 1) {
      sum_ -= times_.front();
      times_.pop_front();
    }
  }
  double meanSeconds() const { return times_.empty() ? 0 : sum_ / static_cast<double>(times_.size()); }

 private:
  std::deque<double> times_;
  double sum_ = 0;
};

Result<void> writeSnapshot(Engine& engine, const std::string& path, const ViewerOptions& options) {
  const EngineStats stats = engine.stats();
  return writeImage(path, engine.width(), engine.height(), 3, overBackground(engine.readPixels(), options.background),
                    stats.orthographic && stats.size_known ? stats.mm_per_px : 0);
}

std::string viewJson(const ViewControl::View& view) {
  nlohmann::ordered_json json;
  json["azimuth_deg"] = view.camera.azimuth_deg;
  json["elevation_deg"] = view.camera.elevation_deg;
  json["distance_mm"] = view.camera.distance_mm;
  json["fov_deg"] = view.camera.fov_deg;
  json["orthographic"] = view.camera.orthographic;
  json["target_mm"] = {view.camera.target_mm.x, view.camera.target_mm.y, view.camera.target_mm.z};
  json["light"] = view.light;
  return json.dump();
}

}  // namespace

std::vector<uint8_t> overBackground(std::span<const uint8_t> rgba, const std::array<uint8_t, 3>& background) {
  std::vector<uint8_t> rgb(rgba.size() / 4 * 3);
  for (size_t i = 0; i < rgb.size() / 3; ++i)
    for (size_t c = 0; c < 3; ++c) rgb[3 * i + c] = rgba[4 * i + 3] ? rgba[4 * i + c] : background[c];
  return rgb;
}

std::string freeSnapshotName(const std::string& folder, const std::string& stem) {
  for (int i = 1; i < 10000; ++i) {
    char number[24];
    std::snprintf(number, sizeof number, "-%04d.png", i);
    std::filesystem::path path = std::filesystem::path(folder) / (stem + number);
    std::error_code ignored;
    if (!std::filesystem::exists(path, ignored)) return path.string();
  }
  return {};
}

Result<void> runViewer(Artwork artwork, const ViewerOptions& options) {
  HeapWarmer heap(kFirstPictureBytes);
  Result<std::unique_ptr<gl::Window>> made_window =
      gl::Window::create(options.title, options.width_px, options.height_px);
  if (!made_window) return made_window.error();
  gl::Window& window = **made_window;
  heap.finish(gl::currentContextInfo().software);
  const double exaggerate = options.scene.relief ? options.scene.exaggerate : 0;
  const Extent extent = artworkExtent(artwork.manifest, exaggerate);
  // What keeps the eye outside: at once for a flat artwork; over a base mesh on a thread of its own, some tenths of a
  // second, during which the window draws and moves already.
  BackgroundTask<std::unique_ptr<const EyeGuard>> guard(
      "relievo-guard",
      [artwork, exaggerate, workers = options.engine.workers] { return makeEyeGuard(artwork, exaggerate, workers); },
      artwork.manifest.base != nullptr);
  bool guarded = false;
  Result<std::unique_ptr<Engine>> made_engine = Engine::create(std::move(artwork), options.scene, options.engine);
  if (!made_engine) return made_engine.error();
  Engine& engine = **made_engine;
  Result<std::unique_ptr<Hud>> hud = Hud::create(gl::currentContextInfo().api, window.contentScale());
  if (!hud) return hud.error();

  Scene scene = options.scene;
  ViewControl::View start;
  start.light = scene.light;
  Result<OrbitCamera> camera = options.camera ? options.camera(extent, window.width(), window.height())
                                              : fitCamera(extent, window.width(), window.height());
  if (!camera) return camera.error();
  start.camera = *camera;
  ViewControl control(extent, start, window.width(), window.height(),
                      {[&](double x, double y) { return engine.surfacePoint(x, y); }});
  control.wireframe = scene.wireframe;
  control.show_pages = scene.show == Show::kPages;

  std::string message = "F1 shows the controls";
  double message_until = nowSeconds() + kMessageS, light_until = 0, last_frame = 0, drawn_at = 0;
  double changed_at = nowSeconds();
  int calm_frames = 0;
  bool switching = false;
  std::array<uint64_t, 6> progress_before{};
  FrameMeter meter;
  const bool exact_still = options.exact_still == ViewerOptions::ExactStill::kAuto
                               ? !gl::currentContextInfo().software && options.frames == 0
                               : options.exact_still == ViewerOptions::ExactStill::kOn;
  OrbitCamera camera_before;
  double moved_at = 0;
  int64_t frames = 0;
  HudState shown;
  while (!control.quit) {
    if (interruptedFlag()) return Error{.kind = ErrorKind::kInterrupted, .message = "interrupted"};
    double now = nowSeconds();
    const bool busy = options.frames > 0 || calm_frames < kCalmFrames ||
                      now < changed_at + (shown.missing_pages > 0 || switching ? kCalmMissingS : kCalmS);
    bool changed = false;
    if (!guarded && guard.ready()) {
      changed = control.setGuard(guard.get().get());
      guarded = true;
    }
    for (const gl::Event& e : busy ? window.pollEvents() : window.waitEvents(kIdleWaitS)) changed |= control.handle(e);
    if (window.width() < 1 || window.height() < 1) {  // minimised
      window.waitEvents(kIdleWaitS);
      continue;
    }
    now = nowSeconds();
    if (control.draggingLight()) light_until = now + kLightGaugeS;
    if (changed) changed_at = now;
    const bool show_light = now < light_until || control.help;
    const bool message_over = now >= message_until && !shown.message.empty();
    if (!busy && !changed && show_light == shown.show_light && !message_over && now < drawn_at + kIdleRedrawS) continue;
    if (!busy) last_frame = 0;  // the pause is no frame's time
    shown.show_light = show_light;
    shown.message = now < message_until ? message : std::string();
    shown.help = control.help;
    if (control.figures != shown.figures.has_value()) changed_at = now;
    shown.light = control.view().light;

    if (const OrbitCamera& now_at = control.view().camera; now_at != camera_before) {
      camera_before = now_at;
      moved_at = now;
    }
    Scene wanted = scene;
    if (exact_still && now >= moved_at + kStillS) wanted.least_cell = 0;
    wanted.light = control.view().light;
    wanted.wireframe = control.wireframe;
    wanted.show = control.show_pages ? Show::kPages : scene.show == Show::kPages ? Show::kNone : scene.show;
    if (Result<void> set = engine.setScene(wanted); !set) return set;
    engine.resize(window.width(), window.height());
    engine.setCamera(control.view().camera);
    engine.frame(now);
    const EngineStats stats = engine.stats();
    if (std::exchange(switching, stats.switching) != stats.switching) changed_at = now;
    const std::array<uint64_t, 6> progress = {stats.resident,
                                              stats.missing_pages,
                                              stats.wanted_nodes,
                                              stats.triangles,
                                              stats.streamer.decoding + stats.streamer.ready,
                                              stats.streamer.queued};
    if (progress != std::exchange(progress_before, progress)) changed_at = now;
    calm_frames = changed_at == now ? 0 : calm_frames + 1;
    for (const std::string& text : engine.takeMessages()) {
      message = text;
      message_until = now + kMessageS;
    }
    if (control.takeSnapshotRequest()) {
      const std::string name = freeSnapshotName(".", options.snapshot_stem);
      Result<void> written = name.empty()
                                 ? Error{.kind = ErrorKind::kIo, .message = "no free number for a snapshot is left"}
                                 : writeSnapshot(engine, name, options);
      message = written ? "written: " + std::filesystem::absolute(name).lexically_normal().string()
                        : "the snapshot failed: " + written.error().text();
      message_until = now + kMessageS;
      shown.message = message;
    }

    shown.unlit = !engine.plan().lit();
    shown.fps = meter.meanSeconds() > 0 ? 1 / meter.meanSeconds() : 0;
    shown.frame_ms = meter.meanSeconds() * 1000;
    shown.resident_pages = stats.resident;
    shown.slots = stats.slots;
    shown.missing_pages = stats.missing_pages;
    shown.error_px = scene.error_px;
    shown.predicted_error_px = stats.predicted_error_px;
    shown.mm_per_px = stats.orthographic ? stats.mm_per_px : 0;
    shown.size_known = stats.size_known;
    shown.figures.reset();
    if (control.figures) shown.figures = hudFigures(stats, engine.manifest());
    engine.present(window.width(), window.height());
    (*hud)->draw(shown, window.width(), window.height());
    window.swap();

    const double end = nowSeconds();
    if (last_frame > 0) meter.add(end - last_frame);
    last_frame = drawn_at = end;
    if (++frames == options.frames) {
      if (!options.snapshot_file.empty())
        if (Result<void> written = writeSnapshot(engine, options.snapshot_file, options); !written) return written;
      break;
    }
  }
  if (options.print_view) printOutf("%s\n", viewJson(control.view()).c_str());
  return {};
}

}  // namespace relievo
