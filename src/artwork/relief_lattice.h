// relief_lattice.h - how a square grid of heights follows from a coarser one where nothing finer is known. A grid of n
// cells a side becomes one of 2 n: a new sample between two on a line is their mean; one in the middle of a cell is the
// mean of the cell's corners (0,0) and (1,1), along which cells are cut into triangles. So the finer grid's triangles
// are the coarser one's, but for rounding. The rule looks at nothing beside the line or the cell: patches and pages
// that share a line agree about it, whichever way it runs.
#pragma once

#include <cstdint>

namespace relievo {

inline constexpr int midHeight(int a, int b) { return (a + b + 1) >> 1; }

}  // namespace relievo
