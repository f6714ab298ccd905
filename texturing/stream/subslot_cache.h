// subslot_cache.h - a page cache whose slots are divided where a page needs less than one. One budget and one order of
// use: any page can take the place of any other.
//
//   level 0   a slot: texture pages
//   level 1   half of a slot: relief pages, two bytes for each sample
//   level 2   a quarter of that: pages that need only every second sample along a side (relief_subslots.h)
//   level 3   a quarter of that: every fourth
//   level 4   a third of a slot: relief pages in compact form (relief_compact.h)
//   level 5   a quarter of that: pages that need only every second sample along a side
//   level 6   a quarter of that: every fourth
//
// A slot is divided into two or three parts. A divided place is a page of the level above, called a bundle: it counts
// as used whenever one of its parts is, and is pinned while one of them is. So each level is a PageCache.
//
// A page takes the deepest free place of its own level or one above. Otherwise the least recently used page of its
// level, or a page or bundle of a level above with all that is in it, is evicted, whichever was unused for longer (if
// equal: the smaller). Within a level the least recently used one is evicted.
//
// A relief page needs at most a free or idle half of a slot that is divided in two. The idle rest of a slot in three
// suits pages in thirds only: a plan that counts on halves divides a slot in three only if a half is to spare, or for
// two pages (slot_pool.h).
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
inline constexpr int kHalves = 1, kThirds = 4;  // the levels into which a slot is divided
inline constexpr bool isThird(int level) { return level >= kThirds; }
// The level in which a level's bundles are, for levels from 1 on.
inline constexpr int parentLevel(int level) { return level == kHalves || level == kThirds ? 0 : level - 1; }

// A SlotIndex encodes a place: bits 0 to 15 the slot, 16 to 21 the part, 24 to 26 the level. For a whole slot it is the
// slot's number. Part i of a half or third, or of a quarter of one, contains parts 4 i to 4 i + 3 of the next level.
struct SlotPart {
  uint32_t slot = 0;
  int level = 0;
  uint32_t part = 0;
};
inline constexpr SlotIndex slotIndexOf(const SlotPart& p) {
  return p.slot | p.part << 16 | static_cast<uint32_t>(p.level) << 24;
}
inline constexpr SlotPart partOf(SlotIndex slot) {
  return {slot & 0xFFFFu, static_cast<int>(slot >> 24 & 7u), slot >> 16 & 63u};
}

class SubslotCache {
 public:
  explicit SubslotCache(uint32_t slot_count);

  uint32_t slotCount() const { return levels_[0].pages.slotCount(); }
  uint32_t residentCount() const { return levels_[0].pages.residentCount(); }  // slots that hold something
  uint32_t pinnedCount() const { return levels_[0].pages.pinnedCount(); }      // slots that hold something pinned
  uint32_t pageCount() const;
  uint32_t pageCount(int level) const;
  uint32_t dividedCount() const { return levels_[kHalves].bundles() + levels_[kThirds].bundles(); }  // divided slots
  uint32_t pinnedHalves() const { return levels_[kHalves].pages.pinnedCount(); }
  uint32_t pinnedHalvedSlots() const { return pinned_halved_slots_; }  // slots divided in two with a pinned page

  // Relief pages are searched in parts, all others in whole slots. kNoSlot: not resident.
  SlotIndex find(PageId id) const;
  PageId pageIn(SlotIndex slot) const;
  bool isPinned(SlotIndex slot) const;
  // As in PageCache.
  void touch(SlotIndex slot, uint64_t tick);
  void pin(SlotIndex slot);
  void unpin(SlotIndex slot);
  void remove(PageId id);  // of a whole slot

  struct Placement {
    SlotIndex slot = kNoSlot;
    bool emptied = false;      // everything that was in the slot was evicted
    bool opened_slot = false;  // nothing in the slot was used in this frame before
    struct Evicted {
      int level;
      uint32_t index;  // as indices() returned it
      PageId page;
    };
    std::vector<Evicted> evicted;  // pages only, no bundles
  };
  // As PageCache::place, in a part of that level: 0 for texture pages, others for relief.
  std::optional<Placement> place(PageId id, uint64_t tick, uint32_t min_age = 1, int level = 0);
  // Places a relief page in a half or third without pinned pages. level: that part's own, or one below.
  Placement placeInPart(SlotIndex part, PageId id, uint64_t tick, int level);
  // Would place() fill a free part of a slot that was used in frame `tick`, without an eviction?
  bool hasPartToFill(uint64_t tick, int level) const;
  // Halves or thirds that were not used in frame `tick`, of slots that were used then or are pinned; the longest idle
  // first.
  void idleParts(int level, uint64_t tick, std::vector<SlotIndex>& out) const;
  // Is a half or third free, or unpinned as a whole and not used in so many frames?
  bool isIdle(SlotIndex part, uint64_t tick, uint32_t min_age) const;

  // Calls f for every resident page.
  template <class F>
  void forEach(F&& f) const {
    for (const Level& l : levels_)
      l.pages.forEach([&](PageId id) {
        if (id.plane() != kBundle) f(id);
      });
  }

  // A dense index of a place and of those that contain it, by level, for tables beside this one.
  std::array<uint32_t, kPartLevels> indices(SlotIndex slot) const;
  uint32_t indexCount(int level) const { return levels_[static_cast<size_t>(level)].pages.slotCount(); }

  size_t metadataBytes() const;
  bool checkInvariants(std::string* why) const;

 private:
  static constexpr Plane kBundle = Plane::kShared;
  struct Level {
    PageCache pages;
    uint32_t parts = 1;                  // of a bundle
    std::vector<uint16_t> parent;        // for each bundle, its index in the level above
    std::vector<uint16_t> free_bundles;  // bundles not in use
    explicit Level(PageCache cache) : pages(std::move(cache)) {}
    uint32_t bundles() const { return static_cast<uint32_t>(parent.size() - free_bundles.size()); }
  };
  Level& at(int level) { return levels_[static_cast<size_t>(level)]; }
  const Level& at(int level) const { return levels_[static_cast<size_t>(level)]; }
  static PageId bundleId(int level, uint32_t bundle) {
    return PageId(kBundle, NodeId{bundle, static_cast<uint32_t>(level), 0, 0});
  }
  SlotIndex slotIndexAt(int level, uint32_t index) const;
  bool canDivideInto(int level) const;
  std::pair<int, SlotIndex> freePart(int level) const;
  uint32_t allocateBundle(int level);
  void releaseBundle(int level, uint32_t bundle, Placement& out);
  uint32_t recordEvicted(int level, const PageCache::Placement& placed, Placement& out);
  Placement placeFrom(int from, std::optional<uint32_t> part, PageId id, uint64_t tick, uint32_t min_age, int level);
  bool isUsedNow(uint32_t slot, uint64_t tick) const;

  std::vector<Level> levels_;
  uint32_t pinned_halved_slots_ = 0;
};

}  // namespace relievo
