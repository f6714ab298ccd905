// Several, near and coloured lights against their CPU reference in double precision, over PTMs, relief and bodies; and
// that one white light far away is what it was without them.
#include <gtest/gtest.h>

#include "src/base/srgb.h"
#include "src/engine/effects/effects.h"
#include "tests/other_bases.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace lights_gltest {

using namespace test;

// noiseSubject's artworks are 70 x 50 mm. Near lights: before the surface, aside of it, and behind it, from where the
// functions of a PTM go over from side to side.
const SceneLight kWarm{.place = {-1, 0.1, 0.35}, .intensity = 0.6, .color = {1, 0.5, 0.2}};
const SceneLight kCold{.place = {1, -0.2, 0.5}, .intensity = 0.4, .color = {0.2, 0.5, 1}};
const SceneLight kNear{.near = true, .place = {-12, 8, 11}, .intensity = 0.5, .color = {1, 0.9, 0.8}};
const SceneLight kStated{.near = true, .place = {20, -10, 30}, .intensity = 0.5, .reference_mm = 25};
const SceneLight kBehindIt{.near = true, .place = {5, 3, -20}, .intensity = 0.3, .reference_mm = 30};

glm::dvec3 vec(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

// For controls: the oracle under other lights than the engine's.
std::function<void(DenseView&)> under(std::vector<SceneLight> lights, bool falloff = true) {
  return [lights, falloff](DenseView& v) {
    v.lit = [lights, falloff](const TextureFormat& format, const double* raw, const glm::dvec3& place_mm) {
      std::vector<PlacedLight> placed;
      for (const SceneLight& light : shadedLights(lights)) {
        PlacedLight p = placedLight(light, glm::dmat3(1), glm::dvec3(0));
        if (p.near && !falloff) p.reference_mm = glm::length(p.place - place_mm);
        placed.push_back(p);
      }
      return litColour(format, raw, placed, place_mm);
    };
  };
}

TEST(Lights, AreTheirReference) {
  const struct {
    const Subject& subject;
    std::vector<SceneLight> lights;
    const char* what;
  } cases[] = {
      {noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21), {kNear, kWarm, kBehindIt, kCold}, "RGB PTM, relief"},
      {noiseSubjectOnce(700, 500, Basis::kPtmLrgb, 0, 22), {kStated, kBehindIt}, "LRGB PTM"},
      {noiseSubjectOnce(700, 500, Basis::kColour, 3, 23), {kWarm, kNear, kStated}, "lit relief"},
  };
  for (const auto& c : cases) {
    Scene scene;
    scene.lights = c.lights;
    const Views views{.views = 6, .random_light = false};
    expectEqual(compare(c.subject, scene, views), c.what);
    if (controlledWithOpenGl()) continue;
    // Controls: an oracle without falloff, one under a single of the lights, one under white ones.
    const auto differs = [&](std::function<void(DenseView&)> wrong) {
      const Totals t = compare(c.subject, scene, {.views = 1, .random_light = false, .wrong_oracle = std::move(wrong)});
      return t.max_difference > 3 && t.above_1 > 100;
    };
    EXPECT_TRUE(differs(under(c.lights, false))) << c.what;
    EXPECT_TRUE(differs(under({c.lights[0]}))) << c.what;
    std::vector<SceneLight> white = c.lights;
    for (SceneLight& light : white) light.color = {1, 1, 1};
    if (white != c.lights) {
      EXPECT_TRUE(differs(under(white))) << c.what;
    }
    EXPECT_FALSE(differs(under(c.lights))) << c.what << ": the control's own oracle";
  }
}

