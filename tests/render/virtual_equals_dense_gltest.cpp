// Virtual equals dense: with everything resident, the engine's frame equals the frame that the oracle
// (dense_reference.h) draws from plain dense textures in double precision, within 1/255, inside the silhouette. Random
// views, seeds printed. Negative controls: pages without borders, and an oracle that is wrong by a little.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>

#include "src/engine.h"
#include "tests/render/dense_pages.h"
#include "tests/render/dense_reference.h"
#include "tests/render/test_artwork.h"
#include "texturing/package_builder.h"
#include "tools/sample_artwork.h"

namespace relievo {
namespace {

constexpr uint32_t kSeed = 20261121;

// Both sides of the comparison: what the engine streams, and the oracle's dense textures.
struct Subject {
  Artwork artwork;
  std::shared_ptr<const DenseTexture> texture;
  std::shared_ptr<const DenseRelief> relief;
};

double uniform(std::mt19937& random, double a, double b) {
  return std::uniform_real_distribution<double>(a, b)(random);
}

// From close enough to see single texels to the whole artwork small, from the front to grazing, targets beyond the
// border.
OrbitCamera randomCamera(std::mt19937& random, const PlanarDomain& d, int height_px) {
  const double w = static_cast<double>(d.width_px) * d.mm_per_px, h = static_cast<double>(d.height_px) * d.mm_per_px;
  OrbitCamera c;
  c.azimuth_deg = uniform(random, -75, 75);
  c.elevation_deg = uniform(random, -65, 65);
  c.fov_deg = uniform(random, 15, 70);
  // Where a texel is a pixel, seen from the front.
  const double one_to_one = d.mm_per_px * height_px / (2 * std::tan(c.fov_deg * 3.14159265358979 / 360));
  const double relief_mm = 65535 * d.relief_scale_mm * (d.relief_depth >= 0);
  const double nearest = std::max(one_to_one / 16, 0.7 * relief_mm),
               farthest = std::max(4 * std::max(w, h), 2 * nearest);
  c.distance_mm = std::exp(uniform(random, std::log(nearest), std::log(farthest)));
  c.target_mm = {uniform(random, -0.52, 0.52) * w, uniform(random, -0.52, 0.52) * h, 0};
  return c;
}

struct Totals {
  int views = 0, seen = 0;
  int max_difference = 0;
  double max_exact = 0, worst_percentile = 0;
  size_t above_1 = 0, compared = 0, to_range = 0, edges = 0, holes = 0, extras = 0;
  double engine_s = 0, oracle_s = 0;
  void print(const char* what) const {
    std::printf(
        "[ dense ] %s: %d views (%d see it), %zu pixels: max %d/255, exact %.3f, worst 99.9%% %.3f, %zu above 1, %zu "
        "holes, "
        "%zu extras; %.3f%% edge pixels left out, %.3f%% compared to a range; engine %.1f s, oracle %.1f s\n",
        what, views, seen, compared, max_difference, max_exact, worst_percentile, above_1, holes, extras,
        100.0 * static_cast<double>(edges) / static_cast<double>(std::max<size_t>(1, compared + edges)),
        100.0 * static_cast<double>(to_range) / static_cast<double>(std::max<size_t>(1, compared)), engine_s, oracle_s);
  }
};

struct Views {
  int views = 10;
  int width = 320, height = 180;
  uint32_t seed = kSeed;
  bool random_light = true;
  Engine::Sabotage sabotage;
  std::function<void(DenseView&)> wrong_oracle;  // for negative controls
  std::function<OrbitCamera(std::mt19937&)> camera;
  int limit = 1;  // views above it are reported
};

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

Totals compare(const Subject& subject, Scene scene, const Views& run, double cache_mib = 256) {
  Totals totals;
  EngineOptions options;
  options.cache_mib = cache_mib;
  auto engine = Engine::create(subject.artwork, scene, options);
  EXPECT_TRUE(engine.ok()) << (engine.ok() ? "" : engine.error().text());
  if (!engine.ok()) return totals;
  Engine& e = **engine;
  e.resize(run.width, run.height);
  if (run.sabotage.no_borders) {
    EXPECT_TRUE(e.sabotage(run.sabotage).ok());
  }
  std::mt19937 random(run.seed);
  for (int view = 0; view < run.views; ++view) {
    const OrbitCamera camera =
        run.camera ? run.camera(random) : randomCamera(random, subject.texture->domain, run.height);
    if (run.random_light) scene.light = {uniform(random, -0.7, 0.7), uniform(random, -0.7, 0.7), 1};
    const double start = now();
    EXPECT_TRUE(e.setScene(scene).ok());
    e.setCamera(camera);
    auto settled = e.settle(60);
    EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
    if (!settled.ok()) return totals;
    EXPECT_EQ(e.stats().detail_bias, 0) << "the cache is too small for this test";
    const auto pixels = e.readPixels();
    const double drawn = now();

    DenseView v;
    v.clip_from_world = e.view().clip_from_world;
    v.width_px = run.width;
    v.height_px = run.height;
    v.exaggerate = scene.exaggerate;
    const auto light = normalizedLight(scene.light);
    v.light_u = light[0];
    v.light_v = light[1];
    v.trilinear = scene.trilinear;
    v.resolved = e.plan().resolve;
    if (run.wrong_oracle) run.wrong_oracle(v);
    const DenseImage reference =
        renderDense(*subject.texture, e.plan().relief ? subject.relief.get() : nullptr, e.instances(), v);
    const ImageDifference d = compareImages(reference, pixels, false);
    totals.engine_s += drawn - start;
    totals.oracle_s += now() - drawn;
    ++totals.views;
    totals.seen += d.compared > 100;
    totals.max_difference = std::max(totals.max_difference, d.maxDifference());
    totals.max_exact = std::max(totals.max_exact, d.max_exact);
    totals.worst_percentile = std::max(totals.worst_percentile, d.percentile_999);
    totals.above_1 += d.count_above_1;
    totals.compared += d.compared;
    totals.to_range += d.compared_to_range;
    totals.edges += d.edge_pixels;
    totals.holes += d.holes;
    totals.extras += d.extras;
    if (!run.wrong_oracle && !run.sabotage.no_borders && !d.within(run.limit)) {
      std::printf("  view %d of seed %u: azimuth %.3f elevation %.3f distance %.3f fov %.3f target %.3f %.3f: %s", view,
                  run.seed, camera.azimuth_deg, camera.elevation_deg, camera.distance_mm, camera.fov_deg,
                  camera.target_mm.x, camera.target_mm.y, d.text().c_str());
      if (d.worst.x >= 0) {
        const DensePixel& p = reference.at(d.worst.x, d.worst.y);
        std::printf("; texel %.4f %.4f, lambda %.4f, d/dx %.4f %.4f, d/dy %.4f %.4f", p.texel.x, p.texel.y, p.lambda,
                    p.texel_dx.x, p.texel_dx.y, p.texel_dy.x, p.texel_dy.y);
      }
      std::printf("\n");
    }
  }
  return totals;
}

void expectEqual(const Totals& t, const char* what) {
  t.print(what);
  EXPECT_LE(t.max_difference, 1);
  EXPECT_EQ(t.holes, 0u);
  EXPECT_EQ(t.extras, 0u);
  EXPECT_GT(t.seen, 0);
  // Edge pixels are left out of the comparison: they must stay few for it to mean anything.
  EXPECT_LT(static_cast<double>(t.edges), 0.03 * static_cast<double>(t.compared + t.edges) + 50);
}

// --- the oracle's own pages: any size, no builder, no file

Subject noiseSubject(int64_t w, int64_t h, Basis basis, double range_mm, uint32_t seed) {
  test::NoiseTexture texture(w, h, basis, seed);
  test::NoiseHeight heights(w, h, range_mm, seed + 100);
  const PlanarDomain domain = denseDomain(texture, range_mm > 0 ? &heights : nullptr, 0.1);
  Subject s;
  auto dense = buildDenseTexture(texture, domain);
  EXPECT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  s.artwork.manifest.domain = domain;
  s.artwork.manifest.texture = texture.format();
  if (range_mm > 0) {
    auto relief = buildDenseRelief(heights, domain);
    EXPECT_TRUE(relief.ok());
    s.relief = std::make_shared<DenseRelief>(std::move(*relief));
    s.artwork.oracle = denseReliefBounds(*s.relief, domain);
  }
  s.artwork.source = densePages(s.texture, s.relief);
  return s;
}

TEST(VirtualEqualsDense, ReliefOfEveryBasis) {
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kColour})
    expectEqual(compare(noiseSubject(1501, 1103, basis, 12, 7), {}, {.views = 12}), basisName(basis));
}

