#include "geometry/bake/sample_layout.h"

namespace relievo {

SampleLayout::SampleLayout(const BaseMesh& base) : corners(base.corners.size()), patches(base.patches.size()) {
  for (const auto& p : base.patches)
    for (const auto& [a, b] : kSideCorners) sides.push_back({std::min(p[a], p[b]), std::max(p[a], p[b])});
  const auto all = sides;
  std::sort(sides.begin(), sides.end());
  sides.erase(std::unique(sides.begin(), sides.end()), sides.end());
  patch_sides.resize(patches);
  side_patch.resize(sides.size());
  for (size_t i = all.size(); i-- > 0;) {
    patch_sides[i / 4][i % 4] =
        static_cast<uint32_t>(std::lower_bound(sides.begin(), sides.end(), all[i]) - sides.begin());
    side_patch[patch_sides[i / 4][i % 4]] = static_cast<uint32_t>(i / 4);
  }
}

}  // namespace relievo
