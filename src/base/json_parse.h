// json_parse.h - JSON of files that anybody may have written. Safe for untrusted text: how deep it nests and how many
// members and values it has is counted in one pass, without recursion, before the JSON library sees the text. The
// library walks a value recursively (copying, printing) and looks members up one after the other, so the text alone
// would decide how much stack, time and memory they take. The caller limits the text's size.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "src/base/result.h"

namespace relievo {

inline constexpr int kMaxJsonDepth = 64;         // arrays and objects inside one another
inline constexpr size_t kMaxJsonMembers = 4096;  // of one object
// In all: an object's n-th member is compared with the n - 1 before it.
inline constexpr size_t kMaxJsonComparisons = size_t{1} << 27;
inline constexpr size_t kMaxJsonValues = size_t{1}
                                         << 21;  // in all: a value of two bytes of text can take 50 bytes of memory

// The error (kInvalidData) names `file` and the byte at which the text is no JSON, nests too deep, or has too many
// members or values.
Result<nlohmann::ordered_json> parseJson(std::string_view text, const std::string& file, int max_depth = kMaxJsonDepth);

}  // namespace relievo
