// Lines and closest points against triangles: analytic planes and spheres, and brute force over all triangles.
#include "geometry/mesh/ray_scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <span>
#include <utility>

#include "geometry/mesh/closest_search.h"
#include "geometry/mesh/mesh_order.h"
#include "tests/geometry/mesh_shapes.h"

namespace relievo {
namespace ray_scene_test {

// The distance to a triangle by its interior and its three segments.
double distanceTo(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c, const glm::dvec3& p) {
  auto segment = [&](const glm::dvec3& from, const glm::dvec3& to) {
    const glm::dvec3 d = to - from;
    const double t = std::clamp(glm::dot(p - from, d) / glm::dot(d, d), 0.0, 1.0);
    return glm::length(p - from - t * d);
  };
  double best = std::min({segment(a, b), segment(b, c), segment(c, a)});
  const glm::dvec3 n = glm::cross(b - a, c - a);
  const glm::dvec3 foot = p - n * (glm::dot(p - a, n) / glm::dot(n, n));
  const bool inside = glm::dot(glm::cross(b - a, foot - a), n) >= 0 && glm::dot(glm::cross(c - b, foot - b), n) >= 0 &&
                      glm::dot(glm::cross(a - c, foot - c), n) >= 0;
  if (inside) best = std::min(best, glm::length(p - foot));
  return best;
}

TEST(RayScene, closestPointsAreThoseOfBruteForce) {
  const TriMesh mesh = sphereMesh(10.0, 12);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene) << scene.error().text();
  std::mt19937 random(7);
  std::uniform_real_distribution<double> place(-15, 15);
  for (int i = 0; i < 2000; ++i) {
    const glm::dvec3 p(place(random), place(random), place(random));
    double expected = std::numeric_limits<double>::infinity();
    for (const auto& t : mesh.triangles)
      expected =
          std::min(expected, distanceTo(mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]], p));
    const SurfacePoint found = (*scene)->closestPoint(p);
    ASSERT_TRUE(found);
    EXPECT_NEAR(found.along, expected, 1e-12);
    const auto& t = mesh.triangles[found.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    EXPECT_NEAR(glm::length(a + found.b1 * (b - a) + found.b2 * (c - a) - p), expected, 1e-12);
    EXPECT_TRUE((*scene)->closestPoint(p, expected * (1 + 1e-9)));
    EXPECT_FALSE((*scene)->closestPoint(p, expected * (1 - 1e-6)));
  }
}

TEST(RayScene, linesTakeTheNearestSurfaceThatFacesThem) {
  const TriMesh mesh = sphereMesh(10.0, 24);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene);
  std::mt19937 random(8);
  std::normal_distribution<double> gauss;
  for (int i = 0; i < 2000; ++i) {
    const glm::dvec3 n = glm::normalize(glm::dvec3(gauss(random), gauss(random), gauss(random)));
    // From 9 along n, whose length is 2: the sphere's outside is 0.5 away; its other side, 9.5 away, faces the other
    // way.
    const SurfacePoint out = (*scene)->nearestOnLine({9.0 * n, 2.0 * n, 20}, Facing::kAlong);
    ASSERT_TRUE(out);
    EXPECT_NEAR(out.along, 0.5, 0.05);
    EXPECT_LE(out.along, 0.5 + 1e-6);  // the mesh is inscribed
    // From beyond: downwards.
    const SurfacePoint back = (*scene)->nearestOnLine({11.0 * n, 2.0 * n, 20}, Facing::kAlong);
    ASSERT_TRUE(back);
    EXPECT_NEAR(back.along, -0.5, 0.05);
    // From -9 along n the near side faces away: only Facing::kAny takes it.
    const SurfacePoint far = (*scene)->nearestOnLine({-9.0 * n, n, 30}, Facing::kAlong);
    ASSERT_TRUE(far);
    EXPECT_NEAR(far.along, 19, 0.1);
    const SurfacePoint any = (*scene)->nearestOnLine({-9.0 * n, n, 30}, Facing::kAny);
    ASSERT_TRUE(any);
    EXPECT_NEAR(any.along, -1, 0.1);
    EXPECT_FALSE((*scene)->nearestOnLine({9.0 * n, 2.0 * n, 0.4}, Facing::kAlong));
    // What the line is said to meet lies on the line.
    const auto& t = mesh.triangles[out.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    EXPECT_LT(glm::length(a + out.b1 * (b - a) + out.b2 * (c - a) - (9.0 + 2.0 * out.along) * n), 1e-5);
  }
}

