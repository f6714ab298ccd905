// subslot_cache.h - a page cache whose slots are divided where a page needs less than one. One budget, one order of
// use: any page can still take the place of any other.
//
//   level 0   a slot: texture pages
//   level 1   half of a slot: relief pages, two bytes a sample
//   level 2   a quarter of that: those that only need every second sample a side (relief_subslots.h)
//   level 3   a quarter of that: every fourth
//   level 4   a third of a slot: relief pages in compact form (relief_compact.h)
//   level 5   a quarter of that: those that only need every second sample a side
//   level 6   a quarter of that: every fourth
//
// A slot is divided in two or in three. What is divided sits in the level above as a page of its own, a bundle, which
// was used whenever one of its parts was and is pinned while one of them is. So each level is a PageCache. A page takes
// the deepest free place that can be had, of its own level and those above it; else somebody leaves: the least recently
// used page of its level, or a page or bundle of a level above with all that is in it, whichever was not used for
// longer (the same: the smaller). The least recently used of that level leaves. Room: whatever else is resident, a
// relief page takes no more than a free or idle half of a slot, of one that is divided in two. What is idle of a slot
// in three is for pages that fit a third alone: who counts on halves opens such a slot only where one is to spare, or
// for two pages (page_streamer.cpp).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "texturing/codec/page_id.h"
#include "texturing/stream/page_cache.h"

namespace relievo {

inline constexpr int kPartLevels = 7;
inline constexpr std::array<uint32_t, kPartLevels> kPartsOfSlot{1, 2, 8, 32, 3, 12, 48};
inline constexpr int kHalves = 1, kThirds = 4;  // levels that a slot is divided into
inline constexpr bool isThird(int level) { return level >= kThirds; }
// The level in which a level's bundles sit; of those from 1 on.
inline constexpr int levelAbove(int level) { return level == kHalves || level == kThirds ? 0 : level - 1; }

// The name of a place: bits 0..15 the slot, 16..21 which of its parts, 24..26 their level. A whole slot's name is its
// number. Part i of a half or third, or of a quarter of one, holds parts 4 i .. 4 i + 3 of the next level.
struct SlotPart {
  uint32_t slot = 0;
  int level = 0;
  uint32_t part = 0;
};
inline constexpr SlotIndex nameOf(const SlotPart& p) {
  return p.slot | p.part << 16 | static_cast<uint32_t>(p.level) << 24;
}
inline constexpr SlotPart partOf(SlotIndex name) {
  return {name & 0xFFFFu, static_cast<int>(name >> 24 & 7u), name >> 16 & 63u};
}

class SubslotCache {
 public:
  explicit SubslotCache(uint32_t slot_count);

  uint32_t slotCount() const { return levels_[0].pages.slotCount(); }
  uint32_t residentCount() const { return levels_[0].pages.residentCount(); }  // slots that hold something
  uint32_t pinnedCount() const { return levels_[0].pages.pinnedCount(); }      // slots that hold something pinned
  uint32_t pageCount() const;
  uint32_t pageCount(int level) const;
  uint32_t dividedCount() const {
    return levels_[kHalves].bundles() + levels_[kThirds].bundles();
  }  // slots that hold parts
  uint32_t pinnedHalves() const { return levels_[kHalves].pages.pinnedCount(); }
  uint32_t pinnedInTwo() const { return pinned_in_two_; }  // slots divided in two that hold something pinned

  // Relief pages are looked for in parts, all others in whole slots. kNoSlot when not resident.
  SlotIndex find(PageId id) const;
  PageId pageIn(SlotIndex name) const;
  bool isPinned(SlotIndex name) const;
  // As PageCache's.
  void touch(SlotIndex name, uint64_t tick);
  void pin(SlotIndex name);
  void unpin(SlotIndex name);
  void remove(PageId id);  // of a whole slot

  struct Placement {
    SlotIndex slot = kNoSlot;
    bool emptied = false;    // all that was in the slot before is gone
    bool took_slot = false;  // nothing in the slot had been used in this frame
    struct Evicted {
      int level;
      uint32_t index;  // as indices() gave it
      PageId page;
    };
    std::vector<Evicted> evicted;  // pages, no bundles
  };
  // As PageCache::place, in a part of that level: 0 for texture pages, others for relief.
  std::optional<Placement> place(PageId id, uint64_t tick, uint32_t min_age = 1, int level = 0);
  // The same for relief, into a half or a third that holds nothing pinned; level: its own or one below.
  Placement placeInPart(SlotIndex part, PageId id, uint64_t tick, int level);
  // Whether place() would only fill what is free in a slot that was used in frame `tick`: nobody leaves.
  bool hasPartToFill(uint64_t tick, int level) const;
  // Halves or thirds that nothing used in frame `tick` sits in, of slots that something did (or that are pinned), the
  // longest idle first.
  void idleParts(int level, uint64_t tick, std::vector<SlotIndex>& out) const;
  // Of a half or third: free, or all in it unpinned and not used in so many frames.
  bool isIdle(SlotIndex part, uint64_t tick, uint32_t min_age) const;

  // Every resident page.
  template <class F>
  void forEach(F&& f) const {
    for (const Level& l : levels_)
      l.pages.forEach([&](PageId id) {
        if (id.plane() != kBundle) f(id);
      });
  }

  // A dense index of what sits at a place and at what is around it, by level (the name's own and those above it), for
  // tables beside this one.
  std::array<uint32_t, kPartLevels> indices(SlotIndex name) const;
  uint32_t indexCount(int level) const { return levels_[static_cast<size_t>(level)].pages.slotCount(); }

  size_t metadataBytes() const;
  bool checkInvariants(std::string* why) const;

 private:
  static constexpr Plane kBundle = Plane::kShared;
  struct Level {
    PageCache pages;
    uint32_t parts = 1;            // of a bundle
    std::vector<uint16_t> around;  // by bundle: its index in the level above
    std::vector<uint16_t> vacant;  // bundles that are none now
    explicit Level(PageCache cache) : pages(std::move(cache)) {}
    uint32_t bundles() const { return static_cast<uint32_t>(around.size() - vacant.size()); }
  };
  Level& at(int level) { return levels_[static_cast<size_t>(level)]; }
  const Level& at(int level) const { return levels_[static_cast<size_t>(level)]; }
  static PageId bundleId(int level, uint32_t bundle) {
    return PageId(kBundle, NodeId{bundle, static_cast<uint32_t>(level), 0, 0});
  }
  SlotIndex nameAt(int level, uint32_t index) const;
  bool mayDivideInto(int level) const;
  std::pair<int, SlotIndex> freePlace(int level) const;
  uint32_t newBundle(int level);
  void release(int level, uint32_t bundle, Placement& out);
  uint32_t noteEvicted(int level, const PageCache::Placement& placed, Placement& out);
  Placement placeBelow(int from, std::optional<uint32_t> part, PageId id, uint64_t tick, uint32_t min_age, int level);
  bool usedNow(uint32_t slot, uint64_t tick) const;

  std::vector<Level> levels_;
  uint32_t pinned_in_two_ = 0;
};

}  // namespace relievo
