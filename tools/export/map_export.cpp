#include "tools/export/map_export.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "texturing/import/image_io.h"
#include "tools/export/map_form.h"
#include "tools/export/surface_rows.h"

namespace relievo {
namespace {

// Values of one row as they are in the file, whatever their type.
struct MapRow {
  std::vector<float> floats;
  std::vector<uint16_t> words;
  std::vector<uint8_t> bytes;
  const void* data(SampleType type) const {
    if (type == SampleType::kFloat) return floats.data();
    return type == SampleType::kUint16 ? static_cast<const void*>(words.data()) : bytes.data();
  }
};

Result<MapForm> flatMapForm(const MapExportOptions& o) {
  auto format = imageFormatOf(o.output);
  if (!format) return format.error();
  const bool png = *format == ImageFormat::kPng, exr = *format == ImageFormat::kExr;
  if (*format == ImageFormat::kJpeg && !isColour(o.map))
    return Error{
        ErrorKind::kUsage, o.output, "a JPEG has 8 bits, and loses some of them", "name a .tif, .exr or .png", {}};
  switch (o.map) {
    case ExportMap::kNormal:
      return MapForm{3, exr ? SampleType::kFloat : SampleType::kUint16, exr};
    case ExportMap::kAlbedo:
    case ExportMap::kLit:
      return MapForm{3, exr ? SampleType::kFloat : SampleType::kUint8, exr};
    default:
      return MapForm{1, png ? SampleType::kUint16 : SampleType::kFloat, exr};
  }
}

void colourRow(const SheetRow& row, SampleType type, MapRow& out) {
  out.floats.clear();
  out.bytes.clear();
  for (const glm::u8vec3& c : row.colours)
    for (glm::length_t k = 0; k < 3; ++k)
      type == SampleType::kFloat ? out.floats.push_back(linearLight(c[k])) : out.bytes.push_back(c[k]);
}

// On the cut from (0,0) to (1,1), on which a cell's centre lies.
void heightRow(const ExportGrid& grid, const SheetRow& above, const SheetRow& below, bool depth, SampleType type,
               MapRow& out) {
  const size_t width = above.heights.size() - 1;
  out.floats.resize(width);
  out.words.resize(width);
  const double highest = grid.heightOf(65535);
  for (size_t x = 0; x < width; ++x) {
    const double sample = (above.heights[x] + below.heights[x + 1]) / 2.0;
    if (type == SampleType::kUint16) {
      out.words[x] = wordOf((depth ? 65535 - sample : sample) / 65535);
    } else {
      const double mm = grid.manifest().domain.relief_offset_mm + sample * grid.manifest().domain.relief_scale_mm;
      out.floats[x] = static_cast<float>(depth ? highest - mm : mm);
    }
  }
}

void normalRow(const SheetRow& above, const SheetRow& below, bool y_down, SampleType type, MapRow& out) {
  out.floats.clear();
  out.words.clear();
  for (size_t x = 0; x + 1 < above.positions.size(); ++x) {
    const glm::dvec3 &a = above.positions[x], &b = above.positions[x + 1], &c = below.positions[x],
                     &d = below.positions[x + 1];
    const double slope_x = (b.z + d.z - a.z - c.z) / 2 / (b.x - a.x),
                 slope_y = (a.z + b.z - c.z - d.z) / 2 / (a.y - c.y);
    const glm::dvec3 n = glm::normalize(glm::dvec3(-slope_x, y_down ? slope_y : -slope_y, 1));
    for (glm::length_t k = 0; k < 3; ++k) {
      const double share = (n[k] + 1) / 2;
      type == SampleType::kFloat ? out.floats.push_back(static_cast<float>(share)) : out.words.push_back(wordOf(share));
    }
  }
}

Result<void> checkArtwork(const Package& package, const MapExportOptions& o) {
  const Manifest& m = package.manifest();
  if (!m.domain.isFlat())
    return Error{ErrorKind::kUsage,
                 package.path(),
                 "is no flat artwork: only these have maps in a plane",
                 "leave out --map, and name a mesh",
                 {}};
  if (!isColour(o.map) && m.domain.relief_depth < 0)
    return Error{ErrorKind::kUsage, package.path(), "has no relief", "only --map albedo and lit can be made of it", {}};
  if (o.map == ExportMap::kLit && m.texture.basis == Basis::kColour && m.domain.relief_depth < 0)
    return Error{
        ErrorKind::kUsage, package.path(), "has no relief, and colours that no light changes", "name --map albedo", {}};
  return {};
}

class MapExport {
 public:
  MapExport(const ExportGrid& grid, const MapExportOptions& options, MapForm form)
      : grid_(grid), options_(options), form_(form), reader_(grid, partsOf(grid, options, form)) {
    reader_.begin(0);
  }
  static RowParts partsOf(const ExportGrid& grid, const MapExportOptions& o, const MapForm& form) {
    RowParts parts{.heights = !isColour(o.map), .positions = o.map == ExportMap::kNormal, .colours = isColour(o.map)};
    if (o.map == ExportMap::kLit) {
      const double length = std::hypot(o.light[0], o.light[1], o.light[2]);
      parts.light = {o.light[0] / length, o.light[1] / length, o.light[2] / length};
    }
    return SheetReader::within(grid, parts,
                               memoryForRows(o) - std::min(memoryForRows(o), writtenRowBytes(grid.columns(), form)));
  }
  static uint64_t bytes(const ExportGrid& grid, const MapExportOptions& o, const MapForm& form) {
    return SheetReader::bytes(grid, partsOf(grid, o, form)) + writtenRowBytes(grid.columns(), form);
  }

