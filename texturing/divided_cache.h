// divided_cache.h - a page cache whose slots are divided where a page needs less than one. One budget, one order of use: any page can
// still take the place of any other.
//
//   level 0   a slot: texture pages
//   level 1   half of a slot: relief pages, two bytes a sample
//   level 2   a quarter of that: those that only need every second sample a side (relief_parts.h)
//   level 3   a quarter of that: every fourth
//
// What is divided sits in the level above as a page of its own, a bundle, which was used whenever one of its parts was and is pinned
// while one of them is. So each level is a PageCache. A page takes the deepest free place that can be had; else somebody leaves: the
// least recently used page of its level, or a page or bundle of a level above with all that is in it, whichever was not used for longer
// (the same: the smaller). The policy then chooses in that level.
// Room: whatever else is resident, a relief page takes no more than a free or idle half of a slot.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "texturing/page_cache.h"
#include "texturing/page_id.h"

namespace relievo {

inline constexpr int kPartLevels = 4;
inline constexpr std::array<uint32_t, kPartLevels> kPartsOfSlot{1, 2, 8, 32};

// The name of a place: bits 0..15 the slot, 16..20 which of its parts, 24..25 their level. A whole slot's name is its number.
// Part i of a level holds parts 4 i .. 4 i + 3 of the next.
struct SlotPart {
  uint32_t slot = 0;
  int level = 0;
  uint32_t part = 0;
};
inline constexpr SlotIndex nameOf(const SlotPart& p) { return p.slot | p.part << 16 | static_cast<uint32_t>(p.level) << 24; }
inline constexpr SlotPart partOf(SlotIndex name) { return {name & 0xFFFFu, static_cast<int>(name >> 24 & 3u), name >> 16 & 31u}; }

class DividedCache {
 public:
  DividedCache(uint32_t slot_count, Replacement policy);

  uint32_t slotCount() const { return levels_[0].pages.slotCount(); }
  uint32_t residentCount() const { return levels_[0].pages.residentCount(); }  // slots that hold something
  uint32_t pinnedCount() const { return levels_[0].pages.pinnedCount(); }      // slots that hold something pinned
  uint32_t pageCount() const;
  uint32_t pageCount(int level) const;
  uint32_t dividedCount() const { return levels_[1].bundles(); }               // slots that hold parts
  uint32_t pinnedHalves() const { return levels_[1].pages.pinnedCount(); }
  uint32_t pinnedDivided() const { return pinned_divided_; }

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
    bool emptied = false;                                // all that was in the slot before is gone
    bool took_slot = false;                              // nothing in the slot had been used in this frame
    struct Evicted {
      int level;
      uint32_t index;  // as indices() gave it
      PageId page;
    };
    std::vector<Evicted> evicted;                        // pages, no bundles
  };
  // As PageCache::place, in a part of that level: 0 for texture pages, 1 to 3 for relief.
  std::optional<Placement> place(PageId id, uint64_t tick, uint32_t min_age = 1, int level = 0);
  // The same for relief, into a half that holds nothing pinned.
  Placement placeInHalf(SlotIndex half, PageId id, uint64_t tick, int level);
  // Whether place() would only fill a free part of a slot that was used in frame `tick`: nobody leaves.
  bool hasPartToFill(uint64_t tick, int level) const;
  // Halves that nothing used in frame `tick` sits in, of slots that something did (or that are pinned), the longest idle first.
  void idleHalves(uint64_t tick, std::vector<SlotIndex>& out) const;
  bool isIdle(SlotIndex half, uint64_t tick, uint32_t min_age) const;  // free, or all in it unpinned and not used in so many frames

  // Every resident page.
  template <class F>
  void forEach(F&& f) const {
    for (const Level& l : levels_)
      l.pages.forEach([&](PageId id) {
        if (id.plane() != kBundle) f(id);
      });
  }

  // A dense index of what sits at a place and at what is around it (level 0 to the name's own), for tables beside this one.
  std::array<uint32_t, kPartLevels> indices(SlotIndex name) const;
  uint32_t indexCount(int level) const { return levels_[static_cast<size_t>(level)].pages.slotCount(); }

  size_t metadataBytes() const;
  bool checkInvariants(std::string* why) const;

 private:
  static constexpr Plane kBundle = static_cast<Plane>(15);  // no page's plane
  struct Level {
    PageCache pages;
    uint32_t parts = 1;             // of a bundle
    std::vector<uint16_t> around;   // by bundle: its index in the level above
    std::vector<uint16_t> vacant;   // bundles that are none now
    explicit Level(PageCache cache) : pages(std::move(cache)) {}
    uint32_t bundles() const { return static_cast<uint32_t>(around.size() - vacant.size()); }
  };
  Level& at(int level) { return levels_[static_cast<size_t>(level)]; }
  const Level& at(int level) const { return levels_[static_cast<size_t>(level)]; }
  static PageId bundleId(int level, uint32_t bundle) { return PageId(kBundle, NodeId{bundle, static_cast<uint32_t>(level), 0, 0}); }
  SlotIndex nameAt(int level, uint32_t index) const;
  bool mayDivideInto(int level) const;
  uint32_t newBundle(int level);
  void release(int level, uint32_t bundle, Placement& out);
  uint32_t noteEvicted(int level, const PageCache::Placement& placed, Placement& out);
  uint32_t divide(int level, uint32_t around);
  Placement placeBelow(int from, std::optional<uint32_t> half, PageId id, uint64_t tick, uint32_t min_age, int level);
  bool usedNow(uint32_t slot, uint64_t tick) const;

  std::vector<Level> levels_;
  uint32_t pinned_divided_ = 0;
};

}  // namespace relievo
