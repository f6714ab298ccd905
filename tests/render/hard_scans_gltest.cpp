// Hard scans through the program: each of the shapes and views that geometry/hard_geometry_test.cpp names, written as a
// mesh file, built into a package and drawn; or refused by name with exit code 3. Drawn: every vertex is a number, no
// pixel is black (surfaces have a little light everywhere; what is no number has none), and no background shows where
// the lines of sight around a pixel all meet the scan. Controls: pictures that were tampered with; the same views
// without snapping.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>

#include "geometry/mesh/ray_scene.h"
#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "tests/geometry/base_shapes.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/made_engine.h"
#include "tests/tools/cli_fixture.h"

namespace relievo {
namespace hard_scans_gltest {

constexpr int kWidth = 160, kHeight = 112;
constexpr int kMarginPx = 2;  // patches follow the scan to a fraction of this at its borders

// Binary doubles, so that what is far from the origin keeps its shape.
std::string plyOf(const TriMesh& mesh, const glm::dvec3& offset) {
  std::ostringstream out;
  out << "ply\nformat binary_little_endian 1.0\nelement vertex " << mesh.positions_mm.size()
      << "\nproperty double x\nproperty double y\nproperty double z\nelement face " << mesh.triangles.size()
      << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const glm::vec3& p : mesh.positions_mm) {
    const glm::dvec3 at = glm::dvec3(p) + offset;
    out.write(reinterpret_cast<const char*>(&at.x), 24);
  }
  for (const auto& t : mesh.triangles) {
    out.put(3);
    out.write(reinterpret_cast<const char*>(t.data()), 12);
  }
  return out.str();
}

struct Scan {
  const char* item;
  TriMesh mesh;
  std::string refused;  // what the refusal says; empty: it is built
  glm::dvec3 offset_mm{0};
  bool close_views = false;  // from on the surface, from within the bounds, along sides of patches
  int patches = 0;           // 0: as many as the builder likes
};

TriMesh sheetOf(int n, double width, double height, const std::function<double(double, double)>& z) {
  return gridMesh(n, n, false, false, [=](double u, double v) { return glm::dvec3(width * u, height * v, z(u, v)); });
}
double noise01(double u, double v) {
  return static_cast<double>(test::mix(static_cast<uint64_t>(1e6 * u) * 7919 + static_cast<uint64_t>(1e6 * v)) >> 11) *
         0x1p-53;
}
TriMesh cone(int sectors) {
  TriMesh mesh;
  mesh.positions_mm.push_back({0, 0, 30});
  for (int k = 0; k < sectors; ++k) {
    const double a = 2 * std::numbers::pi * k / sectors;
    mesh.positions_mm.push_back(glm::vec3(50 * std::cos(a), 50 * std::sin(a), 0));
    mesh.triangles.push_back({0, static_cast<uint32_t>(1 + k), static_cast<uint32_t>(1 + (k + 1) % sectors)});
  }
  return mesh;
}
// Two boxes with one corner in common.
TriMesh touchingBoxes() { return together(boxMesh(6, 20, 20, 20), boxMesh(6, 20, 20, 20), {20, 20, 20}); }
TriMesh withoutArea(TriMesh mesh) {
  const auto first = static_cast<uint32_t>(mesh.positions_mm.size());
  for (float x : {0.0f, 1.0f, 2.0f}) mesh.positions_mm.push_back({x, 70, 0});
  mesh.triangles.push_back({first, first + 1, first + 2});  // on a line
  mesh.triangles.push_back({0, 0, 1});
  return mesh;
}

std::vector<Scan> scans() {
  auto hills = [](double u, double v) { return 3 * std::sin(7 * u) * std::cos(5 * v); };
  const TriMesh needles = gridMesh(1, 1000, false, false, [](double u, double v) {
    return glm::dvec3(100 * u, 10 * v, 2 * u + 0.3 * std::sin(9 * v));
  });
  auto bumpy = [](double height_mm) {
    return cubeMesh(24, [=](const glm::dvec3& p) {
      const glm::dvec3 d = glm::normalize(p);
      return (40 + height_mm * std::sin(4 * d.x + 1) * std::cos(5 * d.y) * std::cos(3 * d.z)) * d;
    });
  };
  std::vector<Scan> all;
  all.push_back({"needle quads 1:10,000", needles, "", {}, false, 0});
  all.push_back({"zero-area quads beside others", withoutArea(ballMesh(16, 40)), "", {}, false, 0});
  all.push_back({"collapsed quads alone", boxMesh(2, 50, 0, 0), "degenerate triangles only", {}, false, 0});
  all.push_back({"edges at the eye, near, on, inside: a ball", bumpy(2), "", {}, true, 0});
  all.push_back({"the same: a sheet", sheetOf(40, 100, 80, hills), "", {}, true, 0});
  all.push_back(
      {"10 um relief on a 10 m panel",
       sheetOf(100, 10'000, 10'000, [](double u, double v) { return 0.005 * std::sin(40 * u) * std::cos(30 * v); }),
       "",
       {},
       true,
       0});
  all.push_back({"coordinates offset by 10^7 mm", bumpy(2), "", {1e7, -1e7, 1e7}, false, 0});
  all.push_back({"displacement larger than the patch", bumpy(25), "", {}, false, 200});
  all.push_back(
      {"all-flat relief (zero range)", sheetOf(20, 100, 80, [](double, double) { return 0.0; }), "", {}, false, 0});
  all.push_back({"full 16-bit range",
                 sheetOf(60, 100, 80, [](double u, double v) { return 2 * noise01(u, v); }),
                 "",
                 {},
                 false,
                 0});
  all.push_back({"valence 3 corners", boxMesh(6, 40, 30, 20), "", {}, false, 0});
  all.push_back({"a corner of valence 20", cone(20), "", {}, false, 0});
  all.push_back({"Moebius strip, cut open", moebiusMesh(), "", {}, false, 0});
  all.push_back({"two touching pieces", touchingBoxes(), "", {}, false, 0});
  all.push_back({"open boundary", wavySheet(40, 0.2), "", {}, false, 0});
  return all;
}

// Pixels whose neighbours' lines of sight all meet the scan between the near and the far plane, from the eye moved by
// that.
std::vector<bool> insideFrom(const glm::dvec3& moved_mm, const ViewTransform& view, const RayScene& scan,
                             glm::dvec3 scan_from_world) {
  scan_from_world += moved_mm;
  const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
  std::vector<Line> lines;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      auto at = [&](double depth) {
        const glm::dvec4 p =
            world_from_clip * glm::dvec4((x + 0.5) / kWidth * 2 - 1, 1 - (y + 0.5) / kHeight * 2, depth, 1);
        return glm::dvec3(p) / p.w;
      };
      if (view.orthographic) {
        const glm::dvec3 from = at(-1), through = at(1) - from, ahead = glm::normalize(through);
        lines.push_back({from + 0.5 * through + scan_from_world, ahead, 0.499 * glm::length(through)});
        continue;
      }
      const glm::dvec3 sight = at(0.5) - view.eye_mm;
      const glm::dvec3 a_mm_deep = sight / -(glm::transpose(view.world_from_camera) * sight).z;
      const double near_mm = 1.05 * view.near_mm, far_mm = 0.999 * view.far_mm;
      lines.push_back(
          {view.eye_mm + 0.5 * (near_mm + far_mm) * a_mm_deep + scan_from_world, a_mm_deep, 0.5 * (far_mm - near_mm)});
    }
  std::vector<SurfacePoint> hits(lines.size());
  scan.nearestOnLines(lines, Facing::kAny, hits);
  std::vector<bool> inside(hits.size());
  for (int y = kMarginPx; y < kHeight - kMarginPx; ++y)
    for (int x = kMarginPx; x < kWidth - kMarginPx; ++x) {
      bool all = true;
      for (int dy = -kMarginPx; dy <= kMarginPx && all; ++dy)
        for (int dx = -kMarginPx; dx <= kMarginPx && all; ++dx)
          all = static_cast<bool>(hits[static_cast<size_t>((y + dy) * kWidth + x + dx)]);
      inside[static_cast<size_t>(y * kWidth + x)] = all;
    }
  return inside;
}

