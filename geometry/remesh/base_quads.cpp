#include "geometry/remesh/base_quads.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

namespace relievo {

namespace {

glm::dvec3 unit(const glm::dvec3& v) {
  const double length = glm::length(v);
  return length > 0 ? v / length : glm::dvec3(0);
}

// 1: all right angles and flat; 0: an angle of 180 degrees or folded (Remacle et al. 2012, Blossom-Quad, eq. 2).
double quadQuality(const std::array<glm::dvec3, 4>& p, double fold) {
  double worst = 0;
  for (int k = 0; k < 4; ++k) {
    const glm::dvec3 a = unit(p[(k + 1) % 4] - p[k]), b = unit(p[(k + 3) % 4] - p[k]);
    worst = std::max(worst, std::abs(std::acos(std::clamp(glm::dot(a, b), -1.0, 1.0)) - std::numbers::pi / 2));
  }
  return std::max(0.0, 1 - worst / (std::numbers::pi / 2)) * std::max(0.0, fold);
}

struct Pair {
  double quality;
  uint32_t a, b;  // triangles
};

// Triangles in pairs: the best first, then better by what augment() and exchange() find. A vertex inside keeps three
// edges, or corners would lie on a straight line.
class TrianglePairs {
 public:
  TrianglePairs(const EditMesh& mesh, bool all_wanted)
      : mesh_(mesh),
        across_(mesh.triangles.size()),
        partner_(mesh.triangles.size(), kNoIndex),
        edges_(mesh.points.size()) {
    for (size_t v = 0; v < edges_.size(); ++v) edges_[v] = static_cast<int>(mesh_.fans[v].size());
    for (const Pair& p : candidates(all_wanted)) {
      if (partner_[p.a] == kNoIndex && partner_[p.b] == kNoIndex && roomFor(p.a, p.b)) join(p.a, p.b);
    }
  }

  // A free triangle takes another's partner, and so on to the next free one; short paths first. Those odd cycles that a
  // search by triangles cannot pass are found from the other end, or not at all. False: none was found.
  bool augment();
  // Two pairs that lie side by side exchange partners where that is better. False: none did.
  bool exchange();

  std::vector<uint32_t> takePartners() { return std::move(partner_); }  // of each triangle; kNoIndex: none

 private:
  std::vector<Pair> candidates(bool all_wanted);  // best first; fills across_

  std::array<uint32_t, 2> sharedEdge(uint32_t a, uint32_t b) const {
    std::array<uint32_t, 2> e{kNoIndex, kNoIndex};
    int n = 0;
    for (uint32_t v : mesh_.triangles[a]) {
      const Triangle& y = mesh_.triangles[b];
      if (n < 2 && (y[0] == v || y[1] == v || y[2] == v)) e[n++] = v;
    }
    return e;
  }
  void change(uint32_t a, uint32_t b, int by) {
    for (uint32_t v : sharedEdge(a, b)) edges_[v] += by;
  }
  bool roomFor(uint32_t a, uint32_t b) const {
    for (uint32_t v : sharedEdge(a, b)) {
      if (!mesh_.border[v] && edges_[v] <= 3) return false;
    }
    return true;
  }
  void join(uint32_t a, uint32_t b) {
    partner_[a] = b;
    partner_[b] = a;
    change(a, b, -1);
  }
  void part(uint32_t a) {
    const uint32_t b = partner_[a];
    partner_[a] = partner_[b] = kNoIndex;
    change(a, b, 1);
  }
  double qualityOf(uint32_t a, uint32_t b) const {
    for (auto [o, q] : across_[a]) {
      if (o == b) return q;
    }
    return 0.0;
  }

  // A breadth-first search of alternating paths: for each triangle reached, the one that it was reached from.
  struct Search {
    std::vector<uint32_t> from, seen;
    uint32_t number = 0;  // what `seen` holds for triangles of this search
  };
  bool searchFrom(uint32_t start, Search& search);
  // The path start ... t, end: each triangle joins the one that it was reached through. False, and nothing is changed,
  // where a vertex has no room.
  bool turnOver(uint32_t start, uint32_t t, uint32_t end, const Search& search);

