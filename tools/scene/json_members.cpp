#include "tools/scene/json_members.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "src/base/json_parse.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

std::string listOf(const std::vector<std::string>& names) {
  std::string out;
  for (const std::string& name : names) out += (out.empty() ? "" : ", ") + name;
  return out;
}

bool inRange(const Json& value, const JsonMember& m) {
  // As a double, so that no number is too large to be looked at.
  return value.is_number() && value.get<double>() >= m.low && value.get<double>() <= m.high;
}

// As JSON Schema counts, 8.0 is one, too.
bool isWhole(const Json& value) { return value.is_number() && value.get<double>() == std::floor(value.get<double>()); }

// What was expected; empty: the value is good.
std::string expectedOf(const JsonMember& m, const Json& value) {
  char text[120];
  switch (m.kind) {
    case JsonMember::Kind::kNumber:
      if (inRange(value, m)) return "";
      std::snprintf(text, sizeof text, "a number from %g to %g", m.low, m.high);
      return text;
    case JsonMember::Kind::kWhole:
      if (!m.among.empty()) {
        if (value.is_number() && std::find(m.among.begin(), m.among.end(), value.get<double>()) != m.among.end())
          return "";
        return "one of " + Json(m.among).dump();
      }
      if (isWhole(value) && inRange(value, m)) return "";
      std::snprintf(text, sizeof text, "a whole number from %g to %g", m.low, m.high);
      return text;
    case JsonMember::Kind::kNumbers:
    case JsonMember::Kind::kWholes: {
      const bool whole = m.kind == JsonMember::Kind::kWholes;
      if (value.is_array() && value.size() == m.count && std::all_of(value.begin(), value.end(), [&](const Json& v) {
            return inRange(v, m) && (!whole || isWhole(v));
          }))
        return "";
      std::snprintf(text, sizeof text, "%zu%s numbers from %g to %g", m.count, whole ? " whole" : "", m.low, m.high);
      return text;
    }
    case JsonMember::Kind::kBool:
      return value.is_boolean() ? "" : "true or false";
    case JsonMember::Kind::kText:
      return value.is_string() ? "" : "a text";
    case JsonMember::Kind::kObject:
      return value.is_object() ? "" : "an object";
    case JsonMember::Kind::kObjects:
      if (value.is_array() && value.size() >= m.least && value.size() <= m.most) return "";
      std::snprintf(text, sizeof text, "a list of %zu to %zu objects", m.least, m.most);
      return text;
    case JsonMember::Kind::kChoice:
      break;
  }
  const bool known =
      value.is_string() && std::find(m.choices.begin(), m.choices.end(), value.get<std::string>()) != m.choices.end();
  return known ? "" : "one of " + listOf(m.choices);
}

// What errors say of a text: its file, and where to look up what is known.
struct JsonOrigin {
  std::string file;
  const char* hint;
  Error invalid(const std::string& what) const { return {ErrorKind::kInvalidData, file, what, hint, {}}; }
};

Result<void> readMembers(const Json& object, const JsonMembers& members, const std::string& within,
                         const JsonOrigin& origin);

// name: of the value, with what it lies within.
Result<void> readValue(const Json& value, const JsonMember& m, const std::string& name, const JsonOrigin& origin) {
  if (const std::string expected = expectedOf(m, value); !expected.empty())
    return origin.invalid("expected " + expected + " for '" + name + "'");
  if (m.kind == JsonMember::Kind::kObject) return readMembers(value, m.members, name + ".", origin);
  if (m.take) m.take(value);
  for (size_t i = 0; m.kind == JsonMember::Kind::kObjects && i < value.size(); ++i) {
    const std::string item = name + "[" + std::to_string(i) + "]";
    if (!value[i].is_object()) return origin.invalid("expected an object for '" + item + "'");
    if (auto read = readMembers(value[i], m.item(i), item + ".", origin); !read) return read;
  }
  return {};
}

