// bake_context.h - the inputs that all stages of a bake share: the scan, the base mesh over it, and the lines along the
// base's interpolated normals, on which heights are measured.
// Units: mm, in the scan's coordinates (relative to TriMesh::origin_mm). Const functions may be called from any thread.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/corner_normals.h"
#include "geometry/bake/line_rasteriser.h"
#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/sample_layout.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// A point of the base surface with the interpolated normal there, which is shorter than 1 between corners whose normals
// differ.
struct BasePoint {
  glm::dvec3 position{0}, normal{0};
};
inline glm::dvec3 lerp(const glm::dvec3& a, const glm::dvec3& b, double t) { return a * (1 - t) + b * t; }
inline BasePoint lerp(const BasePoint& a, const BasePoint& b, double t) {
  return {lerp(a.position, b.position, t), lerp(a.normal, b.normal, t)};
}

// What is linear on a triangle of a patch that is cut, from corner (0,0) by way of (1,0) or (0,1) to (1,1): `along` of
// the first side, and `across` of the second.
inline BasePoint onHalf(const BasePoint& from, const BasePoint& by, const BasePoint& to, double along, double across) {
  auto of = [&](glm::dvec3 BasePoint::*f) { return from.*f * (1 - along) + by.*f * (along - across) + to.*f * across; };
  return {of(&BasePoint::position), of(&BasePoint::normal)};
}

// Interpolates the values of a cell's four corners linearly on its two triangles, which meet along the diagonal
// (0,0)-(1,1). (fx, fy) is the position in the cell, 0 to 1.
template <class T>
T interpolateOnCell(const T& c00, const T& c10, const T& c01, const T& c11, double fx, double fy) {
  return fx >= fy ? c00 + (c10 - c00) * fx + (c11 - c10) * fy : c00 + (c01 - c00) * fy + (c11 - c01) * fx;
}

// Interpolates a grid of (n + 1)^2 values, rows of v, at (u, v), each 0 to 1.
inline double interpolateOnGrid(std::span<const uint16_t> grid, size_t n, double u, double v) {
  const double x = u * static_cast<double>(n), y = v * static_cast<double>(n);
  const size_t x0 = std::min(static_cast<size_t>(x), n - 1), y0 = std::min(static_cast<size_t>(y), n - 1);
  const uint16_t* c = grid.data() + y0 * (n + 1) + x0;
  return interpolateOnCell<double>(c[0], c[1], c[n + 1], c[n + 2], x - static_cast<double>(x0),
                                   y - static_cast<double>(y0));
}

// Splits the grid [0, side)^2 of a patch's samples into square tiles of about `target_side` samples a side. Lines are
// intersected tile by tile: what the lines of a tile meet lies close together, so that few of the scan's ray
// hierarchies, or few of its triangles, are needed at a time.
struct Tiles {
  size_t side, per_side;
  Tiles(size_t samples, size_t target_side)
      : side(samples), per_side(std::max<size_t>(1, (samples + target_side / 2) / target_side)) {}
  size_t first(size_t tile) const { return tile * side / per_side; }
  size_t tileOf(size_t sample) const {
    size_t tile = std::min(sample * per_side / side, per_side - 1);
    while (tile > 0 && first(tile) > sample) --tile;
    while (tile + 1 < per_side && first(tile + 1) <= sample) ++tile;
    return tile;
  }
  // Calls visit(x0, y0, x1, y1) for each tile [x0, x1) x [y0, y1) until it answers false. False: it did.
  template <class Visit>
  bool forEach(Visit visit) const {
    for (size_t y = 0; y < per_side; ++y)
      for (size_t x = 0; x < per_side; ++x)
        if (!visit(first(x), first(y), first(x + 1), first(y + 1))) return false;
    return true;
  }
};

// The line through a point of the base, along its normal, that is searched up to `reach` mm to both sides.
Line lineThrough(const BasePoint& f, double reach);

// The lines of one tile of a patch, which are intersected together.
struct LineBatch {
  uint32_t patch = 0;
  bool on_own_triangles = false;  // hits lie on the patch's own triangles: BakeContext::own_triangles
  std::vector<Line> lines;
  std::vector<RasterLine> raster_lines;
  std::vector<SurfacePoint> hits;
  double u0 = 0, v0 = 0, u_scale = 1, v_scale = 1;
  RasterSquare square;
  // Of a base mesh that is cut: what is linear on one side of the diagonal, and on the other, on all of the square.
  std::array<RasterSquare, 2> halves;
  size_t halfOf(size_t i) const {
    return double{raster_lines[i].v} / v_scale + v0 > double{raster_lines[i].u} / u_scale + u0;
  }
  // Lines that are intersected apart from the others: those of a half; those that the rasteriser leaves open, which are
  // traced as rays.
  struct Part {
    std::vector<size_t> of;  // places in `lines`
    std::vector<Line> lines;
    std::vector<RasterLine> raster_lines;
    std::vector<SurfacePoint> hits;
  } part;
  // The unit normal of the base's surface where the i-th line begins.
  glm::dvec3 baseNormal(size_t i) const {
    const auto& p = square.points;
    const double u = double{raster_lines[i].u}, v = double{raster_lines[i].v};
    const glm::dvec3 along_u = glm::mix(p[1] - p[0], p[3] - p[2], v), along_v = glm::mix(p[2] - p[0], p[3] - p[1], u);
    return glm::normalize(glm::cross(along_v, along_u));
  }
  void add(const Line& line, double u, double v, double start) {
    lines.push_back(line);
    raster_lines.push_back(
        {static_cast<float>((u - u0) * u_scale), static_cast<float>((v - v0) * v_scale), static_cast<float>(start)});
  }
};

