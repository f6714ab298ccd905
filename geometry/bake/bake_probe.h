// bake_probe.h - the distance of a baked surface from its scan, measured at probes: fixed points of each patch, between
// the samples.
// Shape: probesPerPatch() probes for the first patch, then for the second, and so on. Units: mm.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/baked_heights.h"

namespace relievo {

struct Probe {
  double height_mm = 0, cosine = -1;  // where the probe's line meets the scan, and the cosine between line and surface
                                      // normal; below 0: it meets nothing
};
size_t probesPerPatch(const BakeContext& context);
// The (u, v) of probe k in its patch. Source: Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"
// (the sequence of the plastic number); each patch takes its own run of the sequence.
glm::dvec2 probePosition(size_t k);

// The 99.9th percentile of the probes' distances, mm, measured along the scan's normals; 0 if no probe's line meets the
// scan.
double deviationAtProbes(const BakeContext& context, const BakedHeights& baked, const std::vector<Probe>& probes);

}  // namespace relievo
