// bench_frame_time.cpp - how long a moving frame takes along a flight, and what of it the viewer's control of frame
// time (frame_time_control.h) gives up to hold 33 ms; how far its pictures are then from settled ones; and what a
// frame's parts take. Wall clock: nothing else should run.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>

#include "src/engine/engine.h"
#include "src/viewer/frame_time_control.h"
#include "tools/bench/bench_groups.h"
#include "tools/bench/flight.h"
#include "tools/bench/frame_timing.h"

namespace relievo {
namespace {

constexpr double kTargetMs = 33;
constexpr double kStep_s = 1.0 / 30;  // of the flight's time, from frame to frame
constexpr double kSettleTimeout_s = 60;

// Of a body: around it and nearer, with moments of rest at the ends.
Flight aroundFlight(const Extent& extent, int width_px, int height_px) {
  OrbitCamera camera = fitCamera(extent, width_px, height_px);
  const double far_mm = camera.distance_mm;
  Flight flight{.name = "around", .keys = {}};
  const double times[] = {0, 0.3, 3, 6, 8, 8.3};
  const double azimuths[] = {0, 0, 90, 200, 330, 330}, distances[] = {1, 1, 0.5, 0.35, 1, 1};
  for (size_t k = 0; k < std::size(times); ++k) {
    camera.azimuth_deg = azimuths[k];
    camera.distance_mm = distances[k] * far_mm;
    flight.keys.push_back({times[k], camera});
  }
  return flight;
}

// How far a picture, shown as large as a settled one, is from it, dB of 255.
double psnr(const std::vector<uint8_t>& shown, int width, int height, const std::vector<uint8_t>& settled,
            int settled_width, int settled_height) {
  double squares = 0, count = 0;
  for (int y = 0; y < settled_height; ++y)
    for (int x = 0; x < settled_width; ++x) {
      // Bilinear, as a window shows it.
      const double u = std::clamp((x + 0.5) * width / settled_width - 0.5, 0.0, width - 1.0),
                   v = std::clamp((y + 0.5) * height / settled_height - 0.5, 0.0, height - 1.0);
      const int x0 = static_cast<int>(u), y0 = static_cast<int>(v), x1 = std::min(x0 + 1, width - 1),
                y1 = std::min(y0 + 1, height - 1);
      auto at = [&](int i, int j, int c) {
        return static_cast<double>(
            shown[4 * (static_cast<size_t>(j) * static_cast<size_t>(width) + static_cast<size_t>(i)) +
                  static_cast<size_t>(c)]);
      };
      for (int c = 0; c < 3; ++c) {
        const double value = (at(x0, y0, c) * (x0 + 1 - u) + at(x1, y0, c) * (u - x0)) * (y0 + 1 - v) +
                             (at(x0, y1, c) * (x0 + 1 - u) + at(x1, y1, c) * (u - x0)) * (v - y0);
        const double off =
            value - settled[4 * (static_cast<size_t>(y) * static_cast<size_t>(settled_width) + static_cast<size_t>(x)) +
                            static_cast<size_t>(c)];
        squares += off * off;
        ++count;
      }
    }
  return 10 * std::log10(255.0 * 255.0 * count / std::max(squares, 1.0));
}

struct Flown {
  std::vector<double> ms, psnr_db, error_px;
  int given_up = 0;  // frames
  int least_width_px = kBenchWidth;
};

// A frame shows the view that its patch list was made for, which is an earlier one: the same frame again until it is
// this camera's.
Result<void> showSameView(Engine& engine, const OrbitCamera& camera) {
  const glm::dmat4 wanted = viewTransform(camera, artworkExtent(engine.manifest(), engine.scene().exaggerate),
                                          engine.width(), engine.height())
                                .clip_from_world;
  for (int tries = 0; tries < 100; ++tries) {
    engine.frame(benchSeconds());
    if (engine.view().clip_from_world == wanted) return {};
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return Error{ErrorKind::kRuntime, "", "the patch list of a view did not come", "run it again on an idle machine", {}};
}

// control: null, nothing is given up. settled: draws the same views settled; null: nothing is compared.
Result<Flown> fly(Engine& engine, const Flight& flight, const Scene& exact, FrameTimeControl* control, Engine* settled,
                  BenchContext& context) {
  Flown out;
  engine.resize(kBenchWidth, kBenchHeight);
  engine.setCamera(cameraAt(flight, 0));
  if (auto done = engine.settle(kSettleTimeout_s); !done) return done.error();
  const int frames = static_cast<int>(flight.duration_s() / kStep_s);
  const int compared_every = std::max(1, frames / (context.quick ? 6 : 16));
  for (int k = 1; k <= frames && !context.stopped(); ++k) {
    const OrbitCamera camera = cameraAt(flight, k * kStep_s);
    if (auto set = engine.setScene(control ? control->spend(exact) : exact); !set) return set.error();
    const auto [width, height] =
        control ? control->size(kBenchWidth, kBenchHeight) : std::array{kBenchWidth, kBenchHeight};
    engine.resize(width, height);
    engine.setCamera(camera);
    const double ms = timedFrameMs(engine);
    out.ms.push_back(ms);
    if (control) {
      out.given_up += control->pressure() > 0;
      out.least_width_px = std::min(out.least_width_px, width);
      control->observe(ms, true);
    }
    if (settled && k % compared_every == 0) {
      if (auto shown = showSameView(engine, camera); !shown) return shown.error();
      settled->resize(kBenchWidth, kBenchHeight);
      settled->setCamera(camera);
      if (auto done = settled->settle(kSettleTimeout_s); !done) return done.error();
      out.psnr_db.push_back(psnr(engine.readPixels(), width, height, settled->readPixels(), kBenchWidth, kBenchHeight));
      out.error_px.push_back(engine.stats().predicted_error_px * kBenchWidth / width);
    }
  }
  return out;
}

void frameRow(BenchContext& context, const std::string& what, const Flown& flown, std::optional<double> goal,
              const Flown* baseline) {
  BenchRow row;
  row.what = what;
  row.measured = quantile(flown.ms, 0.95);
  row.unit = "ms";
  row.goal = goal;
  if (baseline) {
    row.baseline = quantile(baseline->ms, 0.95);
    row.baseline_name = "nothing given up";
  }
  char note[300];
  int size = std::snprintf(note, sizeof note, "median %.1f, p99 %.1f; %zu frames of the flight", median(flown.ms),
                           quantile(flown.ms, 0.99), flown.ms.size());
  if (baseline && !flown.psnr_db.empty())
    std::snprintf(
        note + size, sizeof note - static_cast<size_t>(size),
        "; in %d of them something given up, down to %d px of width; %.1f dB (worst %.1f) from the settled "
        "pictures, without %.1f (%.1f); geometry off by at most %.2f px (median), %.2f (worst), without %.2f, %.2f",
        flown.given_up, flown.least_width_px, median(flown.psnr_db), quantile(flown.psnr_db, 0),
        median(baseline->psnr_db), quantile(baseline->psnr_db, 0), median(flown.error_px), quantile(flown.error_px, 1),
        median(baseline->error_px), quantile(baseline->error_px, 1));
  row.note = note;
  context.row(row);
}

// The parts of a frame at one view, each by what leaving it out spares.
Result<void> partRows(BenchContext& context, Engine& engine, const Scene& exact, const OrbitCamera& camera) {
  const int frames = context.quick ? 9 : 25;
  engine.resize(kBenchWidth, kBenchHeight);
  engine.setCamera(camera);
  if (auto set = engine.setScene(exact); !set) return set;
  if (auto done = engine.settle(kSettleTimeout_s); !done) return done;
  const EngineStats stats = engine.stats();
  auto still = [&] {
    std::vector<double> ms;
    for (int k = 0; k < frames && !context.stopped(); ++k) ms.push_back(timedFrameMs(engine));
    return median(std::move(ms));
  };
  // Each draws its geometry anew: its list is waited for outside of the time.
  auto moving = [&] {
    std::vector<double> ms;
    OrbitCamera trembling = camera;
    for (int k = 0; k < frames && !context.stopped(); ++k) {
      trembling.azimuth_deg += k % 2 == 0 ? 1e-6 : -1e-6;
      engine.setCamera(trembling);
      engine.frame(benchSeconds());
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      ms.push_back(timedFrameMs(engine));
    }
    return median(std::move(ms));
  };
  const double moving_ms = moving(), shade_ms = still();
  std::vector<double> read_ms;
  for (int k = 0; k < frames; ++k) {
    const double start = benchSeconds();
    engine.readPixels();
    read_ms.push_back(1000 * (benchSeconds() - start));
  }
  // As many triangles over a sixty-fourth of the pixels: what is left is vertices and the list.
  Scene small = exact;
  small.error_px = exact.error_px / 8;
  small.least_cell = exact.least_cell;
  if (auto set = engine.setScene(small); !set) return set;
  engine.resize(kBenchWidth / 8, kBenchHeight / 8);
  if (auto done = engine.settle(kSettleTimeout_s); !done) return done;
  const double vertices_ms = moving();
  const EngineStats small_stats = engine.stats();
  auto add = [&](const char* what, double ms, std::string note) {
    BenchRow row;
    row.what = what;
    row.measured = ms;
    row.unit = "ms";
    row.note = std::move(note);
    context.row(row);
  };
  char note[200];
  std::snprintf(note, sizeof note, "%llu triangles; one view, all pages there",
                static_cast<unsigned long long>(stats.triangles));
  add("a moving frame, exact", moving_ms, note);
  add("of it: shading, and reading the picture back", shade_ms, "a frame of a camera that stands still");
  std::snprintf(note, sizeof note, "no window does it; the floor of what is read: %.1f MiB",
                4.0 * kBenchWidth * kBenchHeight / (1 << 20));
  add("of it: reading the picture back", median(read_ms), note);
  std::snprintf(note, sizeof note, "the same error in mm over 160x90 px, %llu triangles",
                static_cast<unsigned long long>(small_stats.triangles));
  add("of it: vertices and the patch list", vertices_ms, note);
  add("of it: covering pixels with triangles", std::max(0.0, moving_ms - shade_ms - vertices_ms),
      "what the others leave");
  std::snprintf(note, sizeof note, "on the LOD worker's thread, beside the frame");
  add("beside it: choosing the patch list", stats.lod_ms, note);
  return {};
}

}  // namespace

Result<void> frameTimeBench(BenchContext& context) {
  const Artwork artwork = artworkFromPackage(context.package);
  Scene exact;
  exact.light = {-0.6, 0.5, 0.6};
  EngineOptions options;
  options.most_cache_mib = kMostCacheMib;
  options.interrupted = context.interrupted;
  auto engine = Engine::create(artwork, exact, options);
  if (!engine) return engine.error();
  auto settled = Engine::create(artwork, exact, options);
  if (!settled) return settled.error();
  const PatchDomain& domain = artwork.manifest.domain;
  std::vector<Flight> flights;
  if (domain.isFlat()) {
    flights.push_back(orbitFlight(domain.flat(), kBenchWidth, kBenchHeight));
    if (!context.quick) flights.push_back(readingFlight(domain.flat(), kBenchWidth, kBenchHeight));
  } else {
    flights.push_back(aroundFlight(artworkExtent(artwork.manifest), kBenchWidth, kBenchHeight));
  }
  for (const Flight& flight : flights) {
    auto exactly = fly(**engine, flight, exact, nullptr, settled->get(), context);
    if (!exactly) return exactly.error();
    frameRow(context, flight.name + ": p95 of a moving frame, nothing given up", *exactly, std::nullopt, nullptr);
    FrameTimeControl control(kTargetMs);
    auto held = fly(**engine, flight, exact, &control, settled->get(), context);
    if (!held) return held.error();
    frameRow(context, flight.name + ": p95 of a moving frame, held at 33 ms", *held, kTargetMs, &*exactly);
    if (context.stopped()) return {};
  }
  return partRows(context, **engine, exact, cameraAt(flights[0], flights[0].duration_s() / 3));
}

}  // namespace relievo
