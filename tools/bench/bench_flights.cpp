// bench_flights.cpp - three recorded flights: how often the page cache has what a frame wants, and what prefetching
// spares.
#include <algorithm>
#include <cstdio>

#include "src/engine/engine.h"
#include "tools/bench/bench_groups.h"
#include "tools/bench/flight_simulation.h"

namespace relievo {
namespace {

FlightScene sceneOf(const BenchContext& context, const Artwork& artwork) {
  FlightScene scene;
  scene.domain = artwork.manifest.domain.flat();
  scene.oracle = artwork.oracle.get();
  for (int k = 0; k < artwork.manifest.texture.planes(); ++k) scene.texture_planes.push_back(texturePlane(k));
  scene.relief = scene.domain.relief_depth >= 0;
  if (context.quick) {
    scene.width_px = 640;
    scene.height_px = 360;
  }
  return scene;
}

std::vector<Flight> flightsOver(const FlightScene& s) {
  return {orbitFlight(s.domain, s.width_px, s.height_px), readingFlight(s.domain, s.width_px, s.height_px),
          zoomFlight(s.domain, s.width_px, s.height_px)};
}

}  // namespace

Result<void> replacementBench(BenchContext& context) {
  constexpr double kShare =
      0.5;  // of the flight's distinct pages: with less, single frames want more than the cache holds
  Artwork artwork = artworkFromPackage(context.package);
  FlightScene scene = sceneOf(context, artwork);
  if (context.quick) scene.frames_per_s = 20;
  for (const Flight& flight : flightsOver(scene)) {
    if (context.stopped()) return {};
    PageTrace trace = recordFlight(scene, flight);
    uint32_t distinct = distinctPages(trace);
    auto slots = static_cast<uint32_t>(kShare * distinct);
    ReplayResult best = replayOptimum(trace, slots);
    for (Replacement policy : {Replacement::kLru, Replacement::kClock, Replacement::kHalving}) {
      ReplayResult r = replay(trace, slots, policy);
      char note[200];
      std::snprintf(
          note, sizeof note,
          "%.2f %% of it; %llu misses, x%.2f of Belady's %llu (first uses: %llu); %zu frames, %u pages, %u slots",
          100 * r.hitRate() / best.hitRate(), static_cast<unsigned long long>(r.misses),
          static_cast<double>(r.misses) / static_cast<double>(std::max<uint64_t>(1, best.misses)),
          static_cast<unsigned long long>(best.misses), static_cast<unsigned long long>(r.first_uses), trace.size(),
          distinct, slots);
      BenchRow row;
      row.what = flight.name + ": hit rate, " + replacementName(policy);
      if (policy == Replacement::kLru) row.what += " (default)";
      row.measured = 100 * r.hitRate();
      row.unit = "%";
      row.goal = 98 * best.hitRate();
      row.at_most = false;
      row.baseline_name = "Belady's optimum";
      row.baseline = 100 * best.hitRate();
      row.note = note;
      context.row(row);
    }
  }
  return {};
}

Result<void> prefetchBench(BenchContext& context) {
  Artwork artwork = artworkFromPackage(context.package);
  FlightScene scene = sceneOf(context, artwork);
  FlightStreaming how;
  how.format = artwork.manifest.texture;
  how.page_bytes = [&](PageId id) {
    auto record = context.package->record(id);
    return record ? record->size : 0u;
  };
  auto flights = flightsOver(scene);
  flights.push_back(wanderFlight(scene.domain, scene.width_px, scene.height_px, {.speed = 1.25}));
  if (context.quick) {
    how.grid_columns = 80;
    how.grid_rows = 45;
    how.relief_every = 12;
  }
  for (const Flight& flight : flights) {
    if (context.stopped()) return {};
    auto results = streamFlight(scene, flight, how, {std::nullopt, PredictorOptions{}});
    const StreamedFlight &without = results[0], &with = results[1];
    std::string name = flight.name + (flight.name == "wander" ? " (held out)" : "");
    auto percent = [](uint64_t part, uint64_t whole) {
      return whole == 0 ? 0 : 100.0 * static_cast<double>(part) / static_cast<double>(whole);
    };
    char note[200];
    BenchRow row;
    row.what = name + ": pixel-frames coarser than wanted";
    row.measured = 100 * with.coarseShare();
    row.unit = "%";
    row.goal = 0.2 * 100 * without.coarseShare();
    row.baseline_name = "without prefetch";
    row.baseline = 100 * without.coarseShare();
    std::snprintf(note, sizeof note, "down %.1f %%; %.1f s at 60 Hz, %dx%d points a frame",
                  100 - percent(with.coarse, without.coarse), flight.duration_s(), how.grid_columns, how.grid_rows);
    row.note = note;
    context.row(row);
    row.what = name + ": read while flying";
    row.measured = static_cast<double>(with.bytes) / 1e6;
    row.unit = "MB";
    row.goal = 1.25 * static_cast<double>(without.bytes) / 1e6;
    row.baseline = static_cast<double>(without.bytes) / 1e6;
    std::snprintf(note, sizeof note, "%+.1f %%; %llu pages prefetched, %llu of them used, %llu gone unused",
                  percent(with.bytes, without.bytes) - 100, static_cast<unsigned long long>(with.stats.prefetched),
                  static_cast<unsigned long long>(with.stats.prefetch_used),
                  static_cast<unsigned long long>(with.stats.prefetch_wasted));
    row.note = note;
    context.row(row);
  }
  return {};
}

}  // namespace relievo
