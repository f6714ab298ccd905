#include "geometry/remesh/base_simplify.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "geometry/remesh/normal_cone.h"

namespace relievo {

namespace {

using Corners = std::array<glm::dvec3, 3>;

// q(p) = p^T A p - 2 b^T p + c
struct Quadric {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  glm::dvec3 b{0};
  double c = 0;

  void add(const Quadric& o) {
    xx += o.xx, xy += o.xy, xz += o.xz, yy += o.yy, yz += o.yz, zz += o.zz;
    b += o.b;
    c += o.c;
  }
  // Adds the plane through q with normal n, weighted by w.
  void addPlane(const glm::dvec3& n, const glm::dvec3& q, double w) {
    const double d = glm::dot(n, q);
    xx += w * n.x * n.x, xy += w * n.x * n.y, xz += w * n.x * n.z, yy += w * n.y * n.y, yz += w * n.y * n.z,
        zz += w * n.z * n.z;
    b += w * d * n;
    c += w * d * d;
  }
  void addPoint(const glm::dvec3& q, double w) {
    xx += w, yy += w, zz += w;
    b += w * q;
    c += w * glm::dot(q, q);
  }
  double at(const glm::dvec3& p) const {
    return p.x * (xx * p.x + 2 * (xy * p.y + xz * p.z)) + p.y * (yy * p.y + 2 * yz * p.z) + zz * p.z * p.z -
           2 * glm::dot(b, p) + c;
  }
  bool minimum(glm::dvec3& p) const {
    const glm::dmat3 a(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    const double trace = xx + yy + zz, det = glm::determinant(a);
    if (!(det > 1e-12 * trace * trace * trace)) return false;
    p = glm::inverse(a) * b;
    return true;
  }
};

// The shape of a triangle: 1 if equilateral, 0 without area.
double shapeOf(const Corners& p, double twice_area) {
  auto square = [](const glm::dvec3& d) { return glm::dot(d, d); };
  const double sum = square(p[1] - p[0]) + square(p[2] - p[1]) + square(p[0] - p[2]);
  return sum > 0 ? 2 * std::sqrt(3.0) * twice_area / sum : 0;
}

// A collapse: the half edge's origin is removed, its end moves to `at`.
struct CollapseTarget {
  SmartHalfedgeHandle halfedge;
  glm::dvec3 at{0};
  double cost = 0;
};

struct CollapseCandidate {
  double cost;
  VertexHandle low, high;  // the edge's ends
  bool operator<(const CollapseCandidate& o) const {
    if (cost != o.cost) return cost < o.cost;
    return low != o.low ? low < o.low : high < o.high;
  }
};

// At most one candidate for each edge; the cheapest comes first. A heap that knows where each edge's is.
class CollapseQueue {
 public:
  explicit CollapseQueue(size_t edges) : place_(edges, kNone), candidates_(edges) {}
  bool empty() const { return heap_.empty(); }
  void set(EdgeHandle edge, const CollapseCandidate& candidate) {
    const auto e = static_cast<uint32_t>(edge.idx());
    candidates_[e] = candidate;
    if (place_[e] == kNone) {
      heap_.push_back(e);
      place_[e] = static_cast<uint32_t>(heap_.size() - 1);
      rise(place_[e]);
    } else {
      rise(place_[e]);
      sink(place_[e]);
    }
  }
  void remove(EdgeHandle edge) {
    const uint32_t at = place_[static_cast<size_t>(edge.idx())];
    if (at == kNone) return;
    place_[heap_[at]] = kNone;
    const uint32_t last = heap_.back();
    heap_.pop_back();
    if (at == heap_.size()) return;
    heap_[at] = last;
    place_[last] = at;
    rise(at);
    sink(place_[last]);
  }
  EdgeHandle takeFirst() {
    const EdgeHandle edge(static_cast<int>(heap_[0]));
    remove(edge);
    return edge;
  }
  void clear() {
    for (uint32_t e : heap_) place_[e] = kNone;
    heap_.clear();
  }