TEST(VirtualEqualsDense, WithoutRelief) {
  Scene scene;
  scene.relief = false;
  expectEqual(compare(noiseSubject(3001, 700, Basis::kPtmLrgb, 0, 8), scene, {.views = 12}), "flat strip");
  expectEqual(compare(noiseSubject(300, 1700, Basis::kColour, 0, 9), scene, {.views = 8}), "flat, upright strip");
}

TEST(VirtualEqualsDense, FixedLightAndNearestLevel) {
  const Subject subject = noiseSubject(1300, 1000, Basis::kPtmLrgb, 10, 10);
  Scene scene;
  scene.relight = false;
  expectEqual(compare(subject, scene, {.views = 8}), "resolved pages");
  scene.relight = true;
  scene.trilinear = false;
  expectEqual(compare(subject, scene, {.views = 8}), "nearest level");
  scene.trilinear = true;
  scene.exaggerate = 2.5;
  expectEqual(compare(subject, scene, {.views = 8}), "exaggerated relief");
}

TEST(VirtualEqualsDense, FromOneTexel) {
  for (auto [w, h] :
       {std::pair<int64_t, int64_t>{1, 1}, {2, 1}, {1, 3}, {5, 127}, {128, 128}, {129, 128}, {257, 255}, {1, 1000}}) {
    char name[64];
    std::snprintf(name, sizeof name, "%d x %d", int(w), int(h));
    expectEqual(compare(noiseSubject(w, h, Basis::kPtmLrgb, 0.02 * double(std::min(w, h)), 11), {},
                        {.views = 4, .width = 160, .height = 90}),
                name);
  }
}

