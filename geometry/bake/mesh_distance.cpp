#include "geometry/bake/mesh_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/bake/baked_surface.h"
#include "geometry/bake/spread_places.h"
#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/ray_scene.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

Box boxOf(const TriMesh& mesh) {
  Box box;
  for (const glm::vec3& p : mesh.positions_mm) box.add(p);
  return box;
}

// mm[i] becomes the distance from place(i, triangle) to the scene, all of it within `box`, where that is smaller;
// places by jobs, each with a search of its own. Interrupted: of some.
template <class Place>
void lowerToDistance(std::span<float> mm, const RayScene& scene, const Box& box, const DistanceRun& run,
                     Place&& place) {
  constexpr size_t kAJob = 4096;
  const size_t jobs = (mm.size() + kAJob - 1) / kAJob;
  auto progress = [&](size_t taken) {
    if (run.progress) run.progress(static_cast<double>(taken) / static_cast<double>(jobs));
  };
  auto measure = [&](size_t job) {
    SurfacePoint last;  // where the sample before was closest: seldom far from where this one is
    size_t triangle = 0;
    for (size_t i = job * kAJob; i < std::min(mm.size(), (job + 1) * kAJob); ++i) {
      const glm::dvec3 p = place(i, triangle);
      // Most places are far from most parts.
      if (const double nearest = mm[i]; !std::isinf(nearest) && box.squaredDistance(p) > nearest * nearest * (1 + 1e-9))
        continue;
      // Looked for no further than what another part of the surface has. Rounding it to a float first changes nothing:
      // it is monotone, so that what lies between the two is rounded to the same.
      SurfacePoint found =
          std::isinf(mm[i]) ? scene.closestPoint(p, last) : scene.closestPoint(p, static_cast<double>(mm[i]));
      if (!found) continue;
      last = found;
      mm[i] = std::min(mm[i], static_cast<float>(found.along));
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
  auto from = mm.begin();  // what is below it was sorted away by the percentile before
  for (size_t i = 0; i < kShares.size(); ++i) {
    const double rank = std::ceil(kShares[i] * static_cast<double>(mm.size())) - 1;  // nearest rank
    const auto at = mm.begin() + static_cast<ptrdiff_t>(std::max(rank, 0.0));
    std::nth_element(from, at, mm.end());
    out.percentiles_mm[i] = *at;
    from = at;
  }
  return out;
}

// Runs of patches whose triangles, areas and hierarchy fit the memory, at least one patch each: where each ends.
std::vector<size_t> partEnds(const BakedSurface& surface, uint64_t memory_bytes) {
  constexpr uint64_t kBytesATriangle = 12 + 6 + 8 + 64;  // corners, half a vertex, area, hierarchy (ray_scene.cpp)
  std::vector<size_t> ends;
  uint64_t bytes = 0;
  for (size_t p = 0; p < surface.patches(); ++p) {
    const uint64_t more = surface.triangles(p) * kBytesATriangle;
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

TriMesh bakedTriangles(const MeshBake& baked, const DistanceRun& run) {
  const BakedSurface surface(baked, run.workers, run.interrupted);
  return surface.part(0, surface.patches());
}

Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle,
                                     const DistanceRun& run) {
  MeshDistance out;
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  auto stopped = [&] { return run.interrupted && run.interrupted->load(std::memory_order_relaxed); };
  // Of a part of all the time.
  auto within = [&](double from, double to) {
    DistanceRun p = run;
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
  const RaySceneOptions scene_options{.interrupted = run.interrupted,
                                      .budget_bytes = run.memory_bytes ? run.memory_bytes : ~uint64_t{0}};

  // From the scan to each part of the surface, the nearest of them all.
  size_t spread = scan.triangles.size() * static_cast<size_t>(std::max(samples_per_triangle, 0));
  const size_t vertices = scan.positions_mm.size();
  double surface_area = 0;
  {
    const std::vector<double> area_before = areasBefore(scan, 0);
    if (!(area_before.back() > 0)) spread = 0;
    const SpreadPlaces places(scan, area_before, area_before.back(), spread);
    const glm::dvec3 shift = scan.origin_mm - baked.base().origin_mm;
    std::vector<float> there(vertices + spread, std::numeric_limits<float>::infinity());
    for (size_t i = 0, first = 0; i < ends.size(); first = ends[i++]) {
      const TriMesh part = surface.part(first, ends[i]);
      if (stopped()) return interrupted;
      surface_area = areasBefore(part, surface_area).back();
      auto scene = RayScene::create(part, scene_options);
      if (!scene) return scene.error();
      const double from = 0.08 + 0.46 * static_cast<double>(i) / parts;
      lowerToDistance(there, **scene, boxOf(part), within(from, from + 0.46 / parts), [&](size_t k, size_t& triangle) {
        return shift + (k < vertices ? glm::dvec3(scan.positions_mm[k]) : places.place(k - vertices, triangle));
      });
      if (stopped()) return interrupted;
      if (auto sound = (*scene)->status(); !sound) return sound.error();
    }
    out.scan_vertex_mm.assign(there.begin(), there.begin() + static_cast<ptrdiff_t>(vertices));
    out.to_baked = stats(there);
  }

  // From the places that lie on each part to the scan.
  auto scan_scene = RayScene::create(scan, scene_options);
  if (!scan_scene) return scan_scene.error();
  spread = surface_area > 0 ? out.to_baked.samples : 0;
  std::vector<float> back(spread, std::numeric_limits<float>::infinity());
  const glm::dvec3 shift = baked.base().origin_mm - scan.origin_mm;
  double area = 0;
  for (size_t i = 0, first = 0, from_k = 0; i < ends.size(); first = ends[i++]) {
    const TriMesh part = surface.part(first, ends[i]);
    if (stopped()) return interrupted;
    const std::vector<double> area_before = areasBefore(part, area);
    area = area_before.back();
    const SpreadPlaces places(part, area_before, surface_area, spread);
    const size_t end_k = i + 1 < ends.size() ? places.firstAt(area) : spread;
    const double from = 0.58 + 0.42 * static_cast<double>(i) / parts;
    lowerToDistance(std::span(back).subspan(from_k, end_k - from_k), **scan_scene, boxOf(scan),
                    within(from, from + 0.42 / parts),
                    [&](size_t k, size_t& triangle) { return shift + places.place(from_k + k, triangle); });
    if (stopped()) return interrupted;
    from_k = end_k;
  }
  if (auto sound = (*scan_scene)->status(); !sound) return sound.error();
  out.to_scan = stats(back);
  // No more than 240 dB: a number even where both are the same.
  const double rms = std::max({out.to_baked.rms_mm, out.to_scan.rms_mm, 1e-12 * out.diagonal_mm});
  out.psnr_db = out.diagonal_mm > 0 ? 20 * std::log10(out.diagonal_mm / rms) : 0;
  return out;
}

}  // namespace relievo