 private:
  static constexpr uint32_t kNone = ~uint32_t{0};
  static constexpr uint32_t kFan = 4;
  bool before(uint32_t a, uint32_t b) const { return candidates_[a] < candidates_[b]; }
  void put(uint32_t at, uint32_t edge) {
    heap_[at] = edge;
    place_[edge] = at;
  }
  void rise(uint32_t at) {
    const uint32_t edge = heap_[at];
    for (; at > 0 && before(edge, heap_[(at - 1) / kFan]); at = (at - 1) / kFan) put(at, heap_[(at - 1) / kFan]);
    put(at, edge);
  }
  void sink(uint32_t at) {
    const uint32_t edge = heap_[at], size = static_cast<uint32_t>(heap_.size());
    for (;;) {
      const uint32_t first = kFan * at + 1;
      if (first >= size) break;
      uint32_t least = first;
      for (uint32_t k = first + 1; k < std::min(first + kFan, size); ++k)
        if (before(heap_[k], heap_[least])) least = k;
      if (!before(heap_[least], edge)) break;
      put(at, heap_[least]);
      at = least;
    }
    put(at, edge);
  }
  std::vector<uint32_t> heap_, place_;  // edges; for each edge its place in the heap
  std::vector<CollapseCandidate> candidates_;
};

Corners cornersAfter(const TriangleMesh& m, const SmartFaceHandle& f, const SmartVertexHandle& moved,
                     const glm::dvec3& to) {
  Corners corners;
  size_t k = 0;
  for (const auto v : f.vertices()) corners[k++] = v == moved ? to : m.point(v);
  return corners;
}

struct Simplifier {
  TriangleMesh& m;
  const SimplifyOptions& options;
  std::vector<Quadric> quadrics;  // for each vertex
  std::vector<NormalCone> cones;  // for each vertex: the normals of the surface that collapsed into it
  CollapseQueue queue;
  size_t live_triangles;  // not yet removed
  // Limits of the triangles around a collapse. They are relaxed when no collapse is left.
  double min_normal_cosine = 0.3, min_shape = 0.15;
  uint32_t max_valence = 9;
  double deviation_factor = 1;

  Simplifier(TriangleMesh& mesh, const SimplifyOptions& opts)
      : m(mesh),
        options(opts),
        quadrics(m.n_vertices()),
        cones(m.n_vertices()),
        queue(m.n_edges()),
        live_triangles(m.n_faces()) {
    const double flat = options.uncertainty * options.uncertainty;
    for (const auto f : m.faces()) {
      const Corners p = pointsOf<3>(m, f);
      const glm::dvec3 cross = areaVector(p);
      const double area = glm::length(cross) / 2;
      if (!(area > 0)) continue;
      const glm::dvec3 normal = cross / (2 * area), centre = (p[0] + p[1] + p[2]) / 3.0;
      double weight = 1;
      if (!options.weight.empty()) {
        float sum = 0;
        for (const auto v : f.vertices()) sum += options.weight[v.idx()];
        weight = sum / 3.0;
      }
      Quadric q;
      q.addPlane(normal, centre, area * weight / 3);
      q.addPoint(centre, flat * area * weight / 3);
      for (const auto& h : halfedgesOf(f)) {
        quadrics[h.from().idx()].add(q);
        cones[h.from().idx()].add({normal, 0});
        if (h.opp().is_boundary()) addBorder(h, normal, weight);
      }
    }
  }

  // Adds the plane through a border edge that is perpendicular to the surface. It has a large weight, since heights
  // cannot restore what it cuts off.
  void addBorder(const SmartHalfedgeHandle& h, const glm::dvec3& normal, double weight) {
    const glm::dvec3 a = m.point(h.from()), out = glm::cross(m.point(h.to()) - a, normal);
    const double length = glm::length(out);
    if (!(length > 0)) return;
    Quadric edge;
    edge.addPlane(out / length, a, 5 * length * length * weight);
    quadrics[h.from().idx()].add(edge);
    quadrics[h.to().idx()].add(edge);
  }

