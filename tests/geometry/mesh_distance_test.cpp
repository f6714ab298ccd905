// Distances between a scan and what was baked: surfaces a known way apart, either way, and a real scan.
#include "geometry/bake/mesh_distance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iostream>
#include <random>

#include "geometry/remesh/base_domain.h"
#include "geometry/scan/mesh_read.h"
#include "src/artwork/patch_domain.h"
#include "tests/geometry/mesh_shapes.h"
#include "tests/shared_data.h"

namespace relievo {
namespace mesh_distance_test {

std::unique_ptr<MeshBake> bake(const TriMesh& mesh, const BaseMesh& base, int cells_log2) {
  auto made = MeshBake::create(mesh, {}, base, {.cells_log2 = cells_log2});
  EXPECT_TRUE(made) << made.error().text();
  return made ? std::move(*made) : nullptr;
}

TEST(MeshDistance, spheresOneInAnother) {
  const double radius = 50;
  const TriMesh scan = sphereMesh(radius, 40);
  const double sag = radius * (1 - std::cos(std::sqrt(2.0) / 40));  // how far facets lie inside
  for (double apart : {0.0, 0.3, 1.0, -0.5}) {
    const TriMesh other = sphereMesh(radius + apart, 40);
    auto baked = bake(other, sphereBase(radius, 2), 5);
    ASSERT_TRUE(baked);
    auto d = measureDistance(scan, *baked);
    ASSERT_TRUE(d) << d.error().text();
    EXPECT_NEAR(d->diagonal_mm, 2 * radius * std::sqrt(3.0), 0.2);
    for (const DistanceStats* s : {&d->to_baked, &d->to_scan}) {
      EXPECT_EQ(s->samples, scan.positions_mm.size() + 3 * scan.triangles.size());
      EXPECT_NEAR(s->rms_mm, std::abs(apart), sag);
      EXPECT_NEAR(s->max_mm, std::abs(apart), 2 * sag);
      EXPECT_NEAR(s->percentiles_mm[0], std::abs(apart), sag);
      EXPECT_TRUE(std::is_sorted(s->percentiles_mm.begin(), s->percentiles_mm.end()));
      EXPECT_LE(s->percentiles_mm[4], s->max_mm);
    }
    EXPECT_NEAR(d->psnr_db, 20 * std::log10(d->diagonal_mm / std::max(d->to_baked.rms_mm, d->to_scan.rms_mm)), 1e-9);
    ASSERT_EQ(d->scan_vertex_mm.size(), scan.positions_mm.size());
    EXPECT_NEAR(*std::max_element(d->scan_vertex_mm.begin(), d->scan_vertex_mm.end()), std::abs(apart), 2 * sag);
  }
}

TEST(MeshDistance, partsOfTheSurfaceGiveTheSameBits) {
  const TriMesh scan = sphereMesh(50, 14);
  auto baked = bake(sphereMesh(50.3, 14), sphereBase(50, 2), 4);
  ASSERT_TRUE(baked);
  auto whole = measureDistance(scan, *baked);
  ASSERT_TRUE(whole);
  for (uint64_t memory_bytes : {uint64_t{1}, uint64_t{200} << 10, uint64_t{1} << 20}) {
    auto parts = measureDistance(scan, *baked, 3, {.memory_bytes = memory_bytes});
    ASSERT_TRUE(parts) << parts.error().text();
    EXPECT_EQ(parts->scan_vertex_mm, whole->scan_vertex_mm);
    for (auto member : {&MeshDistance::to_baked, &MeshDistance::to_scan}) {
      const DistanceStats &a = (*parts).*member, &b = (*whole).*member;
      EXPECT_EQ(a.samples, b.samples);
      EXPECT_EQ(a.max_mm, b.max_mm);
      EXPECT_EQ(a.rms_mm, b.rms_mm);
      EXPECT_EQ(a.percentiles_mm, b.percentiles_mm);
    }
    EXPECT_EQ(parts->psnr_db, whole->psnr_db);
  }
}

TEST(MeshDistance, stopsWhenInterruptedAndShowsProgress) {
  const TriMesh scan = sphereMesh(50, 40);
  auto baked = bake(scan, sphereBase(50, 2), 5);
  ASSERT_TRUE(baked);
  double last = -1;
  DistanceOptions run{.workers = 1, .progress = [&](double done) {
                        EXPECT_GE(done, last);
                        EXPECT_LE(done, 1);
                        last = done;
                      }};
  auto whole = measureDistance(scan, *baked, 3, run);
  ASSERT_TRUE(whole);
  EXPECT_GT(last, 0.9);
  run.workers = 3;
  run.progress = {};
  auto again = measureDistance(scan, *baked, 3, run);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->scan_vertex_mm, whole->scan_vertex_mm);
  EXPECT_EQ(again->psnr_db, whole->psnr_db);
  // At any time: before, while samples go one way, or the other.
  for (double when : {0.0, 0.2, 0.7}) {
    std::atomic<bool> interrupted{false};
    double seen = 0;
    run = {.workers = 1,
           .progress =
               [&](double done) {
                 seen = done;
                 if (done >= when) interrupted = true;
               },
           .interrupted = &interrupted};
    auto stopped = measureDistance(scan, *baked, 3, run);
    ASSERT_FALSE(stopped);
    EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
    EXPECT_LT(seen, when + 0.2);
  }
}

TEST(MeshDistance, eachWaySeesWhatTheOtherMisses) {
  auto flat = [](double, double) { return 0.0; };
  TriMesh scan = sheetMesh(10, 10, 10, 10, flat);
  const TriMesh whole = scan;
  auto baked = bake(whole, sheetBase(10, 10, 1, 1), 2);
  auto same = measureDistance(scan, *baked);
  ASSERT_TRUE(same);
  EXPECT_LT(same->to_baked.max_mm + same->to_scan.max_mm, 1e-6);
  EXPECT_EQ(same->psnr_db, 240);
  // A piece 7 mm above that the bake lacks: seen from the scan alone.
  const TriMesh piece = sheetMesh(1, 1, 1, 1, [](double, double) { return 7.0; });
  const auto first = static_cast<uint32_t>(scan.positions_mm.size());
  scan.positions_mm.insert(scan.positions_mm.end(), piece.positions_mm.begin(), piece.positions_mm.end());
  for (const auto& t : piece.triangles) scan.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
  auto more = measureDistance(scan, *baked);
  ASSERT_TRUE(more);
  EXPECT_NEAR(more->to_baked.max_mm, 7, 1e-5);
  EXPECT_LT(more->to_scan.max_mm, 1e-5);
  // A scan of a half of it: seen from the bake alone; half of the area is as far away as it lies.
  const TriMesh half = sheetMesh(5, 10, 10, 10, flat);
  auto less = measureDistance(half, *baked, 30);
  ASSERT_TRUE(less);
  EXPECT_LT(less->to_baked.max_mm, 1e-5);
  EXPECT_NEAR(less->to_scan.max_mm, 5, 0.05);
  EXPECT_NEAR(less->to_scan.percentiles_mm[1], 4, 0.1);  // p90: of x in 0..5 there, 0.8
  EXPECT_NEAR(less->to_scan.rms_mm, std::sqrt(0.5 * 25.0 / 3), 0.05);
}

// Area counts, not triangles: half of a sheet cut finely changes nothing.
TEST(MeshDistance, samplesAreSpreadOverTheArea) {
  auto flat = [](double, double) { return 0.0; };
  auto baked = bake(sheetMesh(10, 10, 2, 2, flat), sheetBase(10, 10, 1, 1), 1);
  TriMesh scan = sheetMesh(5, 10, 40, 80, flat);  // fine, on the bake
  const TriMesh away = sheetMesh(5, 10, 1, 1, [](double, double) { return 2.0; });
  const auto first = static_cast<uint32_t>(scan.positions_mm.size());
  scan.positions_mm.insert(scan.positions_mm.end(), away.positions_mm.begin(), away.positions_mm.end());
  for (const auto& t : away.triangles) scan.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
  auto d = measureDistance(scan, *baked, 20);
  ASSERT_TRUE(d);
  EXPECT_NEAR(d->to_baked.rms_mm, std::sqrt(0.5 * 4), 0.05);
}

TEST(MeshDistance, bakedTrianglesAreTheFinestSurface) {
  const TriMesh mesh =
      starMesh([](const glm::dvec3& d) { return 10 + 0.5 * std::sin(9 * d.x) * std::cos(7 * d.y + 3 * d.z); }, 60);
  for (int cells_log2 : {3, 8}) {
    BaseMesh base = sphereBase(9, 1);
    base.origin_mm = {3, 4, 5};
    TriMesh moved = mesh;
    moved.origin_mm = base.origin_mm;
    auto baked = bake(moved, base, cells_log2);
    ASSERT_TRUE(baked);
    const TriMesh surface = bakedTriangles(*baked);
    EXPECT_EQ(surface.origin_mm, base.origin_mm);
    // Each vertex is one of the finest grid's; outside is outside.
    double volume = 0;
    for (const auto& t : surface.triangles) {
      const glm::dvec3 a(surface.positions_mm[t[0]]), b(surface.positions_mm[t[1]]), c(surface.positions_mm[t[2]]);
      volume += glm::dot(a, glm::cross(b, c)) / 6;
    }
    EXPECT_NEAR(volume, 4.0 / 3 * std::acos(-1.0) * 1000, 100);
    EXPECT_GT(volume, 0);
    const size_t n = size_t{kPagePx} << baked->reliefDepth();
    std::vector<uint16_t> q((n + 1) * (n + 1));
    std::vector<glm::dvec3> finest;
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      ASSERT_TRUE(baked->heights(p, q));
      for (size_t i = 0; i < q.size(); i += 37) {
        const double u = static_cast<double>(i % (n + 1)) / static_cast<double>(n),
                     v = static_cast<double>(i / (n + 1)) / static_cast<double>(n);
        finest.push_back(base.point(p, u, v) +
                         (baked->reliefOffsetMm() + baked->reliefScaleMm() * q[i]) * base.normal(p, u, v));
      }
    }
    TriMesh points;  // each a triangle of no size: only its vertices count
    for (const glm::dvec3& p : finest) points.positions_mm.push_back(glm::vec3(p));
    points.origin_mm = base.origin_mm;
    points.triangles.push_back({0, 1, 2});
    auto d = measureDistance(points, *baked, 0);
    ASSERT_TRUE(d);
    EXPECT_EQ(d->to_baked.samples, finest.size());
    EXPECT_LT(d->to_baked.max_mm, std::max(5e-6 * 35, baked->reliefScaleMm()) * 1.01 + 2e-6);
  }
}

