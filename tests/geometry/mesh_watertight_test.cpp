// Watertight over base meshes: where two drawn nodes meet, the vertices of both are the same, bit for bit, whatever
// their levels, patches, orientation and resident pages; with plain arithmetic, and with models of GPUs that contract a
// * b + c to fma. RELIEVO_LONG_TESTS=1: 10^9 comparisons of each sort instead of 10^7.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdio>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {
namespace mesh_watertight_test {

constexpr uint64_t kSeed = 20260401;

// Of each test that counts them.
uint64_t wantedComparisons() { return longTests() ? 1'000'000'000 : 10'000'000 / kViewShare; }

TEST(MeshWatertight, SharedVerticesAreTheSameBitForBit) {
  const std::vector<NamedMesh> meshes = allMeshes();
  const uint64_t wanted = wantedComparisons(), most_cases = longTests() ? 400'000 : 4000;
  MeshSeams total;
  uint64_t cases = 0, nodes = 0, limited = 0, halves = 0;
  for (uint64_t seed = kSeed; total.comparisons < wanted && cases < most_cases; ++seed, ++cases) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    LodResult lod = c.lod->select(c.view, c.resident);
    const BaseMesh& mesh = c.named.mesh;
    MeshHeight height = noiseOver(mesh, c.relief.unitLog2(), seed);
    for (const MeshVertexFunction& twin :
         {twinOf<PlainOps>(mesh, c.relief, height, c.view), twinOf<FmaFirst>(mesh, c.relief, height, c.view),
          twinOf<FmaSecond>(mesh, c.relief, height, c.view)}) {
      MeshSeams seams = compareMeshSeams(mesh, c.relief.unitLog2(), lod.instances, twin);
      ASSERT_EQ(seams.mismatches, 0u) << describe(c, seed);
      ASSERT_EQ(seams.unbalanced, 0u) << describe(c, seed);
      total += seams;
    }
    nodes += lod.instances.size();
    limited += lod.limited_by_residency;
    for (const PatchInstance& p : lod.instances)
      for (const auto& side : p.edges) halves += side[1] != PatchInstance::kWholeEdge;
  }
  std::printf(
      "[ figures  ] seeds from %llu: %llu cases, %llu nodes, %llu shared segments (%llu across patches, %llu limited "
      "by residency, %llu "
      "sides of halves), %llu vertices compared\n",
      static_cast<unsigned long long>(kSeed), static_cast<unsigned long long>(cases),
      static_cast<unsigned long long>(nodes), static_cast<unsigned long long>(total.pairs),
      static_cast<unsigned long long>(total.across_patches), static_cast<unsigned long long>(limited),
      static_cast<unsigned long long>(halves), static_cast<unsigned long long>(total.comparisons));
  EXPECT_GE(total.comparisons, wanted);
  EXPECT_GT(limited, 0u);
  EXPECT_GT(halves, 0u);
  EXPECT_GT(total.across_patches, 0u);
}

// As meshVertexFromEye without its rule: a side runs as its patch does. (Where nothing is contracted, lo * s + hi * t
// is the same either way round: only a model of contraction tells.)
template <class Ops>
glm::vec3 unorderedVertex(const BaseMesh& mesh, uint32_t patch, const glm::dvec3& eye, uint32_t x, uint32_t y,
                          uint32_t side, float mm) {
  const auto& c = mesh.patches[patch];
  float u = static_cast<float>(x) / static_cast<float>(side), v = static_cast<float>(y) / static_cast<float>(side);
  auto across = [&](auto&& field) {
    return lerpOrdered<Ops>(lerpOrdered<Ops>(field(c[0]), field(c[1]), u),
                            lerpOrdered<Ops>(field(c[2]), field(c[3]), u), v);
  };
  glm::vec3 p = across([&](uint32_t k) { return glm::vec3(glm::dvec3(mesh.corners[k].position_mm) - eye); });
  glm::vec3 n = across([&](uint32_t k) { return mesh.corners[k].normal; });
  return p + n * mm;
}

TEST(MeshWatertight, NegativeControls) {
  const std::vector<NamedMesh> meshes = wellShapedMeshes();
  uint64_t unsnapped = 0, alone = 0, snapped_alone = 0, unordered = 0, ranges = 0, one_sided = 0, straight = 0;
  for (uint64_t seed = kSeed; seed < kSeed + (kSanitized ? 15 : 60); ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    const BaseMesh& mesh = c.named.mesh;
    const int unit = c.relief.unitLog2();
    LodResult lod = c.lod->select(c.view, c.resident);
    MeshHeight height = noiseOver(mesh, unit, seed);
    MeshVertexFunction twin = twinOf<PlainOps>(mesh, c.relief, height, c.view);
    unsnapped += compareMeshSeams(mesh, unit, lod.instances, twin, false).mismatches;
    // Each node decides alone: all of its sides are as the coarsest of them, and its vertices snap to that.
    std::vector<PatchInstance> own = lod.instances;
    for (PatchInstance& p : own) {
      uint8_t coarsest = p.grid_level;
      for (const auto& side : p.edges) coarsest = std::min({coarsest, side[0], side[1]});
      for (auto& side : p.edges) side = {coarsest, PatchInstance::kWholeEdge};
      snapped_alone += coarsest < p.grid_level;
    }
    alone += compareMeshSeams(mesh, unit, own, twin).mismatches;
    unordered += compareMeshSeams(mesh, unit, lod.instances, [&](const PatchInstance& p, uint32_t x, uint32_t y) {
                   return bitsOf(unorderedVertex<FmaSecond>(mesh, p.node.patch, c.view.eye_mm, x, y, 1u << unit,
                                                            c.relief.mm(height(p.node.patch, x, y), 1)));
                 }).mismatches;
    // The same heights, to half a step, in 16 bits of a range that is the patch's own.
    ranges += compareMeshSeams(mesh, unit, lod.instances, [&](const PatchInstance& p, uint32_t x, uint32_t y) {
                MeshRelief range = c.relief;
                range.scale_mm *= 1 + 0.1 * p.node.patch;
                auto q = static_cast<uint16_t>(
                    std::min(65535.0, std::round(height(p.node.patch, x, y) * c.relief.scale_mm / range.scale_mm)));
                const auto& k = mesh.patches[p.node.patch];
                std::array<EyeCorner, 4> corners;
                for (size_t i = 0; i < 4; ++i)
                  corners[i] = {glm::vec3(glm::dvec3(mesh.corners[k[i]].position_mm) - c.view.eye_mm),
                                mesh.corners[k[i]].normal};
                return bitsOf(meshVertexFromEye(k, corners, x, y, 1u << unit, range.mm(q, 1), mesh.cut));
              }).mismatches;
    // Every other node takes the edges that it would have if more pages were resident.
    ReliefSet more = c.resident;
    for (const ReliefRequest& request : lod.requests) more.insert(request.page);
    std::map<NodeId, PatchInstance> rich;
    for (const PatchInstance& p : c.lod->select(c.view, more).instances) rich[p.node] = p;
    std::vector<PatchInstance> trap = lod.instances;
    for (PatchInstance& p : trap)
      if (auto found = rich.find(p.node); found != rich.end() && ((p.node.x + p.node.y + p.node.patch) & 1))
        p = found->second;
    one_sided += compareMeshSeams(mesh, unit, trap, twin).mismatches;
    // Half edges in the neighbour's order, where that runs the other way.
    std::vector<PatchInstance> swapped = lod.instances;
    for (PatchInstance& p : swapped)
      for (auto& side : p.edges)
        if (side[1] != PatchInstance::kWholeEdge) std::swap(side[0], side[1]);
    straight += compareMeshSeams(mesh, unit, swapped, twin).mismatches;
  }
  std::printf(
      "[ figures  ] mismatches: %llu without snapping, %llu with levels per node (vertices of %llu nodes snap), %llu "
      "with ends unordered, %llu with a range per patch, %llu with "
      "residency of one side, %llu with halves exchanged\n",
      static_cast<unsigned long long>(unsnapped), static_cast<unsigned long long>(alone),
      static_cast<unsigned long long>(snapped_alone), static_cast<unsigned long long>(unordered),
      static_cast<unsigned long long>(ranges), static_cast<unsigned long long>(one_sided),
      static_cast<unsigned long long>(straight));
  EXPECT_GT(unsnapped, 0u);
  EXPECT_GT(alone, 0u);
  EXPECT_GT(snapped_alone, 0u);
  EXPECT_NE(alone, unsnapped) << "the control of snapping once more";
  EXPECT_GT(unordered, 0u);
  EXPECT_GT(ranges, 0u);
  EXPECT_GT(one_sided, 0u);
  EXPECT_GT(straight, 0u);
}

// ---- every pair of levels, whatever a selection would choose
// Two patches that share a side, somehow turned, with the side's segment drawn by nodes and grids of any two levels.
struct Pair {
  std::array<std::array<uint32_t, 4>, 2> index{};
  std::array<std::array<EyeCorner, 4>, 2> corner{};
  std::array<int, 2> side{};
};
Pair randomPair(Random& random) {
  std::array<uint32_t, 6> names{};
  for (uint32_t& n : names) n = static_cast<uint32_t>(random.integer(0, 1 << 20));
  std::array<EyeCorner, 6> at;
  const double size = std::exp(random.real(-2, 6)), far = std::exp(random.real(-2, 8));
  const glm::dvec3 centre(random.real(-far, far), random.real(-far, far), random.real(-far, far));
  for (EyeCorner& c : at) {
    c.from_eye_mm = glm::vec3(centre + size * glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1)));
    c.normal = glm::vec3(glm::normalize(glm::dvec3(random.real(-1, 1), random.real(-1, 1), random.real(0.1, 2))));
  }
  Pair pair;
  for (size_t k = 0; k < 2; ++k) {
    const int side = random.integer(0, 3);
    const bool turned = random.chance(0.5);
    std::array<int, 4> who{};
    who[static_cast<size_t>(kSideCorners[static_cast<size_t>(side)][0])] = turned ? 1 : 0;
    who[static_cast<size_t>(kSideCorners[static_cast<size_t>(side)][1])] = turned ? 0 : 1;
    const int opposite = side ^ 1;
    who[static_cast<size_t>(kSideCorners[static_cast<size_t>(opposite)][0])] = static_cast<int>(2 + 2 * k);
    who[static_cast<size_t>(kSideCorners[static_cast<size_t>(opposite)][1])] = static_cast<int>(3 + 2 * k);
    for (size_t i = 0; i < 4; ++i) {
      pair.index[k][i] = names[static_cast<size_t>(who[i])];
      pair.corner[k][i] = at[static_cast<size_t>(who[i])];
    }
    pair.side[k] = side;
  }
  return pair;
}
struct PairCount {
  uint64_t comparisons = 0, mismatches = 0;
};
template <class Ops>
void comparePair(const Pair& pair, int unit_log2, int level, uint32_t segment, int edge_level,
                 const std::array<int, 2>& grid, const std::array<bool, 2>& half, const std::vector<float>& heights,
                 PairCount& count) {
  // Grid vertices of each node's side, snapped, as places from the corner with the smaller name.
  std::array<std::vector<std::pair<uint32_t, Bits>>, 2> seen;
  const uint32_t side_units = 1u << unit_log2, width = side_units >> level;
  for (size_t k = 0; k < 2; ++k) {
    const int side = pair.side[k];
    const bool upright = side == kLeft || side == kRight;
    const auto& ends = kSideCorners[static_cast<size_t>(side)];
    const bool flip = pair.index[k][static_cast<size_t>(ends[0])] > pair.index[k][static_cast<size_t>(ends[1])];
    const uint32_t mine = flip ? (1u << level) - 1 - segment : segment;
    const auto n = static_cast<uint32_t>(grid[k]);
    // A node of this level, or one above that has the segment as half of its side.
    uint32_t first = 0, last = 1u << n, origin = mine * width, step = width >> n;
    std::array<uint8_t, 2> record{static_cast<uint8_t>(edge_level), PatchInstance::kWholeEdge};
    if (half[k]) {
      const uint32_t which = mine & 1;
      record = {static_cast<uint8_t>(which ? n - 1 : edge_level), static_cast<uint8_t>(which ? edge_level : n - 1)};
      origin = (mine - which) * width;
      step = 2 * width >> n;
      first = which ? last / 2 : 0;
      last = which ? last : last / 2;
    }
    for (uint32_t i = first; i <= last; ++i) {
      const uint32_t t = origin + snapOnSide(i, n, record) * step, place = flip ? side_units - t : t;
      if (!seen[k].empty() && seen[k].back().first == place) continue;
      const uint32_t across = side == kRight || side == kBottom ? side_units : 0;
      const glm::vec3 v =
          meshVertexFromEye<Ops>(pair.index[k], pair.corner[k], upright ? across : t, upright ? t : across, side_units,
                                 heights[place & (heights.size() - 1)], false);
      seen[k].push_back({place, bitsOf(v)});
    }
    if (flip) std::reverse(seen[k].begin(), seen[k].end());
  }
  count.comparisons += std::max(seen[0].size(), seen[1].size());
  if (seen[0].size() != seen[1].size()) {
    count.mismatches += std::max(seen[0].size(), seen[1].size());
    return;
  }
  for (size_t i = 0; i < seen[0].size(); ++i) count.mismatches += seen[0][i] != seen[1][i];
}
PairCount comparePairs(uint64_t seed, uint64_t wanted) {
  Random random(seed);
  PairCount count;
  std::vector<float> heights(1024);
  while (count.comparisons < wanted) {
    const Pair pair = randomPair(random);
    if (pair.index[0][static_cast<size_t>(kSideCorners[static_cast<size_t>(pair.side[0])][0])] ==
        pair.index[0][static_cast<size_t>(kSideCorners[static_cast<size_t>(pair.side[0])][1])])
      continue;
    const double scale = std::exp(random.real(-8, 3));
    for (float& h : heights)
      h = static_cast<float>(scale) * static_cast<float>(random.engine() >> 48) + static_cast<float>(-20000 * scale);
    const int unit_log2 = random.integer(7, 20), level = random.integer(0, unit_log2 - kMaxGridLevel);
    const auto segment = static_cast<uint32_t>(random.engine() & ((1u << level) - 1));
    for (bool half_a : {false, true})
      for (bool half_b : {false, true}) {
        if ((half_a || half_b) && level == 0) continue;
        for (int a = 1; a <= kMaxGridLevel; ++a)
          for (int b = 1; b <= kMaxGridLevel; ++b)
            for (int m = 0; m <= std::min(a - half_a, b - half_b); ++m) {
              comparePair<PlainOps>(pair, unit_log2, level, segment, m, {a, b}, {half_a, half_b}, heights, count);
              comparePair<FmaFirst>(pair, unit_log2, level, segment, m, {a, b}, {half_a, half_b}, heights, count);
              comparePair<FmaSecond>(pair, unit_log2, level, segment, m, {a, b}, {half_a, half_b}, heights, count);
            }
      }
  }
  return count;
}

