#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

TriangleMesh halfEdgeMeshOf(const Surface& surface) {
  TriangleMesh mesh;
  mesh.reserve(surface.points.size(), surface.triangles.size() * 3 / 2 + surface.loops.size(),
               surface.triangles.size());
  for (const glm::vec3& p : surface.points) mesh.add_vertex(p);
  auto handle = [](uint32_t v) { return VertexHandle(static_cast<int>(v)); };
  for (const Triangle& t : surface.triangles) mesh.add_face(handle(t[0]), handle(t[1]), handle(t[2]));
  return mesh;
}

TriangleMesh compacted(const TriangleMesh& mesh) {
  TriangleMesh out;
  std::vector<VertexHandle> new_handle(mesh.n_vertices());
  for (const auto v : mesh.vertices()) {
    new_handle[v.idx()] = out.add_vertex(mesh.point(v));
    out.data(new_handle[v.idx()]) = mesh.data(v);
  }
  for (const auto f : mesh.faces()) {
    const auto corners = cornersOf<3>(f);
    out.add_face(new_handle[corners[0].idx()], new_handle[corners[1].idx()], new_handle[corners[2].idx()]);
  }
  for (const auto e : mesh.edges())
    for (const auto& h : {e.h0(), e.h1()})
      out.data(out.find_halfedge(new_handle[h.from().idx()], new_handle[h.to().idx()])).curve_position =
          mesh.data(h).curve_position;
  return out;
}

}  // namespace relievo
