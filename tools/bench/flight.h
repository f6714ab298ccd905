// flight.h - camera paths over an artwork: recorded views to compare caches, prefetching and LOD strategies by. A
// camera is a function of time alone, so that every run sees the same frames, however fast it is.
#pragma once

#include <string>
#include <vector>

#include "src/render/camera.h"

namespace relievo {

struct FlightKey {
  double time_s = 0;
  OrbitCamera camera;
};

// Between the keys, each of azimuth, elevation, field of view, log distance and target follows a monotone cubic
// (Fritsch, Carlson 1980, with the harmonic mean of Fritsch, Butland 1984 as slope): velocities are continuous, nothing
// overshoots, and a camera that two keys leave in place stands still. The projection is that of the key before.
struct Flight {
  std::string name;
  std::vector<FlightKey> keys;  // times grow
  double duration_s() const { return keys.empty() ? 0 : keys.back().time_s; }
};

// Before the first key the first camera, after the last the last one. No keys: the default camera.
OrbitCamera cameraAt(const Flight& flight, double time_s);

struct FlightScale {
  double speed = 1;  // 1: reading takes about three seconds a screen's width
  double close_px =
      1;  // how near the close-ups come: px on screen a texel (never nearer than the artwork's half, if it is small)
};
// Each begins and ends with a moment of standing still.
Flight orbitFlight(const FlatDomain& domain, int width_px, int height_px,
                   const FlightScale& scale = {});  // around, to and fro
Flight readingFlight(const FlatDomain& domain, int width_px, int height_px,
                     const FlightScale& scale = {});  // in, two lines, out
Flight zoomFlight(const FlatDomain& domain, int width_px, int height_px,
                  const FlightScale& scale = {});  // in, out, elsewhere, back
// Unlike the others, and not to be tuned on: slanted, diagonal, with stops and turns.
Flight wanderFlight(const FlatDomain& domain, int width_px, int height_px, const FlightScale& scale = {});

}  // namespace relievo