// Inside a patch as on its sides, a vertex is the surface's point, whether the patch is cut or not.
TEST(MeshVertex, IsThePointOfTheBaseMesh) {
  Random random(kSeed);
  double largest = 0, other = 0;
  for (const bool cut : {false, true})
    for (int k = 0; k < 100; ++k) {
      BaseMesh mesh;
      mesh.cut = cut;
      mesh.patches = {{0, 1, 2, 3}};
      std::array<EyeCorner, 4> corners;
      for (EyeCorner& c : corners) {
        c.from_eye_mm = {random.real(-10, 10), random.real(-10, 10), random.real(-10, 10)};
        c.normal = glm::normalize(glm::vec3(random.real(-1, 1), random.real(-1, 1), 2));
        mesh.corners.push_back({c.from_eye_mm, c.normal});
      }
      BaseMesh otherwise = mesh;
      otherwise.cut = !cut;
      constexpr uint32_t kSide = 32;
      for (uint32_t y = 0; y <= kSide; ++y)
        for (uint32_t x = 0; x <= kSide; ++x) {
          const double u = static_cast<double>(x) / kSide, v = static_cast<double>(y) / kSide, height = 0.75;
          const auto vertex = glm::dvec3(meshVertexFromEye({0, 1, 2, 3}, corners, x, y, kSide, 0.75f, cut));
          auto off = [&](const BaseMesh& m) {
            return glm::distance(vertex, m.point(0, u, v) + height * m.normal(0, u, v));
          };
          largest = std::max(largest, off(mesh));
          other = std::max(other, off(otherwise));
        }
    }
  EXPECT_LT(largest, 1e-5);
  EXPECT_GT(other, 1) << "control";
}

TEST(MeshWatertight, EveryPairOfLevelsAndEveryOrientation) {
  const uint64_t wanted = wantedComparisons();
  PairCount count = comparePairs(kSeed, wanted);
  std::printf("[ figures  ] seed %llu: %llu vertices compared, %llu differ\n", static_cast<unsigned long long>(kSeed),
              static_cast<unsigned long long>(count.comparisons), static_cast<unsigned long long>(count.mismatches));
  EXPECT_GE(count.comparisons, wanted);
  EXPECT_EQ(count.mismatches, 0u);
}

}  // namespace mesh_watertight_test
}  // namespace relievo::test
