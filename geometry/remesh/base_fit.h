// base_fit.h - measures how much of a scan lines along a base mesh's normals reach. Undercuts are out of reach. Units:
// diagonals of the scan.
#pragma once

#include <vector>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/corner_placement.h"

namespace relievo {

struct Fit {
  // For each vertex of the surface its distance from the displaced base, or the base's distance from it beyond a
  // border; 1 where the former is clearly more than kMaxFitDistance.
  std::vector<float> vertex_error;
  // The share of the surface's area beyond kMaxFitDistance, plus that of the base's area that has no counterpart in the
  // scan.
  double lost_area = 0;
};
// The spacing of the samples causes smaller distances.
inline constexpr float kMaxFitDistance = 2e-3f;

// Displaces the base at `cells` cells. detailed: cells are distributed by the patches' area, and surface that spans
// from one part of the scan to another counts as lost. workers: 0 is one for each core.
Fit measureFit(const QuadMesh& quads, const TriangleMesh& surface, const ScanSurface& scan, size_t cells, bool detailed,
               int workers);
// Raises the weights (SimplifyOptions::weight) where the surface is lost or next to folded corners, so that patches get
// smaller there.
void raiseWeights(const Fit& fit, const QuadMesh& quads, const TriangleMesh& surface, const Regions& regions,
                  std::vector<float>& weight);

}  // namespace relievo
