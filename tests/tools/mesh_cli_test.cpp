// relievo build --mesh as its users run it: the scan's diagnosis, what is refused and how, reports, the same bytes
// again.
#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numeric>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "cli_fixture.h"
#include "tests/geometry/scan_shapes.h"
#include "tests/view_share.h"

namespace mesh_cli_test {

using namespace relievo::testing_support;
using Json = nlohmann::json;

// A sphere with waves, radius about 40: a corner of a grid of longitudes and latitudes after the other; the poles are
// one vertex each.
struct Ball {
  std::vector<std::array<double, 3>> points;
  std::vector<std::array<int, 3>> triangles;
};
Ball wavyBall(int columns, int rows) {
  Ball ball;
  auto point = [&](double longitude, double latitude) {
    const double r = 40 + 1.5 * std::sin(5 * longitude) * std::cos(latitude) * std::cos(4 * latitude);
    ball.points.push_back({r * std::cos(latitude) * std::cos(longitude), r * std::cos(latitude) * std::sin(longitude),
                           r * std::sin(latitude)});
  };
  const double pi = 3.14159265358979;
  point(0, -pi / 2);
  for (int y = 1; y < rows; ++y)
    for (int x = 0; x < columns; ++x) point(2 * pi * x / columns, pi * y / rows - pi / 2);
  point(0, pi / 2);
  auto at = [&](int x, int y) { return 1 + (y - 1) * columns + x % columns; };
  const int last = static_cast<int>(ball.points.size()) - 1;
  for (int x = 0; x < columns; ++x) {
    ball.triangles.push_back({0, at(x + 1, 1), at(x, 1)});
    ball.triangles.push_back({last, at(x, rows - 1), at(x + 1, rows - 1)});
    for (int y = 1; y + 1 < rows; ++y) {
      ball.triangles.push_back({at(x, y), at(x + 1, y), at(x + 1, y + 1)});
      ball.triangles.push_back({at(x, y), at(x + 1, y + 1), at(x, y + 1)});
    }
  }
  return ball;
}

// A gear wheel of 30 teeth, its caps cut into fans: triangles as large as the teeth, and sharp edges only.
Ball gearWheel() {
  constexpr int kPoints = 120;
  Ball gear;
  for (int k = 0; k < kPoints; ++k) {
    const double angle = 2 * 3.14159265358979 * k / kPoints, radius = k / 2 % 2 ? 38 : 50;
    for (double z : {-3.0, 3.0}) gear.points.push_back({radius * std::cos(angle), radius * std::sin(angle), z});
  }
  gear.points.push_back({0, 0, -3});
  gear.points.push_back({0, 0, 3});
  for (int k = 0; k < kPoints; ++k) {
    const int a = 2 * k, b = 2 * ((k + 1) % kPoints), centre = 2 * kPoints;
    gear.triangles.insert(gear.triangles.end(),
                          {{a, b, b + 1}, {a, b + 1, a + 1}, {centre, b, a}, {centre + 1, a + 1, b + 1}});
  }
  return gear;
}

// Ridges of 100 mm beside one another, every other one leaning over the next valley by `lean` times its width.
Ball leaningRidges(int ridges, int steps, double height, double lean) {
  Ball sheet;
  const double width = 100.0 / ridges;
  for (int i = 0; i <= 2 * ridges; ++i)
    for (int j = 0; j <= steps; ++j)
      sheet.points.push_back(
          {i * width / 2 + (i % 4 == 1 ? lean * width : 0), 100.0 * j / steps, i % 2 ? height : 0.0});
  for (int i = 0; i < 2 * ridges; ++i) {
    for (int j = 0; j < steps; ++j) {
      const int a = i * (steps + 1) + j, b = a + steps + 1;
      sheet.triangles.insert(sheet.triangles.end(), {{a, b, b + 1}, {a, b + 1, a + 1}});
    }
  }
  return sheet;
}

std::string plyOf(const Ball& ball, bool colours = true) {
  std::ostringstream out;
  out << "ply\nformat ascii 1.0\nelement vertex " << ball.points.size()
      << "\nproperty float x\nproperty float y\nproperty float z\n";
  if (colours) out << "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  out << "element face " << ball.triangles.size() << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const auto& p : ball.points) {
    out << p[0] << " " << p[1] << " " << p[2];
    if (colours) out << " " << int(128 + 3 * p[0]) << " 90 " << int(128 - 3 * p[2]);
    out << "\n";
  }
  for (const auto& t : ball.triangles) out << "3 " << t[0] << " " << t[1] << " " << t[2] << "\n";
  return out.str();
}

