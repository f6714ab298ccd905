// baked_patches.h - a bake in its scan's units as a package of patches has it, in mm.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// The bake outlives it.
class BakedPatches final : public PatchSource {
 public:
  // step: of the lattice of the base's corners, in the scan's units.
  BakedPatches(const MeshBake& bake, double step, double mm_per_unit, double slight_mm, std::vector<Provenance> sources,
               const TextureFormat& format)
      : bake_(bake),
        mm_(mm_per_unit),
        step_mm_(step * mm_per_unit),
        slight_mm_(slight_mm),
        base_(bake.base()),
        sources_(std::move(sources)),
        format_(format) {
    base_.origin_mm *= mm_;
    for (BaseCorner& c : base_.corners)
      for (int axis = 0; axis < 3; ++axis) c.position_mm[axis] = onStep(c.position_mm[axis], step, step_mm_);
  }
  const BaseMesh& base() const override { return base_; }
  double baseStepMm() const override { return step_mm_; }
  int textureDepth() const override { return bake_.textureDepth(); }
  int textureDepthOf(uint32_t patch) const override { return bake_.textureDepthOf(patch); }
  int reliefDepth() const override { return bake_.reliefDepth(); }
  TextureFormat format() const override { return format_; }
  double reliefOffsetMm() const override { return bake_.reliefOffsetMm() * mm_; }
  double reliefScaleMm() const override { return bake_.reliefScaleMm() * mm_; }
  double errorUnitMm() const override { return bake_.errorUnitMm() * mm_ * (mm_ == 1 ? 1 : 1 + 1e-6); }
  double slightErrorMm() const override { return slight_mm_; }
  std::vector<Provenance> provenance() const override { return sources_; }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override { return bake_.texels(patch, out); }
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const override { return bake_.heights(patch, out); }
  Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const override {
    scaled(bake_.errorsOfGrid(patch, std::countr_zero(unsigned{kPagePx}) + level).mm, out_mm);
    return {};
  }
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override {
    CoarseErrors out;
    for (size_t k = 0; k < out.size(); ++k) out[k] = scaled(bake_.errorOfGrid(patch, static_cast<int>(k)));
    return out;
  }
  Result<bool> coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out_mm) const override {
    scaled(bake_.errorsOfGrid(patch, cells_log2).mm, out_mm);
    return true;
  }
  bool errorShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> out) const override {
    const std::vector<DeviationShape>& shapes = bake_.errorsOfGrid(patch, cells_log2).shapes;
    std::copy(shapes.begin(), shapes.end(), out.begin());
    return true;
  }

 private:
  // Upper bounds stay so, whatever is rounded on the way, the corners' places included.
  float scaled(float error) const {
    if (mm_ == 1 || error == 0) return error;
    return static_cast<float>(double{error} * mm_ * (1 + 3e-7));
  }
  void scaled(const std::vector<float>& from, std::span<float> out_mm) const {
    for (size_t i = 0; i < from.size(); ++i) out_mm[i] = scaled(from[i]);
  }

  const MeshBake& bake_;
  double mm_, step_mm_, slight_mm_;
  BaseMesh base_;
  std::vector<Provenance> sources_;
  TextureFormat format_;
};

}  // namespace relievo
