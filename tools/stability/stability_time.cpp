#include <cstdint>

#include "texturing/stream/page_cache.h"
#include "texturing/stream/page_table.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

// A page that appeared a quarter of a second ago, up to ten years after the program was started.
StabilityErrors fadeOfAPage() {
  StabilityErrors out;
  for (const double frames : {1.0, 1e6, 1e9, 2e10}) {
    const double born_s = frames / 60;
    const auto age = static_cast<uint16_t>(fadeClock(born_s + 0.25) - fadeClock(born_s));
    out.add(age / 64.0 - 0.25, double{static_cast<float>(born_s + 0.25) - static_cast<float>(born_s)} - 0.25);
  }
  return out;
}

PageId pageOf(uint32_t k) { return {Plane::kRelief, NodeId{0, 8, k, 0}}; }

// Four pages in a cache for four while the number of the frame passes 2^32: a fifth replaces the one unused longest.
StabilityErrors replacementAfterManyFrames() {
  StabilityErrors out;
  for (const uint64_t first : {uint64_t{1} << 20, (uint64_t{1} << 32) - 2, (uint64_t{1} << 40) - 2}) {
    PageCache cache(4);
    for (uint32_t k = 0; k < 4; ++k) cache.place(pageOf(k), first + k);
    double wrong = 0, naive_wrong = 0;
    for (uint32_t k = 4; k < 64; ++k) {
      const auto placed = cache.place(pageOf(k), first + k);
      wrong += !placed || placed->evicted != pageOf(k - 4);
      // The smallest of the numbers' low 32 bits.
      uint32_t oldest = k - 4;
      for (uint32_t other = k - 4; other < k; ++other)
        if (static_cast<uint32_t>(first + other) < static_cast<uint32_t>(first + oldest)) oldest = other;
      naive_wrong += oldest != k - 4;
    }
    out.add(wrong, naive_wrong);
  }
  return out;
}

constexpr StabilityCase kTimeCases[] = {
    {"the fade of a page after up to 2 x 10^10 frames", "it appeared 1/4 s ago", "seconds since the start in a float",
     "s", 1.0 / 64, fadeOfAPage},
    {"replacement while frame numbers pass 2^32 and 2^40", "the page unused longest leaves",
     "the smallest of numbers of 32 bits", "wrong pages", 0.5, replacementAfterManyFrames},
};

}  // namespace

std::span<const StabilityCase> timeStability() { return kTimeCases; }

}  // namespace relievo
