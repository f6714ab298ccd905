#include "tools/bench/replacement.h"

#include <algorithm>
#include <queue>
#include <unordered_map>
#include <unordered_set>
#include <utility>

namespace relievo {
namespace {

constexpr uint32_t kNever = ~0u;

// Each frame's list without repetitions, in the same order.
PageTrace unique(const PageTrace& trace) {
  PageTrace result(trace.size());
  std::unordered_set<PageId> seen;
  for (size_t f = 0; f < trace.size(); ++f) {
    seen.clear();
    for (PageId id : trace[f])
      if (seen.insert(id).second) result[f].push_back(id);
  }
  return result;
}

}  // namespace

ReplayResult replay(const PageTrace& trace, uint32_t slots, Replacement policy) {
  ReplayResult result;
  PageCache cache(slots, policy);
  std::unordered_set<PageId> known;
  std::vector<PageId> missing;
  uint64_t tick = 0;
  for (const auto& frame : unique(trace)) {
    ++tick;
    missing.clear();
    for (PageId id : frame) {
      ++result.wanted;
      SlotIndex slot = cache.find(id);
      if (slot != kNoSlot) {
        cache.touch(slot, tick);
      } else {
        missing.push_back(id);
      }
    }
    for (PageId id : missing) {
      ++result.misses;
      result.first_uses += known.insert(id).second;
      auto placement = cache.place(id, tick);
      result.unplaced += !placement;
      result.evictions += placement && placement->evicted;
    }
  }
  return result;
}

ReplayResult replayOptimum(const PageTrace& trace, uint32_t slots) {
  PageTrace frames = unique(trace);
  // next[f][i]: the frame after f that wants frames[f][i] again.
  std::vector<std::vector<uint32_t>> next(frames.size());
  std::unordered_map<PageId, uint32_t> later;
  for (size_t f = frames.size(); f-- > 0;) {
    next[f].reserve(frames[f].size());
    for (PageId id : frames[f]) {
      auto [it, is_new] = later.try_emplace(id, kNever);
      next[f].push_back(it->second);
      it->second = static_cast<uint32_t>(f);
    }
  }

  ReplayResult result;
  std::unordered_set<PageId> known;
  std::unordered_map<PageId, uint32_t> resident;  // page -> its next use
  // What may leave, farthest next use first. A page used in this frame is only pushed at its end; its older entries,
  // which name this frame as the next use, no longer agree with `resident` and are skipped.
  using Candidate = std::pair<uint32_t, uint64_t>;
  std::priority_queue<Candidate> candidates;
  std::vector<Candidate> used, missing;
  for (size_t f = 0; f < frames.size(); ++f) {
    used.clear();
    missing.clear();
    for (size_t i = 0; i < frames[f].size(); ++i) {
      ++result.wanted;
      PageId id = frames[f][i];
      auto it = resident.find(id);
      if (it == resident.end()) {
        missing.emplace_back(next[f][i], id.bits);
      } else {
        it->second = next[f][i];
        used.emplace_back(next[f][i], id.bits);
      }
    }
    for (const auto& [again, bits] : missing) {
      ++result.misses;
      PageId id;
      id.bits = bits;
      result.first_uses += known.insert(id).second;
      if (resident.size() >= slots) {
        bool evicted = false;
        while (!evicted && !candidates.empty()) {
          auto [when, whom] = candidates.top();
          candidates.pop();
          PageId page;
          page.bits = whom;
          auto it = resident.find(page);
          if (it == resident.end() || it->second != when) continue;
          resident.erase(it);
          evicted = true;
        }
        result.evictions += evicted;
        result.unplaced += !evicted;
        if (!evicted) continue;
      }
      resident.emplace(id, again);
      used.emplace_back(again, bits);
    }
    for (const Candidate& c : used) candidates.push(c);
  }
  return result;
}

uint32_t distinctPages(const PageTrace& trace) {
  std::unordered_set<PageId> pages;
  for (const auto& frame : trace) pages.insert(frame.begin(), frame.end());
  return static_cast<uint32_t>(pages.size());
}

uint32_t largestFrame(const PageTrace& trace) {
  size_t most = 0;
  for (const auto& frame : unique(trace)) most = std::max(most, frame.size());
  return static_cast<uint32_t>(most);
}

}  // namespace relievo
