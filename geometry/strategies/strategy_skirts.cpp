// strategy_skirts.cpp - a negative control: as no-snapping, with a skirt hung from every side of every patch, as deep
// as both sides of an edge can differ. No background shows through the cracks, but skirts do: places are seen where
// they are not.
#include <cmath>

#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

class Skirts final : public LodStrategy {
 public:
  explicit Skirts(const StrategyScene& scene)
      : scene_(scene), bounds_(scene), edge_lod_(edgeLodStrategy().make(scene)) {}

  StrategyResult select(const LodView& view) override {
    StrategyResult result = edge_lod_->select(view);
    result.rule = GridRule::kUnsnapped;
    result.predicted_px = -1;  // a skirt is off by its depth
    for (uint32_t k = 0; k < result.instances.size(); ++k) hang(k, view.exaggerate, result);
    return result;
  }

 private:
  void hang(uint32_t index, double exaggerate, StrategyResult& out) {
    const PatchInstance p = out.instances[index];
    int coarsest = p.grid_level;
    for (const auto& side : p.edges)
      coarsest =
          std::min<int>(coarsest, side[1] == PatchInstance::kWholeEdge ? side[0] : 1 + std::min(side[0], side[1]));
    double depth_mm = bounds_.errorMm(p.node, static_cast<int>(p.node.level) + coarsest, exaggerate) +
                      bounds_.errorMm(p.node, static_cast<int>(p.node.level) + p.grid_level, exaggerate);
    const double step_mm = exaggerate * scene_.domain.relief_scale_mm;
    auto depth_steps = static_cast<float>(step_mm == 0 ? 0 : std::copysign(depth_mm / std::abs(step_mm) + 1, step_mm));
    int32_t last = 1 << p.grid_level;
    auto vertex = [&](int32_t i, int32_t j, bool low) {
      StrategyVertex v;
      v.x = p.x0 + (i << p.step_log2);
      v.y = p.y0 + (j << p.step_log2);
      v.height_steps = static_cast<float>(scene_.heightSteps(p, v.x, v.y)) - (low ? depth_steps : 0);
      v.instance = index;
      return v;
    };
    for (int side = 0; side < 4; ++side)
      for (int32_t k = 0; k < last; ++k) {
        auto at = [&](int32_t along, bool low) {
          bool upright = side == kLeft || side == kRight;
          int32_t across = side == kLeft || side == kTop ? 0 : last;
          return upright ? vertex(across, along, low) : vertex(along, across, low);
        };
        for (const StrategyVertex& v :
             {at(k, false), at(k + 1, false), at(k + 1, true), at(k, false), at(k + 1, true), at(k, true)})
          out.triangles.push_back(v);
      }
  }

  StrategyScene scene_;
  ReliefBounds3d bounds_;
  std::unique_ptr<LodStrategy> edge_lod_;
};

}  // namespace

StrategyEntry skirtsStrategy() {
  StrategyEntry e;
  e.name = "skirts";
  e.title = "Skirts instead of snapping";
  e.purpose =
      "no-snapping's patches, each with skirts that hide the cracks: bits differ all the same, and skirts are seen "
      "where nothing is";
  e.control = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Skirts>(scene); };
  return e;
}

}  // namespace relievo