  Result<void> write(ImageWriter& image) {
    const bool albedo = isColour(options_.map);
    if (!albedo)
      if (auto read = reader_.read(0, above_); !read) return read;
    for (uint64_t y = 0; y + 1 < grid_.rows(); ++y) {
      if (options_.interrupted && options_.interrupted->load(std::memory_order_relaxed))
        return Error{ErrorKind::kInterrupted, options_.output, "interrupted", "", {}};
      if (auto read = albedo ? reader_.readTexels(y, below_) : reader_.read(y + 1, below_); !read) return read;
      fill();
      if (auto appended = image.appendRows(1, row_.data(form_.type)); !appended) return appended;
      std::swap(above_, below_);
      if (options_.progress) options_.progress(static_cast<double>(y) / static_cast<double>(grid_.rows()));
    }
    return {};
  }

 private:
  void fill() {
    switch (options_.map) {
      case ExportMap::kAlbedo:
      case ExportMap::kLit:
        return colourRow(below_, form_.type, row_);
      case ExportMap::kNormal:
        return normalRow(above_, below_, options_.normal_y_down, form_.type, row_);
      default:
        return heightRow(grid_, above_, below_, options_.map == ExportMap::kDepth, form_.type, row_);
    }
  }

  const ExportGrid& grid_;
  const MapExportOptions& options_;
  const MapForm form_;
  SheetReader reader_;
  SheetRow above_, below_;
  MapRow row_;
};

}  // namespace

Result<ExportMap> exportMapOf(const std::string& name) {
  constexpr std::pair<const char*, ExportMap> kMaps[] = {
      {"height", ExportMap::kHeight}, {"displacement", ExportMap::kHeight}, {"depth", ExportMap::kDepth},
      {"normal", ExportMap::kNormal}, {"albedo", ExportMap::kAlbedo},       {"lit", ExportMap::kLit}};
  for (const auto& [known, map] : kMaps)
    if (name == known) return map;
  return Error{
      ErrorKind::kUsage, "", "expected --map height, depth, normal, albedo or lit, found '" + name + "'", "", {}};
}

Result<MapExportReport> exportMap(std::shared_ptr<const Package> package, const MapExportOptions& o) {
  auto form = flatMapForm(o);
  if (!form) return form.error();
  if (auto good = checkArtwork(*package, o); !good) return good.error();
  auto level = mapLevelOf(*package, o, kPageCellsLog2);
  if (!level) return level.error();
  const ExportGrid grid(package, *level);
  if (o.map == ExportMap::kLit && !(std::hypot(o.light[0], o.light[1], o.light[2]) > 0))
    return Error{ErrorKind::kUsage, "", "expected a --light that is not 0,0,0", "0,0,1 is straight from the front", {}};
  if (const uint64_t bytes = MapExport::bytes(grid, o, *form); bytes > memoryForRows(o))
    return tooLarge(o, *form, *level, bytes);
  MapExportReport report;
  const FlatDomain d = package->manifest().domain.flat();
  report.level = *level;
  report.width = static_cast<int64_t>(grid.columns() - 1);
  report.height = static_cast<int64_t>(grid.rows() - 1);
  if (package->manifest().size_known)
    report.mm_per_px = d.mm_per_px * std::ldexp(static_cast<double>(d.patchPx()), -*level);
  report.scaled = form->channels == 1 && form->type == SampleType::kUint16;
  report.low_mm = o.map == ExportMap::kDepth ? 0 : grid.heightOf(0);
  report.high_mm = o.map == ExportMap::kDepth ? grid.heightOf(65535) - grid.heightOf(0) : grid.heightOf(65535);
  auto image = ImageWriter::create(o.output, report.width, report.height, form->channels, form->type, report.mm_per_px);
  if (!image) return image.error();
  MapExport map(grid, o, *form);
  if (auto done = map.write(**image); !done) return done.error();
  if (auto done = (*image)->commit(); !done) return done.error();
  return report;
}

}  // namespace relievo
