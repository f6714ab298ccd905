// compare_scene.h - an artwork's relief, all of it in memory: for the strategies, for the truth, and for the GPU.
#pragma once

#include <atomic>
#include <memory>
#include <unordered_map>

#include "geometry/strategies/lod_strategy.h"
#include "geometry/strategies/strategy_bounds.h"
#include "src/engine/engine.h"
#include "src/render/strategy_pass.h"

namespace relievo {

struct CompareScene {
  StrategyScene strategy;
  // Of each relief page, as the package holds it.
  struct Encoded {
    uint32_t bytes = 0;
    float decode_ms = 0;  // by one thread
  };
  std::unordered_map<NodeId, Encoded> encoded;
  uint64_t pages = 0;  // in memory: of those that are alike one
};

// Reads every relief page twice: first to see which are alike, as those of flat patches. Refuses an artwork whose
// relief takes more than budget_bytes (kUnsupported), or has none; a damaged page is an error (kInvalidData).
// pages: where its relief is read, if not from the package.
Result<CompareScene> loadCompareScene(std::shared_ptr<const Package> package, uint64_t budget_bytes, gl::Api api,
                                      std::unique_ptr<StrategyPass>* pass, const std::atomic<bool>* interrupted,
                                      const PageSource* pages = nullptr);

// What is in view at full resolution, without any seam: grids of one level, the finest one that the limit of triangles
// allows.
struct ReferenceGrid {
  StrategyResult drawn;
  bool whole = true;  // false: coarser than full resolution
};
ReferenceGrid referenceGrid(ReliefBounds3d& bounds, const ViewBounds& screen, double exaggerate,
                            uint64_t triangles_at_most);

}  // namespace relievo
