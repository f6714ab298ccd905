// Baking: heights, colours and errors against analytic surfaces; shared samples; certified errors against brute force.
#include "geometry/bake/mesh_bake.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <random>

#include "geometry/bake/bake_trace.h"
#include "geometry/bake/fidelity.h"
#include "geometry/bake/vertex_normals.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/base_faces.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/relief_lattice.h"
#include "src/base/parallel_for.h"
#include "tests/geometry/mesh_shapes.h"
#include "tests/view_share.h"

namespace relievo {
namespace mesh_bake_test {

using test::kSanitized;
using Heights = std::vector<uint16_t>;

std::unique_ptr<MeshBake> bake(const TriMesh& mesh, const BaseMesh& base, BakeOptions options,
                               const std::vector<MeshBake::Image>& images = {}) {
  auto made = MeshBake::create(mesh, images, base, options);
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
    const bool inside = glm::dot(glm::cross(b - a, p - a), n) >= slack &&
                        glm::dot(glm::cross(c - b, p - b), n) >= slack &&
                        glm::dot(glm::cross(a - c, p - c), n) >= slack;
    if (inside && std::abs(along) < std::abs(best)) best = along;
  }
  return best;
}

TEST(MeshBake, heightsOverASphereAreItsOwn) {
  // Scan: 96 x 96 quads a face, inscribed: at most r (1 - cos) below the sphere. Base: 4 x 4 patches a face, whose
  // normals are bilinear.
  const double radius = 50;
  const TriMesh mesh = sphereMesh(radius, 96);
  const BaseMesh base = sphereBase(radius * 0.98, 4);
  auto baked = bake(mesh, base, {.cells_log2 = 5, .fit = false});
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
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + std::sin(7 * d.x) * std::cos(5 * d.y + 3 * d.z); }, 40);
  BaseMesh base = sphereBase(10, 3);
  // Patches turned at random: neighbours' sides then run in all ways.
  for (auto& p : base.patches) {
    for (unsigned turns = random() % 4; turns > 0; --turns) p = {p[1], p[3], p[0], p[2]};
  }
  const auto neighbours = patchNeighbours(base);
  for (int cells_log2 : {1, 4, 7, 8}) {
    if (kSanitized && cells_log2 == 8) continue;
    auto baked = bake(mesh, base, {.cells_log2 = cells_log2});
    ASSERT_TRUE(baked);
    if (cells_log2 % 4 == 0) {
      EXPECT_TRUE(baked->setStep(300 * baked->reliefScaleMm()));
    }
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
          ASSERT_EQ(onSide(p, static_cast<Side>(s), i), onSide(other.patch, other.side, other.reversed ? n - i : i))
              << cells_log2 << " " << p << " " << s << " " << i;
      }
    }
    EXPECT_GT(reversed, 0u);
    EXPECT_EQ(compared, base.patches.size() * 4 * row);
    // Control: with a range of its own for each patch, shared samples differ.
    for (Heights& q : all) {
      const auto [low, high] = std::minmax_element(q.begin(), q.end());
      const double first = *low, scale = 65535.0 / (*high - first);
      for (uint16_t& v : q) v = static_cast<uint16_t>(std::lround((v - first) * scale));
    }
    size_t different = 0;
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      for (int side_of = 0; side_of < 4; ++side_of) {
        const PatchNeighbour& other = neighbours[p][static_cast<size_t>(side_of)];
        for (size_t i = 0; i <= n; ++i)
          different +=
              onSide(p, static_cast<Side>(side_of), i) != onSide(other.patch, other.side, other.reversed ? n - i : i);
      }
    }
    EXPECT_GT(different, compared / 2);
  }
}

// What differs by more than whole steps from the lattice's rule, and what differs at all.
struct Beside {
  size_t odd = 0, any = 0, all = 0;
};
Beside besideCoarser(const Heights& q, int n, int cells_log2, int finest) {
  Beside out;
  for (int h = n / 2; h > 0; h /= 2) {
    // In 16ths, from the finest samples to coarser ones; between the finest there is nothing.
    constexpr int kParts[] = {16, 12, 12, 8, 8, 6, 6, 4};
    const int apart = h * (1 << cells_log2) / n;
    const int step = finest < 64 || apart == 0 ? finest : finest / 16 * kParts[std::bit_width(unsigned(apart)) - 1];
    for (int y = 0; y <= n; y += h) {
      for (int x = 0; x <= n; x += h) {
        const int at = y * (n + 1) + x, off = (y & h) * (n + 1) + (x & h);
        if (off == 0) continue;
        const int line = midHeight(q[static_cast<size_t>(at - off)], q[static_cast<size_t>(at + off)]);
        const int beside = q[static_cast<size_t>(at)] - line;
        out.odd += beside % step != 0, out.any += beside != 0, ++out.all;
      }
    }
  }
  return out;
}

TEST(MeshBake, steppedHeightsLieWithinHalfAStepOfWhatWasBaked) {
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.4 * std::sin(17 * d.x) * std::cos(15 * d.y + 3 * d.z); }, 60);
  const BaseMesh base = sphereBase(10, 1);
  for (const int cells_log2 : {5, 8}) {
    auto baked = bake(mesh, base, {.cells_log2 = cells_log2, .workers = 1});
    auto other = bake(mesh, base, {.cells_log2 = cells_log2, .workers = 2});
    ASSERT_TRUE(baked && other);
    const int n = static_cast<int>(side(*baked)) - 1, apart = std::max(1, n >> cells_log2);
    std::vector<Heights> exact;
    for (uint32_t p = 0; p < base.patches.size(); ++p) exact.push_back(heightsOf(*baked, p));
    size_t before = base.patches.size() * exact[0].size(), off = 0;
    for (const int step : {20, 150, 1000}) {
      ASSERT_TRUE(baked->setStep((step + 0.5) * baked->reliefScaleMm()));
      ASSERT_TRUE(other->setStep((step + 0.5) * other->reliefScaleMm()));
      Beside found;
      for (uint32_t p = 0; p < base.patches.size(); ++p) {
        const Heights q = heightsOf(*baked, p);
        ASSERT_EQ(q, heightsOf(*other, p)) << "whatever the workers";
        const Beside of_patch = besideCoarser(q, n, cells_log2, step),
                     of_exact = besideCoarser(exact[p], n, cells_log2, step);
        EXPECT_EQ(of_patch.odd, 0u);
        EXPECT_GT(of_exact.odd, of_exact.all / 40) << "control: heights as they were baked";
        found.any += of_patch.any;
        for (int y = 0; y <= n; y += apart)
          for (int x = 0; x <= n; x += apart) {
            const size_t i = static_cast<size_t>(y * (n + 1) + x);
            const bool at_end = 2 * std::min(+exact[p][i], 65535 - exact[p][i]) < step;
            ASSERT_LE(2 * std::abs(q[i] - exact[p][i]), at_end ? 2 * step : step) << p << " " << x << " " << y;
            off += q[i] != exact[p][i];
          }
      }
      EXPECT_LT(found.any, before) << "larger steps leave fewer samples";
      before = found.any;
    }
    EXPECT_GT(off, 0u);
    ASSERT_TRUE(baked->setStep(0));
    for (uint32_t p = 0; p < base.patches.size(); ++p) EXPECT_EQ(heightsOf(*baked, p), exact[p]) << "nothing is lost";
  }
}

// Lines that are intersected together find what each finds alone, though one tells the next how far the scan is.
TEST(BakeContext, LinesTogetherMeetWhatTheyMeetEachAlone) {
  // Two waves, the lower one half as long: lines beside its border meet the upper one, and those close by touch it.
  TriMesh mesh;
  constexpr uint32_t kSide = 60, kHalf = 30;
  for (int sheet = 0; sheet < 2; ++sheet) {
    const auto first = static_cast<uint32_t>(mesh.positions_mm.size());
    for (uint32_t y = 0; y <= kSide; ++y)
      for (uint32_t x = 0; x <= kSide; ++x)
        mesh.positions_mm.push_back(glm::vec3(x, y, 6.0 * sheet + std::sin(0.3 * x) * std::cos(0.2 * y)));
    for (uint32_t y = 0; y < kSide; ++y)
      for (uint32_t x = 0; x < (sheet ? kSide : kHalf); ++x) {
        const uint32_t a = first + y * (kSide + 1) + x, b = a + kSide + 1;
        mesh.triangles.push_back({a, a + 1, b + 1});
        mesh.triangles.push_back({a, b + 1, b});
      }
  }
  auto scene = makeBakeScene(mesh, {});
  ASSERT_TRUE(scene.ok());
  const BaseMesh base = sphereBase(10, 1);
  BakeContext context(mesh, base);
  context.scene = scene->rays;
  context.normals = scene->normals;
  context.touching = Touching::kFacing;
  LineBatch together;
  for (uint32_t i = 0; i < 4000; ++i) {
    // A fiftieth of a cell apart, on no edge; from far beside the border to it.
    const double x = kHalf - 1.9863 + 0.0201 * (399 - i % 400), y = 5.0291 + 4.3017 * (i / 400);
    const double lower = std::sin(0.3 * x) * std::cos(0.2 * y);
    together.add({{x, y, lower + 0.1 * std::sin(0.05 * i)}, {0, 0, 1}, 12}, 0, 0, 0);
  }
  const std::vector<Line> lines = together.lines;
  context.intersect(together);
  ASSERT_EQ(together.hits.size(), lines.size());
  size_t touched = 0, far = 0;
  for (size_t i = 0; i < lines.size(); ++i) {
    LineBatch alone;
    alone.add(lines[i], 0, 0, 0);
    context.intersect(alone);
    ASSERT_EQ(together.hits[i].triangle, alone.hits[0].triangle) << i;
    ASSERT_EQ(together.hits[i].along, alone.hits[0].along) << i;
    (std::abs(alone.hits[0].along) < 1 ? touched : far) += 1;
  }
  EXPECT_GT(touched, lines.size() / 20);
  EXPECT_GT(far, 0u);
}

// By how much steps move heights: of the finest heights themselves, each as heavy as its part of the patch's area.
TEST(MeshBake, stepsMoveHeightsByWhatIsSaid) {
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.4 * std::sin(17 * d.x) * std::cos(15 * d.y + 3 * d.z); }, 60);
  BaseMesh base = sphereBase(10, 2);
  base.corners[base.patches[0][0]].position_mm *= 0.8f;  // patches of different areas
  for (const int cells_log2 : {5, 7}) {
    auto baked = bake(mesh, base, {.cells_log2 = cells_log2});
    ASSERT_TRUE(baked);
    std::vector<Heights> exact;
    for (uint32_t p = 0; p < base.patches.size(); ++p) exact.push_back(heightsOf(*baked, p));
    EXPECT_EQ(baked->stepChangeMm(), 0) << "none yet";
    double before = 0;
    for (const int step : {300, 3000}) {
      ASSERT_TRUE(baked->setStep((step + 0.5) * baked->reliefScaleMm()));
      double sum = 0, area = 0;
      for (uint32_t p = 0; p < base.patches.size(); ++p) {
        const Heights q = heightsOf(*baked, p);
        std::array<glm::dvec3, 4> c;
        for (size_t k = 0; k < 4; ++k) c[k] = glm::dvec3(base.corners[base.patches[p][k]].position_mm);
        const double of_patch = glm::length(glm::cross(c[1] - c[0], c[2] - c[0])) / 2 +
                                glm::length(glm::cross(c[1] - c[3], c[2] - c[3])) / 2;
        double squares = 0;
        for (size_t i = 0; i < q.size(); ++i) squares += std::pow(int{q[i]} - int{exact[p][i]}, 2);
        sum += of_patch * squares / static_cast<double>(q.size());
        area += of_patch;
      }
      const double rms = baked->reliefScaleMm() * std::sqrt(sum / area);
      // At 128 cells heights are the samples: between them what is linear is less, by up to a third of the noise.
      const double least = cells_log2 == 7 ? std::sqrt(0.3) * rms : 0.9 * rms, most = 1.1 * rms;
      EXPECT_GE(baked->stepChangeMm(), least);
      EXPECT_LE(baked->stepChangeMm(), most);
      EXPECT_GT(baked->stepChangeMm(), 3 * before) << "more with larger steps";
      before = baked->stepChangeMm();
    }
  }
}

TEST(MeshBake, errorsFoundLaterAreTheSame) {
  const TriMesh mesh = starMesh([](const glm::dvec3& d) { return 10 + 0.4 * std::sin(17 * d.x); }, 30);
  const BaseMesh base = sphereBase(10, 1);
  auto always = bake(mesh, base, {.cells_log2 = 7}), later = bake(mesh, base, {.cells_log2 = 7, .errors = false});
  ASSERT_TRUE(always && later);
  const std::vector<float> exact = always->errorsOfGrid(0, 4).mm;
  const double step_mm = 40 * always->reliefScaleMm();
  ASSERT_TRUE(always->setStep(step_mm) && later->setStep(step_mm) && later->findErrors());
  EXPECT_EQ(later->errorUnitMm(), always->errorUnitMm());
  for (uint32_t p = 0; p < base.patches.size(); ++p)
    for (int log2 = 0; log2 <= 7; ++log2)
      EXPECT_EQ(later->errorsOfGrid(p, log2).mm, always->errorsOfGrid(p, log2).mm) << p << " " << log2;
  EXPECT_NE(always->errorsOfGrid(0, 4).mm, exact) << "the control: steps change errors";
  EXPECT_FALSE(later->isEven());
}

class MeshBakeOver : public ::testing::TestWithParam<bool> {};  // BaseMesh::cut
INSTANTIATE_TEST_SUITE_P(Patches, MeshBakeOver, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "Cut" : "Bilinear"; });

