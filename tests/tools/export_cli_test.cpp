// relievo export as its users run it: what is refused and how, files that appear whole or not at all, and the distance
// between a scan and what comes out again.
#include <array>
#include <cmath>
#include <iostream>
#include <numbers>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "geometry/mesh/ray_scene.h"
#include "geometry/scan/mesh_read.h"
#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"
#include "texturing/import/image_io.h"

namespace export_cli_test {

using namespace relievo;
using namespace relievo::testing_support;

class ExportCli : public Cli {
 protected:
  std::string get(const std::string& name) const {
    std::ifstream in(file(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  Outcome exported(const std::string& package, const std::string& target, const std::string& options = "") const {
    return relievo("export " + file(package) + " -o " + file(target) + " " + options);
  }
  void makeFlat(int side = 300) const {
    const std::string size = std::to_string(side) + "x" + std::to_string(side);
    const Outcome made = relievo("sample coin --size " + size + " --package " + file("a.relievo"));
    ASSERT_EQ(made.exit_code, 0) << made.output;
  }
};

TEST_F(ExportCli, TheSuffixSaysTheFormatAndOthersAreRefused) {
  makeFlat();
  for (const char* target : {"a.ply", "a.obj", "a.stl", "a.off", "a.glb", "B.GLB"}) {
    const Outcome r = exported("a.relievo", target, "--level 4");
    EXPECT_EQ(r.exit_code, 0) << r.output;
    EXPECT_NE(r.output.find("triangles, level 4, 16 cells a patch side"), std::string::npos) << r.output;
    EXPECT_GT(get(target).size(), 1000u);
  }
  for (const char* target : {"a.fbx", "a", "-", "a.ply.gz"}) {
    const Outcome r = relievo("export " + file("a.relievo") + " -o " + target);
    EXPECT_EQ(r.exit_code, 1) << r.output;
    EXPECT_NE(r.output.find("ends in .ply, .obj, .stl, .off or .glb"), std::string::npos) << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), 1) << r.output;
  }
}

TEST_F(ExportCli, ANameOfAnotherKindSaysWhichOptionIsMissing) {
  makeFlat();
  EXPECT_NE(exported("a.relievo", "a.svg").output.find("--contours, --section or --plane say"), std::string::npos);
  EXPECT_NE(exported("a.relievo", "a.tif").output.find("--map says which image"), std::string::npos);
  EXPECT_NE(exported("a.relievo", "a.fbx").output.find("the name says which format"), std::string::npos);
}

TEST_F(ExportCli, WhatCannotBeIsRefusedInOneSentenceAndTheOldFileStays) {
  makeFlat();
  write("old.ply", "precious");
  const auto refused = [&](const std::string& arguments, int exit_code, const std::string& text) {
    const Outcome r = relievo("export " + arguments);
    EXPECT_EQ(r.exit_code, exit_code) << arguments << ": " << r.output;
    EXPECT_NE(r.output.find(text), std::string::npos) << arguments << ": " << r.output;
    EXPECT_EQ(get("old.ply"), "precious") << arguments;
    EXPECT_EQ(filesNamed(".part-"), 0);
  };
  const std::string a = file("a.relievo"), old = " -o " + file("old.ply") + " ";
  refused(file("nowhere.relievo") + old, 2, "nowhere.relievo");
  refused(a + " -o " + file("nowhere/a.ply"), 2, "make the folder first");
  refused(file("old.ply") + old, 1, "would overwrite an input");
  refused(a + old + "--level 20", 1, "expected a --level of 0 to ");
  refused(a + old + "--level 3 --error-mm 1", 1, "excludes");
  refused(a + old + "--base", 1, "is a flat artwork, which has no base mesh");
  refused(a + old + "--error-mm -1", 1, "--error-mm");
  std::string bytes = get("a.relievo");
  for (size_t i = bytes.size() / 4; i < bytes.size() * 3 / 4; i += 1000) bytes[i] = static_cast<char>(bytes[i] ^ 0x10);
  write("damaged.relievo", bytes);
  refused(file("damaged.relievo") + old, 3, "damaged.relievo");
  write("no.relievo", "this is no package");
  refused(file("no.relievo") + old, 3, "no.relievo");
  ASSERT_EQ(relievo("export " + a + old).exit_code, 0) << "control";
  EXPECT_NE(get("old.ply"), "precious");
}

TEST_F(ExportCli, AnInterruptionOrAFullDiskLeavesNothing) {
  makeFlat(relievo::test::kSanitized ? 500 : 1400);
  write("big.obj", "precious");
  const std::string command = RELIEVO_PROGRAM " export " + file("a.relievo") + " -o " + file("big.obj");
  Outcome r = run("timeout --foreground --preserve-status -k 60 -s INT 0.5 " + command);
  EXPECT_EQ(r.exit_code, 130) << r.output;
  EXPECT_NE(r.output.find("interrupted"), std::string::npos) << r.output;
  r = run("ulimit -f 2000; " + command);
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_EQ(get("big.obj"), "precious");
  EXPECT_EQ(filesNamed(".part-"), 0);
}

// Heights come back through build as they were, in the size that the image states.
TEST_F(ExportCli, MapsOfAFlatArtworkCanBeBuiltAgain) {
  makeFlat();
  Outcome r = exported("a.relievo", "h.png", "--map height");
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("h.png: height map, 300 x 300 px, level 9, 0.1"), std::string::npos) << r.output;
  double low = 0, high = 0;
  const size_t at = r.output.find("0 to 65535 for ");
  ASSERT_NE(at, std::string::npos) << r.output;
  ASSERT_EQ(std::sscanf(r.output.c_str() + at, "0 to 65535 for %lf to %lf mm", &low, &high), 2) << r.output;
  ASSERT_EQ(exported("a.relievo", "c.png", "--map albedo").exit_code, 0);
  std::ostringstream range;
  range.precision(10);
  range << low << ":" << high;
  r = relievo("build --image " + file("c.png") + " --relief " + file("h.png") + " --relief-mm " + range.str() +
              " --mm-per-pixel tag -o " + file("again.relievo"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  const auto relief = [&](const char* package) {
    const std::string info = relievo(std::string("info ") + file(package)).output;
    double from = 0, to = 0;
    const size_t line = info.find("  relief ");
    EXPECT_EQ(std::sscanf(info.c_str() + std::min(line, info.size()), "  relief %lf to %lf", &from, &to), 2) << info;
    return std::array{from, to};
  };
  EXPECT_NEAR(relief("again.relievo")[0], relief("a.relievo")[0], 1e-4);
  EXPECT_NEAR(relief("again.relievo")[1], relief("a.relievo")[1], 1e-4);
  for (const char* wrong : {"--map heights", "--map height --base", "--map height --error-mm 1", "--normal-y down",
                            "--map normal --normal-y left"})
    EXPECT_EQ(exported("a.relievo", "x.tif", wrong).exit_code, 1) << wrong;
  r = exported("a.relievo", "x.ply", "--map height");
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("ends in .png, .tif, .exr or .jpg"), std::string::npos) << r.output;
}

// An orthophoto: what render shows straight from above, pixel by pixel.
TEST_F(ExportCli, LitMapsAreWhatRenderShowsFromAbove) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about pictures";
  for (const std::string basis : {"lrgb", "rgb", "colour"}) {
    ASSERT_EQ(relievo("sample painting --size 600x450 --basis " + basis + " --package " + file("p.relievo")).exit_code,
              0);
    const std::string options = " --light -0.6,0.5,0.4";
    const auto difference = [&](int level, const std::string& light) {
      const double mm = 400.0 / 450 * (1 << (9 - level));
      const std::string scale = std::to_string(mm) + "0";
      const Outcome map = exported("p.relievo", "lit.png", "--map lit --level " + std::to_string(level) + light);
      EXPECT_EQ(map.exit_code, 0) << map.output;
      const Outcome drawn =
          relievo("render " + file("p.relievo") + " -o " + file("drawn.png") + " --mm-per-px " + scale + options);
      if (noGl(drawn)) return -1;
      EXPECT_EQ(drawn.exit_code, 0) << drawn.output;
      const auto a = readImage8(file("lit.png")), b = readImage8(file("drawn.png"));
      if (!a || !b) return 256;
      EXPECT_EQ(a->width, b->width);
      EXPECT_EQ(a->height, b->height);
      if (a->width != b->width || a->height != b->height) return 256;
      int worst = 0;
      for (int y = 0; y < a->height; ++y)
        for (int x = 0; x < a->width; ++x)
          for (int c = 0; c < 3; ++c) {
            const auto i = static_cast<size_t>(y * a->width + x);
            worst = std::max(worst, std::abs(a->pixels[i * static_cast<size_t>(a->channels) + static_cast<size_t>(c)] -
                                             b->pixels[i * static_cast<size_t>(b->channels) + static_cast<size_t>(c)]));
          }
      return worst;
    };
    const int worst = difference(9, options);
    if (worst < 0) GTEST_SKIP() << "no GL here";
    EXPECT_LE(worst, 1) << basis;
    EXPECT_GT(difference(9, " --light 0.6,0.5,0.4"), 20) << "control: another light";
    // The light's length does not matter.
    EXPECT_LE(difference(9, " --light -6,5,4"), 1) << basis;
  }
  EXPECT_EQ(exported("p.relievo", "x.png", "--map albedo --light 1,0,0").exit_code, 1);
  EXPECT_EQ(exported("p.relievo", "x.png", "--map lit --light 0,0,0").exit_code, 1);
  EXPECT_EQ(exported("p.relievo", "x.png", "--map lit --light 1,0").exit_code, 1);
}

// ---- a scan, and what comes out again ----
// A ball with waves, radius about 40, 60 mm off its zero.
std::string wavyBallOff(int columns, int rows) {
  std::ostringstream points, faces;
  const double pi = 3.14159265358979;
  int count = 0;
  const auto point = [&](double longitude, double latitude) {
    const double r = 40 + 1.5 * std::sin(5 * longitude) * std::cos(latitude) * std::cos(4 * latitude);
    points << r * std::cos(latitude) * std::cos(longitude) + 60 << " " << r * std::cos(latitude) * std::sin(longitude)
           << " " << r * std::sin(latitude) << "\n";
    ++count;
  };
  point(0, -pi / 2);
  for (int y = 1; y < rows; ++y)
    for (int x = 0; x < columns; ++x) point(2 * pi * x / columns, pi * y / rows - pi / 2);
  point(0, pi / 2);
  const auto at = [&](int x, int y) { return 1 + (y - 1) * columns + x % columns; };
  const auto face = [&](int a, int b, int c) { faces << "3 " << a << " " << b << " " << c << "\n"; };
  for (int x = 0; x < columns; ++x) {
    face(0, at(x + 1, 1), at(x, 1));
    face(count - 1, at(x, rows - 1), at(x + 1, rows - 1));
    for (int y = 1; y + 1 < rows; ++y) {
      face(at(x, y), at(x + 1, y), at(x + 1, y + 1));
      face(at(x, y), at(x + 1, y + 1), at(x, y + 1));
    }
  }
  return "OFF\n" + std::to_string(count) + " " + std::to_string(2 * columns * (rows - 1)) + " 0\n" + points.str() +
         faces.str();
}

// From places spread evenly over the triangles of one mesh to the other's surface, in mm.
struct Distances {
  double rms = 0, max = 0;
};
Distances distances(const TriMesh& from, const TriMesh& to, size_t samples) {
  auto scene = RayScene::create(to);
  EXPECT_TRUE(scene.ok());
  std::vector<double> areas{0};
  const auto corner = [&](size_t t, size_t k) {
    return from.origin_mm + glm::dvec3(from.positions_mm[from.triangles[t][k]]);
  };
  for (size_t t = 0; t < from.triangles.size(); ++t)
    areas.push_back(areas.back() + glm::length(glm::cross(corner(t, 1) - corner(t, 0), corner(t, 2) - corner(t, 0))));
  std::mt19937 random(1);
  std::uniform_real_distribution<double> share(0, 1);
  Distances d;
  for (size_t i = 0; i < samples; ++i) {
    const auto above = std::upper_bound(areas.begin(), areas.end(), share(random) * areas.back());
    const auto t = std::min(static_cast<size_t>(above - areas.begin()) - 1, from.triangles.size() - 1);
    double u = share(random), v = share(random);
    if (u + v > 1) u = 1 - u, v = 1 - v;
    const glm::dvec3 p = corner(t, 0) + u * (corner(t, 1) - corner(t, 0)) + v * (corner(t, 2) - corner(t, 0));
    const double mm = (*scene)->closestPoint(p - to.origin_mm).along;
    d.rms += mm * mm / static_cast<double>(samples);
    d.max = std::max(d.max, mm);
  }
  d.rms = std::sqrt(d.rms);
  return d;
}

TEST_F(ExportCli, AScanComesOutAsNearAsItsBuildPromised) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("ball.off", wavyBallOff(160, 100));
  const Outcome built = relievo("build --mesh " + file("ball.off") + " -o " + file("ball.relievo"));
  ASSERT_EQ(built.exit_code, 0) << built.output;
  // "  missing   RMS 0.00272 mm, 99.9 % within 0.0115 mm, all within 0.0215 mm; ..."
  struct Promise {
    double rms = 0, most = 0, all = 0;
  };
  const auto promise = [&](const char* direction) {
    const size_t at = built.output.find(direction);
    EXPECT_NE(at, std::string::npos) << built.output;
    Promise p;
    EXPECT_EQ(std::sscanf(built.output.c_str() + at + std::string(direction).size(),
                          " RMS %lf mm, 99.9 %% within %lf mm, all within %lf mm", &p.rms, &p.most, &p.all),
              3)
        << built.output;
    return p;
  };
  const Promise missing = promise("missing"), too_much = promise("too much");
  const Outcome r = exported("ball.relievo", "out.ply");
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("full detail"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("has a quarter of the triangles, within "), std::string::npos) << r.output;
  const auto scan = readMesh(file("ball.off")), out = readMesh(file("out.ply"));
  ASSERT_TRUE(scan.ok() && out.ok());
  EXPECT_EQ(scan->diagnosis.border_loops, 0u);
  EXPECT_EQ(out->diagnosis.border_loops, 0u);
  EXPECT_EQ(out->diagnosis.pieces, 1u);
  EXPECT_TRUE(out->diagnosis.findings.empty()) << out->diagnosis.findings[0].what;
  EXPECT_EQ(out->diagnosis.vertices, out->diagnosis.triangles / 2 + 2) << "a ball";
  const Distances to_out = distances(scan->mesh, out->mesh, 20000), to_scan = distances(out->mesh, scan->mesh, 20000);
  EXPECT_NEAR(to_out.rms, missing.rms, 0.15 * missing.rms) << built.output;
  EXPECT_NEAR(to_scan.rms, too_much.rms, 0.15 * too_much.rms) << built.output;
  // Other samples than the build's may find a little more.
  EXPECT_LT(to_out.max, 1.5 * missing.all);
  EXPECT_LT(to_scan.max, 1.5 * too_much.all);
  // Coarser exports keep what they state, too, and are closed where patches of different levels meet.
  for (const auto& [error, mixed] : {std::pair{0.5, true}, {0.1, true}, {0.02, false}}) {
    const Outcome coarse = exported("ball.relievo", "coarse.ply", "--error-mm " + std::to_string(error));
    ASSERT_EQ(coarse.exit_code, 0) << coarse.output;
    EXPECT_EQ(coarse.output.find("levels ") != std::string::npos, mixed) << coarse.output;
    const auto coarse_mesh = readMesh(file("coarse.ply"));
    ASSERT_TRUE(coarse_mesh.ok());
    EXPECT_LT(coarse_mesh->mesh.triangles.size(), out->mesh.triangles.size());
    EXPECT_EQ(coarse_mesh->diagnosis.border_loops, 0u);
    EXPECT_EQ(coarse_mesh->diagnosis.vertices, coarse_mesh->diagnosis.triangles / 2 + 2) << "a ball";
    EXPECT_LE(distances(out->mesh, coarse_mesh->mesh, 20000).max, error);
    EXPECT_LE(distances(coarse_mesh->mesh, out->mesh, 20000).max, error);
  }
  // Control: a mesh that is moved by the promise is not as near.
  TriMesh moved = out->mesh;
  moved.origin_mm.x += 3 * missing.all;
  EXPECT_GT(distances(scan->mesh, moved, 20000).rms, 1.15 * missing.rms);
  // The surface alone is closed: without one triangle it is not.
  std::string open = get("out.ply");
  const size_t last_face = open.size() - 13;
  std::copy_n(open.begin() + static_cast<ptrdiff_t>(last_face) - 13, 13,
              open.begin() + static_cast<ptrdiff_t>(last_face));
  write("open.ply", open);
  const auto opened = readMesh(file("open.ply"));
  ASSERT_TRUE(opened.ok());
  EXPECT_EQ(opened->diagnosis.border_loops, 1u);
}

