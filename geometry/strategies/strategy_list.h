// strategy_list.h - what each strategy's file offers to the registry.
#pragma once

#include "geometry/strategies/lod_strategy.h"

namespace relievo {

StrategyEntry uniformStrategy();
StrategyEntry cdlodStrategy();
StrategyEntry edgeLodStrategy();
StrategyEntry edgeMorphStrategy();
StrategyEntry edgeScreenStrategy();
StrategyEntry edgeLengthStrategy();
StrategyEntry bintreeStrategy();
StrategyEntry tessellationStrategy();
StrategyEntry clipmapStrategy();
StrategyEntry discreteStrategy();
StrategyEntry clustersStrategy();
StrategyEntry noSnappingStrategy();
StrategyEntry skirtsStrategy();

}  // namespace relievo
