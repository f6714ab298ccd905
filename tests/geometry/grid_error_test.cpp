// Which blocks of coarser grids are near enough: what the full errors say, over rough and smooth surfaces.
#include "geometry/bake/grid_error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "geometry/bake/baked_heights.h"

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
  PatchNormals normals;
  normals.corners.fill({0, 0, 1});
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

// A patch over a twisted quad with normals that spread, and rough heights. twisted 0: the quad is flat, its normals are
// the same.
struct RoughPatch {
  TriMesh mesh;  // only its origin is used
  BaseMesh base;
  std::unique_ptr<BakeContext> context;
  BakedHeights baked;

  RoughPatch(int cells_log2, double rough_mm, bool stepped, uint32_t seed, double twisted = 1) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    for (int k = 0; k < 4; ++k) {
      const double spread = 0.4 * twisted;
      const glm::dvec3 normal = glm::normalize(glm::dvec3(spread * unit(random), spread * unit(random), 1));
      base.corners.push_back({glm::vec3(static_cast<float>(10 * (k % 2)), static_cast<float>(-10 * (k / 2)),
                                        static_cast<float>(2 * twisted * unit(random))),
                              glm::vec3(normal)});
    }
    base.patches = {{0, 1, 2, 3}};
    context = std::make_unique<BakeContext>(mesh, base);
    const size_t m = (size_t{1} << cells_log2) - 1;
    std::vector<float> heights(context->layout.count(m));
    for (float& h : heights) h = static_cast<float>(1 + rough_mm * unit(random));
    baked = BakedHeights(heights, cells_log2);
    baked.step = stepped ? 2 : 1;
  }
};

// The largest distance, at the same (u, v), of the finest grid's vertices from the triangles of a coarser grid.
double farthestFrom(const SurfaceGrid& coarse, const SurfaceGrid& finest) {
  const size_t step = (finest.row() - 1) / (coarse.row() - 1);
  auto at = [&](size_t x, size_t y) {
    const size_t i = y * coarse.row() + x;
    return glm::dvec3(coarse.axes[0][i], coarse.axes[1][i], coarse.axes[2][i]);
  };
  double farthest = 0;
  for (size_t y = 0; y < finest.row(); ++y)
    for (size_t x = 0; x < finest.row(); ++x) {
      const size_t cx = std::min(x / step, coarse.row() - 2), cy = std::min(y / step, coarse.row() - 2);
      const double fx = static_cast<double>(x - cx * step) / static_cast<double>(step),
                   fy = static_cast<double>(y - cy * step) / static_cast<double>(step);
      const glm::dvec3 a = at(cx, cy), d = at(cx + 1, cy + 1), b = fx >= fy ? at(cx + 1, cy) : at(cx, cy + 1);
      const double major = std::max(fx, fy), minor = std::min(fx, fy);
      const glm::dvec3 there = a * (1 - major) + b * (major - minor) + d * minor;
      const size_t i = y * finest.row() + x;
      farthest =
          std::max(farthest, glm::length(glm::dvec3(finest.axes[0][i], finest.axes[1][i], finest.axes[2][i]) - there));
    }
  return farthest;
}

// The oracle is the finest surface itself.
TEST(BetweenSamples, BoundsWhatGridsWithAllSamplesLeaveOut) {
  size_t close = 0, untwisted_too_small = 0;
  for (uint32_t seed = 0; seed < 24; ++seed) {
    const int cells_log2 = 1 + static_cast<int>(seed % 5);
    const RoughPatch patch(cells_log2, seed % 3 == 0 ? 0 : 0.5, seed % 2 == 1, seed);
    const BetweenSamples between = patch.baked.betweenSamples(*patch.context, 0);
    SurfaceGrid finest(7);
    patch.baked.surface(*patch.context, 0, finest);
    for (int log2 = cells_log2; log2 < 7; ++log2) {
      SurfaceGrid coarse(log2);
      patch.baked.surface(*patch.context, 0, coarse);
      const double farthest = farthestFrom(coarse, finest);
      EXPECT_LE(farthest, between.mm(log2)) << seed << " " << log2;
      close += farthest > 0.2 * between.mm(log2);
      // The control: without what normals and positions of the base add, the bound would be broken.
      BetweenSamples untwisted = between;
      untwisted.twist_mm = 0;
      untwisted_too_small += farthest > untwisted.mm(log2);
    }
    EXPECT_EQ(between.mm(7), 0);
    const int enough = between.coarsestWithin(1e-3);
    EXPECT_LE(between.mm(enough), 1e-3);
    EXPECT_TRUE(enough == cells_log2 || between.mm(enough - 1) > 1e-3);
  }
  EXPECT_GT(close, 20u) << "the bound is of some use";
  EXPECT_GT(untwisted_too_small, 20u);
}

// Over a flat base with one normal nothing but rounding is left out.
TEST(BetweenSamples, BoundsWhatRoundingMoves) {
  size_t unrounded_too_small = 0;
  for (uint32_t seed = 0; seed < 8; ++seed) {
    const RoughPatch patch(2 + static_cast<int>(seed % 3), 0.5, seed % 2 == 1, seed, 0);
    const BetweenSamples between = patch.baked.betweenSamples(*patch.context, 0);
    SurfaceGrid finest(7);
    patch.baked.surface(*patch.context, 0, finest);
    for (int log2 = between.cells_log2; log2 < 7; ++log2) {
      SurfaceGrid coarse(log2);
      patch.baked.surface(*patch.context, 0, coarse);
      const double farthest = farthestFrom(coarse, finest);
      EXPECT_LE(farthest, between.mm(log2)) << seed << " " << log2;
      BetweenSamples unrounded = between;
      unrounded.rounding_mm = 0;
      unrounded_too_small += farthest > unrounded.mm(log2);
    }
  }
  EXPECT_GT(unrounded_too_small, 20u) << "the control";
}

