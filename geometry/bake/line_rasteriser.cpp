#include "geometry/bake/line_rasteriser.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "src/base/hash_index.h"
#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

constexpr int kSteps = 4;  // Newton iterations: from an error of a tenth of the square down to rounding
// Of the square's side: (u, v) are also computed this far outside, for triangles that cross the border.
constexpr float kMargin = 0.25f;
constexpr float kRounding = 1e-5f;   // error bound of (u, v): single precision and Newton's remainder
constexpr double kNearShare = 0.25;  // share of Line::likely for the second attempt
constexpr uint32_t kUnknownUvh = 1u << 6;
// Triangles without known (u, v) are tested against all lines, so there may only be a few.
constexpr size_t kMaxUnplaced = 32;

// The volume that the lines fill, in single precision, relative to its middle: P(u, v) = p[0] + u p[1] + v p[2] + u v
// p[3], and N(u, v) likewise.
struct LineVolume {
  std::array<glm::vec3, 4> p, n;
  glm::mat3 start;  // first approximation of (u, v, h) at x: start * x + start_at
  glm::vec3 start_at;
  float low = 0, high = 0, low_extended = 0, high_extended = 0;
  float sign = 1;  // orientation of (u, v) as seen along the lines
  // How far a segment of the given extents in u, v, h departs at most from a straight one in (u, v); in h it is
  // bend_h times as far.
  float bend_uv = 0, bend_uh = 0, bend_vh = 0;
  float bend_h = 0;
  // A triangle with no edge longer than this that reaches into the volume lies within the extended one.
  float max_small_extent = 0;
  float uv_per_mm = 0, h_per_mm = 0;  // upper bounds of the derivatives
  // The volume's bounding planes: dot(plane, x) <= plane_at for each of its points x.
  std::array<glm::vec3, 6> plane;
  std::array<float, 6> plane_at;
};

template <class V>
std::array<V, 4> coefficients(const std::array<V, 4>& c) {
  return {c[0], c[1] - c[0], c[2] - c[0], c[3] - c[1] - c[2] + c[0]};
}

