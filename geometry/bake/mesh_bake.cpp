#include "geometry/bake/mesh_bake.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/bake_texels.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/corner_normals.h"
#include "geometry/bake/height_search.h"
#include "geometry/bake/height_steps.h"
#include "geometry/bake/line_rasteriser.h"
#include "geometry/bake/mip_image.h"
#include "geometry/bake/texture_resolution.h"
#include "geometry/mesh/ray_scene.h"
#include "src/base/parallel_for.h"

namespace relievo {

namespace {

// What gridErrors() returned for a patch. A grid whose blocks are alike takes one: that is all grids of a patch which
// lies on the scan, and most patches of scans that are their own base do.
class PatchErrors {
 public:
  PatchErrors() = default;
  explicit PatchErrors(const std::vector<GridErrors>& grids) {
    for (size_t log2 = 0; log2 < grids.size(); ++log2) {
      const GridErrors& grid = grids[log2];
      const bool alike =
          std::all_of(grid.mm.begin(), grid.mm.end(), [&](float mm) { return mm == grid.mm[0]; }) &&
          std::all_of(grid.shapes.begin(), grid.shapes.end(), [&](const auto& s) { return s == grid.shapes[0]; });
      if (alike) alike_ |= uint32_t{1} << log2;
      const size_t kept = alike ? 1 : grid.mm.size();
      mm_.insert(mm_.end(), grid.mm.begin(), grid.mm.begin() + static_cast<std::ptrdiff_t>(kept));
      shapes_.insert(shapes_.end(), grid.shapes.begin(), grid.shapes.begin() + static_cast<std::ptrdiff_t>(kept));
    }
    mm_.shrink_to_fit();
    shapes_.shrink_to_fit();
  }
  GridErrors grid(int log2) const {
    const size_t at = before(log2), blocks = blocksOf(log2);
    if (isAlike(log2)) return {std::vector(blocks, mm_[at]), std::vector(blocks, shapes_[at])};
    const auto first = static_cast<std::ptrdiff_t>(at), last = static_cast<std::ptrdiff_t>(at + blocks);
    return {{mm_.begin() + first, mm_.begin() + last}, {shapes_.begin() + first, shapes_.begin() + last}};
  }
  float largest(int log2) const {
    const auto first = mm_.begin() + static_cast<std::ptrdiff_t>(before(log2));
    return *std::max_element(first, first + static_cast<std::ptrdiff_t>(isAlike(log2) ? 1 : blocksOf(log2)));
  }

 private:
  static size_t blocksOf(int log2) {
    const auto side = static_cast<size_t>(errorBlocksPerSide(log2));
    return side * side;
  }
  bool isAlike(int log2) const { return alike_ >> log2 & 1; }
  size_t before(int log2) const {
    size_t at = 0;
    for (int k = 0; k < log2; ++k) at += isAlike(k) ? 1 : blocksOf(k);
    return at;
  }
  uint32_t alike_ = 0;  // bit log2
  std::vector<float> mm_;
  std::vector<DeviationShape> shapes_;
};

}  // namespace

struct MeshBake::Impl {
  BakeContext context;
  BakedHeights baked;
  std::vector<uint16_t> exact;  // as they were baked, where those of `baked` are not
  BakeTexture texture;
  std::once_flag made_frames;  // of the texture, once texels are asked for
  BakeReport report;
  bool flat = false;                // MeshBake::isFlat()
  std::vector<PatchErrors> errors;  // for each patch, or one for all
  const PatchErrors& errorsOf(uint32_t patch) const { return errors[errors.size() == 1 ? 0 : patch]; }
  double error_unit_mm = 0;
  bool always_errors = true;