TEST_P(MeshBakeOver, errorsBoundTheDistanceOfCoarserGrids) {
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.4 * std::sin(17 * d.x) * std::cos(15 * d.y + 3 * d.z); }, 60);
  BaseMesh base = sphereBase(10, 1);
  base.cut = GetParam();
  // Cut and bilinear normals differ only where those of opposite corners have different sums.
  for (size_t k = 0; base.cut && k < base.corners.size(); k += 3)
    base.corners[k].normal = glm::normalize(base.corners[k].normal + glm::vec3(0.3f, -0.2f, 0.3f));
  auto baked = bake(mesh, base, {.cells_log2 = 8});
  ASSERT_TRUE(baked);
  ASSERT_TRUE(baked->setStep(40 * baked->reliefScaleMm()));  // of what is written, not of what was baked
  const size_t row = side(*baked), n = row - 1;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(0, 1);
  constexpr int kLooks = kSanitized ? 5000 : 20000;
  double tightest = 0;
  size_t halves_fail = 0, one_sided = 0, within_cells = 0, alike = 0;
  std::array<size_t, 5> half_shapes_fail{};
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const Heights q = heightsOf(*baked, p);
    // The surface of a grid of `cells` cells a side at (u, v), in double precision.
    auto surface = [&](size_t cells, double u, double v) {
      const double x = u * static_cast<double>(cells), y = v * static_cast<double>(cells);
      const size_t x0 = std::min(static_cast<size_t>(x), cells - 1), y0 = std::min(static_cast<size_t>(y), cells - 1),
                   step = n / cells;
      auto vertex = [&](size_t i, size_t j) {
        const double cu = static_cast<double>(i) / static_cast<double>(cells),
                     cv = static_cast<double>(j) / static_cast<double>(cells);
        return base.point(p, cu, cv) +
               (baked->reliefOffsetMm() + baked->reliefScaleMm() * q[j * step * row + i * step]) *
                   base.normal(p, cu, cv);
      };
      const double fx = x - static_cast<double>(x0), fy = y - static_cast<double>(y0);
      const glm::dvec3 a = vertex(x0, y0), b = vertex(x0 + 1, y0), c = vertex(x0, y0 + 1), d = vertex(x0 + 1, y0 + 1);
      return fx >= fy ? a + fx * (b - a) + fy * (d - b) : a + fy * (c - a) + fx * (d - c);
    };
    std::vector<float> finer;
    for (int log2 = 8; log2 >= 0; --log2) {
      const auto blocks = static_cast<size_t>(MeshBake::errorBlocks(log2));
      const std::vector<float> errors = baked->errorsOfGrid(p, log2).mm;
      const std::vector<DeviationShape> shapes = baked->errorsOfGrid(p, log2).shapes;
      if (log2 == 8) {
        EXPECT_EQ(*std::max_element(errors.begin(), errors.end()), 0.0f);
      }
      EXPECT_EQ(baked->errorOfGrid(p, log2), *std::max_element(errors.begin(), errors.end()));
      std::vector<double> measured(errors.size(), 0);
      for (int i = 0; i < kLooks; ++i) {
        const double u = unit(random), v = unit(random);
        const size_t block = std::min(static_cast<size_t>(v * static_cast<double>(blocks)), blocks - 1) * blocks +
                             std::min(static_cast<size_t>(u * static_cast<double>(blocks)), blocks - 1);
        measured[block] = std::max(measured[block], glm::length(surface(n, u, v) - surface(size_t{1} << log2, u, v)));
      }
      for (size_t i = 0; i < errors.size(); ++i) {
        ASSERT_LE(measured[i], errors[i] + 1e-12) << p << " " << log2 << " " << i;
        halves_fail += measured[i] > errors[i] / 2;
        if (errors[i] > 0 && blocks == 1) tightest = std::max(tightest, measured[i] / errors[i]);
      }
      // The shapes, at the finest vertices: none of them is too small, and half of any would be.
      std::vector<Deviation> seen(errors.size());
      for (int i = 0; i < kLooks; ++i) {
        const double u = std::round(unit(random) * static_cast<double>(n)) / static_cast<double>(n),
                     v = std::round(unit(random) * static_cast<double>(n)) / static_cast<double>(n);
        const size_t block = std::min(static_cast<size_t>(v * static_cast<double>(blocks)), blocks - 1) * blocks +
                             std::min(static_cast<size_t>(u * static_cast<double>(blocks)), blocks - 1);
        const glm::dvec3 d = surface(n, u, v) - surface(size_t{1} << log2, u, v),
                         normal = glm::normalize(base.normal(p, u, v));
        const double along = glm::dot(d, normal);
        seen[block] = joined(seen[block], {glm::length(d), -along, along, glm::length(d - along * normal)});
      }
      for (size_t i = 0; i < errors.size(); ++i) {
        const Deviation known = deviationOf(errors[i], shapes[i]);
        ASSERT_LE(seen[i].below_mm, known.below_mm + 1e-12) << p << " " << log2 << " " << i;
        ASSERT_LE(seen[i].above_mm, known.above_mm + 1e-12) << p << " " << log2 << " " << i;
        ASSERT_LE(seen[i].aside_mm, known.aside_mm + 1e-12) << p << " " << log2 << " " << i;
        half_shapes_fail[0] += seen[i].below_mm > known.below_mm / 2,
            half_shapes_fail[1] += seen[i].above_mm > known.above_mm / 2;
        half_shapes_fail[2] += seen[i].aside_mm > known.aside_mm / 2;
        within_cells += known.between_mm < 0.9 * (known.below_mm + known.above_mm);
        one_sided += known.below_mm + known.above_mm < 1.2 * known.mm;
      }
      // What lies apart within one cell, at some of its finest vertices.
      const size_t cells = size_t{1} << log2, step = n / cells, stride = std::max<size_t>(1, step / 16);
      for (int k = 0; k < 40; ++k) {
        const size_t cx = random() % cells, cy = random() % cells,
                     block = cy * blocks / cells * blocks + cx * blocks / cells;
        double low = 0, high = 0;
        std::vector<glm::dvec3> apart{glm::dvec3(0)};
        for (size_t y = cy * step; y <= (cy + 1) * step; y += stride)
          for (size_t x = cx * step; x <= (cx + 1) * step; x += stride) {
            const double u = static_cast<double>(x) / static_cast<double>(n),
                         v = static_cast<double>(y) / static_cast<double>(n);
            apart.push_back(surface(n, u, v) - surface(cells, u, v));
            const double along = glm::dot(apart.back(), glm::normalize(base.normal(p, u, v)));
            low = std::min(low, along), high = std::max(high, along);
          }
        double furthest = 0;
        for (const glm::dvec3& a : apart)
          furthest = std::max(furthest, glm::length(a - apart[random() % apart.size()]));
        const Deviation known = deviationOf(errors[block], shapes[block]);
        ASSERT_LE(high - low, known.between_mm + 1e-12) << p << " " << log2 << " " << block;
        ASSERT_LE(furthest, known.apart_mm + 1e-12) << p << " " << log2 << " " << block;
        half_shapes_fail[3] += high - low > known.between_mm / 2, half_shapes_fail[4] += furthest > known.apart_mm / 2;
        alike += known.apart_mm < 1.5 * known.mm;
      }
      // Monotone: no block below those of the finer level inside it.
      const auto fine = static_cast<size_t>(MeshBake::errorBlocks(log2 + 1));
      for (size_t i = 0; i < finer.size(); ++i) {
        const size_t x = i % fine * blocks / fine, y = i / fine * blocks / fine;
        EXPECT_GE(errors[y * blocks + x], finer[i]);
      }
      finer = errors;
    }
    EXPECT_LE(baked->errorOfGrid(p, 7), 65535 * baked->errorUnitMm());
  }
  EXPECT_GT(tightest, 0.9);
  EXPECT_GT(halves_fail, 0u);  // control: half the errors would not be bounds
  for (size_t fails : half_shapes_fail) EXPECT_GT(fails, 0u);
  EXPECT_GT(one_sided, 0u);
  EXPECT_GT(within_cells, 0u);
  EXPECT_GT(alike, 0u);
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
    for (int log2 = 0; log2 <= 7; ++log2) EXPECT_LT(baked->errorOfGrid(p, log2), 1e-12f);
  }
}

// The scan's vertices lie below the samples: what is baked are their heights, half a step around.
TEST(MeshBake, bumpsKeepTheirHeights) {
  const double amplitude = 0.7;
  auto z = [&](double x, double y) { return amplitude * std::sin(0.9 * x) * std::cos(0.7 * y); };
  const TriMesh mesh = sheetMesh(20, 10, 64, 32, z);
  const BaseMesh base = sheetBase(20, 10, 2, 1);
  auto baked = bake(mesh, base, {.cells_log2 = 5, .fit = false});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->report().by_closest_point, 0u);
  for (uint32_t p = 0; p < 2; ++p) {
    const Heights q = heightsOf(*baked, p);
    for (size_t y = 0; y <= 128; y += 4) {
      for (size_t x = 0; x <= 128; x += 4) {
        const double h = baked->reliefOffsetMm() + baked->reliefScaleMm() * q[y * 129 + x];
        ASSERT_NEAR(
            h,
            static_cast<float>(z(10.0 * p + 10.0 * static_cast<double>(x) / 128, -10.0 * static_cast<double>(y) / 128)),
            0.501 * baked->reliefScaleMm());
      }
    }
  }
  EXPECT_NEAR(baked->reliefScaleMm() * 65535, 2 * amplitude, 0.01);
}

struct AllBytes {
  std::vector<uint16_t> heights;
  std::vector<uint8_t> texels;
  std::vector<float> errors;
  double offset = 0, scale = 0, unit = 0;
  bool operator==(const AllBytes&) const = default;
};
AllBytes allBytes(const MeshBake& baked) {
  AllBytes out{.offset = baked.reliefOffsetMm(), .scale = baked.reliefScaleMm(), .unit = baked.errorUnitMm()};
  for (uint32_t p = 0; p < baked.base().patches.size(); ++p) {
    const Heights q = heightsOf(baked, p);
    out.heights.insert(out.heights.end(), q.begin(), q.end());
    const size_t size = size_t{128} << baked.textureDepth();
    std::vector<uint8_t> texels(6 * size * size);
    EXPECT_TRUE(baked.texels(p, texels));
    out.texels.insert(out.texels.end(), texels.begin(), texels.end());
    for (int log2 = 0; log2 <= 7 + baked.reliefDepth(); ++log2) out.errors.push_back(baked.errorOfGrid(p, log2));
  }
  return out;
}

TEST(MeshBake, theSameForAnyNumberOfWorkers) {
  TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.3 * std::sin(9 * d.x + 4 * d.y) * std::cos(8 * d.z); }, 50);
  std::mt19937 random(21);
  for (size_t i = 0; i < mesh.positions_mm.size(); ++i)
    mesh.colours.push_back(glm::u8vec3(random() % 256, random() % 256, random() % 256));
  const BaseMesh base = sphereBase(10, 1);
  for (int cells_log2 : {3, 8, -1}) {
    if (kSanitized && cells_log2 == 8) continue;
    std::vector<AllBytes> all;
    for (int workers : {1, 2, 3}) {
      if (kSanitized && workers == 2) continue;
      auto baked = bake(mesh, base, {.cells_log2 = cells_log2, .workers = workers});
      ASSERT_TRUE(baked);
      all.push_back(allBytes(*baked));
    }
    EXPECT_TRUE(all[0] == all[1] && all[0] == all.back()) << cells_log2;
  }
  // Control: another mesh has other bytes.
  mesh.positions_mm[7] *= 1.001f;
  EXPECT_FALSE(allBytes(*bake(mesh, base, {.cells_log2 = 3})) ==
               allBytes(*bake(sphereMesh(10, 50), base, {.cells_log2 = 3})));
}

// The samples that a finer grid takes over from a coarser one are those that its own lines find. Where lines are traced
// as rays alone, nothing is taken over.
TEST(TraceSamples, takesOverWhatTheCoarserGridFound) {
  const TriMesh mesh = sheetMesh(20, 10, 80, 40, [](double x, double y) { return 0.5 + 0.2 * std::sin(x) + 0.1 * y; });
  BaseMesh base = sheetBase(22, 12, 2, 2);  // lines beyond the sheet's border meet nothing
  base.origin_mm = {-1, 1, 0};
  for (const size_t rasterise_from : {size_t{0}, ~size_t{0}}) {
    auto scene = makeBakeScene(mesh, {.rasterise_from_triangles = rasterise_from});
    ASSERT_TRUE(scene);
    BakeContext context(mesh, base);
    context.scene = scene->rays;
    context.rasteriser = scene->rasteriser;
    context.normals = scene->normals;
    std::vector<Probe> probes;
    const auto coarse = traceSamples(context, 3, probes, {});
    ASSERT_TRUE(coarse);
    const auto met = coarse->weights.size() -
                     static_cast<size_t>(std::count(coarse->weights.begin(), coarse->weights.end(), uint8_t{0}));
    EXPECT_GT(met, coarse->weights.size() / 2);
    EXPECT_LT(met, coarse->weights.size());
    auto finer = [&](const TracedHeights& coarser) {
      auto traced = traceSamples(context, 6, probes, {}, coarser);
      EXPECT_TRUE(traced);
      return std::move(*traced);
    };
    const TracedHeights anew = finer({}), taken_over = finer(*coarse);
    EXPECT_EQ(anew.heights, taken_over.heights);
    EXPECT_EQ(anew.weights, taken_over.weights);
    // Control: other heights on the coarser grid are taken over, but for those of lines that met nothing.
    const bool rasterised = scene->rasteriser != nullptr;
    TracedHeights other = *coarse;
    for (float& height : other.heights) height += 1;
    const TracedHeights moved = finer(other);
    size_t differ = 0;
    for (size_t i = 0; i < anew.heights.size(); ++i) differ += anew.weights[i] && anew.heights[i] != moved.heights[i];
    EXPECT_EQ(differ, rasterised ? met : 0);
  }
}

