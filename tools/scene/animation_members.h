// animation_members.h - the keys of a scene's camera path and lights as JSON (src/engine/scene_animation.h): read,
// checked and written.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "src/engine/scene_animation.h"
#include "tools/scene/json_members.h"

namespace relievo {

inline constexpr size_t kMaxSceneKeys = 1000;  // of the camera and of each light
inline constexpr double kMaxSceneSeconds = 86400;

// Keys as they are written.
struct CameraKeyMembers {
  std::optional<double> time_s;
  CameraKey key;
};
struct LightKeyMembers {
  std::optional<double> time_s;
  std::optional<std::array<double, 3>> towards, position_mm;
  LightKey key;
};

// Each outlives its member.
JsonMember cameraPathMember(std::vector<CameraKeyMembers>& to);
JsonMember lightKeysMember(std::vector<LightKeyMembers>& to);

// What is wrong with keys, beside what their declaration says; empty: nothing. duration_s: as it is written. name: of
// the light, which is near or not.
std::string problemOf(const std::vector<CameraKeyMembers>& path, std::optional<double> duration_s);
std::string problemOf(const std::vector<LightKeyMembers>& keys, const std::string& name, bool near,
                      std::optional<double> duration_s);
// Without a duration_s the last key's time ends it. lights: the keys of each.
SceneAnimation animationOf(const std::vector<CameraKeyMembers>& path,
                           const std::vector<std::vector<LightKeyMembers>>& lights, std::optional<double> duration_s);

nlohmann::ordered_json jsonOf(const CameraKey& key);
nlohmann::ordered_json jsonOf(const LightKey& key, bool near);

}  // namespace relievo
