// square.h - a place in a forest of quadtrees: node ids with the arithmetic of parents, children and sides. Levels may
// exceed kMaxNodeLevel, where nodes are finer than every page. Internal to geometry/.
#pragma once

#include <cstdint>

#include "src/artwork/node_id.h"

namespace relievo {

// A square of a patch: of level l there are 2^l x 2^l.
struct Square {
  uint32_t patch = 0;
  int level = 0;
  uint32_t x = 0, y = 0;
  Square ancestor(int coarser) const { return {patch, coarser, x >> (level - coarser), y >> (level - coarser)}; }
  Square child(uint32_t k) const { return {patch, level + 1, 2 * x + (k & 1), 2 * y + (k >> 1)}; }
  // The child at a half of a side, the first half towards smaller coordinates.
  Square childAt(int side, uint32_t half) const {
    return child(side == kLeft || side == kRight ? (side == kRight) + 2 * half : half + 2 * (side == kBottom));
  }
  NodeId id() const { return {patch, static_cast<uint32_t>(level), x, y}; }
  friend bool operator==(const Square&, const Square&) = default;
};

}  // namespace relievo
