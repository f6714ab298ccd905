#include "geometry/remesh/base_reduce.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

namespace relievo {

namespace {

uint32_t nextOf(uint32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
uint32_t previousOf(uint32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }

// Half edge 3 t + k runs from corner k of triangle t to corner k + 1. `leaving`: a half edge of each vertex; at the
// border the one without a twin, so that turning against the clock passes the whole fan.
struct Reducer {
  Surface& s;
  std::vector<uint32_t>& twin;
  std::vector<uint32_t> leaving, mark;
  std::vector<uint8_t> stays;
  size_t live;
  const std::atomic<bool>* interrupted;
  uint32_t marks = 0;
  bool sealed = false;  // no new edge joins two vertices that stay: a neighbouring part may get the same one

  Reducer(Surface& surface, std::span<const uint32_t> keep, const std::atomic<bool>* stop)
      : s(surface),
        twin(surface.twin),
        leaving(s.points.size(), kNoIndex),
        mark(s.points.size(), 0),
        stays(s.points.size(), 0),
        live(s.triangles.size()),
        interrupted(stop) {
    for (uint32_t v : keep) stays[v] = 1;
    for (uint32_t h = 0; h < twin.size(); ++h) {
      uint32_t& l = leaving[from(h)];
      if (l == kNoIndex || twin[h] == kNoIndex) l = h;
    }
  }

  uint32_t from(uint32_t h) const { return s.triangles[h / 3][h % 3]; }
  uint32_t to(uint32_t h) const { return s.triangles[h / 3][(h + 1) % 3]; }
  bool border(uint32_t v) const { return twin[leaving[v]] == kNoIndex; }

  // fn(half edge leaving v, the vertex it ends in, the triangle's third, is there a next triangle?) for each triangle
  // around v, until it answers false.
  template <class Fn>
  bool around(uint32_t v, Fn fn) const {
    const uint32_t first = leaving[v];
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
  uint32_t fan(uint32_t v) const {
    uint32_t n = 0;
    around(v, [&](uint32_t, uint32_t, uint32_t, bool) { return ++n, true; });
    return n;
  }

  // May `gone` move to `keep` over the edge that h is a half of?
  bool allowed(uint32_t h, uint32_t gone, uint32_t keep, float longest_square, float least_turn) {
    const uint32_t g = twin[h];
    const bool edge_on_border = g == kNoIndex;
    const bool gone_border = border(gone);
    if (stays[gone] || (gone_border && !edge_on_border)) return false;
    // What fails most often, and costs least, first.
    uint32_t gone_fan = 0;
    const glm::vec3 at = s.points[keep];
    const bool fits = around(gone, [&](uint32_t, uint32_t a, uint32_t b, bool) {
      ++gone_fan;
      if (a == keep || b == keep) return true;
      const glm::vec3 p = s.points[a], reach = p - at;
      if (!(glm::dot(reach, reach) < longest_square)) return false;
      const glm::vec3 q = s.points[b], side = q - p;
      const glm::vec3 before = glm::cross(side, s.points[gone] - p), after = glm::cross(side, at - p);
      const float turn = glm::dot(before, after);
      if (!(turn > 0) || turn * turn < least_turn * least_turn * glm::dot(before, before) * glm::dot(after, after))
        return false;
      // No slivers: the new height over the opposite side is not less than a tenth of that side.
      return !(glm::dot(after, after) < 0.01f * glm::dot(side, side) * glm::dot(side, side) &&
               glm::dot(after, after) < glm::dot(before, before));
    });
    if (!fits) return false;
    ++marks;
    uint32_t keep_fan = 0;
    around(keep, [&](uint32_t, uint32_t a, uint32_t b, bool) {
      ++keep_fan;
      mark[a] = marks;
      mark[b] = marks;
      return true;
    });
    uint32_t common = 0;
    const bool joins = around(gone, [&](uint32_t, uint32_t a, uint32_t b, bool goes_on) {
      common += mark[a] == marks;
      if (!goes_on) common += mark[b] == marks;  // the last neighbour of an open fan
      return !(sealed && stays[keep] && stays[a] && a != keep && mark[a] != marks);
    });
    if (!joins) return false;
    const uint32_t sides = edge_on_border ? 1 : 2;
    if (common != sides) return false;  // the link condition (Dey et al. 1999)
    if (gone_fan + keep_fan < 2 * sides + (gone_border || border(keep) ? 1 : 3) || gone_fan + keep_fan > 16)
      return false;
    auto across = [&](uint32_t k) {
      const uint32_t c = from(previousOf(k));
      return fan(c) > (border(c) ? 1u : 3u);
    };
    return across(h) && (edge_on_border || across(g));
  }

  void collapse(uint32_t h, uint32_t gone, uint32_t keep) {
    around(gone, [&](uint32_t k, uint32_t, uint32_t, bool) {
      s.triangles[k / 3][k % 3] = keep;
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
      // Now x runs from the tip to the kept vertex, y back.
      leaving[tip] = x != kNoIndex ? x : nextOf(y);
      start = y != kNoIndex ? y : nextOf(x);
      s.triangles[k / 3] = {kNoIndex, kNoIndex, kNoIndex};
      --live;
    }
    leaving[keep] = start;
    leaving[gone] = kNoIndex;
    for (uint32_t v : {keep, tips[0], tips[1]}) {
      if (v == kNoIndex) continue;
      const uint32_t first = leaving[v];
      for (uint32_t k = first; twin[k] != kNoIndex;) {  // with the clock, up to the border
        k = nextOf(twin[k]);
        if (k == first) break;
        leaving[v] = k;
      }
      if (twin[leaving[v]] != kNoIndex) leaving[v] = first;
    }
  }

  bool stopped() const { return interrupted && interrupted->load(std::memory_order_relaxed); }

  void pass(size_t wanted, float length, float least_turn) {
    const float square = length * length;
    for (uint32_t h = 0; h < twin.size() && live > wanted; ++h) {
      if (h % (1u << 16) == 0 && stopped()) return;
      if (s.triangles[h / 3][0] == kNoIndex || (twin[h] != kNoIndex && twin[h] < h)) continue;
      const uint32_t a = from(h), b = to(h);
      const glm::vec3 d = s.points[b] - s.points[a];
      if (glm::dot(d, d) > square) continue;
      if (allowed(h, a, b, 3 * square, least_turn)) {
        collapse(h, a, b);
      } else if (allowed(h, b, a, 3 * square, least_turn)) {
        collapse(h, b, a);
      }
    }
  }
};

// Of a regular triangle, of n that have that area together.
float sideOf(double area, size_t n) {
  return static_cast<float>(std::sqrt(area / static_cast<double>(n) * 4 / std::sqrt(3.0)));
}

Thinned takeOut(const Surface& s) {
  Thinned out;
  std::vector<uint32_t> renamed(s.points.size(), kNoIndex);
  for (Triangle t : s.triangles) {
    if (t[0] == kNoIndex) continue;
    for (uint32_t& v : t) {
      uint32_t& name = renamed[v];
      if (name == kNoIndex) {
        name = static_cast<uint32_t>(out.points.size());
        out.points.push_back(s.points[v]);
        out.vertex.push_back(v);
      }
      v = name;
    }
    out.triangles.push_back(t);
  }
  return out;
}

}  // namespace

Thinned thinned(Surface part, float length, std::span<const uint32_t> stay, const std::atomic<bool>* interrupted) {
  Reducer r(part, stay, interrupted);
  r.sealed = true;
  for (const auto& loop : part.loops)
    for (uint32_t v : loop) r.stays[v] = 1;
  for (float at = sideOf(areaOf(part), r.live); at < length && !r.stopped(); at *= 1.4f) r.pass(0, at, 0.8f);
  return takeOut(part);
}

Reduced reduceSurface(Surface scan, size_t triangles, std::span<const uint32_t> keep,
                      const std::atomic<bool>* interrupted) {
  Reduced out;
  if (scan.triangles.size() > triangles + triangles / 2) {
    const double area = areaOf(scan);
    auto side = [&](size_t n) { return sideOf(area, n); };
    Reducer r(scan, keep, interrupted);
    const float last = side(triangles);
    // Ever longer edges, from the scan's own. What turns the surface little goes first; what is left at full length may
    // turn it more.
    for (float length = side(r.live); length < last && r.live > triangles; length *= 1.4f) {
      if (r.stopped()) break;
      r.pass(triangles, length, 0.8f);
    }
    for (float turn : {0.8f, 0.5f, 0.2f}) {
      if (r.stopped()) break;
      if (r.live > triangles) r.pass(triangles, 1.2f * last, turn);
    }
  }
  Thinned left = takeOut(scan);
  scan = {};
  auto surface = makeSurface(left.points, left.triangles);
  out.vertex = std::move(left.vertex);
  assert(surface.ok() && surface->points.size() == left.points.size());
  out.surface = std::move(*surface);
  return out;
}

}  // namespace relievo
