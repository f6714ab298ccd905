// The eye stays outside of the surface that is drawn: the mouse's points come from the picture's depth, the guard from
// what the artwork states. A flat artwork of tall relief and a ball over a base mesh of chords, whose surfaces are
// known. Control: without them the eye goes through.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "src/engine/engine.h"
#include "src/engine/eye_guard.h"
#include "src/viewer/view_control.h"
#include "tests/render/lit_ball.h"
#include "tests/render/test_artwork.h"

namespace relievo {
namespace eye_outside_gltest {

using gl::EventKind;
using test::kHeight;
using test::kRadius;
using test::kWidth;

constexpr double kTallMm = 30;
constexpr int64_t kSidePx = 1024;

// Waves of 30 mm over 102 mm.
class Waves final : public HeightSource {
 public:
  static double at(double x_mm, double y_mm) { return kTallMm / 2 * std::sin(x_mm / 5) * std::cos(y_mm / 7); }
  int64_t width() const override { return kSidePx; }
  int64_t height() const override { return kSidePx; }
  double minMm() const override { return -kTallMm / 2; }
  double maxMm() const override { return kTallMm / 2; }
  Provenance provenance() const override { return {"waves", "", "test"}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    size_t i = 0;
    for (int64_t y = r.y; y < r.y + r.height; ++y)
      for (int64_t x = r.x; x < r.x + r.width; ++x)
        out[i++] = static_cast<float>(
            at((static_cast<double>(x) + 0.5 - kSidePx / 2) * 0.1, (kSidePx / 2 - static_cast<double>(y) - 0.5) * 0.1));
    return {};
  }
};

class EyeOutside : public ::testing::Test {
 protected:
  static Artwork waves() {
    static test::TemporaryFolder folder;
    static std::shared_ptr<const Package> package = [] {
      test::NoiseTexture texture(kSidePx, kSidePx, Basis::kColour, 5);
      Waves heights;
      BuildOptions options;
      options.output = folder.file("waves.relievo");
      options.mm_per_px = 0.1;
      const auto built = buildPackage(texture, &heights, options);
      EXPECT_TRUE(built.ok()) << built.error().text();
      return *Package::open(options.output);
    }();
    return artworkFromPackage(package);
  }
  static Artwork ball() {
    BaseMesh mesh = test::cubeSphere(2, kRadius);
    return test::ballArtwork(std::make_shared<const BaseMesh>(std::move(mesh)), 1, 7);
  }
  // Above 0 outside. A picture's surface may be an error budget off.
  static double wavesOutside(const glm::dvec3& p) {
    return std::max(std::abs(p.x), std::abs(p.y)) > 51.2 ? 1 : p.z - Waves::at(p.x, p.y);
  }
  static double ballOutside(const glm::dvec3& p) { return glm::length(p) - kRadius; }

  struct Window {
    Engine& engine;
    std::unique_ptr<const EyeGuard> guard;
    std::unique_ptr<ViewControl> control;
    Window(Engine& of, const Artwork& artwork, bool guarded) : engine(of) {
      const Extent extent = artworkExtent(artwork.manifest);
      guard = makeEyeGuard(artwork, 1, 2);
      ViewControl::View start{fitCamera(extent, kWidth, kHeight), {0, 0, 1}};
      control = std::make_unique<ViewControl>(
          extent, start, kWidth, kHeight,
          guarded ? ViewControl::Surface{[this](double x, double y) { return engine.surfacePoint(x, y); }, guard.get()}
                  : ViewControl::Surface{});
      draw();
    }
    void draw() {
      engine.setCamera(control->view().camera);
      const auto settled = engine.settle(60);
      ASSERT_TRUE(settled.ok()) << settled.error().text();
    }
    void wheel(double x, double y, double steps) {
      control->handle({.kind = EventKind::kMouseMove, .x = x, .y = y});
      control->handle({.kind = EventKind::kScroll, .y = steps});
    }
    void drag(gl::MouseButton button, double x0, double y0, double x1, double y1) {
      control->handle({.kind = EventKind::kMouseMove, .x = x0, .y = y0});
      control->handle({.kind = EventKind::kMouseDown, .x = x0, .y = y0, .button = button});
      for (int i = 1; i <= 4; ++i)
        control->handle({.kind = EventKind::kMouseMove, .x = x0 + (x1 - x0) * i / 4, .y = y0 + (y1 - y0) * i / 4});
      control->handle({.kind = EventKind::kMouseUp, .x = x1, .y = y1, .button = button});
    }
    glm::dvec3 eye() const { return eyePosition(control->view().camera); }
    double covered() {
      const auto pixels = engine.readPixels();
      size_t seen = 0;
      for (size_t i = 3; i < pixels.size(); i += 4) seen += pixels[i] != 0;
      return static_cast<double>(seen) / (kWidth * kHeight);
    }
  };

