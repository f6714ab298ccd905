// base_topology.h - the connectivity of a whole scan: half edges, pieces (connected components), border loops, a
// consistent orientation for each piece and one fan of triangles for each vertex. Units: the caller's.
// Scans have millions of triangles, for which this is smaller and faster than OpenMesh 9 (coarse_mesh.h): 45 in place
// of 71 bytes a triangle, and a third of the time.
#pragma once

#include <array>
#include <cstdint>
#include <numbers>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"

namespace relievo {

inline constexpr double kDegree = std::numbers::pi / 180;  // in radians

inline constexpr uint32_t kNoIndex = ~uint32_t{0};

using Triangle = std::array<uint32_t, 3>;

// Of half edge 3 t + k: the half edges of the same triangle that follow and precede it.
inline uint32_t nextOf(uint32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
inline uint32_t previousOf(uint32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }

inline glm::dvec3 unit(const glm::dvec3& v) {
  const double length = glm::length(v);
  return length > 0 ? v / length : glm::dvec3(0);
}

struct SurfacePiece {
  uint64_t vertices = 0, triangles = 0, borders = 0;  // borders: border loops
  int64_t euler = 0;                                  // V - E + F
  double area = 0;
  uint32_t first_triangle = 0;
  // The base mesh must have the topology of its scan.
  bool sameTopology(const SurfacePiece& o) const { return euler == o.euler && borders == o.borders; }
};

struct Surface {
  std::vector<glm::vec3> points;
  std::vector<Triangle> triangles;
  std::vector<uint32_t> twin;    // of half edge 3 t + k (corner k to k + 1): the opposite half edge; kNoIndex: border
  std::vector<uint32_t> source;  // the input vertex of which each vertex is a copy
  std::vector<uint32_t> piece;   // for each vertex; kNoIndex: no triangle uses it
  std::vector<SurfacePiece> pieces;
  std::vector<std::vector<uint32_t>> loops;  // border vertices in order, with the surface to their left
};

// Builds the connectivity. A vertex at which several fans of triangles touch is copied for each fan. The triangles of a
// piece are oriented consistently, as most of its area is. Error: kInvalidData for indices out of range, points that
// are not finite, edges of three triangles, triangles that name a vertex twice, and pieces with one side only (Moebius
// strips).
Result<Surface> makeSurface(std::span<const glm::vec3> points, std::span<const Triangle> triangles);

double areaOf(const Surface& s);

// The same surface with four times as many triangles: every edge is halved.
Surface subdivided(const Surface& s);

}  // namespace relievo
