#include "geometry/remesh/triangle_pairs.h"

#include <utility>

#include "geometry/remesh/base_topology.h"

namespace relievo {

namespace {

// A breadth-first search for an alternating path from a triangle without a partner. Odd cycles shrink to their base
// (Edmonds' blossoms), which a forest of disjoint sets tells (Gabow 1976). Only what a search has touched is reset
// before the next one; what one in vain has touched no other needs to look at (the Hungarian tree: Edmonds 1965,
// section 4).
class PathSearch {
 public:
  PathSearch(std::span<const std::array<uint32_t, 3>> neighbours, std::span<const uint8_t> may_stay_alone,
             std::vector<uint32_t>& mate)
      : neighbours_(neighbours),
        may_stay_alone_(may_stay_alone),
        mate_(mate),
        parent_(mate.size(), kNoIndex),
        base_(mate.size()),
        outer_(mate.size(), 0),
        dead_(mate.size(), 0),
        marked_(mate.size(), 0) {
    for (uint32_t t = 0; t < base_.size(); ++t) base_[t] = t;
  }

  // Pairs `root` if that is possible.
  void run(uint32_t root) {
    queue_.assign(1, root);
    touched_.assign(1, root);
    outer_[root] = 1;
    bool in_vain = true;
    for (size_t i = 0; i < queue_.size() && in_vain; ++i) {
      const uint32_t from = queue_[i];
      if (!may_stay_alone_[root] && may_stay_alone_[from]) {
        leaveAlone(from);
        in_vain = false;
      } else if (const uint32_t end = searchFrom(from, root); end != kNoIndex) {
        exchangeAlong(end);
        in_vain = false;
      }
    }
    // Of one that may stay alone another root may still take the place.
    const bool dead = in_vain && !may_stay_alone_[root];
    for (uint32_t t : touched_) {
      dead_[t] = dead;
      parent_[t] = kNoIndex;
      base_[t] = t;
      outer_[t] = 0;
    }
  }

 private:
  void touch(uint32_t t) { touched_.push_back(t); }

  // Looks at the neighbours of an outer triangle. Returns the end of a path, a triangle without a partner; or kNoIndex.
  uint32_t searchFrom(uint32_t from, uint32_t root) {
    for (const uint32_t to : neighbours_[from]) {
      if (to == kNoIndex || dead_[to] || mate_[from] == to || baseOf(from) == baseOf(to)) continue;
      if (to == root || (mate_[to] != kNoIndex && parent_[mate_[to]] != kNoIndex)) {
        shrink(from, to);
      } else if (parent_[to] == kNoIndex) {
        parent_[to] = from;
        touch(to);
        if (mate_[to] == kNoIndex) return to;
        addOuter(mate_[to]);
      }
    }
    return kNoIndex;
  }
  void addOuter(uint32_t t) {
    if (outer_[t]) return;
    outer_[t] = 1;
    touch(t);
    queue_.push_back(t);
  }

  uint32_t baseOf(uint32_t t) {
    while (base_[t] != t) t = base_[t] = base_[base_[t]];
    return t;
  }
  // The base of the smallest cycle through the edge from a to b: both paths to the root, in turn, until they meet.
  uint32_t commonBase(uint32_t a, uint32_t b) {
    ++mark_;
    a = baseOf(a);
    b = baseOf(b);
    for (;; std::swap(a, b)) {
      if (a == kNoIndex) continue;
      if (marked_[a] == mark_) return a;
      marked_[a] = mark_;
      a = mate_[a] == kNoIndex ? kNoIndex : baseOf(parent_[mate_[a]]);
    }
  }
  void markPath(uint32_t t, uint32_t cycle_base, uint32_t child) {
    for (; baseOf(t) != cycle_base; t = parent_[mate_[t]]) {
      cycle_.push_back(baseOf(t));
      cycle_.push_back(baseOf(mate_[t]));
      inner_.push_back(mate_[t]);
      parent_[t] = child;
      child = mate_[t];
    }
  }
  void shrink(uint32_t a, uint32_t b) {
    const uint32_t cycle_base = commonBase(a, b);
    cycle_.clear();
    inner_.clear();
    markPath(a, cycle_base, b);
    markPath(b, cycle_base, a);
    for (const uint32_t t : cycle_) base_[t] = cycle_base;
    for (const uint32_t t : inner_) addOuter(t);
  }

  // Exchanges partners along the path that ends in a triangle without one.
  void exchangeAlong(uint32_t end) {
    while (end != kNoIndex) {
      const uint32_t before = parent_[end], next = mate_[before];
      mate_[end] = before;
      mate_[before] = end;
      end = next;
    }
  }
  // Exchanges partners along the path to an outer triangle, which then stays alone.
  void leaveAlone(uint32_t outer) {
    const uint32_t partner = mate_[outer];
    mate_[outer] = kNoIndex;
    exchangeAlong(partner);
  }

  std::span<const std::array<uint32_t, 3>> neighbours_;
  std::span<const uint8_t> may_stay_alone_;
  std::vector<uint32_t>& mate_;
  std::vector<uint32_t> parent_, base_, queue_, touched_, cycle_, inner_;
  std::vector<uint8_t> outer_, dead_;
  std::vector<uint32_t> marked_;  // by which search for a cycle
  uint32_t mark_ = 0;
};

}  // namespace

void pairMoreTriangles(std::span<const std::array<uint32_t, 3>> neighbours, std::span<const uint8_t> may_stay_alone,
                       std::vector<uint32_t>& mate) {
  PathSearch search(neighbours, may_stay_alone, mate);
  for (uint32_t t = 0; t < mate.size(); ++t)
    if (mate[t] == kNoIndex) search.run(t);
}

}  // namespace relievo
