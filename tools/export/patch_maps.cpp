#include "tools/export/patch_maps.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "src/base/file.h"
#include "src/base/printable.h"
#include "texturing/import/image_io.h"
#include "tools/export/map_form.h"
#include "tools/export/shared_vertices.h"
#include "tools/export/surface_normals.h"
#include "tools/export/surface_rows.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

std::string besideImage(const std::string& image, const char* end) {
  const size_t dot = image.find_last_of("./");
  return (dot == std::string::npos || image[dot] != '.' ? image : image.substr(0, dot)) + end;
}
std::string nameOf(const std::string& path) { return path.substr(path.rfind('/') + 1); }

Result<MapForm> patchMapForm(const MapExportOptions& o) {
  auto format = imageFormatOf(o.output);
  if (!format) return format.error();
  const bool exr = *format == ImageFormat::kExr;
  if (*format == ImageFormat::kJpeg || o.output == "-")
    return Error{ErrorKind::kUsage,
                 o.output,
                 o.output == "-" ? "a scan's map is three files, and standard output takes one"
                                 : "a JPEG would blur the patches' borders",
                 "name a .tif, .exr or .png",
                 {}};
  switch (o.map) {
    case ExportMap::kHeight:
      return MapForm{1, exr ? SampleType::kFloat : SampleType::kUint16, exr};
    case ExportMap::kNormal:
      return MapForm{3, exr ? SampleType::kFloat : SampleType::kUint16, exr};
    case ExportMap::kAlbedo:
      return MapForm{3, exr ? SampleType::kFloat : SampleType::kUint8, exr};
    default:
      return Error{ErrorKind::kUsage, o.output, "a scan has --map displacement, normal and albedo alone", "", {}};
  }
}

// Where tiles lie: patch p is in column p % columns of row p / columns.
struct Atlas {
  uint32_t patches = 0, columns = 0, rows = 0;
  uint64_t tile = 0;  // texels of a side
  uint64_t width() const { return columns * tile; }
  uint64_t height() const { return rows * tile; }
};
Atlas atlasOf(const ExportGrid& grid) {
  Atlas a;
  a.patches = grid.sheets();
  a.columns = static_cast<uint32_t>(std::ceil(std::sqrt(static_cast<double>(a.patches))));
  a.rows = (a.patches + a.columns - 1) / a.columns;
  a.tile = grid.columns();
  return a;
}

// One patch, row after row, with the normals of its own triangles.
class PatchWalk {
 public:
  PatchWalk(const ExportGrid& grid, const RowParts& parts)
      : grid_(grid), reader_(grid, parts), normals_(parts.positions) {}
  void begin(uint32_t patch) {
    reader_.begin(patch);
    next_ = 0;
    if (normals_) sums_.assign(grid_.columns(), glm::dvec3(0));
  }
  // The next row is row() then; sums() are the crosses around its vertices.
  Result<void> advance() {
    if (!normals_) return reader_.read(next_++, row_);
    if (next_ == 0)
      if (auto read = reader_.read(0, below_); !read) return read;
    std::swap(row_, below_);
    if (next_ > 0) sums_.swap(sums_below_);
    sums_below_.assign(grid_.columns(), glm::dvec3(0));
    if (++next_ == grid_.rows()) return {};
    if (auto read = reader_.read(next_, below_); !read) return read;
    addCrosses(row_, below_, sums_, sums_below_);
    return {};
  }
  const SheetRow& row() const { return row_; }
  const std::vector<glm::dvec3>& sums() const { return sums_; }

 private:
  const ExportGrid& grid_;
  SheetReader reader_;
  const bool normals_;
  uint64_t next_ = 0;
  SheetRow row_, below_;
  std::vector<glm::dvec3> sums_, sums_below_;
};

class PatchMaps {
 public:
  PatchMaps(const ExportGrid& grid, const MapExportOptions& options, const MapForm& form)
      : grid_(grid), options_(options), form_(form), atlas_(atlasOf(grid)) {}
  const Atlas& atlas() const { return atlas_; }

  static RowParts partsOf(const MapExportOptions& o) {
    return {.heights = o.map != ExportMap::kAlbedo,
            .positions = o.map == ExportMap::kNormal,
            .colours = o.map == ExportMap::kAlbedo};
  }
  // Everything that grows with the artwork, with one row of each page at once.
  uint64_t bytes(const RowParts& parts) const {
    uint64_t one = SheetReader::bytes(grid_, parts);
    if (parts.positions) one += 2 * grid_.columns() * sizeof(glm::dvec3);
    uint64_t sum = one * atlas_.columns + writtenRowBytes(atlas_.width(), form_);
    if (parts.positions)
      sum += SharedVertices::count(*grid_.manifest().base, uniformLevels(grid_.sheets(), grid_.level())) *
             sizeof(SharedVertices::Vertex);
    return sum;
  }

