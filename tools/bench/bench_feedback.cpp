// bench_feedback.cpp - what it costs to know which texture pages a view wants, and how well each way knows it.
// Own work is thread CPU time: on software GL the drawing threads share the processor. Waiting is wall time.
#include <ctime>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numeric>
#include <set>
#include <tuple>
#include <unordered_map>

#include "geometry/lod/planar_lod.h"
#include "geometry/lod/texture_select.h"
#include "src/engine/engine.h"
#include "src/engine/lod_views.h"
#include "src/gl/context.h"
#include "src/render/feedback_pass.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"
#include "texturing/stream/request_memory.h"
#include "tools/bench/bench_groups.h"

namespace relievo {
namespace {

constexpr int kScale = 8;
using Pixels = std::vector<std::array<uint32_t, 4>>;

double threadMs() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}
double processMs() { return static_cast<double>(std::clock()) * 1e3 / CLOCKS_PER_SEC; }

// The feedback pass of a flat artwork, without pages and an engine.
class FlatFeedback {
 public:
  static Result<std::unique_ptr<FlatFeedback>> create(const Manifest& manifest) {
    auto f = std::unique_ptr<FlatFeedback>(new FlatFeedback(manifest));
    Scene scene;
    scene.relief = false;
    const gl::Defines defines = planEffects(scene, manifest).defines();
    const gl::Api api = gl::currentContextInfo().api;
    auto surface = gl::Program::link(api, {"patch.vert", "surface.frag", defines, patchAttributes(), {}});
    if (!surface) return surface.error();
    f->surface_program_ = std::move(*surface);
    auto linked = gl::Program::link(api, {"screen.vert", "feedback.frag", defines, {"a_corner"}, {}});
    if (!linked) return linked.error();
    f->program_ = std::move(*linked);
    return f;
  }
  void setCamera(const OrbitCamera& camera) {
    view_ = viewTransform(camera, manifest_.domain.flat(), 0, 0, kBenchWidth, kBenchHeight);
    LodView lod = lodViewFrom(view_);
    lod.relief = false;
    struct Flat final : ReliefOracle {
      HeightBounds bounds(const NodeId&) const override { return {}; }
    } flat;
    auto instances = selectPlanarLod(manifest_.domain.flat(), flat, lod, {}).instances;
    const EyeFrame eye = eyeFrame(view_, manifest_.domain, 1, false, surface_.depthMode());
    patches_.setInstances(instances, eye, false, [](const NodeId&) { return kNoSlot; });
    // The surface is drawn for the picture anyhow.
    surface_.resize(kBenchWidth, kBenchHeight, false);
    surface_.begin();
    surface_program_.use();
    setShadingUniforms(surface_program_, {.format = &manifest_.texture, .domain = &manifest_.domain});
    patches_.draw(surface_program_, eye, PatchPass::Mesh::kFull);
  }
  const ViewTransform& view() const { return view_; }
  FeedbackPass& pass() { return pass_; }
  void draw(const FeedbackGrid& grid) {
    program_.use();
    patches_.bindInstances(program_, 3);
    surface_.bind(program_, 4);
    setShadingUniforms(program_, {.format = &manifest_.texture,
                                  .domain = &manifest_.domain,
                                  .sample = {grid.scale, grid.offset.x, grid.offset.y}});
    screen_.draw(false);
  }
  Pixels pixels(const FeedbackGrid& grid) {
    pass_.issue(grid, 0, [&] { draw(grid); });
    auto read = pass_.wait();
    return {read.begin(), read.end()};
  }

