// grid_error.h - how far coarser grids over a patch lie from its finest, at the same (u, v).
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/deviation.h"

namespace relievo {

// The vertices of a grid of 2^cells_log2 cells a side, rows of v from 0: x, y, z each in an array of its own.
struct SurfaceGrid {
  int cells_log2 = 0;
  std::array<std::vector<double>, 3> axes;
  explicit SurfaceGrid(int log2 = 0) : cells_log2(log2) {
    for (auto& axis : axes) axis.resize(row() * row());
  }
  size_t row() const { return (size_t{1} << cells_log2) + 1; }
};

// Blocks of 8 x 8 cells a side of a grid; coarser grids are one block.
constexpr int errorBlocksASide(int cells_log2) { return cells_log2 > 3 ? 1 << (cells_log2 - 3) : 1; }

// What is known of a grid, block by block.
struct GridErrors {
  std::vector<float> mm;               // upper bounds of distances
  std::vector<DeviationShape> shapes;  // which way they lie
};

// By cells_log2 from 0 to the finest's: for each block, what the triangles (cells cut along (0,0)-(1,1)) through every
// 2^n-th vertex leave out of those of the finest; never below those of finer grids' blocks inside it; 0 for the finest.
// corner_normals: of the base, not zero, at (u, v) = (0,0), (1,0), (0,1), (1,1). Scratch: of any content; kept by the
// caller so that one patch after the other needs no new memory.
struct GridErrorScratch {
  std::vector<SurfaceGrid> grids;              // by cells_log2
  std::array<std::vector<double>, 3> normals;  // of length 1, or zero where there is none
  struct Rows {
    std::array<std::vector<double>, 4> now, high,
        low;  // x, y, z of deviations and what lies along the normal: of a row; the extremes of a row of cells
    std::vector<double> squared_now, aside_now, squared, aside;  // the latter two of a row of blocks
  };
  Rows rows;
};
std::vector<GridErrors> gridErrors(const SurfaceGrid& finest, const std::array<glm::dvec3, 4>& corner_normals,
                                   GridErrorScratch& scratch);

}  // namespace relievo
