#include "tools/compare_path.h"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/flight.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxFileBytes = 64 << 20;
constexpr double kFrame_s = 1.0 / 60;

Result<std::vector<OrbitCamera>> camerasFromFile(const std::string& path, const PlanarDomain& domain, int width_px, int height_px) {
  auto text = readTextFile(path, kMaxFileBytes);
  if (!text) {
    Error e = text.error();
    e.hint = "--path is orbit, flyover, zoom or a JSON file of cameras";
    return e;
  }
  auto wrong = [&](const std::string& what) { return Error{ErrorKind::kInvalidData, path, what, "see relievo compare --help for the format", {}}; };
  auto json = nlohmann::json::parse(*text, nullptr, false);
  if (json.is_discarded() || !json.is_object() || !json.contains("cameras") || !json["cameras"].is_array())
    return wrong("expected a JSON object with an array 'cameras'");
  const auto& list = json["cameras"];
  if (list.empty() || list.size() > kMaxCameras) return wrong("expected 1 to " + std::to_string(kMaxCameras) + " cameras, found " + std::to_string(list.size()));
  std::vector<OrbitCamera> out;
  for (size_t k = 0; k < list.size(); ++k) {
    const auto& c = list[k];
    std::string where = "camera " + std::to_string(k) + ": ";
    if (!c.is_object()) return wrong(where + "expected an object");
    bool good = true;
    auto number = [&](const char* key, double otherwise) {
      if (!c.contains(key)) return otherwise;
      good = good && c[key].is_number() && std::isfinite(c[key].get<double>());
      return good ? c[key].get<double>() : otherwise;
    };
    OrbitCamera camera = fitCamera(domain, width_px, height_px, std::clamp(number("fov_deg", 35), 1.0, 170.0));
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
    if (good) camera.distance_mm = number("distance_mm", fitDistance(camera, domain, width_px, height_px));
    if (!good || !(camera.distance_mm > 0)) return wrong(where + "expected finite numbers, an elevation within -89 to 89 and a distance above 0");
    out.push_back(camera);
  }
  return out;
}

}  // namespace

Result<std::vector<CompareCamera>> compareCameras(const std::string& name, int frames, const PlanarDomain& domain, int width_px, int height_px) {
  std::vector<CompareCamera> out;
  Flight flight;
  if (name == "orbit") flight = orbitFlight(domain, width_px, height_px);
  if (name == "flyover") {
    flight = readingFlight(domain, width_px, height_px);
    for (FlightKey& key : flight.keys) key.camera.elevation_deg = kFlyoverTilt_deg;
  }
  if (name == "zoom") flight = zoomFlight(domain, width_px, height_px);
  if (flight.keys.empty()) {
    auto cameras = camerasFromFile(name, domain, width_px, height_px);
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

}  // namespace relievo
