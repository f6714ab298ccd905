// compare_run.h - every strategy with every budget over every frame: figures, for the reports (compare_report.h).
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "geometry/strategies/lod_strategy.h"
#include "src/gl/context.h"
#include "texturing/package/package.h"
#include "tools/compare/compare_measure.h"
#include "tools/compare/compare_path.h"

namespace relievo {

// Where, when and from what a report was made, for people. Empty texts: not known.
struct CompareOrigin {
  std::string command, date, cpu, package_hash, source;  // source: of the artwork, with its seed where it has one
};

struct ComparePlan {
  CompareOrigin origin;
  std::shared_ptr<const Package> package;
  std::string path = "orbit";
  std::vector<CompareCamera> cameras;  // in the path's place, which is then a name for people; usually empty
  std::vector<const StrategyEntry*> strategies;
  std::vector<double> budgets_px;
  int frames = 24;
  int width_px = 1280, height_px = 720;
  double exaggerate = 1;
  double least_cell = 2;                      // as Scene::least_cell; most strategies set it aside
  double measured_exaggerate = 0;             // of the truth, for tests: another one than is drawn; 0: the same
  int repeats = 5;                            // of what is timed, at most
  double repeat_s = 3;                        // no further ones once they took this long
  uint64_t memory_bytes = uint64_t{1} << 30;  // for relief pages
  uint64_t reference_triangles = 40'000'000;  // a frame, see CompareFigures::reference_whole
  uint32_t seam_vertices = 40'000'000;        // no comparison of seams above that
  const std::atomic<bool>* interrupted = nullptr;
  std::function<void(double fraction, const std::string& what)> progress;
};

struct Timing {
  double median = 0, low = 0, high = 0;  // ms; the fastest and the slowest of the repeats
};

// From an empty cache until all that a view draws from has come. What it takes to choose (errors, boxes) is not
// counted.
inline constexpr int kLinkRates[] = {5, 20, 100};  // MB/s
struct ColdStart {
  double bytes = 0, decode_ms = 0;
  bool known() const { return bytes >= 1; }  // reports of before cold starts were counted have none
  // Reading at that rate or, beside it, decoding by one thread: whichever takes longer.
  double ms(double mb_per_s) const { return std::max(bytes / (1000 * mb_per_s), decode_ms); }
};

struct FrameFigures {
  ErrorFigures error;
  double budget_px = 0;         // that the strategy kept to: as asked for, or doubled where a node budget ran out
  double predicted_px = -1;     // negative: nothing is promised
  uint64_t edge_on_pixels = 0;  // not measured
  CoverageFigures coverage;
  SeamFigures seams;
  bool seams_known = false;
  double pop_px = 0;
  uint64_t triangles = 0;
  uint32_t draw_calls = 0, instances = 0;
  uint64_t resident_bytes = 0;  // of the relief pages that the choice displaces from, in the page cache; or of its mesh
  // As they are encoded, pages by the package or parts of a mesh: those that the choice draws from, which is what an
  // empty cache has to read; and of them those that the frame before did not need.
  uint64_t cold_bytes = 0, streamed_bytes = 0;
  double cold_decode_ms = 0;  // decoding cold_bytes, by one thread
  Timing select_ms, frame_ms;
};

struct StrategyFigures {
  const StrategyEntry* strategy = nullptr;
  double budget_px = 0;
  bool available = true;  // false: not in this context or over this artwork; nothing else holds
  std::string why_not;    // then
  std::vector<FrameFigures> frames;
  // The frame that is shown in the report.
  std::vector<float> picture_error_px;  // rows bottom first; not a number where nothing is drawn
  std::vector<float> picture_shade;     // 0..1
};

struct CompareFigures {
  std::string renderer, version;
  int picture_frame = 0;
  size_t frame_count = 0;
  uint64_t relief_pages = 0, relief_bytes = 0;  // in memory: of pages that are alike one
  bool reference_whole = true;  // false: silhouettes are those of a uniform grid that is coarser than full resolution
  uint64_t reference_triangles = 0;  // at most, a frame
  ErrorFigures floor;  // the reference measured like a strategy: what measuring itself is off by (worst frame)
  double reference_bound_px = 0;
  std::vector<StrategyFigures> runs;  // strategies in order, budgets within
};

Result<CompareFigures> runCompare(const ComparePlan& plan, const gl::ContextInfo& context);

}  // namespace relievo
