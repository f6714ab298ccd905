// Several artworks in one picture. The oracles: lines of sight that are met with planes in double precision; the
// pictures of the artworks by themselves, put together on the CPU; and of one artwork its engine's picture.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "src/base/srgb.h"
#include "src/engine/stage.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"
#include "tests/render/pose_fixture.h"

namespace relievo {
namespace stage_gltest {

using namespace test;

constexpr int64_t kPlanePx = 300;
constexpr double kHalfMm = 15;  // denseSubject's 0.1 mm a px

class OneColour final : public TextureSource {
 public:
  explicit OneColour(const std::array<uint8_t, 3>& colour) : colour_(colour) {}
  int64_t width() const override { return kPlanePx; }
  int64_t height() const override { return kPlanePx; }
  TextureFormat format() const override { return {.basis = Basis::kColour}; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    const auto texels = static_cast<size_t>(r.width * r.height);
    for (size_t i = 0; i < 3 * texels; ++i) out[i] = colour_[i / texels];
    return {};
  }

 private:
  std::array<uint8_t, 3> colour_;
};

constexpr std::array<std::array<uint8_t, 3>, 3> kColours{{{200, 30, 20}, {20, 180, 40}, {30, 40, 210}}};

// A square of one colour and of 30 mm.
const Artwork& square(size_t colour) {
  static const std::array<Subject, 3> all{denseSubject(OneColour(kColours[0]), nullptr),
                                          denseSubject(OneColour(kColours[1]), nullptr),
                                          denseSubject(OneColour(kColours[2]), nullptr)};
  return all[colour].artwork;
}

std::unique_ptr<Stage> stageOf(std::vector<StagedArtwork> artworks, const Scene& scene, const OrbitCamera& camera,
                               EngineOptions options = {}) {
  auto stage = Stage::create(std::move(artworks), scene, options);
  EXPECT_TRUE(stage.ok()) << (stage.ok() ? "" : stage.error().text());
  if (!stage.ok()) return nullptr;
  (*stage)->resize(kWidth, kHeight);
  (*stage)->setCamera(camera);
  return std::move(*stage);
}

std::vector<uint8_t> settledPicture(Stage& stage) {
  auto settled = stage.settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  return stage.readPixels();
}

// A line of sight through a pixel's centre: p + t d, with t growing away from the viewer.
struct Ray {
  glm::dvec3 p, d;
};
Ray rayThrough(const OrbitCamera& camera, int x, int y) {
  const glm::dmat3 axes = axesOfCamera(camera.azimuth_deg, camera.elevation_deg);
  const double half_mm = camera.distance_mm * std::tan(radiansOf(camera.fov_deg) / 2);
  const glm::dvec3 at = camera.target_mm + axes * glm::dvec3((2 * (x + 0.5) - kWidth) / kHeight * half_mm,
                                                             (1 - 2 * (y + 0.5) / kHeight) * half_mm, 0);
  const glm::dvec3 eye = camera.target_mm + axes[2] * camera.distance_mm;
  return camera.orthographic ? Ray{at + axes[2] * 1000.0, -axes[2]} : Ray{eye, (at - eye) / camera.distance_mm};
}

// Where a line meets a posed square, and how far within it, mm (below 0: beside it).
struct Meeting {
  double t = 0, within_mm = -1;
};
Meeting meetingOf(const Ray& ray, const Pose& pose) {
  const glm::dmat3 turn = worldFromArtwork(pose);
  const glm::dvec3 p = glm::transpose(turn) *
                       (ray.p - glm::dvec3(pose.position_mm[0], pose.position_mm[1], pose.position_mm[2])),
                   d = glm::transpose(turn) * ray.d;
  const double t = -p.z / d.z;
  const glm::dvec3 at = p + t * d;
  return {t, kHalfMm - std::max(std::abs(at.x), std::abs(at.y))};
}

const std::array<Pose, 3> kCrossing{{{{1, 0, 2}, {5, 35, 0}}, {{-2, 1, 0}, {-10, -40, 20}}, {{0, -3, -1}, {50, 5, 0}}}};

OrbitCamera cameraOfCrossing(bool orthographic) {
  OrbitCamera camera;
  camera.azimuth_deg = 12;
  camera.elevation_deg = 8;
  camera.distance_mm = 70;
  camera.orthographic = orthographic;
  return camera;
}

// Pixels that show another artwork than the nearest that their line of sight meets. Not judged: where two are as near
// to within what depth tells apart, or within a tenth of a millimetre of a border.
struct Judged {
  int sure = 0, wrong = 0;
};
Judged judge(const std::vector<uint8_t>& picture, const OrbitCamera& camera, double apart_mm) {
  Judged j;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const Ray ray = rayThrough(camera, x, y);
      double first = 1e9, second = 1e9;
      int nearest = -1;
      bool sure = true;
      for (int i = 0; i < 3; ++i) {
        const Meeting m = meetingOf(ray, kCrossing[static_cast<size_t>(i)]);
        sure = sure && std::abs(m.within_mm) > 0.1;
        if (m.within_mm < 0) continue;
        second = std::min(second, std::max(first, m.t));
        if (m.t < first) nearest = i;
        first = std::min(first, m.t);
      }
      if (!sure || (nearest >= 0 && second - first < apart_mm)) continue;
      ++j.sure;
      const uint8_t* p = &picture[static_cast<size_t>(y * kWidth + x) * 4];
      bool right = nearest < 0 ? p[3] == 0 : p[3] == 255;
      for (size_t c = 0; c < 3 && nearest >= 0; ++c)
        right = right && std::abs(p[c] - kColours[static_cast<size_t>(nearest)][c]) <= 1;
      j.wrong += !right;
    }
  return j;
}

std::vector<StagedArtwork> crossing() {
  return {{square(0), kCrossing[0], "red"}, {square(1), kCrossing[1], "green"}, {square(2), kCrossing[2], "blue"}};
}

TEST(Stages, ShowTheNearestArtworkAtEachPixel) {
  for (const bool reversed : {true, false})
    for (const bool orthographic : {false, true}) {
      SCOPED_TRACE(std::string(reversed ? "reversed" : "conventional") +
                   (orthographic ? ", orthographic" : ", perspective"));
      const OrbitCamera camera = cameraOfCrossing(orthographic);
      auto stage = stageOf(crossing(), {}, camera, {.reversed_depth = reversed});
      ASSERT_TRUE(stage);
      const auto picture = settledPicture(*stage);
      const Judged j = judge(picture, camera, 0.001);
      EXPECT_GT(j.sure, 40000);
      EXPECT_EQ(j.wrong, 0) << "of " << j.sure;
      EXPECT_GT(stage->compositionBytes(), 0u);
      EXPECT_EQ(stage->stats().passes.back(), "composition");
      // The control: one over the other in their order.
      std::vector<uint8_t> in_order = stage->readPixels();
      for (size_t i = 3; i-- > 0;) {
        auto alone = makeEngine(square(i), {.pose = kCrossing[i]}, {}, kWidth, kHeight);
        ASSERT_TRUE(alone);
        alone->setCamera(camera);
        const auto over = pictureOf(*alone, alone->scene());
        for (size_t k = 0; k < over.size(); k += 4)
          if (over[k + 3] > 0) std::copy_n(&over[k], 4, &in_order[k]);
      }
      EXPECT_GT(judge(in_order, camera, 0.001).wrong, 1000);
      // Places are those of the nearest.
      int asked = 0;
      for (int y = 20; y < kHeight; y += 23)
        for (int x = 40; x < kWidth; x += 31) {
          double first = 1e9, second = 1e9;
          bool sure = true;
          for (const Pose& pose : kCrossing) {
            const Meeting m = meetingOf(rayThrough(camera, x, y), pose);
            sure = sure && std::abs(m.within_mm) > 0.1;
            if (m.within_mm < 0) continue;
            second = std::min(second, std::max(first, m.t));
            first = std::min(first, m.t);
          }
          if (!sure || first == 1e9 || second - first < 0.1) continue;
          const Ray ray = rayThrough(camera, x, y);
          const auto place = stage->surfacePoint(x + 0.5, y + 0.5);
          ASSERT_TRUE(place);
          EXPECT_LT(glm::length(*place - (ray.p + first * ray.d)), 0.01) << "mm";
          ++asked;
        }
      EXPECT_GT(asked, 10);
    }
}

const Artwork& stageBall() {
  static const Artwork ball = ballArtwork(std::make_shared<const BaseMesh>(cubeSphere(2, kRadius)), 1, 7);
  return ball;
}

// A body, relief and a square, which cross.
std::vector<StagedArtwork> mixed() {
  return {{stageBall(), {{10, 0, 5}, {20, 30, 40}}, "ball"},
          {noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21).artwork, {{-30, 10, 30}, {0, 30, 0}}, "relief"},
          {square(1), {{25, -20, 40}, {0, -20, 0}}, "square"}};
}

