// Base meshes of a scan's own triangles: they cover it exactly, each side belongs to two patches or to a border.
#include "geometry/remesh/base_faces.h"

#include <gtest/gtest.h>

#include <map>
#include <numbers>
#include <random>
#include <set>

#include "geometry/remesh/base_domain.h"
#include "geometry/remesh/triangle_pairs.h"
#include "tests/geometry/base_shapes.h"

namespace relievo {
namespace base_faces_test {

using Neighbours = std::vector<std::array<uint32_t, 3>>;

// The size of a largest matching, by trying.
size_t mostPairs(const Neighbours& neighbours, std::vector<uint8_t>& used, uint32_t from = 0) {
  while (from < used.size() && used[from]) ++from;
  if (from == used.size()) return 0;
  used[from] = 1;
  size_t most = mostPairs(neighbours, used, from + 1);
  for (uint32_t to : neighbours[from]) {
    if (to == kNoIndex || used[to]) continue;
    used[to] = 1;
    most = std::max(most, 1 + mostPairs(neighbours, used, from + 1));
    used[to] = 0;
  }
  used[from] = 0;
  return most;
}

TEST(TrianglePairs, AsManyAsThereCanBe) {
  std::mt19937 random(7);
  for (int round = 0; round < 400; ++round) {
    const uint32_t n = 4 + random() % 11;
    Neighbours neighbours(n, {kNoIndex, kNoIndex, kNoIndex});
    auto slot = [&](uint32_t t) { return std::find(neighbours[t].begin(), neighbours[t].end(), kNoIndex); };
    for (uint32_t tries = 0; tries < 3 * n; ++tries) {
      const uint32_t a = random() % n, b = random() % n;
      if (a == b || slot(a) == neighbours[a].end() || slot(b) == neighbours[b].end()) continue;
      *slot(a) = b;
      *slot(b) = a;
    }
    std::vector<uint32_t> mate(n, kNoIndex);
    const std::vector<uint8_t> none(n, 0);
    pairMoreTriangles(neighbours, none, mate);
    size_t paired = 0;
    for (uint32_t t = 0; t < n; ++t) {
      if (mate[t] == kNoIndex) continue;
      ++paired;
      EXPECT_EQ(mate[mate[t]], t);
      EXPECT_NE(std::find(neighbours[t].begin(), neighbours[t].end(), mate[t]), neighbours[t].end());
    }
    std::vector<uint8_t> used(n, 0);
    EXPECT_EQ(paired / 2, mostPairs(neighbours, used)) << "round " << round;
  }
}

// A path of three triangles of which only the first may stay alone: the others are paired, whichever was before.
TEST(TrianglePairs, WhoMayStayAloneGivesWay) {
  const Neighbours path{{1, kNoIndex, kNoIndex}, {0, 2, kNoIndex}, {1, kNoIndex, kNoIndex}};
  const std::vector<uint8_t> first_may{1, 0, 0};
  std::vector<uint32_t> mate{1, 0, kNoIndex};
  pairMoreTriangles(path, first_may, mate);
  EXPECT_EQ(mate, (std::vector<uint32_t>{kNoIndex, 2, 1}));
}

// Two that are alone at the ends of a long way, each step of which leads through an odd cycle of five: out of it by a
// triangle that is reached either way round.
TEST(TrianglePairs, ALongWayThroughOddCyclesIsFound) {
  constexpr uint32_t kCycles = 20'000;
  const uint32_t triangles = 6 * kCycles + 1, last = triangles - 1;
  Neighbours neighbours(triangles, {kNoIndex, kNoIndex, kNoIndex});
  std::vector<uint32_t> mate(triangles, kNoIndex);
  auto join = [&](uint32_t a, uint32_t b, bool paired = false) {
    *std::find(neighbours[a].begin(), neighbours[a].end(), kNoIndex) = b;
    *std::find(neighbours[b].begin(), neighbours[b].end(), kNoIndex) = a;
    if (paired) mate[a] = b, mate[b] = a;
  };
  for (uint32_t i = 0; i < kCycles; ++i) {
    const uint32_t first = 6 * i, c = first + 1;
    for (uint32_t k = 0; k < 5; ++k) join(c + k, c + (k + 1) % 5, k == 1 || k == 3);
    if (i == 0) continue;
    join(first - 4, first);  // from the second of the cycle before
    join(first, c, true);
  }
  join(last - 4, last);
  ASSERT_EQ(std::count(mate.begin(), mate.end(), kNoIndex), 3) << "the ends, and one without neighbours";
  pairMoreTriangles(neighbours, std::vector<uint8_t>(triangles, 0), mate);
  EXPECT_EQ(std::count(mate.begin(), mate.end(), kNoIndex), 1);
  EXPECT_NE(mate[last], kNoIndex);
  for (uint32_t t = 0; t < triangles; ++t) {
    if (mate[t] == kNoIndex) continue;
    ASSERT_EQ(mate[mate[t]], t);
    ASSERT_NE(std::find(neighbours[t].begin(), neighbours[t].end(), mate[t]), neighbours[t].end());
  }
}

double areaOf(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  return glm::length(glm::cross(b - a, c - a)) / 2;
}

bool liesOn(const TriMesh& scan, const glm::dvec3& p) {
  return std::any_of(scan.triangles.begin(), scan.triangles.end(), [&](const std::array<uint32_t, 3>& t) {
    const glm::dvec3 a = scan.positions_mm[t[0]], b = scan.positions_mm[t[1]], c = scan.positions_mm[t[2]];
    return areaOf(p, a, b) + areaOf(p, b, c) + areaOf(p, c, a) < areaOf(a, b, c) * (1 + 1e-5);
  });
}
bool isFlat(const BaseMesh& base, const std::array<uint32_t, 4>& p) {
  auto at = [&](size_t k) { return glm::dvec3(base.corners[p[k]].position_mm); };
  return std::abs(glm::dot(glm::cross(at(1) - at(0), at(3) - at(0)), at(2) - at(0))) < 1e-3;
}

struct Cover {
  double area = 0;          // of the patches' triangles
  size_t farther = 0;       // of those, and of points of flat patches: how many lie on no triangle of the scan
  size_t odd_sides = 0;     // sides of one patch, or of more than two
  size_t missing = 0;       // vertices of the scan that are no corner
  double least_facing = 1;  // of the patches' triangles, to the normals at their corners
};

Cover coverOf(const BaseMesh& base, const TriMesh& scan) {
  Cover c;
  std::map<std::pair<uint32_t, uint32_t>, int> sides;
  std::set<std::array<float, 3>> corners;
  for (const BaseCorner& k : base.corners) corners.insert({k.position_mm.x, k.position_mm.y, k.position_mm.z});
  for (const glm::vec3& p : scan.positions_mm) c.missing += !corners.contains({p.x, p.y, p.z});
  for (uint32_t patch = 0; patch < base.patches.size(); ++patch) {
    const auto& p = base.patches[patch];
    for (double v = 0.1; isFlat(base, p) && v < 1; v += 0.2)
      for (double u = 0.1; u < 1; u += 0.2) c.farther += !liesOn(scan, base.point(patch, u, v));
    for (const auto& [a, b] : kSideCorners) {
      const uint32_t i = p[static_cast<size_t>(a)], j = p[static_cast<size_t>(b)];
      ++sides[{std::min(i, j), std::max(i, j)}];
    }
    for (const std::array<size_t, 3>& t : {std::array<size_t, 3>{0, 2, 3}, std::array<size_t, 3>{0, 3, 1}}) {
      glm::dvec3 at[3];
      for (size_t k = 0; k < 3; ++k) at[k] = base.corners[p[t[k]]].position_mm;
      c.area += areaOf(at[0], at[1], at[2]);
      const glm::dvec3 middle = (at[0] + at[1] + at[2]) / 3.0,
                       normal = glm::normalize(glm::cross(at[1] - at[0], at[2] - at[0]));
      for (size_t k = 0; k < 3; ++k)
        c.least_facing = std::min(c.least_facing, glm::dot(normal, glm::dvec3(base.corners[p[t[k]]].normal)));
      c.farther += !liesOn(scan, middle);
    }
  }
  for (const auto& [side, uses] : sides) c.odd_sides += uses != 2;
  return c;
}

double areaOf(const TriMesh& m) {
  double area = 0;
  for (const auto& t : m.triangles) area += areaOf(m.positions_mm[t[0]], m.positions_mm[t[1]], m.positions_mm[t[2]]);
  return area;
}

BaseMesh facesOf(const TriMesh& mesh, uint32_t max_patches = 4096) {
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  EXPECT_TRUE(surface.ok());
  return surface.ok() ? facesBase(*surface, max_patches) : BaseMesh{};
}
// The largest angle between the two triangles of a patch.
double largestFold(const BaseMesh& base) {
  double largest = 0;
  for (const auto& p : base.patches) {
    auto at = [&](size_t k) { return glm::dvec3(base.corners[p[k]].position_mm); };
    const glm::dvec3 a = glm::cross(at(2) - at(0), at(3) - at(0)), b = glm::cross(at(3) - at(0), at(1) - at(0));
    largest = std::max(largest, std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b)));
  }
  return largest * 180 / std::numbers::pi;
}

