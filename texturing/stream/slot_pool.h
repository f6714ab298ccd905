// slot_pool.h - slots of one size, and how a streamer's plan distributes them among the requested pages. Pure, owned by
// the render thread.
//
// A plan is made once for each frame: beginPlan(), then countResident() once for each requested resident page, then
// reserve() for each missing one. A page for which reserve() fails is deferred. Arriving pages are then placed: texture
// through the cache, relief by placeRelief().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "texturing/stream/recent_use.h"
#include "texturing/stream/subslot_cache.h"

namespace relievo {

// In 4 bytes: the low 31 bits of the last plan that counted the slot, and whether it was prefetched and not requested
// since.
class SlotUse {
 public:
  bool counted(uint64_t plan) const { return (bits_ & ~1u) == markOf(plan); }
  bool count(uint64_t plan) {  // true: for the first time in this plan
    bool first = !counted(plan);
    bits_ = markOf(plan) | (bits_ & 1u);
    return first;
  }
  void setPrefetched(bool prefetched) { bits_ = (bits_ & ~1u) | static_cast<uint32_t>(prefetched); }
  bool takePrefetched() {
    bool prefetched = bits_ & 1u;
    setPrefetched(false);
    return prefetched;
  }

 private:
  static uint32_t markOf(uint64_t plan) { return static_cast<uint32_t>(plan) << 1; }
  uint32_t bits_ = 0;
};
// A pool of slots of one size.
struct SlotPool {
  SubslotCache cache;
  std::array<std::vector<SlotUse>, kPartLevels> slots;  // by level and the cache's indices
  RecentUse recent;
  uint32_t roots = 0;
  // Results of the last plan:
  // - slots_used: slots of requested or pinned pages; free_halves: halves in these that are not needed.
  // - deferred, deferred_relief: pages without room, and those of relief among them; demand: slots that would hold all
  // requested pages.
  // - opened_slots: slots reserved for missing relief; openable_slots: slots that relief may still take.
  // - unreserved_halves: halves that are free, idle or in openable slots, and not reserved.
  uint64_t slots_used = 0, free_halves = 0, deferred = 0, deferred_relief = 0, demand = 0, opened_slots = 0,
           openable_slots = 0;
  int64_t unreserved_halves = 0;
  struct Idle {
    std::vector<SlotIndex> parts;
    bool known = false;
  };
  Idle idle_halves, idle_thirds;  // parts that arriving relief may take, once known
  explicit SlotPool(uint32_t slot_count) : cache(slot_count), recent(cache.slotCount()) { resizeTables(); }
  // Grows the tables with the cache's new parts.
  void resizeTables() {
    for (size_t level = 0; level < kPartLevels; ++level)
      if (slots[level].size() < cache.indexCount(static_cast<int>(level)))
        slots[level].resize(cache.indexCount(static_cast<int>(level)));
  }
  SlotUse& slotOf(SlotIndex slot) {
    const auto level = static_cast<size_t>(partOf(slot).level);
    return slots[level][level == 0 ? slot : cache.indices(slot)[level]];
  }
  void beginPlan() {
    slots_used = cache.pinnedCount();
    free_halves = 2 * uint64_t{cache.pinnedHalvedSlots()} - cache.pinnedHalves();
    deferred = deferred_relief = opened_slots = 0;
    idle_halves.known = idle_thirds.known = false;
  }
  // Counts a resident page, once for each plan. spare_recent: recently used slots are counted already.
  void countResident(SlotIndex slot, uint64_t plan, bool spare_recent = false);
  // Reserves room for missing pages of a node; for relief half a slot, the most that it may need.
  bool reserve(bool relief, uint64_t pages);
  // Places a relief page, first in free parts. If the plan counted on an idle half beside a used one and gave the slots
  // to others, then in that. counted: by the plan, with half a slot. more: another counted compact page comes next.
  std::optional<SubslotCache::Placement> placeRelief(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                     bool counted, bool more);
  // Dividing a slot in three takes two halves that missing pages may need. It is done for one page only if a half is
  // unreserved, and for two pages in any case; the half reserved for a third page stays available.
  std::optional<SubslotCache::Placement> placeInThird(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                      bool counted, bool more);
  std::optional<SubslotCache::Placement> placeUncompressed(PageId id, uint64_t frame, uint32_t min_age, int level);
  std::optional<SubslotCache::Placement> placeInIdle(Idle& idle, int part_level, PageId id, uint64_t frame,
                                                     uint32_t min_age, int level);
};

}  // namespace relievo
