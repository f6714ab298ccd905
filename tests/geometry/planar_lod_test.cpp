// The planar LOD's invariants over random artworks, views and residency: watertight, tiled, balanced. What holds over
// base meshes, too, is tested in quadtree_lod_test.cpp.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdio>
#include <limits>
#include <set>

#include "tests/geometry/lod_fixture.h"

namespace relievo::test {
namespace planar_lod_test {

constexpr uint64_t kSeed = 20140612;
using Case = PlanarCase;

VertexFunction twin(const FlatDomain& domain, ReliefPages& pages, bool relief = true) {
  return [&domain, &pages, relief](const PatchInstance& p, uint32_t i, uint32_t j) {
    return patchVertex(domain, p, i, j, relief, pages);
  };
}
TEST(PlanarLod, SharedVerticesAreTheSameBitForBit) {
  SeamReport total;
  uint64_t cases = 0, drawn = 0, limited = 0, mixed = 0;
  auto start = std::chrono::steady_clock::now();
  // Bounded by count, not by time, so that a run is the same everywhere.
  for (uint64_t seed = kSeed; total.comparisons < share(10'000'000u) && cases < 4000; ++seed, ++cases) {
    Case c = randomPlanarCase(seed);
    c.view.divide_flat = seed % 2 == 0;
    LodResult lod = selectPlanarLod(c.domain, *c.oracle, c.view, c.resident);
    ReliefPages pages(c.domain, noiseHeight);
    SeamReport report = compareSeams(c.domain, lod.instances, twin(c.domain, pages, c.view.relief));
    ASSERT_EQ(report.mismatches, 0u) << describe(c, seed);
    total += report;
    drawn += lod.instances.size();
    limited += lod.limited_by_residency;
    for (const PatchInstance& p : lod.instances)
      for (const auto& side : p.edges) mixed += side[1] != PatchInstance::kWholeEdge;
  }
  double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::printf(
      "[ figures  ] seeds from %llu: %llu cases, %llu nodes, %llu shared segments (%llu limited by residency, %llu "
      "sides of "
      "halves), %llu vertices compared, %.1f s\n",
      static_cast<unsigned long long>(kSeed), static_cast<unsigned long long>(cases),
      static_cast<unsigned long long>(drawn), static_cast<unsigned long long>(total.pairs),
      static_cast<unsigned long long>(limited), static_cast<unsigned long long>(mixed),
      static_cast<unsigned long long>(total.comparisons), seconds);
  EXPECT_GE(total.comparisons, share(10'000'000u));
  EXPECT_GT(limited, 0u);
  EXPECT_GT(mixed, 0u);
}

TEST(PlanarLod, NegativeControlsOfWatertightness) {
  uint64_t unsnapped = 0, per_patch = 0, one_sided = 0, one_sided_cases = 0, finer_heights = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(60); ++seed) {
    Case c = randomPlanarCase(seed);
    LodResult lod = selectPlanarLod(c.domain, *c.oracle, c.view, c.resident);
    ReliefPages pages(c.domain, noiseHeight);
    // Without snapping.
    unsnapped += compareSeams(
                     c.domain, lod.instances,
                     [&](const PatchInstance& p, uint32_t i, uint32_t j) {
                       PatchInstance loose = p;
                       for (auto& side : loose.edges) side = {p.grid_level, PatchInstance::kWholeEdge};
                       return patchVertex(c.domain, loose, i, j, true, pages);
                     },
                     unsnappedVertex)
                     .mismatches;
    // Each node decides alone.
    std::vector<PatchInstance> alone = lod.instances;
    for (PatchInstance& p : alone)
      for (auto& side : p.edges) side = {p.grid_level, PatchInstance::kWholeEdge};
    per_patch += compareSeams(c.domain, alone, twin(c.domain, pages)).mismatches;
    // Every other node takes the edges that it would have if all pages were resident on the other side: from a run with
    // twice the pages, where the node is the same.
    ReliefSet more = c.resident;
    for (const ReliefRequest& request : lod.requests) more.insert(request.page);
    LodResult rich = selectPlanarLod(c.domain, *c.oracle, c.view, more);
    std::map<NodeId, const PatchInstance*> by_node;
    for (const PatchInstance& p : rich.instances) by_node[p.node] = &p;
    std::vector<PatchInstance> trap = lod.instances;
    bool changed = false;
    for (PatchInstance& p : trap) {
      auto found = by_node.find(p.node);
      if (found == by_node.end() || ((p.node.x + p.node.y) & 1) != 0 || found->second->edges == p.edges) continue;
      p.edges = found->second->edges;
      p.grid_level = found->second->grid_level;
      p.step_log2 = found->second->step_log2;
      p.relief_page = found->second->relief_page;
      changed = true;
    }
    if (changed) {
      ++one_sided_cases;
      one_sided += compareSeams(c.domain, trap, twin(c.domain, pages)).mismatches;
    }
    // Heights that depend on the page they were read from (a range per page, say).
    finer_heights += compareSeams(c.domain, lod.instances, [&](const PatchInstance& p, uint32_t i, uint32_t j) {
                       PatchVertex v = patchVertex(c.domain, p, i, j, true, pages);
                       v.height_q8 += p.relief_page.level;
                       return v;
                     }).mismatches;
  }
  std::printf(
      "[ figures  ] mismatches: %llu without snapping, %llu with levels per node, %llu with residency of one side "
      "(%llu cases), "
      "%llu with page-dependent heights\n",
      static_cast<unsigned long long>(unsnapped), static_cast<unsigned long long>(per_patch),
      static_cast<unsigned long long>(one_sided), static_cast<unsigned long long>(one_sided_cases),
      static_cast<unsigned long long>(finer_heights));
  EXPECT_GT(unsnapped, 0u);
  EXPECT_GT(per_patch, 0u);
  EXPECT_GT(one_sided, 0u);
  EXPECT_GT(finer_heights, 0u);
}

// ---- tiling
struct Cover {
  int64_t covered = 0, holes = 0;  // units^2 of the node squares, clipped to the artwork
  uint64_t overlaps = 0, visible_holes = 0;
};
struct CoverCheck {
  const Case& c;
  const PlacedIndex& index;
  std::set<std::array<int64_t, 3>> inner;  // ancestors of drawn nodes
  Cover cover;
  int64_t width, height;

