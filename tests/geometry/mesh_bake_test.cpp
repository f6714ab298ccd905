// Baking: heights, colours and errors against analytic surfaces; shared samples; certified errors against brute force.
#include "geometry/mesh_bake.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "src/base/planar_domain.h"
#include "tests/geometry/mesh_shapes.h"

namespace relievo {
namespace {

using Heights = std::vector<uint16_t>;

std::unique_ptr<MeshBake> bake(const TriMesh& mesh, const BaseMesh& base, BakeOptions options, const MeshBake::Image& image = {}) {
  auto made = MeshBake::create(mesh, image, base, options);
  EXPECT_TRUE(made) << made.error().text();
  return made ? std::move(*made) : nullptr;
}
size_t side(const MeshBake& baked) { return (size_t{kPagePx} << baked.reliefDepth()) + 1; }
Heights heightsOf(const MeshBake& baked, uint32_t patch) {
  Heights out(side(baked) * side(baked));
  EXPECT_TRUE(baked.heights(patch, out));
  return out;
}

// Where the line meets the mesh nearest to its point, outside facing along it.
double heightByBruteForce(const TriMesh& mesh, const glm::dvec3& at, const glm::dvec3& direction) {
  double best = std::numeric_limits<double>::infinity();
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    const glm::dvec3 n = glm::cross(b - a, c - a);
    const double steep = glm::dot(n, direction);
    if (steep <= 0) continue;
    const double along = glm::dot(n, a - at) / steep;
    const glm::dvec3 p = at + along * direction;
    const double slack = -1e-9 * glm::dot(n, n);
    const bool inside = glm::dot(glm::cross(b - a, p - a), n) >= slack && glm::dot(glm::cross(c - b, p - b), n) >= slack && glm::dot(glm::cross(a - c, p - c), n) >= slack;
    if (inside && std::abs(along) < std::abs(best)) best = along;
  }
  return best;
}

TEST(MeshBake, heightsOverASphereAreItsOwn) {
  // Scan: 96 x 96 quads a face, inscribed: at most r (1 - cos) below the sphere. Base: 4 x 4 patches a face, whose normals are bilinear.
  const double radius = 50;
  const TriMesh mesh = sphereMesh(radius, 96);
  const BaseMesh base = sphereBase(radius * 0.98, 4);
  auto baked = bake(mesh, base, {.cells_log2 = 5});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->reliefDepth(), 0);
  EXPECT_EQ(baked->report().by_closest_point, 0u);
  EXPECT_EQ(baked->report().samples, 96u * 32 * 32 + 2);
  const double sag = radius * (1 - std::cos(std::sqrt(2.0) / 96));  // half a quad's diagonal at a face's centre
  std::mt19937 random(11);
  double worst = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const Heights q = heightsOf(*baked, p);
    for (size_t y = 0; y <= 128; y += 4) {  // the samples; what lies between them is interpolated
      for (size_t x = 0; x <= 128; x += 4) {
        const double h = baked->reliefOffsetMm() + baked->reliefScaleMm() * q[y * 129 + x];
        const glm::dvec3 at = base.point(p, x / 128.0, y / 128.0), normal = base.normal(p, x / 128.0, y / 128.0);
        worst = std::max(worst, std::abs(glm::length(at + h * normal) - radius + sag / 2));
        if (random() % 1000) continue;
        // Every triangle's plane, in double precision: half a step, and what a float of the height leaves.
        const double exact = heightByBruteForce(mesh, at, normal);
        EXPECT_NEAR(h, exact, 0.501 * baked->reliefScaleMm() + 1e-7 * std::abs(exact));
      }
    }
  }
  EXPECT_LT(worst, sag / 2 + baked->reliefScaleMm());
}

TEST(MeshBake, sharedSamplesAreTheSameFromAllPatches) {
  std::mt19937 random(3);
  const TriMesh mesh = starMesh([](const glm::dvec3& d) { return 10 + std::sin(7 * d.x) * std::cos(5 * d.y + 3 * d.z); }, 40);
  BaseMesh base = sphereBase(10, 3);
  // Patches turned at random: neighbours' sides then run in all ways.
  for (auto& p : base.patches) {
    for (unsigned turns = random() % 4; turns > 0; --turns) p = {p[1], p[3], p[0], p[2]};
  }
  const auto neighbours = patchNeighbours(base);
  for (int cells_log2 : {1, 4, 7, 8}) {
    auto baked = bake(mesh, base, {.cells_log2 = cells_log2});
    ASSERT_TRUE(baked);
    const size_t row = side(*baked), n = row - 1;
    std::vector<Heights> all;
    for (uint32_t p = 0; p < base.patches.size(); ++p) all.push_back(heightsOf(*baked, p));
    auto onSide = [&](uint32_t p, Side s, size_t i) {
      const size_t x = s == kLeft ? 0 : s == kRight ? n : i, y = s == kTop ? 0 : s == kBottom ? n : i;
      return all[p][y * row + x];
    };
    size_t compared = 0, reversed = 0;
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      for (int s = 0; s < 4; ++s) {
        const PatchNeighbour& other = neighbours[p][static_cast<size_t>(s)];
        ASSERT_NE(other.patch, PatchNeighbour::kNone);
        reversed += other.reversed;
        for (size_t i = 0; i <= n; ++i, ++compared)
          ASSERT_EQ(onSide(p, static_cast<Side>(s), i), onSide(other.patch, other.side, other.reversed ? n - i : i)) << cells_log2 << " " << p << " " << s << " " << i;
      }
    }
    EXPECT_GT(reversed, 0u);
    EXPECT_EQ(compared, base.patches.size() * 4 * row);
  }
}

