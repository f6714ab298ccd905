#include "tools/build_mesh.h"

#include <malloc.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <functional>
#include <memory>
#include <optional>

#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/mesh_distance.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/remesh/base_domain.h"
#include "geometry/scan/mesh_read.h"
#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/base/worker_threads.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "texturing/package/file_provenance.h"
#include "texturing/package/package.h"
#include "texturing/package/package_base.h"
#include "texturing/package/patch_source.h"
#include "tools/build_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/report/mesh_report.h"

namespace relievo {
namespace {

class BakedPatches final : public PatchSource {
 public:
  BakedPatches(const MeshBake& bake, std::vector<Provenance> sources, const TextureFormat& format)
      : bake_(bake), sources_(std::move(sources)), format_(format) {}
  const BaseMesh& base() const override { return bake_.base(); }
  int textureDepth() const override { return bake_.textureDepth(); }
  int reliefDepth() const override { return bake_.reliefDepth(); }
  TextureFormat format() const override { return format_; }
  double reliefOffsetMm() const override { return bake_.reliefOffsetMm(); }
  double reliefScaleMm() const override { return bake_.reliefScaleMm(); }
  double errorUnitMm() const override { return bake_.errorUnitMm(); }
  std::vector<Provenance> provenance() const override { return sources_; }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override { return bake_.texels(patch, out); }
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const override { return bake_.heights(patch, out); }
  Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const override {
    const std::vector<float>& mm = bake_.errorsOfCells(patch, std::countr_zero(unsigned{kPagePx}) + level).mm;
    std::copy(mm.begin(), mm.end(), out_mm.begin());
    return {};
  }
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override {
    CoarseErrors out;
    for (size_t k = 0; k < out.size(); ++k) out[k] = bake_.errorOfCells(patch, static_cast<int>(k));
    return out;
  }
  Result<bool> coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out_mm) const override {
    const std::vector<float>& mm = bake_.errorsOfCells(patch, cells_log2).mm;
    std::copy(mm.begin(), mm.end(), out_mm.begin());
    return true;
  }
  bool errorShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> out) const override {
    const std::vector<DeviationShape>& shapes = bake_.errorsOfCells(patch, cells_log2).shapes;
    std::copy(shapes.begin(), shapes.end(), out.begin());
    return true;
  }

 private:
  const MeshBake& bake_;
  std::vector<Provenance> sources_;
  TextureFormat format_;
};

// The resident size, and its largest since the last call of restart(); Linux.
struct Memory {
  static void restart() {
    if (FILE* f = std::fopen("/proc/self/clear_refs", "w")) {
      std::fputs("5", f);
      std::fclose(f);
    }
  }
  static uint64_t peak() { return field("VmHWM: %llu kB"); }
  static uint64_t now() { return field("VmRSS: %llu kB"); }

 private:
  static uint64_t field(const char* pattern) {
    uint64_t kib = 0;
    if (FILE* f = std::fopen("/proc/self/status", "r")) {
      char line[256];
      unsigned long long value = 0;
      while (std::fgets(line, sizeof line, f))
        if (std::sscanf(line, pattern, &value) == 1) kib = value;
      std::fclose(f);
    }
    return kib << 10;
  }
};

// What a build takes beside a scan, however little memory is left: for looking up where lines meet the scan, and for
// pages.
constexpr uint64_t kLeastRayBytes = uint64_t{256} << 20, kLeastPackageBytes = uint64_t{64} << 20;
// From so many on a scan is worked through in parts.
constexpr size_t kManyTriangles = 400'000;

// Runs a stage with its line of progress, and notes what it cost.
class Stages {
 public:
  template <class F>
  auto run(const char* name, F&& stage) {
    const auto start = std::chrono::steady_clock::now();
    Memory::restart();
    auto result = stage();
    costs.push_back(
        {name, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), Memory::peak()});
    malloc_trim(0);  // what the stage gave back is not the next one's
    return result;
  }
  template <class Options, class F>
  auto run(const char* name, Options& options, F&& stage) {
    ProgressLine line(name);
    options.interrupted = &interruptedFlag();
    options.progress = [&line](double done) { line.update(done, ""); };
    return run(name, std::forward<F>(stage));
  }
  std::vector<StageCost> costs;
};

