#include "geometry/bake/vertex_detail.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

namespace relievo {

double vertexDetail(const TriMesh& mesh) {
  struct Around {
    glm::dvec3 neighbours{0}, normal{0};
    uint32_t count = 0;
  };
  std::vector<Around> around(mesh.positions_mm.size());
  for (const auto& t : mesh.triangles) {
    const std::array<glm::dvec3, 3> p{mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]]};
    const glm::dvec3 normal = glm::cross(p[1] - p[0], p[2] - p[0]);
    for (size_t k = 0; k < 3; ++k) {
      Around& a = around[t[k]];
      a.neighbours += p[(k + 1) % 3];
      a.normal += normal;
      ++a.count;
    }
  }
  double squares = 0;
  uint64_t vertices = 0;
  for (size_t v = 0; v < around.size(); ++v) {
    const Around& a = around[v];
    const double length = glm::length(a.normal);
    if (!(length > 0)) continue;
    const double off =
        glm::dot(a.neighbours / static_cast<double>(a.count) - glm::dvec3(mesh.positions_mm[v]), a.normal / length);
    squares += off * off;
    ++vertices;
  }
  return vertices > 0 ? std::sqrt(squares / static_cast<double>(vertices)) : 0;
}

}  // namespace relievo