 private:
  explicit FlatFeedback(const Manifest& manifest) : manifest_(manifest), pass_(gl::currentContextInfo().software) {}
  Manifest manifest_;
  gl::Program surface_program_, program_;
  PatchPass patches_;
  SurfaceTarget surface_;
  ScreenPass screen_;
  FeedbackPass pass_;
  ViewTransform view_;
};

struct NamedCamera {
  const char* name;
  OrbitCamera camera;
};
// Near enough that the finest levels are wanted, at most.
std::vector<NamedCamera> cameras(const FlatDomain& domain) {
  OrbitCamera whole = fitCamera(domain, kBenchWidth, kBenchHeight);
  OrbitCamera near = whole;
  near.distance_mm *= 0.3;
  OrbitCamera slant = near;
  slant.azimuth_deg = 55;
  slant.elevation_deg = 10;
  OrbitCamera grazing = near;
  grazing.azimuth_deg = 80;
  return {
      {"all of it", whole}, {"close", near}, {"close, 55 degrees aside", slant}, {"close, 80 degrees aside", grazing}};
}

// As one would write it first: ordered containers, every pixel and all its ancestors.
std::vector<NodeRequest> plainAnalysis(std::span<const std::array<uint32_t, 4>> pixels, int width, int height) {
  std::unordered_map<NodeId, NodeRequest> nodes;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto& p = pixels[static_cast<size_t>(y * width + x)];
      if (p[0] == 0) continue;
      NodeId node{p[1], (p[0] >> 8) & 0xFFu, p[2], p[3]};
      auto d = static_cast<float>(std::hypot(x + 0.5 - width / 2.0, y + 0.5 - height / 2.0) /
                                  std::hypot(width / 2.0, height / 2.0));
      for (bool first = true;; first = false) {
        NodeRequest& w = nodes.try_emplace(node, NodeRequest{node, 0, 1.0f}).first->second;
        w.pixels += first;
        w.centre_distance = std::min(w.centre_distance, d);
        if (node.level == 0) break;
        node = node.parent();
      }
    }
  }
  auto before = [](const NodeRequest& a, const NodeRequest& b) {
    return std::tuple(a.node.level, a.centre_distance, a.node) < std::tuple(b.node.level, b.centre_distance, b.node);
  };
  std::set<NodeRequest, decltype(before)> ordered(before);
  for (const auto& [node, request] : nodes) ordered.insert(request);
  return {ordered.begin(), ordered.end()};
}

std::set<NodeId> nodesOf(std::span<const NodeRequest> requests) {
  std::set<NodeId> nodes;
  for (const NodeRequest& w : requests) nodes.insert(w.node);
  return nodes;
}
// Of `of`, in per cent, what `in` has.
double share(const std::set<NodeId>& of, const std::set<NodeId>& in) {
  size_t count = 0;
  for (const NodeId& n : of) count += in.contains(n);
  return of.empty() ? 100 : 100.0 * static_cast<double>(count) / static_cast<double>(of.size());
}

TextureView textureView(const ViewTransform& view, bool relief) {
  TextureView v = textureViewFrom(view, kBenchWidth, kBenchHeight);
  v.relief = relief;
  return v;
}

}  // namespace

Result<void> feedbackBench(BenchContext& context) {
  auto made = FlatFeedback::create(context.package->manifest());
  if (!made) return made.error();
  FlatFeedback& feedback = **made;
  const int rounds = context.quick ? 30 : 150;
  std::vector<double> own, issue, read, analysis, remembered, waited, plain, own_wall;
  size_t most = 0;
  for (const NamedCamera& c : cameras(context.package->manifest().domain.flat())) {
    FeedbackAnalyzer analyzer;
    RequestMemory memory;
    feedback.setCamera(c.camera);
    for (int k = -3; k < rounds && !context.stopped(); ++k) {  // the first rounds compile shaders
      FeedbackGrid grid = feedbackGrid(kBenchWidth, kBenchHeight, kScale, static_cast<uint64_t>(k + 3));
      glFinish();
      double drawing = 0, t0 = threadMs(), w0 = benchSeconds();
      feedback.pass().issue(grid, 0, [&] {
        double t = threadMs();
        feedback.draw(grid);
        drawing = threadMs() - t;
      });
      double t1 = threadMs(), w1 = benchSeconds();
      glFinish();
      double t2 = threadMs(), w2 = benchSeconds();
      auto pixels = feedback.pass().poll();
      double t3 = threadMs();
      auto requests = analyzer.analyze(pixels, grid.width(), grid.height());
      double t4 = threadMs();
      most = std::max(most, memory.add(requests, 1, kScale * kScale).size());
      double t5 = threadMs(), w3 = benchSeconds();
      if (k < 0) continue;
      issue.push_back(t1 - t0 - drawing);
      read.push_back(t3 - t2);
      analysis.push_back(t4 - t3);
      remembered.push_back(t5 - t4);
      own.push_back(t1 - t0 - drawing + t5 - t2);
      own_wall.push_back((w1 - w0 + w3 - w2) * 1e3);
      // The same pass, read at once.
      double w = benchSeconds();
      feedback.pass().issue(grid, 0, [&] { feedback.draw(grid); });
      auto at_once = feedback.pass().wait();
      double t = threadMs();
      plainAnalysis(at_once, grid.width(), grid.height());
      plain.push_back(threadMs() - t);
      waited.push_back((benchSeconds() - w) * 1e3);
    }
  }
  char note[200];
  std::snprintf(note, sizeof note,
                "issue %.3f, read %.3f, analyse %.3f, remember %.3f; p99 %.2f; with the draw calls %.2f ms wall",
                median(issue), median(read), median(analysis), median(remembered), quantile(own, 0.99),
                median(own_wall));
  context.row({.what = "issue, read and analyse 160x90 px, besides drawing",
               .measured = median(own),
               .unit = "ms CPU",
               .goal = 1.0,
               .baseline_name = "ms wall, read at once, std containers",
               .baseline = median(waited),
               .note = note});
  std::snprintf(note, sizeof note, "p99 %.3f; lists of up to %zu nodes", quantile(analysis, 0.99), most);
  context.row({.what = "analysis of 160x90 px",
               .measured = median(analysis),
               .unit = "ms CPU",
               .goal = 0.2,
               .baseline_name = "std::unordered_map and std::set",
               .baseline = median(plain),
               .note = note});
  return {};
}

