// Hard geometry, item by item: no vertex that is no number, no crack, and a predicted error that is a bound, over base
// meshes and on flat artworks, in random views and in those that each item names, whatever pages are resident. One
// checker for all; lists of nodes that are broken on purpose show that it sees what it looks for.
#include <gtest/gtest.h>

#include <cstdio>

#include "tests/geometry/mesh_fixture.h"
#include "tests/geometry/true_mesh_relief.h"
#include "tests/geometry/true_relief.h"

namespace relievo::test {
namespace hard_geometry_test {

constexpr uint64_t kSeed = 20261130;
constexpr int kViewsOfAKind = 3;

// A place on a surface, its normal there, and a side of a patch.
struct Spot {
  glm::dvec3 at, normal, side_from, side_to;
};
struct Numbers {
  uint64_t looked_at = 0, not_finite = 0;
  void look(const glm::vec3& from_eye, const LodView& view) {
    ++looked_at;
    const glm::dmat4 clip = glm::translate(view.clip_from_world, view.eye_mm);
    const glm::vec4 c = glm::mat4(clip) * glm::vec4(from_eye, 1);  // in floats, as the GPU has it
    not_finite += !(std::isfinite(from_eye.x) && std::isfinite(from_eye.y) && std::isfinite(from_eye.z) &&
                    std::isfinite(c.x) && std::isfinite(c.y) && std::isfinite(c.z) && std::isfinite(c.w));
  }
};
struct Cracks {
  uint64_t compared = 0, different = 0;
};

// An artwork whose finest surface is known, whichever LOD draws it.
struct Subject {
  std::string name;
  glm::dvec3 low{0}, high{0};  // without heights
  double min_mm = 0, max_mm = 0, cell_mm = 1;
  std::function<Spot(Random&)> spot;
  std::function<LodResult(const LodView&, const ReliefSet&)> select;
  std::function<void(const LodView&, const std::vector<PatchInstance>&, Numbers&)> numbers;
  std::function<void(const LodView&, const std::vector<PatchInstance>&, bool snapped, Cracks&)> cracks;
  std::function<Measured(const LodView&, const Camera&, const std::vector<PatchInstance>&)> measure;
};

// ---- over a base mesh
using PlaceHeight = std::function<double(const glm::dvec3&, const Place&)>;  // 0..1
double waves(const glm::dvec3& p, const Place& place) {
  const uint64_t h = hashOf(place, 5);
  return 0.5 + 0.2 * std::sin(0.15 * p.x + 1) * std::cos(0.15 * p.y) + 0.1 * std::sin(0.4 * (p.z + 0.3 * p.x)) +
         ((h >> 20) % 3000 == 0 ? 0.19 : 0);
}
double noise(const glm::dvec3&, const Place& place) { return static_cast<double>(hashOf(place, 9) >> 48) / 65535; }
double fallen(const glm::dvec3&, const Place&) { return 0; }

// broken_normals: normals are made unit vectors at each vertex, which has no answer where they cancel.
Subject meshSubject(NamedMesh named, double range_mm, const PlaceHeight& height, bool broken_normals = false) {
  struct Held {
    std::shared_ptr<const BaseMesh> mesh;
    MeshRelief relief;
    std::unique_ptr<TrueMeshRelief> truth;
    std::unique_ptr<MeshLod> lod;
    MeshHeight heights;
  };
  auto held = std::make_shared<Held>();
  Random random(kSeed);
  turnPatches(named.mesh, random);
  held->mesh = std::make_shared<const BaseMesh>(std::move(named.mesh));
  held->relief = {held->mesh->patches.size() <= 4 ? 1 : 0, -0.4 * range_mm, range_mm / 65535};
  held->truth = std::make_unique<TrueMeshRelief>(*held->mesh, held->relief, height);
  held->lod = std::make_unique<MeshLod>(held->mesh, held->relief.depth, held->relief.offset_mm, held->relief.scale_mm,
                                        std::shared_ptr<const ReliefOracle>(std::shared_ptr<void>(), held->truth.get()),
                                        held->truth->coarse());
  held->heights = [truth = held->truth.get()](uint32_t patch, uint32_t x, uint32_t y) {
    return truth->sample(patch, x, y);
  };
  Subject s;
  s.name = std::move(named.name);
  std::tie(s.low, s.high) = boxOf(*held->mesh);
  s.min_mm = held->relief.offset_mm, s.max_mm = held->relief.offset_mm + range_mm;
  s.cell_mm = std::max(glm::length(s.high - s.low), 1e-3) * std::ldexp(1.0, -held->relief.unitLog2() - 1);
  s.spot = [held](Random& r) {
    const BaseMesh& m = *held->mesh;
    const auto patch = static_cast<uint32_t>(r.integer(0, static_cast<int>(m.patches.size()) - 1));
    const double u = r.real(0, 1), v = r.real(0, 1);
    const auto& ends = kSideCorners[static_cast<size_t>(r.integer(0, 3))];
    auto corner = [&](int k) { return glm::dvec3(m.corners[m.patches[patch][static_cast<size_t>(k)]].position_mm); };
    return Spot{m.point(patch, u, v), m.normal(patch, u, v), corner(ends[0]), corner(ends[1])};
  };
  s.select = [held](const LodView& view, const ReliefSet& resident) { return held->lod->select(view, resident); };
  s.numbers = [held, broken_normals](const LodView& view, const std::vector<PatchInstance>& list, Numbers& numbers) {
    const auto point = pointsOf<PlainOps>(*held->mesh, held->relief, held->heights, view);
    for (const PatchInstance& p : list)
      for (uint32_t j = 0; j <= 1u << p.grid_level; ++j)
        for (uint32_t i = 0; i <= 1u << p.grid_level; ++i) {
          const auto g = snapVertex(i, j, p);
          const auto x = static_cast<uint32_t>(p.x0) + (g[0] << p.step_log2),
                     y = static_cast<uint32_t>(p.y0) + (g[1] << p.step_log2);
          glm::vec3 at = point(p, x, y);
          if (broken_normals) {
            const double side = static_cast<double>(held->truth->side());
            at = at + glm::normalize(glm::vec3(held->mesh->normal(p.node.patch, x / side, y / side)));
          }
          numbers.look(at, view);
        }
  };
  s.cracks = [held](const LodView& view, const std::vector<PatchInstance>& list, bool snapped, Cracks& cracks) {
    for (const MeshVertexFunction& twin : {twinOf<PlainOps>(*held->mesh, held->relief, held->heights, view),
                                           twinOf<FmaFirst>(*held->mesh, held->relief, held->heights, view),
                                           twinOf<FmaSecond>(*held->mesh, held->relief, held->heights, view)}) {
      const MeshSeams seams = compareMeshSeams(*held->mesh, held->relief.unitLog2(), list, twin, snapped);
      cracks.compared += seams.comparisons;
      cracks.different += seams.mismatches + seams.unbalanced;
    }
  };
  s.measure = [held](const LodView& view, const Camera& camera, const std::vector<PatchInstance>& list) {
    return measureError(*held->truth, held->relief.unitLog2(), view, camera, list);
  };
  return s;
}

// ---- flat artworks
Subject flatSubject(std::string name, FlatDomain domain, double range_mm, HeightFunction height) {
  struct Held {
    FlatDomain domain;
    std::unique_ptr<TrueRelief> truth;
    std::unique_ptr<ReliefPages> pages;
  };
  auto held = std::make_shared<Held>();
  domain.relief_scale_mm = range_mm / 65535;
  domain.relief_offset_mm = -0.4 * range_mm;
  held->domain = domain;
  held->truth = std::make_unique<TrueRelief>(domain, height);
  held->pages = std::make_unique<ReliefPages>(domain, height);
  const glm::dvec3 half(0.5 * static_cast<double>(domain.width_px) * domain.mm_per_px,
                        0.5 * static_cast<double>(domain.height_px) * domain.mm_per_px, 0);
  Subject s;
  s.name = std::move(name);
  s.low = -half, s.high = half;
  s.min_mm = domain.relief_offset_mm, s.max_mm = domain.relief_offset_mm + range_mm;
  s.cell_mm = std::ldexp(domain.mm_per_px, domain.texture_depth - domain.relief_depth);
  s.spot = [half](Random& r) {
    const double x = r.real(-1, 1) * half.x, y = r.real(-1, 1) * half.y;
    const bool upright = r.chance(0.5);
    return Spot{{x, y, 0},
                {0, 0, 1},
                upright ? glm::dvec3(-half.x, -half.y, 0) : -half,
                upright ? glm::dvec3(-half.x, half.y, 0) : glm::dvec3(half.x, -half.y, 0)};
  };
  s.select = [held](const LodView& view, const ReliefSet& resident) {
    return selectPlanarLod(held->domain, *held->truth, view, resident);
  };
  s.numbers = [held](const LodView& view, const std::vector<PatchInstance>& list, Numbers& numbers) {
    const FlatDomain& d = held->domain;
    const double unit = d.mm_per_px / (1 << kUnitsPerTexelLog2),
                 left = -0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
                 top = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px;
    for (const PatchInstance& p : list)
      for (uint32_t j = 0; j <= 1u << p.grid_level; ++j)
        for (uint32_t i = 0; i <= 1u << p.grid_level; ++i) {
          const PatchVertex v = patchVertex(d, p, i, j, view.relief, *held->pages);
          const double z =
              view.relief ? (d.relief_offset_mm + d.relief_scale_mm * v.height_q8 / 256) * view.exaggerate : 0;
          numbers.look(glm::vec3(glm::dvec3(left + v.x * unit, top - v.y * unit, z) - view.eye_mm), view);
        }
  };
  s.cracks = [held](const LodView& view, const std::vector<PatchInstance>& list, bool snapped, Cracks& cracks) {
    const SeamReport seams = compareSeams(
        held->domain, list,
        [&](const PatchInstance& p, uint32_t i, uint32_t j) {
          PatchInstance loose = p;
          if (!snapped) loose.edges.fill({p.grid_level, PatchInstance::kWholeEdge});
          return patchVertex(held->domain, loose, i, j, view.relief, *held->pages);
        },
        snapped ? snapVertex : unsnappedVertex);
    cracks.compared += seams.comparisons;
    cracks.different += seams.mismatches;
  };
  s.measure = [held](const LodView& view, const Camera& camera, const std::vector<PatchInstance>& list) {
    return measureError(held->domain, *held->truth, view, camera, list, *held->pages);
  };
  return s;
}

// ---- views
enum class Look { kAnywhere, kClose, kEdgeAtEye, kThroughNear, kOnSurface, kInside };

struct Case {
  Camera camera;
  LodView view;
};
Case randomLook(const Subject& s, Look look, Random& random) {
  const double size = std::max(glm::length(s.high - s.low), 1e-3), range = s.max_mm - s.min_mm;
  const Spot spot = s.spot(random);
  glm::dvec3 any(random.real(-1, 1), random.real(-1, 1), random.real(-1, 1));
  any = glm::length(any) > 0.1 ? glm::normalize(any) : glm::dvec3(0, 0, 1);
  const glm::dvec3 n = glm::length(spot.normal) > 1e-3 ? glm::normalize(spot.normal) : any;
  Case c;
  Camera& camera = c.camera;
  camera.fov_y = random.chance(0.2)    ? glm::radians(1.0)
                 : random.chance(0.25) ? glm::radians(170.0)
                                       : random.real(0.2, 1.6);
  camera.aspect = random.real(0.5, 2.5);
  camera.target = spot.at;
  double distance = std::exp(random.real(std::log(8 * s.cell_mm), std::log(3 * size)));
  camera.near_mm = distance * random.real(0.001, 0.3);
  camera.eye = camera.target + distance * (random.chance(0.7) ? glm::normalize(any + 1.5 * n) : any);
  switch (look) {
    case Look::kAnywhere:
      break;
    case Look::kClose:  // where the heights' range is 1 to 150 pixels
      distance = std::max(range, 1e-9 * size) * camera.viewport_height_px / (2 * std::tan(camera.fov_y / 2)) *
                 std::exp(-random.real(0, 5));
      camera.eye = camera.target + (distance + s.max_mm) * glm::normalize(n + 0.5 * any);
      camera.near_mm = 0.01 * distance;
      break;
    case Look::kEdgeAtEye: {
      const glm::dvec3 along = spot.side_to - spot.side_from;
      const double beyond = random.chance(0.3) ? 0 : std::exp(random.real(-7, 1));
      camera.target = spot.side_from;
      camera.eye = spot.side_to + beyond * along + n * (random.chance(0.5) ? 0.0 : random.real(s.min_mm, s.max_mm));
      if (glm::length(camera.eye - camera.target) < 1e-6 * size) camera.eye = camera.target + 1e-3 * size * any;
      camera.near_mm = glm::length(camera.eye - camera.target) * random.real(1e-4, 0.1);
      break;
    }
    case Look::kThroughNear:
      camera.eye = camera.target + n * distance;
      camera.near_mm = distance * (random.chance(0.3) ? 1.0 : 1 - std::exp(random.real(-12, -1)));
      break;
    case Look::kOnSurface:
      camera.eye = spot.at + n * (random.chance(0.3)   ? 0.0
                                  : random.chance(0.5) ? s.max_mm
                                                       : random.real(s.min_mm, s.max_mm));
      camera.target = camera.eye + any * (0.3 * size);
      camera.near_mm = size * std::exp(random.real(-9, -3));
      break;
    case Look::kInside: {
      const glm::dvec3 wider = glm::dvec3(std::max(std::abs(s.min_mm), std::abs(s.max_mm)));
      auto within = [&](size_t k) {
        return random.real(s.low[static_cast<int>(k)] - wider[static_cast<int>(k)],
                           s.high[static_cast<int>(k)] + wider[static_cast<int>(k)]);
      };
      camera.eye = {within(0), within(1), within(2)};
      camera.target = camera.eye + any * (0.3 * size);
      camera.near_mm = size * std::exp(random.real(-9, -3));
      break;
    }
  }
  camera.far_mm = 1e3 * (glm::length(camera.eye - camera.target) + size) + 10 * camera.near_mm;
  const double error_px = std::exp(random.real(-0.7, 2.5));
  const bool orthographic = look != Look::kThroughNear && random.chance(0.15);
  c.view = orthographic
               ? orthographicView(camera, std::max(glm::length(camera.eye - camera.target), 1e-6 * size), error_px)
               : makeView(camera, error_px);
  if (random.chance(0.2)) c.view.exaggerate = random.real(-2, 4);
  return c;
}

// ---- the checker
struct Tally {
  uint64_t views = 0, nodes = 0, samples = 0;
  Numbers numbers;
  Cracks cracks, unsnapped, one_sided;
  int above = 0, coarser_above = 0;
  double tightest = 0;  // measured / predicted
};
void check(const Subject& s, Look look, uint64_t seed, Tally& t) {
  Random random(seed);
  const Case c = randomLook(s, look, random);
  const std::string what = s.name + ", seed " + std::to_string(seed);
  ReliefSet resident;
  const int rounds = random.integer(0, 5);
  for (int round = 0; round < rounds; ++round)
    for (const ReliefRequest& w : s.select(c.view, resident).requests)
      if (rounds > 3 || random.chance(0.7)) resident.insert(w.page);
  const LodResult lod = s.select(c.view, resident);
  ++t.views;
  t.nodes += lod.instances.size();
  EXPECT_TRUE(std::isfinite(lod.max_error_px) && lod.max_error_px >= 0) << what;
  for (const ReliefRequest& w : lod.requests) EXPECT_TRUE(w.priority >= 0 && w.priority <= 1) << what;
  Numbers numbers;
  s.numbers(c.view, lod.instances, numbers);
  EXPECT_EQ(numbers.not_finite, 0u) << what;
  t.numbers.looked_at += numbers.looked_at, t.numbers.not_finite += numbers.not_finite;
  Cracks cracks;
  s.cracks(c.view, lod.instances, true, cracks);
  EXPECT_EQ(cracks.different, 0u) << what;
  t.cracks.compared += cracks.compared, t.cracks.different += cracks.different;
  const Measured m = s.measure(c.view, c.camera, lod.instances);
  t.samples += m.samples;
  const bool above = m.max_px > lod.max_error_px * (1 + 1e-6) + 1e-6;
  t.above += above;
  EXPECT_FALSE(above) << what << ": measured " << m.max_px << " px, predicted " << lod.max_error_px;
  if (m.max_px > 0.01) t.tightest = std::max(t.tightest, m.max_px / lod.max_error_px);

  // Broken on purpose: nothing snaps; every other node has the edges that it would have with more pages; every grid is
  // half as fine as promised.
  s.cracks(c.view, lod.instances, false, t.unsnapped);
  std::vector<PatchInstance> list = lod.instances;
  ReliefSet more = resident;
  for (const ReliefRequest& w : lod.requests) more.insert(w.page);
  std::map<std::array<uint32_t, 4>, PatchInstance> rich;
  auto name = [](const PatchInstance& p) {
    return std::array<uint32_t, 4>{p.node.patch, p.node.level, p.node.x, p.node.y};
  };
  for (const PatchInstance& p : s.select(c.view, more).instances) rich[name(p)] = p;
  for (PatchInstance& p : list)
    if (auto found = rich.find(name(p)); found != rich.end() && ((p.node.x + p.node.y + p.node.patch) & 1))
      p = found->second;
  s.cracks(c.view, list, true, t.one_sided);
  list = lod.instances;
  for (PatchInstance& p : list) {
    if (p.grid_level < 2) continue;
    --p.grid_level, ++p.step_log2;
    for (auto& side : p.edges)
      for (uint8_t& level : side)
        if (level != PatchInstance::kWholeEdge)
          level = std::min<uint8_t>(level, static_cast<uint8_t>(p.grid_level - (side[1] != PatchInstance::kWholeEdge)));
  }
  t.coarser_above += s.measure(c.view, c.camera, list).max_px > lod.max_error_px * (1 + 1e-6) + 1e-6;
}

NamedMesh meshNamed(const std::string& name) {
  for (NamedMesh& m : allMeshes())
    if (m.name == name) return std::move(m);
  ADD_FAILURE() << "no mesh is named " << name;
  return {"one patch", openSheet(1, 1, 100)};
}
FlatDomain flatDomain(uint64_t width_px, uint64_t height_px, double mm_per_px) {
  FlatDomain d = makeDomain(width_px, height_px, 0);
  d.mm_per_px = mm_per_px;
  return d;
}

struct Item {
  const char* name;
  std::vector<Look> looks;
  std::vector<std::function<Subject()>> subjects;
};
std::vector<Item> items() {
  auto mesh = [](std::string name, double range_mm, PlaceHeight height = waves) {
    return [=] { return meshSubject(meshNamed(name), range_mm, height); };
  };
  auto ball = [](double range_mm, PlaceHeight height = waves) {
    return [=] { return meshSubject({"ball", cubeSphere(1, 60), true}, range_mm, height); };
  };
  auto sheet = [](double range_mm, PlaceHeight height = waves) {
    return [=] { return meshSubject({"sheet", openSheet(2, 2, 40)}, range_mm, height); };
  };
  auto flat = [](uint64_t width_px, uint64_t height_px, double mm_per_px, double range_mm,
                 HeightFunction height = reliefHeight) {
    return [=] {
      return flatSubject("flat, " + std::to_string(width_px) + " x " + std::to_string(height_px) + " px",
                         flatDomain(width_px, height_px, mm_per_px), range_mm, height);
    };
  };
  auto moved = [](const glm::vec3& by) {
    return [=] {
      NamedMesh far_ball{"ball 10^7 mm away", cubeSphere(1, 60), true};
      for (BaseCorner& c : far_ball.mesh.corners) c.position_mm += by;
      return meshSubject(far_ball, 5, waves);
    };
  };
  // 0.1 m high, so that its cells are small enough to see the relief.
  auto frieze = [] {
    NamedMesh panel{"panel of 10 m", openSheet(4, 1, 2500, 0)};
    for (BaseCorner& c : panel.mesh.corners) c.position_mm.y *= 0.04f;
    return meshSubject(panel, 0.01, noise);
  };
  const std::vector<Look> anywhere = {Look::kAnywhere, Look::kClose, Look::kOnSurface};
  return {
      {"needle quads 1:10,000", anywhere, {mesh("needles 10,000:1", 0.5), flat(3000, 1, 0.05, 0.5)}},
      {"zero-area and collapsed quads",
       anywhere,
       {mesh("zero area", 3), mesh("collapsed sides", 3), mesh("one point", 3), flat(130, 1, 0.05, 0.3),
        flat(1, 1, 0.05, 0.01)}},
      {"edges that point at the eye",
       {Look::kEdgeAtEye, Look::kEdgeAtEye},
       {sheet(6), ball(5), mesh("fan of 5", 6), flat(300, 200, 0.05, 0.8)}},
      {"edges through the near plane",
       {Look::kThroughNear, Look::kThroughNear},
       {sheet(6), ball(5), flat(300, 200, 0.05, 0.8)}},
      {"eye on the surface, inside the bounds",
       {Look::kOnSurface, Look::kInside},
       {sheet(6), ball(5), mesh("torus", 6), flat(300, 200, 0.05, 0.8)}},
      {"10 um relief on a 10 m panel", anywhere, {frieze, flat(16384, 128, 10000.0 / 16384, 0.01)}},
      {"coordinates offset by 10^7 mm", anywhere, {mesh("corners 10^7 mm away", 3), moved({1e7, -1e7, 0})}},
      {"displacement larger than the patch", anywhere, {sheet(200), ball(200), flat(256, 128, 0.05, 40)}},
      {"all-flat relief (zero range)", anywhere, {sheet(0, fallen), ball(0, fallen), flat(300, 200, 0.05, 0)}},
      {"full 16-bit range", anywhere, {sheet(6, noise), ball(5, noise), flat(300, 200, 0.05, 0.8, noiseHeight)}},
      {"valence 3 and 20 corners", anywhere, {mesh("fan of 3", 5), mesh("fan of 20", 5)}},
      {"Moebius strip", anywhere, {mesh("Moebius strip", 6), mesh("Moebius strip of one row", 6)}},
      {"two touching pieces", anywhere, {mesh("two pieces that touch", 3), mesh("three sheets on a side", 3)}},
      {"open boundary", anywhere, {mesh("open strip", 5), mesh("one patch", 5), flat(333, 217, 0.05, 0.8)}},
  };
}

TEST(HardGeometry, NoNanNoCrackAndTheBoundHolds) {
  uint64_t unsnapped = 0, one_sided = 0;
  int coarser_above = 0;
  for (const Item& item : items()) {
    Tally t;
    std::string names;
    for (size_t k = 0; k < item.subjects.size(); ++k) {
      const Subject s = item.subjects[k]();
      names += (k ? ", " : "") + s.name;
      for (size_t look = 0; look < item.looks.size(); ++look) {
        if (kSanitized && look != k % item.looks.size()) continue;
        for (int view = 0; view < share(kViewsOfAKind); ++view)
          check(s, item.looks[look], kSeed + 1000 * k + 100 * look + static_cast<uint64_t>(view), t);
      }
    }
    std::printf(
        "[ figures  ] %-38s %3llu views %6llu nodes; %8llu vertices, %llu no number; %8llu compared, %llu differ; "
        "%8llu finest vertices, measured/predicted at most %.2f | "
        "broken: %llu differ unsnapped, %llu by pages of one side; %d of %llu above when coarser (%s)\n",
        item.name, static_cast<unsigned long long>(t.views), static_cast<unsigned long long>(t.nodes),
        static_cast<unsigned long long>(t.numbers.looked_at), static_cast<unsigned long long>(t.numbers.not_finite),
        static_cast<unsigned long long>(t.cracks.compared), static_cast<unsigned long long>(t.cracks.different),
        static_cast<unsigned long long>(t.samples), t.tightest, static_cast<unsigned long long>(t.unsnapped.different),
        static_cast<unsigned long long>(t.one_sided.different), t.coarser_above,
        static_cast<unsigned long long>(t.views), names.c_str());
    EXPECT_EQ(t.numbers.not_finite + t.cracks.different + static_cast<uint64_t>(t.above), 0u) << item.name;
    EXPECT_GT(t.numbers.looked_at, 0u) << item.name;
    EXPECT_GT(t.samples, 0u) << item.name << ": nothing was in view";
    unsnapped += t.unsnapped.different, one_sided += t.one_sided.different, coarser_above += t.coarser_above;
  }
  EXPECT_GT(unsnapped, 0u);
  EXPECT_GT(one_sided, 0u);
  EXPECT_GT(coarser_above, 0);
}

// The look-out for what is no number sees it: normals that cancel half-way, made unit vectors.
TEST(HardGeometry, NormalsThatCancelMustNotBeNormalised) {
  NamedMesh opposed{"opposed normals", openSheet(2, 2, 20, 0)};
  for (size_t k = 0; k < opposed.mesh.corners.size(); k += 2)
    opposed.mesh.corners[k].normal = -opposed.mesh.corners[k].normal;
  for (bool broken : {false, true}) {
    const Subject s = meshSubject(opposed, 3, waves, broken);
    Numbers numbers;
    for (uint64_t seed = kSeed; seed < kSeed + 8; ++seed) {
      Random random(seed);
      const Case c = randomLook(s, Look::kAnywhere, random);
      s.numbers(c.view, s.select(c.view, {}).instances, numbers);
    }
    EXPECT_GT(numbers.looked_at, 0u);
    EXPECT_EQ(numbers.not_finite > 0, broken);
  }
}

}  // namespace hard_geometry_test
}  // namespace relievo::test