TEST(MeshBake, beyondTheScansBorderLiesItsBorder) {
  // The base reaches 1 mm further than the sheet on all sides: no line meets anything there.
  auto z = [](double x, double y) { return 0.5 + 0.2 * std::sin(x) + 0.1 * y; };
  TriMesh mesh = sheetMesh(20, 10, 80, 40, z);
  mesh.origin_mm = {1e7, -1e7, 5};  // both from origins of their own
  BaseMesh base = sheetBase(22, 12, 2, 1);
  base.origin_mm = {1e7 - 1, -1e7 + 1, 5};
  auto baked = bake(mesh, base, {.cells_log2 = 6});
  ASSERT_TRUE(baked);
  EXPECT_GT(baked->report().by_closest_point, 1000u);
  EXPECT_LT(baked->report().by_closest_point, 4000u);
  for (uint32_t p = 0; p < 2; ++p) {
    const Heights q = heightsOf(*baked, p);
    double last = 0;
    for (size_t y = 0; y <= 128; y += 2) {
      for (size_t x = 0; x <= 128; x += 2) {
        const glm::dvec3 at = base.point(p, static_cast<double>(x) / 128, static_cast<double>(y) / 128);
        const double h = baked->reliefOffsetMm() + baked->reliefScaleMm() * q[y * 129 + x];
        const double px = std::clamp(at.x - 1, 0.0, 20.0), py = std::clamp(at.y + 1, -10.0, 0.0);
        EXPECT_NEAR(h, z(px, py), 0.08) << at.x << " " << at.y;
        if (x) {
          EXPECT_LT(std::abs(h - last), 0.15);
        }  // no spikes
        last = h;
      }
    }
  }
}

// A sheet at z = 0 from x = 0 on, and one above it that reaches further: lines from just beside the first one's border
// meet the second one.
TEST(MeshBake, aBaseThatTouchesABorderDoesNotJumpToAnotherSheet) {
  TriMesh mesh;
  auto addSheet = [&](float x0, float z) {
    const auto first = static_cast<uint32_t>(mesh.positions_mm.size());
    for (float y : {-1.0f, 2.0f})
      for (float x : {x0, 1.5f}) mesh.positions_mm.push_back({x, y, z});
    mesh.triangles.push_back({first, first + 1, first + 3});
    mesh.triangles.push_back({first, first + 3, first + 2});
  };
  addSheet(0, 0);
  addSheet(-1, 0.2f);
  BaseMesh base;
  for (float y : {1.0f, 0.0f})
    for (float x : {-1e-5f, 1.0f}) base.corners.push_back({{x, y, 0}, {0, 0, 1}});
  base.patches = {{0, 1, 2, 3}};
  auto highestOf = [&](Touching touching) {
    const auto baked = bake(mesh, base, {.cells_log2 = 2, .fit = false, .touching = touching});
    return baked->reliefOffsetMm() + 65535 * baked->reliefScaleMm();
  };
  EXPECT_NEAR(highestOf(Touching::kFacing), 0, 1e-6);
  EXPECT_NEAR(highestOf(Touching::kSameSheet), 0, 1e-6);
  EXPECT_NEAR(highestOf(Touching::kIgnored), 0.2, 1e-4) << "the shape no longer shows the difference";
  // A sheet that is seen from behind is not the base's.
  for (size_t t = 0; t < 2; ++t) std::swap(mesh.triangles[t][1], mesh.triangles[t][2]);
  for (const Touching touching : {Touching::kFacing, Touching::kSameSheet})
    EXPECT_NEAR(highestOf(touching), 0.2, 1e-4) << int(touching);
  EXPECT_NEAR(highestOf(Touching::kAlways), 0, 1e-6);
}

// A box on a floor of 30 x 20 mm, whose walls lean outwards by so much of its height.
TriMesh leaningBox(float high, float lean) {
  TriMesh mesh;
  for (int k = 0; k < 8; ++k) {
    const float beyond = k & 4 ? lean * high : 0;
    mesh.positions_mm.push_back({k & 1 ? 30 + beyond : -beyond, k & 2 ? 20 + beyond : -beyond, k & 4 ? high : 0});
  }
  mesh.triangles = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                    {1, 3, 7}, {1, 7, 5}, {3, 2, 6}, {3, 6, 7}, {2, 0, 4}, {2, 4, 6}};
  return mesh;
}

// A box as its own base, all normals upwards: lines from its bottom and its walls meet its top, or nothing.
TEST(MeshBake, aBaseOnTheScanKeepsItsPlaceWhateverItsNormals) {
  const TriMesh mesh = leaningBox(10, 0);
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 100);
  ASSERT_EQ(base.patches.size(), 6u);
  for (BaseCorner& c : base.corners) c.normal = {0, 0, 1};
  auto highestOf = [&](Touching touching, double touch_mm) {
    const auto baked = bake(mesh, base, {.cells_log2 = 2, .fit = false, .touching = touching, .touch_mm = touch_mm});
    return std::abs(baked->reliefOffsetMm()) + 65535 * baked->reliefScaleMm();
  };
  EXPECT_EQ(highestOf(Touching::kIgnored, 1e-5), 0);
  EXPECT_GT(highestOf(Touching::kIgnored, 0), 5) << "the shape no longer shows the difference";
  // The bottom faces away from its lines.
  EXPECT_NEAR(highestOf(Touching::kSameSheet, 0), 0, 1e-6);
  EXPECT_GT(highestOf(Touching::kFacing, 0), 5) << "the shape no longer shows the difference";
}

// Triangles that fold as their own base: two of them are a patch as they are, without heights and whatever the number
// of its cells.
TEST(MeshBake, aBaseOfTheScansOwnTrianglesIsTheScan) {
  const TriMesh mesh = sheetMesh(40, 30, 8, 6, [](double x, double y) { return 3 * std::sin(0.7 * x) * std::cos(y); });
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 1000);
  ASSERT_GE(base.patches.size(), mesh.triangles.size() / 2);
  double largest_of_bilinear = 0;
  for (const bool cut : {true, false}) {
    base.cut = cut;
    const auto baked = bake(mesh, base, {.touch_mm = 1e-5});
    ASSERT_TRUE(baked);
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      const double error = baked->errorOfGrid(p, 0);
      if (!cut) largest_of_bilinear = std::max(largest_of_bilinear, error);
      else ASSERT_EQ(error, 0) << p;
      if (!cut) continue;
      ASSERT_NEAR(baked->reliefOffsetMm(), 0, 1e-9);
      ASSERT_EQ(baked->reliefScaleMm(), 0);
      const BetweenSamples between = baked->betweenSamples(p);
      ASSERT_EQ(between.mm(between.cells_log2), 0) << p;
      SurfaceGrid grid(4);
      baked->surface(p, grid);
      for (size_t y = 0; y <= 16; ++y)
        for (size_t x = 0; x <= 16; ++x) {
          const size_t at = y * 17 + x;
          const glm::dvec3 place(grid.axes[0][at], grid.axes[1][at], grid.axes[2][at]);
          const double u = static_cast<double>(x) / 16, v = static_cast<double>(y) / 16;
          ASSERT_NEAR(glm::distance(place, base.point(p, u, v)), 0, 1e-9) << p << " " << x << " " << y;
        }
    }
  }
  EXPECT_GT(largest_of_bilinear, 0.1) << "control: the shape no longer shows the difference";
}

// Each texel shows its place on the patch's own two triangles: colours are a ramp along x and y, of sheets that face
// both ways at one place, one of them in the other's complement.
TEST(MeshBake, texelsOfOwnTrianglesAreTheirsWhereSheetsTouch) {
  TriMesh mesh = sheetMesh(40, 30, 4, 3, [](double x, double y) { return 4 * std::sin(0.7 * x) * std::cos(y); });
  for (size_t i = 0; i < mesh.positions_mm.size(); ++i) {
    glm::vec3& p = mesh.positions_mm[i];
    p = {p.x + 0.02f * p.y * (p.x - 20), p.y * (1 + 0.02f * p.x), p.z};  // no parallelograms
  }
  const size_t vertices = mesh.positions_mm.size(), triangles = mesh.triangles.size();
  for (size_t i = 0; i < vertices; ++i) mesh.positions_mm.push_back(mesh.positions_mm[i]);
  for (size_t i = 0; i < triangles; ++i) {
    const Triangle t = mesh.triangles[i];
    const auto more = static_cast<uint32_t>(vertices);
    mesh.triangles.push_back({t[0] + more, t[2] + more, t[1] + more});
  }
  auto rampAt = [](const glm::dvec3& p) { return glm::dvec3(4 * p.x + 60, -3 * p.y + 60, 2 * p.x - 2 * p.y + 30); };
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 1000);
  // Bytes hold the ramp at vertices; the truth between them is what these say.
  for (size_t i = 0; i < mesh.positions_mm.size(); ++i) {
    const glm::dvec3 ramp = rampAt(mesh.positions_mm[i]);
    mesh.colours.push_back(glm::u8vec3(glm::round(i < vertices ? ramp : 255.0 - ramp)));
  }
  double other_base = 0;
  for (const bool cut : {true, false}) {
    base.cut = cut;
    const auto baked = bake(mesh, base, {.touch_mm = 1e-4, .texture_depth = 0});
    ASSERT_TRUE(baked && baked->textureDepth() == 0);
    std::vector<uint8_t> texels(6 * 128 * 128);
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      ASSERT_TRUE(baked->texels(p, texels));
      BaseMesh truth = base;
      truth.cut = true;
      const bool back = base.patches[p][0] >= vertices && base.patches[p][3] >= vertices;
      if (std::any_of(base.patches[p].begin(), base.patches[p].end(), [&](uint32_t c) { return c >= 2 * vertices; }))
        continue;  // a single triangle
      for (size_t y = 0; y < 128; ++y)
        for (size_t x = 0; x < 128; ++x) {
          const glm::dvec3 at = truth.point(p, (static_cast<double>(x) + 0.5) / 128,
                                            (static_cast<double>(y) + 0.5) / 128),
                           ramp = back ? 255.0 - rampAt(at) : rampAt(at);
          for (size_t c = 0; c < 3; ++c) {
            const double off = std::abs(texels[(c * 128 + y) * 128 + x] - ramp[static_cast<int>(c)]);
            if (!cut) other_base = std::max(other_base, off);
            else ASSERT_LE(off, 1.2) << "patch " << p << ", texel " << x << " " << y << ", channel " << c;
          }
        }
    }
  }
  EXPECT_GT(other_base, 2) << "control";
}

// A box as its own base again; steps, of which a sheet beside it needs some, draw it beside the scan. Lines upwards
// from its bottom and its walls, which lean outwards, meet its top: from behind where the box is thin, far away where
// it is not. Each patch shows itself all the same.
TEST(MeshBake, texelsAreOfTheSheetThatThePatchCovers) {
  for (const float high : {0.05f, 10.0f}) {
    TriMesh mesh = leaningBox(high, 0.2f);
    for (int k = 0; k < 4; ++k) mesh.positions_mm.push_back({k & 1 ? 130 : 100, k & 2 ? 20 : 0, 0});
    mesh.triangles.insert(mesh.triangles.end(), {{8, 9, 11}, {8, 11, 10}});
    auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
    ASSERT_TRUE(surface.ok());
    BaseMesh base = facesBase(*surface, 100);
    ASSERT_EQ(base.patches.size(), 7u);
    for (BaseCorner& c : base.corners) {
      c.normal = {0, 0, 1};
      if (c.position_mm.x >= 100) c.position_mm.z = c.position_mm.x > 100 ? 0.07f : -0.35f;
    }
    constexpr double kTouch = 1e-3;
    const auto baked = bake(mesh, base, {.cells_log2 = 2, .fit = false, .touch_mm = kTouch});
    ASSERT_TRUE(baked && baked->setStep(0.2));
    std::vector<uint8_t> texels(6 * 128 * 128);
    size_t tried = 0;
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      const auto& corners = base.patches[p];
      std::array<glm::dvec3, 4> at;
      for (size_t k = 0; k < 4; ++k) at[k] = mesh.positions_mm[corners[k]];
      const glm::dvec3 own = glm::normalize(glm::cross(at[2] - at[1], at[3] - at[0]));
      if (corners[0] >= 8 || (high < 1 && std::abs(own.z) < 0.5)) continue;  // walls that are lower than a step
      const Heights q = heightsOf(*baked, p);
      ASSERT_GT(std::abs(baked->reliefOffsetMm() + baked->reliefScaleMm() * q[64 * 129 + 64]), 2 * kTouch)
          << "not beside";
      ++tried;
      ASSERT_TRUE(baked->textureDepth() == 0 && baked->texels(p, texels));
      for (size_t y = 1; y < 127; ++y)
        for (size_t x = 1; x < 127; ++x)
          for (size_t c = 0; c < 3; ++c)
            ASSERT_NEAR(texels[((3 + c) * 128 + y) * 128 + x], 127.5 * (1 + own[static_cast<int>(c)]), 1)
                << "patch " << p << ", texel " << x << " " << y << ", height " << high;
    }
    EXPECT_EQ(tried, high < 1 ? 2u : 6u);
  }
}

