// Which edges of a scan are creases, with a normal for each side, and which are noise, or round.
#include "geometry/bake/corner_normals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <random>
#include <set>
#include <span>
#include <utility>
#include <vector>

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

// A pocket in a square plate: every triangle of the plate reaches from the pocket's rim to a corner. The walls are
// skewed, as reduced scans have them: their lower ends are anywhere, so that most are steep and some begin as fillets
// do. First are the plate's triangles, and its corners' vertices. bulge: by how much every other vertex of the rim is
// above the plane.
struct PocketPlate {
  static constexpr uint32_t kCorners = 4, kSides = 20;
  TriMesh mesh;
  size_t plate = 0;  // triangles
};
PocketPlate pocketPlate(float bulge) {
  constexpr uint32_t kSides = PocketPlate::kSides, kRim = PocketPlate::kCorners, kLow = kRim + kSides;
  PocketPlate out;
  TriMesh& mesh = out.mesh;
  mesh.positions_mm = {{100, 100, 0}, {-100, 100, 0}, {-100, -100, 0}, {100, -100, 0}};
  addRing(mesh, kSides, 10, 0);
  for (uint32_t k = 1; k < kSides; k += 2) mesh.positions_mm[kRim + k].z = bulge;
  addRing(mesh, kSides, 1, 0);
  std::mt19937 random(3);
  std::uniform_real_distribution<float> radius(7, 13), depth(5, 9);
  for (uint32_t k = 0; k < kSides; ++k) {
    glm::vec3& low = mesh.positions_mm[kLow + k];
    const float r = k % 5 ? radius(random) : 4, z = k % 5 ? -depth(random) : -2;
    low = {r * low.x, r * low.y, z};
  }
  for (uint32_t k = 0; k < kSides; ++k) {
    const uint32_t next = (k + 1) % kSides, corner = k * PocketPlate::kCorners / kSides;
    const uint32_t next_corner = next * PocketPlate::kCorners / kSides;
    mesh.triangles.push_back({kRim + k, corner, kRim + next});
    if (next_corner != corner) mesh.triangles.push_back({corner, next_corner, kRim + next});
  }
  out.plate = mesh.triangles.size();
  for (uint32_t k = 0; k < kSides; ++k) {
    const uint32_t next = (k + 1) % kSides;
    mesh.triangles.push_back({kRim + k, kRim + next, kLow + next});
    mesh.triangles.push_back({kRim + k, kLow + next, kLow + k});
  }
  addFan(mesh, kLow, kSides, {0, 0, -10}, true);
  return out;
}

TEST(CornerNormals, aPlateIsFlatUpToARaggedPocket) {
  auto worstOfPlate = [](const PocketPlate& made, const CornerNormals& found) {
    TriMesh plate = made.mesh;
    plate.triangles.resize(made.plate);
    return worstAngles(plate, found, [](uint32_t, uint32_t) { return glm::dvec3(0, 0, 1); });
  };
  const PocketPlate flat = pocketPlate(0);
  const CornerNormals found = cornerNormals(flat.mesh);
  EXPECT_LT(worstOfPlate(flat, found).corners, 0.1);
  EXPECT_GT(worstOfPlate(flat, found).vertices, 30);
  // The walls, sharp as their edges are, have one normal at each place.
  std::map<uint32_t, std::set<uint32_t>> walls;
  for (auto i = static_cast<uint32_t>(flat.plate); i < flat.mesh.triangles.size(); ++i)
    for (size_t k = 0; k < 3; ++k) walls[flat.mesh.triangles[i][k]].insert(found.ofTriangle(flat.mesh, i)[k]);
  for (const auto& [vertex, normals] : walls)
    EXPECT_LE(normals.size(), vertex < PocketPlate::kCorners + PocketPlate::kSides ? 2u : 1u) << vertex;
  // Control: the rim is known by nothing but the plane. Here the plate's triangles are a degree or two off.
  const PocketPlate bulging = pocketPlate(0.1f);
  EXPECT_GT(worstOfPlate(bulging, cornerNormals(bulging.mesh)).corners, 20);
}

// Shares of the edges between two triangles: in one plane, and sharp.
struct EdgeShares {
  double flat = 0, sharp = 0;
};
EdgeShares edgeShares(const TriMesh& mesh) {
  EdgeShares shares;
  double edges = 0;
  forEachEdge(mesh.triangles, mesh.positions_mm.size(), [&](std::span<const uint32_t> halves) {
    if (halves.size() != 2) return;
    const double angle =
        degreesBetween(normalOf(mesh, mesh.triangles[halves[0] / 3]), normalOf(mesh, mesh.triangles[halves[1] / 3]));
    ++edges;
    shares.flat += angle < 0.5;
    shares.sharp += angle > 40;
  });
  return {shares.flat / edges, shares.sharp / edges};
}

// A level, or a slope, with noise, heights in steps, sampled `along` times as far apart one way as the other.
TriMesh steppedPlane(double slope, double noise, double step, double along) {
  std::mt19937 random(5);
  std::normal_distribution<double> offset(0, noise * step);
  return gridMesh(90, 90, false, false, [&](double u, double v) {
    const double x = 90 * u, y = 90 * along * v;
    return glm::dvec3(x, y, step * std::round((slope * (0.9 * x + 0.4 * y) + offset(random)) / step));
  });
}

