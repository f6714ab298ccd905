#include "src/base/foreign_format.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <string_view>
#include <vector>

#include "src/base/file.h"

namespace relievo {
namespace {

namespace fs = std::filesystem;

std::string beginning(const std::string& path, size_t most) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) return {};
  auto file = InputFile::open(path);
  if (!file) return {};
  std::vector<uint8_t> bytes(std::min<uint64_t>(file->size(), most));
  if (!file->read(0, bytes)) return {};
  return {bytes.begin(), bytes.end()};
}

// The string that a member of a JSON text has, wherever it stands; empty: none. No parser: the text may be anything.
std::string memberText(std::string_view json, std::string_view key) {
  const std::string quoted = "\"" + std::string(key) + "\"";
  for (size_t at = json.find(quoted); at != std::string_view::npos; at = json.find(quoted, at + 1)) {
    size_t i = json.find_first_not_of(" \t\r\n", at + quoted.size());
    if (i == std::string_view::npos || json[i] != ':') continue;
    i = json.find_first_not_of(" \t\r\n", i + 1);
    if (i == std::string_view::npos || json[i] != '"') continue;
    return std::string(json.substr(i + 1, std::min<size_t>(json.find('"', i + 1) - i - 1, 20)));
  }
  return {};
}

// The text of an info.json of relight: "bilinear, mrgb"; empty: it is none.
std::string relightKind(const std::string& json) {
  auto has = [&](std::string_view key) { return json.find("\"" + std::string(key) + "\"") != std::string::npos; };
  const std::string type = memberText(json, "type"), colours = memberText(json, "colorspace");
  if (json.find_first_not_of(" \t\r\n") == std::string::npos || json[json.find_first_not_of(" \t\r\n")] != '{')
    return {};
  if (type.empty() || colours.empty() || !(has("nplanes") || has("materials"))) return {};
  return type + ", " + colours;
}

// The kind of an .rti file by its first line that is no comment; empty: none.
std::string rtiKind(const std::string& text) {
  size_t at = 0;
  while (at < text.size() && text[at] == '#') {
    at = text.find('\n', at);
    at = at == std::string::npos ? text.size() : at + 1;
  }
  const size_t end = text.find_first_of("\r\n \t", at);
  const std::string number = text.substr(at, end == std::string::npos ? end : end - at);
  return number == "1"   ? "PTM"
         : number == "2" ? "spherical harmonics"
         : number == "3" ? "HSH"
         : number == "4" ? "adaptive PTM"
                         : "";
}

}  // namespace

std::optional<Error> foreignFormat(const std::string& path) {
  constexpr size_t kInfoBytes = size_t{1} << 20;
  auto refuse = [&](const std::string& what, const char* hint) {
    return Error{ErrorKind::kUnsupported, path, what, hint, {}};
  };
  constexpr const char* kSavePtm = "have the program that made it write a .ptm (LRGB or RGB)";
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) {
    const std::string kind = relightKind(beginning((fs::path(path) / "info.json").string(), kInfoBytes));
    if (kind.empty()) return {};
    return refuse("a relight folder (" + kind + ") is unsupported", kSavePtm);
  }
  std::string extension = fs::path(path).extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  if (extension == ".json") {
    const std::string kind = relightKind(beginning(path, kInfoBytes));
    if (!kind.empty()) return refuse("the info.json of a relight folder (" + kind + ") is unsupported", kSavePtm);
    return {};
  }
  const std::string text = beginning(path, 4096);
  if (text.empty()) return {};
  if (extension == ".rti" || text.starts_with("#HSH") || text.starts_with("#RTI")) {
    const std::string kind = rtiKind(text);
    return refuse("an .rti file" + (kind.empty() ? std::string() : " (" + kind + ")") + " is unsupported", kSavePtm);
  }
  if (extension == ".hsh") return refuse("an .hsh file (hemispherical harmonics) is unsupported", kSavePtm);
  if (extension == ".lp" || extension == ".dome")
    return refuse("a list of light directions (" + extension + ") is unsupported",
                  "fit a .ptm to its photographs with another program");
  return {};
}

}  // namespace relievo