std::string bytesOf(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

class MeshCli : public Cli {
 protected:
  void SetUp() override {
    Cli::SetUp();
    write("ball.ply", plyOf(wavyBall(60, 40)));
  }
  Json parsed(const std::string& text) const {
    auto json = Json::parse(text, nullptr, false);
    EXPECT_FALSE(json.is_discarded()) << text;
    return json;
  }
  std::string build(const std::string& mesh, const std::string& options = "") const {
    return "build --mesh " + file(mesh) + " -o " + file("a.relievo") + " " +
           (options.find("--patches") == std::string::npos ? "--patches 40 " : "") + options;
  }
};

TEST_F(MeshCli, BuildsAPackageThatTellsOfItsScanAndOfTheDistanceToIt) {
  Outcome r = relievo(build("ball.ply", "--report " + file("r.html") + " --json " + file("r.json")));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("scan      ball.ply (in mm): 2342 vertices, 4680 triangles, 1 piece, 0 open borders"),
            std::string::npos)
      << r.output;
  EXPECT_NE(r.output.find("distance  at most"), std::string::npos) << r.output;
  EXPECT_EQ(filesNamed(".part-"), 0);
  EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);

  auto report = parsed(bytesOf(file("r.json")));
  EXPECT_EQ(report["mesh"]["triangles"], 4680);
  EXPECT_GT(report["package_bytes"].get<double>(), 0);
  EXPECT_GT(report["relief_bits_per_vertex"].get<double>(), 0);
  // Most of it is what a program has anyway: no table is made for more than there is.
  if (!relievo::test::kSanitized) {
    EXPECT_LT(report["build_peak_bytes"].get<double>(), 80 << 20);
  }
  const auto& there = report["distance"]["scan_to_patches"];
  EXPECT_GT(there["samples"].get<int>(), 4680);
  EXPECT_GT(there["max_mm"].get<double>(), 0);
  EXPECT_LT(there["max_mm"].get<double>(), 1.5) << "of a ball of 80 mm with waves of 1.5 mm";
  double before = 0;
  for (const char* p : {"p50_mm", "p90_mm", "p95_mm", "p99_mm", "p99_9_mm", "max_mm"}) {
    EXPECT_GE(there[p].get<double>(), before);
    before = there[p].get<double>();
  }
  EXPECT_NEAR(there["max_of_diagonal"].get<double>() * report["distance"]["diagonal_mm"].get<double>(),
              there["max_mm"].get<double>(), 1e-9);
  const auto& missing = report["fidelity"]["missing"];
  EXPECT_NEAR(missing["p99_9_mm"].get<double>(), there["p99_9_mm"].get<double>(), 0.5 * there["p99_9_mm"].get<double>())
      << "other samples of the same two surfaces";
  std::string stages;
  for (const auto& s : report["stages"]) stages += s["name"].get<std::string>() + " ";
  EXPECT_EQ(stages, "read base bake package distance ");

  const std::string html = bytesOf(file("r.html"));
  EXPECT_NE(html.find("data:image/png;base64,iVBORw0KGgo"), std::string::npos);
  EXPECT_EQ(html.find("://"), std::string::npos) << "the page needs nothing else (a picture in base64 has no colon)";
  EXPECT_EQ(html.find("<script"), std::string::npos);

  r = relievo("info " + file("a.relievo"));
  ASSERT_EQ(r.exit_code, 0);
  EXPECT_NE(r.output.find("scan      ball.ply (in mm): 2342 vertices"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("albedo-normal"), std::string::npos);
  EXPECT_NE(r.output.find("source    ball.ply  xxh3 "), std::string::npos);
  auto info = parsed(relievo("info " + file("a.relievo") + " --json").output);
  EXPECT_EQ(info["mesh"]["vertices_read"], 2342);
  EXPECT_EQ(info["base"]["patches"], info["patches"]);
  EXPECT_FALSE(info.contains("width_px") || info.contains("height_px")) << "a body has no size in px";
  EXPECT_NEAR(info["base"]["max_mm"][0].get<double>(), 40, 6);
  // What the file has beside what is told of each section once: second copies, and padding up to 4096 bytes.
  const auto& sections = info["sections"];
  uint64_t once = 0;
  for (const auto& [name, bytes] : sections.items())
    if (name != "tails_heights_bytes") once += bytes.get<uint64_t>();
  const uint64_t copies = sections["base_mesh_bytes"].get<uint64_t>() + 4096, file = info["file_bytes"].get<uint64_t>();
  EXPECT_LE(once + copies, file);
  EXPECT_GT(once + copies + 4 * 4096, file);
  EXPECT_LT(sections["tails_heights_bytes"], sections["tails_bytes"]);
  EXPECT_NE(r.output.find(" KiB (twice), tails "), std::string::npos) << r.output;
}

TEST_F(MeshCli, WhatWasAskedForAndCannotBeIsSaid) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("small.ply", plyOf(wavyBall(24, 16)));
  Outcome r = relievo(build("small.ply", "--patches 1 --tolerance 0.000001"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find(" patches where 1 was asked for: "), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("e-06 mm were aimed at, and not reached: "), std::string::npos) << r.output;
  EXPECT_NE(relievo("info " + file("a.relievo")).output.find(" mm were aimed at, and not reached: "),
            std::string::npos);
  std::filesystem::remove(file("a.relievo"));
  r = relievo(build("small.ply", "--patches 1025"));
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("small.ply: --patches asks for 1025, a scan of 720 triangles has at most 1024"),
            std::string::npos)
      << r.output;
  r = relievo(build("small.ply", "--tolerance -1"));
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("expected a finite number from 0, found -1"), std::string::npos) << r.output;
  EXPECT_LT(r.output.size(), 200u);
  EXPECT_FALSE(std::filesystem::exists(file("a.relievo")));
}

