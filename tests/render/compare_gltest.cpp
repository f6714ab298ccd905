// relievo compare as a whole, on a small flat artwork and on bodies: promises hold, seams are closed, negative controls
// fail, and two runs agree.
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <random>

#include <nlohmann/json.hpp>

#include "src/gl/context.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/test_artwork.h"
#include "tests/render/true_patches.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/patch_package_builder.h"
#include "texturing/stream/relief_subslots.h"
#include "tools/compare/compare_report.h"
#include "tools/compare/compare_run.h"
#include "tools/compare/compare_scene.h"

namespace relievo {
namespace compare_gltest {

constexpr uint32_t kSeed = 20140613;
constexpr int kWidth = 240, kHeight = 136;

class Compare : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string why;
    // Two patches along the strip, sizes that are no multiple of anything, steep enough to see.
    package_ = test::longTests() ? test::noisePackageOnce(1101, 601, Basis::kColour, 12, 7, &why)
                                 : test::noisePackageOnce(551, 301, Basis::kColour, 6, 7, &why);
    ASSERT_TRUE(package_) << why;
    plan_.package = package_;
    plan_.path = folder_.file("path.json");
    plan_.width_px = kWidth;
    plan_.height_px = kHeight;
    plan_.frames = 0;
    plan_.repeats = 1;
    plan_.budgets_px = {1, 3};
    for (const StrategyEntry& e : lodStrategies()) plan_.strategies.push_back(&e);
    writePath(6);
  }
  // From straight ahead to grazing, from near to far, one of them orthographic; the eye stays above the relief.
  // Making these takes the time of all others; kept_mesh_test looks at what they make.
  void leaveSimplifiedMeshesOut() {
    if (test::longTests()) return;
    std::erase_if(plan_.strategies,
                  [](const StrategyEntry* e) { return e->name == "discrete" || e->name == "clusters"; });
  }
  void writePath(int cameras) {
    std::mt19937 random(kSeed);
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    const double size = test::longTests() ? 1 : 0.5;  // of the artwork
    auto list = nlohmann::json::array();
    for (int k = 0; k < cameras; ++k) {
      nlohmann::json c = {{"azimuth_deg", uniform(-60, 60)},
                          {"elevation_deg", uniform(-55, 55)},
                          {"fov_deg", uniform(20, 70)},
                          {"orthographic", k == 4},
                          {"distance_mm", size * std::exp(uniform(std::log(35.0), std::log(250.0)))},
                          {"target_mm", {size * uniform(-45, 45), size * uniform(-25, 25), 0}}};
      list.push_back(c);
    }
    std::ofstream(plan_.path) << nlohmann::json{{"cameras", list}};
  }
  CompareFigures run() {
    auto figures = runCompare(plan_, gltest::context().info());
    EXPECT_TRUE(figures.ok()) << (figures.ok() ? "" : figures.error().text());
    return figures.ok() ? std::move(*figures) : CompareFigures{};
  }
  static const StrategyFigures& of(const CompareFigures& all, const std::string& name, double budget_px) {
    for (const StrategyFigures& f : all.runs)
      if (f.strategy->name == name && f.budget_px == budget_px) return f;
    ADD_FAILURE() << name;
    return all.runs[0];
  }

  // cracks_show: the background is seen through them.
  void expectGood(const CompareFigures& all, size_t frames_wanted, bool cracks_show);

  test::TemporaryFolder folder_;
  std::shared_ptr<const Package> package_;
  ComparePlan plan_;
};

// Over a base mesh: a ball of turned and mirrored patches, corners of 3 and 4, smooth with a rough part; and an open
// sheet.
class CompareBody : public Compare {
 protected:
  void open(BaseMesh mesh, int depth) {
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    test::MeshRelief relief{depth, -2, 6.0 / 65535};
    test::TruePatches source(mesh, relief, [](const glm::dvec3& p, const test::Place& place) {
      const double waves = 0.4 + 0.2 * std::sin(0.12 * p.x + 1) * std::cos(0.1 * p.y) + 0.1 * std::sin(0.2 * p.z);
      return waves + (p.x + p.y > 25 ? 0.08 * static_cast<double>(test::hashOf(place, 5) & 1023) / 1023 : 0);
    });
    BuildOptions options;
    options.output = folder_.file("body.relievo");
    auto built = buildPatchPackage(source, options);
    ASSERT_TRUE(built.ok()) << built.error().text();
    auto package = Package::open(options.output);
    ASSERT_TRUE(package.ok()) << package.error().text();
    package_ = *package;
    plan_.package = package_;
    auto [low, high] = test::boxOf(mesh);
    const double size = glm::length(high - low);
    std::mt19937 random(kSeed);
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    auto list = nlohmann::json::array();
    for (int k = 0; k < 5; ++k)
      list.push_back({{"azimuth_deg", uniform(-60, 60)},
                      {"elevation_deg", uniform(-55, 55)},
                      {"fov_deg", uniform(20, 60)},
                      {"orthographic", k == 4},
                      {"distance_mm", size * std::exp(uniform(-0.3, 0.8))},
                      {"target_mm", {uniform(-0.1, 0.1) * size, uniform(-0.1, 0.1) * size, 0}}});
    std::ofstream(plan_.path) << nlohmann::json{{"cameras", list}};
  }
};

