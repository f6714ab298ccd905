// compare_scene.h - an artwork's relief, all of it in memory: for the strategies, for the truth, and for the GPU.
#pragma once

#include <atomic>
#include <memory>
#include <unordered_map>

#include "geometry/strategies/lod_strategy.h"
#include "src/engine/engine.h"
#include "src/render/strategy_pass.h"

namespace relievo {

struct CompareScene {
  StrategyScene strategy;
  std::unordered_map<NodeId, uint32_t> encoded_bytes;  // of each relief page, as the package holds it
  uint64_t pages = 0;
};

// Reads every relief page once. Refuses an artwork whose relief takes more than budget_bytes (kUnsupported), or has
// none; a damaged page is an error (kInvalidData).
Result<CompareScene> loadCompareScene(std::shared_ptr<const Package> package, uint64_t budget_bytes, gl::Api api,
                                      std::unique_ptr<StrategyPass>* pass, const std::atomic<bool>* interrupted);

}  // namespace relievo
