// frame_time_control.h - holds the time of a moving frame by giving up accuracy where that is cheapest, and gives none
// up while the camera stands still. Pure: the caller measures time, so that tests can simulate it.
//
// What is given up is one number, the pressure. In the order in which the settings cost the least accuracy for the time
// that they save (relievo accuracy, of the sample artworks): up to kSamplingPressure textures are sampled bilinearly;
// up to kGeometryPressure the geometric error grows to four times; up to kResolutionPressure the picture loses half of
// its width and height, which is what helps where pixels take the time, as in software; then the error grows again.
//
// Control is proportional, in logarithms: a frame that takes twice too long raises the pressure by kGain. A change
// shows only after its patch list has come, a frame or two later: frames until then are not judged. Between kLow and
// kHigh of the target nothing changes, so that noise does not make it tremble; the rest of it is for frames that take
// longer than their neighbours. Where one unit of pressure saves a factor of 1 to 2.2 in time, a step of load by 4 is
// settled within ten frames: so a unit halves the pixels.
#pragma once

#include <array>

#include "src/engine/effect_plan.h"

namespace relievo {

class FrameTimeControl {
 public:
  static constexpr double kGain = 0.9;
  static constexpr double kLow = 0.65, kHigh = 0.85, kAim = 0.71;  // of the target
  static constexpr double kSamplingPressure = 0.25, kGeometryPressure = 1.25, kResolutionPressure = 3.25,
                          kMostPressure = 4.25;
  static constexpr int kFramesUnjudged = 1;  // after a change

  explicit FrameTimeControl(double target_ms) : target_ms_(target_ms) {}
  // After each frame. moving: it was drawn with spend(); a still frame is not judged.
  void observe(double frame_ms, bool moving);
  double pressure() const { return pressure_; }
  // What to draw while the camera moves, of what is wanted while it stands still.
  Scene spend(const Scene& exact) const;
  // And at what size, of a window's.
  std::array<int, 2> size(int width_px, int height_px) const;
  // In one word: "" (nothing), "sampling", "geometry" or "resolution".
  const char* givenUp() const;

 private:
  double scale() const;

  double target_ms_;
  double pressure_ = 0;
  int unjudged_ = 0;
};

}  // namespace relievo
