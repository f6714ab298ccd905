// Lights with a size, and ambient occlusion. Truth is analytic: the share of a disc behind a straight edge, the share
// of sky within a groove and beside a wall; and lines followed in double precision towards the very directions that
// the engine takes. What is off leaves no trace.
#include <gtest/gtest.h>

#include <numbers>
#include <thread>

#include "src/base/srgb.h"
#include "src/engine/effects/ambient_occlusion.h"
#include "src/engine/effects/soft_shadows.h"
#include "src/engine/light_shares.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/height_profile.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace soft_light_gltest {

using namespace test;

constexpr int64_t kSide = 128;
constexpr double kMmPerPx = 0.1;  // denseSubject's
constexpr double kHighestMm = 2;

// A plateau to the left, and ground to the right of a steep wall whose upper edge lies at x = 0.
constexpr double kWallMm = 0.2;
double plateau(double x, double) { return kHighestMm * std::clamp(1 - x / kWallMm, 0.0, 1.0); }
// A groove along y between walls of 45 degrees, as deep as the relief is high.
double groove(double x, double) { return std::min(std::abs(x), kHighestMm); }
// Hills.
double hills(double x, double y) {
  double h = 0;
  for (const auto& [cx, cy, radius, top] :
       {std::array{-2.5, 1.5, 0.8, 1.9}, {2.5, 2.0, 0.6, 1.4}, {1.0, -3.0, 1.2, 1.8}})
    h += top * std::exp(-((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (2 * radius * radius));
  return std::min(h, kHighestMm);
}

std::unique_ptr<Engine> engineOf(const HeightProfile& height, const Scene& scene, int side) {
  const HeightsOfProfile heights(kSide, kHighestMm, height);
  auto engine = makeEngine(denseSubject(WhiteTexels(kSide), &heights).artwork, scene, {}, side, side);
  if (!engine) return nullptr;
  OrbitCamera camera;
  camera.orthographic = true;  // from above: pixel and place are the same
  camera.distance_mm = distanceForScale(camera, kSide * kMmPerPx / side, side);
  engine->setCamera(camera);
  return engine;
}
std::vector<uint8_t> settled(Engine& engine, const Scene& scene) {
  EXPECT_TRUE(engine.setScene(scene).ok());
  auto done = engine.settle(60);
  EXPECT_TRUE(done.ok()) << (done.ok() ? "" : done.error().text());
  return engine.readPixels();
}
// Of the pixel's centre.
glm::dvec2 placeOf(int x, int y, int side) {
  const double mm = kSide * kMmPerPx / side;
  return {(x + 0.5 - 0.5 * side) * mm, (0.5 * side - y - 0.5) * mm};
}

// The share of light that a byte shows of a white surface, against the byte without shadows: the inverse of Lambert's
// law on a display.
double lightShare(uint8_t shadowed, uint8_t lit) {
  const auto light = [](uint8_t byte) { return (std::pow(byte / 255.0, 2.2) - 0.04) / 0.96; };
  return light(shadowed) / light(lit);
}
// Of a white surface without a light.
double skyShare(uint8_t byte) { return linearFromSrgb(byte / 255.0); }

// The share of a disc of radius 1 on one side of the line at t from its middle.
double discBelow(double t) {
  const double c = std::clamp(t, -1.0, 1.0);
  return 1 - (std::acos(c) - c * std::sqrt(1 - c * c)) / std::numbers::pi;
}

// A light of 30 degrees' elevation, 20 degrees wide, behind the edge: at the distance x the edge's elevation is
// atan(h / x), so that the penumbra reaches from x = 2.4 to 5.5 mm.
TEST(SoftShadows, OfAnEdgeHaveThePenumbraOfADisc) {
  if (openGlEs() && !longTests()) return;  // shares of a groove show that the shaders work there
  constexpr int kPicture = 64;
  constexpr double kElevation = std::numbers::pi / 6, kHalf = std::numbers::pi / 18;
  Scene scene{.light = {-std::cos(kElevation), 0, std::sin(kElevation)}, .error_px = 0.2};
  scene.least_cell = 0;
  auto engine = engineOf(plateau, scene, kPicture);
  ASSERT_TRUE(engine);
  scene.shadows = true;
  const auto hard = settled(*engine, scene);
  scene.shadows = false;
  const auto lit = settled(*engine, scene);
  scene.shadows = true;
  scene.light_size_deg = 20;
  const auto soft = settled(*engine, scene);
  double largest = 0, of_hard = 0, of_half_as_wide = 0;
  int between = 0;
  for (int x = kPicture / 2 + 2; x < kPicture - 1; ++x)
    for (int y = kPicture / 4; y < kPicture * 3 / 4; y += 4) {
      const size_t at = static_cast<size_t>(y * kPicture + x) * 4;
      const double edge = std::atan(kHighestMm / placeOf(x, y, kPicture).x);
      const double expected = discBelow((kElevation - edge) / kHalf);
      between += expected > 0.02 && expected < 0.98;
      largest = std::max(largest, std::abs(lightShare(soft[at], lit[at]) - expected));
      of_hard = std::max(of_hard, std::abs(lightShare(hard[at], lit[at]) - expected));
      of_half_as_wide = std::max(
          of_half_as_wide, std::abs(lightShare(soft[at], lit[at]) - discBelow((kElevation - edge) / (0.5 * kHalf))));
    }
  std::printf("[ softness ] penumbra off by at most %.3f\n", largest);
  EXPECT_GT(between, 100);
  // 64 directions are off by up to 0.045 of the disc's area; the wall's edge lies within a texel.
  EXPECT_LE(largest, 0.1);
  EXPECT_GT(of_hard, 0.4) << "the control";
  EXPECT_GT(of_half_as_wide, 0.15) << "the control";
}

// The same edge under a near disc of light. Whether a place of the disc is seen past the edge is linear in where it is,
// so that the share is that of the disc on one side of a line.
TEST(SoftShadows, OfANearDiscHaveItsPenumbra) {
  if (openGlEs() && !longTests()) return;
  constexpr int kPicture = 64;
  constexpr double kDiameterMm = 5;
  const glm::dvec3 light(-9, 0, 9), axis = glm::normalize(light - glm::dvec3(0, 0, 0));
  Scene scene{.error_px = 0.2};
  scene.least_cell = 0;
  scene.lights = {{.near = true, .place = {light.x, light.y, light.z}, .reference_mm = 9}};
  auto engine = engineOf(plateau, scene, kPicture);
  ASSERT_TRUE(engine);
  const auto lit = settled(*engine, scene);
  scene.shadows = true;
  const auto hard = settled(*engine, scene);
  scene.lights[0].size_mm = kDiameterMm;
  const auto soft = settled(*engine, scene);
  EXPECT_EQ(engine->stats().directions, kLightDirections);
  // The light that a byte shows over the ambient share, which falls off with it.
  const auto shareAt = [&](const std::vector<uint8_t>& picture, size_t at, double cosine) {
    const double ratio = linearFromSrgb(picture[at] / 255.0) / linearFromSrgb(lit[at] / 255.0);
    const double full = 0.04 + 0.96 * cosine;
    const double under = srgbFromLinear(ratio * linearFromSrgb(std::pow(full, 1 / 2.2)));
    return (std::pow(under, 2.2) - 0.04) / (full - 0.04);
  };
  double largest = 0, of_hard = 0, of_half_as_wide = 0;
  int between = 0;
  for (int x = kPicture / 2 + 2; x < kPicture - 1; ++x)
    for (int y = kPicture / 4; y < kPicture * 3 / 4; y += 4) {
      const size_t at = static_cast<size_t>(y * kPicture + x) * 4;
      const glm::dvec2 p = placeOf(x, y, kPicture);
      const double cosine = light.z / glm::length(light - glm::dvec3(p, 0));
      const glm::dvec3 rise(kHighestMm, 0, p.x);
      const double above = light.z * p.x + kHighestMm * light.x - kHighestMm * p.x;
      const double half = glm::length(rise - axis * glm::dot(axis, rise)) * kDiameterMm / 2;
      const double expected = discBelow(above / half);
      between += expected > 0.02 && expected < 0.98;
      largest = std::max(largest, std::abs(shareAt(soft, at, cosine) - expected));
      of_hard = std::max(of_hard, std::abs(shareAt(hard, at, cosine) - expected));
      of_half_as_wide = std::max(of_half_as_wide, std::abs(shareAt(soft, at, cosine) - discBelow(2 * above / half)));
    }
  std::printf("[ softness ] near penumbra off by at most %.3f\n", largest);
  EXPECT_GT(between, 50);
  EXPECT_LE(largest, 0.11);
  EXPECT_GT(of_hard, 0.4) << "the control";
  EXPECT_GT(of_half_as_wide, 0.12) << "the control";
}

// Is the sky seen from a place of the surface in this direction? Followed in double precision.
bool seen(const HeightProfile& height, const glm::dvec3& place, const glm::dvec3& towards) {
  constexpr double kStepMm = 0.05, kStartMm = 0.15;
  if (towards.z <= 0) return false;
  for (double t = kStartMm; place.z + t * towards.z < kHighestMm; t += kStepMm) {
    const glm::dvec3 p = place + t * towards;
    if (std::max(std::abs(p.x), std::abs(p.y)) > kSide / 2 * kMmPerPx) return true;
    if (p.z < height(p.x, p.y)) return false;
  }
  return true;
}
glm::dvec3 normalOf(const HeightProfile& height, double x, double y) {
  constexpr double d = 1e-3;
  return glm::normalize(glm::dvec3(height(x - d, y) - height(x + d, y), height(x, y - d) - height(x, y + d), 2 * d));
}

struct Difference {
  double sum = 0, largest = 0;
  int count = 0;
  void add(double off) { sum += std::abs(off), largest = std::max(largest, std::abs(off)), ++count; }
  double mean() const { return sum / std::max(count, 1); }
};

// Hills under one soft light and ambient occlusion, against lines towards the same directions.
TEST(SoftShadows, AndSkyAreTheMeanOfTheirDirections) {
  if (openGlEs() && !longTests()) return;  // as above
  constexpr int kPicture = 64;
  Scene scene{.light = {-0.8, 0.3, 0.45}, .shadows = false, .error_px = 0.2};
  scene.least_cell = 0;
  auto engine = engineOf(hills, scene, kPicture);
  ASSERT_TRUE(engine);
  const auto lit = settled(*engine, scene);
  scene.shadows = true;
  const auto hard = settled(*engine, scene);
  scene.light_size_deg = 25;
  const auto soft = settled(*engine, scene);
  Scene sky{.unlit = true, .ambient_occlusion = {.strength = 1}};
  sky.error_px = 0.2, sky.least_cell = 0;
  const auto occlusion = settled(*engine, sky);
  const auto unit = normalizedLight(scene.light);
  const auto disc = discDirections({unit[0], unit[1], unit[2]}, 25), all = skyDirections(true, kSkyDirectionsOfFlat);
  Difference of_soft, of_hard, of_sky, of_even;
  for (int y = 3; y < kPicture - 3; y += 4)
    for (int x = 3; x < kPicture - 3; x += 4) {
      const size_t at = static_cast<size_t>(y * kPicture + x) * 4;
      const glm::dvec2 p = placeOf(x, y, kPicture);
      const glm::dvec3 place(p, hills(p.x, p.y)), normal = normalOf(hills, p.x, p.y);
      std::vector<bool> free;
      int bright = 0, open = 0;
      for (const glm::dvec3& towards : all) {
        free.push_back(seen(hills, place, towards));
        open += free.back();
      }
      const double share = seenShare(
          normal, all, [&](size_t k) { return free[k]; }, true);
      of_sky.add(skyShare(occlusion[at]) - share);
      of_even.add(skyShare(occlusion[at]) - open / static_cast<double>(all.size()));
      if (glm::dot(normal, disc[0]) < 0.3) continue;  // hardly lit in any case
      for (const glm::dvec3& towards : disc) bright += seen(hills, place, towards);
      of_soft.add(lightShare(soft[at], lit[at]) - bright / static_cast<double>(disc.size()));
      of_hard.add(lightShare(hard[at], lit[at]) - bright / static_cast<double>(disc.size()));
    }
  std::printf("[ softness ] hills: light off by %.4f, at most %.3f; sky by %.4f, at most %.3f, of %d places\n",
              of_soft.mean(), of_soft.largest, of_sky.mean(), of_sky.largest, of_sky.count);
  EXPECT_GT(of_soft.count, 150);
  EXPECT_LE(of_soft.mean(), 0.01);
  EXPECT_LE(of_soft.largest, 0.12);
  EXPECT_LE(of_sky.mean(), 0.01);
  EXPECT_LE(of_sky.largest, 0.1);
  // Controls: a hard light, and directions that count alike.
  EXPECT_GT(of_hard.mean(), 0.02);
  EXPECT_GT(of_even.mean(), 0.02);
}

// On the wall of a groove, from its own plane to the opposite rim: (1 + sin a) / 2, a between the rim and the normal.
// Far from it all of the sky; a slope without end sees (1 + cos 45 degrees) / 2, as the wall does at its upper edge.
TEST(AmbientOcclusion, OfAGrooveIsItsShareOfSky) {
  constexpr int kPicture = 64;
  Scene scene{.unlit = true, .ambient_occlusion = {.strength = 1}, .error_px = 0.2};
  scene.least_cell = 0;
  auto engine = engineOf(groove, scene, kPicture);
  ASSERT_TRUE(engine);
  const auto whole = settled(*engine, scene);
  scene.ambient_occlusion.strength = 0.5;
  const auto half = settled(*engine, scene);
  double largest = 0, of_half = 0, of_hemisphere = 0;
  for (int x = 2; x < kPicture - 2; ++x) {
    const size_t at = static_cast<size_t>(kPicture / 2 * kPicture + x) * 4;
    const double from = std::abs(placeOf(x, 0, kPicture).x);
    if (from < 0.15 || std::abs(from - kHighestMm) < 0.15) continue;  // the samples' own edges
    double expected = 1;
    if (from < kHighestMm) {
      const glm::dvec2 rim = glm::normalize(glm::dvec2(from + kHighestMm, kHighestMm - from));
      const glm::dvec2 normal = glm::dvec2(1, 1) / std::sqrt(2), along(normal.y, -normal.x);
      expected = (1 + std::sin(std::atan2(glm::dot(rim, along), glm::dot(rim, normal)))) / 2;
      of_hemisphere = std::max(of_hemisphere, std::abs(skyShare(whole[at]) - 1));
    }
    largest = std::max(largest, std::abs(skyShare(whole[at]) - expected));
    of_half = std::max(of_half, std::abs(skyShare(half[at]) - (1 + expected) / 2));
  }
  std::printf("[ softness ] groove: off by at most %.3f, by %.3f at half the strength\n", largest, of_half);
  EXPECT_LE(largest, 0.06);
  EXPECT_LE(of_half, 0.03);
  EXPECT_GT(of_hemisphere, 0.4) << "there is nothing to see";
  const size_t flat = static_cast<size_t>(kPicture / 2 * kPicture + 3) * 4;
  EXPECT_GE(whole[flat], 254) << "a flat place sees all of the sky";
}

// A floor and a wall of a base mesh, both kLengthMm long and kHighMm wide.
constexpr double kLengthMm = 60, kHighMm = 30;
class PlainPages final : public PageSource {
 public:
  Result<EncodedPage> read(PageId id) const override {
    if (id.plane() == Plane::kRelief) return madeReliefPage(id.node(), [](double, double) { return uint16_t{0}; });
    return madeTexturePage(std::vector<uint8_t>(kTexturePageBytes, 255));
  }
};

// What a place of the floor, `from` away from the wall and in the middle of its length, sees of the wall: twice the
// configuration factor of an element and a rectangle at a right angle from its corner on (Howell, A Catalog of
// Radiation Heat Transfer Configuration Factors, B-4).
double wallShare(double from) {
  const double x = from / (kLengthMm / 2), y = kHighMm / (kLengthMm / 2), far = std::hypot(x, y);
  return (std::atan(1 / x) - x / far * std::atan(1 / far)) / std::numbers::pi;
}

TEST(AmbientOcclusion, OfAScanIsItsShareOfTheHemisphere) {
  if (openGlEs() && !longTests()) return;  // shares of a groove show that the shaders work there
  constexpr int kPicture = 64;
  auto base = std::make_shared<BaseMesh>();
  const auto corner = [&](double x, double y, double z, const glm::vec3& normal) {
    base->corners.push_back({glm::vec3(x, y, z), normal});
    return static_cast<uint32_t>(base->corners.size() - 1);
  };
  const float slanted = std::sqrt(0.5f);
  const double l = kLengthMm / 2;
  // Of each patch the corners of its square (0, 0), (1, 0), (0, 1), (1, 1): v runs down.
  const uint32_t a = corner(-l, kHighMm, 0, {0, 0, 1}), b = corner(l, kHighMm, 0, {0, 0, 1}),
                 c = corner(-l, 0, 0, {0, slanted, slanted}), d = corner(l, 0, 0, {0, slanted, slanted}),
                 e = corner(-l, 0, kHighMm, {0, 1, 0}), f = corner(l, 0, kHighMm, {0, 1, 0});
  base->patches.push_back({a, b, c, d});
  base->patches.push_back({c, d, e, f});
  Artwork artwork;
  artwork.manifest = madeManifest(base, 1, 1, 1);
  artwork.source = std::make_shared<PlainPages>();
  artwork.oracle = std::make_shared<test::MadeUpMeshOracle>(test::MeshRelief{1, 0, 1.0 / 65535}, 3, 0.01);
  const Scene scene{.unlit = true, .ambient_occlusion = {.strength = 1}};
  auto engine = makeEngine(artwork, scene, {}, kPicture, kPicture);
  ASSERT_TRUE(engine);
  OrbitCamera camera = engine->camera();
  camera.orthographic = true;
  camera.elevation_deg = 50;
  camera.distance_mm = fitDistance(camera, artworkExtent(artwork.manifest), kPicture, kPicture);
  engine->setCamera(camera);
  ASSERT_TRUE(engine->settle(60).ok());
  const auto pixels = engine->readPixels();
  const auto directions = skyDirections(false, kSkyDirectionsOfScan);
  double largest = 0, of_directions = 0, least = 1;
  int compared = 0;
  for (double from = 1; from < kHighMm - 1; from += 1) {
    const glm::dvec4 clip = engine->view().clip_from_world * glm::dvec4(0, from, 0, 1);
    const int x = static_cast<int>((clip.x / clip.w + 1) / 2 * kPicture),
              y = static_cast<int>((1 - clip.y / clip.w) / 2 * kPicture);
    const auto place = engine->surfacePoint(x, y);
    ASSERT_TRUE(place.has_value()) << from;
    if (place->y < 2) continue;  // a pixel or two beside the wall
    const double share = skyShare(pixels[static_cast<size_t>(y * kPicture + x) * 4]);
    largest = std::max(largest, std::abs(share - (1 - wallShare(place->y))));
    const auto free = [&](size_t k) {
      const glm::dvec3 hit = *place - place->y / directions[k].y * directions[k];
      return directions[k].y >= 0 || std::abs(hit.x) > kLengthMm / 2 || hit.z > kHighMm;
    };
    of_directions = std::max(of_directions, std::abs(share - seenShare({0, 0, 1}, directions, free, false)));
    least = std::min(least, share);
    ++compared;
  }
  std::printf("[ softness ] beside a wall: off by at most %.3f, by %.3f of the same directions; %d places\n", largest,
              of_directions, compared);
  EXPECT_GT(compared, 20);
  EXPECT_LE(largest, 0.06);
  EXPECT_LE(of_directions, 0.02);
  EXPECT_LT(least, 0.6) << "there is nothing to see";
  EXPECT_EQ(engine->stats().directions, kSkyDirectionsOfScan);
}

// A body without hollows is nowhere darker, up to its silhouette.
TEST(AmbientOcclusion, OfABallIsNone) {
  constexpr int kPicture = 48, kMargin = 3;
  if (openGlEs() && !longTests()) return;  // as above
  const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  auto engine = makeEngine(ballArtwork(base, 1, 7), {.unlit = true}, {}, kPicture, kPicture);
  ASSERT_TRUE(engine);
  const auto with = settled(*engine, {.unlit = true, .ambient_occlusion = {.strength = 1}});
  int inside = 0, darkest = 255;
  for (int y = kMargin; y < kPicture - kMargin; ++y)
    for (int x = kMargin; x < kPicture - kMargin; ++x) {
      const auto alpha = [&](int i, int j) { return with[static_cast<size_t>((y + j) * kPicture + x + i) * 4 + 3]; };
      if (!alpha(kMargin, 0) || !alpha(-kMargin, 0) || !alpha(0, kMargin) || !alpha(0, -kMargin)) continue;
      ++inside;
      darkest = std::min<int>(darkest, with[static_cast<size_t>(y * kPicture + x) * 4]);
    }
  EXPECT_GT(inside, 400);
  EXPECT_GE(darkest, kAlbedo[0] - 4);
}

// A frame of a camera that moves shows hard shadows; standing still, it is refined step by step to the settled picture,
// the same bytes each time; with several samples, too.
TEST(SoftShadows, AreRefinedToTheSettledPicture) {
  if (openGlEs() && !longTests()) return;  // shares of a groove show that the shaders work there
  for (const int samples : {1, 4}) {
    Scene scene{.light = {-0.8, 0.3, 0.45}, .shadows = true, .samples = samples};
    auto engine = engineOf(hills, scene, 32);
    ASSERT_TRUE(engine);
    const auto hard = settled(*engine, scene);
    EXPECT_EQ(engine->stats().directions, 0);
    EXPECT_FALSE(engine->refine(0));
    scene.light_size_deg = 25;
    if (samples == 1) scene.ambient_occlusion.strength = 0.7;
    const auto soft = settled(*engine, scene);
    EXPECT_NE(soft, hard);
    EXPECT_TRUE(engine->stats().refined);
    EXPECT_EQ(engine->stats().directions, kLightDirections + (samples == 1 ? kSkyDirectionsOfFlat : 0));
    if (samples == 1) {
      engine->frame(0);
      EXPECT_EQ(engine->readPixels(), soft) << "what is refined stays";
    }
    // Another view, and back: a frame or two until the list for it is drawn.
    OrbitCamera camera = engine->camera();
    camera.azimuth_deg = 5;
    engine->setCamera(camera);
    ASSERT_TRUE(engine->settle(60, false).ok());
    camera.azimuth_deg = 0;
    engine->setCamera(camera);
    ASSERT_TRUE(engine->settle(60, false).ok());
    EXPECT_FALSE(engine->stats().refined);
    EXPECT_EQ(engine->stats().directions, 0);
    const auto moving = engine->readPixels();
    EXPECT_NE(moving, soft);
    int steps = 0;
    while (engine->refine(0)) ++steps;
    EXPECT_EQ(steps, samples * kLightDirections / kDirectionsAtATime);
    EXPECT_TRUE(engine->stats().refined);
    EXPECT_EQ(engine->readPixels(), soft);
  }
}

Manifest manifestOf(Basis basis, int relief_depth = 2) {
  Manifest m;
  m.texture.basis = basis;
  m.domain.relief_depth = relief_depth;
  return m;
}

TEST(SoftShadows, ThatAreOffLeaveNoTrace) {
  const Manifest m = manifestOf(Basis::kPtmLrgb);
  const auto variant = [&](const Scene& scene) { return shadingSource(scene, m); };
  const auto passes = [&](const Scene& scene) { return planEffects(scene, m).passes(); };
  const Scene hard{.shadows = true};
  Scene soft = hard, without_shadows, sky, off;
  soft.light_size_deg = without_shadows.light_size_deg = 3;
  sky.ambient_occlusion.strength = 0.5;
  off.ambient_occlusion.strength = 0;
  EXPECT_EQ(planEffects(without_shadows, m), planEffects({}, m));
  EXPECT_EQ(planEffects(off, m), planEffects({}, m));
  EXPECT_EQ(variant(soft), variant(hard)) << "the share is another, not the shader";
  EXPECT_EQ(variant({}).find("u_sky_share"), std::string::npos);
  EXPECT_NE(variant(sky).find("u_sky_share"), std::string::npos);
  EXPECT_EQ(passes(soft),
            (std::vector<std::string>{"surface", "shadow map", "shadow", "soft shadow", "shade", "feedback"}));
  EXPECT_EQ(passes(sky), (std::vector<std::string>{"surface", "sky map", "sky", "shade", "feedback"}));
  EXPECT_EQ(planEffects(sky, m).planesRead(), planEffects({}, m).planesRead());
  // Among several lights each size counts.
  Scene lights = hard;
  lights.lights = {{.place = {1, 0, 1}, .intensity = 0.5}, {.near = true, .place = {0, 0, 9}}};
  EXPECT_FALSE(planEffects(lights, m).soft_shadows);
  lights.lights[0].size_deg = 5;
  EXPECT_TRUE(planEffects(lights, m).soft_shadows && !planEffects(lights, m).soft_near);
  lights.lights[0].size_deg = 0, lights.lights[1].size_mm = 5;
  EXPECT_TRUE(planEffects(lights, m).soft_shadows && planEffects(lights, m).soft_near);
  lights.lights = {{.place = {1, 0, 1}, .size_deg = 5}};
  EXPECT_EQ(planEffects(lights, m), planEffects(soft, m)) << "one white light, however it is said";
  EXPECT_EQ(singleLightSize(lights), 5);
  // There is no sky over what is not displaced, or shown in the place of light.
  sky.relief = false;
  EXPECT_FALSE(planEffects(sky, m).ambient_occlusion);
  EXPECT_FALSE(planEffects({.ambient_occlusion = {.strength = 1}}, manifestOf(Basis::kColour, -1)).ambient_occlusion);
  EXPECT_FALSE(planEffects({.ambient_occlusion = {.strength = 1}, .shading = {.kind = ReliefShading::Kind::kSlope}}, m)
                   .ambient_occlusion);
}

// The directions themselves.
TEST(SoftShadows, ComeFromEvenDirections) {
  const glm::dvec3 light = glm::normalize(glm::dvec3(-0.8, 0.3, 0.45));
  const auto disc = discDirections(light, 8);
  ASSERT_EQ(disc.size(), static_cast<size_t>(kLightDirections));
  glm::dvec3 mean(0);
  double widest = 0;
  for (const glm::dvec3& d : disc) {
    EXPECT_NEAR(glm::length(d), 1, 1e-12);
    widest = std::max(widest, std::acos(glm::dot(d, light)));
    mean += d / static_cast<double>(disc.size());
  }
  EXPECT_LT(glm::degrees(std::acos(glm::dot(glm::normalize(mean), light))), 0.15);
  EXPECT_LE(glm::degrees(widest), 4);
  EXPECT_GT(glm::degrees(widest), 3.9);
  // Of directions over the hemisphere, weighted by the cosine: (1 + cos a) / 2 lies over a plane of angle a.
  const auto sky = skyDirections(true, kSkyDirectionsOfFlat), sphere = skyDirections(false, kSkyDirectionsOfScan);
  for (const double degrees : {0.0, 20.0, 45.0, 70.0}) {
    const double angle = glm::radians(degrees);
    const glm::dvec3 normal(std::sin(angle), 0, std::cos(angle));
    const auto all = [](size_t) { return true; };
    EXPECT_NEAR(seenShare(normal, sky, all, true), (1 + std::cos(angle)) / 2, 0.02) << degrees;
    EXPECT_EQ(seenShare(normal, sphere, all, false), 1);
    EXPECT_NEAR(seenShare(
                    normal, sphere, [&](size_t k) { return sphere[k].z > 0; }, false),
                (1 + std::cos(angle)) / 2, 0.02)
        << degrees;
  }
}

}  // namespace soft_light_gltest
}  // namespace relievo
