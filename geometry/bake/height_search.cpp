#include "geometry/bake/height_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "geometry/bake/bake_fit.h"
#include "geometry/bake/bake_probe.h"
#include "geometry/bake/bake_trace.h"
#include "geometry/bake/fidelity.h"

namespace relievo {
namespace {

constexpr int kMaxAutoCellsLog2 = 10;
constexpr uint64_t kMaxSamples = uint64_t{1} << 32;
// Numbers of lines: below the first, tracing takes a second; above the second, minutes.
constexpr double kCheapLines = 1 << 22, kMaxLines = 1 << 26;

class HeightSearch {
 public:
  HeightSearch(const BakeContext& context, const BakeOptions& options, BakeReport& report)
      : context_(context),
        options_(options),
        report_(report),
        vertices_(static_cast<double>(context.mesh->positions_mm.size())),
        tolerance_mm_(options.tolerance_mm > 0 ? options.tolerance_mm : 1e-4 * diagonalOf(*context.mesh)) {}

  Result<BakedHeights> run() {
    report_.tolerance_mm = tolerance_mm_;
    const int min_log2 = automatic() ? minCellsLog2() : options_.cells_log2;
    if (count(min_log2) > static_cast<double>(kMaxSamples))
      return Error{ErrorKind::kUsage, "", "more than 2^32 relief samples: ask for fewer patches or fewer cells", ""};
    auto done = !automatic()       ? bakeRequested(min_log2)
                : context_.all_own ? useNoHeights(min_log2)
                                   : searchFromCoarse(min_log2);
    if (!done) return done.error();
    if (report_.deviation_mm <= tolerance_mm_) report_.limit = BakeLimit::kNone;
    else if (report_.limit == BakeLimit::kNone) report_.limit = BakeLimit::kCells;
    return std::move(baked_);
  }

 private:
  bool automatic() const { return options_.cells_log2 < 0; }
  double count(int log2) const { return std::ldexp(static_cast<double>(context_.layout.patches), 2 * log2); }
  // Without a given tolerance there is at least one sample for two vertices, so that the scan's own detail is kept.
  int minCellsLog2() const {
    const double min_samples = vertices_ / (options_.tolerance_mm > 0 ? 256 : 2);
    int log2 = 1;
    while (log2 < kMaxAutoCellsLog2 && count(log2) < min_samples) ++log2;
    return log2;
  }
  // The grid that is traced for a fit: 16 times as many lines as samples where that takes a second only (0.5 dB better
  // than 4 times), otherwise 4 times as many; the samples alone where more would take minutes, or would only find the
  // scan's own triangles again.
  int tracedLog2(int log2) const {
    const double max_lines = automatic() ? std::clamp(16 * vertices_, kCheapLines, kMaxLines) : kMaxLines;
    return log2 + (count(log2 + 2) <= kCheapLines ? 2 : count(log2 + 1) <= max_lines ? 1 : 0);
  }

  Result<void> bakeRequested(int log2) {
    if (auto traced = traceTo(options_.fit ? tracedLog2(log2) : log2); !traced) return traced;
    return options_.fit ? useFittedHeights(log2, log2) : useScanHeights(log2);
  }
  Result<void> searchFromCoarse(int min_log2);
  BakeLimit limitAt(int log2, double previous_mm) const;

