// flight_simulation.h - what flights ask of the page cache and of the link to the pages, computed on the CPU: no GL, no real time.
#pragma once

#include "geometry/planar_lod.h"
#include "geometry/texture_select.h"
#include "src/flight.h"
#include "texturing/replacement.h"

namespace relievo {

struct FlightScene {
  PlanarDomain domain;
  const ReliefOracle* oracle = nullptr;
  std::vector<Plane> texture_planes;
  bool relief = true;
  int width_px = 1280, height_px = 720;
  double error_px = 1;
  double frames_per_s = 60;
};

// What the engine derives from a camera, for its own frame and for predicted ones alike. The texture is determined as if the
// artwork were flat: like the feedback pass it then names the levels that pixels want, not all that a slope might.
TextureView textureViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias = 0);
LodView lodViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias = 0);

// The pages that each frame wants, in the order of service, as if nothing were ever evicted.
PageTrace recordFlight(const FlightScene& scene, const Flight& flight);

}  // namespace relievo
