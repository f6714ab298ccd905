#include "src/engine/engine.h"

#include <algorithm>
#include <cassert>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <optional>
#include <thread>
#include <utility>

#include <glm/gtc/matrix_transform.hpp>

#include "geometry/lod/lod_worker.h"
#include "src/artwork/basis.h"
#include "src/engine/drawn_list.h"
#include "src/engine/fault_injection.h"
#include "src/engine/lod_views.h"
#include "src/engine/prefetch.h"
#include "src/engine/resident_planes.h"
#include "src/engine/scene_lights.h"
#include "src/engine/shading_programs.h"
#include "src/engine/standstill.h"
#include "src/engine/surface_shading.h"
#include "src/engine/texture_demand.h"
#include "src/gl/program.h"
#include "src/render/base_corners.h"
#include "src/render/block_formats.h"
#include "src/render/depth_probe.h"
#include "src/render/nearest_depth.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/sample_stack.h"
#include "src/render/surface_target.h"

namespace relievo {
namespace {

constexpr int kCornersUnit = 6;  // and two more: texture units of the base mesh

double steadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

struct Engine::Impl {
  Artwork artwork;
  Scene scene;
  EngineOptions options;
  EffectPlan plan;
  OrbitCamera camera;
  int width = 640, height = 360;
  gl::ContextInfo context;

  std::optional<ResidentPlanes> planes;
  std::optional<Scene> pending_scene;  // a scene of other planes: shown once their roots have come
  std::vector<std::string> notices;    // for the user, but for pages and tails that failed
  std::unique_ptr<PatchPass> patches;
  std::unique_ptr<BaseCorners> corners;                     // over a base mesh
  mutable std::optional<std::pair<double, Extent>> extent;  // of the last exaggeration: a walk over a mesh's corners
  std::optional<SceneLights> lights;
  std::unique_ptr<TextureDemand> demand;
  std::optional<DrawnList> list;
  std::unique_ptr<ScreenPass> screen;
  std::optional<DepthProbe> depth_probe;  // from the first question on
  ShadingPrograms programs;
  SurfaceTarget surface{{}};
  std::optional<SurfaceShading> shading;
  PictureTarget target{{}};
  // Several samples a pixel: their pictures, and how many there are of `sampled`. A change to the scene or the pages
  // resets `sampled`, and with it the picture is one sample again.
  std::unique_ptr<SampleStack> stack;
  int samples_in = 0;
  std::optional<NearestDepth> nearest_depth;  // of those samples, where it is kept
  std::optional<TextureDemand::View> sampled;
  bool target_is_average = false;  // else `target` holds the last sample alone
  bool expecting = false;          // within takeFullFeedback(): the demand is what the geometry suggests
  struct Shaded {
    TextureDemand::View view;
    uint32_t draw_calls = 0;
  };
  std::optional<Shaded> shaded_ahead;  // what settle() drew before its pages were confirmed, of those that are there
  glm::dvec2 offset_px{0};             // of the sample that is being drawn
  std::optional<PageTable> asked;      // what its pixels look up, if not all that is resident
  FaultInjection faults;

  DrawnSurface surface_drawn;
  DrawnSurface streamed_view;  // what the last request lists were for
  uint64_t frame = 0;
  CameraPredictor predictor;
  std::unique_ptr<Prefetcher> prefetcher;          // from the first move of the camera on
  bool predicting = false;                         // the streamer has a list of predicted pages, or one is on the way
  std::pair<uint64_t, double> settled_geometry{};  // relief generation and detail bias that a final list was made for
  double lod_bias = 0;
  bool fades_over = false;     // while settle() draws
  bool settling = false;       // within settle(): nothing is known of the views before
  bool all_pages_come = true;  // none that the settled list wants has failed
  Standstill standstill;       // of settle()
  EngineStats stats;

  const PatchDomain& domain() const { return artwork.manifest.domain; }
  bool overMesh() const { return !domain().isFlat(); }
  PageStreamer& streamer() const { return planes->streamer(); }
  PagePool& pool() const { return planes->pool(); }
  const DrawnList::Made& drawn() const { return list->made(); }
  double tailReach() const { return planes->tailReach(plan, width, height); }

  ViewTransform currentView() const { return viewOf(camera); }
  const Extent& drawnExtent() const {
    const double exaggerate = plan.relief ? scene.exaggerate : 0;
    if (!extent || extent->first != exaggerate) extent = {exaggerate, artworkExtent(artwork.manifest, exaggerate)};
    return extent->second;
  }
  // In the artwork's space, as all that follows from it.
  ViewTransform viewOf(const OrbitCamera& of) const {
    return viewTransform(of, PlacedExtent{drawnExtent(), scene.pose}, width, height);
  }

  ShadingPrograms::Variant programVariant() const {
    gl::Defines defines = plan.defines();
    planes->addDefines(defines);
    return {.defines = std::move(defines),
            .tails = planes->hasTails(),
            .feedback = demand->usesFeedback() && plan.readsTexture(),
            .wireframe = plan.wireframe,
            .shadows = plan.shadows,
            .average = plan.samples > 1,
            .normals = plan.drawsNormals(),
            .shadow_sums = plan.soft_shadows || plan.ambient_occlusion,
            .shadow_adds = plan.soft_near,
            .faults = faults};
  }
  // Artwork, scene, options and what follows from them, before any page is read.
  Result<void> prepare(Artwork of, const Scene& with, const EngineOptions& given);
  CacheNeed cacheNeed() const;
  Result<void> fitCache();
  Result<void> makeNearestDepth() {
    if (!options.keep_depth || plan.samples == 1) {
      nearest_depth.reset();
    } else if (!nearest_depth) {
      auto made = NearestDepth::create(context.api);
      if (!made) return made.error();
      nearest_depth.emplace(std::move(*made));
    }
    return {};
  }
  Result<void> linkPrograms() {
    surface_drawn = {};
    shading->forget(plan);
    sampled.reset();
    if (plan.samples == 1) stack.reset();
    else if (!stack || stack->samples() != plan.samples) stack = std::make_unique<SampleStack>(plan.samples);
    if (auto made = makeNearestDepth(); !made) return made;
    return programs.link(context.api, programVariant());
  }