  const EditMesh& mesh_;
  std::vector<std::vector<std::pair<uint32_t, double>>> across_;  // partners and qualities
  std::vector<uint32_t> partner_;
  std::vector<int> edges_;  // left at a vertex
};

std::vector<Pair> TrianglePairs::candidates(bool all_wanted) {
  std::vector<Pair> pairs;
  for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
    const Triangle& x = mesh_.triangles[t];
    if (x[0] == kNoIndex) continue;
    const glm::dvec3 nt =
        unit(glm::cross(mesh_.points[x[1]] - mesh_.points[x[0]], mesh_.points[x[2]] - mesh_.points[x[0]]));
    for (int k = 0; k < 3; ++k) {
      const uint32_t a = x[k], b = x[(k + 1) % 3], c = x[(k + 2) % 3];
      std::array<uint32_t, 2> found;
      if (mesh_.sharing(a, b, found) != 2 || mesh_.step(a, b)) continue;
      const uint32_t other = found[0] == t ? found[1] : found[0];
      uint32_t d = kNoIndex;
      for (uint32_t w : mesh_.triangles[other]) {
        if (w != a && w != b) d = w;
      }
      if (d == c || d == kNoIndex) continue;
      const Triangle& y = mesh_.triangles[other];
      const glm::dvec3 no =
          unit(glm::cross(mesh_.points[y[1]] - mesh_.points[y[0]], mesh_.points[y[2]] - mesh_.points[y[0]]));
      const double quality =
          quadQuality({mesh_.points[a], mesh_.points[d], mesh_.points[b], mesh_.points[c]}, glm::dot(nt, no));
      if (quality < 0.05 && !all_wanted) continue;
      across_[t].push_back({other, quality});
      if (t < other) pairs.push_back({quality, t, other});
    }
  }
  std::sort(pairs.begin(), pairs.end(), [](const Pair& x, const Pair& y) {
    if (x.quality != y.quality) return x.quality > y.quality;
    return x.a != y.a ? x.a < y.a : x.b < y.b;
  });
  return pairs;
}

bool TrianglePairs::turnOver(uint32_t start, uint32_t t, uint32_t end, const Search& search) {
  std::vector<std::array<uint32_t, 2>> joins, parts;
  for (uint32_t at = t;;) {
    joins.push_back({at, end});
    if (at == start) break;
    end = partner_[at];
    parts.push_back({at, end});
    at = search.from[at];
  }
  for (auto& x : parts) part(x[0]);
  size_t joined = 0;
  for (; joined < joins.size() && roomFor(joins[joined][0], joins[joined][1]); ++joined)
    join(joins[joined][0], joins[joined][1]);
  if (joined == joins.size()) return true;
  for (size_t j = 0; j < joined; ++j) part(joins[j][0]);
  for (auto& x : parts) join(x[0], x[1]);
  return false;
}

bool TrianglePairs::searchFrom(uint32_t start, Search& search) {
  constexpr size_t kMostTriangles = 400;
  const uint32_t number = ++search.number;
  std::vector<uint32_t> queue{start};
  search.seen[start] = number;
  search.from[start] = kNoIndex;
  for (size_t i = 0; i < queue.size() && queue.size() < kMostTriangles; ++i) {
    const uint32_t t = queue[i];
    for (auto [o, q] : across_[t]) {
      if (search.seen[o] == number || o == partner_[t]) continue;
      if (partner_[o] == kNoIndex) {
        if (turnOver(start, t, o, search)) return true;
        continue;
      }
      const uint32_t next = partner_[o];
      if (search.seen[next] == number) continue;
      search.seen[o] = search.seen[next] = number;
      search.from[next] = t;
      queue.push_back(next);
    }
  }
  return false;
}

bool TrianglePairs::augment() {
  Search search{std::vector<uint32_t>(mesh_.triangles.size()), std::vector<uint32_t>(mesh_.triangles.size(), 0)};
  bool any = false;
  for (uint32_t start = 0; start < mesh_.triangles.size(); ++start) {
    if (mesh_.triangles[start][0] == kNoIndex || partner_[start] != kNoIndex) continue;
    any |= searchFrom(start, search);
  }
  return any;
}

bool TrianglePairs::exchange() {
  bool any = false;
  for (uint32_t a = 0; a < mesh_.triangles.size(); ++a) {
    if (mesh_.triangles[a][0] == kNoIndex || partner_[a] == kNoIndex) continue;
    for (auto [c, q] : across_[a]) {
      const uint32_t b = partner_[a], d = partner_[c];
      if (b == kNoIndex || d == kNoIndex || c == b) continue;
      const double other = qualityOf(b, d);
      if (other <= 0 || q + other <= qualityOf(a, b) + qualityOf(c, d) + 1e-6) continue;
      part(a);
      part(c);
      bool room = roomFor(a, c);
      if (room) {
        join(a, c);
        room = roomFor(b, d);
        if (!room) part(a);
      }
      if (room) {
        join(b, d);
        any = true;
      } else {
        join(a, b);
        join(c, d);
      }
      break;
    }
  }
  return any;
}

// For each triangle its partner or kNoIndex: greedily by quality, then longer by alternating paths, then better by
// exchanges.
std::vector<uint32_t> pairTriangles(const EditMesh& m, bool all_wanted) {
  TrianglePairs pairs(m, all_wanted);
  for (int round = 0; round < 4; ++round) {
    const bool longer = pairs.augment(), better = pairs.exchange();
    if (!longer && !better) break;
  }
  return pairs.takePartners();
}

}  // namespace

