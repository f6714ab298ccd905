// surface_normals.h - normals of the triangles that an export's grid of vertices makes, summed around each vertex and
// weighted by area. Pure.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "tools/export/surface_rows.h"

namespace relievo {

// Adds the cross products of a row of cells' triangles to the normals of the vertices above and below it. Cells are cut
// along (0,0)-(1,1).
inline void addCrosses(const SheetRow& above, const SheetRow& below, std::vector<glm::dvec3>& normals_above,
                       std::vector<glm::dvec3>& normals_below) {
  for (size_t x = 0; x + 1 < above.positions.size(); ++x) {
    const glm::dvec3 &a = above.positions[x], &b = above.positions[x + 1], &c = below.positions[x],
                     &d = below.positions[x + 1];
    const glm::dvec3 upper = glm::cross(d - a, b - a), lower = glm::cross(c - a, d - a);
    normals_above[x] += upper + lower;
    normals_above[x + 1] += upper;
    normals_below[x] += lower;
    normals_below[x + 1] += upper + lower;
  }
}

inline glm::vec3 unitNormal(const glm::dvec3& v, const glm::dvec3& otherwise) {
  const double length = glm::length(v);
  return length > 0 ? glm::vec3(v / length) : glm::vec3(glm::normalize(otherwise));
}

}  // namespace relievo
