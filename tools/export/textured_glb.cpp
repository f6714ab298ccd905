#include "tools/export/textured_glb.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "src/base/file.h"
#include "src/base/parallel_for.h"
#include "texturing/import/image_io_module.h"
#include "texturing/import/png_encoder.h"
#include "tools/export/map_atlas.h"
#include "tools/export/mesh_detail.h"
#include "tools/export/mesh_format_glb.h"
#include "tools/export/shared_vertices.h"
#include "tools/export/surface_normals.h"

namespace relievo {
namespace {

class BytesInMemory final : public ImageBytes {
 public:
  Result<void> write(uint64_t offset, std::span<const uint8_t> from) override {
    bytes.resize(std::max<size_t>(bytes.size(), offset + from.size()));
    std::copy(from.begin(), from.end(), bytes.begin() + static_cast<ptrdiff_t>(offset));
    return {};
  }
  Result<void> read(uint64_t offset, std::span<uint8_t> out) override {
    std::copy_n(bytes.begin() + static_cast<ptrdiff_t>(offset), out.size(), out.begin());
    return {};
  }
  uint64_t size() const override { return bytes.size(); }
  ByteBuffer bytes;
};

// One patch's vertices, row by row, as its sides show them.
struct PatchGrid {
  PatchLevels levels;
  std::vector<SheetRow> rows;
  std::vector<std::vector<glm::dvec3>> normals;  // sums of the patch's own triangles' (surface_normals.h)
  bool onBorder(uint64_t x, uint64_t y) const { return x == 0 || y == 0 || x == levels.cells() || y == levels.cells(); }
  // Is it a vertex of the mesh, not one that a side has moved?
  bool isVertex(uint64_t x, uint64_t y) const {
    return !onBorder(x, y) || levels.snapped(x, y) == std::array<uint64_t, 2>{x, y};
  }

  Result<void> read(SheetReader& reader, uint32_t patch, const PatchLevels& of_patch) {
    levels = of_patch;
    const uint64_t n = levels.cells();
    rows.resize(n + 1);
    normals.assign(n + 1, std::vector<glm::dvec3>(n + 1, glm::dvec3(0)));
    reader.begin(patch);
    for (uint64_t y = 0; y <= n; ++y)
      if (auto read = reader.read(y, rows[y]); !read) return read;
    // What vertices move to does not move.
    for (uint64_t y = 0; y <= n; ++y)
      for (uint64_t x = 0; x <= n; x += y == 0 || y == n ? 1 : n) {
        const auto [to_x, to_y] = levels.snapped(x, y);
        rows[y].positions[x] = rows[to_y].positions[to_x];
        if (!rows[y].heights.empty()) rows[y].heights[x] = rows[to_y].heights[to_x];
      }
    for (uint64_t y = 0; y < n; ++y) addCrosses(rows[y], rows[y + 1], normals[y], normals[y + 1]);
    return {};
  }
};

// Axes in which a normal map's texels are stated: x along the tangent, z along the normal.
struct Frame {
  glm::dvec3 normal, tangent;
  glm::vec3 inFrame(const glm::dvec3& n) const {
    const glm::dmat3 axes(tangent, glm::cross(normal, tangent), normal);
    if (!(std::abs(glm::determinant(axes)) > 1e-9)) return {0, 0, 1};
    glm::dvec3 in = glm::inverse(axes) * n;
    in.z = std::max(in.z, 0.0);
    const double length = glm::length(in);
    return length > 0 ? glm::vec3(in / length) : glm::vec3(0, 0, 1);
  }
};

class TexturedGlb {
 public:
  TexturedGlb(const ExportGrid& grid, const MeshDetail& detail, const MapAtlas& atlas, const MeshExportOptions& options)
      : grid_(grid),
        base_(*grid.manifest().base),
        patches_(detail.patches),
        atlas_(atlas),
        options_(options),
        shared_(base_, detail.patches) {
    for (int level = 0; level <= detail.level; ++level) grids_.emplace_back(grid, level);
    const size_t pixels = 3 * static_cast<size_t>(atlas.width()) * static_cast<size_t>(atlas.height());
    colours_.resize(pixels);
    if (atlas.hasNormals()) normals_.resize(pixels);
    facts_.origin = grid.originMm();
    facts_.extent = std::max(grid.extent(), 1e-12);
    facts_.size_known = grid.manifest().size_known;
    facts_.colours = false;
    facts_.faces = detail.faces(grid);
    facts_.about = aboutText(grid.package(), &detail);
    facts_.low = glm::vec3(3e38f), facts_.high = glm::vec3(-3e38f);
    first_.assign(1, 0);
    for (const PatchLevels& p : patches_) {
      uint64_t vertices = p.ownVertices() + 4;
      for (const uint8_t side : p.sides) vertices += (uint64_t{1} << side) - 1;
      first_.push_back(first_.back() + vertices);
    }
    facts_.vertices = first_.back();
  }
  const MeshFacts& facts() const { return facts_; }

