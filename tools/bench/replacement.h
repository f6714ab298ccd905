// replacement.h - how well a replacement policy serves a recorded trace, beside the best that any policy could do.
// A trace is what each frame wanted. A replay follows the engine's rules, with pages that arrive at once: first
// everything wanted that is resident is touched (hits), then what is missing (misses) is placed, in the order of the
// frame's list; a page used in the frame never leaves in it. What finds no slot stays away until a later frame wants it
// again.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "texturing/stream/page_cache.h"

namespace relievo {

using PageTrace = std::vector<std::vector<PageId>>;  // by frame; in the order of service

struct ReplayResult {
  uint64_t wanted = 0;  // accesses: a page is counted once a frame, however often the frame's list names it
  uint64_t misses = 0;
  uint64_t first_uses = 0;  // misses of pages that were never wanted before: no policy avoids them
  uint64_t unplaced = 0;    // misses that found no slot: the frame wants more than the cache holds
  uint64_t evictions = 0;
  uint64_t hits() const { return wanted - misses; }
  double hitRate() const { return wanted == 0 ? 1.0 : static_cast<double>(hits()) / static_cast<double>(wanted); }
};

// Through PageCache itself.
ReplayResult replay(const PageTrace& trace, uint32_t slots, Replacement policy);
// Belady's optimum under the same rules: the page leaves whose next use is farthest. No policy has fewer misses as long
// as no frame wants more than the cache holds (unplaced == 0); beyond that it is a yardstick, not a bound.
ReplayResult replayOptimum(const PageTrace& trace, uint32_t slots);

uint32_t distinctPages(const PageTrace& trace);
uint32_t largestFrame(const PageTrace& trace);  // pages

}  // namespace relievo