// A sheet whose triangles look different left and right of a line that no pair of squares follows: no patch has both.
TEST(BaseFaces, PairsLookAlike) {
  constexpr int kCells = 6;
  TriMesh mesh;
  for (int y = 0; y <= kCells; ++y)
    for (int x = 0; x <= kCells; ++x) mesh.positions_mm.push_back({x, y, 0});
  std::vector<uint32_t> looks;
  for (int y = 0; y < kCells; ++y)
    for (int x = 0; x < kCells; ++x) {
      const auto a = static_cast<uint32_t>(y * (kCells + 1) + x), c = a + kCells + 1;
      mesh.triangles.push_back({a, a + 1, c + 1});
      mesh.triangles.push_back({a, c + 1, c});
      looks.push_back(7 + (x > y));
      looks.push_back(7 + (x > y + 1));  // of squares on a diagonal the halves differ
    }
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  // Patches whose triangles look different: single ones have one.
  auto mixed = [&](const BaseMesh& base) {
    size_t count = 0;
    for (const auto& p : base.patches) {
      std::set<uint32_t> seen;
      for (const auto& [i, j, k] : {std::array<size_t, 3>{0, 2, 3}, std::array<size_t, 3>{0, 3, 1}})
        for (size_t t = 0; t < mesh.triangles.size(); ++t) {
          const std::set<uint32_t> of{p[i], p[j], p[k]};
          if (of == std::set<uint32_t>(mesh.triangles[t].begin(), mesh.triangles[t].end())) seen.insert(looks[t]);
        }
      count += seen.size() > 1;
    }
    return count;
  };
  const BaseMesh apart = facesBase(*surface, 100, FaceNormals::kMean, looks), any = facesBase(*surface, 100);
  EXPECT_EQ(mixed(apart), 0u);
  EXPECT_GT(mixed(any), 0u) << "control";
  const Cover cover = coverOf(apart, mesh);
  EXPECT_NEAR(cover.area, kCells * kCells, 1e-4);
  EXPECT_EQ(cover.farther, 0u);
  EXPECT_EQ(any.patches.size(), size_t{kCells * kCells});
  EXPECT_GT(apart.patches.size(), any.patches.size());
  EXPECT_EQ(facesBase(*surface, kCells * kCells, FaceNormals::kMean, looks).patches, any.patches)
      << "where there may be no more";
}

