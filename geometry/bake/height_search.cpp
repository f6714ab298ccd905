#include "geometry/bake/height_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "geometry/bake/bake_fit.h"
#include "geometry/bake/bake_probe.h"
#include "geometry/bake/bake_trace.h"

namespace relievo {
namespace {

constexpr int kMaxAutoCellsLog2 = 10;
constexpr uint64_t kMaxSamples = uint64_t{1} << 32;
// Lines for a fit.
constexpr double kManyLines = 1 << 23, kMostLines = 1 << 26;

double diagonalOf(const TriMesh& mesh) {
  glm::vec3 low = mesh.positions_mm[mesh.triangles[0][0]], high = low;
  for (const glm::vec3& p : mesh.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  return glm::length(glm::dvec3(high) - glm::dvec3(low));
}

class HeightSearch {
 public:
  HeightSearch(const BakeGround& ground, const BakeOptions& options, BakeReport& report)
      : ground_(ground),
        options_(options),
        report_(report),
        vertices_(static_cast<double>(ground.mesh->positions_mm.size())),
        tolerance_mm_(options.tolerance_mm > 0 ? options.tolerance_mm : 1e-4 * diagonalOf(*ground.mesh)) {}

  Result<BakedHeights> run() {
    report_.tolerance_mm = tolerance_mm_;
    const int least_log2 = automatic() ? leastCells() : options_.cells_log2;
    if (count(least_log2) > static_cast<double>(kMaxSamples))
      return Error{ErrorKind::kUsage, "", "more than 2^32 relief samples: ask for fewer patches or fewer cells", ""};
    auto done = automatic() ? fromCoarse(least_log2) : asAsked(least_log2);
    if (!done) return done.error();
    if (report_.deviation_mm <= tolerance_mm_) report_.limit = BakeLimit::kNone;
    else if (report_.limit == BakeLimit::kNone) report_.limit = BakeLimit::kCells;
    return std::move(baked_);
  }

 private:
  bool automatic() const { return options_.cells_log2 < 0; }
  double count(int log2) const { return std::ldexp(static_cast<double>(ground_.layout.patches), 2 * log2); }
  // Unless a tolerance says what does not matter, the scan's own detail does: at least a sample for two vertices.
  int leastCells() const {
    const double least = vertices_ / (options_.tolerance_mm > 0 ? 256 : 2);
    int log2 = 1;
    while (log2 < kMaxAutoCellsLog2 && count(log2) < least) ++log2;
    return log2;
  }
  // Lines for a fit: four times as many as samples; sixteen times where that takes no more than some seconds (0.5 dB
  // better). None where it took minutes, or where the samples are so dense already that more would only find the scan's
  // own triangles again.
  int finer(int log2) const {
    const double most_lines = automatic() ? std::clamp(16 * vertices_, kManyLines, kMostLines) : kMostLines;
    return log2 + (count(log2 + 2) <= kManyLines ? 2 : count(log2 + 1) <= most_lines ? 1 : 0);
  }

  Result<void> asAsked(int log2) {
    if (auto looked = look(options_.fit ? finer(log2) : log2); !looked) return looked;
    return options_.fit ? takeFit(log2, log2) : takeScan(log2);
  }
  Result<void> fromCoarse(int least_log2);
  BakeLimit limitAt(int log2, double before) const;

  // Lines for 2^log2 cells a patch, unless there are as many.
  Result<void> look(int log2) {
    if (traced_.cells_log2 >= log2) return {};
    auto traced = traceSamples(ground_, log2, probes_, [this](double done) {
      if (options_.progress) options_.progress(0.3 + 0.6 * done);
    });
    if (!traced) return traced.error();
    traced_ = std::move(*traced);
    return {};
  }
  // The scan's own heights, at 2^log2 cells a patch.
  Result<void> takeScan(int log2) {
    const SampleLayout& l = ground_.layout;
    const size_t n = size_t{1} << log2;
    keep(l.everyOther<float>(traced_.heights, size_t{1} << traced_.cells_log2, n), log2, false);
    report_.samples = usedCorners() + l.count(n - 1) - l.corners;
    return {};
  }
  // Heights of at most 2^log2 cells a patch, fitted to what is known.
  Result<void> takeFit(int least_log2, int log2) {
    auto fitted = fitHeights(ground_, traced_, {least_log2, log2, tolerance_mm_});
    if (!fitted) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
    keep(fitted->heights, log2, true);
    report_.samples = usedCorners() + fitted->samples;
    return {};
  }
  uint64_t usedCorners() const {
    return static_cast<uint64_t>(std::count(ground_.used.begin(), ground_.used.end(), 1));
  }
  void keep(const std::vector<float>& heights, int log2, bool fitted) {
    const auto weights =
        ground_.layout.everyOther<uint8_t>(traced_.weights, size_t{1} << traced_.cells_log2, size_t{1} << log2);
    baked_ = BakedHeights(heights, log2);
    report_.cells_log2 = log2;
    report_.by_closest_point = static_cast<uint64_t>(std::count(weights.begin(), weights.end(), 0));
    report_.fitted = fitted;
    report_.deviation_mm = deviationAtProbes(ground_, baked_, probes_);
  }

  const BakeGround& ground_;
  const BakeOptions& options_;
  BakeReport& report_;
  const double vertices_, tolerance_mm_;
  Traced traced_;
  std::vector<Probe> probes_;
  BakedHeights baked_;
};

// Dense scans keep the tolerance with their own heights, and are baked sooner.
Result<void> HeightSearch::fromCoarse(int least_log2) {
  const double& deviation = report_.deviation_mm;
  int log2 = least_log2;
  for (double before = std::numeric_limits<double>::infinity();; before = deviation, ++log2) {
    if (auto looked = look(log2); !looked) return looked;
    if (auto taken = takeScan(log2); !taken) return taken;
    if (deviation <= tolerance_mm_) break;
    report_.limit = limitAt(log2, before);
    if (report_.limit != BakeLimit::kNone) break;
  }
  if (!options_.fit || (deviation <= tolerance_mm_ && log2 == least_log2)) return {};
  if (deviation > tolerance_mm_)
    if (auto looked = look(finer(log2)); !looked) return looked;
  return takeFit(least_log2, log2);
}

// Why grids finer than 2^log2 cells are not tried. before: the deviation of the grid before it.
BakeLimit HeightSearch::limitAt(int log2, double before) const {
  // Small scans may have sharp edges that patches cross: four million samples take about a second.
  const double most = std::max(vertices_ * (options_.tolerance_mm > 0 ? 256 : 16), 4.0 * (1 << 20));
  // Finer than the scan, and hardly better: what is left is not a matter of samples.
  if (count(log2) > 4 * vertices_ && report_.deviation_mm > 0.8 * before) return BakeLimit::kShape;
  if (log2 >= kMaxAutoCellsLog2) return BakeLimit::kCells;
  return count(log2 + 1) > most ? BakeLimit::kSamples : BakeLimit::kNone;
}

}  // namespace

Result<BakedHeights> searchHeights(const BakeGround& ground, const BakeOptions& options, BakeReport& report) {
  return HeightSearch(ground, options, report).run();
}

}  // namespace relievo
