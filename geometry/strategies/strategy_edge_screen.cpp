// strategy_edge_screen.cpp - edge LOD as the engine asks for it: no cells narrower on screen than LodView::min_cell_px
// (two budgets; planar_lod.h lets walls have down to a quarter of that). Steps and cracks in the relief keep an error
// until the finest level, so that without this floor they alone decide how many triangles there are.
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class EdgeScreen final : public LodStrategy {
 public:
  explicit EdgeScreen(const StrategyScene& scene) : lod_(scene) {}
  StrategyResult select(const LodView& view) override { return certifiedResult(lod_.select(view)); }

 private:
  SceneLod lod_;
};

}  // namespace

StrategyEntry edgeScreenStrategy() {
  StrategyEntry e;
  e.name = "edge-screen";
  e.title = "Edge LOD, least cell width";
  e.purpose =
      "as edge-lod, but no cells narrower on screen than two budgets (at walls half a budget): what the viewer draws; "
      "the error it leaves is foreseen";
  e.make = [](const StrategyScene& scene) { return std::make_unique<EdgeScreen>(scene); };
  return e;
}

}  // namespace relievo
