// strategy_no_snapping.cpp - a negative control: the patches of edge-lod, but their vertices stay where they are. Where
// levels meet, vertices of the finer side lie beside the coarser side's edges: the measuring must see mismatches, and
// cracks.
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class NoSnapping final : public LodStrategy {
 public:
  explicit NoSnapping(const StrategyScene& scene) : edge_lod_(edgeLodStrategy().make(scene)) {}
  StrategyResult select(const LodView& view) override {
    StrategyResult result = edge_lod_->select(view);
    result.rule = GridRule::kUnsnapped;
    return result;
  }

 private:
  std::unique_ptr<LodStrategy> edge_lod_;
};

}  // namespace

StrategyEntry noSnappingStrategy() {
  StrategyEntry e;
  e.name = "no-snapping";
  e.title = "Edge LOD without snapping";
  e.purpose = "edge-lod's patches with every vertex where its grid has it: cracks wherever levels meet";
  e.control = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<NoSnapping>(scene); };
  return e;
}

}  // namespace relievo
