// base_quads.h - from coarse triangles to quads: triangles are paired, what remains is split once so that all is quads,
// and corners slide on the scan until the quads are as square as their neighbours let them be.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/base_simplify.h"
#include "geometry/remesh/base_topology.h"

namespace relievo {

// Where on a feature curve a point is that is not fixed, and the next points on it; a feature curve's fixed ends are at
// 0 and at its length.
struct CurvePlace {
  uint32_t curve = kNoIndex;  // kNoIndex: on none
  double along = 0;
  uint32_t before = kNoIndex, after = kNoIndex;
};

struct QuadMesh {
  std::vector<glm::dvec3> points;
  std::vector<glm::dvec3> normals;             // of the surface near the point, for projections
  std::vector<std::array<uint32_t, 4>> quads;  // against the clock seen from outside
  std::vector<uint8_t> fixed;                  // points that stay
  std::vector<CurvePlace> place;
  std::vector<glm::dmat3> slide;  // the directions that a point may move in, those across a crease taken out; or empty
};

// The quads around each corner.
struct QuadStars {
  std::vector<uint32_t> begin, quads;
  explicit QuadStars(const QuadMesh& m);
  // The smallest sine, seen along the normals, of all angles of the quads around a corner: 1: right angles, below 0:
  // folded over.
  double leastSine(const QuadMesh& m, uint32_t corner) const;
};

// Places on the scan (a reduced one will do).
struct ScanLookup {
  const TriMesh& mesh;
  const RayScene& scene;
  glm::dvec3 corner(uint32_t triangle, int k) const { return mesh.positions_mm[mesh.triangles[triangle][k]]; }
  glm::dvec3 point(const SurfacePoint& p) const {
    return corner(p.triangle, 0) * (1 - p.b1 - p.b2) + corner(p.triangle, 1) * p.b1 + corner(p.triangle, 2) * p.b2;
  }
  glm::dvec3 normal(uint32_t triangle) const;  // of length 1
  // The surface near p that faces along n: never that of the other side of a thin wall.
  SurfacePoint project(const glm::dvec3& p, const glm::dvec3& n, double reach) const;
};

// split: every quad into four and every triangle into three (Catmull and Clark 1978); else the pairs alone, if all
// triangles find one: an empty mesh if not.
QuadMesh makeQuads(const EditMesh& mesh, std::span<const FeatureCurve> curves, bool split);
void updateNormals(QuadMesh& mesh);  // of the quads around each corner, by area
void relaxQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanLookup& scan, int rounds);

// Slides corners along borders to where the sides on either side of them stray least from the feature curve
// (deviationFromSide), where that is more than half of what it must (by feature curve).
void settleBorders(QuadMesh& mesh, std::span<const FeatureCurve> curves, std::span<const double> must);

// Moves corners whose quads fold over or come close to it, seen along mesh.normals, until they do not or no move helps.
void untangleQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanLookup& scan);

}  // namespace relievo
