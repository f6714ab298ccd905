#include "tools/scene/animation_members.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "src/engine/effects/lights.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kFarthestKeyMm = 1e12;

JsonMember timeMember(std::optional<double>& to) {
  JsonMember time = numberMember("time_s", "When, seconds from the beginning", 0, kMaxSceneSeconds, to);
  time.needed = true;
  return time;
}

template <class Keys>
JsonMember keysMember(const char* name, const char* meaning, Keys& to,
                      JsonMembers (*members)(typename Keys::value_type&)) {
  return objectsMember(
      name, meaning, 2, kMaxSceneKeys, [&to](size_t count) { to.resize(count); },
      [&to, members](size_t i) {
        if (to.size() <= i) to.resize(i + 1);  // for the schema, where there are none
        return members(to[i]);
      });
}

JsonMembers membersOf(CameraKeyMembers& m) {
  CameraKey& k = m.key;
  return {timeMember(m.time_s),
          numberMember("azimuth_deg",
                       "As the camera's; within 180 degrees either way it goes the shorter way around, and 0 to 360 is "
                       "a whole turn",
                       -1e6, 1e6, k.azimuth_deg),
          numberMember("elevation_deg", "As the camera's", -89, 89, k.elevation_deg),
          numberMember("distance_mm", "As the camera's", 1e-9, kFarthestKeyMm, k.distance_mm),
          numberMember("fov_deg", "As the camera's", kMinFovDeg, kMaxFovDeg, k.fov_deg),
          numberMember("mm_per_px", "As the camera's, in place of distance_mm", 1e-12, 1e9, k.mm_per_px),
          tripleMember("target_mm", "As the camera's", -kFarthestKeyMm, kFarthestKeyMm, k.target_mm)};
}

JsonMembers membersOf(LightKeyMembers& m) {
  return {timeMember(m.time_s), tripleMember("towards", "As the light's, if it is far away", -1e9, 1e9, m.towards),
          tripleMember("position_mm", "As the light's, if it is near", -kFarthestKeyMm, kFarthestKeyMm, m.position_mm),
          numberMember("intensity", "As the light's", 0, kMaxLightIntensity, m.key.intensity),
          tripleMember("color", "As the light's", 0, 1, m.key.color)};
}

template <class Keys>
std::string problemOfTimes(const Keys& keys, const std::string& name, std::optional<double> duration_s) {
  for (size_t i = 0; i < keys.size(); ++i) {
    const std::string time = "'" + name + "[" + std::to_string(i) + "].time_s'";
    if (i > 0 && !(*keys[i].time_s > *keys[i - 1].time_s)) return time + " is not after the key before it";
    if (duration_s && *keys[i].time_s > *duration_s) return time + " is after 'duration_s'";
  }
  return "";
}

}  // namespace

JsonMember cameraPathMember(std::vector<CameraKeyMembers>& to) {
  return keysMember("camera_path", "The camera moves: where it is at times; what no key says is as in camera", to,
                    membersOf);
}
JsonMember lightKeysMember(std::vector<LightKeyMembers>& to) {
  return keysMember("keys", "The light moves or changes: how it is at times; what no key says is as beside them", to,
                    membersOf);
}

std::string problemOf(const std::vector<CameraKeyMembers>& path, std::optional<double> duration_s) {
  if (const std::string problem = problemOfTimes(path, "camera_path", duration_s); !problem.empty()) return problem;
  const auto has = [&](auto member) {
    return std::any_of(path.begin(), path.end(),
                       [&](const CameraKeyMembers& m) { return (m.key.*member).has_value(); });
  };
  if (has(&CameraKey::mm_per_px) && has(&CameraKey::distance_mm))
    return "'camera_path' has both distance_mm and mm_per_px: leave out one of them";
  if (has(&CameraKey::mm_per_px) && has(&CameraKey::fov_deg))
    return "'camera_path' has both fov_deg and mm_per_px: an orthographic picture has no field of view";
  return "";
}

std::string problemOf(const std::vector<LightKeyMembers>& keys, const std::string& name, bool near,
                      std::optional<double> duration_s) {
  const std::string list = name + ".keys";
  if (const std::string problem = problemOfTimes(keys, list, duration_s); !problem.empty()) return problem;
  const std::array<double, 3>* before = nullptr;
  for (size_t i = 0; i < keys.size(); ++i) {
    const std::string key = "'" + list + "[" + std::to_string(i) + "]";
    if (near && keys[i].towards) return key + ".towards' is of a light far away, and '" + name + "' is near";
    if (!near && keys[i].position_mm) return key + ".position_mm' is of a near light, and '" + name + "' is far away";
    if (!keys[i].towards) continue;
    if (*keys[i].towards == std::array<double, 3>{}) return "the light's direction is zero in " + key + "'";
    if (before && areOpposite(*before, *keys[i].towards))
      return key + ".towards' is opposite to the direction before it: say the way by a key between them";
    before = &*keys[i].towards;
  }
  return "";
}

SceneAnimation animationOf(const std::vector<CameraKeyMembers>& path,
                           const std::vector<std::vector<LightKeyMembers>>& lights, std::optional<double> duration_s) {
  SceneAnimation animation;
  double end_s = 0;
  for (const CameraKeyMembers& m : path) {
    animation.camera.push_back(m.key);
    animation.camera.back().time_s = *m.time_s;
    end_s = std::max(end_s, *m.time_s);
  }
  for (const auto& keys : lights) {
    animation.lights.emplace_back();
    for (const LightKeyMembers& m : keys) {
      LightKey key = m.key;
      key.time_s = *m.time_s;
      key.place = m.towards ? m.towards : m.position_mm;
      animation.lights.back().push_back(key);
      end_s = std::max(end_s, key.time_s);
    }
  }
  if (std::all_of(animation.lights.begin(), animation.lights.end(), [](const auto& keys) { return keys.empty(); }))
    animation.lights.clear();
  animation.duration_s = duration_s.value_or(end_s);
  return animation;
}

Json jsonOf(const CameraKey& key) {
  Json json = {{"time_s", key.time_s}};
  putKnown(json, "azimuth_deg", key.azimuth_deg);
  putKnown(json, "elevation_deg", key.elevation_deg);
  putKnown(json, "distance_mm", key.distance_mm);
  putKnown(json, "fov_deg", key.fov_deg);
  putKnown(json, "mm_per_px", key.mm_per_px);
  putKnown(json, "target_mm", key.target_mm);
  return json;
}

Json jsonOf(const LightKey& key, bool near) {
  Json json = {{"time_s", key.time_s}};
  if (key.place) json[near ? "position_mm" : "towards"] = *key.place;
  if (key.intensity) json["intensity"] = *key.intensity;
  if (key.color) json["color"] = *key.color;
  return json;
}

}  // namespace relievo
