#include "geometry/remesh/base_quads.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace relievo {

namespace {

// 1: all right angles and flat; 0: an angle of 180 degrees or folded (Remacle et al. 2012, Blossom-Quad, eq. 2).
double quadQuality(const std::array<glm::dvec3, 4>& p, double fold) {
  double worst = 0;
  for (int k = 0; k < 4; ++k) {
    const glm::dvec3 a = unit(p[(k + 1) % 4] - p[k]), b = unit(p[(k + 3) % 4] - p[k]);
    worst = std::max(worst, std::abs(std::acos(std::clamp(glm::dot(a, b), -1.0, 1.0)) - std::numbers::pi / 2));
  }
  return std::max(0.0, 1 - worst / (std::numbers::pi / 2)) * std::max(0.0, fold);
}

SmartFaceHandle across(const SmartEdgeHandle& edge, FaceHandle face) {
  return edge.h0().face() == face ? edge.h1().face() : edge.h0().face();
}

// Triangles in pairs, named by the edge between them, which becomes a quad's diagonal: the best first, then better by
// what augment() and exchange() find. A vertex inside keeps three edges, or corners would lie on a straight line.
class TrianglePairs {
 public:
  TrianglePairs(const TriangleMesh& mesh, bool all_wanted)
      : mesh_(mesh), quality_(mesh.n_edges(), -1.0), diagonal_(mesh.n_faces()), edges_(mesh.n_vertices()) {
    for (const auto v : mesh_.vertices()) edges_[v.idx()] = facesAround(v);
    std::vector<SmartEdgeHandle> best;
    for (const auto e : mesh_.edges()) {
      if (e.is_boundary() || mesh_.data(e.h0()).step) continue;
      const double fold = glm::dot(unit(areaVector(mesh_, e.h0().face())), unit(areaVector(mesh_, e.h1().face())));
      const double quality = quadQuality(
          {mesh_.point(e.v0()), mesh_.point(e.h1().next().to()), mesh_.point(e.v1()), mesh_.point(e.h0().next().to())},
          fold);
      if (quality < 0.05 && !all_wanted) continue;
      quality_[e.idx()] = quality;
      best.push_back(e);
    }
    // Edges of the same quality by their triangles.
    auto before = [&](const SmartEdgeHandle& x, const SmartEdgeHandle& y) {
      if (qualityOf(x) != qualityOf(y)) return qualityOf(x) > qualityOf(y);
      const std::pair<int, int> of_x = std::minmax({x.h0().face().idx(), x.h1().face().idx()}),
                                of_y = std::minmax({y.h0().face().idx(), y.h1().face().idx()});
      return of_x < of_y;
    };
    std::sort(best.begin(), best.end(), before);
    for (const auto& e : best) {
      if (alone(e.h0().face()) && alone(e.h1().face()) && roomFor(e)) join(e);
    }
  }

  // A free triangle takes another's partner, and so on to the next free one; short paths first. Those odd cycles that a
  // search by triangles cannot pass are found from the other end, or not at all. False: none was found.
  bool augment() {
    Search search{std::vector<SmartHalfedgeHandle>(mesh_.n_faces()), std::vector<uint32_t>(mesh_.n_faces(), 0)};
    bool any = false;
    for (const auto start : mesh_.faces()) any |= alone(start) && searchFrom(start, search);
    return any;
  }
  // Two pairs that lie side by side exchange partners where that is better. False: none did.
  bool exchange();

  std::vector<SmartEdgeHandle> takeDiagonals() { return std::move(diagonal_); }  // of each triangle; not valid: alone

