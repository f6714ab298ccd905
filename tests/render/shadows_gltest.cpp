// Cast shadows. Truth is analytic: hills and walls given by a formula, and lines from the surface to the light,
// followed in double precision. What is lit or dark by more than a margin must be drawn so.
#include <gtest/gtest.h>

#include "src/base/srgb.h"
#include "src/render/shadow_view.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/height_profile.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace shadows_gltest {

using namespace test;

constexpr int64_t kSide = 256;
constexpr double kMmPerPx = 0.1;  // denseSubject's
constexpr double kHighestMm = 3;

// Hills, and a wall with soft edges, mm above the lowest place; x to the right and y up from the centre.
double heightAt(double x, double y) {
  double h = 0;
  for (const auto& [cx, cy, radius, top] :
       {std::array{-6.0, 5.0, 1.6, 2.6}, {5.0, 6.0, 0.8, 1.8}, {6.0, -6.0, 2.5, 2.0}})
    h += top * std::exp(-((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (2 * radius * radius));
  const double wall = 1 / (1 + std::exp((std::abs(x + 3) - 1) * 12)),
               end = 1 / (1 + std::exp((std::abs(y + 5) - 4) * 12));
  return std::min(kHighestMm, h + 1.2 * wall * end);
}

// How far the line from a place of the surface to the light, which is so far away, stays above it, mm; below 0: it does
// not.
double clearance(const glm::dvec3& place, const glm::dvec3& light, double length_mm = 60) {
  constexpr double kStepMm = 0.02, kStartMm = 0.6;  // beyond the place's own surroundings
  double least = 1e9;
  for (double t = kStartMm; place.z + t * light.z < kHighestMm && t < length_mm; t += kStepMm) {
    const glm::dvec3 p = place + t * light;
    if (std::max(std::abs(p.x), std::abs(p.y)) > kSide / 2 * kMmPerPx) break;
    least = std::min(least, p.z - heightAt(p.x, p.y));
  }
  return least;
}

// Where the line of sight through a pixel meets the surface; nothing where it leaves the artwork.
std::optional<glm::dvec3> seenAt(const ViewTransform& view, int x, int y, int width, int height) {
  const glm::dmat4 world = glm::inverse(view.clip_from_world);
  const auto at = [&](double z) {
    const glm::dvec4 p = world * glm::dvec4((x + 0.5) / width * 2 - 1, 1 - (y + 0.5) / height * 2, z, 1);
    return glm::dvec3(p) / p.w;
  };
  const glm::dvec3 near = at(-1), way = glm::normalize(at(1) - near);
  const double start = (kHighestMm - near.z) / way.z, end = -near.z / way.z;
  double above = start;
  for (double t = start; t <= end + 0.02; t += 0.02) {
    const glm::dvec3 p = near + t * way;
    if (p.z > heightAt(p.x, p.y)) {
      above = t;
      continue;
    }
    double low = above, high = t;
    for (int k = 0; k < 40; ++k) {
      const double middle = (low + high) / 2;
      const glm::dvec3 q = near + middle * way;
      (q.z > heightAt(q.x, q.y) ? low : high) = middle;
    }
    return near + low * way;
  }
  return std::nullopt;
}

glm::dvec3 normalAt(const glm::dvec3& p) {
  constexpr double d = 1e-4;
  return glm::normalize(glm::dvec3(heightAt(p.x - d, p.y) - heightAt(p.x + d, p.y),
                                   heightAt(p.x, p.y - d) - heightAt(p.x, p.y + d), 2 * d));
}

struct Drawn {
  std::vector<uint8_t> lit, shadowed;  // without and with shadows
  ViewTransform view;
  std::vector<std::string> passes;
};
// refined: as it settles; else as it moves, with hard shadows and no ambient occlusion.
Drawn draw(const Scene& scene, const OrbitCamera& camera, bool reversed_depth, int side, bool refined = true) {
  const HeightsOfProfile heights(kSide, kHighestMm, heightAt);
  EngineOptions options;
  options.reversed_depth = reversed_depth;
  auto engine = makeEngine(denseSubject(WhiteTexels(kSide), &heights).artwork, scene, options, side, side);
  if (!engine) return {};
  engine->setCamera(camera);
  Drawn drawn;
  for (const bool shadows : {false, true}) {
    Scene now = scene;
    now.shadows = shadows;
    EXPECT_TRUE(engine->setScene(now).ok());
    auto settled = engine->settle(60, refined);
    EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
    (shadows ? drawn.shadowed : drawn.lit) = engine->readPixels();
  }
  drawn.view = engine->view();
  drawn.passes = engine->plan().passes();
  return drawn;
}

struct Counts {
  int sure = 0, dark = 0, wrong = 0, margin = 0;
  double wrongShare() const { return static_cast<double>(wrong) / std::max(sure, 1); }
};
// Places whose line to the light passes the surface by less than this are not judged: a pixel, a texel of the map and
// the drawn triangles are about that large.
constexpr double kMarginMm = 0.1;

// A pixel that is judged, and how clear its line to the light is.
struct Judged {
  size_t at;
  double clearance_mm;
};
// The places seen through every step-th pixel of every step-th row.
std::vector<std::pair<size_t, glm::dvec3>> placesSeen(const Drawn& drawn, int side, int step) {
  std::vector<std::pair<size_t, glm::dvec3>> all;
  for (int y = 2; y < side - 2; y += step)
    for (int x = 2; x < side - 2; x += step) {
      const size_t at = static_cast<size_t>(y * side + x) * 4;
      const auto place = seenAt(drawn.view, x, y, side, side);
      if (!place || drawn.lit[at + 3] == 0 || std::max(std::abs(place->x), std::abs(place->y)) > 12.4) continue;
      all.emplace_back(at, *place);
    }
  return all;
}
std::vector<Judged> towards(const std::vector<std::pair<size_t, glm::dvec3>>& places,
                            const std::array<double, 3>& direction) {
  const auto unit = normalizedLight(direction);
  const glm::dvec3 light(unit[0], unit[1], unit[2]);
  std::vector<Judged> all;
  for (const auto& [at, place] : places)
    if (glm::dot(normalAt(place), light) >= 0.15)  // others are hardly lit in any case
      all.push_back({at, clearance(place, light)});
  return all;
}

Counts judged(const std::vector<Judged>& places, const std::vector<uint8_t>& lit,
              const std::vector<uint8_t>& shadowed) {
  const auto lightOf = [](uint8_t byte) { return (std::pow(byte / 255.0, 2.2) - 0.04) / 0.96; };
  Counts counts;
  for (const auto& [at, above] : places) {
    if (std::abs(above) < kMarginMm) {
      ++counts.margin;
      continue;
    }
    const double share = lightOf(shadowed[at]) / lightOf(lit[at]);
    ++counts.sure;
    counts.dark += above < 0;
    counts.wrong += above < 0 ? share > 0.1 : share < 0.9;
  }
  return counts;
}

OrbitCamera fromAbove(int side) {
  OrbitCamera c;
  c.orthographic = true;
  c.distance_mm = distanceForScale(c, kSide * kMmPerPx / side, side);
  return c;
}
OrbitCamera slanted() {
  OrbitCamera c;
  c.azimuth_deg = 25, c.elevation_deg = 30, c.distance_mm = 45;
  return c;
}

// With OpenGL ES under the first light alone.
TEST(Shadows, LieWhereLinesToTheLightMeetTheSurface) {
  constexpr int kPicture = 256;
  std::vector<std::array<double, 3>> lights{{-0.8, 0.3, 0.4}, {0.5, -0.8, 0.35}, {0.9, 0.2, 0.25}};
  lights.resize(esShare(lights.size()));
  for (const std::array<double, 3>& light : lights)
    for (const OrbitCamera& camera : {fromAbove(kPicture), slanted()}) {
      std::vector<std::pair<size_t, glm::dvec3>> seen;
      std::vector<Judged> places;
      for (const bool reversed : {true, false}) {
        if (!reversed && light[2] < 0.4) continue;  // the depth buffer does not depend on the light
        const Drawn drawn = draw({.light = light}, camera, reversed, kPicture);
        ASSERT_FALSE(drawn.shadowed.empty());
        if (reversed) seen = placesSeen(drawn, kPicture, longTests() ? 2 : 3), places = towards(seen, light);
        const Counts counts = judged(places, drawn.lit, drawn.shadowed);
        EXPECT_GT(counts.sure, 3000);
        EXPECT_GT(counts.dark, counts.sure / 50) << "there is nothing to see";
        EXPECT_LT(counts.margin, counts.sure / 4);
        EXPECT_LE(counts.wrongShare(), 0.002) << counts.wrong << " of " << counts.sure << ", light " << light[0] << " "
                                              << light[1] << (camera.orthographic ? " above" : " slanted") << reversed;
        std::printf("[ shadows  ] %d of %d judged places wrong, %d dark, %d within the margin\n", counts.wrong,
                    counts.sure, counts.dark, counts.margin);
        // Controls: of another light, and none at all.
        if (reversed) {
          EXPECT_GT(judged(towards(seen, {-light[0], -light[1], light[2]}), drawn.lit, drawn.shadowed).wrongShare(),
                    0.02);
        }
        EXPECT_GT(judged(places, drawn.lit, drawn.lit).wrongShare(), 0.02);
      }
    }
}

// ---- near lights

std::vector<Judged> towardsPlace(const std::vector<std::pair<size_t, glm::dvec3>>& places, const glm::dvec3& light_mm) {
  std::vector<Judged> all;
  for (const auto& [at, place] : places) {
    const glm::dvec3 way = light_mm - place;
    const double length = glm::length(way);
    if (length > 1.5 && glm::dot(normalAt(place), way) >= 0.15 * length)
      all.push_back({at, clearance(place, way / length, length)});
  }
  return all;
}
// Of the light alone: what is dark keeps the ambient share, at most a quarter of such places' light.
Counts judgedNear(const std::vector<Judged>& places, const Drawn& drawn, const std::vector<uint8_t>& shadowed) {
  Counts counts;
  for (const auto& [at, above] : places) {
    const double lit = linearFromSrgb(drawn.lit[at] / 255.0), share = linearFromSrgb(shadowed[at] / 255.0) / lit;
    if (std::abs(above) < kMarginMm || drawn.lit[at] < 12) {
      ++counts.margin;
      continue;
    }
    ++counts.sure;
    counts.dark += above < 0;
    counts.wrong += above < 0 ? share > 0.5 : share < 0.85;
  }
  return counts;
}

// From before the artwork, from beside it, and from amid its heights, which several maps around the light hold. With
// OpenGL ES from the second alone.
TEST(Shadows, OfNearLightsLieWhereLinesToTheirPlacesMeetTheSurface) {
  constexpr int kPicture = 192;
  const glm::dvec3 places[] = {{-22, 8, 14}, {-9.5, 3, 5}, {1, 0.5, 2.4}};
  for (const glm::dvec3& light : places) {
    if (openGlEs() && &light != &places[1] && !longTests()) continue;
    Scene scene;
    scene.lights = {{.near = true, .place = {light.x, light.y, light.z}, .intensity = 3, .reference_mm = 3}};
    if (light.z > 10) scene.lights[0].reference_mm = 12;
    // Without shadows heights that are seen from above need no triangles, and a near light is where it is: with this
    // the geometry of both pictures is the same.
    scene.ambient_occlusion.strength = 1;
    for (const OrbitCamera& camera : {fromAbove(kPicture), slanted()}) {
      if (camera.orthographic == (light.z > 10) && !longTests()) continue;
      const Drawn drawn = draw(scene, camera, camera.orthographic, kPicture, false);
      ASSERT_FALSE(drawn.shadowed.empty());
      const auto seen = placesSeen(drawn, kPicture, longTests() ? 2 : 3);
      const auto judged_places = towardsPlace(seen, light);
      const Counts counts = judgedNear(judged_places, drawn, drawn.shadowed);
      EXPECT_GT(counts.sure, 1000);
      EXPECT_GT(counts.dark, counts.sure / 50) << "there is nothing to see";
      EXPECT_LE(counts.wrongShare(), 0.003)
          << counts.wrong << " of " << counts.sure << ", " << light.x << (camera.orthographic ? " above" : " slanted");
      std::printf("[ shadows  ] near: %d of %d judged places wrong, %d dark, %d not judged\n", counts.wrong,
                  counts.sure, counts.dark, counts.margin);
      // Controls: of a light elsewhere, and none at all.
      EXPECT_GT(judgedNear(towardsPlace(seen, {-light.x, -light.y, light.z}), drawn, drawn.shadowed).wrongShare(),
                0.02);
      EXPECT_GT(judgedNear(judged_places, drawn, drawn.lit).wrongShare(), 0.02);
    }
  }
}

// Zoomed in, what casts lies beside the picture.
TEST(Shadows, AreCastByWhatIsBesideThePicture) {
  constexpr int kPicture = 128;
  OrbitCamera camera = fromAbove(kPicture);
  camera.target_mm = {-3.2, 4.0, 0};
  camera.distance_mm /= 6;
  const std::array<double, 3> light{-0.8, 0.3, 0.4};
  const Drawn drawn = draw({.light = light}, camera, true, kPicture);
  ASSERT_FALSE(drawn.shadowed.empty());
  const Counts counts = judged(towards(placesSeen(drawn, kPicture, 2), light), drawn.lit, drawn.shadowed);
  EXPECT_GT(counts.dark, 300);
  EXPECT_LE(counts.wrongShare(), 0.002) << counts.wrong << " of " << counts.sure;
}

TEST(Shadows, OfABallLieOnItsDarkSideAlone) {
  const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  auto engine = makeEngine(ballArtwork(base, 1, 7), {.light = {0.6, 0.3, 0.7}}, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  ASSERT_TRUE(engine->settle(60).ok());
  const std::vector<uint8_t> lit = engine->readPixels();
  Scene scene = engine->scene();
  scene.shadows = true;
  ASSERT_TRUE(engine->setScene(scene).ok());
  ASSERT_TRUE(engine->settle(60).ok());
  const std::vector<uint8_t> shadowed = engine->readPixels();
  int bright = 0, changed = 0;
  for (size_t i = 0; i < lit.size(); i += 4) {
    if (lit[i + 3] == 0 || lit[i] < 0.55 * kAlbedo[0]) continue;  // Lambert's cosine above a quarter
    ++bright;
    changed += std::abs(lit[i] - shadowed[i]) > 2;
  }
  EXPECT_GT(bright, 3000);
  EXPECT_EQ(changed, 0) << "of " << bright;
}

// What is off is not there: no pass, no define.
TEST(Shadows, AreInThePlanWhereTheyChangeSomething) {
  Manifest m;
  m.texture.basis = Basis::kPtmLrgb;
  m.domain.relief_depth = 2;
  const auto has = [&](const Scene& scene) {
    const EffectPlan plan = planEffects(scene, m);
    const auto passes = plan.passes();
    const auto defines = plan.defines();
    const bool pass = std::find(passes.begin(), passes.end(), "shadow map") != passes.end();
    const bool define = std::any_of(defines.begin(), defines.end(), [](const auto& d) { return d.first == "SHADOWS"; });
    EXPECT_EQ(pass, define);
    return pass;
  };
  EXPECT_FALSE(has({}));
  EXPECT_TRUE(has({.shadows = true}));
  EXPECT_TRUE(has({.relight = false, .shadows = true}));
  EXPECT_FALSE(has({.relief = false, .shadows = true}));
  EXPECT_FALSE(has({.shadows = true, .exaggerate = 0}));
  m.texture.basis = Basis::kColour;
  EXPECT_TRUE(has({.shadows = true}));
  EXPECT_FALSE(has({.unlit = true, .shadows = true}));
}

// What the camera sees lies within the map, as large as it can be, and what may cast into it lies before its far plane.
TEST(ShadowView, HoldsWhatTheCameraSees) {
  const Extent extent{.min_mm = {-50, -30, -1}, .max_mm = {50, 30, 4}};
  for (const double distance : {400.0, 30.0, 8.0})
    for (const std::array<double, 3>& direction : {std::array{0.0, 0.0, 1.0}, {-0.8, 0.3, 0.2}, {0.1, 0.99, 0.02}}) {
      OrbitCamera camera;
      camera.azimuth_deg = 35, camera.elevation_deg = 20, camera.distance_mm = distance;
      const ViewTransform view = viewTransform(camera, extent, 640, 360);
      const glm::dvec3 light = glm::normalize(glm::dvec3(direction[0], direction[1], direction[2]));
      const ShadowView shadow = shadowView(view, extent, light);
      glm::dvec2 low(1), high(-1);
      int seen = 0;
      for (int i = 0; i <= 40; ++i)
        for (int j = 0; j <= 40; ++j)
          for (int k = 0; k <= 6; ++k) {
            const glm::dvec3 p = glm::mix(extent.min_mm, extent.max_mm, glm::dvec3(i / 40.0, j / 40.0, k / 6.0));
            const glm::dvec4 on_map = shadow.clip_from_world * glm::dvec4(p, 1);
            EXPECT_LE(std::abs(on_map.z), 1);
            const glm::dvec4 clip = view.clip_from_world * glm::dvec4(p, 1);
            if (std::max({std::abs(clip.x), std::abs(clip.y), std::abs(clip.z)}) > clip.w) continue;
            ++seen;
            EXPECT_LE(std::max(std::abs(on_map.x), std::abs(on_map.y)), 1);
            low = glm::min(low, glm::dvec2(on_map)), high = glm::max(high, glm::dvec2(on_map));
          }
      EXPECT_GT(seen, 0);
      if (seen > 2000) {
        EXPECT_GT(std::min(high.x - low.x, high.y - low.y), 1.8) << distance;
      }
      // Nearer to the light is nearer on the map.
      const glm::dvec4 step = shadow.clip_from_world * glm::dvec4(light, 0);
      EXPECT_LT(step.z, 0);
      EXPECT_NEAR(step.x, 0, 1e-9);
    }
}

// Whatever the camera sees lies in the part of some view that this counts for, and before its far plane.
TEST(ShadowView, OfNearLightsHoldWhatTheCameraSees) {
  const Extent extent{.min_mm = {-50, -30, -1}, .max_mm = {50, 30, 4}};
  size_t fewest = 9, most = 0;
  for (const double distance : {400.0, 30.0})
    for (const glm::dvec3& light : {glm::dvec3(0, 0, 300), {-70, 10, 20}, {10, 5, 2}, {3, 4, -40}}) {
      OrbitCamera camera;
      camera.azimuth_deg = 35, camera.elevation_deg = 20, camera.distance_mm = distance;
      const ViewTransform view = viewTransform(camera, extent, 640, 360);
      const std::vector<ShadowView> shadows = nearShadowViews(view, extent, light);
      fewest = std::min(fewest, shadows.size()), most = std::max(most, shadows.size());
      int seen = 0, lost = 0, without_last = 0;
      for (int i = 0; i <= 40; ++i)
        for (int j = 0; j <= 40; ++j)
          for (int k = 0; k <= 6; ++k) {
            const glm::dvec3 p = glm::mix(extent.min_mm, extent.max_mm, glm::dvec3(i / 40.0, j / 40.0, k / 6.0));
            const glm::dvec4 clip = view.clip_from_world * glm::dvec4(p, 1);
            if (std::max({std::abs(clip.x), std::abs(clip.y), std::abs(clip.z)}) > clip.w) continue;
            if (glm::length(p - light) < 1) continue;
            ++seen;
            const auto holds = [&](const ShadowView& shadow) {
              const glm::dvec4 h = shadow.clip_from_world * glm::dvec4(p, 1);
              const glm::dvec3 at = glm::dvec3(h) / h.w;
              const double slack = 1e-9;
              return h.w > 0 && std::max({std::abs(at.x), std::abs(at.y), std::abs(at.z)}) <= 1 &&
                     at.x >= shadow.low.x - slack && at.x <= shadow.high.x + slack && at.y >= shadow.low.y - slack &&
                     at.y <= shadow.high.y + slack;
            };
            lost += std::none_of(shadows.begin(), shadows.end(), holds);
            without_last += std::none_of(shadows.begin(), shadows.end() - 1, holds);
          }
      EXPECT_GT(seen, 0);
      EXPECT_EQ(lost, 0) << "of " << seen << " under a light at " << light.x << ", " << light.z;
      EXPECT_GT(without_last, 0) << "the control: each view is needed";
    }
  EXPECT_EQ(fewest, 1u);
  EXPECT_GE(most, 5u);
}

}  // namespace shadows_gltest
}  // namespace relievo
