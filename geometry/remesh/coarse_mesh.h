// coarse_mesh.h - the half-edge meshes of remeshing: OpenMesh's, from the reduced surface on. The one file of the
// product that includes OpenMesh (tests/base/rooms_test.cpp); only files of this folder may include it.
//   triangles  the reduced surface, and what is simplified from a copy of it
//   quads      the base mesh to be
//   curves     a half edge that runs along a feature curve knows where on it it starts
// Handles are OpenMesh's smart ones, wherever they come from a circulator: h.to(), v.faces(), f.halfedges().
#pragma once

#include <array>
#include <cstdint>

#include <glm/glm.hpp>

// What OpenMesh asks of a type of points.
namespace OpenMesh {
inline double norm(const glm::dvec3& v) { return glm::length(v); }
}  // namespace OpenMesh

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
#include <OpenMesh/Core/Mesh/PolyMesh_ArrayKernelT.hh>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#pragma GCC diagnostic pop

#include "geometry/remesh/base_topology.h"

template <>
struct OpenMesh::vector_traits<glm::dvec3> {
  using vector_type = glm::dvec3;
  using value_type = double;
  static constexpr size_t size_ = 3;
  static size_t size() { return size_; }
};

namespace relievo {

using OpenMesh::EdgeHandle, OpenMesh::FaceHandle, OpenMesh::VertexHandle;
using OpenMesh::SmartEdgeHandle, OpenMesh::SmartFaceHandle, OpenMesh::SmartHalfedgeHandle, OpenMesh::SmartVertexHandle;

// Of a half edge: where its feature curve is as it leaves its vertex.
struct CurveStep {
  uint32_t curve = kNoIndex;
  double along = 0;
  explicit operator bool() const { return curve != kNoIndex; }
};

struct CoarseTraits : OpenMesh::DefaultTraits {
  using Point = glm::dvec3;
  using Normal = glm::dvec3;
  VertexAttributes(OpenMesh::Attributes::Status);
  EdgeAttributes(OpenMesh::Attributes::Status);
  FaceAttributes(OpenMesh::Attributes::Status);
  VertexTraits {
    bool fixed = false;     // where feature curves meet, end, or turn sharply: it stays
    bool on_curve = false;  // unless it is fixed, two of its half edges are on the feature curve
  };
  HalfedgeTraits { CurveStep step; };
};
struct QuadTraits : CoarseTraits {
  VertexAttributes(OpenMesh::Attributes::Normal);  // the surface's, near the corner
  VertexTraits {
    bool fixed = false, on_curve = false;
    glm::dmat3 slide{1};  // the directions that the corner may move in: those across a crease are taken out
  };
};
struct TriangleMesh : OpenMesh::TriMesh_ArrayKernelT<CoarseTraits> {};
struct QuadMesh : OpenMesh::PolyMesh_ArrayKernelT<QuadTraits> {};  // faces are against the clock seen from outside

// Vertices and faces have the surface's indices.
TriangleMesh halfEdgesOf(const Surface& surface);
// Without what is deleted, in the same order: OpenMesh's own garbage collection fills gaps from the end.
TriangleMesh compacted(const TriangleMesh& mesh);

// The corners of a face, from the first one that it was made of.
template <size_t kCorners>
std::array<VertexHandle, kCorners> cornersOf(const SmartFaceHandle& face) {
  std::array<VertexHandle, kCorners> corners;
  size_t k = 0;
  for (const SmartVertexHandle v : face.vertices()) corners[k++] = v;
  return corners;
}
template <size_t kCorners, class Mesh>
std::array<glm::dvec3, kCorners> pointsOf(const Mesh& mesh, const SmartFaceHandle& face) {
  std::array<glm::dvec3, kCorners> points;
  size_t k = 0;
  for (const SmartVertexHandle v : face.vertices()) points[k++] = mesh.point(v);
  return points;
}
// The half edges of a triangle, from the one that leaves its first corner.
inline std::array<SmartHalfedgeHandle, 3> sidesOf(const SmartFaceHandle& face) {
  const SmartHalfedgeHandle last = face.halfedge();
  return {last.next(), last.prev(), last};
}
// Along the normal, as long as twice the triangle's area.
inline glm::dvec3 areaVector(const std::array<glm::dvec3, 3>& p) { return glm::cross(p[1] - p[0], p[2] - p[0]); }
inline glm::dvec3 areaVector(const TriangleMesh& mesh, const SmartFaceHandle& face) {
  return areaVector(pointsOf<3>(mesh, face));
}
inline glm::dvec3 unit(const glm::dvec3& v) {
  const double length = glm::length(v);
  return length > 0 ? v / length : glm::dvec3(0);
}

// A vertex at a border has one edge more than faces.
inline uint32_t facesAround(const SmartVertexHandle& v) { return v.valence() - (v.is_boundary() ? 1 : 0); }

// The edge from a to b runs along a feature curve, between these places. Where there is no edge, nothing is said.
template <class Mesh>
void markStep(Mesh& mesh, VertexHandle a, VertexHandle b, uint32_t curve, double along_a, double along_b) {
  const auto h = mesh.find_halfedge(a, b);
  if (!h.is_valid()) return;
  mesh.data(h).step = {curve, along_a};
  mesh.data(h.opp()).step = {curve, along_b};
  mesh.data(a).on_curve = mesh.data(b).on_curve = true;
}

}  // namespace relievo