TEST(MeshBake, needlesDoNoHarm) {
  // Triangles 10,000 times as long as wide.
  auto z = [](double x, double y) { return 0.1 * x + 0.2 * y; };
  const TriMesh mesh = sheetMesh(100, 10, 1, 1000, z);
  auto baked = bake(mesh, sheetBase(100, 10, 4, 1), {.cells_log2 = 5});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->report().by_closest_point, 0u);
  for (uint32_t p = 0; p < 4; ++p) {
    const Heights q = heightsOf(*baked, p);
    for (size_t y = 0; y <= 128; ++y)
      for (size_t x = 0; x <= 128; ++x)
        ASSERT_NEAR(baked->reliefOffsetMm() + baked->reliefScaleMm() * q[y * 129 + x],
                    z(25.0 * p + 25.0 * static_cast<double>(x) / 128, -10.0 * static_cast<double>(y) / 128),
                    baked->reliefScaleMm() + 1e-5);
  }
}

TEST(MeshBake, aMoebiusStripAgreesWithItselfUpsideDown) {
  constexpr int kPatches = 12;
  const double pi = std::acos(-1.0);
  auto place = [&](double along, double across) {  // along in turns
    const double turn = 2 * pi * along, tilt = pi * along;
    const glm::dvec3 outwards(std::cos(turn), std::sin(turn), 0);
    return 10.0 * outwards + across * (std::cos(tilt) * outwards + std::sin(tilt) * glm::dvec3(0, 0, 1));
  };
  // After one turn the strip comes back upside down: across becomes -across.
  auto strip = [&](int n, int m) {
    CubeQuads out;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j <= m; ++j) out.corners.push_back(place(static_cast<double>(i) / n, 4.0 * j / m - 2));
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < m; ++j) {
        auto at = [&](int a, int b) { return static_cast<uint32_t>(a == n ? m - b : a * (m + 1) + b); };
        out.quads.push_back({at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)});
      }
    }
    return out;
  };
  const CubeQuads fine = strip(240, 16), coarse = strip(kPatches, 1);
  TriMesh mesh;
  for (const glm::dvec3& p : fine.corners) mesh.positions_mm.push_back(glm::vec3(p));
  mesh.triangles = trianglesOf(fine.quads);
  BaseMesh base;
  for (size_t i = 0; i < coarse.corners.size(); ++i) {
    const double along = static_cast<double>(i / 2) / kPatches;
    const glm::dvec3 across = place(along, 1) - place(along, 0), ahead = place(along + 1e-4, 0) - place(along, 0);
    base.corners.push_back({glm::vec3(coarse.corners[i]), glm::vec3(glm::normalize(glm::cross(across, ahead)))});
  }
  base.patches = coarse.quads;
  ASSERT_EQ(baseMeshProblem(base), "");
  const auto neighbours = patchNeighbours(base);
  ASSERT_TRUE(neighbours[kPatches - 1][kRight].reversed);
  for (const auto& [cells_log2, fit] :
       std::array<std::pair<int, bool>, 4>{{{2, false}, {6, false}, {8, false}, {4, true}}}) {
    auto baked = bake(mesh, base, {.cells_log2 = cells_log2, .fit = fit});
    ASSERT_TRUE(baked);
    EXPECT_TRUE(std::isfinite(baked->reliefOffsetMm()) && std::isfinite(baked->reliefScaleMm()));
    if (!fit) {
      EXPECT_LT(std::abs(baked->reliefOffsetMm()) + baked->reliefScaleMm() * 65535, 20);
    }
    const size_t row = side(*baked), n = row - 1;
    for (uint32_t p = 0; p < kPatches; ++p) {
      const Heights here = heightsOf(*baked, p), next = heightsOf(*baked, (p + 1) % kPatches);
      for (size_t i = 0; i <= n; ++i)
        ASSERT_EQ(here[i * row + n], next[(p + 1 == kPatches ? n - i : i) * row]) << p << " " << i;
      std::vector<uint8_t> texels(6 * 128 * 128);
      if (baked->textureDepth() == 0) {
        EXPECT_TRUE(baked->texels(p, texels));
      }
    }
  }
}

TEST(MeshBake, aWallStaysWithinTheScan) {
  // A step of 3 mm within 0.01 mm: no height beyond the two levels, whatever the lines beside it meet.
  const TriMesh mesh = sheetMesh(10, 10, 1000, 4, [](double x, double) { return x < 5.001 ? 0.0 : 3.0; });
  auto baked = bake(mesh, sheetBase(10, 10, 1, 1), {.cells_log2 = 7});
  ASSERT_TRUE(baked);
  EXPECT_NEAR(baked->reliefOffsetMm(), 0, 1e-6);
  EXPECT_NEAR(baked->reliefScaleMm() * 65535, 3, 1e-5);
}

TEST(MeshBake, coloursAndNormalsAreTheScans) {
  auto z = [](double x, double y) { return 0.3 * std::sin(0.8 * x) + 0.2 * std::cos(0.6 * y); };
  TriMesh mesh = sheetMesh(20, 10, 100, 50, z);
  auto colour = [](double x, double y) { return glm::dvec3(10 + 10 * x, 250 + 20 * y, 100 + 3 * x - 5 * y); };
  for (const glm::vec3& p : mesh.positions_mm) mesh.colours.push_back(glm::u8vec3(glm::round(colour(p.x, p.y))));
  const BaseMesh base = sheetBase(20, 10, 2, 1);
  for (int depth : {0, 1}) {
    auto baked = bake(mesh, base, {.cells_log2 = 6, .texture_depth = depth});
    ASSERT_TRUE(baked);
    const size_t size = size_t{128} << depth;
    size_t swapped = 0;
    for (uint32_t p = 0; p < 2; ++p) {
      std::vector<uint8_t> texels(6 * size * size);
      ASSERT_TRUE(baked->texels(p, texels));
      for (size_t y = 0; y < size; ++y) {
        for (size_t x = 0; x < size; ++x) {
          const double px = 10.0 * p + 10 * (static_cast<double>(x) + 0.5) / static_cast<double>(size),
                       py = -10 * (static_cast<double>(y) + 0.5) / static_cast<double>(size);
          const glm::dvec3 expected = colour(px, py), other = colour(-py, -px);
          const glm::dvec3 normal =
              glm::normalize(glm::dvec3(-0.24 * std::cos(0.8 * px), 0.12 * std::sin(0.6 * py), 1));
          for (int c = 0; c < 3; ++c) {
            const size_t at = (static_cast<size_t>(c) * size + y) * size + x;
            ASSERT_NEAR(texels[at], expected[c], 1.6) << px << " " << py;
            ASSERT_NEAR(texels[at + 3 * size * size], 127.5 * (normal[c] + 1), 2.0) << px << " " << py;
            swapped += std::abs(texels[at] - other[c]) > 1.6;
          }
        }
      }
    }
    EXPECT_GT(swapped, size * size);  // control: u for v would be seen
  }
}

// Large patches are sampled in bands of rows: a ramp of colours has no step where one meets the next, whether bands are
// of 64 rows (rays) or of 128 (rasterised).
TEST(MeshBake, coloursHaveNoStepsBetweenBandsOfRows) {
  constexpr int kCells = 60;
  TriMesh mesh = sheetMesh(10, 10, kCells, kCells, [](double, double) { return 0.0; });
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) mesh.colours.push_back(glm::u8vec3(4 * j, 240 - 4 * j, 4 * i));
  for (const size_t rasterise_from : {size_t{0}, ~size_t{0}}) {
    for (int depth : {1, 2}) {  // a sample for each texel, and for every other one
      auto scene = makeBakeScene(mesh, {.rasterise_from_triangles = rasterise_from, .rasterise_from_per_patch = 0});
      ASSERT_TRUE(scene);
      auto baked =
          MeshBake::create(mesh, {}, sheetBase(10, 10, 1, 1), {.cells_log2 = 4, .texture_depth = depth}, *scene);
      ASSERT_TRUE(baked);
      const size_t texels = size_t{kPagePx} << depth;
      std::vector<uint8_t> out(6 * texels * texels);
      ASSERT_TRUE((*baked)->texels(0, out));
      for (size_t y = 0; y < texels; ++y) {
        for (size_t x = 0; x < texels; ++x) {
          const double u = 240 * (static_cast<double>(x) + 0.5) / static_cast<double>(texels),
                       v = 240 * (static_cast<double>(y) + 0.5) / static_cast<double>(texels);
          const std::array<double, 3> ramp{v, 240 - v, u};
          for (size_t c = 0; c < 3; ++c)
            ASSERT_NEAR(out[(c * texels + y) * texels + x], ramp[c], 0.51) << depth << " " << x << " " << y << " " << c;
        }
      }
    }
  }
}

// A texel for each sample, over a patch that is cut and no parallelogram: each shows its place on one of the halves.
TEST(MeshBake, texelsOfCutPatchesLieOnTheirHalves) {
  constexpr int kCells = 60;
  TriMesh mesh = sheetMesh(10, 10, kCells, kCells, [](double, double) { return 0.0; });
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) mesh.colours.push_back(glm::u8vec3(4 * j, 240 - 4 * j, 4 * i));
  BaseMesh base = sheetBase(10, 10, 1, 1);
  base.corners[base.patches[0][3]].position_mm = {6, -8, 0};
  base.cut = true;
  const auto baked = bake(mesh, base, {.cells_log2 = 4, .texture_depth = 1});
  ASSERT_TRUE(baked);
  constexpr size_t kTexels = 2 * kPagePx;
  std::vector<uint8_t> out(6 * kTexels * kTexels);
  ASSERT_TRUE(baked->texels(0, out));
  BaseMesh bilinear = base;
  bilinear.cut = false;
  double largest = 0, of_bilinear = 0;
  for (size_t y = 0; y < kTexels; ++y)
    for (size_t x = 0; x < kTexels; ++x)
      for (const BaseMesh* of : {&base, &bilinear}) {
        const glm::dvec3 p =
            of->point(0, (static_cast<double>(x) + 0.5) / kTexels, (static_cast<double>(y) + 0.5) / kTexels);
        const std::array<double, 3> ramp{-24 * p.y, 240 + 24 * p.y, 24 * p.x};
        for (size_t c = 0; c < 3; ++c) {
          double& most = of == &base ? largest : of_bilinear;
          most = std::max(most, std::abs(out[(c * kTexels + y) * kTexels + x] - ramp[c]));
        }
      }
  EXPECT_LT(largest, 0.6);
  EXPECT_GT(of_bilinear, 5) << "control";
}

// A roof over a patch, its ridge between two of the samples that normals are interpolated from, and two patches that
// meet at their ridge: the slopes are even up to the texel that the ridge crosses.
TEST(MeshBake, creasesAreSharp) {
  constexpr double kRidge = 4.9;
  for (const int patches : {1, 2}) {
    const double ridge = patches == 1 ? kRidge : 10, width = 10.0 * patches;
    TriMesh mesh = sheetMesh(width, 10, 10 * patches, 10, [](double, double) { return 0.0; });
    for (glm::vec3& p : mesh.positions_mm) {
      if (std::abs(p.x - ridge) < 0.5) p.x = static_cast<float>(ridge);
      p.z = static_cast<float>(-std::abs(p.x - ridge));
    }
    auto baked = bake(mesh, sheetBase(width, 10, patches, 1), {.cells_log2 = 5, .texture_depth = 0});
    ASSERT_TRUE(baked);
    constexpr size_t kTexels = 128;
    std::vector<uint8_t> texels(6 * kTexels * kTexels);
    size_t at_ridge = 0, uphill = 0, downhill = 0;
    for (uint32_t p = 0; p < static_cast<uint32_t>(patches); ++p) {
      ASSERT_TRUE(baked->texels(p, texels));
      for (size_t y = 0; y < kTexels; ++y) {
        for (size_t x = 0; x < kTexels; ++x) {
          const double px = 10.0 * p + 10 * (static_cast<double>(x) + 0.5) / kTexels, side = px < ridge ? -1 : 1;
          const size_t at = y * kTexels + x;
          if (std::abs(px - ridge) < 0.5 * 10 / kTexels) {
            ++at_ridge;
            continue;
          }
          ASSERT_NEAR(texels[at + 3 * kTexels * kTexels], 127.5 * (1 + side * std::sqrt(0.5)), 1) << px << " " << y;
          ASSERT_NEAR(texels[at + 5 * kTexels * kTexels], 127.5 * (1 + std::sqrt(0.5)), 1) << px << " " << y;
          ++(side < 0 ? uphill : downhill);
        }
      }
    }
    EXPECT_LE(at_ridge, kTexels);
    EXPECT_GT(uphill, 50 * kTexels);
    EXPECT_GT(downhill, 50 * kTexels);
    // Control: the ridge's mean normal points up, and would tint the dozen texels to both sides of it.
    std::vector<glm::vec3> means;
    ASSERT_TRUE(makeVertexNormals(mesh, 1, nullptr, means));
    float most = 0;
    for (const glm::vec3& n : means) most = std::max(most, n.z);
    EXPECT_GT(most, 0.99f);
  }
}

