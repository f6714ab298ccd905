#include "tools/export/surface_rows.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "texturing/codec/resolve.h"

namespace relievo {
namespace {

constexpr std::array<double, 3> kLightFromTheFront{0, 0, 1};

// Cells of a sheet along a side of `extent_px` texels.
uint64_t cellsAlong(const FlatDomain& d, uint64_t extent_px, int level) {
  return ((extent_px << level) + d.patchPx() - 1) / d.patchPx();
}
uint64_t pagesAlong(const PatchDomain& d, int level, bool x) {
  if (!d.isFlat()) return uint64_t{1} << level;
  const NodeGrid grid = d.flat().nodeGrid(level);
  return x ? grid.columns : grid.rows;
}
}  // namespace

int ExportGrid::finestLevel(const Manifest& m) {
  return kPageCellsLog2 + (m.domain.relief_depth >= 0 ? m.domain.relief_depth : m.domain.texture_depth);
}

ExportGrid::ExportGrid(std::shared_ptr<const Package> package, int level)
    : package_(std::move(package)), texture_pages_(std::make_shared<const TexturePages>(package_)) {
  setLevel(level);
}

ExportGrid::ExportGrid(const ExportGrid& other, int level)
    : package_(other.package_), texture_pages_(other.texture_pages_) {
  setLevel(level);
}

void ExportGrid::setLevel(int level) {
  level_ = level;
  columns_ = rows_ = cellsPerPatchSide() + 1;
  if (isFlat()) {
    const FlatDomain d = manifest().domain.flat();
    columns_ = cellsAlong(d, d.width_px, level) + 1;
    rows_ = cellsAlong(d, d.height_px, level) + 1;
  }
}

ExportGrid::Ray ExportGrid::ray(uint32_t sheet, uint64_t x, uint64_t y) const {
  const double per_cell = std::ldexp(1.0, -level_);
  if (isFlat()) {
    const FlatDomain d = manifest().domain.flat();
    const auto side = static_cast<double>(d.patchPx()), width = static_cast<double>(d.width_px),
               height = static_cast<double>(d.height_px);
    const double x_px = std::min(static_cast<double>(x) * per_cell * side, width),
                 y_px = std::min(static_cast<double>(y) * per_cell * side, height);
    return {{(x_px - width / 2) * d.mm_per_px, (height / 2 - y_px) * d.mm_per_px, 0}, {0, 0, 1}};
  }
  const double u = static_cast<double>(x) * per_cell, v = static_cast<double>(y) * per_cell;
  return {manifest().base->point(sheet, u, v), manifest().base->normal(sheet, u, v)};
}

double ExportGrid::extent() const {
  if (isFlat()) {
    const FlatDomain d = manifest().domain.flat();
    return static_cast<double>(std::max(d.width_px, d.height_px)) * d.mm_per_px / 2;
  }
  glm::dvec3 low(1e300), high(-1e300);
  for (const BaseCorner& c : manifest().base->corners)
    low = glm::min(low, glm::dvec3(c.position_mm)), high = glm::max(high, glm::dvec3(c.position_mm));
  const glm::dvec3 size = high - low;
  return std::max({size.x, size.y, size.z}) / 2;
}

Result<std::optional<double>> ExportGrid::errorBound(const std::atomic<bool>* stop) const {
  const Manifest& m = manifest();
  if (!hasRelief() || level_ >= finestLevel(m)) return std::optional<double>(0.0);
  double bound = 0;
  if (level_ < kPageCellsLog2) {
    if (isFlat()) return std::optional<double>();
    for (const CoarseErrors& e : m.coarse_errors) bound = std::max(bound, double{e[static_cast<size_t>(level_)]});
    return std::optional<double>(bound);
  }
  const int page_level = level_ - kPageCellsLog2;
  const uint64_t columns = pagesAlong(m.domain, page_level, true), rows = pagesAlong(m.domain, page_level, false);
  for (uint32_t sheet = 0; sheet < sheets(); ++sheet) {
    for (uint64_t y = 0; y < rows; ++y) {
      for (uint64_t x = 0; x < columns; ++x) {
        if (stop && stop->load(std::memory_order_relaxed))
          return Error{ErrorKind::kInterrupted, package_->path(), "interrupted", "", {}};
        const NodeId node = isFlat() ? m.domain.flat().nodeAt(page_level, x, y)
                                     : NodeId{sheet, static_cast<uint32_t>(page_level), static_cast<uint32_t>(x),
                                              static_cast<uint32_t>(y)};
        auto record = package_->record({Plane::kRelief, node});
        if (!record) return record.error();
        bound = std::max(bound, double{record->relief.error_mm});
      }
    }
  }
  return std::optional<double>(bound);
}

SheetReader::SheetReader(const ExportGrid& grid, RowParts parts)
    : grid_(grid),
      parts_(parts),
      relief_level_(static_cast<uint32_t>(std::max(grid.level() - kPageCellsLog2, 0))),
      texture_level_(
          static_cast<uint32_t>(std::clamp(grid.level() - kPageCellsLog2, 0, grid.manifest().domain.texture_depth))),
      relief_pages_(pagesAlong(grid.manifest().domain, static_cast<int>(relief_level_), true)),
      relief_bands_(pagesAlong(grid.manifest().domain, static_cast<int>(relief_level_), false)),
      texture_pages_(pagesAlong(grid.manifest().domain, static_cast<int>(texture_level_), true)),
      texture_bands_(pagesAlong(grid.manifest().domain, static_cast<int>(texture_level_), false)),
      texels_per_cell_(std::ldexp(1.0, kPageCellsLog2 + static_cast<int>(texture_level_) - grid.level())),
      relief_rows_(static_cast<size_t>(std::clamp(parts.rows, 1, kReliefSamples))),
      texture_rows_(static_cast<size_t>(std::clamp(parts.rows + 1, 2, int{kPageFullPx}))) {
  const Manifest& m = grid.manifest();
  if (parts.light && m.texture.basis == Basis::kColour && grid.hasRelief())
    normals_.emplace(ReliefSurface{m.domain.flat()});
}

uint64_t SheetReader::bytes(const ExportGrid& grid, const RowParts& parts) {
  const SheetReader reader(grid, parts);
  constexpr uint64_t kSampleBytes = sizeof(uint16_t), kTexelBytes = 4;
  // Two rows of vertices, and pages while they are decoded.
  uint64_t bytes = 2 * grid.columns() * (sizeof(uint16_t) + sizeof(glm::dvec3) + sizeof(glm::u8vec3));
  if (parts.heights && grid.hasRelief())
    bytes +=
        reader.relief_pages_ * reader.relief_rows_ * kReliefSamples * kSampleBytes + kReliefPageSamples * kSampleBytes;
  if (parts.colours)
    bytes += reader.texture_pages_ * reader.texture_rows_ * kPageFullPx * kTexelBytes +
             static_cast<uint64_t>(grid.manifest().texture.planes() + 1) * kSlotBytes +
             TexturePages::bytes(grid.manifest());
  if (reader.normals_) bytes += ReliefNormals::kCachedBytes;
  return bytes;
}

RowParts SheetReader::within(const ExportGrid& grid, RowParts parts, uint64_t memory_bytes) {
  while (parts.rows > 1 && bytes(grid, parts) > memory_bytes) parts.rows /= 2;
  return parts;
}

void SheetReader::begin(uint32_t sheet) {
  sheet_ = sheet;
  relief_window_ = texture_window_ = {};
}

NodeId SheetReader::node(int level, uint64_t x, uint64_t y) const {
  if (grid_.isFlat()) return grid_.manifest().domain.flat().nodeAt(level, x, y);
  return {sheet_, static_cast<uint32_t>(level), static_cast<uint32_t>(x), static_cast<uint32_t>(y)};
}

Result<void> SheetReader::readReliefPage(const NodeId& at, std::span<uint16_t> samples) {
  auto page = grid_.package().read(PageId(Plane::kRelief, at));
  if (!page) return page.error();
  return decoder_.decodeRelief(page->bytes, samples);
}

Result<void> SheetReader::loadHeights(uint64_t band, size_t row) {
  if (relief_window_.holds(band, row, 1)) return {};
  relief_window_ = {};
  const bool whole = relief_rows_ == kReliefSamples;
  const size_t first = whole ? 0 : row, rows = std::min<size_t>(relief_rows_, kReliefSamples - first),
               kept = relief_rows_ * kReliefSamples;
  samples_.resize(relief_pages_ * kept);
  page_samples_.resize(kReliefPageSamples);
  for (uint64_t x = 0; x < relief_pages_; ++x) {
    if (auto read = readReliefPage(node(static_cast<int>(relief_level_), x, band), page_samples_); !read) return read;
    std::copy_n(page_samples_.begin() + static_cast<std::ptrdiff_t>(first * kReliefSamples), rows * kReliefSamples,
                samples_.begin() + static_cast<std::ptrdiff_t>(x * kept));
  }
  relief_window_ = {band, first, rows};
  return {};
}

Result<void> SheetReader::readColourPage(const NodeId& at, std::span<uint8_t> texels) {
  const TextureFormat& format = grid_.manifest().texture;
  const Shading shading = describe(format.basis).shading;
  const bool as_it_is = shading == Shading::kColour || (shading == Shading::kAlbedoNormal && !parts_.light);
  const int planes = as_it_is ? 1 : format.planes();
  planes_.resize(static_cast<size_t>(planes) * kSlotBytes);
  std::array<const uint8_t*, kMaxTexturePlanes> slots{};
  for (int k = 0; k < planes; ++k) {
    const PageId id(texturePlane(k), at);
    const auto slot = as_it_is ? texels : std::span(planes_).subspan(static_cast<size_t>(k) * kSlotBytes, kSlotBytes);
    if (auto done = grid_.texturePages().read(id, decoder_, slot); !done) return done;
    slots[static_cast<size_t>(k)] = slot.data();
  }
  if (!as_it_is)
    resolvePage(format, parts_.light.value_or(kLightFromTheFront), std::span(slots).first(static_cast<size_t>(planes)),
                texels.data());
  return {};
}

// Colour lit by the normals of its relief.
Result<void> SheetReader::readLitPage(const NodeId& at, std::span<uint8_t> texels) {
  std::vector<uint8_t> colour(kSlotBytes), normal(kSlotBytes);
  if (auto read = readColourPage(at, colour); !read) return read;
  Result<void> relief;
  const bool made = normals_->make(
      at,
      [&](const NodeId& of, std::span<uint16_t> samples) {
        if (auto read = readReliefPage(of, samples); !read) relief = read;
        return relief.ok();
      },
      normal.data());
  if (!made)
    return relief.ok()
               ? Result<void>(Error{
                     ErrorKind::kRuntime, grid_.package().path(), "the relief's normals could not be made", "", {}})
               : relief;
  const std::array<const uint8_t*, 2> slots{colour.data(), normal.data()};
  resolvePage(TextureFormat{.basis = Basis::kAlbedoNormal}, *parts_.light, slots, texels.data());
  return {};
}

Result<void> SheetReader::loadColours(uint64_t band, size_t row, size_t count) {
  if (texture_window_.holds(band, row, count)) return {};
  texture_window_ = {};
  constexpr size_t kRowBytes = 4 * size_t{kPageFullPx};
  const bool whole = texture_rows_ == kPageFullPx;
  const size_t first = whole ? 0 : row, rows = std::min<size_t>(texture_rows_, kPageFullPx - first),
               kept = texture_rows_ * kRowBytes;
  texels_.resize(texture_pages_ * kept);
  page_texels_.resize(kSlotBytes);
  for (uint64_t x = 0; x < texture_pages_; ++x) {
    const NodeId at = node(static_cast<int>(texture_level_), x, band);
    if (auto page = normals_ ? readLitPage(at, page_texels_) : readColourPage(at, page_texels_); !page) return page;
    std::copy_n(page_texels_.begin() + static_cast<std::ptrdiff_t>(first * kRowBytes), rows * kRowBytes,
                texels_.begin() + static_cast<std::ptrdiff_t>(x * kept));
  }
  texture_window_ = {band, first, rows};
  return {};
}

Result<void> SheetReader::readHeights(uint64_t y, SheetRow& row) {
  const uint64_t cells = std::min(grid_.cellsPerPatchSide(), uint64_t{kPagePx});  // of a page at this level
  const uint64_t step = kPagePx / cells, band = std::min(y / cells, relief_bands_ - 1);
  const auto in_page = static_cast<size_t>((y - band * cells) * step);
  if (auto loaded = loadHeights(band, in_page); !loaded) return loaded;
  row.heights.resize(grid_.columns());
  const uint64_t kept = relief_rows_ * kReliefSamples, in_window = in_page - relief_window_.first;
  for (uint64_t x = 0; x < grid_.columns(); ++x) {
    const uint64_t page = std::min(x / cells, relief_pages_ - 1);
    row.heights[x] = samples_[page * kept + in_window * kReliefSamples + (x - page * cells) * step];
  }
  return {};
}

// Bilinear between texels' centres; a page's gutter has those beyond its border.
Result<void> SheetReader::readColours(uint64_t y, SheetRow& row) {
  double width = 1e300, height = 1e300;  // texels of the level, on the artwork
  if (grid_.isFlat()) {
    const FlatDomain d = grid_.manifest().domain.flat();
    const double texels_per_px = std::ldexp(1.0, static_cast<int>(texture_level_) - d.texture_depth);
    width = static_cast<double>(d.width_px) * texels_per_px;
    height = static_cast<double>(d.height_px) * texels_per_px;
  }
  struct Place {
    uint64_t page;
    size_t first;
    double share;  // of the texel behind it
  };
  auto place = [&](uint64_t vertex, double extent, uint64_t pages) {
    const double texel = std::min(static_cast<double>(vertex) * texels_per_cell_, extent);
    const auto page = std::min(static_cast<uint64_t>(texel / kPagePx), pages - 1);
    const double in_slot = texel - static_cast<double>(page * kPagePx) - 0.5 + kPageBorderPx;
    const double first = std::floor(in_slot);
    return Place{page, static_cast<size_t>(first), in_slot - first};
  };
  const Place down = place(y, height, texture_bands_);
  if (auto loaded = loadColours(down.page, down.first, 2); !loaded) return loaded;
  row.colours.resize(grid_.columns());
  const size_t kept = texture_rows_ * 4 * kPageFullPx, in_window = down.first - texture_window_.first;
  for (uint64_t x = 0; x < grid_.columns(); ++x) {
    const Place right = place(x, width, texture_pages_);
    const uint8_t* at = texels_.data() + right.page * kept + 4 * (in_window * kPageFullPx + right.first);
    constexpr size_t kRow = 4 * size_t{kPageFullPx};
    for (glm::length_t c = 0; c < 3; ++c) {
      const double above = at[c] * (1 - right.share) + at[c + 4] * right.share;
      const double below = at[kRow + c] * (1 - right.share) + at[kRow + c + 4] * right.share;
      row.colours[x][c] = static_cast<uint8_t>(std::lround(above * (1 - down.share) + below * down.share));
    }
  }
  return {};
}

Result<void> SheetReader::readTexels(uint64_t y, SheetRow& row) {
  assert(texels_per_cell_ == 1);
  const auto in_slot = static_cast<size_t>(y % kPagePx + kPageBorderPx);
  if (auto loaded = loadColours(y / kPagePx, in_slot, 1); !loaded) return loaded;
  row.colours.resize(grid_.columns() - 1);
  const size_t kept = texture_rows_ * 4 * kPageFullPx, in_window = in_slot - texture_window_.first;
  for (uint64_t x = 0; x < row.colours.size(); ++x) {
    const uint8_t* at =
        texels_.data() + x / kPagePx * kept + 4 * (in_window * kPageFullPx + x % kPagePx + kPageBorderPx);
    row.colours[x] = {at[0], at[1], at[2]};
  }
  return {};
}

Result<void> SheetReader::read(uint64_t y, SheetRow& row) {
  if (parts_.heights && grid_.hasRelief()) {
    if (auto done = readHeights(y, row); !done) return done;
  }
  if (parts_.positions) {
    row.positions.resize(grid_.columns());
    for (uint64_t x = 0; x < grid_.columns(); ++x)
      row.positions[x] = grid_.ray(sheet_, x, y).at(grid_.hasRelief() ? grid_.heightOf(row.heights[x]) : 0.0);
  }
  return parts_.colours ? readColours(y, row) : Result<void>();
}

}  // namespace relievo