// A body: places and normals are known on its sphere. Lights far away turn with the camera, unless they are fixed; near
// ones stay.
TEST(Lights, OfABallFallOffFromWhereTheyAre) {
  const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  Scene scene;
  scene.error_px = 0.1;
  scene.lights = {{.near = true, .place = {40, 45, 55}, .color = {1, 0.7, 0.4}, .reference_mm = 40},
                  {.place = {-0.8, 0.2, 0.4}, .intensity = 0.5, .color = {0.3, 0.5, 1}}};
  for (const bool relight : {true, false}) {
    scene.relight = relight;
    // Once with reversed depth, where the context has it, once with conventional depth: both tell places.
    auto engine = makeEngine(ballArtwork(base, 1, 7), scene, {.reversed_depth = relight}, kWidth, kHeight);
    ASSERT_TRUE(engine);
    OrbitCamera camera = engine->camera();
    camera.azimuth_deg = 50;
    camera.elevation_deg = 20;
    engine->setCamera(camera);
    ASSERT_TRUE(engine->settle(60).ok());
    const auto pixels = engine->readPixels();
    const auto differenceOf = [&](const SceneLight& near, bool turned) {
      std::vector<PlacedLight> lights{
          placedLight(near, glm::dmat3(1), glm::dvec3(0)),
          placedLight(scene.lights[1], turned ? worldFromCamera(camera) : glm::dmat3(1), glm::dvec3(0))};
      return compareWithBall(pixels, engine->view(), kRadius, [&](const glm::dvec3& n) -> std::optional<glm::dvec3> {
        const glm::dvec3 place = kRadius * n;
        // Near a terminator a normal's last bit is many grey levels.
        for (const PlacedLight& l : lights)
          if (std::abs(glm::dot(n, l.near ? glm::normalize(l.place - place) : l.place)) < 0.03) return {};
        std::array<double, 6> raw{kAlbedo[0], kAlbedo[1], kAlbedo[2]};
        for (size_t c = 0; c < 3; ++c) raw[3 + c] = 127.5 * (n[static_cast<int>(c)] + 1);
        return glm::min(255.0 * litColour({.basis = Basis::kAlbedoNormal}, raw.data(), lights, place), 255.0);
      });
    };
    const BallDifference d = differenceOf(scene.lights[0], relight);
    EXPECT_GT(d.inside, 3000u);
    EXPECT_EQ(d.holes, 0u);
    EXPECT_LE(d.largest, 3) << "of 255; normals are bytes";
    // Controls: the light elsewhere, and the other one turned where it is fixed or fixed where it turns.
    SceneLight moved = scene.lights[0];
    moved.place[2] += 4;
    EXPECT_GT(differenceOf(moved, relight).largest, 6);
    EXPECT_GT(differenceOf(scene.lights[0], !relight).largest, 20);
  }
}

Manifest manifestOf(Basis basis) {
  Manifest m;
  m.texture.basis = basis;
  m.domain.relief_depth = 2;
  return m;
}

// One white light far away, however it is said, leaves no trace: no define, uniform, pass or plane.
TEST(Lights, OfOneWhiteLightLeaveNoTrace) {
  const Manifest m = manifestOf(Basis::kPtmRgb);
  const auto variant = [&](const Scene& scene) { return shadingSource(scene, m); };
  SceneLight off = kNear, black = kCold;
  off.intensity = 0;
  black.color = {0, 0, 0};
  for (const bool relight : {true, false}) {
    const Scene none{.light = kWarm.place, .relight = relight, .shadows = true};
    Scene one = none, with_off = none;
    one.lights = {{.place = kWarm.place}};
    with_off.lights = {off, {.place = kWarm.place}, black};
    for (const Scene& scene : {one, with_off}) {
      EXPECT_EQ(planEffects(scene, m), planEffects(none, m));
      EXPECT_EQ(variant(scene), variant(none));
      EXPECT_EQ(singleLight(scene), singleLight(none));
    }
    for (const char* trace : {"u_lights", "u_kept_depth", "basisFunctions"})
      EXPECT_EQ(variant(one).find(trace), std::string::npos) << trace;
    EXPECT_EQ(planEffects(one, m).resolve, !relight);
  }
  // What is on is there, and nothing else of it.
  Scene far, near;
  far.lights = {kWarm, off};
  near.lights = {kNear, kCold};
  EXPECT_NE(variant(far).find("u_lights"), std::string::npos);
  EXPECT_EQ(variant(far).find("basisFunctions(vec3"), std::string::npos);
  EXPECT_NE(variant(near).find("basisFunctions(vec3"), std::string::npos);
  const auto passes = [&](const Scene& scene) { return planEffects(scene, m).passes(); };
  EXPECT_EQ(passes(far), passes({}));
  EXPECT_EQ(passes(near), (std::vector<std::string>{"surface", "kept depth", "shade", "feedback"}));
  EXPECT_EQ(planEffects(near, m).texture_planes, planEffects({}, m).texture_planes);
  // Another place, colour or intensity is no other plan.
  Scene moved = near;
  moved.lights[0].place = {1, 2, 3};
  moved.lights[1].intensity = 3;
  EXPECT_EQ(planEffects(moved, m), planEffects(near, m));
  // Near lights cast shadows, too; an unlit picture has no lights.
  Scene only_near{.shadows = true};
  only_near.lights = {kNear};
  EXPECT_TRUE(planEffects(only_near, m).shadows);
  only_near.unlit = true;
  EXPECT_EQ(planEffects(only_near, manifestOf(Basis::kColour)).lights, 0);
}

