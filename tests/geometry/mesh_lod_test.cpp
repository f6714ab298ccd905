// The LOD over base meshes: what is drawn tiles what is in view, levels are balanced and have samples, lists are
// deterministic and settle, hard geometry and hard views end well.
#include <gtest/gtest.h>

#include <cstdio>
#include <limits>

#include "tests/geometry/mesh_fixture.h"
#include "tests/geometry/true_mesh_relief.h"

namespace relievo::test {
namespace {

constexpr uint64_t kSeed = 20260403;

// ---- tiling
struct Cover {
  double covered = 0, holes = 0;  // in squares of patches
  uint64_t overlaps = 0, visible_holes = 0;
};
// Heights are noise: anything in the artwork's range may be drawn anywhere.
Cover coverOf(const MeshCase& c, const std::vector<PatchInstance>& instances) {
  std::set<NodeId> drawn, inner;
  for (const PatchInstance& p : instances) {
    drawn.insert(p.node);
    for (NodeId n = p.node; n.level > 0;) {
      n = n.parent();
      if (!inner.insert(n).second) break;
    }
  }
  Cover cover;
  const double x = c.view.relief ? c.view.exaggerate : 0;
  auto visible = [&](const NodeId& n) {
    for (int j = 0; j <= 6; ++j)
      for (int i = 0; i <= 6; ++i)
        for (double h : {0.0, 0.5, 1.0}) {
          double u = (n.x + i / 6.0) / double(1u << n.level), v = (n.y + j / 6.0) / double(1u << n.level);
          glm::dvec3 at = c.named.mesh.point(n.patch, u, v) +
                          x * (c.relief.offset_mm + h * 65535 * c.relief.scale_mm) * c.named.mesh.normal(n.patch, u, v);
          glm::dvec4 p = c.view.clip_from_world * glm::dvec4(at, 1);
          if (std::abs(p.x) <= p.w && std::abs(p.y) <= p.w && std::abs(p.z) <= p.w) return true;
        }
    return false;
  };
  std::function<void(const NodeId&)> visit = [&](const NodeId& n) {
    const double area = std::ldexp(1.0, -2 * static_cast<int>(n.level));
    if (drawn.count(n)) {
      cover.covered += area;
      cover.overlaps += inner.count(n);
    } else if (inner.count(n)) {
      for (uint32_t k = 0; k < 4; ++k) visit(n.child(k & 1, k >> 1));
    } else {
      cover.holes += area;
      cover.visible_holes += visible(n);
    }
  };
  for (uint32_t p = 0; p < c.named.mesh.patches.size(); ++p) visit({p, 0, 0, 0});
  return cover;
}

TEST(MeshLod, DrawnNodesTileWhatIsInView) {
  const auto meshes = allMeshes();
  int with_holes = 0;
  uint64_t control = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(300); ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    PlanarLodResult lod = c.lod->select(c.view, c.resident);
    Cover cover = coverOf(c, lod.instances);
    EXPECT_DOUBLE_EQ(cover.covered + cover.holes, static_cast<double>(c.named.mesh.patches.size()))
        << describe(c, seed);
    EXPECT_EQ(cover.overlaps, 0u) << describe(c, seed);
    EXPECT_EQ(cover.visible_holes, 0u) << describe(c, seed);
    with_holes += cover.holes > 0;
    // Negative control: a node in the middle of the list is forgotten.
    if (lod.instances.size() > 3) {
      lod.instances.erase(lod.instances.begin() + static_cast<ptrdiff_t>(lod.instances.size() / 2));
      control += coverOf(c, lod.instances).visible_holes;
    }
  }
  EXPECT_GT(with_holes, 0);
  EXPECT_GT(control, 0u);
}

TEST(MeshLod, InstancesKeepTheHeadersPromises) {
  const auto meshes = allMeshes();
  uint64_t nodes = 0, deepest_step = 0, single_cells = 0;
  for (uint64_t seed = kSeed + 1000; seed < kSeed + 1000 + share(300); ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    PlanarLodResult lod = c.lod->select(c.view, c.resident);
    const int unit = c.relief.unitLog2();
    auto isResident = [&](const NodeId& n) { return n.level == 0 || c.resident.count(n) != 0; };
    for (size_t k = 0; k < lod.instances.size(); ++k) {
      const PatchInstance& p = lod.instances[k];
      ++nodes;
      if (k > 0) {
        const PatchInstance& q = lod.instances[k - 1];
        ASSERT_TRUE(q.grid_level < p.grid_level || (q.grid_level == p.grid_level && q.node < p.node))
            << describe(c, seed);
      }
      const int n = p.grid_level, level = static_cast<int>(p.node.level);
      ASSERT_LE(n, kMaxGridLevel);
      single_cells += n == 0;
      ASSERT_EQ(p.step_log2 + n + level, unit) << describe(c, seed);
      deepest_step += p.step_log2 == 0;
      ASSERT_EQ(p.x0, static_cast<int64_t>(p.node.x) << (unit - level));
      ASSERT_EQ(p.y0, static_cast<int64_t>(p.node.y) << (unit - level));
      for (const auto& side : p.edges)
        ASSERT_LE(side[1] == PatchInstance::kWholeEdge ? side[0] : std::max(side[0], side[1]) + 1, n);
      if (!c.view.relief) continue;
      // The relief page: resident, covers the node, has all samples, and no coarser resident one does.
      ASSERT_TRUE(isResident(p.relief_page) && p.relief_page.level <= p.node.level &&
                  p.node.ancestor(p.relief_page.level) == p.relief_page);
      ASSERT_LE(static_cast<int>(p.relief_page.level), c.relief.depth);
      auto hasSamples = [&](uint32_t page_level) { return static_cast<int>(page_level) + 7 >= level + n; };
      ASSERT_TRUE(hasSamples(p.relief_page.level)) << describe(c, seed);
      for (uint32_t coarser = 0; coarser < p.relief_page.level; ++coarser)
        ASSERT_FALSE(hasSamples(coarser) && isResident(p.node.ancestor(coarser))) << describe(c, seed);
    }
    for (size_t k = 0; k < lod.requests.size(); ++k) {
      const ReliefRequest& b = lod.requests[k];
      ASSERT_TRUE(b.priority >= 0 && b.priority <= 1);
      ASSERT_TRUE(b.page.patch < c.named.mesh.patches.size() && static_cast<int>(b.page.level) <= c.relief.depth &&
                  b.page.x >> b.page.level == 0 && b.page.y >> b.page.level == 0);
      if (k == 0) continue;
      const ReliefRequest& a = lod.requests[k - 1];
      ASSERT_TRUE(a.page.level < b.page.level || (a.page.level == b.page.level && a.priority <= b.priority));
      ASSERT_FALSE(a.page == b.page);
    }
    if (!c.view.relief) {
      ASSERT_TRUE(lod.requests.empty());
    }
  }
  std::printf("[ figures  ] %llu nodes, %llu with the finest cells\n", static_cast<unsigned long long>(nodes),
              static_cast<unsigned long long>(deepest_step));
  EXPECT_GT(deepest_step, 0u);
  EXPECT_GT(single_cells, 0u);
}

bool sameList(const PlanarLodResult& a, const PlanarLodResult& b) {
  auto sameRequest = [](const ReliefRequest& p, const ReliefRequest& q) {
    return p.page == q.page && p.priority == q.priority;
  };
  return a.limited_by_residency == b.limited_by_residency && a.max_error_px == b.max_error_px &&
         a.error_px == b.error_px && a.instances == b.instances &&
         std::equal(a.requests.begin(), a.requests.end(), b.requests.begin(), b.requests.end(), sameRequest);
}

// What a selection keeps from earlier views changes nothing.
TEST(MeshLod, SameInputSameList) {
  const auto meshes = allMeshes();
  uint64_t different = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(60); ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]),
             fresh = randomMeshCase(seed, meshes[seed % meshes.size()]);
    PlanarLodResult first = c.lod->select(c.view, c.resident);
    Random random(seed);
    for (int k = 0; k < 3; ++k) {
      LodView other = makeView(randomMeshCamera(c.named.mesh, c.relief.unitLog2(), random), 1);
      c.lod->select(other, {});
    }
    // The same pages, inserted the other way round into a table of another size.
    std::vector<NodeId> pages(c.resident.begin(), c.resident.end());
    ReliefSet other(4 * pages.size() + 100);
    for (size_t i = pages.size(); i-- > 0;) other.insert(pages[i]);
    EXPECT_TRUE(sameList(first, c.lod->select(c.view, other))) << describe(c, seed);
    EXPECT_TRUE(sameList(first, fresh.lod->select(c.view, c.resident))) << describe(c, seed);
    LodView moved = c.view;
    moved.error_px *= 3;
    different += !sameList(first, c.lod->select(moved, c.resident));
  }
  EXPECT_GT(different, 10u / kViewShare);  // the control: the comparison sees a change
}

