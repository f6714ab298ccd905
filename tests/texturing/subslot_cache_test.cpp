// Slots divided among relief pages: against a plain list of what lies where, and what a plan may count on.
#include "texturing/stream/subslot_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>

#include "texturing/stream/relief_subslots.h"

namespace relievo {
namespace subslot_cache_test {

PageId texturePage(uint32_t x) { return PageId(texturePlane(0), {0, 10, x, 0}); }
PageId reliefPage(uint32_t x) { return PageId(Plane::kRelief, {0, 10, x, 0}); }

TEST(SlotPart, NamesArePlacesOfTheirOwnInTheSlot) {
  std::set<SlotIndex> names;
  for (int level = 1; level < kPartLevels; ++level) {
    std::vector<int> covered(static_cast<size_t>(kPageFullPx * kPageFullPx));
    for (uint32_t part = 0; part < kPartsOfSlot[static_cast<size_t>(level)]; ++part) {
      const SlotPart p{777, level, part};
      EXPECT_TRUE(names.insert(slotIndexOf(p)).second);
      EXPECT_EQ(partOf(slotIndexOf(p)).slot, 777u);
      EXPECT_EQ(partOf(slotIndexOf(p)).level, level);
      EXPECT_EQ(partOf(slotIndexOf(p)).part, part);
      const PartOffset at = offsetInSlot(p);
      for (int y = 0; y < partRows(level); ++y)
        for (int x = 0; x < partColumns(level); ++x)
          ++covered[static_cast<size_t>((at.y + y) * kPageFullPx + at.x + x)];
      if (parentLevel(level) == 0) continue;
      const PartOffset around = offsetInSlot({777, parentLevel(level), part / 4});  // lies in the part that it is of
      EXPECT_GE(at.x, around.x);
      EXPECT_GE(at.y, around.y);
      EXPECT_LE(at.x + partColumns(level), around.x + partColumns(level - 1));
      EXPECT_LE(at.y + partRows(level), around.y + partRows(level - 1));
    }
    const auto once = std::count(covered.begin(), covered.end(), 1),
               never = std::count(covered.begin(), covered.end(), 0);
    EXPECT_EQ(once + never, kPageFullPx * kPageFullPx) << "level " << level << ": one over another";
    EXPECT_LE(never, isThird(level) ? 4 * kPageFullPx : 0) << "level " << level;
  }
  EXPECT_EQ(slotIndexOf({12345, 0, 0}), 12345u);
}

TEST(SubslotCache, ReliefPagesShareSlots) {
  SubslotCache cache(4);
  for (uint32_t i = 0; i < 2; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, 1));
  EXPECT_EQ(cache.residentCount(), 1u);
  for (uint32_t i = 2; i < 10; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, 2));
  EXPECT_EQ(cache.residentCount(), 2u) << "eight in one slot";
  for (uint32_t i = 10; i < 42; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, 3));
  EXPECT_EQ(cache.residentCount(), 3u) << "32 in one slot";
  EXPECT_EQ(cache.pageCount(), 42u);
  ASSERT_TRUE(cache.place(texturePage(0), 1));
  EXPECT_FALSE(cache.place(texturePage(1), 1)) << "all of it is in use";
  EXPECT_FALSE(cache.place(reliefPage(42), 1, 1, 3));
  std::string why;
  EXPECT_TRUE(cache.checkInvariants(&why)) << why;
  // A texture page takes a whole slot, and all that was in it leaves: the one that was not used for longest.
  for (uint32_t i = 0; i < 10; ++i) cache.touch(cache.find(reliefPage(i)), 2);
  auto placed = cache.place(texturePage(1), 2);
  ASSERT_TRUE(placed);
  EXPECT_TRUE(placed->emptied);
  EXPECT_EQ(placed->evicted.size(), 32u);
  EXPECT_EQ(cache.pageCount(), 12u);
  // One use of one part keeps the whole slot; then the other slot's parts leave for a half.
  cache.touch(cache.find(reliefPage(5)), 3);
  cache.touch(cache.find(texturePage(0)), 3);
  cache.touch(cache.find(texturePage(1)), 3);
  placed = cache.place(reliefPage(50), 3, 1, 1);
  ASSERT_TRUE(placed);
  ASSERT_EQ(placed->evicted.size(), 1u) << "the longest idle half, of the first slot";
  EXPECT_EQ(placed->evicted[0].page, reliefPage(0));
  EXPECT_TRUE(cache.checkInvariants(&why)) << why;
}