// A ring of cut stones: few triangles, which are the patches themselves; their tops fold a little.
std::string stonesOff() {
  std::ostringstream points, faces;
  std::mt19937 random(11);
  const auto part = [&] { return static_cast<double>(random() % 1000) / 1000; };
  constexpr int kStones = 24, kAround = 8;
  for (int s = 0; s < kStones; ++s) {
    const double turn = 2 * std::numbers::pi * s / kStones, x = 100 * std::cos(turn), y = 100 * std::sin(turn);
    const int below = s * (2 * kAround + 2), above = below + 1, first = below + 2;
    points << x << " " << y << " " << -6.5 << "\n" << x << " " << y << " " << 6 + part() << "\n";
    for (int k = 0; k < kAround; ++k) {
      const double at = 2 * std::numbers::pi * (k + 0.5 * part()) / kAround, wide = 6 + 4 * part();
      for (const double z : {-6.0, 6.0})
        points << x + (10 + z) / 10 * wide * std::cos(at) << " " << y + (10 + z) / 10 * wide * std::sin(at) << " " << z
               << "\n";
      const int a = first + 2 * k, b = first + 2 * ((k + 1) % kAround);
      faces << "3 " << below << " " << b << " " << a << "\n3 " << above << " " << a + 1 << " " << b + 1 << "\n";
      faces << "3 " << a << " " << b << " " << b + 1 << "\n3 " << a << " " << b + 1 << " " << a + 1 << "\n";
    }
  }
  return "OFF\n" + std::to_string(kStones * (2 * kAround + 2)) + " " + std::to_string(4 * kStones * kAround) + " 0\n" +
         points.str() + faces.str();
}

