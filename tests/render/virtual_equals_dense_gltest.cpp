// Virtual equals dense: with everything resident, the engine's frame equals the frame that the oracle
// (dense_reference.h) draws from plain dense textures in double precision, within 1/255, inside the silhouette. Random
// views, seeds printed. Negative controls: pages without borders, and an oracle that is wrong by a little.
#include "src/engine/fault_injection.h"
#include "tests/render/dense_subjects.h"
#include "tests/view_share.h"

namespace relievo {
namespace virtual_equals_dense_gltest {

using namespace test;

TEST(VirtualEqualsDense, ReliefOfEveryBasis) {
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kColour})
    expectEqual(compare(noiseSubjectOnce(1501, 1103, basis, 12, 7), {}, {.views = 8}), basisName(basis));
}

// Colour lit by the normals of its relief, where the relief is as fine as the colour, finer and coarser, and where
// heights are multiplied.
TEST(VirtualEqualsDense, ColourLitByItsRelief) {
  const Subject same = noiseSubject(1101, 600, Basis::kColour, 12, 21);
  NoiseHeight finer(2202, 1200, 12, 22), coarser(300, 164, 12, 23);
  const Subject on_finer = denseSubject(NoiseTexture(1101, 600, Basis::kColour, 22), &finer, 1),
                on_coarser = denseSubject(NoiseTexture(1101, 600, Basis::kColour, 23), &coarser, -2);
  const Subject strip = noiseSubject(150, 1300, Basis::kColour, 6, 24);
  expectEqual(compare(same, {}, {.views = 6}), "as fine");
  expectEqual(compare(same, {.exaggerate = -2}, {.views = 4}), "exaggerated, mirrored");
  expectEqual(compare(same, {.relight = false}, {.views = 4}), "fixed light");
  expectEqual(compare(same, {.sampling = Sampling::kAnisotropic}, {.views = 3}), "anisotropic");
  expectEqual(compare(on_finer, {}, {.views = 4}), "finer");
  expectEqual(compare(on_coarser, {}, {.views = 6}), "coarser");
  expectEqual(compare(strip, {}, {.views = 6}), "over patches of a strip");
  expectEqual(compare(same, {.unlit = true}, {.views = 4}), "unlit");
  Views run{.views = 3};
  run.wrong_oracle = [](DenseView& v) { v.light[0] += 0.05; };
  EXPECT_GT(compare(same, {}, run).above_1, 100u) << "control";
}

TEST(VirtualEqualsDense, WithoutRelief) {
  Scene scene;
  scene.relief = false;
  expectEqual(compare(noiseSubject(3001, 700, Basis::kPtmLrgb, 0, 8), scene, {.views = 12}), "flat strip");
  expectEqual(compare(noiseSubject(300, 1700, Basis::kColour, 0, 9), scene, {.views = 8}), "flat, upright strip");
}

TEST(VirtualEqualsDense, FixedLightAndNearestLevel) {
  const Subject subject = noiseSubject(1300, 1000, Basis::kPtmLrgb, 10, 10);
  Scene scene;
  scene.relight = false;
  expectEqual(compare(subject, scene, {.views = 8}), "resolved pages");
  scene.relight = true;
  scene.sampling = Sampling::kBilinear;
  expectEqual(compare(subject, scene, {.views = 8}), "nearest level");
  scene.sampling = Sampling::kTrilinear;
  scene.exaggerate = 2.5;
  expectEqual(compare(subject, scene, {.views = 8}), "exaggerated relief");
}

TEST(VirtualEqualsDense, LightsFromAllAround) {
  const Subject subject = noiseSubject(700, 500, Basis::kPtmLrgb, 5, 13);
  for (bool relight : {true, false}) {
    for (const std::array<double, 3>& light :
         {std::array{0.1, 0.0, -1.0}, {0.0, 0.0, -1.0}, {-0.7, 0.5, -0.2}, {0.3, 1.0, 0.0}}) {
      Scene scene;
      scene.relight = relight;
      scene.light = light;
      Views run{.views = 2};
      run.random_light = false;
      expectEqual(compare(subject, scene, run), relight ? "live light from behind" : "fixed light from behind");
      if (light[2] > -0.1) continue;
      run.wrong_oracle = [](DenseView& v) { v.light[2] = -v.light[2]; };
      EXPECT_GT(compare(subject, scene, run).above_1, 100u) << "control";
    }
  }
}

TEST(VirtualEqualsDense, FromOneTexel) {
  for (auto [w, h] :
       {std::pair<int64_t, int64_t>{1, 1}, {2, 1}, {1, 3}, {5, 127}, {128, 128}, {129, 128}, {257, 255}, {1, 1000}}) {
    char name[64];
    std::snprintf(name, sizeof name, "%d x %d", int(w), int(h));
    const Subject subject = noiseSubject(w, h, Basis::kPtmLrgb, 0.02 * double(std::min(w, h)), 11);
    Views views{.views = 6, .width = 160, .height = 90};
    views.camera = [&](std::mt19937& random) { return nearCamera(random, subject.texture->domain, 90, -5, 1); };
    expectEqual(compare(subject, {}, views), name);
  }
}

