// Lines and closest points against triangles: analytic planes and spheres, and brute force over all triangles.
#include "geometry/ray_scene.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/geometry/mesh_shapes.h"

namespace relievo {
namespace {


// The distance to a triangle by its interior and its three segments.
double distanceTo(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c, const glm::dvec3& p) {
  auto segment = [&](const glm::dvec3& from, const glm::dvec3& to) {
    const glm::dvec3 d = to - from;
    const double t = std::clamp(glm::dot(p - from, d) / glm::dot(d, d), 0.0, 1.0);
    return glm::length(p - from - t * d);
  };
  double best = std::min({segment(a, b), segment(b, c), segment(c, a)});
  const glm::dvec3 n = glm::cross(b - a, c - a);
  const glm::dvec3 foot = p - n * (glm::dot(p - a, n) / glm::dot(n, n));
  const bool inside = glm::dot(glm::cross(b - a, foot - a), n) >= 0 && glm::dot(glm::cross(c - b, foot - b), n) >= 0 &&
                      glm::dot(glm::cross(a - c, foot - c), n) >= 0;
  if (inside) best = std::min(best, glm::length(p - foot));
  return best;
}

TEST(RayScene, closestPointsAreThoseOfBruteForce) {
  const TriMesh mesh = sphereMesh(10.0, 12);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene) << scene.error().text();
  std::mt19937 random(7);
  std::uniform_real_distribution<double> place(-15, 15);
  for (int i = 0; i < 2000; ++i) {
    const glm::dvec3 p(place(random), place(random), place(random));
    double expected = std::numeric_limits<double>::infinity();
    for (const auto& t : mesh.triangles) expected = std::min(expected, distanceTo(mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]], p));
    const SurfacePoint found = (*scene)->closestPoint(p);
    ASSERT_TRUE(found);
    EXPECT_NEAR(found.along, expected, 1e-12);
    const auto& t = mesh.triangles[found.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    EXPECT_NEAR(glm::length(a + found.b1 * (b - a) + found.b2 * (c - a) - p), expected, 1e-12);
    EXPECT_TRUE((*scene)->closestPoint(p, expected * (1 + 1e-9)));
    EXPECT_FALSE((*scene)->closestPoint(p, expected * (1 - 1e-6)));
  }
}

TEST(RayScene, linesTakeTheNearestSurfaceThatFacesThem) {
  const TriMesh mesh = sphereMesh(10.0, 24);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene);
  std::mt19937 random(8);
  std::normal_distribution<double> gauss;
  for (int i = 0; i < 2000; ++i) {
    const glm::dvec3 n = glm::normalize(glm::dvec3(gauss(random), gauss(random), gauss(random)));
    // From 9 along n, whose length is 2: the sphere's outside is 0.5 away; its other side, 9.5 away, faces the other way.
    const SurfacePoint out = (*scene)->nearestOnLine({9.0 * n, 2.0 * n, 20}, Facing::kAlong);
    ASSERT_TRUE(out);
    EXPECT_NEAR(out.along, 0.5, 0.05);
    EXPECT_LE(out.along, 0.5 + 1e-6);  // the mesh is inscribed
    // From beyond: downwards.
    const SurfacePoint back = (*scene)->nearestOnLine({11.0 * n, 2.0 * n, 20}, Facing::kAlong);
    ASSERT_TRUE(back);
    EXPECT_NEAR(back.along, -0.5, 0.05);
    // From -9 along n the near side faces away: only Facing::kAny takes it.
    const SurfacePoint far = (*scene)->nearestOnLine({-9.0 * n, n, 30}, Facing::kAlong);
    ASSERT_TRUE(far);
    EXPECT_NEAR(far.along, 19, 0.1);
    const SurfacePoint any = (*scene)->nearestOnLine({-9.0 * n, n, 30}, Facing::kAny);
    ASSERT_TRUE(any);
    EXPECT_NEAR(any.along, -1, 0.1);
    EXPECT_FALSE((*scene)->nearestOnLine({9.0 * n, 2.0 * n, 0.4}, Facing::kAlong));
    // What the line is said to meet lies on the line.
    const auto& t = mesh.triangles[out.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    EXPECT_LT(glm::length(a + out.b1 * (b - a) + out.b2 * (c - a) - (9.0 + 2.0 * out.along) * n), 1e-5);
  }
}

TEST(RayScene, linesThroughVerticesAndEdgesAreNotLost) {
  const TriMesh mesh = sphereMesh(10.0, 16);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene);
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      const glm::dvec3 a(mesh.positions_mm[t[k]]), b(mesh.positions_mm[t[(k + 1) % 3]]);
      for (const glm::dvec3& p : {a, 0.5 * (a + b)}) {
        const SurfacePoint on = (*scene)->nearestOnLine({p, glm::normalize(p), 1}, Facing::kAlong);
        ASSERT_TRUE(on);
        EXPECT_NEAR(on.along, 0, 1e-5);
      }
    }
  }
}

TEST(RayScene, anInterruptedBuildSaysSo) {
  const TriMesh mesh = sphereMesh(10.0, 64);
  const std::atomic<bool> interrupted{true};
  auto scene = RayScene::create(mesh, &interrupted);
  ASSERT_FALSE(scene);
  EXPECT_EQ(scene.error().kind, ErrorKind::kInterrupted);
}

}  // namespace
}  // namespace relievo
