// Watertight over base meshes: where two drawn nodes meet, the vertices of both are the same, bit for bit, whatever their levels, patches,
// orientation and resident pages; with plain arithmetic, and with models of GPUs that contract a * b + c to fma.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {
namespace {

constexpr uint64_t kSeed = 20260401;

struct FmaSecond {  // a * b rounds, the second product does not
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(c, d, a * b); }
};
struct FmaFirst {
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(a, b, c * d); }
};

struct Case {
  NamedMesh named;
  MeshRelief relief;
  std::shared_ptr<MadeUpMeshOracle> oracle;
  std::unique_ptr<MeshLod> lod;
  LodView view;
  ReliefSet resident;
};
Case randomCase(uint64_t seed, NamedMesh named) {
  Random random(seed);
  Case c;
  c.named = std::move(named);
  turnPatches(c.named.mesh, random);
  auto [low, high] = boxOf(c.named.mesh);
  c.relief.depth = random.integer(0, 6);
  c.relief.scale_mm = glm::length(high - low) * std::exp(random.real(-9, -2.5)) / 65535;
  c.relief.offset_mm = -random.real(0, 1) * 65535 * c.relief.scale_mm;
  double error = 65535 * c.relief.scale_mm * random.real(0.01, 1);
  c.oracle = std::make_shared<MadeUpMeshOracle>(c.relief, random.engine(), error);
  c.lod = std::make_unique<MeshLod>(std::make_shared<BaseMesh>(c.named.mesh), c.relief.depth, c.relief.offset_mm, c.relief.scale_mm, c.oracle,
                                    random.chance(0.8) ? c.oracle->coarse(c.named.mesh.patches.size()) : std::vector<CoarseErrors>{});
  Camera camera = randomMeshCamera(c.named.mesh, c.relief.unitLog2(), random);
  double error_px = random.real(0.5, 8);
  c.view = random.chance(0.15) ? orthographicView(camera, glm::length(camera.eye - camera.target), error_px) : makeView(camera, error_px);
  c.view.exaggerate = random.chance(0.3) ? random.real(0, 3) : 1;
  c.view.relief = !random.chance(0.1);
  c.view.min_cell_px = random.chance(0.3) ? random.real(0.5, 4) : 0;
  c.resident = randomMeshResidency(*c.lod, c.view, random);
  return c;
}
std::string describe(const Case& c, uint64_t seed) {
  return "seed " + std::to_string(seed) + ", " + c.named.name + ", relief depth " + std::to_string(c.relief.depth) + ", " +
         std::to_string(c.resident.size()) + " pages resident";
}

TEST(MeshWatertight, SharedVerticesAreTheSameBitForBit) {
  std::vector<NamedMesh> meshes = wellShapedMeshes();
  for (NamedMesh& hard : hardMeshes()) meshes.push_back(std::move(hard));
  MeshSeams total;
  uint64_t cases = 0, nodes = 0, limited = 0, halves = 0;
  for (uint64_t seed = kSeed; total.comparisons < 10'000'000 / kViewShare && cases < 4000; ++seed, ++cases) {
    Case c = randomCase(seed, meshes[seed % meshes.size()]);
    PlanarLodResult lod = c.lod->select(c.view, c.resident);
    const BaseMesh& mesh = c.named.mesh;
    MeshHeight height = noiseOver(mesh, c.relief.unitLog2(), seed);
    for (const MeshVertexFunction& twin : {twinOf<PlainOps>(mesh, c.relief, height, c.view), twinOf<FmaFirst>(mesh, c.relief, height, c.view),
                                           twinOf<FmaSecond>(mesh, c.relief, height, c.view)}) {
      MeshSeams seams = compareMeshSeams(mesh, c.relief.unitLog2(), lod.instances, twin);
      ASSERT_EQ(seams.mismatches, 0u) << describe(c, seed);
      total += seams;
    }
    nodes += lod.instances.size();
    limited += lod.limited_by_residency;
    for (const PatchInstance& p : lod.instances)
      for (const auto& side : p.edges) halves += side[1] != PatchInstance::kWholeEdge;
  }
  std::printf("[ figures  ] seeds from %llu: %llu cases, %llu nodes, %llu shared segments (%llu across patches, %llu limited by residency, %llu "
              "sides of halves), %llu vertices compared\n",
              static_cast<unsigned long long>(kSeed), static_cast<unsigned long long>(cases), static_cast<unsigned long long>(nodes),
              static_cast<unsigned long long>(total.pairs), static_cast<unsigned long long>(total.across_patches),
              static_cast<unsigned long long>(limited), static_cast<unsigned long long>(halves), static_cast<unsigned long long>(total.comparisons));
  EXPECT_GE(total.comparisons, 10'000'000u / kViewShare);
  EXPECT_GT(limited, 0u);
  EXPECT_GT(halves, 0u);
  EXPECT_GT(total.across_patches, 0u);
}

}  // namespace
}  // namespace relievo::test
