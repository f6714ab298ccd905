#include "geometry/bake/bake_probe.h"

#include <algorithm>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr size_t kProbes = 20'000;  // enough for the 99.9th percentile: 20 probes lie above it

}  // namespace

size_t probesPerPatch(const BakeContext& context) { return std::max<size_t>(kProbes / context.layout.patches, 4); }

glm::dvec2 probePosition(size_t k) {
  return {std::fmod(0.5 + static_cast<double>(k) * 0.75487766624669276, 1.0),
          std::fmod(0.5 + static_cast<double>(k) * 0.56984029099805327, 1.0)};
}

double deviationAtProbes(const BakeContext& context, const BakedHeights& baked, const std::vector<Probe>& probes) {
  const size_t count = probesPerPatch(context), n = size_t{1} << baked.cells_log2;
  std::vector<float> deviations(probes.size(), -1.0f);
  parallelFor(context.layout.patches, context.workers, nullptr, [&](size_t patch) {
    std::vector<uint16_t> grid((n + 1) * (n + 1));
    baked.gather(context, static_cast<uint32_t>(patch), grid);
    for (size_t k = patch * count; k < (patch + 1) * count; ++k) {
      if (probes[k].cosine < 0) continue;
      const glm::dvec2 at = probePosition(k);
      const double height = baked.offset_mm + baked.scale_mm * interpolateOnGrid(grid, n, at.x, at.y);
      deviations[k] = static_cast<float>(std::abs((probes[k].height_mm - height) * probes[k].cosine));
    }
  });
  std::erase_if(deviations, [](float d) { return !(d >= 0); });
  if (deviations.empty()) return 0;
  const auto rank = deviations.begin() + static_cast<ptrdiff_t>(static_cast<double>(deviations.size() - 1) * 0.999);
  std::nth_element(deviations.begin(), rank, deviations.end());
  return *rank;
}

}  // namespace relievo
