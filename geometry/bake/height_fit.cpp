#include "geometry/bake/height_fit.h"

#include <algorithm>
#include <cassert>
#include <vector>

#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

// The weight of data of weight 0, beside 1 to 255; and the weight of a node's initial value, which decides where data
// do not.
constexpr float kUnresolvedWeight = 0.25f, kRegularisation = 0.5f;
// Gauss-Seidel sweeps, in alternating order. The matrix is that of overlapping hat functions, whose condition number is
// small: a sweep more than halves the error.
constexpr int kSweeps = 12;

float weightOf(uint8_t w) { return w ? static_cast<float>(w) : kUnresolvedWeight; }

// Bounds a node by the data in its own cells, since an unbounded fit overshoots at steps.
struct Range {
  float low, high;
  void add(float h) {
    low = std::min(low, h);
    high = std::max(high, h);
  }
};

}  // namespace

void fitLine(const HeightData& data, Ends ends, std::span<float> nodes) {
  const size_t n = nodes.size() - 1, ratio = (data.heights.size() - 1) / n;
  assert(data.heights.size() == n * ratio + 1 && data.weights.size() == data.heights.size());
  std::vector<double> diagonal(n + 1, kRegularisation), off_diagonal(n + 1, 0.0), right_side(n + 1);
  std::vector<Range> ranges(n + 1);
  for (size_t i = 0; i <= n; ++i) {
    right_side[i] = double{kRegularisation} * nodes[i];
    ranges[i] = {nodes[i], nodes[i]};
  }
  for (size_t i = 0; i < data.heights.size(); ++i) {
    const size_t cell = i < n * ratio ? i / ratio : n - 1;
    const double t = static_cast<double>(i - cell * ratio) / static_cast<double>(ratio), w = weightOf(data.weights[i]),
                 h = data.heights[i];
    diagonal[cell] += w * (1 - t) * (1 - t);
    diagonal[cell + 1] += w * t * t;
    off_diagonal[cell] += w * t * (1 - t);
    right_side[cell] += w * (1 - t) * h;
    right_side[cell + 1] += w * t * h;
    if (data.weights[i] == 0) continue;
    ranges[cell].add(data.heights[i]);
    ranges[cell + 1].add(data.heights[i]);
  }
  auto relax = [&](size_t i) {
    const double others =
        (i > 0 ? off_diagonal[i - 1] * nodes[i - 1] : 0.0) + (i < n ? off_diagonal[i] * nodes[i + 1] : 0.0);
    nodes[i] = std::clamp(static_cast<float>((right_side[i] - others) / diagonal[i]), ranges[i].low, ranges[i].high);
  };
  const size_t first = ends == Ends::kFixed ? 1 : 0, count = n + 1 - 2 * first;
  for (int sweep = 0; sweep < kSweeps; ++sweep)
    for (size_t i = 0; i < count; ++i) relax(first + (sweep % 2 ? count - 1 - i : i));
}

namespace {

// The normal equation of a node: its coefficient, those of the neighbours along u, along v and along the diagonal, and
// the right-hand side.
struct Equation {
  float self = kRegularisation, east = 0, south = 0, diagonal = 0, right_side = 0;
  Range range{};
};

RELIEVO_SIMD_CLONES void solveGrid(const HeightData& data, size_t data_row, std::span<float> nodes, size_t row,
                                   std::span<Equation> equations) noexcept {
  const size_t n = row - 1, ratio = (data_row - 1) / n;
  assert(data_row == n * ratio + 1 && data.heights.size() == data_row * data_row && nodes.size() == row * row);
  for (size_t i = 0; i < equations.size(); ++i) {
    equations[i].right_side = kRegularisation * nodes[i];
    equations[i].range = {nodes[i], nodes[i]};
  }
  const float step = 1.0f / static_cast<float>(ratio);
  for (size_t y = 0; y < data_row; ++y) {
    const size_t cy = y < n * ratio ? y / ratio : n - 1;
    const float fy = static_cast<float>(y - cy * ratio) * step;
    for (size_t x = 0; x < data_row; ++x) {
      const size_t cx = x < n * ratio ? x / ratio : n - 1;
      const float fx = static_cast<float>(x - cx * ratio) * step;
      const float w = weightOf(data.weights[y * data_row + x]), h = data.heights[y * data_row + x];
      Equation *a = equations.data() + cy * row + cx, *d = a + row + 1;
      const bool above = fx >= fy;
      Equation* b = above ? a + 1 : a + row;
      const float major = above ? fx : fy, minor = above ? fy : fx;
      const float wa = 1 - major, wb = major - minor, wd = minor;
      a->self += w * wa * wa;
      b->self += w * wb * wb;
      d->self += w * wd * wd;
      (above ? a->east : a->south) += w * wa * wb;
      (above ? b->south : b->east) += w * wb * wd;
      a->diagonal += w * wa * wd;
      a->right_side += w * wa * h;
      b->right_side += w * wb * h;
      d->right_side += w * wd * h;
      if (data.weights[y * data_row + x] == 0) continue;
      for (Equation* e : {a, b, d}) e->range.add(h);
    }
  }
  auto relax = [&](size_t i) {
    const Equation& e = equations[i];
    const float others = e.east * nodes[i + 1] + equations[i - 1].east * nodes[i - 1] + e.south * nodes[i + row] +
                         equations[i - row].south * nodes[i - row] + e.diagonal * nodes[i + row + 1] +
                         equations[i - row - 1].diagonal * nodes[i - row - 1];
    nodes[i] = std::clamp((e.right_side - others) / e.self, e.range.low, e.range.high);
  };
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (size_t k = 1; k < n; ++k)
      for (size_t j = 1; j < n; ++j) relax(sweep % 2 ? (n - k) * row + n - j : k * row + j);
  }
}

}  // namespace

void fitGrid(const HeightData& data, size_t data_row, std::span<float> nodes, size_t row) {
  std::vector<Equation> equations(row * row);
  solveGrid(data, data_row, nodes, row, equations);
}

}  // namespace relievo