// Three flat triangles beside one another: those that make a convex quad are a patch, though its corners are farther
// from right angles. Control: with a corner moved to the other side of that line, the squarer two are.
TEST(BaseFaces, ConvexQuadsComeFirst) {
  for (const bool convex : {false, true}) {
    TriMesh mesh;
    mesh.positions_mm = {{0, 0, 0}, {2, 0, 0}, {-0.26f, 1.477f, 0}, {-0.131f, -1.494f, 0}, {9.07f, 13.3f, 0}};
    if (convex) mesh.positions_mm[3].x = 0.9f;
    mesh.triangles = {{0, 1, 2}, {1, 0, 3}, {2, 1, 4}};
    const BaseMesh base = facesOf(mesh);
    ASSERT_EQ(base.patches.size(), 2u);
    const std::set<uint32_t> expected = convex ? std::set<uint32_t>{0, 1, 2, 3} : std::set<uint32_t>{0, 1, 2, 4};
    EXPECT_TRUE(std::any_of(base.patches.begin(), base.patches.end(), [&](const auto& p) {
      return std::set<uint32_t>(p.begin(), p.end()) == expected;
    })) << convex;
  }
}

// A prism over an arrowhead: the two triangles of a cap are no convex quad, and one patch all the same.
TriMesh arrowMesh() {
  TriMesh m;
  for (const glm::vec2& p : {glm::vec2(0, 0), glm::vec2(-20, -10), glm::vec2(30, 0), glm::vec2(-20, 10)})
    for (float z : {0.0f, 5.0f}) m.positions_mm.push_back({p.x, p.y, z});
  for (uint32_t k = 0; k < 4; ++k) {
    const uint32_t a = 2 * k, b = 2 * ((k + 1) % 4);
    m.triangles.push_back({a, b, b + 1});
    m.triangles.push_back({a, b + 1, a + 1});
  }
  for (const auto& [a, b, c] : {Triangle{0, 2, 4}, Triangle{0, 4, 6}}) {
    m.triangles.push_back({a, c, b});
    m.triangles.push_back({a + 1, b + 1, c + 1});
  }
  return m;
}
TriMesh tetrahedronMesh() {
  TriMesh m;
  m.positions_mm = {{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {0, 0, 10}};
  m.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
  return m;
}

TEST(BaseFaces, CoverTheScanExactly) {
  for (const TriMesh& mesh :
       {boxMesh(1, 30, 20, 10), boxMesh(3, 30, 20, 10), arrowMesh(), tetrahedronMesh(), ballMesh(6)}) {
    const BaseMesh base = facesOf(mesh);
    ASSERT_EQ(baseMeshProblem(base), "");
    const Cover c = coverOf(base, mesh);
    EXPECT_NEAR(c.area, areaOf(mesh), 1e-5 * areaOf(mesh));
    EXPECT_EQ(c.farther, 0u);
    EXPECT_EQ(c.odd_sides, 0u);
    EXPECT_EQ(c.missing, 0u);
    EXPECT_GT(c.least_facing, 0.08);
    EXPECT_LE(base.patches.size(), mesh.triangles.size());
  }
  EXPECT_EQ(facesOf(arrowMesh()).patches.size(), 6u) << "each cap and each wall";
  EXPECT_EQ(facesOf(tetrahedronMesh()).patches.size(), 4u);
  EXPECT_EQ(facesOf(boxMesh(1, 30, 20, 10)).patches.size(), 6u) << "no pair lies across an edge of the box";
}

TEST(BaseFacesControl, AnotherBaseIsTold) {
  const TriMesh mesh = boxMesh(3, 30, 20, 10);
  BaseMesh base = facesOf(mesh);
  base.corners[5].position_mm += glm::vec3(1, 1, 1);
  const Cover moved = coverOf(base, mesh);
  EXPECT_GT(moved.farther + moved.missing, 0u);
  base = facesOf(mesh);
  base.patches.pop_back();
  EXPECT_GT(coverOf(base, mesh).odd_sides, 0u);
}

// Three triangles in a row: one stays alone, with the middle of a border as its corner.
TEST(BaseFaces, BordersTakeWhoHasNoPartner) {
  TriMesh strip;
  strip.positions_mm = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {0, 2, 0}};
  strip.triangles = {{0, 1, 2}, {1, 3, 2}, {2, 3, 4}};
  const BaseMesh base = facesOf(strip);
  ASSERT_EQ(base.patches.size(), 2u);
  EXPECT_EQ(base.corners.size(), 6u);
  const Cover c = coverOf(base, strip);
  EXPECT_NEAR(c.area, 1.5, 1e-6);
  EXPECT_EQ(c.farther, 0u);
}

