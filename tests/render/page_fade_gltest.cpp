// The page fade: a new page blends in from its ancestor over the set time, in step with the clock, and ends exactly at
// the page. Every level has one value, so the blend is what a pixel shows. With a fade of 0 the shader has no trace of
// it.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "src/render/patch_pass.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/gl_fixture.h"

namespace relievo {
namespace page_fade_gltest {

using namespace test;

constexpr int kCoarse = 50, kFine = 200;
constexpr double kBorn_s = 10, kFade_s = 1;

// 256 x 256 texels: a root and four pages of the finest level.
Subject twoLevels() {
  Subject s = noiseSubject(256, 256, Basis::kColour, 0, 5);
  auto levels = std::make_shared<DenseTexture>(*s.texture);
  std::fill(levels->levels[0].texels.begin(), levels->levels[0].texels.end(), uint8_t{kCoarse});
  std::fill(levels->levels[1].texels.begin(), levels->levels[1].texels.end(), uint8_t{kFine});
  s.texture = levels;
  s.artwork.source = densePages(s.texture, nullptr);
  return s;
}

// Close enough for the finest level everywhere; all pages are resident, and were all born at kBorn_s, afterwards.
std::unique_ptr<Engine> bornEngine(const Subject& subject, double fade_s) {
  Scene scene;
  scene.sampling = Sampling::kBilinear;
  scene.page_fade_s = fade_s;
  auto made = Engine::create(subject.artwork, scene, {});
  EXPECT_TRUE(made.ok());
  std::unique_ptr<Engine> engine = std::move(*made);
  engine->resize(64, 64);
  OrbitCamera camera;
  camera.distance_mm = 5;
  engine->setCamera(camera);
  for (int i = 0; i < 2000; ++i) {
    engine->frame(kBorn_s);
    if (engine->stats().wanted_nodes > 1 && engine->stats().missing_pages == 0) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(engine->stats().missing_pages, 0u);
  return engine;
}

int shownAt(Engine& engine, double now_s) {
  engine.frame(now_s);
  return engine.readPixels()[4 * (20 * 64 + 20)];
}

TEST(PageFade, BlendsInOverItsTimeAndEndsAtThePage) {
  const Subject subject = twoLevels();
  auto engine = bornEngine(subject, kFade_s);
  int before = 0;
  for (int i = 0; i <= 80; ++i) {
    const double age_s = i / 64.0;  // the clock of the fade ticks 64 times a second
    const int shown = shownAt(*engine, kBorn_s + age_s);
    const double expected = kCoarse + (kFine - kCoarse) * std::min(age_s / kFade_s, 1.0);
    EXPECT_NEAR(shown, expected, 0.51) << age_s;
    EXPECT_GE(shown, before);
    before = shown;
    if (age_s >= kFade_s) {
      EXPECT_EQ(shown, kFine);
    }
  }
  // Negative control: half as long a fade is twice as far half way.
  auto quicker = bornEngine(subject, kFade_s / 2);
  EXPECT_GT(shownAt(*quicker, kBorn_s + 0.25), shownAt(*bornEngine(subject, kFade_s), kBorn_s + 0.25) + 20);
}

// The clock of the fade goes round in 1,024 s; a page is new only once.
TEST(PageFade, APageDoesNotFadeAgainWhenTheClockHasGoneRound) {
  auto engine = bornEngine(twoLevels(), kFade_s);
  EXPECT_LT(shownAt(*engine, kBorn_s + 0.25), kFine);
  for (double later_s : {10.0, 500.0, 1024.0, 1024.25, 3072.25})
    EXPECT_EQ(shownAt(*engine, kBorn_s + later_s), kFine) << later_s;
}

TEST(PageFade, ASettledPictureDoesNotFade) {
  auto engine = bornEngine(twoLevels(), 60);
  EXPECT_LT(shownAt(*engine, kBorn_s + 1), kFine);
  ASSERT_TRUE(engine->settle(60).ok());
  EXPECT_EQ(engine->readPixels()[4 * (20 * 64 + 20)], kFine);
}

TEST(PageFade, OffLeavesNoTrace) {
  const Subject subject = twoLevels();
  auto engine = bornEngine(subject, 0);
  EXPECT_EQ(shownAt(*engine, kBorn_s), kFine);
  for (const double fade_s : {0.0, 1.0}) {
    Scene scene;
    scene.page_fade_s = fade_s;
    const auto plan = planEffects(scene, subject.artwork.manifest);
    auto program = gl::Program::link(gltest::api(), {"screen.vert", "shade.frag", plan.defines(), {"a_corner"}, {}});
    ASSERT_TRUE(program.ok()) << program.error().text();
    EXPECT_EQ(program->uniform("u_fade") >= 0, fade_s > 0);
  }
}

}  // namespace page_fade_gltest
}  // namespace relievo