TEST_F(MeshCli, TheJsonOnStandardOutputIsAllThatIsThere) {
  Outcome r = relievo(build("ball.ply", "--json -"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_EQ(parsed(r.output)["mesh"]["file"], "ball.ply");
}

TEST_F(MeshCli, TheSameBytesForAnyWorkers) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  std::string first;
  for (int workers : {1, 2, 3}) {
    ASSERT_EQ(relievo(build("ball.ply", "--workers " + std::to_string(workers))).exit_code, 0);
    const std::string bytes = bytesOf(file("a.relievo"));
    if (first.empty()) first = bytes;
    EXPECT_TRUE(bytes == first) << workers << " workers";
  }
  // Negative control: other patches give others.
  ASSERT_EQ(relievo(build("ball.ply", "--patches 20")).exit_code, 0);
  EXPECT_FALSE(bytesOf(file("a.relievo")) == first);
}

TEST_F(MeshCli, UnitsSetTheSize) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  auto width = [&](const char* unit) {
    EXPECT_EQ(relievo(build("ball.ply", std::string("--unit ") + unit)).exit_code, 0);
    auto info = parsed(relievo("info " + file("a.relievo") + " --json").output);
    return info["mesh"]["max_mm"][0].get<double>() - info["mesh"]["min_mm"][0].get<double>();
  };
  const double mm = width("mm");
  EXPECT_NEAR(mm, 80, 4);
  EXPECT_NEAR(width("cm") / mm, 10, 1e-4);
  EXPECT_NEAR(width("in") / mm, 25.4, 1e-4);
}

// What is kept is said, what is missed is an exit code and where it is, and --strict leaves nothing behind.
TEST_F(MeshCli, ThePromisedDistanceIsKeptOrMissedInSoManyWords) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("small.ply", plyOf(wavyBall(24, 16)));
  const std::string free = "build --mesh " + file("small.ply") + " -o " + file("a.relievo") + " ";
  Outcome r = relievo(free);
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("dB (diagonal "), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("the target is kept"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("  missing   RMS "), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("  too much  RMS "), std::string::npos) << r.output;
  std::filesystem::remove(file("a.relievo"));
  // As few patches as cannot show it.
  r = relievo(free + "--patches 6 --tolerance 0.0001mm --strict");
  EXPECT_EQ(r.exit_code, 7) << r.output;
  EXPECT_NE(r.output.find("the target is missed: expected RMS within 1e-05 mm"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("leave --patches out"), std::string::npos) << r.output;
  EXPECT_FALSE(std::filesystem::exists(file("a.relievo")));
  EXPECT_EQ(relievo(free + "--tolerance 1kg").exit_code, 1);
  // More than can be shown: the tolerance that is named instead is kept.
  r = relievo(free + "--tolerance 0.00001 --strict");
  EXPECT_EQ(r.exit_code, 7) << r.output;
  const size_t named = r.output.find("; --tolerance ");
  ASSERT_NE(named, std::string::npos) << r.output;
  const std::string tolerance = r.output.substr(named + 2, r.output.find(" is kept") - named - 2);
  EXPECT_EQ(relievo(free + tolerance).exit_code, 0) << tolerance;
  // A share of the diagonal is the same as its length.
  ASSERT_EQ(relievo(free + "--patches 40 --tolerance 1%").exit_code, 0);
  EXPECT_GT(std::filesystem::file_size(file("a.relievo")), 1000u);
}

// A coarse scan with sharp edges has its own triangles as patches, and is shown exactly.
TEST_F(MeshCli, AScanOfFewTrianglesIsShownExactly) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("gear.ply", plyOf(gearWheel(), false));
  auto built = [&](const std::string& name, const std::string& options) {
    const Outcome r = relievo("build --mesh " + file("gear.ply") + " -o " + file(name) + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
  };
  built("a.relievo", " --workers 1 --json " + file("r.json"));
  const auto report = parsed(bytesOf(file("r.json")));
  EXPECT_LE(report["mesh"]["patches"].get<int>(), 480);
  for (const char* way : {"scan_to_patches", "patches_to_scan"})
    EXPECT_LT(report["distance"][way]["max_of_diagonal"].get<double>(), 1e-6) << way;
  EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
  if (!relievo::test::longTests()) return;
  built("b.relievo", " --workers 2");
  EXPECT_EQ(bytesOf(file("a.relievo")), bytesOf(file("b.relievo")));
}

