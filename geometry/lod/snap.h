// snap.h - the CPU reference of the vertex shader's snapping (shaders/patch.vert).
#pragma once

#include <array>
#include <cstdint>

#include "geometry/lod/lod.h"

namespace relievo {

// Grid vertex i of 0..2^n on an edge of 2^m segments, m <= n: the edge vertex that it moves to, in grid steps.
// Dyken, Reimers, Seland 2009: to the nearest; ties go towards the edge's middle on both of its halves, so that no
// triangle flips.
inline uint32_t snapToEdge(uint32_t i, uint32_t n, uint32_t m) {
  if (m >= n) return i;
  uint32_t d = n - m, half = 1u << (d - 1);
  return i < (1u << n) / 2 ? ((i + half) >> d) << d : ((i + half - 1) >> d) << d;
}
// The same for a side of two half edges of 2^a and 2^b segments (a, b <= n - 1): the middle vertex stays.
inline uint32_t snapToHalves(uint32_t i, uint32_t n, uint32_t a, uint32_t b) {
  uint32_t middle = (1u << n) / 2;
  return i < middle ? snapToEdge(i, n - 1, a) : middle + snapToEdge(i - middle, n - 1, b);
}
inline uint32_t snapOnSide(uint32_t i, uint32_t n, const std::array<uint8_t, 2>& side) {
  return side[1] == PatchInstance::kWholeEdge ? snapToEdge(i, n, side[0]) : snapToHalves(i, n, side[0], side[1]);
}
// With geomorph (morph.h), instead of the nearest: the edge vertex next to i on the side of the edge's nearer end.
inline uint32_t snapToNearerEnd(uint32_t i, uint32_t n, uint32_t m) {
  const uint32_t d = n - m;
  return (i > (1u << n) / 2 ? (i + (1u << d) - 1) >> d : i >> d) << d;
}
// Vertex (i, j) of an instance's grid after snapping. Inner vertices and corners stay.
inline std::array<uint32_t, 2> snapVertex(uint32_t i, uint32_t j, const PatchInstance& p) {
  uint32_t last = 1u << p.grid_level;
  uint32_t x = i, y = j;
  if (i == 0) y = snapOnSide(j, p.grid_level, p.edges[kLeft]);
  if (i == last) y = snapOnSide(j, p.grid_level, p.edges[kRight]);
  if (j == 0) x = snapOnSide(i, p.grid_level, p.edges[kTop]);
  if (j == last) x = snapOnSide(i, p.grid_level, p.edges[kBottom]);
  return {x, y};
}

}  // namespace relievo