TEST(MeshBake, foldedTrianglesDoNotDarkenTheirNeighbours) {
  // One vertex of a flat sheet lies beyond its neighbour, a little above: some of its triangles face down.
  TriMesh mesh = sheetMesh(10, 10, 20, 20, [](double, double) { return 0.0; });
  uint32_t moved = 0;
  for (uint32_t i = 0; i < mesh.positions_mm.size(); ++i)
    if (glm::length(mesh.positions_mm[i] - glm::vec3(5, -5, 0)) < 0.1f) moved = i;
  ASSERT_GT(moved, 0u);
  mesh.positions_mm[moved] += glm::vec3(0.7f, 0, 0.02f);
  auto baked = bake(mesh, sheetBase(10, 10, 1, 1), {.cells_log2 = 6});
  std::vector<uint8_t> texels(6 * 128 * 128);
  ASSERT_TRUE(baked->textureDepth() == 0 && baked->texels(0, texels));
  const auto up = texels.begin() + 5 * 128 * 128;
  EXPECT_GE(*std::min_element(up, up + 128 * 128), 225);  // 40 degrees: the fold itself stands up, nothing is dark
  // Control: with all triangles, the vertex has no normal to speak of.
  glm::vec3 sum(0);
  size_t down = 0;
  for (const auto& t : mesh.triangles) {
    for (size_t k = 0; k < 3; ++k) {
      if (t[k] != moved) continue;
      const glm::vec3 a = mesh.positions_mm[t[(k + 1) % 3]] - mesh.positions_mm[moved],
                      b = mesh.positions_mm[t[(k + 2) % 3]] - mesh.positions_mm[moved];
      const glm::vec3 n = glm::cross(a, b);
      sum += glm::normalize(n) * std::atan2(glm::length(n), glm::dot(a, b));
      down += n.z < 0;
    }
  }
  EXPECT_GT(down, 1u);
  EXPECT_LT(glm::normalize(sum).z, 0.5f);
}

TEST(MeshBake, imagesAreLookedUpFromTheirLowerLeftCorner) {
  TriMesh mesh = sheetMesh(20, 10, 20, 10, [](double x, double y) { return 0.2 * std::sin(x + y); });
  for (const auto& t : mesh.triangles) {
    std::array<glm::vec2, 3> uv;
    for (size_t k = 0; k < 3; ++k) uv[k] = {mesh.positions_mm[t[k]].x / 20, 1 + mesh.positions_mm[t[k]].y / 10};
    mesh.corner_uv.push_back(uv);
  }
  constexpr int kWidth = 64, kHeight = 32;
  std::vector<uint8_t> rgb;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      rgb.insert(rgb.end(),
                 {static_cast<uint8_t>(4 * x), static_cast<uint8_t>(8 * y), static_cast<uint8_t>(x + 2 * y)});
  auto baked =
      bake(mesh, sheetBase(20, 10, 2, 1), {.cells_log2 = 5}, {{.width = kWidth, .height = kHeight, .texels = rgb}});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->textureDepth(), 0);
  for (uint32_t p = 0; p < 2; ++p) {
    std::vector<uint8_t> texels(6 * 128 * 128);
    ASSERT_TRUE(baked->texels(p, texels));
    for (int y = 0; y < 128; ++y) {
      for (int x = 0; x < 128; ++x) {
        // Bilinear in the image, whose rows run as v does.
        const double ix = std::clamp((static_cast<int>(p) * 128 + x + 0.5) / 256 * kWidth - 0.5, 0.0, kWidth - 1.0),
                     iy = std::clamp((y + 0.5) / 128 * kHeight - 0.5, 0.0, kHeight - 1.0);
        const size_t at = static_cast<size_t>(y * 128 + x);
        ASSERT_NEAR(texels[at], 4 * ix, 1.01);
        ASSERT_NEAR(texels[at + 128 * 128], 8 * iy, 1.01);
        ASSERT_NEAR(texels[at + 2 * 128 * 128], ix + 2 * iy, 1.01);
      }
    }
  }
  // A scan without colours is grey.
  mesh.corner_uv.clear();
  auto grey = bake(mesh, sheetBase(20, 10, 2, 1), {.cells_log2 = 5});
  std::vector<uint8_t> texels(6 * 128 * 128);
  ASSERT_TRUE(grey->texels(0, texels));
  EXPECT_TRUE(std::all_of(texels.begin(), texels.begin() + 3 * 128 * 128, [](uint8_t c) { return c == 200; }));
}

// A sheet of three patches under an image of stripes: the first has a 50th of it, the third most of it.
TEST(MeshBake, eachPatchHasTheTexelsOfItsPartOfTheImage) {
  TriMesh mesh = sheetMesh(30, 10, 30, 10, [](double, double) { return 0.0; });
  constexpr int kWidth = 1024, kHeight = 100;
  const std::array<double, 4> part{0, 20, 220, kWidth};  // of the image's columns, from patch to patch
  auto column = [&](double x) {
    const auto p = static_cast<size_t>(std::clamp(x / 10, 0.0, 2.0));
    return part[p] + (part[p + 1] - part[p]) * (x / 10 - static_cast<double>(p));
  };
  for (const auto& t : mesh.triangles) {
    auto& uv = mesh.corner_uv.emplace_back();
    float least = 30;
    for (uint32_t v : t) least = std::min(least, mesh.positions_mm[v].x);
    for (size_t k = 0; k < 3; ++k) {
      const glm::vec3 at = mesh.positions_mm[t[k]];
      // A triangle's corners at the border of two patches belong to its own patch.
      const double x = std::clamp<double>(at.x, least, std::floor(least / 10 + 1e-4) * 10 + 10 - 1e-6);
      uv[k] = {static_cast<float>(column(x) / kWidth), 1 + at.y / 10};
    }
  }
  auto stripe = [](int x) { return static_cast<uint8_t>(x % 4 < 2 ? 60 : 190); };
  std::vector<uint8_t> image;
  for (int i = 0; i < kWidth * kHeight; ++i) image.insert(image.end(), 3, stripe(i % kWidth));
  const BaseMesh base = sheetBase(30, 10, 3, 1);
  // By how much a row of a patch's texels is off: the root mean square.
  auto offBy = [&](const MeshBake& baked, uint32_t p) {
    const size_t side = size_t{128} << baked.textureDepthOf(p);
    std::vector<uint8_t> texels(6 * side * side);
    EXPECT_TRUE(baked.texels(p, texels));
    double squares = 0;
    for (size_t x = 0; x < side; ++x) {
      const double at = column(10 * (p + (static_cast<double>(x) + 0.5) / static_cast<double>(side))) - 0.5,
                   part_of = at - std::floor(at);
      const int left = std::clamp(static_cast<int>(std::floor(at)), 0, kWidth - 1);
      const double expected = stripe(left) * (1 - part_of) + stripe(std::min(left + 1, kWidth - 1)) * part_of;
      const double off = texels[(side / 2) * side + x] - expected;
      squares += off * off;
    }
    return std::sqrt(squares / static_cast<double>(side));
  };
  const auto baked = bake(mesh, base, {.cells_log2 = 5}, {{kWidth, kHeight, image}});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->textureDepth(), 3);
  const std::array<int, 3> depths{0, 1, 3};  // 20, 200 and 804 columns; 100 rows
  for (uint32_t p = 0; p < 3; ++p) {
    EXPECT_EQ(baked->textureDepthOf(p), depths[p]) << p;
    EXPECT_LT(offBy(*baked, p), 12) << p;
  }
  const auto coarse = bake(mesh, base, {.cells_log2 = 5, .texture_depth = 1}, {{kWidth, kHeight, image}});
  ASSERT_TRUE(coarse);
  for (uint32_t p = 0; p < 3; ++p) EXPECT_EQ(coarse->textureDepthOf(p), 1) << "as asked for";
}

TEST(MeshBake, asManyCellsAsTheToleranceTakes) {
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.2 * std::sin(12 * d.x) * std::cos(11 * d.y + 9 * d.z); }, 40);
  const BaseMesh base = sphereBase(10, 2);
  int last = 0;
  for (double tolerance : {0.1, 0.01, 0.002}) {
    if (kSanitized && tolerance < 0.01) continue;
    auto baked = bake(mesh, base, {.tolerance_mm = tolerance});
    ASSERT_TRUE(baked);
    EXPECT_LE(baked->report().deviation_mm, tolerance);
    EXPECT_GT(baked->report().cells_log2, last);
    last = baked->report().cells_log2;
    // Not more than that: one level less does not keep it.
    auto coarser = bake(mesh, base, {.cells_log2 = last - 1, .fit = false});
    EXPECT_GT(coarser->report().deviation_mm, tolerance);
  }
  // Without a tolerance the scan's detail is kept, however small it is beside the whole.
  const TriMesh fine =
      sheetMesh(100, 100, 200, 200, [](double x, double y) { return 1e-3 * std::sin(x) * std::cos(y); });
  const BaseMesh sheet = sheetBase(100, 100, 4, 4);
  EXPECT_GE(2 * bake(fine, sheet, {})->report().samples, fine.positions_mm.size());
  EXPECT_LT(2 * bake(fine, sheet, {.tolerance_mm = 0.014})->report().samples, fine.positions_mm.size());
  if (kSanitized) return;
  // What no grid keeps ends at the bound on samples.
  auto most = bake(mesh, base, {.tolerance_mm = 1e-9});
  EXPECT_LE(most->report().samples, 260 * mesh.positions_mm.size());
  EXPECT_GT(most->report().deviation_mm, 1e-9);
}

// The drawn surface against the scan's own function, at places of its own, in the direction of the heights: root mean
// square and 99.9 %.
struct Deviation {
  double rms = 0, p999 = 0;
};
Deviation deviationOf(const MeshBake& baked, const std::function<double(double, double)>& z, double width) {
  std::mt19937 random(77);
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<double> off;
  double squares = 0;
  const size_t n = side(baked) - 1;
  for (uint32_t p = 0; p < baked.base().patches.size(); ++p) {
    const Heights q = heightsOf(baked, p);
    for (int i = 0; i < 10'000; ++i) {
      const double u = unit(random), v = unit(random), x = u * static_cast<double>(n), y = v * static_cast<double>(n);
      const size_t x0 = static_cast<size_t>(x), y0 = static_cast<size_t>(y);
      const double fx = x - static_cast<double>(x0), fy = y - static_cast<double>(y0);
      const uint16_t* c = q.data() + y0 * (n + 1) + x0;
      const double steps = fx >= fy ? c[0] + fx * (c[1] - c[0]) + fy * (c[n + 2] - c[1])
                                    : c[0] + fy * (c[n + 1] - c[0]) + fx * (c[n + 2] - c[n + 1]);
      const glm::dvec3 at = baked.base().point(p, u, v);
      if (at.x < 0.5 || at.y > -0.5 || at.x > width - 0.5 || at.y < 0.5 - width) continue;
      off.push_back(std::abs(baked.reliefOffsetMm() + baked.reliefScaleMm() * steps - z(at.x, at.y)));
      squares += off.back() * off.back();
    }
  }
  std::nth_element(off.begin(), off.begin() + static_cast<ptrdiff_t>(off.size() * 999 / 1000), off.end());
  return {std::sqrt(squares / static_cast<double>(off.size())), off[off.size() * 999 / 1000]};
}

TEST(MeshBake, fittedHeightsLieCloserBetweenSamples) {
  auto z = [](double x, double y) { return 0.7 * std::sin(0.9 * x) * std::cos(0.7 * y); };
  const TriMesh mesh = sheetMesh(20, 20, 400, 400, z);  // its own chords: 1e-4 off
  const BaseMesh base = sheetBase(20, 20, 2, 2);
  auto plain = bake(mesh, base, {.cells_log2 = 4, .fit = false}), fitted = bake(mesh, base, {.cells_log2 = 4});
  EXPECT_FALSE(plain->report().fitted);
  EXPECT_TRUE(fitted->report().fitted);
  EXPECT_EQ(plain->report().samples, fitted->report().samples);
  const Deviation before = deviationOf(*plain, z, 20), after = deviationOf(*fitted, z, 20);
  EXPECT_LT(after.rms, before.rms / 1.8);
  EXPECT_GT(after.rms, before.rms / 3);  // no more than theory allows: it is the same function that is looked at
}

TEST(MeshBake, patchesHaveAsManyCellsAsTheyNeed) {
  // Waves in one corner of 36 patches, a gentle slope elsewhere.
  auto z = [](double x, double y) {
    const double r = std::hypot(x - 5, y + 5);
    return 0.01 * x +
           (r < 6 ? 0.4 * std::pow(std::cos(0.5 * std::acos(-1.0) * r / 6), 2) * std::sin(4 * x) * std::cos(3 * y)
                  : 0.0);
  };
  const TriMesh mesh = sheetMesh(60, 60, 600, 600, z);
  const BaseMesh base = sheetBase(60, 60, 6, 6);
  constexpr double kTolerance = 0.01;
  auto plain = bake(mesh, base, {.tolerance_mm = kTolerance, .fit = false}),
       own = bake(mesh, base, {.tolerance_mm = kTolerance});
  ASSERT_TRUE(plain && own);
  EXPECT_EQ(own->report().cells_log2, plain->report().cells_log2);
  EXPECT_LT(own->report().samples, plain->report().samples / 4);
  // A tolerance is kept, whatever a patch's cells: of the mesh, whose chords lie up to 0.02 from its function.
  const Deviation before = deviationOf(*plain, z, 60), after = deviationOf(*own, z, 60);
  EXPECT_LE(own->report().deviation_mm, kTolerance);
  EXPECT_LT(after.p999, before.p999 + kTolerance);
  // Neighbours of different cells share their samples.
  const size_t row = side(*own), n = row - 1;
  const auto neighbours = patchNeighbours(base);
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const PatchNeighbour& right = neighbours[p][kRight];
    if (right.patch == PatchNeighbour::kNone) continue;
    const Heights a = heightsOf(*own, p), b = heightsOf(*own, right.patch);
    for (size_t i = 0; i <= n; ++i) ASSERT_EQ(a[i * row + n], b[i * row]);
  }
  // Control: the coarsest grid everywhere does not keep it.
  EXPECT_GT(bake(mesh, base, {.cells_log2 = plain->report().cells_log2 - 1})->report().deviation_mm, kTolerance);
}

