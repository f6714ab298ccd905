#include "geometry/bake/bake_fit.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "geometry/bake/height_fit.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// Does the grid of `cells` cells keep the tolerance at 99.8 % of the data, with a root mean square of a fifth of it?
// For the default tolerance of 1e-4 of the diagonal this is 94 dB, with room for what no height can follow. Most
// patches keep the tolerance with room, so that 99.8 % of each are 99.9 % of the whole (measured on a bust).
bool withinTolerance(const HeightData& data, size_t data_cells, std::span<const float> nodes, size_t cells,
                     double tolerance_mm) {
  constexpr double kRmsShare = 0.2, kPercentile = 0.998;
  const size_t step = data_cells / cells, row = cells + 1;
  size_t count = 0, within = 0;
  double squares = 0;
  for (size_t y = 0; y <= data_cells; ++y) {
    const size_t cy = std::min(y / step, cells - 1);
    const float fy = static_cast<float>(y - cy * step) / static_cast<float>(step);
    for (size_t x = 0; x <= data_cells; ++x) {
      const size_t i = y * (data_cells + 1) + x;
      if (data.weights[i] == 0) continue;
      const size_t cx = std::min(x / step, cells - 1);
      const float fx = static_cast<float>(x - cx * step) / static_cast<float>(step);
      const float* c = nodes.data() + cy * row + cx;
      const float d = std::abs(data.heights[i] - interpolateOnCell<float>(c[0], c[1], c[row], c[row + 1], fx, fy)) *
                      static_cast<float>(data.weights[i]) / 255;
      squares += double{d} * d;
      ++count;
      within += d <= tolerance_mm;
    }
  }
  if (count == 0) return true;
  if (squares > kRmsShare * kRmsShare * tolerance_mm * tolerance_mm * static_cast<double>(count)) return false;
  // The deviation of this rank is within the tolerance where more deviations are.
  return within > static_cast<size_t>(static_cast<double>(count - 1) * kPercentile);
}

// Fits in three steps, so that every shared sample is found once, from data that all of its patches share: first each
// side alone with free ends, whose mean at a corner becomes the corner's height; then the sides between fixed corners;
// then the interior of each patch. Each patch gets the fewest cells that keep the tolerance; a side gets as many as the
// finer of its patches.
class HeightFit {
 public:
  HeightFit(const BakeContext& context, const TracedHeights& fine, const HeightFitOptions& options)
      : context_(context), fine_(fine), options_(options), fine_n_(size_t{1} << fine.cells_log2) {}
  // False: the bake was interrupted.
  bool run() {
    fitted_.heights = context_.layout.subsampled<float>(fine_.heights, fine_n_, size_t{1} << options_.cells_log2);
    if (!fitCorners() || !fitAllSides() || !choosePatchCells()) return false;
    writeSides();
    sides_by_log2_.clear();
    return fitInteriors();
  }
  FittedHeights take() { return std::move(fitted_); }

 private:
  // Fits all sides at 2^log2 cells. out: (2^log2 + 1) heights for each side, in order, ends included.
  bool fitSides(int log2, Ends ends, std::vector<float>& out) const;
  bool fitCorners();
  bool fitAllSides();
  bool choosePatchCells();
  void writeSides();
  bool fitInteriors();

  // The traced heights of one patch's grid, and their weights.
  struct PatchData {
    std::vector<float> heights;
    std::vector<uint8_t> weights;
    operator HeightData() const { return {heights, weights}; }
  };
  PatchData dataOf(uint32_t patch) const;
  // Fits the inner nodes of a patch, (cells + 1)^2, whose border is given.
  void fitInterior(const HeightData& data, std::vector<float>& nodes, size_t cells) const;

  const BakeContext& context_;
  const TracedHeights& fine_;
  const HeightFitOptions options_;
  const size_t fine_n_;
  FittedHeights fitted_;
  std::vector<std::vector<float>> sides_by_log2_;  // by log2 of the number of cells
  std::vector<uint8_t> patch_log2_;                // each patch's own number of cells
};

