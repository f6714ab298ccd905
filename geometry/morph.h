// morph.h - where a grid's vertices lie while their level comes or goes (the C++ twin of shaders/patch.vert, MORPH). A vertex that is not one of
// the next coarser level lies on the way from the middle of its two neighbours of that level to its own place: on a segment's side they are
// its neighbours along the segment, inside the grid those along its row, its column or the diagonal that cells are cut by. So at weight 0
// the surface is that of the coarser grid, triangle by triangle, and at weight w it is (1 - w) times that one plus w times the finer one.
// Sides: the weight is the segment's (PatchInstance::edge_morph), known to both nodes; its vertices and their neighbours are too, and the
// middle is 0.5 * (a + b), the same whichever side calls which of them a. Inside: neighbours on a side lie where the side is drawn.
#pragma once

#include <array>
#include <cstdint>

#include "geometry/planar_lod.h"
#include "geometry/snap.h"

namespace relievo {

inline constexpr uint32_t kMorphOne = 256;  // weights count from 0 to it

// A grid vertex after snapping, in grid steps; below kMorphOne it is drawn between own - reach and own + reach.
struct GridVertex {
  std::array<uint32_t, 2> own{}, reach{};
  uint32_t weight = kMorphOne;
};

// On a side of a grid of level n, along it: vertex i of the segments levels[0] (and levels[1]: halves).
inline GridVertex vertexOnSide(uint32_t i, uint32_t n, const std::array<uint8_t, 2>& levels, const std::array<uint8_t, 2>& morph, int axis) {
  const bool halves = levels[1] != PatchInstance::kWholeEdge;
  const uint32_t middle = halves ? (1u << n) / 2 : 0;
  const bool second = halves && i >= middle;
  const uint32_t start = second ? middle : 0, level = levels[second ? 1 : 0], cells = halves ? n - 1 : n;
  GridVertex v;
  v.own[static_cast<size_t>(axis)] = start + snapToEdge(i - start, cells, level);
  const uint32_t step = cells - level, along = (v.own[static_cast<size_t>(axis)] - start) >> step;
  if (level > 0 && (along & 1) != 0) {
    v.reach[static_cast<size_t>(axis)] = 1u << step;
    v.weight = morph[second ? 1 : 0] + 1u;
  }
  return v;
}
// Vertices inside stay: theirs is drawnVertex's business.
inline GridVertex vertexOnBorder(uint32_t i, uint32_t j, const PatchInstance& p) {
  const uint32_t last = 1u << p.grid_level;
  const bool corner = (i == 0 || i == last) && (j == 0 || j == last);
  auto side = [&](int which, uint32_t along, int axis) {
    GridVertex v = vertexOnSide(along, p.grid_level, p.edges[static_cast<size_t>(which)], p.edge_morph[static_cast<size_t>(which)], axis);
    v.own[static_cast<size_t>(1 - axis)] = axis == 0 ? j : i;
    return v;
  };
  if (!corner) {
    if (i == 0) return side(kLeft, j, 1);
    if (i == last) return side(kRight, j, 1);
    if (j == 0) return side(kTop, i, 0);
    if (j == last) return side(kBottom, i, 0);
  }
  return {{i, j}, {}, kMorphOne};
}

// at(x, y): the surface at a place in grid steps; between(a, b, own, w): w of the way from the middle of a and b to own, 0 < w < 1.
template <class At, class Between>
auto drawnVertex(const PatchInstance& p, uint32_t i, uint32_t j, At&& at, Between&& between) {
  auto onGrid = [&](uint32_t x, uint32_t y) {
    const GridVertex v = vertexOnBorder(x, y, p);
    auto own = at(v.own[0], v.own[1]);
    if (v.weight == kMorphOne) return own;
    return between(at(v.own[0] - v.reach[0], v.own[1] - v.reach[1]), at(v.own[0] + v.reach[0], v.own[1] + v.reach[1]), own,
                   static_cast<float>(v.weight) / kMorphOne);
  };
  const uint32_t last = 1u << p.grid_level, weight = p.morph + 1u, dx = i & 1, dy = j & 1;
  const bool inside = i > 0 && j > 0 && i < last && j < last;
  if (!inside || weight == kMorphOne || (dx | dy) == 0) return onGrid(i, j);
  return between(onGrid(i - dx, j - dy), onGrid(i + dx, j + dy), at(i, j), static_cast<float>(weight) / kMorphOne);
}

}  // namespace relievo