  CoverCheck(const Case& in, const PlacedIndex& placed) : c(in), index(placed) {
    width = static_cast<int64_t>(c.domain.width_px) << kUnitsPerTexelLog2;
    height = static_cast<int64_t>(c.domain.height_px) << kUnitsPerTexelLog2;
    for (const auto& [place, p] : index.all())
      for (std::array<int64_t, 3> a = place; a[0] > 0;) {
        a = {a[0] - 1, a[1] >> 1, a[2] >> 1};
        if (!inner.insert(a).second) break;
      }
  }
  bool insideFrustum(double x_units, double y_units, double z_mm) const {
    double mm = c.domain.mm_per_px / (1 << kUnitsPerTexelLog2);
    glm::dvec4 p = c.view.clip_from_world * glm::dvec4((x_units - 0.5 * static_cast<double>(width)) * mm,
                                                       (0.5 * static_cast<double>(height) - y_units) * mm,
                                                       z_mm * c.view.exaggerate, 1);
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w && std::abs(p.z) <= p.w;
  }
  void visit(int64_t level, int64_t x, int64_t y) {
    int shift = index.unitLog2() - static_cast<int>(level);
    int64_t x0 = x << shift, y0 = y << shift, x1 = std::min((x + 1) << shift, width),
            y1 = std::min((y + 1) << shift, height);
    if (x0 >= width || y0 >= height) return;
    bool is_inner = inner.count({level, x, y}) != 0;
    if (index.at(static_cast<int>(level), x, y)) {
      cover.covered += (x1 - x0) * (y1 - y0);
      cover.overlaps += is_inner;
      return;
    }
    if (is_inner) {
      for (int k = 0; k < 4; ++k) visit(level + 1, 2 * x + (k & 1), 2 * y + (k >> 1));
      return;
    }
    cover.holes += (x1 - x0) * (y1 - y0);
    double z0 = c.view.relief ? c.domain.relief_offset_mm : 0,
           z1 = c.view.relief ? z0 + 65535 * c.domain.relief_scale_mm : 0;
    for (int j = 0; j <= 8; ++j)
      for (int i = 0; i <= 8; ++i)
        for (double z : {z0, 0.5 * (z0 + z1), z1})
          if (insideFrustum(static_cast<double>(x0) + static_cast<double>(x1 - x0) * i / 8.0,
                            static_cast<double>(y0) + static_cast<double>(y1 - y0) * j / 8.0, z)) {
            ++cover.visible_holes;
            return;
          }
  }
  void run() {
    for (int64_t patch = 0; patch < c.domain.patchCount(); ++patch)
      visit(0, c.domain.alongX() ? patch : 0, c.domain.alongX() ? 0 : patch);
  }
};

TEST(PlanarLod, DrawnNodesTileWhatIsInView) {
  int cases = 0, with_holes = 0;
  uint64_t control = 0;
  for (uint64_t seed = kSeed; cases < share(300); ++seed) {
    Case c = randomPlanarCase(seed, false);
    c.view.divide_flat = seed % 2 == 0;
    ++cases;
    LodResult lod = selectPlanarLod(c.domain, *c.oracle, c.view, c.resident);
    PlacedIndex index(c.domain, lod.instances);
    ASSERT_EQ(index.all().size(), lod.instances.size()) << describe(c, seed);
    CoverCheck check(c, index);
    check.run();
    EXPECT_EQ(check.cover.covered + check.cover.holes, check.width * check.height) << describe(c, seed);
    EXPECT_EQ(check.cover.overlaps, 0u) << describe(c, seed);
    EXPECT_EQ(check.cover.visible_holes, 0u) << describe(c, seed);
    with_holes += check.cover.holes > 0;
    // Points on the artwork that are in view lie in exactly one drawn node.
    Random random(seed);
    for (int k = 0; k < 200; ++k) {
      double x = random.real(0, 1) * static_cast<double>(check.width),
             y = random.real(0, 1) * static_cast<double>(check.height);
      double z = c.view.relief ? c.domain.relief_offset_mm + random.real(0, 65535) * c.domain.relief_scale_mm : 0;
      if (!check.insideFrustum(x, y, z)) continue;
      int count = 0;
      index.covering(static_cast<int64_t>(x), static_cast<int64_t>(y), &count);
      ASSERT_EQ(count, 1) << describe(c, seed);
    }
    // Negative control: a node in the middle of the list is forgotten.
    if (lod.instances.size() > 3) {
      std::vector<PatchInstance> fewer = lod.instances;
      fewer.erase(fewer.begin() + static_cast<ptrdiff_t>(fewer.size() / 2));
      PlacedIndex broken(c.domain, fewer);
      CoverCheck again(c, broken);
      again.run();
      control += again.cover.visible_holes;
    }
  }
  EXPECT_GT(with_holes, 0);
  EXPECT_GT(control, 0u);
}

TEST(PlanarLod, InstancesKeepTheHeadersPromises) {
  uint64_t nodes = 0;
  for (uint64_t seed = kSeed + 1000; seed < kSeed + 1000 + share(300); ++seed) {
    Case c = randomPlanarCase(seed);
    c.view.divide_flat = seed % 2 == 0;
    LodResult lod = selectPlanarLod(c.domain, *c.oracle, c.view, c.resident);
    PlacedIndex index(c.domain, lod.instances);
    auto isResident = [&](const NodeId& n) { return n.level == 0 || c.resident.count(n) != 0; };
    for (size_t k = 0; k < lod.instances.size(); ++k) {
      const PatchInstance& p = lod.instances[k];
      ++nodes;
      if (k > 0) {
        const PatchInstance& q = lod.instances[k - 1];
        ASSERT_TRUE(q.grid_level < p.grid_level || (q.grid_level == p.grid_level && q.node < p.node))
            << describe(c, seed);
      }
      int n = p.grid_level, u = index.unitLog2(), level = static_cast<int>(p.node.level);
      ASSERT_TRUE(n >= 1 && n <= kMaxGridLevel);
      ASSERT_EQ(p.step_log2 + n + level, u) << describe(c, seed);
      ASSERT_EQ(p.x0, static_cast<int64_t>(c.domain.patchOriginX(p.node.patch)) * 16 +
                          (static_cast<int64_t>(p.node.x) << (u - level)));
      ASSERT_EQ(p.y0, static_cast<int64_t>(c.domain.patchOriginY(p.node.patch)) * 16 +
                          (static_cast<int64_t>(p.node.y) << (u - level)));
      int most = 1;
      for (const auto& side : p.edges) {
        most = std::max<int>(most, side[1] == PatchInstance::kWholeEdge ? side[0] : std::max(side[0], side[1]) + 1);
      }
      ASSERT_EQ(most, n) << describe(c, seed);
      if (!c.view.relief) continue;
      // The relief page: resident, covers the node, has all samples, and no coarser resident one does.
      ASSERT_TRUE(isResident(p.relief_page) && p.relief_page.level <= p.node.level &&
                  p.node.ancestor(p.relief_page.level) == p.relief_page);
      auto hasSamples = [&](uint32_t page_level) {
        return static_cast<int>(page_level) == c.domain.relief_depth || static_cast<int>(page_level) + 7 >= level + n;
      };
      ASSERT_TRUE(hasSamples(p.relief_page.level)) << describe(c, seed);
      for (uint32_t coarser = 0; coarser < p.relief_page.level; ++coarser)
        ASSERT_FALSE(hasSamples(coarser) && isResident(p.node.ancestor(coarser))) << describe(c, seed);
    }
    // 2:1 over the whole strip.
    for (const auto& [place, p] : index.all())
      for (int side = 0; side < 4; ++side) {
        int64_t x = place[1] + (side == kLeft    ? -1
                                : side == kRight ? 1
                                                 : 0),
                y = place[2] + (side == kTop      ? -1
                                : side == kBottom ? 1
                                                  : 0);
        if (x < 0 || y < 0) continue;
        for (int up = 2; up <= place[0]; ++up)
          ASSERT_EQ(index.at(static_cast<int>(place[0]) - up, x >> up, y >> up), nullptr) << describe(c, seed);
      }
    for (size_t k = 1; k < lod.requests.size(); ++k) {
      const ReliefRequest &a = lod.requests[k - 1], &b = lod.requests[k];
      ASSERT_TRUE(a.page.level < b.page.level || (a.page.level == b.page.level && a.priority <= b.priority));
      ASSERT_FALSE(a.page == b.page);
    }
    for (const ReliefRequest& w : lod.requests) {
      ASSERT_TRUE(c.domain.nodeExists(w.page) && static_cast<int>(w.page.level) <= c.domain.relief_depth);
      ASSERT_TRUE(w.priority >= 0 && w.priority <= 1);
    }
  }
  std::printf("[ figures  ] %llu nodes\n", static_cast<unsigned long long>(nodes));
}

// ---- hard views
void expectSane(const FlatDomain& domain, const LodView& view, const char* what, bool settle = true) {
  MadeUpOracle oracle(domain, 7);
  ReliefSet resident;
  LodResult lod;
  for (int round = 0; round < (settle ? kSanitized ? 2 : 8 : 1); ++round) {
    lod = selectPlanarLod(domain, oracle, view, resident);
    for (const ReliefRequest& w : lod.requests) resident.insert(w.page);
  }
  SCOPED_TRACE(what);
  EXPECT_TRUE(std::isfinite(lod.max_error_px));
  EXPECT_GE(lod.max_error_px, 0);
  EXPECT_LT(lod.instances.size(), 30000u);
  for (const ReliefRequest& w : lod.requests) EXPECT_TRUE(w.priority >= 0 && w.priority <= 1);
  ReliefPages pages(domain, noiseHeight);
  SeamReport seams = compareSeams(domain, lod.instances, twin(domain, pages, view.relief));
  EXPECT_EQ(seams.mismatches, 0u);
  std::printf("[ figures  ] %-34s %6zu nodes %6zu wants  error %.3g px\n", what, lod.instances.size(),
              lod.requests.size(), lod.max_error_px);
}

TEST(PlanarLod, HardViews) {
  FlatDomain domain = makeDomain(30000, 20000, 0);
  Camera c;
  c.far_mm = 1e4;
  c.eye = {10, 20, 0.001}, c.target = {500, 30, 0}, c.near_mm = 0.01;
  expectSane(domain, makeView(c), "eye on the surface");
  c.eye = {10, 20, -0.5};
  expectSane(domain, makeView(c), "eye under the surface");
  c.eye = {0, 0, 3}, c.target = {0, 0, 0}, c.near_mm = 2.9999;
  expectSane(domain, makeView(c), "edges through the near plane");
  c.eye = {-760, 0, 0}, c.target = {0, 0, 0}, c.near_mm = 0.1;
  expectSane(domain, makeView(c), "edges point at the eye");
  c.eye = {0, 0, 20}, c.target = {0, 0, 40};
  expectSane(domain, makeView(c), "looking away");
  c.eye = {0, 0, 300}, c.target = {0, 0, 0}, c.fov_y = glm::radians(1.0);
  expectSane(domain, makeView(c), "1 degree");
  c.fov_y = glm::radians(170.0);
  expectSane(domain, makeView(c), "170 degrees");
  c.fov_y = glm::radians(170.0), c.eye = {0, 0, 1};
  expectSane(domain, makeView(c), "170 degrees, close");
  c.fov_y = 0.8, c.eye = {0, 0, 1500};
  LodView view = makeView(c);
  view.error_px = 0;
  expectSane(domain, view, "no error allowed");
  view.error_px = std::numeric_limits<double>::quiet_NaN();
  expectSane(domain, view, "error NaN", false);
  view = makeView(c);
  view.exaggerate = -3;
  expectSane(domain, view, "negative exaggeration");
  view.exaggerate = 0;
  expectSane(domain, view, "exaggeration 0");
  view.exaggerate = 1e6;
  expectSane(domain, view, "exaggeration 1e6");
  view = makeView(c);
  view.relief = false;
  expectSane(domain, view, "flat");
  view = makeView(c);
  view.clip_from_world[1][2] = std::numeric_limits<double>::quiet_NaN();
  expectSane(domain, view, "NaN matrix");
  view.clip_from_world = glm::dmat4(0.0);
  expectSane(domain, view, "zero matrix");
  view = makeView(c);
  view.eye_mm.x = std::numeric_limits<double>::infinity();
  expectSane(domain, view, "infinite eye");
  view = makeView(c);
  view.clip_from_world = glm::ortho(-800.0, 800.0, -500.0, 500.0, -100.0, 100.0);
  view.pixels_per_radian = 1.0;
  expectSane(domain, view, "orthographic, all");
  view.clip_from_world = glm::ortho(3.0, 5.0, 3.0, 4.5, -100.0, 100.0);
  view.pixels_per_radian = 800;
  expectSane(domain, view, "orthographic, close");

  FlatDomain level = domain;
  level.relief_scale_mm = 0;
  level.relief_offset_mm = 2;
  expectSane(level, makeView(c), "zero relief range");
  FlatDomain none = domain;
  none.relief_depth = -1;
  view = makeView(c);
  LodResult lod = selectPlanarLod(none, MadeUpOracle(none, 1), view, {});
  EXPECT_TRUE(lod.requests.empty());
  EXPECT_FALSE(lod.instances.empty());
  FlatDomain strip = makeDomain(1u << 26, 100, 0);
  c.eye = {0, 0, 1e6}, c.near_mm = 1, c.far_mm = 1e8;
  view = makeView(c);
  lod = selectPlanarLod(strip, MadeUpOracle(strip, 1), view, {});
  std::printf("[ figures  ] 2^26 x 100 strip: %zu nodes of %u patches\n", lod.instances.size(), strip.patchCount());
  EXPECT_LE(lod.instances.size(), strip.patchCount());
}

// What the metric ignores on purpose: an edge that points at the eye, displacement that points at the eye.
TEST(PlanarLod, StraightDownDoesNotSwallowTheRelief) {
  FlatDomain domain = makeDomain(4096, 4096, 0);
  Camera c;
  c.eye = {0, 0, 50};
  LodView view = makeView(c);
  MadeUpOracle oracle(domain, 3);
  LodResult lod = selectPlanarLod(domain, oracle, view, {});
  EXPECT_GT(lod.limited_by_residency, 0u);
}

}  // namespace planar_lod_test
}  // namespace relievo::test
