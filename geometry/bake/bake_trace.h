// bake_trace.h - what lines through the samples of a grid meet of the scan.
// Unit: mm along the lines. The same for any number of workers.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/bake_probe.h"
#include "src/base/result.h"

namespace relievo {

// What lines through the samples of a grid meet, as SampleLayout has them.
struct Traced {
  int cells_log2 = 0;
  std::vector<float> heights;
  // 0: the line meets nothing. Else what a height's error counts in space: 1 + 254 x the cosine between line and
  // surface, since its square is what is left of a height's, and its inverse the surface that a cell holds.
  std::vector<uint8_t> weights;
};

// probes: traced beside the samples where they are empty, so that what lies together is looked up together. progress: 0
// to 1. Error: kInterrupted.
Result<Traced> traceSamples(const BakeGround& ground, int cells_log2, std::vector<Probe>& probes,
                            const std::function<void(double)>& progress);

}  // namespace relievo
