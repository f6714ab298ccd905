#include "geometry/bake/line_sweep.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "src/base/hash_index.h"
#include "src/base/parallel_for.h"
#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

constexpr size_t kBlock = 16;       // triangles a box: a strip of them is not much longer than wide
constexpr int kSteps = 4;           // of Newton: from a tenth of a square to rounding
constexpr float kGrow = 0.25f;      // of the square, beyond its sides: triangles that cross them are known there, too
constexpr float kRounding = 1e-5f;  // of (u, v): floats, and what Newton leaves
constexpr double kNear = 0.25;      // of what is likely
constexpr uint32_t kUnknown = 1u << 6;
constexpr size_t kMostWide = 32;  // triangles whose (u, v) are not known

// The body in floats, about its middle: P = p[0] + u p[1] + v p[2] + u v p[3], N alike.
struct Body {
  std::array<glm::vec3, 4> p, n;
  glm::mat3 start;  // (u, v, h) of a place near the middle: start * place + start_at
  glm::vec3 start_at;
  float low = 0, high = 0, low_grown = 0, high_grown = 0;
  float sign = 1;  // of the body's orientation: of (u, v) seen along the lines
  float bend_uv = 0, bend_uh = 0,
        bend_vh = 0;                  // how far a straight line of given extents leaves the straight line in (u, v)
  float bend_h = 0;                   // in h so many times as far
  float small = 0;                    // what is no longer than this and reaches into the body lies within the grown one
  float uv_a_unit = 0, h_a_unit = 0;  // of a move in space, at most
  // Beyond any of these planes there is nothing of the body: dot(normal, place) > at.
  std::array<glm::vec3, 6> plane;
  std::array<float, 6> plane_at;
};

template <class V>
std::array<V, 4> coefficients(const std::array<V, 4>& c) {
  return {c[0], c[1] - c[0], c[2] - c[0], c[3] - c[1] - c[2] + c[0]};
}

