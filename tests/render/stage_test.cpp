// What several artworks share, and which of them the camera sees; no GL.
#include <gtest/gtest.h>

#include <numeric>
#include <random>

#include "src/engine/stage.h"
#include "src/render/composition.h"
#include "tests/render/pose_fixture.h"

namespace relievo {
namespace stage_test {

using namespace test;

TEST(CacheShares, StayWithinTheBudgetAndFollowTheNeeds) {
  std::mt19937_64 random(3);
  for (int run = 0; run < 500; ++run) {
    std::vector<CacheNeed> needs(1 + random() % 16);
    uint64_t least = 0, most = 0;
    for (CacheNeed& need : needs) {
      need.least_bytes = random() % 1000;
      need.most_bytes = need.least_bytes + random() % 5000;
      least += need.least_bytes;
      most += need.most_bytes;
    }
    const uint64_t budget = least + random() % 40000;
    const auto shares = shareCache(needs, budget);
    ASSERT_EQ(shares.size(), needs.size());
    EXPECT_LE(std::accumulate(shares.begin(), shares.end(), uint64_t{0}), budget);
    EXPECT_GE(std::accumulate(shares.begin(), shares.end(), uint64_t{0}) + needs.size(), std::min(budget, most))
        << "what one has no use for is the others'";
    for (size_t i = 0; i < needs.size(); ++i) {
      EXPECT_GE(shares[i], needs[i].least_bytes);
      EXPECT_LE(shares[i], needs[i].most_bytes);
    }
  }
  EXPECT_EQ(shareCache(std::vector<CacheNeed>{{10, 1000}, {20, 40}, {5, 1000}}, 535),
            (std::vector<uint64_t>{250, 40, 245}));
}

// A box is in view where one of its places is, of which many are tried; boxes that are said to be out of view have none
// in the picture.
TEST(ArtworksInView, AreThoseOfWhichThePictureShowsAny) {
  std::mt19937 random(5);
  const auto some = [&](double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); };
  int in = 0, out = 0, spared = 0;
  for (int run = 0; run < 400; ++run) {
    OrbitCamera camera;
    camera.azimuth_deg = some(-180, 180);
    camera.elevation_deg = some(-80, 80);
    camera.distance_mm = some(50, 300);
    camera.orthographic = run % 2 == 0;
    const PlacedExtent placed{{{-some(5, 30), -some(5, 30), -3}, {some(5, 30), some(5, 30), 4}, 0.1, false},
                              {{some(-200, 200), some(-200, 200), some(-200, 200)}, {some(0, 360), some(0, 360), 0}}};
    bool seen = false;
    for (int i = 0; i < 2000 && !seen; ++i) {
      const glm::dvec3 &low = placed.extent.min_mm, &high = placed.extent.max_mm;
      const glm::dvec3 p = pixelOf(
          camera, placeInWorld(placed.pose, {some(low.x, high.x), some(low.y, high.y), some(low.z, high.z)}), 640, 360);
      seen = p.x > 0 && p.x < 640 && p.y > 0 && p.y < 360 && (camera.orthographic || p.z > 0);
    }
    const bool said = isInView(camera, placed, 640, 360);
    if (seen) {
      EXPECT_TRUE(said);
    }
    in += seen;
    out += !seen;
    spared += !said;
  }
  EXPECT_GT(in, 50);
  EXPECT_GT(out, 50);
  EXPECT_GT(spared, out / 2) << "not all are drawn for nothing";
}

// The same measure for pictures of other near and far planes: that of the distance alone, and it grows towards the eye.
TEST(Nearness, IsThatOfTheDistanceWhateverTheNearAndFarPlanes) {
  std::mt19937 random(7);
  const auto some = [&](double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); };
  for (int run = 0; run < 500; ++run) {
    OrbitCamera camera;
    camera.distance_mm = 400;
    camera.orthographic = run % 2 == 0;
    const double z = some(-50, 50);
    std::array<double, 2> nearness{};
    for (double& n : nearness) {
      const Extent box{{-9, -9, z - some(1, 90)}, {9, 9, z + some(1, 90)}, 0.1, false};
      const ViewTransform view = viewTransform(camera, PlacedExtent{box, {}}, 640, 360);
      const glm::dvec4 clip = view.clip_from_world * glm::dvec4(1, 2, z, 1);
      const double depth = 0.5 * (1 - clip.z / clip.w);  // reversed
      n = nearnessOf(view).x + depth * nearnessOf(view).y;
    }
    EXPECT_NEAR(nearness[0], camera.orthographic ? z : 1 / (400 - z), 1e-9);
    EXPECT_NEAR(nearness[0], nearness[1], 1e-9);
  }
}

}  // namespace stage_test
}  // namespace relievo
