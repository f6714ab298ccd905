// How much of a surface only its vertices tell: nothing of a plane, curvature over a step of a smooth one, all of
// noise.
#include "geometry/bake/vertex_detail.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace relievo {
namespace vertex_detail_test {

constexpr uint64_t kSeed = 20261129;

// cells x cells, a side of 1 each; height(x, y).
template <class Height>
TriMesh gridOf(int cells, Height&& height) {
  TriMesh mesh;
  for (int y = 0; y <= cells; ++y)
    for (int x = 0; x <= cells; ++x) mesh.positions_mm.push_back({x, y, height(x, y)});
  const auto row = static_cast<uint32_t>(cells + 1);
  for (uint32_t y = 0; y + 1 < row; ++y)
    for (uint32_t x = 0; x + 1 < row; ++x) {
      const uint32_t a = y * row + x;
      mesh.triangles.push_back({a, a + 1, a + row + 1});
      mesh.triangles.push_back({a, a + row + 1, a + row});
    }
  return mesh;
}

TEST(VertexDetail, IsNothingOnAPlane) {
  EXPECT_NEAR(
      vertexDetail(gridOf(20, [](int x, int y) { return 0.3f * static_cast<float>(x) - static_cast<float>(y); })), 0,
      1e-6);
  EXPECT_EQ(vertexDetail(TriMesh{}), 0);
}

// z = x^2/(2 r): a vertex has six neighbours, four of which lie 1/(2 r) above its tangent plane.
TEST(VertexDetail, IsTheCurvatureOverAStep) {
  constexpr double kRadius = 1000, kExpected = 4.0 / 6 / (2 * kRadius);
  const TriMesh mesh = gridOf(40, [](int x, int) {
    const double from_middle = x - 20;
    return static_cast<float>(from_middle * from_middle / (2 * kRadius));
  });
  EXPECT_NEAR(vertexDetail(mesh), kExpected, 0.06 * kExpected) << "but for the border";
}

// Of independent heights: the vertex's own, and a sixth of each neighbour's.
TEST(VertexDetail, IsAllOfNoise) {
  std::mt19937 random(kSeed);
  std::normal_distribution<float> normal(0, 1e-3f);
  const TriMesh noisy = gridOf(80, [&](int, int) { return normal(random); });
  EXPECT_NEAR(vertexDetail(noisy), 1e-3 * std::sqrt(1 + 1.0 / 6), 0.05e-3);
  // Control: the same surface on every fourth vertex, and its triangles in 4 x 4 parts, hardly has any at most
  // vertices.
  std::vector<float> coarse(21 * 21);
  for (float& z : coarse) z = normal(random);
  const TriMesh finer = gridOf(80, [&](int x, int y) {
    const int cx = std::min(x / 4, 19), cy = std::min(y / 4, 19);
    const float fx = static_cast<float>(x - 4 * cx) / 4, fy = static_cast<float>(y - 4 * cy) / 4;
    auto at = [&](int i, int j) { return coarse[static_cast<size_t>((cy + j) * 21 + cx + i)]; };
    return fx > fy ? at(0, 0) * (1 - fx) + at(1, 0) * (fx - fy) + at(1, 1) * fy
                   : at(0, 0) * (1 - fy) + at(0, 1) * (fy - fx) + at(1, 1) * fx;
  });
  EXPECT_LT(vertexDetail(finer), 0.25e-3);
}

}  // namespace vertex_detail_test
}  // namespace relievo
