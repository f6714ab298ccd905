// The LOD over base meshes: what is drawn tiles what is in view, levels are balanced and have samples, hard geometry
// and hard views end well. What holds for flat artworks, too, is tested in quadtree_lod_test.cpp.
#include <gtest/gtest.h>

#include <cstdio>
#include <limits>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {
namespace mesh_lod_test {

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
    LodResult lod = c.lod->select(c.view, c.resident);
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
    LodResult lod = c.lod->select(c.view, c.resident);
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

// ---- hard views of hard meshes
void expectSane(const NamedMesh& named, const MeshRelief& relief, const LodView& view, const char* what) {
  SCOPED_TRACE(named.name + ", " + what);
  auto oracle = std::make_shared<MadeUpMeshOracle>(relief, 7, 0.01 * 65535 * relief.scale_mm);
  MeshLod selection(std::make_shared<BaseMesh>(named.mesh), relief.depth, relief.offset_mm, relief.scale_mm, oracle,
                    oracle->coarse(named.mesh.patches.size()));
  ReliefSet resident;
  LodResult lod;
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
    if (turn % (kSanitized ? 5 : longTests() ? 1 : 3) == 0) expectSane(named, relief, view, what);
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

}  // namespace mesh_lod_test
}  // namespace relievo::test
