// bench_shader.cpp - what the virtual texture's look-up costs: the shading pass with its page table and pool, against
// the same shader, filters and shading with plain mip-mapped textures (define DENSE). All of the texture is resident on
// both sides, the artwork is flat and fills 1280x720 px. On software GL a time is the processor time of all threads, on
// a GPU the wall's.
#include <cmath>
#include <cstdio>
#include <ctime>
#include <memory>

#include "geometry/lod/planar_lod.h"
#include "src/engine/effect_plan.h"
#include "src/engine/lod_views.h"
#include "src/gl/context.h"
#include "src/render/camera.h"
#include "src/render/dense_levels.h"
#include "src/render/page_pool.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"
#include "texturing/codec/page_codec.h"
#include "tools/bench/bench_groups.h"

namespace relievo {
namespace {

constexpr int kMaxDepth = 4;  // 2048 texels a side

struct FlatOracle final : ReliefOracle {
  HeightBounds bounds(const NodeId&) const override { return {}; }
};

// The first patch of the package, down to a level that dense textures can hold, resident in both ways.
struct BothTextures {
  Manifest manifest;
  std::unique_ptr<PagePool> pool;
  std::unique_ptr<PageTable> table;
  std::unique_ptr<DenseLevels> dense;
};

Result<BothTextures> loadBoth(const Package& package) {
  BothTextures both;
  both.manifest = package.manifest();
  const FlatDomain whole = both.manifest.domain.flat();
  const int depth = std::min(whole.texture_depth, kMaxDepth), planes = both.manifest.texture.planes();
  FlatDomain d;
  d.width_px = std::min<uint64_t>(whole.levelWidth(depth), kPagePx << depth);
  d.height_px = std::min<uint64_t>(whole.levelHeight(depth), kPagePx << depth);
  d.texture_depth = depth;
  both.manifest.domain = d;
  std::vector<NodeId> nodes;
  for (uint32_t level = 0; level <= static_cast<uint32_t>(depth); ++level)
    for (uint32_t y = 0; y < 1u << level; ++y)
      for (uint32_t x = 0; x < 1u << level; ++x)
        if (whole.nodeExists({0, level, x, y})) nodes.push_back({0, level, x, y});
  both.pool = std::make_unique<PagePool>(static_cast<uint32_t>(nodes.size() * static_cast<size_t>(planes)));
  both.table = std::make_unique<PageTable>(static_cast<uint32_t>(nodes.size()), planes);
  both.dense = std::make_unique<DenseLevels>(depth, planes);
  PageDecoder decoder;
  std::vector<uint8_t> texels(kSlotBytes);
  SlotIndex slot = 0;
  for (const NodeId& node : nodes) {
    PageTableEntry entry;
    for (int k = 0; k < planes; ++k, ++slot) {
      const PageId id(texturePlane(k), node);
      auto page = package.read(id);
      if (!page) return page.error();
      if (auto decoded = decoder.decodeToSlot(id.plane(), page->bytes, texels); !decoded) return decoded.error();
      const PageUpload upload{slot, id, texels.data()};
      both.pool->upload({&upload, 1});
      both.dense->upload(static_cast<int>(node.level), k, node.x, node.y, texels);
      entry.slots[static_cast<size_t>(k)] = static_cast<uint16_t>(slot);
    }
    both.table->insert(node, entry);
  }
  both.pool->uploadTable(*both.table);
  return both;
}

enum class Texture { kVirtual, kDense };

// The artwork as it is seen, to be shaded from either texture.
class ShadedView {
 public:
  explicit ShadedView(BothTextures both) : both_(std::move(both)) {}

  // What is seen is the same for both textures, and is not timed.
  Result<void> drawSurface();
  // What one shading takes.
  double seconds(const gl::Program& program, Texture from, bool linear) {
    finishFrame();
    const double start = info_.software ? benchCpuSeconds() : benchSeconds();
    target_.begin();
    program.use();
    both_.pool->bind(program, *both_.table);
    patches_.bindInstances(program, 3);
    surface_.bind(program, 4);
    if (from == Texture::kDense) both_.dense->bind(program, linear);
    setShadingUniforms(
        program, {.format = &both_.manifest.texture, .domain = &both_.manifest.domain, .light = frontLight(-0.5, 0.3)});
    screen_.draw(true);
    finishFrame();
    return (info_.software ? benchCpuSeconds() : benchSeconds()) - start;
  }
  std::vector<uint8_t> picture() const { return target_.readPixels(); }
  const Manifest& manifest() const { return both_.manifest; }
  const gl::ContextInfo& info() const { return info_; }

