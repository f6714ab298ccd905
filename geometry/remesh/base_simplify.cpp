#include "geometry/remesh/base_simplify.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <queue>
#include <vector>

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
  // The plane through q with normal n (or, for n = 0, the point q), with the weight w.
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

// 1: equilateral, 0: without area.
double shapeOf(const Corners& p, double twice_area) {
  auto square = [](const glm::dvec3& d) { return glm::dot(d, d); };
  const double sum = square(p[1] - p[0]) + square(p[2] - p[1]) + square(p[0] - p[2]);
  return sum > 0 ? 2 * std::sqrt(3.0) * twice_area / sum : 0;
}

// Where an edge's ends meet: the vertex that the half edge leaves goes, the one that it ends in stays and moves.
struct Meeting {
  SmartHalfedgeHandle over;
  glm::dvec3 at{0};
  double cost = 0;
};

struct Candidate {
  double cost;
  EdgeHandle edge;
  VertexHandle low, high;  // its ends
  uint32_t stamp;
  bool operator<(const Candidate& o) const {  // the cheapest on top of a std::priority_queue
    if (cost != o.cost) return cost > o.cost;
    return low != o.low ? o.low < low : o.high < high;
  }
};

struct Simplifier {
  TriangleMesh& m;
  const SimplifyOptions& options;
  std::vector<Quadric> quadrics;  // of a vertex
  std::vector<uint32_t> stamp;    // of an edge: its last candidate's
  std::priority_queue<Candidate> queue;
  size_t live;  // triangles
  // How much worse than their surroundings collapses may leave triangles; relaxed when nothing else is left to do.
  double least_turn = 0.3, least_shape = 0.15;
  uint32_t largest_fan = 9;
  double deviation_factor = 1;

