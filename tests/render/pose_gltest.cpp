// Pictures of a posed artwork. Two oracles: the picture of the same artwork without a pose, through the camera and
// under the lights that are moved the other way; and the outline of a plane, whose corners are projected in double
// precision.
#include <gtest/gtest.h>

#include "tests/render/dense_subjects.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"
#include "tests/render/pose_fixture.h"

namespace relievo {
namespace pose_gltest {

using namespace test;

const SceneLight kFar{.place = {-1, 0.1, 0.35}, .intensity = 0.6, .color = {1, 0.5, 0.2}};
const SceneLight kNear{.near = true, .place = {-12, 8, 31}, .intensity = 0.9, .color = {1, 0.9, 0.8}};
const SceneLight kStated{.near = true, .place = {40, 45, 55}, .intensity = 0.7, .reference_mm = 50};

struct Case {
  const char* what;
  const Artwork& artwork;
  bool scan = false;
  Scene scene;
};

// Where the lights are the artwork's own.
std::vector<Case> cases(const Artwork& ball) {
  const Artwork &ptm = noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21).artwork,
                &colour = noiseSubjectOnce(700, 500, Basis::kColour, 3, 23).artwork;
  std::vector<Case> all{
      {"a PTM, far light", ptm, false, {.light = {-0.7, 0.3, 0.5}}},
      {"a PTM, fixed light", ptm, false, {.light = {-0.7, 0.3, 0.5}, .relight = false}},
      {"a PTM, several lights", ptm, false, {.lights = {kFar, kNear}}},
      {"lit relief, shadows", colour, false, {.light = {-0.7, 0.3, 0.3}, .shadows = true, .exaggerate = 3}},
      {"lit relief, near shadows, gloss",
       colour,
       false,
       {.lights = {kNear}, .shadows = true, .gloss = {.reflectance = 0.1}, .exaggerate = 3}},
      {"lit relief, its depth", colour, false, {.shading = {.kind = ReliefShading::Kind::kDepth}}},
      {"a scan, a light that turns with the camera", ball, true, {.light = {-0.5, 0.4, 0.6}, .shadows = true}},
      {"a scan, fixed and near lights", ball, true, {.lights = {kFar, kStated}, .relight = false}},
      {"a scan, its slope", ball, true, {.shading = {.kind = ReliefShading::Kind::kSlope}}}};
  for (Case& c : all) {
    c.scene.error_px = 0.2;
    c.scene.least_cell = 0;
  }
  return all;
}

Artwork ballOnce() {
  static const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  return ballArtwork(base, 1, 7);
}

TEST(PosedPictures, AreThoseThroughTheMovedCamera) {
  const Artwork ball = ballOnce();
  int index = 0;
  for (const Case& c : cases(ball)) {
    for (const bool orthographic : {false, true}) {
      if (openGlEs() && !longTests() && (orthographic != (index % 2 == 0))) continue;
      SCOPED_TRACE(std::string(c.what) + (orthographic ? ", orthographic" : ", perspective"));
      auto engine = makeEngine(c.artwork, c.scene, {.reversed_depth = index % 3 != 0}, kWidth, kHeight);
      ASSERT_TRUE(engine);
      OrbitCamera own = engine->camera();
      own.orthographic = orthographic;
      own.azimuth_deg = 20;
      own.elevation_deg = -15;
      own.distance_mm *= 0.8;
      own.target_mm += glm::dvec3(3, -2, 1);
      const Counter counter(own, 130, 40, {250, -40, 77});
      engine->setCamera(own);
      const auto expected = pictureOf(*engine, c.scene);
      const auto place = engine->surfacePoint(0.4 * kWidth, 0.5 * kHeight);
      engine->setCamera(counter.world);
      const bool turns = c.scan && c.scene.relight;
      const Scene posed = counter.inWorld(c.scene, turns);
      const PictureDifference d = differenceOf(pictureOf(*engine, posed), expected);
      EXPECT_GT(d.pixels, 10000);
      EXPECT_LE(d.different, 20) << "pixels of " << d.pixels << " differ by more than 1/255";
      const auto moved = engine->surfacePoint(0.4 * kWidth, 0.5 * kHeight);
      ASSERT_TRUE(place && moved);
      EXPECT_LT(glm::length(*moved - (counter.turn * *place + counter.moved)), 0.01) << "mm";
      // Controls: no pose, one that turns the other way, one that moves elsewhere.
      Scene wrong = posed;
      const auto differs = [&] { return differenceOf(pictureOf(*engine, wrong), expected).different > 2000; };
      wrong.pose = {};
      EXPECT_TRUE(differs());
      if (!c.scan || c.scene.shading.isOn()) {  // else a ball looks the same however it is turned
        wrong.pose = {posed.pose.position_mm, anglesOf(glm::transpose(counter.turn))};
        EXPECT_TRUE(differs());
      }
      wrong.pose = posed.pose;
      wrong.pose.position_mm[1] += 5;
      EXPECT_TRUE(differs());
      // Lights stay where they are while the artwork turns under them.
      if (!turns && !c.scene.shading.isOn()) {
        wrong = c.scene;
        wrong.pose = posed.pose;
        EXPECT_TRUE(differs()) << "the control with the artwork's own lights";
      }
    }
    ++index;
  }
}

// The outline of a flat artwork without relief: pixels well within the quadrilateral of its projected corners show it,
// and those well outside do not.
TEST(PosedPictures, ShowAPlaneWhereItsCornersProjectTo) {
  const Subject& plane = noiseSubjectOnce(700, 500, Basis::kPtmLrgb, 0, 22);  // 70 x 50 mm
  for (const bool orthographic : {false, true}) {
    auto engine = makeEngine(plane.artwork, {}, {}, kWidth, kHeight);
    ASSERT_TRUE(engine);
    OrbitCamera camera = engine->camera();
    camera.orthographic = orthographic;
    camera.azimuth_deg = -35;
    camera.elevation_deg = 25;
    camera.target_mm = {100, 50, -20};
    engine->setCamera(camera);
    Scene scene;
    scene.pose = {{103, 47, -18}, {-30, 20, 65}};
    const auto picture = pictureOf(*engine, scene);
    const auto wrongUnder = [&](const glm::dmat3& turn, int& judged) {
      std::array<glm::dvec2, 4> corners;
      const glm::dvec3 own[] = {{-35, -25, 0}, {35, -25, 0}, {35, 25, 0}, {-35, 25, 0}};
      for (size_t i = 0; i < 4; ++i)
        corners[i] = glm::dvec2(pixelOf(camera, turn * own[i] + glm::dvec3(103, 47, -18), kWidth, kHeight));
      int wrong = 0;
      judged = 0;
      for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x) {
          double low = 1e9, high = -1e9;  // signed distances from the sides
          for (size_t i = 0; i < 4; ++i) {
            const glm::dvec2 side = glm::normalize(corners[(i + 1) % 4] - corners[i]),
                             to = glm::dvec2(x + 0.5, y + 0.5) - corners[i];
            const double distance = side.x * to.y - side.y * to.x;
            low = std::min(low, distance);
            high = std::max(high, distance);
          }
          const bool inside = low > 0.02 || high < -0.02, near = !inside && (low > -0.02 || high < 0.02);
          if (near) continue;
          ++judged;
          wrong += (picture[static_cast<size_t>(y * kWidth + x) * 4 + 3] != 0) != inside;
        }
      return wrong;
    };
    const auto about = [](int axis, double degrees) {
      const double c = std::cos(radiansOf(degrees)), s = std::sin(radiansOf(degrees));
      return axis == 0   ? rowsOf({1, 0, 0}, {0, c, -s}, {0, s, c})
             : axis == 1 ? rowsOf({c, 0, s}, {0, 1, 0}, {-s, 0, c})
                         : rowsOf({c, -s, 0}, {s, c, 0}, {0, 0, 1});
    };
    int judged = 0;
    EXPECT_EQ(wrongUnder(about(2, 65) * about(1, 20) * about(0, -30), judged), 0) << "of " << judged;
    EXPECT_GT(judged, kWidth * kHeight - 200);
    EXPECT_GT(wrongUnder(about(0, -30) * about(1, 20) * about(2, 65), judged), 500) << "the control: z first";
  }
}

// Without a pose nothing is said to the GPU that was not before: the same plan, shader and bytes.
TEST(PosedPictures, WithoutAPoseAreAsTheyWere) {
  const Subject& subject = noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21);
  Scene none, posed;
  posed.pose = {{1, 2, 3}, {4, 5, 6}};
  EXPECT_EQ(planEffects(none, subject.artwork.manifest), planEffects(posed, subject.artwork.manifest));
  EXPECT_EQ(shadingSource(none, subject.artwork.manifest), shadingSource(posed, subject.artwork.manifest));
  auto engine = makeEngine(subject.artwork, none, {}, 160, 100);
  ASSERT_TRUE(engine);
  const auto before = pictureOf(*engine, none);
  EXPECT_NE(pictureOf(*engine, posed), before) << "the control";
  EXPECT_EQ(pictureOf(*engine, none), before);
  Scene whole_turns;
  whole_turns.pose.rotate_deg = {360, -720, 0};
  EXPECT_EQ(pictureOf(*engine, whole_turns), before) << "whole turns are exact";
}

}  // namespace pose_gltest
}  // namespace relievo
