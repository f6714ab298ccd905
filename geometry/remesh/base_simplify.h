// base_simplify.h - a surface down to a wanted number of well-shaped triangles, its topology kept: pieces, handles and
// border loops. Edge collapses by the quadric error of planes known with an uncertainty (Trettner and Kobbelt 2020):
// where the surface is flat, the uncertainty alone decides, and asks for triangles of even size and shape.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

// Triangles whose vertices know the triangles around them; removed ones are left as {kNoIndex, ...} and empty fans.
struct EditMesh {
  std::vector<glm::dvec3> points;
  std::vector<Triangle> triangles;
  std::vector<std::vector<uint32_t>> fans;
  std::vector<uint8_t> border, fixed;         // of a vertex
  std::vector<std::vector<CurveStep>> steps;  // of a vertex: along the feature curves that it is on
  uint32_t live = 0;                          // triangles

  EditMesh(const Surface& s, const FeatureCurves& curves);
  const CurveStep* step(uint32_t a, uint32_t b) const;  // of the feature curve from a to b; null: their edge is on none
  uint32_t sharing(uint32_t a, uint32_t b, std::array<uint32_t, 2>& found) const;  // triangles at the edge: 0, 1 or 2
};

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
void simplify(EditMesh& mesh, const SimplifyOptions& options);
// Turns edges over where that makes valences more even and the surface no rougher.
void flipEdges(EditMesh& mesh);  // none of a feature curve

}  // namespace relievo
