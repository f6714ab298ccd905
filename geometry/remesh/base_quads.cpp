#include "geometry/remesh/base_quads.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace relievo {

namespace {

// The quality of a quad: 1 if all angles are right ones and it is flat, 0 with an angle of 180 degrees or a fold.
// cosine: between the normals of its two triangles. Source: Remacle et al. 2012, "Blossom-Quad", eq. 2.
double quadQuality(const std::array<glm::dvec3, 4>& p, double cosine) {
  double worst = 0;
  for (int k = 0; k < 4; ++k) {
    const glm::dvec3 a = unit(p[(k + 1) % 4] - p[k]), b = unit(p[(k + 3) % 4] - p[k]);
    worst = std::max(worst, std::abs(std::acos(std::clamp(glm::dot(a, b), -1.0, 1.0)) - std::numbers::pi / 2));
  }
  return std::max(0.0, 1 - worst / (std::numbers::pi / 2)) * std::max(0.0, cosine);
}

SmartFaceHandle oppositeFace(const SmartEdgeHandle& edge, FaceHandle face) {
  return edge.h0().face() == face ? edge.h1().face() : edge.h0().face();
}

// A matching of triangles to pairs. The edge between two partners becomes the quad's diagonal. Pairs are chosen
// greedily by quality; augment() and exchange() improve them. An inner vertex keeps at least three edges, since its
// corners would lie on a straight line otherwise.
class TriangleMatching {
 public:
  TriangleMatching(const TriangleMesh& mesh, bool perfect)
      : mesh_(mesh), quality_(mesh.n_edges(), -1.0), diagonal_(mesh.n_faces()), edges_(mesh.n_vertices()) {
    for (const auto v : mesh_.vertices()) edges_[v.idx()] = faceCount(v);
    std::vector<SmartEdgeHandle> candidates;
    for (const auto e : mesh_.edges()) {
      if (e.is_boundary() || mesh_.data(e.h0()).curve_position) continue;
      const double cosine = glm::dot(unit(areaVector(mesh_, e.h0().face())), unit(areaVector(mesh_, e.h1().face())));
      const double quality = quadQuality(
          {mesh_.point(e.v0()), mesh_.point(e.h1().next().to()), mesh_.point(e.v1()), mesh_.point(e.h0().next().to())},
          cosine);
      if (quality < 0.05 && !perfect) continue;
      quality_[e.idx()] = quality;
      candidates.push_back(e);
    }
    // Edges of the same quality are ordered by their triangles' indices.
    auto before = [&](const SmartEdgeHandle& x, const SmartEdgeHandle& y) {
      if (qualityOf(x) != qualityOf(y)) return qualityOf(x) > qualityOf(y);
      const std::pair<int, int> of_x = std::minmax({x.h0().face().idx(), x.h1().face().idx()}),
                                of_y = std::minmax({y.h0().face().idx(), y.h1().face().idx()});
      return of_x < of_y;
    };
    std::sort(candidates.begin(), candidates.end(), before);
    for (const auto& e : candidates) {
      if (unmatched(e.h0().face()) && unmatched(e.h1().face()) && keepsValence(e)) match(e);
    }
  }

  // Augments the matching along alternating paths: an unmatched triangle takes another's partner, and so on up to the
  // next unmatched one. Some odd cycles are passed from the other end only, or not at all. False: no path was found.
  bool augment() {
    Search search{std::vector<SmartHalfedgeHandle>(mesh_.n_faces()), std::vector<uint32_t>(mesh_.n_faces(), 0)};
    bool changed = false;
    for (const auto start : mesh_.faces()) changed |= unmatched(start) && searchFrom(start, search);
    return changed;
  }
  // Lets two neighbouring pairs exchange partners if that raises their quality. False: none did.
  bool exchange();

  // For each triangle; not valid: unmatched.
  std::vector<SmartEdgeHandle> takeDiagonals() { return std::move(diagonal_); }

