#include "geometry/bake/grid_error.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "src/artwork/base_mesh.h"
#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

// Subdivides a grid to twice as many cells without changing its surface: new vertices are the midpoints of edges,
// diagonals included.
RELIEVO_SIMD_CLONES void refine(const SurfaceGrid& coarse, SurfaceGrid& fine) noexcept {
  const size_t n = coarse.row() - 1, row = coarse.row(), fine_row = fine.row();
  for (size_t axis = 0; axis < 3; ++axis) {
    const double* in = coarse.axes[axis].data();
    double* out = fine.axes[axis].data();
    for (size_t y = 0; y <= n; ++y) {
      const double* a = in + y * row;
      double* o = out + 2 * y * fine_row;
#pragma GCC ivdep
      for (size_t x = 0; x < n; ++x) {
        o[2 * x] = a[x];
        o[2 * x + 1] = 0.5 * (a[x] + a[x + 1]);
      }
      o[2 * n] = a[n];
      if (y == n) break;
      const double* b = a + row;
      o += fine_row;
#pragma GCC ivdep
      for (size_t x = 0; x < n; ++x) {
        o[2 * x] = 0.5 * (a[x] + b[x]);
        o[2 * x + 1] = 0.5 * (a[x] + b[x + 1]);
      }
      o[2 * n] = 0.5 * (a[n] + b[n]);
    }
  }
}

// The interpolation of the corners' normals at each vertex, scaled to length 1.
void unitNormalsOnHalves(const std::array<glm::dvec3, 4>& corners, size_t row,
                         std::array<std::vector<double>, 3>& out) noexcept {
  const double step = 1.0 / static_cast<double>(row - 1);
  for (size_t y = 0; y < row; ++y)
    for (size_t x = 0; x < row; ++x) {
      const std::array<double, 4> share =
          cornerShares(true, static_cast<double>(x) * step, static_cast<double>(y) * step);
      glm::dvec3 normal(0);
      for (size_t k = 0; k < 4; ++k) normal += share[k] * corners[k];
      const double squared = glm::dot(normal, normal), scale = squared > 1e-12 ? 1 / std::sqrt(squared) : 0.0;
      for (int axis = 0; axis < 3; ++axis) out[static_cast<size_t>(axis)][y * row + x] = normal[axis] * scale;
    }
}
RELIEVO_SIMD_CLONES void unitNormals(const std::array<glm::dvec3, 4>& corners, size_t row,
                                     std::array<std::vector<double>, 3>& out) noexcept {
  const double step = 1.0 / static_cast<double>(row - 1);
  for (size_t y = 0; y < row; ++y) {
    const double v = static_cast<double>(y) * step;
    const glm::dvec3 left = corners[0] * (1 - v) + corners[2] * v, right = corners[1] * (1 - v) + corners[3] * v;
    double *nx = out[0].data() + y * row, *ny = out[1].data() + y * row, *nz = out[2].data() + y * row;
#pragma GCC ivdep
    for (size_t x = 0; x < row; ++x) {
      const double u = static_cast<double>(static_cast<int>(x)) * step;
      const double a = left.x * (1 - u) + right.x * u, b = left.y * (1 - u) + right.y * u,
                   c = left.z * (1 - u) + right.z * u;
      const double squared = a * a + b * b + c * c, scale = squared > 1e-12 ? 1 / std::sqrt(squared) : 0.0;
      nx[x] = a * scale, ny[x] = b * scale, nz[x] = c * scale;
    }
  }
}