namespace {

// Time: drawn and read by all threads, against the CPU's own evaluation.
void requestTimes(BenchContext& context, const Artwork& artwork, FlatFeedback& feedback) {
  const FlatDomain domain = artwork.manifest.domain.flat();
  for (bool relief : {false, true}) {
    if (relief && domain.relief_depth < 0) continue;
    std::vector<double> geometry, pass;
    size_t named = 0;
    for (const NamedCamera& c : cameras(domain)) {
      feedback.setCamera(c.camera);
      FeedbackAnalyzer analyzer;
      for (int k = 0; k < (context.quick ? 10 : 40) && !context.stopped(); ++k) {
        double t = threadMs();
        named += selectTextureNodes(domain, *artwork.oracle, textureView(feedback.view(), relief)).size();
        geometry.push_back(threadMs() - t);
        FeedbackGrid grid = feedbackGrid(kBenchWidth, kBenchHeight, kScale, static_cast<uint64_t>(k));
        t = processMs();
        Pixels pixels = feedback.pixels(grid);
        analyzer.analyze(pixels, grid.width(), grid.height());
        pass.push_back(processMs() - t);
      }
    }
    char note[120];
    double all = std::accumulate(geometry.begin(), geometry.end(), 0.0);
    std::snprintf(note, sizeof note, "%.2f us a node named; the pass is of a flat artwork",
                  1e3 * all / static_cast<double>(std::max<size_t>(1, named)));
    context.row({.what = std::string(relief ? "relief" : "flat") + ": geometry, one view",
                 .measured = median(geometry),
                 .unit = "ms CPU",
                 .baseline_name = "feedback at 1/8, drawn, read, analysed",
                 .baseline = median(pass),
                 .note = note});
  }
}

// A slow flight: pages of two views in a row that the list of the second lacks, though every pixel's feedback has them.
void requestsInFlight(BenchContext& context, const FlatDomain& domain, FlatFeedback& feedback) {
  std::array<size_t, 2> lost{};
  size_t wanted = 0;
  const int frames = context.quick ? 20 : 60;
  OrbitCamera camera = cameras(domain)[2].camera;
  FeedbackAnalyzer analyzer;
  RequestMemory memory;
  std::set<NodeId> truth_before;
  std::array<std::set<NodeId>, 2> before;
  for (int k = 0; k < frames && !context.stopped(); ++k) {
    camera.target_mm.x += 0.0005 * camera.distance_mm;
    camera.azimuth_deg += 0.05;
    feedback.setCamera(camera);
    FeedbackGrid full = feedbackGrid(kBenchWidth, kBenchHeight, 1, 0),
                 grid = feedbackGrid(kBenchWidth, kBenchHeight, kScale, static_cast<uint64_t>(k));
    std::set<NodeId> truth = nodesOf(analyzer.analyze(feedback.pixels(full), full.width(), full.height()));
    auto newest = analyzer.analyze(feedback.pixels(grid), grid.width(), grid.height());
    std::array<std::set<NodeId>, 2> now{nodesOf(newest),
                                        nodesOf(memory.add(newest, static_cast<uint64_t>(k), kScale * kScale))};
    for (const NodeId& n : truth) {
      if (!truth_before.contains(n)) continue;
      ++wanted;
      for (size_t i = 0; i < 2; ++i) lost[i] += before[i].contains(n) && !now[i].contains(n);
    }
    truth_before = std::move(truth);
    before = std::move(now);
  }
  auto percent = [&](size_t n) {
    return 100.0 * static_cast<double>(n) / static_cast<double>(std::max<size_t>(1, wanted));
  };
  context.row({.what = "slow flight: wanted pages that drop out of the list, a frame",
               .measured = percent(lost[1]),
               .unit = "%",
               .baseline_name = "with the newest result only",
               .baseline = percent(lost[0]),
               .note = std::to_string(kMovingResults) + " results remembered"});
}

// What each way names of one view, and what every pixel of the settled picture wants.
struct NamedNodes {
  std::set<NodeId> truth, geometry, eighth;
};
Result<NamedNodes> nodesNamed(Engine& by_feedback, Engine& by_geometry, const OrbitCamera& camera) {
  for (Engine* e : {&by_feedback, &by_geometry}) {
    e->setCamera(camera);
    if (auto settled = e->settle(60); !settled) return settled.error();
  }
  NamedNodes named{nodesOf(by_feedback.textureRequests()), nodesOf(by_geometry.textureRequests()), {}};
  OrbitCamera moving = camera;
  for (int k = 0; k < 8; ++k) {  // all but still
    moving.target_mm.x += 1e-6;
    by_feedback.setCamera(moving);
    by_feedback.frame(k * 0.016);
    by_feedback.readPixels();
  }
  named.eighth = nodesOf(by_feedback.textureRequests());
  return named;
}

void nameRows(BenchContext& context, const std::string& name, const NamedNodes& named) {
  char note[160];
  std::snprintf(note, sizeof note, "of %zu pages; 1/8 while moving, %u results", named.truth.size(), kMovingResults);
  context.row({.what = name + ": recall of geometry",
               .measured = share(named.truth, named.geometry),
               .unit = "%",
               .goal = 100.0,
               .at_most = false,
               .baseline_name = "feedback at 1/8",
               .baseline = share(named.truth, named.eighth),
               .note = note});
  std::snprintf(note, sizeof note, "%zu pages named, by feedback %zu", named.geometry.size(), named.eighth.size());
  context.row({.what = name + ": precision of geometry",
               .measured = share(named.geometry, named.truth),
               .unit = "%",
               .baseline_name = "feedback at 1/8",
               .baseline = share(named.eighth, named.truth),
               .note = note});
}

Result<void> requestSets(BenchContext& context, const Artwork& artwork, bool relief) {
  Scene scene;
  scene.relief = relief;
  std::array<std::unique_ptr<Engine>, 2> engines;
  for (size_t i = 0; i < 2; ++i) {
    EngineOptions options;
    options.request_source = i ? RequestSource::kGeometry : RequestSource::kFeedback;
    auto engine = Engine::create(artwork, scene, options);
    if (!engine) return engine.error();
    engines[i] = std::move(*engine);
    engines[i]->resize(context.quick ? kBenchWidth / 2 : kBenchWidth, context.quick ? kBenchHeight / 2 : kBenchHeight);
  }
  for (const NamedCamera& c : cameras(artwork.manifest.domain.flat())) {
    if (context.stopped()) return {};
    auto named = nodesNamed(*engines[0], *engines[1], c.camera);
    if (!named) return named.error();
    nameRows(context, std::string(relief ? "relief, " : "flat, ") + c.name, *named);
  }
  return {};
}

}  // namespace

Result<void> requestSourceBench(BenchContext& context) {
  const Artwork artwork = artworkFromPackage(context.package);
  const FlatDomain domain = artwork.manifest.domain.flat();
  auto feedback = FlatFeedback::create(artwork.manifest);
  if (!feedback) return feedback.error();
  requestTimes(context, artwork, **feedback);
  requestsInFlight(context, domain, **feedback);
  for (bool relief : {false, true}) {
    if (relief && domain.relief_depth < 0) continue;
    if (auto done = requestSets(context, artwork, relief); !done) return done;
    if (context.stopped()) return {};
  }
  return {};
}

}  // namespace relievo
