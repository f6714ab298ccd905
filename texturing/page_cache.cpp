#include "texturing/page_cache.h"

#include <algorithm>
#include <cassert>

namespace relievo {

PageCache::PageCache(uint32_t slot_count) : slots_(slot_count) {
  free_.reserve(slot_count);
  for (uint32_t s = slot_count; s-- > 0;) free_.push_back(s);  // the lowest slot is taken first
  by_page_.reserve(slot_count);
}

uint32_t PageCache::slotCount() const { return static_cast<uint32_t>(slots_.size()); }
uint32_t PageCache::residentCount() const { return static_cast<uint32_t>(slots_.size() - free_.size()); }
uint32_t PageCache::pinnedCount() const { return pinned_; }

SlotIndex PageCache::find(PageId id) const {
  auto it = by_page_.find(id);
  return it == by_page_.end() ? kNoSlot : it->second;
}

PageId PageCache::pageIn(SlotIndex slot) const {
  assert(slot < slots_.size() && slots_[slot].used);
  return slots_[slot].page;
}

bool PageCache::isPinned(SlotIndex slot) const { return slots_[slot].pins > 0; }

void PageCache::touch(SlotIndex slot, uint64_t tick) {
  assert(slot < slots_.size() && slots_[slot].used);
  last_tick_ = std::max(last_tick_, tick);
  Slot& s = slots_[slot];
  s.tick = last_tick_;
  if (s.pins > 0 || slot == newest_) return;
  unlink(slot);
  linkNewest(slot);
}

void PageCache::pin(SlotIndex slot) {
  assert(slot < slots_.size() && slots_[slot].used);
  if (slots_[slot].pins++ > 0) return;
  unlink(slot);
  ++pinned_;
}

void PageCache::unpin(SlotIndex slot) {
  assert(slot < slots_.size() && slots_[slot].used && slots_[slot].pins > 0);
  if (--slots_[slot].pins > 0) return;
  --pinned_;
  slots_[slot].tick = last_tick_;
  linkNewest(slot);
}

std::optional<PageCache::Placement> PageCache::place(PageId id, uint64_t tick) {
  last_tick_ = std::max(last_tick_, tick);
  Placement placement{find(id), std::nullopt};
  if (placement.slot != kNoSlot) {
    touch(placement.slot, tick);
    return placement;
  }
  if (!free_.empty()) {
    placement.slot = free_.back();
    free_.pop_back();
  } else {
    if (oldest_ == kNoSlot || slots_[oldest_].tick >= tick) return std::nullopt;
    placement.slot = oldest_;
    placement.evicted = slots_[oldest_].page;
    by_page_.erase(slots_[oldest_].page);
    unlink(oldest_);
  }
  slots_[placement.slot] = Slot{.page = id, .used = true, .pins = 0, .tick = last_tick_};
  by_page_.emplace(id, placement.slot);
  linkNewest(placement.slot);
  return placement;
}

void PageCache::remove(PageId id) {
  auto it = by_page_.find(id);
  if (it == by_page_.end()) return;
  SlotIndex slot = it->second;
  assert(slots_[slot].pins == 0);
  unlink(slot);
  by_page_.erase(it);
  slots_[slot] = Slot{};
  free_.push_back(slot);
}

std::vector<PageId> PageCache::lruOrder() const {
  std::vector<PageId> order;
  for (SlotIndex s = oldest_; s != kNoSlot; s = slots_[s].newer) order.push_back(slots_[s].page);
  return order;
}

bool PageCache::checkInvariants(std::string* why) const {
  auto fail = [&](const std::string& text) {
    if (why) *why = text;
    return false;
  };
  size_t used = 0, pinned = 0;
  for (SlotIndex s = 0; s < slots_.size(); ++s) {
    if (!slots_[s].used) continue;
    ++used;
    pinned += slots_[s].pins > 0;
    auto it = by_page_.find(slots_[s].page);
    if (it == by_page_.end() || it->second != s)
      return fail("slot " + std::to_string(s) + " holds a page that is not its own");
  }
  if (used != by_page_.size()) return fail("a page is in two slots, or in none");
  if (used + free_.size() != slots_.size()) return fail("free and used slots do not add up");
  if (pinned != pinned_) return fail("the number of pinned pages is wrong");
  std::vector<bool> is_free(slots_.size());
  for (SlotIndex s : free_) {
    if (slots_[s].used || is_free[s]) return fail("slot " + std::to_string(s) + " is free twice, or free and used");
    is_free[s] = true;
  }
  size_t linked = 0;
  uint64_t tick = 0;
  SlotIndex older = kNoSlot;
  for (SlotIndex s = oldest_; s != kNoSlot; older = s, s = slots_[s].newer) {
    if (++linked > used) return fail("the list of uses has a loop");
    if (!slots_[s].used || slots_[s].pins > 0) return fail("a free or pinned slot is in the list of uses");
    if (slots_[s].older != older) return fail("the list of uses is not doubly linked");
    if (slots_[s].tick < tick) return fail("ticks run backwards along the list of uses");
    tick = slots_[s].tick;
  }
  if (newest_ != older) return fail("the newest end of the list of uses is wrong");
  if (linked + pinned != used) return fail("an unpinned page is not in the list of uses");
  return true;
}

void PageCache::unlink(SlotIndex s) {
  Slot& slot = slots_[s];
  (slot.newer == kNoSlot ? newest_ : slots_[slot.newer].older) = slot.older;
  (slot.older == kNoSlot ? oldest_ : slots_[slot.older].newer) = slot.newer;
  slot.newer = slot.older = kNoSlot;
}

void PageCache::linkNewest(SlotIndex s) {
  slots_[s].older = newest_;
  slots_[s].newer = kNoSlot;
  (newest_ == kNoSlot ? oldest_ : slots_[newest_].newer) = s;
  newest_ = s;
}

}  // namespace relievo
