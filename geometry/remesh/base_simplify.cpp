#include "geometry/remesh/base_simplify.h"

#include <algorithm>
#include <cmath>
#include <queue>

namespace relievo {

namespace {

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

glm::dvec3 crossOf(const EditMesh& m, const Triangle& t, uint32_t moved_a, uint32_t moved_b, const glm::dvec3& to) {
  auto at = [&](uint32_t v) { return v == moved_a || v == moved_b ? to : m.points[v]; };
  const glm::dvec3 p = at(t[0]);
  return glm::cross(at(t[1]) - p, at(t[2]) - p);
}

// 1: equilateral, 0: without area.
double shapeOf(const EditMesh& m, const Triangle& t, uint32_t moved_a, uint32_t moved_b, const glm::dvec3& to,
               double twice_area) {
  auto at = [&](uint32_t v) { return v == moved_a || v == moved_b ? to : m.points[v]; };
  auto square = [](const glm::dvec3& d) { return glm::dot(d, d); };
  const double sum = square(at(t[1]) - at(t[0])) + square(at(t[2]) - at(t[1])) + square(at(t[0]) - at(t[2]));
  return sum > 0 ? 2 * std::sqrt(3.0) * twice_area / sum : 0;
}

bool has(const Triangle& t, uint32_t v) { return t[0] == v || t[1] == v || t[2] == v; }

struct Collapse {
  double cost;
  uint32_t a, b;  // a < b; b goes
  uint32_t stamp_a, stamp_b;
  bool operator<(const Collapse& o) const {  // the cheapest on top of a std::priority_queue
    if (cost != o.cost) return cost > o.cost;
    return a != o.a ? a > o.a : b > o.b;
  }
};

struct Simplifier {
  EditMesh& m;
  const SimplifyOptions& options;
  std::vector<Quadric> quadrics;
  std::vector<uint32_t> stamp;
  std::priority_queue<Collapse> queue;
  // How much worse than their surroundings collapses may leave triangles; relaxed when nothing else is left to do.
  double least_turn = 0.3, least_shape = 0.15;
  size_t largest_fan = 9;
  double deviation_factor = 1;
  std::vector<uint32_t> around_a, around_b;

  Simplifier(EditMesh& mesh, const SimplifyOptions& opts)
      : m(mesh), options(opts), quadrics(m.points.size()), stamp(m.points.size(), 0) {
    const double flat = options.uncertainty * options.uncertainty;
    for (const Triangle& t : m.triangles) {
      if (t[0] == kNoIndex) continue;
      const glm::dvec3 cross = glm::cross(m.points[t[1]] - m.points[t[0]], m.points[t[2]] - m.points[t[0]]);
      const double area = glm::length(cross) / 2;
      if (!(area > 0)) continue;
      const glm::dvec3 normal = cross / (2 * area), centre = (m.points[t[0]] + m.points[t[1]] + m.points[t[2]]) / 3.0;
      double weight = 1;
      if (!options.weight.empty()) weight = (options.weight[t[0]] + options.weight[t[1]] + options.weight[t[2]]) / 3.0;
      Quadric q;
      q.addPlane(normal, centre, area * weight / 3);
      q.addPoint(centre, flat * area * weight / 3);
      for (int k = 0; k < 3; ++k) {
        quadrics[t[k]].add(q);
        // The border's own plane, upright on the surface; it counts for more, since no height brings back what it cuts
        // off.
        std::array<uint32_t, 2> found;
        const uint32_t a = t[k], b = t[(k + 1) % 3];
        if (m.border[a] && m.border[b] && m.sharing(a, b, found) == 1) {
          const glm::dvec3 side = m.points[b] - m.points[a], out = glm::cross(side, normal);
          const double length = glm::length(out);
          if (!(length > 0)) continue;
          Quadric edge;
          edge.addPlane(out / length, m.points[a], 5 * length * length * weight);
          quadrics[a].add(edge);
          quadrics[b].add(edge);
        }
      }
    }
  }

  bool held(uint32_t v) const { return m.fixed[v] || m.border[v] || !m.steps[v].empty(); }