TEST(BetweenSamples, GridsHaveTheSameHeightsWhereTheyMeet) {
  for (bool stepped : {false, true}) {
    const RoughPatch patch(3, 0.5, stepped, 7);
    std::vector<uint16_t> finest(129 * 129), grid;
    patch.baked.finest(*patch.context, 0, finest);
    size_t differ = 0;
    for (int log2 = 0; log2 < 7; ++log2) {
      const size_t row = (size_t{1} << log2) + 1, step = size_t{128} >> log2;
      grid.resize(row * row);
      patch.baked.grid(*patch.context, 0, log2, grid);
      for (size_t y = 0; y < row; ++y)
        for (size_t x = 0; x < row; ++x) {
          EXPECT_EQ(grid[y * row + x], finest[(y * 129 + x) * step]);
          differ += grid[y * row + x] != grid[0];
        }
    }
    EXPECT_GT(differ, 1000u) << "the control: heights are rough";
    if (stepped) continue;
    // Between samples they are linear on the cells' triangles, rounded: exact in double precision.
    std::vector<uint16_t> samples(9 * 9);
    patch.baked.grid(*patch.context, 0, 3, samples);
    for (size_t y = 0; y < 129; ++y)
      for (size_t x = 0; x < 129; ++x) {
        const size_t cx = std::min<size_t>(x / 16, 7), cy = std::min<size_t>(y / 16, 7);
        const double fx = static_cast<double>(x - 16 * cx) / 16, fy = static_cast<double>(y - 16 * cy) / 16;
        const uint16_t* c = samples.data() + 9 * cy + cx;
        const double beside = fx >= fy ? c[1] : c[9], major = std::max(fx, fy), minor = std::min(fx, fy);
        const double linear = c[0] * (1 - major) + beside * (major - minor) + c[10] * minor;
        EXPECT_EQ(finest[y * 129 + x], std::floor(linear + 0.5)) << x << " " << y;
      }
  }
}

// A deviation contains another where none of its parts is smaller.
bool contains(const Deviation& large, const Deviation& small) {
  constexpr double kRounding = 1 + 1e-5;
  return small.mm <= large.mm * kRounding && small.below_mm <= large.below_mm * kRounding + 1e-12 &&
         small.above_mm <= large.above_mm * kRounding + 1e-12 && small.aside_mm <= large.aside_mm * kRounding + 1e-12 &&
         small.between_mm <= large.between_mm * kRounding + 1e-12 &&
         small.apart_mm <= large.apart_mm * kRounding + 1e-12;
}

TEST(GridErrorsBetweenSamples, AreAtLeastThoseOfTheFinestGrid) {
  GridErrorScratch scratch;
  size_t larger = 0, smaller_without = 0;
  for (uint32_t seed = 0; seed < 12; ++seed) {
    const RoughPatch patch(2, 0.5, seed % 2 == 1, seed);
    PatchNormals normals;
    for (size_t k = 0; k < 4; ++k) normals.corners[k] = patch.base.corners[k].normal;
    SurfaceGrid finest(7), grid(4);
    patch.baked.surface(*patch.context, 0, finest);
    patch.baked.surface(*patch.context, 0, grid);
    BetweenSamples between = patch.baked.betweenSamples(*patch.context, 0);
    const auto exact = gridErrors(finest, normals, scratch), quick = gridErrors(grid, between, normals, scratch);
    BetweenSamples nothing = between;
    nothing.twist_mm = nothing.product_mm = nothing.rounding_mm = nothing.normal_change = 0;
    const auto without = gridErrors(grid, nothing, normals, scratch);
    ASSERT_EQ(exact.size(), quick.size());
    for (size_t log2 = 0; log2 < exact.size(); ++log2) {
      ASSERT_EQ(exact[log2].mm.size(), quick[log2].mm.size());
      for (size_t i = 0; i < exact[log2].mm.size(); ++i) {
        const Deviation e = deviationOf(exact[log2].mm[i], exact[log2].shapes[i]),
                        q = deviationOf(quick[log2].mm[i], quick[log2].shapes[i]);
        // Shares are rounded up to 255ths of what they are shares of.
        const double rounding = 2 * q.mm / 255;
        EXPECT_TRUE(contains({q.mm, q.below_mm + rounding, q.above_mm + rounding, q.aside_mm + rounding,
                              q.between_mm + 2 * rounding, q.apart_mm + 2 * rounding},
                             e))
            << seed << " " << log2 << " " << i;
        EXPECT_LE(q.mm, e.mm + 2.01 * between.mm(4) + 1e-6) << seed << " " << log2 << " " << i;
        larger += q.mm > e.mm;
        smaller_without += without[log2].mm[i] < e.mm * (1 - 1e-6);
      }
    }
  }
  EXPECT_GT(larger, 50u);
  EXPECT_GT(smaller_without, 50u) << "the control: what lies between samples counts";
}

}  // namespace grid_error_test
}  // namespace relievo
