#include "src/engine/engine.h"

#include <algorithm>
#include <cassert>
#include <chrono>
#include <cmath>
#include <deque>
#include <optional>
#include <thread>
#include <utility>

#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>

#include "geometry/lod/lod_worker.h"
#include "geometry/lod/mesh_lod.h"
#include "src/artwork/basis.h"
#include "src/engine/fault_injection.h"
#include "src/engine/light_shares.h"
#include "src/engine/lod_views.h"
#include "src/engine/prefetch.h"
#include "src/engine/shading_programs.h"
#include "src/engine/stream_switch.h"
#include "src/engine/texture_demand.h"
#include "src/gl/program.h"
#include "src/render/base_corners.h"
#include "src/render/block_formats.h"
#include "src/render/depth_probe.h"
#include "src/render/kept_depth.h"
#include "src/render/normals_target.h"
#include "src/render/page_pool.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/sample_stack.h"
#include "src/render/surface_target.h"
#include "src/render/tail_textures.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

constexpr int kMaxReads = 64;      // over a link of 20 MB/s and 50 ms latency 67 pages of 15 KB are under way
constexpr int kCornersUnit = 6;    // and two more: texture units of the base mesh
constexpr int kShadowUnit = 14;    // of the shares of light
constexpr int kKeptDepthUnit = 6;  // shading programs have no base mesh
constexpr int kNormalsUnit = 7;
constexpr int kSkyUnit = 8;
constexpr uint32_t kReadyLimit =
    256;  // decoded pages that may wait: those of a first view, so that they come while its surface is drawn

// Of what is lower above the horizon of a flat artwork, where a quarter of the sky's light comes from, casters beyond
// the picture's border are left out.
constexpr glm::dvec3 kLowSky{0.8660254037844386, 0, 0.5};

