#include "geometry/strategies/triangle_simplify.h"

#include <meshoptimizer.h>

namespace relievo {

std::vector<uint32_t> simplifiedTriangles(std::span<const glm::vec3> positions, std::span<const uint8_t> kept,
                                          std::span<const uint32_t> triangles, size_t target_triangles) {
  // This version of meshoptimizer takes no list of vertices to keep. It keeps those of which there are more than two at
  // one place, so two copies are added that no triangle has.
  std::vector<glm::vec3> vertices(positions.begin(), positions.end());
  for (size_t v = 0; v < kept.size(); ++v)
    if (kept[v]) vertices.insert(vertices.end(), 2, positions[v]);
  std::vector<uint32_t> out(triangles.size());
  out.resize(meshopt_simplify(out.data(), triangles.data(), triangles.size(), &vertices[0].x, vertices.size(),
                              sizeof(glm::vec3), 3 * target_triangles, 1e9f, 0, nullptr));
  return out;
}

}  // namespace relievo
