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
  if (frame_ms <= kHigh * target_ms_ && frame_ms >= kLow * target_ms_) return;
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
    const double spent =
        std::min(pressure_, kGeometryPressure) - kSamplingPressure + std::max(0.0, pressure_ - kResolutionPressure);
    // In pixels of the picture that is drawn, which the window shows larger.
    scene.error_px = std::max(scene.error_px, kLeastErrorPx) * std::exp2(2 * spent) * scale();
  }
  return scene;
}

// In sixteenths: a new size is new memory, so that small changes of the pressure leave it alone.
double FrameTimeControl::scale() const {
  const double halvings = std::clamp(pressure_ - kGeometryPressure, 0.0, kResolutionPressure - kGeometryPressure);
  return std::ceil(16 * std::exp2(-0.5 * halvings)) / 16;
}

std::array<int, 2> FrameTimeControl::size(int width_px, int height_px) const {
  const auto scaled = [&](int px) { return std::max(1, static_cast<int>(std::lround(px * scale()))); };
  return {scaled(width_px), scaled(height_px)};
}

const char* FrameTimeControl::givenUp() const {
  return scale() < 1 ? "resolution" : pressure_ > kSamplingPressure ? "geometry" : pressure_ > 0 ? "sampling" : "";
}

}  // namespace relievo
