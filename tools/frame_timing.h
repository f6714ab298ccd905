// frame_timing.h - how long the frames of a stage take, for render --frames and plan.
#pragma once

#include <vector>

#include "src/engine/stage.h"

namespace relievo {

double steadyNow();                       // seconds of a steady clock
double medianOf(std::vector<double> ms);  // 0 of none
// A frame, until its picture is there, ms.
double timedFrameMs(Stage& stage);
// Frames of a camera that trembles, so that each draws its geometry anew; fewer once the program is interrupted.
std::vector<double> movingFramesMs(Stage& stage, OrbitCamera camera, int frames);

}  // namespace relievo
