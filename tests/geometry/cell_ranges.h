// cell_ranges.h - of each cell of a square grid: how far what lies in it, its border and 0 included, is apart
// (Deviation::between_mm).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

namespace relievo::test {

class CellRanges {
 public:
  // cells a side, each of step finest cells a side.
  CellRanges(int64_t cells, int64_t step)
      : cells_(cells), step_(step), ranges_(static_cast<size_t>(cells * cells), {0, 0}) {}
  // At finest sample (x, y) from the grid's corner.
  void note(int64_t x, int64_t y, double along) {
    for (int64_t cy = std::max<int64_t>(0, y - 1) / step_; cy <= std::min(cells_ - 1, y / step_); ++cy)
      for (int64_t cx = std::max<int64_t>(0, x - 1) / step_; cx <= std::min(cells_ - 1, x / step_); ++cx) {
        auto& [low, high] = ranges_[static_cast<size_t>(cy * cells_ + cx)];
        low = std::min(low, along), high = std::max(high, along);
      }
  }
  // Of size x size cells from (x, y) on.
  double largest(int64_t x, int64_t y, int64_t size) const {
    double most = 0;
    for (int64_t cy = y; cy < y + size; ++cy)
      for (int64_t cx = x; cx < x + size; ++cx) {
        const auto& [low, high] = ranges_[static_cast<size_t>(cy * cells_ + cx)];
        most = std::max(most, high - low);
      }
    return most;
  }

 private:
  int64_t cells_, step_;
  std::vector<std::array<double, 2>> ranges_;
};

}  // namespace relievo::test
