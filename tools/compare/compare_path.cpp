#include "tools/compare/compare_path.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <optional>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "src/engine/engine.h"
#include "tools/bench/flight.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxFileBytes = 64 << 20;
constexpr double kFrame_s = 1.0 / 60;
// light: as `view --print-view` prints it; these figures are without.
constexpr std::array kCameraKeys{"azimuth_deg",  "elevation_deg", "distance_mm", "fov_deg",
                                 "orthographic", "target_mm",     "light"};

Result<std::vector<OrbitCamera>> camerasFromFile(const std::string& path, const Extent& extent, int width_px,
                                                 int height_px) {
  auto text = readTextFile(path, kMaxFileBytes);
  if (!text) {
    Error e = text.error();
    e.hint = "--path is orbit, flyover, zoom or a JSON file of cameras";
    return e;
  }
  auto wrong = [&](const std::string& what) {
    return Error{ErrorKind::kInvalidData, path, what, "see relievo compare --help for the format", {}};
  };
  auto json = parseJson(*text, path);
  if (!json) {
    Error e = json.error();
    e.hint = "see relievo compare --help for the format";
    return e;
  }
  if (!json->is_object() || !json->contains("cameras") || !(*json)["cameras"].is_array())
    return wrong("expected a JSON object with an array 'cameras'");
  const auto& list = (*json)["cameras"];
  if (list.empty() || list.size() > kMaxCameras)
    return wrong("expected 1 to " + std::to_string(kMaxCameras) + " cameras, found " + std::to_string(list.size()));
  std::vector<OrbitCamera> out;
  for (size_t k = 0; k < list.size(); ++k) {
    const auto& c = list[k];
    std::string where = "camera " + std::to_string(k) + ": ";
    if (!c.is_object()) return wrong(where + "expected an object");
    for (const auto& item : c.items()) {
      const std::string& key = item.key();
      if (std::none_of(kCameraKeys.begin(), kCameraKeys.end(), [&](const char* known) { return key == known; }))
        return wrong(where + "there is no '" + key.substr(0, 40) + "' of a camera");
    }
    bool good = true;
    auto number = [&](const char* key, double otherwise) {
      if (!c.contains(key)) return otherwise;
      good = good && c[key].is_number() && std::isfinite(c[key].get<double>());
      return good ? c[key].get<double>() : otherwise;
    };
    const double fov_deg = number("fov_deg", 35);
    if (good && !(fov_deg >= kMinFovDeg && fov_deg <= kMaxFovDeg))
      return wrong(where + "expected a field of view from 1 to 170 degrees");
    OrbitCamera camera = fitCamera(extent, width_px, height_px, fov_deg);
    if (c.contains("orthographic")) {
      good = good && c["orthographic"].is_boolean();
      camera.orthographic = good && c["orthographic"].get<bool>();
    }
    camera.azimuth_deg = number("azimuth_deg", 0);
    camera.elevation_deg = number("elevation_deg", 0);
    if (c.contains("target_mm")) {
      const auto& t = c["target_mm"];
      good = good && t.is_array() && t.size() == 3;
      for (int i = 0; good && i < 3; ++i) {
        good = t[static_cast<size_t>(i)].is_number();
        if (good) camera.target_mm[i] = t[static_cast<size_t>(i)].get<double>();
      }
    }
    good = good && std::abs(camera.elevation_deg) <= 89;
    if (good) camera.distance_mm = number("distance_mm", fitDistance(camera, extent, width_px, height_px));
    if (!good || !(camera.distance_mm > 0))
      return wrong(where +
                   "expected finite numbers (orthographic: true or false), an elevation within -89 to 89 and a "
                   "distance above 0");
    out.push_back(camera);
  }
  return out;
}

// Where a ray first meets the base mesh, each patch as two triangles.
std::optional<double> alongRay(const BaseMesh& mesh, const glm::dvec3& from, const glm::dvec3& direction) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& c : mesh.patches) {
    auto at = [&](size_t k) { return glm::dvec3(mesh.corners[c[k]].position_mm); };
    for (const auto& t : {std::array<size_t, 3>{0, 1, 3}, std::array<size_t, 3>{0, 3, 2}}) {
      const glm::dvec3 a = at(t[0]), u = at(t[1]) - a, v = at(t[2]) - a, n = glm::cross(u, v), p = a - from;
      const double steep = glm::dot(n, direction);
      if (steep == 0) continue;
      const glm::dvec3 w = glm::cross(direction, p) / steep;
      const double i = glm::dot(v, w), j = -glm::dot(u, w), along = glm::dot(n, p) / steep;
      if (i >= 0 && j >= 0 && i + j <= 1 && along > 0) nearest = std::min(nearest, along);
    }
  }
  if (!(nearest < std::numeric_limits<double>::infinity())) return {};
  return nearest;
}