// A ball of few triangles, which patches of even size show well, too: it is its own base at once, unless less is asked
// for.
TEST_F(MeshCli, FewTrianglesAreTheirOwnBaseUnlessLessIsAskedFor) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const Ball ball = wavyBall(60, 40);
  write("ball.ply", plyOf(ball, false));
  const auto built = [&](const std::string& options) {
    const Outcome r = relievo("build --mesh " + file("ball.ply") + " -o " + file("a.relievo") + " --json " +
                              file("r.json") + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return parsed(bytesOf(file("r.json")));
  };
  const size_t pairs = ball.triangles.size() / 2;
  const Json own = built("");
  EXPECT_GE(own["mesh"]["patches"].get<size_t>(), pairs);
  EXPECT_LT(own["distance"]["scan_to_patches"]["max_of_diagonal"].get<double>(), 1e-6);
  const auto bytes = std::filesystem::file_size(file("a.relievo"));
  // Whoever compares strategies on it is told that there is nothing to choose.
  const std::string compared =
                        "compare " + file("a.relievo") + " -o " + file("report") + " --path " + file("none.json"),
                    nothing = "patches are the scan's own triangles, without heights";
  EXPECT_NE(relievo(compared).output.find(nothing), std::string::npos);
  const Json coarser = built(" --tolerance 0.5%");
  EXPECT_EQ(relievo(compared).output.find(nothing), std::string::npos) << "control";
  EXPECT_LT(coarser["mesh"]["patches"].get<size_t>(), pairs / 4);
  EXPECT_LT(coarser["relief_bits_per_vertex"].get<double>(), own["relief_bits_per_vertex"].get<double>() / 4)
      << "a coarser copy is a smaller one";
  EXPECT_LT(std::filesystem::file_size(file("a.relievo")), bytes);
  EXPECT_LT(built(" --patches 100")["mesh"]["patches"].get<size_t>(), 150u);
}

// Twenty gear wheels, of which patches of even size show nothing: their own triangles are patches, and take a tenth of
// the bytes of simplified ones.
TEST_F(MeshCli, FewTrianglesComeBeforeSimplifiedOnes) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  Ball gears;
  for (int i = 0; i < 20; ++i) {
    const Ball gear = gearWheel();
    const int first = static_cast<int>(gears.points.size());
    for (const auto& p : gear.points) gears.points.push_back({p[0] + 110 * (i % 5), p[1] + 110 * (i / 5), p[2] + i});
    for (const auto& t : gear.triangles) gears.triangles.push_back({first + t[0], first + t[1], first + t[2]});
  }
  write("gears.ply", plyOf(gears, false));
  const Outcome r =
      relievo("build --mesh " + file("gears.ply") + " -o " + file("a.relievo") + " --json " + file("r.json"));
  EXPECT_EQ(r.exit_code, 0) << r.output;
  const Json report = parsed(bytesOf(file("r.json")));
  EXPECT_GT(report["mesh"]["patches"].get<int>(), 4096);
  EXPECT_LT(report["distance"]["scan_to_patches"]["max_of_diagonal"].get<double>(), 1e-5);
  EXPECT_LT(std::filesystem::file_size(file("a.relievo")), 1u << 20);
}

// Few triangles beside creases are patches as soon as ones of even size miss, be it by little or by much: smaller ones,
// and simplified triangles, take twice the bytes.
TEST_F(MeshCli, FewTrianglesBesideCreasesComeBeforeSmallerPatches) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  for (const auto& [name, lean] : {std::pair{"little", 0.75}, {"much", 0.9}}) {
    const std::string scan = std::string(name) + ".ply";
    write(scan, plyOf(leaningRidges(30, 75, 4, lean), false));
    const Outcome r = relievo("build --mesh " + file(scan) + " -o " + file("a.relievo") + " --json " + file("r.json"));
    EXPECT_EQ(r.exit_code, 0) << r.output;
    const Json report = parsed(bytesOf(file("r.json")));
    EXPECT_EQ(report["mesh"]["patches"], 4500) << name;
    EXPECT_LT(report["distance"]["scan_to_patches"]["max_of_diagonal"].get<double>(), 1e-5) << name;
    EXPECT_LT(std::filesystem::file_size(file("a.relievo")), 150u << 10) << name;
  }
}

// A roof that folds by 18 degrees, and a floor between its ridge and what is straight between its eaves: lines from a
// bilinear patch would show the floor in the ridge's place.
TEST_F(MeshCli, TrianglesThatFoldAreAPatchAsTheyAre) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const double ridge = 7.92, floor = 0.75 * ridge;
  Ball roof;
  roof.points = {{0, 0, ridge}, {100, 100, ridge}, {100, 0, 0}, {0, 100, 0}};
  for (const auto& [x, y] : {std::array{20, 20}, {80, 20}, {80, 80}, {20, 80}})
    roof.points.push_back({static_cast<double>(x), static_cast<double>(y), floor});
  roof.triangles = {{0, 2, 1}, {0, 1, 3}, {4, 5, 6}, {4, 6, 7}};
  write("roof.ply", plyOf(roof, false));
  const Outcome r =
      relievo("build --mesh " + file("roof.ply") + " -o " + file("a.relievo") + " --json " + file("r.json"));
  EXPECT_EQ(r.exit_code, 0) << r.output;
  const Json report = parsed(bytesOf(file("r.json")));
  EXPECT_EQ(report["mesh"]["patches"], 2);
  for (const char* way : {"scan_to_patches", "patches_to_scan"})
    EXPECT_LT(report["distance"][way]["max_of_diagonal"].get<double>(), 1e-6) << way;
}

