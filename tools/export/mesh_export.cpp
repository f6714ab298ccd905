#include "tools/export/mesh_export.h"

#include <algorithm>
#include <array>
#include <vector>

#include "src/base/file.h"
#include "src/base/parallel_for.h"
#include "tools/export/glb_draco.h"
#include "tools/export/mesh_detail.h"
#include "tools/export/mesh_format.h"
#include "tools/export/patch_levels.h"
#include "tools/export/shared_vertices.h"
#include "tools/export/surface_normals.h"
#include "tools/export/surface_rows.h"
#include "tools/export/textured_glb.h"

namespace relievo {
namespace {

// Of positions rounded to floats, as a .glb states them.
struct Bounds {
  glm::vec3 low{3e38f}, high{-3e38f};
  void add(const glm::dvec3& p) { low = glm::min(low, glm::vec3(p)), high = glm::max(high, glm::vec3(p)); }
  void add(const Bounds& b) { low = glm::min(low, b.low), high = glm::max(high, b.high); }
};

// A vertex on a patch's border as one patch sees it.
struct BorderVertex {
  uint64_t index;  // of SharedVertices
  glm::vec3 normal;
  uint16_t height;
  glm::u8vec3 colour;
};

// What one sheet gives: bytes of its own vertices (or of a soup's triangles), and its share of those on its border.
struct SheetOutput {
  ByteBuffer bytes;
  Bounds bounds;
  std::vector<BorderVertex> border;
  std::optional<Error> error;
};

// Vertices of a patch's left and right sides, of which rows of its grid show others than their own where these have
// fewer cells.
class SnappedSides {
 public:
  // Rows of the patch that the reader has begun.
  Result<void> read(SheetReader& reader, const PatchLevels& levels) {
    levels_ = levels;
    const uint8_t finest = std::max(levels.sides[kLeft], levels.sides[kRight]);
    if (std::min(levels.sides[kLeft], levels.sides[kRight]) == levels.grid) return {};
    shift_ = levels.grid - finest;
    SheetRow row;
    for (SheetRow& side : sides_) side = {};
    for (uint64_t y = 0; y <= levels.cells(); y += uint64_t{1} << shift_) {
      if (auto read = reader.read(y, row); !read) return read;
      for (const size_t k : {0, 1}) append(sides_[k], row, k == 0 ? 0 : row.positions.size() - 1);
    }
    return {};
  }
  void apply(uint64_t y, SheetRow& row) const {
    const uint64_t last = levels_.cells();
    if (levels_.sides[kLeft] < levels_.grid) copy(row, 0, sides_[0], levels_.snapped(0, y)[1] >> shift_);
    if (levels_.sides[kRight] < levels_.grid) copy(row, last, sides_[1], levels_.snapped(last, y)[1] >> shift_);
    const Side side = y == 0 ? kTop : kBottom;
    if ((y > 0 && y < last) || levels_.sides[side] == levels_.grid) return;
    const SheetRow own = row;
    for (uint64_t x = 0; x <= last; ++x) copy(row, x, own, levels_.snapped(x, y)[0]);
  }

 private:
  static void copy(SheetRow& to, size_t at, const SheetRow& from, size_t place) {
    if (!from.heights.empty()) to.heights[at] = from.heights[place];
    to.positions[at] = from.positions[place];
    if (!from.colours.empty()) to.colours[at] = from.colours[place];
  }
  static void append(SheetRow& to, const SheetRow& from, size_t place) {
    if (!from.heights.empty()) to.heights.push_back(from.heights[place]);
    to.positions.push_back(from.positions[place]);
    if (!from.colours.empty()) to.colours.push_back(from.colours[place]);
  }
  PatchLevels levels_;
  int shift_ = 0;
  std::array<SheetRow, 2> sides_;  // left and right, every 2^shift_-th vertex
};

class MeshExport {
 public:
  MeshExport(const ExportGrid& grid, const MeshDetail& detail, const MeshFormat& format,
             const MeshExportOptions& options, const MeshFacts& facts)
      : grid_(grid), patches_(detail.patches), format_(format), options_(options), facts_(facts) {
    for (int level = 0; level <= detail.level; ++level) grids_.emplace_back(grid, level);
    if (format.soup()) return;
    if (!grid.isFlat()) shared_.emplace(*grid.manifest().base, detail.patches);
    own_first_.assign(1, 0);
    for (const PatchLevels& p : patches_) own_first_.push_back(own_first_.back() + p.ownVertices());
  }