TEST_F(CompareBody, OfABall) {
  open(test::cubeSphere(2, 40), test::longTests());
  leaveSimplifiedMeshesOut();
  expectGood(run(), 5, false);  // through a crack the far side shows, no background
}
// Waves on a quarter of the patches, no height elsewhere: each page is what the package has, and the alike are held
// once.
TEST_F(CompareBody, PagesThatAreAlikeAreHeldOnce) {
  for (const int depth : {0, 1}) {
    const BaseMesh mesh = test::cubeSphere(2, 40);
    test::TruePatches source(mesh, {depth, -2, 6.0 / 65535}, [](const glm::dvec3& p, const test::Place&) {
      return p.x > 1e-6 && p.y > 1e-6 ? 0.5 + 0.01 * p.x * p.y * std::sin(0.3 * p.z) / 40 : 0.5;
    });
    BuildOptions options;
    options.output = folder_.file("alike.relievo");
    ASSERT_TRUE(buildPatchPackage(source, options).ok());
    const auto package = *Package::open(options.output);
    const PatchDomain& domain = package->manifest().domain;
    std::unique_ptr<StrategyPass> pass;
    const gl::Api api = gltest::context().info().api;
    const auto scene = loadCompareScene(package, uint64_t{1} << 30, api, &pass, nullptr);
    ASSERT_TRUE(scene.ok()) << scene.error().text();
    uint64_t all = 0;
    for (int level = 0; level <= depth; ++level) all += domain.nodeCount(level);
    EXPECT_LT(scene->pages, all / 2);
    EXPECT_EQ(scene->encoded.size(), all);
    EXPECT_FALSE(loadCompareScene(package, scene->pages * partBytes(kReliefPartLevel) - 1, api, &pass, nullptr).ok());
    PageDecoder decoder;
    std::vector<uint16_t> samples(kReliefPageSamples);
    size_t raised = 0;
    for (uint32_t p = 0; p < domain.patchCount(); ++p)
      for (uint32_t k = 0; k < 1u << (2 * depth); ++k) {
        const NodeId node{p, static_cast<uint32_t>(depth), k % (1u << depth), k >> depth};
        const auto page = package->read(PageId(Plane::kRelief, node));
        ASSERT_TRUE(page.ok() && decoder.decodeRelief(page->bytes, samples).ok());
        EXPECT_EQ(scene->encoded.at(node).bytes, page->storedBytes());
        for (int64_t y = 0; y <= kPagePx; ++y)
          for (int64_t x = 0; x <= kPagePx; ++x) {
            const uint16_t sample = samples[static_cast<size_t>(y * kReliefSamples + x)];
            ASSERT_EQ(scene->strategy.body->at(p, node.x * kPagePx + x, node.y * kPagePx + y), sample);
            raised += sample != samples[0];
          }
      }
    EXPECT_GT(raised, 10'000u);
  }
}

TEST_F(CompareBody, WhatIsForFlatArtworksOnlySaysSo) {
  open(test::cubeSphere(1, 40), 0);
  plan_.strategies = {findStrategy("bintree"), findStrategy("uniform")};
  plan_.budgets_px = {4};
  const CompareFigures all = run();
  EXPECT_FALSE(all.runs[0].available);
  EXPECT_EQ(all.runs[0].why_not, "for flat artworks only");
  EXPECT_TRUE(all.runs[0].frames.empty());
  EXPECT_TRUE(all.runs[1].available);
  EXPECT_EQ(all.runs[1].why_not, "");
}
TEST_F(CompareBody, OfAnOpenSheet) {
  open(test::openSheet(3, 2, 30), test::longTests());
  expectGood(run(), 5, true);
}

// As on a flat artwork: what is drawn higher than it is measured is off.
TEST_F(CompareBody, AWrongSurfaceIsSeen) {
  open(test::cubeSphere(1, 40), 0);
  plan_.strategies = {findStrategy("uniform")};
  plan_.budgets_px = {0.05};
  CompareFigures right = run();
  EXPECT_LT(summaryOf(right.runs[0], right).max_px, 0.1);
  plan_.measured_exaggerate = 1.2;
  CompareFigures wrong = run();
  EXPECT_GT(summaryOf(wrong.runs[0], wrong).rms_px, 50 * summaryOf(right.runs[0], right).rms_px);
  EXPECT_GT(summaryOf(wrong.runs[0], right).above_bound_frames, 0u);
}

TEST_F(CompareBody, RecordedPathsSeeIt) {
  open(test::cubeSphere(1, 40), 0);
  plan_.strategies = {findStrategy("edge-lod")};
  plan_.budgets_px = {2};
  plan_.frames = 6;
  for (const char* path : {"orbit", "flyover", "zoom"}) {
    plan_.path = path;
    CompareFigures all = run();
    ASSERT_EQ(all.runs[0].frames.size(), 6u);
    for (const FrameFigures& f : all.runs[0].frames) EXPECT_GT(f.error.pixels, 3000u) << path;
    EXPECT_EQ(summaryOf(all.runs[0], all).above_bound_frames, 0u) << path;
  }
}

TEST_F(Compare, PromisesHoldSeamsAreClosedAndControlsFail) { expectGood(run(), 6, true); }

void Compare::expectGood(const CompareFigures& all, size_t frames_wanted, bool cracks_show) {
  ASSERT_EQ(all.runs.size(), plan_.budgets_px.size() * plan_.strategies.size());
  EXPECT_TRUE(all.reference_whole);
  EXPECT_LT(all.floor.max_px, 0.1) << "full resolution measured like a strategy";
  EXPECT_LT(all.floor.p99_px, 0.01);
  uint64_t frames = 0;
  double cold = 0, streamed = 0;
  bool a_third_is_no_bound = false;
  for (const StrategyFigures& run : all.runs) {
    if (!run.available) continue;
    ASSERT_EQ(run.frames.size(), frames_wanted);
    RunSummary s = summaryOf(run, all);
    EXPECT_EQ(run.frames[0].streamed_bytes, run.frames[0].cold_bytes) << run.strategy->name << ": nothing came before";
    EXPECT_EQ(s.above_bound_frames, 0u) << run.strategy->name << " at " << run.budget_px << " px: max " << s.max_px
                                        << ", predicted " << s.predicted_px;
    for (const FrameFigures& f : run.frames) {
      EXPECT_GT(f.error.pixels, 1000u);
      EXPECT_GT(f.triangles, 0u);
      EXPECT_GT(f.cold_bytes, 0u) << run.strategy->name;
      EXPECT_LE(f.streamed_bytes, f.cold_bytes) << run.strategy->name;
      cold += static_cast<double>(f.cold_bytes);
      streamed += static_cast<double>(f.streamed_bytes);
      if (f.predicted_px < 0) continue;
      ++frames;
      EXPECT_LE(f.error.max_px, f.predicted_px + measuringSlackPx(all)) << run.strategy->name;
      a_third_is_no_bound = a_third_is_no_bound || f.error.max_px > f.predicted_px / 3 + measuringSlackPx(all);
    }
    EXPECT_LE(static_cast<double>(s.edge_on_pixels), 0.002 * static_cast<double>(s.pixels))
        << run.strategy->name << ": too much is not measured";
    std::printf(
        "[ compare  ] %-13s %g px: predicted %6.3g, max %6.3g, p99 %6.3g, pop %6.3g px; %8.0f triangles, %llu crack "
        "pixels, %llu of %llu vertices differ, %llu of %llu pixels edge-on\n",
        run.strategy->name.c_str(), run.budget_px, s.predicted_px, s.max_px, s.p99_px, s.pop_px, s.triangles,
        static_cast<unsigned long long>(s.crack_pixels), static_cast<unsigned long long>(s.seams_mismatched),
        static_cast<unsigned long long>(s.seams_compared), static_cast<unsigned long long>(s.edge_on_pixels),
        static_cast<unsigned long long>(s.pixels));
    if (run.strategy->control) continue;
    EXPECT_EQ(s.crack_pixels, 0u) << run.strategy->name;
    if (!s.seams_known) continue;
    EXPECT_GT(s.seams_compared, 50u) << run.strategy->name;
    EXPECT_EQ(s.seams_mismatched, 0u) << run.strategy->name;
  }
  EXPECT_LT(streamed, 0.9 * cold) << "most of what a frame draws from, the frame before had, too";
  EXPECT_GE(frames, 8 * frames_wanted);
  EXPECT_TRUE(a_third_is_no_bound);
  // The controls: the same patches as edge-lod's, which shows none of it.
  uint64_t cracks = 0, mismatches = 0, skirt_cracks = 0, skirt_mismatches = 0;
  for (double budget : plan_.budgets_px) {
    RunSummary control = summaryOf(of(all, "no-snapping", budget), all),
               skirts = summaryOf(of(all, "skirts", budget), all), good = summaryOf(of(all, "edge-lod", budget), all);
    cracks += control.crack_pixels;
    mismatches += control.seams_mismatched;
    skirt_cracks += skirts.crack_pixels;
    skirt_mismatches += skirts.seams_mismatched;
    EXPECT_GT(skirts.triangles, good.triangles);
  }
  EXPECT_EQ(cracks > 0, cracks_show);
  EXPECT_GT(mismatches, 0u);
  if (cracks_show) {
    EXPECT_LT(skirt_cracks, cracks);
  }
  EXPECT_EQ(skirt_mismatches, mismatches);
}

TEST_F(Compare, TwoRunsDifferInTimingsOnly) {
  plan_.budgets_px = {2};
  leaveSimplifiedMeshesOut();
  writePath(2);
  auto withoutTimings = [](const std::string& text) {
    auto json = nlohmann::json::parse(text);
    EXPECT_TRUE(json.contains("timings"));
    json.erase("timings");
    return json.dump();
  };
  CompareFigures a = run(), b = run();
  EXPECT_EQ(withoutTimings(reportJson(plan_, a)), withoutTimings(reportJson(plan_, b)));
  std::string csv = reportCsv(a);
  auto columns = static_cast<std::ptrdiff_t>(reportColumns().size());
  size_t available = 0;
  for (const StrategyFigures& r : a.runs) available += r.available;
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), static_cast<std::ptrdiff_t>(1 + 2 * available));
  for (size_t from = 0; from < csv.size(); from = csv.find('\n', from) + 1)
    EXPECT_EQ(std::count(csv.begin() + static_cast<std::ptrdiff_t>(from),
                         csv.begin() + static_cast<std::ptrdiff_t>(csv.find('\n', from)), ','),
              columns - 1);
  auto pictures = reportPictures(plan_, a);
  EXPECT_EQ(pictures.size(), available);
  for (const ReportPicture& p : pictures)
    EXPECT_GT(std::count_if(p.rgba.begin(), p.rgba.end(), [](uint8_t v) { return v != 0; }), 1000);
  std::string html = reportHtml(plan_, a, pictures);
  EXPECT_EQ(html.find("http://"), std::string::npos);
  EXPECT_EQ(html.find("https://"), std::string::npos);
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_NE(html.find("</html>"), std::string::npos);
}

