#include "src/engine/artwork.h"

#include <algorithm>
#include <cstddef>
#include <utility>

#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

// What the package's index says of heights and errors.
class PackageOracle final : public ReliefOracle {
 public:
  explicit PackageOracle(std::shared_ptr<const Package> package) : package_(std::move(package)) {
    const PatchDomain& d = package_->manifest().domain;
    whole_.min_mm = static_cast<float>(d.relief_offset_mm);
    whole_.max_mm = static_cast<float>(d.relief_offset_mm + 65535 * d.relief_scale_mm);
    whole_.error_mm = whole_.max_mm - whole_.min_mm;
    if (!d.isFlat()) {  // a distance in space: the base's own shape counts
      const Extent extent = extentOf(*package_->manifest().base, std::min(whole_.min_mm, whole_.max_mm),
                                     std::max(whole_.min_mm, whole_.max_mm), d.mm_per_px);
      whole_.error_mm = static_cast<float>(glm::length(extent.max_mm - extent.min_mm)) * 1.0001f;
    }
  }
  HeightBounds bounds(const NodeId& page) const override {
    auto record = package_->record(PageId(Plane::kRelief, page));
    if (!record) return whole_;
    return {record->relief.min_mm, record->relief.max_mm, record->relief.error_mm};
  }
  bool errorBlocks(const NodeId& page, std::span<float> error_mm) const override {
    return package_->reliefErrors(page, error_mm);
  }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> shapes) const override {
    return package_->reliefShapes(page, shapes);
  }
  bool coarseShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> shapes) const override {
    const auto& known = package_->manifest().coarse_shapes;
    if (patch >= known.size()) return false;
    const int grid = cells_log2 - kFirstBlockedGrid;
    const size_t first =
        grid < 0 ? static_cast<size_t>(cells_log2) : kFirstShapedBlock + kFirstCoarseBlock[static_cast<size_t>(grid)];
    std::copy_n(known[patch].begin() + static_cast<std::ptrdiff_t>(first), shapes.size(), shapes.begin());
    return true;
  }
  bool coarseBlocks(uint32_t patch, int cells_log2, std::span<float> error_mm) const override {
    const Manifest& m = package_->manifest();
    const int grid = cells_log2 - kFirstBlockedGrid;
    if (patch >= m.coarse_blocks.size() || grid < 0 || grid >= kBlockedGrids) return false;
    const float whole = m.coarse_errors[patch][static_cast<size_t>(cells_log2)];
    const uint8_t* shares = m.coarse_blocks[patch].data() + kFirstCoarseBlock[static_cast<size_t>(grid)];
    for (size_t i = 0; i < error_mm.size(); ++i) error_mm[i] = coarseBlockMm(whole, shares[i]);
    return true;
  }
  bool heightSlopes(uint32_t patch, HeightSlopes& slopes) const override {
    const auto& known = package_->manifest().height_slopes;
    if (patch >= known.size()) return false;
    slopes = known[patch];
    return true;
  }

 private:
  std::shared_ptr<const Package> package_;
  HeightBounds whole_;
};

}  // namespace

Artwork artworkFromPackage(std::shared_ptr<const Package> package, const std::atomic<bool>* stop) {
  Artwork artwork;
  artwork.manifest = package->manifest();
  artwork.source = package;
  artwork.oracle = std::make_shared<PackageOracle>(package);
  if (package->hasTails())
    artwork.tails = [package, stop](int workers, std::vector<std::string>* problems) {
      return package->tails(workers, problems, stop);
    };
  return artwork;
}

Extent artworkExtent(const Manifest& manifest, double exaggerate) {
  const PatchDomain& d = manifest.domain;
  double low = d.relief_offset_mm * exaggerate, high = (d.relief_offset_mm + 65535 * d.relief_scale_mm) * exaggerate;
  if (d.relief_depth < 0 || exaggerate == 0) low = high = 0;
  if (low > high) std::swap(low, high);
  Extent extent = d.isFlat() ? extentOf(d.flat(), low, high) : extentOf(*manifest.base, low, high, d.mm_per_px);
  extent.size_known = manifest.size_known;
  return extent;
}

glm::dvec3 artworkMiddle(const Manifest& manifest) { return artworkExtent(manifest, 0).centre(); }

}  // namespace relievo