// Patches of the scan's own triangles give these back, in full detail, as the base mesh, and out of maps.
TEST_F(ExportCli, OwnTrianglesComeOutAsTheyWentIn) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("stones.off", stonesOff());
  const Outcome built = relievo("build --mesh " + file("stones.off") + " -o " + file("stones.relievo"));
  ASSERT_EQ(built.exit_code, 0) << built.output;
  const auto scan = readMesh(file("stones.off"));
  ASSERT_TRUE(scan.ok());
  constexpr double kRounding = 2e-3;
  for (const std::string options : {"", "--base", "--error-mm 0.001"}) {
    const Outcome r = exported("stones.relievo", "out.ply", options);
    ASSERT_EQ(r.exit_code, 0) << r.output;
    if (options != "--base") {
      EXPECT_NE(r.output.find(", full detail,"), std::string::npos) << r.output;
    }
    const auto out = readMesh(file("out.ply"));
    ASSERT_TRUE(out.ok());
    EXPECT_EQ(out->mesh.triangles.size(), scan->mesh.triangles.size()) << options;
    EXPECT_EQ(out->diagnosis.border_loops, 0u) << options;
    EXPECT_LT(distances(scan->mesh, out->mesh, 5000).max, kRounding) << options;
    EXPECT_LT(distances(out->mesh, scan->mesh, 5000).max, kRounding) << options;
  }
  ASSERT_EQ(exported("stones.relievo", "out.ply", "--level 2").exit_code, 0);
  const auto fine = readMesh(file("out.ply"));
  ASSERT_TRUE(fine.ok());
  EXPECT_EQ(fine->mesh.triangles.size(), 16 * scan->mesh.triangles.size());
  EXPECT_LT(distances(fine->mesh, scan->mesh, 5000).max, kRounding);
}

