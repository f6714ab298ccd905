// compare_path.h - the cameras of a comparison: a recorded flight (tools/bench/flight.h, or around a body) or a file.
#pragma once

#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/render/camera.h"
#include "texturing/package/package.h"

namespace relievo {

struct CompareCamera {
  OrbitCamera now;
  OrbitCamera
      before;  // a sixtieth of a second earlier (of a file: the camera before): what pops is measured from there
};

// name: orbit, flyover (reading, tilted by kFlyoverTilt_deg) or zoom, `frames` moments at even distances; or a file of
// JSON, all of whose cameras are taken where frames is 0, else as many at even distances:
//   {"cameras": [{"azimuth_deg": 20, "elevation_deg": 10, "distance_mm": 400, "fov_deg": 35, "orthographic": false,
//   "target_mm": [0, 0, 0]}, ...]}
// What a camera leaves out is that of a camera which sees all of the artwork. Orthographic, the picture is as high and
// wide as what perspective shows of the plane through the target. Around a body (an artwork over a base mesh): orbit
// goes once around it (a sheet's: to and fro before the side that it faces); flyover goes close over its surface, a
// third of the way around, looking at it at a slant (where something stands in the way, less of one); zoom comes close
// to four places, each seen from another side.
inline constexpr double kFlyoverTilt_deg = -50;
inline constexpr size_t kMaxCameras = 100000;
Result<std::vector<CompareCamera>> compareCameras(const std::string& name, int frames, const FlatDomain& domain,
                                                  int width_px, int height_px);
Result<std::vector<CompareCamera>> compareCameras(const std::string& name, int frames, const Manifest& artwork,
                                                  int width_px, int height_px);

}  // namespace relievo
