#include "geometry/bake/vertex_normals.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "geometry/mesh/triangle_blocks.h"
#include "src/base/parallel_for.h"

namespace relievo {

std::array<glm::vec3, 3> cornerShares(const TriMesh& mesh, const std::array<uint32_t, 3>& t) {
  const std::array<glm::vec3, 3> p{mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]]};
  const glm::vec3 n = glm::cross(p[1] - p[0], p[2] - p[0]);
  const float area = glm::length(n);
  std::array<glm::vec3, 3> out{};
  if (!(area > 0)) return out;
  for (size_t k = 0; k < 3; ++k) {
    const glm::vec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
    out[k] = n * (angleOf(area, glm::dot(a, b)) / area);
  }
  return out;
}

namespace {

// Does the triangle face away from the normal of one of its corners?
bool facesAway(const TriMesh& mesh, const std::array<uint32_t, 3>& t, const std::vector<glm::vec3>& normals) {
  constexpr float kFoldedCosine = -0.2f;
  const glm::vec3& p = mesh.positions_mm[t[0]];
  const glm::vec3 n = glm::cross(mesh.positions_mm[t[1]] - p, mesh.positions_mm[t[2]] - p);
  bool away = false;
  for (uint32_t v : t) {
    const float along = glm::dot(n, normals[v]);
    away |=
        along < 0 && along * along > kFoldedCosine * kFoldedCosine * glm::dot(n, n) * glm::dot(normals[v], normals[v]);
  }
  return away;
}

}  // namespace

// Triangles are weighted by their angles at the vertex, so that the result does not depend on how they are subdivided
// (Thuermer and Wuethrich 1998). Triangles that are folded back onto their neighbours face away from the others at
// their corners. They would turn the normal, and darken the picture there, and are left out.
bool makeVertexNormals(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted,
                       std::vector<glm::vec3>& normals) {
  normals.assign(mesh.positions_mm.size(), glm::vec3(0));
  const size_t parts = static_cast<size_t>(workerCount(workers));
  auto stopped = [&] { return interrupted && interrupted->load(std::memory_order_relaxed); };
  auto stopAt = [&](size_t i) { return i % (size_t{1} << 18) == 0 && interrupted && *interrupted; };
  // Each job sums up the vertices of its own range, so that the order of additions is the same for any number of
  // workers.
  const TriangleBlocks blocks(mesh.triangles, workers);
  const bool summed = parallelFor(parts, workers, interrupted, [&](size_t part) {
    const size_t first = normals.size() * part / parts, last = normals.size() * (part + 1) / parts;
    blocks.forEach(first, last, stopped, [&](size_t i) {
      const auto& t = mesh.triangles[i];
      std::array<bool, 3> in_range{};
      for (size_t k = 0; k < 3; ++k) in_range[k] = t[k] >= first && t[k] < last;
      if (!in_range[0] && !in_range[1] && !in_range[2]) return;
      const auto contribution = cornerShares(mesh, t);
      for (size_t k = 0; k < 3; ++k)
        if (in_range[k]) normals[t[k]] += contribution[k];
    });
  });
  if (!summed) return false;
  std::vector<std::vector<size_t>> folded(parts);  // triangles in order
  const bool tested = parallelFor(parts, workers, interrupted, [&](size_t part) {
    const size_t first = mesh.triangles.size() * part / parts, last = mesh.triangles.size() * (part + 1) / parts;
    for (size_t i = first; i < last; ++i) {
      if (stopAt(i)) return;
      if (facesAway(mesh, mesh.triangles[i], normals)) folded[part].push_back(i);
    }
  });
  if (!tested) return false;
  for (const auto& list : folded) {
    for (size_t i : list) {
      const auto& t = mesh.triangles[i];
      const auto contribution = cornerShares(mesh, t);
      for (size_t k = 0; k < 3; ++k) {
        // A vertex with few other triangles keeps its normal.
        const glm::vec3 without = normals[t[k]] - contribution[k];
        if (glm::dot(without, contribution[k]) < 0 &&
            4 * glm::dot(without, without) > glm::dot(contribution[k], contribution[k]))
          normals[t[k]] = without;
      }
    }
  }
  return parallelFor(parts, workers, interrupted, [&](size_t part) {
    for (size_t i = normals.size() * part / parts; i < normals.size() * (part + 1) / parts; ++i) {
      const float length = glm::length(normals[i]);
      if (length > 0) normals[i] /= length;
    }
  });
}

}  // namespace relievo
