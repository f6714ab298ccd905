// What the one selection of nodes (geometry/lod/quadtree_lod.h) promises of every forest: a flat artwork, a base mesh,
// and one whose patches have tails. Lists are deterministic, settle, do not depend on the order in which pages came,
// grow as errors shrink; views that are none and oracles that lie do no harm.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <limits>

#include "tests/geometry/lod_fixture.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/geometry/true_mesh_relief.h"
#include "tests/geometry/true_relief.h"

namespace relievo::test {
namespace quadtree_lod_test {

uint64_t cellsOf(const LodResult& lod) {
  uint64_t cells = 0;
  for (const PatchInstance& p : lod.instances) cells += uint64_t{1} << (2 * p.grid_level);
  return cells;
}

// What may be selected from again and again, with an oracle and heights of its own.
using Select = std::function<LodResult(const LodView&, const ReliefSet&)>;
struct Scene {
  uint32_t patches = 0;
  Select select;
};

// ---- the forests: random cases, and scenes made for one question
struct Flat {
  static constexpr uint64_t kSeed = 20140612;
  static constexpr int kLeastGrid = 1, kSettling = 250;
  PlanarCase c;
  std::unique_ptr<PlanarLod> lod;

  explicit Flat(uint64_t seed) : c(randomPlanarCase(seed)), lod(std::make_unique<PlanarLod>(c.domain, c.oracle)) {}
  LodView otherView(Random& random) const { return makeView(randomCamera(c.domain, random), 1); }
  // What a patch without pages is drawn from.
  static bool hasHeights(const NodeId& page, const ReliefSet& resident) {
    return page.level == 0 || resident.contains(page);
  }

  static Scene scene(std::shared_ptr<const ReliefOracle> oracle) {
    const FlatDomain domain = makeDomain(1000, 300, 0);
    auto lod = std::make_shared<PlanarLod>(domain, std::move(oracle));
    return {domain.patchCount(), [lod](const LodView& v, const ReliefSet& r) { return lod->select(v, r); }};
  }
  static std::shared_ptr<const ReliefOracle> madeUp() {
    return std::make_shared<MadeUpOracle>(makeDomain(1000, 300, 0), 7);
  }
  // One bump in the middle of a quarter of the only patch.
  static Scene bump() {
    FlatDomain domain = makeDomain(2048, 2048, -1);
    domain.relief_offset_mm = -2, domain.relief_scale_mm = 4.0 / 65535;
    auto truth = std::make_shared<TrueRelief>(domain, [](int64_t x_units, int64_t y_units) {
      const double x = (static_cast<double>(x_units) / 16 - 1536) / 20,
                   y = (static_cast<double>(y_units) / 16 - 512) / 20;
      return static_cast<uint16_t>(65535 * (0.5 + 0.4 * std::exp(-0.02 * (x * x + y * y))));
    });
    return {1, [domain, truth](LodView v, const ReliefSet& r) {
              v.divide_flat = true;
              return selectPlanarLod(domain, *truth, v, r);
            }};
  }
};
struct Body {
  static constexpr uint64_t kSeed = 20260403;
  static constexpr int kLeastGrid = 0, kSettling = 200;
  MeshCase c;
  MeshLod* lod = nullptr;

  explicit Body(uint64_t seed) : Body(randomMeshCase(seed, meshFor(seed))) {}
  LodView otherView(Random& random) const {
    return makeView(randomMeshCamera(c.named.mesh, c.relief.unitLog2(), random), 1);
  }
  static bool hasHeights(const NodeId& page, const ReliefSet& resident) {
    return page.level == 0 || page.level == kTailLevel || resident.contains(page);
  }

  static Scene scene(std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse = {},
                     bool tails = false) {
    auto mesh = std::make_shared<BaseMesh>(openSheet(3, 3, 20));
    auto lod = std::make_shared<MeshLod>(mesh, 2, -1, 2.0 / 65535, std::move(oracle), std::move(coarse), tails);
    return {static_cast<uint32_t>(mesh->patches.size()),
            [lod](const LodView& v, const ReliefSet& r) { return lod->select(v, r); }};
  }
  static std::shared_ptr<const ReliefOracle> madeUp() {
    return std::make_shared<MadeUpMeshOracle>(MeshRelief{2, -1, 2.0 / 65535}, 7, 0.3);
  }
  static Scene bump(bool tails = false) {
    auto mesh = std::make_shared<BaseMesh>(openSheet(1, 1, 100, 0));
    MeshRelief relief{1, -2, 4.0 / 65535};
    auto truth = std::make_shared<TrueMeshRelief>(*mesh, relief, [](const glm::dvec3& p, const Place&) {
      return 0.5 + 0.4 * std::exp(-0.02 * glm::dot(p - glm::dvec3(25, 25, 0), p - glm::dvec3(25, 25, 0)));
    });
    auto lod =
        std::make_shared<MeshLod>(mesh, relief.depth, relief.offset_mm, relief.scale_mm, truth, truth->coarse(), tails);
    return {1, [lod, mesh](const LodView& v, const ReliefSet& r) { return lod->select(v, r); }};
  }