QuadMesh makeQuads(const EditMesh& m, std::span<const FeatureCurve> curves, bool split) {
  QuadMesh out;
  const std::vector<uint32_t> partner = pairTriangles(m, !split);
  if (!split) {
    for (uint32_t t = 0; t < m.triangles.size(); ++t) {
      if (m.triangles[t][0] != kNoIndex && partner[t] == kNoIndex) return out;
    }
  }
  auto add = [&](const glm::dvec3& p, bool fixed, const CurvePlace& place) {
    out.points.push_back(p);
    out.fixed.push_back(fixed);
    out.place.push_back(place);
    return static_cast<uint32_t>(out.points.size() - 1);
  };
  std::vector<uint32_t> corner(m.points.size(), kNoIndex);
  for (uint32_t v = 0; v < m.points.size(); ++v) {
    if (m.fans[v].empty()) continue;
    const bool sliding = m.steps[v].size() == 2 && !m.fixed[v];
    corner[v] = add(m.points[v], !sliding && (m.fixed[v] || m.border[v] || !m.steps[v].empty()), {});
    if (sliding) out.place.back() = {m.steps[v][0].curve, m.steps[v][0].along, kNoIndex, kNoIndex};
  }
  // Two points that follow one another on a feature curve, from the smaller place to the larger.
  auto follow = [&](uint32_t a, uint32_t b) {
    out.place[a].after = b;
    out.place[b].before = a;
  };
  std::map<std::array<uint32_t, 2>, uint32_t> middles;
  auto middle = [&](uint32_t a, uint32_t b) {
    auto [it, fresh] = middles.try_emplace({std::min(a, b), std::max(a, b)}, 0);
    if (!fresh) return it->second;
    const CurveStep *there = m.step(a, b), *back = m.step(b, a);
    if (!there) return it->second = add((m.points[a] + m.points[b]) / 2.0, false, {});
    const double along = (there->along + back->along) / 2;
    const uint32_t c = it->second =
        add(curves[there->curve].point(along), false, {there->curve, along, kNoIndex, kNoIndex});
    const bool forwards = there->along < back->along;
    follow(corner[forwards ? a : b], c);
    follow(c, corner[forwards ? b : a]);
    return c;
  };
  if (!split) {
    for (uint32_t v = 0; v < m.points.size(); ++v) {
      for (const CurveStep& s : m.steps[v]) {
        if (m.step(s.to, v)->along > s.along) follow(corner[v], corner[s.to]);
      }
    }
  }
  for (uint32_t t = 0; t < m.triangles.size(); ++t) {
    const Triangle& x = m.triangles[t];
    if (x[0] == kNoIndex || (partner[t] != kNoIndex && partner[t] < t)) continue;
    std::vector<uint32_t> face(x.begin(), x.end());
    if (partner[t] != kNoIndex) {
      const Triangle& y = m.triangles[partner[t]];
      for (int k = 0; k < 3; ++k) {
        const uint32_t a = x[k], b = x[(k + 1) % 3];
        for (int j = 0; j < 3; ++j) {
          if (y[j] == b && y[(j + 1) % 3] == a) face = {a, y[(j + 2) % 3], b, x[(k + 2) % 3]};
        }
      }
    }
    const size_t n = face.size();
    if (!split) {
      out.quads.push_back({corner[face[0]], corner[face[1]], corner[face[2]], corner[face[3]]});
      continue;
    }
    glm::dvec3 centre{0};
    for (uint32_t v : face) centre += m.points[v] / static_cast<double>(n);
    const uint32_t c = add(centre, false, {});
    for (size_t k = 0; k < n; ++k) {
      out.quads.push_back(
          {corner[face[k]], middle(face[k], face[(k + 1) % n]), c, middle(face[(k + n - 1) % n], face[k])});
    }
  }
  return out;
}

