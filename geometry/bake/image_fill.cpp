#include "geometry/bake/image_fill.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include <glm/glm.hpp>

#include "geometry/bake/repeated_images.h"

namespace relievo {
namespace {

// Marks the texels that lie on a triangle, or within a texel and a half of it: filters look at these, too.
class TexelMarks {
 public:
  TexelMarks(int width, int height, bool repeats)
      : width_(width), height_(height), repeats_(repeats), shown_(static_cast<size_t>(width) * height, 0) {}
  std::vector<uint8_t>& shown() { return shown_; }

  void add(const std::array<glm::vec2, 3>& uv) {
    constexpr double kBeside = 1.5;
    std::array<glm::dvec2, 3> p;
    glm::dvec2 low(1e300), high(-1e300);
    for (size_t k = 0; k < 3; ++k) {
      p[k] = {double{uv[k].x} * width_, (1 - double{uv[k].y}) * height_};
      low = glm::min(low, p[k] - kBeside), high = glm::max(high, p[k] + kBeside);
    }
    if (!(high.x - low.x < 4.0 * width_ && high.y - low.y < 4.0 * height_)) return markAll();
    // Distances from the sides, inwards positive.
    std::array<glm::dvec3, 3> sides;
    const double area = cross(p[1] - p[0], p[2] - p[0]);
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec2 a = p[k], along = p[(k + 1) % 3] - a;
      const double length = glm::length(along);
      if (!(length > 0)) continue;  // it has no other side than a line
      const glm::dvec2 inwards = glm::dvec2(-along.y, along.x) * ((area < 0 ? -1 : 1) / length);
      sides[k] = glm::dvec3(inwards, -glm::dot(inwards, a));
    }
    for (int64_t y = first(low.y); y <= first(high.y); ++y)
      for (int64_t x = first(low.x); x <= first(high.x); ++x) {
        const glm::dvec3 at(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
        if (std::all_of(sides.begin(), sides.end(),
                        [&](const glm::dvec3& side) { return glm::dot(side, at) >= -kBeside; }))
          mark(x, y);
      }
  }

 private:
  static double cross(const glm::dvec2& a, const glm::dvec2& b) { return a.x * b.y - a.y * b.x; }
  static int64_t first(double at) { return static_cast<int64_t>(std::floor(at)); }
  void markAll() { std::fill(shown_.begin(), shown_.end(), uint8_t{1}); }
  void mark(int64_t x, int64_t y) {
    auto inside = [&](int64_t i, int64_t n) { return repeats_ ? ((i % n) + n) % n : std::clamp<int64_t>(i, 0, n - 1); };
    shown_[static_cast<size_t>(inside(y, height_) * width_ + inside(x, width_))] = 1;
  }

  int width_, height_;
  bool repeats_;
  std::vector<uint8_t> shown_;
};

struct Level {
  size_t width, height;
  std::vector<uint8_t> rgb;    // means of what is shown
  std::vector<uint8_t> known;  // 1: some of it is
};

Level halved(const Level& fine) {
  Level out{(fine.width + 1) / 2, (fine.height + 1) / 2, {}, {}};
  out.rgb.assign(3 * out.width * out.height, 0);
  out.known.assign(out.width * out.height, 0);
  for (size_t y = 0; y < out.height; ++y)
    for (size_t x = 0; x < out.width; ++x) {
      const size_t to = y * out.width + x;
      std::array<int, 3> sum{};
      int count = 0;
      for (size_t k = 0; k < 4; ++k) {
        const size_t i = 2 * x + k % 2, j = 2 * y + k / 2;
        if (i >= fine.width || j >= fine.height || !fine.known[j * fine.width + i]) continue;
        for (size_t c = 0; c < 3; ++c) sum[c] += fine.rgb[3 * (j * fine.width + i) + c];
        ++count;
      }
      if (count == 0) continue;
      for (size_t c = 0; c < 3; ++c) out.rgb[3 * to + c] = static_cast<uint8_t>((2 * sum[c] + count) / (2 * count));
      out.known[to] = 1;
    }
  return out;
}

}  // namespace

FilledImage fillUnshown(const TriMesh& mesh, uint16_t number, int width, int height, bool repeats,
                        std::span<const uint8_t> texels) {
  FilledImage out{{texels.begin(), texels.end()}, 1};
  if (timesShown(mesh, size_t{number} + 1)[number] >= kTimesOver) return out;  // hardly anything is left
  TexelMarks marks(width, height, repeats);
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    if ((mesh.image_of.empty() ? uint16_t{0} : mesh.image_of[t]) == number) marks.add(mesh.corner_uv[t]);
  std::vector<Level> levels;
  levels.push_back(
      {static_cast<size_t>(width), static_cast<size_t>(height), std::move(out.rgb), std::move(marks.shown())});
  const auto shown = std::count(levels[0].known.begin(), levels[0].known.end(), uint8_t{1});
  out.shown = static_cast<double>(shown) / static_cast<double>(levels[0].known.size());
  if (shown == 0 || out.shown == 1) {
    out.rgb = std::move(levels[0].rgb);
    return out;
  }
  while (levels.back().width > 1 || levels.back().height > 1) levels.push_back(halved(levels.back()));
  // From the coarsest level, where all is known, to the finest.
  for (size_t l = levels.size() - 1; l-- > 0;) {
    Level& fine = levels[l];
    const Level& coarse = levels[l + 1];
    auto between = [](size_t at, size_t count) {
      struct Place {
        size_t low, high;
        float to_high;
      };
      const float place = std::clamp((static_cast<float>(at) + 0.5f) / 2 - 0.5f, 0.0f, static_cast<float>(count - 1));
      const auto low = static_cast<size_t>(place);
      return Place{low, std::min(low + 1, count - 1), place - static_cast<float>(low)};
    };
    for (size_t y = 0; y < fine.height; ++y)
      for (size_t x = 0; x < fine.width; ++x) {
        const size_t to = y * fine.width + x;
        if (fine.known[to]) continue;
        const auto u = between(x, coarse.width), v = between(y, coarse.height);
        for (size_t c = 0; c < 3; ++c) {
          auto at = [&](size_t i, size_t j) { return static_cast<float>(coarse.rgb[3 * (j * coarse.width + i) + c]); };
          const float top = at(u.low, v.low) * (1 - u.to_high) + at(u.high, v.low) * u.to_high,
                      bottom = at(u.low, v.high) * (1 - u.to_high) + at(u.high, v.high) * u.to_high;
          fine.rgb[3 * to + c] = static_cast<uint8_t>(top * (1 - v.to_high) + bottom * v.to_high + 0.5f);
        }
      }
  }
  out.rgb = std::move(levels[0].rgb);
  return out;
}

}  // namespace relievo
