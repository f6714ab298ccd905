// strategy_bounds.h - boxes, culling and error bounds, for strategies that do not use planar_lod.h's selection. The
// bounds are those of the edge LOD (geometry/lod/ERROR_BOUND.md), so that a comparison shows the strategies' difference
// and not the metrics'; but they are a node's, not an edge's.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/lod/lod_common.h"
#include "geometry/lod/mesh_forest.h"
#include "geometry/strategies/lod_strategy.h"

namespace relievo {

struct WorldBox {
  glm::dvec3 centre{0}, half{0};
  bool any_direction = false;  // what is in it moves anyhow; else along z alone: a flat artwork's heights
};

class ViewBounds {
 public:
  explicit ViewBounds(const LodView& view) : camera_(view) {}
  bool valid() const { return camera_.valid; }
  bool orthographic() const { return camera_.orthographic; }
  bool culled(const WorldBox& box) const;
  // Pixels that a millimetre of movement, anywhere in the box, can be on screen.
  double pxPerMm(const WorldBox& box) const;
  // From the eye; orthographic: kFarEyeMm.
  double nearestMm(const WorldBox& box) const;
  double farthestMm(const WorldBox& box) const;
  static constexpr double kFarEyeMm = 1e15;
  // From this distance on a movement by so many millimetres is at most so many pixels, wherever in the picture.
  // Orthographic: 0 or infinity.
  double distanceFor(double mm, double px) const;

 private:
  LodCamera camera_;
};

class ReliefBounds3d {
 public:
  explicit ReliefBounds3d(const StrategyScene& scene);
  const PatchDomain& domain() const { return scene_.domain; }
  int unitLog2() const { return unit_log2_; }                         // log2 of a patch's side in units
  int finestLevel() const { return scene_.domain.relief_depth + 7; }  // absolute level of the finest samples
  WorldBox box(const NodeId& node, double exaggerate);
  // Exaggerated, of the surface through the samples of an absolute level, over the node; 0 from the finest level on.
  Deviation deviation(const NodeId& node, int level, double exaggerate);
  double errorMm(const NodeId& node, int level, double exaggerate) { return deviation(node, level, exaggerate).mm; }
  // How far from one another two of the points that it leads to may lie, in any direction.
  double betweenMm(const NodeId& node, int level, double exaggerate);
  double errorPx(const ViewBounds& view, const NodeId& node, int level, double exaggerate) {
    const double error = errorMm(node, level, exaggerate);
    return error > 0 ? error * view.pxPerMm(box(node, exaggerate)) : 0;
  }
  // Root mean square of the level's pages' errors over the whole artwork, and never less than a finer level's; not
  // exaggerated.
  double typicalErrorMm(int level) const {
    return level >= finestLevel() ? 0 : typical_[static_cast<size_t>(std::max(0, level))];
  }
  double rangeMm(const NodeId& node);                       // of heights
  double largestMm(const NodeId& node, double exaggerate);  // that any error can be
  // The node of the same level across a side.
  bool neighbour(const NodeId& node, int side, NodeId* out) const;
  // An instance as strategies make it: whole edges of its own grid's level, displaced from the coarsest page that has
  // its samples.
  PatchInstance instance(const NodeId& node, int grid_level) const;
  // Nodes of a level in view, by patch, then in rows.
  std::vector<NodeId> nodesInView(const ViewBounds& view, int level, double exaggerate);
  // The bound for a list of instances, whoever chose their levels: where vertices snapped to a coarser level,
  // betweenMm() of that.
  double boundPx(const ViewBounds& view, const std::vector<PatchInstance>& instances, double exaggerate);

 private:
  const HeightBounds& heights(const NodeId& page);
  Deviation heightDeviation(const NodeId& node, int level);
  void descend(const ViewBounds& view, const NodeId& node, int level, double exaggerate, std::vector<NodeId>& out);

  StrategyScene scene_;
  std::shared_ptr<MeshForest> forest_;  // over a base mesh
  int unit_log2_ = 0;
  std::unordered_map<NodeId, HeightBounds> heights_;
  std::unordered_map<NodeId, PartErrors> parts_;
  std::vector<double> typical_;
};

}  // namespace relievo
