#include "tools/sample/sample_writer.h"

#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/parallel_for.h"
#include "src/base/progress.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "tools/sample/sample_shading.h"

namespace relievo {
namespace {

constexpr int64_t kBandPx =
    int64_t{8} << 20;  // a band's pixels: 8 Mi * (4 + 4 + 4 + 3 ... bytes) stays far below 1 GiB
constexpr int64_t kShadowPx = int64_t{4096} * 4096;  // a larger artwork casts shadows from a subsampled relief
constexpr int64_t kPngPx = int64_t{64} << 20;
constexpr int64_t kMaxTriangles = 4'000'000;

struct Job {
  const SampleArtwork& artwork;
  const SampleWriteOptions& options;
  int64_t width, height;
  std::vector<std::string> files;  // relative to the folder

  bool stopped() const { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); }
  std::string path(const std::string& name) const { return (std::filesystem::path(options.folder) / name).string(); }
  Error interruption() const {
    return Error{.kind = ErrorKind::kInterrupted,
                 .file = options.folder,
                 .message = "interrupted",
                 .hint = "files that were complete are kept"};
  }
};

// f(rect, out) fills a rectangle, channels interleaved; here a band, its columns shared out over the cores.
template <class T>
void fillBand(const Rect& band, size_t channels, std::vector<T>& out,
              const std::function<void(const Rect&, std::span<T>)>& f) {
  out.resize(static_cast<size_t>(band.width * band.height) * channels);
  const auto cores = static_cast<int64_t>(workerCount(0));
  const int64_t chunk = std::max<int64_t>(512, (band.width / cores + 63) / 64 * 64);
  if (chunk >= band.width) return f(band, out);
  const size_t chunks = static_cast<size_t>((band.width + chunk - 1) / chunk);
  parallelFor(chunks, static_cast<int>(chunks), nullptr, [&](size_t i) {
    const int64_t x = static_cast<int64_t>(i) * chunk;
    Rect part{band.x + x, band.y, std::min(chunk, band.width - x), band.height};
    const size_t row = static_cast<size_t>(part.width) * channels;
    std::vector<T> local(row * static_cast<size_t>(part.height));
    f(part, local);
    for (int64_t y = 0; y < part.height; ++y)
      std::copy_n(local.data() + static_cast<size_t>(y) * row, row,
                  out.data() + static_cast<size_t>(y * band.width + x) * channels);
  });
}

int64_t bandRows(int64_t width) {
  int64_t rows = std::max<int64_t>(1, kBandPx / width);
  return std::min<int64_t>(512, rows >= 64 ? rows / 64 * 64 : rows);
}

// f(band) over the artwork, with a line of progress.
Result<void> forBands(Job& job, const std::string& label, const std::function<Result<void>(const Rect&)>& f) {
  ProgressLine progress(label);
  const int64_t rows = bandRows(job.width);
  for (int64_t y = 0; y < job.height; y += rows) {
    if (job.stopped()) return job.interruption();
    Rect band{0, y, job.width, std::min(rows, job.height - y)};
    if (auto done = f(band); !done) return done;
    progress.update(static_cast<double>(y + band.height) / static_cast<double>(job.height),
                    std::to_string(y + band.height) + " rows");
  }
  return {};
}

Result<void> writeHeights(Job& job) {
  auto exact = ImageWriter::create(job.path("height_float.tif"), job.width, job.height, 1, SampleType::kFloat);
  if (!exact) return exact.error();
  auto coarse = ImageWriter::create(job.path("height_16.tif"), job.width, job.height, 1, SampleType::kUint16);
  if (!coarse) return coarse.error();
  const double lo = job.artwork.minMm(), step = 65535.0 / (job.artwork.maxMm() - lo);
  std::vector<float> mm;
  std::vector<uint16_t> steps;
  auto done = forBands(job, "height", [&](const Rect& band) -> Result<void> {
    fillBand<float>(band, 1, mm, [&](const Rect& r, std::span<float> out) { job.artwork.heights(r, out); });
    steps.resize(mm.size());
    for (size_t i = 0; i < mm.size(); ++i)
      steps[i] = static_cast<uint16_t>(std::clamp((mm[i] - lo) * step + 0.5, 0.0, 65535.0));
    if (auto wrote = (*exact)->appendRows(band.height, mm.data()); !wrote) return wrote;
    return (*coarse)->appendRows(band.height, steps.data());
  });
  if (!done) return done;
  if (auto kept = (*exact)->commit(); !kept) return kept;
  if (auto kept = (*coarse)->commit(); !kept) return kept;
  job.files.insert(job.files.end(), {"height_float.tif", "height_16.tif"});
  return {};
}

Result<void> writeRgb(Job& job, const std::string& stem,
                      const std::function<void(const Rect&, std::span<uint8_t>)>& f) {
  const std::string name =
      stem + (job.width * job.height <= kPngPx && std::max(job.width, job.height) <= 65500 ? ".png" : ".tif");
  auto writer = ImageWriter::create(job.path(name), job.width, job.height, 3, SampleType::kUint8);
  if (!writer) return writer.error();
  std::vector<uint8_t> rgb;
  auto done = forBands(job, stem, [&](const Rect& band) -> Result<void> {
    fillBand<uint8_t>(band, 3, rgb, f);
    return (*writer)->appendRows(band.height, rgb.data());
  });
  if (!done) return done;
  if (auto kept = (*writer)->commit(); !kept) return kept;
  job.files.push_back(name);
  return {};
}

Result<void> writePtmFile(Job& job, Basis basis, const std::string& name) {
  auto source = job.artwork.ptmSource(basis);
  if (auto wrote = writePtm(job.path(name), *source, job.options.interrupted); !wrote) return wrote;
  job.files.push_back(name);
  return {};
}

// What a photograph needs of some rows, kept for all lights where the artwork is small.
struct PhotoRows {
  Rect rect;
  std::vector<float> normals, cavity, gloss;
  std::vector<uint8_t> albedo;
};

void fillPhotoRows(const SampleArtwork& artwork, const Rect& band, PhotoRows& out) {
  out.rect = band;
  fillBand<float>(band, 3, out.normals, [&](const Rect& r, std::span<float> o) { artwork.normals(r, o); });
  fillBand<uint8_t>(band, 3, out.albedo, [&](const Rect& r, std::span<uint8_t> o) { artwork.albedo(r, o); });
  const auto n = static_cast<size_t>(band.width * band.height);
  out.cavity.resize(n);
  out.gloss.resize(n);
  artwork.material(band, out.cavity, out.gloss);
}

struct ShadowGrid {
  int64_t step = 1, width = 0, height = 0;
  std::vector<float> heights;
};

void shadeRows(const SampleArtwork& artwork, const PhotoRows& rows, const ShadowGrid& grid,
               const std::vector<uint8_t>& lit, const sample::Vec3& light, std::vector<uint8_t>& out) {
  out.resize(rows.albedo.size());
  const float lx = static_cast<float>(light[0]), ly = static_cast<float>(light[1]), lz = static_cast<float>(light[2]);
  const float inv_h = 1.0f / std::sqrt(lx * lx + ly * ly + (lz + 1) * (lz + 1));
  const float hx = lx * inv_h, hy = ly * inv_h, hz = (lz + 1) * inv_h;
  const auto strength = static_cast<float>(artwork.glossStrength()), ambient = static_cast<float>(sample::kAmbient);
  const bool sharp = strength > 0.5f;
  auto shadeRange = [&](int64_t y0, int64_t y1) {
    std::vector<float> shadow(static_cast<size_t>(rows.rect.width));
    for (int64_t y = y0; y < y1; ++y) {
      // Bilinear between the grid's samples, which are every step-th pixel.
      const int64_t py = rows.rect.y + y, gy = py / grid.step, gy1 = std::min(gy + 1, grid.height - 1);
      const float fy = static_cast<float>(py % grid.step) / static_cast<float>(grid.step);
      for (int64_t x = 0; x < rows.rect.width; ++x) {
        const int64_t gx = x / grid.step, gx1 = std::min(gx + 1, grid.width - 1);
        const float fx = static_cast<float>(x % grid.step) / static_cast<float>(grid.step);
        auto at = [&](int64_t i, int64_t j) {
          return static_cast<float>(lit[static_cast<size_t>(j * grid.width + i)]);
        };
        float v = at(gx, gy);
        if (grid.step > 1)
          v = (v * (1 - fx) + at(gx1, gy) * fx) * (1 - fy) + (at(gx, gy1) * (1 - fx) + at(gx1, gy1) * fx) * fy;
        shadow[static_cast<size_t>(x)] = v * (1.0f / 255.0f);
      }
      for (int64_t x = 0; x < rows.rect.width; ++x) {
        const auto i = static_cast<size_t>(y * rows.rect.width + x);
        const float* n = rows.normals.data() + 3 * i;
        float lambert = std::max(0.0f, n[0] * lx + n[1] * ly + n[2] * lz);
        float s = std::max(0.0f, n[0] * hx + n[1] * hy + n[2] * hz);
        s *= s, s *= s, s *= s;    // ^8
        if (sharp) s = s * s * s;  // ^24
        const float sg = strength * rows.gloss[i], open = shadow[static_cast<size_t>(x)];
        float k = rows.cavity[i] * ((1 - sg) * (ambient + (1 - ambient) * lambert * open) + sg * s * open);
        for (size_t c = 0; c < 3; ++c)
          out[3 * i + c] =
              static_cast<uint8_t>(std::min(255.0f, static_cast<float>(rows.albedo[3 * i + c]) * k + 0.5f));
      }
    }
  };
  const int64_t half = rows.rect.height / 2;
  parallelFor(2, 2, nullptr,
              [&](size_t part) { shadeRange(part == 0 ? 0 : half, part == 0 ? half : rows.rect.height); });
}

Result<void> writePhotos(Job& job) {
  std::error_code bad;
  std::filesystem::create_directories(job.path("photos"), bad);
  const auto lights = sample::domeLights(job.options.lights);
  const bool small = job.width * job.height <= kShadowPx;
  // The relief that casts shadows: all of it, or every step-th sample.
  ShadowGrid grid;
  while (((job.width + grid.step - 1) / grid.step) * ((job.height + grid.step - 1) / grid.step) > kShadowPx)
    ++grid.step;
  grid.width = (job.width + grid.step - 1) / grid.step, grid.height = (job.height + grid.step - 1) / grid.step;
  grid.heights.resize(static_cast<size_t>(grid.width * grid.height));
  {
    std::vector<float> mm;
    auto done = forBands(job, "shadows", [&](const Rect& band) -> Result<void> {
      fillBand<float>(band, 1, mm, [&](const Rect& r, std::span<float> out) { job.artwork.heights(r, out); });
      for (int64_t y = (band.y + grid.step - 1) / grid.step * grid.step; y < band.y + band.height; y += grid.step)
        for (int64_t x = 0; x < grid.width; ++x)
          grid.heights[static_cast<size_t>(y / grid.step * grid.width + x)] =
              mm[static_cast<size_t>((y - band.y) * job.width + x * grid.step)];
      return {};
    });
    if (!done) return done;
  }
  const std::string extension = std::max(job.width, job.height) <= 65500 ? ".jpg" : ".tif";
  std::string list = std::to_string(lights.size()) + "\n";
  PhotoRows kept;
  const Rect all{0, 0, job.width, job.height};
  if (small) fillPhotoRows(job.artwork, all, kept);
  std::vector<uint8_t> pixels;
  ProgressLine progress("photos");
  for (size_t k = 0; k < lights.size(); ++k) {
    char name[48], line[160];
    std::snprintf(name, sizeof name, "light_%03d%s", static_cast<int>(k + 1), extension.c_str());
    std::snprintf(line, sizeof line, "%s %.9f %.9f %.9f\n", name, lights[k][0], lights[k][1], lights[k][2]);
    list += line;
    const std::string file = std::string("photos/") + name;
    const auto lit = castShadows(grid.heights, grid.width, grid.height,
                                 job.artwork.mmPerPx() * static_cast<double>(grid.step), lights[k]);
    auto writer = ImageWriter::create(job.path(file), job.width, job.height, 3, SampleType::kUint8);
    if (!writer) return writer.error();
    const int64_t rows = small ? job.height : std::max<int64_t>(1, std::min<int64_t>(256, (kBandPx / 2) / job.width));
    for (int64_t y = 0; y < job.height; y += rows) {
      if (job.stopped()) return job.interruption();
      if (!small) fillPhotoRows(job.artwork, {0, y, job.width, std::min(rows, job.height - y)}, kept);
      shadeRows(job.artwork, kept, grid, lit, lights[k], pixels);
      if (auto wrote = (*writer)->appendRows(kept.rect.height, pixels.data()); !wrote) return wrote;
      progress.update(
          (static_cast<double>(k) + static_cast<double>(y + kept.rect.height) / static_cast<double>(job.height)) /
              static_cast<double>(lights.size()),
          name);
    }
    if (auto done = (*writer)->commit(); !done) return done;
    job.files.push_back(file);
  }
  const std::span<const uint8_t> bytes(reinterpret_cast<const uint8_t*>(list.data()), list.size());
  if (auto wrote = writeFile(job.path("photos/lights.lp"), bytes); !wrote) return wrote;
  job.files.push_back("photos/lights.lp");
  return {};
}

struct MeshGrid {
  int64_t step = 1, columns = 1, rows = 1;
  int64_t triangles() const { return 2 * (columns - 1) * (rows - 1); }
};
MeshGrid meshGrid(int64_t width, int64_t height) {
  MeshGrid g;
  for (g.step = 1;; ++g.step) {
    g.columns = (width - 1 + g.step - 1) / g.step + 1, g.rows = (height - 1 + g.step - 1) / g.step + 1;
    if (g.triangles() <= kMaxTriangles) return g;
  }
}

Result<void> writeMesh(Job& job) {
  static_assert(std::endian::native == std::endian::little, "PLY is written as it lies in memory");
  const MeshGrid g = meshGrid(job.width, job.height);
  auto file = OutputFile::create(job.path("mesh.ply"));
  if (!file) return file.error();
  const std::string header = "ply\nformat binary_little_endian 1.0\ncomment relievo sample " +
                             std::string(sampleKindName(job.artwork.options().kind)) +
                             ", mm, z towards the viewer, y up\nelement vertex " + std::to_string(g.columns * g.rows) +
                             "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty "
                             "uchar green\nproperty uchar blue\n" +
                             (job.options.mesh_uv ? "property float s\nproperty float t\n" : "") + "element face " +
                             std::to_string(g.triangles()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  if (auto wrote = file->append({reinterpret_cast<const uint8_t*>(header.data()), header.size()}); !wrote) return wrote;
  const double mm = job.artwork.mmPerPx();
  std::vector<float> z;
  std::vector<uint8_t> rgb, bytes;
  ProgressLine progress("mesh");
  for (int64_t r = 0; r < g.rows; ++r) {
    if (job.stopped()) return job.interruption();
    const Rect row{0, std::min(r * g.step, job.height - 1), job.width, 1};
    fillBand<float>(row, 1, z, [&](const Rect& part, std::span<float> out) { job.artwork.heights(part, out); });
    fillBand<uint8_t>(row, 3, rgb, [&](const Rect& part, std::span<uint8_t> out) { job.artwork.albedo(part, out); });
    bytes.clear();
    for (int64_t c = 0; c < g.columns; ++c) {
      const int64_t x = std::min(c * g.step, job.width - 1);
      const float v[3] = {static_cast<float>((static_cast<double>(x) + 0.5) * mm),
                          static_cast<float>((static_cast<double>(job.height - row.y) - 0.5) * mm),
                          z[static_cast<size_t>(x)]};
      uint8_t vertex[23];
      std::memcpy(vertex, v, 12);
      std::memcpy(vertex + 12, rgb.data() + 3 * x, 3);
      const float uv[2] = {
          static_cast<float>((static_cast<double>(x) + 0.5) / static_cast<double>(job.width)),
          static_cast<float>(1 - (static_cast<double>(row.y) + 0.5) / static_cast<double>(job.height))};
      std::memcpy(vertex + 15, uv, 8);
      bytes.insert(bytes.end(), vertex, vertex + (job.options.mesh_uv ? 23 : 15));
    }
    if (auto wrote = file->append(bytes); !wrote) return wrote;
    progress.update(static_cast<double>(r + 1) / static_cast<double>(g.rows),
                    std::to_string(g.triangles()) + " triangles");
  }
  for (int64_t r = 0; r + 1 < g.rows; ++r) {
    bytes.clear();
    for (int64_t c = 0; c + 1 < g.columns; ++c) {
      const auto a = static_cast<int32_t>(r * g.columns + c), b = a + 1, d = static_cast<int32_t>(a + g.columns),
                 e = d + 1;
      for (const auto& t :
           {std::array<int32_t, 3>{a, d, b}, std::array<int32_t, 3>{b, d, e}}) {  // counter-clockwise from the viewer
        uint8_t face[13] = {3};
        std::memcpy(face + 1, t.data(), 12);
        bytes.insert(bytes.end(), face, face + 13);
      }
    }
    if (auto wrote = file->append(bytes); !wrote) return wrote;
  }
  if (auto kept = file->commit(); !kept) return kept;
  job.files.push_back("mesh.ply");
  return {};
}

Result<void> writeTruth(Job& job) {
  const SampleOptions& o = job.artwork.options();
  auto truth = nlohmann::ordered_json::object();
  truth["generator"] = "relievo sample";
  truth["kind"] = sampleKindName(o.kind);
  truth["seed"] = o.seed;
  truth["width_px"] = o.width;
  truth["height_px"] = o.height;
  truth["mm_per_px"] = job.artwork.mmPerPx();
  truth["relief_mm"] = {job.artwork.minMm(), job.artwork.maxMm()};
  truth["shading"] = {
      {"ambient", sample::kAmbient},
      {"gloss_strength", job.artwork.glossStrength()},
      {"formula", "albedo * cavity * ((1 - s g) (ambient + (1 - ambient) max(0, n.l)) + s g max(0, n.h)^8)"}};
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    if (basis == Basis::kPtmLrgb ? !job.options.ptm_lrgb : !job.options.ptm_rgb) continue;
    TextureFormat f = job.artwork.ptmSource(basis)->format();
    truth[basisName(basis)] = {{"scale", std::vector(f.scales().begin(), f.scales().end())},
                               {"bias", std::vector(f.biases().begin(), f.biases().end())},
                               {"fitted_lights", sample::kFitLights}};
  }
  if (job.options.photos) {
    int64_t step = 1;
    while (((job.width + step - 1) / step) * ((job.height + step - 1) / step) > kShadowPx) ++step;
    truth["photos"] = {{"lights", job.options.lights},
                       {"list", "photos/lights.lp"},
                       {"shadow_step_px", step},
                       {"highlight_exponent", job.artwork.glossStrength() > 0.5 ? 24 : 8}};
  }
  if (job.options.mesh) {
    const MeshGrid g = meshGrid(job.width, job.height);
    truth["mesh"] = {{"step_px", g.step},
                     {"vertices", g.columns * g.rows},
                     {"triangles", g.triangles()},
                     {"axes", "mm; x to the right and y up from the lower left corner; z towards the viewer"}};
  }
  truth["files"] = job.files;
  const std::string text = truth.dump(2) + "\n";
  if (auto wrote = writeFile(job.path("truth.json"), {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
      !wrote)
    return wrote;
  job.files.push_back("truth.json");
  return {};
}

}  // namespace

std::vector<uint8_t> castShadows(const std::vector<float>& heights, int64_t width, int64_t height, double mm_per_px,
                                 const std::array<double, 3>& light) {
  std::vector<uint8_t> lit(static_cast<size_t>(width * height), 255);
  const double lx = light[0], ly = -light[1], flat = std::hypot(lx, ly);  // in the image, y down
  if (flat < 1e-6 || light[2] <= 0) {
    if (light[2] <= 0) std::fill(lit.begin(), lit.end(), 0);
    return lit;
  }
  const bool along_x = std::abs(lx) > std::abs(ly);
  // Lines are swept from the light's side: rows, or columns by way of the transposed field.
  const int64_t lines = along_x ? width : height, length = along_x ? height : width;
  const double major = along_x ? lx : ly, minor = along_x ? ly : lx;
  const bool from_end = major > 0;               // the light stands at the last line
  const double shift = minor / std::abs(major);  // pixels along the line, one line towards the light
  const auto drop = static_cast<float>(mm_per_px * std::hypot(1.0, shift) * light[2] / flat);
  const float inv_soft = 255.0f / (0.75f * drop + 1e-6f);
  const int64_t whole = static_cast<int64_t>(std::floor(shift));
  const auto fraction = static_cast<float>(shift - static_cast<double>(whole));
  auto at = [&](int64_t line, int64_t i) { return static_cast<size_t>(along_x ? i * width + line : line * width + i); };
  constexpr int64_t kPad = 2;
  const auto padded = static_cast<size_t>(length + 2 * kPad);
  std::vector<float> cast(padded, -1e9f), next(padded, -1e9f), line_mm(padded), previous(padded, -1e9f);
  // Columns are gathered a few at a time, so that a cache line is used whole.
  constexpr int64_t kGather = 16;
  std::vector<float> gathered(static_cast<size_t>(length * kGather));
  std::vector<uint8_t> marks(static_cast<size_t>(length * kGather));
  for (int64_t first = 0; first < lines; first += kGather) {
    const int64_t count = std::min(kGather, lines - first);
    auto lineAt = [&](int64_t k) { return from_end ? lines - 1 - (first + k) : first + k; };
    for (int64_t i = 0; along_x && i < length; ++i)
      for (int64_t k = 0; k < count; ++k) gathered[static_cast<size_t>(k * length + i)] = heights[at(lineAt(k), i)];
    for (int64_t k = 0; k < count; ++k) {
      const float* mm = along_x ? gathered.data() + k * length : heights.data() + lineAt(k) * width;
      uint8_t* mark = along_x ? marks.data() + k * length : lit.data() + lineAt(k) * width;
      const float *s0 = cast.data() + kPad + whole, *p0 = previous.data() + kPad + whole;
      float* s = next.data() + kPad;
      for (int64_t i = 0; i < length; ++i) {
        float passed = s0[i] * (1 - fraction) + s0[i + 1] * fraction,
              neighbour = p0[i] * (1 - fraction) + p0[i + 1] * fraction;
        float shade = (passed > neighbour ? passed : neighbour) - drop;
        s[i] = shade;
        float open = 255.0f - (shade - mm[i]) * inv_soft;
        open = open < 0.0f ? 0.0f : (open > 255.0f ? 255.0f : open);
        mark[i] = static_cast<uint8_t>(static_cast<int>(open));
      }
      // Beyond the artwork nothing casts: the pads keep far below.
      std::swap(cast, next);
      std::copy(mm, mm + length, previous.begin() + kPad);
    }
    for (int64_t i = 0; along_x && i < length; ++i)
      for (int64_t k = 0; k < count; ++k) lit[at(lineAt(k), i)] = marks[static_cast<size_t>(k * length + i)];
  }
  return lit;
}

Result<std::vector<std::string>> writeSample(const SampleArtwork& artwork, const SampleWriteOptions& options) {
  std::error_code bad;
  std::filesystem::create_directories(options.folder, bad);
  if (!std::filesystem::is_directory(options.folder))
    return Error{.kind = ErrorKind::kIo,
                 .file = options.folder,
                 .message = "the folder can't be created: " + bad.message(),
                 .hint = "name a folder that you may write to, with -o"};
  Job job{artwork, options, artwork.options().width, artwork.options().height, {}};
  Result<void> done;
  if (options.height) done = writeHeights(job);
  if (done && options.albedo)
    done = writeRgb(job, "albedo", [&](const Rect& r, std::span<uint8_t> out) { artwork.albedo(r, out); });
  if (done && options.normals)
    done = writeRgb(job, "normals", [&](const Rect& r, std::span<uint8_t> out) {
      std::vector<float> n(out.size());
      artwork.normals(r, n);
      for (size_t i = 0; i < n.size(); ++i)
        out[i] = static_cast<uint8_t>(std::clamp(n[i] * 127.5f + 128.0f, 0.0f, 255.0f));
    });
  if (done && options.ptm_lrgb) done = writePtmFile(job, Basis::kPtmLrgb, "ptm_lrgb.ptm");
  if (done && options.ptm_rgb) done = writePtmFile(job, Basis::kPtmRgb, "ptm_rgb.ptm");
  if (done && options.photos) done = writePhotos(job);
  if (done && options.mesh) done = writeMesh(job);
  if (done) done = writeTruth(job);
  if (!done) return done.error();
  return job.files;
}

}  // namespace relievo