// The direction of the light's disc that is nearest to the plane of a flat artwork.
glm::dvec3 lowestOf(const CastingLight& light) {
  if (light.size_deg == 0) return light.towards;
  const double half = glm::radians(light.size_deg / 2), angle = std::acos(std::clamp(light.towards.z, -1.0, 1.0));
  const double lowest = std::min(angle + half, glm::radians(89.9));
  return {std::sin(lowest), 0, std::cos(lowest)};
}

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

  std::unique_ptr<PageStreamer> streamer;
  StreamSwitch stream_switch;
  EffectPlan starting_plan;  // of the streamer that stream_switch makes ready
  std::array<double, 3> starting_light{};
  std::optional<Scene> pending_scene;      // a scene of other planes: shown once their roots have come
  std::vector<std::string> notices;        // for the user, but for pages that failed:
  std::vector<std::string> page_messages;  // these, of streamers that ended
  std::vector<std::string> tail_messages;  // and what the tails could not be made of
  PageFailures failures;                   // of the tails, and of streamers that ended
  std::unique_ptr<PagePool> pool;
  std::unique_ptr<PatchPass> patches;
  std::unique_ptr<BaseCorners> corners;  // over a base mesh
  std::optional<PatchTails> tails;       // over one of many patches; then nothing is pinned
  std::unique_ptr<TailTextures> tail_textures;
  mutable std::optional<std::pair<double, Extent>> extent;  // of the last exaggeration: a walk over a mesh's corners
  mutable std::optional<glm::dvec3> middle;                 // artworkMiddle()
  mutable std::optional<std::pair<ReliefShading, ReliefShading>> completed_shading;  // a scene's, and completed()
  std::unique_ptr<TextureDemand> demand;
  std::unique_ptr<LodWorker> lod;
  std::unique_ptr<ScreenPass> screen;
  std::optional<DepthProbe> depth_probe;  // from the first question on
  ShadingPrograms programs;
  SurfaceTarget surface{{}};
  std::unique_ptr<KeptDepth> kept_depth;  // while the plan keeps depth
  DrawnSurface kept_depth_of;
  std::unique_ptr<NormalsTarget> normals;  // while the plan draws normals
  std::unique_ptr<LightShares> shares;     // while the plan has shadows or ambient occlusion
  PictureTarget target{{}};
  // Several samples a pixel: their pictures, and how many there are of `sampled`. A change to the scene or the pages
  // resets `sampled`, and with it the picture is one sample again.
  std::unique_ptr<SampleStack> stack;
  int samples_in = 0;
  std::optional<TextureDemand::View> sampled;
  bool target_is_average = false;  // else `target` holds the last sample alone
  glm::dvec2 offset_px{0};         // of the sample that is being drawn
  std::optional<PageTable> asked;  // what its pixels look up, if not all that is resident
  FaultInjection faults;

  DrawnSurface surface_drawn;
  DrawnSurface streamed_view;  // what the last request lists were for
  std::vector<NodeRequest> relief_requests;
  std::shared_ptr<const ReliefSet> resident_relief = std::make_shared<ReliefSet>();
  uint64_t resident_generation = ~uint64_t{0};
  std::vector<PatchInstance> instances;
  bool backs_are_hidden = false;      // see LodResult
  uint64_t list_number = 0;           // differs whenever `instances` does
  std::vector<NodeId> pinned_relief;  // pages that `instances` displaces from
  uint64_t frame = 0;
  uint64_t adopted_frame = 0;  // of the LOD request whose answer is drawn
  uint64_t lod_requests = 0;   // so far
  LatencyHistogram lod_lag;
  // A list is drawn with the view that it was made for, a frame late at most times: what that view culled is never
  // looked at.
  struct DrawnView {
    uint64_t frame = 0;
    ViewTransform view;
    double exaggerate = 1;
    uint64_t request = 0;  // counted from 1
  };
  DrawnView drawn;
  std::deque<DrawnView> posted;  // requests whose answers are still to come
  CameraPredictor predictor;
  std::unique_ptr<Prefetcher> prefetcher;          // from the first move of the camera on
  bool predicting = false;                         // the streamer has a list of predicted pages, or one is on the way
  std::pair<uint64_t, double> settled_geometry{};  // relief generation and detail bias that a final list was made for
  double lod_bias = 0;
  bool fades_over = false;     // while settle() draws
  bool settling = false;       // within settle(): nothing is known of the views before
  bool all_pages_come = true;  // none that the settled list wants has failed
  UploadChoice upload;
  uint32_t pinned_nodes = 0;         // in each plane
  CacheSlots slots, starting_slots;  // of the streamer, and of the one that stream_switch makes ready
  EngineStats stats;

  const PatchDomain& domain() const { return artwork.manifest.domain; }
  bool overMesh() const { return !domain().isFlat(); }

  ViewTransform currentView() const { return viewOf(camera); }
  const Extent& drawnExtent() const {
    const double exaggerate = plan.relief ? scene.exaggerate : 0;
    if (!extent || extent->first != exaggerate) extent = {exaggerate, artworkExtent(artwork.manifest, exaggerate)};
    return extent->second;
  }
  ViewTransform viewOf(const OrbitCamera& of) const { return viewTransform(of, drawnExtent(), width, height); }
  // Of directions towards lights: over a base mesh they turn with the camera, unless they are fixed.
  glm::dmat3 worldFromLight(const ViewTransform& view) const {
    return overMesh() && scene.relight ? view.world_from_camera : glm::dmat3(1);
  }
  glm::dvec3 lightInSpace(const ViewTransform& view) const {
    return worldFromLight(view) * glm::make_vec3(singleLight(scene).data());
  }
  // plan.lights of them.
  std::vector<PlacedLight> lightsInSpace(const ViewTransform& view) const {
    std::vector<PlacedLight> placed;
    if (plan.lights == 0) return placed;
    if (!middle) middle = artworkMiddle(artwork.manifest);
    for (const SceneLight& light : shadedLights(scene.lights))
      placed.push_back(placedLight(light, worldFromLight(view), *middle));
    return placed;
  }
  // The lights that cast shadows: those far away, in the shader's order.
  std::vector<CastingLight> castingLights(const ViewTransform& view) const {
    if (plan.lights == 0) return {{lightInSpace(view), singleLightSize(scene)}};
    const std::vector<SceneLight> shaded = shadedLights(scene.lights);
    const std::vector<PlacedLight> placed = lightsInSpace(view);
    std::vector<CastingLight> lights;
    for (size_t i = 0; i < placed.size(); ++i)
      if (!placed[i].near) lights.push_back({placed[i].place, shaded[i].size_deg});
    return lights;
  }

  gl::Defines defines() const {
    gl::Defines all = plan.defines();
    if (tails) all.emplace_back("TAILS", "1");
    if (tail_textures && tail_textures->inRows()) all.emplace_back("TAIL_ROWS", "1");
    for (auto& define : PagePool::defines(slots.upload)) all.push_back(std::move(define));
    return all;
  }
  // Texture levels beyond the root's over which roots give way to tails: as many as the tails' texels are good for, or
  // fewer, so that the roots that a screen full of patches asks for fit the cache with room to spare.
  double tailReach() const {
    const double planes = static_cast<double>(plan.texture_planes.size());
    const double pages_of_screen = static_cast<double>(width) * height / (kPagePx * kPagePx) * planes;
    return std::clamp(0.5 * std::log2(0.6 * slots.texture / pages_of_screen), 0.25, kTailReach);
  }
  void setTailTexels(const EffectPlan& of, const std::array<double, 3>& light) {
    if (!tails) return;
    const TextureFormat& format = artwork.manifest.texture;
    if (!of.readsTexture()) return;
    if (of.shading != ReliefShading::Kind::kNone)
      tail_textures->setTexels(planeOfTails(*tails, texturePlaneIndex(kNormalPlane)), *artwork.manifest.base);
    else if (of.resolve) tail_textures->setTexels(resolvedTails(*tails, format, light), *artwork.manifest.base);
    else if (!of.lit() && format.planes() > 1)
      tail_textures->setTexels(resolvedTails(*tails, {}, light), *artwork.manifest.base);  // the colour alone
    else tail_textures->setTexels(*tails, *artwork.manifest.base, hasNormals(format));
  }

  // What the plan's pages need. Pages that are resolved, or made, are RGBA8.
  CacheNeeds cacheNeeds(const EffectPlan& of) const {
    const bool made = of.resolve || of.normals_exaggerate != 0 || of.madeOfRelief();
    CacheNeeds needs{.upload = made ? PageCodec::kLossless : upload.codec,
                     .texture_planes = static_cast<int>(of.texture_planes.size()),
                     .relief = of.relief,
                     .roots = pinned_nodes,
                     .texture_pages = 0,
                     .relief_pages = 0,
                     .max_slots = PagePool::maxSlots()};
    for (int level = 0; level <= std::max(domain().texture_depth, domain().relief_depth); ++level) {
      needs.texture_pages += domain().texturedNodeCount(level) * of.texture_planes.size();
      if (level <= domain().relief_depth) needs.relief_pages += domain().nodeCount(level);
    }
    return needs;
  }
  std::string whyNotBlocks() const {
    if (isBlockCodec(upload.codec) && plan.normals_exaggerate != 0)
      return "the normals beside them are made of the relief (--unlit needs none)";
    if (isBlockCodec(upload.codec) && plan.madeOfRelief()) return "pages of --shading are made of the relief";
    return upload.why_not_blocks;
  }
  uint64_t cacheBudget() const { return static_cast<uint64_t>(options.cache_mib * 1024 * 1024) - stats.tail_bytes; }

  ShadingPrograms::Variant programVariant() const {
    return {.defines = defines(),
            .tails = tails.has_value(),
            .feedback = demand->usesFeedback() && plan.readsTexture(),
            .wireframe = plan.wireframe,
            .shadows = plan.shadows,
            .average = plan.samples > 1,
            .normals = plan.drawsNormals(),
            .shadow_sums = plan.soft_shadows || plan.ambient_occlusion,
            .faults = faults};
  }
  Result<void> linkPrograms() {
    surface_drawn = kept_depth_of = {};
    if (!plan.casts()) shares.reset();
    else if (shares) shares->forget();
    if (!plan.keepsDepth()) kept_depth.reset();
    if (!plan.drawsNormals()) normals.reset();
    sampled.reset();
    if (plan.samples == 1) stack.reset();
    else if (!stack || stack->samples() != plan.samples) stack = std::make_unique<SampleStack>(plan.samples);
    return programs.link(context.api, programVariant());
  }

  void makeTails() {
    const Manifest& m = artwork.manifest;
    if (artwork.tails) {
      tails = artwork.tails(options.workers, &tail_messages);
    } else {
      tails.emplace(m.domain.patchCount(), m.texture.channels());
      tailsFromPages(*artwork.source, m.texture, m.domain.relief_depth >= 0, 0, tails->patches, options.workers, *tails,
                     &tail_messages, options.interrupted);
    }
    failures.add(tails->failures);
    tail_textures = std::make_unique<TailTextures>(*tails);
  }

  // Begins a new streamer, for other planes than those of the present one.
  void startStreaming(const EffectPlan& for_plan, const Scene& for_scene) {
    StreamerOptions so;
    starting_slots = cacheSlots(cacheNeeds(for_plan), cacheBudget());
    so.slot_count = starting_slots.texture;
    so.relief_slot_count = starting_slots.relief;
    so.relief_parts = !overMesh() || !options.small_relief ? ReliefParts::kOnlyHalves
                      : options.compact_relief             ? ReliefParts::kCompact
                                                           : ReliefParts::kSmall;
    so.upload = starting_slots.upload;
    so.workers = options.workers;
    so.max_reads = kMaxReads;
    so.ready_limit = kReadyLimit;
    so.texture_planes = for_plan.texture_planes;
    so.format = for_plan.format(artwork.manifest);
    if (for_plan.normals_exaggerate != 0) so.normals_of = ReliefSurface{domain().flat(), for_plan.normals_exaggerate};
    if (for_plan.madeOfRelief()) so.normals_of = shadedSurface(for_scene.shading, artwork.manifest);
    starting_plan = for_plan;
    starting_light = singleLight(for_scene);
    so.light = starting_light;
    std::vector<NodeId> roots;
    for (uint32_t p = 0; p < domain().patchCount() && !tails; ++p) roots.push_back({p, 0, 0, 0});
    stream_switch.start(artwork.source, so, roots, for_plan.relief ? roots : std::vector<NodeId>());
  }

  // What is resident for other planes is dropped.
  void adoptStreamer(std::unique_ptr<PageStreamer> next) {
    if (streamer) {
      for (std::string& text : streamer->takeMessages()) page_messages.push_back(std::move(text));
      failures.add(streamer->failures());
      stream_switch.retire(std::move(streamer));
    }
    streamer = std::move(next);
    if (slots != starting_slots) pool->reshape(starting_slots);
    slots = starting_slots;
    setTailTexels(starting_plan, starting_light);
    predictor.reset();
    predicting = false;
    pool->forgetTable();
    demand->reset();
    relief_requests.clear();
    instances.clear();
    pinned_relief.clear();
    resident_generation = ~uint64_t{0};
    adopted_frame = 0;
    posted.clear();
  }

  // Goes over to the pending scene once the roots of its planes are there.
  Result<void> switchPlanes() {
    if (!pending_scene) return {};
    EffectPlan wanted = planEffects(*pending_scene, artwork.manifest);
    if (stream_switch.busy()) {
      auto next = stream_switch.tryTake();
      if (!next) return {};
      if (starting_plan.samePages(wanted)) {
        adoptStreamer(std::move(next));
        scene = *std::exchange(pending_scene, std::nullopt);
        plan = wanted;
        auto light = singleLight(scene);
        if (plan.resolve && light != starting_light) {
          streamer->setLight(light);
          setTailTexels(plan, light);
        }
        return linkPrograms();
      }
      stream_switch.retire(std::move(next));  // the scene changed once more meanwhile
    }
    startStreaming(wanted, *pending_scene);
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
      double reach = 1;
      if (plan.shadows)
        for (const CastingLight& light : castingLights(view))
          reach = std::max(reach, casterReach(drawnExtent(), lowestOf(light), half_mm));
      if (plan.ambient_occlusion) reach = std::max(reach, casterReach(drawnExtent(), kLowSky, half_mm));
      for (int column = 0; column < 4; ++column)
        for (int row = 0; row < 2; ++row) v.clip_from_world[column][row] /= reach;
    }
    v.morph = plan.geomorph;
    v.hysteresis = settling ? 0 : scene.hysteresis;
    // Over a base mesh alone: a flat artwork settles on the list that its pages lead to in the order in which they
    // come.
    v.as_if_resident = settling && all_pages_come && overMesh();
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
    if (streamer->reliefGeneration() != resident_generation) {
      resident_generation = streamer->reliefGeneration();
      auto nodes = streamer->residentRelief();
      resident_relief = std::make_shared<ReliefSet>(nodes.begin(), nodes.end());
    }
    lod->post({frame, lodView(view), resident_relief,
               demand->usesGeometry() ? std::optional(textureView(view)) : std::nullopt});
    posted.push_back({frame, view, scene.exaggerate, ++lod_requests});
  }

  // The list becomes the drawn one if every relief page that it displaces from is still there; those are pinned while
  // it is.
  void adopt(LodAnswer answer) {
    stats.lod_ms = answer.evaluate_ms;
    while (!posted.empty() && posted.front().frame < answer.frame) posted.pop_front();
    if (posted.empty() || posted.front().frame != answer.frame) return;  // asked for before streaming was restarted
    relief_requests.clear();
    for (const ReliefRequest& w : answer.lod.requests) relief_requests.push_back({w.page, 1, w.priority});
    if (answer.texture) {
      stats.determine_ms = answer.determine_ms;
      demand->takeGeometry(*answer.texture);
    }
    std::vector<NodeId> pages;
    if (plan.relief) {
      pages.reserve(answer.lod.instances.size());
      for (const PatchInstance& p : answer.lod.instances)
        if (p.relief_page.level != kTailLevel) pages.push_back(p.relief_page);
      std::sort(pages.begin(), pages.end());
      pages.erase(std::unique(pages.begin(), pages.end()), pages.end());
      for (const NodeId& page : pages) {
        if (streamer->findRelief(page) == kNoSlot) return;  // evicted meanwhile: the next answer will know
      }
      for (const NodeId& page : pages) streamer->pinRelief(page);
      for (const NodeId& page : pinned_relief) streamer->unpinRelief(page);
    }
    pinned_relief = std::move(pages);
    list_number += answer.lod.instances != instances || answer.lod.backs_are_hidden != backs_are_hidden;
    backs_are_hidden = answer.lod.backs_are_hidden;
    instances = std::move(answer.lod.instances);
    stats.predicted_error_px = answer.lod.max_error_px;
    stats.edges_limited = answer.lod.limited_by_residency;
    adopted_frame = answer.frame;
    drawn = posted.front();
  }

  void setUniforms(const gl::Program& program, double now_s, std::array<int, 3> sample = {1, 0, 0},
                   int tap_phase = 0) const {
    if (tail_textures) tail_textures->bind(program, tailReach());
    const glm::dvec3 light = lightInSpace(drawn.view);
    const TextureFormat format = plan.format(artwork.manifest);
    setShadingUniforms(program, {.format = &format,
                                 .domain = &domain(),
                                 .lod_bias = textureBias(),
                                 .sample = sample,
                                 .tap_phase = tap_phase,
                                 .light = {light[0], light[1], light[2]},
                                 .now_s = now_s,
                                 .page_fade_s = scene.page_fade_s,
                                 .fades_over = fades_over});
  }

  ViewTransform sampleView() const { return throughOffset(drawn.view, offset_px, width, height); }
  DrawnSurface surfaceNow() const {
    return {list_number, sampleView().clip_from_world, drawn.exaggerate, width, height};
  }
  const PageTable& shownTable() { return asked ? *asked : streamer->table(); }
  // What is seen at each pixel: the only pass over the geometry, and only when it shows something else than the last.
  void updateSurface() {
    if (surface_drawn == surfaceNow()) return;
    surface_drawn = surfaceNow();
    surface.resize(width, height, plan.anisotropy > 1);
    target.resize(width, height, surface.depth());
    surface.begin();
    useForGeometry(programs.surface);
    const EyeFrame eye = prepareInstances(programs.surface);
    const gl::Program* root_cells = tails && patches->drawsRootCells() ? &programs.root_cells : nullptr;
    if (root_cells) useForGeometry(*root_cells);
    programs.surface.use();
    const PatchPass::Mesh mesh =
        backs_are_hidden && !faults.draw_backs ? PatchPass::Mesh::kFronts : PatchPass::Mesh::kFull;
    stats.draw_calls += faults.call_a_patch ? patches->drawOneByOne(programs.surface, eye)
                                            : patches->draw(programs.surface, eye, mesh, 0, root_cells);
  }

  // Before PatchPass::draw(), for each program that it takes.
  void useForGeometry(const gl::Program& program) {
    program.use();
    pool->bind(program, shownTable());
    setUniforms(program, 0);
    if (corners) corners->bind(program, kCornersUnit);
  }

  // After updateSurface(), whose list of instances it draws once more, as lights and sky see it.
  void updateShares(LightShares::Directions directions) {
    if (!plan.casts()) return;
    if (!shares) shares = std::make_unique<LightShares>(surface.depthMode());
    LightShares::Wanted wanted{.surface = surface_drawn, .view = &drawn.view, .extent = &drawnExtent()};
    if (plan.shadows) wanted.lights = castingLights(drawn.view);
    wanted.sky = plan.ambient_occlusion;
    stats.draw_calls += shares->update(wanted, directions,
                                       {.programs = &programs,
                                        .surface = &surface,
                                        .screen = screen.get(),
                                        .draw_map = [this](const ShadowView& view) { drawShadowMap(view); }});
  }
  bool sharesWhole() const { return !shares || shares->whole(); }
  void drawShadowMap(const ShadowView& view) {
    EyeFrame eye = eyeFrame(drawn.view, domain(), drawn.exaggerate, plan.relief, surface.depthMode());
    eye.clip_from_eye = glClipFrom(view.clip_from_world, eye.origin_mm, surface.depthMode());
    useForGeometry(programs.shadow_map);
    const gl::Program* root_cells = tails && patches->drawsRootCells() ? &programs.shadow_map_roots : nullptr;
    if (root_cells) useForGeometry(*root_cells);
    programs.shadow_map.use();
    stats.draw_calls += patches->draw(programs.shadow_map, eye, PatchPass::Mesh::kFull, 0, root_cells);
  }

  void bindSurface(const gl::Program& program) const {
    patches->bindInstances(program, 3);
    surface.bind(program, 4);
  }

  // After updateSurface(): near lights, gloss, and depth and curvature of a scan, need each pixel's place.
  void keepDepth() {
    if (!plan.keepsDepth() || (kept_depth && kept_depth_of == surface_drawn)) return;
    if (!kept_depth) kept_depth = std::make_unique<KeptDepth>();
    kept_depth->take(surface);
    kept_depth_of = surface_drawn;
  }
  const ReliefShading& completedShading() const {
    if (!completed_shading || completed_shading->first != scene.shading)
      completed_shading = {scene.shading, completed(scene.shading, artwork.manifest)};
    return completed_shading->second;
  }
  // Lights, with gloss, or what is shown in their place; for the shading program in use.
  void setLights(const gl::Program& program) const {
    const bool shaded = plan.shading != ReliefShading::Kind::kNone;
    if (plan.lights == 0 && !shaded && !plan.gloss) return;
    const glm::dvec3& eye_mm = drawn.view.eye_mm;
    const glm::dmat4 eye_from_pixel =
        glm::inverse(glm::translate(sampleView().clip_from_world, eye_mm)) * clipFromPixel(surface.depthMode());
    if (shaded)
      setNamedUniforms(program, shadingUniforms(completedShading(), artwork.manifest, eye_mm, eye_from_pixel,
                                                surface.depthMode().farPlane()));
    if (plan.lights > 0)
      setNamedUniforms(program,
                       lightUniforms(lightsInSpace(drawn.view), plan.format(artwork.manifest), eye_mm, eye_from_pixel));
    if (plan.gloss) setNamedUniforms(program, glossUniforms(scene.gloss, drawn.view, eye_from_pixel));
    if (kept_depth) kept_depth->bind(program, kKeptDepthUnit);
    if (normals) normals->bind(program, kNormalsUnit);
  }

  // After updateShares().
  void shadeSurface(double now_s) {
    target_is_average = false;
    keepDepth();
    // Where no pixel asks for a page, or there is none, nothing is looked up: the same picture, for half the cost.
    // But with anisotropy, a patch that has no page shows its tail along the pixel's footprint.
    const bool no_look_up = demand->requests().empty() || shownTable().size() == 0;
    const bool only_tails = no_look_up && !(plan.anisotropy > 1 && domain().hasUntexturedPatch());
    if (plan.drawsNormals()) {
      if (!normals) normals = std::make_unique<NormalsTarget>();
      normals->begin(surface);
      const gl::Program& drawing = tails && only_tails ? programs.normals_tails : programs.normals;
      drawing.use();
      pool->bind(drawing, shownTable());
      bindSurface(drawing);
      setUniforms(drawing, now_s);
      screen->draw(true);
      ++stats.draw_calls;
    }
    target.begin();
    const gl::Program& program = tails && only_tails ? programs.tails : programs.shade;
    program.use();
    pool->bind(program, shownTable());
    bindSurface(program);
    setUniforms(program, now_s);
    setNamedUniforms(program, effectUniforms(scene.effects));
    setLights(program);
    if (plan.shadows) shares->pass().bind(program, kShadowUnit);
    if (plan.ambient_occlusion) {
      setNamedUniforms(program, occlusionUniforms(scene.ambient_occlusion));
      shares->pass().bindSky(program, kSkyUnit);
    }
    screen->draw(true);
    ++stats.draw_calls;
    if (plan.wireframe) {
      programs.wire.use();
      pool->bind(programs.wire, shownTable());
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
    if (sharesWhole() || samples_in == 0) shadeWithoutFades(now_s);
    if (sharesWhole()) stack->take(target, samples_in++);
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
    const uint32_t roots = tails ? 0 : domain().patchCount();
    asked.emplace(static_cast<uint32_t>(requests.size()) + roots, static_cast<int>(plan.texture_planes.size()));
    auto show = [&](const NodeId& node) {
      if (const auto entry = streamer->table().find(node)) asked->insert(node, *entry);
    };
    for (uint32_t p = 0; p < roots; ++p) show({p, 0, 0, 0});
    for (const NodeRequest& request : requests) show(request.node);
    pool->forgetTable();
    pool->uploadTable(*asked);
    sampled = demandView();
    for (samples_in = 0; samples_in < plan.samples;) drawSample(0, LightShares::Directions::kAll);
    averageSamples();
    asked.reset();
    pool->forgetTable();
    pool->uploadTable(streamer->table());
  }

  // What the cache makes the view do without, and what the scene does without on top of it.
  double textureBias() const { return lod_bias + scene.detail_bias; }
  TextureDemand::View demandView() const { return {surfaceNow(), textureBias(), plan.sampling, plan.anisotropy}; }
  // Draws what the pixels of the grid ask for, from the surface buffer.
  void drawFeedback(const FeedbackGrid& grid, int tap_phase) {
    programs.feedback.use();
    bindSurface(programs.feedback);
    setUniforms(programs.feedback, 0, {grid.scale, grid.offset.x, grid.offset.y}, tap_phase);
    screen->draw(false);
    ++stats.draw_calls;
  }
  auto feedbackDrawing() {
    return [this](const FeedbackGrid& grid, int tap_phase) { drawFeedback(grid, tap_phase); };
  }

  // Settling: while the surface is drawn the workers read what the view's geometry suggests; the feedback then tells
  // what of it counts.
  void expectPages() {
    if (overMesh() || demand->usesGeometry() || lod_bias > 0) return;
    TextureView view = textureView(drawn.view);
    view.relief = false;  // like the feedback, not the finest level that a slope might want
    auto expected = selectTextureNodes(domain().flat(), *artwork.oracle, view);
    if (expected.size() * plan.texture_planes.size() > slots.texture / 2) return;
    demand->expect(expected);
    ++frame;
    stream(steadySeconds(), slots.total());
  }

  // What every pixel of the drawn list wants, at once: waits for it.
  void takeFullFeedback() {
    expectPages();
    updateSurface();
    if (!plan.readsTexture()) return;
    const uint32_t picture_calls = stats.draw_calls;
    demand->takeAll(demandView(), plan.feedbackPhases(), feedbackDrawing());
    stats.draw_calls = picture_calls;
  }

  void stream(double now_s, uint32_t max_uploads) {
    streamer->beginFrame(frame, now_s);
    const DrawnSurface seen{0, currentView().clip_from_world, scene.exaggerate, width, height};
    // The streamer knows its own part of the bias only.
    streamer->setRequestBias(
        demand->usesGeometry() ? std::nullopt : std::optional<double>(demand->bias() - scene.detail_bias),
        seen != streamed_view);
    streamed_view = seen;
    streamer->requestTexture(demand->requests());
    if (plan.relief) streamer->requestRelief(relief_requests);
    pool->upload(streamer->placeReady(max_uploads));
    if (pool->uploadTable(streamer->table())) sampled.reset();
  }

  void stopPrefetch() {
    predictor.reset();
    if (std::exchange(predicting, false)) streamer->requestPrefetch({}, {});
  }

  // Nothing to do while the camera stands still; else a prediction, and a request that another thread answers.
  void prefetch(double now_s) {
    if (!options.prefetch || overMesh()) return;
    predictor.observe(camera, now_s);
    if (!predictor.moves(height) || lod_bias > 0) {
      if (std::exchange(predicting, false)) streamer->requestPrefetch({}, {});
      return;
    }
    if (!prefetcher) prefetcher = std::make_unique<Prefetcher>(domain().flat(), artwork.oracle);
    if (auto answer = prefetcher->tryTake(); answer && predicting) {
      streamer->requestPrefetch(
          answer->texture, plan.relief ? std::span<const NodeRequest>(answer->relief) : std::span<const NodeRequest>());
      stats.predict_ms = answer->determine_ms;
    }
    auto views = predictor.views(prefetchHorizon(streamer->stats().latency_ms.p90 / 1000, predictor.options()));
    Prefetcher::Request request;
    request.now_s = now_s;
    for (const OrbitCamera& ahead : views) {
      request.texture.push_back(textureView(viewOf(ahead)));
      request.texture.back().relief = false;  // like the feedback, not the finest level that a slope might want
    }
    constexpr uint64_t kReliefEvery = 4;  // frames: its cost is that of a frame's patch list
    if (plan.relief && frame % kReliefEvery == 0) {
      request.relief = lodView(viewOf(views.back()));
      request.resident = resident_relief;
    }
    prefetcher->post(std::move(request));
    predicting = true;
  }

  // For the program in use.
  EyeFrame prepareInstances(const gl::Program& program) {
    const EyeFrame eye = eyeFrame(sampleView(), domain(), drawn.exaggerate, plan.relief, surface.depthMode());
    if (corners) {
      corners->setEye(drawn.view.eye_mm);
      corners->bind(program, kCornersUnit);
    }
    if (tail_textures) tail_textures->bind(program, tailReach());
    patches->setInstances(instances, eye, plan.relief, [&](const NodeId& page) { return streamer->findRelief(page); });
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
    if (adopted_frame == 0) {  // a new streamer's first frame has nothing to draw yet: it waits for its list
      postLod(view);
      adopt(lod->waitFor(frame));
    } else {
      if (auto answer = lod->tryTake()) adopt(std::move(*answer));
      lod_lag.add(1 + lod_requests - drawn.request);
      postLod(view);
    }
    lod_bias = streamer->detailBias();
    stats.draw_calls = 0;
    updateSurface();  // a still camera: light, new pages and fades change the shading only
    // Before the shading, whose depth buffer the feedback reads: software GL waits for every pass that has a texture
    // for its target which is read.
    if (demand->usesFeedback() && plan.readsTexture() && frame % static_cast<uint64_t>(options.feedback_interval) == 0)
      demand->step(demandView(), plan.feedbackPhases(), feedbackDrawing());
    if (sampled && *sampled != demandView()) sampled.reset();
    if (!showsAverage()) {
      updateShares(LightShares::Directions::kFew);
      shadeSurface(now_s);
    }
    submitFrame();
  }

  bool allArrived(std::span<const NodeRequest> requests, std::span<const Plane> planes) const {
    for (const NodeRequest& w : requests) {
      bool whole = true, failed = false;
      for (Plane p : planes) {
        PageState state = streamer->state(PageId(p, w.node));
        whole = whole && state == PageState::kResident;
        failed = failed || state == PageState::kFailed;  // then the other planes are asked for no more
      }
      if (!whole && !failed) return false;
    }
    return true;
  }

  // One step of streaming and LOD without a picture; true when the list is final: all its relief is there, and was when
  // it was made.
  bool settleGeometry() {
    ++frame;
    stream(steadySeconds(), slots.total());
    if (settled_geometry == std::pair(streamer->reliefGeneration(), streamer->detailBias()))
      return true;  // nothing new to know
    settled_geometry = {};
    lod_bias = streamer->detailBias();
    postLod(currentView());
    uint64_t generation = resident_generation;
    adopt(lod->waitFor(frame));
    static constexpr Plane kReliefPlane[] = {Plane::kRelief};
    if (adopted_frame != frame) {
      // A page has failed: then what its absence leads to.
      if (all_pages_come && allArrived(relief_requests, kReliefPlane)) all_pages_come = false;
      return false;
    }
    bool final_list =
        !plan.relief || (allArrived(relief_requests, kReliefPlane) && generation == streamer->reliefGeneration());
    if (final_list) settled_geometry = {generation, lod_bias};
    return final_list;
  }
};