  Result<void> write(ImageWriter& image, RowParts parts) {
    if (options_.map == ExportMap::kNormal)
      if (auto done = sumBorders(parts); !done) return done;
    std::deque<PatchWalk> walks;
    for (uint32_t c = 0; c < atlas_.columns; ++c) walks.emplace_back(grid_, parts);
    for (uint32_t r = 0; r < atlas_.rows; ++r) {
      const uint32_t first = r * atlas_.columns, count = std::min(atlas_.columns, atlas_.patches - first);
      for (uint32_t c = 0; c < count; ++c) walks[c].begin(first + c);
      for (uint64_t y = 0; y < atlas_.tile; ++y) {
        if (options_.interrupted && *options_.interrupted) return interruption();
        floats_.assign(atlas_.width() * static_cast<uint64_t>(form_.channels), 0);
        words_.assign(floats_.size(), 0);
        bytes_.assign(floats_.size(), 0);
        for (uint32_t c = 0; c < count; ++c) {
          if (auto done = walks[c].advance(); !done) return done;
          fill(walks[c], first + c, y, c * atlas_.tile);
        }
        const void* data = form_.type == SampleType::kFloat    ? static_cast<const void*>(floats_.data())
                           : form_.type == SampleType::kUint16 ? static_cast<const void*>(words_.data())
                                                               : bytes_.data();
        if (auto done = image.appendRows(1, data); !done) return done;
      }
      report(shared_ ? 0.5 : 0, shared_ ? 0.5 : 1, static_cast<double>(r + 1) / atlas_.rows);
    }
    return {};
  }

 private:
  Error interruption() const { return {ErrorKind::kInterrupted, options_.output, "interrupted", "", {}}; }
  void report(double from, double share, double done) const {
    if (options_.progress) options_.progress(from + share * done);
  }

  // Vertices that patches share have the triangles of all of them around.
  Result<void> sumBorders(const RowParts& parts) {
    shared_.emplace(*grid_.manifest().base, uniformLevels(grid_.sheets(), grid_.level()));
    PatchWalk walk(grid_, parts);
    const uint64_t last = atlas_.tile - 1;
    for (uint32_t p = 0; p < atlas_.patches; ++p) {
      walk.begin(p);
      for (uint64_t y = 0; y <= last; ++y) {
        if (options_.interrupted && *options_.interrupted) return interruption();
        if (auto done = walk.advance(); !done) return done;
        const bool end_row = y == 0 || y == last;
        for (uint64_t x = 0; x <= last; x += end_row ? 1 : last) {
          const uint16_t height = walk.row().heights.empty() ? uint16_t{0} : walk.row().heights[x];
          if (shared_->add(shared_->index(p, x, y), glm::vec3(walk.sums()[x]), height, {})) continue;
          return Error{ErrorKind::kInvalidData,
                       grid_.package().path(),
                       "expected the same height from all patches that share a vertex",
                       "the package was not made by relievo's rules; build it again from its scan",
                       {}};
        }
      }
      report(0, 0.5, static_cast<double>(p + 1) / atlas_.patches);
    }
    return {};
  }

  glm::vec3 normalAt(const PatchWalk& walk, uint32_t patch, uint64_t x, uint64_t y) const {
    const uint64_t last = atlas_.tile - 1;
    const glm::dvec3 sum = x == 0 || y == 0 || x == last || y == last
                               ? glm::dvec3((*shared_)[shared_->index(patch, x, y)].normal)
                               : walk.sums()[x];
    return unitNormal(sum, grid_.ray(patch, x, y).along);
  }