// Computes the volume between the heights low and high. False: lines may intersect one another within it.
bool makeLineVolume(const RasterSquare& square, const glm::dvec3& middle, double low, double high, LineVolume& out) {
  std::array<glm::dvec3, 4> points = square.points;
  for (glm::dvec3& p : points) p -= middle;
  const auto p = coefficients(points), n = coefficients(square.normals);
  const double across = std::max(glm::length(p[1]) + glm::length(p[2]), 1e-300);
  const double normal = std::max(glm::length(n[0] + 0.5 * (n[1] + n[2]) + 0.25 * n[3]), 1e-300);
  const double margin = std::max(0.25 * (high - low), 0.125 * across / normal);
  const std::array<double, 2> t{-double{kMargin}, 1 + double{kMargin}}, h{low - margin, high + margin};
  // The derivative by u is linear in v and h, and so on: each column of the Jacobian lies in the hull of its four
  // values at the extended volume's corners, and so does its mean over any segment in it. A determinant is linear in
  // each column: if all 64 have one sign, none of those means is singular, and no two (u, v, h) give the same point.
  std::array<glm::dvec3, 4> by_u, by_v, by_h;
  for (size_t i = 0; i < 2; ++i)
    for (size_t k = 0; k < 2; ++k) {
      by_u[2 * i + k] = p[1] + t[i] * p[3] + h[k] * (n[1] + t[i] * n[3]);
      by_v[2 * i + k] = p[2] + t[i] * p[3] + h[k] * (n[2] + t[i] * n[3]);
      by_h[2 * i + k] = n[0] + t[k] * n[1] + t[i] * n[2] + t[i] * t[k] * n[3];
    }
  double min_det = std::numeric_limits<double>::infinity(), max_det = -min_det;
  for (const glm::dvec3& a : by_u)
    for (const glm::dvec3& b : by_v) {
      const glm::dvec3 c = glm::cross(a, b);
      for (const glm::dvec3& d : by_h) {
        const double det = glm::dot(c, d);
        min_det = std::min(min_det, det);
        max_det = std::max(max_det, det);
      }
    }
  // Nearly singular volumes are rejected, too, for the convergence of Newton's method and the bounds below.
  constexpr double kMinDetRatio = 0.1;
  if (!(min_det > kMinDetRatio * max_det && min_det > 0) && !(max_det < kMinDetRatio * min_det && max_det < 0))
    return false;
  out.sign = min_det > 0 ? 1.0f : -1.0f;
  for (size_t k = 0; k < 4; ++k) out.p[k] = glm::vec3(p[k]), out.n[k] = glm::vec3(n[k]);
  out.low = static_cast<float>(low);
  out.high = static_cast<float>(high);
  out.low_extended = static_cast<float>(h[0]);
  out.high_extended = static_cast<float>(h[1]);

  const double mid = 0.5 * (low + high);
  const glm::dvec3 u = p[1] + 0.5 * p[3] + mid * (n[1] + 0.5 * n[3]), v = p[2] + 0.5 * p[3] + mid * (n[2] + 0.5 * n[3]);
  const glm::dvec3 w = n[0] + 0.5 * (n[1] + n[2]) + 0.25 * n[3];
  const glm::dvec3 centre = p[0] + 0.5 * (p[1] + p[2]) + 0.25 * p[3] + mid * w;
  const glm::dmat3 inverse = glm::inverse(glm::dmat3(u, v, w));
  out.start = glm::mat3(inverse);
  out.start_at = glm::vec3(glm::dvec3(0.5, 0.5, mid) - inverse * centre);

  // A straight segment x(s), s in [0, 1], has parameters q(s) with J q'' = -D2(q', q'), which depart from q's straight
  // segment by at most max |q''| / 8. The rows of the inverse of J for u and v are cross(by_v, by_h) / det and so on:
  // bounded by their largest length and the least determinant. The bound is doubled for the changes of q'.
  double row = 0, row_h = 0;
  for (const glm::dvec3& d : by_h) {
    for (const glm::dvec3& a : by_u) row = std::max(row, glm::length(glm::cross(a, d)));
    for (const glm::dvec3& b : by_v) row = std::max(row, glm::length(glm::cross(b, d)));
  }
  for (const glm::dvec3& a : by_u)
    for (const glm::dvec3& b : by_v) row_h = std::max(row_h, glm::length(glm::cross(a, b)));
  out.bend_h = static_cast<float>(row_h / row);
  const double det = std::min(std::abs(min_det), std::abs(max_det));
  out.max_small_extent = static_cast<float>(0.99 * std::min(double{kMargin} * det / row, margin * det / row_h));
  row /= det;
  out.uv_per_mm = static_cast<float>(row);
  out.h_per_mm = static_cast<float>(row_h / det);
  double twist = 0, turn_u = 0, turn_v = 0;
  for (double x : h) twist = std::max(twist, glm::length(p[3] + x * n[3]));
  for (double x : t) {
    turn_u = std::max(turn_u, glm::length(n[1] + x * n[3]));
    turn_v = std::max(turn_v, glm::length(n[2] + x * n[3]));
  }
  out.bend_uv = static_cast<float>(0.5 * row * twist);
  out.bend_uh = static_cast<float>(0.5 * row * turn_u);
  out.bend_vh = static_cast<float>(0.5 * row * turn_v);

  // The volume lies in the hull of its eight corners.
  std::array<glm::dvec3, 8> hull;
  double size = 0;
  for (size_t k = 0; k < 8; ++k) {
    hull[k] = points[k % 4] + (k < 4 ? low : high) * square.normals[k % 4];
    size = std::max(size, glm::length(hull[k]));
  }
  const std::array<glm::dvec3, 3> outwards{glm::cross(v, w) / max_det, glm::cross(w, u) / max_det,
                                           glm::cross(u, v) / max_det};
  for (size_t k = 0; k < 6; ++k) {
    const glm::dvec3 m = glm::normalize(k % 2 ? outwards[k / 2] : -outwards[k / 2]);
    double at = -std::numeric_limits<double>::infinity();
    for (const glm::dvec3& x : hull) at = std::max(at, glm::dot(m, x));
    out.plane[k] = glm::vec3(m);
    out.plane_at[k] = static_cast<float>(at + 1e-5 * size);
  }
  return true;
}