bool HeightFit::fitSides(int log2, Ends ends, std::vector<float>& out) const {
  constexpr size_t kSidesPerJob = 64;
  const SampleLayout& l = context_.layout;
  const size_t cells = size_t{1} << log2, step = fine_n_ / cells;
  out.resize(l.sides.size() * (cells + 1));
  return parallelFor(
      (l.sides.size() + kSidesPerJob - 1) / kSidesPerJob, context_.workers, context_.interrupted, [&](size_t job) {
        std::vector<float> data(fine_n_ + 1);
        std::vector<uint8_t> weights(fine_n_ + 1);
        for (size_t side = job * kSidesPerJob; side < std::min(l.sides.size(), (job + 1) * kSidesPerJob); ++side) {
          l.gatherSide<float>(side, fine_n_ - 1, fine_.heights, data);
          l.gatherSide<uint8_t>(side, fine_n_ - 1, fine_.weights, weights);
          const auto nodes = std::span(out).subspan(side * (cells + 1), cells + 1);
          for (size_t i = 0; i <= cells; ++i) nodes[i] = data[i * step];
          if (ends == Ends::kFixed) {
            nodes.front() = fitted_.heights[l.sides[side][0]];
            nodes.back() = fitted_.heights[l.sides[side][1]];
          }
          if (step > 1) fitLine({data, weights}, ends, nodes);
        }
      });
}

bool HeightFit::fitCorners() {
  const SampleLayout& l = context_.layout;
  const size_t n = size_t{1} << options_.cells_log2;
  std::vector<float> sides;
  if (!fitSides(options_.cells_log2, Ends::kFree, sides)) return false;
  std::vector<double> sum(l.corners, 0);
  std::vector<uint32_t> side_count(l.corners, 0);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    for (size_t k = 0; k < 2; ++k) {
      sum[l.sides[side][k]] += sides[side * (n + 1) + k * n];
      ++side_count[l.sides[side][k]];
    }
  }
  for (size_t i = 0; i < l.corners; ++i)
    if (side_count[i] && fine_.weights[i]) fitted_.heights[i] = static_cast<float>(sum[i] / side_count[i]);
  return true;
}

bool HeightFit::fitAllSides() {
  sides_by_log2_.resize(static_cast<size_t>(options_.cells_log2) + 1);
  for (int log2 = options_.min_cells_log2; log2 <= options_.cells_log2; ++log2)
    if (!fitSides(log2, Ends::kFixed, sides_by_log2_[static_cast<size_t>(log2)])) return false;
  return true;
}

HeightFit::PatchData HeightFit::dataOf(uint32_t patch) const {
  const size_t count = (fine_n_ + 1) * (fine_n_ + 1);
  PatchData data{std::vector<float>(count), std::vector<uint8_t>(count)};
  context_.layout.gather<float>(context_.base, patch, fine_n_ - 1, fine_.heights, data.heights);
  context_.layout.gather<uint8_t>(context_.base, patch, fine_n_ - 1, fine_.weights, data.weights);
  return data;
}

void HeightFit::fitInterior(const HeightData& data, std::vector<float>& nodes, size_t cells) const {
  const size_t step = fine_n_ / cells;
  for (size_t y = 1; y < cells; ++y)
    for (size_t x = 1; x < cells; ++x) nodes[y * (cells + 1) + x] = data.heights[(y * (fine_n_ + 1) + x) * step];
  if (step > 1) fitGrid(data, fine_n_ + 1, nodes, cells + 1);
}

