// What `relievo compare` computes without a GPU: errors from places, coverage, seams, camera paths.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <fstream>
#include <limits>

#include "geometry/strategies/strategy_bounds.h"
#include "tests/render/test_artwork.h"
#include "tools/compare/compare_measure.h"
#include "tools/compare/compare_merge.h"
#include "tools/compare/compare_path.h"
#include "tools/compare/compare_report.h"
#include "tools/compare/compare_tables.h"

namespace relievo {
namespace compare_test {

FlatDomain smallDomain() {
  FlatDomain d;
  d.width_px = 300;
  d.height_px = 200;
  d.mm_per_px = 0.5;
  d.texture_depth = FlatDomain::depthFor(300, 200);
  d.relief_depth = d.texture_depth;
  d.relief_scale_mm = 10.0 / 65535;
  d.relief_offset_mm = -2;
  return d;
}

ReliefField rampField(const FlatDomain& d) {
  ReliefField field(d);
  for (int64_t j = 0; j < field.rows; ++j)
    for (int64_t i = 0; i < field.columns; ++i)
      field.samples[static_cast<size_t>(j * field.columns + i)] =
          static_cast<uint16_t>(100 * i + 37 * j + ((i * j) % 7) * 50);
  return field;
}

TEST(ReliefField, GoesThroughItsSamplesAndAlongTheDiagonal) {
  FlatDomain d = smallDomain();
  ReliefField field = rampField(d);
  ASSERT_EQ(field.columns, 301);
  ASSERT_EQ(field.rows, 201);
  int64_t s = int64_t{1} << field.spacing_log2;
  for (int64_t j = 0; j < field.rows; j += 13)
    for (int64_t i = 0; i < field.columns; i += 17)
      EXPECT_EQ(field.heightSteps(static_cast<double>(i * s), static_cast<double>(j * s)), field.at(i, j))
          << i << " " << j;
  double middle = field.heightSteps(10.5 * static_cast<double>(s), 20.5 * static_cast<double>(s));
  EXPECT_EQ(middle, 0.5 * (field.at(10, 20) + field.at(11, 21)));
}

// Places are the truth's, drawn elsewhere by a known way: the error is that way.
TEST(CompareMeasure, TheErrorIsTheDistanceToWhereThePlaceBelongs) {
  FlatDomain d = smallDomain();
  ReliefField field = rampField(d);
  PlanarSurface surface(field, 1);
  OrbitCamera camera = fitCamera(d, 160, 90);
  camera.azimuth_deg = 35;
  camera.elevation_deg = -20;
  Frame frame{viewTransform(camera, d, -2, 8, 160, 90), 160, 90};
  PatchInstance p;
  p.grid_level = 5;
  p.step_log2 = static_cast<uint8_t>(d.texture_depth + 7 + kUnitsPerTexelLog2 - 5);
  std::vector<PatchInstance> instances = {p};
  PlacePixels pixels(160 * 90);
  ErrorVectors errors;
  double size = std::ldexp(1.0, p.step_log2 + p.grid_level);
  int checked = 0;
  for (double y = 100; y < 3000; y += 311)
    for (double x = 50; x < 4000; x += 277) {
      bool in_front = false;
      float u = static_cast<float>(x / size), v = static_cast<float>(y / size);
      glm::dvec2 at = frame.pixelOf(field.worldMm(u * size, v * size, field.heightMm(u * size, v * size)), &in_front);
      ASSERT_TRUE(in_front);
      // Shown three pixels right of and two below the pixel it belongs to.
      int px = static_cast<int>(at.x) + 3, py = static_cast<int>(at.y) - 2;
      if (px < 0 || py < 0 || px >= 160 || py >= 90) continue;
      std::fill(pixels.begin(), pixels.end(), std::array<uint32_t, 4>{});
      pixels[static_cast<size_t>(py * 160 + px)] = {std::bit_cast<uint32_t>(u), std::bit_cast<uint32_t>(v), 1, 0};
      errorVectors(surface, instances, frame, pixels, errors);
      const glm::vec2 e = errors[static_cast<size_t>(py * 160 + px)];
      EXPECT_NEAR(e.x, px + 0.5 - at.x, 1e-4);
      EXPECT_NEAR(e.y, py + 0.5 - at.y, 1e-4);
      EXPECT_EQ(figuresOf(errors).pixels, 1u);
      pixels[static_cast<size_t>(py * 160 + px)][3] =
          std::bit_cast<uint32_t>(65.0f / 32);  // edge-on: 65 of 32 cells a node
      EXPECT_EQ(errorVectors(surface, instances, frame, pixels, errors), 1u);
      EXPECT_EQ(figuresOf(errors).pixels, 0u);
      ++checked;
    }
  EXPECT_GT(checked, 50);
}

TEST(CompareMeasure, FiguresOfKnownErrors) {
  ErrorVectors errors(1000, {0.0f, 0.0f});
  for (size_t i = 0; i < 12; ++i) errors[i] = {3, 4};
  errors[500] = {std::numeric_limits<float>::quiet_NaN(), 0};
  ErrorFigures f = figuresOf(errors);
  EXPECT_EQ(f.pixels, 999u);
  EXPECT_EQ(f.max_px, 5);
  EXPECT_EQ(f.p99_px, 5);
  EXPECT_NEAR(f.rms_px, std::sqrt(12 * 25 / 999.0), 1e-12);
  errors[0] = errors[1] = errors[2] = {0, 0};
  EXPECT_EQ(figuresOf(errors).p99_px, 0);  // 9 of 999
  ErrorVectors after = errors;
  EXPECT_EQ(largestChangePx(errors, after), 0);
  after[7] = {-3, -4};
  EXPECT_EQ(largestChangePx(errors, after), 10);
}

TEST(CompareMeasure, HolesAreCracksOnlyInsideTheSilhouette) {
  constexpr int kSide = 40;
  std::vector<uint8_t> reference(kSide * kSide, 0);
  for (int y = 0; y < kSide; ++y)
    for (int x = 10; x < kSide; ++x)
      reference[static_cast<size_t>(y * kSide + x)] = 1;  // its right, upper and lower ends lie beyond the picture
  auto with = [&](int x, int y, int margin) {
    std::vector<uint8_t> drawn = reference;
    drawn[static_cast<size_t>(y * kSide + x)] ^= 1;
    return compareCoverage(drawn, reference, kSide, kSide, margin);
  };
  EXPECT_EQ(compareCoverage(reference, reference, kSide, kSide, 1).silhouette_pixels, 0u);
  EXPECT_EQ(with(25, 20, 1).crack_pixels, 1u);
  EXPECT_EQ(with(39, 0, 1).crack_pixels, 1u);   // the picture's border is no silhouette
  EXPECT_EQ(with(10, 20, 1).crack_pixels, 0u);  // on the silhouette
  EXPECT_EQ(with(11, 20, 1).crack_pixels, 1u);
  EXPECT_EQ(with(13, 20, 4).crack_pixels, 0u);
  EXPECT_EQ(with(14, 20, 4).crack_pixels, 1u);
  EXPECT_EQ(with(5, 20, 1).crack_pixels, 0u);  // drawn where full resolution has nothing
  EXPECT_EQ(with(5, 20, 1).silhouette_pixels, 1u);
}

// Two nodes side by side, of 4 and 8 segments; the finer one's middle vertices as given.
TEST(CompareMeasure, SeamsAreComparedVertexByVertex) {
  FlatDomain d = smallDomain();
  d.texture_depth = d.relief_depth = 1;
  PatchInstance left, right;
  left.node = {0, 1, 0, 0};
  right.node = {0, 1, 1, 0};
  int unit_log2 = d.texture_depth + 7 + kUnitsPerTexelLog2;
  left.grid_level = 2;
  right.grid_level = 3;
  left.step_log2 = static_cast<uint8_t>(unit_log2 - 1 - 2);
  right.step_log2 = static_cast<uint8_t>(unit_log2 - 1 - 3);
  right.x0 = 1 << (unit_log2 - 1);
  std::vector<PatchInstance> instances = {left, right};
  auto captured = [&](bool snapped) {
    std::vector<float> out;
    for (const PatchInstance& p : instances) {
      int last = 1 << p.grid_level;
      for (int j = 0; j <= last; ++j)
        for (int i = 0; i <= last; ++i) {
          int y = j << p.step_log2;
          if (snapped && &p == &instances[1] && i == 0) y &= ~((1 << left.step_log2) - 1);
          out.insert(out.end(), {static_cast<float>(p.x0 + (i << p.step_log2)), static_cast<float>(y), 0.0f, 1.0f});
        }
    }
    return out;
  };
  EXPECT_EQ(compareSeams(d, instances, captured(true)).compared, 5u);
  EXPECT_EQ(compareSeams(d, instances, captured(true)).mismatched, 0u);
  EXPECT_EQ(compareSeams(d, instances, captured(false)).mismatched, 4u);
  std::vector<float> one_bit = captured(true);
  one_bit[4 * 4 + 2] = std::bit_cast<float>(1u);                  // of the left one's upper right vertex
  EXPECT_EQ(compareSeams(d, instances, one_bit).mismatched, 2u);  // what either side has alone
}

TEST(ComparePath, RecordedAndFromAFile) {
  FlatDomain d = smallDomain();
  for (const char* name : {"orbit", "flyover", "zoom"}) {
    auto cameras = compareCameras(name, 7, d, 160, 90);
    ASSERT_TRUE(cameras.ok()) << name;
    EXPECT_EQ(cameras->size(), 7u);
  }
  EXPECT_EQ((*compareCameras("flyover", 3, d, 160, 90))[1].now.elevation_deg, kFlyoverTilt_deg);
  test::TemporaryFolder folder;
  auto write = [&](const std::string& text) {
    std::ofstream(folder.file("path.json")) << text;
    return compareCameras(folder.file("path.json"), 0, d, 160, 90);
  };
  auto two = write(
      R"({"cameras": [{"azimuth_deg": 20, "distance_mm": 90}, {"elevation_deg": -30, "fov_deg": 60, "target_mm": [1, 2, 3]}]})");
  ASSERT_TRUE(two.ok());
  ASSERT_EQ(two->size(), 2u);
  EXPECT_EQ((*two)[0].now.distance_mm, 90);
  EXPECT_EQ((*two)[1].before.azimuth_deg, 20);
  EXPECT_EQ((*two)[1].now.target_mm, glm::dvec3(1, 2, 3));
  EXPECT_FALSE((*two)[0].now.orthographic);
  auto parallel =
      write(R"({"cameras": [{"orthographic": true}, {"orthographic": false, "fov_deg": 170}, {"fov_deg": 1}]})");
  ASSERT_TRUE(parallel.ok());
  EXPECT_TRUE((*parallel)[0].now.orthographic);
  EXPECT_FALSE((*parallel)[1].now.orthographic);
  EXPECT_EQ((*parallel)[2].now.fov_deg, 1);
  for (const char* bad : {"", "[]", R"({"cameras": [{"orthographic": 1}]})", R"({"cameras": [{"fov_deg": 0.5}]})",
                          R"({"cameras": [{"fov_deg": 171}]})", "{}", R"({"cameras": []})", R"({"cameras": [7]})",
                          R"({"cameras": [{"distance_mm": -1}]})", R"({"cameras": [{"elevation_deg": 90}]})",
                          R"({"cameras": [{"fov_deg": "wide"}]})", R"({"cameras": [{"target_mm": [1, 2]}]})"}) {
    auto result = write(bad);
    ASSERT_FALSE(result.ok()) << bad;
    EXPECT_EQ(result.error().kind, ErrorKind::kInvalidData) << bad;
  }
  EXPECT_EQ(compareCameras(folder.file("nowhere.json"), 0, d, 160, 90).error().kind, ErrorKind::kIo);
}

CompareRow rowOf(const char* name, double budget_px, double p99_px, double triangles, double ms) {
  CompareRow r;
  r.strategy = name;
  r.title = std::string("The ") + name;
  r.budget_px = budget_px;
  r.p99_px = r.max_px = p99_px;
  r.triangles = triangles;
  r.select_ms = {0, 0, 0};
  r.frame_ms = {ms, 0.9 * ms, 1.1 * ms};
  return r;
}

// Triangles in proportion to a power of the error: interpolating their logarithms is exact.
TEST(CompareRows, CostsAtEqualErrorAreInterpolated) {
  std::vector<CompareRow> rows = {rowOf("a", 1, 0.5, 4000, 8), rowOf("a", 4, 2, 1000, 2), rowOf("b", 1, 0.25, 32000, 4),
                                  rowOf("b", 4, 4, 2000, 3), rowOf("c", 1, 0.01, 9, 9)};
  rows.push_back(rowOf("d", 4, 1, 1, 1));
  rows.back().control = true;
  const EqualError at = equalError(rows, 1);
  ASSERT_EQ(at.costs.size(), 2u) << "c does not reach 1 px, d is a control";
  EXPECT_NEAR(at.costs[0].triangles, 2000, 1e-6);
  EXPECT_NEAR(at.costs[0].ms, 4, 1e-9);
  EXPECT_NEAR(at.costs[0].ms_high, 4.4, 1e-9);
  EXPECT_NEAR(at.costs[1].triangles, 8000, 1e-6);
  EXPECT_EQ(at.left_out, std::vector<std::string>{"The c"});
  const std::string text = conclusionText(at);
  EXPECT_NE(text.find("For 1 px at 99 % of pixels: The a draws the fewest triangles, 2000; The b draws 4.00 times"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("The b takes the least time to choose and draw, 3.46 ms; The a takes 1.15 times as long, which "
                      "is within the frames' spread"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("Not reached with these budgets by: The c"), std::string::npos) << text;
  // From an empty cache: bytes in proportion to a power of the error, too. At 20 MB/s a's take 100 ms, b's decoding 30.
  for (CompareRow& r : rows) r.cold = {r.strategy == "a" ? 4e6 / r.budget_px : 1e5, r.strategy == "a" ? 1.0 : 30.0};
  const EqualError cold = equalError(rows, 1);
  EXPECT_NEAR(cold.costs[0].cold.bytes, 2e6, 1);
  EXPECT_NEAR(cold.costs[0].cold.ms(20), 100, 1e-4);
  EXPECT_NEAR(cold.costs[1].cold.ms(20), 30, 1e-4);
  EXPECT_NE(
      conclusionText(cold).find("over a link of 20 MB/s, The b is there first, after 30 ms; The a takes 3.33 times"),
      std::string::npos)
      << conclusionText(cold);
  EXPECT_EQ(text.find("empty cache"), std::string::npos) << "without figures nothing is said";
  // The control: at an error that none reaches nothing is concluded.
  EXPECT_TRUE(equalError(rows, 100).costs.empty());
  EXPECT_NE(conclusionText(equalError(rows, 100)).find("No error is reached"), std::string::npos);
  EXPECT_EQ(equalError(rows).error_px, 1);
}

TEST(CompareRows, BestAreThoseThatNoOtherBeats) {
  std::vector<CompareRow> rows = {rowOf("a", 1, 1, 100, 1), rowOf("a", 2, 2, 50, 1), rowOf("b", 1, 1.5, 100, 1),
                                  rowOf("b", 2, 0.5, 500, 1), rowOf("c", 1, 0.1, 1, 1)};
  rows[4].control = true;
  const auto best = bestRows(
      rows, [](const CompareRow& r) { return r.triangles; }, [](const CompareRow& r) { return r.p99_px; });
  EXPECT_EQ(best, (std::vector<bool>{true, true, false, true, false}));
}

TEST(CompareRows, TablesEscapeWhatTheyShow) {
  std::vector<CompareRow> rows = {rowOf("a", 1, 1, 100, 1)};
  rows[0].title = "50 % of <a_b>, \"c\"";
  EXPECT_NE(rowsLatex(rows, "x & y").find("50 \\% of <a\\_b>"), std::string::npos);
  EXPECT_NE(rowsLatex(rows, "x & y").find("x \\& y"), std::string::npos);
  EXPECT_NE(errorTableHtml(rows).find("&lt;a_b&gt;"), std::string::npos);
  const std::string csv = rowsCsv(rows, "a, \"b\"", true);
  EXPECT_NE(csv.find("\n\"a, \"\"b\"\"\",a,1,"), std::string::npos) << csv;
  EXPECT_EQ(std::count(csv.begin(), csv.end(), ',') % 2, 1) << csv;
}

// What report.json must have for a merged report; every truncation is an error, and so is a missing number.
TEST(CompareMerge, ReadsReportsAndRefusesOthers) {
  const std::string good =
      R"({"renderer": "llvmpipe", "origin": {"cpu": "one", "date": "today", "package_xxh3_64": "12"},
 "artwork": {"file": "stone.relievo"}, "view": {"path": "orbit", "frames": 6, "width_px": 64, "height_px": 36},
 "runs": [
  {"strategy": "a", "title": "A", "purpose": "", "control": false, "error_px": 1, "summary": {"predicted_px": null,
   "max_px": 1, "p99_px": 0.5, "rms_px": 0.1, "pop_px": 0, "crack_px": 0, "silhouette_px": 0, "seam_mismatches": null,
   "triangles_median": 100, "draw_calls_max": 1, "resident_bytes_max": 1, "streamed_bytes": 1}},
  {"strategy": "b", "title": "B", "purpose": "", "control": false, "error_px": 1, "why": "too old"}],
 "timings": {"runs": [{"strategy": "a", "error_px": 1, "select_ms": {"median": 1, "fastest": 1, "slowest": 2},
  "frame_ms": {"median": 3, "fastest": 2, "slowest": 4}}]}})";
  auto part = parseComparison(good, "r.json");
  ASSERT_TRUE(part.ok()) << part.error().text();
  ASSERT_EQ(part->rows.size(), 2u);
  EXPECT_EQ(part->artwork, "stone.relievo");
  EXPECT_EQ(part->origin.package_hash, "12");
  EXPECT_EQ(part->rows[0].totalMs(), 4);
  EXPECT_EQ(part->rows[0].cold.bytes, 0) << "of a report that does not say";
  std::string with_cold = good;
  with_cold.replace(with_cold.find("\"streamed_bytes\""), 0, "\"cold_bytes_median\": 5000, ");
  EXPECT_FALSE(parseComparison(with_cold, "r.json").ok()) << "decoding is missing";
  with_cold.replace(with_cold.find("\"select_ms\""), 0, "\"cold_decode_ms\": 0.125, ");
  auto cold = parseComparison(with_cold, "r.json");
  ASSERT_TRUE(cold.ok()) << cold.error().text();
  EXPECT_EQ(cold->rows[0].cold.bytes, 5000);
  EXPECT_EQ(cold->rows[0].cold.decode_ms, 0.125);
  EXPECT_EQ(part->rows[0].predicted_px, -1);
  EXPECT_FALSE(part->rows[0].seams_known);
  EXPECT_FALSE(part->rows[1].available);
  EXPECT_EQ(part->rows[1].why_not, "too old");
  for (size_t length = 0; length < good.size(); ++length)
    EXPECT_FALSE(parseComparison(good.substr(0, length), "r.json").ok()) << length;
  for (const char* member :
       {"triangles_median", "p99_px", "frame_ms", "strategy\": \"a", "runs", "artwork", "fastest"}) {
    std::string bad = good;
    bad.replace(bad.find(member), 1, "X");
    auto refused = parseComparison(bad, "r.json");
    ASSERT_FALSE(refused.ok()) << member;
    EXPECT_EQ(refused.error().kind, ErrorKind::kInvalidData) << member;
  }
  const std::string html = mergedHtml({*part, *part}, "relievo compare --merge", "today");
  EXPECT_NE(html.find("stone.relievo, llvmpipe"), std::string::npos);
  EXPECT_NE(html.find("</html>"), std::string::npos);
  EXPECT_EQ(html.find("<script"), std::string::npos);
}

// What several comparisons agree on: geometric means of ratios within each.
TEST(CompareMerge, MeansAreOverRatios) {
  MergedPart one, two;
  one.rows = {rowOf("a", 1, 0.5, 400, 1), rowOf("a", 4, 2, 100, 1), rowOf("b", 1, 0.5, 800, 1),
              rowOf("b", 4, 2, 200, 1)};
  two.rows = {rowOf("a", 1, 0.5, 400, 1), rowOf("a", 4, 2, 100, 1), rowOf("b", 1, 0.5, 3200, 1),
              rowOf("b", 4, 2, 800, 1)};
  const std::string text = mergedConclusion({one, two});
  EXPECT_NE(text.find("The a draws the fewest triangles, 1.00 times the fewest of each; The b draws 4.00 times"),
            std::string::npos)
      << text;
  EXPECT_EQ(mergedConclusion({}), "No two strategies reach an equal error in all of these comparisons.");
}

TEST(CompareReport, Base64) {
  auto encode = [](const std::string& s) { return base64({reinterpret_cast<const uint8_t*>(s.data()), s.size()}); };
  EXPECT_EQ(encode(""), "");
  EXPECT_EQ(encode("f"), "Zg==");
  EXPECT_EQ(encode("fo"), "Zm8=");
  EXPECT_EQ(encode("foobar"), "Zm9vYmFy");
}

}  // namespace compare_test
}  // namespace relievo