// Rounding makes a triangle's unit normal a little longer than 1 in some directions, and shorter in others: a corner
// takes the plane's normal in all of them.
TEST(BaseFaces, CornersOfFlatPartsFaceAsTheseDo) {
  std::mt19937 random(3);
  std::normal_distribution<double> turn;
  int longer = 0, shorter = 0;
  for (int round = 0; round < 200; ++round) {
    const glm::dvec3 x = unit({turn(random), turn(random), turn(random)}),
                     normal = unit(glm::cross(x, {turn(random), turn(random), turn(random)})),
                     y = glm::cross(normal, x);
    TriMesh triangle;
    triangle.positions_mm = {glm::vec3(0), glm::vec3(20.0 * x), glm::vec3(20.0 * y)};
    triangle.triangles = {{0, 1, 2}};
    const BaseMesh base = facesOf(triangle);
    ASSERT_EQ(base.patches.size(), 1u);
    for (const BaseCorner& c : base.corners)
      EXPECT_GT(glm::dot(glm::dvec3(c.normal), normal), 0.999) << "round " << round;
    const glm::dvec3 rounded =
        unit(glm::cross(glm::dvec3(triangle.positions_mm[1]), glm::dvec3(triangle.positions_mm[2])));
    longer += glm::dot(rounded, rounded) > 1;
    shorter += glm::dot(rounded, rounded) < 1;
  }
  EXPECT_GT(longer, 10);
  EXPECT_GT(shorter, 10);
}