  // Traces at least 2^log2 cells for each patch.
  Result<void> traceTo(int log2) {
    if (traced_.cells_log2 >= log2) return {};
    auto traced = traceSamples(
        context_, log2, probes_,
        [this](double done) {
          if (options_.progress) options_.progress(0.3 + 0.6 * done);
        },
        traced_);
    if (!traced) return traced.error();
    traced_ = std::move(*traced);
    return {};
  }
  // Bakes the scan's own heights at 2^log2 cells for each patch.
  Result<void> useScanHeights(int log2) {
    const SampleLayout& l = context_.layout;
    const size_t n = size_t{1} << log2;
    store(l.subsampled<float>(traced_.heights, size_t{1} << traced_.cells_log2, n), log2, false);
    report_.samples = usedCorners() + l.count(n - 1) - l.corners;
    return {};
  }
  // All that the base shows lies on the scan: any line there would find that.
  Result<void> useNoHeights(int log2) {
    const SampleLayout& l = context_.layout;
    const size_t n = size_t{1} << log2;
    baked_ = BakedHeights(std::vector<float>(l.count(n - 1), 0), log2);
    report_.cells_log2 = log2;
    report_.samples = usedCorners() + l.count(n - 1) - l.corners;
    report_.by_closest_point = 0;
    report_.fitted = false;
    report_.deviation_mm = 0;
    return {};
  }
  // Bakes heights that are fitted to the traced ones, at 2^min_log2 to 2^log2 cells for each patch.
  Result<void> useFittedHeights(int min_log2, int log2) {
    baked_ = {};  // what was stored before is not needed beside the fit
    auto fitted = fitHeights(context_, traced_, {min_log2, log2, tolerance_mm_});
    if (!fitted) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
    store(fitted->heights, log2, true);
    report_.samples = usedCorners() + fitted->samples;
    return {};
  }
  uint64_t usedCorners() const {
    return static_cast<uint64_t>(std::count(context_.corner_used.begin(), context_.corner_used.end(), 1));
  }
  void store(const std::vector<float>& heights, int log2, bool fitted) {
    const auto weights =
        context_.layout.subsampled<uint8_t>(traced_.weights, size_t{1} << traced_.cells_log2, size_t{1} << log2);
    baked_ = BakedHeights(heights, log2);
    report_.cells_log2 = log2;
    report_.by_closest_point = static_cast<uint64_t>(std::count(weights.begin(), weights.end(), 0));
    report_.fitted = fitted;
    report_.deviation_mm = deviationAtProbes(context_, baked_, probes_);
  }

  const BakeContext& context_;
  const BakeOptions& options_;
  BakeReport& report_;
  const double vertices_, tolerance_mm_;
  TracedHeights traced_;
  std::vector<Probe> probes_;
  BakedHeights baked_;
};

// Doubles the cells until the tolerance is kept, or finer grids do not help. Where the coarsest grid keeps it, as with
// dense scans, no fit is needed.
Result<void> HeightSearch::searchFromCoarse(int min_log2) {
  const double& deviation = report_.deviation_mm;
  int log2 = min_log2;
  for (double previous_mm = std::numeric_limits<double>::infinity();; previous_mm = deviation, ++log2) {
    if (auto traced = traceTo(log2); !traced) return traced;
    if (auto taken = useScanHeights(log2); !taken) return taken;
    if (deviation <= tolerance_mm_) break;
    report_.limit = limitAt(log2, previous_mm);
    if (report_.limit != BakeLimit::kNone) break;
  }
  if (!options_.fit || (deviation <= tolerance_mm_ && log2 == min_log2)) return {};
  report_.far_off = options_.fit_within > 0 && deviation > options_.fit_within * tolerance_mm_;
  if (report_.far_off) return {};
  if (deviation > tolerance_mm_)
    if (auto traced = traceTo(tracedLog2(log2)); !traced) return traced;
  return useFittedHeights(min_log2, log2);
}

// Why grids finer than 2^log2 cells are not tried; kNone: they are. previous_mm: the deviation of the next coarser
// grid.
BakeLimit HeightSearch::limitAt(int log2, double previous_mm) const {
  // Small scans may have sharp edges that cross patches. Four million samples take about a second.
  const double max_samples = std::max(vertices_ * (options_.tolerance_mm > 0 ? 256 : 16), 4.0 * (1 << 20));
  // The grid is finer than the scan and hardly better than the one before: what is left does not depend on samples.
  if (count(log2) > 4 * vertices_ && report_.deviation_mm > 0.8 * previous_mm) return BakeLimit::kShape;
  if (log2 >= kMaxAutoCellsLog2) return BakeLimit::kCells;
  return count(log2 + 1) > max_samples ? BakeLimit::kSamples : BakeLimit::kNone;
}

}  // namespace

Result<BakedHeights> searchHeights(const BakeContext& context, const BakeOptions& options, BakeReport& report) {
  return HeightSearch(context, options, report).run();
}

}  // namespace relievo
