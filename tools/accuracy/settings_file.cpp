#include "tools/accuracy/settings_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <span>
#include <string_view>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "src/engine/engine.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint64_t kMaxSettingsBytes = 1 << 16;
constexpr const char* kFormat = "relievo-settings";
constexpr const char* kHint = "relievo accuracy writes such files; tools/README.md lists their members";

struct NumberMember {
  const char* name;
  std::optional<double> DrawSettings::*value;
  double low, high;
};
constexpr std::array kNumbers{NumberMember{"error_px", &DrawSettings::error_px, 0, 10000},
                              NumberMember{"least_cell", &DrawSettings::least_cell, 0, 100},
                              NumberMember{"detail_bias", &DrawSettings::detail_bias, 0, kMaxSceneDetailBias},
                              NumberMember{"cache_mib", &DrawSettings::cache_mib, 0.1, 65536}};

struct CountMember {
  const char* name;
  std::optional<int> DrawSettings::*value;
  int low, high;
};
constexpr std::array kCounts{
    CountMember{"anisotropy", &DrawSettings::anisotropy, 1, kMaxAnisotropy},
    CountMember{"feedback_scale", &DrawSettings::feedback_scale, 1, kMaxFeedbackScale},
    CountMember{"feedback_interval", &DrawSettings::feedback_interval, 1, kMaxFeedbackInterval}};

constexpr std::array<std::string_view, 4> kSamplings{"nearest", "bilinear", "trilinear", "anisotropic"};
constexpr std::array<std::string_view, 2> kFilters{"exact", "fast"};
struct ChoiceMember {
  const char* name;
  std::optional<std::string> DrawSettings::*value;
  std::span<const std::string_view> choices;
};
constexpr std::array kChoices{ChoiceMember{"sampling", &DrawSettings::sampling, kSamplings},
                              ChoiceMember{"filter", &DrawSettings::filter, kFilters}};

std::string namesOf(std::span<const std::string_view> choices) {
  std::string out;
  for (std::string_view c : choices) out += (out.empty() ? "" : ", ") + std::string(c);
  return out;
}

Error invalid(const std::string& file, const std::string& what, const std::string& hint = kHint) {
  return {ErrorKind::kInvalidData, file, what, hint, {}};
}

// Is this one of the members with a value? Takes it, or says what is wrong with it.
Result<bool> takeMember(const std::string& key, const Json& value, const std::string& file, DrawSettings& out) {
  char text[160];
  auto outOfRange = [&](double low, double high, const char* kind) {
    std::snprintf(text, sizeof text, "expected %s from %g to %g for '%s'", kind, low, high, key.c_str());
    return invalid(file, text);
  };
  for (const NumberMember& m : kNumbers) {
    if (key != m.name) continue;
    if (!value.is_number() || !(value.get<double>() >= m.low && value.get<double>() <= m.high))
      return outOfRange(m.low, m.high, "a number");
    out.*m.value = value.get<double>();
    return true;
  }
  for (const CountMember& m : kCounts) {
    if (key != m.name) continue;
    // As a double, so that no number is too large to be looked at.
    if (!value.is_number_integer() || !(value.get<double>() >= m.low && value.get<double>() <= m.high))
      return outOfRange(m.low, m.high, "a whole number");
    out.*m.value = value.get<int>();
    return true;
  }
  for (const ChoiceMember& m : kChoices) {
    if (key != m.name) continue;
    const std::string choice = value.is_string() ? value.get<std::string>() : "";
    if (std::find(m.choices.begin(), m.choices.end(), choice) == m.choices.end())
      return invalid(file, "expected one of " + namesOf(m.choices) + " for '" + key + "'");
    out.*m.value = choice;
    return true;
  }
  if (key != "prefetch") return false;
  if (!value.is_boolean()) return invalid(file, "expected true or false for 'prefetch'");
  out.prefetch = value.get<bool>();
  return true;
}

Result<void> checkVersion(const Json& json, const std::string& file) {
  if (!json.is_object() || !json.contains("format") || json["format"] != kFormat)
    return invalid(file, "expected a settings file: a JSON object with \"format\": \"relievo-settings\"");
  if (!json.contains("version") || !json["version"].is_number_integer() || json["version"].get<double>() < 1)
    return invalid(file, "expected a whole number from 1 for 'version'");
  if (json["version"].get<double>() > kSettingsVersion)
    return Error{ErrorKind::kUnsupported,
                 file,
                 "the settings have version " + json["version"].dump() + "; this program reads up to version " +
                     std::to_string(kSettingsVersion),
                 "use a newer relievo, or run relievo accuracy again",
                 {}};
  return {};
}

}  // namespace

std::string settingsText(const DrawSettings& settings, const std::string& about) {
  Json json = {{"format", kFormat}, {"version", kSettingsVersion}};
  if (!about.empty()) json["about"] = about;
  for (const NumberMember& m : kNumbers)
    if (settings.*m.value) json[m.name] = *(settings.*m.value);
  for (const ChoiceMember& m : kChoices)
    if (settings.*m.value) json[m.name] = *(settings.*m.value);
  for (const CountMember& m : kCounts)
    if (settings.*m.value) json[m.name] = *(settings.*m.value);
  if (settings.prefetch) json["prefetch"] = *settings.prefetch;
  return json.dump(2) + "\n";
}

Result<DrawSettings> parseSettings(const std::string& text, const std::string& name) {
  auto json = parseJson(text, name);
  if (!json) {
    Error error = json.error();
    error.hint = kHint;
    return error;
  }
  if (auto good = checkVersion(*json, name); !good) return good.error();
  DrawSettings out;
  for (const auto& member : json->items()) {
    const std::string& key = member.key();
    if (key == "format" || key == "version") continue;
    if (key == "about") {
      if (!member.value().is_string()) return invalid(name, "expected a text for 'about'");
      continue;
    }
    auto taken = takeMember(key, member.value(), name, out);
    if (!taken) return taken.error();
    if (!*taken) return invalid(name, "there is no setting '" + key.substr(0, 40) + "'");
  }
  return out;
}

Result<DrawSettings> readSettings(const std::string& path) {
  auto text = readTextFile(path, kMaxSettingsBytes);
  if (!text) return text.error();
  return parseSettings(*text, path);
}

}  // namespace relievo
