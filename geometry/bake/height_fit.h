// height_fit.h - weighted least squares for a height field: heights at the vertices of a grid such that the triangles
// between them lie closest to denser data. Each height stays within the range of the data in its own cells.
// A shared side is fitted alone first (fitLine), then each interior with its border fixed (fitGrid), so that patches
// agree on their sides. Pure; the same input gives the same bits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace relievo {

// Heights at evenly spaced points of a line or a grid, with weights 0 to 255. Data of weight 0 hardly count.
struct HeightData {
  std::span<const float> heights;
  std::span<const uint8_t> weights;
};

// nodes: n + 1 heights, at every r-th of the n r + 1 data. On entry they hold the values to fall back to where data
// have no weight, on return the fit. Fixed ends do not change.
enum class Ends { kFree, kFixed };
void fitLine(const HeightData& data, Ends ends, std::span<float> nodes);

// nodes: (n + 1)^2 heights, rows of v; data: (n r + 1)^2. Cells are cut into triangles along (0,0)-(1,1). Nodes on the
// border do not change.
void fitGrid(const HeightData& data, size_t data_row, std::span<float> nodes, size_t row);

}  // namespace relievo
