// All lines of a square at once: what is answered is what brute force over all triangles finds; what cannot be known is
// not answered.
#include "geometry/bake/line_rasteriser.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "geometry/bake/mesh_bake.h"
#include "src/artwork/patch_domain.h"
#include "tests/geometry/mesh_shapes.h"
#include "tests/view_share.h"

namespace relievo {
namespace line_rasteriser_test {

using test::kSanitized;

glm::dvec3 bilinear(const std::array<glm::dvec3, 4>& c, double u, double v) {
  return (c[0] * (1 - u) + c[1] * u) * (1 - v) + (c[2] * (1 - u) + c[3] * u) * v;
}

// The least |t|, and of those that share it the first triangle; within `likely`, outside facing along. Of lines through
// an edge either triangle does.
SurfacePoint byBruteForce(const TriMesh& mesh, const Line& line) {
  SurfacePoint best;
  double least = line.likely;
  for (uint32_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& t = mesh.triangles[i];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]),
        n = glm::cross(b - a, c - a);
    const double steep = glm::dot(n, line.direction);
    if (!(steep > 0)) continue;
    auto side = [&](const glm::dvec3& p, const glm::dvec3& q) {
      return glm::dot(line.direction, glm::cross(p - line.at, q - line.at));
    };
    if (side(a, b) < 0 || side(b, c) < 0 || side(c, a) < 0) continue;
    const double along = glm::dot(n, a - line.at) / steep;
    if (!(std::abs(along) <= least) || (best && std::abs(along) == least)) continue;
    least = std::abs(along);
    best = {i, 0, 0, along};
  }
  return best;
}

struct Square {
  RasterSquare square;
  std::vector<RasterLine> raster_lines;
  std::vector<Line> lines;
  // n x n lines by rows, their points `start` above the square.
  Square(const RasterSquare& corners, size_t n, double likely, double start = 0) : square(corners) {
    for (size_t i = 0; i < n * n; ++i) {
      const double u = static_cast<double>(i % n) / static_cast<double>(n - 1),
                   v = static_cast<double>(i / n) / static_cast<double>(n - 1);
      const glm::dvec3 direction = bilinear(corners.normals, u, v);
      raster_lines.push_back({static_cast<float>(u), static_cast<float>(v), static_cast<float>(start)});
      lines.push_back({bilinear(corners.points, u, v) + start * direction, direction, 2 * likely, likely});
    }
  }
};
RasterSquare squareOf(const BaseMesh& base, uint32_t patch) {
  RasterSquare out;
  for (size_t k = 0; k < 4; ++k) {
    const BaseCorner& c = base.corners[base.patches[patch][k]];
    out.points[k] = c.position_mm;
    out.normals[k] = c.normal;
  }
  return out;
}

struct Counts {
  size_t answered = 0, wrong = 0, missing = 0;
};
// Answers against all triangles of `truth`.
Counts compare(const TriMesh& rasterised, const TriMesh& truth, const Square& s) {
  const LineRasteriser rasteriser(rasterised, 1);
  std::vector<SurfacePoint> hits(s.lines.size());
  rasteriser.nearest(s.square, s.raster_lines, s.lines, hits);
  Counts out;
  for (size_t i = 0; i < hits.size(); ++i) {
    const SurfacePoint expected = byBruteForce(truth, s.lines[i]);
    out.missing += expected && !hits[i];
    if (!hits[i]) continue;
    ++out.answered;
    if (!expected || std::abs(std::abs(hits[i].along) - std::abs(expected.along)) > 1e-9) {
      ++out.wrong;
      continue;
    }
    // What is said to be met lies on the line.
    const auto& t = rasterised.triangles[hits[i].triangle];
    const glm::dvec3 a(rasterised.positions_mm[t[0]]), b(rasterised.positions_mm[t[1]]),
        c(rasterised.positions_mm[t[2]]);
    const glm::dvec3 on = a + hits[i].b1 * (b - a) + hits[i].b2 * (c - a);
    EXPECT_LT(glm::length(on - s.lines[i].at - hits[i].along * s.lines[i].direction), 1e-5);
  }
  return out;
}

double bumps(const glm::dvec3& d) { return 10 + 0.3 * std::sin(9 * d.x + 4 * d.y) * std::cos(8 * d.z); }

// Both of two meshes.
TriMesh joined(TriMesh a, const TriMesh& b) {
  const auto first = static_cast<uint32_t>(a.positions_mm.size());
  a.positions_mm.insert(a.positions_mm.end(), b.positions_mm.begin(), b.positions_mm.end());
  for (const auto& t : b.triangles) a.triangles.push_back({first + t[0], first + t[1], first + t[2]});
  return a;
}