// The largest values over a block's vertices (those on its border included): squared length of the deviation, its
// component along the normal upwards and downwards, its squared component across the normal. Then, over single cells:
// the largest range of the components along the normal, and the largest squared diagonal of the deviations' bounding
// box.
struct Extremes {
  double squared = 0, above = 0, below = 0, aside = 0, between = 0, apart = 0;
};
void updateMaxima(const std::vector<double>& by, std::vector<double>& high) {
  const double* b = by.data();
  double* h = high.data();
  for (size_t x = 0; x < by.size(); ++x) h[x] = h[x] > b[x] ? h[x] : b[x];
}
void updateMaxima(const std::vector<double>& by, std::vector<double>& high, std::vector<double>& low) {
  const double* b = by.data();
  double *h = high.data(), *l = low.data();
  for (size_t x = 0; x < by.size(); ++x) h[x] = h[x] > b[x] ? h[x] : b[x], l[x] = l[x] < b[x] ? l[x] : b[x];
}
double maxOf(const std::vector<double>& of, size_t first, size_t last) {
  double maximum = 0;
  for (size_t x = first; x <= last; ++x) maximum = std::max(maximum, of[x]);
  return maximum;
}
// Each value becomes the largest, or least, of itself and of the `step` behind it, a power of two: by doubling, in
// vectors. Those at the end have fewer behind them.
void widenMaxima(std::vector<double>& values, size_t step) {
  double* v = values.data();
  auto widen = [&](size_t by) {
    for (size_t x = 0; x + by < values.size(); ++x) v[x] = v[x] > v[x + by] ? v[x] : v[x + by];
  };
  for (size_t by = 1; by < step; by *= 2) widen(by);
  widen(1);
}
void widenMinima(std::vector<double>& values, size_t step) {
  double* v = values.data();
  auto widen = [&](size_t by) {
    for (size_t x = 0; x + by < values.size(); ++x) v[x] = v[x] < v[x + by] ? v[x] : v[x + by];
  };
  for (size_t by = 1; by < step; by *= 2) widen(by);
  widen(1);
}
void allocateRows(size_t row, GridErrorScratch::Rows& rows) {
  for (auto* of : {&rows.now, &rows.high, &rows.low})
    for (auto& values : *of) values.assign(row, 0.0);
  for (auto* values : {&rows.squared_now, &rows.aside_now, &rows.squared, &rows.aside}) values->assign(row, 0.0);
}
// step: the number of finest cells along a coarse cell's side. rows: as allocateRows() leaves them; out: blocks x
// blocks of zeros.
RELIEVO_SIMD_CLONES void blockExtremes(const SurfaceGrid& coarse, const SurfaceGrid& finest,
                                       const std::array<std::vector<double>, 3>& normals, size_t blocks, size_t step,
                                       GridErrorScratch::Rows& rows, std::vector<Extremes>& out) noexcept {
  const size_t row = coarse.row(), n = row - 1, size = n / blocks;
  auto& [now, high, low, squared_now, aside_now, squared, aside] = rows;
  for (size_t y = 0; y <= n; ++y) {
    const size_t at = y * row;
    const double *ax = coarse.axes[0].data() + at, *ay = coarse.axes[1].data() + at, *az = coarse.axes[2].data() + at;
    const double *bx = finest.axes[0].data() + at, *by = finest.axes[1].data() + at, *bz = finest.axes[2].data() + at;
    const double *nx = normals[0].data() + at, *ny = normals[1].data() + at, *nz = normals[2].data() + at;
    double *ox = now[0].data(), *oy = now[1].data(), *oz = now[2].data(), *along = now[3].data(),
           *os = squared_now.data(), *oa = aside_now.data();
#pragma GCC ivdep
    for (size_t x = 0; x < row; ++x) {
      const double dx = bx[x] - ax[x], dy = by[x] - ay[x], dz = bz[x] - az[x];
      const double s = dx * dx + dy * dy + dz * dz, a = dx * nx[x] + dy * ny[x] + dz * nz[x], across = s - a * a;
      ox[x] = dx, oy[x] = dy, oz[x] = dz;
      along[x] = a;
      os[x] = s;
      oa[x] = across > 0 ? across : 0;
    }
    for (size_t k = 0; k < now.size(); ++k) updateMaxima(now[k], high[k], low[k]);
    updateMaxima(squared_now, squared);
    updateMaxima(aside_now, aside);
    if (y == 0) continue;
    Extremes* of_blocks = out.data() + (y - 1) / size * blocks;
    if (y % step == 0) {
      for (auto& values : high) widenMaxima(values, step);
      for (auto& values : low) widenMinima(values, step);
      for (size_t x = 0; x < n; x += step) {
        Extremes& e = of_blocks[x / size];
        double diagonal = 0;
        for (size_t axis = 0; axis < 3; ++axis) {
          const double width = std::max(high[axis][x], 0.0) - std::min(low[axis][x], 0.0);
          diagonal += width * width;
        }
        const double above = std::max(high[3][x], 0.0), below = -std::min(low[3][x], 0.0);
        e.above = std::max(e.above, above), e.below = std::max(e.below, below),
        e.between = std::max(e.between, above + below);
        e.apart = std::max(e.apart, diagonal);
      }
      high = now;  // of the same sizes, so that nothing is allocated
      low = now;
    }
    if (y % size == 0) {
      for (size_t i = 0; i < blocks; ++i) {
        of_blocks[i].squared = maxOf(squared, i * size, (i + 1) * size);
        of_blocks[i].aside = maxOf(aside, i * size, (i + 1) * size);
      }
      squared = squared_now, aside = aside_now;
    }
  }
}

