// Which blocks of coarser grids are near enough: what the full errors say, over rough and smooth surfaces.
#include "geometry/bake/grid_error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace relievo {
namespace grid_error_test {

// A unit square in 2^cells_log2 cells a side: waves, and one corner that is rough.
SurfaceGrid wavyGrid(int cells_log2, uint32_t seed) {
  SurfaceGrid grid(cells_log2);
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  const double size = std::ldexp(1.0, cells_log2);
  for (size_t y = 0; y < grid.row(); ++y)
    for (size_t x = 0; x < grid.row(); ++x) {
      const double u = static_cast<double>(x) / size, v = static_cast<double>(y) / size;
      const double rough = u + v < 0.5 ? 0.01 * unit(random) : 0;
      grid.axes[0][y * grid.row() + x] = u;
      grid.axes[1][y * grid.row() + x] = v + 0.01 * std::sin(5 * u);
      grid.axes[2][y * grid.row() + x] = 0.05 * std::sin(9 * u) * std::cos(7 * v) + rough;
    }
  return grid;
}

TEST(BlocksWithin, AreThoseWhoseErrorsAreAtMostTheTolerance) {
  std::array<glm::dvec3, 4> normals;
  normals.fill({0, 0, 1});
  GridErrorScratch scratch;
  std::vector<std::vector<uint8_t>> within;
  size_t near = 0, far = 0;
  for (int cells_log2 : {1, 3, 4, 7, 8}) {
    const SurfaceGrid finest = wavyGrid(cells_log2, static_cast<uint32_t>(cells_log2));
    const std::vector<GridErrors> errors = gridErrors(finest, normals, scratch);
    std::vector<double> tolerances{0, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 1};
    // At an error itself, and just below.
    for (const GridErrors& e : errors) {
      tolerances.push_back(e.mm[e.mm.size() / 2]);
      tolerances.push_back(std::nextafter(e.mm[e.mm.size() / 2], 0.0f));
    }
    for (double tolerance : tolerances) {
      blocksWithin(finest, tolerance, scratch, within);
      ASSERT_EQ(within.size(), errors.size());
      for (size_t log2 = 1; log2 < errors.size(); ++log2) {  // grids of one cell are left out
        ASSERT_EQ(within[log2].size(), errors[log2].mm.size());
        for (size_t i = 0; i < within[log2].size(); ++i) {
          EXPECT_EQ(within[log2][i] != 0, errors[log2].mm[i] <= tolerance)
              << cells_log2 << " " << log2 << " " << i << " " << tolerance;
          ++(within[log2][i] ? near : far);
        }
      }
    }
  }
  // The control: either answer is frequent.
  EXPECT_GT(near, 1000u);
  EXPECT_GT(far, 1000u);
}

}  // namespace grid_error_test
}  // namespace relievo
