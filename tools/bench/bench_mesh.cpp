// bench_mesh.cpp - artworks over a base mesh: evaluating the LOD of many patches, submitting and drawing them, and
// building one from a scan.
#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numbers>

#include <nlohmann/json.hpp>

#include "geometry/lod/mesh_lod.h"
#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "src/engine/engine.h"
#include "src/engine/lod_views.h"
#include "src/render/base_corners.h"
#include "src/render/camera.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"
#include "tools/bench/bench_groups.h"

extern char** environ;

namespace relievo {
namespace {

// Patches on a bumpy torus, columns around it and rows around its tube.
std::shared_ptr<const BaseMesh> torusPatches(int columns, int rows) {
  auto mesh = std::make_shared<BaseMesh>();
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const double a = -2 * std::numbers::pi * i / columns, b = 2 * std::numbers::pi * j / rows;
      const glm::dvec3 ring(std::cos(a), std::sin(a), 0),
          normal = std::cos(b) * ring + std::sin(b) * glm::dvec3(0, 0, 1);
      mesh->corners.push_back({glm::vec3(100.0 * ring + 40.0 * normal), glm::vec3(normal)});
    }
  }
  auto at = [&](int i, int j) { return static_cast<uint32_t>((j % rows) * columns + i % columns); };
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i) mesh->patches.push_back({at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)});
  return mesh;
}

constexpr double kReliefMm = 0.5;
constexpr float kSlope = 0.1f;  // of the heights, mm a mm: twice what bumps with these errors, one a patch, have
class FallingErrors final : public ReliefOracle {
 public:
  explicit FallingErrors(const BaseMesh& base) : base_(base) {}
  bool heightSlopes(uint32_t patch, HeightSlopes& slopes) const override {
    auto at = [&](size_t k) { return base_.corners[base_.patches[patch][k]].position_mm; };
    const float u = kSlope * std::max(glm::length(at(1) - at(0)), glm::length(at(3) - at(2))),
                v = kSlope * std::max(glm::length(at(2) - at(0)), glm::length(at(3) - at(1)));
    slopes = {-u, u, -v, v};
    return true;
  }
  HeightBounds bounds(const NodeId& page) const override {
    return {-0.25f, 0.25f, static_cast<float>(kReliefMm * std::ldexp(0.01, -2 * static_cast<int>(page.level)))};
  }

 private:
  const BaseMesh& base_;
};

// What is compared with: every patch by itself, its four sides in turn (Schulze Nilsson 2014 evaluates the edges of all
// patches each frame; Dyken, Reimers, Seland 2009, section 3): each side's points projected, its length in pixels the
// measure of its level.
size_t evaluateOneByOne(const BaseMesh& base, const LodView& view) {
  size_t segments = 0;
  for (const auto& patch : base.patches) {
    for (const auto& ends : kSideCorners) {
      glm::dvec2 px[2];
      bool seen = true;
      for (int k = 0; k < 2; ++k) {
        const glm::dvec4 clip =
            view.clip_from_world *
            glm::dvec4(base.corners[patch[static_cast<size_t>(ends[static_cast<size_t>(k)])]].position_mm, 1);
        seen = seen && clip.w > view.near_mm;
        px[k] = glm::dvec2(clip) / std::max(clip.w, view.near_mm) * view.pixels_per_radian;
      }
      if (!seen) continue;
      const double length = glm::length(px[1] - px[0]);
      segments +=
          size_t{1} << std::clamp(static_cast<int>(std::ceil(std::log2(std::max(length / 4, 1.0)))), 0, kMaxGridLevel);
    }
  }
  return segments;
}

