#include <cstdint>

#include "geometry/bake/area_sampler.h"
#include "src/base/latency.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

constexpr size_t kSamples = 1'000'000'000;

// The last of 10^9 samples that are spread over an area: each is found again by the area before it.
StabilityErrors lastOfTheSamples() {
  const AreaSamples samples(12345.678, kSamples);
  StabilityErrors out;
  for (size_t k = kSamples - 2000; k < kSamples; ++k) {
    const double area = samples.areaBefore(k);
    const auto naive_area = static_cast<float>(area);
    const float naive = naive_area / 12345.678f * static_cast<float>(kSamples) - 0.5f;
    out.add(static_cast<double>(samples.firstAt(area)) - static_cast<double>(k),
            double{naive} - static_cast<double>(k));
  }
  return out;
}

// Where in its triangle the k-th sample lies, beside the fraction of k / phi in 128-bit integers.
StabilityErrors placesOfTheSamples() {
  __extension__ using Wide = unsigned __int128;
  // 2^64 over the plastic number, rounded down.
  constexpr long double kPlastic = 1.324717957244746025960908854478097341L;
  const auto step = static_cast<uint64_t>(18446744073709551616.0L / kPlastic);
  StabilityErrors out;
  for (size_t k = kSamples - 2000; k < kSamples; ++k) {
    const auto turns = static_cast<uint64_t>(Wide{step} * k) + (uint64_t{1} << 63);
    const double truth = std::ldexp(static_cast<double>(turns), -64);
    double b1 = pointInTriangle(k).x;
    double naive = std::fmod(0.5f + static_cast<float>(k) / static_cast<float>(kPlastic), 1.0f);
    // The point may be folded into the other half of the unit square, 1 - b1; and 0 and 1 are the same.
    const auto apart = [&](double b) {
      const double folded = std::min(std::abs(b - truth), std::abs(1 - b - truth));
      return std::min(folded, 1 - folded);
    };
    out.add(apart(b1), apart(naive));
  }
  return out;
}

// Areas of 10^5 triangles added behind those of a far larger part of a mesh.
StabilityErrors smallAreasBehindALargeOne() {
  constexpr size_t kTriangles = 100'000;
  constexpr double kBefore = 1e7;  // mm^2, twice the area
  TriMesh mesh;
  mesh.positions_mm = {{0, 0, 0}, {0.5f, 0, 0}, {0, 0.25f, 0}};
  mesh.triangles.assign(kTriangles, {0, 1, 2});
  const double truth = kBefore + 0.125 * kTriangles;
  float sum = kBefore;
  for (size_t k = 0; k < kTriangles; ++k) sum += 0.125f;
  StabilityErrors out;
  out.add((cumulativeAreas(mesh, kBefore).back() - truth) / truth, (double{sum} - truth) / truth);
  return out;
}

// 10^8 latencies counted, as many of 3 as of 1,000.
StabilityErrors countedLatencies() {
  constexpr size_t kLatencies = 100'000'000;
  LatencyHistogram histogram;
  float counted = 0;
  for (size_t k = 0; k < kLatencies; ++k) {
    histogram.add(k % 2 ? 3 : 1000);
    counted += 1;
  }
  StabilityErrors out;
  const auto share = [](double count) { return count / static_cast<double>(kLatencies) - 1; };
  out.add(share(static_cast<double>(histogram.count())), share(counted));
  out.add((static_cast<double>(histogram.percentile(0.5)) - 3) / 3, 0);
  out.add((static_cast<double>(histogram.percentile(0.9)) - 1000) / 1000, 0);
  return out;
}

constexpr StabilityCase kSumCases[] = {
    {"the last of 10^9 samples of an area", "found again by the area before it", "areas and counts in floats",
     "samples", 0.5, lastOfTheSamples},
    {"where the last of 10^9 samples lie in their triangles", "the fraction of k / 1.3247...", "the same in floats",
     "of a side", 1e-6, placesOfTheSamples},
    {"10^5 small triangles behind a part 800 times as large", "the exact sum", "a sum in floats", "of it", 1e-9,
     smallAreasBehindALargeOne},
    {"percentiles of 10^8 latencies", "half are 3, half 1,000; buckets are a 16th wide", "a count in a float",
     "of them", 1.0 / 16, countedLatencies},
};

}  // namespace

std::span<const StabilityCase> sumStability() { return kSumCases; }

}  // namespace relievo
