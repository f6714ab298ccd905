// Scenes that move: exact at their keys, smooth and without overshoot between them, and never the long way around.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "src/engine/scene_animation.h"

namespace relievo {
namespace scene_animation_test {

constexpr int kHeightPx = 400;

OrbitCamera base() {
  OrbitCamera c;
  c.azimuth_deg = 7, c.elevation_deg = -3, c.distance_mm = 321, c.fov_deg = 40, c.target_mm = {1, 2, 3};
  return c;
}
SceneAnimation path(std::vector<CameraKey> keys) {
  const double end_s = keys.back().time_s;
  return {.duration_s = end_s, .camera = std::move(keys), .lights = {}};
}
double azimuthAt(const SceneAnimation& a, double time_s) { return cameraAt(a, base(), kHeightPx, time_s).azimuth_deg; }

TEST(SceneAnimation, IsExactAtItsKeysAndStaysBeyondThem) {
  std::mt19937 random(3);
  const auto number = [&](double low, double high) { return low + (high - low) * (random() % 1001) / 1000.0; };
  for (int run = 0; run < 50; ++run) {
    std::vector<CameraKey> keys;
    double time_s = number(0, 1);
    for (int i = 0; i < 6; ++i, time_s += number(0.01, 3))
      keys.push_back({time_s,
                      number(-180, 180),
                      number(-89, 89),
                      number(0.1, 1e4),
                      number(1, 170),
                      {},
                      std::array{number(-9, 9), 1.0 / 3, number(-1e6, 1e6)}});
    const SceneAnimation a = path(keys);
    for (const CameraKey& key : keys) {
      const OrbitCamera c = cameraAt(a, base(), kHeightPx, key.time_s);
      EXPECT_EQ(c.azimuth_deg, *key.azimuth_deg);
      EXPECT_EQ(c.elevation_deg, *key.elevation_deg);
      EXPECT_EQ(c.distance_mm, *key.distance_mm);
      EXPECT_EQ(c.fov_deg, *key.fov_deg);
      EXPECT_EQ(c.target_mm, glm::dvec3((*key.target_mm)[0], (*key.target_mm)[1], (*key.target_mm)[2]));
    }
    EXPECT_EQ(cameraAt(a, base(), kHeightPx, -1), cameraAt(a, base(), kHeightPx, keys.front().time_s));
    EXPECT_EQ(cameraAt(a, base(), kHeightPx, 1e9), cameraAt(a, base(), kHeightPx, keys.back().time_s));
    EXPECT_NE(cameraAt(a, base(), kHeightPx, (keys[2].time_s + keys[3].time_s) / 2),
              cameraAt(a, base(), kHeightPx, keys[2].time_s))
        << "the control";
  }
  EXPECT_EQ(cameraAt({}, base(), kHeightPx, 3), base());
}

// Largest difference of a function's speeds just before and after a time.
double jumpOfSpeed(const std::function<double(double)>& f, double time_s) {
  constexpr double d = 1e-5;
  return std::abs((f(time_s + d) - f(time_s)) - (f(time_s) - f(time_s - d))) / d;
}

TEST(SceneAnimation, NumbersAreSmoothAndStayBetweenTheirKeys) {
  std::vector<CameraKey> keys;
  const double values[] = {-20, 10, 40, 41, 40.5, -60};
  const double times[] = {0, 1, 1.5, 3, 3.2, 6};
  for (size_t i = 0; i < std::size(values); ++i) keys.push_back({.time_s = times[i], .elevation_deg = values[i]});
  const SceneAnimation a = path(keys);
  const auto at = [&](double t) { return cameraAt(a, base(), kHeightPx, t).elevation_deg; };
  double largest_of_lines = 0;
  for (size_t i = 0; i + 1 < std::size(values); ++i) {
    for (int k = 0; k <= 100; ++k) {
      const double v = at(times[i] + (times[i + 1] - times[i]) * k / 100);
      EXPECT_GE(v, std::min(values[i], values[i + 1]));
      EXPECT_LE(v, std::max(values[i], values[i + 1]));
    }
    if (i == 0) continue;
    EXPECT_LT(jumpOfSpeed(at, times[i]), 0.05) << i;
    const auto lines = [&](double t) {
      const size_t k = t < times[i] ? i - 1 : i;
      return values[k] + (values[k + 1] - values[k]) * (t - times[k]) / (times[k + 1] - times[k]);
    };
    largest_of_lines = std::max(largest_of_lines, jumpOfSpeed(lines, times[i]));
  }
  EXPECT_GT(largest_of_lines, 20) << "the control";
  // A key that leaves a value out passes it by.
  keys.insert(keys.begin() + 2, {.time_s = 1.2, .azimuth_deg = 5});
  const SceneAnimation with_another = path(keys);
  for (double t = 0; t < 6; t += 0.1) EXPECT_EQ(cameraAt(with_another, base(), kHeightPx, t).elevation_deg, at(t));
  // Two keys: a straight line. Distances by their logarithm.
  const SceneAnimation two = path(
      {{.time_s = 1, .azimuth_deg = 10, .distance_mm = 100}, {.time_s = 3, .azimuth_deg = 50, .distance_mm = 900}});
  EXPECT_NEAR(azimuthAt(two, 1.5), 20, 1e-12);
  EXPECT_NEAR(cameraAt(two, base(), kHeightPx, 2).distance_mm, 300, 1e-9);
  const SceneAnimation scale = path({{.time_s = 0, .mm_per_px = 0.1}, {.time_s = 2, .mm_per_px = 0.4}});
  OrbitCamera parallel = base();
  parallel.orthographic = true;
  EXPECT_NEAR(mmPerPx(cameraAt(scale, parallel, kHeightPx, 1), kHeightPx), 0.2, 1e-12);
}

TEST(SceneAnimation, TheCameraNeverTurnsBackAtTheBorderOfAngles) {
  const auto longest = [](const SceneAnimation& a) {
    double sum = 0;
    for (int i = 0; i < 1000; ++i) {
      const double from = a.duration_s * i / 1000, to = a.duration_s * (i + 1) / 1000;
      sum += std::abs(std::remainder(azimuthAt(a, to) - azimuthAt(a, from), 360.0));
    }
    return sum;
  };
  EXPECT_NEAR(longest(path({{.time_s = 0, .azimuth_deg = 100},
                            {.time_s = 1, .azimuth_deg = 170},
                            {.time_s = 2, .azimuth_deg = -170},
                            {.time_s = 5, .azimuth_deg = -100}})),
              160, 1e-6);
  EXPECT_NEAR(longest(path({{.time_s = 0, .azimuth_deg = -170}, {.time_s = 1, .azimuth_deg = 170}})), 20, 1e-6);
  // What is written beyond these angles is meant so.
  EXPECT_NEAR(longest(path({{.time_s = 0, .azimuth_deg = 0}, {.time_s = 1, .azimuth_deg = 360}})), 360, 1e-6);
  EXPECT_NEAR(longest(path({{.time_s = 0, .azimuth_deg = -180}, {.time_s = 1, .azimuth_deg = 180}})), 360, 1e-6);
  EXPECT_NEAR(longest(path({{.time_s = 0, .azimuth_deg = -90}, {.time_s = 1, .azimuth_deg = 90}})), 180, 1e-6);
}

Scene lit(bool near) {
  Scene s;
  SceneLight fixed, moved;
  fixed.place = {1, 2, 3};
  moved.near = near;
  moved.place = {5, 5, 5};
  moved.reference_mm = near ? 10 : 0;
  s.lights = {fixed, moved};
  return s;
}

TEST(SceneAnimation, LightsGoAlongTheSphere) {
  const Scene scene = lit(false);
  const auto towards = [&](const SceneAnimation& a, double t) {
    const auto& p = sceneAt(a, scene, t).lights[1].place;
    return glm::dvec3(p[0], p[1], p[2]);
  };
  // Two keys, of any length: a great circle at one speed.
  const SceneAnimation two{
      .duration_s = 2,
      .camera = {},
      .lights = {
          {}, {{.time_s = 0, .place = std::array{3.0, 0.0, 0.0}}, {.time_s = 2, .place = std::array{0.0, 0.0, 1.0}}}}};
  EXPECT_EQ(towards(two, 0), glm::dvec3(3, 0, 0));
  for (double t = 0.1; t < 2; t += 0.1) {
    const double angle = t / 2 * std::acos(-1.0) / 2;
    EXPECT_LT(glm::length(towards(two, t) - glm::dvec3(std::cos(angle), 0, std::sin(angle))), 1e-12);
  }
  // Around at one height, by keys a quarter of a turn apart: it stays near that height, and turns without a halt.
  SceneAnimation around{.duration_s = 5, .camera = {}, .lights = {{}, {}}};
  const double z = std::sin(0.4), r = std::cos(0.4);
  for (int i = 0; i <= 5; ++i) {
    const double angle = i * std::acos(-1.0) / 2;
    around.lights[1].push_back({.time_s = double(i), .place = std::array{r * std::cos(angle), r * std::sin(angle), z}});
  }
  double lowest_of_arcs = 1;
  for (double t = 1; t <= 4; t += 0.01) {
    const glm::dvec3 p = towards(around, t);
    EXPECT_NEAR(glm::length(p), 1, 1e-9);
    EXPECT_NEAR(p.z, z, 0.06) << t;
    const double angle = std::atan2(p.y, p.x);
    EXPECT_LT(std::abs(std::remainder(angle - t * std::acos(-1.0) / 2, 2 * std::acos(-1.0))), 0.05);
    const glm::dvec3 a = towards(around, std::floor(t)), b = towards(around, std::floor(t) + 1);
    lowest_of_arcs = std::min(lowest_of_arcs, -glm::normalize(a + b).z);
  }
  EXPECT_GT(-lowest_of_arcs - z, 0.1) << "the control: great circles rise between the keys";
  for (int axis = 0; axis < 3; ++axis)
    EXPECT_LT(jumpOfSpeed([&](double t) { return towards(around, t)[axis]; }, 2), 0.01);
  // Scene::light is the first far light's; the other light stays as it is.
  EXPECT_EQ(sceneAt(two, scene, 1).lights[0], scene.lights[0]);
  EXPECT_EQ(sceneAt(two, scene, 1).light, singleLight(scene));
  EXPECT_EQ(sceneAt({}, scene, 1), [&] {
    Scene s = scene;
    s.light = singleLight(s);
    return s;
  }());
}

// A way and the same way back, at uneven times: the tangent at a key regards both of its neighbours alike.
TEST(SceneAnimation, LightsComeTheWayThatTheyWent) {
  const std::array<double, 3> places[] = {{1, 0, 0.2}, {0.3, 0.9, 0.4}, {-0.5, 0.2, 1}, {-1, -0.4, 0.1}};
  const double times[] = {0, 1, 4, 4.5};
  SceneAnimation there{.duration_s = 4.5, .camera = {}, .lights = {{}, {}}}, back = there;
  for (size_t k = 0; k < 4; ++k) {
    there.lights[1].push_back({times[k], places[k], {}, {}});
    back.lights[1].push_back({4.5 - times[3 - k], places[3 - k], {}, {}});
  }
  const Scene scene = lit(false);
  double asked = 0;
  for (double t = 0.05; t < 4.5; t += 0.1) {
    const std::array<double, 3> a = sceneAt(there, scene, t).lights[1].place,
                                b = sceneAt(back, scene, 4.5 - t).lights[1].place;
    EXPECT_LT(std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]), 1e-9) << t;
    asked = std::max(asked, std::hypot(a[0] - places[0][0], a[1] - places[0][1], a[2] - places[0][2]));
  }
  EXPECT_GT(asked, 1) << "the control: it moves";
}

TEST(SceneAnimation, NearLightsMoveAndAllChangeTheirColour) {
  const Scene scene = lit(true);
  const SceneAnimation a{
      .duration_s = 2,
      .camera = {},
      .lights = {
          {},
          {{.time_s = 0, .place = std::array{0.0, 0.0, 10.0}, .intensity = 0},
           {.time_s = 2, .place = std::array{20.0, -40.0, 10.0}, .intensity = 2, .color = std::array{1.0, 0.5, 0.0}}}}};
  const SceneLight middle = sceneAt(a, scene, 0.5).lights[1];
  EXPECT_EQ(middle.place, (std::array{5.0, -10.0, 10.0}));
  EXPECT_DOUBLE_EQ(middle.intensity, 0.5);
  EXPECT_EQ(middle.color, (std::array{1.0, 0.5, 0.0})) << "of the only key that says one";
  EXPECT_EQ(middle.reference_mm, 10);
  EXPECT_TRUE(areOpposite({0, 0, 2}, {0, 0, -1}));
  EXPECT_FALSE(areOpposite({0, 0, 2}, {0, 0.1, -1}));
}

}  // namespace scene_animation_test
}  // namespace relievo
