// baked_patches.h - a bake in its scan's units as a package of patches has it, in mm.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/repeated_images.h"
#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// The bake outlives it, and so do its images' texels, and their JPEGs.
class BakedPatches final : public PatchSource {
 public:
  // step: of the lattice of the base's corners, in the scan's units. jpegs, normal_jpegs: of the images and of their
  // maps of normals (SourceImage::jpeg), or none.
  BakedPatches(const MeshBake& bake, double step, double mm_per_unit, double slight_mm, std::vector<Provenance> sources,
               const TextureFormat& format, std::span<const MeshBake::Image> images = {},
               std::span<const std::vector<uint8_t>> jpegs = {},
               std::span<const std::vector<uint8_t>> normal_jpegs = {})
      : bake_(bake),
        mm_(mm_per_unit),
        step_mm_(step * mm_per_unit),
        slight_mm_(slight_mm),
        even_(bake.isEven()),
        base_(bake.base()),
        sources_(std::move(sources)),
        format_(format) {
    const std::vector<bool> shown = bake.shownImages();
    const std::vector<double> times = timesShown(bake.mesh(), shown.size());
    for (size_t i = 0; i < shown.size(); ++i) {
      number_of_image_.push_back(static_cast<uint16_t>(images_.size()));
      if (!shown[i]) continue;
      const MeshBake::Image& image = images[i];
      auto jpegOf = [&](std::span<const std::vector<uint8_t>> files) {
        return i < files.size() ? std::span<const uint8_t>(files[i]) : std::span<const uint8_t>();
      };
      images_.push_back({.width = image.width,
                         .height = image.height,
                         .repeats = image.repeats,
                         .rgb = image.texels,
                         .fill = !image.palette && times[i] < kTimesOver,
                         .jpeg = jpegOf(jpegs)});
      if (image.normals.empty()) continue;
      SourceImage normals = images_.back();
      normals.is_normals = true;
      normals.normals_downwards = image.normals_downwards;
      normals.width = image.normals_width, normals.height = image.normals_height;
      normals.rgb = image.normals;
      normals.jpeg = jpegOf(normal_jpegs);
      images_.push_back(normals);
    }
    base_.origin_mm *= mm_;
    for (BaseCorner& c : base_.corners)
      for (int axis = 0; axis < 3; ++axis) c.position_mm[axis] = onStep(c.position_mm[axis], step, step_mm_);
  }
  const BaseMesh& base() const override { return base_; }
  double baseStepMm() const override { return step_mm_; }
  int textureDepth() const override { return bake_.textureDepth(); }
  int textureDepthOf(uint32_t patch) const override { return bake_.textureDepthOf(patch); }
  std::vector<SourceImage> images() const override { return images_; }
  bool showsImages() const override { return bake_.showsImages(); }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out;
    const auto on = bake_.imagesOn(patch);
    if (!on) return out;
    out.depth = static_cast<int8_t>(on->depth);
    out.in_tail = on->depth == kNoTexturePage;
    for (size_t half = 0; half < 2; ++half) {
      for (size_t k = 0; k < 3; ++k)
        out.normal[half][k] = glm::u8vec3(glm::round(127.5f * (on->normal[half][k] + 1.0f)));
      if (on->image[half] == kNoImage) {
        out.image[half] = kCornerColours;
        for (size_t k = 0; k < 3; ++k)
          out.colour[half][k] = glm::u8vec3(glm::round(glm::clamp(on->colour[half][k], 0.0f, 255.0f)));
        continue;
      }
      out.image[half] = number_of_image_[on->image[half]];
      const glm::ivec2 size = placeSize(images_, out.image[half]);
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec2 uv = on->uv[half][k];
        const glm::dvec2 from_above(uv.x * size.x, (1 - uv.y) * size.y);
        out.at[half][k] = glm::ivec2(glm::round(256.0 * from_above));
      }
    }
    return out;
  }
  int reliefDepth() const override { return bake_.reliefDepth(); }
  TextureFormat format() const override { return format_; }
  double reliefOffsetMm() const override { return bake_.reliefOffsetMm() * mm_; }
  double reliefScaleMm() const override { return bake_.reliefScaleMm() * mm_; }
  double errorUnitMm() const override { return bake_.errorUnitMm() * mm_ * (mm_ == 1 ? 1 : 1 + 1e-6); }
  bool patchesAreEven() const override { return even_; }
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
    const std::vector<DeviationShape> shapes = bake_.errorsOfGrid(patch, cells_log2).shapes;
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
  bool even_;
  BaseMesh base_;
  std::vector<Provenance> sources_;
  TextureFormat format_;
  std::vector<SourceImage> images_;        // that patches show
  std::vector<uint16_t> number_of_image_;  // by number in the bake
};

}  // namespace relievo
