// Effects on pixels against their CPU references: every effect that has one, over plain colour and over a PTM whose
// colours lie below black and above white, in many views. An effect that is off leaves no trace.
#include <gtest/gtest.h>

#include "src/engine/effects/effects.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace effects_gltest {

using namespace test;

// Values within the parameters' ranges, away from those at which nothing changes; the same ones at every run.
std::vector<PixelEffect::Values> someValues(const PixelEffect& effect, int count) {
  std::mt19937 random(kSeed);
  std::vector<PixelEffect::Values> all;
  for (int i = 0; i < count; ++i) {
    PixelEffect::Values values = effect.neutral();
    for (size_t k = 0; k < values.size(); ++k) {
      const EffectParameter& p = effect.parameters[k];
      // The middle of the range: at its ends pictures are all black or white, and say nothing.
      if (!p.name.empty())
        values[k] = uniform(random, p.neutral + (p.low - p.neutral) / 8, p.neutral + (p.high - p.neutral) / 8);
    }
    all.push_back(values);
  }
  return all;
}

// Noise as a PTM of twice the contrast.
Subject strongSubject(uint32_t seed) {
  NoiseHeight heights(700, 500, 3, seed + 100);
  TextureFormat format = NoiseTexture(1, 1, Basis::kPtmRgb, seed).format();
  for (double& scale : format.scale) scale *= 2;
  return denseSubject(FormattedNoise(700, 500, format, seed), &heights);
}

TEST(Effects, AreTheirReferences) {
  for (const Subject& subject : {strongSubject(11), noiseSubject(700, 500, Basis::kColour, 3, 11)}) {
    for (const PixelEffect* effect : pixelEffects()) {
      if (effect->reference == nullptr) continue;
      for (const PixelEffect::Values& values : someValues(*effect, test::esShare(4))) {
        Scene scene;
        scene.effects = {{effect, values}};
        expectEqual(compare(subject, scene, {.views = 6}), std::string(effect->name).c_str());
        // Control: without the effect the picture is another one.
        const Totals other = compare(subject, scene, {.views = 2, .wrong_oracle = [](DenseView& v) { v.tone = {}; }});
        EXPECT_GT(other.max_difference, 3);
      }
    }
  }
}

TEST(Effects, OffMeansNoTraceInTheShader) {
  const Subject subject = noiseSubject(300, 200, Basis::kPtmRgb, 0, 12);
  const auto variant = [&](const Scene& scene) { return shadingSource(scene, subject.artwork.manifest); };
  Scene off;
  for (const PixelEffect* effect : pixelEffects())
    if (effect->stage == PixelEffect::Stage::kTone) off.effects.push_back({effect, effect->neutral()});
  EXPECT_EQ(variant(off), variant({}));
  EXPECT_EQ(variant(off).find("effect_"), std::string::npos);
  EXPECT_EQ(planEffects(off, subject.artwork.manifest), planEffects({}, subject.artwork.manifest));
  for (const PixelEffect* effect : pixelEffects()) {
    Scene on;
    if (effect->stage == PixelEffect::Stage::kOverlay) on.overlay = effect;
    else on.effects = {{effect, someValues(*effect, 1)[0]}};
    EXPECT_NE(variant(on).find("vec3 effect_" + std::string(effect->name) + "("), std::string::npos) << effect->name;
  }
}

// The values at which an effect is off are those at which its reference changes nothing.
TEST(Effects, NeutralValuesChangeNothing) {
  const auto change = [](const PixelEffect& effect, const PixelEffect::Values& values) {
    double largest = 0;
    for (double colour : {0.0, 0.003, 0.02, 0.2, 0.5, 0.9, 1.0, 1.7}) {
      const glm::dvec3 from(colour, 0.5 * colour, std::min(1.0, 2 * colour)), to = effect.reference(from, values);
      for (int c = 0; c < 3; ++c) largest = std::max(largest, std::abs(to[c] - from[c]));
    }
    return largest;
  };
  for (const PixelEffect* effect : pixelEffects()) {
    if (effect->stage != PixelEffect::Stage::kTone) continue;
    EXPECT_LT(change(*effect, effect->neutral()), 1e-9) << effect->name;
    EXPECT_GT(change(*effect, someValues(*effect, 1)[0]), 1e-3) << effect->name << ", which does something elsewhere";
  }
}

// Control: effects are compared beyond white, too. A reference that starts from clamped colours is another one.
TEST(Effects, StartFromColoursBeyondWhite) {
  Scene scene;
  scene.effects = {{&kExposureEffect, {-2, 4}}};
  const Totals clamped = compare(strongSubject(11), scene, {.views = 2, .wrong_oracle = [](DenseView& v) {
                                                              v.tone = [tone = v.tone](const glm::dvec3& colour) {
                                                                return tone(glm::min(colour, 1.0));
                                                              };
                                                            }});
  EXPECT_GT(clamped.max_difference, 3);
}

// A number that changes costs a uniform, not a program.
TEST(Effects, AnotherValueIsNoOtherPlan) {
  const Subject subject = noiseSubject(300, 200, Basis::kColour, 0, 13);
  Scene one, two;
  one.effects = {{&kExposureEffect, {1, 1}}};
  two.effects = {{&kExposureEffect, {-2, 4}}};
  EXPECT_EQ(planEffects(one, subject.artwork.manifest), planEffects(two, subject.artwork.manifest));
  auto engine = Engine::create(subject.artwork, one, {});
  ASSERT_TRUE(engine.ok());
  auto mean = [&](const Scene& scene) {
    EXPECT_TRUE((*engine)->setScene(scene).ok());
    EXPECT_TRUE((*engine)->settle(60).ok());
    double sum = 0;
    for (uint8_t byte : (*engine)->readPixels()) sum += byte;
    return sum;
  };
  const double bright = mean(one);
  EXPECT_LT(mean(two), 0.8 * bright);
  EXPECT_EQ(mean(one), bright);
}

// The reference itself, where its value is known.
TEST(Effects, ExposureKeepsBlackAndDoublesLight) {
  const auto reference = kExposureEffect.reference;
  EXPECT_NEAR(reference({0, 0, 0}, {5, 1})[0], 0, 1e-12);
  for (double colour : {0.01, 0.2, 0.7, 1.0, 1.7})
    EXPECT_NEAR(reference({colour, colour, colour}, kExposureEffect.neutral())[1], colour, 1e-12);
  // sRGB 0.5 is 0.21404 of the light; twice that is 0.68584 again (IEC 61966-2-1).
  EXPECT_NEAR(reference({0.5, 0.5, 0.5}, {1, 1})[2], 0.68584, 1e-5);
  // What is as bright as the white level becomes white: of 3 stops more, at 8.
  EXPECT_NEAR(reference({1, 1, 1}, {3, 8})[0], 1, 1e-12);
}

}  // namespace effects_gltest
}  // namespace relievo
