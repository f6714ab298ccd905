// LOD over base meshes whose patches have tails (src/artwork/base_mesh.h): roots come and go like other pages, heights
// of coarse grids are always there. Whatever is resident, what is drawn has its samples, and where two nodes meet their
// vertices are the same, bit for bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {
namespace mesh_tails_test {

constexpr uint64_t kSeed = 20261121;
using TailCase = MeshTailCase;

TEST(MeshTails, SharedVerticesAreTheSameWhateverIsResident) {
  const std::vector<NamedMesh> meshes = allMeshes();
  MeshSeams total;
  uint64_t of_tails = 0, of_roots = 0, of_others = 0, mixed = 0, control = 0;
  for (uint64_t seed = kSeed; total.comparisons < share(1'000'000u) && seed < kSeed + 1500; ++seed) {
    TailCase c(seed, meshes[seed % meshes.size()]);
    const LodResult lod = c.lod->select(c.view, c.resident);
    const BaseMesh& mesh = c.named.mesh;
    MeshHeight height = noiseOver(mesh, c.relief.unitLog2(), seed);
    const MeshSeams seams =
        compareMeshSeams(mesh, c.relief.unitLog2(), lod.instances, twinOf<PlainOps>(mesh, c.relief, height, c.view));
    ASSERT_EQ(seams.mismatches, 0u) << describe(c, seed);
    ASSERT_EQ(seams.unbalanced, 0u) << describe(c, seed);
    total += seams;
    uint64_t tails = 0, pages = 0;
    for (const PatchInstance& p : lod.instances) {
      if (!c.view.relief) break;
      const int drawn = static_cast<int>(p.node.level) + p.grid_level;
      if (p.relief_page.level == kTailLevel) {
        ++tails;
        ASSERT_LE(drawn, kTailCellsLog2) << describe(c, seed);
        continue;
      }
      ++pages;
      ++(p.relief_page.level == 0 ? of_roots : of_others);
      ASSERT_TRUE(c.resident.contains(p.relief_page)) << describe(c, seed);
      ASSERT_LE(drawn, static_cast<int>(p.relief_page.level) + 7) << describe(c, seed);
      ASSERT_EQ(p.node.ancestor(p.relief_page.level), p.relief_page);
    }
    of_tails += tails;
    mixed += tails > 0 && pages > 0;
    // Were all of them drawn from tails, vertices between a tail's samples would take another's height.
    std::vector<PatchInstance> broken = lod.instances;
    for (size_t i = 0; i < broken.size(); i += 2) broken[i].relief_page.level = kTailLevel;
    if (c.view.relief)
      control += compareMeshSeams(mesh, c.relief.unitLog2(), broken, twinOf<PlainOps>(mesh, c.relief, height, c.view))
                     .mismatches;
  }
  std::printf(
      "[ figures  ] %llu vertices compared, %llu segments across patches; instances: %llu from tails, %llu from roots, "
      "%llu from finer pages; %llu lists of both\n",
      static_cast<unsigned long long>(total.comparisons), static_cast<unsigned long long>(total.across_patches),
      static_cast<unsigned long long>(of_tails), static_cast<unsigned long long>(of_roots),
      static_cast<unsigned long long>(of_others), static_cast<unsigned long long>(mixed));
  EXPECT_GE(total.comparisons, share(1'000'000u));
  EXPECT_GT(of_tails, share(1000u));
  EXPECT_GT(of_roots, share(100u));
  EXPECT_GT(of_others, share(100u));
  EXPECT_GT(mixed, share(20u));
  EXPECT_GT(control, share(1000u));
}

// With nothing resident all is drawn from tails; what is asked for leaves nothing limited in the end. Where all roots
// are resident, tails change nothing but where heights of coarse grids come from.
TEST(MeshTails, WhatIsAskedForIsEnough) {
  const std::vector<NamedMesh> meshes = wellShapedMeshes();
  int of_pages = 0, of_tails = 0;
  for (uint64_t seed = kSeed; seed < kSeed + share(80); ++seed) {
    TailCase c(seed, meshes[seed % meshes.size()]);
    ReliefSet resident;
    LodResult lod = c.lod->select(c.view, resident);
    for (const PatchInstance& p : lod.instances)
      ASSERT_TRUE(!c.view.relief || p.relief_page.level == kTailLevel) << describe(c, seed);
    for (int round = 0; round < 20; ++round) {
      const size_t before = resident.size();
      for (const ReliefRequest& request : lod.requests) resident.insert(request.page);
      if (resident.size() == before) break;
      lod = c.lod->select(c.view, resident);
    }
    EXPECT_EQ(lod.limited_by_residency, 0u) << describe(c, seed);
    MeshLod without(std::make_shared<BaseMesh>(c.named.mesh), c.relief.depth, c.relief.offset_mm, c.relief.scale_mm,
                    c.oracle, c.oracle->coarse(c.named.mesh.patches.size()));
    for (uint32_t p = 0; p < c.named.mesh.patches.size(); ++p) resident.insert({p, 0, 0, 0});
    lod = c.lod->select(c.view, resident);
    const LodResult reference = without.select(c.view, resident);
    ASSERT_EQ(lod.instances.size(), reference.instances.size()) << describe(c, seed);
    for (size_t i = 0; i < lod.instances.size(); ++i) {
      PatchInstance a = lod.instances[i], b = reference.instances[i];
      const bool tail = a.relief_page.level == kTailLevel;
      ASSERT_TRUE(!c.view.relief || (tail ? b.relief_page.level == 0 : a.relief_page == b.relief_page))
          << describe(c, seed);
      ++(tail ? of_tails : of_pages);
      a.relief_page = b.relief_page = {};
      ASSERT_EQ(a, b) << describe(c, seed) << " instance " << i;
    }
    EXPECT_EQ(lod.max_error_px, reference.max_error_px) << describe(c, seed);
    EXPECT_EQ(lod.limited_by_residency, reference.limited_by_residency) << describe(c, seed);
  }
  EXPECT_GT(of_pages, share(1000u));
  EXPECT_GT(of_tails, share(200u));
}

}  // namespace mesh_tails_test
}  // namespace relievo::test
