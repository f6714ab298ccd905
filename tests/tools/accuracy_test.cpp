// What `relievo accuracy` computes without a GPU: front, choice of combinations, advice, reports; and settings files.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>
#include <set>

#include "tests/texturing/patch_fixture.h"
#include "texturing/package/patch_package_builder.h"
#include "tools/accuracy/accuracy_front.h"
#include "tools/accuracy/accuracy_report.h"
#include "tools/accuracy/reencoded_pages.h"
#include "tools/scene/settings_file.h"

namespace relievo {
namespace accuracy_test {

std::vector<CostAndGain> randomPoints(std::mt19937& random, size_t count) {
  std::vector<CostAndGain> out(count);
  for (CostAndGain& p : out) p = {1.0 + random() % 20, 20.0 + random() % 20};  // few values, so that many are equal
  return out;
}

bool beats(const CostAndGain& a, const CostAndGain& b) {
  return a.ms <= b.ms && a.psnr_db >= b.psnr_db && (a.ms < b.ms || a.psnr_db > b.psnr_db);
}

// What makes a list of points the front: none of it is beaten, each other one is beaten or has an equal in it.
bool isFront(const std::vector<CostAndGain>& points, const std::vector<size_t>& front) {
  for (size_t i : front)
    for (const CostAndGain& p : points)
      if (beats(p, points[i])) return false;
  for (const CostAndGain& p : points)
    if (std::none_of(front.begin(), front.end(), [&](size_t i) {
          return beats(points[i], p) || (points[i].ms == p.ms && points[i].psnr_db == p.psnr_db);
        }))
      return false;
  return true;
}

TEST(AccuracyFront, IsWhatNoPointBeats) {
  std::mt19937 random(5);
  for (int run = 0; run < 300; ++run) {
    const auto points = randomPoints(random, 1 + run % 40);
    std::vector<size_t> front = paretoFront(points);
    EXPECT_TRUE(isFront(points, front)) << run;
    for (size_t k = 1; k < front.size(); ++k) {
      EXPECT_LT(points[front[k - 1]].ms, points[front[k]].ms);
      EXPECT_LT(points[front[k - 1]].psnr_db, points[front[k]].psnr_db);
    }
    // Controls: without one of its points, and with one that is beaten, it is no front.
    for (size_t i = 0; i < points.size(); ++i)
      if (std::any_of(points.begin(), points.end(), [&](const CostAndGain& p) { return beats(p, points[i]); })) {
        std::vector<size_t> more = front;
        more.push_back(i);
        EXPECT_FALSE(isFront(points, more));
      }
    front.pop_back();
    EXPECT_FALSE(isFront(points, front));
  }
}

TEST(AccuracyFront, LeavesOutWhatIsNotANumber) {
  const std::vector<CostAndGain> points{{std::nan(""), 50}, {1, 30}, {2, std::nan("")}, {3, 29}};
  EXPECT_EQ(paretoFront(points), std::vector<size_t>{1});
  EXPECT_TRUE(paretoFront({}).empty());
}

TEST(AccuracyAdvice, IsTheCheapestAndTheMostAccurate) {
  std::mt19937 random(6);
  for (int run = 0; run < 300; ++run) {
    const auto points = randomPoints(random, 1 + run % 30);
    const double db = 19.5 + random() % 22, ms = 0.5 + random() % 22;
    const auto cheap = cheapestWithin(points, db), fine = mostAccurateWithin(points, ms);
    const auto reaches = [&](const CostAndGain& p) { return p.psnr_db >= db; };
    const auto fits = [&](const CostAndGain& p) { return p.ms <= ms; };
    ASSERT_EQ(cheap.has_value(), std::any_of(points.begin(), points.end(), reaches));
    ASSERT_EQ(fine.has_value(), std::any_of(points.begin(), points.end(), fits));
    for (const CostAndGain& p : points) {
      if (reaches(p)) {
        EXPECT_LE(points[*cheap].ms, p.ms);
      }
      if (fits(p)) {
        EXPECT_GE(points[*fine].psnr_db, p.psnr_db);
      }
    }
    if (cheap) {
      EXPECT_TRUE(reaches(points[*cheap]));
    }
    if (fine) {
      EXPECT_TRUE(fits(points[*fine]));
    }
  }
}

TEST(AccuracyCombinations, AreOfTheKnobsOwnFrontsAndNew) {
  const CostAndGain base{10, 40};
  // The third value of the first knob takes longer for less: it is in no combination.
  const std::vector<MeasuredKnob> knobs{{base, {base, {5, 35}, {12, 34}, {20, 46}}}, {base, {base, {8, 39}, {4, 30}}}};
  const auto is_known = [](std::span<const size_t> c) { return c[0] == 0 || c[1] == 0; };
  const auto all = promisingCombinations(knobs, 100, is_known);
  EXPECT_EQ(all.size(), 4u);  // (2 of the first but its base) x (2 of the second but its base)
  std::set<std::vector<size_t>> once(all.begin(), all.end());
  EXPECT_EQ(once.size(), all.size());
  for (const auto& c : all) {
    EXPECT_NE(c[0], 2u);
    EXPECT_FALSE(is_known(c));
  }
  EXPECT_EQ(promisingCombinations(knobs, 3, is_known).size(), 3u);
  EXPECT_EQ(promisingCombinations(knobs, 100, {}).size(), 9u);  // control: with those that are known
  EXPECT_EQ(promisingCombinations({}, 5, {}).size(), 1u);
}

// ---- settings files ----

TEST(AccuracySettings, GoToAFileAndBack) {
  std::mt19937 random(7);
  auto some = [&] { return random() % 2 == 0; };
  for (int run = 0; run < 100; ++run) {
    DrawSettings s;
    if (some()) s.error_px = 0.25 * (random() % 100);
    if (some()) s.least_cell = 0.1 * (random() % 100);
    if (some()) s.detail_bias = 0.05 * (random() % 100);
    if (some()) s.cache_mib = 0.1 + random() % 1000;
    if (some()) s.sampling = some() ? "nearest" : "anisotropic";
    if (some()) s.filter = some() ? "exact" : "fast";
    if (some()) s.anisotropy = 1 + static_cast<int>(random() % 8);
    if (some()) s.feedback_scale = 1 + static_cast<int>(random() % 16);
    if (some()) s.feedback_interval = 1 + static_cast<int>(random() % 16);
    if (some()) s.prefetch = some();
    const auto back = parseSettings(settingsText(s, some() ? "for \"people\"" : ""), "a.json");
    ASSERT_TRUE(back.ok()) << back.error().text();
    EXPECT_EQ(*back, s);
    DrawSettings other = s;
    other.error_px = s.error_px ? *s.error_px + 1 : 1;
    EXPECT_FALSE(*back == other) << "control";
  }
}

TEST(AccuracySettings, RefusesWhatItDoesNotKnowNamingIt) {
  const std::string head = R"({"format": "relievo-settings", "version": 1)";
  struct Case {
    std::string text, named;
    ErrorKind kind = ErrorKind::kInvalidData;
  };
  const Case cases[] = {{head + R"(, "err_px": 1})", "err_px"},
                        {head + R"(, "error_px": "1"})", "error_px"},
                        {head + R"(, "error_px": -1})", "error_px"},
                        {head + R"(, "error_px": null})", "error_px"},
                        {head + R"(, "anisotropy": 2.5})", "anisotropy"},
                        {head + R"(, "anisotropy": 99999999999999999999})", "anisotropy"},
                        {head + R"(, "feedback_interval": 0})", "feedback_interval"},
                        {head + R"(, "sampling": "cubic"})", "sampling"},
                        {head + R"(, "filter": 3})", "filter"},
                        {head + R"(, "prefetch": 1})", "prefetch"},
                        {head + R"(, "about": 1})", "about"},
                        {R"({"format": "relievo-settings", "version": 2})", "version 2", ErrorKind::kUnsupported},
                        {R"({"format": "relievo-settings", "version": "1"})", "version"},
                        {R"({"format": "relievo-settings"})", "version"},
                        {R"({"version": 1})", "format"},
                        {R"({"format": "other", "version": 1})", "format"},
                        {"[]", "format"},
                        {"{", "JSON"},
                        {"", "JSON"}};
  for (const Case& c : cases) {
    const auto r = parseSettings(c.text, "some.json");
    ASSERT_FALSE(r.ok()) << c.text;
    EXPECT_EQ(r.error().kind, c.kind) << c.text;
    EXPECT_NE(r.error().text().find("some.json"), std::string::npos) << r.error().text();
    EXPECT_NE(r.error().text().find(c.named), std::string::npos) << r.error().text();
  }
  EXPECT_TRUE(parseSettings(head + "}", "some.json").ok()) << "control";
  const std::string whole = settingsText(defaultSetting().draw, "about it");
  for (size_t length = 0; length + 2 < whole.size(); ++length)
    EXPECT_FALSE(parseSettings(whole.substr(0, length), "some.json").ok()) << length;
}

// ---- knobs, pages and reports ----

TEST(AccuracyKnobs, EachSaysWhatItIsAndTurnsOneThing) {
  for (bool quick : {true, false}) {
    std::set<std::string> names;
    for (const AccuracyKnob& k : accuracyKnobs(Manifest{}, quick)) {
      EXPECT_TRUE(names.insert(k.name).second) << k.name;
      EXPECT_FALSE(k.title.empty() || k.meaning.empty()) << k.name;
      EXPECT_TRUE(!k.why_not.empty() || k.values.size() >= 2) << k.name;
      std::set<std::string> settings;
      for (const KnobValue& v : k.values) settings.insert(settingText(v.setting));
      EXPECT_EQ(settings.size(), k.values.size()) << k.name << ": two values are the same setting, or read alike";
    }
  }
}

TEST(AccuracyRelief, RoundsToTheNearestAndAlwaysAlike) {
  for (int bits : {8, 9, 12, 16}) {
    const int step = 1 << (16 - bits);
    for (int h = 0; h < 65536; h += 7) {
      const int r = roundedHeight(static_cast<uint16_t>(h), bits);
      EXPECT_LE(std::abs(r - h), step / 2) << h;
      EXPECT_TRUE(r % step == 0 || r == 65535) << h;
    }
  }
  EXPECT_EQ(roundedHeight(12345, 16), 12345);
}

AccuracyResult someResult() {
  AccuracyResult r;
  r.renderer = "a <renderer>";
  auto add = [&](const char* knob, const char* label, double error_px, double psnr_db, double ms) {
    AccuracyRow row{knob, label, knobBase(), {}, {}};
    row.setting.draw.error_px = error_px;
    row.figures.psnr_db = psnr_db;
    row.figures.moving_ms = row.figures.still_ms = row.figures.cold_ms = {ms, ms, ms, 3};
    row.figures.bytes_read = row.figures.bytes_resident = 1000;
    r.rows.push_back(row);
  };
  add("base", "base", 1, 40, 10);
  add("error-px", "1 px", 1, 40, 10);
  add("error-px", "4 px", 4, 30, 4);
  add("error-px", "0.5 px", 0.5, 44, 30);
  add("encoding", "bc1", 1, 60, 1);
  r.rows.back().setting.encoding = "bc1";
  add("cache-mib", "8 MiB", 1, 70, 0.5);
  r.rows.back().problem = "the view did not settle";
  return r;
}

TEST(AccuracyRelief, TailsAreThoseOfThePackageWithHeightsOfAsManyBits) {
  // Patches without any texture page: their tails are all that there is.
  testing_support::ScratchFolder folder;
  BuildOptions options;
  options.output = folder.file("a.relievo");
  options.texture_tolerance = 2;
  class Plain final : public testing_support::NoisyPatches {
   public:
    using NoisyPatches::NoisyPatches;
    int textureDepthOf(uint32_t /*patch*/) const override { return kNoTexturePage; }
    Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
      for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint8_t>(40 + 7 * patch + i % 16);
      return {};
    }
  };
  const auto built = buildPatchPackage(Plain(testing_support::cubeSphere(2, 100, 7), 0, 0, 7), options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  const auto package = *Package::open(options.output);
  EXPECT_EQ(package->manifest().domain.textureDepthOf(0), kNoTexturePage);
  const uint32_t patches = package->manifest().domain.patchCount();
  const PatchTails tails = package->tails(1, nullptr).whole(0, patches);
  AccuracySetting setting = knobBase();
  setting.relief_bits = 9;
  std::shared_ptr<ReencodedPages> pages;
  const auto artwork = artworkOf(package, setting, &pages);
  ASSERT_TRUE(artwork.ok() && artwork->tails);
  const PatchTails rounded = artwork->tails(1, nullptr).whole(0, patches);
  EXPECT_TRUE(rounded.texels == tails.texels);
  size_t changed = 0;
  for (size_t i = 0; i < tails.heights.size(); ++i) {
    ASSERT_EQ(rounded.heights[i], roundedHeight(tails.heights[i], 9));
    changed += rounded.heights[i] != tails.heights[i];
  }
  EXPECT_GT(changed, tails.heights.size() / 2);
}

TEST(AccuracyKnobs, GetTheCacheThatTheArtworkNeeds) {
  std::vector<AccuracyKnob> knobs = accuracyKnobs(Manifest{}, true);
  giveCache(knobs, 325, 261);
  for (const AccuracyKnob& knob : knobs) {
    for (const KnobValue& v : knob.values) EXPECT_EQ(v.setting.draw.cache_mib, 325) << knob.name << " " << v.label;
    if (knob.name == "cache-mib") {
      EXPECT_EQ(knob.values.size(), 1u);
      EXPECT_NE(knob.why_not.find("261 MiB"), std::string::npos) << knob.why_not;
    }
  }
  // One that fits keeps the default, and what is not too small.
  knobs = accuracyKnobs(Manifest{}, true);
  giveCache(knobs, 256, 23.5);
  for (const AccuracyKnob& knob : knobs)
    if (knob.name == "cache-mib") {
      EXPECT_EQ(knob.values.size(), 2u);
      EXPECT_EQ(knob.values[0].setting, knobBase());
      EXPECT_EQ(knob.values[1].setting.draw.cache_mib, 24);
      EXPECT_EQ(knob.why_not, "");
    }
}

TEST(AccuracyReport, AdvisesWhatWasMeasuredAndAFileCanHold) {
  const AccuracyResult r = someResult();
  const auto advice = adviceFor(r, {{35, 42, 50}, {5, 12.5, 1}});
  ASSERT_EQ(advice.size(), 6u);
  EXPECT_EQ(r.rows[advice[0].row.value()].figures.moving_ms.median, 10);
  EXPECT_EQ(r.rows[advice[1].row.value()].label, "0.5 px");
  EXPECT_FALSE(advice[2].row) << "only what needs another package, or was not measured, is as accurate";
  EXPECT_EQ(r.rows[advice[3].row.value()].label, "4 px");
  EXPECT_EQ(advice[4].file, "settings-12-5-ms.json");
  EXPECT_FALSE(advice[5].row);
  EXPECT_EQ(accuracyFront(r), (std::vector<size_t>{2, 0, 3}));
}

TEST(AccuracyReport, IsWholeSafeAndSaysWhatWasNotMeasured) {
  AccuracyPlan plan;
  plan.knobs = accuracyKnobs(Manifest{}, true);
  const AccuracyResult r = someResult();
  const AccuracyProvenance made{"relievo accuracy a.relievo", "2026-01-02 03:04 UTC", "a processor", "a&b.relievo",
                                "0123456789abcdef"};
  const auto files = accuracyReport(plan, r, made, {{35, 50}, {5}});
  auto text = [&](const std::string& name) {
    for (const ReportFile& f : files)
      if (f.name == name) return f.text;
    return std::string();
  };
  const std::string html = text("report.html");
  for (const char* part : {"multisampling", "prefers-color-scheme:dark", "a&amp;b.relievo", "a &lt;renderer&gt;",
                           "the view did not settle", made.command.c_str(), made.date.c_str(), made.cpu.c_str(),
                           made.package_hash.c_str(), "seed 1"})
    EXPECT_NE(html.find(part), std::string::npos) << part;
  for (const char* part : {"http:", "https:", "src=", "href=", "<renderer>"})
    EXPECT_EQ(html.find(part), std::string::npos) << part;
  const std::string csv = text("accuracy.csv");
  const std::string head = csv.substr(0, csv.find('\n'));
  EXPECT_EQ(std::count(head.begin(), head.end(), ',') + 1, static_cast<std::ptrdiff_t>(accuracyColumns().size()));
  const auto json = nlohmann::json::parse(text("accuracy.json"));
  EXPECT_EQ(json["rows"].size(), r.rows.size());
  EXPECT_TRUE(json["rows"].back().contains("problem"));
  EXPECT_EQ(json["package"]["xxh3_64"], made.package_hash);
  const auto settings = parseSettings(text("settings-35-db.json"), "settings-35-db.json");
  ASSERT_TRUE(settings.ok()) << settings.error().text();
  EXPECT_EQ(*settings, r.rows[0].setting.draw);
  EXPECT_EQ(text("settings-50-db.json"), "") << "nothing reaches it";
  EXPECT_TRUE(text("error-px.svg").starts_with("<svg xmlns="));
  EXPECT_EQ(text("prefetch.svg"), "") << "a knob without figures has no plot";
}

}  // namespace accuracy_test
}  // namespace relievo
