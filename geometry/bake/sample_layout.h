// sample_layout.h - where a bake's samples lie in one array: what patches share is kept once.
// Shape: m is the number of inner samples of a side, 2^cells_log2 - 1; n = m + 1 cells. Pure; the base mesh is sound
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

// Samples are kept once each: corners; then the inner samples of each side, from the corner with the smaller index to
// the other; then those inside each patch, by rows.
struct SampleLayout {
  std::vector<std::array<uint32_t, 2>> sides;        // their corners, the smaller index first
  std::vector<std::array<uint32_t, 4>> patch_sides;  // by Side
  std::vector<uint32_t> side_patch;                  // the first patch of each side
  size_t corners = 0, patches = 0;

  explicit SampleLayout(const BaseMesh& base);
  size_t sideFirst(size_t side, size_t m) const { return corners + side * m; }
  size_t insideFirst(size_t patch, size_t m) const { return corners + sides.size() * m + patch * m * m; }
  size_t count(size_t m) const { return corners + sides.size() * m + patches * m * m; }

  // Of samples with n cells a side those that are also there with fewer.
  template <class T>
  std::vector<T> everyOther(std::span<const T> fine, size_t n, size_t coarse_n) const {
    const size_t m = n - 1, coarse_m = coarse_n - 1, step = n / coarse_n;
    std::vector<T> out(count(coarse_m));
    std::copy_n(fine.begin(), corners, out.begin());
    for (size_t side = 0; side < sides.size(); ++side)
      for (size_t i = 1; i < coarse_n; ++i)
        out[sideFirst(side, coarse_m) + i - 1] = fine[sideFirst(side, m) + i * step - 1];
    for (size_t patch = 0; patch < patches; ++patch)
      for (size_t y = 1; y < coarse_n; ++y)
        for (size_t x = 1; x < coarse_n; ++x)
          out[insideFirst(patch, coarse_m) + (y - 1) * coarse_m + x - 1] =
              fine[insideFirst(patch, m) + (y * step - 1) * m + x * step - 1];
    return out;
  }

  // A side with its ends, m + 2 samples.
  template <class T>
  void gatherSide(size_t side, size_t m, std::span<const T> samples, std::span<T> out) const {
    out[0] = samples[sides[side][0]];
    std::copy_n(samples.begin() + static_cast<ptrdiff_t>(sideFirst(side, m)), m, out.begin() + 1);
    out[m + 1] = samples[sides[side][1]];
  }
  // It in its place on the border of a patch's grid of n cells a side.
  template <class T>
  void placeSide(const BaseMesh& base, uint32_t patch, size_t side, size_t n, std::span<const T> line,
                 std::span<T> grid) const {
    const auto [a, b] = kSideCorners[side];
    const size_t first = side == kRight    ? n
                         : side == kBottom ? n * (n + 1)
                                           : 0,
                 step = side == kLeft || side == kRight ? n + 1 : 1;
    const bool forward = base.patches[patch][static_cast<size_t>(a)] < base.patches[patch][static_cast<size_t>(b)];
    for (size_t i = 0; i <= n; ++i) grid[first + i * step] = line[forward ? i : n - i];
  }

  // A patch's whole grid of (m + 2)^2, rows of v from 0.
  template <class T>
  void gather(const BaseMesh& base, uint32_t patch, size_t m, std::span<const T> samples, std::span<T> out) const {
    const size_t n = m + 1, row = m + 2;
    std::vector<T> line(row);
    for (size_t s = 0; s < 4; ++s) {
      gatherSide<T>(patch_sides[patch][s], m, samples, line);
      placeSide<T>(base, patch, s, n, line, out);
    }
    const T* in = samples.data() + insideFirst(patch, m);
    for (size_t y = 1; y < n; ++y) std::copy_n(in + (y - 1) * m, m, out.data() + y * row + 1);
  }
};

}  // namespace relievo
