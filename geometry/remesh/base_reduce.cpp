#include "geometry/remesh/base_reduce.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

namespace relievo {

namespace {

// Half edge 3 t + k runs from corner k of triangle t to corner k + 1. outgoing: one half edge of each vertex; at a
// border the one without a twin, so that a counter-clockwise turn passes all triangles of the vertex.
struct Reducer {
  Surface& s;
  std::vector<uint32_t>& twin;
  std::vector<uint32_t> outgoing, mark;
  std::vector<uint8_t> locked;
  size_t live_triangles;
  const std::atomic<bool>* interrupted;
  uint32_t mark_id = 0;
  // No collapse may create an edge between two locked vertices, since a neighbouring part may create the same one.
  bool no_new_locked_edges = false;

  Reducer(Surface& surface, std::span<const uint32_t> locked_vertices, const std::atomic<bool>* stop)
      : s(surface),
        twin(surface.twin),
        outgoing(s.points.size(), kNoIndex),
        mark(s.points.size(), 0),
        locked(s.points.size(), 0),
        live_triangles(s.triangles.size()),
        interrupted(stop) {
    for (uint32_t v : locked_vertices) locked[v] = 1;
    for (uint32_t h = 0; h < twin.size(); ++h) {
      uint32_t& l = outgoing[from(h)];
      if (l == kNoIndex || twin[h] == kNoIndex) l = h;
    }
  }

  uint32_t from(uint32_t h) const { return s.triangles[h / 3][h % 3]; }
  uint32_t to(uint32_t h) const { return s.triangles[h / 3][(h + 1) % 3]; }
  bool border(uint32_t v) const { return twin[outgoing[v]] == kNoIndex; }

  // Calls fn for each triangle around v, until it answers false. Arguments: the half edge leaving v, its end vertex,
  // the triangle's third vertex, and whether there is a next triangle.
  template <class Fn>
  bool forEachAround(uint32_t v, Fn fn) const {
    const uint32_t first = outgoing[v];
    uint32_t h = first;
    do {
      const uint32_t t = h / 3, k = h - 3 * t, previous = k == 0 ? 2 : k - 1;
      const Triangle& corners = s.triangles[t];
      const uint32_t next = twin[3 * t + previous];
      if (!fn(h, corners[k == 2 ? 0 : k + 1], corners[previous], next != kNoIndex)) return false;
      h = next;
    } while (h != kNoIndex && h != first);
    return true;
  }
  uint32_t fanSize(uint32_t v) const {
    uint32_t n = 0;
    forEachAround(v, [&](uint32_t, uint32_t, uint32_t, bool) { return ++n, true; });
    return n;
  }

  // May `removed` move to `kept` over the edge of half edge h?
  bool canCollapse(uint32_t h, uint32_t removed, uint32_t kept, float max_length_squared, float min_turn_cosine) {
    const uint32_t g = twin[h];
    const bool edge_on_border = g == kNoIndex;
    const bool removed_on_border = border(removed);
    if (locked[removed] || (removed_on_border && !edge_on_border)) return false;
    // The cheap tests that fail most often come first.
    uint32_t removed_fan = 0;
    const glm::vec3 at = s.points[kept];
    const bool fits = forEachAround(removed, [&](uint32_t, uint32_t a, uint32_t b, bool) {
      ++removed_fan;
      if (a == kept || b == kept) return true;
      const glm::vec3 p = s.points[a], reach = p - at;
      if (!(glm::dot(reach, reach) < max_length_squared)) return false;
      const glm::vec3 q = s.points[b], side = q - p;
      const glm::vec3 before = glm::cross(side, s.points[removed] - p), after = glm::cross(side, at - p);
      const float turn = glm::dot(before, after);
      if (!(turn > 0) ||
          turn * turn < min_turn_cosine * min_turn_cosine * glm::dot(before, before) * glm::dot(after, after))
        return false;
      // Slivers are refused: the new height over the opposite side must be at least a tenth of that side.
      return !(glm::dot(after, after) < 0.01f * glm::dot(side, side) * glm::dot(side, side) &&
               glm::dot(after, after) < glm::dot(before, before));
    });
    if (!fits) return false;
    ++mark_id;
    uint32_t kept_fan = 0;
    forEachAround(kept, [&](uint32_t, uint32_t a, uint32_t b, bool) {
      ++kept_fan;
      mark[a] = mark_id;
      mark[b] = mark_id;
      return true;
    });
    uint32_t common = 0;
    const bool joins = forEachAround(removed, [&](uint32_t, uint32_t a, uint32_t b, bool has_next) {
      common += mark[a] == mark_id;
      if (!has_next) common += mark[b] == mark_id;  // the last neighbour at a border
      return !(no_new_locked_edges && locked[kept] && locked[a] && a != kept && mark[a] != mark_id);
    });
    if (!joins) return false;
    const uint32_t sides = edge_on_border ? 1 : 2;
    if (common != sides) return false;  // the link condition (Dey et al. 1999)
    if (removed_fan + kept_fan < 2 * sides + (removed_on_border || border(kept) ? 1 : 3) || removed_fan + kept_fan > 16)
      return false;
    auto across = [&](uint32_t k) {
      const uint32_t c = from(previousOf(k));
      return fanSize(c) > (border(c) ? 1u : 3u);
    };
    return across(h) && (edge_on_border || across(g));
  }

