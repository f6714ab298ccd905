#include "tools/accuracy/accuracy_measure.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

namespace relievo {
namespace {

constexpr double kSettle_s = 30;
constexpr double kArrive_s = 2;              // the last position is shown by then
constexpr double kMovingFrame_s = 0.15;      // of the flight from one moving frame to the next: fast, so that pages
                                             // are late where settings let them be
constexpr double kFlightFrame_s = 1.0 / 60;  // from CompareCamera::before to now

double nowSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Where the camera was so many seconds before it arrived, with the speed that it arrives with.
OrbitCamera earlier(const CompareCamera& at, double seconds) {
  const double t = seconds / kFlightFrame_s;
  auto back = [t](double now, double before) { return now - t * (now - before); };
  OrbitCamera c = at.now;
  c.azimuth_deg = back(at.now.azimuth_deg, at.before.azimuth_deg);
  c.elevation_deg = std::clamp(back(at.now.elevation_deg, at.before.elevation_deg), -89.0, 89.0);
  c.distance_mm = at.now.distance_mm * std::pow(at.before.distance_mm / at.now.distance_mm, t);
  for (int i = 0; i < 3; ++i) c.target_mm[i] = back(at.now.target_mm[i], at.before.target_mm[i]);
  return c;
}

Error interruptedError() { return {ErrorKind::kInterrupted, "", "interrupted: no report was written", "", {}}; }

}  // namespace

void PictureError::add(const ViewTruth& truth, std::span<const uint8_t> rgba, int width_px, int height_px) {
  for (size_t i = 0; i < truth.pixels.size(); ++i) {
    const auto width = static_cast<size_t>(width_px);
    const size_t row = truth.pixels[i] / width, column = truth.pixels[i] % width;
    const uint8_t* shown = &rgba[4 * ((static_cast<size_t>(height_px) - 1 - row) * width + column)];
    if (shown[3] == 0) {
      ++missing;
      continue;
    }
    ++pixels;
    for (int c = 0; c < 3; ++c) {
      const double off = std::abs(static_cast<double>(shown[c]) - static_cast<double>(truth.colours[i][c]));
      squares += off * off;
      largest = std::max(largest, off);
    }
  }
}

double PictureError::psnrDb() const {
  const double mean = squares / (3 * static_cast<double>(std::max<uint64_t>(1, pixels)));
  return 10 * std::log10(255 * 255 / std::max(mean, 1e-9));
}

Result<std::unique_ptr<Engine>> SettingMeasure::coldStart(const AccuracySetting& setting, SettingSamples* samples) {
  Scene scene;
  scene.light = plan_.light;
  EngineOptions options;
  options.workers = plan_.workers;
  options.interrupted = plan_.interrupted;
  applySetting(setting, scene, options);
  const double start = nowSeconds();
  auto engine = Engine::create(artwork_, scene, options);
  if (!engine) return engine;
  (*engine)->resize(plan_.width_px, plan_.height_px);
  (*engine)->setCamera(earlier(path_[0], plan_.moving_frames * kMovingFrame_s));
  if (auto settled = (*engine)->settle(kSettle_s); !settled) return settled.error();
  StrategyPass::finish();
  if (samples) samples->cold_ms.push_back(1000 * (nowSeconds() - start));
  return engine;
}

// A frame is drawn with the newest patch list, mostly that of the camera a frame before; where a list takes long, a
// frame shows what the last one showed, and costs little. So what counts is not a frame's time but the time for each
// position of the camera that is shown, up to and with the last one.
Result<double> SettingMeasure::arrive(Engine& engine, size_t view) {
  const CompareCamera& camera = path_[view];
  engine.setCamera(earlier(camera, plan_.moving_frames * kMovingFrame_s));
  if (auto settled = engine.settle(kSettle_s); !settled) return settled.error();
  glm::dmat4 shown = engine.view().clip_from_world;
  int positions = 0;
  StrategyPass::finish();
  const double start = nowSeconds();
  auto drawFrame = [&](const OrbitCamera& at) {
    engine.setCamera(at);
    engine.frame(nowSeconds());
    StrategyPass::finish();
    const glm::dmat4 before = std::exchange(shown, engine.view().clip_from_world);
    positions += shown != before;
  };
  for (int k = plan_.moving_frames - 1; k >= 0; --k) {
    OrbitCamera at = earlier(camera, k * kMovingFrame_s);
    // Where a flight stands still: so little that nothing else is seen, but geometry is drawn anew.
    at.azimuth_deg += k % 2 == 0 ? 0 : 1e-6;
    drawFrame(at);
    if (plan_.interrupted && *plan_.interrupted) return interruptedError();
  }
  const double last_start = nowSeconds();
  while (shown != truths_[view].view.clip_from_world && nowSeconds() < last_start + kArrive_s) drawFrame(camera.now);
  return 1000 * (nowSeconds() - start) / std::max(1, positions);
}

// Median of the frames of a view that stands still.
double SettingMeasure::stillFrameMs(Engine& engine) const {
  engine.frame(nowSeconds());  // the first frame after settling may draw the surface once more
  std::vector<double> ms;
  for (int k = 0; k < plan_.still_frames; ++k) {
    StrategyPass::finish();
    const double start = nowSeconds();
    engine.frame(nowSeconds());
    StrategyPass::finish();
    ms.push_back(1000 * (nowSeconds() - start));
  }
  return spreadOf(std::move(ms)).median;
}

Result<void> SettingMeasure::measureGeometry(Engine& engine, const ViewTruth& truth, AccuracyFigures& out) {
  StrategyPass& pass = rebuilt_pass_ ? *rebuilt_pass_ : truth_.pass();
  StrategyResult chosen;
  chosen.instances = engine.instances();
  // A tail's heights are samples of its patch's root page, which this pass has in its place.
  for (PatchInstance& p : chosen.instances)
    if (p.relief_page.level == kTailLevel) p.relief_page = {p.node.patch, 0, 0, 0};
  if (auto drawn = pass.draw(chosen, truth.view, 1); !drawn) return drawn.error();
  PlacePixels pixels;
  ErrorVectors errors;
  pass.read(pixels);
  errorVectors(truth_.surface(), chosen.instances, {truth.view, plan_.width_px, plan_.height_px}, pixels, errors);
  const ErrorFigures f = figuresOf(errors);
  out.geometry_px = std::max(out.geometry_px, f.max_px);
  out.geometry_p99_px = std::max(out.geometry_p99_px, f.p99_px);
  for (size_t i = 0; i < errors.size(); ++i)
    if (!std::isnan(errors[i].x))
      out.geometry_mm = std::max(out.geometry_mm, static_cast<double>(glm::length(errors[i]) * truth.mm_per_px[i]));
  out.predicted_px = std::max(out.predicted_px, engine.stats().predicted_error_px);
  return {};
}

// compared: settled pictures and geometry, too, which are the same in every round.
Result<void> SettingMeasure::passOverPath(Engine& engine, SettingSamples& samples, bool compared) {
  AccuracyFigures& out = samples.figures;
  double moving_ms = 0, still_ms = 0;
  for (size_t v = 0; v < path_.size(); ++v) {
    auto moved = arrive(engine, v);
    if (!moved) return moved.error();
    moving_ms += *moved;
    samples.moving.add(truths_[v], engine.readPixels(), plan_.width_px, plan_.height_px);
    if (auto settled = engine.settle(kSettle_s); !settled) return settled;
    samples.triangles.push_back(engine.stats().triangles);
    out.bytes_resident = std::max(out.bytes_resident, engine.stats().streamer.resident_bytes);
    if (compared) {
      samples.settled.add(truths_[v], engine.readPixels(), plan_.width_px, plan_.height_px);
      if (auto measured = measureGeometry(engine, truths_[v], out); !measured) return measured;
    }
    still_ms += stillFrameMs(engine);
    if (plan_.interrupted && *plan_.interrupted) return interruptedError();
  }
  samples.moving_ms.push_back(moving_ms / static_cast<double>(path_.size()));
  samples.still_ms.push_back(still_ms / static_cast<double>(path_.size()));
  return {};
}

// Relief of fewer bits has places of its own.
Result<void> SettingMeasure::prepareRelief(const AccuracySetting& setting) {
  rebuilt_pass_.reset();
  if (setting.relief_bits >= 16) return {};
  auto scene =
      loadCompareScene(plan_.package, plan_.memory_bytes, api_, &rebuilt_pass_, plan_.interrupted, rebuilt_.get());
  if (!scene) return scene.error();
  rebuilt_pass_->resize(plan_.width_px, plan_.height_px);
  return {};
}

Result<void> SettingMeasure::prepare(const AccuracySetting& setting) {
  auto artwork = artworkOf(plan_.package, setting, &rebuilt_);
  if (!artwork) return artwork.error();
  artwork_ = std::move(*artwork);
  if (auto relief = prepareRelief(setting); !relief) return relief;
  if (!rebuilt_) return {};
  // Once without a clock: encoding is no part of what a package that was built so takes.
  auto engine = coldStart(setting, nullptr);
  if (!engine) return engine.error();
  SettingSamples unused;
  return passOverPath(**engine, unused, false);
}

Result<void> SettingMeasure::round(const AccuracySetting& setting, SettingSamples& samples) {
  if (auto ready = prepare(setting); !ready) return ready.error();
  for (int k = 1; k < plan_.cold_starts; ++k)
    if (auto engine = coldStart(setting, &samples); !engine) return engine.error();
  auto engine = coldStart(setting, &samples);
  if (!engine) return engine.error();
  const bool first = samples.rounds++ == 0;
  if (auto passed = passOverPath(**engine, samples, first); !passed) return passed;
  if (!first) return {};
  for (uint64_t bytes : (*engine)->stats().streamer.bytes_read) samples.figures.bytes_read += bytes;
  if (rebuilt_ && rebuilt_->encodedPages() > 0)
    samples.figures.build_s = rebuilt_->encodedSeconds() * static_cast<double>(plan_.package->manifest().page_count) /
                              static_cast<double>(rebuilt_->encodedPages());
  return {};
}

AccuracyFigures figuresOf(const SettingSamples& samples) {
  AccuracyFigures out = samples.figures;
  out.psnr_db = samples.settled.psnrDb();
  out.largest = samples.settled.largest;
  out.missing_pixels = samples.settled.missing;
  out.moving_psnr_db = samples.moving.psnrDb();
  out.triangles = spreadOf(samples.triangles).median;
  out.moving_ms = spreadOf(samples.moving_ms);
  out.still_ms = spreadOf(samples.still_ms);
  out.cold_ms = spreadOf(samples.cold_ms);
  return out;
}

}  // namespace relievo