// Of its own, not those that name materials' colours.
bool hasTextureCoordinates(const TriMesh& mesh) { return !mesh.corner_uv.empty() && mesh.palette.empty(); }

// The image that the scan's texture coordinates belong to, as three channels.
Result<Image8> readTexture(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (a.texture == "none") return Image8{};
  if (!a.texture.empty() && !hasTextureCoordinates(mesh))
    return Error{ErrorKind::kUsage,
                 a.mesh,
                 "--texture needs texture coordinates, found none in the mesh",
                 "leave --texture out: colours of vertices or materials are used",
                 {}};
  const std::string path = a.texture.empty() ? mesh.texture_path : a.texture;
  if (path.empty() && !mesh.palette.empty()) {
    Image8 row{static_cast<int>(mesh.palette.size()), 1, 3, {}};
    for (const glm::u8vec3& colour : mesh.palette) row.pixels.insert(row.pixels.end(), {colour.r, colour.g, colour.b});
    return row;
  }
  if (path.empty() || mesh.corner_uv.empty()) return Image8{};
  if (a.texture.empty() && !a.allow_outside)
    if (auto beside = checkBesideMesh(a.mesh, path, "the image"); !beside) return beside.error();
  auto image = readImage8(path, a.images);
  if (!image) {
    Error error = image.error();
    if (a.texture.empty())
      error.hint = "the mesh names it; --texture FILE names another, --texture none builds without";
    return error;
  }
  if (image->channels == 2 || image->channels == 4)
    warn(path + ": its alpha channel is ignored; colours are taken as they are stored");
  if (image->channels == 3) return image;
  Image8 rgb{image->width, image->height, 3, {}};
  const size_t channels = static_cast<size_t>(image->channels), pixels = image->pixels.size() / channels;
  rgb.pixels.resize(pixels * 3);
  for (size_t i = 0; i < pixels; ++i)
    for (size_t c = 0; c < 3; ++c) rgb.pixels[3 * i + c] = image->pixels[i * channels + (channels >= 3 ? c : 0)];
  return rgb;
}

// What lies on the patches: a PTM's planes, channels interleaved, or an image's colours; and what they mean.
struct Surface {
  Image8 image;
  TextureFormat format{.basis = Basis::kAlbedoNormal};
  std::optional<Provenance> source;
};

// The coordinates belong to the image that the mesh names: a PTM of other proportions was taken otherwise.
Result<void> checkProportions(const MeshBuildArguments& a, const TriMesh& mesh, int64_t width, int64_t height) {
  if (a.texture == "none" || mesh.texture_path.empty()) return {};
  if (!a.allow_outside)
    if (auto beside = checkBesideMesh(a.mesh, mesh.texture_path, "the image"); !beside) return beside;
  ImageReadOptions as_stored = a.images;
  as_stored.orient = false;
  auto named = openColourImage(mesh.texture_path, as_stored);
  if (!named) return {};
  const double ratio = static_cast<double>(width) / static_cast<double>(height) *
                       static_cast<double>((*named)->height()) / static_cast<double>((*named)->width());
  if (ratio > 0.99 && ratio < 1.01) return {};
  auto size = [](int64_t w, int64_t h) { return std::to_string(w) + " x " + std::to_string(h); };
  return Error{ErrorKind::kInvalidData,
               a.ptm,
               "expected the proportions of the mesh's image " + mesh.texture_path + ", " +
                   size((*named)->width(), (*named)->height()) + ", found " + size(width, height),
               "--texture none: the texture coordinates are the PTM's all the same",
               {}};
}

