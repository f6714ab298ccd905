// Scenes of many patches, drawn from their tails (texturing/package/patch_tails.h): the picture is that of pages and of
// analytic truth, no page is pinned, and the smallest cache that is taken still draws everything. Bits of shared
// vertices: mesh_watertight_gltest.
#include <gtest/gtest.h>

#include <random>

#include "shaders/embedded.h"
#include "src/engine/fault_injection.h"
#include "src/render/tail_textures.h"
#include "src/render/texel_table.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"
#include "tests/view_share.h"

namespace relievo {
namespace patch_tails_gltest {

using namespace test;

constexpr uint64_t kSeed = 20261121;

class ManyPatches : public ::testing::Test {
 protected:
  // mirrored: some patches are, so that it counts as no closed body, whose backs are not drawn.
  static Artwork ball(int patches_a_side, bool mirrored = false) {
    BaseMesh mesh = test::cubeSphere(patches_a_side, kRadius);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns, mirrored);
    auto base = std::make_shared<const BaseMesh>(std::move(mesh));
    Artwork artwork = ballArtwork(base, 0, kSeed);
    // Chords of so many patches lie within this of the ball.
    CoarseErrors errors;
    for (size_t k = 0; k < errors.size(); ++k)
      errors[k] =
          static_cast<float>(kRadius * std::ldexp(0.5 / (patches_a_side * patches_a_side), -2 * static_cast<int>(k)));
    artwork.manifest.coarse_errors.assign(base->patches.size(), errors);
    return artwork;
  }
  static std::unique_ptr<Engine> engineOf(const Artwork& artwork, const Scene& scene, uint32_t most_pinned,
                                          double cache_mib) {
    EngineOptions options;
    options.most_pinned_patches = most_pinned;
    options.cache_mib = cache_mib;
    return test::makeEngine(artwork, scene, options, kWidth, kHeight);
  }
  static OrbitCamera cameraAt(double azimuth, double elevation, double radii) {
    OrbitCamera c;
    c.azimuth_deg = azimuth;
    c.elevation_deg = elevation;
    c.distance_mm = radii * kRadius;
    c.fov_deg = 30;
    return c;
  }
};

struct Shown {
  BallDifference of_ball;
  int most_different = 0;  // of 255, between the two engines
  uint64_t covered_differently = 0;
  uint32_t pages = 0;  // resident with tails
};

Shown show(Engine& tails, Engine& pages, const OrbitCamera& camera) {
  Shown out;
  std::vector<uint8_t> picture[2];
  for (Engine* e : {&tails, &pages}) {
    e->setCamera(camera);
    auto settled = e->settle(60);
    EXPECT_TRUE(settled.ok()) << settled.error().text();
    picture[e == &pages] = e->readPixels();
  }
  const ViewTransform view = tails.view();
  out.of_ball = compareWithBall(picture[0], view, view.world_from_camera * glm::dvec3(0, 0, 1), kRadius);
  for (size_t i = 0; i < picture[0].size(); i += 4) {
    if ((picture[0][i + 3] == 0) != (picture[1][i + 3] == 0)) {
      ++out.covered_differently;
      continue;
    }
    for (size_t c = 0; c < 3; ++c)
      out.most_different = std::max(out.most_different, std::abs(picture[0][i + c] - picture[1][i + c]));
  }
  out.pages = tails.stats().resident;
  return out;
}

// 384 patches, some 6 to 200 px wide: from tails alone, from both, from pages alone.
TEST_F(ManyPatches, TailsShowWhatPagesShow) {
  const Artwork artwork = ball(8);
  Scene scene;
  scene.error_px = 0.5;
  auto tails = engineOf(artwork, scene, 0, 64), pages = engineOf(artwork, scene, kMaxPatches, 128);
  ASSERT_TRUE(tails && pages);
  EXPECT_EQ(tails->stats().resident, 0u);
  EXPECT_GE(pages->stats().resident, 384u);
  const struct {
    double radii;
    int most;  // of 255; 0: the same picture
    bool no_pages;
  } views[] = {{16, 4, true}, {7, 4, true}, {3, 4, false}, {1.8, 4, false}, {1.05, 0, false}};
  for (const auto& v : views) {
    const Shown s = show(*tails, *pages, cameraAt(33, 21, v.radii));
    std::printf(
        "[ picture  ] at %.2f radii: off the ball by at most %.2f of 255, off the picture of pages by %d; %u pages "
        "resident\n",
        v.radii, s.of_ball.largest, s.most_different, s.pages);
    EXPECT_EQ(s.covered_differently, 0u) << v.radii;
    EXPECT_LE(s.most_different, v.most) << v.radii;
    if (v.radii > 1.5) {
      EXPECT_GT(s.of_ball.inside, v.radii > 10 ? 50u : 500u);
      EXPECT_EQ(s.of_ball.holes + s.of_ball.strays, 0u) << v.radii;
      EXPECT_LE(s.of_ball.largest, 4) << v.radii;
    }
    EXPECT_EQ(s.pages == 0, v.no_pages) << v.radii;
  }
  // Coming back, what was streamed is there or not: the picture is the same.
  const Shown again = show(*tails, *pages, cameraAt(33, 21, 7));
  EXPECT_LE(again.most_different, 4);
}

TEST_F(ManyPatches, OtherTexelsInTheTailsWouldBeSeen) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  Artwork artwork = ball(8);
  Scene scene;
  auto pages = engineOf(artwork, scene, kMaxPatches, 128);
  artwork.tails = [artwork](int workers, std::vector<std::string>*) {
    const Manifest& m = artwork.manifest;
    PatchTails tails(m.domain.patchCount(), m.texture.channels());
    tailsFromPages(*artwork.source, m.texture, true, 0, workers, tails, nullptr);
    for (uint8_t& texel : tails.texels) texel = static_cast<uint8_t>(texel ^ 32);
    return tails;
  };
  auto tails = engineOf(artwork, scene, 0, 64);
  ASSERT_TRUE(tails && pages);
  EXPECT_GT(show(*tails, *pages, cameraAt(33, 21, 7)).most_different, 20);
}

