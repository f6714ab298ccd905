#include "geometry/bake/height_steps.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>

#include "src/artwork/relief_lattice.h"
#include "src/base/parallel_for.h"
#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

// Of samples h apart from those they lie between. What lies between coarse samples follows them, so theirs are smaller:
// that takes 5 % fewer bytes for the same distance from the scan.
int stepOf(size_t h, int finest) {
  constexpr int kParts = 16, kOfGrids[] = {16, 12, 12, 8, 8, 6, 6, 4};
  constexpr int kLeast = 4 * kParts;  // smaller ones have no such parts
  if (finest < kLeast) return finest;
  return finest / kParts *
         kOfGrids[std::min<size_t>(static_cast<size_t>(std::bit_width(h)) - 1, std::size(kOfGrids) - 1)];
}

// The nearest height that lies whole steps from the line, within 16 bits.
uint16_t stepped(int height, int line, int step) {
  const int k = (std::abs(height - line) + step / 2) / step;
  int out = height < line ? line - k * step : line + k * step;
  if (out > 65535) out -= step;
  if (out < 0) out += step;
  return static_cast<uint16_t>(out);
}

}  // namespace

std::optional<std::vector<uint16_t>> steppedHeights(const BakeContext& context, std::span<const uint16_t> heights,
                                                    int cells_log2, int step) {
  const SampleLayout& l = context.layout;
  const size_t n = size_t{1} << cells_log2, m = n - 1, row = n + 1;
  std::vector<uint16_t> out(heights.size()), line(row);
  for (size_t i = 0; i < l.corners; ++i) out[i] = stepped(heights[i], 0, stepOf(n / 2, step));
  for (size_t side = 0; side < l.sides.size(); ++side) {
    line[0] = out[l.sides[side][0]], line[n] = out[l.sides[side][1]];
    const size_t first = l.sideBegin(side, m);
    for (size_t h = n / 2; h > 0; h /= 2)
      for (size_t i = h; i < n; i += 2 * h)
        line[i] = stepped(heights[first + i - 1], midHeight(line[i - h], line[i + h]), stepOf(h, step));
    std::copy_n(line.begin() + 1, m, out.begin() + static_cast<ptrdiff_t>(first));
  }
  const bool done = parallelForWith(
      l.patches, context.workers, context.interrupted, [&] { return std::vector<uint16_t>(row * row); },
      [&](std::vector<uint16_t>& grid, size_t patch) {
        l.gather<uint16_t>(context.base, static_cast<uint32_t>(patch), m, out, grid);
        const size_t first = l.interiorBegin(patch, m);
        for (size_t h = n / 2; h > 0; h /= 2) {
          for (size_t y = h; y < n; y += h) {
            const size_t dy = y & h;
            for (size_t x = h; x < n; x += h) {
              const size_t dx = x & h, off = dy * row + dx;
              if (off == 0) continue;
              uint16_t* g = &grid[y * row + x];
              *g = stepped(heights[first + (y - 1) * m + x - 1], midHeight(*(g - off), *(g + off)), stepOf(h, step));
            }
          }
        }
        for (size_t y = 1; y < n; ++y)
          std::copy_n(grid.begin() + static_cast<ptrdiff_t>(y * row + 1), m,
                      out.begin() + static_cast<ptrdiff_t>(first + (y - 1) * m));
      });
  if (!done) return std::nullopt;
  return out;
}

namespace {

// Twelve times the sum over a grid's cells of the mean squares of what is linear on their two triangles, which meet
// along the diagonal (0,0)-(1,1). Of a triangle with a, b and c at its corners that mean is (a a + b b + c c + a b + b
// c
// + c a) / 6.
RELIEVO_SIMD_CLONES double squaresOnCells(const int* grid, size_t row) noexcept {
  double sum = 0;
  for (size_t y = 0; y + 1 < row; ++y) {
    const int *above = grid + y * row, *below = above + row;
    int64_t squares = 0;
    for (size_t x = 0; x + 1 < row; ++x) {
      const int64_t a = above[x], b = above[x + 1], c = below[x], d = below[x + 1];
      squares += 2 * (a * a + d * d + a * d) + b * b + c * c + (a + d) * (b + c);
    }
    sum += static_cast<double>(squares);
  }
  return sum;
}

}  // namespace

double rmsOfChange(const BakeContext& context, std::span<const uint16_t> before, std::span<const uint16_t> after,
                   int cells_log2) {
  const SampleLayout& l = context.layout;
  const size_t n = size_t{1} << cells_log2, row = n + 1;
  struct Scratch {
    std::vector<uint16_t> before, after;
    std::vector<int> change;
  };
  std::vector<double> squares(l.patches);
  const bool done = parallelForWith(
      l.patches, context.workers, context.interrupted,
      [&] {
        return Scratch{std::vector<uint16_t>(row * row), std::vector<uint16_t>(row * row), std::vector<int>(row * row)};
      },
      [&](Scratch& s, size_t patch) {
        l.gather<uint16_t>(context.base, static_cast<uint32_t>(patch), n - 1, before, s.before);
        l.gather<uint16_t>(context.base, static_cast<uint32_t>(patch), n - 1, after, s.after);
        for (size_t i = 0; i < row * row; ++i) s.change[i] = int{s.after[i]} - s.before[i];
        squares[patch] = squaresOnCells(s.change.data(), row) / (12.0 * static_cast<double>(n * n));
      });
  if (!done) return 0;
  double sum = 0, area = 0;
  for (size_t patch = 0; patch < l.patches; ++patch) {
    const auto& c = context.base.patches[patch];
    const glm::dvec3 p = context.cornerPoint(c[0]).position;
    const double of_patch =
        glm::length(glm::cross(context.cornerPoint(c[3]).position - p,
                               context.cornerPoint(c[2]).position - context.cornerPoint(c[1]).position));
    sum += of_patch * squares[patch];
    area += of_patch;
  }
  return area > 0 ? std::sqrt(sum / area) : 0;
}

}  // namespace relievo
