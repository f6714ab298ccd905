#include "texturing/stream/slot_pool.h"

#include <algorithm>
#include <utility>

#include "texturing/stream/relief_subslots.h"

namespace relievo {

void SlotPool::countResident(SlotIndex slot, uint64_t plan, bool spare_recent) {
  const SlotPart part = partOf(slot);
  const auto needsSlot = [&] { return !cache.isPinned(part.slot) && !(spare_recent && recent.isRecent(part.slot)); };
  if (part.level == 0) {
    slots_used += needsSlot();
    return;
  }
  if (slots[0][part.slot].count(plan) && !cache.isPinned(part.slot)) {
    slots_used += needsSlot();
    if (!isThird(part.level)) free_halves += 2;
  }
  if (isThird(part.level)) return;  // the rest of such a slot does not suit every page
  const bool first = part.level == kHalves || slots[kHalves][cache.indices(slot)[kHalves]].count(plan);
  const uint32_t half = part.part / (kPartsOfSlot[static_cast<size_t>(part.level)] / 2);
  if (first && !cache.isPinned(slotIndexOf({part.slot, kHalves, half}))) --free_halves;
}

bool SlotPool::reserve(bool relief, uint64_t pages) {
  if (relief && free_halves > 0) {
    --free_halves;
    return true;
  }
  if (slots_used + pages > cache.slotCount()) return false;
  slots_used += pages;
  free_halves += relief;
  opened_slots += relief;
  return true;
}

std::optional<SubslotCache::Placement> SlotPool::placeRelief(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                             bool counted, bool more) {
  if (isThird(level)) {
    if (auto placed = placeInThird(id, frame, min_age, level, counted, more)) return placed;
    level = plainLevel(level);
  }
  auto placed = placeUncompressed(id, frame, min_age, level);
  if (placed) unreserved_halves -= !counted;
  return placed;
}

std::optional<SubslotCache::Placement> SlotPool::placeInThird(PageId id, uint64_t frame, uint32_t min_age, int level,
                                                              bool counted, bool more) {
  const int64_t slot_takes = counted ? 1 : 2;
  std::optional<SubslotCache::Placement> placed;
  if (cache.hasPartToFill(frame, level) || (openable_slots > 0 && unreserved_halves >= slot_takes))
    placed = cache.place(id, frame, min_age, level);
  if (!placed) placed = placeInIdle(idle_thirds, kThirds, id, frame, min_age, level);
  if (!placed && openable_slots > 0 && counted && more) placed = cache.place(id, frame, min_age, level);
  if (!placed) return std::nullopt;
  unreserved_halves += placed->opened_slot ? -slot_takes : counted;
  if (!placed->opened_slot) return placed;
  openable_slots -= openable_slots > 0;
  if (idle_thirds.known)
    for (uint32_t k = 0; k < kPartsOfSlot[kThirds]; ++k)
      idle_thirds.parts.push_back(slotIndexOf({partOf(placed->slot).slot, kThirds, k}));
  return placed;
}

std::optional<SubslotCache::Placement> SlotPool::placeUncompressed(PageId id, uint64_t frame, uint32_t min_age,
                                                                   int level) {
  if (openable_slots > 0 || cache.find(id) != kNoSlot || cache.hasPartToFill(frame, level)) {
    auto placed = cache.place(id, frame, min_age, level);
    openable_slots -= placed && placed->opened_slot && openable_slots > 0;
    return placed;
  }
  return placeInIdle(idle_halves, kHalves, id, frame, min_age, level);
}

std::optional<SubslotCache::Placement> SlotPool::placeInIdle(Idle& idle, int part_level, PageId id, uint64_t frame,
                                                             uint32_t min_age, int level) {
  if (!std::exchange(idle.known, true)) cache.idleParts(part_level, frame, idle.parts);
  auto next = std::find_if(idle.parts.begin(), idle.parts.end(),
                           [&](SlotIndex part) { return cache.isIdle(part, frame, min_age); });
  if (next == idle.parts.end()) return std::nullopt;
  const SlotIndex part = *next;
  idle.parts.erase(next);
  return cache.placeInPart(part, id, frame, level);
}

}  // namespace relievo