  Result<void> write(OutputFile& file) {
    if (auto done = file.append(glbHead(facts_, maps_)); !done) return done;
    if (auto done = sumShared(); !done) return done;
    if (auto done = writeVertices(file); !done) return done;
    if (auto done = writeFaces(file); !done) return done;
    if (auto done = writeImage(file, colours_, maps_.colour_bytes); !done) return done;
    if (!normals_.empty())
      if (auto done = writeImage(file, normals_, maps_.normal_bytes); !done) return done;
    return file.writeAt(0, glbHead(facts_, maps_));
  }

 private:
  struct Output {
    struct Border {
      uint64_t index;
      glm::vec3 normal;
      uint16_t height;
    };
    std::vector<Border> border;
    ByteBuffer bytes;
    glm::vec3 low{3e38f}, high{-3e38f};
    std::optional<Error> error;
  };
  struct Worker {
    std::optional<SheetReader> reader;
    int level = -1;
    PatchGrid grid;
    PageDecoder decoder;
    MapAtlas::Texels texels;
  };
  const ExportGrid& gridOf(uint32_t patch) const { return grids_[patches_[patch].grid]; }
  Error interruption() const { return {ErrorKind::kInterrupted, options_.output, "interrupted", "", {}}; }
  void report(double share) const {
    if (options_.progress) options_.progress(share);
  }

  Result<void> readGrid(Worker& w, uint32_t patch) const {
    if (w.level != patches_[patch].grid) w.reader.emplace(gridOf(patch), RowParts{.colours = false});
    w.level = patches_[patch].grid;
    return w.grid.read(*w.reader, patch, patches_[patch]);
  }

  // Calls make(worker, patch, output) for all patches at once, then take(output) for one after the other.
  template <class Make, class Take>
  Result<void> forPatches(double from, double to, Make make, Take take) {
    constexpr uint32_t kAtOnce = 64;
    const auto count = static_cast<uint32_t>(patches_.size());
    for (uint32_t first = 0; first < count; first += kAtOnce) {
      std::vector<Output> outputs(std::min(kAtOnce, count - first));
      const bool whole = parallelForWith(
          outputs.size(), options_.workers, options_.interrupted, [] { return Worker(); },
          [&](Worker& w, size_t i) {
            if (auto made = make(w, first + static_cast<uint32_t>(i), outputs[i]); !made)
              outputs[i].error = made.error();
          });
      if (!whole) return interruption();
      for (Output& out : outputs) {
        if (out.error) return *out.error;
        if (auto taken = take(out); !taken) return taken;
      }
      report(from + (to - from) * first / count);
    }
    return {};
  }

  Result<void> sumShared() {
    return forPatches(
        0, 0.3,
        [&](Worker& w, uint32_t patch, Output& out) -> Result<void> {
          if (auto read = readGrid(w, patch); !read) return read;
          const PatchGrid& g = w.grid;
          const uint64_t n = g.levels.cells();
          for (uint64_t y = 0; y <= n; ++y)
            for (uint64_t x = 0; x <= n; x += y == 0 || y == n ? 1 : n) {
              const auto [to_x, to_y] = g.levels.snapped(x, y);
              out.border.push_back({shared_.index(patch, to_x, to_y), glm::vec3(g.normals[y][x]),
                                    g.rows[y].heights.empty() ? uint16_t{0} : g.rows[y].heights[x]});
            }
          return {};
        },
        [&](const Output& out) -> Result<void> {
          for (const Output::Border& b : out.border)
            if (!shared_.add(b.index, b.normal, b.height, {}))
              return Error{ErrorKind::kInvalidData,
                           grid_.package().path(),
                           "expected the same height from all patches that share a vertex, found others",
                           "rebuild the package",
                           {}};
          return {};
        });
  }

