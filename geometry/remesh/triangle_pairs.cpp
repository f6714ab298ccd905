#include "geometry/remesh/triangle_pairs.h"

#include "geometry/remesh/base_topology.h"

namespace relievo {

namespace {

// A breadth-first search for an alternating path from a triangle without a partner. Odd cycles shrink to their base
// (Edmonds' blossoms). Only what a search has touched is reset before the next one.
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
        marked_(mate.size(), 0),
        in_cycle_(mate.size(), 0) {
    for (uint32_t t = 0; t < base_.size(); ++t) base_[t] = t;
  }

  // Pairs `root` if that is possible.
  void run(uint32_t root) {
    queue_.assign(1, root);
    touched_.assign(1, root);
    outer_[root] = 1;
    for (size_t i = 0; i < queue_.size(); ++i) {
      const uint32_t from = queue_[i];
      if (!may_stay_alone_[root] && may_stay_alone_[from]) {
        leaveAlone(from);
        break;
      }
      if (const uint32_t end = searchFrom(from, root); end != kNoIndex) {
        exchangeAlong(end);
        break;
      }
    }
    for (uint32_t t : touched_) {
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
      if (to == kNoIndex || base_[from] == base_[to] || mate_[from] == to) continue;
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

  // The base of the smallest cycle through the edge from a to b.
  uint32_t commonBase(uint32_t a, uint32_t b) {
    std::vector<uint32_t> path;
    for (;;) {
      a = base_[a];
      marked_[a] = 1;
      path.push_back(a);
      if (mate_[a] == kNoIndex) break;
      a = parent_[mate_[a]];
    }
    for (b = base_[b]; !marked_[b]; b = base_[parent_[mate_[b]]]) {
    }
    for (uint32_t t : path) marked_[t] = 0;
    return b;
  }
  void markPath(uint32_t t, uint32_t cycle_base, uint32_t child) {
    for (; base_[t] != cycle_base; t = parent_[mate_[t]]) {
      in_cycle_[base_[t]] = in_cycle_[base_[mate_[t]]] = 1;
      parent_[t] = child;
      child = mate_[t];
    }
  }
  void shrink(uint32_t a, uint32_t b) {
    const uint32_t cycle_base = commonBase(a, b);
    markPath(a, cycle_base, b);
    markPath(b, cycle_base, a);
    // touched_ grows while its earlier part is read.
    const size_t count = touched_.size();
    for (size_t i = 0; i < count; ++i) {
      const uint32_t t = touched_[i];
      if (!in_cycle_[base_[t]]) continue;
      base_[t] = cycle_base;
      addOuter(t);
    }
    for (size_t i = 0; i < count; ++i) in_cycle_[touched_[i]] = 0;
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
  std::vector<uint32_t> parent_, base_, queue_, touched_;
  std::vector<uint8_t> outer_, marked_, in_cycle_;
};

}  // namespace

void pairMoreTriangles(std::span<const std::array<uint32_t, 3>> neighbours, std::span<const uint8_t> may_stay_alone,
                       std::vector<uint32_t>& mate) {
  PathSearch search(neighbours, may_stay_alone, mate);
  for (uint32_t t = 0; t < mate.size(); ++t)
    if (mate[t] == kNoIndex) search.run(t);
}

}  // namespace relievo