TEST(VirtualEqualsDense, ToTwoToThe24Texels) {
  for (auto [w, h] :
       {std::pair<int64_t, int64_t>{65536, 65536 - 512}, {1 << 20, 1 << 20}, {1 << 24, 1 << 24}, {1 << 22, 1 << 14}}) {
    char name[64];
    std::snprintf(name, sizeof name, "%lld x %lld", static_cast<long long>(w), static_cast<long long>(h));
    const Subject subject = periodicSubject(w, h, Basis::kPtmLrgb);
    Views run{.views = 8};
    run.camera = [&, n = 0](std::mt19937& random) mutable {
      OrbitCamera c = nearCamera(random, subject.texture->domain, 180, -4, 6);     // a far one sees a constant
      if (n++ % 2 == 0) c.target_mm = {0.005 * double(w), -0.005 * double(h), 0};  // the last texels of the far corner
      return c;
    };
    expectEqual(compare(subject, {}, run), name);
  }
}

// The random camera's picture, with parallel lines of sight.
OrbitCamera parallel(OrbitCamera c) {
  c.orthographic = true;
  return c;
}

TEST(VirtualEqualsDense, Orthographic) {
  const Subject &relief = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7),
                &flat = noiseSubjectOnce(1501, 700, Basis::kColour, 0, 8);
  for (const Subject* subject : {&relief, &flat}) {
    Views run{.views = 10};
    run.camera = [&](std::mt19937& random) { return parallel(randomCamera(random, subject->texture->domain, 180)); };
    expectEqual(compare(*subject, {}, run), subject == &relief ? "orthographic, relief" : "orthographic, flat");
    Scene scene;
    scene.sampling = Sampling::kAnisotropic;
    run.views = 4;
    expectEqual(compare(*subject, scene, run), "orthographic, anisotropic");
    run.wrong_oracle = [](DenseView& v) {
      for (int column = 0; column < 4; ++column) v.clip_from_world[column][0] *= 1.005;
    };
    const Totals t = compare(*subject, {}, run);
    t.print("a scale off by half a percent");
    EXPECT_GT(t.above_1, 100u) << "control";
  }
  const Subject vast = periodicSubject(1 << 24, 1 << 24, Basis::kPtmLrgb);
  Views run{.views = 6};
  run.camera = [&, n = 0](std::mt19937& random) mutable {
    OrbitCamera c = parallel(nearCamera(random, vast.texture->domain, 180, -4, 6));
    if (n++ % 2 == 0) c.target_mm = {0.005 * (1 << 24), -0.005 * (1 << 24), 0};
    return c;
  };
  expectEqual(compare(vast, {}, run), "orthographic, 2^24 x 2^24");
}

TEST(VirtualEqualsDense, AtBothEndsOfTheFieldOfView) {
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  for (double fov_deg : {kMinFovDeg, kMaxFovDeg}) {
    Views run{.views = 8};
    run.camera = [&](std::mt19937& random) {
      OrbitCamera c = randomCamera(random, subject.texture->domain, 180);
      const double mm_per_px = mmPerPx(c, 180);
      c.fov_deg = fov_deg;
      c.distance_mm = distanceForScale(c, mm_per_px, 180);
      return c;
    };
    expectEqual(compare(subject, {}, run), fov_deg < 2 ? "1 degree" : "170 degrees");
  }
}

// --- negative controls

TEST(VirtualEqualsDense, NegativeControlPagesWithoutBorders) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  Views run{.views = 12};
  run.faults.no_borders = true;
  const Totals t = compare(subject, {}, run);
  t.print("without borders");
  EXPECT_GT(t.max_difference, 1);
  EXPECT_GT(t.above_1, 100u);
}

TEST(VirtualEqualsDense, NegativeControlAWrongOracle) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  const std::vector<std::pair<const char*, std::function<void(DenseView&)>>> mistakes{
      {"level of detail off by a quarter", [](DenseView& v) { v.lod_bias = 0.25; }},
      {"light off by a degree", [](DenseView& v) { v.light[0] += 0.0175; }},
      {"nearest level", [](DenseView& v) { v.sampling = DenseSampling::kBilinear; }},
      {"the farthest surface instead of the nearest",
       [](DenseView& v) {
         for (int column = 0; column < 4; ++column) v.clip_from_world[column][2] *= -1;
       }},
      {"half a pixel to the side", [](DenseView& v) {
         glm::dmat4 shift{1.0};
         shift[3][0] = 1.0 / v.width_px;
         v.clip_from_world = shift * v.clip_from_world;
       }}};
  for (const auto& [what, mistake] : mistakes) {
    Views run{.views = 6};
    run.wrong_oracle = mistake;
    const Totals t = compare(subject, {}, run);
    t.print(what);
    EXPECT_GT(t.max_difference, 1) << what;
    EXPECT_GT(t.above_1, 100u) << what;
  }
}

}  // namespace virtual_equals_dense_gltest
}  // namespace relievo