// A slow zoom from tails to pages: each picture is the ball's.
TEST_F(ManyPatches, GoesOverAndStaysTheBall) {
  const Artwork artwork = ball(6);
  Scene scene;
  scene.error_px = 0.25;
  auto tails = engineOf(artwork, scene, 0, 64);
  ASSERT_TRUE(tails);
  double worst = 0;
  int from_tails = 0, from_pages = 0;
  for (double radii = 9; radii > 1.3; radii *= 0.93) {
    tails->setCamera(cameraAt(120, -17, radii));
    ASSERT_TRUE(tails->settle(60).ok());
    const ViewTransform view = tails->view();
    const BallDifference d =
        compareWithBall(tails->readPixels(), view, view.world_from_camera * glm::dvec3(0, 0, 1), kRadius);
    EXPECT_EQ(d.holes, 0u);
    worst = std::max(worst, d.largest);
    ++(tails->stats().wanted_nodes == 0 ? from_tails : from_pages);
  }
  EXPECT_LE(worst, 4);
  EXPECT_GT(from_tails, 3);
  EXPECT_GT(from_pages, 3);
}

// 24,576 patches whose three roots each would take 5 GB.
TEST_F(ManyPatches, TheSmallestCacheDrawsAll) {
  Artwork artwork = ball(64, true);
  artwork.tails = [artwork](int,
                            std::vector<std::string>*) {  // one colour; the chords themselves: 0.02 mm off the ball
    PatchTails tails(artwork.manifest.domain.patchCount(), artwork.manifest.texture.channels());
    std::ranges::fill(tails.texels, uint8_t{200});
    return tails;
  };
  EngineOptions options;
  options.cache_mib = 1;
  auto refused = Engine::create(artwork, {}, options);
  ASSERT_FALSE(refused.ok());
  EXPECT_EQ(refused.error().kind, ErrorKind::kUsage);
  int least = 0;
  ASSERT_EQ(std::sscanf(refused.error().hint.c_str(), "give it at least %d MiB", &least), 1) << refused.error().hint;
  EXPECT_LT(least, 128);
  options.cache_mib = least - 1.5;
  EXPECT_FALSE(Engine::create(artwork, {}, options).ok());
  auto engine = engineOf(artwork, {}, options.most_pinned_patches, least);
  ASSERT_TRUE(engine);
  for (double radii : {4.0, 1.6, 1.02}) {
    engine->setCamera(cameraAt(-50, 35, radii));
    for (int frame = 0; frame < 4; ++frame) engine->frame(frame * 0.02);
    const BallDifference d = compareWithBall(engine->readPixels(), engine->view(), glm::dvec3(0, 0, 1), 0.98 * kRadius);
    EXPECT_EQ(d.holes, 0u) << radii;
    EXPECT_LE(engine->stats().draw_calls, 8u);
    if (radii == 4) {
      EXPECT_GT(d.inside, 1000u);
      EXPECT_EQ(engine->stats().resident, 0u);
      // Single cells are drawn as one mesh; as many draw calls as patches show the same.
      const auto as_one = engine->readPixels();
      const uint32_t instances = engine->stats().instances;
      EXPECT_GT(instances, 2000u);
      ASSERT_TRUE(injectFaults(*engine, {.call_a_patch = true}).ok());
      engine->frame(0.1);
      EXPECT_GE(engine->stats().draw_calls, instances);
      EXPECT_TRUE(engine->readPixels() == as_one);
      ASSERT_TRUE(injectFaults(*engine, {}).ok());
    }
  }
}

