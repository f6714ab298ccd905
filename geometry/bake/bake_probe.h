// bake_probe.h - how far a baked surface lies from its scan, measured along lines between the samples.
// Shape: probesAPatch() probes a patch, patch after patch. Unit: mm.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/baked_heights.h"

namespace relievo {

struct Probe {
  double along = 0, cosine = -1;  // of the line's hit; below 0: none
};
size_t probesAPatch(const BakeGround& ground);
// Of (u, v) of its patch: the plastic number's sequence (Roberts 2018), another run of it for each patch.
glm::dvec2 probePlace(size_t k);

// In the scan's tangents' direction: the 99.9th percentile; 0 where no line meets the scan.
double deviationAtProbes(const BakeGround& ground, const BakedHeights& baked, const std::vector<Probe>& probes);

}  // namespace relievo
