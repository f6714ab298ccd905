#include "geometry/bake/mesh_bake.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/bake_texels.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/height_search.h"
#include "geometry/bake/height_steps.h"
#include "geometry/bake/line_sweep.h"
#include "geometry/bake/plane_image.h"
#include "geometry/bake/vertex_normals.h"
#include "geometry/mesh/ray_scene.h"
#include "src/base/parallel_for.h"

namespace relievo {

struct MeshBake::Impl {
  BakeGround ground;
  BakedHeights baked;
  std::vector<uint16_t> exact;  // as they were baked, where those of `baked` are not
  BakeTexture texture;
  BakeReport report;
  std::vector<std::vector<GridErrors>> errors;  // by patch, then as gridErrors() has them
  double error_unit_mm = 0;

  Impl(const TriMesh& mesh, const BaseMesh& base) : ground(mesh, base) {}
};

namespace {

Error interruptedError() { return {ErrorKind::kInterrupted, "", "interrupted", ""}; }

Result<void> checkBake(const TriMesh& mesh, const MeshBake::Image& image, const BaseMesh& base,
                       const BakeOptions& options) {
  auto usage = [](std::string what) { return Error{ErrorKind::kUsage, "", std::move(what), ""}; };
  if (options.cells_log2 != -1 && (options.cells_log2 < 1 || options.cells_log2 > kMaxCellsLog2))
    return usage("relief cells a patch: expected 2^1 to 2^" + std::to_string(kMaxCellsLog2) + ", found 2^" +
                 std::to_string(options.cells_log2));
  if (options.texture_depth < -1 || options.texture_depth > 7)
    return usage("texture depth of a patch: expected 0 to 7, found " + std::to_string(options.texture_depth));
  if (!(options.tolerance_mm >= 0) || !std::isfinite(options.tolerance_mm))
    return usage("the tolerance is not a distance in mm");
  if (mesh.triangles.empty()) return Error{ErrorKind::kInvalidData, "", "the mesh has no triangle", ""};
  if (image.planes && mesh.corner_uv.empty()) return usage("the mesh has no texture coordinates for the planes");
  if (!image.planes && !image.texels.empty() && image.channels != 3)
    return usage("an image of colours has three channels");
  if (auto problem = baseMeshProblem(base); !problem.empty())
    return Error{ErrorKind::kInvalidData, "", "base mesh: " + problem, ""};
  return {};
}

// The image where the mesh has texture coordinates for it.
BakeTexture textureOf(const TriMesh& mesh, const MeshBake::Image& image) {
  BakeTexture texture;
  if (image.texels.empty() || mesh.corner_uv.empty()) return texture;
  texture.planes = image.planes;
  texture.image =
      PlaneImage(image.width, image.height, image.channels, image.texels, image.planes ? 16 : 0, image.repeats);
  return texture;
}

// How far coarser grids lie from each patch's finest, as gridErrors() has them. Empty: interrupted.
std::vector<std::vector<GridErrors>> errorsOf(const BakeGround& ground, const BakedHeights& baked,
                                              const std::function<void(double)>& progress) {
  constexpr size_t kPatchesAJob = 16;
  const size_t patches = ground.base.patches.size();
  std::vector<std::vector<GridErrors>> errors(patches);
  const bool done =
      parallelFor((patches + kPatchesAJob - 1) / kPatchesAJob, ground.workers, ground.interrupted,
                  [&](size_t job) {
                    SurfaceGrid finest(kPageCellsLog2 + baked.reliefDepth());
                    GridErrorScratch scratch;
                    for (size_t p = job * kPatchesAJob; p < std::min(patches, (job + 1) * kPatchesAJob); ++p) {
                      if (ground.stopped()) return;
                      baked.surface(ground, static_cast<uint32_t>(p), finest);
                      std::array<glm::dvec3, 4> normals;
                      for (size_t k = 0; k < 4; ++k) normals[k] = ground.base.corners[ground.base.patches[p][k]].normal;
                      errors[p] = gridErrors(finest, normals, scratch);
                    }
                  },
                  [&](size_t taken) {
                    if (progress)
                      progress(std::min(1.0, static_cast<double>(taken * kPatchesAJob) / static_cast<double>(patches)));
                  });
  if (!done) errors.clear();
  return errors;
}

// What the largest error of all fits into 16 bits with.
double errorUnit(const std::vector<std::vector<GridErrors>>& errors, double relief_scale_mm) {
  float largest = 0;
  for (const auto& by_grid : errors)
    for (float e : by_grid[kPageCellsLog2].mm) largest = std::max(largest, e);
  return largest > 0           ? static_cast<double>(largest) / 65535.0 * (1 + 1e-9)
         : relief_scale_mm > 0 ? relief_scale_mm
                               : 1.0;
}

}  // namespace

Result<BakeScene> makeBakeScene(const TriMesh& mesh, const BakeSceneOptions& options) {
  BakeScene out;
  const bool swept = mesh.triangles.size() >= options.sweep_from_triangles;
  auto rays = RayScene::create(mesh, {.interrupted = options.interrupted,
                                      .region_triangles = options.region_triangles,
                                      .budget_bytes = options.ray_bytes,
                                      .at_once = !swept});
  if (!rays) return rays.error();
  out.rays = std::move(*rays);
  if (swept) out.sweep = std::make_shared<const LineSweep>(mesh, options.workers);
  std::vector<glm::vec3> normals;
  if (!makeVertexNormals(mesh, options.workers, options.interrupted, normals)) return interruptedError();
  out.normals = std::make_shared<const std::vector<glm::vec3>>(std::move(normals));
  return out;
}

MeshBake::MeshBake(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
MeshBake::~MeshBake() = default;
const BaseMesh& MeshBake::base() const { return impl_->ground.base; }
const BakeReport& MeshBake::report() const { return impl_->report; }
int MeshBake::textureDepth() const { return impl_->report.texture_depth; }
int MeshBake::reliefDepth() const { return impl_->baked.reliefDepth(); }
double MeshBake::reliefOffsetMm() const { return impl_->baked.offset_mm; }
double MeshBake::reliefScaleMm() const { return impl_->baked.scale_mm; }
double MeshBake::errorUnitMm() const { return impl_->error_unit_mm; }

Result<std::unique_ptr<MeshBake>> MeshBake::create(const TriMesh& mesh, const Image& image, const BaseMesh& base,
                                                   const BakeOptions& given, BakeScene scene) {
  const auto started = std::chrono::steady_clock::now();
  BakeOptions options = given;
  if (given.progress) {  // grids tried one after the other never lead backwards
    options.progress = [&given, most = 0.0](double done) mutable { given.progress(most = std::max(most, done)); };
  }
  auto progress = [&](double done) {
    if (options.progress) options.progress(done);
  };
  if (auto sound = checkBake(mesh, image, base, options); !sound) return sound.error();
  auto impl = std::make_unique<Impl>(mesh, base);
  impl->ground.workers = options.workers;
  impl->ground.interrupted = options.interrupted;
  impl->texture = textureOf(mesh, image);
  if (!scene.rays) {
    auto made = makeBakeScene(mesh, {.workers = options.workers, .interrupted = options.interrupted});
    if (!made) return made.error();
    scene = std::move(*made);
  }
  impl->ground.scene = std::move(scene.rays);
  impl->ground.sweep = std::move(scene.sweep);
  impl->ground.normals = std::move(scene.normals);
  progress(0.3);

  auto baked = searchHeights(impl->ground, options, impl->report);
  if (!baked) return baked.error();
  impl->baked = std::move(*baked);
  chooseTexelSize(impl->ground, options.texture_depth, impl->texture);
  impl->report.texture_depth = impl->texture.depth;
  impl->errors = errorsOf(impl->ground, impl->baked, [&](double done) { progress(0.9 + 0.1 * done); });
  if (impl->errors.empty()) return interruptedError();
  impl->error_unit_mm = errorUnit(impl->errors, impl->baked.scale_mm);
  if (auto sound = impl->ground.scene->status(); !sound) return sound.error();
  impl->report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  progress(1);
  return std::unique_ptr<MeshBake>(new MeshBake(std::move(impl)));
}

Result<void> MeshBake::setStep(double step_mm) {
  Impl& b = *impl_;
  constexpr double kMostSteps = 16384;
  const int step =
      b.baked.scale_mm > 0 ? static_cast<int>(std::clamp(std::floor(step_mm / b.baked.scale_mm), 1.0, kMostSteps)) : 1;
  if (b.exact.empty()) b.exact = b.baked.samples;
  auto made = step > 1 ? steppedHeights(b.ground, b.exact, b.baked.cells_log2, step) : std::optional(b.exact);
  if (!made) return interruptedError();
  b.baked.samples = std::move(*made);
  b.baked.stepped = step > 1;
  b.errors = errorsOf(b.ground, b.baked, {});
  if (b.errors.empty()) return interruptedError();
  b.error_unit_mm = errorUnit(b.errors, b.baked.scale_mm);
  return {};
}

Result<void> MeshBake::heights(uint32_t patch, std::span<uint16_t> out) const {
  impl_->baked.finest(impl_->ground, patch, out);
  return {};
}

const GridErrors& MeshBake::errorsOfCells(uint32_t patch, int cells_log2) const {
  return impl_->errors[patch][static_cast<size_t>(cells_log2)];
}
float MeshBake::errorOfCells(uint32_t patch, int cells_log2) const {
  const std::vector<float>& mm = errorsOfCells(patch, cells_log2).mm;
  return *std::max_element(mm.begin(), mm.end());
}

Result<void> MeshBake::texels(uint32_t patch, std::span<uint8_t> out) const {
  const Impl& b = *impl_;
  return bakeTexels(b.ground, b.baked, b.texture, b.report.deviation_mm, patch, out) ? Result<void>()
                                                                                     : interruptedError();
}

}  // namespace relievo
