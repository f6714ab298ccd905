// strategy_tessellation.cpp - hardware tessellation: equal nodes, each cut by the GPU into up to 64 x 64 cells by a
// factor an edge, chosen as edge-lod chooses its levels (both nodes of an edge, the certified error). Factors are
// powers of two and the shader rounds to whole samples, so shared vertices agree. What triangles lie between them is
// the tessellator's business: nothing is promised.
#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

constexpr int kMaxFactorLog2 = 6;  // GL guarantees 64

class Tessellation final : public LodStrategy {
 public:
  explicit Tessellation(const StrategyScene& scene) : bounds_(scene) {}

  StrategyResult select(const LodView& view) override {
    ViewBounds screen(view);
    StrategyResult result;
    result.rule = GridRule::kTessellated;
    result.error_px = view.error_px;
    for (int node_level = 0;; ++node_level) {
      bool last = node_level + kMaxFactorLog2 >= bounds_.finestLevel();
      result.instances.clear();
      bool enough = true;
      for (const NodeId& node : bounds_.nodesInView(screen, node_level, view.exaggerate)) {
        std::array<std::array<uint8_t, 2>, 4> edges{};
        int inner = 1;
        for (int side = 0; side < 4; ++side) {
          int level = wantedLevel(node, side, screen, view);
          enough = enough && (last || level <= node_level + kMaxFactorLog2);
          int factor_log2 = std::min(level - node_level, kMaxFactorLog2);
          edges[static_cast<size_t>(side)] = {static_cast<uint8_t>(factor_log2), PatchInstance::kWholeEdge};
          inner = std::max(inner, factor_log2);
        }
        if (!enough) break;
        PatchInstance p = bounds_.instance(node, inner);
        p.edges = edges;
        result.instances.push_back(p);
      }
      if (enough) break;
    }
    sortInstances(result.instances);
    return result;
  }

 private:
  // A function of the two nodes of an edge, never of which of them asks.
  int wantedLevel(const NodeId& node, int side, const ViewBounds& screen, const LodView& view) {
    WorldBox box = bounds_.box(node, view.exaggerate);
    NodeId other = node;
    bool has_other = bounds_.neighbour(node, side, &other);
    if (has_other) {
      WorldBox b = bounds_.box(other, view.exaggerate);
      glm::dvec3 low = glm::min(box.centre - box.half, b.centre - b.half),
                 high = glm::max(box.centre + box.half, b.centre + b.half);
      box = {0.5 * (low + high), 0.5 * (high - low), box.any_direction};
    }
    double px_per_mm = screen.pxPerMm(box);
    int level = static_cast<int>(node.level);
    for (; level < bounds_.finestLevel(); ++level) {
      double error = bounds_.errorMm(node, level, view.exaggerate);
      if (has_other) error = std::max(error, bounds_.errorMm(other, level, view.exaggerate));
      if (error * px_per_mm <= view.error_px) break;
    }
    return level;
  }

  ReliefBounds3d bounds_;
};

}  // namespace

StrategyEntry tessellationStrategy() {
  StrategyEntry e;
  e.name = "tessellation";
  e.title = "Hardware tessellation";
  e.purpose = "equal nodes, cut by the GPU's tessellator into up to 64 x 64 cells by a factor an edge";
  e.needs_tessellation = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Tessellation>(scene); };
  return e;
}

}  // namespace relievo
