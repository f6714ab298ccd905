#include "src/engine/scene_animation.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

#include <glm/glm.hpp>

#include "src/base/monotone_cubic.h"

namespace relievo {
namespace {

struct Knot {
  double time_s, value;
};

// At an end, from the parabola through three knots, kept monotone.
double endSlope(double h0, double h1, double d0, double d1) {
  const double slope = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
  if (slope * d0 <= 0) return 0;
  return d0 * d1 <= 0 && std::abs(slope) > 3 * std::abs(d0) ? 3 * d0 : slope;
}

// knots: at least one, by time.
double monotoneAt(std::span<const Knot> knots, double time_s) {
  if (time_s <= knots.front().time_s) return knots.front().value;
  if (time_s >= knots.back().time_s) return knots.back().value;
  size_t i = 0;
  while (time_s >= knots[i + 1].time_s) ++i;
  if (time_s == knots[i].time_s) return knots[i].value;
  const auto width = [&](size_t k) { return knots[k + 1].time_s - knots[k].time_s; };
  const auto line = [&](size_t k) { return (knots[k + 1].value - knots[k].value) / width(k); };
  const auto slope = [&](size_t k) {
    const size_t last = knots.size() - 1;
    if (last == 1) return line(0);
    if (k == 0) return endSlope(width(0), width(1), line(0), line(1));
    if (k == last) return endSlope(width(last - 1), width(last - 2), line(last - 1), line(last - 2));
    return monotoneSlope(line(k - 1), line(k), width(k - 1), width(k));
  };
  const double a = knots[i].value, b = knots[i + 1].value;
  const double value = cubicBetween(a, b, slope(i), slope(i + 1), width(i), (time_s - knots[i].time_s) / width(i));
  return std::clamp(value, std::min(a, b), std::max(a, b));  // but for rounding it is
}

// The knots of one value of keys; those that leave it out have none.
template <class Key, class Value>
std::vector<Knot> knotsOf(const std::vector<Key>& keys, Value&& value) {
  std::vector<Knot> knots;
  for (const Key& key : keys)
    if (const std::optional<double> v = value(key)) knots.push_back({key.time_s, *v});
  return knots;
}
void takeValue(std::span<const Knot> knots, double time_s, double& to) {
  if (!knots.empty()) to = monotoneAt(knots, time_s);
}
// Where a time lies at a knot, or beyond the first or last: its value as it is. knots: at least one.
std::optional<double> exactAt(std::span<const Knot> knots, double time_s) {
  const double held_s = std::clamp(time_s, knots.front().time_s, knots.back().time_s);
  for (const Knot& knot : knots)
    if (knot.time_s == held_s) return knot.value;
  return std::nullopt;
}
void takeEven(std::vector<Knot> knots, double time_s, double& to) {
  if (knots.empty()) return;
  const auto exact = exactAt(knots, time_s);
  for (Knot& knot : knots) knot.value = std::log(knot.value);
  to = exact ? *exact : std::exp(monotoneAt(knots, time_s));
}
template <class Key, class Triple>
void takeTriple(const std::vector<Key>& keys, Triple&& triple, double time_s, std::array<double, 3>& to) {
  for (size_t axis = 0; axis < 3; ++axis)
    takeValue(knotsOf(keys,
                      [&](const Key& key) {
                        const auto& t = triple(key);
                        return t ? std::optional((*t)[axis]) : std::nullopt;
                      }),
              time_s, to[axis]);
}

void takeAzimuth(std::vector<Knot> azimuths, double time_s, double& to) {
  if (azimuths.empty()) return;
  const auto exact = exactAt(azimuths, time_s);
  double turns = 0;
  for (size_t i = 1; i < azimuths.size(); ++i) {
    const double step = azimuths[i].value + turns - azimuths[i - 1].value;
    if (std::abs(step) > 180 && std::abs(step) < 360) turns -= std::copysign(360.0, step);
    azimuths[i].value += turns;
  }
  to = exact ? *exact : monotoneAt(azimuths, time_s);
}

glm::dvec3 unit(const std::array<double, 3>& v) { return glm::normalize(glm::dvec3(v[0], v[1], v[2])); }

double angleOf(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
}
// The tangent at `from` that leads to `to` along a great circle in a unit of time.
glm::dvec3 wayTo(const glm::dvec3& from, const glm::dvec3& to) {
  const glm::dvec3 aside = to - from * glm::dot(from, to);
  const double size = glm::length(aside);
  return size > 0 ? aside * (angleOf(from, to) / size) : glm::dvec3(0);
}
glm::dvec3 along(const glm::dvec3& from, const glm::dvec3& way) {
  const double angle = glm::length(way);
  return angle > 0 ? from * std::cos(angle) + way * (std::sin(angle) / angle) : from;
}
glm::dvec3 between(const glm::dvec3& a, const glm::dvec3& b, double t) { return along(a, wayTo(a, b) * t); }

struct Direction {
  double time_s;
  std::array<double, 3> towards;
};

std::array<double, 3> directionAt(const std::vector<Direction>& keys, double time_s) {
  if (time_s <= keys.front().time_s) return keys.front().towards;
  if (time_s >= keys.back().time_s) return keys.back().towards;
  size_t i = 0;
  while (time_s >= keys[i + 1].time_s) ++i;
  if (time_s == keys[i].time_s) return keys[i].towards;
  // Per second, at key k: what the ways to its two neighbours have in common (Catmull, Rom 1974, for uneven times).
  const auto speed = [&](size_t k) {
    const glm::dvec3 here = unit(keys[k].towards);
    const auto to = [&](size_t n) { return wayTo(here, unit(keys[n].towards)) / (keys[n].time_s - keys[k].time_s); };
    if (k == 0) return to(1);
    if (k == keys.size() - 1) return to(k - 1);
    const double before = keys[k].time_s - keys[k - 1].time_s, after = keys[k + 1].time_s - keys[k].time_s;
    return (to(k - 1) * after + to(k + 1) * before) / (before + after);
  };
  const double h = keys[i + 1].time_s - keys[i].time_s, t = (time_s - keys[i].time_s) / h;
  const glm::dvec3 a = unit(keys[i].towards), d = unit(keys[i + 1].towards);
  const glm::dvec3 b = along(a, speed(i) * (h / 3)), c = along(d, speed(i + 1) * (-h / 3));
  const glm::dvec3 bc = between(b, c, t);
  const glm::dvec3 p = between(between(between(a, b, t), bc, t), between(bc, between(c, d, t), t), t);
  return {p.x, p.y, p.z};
}

SceneLight lightAt(const std::vector<LightKey>& keys, const SceneLight& base, double time_s) {
  SceneLight light = base;
  takeValue(knotsOf(keys, [](const LightKey& k) { return k.intensity; }), time_s, light.intensity);
  takeTriple(
      keys, [](const LightKey& k) -> auto& { return k.color; }, time_s, light.color);
  if (light.near) {
    takeTriple(
        keys, [](const LightKey& k) -> auto& { return k.place; }, time_s, light.place);
    return light;
  }
  std::vector<Direction> directions;
  for (const LightKey& key : keys)
    if (key.place) directions.push_back({key.time_s, *key.place});
  if (!directions.empty()) light.place = directionAt(directions, time_s);
  return light;
}

}  // namespace

OrbitCamera cameraAt(const SceneAnimation& animation, const OrbitCamera& base, int height_px, double time_s) {
  OrbitCamera c = base;
  const auto& keys = animation.camera;
  takeAzimuth(knotsOf(keys, [](const CameraKey& k) { return k.azimuth_deg; }), time_s, c.azimuth_deg);
  takeValue(knotsOf(keys, [](const CameraKey& k) { return k.elevation_deg; }), time_s, c.elevation_deg);
  takeValue(knotsOf(keys, [](const CameraKey& k) { return k.fov_deg; }), time_s, c.fov_deg);
  takeEven(knotsOf(keys, [](const CameraKey& k) { return k.distance_mm; }), time_s, c.distance_mm);
  double scale = 0;
  takeEven(knotsOf(keys, [](const CameraKey& k) { return k.mm_per_px; }), time_s, scale);
  if (scale > 0) c.distance_mm = distanceForScale(c, scale, height_px);
  std::array<double, 3> target{c.target_mm.x, c.target_mm.y, c.target_mm.z};
  takeTriple(
      keys, [](const CameraKey& k) -> auto& { return k.target_mm; }, time_s, target);
  c.target_mm = {target[0], target[1], target[2]};
  return c;
}

Scene sceneAt(const SceneAnimation& animation, const Scene& scene, double time_s) {
  Scene now = scene;
  for (size_t i = 0; i < std::min(now.lights.size(), animation.lights.size()); ++i)
    now.lights[i] = lightAt(animation.lights[i], scene.lights[i], time_s);
  if (!now.lights.empty()) now.light = singleLight(now);
  return now;
}

bool areOpposite(const std::array<double, 3>& a, const std::array<double, 3>& b) {
  constexpr double kNearly = 1e-3;
  return angleOf(unit(a), unit(b)) > std::numbers::pi - kNearly;
}

}  // namespace relievo
