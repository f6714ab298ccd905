// settings_file.h - a file of rendering settings that stand between accuracy and time: what `relievo accuracy` writes,
// and --settings of render, view and compare reads. JSON, a flat object:
//
//   {"format": "relievo-settings", "version": 1, "about": "any text", "error_px": 1, "least_cell": 2, ...}
//
// "format" and "version" must be there; every other member may be left out, and then means "as without the file".
// Unknown members, other types and values out of range are refused (kInvalidData, exit code 3), newer versions, too
// (kUnsupported, exit code 5). Safe for untrusted text.
#pragma once

#include <optional>
#include <string>

#include "src/base/result.h"
#include "tools/scene/json_members.h"

namespace relievo {

inline constexpr int kSettingsVersion = 1;

// The units are those of the options of the same names (relievo render --help).
struct DrawSettings {
  std::optional<double> error_px;     // geometric error aimed at, px
  std::optional<double> least_cell;   // no narrower triangles than this many error_px
  std::optional<double> detail_bias;  // texture levels coarser than a pixel asks for
  std::optional<std::string> sampling, filter;
  std::optional<int> anisotropy;         // taps
  std::optional<int> feedback_scale;     // px of the picture a px of the feedback pass, along each side
  std::optional<int> feedback_interval;  // frames
  std::optional<bool> prefetch;
  std::optional<double> cache_mib;  // MiB
  friend bool operator==(const DrawSettings&, const DrawSettings&) = default;
};

// The members of a settings object, which take their values to `to`.
JsonMembers settingsMembers(DrawSettings& to);
// The text of a settings file. about: left out where it is empty.
std::string settingsText(const DrawSettings& settings, const std::string& about);
// name: of the file, for errors.
Result<DrawSettings> parseSettings(const std::string& text, const std::string& name);
Result<DrawSettings> readSettings(const std::string& path);

}  // namespace relievo
