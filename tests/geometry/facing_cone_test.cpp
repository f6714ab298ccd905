// Cones of normals against all triangles of all levels' grids, in doubles; which meshes are closed bodies; and lists
// with and without what faces away: nothing else may differ. Controls: cones a few degrees too narrow, slopes that are
// not true, eyes and near planes inside.
#include "geometry/lod/facing_cone.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/geometry/mesh_fixture.h"

namespace relievo {
namespace facing_cone_test {

constexpr uint64_t kSeed = 20261122;
constexpr int kUnitLog2 = 7;

// Bumps as a function of the place in space, so that patches agree where they meet; 16-bit samples of it.
struct Bumps {
  double amplitude_mm = 3, wave_mm = 40;
  double offset() const { return -amplitude_mm; }
  double scale() const { return 2 * amplitude_mm / 65535; }
  uint16_t operator()(const BaseMesh& mesh, uint32_t patch, double u, double v) const {
    const glm::dvec3 q = mesh.point(patch, u, v) * (2 * std::numbers::pi / wave_mm);
    const double h =
        amplitude_mm * std::sin(q.x + 0.7 * std::sin(q.y)) * std::cos(1.3 * q.y + 0.4 * q.z) * std::cos(0.6 * q.z);
    return static_cast<uint16_t>(std::lround((h - offset()) / scale()));
  }
};

struct Displaced {
  const BaseMesh& mesh;
  Bumps bumps;
  uint32_t patch;
  std::vector<uint16_t> samples = {};
  HeightSlopes slopes = {};
  double low = 0, high = 0;

