// view_share.h - how much of their random work tests do: under the address sanitizer and with OpenGL ES less, with
// RELIEVO_LONG_TESTS=1 more.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <string_view>

namespace relievo::test {

// It takes ten to sixteen times as long and looks at memory, not at figures: it sees a sixteenth of the views, scans
// and damages.
#ifdef RELIEVO_ADDRESS_SANITIZER
inline constexpr int kViewShare = 16;
#else
inline constexpr int kViewShare = 1;
#endif
inline constexpr bool kSanitized = kViewShare > 1;

// RELIEVO_LONG_TESTS=1, and nothing else: what tests do then is named where they ask.
inline bool longTests() {
  const char* node = std::getenv("RELIEVO_LONG_TESTS");
  return node && std::string_view(node) == "1";
}

// Of n of them: an eighth (or another part), or all with RELIEVO_LONG_TESTS=1; at least one.
template <class Count>
Count share(Count n, Count part = 8) {
  return std::max(Count{1}, kSanitized ? n / kViewShare : longTests() ? n : n / part);
}

inline bool openGlEs() {
  const char* api = std::getenv("RELIEVO_GL");
  return api && std::string_view(api) == "es";
}

// Of n of them with OpenGL ES (RELIEVO_GL=es), whose contexts the same driver draws with the same shader bodies: a
// quarter, or all with RELIEVO_LONG_TESTS=1. With OpenGL all.
template <class Count>
Count esShare(Count n) {
  return openGlEs() && !longTests() ? std::max(Count{1}, n / 4) : n;
}

// Of n random frames or views with OpenGL: an eighth, or all with RELIEVO_LONG_TESTS=1. With OpenGL ES a quarter of
// that.
template <class Count>
Count glShare(Count n) {
  return esShare(longTests() ? n : std::max(Count{1}, n / 8));
}

// Of n views whose every pixel is computed once more on the CPU: with OpenGL a half, with OpenGL ES an eighth, three at
// least; all with RELIEVO_LONG_TESTS=1.
inline int denseShare(int n) {
  if (longTests()) return n;
  return std::min(n, std::max(3, openGlEs() ? n / 8 : n / 2));
}

// Negative controls show that a test's own code can fail, and what lies outside the shaders is the same: with OpenGL ES
// both would be shown again.
inline bool controlledWithOpenGl() { return openGlEs() && !longTests(); }

}  // namespace relievo::test
