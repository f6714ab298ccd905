#include "geometry/remesh/feature_curves.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

namespace {

constexpr double kSharp =
    50 * std::numbers::pi / 180;    // turns of a feature curve, and folds of the surface, that count
constexpr double kShortest = 0.25;  // of a net of creases, for each of its ends, forks and sharp turns, in diagonals

double angleOf(const glm::dvec3& a, const glm::dvec3& b) {
  const double length = glm::length(a) * glm::length(b);
  return length > 0 ? std::acos(std::clamp(glm::dot(a, b) / length, -1.0, 1.0)) : 0;
}

// A line of the reduced surface's vertices with their places; closed: the last one leads back to the first.
struct Line {
  std::vector<VertexHandle> vertices;  // not valid: of the scan's border, and gone
  std::vector<glm::dvec3> points;
  bool closed = false, border = false;
};

// Indices into the line where it turns by more than kSharp within a window on either side, the sharpest of their
// surroundings.
std::vector<size_t> sharpTurns(const Line& line) {
  const size_t n = line.points.size();
  std::vector<double> at{0};
  for (size_t i = 0; i + 1 < n + line.closed; ++i)
    at.push_back(at.back() + glm::length(line.points[(i + 1) % n] - line.points[i]));
  const double length = at.back(), window = std::max(length / 24, 0.01);
  auto place = [&](double s) {
    if (line.closed) s -= std::floor(s / length) * length;
    s = std::clamp(s, 0.0, length);
    size_t i = std::upper_bound(at.begin(), at.end(), s) - at.begin();
    i = std::min(i == 0 ? 0 : i - 1, at.size() - 2);
    const double t = at[i + 1] > at[i] ? (s - at[i]) / (at[i + 1] - at[i]) : 0;
    return line.points[i] * (1 - t) + line.points[(i + 1) % n] * t;
  };
  std::vector<double> turn(n, 0.0);
  for (size_t i = line.closed ? 0 : 1; i < n - !line.closed; ++i) {
    turn[i] = angleOf(line.points[i] - place(at[i] - window), place(at[i] + window) - line.points[i]);
  }
  std::vector<size_t> sharp;
  for (size_t i = 0; i < n; ++i) {
    if (turn[i] < kSharp) continue;
    bool largest = true;
    for (int way : {1, -1}) {
      double walked = 0;
      for (size_t step = 1; step < n && largest; ++step) {
        const size_t from = (i + n + way * (step - 1)) % n, j = (i + n + n + way * step) % n;
        if (!line.closed && ((way > 0 && j < i) || (way < 0 && j > i))) break;
        walked += glm::length(line.points[j] - line.points[from % n]);
        if (walked > window) break;
        largest = way > 0 ? turn[j] < turn[i] : turn[j] <= turn[i];
      }
    }
    if (largest) sharp.push_back(i);
  }
  return sharp;
}

// A closed line's points, few enough that all lie within that distance of the polygon through them (Douglas and Peucker
// 1973).
std::vector<size_t> outline(const std::vector<glm::dvec3>& points, double within) {
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
  std::vector<std::array<size_t, 2>> open{{a, b > a ? b : b + n}, {b, a > b ? a : a + n}};
  while (!open.empty()) {
    const auto [first, last] = open.back();
    open.pop_back();
    const glm::dvec3 p = points[first % n], side = points[last % n] - p;
    size_t worst = first;
    double off = within;
    for (size_t i = first + 1; i < last; ++i) {
      const glm::dvec3 d = points[i % n] - p;
      const double t = std::clamp(glm::dot(d, side) / std::max(glm::dot(side, side), 1e-300), 0.0, 1.0),
                   length = glm::length(d - t * side);
      if (length > off) off = length, worst = i;
    }
    if (worst == first) continue;
    kept.push_back(worst % n);
    open.push_back({first, worst});
    open.push_back({worst, last});
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

// sharpTurns of a border, of its outline: small steps neither make corners nor hide them.
std::vector<size_t> borderTurns(const std::vector<glm::dvec3>& points) {
  double length = glm::length(points.front() - points.back());
  for (size_t i = 1; i < points.size(); ++i) length += glm::length(points[i] - points[i - 1]);
  // A 400th of a circle's length off it are sides of 20 degrees.
  const std::vector<size_t> kept = outline(points, std::min(0.005, length / 400));
  if (kept.size() < 3) return {};
  Line line{.closed = true, .border = true};
  for (size_t i : kept) line.points.push_back(points[i]);
  std::vector<size_t> turns;
  for (size_t i : sharpTurns(line)) turns.push_back(kept[i]);
  return turns;
}

// Cuts a line at its sharp turns (a closed one at least once) into feature curves, and marks their steps.
void addCurves(const Line& line, TriangleMesh& mesh, std::vector<FeatureCurve>& curves) {
  const size_t n = line.points.size();
  // Fixed vertices must still exist.
  std::vector<size_t> cuts;
  for (size_t i : line.border ? borderTurns(line.points) : sharpTurns(line)) {
    if (line.vertices[i].is_valid()) cuts.push_back(i);
  }
  if (line.closed && cuts.empty()) {
    const auto left =
        std::find_if(line.vertices.begin(), line.vertices.end(), [](VertexHandle v) { return v.is_valid(); });
    if (left == line.vertices.end()) return;
    cuts.push_back(left - line.vertices.begin());
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
    double before_along = 0;
    for (size_t i = first; i <= last; ++i) {
      const glm::dvec3 p = line.points[i % n];
      const double along = i == first ? 0 : curve.at.back() + glm::length(p - curve.points.back());
      curve.points.push_back(p);
      curve.at.push_back(along);
      const VertexHandle v = line.vertices[i % n];
      if (!v.is_valid()) continue;
      if (before.is_valid()) markStep(mesh, before, v, static_cast<uint32_t>(curves.size()), before_along, along);
      if (i == first || i == last) mesh.data(v).fixed = true;
      before = v;
      before_along = along;
    }
    curves.push_back(std::move(curve));
  }
}

// The edges along which the surface folds sharply, and the lines that they make.
struct Creases {
  const TriangleMesh& m;
  std::vector<std::vector<SmartHalfedgeHandle>> leaving;  // of a vertex
  std::vector<uint8_t> walked;                            // of an edge
  std::vector<Line> lines;

  explicit Creases(const TriangleMesh& mesh) : m(mesh), leaving(m.n_vertices()), walked(m.n_edges(), 0) {
    for (const auto e : m.edges()) {
      if (e.is_boundary()) continue;
      const glm::dvec3 n = unit(areaVector(m, e.h0().face())), o = unit(areaVector(m, e.h1().face()));
      if (glm::dot(n, o) > std::cos(kSharp)) continue;
      for (const auto& h : {e.h0(), e.h1()}) leaving[h.from().idx()].push_back(h);
    }
    for (bool circles : {false, true}) {  // what is left after those that start at nodes
      for (const auto v : m.vertices()) {
        if (!circles && !node(v)) continue;
        for (const auto& h : leaving[v.idx()]) {
          if (!walked[h.edge().idx()]) walk(h);
        }
      }
    }
  }

  bool node(const SmartVertexHandle& v) const { return leaving[v.idx()].size() != 2 || v.is_boundary(); }

  void walk(SmartHalfedgeHandle h) {
    const SmartVertexHandle first = h.from();
    Line line{.vertices = {first}};
    for (;;) {
      walked[h.edge().idx()] = 1;
      line.closed = h.to() == first && !node(first);  // back to a fork: it stays the end of both ways
      if (!line.closed) line.vertices.push_back(h.to());
      if (line.closed || node(h.to())) break;
      const auto& ways = leaving[h.to().idx()];
      h = ways[0].edge() == h.edge() ? ways[1] : ways[0];
    }
    for (const VertexHandle v : line.vertices) line.points.push_back(m.point(v));
    lines.push_back(std::move(line));
  }
};

// The lines along which the surface folds sharply, as long as they form nets that are long for their number of ends and
// forks.
std::vector<Line> creaseLines(const TriangleMesh& m) {
  Creases creases(m);
  std::vector<Line>& lines = creases.lines;
  // Nets that are too short for their fixed points are roughness.
  std::vector<int> net(m.n_vertices());
  std::iota(net.begin(), net.end(), 0);
  auto netOf = [&](VertexHandle vertex) {
    int v = vertex.idx();
    while (net[v] != v) v = net[v] = net[net[v]];
    return v;
  };
  for (const Line& line : lines) {
    const int a = netOf(line.vertices.front()), b = netOf(line.vertices.back());
    net[std::max(a, b)] = std::min(a, b);
  }
  std::vector<double> length(m.n_vertices(), 0.0), fixed(m.n_vertices(), 0.0);
  for (const auto v : m.vertices()) fixed[netOf(v)] += !creases.leaving[v.idx()].empty() && creases.node(v);
  for (const Line& line : lines) {
    const int n = netOf(line.vertices.front());
    for (size_t i = 1; i < line.points.size(); ++i) length[n] += glm::length(line.points[i] - line.points[i - 1]);
    fixed[n] += static_cast<double>(sharpTurns(line).size());
  }
  std::erase_if(lines, [&](const Line& line) {
    const int n = netOf(line.vertices.front());
    return length[n] < kShortest * std::max(fixed[n], 1.0);
  });
  return std::move(lines);
}

}  // namespace

glm::dvec3 FeatureCurve::point(double s) const {
  size_t i = std::upper_bound(at.begin(), at.end(), s) - at.begin();
  i = std::min(i == 0 ? 0 : i - 1, at.size() - 2);
  const double t = at[i + 1] > at[i] ? std::clamp((s - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0) : 0;
  return points[i] * (1 - t) + points[i + 1] * t;
}

double deviationFromSide(const FeatureCurve& curve, const CurveEnd& a, const CurveEnd& b) {
  auto i = static_cast<size_t>(std::upper_bound(curve.at.begin(), curve.at.end(), std::min(a.along, b.along)) -
                               curve.at.begin());
  const double end = std::max(a.along, b.along);
  const glm::dvec3 side = b.point - a.point;
  double deviation = 0;
  for (; i < curve.at.size() && curve.at[i] < end; ++i) {
    const glm::dvec3 p = curve.points[i] - a.point;
    glm::dvec3 off{0};
    for (double t = (curve.at[i] - a.along) / (b.along - a.along), round = 0; round < 3; ++round) {
      const glm::dvec3 n = a.normal * (1 - t) + b.normal * t,
                       across = side - n * (glm::dot(side, n) / std::max(glm::dot(n, n), 1e-300));
      t = std::clamp(glm::dot(p, across) / std::max(glm::dot(across, across), 1e-300), 0.0, 1.0);
      off = p - t * side;
      off -= n * (glm::dot(off, n) / std::max(glm::dot(n, n), 1e-300));
    }
    deviation = std::max(deviation, glm::length(off));
  }
  return deviation;
}

double deviationForSides(const FeatureCurve& curve, double side, double within) {
  const double sides = 1.5 * std::max(2.0, curve.length() / side);
  while (within < 1 && static_cast<double>(outline(curve.points, within).size()) > sides + 1) within *= 2;
  return within;
}

std::vector<uint32_t> borderCorners(const std::vector<BorderLine>& scan_borders) {
  std::vector<uint32_t> corners;
  for (const BorderLine& border : scan_borders) {
    for (size_t i : borderTurns({border.points.begin(), border.points.end()})) corners.push_back(border.vertices[i]);
  }
  return corners;
}

std::vector<FeatureCurve> findFeatureCurves(const std::vector<BorderLine>& scan_borders,
                                            std::span<const uint32_t> vertex, TriangleMesh& reduced) {
  std::vector<FeatureCurve> curves;
  uint32_t last = 0;
  for (const BorderLine& border : scan_borders)
    last = std::max(last, *std::max_element(border.vertices.begin(), border.vertices.end()));
  std::vector<VertexHandle> left(scan_borders.empty() ? 0 : last + 1);  // of the scan's vertices
  for (size_t v = 0; v < vertex.size(); ++v) {
    if (vertex[v] < left.size()) left[vertex[v]] = VertexHandle(static_cast<int>(v));
  }
  for (const BorderLine& border : scan_borders) {
    Line line{{}, {border.points.begin(), border.points.end()}, true, true};
    for (uint32_t v : border.vertices) line.vertices.push_back(left[v]);
    addCurves(line, reduced, curves);
  }
  for (const Line& line : creaseLines(reduced)) addCurves(line, reduced, curves);
  return curves;
}

}  // namespace relievo