// False: lines may meet one another within it.
bool makeBody(const SweepSquare& square, const glm::dvec3& middle, double low, double high, Body& out) {
  std::array<glm::dvec3, 4> points = square.points;
  for (glm::dvec3& p : points) p -= middle;
  const auto p = coefficients(points), n = coefficients(square.normals);
  const double across = std::max(glm::length(p[1]) + glm::length(p[2]), 1e-300);
  const double normal = std::max(glm::length(n[0] + 0.5 * (n[1] + n[2]) + 0.25 * n[3]), 1e-300);
  const double grow = std::max(0.25 * (high - low), 0.125 * across / normal);
  const std::array<double, 2> t{-double{kGrow}, 1 + double{kGrow}}, h{low - grow, high + grow};
  // The derivative by u is linear in v and h, and so on: each column of the Jacobian lies in the hull of its four
  // values at the grown body's corners, and so does its mean over any segment in it. A determinant is linear in each
  // column: where all 64 have one sign, none of those means is singular, and no two places of the body are the same.
  std::array<glm::dvec3, 4> by_u, by_v, by_h;
  for (size_t i = 0; i < 2; ++i)
    for (size_t k = 0; k < 2; ++k) {
      by_u[2 * i + k] = p[1] + t[i] * p[3] + h[k] * (n[1] + t[i] * n[3]);
      by_v[2 * i + k] = p[2] + t[i] * p[3] + h[k] * (n[2] + t[i] * n[3]);
      by_h[2 * i + k] = n[0] + t[k] * n[1] + t[i] * n[2] + t[i] * t[k] * n[3];
    }
  double least = std::numeric_limits<double>::infinity(), most = -least;
  for (const glm::dvec3& a : by_u)
    for (const glm::dvec3& b : by_v) {
      const glm::dvec3 c = glm::cross(a, b);
      for (const glm::dvec3& d : by_h) {
        const double det = glm::dot(c, d);
        least = std::min(least, det);
        most = std::max(most, det);
      }
    }
  // Nearly singular bodies are left out, too: Newton's steps and the bounds below want them well away from it.
  constexpr double kEven = 0.1;
  if (!(least > kEven * most && least > 0) && !(most < kEven * least && most < 0)) return false;
  out.sign = least > 0 ? 1.0f : -1.0f;
  for (size_t k = 0; k < 4; ++k) out.p[k] = glm::vec3(p[k]), out.n[k] = glm::vec3(n[k]);
  out.low = static_cast<float>(low);
  out.high = static_cast<float>(high);
  out.low_grown = static_cast<float>(h[0]);
  out.high_grown = static_cast<float>(h[1]);

  const double mid = 0.5 * (low + high);
  const glm::dvec3 u = p[1] + 0.5 * p[3] + mid * (n[1] + 0.5 * n[3]), v = p[2] + 0.5 * p[3] + mid * (n[2] + 0.5 * n[3]);
  const glm::dvec3 w = n[0] + 0.5 * (n[1] + n[2]) + 0.25 * n[3];
  const glm::dvec3 centre = p[0] + 0.5 * (p[1] + p[2]) + 0.25 * p[3] + mid * w;
  const glm::dmat3 inverse = glm::inverse(glm::dmat3(u, v, w));
  out.start = glm::mat3(inverse);
  out.start_at = glm::vec3(glm::dvec3(0.5, 0.5, mid) - inverse * centre);

  // A straight segment x(s), s in [0, 1], has q(s) with J q'' = -D2(q', q'), and is q's straight segment to max |q''|
  // / 8. Of the inverse of J the rows of u and v are cross(by_v, by_h) / det and so on: bounded by their largest and
  // the least determinant. Twice that, for the changes of q'.
  double row = 0, row_h = 0;
  for (const glm::dvec3& d : by_h) {
    for (const glm::dvec3& a : by_u) row = std::max(row, glm::length(glm::cross(a, d)));
    for (const glm::dvec3& b : by_v) row = std::max(row, glm::length(glm::cross(b, d)));
  }
  for (const glm::dvec3& a : by_u)
    for (const glm::dvec3& b : by_v) row_h = std::max(row_h, glm::length(glm::cross(a, b)));
  out.bend_h = static_cast<float>(row_h / row);
  const double det = std::min(std::abs(least), std::abs(most));
  out.small = static_cast<float>(0.99 * std::min(double{kGrow} * det / row, grow * det / row_h));
  row /= det;
  out.uv_a_unit = static_cast<float>(row);
  out.h_a_unit = static_cast<float>(row_h / det);
  double twist = 0, turn_u = 0, turn_v = 0;
  for (double x : h) twist = std::max(twist, glm::length(p[3] + x * n[3]));
  for (double x : t) {
    turn_u = std::max(turn_u, glm::length(n[1] + x * n[3]));
    turn_v = std::max(turn_v, glm::length(n[2] + x * n[3]));
  }
  out.bend_uv = static_cast<float>(0.5 * row * twist);
  out.bend_uh = static_cast<float>(0.5 * row * turn_u);
  out.bend_vh = static_cast<float>(0.5 * row * turn_v);

  // The body lies in the hull of its eight corners.
  std::array<glm::dvec3, 8> hull;
  double size = 0;
  for (size_t k = 0; k < 8; ++k) {
    hull[k] = points[k % 4] + (k < 4 ? low : high) * square.normals[k % 4];
    size = std::max(size, glm::length(hull[k]));
  }
  const std::array<glm::dvec3, 3> outwards{glm::cross(v, w) / most, glm::cross(w, u) / most, glm::cross(u, v) / most};
  for (size_t k = 0; k < 6; ++k) {
    const glm::dvec3 m = glm::normalize(k % 2 ? outwards[k / 2] : -outwards[k / 2]);
    double at = -std::numeric_limits<double>::infinity();
    for (const glm::dvec3& x : hull) at = std::max(at, glm::dot(m, x));
    out.plane[k] = glm::vec3(m);
    out.plane_at[k] = static_cast<float>(at + 1e-5 * size);
  }
  return true;
}