TEST(LineRasteriser, answersWhatBruteForceFinds) {
  const TriMesh mesh = starMesh(bumps, kSanitized ? 20 : 40);
  const BaseMesh base = sphereBase(9.8, 2);
  Counts all;
  size_t lines = 0;
  for (uint32_t p = 0; p < base.patches.size(); p += kSanitized ? 8 : 2) {
    for (double start : {0.0, 0.4}) {
      const Square s(squareOf(base, p), 17, 2, start);
      lines += s.lines.size();
      const Counts one = compare(mesh, mesh, s);
      all.answered += one.answered, all.wrong += one.wrong, all.missing += one.missing;
    }
  }
  EXPECT_EQ(all.answered, lines);
  EXPECT_EQ(all.wrong, 0u);
  EXPECT_EQ(all.missing, 0u);
}

TEST(LineRasteriser, ofSeveralSurfacesTheNearest) {
  // Shells 0.4 apart, all of which face outwards; lines' points lie below, between and above them.
  const int n = kSanitized ? 20 : 30;
  const TriMesh outer = starMesh(bumps, n),
                shells = joined(outer, starMesh([](const glm::dvec3&d) { return bumps(d) - 0.4; }, n + 3));
  const BaseMesh base = sphereBase(9.8, 4);
  for (double start : {-0.3, 0.1, 0.8}) {
    const Square s(squareOf(base, 5), 25, 1.2, start);
    const Counts both = compare(shells, shells, s);
    EXPECT_EQ(both.answered, s.lines.size());
    EXPECT_EQ(both.wrong, 0u);
    // Control: who sees one of the shells alone is wrong where the other one is nearer.
    if (start < 0) {
      EXPECT_GT(compare(outer, shells, s).wrong, s.lines.size() / 2);
    }
  }
  // A side that faces the other way is none, however near.
  TriMesh wall = starMesh([](const glm::dvec3& d) { return bumps(d) - 0.1; }, n);
  for (auto& t : wall.triangles) std::swap(t[1], t[2]);
  const Counts walled = compare(joined(outer, wall), outer, Square(squareOf(base, 5), 25, 2));
  EXPECT_EQ(walled.answered, 25u * 25);
  EXPECT_EQ(walled.wrong, 0u);
}

TEST(LineRasteriser, noLineSlipsBetweenTriangles) {
  // Every line goes through a vertex of the sheet or the middle of an edge.
  const TriMesh sheet =
      sheetMesh(8, 8, 16, 16, [](double x, double y) { return 0.25 * std::sin(x) * std::cos(2 * y); });
  const RasterSquare square{{glm::dvec3(0, 0, 0.5), {8, 0, 0.5}, {0, -8, 0.5}, {8, -8, 0.5}},
                            {glm::dvec3(0, 0, 1), {0, 0, 1}, {0, 0, 1}, {0, 0, 1}}};
  const Counts all = compare(sheet, sheet, Square(square, 33, 2));
  EXPECT_EQ(all.answered, 33u * 33);
  EXPECT_EQ(all.wrong, 0u);
  // Control: without one of its quads a line falls through.
  TriMesh torn = sheet;
  torn.triangles.erase(torn.triangles.begin() + 254, torn.triangles.begin() + 256);
  EXPECT_LT(compare(torn, torn, Square(square, 33, 2)).answered, 33u * 33);
  EXPECT_EQ(compare(torn, torn, Square(square, 33, 2)).missing, 0u);
}

TEST(LineRasteriser, triangleSoupIsNeverAnsweredWrongly) {
  // Triangles of any size and direction, subset larger than the square.
  std::mt19937 random(31);
  std::normal_distribution<double> gauss;
  auto near = [&](double size) { return glm::vec3(size * gauss(random), size * gauss(random), size * gauss(random)); };
  size_t answered = 0, missing = 0;
  for (int round = 0; round < (kSanitized ? 6 : 40); ++round) {
    TriMesh soup;
    for (uint32_t i = 0; i < 600; ++i) {
      const glm::vec3 at = near(2);
      const double size = i < 4 ? 5 : 0.2;
      for (int k = 0; k < 3; ++k) soup.positions_mm.push_back(at + near(size));
      soup.triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    RasterSquare square;
    for (size_t k = 0; k < 4; ++k) {
      square.points[k] = glm::dvec3(k % 2 ? 1.5 : -1.5, k / 2 ? -1.5 : 1.5, 0) + 0.2 * glm::dvec3(near(1));
      square.normals[k] = glm::normalize(glm::dvec3(0, 0, 1) + 0.02 * round * glm::dvec3(near(1)));
    }
    const Counts one = compare(soup, soup, Square(square, 25, 2));
    EXPECT_EQ(one.wrong, 0u) << round;
    answered += one.answered, missing += one.missing;
  }
  printf("%zu answered, %zu not known\n", answered, missing);
  EXPECT_GT(answered, missing);
}

TEST(LineRasteriser, whereLinesMeetOneAnotherNothingWrongIsSaid) {
  // Lines that meet in one point, 2 above the square, which is as far as they are looked along.
  RasterSquare square;
  for (size_t k = 0; k < 4; ++k) {
    square.points[k] = {k % 2 ? 5 : 3, k / 2 ? -5 : -3, 0};
    square.normals[k] = glm::dvec3(4, -4, 2) - square.points[k];
  }
  auto sheet = [](double z) { return sheetMesh(8, 8, 40, 40, [=](double x, double) { return z + 0.02 * x; }); };
  const Square s(square, 21, 1);
  // What lies well previous that point is found all the same; what lies there is left open.
  const TriMesh both = joined(sheet(1.8), sheet(0.2));
  const Counts near = compare(both, both, s), far = compare(sheet(1.8), sheet(1.8), s);
  EXPECT_EQ(near.answered, s.lines.size());
  EXPECT_EQ(near.wrong, 0u);
  EXPECT_EQ(far.answered, 0u);
  EXPECT_EQ(far.missing, s.lines.size());
}

class LineRasteriserOver : public ::testing::TestWithParam<bool> {};  // BaseMesh::cut
INSTANTIATE_TEST_SUITE_P(Patches, LineRasteriserOver, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "Cut" : "Bilinear"; });

