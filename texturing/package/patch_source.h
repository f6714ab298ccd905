// patch_source.h - texels and heights of an artwork made of patches over a base mesh, patch by patch; what a mesh was
// baked into (geometry/bake/mesh_bake.h), or a procedural one. Each patch (src/artwork/patch_domain.h) is
// up to 2^textureDepth x 128 texels and 2^reliefDepth x 128 relief cells a side.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/basis.h"
#include "src/artwork/deviation.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/shown_images.h"
#include "src/base/result.h"
#include "texturing/package/raster_source.h"

namespace relievo {

// An image that patches show: sRGB, rows from the top, three bytes a texel.
struct SourceImage {
  int width = 0, height = 0;
  bool repeats = false;  // beyond its borders; else these go on
  std::span<const uint8_t> rgb;
  bool fill = false;              // what no patch shows of it may become what lies around it (image_fill.h)
  std::span<const uint8_t> jpeg;  // the same texels as plainJpeg() gives them; none: they came from no such file
  // No colours, but normals in tangent space: byte b for b / 127.5 - 1, x to the right, y upwards or downwards, z
  // outwards. They belong to the image before them, which patches name; it repeats alike.
  bool is_normals = false, normals_downwards = false;
};
// Of the image that patches name and its normals, along x and along y, whichever has more texels: places in it
// (PatchImage::at) count these. Images: whatever has width, height and is_normals.
template <class Images>
glm::ivec2 placeSize(const Images& images, size_t number) {
  glm::ivec2 size(images[number].width, images[number].height);
  if (number + 1 < images.size() && images[number + 1].is_normals)
    size = glm::max(size, glm::ivec2(images[number + 1].width, images[number + 1].height));
  return size;
}
// Where a patch that is cut lies in images, affinely, or which colours its corners have: on each half, to the right of
// the diagonal and to its left.
struct PatchImage {
  int8_t depth = kNoTexturePage;  // its finest texture level; kNoTexturePage: none, at most its tail shows the images
  bool in_tail = false;           // without levels it shows them nevertheless
  bool shows() const { return in_tail || depth != kNoTexturePage; }
  std::array<uint16_t, 2> image{};  // or kCornerColours
  // Of a half's corners (0,0), (1,0) or (0,1), and (1,1): 256ths of a texel (placeSize()) from the image's upper left
  // corner; and the normals there, which are linear between them, byte b for b / 127.5 - 1.
  std::array<std::array<glm::ivec2, 3>, 2> at{};
  std::array<std::array<glm::u8vec3, 3>, 2> normal{};
  // With kCornerColours, in place of these places: sRGB.
  std::array<std::array<glm::u8vec3, 3>, 2> colour{};
  bool hasColours(size_t half) const { return image[half] == kCornerColours; }
  bool hasColours() const { return hasColours(0) || hasColours(1); }
};

class PatchSource {
 public:
  virtual ~PatchSource() = default;
  virtual const BaseMesh& base() const = 0;
  // Of the lattice that its corners' positions lie on (onLattice()); 0: of none.
  virtual double baseStepMm() const { return 0; }
  virtual int textureDepth() const = 0;  // the largest of all patches
  // What finer levels of the patch show is what a bilinear filter makes of this one. kNoTexturePage: its tail's texels
  // are all that there is.
  virtual int textureDepthOf(uint32_t /*patch*/) const { return textureDepth(); }
  // Of patches that show images textureDepthOf() is kNoTexturePage, and texels() are not asked for.
  // textureDepth() is the largest of all patches, those of PatchImage included.
  virtual std::vector<SourceImage> images() const { return {}; }
  // Some patch shows an image, or colours of corners.
  virtual bool showsImages() const { return !images().empty(); }
  virtual PatchImage imageOf(uint32_t /*patch*/) const { return {}; }
  virtual int reliefDepth() const = 0;
  virtual TextureFormat format() const = 0;
  virtual double reliefOffsetMm() const = 0;  // height in mm = offset + q * scale, one range for the artwork
  virtual double reliefScaleMm() const = 0;
  virtual double errorUnitMm() const = 0;  // of the errors kept in the package: no error exceeds 65,535 of it
  // All patches have the same heights, which are the same everywhere, and no grid of theirs has an error.
  virtual bool patchesAreEven() const { return false; }
  // Errors up to this matter to nobody: of these a compact package does not keep where and which way they lie.
  virtual double slightErrorMm() const { return 0; }
  virtual std::vector<Provenance> provenance() const = 0;

  // The following are const and thread-safe.
  // Channel-major, rows of v from 0: out[(c * P + y) * P + x], P = texelsASide(textureDepthOf(patch)), texel centres at
  // (x + 1/2, y + 1/2) / P.
  virtual Result<void> texels(uint32_t patch, std::span<uint8_t> out) const = 0;
  // Rows of v from 0: out[y * (R + 1) + x], R = 128 << reliefDepth(), samples at (x, y) / R. Samples on a side that two
  // patches share are the same from both; those at a shared corner are the same from all.
  virtual Result<void> heights(uint32_t patch, std::span<uint16_t> out) const = 0;
  // How far in mm (a distance in space) the triangles through every 2^(reliefDepth - level)-th vertex of S lie from
  // those of the finest, at the same (u, v): an upper bound by blocks of 8 x 8 cells of that level, out[y * B + x], B =
  // 16 << level. 0 at level reliefDepth; a block's error is not below those of the blocks of finer levels inside it.
  virtual Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const = 0;
  // The same for whole patches of fewer cells than a page has: element k is that of 2^k cells a side, never below those
  // behind it.
  virtual Result<CoarseErrors> coarseErrors(uint32_t patch) const = 0;
  // Of one of the grids of 2^cells_log2 cells, 4 .. 6, by blocks of 8 x 8 cells: out[y * B + x], B = 2^(cells_log2 -
  // 3). False: not known, the whole patch's holds for all of them.
  virtual Result<bool> coarseBlocks(uint32_t /*patch*/, int /*cells_log2*/, std::span<float> /*out_mm*/) const {
    return false;
  }
  // Which way those errors lie: of the grid of 2^cells_log2 cells, 0 .. 7 + reliefDepth(), block by block as errors()
  // and coarseBlocks() have them, or one of the whole patch below 16 cells; shares of what these say. False: not known.
  virtual bool errorShapes(uint32_t /*patch*/, int /*cells_log2*/, std::span<DeviationShape> /*out*/) const {
    return false;
  }
};

}  // namespace relievo
