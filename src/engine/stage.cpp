#include "src/engine/stage.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <tuple>

#include <nlohmann/json.hpp>

#include "src/render/composition.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMib = 1024 * 1024;

struct Actor {
  std::string name;
  Pose pose;
  std::unique_ptr<Engine> engine;
  bool in_view = true;
  glm::dmat4 asked{0.0};  // the view of its last frame
  // Once it went out of view: the views that its picture, and a patch list on the way, are of. Until its picture is
  // of another one, or the present one is the same, it is not shown.
  std::optional<std::array<glm::dmat4, 2>> left_at;

  ViewTransform viewOf(const OrbitCamera& camera) const {
    return viewTransform(camera, engine->placed(), engine->width(), engine->height());
  }
};

Error named(Error error, const std::string& name) {
  if (error.file.empty() && error.kind != ErrorKind::kInterrupted) error.file = name;
  return error;
}

// Of objects of counts, and of such objects.
void addCounts(Json& to, const Json& from) {
  for (const auto& [key, value] : from.items()) {
    if (value.is_object()) addCounts(to[key], value);
    else to[key] = (to.contains(key) ? to[key].get<uint64_t>() : 0) + value.get<uint64_t>();
  }
}

// Each one's part of the page cache.
Result<std::vector<EngineOptions>> sharedOptions(std::span<const StagedArtwork> artworks, const Scene& scene,
                                                 const EngineOptions& options, std::vector<std::string>& notices) {
  std::vector<CacheNeed> needs;
  uint64_t least = 0;
  for (const StagedArtwork& one : artworks) {
    auto need = Engine::cacheNeed(one.artwork, stagedScene(scene, one.pose, {}), options);
    if (!need) return named(need.error(), one.name);
    needs.push_back(*need);
    least += need->least_bytes;
  }
  auto budget_mib = cacheMibFor(least, options, true, notices);
  if (!budget_mib) return budget_mib.error();
  const auto shares = shareCache(needs, static_cast<uint64_t>(*budget_mib * kMib));
  std::vector<EngineOptions> all(artworks.size(), options);
  for (size_t i = 0; i < all.size(); ++i) {
    all[i].cache_mib = static_cast<double>(shares[i]) / kMib;
    all[i].most_cache_mib = 0;
    all[i].workers = std::max(1, options.workers / static_cast<int>(all.size()));
    all[i].uploads_per_frame = std::max(1u, options.uploads_per_frame / static_cast<uint32_t>(all.size()));
    all[i].keep_depth = true;
  }
  return all;
}

}  // namespace

std::vector<uint64_t> shareCache(std::span<const CacheNeed> needs, uint64_t budget_bytes) {
  std::vector<uint64_t> shares;
  uint64_t rest = budget_bytes;
  for (const CacheNeed& need : needs) {
    shares.push_back(need.least_bytes);
    assert(rest >= need.least_bytes);
    rest -= need.least_bytes;
  }
  // Those that have the least use for more first: what they leave is the others'.
  std::vector<size_t> order(needs.size());
  std::iota(order.begin(), order.end(), size_t{0});
  const auto use = [&](size_t i) { return needs[i].most_bytes - std::min(needs[i].most_bytes, needs[i].least_bytes); };
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return use(a) < use(b); });
  for (size_t k = 0; k < order.size(); ++k) {
    const uint64_t more = std::min(use(order[k]), rest / (order.size() - k));
    shares[order[k]] += more;
    rest -= more;
  }
  return shares;
}

glm::dvec3 middleOf(std::span<const PlacedExtent> flat_extents) { return worldExtent(flat_extents).centre(); }

Scene stagedScene(const Scene& scene, const Pose& pose, const std::optional<glm::dvec3>& middle_mm) {
  Scene own = scene;
  own.pose = pose;
  for (SceneLight& light : own.lights)
    if (middle_mm && light.near && light.reference_mm == 0)
      light.reference_mm = placedLight(light, glm::dmat3(1), *middle_mm).reference_mm;
  return own;
}

std::string stagedProblem(const Scene& scene, const glm::dvec3& middle_mm) {
  for (const SceneLight& light : scene.lights)
    if (light.near && light.reference_mm == 0 && placedLight(light, glm::dmat3(1), middle_mm).reference_mm == 0)
      return "a light in the middle of the artworks needs a distance at which its intensity is as stated "
             "(reference_mm)";
  return "";
}

