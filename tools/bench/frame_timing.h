// frame_timing.h - how long the frames of a stage, or of an engine, take, for render --frames, plan and bench.
#pragma once

#include <vector>

#include "src/engine/stage.h"

namespace relievo {

double steadyNow();                       // seconds of a steady clock
double medianOf(std::vector<double> ms);  // 0 of none
// A frame of an Engine or a Stage, until its picture is there, ms.
template <class Drawing>
double timedFrameMs(Drawing& drawing) {
  const double start = steadyNow();
  drawing.frame(start);
  drawing.readPixels();  // waits for the picture
  return (steadyNow() - start) * 1000;
}
// Frames of a camera that trembles, so that each draws its geometry anew; fewer once the program is interrupted.
std::vector<double> movingFramesMs(Stage& stage, OrbitCamera camera, int frames);

}  // namespace relievo
