#include "geometry/scan/mesh_sheets.h"

#include <cmath>
#include <tuple>

namespace relievo {

EdgeCensus takeCensus(const TriMesh& mesh, const std::atomic<bool>* stop, int workers) {
  const Triangles& triangles = mesh.triangles;
  constexpr int kMostParts = 8;  // each may go over all triangles
  const auto parts = static_cast<size_t>(std::min(workerCount(workers), kMostParts));
  std::vector<uint32_t> mate(triangles.size() * 3, kNoHalfEdge);
  auto third = [&](uint32_t h) { return fromVertex(triangles, previousInTriangle(h)); };
  struct Part {
    EdgeCensus census;
    std::vector<std::pair<uint32_t, uint32_t>> thirds;
  };
  std::vector<Part> found(parts);
  forEachEdgeInParts(
      triangles, mesh.positions_mm.size(), parts,
      [&](size_t part, std::span<const uint32_t> edge) {
        auto& [census, thirds] = found[part];
        if (edge.size() == 1) {
          census.open.push_back(edge[0]);
        } else if (edge.size() == 2) {
          mate[edge[0]] = edge[1];
          mate[edge[1]] = edge[0];
          if (third(edge[0]) == third(edge[1])) census.duplicates.push_back(edge[1] / 3);
        } else {
          census.crowded.insert(census.crowded.end(), edge.begin(), edge.end());
          census.crowded_end.push_back(static_cast<uint32_t>(census.crowded.size()));
          thirds.clear();
          for (uint32_t h : edge) thirds.emplace_back(third(h), h);
          std::sort(thirds.begin(), thirds.end());
          for (size_t i = 1; i < thirds.size(); ++i)
            if (thirds[i].first == thirds[i - 1].first) census.duplicates.push_back(thirds[i].second / 3);
        }
      },
      stop);
  EdgeCensus census = std::move(found[0].census);
  for (size_t part = 1; part < parts; ++part) {
    const EdgeCensus& more = found[part].census;
    for (uint32_t end : more.crowded_end)
      census.crowded_end.push_back(static_cast<uint32_t>(census.crowded.size()) + end);
    census.open.insert(census.open.end(), more.open.begin(), more.open.end());
    census.crowded.insert(census.crowded.end(), more.crowded.begin(), more.crowded.end());
    census.duplicates.insert(census.duplicates.end(), more.duplicates.begin(), more.duplicates.end());
  }
  census.mate = std::move(mate);
  std::sort(census.duplicates.begin(), census.duplicates.end());
  census.duplicates.erase(std::unique(census.duplicates.begin(), census.duplicates.end()), census.duplicates.end());
  return census;
}

namespace {

// Walks over the pieces, triangle by triangle, in the order of their first triangles. cross(h, m) for each pair of
// mates of which h's triangle was met first (twice for pairs within what is already met).
template <class Meet, class Cross>
Pieces walk(size_t triangles, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop, Meet meet,
            Cross cross) {
  Pieces pieces;
  pieces.order.reserve(triangles);
  std::vector<bool> met(triangles);
  for (uint32_t seed = 0; seed < triangles; ++seed) {
    if (met[seed]) continue;
    met[seed] = true;
    size_t at = pieces.order.size();
    pieces.order.push_back(seed);
    for (; at < pieces.order.size(); ++at) {
      if (stopAt(at, stop)) return pieces;
      uint32_t t = pieces.order[at];
      for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        uint32_t m = mate[h];
        if (m == kNoHalfEdge) continue;
        if (met[m / 3]) {
          cross(h, m);
          continue;
        }
        met[m / 3] = true;
        pieces.order.push_back(m / 3);
        meet(h, m);
      }
    }
    pieces.end.push_back(static_cast<uint32_t>(pieces.order.size()));
  }
  return pieces;
}

}  // namespace

Pieces findPieces(const TriMesh& mesh, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop) {
  auto nothing = [](uint32_t, uint32_t) {};
  return walk(mesh.triangles.size(), mate, stop, nothing, nothing);
}