// Sizes that no memory holds: the texture repeats, its pages are made when asked for.
Subject periodicSubject(int64_t w, int64_t h, Basis basis) {
  test::NoiseTexture period(512, 512, basis, 77);
  const auto width = static_cast<uint64_t>(w), height = static_cast<uint64_t>(h);
  PlanarDomain domain;
  domain.width_px = width;
  domain.height_px = height;
  domain.mm_per_px = 0.01;
  domain.texture_depth = PlanarDomain::depthFor(width, height);
  Subject s;
  auto dense = buildPeriodicTexture(period, domain);
  EXPECT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  s.artwork.manifest.domain = domain;
  s.artwork.manifest.texture = period.format();
  s.artwork.source = densePages(s.texture, nullptr);
  return s;
}

TEST(VirtualEqualsDense, ToTwoToThe24Texels) {
  for (auto [w, h] :
       {std::pair<int64_t, int64_t>{65536, 65536 - 512}, {1 << 20, 1 << 20}, {1 << 24, 1 << 24}, {1 << 24, 4096}}) {
    char name[64];
    std::snprintf(name, sizeof name, "%lld x %lld", static_cast<long long>(w), static_cast<long long>(h));
    const Subject subject = periodicSubject(w, h, Basis::kPtmLrgb);
    Views run{.views = 8};
    // Near views only: far ones see a constant. Anywhere, the last texels of the far corner included.
    run.camera = [&, n = 0](std::mt19937& random) mutable {
      OrbitCamera c = randomCamera(random, subject.texture->domain, 180);
      const double one_to_one = 0.01 * 180 / (2 * std::tan(c.fov_deg * 3.14159265358979 / 360));
      c.distance_mm = one_to_one * std::exp2(uniform(random, -4, 6));
      if (n++ % 2 == 0) c.target_mm = {0.005 * double(w), -0.005 * double(h), 0};
      return c;
    };
    expectEqual(compare(subject, {}, run), name);
  }
}

// --- a package of a sample artwork: the whole way, builder included

class SampleEqualsDense : public testing::TestWithParam<Basis> {};

TEST_P(SampleEqualsDense, HundredRandomViews) {
  test::TemporaryFolder folder;
  SampleArtwork sample({.kind = SampleKind::kInscription, .width = 4096, .height = 4096, .seed = 3});
  auto texture = sample.ptmSource(GetParam());
  auto heights = sample.heightSource();
  BuildOptions options;
  options.output = folder.file("sample.relievo");
  options.mm_per_px = sample.mmPerPx();
  auto built = buildPackage(*texture, heights.get(), options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok()) << package.error().text();
  Subject s;
  s.artwork = artworkFromPackage(*package);
  const PlanarDomain& domain = s.artwork.manifest.domain;
  auto dense = buildDenseTexture(*texture, domain);
  ASSERT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  auto relief = buildDenseRelief(*heights, domain);
  ASSERT_TRUE(relief.ok());
  s.relief = std::make_shared<DenseRelief>(std::move(*relief));
  expectEqual(compare(s, {}, {.views = 100}), basisName(GetParam()));
}

INSTANTIATE_TEST_SUITE_P(Bases, SampleEqualsDense, testing::Values(Basis::kPtmLrgb, Basis::kPtmRgb), [](const auto& i) {
  return i.param == Basis::kPtmLrgb ? std::string("Lrgb") : std::string("Rgb");
});

// --- negative controls

TEST(VirtualEqualsDense, NegativeControlPagesWithoutBorders) {
  const Subject subject = noiseSubject(1501, 1103, Basis::kPtmLrgb, 12, 7);
  Views run{.views = 12};
  run.sabotage.no_borders = true;
  const Totals t = compare(subject, {}, run);
  t.print("without borders");
  EXPECT_GT(t.max_difference, 1);
  EXPECT_GT(t.above_1, 100u);
}

TEST(VirtualEqualsDense, NegativeControlAWrongOracle) {
  const Subject subject = noiseSubject(1501, 1103, Basis::kPtmLrgb, 12, 7);
  const std::vector<std::pair<const char*, std::function<void(DenseView&)>>> mistakes{
      {"level of detail off by a quarter", [](DenseView& v) { v.lod_bias = 0.25; }},
      {"light off by a degree", [](DenseView& v) { v.light_u += 0.0175; }},
      {"nearest level", [](DenseView& v) { v.trilinear = false; }},
      {"half a pixel to the side", [](DenseView& v) {
         glm::dmat4 shift{1.0};
         shift[3][0] = 1.0 / v.width_px;
         v.clip_from_world = shift * v.clip_from_world;
       }}};
  for (const auto& [what, mistake] : mistakes) {
    Views run{.views = 6};
    run.wrong_oracle = mistake;
    const Totals t = compare(subject, {}, run);
    t.print(what);
    EXPECT_GT(t.max_difference, 1) << what;
    EXPECT_GT(t.above_1, 100u) << what;
  }
}

}  // namespace
}  // namespace relievo