// Relief that is drawn higher than the truth it is measured against is off by what the heights say: the measuring sees
// it.
TEST_F(Compare, AWrongSurfaceIsSeen) {
  plan_.strategies = {findStrategy("uniform")};
  plan_.budgets_px = {0.05};
  CompareFigures right = run();
  EXPECT_LT(summaryOf(right.runs[0], right).max_px, 0.1);
  plan_.measured_exaggerate = 1.05;
  CompareFigures wrong = run();
  EXPECT_GT(summaryOf(wrong.runs[0], wrong).rms_px, 50 * summaryOf(right.runs[0], right).rms_px);
  EXPECT_GT(wrong.floor.max_px, 0.2) << "full resolution, too";
  EXPECT_GT(summaryOf(wrong.runs[0], right).above_bound_frames, 0u);
}

TEST_F(Compare, StopsWhenInterruptedAndRefusesWhatDoesNotFit) {
  std::atomic<bool> stop = true;
  plan_.interrupted = &stop;
  auto stopped = runCompare(plan_, gltest::context().info());
  ASSERT_FALSE(stopped.ok());
  EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
  plan_.interrupted = nullptr;
  plan_.memory_bytes = 1 << 18;
  auto refused = runCompare(plan_, gltest::context().info());
  ASSERT_FALSE(refused.ok());
  EXPECT_EQ(refused.error().kind, ErrorKind::kUnsupported);
}

}  // namespace compare_gltest
}  // namespace relievo
