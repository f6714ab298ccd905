#include "tools/bench/replacement.h"

#include <algorithm>
#include <cassert>
#include <queue>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "texturing/stream/page_cache.h"

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

// What replays ask of a cache: PageCache's way of saying it.
class LruCache {
 public:
  explicit LruCache(uint32_t slots) : cache_(slots) {}
  bool touch(PageId id, uint64_t tick) {
    const SlotIndex slot = cache_.find(id);
    if (slot == kNoSlot) return false;
    cache_.touch(slot, tick);
    return true;
  }
  HandCache::Placement place(PageId id, uint64_t tick) {
    const auto placement = cache_.place(id, tick);
    return placement ? HandCache::Placement{true, placement->evicted} : HandCache::Placement{};
  }

 private:
  PageCache cache_;
};

template <class Cache>
ReplayResult replayThrough(const PageTrace& trace, Cache cache) {
  ReplayResult result;
  std::unordered_set<PageId> known;
  std::vector<PageId> missing;
  uint64_t tick = 0;
  for (const auto& frame : unique(trace)) {
    ++tick;
    missing.clear();
    for (PageId id : frame) {
      ++result.wanted;
      if (!cache.touch(id, tick)) missing.push_back(id);
    }
    for (PageId id : missing) {
      ++result.misses;
      result.first_uses += known.insert(id).second;
      const auto placement = cache.place(id, tick);
      result.unplaced += !placement.placed;
      result.evictions += placement.evicted.has_value();
    }
  }
  return result;
}

}  // namespace

const char* replacementName(Replacement policy) {
  switch (policy) {
    case Replacement::kLru:
      return "lru";
    case Replacement::kClock:
      return "clock";
    case Replacement::kHalving:
      return "halving";
  }
  return "";
}

HandCache::HandCache(uint32_t slots, Replacement policy) : policy_(policy), slot_count_(slots) {
  assert(policy != Replacement::kLru);
}

uint64_t HandCache::advance(uint64_t tick) {
  if (tick > last_tick_) {
    last_tick_ = tick;
    threshold_ = kFirstThreshold;
  }
  return last_tick_;
}

bool HandCache::touch(PageId id, uint64_t tick) {
  const auto found = index_.find(id);
  if (found == index_.end()) return false;
  slots_[found->second].tick = advance(tick);
  slots_[found->second].marked = true;
  return true;
}

HandCache::Placement HandCache::place(PageId id, uint64_t tick) {
  assert(!index_.contains(id));
  tick = advance(tick);
  if (slots_.size() < slot_count_) {
    index_[id] = slots_.size();
    slots_.push_back({id, tick, true});
    return {true, std::nullopt};
  }
  const auto slot = victim(tick);
  if (!slot) return {};
  const PageId evicted = slots_[*slot].page;
  index_.erase(evicted);
  index_[id] = *slot;
  slots_[*slot] = {id, tick, true};
  return {true, evicted};
}

size_t HandCache::step() {
  const size_t s = hand_;
  hand_ = hand_ + 1 == slots_.size() ? 0 : hand_ + 1;
  return s;
}

std::optional<size_t> HandCache::victim(uint64_t tick) {
  if (policy_ == Replacement::kClock) {
    for (size_t n = 2 * slots_.size(); n > 0; --n) {  // the first round may find nothing but marks to clear
      const size_t s = step();
      if (slots_[s].tick == tick) continue;
      if (!std::exchange(slots_[s].marked, false)) return s;
    }
    return std::nullopt;
  }
  for (;; threshold_ /= 2) {
    for (size_t n = slots_.size(); n > 0; --n)
      if (const size_t s = step(); tick - slots_[s].tick > threshold_) return s;
    if (threshold_ == 0) return std::nullopt;
  }
}

ReplayResult replay(const PageTrace& trace, uint32_t slots, Replacement policy) {
  return policy == Replacement::kLru ? replayThrough(trace, LruCache(slots))
                                     : replayThrough(trace, HandCache(slots, policy));
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
