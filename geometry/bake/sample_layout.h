// sample_layout.h - the order of a bake's samples in one array, where samples that patches share are kept once.
// Shape: n = 2^cells_log2 cells a side, of which m = n - 1 samples are inner ones. Pure; the base mesh must be valid
// (baseMeshProblem).
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

// First the corners; then the inner samples of each side, from the corner with the smaller index; then those inside
// each patch, by rows.
struct SampleLayout {
  std::vector<std::array<uint32_t, 2>> sides;        // their corners, the smaller index first
  std::vector<std::array<uint32_t, 4>> patch_sides;  // indexed by Side
  std::vector<uint32_t> side_patch;                  // the first patch of each side
  size_t corners = 0, patches = 0;

  explicit SampleLayout(const BaseMesh& base);
  size_t sideBegin(size_t side, size_t m) const { return corners + side * m; }
  size_t interiorBegin(size_t patch, size_t m) const { return corners + sides.size() * m + patch * m * m; }
  size_t count(size_t m) const { return corners + sides.size() * m + patches * m * m; }

  // The samples of a grid of n cells a side that a grid of coarse_n cells has, too.
  template <class T>
  std::vector<T> subsampled(std::span<const T> fine, size_t n, size_t coarse_n) const {
    const size_t m = n - 1, coarse_m = coarse_n - 1, step = n / coarse_n;
    std::vector<T> out(count(coarse_m));
    std::copy_n(fine.begin(), corners, out.begin());
    for (size_t side = 0; side < sides.size(); ++side)
      for (size_t i = 1; i < coarse_n; ++i)
        out[sideBegin(side, coarse_m) + i - 1] = fine[sideBegin(side, m) + i * step - 1];
    for (size_t patch = 0; patch < patches; ++patch)
      for (size_t y = 1; y < coarse_n; ++y)
        for (size_t x = 1; x < coarse_n; ++x)
          out[interiorBegin(patch, coarse_m) + (y - 1) * coarse_m + x - 1] =
              fine[interiorBegin(patch, m) + (y * step - 1) * m + x * step - 1];
    return out;
  }

  // The samples of a side with its ends, m + 2.
  template <class T>
  void gatherSide(size_t side, size_t m, std::span<const T> samples, std::span<T> out) const {
    out[0] = samples[sides[side][0]];
    std::copy_n(samples.begin() + static_cast<ptrdiff_t>(sideBegin(side, m)), m, out.begin() + 1);
    out[m + 1] = samples[sides[side][1]];
  }
  // Writes the samples of a side to the border of a patch's grid of n cells a side.
  template <class T>
  void setSide(const BaseMesh& base, uint32_t patch, size_t side, size_t n, std::span<const T> line,
               std::span<T> grid) const {
    const auto [a, b] = kSideCorners[side];
    const size_t first = side == kRight    ? n
                         : side == kBottom ? n * (n + 1)
                                           : 0,
                 step = side == kLeft || side == kRight ? n + 1 : 1;
    const bool forward = base.patches[patch][static_cast<size_t>(a)] < base.patches[patch][static_cast<size_t>(b)];
    for (size_t i = 0; i <= n; ++i) grid[first + i * step] = line[forward ? i : n - i];
  }

  // The samples of a patch, (m + 2)^2, rows of v from 0.
  template <class T>
  void gather(const BaseMesh& base, uint32_t patch, size_t m, std::span<const T> samples, std::span<T> out) const {
    const size_t n = m + 1, row = m + 2;
    std::vector<T> line(row);
    for (size_t s = 0; s < 4; ++s) {
      gatherSide<T>(patch_sides[patch][s], m, samples, line);
      setSide<T>(base, patch, s, n, line, out);
    }
    const T* in = samples.data() + interiorBegin(patch, m);
    for (size_t y = 1; y < n; ++y) std::copy_n(in + (y - 1) * m, m, out.data() + y * row + 1);
  }
};

}  // namespace relievo