// One for each thread, reused from square to square so that its vectors keep their capacity.
struct Scratch {
  HashIndex<uint64_t> local_index;  // by a vertex's number in the scan: its index in the arrays below
  std::vector<uint32_t> blocks;
  std::vector<float> x, y, z, u, v, h, moved;
  struct VertexUvh {
    float u, v, h;
    uint32_t outside;  // bits of the planes that the vertex lies outside of; kUnknownUvh: (u, v, h) are not within the
                       // extended volume
  };
  std::vector<VertexUvh> vertex_uvh;
  std::vector<std::array<uint32_t, 3>> triangles;  // local indices of their vertices
  std::vector<uint32_t> triangle_numbers;          // their numbers in the scan
  // Lines sorted by bins of (u, v): bin b has the lines first[b] to first[b + 1].
  std::vector<uint32_t> first, line, bin_of;
  std::vector<float> line_u, line_v;
  std::vector<uint32_t> nearest;  // for each sorted line its nearest triangle

  uint32_t localIndexOf(uint32_t vertex, const TriMesh& mesh, const glm::dvec3& middle) {
    local_index.makeRoom();
    const uint32_t index =
        local_index.findOrAdd(exactHash(vertex), static_cast<uint32_t>(x.size()), [](uint32_t) { return true; });
    if (index < x.size()) return index;
    const glm::vec3 position(glm::dvec3(mesh.positions_mm[vertex]) - middle);
    x.push_back(position.x);
    y.push_back(position.y);
    z.push_back(position.z);
    return index;
  }
  // likely: the expected number of vertices.
  void clear(size_t likely) {
    local_index.reset(likely + likely / 2 + 32);
    for (auto* list : {&x, &y, &z}) {
      list->clear();
      list->reserve(likely);
    }
    triangles.clear();
    triangle_numbers.clear();
  }
  // For computeVertexUvh(), which may not allocate.
  void allocateUvh() {
    for (auto* list : {&u, &v, &h, &moved}) list->resize(x.size());
    vertex_uvh.resize(x.size());
  }
};

// Computes the vertices' (u, v, h), the length of the last Newton step, and the planes that they lie outside of. Plain
// loops over arrays, which compile to SIMD.
RELIEVO_SIMD_CLONES void computeVertexUvh(const LineVolume& b, Scratch& s) noexcept {
  const size_t count = s.x.size();
  const float *x = s.x.data(), *y = s.y.data(), *z = s.z.data();
  float *us = s.u.data(), *vs = s.v.data(), *hs = s.h.data(), *moved = s.moved.data();
  const std::array<glm::vec3, 4> p = b.p, n = b.n;  // copies, which the compiler knows not to alias the output
  const std::array<glm::vec3, 6> plane = b.plane;
  const std::array<float, 6> plane_at = b.plane_at;
  const float low = b.low_extended, high = b.high_extended;
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
        // Solves for the step by Cramer's rule.
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
      const bool known = (moved[i] < 1e-3f) & (us[i] > -kMargin) & (us[i] < 1 + kMargin) & (vs[i] > -kMargin) &
                         (vs[i] < 1 + kMargin) & (hs[i] > low) & (hs[i] < high);
      code[i - first] = c | (known ? 0u : kUnknownUvh);
    }
    for (size_t i = first; i < last; ++i) s.vertex_uvh[i] = {us[i], vs[i], hs[i], code[i - first]};
  }
}