  // Nothing that was found or drawn of the planes before holds.
  void forgetPlanes() {
    predictor.reset();
    predicting = false;
    demand->reset();
    list->reset();
  }

  // Goes over to the pending scene once the roots of its planes are there.
  Result<void> switchPlanes() {
    if (!pending_scene) return {};
    const EffectPlan wanted = planEffects(*pending_scene, artwork.manifest);
    if (planes->starting()) {
      if (planes->adopt(wanted)) {
        forgetPlanes();
        scene = *std::exchange(pending_scene, std::nullopt);
        plan = wanted;
        if (const auto light = fixedLight(scene); plan.resolve && light != planes->startedLight())
          planes->setLight(plan, light);
        return linkPrograms();
      }
      if (planes->starting()) return {};
    }
    planes->start(wanted, *pending_scene);
    return {};
  }

  LodView lodView(const ViewTransform& view) const {
    LodView v = lodViewFrom(view);
    v.error_px = scene.error_px * std::exp2(lod_bias);  // under pressure geometry gives way as texture does
    v.min_cell_px = scene.least_cell *
                    v.error_px;  // steps and cracks keep an error until the finest level: the screen bounds the cost
    v.exaggerate = scene.exaggerate;
    v.relief = plan.relief;
    v.hide_backs = options.hide_backs && !plan.casts();  // what faces away may stand in the light
    v.any_direction = plan.casts();
    if (plan.casts()) {
      // What is beside the picture may cast a shadow into it.
      const double half_mm = 0.5 * mmPerPx(camera, height) * std::min(width, height);
      const double reach = lights->reach(scene, plan, view, drawnExtent(), half_mm);
      for (int column = 0; column < 4; ++column)
        for (int row = 0; row < 2; ++row) v.clip_from_world[column][row] /= reach;
    }
    v.morph = plan.geomorph;
    v.hysteresis = settling ? 0 : scene.hysteresis;
    // Lists that grow with their pages end in one that depends on the order in which these came.
    v.as_if_resident = settling && all_pages_come;
    return v;
  }

  TextureView textureView(const ViewTransform& view) const {
    TextureView v = textureViewFrom(view, width, height);
    v.lod_bias = textureBias();
    v.trilinear = plan.sampling >= Sampling::kTrilinear;
    v.anisotropy = plan.anisotropy;
    v.relief = plan.relief;
    v.exaggerate = scene.exaggerate;
    v.error_px = scene.error_px * std::exp2(lod_bias);
    return v;
  }

  void postLod(const ViewTransform& view) {
    list->post(frame, lodView(view), demand->usesGeometry() ? std::optional(textureView(view)) : std::nullopt, view,
               scene.exaggerate, streamer());
  }
  void adopt(LodAnswer answer) { list->adopt(std::move(answer), plan.relief, streamer(), *demand, stats); }

  void setUniforms(const gl::Program& program, double now_s, double bias, std::array<int, 3> sample = {1, 0, 0},
                   int tap_phase = 0) const {
    if (const TailTextures* tails = planes->tailTextures()) tails->bind(program, tailReach());
    const glm::dvec3 light = lights->single(scene, drawn().view);
    const TextureFormat format = plan.format(artwork.manifest);
    setShadingUniforms(program, {.format = &format,
                                 .domain = &domain(),
                                 .lod_bias = bias,
                                 .sample = sample,
                                 .tap_phase = tap_phase,
                                 .light = {light[0], light[1], light[2]},
                                 .now_s = now_s,
                                 .page_fade_s = scene.page_fade_s,
                                 .fades_over = fades_over});
  }

  ViewTransform sampleView() const { return throughOffset(drawn().view, offset_px, width, height); }
  DrawnSurface surfaceNow() const {
    return {list->number(), sampleView().clip_from_world, drawn().exaggerate, width, height};
  }
  const PageTable& shownTable() { return asked ? *asked : streamer().table(); }
  // What is seen at each pixel: the only pass over the geometry, and only when it shows something else than the last.
  void updateSurface() {
    if (surface_drawn == surfaceNow()) return;
    surface_drawn = surfaceNow();
    surface.resize(width, height, plan.anisotropy > 1);
    target.resize(width, height, surface.depth());
    surface.begin();
    useForGeometry(programs.surface);
    const EyeFrame eye = prepareInstances(programs.surface);
    const gl::Program* root_cells = planes->hasTails() && patches->drawsRootCells() ? &programs.root_cells : nullptr;
    if (root_cells) useForGeometry(*root_cells);
    programs.surface.use();
    const PatchPass::Mesh mesh =
        list->backsAreHidden() && !faults.draw_backs ? PatchPass::Mesh::kFronts : PatchPass::Mesh::kFull;
    stats.draw_calls += faults.call_a_patch ? patches->drawOneByOne(programs.surface, eye)
                                            : patches->draw(programs.surface, eye, mesh, 0, root_cells);
  }

  // Before PatchPass::draw(), for each program that it takes.
  void useForGeometry(const gl::Program& program) {
    program.use();
    pool().bind(program, shownTable());
    setUniforms(program, 0, textureBias());
    if (corners) corners->bind(program, kCornersUnit);
  }

