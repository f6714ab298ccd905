// replacement.h - how well a replacement policy serves a recorded trace, beside the best that any policy could do.
// A trace is what each frame wanted. A replay follows the engine's rules, with pages that arrive at once: first
// everything wanted that is resident is touched (hits), then what is missing (misses) is placed, in the order of the
// frame's list; a page used in the frame never leaves in it. What finds no slot stays away until a later frame wants it
// again.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <unordered_map>
#include <vector>

#include "texturing/codec/page_id.h"

namespace relievo {

using PageTrace = std::vector<std::vector<PageId>>;  // by frame; in the order of service

// Who leaves when a slot is needed, of the pages that were not used in this frame. The product's cache is kLru: on
// recorded flights the others serve within 0.1 % of it (`relievo bench --only replacement`).
//   kLru      the least recently used.
//   kClock    second chance: a hand goes round the slots, takes the first page that was not used since it last came by.
//   kHalving  Rudelle 2015, section 4.3: a hand goes round the slots, takes the first page not used for more than a
//             threshold of frames; after a round without success the threshold is halved (rounded down), until the next
//             frame starts anew. He does not give the first threshold; here it is kFirstThreshold.
enum class Replacement : uint8_t { kLru, kClock, kHalving };
const char* replacementName(Replacement policy);  // "lru", "clock", "halving"
inline constexpr uint32_t kFirstThreshold = 64;   // frames: about a second

// A cache of equal slots under the two other policies. Ticks are frames and do not run backwards: one smaller than the
// largest seen so far counts as that one.
class HandCache {
 public:
  HandCache(uint32_t slots, Replacement policy);
  bool touch(PageId id, uint64_t tick);  // false: not resident
  struct Placement {
    bool placed = false;
    std::optional<PageId> evicted;
  };
  Placement place(PageId id, uint64_t tick);  // of a page that is not resident

 private:
  uint64_t advance(uint64_t tick);
  struct Slot {
    PageId page;
    uint64_t tick = 0;
    bool marked = false;  // used since the hand came by
  };
  std::optional<size_t> victim(uint64_t tick);
  size_t step();

  Replacement policy_;
  uint32_t slot_count_;
  std::vector<Slot> slots_;  // those that hold a page
  std::unordered_map<PageId, size_t> index_;
  uint64_t last_tick_ = 0;
  size_t hand_ = 0;
  uint64_t threshold_ = kFirstThreshold;
};

struct ReplayResult {
  uint64_t wanted = 0;  // accesses: a page is counted once a frame, however often the frame's list names it
  uint64_t misses = 0;
  uint64_t first_uses = 0;  // misses of pages that were never wanted before: no policy avoids them
  uint64_t unplaced = 0;    // misses that found no slot: the frame wants more than the cache holds
  uint64_t evictions = 0;
  uint64_t hits() const { return wanted - misses; }
  double hitRate() const { return wanted == 0 ? 1.0 : static_cast<double>(hits()) / static_cast<double>(wanted); }
};

// kLru: through PageCache itself (texturing/stream/page_cache.h).
ReplayResult replay(const PageTrace& trace, uint32_t slots, Replacement policy);
// Belady's optimum under the same rules: the page leaves whose next use is farthest. No policy has fewer misses as long
// as no frame wants more than the cache holds (unplaced == 0); beyond that it is a yardstick, not a bound.
ReplayResult replayOptimum(const PageTrace& trace, uint32_t slots);

uint32_t distinctPages(const PageTrace& trace);
uint32_t largestFrame(const PageTrace& trace);  // pages

}  // namespace relievo