TEST(RayScene, linesThroughVerticesAndEdgesAreNotLost) {
  const TriMesh mesh = sphereMesh(10.0, 16);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene);
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      const glm::dvec3 a(mesh.positions_mm[t[k]]), b(mesh.positions_mm[t[(k + 1) % 3]]);
      for (const glm::dvec3& p : {a, 0.5 * (a + b)}) {
        const SurfacePoint on = (*scene)->nearestOnLine({p, glm::normalize(p), 1}, Facing::kAlong);
        ASSERT_TRUE(on);
        EXPECT_NEAR(on.along, 0, 1e-5);
      }
    }
  }
}

// Whatever memory the regions may have, the very same triangle and place come out: on edges and at vertices, where
// several triangles are equally near, above all. Regions of another size: the same place, but for rounding.
TEST(RayScene, regionsDoNotChangeResults) {
  TriMesh mesh = sphereMesh(10.0, 12);
  std::mt19937 random(9);
  std::shuffle(mesh.triangles.begin(), mesh.triangles.end(), random);  // every region all over the sphere
  const TriMesh spread = mesh;
  std::sort(mesh.triangles.begin(), mesh.triangles.end(),
            [&](const auto& a, const auto& b) { return mesh.positions_mm[a[0]].x < mesh.positions_mm[b[0]].x; });
  const auto& p = mesh.positions_mm;
  std::vector<Line> lines;
  std::vector<glm::dvec3> places;
  std::uniform_real_distribution<double> in(-1, 1);
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a(p[t[0]]), b(p[t[1]]), c(p[t[2]]);
    for (const glm::dvec3& at : {a, 0.5 * (a + b), (a + b + c) / 3.0}) {
      lines.push_back({at * (1 + 0.05 * in(random)), glm::normalize(at), 25});
      lines.push_back(lines.back());
      lines.back().likely = 0.3;
      places.push_back(at * (1 + 0.2 * in(random)));
    }
  }
  for (int i = 0; i < 300; ++i) {
    lines.push_back({10.0 * glm::dvec3(in(random), in(random), in(random)),
                     glm::dvec3(in(random), in(random), in(random)), 8 * std::abs(in(random))});
    places.push_back(15.0 * glm::dvec3(in(random), in(random), in(random)));
  }
  for (const TriMesh* m : {&std::as_const(mesh), &spread}) {
    std::vector<SurfacePoint> expected, same;
    std::vector<SurfacePoint> hits(lines.size());
    uint32_t last_run = 0;
    for (const auto& [run, budget] :
         {std::pair<uint32_t, uint64_t>{1u << 20, ~uint64_t{0}}, {300, ~uint64_t{0}}, {300, 300 * 64 * 4}}) {
      auto scene = RayScene::create(*m, {.region_triangles = run, .budget_bytes = budget});
      ASSERT_TRUE(scene);
      std::vector<SurfacePoint> found;
      for (Facing facing : {Facing::kAny, Facing::kAlong}) {
        (*scene)->nearestOnLines(lines, facing, hits);
        found.insert(found.end(), hits.begin(), hits.end());
      }
      for (const glm::dvec3& place : places) found.push_back((*scene)->closestPoint(place, 3));
      ASSERT_TRUE((*scene)->status());
      if (expected.empty()) expected = found;
      ASSERT_EQ(found.size(), expected.size());
      if (run != last_run) same = found;
      last_run = run;
      for (size_t i = 0; i < found.size(); ++i) {
        ASSERT_EQ(found[i].triangle, same[i].triangle) << i << ", regions of " << run << ", " << budget << " bytes";
        ASSERT_EQ(found[i].along, same[i].along) << i;
        ASSERT_EQ(found[i].b1, same[i].b1) << i;
        ASSERT_EQ(found[i].b2, same[i].b2) << i;
        ASSERT_EQ(static_cast<bool>(found[i]), static_cast<bool>(expected[i])) << i;
        if (found[i]) {
          ASSERT_NEAR(found[i].along, expected[i].along, 2e-6) << i << ", regions of " << run;
        }
      }
      EXPECT_EQ((*scene)->regions(), (m->triangles.size() + run - 1) / run);
      // Control: with little memory hierarchies are built again and again; with enough, once.
      EXPECT_EQ((*scene)->builds() > (*scene)->regions(), budget != ~uint64_t{0});
      EXPECT_GE((*scene)->builds(), (*scene)->regions());
    }
    // Control: there are ties, and they are decided by the triangles' order.
    TriMesh backwards = *m;
    std::reverse(backwards.triangles.begin(), backwards.triangles.end());
    auto scene = RayScene::create(backwards);
    ASSERT_TRUE(scene);
    (*scene)->nearestOnLines(lines, Facing::kAny, hits);
    size_t other = 0;
    for (size_t i = 0; i < lines.size(); ++i)
      if (hits[i]) other += m->triangles.size() - 1 - hits[i].triangle != expected[i].triangle;
    EXPECT_GT(other, lines.size() / 20);
  }
}