  SurfaceShading::Frame shadedFrame(const ViewTransform& seen, double now_s) {
    return {.scene = scene,
            .plan = plan,
            .programs = programs,
            .surface = surface,
            .screen = *screen,
            .lights = *lights,
            .extent = drawnExtent(),
            .view = drawn().view,
            .seen = seen,
            .surface_drawn = surface_drawn,
            .use = [this, now_s](const gl::Program& program) { useForSurface(program, now_s); },
            .draw_map = [this](const ShadowView& view) { drawShadowMap(view); }};
  }
  // After updateSurface(), whose list of instances it draws once more, as lights and sky see it.
  void updateShares(LightShares::Directions directions) {
    const ViewTransform seen = sampleView();
    stats.draw_calls += shading->updateShares(shadedFrame(seen, 0), directions);
  }
  void drawShadowMap(const ShadowView& view) {
    EyeFrame eye = eyeFrame(drawn().view, domain(), drawn().exaggerate, plan.relief, surface.depthMode());
    eye.clip_from_eye = glClipFrom(view.clip_from_world, eye.origin_mm, surface.depthMode());
    useForGeometry(programs.shadow_map);
    const gl::Program* root_cells =
        planes->hasTails() && patches->drawsRootCells() ? &programs.shadow_map_roots : nullptr;
    if (root_cells) useForGeometry(*root_cells);
    programs.shadow_map.use();
    stats.draw_calls += patches->draw(programs.shadow_map, eye, PatchPass::Mesh::kFull, 0, root_cells);
  }

  void bindSurface(const gl::Program& program) const {
    patches->bindInstances(program, 3);
    surface.bind(program, 4);
  }
  void useForSurface(const gl::Program& program, double now_s) {
    program.use();
    pool().bind(program, shownTable());
    bindSurface(program);
    setUniforms(program, now_s, shadedBias());
  }

  // After updateShares().
  void shadeSurface(double now_s) {
    target_is_average = false;
    const ViewTransform seen = sampleView();
    stats.draw_calls += shading->draw(shadedFrame(seen, now_s), target, lookups());
    if (plan.wireframe) {
      programs.wire.use();
      pool().bind(programs.wire, shownTable());
      const EyeFrame eye = prepareInstances(programs.wire);
      stats.draw_calls += patches->draw(programs.wire, eye, PatchPass::Mesh::kLines, 2e-5f);
    }
  }

  // Of several samples, one more picture, or more directions of its light: it counts once these are whole. It leaves a
  // surface of that sample behind: whatever needs the pixels' centres calls updateSurface() first.
  void drawSample(double now_s, LightShares::Directions directions) {
    offset_px = samplePattern(plan.samples)[static_cast<size_t>(samples_in)];
    updateSurface();
    updateShares(directions);
    if (shading->whole() || samples_in == 0) shadeWithoutFades(now_s);
    if (shading->whole() && nearest_depth) nearest_depth->take(surface, *screen, samples_in == 0);
    if (shading->whole()) stack->take(target, samples_in++);
    offset_px = {};
  }
  void shadeWithoutFades(double now_s) {
    fades_over = true;
    shadeSurface(now_s);
    fades_over = false;
  }
  void averageSamples() {
    if (target_is_average) return;
    stack->average(programs.average, *screen, samples_in, target);
    ++stats.draw_calls;
    target_is_average = true;
  }
  bool showsAverage() const { return sampled && samples_in > 0; }
  // Which pages are resident beside those that the pixels' centres ask for depends on what was seen before, and when
  // pages came. So that a settled picture does not, its samples find those pages alone, and roots.
  void drawSettledSamples() {
    const auto& requests = demand->requests();
    const uint32_t roots = planes->hasTails() ? 0 : domain().patchCount();
    asked.emplace(static_cast<uint32_t>(requests.size()) + roots, static_cast<int>(plan.texture_planes.size()));
    auto show = [&](const NodeId& node) {
      if (const auto entry = streamer().table().find(node)) asked->insert(node, *entry);
    };
    for (uint32_t p = 0; p < roots; ++p) show({p, 0, 0, 0});
    for (const NodeRequest& request : requests) show(request.node);
    pool().forgetTable();
    pool().uploadTable(*asked);
    sampled = demandView();
    for (samples_in = 0; samples_in < plan.samples;) drawSample(0, LightShares::Directions::kAll);
    averageSamples();
    asked.reset();
    pool().forgetTable();
    pool().uploadTable(streamer().table());
  }

  // What the cache makes the view do without, and what the scene does without on top of it.
  double textureBias() const { return lod_bias + scene.detail_bias; }
  // Where no page but the roots is there, as in a first picture, all look-ups end at them: they begin there, too, and
  // look at one level, which shows the same in less time. Overlays tell what was wanted, and taps of anisotropic
  // sampling look up on their own.
  bool onlyRoots() {
    return !planes->hasTails() && shownTable().size() == domain().patchCount() && plan.anisotropy == 1 &&
           !scene.overlay && !plan.drawsNormals();
  }
  double shadedBias() { return onlyRoots() ? kMaxNodeLevel : textureBias(); }
  SurfaceShading::Lookups lookups() {
    // Where no pixel asks for a page, or there is none, nothing is looked up: the same picture, for half the cost.
    // But with anisotropy, a patch that has no page shows its tail along the pixel's footprint.
    const bool no_look_up = demand->requests().empty() || shownTable().size() == 0;
    if (planes->hasTails() && no_look_up && !(plan.anisotropy > 1 && domain().hasUntexturedPatch()))
      return SurfaceShading::Lookups::kTails;
    if (plan.sampling != Sampling::kTrilinear || !plan.readsTexture() || !onlyRoots())
      return SurfaceShading::Lookups::kPages;
    if (programs.roots.id() == 0 && !programs.linkRoots(context.api, programVariant()))
      return SurfaceShading::Lookups::kPages;
    return SurfaceShading::Lookups::kRoots;
  }
  TextureDemand::View demandView() const { return {surfaceNow(), textureBias(), plan.sampling, plan.anisotropy}; }
  // Draws what the pixels of the grid ask for, from the surface buffer.
  void drawFeedback(const FeedbackGrid& grid, int tap_phase) {
    programs.feedback.use();
    bindSurface(programs.feedback);
    setUniforms(programs.feedback, 0, textureBias(), {grid.scale, grid.offset.x, grid.offset.y}, tap_phase);
    screen->draw(false);
    ++stats.draw_calls;
  }
  auto feedbackDrawing() {
    return [this](const FeedbackGrid& grid, int tap_phase) { drawFeedback(grid, tap_phase); };
  }

