// triangle_point.h - a triangle's area and its point that is closest to a place, in double precision. Pure.
#pragma once

#include <cstdint>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

struct TriangleCorners {
  glm::dvec3 a, b, c;
};
inline TriangleCorners cornersOf(const TriMesh& mesh, uint32_t triangle) {
  const auto& t = mesh.triangles[triangle];
  return {mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]]};
}

inline double doubleAreaOf(const TriangleCorners& t) { return glm::length(glm::cross(t.b - t.a, t.c - t.a)); }

// The weights of corners b and c, and the distance.
struct TrianglePoint {
  double b1 = 0, b2 = 0, distance = 0;
};
// Ericson, Real-Time Collision Detection, 5.1.5: the closest point by the Voronoi regions of the triangle's features.
inline TrianglePoint closestOnTriangle(const TriangleCorners& t, const glm::dvec3& p) {
  TrianglePoint out;
  const glm::dvec3 ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
  const double d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap);
  const glm::dvec3 bp = p - t.b;
  const double d3 = glm::dot(ab, bp), d4 = glm::dot(ac, bp);
  const glm::dvec3 cp = p - t.c;
  const double d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (d1 <= 0 && d2 <= 0) {
  } else if (d3 >= 0 && d4 <= d3) {
    out.b1 = 1;
  } else if (d6 >= 0 && d5 <= d6) {
    out.b2 = 1;
  } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    out.b1 = d1 / (d1 - d3);
  } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    out.b2 = d2 / (d2 - d6);
  } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    out.b2 = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    out.b1 = 1 - out.b2;
  } else {
    const double sum = va + vb + vc;
    out.b1 = vb / sum;
    out.b2 = vc / sum;
  }
  out.distance = glm::length(ap - out.b1 * ab - out.b2 * ac);
  return out;
}

}  // namespace relievo