// Of one thread, kept from square to square.
struct Scratch {
  HashIndex<uint64_t> names;  // vertices of the scan by number: places in the arrays below
  std::vector<uint32_t> blocks;
  std::vector<float> x, y, z, u, v, h, moved;
  struct Placed {
    float u, v, h;
    uint32_t beyond;  // which planes; and kUnknown where (u, v, h) are not those of the grown body
  };
  std::vector<Placed> placed;
  std::vector<std::array<uint32_t, 3>> triangles;  // their vertices' places
  std::vector<uint32_t> numbers;                   // and their numbers in the scan
  // Lines by bins of (u, v): those of bin b are first[b] to first[b + 1] of what follows.
  std::vector<uint32_t> first, line, bin_of;
  std::vector<float> line_u, line_v;
  std::vector<uint32_t> nearest;  // triangle of each

  uint32_t nameOf(uint32_t vertex, const TriMesh& mesh, const glm::dvec3& middle) {
    names.makeRoom();
    const uint32_t name =
        names.findOrAdd(exactHash(vertex), static_cast<uint32_t>(x.size()), [](uint32_t) { return true; });
    if (name < x.size()) return name;
    const glm::vec3 place(glm::dvec3(mesh.positions_mm[vertex]) - middle);
    x.push_back(place.x);
    y.push_back(place.y);
    z.push_back(place.z);
    return name;
  }
  // For some number of vertices.
  void clear(size_t likely) {
    names.reset(likely + likely / 2 + 32);
    for (auto* list : {&x, &y, &z}) {
      list->clear();
      list->reserve(likely);
    }
    triangles.clear();
    numbers.clear();
  }
  // For as many vertices as there are.
  void setUpPlaces() {
    for (auto* list : {&u, &v, &h, &moved}) list->resize(x.size());
    placed.resize(x.size());
  }
};