 private:
  double qualityOf(EdgeHandle e) const { return quality_[e.idx()]; }
  bool alone(FaceHandle f) const { return !diagonal_[f.idx()].is_valid(); }
  SmartFaceHandle partner(FaceHandle f) const { return across(diagonal_[f.idx()], f); }
  bool roomFor(const SmartEdgeHandle& e) const {
    auto room = [&](const SmartVertexHandle& v) { return v.is_boundary() || edges_[v.idx()] > 3; };
    return room(e.v0()) && room(e.v1());
  }
  void join(const SmartEdgeHandle& e) {
    diagonal_[e.h0().face().idx()] = diagonal_[e.h1().face().idx()] = e;
    --edges_[e.v0().idx()], --edges_[e.v1().idx()];
  }
  void part(const SmartEdgeHandle& e) {
    diagonal_[e.h0().face().idx()] = diagonal_[e.h1().face().idx()] = SmartEdgeHandle();
    ++edges_[e.v0().idx()], ++edges_[e.v1().idx()];
  }
  // All, or nothing is changed: false.
  bool change(std::span<const SmartEdgeHandle> parts, std::span<const SmartEdgeHandle> joins) {
    for (const auto& e : parts) part(e);
    size_t joined = 0;
    while (joined < joins.size() && roomFor(joins[joined])) join(joins[joined++]);
    if (joined == joins.size()) return true;
    for (const auto& e : joins.first(joined)) part(e);
    for (const auto& e : parts) join(e);
    return false;
  }

  // A breadth-first search of alternating paths: for each triangle reached, the half edge over which its partner was.
  struct Search {
    std::vector<SmartHalfedgeHandle> over;
    std::vector<uint32_t> seen;
    uint32_t number = 0;  // what `seen` holds for triangles of this search
  };
  bool searchFrom(FaceHandle start, Search& search);
  // The path from start to the triangle beyond `end`: each triangle joins the one that it was reached through.
  bool turnOver(FaceHandle start, SmartHalfedgeHandle end, const Search& search) {
    std::vector<SmartEdgeHandle> joins{end.edge()}, parts;
    while (end.face() != start) {
      parts.push_back(diagonal_[end.face().idx()]);
      end = search.over[end.face().idx()];
      joins.push_back(end.edge());
    }
    return change(parts, joins);
  }

  const TriangleMesh& mesh_;
  std::vector<double> quality_;            // of an edge; below 0: it cannot be a diagonal
  std::vector<SmartEdgeHandle> diagonal_;  // of a triangle
  std::vector<uint32_t> edges_;            // left at a vertex
};

bool TrianglePairs::searchFrom(FaceHandle start, Search& search) {
  constexpr size_t kMostTriangles = 400;
  const uint32_t number = ++search.number;
  std::vector<SmartFaceHandle> queue{OpenMesh::make_smart(start, mesh_)};
  search.seen[start.idx()] = number;
  for (size_t i = 0; i < queue.size() && queue.size() < kMostTriangles; ++i) {
    const SmartFaceHandle f = queue[i];
    for (const auto& h : sidesOf(f)) {
      if (qualityOf(h.edge()) < 0 || h.edge() == diagonal_[f.idx()]) continue;
      const SmartFaceHandle other = h.opp().face();
      if (search.seen[other.idx()] == number) continue;
      if (alone(other)) {
        if (turnOver(start, h, search)) return true;
        continue;
      }
      const SmartFaceHandle next = partner(other);
      if (search.seen[next.idx()] == number) continue;
      search.seen[other.idx()] = search.seen[next.idx()] = number;
      search.over[next.idx()] = h;
      queue.push_back(next);
    }
  }
  return false;
}

bool TrianglePairs::exchange() {
  bool any = false;
  for (const auto a : mesh_.faces()) {
    if (alone(a)) continue;
    for (const auto& h : sidesOf(a)) {
      const SmartFaceHandle c = h.opp().face();
      if (qualityOf(h.edge()) < 0 || h.edge() == diagonal_[a.idx()] || alone(c)) continue;
      const std::array<SmartEdgeHandle, 2> were{diagonal_[a.idx()], diagonal_[c.idx()]};
      SmartEdgeHandle between;  // their partners
      for (const auto g : partner(a).halfedges()) {
        if (g.opp().face() == partner(c)) between = g.edge();
      }
      if (!between.is_valid() || qualityOf(between) <= 0 ||
          qualityOf(h.edge()) + qualityOf(between) <= qualityOf(were[0]) + qualityOf(were[1]) + 1e-6)
        continue;
      any |= change(were, std::array{h.edge(), between});
      break;
    }
  }
  return any;
}

// For each triangle its quad's diagonal: greedily by quality, then more by alternating paths, then better by exchanges.
std::vector<SmartEdgeHandle> pairTriangles(const TriangleMesh& m, bool all_wanted) {
  TrianglePairs pairs(m, all_wanted);
  for (int round = 0; round < 4; ++round) {
    const bool longer = pairs.augment(), better = pairs.exchange();
    if (!longer && !better) break;
  }
  return pairs.takeDiagonals();
}

// A corner that slides on a feature curve, between its neighbours there.
struct Sliding {
  SmartHalfedgeHandle before, after;  // half edges to the neighbours; not valid: there is none, and it must stay
  uint32_t curve = kNoIndex;
  double start = 0, along = 0, end = 0;

