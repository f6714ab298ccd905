#include "tools/bench/flight_simulation.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <numbers>

#include "src/engine/lod_views.h"

namespace relievo {
namespace {

ViewTransform viewOf(const FlightScene& scene, const OrbitCamera& camera) {
  double low = 0, high = 0;
  if (scene.relief) {
    low = scene.domain.relief_offset_mm;
    high = scene.domain.relief_offset_mm + 65535 * scene.domain.relief_scale_mm;
  }
  return viewTransform(camera, scene.domain, std::min(low, high), std::max(low, high), scene.width_px, scene.height_px);
}

}  // namespace

TextureView textureViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias) {
  TextureView t = textureViewFrom(viewOf(scene, camera), scene.width_px, scene.height_px);
  t.lod_bias = lod_bias;
  t.relief = false;
  return t;
}

LodView lodViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias) {
  LodView v = lodViewFrom(viewOf(scene, camera));
  v.error_px = scene.error_px * std::exp2(lod_bias);
  v.min_cell_px = 2 * v.error_px;
  v.relief = scene.relief;
  return v;
}

PageTrace recordFlight(const FlightScene& scene, const Flight& flight) {
  PageTrace trace;
  ReliefSet known;
  for (uint32_t p = 0; p < scene.domain.patchCount(); ++p) known.insert({p, 0, 0, 0});
  auto frames = static_cast<size_t>(std::floor(flight.duration_s() * scene.frames_per_s)) + 1;
  for (size_t f = 0; f < frames; ++f) {
    OrbitCamera camera = cameraAt(flight, static_cast<double>(f) / scene.frames_per_s);
    auto& pages = trace.emplace_back();
    for (const TextureRequest& w : selectTextureNodes(scene.domain, *scene.oracle, textureViewOf(scene, camera)))
      for (Plane plane : scene.texture_planes) pages.emplace_back(plane, w.node);
    if (!scene.relief) continue;
    for (const ReliefRequest& w :
         selectPlanarLod(scene.domain, *scene.oracle, lodViewOf(scene, camera), known).requests) {
      pages.emplace_back(Plane::kRelief, w.page);
      known.insert(w.page);
    }
    // Coarse before fine, over both kinds.
    std::stable_sort(pages.begin(), pages.end(), [](PageId a, PageId b) { return a.node().level < b.node().level; });
  }
  return trace;
}

namespace {

class NoBytes final : public PageSource {
 public:
  Result<EncodedPage> read(PageId) const override { return EncodedPage{}; }
};

class Link {
 public:
  Link(const LinkOptions& options, const std::function<uint32_t(PageId)>& page_bytes)
      : options_(options), page_bytes_(page_bytes) {}

  void deliver(PageStreamer& streamer, double now_s) {
    while (!flying_.empty() && flying_.front().arrives_s <= now_s) {
      streamer.finishJob(flying_.front().job);
      flying_.pop_front();
    }
  }
  void ask(PageStreamer& streamer, double now_s) {
    while (flying_.size() < options_.in_flight) {
      auto job = streamer.takeJob();
      if (!job) return;
      uint32_t bytes = page_bytes_(job->id);
      free_s_ = std::max(free_s_, now_s + options_.latency_s) + bytes / options_.bytes_per_s;
      flying_.push_back({*job, free_s_});
      bytes_ += bytes;
      ++pages_;
    }
  }
  uint64_t bytes() const { return bytes_; }
  uint64_t pages() const { return pages_; }

