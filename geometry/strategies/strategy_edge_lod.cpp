// strategy_edge_lod.cpp - edge-LOD quad patches with the error metric (planar_lod.h, mesh_lod.h), refined until the
// budget holds everywhere.
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class EdgeLod final : public LodStrategy {
 public:
  explicit EdgeLod(const StrategyScene& scene) : lod_(scene) {}
  StrategyResult select(const LodView& view) override {
    LodView v = view;
    v.min_cell_px = 0;
    return certifiedResult(lod_.select(v));
  }

 private:
  SceneLod lod_;
};

}  // namespace

StrategyEntry edgeLodStrategy() {
  StrategyEntry e;
  e.name = "edge-lod";
  e.title = "Edge LOD, error metric";
  e.purpose =
      "quad patches with a level an edge by the certified error, vertices snapped; cells as small as the budget asks "
      "for";
  e.keeps_budget = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<EdgeLod>(scene); };
  return e;
}

}  // namespace relievo