void binLines(std::span<const RasterLine> raster_lines, size_t bins, Scratch& s) {
  auto binOf = [&](float t) {
    return std::min(static_cast<size_t>(std::max(t, 0.0f) * static_cast<float>(bins)), bins - 1);
  };
  s.first.assign(bins * bins + 1, 0);
  s.bin_of.resize(raster_lines.size());
  for (size_t i = 0; i < raster_lines.size(); ++i) {
    s.bin_of[i] = static_cast<uint32_t>(binOf(raster_lines[i].v) * bins + binOf(raster_lines[i].u));
    ++s.first[s.bin_of[i] + 1];
  }
  for (size_t b = 0; b < bins * bins; ++b) s.first[b + 1] += s.first[b];
  for (auto* list : {&s.line_u, &s.line_v}) list->resize(raster_lines.size());
  s.line.resize(raster_lines.size());
  for (size_t i = 0; i < raster_lines.size(); ++i) {
    const uint32_t at = s.first[s.bin_of[i]]++;
    s.line[at] = static_cast<uint32_t>(i);
    s.line_u[at] = raster_lines[i].u;
    s.line_v[at] = raster_lines[i].v;
  }
  for (size_t b = bins * bins; b > 0; --b) s.first[b] = s.first[b - 1];
  s.first[0] = 0;
}

}  // namespace

void LineRasteriser::nearest(const RasterSquare& square, std::span<const RasterLine> raster_lines,
                             std::span<const Line> lines, std::span<SurfacePoint> hits) const {
  std::fill(hits.begin(), hits.end(), SurfacePoint{});
  if (raster_lines.empty() || nearest(square, raster_lines, lines, 1, 0, hits)) return;
  // Lines may intersect further out only: the second attempt searches a shorter distance.
  std::vector<uint32_t> left;
  for (uint32_t i = 0; i < hits.size(); ++i)
    if (!hits[i]) left.push_back(i);
  if (!left.empty()) nearestOfSubset(square, left, raster_lines, lines, kNearShare, 0, hits);
}

bool LineRasteriser::nearestOfSubset(const RasterSquare& square, std::span<const uint32_t> subset,
                                     std::span<const RasterLine> raster_lines, std::span<const Line> lines,
                                     double share, int depth, std::span<SurfacePoint> hits) const {
  std::vector<RasterLine> own_raster_lines(subset.size());
  std::vector<Line> own_lines(subset.size());
  std::vector<SurfacePoint> own_hits(subset.size());
  for (size_t i = 0; i < subset.size(); ++i)
    own_raster_lines[i] = raster_lines[subset[i]], own_lines[i] = lines[subset[i]];
  const bool resolved = nearest(square, own_raster_lines, own_lines, share, depth, own_hits);
  for (size_t i = 0; i < subset.size(); ++i) hits[subset[i]] = own_hits[i];
  return resolved;
}

bool LineRasteriser::nearest(const RasterSquare& square, std::span<const RasterLine> raster_lines,
                             std::span<const Line> lines, double share, int depth, std::span<SurfacePoint> hits) const {
  constexpr int kMaxDepth = 2;
  if (rasterise(square, raster_lines, lines, share, hits)) return true;
  if (depth == kMaxDepth) return false;
  bool resolved = true;
  // Lines turn less over smaller squares.
  for (size_t quarter = 0; quarter < 4; ++quarter) {
    const float u0 = quarter % 2 ? 0.5f : 0.0f, v0 = quarter / 2 ? 0.5f : 0.0f;
    std::vector<uint32_t> inside;
    std::vector<RasterLine> moved(raster_lines.begin(), raster_lines.end());
    for (uint32_t i = 0; i < raster_lines.size(); ++i) {
      if ((raster_lines[i].u >= 0.5f) != (quarter % 2 == 1) || (raster_lines[i].v >= 0.5f) != (quarter / 2 == 1))
        continue;
      moved[i] = {2 * (raster_lines[i].u - u0), 2 * (raster_lines[i].v - v0), raster_lines[i].start};
      inside.push_back(i);
    }
    if (inside.empty()) continue;
    RasterSquare part;
    for (size_t k = 0; k < 4; ++k) {
      const double u = u0 + (k % 2 ? 0.5 : 0.0), v = v0 + (k / 2 ? 0.5 : 0.0);
      auto at = [&](const std::array<glm::dvec3, 4>& c) {
        return (c[0] * (1 - u) + c[1] * u) * (1 - v) + (c[2] * (1 - u) + c[3] * u) * v;
      };
      part.points[k] = at(square.points);
      part.normals[k] = at(square.normals);
    }
    resolved = nearestOfSubset(part, inside, moved, lines, share, depth + 1, hits) && resolved;
  }
  return resolved;
}