  // False: interrupted.
  bool findErrors(const std::function<void(double)>& progress);
  Impl(const TriMesh& mesh, const BaseMesh& base) : context(mesh, base) {}
};

namespace {

Error interruptedError() { return {ErrorKind::kInterrupted, "", "interrupted", ""}; }

Result<void> validate(const TriMesh& mesh, std::span<const MeshBake::Image> images, const BaseMesh& base,
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
  for (const MeshBake::Image& image : images) {
    if (image.texels.empty()) return usage("an image has no texels");
    if (image.planes && mesh.corner_uv.empty()) return usage("the mesh has no texture coordinates for the planes");
    if (image.planes && images.size() > 1) return usage("there are planes beside other images");
    if (!image.planes && image.channels != 3) return usage("an image of colours has three channels");
    if (!image.normals.empty() && (image.planes || image.palette))
      return usage("planes, or a palette, have a map of normals");
  }
  for (const uint16_t image : mesh.image_of)
    if (!images.empty() && image != kNoImage && image >= images.size())
      return usage("a triangle shows image " + std::to_string(image) + ", there are " + std::to_string(images.size()));
  if (auto problem = baseMeshProblem(base); !problem.empty())
    return Error{ErrorKind::kInvalidData, "", "base mesh: " + problem, ""};
  return {};
}

// The texture: the images if the mesh has texture coordinates for them, or needs none.
BakeTexture textureOf(const TriMesh& mesh, std::span<const MeshBake::Image> images) {
  BakeTexture texture;
  texture.one_colour =
      images.size() == 1 && images[0].palette && images[0].width * images[0].height == 1 && mesh.image_of.empty();
  if (mesh.corner_uv.empty() && !texture.one_colour) return texture;
  for (const MeshBake::Image& image : images) {
    texture.planes = image.planes;
    BakeTexture::Image& own = texture.images.emplace_back();
    own.texels =
        MipImage(image.width, image.height, image.channels, image.texels, image.planes ? 16 : 0, image.repeats);
    own.palette = image.palette;
    own.has_file = image.has_file;
    own.normals_downwards = image.normals_downwards;
    own.places = {image.placeWidth(), image.placeHeight()};
    if (!image.normals.empty())
      own.normals = MipImage(image.normals_width, image.normals_height, 3, image.normals, 0, image.repeats);
  }
  return texture;
}

// The errors of each patch's grids (gridErrors()). What grids leave out between samples is left out here, too, where it
// is a small share of the tolerance. Of the first `patches` ones. Empty: the bake was interrupted.
std::vector<PatchErrors> errorsOfPatches(const BakeContext& context, const BakedHeights& baked, size_t patches,
                                         double tolerance_mm, const std::function<void(double)>& progress) {
  // Of the tolerance, and of the shapes, which packages round to sevenths. Packages keep no shape of errors up to half
  // the RMS that is aimed at (PatchSource::slightErrorMm()).
  constexpr double kNegligible = 1.0 / 16, kNegligibleTurn = 1.0 / 16, kSlight = 0.15;
  struct Scratch {
    std::vector<SurfaceGrid> grids;  // by cells_log2
    GridErrorScratch errors;
  };
  std::vector<PatchErrors> errors(patches);
  const bool done = parallelForWith(
      patches, context.workers, context.interrupted, [&] { return Scratch{}; },
      [&](Scratch& s, size_t p) {
        const BetweenSamples between = baked.betweenSamples(context, static_cast<uint32_t>(p));
        PatchNormals normals{.corners = {}, .cut = context.base.cut};
        for (size_t k = 0; k < 4; ++k) normals.corners[k] = context.base.corners[context.base.patches[p][k]].normal;
        std::vector<GridErrors> found;
        auto from = [&](int log2) {
          for (int k = static_cast<int>(s.grids.size()); k <= log2; ++k) s.grids.emplace_back(k);
          SurfaceGrid& grid = s.grids[static_cast<size_t>(log2)];
          baked.surface(context, static_cast<uint32_t>(p), grid);
          found = gridErrors(grid, between, normals, s.errors);
        };
        const int coarsest = between.coarsestWithin(kNegligible * tolerance_mm);
        from(coarsest);
        int log2 = coarsest;
        // Of slight errors it matters to nobody where they point.
        if (found[0].mm[0] > kSlight * tolerance_mm)
          while (log2 < between.finest_log2 && between.normalChange(log2) > kNegligibleTurn) ++log2;
        if (log2 > coarsest) from(log2);
        errors[p] = PatchErrors(found);
      },
      [&](size_t taken) {
        if (progress) progress(static_cast<double>(taken) / static_cast<double>(patches));
      });
  if (!done) errors.clear();
  return errors;
}

// The unit in which the largest error fits into 16 bits.
double errorUnit(const std::vector<PatchErrors>& errors, double relief_scale_mm) {
  float largest = 0;
  for (const PatchErrors& of_patch : errors) largest = std::max(largest, of_patch.largest(kPageCellsLog2));
  return largest > 0           ? static_cast<double>(largest) / 65535.0 * (1 + 1e-9)
         : relief_scale_mm > 0 ? relief_scale_mm
                               : 1.0;
}

}  // namespace

bool MeshBake::Impl::findErrors(const std::function<void(double)>& progress) {
  errors = errorsOfPatches(context, baked, flat ? 1 : context.base.patches.size(), report.tolerance_mm, progress);
  if (errors.empty()) return false;
  error_unit_mm = errorUnit(errors, baked.scale_mm);
  return true;
}

Result<BakeScene> makeBakeScene(const TriMesh& mesh, const BakeSceneOptions& options) {
  BakeScene out;
  const bool rasterise = mesh.triangles.size() >= options.rasterise_from_triangles;
  auto rays = RayScene::create(mesh, {.interrupted = options.interrupted,
                                      .region_triangles = options.region_triangles,
                                      .budget_bytes = options.ray_bytes,
                                      .at_once = !rasterise});
  if (!rays) return rays.error();
  out.rays = std::move(*rays);
  if (rasterise) out.rasteriser = std::make_shared<const LineRasteriser>(mesh, options.workers);
  out.rasterise_from_per_patch = options.rasterise_from_per_patch;
  CornerNormals normals;
  if (!makeCornerNormals(mesh, options.workers, options.interrupted, normals)) return interruptedError();
  out.normals = std::make_shared<const CornerNormals>(std::move(normals));
  return out;
}

MeshBake::MeshBake(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
MeshBake::~MeshBake() = default;
const TriMesh& MeshBake::mesh() const { return *impl_->context.mesh; }
const BaseMesh& MeshBake::base() const { return impl_->context.base; }
const BakeReport& MeshBake::report() const { return impl_->report; }
int MeshBake::textureDepth() const { return impl_->report.texture_depth; }
int MeshBake::textureDepthOf(uint32_t patch) const { return impl_->texture.of_patch[patch].depth; }
std::vector<bool> MeshBake::shownImages() const {
  std::vector<bool> shown;
  for (const BakeTexture::Image& image : impl_->texture.images) shown.push_back(image.shown);
  return shown;
}
bool MeshBake::showsImages() const {
  const auto& patches = impl_->texture.of_patch;
  return std::any_of(patches.begin(), patches.end(),
                     [](const PatchResolution& r) { return r.shown_depth.has_value(); });
}
std::optional<ImagesOnPatch> MeshBake::imagesOn(uint32_t patch) const {
  const std::optional<int> depth = impl_->texture.of_patch[patch].shown_depth;
  if (!depth) return std::nullopt;
  ImagesOnPatch on = imagesOnPatch(impl_->context, impl_->texture, patch);
  on.depth = *depth;
  return on;
}
int MeshBake::reliefDepth() const { return impl_->baked.reliefDepth(); }
double MeshBake::reliefOffsetMm() const { return impl_->baked.offset_mm; }
double MeshBake::reliefScaleMm() const { return impl_->baked.scale_mm; }
double MeshBake::errorUnitMm() const { return impl_->error_unit_mm; }
bool MeshBake::isFlat() const { return impl_->flat; }
bool MeshBake::isEven() const {
  return impl_->baked.allAlike() && std::all_of(impl_->errors.begin(), impl_->errors.end(),
                                                [](const PatchErrors& e) { return e.largest(0) == 0; });
}

Result<std::unique_ptr<MeshBake>> MeshBake::create(const TriMesh& mesh, std::span<const Image> images,
                                                   const BaseMesh& base, const BakeOptions& requested,
                                                   BakeScene scene) {
  const auto started = std::chrono::steady_clock::now();
  BakeOptions options = requested;
  if (requested.progress) {  // progress must not run backwards when several grids are tried
    options.progress = [&requested, most = 0.0](double done) mutable {
      requested.progress(most = std::max(most, done));
    };
  }
  auto progress = [&](double done) {
    if (options.progress) options.progress(done);
  };
  if (auto sound = validate(mesh, images, base, options); !sound) return sound.error();
  auto impl = std::make_unique<Impl>(mesh, base);
  impl->context.workers = options.workers;
  impl->context.interrupted = options.interrupted;
  impl->context.touching = options.touching;
  impl->context.touch_mm = options.touch_mm;
  impl->texture = textureOf(mesh, images);
  if (!scene.rays) {
    auto made = makeBakeScene(mesh, {.workers = options.workers, .interrupted = options.interrupted});
    if (!made) return made.error();
    scene = std::move(*made);
  }
  impl->context.scene = std::move(scene.rays);
  const size_t from_per_patch = (base.cut ? BakeSceneOptions::kCutTimes : 1) * scene.rasterise_from_per_patch;
  if (mesh.triangles.size() / base.patches.size() >= from_per_patch)
    impl->context.rasteriser = std::move(scene.rasteriser);
  impl->context.normals = std::move(scene.normals);
  if (base.cut && options.touch_mm > 0 && !impl->context.findOwnTriangles()) return interruptedError();
  progress(0.3);

  auto baked = searchHeights(impl->context, options, impl->report);
  if (!baked) return baked.error();
  impl->baked = std::move(*baked);
  impl->flat = base.cut && impl->baked.allAlike() && impl->baked.offset_mm == 0;
  if (!chooseTextureResolution(impl->context, {options.texture_depth, options.tail_textures, options.show_images},
                               impl->texture))
    return interruptedError();
  impl->report.texture_depth = impl->texture.depth;
  impl->always_errors = options.errors;
  if (options.errors && !impl->findErrors([&](double done) { progress(0.9 + 0.1 * done); })) return interruptedError();
  if (auto sound = impl->context.scene->status(); !sound) return sound.error();
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
  auto made = step > 1 ? steppedHeights(b.context, b.exact, b.baked.cells_log2, step) : std::optional(b.exact);
  if (!made) return interruptedError();
  b.baked.samples = std::move(*made);
  b.baked.step = step;
  b.errors.clear();
  return b.always_errors ? findErrors() : Result<void>();
}

double MeshBake::stepChangeMm() const {
  const Impl& b = *impl_;
  if (b.baked.step == 1) return 0;
  return b.baked.scale_mm * rmsOfChange(b.context, b.exact, b.baked.samples, b.baked.cells_log2);
}

Result<void> MeshBake::findErrors() { return impl_->findErrors({}) ? Result<void>() : interruptedError(); }

void MeshBake::surface(uint32_t patch, SurfaceGrid& out) const { impl_->baked.surface(impl_->context, patch, out); }

BetweenSamples MeshBake::betweenSamples(uint32_t patch) const {
  return impl_->baked.betweenSamples(impl_->context, patch);
}

void MeshBake::heightsOfGrid(uint32_t patch, int cells_log2, std::span<uint16_t> out) const {
  impl_->baked.grid(impl_->context, patch, cells_log2, out);
}

Result<void> MeshBake::heights(uint32_t patch, std::span<uint16_t> out) const {
  impl_->baked.finest(impl_->context, patch, out);
  return {};
}

GridErrors MeshBake::errorsOfGrid(uint32_t patch, int cells_log2) const {
  return impl_->errorsOf(patch).grid(cells_log2);
}
float MeshBake::errorOfGrid(uint32_t patch, int cells_log2) const { return impl_->errorsOf(patch).largest(cells_log2); }

Result<void> MeshBake::texels(uint32_t patch, std::span<uint8_t> out) const {
  Impl& b = *impl_;
  std::call_once(b.made_frames, [&] { b.texture.frames = tangentFrames(b.context, b.texture); });
  return bakeTexels(b.context, b.baked, b.texture, b.report.deviation_mm, patch, out) ? Result<void>()
                                                                                      : interruptedError();
}

}  // namespace relievo
