// strategy_edge_length.cpp - edge LOD with a length metric: segments of an edge are no longer on screen than
// kLengthPerBudget budgets, whatever the relief does there (Dyken, Reimers, Seland 2009 measure silhouettes, Schulze
// Nilsson 2014 lengths). What error that leaves is known afterwards, not chosen.
#include <cmath>
#include <limits>

#include "geometry/lod/lod_common.h"
#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

constexpr double kLengthPerBudget = 4;

// Claims that every page but the finest is off by its whole range of heights: then only the cells' width stops the
// refinement (LodView::min_cell_px). Where heights hardly differ they are given a thousandth of the artwork's range.
class NeverGoodEnough final : public ReliefOracle {
 public:
  explicit NeverGoodEnough(const StrategyScene& scene)
      : truth_(scene.oracle),
        over_mesh_(!scene.domain.isFlat()),
        least_mm_(static_cast<float>(std::abs(65535 * scene.domain.relief_scale_mm) / 1000)) {}
  HeightBounds bounds(const NodeId& page) const override {
    HeightBounds b = truth_->bounds(page);
    b.max_mm = std::max(b.max_mm, b.min_mm + least_mm_);
    // Over a base mesh a distance in space, which mesh_lod.h cuts to the square's size.
    b.error_mm = over_mesh_ ? std::numeric_limits<float>::infinity() : b.max_mm - b.min_mm;
    return b;
  }

 private:
  std::shared_ptr<const ReliefOracle> truth_;
  bool over_mesh_;
  float least_mm_;
};

class EdgeLength final : public LodStrategy {
 public:
  explicit EdgeLength(const StrategyScene& scene)
      : lod_(scene, std::make_shared<NeverGoodEnough>(scene)), bounds_(scene) {}
  StrategyResult select(const LodView& view) override {
    LodView v = view;
    // Refining ends at twice the least width, which planar_lod.h narrows where the error is many times the budget: here
    // it always is.
    v.min_cell_px = kLengthPerBudget * view.error_px / (2 * leastCellPx(1, std::numeric_limits<double>::infinity()));
    v.error_px = 0;
    LodResult lod = lod_.select(v);
    StrategyResult result;
    result.instances = std::move(lod.instances);
    result.error_px = view.error_px;
    result.predicted_px = bounds_.boundPx(ViewBounds(view), result.instances, view.exaggerate);
    return result;
  }

 private:
  SceneLod lod_;
  ReliefBounds3d bounds_;
};

}  // namespace

StrategyEntry edgeLengthStrategy() {
  StrategyEntry e;
  e.name = "edge-length";
  e.title = "Edge LOD, length metric";
  e.purpose = "as edge-lod, but edges are cut into segments of at most 4 budgets on screen, whatever error that leaves";
  e.make = [](const StrategyScene& scene) { return std::make_unique<EdgeLength>(scene); };
  return e;
}

}  // namespace relievo