  Sliding(const QuadMesh& m, const SmartVertexHandle& v) {
    for (const auto h : v.outgoing_halfedges()) {
      const CurveStep &here = m.data(h).step, &there = m.data(h.opp()).step;
      if (!here) continue;
      curve = here.curve;
      along = here.along;
      (there.along < along ? before : after) = h;
      (there.along < along ? start : end) = there.along;
    }
  }
  bool possible() const { return before.is_valid() && after.is_valid(); }
  void move(QuadMesh& m, const FeatureCurve& on, double to) {
    along = m.data(before).step.along = m.data(after).step.along = to;
    m.set_point(before.from(), on.point(to));
  }
};

// Of a quad's angle at the vertex that the half edge leaves, seen along the normal there.
double sineAt(const QuadMesh& m, const SmartHalfedgeHandle& h) {
  const glm::dvec3 p = m.point(h.from()), a = m.point(h.to()) - p, b = m.point(h.prev().from()) - p;
  const double length = glm::length(a) * glm::length(b);
  return length > 0 ? glm::dot(glm::cross(a, b), m.normal(h.from())) / length : 0.0;
}

}  // namespace

QuadMesh makeQuads(const TriangleMesh& m, std::span<const FeatureCurve> curves, bool split) {
  QuadMesh out;
  const std::vector<SmartEdgeHandle> diagonal = pairTriangles(m, !split);
  if (!split && !std::all_of(diagonal.begin(), diagonal.end(), [](EdgeHandle e) { return e.is_valid(); })) return out;
  for (const auto v : m.vertices()) {
    const auto corner = out.add_vertex(m.point(v));
    out.data(corner).fixed = m.data(v).fixed || (v.is_boundary() && !m.data(v).on_curve);
  }
  std::vector<VertexHandle> middle(m.n_edges());
  auto along = [&](const SmartEdgeHandle& e) { return (m.data(e.h0()).step.along + m.data(e.h1()).step.along) / 2; };
  auto middleOf = [&](const SmartEdgeHandle& e) {
    VertexHandle& v = middle[e.idx()];
    const CurveStep& step = m.data(e.h0()).step;
    if (!v.is_valid())
      v = out.add_vertex(step ? curves[step.curve].point(along(e)) : (m.point(e.v0()) + m.point(e.v1())) / 2.0);
    return v;
  };
  for (const auto f : m.faces()) {
    const SmartEdgeHandle& own = diagonal[f.idx()];
    if (own.is_valid() && across(own, f) < f) continue;
    std::vector<SmartHalfedgeHandle> sides;  // of the triangle, or the pair
    for (const auto& h : sidesOf(f)) {
      if (h.edge() != own) sides.push_back(h);
      else sides = {h.opp().next(), h.opp().prev(), h.next(), h.prev()};
      if (sides.size() == 4) break;
    }
    if (!split) {
      out.add_face(sides[0].from(), sides[1].from(), sides[2].from(), sides[3].from());
      continue;
    }
    const size_t n = sides.size();
    glm::dvec3 middle_of_all{0};
    for (const auto& h : sides) middle_of_all += m.point(h.from()) / static_cast<double>(n);
    const VertexHandle centre = out.add_vertex(middle_of_all);
    for (size_t k = 0; k < n; ++k) {
      const VertexHandle after = middleOf(sides[k].edge()), before = middleOf(sides[(k + n - 1) % n].edge());
      out.add_face(sides[k].from(), after, centre, before);
    }
  }
  for (const auto e : m.edges()) {
    const CurveStep &a = m.data(e.h0()).step, &b = m.data(e.h1()).step;
    if (!a) continue;
    const VertexHandle between = middle[e.idx()];
    if (!split) markStep(out, e.v0(), e.v1(), a.curve, a.along, b.along);
    if (!split) continue;
    markStep(out, e.v0(), between, a.curve, a.along, along(e));
    markStep(out, between, e.v1(), a.curve, along(e), b.along);
  }
  return out;
}

