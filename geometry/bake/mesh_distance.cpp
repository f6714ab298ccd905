#include "geometry/bake/mesh_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/bake/area_sampler.h"
#include "geometry/bake/baked_surface.h"
#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/closest_search.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

Box boxOf(const TriMesh& mesh) {
  Box box;
  for (const glm::vec3& p : mesh.positions_mm) box.add(p);
  return box;
}

// Lowers mm[i] to the distance of position(i, triangle) from a mesh, which lies within `box`. Samples are processed
// in jobs, each with a search state of its own. If interrupted, some are not updated.
template <class Position>
void updateDistances(std::span<float> mm, const ClosestSearch& search, const Box& box, const DistanceOptions& run,
                     Position&& position) {
  constexpr size_t kSamplesPerJob = 4096;
  const size_t jobs = (mm.size() + kSamplesPerJob - 1) / kSamplesPerJob;
  auto progress = [&](size_t taken) {
    if (run.progress) run.progress(static_cast<double>(taken) / static_cast<double>(jobs));
  };
  auto measure = [&](size_t job) {
    size_t last = kNoPart;  // the next sample is seldom far from this one's closest point
    size_t triangle = 0;
    for (size_t i = job * kSamplesPerJob; i < std::min(mm.size(), (job + 1) * kSamplesPerJob); ++i) {
      const glm::dvec3 p = position(i, triangle);
      // Most samples are far from most parts.
      if (const double nearest = mm[i]; !std::isinf(nearest) && box.squaredDistance(p) > nearest * nearest * (1 + 1e-9))
        continue;
      // The search stops at the distance found in another part. That distance was rounded to a float, which changes
      // nothing: rounding is monotone, so that anything between the two values is rounded to the same float.
      mm[i] = std::min(mm[i], static_cast<float>(search.distance(p, mm[i], last)));
    }
  };
  parallelFor(jobs, run.workers, run.interrupted, measure, progress);
}

DistanceStats stats(std::span<float> mm) {
  DistanceStats out;
  out.samples = mm.size();
  if (mm.empty()) return out;
  double sum = 0;
  for (float d : mm) sum += static_cast<double>(d) * d;
  out.rms_mm = std::sqrt(sum / static_cast<double>(mm.size()));
  out.max_mm = *std::max_element(mm.begin(), mm.end());
  constexpr std::array<double, 5> kShares{0.5, 0.9, 0.95, 0.99, 0.999};
  auto from = mm.begin();  // the previous percentile has moved smaller values before it
  for (size_t i = 0; i < kShares.size(); ++i) {
    const double rank = std::ceil(kShares[i] * static_cast<double>(mm.size())) - 1;  // nearest rank
    const auto at = mm.begin() + static_cast<ptrdiff_t>(std::max(rank, 0.0));
    std::nth_element(from, at, mm.end());
    out.percentiles_mm[i] = *at;
    from = at;
  }
  return out;
}

// Splits the patches into runs whose triangles, areas and boxes fit the memory, at least one patch each. Returns the
// end of each run.
std::vector<size_t> partEnds(const BakedSurface& surface, uint64_t memory_bytes) {
  constexpr uint64_t kBytesPerTriangle = 12 + 6 + 8 + 2;  // corners, half a vertex, area, boxes (closest_search.h)
  std::vector<size_t> ends;
  uint64_t bytes = 0;
  for (size_t p = 0; p < surface.patches(); ++p) {
    const uint64_t more = surface.triangles(p) * kBytesPerTriangle;
    if (memory_bytes > 0 && bytes > 0 && bytes + more > memory_bytes) {
      ends.push_back(p);
      bytes = 0;
    }
    bytes += more;
  }
  ends.push_back(surface.patches());
  return ends;
}

}  // namespace

