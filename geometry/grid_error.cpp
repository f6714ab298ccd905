#include "geometry/grid_error.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace relievo {
namespace {

// The same triangles with twice as many cells a side: new vertices lie halfway along edges, the cells' diagonals among them.
void refine(const SurfaceGrid& coarse, SurfaceGrid& fine) {
  const size_t n = coarse.row() - 1, row = coarse.row(), fine_row = fine.row();
  for (size_t axis = 0; axis < 3; ++axis) {
    const double* in = coarse.axes[axis].data();
    double* out = fine.axes[axis].data();
    for (size_t y = 0; y <= n; ++y) {
      const double* a = in + y * row;
      double* o = out + 2 * y * fine_row;
      for (size_t x = 0; x < n; ++x) {
        o[2 * x] = a[x];
        o[2 * x + 1] = 0.5 * (a[x] + a[x + 1]);
      }
      o[2 * n] = a[n];
      if (y == n) break;
      const double* b = a + row;
      o += fine_row;
      for (size_t x = 0; x < n; ++x) {
        o[2 * x] = 0.5 * (a[x] + b[x]);
        o[2 * x + 1] = 0.5 * (a[x] + b[x + 1]);
      }
      o[2 * n] = 0.5 * (a[n] + b[n]);
    }
  }
}

// The largest squared distance of each block's vertices, those between blocks counted for both.
void blockDistances(const SurfaceGrid& a, const SurfaceGrid& b, size_t blocks, std::vector<double>& rows, std::vector<double>& out) {
  const size_t row = a.row(), n = row - 1, size = n / blocks;
  out.assign(blocks * blocks, 0.0);
  rows.resize(row);
  for (size_t y = 0; y <= n; ++y) {
    const size_t at = y * row;
    const double *ax = a.axes[0].data() + at, *ay = a.axes[1].data() + at, *az = a.axes[2].data() + at;
    const double *bx = b.axes[0].data() + at, *by = b.axes[1].data() + at, *bz = b.axes[2].data() + at;
    for (size_t x = 0; x < row; ++x) {
      const double dx = ax[x] - bx[x], dy = ay[x] - by[x], dz = az[x] - bz[x];
      rows[x] = dx * dx + dy * dy + dz * dz;
    }
    const size_t last = std::min(y / size, blocks - 1), first = y > 0 && y < n && y % size == 0 ? last - 1 : last;
    for (size_t i = 0; i < blocks; ++i) {
      const double* part = rows.data() + i * size;
      std::array<double, 8> lanes{};
      size_t x = 0;
      for (; x + 8 <= size; x += 8)
        for (size_t k = 0; k < 8; ++k) lanes[k] = std::max(lanes[k], part[x + k]);
      double most = *std::max_element(lanes.begin(), lanes.end());
      for (; x <= size; ++x) most = std::max(most, part[x]);
      for (size_t j = first; j <= last; ++j) out[j * blocks + i] = std::max(out[j * blocks + i], most);
    }
  }
}

}  // namespace

std::vector<std::vector<float>> gridErrors(const SurfaceGrid& finest, std::vector<SurfaceGrid>& grids) {
  // Both surfaces are linear on the finest grid's triangles, so they are furthest apart at its vertices.
  const int top = finest.cells_log2;
  std::vector<std::vector<float>> errors(static_cast<size_t>(top) + 1);
  // Refined from the coarser, by cells_log2.
  for (int log2 = static_cast<int>(grids.size()); log2 <= top; ++log2) grids.emplace_back(log2);
  std::vector<double> rows, squared;
  for (int log2 = top; log2 >= 0; --log2) {
    const auto blocks = static_cast<size_t>(errorBlocksASide(log2));
    std::vector<float>& own = errors[static_cast<size_t>(log2)];
    own.assign(blocks * blocks, 0.0f);
    if (log2 == top) continue;
    SurfaceGrid& coarse = grids[static_cast<size_t>(log2)];
    const size_t row = coarse.row(), step = size_t{1} << (top - log2);
    for (size_t axis = 0; axis < 3; ++axis)
      for (size_t y = 0; y < row; ++y)
        for (size_t x = 0; x < row; ++x) coarse.axes[axis][y * row + x] = finest.axes[axis][(y * finest.row() + x) * step];
    for (int up = log2; up < top; ++up) refine(grids[static_cast<size_t>(up)], grids[static_cast<size_t>(up) + 1]);
    blockDistances(grids[static_cast<size_t>(top)], finest, blocks, rows, squared);
    const std::vector<float>& finer = errors[static_cast<size_t>(log2) + 1];
    const auto finer_blocks = static_cast<size_t>(errorBlocksASide(log2 + 1));
    for (size_t j = 0; j < blocks; ++j) {
      for (size_t i = 0; i < blocks; ++i) {
        float& error = own[j * blocks + i];
        // Up a little: for the squares above, and for what is drawn in single precision.
        if (squared[j * blocks + i] > 0)
          error = std::nextafter(static_cast<float>(std::sqrt(squared[j * blocks + i]) * (1 + 1e-6)), std::numeric_limits<float>::infinity());
        const size_t ratio = finer_blocks / blocks;
        for (size_t y = 0; y < ratio; ++y)
          for (size_t x = 0; x < ratio; ++x) error = std::max(error, finer[(j * ratio + y) * finer_blocks + i * ratio + x]);
      }
    }
  }
  return errors;
}

}  // namespace relievo