  Displaced(const BaseMesh& m, const Bumps& b, uint32_t p) : mesh(m), bumps(b), patch(p) {
    const int n = 1 << kUnitLog2;
    for (int y = 0; y <= n; ++y)
      for (int x = 0; x <= n; ++x) samples.push_back(bumps(mesh, patch, double(x) / n, double(y) / n));
    auto mm = [&](int x, int y) {
      return bumps.offset() + bumps.scale() * samples[static_cast<size_t>(y * (n + 1) + x)];
    };
    low = high = mm(0, 0);
    auto widen = [n](float& least, float& most, double step) {
      least = std::min(least, std::nextafter(static_cast<float>(step * n), -INFINITY)),
      most = std::max(most, std::nextafter(static_cast<float>(step * n), INFINITY));
    };
    for (int y = 0; y <= n; ++y)
      for (int x = 0; x <= n; ++x) {
        low = std::min(low, mm(x, y)), high = std::max(high, mm(x, y));
        if (x < n) widen(slopes.min_u, slopes.max_u, mm(x + 1, y) - mm(x, y));
        if (y < n) widen(slopes.min_v, slopes.max_v, mm(x, y + 1) - mm(x, y));
      }
  }
  glm::dvec3 at(int x, int y, double exaggerate) const {
    const int n = 1 << kUnitLog2;
    const double u = double(x) / n, v = double(y) / n,
                 h = bumps.offset() + bumps.scale() * samples[static_cast<size_t>(y * (n + 1) + x)];
    return mesh.point(patch, u, v) + exaggerate * h * mesh.normal(patch, u, v);
  }
  FacingCone cone(double x) const {
    const float f = static_cast<float>(x);
    HeightSlopes s = slopes;
    for (float* k : {&s.min_u, &s.max_u, &s.min_v, &s.max_v}) *k *= f;
    if (x < 0) std::swap(s.min_u, s.max_u), std::swap(s.min_v, s.max_v);
    return facingCone(mesh, patch, std::min(low * x, high * x), std::max(low * x, high * x), s);
  }
  // Outward normals of all triangles of the grid of 2^level cells.
  template <class Visit>
  void normals(int level, double exaggerate, Visit visit) const {
    const int n = 1 << kUnitLog2, step = n >> level;
    for (int y = 0; y < n; y += step)
      for (int x = 0; x < n; x += step) {
        const glm::dvec3 a = at(x, y, exaggerate), b = at(x + step, y, exaggerate), c = at(x, y + step, exaggerate),
                         d = at(x + step, y + step, exaggerate);
        visit(glm::cross(d - a, b - a));
        visit(glm::cross(c - a, d - a));
      }
  }
};

TEST(FacingCone, HoldsEveryNormalOfEveryLevel) {
  test::Random random(kSeed);
  uint64_t normals = 0, outside_narrower = 0, outside_without_slopes = 0, cones = 0;
  double spare = 1e9;
  for (const BaseMesh& mesh : {test::cubeSphere(4, 60), test::torus(24, 12, 80, 25), test::openSheet(3, 3, 30)}) {
    for (int i = 0; i < 12; ++i) {
      Displaced patch(mesh, {random.real(0.2, 3), random.real(25, 60)},
                      static_cast<uint32_t>(random.integer(0, static_cast<int>(mesh.patches.size()) - 1)));
      const double exaggerate = i % 3 == 0 ? random.real(-1, 2) : 1;
      const FacingCone cone = patch.cone(exaggerate), flat = facingCone(mesh, patch.patch, 0, 0, {});
      if (!(cone.sine < 1)) continue;
      ++cones;
      double widest = 0;
      for (int level = 0; level <= kUnitLog2; ++level) {
        patch.normals(level, exaggerate, [&](const glm::dvec3& n) {
          const double sine = glm::length(glm::cross(glm::normalize(n), cone.axis));
          ASSERT_GT(glm::dot(n, cone.axis), 0);
          ASSERT_LE(sine, cone.sine);
          widest = std::max(widest, std::asin(sine));
          outside_without_slopes += flat.sine < 1 && glm::length(glm::cross(glm::normalize(n), flat.axis)) > flat.sine;
          ++normals;
        });
      }
      spare = std::min(spare, glm::degrees(std::asin(cone.sine) - widest));
      patch.normals(kUnitLog2, exaggerate, [&](const glm::dvec3& n) {
        outside_narrower += glm::length(glm::cross(glm::normalize(n), cone.axis)) >
                            std::sin(std::max(0.0, std::asin(cone.sine) - glm::radians(12.0)));
      });
    }
  }
  std::printf(
      "[ cones    ] seed %llu: %llu normals in %llu cones, the tightest with %.2f degrees to spare; outside of cones "
      "12 degrees narrower %llu, of the base's own %llu\n",
      (unsigned long long)kSeed, (unsigned long long)normals, (unsigned long long)cones, spare,
      (unsigned long long)outside_narrower, (unsigned long long)outside_without_slopes);
  EXPECT_GT(cones, 20u);
  EXPECT_GT(outside_narrower, 0u) << "control";
  EXPECT_GT(outside_without_slopes, 0u) << "control";
}

TEST(FacingCone, BytesAreRoundedOutwards) {
  test::Random random(kSeed + 1);
  for (int i = 0; i < 20000; ++i) {
    FacingCone cone{glm::normalize(glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1))),
                    random.real(0, 1.05)};
    const uint32_t bytes = packCone(cone);
    auto byte = [&](int n) { return static_cast<double>(static_cast<int8_t>(bytes >> (8 * n))) / 127; };
    if (byte(3) >= 0.995) continue;
    ASSERT_LT(cone.sine, 1);
    // Whatever is seen from behind by the bytes is by the cone.
    const glm::dvec3 v =
        random.real(0.1, 500) *
        glm::normalize(cone.axis + glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1)));
    const glm::dvec3 axis(byte(0), byte(1), byte(2));
    if (glm::dot(v, axis) > byte(3) * glm::length(v)) {
      ASSERT_GT(glm::dot(v, cone.axis), cone.sine * glm::length(v));
    }
  }
  EXPECT_EQ(packCone({}) >> 24, 127u) << "nothing is known";
  // Joined: inside of each, inside of all.
  for (int i = 0; i < 2000; ++i) {
    std::array<FacingCone, 4> cones;
    const glm::dvec3 middle = glm::normalize(glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1)));
    for (FacingCone& c : cones)
      c = {glm::normalize(middle + 0.3 * glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1))),
           random.real(0, 0.5)};
    const FacingCone all = joined(cones);
    if (!(all.sine < 1)) continue;
    for (const FacingCone& c : cones)
      ASSERT_LE(std::acos(glm::dot(c.axis, all.axis)) + std::asin(c.sine), std::asin(all.sine) + 1e-9);
  }
}

