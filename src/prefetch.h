// prefetch.h - where the camera will be when a page asked for now arrives. Pure; used by the engine and by simulations alike.
#pragma once

#include <array>
#include <cstddef>
#include <deque>
#include <vector>

#include "src/camera.h"

namespace relievo {

struct PredictorOptions {
  double window_s = 0.1;   // cameras of this age and younger tell the velocity: evens out the jitter of hands and frame times
  double horizon_s = 0.5;  // how far ahead
  int steps = 2;           // views predicted up to there, evenly spaced
  double still_px = 2;     // predicted to move less than this on screen: the camera stands still
};

// Constant velocity in azimuth, elevation, log distance and target, by least squares over the window. The target's velocity is
// meant relative to the distance: who zooms in on a place moves ever more slowly towards it, and who pans keeps to so many screens a
// second.
class CameraPredictor {
 public:
  explicit CameraPredictor(PredictorOptions options = {}) : options_(options) {}

  // Each frame's camera; times that do not grow, or that jump by more than a second, start it anew.
  void observe(const OrbitCamera& camera, double now_s);
  void reset() { past_.clear(); }
  OrbitCamera predict(double ahead_s) const;  // at now_s + ahead_s; the newest camera when there is too little to go by
  // The views to prefetch for, nearest in time first; empty when the camera stands still (or is about to).
  std::vector<OrbitCamera> views(int height_px) const;

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

}  // namespace relievo
