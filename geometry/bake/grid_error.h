// grid_error.h - the distance of coarser grids over a patch from its finest grid, at the same (u, v). These are the
// errors from which the level of detail is chosen. Units: those of the grid.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/between_samples.h"
#include "src/artwork/deviation.h"

namespace relievo {

// The vertices of a grid of 2^cells_log2 cells a side, rows of v from 0, one array for each coordinate.
struct SurfaceGrid {
  int cells_log2 = 0;
  std::array<std::vector<double>, 3> axes;
  explicit SurfaceGrid(int log2 = 0) : cells_log2(log2) {
    for (auto& axis : axes) axis.resize(row() * row());
  }
  size_t row() const { return (size_t{1} << cells_log2) + 1; }
};

// A grid's errors are kept for blocks of 8 x 8 cells: this many blocks a side. Grids of at most 8 cells a side are one
// block.
constexpr int errorBlocksPerSide(int cells_log2) { return cells_log2 > 3 ? 1 << (cells_log2 - 3) : 1; }

// The errors of one grid, by blocks.
struct GridErrors {
  std::vector<float> mm;               // upper bounds of the distance
  std::vector<DeviationShape> shapes;  // the direction of the distance, src/artwork/deviation.h
};

// The base's normals over a patch: those of its corners, not zero, at (u, v) = (0,0), (1,0), (0,1), (1,1), and how they
// are interpolated (BaseMesh::cut).
struct PatchNormals {
  std::array<glm::dvec3, 4> corners;
  bool cut = false;
};

// Memory that is reused from patch to patch; its content does not matter.
struct GridErrorScratch {
  std::vector<SurfaceGrid> grids;              // by cells_log2
  std::array<std::vector<double>, 3> normals;  // of length 1, or zero where the corners' normals cancel out
  struct Rows {
    // x, y, z of the deviation and its component along the normal: in the current row of vertices, and its extremes
    // over a row of cells.
    std::array<std::vector<double>, 4> now, high, low;
    std::vector<double> squared_now, aside_now, squared, aside;  // the latter two: over a row of blocks
  };
  Rows rows;
};

// The errors of all grids of a patch, indexed by cells_log2 from 0 to finest.cells_log2 (which has errors of 0). Grid k
// consists of every 2^(finest.cells_log2 - k)-th vertex, its cells cut along (0,0)-(1,1). A block's errors are at least
// those of the finer grids' blocks inside it.
std::vector<GridErrors> gridErrors(const SurfaceGrid& finest, const PatchNormals& normals, GridErrorScratch& scratch);

// The same of all grids up to between.finest_log2, found on `grid`, which is one of those that have all samples, in a
// fraction of the time. Errors exceed those that gridErrors() finds on the finest grid by at most twice
// between.mm(grid.cells_log2); shapes are wider by that and by between.normalChange(grid.cells_log2).
std::vector<GridErrors> gridErrors(const SurfaceGrid& grid, const BetweenSamples& between, const PatchNormals& normals,
                                   GridErrorScratch& scratch);

// Of the same grids' blocks, which have errors of at most `tolerance`: within[cells_log2][block] is 1. In a fraction of
// gridErrors()'s time. Grids of one cell are left out.
void blocksWithin(const SurfaceGrid& finest, double tolerance, GridErrorScratch& scratch,
                  std::vector<std::vector<uint8_t>>& within);

}  // namespace relievo
