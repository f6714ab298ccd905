// between_samples.h - how far the finest drawn surface of a patch may lie, at the same (u, v), from its grids that have
// all of its samples. What is shown by a coarse grid within a tolerance need not be computed on the finest.
//
// Between samples heights are linear on the cells' triangles, but for rounding, and positions and normals of the base
// are bilinear, or linear on halves (src/artwork/base_mesh.h). So the surface differs from a cell's triangles by the
// second differences of these, and of the product of heights and normals: upper bounds for the price of one look at the
// samples. Units: mm. Pure. Made by BakedHeights::betweenSamples().
#pragma once

#include <algorithm>
#include <cmath>

namespace relievo {

struct BetweenSamples {
  int cells_log2 = 0, finest_log2 = 0;  // of the samples, and of the finest drawn grid
  double twist_mm = 0;       // of positions, and of normals times the largest height: were the patch one cell
  double product_mm = 0;     // of heights times normals, both of which change: over a cell of the samples
  double rounding_mm = 0;    // what a step of 16 bits moves; 0 where all heights are the same
  double normal_change = 0;  // radians or more, between the normals of two points of the patch; may be infinite

  // An upper bound for the grid of 2^log2 cells a side, cells_log2 <= log2 <= finest_log2. Falls with log2.
  double mm(int log2) const {
    if (log2 >= finest_log2) return 0;
    // The rules that heights between samples follow round once to the nearest step, or up by half a step whenever cells
    // are halved.
    const double steps = std::max(1.0, 0.5 * (finest_log2 - log2));
    return (std::ldexp(twist_mm, -2 * log2) + std::ldexp(product_mm, -2 * (log2 - cells_log2)) + steps * rounding_mm) *
           (1 + 1e-6);
  }
  // Between the normals of two points of one of that grid's cells.
  double normalChange(int log2) const { return std::ldexp(normal_change, -log2); }
  // The coarsest of these grids with mm() of at most tolerance_mm.
  int coarsestWithin(double tolerance_mm) const {
    int log2 = std::min(cells_log2, finest_log2);
    while (log2 < finest_log2 && mm(log2) > tolerance_mm) ++log2;
    return log2;
  }
};

}  // namespace relievo