// Patches lie within about that of the scan: an eye on it sees the scan's other side as well as its own.
constexpr double kCloseTo = 1e-4;  // of the diagonal
std::vector<bool> insideOf(const ViewTransform& view, const RayScene& scan, const glm::dvec3& scan_from_world,
                           double diagonal_mm) {
  std::vector<bool> inside = insideFrom({0, 0, 0}, view, scan, scan_from_world);
  for (int k = 0; k < 6; ++k) {
    glm::dvec3 moved(0);
    moved[k % 3] = (k < 3 ? kCloseTo : -kCloseTo) * diagonal_mm;
    const std::vector<bool> from_there = insideFrom(moved, view, scan, scan_from_world);
    for (size_t i = 0; i < inside.size(); ++i) inside[i] = inside[i] && from_there[i];
  }
  return inside;
}

struct Looked {
  uint64_t inside = 0, background = 0, black = 0;
};
Looked lookAt(const std::vector<uint8_t>& pixels, const std::vector<bool>& inside) {
  Looked looked;
  for (int y = kMarginPx; y < kHeight - kMarginPx; ++y)
    for (int x = kMarginPx; x < kWidth - kMarginPx; ++x) {
      const auto at = static_cast<size_t>(y * kWidth + x);
      const uint8_t* pixel = &pixels[4 * at];
      const bool seen = pixel[3] != 0;
      looked.black += seen && pixel[0] + pixel[1] + pixel[2] == 0;
      looked.inside += inside[at];
      looked.background += inside[at] && !seen;
    }
  return looked;
}