// The largest squared distance of a grid from the finest grid's part that begins at its vertex (x0, y0). largest: as
// many zeros as the grid has columns.
RELIEVO_SIMD_CLONES void largestSquared(const SurfaceGrid& grid, const SurfaceGrid& finest, size_t x0, size_t y0,
                                        std::vector<double>& largest) noexcept {
  const size_t row = grid.row();
  double* h = largest.data();
  for (size_t y = 0; y < row; ++y) {
    const size_t at = y * row, of_finest = (y0 + y) * finest.row() + x0;
    const double *ax = grid.axes[0].data() + at, *ay = grid.axes[1].data() + at, *az = grid.axes[2].data() + at;
    const double *bx = finest.axes[0].data() + of_finest, *by = finest.axes[1].data() + of_finest,
                 *bz = finest.axes[2].data() + of_finest;
#pragma GCC ivdep
    for (size_t x = 0; x < row; ++x) {
      const double dx = bx[x] - ax[x], dy = by[x] - ay[x], dz = bz[x] - az[x], s = dx * dx + dy * dy + dz * dz;
      h[x] = h[x] > s ? h[x] : s;
    }
  }
}

// Rounded up: for the square roots here, and because vertices are drawn in single precision.
constexpr double kRoundUp = 1 + 1e-6;
float upperBound(double mm) {
  return mm > 0 ? std::nextafter(static_cast<float>(mm), std::numeric_limits<float>::infinity()) : 0.0f;
}

}  // namespace

void blocksWithin(const SurfaceGrid& finest, double tolerance, GridErrorScratch& scratch,
                  std::vector<std::vector<uint8_t>>& within) {
  const int finest_log2 = finest.cells_log2;
  std::vector<SurfaceGrid>& grids = scratch.grids;
  within.resize(static_cast<size_t>(finest_log2) + 1);
  within.back().assign(static_cast<size_t>(errorBlocksPerSide(finest_log2) * errorBlocksPerSide(finest_log2)), 1);
  for (int log2 = finest_log2 - 1; log2 >= 0; --log2) {
    const auto blocks = static_cast<size_t>(errorBlocksPerSide(log2)),
               finer_blocks = static_cast<size_t>(errorBlocksPerSide(log2 + 1)), ratio = finer_blocks / blocks;
    const std::vector<uint8_t>& finer = within[static_cast<size_t>(log2) + 1];
    std::vector<uint8_t>& out = within[static_cast<size_t>(log2)];
    out.assign(blocks * blocks, 0);
    // A block as a grid of its own, subdivided until its vertices are the finest grid's there.
    const int block_log2 = std::min(log2, 3), ups = finest_log2 - log2;
    const size_t row = (size_t{1} << block_log2) + 1, step = size_t{1} << ups, width = (row - 1) * step;
    for (size_t block = 0; log2 > 0 && block < out.size(); ++block) {
      const size_t i = block % blocks, j = block / blocks;
      bool may_be = true;
      for (size_t k = 0; k < ratio * ratio; ++k)
        may_be = may_be && finer[(j * ratio + k / ratio) * finer_blocks + i * ratio + k % ratio];
      if (!may_be) continue;
      // Few patches need the largest ones.
      for (int k = static_cast<int>(grids.size()); k <= block_log2 + ups; ++k) grids.emplace_back(k);
      SurfaceGrid& coarse = grids[static_cast<size_t>(block_log2)];
      for (size_t axis = 0; axis < 3; ++axis)
        for (size_t y = 0; y < row; ++y)
          for (size_t x = 0; x < row; ++x)
            coarse.axes[axis][y * row + x] =
                finest.axes[axis][(j * width + y * step) * finest.row() + i * width + x * step];
      for (int up = 0; up < ups; ++up)
        refine(grids[static_cast<size_t>(block_log2 + up)], grids[static_cast<size_t>(block_log2 + up) + 1]);
      std::vector<double>& largest = scratch.rows.squared;
      largest.assign(width + 1, 0.0);
      largestSquared(grids[static_cast<size_t>(block_log2 + ups)], finest, i * width, j * width, largest);
      out[block] = upperBound(std::sqrt(maxOf(largest, 0, width)) * kRoundUp) <= tolerance;
    }
  }
}