Result<Surface> readPtmPlanes(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (!hasTextureCoordinates(mesh))
    return Error{ErrorKind::kUsage,
                 a.mesh,
                 "--ptm needs texture coordinates, found none in the mesh",
                 "export the mesh with texture coordinates for the PTM's pixels, or leave --ptm out",
                 {}};
  auto opened = openPtm(a.ptm, {.memory_budget_bytes = a.package.memory_budget_bytes});
  if (!opened) return opened.error();
  const TextureSource& ptm = **opened;
  Surface out{{}, ptm.format(), ptm.provenance()};
  const int channels = out.format.channels();
  if (auto fits = checkProportions(a, mesh, ptm.width(), ptm.height()); !fits) return fits.error();
  // With its coarser levels.
  const double bytes = static_cast<double>(ptm.width()) * static_cast<double>(ptm.height()) * channels * 4 / 3;
  if (bytes > static_cast<double>(a.package.memory_budget_bytes))
    return Error{ErrorKind::kUsage,
                 a.ptm,
                 "its planes take " + std::to_string(static_cast<uint64_t>(bytes) >> 20) +
                     " MiB of memory, expected at most " + std::to_string(a.package.memory_budget_bytes >> 20),
                 "--memory-mib allows more",
                 {}};
  out.image = {static_cast<int>(ptm.width()), static_cast<int>(ptm.height()), channels, {}};
  const auto width = static_cast<size_t>(ptm.width()), planes = static_cast<size_t>(channels);
  out.image.pixels.resize(width * static_cast<size_t>(ptm.height()) * planes);
  constexpr int64_t kRows = 64;
  std::vector<uint8_t> band;
  for (int64_t y = 0; y < ptm.height(); y += kRows) {
    if (interruptedFlag()) break;
    const Rect rect{0, y, ptm.width(), std::min(kRows, ptm.height() - y)};
    const size_t texels = width * static_cast<size_t>(rect.height);
    band.resize(texels * planes);
    if (auto read = ptm.read(rect, band); !read) return read.error();
    uint8_t* to = out.image.pixels.data() + static_cast<size_t>(y) * width * planes;
    for (size_t c = 0; c < planes; ++c)
      for (size_t i = 0; i < texels; ++i) to[i * planes + c] = band[c * texels + i];
  }
  return out;
}

Result<Surface> readSurface(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (!a.ptm.empty()) return readPtmPlanes(a, mesh);
  auto image = readTexture(a, mesh);
  if (!image) return image.error();
  Surface out;
  out.image = std::move(*image);
  if (out.image.width > 0 && (mesh.palette.empty() || !a.texture.empty()))
    out.source = FileProvenance(a.texture.empty() ? mesh.texture_path : a.texture, true).get();
  return out;
}

Error interrupted(const MeshBuildArguments& a) {
  return {ErrorKind::kInterrupted, a.package.output, "interrupted", "nothing was written", {}};
}

std::string millimetres(double mm) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g mm", mm);
  return text;
}

// A scan's way into a package, stage by stage; each begins with what those before it left.
class MeshBuild {
 public:
  explicit MeshBuild(const MeshBuildArguments& a) : a_(a), mesh_file_(a.mesh, true) {}

  Result<void> run() {
    if (auto done = read(); !done) return done;
    if (auto done = checkArguments(); !done) return done;
    auto textured = readSurface(a_, loaded_.mesh);
    if (!textured) return textured.error();
    textured_ = std::move(*textured);
    if (interruptedFlag()) return interrupted(a_);
    if (auto done = makeBase(); !done) return done;
    if (auto done = bake(); !done) return done;
    if (auto done = pack(); !done) return done;
    if (measured())
      if (auto done = measure(); !done) return done;
    result_.stages = stages_.costs;
    return writeReports();
  }
  void printSummary() const;

 private:
  Result<void> read();
  // What only the scan itself tells to be impossible.
  Result<void> checkArguments() const;
  // Beside it begins what the bake looks up.
  Result<void> makeBase();
  Result<void> bake();
  Result<void> pack();
  bool measured() const { return !a_.report.empty() || !a_.json_file.empty(); }
  Result<void> measure();
  Result<void> writeReports() const;

  const MeshBuildArguments& a_;
  Stages stages_;
  FileProvenance mesh_file_;
  LoadedMesh loaded_;
  Surface textured_;
  std::optional<BackgroundTask<Result<BakeScene>>> bake_scene_;
  BaseMesh base_;
  std::unique_ptr<MeshBake> bake_;
  MeshBuildResult result_;
};

