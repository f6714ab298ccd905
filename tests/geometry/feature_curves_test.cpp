// Creases that base meshes follow, and the cones of normals that tell where a base mesh must stay fine.
#include "geometry/remesh/feature_curves.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <numeric>
#include <random>

#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/normal_cone.h"

namespace relievo {
namespace feature_curves_test {

constexpr double kDegree = std::numbers::pi / 180;

// A roof over [0, 1] x [-0.2, 0.2] whose ridge along x folds by 80 degrees at x = 0 and by ever less towards x = 1.
TriangleMesh flatteningRoof() {
  constexpr uint32_t kSteps = 64;
  std::vector<glm::vec3> points;
  for (uint32_t i = 0; i <= kSteps; ++i) {
    const double x = static_cast<double>(i) / kSteps, slope = std::tan((40 - 40 * x) * kDegree);
    for (double y : {-0.2, 0.0, 0.2}) points.emplace_back(x, y, -std::abs(y) * slope);
  }
  std::vector<Triangle> triangles;
  for (uint32_t i = 0; i < kSteps; ++i)
    for (uint32_t k : {0u, 1u}) {
      const uint32_t a = 3 * i + k;
      triangles.push_back({a, a + 3, a + 4});
      triangles.push_back({a, a + 4, a + 1});
    }
  return halfEdgeMeshOf(*makeSurface(points, triangles));
}

std::vector<FeatureCurve> creasesOf(TriangleMesh mesh, double min_length_per_node) {
  std::vector<uint32_t> vertex(mesh.n_vertices());
  std::iota(vertex.begin(), vertex.end(), 0u);
  return findFeatureCurves({}, vertex, min_length_per_node, mesh);
}

// Folds of 50 degrees end at x = 3/8, those of 25 at x = 11/16.
TEST(FeatureCurves, ACreaseGoesOnWhereItFlattens) {
  const auto creases = creasesOf(flatteningRoof(), 0.2);
  ASSERT_EQ(creases.size(), 1u);
  EXPECT_NEAR(creases[0].length(), 11.0 / 16, 1.5 / 64);
}

TEST(FeatureCurves, SmallPatchesFollowShorterCreases) {
  // Two ends: the crease has 11/32 for each.
  EXPECT_EQ(creasesOf(flatteningRoof(), 0.32).size(), 1u);
  EXPECT_EQ(creasesOf(flatteningRoof(), 0.36).size(), 0u);
}

glm::dvec3 randomDirection(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
}
double angle(const glm::dvec3& a, const glm::dvec3& b) { return std::acos(std::clamp(glm::dot(a, b), -1.0, 1.0)); }

TEST(NormalCone, HoldsWhatWasAddedAndHardlyMore) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> half_angle(0, 0.6), turn(0, 2 * std::numbers::pi);
  int outside_the_first = 0;
  for (int round = 0; round < 500; ++round) {
    const glm::dvec3 a = randomDirection(random), b = randomDirection(random);
    const double at_a = half_angle(random), at_b = half_angle(random);
    NormalCone cone(a, at_a);
    cone.add({b, at_b});
    // Directions on the edge of b's cone lie in the joined one: seen from any n, none is further than it says.
    const glm::dvec3 side =
        glm::normalize(glm::cross(b, std::abs(b.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0)));
    for (int k = 0; k < 8; ++k) {
      const double phi = turn(random);
      const glm::dvec3 out = side * std::cos(phi) + glm::cross(b, side) * std::sin(phi);
      const glm::dvec3 edge = b * std::cos(at_b) + out * std::sin(at_b), n = randomDirection(random);
      EXPECT_GE(cone.largestAngle(n) + 1e-6, angle(n, edge));
      outside_the_first += angle(a, edge) > at_a;
    }
    // Seen from b it reaches as far as the far edge of a's cone, and no further.
    EXPECT_NEAR(cone.largestAngle(b), std::min(std::max(angle(a, b) + at_a, at_b), std::numbers::pi), 1e-6);
  }
  EXPECT_GT(outside_the_first, 1000) << "the first cones alone would pass";
  EXPECT_EQ(NormalCone().largestAngle({0, 0, 1}), 0);
}

}  // namespace feature_curves_test
}  // namespace relievo