// Grant what is asked for: after a few rounds nothing is missing, the wants are stable, and only they are needed.
TEST(MeshLod, SettlesWhenRequestsAreGrantedAndKeepsNothingElse) {
  const auto meshes = allMeshes();
  int most_rounds = 0, over_budget = 0, cases = 0;
  size_t most_nodes = 0, most_requests = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(200); ++seed, ++cases) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    ReliefSet resident;
    PlanarLodResult lod;
    int rounds = 0;
    for (; rounds < 30; ++rounds) {
      lod = c.lod->select(c.view, resident);
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

// ---- hard views of hard meshes
void expectSane(const NamedMesh& named, const MeshRelief& relief, const LodView& view, const char* what) {
  SCOPED_TRACE(named.name + ", " + what);
  auto oracle = std::make_shared<MadeUpMeshOracle>(relief, 7, 0.01 * 65535 * relief.scale_mm);
  MeshLod selection(std::make_shared<BaseMesh>(named.mesh), relief.depth, relief.offset_mm, relief.scale_mm, oracle,
                    oracle->coarse(named.mesh.patches.size()));
  ReliefSet resident;
  PlanarLodResult lod;
  for (int round = 0; round < 3; ++round) {
    lod = selection.select(view, resident);
    for (const ReliefRequest& w : lod.requests) resident.insert(w.page);
  }
  EXPECT_TRUE(std::isfinite(lod.max_error_px)) << lod.max_error_px;
  EXPECT_GE(lod.max_error_px, 0);
  EXPECT_LT(lod.instances.size(), 30000u);
  for (const ReliefRequest& w : lod.requests) EXPECT_TRUE(w.priority >= 0 && w.priority <= 1);
  MeshHeight height = noiseOver(named.mesh, relief.unitLog2(), 3);
  MeshSeams seams = compareMeshSeams(named.mesh, relief.unitLog2(), lod.instances,
                                     twinOf<PlainOps>(named.mesh, relief, height, view));
  EXPECT_EQ(seams.mismatches, 0u);
  EXPECT_EQ(seams.unbalanced, 0u);
}

TEST(MeshLod, HardViewsOfHardMeshes) {
  std::vector<NamedMesh> meshes = hardMeshes();
  meshes.push_back({"Moebius strip", moebius(5, 60, 40)});
  for (int valence : {3, 20}) meshes.push_back({"fan of " + std::to_string(valence), fan(valence, 50)});
  constexpr double kErrorPx = 16;
  size_t turn = 0;
  auto look = [&](const NamedMesh& named, const MeshRelief& relief, const LodView& view, const char* what) {
    if (!kSanitized || turn % 5 == 0) expectSane(named, relief, view, what);
    ++turn;
  };
  for (const NamedMesh& named : meshes) {
    auto [low, high] = boxOf(named.mesh);
    const double size = std::max(glm::length(high - low), 1.0);
    const glm::dvec3 on = named.mesh.point(0, 0.3, 0.4),
                     corner = glm::dvec3(named.mesh.corners[named.mesh.patches[0][0]].position_mm),
                     along = glm::dvec3(named.mesh.corners[named.mesh.patches[0][1]].position_mm) - corner;
    for (double range_mm : {3 * size, 0.01, 0.0}) {  // larger than the patches; 10 um; none
      if (kSanitized && range_mm < size) continue;
      MeshRelief relief{2, -0.5 * range_mm, range_mm / 65535};
      Camera c;
      c.near_mm = 1e-3 * size, c.far_mm = 1e3 * size;
      c.eye = on, c.target = on + glm::dvec3(0, 0.1, 1);
      look(named, relief, makeView(c, kErrorPx), "eye on the surface");
      c.target = 0.5 * (low + high) + glm::dvec3(1e-3, 0, 0), c.eye = 0.5 * (low + high);
      look(named, relief, makeView(c, kErrorPx), "eye inside the bounds");
      c.eye = corner + 2.0 * along + glm::dvec3(0, 0, 1e-9), c.target = corner;
      if (glm::length(along) > 0) look(named, relief, makeView(c, kErrorPx), "an edge points at the eye");
      c.eye = on + glm::dvec3(0, 0, 0.3 * size), c.target = on, c.near_mm = 0.29999 * size;
      look(named, relief, makeView(c, kErrorPx), "edges through the near plane");
      c.near_mm = 1e-3 * size, c.fov_y = glm::radians(1.0);
      look(named, relief, makeView(c, kErrorPx), "1 degree");
      c.fov_y = glm::radians(170.0);
      look(named, relief, makeView(c, kErrorPx), "170 degrees");
      c.fov_y = 0.8;
      look(named, relief, orthographicView(c, size, kErrorPx), "orthographic");
      LodView view = makeView(c, kErrorPx);
      view.exaggerate = -3;
      look(named, relief, view, "negative exaggeration");
    }
  }
}

TEST(MeshLod, ViewsThatAreNoneDrawTheRoots) {
  NamedMesh named{"torus", torus(9, 5, 80, 25), true};
  MeshRelief relief{2, -1, 3.0 / 65535};
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
  auto oracle = std::make_shared<MadeUpMeshOracle>(relief, 7, 0.3);
  MeshLod selection(std::make_shared<BaseMesh>(named.mesh), relief.depth, relief.offset_mm, relief.scale_mm, oracle);
  for (const LodView& view : views) {
    PlanarLodResult lod = selection.select(view, {});
    ASSERT_EQ(lod.instances.size(), named.mesh.patches.size());
    EXPECT_TRUE(lod.requests.empty());
    EXPECT_EQ(lod.max_error_px, 0);
    for (uint32_t p = 0; p < lod.instances.size(); ++p) {
      EXPECT_EQ(lod.instances[p].node, (NodeId{p, 0, 0, 0}));
      EXPECT_EQ(lod.instances[p].grid_level, 0);
      for (const auto& side : lod.instances[p].edges)
        EXPECT_EQ(side, (std::array<uint8_t, 2>{0, PatchInstance::kWholeEdge}));
    }
  }
  // What is no number among the requests is the default, or nothing.
  LodView view = makeView(c);
  view.error_px = nan, view.exaggerate = inf, view.near_mm = -1, view.min_cell_px = nan;
  EXPECT_TRUE(std::isfinite(selection.select(view, {}).max_error_px));
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
TEST(MeshLod, OraclesThatLieAreTakenForKnowingNothing) {
  NamedMesh named{"sheet", openSheet(3, 3, 20)};
  Camera c;
  c.eye = {0, 0, 60};
  for (int kind : {0, 1, 2}) {
    std::vector<CoarseErrors> coarse(9);
    for (auto& e : coarse)
      e.fill(kind == 0   ? std::numeric_limits<float>::quiet_NaN()
             : kind == 1 ? -1.0f
                         : std::numeric_limits<float>::infinity());
    MeshLod selection(std::make_shared<BaseMesh>(named.mesh), 2, -1, 2.0 / 65535, std::make_shared<LyingOracle>(kind),
                      coarse);
    ReliefSet resident;
    PlanarLodResult lod;
    for (int round = 0; round < 6; ++round) {
      lod = selection.select(makeView(c), resident);
      for (const ReliefRequest& w : lod.requests) resident.insert(w.page);
    }
    EXPECT_TRUE(std::isfinite(lod.max_error_px));
    EXPECT_GT(lod.instances.size(), 9u);  // down to the finest samples, as far as the budget of nodes goes
    EXPECT_EQ(lod.limited_by_residency, 0u);
  }
}

// Levels are a function of the error asked for: a smaller one never asks for anything coarser. A node that would save
// less than 32 cells by being divided stays whole, and is drawn finer than asked for by no more than that.
TEST(MeshLod, SmallerErrorsNeverDrawCoarser) {
  const auto meshes = wellShapedMeshes();
  uint64_t all_fine = 0, all_coarse = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(60); ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    struct Drawn {
      bool as_asked = false;
      uint64_t cells = 0, spare = 0;
    };
    auto draw = [&](double error_px) {
      LodView view = c.view;
      view.error_px = error_px;
      PlanarLodResult lod = c.lod->select(view, c.resident);
      Drawn drawn{lod.error_px <= error_px};
      for (const PatchInstance& p : lod.instances) {
        const uint64_t cells = uint64_t{1} << (2 * p.grid_level);
        drawn.cells += cells;
        drawn.spare += std::min<uint64_t>(cells, 32);
      }
      return drawn;
    };
    const Drawn fine = draw(c.view.error_px), coarse = draw(3 * c.view.error_px);
    if (!fine.as_asked) continue;
    EXPECT_GE(fine.cells + coarse.spare, coarse.cells) << describe(c, seed);
    all_fine += fine.cells, all_coarse += coarse.cells;
  }
  std::printf("[ figures  ] %llu cells, %llu for three times the error\n", static_cast<unsigned long long>(all_fine),
              static_cast<unsigned long long>(all_coarse));
  if (!kSanitized) {
    EXPECT_GT(all_fine, all_coarse + all_coarse / 4);
  }  // few views may lack pages for more
}

// Where a part of a node asks for more than the rest, the rest is drawn without: all of it would take many more
// triangles, for the same promise.
TEST(MeshLod, NodesAreDividedWhereThatSavesTriangles) {
  // One bump in the middle of a quarter of the only patch.
  BaseMesh mesh = openSheet(1, 1, 100, 0);
  MeshRelief relief{1, -2, 4.0 / 65535};
  TrueMeshRelief truth(mesh, relief, [](const glm::dvec3& p, const Place&) {
    return 0.5 + 0.4 * std::exp(-0.02 * glm::dot(p - glm::dvec3(25, 25, 0), p - glm::dvec3(25, 25, 0)));
  });
  MeshLod lod(std::make_shared<BaseMesh>(mesh), relief.depth, relief.offset_mm, relief.scale_mm,
              std::shared_ptr<const ReliefOracle>(std::shared_ptr<void>(), &truth), truth.coarse());
  Camera c;
  c.eye = {0, 30, 150};
  LodView view = makeView(c, 0.25);
  view.as_if_resident = true;
  auto count = [](const PlanarLodResult& result) {
    uint64_t cells = 0;
    for (const PatchInstance& p : result.instances) cells += uint64_t{1} << (2 * p.grid_level);
    return cells;
  };
  const PlanarLodResult divided = lod.select(view, {});
  int finest = 0;
  for (const PatchInstance& p : divided.instances)
    finest = std::max(finest, static_cast<int>(p.node.level) + p.grid_level);
  const uint64_t cells = count(divided), as_one = uint64_t{1} << (2 * finest);
  std::printf("[ figures  ] %zu nodes, %llu cells, %llu if all were as fine; %.2f px promised\n",
              divided.instances.size(), static_cast<unsigned long long>(cells), static_cast<unsigned long long>(as_one),
              divided.max_error_px);
  EXPECT_LE(divided.max_error_px, 0.5 * (1 + 1e-9));
  EXPECT_LT(3 * cells, as_one);
}

}  // namespace
}  // namespace relievo::test
