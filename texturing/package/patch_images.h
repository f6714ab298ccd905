// patch_images.h - images that patches show (texturing/PACKAGE.md, "Images that patches show"). Where a scan repeats an
// image, pages of its patches would hold the image over and over. Such a package has the image once, and says of each
// patch where its corners lie in it; pages, and from version 16 on tails, are made when they are read. Integer
// arithmetic: the same texels on every machine.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/shown_images.h"
#include "src/artwork/tangent_frames.h"
#include "src/base/result.h"
#include "texturing/codec/mip.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// Places of a half's corners (PatchImage::at), which count texels of place_size, in those of an image of that size.
std::array<glm::ivec2, 3> placesIn(const glm::ivec2& size, const glm::ivec2& place_size,
                                   const std::array<glm::ivec2, 3>& at);

// An image, or a map of normals, and its coarser levels, which are made by the rules of mip.h. Immutable.
class ShownImage {
 public:
  explicit ShownImage(const SourceImage& image) : ShownImage(image, {image.width, image.height}) {}
  ShownImage(const SourceImage& image, const glm::ivec2& place_size);
  // rgb: in place of the image's own texels, as withRoom() gives them, so that they are not copied.
  ShownImage(const SourceImage& image, const glm::ivec2& place_size, std::vector<uint8_t> rgb);
  static std::vector<uint8_t> withRoom(std::span<const uint8_t> rgb);
  std::span<const uint8_t> texels() const;  // of the finest level, as SourceImage::rgb
  // A half's places, in 256ths of its own texels.
  std::array<glm::ivec2, 3> placesOf(const PatchImage& patch, size_t half) const;
  // Along x and y: whether the image is repeated beyond its border, else this goes on; and what places count from.
  struct Repetition {
    std::array<bool, 2> repeats{};
    std::array<int64_t, 2> from{};
  };
  // For a half with these places (placesOf()) at its corners. Where they lie within one repetition, but for half a
  // texel, the half shows that one alone: nothing of the opposite border.
  Repetition repetitionOf(const std::array<glm::ivec2, 3>& places) const;
  // Bilinear, at a place in 256ths of a texel of the finest level, from the image's upper left corner on. level: 0 is
  // the finest, beyond the coarsest that one is taken.
  std::array<uint8_t, 3> sample(int64_t x, int64_t y, int level, const Repetition& repetition) const;
  // Texels along a line: the k-th lies at from + ((begin + k step) >> shift). out: a channel's each, `count` of them.
  struct Line {
    std::array<int64_t, 2> from{}, begin{}, step{};
    int shift = 0;
    size_t count = 0;
  };
  void sampleLine(const Line& line, int level, const Repetition& repetition, const std::array<uint8_t*, 3>& out) const;

 private:
  struct Level {
    int64_t width, height;
    std::vector<uint8_t> rgb;  // and a byte, so that four may be read at any texel
  };
  int64_t width_, height_;
  glm::ivec2 place_size_;
  bool repeats_;
  std::vector<Level> levels_;
};

// The level of an image that a patch of 2^side_log2 texels a side shows on a half with these places: one of its texels
// is at most 1.5 of that level long, in either direction.
int shownLevel(const std::array<glm::ivec2, 3>& places, int side_log2);
// The map of normals of a patch's half, and its tangent frame; or none.
struct ShownNormals {
  const ShownImage* map = nullptr;
  TangentFrame frame;
};
using NormalsOfHalves = std::array<ShownNormals, 2>;
// Of each image: has it a map of normals, which is the one behind it? Images: SourceImage or StoredImage.
enum class HasNormals : uint8_t { kNo, kUpwards, kDownwards };
template <class Images>
std::vector<HasNormals> normalsOfImages(const Images& images) {
  std::vector<HasNormals> out(images.size());
  for (size_t i = 1; i < images.size(); ++i)
    if (images[i].is_normals) out[i - 1] = images[i].normals_downwards ? HasNormals::kDownwards : HasNormals::kUpwards;
  return out;
}
// Two a patch; empty: no image has normals.
std::vector<TangentFrame> framesOfHalves(const std::vector<HasNormals>& of_images, std::span<const PatchImage> patches,
                                         const BaseMesh& base);
