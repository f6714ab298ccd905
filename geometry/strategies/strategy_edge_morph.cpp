// strategy_edge_morph.cpp - edge-LOD quad patches as in strategy_edge_lod.cpp, with continuous levels: vertices slide
// to their places (morph.h).
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class EdgeMorph final : public LodStrategy {
 public:
  explicit EdgeMorph(const StrategyScene& scene) : lod_(scene) {}
  StrategyResult select(const LodView& view) override {
    LodView v = view;
    v.min_cell_px = 0;
    v.morph = true;
    StrategyResult result = certifiedResult(lod_.select(v));
    result.rule = GridRule::kGeomorph;
    return result;
  }

 private:
  SceneLod lod_;
};

}  // namespace

StrategyEntry edgeMorphStrategy() {
  StrategyEntry e;
  e.name = "edge-lod-morph";
  e.title = "Edge LOD, geomorph";
  e.purpose =
      "edge-lod with continuous levels: vertices come and go in the middle of their neighbours, within the budget";
  e.keeps_budget = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<EdgeMorph>(scene); };
  return e;
}

}  // namespace relievo
