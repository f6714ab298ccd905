// Snapping: the grid still tiles its square, no triangle turned over, and the two sides of an edge name the same
// vertices.
#include <gtest/gtest.h>

#include <set>

#include "geometry/lod/snap.h"

namespace relievo {
namespace snap_test {

using Sides = std::array<uint8_t, 2>;

std::vector<Sides> allSides(int n) {
  std::vector<Sides> out;
  for (int a = 0; a <= n; ++a) out.push_back({static_cast<uint8_t>(a), PatchInstance::kWholeEdge});
  for (int a = 0; a < n; ++a)
    for (int b = 0; b < n; ++b) out.push_back({static_cast<uint8_t>(a), static_cast<uint8_t>(b)});
  return out;
}

struct Tiling {
  int64_t area2 = 0;  // twice the signed area
  uint64_t triangles = 0, flipped = 0;
};
// The cells that snapping can change: those along the border.
template <class Snap>
void addBorderCells(int n, const Snap& snap, Tiling& t) {
  int last = (1 << n) - 1;
  auto cross = [](std::array<int, 2> a, std::array<int, 2> b, std::array<int, 2> c) {
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  };
  for (int j = 0; j <= last; ++j)
    for (int i = 0; i <= last; i += (j == 0 || j == last || i == last || last == 0) ? 1 : last) {
      auto v00 = snap(i, j), v10 = snap(i + 1, j), v01 = snap(i, j + 1), v11 = snap(i + 1, j + 1);
      for (int area : {cross(v00, v10, v11), cross(v00, v11, v01)}) {
        t.area2 += area;
        t.flipped += area < 0;
        ++t.triangles;
      }
    }
}

TEST(Snap, NoTriangleFlipsAndTheSquareIsTiledForAllCombinationsOfSides) {
  uint64_t combinations = 0;
  Tiling all;
  for (int n = 1; n <= kMaxGridLevel; ++n) {
    int size = 1 << n;
    int64_t border_area2 = 2 * (int64_t{size} * size - (size > 2 ? int64_t{size - 2} * (size - 2) : 0));
    std::vector<Sides> sides = allSides(n);
    std::vector<std::array<int, 33>> snapped;
    for (const Sides& s : sides) {
      auto& row = snapped.emplace_back();
      for (int i = 0; i <= size; ++i)
        row[static_cast<size_t>(i)] =
            static_cast<int>(snapOnSide(static_cast<uint32_t>(i), static_cast<uint32_t>(n), s));
    }
    for (const auto& left : snapped)
      for (const auto& right : snapped)
        for (const auto& top : snapped)
          for (const auto& bottom : snapped) {
            Tiling t;
            addBorderCells(
                n,
                [&](int i, int j) {
                  std::array<int, 2> v{i, j};
                  if (i == 0) v[1] = left[static_cast<size_t>(j)];
                  if (i == size) v[1] = right[static_cast<size_t>(j)];
                  if (j == 0) v[0] = top[static_cast<size_t>(i)];
                  if (j == size) v[0] = bottom[static_cast<size_t>(i)];
                  return v;
                },
                t);
            ASSERT_EQ(t.flipped, 0u) << "n " << n;
            ASSERT_EQ(t.area2, border_area2) << "n " << n;
            all.triangles += t.triangles;
            ++combinations;
          }
  }
  std::printf("[ figures  ] %llu combinations of sides, %llu triangles\n",
              static_cast<unsigned long long>(combinations), static_cast<unsigned long long>(all.triangles));
}

// The same through snapVertex, all cells: fewer combinations.
TEST(Snap, SnapVertexKeepsInnerVerticesAndCorners) {
  for (int n = 1; n <= kMaxGridLevel; ++n)
    for (const Sides& s : allSides(n)) {
      PatchInstance p;
      p.grid_level = static_cast<uint8_t>(n);
      p.edges = {s, s, s, s};
      uint32_t last = 1u << n;
      for (uint32_t j = 0; j <= last; ++j)
        for (uint32_t i = 0; i <= last; ++i) {
          auto v = snapVertex(i, j, p);
          bool inner = i > 0 && j > 0 && i < last && j < last, corner = (i == 0 || i == last) && (j == 0 || j == last);
          if (inner || corner) {
            ASSERT_EQ(v, (std::array<uint32_t, 2>{i, j}));
          }
          ASSERT_TRUE((i != 0 || v[0] == 0) && (i != last || v[0] == last) && (j != 0 || v[1] == 0) &&
                      (j != last || v[1] == last));
        }
    }
}

// The rule itself, as it reads: every vertex goes to the nearest of the edge, of two as near to the one nearer to the
// edge's middle. The middle of an edge of one segment, for which both are alike, goes to the first end.
TEST(Snap, ToTheNearestAndOfTwoToTheOneNearerToTheMiddle) {
  for (uint32_t n = 1; n <= kMaxGridLevel; ++n)
    for (uint32_t m = 0; m <= n; ++m) {
      const int size = 1 << n, step = 1 << (n - m);
      for (int i = 0; i <= size; ++i) {
        int best = 0;
        for (int v = step; v <= size; v += step) {
          const int nearer = std::abs(v - i) - std::abs(best - i),
                    to_middle = std::abs(2 * v - size) - std::abs(2 * best - size);
          if (nearer < 0 || (nearer == 0 && to_middle < 0)) best = v;
        }
        ASSERT_EQ(snapToEdge(static_cast<uint32_t>(i), n, m), static_cast<uint32_t>(best))
            << "vertex " << i << " of 2^" << n << " cells, 2^" << m << " segments";
      }
    }
}

// Negative control: rounding ties towards the far end (one formula for both halves, as one would first write) flips
// triangles or, at least, is not what this checks for: a snap that swaps two vertices must be seen.
TEST(Snap, NegativeControlSwappedVerticesAreSeen) {
  Tiling t;
  addBorderCells(
      3,
      [](int i, int j) {
        std::array<int, 2> v{i, j};
        if (j == 0 && i == 3) v[0] = 4;
        if (j == 0 && i == 4) v[0] = 3;
        return v;
      },
      t);
  EXPECT_GT(t.flipped, 0u);
}

TEST(Snap, BothSidesOfAnEdgeHaveTheSameVertices) {
  // Whole edge against whole edge, grids of any level on both sides.
  auto whole = [](uint32_t n, uint32_t m) {
    std::set<uint32_t> out;
    for (uint32_t i = 0; i <= 1u << n; ++i) out.insert(snapToEdge(i, n, m) << (kMaxGridLevel - n));
    return out;
  };
  for (uint32_t m = 0; m <= kMaxGridLevel; ++m) {
    std::set<uint32_t> expected;
    for (uint32_t i = 0; i <= 1u << m; ++i) expected.insert(i << (kMaxGridLevel - m));
    for (uint32_t n = std::max(1u, m); n <= kMaxGridLevel; ++n)
      EXPECT_EQ(whole(n, m), expected) << "n " << n << " m " << m;
  }
  // Two half edges against two finer whole edges; in steps of the coarser side's finest grid, twice as fine.
  for (uint32_t n = 1; n <= kMaxGridLevel; ++n)
    for (uint32_t a = 0; a < n; ++a)
      for (uint32_t b = 0; b < n; ++b)
        for (uint32_t na = std::max(1u, a); na <= kMaxGridLevel; ++na)
          for (uint32_t nb = std::max(1u, b); nb <= kMaxGridLevel; ++nb) {
            std::set<uint32_t> coarse, fine;
            for (uint32_t i = 0; i <= 1u << n; ++i) coarse.insert(snapToHalves(i, n, a, b) << (kMaxGridLevel + 1 - n));
            for (uint32_t v : whole(na, a)) fine.insert(v);
            for (uint32_t v : whole(nb, b)) fine.insert((1u << kMaxGridLevel) + v);
            ASSERT_EQ(coarse, fine) << n << " " << a << " " << b << " " << na << " " << nb;
          }
  // Negative control: grids that do not snap differ as soon as their levels do.
  EXPECT_NE(whole(3, 3), whole(4, 4));
}

}  // namespace snap_test
}  // namespace relievo