// Members nest as deep as their declaration does.
Result<void> readMembers(const Json& object, const JsonMembers& members, const std::string& within,
                         const JsonOrigin& origin) {
  for (const auto& item : object.items()) {
    const std::string& key = item.key();
    if (within.empty() && (key == "format" || key == "version")) continue;
    const auto m = std::find_if(members.begin(), members.end(), [&](const JsonMember& one) { return one.name == key; });
    if (m == members.end()) {
      std::vector<std::string> known;
      for (const JsonMember& one : members) known.push_back(one.name);
      return origin.invalid("there is no '" + within + key.substr(0, 40) + "'; known are " + listOf(known));
    }
    if (auto read = readValue(item.value(), *m, within + key, origin); !read) return read;
  }
  for (const JsonMember& m : members)
    if (!m.beside.empty() && object.contains(m.name) && !object.contains(m.beside))
      return origin.invalid("'" + within + m.name + "' needs '" + within + m.beside + "' beside it");
  for (const JsonMember& m : members) {
    if (m.or_else.empty() || object.contains(m.name) != object.contains(m.or_else)) continue;
    if (!object.contains(m.name)) return origin.invalid("'" + within + m.name + "' is missing");
    return origin.invalid("'" + within + m.or_else + "' takes the place of '" + within + m.name +
                          "': leave out one of them");
  }
  for (const JsonMember& m : members)
    if (m.needed && !object.contains(m.name)) return origin.invalid("'" + within + m.name + "' is missing");
  return {};
}

Json schemaOfMember(const JsonMember& m);

Json schemaOfObject(const JsonMembers& members, Json schema) {
  schema["type"] = "object";
  schema["additionalProperties"] = false;
  Json properties = schema.contains("properties") ? schema["properties"] : Json::object();
  Json required = schema.contains("required") ? schema["required"] : Json::array();
  for (const JsonMember& m : members) {
    properties[m.name] = schemaOfMember(m);
    if (m.needed) required.push_back(m.name);
    if (!m.or_else.empty())
      schema["oneOf"] = {{{"required", Json::array({m.name})}}, {{"required", Json::array({m.or_else})}}};
    if (!m.beside.empty()) schema["dependentRequired"][m.name] = {m.beside};
  }
  schema["properties"] = std::move(properties);
  if (!required.empty()) schema["required"] = std::move(required);
  return schema;
}

Json schemaOfMember(const JsonMember& m) {
  Json schema = {{"description", m.meaning}};
  const auto range = [&](const char* type) {
    if (m.kind == JsonMember::Kind::kWhole || m.kind == JsonMember::Kind::kWholes)
      return Json{{"type", type}, {"minimum", std::llround(m.low)}, {"maximum", std::llround(m.high)}};
    return Json{{"type", type}, {"minimum", m.low}, {"maximum", m.high}};
  };
  switch (m.kind) {
    case JsonMember::Kind::kNumber:
      schema.update(range("number"));
      break;
    case JsonMember::Kind::kWhole:
      if (!m.among.empty()) schema["enum"] = m.among;
      else schema.update(range("integer"));
      break;
    case JsonMember::Kind::kNumbers:
    case JsonMember::Kind::kWholes:
      schema.update(Json{{"type", "array"},
                         {"items", range(m.kind == JsonMember::Kind::kWholes ? "integer" : "number")},
                         {"minItems", m.count},
                         {"maxItems", m.count}});
      break;
    case JsonMember::Kind::kBool:
      schema["type"] = "boolean";
      break;
    case JsonMember::Kind::kText:
      schema["type"] = "string";
      break;
    case JsonMember::Kind::kChoice:
      schema["enum"] = m.choices;
      break;
    case JsonMember::Kind::kObject:
      return schemaOfObject(m.members, std::move(schema));
    case JsonMember::Kind::kObjects:
      schema.update(Json{{"type", "array"},
                         {"items", schemaOfObject(m.item(0), Json::object())},
                         {"minItems", m.least},
                         {"maxItems", m.most}});
      break;
  }
  return schema;
}

JsonMember member(const char* name, const char* meaning, JsonMember::Kind kind) {
  JsonMember m;
  m.name = name;
  m.meaning = meaning;
  m.kind = kind;
  return m;
}

}  // namespace

JsonMember numberMember(const char* name, const char* meaning, double low, double high, std::optional<double>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kNumber);
  m.low = low, m.high = high;
  m.take = [&to](const Json& v) { to = v.get<double>(); };
  return m;
}

