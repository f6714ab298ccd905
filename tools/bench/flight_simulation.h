// flight_simulation.h - simulates, without GL and without real time, which pages a flight requests and when they arrive
// over a link of limited bandwidth and latency.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "geometry/lod/planar_lod.h"
#include "geometry/lod/texture_select.h"
#include "src/engine/prefetch.h"
#include "texturing/stream/page_streamer.h"
#include "tools/bench/flight.h"
#include "tools/bench/replacement.h"

namespace relievo {

struct FlightScene {
  FlatDomain domain;
  const ReliefOracle* oracle = nullptr;
  std::vector<Plane> texture_planes;
  bool relief = true;
  int width_px = 1280, height_px = 720;
  double error_px = 1;
  double frames_per_s = 60;
};

// What the engine derives from a camera, for its own frame and for predicted ones alike. The texture is determined as
// if the artwork were flat: like the feedback pass it then names the levels that pixels want, not all that a slope
// might.
TextureView textureViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias = 0);
LodView lodViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias = 0);

// The pages that each frame wants, in the order of service, as if nothing were ever evicted.
PageTrace recordFlight(const FlightScene& scene, const Flight& flight);

// A link to the pages on a virtual clock: what is asked for arrives latency_s later at the earliest, one page after the
// other.
struct LinkOptions {
  double bytes_per_s = 20e6;
  double latency_s = 0.05;
  size_t in_flight = 64;  // reads; 20 MB/s x 50 ms are 40 pages of 25 kB
};

struct StreamedFlight {
  uint64_t points = 0;            // of the artwork, over all frames
  uint64_t coarse = 0;            // of these, shown from a coarser level than wanted
  uint64_t levels_missing = 0;    // sum over these of how many levels coarser
  uint64_t bytes = 0, pages = 0;  // over the link while flying
  StreamerStats stats;
  double coarseShare() const { return points == 0 ? 0 : static_cast<double>(coarse) / static_cast<double>(points); }
};

struct FlightStreaming {
  LinkOptions link;
  uint32_t slot_count = 3628;  // 256 MiB
  TextureFormat format;
  std::function<uint32_t(PageId)> page_bytes;  // encoded
  int grid_columns = 160, grid_rows = 90;      // points looked at in each frame
  int relief_every = 4;                        // frames: how often relief pages are determined
};

// Flies once, with the real PageStreamer, and for each of `predictors` with a streamer, link and cache of its own; the
// first is nothing for no prefetching. Requests are a frame late, as the feedback's are. The flight starts settled. A
// point's wanted level follows from the ray through it (flat artwork); what shows is its finest resident ancestor.
// Deterministic.
std::vector<StreamedFlight> streamFlight(const FlightScene& scene, const Flight& flight, const FlightStreaming& how,
                                         const std::vector<std::optional<PredictorOptions>>& predictors);

}  // namespace relievo
