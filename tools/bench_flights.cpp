// bench_flights.cpp - three recorded flights: how often the page cache has what a frame wants, and what prefetching spares.
#include <algorithm>
#include <cstdio>

#include "src/engine.h"
#include "src/flight_simulation.h"
#include "tools/bench_groups.h"

namespace relievo {
namespace {

FlightScene sceneOf(const BenchContext& context, const Artwork& artwork) {
  FlightScene scene;
  scene.domain = artwork.manifest.domain;
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
  constexpr double kShare = 0.5;  // of the flight's distinct pages: with less, single frames want more than the cache holds
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
      std::snprintf(note, sizeof note, "%.2f %% of it; %llu misses, x%.2f of Belady's %llu (first uses: %llu); %zu frames, %u pages, %u slots",
                    100 * r.hitRate() / best.hitRate(), static_cast<unsigned long long>(r.misses),
                    static_cast<double>(r.misses) / static_cast<double>(std::max<uint64_t>(1, best.misses)),
                    static_cast<unsigned long long>(best.misses), static_cast<unsigned long long>(r.first_uses), trace.size(), distinct, slots);
      BenchRow row;
      row.what = flight.name + ": hit rate, " + replacementName(policy);
      if (policy == StreamerOptions{}.replacement) row.what += " (default)";
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
  auto flights = flightsOver(scene);
  flights.push_back(wanderFlight(scene.domain, scene.width_px, scene.height_px));
  FlightStreaming how;
  how.format = artwork.manifest.texture;
  how.page_bytes = [&](PageId id) {
    auto record = context.package->record(id);
    return record ? record->size : 0u;
  };
  std::vector<std::optional<PredictorOptions>> predictors = {std::nullopt};
  for (double h : {0.2, 0.35, 0.5, 0.7, 1.0}) for (int steps : {1, 2}) predictors.push_back(PredictorOptions{.horizon_s = h, .steps = steps});
  for (const Flight& flight : flights) {
    if (context.stopped()) return {};
    double start = benchSeconds();
    auto results = streamFlight(scene, flight, how, predictors);
    printf("%s %.2f s, %.1f s flight\n", flight.name.c_str(), benchSeconds() - start, flight.duration_s());
    for (size_t i = 0; i < results.size(); ++i) {
      const auto& r = results[i];
      printf("  %-9s %.4f %% coarse, levels %.3f, down %.1f %%, bytes %.2f MB (%+.1f %%), prefetched %lu used %lu wasted %lu p50 %.0f p90 %.0f\n",
             predictors[i] ? (std::to_string(predictors[i]->horizon_s).substr(0, 4) + " x" + std::to_string(predictors[i]->steps)).c_str() : "none", 100 * r.coarseShare(),
             double(r.levels_missing) / r.points * 100, 100 * (1 - double(r.coarse) / results[0].coarse), r.bytes / 1e6, 100.0 * r.bytes / results[0].bytes - 100,
             r.stats.prefetched, r.stats.prefetch_used, r.stats.prefetch_wasted, double(r.stats.latency_ms.p50), double(r.stats.latency_ms.p90));
    }
  }
  return {};
}

}  // namespace relievo