double leastSine(const QuadMesh& m, const SmartVertexHandle& corner) {
  double least = 1;
  for (const auto f : corner.faces()) {
    for (const auto h : f.halfedges()) least = std::min(least, sineAt(m, h));
  }
  return least;
}

bool folds(const QuadMesh& m, const SmartVertexHandle& corner) {
  for (const auto h : corner.outgoing_halfedges()) {
    if (!h.is_boundary() && sineAt(m, h) < 0.02) return true;
  }
  return false;
}

glm::dvec3 ScanLookup::normal(uint32_t t) const {
  return unit(glm::cross(corner(t, 1) - corner(t, 0), corner(t, 2) - corner(t, 0)));
}

SurfacePoint ScanLookup::project(const glm::dvec3& p, const glm::dvec3& n, double reach) const {
  const SurfacePoint near = scene.closestPoint(p, reach);
  if (near && glm::dot(normal(near.triangle), n) > 0.2) return near;
  return scene.nearestOnLine({p, n, reach}, Facing::kAlong);
}

void updateNormals(QuadMesh& m) {
  for (const auto v : m.vertices()) m.set_normal(v, glm::dvec3(0));
  for (const auto f : m.faces()) {
    const auto p = pointsOf<4>(m, f);
    const glm::dvec3 up = glm::cross(p[2] - p[0], p[3] - p[1]);
    for (const auto v : f.vertices()) m.set_normal(v, m.normal(v) + up);
  }
  for (const auto v : m.vertices()) m.set_normal(v, unit(m.normal(v)));
}

void relaxQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanLookup& scan, int rounds) {
  std::vector<glm::dvec3> target(m.n_vertices());
  std::vector<double> weight(m.n_vertices());
  for (int round = 0; round < rounds; ++round) {
    updateNormals(m);
    std::fill(target.begin(), target.end(), glm::dvec3(0));
    std::fill(weight.begin(), weight.end(), 0.0);
    for (const auto f : m.faces()) {
      const auto p = pointsOf<4>(m, f);
      const glm::dvec3 normal = unit(glm::cross(p[2] - p[0], p[3] - p[1]));
      if (normal == glm::dvec3(0)) continue;
      // The square that fits best: each corner turned back to the first one's place and averaged.
      const glm::dvec3 centre = (p[0] + p[1] + p[2] + p[3]) / 4.0;
      glm::dvec3 arm{0};
      for (int k = 0; k < 4; ++k) {
        glm::dvec3 d = p[k] - centre;
        for (int j = 0; j < (4 - k) % 4; ++j) d = glm::cross(normal, d);
        arm += (d - normal * glm::dot(d, normal)) / 4.0;
      }
      const double w = 1 / std::max(glm::length(arm), 1e-12);  // small quads count as much as large ones
      for (const auto v : f.vertices()) {
        target[v.idx()] += w * (centre + arm);
        weight[v.idx()] += w;
        arm = glm::cross(normal, arm);
      }
    }
    for (const auto v : m.vertices()) {
      if (m.data(v).fixed || weight[v.idx()] <= 0) continue;
      const glm::dvec3 was = m.point(v), to = target[v.idx()] / weight[v.idx()];
      if (m.data(v).on_curve) {
        Sliding at(m, v);
        if (!at.possible()) continue;
        // Along the feature curve as far as the desired level points that way, and towards the middle.
        const glm::dvec3 tangent = unit(m.point(at.after.to()) - m.point(at.before.to()));
        const double s = 0.7 * (at.along + 0.5 * glm::dot(to - was, tangent)) + 0.3 * (at.start + at.end) / 2;
        at.move(m, curves[at.curve], std::clamp(s, 0.75 * at.start + 0.25 * at.end, 0.25 * at.start + 0.75 * at.end));
        continue;
      }
      glm::dvec3 step = 0.6 * (to - was);
      step -= m.normal(v) * glm::dot(step, m.normal(v));
      step = m.data(v).slide * step;
      const double reach = 2 * facesAround(v) / weight[v.idx()];  // about twice the quads' radius
      const double before = leastSine(m, v);
      if (const SurfacePoint hit = scan.project(was + step, m.normal(v), reach)) m.set_point(v, scan.point(hit));
      if (leastSine(m, v) < std::min(before, 0.3)) m.set_point(v, was);
    }
  }
}