  bool constrained(const SmartVertexHandle& v) const {
    return m.data(v).fixed || m.data(v).on_curve || v.is_boundary();
  }
  const CurvePosition& curvePosition(const SmartHalfedgeHandle& h) const { return m.data(h).curve_position; }

  // The cheapest collapse of an edge, or nothing if it must stay.
  std::optional<CollapseTarget> collapseTargetOf(const SmartEdgeHandle& edge) const {
    // If both ends are alike, the first one stays.
    const SmartHalfedgeHandle first = edge.v0() < edge.v1() ? edge.h0() : edge.h1();
    const SmartVertexHandle a = first.from(), b = first.to();
    Quadric q = quadrics[a.idx()];
    q.add(quadrics[b.idx()]);
    const bool constrained_a = constrained(a), constrained_b = constrained(b);
    bool to_a = true;
    glm::dvec3 at;
    if (constrained_a || constrained_b) {
      to_a = constrained_a;
      if (constrained_a && constrained_b) {
        const bool fixed_a = m.data(a).fixed, fixed_b = m.data(b).fixed;
        if ((fixed_a && fixed_b) || !curvePosition(first)) return {};
        to_a = fixed_a || (!fixed_b && q.at(m.point(a)) <= q.at(m.point(b)));
      }
      at = m.point(to_a ? a : b);
    } else if (!q.minimum(at)) {
      at = (m.point(a) + m.point(b)) / 2.0;
    }
    const SmartHalfedgeHandle collapsed = to_a ? first.opp() : first;
    return CollapseTarget{collapsed, at, std::max(q.at(at), 0.0) * foldPenalty(collapsed, at)};
  }

  // The factor by which a collapse costs more because triangles around it would turn far away from the surface that
  // they stand for: over them it is no function of heights any more (Lee, Moreton, Hoppe 2000, section 4.2). 1 where a
  // feature curve keeps the two sides of a crease apart.
  double foldPenalty(const SmartHalfedgeHandle& halfedge, const glm::dvec3& to) const {
    constexpr double kFree = 80 * std::numbers::pi / 180, kTenfold = 60 * std::numbers::pi / 180;
    if (!options.follow_folds || constrained(halfedge.to())) return 1;
    NormalCone cone = cones[halfedge.from().idx()];
    cone.add(cones[halfedge.to().idx()]);
    double largest_angle = 0;
    for (const auto& v : {halfedge.from(), halfedge.to()}) {
      for (const auto f : v.faces()) {
        if (f == halfedge.face() || f == halfedge.opp().face()) continue;
        const glm::dvec3 area = areaVector(cornersAfter(m, f, v, to));
        const double length = glm::length(area);
        if (length > 0) largest_angle = std::max(largest_angle, cone.largestAngle(area / length));
      }
    }
    return std::pow(10.0, std::max(0.0, (largest_angle - kFree) / kTenfold));
  }

  void push(const SmartEdgeHandle& edge) {
    if (const auto target = collapseTargetOf(edge))
      queue.set(edge, {target->cost, std::min(edge.v0(), edge.v1()), std::max(edge.v0(), edge.v1())});
    else queue.remove(edge);
  }

