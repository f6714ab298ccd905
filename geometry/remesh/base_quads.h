// base_quads.h - from coarse triangles to quads: triangles are paired, what remains is split once so that all is quads,
// and corners slide on the scan until the quads are as square as their neighbours let them be.
#pragma once

#include <span>

#include <glm/glm.hpp>

#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

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
QuadMesh makeQuads(const TriangleMesh& mesh, std::span<const FeatureCurve> curves, bool split);
void updateNormals(QuadMesh& mesh);  // of the quads around each corner, by area
void relaxQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanLookup& scan, int rounds);

// Slides corners along borders to where the sides on either side of them stray least from the feature curve
// (deviationFromSide), where that is more than half of what it must (by feature curve).
void settleBorders(QuadMesh& mesh, std::span<const FeatureCurve> curves, std::span<const double> must);

// Moves corners whose quads fold over or come close to it, seen along their normals, until they do not or no move
// helps.
void untangleQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanLookup& scan);

// The smallest sine, seen along the normals, of all angles of the quads around a corner: 1: right angles, below 0:
// folded over.
double leastSine(const QuadMesh& mesh, const SmartVertexHandle& corner);
// At the corner itself a quad folds over, or nearly.
bool folds(const QuadMesh& mesh, const SmartVertexHandle& corner);

}  // namespace relievo