TEST(SubslotCache, SlotsInThreeAndInTwo) {
  SubslotCache cache(4);
  ASSERT_TRUE(cache.place(reliefPage(0), 1, 1, kHalves));
  for (uint32_t i = 1; i < 4; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, kThirds));
  EXPECT_EQ(cache.residentCount(), 2u) << "three in a slot of their own";
  EXPECT_EQ(cache.dividedCount(), 2u);
  for (uint32_t i = 4; i < 16; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, kThirds + 1));
  EXPECT_EQ(cache.residentCount(), 3u) << "twelve in one slot";
  EXPECT_FALSE(cache.hasPartToFill(1, kThirds)) << "the half that is free is none";
  EXPECT_TRUE(cache.hasPartToFill(1, kHalves + 2)) << "in that half";
  for (uint32_t i = 16; i < 48; ++i) ASSERT_TRUE(cache.place(reliefPage(i), 1, 1, kThirds + 2));
  EXPECT_EQ(cache.residentCount(), 4u);
  EXPECT_TRUE(cache.hasPartToFill(1, kThirds + 1)) << "in the third that has nothing yet";
  EXPECT_EQ(cache.pageCount(), 48u);
  EXPECT_EQ(cache.pageCount(kThirds), 3u);
  for (uint32_t i : {0u, 2u, 17u}) cache.pin(cache.find(reliefPage(i)));
  EXPECT_EQ(cache.pinnedCount(), 3u);
  EXPECT_EQ(cache.pinnedHalvedSlots(), 1u);
  EXPECT_EQ(cache.pinnedHalves(), 1u);
  std::string why;
  EXPECT_TRUE(cache.checkInvariants(&why)) << why;
  std::vector<SlotIndex> idle;
  cache.touch(cache.find(reliefPage(1)), 2);
  cache.idleParts(kHalves, 2, idle);
  EXPECT_EQ(idle.size(), 1u) << "no part of a slot in three is a half";
  cache.idleParts(kThirds, 2, idle);
  EXPECT_EQ(idle.size(), 3u) << "that of page 3, and two beside page 17";
  // A slot in three changes into one in two, where all that is in it is idle.
  const auto placed = cache.place(texturePage(0), 2);
  ASSERT_TRUE(placed);
  EXPECT_EQ(placed->evicted.size(), 12u);
  cache.touch(placed->slot, 3);
  EXPECT_FALSE(cache.place(texturePage(1), 3)) << "all others hold something pinned";
  const auto third = cache.place(reliefPage(60), 3, 1, kThirds + 1);
  ASSERT_TRUE(third);
  EXPECT_FALSE(third->opened_slot);
  EXPECT_TRUE(third->evicted.empty()) << "the third that had nothing yet";
  EXPECT_TRUE(cache.checkInvariants(&why)) << why;
}

// The same rules in the plainest way: what lies where, and when it was used.
struct Model {
  struct Entry {
    PageId id;
    uint64_t tick;
    int pins;
  };
  std::map<SlotIndex, Entry> entries;  // by name

  static bool overlap(SlotIndex a, SlotIndex b) {
    SlotPart p = partOf(a), q = partOf(b);
    if (p.slot != q.slot) return false;
    if (p.level > 0 && q.level > 0 && isThird(p.level) != isThird(q.level)) return true;
    if (p.level > q.level) std::swap(p, q);
    return p.level == 0 ||
           q.part / (kPartsOfSlot[static_cast<size_t>(q.level)] / kPartsOfSlot[static_cast<size_t>(p.level)]) == p.part;
  }
};

