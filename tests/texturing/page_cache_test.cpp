// One budget, the least recently used leaves: the cache against a naive model, and each plane against the others.
#include "texturing/stream/page_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>

#include "tests/view_share.h"

namespace relievo {
namespace page_cache_test {

PageId texturePage(uint32_t x) { return PageId(texturePlane(x % 3), {0, 10, x, 0}); }
PageId reliefPage(uint32_t x) { return PageId(Plane::kRelief, {0, 10, x, 1}); }

// The same rules in the plainest way: a list of pages with their last use, searched from end to end.
struct Model {
  struct Entry {
    PageId id;
    uint64_t tick, order;
    int pins;
  };
  size_t slots;
  std::vector<Entry> entries;
  uint64_t last_tick = 0, order = 0;

  Entry* find(PageId id) {
    for (Entry& e : entries)
      if (e.id == id) return &e;
    return nullptr;
  }
  void touch(Entry& e, uint64_t tick) {
    e.tick = last_tick = std::max(last_tick, tick);
    if (e.pins == 0) e.order = ++order;
  }
  void unpin(Entry& e) {
    if (--e.pins > 0) return;
    e.tick = last_tick;
    e.order = ++order;
  }
  // Whether there is room, and who leaves.
  std::pair<bool, std::optional<PageId>> place(PageId id, uint64_t tick, uint64_t min_age) {
    last_tick = std::max(last_tick, tick);
    if (Entry* e = find(id)) {
      touch(*e, tick);
      return {true, std::nullopt};
    }
    std::optional<PageId> evicted;
    if (entries.size() == slots) {
      auto victim = entries.end();
      for (auto e = entries.begin(); e != entries.end(); ++e)
        if (e->pins == 0 && (victim == entries.end() || e->order < victim->order)) victim = e;
      if (victim == entries.end() || victim->tick + min_age > tick) return {false, std::nullopt};
      evicted = victim->id;
      entries.erase(victim);
    }
    entries.push_back({id, last_tick, ++order, 0});
    return {true, evicted};
  }
  std::vector<PageId> lruOrder() {
    auto sorted = entries;
    std::erase_if(sorted, [](const Entry& e) { return e.pins > 0; });
    std::sort(sorted.begin(), sorted.end(), [](const Entry& a, const Entry& b) { return a.order < b.order; });
    std::vector<PageId> ids;
    for (const Entry& e : sorted) ids.push_back(e.id);
    return ids;
  }
};

// Runs random operations on both; the first difference, or nothing. `broken` makes the model differ, for the control.
std::string compareWithModel(uint64_t seed, bool broken) {
  std::mt19937_64 random(seed);
  auto upTo = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
  uint32_t slots = 1 + upTo(24);
  PageCache cache(slots);
  Model model{slots, {}, 0, 0};
  uint64_t tick = 1;
  for (int step = 0; step < 4000; ++step) {
    uint32_t x = upTo(3 * slots + 1);
    PageId id = upTo(2) ? texturePage(x) : reliefPage(x);
    auto where = "step " + std::to_string(step) + ": ";
    auto* entry = model.find(id);
    SlotIndex slot = cache.find(id);
    if ((slot != kNoSlot) != (entry != nullptr)) return where + "resident in one, absent in the other";
    switch (upTo(12)) {
      case 0:
        tick += upTo(3);
        break;
      case 1:
      case 2:
        if (entry) {
          cache.touch(slot, tick);
          if (!(broken && upTo(50) == 0)) model.touch(*entry, tick);
        }
        break;
      case 3:
        if (entry && cache.pinnedCount() < slots) {
          cache.pin(slot);
          ++entry->pins;
        }
        break;
      case 4:
      case 5:
        if (entry && entry->pins > 0) {
          cache.unpin(slot);
          model.unpin(*entry);
        }
        break;
      case 6:
        if (entry ? entry->pins == 0 : true) {
          cache.remove(id);
          std::erase_if(model.entries, [&](const Model::Entry& e) { return e.id == id; });
        }
        break;
      default: {
        std::map<PageId, SlotIndex> before;
        cache.forEach([&](PageId p) { before[p] = cache.find(p); });
        uint32_t min_age = upTo(3) ? 1 : 1 + upTo(6);
        auto placement = cache.place(id, tick, min_age);
        auto [room, evicted] = model.place(id, tick, min_age);
        if (placement.has_value() != room) return where + "one finds room, the other does not";
        if (!placement) break;
        if (placement->evicted != evicted) return where + "different pages are evicted";
        if (cache.pageIn(placement->slot) != id || cache.find(id) != placement->slot)
          return where + "placed elsewhere than said";
        for (const auto& [p, s] : before)
          if (p != evicted && cache.find(p) != s) return where + "a page moved or vanished that was not evicted";
      }
    }
    std::string why;
    if (!cache.checkInvariants(&why)) return where + why;
    if (cache.residentCount() != model.entries.size() || cache.residentCount() > slots)
      return where + "different numbers of pages";
    if (cache.lruOrder() != model.lruOrder()) return where + "different orders of use";
    auto pinned = std::count_if(model.entries.begin(), model.entries.end(), [](const auto& e) { return e.pins > 0; });
    if (cache.pinnedCount() != static_cast<uint32_t>(pinned)) return where + "different numbers of pinned pages";
  }
  return {};
}

// Whatever age is asked for, what the current frame uses stays.
TEST(PageCache, AnAgeOf0SparesTheCurrentFrameToo) {
  {
    PageCache cache(1);
    const PageId first(Plane::kTexture0, {1, 0, 0, 0}), second(Plane::kTexture0, {2, 0, 0, 0});
    ASSERT_TRUE(cache.place(first, 1));
    EXPECT_FALSE(cache.place(second, 1, 0));
    EXPECT_NE(cache.find(first), kNoSlot);
    EXPECT_TRUE(cache.place(second, 2, 0)) << "a frame later";
  }
}

TEST(PageCache, RandomOperationsAgreeWithANaiveModel) {
  for (uint64_t seed = 1; seed <= (test::kSanitized ? 30 : 100); ++seed)
    ASSERT_EQ(compareWithModel(seed, false), "") << "seed " << seed;
}

TEST(PageCache, TheComparisonSeesAForgottenTouch) {
  int seen = 0;
  for (uint64_t seed = 1; seed <= 20; ++seed) seen += !compareWithModel(seed, true).empty();
  EXPECT_GE(seen, 10);  // with one or two slots the order says little
}

// What must hold, against a plain record of uses and pins: who leaves was free to leave, nobody does
// while a slot is free, and "no room" is true. `too_young` makes the record count pages of the last frame as used now:
// the control.
std::string checkEvictions(uint64_t seed, bool too_young) {
  std::mt19937_64 random(seed);
  auto upTo = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
  uint32_t slots = 1 + upTo(40);
  PageCache cache(slots);
  struct Seen {
    uint64_t tick;
    int pins;
  };
  std::map<PageId, Seen> seen;
  uint64_t tick = 1, told = 0;  // the frame, and the last one that the cache was told of
  for (int step = 0; step < 4000; ++step) {
    auto where = "step " + std::to_string(step) + ": ";
    PageId id = upTo(2) ? texturePage(upTo(2 * slots + 1)) : reliefPage(upTo(2 * slots + 1));
    auto it = seen.find(id);
    SlotIndex slot = cache.find(id);
    if ((slot != kNoSlot) != (it != seen.end())) return where + "resident in one, absent in the other";
    uint32_t what = upTo(16);
    if (what < 2) {
      tick += upTo(10) ? 1 : 100;
    } else if (what < 5 && it != seen.end()) {
      cache.touch(slot, tick);
      if (it->second.pins == 0) it->second.tick = tick;
      told = tick;
    } else if (what == 5 && it != seen.end() && cache.pinnedCount() < slots) {
      cache.pin(slot);
      ++it->second.pins;
    } else if (what < 8 && it != seen.end() && it->second.pins > 0) {
      cache.unpin(slot);
      --it->second.pins;
      it->second.tick = told;
    } else if (what == 8 && it != seen.end() && it->second.pins == 0) {
      cache.remove(id);
      seen.erase(it);
    } else {
      uint32_t min_age = upTo(3) ? 1 : 1 + upTo(80);
      bool full = seen.size() == slots, known = it != seen.end();
      auto mayLeave = [&](const Seen& s) { return s.pins == 0 && s.tick + min_age + too_young <= tick; };
      bool room = known || !full;
      for (const auto& [page, s] : seen) room = room || mayLeave(s);
      auto placement = cache.place(id, tick, min_age);
      told = tick;
      if (placement.has_value() != room) return where + (room ? "no slot, and there was one" : "a slot out of nothing");
      if (!placement) continue;
      if (placement->evicted.has_value() != (full && !known)) return where + "evicted for nothing, or not at all";
      if (placement->evicted) {
        auto gone = seen.find(*placement->evicted);
        if (gone == seen.end() || !mayLeave(gone->second)) return where + "a page left that had to stay";
        seen.erase(gone);
      }
      seen[id].tick = tick;
    }
    std::string why;
    if (!cache.checkInvariants(&why)) return where + why;
    if (cache.residentCount() != seen.size()) return where + "different numbers of pages";
  }
  return {};
}

TEST(PageCache, WhatIsInUseStaysAndWhatIsNotIsFound) {
  for (uint64_t seed = 1; seed <= 120; ++seed) ASSERT_EQ(checkEvictions(seed, false), "") << "seed " << seed;
}

TEST(PageCache, TheCheckSeesEvictionsOfWhatIsTooYoung) {
  int caught = 0;
  for (uint64_t seed = 1; seed <= 10; ++seed) caught += !checkEvictions(seed, true).empty();
  EXPECT_GE(caught, 9);
}

TEST(PageCache, MetadataIsTwentyOneBytesASlot) {
  for (uint32_t slots : {1000u, 3628u, kMaxSlots}) {
    PageCache cache(slots);
    for (uint32_t i = 0; i < 2 * slots; ++i) ASSERT_TRUE(cache.place(texturePage(i), 1 + i));
    EXPECT_EQ(cache.residentCount(), slots);
    EXPECT_LE(static_cast<double>(cache.metadataBytes() - sizeof cache) / slots, 21.01);
  }
  EXPECT_EQ(PageCache(70000).slotCount(), kMaxSlots);
}

TEST(PageCache, TexturePagesEvictStaleReliefPagesAndTheReverse) {
  for (bool texture_first : {true, false}) {
    PageCache cache(8);
    auto first = texture_first ? texturePage : reliefPage;
    auto second = texture_first ? reliefPage : texturePage;
    for (uint32_t i = 0; i < 8; ++i) ASSERT_TRUE(cache.place(first(i), 1));
    for (uint32_t i = 0; i < 8; ++i) {
      auto placement = cache.place(second(i), 2);
      ASSERT_TRUE(placement);
      EXPECT_EQ(placement->evicted, first(i)) << "the least recently used page leaves, whatever its plane";
    }
    EXPECT_EQ(cache.residentCount(), 8u);
    EXPECT_FALSE(cache.place(first(0), 2)) << "everything is used in this frame";
    EXPECT_TRUE(cache.place(first(0), 3));
  }
}

TEST(PageCache, PagesOfThisFrameAndPinnedOnesStay) {
  PageCache cache(3);
  for (uint32_t i = 0; i < 3; ++i) cache.place(texturePage(i), 1);
  cache.pin(cache.find(texturePage(0)));
  cache.pin(cache.find(texturePage(0)));
  cache.touch(cache.find(texturePage(1)), 2);
  EXPECT_EQ(cache.place(reliefPage(0), 2)->evicted, texturePage(2));
  EXPECT_FALSE(cache.place(reliefPage(1), 2));
  cache.unpin(cache.find(texturePage(0)));
  EXPECT_EQ(cache.pinnedCount(), 1u) << "pinned twice, unpinned once";
  for (uint32_t i = 0; i < 9; ++i) cache.place(reliefPage(i), 3 + i);
  EXPECT_NE(cache.find(texturePage(0)), kNoSlot);
  cache.unpin(cache.find(texturePage(0)));
  EXPECT_EQ(cache.pinnedCount(), 0u);
  EXPECT_EQ(cache.lruOrder().back(), texturePage(0)) << "what was held until now is the most recently used";
}

TEST(PageCache, NoSlots) {
  PageCache cache(0);
  EXPECT_FALSE(cache.place(texturePage(0), 1));
  EXPECT_EQ(cache.find(texturePage(0)), kNoSlot);
  EXPECT_TRUE(cache.checkInvariants(nullptr));
}

}  // namespace page_cache_test
}  // namespace relievo
