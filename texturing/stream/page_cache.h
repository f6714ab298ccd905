// page_cache.h - which page sits in which slot, all of one size. One budget for every plane; the least recently used
// page leaves.
// (Slots that are divided among smaller pages: subslot_cache.h.) Pure bookkeeping, owned by the render thread: no GL,
// no threads. Memory: 21 bytes a slot.
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
inline constexpr uint32_t kMaxSlots = 65535;  // slots have 16-bit names, here and in the page table

class PageCache {
 public:
  // At most kMaxSlots; what is beyond is left out.
  explicit PageCache(uint32_t slot_count);

  uint32_t slotCount() const;
  uint32_t residentCount() const;
  uint32_t pinnedCount() const;     // pages with at least one pin
  SlotIndex find(PageId id) const;  // kNoSlot when not resident
  PageId pageIn(SlotIndex slot) const;
  bool isPinned(SlotIndex slot) const;
  bool holdsPage(SlotIndex slot) const { return pages_[slot].bits != kFreeBits; }
  uint32_t lastUse(SlotIndex slot) const {
    return uses_[slot].tick;
  }  // of an unpinned page: the low 32 bits of its tick

  // Marks as used now (most recently used). tick is the frame number: pages used in the current frame are never
  // evicted. Ticks do not run backwards: one smaller than the largest seen so far counts as that one. (The low 32 bits
  // are kept: a page that nobody used for 2^32 frames would count as fresh, once.)
  void touch(SlotIndex slot, uint64_t tick);
  // Pinned pages (counted, up to 65,535 times) stay until unpinned as often as pinned. The last unpin counts as a use:
  // what was held until now is the most recently used.
  void pin(SlotIndex slot);
  void unpin(SlotIndex slot);

  struct Placement {
    SlotIndex slot = kNoSlot;
    std::optional<PageId> evicted;
  };
  // Takes a free slot or that of the least recently used page that is neither pinned nor was used in the last min_age
  // frames (1: in frame `tick`; 0 counts as 1); the page counts as used in that frame. Nothing when no slot can be had:
  // the cache is too small for what this frame uses. A page that is resident already keeps its slot and is touched.
  std::optional<Placement> place(PageId id, uint64_t tick, uint32_t min_age = 1);
  // The same into a slot of the caller's choice, which is free or holds an unpinned page: who was there leaves. `id` is
  // not resident.
  Placement placeAt(SlotIndex slot, PageId id, uint64_t tick);
  void remove(PageId id);  // not pinned; absent: nothing happens
  // Whether a page can be placed without another one leaving; and how long ago the least recently used unpinned page
  // was used, in frames (0: in frame `tick`, or there is none). With min_age up to that, place() finds somebody to
  // leave.
  SlotIndex firstFree() const { return free_ == kNone ? kNoSlot : free_; }  // the next page's
  uint32_t oldestAge(uint64_t tick);

  // Slots that come and go: adds closed ones; a closed slot is free, but no page is placed there until it is opened.
  void addClosed(uint32_t count);  // slotCount() + count: kMaxSlots at most
  void open(SlotIndex slot);
  void close(SlotIndex slot);  // that holds no page

  // Every resident page, in the order of slots.
  template <class F>
  void forEach(F&& f) const {
    for (PageId page : pages_)
      if (page.bits != kFreeBits) f(page);
  }

  size_t metadataBytes() const;  // all that this object has allocated, itself included
  // Unpinned pages, least recently used first; for tests.
  std::vector<PageId> lruOrder() const;
  bool checkInvariants(std::string* why) const;

 private:
  using Link = uint16_t;
  static constexpr Link kNone = 0xFFFF;
  static constexpr uint64_t kFreeBits = ~uint64_t{0};  // no page's name: levels end at 17
  struct Use {
    uint32_t tick = 0;
    Link newer = kNone, older = kNone;  // list of uses; of free slots, list of those: `newer` is the next one
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