// The unit changes coordinates and nothing else.
TEST_F(MeshCli, UnitsLeaveThePatchesAsTheyAre) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  auto built = [&](const char* unit) {
    const Outcome r = relievo("build --mesh " + file("ball.ply") + " -o " + file("a.relievo") + " --unit " + unit);
    EXPECT_TRUE(r.exit_code == 0 || r.exit_code == 7) << r.output;
    return parsed(relievo("info " + file("a.relievo") + " --json").output);
  };
  const auto mm = built("mm");
  const auto inches = built("in");
  for (const char* key : {"patches", "corners", "samples", "cells_a_side", "samples_by_closest_point"})
    EXPECT_EQ(inches["mesh"][key], mm["mesh"][key]) << key;
}

TEST_F(MeshCli, WhatIsRepairedIsSaidAndKept) {
  Ball ball = wavyBall(60, 40);
  for (int k = 0; k < 5; ++k) {  // five triangles with vertices of their own
    for (int& v : ball.triangles[static_cast<size_t>(900 + 7 * k)]) {
      ball.points.push_back(ball.points[static_cast<size_t>(v)]);
      v = static_cast<int>(ball.points.size()) - 1;
    }
  }
  ball.triangles.push_back({7, 7, 9});  // and one without area
  write("worn.ply", plyOf(ball));
  Outcome r = relievo(build("worn.ply"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("found"), std::string::npos) << r.output;
  auto info = parsed(relievo("info " + file("a.relievo") + " --json").output);
  EXPECT_EQ(info["mesh"]["vertices_read"], 2342 + 15);
  EXPECT_EQ(info["mesh"]["vertices"], 2342);
  EXPECT_EQ(info["mesh"]["triangles"], 4680);
  ASSERT_GE(info["mesh"]["findings"].size(), 2u) << info["mesh"].dump(1);
  for (const auto& f : info["mesh"]["findings"]) {
    EXPECT_GT(f["count"].get<int>(), 0);
    const std::string what = f["what"].get<std::string>();  // of one in the singular
    EXPECT_NE(relievo("info " + file("a.relievo")).output.find(what.substr(0, what.size() - 4)), std::string::npos)
        << what;
  }
}

TEST_F(MeshCli, BadMeshesAreExitCode3AndNamed) {
  const std::string good = plyOf(wavyBall(60, 40));
  std::string nan = good;
  nan.replace(nan.find("end_header\n") + 11, 1, "nan ");
  std::string range = good + "";
  range.replace(range.rfind("3 "), std::string::npos, "3 0 1 99999\n");
  for (const auto& [name, text] : std::vector<std::pair<std::string, std::string>>{
           {"cut.ply", good.substr(0, good.size() / 2)},
           {"words.ply", "this is no mesh"},
           {"range.ply", range},
           {"nan.ply", nan},
           {"huge.ply",
            "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\nproperty float "
            "y\nproperty float z\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\nabc"},
           {"points.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float "
            "z\nend_header\n0 0 0\n"}}) {
    write(name, text);
    Outcome r = relievo(build(name));
    EXPECT_EQ(r.exit_code, 3) << name << ": " << r.output;
    EXPECT_NE(r.output.find(name), std::string::npos) << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), 1) << "one clear error: " << r.output;
    EXPECT_FALSE(std::filesystem::exists(file("a.relievo")));
  }
  EXPECT_EQ(filesNamed(".part-"), 0);
  EXPECT_EQ(relievo(build("nowhere.ply")).exit_code, 2);
  write("a.3ds", "x");
  EXPECT_EQ(relievo(build("a.3ds")).exit_code, 5);
}

TEST_F(MeshCli, OptionsThatDoNotGoTogetherAreExitCode1) {
  for (const char* options : {"--ptm x.ptm", "--image x.png", "--relief h.png", "--mm-per-pixel 2", "--unit furlong",
                              "--tolerance -1", "--patches -3", "--texture none --unit"})
    EXPECT_EQ(relievo(build("ball.ply", options)).exit_code, 1) << options;
  for (const char* options : {"--unit mm", "--tolerance 1", "--patches 9", "--texture t.png", "--report r.html"})
    EXPECT_EQ(relievo("build --image x.png -o " + file("a.relievo") + " " + options).exit_code, 1) << options;
  Outcome r = relievo(build("ball.ply", "--texture " + file("ball.ply")));
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("--texture needs texture coordinates"), std::string::npos) << r.output;
  EXPECT_EQ(relievo("build --mesh " + file("ball.ply") + " -o " + file("ball.ply")).exit_code, 1)
      << "the output is the input";
  EXPECT_EQ(bytesOf(file("ball.ply")), plyOf(wavyBall(60, 40)));
}