TEST(MeshBake, noFitIsMadeFarOff) {
  const TriMesh mesh = sheetMesh(10, 10, 40, 4, [](double x, double) { return x < 5.001 ? 0.0 : 3.0; });
  const BaseMesh base = sheetBase(10, 10, 1, 1);
  auto fitted = bake(mesh, base, {.tolerance_mm = 0.05}),
       near = bake(mesh, base, {.tolerance_mm = 0.05, .fit_within = 1e3}),
       far_off = bake(mesh, base, {.tolerance_mm = 0.05, .fit_within = 0.01});
  ASSERT_TRUE(fitted && near && far_off);
  EXPECT_GT(far_off->report().deviation_mm, 0.01 * 0.05);
  EXPECT_TRUE(far_off->report().far_off);
  EXPECT_FALSE(far_off->report().fitted);
  for (const auto* other : {&fitted, &near}) {
    EXPECT_TRUE((*other)->report().fitted);
    EXPECT_FALSE((*other)->report().far_off);
  }
  EXPECT_EQ(heightsOf(*fitted, 0), heightsOf(*near, 0));
}

TEST(MeshBake, whatCannotBeBakedIsNamed) {
  const TriMesh mesh = sphereMesh(10, 8);
  const BaseMesh base = sphereBase(10, 1);
  auto kind = [](const TriMesh& m, const BaseMesh& b, BakeOptions options) {
    auto made = MeshBake::create(m, {}, b, options);
    EXPECT_FALSE(made);
    return made ? ErrorKind::kRuntime : made.error().kind;
  };
  EXPECT_EQ(kind(mesh, base, {.cells_log2 = 0}), ErrorKind::kUsage);
  EXPECT_EQ(kind(mesh, base, {.cells_log2 = 15}), ErrorKind::kUsage);
  EXPECT_EQ(kind(mesh, base, {.cells_log2 = 3, .texture_depth = 9}), ErrorKind::kUsage);
  EXPECT_EQ(kind(mesh, base, {.cells_log2 = 3, .tolerance_mm = -1}), ErrorKind::kUsage);
  EXPECT_EQ(kind(TriMesh{}, base, {.cells_log2 = 3}), ErrorKind::kInvalidData);
  BaseMesh bad = base;
  bad.corners[0].normal *= 2;
  EXPECT_EQ(kind(mesh, bad, {.cells_log2 = 3}), ErrorKind::kInvalidData);
  std::atomic<bool> interrupted{false};
  BakeOptions options{.cells_log2 = 7, .workers = 2, .interrupted = &interrupted};
  double last = 0;
  options.progress = [&](double done) {
    EXPECT_GE(done, last);
    EXPECT_LE(done, 1);
    last = done;
    if (done > 0.5) interrupted = true;
  };
  EXPECT_EQ(kind(mesh, base, options), ErrorKind::kInterrupted);
  EXPECT_GT(last, 0.5);
  // Several grids are tried: progress still only grows, up to 1.
  options.cells_log2 = -1;
  options.interrupted = nullptr;
  last = 0;
  auto whole = MeshBake::create(sphereMesh(10, 40), {}, base, options);
  ASSERT_TRUE(whole);
  EXPECT_GT(whole->get()->report().cells_log2, 3);
  EXPECT_EQ(last, 1);
}

TEST(MeshBake, texelsStopWhenInterrupted) {
  std::atomic<bool> interrupted{false};
  const TriMesh mesh = sphereMesh(10, 20);
  auto baked = bake(mesh, sphereBase(10, 2), {.cells_log2 = 4, .interrupted = &interrupted});
  ASSERT_TRUE(baked);
  std::vector<uint8_t> texels(6 * (size_t{kPagePx} << baked->textureDepth()) *
                              (size_t{kPagePx} << baked->textureDepth()));
  EXPECT_TRUE(baked->texels(0, texels));
  interrupted = true;
  auto stopped = baked->texels(0, texels);
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
}

// With memory for an eighth of the scan's hierarchies each is built a few times over all, not again and again; what
// comes out is the same.
TEST(MeshBake, littleMemoryIsEnough) {
  TriMesh mesh = starMesh([](const glm::dvec3& d) { return 10 + 0.3 * std::sin(9 * d.x + 4 * d.y); }, 80);
  ASSERT_TRUE(orderTriangles(mesh, 1));
  const BaseMesh base = sphereBase(10, 1);
  constexpr uint32_t kRegion = 300;
  Heights heights[2];
  std::vector<uint8_t> texels[2];
  for (int k = 0; k < 2; ++k) {
    const uint64_t all = mesh.triangles.size() * 64;
    auto scene = makeBakeScene(mesh, {.ray_bytes = k ? all / 8 : all, .region_triangles = kRegion, .workers = 1});
    ASSERT_TRUE(scene);
    const RayScene& rays = *scene->rays;
    auto made = MeshBake::create(mesh, {}, base, {.cells_log2 = 8, .fit = false, .texture_depth = 1, .workers = 1},
                                 std::move(*scene));
    ASSERT_TRUE(made);
    const MeshBake& baked = **made;
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      const Heights here = heightsOf(baked, p);
      heights[k].insert(heights[k].end(), here.begin(), here.end());
      std::vector<uint8_t> out(6 * 256 * 256);
      ASSERT_TRUE(baked.texels(p, out));
      texels[k].insert(texels[k].end(), out.begin(), out.end());
    }
    ASSERT_GT(rays.regions(), 200u);
    printf("%zu regions, %llu builds\n", rays.regions(), static_cast<unsigned long long>(rays.builds()));
    if (k == 0) {
      EXPECT_EQ(rays.builds(), rays.regions());
      continue;
    }
    EXPECT_GT(rays.builds(), rays.regions());
    EXPECT_LT(rays.builds(), 8 * rays.regions());
    // Control: a four-hundredth of the lines, in no order, needs more of them.
    const uint64_t before = rays.builds();
    std::mt19937 random(5);
    std::uniform_real_distribution<double> in(0, 1);
    for (int i = 0; i < 2000; ++i) {
      const auto p = static_cast<uint32_t>(random() % base.patches.size());
      const double u = in(random), v = in(random);
      EXPECT_TRUE(rays.nearestOnLine({base.point(p, u, v), base.normal(p, u, v), 20, 4}, Facing::kAlong));
    }
    printf("%llu builds for 2,000 lines in no order\n", static_cast<unsigned long long>(rays.builds() - before));
    EXPECT_GT(rays.builds() - before, before);
  }
  EXPECT_EQ(heights[0], heights[1]);
  EXPECT_EQ(texels[0], texels[1]);
}

TEST(MeshBake, patchesAreReadByManyThreadsAtOnce) {
  TriMesh mesh = starMesh([](const glm::dvec3& d) { return 10 + 0.3 * std::sin(9 * d.x + 4 * d.y); }, 30);
  for (const glm::vec3& p : mesh.positions_mm) mesh.colours.push_back(glm::u8vec3(128.0f + 10.0f * p));
  auto baked = bake(mesh, sphereBase(10, 2), {.cells_log2 = 5});
  ASSERT_TRUE(baked);
  const size_t patches = baked->base().patches.size();
  std::vector<std::vector<uint8_t>> one(patches), many(patches);
  auto read = [&](size_t p, std::vector<uint8_t>& out) {
    out.resize(6 * 128 * 128);
    EXPECT_TRUE(baked->texels(static_cast<uint32_t>(p), out));
  };
  for (size_t p = 0; p < patches; ++p) read(p, one[p]);
  parallelFor(patches, 4, nullptr, [&](size_t p) { read(p, many[p]); });
  EXPECT_TRUE(one == many);
}

TEST(MeshBake, aThinReliefOnABigPanel) {
  // 10 um on 10 m, far from the scan's origin: vertices under samples, exact in z.
  auto z = [](double x, double y) { return 0.005 * std::sin(0.01 * x) * std::cos(0.013 * y); };
  TriMesh mesh = sheetMesh(8192, 8192, 128, 128, z);
  mesh.origin_mm = {1e7, 1e7, -1e7};
  BaseMesh base = sheetBase(8192, 8192, 2, 2);
  base.origin_mm = mesh.origin_mm;
  auto baked = bake(mesh, base, {.cells_log2 = 6, .fit = false});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->report().by_closest_point, 0u);
  EXPECT_LT(baked->reliefScaleMm() * 65535, 0.011);
  for (uint32_t p = 0; p < 4; ++p) {
    const Heights q = heightsOf(*baked, p);
    for (size_t y = 0; y <= 128; y += 2) {
      for (size_t x = 0; x <= 128; x += 2) {
        const double px = 4096.0 * (p % 2) + 32.0 * static_cast<double>(x),
                     py = -4096.0 * (p / 2) - 32.0 * static_cast<double>(y);
        ASSERT_NEAR(baked->reliefOffsetMm() + baked->reliefScaleMm() * q[y * 129 + x], z(px, py),
                    0.51 * baked->reliefScaleMm());
      }
    }
    EXPECT_LT(baked->errorOfGrid(p, 0), 0.011f);
    EXPECT_GT(baked->errorOfGrid(p, 0), 0.0f);
  }
}

TEST(MeshBake, degenerateBasesGiveNumbers) {
  TriMesh one;
  one.positions_mm = {{0, 0, 0}, {1, 0, 0}, {0, -1, 0}};
  one.triangles = {{0, 2, 1}};
  const TriMesh sphere = sphereMesh(10, kSanitized ? 4 : 10);
  BaseMesh collapsed = sheetBase(1, 1, 2, 2);
  for (uint32_t c : {0u, 1u, 3u, 4u}) collapsed.corners[c].position_mm = {0.5f, -0.5f, 0};  // a patch without size
  BaseMesh needles = sheetBase(10'000, 1, 1, 4);
  BaseMesh opposed = sheetBase(1, 1, 1, 1);  // normals that cancel in the middle
  opposed.corners[0].normal = opposed.corners[3].normal = {0, 0, -1};
  for (const TriMesh* mesh : std::array<const TriMesh*, 2>{&one, &sphere}) {
    for (const BaseMesh* base : {&collapsed, &needles, &opposed}) {
      ASSERT_EQ(baseMeshProblem(*base), "");
      for (int cells_log2 : {1, 5, -1}) {
        if (kSanitized && cells_log2 == 5) continue;
        auto baked = bake(*mesh, *base, {.cells_log2 = cells_log2});
        ASSERT_TRUE(baked);
        EXPECT_TRUE(std::isfinite(baked->reliefOffsetMm()) && std::isfinite(baked->reliefScaleMm()) &&
                    std::isfinite(baked->report().deviation_mm));
        EXPECT_TRUE(std::isfinite(baked->errorUnitMm()) && baked->errorUnitMm() > 0);
        std::vector<uint8_t> texels(6 * (size_t{128} << baked->textureDepth()) *
                                    (size_t{128} << baked->textureDepth()));
        for (uint32_t p = 0; p < base->patches.size(); ++p) {
          for (int log2 = 0; log2 <= 7; ++log2) EXPECT_TRUE(std::isfinite(baked->errorOfGrid(p, log2)));
          EXPECT_TRUE(baked->texels(p, texels));
        }
      }
    }
  }
}

// Colours that whole triangles have meet without a mix of them, and where they do on the scan, though texels are
// interpolated from a coarser grid.
TEST(MeshBake, paletteColoursDoNotMix) {
  constexpr double kBorder = 4.5;  // between two of the samples that texels are interpolated from
  constexpr size_t kTexels = 512, kPlane = kTexels * kTexels;
  TriMesh mesh = sheetMesh(10, 10, 20, 20, [](double x, double) { return 0.1 * std::sin(x); });
  for (const auto& t : mesh.triangles) {
    const float middle = (mesh.positions_mm[t[0]].x + mesh.positions_mm[t[1]].x + mesh.positions_mm[t[2]].x) / 3;
    mesh.corner_uv.push_back({});
    mesh.corner_uv.back().fill(glm::vec2(middle < kBorder ? 0.25f : 0.75f, 0.5f));
  }
  const std::vector<uint8_t> colours{200, 40, 0, 20, 220, 0};
  // Between red and green, and texels of the wrong one.
  auto count = [&](const TriMesh& scan, const std::vector<MeshBake::Image>& images) {
    std::array<size_t, 2> mixed_wrong{};
    auto baked = bake(scan, sheetBase(10, 10, 1, 1), {.cells_log2 = 4, .texture_depth = 2}, images);
    std::vector<uint8_t> out(6 * kPlane);
    EXPECT_TRUE(baked && baked->texels(0, out));
    for (size_t i = 0; i < kPlane; ++i) {
      const bool red = std::abs(out[i] - 200) <= 1, green = std::abs(out[i] - 20) <= 1;
      mixed_wrong[0] += !red && !green;
      const double x = 10 * (static_cast<double>(i % kTexels) + 0.5) / kTexels;
      if (std::abs(x - kBorder) > 10.0 / kTexels) mixed_wrong[1] += x < kBorder ? !red : !green;
    }
    return mixed_wrong;
  };
  const MeshBake::Image image{.width = 2, .height = 1, .texels = colours, .palette = true};
  EXPECT_EQ(count(mesh, {image}), (std::array<size_t, 2>{0, 0}));
  // Beside an image, which no triangle of the patch shows, too.
  TriMesh second = mesh;
  second.image_of.assign(mesh.triangles.size(), 1);
  EXPECT_EQ(count(second, {{.width = 1, .height = 2, .texels = colours}, image}), (std::array<size_t, 2>{0, 0}));
  // Control: vertices' colours are interpolated from the same grid.
  TriMesh control = mesh;
  control.corner_uv.clear();
  for (const glm::vec3& p : control.positions_mm)
    control.colours.push_back(p.x < kBorder ? glm::u8vec3(200, 40, 0) : glm::u8vec3(20, 220, 0));
  const auto control_counts = count(control, {});
  EXPECT_GT(control_counts[0], kTexels);
  EXPECT_GT(control_counts[1], kTexels);
}

// Of several images each triangle shows its own, at its own place; some show none, and have their vertices' colours.
TEST(MeshBake, trianglesShowTheirOwnImages) {
  TriMesh mesh = sheetMesh(30, 10, 30, 10, [](double, double) { return 0.0; });
  for (const auto& t : mesh.triangles) {
    const float middle = (mesh.positions_mm[t[0]].x + mesh.positions_mm[t[1]].x + mesh.positions_mm[t[2]].x) / 3;
    const auto third = static_cast<uint16_t>(middle / 10);
    mesh.image_of.push_back(third == 2 ? kNoImage : third);
    auto& uv = mesh.corner_uv.emplace_back();
    for (size_t k = 0; k < 3; ++k) uv[k] = {mesh.positions_mm[t[k]].x / 10 - third, 1 + mesh.positions_mm[t[k]].y / 10};
  }
  mesh.colours.assign(mesh.positions_mm.size(), {10, 20, 30});
  // The first gets brighter to the right, the second, which is finer, downwards.
  std::vector<uint8_t> right, down;
  for (int i = 0; i < 64 * 64; ++i) right.insert(right.end(), 3, static_cast<uint8_t>(4 * (i % 64)));
  for (int i = 0; i < 256 * 256; ++i) down.insert(down.end(), 3, static_cast<uint8_t>(i / 256));
  const auto baked = bake(mesh, sheetBase(30, 10, 3, 1), {.cells_log2 = 5}, {{64, 64, right}, {256, 256, down}});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->textureDepthOf(0), 0);
  EXPECT_EQ(baked->textureDepthOf(1), 1);
  for (uint32_t p = 0; p < 3; ++p) {
    const size_t side = size_t{128} << baked->textureDepthOf(p);
    std::vector<uint8_t> texels(6 * side * side);
    ASSERT_TRUE(baked->texels(p, texels));
    for (size_t y = 0; y < side; ++y)
      for (size_t x = 2; x + 2 < side; ++x) {
        const double u = (static_cast<double>(x) + 0.5) / static_cast<double>(side),
                     v = (static_cast<double>(y) + 0.5) / static_cast<double>(side);
        const double expected = p == 0   ? 4 * std::clamp(64 * u - 0.5, 0.0, 63.0)
                                : p == 1 ? std::clamp(256 * v - 0.5, 0.0, 255.0)
                                         : 10;
        ASSERT_NEAR(texels[y * side + x], expected, 1.5) << p << " " << x << " " << y;
      }
  }
  // One image that a triangle names and that is not there.
  auto fewer = MeshBake::create(mesh, std::vector<MeshBake::Image>{{64, 64, right}}, sheetBase(30, 10, 3, 1), {});
  ASSERT_FALSE(fewer);
  EXPECT_EQ(fewer.error().kind, ErrorKind::kUsage);
}

