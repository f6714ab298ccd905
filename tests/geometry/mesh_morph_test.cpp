// Geomorph over base meshes: shared vertices keep their bits whatever the weights, a level ends where the next one begins, the predicted error
// stays a bound, and what moves on the screen from one small step of the camera to the next is at most half a pixel. Hysteresis: a trembling
// camera changes nothing.
#include <gtest/gtest.h>

#include <cstdio>

#include "geometry/morph.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/geometry/true_mesh_relief.h"

namespace relievo::test {
namespace {

constexpr uint64_t kSeed = 20260411;

struct FmaSecond {  // a * b rounds, the second product does not
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(c, d, a * b); }
};
struct FmaFirst {
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(a, b, c * d); }
};

// ---- watertight
TEST(MeshMorph, SharedVerticesAreTheSameBitForBit) {
  const std::vector<NamedMesh> meshes = allMeshes();
  MeshSeams total;
  uint64_t cases = 0, nodes = 0, on_the_way = 0;
  for (uint64_t seed = kSeed; total.comparisons < 10'000'000 / kViewShare && cases < 4000; ++seed, ++cases) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    c.view.morph = true;
    PlanarLodResult lod = c.lod->select(c.view, c.resident);
    const BaseMesh& mesh = c.named.mesh;
    MeshHeight height = noiseOver(mesh, c.relief.unitLog2(), seed);
    for (const MeshGridFunction& twin : {morphTwinOf<PlainOps>(mesh, c.relief, height, c.view), morphTwinOf<FmaFirst>(mesh, c.relief, height, c.view),
                                         morphTwinOf<FmaSecond>(mesh, c.relief, height, c.view)}) {
      MeshSeams seams = compareMeshSeams(mesh, c.relief.unitLog2(), lod.instances, {}, true, twin);
      ASSERT_EQ(seams.mismatches, 0u) << describe(c, seed);
      ASSERT_EQ(seams.unbalanced, 0u) << describe(c, seed);
      total += seams;
    }
    nodes += lod.instances.size();
    for (const PatchInstance& p : lod.instances)
      for (const auto& side : p.edge_morph) on_the_way += side[0] != PatchInstance::kInPlace;
  }
  std::printf("[ figures  ] seeds from %llu: %llu cases, %llu nodes, %llu vertices compared, %llu across patches; %llu sides with vertices on their way\n",
              static_cast<unsigned long long>(kSeed), static_cast<unsigned long long>(cases), static_cast<unsigned long long>(nodes),
              static_cast<unsigned long long>(total.comparisons), static_cast<unsigned long long>(total.across_patches), static_cast<unsigned long long>(on_the_way));
  EXPECT_GE(total.comparisons, 10'000'000u / kViewShare);
  EXPECT_GT(on_the_way, nodes / 2);
}

TEST(MeshMorph, NegativeControlsOfWatertightness) {
  const std::vector<NamedMesh> meshes = wellShapedMeshes();
  uint64_t own_weights = 0, swapped_halves = 0, sloped = 0;
  for (uint64_t seed = kSeed; seed < kSeed + 40; ++seed) {
    MeshCase c = randomMeshCase(seed, meshes[seed % meshes.size()]);
    c.view.morph = true;
    const BaseMesh& mesh = c.named.mesh;
    PlanarLodResult lod = c.lod->select(c.view, c.resident);
    MeshHeight height = noiseOver(mesh, c.relief.unitLog2(), seed);
    const MeshGridFunction twin = morphTwinOf<PlainOps>(mesh, c.relief, height, c.view);
    auto mismatches = [&](const std::vector<PatchInstance>& list, const MeshGridFunction& vertex) {
      return compareMeshSeams(mesh, c.relief.unitLog2(), list, {}, true, vertex).mismatches;
    };
    std::vector<PatchInstance> own = lod.instances, swapped = lod.instances;
    for (PatchInstance& p : own)  // a weight a node
      for (auto& side : p.edge_morph) side = {p.morph, p.morph};
    own_weights += mismatches(own, twin);
    for (PatchInstance& p : swapped)
      for (auto& side : p.edge_morph) std::swap(side[0], side[1]);
    swapped_halves += mismatches(swapped, twin);
    // The middle of two as one of them and half the way to the other.
    sloped += mismatches(lod.instances, morphTwinOf<PlainOps>(mesh, c.relief, height, c.view, [](const glm::vec3& a, const glm::vec3& b, const glm::vec3& v, float w) {
                           return lerpOrdered(a + 0.5f * (b - a), v, w);
                         }));
  }
  std::printf("[ figures  ] mismatches: %llu with weights per node, %llu with halves exchanged, %llu with middles from one end\n",
              static_cast<unsigned long long>(own_weights), static_cast<unsigned long long>(swapped_halves), static_cast<unsigned long long>(sloped));
  EXPECT_GT(own_weights, 0u);
  EXPECT_GT(swapped_halves, 0u);
  EXPECT_GT(sloped, 0u);
}

