// normal_map_fit.h - does a map of normals belong to its surface, and which way does y count in it, where its file does
// not say so? Both ways are in use: upwards as OpenGL and glTF have it, downwards as DirectX. A map that was made for a
// scan of fewer triangles than its source brings the smooth normals between corners back to the surface, triangle by
// triangle: the y with which it does so is its own. Maps whose normals point into the surface are of another kind, such
// as those in the object's space.
#pragma once

#include <cstdint>
#include <span>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

enum class NormalMapFit : uint8_t { kUpwards, kDownwards, kNone };

// Of the mesh's image with that number. y: what is stated. vertex_normals: a vertex, for triangles without normals of
// their own (TriMesh::corner_normals).
NormalMapFit normalMapFit(const TriMesh& mesh, uint16_t number, const MeshBake::Image& image, NormalMap::Y y,
                          std::span<const glm::vec3> vertex_normals);

}  // namespace relievo
