#include "geometry/strategies/strategy_list.h"

namespace relievo {

const std::vector<StrategyEntry>& lodStrategies() {
  static const std::vector<StrategyEntry> all = {
      uniformStrategy(),    cdlodStrategy(),      edgeLodStrategy(),      edgeMorphStrategy(), edgeScreenStrategy(),
      edgeLengthStrategy(), bintreeStrategy(),    tessellationStrategy(), clipmapStrategy(),   discreteStrategy(),
      clustersStrategy(),   noSnappingStrategy(), skirtsStrategy()};
  return all;
}

const StrategyEntry* findStrategy(const std::string& name) {
  for (const StrategyEntry& e : lodStrategies())
    if (e.name == name) return &e;
  return nullptr;
}

}  // namespace relievo