// ---- what is drawn, place by place
struct Vertex {
  glm::dvec2 place{0};  // units of the patch
  glm::dvec3 at{0};
};
Vertex operator+(const Vertex& a, const Vertex& b) { return {a.place + b.place, a.at + b.at}; }
Vertex operator*(double k, const Vertex& a) { return {k * a.place, k * a.at}; }

constexpr int64_t kSampled = 3;  // every third finest sample either way: prime to all levels' steps

// By finest sample of a patch (rows of v): how far the picture of the drawn point lies from that of the finest surface's, px. Not a number: not drawn,
// or out of the picture.
using Offsets = std::vector<std::vector<glm::dvec2>>;
struct Screen {
  glm::dmat4 clip_from_world;
  double half_height_px, aspect, near_mm;
  bool orthographic;
  Screen(const LodView& view, const Camera& camera)
      : clip_from_world(view.clip_from_world), half_height_px(0.5 * camera.viewport_height_px), aspect(camera.aspect), near_mm(camera.near_mm),
        orthographic(glm::length(glm::dvec3(glm::transpose(view.clip_from_world)[3])) == 0) {}
  // -1: no picture, 0: beside it, 1: in it.
  int project(const glm::dvec3& at, glm::dvec2& px) const {
    glm::dvec4 p = clip_from_world * glm::dvec4(at, 1);
    if (!orthographic && p.w < near_mm) return -1;
    px = glm::dvec2(p.x * aspect, p.y) / p.w * half_height_px;
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w ? 1 : 0;
  }
};
Offsets offsetsOf(const TrueMeshRelief& relief, size_t patches, const LodView& view, const Camera& camera, const std::vector<PatchInstance>& instances) {
  const int64_t side = relief.side();
  const double none = std::numeric_limits<double>::quiet_NaN(), exaggerate = view.relief ? view.exaggerate : 0;
  Offsets all(patches);
  const Screen screen(view, camera);
  std::vector<Vertex> grid;
  for (const PatchInstance& p : instances) {
    auto& of_patch = all[p.node.patch];
    if (of_patch.empty()) of_patch.assign(static_cast<size_t>((side + 1) * (side + 1)), glm::dvec2(none));
    const uint32_t size = 1u << p.grid_level;
    grid.clear();
    auto vertex = [&](uint32_t i, uint32_t j) {
      const int64_t x = p.x0 + (int64_t{i} << p.step_log2), y = p.y0 + (int64_t{j} << p.step_log2);
      return Vertex{{double(x), double(y)}, relief.point(p.node.patch, x, y, exaggerate)};
    };
    for (uint32_t j = 0; j <= size; ++j)
      for (uint32_t i = 0; i <= size; ++i)
        grid.push_back(drawnVertex(p, i, j, vertex, [](const Vertex& a, const Vertex& b, const Vertex& own, float w) { return (0.5 - 0.5 * w) * (a + b) + double{w} * own; }));
    auto triangle = [&](const Vertex& a, const Vertex& b, const Vertex& c) {
      const double area = (b.place.x - a.place.x) * (c.place.y - a.place.y) - (b.place.y - a.place.y) * (c.place.x - a.place.x);
      EXPECT_GE(area, -1e-9);
      if (area < 1e-9) return;
      auto low = [](double u, double v, double w) { return static_cast<int64_t>(std::ceil(std::min({u, v, w}) - 1e-9)); };
      auto high = [](double u, double v, double w) { return static_cast<int64_t>(std::floor(std::max({u, v, w}) + 1e-9)); };
      auto next = [](int64_t at) { return (at + kSampled - 1) / kSampled * kSampled; };
      for (int64_t y = next(low(a.place.y, b.place.y, c.place.y)); y <= high(a.place.y, b.place.y, c.place.y); y += kSampled)
        for (int64_t x = next(low(a.place.x, b.place.x, c.place.x)); x <= high(a.place.x, b.place.x, c.place.x); x += kSampled) {
          const double wb = ((double(x) - a.place.x) * (c.place.y - a.place.y) - (double(y) - a.place.y) * (c.place.x - a.place.x)) / area;
          const double wc = ((b.place.x - a.place.x) * (double(y) - a.place.y) - (b.place.y - a.place.y) * (double(x) - a.place.x)) / area;
          if (wb < -1e-9 || wc < -1e-9 || wb + wc > 1 + 1e-9) continue;
          glm::dvec2 seen(0), truth(0);
          const int in_truth = screen.project(relief.point(p.node.patch, x, y, exaggerate), truth);
          if (in_truth < 0) continue;
          const int in = screen.project(a.at + wb * (b.at - a.at) + wc * (c.at - a.at), seen);
          if (in >= 0 && (in || in_truth)) of_patch[static_cast<size_t>(y * (side + 1) + x)] = seen - truth;
        }
    };
    for (uint32_t j = 0; j < size; ++j)
      for (uint32_t i = 0; i < size; ++i) {
        const Vertex *top = &grid[j * (size + 1) + i], *bottom = top + size + 1;
        triangle(top[0], top[1], bottom[1]);
        triangle(top[0], bottom[1], bottom[0]);
      }
  }
  return all;
}
double largest(const Offsets& offsets) {
  double most = 0;
  for (const auto& patch : offsets)
    for (const glm::dvec2& o : patch) most = std::max(most, std::isnan(o.x) ? 0 : glm::length(o));
  return most;
}
// Of what moves relative to the finest surface from one picture to the next.
double largestMove(const Offsets& before, const Offsets& after) {
  double most = 0;
  for (size_t p = 0; p < before.size(); ++p)
    for (size_t k = 0; k < std::min(before[p].size(), after[p].size()); ++k) {
      const glm::dvec2 d = after[p][k] - before[p][k];
      if (!std::isnan(d.x)) most = std::max(most, glm::length(d));
    }
  return most;
}

