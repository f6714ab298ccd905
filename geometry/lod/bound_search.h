// bound_search.h - the least upper bound that is known of what is drawn, by parts: the part with the largest bound is
// divided until it cannot be. What is nowhere near the largest is never looked at closely, so that a search costs some
// tens of parts. Internal to geometry/.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "geometry/lod/desired_level.h"

namespace relievo {

// Levels (desired levels) of a drawn node's sides, by side: of a whole one, then kWholeSide; or of its two halves.
using SideLevels = std::array<std::array<int, 2>, 4>;
inline constexpr int kWholeSide = -1;
inline int coarsestOf(const std::array<int, 2>& side) {
  return side[1] == kWholeSide ? side[0] : std::min(side[0], side[1]);
}

// The coarsest level that triangles within a part of a node, square (x, y) of the 2^depth a side, have vertices of:
// that of its inside and those of the sides that the part lies at. Around a corner: a vertex next to one snaps away
// from it where segments have two cells, and only there; then a triangle with vertices on the other side of the corner
// reaches two cells along this one.
inline int coarsestAround(const SideLevels& sides, int inside, int node_level, int depth, uint32_t x, uint32_t y) {
  const uint32_t last = (1u << depth) - 1;
  const int grid = wholeLevels(inside);
  int coarsest = inside;
  for (size_t side = 0; side < 4; ++side) {
    const bool upright = side == kLeft || side == kRight;
    if ((upright ? x : y) != (side == kRight || side == kBottom ? last : 0)) continue;
    const uint32_t along = upright ? y : x;
    const int here =
        sides[side][1] == kWholeSide || depth == 0 ? coarsestOf(sides[side]) : sides[side][along > last / 2];
    coarsest = std::min(coarsest, here);
    if (node_level + depth < grid || grid - wholeLevels(here) != 1) continue;
    auto around = [&](int next) {
      const auto& levels = sides[static_cast<size_t>(next)];
      const int there = levels[1] == kWholeSide ? levels[0] : levels[side == kRight || side == kBottom];
      if (grid - wholeLevels(there) <= 1) coarsest = std::min(coarsest, there);
    };
    if (along < 2) around(upright ? kTop : kLeft);
    if (last - along < 2) around(upright ? kBottom : kRight);
  }
  return coarsest;
}

inline constexpr size_t kMostParts = 512;  // divided for a bound

// parts: of any order, each with its bound `px`; scratch afterwards. divide(part, add): false: it cannot be divided;
// else calls add(child) for those of its children that count. A child's bound may be the larger one: its parent's holds
// for it, too. What is found after kMostParts is an upper bound all the same.
template <class Part, class Divide>
double searchBound(std::vector<Part>& parts, Divide&& divide) {
  auto less = [](const Part& a, const Part& b) { return a.px < b.px; };
  std::make_heap(parts.begin(), parts.end(), less);
  for (size_t steps = 0; !parts.empty(); ++steps) {
    if (steps == kMostParts) return parts.front().px;
    std::pop_heap(parts.begin(), parts.end(), less);
    const Part top = parts.back();
    parts.pop_back();
    auto add = [&](Part child) {
      child.px = std::min(child.px, top.px);
      parts.push_back(child);
      std::push_heap(parts.begin(), parts.end(), less);
    };
    if (!divide(top, add)) return top.px;
  }
  return 0;
}

}  // namespace relievo