namespace {

bool runsAlike(const Triangles& triangles, uint32_t h, uint32_t m) {
  return fromVertex(triangles, h) == fromVertex(triangles, m);
}

// Does any triangle run against a neighbour?
bool anyRunsAlike(const Triangles& triangles, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop,
                  int workers) {
  constexpr size_t kBlock = size_t{1} << 16;
  std::atomic<bool> any{false};
  parallelFor((triangles.size() + kBlock - 1) / kBlock, workers, stop, [&](size_t block) {
    const size_t first = block * kBlock * 3, last = std::min(first + kBlock * 3, mate.size());
    for (size_t h = first; h < last && !any; ++h)
      if (mate[h] != kNoHalfEdge && runsAlike(triangles, static_cast<uint32_t>(h), mate[h])) any = true;
  });
  return any;
}

// A piece with larger holes may be a vessel scanned from within.
constexpr double kMostHoles = 0.05;  // of its area

// Half-edges of a piece that no other triangle meets.
std::vector<uint32_t> openEdges(const EdgeCensus& census, std::span<const uint32_t> members) {
  std::vector<uint32_t> out;
  for (uint32_t t : members)
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h)
      if (census.mate[h] == kNoHalfEdge) out.push_back(h);
  return out;
}

// Each hole is covered by triangles from its border to the middle of that.
bool hasSmallHoles(const TriMesh& mesh, std::span<const uint32_t> members, std::span<const uint32_t> open) {
  const Triangles& triangles = mesh.triangles;
  std::unordered_map<uint32_t, uint32_t> parent;  // of vertices on borders
  auto rootOf = [&](uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (uint32_t h : open) {
    const uint32_t a = fromVertex(triangles, h), b = toVertex(triangles, h);
    parent.try_emplace(a, a), parent.try_emplace(b, b);
    const uint32_t first = rootOf(a), second = rootOf(b);
    parent[std::max(first, second)] = std::min(first, second);
  }
  auto at = [&](uint32_t v) { return glm::dvec3(mesh.positions_mm[v]); };
  struct Border {
    glm::dvec3 sum{0};
    double count = 0;
  };
  std::unordered_map<uint32_t, Border> borders;
  for (uint32_t h : open) {
    Border& b = borders[rootOf(fromVertex(triangles, h))];
    b.sum += at(fromVertex(triangles, h));
    ++b.count;
  }
  double area = 0, holes = 0;
  for (uint32_t t : members) {
    const auto& v = triangles[t];
    area += glm::length(glm::cross(at(v[1]) - at(v[0]), at(v[2]) - at(v[0])));
  }
  for (uint32_t h : open) {
    const Border& b = borders[rootOf(fromVertex(triangles, h))];
    const glm::dvec3 centre = b.sum / b.count;
    holes += glm::length(glm::cross(at(fromVertex(triangles, h)) - centre, at(toVertex(triangles, h)) - centre));
  }
  return holes <= kMostHoles * area;
}

}  // namespace