OrbitCamera cameraFrom(const glm::dvec3& eye, const glm::dvec3& target, double fov_deg) {
  OrbitCamera c;
  const glm::dvec3 back = glm::normalize(eye - target);
  c.elevation_deg = std::clamp(glm::degrees(std::asin(std::clamp(back.y, -1.0, 1.0))), -89.0, 89.0);
  c.azimuth_deg = glm::degrees(std::atan2(back.x, back.z));
  c.target_mm = target;
  c.distance_mm = glm::length(eye - target);
  c.fov_deg = fov_deg;
  return c;
}
std::vector<OrbitCamera> camerasFor(const Scan& scan, const Manifest& manifest) {
  std::vector<OrbitCamera> all;
  const Extent extent = artworkExtent(manifest);
  for (const auto& [azimuth, elevation, fov] :
       std::array<std::array<double, 3>, 3>{{{10, 15, 35}, {-50, 40, 1}, {150, -20, 100}}}) {
    OrbitCamera c = fitCamera(extent, kWidth, kHeight, fov);
    c.azimuth_deg = azimuth, c.elevation_deg = elevation;
    c.distance_mm = fitDistance(c, extent, kWidth, kHeight);
    all.push_back(c);
  }
  all.push_back(all.front());
  all.back().orthographic = true;
  if (!scan.close_views) return all;
  const BaseMesh& base = *manifest.base;
  const double size = glm::length(extent.max_mm - extent.min_mm);
  const auto patch = static_cast<uint32_t>(base.patches.size() / 2);
  const glm::dvec3 from(base.corners[base.patches[patch][0]].position_mm),
      to(base.corners[base.patches[patch][1]].position_mm), on = base.point(patch, 0.3, 0.6),
                                                            normal = glm::normalize(base.normal(patch, 0.3, 0.6));
  all.push_back(cameraFrom(to + 0.7 * (to - from), from, 35));     // an edge points at the eye
  all.push_back(cameraFrom(to, from, 60));                         // and ends there
  all.push_back(cameraFrom(on, on + normal * 0.01 * size, 90));    // on the surface, looking out
  all.push_back(cameraFrom(on, on - normal * 0.2 * size, 90));     // and in
  all.push_back(cameraFrom(on + 0.002 * size * normal, on, 170));  // close to it: the near plane goes through
  all.push_back(cameraFrom(extent.centre() + 0.01 * size * normal, on, 120));  // from within the bounds
  return all;
}

class HardScans : public testing_support::Cli {
 protected:
  std::unique_ptr<Engine> engineFor(const std::string& package, bool snapping) {
    auto opened = Package::open(file(package));
    EXPECT_TRUE(opened.ok()) << (opened.ok() ? "" : opened.error().text());
    if (!opened.ok()) return nullptr;
    auto engine = test::makeEngine(artworkFromPackage(*opened), {}, {}, kWidth, kHeight);
    if (engine && !snapping) {
      EXPECT_TRUE(injectFaults(*engine, {.no_snapping = true}).ok());
    }
    return engine;
  }
};

