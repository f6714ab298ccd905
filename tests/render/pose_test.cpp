// Poses by themselves: the angles are those of build --rotate, the motion is rigid, and a view of a posed artwork is
// the world's view of its places.
#include <gtest/gtest.h>

#include <random>

#include "geometry/scan/mesh_read.h"
#include "src/engine/eye_guard.h"
#include "tests/render/pose_fixture.h"

namespace relievo {
namespace pose_test {

using namespace test;

constexpr int kWidth = 640, kHeight = 400;

double largestPart(const glm::dmat3& m) {
  double largest = 0;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) largest = std::max(largest, std::abs(m[c][r]));
  return largest;
}

struct Dice {
  std::mt19937 random{11};
  double operator()(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); }
};

Pose somePose(Dice& dice) {
  return {{dice(-90, 90), dice(-90, 90), dice(-90, 90)}, {dice(-400, 400), dice(-400, 400), dice(-400, 400)}};
}

TEST(Poses, TurnAsScansAreTurned) {
  Dice dice;
  for (int i = 0; i < 200; ++i) {
    const Pose pose = somePose(dice);
    const auto& a = pose.rotate_deg;
    EXPECT_LT(largestPart(worldFromArtwork(pose) - turnOf('y', {a[0], a[1], a[2]})), 1e-12);
    if (i > 0) {
      EXPECT_GT(largestPart(worldFromArtwork(pose) - turnOf('y', {a[2], a[1], a[0]})), 1e-3) << "the control";
    }
  }
  for (int i = 0; i < 64; ++i) {
    const glm::dvec3 quarters(90 * (i % 4), -90 * (i / 4 % 4), 90 * (i / 16));
    const Pose pose{{}, {quarters.x, quarters.y, quarters.z}};
    EXPECT_EQ(worldFromArtwork(pose), turnOf('y', quarters)) << "multiples of 90 degrees are exact";
  }
  // Where this is known: x first.
  const glm::dvec3 moved = placeInWorld({{1, 2, 3}, {90, 0, 90}}, {0, 1, 0});
  EXPECT_EQ(moved, glm::dvec3(1, 2, 4)) << "y goes to z, which stays";
}

TEST(Poses, AreRigidAndComeBack) {
  Dice dice;
  for (int i = 0; i < 200; ++i) {
    const Pose pose = somePose(dice);
    const glm::dmat3 turn = worldFromArtwork(pose);
    EXPECT_LT(largestPart(turn * artworkFromWorld(pose) - glm::dmat3(1)), 1e-14);
    EXPECT_NEAR(glm::determinant(turn), 1, 1e-14);
    const glm::dvec3 place(dice(-50, 50), dice(-50, 50), dice(-50, 50));
    EXPECT_LT(glm::length(placeInArtwork(pose, placeInWorld(pose, place)) - place), 1e-12);
  }
  const glm::dvec3 place(0.1, -1.0 / 3, 1e9 / 7);
  EXPECT_EQ(placeInWorld({}, place), place);
  EXPECT_EQ(placeInArtwork({}, place), place);
}

OrbitCamera someCamera(Dice& dice, bool orthographic) {
  OrbitCamera c;
  c.azimuth_deg = dice(-180, 180);
  c.elevation_deg = dice(-80, 80);
  c.distance_mm = dice(150, 900);
  c.fov_deg = dice(20, 60);
  c.orthographic = orthographic;
  c.target_mm = {dice(-20, 20), dice(-20, 20), dice(-20, 20)};
  return c;
}

Extent boxOf(Dice& dice) {
  return {{-dice(5, 30), -dice(5, 30), -dice(1, 9)}, {dice(5, 30), dice(5, 30), dice(1, 9)}, 0.1, false};
}

TEST(Poses, ShowTheArtworksPlacesWhereTheyStand) {
  Dice dice;
  double ignored = 0, turned_back = 0;
  for (int i = 0; i < 200; ++i) {
    const PlacedExtent placed{boxOf(dice), somePose(dice)};
    const OrbitCamera camera = someCamera(dice, i % 2 == 0);
    const glm::dvec3 place(dice(-5, 5), dice(-5, 5), dice(-1, 1));
    const auto pixelThrough = [&](const ViewTransform& view) {
      const glm::dvec4 clip = view.clip_from_world * glm::dvec4(place, 1);
      return glm::dvec2((clip.x / clip.w + 1) / 2 * kWidth, (1 - clip.y / clip.w) / 2 * kHeight);
    };
    const glm::dvec3 expected = pixelOf(camera, placeInWorld(placed.pose, place), kWidth, kHeight);
    if (expected.z < 1 && !camera.orthographic) continue;  // behind the eye
    const auto off = [&](const PlacedExtent& as) {
      return glm::length(pixelThrough(viewTransform(camera, as, kWidth, kHeight)) - glm::dvec2(expected));
    };
    EXPECT_LT(off(placed), 1e-6) << "px";
    ignored += off({placed.extent, {}}) < 5;
    Pose other = placed.pose;
    other.rotate_deg = anglesOf(artworkFromWorld(placed.pose));
    turned_back += off({placed.extent, other}) < 0.1;
  }
  EXPECT_LT(ignored, 5) << "the control without a pose";
  EXPECT_LT(turned_back, 5) << "the control that turns the other way";
}