 protected:
  explicit Body(MeshCase of) : c(std::move(of)), lod(c.lod.get()) {}
  static const NamedMesh& meshFor(uint64_t seed) {
    static const std::vector<NamedMesh> meshes = allMeshes();
    return meshes[seed % meshes.size()];
  }
};
struct BodyWithTails : Body {
  static constexpr uint64_t kSeed = 20261121;
  static constexpr int kSettling = 80;
  explicit BodyWithTails(uint64_t seed) : Body(MeshTailCase(seed, meshFor(seed))) {}
  static bool hasHeights(const NodeId& page, const ReliefSet& resident) {
    return page.level == kTailLevel || resident.contains(page);
  }
  static Scene scene(std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse = {}) {
    return Body::scene(std::move(oracle), std::move(coarse), true);
  }
  static Scene bump() { return Body::bump(true); }
};

template <class Forest>
class QuadtreeLod : public testing::Test {};
struct Names {
  template <class Forest>
  static std::string GetName(int) {
    return std::is_same_v<Forest, Flat> ? "Flat" : std::is_same_v<Forest, Body> ? "BaseMesh" : "WithTails";
  }
};
using Forests = testing::Types<Flat, Body, BodyWithTails>;
TYPED_TEST_SUITE(QuadtreeLod, Forests, Names);

// What a selection keeps from earlier views changes nothing.
TYPED_TEST(QuadtreeLod, SameInputSameList) {
  uint64_t different = 0;
  const int seeds = std::max(share(60), 15 / kViewShare);  // the control asks for more than ten
  for (uint64_t seed = TypeParam::kSeed; seed < TypeParam::kSeed + static_cast<uint64_t>(seeds); ++seed) {
    TypeParam t(seed), fresh(seed);
    auto& c = t.c;
    const LodResult first = t.lod->select(c.view, c.resident);
    Random random(seed);
    for (int k = 0; k < 3; ++k) t.lod->select(t.otherView(random), {});
    // The same pages, inserted the other way round into a table of another size.
    std::vector<NodeId> pages(c.resident.begin(), c.resident.end());
    ReliefSet other(4 * pages.size() + 100);
    for (size_t i = pages.size(); i-- > 0;) other.insert(pages[i]);
    EXPECT_TRUE(sameList(first, t.lod->select(c.view, other))) << describe(c, seed);
    EXPECT_TRUE(sameList(first, fresh.lod->select(c.view, c.resident))) << describe(c, seed);
    LodView moved = c.view;
    moved.error_px *= 3;
    different += !sameList(first, t.lod->select(moved, c.resident));
  }
  EXPECT_GT(different, 10u / kViewShare);  // the control: the comparison sees a change
}

// Grant what is asked for: after a few rounds nothing is missing, the requests are stable, and only they are needed.
TYPED_TEST(QuadtreeLod, SettlesWhenRequestsAreGrantedAndKeepsNothingElse) {
  int most_rounds = 0, over_budget = 0, cases = 0;
  size_t most_nodes = 0, most_requests = 0;
  for (uint64_t seed = TypeParam::kSeed; seed < TypeParam::kSeed + share(TypeParam::kSettling); ++seed, ++cases) {
    TypeParam t(seed);
    auto& c = t.c;
    ReliefSet resident;
    LodResult lod;
    int rounds = 0;
    for (; rounds < 30; ++rounds) {
      lod = t.lod->select(c.view, resident);
      ReliefSet wanted;
      for (const ReliefRequest& w : lod.requests) wanted.insert(w.page);
      if (wanted == resident) break;
      resident = std::move(wanted);  // a cache of exactly what is wanted: everything else is evicted at once
    }
    over_budget += lod.error_px > c.view.error_px;
    ASSERT_LT(rounds, 30) << describe(c, seed);
    ASSERT_EQ(lod.limited_by_residency, 0u) << describe(c, seed);
    if (c.view.min_cell_px == 0) {
      ASSERT_LE(lod.max_error_px, 2 * lod.error_px * (1 + 1e-9)) << describe(c, seed);
    }
    most_rounds = std::max(most_rounds, rounds);
    most_nodes = std::max(most_nodes, lod.instances.size());
    most_requests = std::max(most_requests, lod.requests.size());
  }
  std::printf("[ figures  ] %d cases: at most %d rounds, %zu nodes, %zu pages; %d cases over the node budget\n", cases,
              most_rounds, most_nodes, most_requests, over_budget);
  EXPECT_LT(over_budget, cases / 2);
}

// The list that a view ends with, once all its pages are there, is known before; and is what they give then. The
// control: pages that come a few at a time, in any order, end in other lists, too, each of which asks for no more.
TYPED_TEST(QuadtreeLod, WhatPagesLeadToDoesNotDependOnTheirOrder) {
  int of_pages = 0, others = 0, cases = 0;
  for (uint64_t seed = TypeParam::kSeed; seed < TypeParam::kSeed + 12 + 48 / kViewShare; ++seed) {
    TypeParam t(seed);
    auto& c = t.c;
    if (!c.view.relief) continue;
    LodView ahead = c.view;
    ahead.as_if_resident = true;
    const LodResult expected = t.lod->select(ahead, {});
    ReliefSet resident;
    for (const ReliefRequest& request : expected.requests) resident.insert(request.page);
    for (const PatchInstance& p : expected.instances) {
      ASSERT_TRUE(TypeParam::hasHeights(p.relief_page, resident)) << describe(c, seed);
      of_pages += p.relief_page.level != kTailLevel;
    }
    const LodResult there = t.lod->select(c.view, resident);
    EXPECT_EQ(there.instances, expected.instances) << describe(c, seed);
    EXPECT_EQ(there.limited_by_residency, 0u) << describe(c, seed);
    Random random(seed);
    ReliefSet growing;
    for (int round = 0; round < 200; ++round) {
      std::vector<NodeId> missing;
      const LodResult lod = t.lod->select(c.view, growing);
      for (const ReliefRequest& request : lod.requests)
        if (!growing.contains(request.page)) missing.push_back(request.page);
      if (missing.empty()) {
        others += lod.instances != expected.instances;
        ++cases;
        break;
      }
      std::shuffle(missing.begin(), missing.end(), random.engine);
      growing.insert(missing.begin(), missing.begin() + static_cast<std::ptrdiff_t>((missing.size() + 1) / 2));
    }
  }
  std::printf("[ figures  ] %d of %d orders of arrival end in another list\n", others, cases);
  EXPECT_GT(of_pages, 1000 / kViewShare);
  EXPECT_GE(others, 3 / kViewShare) << "the control";
  EXPECT_GE(cases, 6);
}

// Levels are a function of the error asked for: a smaller one never asks for anything coarser. A node that would save
// less than 32 cells by being divided stays whole, and is drawn finer than asked for by no more than that.
TYPED_TEST(QuadtreeLod, SmallerErrorsNeverDrawCoarser) {
  uint64_t all_fine = 0, all_coarse = 0;
  for (uint64_t seed = TypeParam::kSeed; seed < TypeParam::kSeed + share(60); ++seed) {
    TypeParam t(seed);
    auto& c = t.c;
    auto draw = [&](double error_px) {
      LodView view = c.view;
      view.error_px = error_px;
      return t.lod->select(view, c.resident);
    };
    const LodResult fine = draw(c.view.error_px), coarse = draw(3 * c.view.error_px);
    if (fine.error_px > c.view.error_px) continue;
    uint64_t spare = 0;
    for (const PatchInstance& p : coarse.instances) spare += std::min<uint64_t>(uint64_t{1} << (2 * p.grid_level), 32);
    EXPECT_GE(cellsOf(fine) + spare, cellsOf(coarse)) << describe(c, seed);
    all_fine += cellsOf(fine), all_coarse += cellsOf(coarse);
  }
  std::printf("[ figures  ] %llu cells, %llu for three times the error\n", static_cast<unsigned long long>(all_fine),
              static_cast<unsigned long long>(all_coarse));
  if (!kSanitized) {
    EXPECT_GT(all_fine, all_coarse + all_coarse / 4);
  }  // few views may lack pages for more
}

TYPED_TEST(QuadtreeLod, ViewsThatAreNoneDrawTheRoots) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  Camera c;
  c.eye = {0, 0, 300};
  std::vector<LodView> views(6, makeView(c));
  views[0].clip_from_world[1][2] = nan;
  views[1].clip_from_world = glm::dmat4(0.0);
  views[2].eye_mm.x = inf;
  views[3].pixels_per_radian = nan;
  views[4].pixels_per_radian = 0;
  views[5].clip_from_world[2][3] = -inf;
  const Scene scene = TypeParam::scene(TypeParam::madeUp());
  for (const LodView& view : views) {
    const LodResult lod = scene.select(view, {});
    ASSERT_EQ(lod.instances.size(), scene.patches);
    EXPECT_TRUE(lod.requests.empty());
    EXPECT_EQ(lod.max_error_px, 0);
    for (uint32_t p = 0; p < lod.instances.size(); ++p) {
      EXPECT_EQ(lod.instances[p].node, (NodeId{p, 0, 0, 0}));
      EXPECT_EQ(lod.instances[p].grid_level, TypeParam::kLeastGrid);
      for (const auto& side : lod.instances[p].edges)
        EXPECT_EQ(side, (std::array<uint8_t, 2>{0, PatchInstance::kWholeEdge}));
    }
  }
  // What is no number among the requests is the default, or nothing.
  LodView view = makeView(c);
  view.error_px = nan, view.exaggerate = inf, view.near_mm = -1, view.min_cell_px = nan;
  EXPECT_TRUE(std::isfinite(scene.select(view, {}).max_error_px));
}

// An oracle that knows nothing, or says what cannot be.
class LyingOracle final : public ReliefOracle {
 public:
  explicit LyingOracle(int kind) : kind_(kind) {}
  HeightBounds bounds(const NodeId&) const override {
    const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    return kind_ == 0   ? HeightBounds{nan, nan, nan}
           : kind_ == 1 ? HeightBounds{5, -5, -1}
                        : HeightBounds{-inf, inf, inf};
  }
  bool errorBlocks(const NodeId&, std::span<float> error_mm) const override {
    for (float& e : error_mm) e = kind_ == 1 ? -1 : std::numeric_limits<float>::quiet_NaN();
    return true;
  }

