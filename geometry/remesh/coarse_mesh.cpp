#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

TriangleMesh halfEdgesOf(const Surface& surface) {
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
  std::vector<VertexHandle> name(mesh.n_vertices());
  for (const auto v : mesh.vertices()) {
    name[v.idx()] = out.add_vertex(mesh.point(v));
    out.data(name[v.idx()]) = mesh.data(v);
  }
  for (const auto f : mesh.faces()) {
    const auto corners = cornersOf<3>(f);
    out.add_face(name[corners[0].idx()], name[corners[1].idx()], name[corners[2].idx()]);
  }
  for (const auto e : mesh.edges())
    for (const auto& h : {e.h0(), e.h1()})
      out.data(out.find_halfedge(name[h.from().idx()], name[h.to().idx()])).step = mesh.data(h).step;
  return out;
}

}  // namespace relievo
