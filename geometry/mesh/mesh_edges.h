// mesh_edges.h - the edges of a triangle soup: which half-edges lie between the same two vertices. Half-edge 3 t + k
// runs from corner k of triangle t to its next corner. Internal to mesh_read.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/mesh/triangle_blocks.h"
#include "src/base/parallel_for.h"

namespace relievo {

inline constexpr uint32_t kNoHalfEdge = ~uint32_t{0};
inline constexpr size_t kMaxTriangles = 0x55555554;  // half-edges have 32-bit names
using Triangles = std::vector<std::array<uint32_t, 3>>;

inline uint32_t nextInTriangle(uint32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
inline uint32_t previousInTriangle(uint32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }
inline uint32_t fromVertex(const Triangles& t, uint32_t h) { return t[h / 3][h % 3]; }
inline uint32_t toVertex(const Triangles& t, uint32_t h) { return fromVertex(t, nextInTriangle(h)); }

// Asked in loops over millions, every quarter of a million steps: some milliseconds.
inline bool stopAt(size_t step, const std::atomic<bool>* stop) {
  return (step & 0x3FFFF) == 0 && stop && stop->load(std::memory_order_relaxed);
}

// visit(part, half_edges) once an edge, whichever way they run, ascending; the edges by their lower vertex, then by
// their higher one: each part has a range of lower vertices, and parts are visited at the same time. Half-edges are
// dealt out to their lower vertices and sorted there: linear, for vertices of usual valence. Memory: 4 bytes a vertex
// and 8 a half-edge, of which an eighth is held at once in large meshes (at least 4 M of them: 32 MB). Ends early, soon
// after *stop is set.
template <class Visit>
void forEachEdgeInParts(const Triangles& triangles, size_t vertices, size_t parts, Visit visit,
                        const std::atomic<bool>* stop = nullptr) {
  std::vector<uint32_t> end(vertices + 1, 0);  // of each vertex's half-edges, counted over all vertices
  auto stopped = [&] { return stop && stop->load(std::memory_order_relaxed); };
  const TriangleBlocks blocks(triangles, static_cast<int>(parts));
  auto inParallel = [&](auto&& job) { return parallelFor(parts, static_cast<int>(parts), nullptr, job) && !stopped(); };
  const bool counted = inParallel([&](size_t part) {
    const size_t first = vertices * part / parts, count = vertices * (part + 1) / parts - first;
    blocks.forEach(first, first + count, stopped, [&](size_t i) {
      const auto& t = triangles[i];
      for (int k = 0; k < 3; ++k)
        if (const uint32_t low = std::min(t[k], t[k == 2 ? 0 : k + 1]); low - first < count) ++end[low];
    });
  });
  if (!counted) return;
  uint32_t sum = 0;
  for (uint32_t& e : end) e = sum += e;
  auto begin = [&](size_t v) { return v == 0 ? 0 : end[v - 1]; };
  const size_t share = std::max<size_t>(size_t{4} << 20, triangles.size() * 3 / 8) / parts;
  inParallel([&](size_t part) {
    auto bound = [&](size_t k) {  // as many half-edges a part
      return k == parts ? vertices
                        : static_cast<size_t>(
                              std::lower_bound(end.begin(), end.end(), triangles.size() * 3 * k / parts) - end.begin());
    };
    const size_t part_end = bound(part + 1);
    std::vector<uint64_t> dealt;  // higher vertex, half-edge
    dealt.reserve(std::min(share, triangles.size() * 3));
    std::vector<uint32_t> next, edge;
    for (size_t first = bound(part); first < part_end && !stopped();) {
      size_t last = first;
      const size_t base = begin(first);
      while (last < part_end && (last == first || end[last] - base <= share)) ++last;
      dealt.resize(begin(last) - base);
      next.resize(last - first);
      for (size_t v = first; v < last; ++v) next[v - first] = static_cast<uint32_t>(begin(v) - base);
      blocks.forEach(first, last, stopped, [&](size_t i) {
        const auto& t = triangles[i];
        for (uint32_t k = 0; k < 3; ++k) {
          uint32_t a = t[k], b = t[k == 2 ? 0 : k + 1], low = std::min(a, b);
          if (low >= first && low < last)
            dealt[next[low - first]++] =
                static_cast<uint64_t>(std::max(a, b)) << 32 | (3 * static_cast<uint32_t>(i) + k);
        }
      });
      if (stopped()) return;
      for (size_t v = first; v < last; ++v) {
        if (stopAt(v, stop)) return;
        auto from = dealt.begin() + static_cast<std::ptrdiff_t>(begin(v) - base),
             to = dealt.begin() + static_cast<std::ptrdiff_t>(end[v] - base);
        if (to - from <= 24)
          for (auto i = from; i != to; ++i)
            for (auto j = i; j != from && *j < j[-1]; --j) std::swap(*j, j[-1]);
        else std::sort(from, to);
        while (from != to) {
          auto same = from;
          edge.clear();
          for (; same != to && *same >> 32 == *from >> 32; ++same) edge.push_back(static_cast<uint32_t>(*same));
          visit(part, std::span<const uint32_t>(edge));
          from = same;
        }
      }
      first = last;
    }
  });
}

// visit(half_edges) on this thread alone.
template <class Visit>
void forEachEdge(const Triangles& triangles, size_t vertices, Visit visit, const std::atomic<bool>* stop = nullptr) {
  forEachEdgeInParts(
      triangles, vertices, 1, [&](size_t, std::span<const uint32_t> edge) { visit(edge); }, stop);
}

}  // namespace relievo