bool isInView(const OrbitCamera& camera, const PlacedExtent& placed, int width_px, int height_px) {
  const ViewTransform view = viewTransform(camera, placed, width_px, height_px);
  const glm::dvec3 &low = placed.extent.min_mm, &high = placed.extent.max_mm;
  // A box lies beyond a side of the picture, or behind the eye, where its corners do.
  std::array<int, 5> beyond{};
  for (int corner = 0; corner < 8; ++corner) {
    const glm::dvec4 p = view.clip_from_world * glm::dvec4(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y,
                                                           corner & 4 ? high.z : low.z, 1);
    beyond[0] += p.x > p.w;
    beyond[1] += p.x < -p.w;
    beyond[2] += p.y > p.w;
    beyond[3] += p.y < -p.w;
    beyond[4] += p.w <= 0;
  }
  return std::none_of(beyond.begin(), beyond.end(), [](int count) { return count == 8; });
}

struct Stage::Impl {
  Scene scene;
  std::optional<glm::dvec3> middle_mm;  // of several artworks
  std::vector<Actor> actors;
  std::vector<size_t> order;  // of several: by pose and name, so that their order in the file decides on nothing
  OrbitCamera camera;
  std::vector<std::string> notices;
  gl::ContextInfo context;
  std::optional<Composition> composition;
  bool composition_failed = false;  // its shaders do not link here
  std::unique_ptr<ScreenPass> screen;

  bool single() const { return actors.size() == 1; }
  // Before any artwork takes the scene, so that all show the same one.
  Result<void> check(const Scene& wanted) const {
    if (!middle_mm) return {};
    if (const std::string problem = stagedProblem(wanted, *middle_mm); !problem.empty())
      return Error{ErrorKind::kUsage, "", problem, "", {}};
    for (const Actor& actor : actors)
      if (const std::string problem =
              sceneProblem(stagedScene(wanted, actor.pose, middle_mm), actor.engine->manifest());
          !problem.empty())
        return named({ErrorKind::kUsage, "", problem, "", {}}, actor.name);
    return {};
  }
  void updateInView() {
    for (Actor& actor : actors) {
      if (single()) continue;
      const Engine& e = *actor.engine;
      const bool before = std::exchange(actor.in_view, isInView(camera, e.placed(), e.width(), e.height()));
      if (before && !actor.in_view && !actor.left_at) actor.left_at = {e.view().clip_from_world, actor.asked};
    }
  }
  // Those whose picture is one of the present view.
  std::vector<size_t> shown() {
    std::vector<size_t> all;
    for (size_t i : order) {
      Actor& actor = actors[i];
      if (!actor.in_view) continue;
      if (actor.left_at) {
        const glm::dmat4 drawn = actor.engine->view().clip_from_world;
        const bool old = drawn == (*actor.left_at)[0] || drawn == (*actor.left_at)[1];
        const Engine& e = *actor.engine;
        const Engine::Layer layer = actor.engine->layer();
        const bool resized = layer.picture.width() != e.width() || layer.picture.height() != e.height();
        if (resized || (old && drawn != actor.viewOf(camera).clip_from_world)) continue;
        actor.left_at.reset();
      }
      all.push_back(i);
    }
    return all;
  }
  // False: what it is made with could not be linked.
  bool compose(std::span<const size_t> layers, const glm::vec4& behind) {
    const Engine& first = *actors[0].engine;
    if (composition_failed) return false;
    if (!composition) {
      const DepthMode depth = actors[0].engine->layer().depth_mode;
      auto made = Composition::create(context.api, depth);
      if (!made) {
        notices.push_back(made.error().text());
        composition_failed = true;
        return false;
      }
      composition.emplace(std::move(*made));
      screen = std::make_unique<ScreenPass>(depth);
    }
    composition->begin(first.width(), first.height(), static_cast<int>(layers.size()));
    for (size_t k = 0; k < layers.size(); ++k) {
      const Engine::Layer layer = actors[layers[k]].engine->layer();
      composition->take(static_cast<int>(k), layer.picture, layer.depth, layer.view);
    }
    composition->draw(*screen, behind);
    return true;
  }
  std::vector<std::string> prefixed(std::vector<std::string> texts, const Actor& actor) const {
    if (!single())
      for (std::string& text : texts) text = actor.name + ": " + text;
    return texts;
  }
};

