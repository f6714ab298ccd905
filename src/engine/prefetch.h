// prefetch.h - predicts where the camera will be when a page that is requested now arrives, and which pages it will
// need there. The prediction is pure; the engine and simulations share it. The Prefetcher determines the pages on a
// thread of its own, on the CPU.
#pragma once

#include <array>
#include <cstddef>
#include <deque>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

#include "geometry/lod/lod.h"
#include "geometry/lod/texture_select.h"
#include "src/render/camera.h"
#include "texturing/stream/feedback.h"

namespace relievo {

struct PredictorOptions {
  // The velocity is fitted to the cameras of the last window_s, to even out the jitter of hands and frame times.
  double window_s = 0.1;
  double horizon_s = 0.6;  // how far ahead at most; see prefetchHorizon()
  int steps = 2;           // views predicted up to there, evenly spaced
  double still_px = 2;     // a camera predicted to move less than this on screen until horizon_s counts as still
};

// How far ahead to predict: twice the 90th percentile of the latency from request to display, since a page must be
// requested as early as it takes to arrive, and a view's pages as early as they take together. At least
// kShortestHorizon_s, at most horizon_s. At 0.6 s flights over a link of 20 MB/s and 50 ms have most of the gain
// (relievo bench --only prefetch); beyond it, the share of pages that are read in vain grows faster.
inline constexpr double kShortestHorizon_s = 0.2;
double prefetchHorizon(double latency_p90_s, const PredictorOptions& options);

// Constant velocity in azimuth, elevation, log distance and target, by least squares over the window. The target's
// velocity is relative to the distance: zooming in on a place approaches it ever more slowly, and panning keeps a
// constant number of screens a second.
class CameraPredictor {
 public:
  explicit CameraPredictor(PredictorOptions options = {}) : options_(options) {}

  // Takes each frame's camera. Forgets the past where time does not grow or jumps by more than a second, or where the
  // field of view or the projection changes.
  void observe(const OrbitCamera& camera, double now_s);
  void reset() { past_.clear(); }
  OrbitCamera predict(double ahead_s) const;  // at now_s + ahead_s; the newest camera where too few were observed
  bool moves(int height_px) const;            // false: still (PredictorOptions::still_px)
  // The views to prefetch for, up to a horizon, nearest in time first.
  std::vector<OrbitCamera> views(double horizon_s) const;
  const PredictorOptions& options() const { return options_; }

 private:
  static constexpr size_t kValues = 6;  // azimuth, elevation, log distance, target
  struct Seen {
    double time_s;
    OrbitCamera camera;
  };
  std::array<double, kValues> velocity() const;

  PredictorOptions options_;
  std::deque<Seen> past_;
};

// The nodes predicted lately. Predictions fluctuate: a page under way that drops out of the list for some frames would
// be cancelled and read again. So a node stays in the list for kRemember_s after it was last predicted, behind those
// that are predicted now.
class PredictedRequests {
 public:
  static constexpr double kRemember_s = 0.25;

  // begin(), add() for the nodes of the views that are predicted now, finish(). Each node is listed once, with its
  // smallest distance from a view's centre.
  void begin(double now_s);
  void add(const NodeId& node, float centre_distance);
  const std::vector<NodeRequest>& finish();

 private:
  struct Known {
    double last_s;
    float centre_distance;
  };
  double now_s_ = 0;
  std::unordered_map<NodeId, Known> known_;
  std::vector<NodeRequest> requests_;
};

// Takes the newest request and gives the newest answer. Used from one thread, which waits in the destructor only. Where
// no thread can be started, requests have no answer and nothing is prefetched.
class Prefetcher {
 public:
  struct Request {
    std::vector<TextureView> texture;
    std::optional<LodView> relief;  // the view farthest ahead
    std::shared_ptr<const ReliefSet> resident;
    double now_s = 0;
  };
  struct Answer {
    std::vector<NodeRequest> texture, relief;
    double determine_ms = 0;
  };

  Prefetcher(const FlatDomain& domain, std::shared_ptr<const ReliefOracle> oracle);
  ~Prefetcher();
  void post(Request request);
  std::optional<Answer> tryTake();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