QuadStars::QuadStars(const QuadMesh& m) : begin(m.points.size() + 1, 0), quads(4 * m.quads.size()) {
  for (const auto& q : m.quads) {
    for (uint32_t c : q) ++begin[c + 1];
  }
  for (size_t c = 1; c < begin.size(); ++c) begin[c] += begin[c - 1];
  std::vector<uint32_t> fill(begin.begin(), begin.end() - 1);
  for (uint32_t q = 0; q < m.quads.size(); ++q) {
    for (uint32_t c : m.quads[q]) quads[fill[c]++] = q;
  }
}

double QuadStars::leastSine(const QuadMesh& m, uint32_t corner) const {
  double least = 1;
  for (uint32_t i = begin[corner]; i < begin[corner + 1]; ++i) {
    const auto& q = m.quads[quads[i]];
    for (int k = 0; k < 4; ++k) {
      const glm::dvec3 a = m.points[q[(k + 1) % 4]] - m.points[q[k]], b = m.points[q[(k + 3) % 4]] - m.points[q[k]];
      const double length = glm::length(a) * glm::length(b);
      least = std::min(least, length > 0 ? glm::dot(glm::cross(a, b), m.normals[q[k]]) / length : 0.0);
    }
  }
  return least;
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
  m.normals.assign(m.points.size(), glm::dvec3(0));
  for (const auto& q : m.quads) {
    const glm::dvec3 up = glm::cross(m.points[q[2]] - m.points[q[0]], m.points[q[3]] - m.points[q[1]]);
    for (uint32_t v : q) m.normals[v] += up;
  }
  for (glm::dvec3& n : m.normals) n = unit(n);
}

void relaxQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanLookup& scan, int rounds) {
  const size_t n = m.points.size();
  const QuadStars stars(m);
  std::vector<glm::dvec3> target(n);
  std::vector<double> weight(n);
  std::vector<int> uses(n, 0);
  for (const auto& q : m.quads) {
    for (uint32_t v : q) ++uses[v];
  }
  for (int round = 0; round < rounds; ++round) {
    updateNormals(m);
    std::fill(target.begin(), target.end(), glm::dvec3(0));
    std::fill(weight.begin(), weight.end(), 0.0);
    for (const auto& q : m.quads) {
      const glm::dvec3 p[4] = {m.points[q[0]], m.points[q[1]], m.points[q[2]], m.points[q[3]]};
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
      for (int k = 0; k < 4; ++k) {
        target[q[k]] += w * (centre + arm);
        weight[q[k]] += w;
        arm = glm::cross(normal, arm);
      }
    }
    for (uint32_t v = 0; v < n; ++v) {
      if (m.fixed[v] || weight[v] <= 0) continue;
      const glm::dvec3 to = target[v] / weight[v];
      if (CurvePlace& at = m.place[v]; at.curve != kNoIndex) {
        const FeatureCurve& curve = curves[at.curve];
        if (at.before == kNoIndex || at.after == kNoIndex) continue;
        const double start = m.fixed[at.before] ? 0 : m.place[at.before].along,
                     end = m.fixed[at.after] ? curve.length() : m.place[at.after].along;
        // Along the feature curve as far as the desired level points that way, and towards the middle.
        const glm::dvec3 tangent = unit(m.points[at.after] - m.points[at.before]);
        const double s = 0.7 * (at.along + 0.5 * glm::dot(to - m.points[v], tangent)) + 0.3 * (start + end) / 2;
        at.along = std::clamp(s, 0.75 * start + 0.25 * end, 0.25 * start + 0.75 * end);
        m.points[v] = curve.point(at.along);
        continue;
      }
      glm::dvec3 step = 0.6 * (to - m.points[v]);
      step -= m.normals[v] * glm::dot(step, m.normals[v]);
      if (!m.slide.empty()) step = m.slide[v] * step;
      const double reach = 2 * uses[v] / weight[v];  // about twice the quads' radius
      const glm::dvec3 was = m.points[v];
      const double before = stars.leastSine(m, v);
      if (const SurfacePoint hit = scan.project(was + step, m.normals[v], reach)) m.points[v] = scan.point(hit);
      if (stars.leastSine(m, v) < std::min(before, 0.3)) m.points[v] = was;
    }
  }
}