TEST(MeshBake, errorsBoundTheDistanceOfCoarserGrids) {
  const TriMesh mesh = starMesh([](const glm::dvec3& d) { return 10 + 0.4 * std::sin(17 * d.x) * std::cos(15 * d.y + 3 * d.z); }, 60);
  const BaseMesh base = sphereBase(10, 1);
  auto baked = bake(mesh, base, {.cells_log2 = 8});
  ASSERT_TRUE(baked);
  const size_t row = side(*baked), n = row - 1;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(0, 1);
  double tightest = 0;
  size_t halves_fail = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const Heights q = heightsOf(*baked, p);
    // The surface of a grid of `cells` cells a side at (u, v), in double precision.
    auto surface = [&](size_t cells, double u, double v) {
      const double x = u * static_cast<double>(cells), y = v * static_cast<double>(cells);
      const size_t x0 = std::min(static_cast<size_t>(x), cells - 1), y0 = std::min(static_cast<size_t>(y), cells - 1), step = n / cells;
      auto vertex = [&](size_t i, size_t j) {
        const double cu = static_cast<double>(i) / static_cast<double>(cells), cv = static_cast<double>(j) / static_cast<double>(cells);
        return base.point(p, cu, cv) + (baked->reliefOffsetMm() + baked->reliefScaleMm() * q[j * step * row + i * step]) * base.normal(p, cu, cv);
      };
      const double fx = x - static_cast<double>(x0), fy = y - static_cast<double>(y0);
      const glm::dvec3 a = vertex(x0, y0), b = vertex(x0 + 1, y0), c = vertex(x0, y0 + 1), d = vertex(x0 + 1, y0 + 1);
      return fx >= fy ? a + fx * (b - a) + fy * (d - b) : a + fy * (c - a) + fx * (d - c);
    };
    std::vector<float> finer;
    for (int log2 = 8; log2 >= 0; --log2) {
      const auto blocks = static_cast<size_t>(MeshBake::errorBlocks(log2));
      std::vector<float> errors(blocks * blocks);
      ASSERT_TRUE(baked->errorsOfCells(p, log2, errors));
      if (log2 == 8) {
        EXPECT_EQ(*std::max_element(errors.begin(), errors.end()), 0.0f);
      }
      EXPECT_EQ(baked->errorOfCells(p, log2), *std::max_element(errors.begin(), errors.end()));
      std::vector<double> measured(errors.size(), 0);
      for (int i = 0; i < 20000; ++i) {
        const double u = unit(random), v = unit(random);
        const size_t block = std::min(static_cast<size_t>(v * static_cast<double>(blocks)), blocks - 1) * blocks + std::min(static_cast<size_t>(u * static_cast<double>(blocks)), blocks - 1);
        measured[block] = std::max(measured[block], glm::length(surface(n, u, v) - surface(size_t{1} << log2, u, v)));
      }
      for (size_t i = 0; i < errors.size(); ++i) {
        ASSERT_LE(measured[i], errors[i] + 1e-12) << p << " " << log2 << " " << i;
        halves_fail += measured[i] > errors[i] / 2;
        if (errors[i] > 0 && blocks == 1) tightest = std::max(tightest, measured[i] / errors[i]);
      }
      // Monotone: no block below those of the finer level inside it.
      const auto fine = static_cast<size_t>(MeshBake::errorBlocks(log2 + 1));
      for (size_t i = 0; i < finer.size(); ++i) {
        const size_t x = i % fine * blocks / fine, y = i / fine * blocks / fine;
        EXPECT_GE(errors[y * blocks + x], finer[i]);
      }
      finer = errors;
    }
    std::vector<float> level(16 * 16), cells(16 * 16);
    ASSERT_TRUE(baked->errors(p, 0, level));
    ASSERT_TRUE(baked->errorsOfCells(p, 7, cells));
    EXPECT_EQ(level, cells);
    EXPECT_LE(*std::max_element(level.begin(), level.end()), 65535 * baked->errorUnitMm());
  }
  EXPECT_GT(tightest, 0.9);
  EXPECT_GT(halves_fail, 0u);  // control: half the errors would not be bounds
}

TEST(MeshBake, aFlatSheetHasNoRange) {
  const TriMesh mesh = sheetMesh(20, 10, 8, 4, [](double, double) { return 0.0; });
  const BaseMesh base = sheetBase(20, 10, 2, 1);
  auto baked = bake(mesh, base, {.cells_log2 = 4});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->reliefScaleMm(), 0.0);
  EXPECT_EQ(baked->reliefOffsetMm(), 0.0);
  EXPECT_GT(baked->errorUnitMm(), 0.0);
  for (uint32_t p = 0; p < 2; ++p) {
    for (uint16_t q : heightsOf(*baked, p)) ASSERT_EQ(q, 0);
    for (int log2 = 0; log2 <= 7; ++log2) EXPECT_LT(baked->errorOfCells(p, log2), 1e-12f);
  }
}

}  // namespace
}  // namespace relievo