namespace {

// A triangle's plane.
struct TrianglePlane {
  glm::dvec3 corner, ab, ac, normal;
};
TrianglePlane trianglePlane(const TriMesh& mesh, uint32_t triangle) {
  const auto& t = mesh.triangles[triangle];
  const glm::dvec3 a(mesh.positions_mm[t[0]]), ab = glm::dvec3(mesh.positions_mm[t[1]]) - a,
                                               ac = glm::dvec3(mesh.positions_mm[t[2]]) - a;
  return {a, ab, ac, glm::cross(ab, ac)};
}
// The parameter t at which a line meets the plane; infinite if the triangle's outside does not face along it.
double alongLine(const TrianglePlane& plane, const Line& line) {
  const double steep = glm::dot(plane.normal, line.direction);
  return steep > 0 ? glm::dot(plane.normal, plane.corner - line.at) / steep : std::numeric_limits<double>::infinity();
}
// Does the line pass through the triangle or its border? The signed volumes over a side, from the line's point along
// the line, have the same magnitude for both triangles at it, so that no line is outside of both.
bool passesThrough(const TriMesh& mesh, uint32_t triangle, const Line& line) {
  std::array<glm::dvec3, 3> to;
  for (size_t k = 0; k < 3; ++k) to[k] = glm::dvec3(mesh.positions_mm[mesh.triangles[triangle][k]]) - line.at;
  for (size_t k = 0; k < 3; ++k)
    if (!(glm::dot(line.direction, glm::cross(to[k], to[k == 2 ? 0 : k + 1])) >= 0)) return false;
  return true;
}

// Collects the triangles of all blocks that may reach into the volume, and their vertices.
void collectTriangles(const TriangleRuns& runs, const LineVolume& volume, const glm::dvec3& middle, Scratch& s) {
  const TriMesh& mesh = runs.mesh();
  const BoxTree& blocks = runs.boxes();
  const glm::vec3 centre(middle);
  const float rounding = 1e-6f * glm::length(centre);
  auto overlaps = [&](const Box& box) {
    const glm::vec3 m = 0.5f * (box.low + box.high) - centre, e = 0.5f * (box.high - box.low) + rounding;
    for (size_t k = 0; k < 6; ++k)
      if (glm::dot(volume.plane[k], m) - glm::dot(glm::abs(volume.plane[k]), e) > volume.plane_at[k]) return false;
    return true;
  };
  s.blocks.clear();
  s.clear(0);
  blocks.forEach(overlaps, [&](size_t block) {
    s.blocks.push_back(static_cast<uint32_t>(block));
    const Box box = blocks.part(block);
    const glm::vec3 m = 0.5f * (box.low + box.high) - centre;
    s.x.push_back(m.x);
    s.y.push_back(m.y);
    s.z.push_back(m.z);
  });
  // The planes are loose around a curved volume: small blocks are culled by the (u, v, h) of their centres.
  s.allocateUvh();
  computeVertexUvh(volume, s);
  size_t kept = 0;
  for (size_t i = 0; i < s.blocks.size(); ++i) {
    const Box box = blocks.part(s.blocks[i]);
    const float reach = 0.5f * glm::length(box.high - box.low) + rounding;
    if (reach < volume.max_small_extent) {
      const Scratch::VertexUvh& at = s.vertex_uvh[i];
      const float slack_uv = reach * volume.uv_per_mm + kRounding,
                  slack_h = reach * volume.h_per_mm + kRounding * (volume.high_extended - volume.low_extended);
      if (at.outside & kUnknownUvh || at.u < -slack_uv || at.u > 1 + slack_uv || at.v < -slack_uv ||
          at.v > 1 + slack_uv || at.h < volume.low - slack_h || at.h > volume.high + slack_h)
        continue;
    }
    s.blocks[kept++] = s.blocks[i];
  }
  s.blocks.resize(kept);
  s.clear(s.blocks.size() * TriangleRuns::kRun * 5 / 8);
  for (uint32_t block : s.blocks) {
    // Most triangles share two vertices with the one before.
    std::array<uint32_t, 3> previous{}, previous_locals{};
    bool any = false;
    for (size_t i = 0, count = runs.sizeOf(block); i < count; ++i) {
      const uint32_t t = runs.triangle(block, i);
      const auto& corners = mesh.triangles[t];
      std::array<uint32_t, 3> locals;
      for (size_t k = 0; k < 3; ++k) {
        const uint32_t v = corners[k];
        locals[k] = any && v == previous[0]   ? previous_locals[0]
                    : any && v == previous[1] ? previous_locals[1]
                    : any && v == previous[2] ? previous_locals[2]
                                              : s.localIndexOf(v, mesh, middle);
      }
      previous = corners;
      previous_locals = locals;
      any = true;
      s.triangles.push_back(locals);
      s.triangle_numbers.push_back(t);
    }
  }
}

// Rasterises the triangles into (u, v). For each sorted line the triangle with the nearest intersection goes to
// s.nearest. False: too many triangles without known (u, v).
RELIEVO_SIMD_CLONES bool rasteriseTriangles(const TriMesh& mesh, const LineVolume& volume,
                                            const std::array<glm::vec3, 4>& normals, std::span<const Line> lines,
                                            size_t bins, Scratch& s) noexcept {
  auto binOf = [&](float x) {
    return static_cast<size_t>(std::clamp(x * static_cast<float>(bins), 0.0f, static_cast<float>(bins - 1)));
  };
  size_t unplaced = 0;
  for (size_t i = 0; i < s.triangles.size(); ++i) {
    const auto& t = s.triangles[i];
    const Scratch::VertexUvh &p0 = s.vertex_uvh[t[0]], &p1 = s.vertex_uvh[t[1]], &p2 = s.vertex_uvh[t[2]];
    if (p0.outside & p1.outside & p2.outside & ~kUnknownUvh) continue;
    std::array<float, 3> u, v;
    float u_low = 0, u_high = 1, v_low = 0, v_high = 1,
          slack = 0;  // slack: how far the triangle may reach beyond its straight sides in (u, v)
    if (!((p0.outside | p1.outside | p2.outside) & kUnknownUvh)) {
      u = {p0.u, p1.u, p2.u};
      v = {p0.v, p1.v, p2.v};
      u_low = std::min({u[0], u[1], u[2]}), u_high = std::max({u[0], u[1], u[2]});
      v_low = std::min({v[0], v[1], v[2]}), v_high = std::max({v[0], v[1], v[2]});
      const float h_low = std::min({p0.h, p1.h, p2.h}), h_high = std::max({p0.h, p1.h, p2.h}), du = u_high - u_low,
                  dv = v_high - v_low, dh = h_high - h_low;
      slack = volume.bend_uv * du * dv + volume.bend_uh * du * dh + volume.bend_vh * dv * dh + kRounding;
      const float room = volume.bend_h * slack;
      if (u_high < -slack || u_low > 1 + slack || v_high < -slack || v_low > 1 + slack || h_high + room < volume.low ||
          h_low - room > volume.high)
        continue;
    } else {
      const glm::vec3 a(s.x[t[0]], s.y[t[0]], s.z[t[0]]), b(s.x[t[1]], s.y[t[1]], s.z[t[1]]),
          c(s.x[t[2]], s.y[t[2]], s.z[t[2]]);
      const float longest = std::max({glm::dot(b - a, b - a), glm::dot(c - a, c - a), glm::dot(c - b, c - b)});
      if (longest < volume.max_small_extent * volume.max_small_extent) continue;  // it lies outside of the volume
      const glm::vec3 facing = glm::cross(b - a, c - a);
      // The lines' directions are convex combinations of the corners' normals.
      if (std::all_of(normals.begin(), normals.end(), [&](const glm::vec3& n) { return glm::dot(facing, n) <= 0; }))
        continue;
      if (++unplaced > kMaxUnplaced) return false;
      u = v = {};
    }
    // Edge functions as seen along the lines, positive inside: side_u u + side_v v + side_at, raised by the slack.
    std::array<float, 3> side_u, side_v, side_at, twice_slack;
    for (size_t k = 0; k < 3; ++k) {
      const size_t next = k == 2 ? 0 : k + 1;
      side_u[k] = -volume.sign * (v[next] - v[k]);
      side_v[k] = volume.sign * (u[next] - u[k]);
      const float side_slack = slack * (std::abs(side_u[k]) + std::abs(side_v[k]));
      side_at[k] = side_slack - side_u[k] * u[k] - side_v[k] * v[k];
      twice_slack[k] = 2 * side_slack;
    }
    // The triangle faces away from the lines.
    if (volume.sign * (side_v[0] * side_u[1] - side_u[0] * side_v[1]) > twice_slack[0] + twice_slack[1]) continue;
    const uint32_t triangle = s.triangle_numbers[i];
    const size_t first_u = binOf(u_low - slack), last_u = binOf(u_high + slack), last_v = binOf(v_high + slack);
    for (size_t row = binOf(v_low - slack); row <= last_v; ++row) {
      const uint32_t end = s.first[row * bins + last_u + 1];
      for (uint32_t at = s.first[row * bins + first_u]; at < end; ++at) {
        const float x = s.line_u[at], y = s.line_v[at];
        const float w0 = side_u[0] * x + side_v[0] * y + side_at[0], w1 = side_u[1] * x + side_v[1] * y + side_at[1],
                    w2 = side_u[2] * x + side_v[2] * y + side_at[2];
        if (std::min({w0, w1, w2}) < 0) continue;
        if (!(w0 > twice_slack[0] && w1 > twice_slack[1] && w2 > twice_slack[2]) &&
            !passesThrough(mesh, triangle, lines[s.line[at]]))
          continue;
        uint32_t& nearest_triangle = s.nearest[at];
        if (nearest_triangle != SurfacePoint::kNone) {
          const Line& line = lines[s.line[at]];
          const double distance = std::abs(alongLine(trianglePlane(mesh, triangle), line)),
                       nearest_distance = std::abs(alongLine(trianglePlane(mesh, nearest_triangle), line));
          if (!(distance < nearest_distance || (distance == nearest_distance && triangle < nearest_triangle))) continue;
        }
        nearest_triangle = triangle;
      }
    }
  }
  return true;
}

}  // namespace

