// spread_places.h - places spread evenly over a mesh's area, at fixed places: the same mesh gives the same ones.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// The k-th place in a triangle: the plastic number's sequence, folded into it (Roberts 2018): any run of them is spread
// evenly.
inline glm::dvec2 placeInTriangle(size_t k) {
  constexpr double kPlastic = 1.32471795724474602596;
  double b1 = std::fmod(0.5 + static_cast<double>(k) / kPlastic, 1.0),
         b2 = std::fmod(0.5 + static_cast<double>(k) / (kPlastic * kPlastic), 1.0);
  if (b1 + b2 > 1) {
    b1 = 1 - b1;
    b2 = 1 - b2;
  }
  return {b1, b2};
}

// The sum of the areas (twice) of the triangles before each one, from `before` on.
inline std::vector<double> areasBefore(const TriMesh& mesh, double before) {
  std::vector<double> out{before};
  out.reserve(mesh.triangles.size() + 1);
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    out.push_back(out.back() + glm::length(glm::cross(b - a, c - a)));
  }
  return out;
}

// The k-th of `spread` places, evenly over a mesh's area, that lies on a part of it: the part's areas, and the whole
// mesh's.
class SpreadPlaces {
 public:
  SpreadPlaces(const TriMesh& part, const std::vector<double>& area_before, double whole_area, size_t spread)
      : part_(part), area_before_(area_before), whole_area_(whole_area), spread_(spread) {}
  double areaOf(size_t k) const { return (static_cast<double>(k) + 0.5) / static_cast<double>(spread_) * whole_area_; }
  // The first place at or behind an area.
  size_t firstAt(double area) const {
    size_t low = 0, high = spread_;
    while (low < high) {
      const size_t k = (low + high) / 2;
      if (areaOf(k) < area) low = k + 1;
      else high = k;
    }
    return low;
  }
  // `triangle` is where the search begins, and then the place's.
  glm::dvec3 place(size_t k, size_t& triangle) const {
    const double area = areaOf(k);
    if (area >= area_before_[triangle + 1])
      triangle =
          static_cast<size_t>(std::upper_bound(area_before_.begin(), area_before_.end(), area) - area_before_.begin()) -
          1;
    triangle = std::min(triangle, part_.triangles.size() - 1);
    const auto& t = part_.triangles[triangle];
    const glm::dvec2 w = placeInTriangle(k);
    const glm::dvec3 a(part_.positions_mm[t[0]]), b(part_.positions_mm[t[1]]), c(part_.positions_mm[t[2]]);
    return a + w.x * (b - a) + w.y * (c - a);
  }

 private:
  const TriMesh& part_;
  const std::vector<double>& area_before_;
  double whole_area_;
  size_t spread_;
};

}  // namespace relievo