 private:
  int kind_;
};
template <class Forest>
Scene sceneOfLies(int kind) {
  if constexpr (std::is_same_v<Forest, Flat>) return Flat::scene(std::make_shared<LyingOracle>(kind));
  else {
    std::vector<CoarseErrors> coarse(9);
    for (auto& e : coarse)
      e.fill(kind == 0   ? std::numeric_limits<float>::quiet_NaN()
             : kind == 1 ? -1.0f
                         : std::numeric_limits<float>::infinity());
    return Forest::scene(std::make_shared<LyingOracle>(kind), coarse);
  }
}
TYPED_TEST(QuadtreeLod, OraclesThatLieAreTakenForKnowingNothing) {
  Camera c;
  c.eye = {0, 0, 60};
  for (int kind : {0, 1, 2}) {
    const Scene scene = sceneOfLies<TypeParam>(kind);
    ReliefSet resident;
    LodResult lod;
    for (int round = 0; round < 6; ++round) {
      lod = scene.select(makeView(c), resident);
      for (const ReliefRequest& w : lod.requests) resident.insert(w.page);
    }
    EXPECT_TRUE(std::isfinite(lod.max_error_px));
    // Down to the finest samples, as far as the budget of nodes goes.
    EXPECT_GT(lod.instances.size(), scene.patches);
    EXPECT_EQ(lod.limited_by_residency, 0u);
  }
}

// Where a part of a node asks for more than the rest, the rest is drawn without: all of it would take many more
// triangles, for the same promise.
TYPED_TEST(QuadtreeLod, NodesAreDividedWhereThatSavesTriangles) {
  const Scene scene = TypeParam::bump();
  Camera c;
  c.eye = {0, 30, 150};
  LodView view = makeView(c, 0.25);
  view.as_if_resident = true;
  const LodResult divided = scene.select(view, {});
  int finest = 0;
  for (const PatchInstance& p : divided.instances)
    finest = std::max(finest, static_cast<int>(p.node.level) + p.grid_level);
  const uint64_t cells = cellsOf(divided), as_one = uint64_t{1} << (2 * finest);
  std::printf("[ figures  ] %zu nodes, %llu cells, %llu if all were as fine; %.2f px promised\n",
              divided.instances.size(), static_cast<unsigned long long>(cells), static_cast<unsigned long long>(as_one),
              divided.max_error_px);
  EXPECT_LE(divided.max_error_px, 0.5 * (1 + 1e-9));
  EXPECT_LT(3 * cells, as_one);
  // The control: with hysteresis nodes are not divided for that, and the same promise takes more.
  view.hysteresis = 1e-9;
  EXPECT_LT(cells, cellsOf(scene.select(view, {})));
}

}  // namespace quadtree_lod_test
}  // namespace relievo::test