TEST(Stages, DoNotDependOnTheOrderOfTheArtworks) {
  for (const int samples : {1, 4}) {
    Scene scene{.light = {-0.5, 0.4, 0.7}};
    scene.lights = {{.place = {-0.5, 0.4, 0.7}, .intensity = 0.7},
                    {.near = true, .place = {60, 50, 90}, .intensity = 0.4}};
    scene.samples = samples;
    std::vector<std::vector<uint8_t>> pictures;
    for (const std::array<size_t, 3>& order : {std::array<size_t, 3>{0, 1, 2}, {2, 1, 0}, {1, 2, 0}}) {
      auto all = mixed();
      std::vector<StagedArtwork> some;
      for (size_t i : order) some.push_back(std::move(all[i]));
      OrbitCamera camera;
      camera.azimuth_deg = -20;
      camera.distance_mm = 300;
      auto stage = stageOf(std::move(some), scene, camera);
      ASSERT_TRUE(stage);
      pictures.push_back(settledPicture(*stage));
    }
    EXPECT_EQ(pictures[1], pictures[0]);
    EXPECT_EQ(pictures[2], pictures[0]);
    const PictureDifference none = differenceOf(pictures[0], std::vector<uint8_t>(pictures[0].size()));
    EXPECT_GT(none.pixels, 5000);
  }
}