// ---- maps of a scan: its surface from them by tests/tools/patch_maps.py, which knows tools/export/PATCH_MAPS.md ----
class PatchMaps : public ExportCli {
 protected:
  void SetUp() override {
    ExportCli::SetUp();
    write("ball.off", wavyBallOff(40, 24));
    const Outcome built =
        relievo("build --mesh " + file("ball.off") + " --patches 24 --tolerance 0.1% -o " + file("ball.relievo"));
    ASSERT_EQ(built.exit_code, 0) << built.output;
  }
  // The interpreter that has NumPy; empty: none.
  static std::string python() {
    for (const std::string name : {"/usr/bin/python3", "python3"})
      if (run(name + " -c 'import numpy'").exit_code == 0) return name;
    return "";
  }
  Outcome compared(const std::string& maps) const {
    return run("cd " + folder_ + " && " + python() + " " RELIEVO_SOURCE_DIR "/tests/tools/patch_maps.py out.ply " +
               maps);
  }
};

TEST_F(PatchMaps, GiveTheExportedMeshBack) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  ASSERT_NE(python(), "") << "no python3-numpy here: tools/setup installs it";
  for (const int level : {0, 2}) {
    const std::string at = " --level " + std::to_string(level);
    ASSERT_EQ(exported("ball.relievo", "out.ply", at).exit_code, 0);
    for (const std::string end : {"tif", "exr"}) {
      for (const std::string map : {"displacement", "normal", "albedo"}) {
        const Outcome r = exported("ball.relievo", map + "." + end, "--map " + map + at);
        EXPECT_EQ(r.exit_code, 0) << r.output;
        EXPECT_NE(r.output.find(" samples, "), std::string::npos) << r.output;
      }
      const Outcome r = compared("displacement.map.json normal.map.json albedo.map.json");
      EXPECT_EQ(r.exit_code, 0) << level << end << ":\n" << r.output;
      std::cout << "[ figures  ] level " << level << ", ." << end << ": " << r.output.substr(0, r.output.find('\n'))
                << "\n";
    }
  }
  // Of patches that are cut.
  write("stones.off", stonesOff());
  ASSERT_EQ(relievo("build --mesh " + file("stones.off") + " -o " + file("stones.relievo")).exit_code, 0);
  ASSERT_EQ(exported("stones.relievo", "out.ply", "--level 2").exit_code, 0);
  ASSERT_EQ(exported("stones.relievo", "s.tif", "--map height --level 2").exit_code, 0);
  EXPECT_NE(get("s.map.json").find("\"inside\":\"triangles\""), std::string::npos);
  const Outcome of_stones = compared("s.map.json");
  EXPECT_EQ(of_stones.exit_code, 0) << of_stones.output;
  ASSERT_EQ(exported("ball.relievo", "out.ply", "--level 2").exit_code, 0);
  // Controls: a sample of the atlas, a place of the base mesh, a normal that is another.
  ASSERT_EQ(exported("ball.relievo", "h.tif", "--map height --level 2").exit_code, 0);
  ASSERT_EQ(exported("ball.relievo", "n.tif", "--map normal --level 2").exit_code, 0);
  ASSERT_EQ(compared("h.map.json n.map.json").exit_code, 0);
  for (const char* name : {"h.tif", "n.tif"}) {
    const std::string whole = get(name);
    std::string other = whole;
    const size_t sample = other.size() / 3 / 2 * 2;
    other[sample] = static_cast<char>(other[sample] ^ 0x40);
    other[sample + 1] = static_cast<char>(other[sample + 1] ^ 0x40);
    write(name, other);
    EXPECT_EQ(compared("h.map.json n.map.json").exit_code, 7) << name;
    write(name, whole);
  }
  const std::string json = get("h.map.json");
  write("h.map.json", std::string(json).replace(json.find("\"origin\":["), 10, "\"origin\":[1"));
  EXPECT_EQ(compared("h.map.json n.map.json").exit_code, 7);
}