bool LineRasteriser::rasterise(const RasterSquare& square, std::span<const RasterLine> raster_lines,
                               std::span<const Line> lines, double share, std::span<SurfacePoint> hits) const {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (size_t i = 0; i < raster_lines.size(); ++i) {
    const double likely = share * std::min(lines[i].likely, lines[i].reach);
    low = std::min(low, raster_lines[i].start - likely);
    high = std::max(high, raster_lines[i].start + likely);
  }
  glm::dvec3 middle(0);
  for (const glm::dvec3& p : square.points) middle += 0.25 * p;
  LineVolume volume;
  if (!(low <= high) || !makeLineVolume(square, middle, low, high, volume)) return false;

  static thread_local Scratch scratch;
  Scratch& s = scratch;
  const TriMesh& mesh = runs_->mesh();
  collectTriangles(*runs_, volume, middle, s);
  s.allocateUvh();
  computeVertexUvh(volume, s);
  const auto bins = static_cast<size_t>(std::clamp(std::sqrt(static_cast<double>(raster_lines.size())), 1.0, 256.0));
  binLines(raster_lines, bins, s);
  std::array<glm::vec3, 4> normals;
  for (size_t k = 0; k < 4; ++k) normals[k] = glm::vec3(square.normals[k]);
  s.nearest.assign(s.line.size(), SurfacePoint::kNone);
  if (!rasteriseTriangles(mesh, volume, normals, lines, bins, s)) return false;
  for (size_t at = 0; at < raster_lines.size(); ++at) {
    if (s.nearest[at] == SurfacePoint::kNone) continue;
    const Line& line = lines[s.line[at]];
    const TrianglePlane plane = trianglePlane(mesh, s.nearest[at]);
    const double steep = glm::dot(plane.normal, line.direction), area = glm::dot(plane.normal, plane.normal);
    // A line along the surface is left open: rounding would decide.
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