// Not even where depths are equal, bit for bit.
TEST(Stages, DoNotDependOnTheOrderWhereDepthsAreEqual) {
  std::vector<std::vector<uint8_t>> pictures;
  for (const bool turned : {false, true}) {
    std::vector<StagedArtwork> all{{square(0), kCrossing[0], "a"}, {square(1), kCrossing[0], "b"}};
    if (turned) std::swap(all[0], all[1]);
    auto stage = stageOf(std::move(all), {}, cameraOfCrossing(false));
    ASSERT_TRUE(stage);
    pictures.push_back(settledPicture(*stage));
  }
  EXPECT_EQ(pictures[0], pictures[1]);
}

// Of one file twice, which is told apart by its place in the list.
TEST(Stages, DoNotDependOnTheOrderOfTheSameFile) {
  std::vector<std::vector<uint8_t>> pictures;
  const Pose turned{{0, 0, 0}, {0, 0, 180}};  // the same square, its depths the same but for rounding
  for (const std::array<Pose, 2>& poses : {std::array<Pose, 2>{Pose{}, turned}, std::array<Pose, 2>{turned, Pose{}}}) {
    auto stage = stageOf({{square(0), poses[0], "a (1)"}, {square(0), poses[1], "a (2)"}}, {}, cameraOfCrossing(false));
    ASSERT_TRUE(stage);
    pictures.push_back(settledPicture(*stage));
  }
  EXPECT_EQ(pictures[0], pictures[1]);
}

// A light in the middle of all has no distance to take its intensity from, and no artwork takes the scene.
TEST(Stages, RefuseALightInTheMiddleOfAll) {
  std::vector<StagedArtwork> all{{square(0), Pose{{-50, 0, 0}, {}}, "a"}, {square(1), Pose{{50, 0, 0}, {}}, "b"}};
  Scene middle{.light = {-0.5, 0.4, 0.7}};
  middle.lights = {{.near = true, .place = {0, 0, 0}}};
  auto refused = Stage::create(all, middle, {});
  ASSERT_FALSE(refused.ok());
  EXPECT_NE(refused.error().text().find("reference_mm"), std::string::npos) << refused.error().text();
  Scene aside = middle;
  aside.lights[0].place = {0, 0, 80};
  auto stage = Stage::create(all, aside, {});
  ASSERT_TRUE(stage.ok()) << "control";
  EXPECT_FALSE((*stage)->setScene(middle).ok());
  for (size_t i = 0; i < 2; ++i) EXPECT_EQ((*stage)->engine(i).scene().lights[0].place, aside.lights[0].place);
  middle.lights[0].reference_mm = 10;
  EXPECT_TRUE((*stage)->setScene(middle).ok());
}