TEST(Lights, ThatCannotBeShownAreNamed) {
  Scene scene;
  scene.lights = {kNear};
  EXPECT_EQ(sceneProblem(scene, manifestOf(Basis::kPtmLrgb)), "");
  EXPECT_NE(sceneProblem(scene, manifestOf(otherBases()[0])).find("test-hsh4-lrgb"), std::string::npos);
  scene.lights = {kWarm};
  EXPECT_EQ(sceneProblem(scene, manifestOf(otherBases()[0])), "");
  scene.lights.resize(5);
  EXPECT_NE(sceneProblem(scene, manifestOf(Basis::kPtmLrgb)).find("at most 4"), std::string::npos);
  scene.lights = {{.near = true, .place = {0, 0, 0}}};
  EXPECT_NE(sceneProblem(scene, manifestOf(Basis::kPtmLrgb)).find("reference_mm"), std::string::npos);
}

int largestDifference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b, size_t channel = 3) {
  int largest = 0;
  EXPECT_EQ(a.size(), b.size());
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    if (channel == 3 || i % 4 == channel) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

// Laws that hold without any reference.
TEST(Lights, AddUpInLinearLight) {
  for (const Basis basis : {Basis::kPtmRgb, Basis::kColour}) {
    if (basis == Basis::kColour && openGlEs() && !longTests()) continue;
    const Subject& subject = noiseSubjectOnce(700, 500, basis, 3, basis == Basis::kColour ? 23 : 21);
    auto engine = makeEngine(subject.artwork, {}, {}, 120, 80);
    ASSERT_TRUE(engine);
    const auto with = [&](std::vector<SceneLight> lights) {
      Scene scene;
      scene.light = kWarm.place;
      scene.lights = std::move(lights);
      return pictureOf(*engine, scene);
    };
    const auto lit = [](double intensity) { return SceneLight{.place = kWarm.place, .intensity = intensity}; };
    const auto plain = with({});
    EXPECT_EQ(with({lit(1)}), plain) << "the same bytes";
    // Two of half the intensity are one; a near light so far away that all its ways are one is a light far away.
    EXPECT_LE(largestDifference(with({lit(0.5), lit(0.25), lit(0.25)}), plain), 1);
    const glm::dvec3 far_mm = 1e6 * glm::normalize(vec(kWarm.place));
    EXPECT_LE(largestDifference(with({{.near = true, .place = {far_mm.x, far_mm.y, far_mm.z}}}), plain), 1);
    EXPECT_GT(largestDifference(with({lit(0.5), lit(0.25)}), plain), 3) << "the control";
    // Twice the intensity is a stop of --exposure.
    Scene stop;
    stop.light = kWarm.place;
    stop.effects = {{&kExposureEffect, {1, 1}}};
    EXPECT_LE(largestDifference(with({lit(2)}), pictureOf(*engine, stop)), 1);
    // Colours keep to themselves.
    const auto red = with({{.place = kWarm.place, .color = {1, 0, 0}}, {.place = kCold.place, .color = {0, 1, 0}}});
    EXPECT_LE(largestDifference(red, plain, 0), 1);
    EXPECT_GT(largestDifference(red, plain, 1), 3);
  }
}

// Lights far away cast their own shadows each: what reaches a channel is what it is under its light alone.
TEST(Lights, CastTheirOwnShadows) {
  auto engine = makeEngine(noiseSubjectOnce(700, 500, Basis::kColour, 3, 23).artwork, {.exaggerate = 8}, {}, 240, 160);
  ASSERT_TRUE(engine);
  const auto shadowed = [&](const std::array<double, 3>& light, std::vector<SceneLight> lights, bool shadows = true) {
    Scene scene{.light = light, .shadows = shadows};
    scene.exaggerate = 8;
    // Shadows draw other triangles; at this error both are the surface.
    scene.error_px = 0.2;
    scene.least_cell = 0;
    scene.lights = std::move(lights);
    return pictureOf(*engine, scene);
  };
  // The pixels, of 240 x 160, whose channels differ by more than rounding does.
  const auto others = [](const std::vector<uint8_t>& a, const std::vector<uint8_t>& b, size_t channel) {
    int count = 0;
    for (size_t i = channel; i < a.size(); i += 4) count += std::abs(a[i] - b[i]) > 1;
    return count;
  };
  const auto both = shadowed({}, {{.place = kWarm.place, .color = {1, 0, 0}},
                                  {.near = true, .place = kNear.place, .color = {0, 0, 1}},
                                  {.place = kCold.place, .color = {0, 1, 0}}});
  EXPECT_EQ(engine->plan().lights, 3);
  EXPECT_LE(others(both, shadowed(kWarm.place, {}), 0), 20);
  EXPECT_LE(others(both, shadowed(kCold.place, {}), 1), 20);
  EXPECT_LE(others(both, shadowed({}, {{.near = true, .place = kNear.place}}), 2), 20);
  // Controls: without shadows, and with those of the other light.
  EXPECT_GT(others(both, shadowed(kWarm.place, {}, false), 0), 1000);
  EXPECT_GT(others(both, shadowed(kCold.place, {}), 0), 1000);
  EXPECT_GT(others(both, shadowed({}, {{.near = true, .place = kNear.place}}, false), 2), 500);
}

// From a light that is resolved once a page to lights that are not, and back; the picture is that of an engine that was
// made for them.
TEST(Lights, ComeAndGoWhereTheLightIsFixed) {
  const Subject& subject = noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21);
  Scene fixed{.light = kWarm.place, .relight = false}, lit = fixed;
  lit.lights = {kNear, kCold};
  auto engine = makeEngine(subject.artwork, fixed, {}, 160, 100),
       other = makeEngine(subject.artwork, lit, {}, 160, 100);
  ASSERT_TRUE(engine && other);
  const auto before = pictureOf(*engine, fixed);
  EXPECT_TRUE(engine->plan().resolve);
  const auto with = pictureOf(*engine, lit);
  EXPECT_FALSE(engine->plan().resolve);
  EXPECT_EQ(with, pictureOf(*other, lit));
  EXPECT_GT(largestDifference(with, before), 3);
  EXPECT_EQ(pictureOf(*engine, fixed), before);
}