  // While the surface is drawn the workers read what the view's geometry suggests; the feedback then tells what of it
  // counts. In a first frame and in settling; of flat artworks. False: nothing is suggested.
  bool expectPages(uint32_t max_uploads) {
    if (overMesh() || !demand->usesFeedback() || demand->usesGeometry() || lod_bias > 0) return false;
    TextureView view = textureView(drawn().view);
    view.relief = false;  // like the feedback, not the finest level that a slope might want
    auto expected = selectTextureNodes(domain().flat(), *artwork.oracle, view);
    if (expected.size() * plan.texture_planes.size() > planes->slots().texture / 2) return false;
    demand->expect(expected);
    ++frame;
    stream(steadySeconds(), max_uploads);
    return true;
  }

  // What every pixel of the drawn list wants, at once: waits for it.
  void takeFullFeedback() {
    shaded_ahead.reset();
    expecting = expectPages(planes->slots().total());
    updateSurface();
    if (!plan.readsTexture()) return;
    const uint32_t picture_calls = stats.draw_calls;
    demand->takeAll(demandView(), plan.feedbackPhases(), feedbackDrawing(),
                    [this](std::span<const NodeRequest> so_far) { shadeAhead(so_far); });
    stats.draw_calls = picture_calls;
  }

  // While the rest of the feedback is drawn: where all pages are there that the view's geometry suggests, and that the
  // pixels so far ask for, the picture is drawn at once. It is the settled one unless the rest asks for more
  // (isShadedAhead()).
  void shadeAhead(std::span<const NodeRequest> so_far) {
    if (!expecting || isShadedAhead() || plan.casts() || plan.samples > 1) return;
    ++frame;
    stream(steadySeconds(), planes->slots().total());
    if (!allArrived(so_far, plan.texture_planes) || !allArrived(demand->requests(), plan.texture_planes)) return;
    const uint32_t calls = stats.draw_calls;
    shadeWithoutFades(steadySeconds());
    shaded_ahead = {demandView(), stats.draw_calls - calls};
  }
  bool isShadedAhead() { return shaded_ahead && shaded_ahead->view == demandView(); }

  void stream(double now_s, uint32_t max_uploads) {
    streamer().beginFrame(frame, now_s);
    const DrawnSurface seen{0, currentView().clip_from_world, scene.exaggerate, width, height};
    // The streamer knows its own part of the bias only. Where relief finds no place, no feedback follows that would
    // tell of a bias: its own lists do.
    const double texture_bias = demand->bias() - scene.detail_bias;
    const bool starved = settling && standstill.starved() && streamer().atRest();
    streamer().setRequestBias(
        demand->usesGeometry() ? std::nullopt : std::optional<double>(starved ? lod_bias : texture_bias),
        seen != streamed_view);
    streamed_view = seen;
    streamer().requestTexture(demand->requests());
    if (plan.relief) streamer().requestRelief(list->reliefRequests());
    const auto uploads = streamer().placeReady(max_uploads);
    pool().upload(uploads);
    // Roots that are resolved under another light lie where they lay before.
    if (pool().uploadTable(streamer().table()) || !uploads.empty()) {
      sampled.reset();
      shaded_ahead.reset();
    }
  }

  void stopPrefetch() {
    predictor.reset();
    if (std::exchange(predicting, false)) streamer().requestPrefetch({}, {});
  }

  // Nothing to do while the camera stands still; else a prediction, and a request that another thread answers.
  void prefetch(double now_s) {
    if (!options.prefetch || overMesh()) return;
    predictor.observe(camera, now_s);
    if (!predictor.moves(height) || lod_bias > 0) {
      if (std::exchange(predicting, false)) streamer().requestPrefetch({}, {});
      return;
    }
    if (!prefetcher) prefetcher = std::make_unique<Prefetcher>(domain().flat(), artwork.oracle);
    if (auto answer = prefetcher->tryTake(); answer && predicting) {
      streamer().requestPrefetch(
          answer->texture, plan.relief ? std::span<const NodeRequest>(answer->relief) : std::span<const NodeRequest>());
      stats.predict_ms = answer->determine_ms;
    }
    auto views = predictor.views(prefetchHorizon(streamer().stats().latency_ms.p90 / 1000, predictor.options()));
    Prefetcher::Request request;
    request.now_s = now_s;
    for (const OrbitCamera& ahead : views) {
      request.texture.push_back(textureView(viewOf(ahead)));
      request.texture.back().relief = false;  // like the feedback, not the finest level that a slope might want
    }
    constexpr uint64_t kReliefEvery = 4;  // frames: its cost is that of a frame's patch list
    if (plan.relief && frame % kReliefEvery == 0) {
      request.relief = lodView(viewOf(views.back()));
      request.resident = list->resident();
    }
    prefetcher->post(std::move(request));
    predicting = true;
  }