// A slab whose material names a picture, red on the left and blue on the right.
TEST_F(MeshCli, TexturesComeFromTheMaterialOrByName) {
  std::ostringstream obj;
  obj << "mtllib slab.mtl\nusemtl picture\n";
  const int n = 3;
  for (int y = 0; y <= n; ++y)
    for (int x = 0; x <= n; ++x)
      obj << "v " << 10 * x << " " << 10 * y << " " << (x * y) % 3 << "\nvt " << double(x) / n << " " << double(y) / n
          << "\n";
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const int a = y * (n + 1) + x + 1, b = a + 1, c = a + n + 1, d = c + 1;
      obj << "f " << a << "/" << a << " " << b << "/" << b << " " << d << "/" << d << "\nf " << a << "/" << a << " "
          << d << "/" << d << " " << c << "/" << c << "\n";
    }
  write("slab.obj", obj.str());
  write("slab.mtl", "newmtl picture\nmap_Kd picture.ppm\n");
  write("picture.ppm", std::string("P6\n2 1\n255\n") + "\xff\x10\x10\x10\x10\xff");
  write("grey.pgm", std::string("P5\n1 1\n255\n") + "\x80");
  Outcome r = relievo(build("slab.obj"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  const std::string coloured = bytesOf(file("a.relievo"));
  EXPECT_NE(relievo("info " + file("a.relievo")).output.find("source    picture.ppm  xxh3 "), std::string::npos);
  EXPECT_NE(relievo("info " + file("a.relievo")).output.find("1 open border,"), std::string::npos);
  ASSERT_EQ(relievo(build("slab.obj", "--texture " + file("grey.pgm"))).exit_code, 0);
  EXPECT_NE(bytesOf(file("a.relievo")), coloured);
  ASSERT_EQ(relievo(build("slab.obj", "--texture none")).exit_code, 0);
  EXPECT_EQ(relievo("info " + file("a.relievo")).output.find("picture.ppm"), std::string::npos);
  for (const char* named : {"picture.ppm", "slab.mtl"}) {
    const std::string before = bytesOf(file(named));
    r = relievo(build("slab.obj", "--texture none --report " + file(named)));
    EXPECT_EQ(r.exit_code, 1) << r.output;
    EXPECT_NE(r.output.find("--report would overwrite"), std::string::npos) << r.output;
    EXPECT_NE(r.output.find(std::string(named) + ", which the mesh names"), std::string::npos) << r.output;
    EXPECT_EQ(bytesOf(file(named)), before);
  }
  std::filesystem::remove(file("picture.ppm"));
  r = relievo(build("slab.obj"));
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_NE(r.output.find("picture.ppm"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("--texture none"), std::string::npos) << r.output;
}

// A sheet that repeats an image 30 times each way: its texels would be 900 times the image's.
TEST_F(MeshCli, AnImageThatIsRepeatedIsStoredOnce) {
  constexpr int kCells = 12, kImage = 96, kTimes = 30;
  std::ostringstream obj;
  obj << "mtllib sheet.mtl\nusemtl picture\n";
  for (int y = 0; y <= kCells; ++y)
    for (int x = 0; x <= kCells; ++x)
      obj << "v " << 10 * x << " " << 10 * y << " " << (x * y) % 5 << "\nvt " << double(kTimes * x) / kCells << " "
          << double(kTimes * y) / kCells << "\n";
  for (int y = 0; y < kCells; ++y)
    for (int x = 0; x < kCells; ++x) {
      const int a = y * (kCells + 1) + x + 1, b = a + 1, c = a + kCells + 1, d = c + 1;
      obj << "f " << a << "/" << a << " " << b << "/" << b << " " << d << "/" << d << "\nf " << a << "/" << a << " "
          << d << "/" << d << " " << c << "/" << c << "\n";
    }
  write("sheet.obj", obj.str());
  write("sheet.mtl", "newmtl picture\nmap_Kd picture.ppm\n");
  std::string image = "P6\n" + std::to_string(kImage) + " " + std::to_string(kImage) + "\n255\n";
  for (int i = 0; i < kImage * kImage; ++i)
    for (int c = 0; c < 3; ++c)
      image += static_cast<char>(
          static_cast<uint8_t>(120 + 100 * std::sin(0.2 * (i % kImage) + c) * std::cos(0.3 * (i / kImage))));
  write("picture.ppm", image);
  const std::string path = file("a.relievo");
  const Outcome r = relievo("build --mesh " + file("sheet.obj") + " -o " + path);
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("  images    1 stored once and as they are; "), std::string::npos) << r.output;
  const auto bytes = std::filesystem::file_size(path);
  EXPECT_LT(bytes, 130'000u);
  EXPECT_EQ(relievo("verify " + path).exit_code, 0);
  const Json info = parsed(relievo("info --json " + path).output);
  EXPECT_EQ(info["shown_images"]["patches"], info["patches"]);
  // Where texels are to be stored in another way, pages hold them.
  ASSERT_EQ(relievo("build --mesh " + file("sheet.obj") + " --encoding q5 -o " + path).exit_code, 0);
  EXPECT_FALSE(parsed(relievo("info --json " + path).output).contains("shown_images"));
  EXPECT_GT(std::filesystem::file_size(path), 10 * bytes) << "control";
}

TEST_F(MeshCli, ImagesOutsideTheMeshsFolderAreRefusedByName) {
  std::filesystem::create_directory(file("inner"));
  write("inner/a.obj",
        "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 10 0 0\nv 10 10 1\nv 0 10 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 "
        "4/4\n");
  write("inner/a.mtl", "newmtl m\nmap_Kd ../secret.ppm\n");
  write("secret.ppm", std::string("P6\n2 1\n255\n") + "\xff\x10\x10\x10\x10\xff");
  const std::string build = "build --mesh " + file("inner/a.obj") + " -o " + file("a.relievo");
  Outcome r = relievo(build);
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("secret.ppm"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("--allow-outside"), std::string::npos) << r.output;
  EXPECT_FALSE(std::filesystem::exists(file("a.relievo")));
  EXPECT_EQ(relievo(build + " --allow-outside").exit_code, 0);
  EXPECT_EQ(relievo(build + " --texture none").exit_code, 0);
  EXPECT_EQ(relievo(build + " --texture " + file("secret.ppm")).exit_code, 0)
      << "who names it on the command line means it";
}

TEST_F(MeshCli, AnInterruptedBuildLeavesWhatWasThere) {
  write("dense.ply", plyOf(wavyBall(700, 500), false));
  write("a.relievo", "precious");
  Outcome r = run("timeout --preserve-status -s INT 0.5 " RELIEVO_PROGRAM " " +
                  build("dense.ply", "--patches 5000 --tolerance 0.0001"));
  EXPECT_EQ(r.exit_code, 130) << r.output;
  EXPECT_EQ(bytesOf(file("a.relievo")), "precious");
  EXPECT_EQ(filesNamed(".part-"), 0);
}

// ---- units, place, attitude and order

// With all digits of a double, which files of scans in metres or far from the origin need.
std::string exactPlyOf(const Ball& ball) {
  std::ostringstream out;
  out.precision(17);
  out << "ply\nformat ascii 1.0\nelement vertex " << ball.points.size()
      << "\nproperty double x\nproperty double y\nproperty double z\nelement face " << ball.triangles.size()
      << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const auto& p : ball.points) out << p[0] << " " << p[1] << " " << p[2] << "\n";
  for (const auto& t : ball.triangles) out << "3 " << t[0] << " " << t[1] << " " << t[2] << "\n";
  return out.str();
}
template <class Moves>
Ball moved(Ball ball, const Moves& moves) {
  for (auto& p : ball.points) p = moves(p);
  return ball;
}
Ball shuffled(const Ball& ball) {
  std::mt19937 random(20261125);
  std::vector<int> place(ball.points.size());
  std::iota(place.begin(), place.end(), 0);
  std::shuffle(place.begin(), place.end(), random);
  Ball out = ball;
  for (size_t i = 0; i < place.size(); ++i) out.points[static_cast<size_t>(place[i])] = ball.points[i];
  for (auto& t : out.triangles) {
    for (int& corner : t) corner = place[static_cast<size_t>(corner)];
    std::rotate(t.begin(), t.begin() + random() % 3, t.end());
  }
  std::shuffle(out.triangles.begin(), out.triangles.end(), random);
  return out;
}

Ball ballOf(const relievo::TriMesh& mesh) {
  Ball scan;
  for (const glm::vec3& p : mesh.positions_mm) scan.points.push_back({p.x, p.y, p.z});
  for (const auto& t : mesh.triangles)
    scan.triangles.push_back({static_cast<int>(t[0]), static_cast<int>(t[1]), static_cast<int>(t[2])});
  return scan;
}

// The helmet's corners are folded, which counts against its base until there are 800 patches: a bake shows that 320
// are enough. The vase's 320 are not. The bumpy ball loses nothing with 64, but these would take five pages each.
// With all of their texels: without, own triangles take fewer bytes.
TEST_F(MeshCli, AsManyPatchesAsTheBakeAsksFor) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const auto built = [&](const relievo::TriMesh& mesh, const std::string& options = " --texture-tolerance -1") {
    write("scan.ply", exactPlyOf(ballOf(mesh)));
    const Outcome r = relievo("build --mesh " + file("scan.ply") + " -o " + file("a.relievo") + " --json " +
                              file("r.json") + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return parsed(bytesOf(file("r.json")));
  };
  EXPECT_LE(built(relievo::helmet(1))["mesh"]["patches"].get<int>(), 400);
  EXPECT_GE(built(relievo::vase(1))["mesh"]["patches"].get<int>(), 500);
  const Json ball = built(relievo::bumpyBall(2));
  EXPECT_GT(ball["mesh"]["patches"].get<int>(), 100);
  EXPECT_LE(ball["mesh"]["cells_a_side"].get<int>(), 128);
  EXPECT_LE(ball["relief_bits_per_vertex"].get<double>(), 40);  // 58 with 64 patches
  const auto bytes = std::filesystem::file_size(file("a.relievo"));
  const size_t triangles = relievo::bumpyBall(2).triangles.size();
  EXPECT_GE(built(relievo::bumpyBall(2), "")["mesh"]["patches"].get<size_t>(), triangles / 2);
  EXPECT_LT(std::filesystem::file_size(file("a.relievo")), bytes / 2);
}

// Less accuracy takes less: cells decide, not another base.
TEST_F(MeshCli, BitsGrowWithAccuracy) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("figure.ply", exactPlyOf(ballOf(relievo::figure(2))));
  struct Built {
    double patches, bits;
  };
  const auto built = [&](const std::string& tolerance) {
    const Outcome r = relievo("build --mesh " + file("figure.ply") + " -o " + file("a.relievo") + " --tolerance " +
                              tolerance + " --json " + file("r.json"));
    EXPECT_EQ(r.exit_code, 0) << r.output;
    const auto report = parsed(bytesOf(file("r.json")));
    return Built{report["mesh"]["patches"], report["relief_bits_per_vertex"]};
  };
  const Built loose = built("0.063%"), usual = built("0.03%");
  EXPECT_EQ(loose.patches, usual.patches);
  EXPECT_LT(loose.bits, usual.bits);
  EXPECT_GT(loose.bits, 0);
}

