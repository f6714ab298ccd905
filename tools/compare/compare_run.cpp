#include "tools/compare/compare_run.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <unordered_set>

#include "geometry/strategies/encoded_parts.h"
#include "geometry/strategies/strategy_bounds.h"
#include "src/engine/lod_views.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/relief_subslots.h"
#include "tools/compare/compare_path.h"
#include "tools/compare/compare_scene.h"

namespace relievo {
namespace {

constexpr int kCrackMarginPx = 1;

double nowMs() {
  return 1000 * std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

Timing timingOf(std::vector<double> ms) {
  if (ms.empty()) return {};
  std::sort(ms.begin(), ms.end());
  return {ms[ms.size() / 2], ms.front(), ms.back()};
}

class Runner {
 public:
  Runner(const ComparePlan& plan, const gl::ContextInfo& context, CompareScene scene,
         std::unique_ptr<StrategyPass> pass, std::vector<CompareCamera> cameras)
      : plan_(plan),
        context_(context),
        scene_(std::move(scene)),
        pass_(std::move(pass)),
        cameras_(std::move(cameras)),
        bounds_(scene_.strategy),
        surface_(
            surfaceOf(scene_.strategy, plan.measured_exaggerate != 0 ? plan.measured_exaggerate : plan.exaggerate)) {
    pass_->resize(plan.width_px, plan.height_px);
  }

  Result<CompareFigures> run() {
    CompareFigures figures;
    figures.renderer = context_.renderer;
    figures.version = context_.version;
    figures.picture_frame = static_cast<int>(cameras_.size() / 2);
    figures.frame_count = cameras_.size();
    figures.relief_pages = scene_.pages;
    figures.relief_bytes = scene_.pages * partBytes(kReliefPartLevel);
    std::vector<Running> running;
    for (const StrategyEntry* s : plan_.strategies)
      for (double budget : plan_.budgets_px) {
        StrategyFigures f;
        f.strategy = s;
        f.budget_px = budget;
        f.why_not = whyNotAvailable(*s);
        f.available = f.why_not.empty();
        running.push_back({f.available ? s->make(scene_.strategy) : nullptr, {}});
        figures.runs.push_back(std::move(f));
      }
    double steps = static_cast<double>(cameras_.size() * (running.size() + 1)), step = 0;
    for (size_t frame = 0; frame < cameras_.size(); ++frame) {
      auto tell = [&](const std::string& what) {
        if (plan_.progress)
          plan_.progress(step / steps,
                         "frame " + std::to_string(frame + 1) + " of " + std::to_string(cameras_.size()) + ", " + what);
        ++step;
      };
      Frame now = frameOf(cameras_[frame].now);
      tell("full resolution");
      if (auto done = drawReference(now, figures); !done) return done.error();
      for (size_t r = 0; r < running.size(); ++r) {
        if (plan_.interrupted && *plan_.interrupted)
          return Error{ErrorKind::kInterrupted, "", "interrupted: no report was written", "", {}};
        StrategyFigures& f = figures.runs[r];
        tell(f.strategy->name);
        if (!f.available) continue;
        bool shown = static_cast<int>(frame) == figures.picture_frame;
        if (auto done = measure(running[r], f, cameras_[frame], now, shown); !done) return done.error();
      }
    }
    return figures;
  }

 private:
  struct Running {
    std::unique_ptr<LodStrategy> strategy;
    // What the frame before drew from: pages, or parts of a mesh.
    std::unordered_set<NodeId> pages;
    std::shared_ptr<const StrategyMesh> mesh;
    std::vector<uint32_t> parts;
  };

  // What the choice draws from, encoded, and what of it the frame before did not.
  void countBytes(const StrategyResult& chosen, Running& running, FrameFigures& f) const {
    auto count = [&](uint32_t bytes, float decode_ms, bool known) {
      f.cold_bytes += bytes;
      f.cold_decode_ms += decode_ms;
      if (!known) f.streamed_bytes += bytes;
    };
    if (chosen.mesh) {
      f.resident_bytes = chosen.mesh->gpuBytes();
      std::vector<uint32_t> parts = partsOf(*chosen.mesh, chosen.ranges);
      const bool same_mesh = chosen.mesh == running.mesh;
      for (const uint32_t p : parts)
        count(chosen.mesh->parts[p].encoded_bytes, chosen.mesh->parts[p].decode_ms,
              same_mesh && std::binary_search(running.parts.begin(), running.parts.end(), p));
      running.mesh = chosen.mesh;
      running.parts = std::move(parts);
      return;
    }
    std::unordered_set<NodeId> pages;
    for (const PatchInstance& p : chosen.instances) pages.insert(p.relief_page);
    f.resident_bytes = pages.size() * partBytes(kReliefPartLevel);
    for (const NodeId& page : pages) {
      const CompareScene::Encoded& encoded = scene_.encoded.at(page);
      count(encoded.bytes, encoded.decode_ms, running.pages.count(page) > 0);
    }
    running.pages = std::move(pages);
  }

  static std::unique_ptr<CompareSurface> surfaceOf(const StrategyScene& scene, double exaggerate) {
    if (scene.domain.isFlat()) return std::make_unique<PlanarSurface>(*scene.field, exaggerate);
    return std::make_unique<BodySurface>(*scene.body, exaggerate);
  }
  Frame frameOf(const OrbitCamera& camera) const {
    return {viewTransform(camera, artworkExtent(plan_.package->manifest(), plan_.exaggerate), plan_.width_px,
                          plan_.height_px),
            plan_.width_px, plan_.height_px};
  }
  LodView lodViewOf(const Frame& frame, double budget_px) const {
    LodView v = lodViewFrom(frame.view);
    v.error_px = budget_px;
    v.min_cell_px = plan_.least_cell * budget_px;  // as the engine has it
    v.exaggerate = plan_.exaggerate;
    return v;
  }

  std::string whyNotAvailable(const StrategyEntry& s) const {
    if (s.needs_tessellation && !StrategyPass::hasTessellation(context_.api)) return "needs OpenGL 4";
    if (s.flat_only && scene_.strategy.body) return "for flat artworks only";
    return "";
  }

  Result<void> drawReference(const Frame& now, CompareFigures& figures) {
    const ViewBounds screen(lodViewFrom(now.view));
    const ReferenceGrid grid = referenceGrid(bounds_, screen, plan_.exaggerate, plan_.reference_triangles);
    const StrategyResult& all = grid.drawn;
    figures.reference_whole = figures.reference_whole && grid.whole;
    reference_bound_px_ = bounds_.boundPx(screen, all.instances, plan_.exaggerate);
    figures.reference_bound_px = std::max(figures.reference_bound_px, reference_bound_px_);
    auto drawn = pass_->draw(all, now.view, plan_.exaggerate);
    if (!drawn) return drawn.error();
    pass_->read(pixels_);
    reference_ = coverage(pixels_);
    figures.reference_triangles = std::max(figures.reference_triangles, drawn->triangles);
    errorVectors(*surface_, all.instances, now, pixels_, errors_);
    ErrorFigures floor = figuresOf(errors_);
    if (floor.max_px >= figures.floor.max_px) figures.floor = floor;
    return {};
  }

  Result<void> measure(Running& running, StrategyFigures& out, const CompareCamera& camera, const Frame& now,
                       bool shown) {
    FrameFigures f;
    Frame before = frameOf(camera.before);
    // What the frame before would have drawn, seen by this frame's camera.
    StrategyResult earlier = running.strategy->select(lodViewOf(before, out.budget_px));

    LodView view = lodViewOf(now, out.budget_px);
    StrategyResult chosen;
    std::vector<double> select_ms, frame_ms;
    double began = nowMs();
    auto another = [&](int k) { return k == 0 || (k < plan_.repeats && nowMs() - began < 1000 * plan_.repeat_s); };
    for (int k = 0; another(k); ++k) {
      double start = nowMs();
      chosen = running.strategy->select(view);
      select_ms.push_back(nowMs() - start);
    }
    // The same again, if no vertex of it moves with the eye, looks the same.
    const bool changed = chosen.rule == GridRule::kMorphed ||
                         (chosen.rule == GridRule::kTrianglesOnly && !chosen.mesh) || chosen.rule != earlier.rule ||
                         chosen.mesh != earlier.mesh || chosen.ranges != earlier.ranges ||
                         chosen.instances != earlier.instances;
    if (changed) {
      if (auto drawn = pass_->draw(earlier, now.view, plan_.exaggerate); !drawn) return drawn.error();
      pass_->read(pixels_);
      errorVectors(*surface_, earlier.instances, now, pixels_, errors_before_);
    }
    StrategyDraw last;
    // A mesh that the GPU keeps is uploaded once, which is no frame's time.
    if (chosen.mesh)
      if (auto drawn = pass_->draw(chosen, now.view, plan_.exaggerate); !drawn) return drawn.error();
    began = nowMs();
    for (int k = 0; another(k); ++k) {
      StrategyPass::finish();
      double start = nowMs();
      auto drawn = pass_->draw(chosen, now.view, plan_.exaggerate);
      if (!drawn) return drawn.error();
      StrategyPass::finish();
      frame_ms.push_back(nowMs() - start);
      last = *drawn;
    }
    f.select_ms = timingOf(std::move(select_ms));
    f.frame_ms = timingOf(std::move(frame_ms));
    f.triangles = last.triangles;
    f.draw_calls = last.draw_calls;
    f.instances = static_cast<uint32_t>(chosen.instances.size());
    f.budget_px = chosen.error_px;
    f.predicted_px = chosen.predicted_px;

    pass_->read(pixels_);
    f.edge_on_pixels = errorVectors(*surface_, chosen.instances, now, pixels_, errors_);
    f.error = figuresOf(errors_);
    f.pop_px = changed ? largestChangePx(errors_before_, errors_) : 0;
    // Where the silhouette may lie elsewhere by right, the background is no crack.
    int margin = kCrackMarginPx + static_cast<int>(std::ceil(std::clamp(
                                      std::max(chosen.predicted_px, out.budget_px) + reference_bound_px_, 0.0, 1e4)));
    f.coverage = compareCoverage(coverage(pixels_), reference_, plan_.width_px, plan_.height_px, margin);
    auto captured = pass_->capture(chosen, now.view, plan_.exaggerate, plan_.seam_vertices);
    if (!captured) return captured.error();
    f.seams_known = !captured->empty();
    if (f.seams_known) {
      const StrategyScene& scene = scene_.strategy;
      f.seams = scene.domain.isFlat()
                    ? compareSeams(scene.domain.flat(), chosen.instances, *captured)
                    : compareSeams(*scene.body->base, bounds_.unitLog2(), chosen.instances, *captured);
    }

    countBytes(chosen, running, f);
    if (shown) keepPicture(chosen, now, out);
    out.frames.push_back(f);
    return {};
  }

  void keepPicture(const StrategyResult& chosen, const Frame& now, StrategyFigures& out) const {
    const float none = std::numeric_limits<float>::quiet_NaN();
    out.picture_error_px.assign(errors_.size(), none);
    out.picture_shade.assign(errors_.size(), 0);
    glm::dvec3 light = glm::normalize(glm::dvec3(-0.6, 0.5, 0.6));
    if (scene_.strategy.body) light = now.view.world_from_camera * light;  // bodies are seen from everywhere
    for (size_t i = 0; i < errors_.size(); ++i) {
      if (std::isnan(errors_[i].x)) continue;
      out.picture_error_px[i] = glm::length(errors_[i]);
      const PatchInstance& p = chosen.instances[pixels_[i][2] - 1];
      double u = std::bit_cast<float>(pixels_[i][0]), v = std::bit_cast<float>(pixels_[i][1]);
      // The relief's slope over about a pixel.
      glm::dvec3 here = surface_->finestPointMm(p, u, v);
      double mm = (now.view.orthographic ? 1 : glm::length(here - now.view.eye_mm)) / now.view.pixels_per_radian;
      double step = mm / (surface_->mmPerUnit(p) * std::ldexp(1.0, p.step_log2 + p.grid_level));
      glm::dvec3 along = surface_->finestPointMm(p, u + step, v) - surface_->finestPointMm(p, u - step, v);
      glm::dvec3 down = surface_->finestPointMm(p, u, v + step) - surface_->finestPointMm(p, u, v - step);
      glm::dvec3 normal = glm::cross(down, along);
      double length = glm::length(normal);
      out.picture_shade[i] =
          static_cast<float>(length > 0 ? 0.25 + 0.75 * std::max(0.0, glm::dot(normal, light) / length) : 0.6);
    }
  }

  const ComparePlan& plan_;
  gl::ContextInfo context_;
  CompareScene scene_;
  std::unique_ptr<StrategyPass> pass_;
  std::vector<CompareCamera> cameras_;
  ReliefBounds3d bounds_;
  std::unique_ptr<CompareSurface> surface_;
  PlacePixels pixels_;
  ErrorVectors errors_, errors_before_;
  std::vector<uint8_t> reference_;
  double reference_bound_px_ = 0;  // of the frame's
};

}  // namespace

Result<CompareFigures> runCompare(const ComparePlan& plan, const gl::ContextInfo& context) {
  Result<std::vector<CompareCamera>> cameras = plan.cameras;
  if (plan.cameras.empty())
    cameras = compareCameras(plan.path, plan.frames, plan.package->manifest(), plan.width_px, plan.height_px);
  if (!cameras) return cameras.error();
  std::unique_ptr<StrategyPass> pass;
  auto scene = loadCompareScene(plan.package, plan.memory_bytes, context.api, &pass, plan.interrupted);
  if (!scene) return scene.error();
  return Runner(plan, context, std::move(*scene), std::move(pass), std::move(*cameras)).run();
}

}  // namespace relievo