TEST_F(HardScans, AreDrawnWithoutHolesOrRefusedByName) {
  uint64_t unsnapped = 0;
  Looked tampered;
  for (const Scan& scan : scans()) {
    write("scan.ply", plyOf(scan.mesh, scan.offset_mm));
    const std::string patches = scan.patches ? " --patches " + std::to_string(scan.patches) : "";
    const auto built = relievo("build --mesh " + file("scan.ply") + " -o " + file("scan.relievo") + patches);
    if (!scan.refused.empty()) {
      EXPECT_EQ(built.exit_code, 3) << scan.item << ": " << built.output;
      EXPECT_NE(built.output.find(scan.refused), std::string::npos) << built.output;
      EXPECT_NE(built.output.find("scan.ply"), std::string::npos) << built.output;
      std::printf("[ figures  ] %-42s refused: %s", scan.item, built.output.c_str());
      continue;
    }
    ASSERT_EQ(built.exit_code, 0) << scan.item << ": " << built.output;
    auto engine = engineFor("scan.relievo", true);
    ASSERT_TRUE(engine);
    auto rays = RayScene::create(scan.mesh);
    ASSERT_TRUE(rays.ok());
    const glm::dvec3 scan_from_world = engine->manifest().base->origin_mm - scan.offset_mm;
    const Extent extent = artworkExtent(engine->manifest());
    const double diagonal_mm = glm::length(extent.max_mm - extent.min_mm);
    Looked sum;
    uint64_t numbers = 0, triangles = 0;
    size_t views = 0;
    for (const OrbitCamera& camera : camerasFor(scan, engine->manifest())) {
      ++views;
      engine->setCamera(camera);
      const auto settled = engine->settle(120);
      ASSERT_TRUE(settled.ok()) << scan.item << ": " << settled.error().text();
      const auto pixels = engine->readPixels();
      const std::vector<bool> inside = insideOf(engine->view(), **rays, scan_from_world, diagonal_mm);
      const Looked looked = lookAt(pixels, inside);
      EXPECT_EQ(looked.background, 0u) << scan.item << ", view " << views << ", of " << looked.inside;
      EXPECT_EQ(looked.black, 0u) << scan.item << ", view " << views;
      sum.inside += looked.inside, sum.background += looked.background, sum.black += looked.black;
      triangles += engine->stats().triangles;
      for (float f : engine->captureVertices(40'000'000)) {
        ++numbers;
        ASSERT_TRUE(std::isfinite(f)) << scan.item << ", view " << views;
      }
      auto broken = pixels;  // background here and there, and pixels without light
      for (size_t i = 0; i + 3 < broken.size(); i += 4 * 97) {
        broken[i + 3] = 0;
        if (i + 7 < broken.size()) broken[i + 4] = broken[i + 5] = broken[i + 6] = 0;
      }
      const Looked there = lookAt(broken, inside);
      tampered.background += there.background, tampered.black += there.black;
    }
    EXPECT_GT(sum.inside, 0u) << scan.item;
    std::printf(
        "[ figures  ] %-42s %3zu views, %7llu pixels inside, %llu of them background, %llu black; %8llu numbers, %7llu "
        "triangles\n",
        scan.item, views, static_cast<unsigned long long>(sum.inside), static_cast<unsigned long long>(sum.background),
        static_cast<unsigned long long>(sum.black), static_cast<unsigned long long>(numbers),
        static_cast<unsigned long long>(triangles));
    if ((scan.close_views || scan.patches) && unsnapped < 10) {
      auto broken = engineFor("scan.relievo", false);
      for (const OrbitCamera& camera : camerasFor(scan, broken->manifest())) {
        broken->setCamera(camera);
        ASSERT_TRUE(broken->settle(120).ok());
        unsnapped +=
            lookAt(broken->readPixels(), insideOf(broken->view(), **rays, scan_from_world, diagonal_mm)).background;
        if (unsnapped >= 10) break;
      }
    }
  }
  std::printf(
      "[ figures  ] background pixels: %llu without snapping; where pictures were tampered with %llu, and %llu black "
      "ones\n",
      static_cast<unsigned long long>(unsnapped), static_cast<unsigned long long>(tampered.background),
      static_cast<unsigned long long>(tampered.black));
  EXPECT_GT(tampered.background, 0u);
  EXPECT_GT(tampered.black, 0u);
  EXPECT_GT(unsnapped, 0u);
}

}  // namespace hard_scans_gltest
}  // namespace relievo