// Fills the stack below the caller with floats that, taken for rays, begin before the line's point.
[[gnu::noinline]] void spoilStack() {
  volatile float stack[1 << 14];
  for (volatile float& f : stack) f = -1;
}

// A machine without AVX has packets of four rays and no mask: what is in a packet's other lanes must not count, be the
// packet not full, or some of its lines met already.
TEST(RayScene, machinesWithoutAvxFindTheSame) {
  TriMesh mesh = sphereMesh(10.0, 12);
  std::sort(mesh.triangles.begin(), mesh.triangles.end(),
            [&](const auto& a, const auto& b) { return mesh.positions_mm[a[0]].x < mesh.positions_mm[b[0]].x; });
  std::mt19937 random(12);
  std::uniform_real_distribution<double> in(-1, 1);
  std::vector<Line> lines;
  for (int i = 0; i < 3000; ++i) {
    const glm::dvec3 n = glm::normalize(glm::dvec3(in(random), in(random), in(random)));
    lines.push_back({(10 + in(random)) * n, n, i % 5 == 0 ? 0.2 : 25.0, i % 3 == 0 ? 0.5 : 0.0});
    if (i % 7 == 0) lines.back().direction = glm::dvec3(0);
  }
  for (uint32_t run : {1u << 20, 100u}) {
    auto here = RayScene::create(mesh, {.region_triangles = run});
    auto there = RayScene::create(mesh, {.region_triangles = run, .device = "isa=sse2"});
    ASSERT_TRUE(here) << here.error().text();
    ASSERT_TRUE(there) << there.error().text();
    for (Facing facing : {Facing::kAny, Facing::kAlong}) {
      size_t met = 0;
      for (size_t first = 0, count = 1; first + count <= lines.size(); first += count, count = count % 11 + 1) {
        const std::span<const Line> some(lines.data() + first, count);
        std::vector<SurfacePoint> expected(count), found(count);
        (*here)->nearestOnLines(some, facing, expected);
        spoilStack();
        (*there)->nearestOnLines(some, facing, found);
        for (size_t i = 0; i < count; ++i) {
          ASSERT_EQ(static_cast<bool>(found[i]), static_cast<bool>(expected[i])) << first + i;
          if (!found[i]) continue;
          ++met;
          ASSERT_NEAR(found[i].along, expected[i].along, 2e-6) << first + i;
        }
      }
      EXPECT_GT(met, lines.size() / 2);
      EXPECT_LT(met, lines.size() * 9 / 10);  // control: some meet nothing
    }
  }
}

// Where hits are expected is a matter of time only.
TEST(RayScene, aLikelyDistanceIsNoLimit) {
  const TriMesh mesh = sphereMesh(10.0, 24);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene);
  std::mt19937 random(10);
  std::normal_distribution<double> gauss;
  std::uniform_real_distribution<double> in(0.5, 1.5);
  for (int i = 0; i < 2000; ++i) {
    const glm::dvec3 n = glm::normalize(glm::dvec3(gauss(random), gauss(random), gauss(random)));
    Line line{10 * in(random)*n, n, 20};
    const SurfacePoint plain = (*scene)->nearestOnLine(line, Facing::kAlong);
    for (double likely : {1e-9, 0.01, 1.0, 100.0}) {
      line.likely = likely;
      const SurfacePoint hit = (*scene)->nearestOnLine(line, Facing::kAlong);
      ASSERT_EQ(static_cast<bool>(hit), static_cast<bool>(plain));
      if (hit) {
        ASSERT_NEAR(hit.along, plain.along, 1e-6);
      }
    }
  }
}