Engine::Engine(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Engine::~Engine() = default;

Result<std::unique_ptr<Engine>> Engine::create(Artwork artwork, const Scene& scene, const EngineOptions& options) {
  if (const std::string problem = sceneProblem(scene, artwork.manifest); !problem.empty())
    return Error{ErrorKind::kUsage, "", problem, scene.unlit ? "leave out --unlit" : "", {}};
  auto impl = std::make_unique<Impl>();
  impl->artwork = std::move(artwork);
  impl->scene = scene;
  impl->options = options;
  impl->options.feedback_scale = std::clamp(options.feedback_scale, 1, kMaxFeedbackScale);
  impl->options.feedback_interval = std::clamp(options.feedback_interval, 1, kMaxFeedbackInterval);
  impl->context = gl::currentContextInfo();
  impl->plan = planEffects(scene, impl->artwork.manifest);
  const Manifest& manifest = impl->artwork.manifest;
  const bool with_tails = drawnWithTails(manifest.domain, options.most_pinned_patches);
  if (with_tails)
    impl->stats.tail_bytes =
        tailGpuBytes(manifest.domain.patchCount(), static_cast<uint64_t>(manifest.texture.planes()));
  const uint32_t roots = with_tails ? 1 : impl->domain().patchCount();
  auto upload = chooseUpload(options.upload, manifest, impl->context.software,
                             [&](PageCodec codec) { return missingBlockExtension(codec, impl->context.api); });
  if (!upload) return upload.error();
  impl->upload = *upload;
  if (const std::string why = impl->whyNotBlocks(); options.upload == Upload::kBlocks && !why.empty())
    impl->notices.push_back("texture pages are uploaded as rgba8, not as blocks: " + why);
  impl->pinned_nodes = roots;
  // Roots of every plane (or tails), and a little room to look at anything beside them; also when one light is fixed
  // later.
  EffectPlan fixed = impl->plan;
  if (!fixed.resolve && fixed.lit()) {
    Scene fixed_scene = scene;
    fixed_scene.relight = false;
    fixed_scene.lights.clear();
    fixed = planEffects(fixed_scene, manifest);
  }
  // Without --shading later there are other planes, too.
  Scene unshaded = scene;
  unshaded.shading = {};
  const uint64_t least = impl->stats.tail_bytes +
                         std::max({minCacheBytes(impl->cacheNeeds(impl->plan)), minCacheBytes(impl->cacheNeeds(fixed)),
                                   minCacheBytes(impl->cacheNeeds(planEffects(unshaded, manifest)))});
  if (options.cache_mib * 1024 * 1024 < static_cast<double>(least)) {
    return Error{ErrorKind::kUsage,
                 "",
                 "the page cache of " + std::to_string(options.cache_mib) + " MiB is too small for this artwork",
                 "give it at least " + std::to_string(least / (1024 * 1024) + 1) + " MiB (--cache-mib)",
                 {}};
  }
  if (with_tails) {
    if (const uint64_t most = TailTextures::maxPatches(manifest.texture.planes());
        manifest.domain.patchCount() > most) {
      return Error{ErrorKind::kUnsupported,
                   "",
                   "this GL context has room for the tails of " + std::to_string(most) + " patches, the artwork has " +
                       std::to_string(manifest.domain.patchCount()),
                   "build it with fewer patches (--patches)",
                   {}};
    }
    impl->makeTails();
    if (options.interrupted && options.interrupted->load())
      return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  }
  impl->slots = cacheSlots(impl->cacheNeeds(impl->plan), impl->cacheBudget());
  impl->camera = fitCamera(artworkExtent(impl->artwork.manifest), impl->width, impl->height);
  impl->pool = std::make_unique<PagePool>(impl->slots);
  impl->patches = std::make_unique<PatchPass>(impl->context.software);
  const DepthMode depth = depthMode(options.reversed_depth);
  impl->stats.reversed_depth = depth.reversed;
  impl->surface = SurfaceTarget(depth);
  impl->target = PictureTarget(depth);
  impl->screen = std::make_unique<ScreenPass>(depth);
  // Over a base mesh the pass alone knows: a texture's density varies over its patches.
  impl->demand = std::make_unique<TextureDemand>(impl->overMesh() ? RequestSource::kFeedback : options.request_source,
                                                 impl->options.feedback_scale, impl->context.software, impl->domain());
  if (const Manifest& m = impl->artwork.manifest; !m.domain.isFlat()) {
    impl->corners = std::make_unique<BaseCorners>(m.base);
    auto lod =
        std::make_shared<MeshLod>(m.base, m.domain.relief_depth, m.domain.relief_offset_mm, m.domain.relief_scale_mm,
                                  impl->artwork.oracle, m.coarse_errors, impl->tails.has_value());
    impl->lod = std::make_unique<LodWorker>(
        [lod](const LodView& view, const ReliefSet& resident) { return lod->select(view, resident); });
  } else {
    impl->lod = std::make_unique<LodWorker>(impl->domain().flat(), impl->artwork.oracle);
  }
  if (auto linked = impl->linkPrograms(); !linked) return linked.error();
  impl->startStreaming(impl->plan, impl->scene);
  impl->adoptStreamer(impl->stream_switch.take());
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
const std::vector<PatchInstance>& Engine::instances() const { return impl_->instances; }
const std::vector<NodeRequest>& Engine::textureRequests() const { return impl_->demand->requests(); }
ViewTransform Engine::view() const { return impl_->drawn.view; }

Result<void> Engine::setScene(const Scene& scene) {
  Impl& e = *impl_;
  if (const std::string problem = sceneProblem(scene, e.artwork.manifest); !problem.empty())
    return Error{ErrorKind::kUsage, "", problem, "", {}};
  if (scene != e.scene) e.sampled.reset();
  EffectPlan before = e.plan;
  auto light_before = singleLight(e.scene);
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
  if (auto light = singleLight(now); e.plan.resolve && light != light_before) {
    e.streamer->setLight(light);
    e.setTailTexels(e.plan, light);
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
  if (e.adopted_frame == 0) return false;
  if (e.plan.samples == 1) {
    if (e.sharesWhole()) return false;
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
  double start = steadySeconds();
  auto interrupted = [&] { return e.options.interrupted && e.options.interrupted->load(); };
  auto timedOut = [&] { return steadySeconds() - start > timeout_s || interrupted(); };
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
    if (e.demand->usesFeedback()) e.takeFullFeedback();
    for (int step = 0; !timedOut(); ++step) {
      // Relief takes part, so that it is not evicted meanwhile; the list stays the same unless it is.
      bool geometry = e.settleGeometry();
      if (geometry && e.streamer->settled() && e.lod_bias == bias &&
          e.allArrived(e.demand->requests(), e.plan.texture_planes)) {
        done = true;
        break;
      }
      if (e.lod_bias != bias && step >= 16) break;
      // Nothing to upload: pages are on their way, or are read again later.
      if (e.streamer->stats().ready == 0) pause();
    }
  }
  if (interrupted()) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  if (!done) {
    const StreamerStats& s = e.streamer->stats();
    return Error{ErrorKind::kRuntime,
                 "",
                 "the view did not settle within " + std::to_string(static_cast<int>(timeout_s)) +
                     " s: " + std::to_string(s.queued + s.decoding) + " pages under way, " +
                     std::to_string(s.deferred) + " without a place in the cache",
                 "raise --cache-mib or --timeout",
                 {}};
  }
  ++e.stats.frames;
  if (e.plan.samples > 1 && refined) {
    e.drawSettledSamples();
  } else {
    e.sampled.reset();
    e.updateSurface();
    e.updateShares(refined ? LightShares::Directions::kAll : LightShares::Directions::kFew);
    e.shadeWithoutFades(steadySeconds());
  }
  finishFrame();
  return {};
}

std::vector<uint8_t> Engine::readPixels() {
  if (impl_->showsAverage()) impl_->averageSamples();
  return impl_->target.readPixels();
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
  return std::isfinite(place.x) && std::isfinite(place.y) && std::isfinite(place.z) ? std::optional(place)
                                                                                    : std::nullopt;
}

EngineStats Engine::stats() const {
  const Impl& e = *impl_;
  EngineStats s = e.stats;
  s.streamer = e.streamer->stats();
  s.lod_lag_frames = summarize(e.lod_lag, 1);
  s.instances = e.patches->instanceCount();
  s.triangles = e.patches->triangles();
  s.wanted_nodes = static_cast<uint32_t>(e.demand->requests().size());
  for (const NodeRequest& w : e.demand->requests()) {
    for (Plane p : e.plan.texture_planes)
      s.missing_pages += e.streamer->state(PageId(p, w.node)) != PageState::kResident;
  }
  if (e.plan.relief) {
    for (const NodeRequest& w : e.relief_requests)
      s.missing_pages += e.streamer->state(PageId(Plane::kRelief, w.node)) != PageState::kResident;
  }
  s.orthographic = e.camera.orthographic;
  s.mm_per_px = mmPerPx(e.camera, e.height);
  s.size_known = e.artwork.manifest.size_known;
  s.slots = e.slots.total();
  s.resident = static_cast<uint32_t>(s.streamer.resident);
  s.upload = e.slots.upload;
  s.why_not_blocks = e.whyNotBlocks();
  s.cache_bytes = e.slots.bytes();
  s.texture_bytes = e.pool->textureBytes();
  s.detail_bias = e.lod_bias;
  s.samples = e.showsAverage() ? e.samples_in : 1;
  s.directions = e.shares ? e.shares->directions() : 0;
  s.refined = e.plan.samples > 1 ? s.samples == e.plan.samples : e.sharesWhole();
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
  for (auto texts : {std::exchange(impl_->tail_messages, {}), std::exchange(impl_->page_messages, {}),
                     impl_->streamer->takeMessages()})
    for (std::string& text : texts) all.push_back(std::move(text));
  return all;
}

PageFailures Engine::failures() const {
  PageFailures all = impl_->failures;
  all.add(impl_->streamer->failures());
  return all;
}

std::vector<std::string> Engine::takeNotices() {
  std::vector<std::string> all = std::exchange(impl_->notices, {});
  // Tails are made of root pages where they are damaged: the same picture, unless those failed.
  if (const auto tails = std::exchange(impl_->tail_messages, {}); !tails.empty() && impl_->failures.pages == 0) {
    all.push_back(tails.front() +
                  (tails.size() > 1 ? ", and " + std::to_string(tails.size() - 1) + " more like it" : ""));
  }
  impl_->page_messages.clear();
  (void)impl_->streamer->takeMessages();
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
  e.pool->bind(e.programs.capture, e.streamer->table());
  if (!e.tails || e.faults.call_a_patch) return e.patches->capture(e.programs.capture, eye, max_vertices);
  e.programs.capture_roots.use();
  e.corners->bind(e.programs.capture_roots, kCornersUnit);
  e.tail_textures->bind(e.programs.capture_roots, e.tailReach());
  return e.patches->capture(e.programs.capture, eye, max_vertices, &e.programs.capture_roots);
}

}  // namespace relievo