  const MeshFacts& facts() const { return facts_; }
  Result<void> write(OutputFile& file);

 private:
  using Append = std::function<Result<void>(ByteBuffer&)>;
  Result<void> writeSheets(OutputFile& file);
  Result<void> walkSheet(SheetReader& reader, uint32_t sheet, SheetOutput& out, const Append& append);
  void emitRow(uint32_t sheet, uint64_t y, const SheetRow& row, const std::vector<glm::dvec3>& normals,
               SheetOutput& out) const;
  void emitTriangles(uint32_t sheet, uint64_t y, const SheetRow& above, const SheetRow& below, SheetOutput& out) const;
  Result<void> merge(const SheetOutput& out);
  Result<void> writeShared(OutputFile& file);
  Result<void> writeFaces(OutputFile& file);
  uint32_t vertexIndex(uint32_t sheet, uint64_t x, uint64_t y) const;
  const ExportGrid& gridOf(uint32_t sheet) const { return patches_.empty() ? grid_ : grids_[patches_[sheet].grid]; }
  bool hasTriangle(uint32_t sheet, uint64_t x, uint64_t y, bool above) const {
    return patches_.empty() || patches_[sheet].hasTriangle(x, y, above);
  }
  bool interrupted() const { return options_.interrupted && options_.interrupted->load(std::memory_order_relaxed); }
  Error interruption() const { return {ErrorKind::kInterrupted, options_.output, "interrupted", "", {}}; }
  void report(double share) const {
    if (options_.progress) options_.progress(share);
  }