Result<void> MeshBuild::read() {
  MeshReadOptions read_options;
  read_options.mm_per_unit = mmPerUnit(a_.unit);
  read_options.workers = a_.package.workers;
  read_options.allow_outside = a_.allow_outside;
  auto loaded = stages_.run("read", read_options, [&] {
    auto mesh = readMesh(a_.mesh, read_options);
    if (mesh.ok()) mesh_file_.start();
    if (mesh.ok() && needsOrder(mesh->mesh)) orderTriangles(mesh->mesh, a_.package.workers, &interruptedFlag());
    return mesh;
  });
  if (!loaded) return loaded.error();
  loaded_ = std::move(*loaded);
  if (a_.named_files) *a_.named_files = loaded_.named_files;
  // Nothing of what follows can give the scan's own memory back.
  if (const uint64_t held = Memory::now(); held > a_.package.memory_budget_bytes) {
    warn(a_.mesh + ": the scan alone takes " + std::to_string(held >> 20) + " MiB of memory, --memory-mib allows " +
         std::to_string(a_.package.memory_budget_bytes >> 20) + ", about " +
         std::to_string((held + kLeastRayBytes + kLeastPackageBytes) >> 20) + " MiB are needed");
  }
  return {};
}

Result<void> MeshBuild::checkArguments() const {
  std::vector<NamedFile> named;
  for (const std::string& path : loaded_.named_files) named.push_back({path + ", which the mesh names", path});
  if (auto good = checkApart({{"-o", a_.package.output}, {"--report", a_.report}, {"--json", a_.json_file}}, named);
      !good)
    return good;
  // Each patch has cells of its own: more of them than the scan has detail for take minutes, and space, for nothing.
  constexpr size_t kAlwaysPatches = 1024;
  if (const size_t most = std::max(kAlwaysPatches, loaded_.mesh.triangles.size() / 2); a_.patches > most)
    return Error{ErrorKind::kUsage,
                 a_.mesh,
                 "--patches asks for " + std::to_string(a_.patches) + ", a scan of " +
                     std::to_string(loaded_.mesh.triangles.size()) + " triangles has at most " + std::to_string(most),
                 "ask for fewer, or leave --patches out",
                 {}};
  return {};
}

Result<void> MeshBuild::makeBase() {
  const TriMesh& scan = loaded_.mesh;
  BaseDomainOptions base_options;
  base_options.patches = a_.patches;
  base_options.workers = a_.package.workers;
  // What the bake looks up is made while the base mesh needs one core only. Of the memory it may have what the package
  // does not need.
  constexpr uint64_t kPackageBytes = uint64_t{128} << 20;
  base_options.scan_done = [&] {
    const uint64_t held = Memory::now() + scan.positions_mm.size() * sizeof(glm::vec3) + kPackageBytes;
    const uint64_t left = a_.package.memory_budget_bytes > held ? a_.package.memory_budget_bytes - held : 0;
    BakeSceneOptions options{
        .ray_bytes = std::max(left, kLeastRayBytes), .workers = a_.package.workers, .interrupted = &interruptedFlag()};
    bake_scene_.emplace("relievo-scene", [&scan, options] { return makeBakeScene(scan, options); });
  };
  auto base = stages_.run("base", base_options, [&] { return makeBaseMesh(scan, base_options); });
  if (!base) {
    Error error = base.error();
    if (error.kind == ErrorKind::kInvalidData) error.file = a_.mesh;
    return error;
  }
  base_ = std::move(*base);
  return {};
}

Result<void> MeshBuild::bake() {
  const TriMesh& scan = loaded_.mesh;
  const Image8& image = textured_.image;
  BakeOptions bake_options;
  bake_options.tolerance_mm = a_.tolerance_mm;
  bake_options.workers = a_.package.workers;
  auto bake = stages_.run("bake", bake_options, [&]() -> Result<std::unique_ptr<MeshBake>> {
    Result<BakeScene>& scene = bake_scene_->get();
    if (!scene) return scene.error();
    return MeshBake::create(
        scan,
        {image.width, image.height, image.pixels, std::max(image.channels, 3), !a_.ptm.empty(), scan.texture_repeats},
        base_, bake_options, std::move(*scene));
  });
  if (!bake) return bake.error();
  bake_ = std::move(*bake);
  return {};
}