  // Where both ends go, and at what cost; false: the edge must stay.
  bool evaluate(uint32_t a, uint32_t b, glm::dvec3& to, double& cost) const {
    Quadric q = quadrics[a];
    q.add(quadrics[b]);
    const bool hold_a = held(a), hold_b = held(b);
    if (hold_a && hold_b) {
      if ((m.fixed[a] && m.fixed[b]) || !m.step(a, b)) return false;
      const bool to_a = m.fixed[a] || (!m.fixed[b] && q.at(m.points[a]) <= q.at(m.points[b]));
      to = m.points[to_a ? a : b];
    } else if (hold_a || hold_b) {
      to = m.points[hold_a ? a : b];
    } else if (!q.minimum(to)) {
      to = (m.points[a] + m.points[b]) / 2.0;
    }
    cost = std::max(q.at(to), 0.0);
    return true;
  }

  void push(uint32_t a, uint32_t b) {
    if (a > b) std::swap(a, b);
    glm::dvec3 to;
    double cost;
    if (evaluate(a, b, to, cost)) queue.push({cost, a, b, stamp[a], stamp[b]});
  }

  void neighbours(uint32_t v, std::vector<uint32_t>& out) const {
    out.clear();
    for (uint32_t t : m.fans[v]) {
      for (uint32_t w : m.triangles[t]) {
        if (w != v) out.push_back(w);
      }
    }
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
  }

  glm::dvec3 normalAround(uint32_t a, uint32_t b) const {
    glm::dvec3 sum{0};
    for (uint32_t v : {a, b}) {
      for (uint32_t t : m.fans[v]) sum += crossOf(m, m.triangles[t], kNoIndex, kNoIndex, {});
    }
    const double length = glm::length(sum);
    return length > 0 ? sum / length : glm::dvec3(0);
  }

  // Does the border follow its feature curve still, without the vertex that goes?
  bool follows(uint32_t kept, uint32_t gone) const {
    const CurveStep* joint = m.step(kept, gone);
    if (!joint || joint->curve >= options.deviation.size() || !options.curves[joint->curve].border) return true;
    for (const CurveStep& s : m.steps[gone]) {
      const CurveStep* back = m.step(s.to, gone);
      if (s.to == kept || s.curve != joint->curve || !back) continue;
      const glm::dvec3 n = normalAround(kept, gone);
      if (deviationFromSide(options.curves[s.curve], {m.points[kept], n, joint->along},
                            {m.points[s.to], n, back->along}) > deviation_factor * options.deviation[s.curve])
        return false;
    }
    return true;
  }

  // Does the surface stay a surface of the same kind (the link condition, Dey et al. 1999), and of a decent shape?
  bool allowed(uint32_t a, uint32_t b, const glm::dvec3& to) {
    std::array<uint32_t, 2> found;
    const uint32_t sides = m.sharing(a, b, found);
    if (sides == 0 || (m.border[a] && m.border[b] && sides != 1)) return false;
    neighbours(a, around_a);
    neighbours(b, around_b);
    uint32_t common = 0;
    for (size_t i = 0, j = 0; i < around_a.size() && j < around_b.size();) {
      if (around_a[i] == around_b[j]) {
        ++common, ++i, ++j;
      } else if (around_a[i] < around_b[j]) {
        ++i;
      } else {
        ++j;
      }
    }
    if (common != sides) return false;
    const size_t fan = m.fans[a].size() + m.fans[b].size() - 2 * sides;
    if (fan < (m.border[a] || m.border[b] ? 1u : 3u) ||
        fan > std::max({largest_fan, m.fans[a].size(), m.fans[b].size()}))
      return false;
    for (uint32_t t : m.fans[b]) {
      Triangle x = m.triangles[t];
      if (has(x, a)) continue;
      std::replace(x.begin(), x.end(), b, a);
      std::sort(x.begin(), x.end());
      for (uint32_t o : m.fans[a]) {
        Triangle y = m.triangles[o];
        std::sort(y.begin(), y.end());
        if (x == y) return false;
      }
    }
    // The vertex across keeps three triangles (one at a border); and two feature curves do not become one.
    for (uint32_t k = 0; k < sides; ++k) {
      for (uint32_t w : m.triangles[found[k]]) {
        if (w == a || w == b) continue;
        if (m.fans[w].size() <= (m.border[w] ? 1u : 3u) || (m.step(a, w) && m.step(b, w))) return false;
      }
    }
    for (uint32_t v : {a, b}) {
      for (uint32_t t : m.fans[v]) {
        const Triangle& x = m.triangles[t];
        if (has(x, a) && has(x, b)) continue;
        const glm::dvec3 before = crossOf(m, x, kNoIndex, kNoIndex, to), after = crossOf(m, x, a, b, to);
        const double la = glm::length(after), lb = glm::length(before);
        if (glm::dot(before, after) < least_turn * la * lb) return false;
        const double shape = shapeOf(m, x, a, b, to, la);
        if (shape < least_shape && shape < shapeOf(m, x, kNoIndex, kNoIndex, to, lb)) return false;
      }
    }
    return true;
  }