  const ExportGrid& grid_;  // the finest
  const std::vector<PatchLevels>& patches_;
  std::vector<ExportGrid> grids_;  // by level
  const MeshFormat& format_;
  const MeshExportOptions& options_;
  MeshFacts facts_;
  std::vector<uint64_t> own_first_;  // of each patch's own vertices
  std::optional<SharedVertices> shared_;
  Bounds bounds_;
};

void MeshExport::emitRow(uint32_t sheet, uint64_t y, const SheetRow& row, const std::vector<glm::dvec3>& normals,
                         SheetOutput& out) const {
  const ExportGrid& grid = gridOf(sheet);
  const bool end_row = y == 0 || y + 1 == grid.rows();
  for (uint64_t x = 0; x < grid.columns(); ++x) {
    if (shared_ && (end_row || x == 0 || x + 1 == grid.columns())) {
      const auto [to_x, to_y] = patches_[sheet].snapped(x, y);
      out.border.push_back({shared_->index(sheet, to_x, to_y), glm::vec3(normals[x]),
                            row.heights.empty() ? uint16_t{0} : row.heights[x], row.colours[x]});
      continue;
    }
    const glm::vec3 normal = unitNormal(normals[x], grid.isFlat() ? glm::dvec3(0, 0, 1) : grid.ray(sheet, x, y).along);
    format_.vertex(facts_, {row.positions[x], normal, row.colours[x]}, out.bytes);
    out.bounds.add(row.positions[x]);
  }
}

void MeshExport::emitTriangles(uint32_t sheet, uint64_t y, const SheetRow& above, const SheetRow& below,
                               SheetOutput& out) const {
  for (size_t x = 0; x + 1 < above.positions.size(); ++x) {
    const glm::dvec3 &a = above.positions[x], &b = above.positions[x + 1], &c = below.positions[x],
                     &d = below.positions[x + 1];
    if (hasTriangle(sheet, x, y, true)) format_.triangle(facts_, {a, d, b}, out.bytes);
    if (hasTriangle(sheet, x, y, false)) format_.triangle(facts_, {a, c, d}, out.bytes);
  }
}

Result<void> MeshExport::walkSheet(SheetReader& reader, uint32_t sheet, SheetOutput& out, const Append& append) {
  const ExportGrid& grid = gridOf(sheet);
  reader.begin(sheet);
  SheetRow above, below;
  SnappedSides sides;
  const bool snapped = !patches_.empty() && patches_[sheet].isSnapped();
  if (snapped)
    if (auto read = sides.read(reader, patches_[sheet]); !read) return read;
  auto readRow = [&](uint64_t y, SheetRow& row) {
    auto read = reader.read(y, row);
    if (read && snapped) sides.apply(y, row);
    return read;
  };
  std::vector<glm::dvec3> normals_above(grid.columns(), glm::dvec3(0)), normals_below = normals_above;
  if (auto read = readRow(0, above); !read) return read;
  for (uint64_t y = 0; y + 1 < grid.rows(); ++y) {
    if (interrupted()) return interruption();
    if (auto read = readRow(y + 1, below); !read) return read;
    if (format_.soup()) {
      emitTriangles(sheet, y, above, below, out);
    } else {
      std::fill(normals_below.begin(), normals_below.end(), glm::dvec3(0));
      addCrosses(above, below, normals_above, normals_below);
      emitRow(sheet, y, above, normals_above, out);
    }
    if (auto appended = append(out.bytes); !appended) return appended;
    if (grid.isFlat()) report(0.7 * static_cast<double>(y) / static_cast<double>(grid.rows()));
    std::swap(above, below);
    std::swap(normals_above, normals_below);
  }
  if (!format_.soup()) emitRow(sheet, grid.rows() - 1, above, normals_above, out);
  return append(out.bytes);
}

// In the order of the patches, whichever worker made it: sums of floats depend on theirs.
Result<void> MeshExport::merge(const SheetOutput& out) {
  bounds_.add(out.bounds);
  for (const BorderVertex& b : out.border) {
    if (shared_->add(b.index, b.normal, b.height, b.colour)) continue;
    return Error{ErrorKind::kInvalidData,
                 grid_.package().path(),
                 "expected the same height from all patches that share a vertex, found " + std::to_string(b.height) +
                     " beside " + std::to_string((*shared_)[b.index].height),
                 "the package was not made by relievo's rules; build it again from its scan",
                 {}};
  }
  return {};
}

// One worker's: patches of the same level one after the other have the same reader.
class LevelReader {
 public:
  SheetReader& of(const ExportGrid& grid, const RowParts& parts) {
    if (level_ != grid.level()) reader_.emplace(grid, parts);
    level_ = grid.level();
    return *reader_;
  }

