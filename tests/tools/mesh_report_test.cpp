// What is told of a scan: the painted error against where it lies, and text of any JSON.
#include "tools/report/mesh_report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>

namespace relievo {
namespace mesh_report_test {

using Json = nlohmann::ordered_json;

// A sphere of radius 10 around (100, 50, -30).
TriMesh sphere() {
  TriMesh mesh;
  mesh.origin_mm = {1e6, 0, 0};
  constexpr int kColumns = 64, kRows = 32;
  for (int y = 0; y <= kRows; ++y)
    for (int x = 0; x < kColumns; ++x) {
      const double longitude = 2 * M_PI * x / kColumns, latitude = M_PI * y / kRows - M_PI / 2;
      mesh.positions_mm.push_back(glm::vec3(100 + 10 * std::cos(latitude) * std::sin(longitude),
                                            50 + 10 * std::sin(latitude),
                                            -30 + 10 * std::cos(latitude) * std::cos(longitude)));
    }
  auto at = [](int x, int y) { return static_cast<uint32_t>(y * kColumns + x % kColumns); };
  for (int y = 0; y < kRows; ++y)
    for (int x = 0; x < kColumns; ++x) {
      mesh.triangles.push_back({at(x, y), at(x + 1, y), at(x + 1, y + 1)});
      mesh.triangles.push_back({at(x, y), at(x + 1, y + 1), at(x, y + 1)});
    }
  return mesh;
}

struct Pixel {
  int r, g, b;
};
Pixel pixel(const ErrorPicture& p, int x, int y) {
  const uint8_t* at =
      p.rgb.data() + 3 * (static_cast<size_t>(y) * static_cast<size_t>(p.width) + static_cast<size_t>(x));
  return {at[0], at[1], at[2]};
}
bool isViolet(Pixel p) { return p.b > p.g + 30; }
bool isYellow(Pixel p) { return p.r > p.b + 100 && p.g > p.b + 100; }
bool isWhite(Pixel p) { return p.r == 255 && p.g == 255 && p.b == 255; }

// The front (z > -30) lies 1 mm off, the rest nothing: only the front view is yellow, and the sides are half of each.
TEST(PaintedError, isSeenFromWhereItLies) {
  const TriMesh scan = sphere();
  std::vector<float> mm;
  for (const glm::vec3& p : scan.positions_mm) mm.push_back(p.z > -30 ? 1.0f : 0.0f);
  constexpr int kPx = 200;
  const ErrorPicture picture = paintError(scan, mm, 1e-3, 1, kPx);
  ASSERT_EQ(picture.width, 4 * kPx);
  ASSERT_EQ(picture.height, kPx);
  for (int view = 0; view < 4; ++view) {
    const int x = view * kPx;
    EXPECT_TRUE(isWhite(pixel(picture, x + 2, 2))) << "beyond the silhouette";
    EXPECT_FALSE(isWhite(pixel(picture, x + kPx / 2, 10))) << "it fills the picture";
    const Pixel left = pixel(picture, x + kPx / 4, kPx / 2), right = pixel(picture, x + 3 * kPx / 4, kPx / 2);
    // From the front, its left (-x), the back, its right: the front lies ahead, to one side, behind, to the other side.
    if (view == 0) {
      EXPECT_TRUE(isYellow(left) && isYellow(right));
    } else if (view == 2) {
      EXPECT_TRUE(isViolet(left) && isViolet(right));
    } else {
      EXPECT_TRUE(isYellow(left) != isYellow(right) && isViolet(left) != isViolet(right)) << "view " << view;
    }
  }
  EXPECT_TRUE(isYellow(pixel(picture, kPx + kPx / 4, kPx / 2)) != isYellow(pixel(picture, 3 * kPx + kPx / 4, kPx / 2)))
      << "the sides mirror";
}

TEST(PaintedError, goesByDecades) {
  const TriMesh scan = sphere();
  auto brightness = [&](float mm) {
    const Pixel p = pixel(paintError(scan, std::vector<float>(scan.positions_mm.size(), mm), 1e-4, 1, 100), 50, 50);
    return p.g;
  };
  int before = brightness(0);
  EXPECT_EQ(brightness(1e-4f), before);
  for (float mm : {1e-3f, 1e-2f, 1e-1f, 1.0f}) {
    EXPECT_GT(brightness(mm), before + 20) << mm;
    before = brightness(mm);
  }
  EXPECT_EQ(brightness(100), before);
}

// Triangles of no area, seen edge on, and a mesh of one point: no division by nothing.
TEST(PaintedError, ofDegenerateMeshes) {
  TriMesh scan;
  scan.positions_mm = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  scan.triangles = {{0, 1, 2}};
  EXPECT_TRUE(isWhite(pixel(paintError(scan, {0, 0, 0}, 1e-6, 1, 16), 8, 8)));
  scan.positions_mm = {{0, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const ErrorPicture picture = paintError(scan, {NAN, INFINITY, 1}, 1e-6, 1, 64);
  EXPECT_EQ(picture.rgb.size(), size_t{64} * 64 * 4 * 3);
}

MeshBuildResult someResult() {
  MeshDiagnosis diagnosis;
  diagnosis.vertices_read = 12;
  diagnosis.triangles_read = 20;
  diagnosis.vertices = 10;
  diagnosis.triangles = 19;
  diagnosis.pieces = 2;
  diagnosis.border_loops = 1;
  diagnosis.min_mm = {-1, -2, -3};
  diagnosis.max_mm = {1, 2, 3};
  diagnosis.findings.push_back({"duplicate vertices", 2, {{0.5, 0, 0}, {1, 2, 3}}, "welded"});
  diagnosis.findings.push_back({"open borders", 1, {}, ""});
  BaseMesh base;
  base.corners.resize(6);
  base.patches.resize(2);
  BakeReport bake;
  bake.cells_log2 = 5;
  bake.texture_depth = 1;
  bake.samples = 2000;
  MeshBuildResult r;
  r.package = "a <b>.relievo";
  r.mesh = meshJson("scan <1> & \"2\".ply", "cm", diagnosis, base, bake);
  r.distance.diagonal_mm = 10;
  r.distance.to_baked = {100, 0.5, 0.1, {0.01, 0.02, 0.03, 0.04, 0.05}};
  r.distance.to_scan = {200, 0.25, 0.05, {0.001, 0.002, 0.003, 0.004, 0.005}};
  r.fidelity.diagonal_mm = 10;
  r.fidelity.target = FidelityTarget::of(10);
  r.fidelity.to_drawn = {.samples = 7, .rms_mm = 1e-4, .p99_9_mm = 2e-3, .max_mm = 0.5, .max_at_mm = {1, 2, 3}};
  r.fidelity.to_scan = {.samples = 8, .rms_mm = 2e-4, .p99_9_mm = 2.5e-3, .max_mm = 0.25};
  r.stages = {{"read", 0.5, 1000}, {"bake", 1.5, 4000}, {"distance", 8, 9000}};
  r.relief_bytes = 100;
  r.package_bytes = 1000;
  r.triangles_read = 20;
  r.vertices = 10;
  return r;
}

TEST(MeshReport, figuresFollowFromWhatWasMeasured) {
  const Json json = reportJson(someResult());
  EXPECT_DOUBLE_EQ(json["relief_bits_per_vertex"].get<double>(), 80);
  EXPECT_DOUBLE_EQ(json["samples_per_vertex"].get<double>(), 200);
  EXPECT_DOUBLE_EQ(json["distance"]["scan_to_patches"]["max_of_diagonal"].get<double>(), 0.05);
  EXPECT_DOUBLE_EQ(json["distance"]["patches_to_scan"]["p99_9_of_diagonal"].get<double>(), 0.0005);
  EXPECT_DOUBLE_EQ(json["triangles_per_s"].get<double>(), 10) << "measuring is not building";
  EXPECT_DOUBLE_EQ(json["build_peak_bytes_per_triangle"].get<double>(), 200);
  EXPECT_EQ(json["mesh"]["texels_a_side"], 256);
  EXPECT_EQ(json["mesh"]["cells_a_side"], 32);
}

TEST(MeshReport, fidelityIsKeptOrMissed) {
  MeshBuildResult r = someResult();
  const Json kept = reportJson(r)["fidelity"];
  EXPECT_EQ(kept["kept"], true) << kept;
  r.fidelity.to_scan.area_beyond = 2e-4;
  const Json missed = reportJson(r)["fidelity"];
  EXPECT_EQ(missed["kept"], false);
  EXPECT_DOUBLE_EQ(missed["too_much"]["area_beyond"].get<double>(), 2e-4);
  EXPECT_DOUBLE_EQ(missed["target"]["beyond_mm"].get<double>(), 1e-2);
  EXPECT_NEAR(missed["psnr_db"].get<double>(), 20 * std::log10(10 / 2e-4), 1e-9);
  EXPECT_EQ(missed["missing"]["max_at_mm"], Json({1.0, 2.0, 3.0}));
}

TEST(MeshReport, textNamesFindingsAndPlaces) {
  const std::string text = meshText(someResult().mesh);
  EXPECT_NE(text.find("10 vertices, 19 triangles, 2 pieces, 1 open border, 2 x 4 x 6 mm"), std::string::npos) << text;
  EXPECT_NE(text.find("read    12 vertices, 20 triangles"), std::string::npos) << text;
  EXPECT_NE(text.find("found   2 duplicate vertices: welded; at (0.5, 0, 0), (1, 2, 3)"), std::string::npos) << text;
  EXPECT_NE(text.find("found   1 open border: left as it is\n"), std::string::npos) << text;
}

TEST(MeshReport, textSaysWhatWasAskedForAndNotReached) {
  MeshDiagnosis diagnosis;
  diagnosis.findings = {{"isolated pieces", 1, {}, ""},
                        {"vertices of no triangle", 1, {}, "dropped"},
                        {"triangles of materials without an image (material \"files\")", 1, {}, "x"},
                        {"open borders", 11, {{1, 2, 3}, {4, 5, 6}}, ""}};
  BaseMesh base;
  base.patches.resize(10);
  BakeReport bake;
  bake.cells_log2 = 6;
  bake.tolerance_mm = 0.5;
  bake.deviation_mm = 0.25;
  auto text = [&](uint32_t asked) { return meshText(meshJson("a.ply", "mm", diagnosis, base, bake, asked)); };
  for (const char* words : {"found   1 isolated piece: left", "found   1 vertex of no triangle: dropped",
                            "found   1 triangle of a material without an image (material \"files\"): x",
                            "found   11 open borders: left as it is; at (1, 2, 3), (4, 5, 6) and 9 more\n",
                            "64 x 64 cells of heights a patch"})
    EXPECT_NE(text(0).find(words), std::string::npos) << words << " in " << text(0);
  for (uint32_t asked : {0u, 10u}) {
    EXPECT_EQ(text(asked).find("asked for"), std::string::npos) << text(asked);
    EXPECT_EQ(text(asked).find("not reached"), std::string::npos) << text(asked);
  }
  EXPECT_NE(text(1).find("over 10 patches where 1 was asked for: its pieces"), std::string::npos) << text(1);
  EXPECT_NE(text(11).find("over 10 patches where 11 were asked for: numbers are kept to about 30 %"), std::string::npos)
      << text(11);
  std::set<std::string> reasons;
  for (BakeLimit limit : {BakeLimit::kCells, BakeLimit::kSamples, BakeLimit::kShape}) {
    bake.limit = limit;
    const size_t at = text(0).find("0.5 mm were aimed at, and not reached: ");
    ASSERT_NE(at, std::string::npos) << text(0);
    reasons.insert(text(0).substr(at));
  }
  EXPECT_EQ(reasons.size(), 3u);
}

// The manifest may be anybody's: members missing, of other types, nested, huge.
TEST(MeshReport, textOfAnyJsonIsTextOrNothing) {
  const Json good = someResult().mesh;
  EXPECT_EQ(meshText(Json()), "");
  EXPECT_EQ(meshText(Json::array({1, 2})), "");
  EXPECT_EQ(meshText("scan"), "");
  EXPECT_EQ(meshText(Json{{"file", 7}}), "");
  const std::vector<Json> odd{Json(),
                              Json(true),
                              Json(-1),
                              Json(1e300),
                              Json("%s%n"),
                              Json::array(),
                              Json::array({1, "a", Json()}),
                              Json::object(),
                              Json{{"what", 3}}};
  for (const auto& [key, value] : good.items()) {
    for (const Json& other : odd) {
      Json bad = good;
      bad[key] = other;
      EXPECT_NO_THROW(meshText(bad)) << key;
      bad = good;
      if (key == "findings") {
        bad[key][0] = other;
        EXPECT_NO_THROW(meshText(bad));
        for (const char* member : {"what", "count", "done", "places_mm"}) {
          bad = good;
          bad[key][0][member] = other;
          EXPECT_NO_THROW(meshText(bad)) << member;
        }
        bad = good;
        bad[key][0]["places_mm"][0] = other;
        EXPECT_NO_THROW(meshText(bad));
      }
    }
    Json missing = good;
    missing.erase(key);
    EXPECT_NO_THROW(meshText(missing)) << key;
  }
}

TEST(MeshReport, aPageOfItsOwn) {
  const std::string path =
      (std::filesystem::temp_directory_path() / ("relievo-report-" + std::to_string(std::random_device{}()) + ".html"))
          .string();
  TriMesh scan = sphere();
  MeshBuildResult r = someResult();
  r.distance.scan_vertex_mm.assign(scan.positions_mm.size(), 0.01f);
  ASSERT_TRUE(writeMeshReport(path, scan, r).ok());
  std::ifstream in(path);
  const std::string html{std::istreambuf_iterator<char>(in), {}};
  std::filesystem::remove(path);
  EXPECT_NE(html.find("scan &lt;1&gt; &amp; &quot;2&quot;.ply"), std::string::npos) << "names are text";
  EXPECT_EQ(html.find("<1>"), std::string::npos);
  EXPECT_EQ(html.find("a <b>"), std::string::npos);
  for (const char* words :
       {"data:image/png;base64,", "<td>largest</td><td>0.5 mm</td><td>5.00e-02</td>", "p99.9", "duplicate vertices",
        "bake", "The target is kept", "<td>99.9 %</td><td>0.003 mm</td><td>0.002 mm</td><td>0.0025 mm</td>"})
    EXPECT_NE(html.find(words), std::string::npos) << words;
  auto failed = writeMeshReport("/nowhere/at/all.html", scan, r);
  ASSERT_FALSE(failed.ok());
  EXPECT_EQ(failed.error().kind, ErrorKind::kIo);
}

TEST(MissedTarget, tellsExpectedAndFoundApart) {
  Fidelity f;
  f.target = FidelityTarget::within(0.322);
  f.to_drawn.rms_mm = 0.03220004;
  f.to_drawn.p99_9_mm = 0.5;
  f.to_drawn.max_mm = 2;
  f.to_drawn.area_beyond = 1.04e-4;
  f.to_drawn.max_at_mm = {1, 2, 3};
  EXPECT_EQ(
      missedTarget(f),
      "the target is missed: expected RMS within 0.0322 mm, 99.9 % within 0.322 mm and 99.99 % of the area within "
      "1.07 mm of the scan, found 0.03220004 mm, 0.5 mm and 99.9896 %, the largest distance 2 mm at (1, 2, 3)");
  // Control: numbers that differ anyway, and equal ones, stay short.
  f.to_drawn.rms_mm = 0.0412345678;
  f.to_drawn.p99_9_mm = f.target.p99_9_mm;
  f.to_drawn.area_beyond = 0.1234567;
  EXPECT_NE(missedTarget(f).find("found 0.0412 mm, 0.322 mm and 87.65 %,"), std::string::npos) << missedTarget(f);
}

}  // namespace mesh_report_test
}  // namespace relievo
