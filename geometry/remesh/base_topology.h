// base_topology.h - a scan's connectivity, made explicit: pieces, border loops, one winding a piece, one fan of
// triangles a vertex. Of whole scans, which may have millions of triangles; what they are reduced to is OpenMesh's
// (coarse_mesh.h). OpenMesh 9 was measured for this, too: of a million triangles it is made in three times the time
// (0.3 s for 0.1 s) and takes 71 bytes a triangle for 45.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"

namespace relievo {

inline constexpr uint32_t kNoIndex = ~uint32_t{0};

using Triangle = std::array<uint32_t, 3>;

struct SurfacePiece {
  uint64_t vertices = 0, triangles = 0, borders = 0;  // borders: loops
  int64_t euler = 0;                                  // V - E + F
  double area = 0;
  uint32_t first_triangle = 0;
  // What must not change from the scan to its base mesh.
  bool sameTopology(const SurfacePiece& o) const { return euler == o.euler && borders == o.borders; }
};

struct Surface {
  std::vector<glm::vec3> points;
  std::vector<Triangle> triangles;
  std::vector<uint32_t> twin;    // of half edge 3 t + k (corner k to k + 1): the one back; kNoIndex: border
  std::vector<uint32_t> source;  // the vertex of the input that each vertex is (a copy of)
  std::vector<uint32_t> piece;   // of a vertex; kNoIndex: no triangle uses it
  std::vector<SurfacePiece> pieces;
  std::vector<std::vector<uint32_t>> loops;  // border vertices in order, the surface to their left
};

// Vertices at which several fans of triangles touch become one a fan; triangles are wound alike within a piece (as most
// of its area is). Refuses indices out of range, points that are not finite, edges of three triangles, triangles that
// name a vertex twice, pieces without area and pieces with one side only (Moebius strips).
Result<Surface> makeSurface(std::span<const glm::vec3> points, std::span<const Triangle> triangles);

double areaOf(const Surface& s);

// The same surface of four times as many triangles: every edge halved.
Surface subdivided(const Surface& s);

}  // namespace relievo