  // b goes; a takes its place on their feature curve.
  void joinCurves(uint32_t a, uint32_t b) {
    const CurveStep* joint = m.step(a, b);
    if (joint) {
      const CurveStep was = *joint;
      for (const CurveStep& s : m.steps[b]) {
        if (s.to == a) continue;
        m.steps[a].push_back({s.to, s.curve, was.along});
        for (CurveStep& back : m.steps[s.to]) {
          if (back.to == b && back.curve == s.curve) back.to = a;
        }
      }
      std::erase_if(m.steps[a], [&](const CurveStep& s) { return s.to == b; });
    }
    m.steps[b].clear();
  }

  void collapse(uint32_t a, uint32_t b, const glm::dvec3& to) {
    std::array<uint32_t, 2> found;
    const uint32_t sides = m.sharing(a, b, found);
    for (uint32_t k = 0; k < sides; ++k) {
      const Triangle x = m.triangles[found[k]];
      for (uint32_t w : x) std::erase(m.fans[w], found[k]);
      m.triangles[found[k]] = {kNoIndex, kNoIndex, kNoIndex};
      --m.live;
    }
    for (uint32_t t : m.fans[b]) {
      std::replace(m.triangles[t].begin(), m.triangles[t].end(), b, a);
      m.fans[a].push_back(t);
    }
    m.fans[b].clear();
    joinCurves(a, b);
    m.points[a] = to;
    m.border[a] |= m.border[b];
    quadrics[a].add(quadrics[b]);
    ++stamp[a], ++stamp[b];
    neighbours(a, around_a);
    for (uint32_t w : around_a) push(a, w);
  }

