// corner_placement.h - assigns regions of a scan to the corners of its base mesh, and from them the corners' positions
// (on creases, if there are any) and normals. Units: diagonals of the scan.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

// What every round asks of a surface that stays: by index, in the orders of its half edges.
struct RegionTables {
  struct Neighbour {
    uint32_t vertex;
    float length;  // of the edge
  };
  struct Face {
    std::array<uint32_t, 3> vertices;
    glm::dvec3 point;         // its first corner's
    glm::dvec3 area, normal;  // of twice the triangle's area; of length 1, or 0
    double twice_area;
  };
  std::vector<glm::dvec3> points;
  std::vector<uint32_t> first;  // of each vertex's neighbours; the last is behind them all
  std::vector<Neighbour> neighbours;
  std::vector<Face> faces;
  explicit RegionTables(const TriangleMesh& surface);
};

// For each vertex of the surface the corner that is nearest along the surface; not valid: none.
using Regions = std::vector<VertexHandle>;
Regions cornerRegions(const QuadMesh& quads, const RegionTables& surface, const ScanSurface& scan);
// Moves corners to the point closest to the planes of their regions, and records the creases that they are on. Source:
void placeCorners(QuadMesh& quads, const RegionTables& surface, const Regions& regions, const ScanSurface& scan);
// Assigns the area-weighted mean normal of each corner's region, which is about half a patch wide, so that lines along
// the interpolated normals do not cross. Normals are turned towards parts that would face away from them.
void assignNormals(QuadMesh& quads, const RegionTables& surface, const Regions& regions, const ScanSurface& scan);

}  // namespace relievo
