// prefetch.h - where the camera will be when a page asked for now arrives, and what it will want there. The prediction
// is pure, and used by the engine and by simulations alike; the Prefetcher determines the pages on a thread of its own,
// on the CPU.
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
  double window_s =
      0.1;  // cameras of this age and younger tell the velocity: evens out the jitter of hands and frame times
  double horizon_s = 0.6;  // how far ahead at most; see prefetchHorizon()
  int steps = 2;           // views predicted up to there, evenly spaced
  double still_px = 2;     // predicted to move less than this on screen until horizon_s: the camera stands still
};

// A page has to be asked for as long ahead as it takes to come, and a view's worth of them as long as they take
// together: twice the 90th percentile of the latency from wanted to shown, within these bounds. 0.6 s is where flights
// at 20 MB/s and 50 ms have most of the gain (relievo bench --only prefetch); beyond, what is read in vain grows
// faster.
inline constexpr double kShortestHorizon_s = 0.2;
double prefetchHorizon(double latency_p90_s, const PredictorOptions& options);

// Constant velocity in azimuth, elevation, log distance and target, by least squares over the window. The target's
// velocity is meant relative to the distance: who zooms in on a place moves ever more slowly towards it, and who pans
// keeps to so many screens a second.
class CameraPredictor {
 public:
  explicit CameraPredictor(PredictorOptions options = {}) : options_(options) {}

  // Each frame's camera; times that do not grow, or that jump by more than a second, another field of view or
  // projection start it anew.
  void observe(const OrbitCamera& camera, double now_s);
  void reset() { past_.clear(); }
  OrbitCamera predict(double ahead_s) const;  // at now_s + ahead_s; the newest camera when there is too little to go by
  bool moves(int height_px) const;            // by still_px or more until the longest horizon
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

// What was predicted lately. Predictions tremble; a page that is on its way and drops out of the list for some frames
// would be cancelled and read again. So a node stays listed until it was not predicted for kRemember_s, behind what is
// predicted now.
class PredictedRequests {
 public:
  static constexpr double kRemember_s = 0.25;

  // The views predicted now, by their nodes: each node once, as urgent as where it is nearest to the centre.
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

// Newest request in, newest answer out; used from one thread, which never waits (but for the destructor). Where no
// thread can be started nothing is predicted: requests have no answer.
class Prefetcher {
 public:
  struct Request {
    std::vector<TextureView> texture;
    std::optional<LodView> relief;  // of the farthest view ahead
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
