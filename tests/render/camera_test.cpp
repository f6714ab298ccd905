// Cameras: nothing in view is cut by the near or far plane, the near plane is no nearer than it must be, and a fitted
// view holds the whole artwork.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "src/engine/engine.h"
#include "src/render/camera.h"

#include <glm/gtc/matrix_transform.hpp>

namespace relievo {
namespace camera_test {

constexpr uint32_t kSeed = 7;
constexpr int kWidth = 1280, kHeight = 720;

FlatDomain panel() {
  FlatDomain d;
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
  FlatDomain d = panel();
  constexpr double kLow = -4, kHigh = 2;
  ViewTransform v = viewTransform(camera, d, kLow, kHigh, kWidth, kHeight);
  Cut c;
  c.near_mm = v.near_mm * near_factor;
  if (!v.orthographic && v.eye_mm.z <= kHigh) return c;  // an eye within the heights: the near plane may cut
  // Nothing in view is nearer than the nearest point by more than the depths are deep.
  if (v.orthographic)
    v.clip_from_world = glm::translate(glm::dmat4(1.0), glm::dvec3(0, 0, 1 - near_factor)) * v.clip_from_world;
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  for (int i = 0; i < 20000; ++i) {
    glm::dvec4 p =
        v.clip_from_world * glm::dvec4(uniform(-150, 150), uniform(-85, 85), i % 2 ? kHigh : uniform(kLow, kHigh), 1);
    if (p.w <= 0 || std::abs(p.x) > p.w || std::abs(p.y) > p.w) continue;
    ++c.seen;
    c.cut += (v.orthographic ? p.z < -p.w : p.w < c.near_mm) || p.z > p.w;
    c.nearest_mm = std::min(c.nearest_mm, p.w);
  }
  return c;
}

OrbitCamera randomCamera(std::mt19937& random, bool orthographic = false) {
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  OrbitCamera c;
  c.azimuth_deg = uniform(-85, 85);
  c.elevation_deg = uniform(-85, 85);
  c.distance_mm = std::exp(uniform(std::log(3.0), std::log(2000.0)));
  c.fov_deg = uniform(5, 120);
  c.orthographic = orthographic;
  c.target_mm = {uniform(-150, 150), uniform(-85, 85), 0};
  return c;
}

TEST(Camera, NearAndFarCutNothingInView) {
  for (bool orthographic : {false, true}) {
    std::mt19937 random(kSeed);
    int seen = 0, cut = 0;
    for (int i = 0; i < 300; ++i) {
      Cut c = countCut(randomCamera(random, orthographic), random, 1);
      seen += c.seen;
      cut += c.cut;
    }
    EXPECT_GT(seen, 100000);
    EXPECT_EQ(cut, 0) << "of " << seen << ", seed " << kSeed;
  }
}

// Orthographic: by half of all depths.
TEST(Camera, ANearPlaneTwiceAsFarWouldCut) {
  for (bool orthographic : {false, true}) {
    std::mt19937 random(kSeed);
    int cut = 0;
    for (int i = 0; i < 300; ++i) cut += countCut(randomCamera(random, orthographic), random, 2).cut;
    EXPECT_GT(cut, 0);
  }
}

// Depth has as many steps as its range is deep: a close-up of a large panel at a slant must not count the panel's far
// ends.
TEST(Camera, OrthographicDepthsAreThoseOfWhatIsSeen) {
  OrbitCamera c;
  c.orthographic = true;
  c.azimuth_deg = 60;
  c.distance_mm = 5;
  const ViewTransform v = viewTransform(c, panel(), -0.1, 0.1, kWidth, kHeight);
  EXPECT_LT(v.far_mm - v.near_mm, 20);
  EXPECT_GT(viewTransform(c, {{-150, -85, -0.1}, {150, 85, 0.1}, 0.1, false}, kWidth, kHeight).far_mm, 100)
      << "control: a body shows all of it";
}

// A depth buffer's step grows with 1 / near: at an oblique close-up the near plane must not fall to a thousandth of the
// distance.
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
  FlatDomain d = panel();
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

// Heights far from 0, and large ones, are in the picture; small ones around 0 change nothing.
TEST(Camera, AFittedViewHoldsWhatIsDisplaced) {
  const FlatDomain d = panel();
  std::mt19937 random(kSeed + 3);
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  for (auto [low, high] : {std::pair{490.0, 500.0}, {-500.0, -490.0}, {0.0, 100.0}, {-100.0, 100.0}, {-4.0, 2.0}}) {
    const Extent extent = extentOf(d, low, high);
    for (int i = 0; i < 100; ++i) {
      OrbitCamera c = fitCamera(extent, kWidth, kHeight, uniform(5, 120));
      EXPECT_GE(c.target_mm.z, low);
      EXPECT_LE(c.target_mm.z, high);
      c.azimuth_deg = i == 0 ? 0 : uniform(-85, 85);
      c.elevation_deg = i == 0 ? 0 : uniform(-85, 85);
      c.orthographic = i % 2 == 1;
      c.distance_mm = fitDistance(c, extent, kWidth, kHeight);
      const ViewTransform v = viewTransform(c, d, low, high, kWidth, kHeight);
      double largest = 0;
      for (int corner = 0; corner < 8; ++corner) {
        const glm::dvec4 p =
            v.clip_from_world * glm::dvec4(corner & 1 ? 150 : -150, corner & 2 ? 85 : -85, corner & 4 ? high : low, 1);
        ASSERT_GT(p.w, 0);
        largest = std::max({largest, std::abs(p.x) / p.w, std::abs(p.y) / p.w});
      }
      EXPECT_LE(largest, 1.0 + 1e-9) << low << " to " << high;
      EXPECT_GE(largest, 0.9) << low << " to " << high;
    }
  }
  // As the plane alone: pictures of artworks whose heights are a few percent of their sides stay as they are.
  const OrbitCamera plane = fitCamera(d, kWidth, kHeight), relief = fitCamera(extentOf(d, -4, 2), kWidth, kHeight);
  EXPECT_EQ(relief.distance_mm, plane.distance_mm);
  EXPECT_EQ(relief.target_mm, plane.target_mm);
}

TEST(Camera, AnArtworksExtentHoldsItsDisplacedHeights) {
  Manifest m;
  m.domain = panel();
  EXPECT_EQ(artworkExtent(m).max_mm.z, 0);
  m.domain.relief_depth = 2;
  m.domain.relief_offset_mm = 490;
  m.domain.relief_scale_mm = 10.0 / 65535;
  for (double exaggerate : {1.0, 2.0, -1.0, 0.0}) {
    const Extent extent = artworkExtent(m, exaggerate);
    EXPECT_NEAR(extent.min_mm.z, std::min(490 * exaggerate, 500 * exaggerate), 1e-9);
    EXPECT_NEAR(extent.max_mm.z, std::max(490 * exaggerate, 500 * exaggerate), 1e-9);
    EXPECT_TRUE(extent.flat && extent.size_known);
  }
  m.size_known = false;
  EXPECT_FALSE(artworkExtent(m).size_known);
}

glm::dvec2 pixelOf(const ViewTransform& v, const glm::dvec3& p) {
  const glm::dvec4 clip = v.clip_from_world * glm::dvec4(p, 1);
  return {(clip.x / clip.w + 1) / 2 * kWidth, (1 - clip.y / clip.w) / 2 * kHeight};
}

TEST(Camera, PointUnderAPixelProjectsBackToIt) {
  for (bool orthographic : {false, true}) {
    OrbitCamera c;
    c.azimuth_deg = 30;
    c.elevation_deg = -20;
    c.distance_mm = 400;
    c.orthographic = orthographic;
    ViewTransform v = viewTransform(c, panel(), 0, 0, kWidth, kHeight);
    glm::dvec3 p;
    ASSERT_TRUE(pointOnPlane(c, kWidth, kHeight, 200.5, 610.25, &p));
    EXPECT_NEAR(p.z, 0, 1e-9);
    for (const glm::dvec3& at : {p, pointAtTarget(c, kWidth, kHeight, 200.5, 610.25)}) {
      EXPECT_NEAR(pixelOf(v, at).x, 200.5, 1e-9);
      EXPECT_NEAR(pixelOf(v, at).y, 610.25, 1e-9);
    }
  }
}

// A pixel is the distance from the target along the picture's axes over the scale: whatever the depth, and however
// distance and field of view make up the scale.
TEST(Camera, OrthographicPixelsAreMillimetresOverTheScale) {
  std::mt19937 random(kSeed);
  auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
  double perspective_off = 0;
  for (int i = 0; i < 200; ++i) {
    OrbitCamera c = randomCamera(random, true);
    const double mm_per_px = std::exp(uniform(-6, 1));
    c.distance_mm = distanceForScale(c, mm_per_px, kHeight);
    EXPECT_NEAR(mmPerPx(c, kHeight), mm_per_px, 1e-12 * mm_per_px);
    const double az = glm::radians(c.azimuth_deg), el = glm::radians(c.elevation_deg);
    const glm::dvec3 right{std::cos(az), 0, -std::sin(az)},
        back{std::sin(az) * std::cos(el), std::sin(el), std::cos(az) * std::cos(el)}, up = glm::cross(back, right);
    const glm::dvec2 mm{uniform(-600, 600) * mm_per_px, uniform(-350, 350) * mm_per_px};
    const glm::dvec2 truth{kWidth / 2.0 + mm.x / mm_per_px, kHeight / 2.0 - mm.y / mm_per_px};
    OrbitCamera other = c;
    other.fov_deg = uniform(1, 170);
    other.distance_mm = distanceForScale(other, mm_per_px, kHeight);
    for (double depth : {-40.0, 0.0, 3.0, 500.0}) {
      const glm::dvec3 p = c.target_mm + mm.x * right + mm.y * up + depth * back;
      for (const OrbitCamera& camera : {c, other}) {
        const ViewTransform v = viewTransform(camera, panel(), -1, 1, kWidth, kHeight);
        EXPECT_NEAR(v.pixels_per_radian * mm_per_px, 1, 1e-12);
        EXPECT_LT(glm::length(pixelOf(v, p) - truth), 1e-6) << "seed " << kSeed << ", round " << i;
      }
      OrbitCamera perspective = c;
      perspective.orthographic = false;
      const glm::dvec2 seen = pixelOf(viewTransform(perspective, panel(), -1, 1, kWidth, kHeight), p);
      // Who switches sees the plane through the target as it was.
      if (depth == 0) {
        EXPECT_LT(glm::length(seen - truth), 1e-6);
      }
      if (depth == 3.0) perspective_off = std::max(perspective_off, glm::length(seen - truth));
    }
  }
  EXPECT_GT(perspective_off, 1) << "control: perspective moves what lies nearer";
}

TEST(Camera, AnOrthographicPictureOfItsSizeHoldsAllAndNoMore) {
  std::mt19937 random(kSeed);
  const Extent box{{-150, -85, -20}, {150, 85, 30}, 0.1, false};
  for (int i = 0; i < 100; ++i) {
    OrbitCamera c = randomCamera(random, true);
    c.target_mm = box.centre();
    const glm::dvec2 size = orthographicSize(c, box);
    glm::dvec2 largest(0);
    for (int corner = 0; corner < 8; ++corner) {
      const glm::dvec3 p{corner & 1 ? 150 : -150, corner & 2 ? 85 : -85, corner & 4 ? 30 : -20};
      const ViewTransform v = viewTransform(c, box, kWidth, kHeight);
      largest = glm::max(largest, glm::abs(pixelOf(v, p) - glm::dvec2(kWidth, kHeight) / 2.0));
    }
    EXPECT_LT(glm::length(2.0 * largest * mmPerPx(c, kHeight) - size), 1e-9 * glm::length(size));
    c.distance_mm = fitDistance(c, box, kWidth, kHeight);
    const glm::dvec2 share = size / (mmPerPx(c, kHeight) * glm::dvec2(kWidth, kHeight));
    EXPECT_NEAR(std::max(share.x, share.y), 1 / 1.06, 1e-9) << "fitted, with its margin";
  }
}

}  // namespace camera_test
}  // namespace relievo
