#include "texturing/package/image_fill.h"

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdlib>
#include <vector>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr int kTexelLog2 = 8;                       // places are 256ths
constexpr int64_t kBeside = 3 << (kTexelLog2 - 1);  // a texel and a half
constexpr int64_t kMostTimesOver = 4;               // a triangle that is larger shows all

int64_t texelAt(int64_t place) { return place >> kTexelLog2; }

// Of a foreign file's triangles: beyond both all counts as shown.
constexpr uint64_t kMostLooks = uint64_t{1} << 24, kMostLooksATexel = 64;

struct Level {
  size_t width, height;
  std::vector<uint8_t> rgb;    // means of what is shown
  std::vector<uint8_t> known;  // 1: some of it is
};

// A level's rows, on as many threads as there are cores where it is large.
template <class Row>
void forEachRow(const Level& level, Row&& row) {
  const size_t rows_a_job = (size_t{1} << 18) / level.width + 1;
  parallelFor((level.height + rows_a_job - 1) / rows_a_job, 0, nullptr, [&](size_t job) {
    for (size_t y = job * rows_a_job; y < std::min((job + 1) * rows_a_job, level.height); ++y) row(y);
  });
}

// Fills `out`, the next coarser level, from a level.
void halve(const Level& fine, std::span<const uint8_t> rgb, Level& out) {
  out = {(fine.width + 1) / 2, (fine.height + 1) / 2, {}, {}};
  out.rgb.assign(3 * out.width * out.height, 0);
  out.known.assign(out.width * out.height, 0);
  forEachRow(out, [&](size_t y) {
    for (size_t x = 0; x < out.width; ++x) {
      const size_t to = y * out.width + x;
      std::array<int, 3> sum{};
      int count = 0;
      for (size_t k = 0; k < 4; ++k) {
        const size_t i = 2 * x + k % 2, j = 2 * y + k / 2;
        if (i >= fine.width || j >= fine.height || !fine.known[j * fine.width + i]) continue;
        for (size_t c = 0; c < 3; ++c) sum[c] += rgb[3 * (j * fine.width + i) + c];
        ++count;
      }
      if (count == 0) continue;
      for (size_t c = 0; c < 3; ++c) out.rgb[3 * to + c] = static_cast<uint8_t>((2 * sum[c] + count) / (2 * count));
      out.known[to] = 1;
    }
  });
}

// What is not known of a level, between the texels of the next coarser one.
void fillFrom(const Level& coarse, const Level& fine, std::span<uint8_t> rgb) {
  struct Place {
    size_t low, high;
    uint32_t to_high;  // quarters
  };
  auto between = [](size_t at, size_t count) {
    const size_t quarters = std::min(2 * at - std::min<size_t>(at, 1), 4 * (count - 1)), low = quarters / 4;
    return Place{low, std::min(low + 1, count - 1), static_cast<uint32_t>(quarters % 4)};
  };
  forEachRow(fine, [&](size_t y) {
    for (size_t x = 0; x < fine.width; ++x) {
      const size_t to = y * fine.width + x;
      if (fine.known[to]) continue;
      const Place u = between(x, coarse.width), v = between(y, coarse.height);
      for (size_t c = 0; c < 3; ++c) {
        auto at = [&](size_t i, size_t j) { return uint32_t{coarse.rgb[3 * (j * coarse.width + i) + c]}; };
        const uint32_t top = at(u.low, v.low) * (4 - u.to_high) + at(u.high, v.low) * u.to_high,
                       bottom = at(u.low, v.high) * (4 - u.to_high) + at(u.high, v.high) * u.to_high;
        rgb[3 * to + c] = static_cast<uint8_t>((top * (4 - v.to_high) + bottom * v.to_high + 8) / 16);
      }
    }
  });
}

}  // namespace

ShownMarks::ShownMarks(int width, int height, bool repeats)
    : width_(width), height_(height), repeats_(repeats), shown_(static_cast<size_t>(width) * height, 0) {}

