// Gloss against its reference in double precision: on a ball, whose places and normals are known, in perspective and
// orthographic pictures, and over a PTM on a relief given by a formula. The reference itself where its value is known.
#include <gtest/gtest.h>

#include <numbers>

#include "src/base/srgb.h"
#include "src/engine/effects/gloss.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/height_profile.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace gloss_gltest {

using namespace test;

const glm::dvec3 kTowards = glm::normalize(glm::dvec3(-0.4, 0.5, 0.75));

// What the ball shows at the normal n under one light far away, whose highlight is seen from `viewer`.
glm::dvec3 onBall(const Gloss& gloss, const glm::dvec3& n, const glm::dvec3& light, const glm::dvec3& viewer) {
  const double lit = std::pow(0.04 + 0.96 * std::max(glm::dot(n, light), 0.0), 1 / 2.2);
  const glm::dvec3 matt = glm::dvec3(kAlbedo[0], kAlbedo[1], kAlbedo[2]) / 255.0 * lit;
  return glm::min(255.0 * glossed(matt, glm::dvec3(highlight(gloss, n, light, viewer))), 255.0);
}

TEST(Gloss, OfABallIsItsReference) {
  const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  Scene scene{.light = {kTowards.x, kTowards.y, kTowards.z},
              .relight = false,
              .gloss = {.reflectance = 0.05, .roughness = 0.45}};
  auto engine = makeEngine(ballArtwork(base, 1, 7), scene, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  for (const bool orthographic : {false, true}) {
    if (orthographic && controlledWithOpenGl()) continue;
    OrbitCamera camera = engine->camera();
    camera.orthographic = orthographic;
    camera.azimuth_deg = 20;
    camera.fov_deg = 60;
    camera.distance_mm = 2.6 * kRadius;  // near, so that the way to the eye differs over the ball
    engine->setCamera(camera);
    const auto pixels = pictureOf(*engine, scene);
    const ViewTransform view = engine->view();
    const auto differenceOf = [&](const Gloss& gloss, bool parallel) {
      return compareWithBall(pixels, view, kRadius, [&](const glm::dvec3& n) -> std::optional<glm::dvec3> {
        const glm::dvec3 viewer = parallel ? view.world_from_camera[2] : glm::normalize(view.eye_mm - kRadius * n);
        if (std::abs(glm::dot(n, kTowards)) < 0.05)
          return {};  // near the terminator a normal's last bit is many grey levels
        return onBall(gloss, n, kTowards, viewer);
      });
    };
    const BallDifference d = differenceOf(scene.gloss, orthographic);
    EXPECT_GT(d.inside, 3000u);
    EXPECT_LE(d.largest, 5) << "of 255; normals are bytes; orthographic " << orthographic;
    std::printf("[ gloss    ] ball off by at most %.2f of 255\n", d.largest);
    // Controls: no gloss, a rougher one, and the viewer of the other projection.
    EXPECT_GT(differenceOf({}, orthographic).largest, 20);
    EXPECT_GT(differenceOf({.reflectance = 0.05, .roughness = 0.55}, orthographic).largest, 10);
    EXPECT_GT(differenceOf(scene.gloss, !orthographic).largest, 20);
  }
  if (controlledWithOpenGl()) return;
  // Two lights, of which one is near and coloured: their highlights add up.
  const SceneLight near{
      .near = true, .place = {40, 45, 75}, .intensity = 0.5, .color = {1, 0.7, 0.4}, .reference_mm = 50},
      far{.place = scene.light, .intensity = 0.5};
  scene.lights = {near, far};
  const auto pixels = pictureOf(*engine, scene);
  const ViewTransform view = engine->view();
  const bool parallel = view.orthographic;
  const std::vector<PlacedLight> placed{placedLight(far, glm::dmat3(1), glm::dvec3(0)),
                                        placedLight(near, glm::dmat3(1), glm::dvec3(0))};
  const auto with = [&](bool tinted) {
    return compareWithBall(pixels, view, kRadius, [&](const glm::dvec3& n) -> std::optional<glm::dvec3> {
      const glm::dvec3 place = kRadius * n, way = near.near ? placed[1].place - place : glm::dvec3(0);
      const glm::dvec3 towards = glm::normalize(way);
      if (std::abs(glm::dot(n, kTowards)) < 0.05 || std::abs(glm::dot(n, towards)) < 0.05) return {};
      std::array<double, 6> raw{kAlbedo[0], kAlbedo[1], kAlbedo[2]};
      for (size_t c = 0; c < 3; ++c) raw[3 + c] = 127.5 * (n[static_cast<int>(c)] + 1);
      const glm::dvec3 viewer = parallel ? view.world_from_camera[2] : glm::normalize(view.eye_mm - place);
      const double falloff = 50.0 * 50 / glm::dot(way, way);
      const glm::dvec3 highlights =
          placed[0].color * highlight(scene.gloss, n, kTowards, viewer) +
          (tinted ? placed[1].color : glm::dvec3(0.5)) * falloff * highlight(scene.gloss, n, towards, viewer);
      const glm::dvec3 matt = litColour({.basis = Basis::kAlbedoNormal}, raw.data(), placed, place);
      return glm::min(255.0 * glossed(matt, highlights), 255.0);
    });
  };
  EXPECT_LE(with(true).largest, 5);
  EXPECT_GT(with(false).largest, 10) << "the control";
}

// --- over a PTM

constexpr int64_t kSide = 64;
double waveZ(double x, double y) { return 1 + 0.5 * std::sin(0.9 * x) + 0.4 * std::cos(0.7 * y + 0.3 * x); }
glm::dvec3 waveNormal(double x, double y) {
  return glm::normalize(glm::dvec3(-0.45 * std::cos(0.9 * x) + 0.12 * std::sin(0.7 * y + 0.3 * x),
                                   0.28 * std::sin(0.7 * y + 0.3 * x), 1));
}
// The highlight is what the picture with gloss has more than the one without, in linear light.
TEST(Gloss, OverAPtmFollowsItsRelief) {
  const HeightsOfProfile heights(kSide, 2, waveZ);
  Scene scene{.light = {kTowards.x, kTowards.y, kTowards.z}, .error_px = 0.2};
  scene.least_cell = 0;
  auto engine =
      makeEngine(denseSubject(NoiseTexture(kSide, kSide, Basis::kPtmRgb, 5), &heights).artwork, scene, {}, 64, 64);
  ASSERT_TRUE(engine);
  OrbitCamera camera;
  camera.orthographic = true;  // from above: pixel and place are the same
  camera.distance_mm = distanceForScale(camera, 0.1, 64);
  engine->setCamera(camera);
  const auto matt = pictureOf(*engine, scene);
  scene.gloss = {.reflectance = 0.1, .roughness = 0.5};
  const auto glossy = pictureOf(*engine, scene);
  double sum = 0, largest = 0, of_flat = 0;
  int count = 0;
  for (int y = 3; y < 61; y += 2)
    for (int x = 3; x < 61; x += 2) {
      const size_t at = static_cast<size_t>(y * 64 + x) * 4;
      const glm::dvec3 n = waveNormal((x + 0.5 - 32) * 0.1, (32 - y - 0.5) * 0.1);
      for (size_t c = 0; c < 3; ++c) {
        if (glossy[at + c] == 255 || matt[at + c] == 0) continue;  // cut off
        const auto expected = [&](const glm::dvec3& normal) {
          return 255 * glossed(glm::dvec3(matt[at + c] / 255.0),
                               glm::dvec3(highlight(scene.gloss, normal, kTowards, {0, 0, 1})))
                           .x;
        };
        sum += std::abs(glossy[at + c] - expected(n));
        largest = std::max(largest, std::abs(glossy[at + c] - expected(n)));
        of_flat += std::abs(glossy[at + c] - expected({0, 0, 1}));
        ++count;
      }
    }
  std::printf("[ gloss    ] PTM off by %.2f of 255, at most %.2f, of %d\n", sum / count, largest, count);
  EXPECT_GT(count, 1000);
  EXPECT_LE(sum / count, 1);
  EXPECT_LE(largest, 5);
  EXPECT_GT(of_flat / count, 8) << "the control: a flat normal";
  // Where no light arrives there is no highlight: another light's shadow leaves its own alone.
  scene.light = {-1, 0.1, 0.15};
  scene.shadows = true;
  scene.exaggerate = 2;
  const auto shiny = pictureOf(*engine, scene);
  scene.gloss = {};
  const auto dull = pictureOf(*engine, scene);
  scene.shadows = false;
  const auto lit = pictureOf(*engine, scene);
  int dark = 0, changed = 0, elsewhere = 0;
  for (size_t i = 0; i < lit.size(); i += 4) {
    const double share = linearFromSrgb(dull[i] / 255.0) / std::max(linearFromSrgb(lit[i] / 255.0), 1e-3);
    if (lit[i] < 40) continue;
    dark += share < 0.1;
    changed += share < 0.1 && std::abs(shiny[i] - dull[i]) > 1;
    elsewhere += share > 0.9 && std::abs(shiny[i] - dull[i]) > 1;
  }
  EXPECT_GT(dark, 20);
  EXPECT_EQ(changed, 0) << "of " << dark;
  EXPECT_GT(elsewhere, 40);
}

TEST(Gloss, ThatIsOffLeavesNoTrace) {
  Manifest m;
  m.texture.basis = Basis::kPtmLrgb;
  m.domain.relief_depth = 2;
  Scene off, on, fixed{.relight = false};
  off.gloss.roughness = 0.7;
  on.gloss.reflectance = fixed.gloss.reflectance = 0.04;
  EXPECT_EQ(planEffects(off, m), planEffects({}, m));
  EXPECT_EQ(shadingSource(off, m), shadingSource({}, m));
  EXPECT_EQ(shadingSource({}, m).find("u_gloss"), std::string::npos);
  EXPECT_NE(shadingSource(on, m).find("u_gloss"), std::string::npos);
  EXPECT_EQ(planEffects(on, m).passes(), (std::vector<std::string>{"surface", "kept depth", "shade", "feedback"}));
  EXPECT_EQ(planEffects(on, m).planesRead(), planEffects({}, m).planesRead());
  EXPECT_FALSE(planEffects(fixed, m).resolve) << "the viewer counts, and is no page's";
  // Without light, or over a PTM without relief, there is none.
  on.relief = false;
  EXPECT_FALSE(planEffects(on, m).gloss);
  m.texture.basis = Basis::kColour;
  EXPECT_FALSE(planEffects({.unlit = true, .gloss = on.gloss}, m).gloss);
  EXPECT_TRUE(planEffects({.gloss = on.gloss}, m).gloss);
}

// The reference: known values, light and viewer exchanged, and no more light than arrives.
TEST(Gloss, IsALobeOfWhatArrives) {
  const glm::dvec3 n(0, 0, 1), l = glm::normalize(glm::dvec3(0.5, 0.2, 0.7)),
                               v = glm::normalize(glm::dvec3(-0.6, 0.1, 0.4));
  for (const double roughness : {0.3, 0.6, 1.0}) {
    const Gloss gloss{.reflectance = 0.04, .roughness = roughness};
    EXPECT_NEAR(highlight(gloss, n, n, n), 0.04 / (4 * std::pow(roughness, 4)), 1e-12) << "straight ahead";
    EXPECT_NEAR(highlight(gloss, n, l, v) / l.z, highlight(gloss, n, v, l) / v.z, 1e-12) << "reciprocal";
    EXPECT_EQ(highlight(gloss, n, -n, n), 0);
    // A surface that reflects all: over all lights of the hemisphere, each of radiance 1, at most 1, and nearly 1
    // where it is smooth (Walter et al.: what is lost bounces more than once).
    const Gloss mirror{.reflectance = 1, .roughness = roughness};
    double sum = 0;
    constexpr int kSteps = 400;
    for (int i = 0; i < kSteps; ++i)
      for (int j = 0; j < kSteps; ++j) {
        const double z = (i + 0.5) / kSteps, turn = 2 * std::numbers::pi * (j + 0.5) / kSteps, r = std::sqrt(1 - z * z);
        sum += highlight(mirror, n, {r * std::cos(turn), r * std::sin(turn), z}, v);
      }
    // pi of the highlight is that of the light, 2 pi the hemisphere.
    const double share = 2 * sum / (kSteps * kSteps);
    EXPECT_LE(share, 1.005) << roughness;
    EXPECT_GT(share, roughness < 0.5 ? 0.97 : 0.4) << roughness;
  }
}

}  // namespace gloss_gltest
}  // namespace relievo
