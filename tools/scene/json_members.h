// json_members.h - JSON objects whose members are declared: the declaration reads them, refuses what it does not know,
// and is the object's JSON Schema.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "src/base/result.h"

namespace relievo {

struct JsonMember {
  enum class Kind { kNumber, kWhole, kBool, kText, kChoice, kNumbers, kWholes, kObject, kObjects };
  std::string name;
  std::string meaning;  // for people, with the unit
  Kind kind = Kind::kNumber;
  double low = 0, high = 0;          // of numbers, both included
  size_t count = 1;                  // of kNumbers and kWholes
  std::vector<std::string> choices;  // of kChoice
  std::vector<int> among;            // of kWhole: these alone, in place of low and high, if there are any
  std::vector<JsonMember> members;   // of kObject
  // Of kObjects, a list of `least` to `most` objects: the members of the one with this index. All have the same
  // declaration.
  std::function<std::vector<JsonMember>(size_t index)> item;
  size_t least = 1, most = 1;
  bool needed = false;
  std::string beside;   // the member that must be there where this one is; empty: none
  std::string or_else;  // either this member is there or that one, and not both; empty: there is no such other
  // Called with a value of that kind and range; not of an object, whose members are taken one by one. Of a list of
  // objects it is called before those.
  std::function<void(const nlohmann::ordered_json&)> take;
};
using JsonMembers = std::vector<JsonMember>;

// Each writes to `to`, which outlives the member.
JsonMember numberMember(const char* name, const char* meaning, double low, double high, std::optional<double>& to);
JsonMember wholeMember(const char* name, const char* meaning, int low, int high, std::optional<int>& to);
JsonMember wholeMember(const char* name, const char* meaning, std::vector<int> among, std::optional<int>& to);
JsonMember boolMember(const char* name, const char* meaning, std::optional<bool>& to);
JsonMember textMember(const char* name, const char* meaning, std::string& to);
JsonMember choiceMember(const char* name, const char* meaning, std::vector<std::string> choices,
                        std::optional<std::string>& to);
JsonMember tripleMember(const char* name, const char* meaning, double low, double high,
                        std::optional<std::array<double, 3>>& to);
JsonMember sizeMember(const char* name, const char* meaning, int most, std::optional<std::array<int, 2>>& to);
JsonMember objectMember(const char* name, const char* meaning, JsonMembers members);
// count: how many there are.
// `resize` is called with the number of objects before `item` is called with their indices.
JsonMember objectsMember(const char* name, const char* meaning, size_t least, size_t most,
                         std::function<void(size_t)> resize, std::function<JsonMembers(size_t)> item);

// What the file of a format says of itself: "format" and "version", which must be there, and "about", any text.
struct JsonFormat {
  const char* name;   // "relievo-settings"
  const char* noun;   // "settings", as in "expected a settings file"
  int version = 1;    // the newest that is read; the first is 1
  const char* hint;   // where to look up what is known
  const char* newer;  // what to do about a newer one
};

// Reads the text of such a file. Errors name `file`: kInvalidData of text that is no JSON or no such file, unknown
// members, other types and values out of range; kUnsupported of newer versions. Safe for untrusted text.
Result<void> readJsonFile(std::string_view text, const JsonFormat& format, const JsonMembers& members,
                          const std::string& file);
// Reads the text of one member's value, such as an option's. Errors name no file.
Result<void> readJsonValue(std::string_view text, const JsonMember& member, const char* hint);
// Its JSON Schema (draft 2020-12).
std::string jsonSchema(const JsonFormat& format, const JsonMembers& members);

// For writing: a member where there is a value.
template <class Json, class T>
void putKnown(Json& object, const char* name, const std::optional<T>& value) {
  if (value) object[name] = *value;
}

}  // namespace relievo
