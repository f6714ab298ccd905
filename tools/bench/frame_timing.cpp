#include "tools/bench/frame_timing.h"

#include <algorithm>
#include <chrono>

#include "src/base/progress.h"

namespace relievo {

double steadyNow() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double medianOf(std::vector<double> ms) {
  if (ms.empty()) return 0;
  std::nth_element(ms.begin(), ms.begin() + static_cast<std::ptrdiff_t>(ms.size() / 2), ms.end());
  return ms[ms.size() / 2];
}

std::vector<double> movingFramesMs(Stage& stage, OrbitCamera camera, int frames) {
  std::vector<double> ms;
  for (int i = 0; i < frames && !interruptedFlag(); ++i) {
    camera.azimuth_deg += i % 2 == 0 ? 1e-6 : -1e-6;
    stage.setCamera(camera);
    ms.push_back(timedFrameMs(stage));
  }
  return ms;
}

}  // namespace relievo