void ShownMarks::mark(int64_t x, int64_t y) {
  auto inside = [&](int64_t i, int64_t n) { return repeats_ ? ((i % n) + n) % n : std::clamp<int64_t>(i, 0, n - 1); };
  shown_[static_cast<size_t>(inside(y, height_) * width_ + inside(x, width_))] = 1;
}

void ShownMarks::add(const std::array<glm::ivec2, 3>& triangle) {
  using Place = std::array<int64_t, 2>;
  Place low{}, high{};
  std::array<Place, 3> p;
  for (int axis = 0; axis < 2; ++axis) {
    const auto i = static_cast<size_t>(axis);
    const auto [least, most] = std::minmax({triangle[0][axis], triangle[1][axis], triangle[2][axis]});
    low[i] = int64_t{least} - kBeside, high[i] = int64_t{most} + kBeside;
    for (size_t k = 0; k < 3; ++k) p[k][i] = triangle[k][axis];
    if (high[i] - low[i] >= (kMostTimesOver * (axis == 0 ? width_ : height_)) << kTexelLog2) {
      std::fill(shown_.begin(), shown_.end(), uint8_t{1});
      return;
    }
  }
  auto texelsAlong = [&](size_t i) { return static_cast<uint64_t>(texelAt(high[i]) - texelAt(low[i]) + 1); };
  looked_at_ += texelsAlong(0) * texelsAlong(1);
  if (looked_at_ > std::max(kMostLooks, kMostLooksATexel * shown_.size())) {
    std::fill(shown_.begin(), shown_.end(), uint8_t{1});
    return;
  }
  auto cross = [](const Place& a, const Place& b) { return a[0] * b[1] - a[1] * b[0]; };
  auto from = [](const Place& a, const Place& b) { return Place{b[0] - a[0], b[1] - a[1]}; };
  const int64_t turn = cross(from(p[0], p[1]), from(p[0], p[2])) < 0 ? -1 : 1;
  // A place lies inside of an edge, or at most kBeside outside of it, where cross() is no less than `least`: its length
  // is taken as the larger extent and half of the smaller one, which is up to an eighth more than it is.
  struct Edge {
    Place at, along;
    int64_t least;
  };
  std::array<Edge, 3> edges;
  for (size_t k = 0; k < 3; ++k) {
    const Place along = from(p[k], p[(k + 1) % 3]);
    const auto [small, large] = std::minmax({std::abs(along[0]), std::abs(along[1])});
    edges[k] = {p[k], along, -kBeside * (large + small / 2)};
  }
  for (int64_t y = texelAt(low[1]); y <= texelAt(high[1]); ++y)
    for (int64_t x = texelAt(low[0]); x <= texelAt(high[0]); ++x) {
      const Place middle{(2 * x + 1) << (kTexelLog2 - 1), (2 * y + 1) << (kTexelLog2 - 1)};
      if (std::all_of(edges.begin(), edges.end(),
                      [&](const Edge& edge) { return turn * cross(edge.along, from(edge.at, middle)) >= edge.least; }))
        mark(x, y);
    }
}

double ShownMarks::share() const {
  const auto shown = std::count(shown_.begin(), shown_.end(), uint8_t{1});
  return static_cast<double>(shown) / static_cast<double>(shown_.size());
}

void ShownMarks::fillRest(std::span<uint8_t> rgb) && {
  assert(rgb.size() == 3 * shown_.size());
  if (const double share = this->share(); share == 0 || share == 1) return;
  // The finest level's texels are the caller's.
  std::vector<Level> levels;
  levels.push_back({static_cast<size_t>(width_), static_cast<size_t>(height_), {}, std::move(shown_)});
  auto texels = [&](size_t level) { return level == 0 ? rgb : std::span<uint8_t>(levels[level].rgb); };
  while (levels.back().width > 1 || levels.back().height > 1) {
    Level coarse;
    halve(levels.back(), texels(levels.size() - 1), coarse);
    levels.push_back(std::move(coarse));
  }
  // From the coarsest level, where all is known, to the finest.
  for (size_t l = levels.size() - 1; l-- > 0;) fillFrom(levels[l + 1], levels[l], texels(l));
}

}  // namespace relievo
