// height_fit.h - heights at the vertices of a grid, chosen so that the triangles between them lie closest to more
// heights than there are vertices (weighted least squares), not through those at the vertices; each within the range of
// the heights around it. Two steps, so that patches can share a side: along the side alone first, then inside with the
// border as it is. Pure; the same input gives the same bits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace relievo {

// Heights at evenly spaced places of a line or a grid, weights 0 .. 255; those of weight 0 hardly count.
struct HeightData {
  std::span<const float> heights;
  std::span<const uint8_t> weights;
};

// nodes: n + 1 values at every r-th of the n r + 1 data; in: those that count where no data do; out: the fit. Fixed
// ends are not changed.
enum class Ends { kFree, kFixed };
void fitLine(const HeightData& data, Ends ends, std::span<float> nodes);

// nodes: (n + 1)^2, rows of v; data: (n r + 1)^2 alike. Cells' triangles are cut along (0,0)-(1,1). The border's nodes
// are not changed.
void fitGrid(const HeightData& data, size_t data_row, std::span<float> nodes, size_t row);

}  // namespace relievo
