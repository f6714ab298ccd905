// line_sweep.h - all lines of a square of a base patch against a scan at once, in one pass over the scan's triangles
// there. Where lines are as dense as triangles this takes less time than a ray each, and needs no hierarchy: 1.7 bytes
// a triangle in place of 50.
//
// How: the square's lines fill a body, (u, v, h) -> P(u, v) + h N(u, v). The body's corners tell whether no two of its
// lines meet within it and none turns back (else smaller squares are tried, then what is nearer, then nothing is
// answered). So each of the scan's vertices there has one (u, v, h), found by Newton's steps, and each triangle is
// drawn into (u, v) like into a picture. What lies near a triangle's side is decided in space, in double precision and
// alike from both triangles, so no line slips between two; where on the line a triangle lies is computed in double as
// well. Of lines that are answered no surface that faces along them lies nearer. Lines that meet nothing within the
// body are not answered. Const and thread-safe. The same whatever is asked before.
#pragma once

#include <array>
#include <span>

#include <glm/glm.hpp>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// Its corners, at (u, v) = (0,0), (1,0), (0,1), (1,1), and the lines' directions there; bilinear between.
struct SweepSquare {
  std::array<glm::dvec3, 4> points, normals;
};
// Where in the square a line is, and how far its point (Line::at) lies above the square along it.
struct SweepPlace {
  float u = 0, v = 0, start = 0;
};

class LineSweep {
 public:
  // The mesh's arrays are used in place: they must outlive this unchanged.
  LineSweep(const TriMesh& mesh, int workers);

  // Of each line the hit with the smallest |t| <= likely whose outside faces along it; SurfacePoint::kNone: not known.
  // places, hits: one a line.
  void nearest(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines,
               std::span<SurfacePoint> hits) const;

 private:
  bool nearest(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines, double share,
               int depth, std::span<SurfacePoint> hits) const;
  bool nearestOf(const SweepSquare& square, std::span<const uint32_t> some, std::span<const SweepPlace> places,
                 std::span<const Line> lines, double share, int depth, std::span<SurfacePoint> hits) const;
  // Of hits with |t| <= share * likely. False: none is known, the square is too large.
  bool sweep(const SweepSquare& square, std::span<const SweepPlace> places, std::span<const Line> lines, double share,
             std::span<SurfacePoint> hits) const;

  const TriMesh* mesh_;
  BoxTree blocks_;  // of successive triangles
};

}  // namespace relievo
