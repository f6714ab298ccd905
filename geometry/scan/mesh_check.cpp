// mesh_check.cpp - TriMesh's promises, looked at without any of what keeps them (mesh_repair.cpp).
#include <algorithm>
#include <cmath>

#include "geometry/scan/mesh_read.h"

namespace relievo {

std::string triMeshProblem(const TriMesh& mesh) {
  const size_t vertices = mesh.positions_mm.size(), triangles = mesh.triangles.size();
  if (triangles == 0) return "no triangle";
  if (!mesh.colours.empty() && mesh.colours.size() != vertices)
    return "colours of " + std::to_string(mesh.colours.size()) + " vertices";
  if (!mesh.corner_uv.empty() && mesh.corner_uv.size() != triangles)
    return "texture coordinates of " + std::to_string(mesh.corner_uv.size()) + " triangles";
  if (!mesh.corner_normals.empty() && mesh.corner_normals.size() != triangles)
    return "normals of " + std::to_string(mesh.corner_normals.size()) + " triangles";
  if (!mesh.image_of.empty() && mesh.image_of.size() != triangles)
    return "images of " + std::to_string(mesh.image_of.size()) + " triangles";
  for (size_t t = 0; t < mesh.image_of.size(); ++t)
    if (const uint16_t image = mesh.image_of[t]; image != kNoImage && image >= mesh.images.size())
      return "triangle " + std::to_string(t) + " names image " + std::to_string(image);
  if (!mesh.images.empty() && mesh.corner_uv.empty()) return "images without texture coordinates";
  for (int c = 0; c < 3; ++c)
    if (!std::isfinite(mesh.origin_mm[c])) return "an origin that is not finite";
  for (size_t v = 0; v < vertices; ++v)
    for (int c = 0; c < 3; ++c)
      if (!std::isfinite(mesh.positions_mm[v][c])) return "vertex " + std::to_string(v) + " is not finite";
  for (size_t t = 0; t < mesh.corner_uv.size(); ++t)
    for (const glm::vec2& uv : mesh.corner_uv[t])
      if (!std::isfinite(uv.x) || !std::isfinite(uv.y))
        return "texture coordinates of triangle " + std::to_string(t) + " are not finite";
  for (size_t t = 0; t < mesh.corner_normals.size(); ++t)
    for (const glm::vec3& n : mesh.corner_normals[t])
      if (n != glm::vec3(0) && !(std::abs(glm::length(n) - 1) < 1e-5f))
        return "normals of triangle " + std::to_string(t) + " have another length than 1";
  std::vector<bool> used(vertices);
  std::vector<std::array<uint32_t, 2>> edges;
  edges.reserve(3 * triangles);
  for (size_t t = 0; t < triangles; ++t) {
    const auto& [a, b, c] = mesh.triangles[t];
    for (uint32_t v : {a, b, c}) {
      if (v >= vertices) return "triangle " + std::to_string(t) + " names vertex " + std::to_string(v);
      used[v] = true;
    }
    glm::dvec3 p(mesh.positions_mm[a]), q(mesh.positions_mm[b]), r(mesh.positions_mm[c]);
    if (a == b || b == c || c == a || !(glm::length(glm::cross(q - p, r - p)) > 0))
      return "triangle " + std::to_string(t) + " is degenerate";
    for (auto [from, to] : {std::pair{a, b}, {b, c}, {c, a}}) edges.push_back({std::min(from, to), std::max(from, to)});
  }
  std::sort(edges.begin(), edges.end());
  for (size_t i = 2; i < edges.size(); ++i)
    if (edges[i] == edges[i - 2])
      return "more than two triangles share the edge " + std::to_string(edges[i][0]) + " - " +
             std::to_string(edges[i][1]);
  for (size_t v = 0; v < vertices; ++v)
    if (!used[v]) return "no triangle names vertex " + std::to_string(v);
  return {};
}

}  // namespace relievo
