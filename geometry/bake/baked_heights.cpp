#include "geometry/bake/baked_heights.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "src/artwork/patch_domain.h"
#include "src/artwork/relief_lattice.h"

namespace relievo {

BakedHeights::BakedHeights(std::span<const float> heights, int log2) : cells_log2(log2) {
  const auto [low, high] = std::minmax_element(heights.begin(), heights.end());
  offset_mm = *low;
  scale_mm = (static_cast<double>(*high) - *low) / 65535.0;
  const double per_mm = scale_mm > 0 ? 1.0 / scale_mm : 0.0;
  samples.resize(heights.size());
  for (size_t i = 0; i < heights.size(); ++i)
    samples[i] = static_cast<uint16_t>(std::clamp(std::floor((heights[i] - offset_mm) * per_mm + 0.5), 0.0, 65535.0));
}

bool BakedHeights::allAlike() const {
  return std::adjacent_find(samples.begin(), samples.end(), std::not_equal_to<>()) == samples.end();
}

namespace {

// A grid of 2^log2 cells from a coarser one, by the lattice's rule.
void refine(std::span<const uint16_t> coarse, int cells_log2, int log2, std::span<uint16_t> out) {
  const size_t n = size_t{1} << cells_log2, row = (size_t{1} << log2) + 1;
  const int up = log2 - cells_log2;
  for (size_t y = 0; y <= n; ++y)
    for (size_t x = 0; x <= n; ++x) out[(y << up) * row + (x << up)] = coarse[y * (n + 1) + x];
  for (size_t h = size_t{1} << up >> 1; h > 0; h /= 2) {
    for (size_t y = 0; y < row; y += h) {
      const size_t dy = y & h;
      for (size_t x = dy ? 0 : h; x < row; x += dy ? h : 2 * h) {
        const size_t dx = x & h, at = y * row + x, off = dy * row + dx;
        out[at] = static_cast<uint16_t>(midHeight(out[at - off], out[at + off]));
      }
    }
  }
}

// The same, interpolated linearly on the cells' triangles. Integer arithmetic makes the result independent of the
// direction in which a patch runs along a shared side.
void interpolate(std::span<const uint16_t> coarse, int cells_log2, int log2, std::span<uint16_t> out) {
  const int n = 1 << cells_log2, up = log2 - cells_log2, cells = 1 << up;
  const auto row = (size_t{1} << log2) + 1;
  for (int cy = 0; cy < n; ++cy) {
    for (int cx = 0; cx < n; ++cx) {
      const uint16_t* c =
          coarse.data() + static_cast<size_t>(cy) * static_cast<size_t>(n + 1) + static_cast<size_t>(cx);
      const int c00 = c[0], c10 = c[1], c01 = c[n + 1], c11 = c[n + 2];
      uint16_t* to = out.data() + static_cast<size_t>(cy << up) * row + static_cast<size_t>(cx << up);
      // The last row and column of a cell are the next cell's, but for the grid's own.
      const int rows = cy + 1 < n ? cells : cells + 1, columns = cx + 1 < n ? cells : cells + 1;
      for (int fy = 0; fy < rows; ++fy, to += row) {
        const int along_v = c00 * (cells - fy) + c01 * fy + cells / 2,
                  along_diagonal = c00 * cells + (c11 - c10) * fy + cells / 2;
        const int before = std::min(fy, columns);
        for (int fx = 0; fx < before; ++fx) to[fx] = static_cast<uint16_t>((along_v + (c11 - c01) * fx) >> up);
        for (int fx = before; fx < columns; ++fx)
          to[fx] = static_cast<uint16_t>((along_diagonal + (c10 - c00) * fx) >> up);
      }
    }
  }
}

}  // namespace

BetweenSamples BakedHeights::betweenSamples(const BakeContext& context, uint32_t patch) const {
  BetweenSamples out{.cells_log2 = cells_log2, .finest_log2 = finestLog2()};
  if (cells_log2 >= out.finest_log2) return out;
  const size_t n = size_t{1} << cells_log2, row = n + 1;
  std::vector<uint16_t> q(row * row);
  gather(context, patch, q);
  const auto [low, high] = std::minmax_element(q.begin(), q.end());
  int largest_step = 0;  // along a side of a cell
  for (size_t y = 0; y <= n; ++y)
    for (size_t x = 0; x <= n; ++x) {
      if (x < n) largest_step = std::max(largest_step, std::abs(q[y * row + x + 1] - q[y * row + x]));
      if (y < n) largest_step = std::max(largest_step, std::abs(q[(y + 1) * row + x] - q[y * row + x]));
    }
  std::array<BasePoint, 4> c;
  for (size_t k = 0; k < 4; ++k) c[k] = context.cornerPoint(context.base.patches[patch][k]);
  const double largest = std::max(std::abs(offset_mm + scale_mm * *low), std::abs(offset_mm + scale_mm * *high));
  // Of a bilinear function, with D = f00 - f10 - f01 + f11: a quarter of |D| from the triangles over its corners, and a
  // quarter of that with each doubling of the cells.
  auto twist = [&](glm::dvec3 BasePoint::*of) {
    return context.base.cut ? 0.0 : glm::length(c[0].*of - c[1].*of - c[2].*of + c[3].*of) / 4;
  };
  auto change = [&](size_t a, size_t b) { return glm::length(c[b].normal - c[a].normal); };
  const double along_u = std::max(change(0, 1), change(2, 3)), along_v = std::max(change(0, 2), change(1, 3));
  const bool same = *low == *high;
  out.twist_mm = twist(&BasePoint::position) + largest * twist(&BasePoint::normal);
  // The product of two linear functions is within a third of the product of their ranges of the linear one. Along the
  // diagonal both may change by what they change along two sides.
  out.product_mm = 2.0 * largest_step * scale_mm * std::ldexp(along_u + along_v, -cells_log2) / 3;
  // Heights that are rounded by a step move points along normals, of length 1 within 1e-3, and change that product:
  // both ends of a range, over cells of at most half the patch.
  out.rounding_mm = same ? 0 : scale_mm * (1.01 + (along_u + along_v) / 3);
  // No mix of the corners' normals is shorter along their mean than the shortest.
  glm::dvec3 mean(0);
  for (const BasePoint& corner : c) mean += corner.normal;
  double shortest = glm::length(mean);
  if (shortest > 0) {
    mean /= shortest;
    for (const BasePoint& corner : c) shortest = std::min(shortest, glm::dot(corner.normal, mean));
  }
  out.normal_change = shortest > 0 ? (along_u + along_v) / shortest : std::numeric_limits<double>::infinity();
  return out;
}

void BakedHeights::gather(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const {
  context.layout.gather<uint16_t>(context.base, patch, (size_t{1} << cells_log2) - 1, samples, out);
}

void BakedHeights::grid(const BakeContext& context, uint32_t patch, int log2, std::span<uint16_t> out) const {
  if (log2 == cells_log2) {
    gather(context, patch, out);
    return;
  }
  const size_t n = size_t{1} << cells_log2;
  std::vector<uint16_t> samples_of_patch((n + 1) * (n + 1));
  gather(context, patch, samples_of_patch);
  if (log2 < cells_log2) {
    const size_t cells = size_t{1} << log2, apart = n / cells;
    for (size_t y = 0; y <= cells; ++y)
      for (size_t x = 0; x <= cells; ++x) out[y * (cells + 1) + x] = samples_of_patch[(y * (n + 1) + x) * apart];
  } else if (step > 1) {
    refine(samples_of_patch, cells_log2, log2, out);
  } else {
    interpolate(samples_of_patch, cells_log2, log2, out);
  }
}

void BakedHeights::surface(const BakeContext& context, uint32_t patch, SurfaceGrid& out) const {
  const size_t row = out.row();
  std::vector<uint16_t> q(row * row);
  grid(context, patch, out.cells_log2, q);
  const auto& c = context.base.patches[patch];
  const double per_cell = 1.0 / static_cast<double>(row - 1);
  if (context.base.cut) {
    for (size_t y = 0; y < row; ++y)
      for (size_t x = 0; x < row; ++x) {
        const BasePoint at =
            context.patchPoint(patch, static_cast<double>(x) * per_cell, static_cast<double>(y) * per_cell);
        const double height = offset_mm + scale_mm * q[y * row + x];
        for (int axis = 0; axis < 3; ++axis)
          out.axes[static_cast<size_t>(axis)][y * row + x] = at.position[axis] + height * at.normal[axis];
      }
    return;
  }
  for (size_t y = 0; y < row; ++y) {
    const double v = static_cast<double>(y) * per_cell;
    const BasePoint left = lerp(context.cornerPoint(c[0]), context.cornerPoint(c[2]), v),
                    right = lerp(context.cornerPoint(c[1]), context.cornerPoint(c[3]), v);
    const uint16_t* height = q.data() + y * row;
    for (int axis = 0; axis < 3; ++axis) {
      const double p0 = left.position[axis], p1 = right.position[axis], n0 = left.normal[axis], n1 = right.normal[axis];
      double* coordinates = out.axes[static_cast<size_t>(axis)].data() + y * row;
#pragma GCC ivdep
      for (size_t x = 0; x < row; ++x) {
        const double u = static_cast<double>(static_cast<int>(x)) * per_cell;
        coordinates[x] = p0 * (1 - u) + p1 * u + (offset_mm + scale_mm * height[x]) * (n0 * (1 - u) + n1 * u);
      }
    }
  }
}

}  // namespace relievo
