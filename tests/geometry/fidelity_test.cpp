// What is promised of a bake is kept, measured without anything of the product's: closest points in double precision,
// triangle by triangle (Ericson 2005), from the scan to what is drawn and back.
#include "geometry/bake/fidelity.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "geometry/bake/mesh_distance.h"
#include "geometry/remesh/base_domain.h"
#include "tests/geometry/base_shapes.h"
#include "tests/geometry/scan_shapes.h"
#include "tests/view_share.h"

namespace relievo {
namespace fidelity_test {

constexpr double kPi = std::numbers::pi;

double squaredDistance(const glm::dvec3& p, const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  auto toSegment = [&](const glm::dvec3& from, const glm::dvec3& to) {
    const glm::dvec3 d = to - from;
    const double t = std::clamp(glm::dot(p - from, d) / std::max(glm::dot(d, d), 1e-300), 0.0, 1.0);
    return glm::dot(p - from - t * d, p - from - t * d);
  };
  const glm::dvec3 n = glm::cross(b - a, c - a);
  const double nn = glm::dot(n, n);
  if (nn > 0 && glm::dot(glm::cross(b - a, p - a), n) >= 0 && glm::dot(glm::cross(c - b, p - b), n) >= 0 &&
      glm::dot(glm::cross(a - c, p - c), n) >= 0) {
    const double along = glm::dot(p - a, n);
    return along * along / nn;
  }
  return std::min({toSegment(a, b), toSegment(b, c), toSegment(c, a)});
}

// All triangles, one after the other, but for those whose ball, or whose neighbours' ball, is farther than the nearest
// one so far.
class Triangles {
 public:
  explicit Triangles(const TriMesh& mesh) : mesh_(mesh) {
    for (size_t t = 0; t < mesh.triangles.size(); ++t) {
      const glm::dvec3 a = corner(t, 0), b = corner(t, 1), c = corner(t, 2), centre = (a + b + c) / 3.0;
      balls_.push_back({centre, std::max({glm::length(a - centre), glm::length(b - centre), glm::length(c - centre)})});
    }
    for (size_t first = 0; first < balls_.size(); first += kGroup) {
      Ball group{balls_[first].centre, 0};
      for (size_t t = first; t < std::min(first + kGroup, balls_.size()); ++t)
        group.radius = std::max(group.radius, glm::length(balls_[t].centre - group.centre) + balls_[t].radius);
      groups_.push_back(group);
    }
  }
  double squaredDistanceTo(const glm::dvec3& p) const {
    double best = 1e300, reach = 1e150;
    const auto beyond = [&](const Ball& ball) {
      const glm::dvec3 d = p - ball.centre;
      const double far = ball.radius + reach;
      return glm::dot(d, d) >= far * far;
    };
    for (size_t g = 0; g < groups_.size(); ++g) {
      if (beyond(groups_[g])) continue;
      for (size_t t = g * kGroup; t < std::min((g + 1) * kGroup, balls_.size()); ++t) {
        if (beyond(balls_[t])) continue;
        best = std::min(best, squaredDistance(p, corner(t, 0), corner(t, 1), corner(t, 2)));
        reach = std::sqrt(best);
      }
    }
    return best;
  }

