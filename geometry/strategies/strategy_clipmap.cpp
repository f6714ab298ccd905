// strategy_clipmap.cpp - geometry clipmaps: nested square rings of grids around the place that the viewer stands above,
// each of cells twice as wide as those of the one inside. Losasso, Hoppe 2004, "Geometry Clipmaps: Terrain Rendering
// Using Nested Regular Grids"; Asirvatham, Hoppe 2005 (GPU Gems 2, chapter 2).
//
// As theirs: about 256 cells across (theirs 254) wherever the budget asks for no more; a ring is made of square blocks
// (here 16 cells wide, theirs 63); rings that would be less than 2.5 times as wide as the viewer is high are left out
// (2004, section 3.2). Unlike theirs: rings move by two blocks instead of two cells, since they are made of the nodes
// that every strategy draws; all heights are resident, so nothing is copied along; and instead of blending a ring's
// outer tenth into the coarser one, the vertices on its outer border snap to it (patch.vert), which closes the seam bit
// for bit and lets the change be seen.
//
// Their rings know no error: 255 was chosen for triangles of about 3 px. Here all rings are made as wide as the level
// needs whose typical error (root mean square over the artwork's pages, as in strategy_cdlod.cpp) reaches farthest. One
// width for all places is the method's nature, so places rougher than most exceed the budget: what bound that leaves is
// told, none is kept.
#include <algorithm>
#include <cmath>

#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

constexpr int kBlockLog2 = 4;         // cells of a block
constexpr int64_t kLeastBlocks = 16;  // of a ring's width: 256 cells
constexpr int64_t kMostBlocks = int64_t{1} << 20;
constexpr double kLeastHeights = 2.5;  // of a ring's width over the viewer's height

// In blocks of its level; inside it the finer ring lies.
struct ClipRing {
  int64_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool holds(int64_t x, int64_t y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
};

class Clipmap final : public LodStrategy {
 public:
  explicit Clipmap(const StrategyScene& scene) : scene_(scene), bounds_(scene) {
    finest_ = bounds_.finestLevel();
    coarsest_ = std::min(kBlockLog2, finest_);
  }

  StrategyResult select(const LodView& view) override {
    const ViewBounds screen(view);
    StrategyResult out;
    out.error_px = view.error_px;
    const int first = finestRing(view, screen);
    layRings(view, screen, first);
    for (int level = first; level >= coarsest_; --level)
      for (const NodeId& node : bounds_.nodesInView(screen, level - coarsest_, view.exaggerate))
        addBlock(node, level, first, out);
    sortInstances(out.instances);
    out.predicted_px = bounds_.boundPx(screen, out.instances, view.exaggerate);
    return out;
  }

