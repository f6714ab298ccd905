// line_rasteriser.h - intersects all lines of a square of a base patch with a scan in one pass over the scan's
// triangles there. Where lines are as dense as triangles this is faster than a ray for each line, and needs no ray
// hierarchy: 2 bytes a triangle in place of 50.
//
// Method: the square's lines fill a volume, (u, v, h) -> P(u, v) + h N(u, v). Bounds of the Jacobian over the volume
// show whether lines intersect one another; if they may, smaller squares are tried, then a shorter distance, and then
// lines are left open. Otherwise each vertex of the scan in the volume has one (u, v, h), found by Newton's method, and
// each triangle is rasterised into (u, v). Lines near a triangle's side are tested in space in double precision, alike
// for both triangles at the side, so that no line slips between two.
//
// An answer is the nearest surface that faces along the line. Lines that meet nothing within the volume are left open.
// Const and thread-safe; answers do not depend on earlier calls.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <utility>

#include <glm/glm.hpp>

#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/tri_mesh.h"
#include "geometry/mesh/triangle_runs.h"

namespace relievo {

// A square's corners at (u, v) = (0,0), (1,0), (0,1), (1,1), and the lines' directions there; bilinear between.
struct RasterSquare {
  std::array<glm::dvec3, 4> points, normals;
};
// A line's position in the square, and how far its point (Line::at) lies above the square along the line.
struct RasterLine {
  float u = 0, v = 0, start = 0;
};

class LineRasteriser {
 public:
  // runs: may be shared with others.
  explicit LineRasteriser(std::shared_ptr<const TriangleRuns> runs) : runs_(std::move(runs)) {}
  // The mesh's arrays are used in place: they must outlive the rasteriser unchanged. workers: 0 is one for each core.
  LineRasteriser(const TriMesh& mesh, int workers)
      : LineRasteriser(std::make_shared<const TriangleRuns>(mesh, workers)) {}
  const std::shared_ptr<const TriangleRuns>& runs() const { return runs_; }

  // For each line, the hit with the smallest |t| <= Line::likely whose outside faces along the line;
  // SurfacePoint::kNone: left open. raster_lines and hits correspond to lines.
  void nearest(const RasterSquare& square, std::span<const RasterLine> raster_lines, std::span<const Line> lines,
               std::span<SurfacePoint> hits) const;

 private:
  bool nearest(const RasterSquare& square, std::span<const RasterLine> raster_lines, std::span<const Line> lines,
               double share, int depth, std::span<SurfacePoint> hits) const;
  bool nearestOfSubset(const RasterSquare& square, std::span<const uint32_t> subset,
                       std::span<const RasterLine> raster_lines, std::span<const Line> lines, double share, int depth,
                       std::span<SurfacePoint> hits) const;
  // Answers lines with |t| <= share * likely. False: the square is too large, and no line is answered.
  bool rasterise(const RasterSquare& square, std::span<const RasterLine> raster_lines, std::span<const Line> lines,
                 double share, std::span<SurfacePoint> hits) const;

  std::shared_ptr<const TriangleRuns> runs_;
};

}  // namespace relievo