Result<void> lodRow(BenchContext& context, int columns, int rows, double goal_ms) {
  auto base = torusPatches(columns, rows);
  std::vector<CoarseErrors> coarse(base->patches.size());
  for (CoarseErrors& e : coarse)
    for (int k = 0; k < 7; ++k) e[static_cast<size_t>(k)] = static_cast<float>(kReliefMm * std::ldexp(0.25, -2 * k));
  MeshLod lod(base, 0, -0.25, kReliefMm / 65535, std::make_shared<FallingErrors>(*base), coarse);
  const Extent extent = extentOf(*base, -0.25, 0.25, 0.1);
  ReliefSet resident;
  for (uint32_t p = 0; p < base->patches.size(); ++p) resident.insert({p, 0, 0, 0});
  std::vector<double> ms, all_ms, baseline_ms;
  size_t instances = 0;
  uint64_t triangles = 0;
  for (bool hide_backs : {false, true}) {  // one after the other, so that lists are as long as those before them
    for (int i = 0; i < (context.quick ? 21 : 101) && !context.stopped(); ++i) {
      OrbitCamera camera = fitCamera(extent, kBenchWidth, kBenchHeight);
      camera.azimuth_deg = 0.37 * i;
      camera.elevation_deg = 40;
      LodView view = lodViewFrom(viewTransform(camera, extent, kBenchWidth, kBenchHeight));
      view.error_px = 1;
      view.min_cell_px = 2;
      view.hide_backs = hide_backs;
      double start = benchSeconds();
      LodResult result = lod.select(view, resident);
      (hide_backs ? ms : all_ms).push_back((benchSeconds() - start) * 1000);
      instances = result.instances.size();
      triangles = 0;
      for (const PatchInstance& p : result.instances) triangles += uint64_t{2} << (2 * p.grid_level);
      if (hide_backs) continue;
      start = benchSeconds();
      volatile size_t kept = evaluateOneByOne(*base, view);
      (void)kept;
      baseline_ms.push_back((benchSeconds() - start) * 1000);
    }
  }
  if (context.stopped()) return {};
  char what[80], note[160];
  std::snprintf(what, sizeof what, "edge-LOD evaluation of %zu patches, one core", base->patches.size());
  std::snprintf(note, sizeof note,
                "slowest %.2f ms; %zu instances, %llu triangles, the others face away; %.2f ms with those",
                quantile(ms, 1), instances, static_cast<unsigned long long>(triangles), median(all_ms));
  context.row({.what = what,
               .measured = median(ms),
               .unit = "ms",
               .goal = goal_ms,
               .baseline_name = "each side's length on screen, one by one",
               .baseline = median(baseline_ms),
               .note = note});
  return {};
}

// What the render thread does for a new list and a moved eye, but for drawing: corners from the eye, instances packed
// and uploaded, uniforms, bindings and calls. Software GL draws within the calls; so those are measured with one
// instance each, all of it outside of the picture.
Result<void> submitRow(BenchContext& context) {
  auto base = torusPatches(270, 90);
  MeshLod lod(base, 0, -0.25, kReliefMm / 65535, std::make_shared<FallingErrors>(*base), {}, true);
  const Extent extent = extentOf(*base, -0.25, 0.25, 0.1);
  PatchMeasures measures;
  measures.relief_depth = 0;
  const auto domain = PatchDomain::overMesh(static_cast<uint32_t>(base->patches.size()), measures);
  auto program = gl::Program::link(gl::currentContextInfo().api,
                                   {"patch.vert", "surface.frag", {{"MESH", "1"}}, patchAttributes(), {}});
  if (!program) return program.error();
  BaseCorners corners(base);
  PatchPass patches, one_each;
  SurfaceTarget surface;
  surface.resize(64, 64, false);
  std::vector<double> corner_ms, pack_ms, call_ms, baseline_ms;
  uint32_t calls = 0, instances = 0;
  EyeFrame nowhere;
  std::vector<PatchInstance> each;
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    PatchInstance& p = each.emplace_back();
    p.grid_level = static_cast<uint8_t>(n);
    p.step_log2 = static_cast<uint8_t>(7 - n);
    for (auto& side : p.edges) side = {static_cast<uint8_t>(n), PatchInstance::kWholeEdge};
  }
  auto no_page = [](const NodeId&) { return kNoSlot; };
  one_each.setInstances(each, nowhere, false, no_page);
  surface.begin();
  program->use();
  for (int i = 0; i < (context.quick ? 21 : 101) && !context.stopped(); ++i) {
    OrbitCamera camera = fitCamera(extent, kBenchWidth, kBenchHeight);
    camera.azimuth_deg = 0.37 * i;
    camera.elevation_deg = 40;
    const ViewTransform transform = viewTransform(camera, extent, kBenchWidth, kBenchHeight);
    LodView view = lodViewFrom(transform);
    view.error_px = 1;
    view.min_cell_px = 2;
    const LodResult result = lod.select(view, {});
    instances = static_cast<uint32_t>(result.instances.size());
    double start = benchSeconds();
    corners.setEye(transform.eye_mm);
    corner_ms.push_back((benchSeconds() - start) * 1000);
    start = benchSeconds();
    patches.setInstances(result.instances, eyeFrame(transform, domain, 1, true, surface.depthMode()), true, no_page);
    pack_ms.push_back((benchSeconds() - start) * 1000);
    start = benchSeconds();
    calls = one_each.draw(*program, nowhere, PatchPass::Mesh::kFronts);
    call_ms.push_back((benchSeconds() - start) * 1000);
    if (i % 20 != 0) continue;
    start = benchSeconds();
    patches.drawOneByOne(*program, nowhere);
    baseline_ms.push_back((benchSeconds() - start) * 1000);
  }
  finishFrame();
  if (context.stopped()) return {};
  char what[96], note[200];
  std::snprintf(what, sizeof what, "submission on the render thread, %zu patches", base->patches.size());
  std::snprintf(note, sizeof note,
                "%zu corners from the eye %.3f ms; %u instances packed and uploaded in %.3f ms, slowest %.2f; %u calls "
                "with one instance each %.3f ms",
                base->corners.size(), median(corner_ms), instances, median(pack_ms), quantile(pack_ms, 1), calls,
                median(call_ms));
  context.row({.what = what,
               .measured = median(corner_ms) + median(pack_ms) + median(call_ms),
               .unit = "ms",
               .goal = 0.2,
               .baseline_name = "a call and uniforms a patch, nothing in view",
               .baseline = median(baseline_ms),
               .note = note});
  return {};
}

