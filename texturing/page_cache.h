// page_cache.h - which page sits in which slot. One budget, one replacement policy (least recently used) for every
// plane: a slot is kSlotBytes of RGBA8 texels, whether it holds coefficients, colour or relief, so any page can replace
// any other. Pure bookkeeping, owned by the render thread: no GL, no threads. Every operation is O(1).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "texturing/page_id.h"

namespace relievo {

using SlotIndex = uint32_t;
inline constexpr SlotIndex kNoSlot = 0xFFFFFFFFu;

class PageCache {
 public:
  explicit PageCache(uint32_t slot_count);

  uint32_t slotCount() const;
  uint32_t residentCount() const;
  uint32_t pinnedCount() const;     // pages with at least one pin
  SlotIndex find(PageId id) const;  // kNoSlot when not resident
  PageId pageIn(SlotIndex slot) const;
  bool isPinned(SlotIndex slot) const;

  // Marks as used now (most recently used). tick is the frame number: pages used in the current frame are never
  // evicted. Ticks do not run backwards: one smaller than the largest seen so far counts as that one.
  void touch(SlotIndex slot, uint64_t tick);
  // Pinned pages (counted) stay until unpinned as often as pinned. The last unpin counts as a use: what was held until
  // now is the most recently used.
  void pin(SlotIndex slot);
  void unpin(SlotIndex slot);

  struct Placement {
    SlotIndex slot = kNoSlot;
    std::optional<PageId> evicted;
  };
  // Takes a free slot or that of the least recently used page that is neither pinned nor used in frame `tick`; the page
  // counts as used in that frame. Nothing when no slot can be had: the cache is too small for what this frame uses.
  // A page that is resident already keeps its slot and is touched.
  std::optional<Placement> place(PageId id, uint64_t tick);
  void remove(PageId id);  // not pinned; absent: nothing happens

  // Every resident page, in the order of slots.
  template <class F>
  void forEach(F&& f) const {
    for (const Slot& s : slots_)
      if (s.used) f(s.page);
  }

  // Unpinned pages, least recently used first; for tests.
  std::vector<PageId> lruOrder() const;
  bool checkInvariants(std::string* why) const;

 private:
  struct Slot {
    PageId page;
    bool used = false;
    uint32_t pins = 0;
    uint64_t tick = 0;
    SlotIndex newer = kNoSlot, older = kNoSlot;  // intrusive LRU list
  };
  void unlink(SlotIndex s);
  void linkNewest(SlotIndex s);

  // Pinned pages are not in the list, and ticks grow along it, so its oldest end alone says whether anything can be
  // had.
  std::vector<Slot> slots_;
  std::vector<SlotIndex> free_;
  std::unordered_map<PageId, SlotIndex> by_page_;
  SlotIndex newest_ = kNoSlot, oldest_ = kNoSlot;
  uint64_t last_tick_ = 0;
  uint32_t pinned_ = 0;
};

}  // namespace relievo