// Flights around a body.
class BodyPath {
 public:
  BodyPath(const BaseMesh& mesh, const Extent& extent, int width_px, int height_px)
      : mesh_(mesh),
        extent_(extent),
        whole_(fitCamera(extent, width_px, height_px)),
        size_mm_(glm::length(extent.max_mm - extent.min_mm)) {
    for (double azimuth : {0.0, 90.0, 45.0}) {  // all in view from wherever
      OrbitCamera c = whole_;
      c.azimuth_deg = azimuth;
      whole_.distance_mm = std::max(whole_.distance_mm, fitDistance(c, extent, width_px, height_px));
    }
    // A sheet, or half a body, is looked at from the side that it faces; others from everywhere.
    glm::dvec3 facing(0);
    double area = 0;
    for (const auto& c : mesh.patches) {
      auto at = [&](size_t k) { return glm::dvec3(mesh.corners[c[k]].position_mm); };
      const glm::dvec3 n = glm::cross(at(2) - at(1), at(3) - at(0));
      facing += n;
      area += glm::length(n);
    }
    sheet_ = glm::length(facing) > 0.5 * area;
    if (sheet_) {
      facing = glm::normalize(facing);
      front_azimuth_deg_ = glm::degrees(std::atan2(facing.x, facing.z));
      front_elevation_deg_ = std::clamp(glm::degrees(std::asin(std::clamp(facing.y, -1.0, 1.0))), -60.0, 60.0);
    }
    // A texel a pixel, as flights over flat artworks have it; no nearer than a twelfth of it all.
    close_mm_ = std::clamp(height_px / (2 * std::tan(glm::radians(whole_.fov_deg) / 2)) * extent.texel_mm,
                           whole_.distance_mm / 12, whole_.distance_mm / 3);
  }
  Flight orbit() {
    OrbitCamera c = whole_;
    c.distance_mm *= 0.75;
    for (int k = 0; k <= 96; ++k) {
      const double phase = 2 * std::numbers::pi * k / 96;
      c.azimuth_deg = front_azimuth_deg_ + (sheet_ ? 55 * std::sin(phase) : 3.75 * k);
      c.elevation_deg = front_elevation_deg_ + 25 * std::sin(2 * phase);
      add(0.25, c);
    }
    return {"orbit", keys_};
  }
  Flight flyover() {
    OrbitCamera c = whole_;
    c.distance_mm = close_mm_;
    for (int k = 0; k <= 48; ++k) {
      const double turn = sheet_ ? 40 : 60;
      c.azimuth_deg = front_azimuth_deg_ - turn + 2 * turn * k / 48;
      c.target_mm = surfaceSeen(c.azimuth_deg, front_elevation_deg_, {0, 0});
      for (c.elevation_deg = -kFlyoverTilt_deg; c.elevation_deg > 0 && blocked(c); c.elevation_deg -= 10) {
      }
      add(0.25, c);
    }
    return {"flyover", keys_};
  }
  Flight zoom() {
    add(0, whole_);
    for (auto [turn, x, y] : {std::array{-20.0, -0.12, 0.1}, std::array{70.0, 0.05, -0.12},
                              std::array{160.0, 0.1, 0.05}, std::array{250.0, -0.05, -0.05}}) {
      OrbitCamera far = whole_, near = whole_;
      far.azimuth_deg = near.azimuth_deg = front_azimuth_deg_ + (sheet_ ? 40 * std::sin(glm::radians(turn)) : turn);
      far.elevation_deg = near.elevation_deg = front_elevation_deg_;
      near.target_mm = surfaceSeen(near.azimuth_deg, front_elevation_deg_, {x, y});
      near.distance_mm = close_mm_;
      OrbitCamera between = far;
      between.distance_mm = std::sqrt(far.distance_mm * near.distance_mm);
      between.target_mm = 0.5 * (far.target_mm + near.target_mm);
      for (const OrbitCamera& at : {far, between, near, near, between, far}) add(1, at);
    }
    return {"zoom", keys_};
  }