Stage::Stage(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Stage::~Stage() = default;

Result<std::unique_ptr<Stage>> Stage::create(std::vector<StagedArtwork> artworks, const Scene& scene,
                                             const EngineOptions& options) {
  assert(!artworks.empty() && artworks.size() <= kMostArtworks);
  auto impl = std::make_unique<Impl>();
  impl->scene = scene;
  impl->context = gl::currentContextInfo();
  std::vector<EngineOptions> each{options};
  const bool several = artworks.size() > 1;
  if (several) {
    std::vector<PlacedExtent> flat;
    for (const StagedArtwork& one : artworks) flat.push_back({artworkExtent(one.artwork.manifest, 0), one.pose});
    impl->middle_mm = middleOf(flat);
    if (auto sound = impl->check(scene); !sound) return sound.error();
    auto shared = sharedOptions(artworks, scene, options, impl->notices);
    if (!shared) return shared.error();
    each = std::move(*shared);
  }
  for (size_t i = 0; i < artworks.size(); ++i) {
    StagedArtwork& one = artworks[i];
    auto engine = Engine::create(std::move(one.artwork), stagedScene(scene, one.pose, impl->middle_mm), each[i]);
    if (!engine) return several ? named(engine.error(), one.name) : engine.error();
    impl->actors.push_back({std::move(one.name), one.pose, std::move(*engine)});
    impl->order.push_back(i);
  }
  const auto key = [&](size_t i) {
    const Actor& a = impl->actors[i];
    return std::tie(a.pose.position_mm, a.pose.rotate_deg, a.name);
  };
  std::stable_sort(impl->order.begin(), impl->order.end(), [&](size_t a, size_t b) { return key(a) < key(b); });
  impl->camera = impl->actors[0].engine->camera();
  std::unique_ptr<Stage> stage(new Stage(std::move(impl)));
  if (several) stage->setCamera(fitCamera(stage->placed(), stage->width(), stage->height()));
  return stage;
}

size_t Stage::size() const { return impl_->actors.size(); }
const Engine& Stage::engine(size_t i) const { return *impl_->actors[i].engine; }
const std::string& Stage::name(size_t i) const { return impl_->actors[i].name; }
const Pose& Stage::pose(size_t i) const { return impl_->actors[i].pose; }
bool Stage::inView(size_t i) const { return impl_->actors[i].in_view; }
std::vector<PlacedExtent> Stage::placed() const {
  std::vector<PlacedExtent> all;
  for (const Actor& actor : impl_->actors) all.push_back(actor.engine->placed());
  return all;
}

void Stage::resize(int width_px, int height_px) {
  for (Actor& actor : impl_->actors) actor.engine->resize(width_px, height_px);
  impl_->updateInView();
}
int Stage::width() const { return impl_->actors[0].engine->width(); }
int Stage::height() const { return impl_->actors[0].engine->height(); }
void Stage::setCamera(const OrbitCamera& camera) {
  impl_->camera = camera;
  for (Actor& actor : impl_->actors) actor.engine->setCamera(camera);
  impl_->updateInView();
}
const OrbitCamera& Stage::camera() const { return impl_->camera; }

Result<void> Stage::setScene(const Scene& scene) {
  if (auto sound = impl_->check(scene); !sound) return sound;
  for (Actor& actor : impl_->actors)
    if (auto set = actor.engine->setScene(stagedScene(scene, actor.pose, impl_->middle_mm)); !set)
      return impl_->single() ? set.error() : named(set.error(), actor.name);
  impl_->scene = scene;
  impl_->updateInView();
  return {};
}
const Scene& Stage::scene() const { return impl_->scene; }

void Stage::frame(double now_s) {
  for (Actor& actor : impl_->actors) {
    if (!actor.in_view) continue;
    if (!impl_->single()) actor.asked = actor.viewOf(impl_->camera).clip_from_world;
    actor.engine->frame(now_s);
  }
}

bool Stage::refine(double now_s) {
  bool drawn = false;
  for (Actor& actor : impl_->actors)
    if (actor.in_view) drawn = actor.engine->refine(now_s) || drawn;
  return drawn;
}

Result<void> Stage::settle(double timeout_s, bool refined) {
  for (Actor& actor : impl_->actors) {
    if (!actor.in_view) continue;
    if (auto settled = actor.engine->settle(timeout_s, refined); !settled)
      return impl_->single() ? settled.error() : named(settled.error(), actor.name);
    actor.left_at.reset();
  }
  return {};
}

std::vector<uint8_t> Stage::readPixels() {
  Impl& s = *impl_;
  if (s.single()) return s.actors[0].engine->readPixels();
  const std::vector<size_t> shown = s.shown();
  if (shown.size() == 1) return s.actors[shown[0]].engine->readPixels();
  if (shown.empty() || !s.compose(shown, glm::vec4(0)))
    return std::vector<uint8_t>(static_cast<size_t>(width()) * static_cast<size_t>(height()) * 4);
  return s.composition->picture().readPixels();
}

void Stage::present(int window_width_px, int window_height_px) {
  Impl& s = *impl_;
  if (s.single()) return s.actors[0].engine->present(window_width_px, window_height_px);
  const std::vector<size_t> shown = s.shown();
  if (shown.size() == 1) return s.actors[shown[0]].engine->present(window_width_px, window_height_px);
  if (s.compose(shown, pictureGreyLight())) s.composition->picture().present(window_width_px, window_height_px);
}

std::optional<glm::dvec3> Stage::surfacePoint(double x_px, double y_px) {
  Impl& s = *impl_;
  if (s.single()) return s.actors[0].engine->surfacePoint(x_px, y_px);
  std::optional<glm::dvec3> nearest;
  const glm::dvec3 towards = worldFromCamera(s.camera)[2];
  for (const size_t i : s.shown()) {
    const auto place = s.actors[i].engine->surfacePoint(x_px, y_px);
    if (place && (!nearest || glm::dot(*place - *nearest, towards) > 0)) nearest = place;
  }
  return nearest;
}

std::vector<std::string> Stage::takeMessages() {
  std::vector<std::string> all = std::exchange(impl_->notices, {});
  for (Actor& actor : impl_->actors)
    for (std::string& text : impl_->prefixed(actor.engine->takeMessages(), actor)) all.push_back(std::move(text));
  return all;
}

std::vector<std::string> Stage::takeNotices() {
  std::vector<std::string> all = std::exchange(impl_->notices, {});
  for (Actor& actor : impl_->actors)
    for (std::string& text : impl_->prefixed(actor.engine->takeNotices(), actor)) all.push_back(std::move(text));
  return all;
}

PageFailures Stage::failures() const {
  PageFailures all;
  for (const Actor& actor : impl_->actors) {
    PageFailures own = actor.engine->failures();
    if (own.pages == 0) continue;
    if (!impl_->single()) own.first = actor.name + ": " + own.first;
    all.add(own);
  }
  return all;
}

uint64_t Stage::compositionBytes() const { return impl_->composition ? impl_->composition->bytes() : 0; }

EngineStats Stage::stats() const {
  if (impl_->single()) return impl_->actors[0].engine->stats();
  std::vector<EngineStats> all;
  for (const Actor& actor : impl_->actors) {
    EngineStats own = actor.engine->stats();
    if (!actor.in_view) {
      own.instances = own.triangles = own.draw_calls = own.wanted_nodes = own.missing_pages = own.edges_limited = 0;
      own.predicted_error_px = own.detail_bias = own.lod_ms = own.determine_ms = 0;
      own.switching = false;
      own.refined = true;
      own.samples = 0;  // counts in no minimum
      own.directions = 0;
      own.passes.clear();
    }
    all.push_back(std::move(own));
  }
  EngineStats sum = sumOf(all);
  if (impl_->composition) {
    sum.passes.emplace_back("composition");
    ++sum.draw_calls;
  }
  return sum;
}

std::string Stage::statsJson() const {
  const Engine& first = engine(0);
  if (impl_->single()) return engineStatsJson(first.stats(), first.manifest());
  Json sum = Json::parse(engineStatsJson(stats(), first.manifest())), planes = Json::object(), each = Json::array();
  for (size_t i = 0; i < size(); ++i) {
    Json own = Json::parse(engineStatsJson(engine(i).stats(), engine(i).manifest()));
    addCounts(planes, own["planes"]);
    Json one = {{"artwork", name(i)}, {"in_view", inView(i)}};
    one.update(own);
    each.push_back(std::move(one));
  }
  sum["planes"] = std::move(planes);
  sum["composition_mib"] = static_cast<double>(compositionBytes()) / kMib;
  sum["artworks"] = std::move(each);
  return sum.dump(2, ' ', false, Json::error_handler_t::replace);
}

}  // namespace relievo