TEST(CornerNormals, planesWithNoiseInStepsAreNoPlates) {
  for (const double slope : {0.0, 0.13}) {
    for (const auto& [noise, step] : {std::pair{0.5, 0.5}, {1.0, 0.5}, {1.0, 2.0}}) {
      const TriMesh mesh = steppedPlane(slope, noise, step, 1);
      // Where a crease was found by chance there is a corner for every triangle at its six vertices.
      EXPECT_LT(cornerNormals(mesh).split.size(), mesh.triangles.size() / 100) << slope << " " << step;
      // Control: there is what plates are made of.
      const EdgeShares shares = edgeShares(mesh);
      EXPECT_GT(shares.flat, 0.03);
      EXPECT_GT(shares.sharp, 0.1);
    }
  }
  // Of a line scan all edges along the lines are long.
  const TriMesh lines = steppedPlane(0.13, 0.5, 0.5, 8);
  EXPECT_LT(cornerNormals(lines).split.size(), lines.triangles.size() / 50);
  EXPECT_GT(edgeShares(lines).flat, 0.05);
}

// Marching cubes of a ball. An edge is cut at the middle of one of so many parts, as of a volume of few values: the
// surface is one of small steps.
TriMesh marchedBall(int radius, int parts) {
  using Cell = std::array<int, 3>;
  const int n = 2 * radius + 6;
  const glm::dvec3 centre(n / 2.0 + 0.13, n / 2.0 - 0.21, n / 2.0 + 0.07);
  auto outside = [&](const Cell& c) { return glm::length(glm::dvec3(c[0], c[1], c[2]) - centre) - radius; };
  TriMesh mesh;
  std::map<std::pair<Cell, Cell>, uint32_t> names;
  auto vertex = [&](Cell a, Cell b) {
    if (b < a) std::swap(a, b);
    const auto [it, fresh] = names.try_emplace({a, b}, static_cast<uint32_t>(mesh.positions_mm.size()));
    if (fresh) {
      const double at = outside(a) / (outside(a) - outside(b));
      const auto share = static_cast<float>((std::floor(at * parts) + 0.5) / parts);
      const glm::vec3 from(a[0], a[1], a[2]), to(b[0], b[1], b[2]);
      mesh.positions_mm.push_back(from + share * (to - from));
    }
    return it->second;
  };
  for (int cube = 0; cube < n * n * n; ++cube) {
    const Cell low{cube % n, cube / n % n, cube / n / n};
    std::map<uint32_t, uint32_t> next;  // around the polygons, by what they leave on each face of the cube
    for (size_t axis = 0; axis < 3; ++axis) {
      for (int side = 0; side < 2; ++side) {
        std::array<Cell, 4> corners{low, low, low, low};  // counter-clockwise from outside the cube
        for (Cell& c : corners) c[axis] += side;
        const size_t x = (axis + (side ? 1 : 2)) % 3, y = (axis + (side ? 2 : 1)) % 3;
        ++corners[1][x], ++corners[2][x], ++corners[2][y], ++corners[3][y];
        std::vector<std::pair<bool, uint32_t>> cuts;  // does the ball begin there?
        for (size_t k = 0; k < 4; ++k) {
          const Cell &a = corners[k], &b = corners[(k + 1) % 4];
          if ((outside(a) < 0) != (outside(b) < 0)) cuts.push_back({outside(b) < 0, vertex(a, b)});
        }
        for (size_t k = 0; k < cuts.size(); ++k)
          if (cuts[k].first) next[cuts[k].second] = cuts[(k + 1) % cuts.size()].second;
      }
    }
    while (!next.empty()) {
      std::vector<uint32_t> polygon{next.begin()->first};
      while (true) {
        const auto it = next.find(polygon.back());
        const uint32_t to = it->second;
        next.erase(it);
        if (to == polygon[0]) break;
        polygon.push_back(to);
      }
      for (size_t k = 2; k < polygon.size(); ++k) mesh.triangles.push_back({polygon[0], polygon[k - 1], polygon[k]});
    }
  }
  for (glm::vec3& p : mesh.positions_mm) p -= glm::vec3(centre);
  return mesh;
}

TEST(CornerNormals, stairsOfMarchingCubesAreNoPlates) {
  for (const int radius : {8, 14}) {
    const TriMesh mesh = marchedBall(radius, 2);
    EXPECT_FALSE(cornerNormals(mesh).hasCreases()) << radius;
    EXPECT_LT(rmsDegrees(mesh), 25);
    // Control: there is what plates are made of.
    const EdgeShares shares = edgeShares(mesh);
    EXPECT_GT(shares.flat, 0.1);
    EXPECT_GT(shares.sharp, 0.01);
  }
}

TEST(CornerNormals, aNoisyBallOnALatticeHasNoPlates) {
  for (const auto& [noise, step] : {std::pair{0.18, 1.0f}, {0.1, 1.4f}, {0.18, 2.0f}}) {
    TriMesh mesh = noisyBall(24, noise);  // edges of about 3
    for (glm::vec3& p : mesh.positions_mm) p = step * glm::round(p / step);
    EXPECT_FALSE(cornerNormals(mesh).hasCreases()) << noise << " " << step;
    // Control: there is what plates are made of.
    const EdgeShares shares = edgeShares(mesh);
    EXPECT_GT(shares.flat, 0.05);
    EXPECT_GT(shares.sharp, 0.1);
  }
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