TEST_P(LineRasteriserOver, bakesTheSameAsRays) {
  const TriMesh mesh = starMesh(bumps, kSanitized ? 24 : 90);
  BaseMesh base = sphereBase(9.8, 2);
  base.cut = GetParam();
  std::vector<uint16_t> heights[2];
  std::vector<uint8_t> texels[2];
  double scale_mm[2];
  for (size_t k = 0; k < 2; ++k) {
    auto scene = makeBakeScene(mesh, {.rasterise_from_triangles = k ? 0 : ~size_t{0},
                                      .rasterise_from_per_patch = 0,
                                      .workers = static_cast<int>(k + 1)});
    ASSERT_TRUE(scene);
    EXPECT_EQ(scene->rasteriser != nullptr, k == 1);
    const RayScene& rays = *scene->rays;
    auto made = MeshBake::create(mesh, {}, base,
                                 {.cells_log2 = kSanitized ? 4 : 6, .fit = false, .texture_depth = 0, .workers = 2},
                                 std::move(*scene));
    ASSERT_TRUE(made);
    scale_mm[k] = (*made)->reliefScaleMm();
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      std::vector<uint16_t> here(129 * 129);
      ASSERT_TRUE((*made)->heights(p, here));
      heights[k].insert(heights[k].end(), here.begin(), here.end());
      if (kSanitized && p % 8) continue;
      std::vector<uint8_t> out(6 * 128 * 128);
      ASSERT_TRUE((*made)->texels(p, out));
      texels[k].insert(texels[k].end(), out.begin(), out.end());
    }
    // The rasteriser leaves no line to rays here: no hierarchy is ever built.
    EXPECT_EQ(rays.builds(), k ? 0u : rays.regions());
  }
  EXPECT_NEAR(scale_mm[0], scale_mm[1], 1e-9);
  int worst_height = 0, worst_texel = 0;
  for (size_t i = 0; i < heights[0].size(); ++i)
    worst_height = std::max(worst_height, std::abs(heights[0][i] - heights[1][i]));
  for (size_t i = 0; i < texels[0].size(); ++i)
    worst_texel = std::max(worst_texel, std::abs(texels[0][i] - texels[1][i]));
  EXPECT_LE(worst_height, 1);
  EXPECT_LE(worst_texel, 1);
}

// Rays are faster where patches have few triangles: a large scan is rasterised over a base of few patches only.
TEST(LineRasteriser, rayedWherePatchesHaveFewTriangles) {
  const TriMesh mesh = starMesh(bumps, 24);
  BaseMesh base = sphereBase(9.8, 2);
  const size_t a_patch = mesh.triangles.size() / base.patches.size();
  ASSERT_GE(a_patch, 32u);
  // A base that is cut needs sixteen times as many.
  for (const auto& [cut, enough] : {std::pair{false, a_patch}, {true, a_patch / 16}}) {
    for (const size_t more : {0, 1}) {
      base.cut = cut;
      auto scene =
          makeBakeScene(mesh, {.rasterise_from_triangles = 0, .rasterise_from_per_patch = enough + more, .workers = 1});
      ASSERT_TRUE(scene);
      const RayScene& rays = *scene->rays;
      auto made = MeshBake::create(mesh, {}, base, {.cells_log2 = 3, .fit = false, .workers = 1}, std::move(*scene));
      ASSERT_TRUE(made);
      EXPECT_EQ(rays.builds(), more ? rays.regions() : 0u);
    }
  }
}

}  // namespace line_rasteriser_test
}  // namespace relievo
