// Which edges of a scan are creases, with a normal for each side, and which are noise, or round.
#include "geometry/bake/corner_normals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <span>

#include "geometry/mesh/mesh_edges.h"
#include "tests/geometry/base_shapes.h"

namespace relievo {
namespace corner_normals_test {

constexpr double kDegree = std::numbers::pi / 180;

CornerNormals cornerNormals(const TriMesh& mesh, int workers = 1) {
  CornerNormals out;
  EXPECT_TRUE(makeCornerNormals(mesh, workers, nullptr, out));
  return out;
}

double degreesBetween(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b)) / kDegree;
}

glm::dvec3 normalOf(const TriMesh& mesh, const std::array<uint32_t, 3>& t) {
  const glm::dvec3 a = mesh.positions_mm[t[0]], b = mesh.positions_mm[t[1]], c = mesh.positions_mm[t[2]];
  return glm::normalize(glm::cross(b - a, c - a));
}

// The largest angles between the corners' normals and truth(triangle, vertex): of the scan's shading, and of the mean
// normals of vertices, which are the control.
struct Worst {
  double corners = 0, vertices = 0;
};
template <class Truth>
Worst worstAngles(const TriMesh& mesh, const CornerNormals& found, Truth truth) {
  Worst worst;
  for (uint32_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& t = mesh.triangles[i];
    const auto& corners = found.ofTriangle(mesh, i);
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 expected = truth(i, t[k]);
      worst.corners = std::max(worst.corners, degreesBetween(found.normals[corners[k]], expected));
      worst.vertices = std::max(worst.vertices, degreesBetween(found.normals[t[k]], expected));
    }
  }
  return worst;
}

TEST(CornerNormals, flatFacesAreFlatUpToTheirEdges) {
  for (const TriMesh& box : {boxMesh(1, 100, 10, 1), boxMesh(6, 100, 10, 1)}) {
    const CornerNormals found = cornerNormals(box);
    const Worst worst = worstAngles(box, found, [&](uint32_t i, uint32_t) { return normalOf(box, box.triangles[i]); });
    EXPECT_LT(worst.corners, 0.1);
    EXPECT_GT(worst.vertices, 40);
  }
}

// A disc or a cone's side: triangles from the ring's vertices [first, first + n) to `centre`, outside upwards.
void addFan(TriMesh& mesh, uint32_t first, uint32_t n, const glm::vec3& centre, bool upwards) {
  const auto middle = static_cast<uint32_t>(mesh.positions_mm.size());
  mesh.positions_mm.push_back(centre);
  for (uint32_t k = 0; k < n; ++k) {
    const uint32_t a = first + k, b = first + (k + 1) % n;
    mesh.triangles.push_back({upwards ? a : b, upwards ? b : a, middle});
  }
}
void addRing(TriMesh& mesh, uint32_t n, float radius, float z) {
  for (uint32_t k = 0; k < n; ++k) {
    const double turn = 2 * std::numbers::pi * k / n;
    mesh.positions_mm.push_back({radius * std::cos(turn), radius * std::sin(turn), z});
  }
}

TEST(CornerNormals, aCylinderIsRoundAndHasSharpRims) {
  constexpr uint32_t kSides = 32;
  TriMesh mesh;
  addRing(mesh, kSides, 10, 0);
  addRing(mesh, kSides, 10, 30);
  for (uint32_t k = 0; k < kSides; ++k) {
    const uint32_t next = (k + 1) % kSides;
    mesh.triangles.push_back({k, next, kSides + next});
    mesh.triangles.push_back({k, kSides + next, kSides + k});
  }
  const size_t walls = mesh.triangles.size();
  addFan(mesh, 0, kSides, {0, 0, 0}, false);
  addFan(mesh, kSides, kSides, {0, 0, 30}, true);
  const CornerNormals found = cornerNormals(mesh);
  const Worst worst = worstAngles(mesh, found, [&](uint32_t i, uint32_t v) -> glm::dvec3 {
    if (i >= walls) return normalOf(mesh, mesh.triangles[i]);
    return glm::normalize(glm::dvec3(mesh.positions_mm[v].x, mesh.positions_mm[v].y, 0));
  });
  EXPECT_LT(worst.corners, 0.1);
  EXPECT_GT(worst.vertices, 40);
  // Control: a wall's own normal is half a side's turn away from the round one.
  EXPECT_NEAR(degreesBetween(normalOf(mesh, mesh.triangles[0]), {1, 0, 0}), 180.0 / kSides, 1e-3);
}

TEST(CornerNormals, aConeHasNoNormalAtItsTip) {
  constexpr uint32_t kSides = 32;
  TriMesh mesh;
  addRing(mesh, kSides, 10, 0);
  addFan(mesh, 0, kSides, {0, 0, 20}, true);
  const uint32_t tip = kSides;
  addFan(mesh, 0, kSides, {0, 0, 0}, false);
  const CornerNormals found = cornerNormals(mesh);
  const Worst worst = worstAngles(mesh, found, [&](uint32_t i, uint32_t v) -> glm::dvec3 {
    if (i >= kSides || v == tip) return normalOf(mesh, mesh.triangles[i]);
    return glm::normalize(glm::dvec3(2.0 * mesh.positions_mm[v].x, 2.0 * mesh.positions_mm[v].y, 10));
  });
  EXPECT_LT(worst.corners, 0.2);  // the sides are flat, the truth is round
  EXPECT_GT(worst.vertices, 60);
}

