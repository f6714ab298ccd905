// base_quads.h - turns coarse triangles into quads: triangles are paired, the rest is split once so that all faces are
// quads, and corners slide on the scan until the quads are as square as their neighbours permit. Sources: Remacle et
// al. 2012, "Blossom-Quad"; Catmull and Clark 1978.
#pragma once

#include <span>

#include <glm/glm.hpp>

#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

// Queries on the scan's surface, or on a reduced copy.
struct ScanSurface {
  const TriMesh& mesh;
  const RayScene& scene;
  glm::dvec3 corner(uint32_t triangle, int k) const { return mesh.positions_mm[mesh.triangles[triangle][k]]; }
  glm::dvec3 point(const SurfacePoint& p) const {
    return corner(p.triangle, 0) * (1 - p.b1 - p.b2) + corner(p.triangle, 1) * p.b1 + corner(p.triangle, 2) * p.b2;
  }
  glm::dvec3 normal(uint32_t triangle) const;  // of length 1
  // The surface point near p that faces along n, so that it is never on the other side of a thin wall.
  SurfacePoint project(const glm::dvec3& p, const glm::dvec3& n, double reach) const;
};

// Pairs triangles into quads. split: each quad is split into four and each remaining triangle into three (Catmull and
// Clark 1978). Without it the result is empty unless all triangles find a partner.
QuadMesh makeQuads(const TriangleMesh& mesh, std::span<const FeatureCurve> curves, bool split);
void updateNormals(QuadMesh& mesh);  // area-weighted mean over the quads around each corner
void relaxQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanSurface& scan, int rounds);

// Slides corners along borders to where the feature curve deviates least from the sides beside them
// (deviationFromSide), if it deviates by more than half of the allowed deviation (one for each feature curve).
void fitBorderCorners(QuadMesh& mesh, std::span<const FeatureCurve> curves, std::span<const double> allowed);

// Moves corners whose quads fold over, or nearly, as seen along their normals, until no move helps.
void untangleQuads(QuadMesh& mesh, std::span<const FeatureCurve> curves, const ScanSurface& scan);

// The smallest sine of all angles of the quads around a corner, as seen along the normals. 1: right angles; below 0:
// folded over.
double minSine(const QuadMesh& mesh, const SmartVertexHandle& corner);
// Does a quad fold over, or nearly, at the corner itself?
bool isFolded(const QuadMesh& mesh, const SmartVertexHandle& corner);

}  // namespace relievo
