#include "src/viewer/viewer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/heap.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/base/worker_threads.h"
#include "src/engine/effects/effects.h"
#include "src/engine/eye_guard.h"
#include "src/gl/window.h"
#include "src/render/over_background.h"
#include "src/viewer/frame_time_control.h"
#include "src/viewer/hud.h"
#include "src/viewer/view_control.h"
#include "texturing/import/image_io.h"

namespace relievo {
namespace {

constexpr double kMessageS = 6;       // how long a message stays
constexpr double kLightGaugeS = 1.5;  // and the light's direction after a drag
// Redrawing stops once nothing has changed for this long, in seconds and in frames with feedback (it and the LOD answer
// some frames late); longer where pages are missing, which may be on their way.
constexpr double kCalmS = 0.5, kCalmMissingS = 3;
constexpr int kCalmFrames = 12;
// A camera stands still once it has not moved for this long, s; less than kCalmS, so that what follows from it is
// drawn.
constexpr double kStillS = 0.3;
constexpr double kIdleWaitS = 0.25;         // between looks at the clock then
constexpr double kUsualReflectance = 0.04;  // of gloss that a key turns on: varnish
constexpr double kIdleRedrawS = 1;          // and between pictures: a page that failed may be tried again

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

Result<void> writeSnapshot(Stage& stage, const std::string& path, const ViewerOptions& options) {
  const EngineStats stats = stage.stats();
  return writeImage(path, stage.width(), stage.height(), 3, overBackground(stage.readPixels(), options.background),
                    stats.orthographic && stats.size_known ? stats.mm_per_px : 0);
}

std::string viewJson(const ViewControl::View& view) {
  auto json = nlohmann::ordered_json::object();
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

std::string freeSnapshotName(const std::string& folder, const std::string& stem) {
  for (int i = 1; i < 10000; ++i) {
    char number[24];
    std::snprintf(number, sizeof number, "-%04d.png", i);
    std::filesystem::path path = std::filesystem::path(folder) / (stem + number);
    std::error_code ignored;
    if (!std::filesystem::exists(path, ignored) &&
        !std::filesystem::exists(std::filesystem::path(path).replace_extension(".json"), ignored))
      return path.string();
  }
  return {};
}

namespace {

// What keeps the eye outside: at once for flat artworks; over a base mesh on a thread of its own, once the first frame
// is shown, some tenths of a second, during which the window draws and moves already.
struct GuardMaker {
  std::vector<Artwork> artworks;
  std::vector<PlacedExtent> placed;
  double exaggerate = 1;
  int workers = 1;

  bool takesTime() const {
    return std::any_of(artworks.begin(), artworks.end(),
                       [](const Artwork& artwork) { return !artwork.manifest.domain.isFlat(); });
  }
  std::unique_ptr<const EyeGuard> operator()() const {
    std::vector<std::unique_ptr<const EyeGuard>> guards;
    for (size_t i = 0; i < artworks.size(); ++i)
      guards.push_back(placedGuard(makeEyeGuard(artworks[i], exaggerate, workers), placed[i]));
    return guardOfAll(std::move(guards));
  }
};

class Guard {
 public:
  explicit Guard(GuardMaker maker) : maker_(std::move(maker)) {
    if (!maker_.takesTime()) start(false);
  }
  void frameShown() {
    if (!task_) start(true);
  }
  bool ready() const { return task_ && task_->ready(); }
  const EyeGuard* get() { return task_->get().get(); }

 private:
  void start(bool beside) { task_.emplace("relievo-guard", std::move(maker_), beside); }

  GuardMaker maker_;
  std::optional<BackgroundTask<std::unique_ptr<const EyeGuard>>> task_;
};

// The window's life: events are handled, and a frame is drawn where something changed or is still on its way.
class ViewLoop {
 public:
  ViewLoop(gl::Window& window, Stage& stage, Hud& hud, ViewControl& control, Guard& guard, const ViewerOptions& options)
      : window_(window), stage_(stage), hud_(hud), control_(control), guard_(guard), options_(options) {}
  Result<void> run();

 private:
  // Frames follow one another; else events are waited for.
  bool busy(double now) const { return options_.frames > 0 || control_.playing || !calm(now) || refining(now); }
  bool calm(double now) const {
    return calm_frames_ >= kCalmFrames * options_.engine.feedback_interval &&
           now >= changed_at_ + (shown_.missing_pages > 0 || switching_ ? kCalmMissingS : kCalmS);
  }
  // Once nothing changes any more, frames add the samples, and directions of light, that the picture lacks.
  bool refining(double now) const {
    return lacks_samples_ && calm(now) && now >= changed_at_ + options_.scene.page_fade_s;
  }
  bool takeEvents(bool busy);
  // The next moment of what moves by itself. True: something did.
  bool play(double now);
  // Is there anything to draw? Notes what the head-up display shows of it.
  bool toDraw(double now, bool busy, bool changed);
  void showHeldLight();
  void noteKeys(const Scene& wanted, double now);
  Scene sceneAt(double now);
  std::array<int, 2> pictureSize() const;  // after sceneAt()
  Result<EngineStats> drawScene(double now);
  void noteProgress(const EngineStats& stats, double now);
  void say(std::string message, double now) {
    message_ = std::move(message);
    message_until_ = now + kMessageS;
  }
  void takeSnapshot(double now);
  void drawHud(const EngineStats& stats);
  void meterFrame() {
    const double end = nowSeconds();
    if (last_frame_ > 0) meter_.add(end - last_frame_);
    if (frame_time_ && last_frame_ > 0) frame_time_->observe(1000 * (end - last_frame_), moving_);
    last_frame_ = drawn_at_ = end;
  }

  gl::Window& window_;
  Stage& stage_;
  Hud& hud_;
  ViewControl& control_;
  Guard& guard_;
  const ViewerOptions& options_;
  const bool exact_still_ = options_.exact_still == ViewerOptions::ExactStill::kAuto
                                ? !gl::currentContextInfo().software && options_.frames == 0
                                : options_.exact_still == ViewerOptions::ExactStill::kOn;

  std::string message_ = "F1 shows the controls";
  // When, in seconds of nowSeconds().
  double message_until_ = nowSeconds() + kMessageS, light_until_ = 0, last_frame_ = 0, drawn_at_ = 0;
  double changed_at_ = nowSeconds(), moved_at_ = 0;
  int calm_frames_ = 0;
  bool guarded_ = false, switching_ = false, moving_ = false, lacks_samples_ = false;
  bool last_ = false;  // of ViewerOptions::frames
  std::optional<FrameTimeControl> frame_time_ = options_.frame_ms > 0
                                                    ? std::optional<FrameTimeControl>(options_.frame_ms)
                                                    : std::nullopt;
  std::array<uint64_t, 6> progress_{};
  std::array<int, 4> keys_{-1, 0, 0, 0};  // what keys chose by the last frame; below 0: there was none
  OrbitCamera camera_;                    // of the last frame
  const OrbitCamera start_camera_ = control_.view().camera;
  double play_s_ = 0, played_at_ = nowSeconds();  // of the animation; when that was, by the clock
  FrameMeter meter_;
  HudState shown_;
};

bool ViewLoop::takeEvents(bool busy) {
  bool changed = false;
  if (!guarded_ && guard_.ready()) {
    changed = control_.setGuard(guard_.get());
    guarded_ = true;
  }
  for (const gl::Event& e : busy ? window_.pollEvents() : window_.waitEvents(kIdleWaitS)) changed |= control_.handle(e);
  return changed;
}

bool ViewLoop::play(double now) {
  const double before = std::exchange(played_at_, now);
  if (!control_.playing) return false;
  play_s_ = std::fmod(play_s_ + now - before, options_.animation.duration_s);
  control_.show(cameraAt(options_.animation, start_camera_, window_.height(), play_s_),
                relievo::sceneAt(options_.animation, options_.scene, play_s_).lights);
  return true;
}

bool ViewLoop::toDraw(double now, bool busy, bool changed) {
  if (control_.draggingLight()) light_until_ = now + kLightGaugeS;
  if (changed) changed_at_ = now;
  const bool show_light = now < light_until_ || control_.help;
  const bool message_over = now >= message_until_ && !shown_.message.empty();
  if (!busy && !changed && show_light == shown_.show_light && !message_over && now < drawn_at_ + kIdleRedrawS)
    return false;
  if (!busy) last_frame_ = 0;  // the pause is no frame's time
  shown_.show_light = show_light;
  shown_.message = now < message_until_ ? message_ : std::string();
  shown_.help = control_.help;
  if (control_.figures != shown_.figures.has_value()) changed_at_ = now;
  showHeldLight();
  return true;
}

// A near light is shown by its direction from what the camera looks at.
void ViewLoop::showHeldLight() {
  const ViewControl::View& view = control_.view();
  shown_.light = view.light;
  shown_.held_light.clear();
  if (view.held >= view.lights.size()) return;
  const SceneLight& held = view.lights[view.held];
  if (view.lights.size() > 1 || held.near)
    shown_.held_light = "light " + std::to_string(view.held + 1) + " of " + std::to_string(view.lights.size());
  if (!held.near) return;
  char text[96];
  std::snprintf(text, sizeof text, ", near, at %.4g %.4g %.4g mm", held.place[0], held.place[1], held.place[2]);
  shown_.held_light += text;
  const glm::dvec3 way = glm::dvec3(held.place[0], held.place[1], held.place[2]) - view.camera.target_mm;
  const double length = glm::length(way);
  if (length > 0) shown_.light = {way.x / length, way.y / length, way.z / length};
}

// Says which keys cannot change the picture.
void ViewLoop::noteKeys(const Scene& wanted, double now) {
  const std::array<int, 4> keys{static_cast<int>(control_.shading), control_.shadows, control_.gloss,
                                static_cast<int>(control_.view().held)};
  const std::array<int, 4> before = std::exchange(keys_, keys);
  if (before == keys || before[0] < 0) return;
  std::vector<EffectPlan> plans;
  for (size_t i = 0; i < stage_.size(); ++i) plans.push_back(planEffects(wanted, stage_.engine(i).manifest()));
  const auto any = [&](bool EffectPlan::*effect) {
    return std::any_of(plans.begin(), plans.end(), [effect](const EffectPlan& plan) { return plan.*effect; });
  };
  if (before[3] != keys[3]) light_until_ = now + kLightGaugeS;
  if (before[1] < keys[1] && !any(&EffectPlan::shadows))
    say("shadows change nothing: nothing is lit, or no relief is shown", now);
  if (before[2] < keys[2] && !any(&EffectPlan::gloss))
    say("gloss changes nothing: nothing is lit, or no relief is shown", now);
}

Scene ViewLoop::sceneAt(double now) {
  if (const OrbitCamera& now_at = control_.view().camera; now_at != camera_) {
    camera_ = now_at;
    moved_at_ = now;
  }
  const PixelEffect* const overlay = options_.scene.overlay;
  Scene wanted = options_.scene;
  // Snapshots are not of what was given up.
  moving_ = now < moved_at_ + kStillS && !control_.wantsSnapshot() && !last_;
  if (exact_still_ && !moving_) wanted.least_cell = 0;
  if ((moving_ || control_.draggingLight()) && wanted.sampling == Sampling::kAuto)
    wanted.sampling = Sampling::kTrilinear;
  if (frame_time_ && moving_) wanted = frame_time_->spend(wanted);
  wanted.light = control_.view().light;
  wanted.lights = control_.view().lights;
  if (!control_.occlusion) wanted.ambient_occlusion = {};
  else if (!wanted.ambient_occlusion.isOn()) wanted.ambient_occlusion.strength = kUsualOcclusion;
  wanted.shadows = control_.shadows;
  if (!control_.gloss) wanted.gloss = {};
  else if (!wanted.gloss.isOn()) wanted.gloss.reflectance = kUsualReflectance;
  if (wanted.shading.kind != control_.shading)
    wanted.shading = {.kind = control_.shading, .map = wanted.shading.map, .up = wanted.shading.up};
  wanted.wireframe = control_.wireframe;
  wanted.overlay = control_.show_pages ? &kPagesEffect : overlay == &kPagesEffect ? nullptr : overlay;
  return wanted;
}

std::array<int, 2> ViewLoop::pictureSize() const {
  if (frame_time_ && moving_) return frame_time_->size(window_.width(), window_.height());
  return {window_.width(), window_.height()};
}

Result<EngineStats> ViewLoop::drawScene(double now) {
  const Scene wanted = sceneAt(now);
  if (Result<void> set = stage_.setScene(wanted); !set) return set.error();
  noteKeys(wanted, now);
  const auto [width_px, height_px] = pictureSize();
  if (width_px != stage_.width() || height_px != stage_.height()) changed_at_ = now;
  stage_.resize(width_px, height_px);
  stage_.setCamera(control_.view().camera);
  if (!refining(now) || !stage_.refine(now)) stage_.frame(now);
  const EngineStats stats = stage_.stats();
  lacks_samples_ = !stats.refined;
  return stats;
}

void ViewLoop::noteProgress(const EngineStats& stats, double now) {
  if (std::exchange(switching_, stats.switching) != stats.switching) changed_at_ = now;
  const std::array<uint64_t, 6> progress = {stats.resident,
                                            stats.missing_pages,
                                            stats.wanted_nodes,
                                            stats.triangles,
                                            stats.streamer.decoding + stats.streamer.ready,
                                            stats.streamer.queued};
  if (progress != std::exchange(progress_, progress)) changed_at_ = now;
  calm_frames_ = changed_at_ == now ? 0 : calm_frames_ + 1;
}

void ViewLoop::takeSnapshot(double now) {
  const std::string name = freeSnapshotName(".", options_.snapshot_stem);
  Result<void> written = name.empty()
                             ? Error{.kind = ErrorKind::kIo, .message = "no free number for a snapshot is left"}
                             : writeSnapshot(stage_, name, options_);
  if (written && options_.scene_text) {
    const std::string text = options_.scene_text(stage_.camera(), stage_.scene(), stage_.width(), stage_.height());
    written = writeFile(std::filesystem::path(name).replace_extension(".json").string(),
                        {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
  }
  say(written ? "written: " + std::filesystem::absolute(name).lexically_normal().string()
              : "the snapshot failed: " + written.error().text(),
      now);
  shown_.message = message_;
}

void ViewLoop::drawHud(const EngineStats& stats) {
  shown_.unlit = true;
  shown_.shading = "";
  shown_.shadows = shown_.ambient_occlusion = shown_.gloss = false;
  for (size_t i = 0; i < stage_.size(); ++i) {
    const EffectPlan& plan = stage_.engine(i).plan();
    shown_.unlit = shown_.unlit && !plan.lit();
    if (plan.shading != ReliefShading::Kind::kNone) shown_.shading = shadingName(plan.shading);
    shown_.shadows = shown_.shadows || plan.shadows;
    shown_.ambient_occlusion = shown_.ambient_occlusion || plan.ambient_occlusion;
    shown_.gloss = shown_.gloss || plan.gloss;
  }
  shown_.fps = meter_.meanSeconds() > 0 ? 1 / meter_.meanSeconds() : 0;
  shown_.frame_ms = meter_.meanSeconds() * 1000;
  shown_.resident_pages = stats.resident;
  shown_.slots = stats.slots;
  shown_.missing_pages = stats.missing_pages;
  shown_.error_px = options_.scene.error_px;
  shown_.given_up = frame_time_ && moving_ ? frame_time_->givenUp() : "";
  shown_.predicted_error_px = stats.predicted_error_px;
  shown_.mm_per_px = stats.orthographic ? stats.mm_per_px * stage_.width() / window_.width() : 0;  // of the window
  shown_.size_known = stats.size_known;
  shown_.duration_s = options_.animation.duration_s;
  shown_.time_s = play_s_;
  shown_.playing = control_.playing;
  shown_.figures.reset();
  if (control_.figures) shown_.figures = hudFigures(stats, stage_);
  stage_.present(window_.width(), window_.height());
  hud_.draw(shown_, window_.width(), window_.height());
  window_.swap();
}

Result<void> ViewLoop::run() {
  for (int64_t frames = 0; !control_.quit;) {
    if (interruptedFlag()) return Error{.kind = ErrorKind::kInterrupted, .message = "interrupted"};
    const bool busy_now = busy(nowSeconds()), changed = takeEvents(busy_now);
    if (window_.width() < 1 || window_.height() < 1) {  // minimised
      window_.waitEvents(kIdleWaitS);
      continue;
    }
    const double now = nowSeconds();
    const bool moved = play(now);
    if (!toDraw(now, busy_now, changed || moved)) continue;
    last_ = frames + 1 == options_.frames;
    auto stats = drawScene(now);
    if (!stats) return stats.error();
    noteProgress(*stats, now);
    for (const std::string& text : stage_.takeMessages()) say(text, now);
    if (control_.takeSnapshotRequest()) takeSnapshot(now);
    drawHud(*stats);
    meterFrame();
    guard_.frameShown();
    if (++frames == options_.frames) {
      if (!options_.snapshot_file.empty()) return writeSnapshot(stage_, options_.snapshot_file, options_);
      break;
    }
  }
  return {};
}

// The kinds that all artworks can be shown with.
std::vector<ReliefShading::Kind> possibleShadings(const Stage& stage, const Scene& scene) {
  std::vector<ReliefShading::Kind> kinds;
  for (const auto kind : {ReliefShading::Kind::kSlope, ReliefShading::Kind::kCurvature, ReliefShading::Kind::kDepth}) {
    bool possible = true;
    for (size_t i = 0; i < stage.size(); ++i) {
      Scene shaded = stage.engine(i).scene();
      shaded.shading = scene.shading.kind == kind ? scene.shading : ReliefShading{.kind = kind};
      possible = possible && sceneProblem(shaded, stage.engine(i).manifest()).empty();
    }
    if (possible) kinds.push_back(kind);
  }
  return kinds;
}

}  // namespace

Result<void> runViewer(std::vector<StagedArtwork> artworks, const ViewerOptions& options) {
  HeapWarmer heap(kFirstPictureBytes);
  Result<std::unique_ptr<gl::Window>> made_window =
      gl::Window::create(options.title, options.width_px, options.height_px);
  if (!made_window) return made_window.error();
  gl::Window& window = **made_window;
  if (!gl::currentContextInfo().software) heap.giveBack();
  GuardMaker make{.exaggerate = options.scene.relief ? options.scene.exaggerate : 0, .workers = options.engine.workers};
  for (const StagedArtwork& one : artworks) {
    make.artworks.push_back(one.artwork);
    make.placed.push_back(placedExtent(options.scene, one.artwork.manifest));
    make.placed.back().pose = one.pose;
  }
  const std::vector<PlacedExtent> placed = make.placed;
  Guard guard(std::move(make));
  Result<std::unique_ptr<Stage>> made_stage = Stage::create(std::move(artworks), options.scene, options.engine);
  if (!made_stage) return made_stage.error();
  Stage& stage = **made_stage;
  Result<std::unique_ptr<Hud>> hud = Hud::create(gl::currentContextInfo().api, window.contentScale());
  if (!hud) return hud.error();

  ViewControl::View start;
  start.light = options.scene.light;
  start.lights = options.scene.lights;
  Result<OrbitCamera> camera = options.camera ? options.camera(placed, window.width(), window.height())
                                              : fitCamera(placed, window.width(), window.height());
  if (!camera) return camera.error();
  start.camera = *camera;
  ViewControl control(worldExtent(placed), start, window.width(), window.height(), {[&](double x, double y) {
                        // The picture may be smaller than its window.
                        return stage.surfacePoint(x * stage.width() / window.width(),
                                                  y * stage.height() / window.height());
                      }});
  control.occlusion = options.scene.ambient_occlusion.isOn();
  control.animated = control.playing = options.animation.isOn();
  control.shadows = options.scene.shadows;
  control.gloss = options.scene.gloss.isOn();
  control.shading = options.scene.shading.kind;
  control.shadings = possibleShadings(stage, options.scene);
  control.wireframe = options.scene.wireframe;
  control.show_pages = options.scene.overlay == &kPagesEffect;

  if (Result<void> ended = ViewLoop(window, stage, **hud, control, guard, options).run(); !ended) return ended;
  if (options.print_view) printOutf("%s\n", viewJson(control.view()).c_str());
  return {};
}

}  // namespace relievo