// (u, v, h) of the vertices, how far the last step moved them, and the planes that they lie beyond. Plain loops over
// arrays: several at a time.
RELIEVO_SIMD_CLONES void placeVertices(const Body& b, Scratch& s) noexcept {
  const size_t count = s.x.size();
  const float *x = s.x.data(), *y = s.y.data(), *z = s.z.data();
  float *us = s.u.data(), *vs = s.v.data(), *hs = s.h.data(), *moved = s.moved.data();
  const std::array<glm::vec3, 4> p = b.p, n = b.n;  // copies: what is written below cannot be them
  const std::array<glm::vec3, 6> plane = b.plane;
  const std::array<float, 6> plane_at = b.plane_at;
  const float low = b.low_grown, high = b.high_grown;
  constexpr size_t kRun = 512;
  for (size_t first = 0; first < count; first += kRun) {
    const size_t last = std::min(count, first + kRun);
#pragma GCC ivdep
    for (size_t i = first; i < last; ++i) {
      us[i] = b.start[0].x * x[i] + b.start[1].x * y[i] + b.start[2].x * z[i] + b.start_at.x;
      vs[i] = b.start[0].y * x[i] + b.start[1].y * y[i] + b.start[2].y * z[i] + b.start_at.y;
      hs[i] = b.start[0].z * x[i] + b.start[1].z * y[i] + b.start[2].z * z[i] + b.start_at.z;
    }
    for (int step = 0; step < kSteps; ++step) {
#pragma GCC ivdep
      for (size_t i = first; i < last; ++i) {
        const float u = us[i], v = vs[i], h = hs[i], uv = u * v;
        const float nx = n[0].x + u * n[1].x + v * n[2].x + uv * n[3].x,
                    ny = n[0].y + u * n[1].y + v * n[2].y + uv * n[3].y,
                    nz = n[0].z + u * n[1].z + v * n[2].z + uv * n[3].z;
        const float rx = x[i] - (p[0].x + u * p[1].x + v * p[2].x + uv * p[3].x + h * nx),
                    ry = y[i] - (p[0].y + u * p[1].y + v * p[2].y + uv * p[3].y + h * ny),
                    rz = z[i] - (p[0].z + u * p[1].z + v * p[2].z + uv * p[3].z + h * nz);
        const float ax = p[1].x + v * p[3].x + h * (n[1].x + v * n[3].x),
                    ay = p[1].y + v * p[3].y + h * (n[1].y + v * n[3].y),
                    az = p[1].z + v * p[3].z + h * (n[1].z + v * n[3].z);
        const float bx = p[2].x + u * p[3].x + h * (n[2].x + u * n[3].x),
                    by = p[2].y + u * p[3].y + h * (n[2].y + u * n[3].y),
                    bz = p[2].z + u * p[3].z + h * (n[2].z + u * n[3].z);
        // Cramer's rule.
        const float cx = by * nz - bz * ny, cy = bz * nx - bx * nz, cz = bx * ny - by * nx;
        const float inverse = 1 / (ax * cx + ay * cy + az * cz);
        const float dx = ry * az - rz * ay, dy = rz * ax - rx * az, dz = rx * ay - ry * ax;  // r x a
        const float du = inverse * (rx * cx + ry * cy + rz * cz), dv = -inverse * (dx * nx + dy * ny + dz * nz),
                    dh = inverse * (dx * bx + dy * by + dz * bz);
        us[i] = u + du;
        vs[i] = v + dv;
        hs[i] = h + dh;
        moved[i] = std::abs(du) + std::abs(dv);
      }
    }
    std::array<uint32_t, kRun> code;
#pragma GCC ivdep
    for (size_t i = first; i < last; ++i) {
      uint32_t c = 0;
      for (uint32_t k = 0; k < 6; ++k)
        c |= (plane[k].x * x[i] + plane[k].y * y[i] + plane[k].z * z[i] > plane_at[k] ? 1u : 0u) << k;
      const bool known = (moved[i] < 1e-3f) & (us[i] > -kGrow) & (us[i] < 1 + kGrow) & (vs[i] > -kGrow) &
                         (vs[i] < 1 + kGrow) & (hs[i] > low) & (hs[i] < high);
      code[i - first] = c | (known ? 0u : kUnknown);
    }
    for (size_t i = first; i < last; ++i) s.placed[i] = {us[i], vs[i], hs[i], code[i - first]};
  }
}

void binLines(std::span<const SweepPlace> places, size_t bins, Scratch& s) {
  auto binOf = [&](float t) {
    return std::min(static_cast<size_t>(std::max(t, 0.0f) * static_cast<float>(bins)), bins - 1);
  };
  s.first.assign(bins * bins + 1, 0);
  s.bin_of.resize(places.size());
  for (size_t i = 0; i < places.size(); ++i) {
    s.bin_of[i] = static_cast<uint32_t>(binOf(places[i].v) * bins + binOf(places[i].u));
    ++s.first[s.bin_of[i] + 1];
  }
  for (size_t b = 0; b < bins * bins; ++b) s.first[b + 1] += s.first[b];
  for (auto* list : {&s.line_u, &s.line_v}) list->resize(places.size());
  s.line.resize(places.size());
  for (size_t i = 0; i < places.size(); ++i) {
    const uint32_t at = s.first[s.bin_of[i]]++;
    s.line[at] = static_cast<uint32_t>(i);
    s.line_u[at] = places[i].u;
    s.line_v[at] = places[i].v;
  }
  for (size_t b = bins * bins; b > 0; --b) s.first[b] = s.first[b - 1];
  s.first[0] = 0;
}

}  // namespace

