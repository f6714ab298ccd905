// base_simplify.h - a surface down to a wanted number of well-shaped triangles, its topology kept: pieces, handles and
// border loops. Edge collapses by the quadric error of planes known with an uncertainty (Trettner and Kobbelt 2020):
// where the surface is flat, the uncertainty alone decides, and asks for triangles of even size and shape.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>

#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

struct SimplifyOptions {
  uint32_t triangles = 0;    // down to, where the topology lets it
  double uncertainty = 0.2;  // of a plane's direction, in radians: what bends less over a triangle counts as flat
  std::span<const float>
      weight;  // of a vertex's surroundings: 16 times the weight halves the triangles' sides; or empty
  // How far a border's feature curve may stray from the edges along it (deviationFromSide): by feature curve, or empty:
  // anywhere. Where too many triangles remain, ever further.
  std::span<const FeatureCurve> curves;
  std::span<const double> deviation;
  const std::atomic<bool>* interrupted = nullptr;
};
// Vertices on feature curves stay where they are or go, along their feature curve; fixed ones stay; others move.
// Vertices and faces are numbered anew.
void simplify(TriangleMesh& mesh, const SimplifyOptions& options);
// Turns edges over where that makes valences more even and the surface no rougher.
void flipEdges(TriangleMesh& mesh);  // none of a feature curve

}  // namespace relievo