TEST(MeshOrder, bringsNeighboursTogether) {
  TriMesh mesh = sphereMesh(10.0, 200);
  ASSERT_GE(mesh.triangles.size(), kManyTriangles);
  EXPECT_FALSE(needsOrder(mesh));
  std::mt19937 random(11);
  std::shuffle(mesh.triangles.begin(), mesh.triangles.end(), random);
  EXPECT_TRUE(needsOrder(mesh));
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    mesh.corner_uv.push_back({glm::vec2(static_cast<float>(mesh.triangles[t][1]), 0)});
  for (const auto& t : mesh.triangles) mesh.image_of.push_back(static_cast<uint16_t>(t[1] % 1000));
  // The part of the sphere's size that runs of a hundredth of all triangles take, on the mean.
  auto extent = [](const TriMesh& m) {
    double sum = 0;
    const size_t run = m.triangles.size() / 100;
    for (size_t first = 0; first + run <= m.triangles.size(); first += run) {
      glm::vec3 low(1e9f), high(-1e9f);
      for (size_t t = first; t < first + run; ++t)
        for (uint32_t v : m.triangles[t])
          low = glm::min(low, m.positions_mm[v]), high = glm::max(high, m.positions_mm[v]);
      sum += glm::length(high - low) / (20 * std::sqrt(3.0)) / 100;
    }
    return sum;
  };
  EXPECT_GT(extent(mesh), 0.95);
  TriMesh ordered = mesh;
  ASSERT_TRUE(orderTriangles(ordered, 1));
  EXPECT_LT(extent(ordered), 0.3);
  EXPECT_FALSE(needsOrder(ordered));
  EXPECT_EQ(ordered.positions_mm, mesh.positions_mm);
  for (size_t t = 0; t < ordered.triangles.size(); ++t)
    ASSERT_TRUE(ordered.corner_uv[t][0].x == static_cast<float>(ordered.triangles[t][1]) &&
                ordered.image_of[t] == ordered.triangles[t][1] % 1000);
  auto sorted = [](TriMesh m) {
    std::sort(m.triangles.begin(), m.triangles.end());
    return m.triangles;
  };
  EXPECT_EQ(sorted(ordered), sorted(mesh));
  TriMesh again = mesh;
  ASSERT_TRUE(orderTriangles(again, 3));
  EXPECT_EQ(again.triangles, ordered.triangles);
  const std::atomic<bool> interrupted{true};
  EXPECT_FALSE(orderTriangles(again, 1, &interrupted));
  EXPECT_EQ(again.triangles, ordered.triangles);
}

TEST(RayScene, anInterruptedBuildSaysSo) {
  const TriMesh mesh = sphereMesh(10.0, 64);
  const std::atomic<bool> interrupted{true};
  auto scene = RayScene::create(mesh, &interrupted);
  ASSERT_FALSE(scene);
  EXPECT_EQ(scene.error().kind, ErrorKind::kInterrupted);
}

// Near, far and on the surface; from any place where the search may begin, and within any distance.
// Boxes are compared in single precision: none within a distance in double precision may be left out.
TEST(SearchReach, missesNoBoxWithinTheDistance) {
  std::mt19937 random(17);
  std::uniform_real_distribution<double> unit(-1, 1);
  size_t tight = 0, missed_without_slack = 0, left_out = 0;
  for (int round = 0; round < 20000; ++round) {
    const double size = std::pow(10.0, 4 * unit(random)), far = round % 2 ? size : 100 * size;
    auto point = [&](double scale) { return scale * glm::dvec3(unit(random), unit(random), unit(random)); };
    const glm::dvec3 place = point(far);
    BoxGroup boxes;
    for (size_t i = 0; i < BoxGroup::kBoxes; ++i) {
      Box box;
      const glm::dvec3 corner = place + point(size);
      box.add(glm::vec3(corner));
      box.add(glm::vec3(corner + point(0.5 * size)));
      boxes.set(i, box);
      ASSERT_EQ(boxes.box(i).low, box.low);
      ASSERT_EQ(boxes.box(i).high, box.high);
    }
    SearchReach reach(place);
    const BoxGroup::Lanes squared = boxes.squaredDistances(reach.place());
    for (size_t i = 0; i < BoxGroup::kBoxes; ++i) {
      const double exact = std::sqrt(boxes.box(i).squaredDistance(place));
      reach.set(exact);
      ASSERT_LE(squared[i], reach.squared()) << round;
      missed_without_slack += squared[i] > static_cast<float>(exact * exact);
      ++tight;
      reach.set(exact - 1e-3 * far);
      left_out += exact > 2e-3 * far && squared[i] > reach.squared();
    }
    // Lanes that nothing was set to are never near.
    reach.set(1e9 * far);
    EXPECT_GT(BoxGroup().squaredDistances(reach.place())[0], reach.squared());
  }
  EXPECT_GT(missed_without_slack, tight / 10);  // control
  EXPECT_GT(left_out, tight / 4);
}

