// bake_ground.h - what every stage of a bake looks at: the scan, the base mesh over it, and the lines along the base's
// interpolated normals. Unit: mm, in the scan's coordinates. Const: any thread.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/line_sweep.h"
#include "geometry/bake/sample_layout.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// A place of the base surface and the line through it.
struct LineFrame {
  glm::dvec3 point{0}, normal{0};
};
inline glm::dvec3 lerp(const glm::dvec3& a, const glm::dvec3& b, double t) { return a * (1 - t) + b * t; }
inline LineFrame lerp(const LineFrame& a, const LineFrame& b, double t) {
  return {lerp(a.point, b.point, t), lerp(a.normal, b.normal, t)};
}

// Linear on the triangles of a cell, cut along (0,0)-(1,1).
template <class T>
T onCell(const T& c00, const T& c10, const T& c01, const T& c11, double fx, double fy) {
  return fx >= fy ? c00 + (c10 - c00) * fx + (c11 - c10) * fy : c00 + (c01 - c00) * fy + (c11 - c01) * fx;
}

// A grid of n cells a side at (u, v), its cells' triangles linear.
inline double onGrid(std::span<const uint16_t> grid, size_t n, double u, double v) {
  const double x = u * static_cast<double>(n), y = v * static_cast<double>(n);
  const size_t x0 = std::min(static_cast<size_t>(x), n - 1), y0 = std::min(static_cast<size_t>(y), n - 1);
  const uint16_t* c = grid.data() + y0 * (n + 1) + x0;
  return onCell<double>(c[0], c[1], c[n + 1], c[n + 2], x - static_cast<double>(x0), y - static_cast<double>(y0));
}

// Lines are looked up by squares of a patch: what they meet lies together, so that few of the scan's hierarchies are
// needed at a time, or few of its triangles swept. Of [0, side)^2, some `wanted` each way.
struct Tiles {
  size_t side, parts;
  Tiles(size_t places, size_t wanted) : side(places), parts(std::max<size_t>(1, (places + wanted / 2) / wanted)) {}
  size_t first(size_t part) const { return part * side / parts; }
  size_t of(size_t place) const {
    size_t part = std::min(place * parts / side, parts - 1);
    while (part > 0 && first(part) > place) --part;
    while (part + 1 < parts && first(part + 1) <= place) ++part;
    return part;
  }
  // visit(x0, y0, x1, y1), until it answers false.
  template <class Visit>
  bool forEach(Visit visit) const {
    for (size_t y = 0; y < parts; ++y)
      for (size_t x = 0; x < parts; ++x)
        if (!visit(first(x), first(y), first(x + 1), first(y + 1))) return false;
    return true;
  }
};

// The line through a place that looks as far as `reach`, mm, to both sides. Normals between opposed ones are short.
Line lineOf(const LineFrame& f, double reach);

// Lines of a square of a patch that are asked for together.
struct LineLookup {
  std::vector<Line> lines;
  std::vector<SweepPlace> places;
  std::vector<SurfacePoint> hits;
  double u0 = 0, v0 = 0, u_scale = 1, v_scale = 1;
  SweepSquare square;
  // Rays for what is not swept.
  std::vector<Line> left;
  std::vector<SurfacePoint> left_hits;
  void add(const Line& line, double u, double v, double start) {
    lines.push_back(line);
    places.push_back(
        {static_cast<float>((u - u0) * u_scale), static_cast<float>((v - v0) * v_scale), static_cast<float>(start)});
  }
};

struct BakeGround {
  const TriMesh* mesh;
  BaseMesh base;
  SampleLayout layout;
  int workers = 0;
  const std::atomic<bool>* interrupted = nullptr;
  glm::dvec3 shift{0};  // from the base's coordinates to the mesh's
  // Of makeBakeScene().
  std::shared_ptr<const RayScene> scene;
  std::shared_ptr<const LineSweep> sweep;
  std::shared_ptr<const std::vector<glm::vec3>> normals;      // of the mesh's vertices
  std::vector<uint8_t> used;                                  // by corner: has it a patch?
  std::vector<uint32_t> corner_patch;                         // the first, of those used
  std::vector<double> corner_reach, side_reach, patch_reach;  // mm: how far lines look

  BakeGround(const TriMesh& scan, const BaseMesh& over_scan);

  // Shared places are computed by one rule from the same numbers, whichever patch asks (as geometry/lod/mesh_vertex.h
  // does).
  LineFrame corner(uint32_t index) const {
    const BaseCorner& c = base.corners[index];
    return {glm::dvec3(c.position_mm) + shift, glm::dvec3(c.normal)};
  }
  LineFrame onSide(std::array<uint32_t, 2> ends, double t) const { return lerp(corner(ends[0]), corner(ends[1]), t); }
  LineFrame inside(uint32_t patch, double u, double v) const {
    const auto& c = base.patches[patch];
    return lerp(lerp(corner(c[0]), corner(c[1]), u), lerp(corner(c[2]), corner(c[3]), u), v);
  }
  // Vertex (x, y) of a grid of n cells a side.
  LineFrame at(uint32_t patch, size_t x, size_t y, size_t n) const {
    const double u = static_cast<double>(x) / static_cast<double>(n),
                 v = static_cast<double>(y) / static_cast<double>(n);
    const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
    const auto& c = base.patches[patch];
    if (on_u && on_v) return corner(c[(x ? 1 : 0) + (y ? 2 : 0)]);
    if (!on_u && !on_v) return inside(patch, u, v);
    const int side = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop);
    const auto [a, b] = kSideCorners[static_cast<size_t>(side)];
    const double t = on_u ? v : u;
    const uint32_t from = c[static_cast<size_t>(a)], to = c[static_cast<size_t>(b)];
    return from < to ? onSide({from, to}, t) : onSide({to, from}, 1 - t);
  }

  size_t tile() const { return sweep ? 128 : 64; }  // places a side that are looked up together
  void begin(LineLookup& look, uint32_t patch, double u0, double v0, double u1, double v1) const;
  // The nearest surface that faces along each line.
  void find(LineLookup& look) const;
  bool stopped() const { return interrupted && interrupted->load(std::memory_order_relaxed); }
};

}  // namespace relievo