TEST_F(PatchMaps, AreRefusedWhereTheyCannotBeAndComeWithAllTheirFiles) {
  const auto refused = [&](const std::string& target, const std::string& options, const std::string& text) {
    const Outcome r = exported("ball.relievo", target, options);
    EXPECT_EQ(r.exit_code, 1) << options << ": " << r.output;
    EXPECT_NE(r.output.find(text), std::string::npos) << options << ": " << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), 1) << r.output;
    EXPECT_EQ(filesNamed(".map."), 0) << options;
  };
  refused("a.tif", "--map depth", "a scan has --map displacement, normal and albedo alone");
  refused("a.tif", "--map lit", "a scan has --map displacement, normal and albedo alone");
  refused("a.tif", "--map normal --normal-y down", "have no --normal-y");
  refused("a.jpg", "--map albedo", "JPEG");
  refused("a.tif", "--map height --level 20", "expected a --level of 0 to ");
  Outcome r = run("cd " + folder_ + " && " RELIEVO_PROGRAM " export ball.relievo -o - --map height");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  fs::create_symlink("/dev/null", file("null.tif"));
  refused("null.tif", "--map albedo", "a scan's map is three files");
  // The package's own name is no place for the base mesh.
  fs::copy_file(file("ball.relievo"), file("n.map.obj"));
  r = exported("n.map.obj", "n.tif", "--map height");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("the map's base mesh would overwrite an input"), std::string::npos) << r.output;
  fs::remove(file("n.map.obj"));
  // Interrupted, or on a full disk, all three stay away.
  const std::string command = RELIEVO_PROGRAM " export " + file("ball.relievo") + " -o " + file("big.tif") + " --map ";
  r = run("timeout --foreground --preserve-status -k 60 -s INT 0.4 " + command + "normal");
  if (r.exit_code != 0) {  // a machine that is fast enough is done before
    EXPECT_EQ(r.exit_code, 130) << r.output;
    EXPECT_EQ(filesNamed("big."), 0);
  }
  r = run("ulimit -f 200; " RELIEVO_PROGRAM " export " + file("ball.relievo") + " -o " + file("full.tif") +
          " --map albedo");
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_EQ(filesNamed("full."), 0) << r.output;
  EXPECT_EQ(filesNamed(".part-"), 0);
}

