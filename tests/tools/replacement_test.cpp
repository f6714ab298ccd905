// Replays of traces: Belady's optimum against brute force, and no policy beats it.
#include "tools/bench/replacement.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <map>
#include <random>
#include <set>

#include "tests/view_share.h"

namespace relievo {
namespace replacement_test {

constexpr Replacement kPolicies[] = {Replacement::kLru, Replacement::kClock, Replacement::kHalving};

PageId page(uint32_t x) { return PageId(texturePlane(0), {0, 10, x, 0}); }

PageTrace traceOf(std::initializer_list<std::initializer_list<uint32_t>> frames) {
  PageTrace trace;
  for (const auto& f : frames) {
    trace.emplace_back();
    for (uint32_t x : f) trace.back().push_back(page(x));
  }
  return trace;
}

// No frame wants more than `slots`. A drifting window with jumps back: something like a camera.
PageTrace randomTrace(uint64_t seed, uint32_t slots, int frames) {
  std::mt19937_64 random(seed);
  auto upTo = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
  PageTrace trace;
  uint32_t at = 0, range = 2 * slots + upTo(4 * slots + 1);
  for (int f = 0; f < frames; ++f) {
    if (upTo(4) == 0) at = upTo(10) == 0 ? upTo(range) : at + upTo(3);
    std::set<uint32_t> request;
    for (uint32_t n = upTo(slots + 1); n > 0; --n)
      request.insert((upTo(5) == 0 ? upTo(range) : at + upTo(slots)) % range);
    trace.emplace_back();
    for (uint32_t x : request) trace.back().push_back(page(x));
    std::shuffle(trace.back().begin(), trace.back().end(), random);
    if (!trace.back().empty() && upTo(3) == 0) trace.back().push_back(trace.back().front());  // named twice
  }
  return trace;
}

// The fewest misses of any choice of victims, by trying them all: a map from what may be resident to the fewest misses
// so far.
uint64_t bruteForceMisses(const PageTrace& trace, size_t slots) {
  std::map<std::set<PageId>, uint64_t> states{{{}, 0}};
  for (const auto& frame : trace) {
    std::set<PageId> request(frame.begin(), frame.end());
    std::map<std::set<PageId>, uint64_t> after;
    for (const auto& [resident, misses] : states) {
      std::set<PageId> all = request;
      all.insert(resident.begin(), resident.end());
      std::vector<PageId> others;
      std::set_difference(resident.begin(), resident.end(), request.begin(), request.end(), std::back_inserter(others));
      auto missed = static_cast<uint64_t>(
          std::count_if(request.begin(), request.end(), [&held = resident](PageId p) { return !held.contains(p); }));
      size_t must_leave = all.size() > slots ? all.size() - slots : 0;
      for (uint32_t choice = 0; choice < 1u << others.size(); ++choice) {
        if (static_cast<size_t>(std::popcount(choice)) != must_leave) continue;
        std::set<PageId> stay = all;
        for (size_t i = 0; i < others.size(); ++i)
          if (choice >> i & 1) stay.erase(others[i]);
        auto [it, is_new] = after.try_emplace(stay, misses + missed);
        it->second = std::min(it->second, misses + missed);
      }
    }
    states = std::move(after);
  }
  uint64_t best = ~uint64_t{0};
  for (const auto& [resident, misses] : states) best = std::min(best, misses);
  return best;
}

TEST(Replacement, BeladyEqualsBruteForceOnSmallTraces) {
  int lru_is_worse = 0;
  for (uint64_t seed = 1; seed <= 150; ++seed) {
    uint32_t slots = 1 + static_cast<uint32_t>(seed % 4);
    PageTrace trace = randomTrace(seed, slots, 14);
    uint64_t best = bruteForceMisses(trace, slots);
    ASSERT_EQ(replayOptimum(trace, slots).misses, best) << "seed " << seed;
    lru_is_worse += replay(trace, slots, Replacement::kLru).misses > best;
  }
  EXPECT_GT(lru_is_worse, 50) << "the control: a policy that is not the optimum does not pass for it";
}

TEST(Replacement, NoPolicyBeatsBelady) {
  for (uint64_t seed = 1; seed <= (test::kSanitized ? 12 : 200); ++seed) {
    auto slots = static_cast<uint32_t>(2 + seed % 60);
    PageTrace trace = randomTrace(seed, slots, 300);
    ReplayResult best = replayOptimum(trace, slots);
    ASSERT_EQ(best.unplaced, 0u);
    for (Replacement policy : kPolicies) {
      ReplayResult r = replay(trace, slots, policy);
      ASSERT_EQ(r.wanted, best.wanted);
      ASSERT_EQ(r.first_uses, best.first_uses);
      ASSERT_EQ(r.first_uses, distinctPages(trace));
      ASSERT_GE(r.misses, best.misses) << replacementName(policy) << ", seed " << seed;
      ASSERT_GE(best.misses, best.first_uses);
    }
  }
}

// The control of the one above: when frames want more than the cache holds, the comparison is of another kind, and says
// so.
TEST(Replacement, FramesLargerThanTheCacheAreCounted) {
  PageTrace trace = traceOf({{0, 1, 2, 3}, {3, 2, 1, 0}});
  for (Replacement policy : kPolicies) {
    ReplayResult r = replay(trace, 3, policy);
    EXPECT_EQ(r.misses, 5u);
    EXPECT_EQ(r.unplaced, 2u) << "page 3, twice: what is wanted now does not make room for what is wanted now";
    EXPECT_EQ(r.evictions, 0u);
  }
  EXPECT_EQ(replayOptimum(trace, 3).misses, 5u);
  EXPECT_EQ(replayOptimum(trace, 3).unplaced, 2u);
  EXPECT_EQ(replayOptimum(trace, 0).misses, 8u);
  EXPECT_EQ(replay(trace, 0, Replacement::kLru).unplaced, 8u);
}

TEST(Replacement, ALoopIsTheWorstForLruAndNotForBelady) {
  // 5 pages in turn, 4 slots: LRU always has just lost what comes next; the optimum misses one in four of them.
  PageTrace trace;
  for (uint32_t f = 0; f < 400; ++f) trace.push_back({page(f % 5)});
  EXPECT_EQ(replay(trace, 4, Replacement::kLru).hits(), 0u);
  EXPECT_EQ(replayOptimum(trace, 4).misses, 5u + (400 - 5) / 4);
  for (Replacement policy : kPolicies)
    EXPECT_EQ(replay(trace, 5, policy).misses, 5u) << "with room for all, first uses only";
}

TEST(Replacement, CountsByHand) {
  PageTrace trace = traceOf({{0, 1}, {2, 2}, {0}, {3}, {1}});
  ReplayResult r = replay(trace, 3, Replacement::kLru);  // 3 takes the slot of 1, the oldest; 1 takes that of 2
  EXPECT_EQ(r.wanted, 6u);
  EXPECT_EQ(r.misses, 5u);
  EXPECT_EQ(r.first_uses, 4u);
  EXPECT_EQ(r.evictions, 2u);
  ReplayResult best = replayOptimum(trace, 3);  // 3 takes the slot of 2 or 0, which are never wanted again
  EXPECT_EQ(best.misses, 4u);
  EXPECT_EQ(best.evictions, 1u);
  EXPECT_NEAR(best.hitRate(), 2.0 / 6, 1e-12);
  EXPECT_EQ(distinctPages(trace), 4u);
  EXPECT_EQ(largestFrame(trace), 2u);
  EXPECT_EQ(replay({}, 3, Replacement::kLru).hitRate(), 1.0);
}

TEST(HandCache, ClockGivesASecondChance) {
  HandCache cache(4, Replacement::kClock);
  for (uint32_t i = 0; i < 4; ++i) cache.place(page(i), 1);
  // All are marked: the hand clears every mark, comes back to slot 0 and takes it.
  EXPECT_EQ(cache.place(page(10), 2).evicted, page(0));
  cache.touch(page(1), 2);
  // Slot 1 was used since: it is passed (in a later frame, too) and slot 2 leaves.
  EXPECT_EQ(cache.place(page(11), 3).evicted, page(2));
  EXPECT_EQ(cache.place(page(12), 3).evicted, page(3));
  // 10 has its mark since it was placed, 1 lost its own: 1 leaves, though 10 was used no later than it.
  EXPECT_EQ(cache.place(page(13), 4).evicted, page(1));
}

TEST(HandCache, HalvingLowersItsThresholdWithinAFrameOnly) {
  constexpr uint32_t kFirst = kFirstThreshold;
  HandCache cache(3, Replacement::kHalving);
  cache.place(page(0), 1);
  cache.place(page(1), 1 + kFirst / 4);
  cache.place(page(2), 2);
  uint64_t now = 1 + kFirst;  // ages: kFirst, 3/4 kFirst, kFirst - 1; none is above kFirst, all are above kFirst / 2
  EXPECT_EQ(cache.place(page(3), now).evicted, page(0)) << "first slot of the round after the halving";
  EXPECT_EQ(cache.place(page(4), now).evicted, page(1)) << "the hand goes on, the threshold stays";
  // A new frame: the threshold is back, and only page 2 is older than it.
  EXPECT_EQ(cache.place(page(5), 3 + kFirst).evicted, page(2));
  HandCache again(2, Replacement::kHalving);
  again.place(page(0), 5);
  again.place(page(1), 4);
  EXPECT_EQ(again.place(page(2), 6).evicted, page(0)) << "down to threshold 0, any page of an older frame";
  EXPECT_EQ(again.place(page(3), 6).evicted, page(1));
  EXPECT_FALSE(again.place(page(4), 6).placed);
}

}  // namespace replacement_test
}  // namespace relievo