 private:
  double qualityOf(EdgeHandle e) const { return quality_[e.idx()]; }
  bool unmatched(FaceHandle f) const { return !diagonal_[f.idx()].is_valid(); }
  SmartFaceHandle partner(FaceHandle f) const { return oppositeFace(diagonal_[f.idx()], f); }
  bool keepsValence(const SmartEdgeHandle& e) const {
    auto room = [&](const SmartVertexHandle& v) { return v.is_boundary() || edges_[v.idx()] > 3; };
    return room(e.v0()) && room(e.v1());
  }
  void match(const SmartEdgeHandle& e) {
    diagonal_[e.h0().face().idx()] = diagonal_[e.h1().face().idx()] = e;
    --edges_[e.v0().idx()], --edges_[e.v1().idx()];
  }
  void unmatch(const SmartEdgeHandle& e) {
    diagonal_[e.h0().face().idx()] = diagonal_[e.h1().face().idx()] = SmartEdgeHandle();
    ++edges_[e.v0().idx()], ++edges_[e.v1().idx()];
  }
  // Replaces pairs. False: a vertex would lose too many edges, and nothing was changed.
  bool tryReplace(std::span<const SmartEdgeHandle> old_pairs, std::span<const SmartEdgeHandle> new_pairs) {
    for (const auto& e : old_pairs) unmatch(e);
    size_t joined = 0;
    while (joined < new_pairs.size() && keepsValence(new_pairs[joined])) match(new_pairs[joined++]);
    if (joined == new_pairs.size()) return true;
    for (const auto& e : new_pairs.first(joined)) unmatch(e);
    for (const auto& e : old_pairs) match(e);
    return false;
  }

  // A breadth-first search along alternating paths. reached_over: for each triangle, the half edge over which its
  // partner was reached.
  struct Search {
    std::vector<SmartHalfedgeHandle> reached_over;
    std::vector<uint32_t> visited;
    uint32_t search_id = 0;  // the value in `visited` that stands for this search
  };
  bool searchFrom(FaceHandle start, Search& search);
  // Exchanges the pairs along the path from start to the triangle beyond `end`: each triangle takes the one through
  // which it was reached.
  bool augmentAlong(FaceHandle start, SmartHalfedgeHandle end, const Search& search) {
    std::vector<SmartEdgeHandle> new_pairs{end.edge()}, old_pairs;
    while (end.face() != start) {
      old_pairs.push_back(diagonal_[end.face().idx()]);
      end = search.reached_over[end.face().idx()];
      new_pairs.push_back(end.edge());
    }
    return tryReplace(old_pairs, new_pairs);
  }

  const TriangleMesh& mesh_;
  std::vector<double> quality_;            // for each edge; below 0: it cannot be a diagonal
  std::vector<SmartEdgeHandle> diagonal_;  // for each triangle
  std::vector<uint32_t> edges_;            // edges that remain at each vertex
};

bool TriangleMatching::searchFrom(FaceHandle start, Search& search) {
  constexpr size_t kMaxTriangles = 400;
  const uint32_t search_id = ++search.search_id;
  std::vector<SmartFaceHandle> queue{OpenMesh::make_smart(start, mesh_)};
  search.visited[start.idx()] = search_id;
  for (size_t i = 0; i < queue.size() && queue.size() < kMaxTriangles; ++i) {
    const SmartFaceHandle f = queue[i];
    for (const auto& h : halfedgesOf(f)) {
      if (qualityOf(h.edge()) < 0 || h.edge() == diagonal_[f.idx()]) continue;
      const SmartFaceHandle other = h.opp().face();
      if (search.visited[other.idx()] == search_id) continue;
      if (unmatched(other)) {
        if (augmentAlong(start, h, search)) return true;
        continue;
      }
      const SmartFaceHandle next = partner(other);
      if (search.visited[next.idx()] == search_id) continue;
      search.visited[other.idx()] = search.visited[next.idx()] = search_id;
      search.reached_over[next.idx()] = h;
      queue.push_back(next);
    }
  }
  return false;
}

bool TriangleMatching::exchange() {
  bool changed = false;
  for (const auto a : mesh_.faces()) {
    if (unmatched(a)) continue;
    for (const auto& h : halfedgesOf(a)) {
      const SmartFaceHandle c = h.opp().face();
      if (qualityOf(h.edge()) < 0 || h.edge() == diagonal_[a.idx()] || unmatched(c)) continue;
      const std::array<SmartEdgeHandle, 2> old_diagonals{diagonal_[a.idx()], diagonal_[c.idx()]};
      SmartEdgeHandle between;  // between the partners
      for (const auto g : partner(a).halfedges()) {
        if (g.opp().face() == partner(c)) between = g.edge();
      }
      if (!between.is_valid() || qualityOf(between) <= 0 ||
          qualityOf(h.edge()) + qualityOf(between) <= qualityOf(old_diagonals[0]) + qualityOf(old_diagonals[1]) + 1e-6)
        continue;
      changed |= tryReplace(old_diagonals, std::array{h.edge(), between});
      break;
    }
  }
  return changed;
}

// The diagonal of each triangle's quad.
std::vector<SmartEdgeHandle> pairTriangles(const TriangleMesh& m, bool perfect) {
  TriangleMatching pairs(m, perfect);
  for (int round = 0; round < 4; ++round) {
    const bool longer = pairs.augment(), better = pairs.exchange();
    if (!longer && !better) break;
  }
  return pairs.takeDiagonals();
}

// Moves a corner along its feature curve, between its two neighbours on it.
struct CurveSlider {
  SmartHalfedgeHandle before, after;  // half edges to the neighbours; not valid: the corner must stay
  uint32_t curve = kNoIndex;
  double start = 0, arc_length = 0, end = 0;