// A power of two changes no digit of any number: the same figures. Others round otherwise, and where two collapses of
// a simplification cost the same to the last digits another one comes first: as many patches and samples within a
// sixth, as close within 0.5 dB.
TEST_F(MeshCli, UnitPlaceAttitudeAndOrderChangeNothingButCoordinates) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  using Point = std::array<double, 3>;
  const auto scaled = [](double factor) {
    return [factor](const Point& p) { return Point{factor * p[0], factor * p[1], factor * p[2]}; };
  };
  const auto far = [](const Point& p) { return Point{p[0] + 1e7, p[1] - 1e7, p[2] + 1e7}; };
  const auto turned = [](const Point& p) {
    const double c = std::cos(0.7), s = std::sin(0.7), d = std::cos(0.4), e = std::sin(0.4);
    const double x = c * p[0] - s * p[1], y = s * p[0] + c * p[1];
    return Point{x, d * y - e * p[2], e * y + d * p[2]};
  };
  const Ball ball = wavyBall(100, 60);  // more triangles than are patches at once
  struct Figures {
    int exit_code = 0;
    double patches = 0, samples = 0, psnr_db = 0;
  };
  const auto figuresOf = [&](const Ball& scan, const std::string& options = "") {
    write("scan.ply", exactPlyOf(scan));
    const Outcome r = relievo("build --mesh " + file("scan.ply") + " -o " + file("a.relievo") + " --json " +
                              file("scan.json") + " " + options);
    const Json json = parsed(bytesOf(file("scan.json")));
    return Figures{r.exit_code, json["mesh"]["patches"], json["mesh"]["samples"], json["fidelity"]["psnr_db"]};
  };
  const Figures plain = figuresOf(ball);
  EXPECT_EQ(plain.exit_code, 0);
  const auto near = [&](const Figures& f) {
    return f.exit_code == plain.exit_code && std::abs(f.patches - plain.patches) <= plain.patches / 6 &&
           std::abs(f.samples - plain.samples) <= plain.samples / 6 && std::abs(f.psnr_db - plain.psnr_db) <= 0.5;
  };
  const Figures by_1024 = figuresOf(moved(ball, scaled(1024)));
  EXPECT_EQ(by_1024.patches, plain.patches);
  EXPECT_EQ(by_1024.samples, plain.samples);
  EXPECT_NEAR(by_1024.psnr_db, plain.psnr_db, 1e-6);
  std::vector<std::pair<const char*, Ball>> cases{{"in metres, in another order", shuffled(moved(ball, scaled(1e-3)))},
                                                  {"turned, 10^7 mm from the origin", moved(moved(ball, turned), far)}};
  if (relievo::test::longTests()) {
    cases = {{"in metres", moved(ball, scaled(1e-3))},
             {"10^7 mm from the origin", moved(ball, far)},
             {"turned", moved(ball, turned)},
             {"in another order", shuffled(ball)}};
  }
  for (const auto& [what, scan] : cases) {
    const Figures f = figuresOf(scan);
    EXPECT_TRUE(near(f)) << what << ": exit code " << f.exit_code << ", " << f.patches << " patches, " << f.samples
                         << " samples, " << f.psnr_db << " dB; plain: " << plain.patches << ", " << plain.samples
                         << ", " << plain.psnr_db;
  }
  // The control: a tolerance in the file's unit is another one a thousand times as large.
  EXPECT_FALSE(near(figuresOf(moved(ball, scaled(1024)), "--tolerance 0.05")));
}

}  // namespace mesh_cli_test