struct Subject {
  std::string name;
  std::shared_ptr<const BaseMesh> mesh;
  MeshRelief relief;
  std::unique_ptr<TrueMeshRelief> truth;
  std::unique_ptr<MeshLod> lod;
  ReliefSet all_pages;
};
Subject makeSubject(std::string name, BaseMesh mesh, int depth, double height_share, const std::function<double(const glm::dvec3&, const Place&)>& height) {
  Subject s;
  s.name = std::move(name);
  s.mesh = std::make_shared<const BaseMesh>(std::move(mesh));
  auto [low, high] = boxOf(*s.mesh);
  s.relief = {depth, 0, height_share * glm::length(high - low) / 65535};
  s.relief.offset_mm = -0.4 * 65535 * s.relief.scale_mm;
  s.truth = std::make_unique<TrueMeshRelief>(*s.mesh, s.relief, height);
  s.lod = std::make_unique<MeshLod>(s.mesh, depth, s.relief.offset_mm, s.relief.scale_mm,
                                    std::shared_ptr<const ReliefOracle>(std::shared_ptr<void>(), s.truth.get()), s.truth->coarse());
  for (uint32_t p = 0; p < s.mesh->patches.size(); ++p)
    for (uint32_t l = 1; l <= static_cast<uint32_t>(depth); ++l)
      for (uint32_t y = 0; y < 1u << l; ++y)
        for (uint32_t x = 0; x < 1u << l; ++x) s.all_pages.insert({p, l, x, y});
  return s;
}
std::vector<Subject> makeSubjects() {
  auto waves = [](const glm::dvec3& p, double f) { return 0.5 + 0.2 * std::sin(f * p.x + 1) * std::cos(f * p.y) + 0.1 * std::sin(2.7 * f * (p.z + 0.3 * p.x)); };
  std::vector<Subject> all;
  all.push_back(makeSubject("smooth ball", cubeSphere(1, 60), 0, 0.05, [=](const glm::dvec3& p, const Place&) { return waves(p, 0.05); }));
  all.push_back(makeSubject("ball with a rough part and pits", cubeSphere(2, 60), 0, 0.05, [=](const glm::dvec3& p, const Place& place) {
    const uint64_t h = hashOf(place, 5);
    return waves(p, 0.15) + (p.x > 0 && p.y > 0 ? 0.05 * static_cast<double>(h & 1023) / 1023 : 0) + ((h >> 20) % 3000 == 0 ? 0.2 : 0);
  }));
  all.push_back(makeSubject("sheet with a wall", openSheet(2, 1, 60), 1, 0.04, [=](const glm::dvec3& p, const Place&) {
    return 0.7 * waves(p, 0.1) + (p.x + 0.4 * p.y > 11 ? 0.3 : 0);
  }));
  return all;
}

