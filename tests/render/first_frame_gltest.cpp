// The first frame of a view, while no page but the roots can be read: it does not wait, and shows all of the artwork as
// its roots have it, which is the frame that the oracle (dense_reference.h) draws from its coarsest level in double
// precision. By then the pages that the view is going to want are requested.
#include <algorithm>

#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"
#include "tests/texturing/fake_sources.h"

namespace relievo {
namespace first_frame_gltest {

using namespace test;

constexpr int kWidth = 320, kHeight = 180;
constexpr double kCoarsest = 30;  // a bias beyond all levels

struct First {
  std::shared_ptr<fake::GatedSource> gate;  // shut, once the engine has its roots
  std::unique_ptr<Engine> engine;           // after one frame

  First(const Subject& subject, const Scene& scene, const OrbitCamera& camera)
      : gate(std::make_shared<fake::GatedSource>(subject.artwork.source, true)) {
    Artwork artwork = subject.artwork;
    artwork.source = gate;
    engine = makeEngine(artwork, scene, {}, kWidth, kHeight);
    gate->open(false);
    if (!engine) return;
    engine->setCamera(camera);
    engine->frame(0);
  }
  First(const First&) = delete;
  First& operator=(const First&) = delete;
  ~First() { gate->open(); }
};

DenseImage oracle(const Engine& e, const Subject& subject, const Scene& scene, double lod_bias) {
  DenseView v;
  v.clip_from_world = e.view().clip_from_world;
  v.width_px = kWidth;
  v.height_px = kHeight;
  v.exaggerate = scene.exaggerate;
  v.light = normalizedLight(scene.light);
  v.sampling = static_cast<DenseSampling>(scene.sampling);
  v.anisotropy = e.plan().anisotropy;
  v.lod_bias = lod_bias;
  v.snapped_px = snappedPx();
  return renderDense(*subject.texture, e.plan().relief ? subject.relief.get() : nullptr, e.instances(), v);
}

// Fine enough for pages of several levels, and seen from aside.
OrbitCamera closeCamera(const Subject& subject, double turn) {
  const FlatDomain& d = subject.texture->domain;
  const PlacedExtent placed{artworkExtent(subject.artwork.manifest), {}};
  OrbitCamera camera = fitCamera(std::span(&placed, 1), kWidth, kHeight);
  camera.azimuth_deg = 25 * std::sin(turn);
  camera.elevation_deg = 20 * std::cos(turn);
  camera.distance_mm *= 0.5;
  camera.target_mm = {0.05 * turn * static_cast<double>(d.width_px) * d.mm_per_px, 0, 0};
  return camera;
}

TEST(FirstFrame, ShowsTheRootsWhileNoOtherPageIsThere) {
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  const Scene bilinear{.sampling = Sampling::kBilinear}, flat{.relief = false}, fading{.page_fade_s = 0.25};
  size_t finer_is_different = 0;
  for (const Scene& scene : {Scene{}, bilinear, flat, fading}) {
    for (const double turn : {0.0, 2.0}) {
      First first(subject, scene, closeCamera(subject, turn));
      ASSERT_TRUE(first.engine);
      std::vector<uint8_t> pixels = first.engine->readPixels();
      const DenseImage coarse = oracle(*first.engine, subject, scene, kCoarsest);
      const ImageDifference d = compareImages(coarse, pixels, false);
      EXPECT_GT(d.compared, 10'000u);
      EXPECT_TRUE(d.within(1)) << d.text();
      EXPECT_EQ(d.holes, 0u) << "background shows where the artwork is";
      EXPECT_EQ(d.extras, 0u);
      finer_is_different +=
          compareImages(oracle(*first.engine, subject, scene, 0), pixels, false).count_above_1 > 10'000;
      std::fill(pixels.begin(), pixels.end(), uint8_t{0});
      EXPECT_GT(compareImages(coarse, pixels, false).holes, 10'000u) << "control: nothing but background";
    }
  }
  EXPECT_EQ(finer_is_different, 8u) << "control: finer levels are in view";
}

TEST(FirstFrame, AsksForThePagesThatTheSettledViewWants) {
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  for (const bool relief : {false, true}) {
    // Slopes of this rough relief want a level more in places, which the feedback finds later.
    const double least_share = relief ? 0.7 : 1;
    First first(subject, {.relief = relief}, closeCamera(subject, 1));
    ASSERT_TRUE(first.engine);
    std::vector<NodeId> asked;
    for (const NodeRequest& r : first.engine->textureRequests()) asked.push_back(r.node);
    const StreamerStats streamer = first.engine->stats().streamer;
    EXPECT_GT(streamer.queued + streamer.decoding, 0u) << "the workers are at it";
    first.gate->open();
    ASSERT_TRUE(first.engine->settle(60).ok());
    size_t wanted = 0, found = 0;
    for (const NodeRequest& r : first.engine->textureRequests()) {
      ++wanted;
      found += std::find(asked.begin(), asked.end(), r.node) != asked.end();
    }
    std::printf("[ first ] %zu of the %zu nodes that every pixel asks for are asked for in the first frame\n", found,
                wanted);
    EXPECT_GT(wanted, 10u);
    EXPECT_GE(static_cast<double>(found), least_share * static_cast<double>(wanted));
  }
}

// A picture that settles after such a frame, and one that settles at once, of the same pages.
TEST(FirstFrame, LeavesNothingBehind) {
  const Subject& subject = noiseSubjectOnce(1501, 1103, Basis::kPtmLrgb, 12, 7);
  for (const double turn : {0.0, 2.0}) {
    First first(subject, {}, closeCamera(subject, turn));
    ASSERT_TRUE(first.engine);
    const std::vector<uint8_t> coarse = first.engine->readPixels();
    first.gate->open();
    ASSERT_TRUE(first.engine->settle(60).ok());
    const std::vector<uint8_t> settled = first.engine->readPixels();
    EXPECT_NE(settled, coarse);
    auto fresh = makeEngine(subject.artwork, {}, {}, kWidth, kHeight);
    ASSERT_TRUE(fresh);
    fresh->setCamera(closeCamera(subject, turn));
    ASSERT_TRUE(fresh->settle(60).ok());
    EXPECT_EQ(settled, fresh->readPixels());
    EXPECT_EQ(fresh->stats().draw_calls, first.engine->stats().draw_calls);
  }
}

}  // namespace first_frame_gltest
}  // namespace relievo