TEST(BaseFaces, NoMoreThanAskedFor) {
  const TriMesh mesh = ballMesh(6);
  const size_t free = facesOf(mesh).patches.size(), least = mesh.triangles.size() / 2;
  EXPECT_GE(free, least);
  EXPECT_LE(facesOf(mesh, static_cast<uint32_t>(free - 1)).patches.size(), free - 1);
  EXPECT_TRUE(facesOf(mesh, static_cast<uint32_t>(least - 1)).patches.empty());
  auto domain = BaseDomain::create(mesh);
  ASSERT_TRUE(domain.ok());
  EXPECT_FALSE((*domain)->faces(static_cast<uint32_t>(least - 1)).ok());
  auto base = (*domain)->faces(4096);
  ASSERT_TRUE(base.ok());
  EXPECT_EQ(base->patches.size(), free);
  EXPECT_EQ(*base, *(*domain)->faces(4096));
}

// Pairs that fold are the scan, too, cut along the side that they share.
TEST(BaseFaces, PairsThatFoldAreTheScan) {
  const TriMesh ball = ballMesh(8);
  BaseMesh base = facesOf(ball);
  EXPECT_TRUE(base.cut);
  EXPECT_GT(largestFold(base), 6) << "control";
  EXPECT_LE(largestFold(base), 20);
  auto besideIt = [&] {
    int count = 0;
    for (uint32_t p = 0; p < base.patches.size(); ++p)
      for (const auto& [u, v] : {std::pair{0.37, 0.61}, {0.8, 0.1}, {0.5, 0.5}})
        count += !liesOn(ball, base.point(p, u, v));
    return count;
  };
  EXPECT_EQ(besideIt(), 0);
  base.cut = false;
  EXPECT_GT(besideIt(), 10) << "control";
}