// A path: its camera at 0 .. 1.
struct Path {
  std::string name;
  int steps;
  std::function<Camera(double)> at;
};
std::vector<Path> pathsOver(const BaseMesh& mesh) {
  auto [low, high] = boxOf(mesh);
  const glm::dvec3 centre = 0.5 * (low + high);
  const double size = glm::length(high - low);
  const glm::dvec3 top = mesh.point(0, 0.4, 0.3), up = glm::normalize(mesh.normal(0, 0.4, 0.3));
  const glm::dvec3 along = glm::normalize(mesh.point(0, 1, 0.3) - mesh.point(0, 0, 0.3));
  auto camera = [=](const glm::dvec3& eye, const glm::dvec3& target) {
    Camera c;
    c.eye = eye, c.target = target;
    c.near_mm = 0.002 * size, c.far_mm = 20 * size;
    return c;
  };
  return {{"towards it", 150, [=](double t) { return camera(top + size * 2.5 * std::pow(0.02, t) * glm::normalize(up + 0.3 * along), top); }},
          {"around it", 80, [=](double t) {
             const double a = 0.8 * t;
             return camera(centre + 1.1 * size * (std::cos(a) * up + std::sin(a) * along), centre);
           }},
          {"low over it", 100, [=](double t) {
             const glm::dvec3 eye = top + (0.3 * t - 0.45) * size * along + 0.12 * size * up;
             return camera(eye, eye + along - 0.35 * up);
           }}};
}

struct Pops {
  double largest_px = 0, error_px = 0, over_bound = 0;
  int frames = 0, above_half = 0;
  uint64_t cells = 0;
};
enum class How { kMorph, kStill, kRounded };
Pops fly(Subject& s, const Path& path, double error_px, double min_cell_px, How how) {
  Pops pops;
  Offsets before;
  for (int k = 0; k <= path.steps; ++k) {
    const Camera camera = path.at(double(k) / path.steps);
    LodView view = makeView(camera, error_px);
    view.min_cell_px = min_cell_px;
    view.morph = how != How::kStill;
    PlanarLodResult lod = s.lod->select(view, s.all_pages);
    if (how == How::kRounded)
      for (PatchInstance& p : lod.instances) {
        auto rounded = [](uint8_t& w) { w = w < 128 ? 0 : 255; };
        rounded(p.morph);
        for (auto& side : p.edge_morph) rounded(side[0]), rounded(side[1]);
      }
    Offsets now = offsetsOf(*s.truth, s.mesh->patches.size(), view, camera, lod.instances);
    const double error = largest(now);
    pops.error_px = std::max(pops.error_px, error);
    pops.over_bound = std::max(pops.over_bound, error / lod.max_error_px);
    if (k > 0) {
      const double move = largestMove(before, now);
      if (std::getenv("POP_TRACE") && move > 0.3) std::printf("   frame %d: %.3f\n", k, move), std::fflush(stdout);
      pops.largest_px = std::max(pops.largest_px, move);
      pops.above_half += move > 0.5;
      ++pops.frames;
    }
    for (const PatchInstance& p : lod.instances) pops.cells += uint64_t{1} << (2 * p.grid_level);
    before = std::move(now);
  }
  return pops;
}

TEST(MeshMorph, NothingPops) {
  double morph = 0, still = 0, rounded = 0;
  for (Subject& s : makeSubjects())
    for (const Path& path : pathsOver(*s.mesh))
      for (double min_cell_px : {0.0, 2.0}) {
        Pops on = fly(s, path, 1, min_cell_px, How::kMorph), off = fly(s, path, 1, min_cell_px, How::kStill);
        Pops control = fly(s, path, 1, min_cell_px, How::kRounded);
        std::printf("[ figures  ] %-32s %-12s cells %.0f px: largest pop %.3f px (%d of %d frames above 0.5), without %.3f, weights rounded %.3f; error %.2f and %.2f px, of the bound %.2f and %.2f; "
                    "cells %llu and %llu\n",
                    s.name.c_str(), path.name.c_str(), min_cell_px, on.largest_px, on.above_half, on.frames, off.largest_px, control.largest_px, on.error_px, off.error_px, on.over_bound,
                    off.over_bound, static_cast<unsigned long long>(on.cells), static_cast<unsigned long long>(off.cells));
        morph = std::max(morph, on.largest_px), still = std::max(still, off.largest_px), rounded = std::max(rounded, control.largest_px);
        EXPECT_LE(on.over_bound, 1 + 1e-6);
        EXPECT_LE(off.over_bound, 1 + 1e-6);
      }
  EXPECT_LE(morph, 0.5);
  EXPECT_GT(still, 0.5);
  EXPECT_GT(rounded, 0.5);
}

}  // namespace
}  // namespace relievo::test