bool HeightFit::choosePatchCells() {
  const SampleLayout& l = context_.layout;
  patch_log2_.assign(l.patches, static_cast<uint8_t>(options_.cells_log2));
  if (options_.min_cells_log2 == options_.cells_log2) return true;
  return parallelFor(l.patches, context_.workers, context_.interrupted, [&](size_t patch) {
    const auto p = static_cast<uint32_t>(patch);
    std::vector<float> nodes;
    const PatchData data = dataOf(p);
    for (int log2 = options_.min_cells_log2; log2 < options_.cells_log2; ++log2) {
      const size_t cells = size_t{1} << log2;
      nodes.resize((cells + 1) * (cells + 1));
      const std::vector<float>& border = sides_by_log2_[static_cast<size_t>(log2)];
      for (size_t s = 0; s < 4; ++s)
        l.setSide<float>(context_.base, p, s, cells,
                         std::span(border).subspan(l.patch_sides[p][s] * (cells + 1), cells + 1), nodes);
      fitInterior(data, nodes, cells);
      if (!withinTolerance(data, fine_n_, nodes, cells, options_.tolerance_mm)) continue;
      patch_log2_[p] = static_cast<uint8_t>(log2);
      break;
    }
  });
}

void HeightFit::writeSides() {
  const SampleLayout& l = context_.layout;
  const size_t n = size_t{1} << options_.cells_log2, m = n - 1;
  std::vector<uint8_t> side_log2(l.sides.size(), 0);
  for (size_t p = 0; p < l.patches; ++p)
    for (uint32_t side : l.patch_sides[p]) side_log2[side] = std::max(side_log2[side], patch_log2_[p]);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t cells = size_t{1} << side_log2[side], step = n / cells;
    const float* nodes = sides_by_log2_[side_log2[side]].data() + side * (cells + 1);
    for (size_t i = 1; i < n; ++i) {
      const size_t cell = i / step;
      const float t = static_cast<float>(i - cell * step) / static_cast<float>(step);
      fitted_.heights[l.sideBegin(side, m) + i - 1] = t > 0 ? nodes[cell] * (1 - t) + nodes[cell + 1] * t : nodes[cell];
    }
    fitted_.samples += cells - 1;
  }
  for (uint8_t log2 : patch_log2_) fitted_.samples += ((size_t{1} << log2) - 1) * ((size_t{1} << log2) - 1);
}

bool HeightFit::fitInteriors() {
  const SampleLayout& l = context_.layout;
  const size_t n = size_t{1} << options_.cells_log2, m = n - 1;
  return parallelFor(l.patches, context_.workers, context_.interrupted, [&](size_t patch) {
    const auto p = static_cast<uint32_t>(patch);
    const size_t cells = size_t{1} << patch_log2_[p], step = n / cells;
    std::vector<float> nodes((cells + 1) * (cells + 1));
    {
      std::vector<float> whole((n + 1) * (n + 1));
      l.gather<float>(context_.base, p, m, fitted_.heights, whole);
      for (size_t y = 0; y <= cells; ++y)
        for (size_t x = 0; x <= cells; ++x) nodes[y * (cells + 1) + x] = whole[(y * (n + 1) + x) * step];
    }
    fitInterior(dataOf(p), nodes, cells);
    float* out = fitted_.heights.data() + l.interiorBegin(patch, m);
    for (size_t y = 1; y < n; ++y) {
      for (size_t x = 1; x < n; ++x) {
        const size_t cx = x / step, cy = y / step;
        const float* c = nodes.data() + cy * (cells + 1) + cx;
        const double fx = static_cast<double>(x - cx * step) / static_cast<double>(step),
                     fy = static_cast<double>(y - cy * step) / static_cast<double>(step);
        *out++ = static_cast<float>(interpolateOnCell<double>(c[0], c[1], c[cells + 1], c[cells + 2], fx, fy));
      }
    }
  });
}

}  // namespace

std::optional<FittedHeights> fitHeights(const BakeContext& context, const TracedHeights& fine,
                                        const HeightFitOptions& options) {
  HeightFit fit(context, fine, options);
  if (!fit.run()) return std::nullopt;
  return fit.take();
}

}  // namespace relievo
