// surface_rows.h - an artwork's surface as grids of vertices, read row by row, so that memory is bounded by rows of
// pages. All patches have 2^level cells a side. Over a base mesh a sheet is a patch; a flat artwork is one sheet, its
// whole strip of patches. Level L takes the samples of relief pages of level L - 7, or every 2^(7 - L)-th one of the
// root pages.
//
// Coordinates: over a base mesh mm from its origin_mm; of a flat artwork mm (or px, where no size is known) from its
// centre on the plane of height 0, x right, y up, z towards the viewer.
//
// Vertices that patches share have the same bits from all of them, which formats without indices need: u and v are
// multiples of 2^-level, 1 - u and 1 - v are exact, and x * 1 + y * 0 is x, so that on a side both patches add the same
// two products. The project is compiled without contraction to fma.
//
// Errors: what the package's pages have, with the place in the file (kInvalidData, kIo).
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/texture_pages.h"
#include "texturing/stream/relief_normals.h"

namespace relievo {

class ExportGrid {
 public:
  // level: 0 .. finestLevel().
  ExportGrid(std::shared_ptr<const Package> package, int level);
  // Of the same package.
  ExportGrid(const ExportGrid& other, int level);
  // Of an artwork without relief, the level at which a cell is a texel: vertices carry the colours.
  static int finestLevel(const Manifest& manifest);

  const Package& package() const { return *package_; }
  const TexturePages& texturePages() const { return *texture_pages_; }
  const Manifest& manifest() const { return package_->manifest(); }
  int level() const { return level_; }
  bool isFlat() const { return manifest().domain.isFlat(); }
  bool hasRelief() const { return manifest().domain.relief_depth >= 0; }
  uint64_t cellsPerPatchSide() const { return uint64_t{1} << level_; }
  uint32_t sheets() const { return isFlat() ? 1 : manifest().domain.patchCount(); }
  // Vertices of a sheet.
  uint64_t columns() const { return columns_; }
  uint64_t rows() const { return rows_; }
  // A vertex's place without relief, and the vector along which a height of 1 moves it.
  struct Ray {
    glm::dvec3 base, along;
    glm::dvec3 at(double height) const { return base + height * along; }
  };
  Ray ray(uint32_t sheet, uint64_t x, uint64_t y) const;
  double heightOf(uint16_t sample) const {
    return manifest().domain.relief_offset_mm + sample * manifest().domain.relief_scale_mm;
  }
  // Adds to a vertex's coordinates: 0 for flat artworks.
  glm::dvec3 originMm() const { return isFlat() ? glm::dvec3(0) : manifest().base->origin_mm; }
  // Half the longest side of a box around the corners (flat: around the artwork): what coordinates from the origin are
  // about as large as.
  double extent() const;
  // How far (a distance in space at the same (u, v)) this grid lies from the finest: an upper bound. Nothing: the
  // package has none for grids of flat artworks coarser than a root page. Reads the index of a level: kInterrupted soon
  // after *stop is set (it may be null).
  Result<std::optional<double>> errorBound(const std::atomic<bool>* stop = nullptr) const;

 private:
  void setLevel(int level);
  std::shared_ptr<const Package> package_;
  std::shared_ptr<const TexturePages> texture_pages_;
  int level_ = 0;
  uint64_t columns_ = 0, rows_ = 0;
};

struct SheetRow {
  std::vector<uint16_t> heights;  // empty without relief
  std::vector<glm::dvec3> positions;
  std::vector<glm::u8vec3> colours;  // sRGB: the albedo; of a basis of light, the pixel under light from the front
};
struct RowParts {
  bool heights = true, positions = true, colours = true;
  // Of a flat artwork: colours under this light (a unit vector), as `relievo render` shows them; else as they are.
  std::optional<std::array<double, 3>> light;
  // Rows of each page that are kept at once. With fewer than a page has, pages are decoded again for the next ones:
  // less memory, more time.
  int rows = kPageFullPx;
};

// Reads the rows of one sheet after the other; one per thread. Rows in growing order read each page once, unless
// RowParts::rows says otherwise.
class SheetReader {
 public:
  SheetReader(const ExportGrid& grid, RowParts parts);
  void begin(uint32_t sheet);
  Result<void> read(uint64_t y, SheetRow& row);
  // Row y of the texels of this level, as they are: of a flat artwork's sheet, at levels that the texture has. They are
  // the cells, one fewer than columns().
  Result<void> readTexels(uint64_t y, SheetRow& row);
  // The memory that its pages and a row take.
  static uint64_t bytes(const ExportGrid& grid, const RowParts& parts);
  // With as many rows at once as this much memory allows; with one where none fit.
  static RowParts within(const ExportGrid& grid, RowParts parts, uint64_t memory_bytes);

 private:
  // Which rows of which pages are in memory.
  struct Window {
    uint64_t band = ~uint64_t{0};
    size_t first = 0, rows = 0;
    bool holds(uint64_t b, size_t row, size_t count) const {
      return b == band && row >= first && row + count <= first + rows;
    }
  };
  Result<void> loadHeights(uint64_t band, size_t row);
  // Rows of slots, border included.
  Result<void> loadColours(uint64_t band, size_t row, size_t count);
  Result<void> readColourPage(const NodeId& node, std::span<uint8_t> texels);
  Result<void> readReliefPage(const NodeId& node, std::span<uint16_t> samples);
  Result<void> readLitPage(const NodeId& node, std::span<uint8_t> texels);
  Result<void> readHeights(uint64_t y, SheetRow& row);
  Result<void> readColours(uint64_t y, SheetRow& row);
  NodeId node(int level, uint64_t x, uint64_t y) const;

  const ExportGrid& grid_;
  const RowParts parts_;
  const uint32_t relief_level_, texture_level_;
  const uint64_t relief_pages_, relief_bands_, texture_pages_, texture_bands_;
  const double texels_per_cell_;
  uint32_t sheet_ = 0;
  const size_t relief_rows_, texture_rows_;  // of a window
  Window relief_window_, texture_window_;
  PageDecoder decoder_;
  std::vector<uint16_t> samples_;  // the window's rows of the band's pages, one page after the other
  std::vector<uint8_t> texels_;    // as slot texels of colour
  std::vector<uint8_t> planes_, page_texels_;
  std::vector<uint16_t> page_samples_;
  std::optional<ReliefNormals> normals_;
};

}  // namespace relievo
