// Strategies that draw from meshes which they simplified (geometry/strategies/strategy_surface.h): whatever they draw
// for a view is closed and covers every place once, its error is what they say, and controls fail.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>

#ifdef RELIEVO_HAS_MESHOPTIMIZER
#include <meshoptimizer.h>
#endif

#include "geometry/strategies/cluster_dag.h"
#include "geometry/strategies/encoded_parts.h"
#include "geometry/strategies/surface_simplify.h"
#include "tests/geometry/lod_fixture.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/view_share.h"

namespace relievo::test {
namespace kept_mesh_test {

uint16_t hills(int64_t x, int64_t y) {
  const double a = static_cast<double>(x), b = static_cast<double>(y);
  const double rough = x + y > 2500 ? 900.0 * (noiseHeight(x, y) / 65535.0) : 0;
  return static_cast<uint16_t>(30000 + 9000 * std::sin(a * 0.008) * std::cos(b * 0.006) + rough);
}

StrategyScene flatScene(uint64_t width_px, uint64_t height_px, HeightFunction height) {
  StrategyScene scene;
  const FlatDomain domain = makeDomain(width_px, height_px, 0);
  scene.domain = domain;
  scene.oracle = std::make_shared<MadeUpOracle>(domain, 7, true);
  auto resident = std::make_shared<ReliefSet>();
  auto field = std::make_shared<ReliefField>(domain);
  ReliefPages pages(domain, height);
  for (int level = 0; level <= scene.domain.relief_depth; ++level)
    for (uint32_t patch = 0; patch < scene.domain.patchCount(); ++patch)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x) {
          const NodeId n{patch, static_cast<uint32_t>(level), x, y};
          if (!scene.domain.nodeExists(n)) continue;
          resident->insert(n);
          if (level == scene.domain.relief_depth) field->setPage(n, pages(n));
        }
  scene.resident = resident;
  scene.field = field;
  return scene;
}
StrategyScene bodyScene(int around, uint32_t seed) {
  StrategyScene scene;
  BaseMesh mesh = cubeSphere(around, 40);
  Random turns(seed);
  turnPatches(mesh, turns);
  PatchMeasures measures;
  measures.relief_depth = 0;
  measures.relief_offset_mm = -1;
  measures.relief_scale_mm = 2.0 / 65535;
  scene.domain = PatchDomain::overMesh(static_cast<uint32_t>(mesh.patches.size()), measures);
  auto base = std::make_shared<BaseMesh>(mesh);
  auto body = std::make_shared<BodyField>(base, measures);
  for (uint32_t p = 0; p < base->patches.size(); ++p)
    for (int64_t y = 0; y <= body->side; ++y)
      for (int64_t x = 0; x <= body->side; ++x) {
        const double u = static_cast<double>(x) / static_cast<double>(body->side),
                     v = static_cast<double>(y) / static_cast<double>(body->side);
        const glm::dvec3 at = base->point(p, u, v);
        body->at(p, x, y) = static_cast<uint16_t>(32768 + 20000 * std::sin(0.3 * at.x + 1) * std::cos(0.2 * at.y));
      }
  scene.body = body;
  scene.oracle = std::make_shared<MadeUpOracle>(makeDomain(128, 128, 0), 7, true);
  auto resident = std::make_shared<ReliefSet>();
  for (uint32_t p = 0; p < base->patches.size(); ++p) resident->insert({p, 0, 0, 0});
  scene.resident = resident;
  return scene;
}

// Edges of welded vertices that another number of triangles than two has, but for the artwork's border. (Patches may be
// mirrored, so directions say nothing.)
size_t openEdges(const FineSurface& surface, std::span<const uint32_t> triangles, bool flat) {
  std::map<std::pair<uint32_t, uint32_t>, int> edges;
  std::map<uint32_t, glm::vec3> places;
  for (size_t k = 0; k < triangles.size(); ++k) {
    const uint32_t a = surface.weld(triangles[k]), b = surface.weld(triangles[k % 3 == 2 ? k - 2 : k + 1]);
    ++edges[std::minmax(a, b)];
    places[a] = surface.positions()[a];
  }
  glm::vec3 low(1e30f), high(-1e30f);
  for (const glm::vec3& p : surface.positions()) low = glm::min(low, p), high = glm::max(high, p);
  size_t open = 0;
  for (const auto& [edge, count] : edges) {
    if (count == 2) continue;
    const glm::vec3 a = places[edge.first], b = places[edge.second];
    const bool border =
        flat && ((a.x == b.x && (a.x == low.x || a.x == high.x)) || (a.y == b.y && (a.y == low.y || a.y == high.y)));
    open += !border || count != 1;
  }
  return open;
}
double areaOf(const FineSurface& surface, std::span<const uint32_t> triangles) {
  double area = 0;
  for (size_t k = 0; k < triangles.size(); k += 3) {
    const auto a = surface.place(triangles[k]), b = surface.place(triangles[k + 1]),
               c = surface.place(triangles[k + 2]);
    const auto twice = (b.i - a.i) * (c.j - a.j) - (b.j - a.j) * (c.i - a.i);
    EXPECT_LT(twice, 0) << "turned over, or without area";
    area -= 0.5 * static_cast<double>(twice);
  }
  return area;
}
// By brute force: many places of every triangle, fewer where triangles are many.
double sampledMm(const StrategyScene& scene, double exaggerate, const FineSurface& surface,
                 std::span<const uint32_t> triangles) {
  double worst = 0;
  const int steps = triangles.size() < 3 * 2000 || longTests() ? 12 : 4;
  for (size_t k = 0; k < triangles.size(); k += 3) {
    const auto a = surface.place(triangles[k]), b = surface.place(triangles[k + 1]),
               c = surface.place(triangles[k + 2]);
    const std::array<glm::dvec3, 3> p = {surface.positions()[triangles[k]], surface.positions()[triangles[k + 1]],
                                         surface.positions()[triangles[k + 2]]};
    for (int i = 0; i <= steps; ++i)
      for (int j = 0; i + j <= steps; ++j) {
        const double u = static_cast<double>(i) / steps, v = static_cast<double>(j) / steps;
        const double x = static_cast<double>(a.i) + u * static_cast<double>(b.i - a.i) +
                         v * static_cast<double>(c.i - a.i),
                     y = static_cast<double>(a.j) + u * static_cast<double>(b.j - a.j) +
                         v * static_cast<double>(c.j - a.j);
        const glm::dvec3 drawn = p[0] + u * (p[1] - p[0]) + v * (p[2] - p[0]);
        if (scene.body) {
          worst = std::max(worst, glm::length(drawn - scene.body->pointMm(a.patch, x, y, exaggerate)));
        } else {
          const double unit = static_cast<double>(1 << scene.field->spacing_log2);
          worst = std::max(worst, std::abs(drawn.z - scene.field->heightMm(x * unit, y * unit)));
        }
      }
  }
  return worst;
}

TEST(KeptMesh, SimplifiedSurfacesAreClosedAndAsExactAsTheySay) {
  struct Case {
    const char* name;
    StrategyScene scene;
    double exaggerate = 1;
  };
  const Case cases[] = {{"flat", flatScene(256, 256, hills)},
                        {"flat, noise", flatScene(128, 128, noiseHeight)},
                        {"a ball", bodyScene(1, 11)},
                        {"a ball, heights x -3", bodyScene(1, 13), -3}};
  for (const Case& c : cases) {
    if (kSanitized && (&c == &cases[0] || &c == &cases[2])) continue;  // the same code
    const FineSurface surface(c.scene, c.exaggerate, 1'000'000);
    ASSERT_TRUE(surface.whole());
    std::vector<uint32_t> triangles = surface.triangles(6);
    const double area = areaOf(surface, triangles);
    EXPECT_EQ(openEdges(surface, triangles, c.scene.domain.isFlat()), 0u) << c.name;
    EXPECT_EQ(openEdges(surface, std::span(triangles).subspan(300), c.scene.domain.isFlat()) > 0, true)
        << "the control: triangles are missing";
    SurfaceSimplifier simplifier(surface, triangles, {});
    double before = 0;
    for (size_t target = triangles.size() / 3; target > 100; target /= 3) {
      simplifier.reduce(target);
      triangles = simplifier.triangles();
      EXPECT_LE(triangles.size() / 3, std::max<size_t>(target, 100)) << c.name;
      EXPECT_EQ(areaOf(surface, triangles), area) << c.name;
      EXPECT_EQ(openEdges(surface, triangles, c.scene.domain.isFlat()), 0u) << c.name;
      const double exact = surface.deviationMm(triangles),
                   sampled = sampledMm(c.scene, c.exaggerate, surface, triangles);
      EXPECT_LE(sampled, exact * (1 + 1e-6) + 1e-5) << c.name;
      EXPECT_LE(exact, simplifier.errorMm() * (1 + 1e-6) + 1e-5) << c.name;
      EXPECT_GE(simplifier.errorMm(), before);
      before = simplifier.errorMm();
      if (target < 2000) {
        EXPECT_GT(sampled, 0.9 * exact) << c.name << ", the control: a smaller bound would not hold";
      }
      std::printf("[ figures  ] %s: %zu triangles, off by %.4g mm, at places of a grid %.4g mm\n", c.name,
                  triangles.size() / 3, exact, sampled);
    }
  }
}

// Triangles by their vertices, the least first.
using PartTriangle = std::array<PartVertex, 3>;
PartTriangle triangleOf(PartTriangle t) {
  std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
  return t;
}
std::vector<PartTriangle> trianglesOf(const DecodedPart& part) {
  std::vector<PartTriangle> out;
  for (size_t k = 0; k < part.indices.size(); k += 3)
    out.push_back(triangleOf(
        {part.vertices[part.indices[k]], part.vertices[part.indices[k + 1]], part.vertices[part.indices[k + 2]]}));
  std::sort(out.begin(), out.end());
  return out;
}
std::vector<PartTriangle> trianglesOf(const StrategyMesh& mesh, std::span<const IndexRange> ranges) {
  auto at = [&](uint32_t k) {
    const StrategyVertex& v = mesh.vertices[mesh.indices[k]];
    return PartVertex{mesh.instances[v.instance].node.patch, v.x, v.y, static_cast<uint16_t>(v.height_steps)};
  };
  std::vector<PartTriangle> out;
  for (const IndexRange& r : ranges)
    for (uint32_t k = r.first; k < r.first + r.count; k += 3) out.push_back(triangleOf({at(k), at(k + 1), at(k + 2)}));
  std::sort(out.begin(), out.end());
  return out;
}

TEST(KeptMesh, PartsKeepEveryTriangle) {
  for (const StrategyScene& scene : {flatScene(128, 128, hills), bodyScene(1, 11)}) {
    const ClusterDag dag = clusterDag(FineSurface(scene, 1, 20'000), 1, 8, 2);
    const StrategyMesh& mesh = *dag.mesh;
    ASSERT_EQ(mesh.parts.size(), dag.groups.size() + 1);
    std::vector<std::vector<IndexRange>> ranges(mesh.parts.size());
    uint64_t bytes = 0, indices = 0;
    for (const auto& [range, part] : mesh.part_ranges) ranges[part].push_back(range), indices += range.count;
    EXPECT_EQ(indices, mesh.indices.size()) << "every triangle is in one part";
    for (size_t p = 0; p < ranges.size(); ++p) {
      const EncodedPart encoded = encodePart(mesh, ranges[p]);
      EXPECT_EQ(mesh.parts[p].encoded_bytes, encoded.vertices.size() + encoded.indices.size());
      bytes += mesh.parts[p].encoded_bytes;
      const auto decoded = decodePart(encoded);
      ASSERT_TRUE(decoded);
      EXPECT_EQ(trianglesOf(*decoded), trianglesOf(mesh, ranges[p]));
      EncodedPart damaged = encoded;
      damaged.vertices[damaged.vertices.size() / 2] ^= 16;
      const auto other = decodePart(damaged);
      EXPECT_TRUE(!other || trianglesOf(*other) != trianglesOf(mesh, ranges[p])) << "the control";
    }
    const double bits = 8.0 * static_cast<double>(bytes) / (static_cast<double>(indices) / 3);
    EXPECT_LT(bits, 64) << "bits a triangle, of places of 32 + 32 + 16 bits and three indices";
    // Parts of what a view draws, by brute force.
    Random random(5);
    for (int k = 0; k < 50; ++k) {
      std::vector<IndexRange> drawn;
      for (auto c = static_cast<size_t>(random.integer(0, 7)); c < dag.clusters.size();
           c += static_cast<size_t>(random.integer(1, 40)))
        drawn.push_back(dag.clusters[c].range);
      std::set<uint32_t> wanted;
      for (const auto& [range, part] : mesh.part_ranges)
        for (const IndexRange& d : drawn)
          if (range.first < d.first + d.count && d.first < range.first + range.count) wanted.insert(part);
      EXPECT_EQ(partsOf(mesh, drawn), std::vector<uint32_t>(wanted.begin(), wanted.end()));
    }
  }
}

// Of as many triangles as meshoptimizer leaves, ours are off by less: its quadrics sum up squares of distances, and in
// single precision, ours are measured.
TEST(KeptMesh, LeavesLessErrorThanMeshoptimizer) {
  if (kSanitized) GTEST_SKIP() << "about figures";
#ifdef RELIEVO_HAS_MESHOPTIMIZER
  const StrategyScene scene = flatScene(256, 256, hills);
  const FineSurface surface(scene, 1, 1'000'000);
  const std::vector<uint32_t> all = surface.triangles(6);
  SurfaceSimplifier simplifier(surface, all, {});
  // Corners must stay: it keeps vertices of which there are more than two at one place.
  std::vector<glm::vec3> positions = surface.positions();
  for (uint32_t v = 0; v < surface.positions().size(); ++v)
    if (surface.isCorner(v)) positions.insert(positions.end(), 2, surface.positions()[v]);
  for (const size_t target : {size_t{40'000}, size_t{10'000}, size_t{2'500}}) {
    std::vector<uint32_t> theirs(all.size());
    theirs.resize(meshopt_simplify(theirs.data(), all.data(), all.size(), &positions[0].x, positions.size(),
                                   sizeof(glm::vec3), 3 * target, 1e9f, 0, nullptr));
    simplifier.reduce(theirs.size() / 3);
    const double their_mm = surface.deviationMm(theirs), our_mm = surface.deviationMm(simplifier.triangles());
    EXPECT_LT(our_mm, 0.5 * their_mm) << theirs.size() / 3;
    std::printf("[ figures  ] %zu triangles: off by %.4g mm, meshoptimizer's by %.4g mm\n", theirs.size() / 3, our_mm,
                their_mm);
  }
#else
  GTEST_SKIP() << "built without meshoptimizer (tools/setup installs it)";
#endif
}

// Strips of patches that the border cuts: seams between patches, and a last column that is no whole sample wide.
TEST(KeptMesh, PatchesOfAStripStayTogether) {
  for (auto [width, height] : {std::pair<uint64_t, uint64_t>{500, 130}, {131, 300}}) {
    const StrategyScene scene = flatScene(width, height, hills);
    const FineSurface surface(scene, 1, 1'000'000);
    std::vector<uint32_t> triangles = surface.triangles(6);
    const double area = areaOf(surface, triangles);
    SurfaceSimplifier simplifier(surface, triangles, {});
    simplifier.reduce(200);
    triangles = simplifier.triangles();
    EXPECT_LE(triangles.size() / 3, 200u);
    EXPECT_EQ(areaOf(surface, triangles), area);
    EXPECT_EQ(openEdges(surface, triangles, true), 0u);
  }
}

// What a view draws from the graph, in the surface's own vertices: a random cut, made as the strategy makes it.
std::vector<uint32_t> cutOf(const ClusterDag& dag, const std::vector<std::vector<uint32_t>>& names,
                            const std::vector<uint8_t>& refined) {
  std::vector<uint32_t> out;
  for (uint32_t c = 0; c < dag.clusters.size(); ++c) {
    const Cluster& of = dag.clusters[c];
    if (of.producer != Cluster::kNone && refined[of.producer]) continue;
    if (of.consumer != Cluster::kNone && !refined[of.consumer]) continue;
    out.insert(out.end(), names[c].begin(), names[c].end());
  }
  return out;
}

TEST(KeptMesh, EveryCutThroughTheClustersIsClosed) {
  struct Case {
    StrategyScene scene;
    size_t least_levels;
  };
  for (const Case& c : {Case{flatScene(300, 180, hills), 3}, Case{bodyScene(1, 5), 3}}) {
    const FineSurface surface(c.scene, 1, 1'000'000);
    const ClusterDag dag = clusterDag(surface, 1, 8, 2);
    // The mesh's vertices back to the surface's.
    std::map<std::array<int64_t, 3>, uint32_t> vertex_at;
    for (uint32_t v = 0; v < surface.positions().size(); ++v) {
      const auto p = surface.place(v);
      vertex_at.try_emplace({p.patch, p.i, p.j}, v);
    }
    std::vector<std::vector<uint32_t>> names(dag.clusters.size());
    const double step = c.scene.body ? 1 : static_cast<double>(1 << c.scene.field->spacing_log2);
    for (size_t k = 0; k < dag.clusters.size(); ++k) {
      const IndexRange r = dag.clusters[k].range;
      EXPECT_LE(r.count, 3 * kClusterTriangles);
      for (uint32_t i = r.first; i < r.first + r.count; ++i) {
        const StrategyVertex& v = dag.mesh->vertices[dag.mesh->indices[i]];
        const PatchInstance& p = dag.mesh->instances[v.instance];
        names[k].push_back(vertex_at.at({p.node.patch, static_cast<int64_t>(std::ceil((v.x - p.x0) / step)),
                                         static_cast<int64_t>(std::ceil((v.y - p.y0) / step))}));
      }
    }
    for (const ClusterGroup& g : dag.groups)
      for (const uint32_t p : g.producers) {
        EXPECT_GE(g.error_mm, dag.groups[p].error_mm);
        const WorldBox &outer = g.box, &inner = dag.groups[p].box;
        for (int axis = 0; axis < 3; ++axis)
          EXPECT_LE(std::abs(outer.centre[axis] - inner.centre[axis]) + inner.half[axis], outer.half[axis] + 1e-5);
      }
    // Halves of halves: together about as many triangles as the finest mesh has once more (Ponchio 2009; Karis 2021).
    EXPECT_LT(dag.mesh->indices.size(), 2.2 * static_cast<double>(surface.triangles(3).size()));
    const double area = areaOf(surface, surface.triangles(3));
    Random random(3);
    size_t least = ~size_t{0}, control_open = 0;
    for (int cut = 0; cut < 30; ++cut) {
      // Groups by chance, as far as all that stand above them are refined.
      std::vector<uint8_t> refined(dag.groups.size(), 1);
      for (size_t g = dag.groups.size(); g-- > 0;) {
        bool may = true;
        for (size_t up = g + 1; up < dag.groups.size(); ++up)
          if (std::count(dag.groups[up].producers.begin(), dag.groups[up].producers.end(), g) && !refined[up])
            may = false;
        refined[g] = may && (cut > 0 && random.real(0, 1) < 0.7);
      }
      const std::vector<uint32_t> drawn = cutOf(dag, names, refined);
      EXPECT_EQ(openEdges(surface, drawn, c.scene.domain.isFlat()), 0u) << "cut " << cut;
      EXPECT_EQ(areaOf(surface, drawn), area) << "cut " << cut;
      double promised = 0;
      for (const Cluster& k : dag.clusters)
        if (k.producer != Cluster::kNone && !refined[k.producer])
          promised = std::max(promised, dag.groups[k.producer].error_mm);
      EXPECT_LE(surface.deviationMm(drawn), promised * (1 + 1e-6) + 1e-9);
      least = std::min(least, drawn.size() / 3);
      // The control: one group is refined on its own, whatever stands above it.
      if (refined[0]) continue;
      refined[0] = 1;
      control_open += openEdges(surface, cutOf(dag, names, refined), c.scene.domain.isFlat()) > 0;
    }
    EXPECT_LT(least, surface.triangles(3).size() / 3 / (1u << c.least_levels)) << "the coarsest cut";
    EXPECT_GT(control_open, 0u) << "the control: an impossible cut is closed, too";
    std::printf("[ figures  ] %zu clusters in %zu groups, the coarsest cut %zu of %zu triangles\n", dag.clusters.size(),
                dag.groups.size(), least, surface.triangles(3).size() / 3);
  }
}

TEST(KeptMesh, TheGraphIsTheSameWithManyThreads) {
  const StrategyScene scene = flatScene(200, 150, hills);
  const FineSurface surface(scene, 1, 1'000'000);
  const ClusterDag one = clusterDag(surface, 1, 8, 1), many = clusterDag(surface, 1, 8, 3);
  EXPECT_EQ(one.mesh->indices, many.mesh->indices);
  ASSERT_EQ(one.groups.size(), many.groups.size());
  for (size_t g = 0; g < one.groups.size(); ++g) EXPECT_EQ(one.groups[g].error_mm, many.groups[g].error_mm);
}

// Flat patches, which every grid shows.
TEST(KeptMesh, SamplesThatShowNothingMoreAreLeftOut) {
  PatchMeasures measures;
  measures.relief_scale_mm = 2.0 / 65535;
  StrategyScene scene;
  BaseMesh mesh = cubeSphere(2, 10);
  mesh.cut = true;
  scene.domain = PatchDomain::overMesh(static_cast<uint32_t>(mesh.patches.size()), measures);
  auto base = std::make_shared<BaseMesh>(mesh);
  auto body = std::make_shared<BodyField>(base, measures);
  std::fill(body->samples.begin(), body->samples.end(), uint16_t{12'345});
  scene.body = body;
  scene.oracle = std::make_shared<MadeUpOracle>(makeDomain(128, 128, 0), 7, true);
  auto resident = std::make_shared<ReliefSet>();
  for (uint32_t p = 0; p < base->patches.size(); ++p) resident->insert({p, 0, 0, 0});
  scene.resident = resident;
  const FineSurface all(scene, 2, 1'000'000);
  EXPECT_EQ(all.positions().size(), base->patches.size() * 129 * 129);
  const double area = all.samplesOf(all.triangles(3).data()) * static_cast<double>(all.triangles(3).size());
  for (const size_t cells_log2 : {size_t{0}, size_t{3}}) {
    CoarseErrors errors{};
    for (size_t k = 0; k < cells_log2; ++k) errors[k] = 0.1f;
    scene.coarse.assign(base->patches.size(), CoarseErrors{});
    scene.coarse.back() = errors;  // one patch is enough
    const FineSurface few(scene, 2, 1'000'000), coarser(scene, 2, 4 * base->patches.size());
    const size_t side = (size_t{1} << cells_log2) + 1;
    EXPECT_EQ(few.positions().size(), base->patches.size() * side * side);
    EXPECT_TRUE(few.whole());
    EXPECT_EQ(coarser.whole(), cells_log2 == 0);
    EXPECT_LT(few.deviationMm(few.triangles(3)), 1e-5);
    EXPECT_LT(coarser.deviationMm(coarser.triangles(3)), 1e-5);
    const std::vector<uint32_t> triangles = few.triangles(3);
    EXPECT_NEAR(few.samplesOf(triangles.data()) * static_cast<double>(triangles.size()), area, 1e-6 * area);
    EXPECT_EQ(openEdges(few, triangles, false), 0u);
    // The same places: corner by corner of the patches.
    for (uint32_t p = 0; p < base->patches.size(); ++p)
      for (const size_t k : {size_t{0}, side - 1, side * side - 1}) {
        const size_t x = k % side * (128 / (side - 1)), y = k / side * (128 / (side - 1));
        EXPECT_EQ(few.positions()[p * side * side + k], all.positions()[p * 129 * 129 + y * 129 + x]);
      }
    StrategyMesh drawn;
    few.append(triangles, 16, drawn);
    int32_t furthest = 0;
    for (const StrategyVertex& v : drawn.vertices) {
      EXPECT_EQ(v.height_steps, 12'345);
      furthest = std::max(furthest, v.x);
    }
    EXPECT_EQ(furthest, 128);
  }
}

// Over too many samples the mesh starts from every second one, and says how far that is off.
TEST(KeptMesh, TooManySamplesAreNotAllTaken) {
  const StrategyScene scene = flatScene(256, 256, noiseHeight);
  const FineSurface all(scene, 1, 1'000'000), some(scene, 1, 20'000);
  EXPECT_FALSE(some.whole());
  EXPECT_LE(some.positions().size(), 20'000u);
  EXPECT_EQ(all.deviationMm(all.triangles(6)), 0);
  EXPECT_GT(some.deviationMm(some.triangles(6)), 0.1);
}

}  // namespace kept_mesh_test
}  // namespace relievo::test