bool isClosed(const BaseMesh& mesh) { return isClosedBody(mesh, patchNeighbours(mesh)); }

TEST(ClosedBody, IsWithoutBorderAndOutwardsEverywhere) {
  EXPECT_TRUE(isClosed(test::cubeSphere(1, 60)));
  EXPECT_TRUE(isClosed(test::cubeSphere(5, 60)));
  EXPECT_TRUE(isClosed(test::torus(9, 5, 80, 25)));
  EXPECT_FALSE(isClosed(test::openSheet(3, 4, 30)));
  EXPECT_FALSE(isClosed(test::moebius(7, 60, 40)));
  BaseMesh ball = test::cubeSphere(3, 60);
  test::Random random(kSeed);
  test::turnPatches(ball, random, false);
  EXPECT_TRUE(isClosed(ball)) << "turned patches face as before";
  BaseMesh hole = ball;
  hole.patches.pop_back();
  EXPECT_FALSE(isClosed(hole));
  BaseMesh flipped = ball;
  std::swap(flipped.patches[7][1], flipped.patches[7][2]);
  EXPECT_FALSE(isClosed(flipped));
  BaseMesh inside_out = ball;
  for (auto& c : inside_out.patches) std::swap(c[1], c[2]);
  EXPECT_FALSE(isClosed(inside_out));
  // A ball and, inside of it, one that is inside out.
  BaseMesh hollow = ball;
  for (const BaseCorner& c : inside_out.corners) hollow.corners.push_back({c.position_mm * 0.5f, -c.normal});
  for (auto c : inside_out.patches) {
    for (uint32_t& k : c) k += static_cast<uint32_t>(ball.corners.size());
    hollow.patches.push_back(c);
  }
  EXPECT_FALSE(isClosed(hollow)) << "the inner one counts as turned inside out";
}

class BumpOracle final : public ReliefOracle {
 public:
  BumpOracle(const BaseMesh& mesh, const Bumps& bumps, bool true_slopes) : bumps_(bumps) {
    for (uint32_t p = 0; p < mesh.patches.size(); ++p)
      slopes_.push_back(true_slopes ? Displaced(mesh, bumps, p).slopes : HeightSlopes{});
  }
  HeightBounds bounds(const NodeId& page) const override {
    const auto a = static_cast<float>(bumps_.amplitude_mm);
    return {-a, a, 0.05f * std::ldexp(a, -2 * static_cast<int>(page.level))};
  }
  bool heightSlopes(uint32_t patch, HeightSlopes& slopes) const override {
    slopes = slopes_[patch];
    return true;
  }

 private:
  Bumps bumps_;
  std::vector<HeightSlopes> slopes_;
};

