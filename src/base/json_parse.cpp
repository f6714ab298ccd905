#include "src/base/json_parse.h"

#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

namespace relievo {
namespace {

// Where the text exceeds the limits, and how. Brackets and commas count outside strings only; whether the rest is JSON
// is the parser's concern.
std::optional<Error> beyondLimits(std::string_view text, const std::string& file, int max_depth) {
  std::vector<size_t> members;  // of each array or object around this place, so far; arrays do not count
  size_t values = 1, comparisons = 0;
  bool in_string = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      in_string = c != '"';
      continue;
    }
    if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (members.size() >= static_cast<size_t>(max_depth))
        return Error{ErrorKind::kInvalidData, file,
                     "expected JSON of at most " + std::to_string(max_depth) + " levels, found more", "", i};
      members.push_back(0);
      ++values;
    } else if (c == '}' || c == ']') {
      if (!members.empty()) members.pop_back();
    } else if (c == ',') {
      ++values;
    } else if (c == ':' && !members.empty()) {
      comparisons += members.back();
      if (++members.back() > kMaxJsonMembers)
        return Error{ErrorKind::kInvalidData, file,
                     "expected JSON objects of at most " + std::to_string(kMaxJsonMembers) + " members, found more", "",
                     i};
      if (comparisons > kMaxJsonComparisons)
        return Error{ErrorKind::kInvalidData, file, "too many of its JSON objects have hundreds of members", "", i};
    }
    if (values > kMaxJsonValues)
      return Error{ErrorKind::kInvalidData, file,
                   "expected JSON of at most " + std::to_string(kMaxJsonValues) + " values, found more", "", i};
  }
  return {};
}

// Keeps nothing but the place of the first error.
struct ErrorPlace final : nlohmann::json_sax<nlohmann::ordered_json> {
  size_t byte = 0;
  bool null() override { return true; }
  bool boolean(bool) override { return true; }
  bool number_integer(number_integer_t) override { return true; }
  bool number_unsigned(number_unsigned_t) override { return true; }
  bool number_float(number_float_t, const string_t&) override { return true; }
  bool string(string_t&) override { return true; }
  bool binary(binary_t&) override { return true; }
  bool start_object(std::size_t) override { return true; }
  bool key(string_t&) override { return true; }
  bool end_object() override { return true; }
  bool start_array(std::size_t) override { return true; }
  bool end_array() override { return true; }
  bool parse_error(std::size_t position, const std::string&, const nlohmann::detail::exception&) override {
    byte = position > 0 ? position - 1 : 0;  // counted from 1
    return false;
  }
};

}  // namespace

Result<nlohmann::ordered_json> parseJson(std::string_view text, const std::string& file, int max_depth) {
  if (auto beyond = beyondLimits(text, file, max_depth)) return *beyond;
  auto json = nlohmann::ordered_json::parse(text, nullptr, false);
  if (!json.is_discarded()) return json;
  ErrorPlace place;
  (void)nlohmann::ordered_json::sax_parse(text, &place);
  return Error{ErrorKind::kInvalidData, file, "it is not valid JSON", "", place.byte};
}

}  // namespace relievo