// ---- a scan, as a file

// A ball with bumps, as many triangles as asked for; deterministic. Binary PLY.
Result<void> writeScan(const std::string& path, uint64_t triangles) {
  const auto rows = static_cast<uint32_t>(std::sqrt(static_cast<double>(triangles) / 4)), columns = 2 * rows;
  std::vector<uint8_t> bytes;
  auto put = [&](const auto& value) {
    const auto* p = reinterpret_cast<const uint8_t*>(&value);
    bytes.insert(bytes.end(), p, p + sizeof value);
  };
  const uint32_t vertices = (rows - 1) * columns + 2;
  const uint32_t faces = 2 * columns * (rows - 1);
  const std::string head = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(vertices) +
                           "\nproperty float x\nproperty float y\nproperty float z\nelement face " +
                           std::to_string(faces) + "\nproperty list uchar int vertex_indices\nend_header\n";
  bytes.reserve(head.size() + vertices * size_t{12} + faces * size_t{13});
  bytes.insert(bytes.end(), head.begin(), head.end());
  auto vertex = [&](double latitude, double longitude) {
    const glm::dvec3 d(std::sin(latitude) * std::cos(longitude), std::cos(latitude),
                       -std::sin(latitude) * std::sin(longitude));
    const double bump = std::sin(5 * d.x + 2 * std::sin(7 * d.y)) + 0.3 * std::sin(23 * d.y + 3 * std::sin(17 * d.z)) +
                        0.05 * std::sin(151 * d.x) * std::sin(167 * d.z);
    const glm::vec3 p((100 + 2 * bump) * d);
    for (int k = 0; k < 3; ++k) put(p[k]);
  };
  vertex(0, 0);
  for (uint32_t j = 1; j < rows; ++j)
    for (uint32_t i = 0; i < columns; ++i) vertex(std::numbers::pi * j / rows, 2 * std::numbers::pi * i / columns);
  vertex(std::numbers::pi, 0);
  auto face = [&](uint32_t a, uint32_t b, uint32_t c) {
    put(uint8_t{3});
    for (uint32_t k : {a, b, c}) put(k);
  };
  auto at = [&](uint32_t j, uint32_t i) { return 1 + (j - 1) * columns + i % columns; };
  for (uint32_t i = 0; i < columns; ++i) face(0, at(1, i), at(1, i + 1));
  for (uint32_t j = 1; j + 1 < rows; ++j) {
    for (uint32_t i = 0; i < columns; ++i) {
      face(at(j, i), at(j + 1, i), at(j + 1, i + 1));
      face(at(j, i), at(j + 1, i + 1), at(j, i + 1));
    }
  }
  for (uint32_t i = 0; i < columns; ++i) face(at(rows - 1, i), vertices - 1, at(rows - 1, i + 1));
  return writeFile(path, bytes);
}

