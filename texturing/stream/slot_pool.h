// slot_pool.h - slots of one size, and the room in them that a streamer's plan gives to the pages it wants. Pure
// bookkeeping, owned by the render thread.
//
// A plan (once a frame) goes over the requested pages: beginPlan(); needRoom() of each that is resident, once;
// takeRoom() for those to come. What takeRoom() refuses is deferred. Pages that arrive are then placed: of texture
// through the cache, of relief by placeRelief().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "texturing/stream/recent_use.h"
#include "texturing/stream/subslot_cache.h"

namespace relievo {

// 4 bytes: the low 31 bits of the last plan that counted it; whether it was prefetched, and not wanted since.
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
// Slots of one size.
struct SlotPool {
  SubslotCache cache;
  std::array<std::vector<SlotUse>, kPartLevels> slots;  // by level, and the cache's indices
  RecentUse recent;
  uint32_t roots = 0;
  // Of the last plan: slots that the request lists need, with those that hold something pinned; in these, halves that
  // are not needed; pages without room, and those of relief among them; slots that would hold all; slots that relief to
  // come was given, and may take still; halves that are free, idle or in such slots, and not spoken for.
  uint64_t room_used = 0, halves_left = 0, deferred = 0, deferred_relief = 0, demand = 0, opened = 0, openings = 0;
  int64_t spare_halves = 0;
  struct Idle {
    std::vector<SlotIndex> parts;
    bool known = false;
  };
  Idle idle_halves, idle_thirds;  // that relief to come may take, once known
  explicit SlotPool(uint32_t slot_count) : cache(slot_count), recent(cache.slotCount()) { follow(); }
  // Slots for the cache's new parts.
  void follow() {
    for (size_t level = 0; level < kPartLevels; ++level)
      if (slots[level].size() < cache.indexCount(static_cast<int>(level)))
        slots[level].resize(cache.indexCount(static_cast<int>(level)));
  }
  SlotUse& slotOf(SlotIndex name) {
    const auto level = static_cast<size_t>(partOf(name).level);
    return slots[level][level == 0 ? name : cache.indices(name)[level]];
  }
  void beginPlan() {
    room_used = cache.pinnedCount();
    halves_left = 2 * uint64_t{cache.pinnedInTwo()} - cache.pinnedHalves();
    deferred = deferred_relief = opened = 0;
    idle_halves.known = idle_thirds.known = false;
  }
  // Of a page that is counted for the first time. spare_recent: what was used recently has its room already.
  void needRoom(SlotIndex name, uint64_t plan, bool spare_recent = false);
  // For pages of a node that are to come; of relief for as much as it may turn out to need, which is half a slot.
  bool takeRoom(bool relief, uint64_t pages);
  // Relief fills what is free. Else the plan may have counted on an idle half beside one in use, and given the slots to
  // others. counted: by the plan, with half a slot. more: whether another compact page that it counted comes next.
  std::optional<SubslotCache::Placement> placeRelief(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                     bool counted, bool more);
  // A slot in three takes two halves from what is to come, which may turn out to need them: for one page only where a
  // half is to spare. Two pages have it in their own right, and what a third one was counted with is left for others.
  std::optional<SubslotCache::Placement> placeInThird(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                      bool counted, bool more);
  std::optional<SubslotCache::Placement> placePlain(PageId id, uint64_t frame, uint32_t min_age, int level);
  std::optional<SubslotCache::Placement> placeInIdle(Idle& idle, int part_level, PageId id, uint64_t frame,
                                                     uint32_t min_age, int level);
};

}  // namespace relievo