LineSweep::LineSweep(const TriMesh& mesh, int workers) : mesh_(&mesh) {
  std::vector<Box> boxes((mesh.triangles.size() + kBlock - 1) / kBlock);
  constexpr size_t kBlocksAJob = 1024;
  parallelFor((boxes.size() + kBlocksAJob - 1) / kBlocksAJob, workers, nullptr, [&](size_t job) {
    for (size_t b = job * kBlocksAJob; b < std::min(boxes.size(), (job + 1) * kBlocksAJob); ++b)
      for (size_t t = b * kBlock; t < std::min(mesh.triangles.size(), (b + 1) * kBlock); ++t)
        for (uint32_t v : mesh.triangles[t]) boxes[b].add(mesh.positions_mm[v]);
  });
  blocks_ = BoxTree(std::move(boxes));
}

void LineSweep::nearest(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines,
                        std::span<SurfacePoint> hits) const {
  std::fill(hits.begin(), hits.end(), SurfacePoint{});
  if (places.empty() || nearest(square, places, lines, 1, 0, hits)) return;
  // Where lines meet one another further out, what is near at least.
  std::vector<uint32_t> left;
  for (uint32_t i = 0; i < hits.size(); ++i)
    if (!hits[i]) left.push_back(i);
  if (!left.empty()) nearestOf(square, left, places, lines, kNear, 0, hits);
}

bool LineSweep::nearestOf(const SweepSquare& square, std::span<const uint32_t> some, std::span<const SweepPlace> places,
                          std::span<const Line> lines, double share, int depth, std::span<SurfacePoint> hits) const {
  std::vector<SweepPlace> own_places(some.size());
  std::vector<Line> own_lines(some.size());
  std::vector<SurfacePoint> own_hits(some.size());
  for (size_t i = 0; i < some.size(); ++i) own_places[i] = places[some[i]], own_lines[i] = lines[some[i]];
  const bool known = nearest(square, own_places, own_lines, share, depth, own_hits);
  for (size_t i = 0; i < some.size(); ++i) hits[some[i]] = own_hits[i];
  return known;
}

bool LineSweep::nearest(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines,
                        double share, int depth, std::span<SurfacePoint> hits) const {
  constexpr int kDeepest = 2;
  if (sweep(square, places, lines, share, hits)) return true;
  if (depth == kDeepest) return false;
  bool known = true;
  // Of smaller squares lines turn less.
  for (size_t quarter = 0; quarter < 4; ++quarter) {
    const float u0 = quarter % 2 ? 0.5f : 0.0f, v0 = quarter / 2 ? 0.5f : 0.0f;
    std::vector<uint32_t> inside;
    std::vector<SweepPlace> moved(places.begin(), places.end());
    for (uint32_t i = 0; i < places.size(); ++i) {
      if ((places[i].u >= 0.5f) != (quarter % 2 == 1) || (places[i].v >= 0.5f) != (quarter / 2 == 1)) continue;
      moved[i] = {2 * (places[i].u - u0), 2 * (places[i].v - v0), places[i].start};
      inside.push_back(i);
    }
    if (inside.empty()) continue;
    SweepSquare part;
    for (size_t k = 0; k < 4; ++k) {
      const double u = u0 + (k % 2 ? 0.5 : 0.0), v = v0 + (k / 2 ? 0.5 : 0.0);
      auto at = [&](const std::array<glm::dvec3, 4>& c) {
        return (c[0] * (1 - u) + c[1] * u) * (1 - v) + (c[2] * (1 - u) + c[3] * u) * v;
      };
      part.points[k] = at(square.points);
      part.normals[k] = at(square.normals);
    }
    known = nearestOf(part, inside, moved, lines, share, depth + 1, hits) && known;
  }
  return known;
}