// Patches with few of an image's texels have a tail's alone, where their normals need no more.
TEST(MeshBake, fewTexelsOfAnImageAreATails) {
  auto sheet = [](int nx, int ny, double slope) {
    TriMesh mesh = sheetMesh(30, 10, nx, ny, [&](double x, double) { return slope * std::max(x - 15, 0.0); });
    for (const auto& t : mesh.triangles) {
      auto& uv = mesh.corner_uv.emplace_back();
      for (size_t k = 0; k < 3; ++k) uv[k] = {mesh.positions_mm[t[k]].x / 30, 1 + mesh.positions_mm[t[k]].y / 10};
    }
    return mesh;
  };
  std::vector<uint8_t> image;
  for (int i = 0; i < 36 * 12; ++i)
    image.insert(image.end(), {static_cast<uint8_t>(7 * (i % 36)), static_cast<uint8_t>(20 * (i / 36)), 9});
  auto depths = [&](const TriMesh& mesh, const BaseMesh& base, int width, bool tails) {
    BakeOptions options{.cells_log2 = 3, .fit = false};
    options.tail_textures = tails;
    const std::vector<uint8_t> texels(image.begin(), image.begin() + static_cast<std::ptrdiff_t>(3 * 12 * width));
    const auto baked = bake(mesh, base, options, {{width, 12, width == 36 ? image : texels}});
    std::vector<int> out;
    for (uint32_t p = 0; p < base.patches.size(); ++p) out.push_back(baked->textureDepthOf(p));
    EXPECT_EQ(baked->textureDepth(), 0);
    return out;
  };
  using Depths = std::vector<int>;
  constexpr int kTail = kNoTexturePage;
  const BaseMesh base = sheetBase(30, 10, 3, 1);
  EXPECT_EQ(depths(sheet(6, 2, 0), base, 36, true), (Depths{kTail, kTail, kTail}));
  EXPECT_EQ(depths(sheet(6, 2, 0), base, 36, false), (Depths{0, 0, 0})) << "unless it is allowed";
  EXPECT_EQ(depths(sheet(30, 10, 0), base, 36, true), (Depths{0, 0, 0})) << "normals may need more";
  const BaseMesh rows = sheetBase(30, 10, 3, 2);
  EXPECT_EQ(depths(sheet(6, 8, 0), rows, 36, true), Depths(6, kTail));
  EXPECT_EQ(depths(sheet(6, 8, 1), rows, 36, true), (Depths{kTail, 0, kTail, kTail, 0, kTail})) << "a crease does";
  // Its texels are the image's at their centres.
  BakeOptions options{.cells_log2 = 3, .fit = false};
  options.tail_textures = true;
  const TriMesh coarse = sheet(6, 2, 0);
  const auto baked = bake(coarse, base, options, {{36, 12, image}});
  ASSERT_TRUE(baked);
  constexpr size_t kSide = kTailTexels;
  std::vector<uint8_t> texels(6 * kSide * kSide);
  for (uint32_t p = 0; p < 3; ++p) {
    ASSERT_TRUE(baked->texels(p, texels));
    for (size_t i = 0; i < kSide * kSide; ++i) {
      const double x = std::clamp(12 * (p + (static_cast<double>(i % kSide) + 0.5) / kSide) - 0.5, 0.0, 35.0),
                   y = std::clamp(12 * (static_cast<double>(i / kSide) + 0.5) / kSide - 0.5, 0.0, 11.0);
      ASSERT_NEAR(texels[i], 7 * x, 1.01) << p << " " << i;
      ASSERT_NEAR(texels[kSide * kSide + i], 20 * y, 1.01) << p << " " << i;
      ASSERT_EQ(texels[5 * kSide * kSide + i], 255) << "facing up";
    }
  }
}

// A scan that is its own base, and shows an image over and over: patches show it themselves, each half affinely.
TEST(MeshBake, repeatedImagesAreShownByOwnTriangles) {
  constexpr double kTimesX = 40, kTimesY = 30;
  TriMesh mesh = sheetMesh(30, 10, 7, 5, [](double x, double) { return 0.5 * std::max(x - 15, 0.0); });
  for (const auto& t : mesh.triangles) {
    auto& uv = mesh.corner_uv.emplace_back();
    for (size_t k = 0; k < 3; ++k)
      uv[k] = {kTimesX / 30 * mesh.positions_mm[t[k]].x, kTimesY / 10 * mesh.positions_mm[t[k]].y};
  }
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 1000);
  base.cut = true;
  const std::vector<uint8_t> texels(3 * 64 * 64, 100);
  const MeshBake::Image image{.width = 64, .height = 64, .texels = texels, .repeats = true};
  BakeOptions options{.cells_log2 = 3, .fit = false, .touch_mm = 1e-4};
  options.tail_textures = options.show_images = true;
  const auto baked = bake(mesh, base, options, {image});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->shownImages(), std::vector<bool>{true});
  int deepest = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = baked->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p << ": those of one triangle, too";
    EXPECT_EQ(baked->textureDepthOf(p), kNoTexturePage);
    deepest = std::max(deepest, on->depth);
    for (size_t half = 0; half < 2; ++half)
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec3 at(
            base.corners[base.patches[p][std::array{size_t{0}, half ? size_t{2} : size_t{1}, size_t{3}}[k]]]
                .position_mm);
        EXPECT_NEAR(on->uv[half][k].x, kTimesX / 30 * at.x, 1e-4);
        EXPECT_NEAR(on->uv[half][k].y, kTimesY / 10 * at.y, 1e-4);
        EXPECT_NEAR(glm::length(on->normal[half][k]), 1, 1e-5);
        if (std::abs(at.x - 15) < 5) continue;  // a crease
        EXPECT_NEAR(on->normal[half][k].z, at.x < 15 ? 1 : 1 / std::hypot(1, 0.5), 1e-3);
      }
  }
  EXPECT_TRUE(baked->isEven()) << "the base is the scan";
  EXPECT_EQ(baked->textureDepth(), deepest);
  EXPECT_EQ(deepest, 2) << "6 x 6 images of 64 texels, at most 1.42 a texel";
  // Not where it is not asked for, where there are texels for it, or where patches are other than the triangles.
  options.show_images = false;
  EXPECT_FALSE(bake(mesh, base, options, {image})->imagesOn(0));
  options.show_images = true, options.texture_depth = 0;
  EXPECT_FALSE(bake(mesh, base, options, {image})->imagesOn(0));
  options.texture_depth = -1, options.touch_mm = 0;
  EXPECT_FALSE(bake(mesh, base, options, {image})->imagesOn(0));
  options.touch_mm = 1e-4;
  const std::vector<uint8_t> many(3 * 2048 * 2048, 100);
  TriMesh once = mesh;
  for (auto& uv : once.corner_uv)
    for (auto& corner : uv) corner *= glm::vec2(1 / kTimesX, 1 / kTimesY);
  MeshBake::Image large{.width = 2048, .height = 1024, .texels = std::span(many).first(3 * 2048 * 1024)};
  EXPECT_FALSE(bake(once, base, options, {large})->imagesOn(0)) << "as many texels as the image has";
  large.has_file = true;
  EXPECT_TRUE(bake(once, base, options, {large})->imagesOn(0)) << "but a file of fewer bytes";
  large.has_file = false;
  // Tails show all of a small one: 35 x 16 x 16 texels.
  const std::vector<uint8_t> small(3 * 80 * 80, 100);
  EXPECT_EQ(bake(once, base, options, {{.width = 80, .height = 80, .texels = small}})->shownImages(),
            std::vector<bool>{false});
  const auto in_tails = bake(once, base, options, {{.width = 64, .height = 64, .texels = texels}});
  ASSERT_TRUE(in_tails->imagesOn(0));
  EXPECT_EQ(in_tails->imagesOn(0)->depth, kNoTexturePage);
  // Patches of which a half shows one that is not repeated show neither.
  TriMesh two = mesh;
  for (size_t t = 0; t < two.triangles.size(); ++t) {
    two.image_of.push_back(t % 2);
    if (t % 2) two.corner_uv[t] = once.corner_uv[t];
  }
  large.height = 2048, large.texels = many;
  const auto halves = bake(two, base, options, {image, large});
  size_t shown = 0, single = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = halves->imagesOn(p);
    shown += on.has_value();
    single += on && on->image[0] == 0 && on->image[1] == 0;
  }
  EXPECT_EQ(shown, single);
  EXPECT_EQ(halves->shownImages(), (std::vector<bool>{shown > 0, false})) << "nor is one kept that no patch shows";
  // Of an atlas of many triangles patches would have a page each.
  for (auto& uv : once.corner_uv)
    for (auto& corner : uv) corner *= 0.9f;
  const std::vector<uint8_t> atlas(3 * 256 * 256, 100);
  EXPECT_TRUE(bake(once, base, options, {{.width = 256, .height = 256, .texels = atlas}})->imagesOn(0));
}

// A base that lies on the scan everywhere, within what it may be off: lines are not asked for heights, and what is
// drawn are its own triangles, which is what is measured. Controls: where that is too far off, where one triangle is,
// or where patches are not cut, there are heights.
TEST(MeshBake, ownTrianglesAreFlat) {
  constexpr float kOff = 0.003f;
  const TriMesh mesh = sheetMesh(30, 10, 6, 4, [](double, double) { return 0.0; });
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 1000);
  for (BaseCorner& corner : base.corners) corner.position_mm.z += kOff;
  BakeOptions options{.touch_mm = 2 * kOff};
  auto rms = [&](const MeshBake& baked) {
    const auto found = measureFidelity(FidelityScan(mesh, 0), baked, FidelityTarget::of(diagonalOf(mesh)));
    EXPECT_TRUE(found.ok());
    return std::array{found->to_drawn.rms_mm, found->to_scan.rms_mm};
  };
  const auto flat = bake(mesh, base, options);
  ASSERT_TRUE(flat);
  EXPECT_TRUE(flat->isFlat());
  EXPECT_TRUE(flat->isEven());
  EXPECT_EQ(flat->report().limit, BakeLimit::kNone);
  EXPECT_EQ(flat->report().by_closest_point, 0u);
  for (const double way : rms(*flat)) EXPECT_NEAR(way, kOff, 1e-5);
  for (uint32_t p = 0; p < base.patches.size(); ++p)
    for (int log2 = 0; log2 <= kPageCellsLog2; ++log2) EXPECT_EQ(flat->errorOfGrid(p, log2), 0) << p << ", " << log2;

  options.touch_mm = kOff / 2;
  const auto near = bake(mesh, base, options);
  ASSERT_TRUE(near);
  EXPECT_FALSE(near->isFlat());
  for (const double way : rms(*near)) EXPECT_LT(way, 1e-5) << "heights lead to the scan";
  options.touch_mm = 2 * kOff;
  BaseMesh moved = base;
  moved.corners[moved.patches[5][0]].position_mm.z += 4 * kOff;
  EXPECT_FALSE(bake(mesh, moved, options)->isFlat());
  BaseMesh whole = base;
  whole.cut = false;
  EXPECT_FALSE(bake(mesh, whole, options)->isFlat());
}

