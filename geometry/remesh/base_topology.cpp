#include "geometry/remesh/base_topology.h"

#include <cassert>
#include <cmath>
#include <numeric>
#include <string>

namespace relievo {

namespace {

std::string positionText(const glm::vec3& p) {
  auto number = [](float x) {
    std::string s = std::to_string(x);
    return s.substr(0, s.find('.') + 4);
  };
  return "(" + number(p.x) + ", " + number(p.y) + ", " + number(p.z) + ") mm";
}

Error invalid(const std::string& message, const std::string& hint = {}) {
  return {ErrorKind::kInvalidData, {}, message, hint, {}};
}

// Finds the opposite of each half edge 3 t + k (corner k to corner k + 1), also between triangles of different
// orientation. consistent: is the orientation the same everywhere?
Result<std::vector<uint32_t>> pairHalfEdges(const Surface& s, bool& consistent) {
  const size_t half_edges = 3 * s.triangles.size();
  std::vector<uint32_t> begin(s.points.size() + 2, 0), sorted(half_edges), twin(half_edges, kNoIndex);
  auto lower = [](const Triangle& t, size_t k) { return std::min(t[k], t[k == 2 ? 0 : k + 1]); };
  for (const Triangle& t : s.triangles)
    for (size_t k = 0; k < 3; ++k) ++begin[lower(t, k) + 2];
  for (size_t i = 2; i < begin.size(); ++i) begin[i] += begin[i - 1];
  uint32_t next = 0;
  for (const Triangle& t : s.triangles)
    for (size_t k = 0; k < 3; ++k) sorted[begin[lower(t, k) + 1]++] = next++;
  consistent = true;
  struct End {
    uint32_t vertex;
    bool leaves;  // the half edge starts at the lower vertex
  };
  std::vector<End> ends;  // the other ends of a vertex's half edges
  for (uint32_t v = 0; v < s.points.size(); ++v) {
    ends.clear();
    for (uint32_t i = begin[v]; i < begin[v + 1]; ++i) {
      const uint32_t t = sorted[i] / 3, k = sorted[i] - 3 * t;
      const uint32_t from = s.triangles[t][k], to = s.triangles[t][k == 2 ? 0 : k + 1];
      ends.push_back({from == v ? to : from, from == v});
    }
    for (size_t i = 0; i < ends.size(); ++i) {
      for (size_t j = i + 1; j < ends.size(); ++j) {
        if (ends[i].vertex != ends[j].vertex) continue;
        uint32_t &of_i = twin[sorted[begin[v] + i]], &of_j = twin[sorted[begin[v] + j]];
        if (of_i != kNoIndex || of_j != kNoIndex) {
          return invalid(
              "three triangles share the edge at " + positionText(s.points[ends[i].leaves ? v : ends[i].vertex]),
              "let the mesh be repaired as it is read");
        }
        of_i = sorted[begin[v] + j];
        of_j = sorted[begin[v] + i];
        if (ends[i].leaves == ends[j].leaves) consistent = false;
      }
    }
  }
  return twin;
}

// Orients each piece's triangles consistently, as the larger part of its area already is.
Result<void> orientConsistently(Surface& s, std::span<const uint32_t> twin) {
  std::vector<uint8_t> state(s.triangles.size(), 0);  // 0: not visited, 1: stays, 2: flipped
  std::vector<uint32_t> piece;
  auto sameWay = [&](uint32_t h, uint32_t g) { return s.triangles[h / 3][h % 3] == s.triangles[g / 3][g % 3]; };
  for (uint32_t first = 0; first < s.triangles.size(); ++first) {
    if (state[first]) continue;
    piece.assign(1, first);
    state[first] = 1;
    double area[2] = {0, 0};
    for (size_t i = 0; i < piece.size(); ++i) {
      const Triangle& t = s.triangles[piece[i]];
      area[state[piece[i]] - 1] +=
          glm::length(glm::cross(s.points[t[1]] - s.points[t[0]], s.points[t[2]] - s.points[t[0]]));
      for (uint32_t k = 0; k < 3; ++k) {
        const uint32_t h = 3 * piece[i] + k, g = twin[h];
        if (g == kNoIndex) continue;
        const uint8_t expected_state = sameWay(h, g) ? 3 - state[piece[i]] : state[piece[i]];
        if (state[g / 3] == 0) {
          state[g / 3] = expected_state;
          piece.push_back(g / 3);
        } else if (state[g / 3] != expected_state) {
          return Error{ErrorKind::kInvalidData,
                       {},
                       "a piece of the surface has one side only, as a Moebius strip has; its strip closes at " +
                           positionText(s.points[s.triangles[g / 3][g % 3]]),
                       "cut it open there",
                       {}};
        }
      }
    }
    const uint8_t flipped_state = area[1] > area[0] ? 1 : 2;
    for (uint32_t t : piece) {
      if (state[t] == flipped_state) std::swap(s.triangles[t][1], s.triangles[t][2]);
    }
  }
  return {};
}

// Checks vertices and triangles one by one.
Result<void> checkInput(std::span<const glm::vec3> points, std::span<const Triangle> triangles) {
  if (triangles.empty()) return invalid("the mesh has no triangle");
  if (triangles.size() >= (uint64_t{1} << 32) / 3)
    return invalid("the mesh has more than 1.4 thousand million triangles");
  for (const glm::vec3& p : points) {
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
      return invalid("the mesh has a vertex without a finite position");
  }
  for (const Triangle& t : triangles) {
    for (uint32_t v : t) {
      if (v >= points.size())
        return invalid("a triangle names vertex " + std::to_string(v) + " of " + std::to_string(points.size()));
    }
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) {
      return invalid("a triangle names one vertex twice, at " + positionText(points[t[0]]),
                     "let the mesh be repaired as it is read");
    }
  }
  return {};
}

// Copies a vertex for each further fan of triangles around it.
void splitVerticesByFans(Surface& s) {
  std::vector<uint32_t> corner_vertex(3 * s.triangles.size(), kNoIndex);
  std::vector<uint8_t> has_fan(s.points.size(), 0);
  for (uint32_t h = 0; h < corner_vertex.size(); ++h) {
    if (corner_vertex[h] != kNoIndex) continue;
    uint32_t v = s.triangles[h / 3][h % 3];
    if (has_fan[v]) {
      s.points.push_back(s.points[v]);
      s.source.push_back(v);
      v = static_cast<uint32_t>(s.points.size() - 1);
    } else {
      has_fan[v] = 1;
    }
    uint32_t g = h;
    do {  // counter-clockwise, over the edge that ends in the vertex
      corner_vertex[g] = v;
      g = s.twin[previousOf(g)];
    } while (g != kNoIndex && g != h);
    if (g == kNoIndex) {
      for (g = s.twin[h]; g != kNoIndex; g = s.twin[g]) {
        g = nextOf(g);
        corner_vertex[g] = v;
      }
    }
  }
  for (uint32_t h = 0; h < corner_vertex.size(); ++h) s.triangles[h / 3][h % 3] = corner_vertex[h];
}

// For each vertex, the smallest vertex of its piece (union-find).
std::vector<uint32_t> pieceRoots(const Surface& s) {
  std::vector<uint32_t> parent(s.points.size());
  std::iota(parent.begin(), parent.end(), 0u);
  auto rootOf = [&](uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (const Triangle& t : s.triangles) {
    uint32_t a = rootOf(t[0]);
    for (int k = 1; k < 3; ++k) {
      const uint32_t b = rootOf(t[k]);
      if (a != b) parent[std::max(a, b)] = std::min(a, b);
      a = std::min(a, b);
    }
  }
  for (uint32_t v = 0; v < parent.size(); ++v) parent[v] = rootOf(v);
  return parent;
}

// Numbers the pieces in the order of their first triangles; loops are added later. Returns the number of border edges
// of each piece.
std::vector<uint64_t> numberPieces(Surface& s) {
  s.piece.assign(s.points.size(), kNoIndex);
  const std::vector<uint32_t> root = pieceRoots(s);
  std::vector<uint64_t> border_edges;
  for (uint32_t i = 0; i < s.triangles.size(); ++i) {
    const Triangle& t = s.triangles[i];
    uint32_t& piece = s.piece[root[t[0]]];
    if (piece == kNoIndex) {
      piece = static_cast<uint32_t>(s.pieces.size());
      s.pieces.push_back({.first_triangle = i});
      border_edges.push_back(0);
    }
    SurfacePiece& p = s.pieces[piece];
    ++p.triangles;
    p.area += 0.5 * glm::length(glm::cross(glm::dvec3(s.points[t[1]]) - glm::dvec3(s.points[t[0]]),
                                           glm::dvec3(s.points[t[2]]) - glm::dvec3(s.points[t[0]])));
    for (uint32_t k = 0; k < 3; ++k) border_edges[piece] += s.twin[3 * i + k] == kNoIndex;
  }
  for (uint32_t v = 0; v < s.points.size(); ++v) {
    s.piece[v] = s.piece[root[v]];
    if (s.piece[v] != kNoIndex) ++s.pieces[s.piece[v]].vertices;
  }
  return border_edges;
}

void traceBorderLoops(Surface& s) {
  std::vector<uint8_t> visited(3 * s.triangles.size(), 0);
  for (uint32_t h = 0; h < visited.size(); ++h) {
    if (s.twin[h] != kNoIndex || visited[h]) continue;
    std::vector<uint32_t> loop;
    for (uint32_t g = h; !visited[g];) {
      visited[g] = 1;
      loop.push_back(s.triangles[g / 3][g % 3]);
      // The next border edge starts at the end of this one: rotate about that vertex.
      g = nextOf(g);
      while (s.twin[g] != kNoIndex) g = nextOf(s.twin[g]);
    }
    ++s.pieces[s.piece[loop[0]]].borders;
    s.loops.push_back(std::move(loop));
  }
}

}  // namespace

Result<Surface> makeSurface(std::span<const glm::vec3> points, std::span<const Triangle> triangles) {
  if (auto sound = checkInput(points, triangles); !sound) return sound.error();
  Surface s;
  s.points.assign(points.begin(), points.end());
  s.triangles.assign(triangles.begin(), triangles.end());
  s.source.resize(points.size());
  std::iota(s.source.begin(), s.source.end(), 0u);

  bool consistent = true;
  auto twins = pairHalfEdges(s, consistent);
  if (!twins) return twins.error();
  if (!consistent) {
    if (auto oriented = orientConsistently(s, *twins); !oriented) return oriented.error();
    twins = pairHalfEdges(s, consistent);
  }
  s.twin = std::move(*twins);

  splitVerticesByFans(s);
  const std::vector<uint64_t> border_edges = numberPieces(s);
  traceBorderLoops(s);
  for (size_t i = 0; i < s.pieces.size(); ++i) {
    SurfacePiece& p = s.pieces[i];
    p.euler = static_cast<int64_t>(p.vertices) - static_cast<int64_t>((3 * p.triangles + border_edges[i]) / 2) +
              static_cast<int64_t>(p.triangles);
  }
  return s;
}

double areaOf(const Surface& s) {
  double area = 0;
  for (const SurfacePiece& p : s.pieces) area += p.area;
  return area;
}

Surface subdivided(const Surface& s) {
  std::vector<glm::vec3> points = s.points;
  std::vector<Triangle> triangles;
  triangles.reserve(4 * s.triangles.size());
  std::vector<uint32_t> middle(s.twin.size());
  for (uint32_t h = 0; h < middle.size(); ++h) {
    if (s.twin[h] != kNoIndex && s.twin[h] < h) {
      middle[h] = middle[s.twin[h]];
      continue;
    }
    const Triangle& t = s.triangles[h / 3];
    middle[h] = static_cast<uint32_t>(points.size());
    points.push_back((s.points[t[h % 3]] + s.points[t[(h + 1) % 3]]) / 2.0f);
  }
  for (uint32_t t = 0; t < s.triangles.size(); ++t) {
    const uint32_t a = middle[3 * t], b = middle[3 * t + 1], c = middle[3 * t + 2];
    triangles.push_back({s.triangles[t][0], a, c});
    triangles.push_back({a, s.triangles[t][1], b});
    triangles.push_back({c, b, s.triangles[t][2]});
    triangles.push_back({a, b, c});
  }
  auto finer = makeSurface(points, triangles);
  assert(finer.ok());
  return std::move(*finer);
}

}  // namespace relievo
