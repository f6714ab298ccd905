// base_mesh.h - the coarse quads of an artwork that is not flat (adaptive quad patches: Gobbetti et al. 2012). Patch p
// of the base mesh is patch p of the forest of quadtrees; its surface is
//   S(u, v) = P(u, v) + h(u, v) N(u, v),  (u, v) in [0, 1]^2,
// P and N interpolated between the four corners' positions and normals, N not normalised (so that S is a polynomial
// where h is), h the relief's height in mm. What is drawn and measured: the triangles of the finest grid of vertices of
// S, cut along (0,0)-(1,1). P and N are bilinear; or they are cut along (0,0)-(1,1), too, and linear on both halves, so
// that two triangles of a scan are a patch as they are, whatever the number of its cells.
//
// Orientation: seen from outside, with u to the right, v points down, as x and y of a flat artwork's texels do: P_v x
// P_u points outwards. Neighbours share corners by index; their sides need not run alike, and a patch may even meet a
// neighbour upside down (a Moebius strip): only the direction along a side, by its corners' indices, is ever relied on.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/deviation.h"
#include "src/artwork/node_id.h"

namespace relievo {

struct BaseCorner {
  glm::vec3 position_mm{0};  // from BaseMesh::origin_mm
  glm::vec3 normal{0};       // of length 1, outwards
  friend bool operator==(const BaseCorner&, const BaseCorner&) = default;
};

// The shares of a patch's corners at (u, v), which add up to 1.
inline std::array<double, 4> cornerShares(bool cut, double u, double v) {
  if (!cut) return {(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v};
  const double low = std::min(u, v);
  return {1 - std::max(u, v), u - low, v - low, low};
}

struct BaseMesh {
  glm::dvec3 origin_mm{0};  // of the corners' positions, in the coordinates of the scan
  std::vector<BaseCorner> corners;
  std::vector<std::array<uint32_t, 4>> patches;  // corners at (u, v) = (0,0), (1,0), (0,1), (1,1)
  bool cut = false;                              // P and N are linear on the patches' halves

  glm::dvec3 point(uint32_t patch, double u, double v) const { return across(patch, u, v, &BaseCorner::position_mm); }
  glm::dvec3 normal(uint32_t patch, double u, double v) const { return across(patch, u, v, &BaseCorner::normal); }
  // P's mixed second difference over a patch, mm: in the middle of cells of width w, P lies a quarter of it times w^2
  // from their triangles. None where these are P.
  glm::dvec3 twist(uint32_t patch) const {
    auto at = [&](size_t k) { return glm::dvec3(corners[patches[patch][k]].position_mm); };
    return cut ? glm::dvec3(0) : at(0) - at(1) - at(2) + at(3);
  }
  friend bool operator==(const BaseMesh&, const BaseMesh&) = default;

 private:
  glm::dvec3 across(uint32_t patch, double u, double v, glm::vec3 BaseCorner::*field) const {
    const std::array<double, 4> share = cornerShares(cut, u, v);
    glm::dvec3 sum(0);
    for (size_t k = 0; k < 4; ++k) sum += share[k] * glm::dvec3(corners[patches[patch][k]].*field);
    return sum;
  }
};

// Are texels, which are squares in (u, v), more than three times as long as wide in space over a tenth of the base's
// area or more? As of a scan's own long triangles. Looks at 2,048 patches at most, at their middles.
bool isStretched(const BaseMesh& mesh);

// The corner slots of a side's two ends, in the direction of growing u or v.
inline constexpr std::array<std::array<int, 2>, 4> kSideCorners{{{0, 2}, {1, 3}, {0, 1}, {2, 3}}};  // by Side

// How far in mm (a distance in space) a patch's grids of 2^k cells a side lie from the finest surface, k = 0..6.
using CoarseErrors = std::array<float, 7>;
// Of those of 16, 32 and 64 cells by blocks of 8 x 8 cells: 2, 4 and 8 blocks a side, one grid after the other, rows of
// v from 0. As bytes: shares of the whole patch's error of that grid, rounded up.
inline constexpr int kFirstBlockedGrid = 4, kBlockedGrids = 3;
using CoarseBlocks = std::array<uint8_t, 4 + 16 + 64>;
inline constexpr std::array<size_t, kBlockedGrids + 1> kFirstCoarseBlock{0, 4, 20, 84};
// Which way these errors lie: of the grids of 1, 2, 4 and 8 cells as a whole, then as CoarseBlocks has them.
inline constexpr size_t kFirstShapedBlock = 4;
using CoarseShapes = std::array<DeviationShape, kFirstShapedBlock + 84>;
inline float coarseBlockMm(float whole_mm, uint8_t share) {
  if (share == 0) return 0;
  if (share == 255) return whole_mm;
  return std::nextafter(static_cast<float>(double{whole_mm} * share / 255), whole_mm);
}

// Ranges over a patch of the difference quotients of its heights between neighbouring finest samples along u and along
// v: mm over a patch's side. They bound which way its surface can face (geometry/lod/facing_cone.h).
struct HeightSlopes {
  float min_u = 0, max_u = 0, min_v = 0, max_v = 0;
  friend bool operator==(const HeightSlopes&, const HeightSlopes&) = default;
};

// Base meshes that take few bytes in a package have corners on lattices: positions k step from the origin, in single
// precision, |k| at most 2^23, and components of normals in 1024ths, which leaves a normal's length within 1e-3 of 1.
// Corners come in the order in which patches name them first.
inline constexpr double kNormalSteps = 1024;
inline constexpr int32_t kMostPositionSteps = 1 << 23;
BaseMesh onLattice(const BaseMesh& mesh, double step_mm);
// The same patches, each next to one shortly before it (open_sides.h): what is coded in their order takes fewer bytes.
BaseMesh inSequence(const BaseMesh& mesh);
// A coordinate on such a lattice, or near it, as one on the lattice of another unit.
float onStep(float v, double step, double new_step);

// A patch's tail, resident whenever the patch is: its heights at 2^kTailCellsLog2 cells a side and its texture's levels
// of kTailTexels a side and fewer (texturing/package/patch_tails.h).
inline constexpr int kTailCellsLog2 = 4;
inline constexpr int kTailTexels = 16;
// A level that no page has: the tail in a page's place.
inline constexpr uint32_t kTailLevel = 31;

// What lies across a patch's side.
struct PatchNeighbour {
  static constexpr uint32_t kNone = ~uint32_t{0};
  uint32_t patch = kNone;  // kNone: the mesh's border
  Side side = kLeft;       // the neighbour's side
  bool reversed = false;   // its parameter runs the other way
  friend bool operator==(const PatchNeighbour&, const PatchNeighbour&) = default;
};
using PatchNeighbours = std::array<PatchNeighbour, 4>;  // by Side

// By patch. Sides that more than two patches share, or a patch with itself, are borders for all of them.
std::vector<PatchNeighbours> patchNeighbours(const BaseMesh& mesh);

// Is it fit for use: indices in range, all numbers finite, normals of length 1 (within 1e-3), no patch that names a
// corner twice, at least one patch? Says what is wrong, or nothing.
std::string baseMeshProblem(const BaseMesh& mesh);

}  // namespace relievo