 private:
  struct Ball {
    glm::dvec3 centre;
    double radius;
  };
  static constexpr size_t kGroup = 64;
  glm::dvec3 corner(size_t t, size_t k) const { return mesh_.positions_mm[mesh_.triangles[t][k]]; }
  const TriMesh& mesh_;
  std::vector<Ball> balls_, groups_;
};

struct Way {
  double rms = 0, largest = 0;  // in diagonals
};
// `count` places, spread evenly over the area.
Way measured(const TriMesh& from, const TriMesh& to, const glm::dvec3& shift, double diagonal, size_t count) {
  const Triangles surface(to);
  std::vector<double> area{0};
  for (const auto& t : from.triangles) {
    const glm::dvec3 a(from.positions_mm[t[0]]), b(from.positions_mm[t[1]]), c(from.positions_mm[t[2]]);
    area.push_back(area.back() + glm::length(glm::cross(b - a, c - a)));
  }
  Way way;
  double squares = 0;
  for (size_t k = 0; k < count; ++k) {
    const double at = (static_cast<double>(k) + 0.5) / static_cast<double>(count) * area.back();
    const size_t i =
        std::min<size_t>(std::upper_bound(area.begin(), area.end(), at) - area.begin() - 1, from.triangles.size() - 1);
    const auto& t = from.triangles[i];
    double u = std::fmod(0.5 + static_cast<double>(k) * 0.618034, 1.0), v = (static_cast<double>(k % 97) + 0.5) / 97;
    if (u + v > 1) u = 1 - u, v = 1 - v;
    const glm::dvec3 a(from.positions_mm[t[0]]), b(from.positions_mm[t[1]]), c(from.positions_mm[t[2]]),
        p = a + u * (b - a) + v * (c - a) + shift;
    const double best = surface.squaredDistanceTo(p);
    squares += best;
    way.largest = std::max(way.largest, std::sqrt(best) / diagonal);
  }
  way.rms = std::sqrt(squares / static_cast<double>(count)) / diagonal;
  return way;
}

struct Made {
  std::unique_ptr<MeshBake> bake;
  Fidelity fidelity;
};
// As the program does.
Made bakeUntilKept(const TriMesh& scan, int rounds = 5) {
  auto scene = makeBakeScene(scan, {});
  auto domain = BaseDomain::create(scan);
  EXPECT_TRUE(scene.ok() && domain.ok());
  Made best;
  auto base = (*domain)->make();
  for (int round = 0; base.ok(); ++round) {
    auto bake = MeshBake::create(scan, {}, *base, {}, *scene);
    EXPECT_TRUE(bake.ok());
    auto measured_fidelity = measureFidelity(FidelityScan(scan, 0), **bake, FidelityTarget::of(diagonalOf(scan)));
    EXPECT_TRUE(measured_fidelity.ok());
    std::vector<RefineRequest> requests;
    for (const FidelityViolation& m : measured_fidelity->violations) requests.push_back({m.position_mm, 16});
    const bool kept = measured_fidelity->kept();
    if (!best.bake || measured_fidelity->excess() < best.fidelity.excess())
      best = {std::move(*bake), std::move(*measured_fidelity)};
    if (kept || round == rounds) break;
    base = (*domain)->refine(requests, 4096);
  }
  return best;
}

void PrintTo(const ScanShape& s, std::ostream* out) { *out << s.name; }
class PromisedDistance : public testing::TestWithParam<ScanShape> {};

TEST_P(PromisedDistance, IsKeptBothWays) {
  if (test::kSanitized) GTEST_SKIP() << "minutes of the same code";
  const TriMesh scan = GetParam().make(1);
  const Made made = bakeUntilKept(scan);
  ASSERT_TRUE(made.bake);
  const double diagonal = diagonalOf(scan);
  const TriMesh drawn = bakedTriangles(*made.bake);
  const glm::dvec3 shift = scan.origin_mm - drawn.origin_mm;
  const Way there = measured(scan, drawn, shift, diagonal, 300), back = measured(drawn, scan, -shift, diagonal, 300);
  printf("%s: %zu patches, %.1f dB; RMS %.2e and %.2e, largest %.2e and %.2e diagonals\n", GetParam().name,
         made.bake->base().patches.size(), made.fidelity.psnr_db(), there.rms, back.rms, there.largest, back.largest);
  EXPECT_TRUE(made.fidelity.kept()) << made.fidelity.excess();
  EXPECT_LE(there.rms, 3e-5);
  EXPECT_LE(back.rms, 3e-5);
  EXPECT_LE(there.largest, 1e-3);
  EXPECT_LE(back.largest, 1e-3);
  // What the program says is what is so.
  EXPECT_NEAR(made.fidelity.to_drawn.rms_mm / diagonal, there.rms, 1.5e-5);
  EXPECT_NEAR(made.fidelity.to_scan.rms_mm / diagonal, back.rms, 1.5e-5);
}
// Those of more triangles are measured by tools/bench/scan_bytes.
INSTANTIATE_TEST_SUITE_P(Shapes, PromisedDistance, testing::ValuesIn(kScanShapes.begin(), kScanShapes.begin() + 6),
                         [](const auto& i) { return i.param.name; });

// A scan of which a piece is not drawn, and one with a piece too much, miss the target, and where is said.
TEST(PromisedDistanceControl, MissingPiecesAreMisses) {
  const TriMesh one = ballMesh(12), two = together(one, ballMesh(4, 5.0), glm::vec3(80, 0, 0));
  const Made made = bakeUntilKept(one, 0);
  ASSERT_TRUE(made.bake);
  ASSERT_TRUE(made.fidelity.kept());
  auto missing = measureFidelity(FidelityScan(two, 0), *made.bake, FidelityTarget::of(diagonalOf(two)));
  ASSERT_TRUE(missing.ok());
  EXPECT_FALSE(missing->kept());
  EXPECT_GT(missing->to_drawn.area_beyond, 0.005);
  EXPECT_LT(missing->to_scan.area_beyond, 1e-4);
  EXPECT_GT(missing->to_drawn.max_at_mm.x, 60);
  const Made both = bakeUntilKept(two, 0);
  auto much = measureFidelity(FidelityScan(one, 0), *both.bake, FidelityTarget::of(diagonalOf(two)));
  ASSERT_TRUE(much.ok());
  EXPECT_FALSE(much->kept());
  EXPECT_GT(much->to_scan.area_beyond, 0.005);
  EXPECT_LT(much->to_drawn.area_beyond, 1e-4);
  const TriMesh drawn = bakedTriangles(*made.bake);
  EXPECT_GT(measured(two, drawn, two.origin_mm - drawn.origin_mm, diagonalOf(two), 300).largest, 0.1);
}

// Far off, coarse blocks are measured: what they say is what is so, but for a little. Where the target is one that is
// nearly kept, the same surface is measured on fine ones.
TEST(FarOff, IsToldAsFarOffAsItIs) {
  const TriMesh ball = ballMesh(8),
                scan = cubeMesh(30, [](const glm::dvec3&p) {
                  const glm::dvec3 d = glm::normalize(p);
                  return d * (50 + 5 * std::sin(13 * d.x) * std::sin(13 * d.y) * std::sin(13 * d.z));
                });
  auto base = makeBaseMesh(ball, {.patches = 24});
  ASSERT_TRUE(base.ok());
  BakeOptions options;
  options.cells_log2 = 2;
  options.fit = false;
  auto bake = MeshBake::create(scan, {}, *base, options);
  ASSERT_TRUE(bake.ok());
  const double diagonal = diagonalOf(scan);
  const FidelityScan measured_scan(scan, 0, 10'000);
  auto coarse = measureFidelity(measured_scan, **bake, FidelityTarget::of(diagonal)),
       fine = measureFidelity(measured_scan, **bake, FidelityTarget::within(0.05 * diagonal));
  ASSERT_TRUE(coarse.ok() && fine.ok());
  ASSERT_GT(coarse->excess(), 32);
  ASSERT_LT(fine->excess(), 32);
  EXPECT_NE(coarse->to_scan.rms_mm, fine->to_scan.rms_mm);
  // Four cells between two samples.
  SurfaceGrid grid(4);
  TriMesh drawn;
  for (uint32_t patch = 0; patch < base->patches.size(); ++patch) {
    (*bake)->surface(patch, grid);
    const auto row = static_cast<uint32_t>(grid.row()), first = static_cast<uint32_t>(drawn.positions_mm.size());
    for (size_t i = 0; i < row * row; ++i)
      drawn.positions_mm.push_back(glm::vec3(glm::dvec3(grid.axes[0][i], grid.axes[1][i], grid.axes[2][i])));
    for (uint32_t y = 0; y + 1 < row; ++y)
      for (uint32_t x = 0; x + 1 < row; ++x) {
        const uint32_t a = first + y * row + x, b = a + row;
        drawn.triangles.push_back({a, b + 1, a + 1});
        drawn.triangles.push_back({a, b, b + 1});
      }
  }
  const Way there = measured(scan, drawn, glm::dvec3(0), diagonal, 4000),
            back = measured(drawn, scan, glm::dvec3(0), diagonal, 4000);
  for (const Fidelity* found : {&*coarse, &*fine}) {
    EXPECT_NEAR(found->to_drawn.rms_mm / diagonal, there.rms, 0.03 * there.rms);
    EXPECT_NEAR(found->to_scan.rms_mm / diagonal, back.rms, 0.03 * back.rms);
  }
}

// Distances as a surface may have them: half a normal distribution, and a share of it that is some times as far off.
// What many places find decides; few ones may be sure only where it agrees.
TEST(SurelyWithin, IsSeldomWrongAndSureWhereThereIsRoom) {
  std::mt19937 random(23);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> unit(0, 1);
  const FidelityTarget target = FidelityTarget::of(1);
  constexpr uint64_t kFew = 8000;
  constexpr double kShare = 0.9;
  struct Surface {
    double rms, tail_share, tail_times;  // rms: of the target's, with the tail
  };
  auto sureOf = [&](const Surface& s) {
    int sure = 0;
    const double scale =
        s.rms * target.rms_mm / std::sqrt(1 - s.tail_share + s.tail_share * s.tail_times * s.tail_times);
    constexpr int kRounds = 100;
    for (int round = 0; round < kRounds; ++round) {
      Fidelity f{.diagonal_mm = 1, .target = target, .to_drawn = {}, .to_scan = {}, .violations = {}};
      for (OneSidedFidelity* way : {&f.to_drawn, &f.to_scan}) {
        double squares = 0, fourths = 0, within = 0, beyond = 0;
        for (uint64_t i = 0; i < kFew; ++i) {
          const double d = std::abs(normal(random)) * scale * (unit(random) < s.tail_share ? s.tail_times : 1);
          squares += d * d, fourths += d * d * d * d;
          within += d <= target.p99_9_mm, beyond += d > target.max_mm;
        }
        const double n = kFew, mean = squares / n;
        *way = {.samples = kFew,
                .rms_mm = std::sqrt(mean),
                .mean_square_error = std::sqrt((fourths / n - mean * mean) / n),
                .area_within = within / n,
                .area_beyond = beyond / n};
      }
      sure += surelyWithin(f, kShare);
    }
    return static_cast<double>(sure) / kRounds;
  };
  // The RMS, the 99.9th percentile and what lies beyond the largest: just outside of what is asked for.
  EXPECT_LE(sureOf({kShare, 0, 1}), 0.01);
  EXPECT_LE(sureOf({kShare, 0.01, 5}), 0.01);
  EXPECT_LE(sureOf({0.85, 0.0015, 20}), 0.01);
  EXPECT_LE(sureOf({0.8, 0.0015, 30}), 0.02);
  // With room.
  EXPECT_EQ(sureOf({0.8, 0, 1}), 1);
  EXPECT_GE(sureOf({0.6, 0.01, 5}), 0.99);
  EXPECT_GE(sureOf({0.5, 0, 1}), 1);
}

// One of few places beyond the largest distance is too much, be all else well within.
TEST(SurelyWithin, NoneMayLieBeyondTheLargest) {
  Fidelity f{.diagonal_mm = 1, .target = FidelityTarget::of(1), .to_drawn = {}, .to_scan = {}, .violations = {}};
  for (OneSidedFidelity* way : {&f.to_drawn, &f.to_scan}) *way = {.samples = 8000, .rms_mm = 0.4 * f.target.rms_mm};
  f.to_scan.area_within = 1 - 1.0 / 8000;
  EXPECT_TRUE(surelyWithin(f, 0.9)) << "control: one beyond the percentile";
  f.to_scan.area_beyond = 1.0 / 8000;
  EXPECT_FALSE(surelyWithin(f, 0.9));
}

// Few places find what many do, within some standard errors, and a miss is no less one.
TEST(SurelyWithin, FewPlacesOfABakeFindWhatManyDo) {
  const TriMesh scan = ballMesh(40);
  const Made made = bakeUntilKept(scan, 0);
  ASSERT_TRUE(made.bake && made.fidelity.kept());
  const FidelityScan many(scan, 0);
  const FidelityScan few = FidelityScan::fewer(many, 0, 8000);
  EXPECT_EQ(few.areaSamples(), 8000u);
  EXPECT_EQ(few.positions().size(), few.areaSamples()) << "no vertices";
  for (const double shrink : {1.0, 0.6}) {
    const FidelityTarget target = FidelityTarget::within(
        shrink * std::max(made.fidelity.to_drawn.rms_mm, made.fidelity.to_scan.rms_mm) * 10 / 0.7);
    auto of_many = measureFidelity(many, *made.bake, target),
         of_few = measureFidelity(few, *made.bake, target, {.soon = true});
    ASSERT_TRUE(of_many.ok() && of_few.ok());
    for (auto way : {&Fidelity::to_drawn, &Fidelity::to_scan}) {
      const double square = std::pow(((*of_many).*way).rms_mm, 2), found = std::pow(((*of_few).*way).rms_mm, 2);
      EXPECT_NEAR(found, square, 5 * ((*of_few).*way).mean_square_error + 0.02 * square);
      EXPECT_GT(((*of_few).*way).mean_square_error, 0);
    }
    EXPECT_EQ(surelyWithin(*of_few, 0.9), shrink == 1.0 && of_many->kept());
  }
}

// The largest distance covers vertices, of which only those are searched to the end that might be it: a spike of the
// scan, of no area to speak of, that no bake shows.
TEST(PromisedDistance, VerticesThatStickOutAreFound) {
  TriMesh scan = ballMesh(40);
  const Made made = bakeUntilKept(scan, 0);
  ASSERT_TRUE(made.bake && made.fidelity.kept());
  const size_t spike = scan.positions_mm.size() / 3;
  const glm::vec3 was = scan.positions_mm[spike];
  scan.positions_mm[spike] = 1.5f * was;
  auto found = measureFidelity(FidelityScan(scan, 0, 1000), *made.bake, FidelityTarget::of(diagonalOf(scan)));
  ASSERT_TRUE(found.ok());
  EXPECT_NEAR(found->to_drawn.max_mm, 0.5 * glm::length(was), 0.01 * glm::length(was));
  EXPECT_LT(glm::length(found->to_drawn.max_at_mm - glm::dvec3(scan.positions_mm[spike])), 1e-6);
  bool listed = false;
  for (const FidelityViolation& v : found->violations)
    listed |= glm::length(v.position_mm - glm::dvec3(scan.positions_mm[spike])) < 1e-6;
  EXPECT_TRUE(listed);
  scan.positions_mm[spike] = was;  // control
  found = measureFidelity(FidelityScan(scan, 0, 1000), *made.bake, FidelityTarget::of(diagonalOf(scan)));
  ASSERT_TRUE(found.ok());
  EXPECT_LT(found->to_drawn.max_mm, 0.01 * glm::length(was));
}

// Every piece has patches from the first base on: what a closed one's topology needs, at least.
TEST(PromisedDistance, NoPieceVanishes) {
  const TriMesh scan = figure(1);
  auto base = makeBaseMesh(scan);
  ASSERT_TRUE(base.ok());
  size_t of_body = 0;
  for (const auto& p : base->patches) of_body += glm::length(base->corners[p[0]].position_mm) < 80;
  EXPECT_GE(of_body, 6u);
  EXPECT_GE(base->patches.size() - of_body, 23u * 4);
}

}  // namespace fidelity_test
}  // namespace relievo