// The reference itself, where its value is known.
TEST(Lights, FallOffWithTheSquareOfTheDistance) {
  const double raw[6] = {255, 255, 255, 127.5, 127.5, 255};  // white, facing z
  const TextureFormat format{.basis = Basis::kAlbedoNormal};
  const auto linear = [&](const PlacedLight& light, const glm::dvec3& place) {
    return linearFromSrgb(litColour(format, raw, std::span(&light, 1), place).y);
  };
  const PlacedLight above{.near = true, .place = {0, 0, 10}, .color = {1, 0.25, 0}, .reference_mm = 10};
  EXPECT_NEAR(linear(above, {0, 0, 0}), 0.25, 1e-9) << "at the distance of its intensity";
  EXPECT_NEAR(linear(above, {0, 0, 5}), 1, 1e-9);
  EXPECT_NEAR(linear(above, {0, 0, -10}), 0.0625, 1e-9);
  EXPECT_NEAR(linear(above, {0, 0, 10}), 0.25e6, 1) << "as at a thousandth of that";
  // Aside by the distance: half the square, and Lambert's cosine of 45 degrees, on a display.
  const double aside = linearFromSrgb(std::pow(0.04 + 0.96 / std::sqrt(2), 1 / 2.2));
  EXPECT_NEAR(linear(above, {10, 0, 0}), 0.125 * aside, 1e-9);
  const SceneLight light{.near = true, .place = {0, 0, 10}};
  EXPECT_EQ(placedLight(light, glm::dmat3(1), {0, 4, 7}).reference_mm, 5) << "from the artwork's middle";
}

}  // namespace lights_gltest
}  // namespace relievo