  void put(size_t at, double value, double share) {
    if (form_.type == SampleType::kFloat) floats_[at] = static_cast<float>(value);
    else words_[at] = wordOf(share);
  }
  void fill(const PatchWalk& walk, uint32_t patch, uint64_t y, uint64_t left) {
    const SheetRow& row = walk.row();
    for (uint64_t x = 0; x < atlas_.tile; ++x) {
      const size_t at = (left + x) * static_cast<size_t>(form_.channels);
      if (options_.map == ExportMap::kHeight) {
        floats_[at] = static_cast<float>(grid_.heightOf(row.heights[x]));
        words_[at] = row.heights[x];
      } else if (options_.map == ExportMap::kNormal) {
        const glm::vec3 n = normalAt(walk, patch, x, y);
        for (glm::length_t c = 0; c < 3; ++c) {
          const double share = (double{n[c]} + 1) / 2;
          put(at + static_cast<size_t>(c), share, share);
        }
      } else {
        for (glm::length_t c = 0; c < 3; ++c) {
          bytes_[at + static_cast<size_t>(c)] = row.colours[x][c];
          if (form_.type == SampleType::kFloat) floats_[at + static_cast<size_t>(c)] = linearLight(row.colours[x][c]);
        }
      }
    }
  }

  const ExportGrid& grid_;
  const MapExportOptions& options_;
  const MapForm form_;
  const Atlas atlas_;
  std::optional<SharedVertices> shared_;
  std::vector<float> floats_;
  std::vector<uint16_t> words_;
  std::vector<uint8_t> bytes_;
};

// What a stored sample s stands for: offset + scale s.
Json valueJson(const ExportGrid& grid, const MapExportOptions& o, const MapForm& form) {
  const PatchDomain& d = grid.manifest().domain;
  const bool is_float = form.type == SampleType::kFloat;
  Json value = Json::object();
  value["type"] = is_float ? "float32" : form.type == SampleType::kUint16 ? "uint16" : "uint8";
  if (o.map == ExportMap::kHeight) {
    value["offset"] = is_float ? 0 : d.relief_offset_mm;
    value["scale"] = is_float ? 1 : d.relief_scale_mm;
  } else if (o.map == ExportMap::kNormal) {
    value["offset"] = -1;
    value["scale"] = is_float ? 2.0 : 2.0 / 65535;
  } else {
    value["colour_space"] = is_float ? "linear light" : "sRGB";
    value["offset"] = 0;
    value["scale"] = is_float ? 1.0 : 1.0 / 255;
  }
  return value;
}

Json vectorJson(const glm::dvec3& v) { return Json::array({v.x, v.y, v.z}); }

std::string jsonText(const ExportGrid& grid, const MapExportOptions& o, const MapForm& form, const Atlas& atlas) {
  const BaseMesh& base = *grid.manifest().base;
  const char* const name = o.map == ExportMap::kHeight ? "height" : o.map == ExportMap::kNormal ? "normal" : "albedo";
  Json json = Json::object();
  json["format"] = "relievo patch map";
  json["version"] = 1;
  json["generator"] = "relievo " RELIEVO_VERSION;
  json["artwork"] = nameOf(grid.package().path());
  json["map"] = name;
  json["image"] = nameOf(o.output);
  json["base"] = nameOf(patchMapObj(o.output));
  json["unit"] = "mm";
  json["origin"] = vectorJson(base.origin_mm);
  json["level"] = grid.level();
  json["cells"] = grid.cellsPerPatchSide();
  json["atlas"] = {{"width", atlas.width()},
                   {"height", atlas.height()},
                   {"columns", atlas.columns},
                   {"rows", atlas.rows},
                   {"tile", atlas.tile}};
  json["value"] = valueJson(grid, o, form);
  json["formula"] =
      "patch p, vertex (i, j), 0 <= i, j <= cells, u = i / cells, v = j / cells: texel ((p % columns) * tile + i, "
      "floor(p / columns) * tile + j) of the image, its top row first; P(u, v) and D(u, v) from the corners' positions "
      "and directions, patches naming corners at (u, v) = (0,0), (1,0), (0,1), (1,1), by weights (1-u)(1-v), u(1-v), "
      "(1-u)v, uv if inside is bilinear, and 1-max(u,v), u-min(u,v), v-min(u,v), min(u,v) if it is triangles; surface "
      "= origin + P + height * D";
  json["inside"] = base.cut ? "triangles" : "bilinear";
  json["positions"] = json["directions"] = json["patches"] = Json::array();
  for (const BaseCorner& c : base.corners) {
    json["positions"].push_back(vectorJson(c.position_mm));
    json["directions"].push_back(vectorJson(c.normal));
  }
  for (const auto& p : base.patches) json["patches"].push_back({p[0], p[1], p[2], p[3]});
  return json.dump(-1, ' ', true, Json::error_handler_t::replace) + "\n";
}