 private:
  std::optional<SheetReader> reader_;
  int level_ = -1;
};

Result<void> MeshExport::writeSheets(OutputFile& file) {
  const RowParts parts{.colours = facts_.colours};
  const uint32_t sheets = grid_.sheets();
  if (sheets == 1) {
    SheetReader reader(gridOf(0), parts);
    SheetOutput out;
    auto walked = walkSheet(reader, 0, out, [&](ByteBuffer& bytes) {
      auto appended = file.append(bytes);
      bytes.clear();
      return appended;
    });
    return walked ? merge(out) : walked;
  }
  // A batch of sheets in memory, made by all workers, then appended in order.
  constexpr uint64_t kMostBytesPerVertex = 160;  // of a soup's two triangles, or of a line of text and a border's share
  constexpr uint32_t kMostAtOnce = 256;
  auto batchFrom = [&](uint32_t first) {
    uint32_t count = 0;
    for (uint64_t left = options_.memory_bytes / 4; first + count < sheets && count < kMostAtOnce; ++count) {
      const ExportGrid& grid = gridOf(first + count);
      const uint64_t bytes = grid.columns() * grid.rows() * kMostBytesPerVertex;
      if (count > 0 && bytes > left) break;
      left -= std::min(bytes, left);
    }
    return count;
  };
  for (uint32_t first = 0, batch = 0; first < sheets; first += batch) {
    batch = batchFrom(first);
    std::vector<SheetOutput> outputs(batch);
    const bool whole = parallelForWith(
        outputs.size(), options_.workers, options_.interrupted, [] { return LevelReader(); },
        [&](LevelReader& reader, size_t i) {
          const uint32_t sheet = first + static_cast<uint32_t>(i);
          auto walked =
              walkSheet(reader.of(gridOf(sheet), parts), sheet, outputs[i], [](ByteBuffer&) { return Result<void>(); });
          if (!walked) outputs[i].error = walked.error();
        });
    if (!whole) return interruption();
    for (SheetOutput& out : outputs) {
      if (out.error) return *out.error;
      if (auto merged = merge(out); !merged) return merged;
      if (auto appended = file.append(out.bytes); !appended) return appended;
      out = {};
    }
    report(0.7 * static_cast<double>(first) / sheets);
  }
  return {};
}

Result<void> MeshExport::writeShared(OutputFile& file) {
  ByteBuffer bytes;
  constexpr size_t kPiece = size_t{1} << 20;
  for (uint64_t i = 0; shared_ && i < shared_->size(); ++i) {
    const SharedVertices::Vertex& v = (*shared_)[i];
    const SharedVertices::Place at = shared_->place(i);
    const ExportGrid::Ray ray = gridOf(at.patch).ray(at.patch, at.x, at.y);
    const glm::dvec3 position = ray.at(grid_.hasRelief() ? grid_.heightOf(v.height) : 0.0);
    format_.vertex(facts_, {position, unitNormal(v.normal, ray.along), v.colour}, bytes);
    bounds_.add(position);
    if (bytes.size() < kPiece) continue;
    if (auto appended = file.append(bytes); !appended) return appended;
    bytes.clear();
    if (interrupted()) return interruption();
  }
  return file.append(bytes);
}

uint32_t MeshExport::vertexIndex(uint32_t sheet, uint64_t x, uint64_t y) const {
  if (!shared_) return static_cast<uint32_t>(y * grid_.columns() + x);
  const uint64_t n = patches_[sheet].cells();
  if (x == 0 || x == n || y == 0 || y == n) {
    const auto [to_x, to_y] = patches_[sheet].snapped(x, y);
    return static_cast<uint32_t>(own_first_.back() + shared_->index(sheet, to_x, to_y));
  }
  return static_cast<uint32_t>(own_first_[sheet] + (y - 1) * (n - 1) + x - 1);
}

Result<void> MeshExport::writeFaces(OutputFile& file) {
  if (format_.soup()) return {};
  ByteBuffer bytes;
  for (uint32_t sheet = 0; sheet < grid_.sheets(); ++sheet) {
    const ExportGrid& grid = gridOf(sheet);
    std::vector<uint32_t> above(grid.columns()), below(grid.columns());
    auto indexRow = [&](uint64_t y, std::vector<uint32_t>& row) {
      for (uint64_t x = 0; x < row.size(); ++x) row[x] = vertexIndex(sheet, x, y);
    };
    indexRow(0, above);
    for (uint64_t y = 0; y + 1 < grid.rows(); ++y) {
      indexRow(y + 1, below);
      for (size_t x = 0; x + 1 < above.size(); ++x) {
        if (hasTriangle(sheet, x, y, true)) format_.face({above[x], below[x + 1], above[x + 1], 0}, 3, bytes);
        if (hasTriangle(sheet, x, y, false)) format_.face({above[x], below[x], below[x + 1], 0}, 3, bytes);
      }
      std::swap(above, below);
      if (auto appended = file.append(bytes); !appended) return appended;
      bytes.clear();
      if (interrupted()) return interruption();
    }
    report(0.7 + 0.3 * sheet / grid_.sheets());
  }
  return {};
}

Result<void> MeshExport::write(OutputFile& file) {
  if (auto done = file.append(format_.head(facts_)); !done) return done;
  for (auto step : {&MeshExport::writeSheets, &MeshExport::writeShared, &MeshExport::writeFaces})
    if (auto done = (this->*step)(file); !done) return done;
  facts_.low = bounds_.low;
  facts_.high = bounds_.high;
  return file.writeAt(0, format_.head(facts_));
}

// The base mesh's patches as faces, its corners as vertices.
Result<void> writeBase(OutputFile& file, const BaseMesh& base, const MeshFormat& format, MeshFacts& facts) {
  std::vector<uint32_t> index(base.corners.size(), ~uint32_t{0});
  ByteBuffer vertices, faces;
  Bounds bounds;
  uint32_t next = 0;
  for (const auto& patch : base.patches) {
    std::array<glm::dvec3, 4> at{};
    for (size_t k = 0; k < 4; ++k) {
      const BaseCorner& c = base.corners[patch[k]];
      at[k] = c.position_mm;
      if (format.soup() || index[patch[k]] != ~uint32_t{0}) continue;
      index[patch[k]] = next++;
      format.vertex(facts, {at[k], c.normal, {}}, vertices);
      bounds.add(at[k]);
    }
    // Counter-clockwise seen from outside: (0,0), (0,1), (1,1), (1,0).
    const std::array<uint32_t, 4> quad{index[patch[0]], index[patch[2]], index[patch[3]], index[patch[1]]};
    if (format.soup()) {
      format.triangle(facts, {at[0], at[3], at[1]}, faces);
      format.triangle(facts, {at[0], at[2], at[3]}, faces);
    } else if (facts.corners == 4) {
      format.face(quad, 4, faces);
    } else {
      format.face({quad[0], quad[2], quad[3], 0}, 3, faces);
      format.face({quad[0], quad[1], quad[2], 0}, 3, faces);
    }
  }
  facts.low = bounds.low;
  facts.high = bounds.high;
  for (const ByteBuffer& part : {format.head(facts), vertices, faces})
    if (auto done = file.append(part); !done) return done;
  return {};
}

// Memory that grows with the mesh, or with the artwork's width.
Result<void> checkMemory(const ExportGrid& grid, const MeshDetail& detail, const MeshExportOptions& o, bool soup) {
  const bool many = grid.sheets() > 1;
  uint64_t bytes =
      SheetReader::bytes(grid, {.colours = !soup}) * (many ? static_cast<uint64_t>(workerCount(o.workers)) : 1);
  if (!grid.isFlat() && !soup)
    bytes += SharedVertices::count(*grid.manifest().base, detail.patches) * sizeof(SharedVertices::Vertex);
  if (many) bytes += grid.columns() * grid.rows() * 160;
  if (bytes <= o.memory_bytes) return {};
  return Error{ErrorKind::kUsage,
               o.output,
               "level " + std::to_string(grid.level()) + " takes " + std::to_string((bytes >> 20) + 1) +
                   " MiB of memory, --memory-mib allows " + std::to_string(o.memory_bytes >> 20),
               "allow more, or choose a coarser --level or an --error-mm",
               {}};
}

Result<void> checkDraco(const MeshFormat& format, const MeshFacts& facts, const MeshExportOptions& o) {
  if (o.draco_bits == 0) return {};
  if (!format.takesDraco())
    return Error{
        ErrorKind::kUsage, o.output, "only a .glb can be compressed by Draco", "leave out --draco, or name a .glb", {}};
  const uint64_t bytes = dracoBytes(facts);
  if (bytes <= o.memory_bytes) return {};
  return Error{ErrorKind::kUsage,
               o.output,
               "Draco takes some " + std::to_string((bytes >> 20) + 1) + " MiB of memory for " +
                   std::to_string(facts.faces) + " triangles, --memory-mib allows " +
                   std::to_string(o.memory_bytes >> 20),
               "allow more, or choose a coarser --level or an --error-mm",
               {}};
}
Result<void> compressIfAsked(OutputFile& file, const MeshFacts& facts, const MeshExportOptions& o,
                             MeshExportReport& report) {
  if (o.draco_bits == 0) return {};
  auto done = compressGlb(file, facts, o.draco_bits);
  if (!done) return done.error();
  report.vertices = done->vertices;
  report.draco_step = done->step;
  return {};
}

MeshFacts factsOf(const ExportGrid& grid, const MeshDetail& detail, const MeshFormat& format) {
  MeshFacts facts;
  facts.origin = grid.originMm();
  facts.extent = std::max(grid.extent(), 1e-12);
  facts.size_known = grid.manifest().size_known;
  facts.colours = !format.soup();
  facts.faces = detail.faces(grid);
  return facts;
}

Result<MeshExportReport> exportBase(const std::shared_ptr<const Package>& package, const MeshFormat& format,
                                    const MeshExportOptions& o) {
  const ExportGrid grid(package, 0);
  if (grid.isFlat())
    return Error{
        ErrorKind::kUsage, package->path(), "is a flat artwork, which has no base mesh", "leave out --base", {}};
  const BaseMesh& base = *package->manifest().base;
  MeshFacts facts = factsOf(grid, {}, format);
  facts.colours = false;
  const bool quads = format.quads() && !base.cut;
  facts.corners = quads ? 4 : 3;
  facts.faces = base.patches.size() * (quads ? 1 : 2);
  std::vector<bool> used(base.corners.size());
  for (const auto& patch : base.patches)
    for (const uint32_t corner : patch) used[corner] = true;
  facts.vertices = static_cast<uint64_t>(std::count(used.begin(), used.end(), true));
  facts.about = aboutText(*package, nullptr);
  if (auto good = format.check(o.output, facts); !good) return good.error();
  if (auto good = checkDraco(format, facts, o); !good) return good.error();
  auto file = OutputFile::create(o.output);
  if (!file) return file.error();
  if (auto done = writeBase(*file, base, format, facts); !done) return done.error();
  MeshExportReport report;
  report.vertices = facts.vertices;
  if (auto done = compressIfAsked(*file, facts, o, report); !done) return done.error();
  const uint64_t bytes = file->size();
  if (auto done = file->commit(); !done) return done.error();
  report.faces = facts.faces;
  report.file_bytes = bytes;
  report.quads = quads;
  report.from_origin = countsFromOrigin(facts);
  report.origin_mm = facts.origin;
  return report;
}

}  // namespace

Result<MeshExportReport> exportMesh(std::shared_ptr<const Package> package, const MeshExportOptions& o) {
  auto format = meshFormatOf(o.output);
  if (!format) return format.error();
  if (o.maps_px > 0) {
    if ((*format)->holdsMaps()) return exportTexturedGlb(package, o);
    return Error{ErrorKind::kUsage, o.output, "only a .glb holds maps", "leave out --maps, or name a .glb", {}};
  }
  if (o.base) return exportBase(package, **format, o);
  auto detail = chooseDetail(package, o.level, o.error_mm, o.interrupted);
  if (!detail) return detail.error();
  const ExportGrid grid(package, detail->level);
  MeshFacts facts = factsOf(grid, *detail, **format);
  const bool soup = (*format)->soup();
  if (!soup) facts.vertices = detail->vertices(grid);
  if (auto good = (*format)->check(o.output, facts); !good) return good.error();
  if (auto good = checkMemory(grid, *detail, o, soup); !good) return good.error();
  if (auto good = checkDraco(**format, facts, o); !good) return good.error();
  auto coarser = ExportGrid(grid, std::max(detail->level - 1, 0)).errorBound(o.interrupted);
  if (!coarser) return coarser.error();
  facts.about = aboutText(*package, &*detail);
  MeshExport mesh(grid, *detail, **format, o, facts);
  auto file = OutputFile::create(o.output);
  if (!file) return file.error();
  if (auto done = mesh.write(*file); !done) return done.error();
  MeshExportReport report;
  report.vertices = mesh.facts().vertices;
  if (auto done = compressIfAsked(*file, mesh.facts(), o, report); !done) return done.error();
  const uint64_t bytes = file->size();
  if (auto done = file->commit(); !done) return done.error();
  report.least_level = detail->least_level;
  report.level = detail->level;
  report.faces = facts.faces;
  report.file_bytes = bytes;
  report.error_mm = detail->error_mm;
  if (detail->level > 0) report.coarser_error_mm = *coarser;
  report.from_origin = countsFromOrigin(facts);
  report.origin_mm = facts.origin;
  return report;
}

}  // namespace relievo
