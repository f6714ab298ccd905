// morph.h - where a grid's vertices lie while their level comes or goes (the CPU reference of shaders/patch.vert,
// MORPH). A vertex that is not one of the next coarser level is on the way to its own place. Inside the grid it comes
// from the middle of its two neighbours of that level, along its row, its column or the diagonal that cells are cut by:
// so at weight 0 the surface is that of the coarser grid, triangle by triangle, and at weight w it is (1 - w) times
// that one plus w times the finer one. A grid beside a segment may be finer than it. If the vertices that it has too
// many went elsewhere when a level of the segment begins, as to the nearest (snap.h), the triangles beside the segment
// would be cut another way at once. So they snap to the segment's vertex next to them on the side of its nearer end,
// and a new one slides out of that neighbour: those that follow it were there before it came. s of the way, the segment
// lies as s / (2 - s) of the way up would have it, or nearer to the finer one: s = 2 w / (1 + w) (slideOf() in
// desired_level.h). Only the segment's middle, which has no nearer end, comes from the middle of both. Segment, weight
// and ends are known to both nodes, and nothing asks which way a side runs.
#pragma once

#include <array>
#include <cstdint>

#include "geometry/lod/lod.h"
#include "geometry/lod/snap.h"

namespace relievo {

inline constexpr uint32_t kMorphOne = 256;  // weights count from 0 to it

// A grid vertex after snapping, in grid steps; below kMorphOne it is drawn between the middle of `from` and `to`, often
// one place, and `own`.
struct GridVertex {
  std::array<uint32_t, 2> own{}, from{}, to{};
  uint32_t weight = kMorphOne;
};

// On a side of a grid of level n, along it: vertex i of the segments levels[0] (and levels[1]: halves).
inline GridVertex vertexOnSide(uint32_t i, uint32_t n, const std::array<uint8_t, 2>& levels,
                               const std::array<uint8_t, 2>& morph, int axis) {
  const bool halves = levels[1] != PatchInstance::kWholeEdge;
  const uint32_t middle = halves ? (1u << n) / 2 : 0;
  const bool second = halves && i >= middle;
  const uint32_t start = second ? middle : 0, level = levels[second ? 1 : 0], cells = halves ? n - 1 : n;
  const uint32_t own = snapToNearerEnd(i - start, cells, level), step = 1u << (cells - level),
                 centre = (1u << cells) / 2;
  GridVertex v;
  const auto k = static_cast<size_t>(axis);
  v.own[k] = start + own;
  if (level > 0 && (own & step) != 0) {
    v.from[k] = own > centre ? v.own[k] + step : v.own[k] - step;
    v.to[k] = own < centre ? v.own[k] - step : v.own[k] + step;
    v.weight = morph[second ? 1 : 0] + 1u;
  }
  return v;
}
// Vertices inside stay: theirs is drawnVertex's business.
inline GridVertex vertexOnBorder(uint32_t i, uint32_t j, const PatchInstance& p) {
  const uint32_t last = 1u << p.grid_level;
  const bool corner = (i == 0 || i == last) && (j == 0 || j == last);
  auto side = [&](int which, uint32_t along, int axis) {
    GridVertex v = vertexOnSide(along, p.grid_level, p.edges[static_cast<size_t>(which)],
                                p.edge_morph[static_cast<size_t>(which)], axis);
    for (auto* place : {&v.own, &v.from, &v.to}) (*place)[static_cast<size_t>(1 - axis)] = axis == 0 ? j : i;
    return v;
  };
  if (!corner) {
    if (i == 0) return side(kLeft, j, 1);
    if (i == last) return side(kRight, j, 1);
    if (j == 0) return side(kTop, i, 0);
    if (j == last) return side(kBottom, i, 0);
  }
  return {{i, j}, {}, {}, kMorphOne};
}

// at(x, y): the surface at a place in grid steps; between(a, b, own, w): w of the way from the middle of a and b to
// own, 0 < w < 1.
template <class At, class Between>
auto drawnVertex(const PatchInstance& p, uint32_t i, uint32_t j, At&& at, Between&& between) {
  auto onGrid = [&](uint32_t x, uint32_t y) {
    const GridVertex v = vertexOnBorder(x, y, p);
    auto own = at(v.own[0], v.own[1]);
    if (v.weight == kMorphOne) return own;
    return between(at(v.from[0], v.from[1]), at(v.to[0], v.to[1]), own, static_cast<float>(v.weight) / kMorphOne);
  };
  const uint32_t last = 1u << p.grid_level, weight = p.morph + 1u, dx = i & 1, dy = j & 1;
  const bool inside = i > 0 && j > 0 && i < last && j < last;
  if (!inside || weight == kMorphOne || (dx | dy) == 0) return onGrid(i, j);
  return between(onGrid(i - dx, j - dy), onGrid(i + dx, j + dy), at(i, j), static_cast<float>(weight) / kMorphOne);
}

}  // namespace relievo
