// base_fit.h - how well a scan is reached by lines from a base mesh along its normals: what lies in undercuts is not.
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/remesh/base_place.h"
#include "geometry/remesh/base_quads.h"

namespace relievo {

struct Fit {
  std::vector<float> error;  // of each vertex of the surface: its distance from the displaced base, or the base's from
                             // it beyond a border
  double lost = 0;           // the part of the surface's area that is further away than kLostDistance; and of the base
};
// In diagonals. The samples' own spacing leaves less.
inline constexpr float kLostDistance = 2e-3f;

// cells: of a patch's side that the base is displaced at.
Fit judgeFit(const QuadMesh& quads, const std::vector<glm::dvec3>& normals, const Surface& s, const ScanLookup& scan,
             int cells);
// Corners at which quads fold over, or nearly, seen along the corners' normals.
std::vector<uint8_t> foldedCorners(const QuadMesh& quads, const std::vector<glm::dvec3>& normals);
// Raises the weights (SimplifyOptions::weight) where the surface is lost or lies next to folded corners (regions:
// cornerRegions), so that patches get smaller there.
void raiseWeights(const Fit& fit, const std::vector<uint8_t>& folded, const std::vector<uint32_t>& regions,
                  const Surface& s, std::vector<float>& weight);

}  // namespace relievo