Turned findTurns(const TriMesh& mesh, const EdgeCensus& census, const std::atomic<bool>* stop, int workers) {
  const Triangles& triangles = mesh.triangles;
  Turned out;
  std::vector<bool>& turn = out.turn;
  turn.resize(triangles.size());
  std::vector<bool> contradicts, open;
  auto fits = [&](uint32_t h, uint32_t m) { return (turn[m / 3] != turn[h / 3]) == runsAlike(triangles, h, m); };
  if (anyRunsAlike(triangles, census.mate, stop, workers)) {
    contradicts.resize(triangles.size());
    out.pieces = walk(
        triangles.size(), census.mate, stop,
        [&](uint32_t h, uint32_t m) { turn[m / 3] = turn[h / 3] != runsAlike(triangles, h, m); },
        [&](uint32_t h, uint32_t m) {
          if (!fits(h, m)) contradicts[h / 3] = true;
        });
  } else {
    out.pieces = findPieces(mesh, census.mate, stop);
  }
  if (!census.open.empty()) open.resize(triangles.size());
  for (uint32_t h : census.open) open[h / 3] = true;
  size_t steps = 0;
  for (size_t piece = 0; piece < out.pieces.count(); ++piece) {
    auto members = out.pieces.triangles(piece);
    size_t turned = 0;
    bool contradiction = false, closed = true;
    if (!contradicts.empty() || !open.empty()) {
      for (uint32_t t : members) {
        if (stopAt(steps++, stop)) return out;
        turned += turn[t];
        contradiction = contradiction || (!contradicts.empty() && contradicts[t]);
        closed = closed && (open.empty() || !open[t]);
      }
    }
    if (contradiction) {
      closed = false;
      ++out.cut_pieces;
      for (uint32_t t : members)
        for (uint32_t h = 3 * t; h < 3 * t + 3; ++h)
          if (const uint32_t m = census.mate[h]; m != kNoHalfEdge && h < m && !fits(h, m)) out.cut.push_back(h);
    }
    if (turned > 0) {
      const bool invert = turned > members.size() - turned;
      for (uint32_t t : members) {
        if (invert) turn[t] = !turn[t];
        if (turn[t]) out.triangles.push_back(t);
      }
    }
    if (contradiction) continue;
    // From the middle of the borders, from where holes hardly count.
    const std::vector<uint32_t> open_edges = closed ? std::vector<uint32_t>() : openEdges(census, members);
    glm::dvec3 origin(mesh.positions_mm[triangles[members[0]][0]]), middle(0);
    for (uint32_t h : open_edges) middle += glm::dvec3(mesh.positions_mm[fromVertex(triangles, h)]) - origin;
    if (!closed) origin += middle / static_cast<double>(open_edges.size());
    double volume = 0;
    for (uint32_t t : members) {
      if (stopAt(steps++, stop)) return out;
      auto at = [&](size_t k) { return glm::dvec3(mesh.positions_mm[triangles[t][k]]) - origin; };
      double v = glm::dot(at(0), glm::cross(at(1), at(2)));
      volume += turn[t] ? -v : v;
    }
    if (volume >= 0 || (!closed && !hasSmallHoles(mesh, members, open_edges))) continue;
    (closed ? out.inside_out : out.inside_out_with_holes).push_back(members[0]);
    for (uint32_t t : members) turn[t] = !turn[t];
  }
  out.complete = true;
  return out;
}

void turnOver(TriMesh& mesh, EdgeCensus& census, Turned& turned) {
  if (!turned.complete) return;
  for (uint32_t h : turned.cut) {
    const uint32_t m = census.mate[h];
    census.mate[h] = census.mate[m] = kNoHalfEdge;
    census.open.insert(census.open.end(), {h, m});
  }
  if (turned.triangles.empty() && turned.inside_out.empty() && turned.inside_out_with_holes.empty()) return;
  const std::vector<bool>& turn = turned.turn;
  // Corners 1 and 2 change places, and with them half-edges 0 and 2.
  auto renamed = [&](uint32_t h) { return turn[h / 3] && h % 3 != 1 ? h / 3 * 3 + 2 - h % 3 : h; };
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!turn[t]) continue;
    std::swap(mesh.triangles[t][1], mesh.triangles[t][2]);
    if (!mesh.corner_uv.empty()) std::swap(mesh.corner_uv[t][1], mesh.corner_uv[t][2]);
    if (!mesh.corner_normals.empty()) {
      std::swap(mesh.corner_normals[t][1], mesh.corner_normals[t][2]);
      for (glm::vec3& n : mesh.corner_normals[t]) n = -n;
    }
    std::swap(census.mate[3 * t], census.mate[3 * t + 2]);
  }
  for (uint32_t& m : census.mate)
    if (m != kNoHalfEdge) m = renamed(m);
  for (uint32_t& h : census.open) h = renamed(h);
  for (uint32_t& h : census.crowded) h = renamed(h);
  for (uint32_t& h : turned.cut) h = renamed(h);
}

