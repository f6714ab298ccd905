// What a body over a base mesh looks like, against analytic truth: a ball of one colour, lit by Lambert's law under a
// light that turns with the camera. Geometry (which pixels), texture look-up (normals, over patches of any orientation)
// and shading all have to be right. Controls: the same picture against a light that stays, and against a ball of
// another size. And a bowl, whose inside is lit as what is seen of it, not as its outside.
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
    test::turnPatches(mesh, turns, false);
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

// A ball without the sixth of it that a cube's face covers, seen through that hole.
TEST(Bowl, IsLitOnTheSideThatIsSeen) {
  test::Random turns(kSeed);
  BaseMesh mesh = test::cubeSphere(2, kRadius);
  std::erase_if(mesh.patches, [&](const std::array<uint32_t, 4>& corners) {
    glm::vec3 middle(0);
    for (uint32_t c : corners) middle += mesh.corners[c].position_mm;
    return middle.z > std::max(std::abs(middle.x), std::abs(middle.y));
  });
  ASSERT_EQ(mesh.patches.size(), 20u);
  test::turnPatches(mesh, turns, false);
  const Artwork bowl = ballArtwork(std::make_shared<const BaseMesh>(std::move(mesh)), 1, kSeed);
  const auto share = [](const glm::dvec3& p) { return std::max(std::abs(p.x), std::abs(p.y)) / std::max(p.z, 1e-9); };
  uint64_t inside = 0, outside = 0;
  double largest = 0, as_outside = 0;
  for (const auto& [azimuth, elevation, orthographic, several] :
       {std::tuple{25.0, 10.0, false, false}, {-20.0, -30.0, false, true}, {10.0, 25.0, true, false}}) {
    Scene scene;
    scene.error_px = 0.1;
    scene.light = {0.4, 0.3, 0.8};
    if (several) scene.lights = {{.place = scene.light}, {.place = {0, 0, 1}, .intensity = 1e-9}};
    auto made = Engine::create(bowl, scene, {});
    ASSERT_TRUE(made.ok()) << made.error().text();
    Engine& engine = **made;
    engine.resize(kWidth, kHeight);
    OrbitCamera c;
    c.azimuth_deg = azimuth, c.elevation_deg = elevation, c.orthographic = orthographic;
    c.distance_mm = 4 * kRadius;
    engine.setCamera(c);
    auto settled = engine.settle(60);
    ASSERT_TRUE(settled.ok()) << settled.error().text();
    const ViewTransform view = engine.view();
    const auto light = normalizedLight(scene.light);
    const glm::dvec3 to_light = view.world_from_camera * glm::dvec3(light[0], light[1], light[2]);
    const std::vector<uint8_t> pixels = engine.readPixels();
    eachRay(view, [&](size_t at, const BallRay& ray) {
      if (!ray.hits(kRadius)) return;
      const glm::dvec3 near = ray.place(kRadius, -1), far = ray.place(kRadius, 1);
      const double hole = share(near);
      if (hole > 0.93 && hole < 1.07) return;  // the rim
      const bool in = hole < 1;
      const glm::dvec3 out = glm::normalize(in ? far : near);
      const auto off = [&](const glm::dvec3& normal) {
        const double lit = std::max(glm::dot(normal, to_light), 0.0);
        double most = 0;
        for (int k = 0; k < 3; ++k)
          most = std::max(
              most, std::abs(pixels[at + k] - kAlbedo[static_cast<size_t>(k)] * std::pow(0.04 + 0.96 * lit, 1 / 2.2)));
        return std::abs(glm::dot(normal, to_light)) < 0.02 ? 0.0 : most;
      };
      ++(in ? inside : outside);
      largest = std::max(largest, off(in ? -out : out));
      if (in) as_outside = std::max(as_outside, off(out));
    });
  }
  std::printf(
      "[ picture  ] %llu pixels inside, %llu outside; off by at most %.2f of 255 (%.0f if lit as the outside)\n",
      (unsigned long long)inside, (unsigned long long)outside, largest, as_outside);
  EXPECT_GT(inside, 5000u);
  EXPECT_GT(outside, 5000u);
  EXPECT_LE(largest, 2.5);
  EXPECT_GT(as_outside, 100) << "control";
}

INSTANTIATE_TEST_SUITE_P(Patches, MeshPicture, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "Cut" : "Bilinear"; });

}  // namespace mesh_picture_gltest
}  // namespace relievo
