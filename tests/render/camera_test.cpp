// Cameras: nothing in view is cut by the near or far plane, the near plane is no nearer than it must be, and a fitted view
// holds the whole artwork.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "src/camera.h"

namespace relievo {
namespace {

constexpr uint32_t kSeed = 7;
constexpr int kWidth = 1280, kHeight = 720;

PlanarDomain panel() {
  PlanarDomain d;
  d.width_px = 3000;
  d.height_px = 1700;
  d.mm_per_px = 0.1;
  return d;
}

struct Cut {
  int seen = 0, cut = 0;
  double nearest_mm = 1e300, near_mm = 0;
};

// Random points of the artwork's box that are in the picture.
Cut countCut(const OrbitCamera& camera, std::mt19937& random, double near_factor) {
  PlanarDomain d = panel();
  constexpr double kLow = -4, kHigh = 2;
  ViewTransform v = viewTransform(camera, d, kLow, kHigh, kWidth, kHeight);
  Cut c;
  c.near_mm = v.near_mm * near_factor;
  if (v.eye_mm.z <= kHigh) return c;  // an eye within the heights: the near plane may cut
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  for (int i = 0; i < 20000; ++i) {
    glm::dvec4 p = v.clip_from_world * glm::dvec4(uniform(-150, 150), uniform(-85, 85), i % 2 ? kHigh : uniform(kLow, kHigh), 1);
    if (p.w <= 0 || std::abs(p.x) > p.w || std::abs(p.y) > p.w) continue;
    ++c.seen;
    c.cut += p.w < c.near_mm || p.z > p.w;
    c.nearest_mm = std::min(c.nearest_mm, p.w);
  }
  return c;
}

OrbitCamera randomCamera(std::mt19937& random) {
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  OrbitCamera c;
  c.azimuth_deg = uniform(-85, 85);
  c.elevation_deg = uniform(-85, 85);
  c.distance_mm = std::exp(uniform(std::log(3.0), std::log(2000.0)));
  c.fov_deg = uniform(5, 120);
  c.target_mm = {uniform(-150, 150), uniform(-85, 85), 0};
  return c;
}

TEST(Camera, NearAndFarCutNothingInView) {
  std::mt19937 random(kSeed);
  int seen = 0, cut = 0;
  for (int i = 0; i < 300; ++i) {
    Cut c = countCut(randomCamera(random), random, 1);
    seen += c.seen;
    cut += c.cut;
  }
  EXPECT_GT(seen, 100000);
  EXPECT_EQ(cut, 0) << "of " << seen << ", seed " << kSeed;
}

TEST(Camera, ANearPlaneTwiceAsFarWouldCut) {
  std::mt19937 random(kSeed);
  int cut = 0;
  for (int i = 0; i < 300; ++i) cut += countCut(randomCamera(random), random, 2).cut;
  EXPECT_GT(cut, 0);
}

// A depth buffer's step grows with 1 / near: at an oblique close-up the near plane must not fall to a thousandth of the distance.
TEST(Camera, TheNearPlaneIsCloseToWhatIsSeenInObliqueViews) {
  OrbitCamera c;
  c.azimuth_deg = -45;
  c.elevation_deg = -58;
  c.distance_mm = 64;
  c.target_mm = {-5, -67, 0};
  std::mt19937 random(kSeed);
  Cut cut = countCut(c, random, 1);
  ASSERT_GT(cut.seen, 1000);
  EXPECT_GT(cut.near_mm, 0.5 * cut.nearest_mm);  // a thousandth of the distance is 0.06 mm, some 0.002 of it
}

TEST(Camera, AFittedViewHoldsTheWholeArtworkAndLittleElse) {
  PlanarDomain d = panel();
  std::mt19937 random(kSeed);
  for (int i = 0; i < 200; ++i) {
    OrbitCamera c = randomCamera(random);
    c.target_mm = {0, 0, 0};
    c.distance_mm = fitDistance(c, d, kWidth, kHeight);
    ViewTransform v = viewTransform(c, d, 0, 0, kWidth, kHeight);
    double largest = 0;
    for (int corner = 0; corner < 4; ++corner) {
      glm::dvec4 p = v.clip_from_world * glm::dvec4(corner & 1 ? 150 : -150, corner & 2 ? 85 : -85, 0, 1);
      ASSERT_GT(p.w, 0);
      largest = std::max({largest, std::abs(p.x) / p.w, std::abs(p.y) / p.w});
    }
    EXPECT_LE(largest, 1.0);
    EXPECT_GE(largest, 0.9);
  }
}

TEST(Camera, PointUnderAPixelProjectsBackToIt) {
  OrbitCamera c;
  c.azimuth_deg = 30;
  c.elevation_deg = -20;
  c.distance_mm = 400;
  ViewTransform v = viewTransform(c, panel(), 0, 0, kWidth, kHeight);
  glm::dvec3 p;
  ASSERT_TRUE(pointOnPlane(c, kWidth, kHeight, 200.5, 610.25, &p));
  glm::dvec4 clip = v.clip_from_world * glm::dvec4(p, 1);
  EXPECT_NEAR((clip.x / clip.w + 1) / 2 * kWidth, 200.5, 1e-9);
  EXPECT_NEAR((1 - clip.y / clip.w) / 2 * kHeight, 610.25, 1e-9);
}

}  // namespace
}  // namespace relievo
