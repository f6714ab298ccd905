#include "geometry/remesh/feature_curves.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

namespace {

// Turns of a feature curve, and dihedral angles, from which on they count.
constexpr double kSharpAngle = 50 * kDegree;
// A crease goes on along edges of at least that dihedral angle, where it does not turn by more than that.
constexpr double kBluntAngle = 25 * kDegree, kMaxTurn = 40 * kDegree;

double angleOf(const glm::dvec3& a, const glm::dvec3& b) {
  const double length = glm::length(a) * glm::length(b);
  return length > 0 ? std::acos(std::clamp(glm::dot(a, b) / length, -1.0, 1.0)) : 0;
}

// A polyline of the reduced surface's vertices; closed: the last one leads back to the first.
struct Polyline {
  std::vector<VertexHandle> vertices;  // not valid: a vertex of the scan's border that the reduction removed
  std::vector<glm::dvec3> points;
  bool closed = false, border = false;
};

// Indices at which the line turns by more than kSharpAngle within a window on either side, if no neighbour within the
// window turns more.
std::vector<size_t> sharpTurns(const Polyline& line) {
  const size_t n = line.points.size();
  std::vector<double> arc_lengths{0};
  for (size_t i = 0; i + 1 < n + line.closed; ++i)
    arc_lengths.push_back(arc_lengths.back() + glm::length(line.points[(i + 1) % n] - line.points[i]));
  const double length = arc_lengths.back(), window = std::max(length / 24, 0.01);
  auto pointAt = [&](double s) {
    if (line.closed) s -= std::floor(s / length) * length;
    s = std::clamp(s, 0.0, length);
    size_t i = std::upper_bound(arc_lengths.begin(), arc_lengths.end(), s) - arc_lengths.begin();
    i = std::min(i == 0 ? 0 : i - 1, arc_lengths.size() - 2);
    const double t =
        arc_lengths[i + 1] > arc_lengths[i] ? (s - arc_lengths[i]) / (arc_lengths[i + 1] - arc_lengths[i]) : 0;
    return line.points[i] * (1 - t) + line.points[(i + 1) % n] * t;
  };
  std::vector<double> turn(n, 0.0);
  for (size_t i = line.closed ? 0 : 1; i < n - !line.closed; ++i) {
    turn[i] =
        angleOf(line.points[i] - pointAt(arc_lengths[i] - window), pointAt(arc_lengths[i] + window) - line.points[i]);
  }
  std::vector<size_t> sharp;
  for (size_t i = 0; i < n; ++i) {
    if (turn[i] < kSharpAngle) continue;
    bool largest = true;
    for (int way : {1, -1}) {
      double distance = 0;
      for (size_t step = 1; step < n && largest; ++step) {
        const size_t from = (i + n + way * (step - 1)) % n, j = (i + n + n + way * step) % n;
        if (!line.closed && ((way > 0 && j < i) || (way < 0 && j > i))) break;
        distance += glm::length(line.points[j] - line.points[from % n]);
        if (distance > window) break;
        largest = way > 0 ? turn[j] < turn[i] : turn[j] <= turn[i];
      }
    }
    if (largest) sharp.push_back(i);
  }
  return sharp;
}

// A subset of a closed line's points whose polygon is within the tolerance of all of them (Douglas and Peucker 1973).
std::vector<size_t> simplifiedPolygon(const std::vector<glm::dvec3>& points, double tolerance) {
  const size_t n = points.size();
  auto farthest = [&](size_t from) {
    size_t best = from;
    for (size_t i = 0; i < n; ++i) {
      if (glm::length(points[i] - points[from]) > glm::length(points[best] - points[from])) best = i;
    }
    return best;
  };
  const size_t a = farthest(0), b = farthest(a);
  std::vector<size_t> kept{a, b};
  if (a == b) return {a};
  std::vector<std::array<size_t, 2>> pending{{a, b > a ? b : b + n}, {b, a > b ? a : a + n}};
  while (!pending.empty()) {
    const auto [first, last] = pending.back();
    pending.pop_back();
    const glm::dvec3 p = points[first % n], side = points[last % n] - p;
    size_t worst = first;
    double offset = tolerance;
    for (size_t i = first + 1; i < last; ++i) {
      const glm::dvec3 d = points[i % n] - p;
      const double t = std::clamp(glm::dot(d, side) / std::max(glm::dot(side, side), 1e-300), 0.0, 1.0),
                   length = glm::length(d - t * side);
      if (length > offset) offset = length, worst = i;
    }
    if (worst == first) continue;
    kept.push_back(worst % n);
    pending.push_back({first, worst});
    pending.push_back({worst, last});
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

// The sharp turns of a border's simplified polygon, so that small steps neither make corners nor hide them.
std::vector<size_t> borderTurns(const std::vector<glm::dvec3>& points) {
  double length = glm::length(points.front() - points.back());
  for (size_t i = 1; i < points.size(); ++i) length += glm::length(points[i] - points[i - 1]);
  // For a circle this tolerance, a 400th of its length, gives sides of 20 degrees.
  const std::vector<size_t> kept = simplifiedPolygon(points, std::min(0.005, length / 400));
  if (kept.size() < 3) return {};
  Polyline line{.closed = true, .border = true};
  for (size_t i : kept) line.points.push_back(points[i]);
  std::vector<size_t> turns;
  for (size_t i : sharpTurns(line)) turns.push_back(kept[i]);
  return turns;
}

// Cuts a line at its sharp turns (a closed one at least once) into feature curves, and marks their half edges.
void addCurves(const Polyline& line, TriangleMesh& mesh, std::vector<FeatureCurve>& curves) {
  const size_t n = line.points.size();
  // Only vertices that the reduction kept can be fixed.
  std::vector<size_t> cuts;
  for (size_t i : line.border ? borderTurns(line.points) : sharpTurns(line)) {
    if (line.vertices[i].is_valid()) cuts.push_back(i);
  }
  if (line.closed && cuts.empty()) {
    const auto first_kept =
        std::find_if(line.vertices.begin(), line.vertices.end(), [](VertexHandle v) { return v.is_valid(); });
    if (first_kept == line.vertices.end()) return;
    cuts.push_back(first_kept - line.vertices.begin());
  }
  if (!line.closed) {
    cuts.insert(cuts.begin(), 0);
    cuts.push_back(n - 1);
    cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  }
  for (size_t c = 0; c + !line.closed < cuts.size(); ++c) {
    const size_t first = cuts[c], last = c + 1 < cuts.size() ? cuts[c + 1] : cuts[0] + n;
    FeatureCurve curve;
    curve.border = line.border;
    VertexHandle before;
    double before_arc_length = 0;
    for (size_t i = first; i <= last; ++i) {
      const glm::dvec3 p = line.points[i % n];
      const double arc_length = i == first ? 0 : curve.arc_lengths.back() + glm::length(p - curve.points.back());
      curve.points.push_back(p);
      curve.arc_lengths.push_back(arc_length);
      const VertexHandle v = line.vertices[i % n];
      if (!v.is_valid()) continue;
      if (before.is_valid())
        setCurvePosition(mesh, before, v, static_cast<uint32_t>(curves.size()), before_arc_length, arc_length);
      if (i == first || i == last) mesh.data(v).fixed = true;
      before = v;
      before_arc_length = arc_length;
    }
    curves.push_back(std::move(curve));
  }
}

// The edges along which the surface folds sharply, and the lines that they form.
struct Creases {
  const TriangleMesh& m;
  std::vector<std::vector<SmartHalfedgeHandle>> crease_halfedges;  // for each vertex
  std::vector<uint8_t> visited;                                    // for each edge
  std::vector<Polyline> lines;

  explicit Creases(const TriangleMesh& mesh) : m(mesh), crease_halfedges(m.n_vertices()), visited(m.n_edges(), 0) {
    for (const auto e : m.edges()) {
      if (!e.is_boundary() && dihedralCosine(e) <= std::cos(kSharpAngle)) add(e);
    }
    for (const auto v : m.vertices()) {
      for (SmartVertexHandle end = v; crease_halfedges[end.idx()].size() == 1 && !end.is_boundary();) {
        const SmartHalfedgeHandle next = continuation(crease_halfedges[end.idx()][0].opp());
        if (!next.is_valid()) break;
        add(next.edge());
        end = next.to();
      }
    }
    for (bool circles : {false, true}) {  // closed lines without a node remain for the second pass
      for (const auto v : m.vertices()) {
        if (!circles && !isNode(v)) continue;
        for (const auto& h : crease_halfedges[v.idx()]) {
          if (!visited[h.edge().idx()]) traceLine(h);
        }
      }
    }
  }

  double dihedralCosine(const SmartEdgeHandle& e) const {
    return glm::dot(unit(areaVector(m, e.h0().face())), unit(areaVector(m, e.h1().face())));
  }
  void add(const SmartEdgeHandle& e) {
    for (const auto& h : {e.h0(), e.h1()}) crease_halfedges[h.from().idx()].push_back(h);
  }
  // The sharpest of the edges that continue a crease beyond its end; not valid if there is none.
  SmartHalfedgeHandle continuation(const SmartHalfedgeHandle& last) const {
    const glm::dvec3 direction = m.point(last.to()) - m.point(last.from());
    SmartHalfedgeHandle best;
    double sharpest = std::cos(kBluntAngle);
    for (const auto h : last.to().outgoing_halfedges()) {
      if (h == last.opp() || h.edge().is_boundary()) continue;
      if (angleOf(direction, m.point(h.to()) - m.point(h.from())) > kMaxTurn) continue;
      const double cosine = dihedralCosine(h.edge());
      if (cosine < sharpest) sharpest = cosine, best = h;
    }
    return best;
  }

  bool isNode(const SmartVertexHandle& v) const { return crease_halfedges[v.idx()].size() != 2 || v.is_boundary(); }

  void traceLine(SmartHalfedgeHandle h) {
    const SmartVertexHandle first = h.from();
    Polyline line{.vertices = {first}};
    for (;;) {
      visited[h.edge().idx()] = 1;
      // A line back to the same fork is not closed: the fork stays fixed.
      line.closed = h.to() == first && !isNode(first);
      if (!line.closed) line.vertices.push_back(h.to());
      if (line.closed || isNode(h.to())) break;
      const auto& outgoing = crease_halfedges[h.to().idx()];
      h = outgoing[0].edge() == h.edge() ? outgoing[1] : outgoing[0];
    }
    for (const VertexHandle v : line.vertices) line.points.push_back(m.point(v));
    lines.push_back(std::move(line));
  }
};

// The lines along which the surface folds sharply, without networks that are too short for their number of ends and
// forks: these are roughness.
std::vector<Polyline> creaseLines(const TriangleMesh& m, double min_length_per_node) {
  Creases creases(m);
  std::vector<Polyline>& lines = creases.lines;
  // Joins lines to networks (union-find).
  std::vector<int> component(m.n_vertices());
  std::iota(component.begin(), component.end(), 0);
  auto componentOf = [&](VertexHandle vertex) {
    int v = vertex.idx();
    while (component[v] != v) v = component[v] = component[component[v]];
    return v;
  };
  for (const Polyline& line : lines) {
    const int a = componentOf(line.vertices.front()), b = componentOf(line.vertices.back());
    component[std::max(a, b)] = std::min(a, b);
  }
  std::vector<double> length(m.n_vertices(), 0.0), fixed(m.n_vertices(), 0.0);
  for (const auto v : m.vertices())
    fixed[componentOf(v)] += !creases.crease_halfedges[v.idx()].empty() && creases.isNode(v);
  for (const Polyline& line : lines) {
    const int n = componentOf(line.vertices.front());
    for (size_t i = 1; i < line.points.size(); ++i) length[n] += glm::length(line.points[i] - line.points[i - 1]);
    fixed[n] += static_cast<double>(sharpTurns(line).size());
  }
  std::erase_if(lines, [&](const Polyline& line) {
    const int n = componentOf(line.vertices.front());
    return length[n] < min_length_per_node * std::max(fixed[n], 1.0);
  });
  return std::move(lines);
}

}  // namespace

glm::dvec3 FeatureCurve::point(double s) const {
  size_t i = std::upper_bound(arc_lengths.begin(), arc_lengths.end(), s) - arc_lengths.begin();
  i = std::min(i == 0 ? 0 : i - 1, arc_lengths.size() - 2);
  const double t = arc_lengths[i + 1] > arc_lengths[i]
                       ? std::clamp((s - arc_lengths[i]) / (arc_lengths[i + 1] - arc_lengths[i]), 0.0, 1.0)
                       : 0;
  return points[i] * (1 - t) + points[i + 1] * t;
}

double deviationFromSide(const FeatureCurve& curve, const CurveEnd& a, const CurveEnd& b) {
  auto i = static_cast<size_t>(
      std::upper_bound(curve.arc_lengths.begin(), curve.arc_lengths.end(), std::min(a.arc_length, b.arc_length)) -
      curve.arc_lengths.begin());
  const double end = std::max(a.arc_length, b.arc_length);
  const glm::dvec3 side = b.point - a.point;
  double deviation = 0;
  for (; i < curve.arc_lengths.size() && curve.arc_lengths[i] < end; ++i) {
    const glm::dvec3 p = curve.points[i] - a.point;
    glm::dvec3 offset{0};
    for (double t = (curve.arc_lengths[i] - a.arc_length) / (b.arc_length - a.arc_length), round = 0; round < 3;
         ++round) {
      const glm::dvec3 n = a.normal * (1 - t) + b.normal * t,
                       across = side - n * (glm::dot(side, n) / std::max(glm::dot(n, n), 1e-300));
      t = std::clamp(glm::dot(p, across) / std::max(glm::dot(across, across), 1e-300), 0.0, 1.0);
      offset = p - t * side;
      offset -= n * (glm::dot(offset, n) / std::max(glm::dot(n, n), 1e-300));
    }
    deviation = std::max(deviation, glm::length(offset));
  }
  return deviation;
}

double deviationForSides(const FeatureCurve& curve, double side, double tolerance) {
  const double sides = 1.5 * std::max(2.0, curve.length() / side);
  while (tolerance < 1 && static_cast<double>(simplifiedPolygon(curve.points, tolerance).size()) > sides + 1)
    tolerance *= 2;
  return tolerance;
}

std::vector<uint32_t> borderCorners(const std::vector<BorderLoop>& scan_borders) {
  std::vector<uint32_t> corners;
  for (const BorderLoop& border : scan_borders) {
    for (size_t i : borderTurns({border.points.begin(), border.points.end()})) corners.push_back(border.vertices[i]);
  }
  return corners;
}

std::vector<FeatureCurve> findFeatureCurves(const std::vector<BorderLoop>& scan_borders,
                                            std::span<const uint32_t> vertex, double min_length_per_node,
                                            TriangleMesh& reduced) {
  std::vector<FeatureCurve> curves;
  uint32_t last = 0;
  for (const BorderLoop& border : scan_borders)
    last = std::max(last, *std::max_element(border.vertices.begin(), border.vertices.end()));
  std::vector<VertexHandle> reduced_vertices(scan_borders.empty() ? 0 : last + 1);  // for each vertex of the scan
  for (size_t v = 0; v < vertex.size(); ++v) {
    if (vertex[v] < reduced_vertices.size()) reduced_vertices[vertex[v]] = VertexHandle(static_cast<int>(v));
  }
  for (const BorderLoop& border : scan_borders) {
    Polyline line{{}, {border.points.begin(), border.points.end()}, true, true};
    for (uint32_t v : border.vertices) line.vertices.push_back(reduced_vertices[v]);
    addCurves(line, reduced, curves);
  }
  for (const Polyline& line : creaseLines(reduced, min_length_per_node)) addCurves(line, reduced, curves);
  return curves;
}

}  // namespace relievo