 private:
  struct Flying {
    PageJob job;
    double arrives_s;
  };
  LinkOptions options_;
  const std::function<uint32_t(PageId)>& page_bytes_;
  std::deque<Flying> flying_;
  double free_s_ = 0;
  uint64_t bytes_ = 0, pages_ = 0;
};

struct Requests {
  std::vector<NodeRequest> texture, relief;
};

// The node of the finest level that trilinear filtering reads at a pixel; nothing beside the artwork.
std::optional<NodeId> nodeAt(const FlightScene& scene, const OrbitCamera& camera, double x_px, double y_px) {
  double az = glm::radians(camera.azimuth_deg), el = glm::radians(camera.elevation_deg);
  glm::dvec3 back{std::sin(az) * std::cos(el), std::sin(el), std::cos(az) * std::cos(el)};
  glm::dvec3 right{std::cos(az), 0, -std::sin(az)}, up = glm::cross(back, right);
  const bool parallel = camera.orthographic;
  double px = mmPerPx(camera, scene.height_px) / (parallel ? 1 : camera.distance_mm);  // at unit depth
  glm::dvec3 aside = right * ((x_px - 0.5 * scene.width_px) * px) + up * ((0.5 * scene.height_px - y_px) * px);
  glm::dvec3 eye = camera.target_mm + back * camera.distance_mm + (parallel ? aside : glm::dvec3(0)),
             sight = (parallel ? glm::dvec3(0) : aside) - back;
  if (parallel ? sight.z == 0 : sight.z * eye.z >= 0) return std::nullopt;
  double t = -eye.z / sight.z;
  glm::dvec3 at = eye + sight * t;
  auto rate = [&](const glm::dvec3& d) {
    return glm::dvec2(d - sight * (d.z / sight.z)) * ((parallel ? 1 : t) / scene.domain.mm_per_px);
  };
  glm::dvec2 dx = rate(right * px), dy = rate(up * px);
  double lod = 0.5 * std::log2(std::max(glm::dot(dx, dx), glm::dot(dy, dy)));
  const FlatDomain& d = scene.domain;
  double x = at.x / d.mm_per_px + 0.5 * static_cast<double>(d.width_px),
         y = 0.5 * static_cast<double>(d.height_px) - at.y / d.mm_per_px;
  if (!(x >= 0 && y >= 0 && x < static_cast<double>(d.width_px) && y < static_cast<double>(d.height_px)))
    return std::nullopt;
  auto level = static_cast<uint32_t>(
      d.texture_depth - static_cast<int>(std::floor(std::clamp(lod, 0.0, static_cast<double>(d.texture_depth)))));
  auto patch = static_cast<uint32_t>((d.alongX() ? x : y) / static_cast<double>(d.patchPx()));
  double node_px = static_cast<double>(d.patchPx() >> level);
  return NodeId{patch, level, static_cast<uint32_t>((x - static_cast<double>(d.patchOriginX(patch))) / node_px),
                static_cast<uint32_t>((y - static_cast<double>(d.patchOriginY(patch))) / node_px)};
}

// One cache and link of their own, with a way to predict or none.
struct Run {
  std::optional<CameraPredictor> predictor;
  std::unique_ptr<PageStreamer> streamer;
  std::unique_ptr<Link> link;
  PredictedRequests texture, relief;
  StreamedFlight result;
  uint64_t bytes_before = 0, pages_before = 0;
};

// All runs, frame by frame.
class Simulation {
 public:
  Simulation(const FlightScene& scene, const FlightStreaming& how,
             const std::vector<std::optional<PredictorOptions>>& predictors)
      : scene_(scene), how_(how) {
    std::vector<NodeId> roots;
    for (uint32_t p = 0; p < scene.domain.patchCount(); ++p) roots.push_back({p, 0, 0, 0});
    known_.insert(roots.begin(), roots.end());
    for (const auto& options : predictors) addRun(options, roots);
  }

  // Stands still until nothing more arrives.
  void settle(const OrbitCamera& camera) {
    for (int i = 0; i < 6000 && (i < 8 || !settled()); ++i) step(camera, now_s_ - 1e3);
    for (Run& run : runs_) {
      if (run.predictor) run.predictor->reset();
      run.bytes_before = run.link->bytes();
      run.pages_before = run.link->pages();
    }
  }

  void fly(const Flight& flight) {
    auto frames = static_cast<size_t>(std::floor(flight.duration_s() * scene_.frames_per_s)) + 1;
    for (size_t f = 0; f < frames; ++f) {
      const double t = static_cast<double>(f) / scene_.frames_per_s;
      const OrbitCamera camera = cameraAt(flight, t);
      step(camera, t);
      lookAtPoints(camera);
    }
  }

  std::vector<StreamedFlight> finish() {
    std::vector<StreamedFlight> results;
    for (Run& run : runs_) {
      run.result.bytes = run.link->bytes() - run.bytes_before;
      run.result.pages = run.link->pages() - run.pages_before;
      run.result.stats = run.streamer->stats();
      while (auto job = run.streamer->takeJob()) run.streamer->finishJob(*job);
      results.push_back(run.result);
    }
    return results;
  }

 private:
  void addRun(const std::optional<PredictorOptions>& options, const std::vector<NodeId>& roots) {
    Run& run = runs_.emplace_back();
    if (options) run.predictor.emplace(*options);
    StreamerOptions so;
    so.slot_count = how_.slot_count;
    so.workers = 0;
    so.texture_planes = scene_.texture_planes;
    so.format = how_.format;
    so.ready_limit = static_cast<uint32_t>(4 * how_.link.in_flight);
    run.streamer = std::make_unique<PageStreamer>(
        source_, so, [](Plane, std::span<const uint8_t>, std::span<uint8_t>) { return Result<void>(); });
    run.streamer->pinRoots(roots, scene_.relief ? std::span<const NodeId>(roots) : std::span<const NodeId>());
    run.link = std::make_unique<Link>(how_.link, how_.page_bytes);
  }

