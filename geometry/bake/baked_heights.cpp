#include "geometry/bake/baked_heights.h"

#include <algorithm>
#include <cmath>

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

namespace {

// A page's grid from a coarser one, by the lattice's rule.
void refine(std::span<const uint16_t> coarse, int cells_log2, std::span<uint16_t> out) {
  const size_t n = size_t{1} << cells_log2;
  const int up = kPageCellsLog2 - cells_log2;
  for (size_t y = 0; y <= n; ++y)
    for (size_t x = 0; x <= n; ++x) out[(y << up) * kReliefSamples + (x << up)] = coarse[y * (n + 1) + x];
  for (int h = 1 << up >> 1; h > 0; h /= 2) {
    for (int y = 0; y <= kPagePx; y += h) {
      const int dy = y & h;
      for (int x = dy ? 0 : h; x <= kPagePx; x += dy ? h : 2 * h) {
        const int dx = x & h, at = y * kReliefSamples + x, off = dy * kReliefSamples + dx;
        out[static_cast<size_t>(at)] =
            static_cast<uint16_t>(midHeight(out[static_cast<size_t>(at - off)], out[static_cast<size_t>(at + off)]));
      }
    }
  }
}

}  // namespace

void BakedHeights::gather(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const {
  context.layout.gather<uint16_t>(context.base, patch, (size_t{1} << cells_log2) - 1, samples, out);
}

void BakedHeights::finest(const BakeContext& context, uint32_t patch, std::span<uint16_t> out) const {
  const size_t n = size_t{1} << cells_log2;
  if (cells_log2 >= kPageCellsLog2) {
    gather(context, patch, out);
    return;
  }
  std::vector<uint16_t> coarse((n + 1) * (n + 1));
  gather(context, patch, coarse);
  if (stepped) {
    refine(coarse, cells_log2, out);
    return;
  }
  // Integer arithmetic makes the result independent of the direction in which a patch runs along a shared side.
  const int up = kPageCellsLog2 - cells_log2, cells = 1 << up;
  for (int y = 0; y <= kPagePx; ++y) {
    const int cy = std::min(y >> up, static_cast<int>(n) - 1), fy = y - (cy << up);
    for (int x = 0; x <= kPagePx; ++x) {
      const int cx = std::min(x >> up, static_cast<int>(n) - 1), fx = x - (cx << up);
      const uint16_t* c = coarse.data() + static_cast<size_t>(cy) * (n + 1) + static_cast<size_t>(cx);
      const int c00 = c[0], c10 = c[1], c01 = c[n + 1], c11 = c[n + 2];
      const int sum =
          fx >= fy ? c00 * (cells - fx) + c10 * (fx - fy) + c11 * fy : c00 * (cells - fy) + c01 * (fy - fx) + c11 * fx;
      out[static_cast<size_t>(y) * kReliefSamples + static_cast<size_t>(x)] =
          static_cast<uint16_t>((sum + cells / 2) >> up);
    }
  }
}

void BakedHeights::surface(const BakeContext& context, uint32_t patch, SurfaceGrid& out) const {
  const size_t row = out.row();
  std::vector<uint16_t> q(row * row);
  finest(context, patch, q);
  const auto& c = context.base.patches[patch];
  const double per_cell = 1.0 / static_cast<double>(row - 1);
  for (size_t y = 0; y < row; ++y) {
    const double v = static_cast<double>(y) * per_cell;
    const BasePoint left = lerp(context.cornerPoint(c[0]), context.cornerPoint(c[2]), v),
                    right = lerp(context.cornerPoint(c[1]), context.cornerPoint(c[3]), v);
    const uint16_t* height = q.data() + y * row;
    for (int axis = 0; axis < 3; ++axis) {
      const double p0 = left.position[axis], p1 = right.position[axis], n0 = left.normal[axis], n1 = right.normal[axis];
      double* coordinates = out.axes[static_cast<size_t>(axis)].data() + y * row;
      for (size_t x = 0; x < row; ++x) {
        const double u = static_cast<double>(static_cast<int>(x)) * per_cell;
        coordinates[x] = p0 * (1 - u) + p1 * u + (offset_mm + scale_mm * height[x]) * (n0 * (1 - u) + n1 * u);
      }
    }
  }
}

}  // namespace relievo
