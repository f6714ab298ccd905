// What a body over a base mesh looks like, against analytic truth: a ball of one colour, lit by Lambert's law under a
// light that turns with the camera. Geometry (which pixels), texture look-up (normals, over patches of any orientation)
// and shading all have to be right. Controls: the same picture against a light that stays, and against a ball of
// another size.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "src/engine/engine.h"
#include "tests/render/lit_ball.h"
#include "tests/view_share.h"

namespace relievo {
namespace mesh_picture_gltest {

using namespace test;

constexpr uint64_t kSeed = 20261121;

class MeshPicture : public ::testing::TestWithParam<bool> {  // BaseMesh::cut
 protected:
  void SetUp() override {
    BaseMesh mesh = test::cubeSphere(2, kRadius);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    mesh.cut = GetParam();
    base_ = std::make_shared<const BaseMesh>(std::move(mesh));
    artwork_ = ballArtwork(base_, 1, kSeed);
  }

  std::shared_ptr<const BaseMesh> base_;
  Artwork artwork_;
};

TEST_P(MeshPicture, IsThatOfALitBall) {
  std::mt19937 random(static_cast<uint32_t>(kSeed));
  std::uniform_real_distribution<double> uniform(0, 1);
  Scene scene;
  scene.error_px = 0.1;
  auto made = Engine::create(artwork_, scene, {});
  ASSERT_TRUE(made.ok()) << made.error().text();
  Engine& engine = **made;
  engine.resize(kWidth, kHeight);
  BallDifference total;
  double still_light = 0, other_size = 0;
  const int views = test::denseShare(16);
  for (int view = 0; view < views; ++view) {
    OrbitCamera c;
    c.azimuth_deg = 360 * uniform(random) - 180;
    c.elevation_deg = 170 * uniform(random) - 85;
    c.distance_mm = kRadius * (1.5 + 3 * uniform(random));
    c.fov_deg = 20 + 40 * uniform(random);
    c.orthographic = view >= views * 3 / 4;
    engine.setCamera(c);
    scene.light = {uniform(random) - 0.5, uniform(random) - 0.5, 0.3 + uniform(random)};
    ASSERT_TRUE(engine.setScene(scene).ok());
    auto settled = engine.settle(60);
    ASSERT_TRUE(settled.ok()) << settled.error().text();
    const auto light = normalizedLight(scene.light);
    const glm::dvec3 to_light(light[0], light[1], light[2]);
    const ViewTransform view_now = engine.view();
    const auto pixels = engine.readPixels();
    const BallDifference d = compareWithBall(pixels, view_now, view_now.world_from_camera * to_light, kRadius);
    total.inside += d.inside, total.outside += d.outside, total.holes += d.holes, total.strays += d.strays;
    total.largest = std::max(total.largest, d.largest);
    still_light = std::max(still_light, compareWithBall(pixels, view_now, to_light, kRadius).largest);
    other_size = std::max(
        other_size, compareWithBall(pixels, view_now, view_now.world_from_camera * to_light, 0.97 * kRadius).largest);
  }
  std::printf(
      "[ picture  ] seed %llu: %llu pixels inside, %llu outside; off by at most %.2f of 255 (%.0f with a light that "
      "stays, %.1f for a ball 3 %% smaller)\n",
      (unsigned long long)kSeed, (unsigned long long)total.inside, (unsigned long long)total.outside, total.largest,
      still_light, other_size);
  EXPECT_GT(total.inside, 50'000u * static_cast<unsigned>(views) / 16);
  EXPECT_GT(total.outside, 50'000u * static_cast<unsigned>(views) / 16);
  EXPECT_EQ(total.holes, 0u);
  EXPECT_EQ(total.strays, 0u);
  // A normal byte is off by half a step, a pixel by half a level; the power curve is steepest in the dark.
  EXPECT_LE(total.largest, 2.5);
  EXPECT_GT(still_light, 20) << "control";
  EXPECT_GT(other_size, 8) << "control";
}

INSTANTIATE_TEST_SUITE_P(Patches, MeshPicture, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "Cut" : "Bilinear"; });

}  // namespace mesh_picture_gltest
}  // namespace relievo
