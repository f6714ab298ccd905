#include "src/engine/resident_planes.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "texturing/codec/page_codec.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

constexpr int kMaxReads = 64;  // over a link of 20 MB/s and 50 ms latency 67 pages of 15 KB are under way
constexpr uint32_t kReadyLimit =
    256;  // decoded pages that may wait: those of a first view, so that they come while its surface is drawn

}  // namespace

ResidentPlanes::ResidentPlanes(const Artwork& artwork, const EngineOptions& options, uint64_t tail_bytes,
                               UploadChoice upload)
    : artwork_(artwork), options_(options), tail_bytes_(tail_bytes), upload_(std::move(upload)) {}

Result<void> ResidentPlanes::makeTails() {
  if (tail_bytes_ == 0) return {};
  readTails();
  if (options_.interrupted && options_.interrupted->load())
    return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  if (!TailTextures::fit(*tails_, TexelTable::mostRowTexels(), TexelTable::mostBufferTexels()))
    return Error{ErrorKind::kUnsupported,
                 "",
                 "this GL context has no room for the tails of " + std::to_string(tails_->patches()) + " patches",
                 "build the artwork with fewer patches (--patches)",
                 {}};
  tail_textures_ = std::make_unique<TailTextures>(*tails_);
  tail_bytes_ = tail_textures_->mostBytes();
  return {};
}

void ResidentPlanes::openPool(const EffectPlan& plan) {
  slots_ = cacheSlots(needs(plan), budget());
  pool_ = std::make_unique<PagePool>(slots_);
}

void ResidentPlanes::openStreamer(const EffectPlan& plan, const Scene& scene) {
  start(plan, scene);
  take(switch_.take());
}

double ResidentPlanes::tailReach(const EffectPlan& plan, int width_px, int height_px) const {
  const double planes = static_cast<double>(plan.texture_planes.size());
  const double pages_of_screen = static_cast<double>(width_px) * height_px / (kPagePx * kPagePx) * planes;
  return std::clamp(0.5 * std::log2(0.6 * slots_.texture / pages_of_screen), 0.25, kTailReach);
}

void ResidentPlanes::addDefines(gl::Defines& defines) const {
  if (tails_) defines.emplace_back("TAILS", "1");
  if (tail_textures_ && tail_textures_->inRows()) defines.emplace_back("TAIL_ROWS", "1");
  if (tail_textures_ && tail_textures_->inPairs()) defines.emplace_back("TAIL_PAIRS", "1");
  for (auto& define : PagePool::defines(slots_.upload)) defines.push_back(std::move(define));
}

// What the plan's pages need. Pages that are resolved, or made, are RGBA8.
CacheNeeds ResidentPlanes::needs(const EffectPlan& plan) const {
  const PatchDomain& domain = artwork_.manifest.domain;
  const bool made = plan.resolve || plan.normals_exaggerate != 0 || plan.madeOfRelief();
  CacheNeeds needs{.upload = made ? PageCodec::kLossless : upload_.codec,
                   .texture_planes = static_cast<int>(plan.texture_planes.size()),
                   .relief = plan.relief,
                   .roots = tail_bytes_ > 0 ? 1 : domain.patchCount(),
                   .texture_pages = 0,
                   .relief_pages = 0,
                   .max_slots = PagePool::maxSlots()};
  for (int level = 0; level <= std::max(domain.texture_depth, domain.relief_depth); ++level) {
    needs.texture_pages += domain.texturedNodeCount(level) * plan.texture_planes.size();
    if (level <= domain.relief_depth) needs.relief_pages += domain.nodeCount(level);
  }
  return needs;
}

uint64_t ResidentPlanes::mostBytes(const EffectPlan& plan) const {
  const CacheNeeds all = needs(plan);
  const uint64_t texture = all.texture_pages * slotBytes(all.upload, Plane::kTexture0),
                 relief = all.relief ? all.relief_pages * kSlotBytes / 2 : 0;
  return std::max(leastBytes(plan), tail_bytes_ + texture + relief);
}

std::string ResidentPlanes::whyNotBlocks(const EffectPlan& plan) const {
  if (isBlockCodec(upload_.codec) && plan.normals_exaggerate != 0)
    return "the normals beside them are made of the relief (--unlit needs none)";
  if (isBlockCodec(upload_.codec) && plan.madeOfRelief()) return "pages of --shading are made of the relief";
  return upload_.why_not_blocks;
}

uint64_t ResidentPlanes::budget() const {
  return static_cast<uint64_t>(options_.cache_mib * 1024 * 1024) - tail_bytes_;
}