  bool settled() const {
    return std::all_of(runs_.begin(), runs_.end(), [](const Run& r) { return r.streamer->settled(); });
  }

  // One frame: the runs are asked for what the frame before determined, and what this one asks for is determined.
  void step(const OrbitCamera& camera, double flight_s) {
    ++frame_;
    now_s_ += 1 / scene_.frames_per_s;
    const bool relief_turn = scene_.relief && frame_ % static_cast<uint64_t>(how_.relief_every) == 1;
    for (Run& run : runs_) {
      PageStreamer& streamer = *run.streamer;
      run.link->deliver(streamer, now_s_);
      streamer.beginFrame(frame_, now_s_);
      streamer.requestTexture(requests_.texture);
      if (scene_.relief) streamer.requestRelief(requests_.relief);
      if (run.predictor) prefetch(run, camera, flight_s, relief_turn);
      streamer.placeReady(64);
      run.link->ask(streamer, now_s_);
    }
    requests_.texture.clear();
    for (const TextureRequest& w : selectTextureNodes(scene_.domain, *scene_.oracle, textureViewOf(scene_, camera)))
      requests_.texture.push_back({w.node, 1, w.priority});
    if (!relief_turn) return;
    requests_.relief = reliefOf(camera);
    for (const NodeRequest& w : requests_.relief) known_.insert(w.node);
  }

  void prefetch(Run& run, const OrbitCamera& camera, double flight_s, bool relief_turn) {
    PageStreamer& streamer = *run.streamer;
    run.predictor->observe(camera, flight_s);
    std::vector<OrbitCamera> views;
    if (run.predictor->moves(scene_.height_px))
      views = run.predictor->views(prefetchHorizon(streamer.stats().latency_ms.p90 / 1000, run.predictor->options()));
    run.texture.begin(now_s_);
    run.relief.begin(now_s_);
    for (const OrbitCamera& view : views)
      for (const TextureRequest& w : selectTextureNodes(scene_.domain, *scene_.oracle, textureViewOf(scene_, view)))
        run.texture.add(w.node, w.priority);
    if (relief_turn && !views.empty())
      for (const NodeRequest& w : reliefOf(views.back())) run.relief.add(w.node, w.centre_distance);
    if (views.empty()) {
      streamer.requestPrefetch({}, {});
    } else {
      streamer.requestPrefetch(run.texture.finish(), run.relief.finish());
    }
  }

  std::vector<NodeRequest> reliefOf(const OrbitCamera& camera) const {
    std::vector<NodeRequest> result;
    for (const ReliefRequest& w :
         selectPlanarLod(scene_.domain, *scene_.oracle, lodViewOf(scene_, camera), known_).requests)
      result.push_back({w.page, 1, w.priority});
    return result;
  }

  // How far what shows at the grid's points is from what is wanted there.
  void lookAtPoints(const OrbitCamera& camera) {
    for (int j = 0; j < how_.grid_rows; ++j) {
      for (int i = 0; i < how_.grid_columns; ++i) {
        auto node = nodeAt(scene_, camera, (i + 0.5) * scene_.width_px / how_.grid_columns,
                           (j + 0.5) * scene_.height_px / how_.grid_rows);
        if (!node) continue;
        for (Run& run : runs_) {
          NodeId shown = *node;
          while (shown.level > 0 && !run.streamer->table().find(shown)) shown = shown.parent();
          ++run.result.points;
          run.result.coarse += shown.level < node->level;
          run.result.levels_missing += node->level - shown.level;
        }
      }
    }
  }

  const FlightScene& scene_;
  const FlightStreaming& how_;
  const std::shared_ptr<NoBytes> source_ = std::make_shared<NoBytes>();
  std::vector<Run> runs_;
  ReliefSet known_;  // relief pages are determined as if all that was wanted were there
  Requests requests_;
  uint64_t frame_ = 0;
  double now_s_ = 0;
};

}  // namespace

std::vector<StreamedFlight> streamFlight(const FlightScene& scene, const Flight& flight, const FlightStreaming& how,
                                         const std::vector<std::optional<PredictorOptions>>& predictors) {
  Simulation simulation(scene, how, predictors);
  simulation.settle(cameraAt(flight, 0));
  simulation.fly(flight);
  return simulation.finish();
}

}  // namespace relievo