JsonMember wholeMember(const char* name, const char* meaning, int low, int high, std::optional<int>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kWhole);
  m.low = low, m.high = high;
  m.take = [&to](const Json& v) { to = v.get<int>(); };
  return m;
}

JsonMember wholeMember(const char* name, const char* meaning, std::vector<int> among, std::optional<int>& to) {
  JsonMember m = wholeMember(name, meaning, 0, 0, to);
  m.among = std::move(among);
  return m;
}

JsonMember boolMember(const char* name, const char* meaning, std::optional<bool>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kBool);
  m.take = [&to](const Json& v) { to = v.get<bool>(); };
  return m;
}

JsonMember textMember(const char* name, const char* meaning, std::string& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kText);
  m.take = [&to](const Json& v) { to = v.get<std::string>(); };
  return m;
}

JsonMember choiceMember(const char* name, const char* meaning, std::vector<std::string> choices,
                        std::optional<std::string>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kChoice);
  m.choices = std::move(choices);
  m.take = [&to](const Json& v) { to = v.get<std::string>(); };
  return m;
}

JsonMember tripleMember(const char* name, const char* meaning, double low, double high,
                        std::optional<std::array<double, 3>>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kNumbers);
  m.low = low, m.high = high, m.count = 3;
  m.take = [&to](const Json& v) { to = v.get<std::array<double, 3>>(); };
  return m;
}

JsonMember sizeMember(const char* name, const char* meaning, int most, std::optional<std::array<int, 2>>& to) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kWholes);
  m.low = 1, m.high = most, m.count = 2;
  m.take = [&to](const Json& v) { to = {v[0].get<int>(), v[1].get<int>()}; };
  return m;
}

JsonMember objectMember(const char* name, const char* meaning, JsonMembers members) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kObject);
  m.members = std::move(members);
  return m;
}

JsonMember objectsMember(const char* name, const char* meaning, size_t least, size_t most,
                         std::function<void(size_t)> resize, std::function<JsonMembers(size_t)> item) {
  JsonMember m = member(name, meaning, JsonMember::Kind::kObjects);
  m.least = least, m.most = most;
  m.take = [resize = std::move(resize)](const Json& v) { resize(v.size()); };
  m.item = std::move(item);
  return m;
}

Result<void> readJsonValue(std::string_view text, const JsonMember& member, const char* hint) {
  auto json = parseJson(text, "");
  if (!json) {
    Error error = json.error();
    error.hint = hint;
    return error;
  }
  return readValue(*json, member, member.name, {"", hint});
}

Result<void> readJsonFile(std::string_view text, const JsonFormat& format, const JsonMembers& members,
                          const std::string& file) {
  auto json = parseJson(text, file);
  if (!json) {
    Error error = json.error();
    error.hint = format.hint;
    return error;
  }
  const auto invalid = [&](const std::string& what) {
    return Error{ErrorKind::kInvalidData, file, what, format.hint, {}};
  };
  if (!json->is_object() || !json->contains("format") || (*json)["format"] != format.name)
    return invalid(std::string("expected a ") + format.noun + " file: a JSON object with \"format\": \"" + format.name +
                   "\"");
  const Json version = json->contains("version") ? (*json)["version"] : Json();
  if (!version.is_number_integer() || version.get<double>() < 1)
    return invalid("expected a whole number from 1 for 'version'");
  if (version.get<double>() > format.version)
    return Error{ErrorKind::kUnsupported,
                 file,
                 std::string("the ") + format.noun + " file has version " + version.dump() +
                     "; this program reads up to version " + std::to_string(format.version),
                 format.newer,
                 {}};
  return readMembers(*json, members, "", {file, format.hint});
}

std::string jsonSchema(const JsonFormat& format, const JsonMembers& members) {
  Json schema = {{"$schema", "https://json-schema.org/draft/2020-12/schema"}, {"title", format.name}};
  schema["properties"] = {{"format", {{"const", format.name}}},
                          {"version", {{"type", "integer"}, {"minimum", 1}, {"maximum", format.version}}}};
  schema["required"] = {"format", "version"};
  return schemaOfObject(members, std::move(schema)).dump(2) + "\n";
}

}  // namespace relievo