// Random operations; the first thing that is wrong, or nothing. careless: somebody in use is forgotten, for the
// control.
std::string randomRun(uint64_t seed, bool careless, int* evicted_pages) {
  std::mt19937_64 random(seed);
  auto upTo = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
  const uint32_t slots = 1 + upTo(12);
  SubslotCache cache(slots);
  Model model;
  std::map<uint32_t, int> level_of;
  uint64_t tick = 1;
  std::string why;
  for (int step = 0; step < 3000; ++step) {
    const uint32_t x = upTo(6 * slots + 1);
    const bool relief = upTo(3) > 0;
    const PageId id = relief ? reliefPage(x) : texturePage(x);
    auto known =
        std::find_if(model.entries.begin(), model.entries.end(), [&](const auto& e) { return e.second.id == id; });
    const std::string at = "seed " + std::to_string(seed) + ", step " + std::to_string(step) + ": ";
    if ((known == model.entries.end()) != (cache.find(id) == kNoSlot)) return at + "a page is there, or not";
    if (known != model.entries.end() && cache.find(id) != known->first) return at + "a page has moved";
    switch (upTo(8)) {
      case 0:
        ++tick;
        break;
      case 1:
        if (known == model.entries.end()) break;
        cache.touch(known->first, tick);
        if (!careless) known->second.tick = tick;
        break;
      case 2:
        if (known == model.entries.end() || known->second.pins > 3) break;
        cache.pin(known->first);
        ++known->second.pins;
        break;
      case 3:
        if (known == model.entries.end() || known->second.pins == 0) break;
        cache.touch(known->first, tick);
        cache.unpin(known->first);
        if (--known->second.pins == 0) known->second.tick = tick;
        break;
      default: {
        if (known != model.entries.end()) break;
        if (!level_of.count(x)) level_of[x] = 1 + static_cast<int>(upTo(kPartLevels - 1));
        const int level = relief ? level_of[x] : 0;
        const uint32_t min_age = 1 + upTo(3);
        std::vector<SlotIndex> idle;
        if (relief && upTo(4) == 0) cache.idleParts(isThird(level) ? kThirds : kHalves, tick, idle);
        SubslotCache::Placement placed;
        if (!idle.empty()) {
          if (!cache.isIdle(idle.front(), tick, 1)) return at + "a part is idle, and is not";
          placed = cache.placeInPart(idle.front(), id, tick, level);
          if (placed.opened_slot) return at + "its slot was in use";
          if (!Model::overlap(placed.slot, idle.front())) return at + "not the part that was asked for";
        } else {
          const bool fills = cache.hasPartToFill(tick, level);
          auto found = cache.place(id, tick, min_age, level);
          if (!found) {  // nowhere: every slot has something that may not leave
            if (fills) return at + "there was a free part";
            std::set<uint32_t> held;
            for (const auto& [name, e] : model.entries)
              if (e.pins > 0 || e.tick + min_age > tick) held.insert(partOf(name).slot);
            if (held.size() < slots) return at + "there was room";
            break;
          }
          placed = *found;
          if (fills && (placed.opened_slot || !placed.evicted.empty())) return at + "a free part was not filled";
        }
        // Exactly what lay there has left, and nothing that is pinned or was used too lately.
        std::set<uint64_t> gone;
        for (const auto& out : placed.evicted) gone.insert(out.page.bits);
        *evicted_pages += static_cast<int>(gone.size());
        for (auto e = model.entries.begin(); e != model.entries.end();) {
          const bool left = gone.count(e->second.id.bits) > 0;
          if (Model::overlap(e->first, placed.slot) && !left) return at + "two pages in one place";
          if (left && (e->second.pins > 0 || e->second.tick == tick)) return at + "a page left that was in use";
          if (left) gone.erase(e->second.id.bits);
          e = left ? model.entries.erase(e) : std::next(e);
        }
        if (!gone.empty()) return at + "a page left that was not there";
        if (partOf(placed.slot).level != level) return at + "a place of another size";
        model.entries[placed.slot] = {id, tick, 0};
      }
    }
    if (step % 16 == 0 && !cache.checkInvariants(&why)) return at + why;
    if (cache.pageCount() != model.entries.size()) return at + "pages are counted wrong";
    std::set<uint32_t> used;
    for (const auto& [name, e] : model.entries) used.insert(partOf(name).slot);
    if (cache.residentCount() != used.size()) return at + "slots are counted wrong";
  }
  return "";
}

TEST(SubslotCache, NoTwoPagesInOnePlaceAndNothingInUseLeaves) {
  int evicted = 0;
  for (uint64_t seed = 1; seed <= 60; ++seed) ASSERT_EQ(randomRun(seed, false, &evicted), "");
  EXPECT_GT(evicted, 10000);
}

TEST(SubslotCache, AModelThatForgetsUsesDiffers) {
  int evicted = 0, seen = 0;
  for (uint64_t seed = 1; seed <= 60; ++seed) seen += randomRun(seed, true, &evicted) != "";
  EXPECT_GT(seen, 30);
}

// A texture page and a relief page for each frame's new requests, all slots needed: the half beside a page in use is
// found, whatever is older.
TEST(SubslotCache, IdleHalvesOfSlotsInUse) {
  SubslotCache cache(3);
  for (uint32_t i = 0; i < 4; ++i) cache.place(reliefPage(i), 1 + i / 2, 1, 1);  // slots 0 and 1
  cache.place(texturePage(0), 3);
  cache.touch(cache.find(reliefPage(2)), 4);
  std::vector<SlotIndex> idle;
  cache.idleParts(kHalves, 4, idle);
  ASSERT_EQ(idle.size(), 1u) << "slot 0 is not in use, and slot 2 is not divided";
  EXPECT_EQ(idle[0], cache.find(reliefPage(3)));
  const auto placed = cache.placeInPart(idle[0], reliefPage(9), 4, 1);
  ASSERT_EQ(placed.evicted.size(), 1u);
  EXPECT_EQ(placed.evicted[0].page, reliefPage(3));
  EXPECT_NE(cache.find(reliefPage(0)), kNoSlot);
  cache.idleParts(kHalves, 4, idle);
  EXPECT_TRUE(idle.empty());
}

}  // namespace subslot_cache_test
}  // namespace relievo
