// base_simplify.h - simplifies a surface to a given number of well-shaped triangles, and keeps its topology (pieces,
// handles, border loops). Edges collapse by a quadric error whose planes have an uncertain direction (Trettner and
// Kobbelt 2020): where the surface is flat, the uncertainty prefers triangles of even size and shape.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>

#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

struct SimplifyOptions {
  uint32_t triangles = 0;    // the target; more where the topology needs them
  double uncertainty = 0.2;  // standard deviation of a plane's direction, radians; bends below it count as flat
  // For each vertex: 16 times the weight halves the triangles' sides around it; or empty.
  std::span<const float> weight;
  // How far a border's feature curve may deviate from the edges along it (deviationFromSide): one for each feature
  // curve, or empty for no bound. The bound is relaxed if too many triangles remain.
  std::span<const FeatureCurve> curves;
  std::span<const double> allowed_deviation;
  // Keep smaller triangles where the surface folds, at the expense of their shape.
  bool follow_folds = false;
  const std::atomic<bool>* interrupted = nullptr;
};
// Fixed vertices stay; vertices on feature curves stay or are removed along the curve; others move. Vertices and faces
// are renumbered.
void simplify(TriangleMesh& mesh, const SimplifyOptions& options);
// Flips edges where that evens out valences and does not make the surface rougher; none of a feature curve.
void flipEdges(TriangleMesh& mesh);

}  // namespace relievo