  // Is the border's deviation from its feature curve still allowed without the removed vertex?
  bool keepsBorder(const SmartHalfedgeHandle& halfedge) const {
    const CurvePosition curve_position = curvePosition(halfedge.opp());
    if (!curve_position || curve_position.curve >= options.allowed_deviation.size() ||
        !options.curves[curve_position.curve].border)
      return true;
    const SmartVertexHandle removed = halfedge.from(), kept = halfedge.to();
    glm::dvec3 n{0};
    for (const auto& v : {kept, removed}) {
      for (const auto f : v.faces()) n += areaVector(m, f);
    }
    n = unit(n);
    for (const auto h : removed.outgoing_halfedges()) {
      if (h == halfedge || curvePosition(h).curve != curve_position.curve) continue;
      if (deviationFromSide(options.curves[curve_position.curve], {m.point(kept), n, curve_position.arc_length},
                            {m.point(h.to()), n, curvePosition(h.opp()).arc_length}) >
          deviation_factor * options.allowed_deviation[curve_position.curve])
        return false;
    }
    return true;
  }

  // Does the surface keep its topology, shape and feature curves?
  bool allowed(const SmartHalfedgeHandle& halfedge, const glm::dvec3& to) {
    if (!m.is_collapse_ok(halfedge)) return false;  // the link condition (Dey et al. 1999)
    const SmartVertexHandle removed = halfedge.from(), kept = halfedge.to();
    const uint32_t removed_faces = faceCount(removed), kept_faces = faceCount(kept),
                   valence = removed_faces + kept_faces - (halfedge.edge().is_boundary() ? 2 : 4);
    if (valence < (removed.is_boundary() || kept.is_boundary() ? 1u : 3u) ||
        valence > std::max({max_valence, removed_faces, kept_faces}))
      return false;
    for (const auto& h : {halfedge, halfedge.opp()}) {
      if (h.is_boundary()) continue;
      // The opposite vertex keeps three triangles (one at a border), and two feature curves may not merge.
      const SmartVertexHandle across = h.next().to();
      if (faceCount(across) <= (across.is_boundary() ? 1u : 3u) || (curvePosition(h.next()) && curvePosition(h.prev())))
        return false;
    }
    for (const auto& v : {removed, kept}) {
      for (const auto f : v.faces()) {
        if (f == halfedge.face() || f == halfedge.opp().face()) continue;
        const Corners before = pointsOf<3>(m, f), after = cornersAfter(m, f, v, to);
        const glm::dvec3 old_area = areaVector(before), new_area = areaVector(after);
        const double old_length = glm::length(old_area), new_length = glm::length(new_area);
        if (glm::dot(old_area, new_area) < min_normal_cosine * new_length * old_length) return false;
        const double shape = shapeOf(after, new_length);
        if (shape < min_shape && shape < shapeOf(before, old_length)) return false;
      }
    }
    return true;
  }

  void collapse(const SmartHalfedgeHandle& halfedge, const glm::dvec3& to) {
    const SmartVertexHandle removed = halfedge.from(), kept = halfedge.to();
    // The kept vertex takes over the feature curve.
    for (const auto h : removed.outgoing_halfedges())
      m.data(h).curve_position.arc_length = curvePosition(halfedge.opp()).arc_length;
    // Two edges merge into one on either side. At most one of them is on a feature curve, and OpenMesh may keep either.
    struct Side {
      SmartVertexHandle across;
      CurvePosition kept, back;
    };
    std::vector<Side> sides;
    for (const auto& h : {halfedge, halfedge.opp()}) {
      if (h.is_boundary()) continue;
      const SmartHalfedgeHandle back = curvePosition(h.next()) ? h.next().opp() : h.prev();
      sides.push_back({back.from(), curvePosition(back.opp()), curvePosition(back)});
    }
    live_triangles -= halfedge.edge().is_boundary() ? 1 : 2;
    quadrics[kept.idx()].add(quadrics[removed.idx()]);
    cones[kept.idx()].add(cones[removed.idx()]);
    m.set_point(kept, to);
    m.collapse(halfedge);
    for (const Side& side : sides) {
      const SmartHalfedgeHandle h = m.find_halfedge(kept, side.across);
      m.data(h).curve_position = side.kept;
      m.data(h.opp()).curve_position = side.back;
    }
    for (const auto e : kept.edges()) push(e);
  }

