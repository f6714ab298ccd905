// facing_cone.h - which patches of a closed body an eye sees from behind, whatever the level they are drawn with: such
// a patch cannot be seen.
//
// The normals of S = P + h N (src/artwork/base_mesh.h): a triangle of any level's grid has one leg along u and one
// along v, vertices of S at its ends. A leg along u, divided by its length in u, is the mean of S's finest difference
// quotients under it; each of those is
//   P_u + h_u N + h N_u,
// P_u a mix of the patch's two sides along u, h_u a difference quotient of the heights, N a mix of the corners'
// normals, h a height within the patch's range: exactly, since P and N are bilinear. So with a range of h, h_u and h_v
// all legs lie in two boxes, and the normals, their cross products, in a cone. (Triangles beside a side whose vertices
// snapped have a leg that is neither; whoever draws the patch on the other side of it draws that side alike. Left out,
// a patch's outline is the outline of its neighbours.)
//
// Why such a patch may be left out: seen from outside a closed body, each ray meets as many fronts as backs, and a back
// never first.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/base_mesh.h"

namespace relievo {

// Every normal n, of length 1, has dot(n, axis) >= sqrt(1 - sine^2). sine >= 1: nothing is known.
struct FacingCone {
  glm::dvec3 axis{0};
  double sine = 2;
};

// Of a patch, its heights min_mm .. max_mm. Of zero area, folded or steep: nothing is known.
FacingCone facingCone(const BaseMesh& mesh, uint32_t patch, double min_mm, double max_mm, const HeightSlopes& slopes);
// Around several.
FacingCone joined(std::span<const FacingCone> cones);

// Four bytes a cone, rounded outwards: x, y, z of the axis and the sine, in 127ths; a sine of 127: nothing is known. An
// eye sees only backs of what lies around c within r where dot(c - eye, axis) > sine * |c - eye| + r, axis and sine
// taken from the bytes.
uint32_t packCone(const FacingCone& cone);

// Has the mesh no border, is it oriented alike across all sides, and outwards: does each connected part enclose a
// volume above zero?
bool isClosedBody(const BaseMesh& mesh, std::span<const PatchNeighbours> neighbours);

}  // namespace relievo