namespace {

// What lines through a triangle need of it.
struct Plane {
  glm::dvec3 corner, ab, ac, normal;
};
Plane planeOf(const TriMesh& mesh, uint32_t triangle) {
  const auto& t = mesh.triangles[triangle];
  const glm::dvec3 a(mesh.positions_mm[t[0]]), ab = glm::dvec3(mesh.positions_mm[t[1]]) - a,
                                               ac = glm::dvec3(mesh.positions_mm[t[2]]) - a;
  return {a, ab, ac, glm::cross(ab, ac)};
}
// How far along a line from its point; infinite where it does not face along it.
double alongLine(const Plane& plane, const Line& line) {
  const double steep = glm::dot(plane.normal, line.direction);
  return steep > 0 ? glm::dot(plane.normal, plane.corner - line.at) / steep : std::numeric_limits<double>::infinity();
}
// Inside, or on its sides. The volumes over a side, from the line's point along the line, are of either triangle at it
// the same number, but for their sign: no line is outside of both.
bool passesThrough(const TriMesh& mesh, uint32_t triangle, const Line& line) {
  std::array<glm::dvec3, 3> to;
  for (size_t k = 0; k < 3; ++k) to[k] = glm::dvec3(mesh.positions_mm[mesh.triangles[triangle][k]]) - line.at;
  for (size_t k = 0; k < 3; ++k)
    if (!(glm::dot(line.direction, glm::cross(to[k], to[k == 2 ? 0 : k + 1])) >= 0)) return false;
  return true;
}

// The triangles of the blocks that may reach into the body, and their vertices.
void listTriangles(const TriMesh& mesh, const BoxTree& blocks, const Body& body, const glm::dvec3& middle, Scratch& s) {
  const glm::vec3 centre(middle);
  const float slack = 1e-6f * glm::length(centre);
  auto wanted = [&](const Box& box) {
    const glm::vec3 m = 0.5f * (box.low + box.high) - centre, e = 0.5f * (box.high - box.low) + slack;
    for (size_t k = 0; k < 6; ++k)
      if (glm::dot(body.plane[k], m) - glm::dot(glm::abs(body.plane[k]), e) > body.plane_at[k]) return false;
    return true;
  };
  s.blocks.clear();
  s.clear(0);
  blocks.forEach(wanted, [&](size_t block) {
    s.blocks.push_back(static_cast<uint32_t>(block));
    const Box& box = blocks.part(block);
    const glm::vec3 m = 0.5f * (box.low + box.high) - centre;
    s.x.push_back(m.x);
    s.y.push_back(m.y);
    s.z.push_back(m.z);
  });
  // Planes leave much beside a curved body: small blocks are told by their middles' (u, v, h).
  s.setUpPlaces();
  placeVertices(body, s);
  size_t kept = 0;
  for (size_t i = 0; i < s.blocks.size(); ++i) {
    const Box& box = blocks.part(s.blocks[i]);
    const float reach = 0.5f * glm::length(box.high - box.low) + slack;
    if (reach < body.small) {
      const Scratch::Placed& at = s.placed[i];
      const float off = reach * body.uv_a_unit + kRounding,
                  off_h = reach * body.h_a_unit + kRounding * (body.high_grown - body.low_grown);
      if (at.beyond & kUnknown || at.u < -off || at.u > 1 + off || at.v < -off || at.v > 1 + off ||
          at.h < body.low - off_h || at.h > body.high + off_h)
        continue;
    }
    s.blocks[kept++] = s.blocks[i];
  }
  s.blocks.resize(kept);
  s.clear(s.blocks.size() * kBlock * 5 / 8);
  for (uint32_t block : s.blocks) {
    // Most triangles have two corners of the one before.
    std::array<uint32_t, 3> before{}, named{};
    bool any = false;
    for (size_t t = block * kBlock; t < std::min(mesh.triangles.size(), (block + 1) * kBlock); ++t) {
      const auto& corners = mesh.triangles[t];
      std::array<uint32_t, 3> names;
      for (size_t k = 0; k < 3; ++k) {
        const uint32_t v = corners[k];
        names[k] = any && v == before[0]   ? named[0]
                   : any && v == before[1] ? named[1]
                   : any && v == before[2] ? named[2]
                                           : s.nameOf(v, mesh, middle);
      }
      before = corners;
      named = names;
      any = true;
      s.triangles.push_back(names);
      s.numbers.push_back(static_cast<uint32_t>(t));
    }
  }
}

// Of each line, in the bins' order, the triangle whose plane it meets nearest, into s.nearest. False: too many
// triangles whose places in (u, v) are not known.
RELIEVO_SIMD_CLONES bool drawTriangles(const TriMesh& mesh, const Body& body, const std::array<glm::vec3, 4>& normals,
                                       std::span<const Line> lines, size_t bins, Scratch& s) noexcept {
  auto binOf = [&](float x) {
    return static_cast<size_t>(std::clamp(x * static_cast<float>(bins), 0.0f, static_cast<float>(bins - 1)));
  };
  size_t wide = 0;
  for (size_t i = 0; i < s.triangles.size(); ++i) {
    const auto& t = s.triangles[i];
    const Scratch::Placed &p0 = s.placed[t[0]], &p1 = s.placed[t[1]], &p2 = s.placed[t[2]];
    if (p0.beyond & p1.beyond & p2.beyond & ~kUnknown) continue;
    std::array<float, 3> u, v;
    float u_low = 0, u_high = 1, v_low = 0, v_high = 1,
          off = 0;  // off: how far from the straight sides in (u, v) the triangle may reach
    if (!((p0.beyond | p1.beyond | p2.beyond) & kUnknown)) {
      u = {p0.u, p1.u, p2.u};
      v = {p0.v, p1.v, p2.v};
      u_low = std::min({u[0], u[1], u[2]}), u_high = std::max({u[0], u[1], u[2]});
      v_low = std::min({v[0], v[1], v[2]}), v_high = std::max({v[0], v[1], v[2]});
      const float h_low = std::min({p0.h, p1.h, p2.h}), h_high = std::max({p0.h, p1.h, p2.h}), du = u_high - u_low,
                  dv = v_high - v_low, dh = h_high - h_low;
      off = body.bend_uv * du * dv + body.bend_uh * du * dh + body.bend_vh * dv * dh + kRounding;
      const float room = body.bend_h * off;
      if (u_high < -off || u_low > 1 + off || v_high < -off || v_low > 1 + off || h_high + room < body.low ||
          h_low - room > body.high)
        continue;
    } else {
      const glm::vec3 a(s.x[t[0]], s.y[t[0]], s.z[t[0]]), b(s.x[t[1]], s.y[t[1]], s.z[t[1]]),
          c(s.x[t[2]], s.y[t[2]], s.z[t[2]]);
      const float longest = std::max({glm::dot(b - a, b - a), glm::dot(c - a, c - a), glm::dot(c - b, c - b)});
      if (longest < body.small * body.small) continue;  // it does not reach into the body
      const glm::vec3 facing = glm::cross(b - a, c - a);
      // Directions are means of the corners'.
      if (std::all_of(normals.begin(), normals.end(), [&](const glm::vec3& n) { return glm::dot(facing, n) <= 0; }))
        continue;
      if (++wide > kMostWide) return false;
      u = v = {};
    }
    // Sides as seen along the lines, positive inside: side_u u + side_v v + side_at, raised by what they may be off.
    std::array<float, 3> side_u, side_v, side_at, twice_off;
    for (size_t k = 0; k < 3; ++k) {
      const size_t next = k == 2 ? 0 : k + 1;
      side_u[k] = -body.sign * (v[next] - v[k]);
      side_v[k] = body.sign * (u[next] - u[k]);
      const float near = off * (std::abs(side_u[k]) + std::abs(side_v[k]));
      side_at[k] = near - side_u[k] * u[k] - side_v[k] * v[k];
      twice_off[k] = 2 * near;
    }
    // Turned away from the lines.
    if (body.sign * (side_v[0] * side_u[1] - side_u[0] * side_v[1]) > twice_off[0] + twice_off[1]) continue;
    const uint32_t triangle = s.numbers[i];
    const size_t first_u = binOf(u_low - off), last_u = binOf(u_high + off), last_v = binOf(v_high + off);
    for (size_t row = binOf(v_low - off); row <= last_v; ++row) {
      const uint32_t end = s.first[row * bins + last_u + 1];
      for (uint32_t at = s.first[row * bins + first_u]; at < end; ++at) {
        const float x = s.line_u[at], y = s.line_v[at];
        const float w0 = side_u[0] * x + side_v[0] * y + side_at[0], w1 = side_u[1] * x + side_v[1] * y + side_at[1],
                    w2 = side_u[2] * x + side_v[2] * y + side_at[2];
        if (std::min({w0, w1, w2}) < 0) continue;
        if (!(w0 > twice_off[0] && w1 > twice_off[1] && w2 > twice_off[2]) &&
            !passesThrough(mesh, triangle, lines[s.line[at]]))
          continue;
        uint32_t& known_triangle = s.nearest[at];
        if (known_triangle != SurfacePoint::kNone) {
          const Line& line = lines[s.line[at]];
          const double here = std::abs(alongLine(planeOf(mesh, triangle), line)),
                       there = std::abs(alongLine(planeOf(mesh, known_triangle), line));
          if (!(here < there || (here == there && triangle < known_triangle))) continue;
        }
        known_triangle = triangle;
      }
    }
  }
  return true;
}

}  // namespace