 private:
  double blockMm(int level) const {
    return std::ldexp(static_cast<double>(scene_.domain.patchPx()) * scene_.domain.mm_per_px, coarsest_ - level);
  }
  // Orthographic: the level whose typical error is within the budget, everywhere.
  int finestRing(const LodView& view, const ViewBounds& screen) const {
    int level = finest_;
    if (screen.orthographic()) {
      while (level > coarsest_ && reachMm(level, view, screen) == 0) --level;
      return level;
    }
    const double high = std::abs(view.eye_mm.z - scene_.domain.relief_offset_mm * view.exaggerate);
    while (level > coarsest_ && static_cast<double>(kLeastBlocks) * blockMm(level) < kLeastHeights * high &&
           reachMm(level, view, screen) <= high)
      --level;
    return level;
  }
  // How far from the eye a level is needed: nearer, the next coarser one's typical error exceeds the budget.
  double reachMm(int level, const LodView& view, const ViewBounds& screen) const {
    return screen.distanceFor(bounds_.typicalErrorMm(level - 1) * std::abs(view.exaggerate), view.error_px);
  }
  void layRings(const LodView& view, const ViewBounds& screen, int first) {
    // As many blocks for each, or their squares would not nest.
    int64_t blocks = kLeastBlocks;
    for (int level = first; level > coarsest_; --level) {
      const double half = std::min(reachMm(level, view, screen) / blockMm(level), 1.0 * kMostBlocks);
      // Two more, since a ring is where its blocks allow it to be.
      blocks = std::max(blocks, 2 * (static_cast<int64_t>(std::ceil(half)) + 2));
    }
    blocks = std::min((blocks + 3) / 4 * 4, kMostBlocks);
    const FlatDomain d = scene_.domain.flat();
    const double x = view.eye_mm.x + 0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
                 y = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px - view.eye_mm.y;
    for (int level = first; level >= coarsest_; --level) {
      auto corner = [&](double foot_mm) {
        const double at = std::clamp(foot_mm / blockMm(level), -1.0 * kMostBlocks, 1.0 * kMostBlocks);
        // Even: its sides lie between the coarser level's blocks.
        return 2 * static_cast<int64_t>(std::llround((at - 0.5 * static_cast<double>(blocks)) / 2));
      };
      ClipRing& ring = rings_[static_cast<size_t>(level)];
      ring = {corner(x), corner(y), 0, 0};
      ring.x1 = ring.x0 + blocks;
      ring.y1 = ring.y0 + blocks;
      // The finer ring, and a block around it, lies within, so that neighbours differ by one level.
      if (level < first) {
        const ClipRing& inner = rings_[static_cast<size_t>(level) + 1];
        auto floorEven = [](int64_t v) { return v - (v & 1); };
        ring.x0 = std::min(ring.x0, floorEven((inner.x0 >> 1) - 1));
        ring.y0 = std::min(ring.y0, floorEven((inner.y0 >> 1) - 1));
        ring.x1 = std::max(ring.x1, floorEven((inner.x1 >> 1) + 2));
        ring.y1 = std::max(ring.y1, floorEven((inner.y1 >> 1) + 2));
      }
    }
    // The coarsest is everywhere.
    if (screen.orthographic())
      rings_[static_cast<size_t>(first)] = {-kMostBlocks, -kMostBlocks, kMostBlocks, kMostBlocks};
    rings_[static_cast<size_t>(coarsest_)] = {-kMostBlocks, -kMostBlocks, kMostBlocks, kMostBlocks};
  }
  void addBlock(const NodeId& node, int level, int first, StrategyResult& out) {
    const FlatDomain d = scene_.domain.flat();
    const int64_t along = int64_t{node.patch} << node.level, x = node.x + (d.alongX() ? along : 0),
                  y = node.y + (d.alongX() ? 0 : along);
    const ClipRing& ring = rings_[static_cast<size_t>(level)];
    if (!ring.holds(x, y)) return;
    if (level < first && rings_[static_cast<size_t>(level) + 1].holds(2 * x, 2 * y)) return;
    PatchInstance p = bounds_.instance(node, coarsest_);
    // On the ring's border an edge has the coarser ring's cells.
    const std::array<bool, 4> beyond = {!ring.holds(x - 1, y), !ring.holds(x + 1, y), !ring.holds(x, y - 1),
                                        !ring.holds(x, y + 1)};
    for (size_t side = 0; side < 4; ++side)
      if (beyond[side]) p.edges[side] = {static_cast<uint8_t>(coarsest_ - 1), PatchInstance::kWholeEdge};
    out.instances.push_back(p);
  }

  StrategyScene scene_;
  ReliefBounds3d bounds_;
  int finest_ = 0, coarsest_ = 0;  // absolute levels of vertices
  std::array<ClipRing, kMorphLevels> rings_{};
};

}  // namespace

StrategyEntry clipmapStrategy() {
  StrategyEntry e;
  e.name = "clipmap";
  e.title = "Geometry clipmap";
  e.purpose =
      "nested square rings of grids around the place below the viewer, 256 cells across, or more where the typical "
      "error asks for it; what lies rougher exceeds the budget";
  e.flat_only = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Clipmap>(scene); };
  return e;
}

}  // namespace relievo