  CurveSlider(const QuadMesh& m, const SmartVertexHandle& v) {
    for (const auto h : v.outgoing_halfedges()) {
      const CurvePosition &position = m.data(h).curve_position, &opposite = m.data(h.opp()).curve_position;
      if (!position) continue;
      curve = position.curve;
      arc_length = position.arc_length;
      (opposite.arc_length < arc_length ? before : after) = h;
      (opposite.arc_length < arc_length ? start : end) = opposite.arc_length;
    }
  }
  bool possible() const { return before.is_valid() && after.is_valid(); }
  void move(QuadMesh& m, const FeatureCurve& on, double to) {
    arc_length = m.data(before).curve_position.arc_length = m.data(after).curve_position.arc_length = to;
    m.set_point(before.from(), on.point(to));
  }
};

// The sine of a quad's angle at the origin of the half edge, as seen along the normal there.
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
  auto arc_length = [&](const SmartEdgeHandle& e) {
    return (m.data(e.h0()).curve_position.arc_length + m.data(e.h1()).curve_position.arc_length) / 2;
  };
  auto middleOf = [&](const SmartEdgeHandle& e) {
    VertexHandle& v = middle[e.idx()];
    const CurvePosition& step = m.data(e.h0()).curve_position;
    if (!v.is_valid())
      v = out.add_vertex(step ? curves[step.curve].point(arc_length(e)) : (m.point(e.v0()) + m.point(e.v1())) / 2.0);
    return v;
  };
  for (const auto f : m.faces()) {
    const SmartEdgeHandle& diagonal_edge = diagonal[f.idx()];
    if (diagonal_edge.is_valid() && oppositeFace(diagonal_edge, f) < f) continue;
    std::vector<SmartHalfedgeHandle> sides;  // of the triangle, or of the pair
    for (const auto& h : halfedgesOf(f)) {
      if (h.edge() != diagonal_edge) sides.push_back(h);
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
    const CurvePosition &a = m.data(e.h0()).curve_position, &b = m.data(e.h1()).curve_position;
    if (!a) continue;
    const VertexHandle between = middle[e.idx()];
    if (!split) setCurvePosition(out, e.v0(), e.v1(), a.curve, a.arc_length, b.arc_length);
    if (!split) continue;
    setCurvePosition(out, e.v0(), between, a.curve, a.arc_length, arc_length(e));
    setCurvePosition(out, between, e.v1(), a.curve, arc_length(e), b.arc_length);
  }
  return out;
}

double minSine(const QuadMesh& m, const SmartVertexHandle& corner) {
  double smallest = 1;
  for (const auto f : corner.faces()) {
    for (const auto h : f.halfedges()) smallest = std::min(smallest, sineAt(m, h));
  }
  return smallest;
}

bool isFolded(const QuadMesh& m, const SmartVertexHandle& corner) {
  for (const auto h : corner.outgoing_halfedges()) {
    if (!h.is_boundary() && sineAt(m, h) < 0.02) return true;
  }
  return false;
}

glm::dvec3 ScanSurface::normal(uint32_t t) const {
  return unit(glm::cross(corner(t, 1) - corner(t, 0), corner(t, 2) - corner(t, 0)));
}

SurfacePoint ScanSurface::project(const glm::dvec3& p, const glm::dvec3& n, double reach) const {
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

void relaxQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanSurface& scan, int rounds) {
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
      // The best-fitting square: each corner is rotated back to the first one's position, and they are averaged.
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
      const glm::dvec3 old_position = m.point(v), to = target[v.idx()] / weight[v.idx()];
      if (m.data(v).on_curve) {
        CurveSlider slider(m, v);
        if (!slider.possible()) continue;
        // Moves along the feature curve towards the target, and towards the middle of the two neighbours.
        const glm::dvec3 tangent = unit(m.point(slider.after.to()) - m.point(slider.before.to()));
        const double s = 0.7 * (slider.arc_length + 0.5 * glm::dot(to - old_position, tangent)) +
                         0.3 * (slider.start + slider.end) / 2;
        slider.move(m, curves[slider.curve],
                    std::clamp(s, 0.75 * slider.start + 0.25 * slider.end, 0.25 * slider.start + 0.75 * slider.end));
        continue;
      }
      glm::dvec3 step = 0.6 * (to - old_position);
      step -= m.normal(v) * glm::dot(step, m.normal(v));
      step = m.data(v).free_directions * step;
      const double reach = 2 * faceCount(v) / weight[v.idx()];  // about twice the quads' radius
      const double before = minSine(m, v);
      if (const SurfacePoint hit = scan.project(old_position + step, m.normal(v), reach))
        m.set_point(v, scan.point(hit));
      if (minSine(m, v) < std::min(before, 0.3)) m.set_point(v, old_position);
    }
  }
}

