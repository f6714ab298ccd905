// node_id.h - the name of a place on an artwork: a node of the quadtree over one patch.
// Level 0 covers the patch; a node (level, x, y) has the children (level + 1, 2x + {0,1}, 2y + {0,1}). x grows to the
// right, y grows downwards (image order). Integers name places; floats only ever live inside a node.
#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>

namespace relievo {

struct NodeId {
  uint32_t patch = 0;
  uint32_t level = 0;
  uint32_t x = 0;
  uint32_t y = 0;

  friend auto operator<=>(const NodeId&, const NodeId&) = default;
  NodeId parent() const { return {patch, level - 1, x >> 1, y >> 1}; }
  NodeId child(uint32_t cx, uint32_t cy) const { return {patch, level + 1, 2 * x + cx, 2 * y + cy}; }
  // The ancestor at a coarser (or the same) level.
  NodeId ancestor(uint32_t coarser) const { return {patch, coarser, x >> (level - coarser), y >> (level - coarser)}; }
};

enum Side : int { kLeft = 0, kRight = 1, kTop = 2, kBottom = 3 };  // x = 0, x = N, y = 0, y = N of a node's grid

// 64-bit packing: level 5 | patch 20 | x 17 | y 17 bits, 59 in all (PageId adds the plane above them).
inline constexpr uint32_t kMaxNodeLevel = 17;  // 2^17 pages of 128 texels = 2^24 texels a side
inline constexpr uint32_t kMaxPatches = 1u << 20;
inline constexpr uint64_t packNode(const NodeId& n) {
  return (uint64_t{n.level} << 54) | (uint64_t{n.patch} << 34) | (uint64_t{n.x} << 17) | uint64_t{n.y};
}
inline constexpr NodeId unpackNode(uint64_t key) {
  return {static_cast<uint32_t>((key >> 34) & 0xFFFFFu), static_cast<uint32_t>((key >> 54) & 0x1Fu),
          static_cast<uint32_t>((key >> 17) & 0x1FFFFu), static_cast<uint32_t>(key & 0x1FFFFu)};
}

}  // namespace relievo

template <>
struct std::hash<relievo::NodeId> {
  size_t operator()(const relievo::NodeId& n) const noexcept {
    uint64_t h = relievo::packNode(n) * 0x9E3779B97F4A7C15ull;
    return static_cast<size_t>(h ^ (h >> 32));
  }
};
