// page_life.h - the states of a page and the transitions between them, drawn in texturing/README.md. PageStreamer makes
// every transition through PageStateCounts::move(), which counts it.
#pragma once

#include <array>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "texturing/codec/page_id.h"

namespace relievo {

enum class PageState : uint8_t { kAbsent, kQueued, kDecoding, kReady, kResident, kFailed };
inline constexpr size_t kPageStates = 6;
inline constexpr std::array<std::string_view, kPageStates> kPageStateNames{"absent", "queued",   "decoding",
                                                                           "ready",  "resident", "failed"};

struct PageTransition {
  PageState from, to;
};
// texturing/stream/README.md says what causes each transition.
inline constexpr std::array<PageTransition, 11> kPageTransitions{{
    {PageState::kAbsent, PageState::kQueued},
    {PageState::kQueued, PageState::kDecoding},
    {PageState::kQueued, PageState::kAbsent},
    {PageState::kDecoding, PageState::kReady},
    {PageState::kDecoding, PageState::kFailed},
    {PageState::kDecoding, PageState::kAbsent},
    {PageState::kReady, PageState::kResident},
    {PageState::kReady, PageState::kAbsent},
    {PageState::kResident, PageState::kAbsent},
    {PageState::kFailed, PageState::kQueued},
    {PageState::kFailed, PageState::kAbsent},
}};

constexpr bool isLegal(PageState from, PageState to) {
  for (const PageTransition& t : kPageTransitions)
    if (t.from == from && t.to == to) return true;
  return false;
}

// The number of pages in each state, by plane number, and the number of transitions so far.
struct PageStateCounts {
  std::array<std::array<uint64_t, kPlaneNumbers>, kPageStates> pages{};  // [state][plane]; kAbsent is not counted
  std::array<std::array<uint64_t, kPageStates>, kPageStates> moves{};    // [from][to]

  void move(size_t plane, PageState from, PageState to) {
    assert(isLegal(from, to));
    ++moves[static_cast<size_t>(from)][static_cast<size_t>(to)];
    if (from != PageState::kAbsent) --pages[static_cast<size_t>(from)][plane];
    if (to != PageState::kAbsent) ++pages[static_cast<size_t>(to)][plane];
  }
  uint64_t count(PageState state) const {
    uint64_t sum = 0;
    for (uint64_t n : pages[static_cast<size_t>(state)]) sum += n;
    return sum;
  }
};

}  // namespace relievo