// The base mesh's quads, counter-clockwise seen from outside. Corners of the quad are centres of the tile's corner
// texels, so that a bilinear filter gives the samples at vertices and nothing of a neighbour.
std::string objText(const ExportGrid& grid, const MapExportOptions& o, const Atlas& atlas) {
  const BaseMesh& base = *grid.manifest().base;
  std::string text = "# " + printable(nameOf(grid.package().path())) + ", the base of " + nameOf(o.output) +
                     ", exported by relievo " RELIEVO_VERSION "\n# unit mm\n";
  char line[200];
  for (const BaseCorner& c : base.corners) {
    const glm::dvec3 p = base.origin_mm + glm::dvec3(c.position_mm);
    std::snprintf(line, sizeof line, "v %.15g %.15g %.15g\n", p.x, p.y, p.z);
    text += line;
  }
  for (const BaseCorner& c : base.corners) {
    std::snprintf(line, sizeof line, "vn %.9g %.9g %.9g\n", c.normal.x, c.normal.y, c.normal.z);
    text += line;
  }
  const auto width = static_cast<double>(atlas.width()), height = static_cast<double>(atlas.height());
  for (uint32_t p = 0; p < atlas.patches; ++p)
    for (const uint32_t corner : {0u, 2u, 3u, 1u}) {
      const double x = static_cast<double>(p % atlas.columns * atlas.tile + (corner & 1) * (atlas.tile - 1)) + 0.5,
                   y = static_cast<double>(p / atlas.columns * atlas.tile + (corner >> 1) * (atlas.tile - 1)) + 0.5;
      std::snprintf(line, sizeof line, "vt %.12g %.12g\n", x / width, 1 - y / height);
      text += line;
    }
  for (uint32_t p = 0; p < atlas.patches; ++p) {
    text += "f";
    constexpr std::array<size_t, 4> kCorners{0, 2, 3, 1};
    for (size_t k = 0; k < 4; ++k) {
      const uint32_t corner = base.patches[p][kCorners[k]] + 1;
      std::snprintf(line, sizeof line, " %u/%zu/%u", corner, size_t{4} * p + k + 1, corner);
      text += line;
    }
    text += "\n";
  }
  return text;
}

Result<OutputFile> writeBeside(const std::string& path, const std::string& text) {
  auto file = OutputFile::create(path);
  if (!file) return file.error();
  if (auto done = file->append({reinterpret_cast<const uint8_t*>(text.data()), text.size()}); !done)
    return done.error();
  if (auto done = file->finish(); !done) return done.error();
  return file;
}

}  // namespace

std::string patchMapJson(const std::string& image) { return besideImage(image, ".map.json"); }
std::string patchMapObj(const std::string& image) { return besideImage(image, ".map.obj"); }

Result<PatchMapReport> exportPatchMaps(std::shared_ptr<const Package> package, const MapExportOptions& o) {
  auto form = patchMapForm(o);
  if (!form) return form.error();
  if (package->manifest().domain.isFlat() || package->manifest().domain.relief_depth < 0)
    return Error{ErrorKind::kUsage, package->path(), "is no scan: it has no patches over a base mesh", "", {}};
  if (o.normal_y_down)
    return Error{ErrorKind::kUsage,
                 o.output,
                 "a scan's normals are those of its own axes, and have no --normal-y",
                 "leave it out",
                 {}};
  auto level = mapLevelOf(*package, o, 0);
  if (!level) return level.error();
  const ExportGrid grid(package, *level);
  PatchMaps maps(grid, o, *form);
  RowParts parts = PatchMaps::partsOf(o);
  while (parts.rows > 1 && maps.bytes(parts) > memoryForRows(o)) parts.rows /= 2;
  if (const uint64_t bytes = maps.bytes(parts); bytes > memoryForRows(o)) return tooLarge(o, *form, *level, bytes);
  const Atlas& atlas = maps.atlas();
  auto json = writeBeside(patchMapJson(o.output), jsonText(grid, o, *form, atlas));
  if (!json) return json.error();
  auto obj = writeBeside(patchMapObj(o.output), objText(grid, o, atlas));
  if (!obj) return obj.error();
  PatchMapReport report{*level, atlas.patches, atlas.columns, static_cast<int64_t>(atlas.width()),
                        static_cast<int64_t>(atlas.height())};
  auto image = ImageWriter::create(o.output, report.width, report.height, form->channels, form->type);
  if (!image) return image.error();
  if (auto done = maps.write(**image, parts); !done) return done.error();
  if (auto done = (*image)->commit(); !done) return done.error();
  if (auto done = obj->commit(); !done) return done.error();
  if (auto done = json->commit(); !done) return done.error();
  return report;
}

}  // namespace relievo