 private:
  BothTextures both_;
  const gl::ContextInfo info_ = gl::currentContextInfo();
  PatchPass patches_;
  SurfaceTarget surface_;
  ScreenPass screen_;
  PictureTarget target_;
};

// Somewhat askew, so that levels change over the picture; on the average two levels take part.
OrbitCamera askew(const FlatDomain& d) {
  OrbitCamera camera;
  camera.azimuth_deg = 12;
  camera.elevation_deg = 8;
  const double texels_per_px =
      0.7 * std::min(static_cast<double>(d.width_px) / kBenchWidth, static_cast<double>(d.height_px) / kBenchHeight);
  camera.distance_mm = texels_per_px * kBenchHeight / (2 * std::tan(camera.fov_deg * 3.14159265358979 / 360));
  return camera;
}

Result<void> ShadedView::drawSurface() {
  const FlatDomain d = both_.manifest.domain.flat();
  const ViewTransform view = viewTransform(askew(d), d, 0, 0, kBenchWidth, kBenchHeight);
  LodView lod = lodViewFrom(view);
  lod.relief = false;
  const auto instances = selectPlanarLod(d, FlatOracle(), lod, {}).instances;
  const EyeFrame eye = eyeFrame(view, d, 1, false, depthMode());
  patches_.setInstances(instances, eye, false, [](const NodeId&) { return kNoSlot; });
  surface_.resize(kBenchWidth, kBenchHeight, false);
  Scene flat;
  flat.relief = false;
  auto surface_program = gl::Program::link(
      info_.api, {"patch.vert", "surface.frag", planEffects(flat, both_.manifest).defines(), patchAttributes(), {}});
  if (!surface_program) return surface_program.error();
  surface_.begin();
  surface_program->use();
  setShadingUniforms(*surface_program, {.format = &both_.manifest.texture, .domain = &both_.manifest.domain});
  patches_.draw(*surface_program, eye, PatchPass::Mesh::kFull);
  target_.resize(kBenchWidth, kBenchHeight, surface_.depth());
  return {};
}

struct Case {
  const char* what;
  Sampling sampling;
  Filter filter;
  bool goal;
};
constexpr Case kCases[] = {{"bilinear, exact filter", Sampling::kBilinear, Filter::kExact, true},
                           {"trilinear, exact filter", Sampling::kTrilinear, Filter::kExact, true},
                           {"bilinear, fast filter", Sampling::kBilinear, Filter::kFast, true},
                           {"trilinear, fast filter", Sampling::kTrilinear, Filter::kFast, true},
                           {"nearest", Sampling::kNearest, Filter::kExact, false}};

// The two are the same picture, or the comparison says nothing.
struct Difference {
  int most = 0;           // of 255
  size_t background = 0;  // pixels that the artwork does not cover
};
Difference compare(ShadedView& view, const gl::Program& of_virtual, const gl::Program& of_dense, bool linear) {
  view.seconds(of_virtual, Texture::kVirtual, linear);
  const auto virtual_pixels = view.picture();
  view.seconds(of_dense, Texture::kDense, linear);
  const auto dense_pixels = view.picture();
  Difference out;
  for (size_t i = 0; i < dense_pixels.size(); ++i) {
    out.most = std::max(out.most, std::abs(int{dense_pixels[i]} - int{virtual_pixels[i]}));
    out.background += i % 4 == 3 && dense_pixels[i] == 0;
  }
  return out;
}

Result<void> shadingRow(BenchContext& context, ShadedView& view, const Case& c) {
  Scene scene;
  scene.relief = false;
  scene.sampling = c.sampling;
  scene.filter = c.filter;
  gl::Defines defines = planEffects(scene, view.manifest()).defines();
  auto virtual_program = gl::Program::link(view.info().api, {"screen.vert", "shade.frag", defines, {"a_corner"}, {}});
  if (!virtual_program) return virtual_program.error();
  defines.emplace_back("DENSE", "1");
  auto dense_program = gl::Program::link(view.info().api, {"screen.vert", "shade.frag", defines, {"a_corner"}, {}});
  if (!dense_program) return dense_program.error();
  const bool linear = c.filter == Filter::kFast;
  const Difference difference = compare(view, *virtual_program, *dense_program, linear);
  std::vector<double> of_virtual, of_dense, ratios;
  const int repetitions = context.quick ? 9 : 31;
  for (int i = 0; i < repetitions && !context.stopped(); ++i) {
    of_virtual.push_back(1000 * view.seconds(*virtual_program, Texture::kVirtual, linear));
    of_dense.push_back(1000 * view.seconds(*dense_program, Texture::kDense, linear));
    ratios.push_back(of_virtual.back() / of_dense.back());
  }
  char note[200];
  std::snprintf(note, sizeof note, "%s: virtual %.1f ms, dense %.1f ms; pictures differ by %d/255 at most%s",
                view.info().software ? "processor time" : "wall time", median(of_virtual), median(of_dense),
                difference.most, difference.background ? "; the artwork does not fill the view" : "");
  BenchRow row;
  row.what = std::string(basisName(view.manifest().texture.basis)) + ", " + c.what;
  row.measured = median(ratios);
  row.unit = "x";
  if (c.goal) row.goal = 1.4;
  row.baseline_name = "the same shader with dense textures";
  row.baseline = 1;
  row.note = note;
  context.row(row);
  return {};
}

}  // namespace

Result<void> shaderBench(BenchContext& context) {
  auto both = loadBoth(*context.package);
  if (!both) return both.error();
  ShadedView view(std::move(*both));
  if (auto drawn = view.drawSurface(); !drawn) return drawn;
  for (const Case& c : kCases) {
    if (context.stopped()) return {};
    if (auto done = shadingRow(context, view, c); !done) return done;
  }
  return {};
}

}  // namespace relievo