void pairCrowded(const TriMesh& mesh, EdgeCensus& census) {
  struct Leaf {
    uint32_t half_edge;
    bool forward;     // from the edge's lower vertex
    glm::dvec3 into;  // of length 1, across the edge into the triangle
    double angle;     // 0..4, growing with the angle around the edge
  };
  auto mate = [&](const Leaf& a, const Leaf& b) {
    census.mate[a.half_edge] = b.half_edge;
    census.mate[b.half_edge] = a.half_edge;
  };
  size_t begin = 0;
  std::vector<Leaf> leaves;
  for (uint32_t end : census.crowded_end) {
    std::span<const uint32_t> edge = std::span(census.crowded).subspan(begin, end - begin);
    begin = end;
    if (edge.size() > kMaxPaired) continue;
    auto place = [&](uint32_t v) { return glm::dvec3(mesh.positions_mm[v]); };
    uint32_t low = std::min(fromVertex(mesh.triangles, edge[0]), toVertex(mesh.triangles, edge[0]));
    uint32_t high = std::max(fromVertex(mesh.triangles, edge[0]), toVertex(mesh.triangles, edge[0]));
    glm::dvec3 along = glm::normalize(place(high) - place(low));
    leaves.clear();
    for (uint32_t h : edge) {
      glm::dvec3 w = place(fromVertex(mesh.triangles, previousInTriangle(h))) - place(low);
      w -= along * glm::dot(w, along);
      leaves.push_back({h, fromVertex(mesh.triangles, h) == low, w / std::max(glm::length(w), 1e-300), 0});
    }
    glm::dvec3 x = leaves[0].into, y = glm::cross(along, x);
    for (Leaf& l : leaves) {  // without trigonometry: the same on every machine
      double u = glm::dot(l.into, x), v = glm::dot(l.into, y), part = v / std::max(std::abs(u) + std::abs(v), 1e-300);
      l.angle = u >= 0 ? (v >= 0 ? part : 4 + part) : 2 - part;
    }
    std::sort(leaves.begin(), leaves.end(), [](const Leaf& a, const Leaf& b) {
      return a.angle != b.angle ? a.angle < b.angle : a.half_edge < b.half_edge;
    });
    // A backward triangle has its normal on the side of smaller angles, so the solid follows it.
    const size_t n = leaves.size();
    bool alternate = true;
    for (size_t i = 0; i < n; ++i) alternate = alternate && leaves[i].forward != leaves[(i + 1) % n].forward;
    if (alternate) {
      for (size_t i = 0; i < n; ++i)
        if (!leaves[i].forward) mate(leaves[i], leaves[(i + 1) % n]);
      continue;
    }
    struct Pair {
      double cosine;
      size_t a, b;
    };
    std::vector<Pair> pairs;
    for (size_t a = 0; a < n; ++a)
      for (size_t b = a + 1; b < n; ++b)
        if (leaves[a].forward != leaves[b].forward) pairs.push_back({glm::dot(leaves[a].into, leaves[b].into), a, b});
    std::sort(pairs.begin(), pairs.end(),
              [](const Pair& p, const Pair& q) { return std::tie(p.cosine, p.a, p.b) < std::tie(q.cosine, q.a, q.b); });
    std::vector<bool> taken(n);
    for (const Pair& p : pairs) {
      if (taken[p.a] || taken[p.b]) continue;
      taken[p.a] = taken[p.b] = true;
      mate(leaves[p.a], leaves[p.b]);
    }
  }
}