// One artwork: its engine's bytes, and nothing of a composition.
TEST(Stages, OfOneArtworkAreItsEngine) {
  for (const int samples : {1, 4}) {
    Scene scene{.light = {-0.5, 0.4, 0.7}, .shadows = true};
    scene.samples = samples;
    scene.pose = {{3, 1, 2}, {10, 20, 30}};
    const Artwork& relief = noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21).artwork;
    auto engine = makeEngine(relief, scene, {}, kWidth, kHeight);
    ASSERT_TRUE(engine);
    auto stage = stageOf({{relief, scene.pose, "relief"}}, scene, engine->camera());
    ASSERT_TRUE(stage);
    EXPECT_EQ(settledPicture(*stage), pictureOf(*engine, scene));
    EXPECT_EQ(stage->compositionBytes(), 0u);
    EXPECT_EQ(stage->stats().passes, engine->stats().passes);
    EXPECT_EQ(stage->stats().draw_calls, engine->stats().draw_calls);
    EXPECT_EQ(stage->stats().cache_bytes, engine->stats().cache_bytes);
    EXPECT_EQ(nlohmann::json::parse(stage->statsJson()).count("artworks"), 0u);
  }
}

// Of two artworks one of which is out of view, that one is neither streamed nor drawn, and the picture is the other's.
TEST(Stages, SpareWhatIsOutOfView) {
  const Artwork& relief = noiseSubjectOnce(700, 500, Basis::kPtmRgb, 3, 21).artwork;
  auto engine = makeEngine(relief, {}, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  auto stage = stageOf({{relief, {}, "relief"}, {stageBall(), {{400, 0, 0}, {}}, "ball"}}, {}, engine->camera());
  ASSERT_TRUE(stage);
  EXPECT_EQ(settledPicture(*stage), pictureOf(*engine, {}));
  stage->frame(1);
  EXPECT_TRUE(stage->inView(0));
  EXPECT_FALSE(stage->inView(1));
  EXPECT_EQ(stage->engine(1).stats().frames, 0u);
  EXPECT_EQ(stage->compositionBytes(), 0u);
  EXPECT_EQ(stage->stats().triangles, stage->engine(0).stats().triangles);
  // Into view, out of it, and into it from the other side: what it showed before is not shown in its place.
  OrbitCamera camera = stage->camera();
  camera.target_mm.x = 380;
  stage->setCamera(camera);
  const auto with_ball = settledPicture(*stage);
  EXPECT_GT(stage->engine(1).stats().frames, 0u);
  EXPECT_FALSE(stage->inView(0));
  camera.target_mm.x = 0;
  stage->setCamera(camera);
  for (int i = 0; i < 4; ++i) stage->frame(2 + i);
  EXPECT_EQ(settledPicture(*stage), pictureOf(*engine, {}));
  camera.target_mm.x = 420;
  stage->setCamera(camera);
  stage->frame(10);
  const auto first = stage->readPixels();
  const auto settled = settledPicture(*stage);
  // Pixels that an artwork covers in one picture alone.
  const auto covered_apart = [](const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
    int count = 0;
    for (size_t k = 3; k < a.size(); k += 4) count += (a[k] > 0) != (b[k] > 0);
    return count;
  };
  const bool empty = covered_apart(first, std::vector<uint8_t>(first.size())) == 0;
  EXPECT_TRUE(empty || covered_apart(first, settled) < 200) << covered_apart(first, settled);
  EXPECT_GT(covered_apart(with_ball, settled), 1000) << "control";
  EXPECT_GT(differenceOf(settled, std::vector<uint8_t>(settled.size())).pixels, 1000);
}

glm::dvec3 linearOf(const uint8_t* p) {
  return {linearFromSrgb(p[0] / 255.0), linearFromSrgb(p[1] / 255.0), linearFromSrgb(p[2] / 255.0)};
}

// A square before another one: at its border each shows by its share of the pixel's samples. Put together on the CPU
// from the pictures of each by itself.
TEST(Stages, BlendAtBordersByCoverage) {
  OrbitCamera camera = cameraOfCrossing(false);
  camera.distance_mm = 70;
  const Pose front{{14, 11, 8}, {0, 0, 17}}, back{{0, 0, 0}, {10, 0, 0}};
  for (const int samples : {4, 8}) {
    Scene scene;
    scene.samples = samples;
    auto stage = stageOf({{square(1), back, "back"}, {square(0), front, "front"}}, scene, camera);
    ASSERT_TRUE(stage);
    const auto picture = settledPicture(*stage);
    std::array<std::vector<uint8_t>, 2> alone;
    for (size_t i = 0; i < 2; ++i) {
      Scene own = scene;
      own.pose = i == 0 ? front : back;
      auto engine = makeEngine(square(i), own, {}, kWidth, kHeight);
      ASSERT_TRUE(engine);
      engine->setCamera(camera);
      alone[i] = pictureOf(*engine, own);
    }
    int borders = 0, wrong = 0, wrong_without = 0, alone_changed = 0;
    for (size_t k = 0; k < picture.size(); k += 4) {
      const double a = alone[0][k + 3] / 255.0, b = alone[1][k + 3] / 255.0, covered = a + (1 - a) * b;
      borders += a > 0 && a < 1 && b == 1;
      if (a == 0 || b == 0)
        alone_changed += !std::equal(&picture[k], &picture[k] + 4, a > 0 ? &alone[0][k] : &alone[1][k]);
      const auto differs = [&](double share, double next) {
        if (std::abs(255 * (share + next) - picture[k + 3]) > 1) return true;
        if (share + next == 0) return false;
        const glm::dvec3 mean = (share * linearOf(&alone[0][k]) + next * linearOf(&alone[1][k])) / (share + next);
        for (int c = 0; c < 3; ++c)
          if (std::abs(255 * srgbFromLinear(mean[c]) - picture[k + static_cast<size_t>(c)]) > 1.01) return true;
        return false;
      };
      wrong += differs(a, covered - a);
      wrong_without += a > 0 && a < 1 && differs(a * (1 - b), b);
    }
    EXPECT_GT(borders, 60);
    EXPECT_EQ(wrong, 0);
    EXPECT_EQ(alone_changed, 0) << "where one shows alone its bytes stay";
    EXPECT_GT(wrong_without, 40) << "the control: at borders the one behind is taken for the nearer one";
  }
}

TEST(Stages, NameTheArtworkThatSomethingIsWrongWith) {
  const OrbitCamera camera = cameraOfCrossing(false);
  Scene unlit;
  unlit.unlit = true;
  auto refused = Stage::create(mixed(), unlit, {});
  ASSERT_FALSE(refused.ok());
  EXPECT_NE(refused.error().text().find("relief: "), std::string::npos) << refused.error().text();
  auto stage = stageOf(mixed(), {}, camera);
  ASSERT_TRUE(stage);
  const auto set = stage->setScene(unlit);
  ASSERT_FALSE(set.ok());
  EXPECT_EQ(set.error().file, "relief");
  auto small = Stage::create(mixed(), {}, {.cache_mib = 1});
  ASSERT_FALSE(small.ok());
  EXPECT_NE(small.error().text().find("these artworks"), std::string::npos) << small.error().text();
}

// The budget is one for all; light that falls off does so from the middle of all.
TEST(Stages, ShareCacheAndLights) {
  OrbitCamera camera;
  camera.distance_mm = 400;
  Scene scene;
  scene.lights = {{.near = true, .place = {0, 0, 300}}};
  glm::dvec3 low(1e9), high(-1e9);
  for (const StagedArtwork& one : mixed()) {
    const Extent box = artworkExtent(one.artwork.manifest, 0);
    for (int corner = 0; corner < 8; ++corner) {
      const glm::dvec3 place =
          placeInWorld(one.pose, {corner & 1 ? box.max_mm.x : box.min_mm.x, corner & 2 ? box.max_mm.y : box.min_mm.y,
                                  corner & 4 ? box.max_mm.z : box.min_mm.z});
      low = glm::min(low, place);
      high = glm::max(high, place);
    }
  }
  const double reference_mm = glm::length(glm::dvec3(0, 0, 300) - (low + high) / 2.0);
  for (const double cache_mib : {40.0, 100.0}) {
    auto stage = stageOf(mixed(), scene, camera, {.cache_mib = cache_mib});
    ASSERT_TRUE(stage);
    EXPECT_TRUE(stage->settle(60).ok());
    const EngineStats sum = stage->stats();
    EXPECT_LE(static_cast<double>(sum.cache_bytes), cache_mib * 1024 * 1024);
    uint64_t triangles = 0;
    double largest = 0;
    for (size_t i = 0; i < stage->size(); ++i) {
      const EngineStats own = stage->engine(i).stats();
      triangles += own.triangles;
      largest = std::max(largest, own.predicted_error_px);
      EXPECT_NEAR(stage->engine(i).scene().lights[0].reference_mm, reference_mm, 1e-9);
    }
    EXPECT_EQ(sum.triangles, triangles);
    EXPECT_EQ(sum.predicted_error_px, largest);
    const auto json = nlohmann::json::parse(stage->statsJson());
    ASSERT_EQ(json["artworks"].size(), 3u);
    EXPECT_EQ(json["artworks"][0]["artwork"], "ball");
    EXPECT_TRUE(json["planes"].contains("albedo") && json["planes"].contains("colour")) << json["planes"];
  }
}

}  // namespace stage_gltest
}  // namespace relievo