// The mean of the triangles' normals by their angles, where all of them face it; else what faces all.
TEST(BaseFaces, MeanNormalsAreThoseOfTriangles) {
  for (const bool sharp : {false, true}) {
    TriMesh mesh = ballMesh(6);
    if (sharp)
      for (glm::vec3& p : mesh.positions_mm) p.z *= 0.02f;  // at the rim they face up and down
    auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
    ASSERT_TRUE(surface.ok());
    const BaseMesh mean = facesBase(*surface, 4096, FaceNormals::kMean), faced = facesBase(*surface, 4096);
    ASSERT_EQ(mean.patches, faced.patches);
    std::vector<glm::dvec3> sum(mean.corners.size(), glm::dvec3(0));
    std::vector<double> facing(mean.corners.size(), 1);
    auto forEachCorner = [&](auto&& f) {
      for (const Triangle& t : surface->triangles)
        for (size_t k = 0; k < 3; ++k) {
          const glm::dvec3 p = surface->points[t[k]], a = glm::dvec3(surface->points[t[(k + 1) % 3]]) - p,
                           b = glm::dvec3(surface->points[t[(k + 2) % 3]]) - p;
          f(t[k], unit(glm::cross(a, b)), std::acos(glm::dot(unit(a), unit(b))));
        }
    };
    forEachCorner([&](uint32_t v, const glm::dvec3& n, double angle) { sum[v] += n * angle; });
    forEachCorner(
        [&](uint32_t v, const glm::dvec3& n, double) { facing[v] = std::min(facing[v], glm::dot(n, unit(sum[v]))); });
    int means = 0, others = 0, differ = 0;
    for (size_t v = 0; v < surface->points.size(); ++v) {
      const glm::dvec3 n = mean.corners[v].normal;
      differ += glm::length(n - glm::dvec3(faced.corners[v].normal)) > 1e-4;
      if (facing[v] > 0.51) {
        ++means;
        EXPECT_LT(glm::length(n - unit(sum[v])), 1e-5) << v;
      }
      if (facing[v] < 0.49) {
        ++others;
        EXPECT_EQ(mean.corners[v].normal, faced.corners[v].normal) << v;
      }
    }
    EXPECT_GT(means, 20);
    EXPECT_GT(differ, 20) << "control: the two kinds are not the same";
    EXPECT_EQ(others > 20, sharp);
  }
}

double distanceTo(const BaseMesh& base, const glm::dvec3& p) {
  double nearest = 1e300;
  for (const BaseCorner& c : base.corners) nearest = std::min(nearest, glm::length(glm::dvec3(c.position_mm) - p));
  return nearest;
}

TEST(SimplifiedFaces, KeepSharpEdgesWithFewPatches) {
  const TriMesh mesh = boxMesh(40, 30, 20, 10);
  auto domain = BaseDomain::create(mesh);
  ASSERT_TRUE(domain.ok());
  ASSERT_FALSE((*domain)->faces(100).ok());
  auto base = (*domain)->simplifiedFaces({}, 100);
  ASSERT_TRUE(base.ok()) << base.error().text();
  EXPECT_EQ(baseMeshProblem(*base), "");
  EXPECT_LE(base->patches.size(), 100u);
  EXPECT_EQ(coverOf(*base, TriMesh{}).odd_sides, 0u);
  glm::vec3 low(1e9f), high(-1e9f);
  for (const glm::vec3& p : mesh.positions_mm) low = glm::min(low, p), high = glm::max(high, p);
  for (int k = 0; k < 8; ++k) {
    const glm::dvec3 corner(k & 1 ? low.x : high.x, k & 2 ? low.y : high.y, k & 4 ? low.z : high.z);
    EXPECT_LT(distanceTo(*base, corner), 1e-3) << "a corner of the box";
  }
  // On the box: as far outside of it as inside.
  for (uint32_t p = 0; p < base->patches.size(); ++p) {
    for (int k = 0; k < 25; ++k) {
      const glm::dvec3 at = base->point(p, k % 5 / 4.0, k / 5 / 4.0);
      const glm::dvec3 inside = glm::min(at - glm::dvec3(low), glm::dvec3(high) - at);
      EXPECT_NEAR(std::min({inside.x, inside.y, inside.z}), 0, 1e-3);
    }
  }
}

TEST(SimplifiedFaces, MorePatchesWhereTheyAreAskedFor) {
  const TriMesh mesh = ballMesh(60, 50);
  const glm::dvec3 pole(0, 0, 50);
  auto domain = BaseDomain::create(mesh);
  ASSERT_TRUE(domain.ok());
  auto cornersNear = [&](const BaseMesh& base) {
    return std::count_if(base.corners.begin(), base.corners.end(),
                         [&](const BaseCorner& c) { return glm::length(glm::dvec3(c.position_mm) - pole) < 15; });
  };
  auto even = (*domain)->simplifiedFaces({}, 400);
  ASSERT_TRUE(even.ok());
  const RefineRequest request{pole, 64};
  auto finer = (*domain)->simplifiedFaces(std::span(&request, 1), 400);
  ASSERT_TRUE(finer.ok());
  EXPECT_LE(finer->patches.size(), 400u);
  EXPECT_GT(cornersNear(*finer), cornersNear(*even));
}

}  // namespace base_faces_test
}  // namespace relievo