  static void zoomIn(const Artwork& artwork, double (*outside)(const glm::dvec3&)) {
    auto engine = Engine::create(artwork, Scene{}, {});
    ASSERT_TRUE(engine.ok()) << engine.error().text();
    (*engine)->resize(kWidth, kHeight);
    for (glm::dvec2 mouse : {glm::dvec2(160, 90), glm::dvec2(140, 100), glm::dvec2(173, 90)}) {
      for (bool guarded : {true, false}) {
        Window window(**engine, artwork, guarded);
        double least = 1e300;
        for (int notch = 0; notch < 100; ++notch) {
          window.wheel(mouse.x, mouse.y, 1);
          least = std::min(least, outside(window.eye()));
          if (guarded && notch % 4 == 0) window.draw();
        }
        window.draw();
        if (guarded) {
          EXPECT_GT(least, 0);
          EXPECT_EQ(window.covered(), 1) << "the artwork fills the window";
          EXPECT_TRUE((*engine)->surfacePoint(kWidth / 2, kHeight / 2));
        } else if (mouse.x == 173) {
          EXPECT_TRUE(least < 0 || window.covered() < 1) << "control";
        }
      }
    }
  }
  static void anyMoves(const Artwork& artwork, double (*outside)(const glm::dvec3&)) {
    auto engine = Engine::create(artwork, Scene{}, {});
    ASSERT_TRUE(engine.ok()) << engine.error().text();
    (*engine)->resize(kWidth, kHeight);
    Window window(**engine, artwork, true);
    std::mt19937 random(3);
    auto x = [&] { return std::uniform_real_distribution<double>(0, kWidth)(random); };
    auto y = [&] { return std::uniform_real_distribution<double>(0, kHeight)(random); };
    for (int i = 0; i < 60; ++i) {
      switch (random() % 6) {
        case 0:
        case 1:
          window.wheel(x(), y(), 6);
          break;
        case 2:
          window.wheel(x(), y(), -3);
          break;
        case 3:
          window.drag(gl::MouseButton::kLeft, x(), y(), x(), y());
          break;
        case 4:
          window.drag(gl::MouseButton::kMiddle, x(), y(), x(), y());
          break;
        case 5:
          window.control->handle({.kind = EventKind::kKeyDown, .key = "O"});
          break;
      }
      if (!window.control->view().camera.orthographic) {
        EXPECT_GT(outside(window.eye()), 0) << "seed 3, move " << i;
      }
      window.draw();
    }
  }
};

TEST_F(EyeOutside, AHundredNotchesOnTallRelief) { zoomIn(waves(), wavesOutside); }
TEST_F(EyeOutside, AHundredNotchesOnABall) { zoomIn(ball(), ballOutside); }
TEST_F(EyeOutside, WhateverAHandDoesOnTallRelief) { anyMoves(waves(), wavesOutside); }
TEST_F(EyeOutside, WhateverAHandDoesOnABall) { anyMoves(ball(), ballOutside); }

// A pixel's point projects to that pixel and lies on the surface; beside the artwork there is none.
TEST_F(EyeOutside, ThePointUnderAPixelLiesOnTheSurface) {
  for (bool body : {false, true}) {
    for (bool orthographic : {false, true}) {
      for (bool reversed : {true, false}) {
        Scene scene;
        scene.error_px = 0.1;
        EngineOptions options;
        options.reversed_depth = reversed;
        const Artwork artwork = body ? ball() : waves();
        auto engine = Engine::create(artwork, scene, options);
        ASSERT_TRUE(engine.ok()) << engine.error().text();
        (*engine)->resize(kWidth, kHeight);
        OrbitCamera camera = fitCamera(artworkExtent(artwork.manifest), kWidth, kHeight);
        camera.azimuth_deg = 20;
        camera.elevation_deg = -15;
        camera.orthographic = orthographic;
        (*engine)->setCamera(camera);
        ASSERT_TRUE((*engine)->settle(60).ok());
        const ViewTransform view = (*engine)->view();
        for (int y = 60; y <= 120; y += 15) {
          for (int x = 120; x <= 200; x += 20) {
            const auto p = (*engine)->surfacePoint(x + 0.3, y + 0.7);
            ASSERT_TRUE(p) << x << ", " << y;
            EXPECT_LT(std::abs(body ? ballOutside(*p) : wavesOutside(*p)), 0.6) << x << ", " << y;
            const glm::dvec4 clip = view.clip_from_world * glm::dvec4(*p, 1);
            EXPECT_NEAR((clip.x / clip.w + 1) * kWidth / 2, x + 0.5, 1e-6);
            EXPECT_NEAR((1 - clip.y / clip.w) * kHeight / 2, y + 0.5, 1e-6);
          }
        }
        for (glm::dvec2 beside :
             {glm::dvec2(1, 1), glm::dvec2(-5, 20), glm::dvec2(kWidth, 20), glm::dvec2(3, kHeight + 40)})
          EXPECT_FALSE((*engine)->surfacePoint(beside.x, beside.y)) << beside.x << ", " << beside.y;
      }
    }
  }
}

// The guard's distance is never more than the true one, and near the surface not much less.
TEST_F(EyeOutside, TheGuardsDistanceIsABound) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const Artwork flat = waves();
  const auto over_waves = makeEyeGuard(flat, 1, 2);
  const auto around_ball = makeEyeGuard(ball(), 1, 2);
  double slack_waves = 0;
  for (int i = 0; i < 3000; ++i) {
    const glm::dvec3 p(51 * uniform(random), 51 * uniform(random), 30 * uniform(random));
    const double d = over_waves->distance(p);
    if (wavesOutside(p) < 0) {
      EXPECT_LE(d, 0) << "behind the surface nothing is free";
    } else {
      EXPECT_LE(d, p.z - Waves::at(p.x, p.y) + 0.01);
      if (p.z > 16) slack_waves = std::max(slack_waves, p.z - kTallMm / 2 - d);
    }
    const glm::dvec3 q = 90.0 * glm::dvec3(uniform(random), uniform(random), uniform(random));
    EXPECT_LE(around_ball->distance(q), std::abs(ballOutside(q)) + 1e-4);
    if (around_ball->distance(q) > 0) {
      EXPECT_EQ(around_ball->behind(q), ballOutside(q) < 0);
    }
  }
  EXPECT_LT(slack_waves, 0.01) << "above the highest place nothing is in the way";
}

}  // namespace eye_outside_gltest
}  // namespace relievo
