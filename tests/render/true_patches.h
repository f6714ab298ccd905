// true_patches.h - a relief over a base mesh held in full (tests/geometry/true_mesh_relief.h) as the source of a
// package, with its true errors.
#pragma once

#include "tests/geometry/true_mesh_relief.h"
#include "texturing/package/patch_source.h"

namespace relievo::test {

class TruePatches final : public PatchSource {
 public:
  using Height = std::function<double(const glm::dvec3&, const Place&)>;
  TruePatches(const BaseMesh& mesh, const MeshRelief& relief, const Height& height)
      : mesh_(mesh), relief_(relief), truth_(mesh_, relief_, height) {}
  const BaseMesh& base() const override { return mesh_; }
  int textureDepth() const override { return 0; }
  int reliefDepth() const override { return relief_.depth; }
  TextureFormat format() const override {
    TextureFormat format;
    format.basis = Basis::kAlbedoNormal;
    return format;
  }
  double reliefOffsetMm() const override { return relief_.offset_mm; }
  double reliefScaleMm() const override { return relief_.scale_mm; }
  double errorUnitMm() const override {
    double most = 0;
    for (const CoarseErrors& errors : truth_.coarse()) most = std::max<double>(most, errors[0]);
    return std::max(most, 1e-6) / 30000;
  }
  std::vector<Provenance> provenance() const override { return {{"a known relief", "", "test"}}; }
  Result<void> texels(uint32_t, std::span<uint8_t> out) const override {
    std::fill(out.begin(), out.end(), uint8_t{128});
    return {};
  }
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const override {
    const int64_t row = truth_.side() + 1;
    for (int64_t y = 0; y < row; ++y)
      for (int64_t x = 0; x < row; ++x) out[static_cast<size_t>(y * row + x)] = truth_.sample(patch, x, y);
    return {};
  }
  Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const override {
    const size_t side = size_t{16} << level;
    std::array<float, 256> blocks;
    for (uint32_t y = 0; y < 1u << level; ++y)
      for (uint32_t x = 0; x < 1u << level; ++x) {
        truth_.errorBlocks({patch, static_cast<uint32_t>(level), x, y}, blocks);
        for (size_t k = 0; k < blocks.size(); ++k) out_mm[(16 * y + k / 16) * side + 16 * x + k % 16] = blocks[k];
      }
    return {};
  }
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override { return truth_.coarse()[patch]; }
  Result<bool> coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out_mm) const override {
    return truth_.coarseBlocks(patch, cells_log2, out_mm);
  }

 private:
  BaseMesh mesh_;
  MeshRelief relief_;
  TrueMeshRelief truth_;
};

}  // namespace relievo::test