TEST(MeshDistance, aRealScan) {
  const std::filesystem::path path = sharedData("laurana.ply");
  if (path.empty()) GTEST_SKIP() << "no ../shared/data/laurana.ply beside the checkout";
  auto scan = readMesh(path.string());
  ASSERT_TRUE(scan) << scan.error().text();
  auto base = makeBaseMesh(scan->mesh, {.patches = 600});
  ASSERT_TRUE(base) << base.error().text();
  double last = 0;
  for (int cells_log2 : {2, 4}) {
    auto baked = bake(scan->mesh, *base, cells_log2);
    ASSERT_TRUE(baked);
    EXPECT_LT(static_cast<double>(baked->report().by_closest_point),
              0.02 * static_cast<double>(baked->report().samples));
    auto d = measureDistance(scan->mesh, *baked);
    ASSERT_TRUE(d);
    std::cout << "2^" << cells_log2 << " cells, "
              << static_cast<double>(baked->report().samples) / static_cast<double>(scan->mesh.positions_mm.size())
              << " samples a vertex: " << d->psnr_db << " dB, max "
              << std::max(d->to_baked.max_mm, d->to_scan.max_mm) / d->diagonal_mm << " of the diagonal\n";
    EXPECT_GT(d->psnr_db, last + 6);  // four times the samples twice: at least 3 dB each time
    last = d->psnr_db;
  }
  EXPECT_GT(last, 75);
}

}  // namespace mesh_distance_test
}  // namespace relievo