 private:
  void add(double seconds, const OrbitCamera& c) {
    keys_.push_back({keys_.empty() ? 0 : keys_.back().time_s + seconds, c});
  }
  // Of what is seen from there, beside the picture's middle by parts of the body's size.
  glm::dvec3 surfaceSeen(double azimuth_deg, double elevation_deg, const glm::dvec2& aside) const {
    OrbitCamera c;
    c.azimuth_deg = azimuth_deg;
    c.elevation_deg = elevation_deg;
    c.target_mm = extent_.centre();
    c.distance_mm = 2 * size_mm_;
    const glm::dvec3 back = (eyePosition(c) - c.target_mm) / c.distance_mm,
                     right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back)), up = glm::cross(back, right);
    for (const glm::dvec2& at : {aside, glm::dvec2(0)}) {
      const glm::dvec3 from = eyePosition(c) + size_mm_ * (at.x * right + at.y * up);
      if (auto along = alongRay(mesh_, from, -back)) return from - *along * back;
    }
    return c.target_mm;
  }
  bool blocked(const OrbitCamera& c) const {
    const glm::dvec3 way = (eyePosition(c) - c.target_mm) / c.distance_mm;
    const double clear = 0.02 * size_mm_;
    auto along = alongRay(mesh_, c.target_mm + clear * way, way);
    return along && *along < c.distance_mm;
  }

  const BaseMesh& mesh_;
  Extent extent_;
  OrbitCamera whole_;
  double size_mm_, close_mm_ = 0, front_azimuth_deg_ = 0, front_elevation_deg_ = 0;
  bool sheet_ = false;
  std::vector<FlightKey> keys_;
};

Result<std::vector<CompareCamera>> camerasOf(const std::string& name, const Flight& flight, int frames,
                                             const Extent& extent, int width_px, int height_px) {
  std::vector<CompareCamera> out;
  if (flight.keys.empty()) {
    auto cameras = camerasFromFile(name, extent, width_px, height_px);
    if (!cameras) return cameras.error();
    size_t count = frames == 0 ? cameras->size() : std::min<size_t>(static_cast<size_t>(frames), cameras->size());
    for (size_t k = 0; k < count; ++k) {
      size_t at = count == 1 ? 0 : k * (cameras->size() - 1) / (count - 1);
      out.push_back({(*cameras)[at], (*cameras)[at == 0 ? 0 : at - 1]});
    }
    return out;
  }
  if (frames == 0) frames = 24;
  for (int k = 0; k < frames; ++k) {
    double t = flight.duration_s() * (k + 0.5) / frames;
    out.push_back({cameraAt(flight, t), cameraAt(flight, t - kFrame_s)});
  }
  return out;
}

}  // namespace

Result<std::vector<CompareCamera>> compareCameras(const std::string& name, int frames, const Manifest& artwork,
                                                  int width_px, int height_px) {
  if (artwork.domain.isFlat()) return compareCameras(name, frames, artwork.domain.flat(), width_px, height_px);
  const Extent extent = artworkExtent(artwork);
  BodyPath path(*artwork.base, extent, width_px, height_px);
  Flight flight = name == "orbit"     ? path.orbit()
                  : name == "flyover" ? path.flyover()
                  : name == "zoom"    ? path.zoom()
                                      : Flight{};
  return camerasOf(name, flight, frames, extent, width_px, height_px);
}

Result<std::vector<CompareCamera>> compareCameras(const std::string& name, int frames, const FlatDomain& domain,
                                                  int width_px, int height_px) {
  Flight flight;
  if (name == "orbit") flight = orbitFlight(domain, width_px, height_px);
  if (name == "flyover") {
    flight = readingFlight(domain, width_px, height_px);
    for (FlightKey& key : flight.keys) key.camera.elevation_deg = kFlyoverTilt_deg;
  }
  if (name == "zoom") flight = zoomFlight(domain, width_px, height_px);
  return camerasOf(name, flight, frames, extentOf(domain), width_px, height_px);
}

}  // namespace relievo
