#include "geometry/bake/bake_fit.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "geometry/bake/height_fit.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// Does the grid of `cells` cells keep the tolerance at nearly all of the data, and a fifth of it in their root mean
// square? A tolerance of 1e-4 of the diagonal is 94 dB then, with room for what no height shows; and 99.8 % of each
// patch were 99.9 % of a bust's, since most keep it with room. off: scratch.
bool keeps(const HeightData& data, size_t data_cells, std::span<const float> nodes, size_t cells, double tolerance_mm,
           std::vector<float>& off) {
  constexpr double kRms = 0.2, kShare = 0.998;
  const size_t step = data_cells / cells, row = cells + 1;
  off.clear();
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
      const float d = std::abs(data.heights[i] - onCell<float>(c[0], c[1], c[row], c[row + 1], fx, fy)) *
                      static_cast<float>(data.weights[i]) / 255;
      squares += double{d} * d;
      off.push_back(d);
    }
  }
  if (off.empty()) return true;
  if (squares > kRms * kRms * tolerance_mm * tolerance_mm * static_cast<double>(off.size())) return false;
  const auto rank = off.begin() + static_cast<ptrdiff_t>(static_cast<double>(off.size() - 1) * kShare);
  std::nth_element(off.begin(), rank, off.end());
  return *rank <= tolerance_mm;
}

// Least squares: sides by themselves with free ends, whose means are the corners; sides again between these; then the
// inside. So every shared sample is found once, from what all of its patches share. Each patch has as few cells as keep
// the tolerance, a side as many as the finer of its patches; between its samples there are those of the triangles.
class HeightFit {
 public:
  HeightFit(const BakeGround& ground, const Traced& fine, const HeightFitOptions& how)
      : ground_(ground), fine_(fine), how_(how), fine_n_(size_t{1} << fine.cells_log2) {}
  // False: interrupted.
  bool run() {
    fitted_.heights = ground_.layout.everyOther<float>(fine_.heights, fine_n_, size_t{1} << how_.cells_log2);
    if (!placeCorners() || !fitAllSides() || !choosePatchCells()) return false;
    placeSides();
    sides_by_log2_.clear();
    return fitInsides();
  }
  FittedHeights take() { return std::move(fitted_); }

 private:
  // The sides with 2^log2 cells, one after the other, with both ends.
  bool fitSides(int log2, Ends ends, std::vector<float>& out) const;
  bool placeCorners();
  bool fitAllSides();
  bool choosePatchCells();
  void placeSides();
  bool fitInsides();

  // What the lines of a patch met.
  struct PatchData {
    std::vector<float> heights;
    std::vector<uint8_t> weights;
    operator HeightData() const { return {heights, weights}; }
  };
  PatchData dataOf(uint32_t patch) const;
  // A patch with its border given, (cells + 1)^2.
  void fitInside(const HeightData& data, std::vector<float>& nodes, size_t cells) const;

  const BakeGround& ground_;
  const Traced& fine_;
  const HeightFitOptions how_;
  const size_t fine_n_;
  FittedHeights fitted_;
  std::vector<std::vector<float>> sides_by_log2_;  // of each number of cells
  std::vector<uint8_t> patch_log2_;                // a patch's own cells
};