  Simplifier(TriangleMesh& mesh, const SimplifyOptions& opts)
      : m(mesh), options(opts), quadrics(m.n_vertices()), stamp(m.n_edges(), 0), live(m.n_faces()) {
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
      for (const auto& h : sidesOf(f)) {
        quadrics[h.from().idx()].add(q);
        if (h.opp().is_boundary()) addBorder(h, normal, weight);
      }
    }
  }

  // The border's own plane, upright on the surface; it counts for more, since no height brings back what it cuts off.
  void addBorder(const SmartHalfedgeHandle& h, const glm::dvec3& normal, double weight) {
    const glm::dvec3 a = m.point(h.from()), out = glm::cross(m.point(h.to()) - a, normal);
    const double length = glm::length(out);
    if (!(length > 0)) return;
    Quadric edge;
    edge.addPlane(out / length, a, 5 * length * length * weight);
    quadrics[h.from().idx()].add(edge);
    quadrics[h.to().idx()].add(edge);
  }

  bool held(const SmartVertexHandle& v) const { return m.data(v).fixed || m.data(v).on_curve || v.is_boundary(); }
  const CurveStep& step(const SmartHalfedgeHandle& h) const { return m.data(h).step; }

  // Nothing: the edge must stay.
  std::optional<Meeting> meetingOf(const SmartEdgeHandle& edge) const {
    // Of two vertices that are alike the first one stays.
    const SmartHalfedgeHandle first = edge.v0() < edge.v1() ? edge.h0() : edge.h1();
    const SmartVertexHandle a = first.from(), b = first.to();
    Quadric q = quadrics[a.idx()];
    q.add(quadrics[b.idx()]);
    const bool hold_a = held(a), hold_b = held(b);
    bool to_a = true;
    glm::dvec3 at;
    if (hold_a || hold_b) {
      to_a = hold_a;
      if (hold_a && hold_b) {
        const bool fixed_a = m.data(a).fixed, fixed_b = m.data(b).fixed;
        if ((fixed_a && fixed_b) || !step(first)) return {};
        to_a = fixed_a || (!fixed_b && q.at(m.point(a)) <= q.at(m.point(b)));
      }
      at = m.point(to_a ? a : b);
    } else if (!q.minimum(at)) {
      at = (m.point(a) + m.point(b)) / 2.0;
    }
    return Meeting{to_a ? first.opp() : first, at, std::max(q.at(at), 0.0)};
  }

  void push(const SmartEdgeHandle& edge) {
    const uint32_t own = ++stamp[edge.idx()];
    if (const auto meeting = meetingOf(edge))
      queue.push({meeting->cost, edge, std::min(edge.v0(), edge.v1()), std::max(edge.v0(), edge.v1()), own});
  }

  // Does the border follow its feature curve still, without the vertex that goes?
  bool follows(const SmartHalfedgeHandle& over) const {
    const CurveStep joint = step(over.opp());
    if (!joint || joint.curve >= options.deviation.size() || !options.curves[joint.curve].border) return true;
    const SmartVertexHandle gone = over.from(), kept = over.to();
    glm::dvec3 n{0};
    for (const auto& v : {kept, gone}) {
      for (const auto f : v.faces()) n += areaVector(m, f);
    }
    n = unit(n);
    for (const auto h : gone.outgoing_halfedges()) {
      if (h == over || step(h).curve != joint.curve) continue;
      if (deviationFromSide(options.curves[joint.curve], {m.point(kept), n, joint.along},
                            {m.point(h.to()), n, step(h.opp()).along}) >
          deviation_factor * options.deviation[joint.curve])
        return false;
    }
    return true;
  }

  // Does the surface stay a surface of the same kind, of a decent shape, with the same feature curves?
  bool allowed(const SmartHalfedgeHandle& over, const glm::dvec3& to) {
    if (!m.is_collapse_ok(over)) return false;  // the link condition (Dey et al. 1999)
    const SmartVertexHandle gone = over.from(), kept = over.to();
    const uint32_t of_gone = facesAround(gone), of_kept = facesAround(kept),
                   fan = of_gone + of_kept - (over.edge().is_boundary() ? 2 : 4);
    if (fan < (gone.is_boundary() || kept.is_boundary() ? 1u : 3u) || fan > std::max({largest_fan, of_gone, of_kept}))
      return false;
    for (const auto& h : {over, over.opp()}) {
      if (h.is_boundary()) continue;
      // The vertex across keeps three triangles (one at a border); and two feature curves do not become one.
      const SmartVertexHandle across = h.next().to();
      if (facesAround(across) <= (across.is_boundary() ? 1u : 3u) || (step(h.next()) && step(h.prev()))) return false;
    }
    for (const auto& v : {gone, kept}) {
      for (const auto f : v.faces()) {
        if (f == over.face() || f == over.opp().face()) continue;
        Corners before, after;
        size_t k = 0;
        for (const auto w : f.vertices()) {
          before[k] = m.point(w);
          after[k++] = w == v ? to : m.point(w);
        }
        const glm::dvec3 was = areaVector(before), is = areaVector(after);
        const double length_was = glm::length(was), length_is = glm::length(is);
        if (glm::dot(was, is) < least_turn * length_is * length_was) return false;
        const double shape = shapeOf(after, length_is);
        if (shape < least_shape && shape < shapeOf(before, length_was)) return false;
      }
    }
    return true;
  }

  void collapse(const SmartHalfedgeHandle& over, const glm::dvec3& to) {
    const SmartVertexHandle gone = over.from(), kept = over.to();
    // The feature curve goes on from the vertex that is kept.
    for (const auto h : gone.outgoing_halfedges()) m.data(h).step.along = step(over.opp()).along;
    // Of the two edges that become one on either side, one at most is on a feature curve: which one OpenMesh keeps does
    // not matter.
    struct Side {
      SmartVertexHandle across;
      CurveStep kept, back;
    };
    std::vector<Side> sides;
    for (const auto& h : {over, over.opp()}) {
      if (h.is_boundary()) continue;
      const SmartHalfedgeHandle back = step(h.next()) ? h.next().opp() : h.prev();
      sides.push_back({back.from(), step(back.opp()), step(back)});
    }
    live -= over.edge().is_boundary() ? 1 : 2;
    quadrics[kept.idx()].add(quadrics[gone.idx()]);
    m.set_point(kept, to);
    m.collapse(over);
    for (const Side& side : sides) {
      const SmartHalfedgeHandle h = m.find_halfedge(kept, side.across);
      m.data(h).step = side.kept;
      m.data(h.opp()).step = side.back;
    }
    for (const auto e : kept.edges()) push(e);
  }

  void run() {
    for (int round = 0; round < 4 && live > options.triangles; ++round) {
      for (const auto e : m.edges()) push(e);
      while (live > options.triangles && !queue.empty()) {
        if (options.interrupted && options.interrupted->load(std::memory_order_relaxed)) return;
        const Candidate c = queue.top();
        queue.pop();
        const SmartEdgeHandle edge = OpenMesh::make_smart(c.edge, m);
        if (edge.deleted() || stamp[c.edge.idx()] != c.stamp) continue;
        const auto meeting = meetingOf(edge);
        if (meeting && follows(meeting->over) && allowed(meeting->over, meeting->at))
          collapse(meeting->over, meeting->at);
      }
      queue = {};
      least_turn = std::max(0.02, least_turn - 0.14);
      least_shape = round < 2 ? least_shape / 4 : 0;
      largest_fan += 6;
      deviation_factor = round < 2 ? 2 * deviation_factor : 1e3;
    }
  }
};

// The edge a b between the triangles a b c and b a d: is c d no rougher, and are its triangles of a better shape? Where
// valences become more even, a fair shape will do.
bool flipLooksBetter(const TriangleMesh& m, const SmartHalfedgeHandle& edge, bool more_even) {
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
  auto badness = [](const SmartVertexHandle& v, int change) {
    const int d = static_cast<int>(v.valence()) + change - (v.is_boundary() ? 4 : 6);
    return d * d;
  };
  for (int round = 0; round < 6; ++round) {
    uint32_t flips = 0;
    for (const auto f : m.faces()) {
      for (size_t k = 0; k < 3; ++k) {
        const SmartHalfedgeHandle side = sidesOf(f)[k], next = side.next();
        const SmartEdgeHandle e = side.edge();
        if (e.is_boundary() || side.opp().face() < f || m.data(side).step || !m.is_flip_ok(e) ||
            e.v0().valence() <= 3 || e.v1().valence() <= 3)
          continue;
        int before = 0, after = 0;
        for (const auto& h : {side, side.opp()}) {
          before += badness(h.from(), 0) + badness(h.next().to(), 0);
          after += badness(h.from(), -1) + badness(h.next().to(), 1);
        }
        if (after > before || !flipLooksBetter(m, side, after < before)) continue;
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
