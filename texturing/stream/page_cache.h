// page_cache.h - which page is in which slot of a cache whose slots have one size. One budget serves all planes; the
// least recently used page is evicted. For slots that are divided among smaller pages see subslot_cache.h. Pure, owned
// by the render thread. Memory: 21 bytes for each slot.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "src/base/hash_index.h"
#include "texturing/codec/page_id.h"

namespace relievo {

using SlotIndex = uint32_t;
inline constexpr SlotIndex kNoSlot = 0xFFFFFFFFu;
inline constexpr uint32_t kMaxSlots = 65535;  // slot numbers have 16 bits here and in the page table

class PageCache {
 public:
  // slot_count is limited to kMaxSlots.
  explicit PageCache(uint32_t slot_count);

  uint32_t slotCount() const;
  uint32_t residentCount() const;
  uint32_t pinnedCount() const;     // pages with at least one pin
  SlotIndex find(PageId id) const;  // kNoSlot: not resident
  PageId pageIn(SlotIndex slot) const;
  bool isPinned(SlotIndex slot) const;
  bool holdsPage(SlotIndex slot) const { return pages_[slot].bits != kFreeBits; }
  uint32_t lastUse(SlotIndex slot) const {
    return uses_[slot].tick;
  }  // of an unpinned page: the low 32 bits of its tick

  // Marks a page as the most recently used. tick: the frame number. Pages used in the current frame are never evicted.
  // Ticks do not run backwards: a smaller one counts as the largest so far. Only the low 32 bits are kept, so that a
  // page unused for 2^32 frames counts as fresh once.
  void touch(SlotIndex slot, uint64_t tick);
  // A pinned page stays until it is unpinned as often as pinned (up to 65,535 times). The last unpin counts as a use.
  void pin(SlotIndex slot);
  void unpin(SlotIndex slot);

  struct Placement {
    SlotIndex slot = kNoSlot;
    std::optional<PageId> evicted;
  };
  // Places a page in a free slot, or in that of the least recently used page that is not pinned and was not used in the
  // last min_age frames (1: in frame `tick`; 0 counts as 1). The page counts as used in that frame. Nothing: the cache
  // is too small for what this frame uses. A resident page keeps its slot and is touched.
  std::optional<Placement> place(PageId id, uint64_t tick, uint32_t min_age = 1);
  // Places a page in the given slot, which is free or holds an unpinned page, which is evicted. `id` must not be
  // resident.
  Placement placeAt(SlotIndex slot, PageId id, uint64_t tick);
  void remove(PageId id);  // the page must not be pinned; if it is absent, nothing happens
  // firstFree(): the slot that the next page gets without an eviction. oldestAge(): how many frames ago the least
  // recently used unpinned page was used (0: in frame `tick`, or there is none); with min_age up to that, place() can
  // evict a page.
  SlotIndex firstFree() const { return free_ == kNone ? kNoSlot : free_; }
  uint32_t oldestAge(uint64_t tick);

  // Slots that come and go: addClosed() adds closed slots; a closed slot gets no page until it is opened.
  void addClosed(uint32_t count);  // slotCount() + count must be at most kMaxSlots
  void open(SlotIndex slot);
  void close(SlotIndex slot);  // the slot must not hold a page

  // Calls f for every resident page, in the order of slots.
  template <class F>
  void forEach(F&& f) const {
    for (PageId page : pages_)
      if (page.bits != kFreeBits) f(page);
  }

  size_t metadataBytes() const;  // the memory of this object, itself included
  // Unpinned pages, least recently used first; for tests.
  std::vector<PageId> lruOrder() const;
  bool checkInvariants(std::string* why) const;

 private:
  using Link = uint16_t;
  static constexpr Link kNone = 0xFFFF;
  static constexpr uint64_t kFreeBits = ~uint64_t{0};  // no valid page id: levels end at 17
  struct Use {
    uint32_t tick = 0;
    Link newer = kNone, older = kNone;  // linked list of uses; for free slots, a list through `newer`
  };

  void advance(uint64_t tick);
  uint32_t age(SlotIndex s) const { return static_cast<uint32_t>(last_tick_) - uses_[s].tick; }
  bool pinned(SlotIndex s) const { return pins_[s] != 0; }
  void markUsed(SlotIndex s);
  void unlink(SlotIndex s);
  void linkNewest(SlotIndex s);
  void linkFree(SlotIndex s);
  void unlinkFree(SlotIndex s);
  void enter(SlotIndex s);
  void forget(SlotIndex s);

  std::vector<PageId> pages_;   // by slot
  std::vector<Use> uses_;       // by slot
  std::vector<uint16_t> pins_;  // by slot
  HashIndex<Link, 67> index_;   // page -> slot
  Link free_ = kNone, newest_ = kNone, oldest_ = kNone;
  uint32_t resident_ = 0, pinned_ = 0, closed_ = 0;
  uint64_t last_tick_ = 0;
};

}  // namespace relievo