TriMesh bakedTriangles(const MeshBake& baked, const DistanceOptions& run) {
  const BakedSurface surface(baked, run.workers, run.interrupted);
  return surface.part(0, surface.patches());
}

Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle,
                                     const DistanceOptions& run) {
  MeshDistance out;
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  auto stopped = [&] { return run.interrupted && run.interrupted->load(std::memory_order_relaxed); };
  // Maps the progress of one step to its part of the whole.
  auto within = [&](double from, double to) {
    DistanceOptions p = run;
    if (run.progress) p.progress = [&run, from, to](double done) { run.progress(from + done * (to - from)); };
    return p;
  };
  if (scan.triangles.empty()) return Error{ErrorKind::kInvalidData, "", "the mesh has no triangle", ""};
  glm::vec3 low = scan.positions_mm[0], high = low;
  for (const glm::vec3& p : scan.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  out.diagonal_mm = glm::length(glm::dvec3(high) - glm::dvec3(low));
  if (run.progress) run.progress(0);
  const BakedSurface surface(baked, run.workers, run.interrupted);
  if (stopped()) return interrupted;
  const std::vector<size_t> ends = partEnds(surface, run.memory_bytes);
  const double parts = static_cast<double>(ends.size());

  // From the scan to the nearest part of the surface.
  size_t sample_count = scan.triangles.size() * static_cast<size_t>(std::max(samples_per_triangle, 0));
  const size_t vertices = scan.positions_mm.size();
  double surface_area = 0;
  {
    const std::vector<double> cumulative_area = cumulativeAreas(scan, 0);
    if (!(cumulative_area.back() > 0)) sample_count = 0;
    const AreaSampler sampler(scan, cumulative_area, cumulative_area.back(), sample_count);
    const glm::dvec3 shift = scan.origin_mm - baked.base().origin_mm;
    std::vector<float> from_scan(vertices + sample_count, std::numeric_limits<float>::infinity());
    for (size_t i = 0, first = 0; i < ends.size(); first = ends[i++]) {
      const TriMesh part = surface.part(first, ends[i]);
      if (stopped()) return interrupted;
      surface_area = cumulativeAreas(part, surface_area).back();
      const ClosestSearch search(part, run.workers);
      const double from = 0.08 + 0.46 * static_cast<double>(i) / parts;
      updateDistances(
          from_scan, search, boxOf(part), within(from, from + 0.46 / parts), [&](size_t k, size_t& triangle) {
            return shift + (k < vertices ? glm::dvec3(scan.positions_mm[k]) : sampler.position(k - vertices, triangle));
          });
      if (stopped()) return interrupted;
    }
    out.scan_vertex_mm.assign(from_scan.begin(), from_scan.begin() + static_cast<ptrdiff_t>(vertices));
    out.to_baked = stats(from_scan);
  }

  // From the samples on each part to the scan.
  const ClosestSearch scan_search(scan, run.workers);
  sample_count = surface_area > 0 ? out.to_baked.samples : 0;
  std::vector<float> from_baked(sample_count, std::numeric_limits<float>::infinity());
  const glm::dvec3 shift = baked.base().origin_mm - scan.origin_mm;
  double area = 0;
  for (size_t i = 0, first = 0, from_k = 0; i < ends.size(); first = ends[i++]) {
    const TriMesh part = surface.part(first, ends[i]);
    if (stopped()) return interrupted;
    const std::vector<double> cumulative_area = cumulativeAreas(part, area);
    area = cumulative_area.back();
    const AreaSampler sampler(part, cumulative_area, surface_area, sample_count);
    const size_t end_k = i + 1 < ends.size() ? sampler.firstSampleAt(area) : sample_count;
    const double from = 0.58 + 0.42 * static_cast<double>(i) / parts;
    updateDistances(std::span(from_baked).subspan(from_k, end_k - from_k), scan_search, boxOf(scan),
                    within(from, from + 0.42 / parts),
                    [&](size_t k, size_t& triangle) { return shift + sampler.position(from_k + k, triangle); });
    if (stopped()) return interrupted;
    from_k = end_k;
  }
  out.to_scan = stats(from_baked);
  // At most 240 dB, so that two identical surfaces give a number.
  const double rms = std::max({out.to_baked.rms_mm, out.to_scan.rms_mm, 1e-12 * out.diagonal_mm});
  out.psnr_db = out.diagonal_mm > 0 ? 20 * std::log10(out.diagonal_mm / rms) : 0;
  return out;
}

}  // namespace relievo
