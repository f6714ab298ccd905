#include "tools/bench/flight.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "src/base/monotone_cubic.h"

namespace relievo {
namespace {

using Values = std::array<double, 7>;

Values valuesOf(const OrbitCamera& c) {
  return {c.azimuth_deg, c.elevation_deg, std::log(c.distance_mm), c.fov_deg, c.target_mm.x,
          c.target_mm.y, c.target_mm.z};
}
OrbitCamera cameraOf(const Values& v) {
  OrbitCamera c;
  c.azimuth_deg = v[0];
  c.elevation_deg = v[1];
  c.distance_mm = std::exp(v[2]);
  c.fov_deg = v[3];
  c.target_mm = {v[4], v[5], v[6]};
  return c;
}

// Builds a path leg by leg; each leg starts where the last one ended.
class Path {
 public:
  Path(const OrbitCamera& start, double speed) : speed_(speed) { keys_.push_back({0, start}); }

  const OrbitCamera& camera() const { return keys_.back().camera; }
  void stay(double seconds) { add(seconds, camera()); }
  void goTo(double seconds, const OrbitCamera& end) { add(seconds, end); }

  // The point stays where it is on screen on the way to the centre, as by a wheel over it: log distance changes evenly
  // (eased), the target's way is proportional to the distance.
  void zoomTo(double seconds, const glm::dvec3& point_mm, double distance_mm) {
    OrbitCamera from = camera();
    constexpr int kSteps = 24;
    for (int i = 1; i <= kSteps; ++i) {
      double t = static_cast<double>(i) / kSteps, s = t * t * (3 - 2 * t);
      OrbitCamera c = from;
      c.distance_mm = from.distance_mm * std::pow(distance_mm / from.distance_mm, s);
      double change = from.distance_mm - distance_mm;
      double rest = std::abs(change) < 1e-9 * distance_mm ? 1 - s : (c.distance_mm - distance_mm) / change;
      c.target_mm = point_mm + (from.target_mm - point_mm) * rest;
      add(seconds / kSteps, c);
    }
  }
  Flight finish(std::string name) { return {std::move(name), std::move(keys_)}; }

 private:
  void add(double seconds, const OrbitCamera& c) { keys_.push_back({keys_.back().time_s + seconds / speed_, c}); }