// Texels (x0 + x, y0 + y) of such a patch, which may lie beyond it: there the halves go on. out: R, G, B, or the
// normals' x, y, z, count x count each, rows of v.
struct ShownTexels {
  int side_log2 = 0;
  int64_t x0 = 0, y0 = 0;
  size_t count = 0;
};
// images: of halves with colours of corners none is needed.
void showImages(const PatchImage& patch, const std::array<const ShownImage*, 2>& images, const ShownTexels& which,
                std::span<uint8_t> out);
void showNormals(const PatchImage& patch, const ShownTexels& which, std::span<uint8_t> out,
                 const NormalsOfHalves& maps = {});
// The texels of its tail (PatchTails::texelsOf(), of albedo and normal).
void tailOfImages(const PatchImage& patch, const std::array<const ShownImage*, 2>& images, const MipFilter& mip,
                  std::span<uint8_t> out, const NormalsOfHalves& maps = {});

// Images are stored as tiles of kPagePx texels a side, rows of them from the top: texture pages of one plane whose
// borders repeat their own texels, as the tile's beyond the image do. Or, in version 15, as the JPEG that they came as,
// which then is the one tile.
struct ImageTile {
  uint32_t size = 0;
  uint64_t hash = 0;  // xxh3-64
};
struct StoredImage {
  uint32_t width = 0, height = 0;
  bool repeats = false;
  bool is_jpeg = false;  // (texturing/codec/image_jpeg.h)
  bool fill = false;     // of a JPEG: once it is read, ShownMarks::fillRest()
  std::vector<ImageTile> tiles;
  bool is_normals = false, normals_downwards = false;  // as SourceImage has them
  uint32_t columns() const { return (width + kPagePx - 1) / kPagePx; }
  uint32_t rows() const { return (height + kPagePx - 1) / kPagePx; }
  uint64_t tileCount() const { return is_jpeg ? 1 : uint64_t{columns()} * rows(); }
  uint64_t mostTileBytes() const;
};
void cutTile(const SourceImage& image, uint32_t column, uint32_t row, std::span<uint8_t> channels /* of a page */);
// Into the image's texels, R G B.
void pasteTile(const StoredImage& image, uint32_t column, uint32_t row, std::span<const uint8_t> channels,
               std::span<uint8_t> rgb);

struct PatchImages {
  std::vector<StoredImage> images;
  std::vector<PatchImage> of_patch;
  bool anyColours() const;  // of corners
};
// What no patch shows of the image becomes what lies around it. number: by which patches name it, or the one that it is
// the map of normals of; place_size: of that.
void fillImage(const SourceImage& image, size_t number, const glm::ivec2& place_size,
               std::span<const PatchImage> patches, std::span<uint8_t> rgb);
// by_base: as KindsOfImages; with colours of corners it is set.
std::vector<uint8_t> encodePatchImages(std::span<const StoredImage> images, std::span<const PatchImage> of_patch,
                                       const BaseMesh& base, bool by_base);
// What there may be: JPEGs from version 15 on, patches whose tails alone show images from version 16 on. From version
// 17 on normals are predicted by those of the base mesh, or by its halves' planes. From version 18 on halves may have
// colours of corners, and in version 19 images maps of normals, and more than kMostTexelsBefore19.
struct KindsOfImages {
  bool jpegs = false, in_tails = false, by_base = false, colours = false, richer = false;
};
// Safe for untrusted bytes. tile_bytes: what all tiles take. The error names what is wrong; its file is empty.
Result<PatchImages> decodePatchImages(std::span<const uint8_t> bytes, const BaseMesh& base, uint64_t tile_bytes,
                                      KindsOfImages kinds);

}  // namespace relievo
