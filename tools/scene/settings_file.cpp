#include "tools/scene/settings_file.h"

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/engine/engine.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxSettingsBytes = 1 << 16;
constexpr JsonFormat kSettingsFormat{"relievo-settings", "settings", kSettingsVersion,
                                     "relievo accuracy writes such files; tools/README.md lists their members",
                                     "use a newer relievo, or run relievo accuracy again"};

}  // namespace

JsonMembers settingsMembers(DrawSettings& to) {
  return {
      numberMember("error_px", "Geometric error to aim at on screen, px", 0, 10000, to.error_px),
      numberMember("least_cell", "No narrower triangles on screen than so many error_px", 0, 100, to.least_cell),
      numberMember("detail_bias", "Texture levels coarser than the pixels ask for", 0, kMaxSceneDetailBias,
                   to.detail_bias),
      choiceMember("sampling", "Texels and levels a pixel reads",
                   {"nearest", "bilinear", "trilinear", "anisotropic", "auto"}, to.sampling),
      wholeMember("anisotropy", "Taps a pixel at most, with anisotropic sampling", 1, kMaxAnisotropy, to.anisotropy),
      choiceMember("filter", "Texture filter: full precision, or the texture unit's", {"exact", "fast"}, to.filter),
      wholeMember("feedback_scale", "Width and height of the picture over those of the feedback pass", 1,
                  kMaxFeedbackScale, to.feedback_scale),
      wholeMember("feedback_interval", "Frames from one feedback pass to the next", 1, kMaxFeedbackInterval,
                  to.feedback_interval),
      boolMember("prefetch", "Read what a moving camera is about to want", to.prefetch),
      numberMember("cache_mib", "Page cache for all planes together, MiB", 0.1, 65536, to.cache_mib)};
}

std::string settingsText(const DrawSettings& s, const std::string& about) {
  nlohmann::ordered_json json = {{"format", kSettingsFormat.name}, {"version", kSettingsVersion}};
  if (!about.empty()) json["about"] = about;
  putKnown(json, "error_px", s.error_px);
  putKnown(json, "least_cell", s.least_cell);
  putKnown(json, "detail_bias", s.detail_bias);
  putKnown(json, "cache_mib", s.cache_mib);
  putKnown(json, "sampling", s.sampling);
  putKnown(json, "filter", s.filter);
  putKnown(json, "anisotropy", s.anisotropy);
  putKnown(json, "feedback_scale", s.feedback_scale);
  putKnown(json, "feedback_interval", s.feedback_interval);
  putKnown(json, "prefetch", s.prefetch);
  return json.dump(2) + "\n";
}

Result<DrawSettings> parseSettings(const std::string& text, const std::string& name) {
  DrawSettings out;
  std::string about;
  JsonMembers members = settingsMembers(out);
  members.push_back(textMember("about", "Any text", about));
  if (auto read = readJsonFile(text, kSettingsFormat, members, name); !read) return read.error();
  return out;
}

Result<DrawSettings> readSettings(const std::string& path) {
  auto text = readTextFile(path, kMaxSettingsBytes);
  if (!text) return text.error();
  return parseSettings(*text, path);
}

}  // namespace relievo