struct Lists {
  uint64_t views = 0, hiding_views = 0, left_out = 0, drawn = 0, fronts_left_out = 0;
};
// Of random views: lists with backs and without.
Lists compareLists(const BaseMesh& mesh, const Bumps& bumps, bool true_slopes, int views) {
  test::Random random(kSeed + 2);
  auto shared = std::make_shared<const BaseMesh>(mesh);
  std::vector<CoarseErrors> coarse(mesh.patches.size());
  for (CoarseErrors& e : coarse)
    for (int k = 0; k < 7; ++k)
      e[static_cast<size_t>(k)] = static_cast<float>(bumps.amplitude_mm * std::ldexp(1.0, -2 * k));
  MeshLod lod(shared, 0, bumps.offset(), bumps.scale(), std::make_shared<BumpOracle>(mesh, bumps, true_slopes), coarse);
  std::vector<Displaced> patches;
  for (uint32_t p = 0; p < mesh.patches.size(); ++p) patches.emplace_back(mesh, bumps, p);
  ReliefSet resident;
  Lists lists;
  for (int i = 0; i < views; ++i) {
    test::Camera camera = test::randomMeshCamera(mesh, kUnitLog2, random);
    LodView view = test::makeView(camera);
    view.error_px = std::exp(random.real(-1, 3));
    view.min_cell_px = random.chance(0.5) ? 2 : 0;
    view.hide_backs = false;
    const LodResult all = lod.select(view, resident);
    view.hide_backs = true;
    const LodResult some = lod.select(view, resident);
    EXPECT_EQ(all.backs_are_hidden, some.backs_are_hidden) << "by the body and the eye alone";
    ++lists.views;
    lists.hiding_views += some.backs_are_hidden;
    EXPECT_LE(some.max_error_px, all.max_error_px);
    EXPECT_EQ(some.requests.size(), all.requests.size());
    size_t k = 0;
    for (const PatchInstance& p : all.instances) {
      if (k < some.instances.size() && some.instances[k] == p) {
        ++k, ++lists.drawn;
        continue;
      }
      ++lists.left_out;
      EXPECT_TRUE(some.backs_are_hidden);
      // All of it, at any level, is seen from behind.
      bool front = false;
      const Displaced& patch = patches[p.node.patch];
      for (int level : {0, 2, 4}) {
        const int n = 1 << kUnitLog2, step = n >> level;
        for (int y = 0; y < n; y += step)
          for (int x = 0; x < n; x += step) {
            const glm::dvec3 a = patch.at(x, y, 1), b = patch.at(x + step, y, 1), c = patch.at(x, y + step, 1),
                             d = patch.at(x + step, y + step, 1);
            front = front || glm::dot(glm::cross(d - a, b - a), a - view.eye_mm) <= 0 ||
                    glm::dot(glm::cross(c - a, d - a), a - view.eye_mm) <= 0;
          }
      }
      lists.fronts_left_out += front;
    }
    EXPECT_EQ(k, some.instances.size()) << "what is drawn is drawn as it would be with all the rest";
  }
  return lists;
}

TEST(HiddenBacks, AreLeftOutAndChangeNothingElse) {
  for (const BaseMesh& mesh : {test::cubeSphere(6, 60), test::torus(30, 14, 80, 25)}) {
    const Lists lists = compareLists(mesh, {1.5, 45}, true, 40);
    std::printf(
        "[ backs    ] seed %llu, %zu patches: hidden in %llu of %llu views; %llu instances drawn, %llu left out\n",
        (unsigned long long)kSeed, mesh.patches.size(), (unsigned long long)lists.hiding_views,
        (unsigned long long)lists.views, (unsigned long long)lists.drawn, (unsigned long long)lists.left_out);
    EXPECT_GT(lists.hiding_views, 5u);
    EXPECT_LT(lists.hiding_views, lists.views) << "eyes and near planes inside the body";
    EXPECT_GT(lists.left_out, 100u);
    EXPECT_EQ(lists.fronts_left_out, 0u);
  }
  // Control: heights steeper than they say.
  EXPECT_GT(compareLists(test::cubeSphere(6, 60), {3, 25}, false, 30).fronts_left_out, 0u);
  // No closed body: nothing is left out.
  EXPECT_EQ(compareLists(test::openSheet(5, 5, 30), {1.5, 45}, true, 20).left_out, 0u);
}

}  // namespace facing_cone_test
}  // namespace relievo
