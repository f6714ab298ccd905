// base_quads.h - from coarse triangles to quads: triangles are paired, what remains is split once so that all is quads, and corners slide
// on the scan until the quads are as square as their neighbours let them be.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/base_simplify.h"
#include "geometry/base_topology.h"
#include "geometry/ray_scene.h"

namespace relievo {

// A border of the scan, by the distance along it.
struct BorderLoop {
  std::vector<glm::dvec3> points;
  std::vector<double> at;  // of each point
  double length = 0;
  glm::dvec3 point(double s) const;
  double ahead(double from, double to) const;  // 0 <= x < length
};

struct QuadMesh {
  std::vector<glm::dvec3> points;
  std::vector<glm::dvec3> normals;            // of the surface near the point, for projections
  std::vector<std::array<uint32_t, 4>> quads;  // against the clock seen from outside
  std::vector<uint32_t> loop;                 // the border that a point is on; kNoIndex: none
  std::vector<double> along;                  // where on it
  std::vector<uint8_t> fixed;
};

struct BorderPlace {
  uint32_t loop = kNoIndex;
  double along = 0;
  bool fixed = false;
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

// split: every quad into four and every triangle into three (Catmull and Clark 1978); else the pairs alone, if all triangles find
// one: an empty mesh if not.
QuadMesh makeQuads(const EditMesh& mesh, std::span<const BorderLoop> loops, const std::function<BorderPlace(uint32_t)>& border_place, bool split);
void relaxQuads(QuadMesh& mesh, std::span<const BorderLoop> loops, const ScanLookup& scan, int rounds);

}  // namespace relievo