void settleBorders(QuadMesh& m, std::span<const FeatureCurve> curves, std::span<const double> must) {
  const QuadStars stars(m);
  for (int round = 0; round < 4; ++round) {
    for (uint32_t v = 0; v < m.points.size(); ++v) {
      CurvePlace& at = m.place[v];
      if (m.fixed[v] || at.curve == kNoIndex || !curves[at.curve].border || at.before == kNoIndex ||
          at.after == kNoIndex)
        continue;
      const FeatureCurve& curve = curves[at.curve];
      const CurveEnd before{m.points[at.before], m.normals[at.before],
                            m.fixed[at.before] ? 0 : m.place[at.before].along};
      const CurveEnd after{m.points[at.after], m.normals[at.after],
                           m.fixed[at.after] ? curve.length() : m.place[at.after].along};
      auto deviation = [&](double along) {
        const CurveEnd here{curve.point(along), m.normals[v], along};
        return std::max(deviationFromSide(curve, before, here), deviationFromSide(curve, here, after));
      };
      double best = at.along, least = deviation(best);
      if (least <= must[at.curve] / 2) continue;
      const double sine = std::min(stars.leastSine(m, v), 0.3);
      for (int k = 0; k <= 16; ++k) {
        const double along = before.along + (after.along - before.along) * (0.25 + 0.5 * k / 16), s = deviation(along);
        if (s >= 0.95 * least) continue;
        const glm::dvec3 was = m.points[v];
        m.points[v] = curve.point(along);
        if (stars.leastSine(m, v) >= sine) best = along, least = s;
        m.points[v] = was;
      }
      at.along = best;
      m.points[v] = curve.point(best);
    }
  }
}

void untangleQuads(QuadMesh& m, std::span<const FeatureCurve> curves, const ScanLookup& scan) {
  constexpr double kEnough = 0.3;  // of a sine: 17 degrees from folding
  const QuadStars stars(m);
  for (int round = 0; round < 20; ++round) {
    bool moved = false;
    for (uint32_t v = 0; v < m.points.size(); ++v) {
      if (m.fixed[v] || stars.leastSine(m, v) >= kEnough) continue;
      const glm::dvec3 was = m.points[v];
      const CurvePlace place = m.place[v];
      if (place.curve != kNoIndex && (place.before == kNoIndex || place.after == kNoIndex)) continue;
      // Towards the middle of the neighbours; of a feature curve's two neighbours.
      glm::dvec3 middle{0};
      double reach = 0;
      for (uint32_t i = stars.begin[v]; i < stars.begin[v + 1]; ++i) {
        for (uint32_t c : m.quads[stars.quads[i]]) {
          if (c == v) continue;
          middle += m.points[c];
          reach = std::max(reach, glm::length(m.points[c] - was));
        }
      }
      middle /= 3.0 * (stars.begin[v + 1] - stars.begin[v]);
      glm::dvec3 best = was;
      double best_sine = stars.leastSine(m, v), best_along = place.along;
      for (double t : {1.0, 0.5, 0.25, 0.1}) {
        if (place.curve != kNoIndex) {
          const FeatureCurve& curve = curves[place.curve];
          const double start = m.fixed[place.before] ? 0 : m.place[place.before].along;
          const double end = m.fixed[place.after] ? curve.length() : m.place[place.after].along;
          m.place[v].along = place.along + t * ((start + end) / 2 - place.along);
          m.points[v] = curve.point(m.place[v].along);
        } else {
          const SurfacePoint hit = scan.project(was + t * (middle - was), m.normals[v], reach);
          if (!hit) continue;
          m.points[v] = scan.point(hit);
        }
        const double sine = stars.leastSine(m, v);
        if (sine > best_sine + 1e-3) best_sine = sine, best = m.points[v], best_along = m.place[v].along, moved = true;
      }
      m.points[v] = best;
      m.place[v].along = best_along;
    }
    if (!moved) return;
  }
}

}  // namespace relievo
