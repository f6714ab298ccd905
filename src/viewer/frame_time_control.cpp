#include "src/viewer/frame_time_control.h"

#include <algorithm>
#include <cmath>

namespace relievo {

void FrameTimeControl::observe(double frame_ms, bool moving) {
  if (!moving || !(frame_ms > 0) || !std::isfinite(frame_ms)) return;
  if (unjudged_ > 0) {
    --unjudged_;
    return;
  }
  if (frame_ms <= target_ms_ && frame_ms >= kLow * target_ms_) return;
  const double wanted = std::clamp(pressure_ + kGain * std::log2(frame_ms / (kAim * target_ms_)), 0.0, kMostPressure);
  if (wanted == pressure_) return;
  pressure_ = wanted;
  unjudged_ = kFramesUnjudged;
}

Scene FrameTimeControl::spend(const Scene& exact) const {
  Scene scene = exact;
  if (pressure_ > 0) scene.sampling = std::min(scene.sampling, Sampling::kBilinear);
  if (pressure_ > kSamplingPressure) {
    // From an error of nothing, too, something can be given up.
    constexpr double kLeastErrorPx = 0.25;
    scene.error_px = std::max(scene.error_px, kLeastErrorPx) * std::exp2(2 * (pressure_ - kSamplingPressure));
  }
  return scene;
}

const char* FrameTimeControl::givenUp() const {
  return pressure_ > kSamplingPressure ? "geometry" : pressure_ > 0 ? "sampling" : "";
}

}  // namespace relievo