void fitBorderCorners(QuadMesh& m, std::span<const FeatureCurve> curves, std::span<const double> allowed) {
  for (int round = 0; round < 4; ++round) {
    for (const auto v : m.vertices()) {
      if (m.data(v).fixed || !m.data(v).on_curve) continue;
      CurveSlider slider(m, v);
      if (!slider.possible() || !curves[slider.curve].border) continue;
      const FeatureCurve& curve = curves[slider.curve];
      const SmartVertexHandle from = slider.before.to(), to = slider.after.to();
      const CurveEnd before{m.point(from), m.normal(from), slider.start}, after{m.point(to), m.normal(to), slider.end};
      auto deviation = [&](double arc_length) {
        const CurveEnd middle{curve.point(arc_length), m.normal(v), arc_length};
        return std::max(deviationFromSide(curve, before, middle), deviationFromSide(curve, middle, after));
      };
      double best = slider.arc_length, smallest = deviation(best);
      if (smallest <= allowed[slider.curve] / 2) continue;
      const double sine = std::min(minSine(m, v), 0.3);
      for (int k = 0; k <= 16; ++k) {
        const double arc_length = slider.start + (slider.end - slider.start) * (0.25 + 0.5 * k / 16),
                     s = deviation(arc_length);
        if (s >= 0.95 * smallest) continue;
        const glm::dvec3 old_position = m.point(v);
        m.set_point(v, curve.point(arc_length));
        if (minSine(m, v) >= sine) best = arc_length, smallest = s;
        m.set_point(v, old_position);
      }
      slider.move(m, curve, best);
    }
  }
}

void untangleQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanSurface& scan) {
  constexpr double kUntangledSine = 0.3;  // sine of the smallest angle that suffices, 17 degrees
  for (int round = 0; round < 20; ++round) {
    bool moved = false;
    for (const auto v : m.vertices()) {
      double best_sine = minSine(m, v);
      if (m.data(v).fixed || best_sine >= kUntangledSine) continue;
      CurveSlider slider(m, v);
      if (m.data(v).on_curve && !slider.possible()) continue;
      const glm::dvec3 old_position = m.point(v);
      const double arc_length = slider.arc_length;
      // Try positions towards the mean of the neighbours, or on a feature curve towards the middle of its two
      // neighbours.
      glm::dvec3 middle{0};
      double reach = 0;
      for (const auto f : v.faces()) {
        for (const auto c : f.vertices()) {
          if (c == v) continue;
          middle += m.point(c);
          reach = std::max(reach, glm::length(m.point(c) - old_position));
        }
      }
      middle /= 3.0 * faceCount(v);
      glm::dvec3 best = old_position;
      double best_arc_length = arc_length;
      for (double t : {1.0, 0.5, 0.25, 0.1}) {
        if (m.data(v).on_curve) {
          slider.move(m, curves[slider.curve], arc_length + t * ((slider.start + slider.end) / 2 - arc_length));
        } else {
          const SurfacePoint hit = scan.project(old_position + t * (middle - old_position), m.normal(v), reach);
          if (!hit) continue;
          m.set_point(v, scan.point(hit));
        }
        const double sine = minSine(m, v);
        if (sine > best_sine + 1e-3)
          best_sine = sine, best = m.point(v), best_arc_length = slider.arc_length, moved = true;
      }
      if (m.data(v).on_curve) slider.move(m, curves[slider.curve], best_arc_length);
      m.set_point(v, best);
    }
    if (!moved) return;
  }
}

}  // namespace relievo