// A crease that flattens out has an end, where the surface is one.
TEST(CornerNormals, aCreaseEndsWhereItIsFlat) {
  const TriMesh mesh = gridMesh(8, 40, false, false, [](double u, double v) {
    return glm::dvec3(4 * u, 40 * v, -2 * std::abs(4 * u - 2) * std::clamp(1.8 - 2 * v, 0.0, 1.0));
  });
  const CornerNormals found = cornerNormals(mesh);
  size_t sharp = 0, smooth = 0;
  for (uint32_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& corners = found.ofTriangle(mesh, i);
    for (size_t k = 0; k < 3; ++k) {
      const uint32_t v = mesh.triangles[i][k];
      const glm::vec3 p = mesh.positions_mm[v];
      if (std::abs(p.x - 2) > 0.1f || p.y > 33) {
        EXPECT_EQ(corners[k], v) << p.x << " " << p.y;
        ++smooth;
      } else if (p.y < 14) {
        EXPECT_LT(degreesBetween(found.normals[corners[k]], normalOf(mesh, mesh.triangles[i])), 0.1);
        EXPECT_GT(degreesBetween(found.normals[v], normalOf(mesh, mesh.triangles[i])), 60);
        ++sharp;
      }
    }
  }
  EXPECT_GT(sharp, 30u);
  EXPECT_GT(smooth, 1000u);
}

// A ball whose vertices are moved at random. The triangles' normals are off by 25 degrees, root mean square.
TriMesh noisyBall(int n, double noise) {
  TriMesh mesh = ballMesh(n);
  std::mt19937 random(7);
  std::normal_distribution<float> offset(0, static_cast<float>(noise * 50 * std::numbers::pi / (2 * n)));
  for (glm::vec3& p : mesh.positions_mm) p += glm::vec3(offset(random), offset(random), offset(random));
  return mesh;
}
double rmsDegrees(const TriMesh& mesh) {
  double sum = 0;
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 out = mesh.positions_mm[t[0]] + mesh.positions_mm[t[1]] + mesh.positions_mm[t[2]];
    sum += std::pow(degreesBetween(normalOf(mesh, t), out), 2);
  }
  return std::sqrt(sum / static_cast<double>(mesh.triangles.size()));
}

TEST(CornerNormals, noiseIsNoCrease) {
  for (const double noise : {0.1, 0.15, 0.18, 0.25, 0.35}) {
    const TriMesh mesh = noisyBall(24, noise);
    EXPECT_FALSE(cornerNormals(mesh).hasCreases()) << "triangles off by " << rmsDegrees(mesh) << " degrees";
  }
  // Controls: it is as much noise as said, and an angle alone would find creases all over.
  const TriMesh mesh = noisyBall(24, 0.18);
  EXPECT_NEAR(rmsDegrees(mesh), 25, 2);
  size_t edges = 0, sharp = 0;
  forEachEdge(mesh.triangles, mesh.positions_mm.size(), [&](std::span<const uint32_t> halves) {
    ASSERT_EQ(halves.size(), 2u);
    ++edges;
    sharp += degreesBetween(normalOf(mesh, mesh.triangles[halves[0] / 3]),
                            normalOf(mesh, mesh.triangles[halves[1] / 3])) > 40;
  });
  EXPECT_GT(sharp, edges / 8);
  // A box beside the ball has its creases.
  const TriMesh both = together(mesh, boxMesh(4, 20, 20, 20), glm::vec3(200, 0, 0));
  EXPECT_TRUE(cornerNormals(both).hasCreases());
}

TEST(CornerNormals, areTheSameForAnyNumberOfWorkers) {
  TriMesh mesh = together(noisyBall(40, 0.1), boxMesh(36, 80, 60, 40), glm::vec3(200, 0, 0));
  mesh = together(mesh, boxMesh(1, 1, 2, 3), glm::vec3(0, 200, 0));
  ASSERT_GT(mesh.positions_mm.size(), 4 * 4096u);  // so that there are several ranges of vertices
  const CornerNormals one = cornerNormals(mesh, 1);
  EXPECT_GT(one.split.size(), 1000u);
  for (const int workers : {2, 5}) {
    const CornerNormals other = cornerNormals(mesh, workers);
    EXPECT_EQ(one.normals, other.normals);
    EXPECT_EQ(one.split, other.split);
    ASSERT_EQ(one.runs.size(), other.runs.size());
    for (size_t i = 0; i < one.runs.size(); ++i) EXPECT_EQ(one.runs[i].split, other.runs[i].split);
  }
  const std::atomic<bool> interrupted{true};
  CornerNormals none;
  EXPECT_FALSE(makeCornerNormals(mesh, 2, &interrupted, none));
}

}  // namespace corner_normals_test
}  // namespace relievo