// ---- lines ----
TEST_F(ExportCli, LinesAreDrawnOrListedAndRefusedInOneSentence) {
  makeFlat(test::kSanitized ? 100 : 300);
  Outcome r = exported("a.relievo", "c.svg", "--contours 0.25");
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find(" of them closed, "), std::string::npos) << r.output;
  EXPECT_NE(get("c.svg").find("<title>a.relievo, contours every 0.25 mm</title>"), std::string::npos);
  r = exported("a.relievo", "s.CSV", "--section -10,0,12.5,3 --level 7");
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_EQ(get("s.CSV").find("line,closed,distance_mm,x_mm,y_mm,z_mm\n1,0,0,-10,0,"), 0u);
  write("ball.off", wavyBallOff(24, 16));
  ASSERT_EQ(relievo("build --mesh " + file("ball.off") + " --patches 24 -o " + file("ball.relievo")).exit_code, 0);
  // A ball of radius 40, waves of at most 1.5 mm: at z = 20 a circle of about 34.6 mm.
  r = exported("ball.relievo", "p.csv", "--plane 0,0,2,40");
  EXPECT_EQ(r.exit_code, 0) << r.output;
  std::istringstream csv(get("p.csv"));
  std::string line;
  std::getline(csv, line);
  EXPECT_EQ(line, "line,closed,right_mm,up_mm,x_mm,y_mm,z_mm");
  int points = 0;
  while (std::getline(csv, line)) {
    double right = 0, up = 0, x = 0, y = 0, z = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "1,1,%lf,%lf,%lf,%lf,%lf", &right, &up, &x, &y, &z), 5) << line;
    EXPECT_NEAR(z, 20, 1e-6);
    EXPECT_NEAR(std::hypot(x - 60, y), 34.6, 2);
    EXPECT_NEAR(right, x, 1e-6);
    EXPECT_NEAR(up, y, 1e-6);
    ++points;
  }
  EXPECT_GT(points, 100);
  write("old.svg", "precious");
  const auto refused = [&](const char* package, const char* options, int exit_code, const char* text) {
    const Outcome failed = exported(package, "old.svg", options);
    EXPECT_EQ(failed.exit_code, exit_code) << options << failed.output;
    EXPECT_NE(failed.output.find(text), std::string::npos) << options << ": " << failed.output;
    EXPECT_EQ(get("old.svg"), "precious") << options;
  };
  refused("a.relievo", "--contours 0", 1, "--contours");
  refused("a.relievo", "--contours -1", 1, "--contours");
  refused("a.relievo", "--contours 1e-7", 1, "choose a larger step");
  refused("a.relievo", "--contours 0.1 --section 0,0,1,1", 1, "excludes");
  refused("a.relievo", "--contours 0.1 --map height", 1, "excludes");
  refused("a.relievo", "--section 0,0,1", 1, "expected four numbers");
  refused("a.relievo", "--section 0,0,1,nan", 1, "expected four numbers");
  refused("a.relievo", "--section 3,3,3,3", 1, "between two places");
  refused("a.relievo", "--section 900,0,900,5", 1, "does not reach it");
  refused("a.relievo", "--contours 100 --level 20", 1, "expected a --level of 0 to");
  refused("a.relievo", "--plane 0,0,1,0", 1, "which --section cuts");
  refused("ball.relievo", "--plane 0,0,0,1", 1, "normal of more than 0");
  refused("ball.relievo", "--plane 0,0,1,900", 1, "does not reach it");
  refused("ball.relievo", "--contours 1", 1, "--plane cuts a scan");
  refused("ball.relievo", "--section 0,0,1,1", 1, "--plane cuts a scan");
  r = exported("a.relievo", "x.pdf", "--contours 1");
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("ends in .svg or .csv"), std::string::npos) << r.output;
  r = run("ulimit -f 2; " RELIEVO_PROGRAM " export " + file("a.relievo") + " -o " + file("old.svg") +
          " --contours 0.1");
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_EQ(get("old.svg"), "precious");
  EXPECT_EQ(filesNamed(".part-"), 0);
}

}  // namespace export_cli_test
