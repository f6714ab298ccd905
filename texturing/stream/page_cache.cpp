#include "texturing/stream/page_cache.h"

#include <algorithm>
#include <cassert>

namespace relievo {

PageCache::PageCache(uint32_t slot_count) {
  slot_count = std::min(slot_count, kMaxSlots);
  PageId free_page;
  free_page.bits = kFreeBits;
  pages_.assign(slot_count, free_page);
  uses_.resize(slot_count);
  pins_.resize(slot_count);
  index_.reset(slot_count);
  for (uint32_t s = slot_count; s-- > 0;) linkFree(s);  // the lowest slot is taken first
}

void PageCache::addClosed(uint32_t count) {
  const size_t slots = pages_.size() + count;
  assert(slots <= kMaxSlots);
  PageId free_page;
  free_page.bits = kFreeBits;
  pages_.resize(slots, free_page);
  uses_.resize(slots);
  pins_.resize(slots);
  closed_ += count;
  index_.reset(slots);
  for (SlotIndex s = 0; s < pages_.size(); ++s)
    if (holdsPage(s)) enter(s);
}

void PageCache::open(SlotIndex slot) {
  assert(pages_[slot].bits == kFreeBits && closed_ > 0);
  --closed_;
  linkFree(slot);
}

void PageCache::close(SlotIndex slot) {
  assert(pages_[slot].bits == kFreeBits);
  ++closed_;
  unlinkFree(slot);
}

uint32_t PageCache::slotCount() const { return static_cast<uint32_t>(pages_.size()); }
uint32_t PageCache::residentCount() const { return resident_; }
uint32_t PageCache::pinnedCount() const { return pinned_; }

SlotIndex PageCache::find(PageId id) const {
  static_assert(decltype(index_)::kNone == kNoSlot);
  return index_.find(hashOfKey(id.bits), [&](SlotIndex s) { return pages_[s] == id; });
}

PageId PageCache::pageIn(SlotIndex slot) const {
  assert(slot < pages_.size() && pages_[slot].bits != kFreeBits);
  return pages_[slot];
}

bool PageCache::isPinned(SlotIndex slot) const { return pinned(slot); }

void PageCache::advance(uint64_t tick) { last_tick_ = std::max(last_tick_, tick); }

// The page must not be pinned or in the list.
void PageCache::markUsed(SlotIndex s) {
  uses_[s].tick = static_cast<uint32_t>(last_tick_);
  linkNewest(s);
}

void PageCache::touch(SlotIndex slot, uint64_t tick) {
  assert(slot < pages_.size() && pages_[slot].bits != kFreeBits);
  advance(tick);
  if (pinned(slot)) return;
  unlink(slot);
  markUsed(slot);
}

void PageCache::pin(SlotIndex slot) {
  assert(slot < pages_.size() && pages_[slot].bits != kFreeBits && pins_[slot] != 0xFFFF);
  if (pins_[slot]++ > 0) return;
  unlink(slot);
  ++pinned_;
}

void PageCache::unpin(SlotIndex slot) {
  assert(slot < pages_.size() && pinned(slot));
  --pins_[slot];
  if (pinned(slot)) return;
  --pinned_;
  markUsed(slot);
}

std::optional<PageCache::Placement> PageCache::place(PageId id, uint64_t tick, uint32_t min_age) {
  advance(tick);
  Placement placement{find(id), std::nullopt};
  if (placement.slot != kNoSlot) {
    touch(placement.slot, tick);
    return placement;
  }
  if (free_ != kNone) return placeAt(free_, id, tick);
  // Ticks grow along the list of uses, so that its oldest end decides.
  if (oldest_ == kNone || age(oldest_) < std::max(1u, min_age)) return std::nullopt;
  return placeAt(oldest_, id, tick);
}

PageCache::Placement PageCache::placeAt(SlotIndex slot, PageId id, uint64_t tick) {
  assert(!pinned(slot) && find(id) == kNoSlot);
  advance(tick);
  Placement placement{slot, std::nullopt};
  if (holdsPage(slot)) {
    placement.evicted = pages_[slot];
    forget(slot);
    unlink(slot);
  } else {
    unlinkFree(slot);
    ++resident_;
  }
  pages_[slot] = id;
  enter(slot);
  markUsed(slot);
  return placement;
}

void PageCache::remove(PageId id) {
  SlotIndex slot = find(id);
  if (slot == kNoSlot) return;
  assert(!pinned(slot));
  unlink(slot);
  forget(slot);
  pages_[slot].bits = kFreeBits;
  pins_[slot] = 0;
  linkFree(slot);
  --resident_;
}

uint32_t PageCache::oldestAge(uint64_t tick) {
  advance(tick);
  return oldest_ == kNone ? 0 : age(oldest_);
}

// --- page -> slot ---

// The page in it is not in the index yet.
void PageCache::enter(SlotIndex s) {
  index_.findOrAdd(hashOfKey(pages_[s].bits), s, [](SlotIndex) { return false; });
}

void PageCache::forget(SlotIndex s) {
  index_.erase(hashOfKey(pages_[s].bits), s, [&](SlotIndex other) { return hashOfKey(pages_[other].bits); });
}

// --- list of uses ---

void PageCache::unlink(SlotIndex s) {
  Use& use = uses_[s];
  (use.newer == kNone ? newest_ : uses_[use.newer].older) = use.older;
  (use.older == kNone ? oldest_ : uses_[use.older].newer) = use.newer;
  use.newer = use.older = kNone;
}

void PageCache::linkNewest(SlotIndex s) {
  uses_[s].older = newest_;
  uses_[s].newer = kNone;
  (newest_ == kNone ? oldest_ : uses_[newest_].newer) = static_cast<Link>(s);
  newest_ = static_cast<Link>(s);
}

// --- list of free slots ---

void PageCache::linkFree(SlotIndex s) {
  uses_[s].newer = free_;
  uses_[s].older = kNone;
  if (free_ != kNone) uses_[free_].older = static_cast<Link>(s);
  free_ = static_cast<Link>(s);
}

void PageCache::unlinkFree(SlotIndex s) {
  const Use use = uses_[s];
  (use.older == kNone ? free_ : uses_[use.older].newer) = use.newer;
  if (use.newer != kNone) uses_[use.newer].older = use.older;
}

// --- accounts and tests ---

size_t PageCache::metadataBytes() const {
  return sizeof *this + pages_.capacity() * sizeof(PageId) + uses_.capacity() * sizeof(Use) +
         pins_.capacity() * sizeof(uint16_t) + index_.bytes();
}

std::vector<PageId> PageCache::lruOrder() const {
  std::vector<PageId> order;
  for (Link s = oldest_; s != kNone; s = uses_[s].newer) order.push_back(pages_[s]);
  return order;
}

bool PageCache::checkInvariants(std::string* why) const {
  auto fail = [&](const std::string& text) {
    if (why) *why = text;
    return false;
  };
  size_t used = 0, pinned_pages = 0;
  for (SlotIndex s = 0; s < pages_.size(); ++s) {
    if (pages_[s].bits == kFreeBits) continue;
    ++used;
    pinned_pages += pinned(s);
    if (find(pages_[s]) != s) return fail("slot " + std::to_string(s) + " holds a page that is not its own");
  }
  if (used != index_.size() || used != resident_) return fail("a page is in two slots, or in none");
  if (pinned_pages != pinned_) return fail("the number of pinned pages is wrong");
  size_t free = 0;
  for (Link s = free_; s != kNone; s = uses_[s].newer) {
    if (++free > pages_.size()) return fail("the list of free slots has a loop");
    if (pages_[s].bits != kFreeBits) return fail("slot " + std::to_string(s) + " is free and used");
  }
  if (used + free + closed_ != pages_.size()) return fail("free, used and closed slots do not add up");
  size_t linked = 0;
  uint32_t oldest_age = ~0u;
  Link older = kNone;
  for (Link s = oldest_; s != kNone; older = s, s = uses_[s].newer) {
    if (++linked > used) return fail("the list of uses has a loop");
    if (pages_[s].bits == kFreeBits || pinned(s)) return fail("a free or pinned slot is in the list of uses");
    if (uses_[s].older != older) return fail("the list of uses is not doubly linked");
    if (age(s) > oldest_age) return fail("ticks run backwards along the list of uses");
    oldest_age = age(s);
  }
  if (newest_ != older) return fail("the newest end of the list of uses is wrong");
  if (linked + pinned_pages != used) return fail("an unpinned page is not in the list of uses");
  return true;
}

}  // namespace relievo