  // For the program in use.
  EyeFrame prepareInstances(const gl::Program& program) {
    const EyeFrame eye = eyeFrame(sampleView(), domain(), drawn().exaggerate, plan.relief, surface.depthMode());
    if (corners) {
      corners->setEye(drawn().view.eye_mm);
      corners->bind(program, kCornersUnit);
    }
    if (const TailTextures* tails = planes->tailTextures()) tails->bind(program, tailReach());
    patches->setInstances(list->instances(), eye, plan.relief,
                          [&](const NodeId& page) { return streamer().findRelief(page); });
    return eye;
  }

  void frameOnce(double now_s) {
    ++frame;
    ++stats.frames;
    if (auto switched = switchPlanes(); !switched) notices.push_back(switched.error().text());
    demand->takeFinished(plan.feedbackPhases());
    prefetch(now_s);
    stream(now_s, options.uploads_per_frame);
    ViewTransform view = currentView();
    bool first_requests = false;
    if (list->adoptedFrame() == 0) {  // a new streamer's first frame has nothing to draw yet: it waits for its list
      postLod(view);
      adopt(list->waitFor(frame));
      first_requests = plan.readsTexture() && expectPages(options.uploads_per_frame);
    } else {
      if (auto answer = list->tryTake()) adopt(std::move(*answer));
      list->countLag();
      postLod(view);
    }
    lod_bias = streamer().detailBias();
    stats.draw_calls = 0;
    updateSurface();  // a still camera: light, new pages and fades change the shading only
    // Before the shading, whose depth buffer the feedback reads: software GL waits for every pass that has a texture
    // for its target which is read.
    // A first picture does not wait for it: what the geometry suggests is requested already.
    if (demand->usesFeedback() && plan.readsTexture() && !first_requests &&
        frame % static_cast<uint64_t>(options.feedback_interval) == 0)
      demand->step(demandView(), plan.feedbackPhases(), feedbackDrawing());
    if (sampled && *sampled != demandView()) sampled.reset();
    if (!showsAverage()) {
      updateShares(LightShares::Directions::kFew);
      shadeSurface(now_s);
    }
    submitFrame();
  }

  bool allArrived(std::span<const NodeRequest> requests, std::span<const Plane> of_planes) const {
    for (const NodeRequest& w : requests) {
      bool whole = true, failed = false;
      for (Plane p : of_planes) {
        PageState state = streamer().state(PageId(p, w.node));
        whole = whole && state == PageState::kResident;
        failed = failed || state == PageState::kFailed;  // then the other planes are asked for no more
      }
      if (!whole && !failed) return false;
    }
    return true;
  }

