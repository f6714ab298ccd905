// base_fit.h - how well a scan is reached by lines from a base mesh along its normals: what lies in undercuts is not.
#pragma once

#include <vector>

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

// The base is displaced at so many cells. closely: spread over the patches by their area, and what spans from one part
// of the scan to another is lost, too.
Fit judgeFit(const QuadMesh& quads, const TriangleMesh& surface, const ScanLookup& scan, size_t cells, bool closely);
// Raises the weights (SimplifyOptions::weight) where the surface is lost or lies next to folded corners, so that
// patches get smaller there.
void raiseWeights(const Fit& fit, const QuadMesh& quads, const TriangleMesh& surface, const Regions& regions,
                  std::vector<float>& weight);

}  // namespace relievo