// Each triangle is in one run, within its box; runs beside one another lie near one another.
TEST(TriangleRuns, HoldEachTriangleOnce) {
  TriMesh mesh = sphereMesh(10.0, 24);
  mesh.triangles.pop_back();  // the last run is not a whole one
  auto sum_of_steps = [](const std::vector<Box>& boxes) {
    double sum = 0;
    for (size_t i = 1; i < boxes.size(); ++i)
      sum += glm::length(boxes[i].low + boxes[i].high - boxes[i - 1].low - boxes[i - 1].high);
    return sum;
  };
  const TriangleRuns runs(mesh, 2);
  std::vector<int> seen(mesh.triangles.size(), 0);
  std::vector<Box> boxes;
  size_t short_runs = 0;
  for (size_t r = 0; r < runs.boxes().parts(); ++r) {
    const Box box = runs.boxes().part(r);
    boxes.push_back(box);
    short_runs += runs.sizeOf(r) < TriangleRuns::kRun;
    for (size_t i = 0; i < runs.sizeOf(r); ++i) {
      const uint32_t t = runs.triangle(r, i);
      ++seen[t];
      for (uint32_t v : mesh.triangles[t]) EXPECT_EQ(box.squaredDistance(glm::dvec3(mesh.positions_mm[v])), 0);
    }
  }
  EXPECT_EQ(short_runs, 1u);
  EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), static_cast<ptrdiff_t>(seen.size()));
  std::shuffle(boxes.begin(), boxes.end(), std::mt19937(3));
  const double shuffled = sum_of_steps(boxes);
  boxes.clear();
  for (size_t r = 0; r < runs.boxes().parts(); ++r) boxes.push_back(runs.boxes().part(r));
  EXPECT_LT(sum_of_steps(boxes), 0.5 * shuffled);
}

// Triangles in any order of the list are searched as fast, and found the same.
TEST(ClosestSearch, distancesAreThoseOfRayScenesBitForBit) {
  const TriMesh mesh = sphereMesh(10.0, 24);
  TriMesh shuffled = mesh;
  std::mt19937 random(20261125);
  std::shuffle(shuffled.triangles.begin(), shuffled.triangles.end(), random);
  auto scene = RayScene::create(mesh);
  ASSERT_TRUE(scene) << scene.error().text();
  const ClosestSearch search(mesh, 2), search_shuffled(shuffled, 2);
  EXPECT_FALSE(search.runs().ordered());
  EXPECT_TRUE(search_shuffled.runs().ordered());
  constexpr double kAny = std::numeric_limits<double>::infinity();
  std::uniform_real_distribution<double> place(-15, 15);
  size_t last = kNoPart;
  int differ_from_the_next = 0;
  double before = -1;
  for (int i = 0; i < 4000; ++i) {
    glm::dvec3 p(place(random), place(random), place(random));
    if (i % 4 == 1) p *= 1e4;
    if (i % 4 == 2) p = glm::dvec3(mesh.positions_mm[random() % mesh.positions_mm.size()]);
    const double expected = (*scene)->closestPoint(p).along;
    size_t none = kNoPart;
    EXPECT_EQ(search.distance(p, kAny, none), expected);
    size_t anywhere = kNoPart;
    EXPECT_EQ(search_shuffled.distance(p, kAny, anywhere), expected);
    EXPECT_EQ(search.distance(p, kAny, last), expected) << "begun where the last one ended";
    EXPECT_EQ(search.distance(p, expected, none), expected);
    if (expected > 0) {
      EXPECT_EQ(search.distance(p, expected * (1 - 1e-9), none), kAny) << "nothing is as near";
    }
    differ_from_the_next += expected != before;
    before = expected;
  }
  EXPECT_GT(differ_from_the_next, 2900) << "the control: places have distances of their own";
}

}  // namespace ray_scene_test
}  // namespace relievo
