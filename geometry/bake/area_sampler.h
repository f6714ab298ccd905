// area_sampler.h - sample positions spread evenly over a mesh's area. They are deterministic: the same mesh gives the
// same positions. Units: those of the mesh.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"
#include "geometry/mesh/triangle_point.h"

namespace relievo {

// The barycentric weights of corners 1 and 2 for the k-th point of a triangle. Source: Roberts 2018, "The unreasonable
// effectiveness of quasirandom sequences" (the sequence of the plastic number, folded into the triangle): the points of
// any run of indices are spread evenly.
inline glm::dvec2 pointInTriangle(size_t k) {
  constexpr double kPlastic = 1.32471795724474602596;
  double b1 = 0.5 + static_cast<double>(k) / kPlastic, b2 = 0.5 + static_cast<double>(k) / (kPlastic * kPlastic);
  b1 -= std::floor(b1), b2 -= std::floor(b2);
  if (b1 + b2 > 1) {
    b1 = 1 - b1;
    b2 = 1 - b2;
  }
  return {b1, b2};
}

// Twice the summed areas of the triangles before each triangle, starting from `before`, with the total at the end.
inline std::vector<double> cumulativeAreas(const TriMesh& mesh, double before) {
  std::vector<double> out{before};
  out.reserve(mesh.triangles.size() + 1);
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) out.push_back(out.back() + doubleAreaOf(cornersOf(mesh, t)));
  return out;
}

// `count` samples that are spread over an area: which lie where.
class AreaSamples {
 public:
  AreaSamples(double whole_area, size_t count) : whole_area_(whole_area), count_(count) {}
  double areaBefore(size_t k) const {
    return (static_cast<double>(k) + 0.5) / static_cast<double>(count_) * whole_area_;
  }
  // The first sample at or behind a cumulative area.
  size_t firstAt(double area) const {
    size_t low = 0, high = count_;
    while (low < high) {
      const size_t k = (low + high) / 2;
      if (areaBefore(k) < area) low = k + 1;
      else high = k;
    }
    return low;
  }

 private:
  double whole_area_;
  size_t count_;
};

// The samples that lie on one part of a mesh when `count` samples are spread over the whole mesh, so that a mesh can be
// sampled part by part. cumulative_area: of the part (cumulativeAreas()); whole_area: of the whole mesh.
class AreaSampler {
 public:
  AreaSampler(const TriMesh& part, const std::vector<double>& cumulative_area, double whole_area, size_t count)
      : part_(part), cumulative_area_(cumulative_area), samples_(whole_area, count) {}
  size_t firstSampleAt(double area) const { return samples_.firstAt(area); }
  // The position of sample k. triangle: where the search begins; receives the sample's triangle.
  glm::dvec3 position(size_t k, size_t& triangle) const {
    const double area = samples_.areaBefore(k);
    if (area >= cumulative_area_[triangle + 1])
      triangle = static_cast<size_t>(std::upper_bound(cumulative_area_.begin(), cumulative_area_.end(), area) -
                                     cumulative_area_.begin()) -
                 1;
    triangle = std::min(triangle, part_.triangles.size() - 1);
    const auto& t = part_.triangles[triangle];
    const glm::dvec2 w = pointInTriangle(k);
    const glm::dvec3 a(part_.positions_mm[t[0]]), b(part_.positions_mm[t[1]]), c(part_.positions_mm[t[2]]);
    return a + w.x * (b - a) + w.y * (c - a);
  }

 private:
  const TriMesh& part_;
  const std::vector<double>& cumulative_area_;
  AreaSamples samples_;
};

}  // namespace relievo
