// triangle_pairs.h - pairs the triangles of a surface so that as few as possible stay alone: a largest matching of the
// graph whose vertices are triangles and whose edges are shared sides. Source: Edmonds 1965, "Paths, trees, and
// flowers". A closed surface always has a matching of all triangles (Petersen 1891).
// Pure; the same input gives the same result.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace relievo {

// neighbours: for each triangle, the ones that it may be paired with; kNoIndex for none. may_stay_alone: for each
// triangle, it needs no partner, as one at a border. mate: for each triangle its partner, or kNoIndex; symmetric. Pairs
// are added, and exchanged where that pairs more triangles; no triangle that has a partner loses it for good unless it
// may stay alone.
void pairMoreTriangles(std::span<const std::array<uint32_t, 3>> neighbours, std::span<const uint8_t> may_stay_alone,
                       std::vector<uint32_t>& mate);

}  // namespace relievo