// A scan of one colour that is its own base needs no texels: its patches show the colour, and have the triangles'
// normals. Neither does one of several: where two meet, or a crease runs, pages follow from them.
TEST(MeshBake, plainColoursAreShownByOwnTriangles) {
  const TriMesh mesh = sheetMesh(30, 10, 6, 4, [](double x, double) { return std::max(x - 15, 0.0); });
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 1000);
  base.cut = true;
  const std::vector<uint8_t> colours{10, 20, 30, 200, 100, 50};
  const MeshBake::Image one{.width = 1, .height = 1, .texels = std::span(colours).first(3), .palette = true};
  BakeOptions options{.cells_log2 = 3, .fit = false, .touch_mm = 1e-4};
  options.tail_textures = options.show_images = true;
  const auto baked = bake(mesh, base, options, {one});
  ASSERT_TRUE(baked);
  EXPECT_EQ(baked->shownImages(), std::vector<bool>{true}) << "without any texture coordinates";
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = baked->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    EXPECT_EQ(on->depth, kNoTexturePage);
    for (size_t half = 0; half < 2; ++half)
      for (const glm::dvec2& uv : on->uv[half]) EXPECT_EQ(uv, glm::dvec2(0));
    EXPECT_EQ(baked->textureDepthOf(p), kNoTexturePage);
  }
  // Controls: not unless it is asked for, nor with other patches, nor without such an image; the texels have the
  // colour.
  options.show_images = false;
  const auto stored = bake(mesh, base, options, {one});
  EXPECT_FALSE(stored->imagesOn(0));
  std::vector<uint8_t> texels(6 * kTailTexels * kTailTexels);
  ASSERT_EQ(stored->textureDepthOf(0), kNoTexturePage);
  ASSERT_TRUE(stored->texels(0, texels));
  for (size_t c = 0; c < 3; ++c) EXPECT_EQ(texels[c * kTailTexels * kTailTexels + 7], colours[c]);
  options.show_images = true;
  EXPECT_FALSE(bake(mesh, base, options)->imagesOn(0)) << "grey, and nobody has an image of it";
  const auto even = bake(mesh, sheetBase(30, 10, 3, 2), options, {one});
  for (uint32_t p = 0; p < 6; ++p) EXPECT_FALSE(even->imagesOn(p));
  // Two colours: halves that differ have a page.
  TriMesh painted = mesh;
  for (size_t t = 0; t < painted.triangles.size(); ++t)
    painted.corner_uv.emplace_back().fill({t % 2 ? 0.75f : 0.25f, 0.5f});
  const MeshBake::Image palette{.width = 2, .height = 1, .texels = colours, .palette = true};
  const auto two = bake(painted, base, options, {palette});
  size_t with_page = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = two->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    EXPECT_EQ(on->depth, on->uv[0][0] == on->uv[1][0] ? kNoTexturePage : 0) << p;
    with_page += on->depth == 0;
  }
  EXPECT_GT(with_page, 0u);
  // A patch of the two triangles at a crease, or where there is none.
  for (const bool folded : {false, true}) {
    const TriMesh roof =
        sheetMesh(30, 10, 6, 8, [&](double x, double) { return folded ? std::max(x - 15, 0.0) : 0.0; });
    auto at = [&](uint32_t v) { return roof.positions_mm[v]; };
    BaseMesh pair;
    pair.cut = true;
    std::array<uint32_t, 4> corners{};
    for (const auto& t : roof.triangles)
      for (size_t k = 0; k < 3; ++k) {
        const uint32_t p = t[k], s = t[(k + 1) % 3], q = t[(k + 2) % 3];
        if (at(p).x != 15 || at(s).x != 15 || std::min(at(p).y, at(s).y) != -5) continue;
        if (at(q).x > 15) corners[0] = p, corners[3] = s, corners[1] = q;
        else corners[2] = q;
      }
    for (const uint32_t v : corners) pair.corners.push_back({at(v), {0, 0, 1}});
    pair.patches = {{0, 1, 2, 3}};
    const auto on = bake(roof, pair, options, {one})->imagesOn(0);
    ASSERT_TRUE(on.has_value());
    EXPECT_EQ(on->depth, folded ? 0 : kNoTexturePage);
  }
}

BaseMesh ownTriangles(const TriMesh& mesh) {
  BaseMesh base = facesBase(*makeSurface(mesh.positions_mm, mesh.triangles), 1000);
  base.cut = true;
  return base;
}
BakeOptions showingImages() {
  BakeOptions options{.cells_log2 = 3, .fit = false, .touch_mm = 1e-4};
  options.tail_textures = options.show_images = true;
  return options;
}

// Colours of vertices are those of patches' corners, linear between them as on the triangles.
TEST(MeshBake, verticesColoursAreShownByOwnTriangles) {
  TriMesh mesh = sheetMesh(30, 10, 6, 4, [](double, double) { return 0.0; });
  auto colourAt = [](const glm::vec3& p) {
    return glm::u8vec3(glm::round(glm::vec3(120 + 6 * p.x, 90 - 11 * p.y, 30 + 0.4f * p.x * p.x)));
  };
  for (const glm::vec3& p : mesh.positions_mm) mesh.colours.push_back(colourAt(p));
  const BaseMesh base = ownTriangles(mesh);
  BakeOptions options = showingImages();
  const auto baked = bake(mesh, base, options);
  ASSERT_TRUE(baked);
  EXPECT_TRUE(baked->showsImages());
  float furthest = 0, control = 0;
  size_t vertices = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = baked->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    EXPECT_EQ(on->depth, kNoTexturePage) << "there is no border between the halves";
    for (size_t half = 0; half < 2; ++half) {
      EXPECT_EQ(on->image[half], kNoImage);
      for (size_t k = 0; k < 3; ++k) {
        const std::array<size_t, 3> of_half{0, half == 0 ? size_t{1} : size_t{2}, 3};
        const glm::vec3 at = base.corners[base.patches[p][of_half[k]]].position_mm;
        if (std::find(mesh.positions_mm.begin(), mesh.positions_mm.end(), at) == mesh.positions_mm.end())
          continue;  // the middle of a side
        ++vertices;
        furthest = std::max(furthest, glm::distance(on->colour[half][k], glm::vec3(colourAt(at))));
        control = std::max(control, glm::distance(on->colour[half][k], glm::vec3(colourAt(-at))));
      }
    }
  }
  EXPECT_GT(vertices, 6 * base.patches.size() / 2);
  EXPECT_LT(furthest, 0.01f);
  EXPECT_GT(control, 50.0f) << "control: those of other vertices";
  // Controls: texels have them where patches may not show them, and of a scan without colours there is nothing to show.
  options.show_images = false;
  const auto stored = bake(mesh, base, options);
  EXPECT_FALSE(stored->imagesOn(0));
  EXPECT_FALSE(stored->showsImages());
  options.show_images = true;
  mesh.colours.clear();
  EXPECT_FALSE(bake(mesh, base, options)->showsImages());
}

// Beside triangles that show an image, which a patch shows on one half; and where vertices that lie at one place have
// two colours, a page shows the border between them.
TEST(MeshBake, verticesColoursAreShownBesideImages) {
  TriMesh mesh = sheetMesh(30, 10, 6, 4, [](double, double) { return 0.0; });
  mesh.colours.assign(mesh.positions_mm.size(), glm::u8vec3(9, 99, 199));
  const BaseMesh base = ownTriangles(mesh);
  BakeOptions options = showingImages();
  TriMesh beside = mesh;
  const std::vector<uint8_t> texels(3 * 32 * 32, 100);
  for (size_t t = 0; t < beside.triangles.size(); ++t) {
    beside.image_of.push_back(t % 2 ? kNoImage : uint16_t{0});
    beside.corner_uv.emplace_back() = {glm::vec2(0, 0), glm::vec2(8, 0), glm::vec2(0, 8)};
  }
  const auto baked = bake(beside, base, options, {{.width = 32, .height = 32, .texels = texels, .repeats = true}});
  size_t mixed = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = baked->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    const bool first = on->image[0] == kNoImage, second = on->image[1] == kNoImage;
    mixed += first != second;
    if (first != second) {
      EXPECT_GE(on->depth, 0) << "a border runs through it";
      for (const glm::vec3& colour : on->colour[first ? 0 : 1])
        EXPECT_LT(glm::distance(colour, glm::vec3(9, 99, 199)), 0.01f);
    }
  }
  EXPECT_GT(mixed, 0u);
  // Each triangle has vertices of its own.
  TriMesh facets;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    for (const uint32_t v : mesh.triangles[t]) {
      facets.positions_mm.push_back(mesh.positions_mm[v]);
      facets.colours.push_back(t % 2 ? glm::u8vec3(250, 20, 20) : glm::u8vec3(20, 20, 250));
    }
    const auto first = static_cast<uint32_t>(3 * t);
    facets.triangles.push_back({first, first + 1, first + 2});
  }
  const auto faceted = bake(facets, base, options);
  size_t with_page = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto on = faceted->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    const bool differ = glm::distance(on->colour[0][0], on->colour[1][0]) > 100;
    EXPECT_EQ(on->depth, differ ? 0 : kNoTexturePage) << p;
    with_page += differ;
  }
  EXPECT_GT(with_page, 0u);
}

// Sheets that overlap, cut along other diagonals: each patch has the triangles that it was made of.
TEST(MeshBake, ownTrianglesAreFoundWhereOthersLieOnThem) {
  TriMesh mesh;
  mesh.positions_mm = {{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {10, 10, 0}, {-3, -3, 0}, {6, -3, 0}, {-3, 6, 0}, {6, 6, 0}};
  mesh.triangles = {{0, 1, 3}, {0, 3, 2}, {4, 5, 6}, {5, 7, 6}};
  mesh.image_of = {0, 0, 1, 1};
  for (const auto& t : mesh.triangles) {
    auto& uv = mesh.corner_uv.emplace_back();
    for (size_t k = 0; k < 3; ++k) uv[k] = glm::vec2(mesh.positions_mm[t[k]]);
  }
  auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
  ASSERT_TRUE(surface.ok());
  BaseMesh base = facesBase(*surface, 100);
  base.cut = true;
  ASSERT_EQ(base.patches.size(), 2u);
  const std::vector<uint8_t> texels(3 * 32 * 32, 100);
  const MeshBake::Image image{.width = 32, .height = 32, .texels = texels, .repeats = true};
  BakeOptions options{.cells_log2 = 3, .fit = false, .touch_mm = 1e-4};
  options.tail_textures = options.show_images = true;
  const auto baked = bake(mesh, base, options, {image, image});
  ASSERT_TRUE(baked);
  for (uint32_t p = 0; p < 2; ++p) {
    const auto on = baked->imagesOn(p);
    ASSERT_TRUE(on.has_value()) << p;
    const uint16_t own =
        base.corners[base.patches[p][0]].position_mm.x == 0 || base.corners[base.patches[p][0]].position_mm.x == 10 ? 0
                                                                                                                    : 1;
    EXPECT_EQ(on->image, (std::array<uint16_t, 2>{own, own}));
  }
}

// Without an image it is the crease, the border between two plain colours, or many triangles that ask for a page.
TEST(MeshBake, smoothPatchesOfOneColourAreTails) {
  using Depths = std::vector<int>;
  constexpr int kTail = kNoTexturePage;
  const BaseMesh rows = sheetBase(30, 10, 3, 2);
  auto sheet = [](int nx, int ny, double slope) {
    return sheetMesh(30, 10, nx, ny, [&](double x, double) { return slope * std::max(x - 15, 0.0); });
  };
  auto depths = [&](const TriMesh& mesh, bool tails, const std::vector<MeshBake::Image>& images = {}) {
    BakeOptions options{.cells_log2 = 3, .fit = false};
    options.tail_textures = tails;
    const auto baked = bake(mesh, rows, options, images);
    Depths out;
    for (uint32_t p = 0; p < rows.patches.size(); ++p) out.push_back(baked->textureDepthOf(p));
    return out;
  };
  EXPECT_EQ(depths(sheet(6, 8, 0), true), Depths(6, kTail));
  EXPECT_EQ(depths(sheet(6, 8, 0), false), Depths(6, 0)) << "unless it is allowed";
  EXPECT_EQ(depths(sheet(6, 8, 1), true), (Depths{kTail, 0, kTail, kTail, 0, kTail}));
  EXPECT_EQ(depths(sheet(120, 40, 0), true), Depths(6, 0)) << "normals may need more";
  // Two colours that meet at x = 15, in the middle patches; then at x = 10, between two.
  const std::vector<uint8_t> colours{250, 0, 0, 0, 0, 250};
  const MeshBake::Image palette{.width = 2, .height = 1, .texels = colours, .palette = true};
  for (const auto& [border, expected] :
       {std::pair{15.0f, Depths{kTail, 0, kTail, kTail, 0, kTail}}, {10.0f, Depths(6, kTail)}}) {
    TriMesh mesh = sheet(6, 8, 0);
    for (const auto& t : mesh.triangles) {
      const float middle = (mesh.positions_mm[t[0]].x + mesh.positions_mm[t[1]].x + mesh.positions_mm[t[2]].x) / 3;
      mesh.corner_uv.emplace_back().fill({middle < border ? 0.25f : 0.75f, 0.5f});
    }
    EXPECT_EQ(depths(mesh, true, {palette}), expected) << border;
  }
}

}  // namespace mesh_bake_test
}  // namespace relievo