  bool settleGeometry() {
    const bool final_list = stepGeometry();
    standstill.note(streamer(), *list, final_list);
    return final_list;
  }
  // One step of streaming and LOD without a picture; true when the list is final: all its relief is there, and was when
  // it was made.
  bool stepGeometry() {
    ++frame;
    stream(steadySeconds(), planes->slots().total());
    if (settled_geometry == std::pair(streamer().reliefGeneration(), streamer().detailBias()))
      return true;  // nothing new to know
    settled_geometry = {};
    lod_bias = streamer().detailBias();
    postLod(currentView());
    const uint64_t generation = list->residentGeneration();
    adopt(list->waitFor(frame));
    static constexpr Plane kReliefPlane[] = {Plane::kRelief};
    if (list->adoptedFrame() != frame) {
      // A page has failed: then what its absence leads to.
      if (all_pages_come && allArrived(list->reliefRequests(), kReliefPlane)) all_pages_come = false;
      return false;
    }
    bool final_list = !plan.relief ||
                      (allArrived(list->reliefRequests(), kReliefPlane) && generation == streamer().reliefGeneration());
    if (final_list) settled_geometry = {generation, lod_bias};
    return final_list;
  }
};

Engine::Engine(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Engine::~Engine() = default;

// Roots of every plane (or tails), and a little room to look at anything beside them; also when one light is fixed
// later, and without --shading, when there are other planes, too.
CacheNeed Engine::Impl::cacheNeed() const {
  const Manifest& manifest = artwork.manifest;
  EffectPlan fixed = plan;
  if (!fixed.resolve && fixed.lit()) {
    Scene fixed_scene = scene;
    fixed_scene.relight = false;
    fixed_scene.lights.clear();
    fixed = planEffects(fixed_scene, manifest);
  }
  Scene unshaded = scene;
  unshaded.shading = {};
  const EffectPlan plain = planEffects(unshaded, manifest);
  return {std::max({planes->leastBytes(plan), planes->leastBytes(fixed), planes->leastBytes(plain)}),
          std::max({planes->mostBytes(plan), planes->mostBytes(fixed), planes->mostBytes(plain)})};
}

Result<double> cacheMibFor(uint64_t least_bytes, const EngineOptions& options, bool several,
                           std::vector<std::string>& notices) {
  constexpr double kMib = 1024 * 1024;
  if (options.cache_mib * kMib >= static_cast<double>(least_bytes)) return options.cache_mib;
  const double least_mib = std::floor(static_cast<double>(least_bytes) / kMib) + 1,
               taken_mib = least_mib + kSpareCacheMib;
  const char* whose = several ? "these artworks" : "this artwork";
  char text[120];
  if (taken_mib <= options.most_cache_mib) {
    std::snprintf(text, sizeof text, "the page cache takes %.0f MiB, as %s need%s %.0f", taken_mib, whose,
                  several ? "" : "s", least_mib);
    notices.emplace_back(text);
    return taken_mib;
  }
  std::snprintf(text, sizeof text, "the page cache of %g MiB is too small for %s", options.cache_mib, whose);
  return Error{ErrorKind::kUsage,
               "",
               text,
               "give it at least " + std::to_string(std::lround(least_mib)) + " MiB (--cache-mib)",
               {}};
}

Result<void> Engine::Impl::fitCache() {
  auto fitted = cacheMibFor(cacheNeed().least_bytes, options, false, notices);
  if (!fitted) return fitted.error();
  options.cache_mib = *fitted;
  return {};
}

Result<void> Engine::Impl::prepare(Artwork of, const Scene& with, const EngineOptions& given) {
  artwork = std::move(of);
  scene = with;
  options = given;
  options.feedback_scale = std::clamp(options.feedback_scale, 1, kMaxFeedbackScale);
  options.feedback_interval = std::clamp(options.feedback_interval, 1, kMaxFeedbackInterval);
  context = gl::currentContextInfo();
  const Manifest& manifest = artwork.manifest;
  plan = planEffects(scene, manifest);
  if (drawnWithTails(manifest.domain, options.most_pinned_patches))
    stats.tail_bytes = tailGpuBytes(manifest.domain.patchCount(), static_cast<uint64_t>(manifest.texture.planes()));
  auto upload = chooseUpload(options.upload, manifest, context.software,
                             [&](PageCodec codec) { return missingBlockExtension(codec, context.api); });
  if (!upload) return upload.error();
  planes.emplace(artwork, options, stats.tail_bytes, std::move(*upload));
  return {};
}

Result<CacheNeed> Engine::cacheNeed(const Artwork& artwork, const Scene& scene, const EngineOptions& options) {
  Impl impl;
  if (auto prepared = impl.prepare(artwork, scene, options); !prepared) return prepared.error();
  return impl.cacheNeed();
}

Result<std::unique_ptr<Engine>> Engine::create(Artwork artwork, const Scene& scene, const EngineOptions& options) {
  if (const std::string problem = sceneProblem(scene, artwork.manifest); !problem.empty())
    return Error{ErrorKind::kUsage, "", problem, scene.unlit ? "leave out --unlit" : "", {}};
  auto impl = std::make_unique<Impl>();
  if (auto prepared = impl->prepare(std::move(artwork), scene, options); !prepared) return prepared.error();
  const Manifest& manifest = impl->artwork.manifest;
  ResidentPlanes& planes = *impl->planes;
  if (const std::string why = planes.whyNotBlocks(impl->plan); options.upload == Upload::kBlocks && !why.empty())
    impl->notices.push_back("texture pages are uploaded as rgba8, not as blocks: " + why);
  if (auto made = planes.makeTails(); !made) return made.error();
  impl->stats.tail_bytes = planes.tailBytes();
  if (auto fits = impl->fitCache(); !fits) return fits.error();
  planes.openPool(impl->plan);
  const PlacedExtent placed{artworkExtent(manifest), scene.pose};
  impl->camera = fitCamera(std::span(&placed, 1), impl->width, impl->height);
  impl->patches = std::make_unique<PatchPass>(impl->context.software);
  const DepthMode depth = depthMode(options.reversed_depth);
  impl->stats.reversed_depth = depth.reversed;
  impl->surface = SurfaceTarget(depth);
  impl->target = PictureTarget(depth);
  impl->screen = std::make_unique<ScreenPass>(depth);
  impl->lights.emplace(manifest);
  impl->shading.emplace(manifest, depth);
  // Over a base mesh the pass alone knows: a texture's density varies over its patches.
  impl->demand = std::make_unique<TextureDemand>(impl->overMesh() ? RequestSource::kFeedback : options.request_source,
                                                 impl->options.feedback_scale, impl->context.software, impl->domain());
  if (impl->overMesh()) impl->corners = std::make_unique<BaseCorners>(manifest.base);
  impl->list.emplace(impl->artwork, planes.hasTails());
  if (auto linked = impl->linkPrograms(); !linked) return linked.error();
  planes.openStreamer(impl->plan, impl->scene);
  impl->forgetPlanes();
  return std::unique_ptr<Engine>(new Engine(std::move(impl)));
}

void Engine::resize(int width_px, int height_px) {
  impl_->width = std::max(1, width_px);
  impl_->height = std::max(1, height_px);
}
int Engine::width() const { return impl_->width; }
int Engine::height() const { return impl_->height; }
void Engine::setCamera(const OrbitCamera& camera) { impl_->camera = camera; }
const OrbitCamera& Engine::camera() const { return impl_->camera; }
const Scene& Engine::scene() const { return impl_->pending_scene ? *impl_->pending_scene : impl_->scene; }
const EffectPlan& Engine::plan() const { return impl_->plan; }
const Manifest& Engine::manifest() const { return impl_->artwork.manifest; }
PlacedExtent Engine::placed() const { return {impl_->drawnExtent(), impl_->scene.pose}; }
const std::vector<PatchInstance>& Engine::instances() const { return impl_->list->instances(); }
const std::vector<NodeRequest>& Engine::textureRequests() const { return impl_->demand->requests(); }
ViewTransform Engine::view() const { return impl_->drawn().view; }

Result<void> Engine::setScene(const Scene& scene) {
  Impl& e = *impl_;
  if (const std::string problem = sceneProblem(scene, e.artwork.manifest); !problem.empty())
    return Error{ErrorKind::kUsage, "", problem, "", {}};
  if (scene != e.scene) e.sampled.reset();
  EffectPlan before = e.plan;
  auto light_before = fixedLight(e.scene);
  Scene now = scene;
  e.pending_scene.reset();
  if (!planEffects(scene, e.artwork.manifest).samePages(before)) {
    // What decides on the planes stays until theirs have come; everything else changes at once.
    e.pending_scene = scene;
    now.relief = e.scene.relief;
    now.relight = e.scene.relight;
    now.lights = e.scene.lights;
    now.gloss = e.scene.gloss;
    now.unlit = e.scene.unlit;
    now.exaggerate = e.scene.exaggerate;
    now.shading = e.scene.shading;
  }
  e.scene = now;
  e.plan = planEffects(now, e.artwork.manifest);
  assert(e.plan.samePages(before));
  if (auto light = fixedLight(now); e.plan.resolve && light != light_before) {
    e.planes->setLight(e.plan, light);
  }
  if (e.plan != before) {
    if (auto linked = e.linkPrograms(); !linked) return linked;
  }
  return e.switchPlanes();
}

Result<void> injectFaults(Engine& engine, const FaultInjection& what) {
  engine.impl_->faults = what;
  return engine.impl_->linkPrograms();
}

void Engine::frame(double now_s) { impl_->frameOnce(now_s); }

bool Engine::refine(double now_s) {
  Impl& e = *impl_;
  if (e.list->adoptedFrame() == 0) return false;
  if (e.plan.samples == 1) {
    if (e.shading->whole()) return false;
    ++e.stats.frames;
    e.stats.draw_calls = 0;
    e.updateSurface();
    e.updateShares(LightShares::Directions::kMore);
    e.shadeWithoutFades(now_s);
    submitFrame();
    return true;
  }
  if (e.sampled && *e.sampled != e.demandView()) e.sampled.reset();
  if (!e.showsAverage()) e.samples_in = 0;
  if (e.samples_in == e.plan.samples) return false;
  e.sampled = e.demandView();
  ++e.stats.frames;
  e.stats.draw_calls = 0;
  e.drawSample(now_s, LightShares::Directions::kMore);
  submitFrame();
  return true;
}

Result<void> Engine::settle(double timeout_s, bool refined) {
  // What the texture wants follows from the geometry, and the geometry from the view and its relief. So: relief and
  // patch list first, then one full-size feedback, then its pages, then one picture. Pressure on the cache starts it
  // over, with less detail.
  Impl& e = *impl_;
  e.stopPrefetch();
  e.standstill = {};
  double start = steadySeconds();
  auto interrupted = [&] { return e.options.interrupted && e.options.interrupted->load(); };
  auto timedOut = [&] { return steadySeconds() - start > timeout_s || interrupted() || e.standstill.stuck(); };
  auto pause = [] { std::this_thread::sleep_for(std::chrono::microseconds(100)); };
  while (e.pending_scene && !timedOut()) {
    if (auto switched = e.switchPlanes(); !switched) return switched;
    if (e.pending_scene) pause();
  }
  e.settling = e.all_pages_come = true;
  struct Settled {
    bool& settling;
    ~Settled() { settling = false; }
  } settled{e.settling};
  e.settled_geometry = {};
  e.stats.draw_calls = 0;
  double bias = 0;
  bool done = false;
  while (!done && !timedOut()) {
    while (!e.settleGeometry() && !timedOut()) pause();
    bias = e.lod_bias;
    const uint64_t looked_at = e.list->number();
    if (e.demand->usesFeedback()) e.takeFullFeedback();
    for (int step = 0; !timedOut(); ++step) {
      // Relief takes part, so that it is not evicted meanwhile. The list stays the same unless it is, or comes late to
      // a list that grows with it.
      const bool geometry = e.settleGeometry();
      if (geometry && e.list->number() != looked_at) break;
      if (geometry && e.streamer().settled() && e.lod_bias == bias &&
          e.allArrived(e.demand->requests(), e.plan.texture_planes)) {
        done = true;
        break;
      }
      if (e.lod_bias != bias && step >= 16) break;
      // Nothing to upload: pages are on their way, or are read again later.
      if (e.streamer().stats().ready == 0) pause();
    }
  }
  if (interrupted()) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  if (!done) {
    const StreamerStats& s = e.streamer().stats();
    const bool stuck = e.standstill.stuck();
    return Error{
        ErrorKind::kRuntime,
        "",
        "the view " +
            (stuck ? "cannot settle" : "did not settle within " + std::to_string(static_cast<int>(timeout_s)) + " s") +
            ": " + std::to_string(s.queued + s.decoding) + " pages under way, " + std::to_string(s.deferred) +
            " without a place in the cache",
        stuck ? "raise --cache-mib" : "raise --cache-mib or --timeout",
        {}};
  }
  ++e.stats.frames;
  if (e.plan.samples > 1 && refined) {
    e.drawSettledSamples();
  } else {
    e.sampled.reset();
    e.updateSurface();
    e.updateShares(refined ? LightShares::Directions::kAll : LightShares::Directions::kFew);
    if (e.isShadedAhead()) e.stats.draw_calls += e.shaded_ahead->draw_calls;
    else e.shadeWithoutFades(steadySeconds());
    e.shaded_ahead.reset();
  }
  finishFrame();
  return {};
}

std::vector<uint8_t> Engine::readPixels() {
  if (impl_->showsAverage()) impl_->averageSamples();
  return impl_->target.readPixels();
}

Engine::Layer Engine::layer() {
  Impl& e = *impl_;
  const bool average = e.showsAverage();
  if (average) e.averageSamples();
  return {e.target, average && e.nearest_depth ? e.nearest_depth->depth() : e.surface.depth(), e.surface.depthMode(),
          e.drawn().view};
}

void Engine::present(int window_width_px, int window_height_px) {
  Impl& e = *impl_;
  if (!e.showsAverage()) return e.target.present(window_width_px, window_height_px);
  e.averageSamples();
  e.stack->present(e.programs.average, *e.screen, window_width_px, window_height_px);
}

std::optional<glm::dvec3> Engine::surfacePoint(double x_px, double y_px) {
  Impl& e = *impl_;
  const DrawnSurface& shown = e.surface_drawn;
  if (shown.width == 0 || !(x_px >= 0 && y_px >= 0 && x_px < shown.width && y_px < shown.height)) return std::nullopt;
  if (!e.depth_probe) {
    auto probe = DepthProbe::create(e.context.api);
    if (!probe) {
      e.notices.push_back(probe.error().text());
      return std::nullopt;
    }
    e.depth_probe = std::move(*probe);
  }
  const int x = static_cast<int>(x_px), y = shown.height - 1 - static_cast<int>(y_px);
  const auto z = e.depth_probe->read(e.surface, *e.screen, x, y);
  if (!z) return std::nullopt;
  const glm::dvec4 clip((x + 0.5) / shown.width * 2 - 1, (y + 0.5) / shown.height * 2 - 1, *z, 1);
  const glm::dvec4 world = glm::inverse(shown.clip_from_world) * clip;
  const glm::dvec3 place = glm::dvec3(world) / world.w;
  if (!std::isfinite(place.x) || !std::isfinite(place.y) || !std::isfinite(place.z)) return std::nullopt;
  return placeInWorld(e.scene.pose, place);
}

EngineStats Engine::stats() const {
  const Impl& e = *impl_;
  EngineStats s = e.stats;
  s.streamer = e.streamer().stats();
  s.lod_lag_frames = summarize(e.list->lag(), 1);
  s.instances = e.patches->instanceCount();
  s.triangles = e.patches->triangles();
  s.wanted_nodes = static_cast<uint32_t>(e.demand->requests().size());
  for (const NodeRequest& w : e.demand->requests()) {
    for (Plane p : e.plan.texture_planes)
      s.missing_pages += e.streamer().state(PageId(p, w.node)) != PageState::kResident;
  }
  if (e.plan.relief) {
    for (const NodeRequest& w : e.list->reliefRequests())
      s.missing_pages += e.streamer().state(PageId(Plane::kRelief, w.node)) != PageState::kResident;
  }
  s.orthographic = e.camera.orthographic;
  s.mm_per_px = mmPerPx(e.camera, e.height);
  s.size_known = e.artwork.manifest.size_known;
  s.slots = e.planes->slots().total();
  s.resident = static_cast<uint32_t>(s.streamer.resident);
  s.upload = e.planes->slots().upload;
  s.why_not_blocks = e.planes->whyNotBlocks(e.plan);
  s.cache_bytes = e.planes->slots().bytes();
  s.texture_bytes = e.pool().textureBytes();
  s.detail_bias = e.lod_bias;
  s.samples = e.showsAverage() ? e.samples_in : 1;
  s.directions = e.shading->directions();
  s.refined = e.plan.samples > 1 ? s.samples == e.plan.samples : e.shading->whole();
  s.shading = e.scene.shading;
  s.switching = e.pending_scene.has_value();
  s.passes = e.plan.passes();
  if (!e.demand->usesFeedback()) std::erase(s.passes, "feedback");
  if (e.plan.resolve) {
    for (int k = 0; k < e.artwork.manifest.texture.planes(); ++k)
      s.planes_read.push_back(planeName(texturePlane(k), e.artwork.manifest.texture.basis));
    if (e.plan.relief) s.planes_read.push_back("relief");
  } else {
    s.planes_read = e.plan.planesRead();
  }
  return s;
}

std::vector<std::string> Engine::takeMessages() {
  std::vector<std::string> all = std::exchange(impl_->notices, {});
  for (auto texts : {impl_->planes->takeTailMessages(), impl_->planes->takePageMessages()})
    for (std::string& text : texts) all.push_back(std::move(text));
  return all;
}

PageFailures Engine::failures() const { return impl_->planes->failures(); }

std::vector<std::string> Engine::takeNotices() {
  std::vector<std::string> all = std::exchange(impl_->notices, {});
  // Tails are made of root pages where they are damaged: the same picture, unless those failed.
  if (const auto tails = impl_->planes->takeTailMessages(); !tails.empty() && impl_->planes->pastFailures().pages == 0)
    all.push_back(tails.front() +
                  (tails.size() > 1 ? ", and " + std::to_string(tails.size() - 1) + " more like it" : ""));
  (void)impl_->planes->takePageMessages();
  return all;
}

std::vector<float> Engine::captureVertices(uint32_t max_vertices) {
  Impl& e = *impl_;
  if (e.programs.capture.id() == 0 && !e.programs.linkCapture(e.context.api, e.programVariant())) return {};
  e.surface_drawn = {};
  e.surface.resize(e.width, e.height, false);
  e.target.resize(e.width, e.height, e.surface.depth());
  e.target.bind();  // transform feedback answers zeros without one
  e.programs.capture.use();
  EyeFrame eye = e.prepareInstances(e.programs.capture);
  e.pool().bind(e.programs.capture, e.streamer().table());
  if (!e.planes->hasTails() || e.faults.call_a_patch) return e.patches->capture(e.programs.capture, eye, max_vertices);
  e.programs.capture_roots.use();
  e.corners->bind(e.programs.capture_roots, kCornersUnit);
  e.planes->tailTextures()->bind(e.programs.capture_roots, e.tailReach());
  return e.patches->capture(e.programs.capture, eye, max_vertices, &e.programs.capture_roots);
}

}  // namespace relievo