  void collapse(uint32_t h, uint32_t removed, uint32_t kept) {
    forEachAround(removed, [&](uint32_t k, uint32_t, uint32_t, bool) {
      s.triangles[k / 3][k % 3] = kept;
      return true;
    });
    const uint32_t halves[2] = {h, twin[h]};
    uint32_t start = kNoIndex;
    uint32_t tips[2] = {kNoIndex, kNoIndex};
    for (int i = 0; i < 2; ++i) {
      const uint32_t k = halves[i];
      if (k == kNoIndex) continue;
      const uint32_t x = twin[nextOf(k)], y = twin[previousOf(k)];
      if (x != kNoIndex) twin[x] = y;
      if (y != kNoIndex) twin[y] = x;
      const uint32_t tip = s.triangles[k / 3][(k + 2) % 3];
      tips[i] = tip;
      // x runs from the tip to the kept vertex, y back.
      outgoing[tip] = x != kNoIndex ? x : nextOf(y);
      start = y != kNoIndex ? y : nextOf(x);
      s.triangles[k / 3] = {kNoIndex, kNoIndex, kNoIndex};
      --live_triangles;
    }
    outgoing[kept] = start;
    outgoing[removed] = kNoIndex;
    for (uint32_t v : {kept, tips[0], tips[1]}) {
      if (v == kNoIndex) continue;
      const uint32_t first = outgoing[v];
      for (uint32_t k = first; twin[k] != kNoIndex;) {  // clockwise, up to the border
        k = nextOf(twin[k]);
        if (k == first) break;
        outgoing[v] = k;
      }
      if (twin[outgoing[v]] != kNoIndex) outgoing[v] = first;
    }
  }

  bool stopped() const { return interrupted && interrupted->load(std::memory_order_relaxed); }

  void pass(size_t target_triangles, float length, float min_turn_cosine) {
    const float square = length * length;
    for (uint32_t h = 0; h < twin.size() && live_triangles > target_triangles; ++h) {
      if (h % (1u << 16) == 0 && stopped()) return;
      if (s.triangles[h / 3][0] == kNoIndex || (twin[h] != kNoIndex && twin[h] < h)) continue;
      const uint32_t a = from(h), b = to(h);
      const glm::vec3 d = s.points[b] - s.points[a];
      if (glm::dot(d, d) > square) continue;
      if (canCollapse(h, a, b, 3 * square, min_turn_cosine)) {
        collapse(h, a, b);
      } else if (canCollapse(h, b, a, 3 * square, min_turn_cosine)) {
        collapse(h, b, a);
      }
    }
  }
};

// The side of a regular triangle, n of which have that area together.
float regularSideLength(double area, size_t n) {
  return static_cast<float>(std::sqrt(area / static_cast<double>(n) * 4 / std::sqrt(3.0)));
}

ReducedPart extractLive(const Surface& s) {
  ReducedPart out;
  std::vector<uint32_t> new_index(s.points.size(), kNoIndex);
  for (Triangle t : s.triangles) {
    if (t[0] == kNoIndex) continue;
    for (uint32_t& v : t) {
      uint32_t& index = new_index[v];
      if (index == kNoIndex) {
        index = static_cast<uint32_t>(out.points.size());
        out.points.push_back(s.points[v]);
        out.vertex.push_back(v);
      }
      v = index;
    }
    out.triangles.push_back(t);
  }
  return out;
}

}  // namespace

ReducedPart reducePart(Surface part, float length, std::span<const uint32_t> locked,
                       const std::atomic<bool>* interrupted) {
  Reducer r(part, locked, interrupted);
  r.no_new_locked_edges = true;
  for (const auto& loop : part.loops)
    for (uint32_t v : loop) r.locked[v] = 1;
  for (float at = regularSideLength(areaOf(part), r.live_triangles); at < length && !r.stopped(); at *= 1.4f)
    r.pass(0, at, 0.8f);
  return extractLive(part);
}

Reduced reduceSurface(Surface scan, size_t triangles, std::span<const uint32_t> locked,
                      const std::atomic<bool>* interrupted) {
  Reduced out;
  if (scan.triangles.size() > triangles + triangles / 2) {
    const double area = areaOf(scan);
    auto side = [&](size_t n) { return regularSideLength(area, n); };
    Reducer r(scan, locked, interrupted);
    const float last = side(triangles);
    // Passes with ever longer edges, from the scan's own on. Collapses that hardly turn the surface come first; at full
    // length they may turn it more.
    for (float length = side(r.live_triangles); length < last && r.live_triangles > triangles; length *= 1.4f) {
      if (r.stopped()) break;
      r.pass(triangles, length, 0.8f);
    }
    for (float turn : {0.8f, 0.5f, 0.2f}) {
      if (r.stopped()) break;
      if (r.live_triangles > triangles) r.pass(triangles, 1.2f * last, turn);
    }
  }
  ReducedPart reduced = extractLive(scan);
  scan = {};
  auto surface = makeSurface(reduced.points, reduced.triangles);
  out.vertex = std::move(reduced.vertex);
  assert(surface.ok() && surface->points.size() == reduced.points.size());
  out.surface = std::move(*surface);
  return out;
}

}  // namespace relievo