Result<void> MeshBuild::pack() {
  std::vector<Provenance> sources{mesh_file_.get()};
  if (textured_.source) sources.push_back(*textured_.source);
  result_.package = a_.package.output;
  result_.mesh = meshJson(sources[0].name, a_.unit, loaded_.diagnosis, bake_->base(), bake_->report(), a_.patches);
  BuildOptions package = a_.package;
  package.manifest_extra =
      nlohmann::ordered_json{{"mesh", result_.mesh}}.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  // The scan and what it was baked into stay in memory beside; the rest of the budget, but for the least, is the
  // package's.
  constexpr uint64_t kKeptBytes = uint64_t{16} << 20;
  const uint64_t held = Memory::now();
  package.kept_bytes = kKeptBytes;
  package.memory_budget_bytes = std::max(package.memory_budget_bytes, held + kLeastPackageBytes) - held;
  auto built = stages_.run(
      "package", [&] { return buildPatchesWithProgress(BakedPatches(*bake_, sources, textured_.format), package); });
  if (!built) return built.error().kind == ErrorKind::kInterrupted ? interrupted(a_) : built.error();
  result_.pages = built->pages;
  result_.package_bytes = built->package_bytes;
  result_.triangles_read = loaded_.diagnosis.triangles_read;
  result_.vertices = loaded_.diagnosis.vertices;
  {
    auto opened = Package::open(a_.package.output);
    if (!opened) return opened.error();
    auto relief = planeUsage(**opened, Plane::kRelief);
    if (!relief) return relief.error();
    result_.relief_bytes = relief->bytes + baseSectionBytes(base_.corners.size(), base_.patches.size());
  }
  return {};
}

Result<void> MeshBuild::measure() {
  DistanceRun distance_run;
  distance_run.workers = a_.package.workers;
  // Small parts of a large surface take long: where the scan alone is beyond the budget, they are not that small.
  const uint64_t in_use = Memory::now(), least = uint64_t{in_use > a_.package.memory_budget_bytes ? 64u : 16u} << 20;
  distance_run.memory_bytes = std::max(a_.package.memory_budget_bytes, in_use + least) - in_use;
  auto distance =
      stages_.run("distance", distance_run, [&] { return measureDistance(loaded_.mesh, *bake_, 3, distance_run); });
  if (!distance) {
    Error error = distance.error();
    if (error.kind == ErrorKind::kInterrupted)
      error.hint = a_.package.output + " is whole; its distances were not measured, no report was written";
    return error;
  }
  result_.distance = std::move(*distance);
  return {};
}

Result<void> MeshBuild::writeReports() const {
  if (!a_.report.empty())
    if (auto written = writeMeshReport(a_.report, loaded_.mesh, result_); !written) return written;
  if (!a_.json_file.empty()) {
    const std::string text = reportJson(result_).dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
    if (auto written = writeFile(a_.json_file, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
        !written || a_.json_file == "-")
      return written;
  }
  return {};
}

void MeshBuild::printSummary() const {
  double seconds = 0;
  uint64_t peak = 0;
  std::string each;
  for (const StageCost& s : stages_.costs) {
    char text[64];
    std::snprintf(text, sizeof text, "%s%s %.1f s", each.empty() ? "" : ", ", s.name.c_str(), s.seconds);
    each += text;
    seconds += s.seconds;
    peak = std::max(peak, s.peak_bytes);
  }
  printOutf("%s: %llu pages, %.1f MiB, %.1f s (%s), in at most %.0f MiB of memory\n%s", a_.package.output.c_str(),
            static_cast<unsigned long long>(result_.pages), static_cast<double>(result_.package_bytes) / (1 << 20),
            seconds, each.c_str(), static_cast<double>(peak) / (1 << 20), meshText(result_.mesh).c_str());
  if (measured()) {
    const MeshDistance& d = result_.distance;
    printOutf("  distance  at most %s from scan to patches, %s back; RMS %s and %s, %.1f dB\n",
              millimetres(d.to_baked.max_mm).c_str(), millimetres(d.to_scan.max_mm).c_str(),
              millimetres(d.to_baked.rms_mm).c_str(), millimetres(d.to_scan.rms_mm).c_str(), d.psnr_db);
  }
}

}  // namespace

double mmPerUnit(const std::string& unit) {
  return unit == "mm" ? 1 : unit == "cm" ? 10 : unit == "m" ? 1000 : unit == "in" ? 25.4 : 0;
}

Result<void> buildFromMesh(const MeshBuildArguments& a) {
  MeshBuild build(a);
  if (auto done = build.run(); !done) return done;
  if (!a.quiet && a.json_file != "-") build.printSummary();
  return {};
}

}  // namespace relievo
