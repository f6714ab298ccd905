// coarse_mesh.h - the half-edge meshes of remeshing, from the reduced surface on: TriangleMesh for the reduced surface
// and its simplified copies, QuadMesh for the base mesh to be. Half edges along a feature curve store their position on
// it. This is the only file of the product that includes OpenMesh (tests/base/rooms_test.cpp), and only files of this
// folder may include it.
// Handles from circulators are OpenMesh's smart ones: h.to(), v.faces(), f.halfedges(). Units: diagonals of the scan.
#pragma once

#include <array>
#include <cstdint>

#include <glm/glm.hpp>

// OpenMesh requires this function of a point type.
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

// The position of a half edge's origin on its feature curve, if it runs along one.
struct CurvePosition {
  uint32_t curve = kNoIndex;
  double arc_length = 0;
  explicit operator bool() const { return curve != kNoIndex; }
};

struct CoarseTraits : OpenMesh::DefaultTraits {
  using Point = glm::dvec3;
  using Normal = glm::dvec3;
  VertexAttributes(OpenMesh::Attributes::Status);
  EdgeAttributes(OpenMesh::Attributes::Status);
  FaceAttributes(OpenMesh::Attributes::Status);
  VertexTraits {
    bool fixed = false;     // a feature curve's end, fork or sharp turn: must stay
    bool on_curve = false;  // two of its half edges are on the feature curve, unless it is fixed
  };
  HalfedgeTraits { CurvePosition curve_position; };
};
struct QuadTraits : CoarseTraits {
  VertexAttributes(OpenMesh::Attributes::Normal);  // the surface's normal near the corner
  VertexTraits {
    bool fixed = false, on_curve = false;
    glm::dmat3 free_directions{1};  // projects moves to the permitted directions: those across a crease are removed
  };
};
// A mesh that is copied whole or not at all: where OpenMesh has no memory for all of a copy, that shares properties
// with the original, and deletes them in its destructor. The program ends then (std::terminate) instead of unwinding.
template <class Mesh>
struct Copyable : Mesh {
  Copyable() = default;
  Copyable(const Copyable& other) : Mesh() { assign(other); }
  Copyable& operator=(const Copyable& other) {
    assign(other);
    return *this;
  }

 private:
  void assign(const Copyable& other) noexcept { Mesh::operator=(other); }
};
struct TriangleMesh : Copyable<OpenMesh::TriMesh_ArrayKernelT<CoarseTraits>> {};
struct QuadMesh : Copyable<OpenMesh::PolyMesh_ArrayKernelT<QuadTraits>> {};  // faces: counter-clockwise from outside

// Vertices and faces have the surface's indices.
TriangleMesh halfEdgeMeshOf(const Surface& surface);
// Removes deleted elements and keeps the order (OpenMesh's own garbage collection does not).
TriangleMesh compacted(const TriangleMesh& mesh);

// The corners of a face, in the order in which it was made.
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
inline std::array<SmartHalfedgeHandle, 3> halfedgesOf(const SmartFaceHandle& face) {
  const SmartHalfedgeHandle last = face.halfedge();
  return {last.next(), last.prev(), last};
}
// A vector along the normal whose length is twice the triangle's area.
inline glm::dvec3 areaVector(const std::array<glm::dvec3, 3>& p) { return glm::cross(p[1] - p[0], p[2] - p[0]); }
inline glm::dvec3 areaVector(const TriangleMesh& mesh, const SmartFaceHandle& face) {
  return areaVector(pointsOf<3>(mesh, face));
}

// The number of faces around a vertex.
inline uint32_t faceCount(const SmartVertexHandle& v) { return v.valence() - (v.is_boundary() ? 1 : 0); }

// Marks the edge from a to b, if there is one, as a part of a feature curve between two arc lengths.
template <class Mesh>
void setCurvePosition(Mesh& mesh, VertexHandle a, VertexHandle b, uint32_t curve, double arc_length_a,
                      double arc_length_b) {
  const auto h = mesh.find_halfedge(a, b);
  if (!h.is_valid()) return;
  mesh.data(h).curve_position = {curve, arc_length_a};
  mesh.data(h.opp()).curve_position = {curve, arc_length_b};
  mesh.data(a).on_curve = mesh.data(b).on_curve = true;
}

}  // namespace relievo