std::vector<GridErrors> gridErrors(const SurfaceGrid& grid, const BetweenSamples& between, const PatchNormals& normals,
                                   GridErrorScratch& scratch) {
  std::vector<GridErrors> errors = gridErrors(grid, normals, scratch);
  const int from = grid.cells_log2;
  if (from == between.finest_log2) return errors;
  // At a vertex of the finest grid the deviation is a mix of those at the vertices of a cell around it, and what lies
  // between samples; the normal may be that of another place of the cell.
  const double more = between.mm(from) * kRoundUp, turn = between.normalChange(from) * kRoundUp;
  for (int log2 = 0; log2 < from; ++log2) {
    GridErrors& e = errors[static_cast<size_t>(log2)];
    for (size_t i = 0; i < e.mm.size(); ++i) {
      const Deviation d = deviationOf(e.mm[i], e.shapes[i]);
      const double mm = d.mm + more, turned = turn * d.mm + more;
      const Deviation with{mm,
                           std::min(mm, d.below_mm + turned),
                           std::min(mm, d.above_mm + turned),
                           std::min(mm, d.aside_mm + 2 * turned),
                           d.between_mm + 2 * turned,
                           std::min(2 * mm, d.apart_mm + 2 * more)};
      e.mm[i] = upperBound(mm);
      e.shapes[i] = shapeOf(with);
    }
  }
  for (int log2 = from; log2 <= between.finest_log2; ++log2) {
    errors.resize(static_cast<size_t>(log2) + 1);
    GridErrors& e = errors.back();
    const auto blocks = static_cast<size_t>(errorBlocksPerSide(log2));
    // The same for all of them: smaller ones would be no less negligible, and take more bytes.
    const double mm = log2 < between.finest_log2 ? more : 0;
    e.mm.assign(blocks * blocks, upperBound(mm));
    e.shapes.assign(blocks * blocks, shapeOf(Deviation::anyDirection(mm)));
  }
  return errors;
}

std::vector<GridErrors> gridErrors(const SurfaceGrid& finest, const PatchNormals& normals, GridErrorScratch& scratch) {
  // Both surfaces are linear on the finest grid's triangles, so that they are furthest apart, in any direction, at its
  // vertices.
  const int finest_log2 = finest.cells_log2;
  std::vector<SurfaceGrid>& grids = scratch.grids;
  std::vector<GridErrors> errors(static_cast<size_t>(finest_log2) + 1);
  // The coarse grid, subdivided once for each level up to the finest.
  for (int log2 = static_cast<int>(grids.size()); log2 <= finest_log2; ++log2) grids.emplace_back(log2);
  for (auto& axis : scratch.normals) axis.resize(finest.row() * finest.row());
  (normals.cut ? unitNormalsOnHalves : unitNormals)(normals.corners, finest.row(), scratch.normals);
  std::vector<Extremes> extremes;
  std::vector<Deviation> current, finer;
  for (int log2 = finest_log2; log2 >= 0; --log2) {
    const auto blocks = static_cast<size_t>(errorBlocksPerSide(log2));
    GridErrors& out = errors[static_cast<size_t>(log2)];
    current.assign(blocks * blocks, {});
    out.mm.assign(blocks * blocks, 0.0f);
    out.shapes.assign(blocks * blocks, {0, 0, 0, 0, 0});
    if (log2 < finest_log2) {
      SurfaceGrid& coarse = grids[static_cast<size_t>(log2)];
      const size_t row = coarse.row(), step = size_t{1} << (finest_log2 - log2);
      for (size_t axis = 0; axis < 3; ++axis)
        for (size_t y = 0; y < row; ++y)
          for (size_t x = 0; x < row; ++x)
            coarse.axes[axis][y * row + x] = finest.axes[axis][(y * finest.row() + x) * step];
      for (int up = log2; up < finest_log2; ++up)
        refine(grids[static_cast<size_t>(up)], grids[static_cast<size_t>(up) + 1]);
      extremes.assign(blocks * blocks, {});
      allocateRows(finest.row(), scratch.rows);
      blockExtremes(grids[static_cast<size_t>(finest_log2)], finest, scratch.normals, blocks, step, scratch.rows,
                    extremes);
      const auto finer_blocks = static_cast<size_t>(errorBlocksPerSide(log2 + 1)), ratio = finer_blocks / blocks;
      for (size_t j = 0; j < blocks; ++j) {
        for (size_t i = 0; i < blocks; ++i) {
          const Extremes& e = extremes[j * blocks + i];
          Deviation& d = current[j * blocks + i];
          d = {std::sqrt(e.squared) * kRoundUp,
               e.below * kRoundUp,
               e.above * kRoundUp,
               (std::sqrt(e.aside) + 1e-7 * std::sqrt(e.squared)) * kRoundUp,
               e.between * kRoundUp,
               std::sqrt(e.apart) * kRoundUp};
          for (size_t y = 0; y < ratio; ++y)
            for (size_t x = 0; x < ratio; ++x) d = joined(d, finer[(j * ratio + y) * finer_blocks + i * ratio + x]);
          out.mm[j * blocks + i] = upperBound(d.mm);
          out.shapes[j * blocks + i] = shapeOf(d);
        }
      }
    }
    std::swap(current, finer);
  }
  return errors;
}

}  // namespace relievo