  double speed_;
  std::vector<FlightKey> keys_;
};

struct FlightStage {
  OrbitCamera whole;                  // all in view
  double close_mm = 0;                // distance of the close-ups
  double half_w = 0, half_h = 0;      // of the artwork, mm
  double screen_w = 0, screen_h = 0;  // of the plane seen from close by, mm
};
FlightStage stageFor(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale) {
  FlightStage s;
  s.whole = fitCamera(domain, width_px, height_px);
  double pixels_per_radian = height_px / (2 * std::tan(s.whole.fov_deg * std::numbers::pi / 360));
  s.close_mm = std::min(pixels_per_radian * domain.mm_per_px / scale.close_px, s.whole.distance_mm / 2);
  s.half_w = 0.5 * static_cast<double>(domain.width_px) * domain.mm_per_px;
  s.half_h = 0.5 * static_cast<double>(domain.height_px) * domain.mm_per_px;
  s.screen_h = s.close_mm * height_px / pixels_per_radian;
  s.screen_w = s.screen_h * width_px / height_px;
  return s;
}

constexpr double kStill_s = 0.5;
constexpr double kReading_s = 3;  // a screen's width

}  // namespace

OrbitCamera cameraAt(const Flight& flight, double time_s) {
  const auto& keys = flight.keys;
  if (keys.empty()) return {};
  if (!(time_s > keys.front().time_s)) return keys.front().camera;
  if (time_s >= keys.back().time_s) return keys.back().camera;
  auto next =
      std::upper_bound(keys.begin(), keys.end(), time_s, [](double t, const FlightKey& k) { return t < k.time_s; });
  auto i = static_cast<size_t>(next - keys.begin()) - 1;
  auto span = [&](size_t k) { return keys[k + 1].time_s - keys[k].time_s; };
  auto secant = [&](size_t k, int v) {
    return (valuesOf(keys[k + 1].camera)[v] - valuesOf(keys[k].camera)[v]) / span(k);
  };
  // At rest at both ends of the path.
  auto slope = [&](size_t k, int v) {
    return k == 0 || k + 1 == keys.size() ? 0 : monotoneSlope(secant(k - 1, v), secant(k, v), span(k - 1), span(k));
  };
  double h = span(i), t = (time_s - keys[i].time_s) / h;
  Values a = valuesOf(keys[i].camera), b = valuesOf(keys[i + 1].camera), at{};
  for (int v = 0; v < static_cast<int>(at.size()); ++v) {
    if (a[v] == b[v]) {
      at[v] = a[v];
      continue;
    }
    at[v] = cubicBetween(a[v], b[v], slope(i, v), slope(i + 1, v), h, t);
  }
  OrbitCamera camera = cameraOf(at);
  camera.orthographic = keys[i].camera.orthographic;
  if (keys[i].camera.distance_mm == keys[i + 1].camera.distance_mm)
    camera.distance_mm = keys[i].camera.distance_mm;  // not exp(log())
  return camera;
}

Flight orbitFlight(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale) {
  FlightStage s = stageFor(domain, width_px, height_px, scale);
  OrbitCamera c = s.whole;
  c.distance_mm = std::max(s.close_mm, 0.4 * s.whole.distance_mm);
  Path path(c, scale.speed);
  path.stay(kStill_s);
  constexpr int kSteps = 48;
  constexpr double kPeriod_s = 12;
  for (int i = 1; i <= kSteps; ++i) {
    double phase = 2 * std::numbers::pi * i / kSteps;
    OrbitCamera at = c;
    at.azimuth_deg = 55 * std::sin(phase);
    at.elevation_deg = 25 * std::sin(2 * phase);
    path.goTo(kPeriod_s / kSteps, at);
  }
  path.stay(kStill_s);
  return path.finish("orbit");
}

Flight readingFlight(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale) {
  FlightStage s = stageFor(domain, width_px, height_px, scale);
  double reach = std::max(0.0, s.half_w - 0.5 * s.screen_w), line = std::min(0.4 * s.half_h, 0.7 * s.screen_h);
  Path path(s.whole, scale.speed);
  path.stay(kStill_s);
  path.zoomTo(3, {-reach, line, 0}, s.close_mm);
  double line_s = kReading_s * std::max(0.25, 2 * reach / s.screen_w);
  OrbitCamera c = path.camera();
  for (double y : {line, 0.0}) {
    c.target_mm = {-reach, y, 0};
    if (y != line) path.goTo(kReading_s / 2, c);  // back to the line's start: twice as fast or more
    c.target_mm.x = reach;
    path.goTo(line_s, c);
  }
  path.zoomTo(2.5, {0, 0, 0}, s.whole.distance_mm);
  path.stay(kStill_s);
  return path.finish("reading");
}

Flight zoomFlight(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale) {
  FlightStage s = stageFor(domain, width_px, height_px, scale);
  glm::dvec3 a{-0.55 * s.half_w, 0.4 * s.half_h, 0}, b{0.5 * s.half_w, -0.45 * s.half_h, 0}, middle{0};
  double between_mm = std::sqrt(s.close_mm * s.whole.distance_mm);
  Path path(s.whole, scale.speed);
  path.stay(kStill_s);
  for (const glm::dvec3& spot : {a, b, a, b}) {
    path.zoomTo(2.5, spot, s.close_mm);
    path.stay(1);
    path.zoomTo(1.5, middle, between_mm);
    path.zoomTo(1, middle, s.whole.distance_mm);
  }
  path.stay(kStill_s);
  return path.finish("zoom");
}

Flight wanderFlight(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale) {
  FlightStage s = stageFor(domain, width_px, height_px, scale);
  OrbitCamera c = s.whole;
  c.azimuth_deg = -20;
  c.elevation_deg = 15;
  c.distance_mm = std::min(2.2 * s.close_mm, s.whole.distance_mm);
  c.target_mm = {0.6 * s.half_w, 0.55 * s.half_h, 0};
  Path path(c, scale.speed);
  path.stay(kStill_s);
  struct Leg {
    double seconds, x, y, azimuth, elevation,
        distance;  // the target in halves of the artwork, the distance in close-ups
  };
  for (const Leg& leg : {Leg{2.2, 0.1, 0.2, -35, 30, 1.3},
                         {0.7, 0.1, 0.2, -35, 30, 1.3},
                         {2.6, -0.5, 0.45, 10, 40, 1.1},
                         {1.8, -0.35, -0.3, 40, -10, 1.9},
                         {0.4, -0.35, -0.3, 40, -10, 1.9},
                         {2.0, 0.4, -0.5, 25, -35, 1.2},
                         {1.6, 0.55, 0.1, 0, 0, 3.0},
                         {2.4, 0.1, 0.2, -35, 30, 1.3}}) {
    c.target_mm = {leg.x * s.half_w, leg.y * s.half_h, 0};
    c.azimuth_deg = leg.azimuth;
    c.elevation_deg = leg.elevation;
    c.distance_mm = std::min(leg.distance * s.close_mm, s.whole.distance_mm);
    path.goTo(leg.seconds, c);
  }
  path.stay(kStill_s);
  return path.finish("wander");
}

}  // namespace relievo
