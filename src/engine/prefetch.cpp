#include "src/engine/prefetch.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <utility>

#include "geometry/lod/planar_lod.h"
#include "src/base/mailbox.h"
#include "src/base/worker_threads.h"

namespace relievo {
namespace {

constexpr double kGap_s = 1;

std::array<double, 6> valuesOf(const OrbitCamera& c) {
  return {c.azimuth_deg, c.elevation_deg, std::log(c.distance_mm), c.target_mm.x, c.target_mm.y, c.target_mm.z};
}

}  // namespace

double prefetchHorizon(double latency_p90_s, const PredictorOptions& options) {
  return std::clamp(2 * latency_p90_s, std::min(kShortestHorizon_s, options.horizon_s), options.horizon_s);
}

void CameraPredictor::observe(const OrbitCamera& camera, double now_s) {
  if (!past_.empty() &&
      (now_s <= past_.back().time_s || now_s > past_.back().time_s + kGap_s ||
       camera.fov_deg != past_.back().camera.fov_deg || camera.orthographic != past_.back().camera.orthographic)) {
    past_.clear();
  }
  past_.push_back({now_s, camera});
  // At least two, so that slow frames have a velocity, too.
  while (past_.size() > 2 && past_[1].time_s <= now_s - options_.window_s) past_.pop_front();
}

std::array<double, CameraPredictor::kValues> CameraPredictor::velocity() const {
  std::array<double, kValues> v{};
  if (past_.size() < 2) return v;
  double mean_t = 0;
  std::array<double, kValues> mean{};
  auto n = static_cast<double>(past_.size());
  for (const Seen& s : past_) {
    mean_t += s.time_s / n;
    auto values = valuesOf(s.camera);
    for (size_t k = 0; k < kValues; ++k) mean[k] += values[k] / n;
  }
  double tt = 0;
  for (const Seen& s : past_) {
    double dt = s.time_s - mean_t;
    tt += dt * dt;
    auto values = valuesOf(s.camera);
    for (size_t k = 0; k < kValues; ++k) v[k] += dt * (values[k] - mean[k]);
  }
  for (double& x : v) x /= tt;
  // From the window's mean distance to the present one.
  double nearer = past_.back().camera.distance_mm / std::exp(mean[2]);
  for (size_t k = 3; k < kValues; ++k) v[k] *= nearer;
  return v;
}

OrbitCamera CameraPredictor::predict(double ahead_s) const {
  if (past_.empty()) return {};
  OrbitCamera c = past_.back().camera;
  auto v = velocity();
  c.azimuth_deg += v[0] * ahead_s;
  c.elevation_deg = std::clamp(c.elevation_deg + v[1] * ahead_s, -89.0, 89.0);
  c.distance_mm *= std::exp(v[2] * ahead_s);
  // The integral of exp(v2 t) from 0 to ahead_s: the distance's factor over the time.
  double way_s = std::abs(v[2] * ahead_s) < 1e-6 ? ahead_s : std::expm1(v[2] * ahead_s) / v[2];
  c.target_mm += glm::dvec3(v[3], v[4], v[5]) * way_s;
  return c;
}

bool CameraPredictor::moves(int height_px) const {
  if (past_.size() < 2) return false;
  const OrbitCamera& now = past_.back().camera;
  OrbitCamera then = predict(options_.horizon_s);
  double pixels_per_radian = height_px / (2 * std::tan(now.fov_deg * std::numbers::pi / 360));
  double nearer_mm = std::min(now.distance_mm, then.distance_mm);
  double turned =
      std::max(std::abs(then.azimuth_deg - now.azimuth_deg), std::abs(then.elevation_deg - now.elevation_deg));
  double moved_px = pixels_per_radian * glm::length(then.target_mm - now.target_mm) / nearer_mm;
  moved_px += pixels_per_radian * turned * std::numbers::pi / 180;
  moved_px += 0.5 * height_px * std::abs(std::log(then.distance_mm / now.distance_mm));
  return moved_px >= options_.still_px;
}

std::vector<OrbitCamera> CameraPredictor::views(double horizon_s) const {
  std::vector<OrbitCamera> result;
  for (int i = 1; i <= options_.steps; ++i) result.push_back(predict(horizon_s * i / options_.steps));
  return result;
}

void PredictedRequests::begin(double now_s) {
  if (now_s < now_s_) known_.clear();
  now_s_ = now_s;
}

void PredictedRequests::add(const NodeId& node, float centre_distance) {
  auto [it, is_new] = known_.try_emplace(node, Known{now_s_, centre_distance});
  if (!is_new && it->second.last_s == now_s_) centre_distance = std::min(centre_distance, it->second.centre_distance);
  it->second = {now_s_, centre_distance};
}

const std::vector<NodeRequest>& PredictedRequests::finish() {
  std::erase_if(known_, [&](const auto& k) { return k.second.last_s + kRemember_s < now_s_; });
  requests_.clear();
  for (const auto& [node, k] : known_) requests_.push_back({node, 1, k.last_s == now_s_ ? k.centre_distance : 2.0f});
  return requests_;
}

struct Prefetcher::Impl {
  Impl(const FlatDomain& d, std::shared_ptr<const ReliefOracle> o) : domain(d), oracle(std::move(o)) {
    // Without a thread nothing is determined ahead of time: pages come when they are in view.
    thread.start(1, [this] { work(); });
  }
  ~Impl() {
    requests.close();
    thread.join();
  }

  void work() {
    static const ReliefSet kNothing;
    PredictedRequests texture, relief;
    while (std::optional<Request> request = requests.take()) {
      auto start = std::chrono::steady_clock::now();
      Answer answer;
      texture.begin(request->now_s);
      for (const TextureView& view : request->texture)
        for (const TextureRequest& w : selectTextureNodes(domain, *oracle, view)) texture.add(w.node, w.priority);
      answer.texture = texture.finish();
      relief.begin(request->now_s);
      if (request->relief) {
        const ReliefSet& resident = request->resident ? *request->resident : kNothing;
        for (const ReliefRequest& w : selectPlanarLod(domain, *oracle, *request->relief, resident).requests)
          relief.add(w.page, w.priority);
      }
      answer.relief = relief.finish();
      answer.determine_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
      answers.post(std::move(answer));
    }
  }

  const FlatDomain domain;
  const std::shared_ptr<const ReliefOracle> oracle;
  Mailbox<Request> requests;
  Mailbox<Answer> answers;
  WorkerThreads thread{"relievo-ahead"};  // last
};

Prefetcher::Prefetcher(const FlatDomain& domain, std::shared_ptr<const ReliefOracle> oracle)
    : impl_(std::make_unique<Impl>(domain, std::move(oracle))) {}
Prefetcher::~Prefetcher() = default;
void Prefetcher::post(Request request) {
  if (!impl_->thread.empty()) impl_->requests.post(std::move(request));
}
std::optional<Prefetcher::Answer> Prefetcher::tryTake() {
  impl_->thread.rethrow();
  return impl_->answers.tryTake();
}

}  // namespace relievo