bool LineSweep::sweep(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines,
                      double share, std::span<SurfacePoint> hits) const {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (size_t i = 0; i < places.size(); ++i) {
    const double likely = share * std::min(lines[i].likely, lines[i].reach);
    low = std::min(low, places[i].start - likely);
    high = std::max(high, places[i].start + likely);
  }
  glm::dvec3 middle(0);
  for (const glm::dvec3& p : square.points) middle += 0.25 * p;
  Body body;
  if (!(low <= high) || !makeBody(square, middle, low, high, body)) return false;

  static thread_local Scratch scratch;
  Scratch& s = scratch;
  listTriangles(*mesh_, blocks_, body, middle, s);
  s.setUpPlaces();
  placeVertices(body, s);
  const auto bins = static_cast<size_t>(std::clamp(std::sqrt(static_cast<double>(places.size())), 1.0, 256.0));
  binLines(places, bins, s);
  std::array<glm::vec3, 4> normals;
  for (size_t k = 0; k < 4; ++k) normals[k] = glm::vec3(square.normals[k]);
  s.nearest.assign(s.line.size(), SurfacePoint::kNone);
  if (!drawTriangles(*mesh_, body, normals, lines, bins, s)) return false;
  for (size_t at = 0; at < places.size(); ++at) {
    if (s.nearest[at] == SurfacePoint::kNone) continue;
    const Line& line = lines[s.line[at]];
    const Plane plane = planeOf(*mesh_, s.nearest[at]);
    const double steep = glm::dot(plane.normal, line.direction), area = glm::dot(plane.normal, plane.normal);
    // Not along the surface: there rounding decides.
    if (!(steep > 0) || !(steep * steep > 1e-12 * area * glm::dot(line.direction, line.direction))) continue;
    const glm::dvec3 from_corner = line.at - plane.corner;
    const double along = -glm::dot(plane.normal, from_corner) / steep;
    if (!(std::abs(along) <= share * std::min(line.likely, line.reach))) continue;
    const glm::dvec3 ap = from_corner + along * line.direction;
    SurfacePoint& hit = hits[s.line[at]];
    hit = {s.nearest[at], 0, 0, along};
    const double per_area = 1 / area;
    hit.b1 = std::clamp(glm::dot(glm::cross(ap, plane.ac), plane.normal) * per_area, 0.0, 1.0);
    hit.b2 = std::clamp(glm::dot(glm::cross(plane.ab, ap), plane.normal) * per_area, 0.0, 1.0 - hit.b1);
  }
  return true;
}

}  // namespace relievo
