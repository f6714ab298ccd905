// height_steps.h - heights that differ by whole steps from what coarser grids show (src/artwork/relief_lattice.h):
// where that is within half a step of a height, a package needs next to nothing for it. Each comes to lie within half a
// step of what it was, or within one next to the ends of the 16 bits. Pure; the same for any number of workers.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/bake/bake_context.h"

namespace relievo {

// heights: as SampleLayout has them. step: of the finest grid's, in their unit, 1 to 16384; coarser grids' are as large
// or smaller. Those of a side depend on the side's alone, so that patches agree about them. Nothing: interrupted.
std::optional<std::vector<uint16_t>> steppedHeights(const BakeContext& context, std::span<const uint16_t> heights,
                                                    int cells_log2, int step);

// How far stepped heights lie from what they were, in the heights' unit: the root mean square over the base's area,
// between samples, too. That is how far the surface moves where it is as steep as the base; it moves less where it is
// steeper. 0 if interrupted.
double rmsOfChange(const BakeContext& context, std::span<const uint16_t> before, std::span<const uint16_t> after,
                   int cells_log2);

}  // namespace relievo
