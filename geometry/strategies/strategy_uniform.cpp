// strategy_uniform.cpp - one grid over all that is in view, so fine that the budget holds everywhere: what a plain
// height-field mesh with culling does. The level is that of the place which needs most, mostly the nearest one;
// everything else pays for it.
#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class Uniform final : public LodStrategy {
 public:
  explicit Uniform(const StrategyScene& scene) : over_mesh_(!scene.domain.isFlat()), bounds_(scene) {}

  StrategyResult select(const LodView& view) override {
    ViewBounds screen(view);
    StrategyResult result;
    result.error_px = view.error_px;
    for (int level = over_mesh_ ? 0 : 1;; ++level) {
      // As few instances as grids of 32 cells allow.
      int node_level = std::max(0, level - kMaxGridLevel);
      auto nodes = bounds_.nodesInView(screen, node_level, view.exaggerate);
      double bound = 0;
      bool last = level >= bounds_.finestLevel();
      for (const NodeId& n : nodes) {
        bound = std::max(bound, bounds_.errorPx(screen, n, level, view.exaggerate));
        if (bound > view.error_px && !last) break;
      }
      if (bound > view.error_px && !last) continue;
      for (const NodeId& n : nodes) result.instances.push_back(bounds_.instance(n, level - node_level));
      result.predicted_px = bound;
      return result;
    }
  }

 private:
  bool over_mesh_;  // patches may be single cells there
  ReliefBounds3d bounds_;
};

}  // namespace

StrategyEntry uniformStrategy() {
  StrategyEntry e;
  e.name = "uniform";
  e.title = "Uniform grid";
  e.purpose = "one grid level for all that is in view, chosen so that the budget holds where most is needed";
  e.keeps_budget = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Uniform>(scene); };
  return e;
}

}  // namespace relievo