struct Build {
  double seconds = 0;     // without measuring distances
  double peak_bytes = 0;  // of the process, in any stage of the build
};
// In a process of its own, so that its peak memory is its own.
Result<Build> buildPackageOf(const std::string& scan, const std::string& package, const std::string& json_file) {
  std::vector<std::string> arguments = {"relievo", "build", "--mesh", scan, "-o", package, "--json", json_file};
  std::vector<char*> argv;
  for (std::string& a : arguments) argv.push_back(a.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t quiet;
  posix_spawn_file_actions_init(&quiet);
  for (int fd : {1, 2}) posix_spawn_file_actions_addopen(&quiet, fd, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  int status = posix_spawn(&child, "/proc/self/exe", &quiet, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&quiet);
  if (status == 0) waitpid(child, &status, 0);
  if (status != 0) return Error{ErrorKind::kRuntime, "", "relievo build --mesh failed", "run it by itself", {}};
  auto text = readTextFile(json_file, 1 << 20);
  if (!text) return text.error();
  auto json = parseJson(*text, json_file);
  if (!json) return json.error();
  Build build;
  if (!json->is_object() || !json->contains("build_seconds"))
    return Error{ErrorKind::kInvalidData, json_file, "expected the build's time", "", {}};
  build.seconds = (*json)["build_seconds"].get<double>();
  for (const auto& stage : (*json)["stages"]) {
    if (stage["name"] != "distance") build.peak_bytes = std::max(build.peak_bytes, stage["peak_bytes"].get<double>());
  }
  return build;
}

}  // namespace

Result<void> meshLodBench(BenchContext& context) {
  if (auto done = lodRow(context, 270, 90, 0.25); !done) return done;
  if (auto done = lodRow(context, 512, 192, 1.0); !done) return done;
  return submitRow(context);
}

Result<void> meshBuildBench(BenchContext& context) {
  const uint64_t triangles = context.quick ? 250'000 : 2'000'000;
  const std::string scan = context.folder + "/scan.ply", package = context.folder + "/scan.relievo",
                    json_file = context.folder + "/scan.json";
  if (auto written = writeScan(scan, triangles); !written) return written;
  auto built = buildPackageOf(scan, package, json_file);
  if (!built) return built.error();
  auto opened = Package::open(package);
  if (!opened) return opened.error();
  const double n = static_cast<double>(triangles);
  const double read_s = [&] {
    const double start = benchSeconds();
    (void)hashFile(scan);
    return benchSeconds() - start;
  }();
  context.row({.what = "relievo build --mesh, triangles a second, 2 cores",
               .measured = n / 1e6 / built->seconds,
               .unit = "M/s",
               .goal = 1,
               .at_most = false,
               .baseline_name = "the file read and hashed alone",
               .baseline = n / 1e6 / read_s,
               .note = std::to_string(triangles) + " triangles, " +
                       std::to_string((*opened)->manifest().domain.patchCount()) + " patches"});
  context.row({.what = "its peak memory, a triangle",
               .measured = built->peak_bytes / n,
               .unit = "B",
               .goal = 100,
               .baseline_name = "the file itself",
               .baseline = static_cast<double>(std::filesystem::file_size(scan)) / n});
  if (context.stopped()) return {};

  // What was built, on screen.
  EngineOptions options;
  options.cache_mib = 1024;
  std::vector<double> frame_ms, submit_ms;
  EngineStats stats;
  auto engine = Engine::create(artworkFromPackage(*opened), Scene{}, options);
  if (!engine) return engine.error();
  (*engine)->resize(kBenchWidth, kBenchHeight);
  OrbitCamera camera = fitCamera(artworkExtent((*opened)->manifest()), kBenchWidth, kBenchHeight);
  (*engine)->setCamera(camera);
  if (auto settled = (*engine)->settle(120); !settled) return settled;
  for (int i = 0; i < (context.quick ? 15 : 60) && !context.stopped(); ++i) {
    camera.azimuth_deg += 0.2;
    (*engine)->setCamera(camera);
    double start = benchSeconds();
    (*engine)->frame(benchSeconds());
    submit_ms.push_back((benchSeconds() - start) * 1000);
    (*engine)->readPixels();
    frame_ms.push_back((benchSeconds() - start) * 1000);
    stats = (*engine)->stats();
  }
  char note[160];
  std::snprintf(note, sizeof note, "predicted error %.2f px, %u instances", stats.predicted_error_px, stats.instances);
  context.row({.what = "that scan turning at 1280x720, error 1 px: a frame",
               .measured = median(frame_ms),
               .unit = "ms",
               .goal = 1000.0 / 30,
               .note = note});
  context.row({.what = "triangles drawn in it",
               .measured = static_cast<double>(stats.triangles),
               .unit = "",
               .goal = 60000,
               .baseline_name = "in the scan",
               .baseline = n});
  context.row({.what = "draw calls, shading and feedback included",
               .measured = static_cast<double>(stats.draw_calls),
               .unit = "",
               .goal = 8});
  context.row({.what = "a frame on the render thread, until it is submitted",
               .measured = median(submit_ms),
               .unit = "ms",
               .note = "software GL draws on that thread, too"});
  return {};
}

}  // namespace relievo