struct BakeContext {
  const TriMesh* mesh;
  BaseMesh base;
  SampleLayout layout;
  int workers = 0;
  const std::atomic<bool>* interrupted = nullptr;
  Touching touching = Touching::kIgnored;  // BakeOptions
  double touch_mm = 0;                     // BakeOptions
  glm::dvec3 shift{0};                     // from the base's coordinates to the scan's
  // The next three come from makeBakeScene().
  std::shared_ptr<const RayScene> scene;
  std::shared_ptr<const LineRasteriser> rasteriser;
  std::shared_ptr<const CornerNormals> normals;
  std::vector<uint8_t> corner_used;                           // one for each corner: 1 where a patch has it
  std::vector<uint32_t> corner_patch;                         // one for each corner: its first patch
  std::vector<double> corner_reach, side_reach, patch_reach;  // mm: how far lines are searched
  // Of patches that lie on the scan and are cut, by patch: the triangles that their halves lie on, to the right of the
  // diagonal and to its left; kNone where there are no such. Empty: not looked for.
  std::vector<std::array<uint32_t, 2>> own_triangles;
  bool all_own = false;  // there are such everywhere

  BakeContext(const TriMesh& scan, const BaseMesh& over_scan);

  // Points that patches share are computed by one rule from the same numbers, whichever patch asks, so that they agree
  // bit for bit (as geometry/lod/mesh_vertex.h does).
  BasePoint cornerPoint(uint32_t index) const {
    const BaseCorner& c = base.corners[index];
    return {glm::dvec3(c.position_mm) + shift, glm::dvec3(c.normal)};
  }
  BasePoint sidePoint(std::array<uint32_t, 2> ends, double t) const {
    return lerp(cornerPoint(ends[0]), cornerPoint(ends[1]), t);
  }
  BasePoint patchPoint(uint32_t patch, double u, double v) const {
    const auto& c = base.patches[patch];
    if (base.cut)
      return onHalf(cornerPoint(c[0]), cornerPoint(c[v > u ? 2 : 1]), cornerPoint(c[3]), std::max(u, v),
                    std::min(u, v));
    return lerp(lerp(cornerPoint(c[0]), cornerPoint(c[1]), u), lerp(cornerPoint(c[2]), cornerPoint(c[3]), u), v);
  }
  // Vertex (x, y) of a patch's grid of n cells a side.
  BasePoint gridPoint(uint32_t patch, size_t x, size_t y, size_t n) const {
    const double u = static_cast<double>(x) / static_cast<double>(n),
                 v = static_cast<double>(y) / static_cast<double>(n);
    const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
    const auto& c = base.patches[patch];
    if (on_u && on_v) return cornerPoint(c[(x ? 1 : 0) + (y ? 2 : 0)]);
    if (!on_u && !on_v) return patchPoint(patch, u, v);
    const int side = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop);
    const auto [a, b] = kSideCorners[static_cast<size_t>(side)];
    const double t = on_u ? v : u;
    const uint32_t from = c[static_cast<size_t>(a)], to = c[static_cast<size_t>(b)];
    return from < to ? sidePoint({from, to}, t) : sidePoint({to, from}, 1 - t);
  }

  size_t tileSize() const {
    return rasteriser ? 128 : 64;
  }  // samples a tile's side; rasterised tiles are larger since each collects its triangles anew
  void beginBatch(LineBatch& batch, uint32_t patch, double u0, double v0, double u1, double v1) const;
  // Fills batch.hits: for each line, the nearest surface whose outside faces along it.
  void intersect(LineBatch& batch) const;
  // The scan's point that the base shows at (u, v), or else the closest one.
  SurfacePoint pointAt(uint32_t patch, double u, double v) const;
  // Of the half of a patch that is cut, at (0,0), (1,0) or (0,1), and (1,1).
  std::array<glm::dvec3, 3> cornersOfHalf(uint32_t patch, size_t half) const;
  // Sets own_triangles. False: stopped().
  bool findOwnTriangles();
  bool stopped() const { return interrupted && interrupted->load(std::memory_order_relaxed); }

 private:
  // A ball that the scan does not come into.
  struct FreeBall {
    glm::dvec3 centre{0};
    double radius = 0;
  };
  void findHits(LineBatch& batch) const;
  // Through the place of a half that lies at these weights between its corners. Of a half without area a line that
  // meets nothing.
  Line lineOnHalf(uint32_t patch, size_t half, const std::array<double, 3>& weights) const;
  // Does a half of a patch lie on that triangle?
  bool holds(const SurfacePoint& found, uint32_t patch, size_t half) const;
  // The triangle that a half of a patch lies on, which is not the one in its middle.
  uint32_t ownTriangleBesideMiddle(uint32_t patch, size_t half) const;
  // The closest point of the scan instead of a hit that is far from it, if `touching` allows it there: next to a sharp
  // edge a line may pass between the triangles' rounded coordinates, or just beside the edge, and meet another part of
  // the scan.
  SurfacePoint touchingPoint(const LineBatch& batch, size_t i, FreeBall& free) const;
  // The scan's point at the line's own origin, or the hit if there is none.
  SurfacePoint pointAtOrigin(const Line& line, SurfacePoint hit) const;
};

}  // namespace relievo