// Numbers that GLSL has to know.
// A context has room for what tails take, not for the most that so many could: patches without heights of 2 x 2 texels.
TEST(TailTextures, FitByWhatTheyTake) {
  const KeptTails even(1000, 6);
  constexpr uint64_t kTexels = 1000 * 2 * (1 + 4 * 4),  // a rank, and a block with its border, of either plane
      kHeights = 1000 * 4 + kTailHeights;
  EXPECT_TRUE(TailTextures::fit(even, kTexels, kHeights));
  EXPECT_FALSE(TailTextures::fit(even, kTexels - 1, kHeights));
  EXPECT_FALSE(TailTextures::fit(even, kTexels, kHeights - 1));
  EXPECT_TRUE(TailTextures::fit(even, kTexels, 0)) << "heights lie in rows, too";
  PatchTails bent(3, 6);
  bent.heights[0] = 7;
  EXPECT_TRUE(TailTextures::fit(bent, kTexels, 3 * (4 + kTailHeights)));
  EXPECT_FALSE(TailTextures::fit(bent, kTexels, 3 * (4 + kTailHeights) - 1)) << "a grid each";
}

TEST(TailShaders, KnowTheSameNumbers) {
  const std::string text(shaderSource("tails.glsl")), vertex(shaderSource("patch.vert"));
  auto has = [](const std::string& in, const std::string& what) { return in.find(what) != std::string::npos; };
  EXPECT_TRUE(has(text, "kTailLevels = " + std::to_string(kTailLevels) + ";"));
  EXPECT_TRUE(has(text, "uint side = uint(16 >> shown) + 2u;"));
  EXPECT_TRUE(has(vertex, "a_node.z * u_tail_grid + uint(s.y * " + std::to_string(kTailSamples) + " + s.x)"));
  EXPECT_TRUE(has(vertex, "u_tail_patches * " + std::to_string(kTailBlockHeights - kTailHeights) + "u"));
  const std::string tables(shaderSource("texel_table.glsl"));
  static_assert(TexelTable::kRow == 2048 && TexelTable::kRows == 2048);
  EXPECT_TRUE(has(tables, "(i) & 2047u") && has(tables, ">> 11u) & 2047u") && has(tables, ">> 22u"));
}

}  // namespace patch_tails_gltest
}  // namespace relievo
