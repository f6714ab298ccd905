// frame_timing.h - how long an engine's frames take, for render --frames, plan and bench.
#pragma once

#include <vector>

#include "src/engine/engine.h"

namespace relievo {

double steadyNow();                       // seconds of a steady clock
double medianOf(std::vector<double> ms);  // 0 of none
// A frame, until its picture is there, ms.
double timedFrameMs(Engine& engine);
// Frames of a camera that trembles, so that each draws its geometry anew; fewer once the program is interrupted.
std::vector<double> movingFramesMs(Engine& engine, OrbitCamera camera, int frames);

}  // namespace relievo