  void run() {
    for (int round = 0; round < 4 && m.live > options.triangles; ++round) {
      for (uint32_t v = 0; v < m.points.size(); ++v) {
        if (m.fans[v].empty()) continue;
        neighbours(v, around_a);
        for (uint32_t w : around_a) {
          if (v < w) push(v, w);
        }
      }
      while (m.live > options.triangles && !queue.empty()) {
        if (options.interrupted && options.interrupted->load(std::memory_order_relaxed)) return;
        const Collapse c = queue.top();
        queue.pop();
        if (stamp[c.a] != c.stamp_a || stamp[c.b] != c.stamp_b) continue;
        glm::dvec3 to;
        double cost;
        if (!evaluate(c.a, c.b, to, cost)) continue;
        uint32_t kept = c.a, gone = c.b;
        if (held(c.b) && to == m.points[c.b]) std::swap(kept, gone);  // a place on a feature curve keeps its vertex
        if (follows(kept, gone) && allowed(c.a, c.b, to)) collapse(kept, gone, to);
      }
      queue = {};
      least_turn = std::max(0.02, least_turn - 0.14);
      least_shape = round < 2 ? least_shape / 4 : 0;
      largest_fan += 6;
      deviation_factor = round < 2 ? 2 * deviation_factor : 1e3;
    }
  }
};

}  // namespace

EditMesh::EditMesh(const Surface& s, const FeatureCurves& curves)
    : points(s.points.begin(), s.points.end()),
      triangles(s.triangles),
      fans(s.points.size()),
      border(s.points.size(), 0),
      fixed(curves.fixed),
      steps(curves.steps),
      live(static_cast<uint32_t>(s.triangles.size())) {
  for (uint32_t t = 0; t < triangles.size(); ++t) {
    for (uint32_t v : triangles[t]) fans[v].push_back(t);
  }
  for (const auto& loop : s.loops) {
    for (uint32_t v : loop) border[v] = 1;
  }
}

const CurveStep* EditMesh::step(uint32_t a, uint32_t b) const {
  for (const CurveStep& s : steps[a]) {
    if (s.to == b) return &s;
  }
  return nullptr;
}

uint32_t EditMesh::sharing(uint32_t a, uint32_t b, std::array<uint32_t, 2>& found) const {
  uint32_t n = 0;
  for (uint32_t t : fans[a]) {
    if (has(triangles[t], b) && n < 2) found[n++] = t;
  }
  return n;
}

void simplify(EditMesh& mesh, const SimplifyOptions& options) { Simplifier(mesh, options).run(); }

void flipEdges(EditMesh& m) {
  auto wanted = [&](uint32_t v) { return m.border[v] ? 4 : 6; };
  // A border vertex has one neighbour more than triangles.
  auto valence = [&](uint32_t v) { return static_cast<int>(m.fans[v].size()) + (m.border[v] ? 1 : 0); };
  auto badness = [&](uint32_t v, int change) {
    const int d = valence(v) + change - wanted(v);
    return d * d;
  };
  for (int round = 0; round < 6; ++round) {
    uint32_t flips = 0;
    for (uint32_t t = 0; t < m.triangles.size(); ++t) {
      for (int k = 0; k < 3 && m.triangles[t][0] != kNoIndex; ++k) {
        const uint32_t a = m.triangles[t][k], b = m.triangles[t][(k + 1) % 3], c = m.triangles[t][(k + 2) % 3];
        std::array<uint32_t, 2> found;
        if (m.sharing(a, b, found) != 2 || m.step(a, b)) continue;
        const uint32_t other = found[0] == t ? found[1] : found[0];
        uint32_t d = kNoIndex;
        for (uint32_t w : m.triangles[other]) {
          if (w != a && w != b) d = w;
        }
        if (other < t || d == c || valence(a) <= 3 || valence(b) <= 3) continue;
        std::array<uint32_t, 2> unused;
        if (m.sharing(c, d, unused) != 0) continue;
        const int before = badness(a, 0) + badness(b, 0) + badness(c, 0) + badness(d, 0);
        const int after = badness(a, -1) + badness(b, -1) + badness(c, 1) + badness(d, 1);
        if (after > before) continue;
        const Triangle was[2] = {m.triangles[t], m.triangles[other]}, now[2] = {{a, d, c}, {d, b, c}};
        glm::dvec3 n[4];
        double shape[4];
        for (int i = 0; i < 4; ++i) {
          const Triangle& x = i < 2 ? was[i] : now[i - 2];
          n[i] = crossOf(m, x, kNoIndex, kNoIndex, {});
          const double length = glm::length(n[i]);
          shape[i] = shapeOf(m, x, kNoIndex, kNoIndex, {}, length);
          n[i] = length > 0 ? n[i] / length : glm::dvec3(0);
        }
        const glm::dvec3 mean = glm::normalize(n[0] + n[1] + glm::dvec3(1e-30));
        const double worst_before = std::min(shape[0], shape[1]), worst_after = std::min(shape[2], shape[3]);
        if (glm::dot(n[0], n[1]) < 0.7 || glm::dot(n[2], mean) < 0.7 || glm::dot(n[3], mean) < 0.7) continue;
        if (after == before ? worst_after <= worst_before + 0.05 : worst_after < std::min(0.6 * worst_before, 0.5))
          continue;
        for (int i = 0; i < 2; ++i) {
          for (uint32_t w : was[i]) std::erase(m.fans[w], i ? other : t);
        }
        m.triangles[t] = now[0];
        m.triangles[other] = now[1];
        for (int i = 0; i < 2; ++i) {
          for (uint32_t w : now[i]) m.fans[w].push_back(i ? other : t);
        }
        ++flips;
      }
    }
    if (flips == 0) break;
  }
}

}  // namespace relievo