TEST(Poses, AreWithinTheFittedView) {
  Dice dice;
  for (int i = 0; i < 100; ++i) {
    const std::vector<PlacedExtent> placed{{boxOf(dice), somePose(dice)}, {boxOf(dice), somePose(dice)}};
    for (size_t count : {size_t{1}, size_t{2}}) {
      const auto some = std::span(placed).first(count);
      OrbitCamera camera = someCamera(dice, i % 2 == 0);
      const OrbitCamera straight = fitCamera(some, kWidth, kHeight);
      camera.target_mm = straight.target_mm;
      camera.distance_mm = fitDistance(camera, some, kWidth, kHeight);
      const Extent all = worldExtent(some);
      double widest = 0;
      for (const PlacedExtent& one : some)
        for (int corner = 0; corner < 8; ++corner) {
          const glm::dvec3 &low = one.extent.min_mm, &high = one.extent.max_mm;
          const glm::dvec3 place = placeInWorld(
              one.pose, {corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y, corner & 4 ? high.z : low.z});
          const glm::dvec3 p = pixelOf(camera, place, kWidth, kHeight);
          widest = std::max({widest, std::abs(p.x / kWidth * 2 - 1), std::abs(p.y / kHeight * 2 - 1)});
          EXPECT_TRUE(glm::all(glm::greaterThanEqual(place, all.min_mm - 1e-9)) &&
                      glm::all(glm::lessThanEqual(place, all.max_mm + 1e-9)));
        }
      EXPECT_LE(widest, 1);
      EXPECT_GT(widest, 0.9);
    }
  }
  // Without poses all is as it is without any.
  const Extent box = boxOf(dice);
  const PlacedExtent alone{box, {}};
  EXPECT_EQ(fitCamera(std::span(&alone, 1), kWidth, kHeight), fitCamera(box, kWidth, kHeight));
}

// Of a plane of 70 x 50 mm that is turned: from both sides at most the distance, and not much less.
TEST(Poses, KeepTheEyeOutsideOfWhatStandsThere) {
  Artwork plane;
  FlatDomain domain;
  domain.width_px = 700;
  domain.height_px = 500;
  domain.mm_per_px = 0.1;
  domain.texture_depth = FlatDomain::depthFor(700, 500);
  plane.manifest.domain = domain;
  Dice dice;
  const PlacedExtent placed{artworkExtent(plane.manifest), {{30, -20, 10}, {20, 150, -40}}};
  const auto guard = placedGuard(makeEyeGuard(plane, 1, 1), placed);
  const auto turned_only_in_name = placedGuard(makeEyeGuard(plane, 1, 1), {placed.extent, {{30, -20, 10}, {}}});
  int negative = 0;
  for (int i = 0; i < 500; ++i) {
    const glm::dvec3 own(dice(-80, 80), dice(-60, 60), dice(-60, 60));
    const glm::dvec3 beside(std::max(std::abs(own.x) - 35, 0.0), std::max(std::abs(own.y) - 25, 0.0), own.z);
    const double distance = guard->distance(placeInWorld(placed.pose, own));
    EXPECT_LE(distance, glm::length(beside) + 1e-9);
    EXPECT_GT(distance, 0.5 * glm::length(beside));
    negative += turned_only_in_name->distance(own + glm::dvec3(30, -20, 10)) < 0;
  }
  EXPECT_GT(negative, 20) << "one that is not turned has nothing behind it";
  // Of several the nearest counts.
  const PlacedExtent other{placed.extent, {{-40, 10, 60}, {0, 40, 0}}};
  std::vector<std::unique_ptr<const EyeGuard>> guards;
  for (const PlacedExtent& one : {placed, other}) guards.push_back(placedGuard(makeEyeGuard(plane, 1, 1), one));
  const auto second = placedGuard(makeEyeGuard(plane, 1, 1), other), both = guardOfAll(std::move(guards));
  for (int i = 0; i < 100; ++i) {
    const glm::dvec3 place(dice(-80, 80), dice(-60, 60), dice(-60, 60));
    EXPECT_EQ(both->distance(place), std::min(guard->distance(place), second->distance(place)));
  }
}

}  // namespace pose_test
}  // namespace relievo