void settleBorders(QuadMesh& m, std::span<const FeatureCurve> curves, std::span<const double> must) {
  for (int round = 0; round < 4; ++round) {
    for (const auto v : m.vertices()) {
      if (m.data(v).fixed || !m.data(v).on_curve) continue;
      Sliding at(m, v);
      if (!at.possible() || !curves[at.curve].border) continue;
      const FeatureCurve& curve = curves[at.curve];
      const SmartVertexHandle from = at.before.to(), to = at.after.to();
      const CurveEnd before{m.point(from), m.normal(from), at.start}, after{m.point(to), m.normal(to), at.end};
      auto deviation = [&](double along) {
        const CurveEnd here{curve.point(along), m.normal(v), along};
        return std::max(deviationFromSide(curve, before, here), deviationFromSide(curve, here, after));
      };
      double best = at.along, least = deviation(best);
      if (least <= must[at.curve] / 2) continue;
      const double sine = std::min(leastSine(m, v), 0.3);
      for (int k = 0; k <= 16; ++k) {
        const double along = at.start + (at.end - at.start) * (0.25 + 0.5 * k / 16), s = deviation(along);
        if (s >= 0.95 * least) continue;
        const glm::dvec3 was = m.point(v);
        m.set_point(v, curve.point(along));
        if (leastSine(m, v) >= sine) best = along, least = s;
        m.set_point(v, was);
      }
      at.move(m, curve, best);
    }
  }
}

void untangleQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanLookup& scan) {
  constexpr double kEnough = 0.3;  // of a sine: 17 degrees from folding
  for (int round = 0; round < 20; ++round) {
    bool moved = false;
    for (const auto v : m.vertices()) {
      double best_sine = leastSine(m, v);
      if (m.data(v).fixed || best_sine >= kEnough) continue;
      Sliding at(m, v);
      if (m.data(v).on_curve && !at.possible()) continue;
      const glm::dvec3 was = m.point(v);
      const double along = at.along;
      // Towards the middle of the neighbours; of a feature curve's two neighbours.
      glm::dvec3 middle{0};
      double reach = 0;
      for (const auto f : v.faces()) {
        for (const auto c : f.vertices()) {
          if (c == v) continue;
          middle += m.point(c);
          reach = std::max(reach, glm::length(m.point(c) - was));
        }
      }
      middle /= 3.0 * facesAround(v);
      glm::dvec3 best = was;
      double best_along = along;
      for (double t : {1.0, 0.5, 0.25, 0.1}) {
        if (m.data(v).on_curve) {
          at.move(m, curves[at.curve], along + t * ((at.start + at.end) / 2 - along));
        } else {
          const SurfacePoint hit = scan.project(was + t * (middle - was), m.normal(v), reach);
          if (!hit) continue;
          m.set_point(v, scan.point(hit));
        }
        const double sine = leastSine(m, v);
        if (sine > best_sine + 1e-3) best_sine = sine, best = m.point(v), best_along = at.along, moved = true;
      }
      if (m.data(v).on_curve) at.move(m, curves[at.curve], best_along);
      m.set_point(v, best);
    }
    if (!moved) return;
  }
}

}  // namespace relievo