  // Of the mesh's vertices in the grid.
  std::vector<Frame> framesOf(const PatchGrid& g, uint32_t patch) const {
    const uint64_t n = g.levels.cells(), row = n + 1;
    std::vector<Frame> frames(row * row);
    const auto& c = base_.patches[patch];
    const auto corner = [&](size_t k) { return glm::dvec3(base_.corners[c[k]].position_mm); };
    for (uint64_t y = 0; y <= n; ++y)
      for (uint64_t x = 0; x <= n; ++x) {
        if (!g.isVertex(x, y)) continue;
        const glm::dvec3 sum =
            g.onBorder(x, y) ? glm::dvec3(shared_[shared_.index(patch, x, y)].normal) : g.normals[y][x];
        const glm::dvec3 normal = unitNormal(sum, gridOf(patch).ray(patch, x, y).along);
        const double v = static_cast<double>(y) / static_cast<double>(n);
        const glm::dvec3 along = glm::mix(corner(1) - corner(0), corner(3) - corner(2), v);
        glm::dvec3 tangent = along - glm::dot(along, normal) * normal;
        if (!(glm::length(tangent) > 1e-9 * glm::length(along)))
          tangent = glm::cross(normal, std::abs(normal.x) < 0.6 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
        // As the file has them.
        frames[y * row + x] = {glm::dvec3(glm::vec3(normal)), glm::dvec3(glm::vec3(glm::normalize(tangent)))};
      }
    return frames;
  }
  // At the centres of a tile's texels, each on the triangle of the mesh that shows it.
  static std::vector<Frame> framesOfTexels(const PatchLevels& levels, const std::vector<Frame>& frames, int side) {
    const uint64_t n = levels.cells();
    std::vector<Frame> out(static_cast<size_t>(side) * static_cast<size_t>(side));
    const double px_per_cell = static_cast<double>(side) / static_cast<double>(n);
    auto show = [&](const std::array<std::array<uint64_t, 2>, 3>& corners) {
      std::array<glm::dvec2, 3> at;
      std::array<const Frame*, 3> frame;
      for (size_t k = 0; k < 3; ++k) {
        const auto [x, y] = levels.snapped(corners[k][0], corners[k][1]);
        at[k] = px_per_cell * glm::dvec2(static_cast<double>(x), static_cast<double>(y));
        frame[k] = &frames[y * (n + 1) + x];
      }
      const glm::dvec2 e = at[1] - at[0], f = at[2] - at[0];
      const double det = e.x * f.y - e.y * f.x;
      if (det == 0) return;
      const glm::dvec2 low = glm::min(glm::min(at[0], at[1]), at[2]), high = glm::max(glm::max(at[0], at[1]), at[2]);
      for (int y = static_cast<int>(low.y); y < std::min(static_cast<int>(high.y) + 1, side); ++y)
        for (int x = static_cast<int>(low.x); x < std::min(static_cast<int>(high.x) + 1, side); ++x) {
          constexpr double kOnEdge = -1e-9;
          const glm::dvec2 p = glm::dvec2(x + 0.5, y + 0.5) - at[0];
          const double to_e = (p.x * f.y - p.y * f.x) / det, to_f = (e.x * p.y - e.y * p.x) / det,
                       stays = 1 - to_e - to_f;
          if (to_e < kOnEdge || to_f < kOnEdge || stays < kOnEdge) continue;
          out[static_cast<size_t>(y * side + x)] = {
              stays * frame[0]->normal + to_e * frame[1]->normal + to_f * frame[2]->normal,
              stays * frame[0]->tangent + to_e * frame[1]->tangent + to_f * frame[2]->tangent};
        }
    };
    for (uint64_t y = 0; y < n; ++y)
      for (uint64_t x = 0; x < n; ++x) {
        if (levels.hasTriangle(x, y, true)) show({{{x, y}, {x + 1, y}, {x + 1, y + 1}}});
        if (levels.hasTriangle(x, y, false)) show({{{x, y}, {x, y + 1}, {x + 1, y + 1}}});
      }
    return out;
  }

  Result<void> fillTile(Worker& w, uint32_t patch, const std::vector<Frame>& frames) {
    if (auto read = atlas_.read(patch, w.decoder, w.texels); !read) return read;
    const MapAtlas::Tile& tile = atlas_.tile(patch);
    std::vector<Frame> of_texels;
    if (!normals_.empty()) of_texels = framesOfTexels(patches_[patch], frames, tile.side);
    const auto inside = [&](int i) { return std::clamp(i - MapAtlas::kBorder, 0, tile.side - 1); };
    for (int y = 0; y < w.texels.side; ++y) {
      const auto row = static_cast<size_t>(tile.y - MapAtlas::kBorder + y) * static_cast<size_t>(atlas_.width());
      for (int x = 0; x < w.texels.side; ++x) {
        const auto at = static_cast<size_t>(y * w.texels.side + x),
                   to = 3 * (row + static_cast<size_t>(tile.x - MapAtlas::kBorder + x));
        std::copy_n(w.texels.colours[at].begin(), 3, colours_.begin() + static_cast<ptrdiff_t>(to));
        if (normals_.empty()) continue;
        const Frame& frame = of_texels[static_cast<size_t>(inside(y) * tile.side + inside(x))];
        const glm::vec3 n = frame.inFrame(w.texels.normals[at]);
        for (glm::length_t c = 0; c < 3; ++c)
          normals_[to + static_cast<size_t>(c)] = static_cast<uint8_t>(std::lround(127.5f * n[c] + 127.5f));
      }
    }
    return {};
  }

  Result<void> writeVertices(OutputFile& file) {
    return forPatches(
        0.3, 0.8,
        [&](Worker& w, uint32_t patch, Output& out) -> Result<void> {
          if (auto read = readGrid(w, patch); !read) return read;
          const PatchGrid& g = w.grid;
          const uint64_t n = g.levels.cells();
          const std::vector<Frame> frames = framesOf(g, patch);
          const MapAtlas::Tile& tile = atlas_.tile(patch);
          for (uint64_t y = 0; y <= n; ++y)
            for (uint64_t x = 0; x <= n; ++x) {
              if (!g.isVertex(x, y)) continue;
              const glm::vec3 position(g.rows[y].positions[x]);
              const Frame& frame = frames[y * (n + 1) + x];
              const auto uv = [&](int first, uint64_t i, int size) {
                return static_cast<float>((first + tile.side * static_cast<double>(i) / static_cast<double>(n)) / size);
              };
              put(out.bytes, position);
              put(out.bytes, glm::vec3(frame.normal));
              put(out.bytes, glm::vec4(glm::vec3(frame.tangent), 1));
              put(out.bytes, glm::vec2(uv(tile.x, x, atlas_.width()), uv(tile.y, y, atlas_.height())));
              out.low = glm::min(out.low, position), out.high = glm::max(out.high, position);
            }
          return fillTile(w, patch, frames);
        },
        [&](const Output& out) {
          facts_.low = glm::min(facts_.low, out.low), facts_.high = glm::max(facts_.high, out.high);
          return file.append(out.bytes);
        });
  }

  Result<void> writeFaces(OutputFile& file) {
    ByteBuffer bytes;
    std::vector<uint32_t> number;
    for (uint32_t patch = 0; patch < patches_.size(); ++patch) {
      const PatchLevels& p = patches_[patch];
      const PatchGrid g{.levels = p, .rows = {}, .normals = {}};
      const uint64_t n = p.cells(), row = n + 1;
      number.assign(row * row, 0);
      auto next = static_cast<uint32_t>(first_[patch]);
      for (uint64_t y = 0; y <= n; ++y)
        for (uint64_t x = 0; x <= n; ++x)
          if (g.isVertex(x, y)) number[y * row + x] = next++;
      const auto of = [&](uint64_t x, uint64_t y) {
        const auto [to_x, to_y] = p.snapped(x, y);
        return number[to_y * row + to_x];
      };
      for (uint64_t y = 0; y < n; ++y)
        for (uint64_t x = 0; x < n; ++x)
          for (const bool above : {true, false}) {
            if (!p.hasTriangle(x, y, above)) continue;
            put(bytes, of(x, y));
            put(bytes, above ? of(x + 1, y + 1) : of(x, y + 1));
            put(bytes, above ? of(x + 1, y) : of(x + 1, y + 1));
          }
      if (auto appended = file.append(bytes); !appended) return appended;
      bytes.clear();
      if (options_.interrupted && options_.interrupted->load(std::memory_order_relaxed)) return interruption();
    }
    report(0.85);
    return {};
  }

  Result<void> writeImage(OutputFile& file, const std::vector<uint8_t>& pixels, uint64_t& png_bytes) {
    BytesInMemory png;
    const ImageEncoding encoding{
        .path = options_.output, .width = atlas_.width(), .height = atlas_.height(), .channels = 3};
    auto encoder = createPngEncoder(encoding, png);
    if (!encoder) return encoder.error();
    constexpr int64_t kRows = 64;
    for (int64_t y = 0; y < encoding.height; y += kRows) {
      const int64_t rows = std::min(kRows, encoding.height - y);
      if (auto done = (*encoder)->appendRows(rows, pixels.data() + 3 * y * encoding.width); !done) return done;
      if (options_.interrupted && options_.interrupted->load(std::memory_order_relaxed)) return interruption();
    }
    if (auto done = (*encoder)->finish(); !done) return done;
    png_bytes = png.bytes.size();
    png.bytes.resize((png_bytes + 3) / 4 * 4, 0);
    return file.append(png.bytes);
  }

  const ExportGrid& grid_;  // the finest
  const BaseMesh& base_;
  const std::vector<PatchLevels>& patches_;
  const MapAtlas& atlas_;
  const MeshExportOptions& options_;
  std::vector<ExportGrid> grids_;  // by level
  SharedVertices shared_;
  MeshFacts facts_;
  GlbMaps maps_;
  std::vector<uint64_t> first_;  // of each patch's vertices
  std::vector<uint8_t> colours_, normals_;
};

// Of what grows with the artwork.
Result<void> checkMapsMemory(const ExportGrid& grid, const MeshDetail& detail, const MapAtlas& atlas,
                             const MeshExportOptions& o) {
  constexpr uint64_t kVertexBytes = 200;  // of a patch's grid and its frames
  constexpr uint64_t kPixelBytes = 12;    // both images, and one as a PNG
  const uint64_t n = grid.cellsPerPatchSide() + 1, workers = static_cast<uint64_t>(workerCount(o.workers));
  const uint64_t bytes = workers * (SheetReader::bytes(grid, {.colours = false}) + n * n * kVertexBytes) +
                         kPixelBytes * static_cast<uint64_t>(atlas.width()) * static_cast<uint64_t>(atlas.height()) +
                         TexturePages::bytes(grid.manifest()) +
                         SharedVertices::count(*grid.manifest().base, detail.patches) * sizeof(SharedVertices::Vertex);
  if (bytes <= o.memory_bytes) return {};
  return Error{ErrorKind::kUsage,
               o.output,
               "level " + std::to_string(grid.level()) + " with maps takes " + std::to_string((bytes >> 20) + 1) +
                   " MiB of memory, --memory-mib allows " + std::to_string(o.memory_bytes >> 20),
               "allow more, or choose a coarser --level, an --error-mm, or smaller --maps",
               {}};
}

}  // namespace

Result<MeshExportReport> exportTexturedGlb(const std::shared_ptr<const Package>& package, const MeshExportOptions& o) {
  if (package->manifest().domain.isFlat())
    return Error{ErrorKind::kUsage,
                 package->path(),
                 "is a flat artwork, whose maps are images of their own",
                 "--map albedo and --map normal write them",
                 {}};
  auto detail = chooseDetail(package, o.level, o.error_mm, o.interrupted);
  if (!detail) return detail.error();
  auto atlas = MapAtlas::create(package, o.maps_px);
  if (!atlas) return atlas.error();
  const ExportGrid grid(package, detail->level);
  if (auto good = checkMapsMemory(grid, *detail, *atlas, o); !good) return good.error();
  TexturedGlb glb(grid, *detail, *atlas, o);
  if (auto good = makeGlbFormat()->check(o.output, glb.facts()); !good) return good.error();
  auto file = OutputFile::create(o.output);
  if (!file) return file.error();
  if (auto done = glb.write(*file); !done) return done.error();
  MeshExportReport report;
  report.file_bytes = file->size();
  if (auto done = file->commit(); !done) return done.error();
  report.vertices = glb.facts().vertices;
  report.faces = glb.facts().faces;
  report.least_level = detail->least_level;
  report.level = detail->level;
  report.error_mm = detail->error_mm;
  report.from_origin = countsFromOrigin(glb.facts());
  report.origin_mm = glb.facts().origin;
  report.maps_px = {atlas->width(), atlas->height()};
  return report;
}

}  // namespace relievo
