// corner_normals.h - the normals that a scan is shaded with: one for each vertex, but at a crease (an edge between two
// smooth parts, as of a machined plate) one for each side of it, and where a plate ends at something sharp the plate's
// own. A triangle's corners name them.
// Memory: 12 bytes a vertex; where there are creases a quarter of a byte a triangle, 12 bytes for each side of a vertex
// on them and 12 for each triangle there. While they are found, some 48 for each triangle in one plane with its
// neighbour at a vertex with sharp edges. Const functions may be called from any thread. The result is the same for any
// number of workers.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

struct CornerNormals {
  // normals[v], v a vertex: the mean around it, as vertex_normals.h has it, for who needs one direction at a vertex.
  // Behind them those of the sides of creases. Of length 1, or 0 where no triangle has an area.
  std::vector<glm::vec3> normals;

  bool hasCreases() const { return !split.empty(); }
  // Has a corner of the triangle a normal that not all of its vertex's triangles share?
  bool isSplit(uint32_t triangle) const {
    return hasCreases() && (runs[triangle / 64].split >> triangle % 64 & 1) != 0;
  }
  // The indices in `normals` of the triangle's corners.
  const std::array<uint32_t, 3>& ofTriangle(const TriMesh& mesh, uint32_t triangle) const {
    if (!isSplit(triangle)) return mesh.triangles[triangle];
    const Run& run = runs[triangle / 64];
    const uint64_t before = run.split & ((uint64_t{1} << triangle % 64) - 1);
    return split[run.before + static_cast<uint32_t>(std::popcount(before))];
  }

  // The triangles that do not have the normals of all their vertices, in order, and where to find them among those: of
  // each run of 64 triangles which are split, and how many are before the run.
  std::vector<std::array<uint32_t, 3>> split;
  struct Run {
    uint64_t split = 0;
    uint32_t before = 0;
  };
  std::vector<Run> runs;
};

// What a triangle's corners are shaded with: the mesh's own normals (TriMesh::corner_normals) where it has some.
inline std::array<glm::vec3, 3> shadingNormals(const TriMesh& mesh, const CornerNormals& normals, uint32_t triangle) {
  std::array<glm::vec3, 3> out;
  const auto& corners = normals.ofTriangle(mesh, triangle);
  for (size_t k = 0; k < 3; ++k) {
    out[k] = normals.normals[corners[k]];
    if (!mesh.corner_normals.empty() && mesh.corner_normals[triangle][k] != glm::vec3(0))
      out[k] = mesh.corner_normals[triangle][k];
  }
  return out;
}

// False: the call was interrupted, and the normals are incomplete. workers: 0 is one for each core.
bool makeCornerNormals(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted, CornerNormals& out);

}  // namespace relievo
