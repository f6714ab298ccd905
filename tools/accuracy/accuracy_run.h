// accuracy_run.h - every knob's values, one at a time, then combinations of them, measured along one camera path
// against the truth (truth.h): figures, for the reports. Needs a current GL context.
//
// The path has views of three flights in turn: around the artwork, over it at a slant, and close to it
// (tools/compare/compare_path.h); or of the cameras that it is given. Which moments of the flights they are is drawn by
// the seed. Before each view the camera comes along the flight's direction for some frames, 0.15 s of the flight each,
// which at 60 frames/s is nine times its speed: these are the moving ones, and pages are late in them where settings
// let them be. Then the view settles, and stands still.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "src/gl/context.h"
#include "tools/accuracy/knobs.h"
#include "tools/accuracy/truth.h"
#include "tools/compare/compare_path.h"

namespace relievo {

struct AccuracyPlan {
  std::shared_ptr<const Package> package;
  std::array<double, 3> light{-0.6, 0.5, 0.6};
  uint32_t seed = 1;
  int views = 6;
  std::vector<CompareCamera> cameras;  // of a path in the place of the flights, at even times; usually empty
  int width_px = 1280, height_px = 720;
  int moving_frames = 12, still_frames = 9;  // timed, a view
  int passes = 3;       // rounds over all settings: each flies the path once, with an engine of its own
  int cold_starts = 2;  // a round
  int one_of = 1;       // TruthOptions::one_of
  int combinations = 40;
  int workers = 2;
  uint64_t memory_bytes = uint64_t{1} << 30;
  uint64_t reference_triangles = 40'000'000;
  std::vector<AccuracyKnob> knobs;
  double cache_mib = EngineOptions{}.cache_mib;  // of all settings but those of the cache's knob
  const std::atomic<bool>* interrupted = nullptr;
  std::function<void(double fraction, const std::string& what)> progress;
};

// Of repeated measurements: median and quartiles.
struct Spread {
  double median = 0, low = 0, high = 0;
  size_t count = 0;
};
Spread spreadOf(std::vector<double> values);

struct AccuracyFigures {
  double psnr_db = 0;         // of settled views; of a picture that is right but for rounding to bytes: 58.9
  double largest = 0;         // largest error of a channel, of 255
  double moving_psnr_db = 0;  // of the last moving frames
  double geometry_px = 0, geometry_p99_px = 0, geometry_mm = 0;  // largest, of 99 % of the pixels; largest
  double predicted_px = 0;                                       // the bound that the renderer states
  double triangles = 0;                                          // median
  Spread moving_ms, still_ms, cold_ms;
  uint64_t bytes_read = 0, bytes_resident = 0;  // over the path, from a cold start; at most
  double build_s = -1;  // CPU time of encoding all its pages again, extrapolated from those read; negative: not built
  uint64_t missing_pixels = 0;  // background where the truth shows the artwork, edges left out
};

struct AccuracyRow {
  std::string knob, label;  // of a combination "combination" and its number; of the base "base" and "default"
  AccuracySetting setting;
  AccuracyFigures figures;
  std::string problem;  // not empty: it could not be measured, and this is why; the figures mean nothing
};

struct AccuracyResult {
  std::string renderer, version;
  std::vector<AccuracyRow> rows;
  std::vector<OrbitCamera> cameras;
  uint64_t truth_pixels = 0, covered_pixels = 0, edge_pixels = 0, unsolved_pixels = 0;  // all views
  bool truth_whole = true;
  // The base, measured again between the others: what measuring itself is uncertain by.
  Spread control_moving_ms, control_still_ms, control_cold_ms;
  double control_psnr_db = 0;  // the largest difference of its PSNR; settled pictures should not differ at all
};

// The path's cameras: where each view is, and how the camera moves as it arrives there (a 60th of a second earlier).
Result<std::vector<CompareCamera>> accuracyPath(const AccuracyPlan& plan);
// Gives the plan and its knobs the cache that this artwork needs, as render does, with a notice where that is more than
// the default one. Needs a current GL context.
Result<void> fitCache(AccuracyPlan& plan, std::vector<std::string>& notices);
Result<AccuracyResult> runAccuracy(const AccuracyPlan& plan, const gl::ContextInfo& context);

}  // namespace relievo