  void run() {
    for (int round = 0; round < 4 && live_triangles > options.triangles; ++round) {
      for (const auto e : m.edges()) push(e);
      while (live_triangles > options.triangles && !queue.empty()) {
        if (options.interrupted && options.interrupted->load(std::memory_order_relaxed)) return;
        const SmartEdgeHandle edge = OpenMesh::make_smart(queue.takeFirst(), m);
        if (edge.deleted()) continue;
        const auto target = collapseTargetOf(edge);
        if (target && keepsBorder(target->halfedge) && allowed(target->halfedge, target->at))
          collapse(target->halfedge, target->at);
      }
      queue.clear();
      min_normal_cosine = std::max(0.02, min_normal_cosine - 0.14);
      min_shape = round < 2 ? min_shape / 4 : 0;
      max_valence += 6;
      deviation_factor = round < 2 ? 2 * deviation_factor : 1e3;
    }
  }
};

// Compares the edge a b between the triangles a b c and b a d with the edge c d: is c d no rougher, and are its
// triangles better shaped? If valences get more even, a fair shape is enough.
bool flipImproves(const TriangleMesh& m, const SmartHalfedgeHandle& edge, bool more_even) {
  const glm::dvec3 a = m.point(edge.from()), b = m.point(edge.to()), c = m.point(edge.next().to()),
                   d = m.point(edge.opp().next().to());
  const Corners triangles[4] = {pointsOf<3>(m, edge.face()), pointsOf<3>(m, edge.opp().face()), {a, d, c}, {d, b, c}};
  glm::dvec3 n[4];
  double shape[4];
  for (int i = 0; i < 4; ++i) {
    n[i] = areaVector(triangles[i]);
    shape[i] = shapeOf(triangles[i], glm::length(n[i]));
    n[i] = unit(n[i]);
  }
  const glm::dvec3 mean = glm::normalize(n[0] + n[1] + glm::dvec3(1e-30));
  const double worst_before = std::min(shape[0], shape[1]), worst_after = std::min(shape[2], shape[3]);
  if (glm::dot(n[0], n[1]) < 0.7 || glm::dot(n[2], mean) < 0.7 || glm::dot(n[3], mean) < 0.7) return false;
  return more_even ? worst_after >= std::min(0.6 * worst_before, 0.5) : worst_after > worst_before + 0.05;
}

}  // namespace

void simplify(TriangleMesh& mesh, const SimplifyOptions& options) {
  Simplifier(mesh, options).run();
  mesh = compacted(mesh);
}

void flipEdges(TriangleMesh& m) {
  auto valenceError = [](const SmartVertexHandle& v, int change) {
    const int d = static_cast<int>(v.valence()) + change - (v.is_boundary() ? 4 : 6);
    return d * d;
  };
  for (int round = 0; round < 6; ++round) {
    uint32_t flips = 0;
    for (const auto f : m.faces()) {
      for (size_t k = 0; k < 3; ++k) {
        const SmartHalfedgeHandle side = halfedgesOf(f)[k], next = side.next();
        const SmartEdgeHandle e = side.edge();
        if (e.is_boundary() || side.opp().face() < f || m.data(side).curve_position || !m.is_flip_ok(e) ||
            e.v0().valence() <= 3 || e.v1().valence() <= 3)
          continue;
        int before = 0, after = 0;
        for (const auto& h : {side, side.opp()}) {
          before += valenceError(h.from(), 0) + valenceError(h.next().to(), 0);
          after += valenceError(h.from(), -1) + valenceError(h.next().to(), 1);
        }
        if (after > before || !flipImproves(m, side, after < before)) continue;
        const SmartHalfedgeHandle to_first = side.prev();  // the triangles are then a d c and d b c
        m.flip(e);
        m.set_halfedge_handle(to_first.face(), to_first);
        m.set_halfedge_handle(next.face(), next.next());
        ++flips;
      }
    }
    if (flips == 0) break;
  }
}

}  // namespace relievo
