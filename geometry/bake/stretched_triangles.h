// stretched_triangles.h - how much of a scan lies in long thin triangles. A patch of two of them has as many texels
// along as across: seen from far, where a pixel takes several of those across, colours run along it for many pixels,
// beyond what anisotropic filtering mends. Pure.
#pragma once

#include <algorithm>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// The share of the scan's area in triangles whose longest side is more than 8 times their height over it.
inline double stretchedShare(const TriMesh& mesh) {
  constexpr double kStretched = 8;
  double area = 0, stretched = 0;
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a = mesh.positions_mm[t[0]], b = mesh.positions_mm[t[1]], c = mesh.positions_mm[t[2]];
    const double longest = std::max({glm::distance(a, b), glm::distance(b, c), glm::distance(c, a)}),
                 twice = glm::length(glm::cross(b - a, c - a));
    area += twice;
    if (longest * longest > kStretched * twice) stretched += twice;
  }
  return area > 0 ? stretched / area : 0;
}

}  // namespace relievo