bool HeightFit::fitSides(int log2, Ends ends, std::vector<float>& out) const {
  constexpr size_t kSidesAJob = 64;
  const SampleLayout& l = ground_.layout;
  const size_t cells = size_t{1} << log2, step = fine_n_ / cells;
  out.resize(l.sides.size() * (cells + 1));
  return parallelFor(
      (l.sides.size() + kSidesAJob - 1) / kSidesAJob, ground_.workers, ground_.interrupted, [&](size_t job) {
        std::vector<float> data(fine_n_ + 1);
        std::vector<uint8_t> weights(fine_n_ + 1);
        for (size_t side = job * kSidesAJob; side < std::min(l.sides.size(), (job + 1) * kSidesAJob); ++side) {
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

bool HeightFit::placeCorners() {
  const SampleLayout& l = ground_.layout;
  const size_t n = size_t{1} << how_.cells_log2;
  std::vector<float> sides;
  if (!fitSides(how_.cells_log2, Ends::kFree, sides)) return false;
  std::vector<double> sum(l.corners, 0);
  std::vector<uint32_t> meet(l.corners, 0);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    for (size_t k = 0; k < 2; ++k) {
      sum[l.sides[side][k]] += sides[side * (n + 1) + k * n];
      ++meet[l.sides[side][k]];
    }
  }
  for (size_t i = 0; i < l.corners; ++i)
    if (meet[i] && fine_.weights[i]) fitted_.heights[i] = static_cast<float>(sum[i] / meet[i]);
  return true;
}

bool HeightFit::fitAllSides() {
  sides_by_log2_.resize(static_cast<size_t>(how_.cells_log2) + 1);
  for (int log2 = how_.least_log2; log2 <= how_.cells_log2; ++log2)
    if (!fitSides(log2, Ends::kFixed, sides_by_log2_[static_cast<size_t>(log2)])) return false;
  return true;
}

HeightFit::PatchData HeightFit::dataOf(uint32_t patch) const {
  const size_t count = (fine_n_ + 1) * (fine_n_ + 1);
  PatchData data{std::vector<float>(count), std::vector<uint8_t>(count)};
  ground_.layout.gather<float>(ground_.base, patch, fine_n_ - 1, fine_.heights, data.heights);
  ground_.layout.gather<uint8_t>(ground_.base, patch, fine_n_ - 1, fine_.weights, data.weights);
  return data;
}

void HeightFit::fitInside(const HeightData& data, std::vector<float>& nodes, size_t cells) const {
  const size_t step = fine_n_ / cells;
  for (size_t y = 1; y < cells; ++y)
    for (size_t x = 1; x < cells; ++x) nodes[y * (cells + 1) + x] = data.heights[(y * (fine_n_ + 1) + x) * step];
  if (step > 1) fitGrid(data, fine_n_ + 1, nodes, cells + 1);
}

bool HeightFit::choosePatchCells() {
  const SampleLayout& l = ground_.layout;
  patch_log2_.assign(l.patches, static_cast<uint8_t>(how_.cells_log2));
  if (how_.least_log2 == how_.cells_log2) return true;
  return parallelFor(l.patches, ground_.workers, ground_.interrupted, [&](size_t patch) {
    const auto p = static_cast<uint32_t>(patch);
    std::vector<float> nodes, off;
    const PatchData data = dataOf(p);
    for (int log2 = how_.least_log2; log2 < how_.cells_log2; ++log2) {
      const size_t cells = size_t{1} << log2;
      nodes.resize((cells + 1) * (cells + 1));
      const std::vector<float>& border = sides_by_log2_[static_cast<size_t>(log2)];
      for (size_t s = 0; s < 4; ++s)
        l.placeSide<float>(ground_.base, p, s, cells,
                           std::span(border).subspan(l.patch_sides[p][s] * (cells + 1), cells + 1), nodes);
      fitInside(data, nodes, cells);
      if (!keeps(data, fine_n_, nodes, cells, how_.tolerance_mm, off)) continue;
      patch_log2_[p] = static_cast<uint8_t>(log2);
      break;
    }
  });
}

void HeightFit::placeSides() {
  const SampleLayout& l = ground_.layout;
  const size_t n = size_t{1} << how_.cells_log2, m = n - 1;
  std::vector<uint8_t> side_log2(l.sides.size(), 0);
  for (size_t p = 0; p < l.patches; ++p)
    for (uint32_t side : l.patch_sides[p]) side_log2[side] = std::max(side_log2[side], patch_log2_[p]);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t cells = size_t{1} << side_log2[side], step = n / cells;
    const float* nodes = sides_by_log2_[side_log2[side]].data() + side * (cells + 1);
    for (size_t i = 1; i < n; ++i) {
      const size_t cell = i / step;
      const float t = static_cast<float>(i - cell * step) / static_cast<float>(step);
      fitted_.heights[l.sideFirst(side, m) + i - 1] = t > 0 ? nodes[cell] * (1 - t) + nodes[cell + 1] * t : nodes[cell];
    }
    fitted_.samples += cells - 1;
  }
  for (uint8_t log2 : patch_log2_) fitted_.samples += ((size_t{1} << log2) - 1) * ((size_t{1} << log2) - 1);
}

bool HeightFit::fitInsides() {
  const SampleLayout& l = ground_.layout;
  const size_t n = size_t{1} << how_.cells_log2, m = n - 1;
  return parallelFor(l.patches, ground_.workers, ground_.interrupted, [&](size_t patch) {
    const auto p = static_cast<uint32_t>(patch);
    const size_t cells = size_t{1} << patch_log2_[p], step = n / cells;
    const PatchData data = dataOf(p);
    std::vector<float> whole((n + 1) * (n + 1)), nodes((cells + 1) * (cells + 1));
    l.gather<float>(ground_.base, p, m, fitted_.heights, whole);
    for (size_t y = 0; y <= cells; ++y)
      for (size_t x = 0; x <= cells; ++x) nodes[y * (cells + 1) + x] = whole[(y * (n + 1) + x) * step];
    fitInside(data, nodes, cells);
    float* out = fitted_.heights.data() + l.insideFirst(patch, m);
    for (size_t y = 1; y < n; ++y) {
      for (size_t x = 1; x < n; ++x) {
        const size_t cx = x / step, cy = y / step;
        const float* c = nodes.data() + cy * (cells + 1) + cx;
        const double fx = static_cast<double>(x - cx * step) / static_cast<double>(step),
                     fy = static_cast<double>(y - cy * step) / static_cast<double>(step);
        *out++ = static_cast<float>(onCell<double>(c[0], c[1], c[cells + 1], c[cells + 2], fx, fy));
      }
    }
  });
}

}  // namespace

std::optional<FittedHeights> fitHeights(const BakeGround& ground, const Traced& fine, const HeightFitOptions& how) {
  HeightFit fit(ground, fine, how);
  if (!fit.run()) return std::nullopt;
  return fit.take();
}

}  // namespace relievo