namespace {

uint32_t copyVertex(TriMesh& mesh, uint32_t v) {
  mesh.positions_mm.push_back(mesh.positions_mm[v]);
  if (!mesh.colours.empty()) mesh.colours.push_back(mesh.colours[v]);
  return static_cast<uint32_t>(mesh.positions_mm.size() - 1);
}

// second(vertex, fan) for each fan of triangles but the first around a vertex: corners, named as the half-edges that
// leave them. False: it said so, or *stop was set.
template <class Second>
bool forEachFurtherFan(const Triangles& triangles, size_t vertices, const std::vector<uint32_t>& mate,
                       const std::atomic<bool>* stop, Second second) {
  std::vector<bool> done(triangles.size() * 3), has_fan(vertices);
  std::vector<uint32_t> fan;
  for (uint32_t corner = 0; corner < done.size(); ++corner) {
    if (stopAt(corner, stop)) return false;
    if (done[corner]) continue;
    const uint32_t v = fromVertex(triangles, corner);
    fan.assign(1, corner);
    done[corner] = true;
    for (uint32_t start : {corner, previousInTriangle(corner)}) {
      for (uint32_t edge = start; mate[edge] != kNoHalfEdge;) {
        // Into the next triangle through its edge m; on through its other edge at v. Mates may run alike (no
        // orientation).
        uint32_t m = mate[edge];
        bool leaves = fromVertex(triangles, m) == v;
        uint32_t c = leaves ? m : nextInTriangle(m);
        if (done[c]) break;
        done[c] = true;
        fan.push_back(c);
        edge = leaves ? previousInTriangle(c) : c;
      }
    }
    if (!has_fan[v]) has_fan[v] = true;
    else if (!second(v, fan)) return false;
  }
  return true;
}

bool splitFansOnce(TriMesh& mesh, const std::vector<uint32_t>& mate, std::vector<uint32_t>& split,
                   const std::atomic<bool>* stop) {
  std::vector<bool> counted(mesh.positions_mm.size());
  return forEachFurtherFan(mesh.triangles, mesh.positions_mm.size(), mate, stop,
                           [&](uint32_t v, const std::vector<uint32_t>& fan) {
                             if (!counted[v]) split.push_back(v);
                             counted[v] = true;
                             uint32_t copy = copyVertex(mesh, v);
                             for (uint32_t c : fan) mesh.triangles[c / 3][c % 3] = copy;
                             return true;
                           });
}

// Edges that more than a pair of mates name, after the split: all but the first pair (or triangle) leave the vertex
// that the edge's first half-edge starts from, each with a vertex of its own.
bool cutCurls(TriMesh& mesh, std::vector<uint32_t>& mate, const std::atomic<bool>* stop) {
  std::vector<std::array<uint32_t, 2>> leave;  // a half-edge, and its mate or none
  forEachEdge(
      mesh.triangles, mesh.positions_mm.size(),
      [&](std::span<const uint32_t> edge) {
        if (edge.size() < 2 || (edge.size() == 2 && mate[edge[0]] == edge[1])) return;
        auto paired = std::find_if(edge.begin(), edge.end(), [&](uint32_t h) { return mate[h] != kNoHalfEdge; });
        uint32_t stays = paired != edge.end() ? *paired : edge[0];
        for (uint32_t h : edge)
          if (h != stays && mate[h] != stays && (mate[h] == kNoHalfEdge || mate[h] > h)) leave.push_back({h, mate[h]});
      },
      stop);
  for (auto& pair : leave) {
    const uint32_t v = fromVertex(mesh.triangles, pair[0]);
    uint32_t copy = kNoHalfEdge;
    for (uint32_t h : pair) {
      if (h == kNoHalfEdge) continue;
      // The corner at v, unless an earlier cut took it.
      uint32_t corner = fromVertex(mesh.triangles, h) == v ? h
                        : toVertex(mesh.triangles, h) == v ? nextInTriangle(h)
                                                           : kNoHalfEdge;
      if (corner == kNoHalfEdge) continue;
      uint32_t other = corner == h ? previousInTriangle(h) : corner;
      if (mate[other] != kNoHalfEdge) {
        mate[mate[other]] = kNoHalfEdge;
        mate[other] = kNoHalfEdge;
      }
      if (copy == kNoHalfEdge) copy = copyVertex(mesh, v);
      mesh.triangles[corner / 3][corner % 3] = copy;
    }
  }
  return !leave.empty();
}

}  // namespace

bool oneFanAVertex(const TriMesh& mesh, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop) {
  return forEachFurtherFan(mesh.triangles, mesh.positions_mm.size(), mate, stop,
                           [](uint32_t, const std::vector<uint32_t>&) { return false; });
}

bool splitFans(TriMesh& mesh, EdgeCensus& census, std::vector<uint32_t>& split, const std::atomic<bool>* stop) {
  constexpr int kMaxRounds = 100;  // one is usual, two are rare
  for (int round = 0; round < kMaxRounds; ++round) {
    if (!splitFansOnce(mesh, census.mate, split, stop)) return false;
    if (census.crowded.empty() || !cutCurls(mesh, census.mate, stop)) return true;
  }
  return false;
}

}  // namespace relievo
