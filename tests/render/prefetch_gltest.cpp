// The engine's prefetch: a moving camera's next pages are read ahead, a still camera's are not, and the settled picture
// is the same.
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <thread>

#include "src/engine/engine.h"
#include "tests/render/test_artwork.h"

namespace relievo {
namespace prefetch_gltest {

constexpr int kWidth = 320, kHeight = 180;

class PrefetchGl : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string why;
    package_ = test::noisePackageOnce(2048, 2048, Basis::kPtmLrgb, 4, 7, &why);
    ASSERT_TRUE(package_) << why;
  }
  std::unique_ptr<Engine> engineWith(bool prefetch) {
    EngineOptions options;
    options.prefetch = prefetch;
    auto engine = Engine::create(artworkFromPackage(package_), Scene{}, options);
    if (!engine) return nullptr;
    (*engine)->resize(kWidth, kHeight);
    return std::move(*engine);
  }
  static OrbitCamera cameraAt(double t) {
    OrbitCamera c;
    c.distance_mm = 40;
    c.target_mm.x = -70 + 90 * t;
    return c;
  }
  // Frames on a clock of their own; real time passes as well, so that workers have some.
  void fly(Engine& engine, double from_s, double to_s, bool still = false) {
    for (double t = from_s; t < to_s; t += 1.0 / 60) {
      engine.setCamera(cameraAt(still ? from_s : t));
      engine.frame(100 + t);
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }

  std::shared_ptr<const Package> package_;
};

TEST_F(PrefetchGl, AMovingCameraReadsAheadAndAStillOneDoesNot) {
  auto engine = engineWith(true);
  ASSERT_TRUE(engine);
  fly(*engine, 0, 0.5, true);
  EXPECT_EQ(engine->stats().streamer.prefetched, 0u);
  EXPECT_EQ(engine->stats().predict_ms, 0) << "a still camera costs nothing, no thread either";
  fly(*engine, 0.5, 1.5);
  EXPECT_GT(engine->stats().streamer.prefetched, 0u);
  EXPECT_GT(engine->stats().streamer.prefetch_used, 0u);
  auto other = engineWith(false);
  ASSERT_TRUE(other);
  fly(*other, 0.5, 1.5);
  EXPECT_EQ(other->stats().streamer.prefetched, 0u) << "the control: switched off";
}

TEST_F(PrefetchGl, TheSettledPictureIsTheSame) {
  std::vector<uint8_t> picture[2];
  for (int on : {0, 1}) {
    auto engine = engineWith(on != 0);
    ASSERT_TRUE(engine);
    fly(*engine, 0, 1.0);  // settles in the middle of the way, with predictions under way
    auto settled = engine->settle(60);
    ASSERT_TRUE(settled) << settled.error().text();
    picture[on] = engine->readPixels();
    if (on) {
      // The control: another place is another picture.
      engine->setCamera(cameraAt(1.2));
      ASSERT_TRUE(engine->settle(60));
      EXPECT_NE(engine->readPixels(), picture[on]);
    }
  }
  EXPECT_EQ(picture[0], picture[1]);
}

}  // namespace prefetch_gltest
}  // namespace relievo