void ResidentPlanes::readTails() {
  const Manifest& m = artwork_.manifest;
  if (artwork_.tails) {
    tails_ = artwork_.tails(options_.workers, &tail_messages_);
  } else {
    PatchTails made(m.domain.patchCount(), m.texture.channels());
    tailsFromPages(*artwork_.source, m.texture, m.domain.relief_depth >= 0, 0, options_.workers, made, &tail_messages_,
                   options_.interrupted);
    tails_.emplace(made, KeptTailTolerance{.normals = hasNormals(m.texture)});
  }
  failures_.add(tails_->failures());
}

void ResidentPlanes::setTailTexels(const EffectPlan& plan, const std::array<double, 3>& light) {
  if (!tails_) return;
  const TextureFormat& format = artwork_.manifest.texture;
  if (!plan.readsTexture()) return;
  const BaseMesh& base = *artwork_.manifest.base;
  const GutterEnds ends{.colours = artwork_.manifest.tail_edges};  // of three channels
  auto set = [&](const KeptTails& tails, GutterEnds of) {
    tail_textures_->setTexels(tails, base, of, options_.workers);
  };
  if (plan.shading != ReliefShading::Kind::kNone) set(planeOfTails(*tails_, texturePlaneIndex(kNormalPlane)), {});
  else if (plan.resolve) set(resolvedTails(*tails_, format, light), ends);
  else if (!plan.lit() && format.planes() > 1) set(resolvedTails(*tails_, {}, light), ends);  // the colour alone
  else set(*tails_, {.colours = ends.colours, .normals = hasNormals(format)});
}

void ResidentPlanes::start(const EffectPlan& plan, const Scene& scene) {
  const PatchDomain& domain = artwork_.manifest.domain;
  StreamerOptions so;
  starting_slots_ = cacheSlots(needs(plan), budget());
  so.slot_count = starting_slots_.texture;
  so.relief_slot_count = starting_slots_.relief;
  so.relief_parts = domain.isFlat() || !options_.small_relief ? ReliefParts::kOnlyHalves
                    : options_.compact_relief                 ? ReliefParts::kCompact
                                                              : ReliefParts::kSmall;
  so.upload = starting_slots_.upload;
  so.workers = options_.workers;
  so.max_reads = kMaxReads;
  so.ready_limit = kReadyLimit;
  so.texture_planes = plan.texture_planes;
  so.format = plan.format(artwork_.manifest);
  if (plan.normals_exaggerate != 0) so.normals_of = ReliefSurface{domain.flat(), plan.normals_exaggerate};
  if (plan.madeOfRelief()) so.normals_of = shadedSurface(scene.shading, artwork_.manifest);
  starting_plan_ = plan;
  starting_light_ = fixedLight(scene);
  so.light = starting_light_;
  std::vector<NodeId> roots;
  for (uint32_t p = 0; p < domain.patchCount() && !tails_; ++p) roots.push_back({p, 0, 0, 0});
  switch_.start(artwork_.source, so, roots, plan.relief ? roots : std::vector<NodeId>());
}

void ResidentPlanes::take(std::unique_ptr<PageStreamer> next) {
  if (streamer_) {
    for (std::string& text : streamer_->takeMessages()) page_messages_.push_back(std::move(text));
    failures_.add(streamer_->failures());
    switch_.retire(std::move(streamer_));
  }
  streamer_ = std::move(next);
  if (slots_ != starting_slots_) pool_->reshape(starting_slots_);
  slots_ = starting_slots_;
  setTailTexels(starting_plan_, starting_light_);
  pool_->forgetTable();
}

bool ResidentPlanes::adopt(const EffectPlan& wanted) {
  auto next = switch_.tryTake();
  if (!next) return false;
  if (!starting_plan_.samePages(wanted)) {
    switch_.retire(std::move(next));
    return false;
  }
  take(std::move(next));
  return true;
}

void ResidentPlanes::setLight(const EffectPlan& plan, const std::array<double, 3>& light) {
  streamer_->setLight(light);
  setTailTexels(plan, light);
}

std::vector<std::string> ResidentPlanes::takePageMessages() {
  std::vector<std::string> all = std::exchange(page_messages_, {});
  for (std::string& text : streamer_->takeMessages()) all.push_back(std::move(text));
  return all;
}

PageFailures ResidentPlanes::failures() const {
  PageFailures all = failures_;
  all.add(streamer_->failures());
  return all;
}

}  // namespace relievo
