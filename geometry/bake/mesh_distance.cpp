#include "geometry/bake/mesh_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/ray_scene.h"
#include "src/artwork/patch_domain.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// The k-th place in a triangle: the plastic number's sequence, folded into it (Roberts 2018): any run of them is spread
// evenly.
glm::dvec2 placeInTriangle(size_t k) {
  constexpr double kPlastic = 1.32471795724474602596;
  double b1 = std::fmod(0.5 + static_cast<double>(k) / kPlastic, 1.0),
         b2 = std::fmod(0.5 + static_cast<double>(k) / (kPlastic * kPlastic), 1.0);
  if (b1 + b2 > 1) {
    b1 = 1 - b1;
    b2 = 1 - b2;
  }
  return {b1, b2};
}

// The sum of the areas (twice) of the triangles before each one, from `before` on.
std::vector<double> areasBefore(const TriMesh& mesh, double before) {
  std::vector<double> out{before};
  out.reserve(mesh.triangles.size() + 1);
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    out.push_back(out.back() + glm::length(glm::cross(b - a, c - a)));
  }
  return out;
}

Box boxOf(const TriMesh& mesh) {
  Box box;
  for (const glm::vec3& p : mesh.positions_mm) box.add(p);
  return box;
}

// The k-th of `spread` places, evenly over a mesh's area, that lies on a part of it: the part's areas, and the whole
// mesh's.
class SpreadPlaces {
 public:
  SpreadPlaces(const TriMesh& part, const std::vector<double>& area_before, double whole_area, size_t spread)
      : part_(part), area_before_(area_before), whole_area_(whole_area), spread_(spread) {}
  double areaOf(size_t k) const { return (static_cast<double>(k) + 0.5) / static_cast<double>(spread_) * whole_area_; }
  // The first place at or behind an area.
  size_t firstAt(double area) const {
    size_t low = 0, high = spread_;
    while (low < high) {
      const size_t k = (low + high) / 2;
      if (areaOf(k) < area) low = k + 1;
      else high = k;
    }
    return low;
  }
  // `triangle` is where the search begins, and then the place's.
  glm::dvec3 place(size_t k, size_t& triangle) const {
    const double area = areaOf(k);
    if (area >= area_before_[triangle + 1])
      triangle =
          static_cast<size_t>(std::upper_bound(area_before_.begin(), area_before_.end(), area) - area_before_.begin()) -
          1;
    triangle = std::min(triangle, part_.triangles.size() - 1);
    const auto& t = part_.triangles[triangle];
    const glm::dvec2 w = placeInTriangle(k);
    const glm::dvec3 a(part_.positions_mm[t[0]]), b(part_.positions_mm[t[1]]), c(part_.positions_mm[t[2]]);
    return a + w.x * (b - a) + w.y * (c - a);
  }

 private:
  const TriMesh& part_;
  const std::vector<double>& area_before_;
  double whole_area_;
  size_t spread_;
};

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

// The surface that a bake is measured by, patch by patch (bakedTriangles()).
class BakedSurface {
 public:
  BakedSurface(const MeshBake& baked, const DistanceRun& run)
      : baked_(baked), run_(run), finest_log2_(7 + baked.reliefDepth()) {
    const BaseMesh& base = baked.base();
    glm::dvec3 low(base.corners[0].position_mm), high = low;
    for (const BaseCorner& c : base.corners) {
      low = glm::min(low, glm::dvec3(c.position_mm));
      high = glm::max(high, glm::dvec3(c.position_mm));
    }
    const double close_mm = std::max(5e-6 * glm::length(high - low), baked.reliefScaleMm());
    cells_log2_.resize(base.patches.size());
    parallelFor(cells_log2_.size(), run.workers, run.interrupted, [&](size_t p) {
      int& log2 = cells_log2_[p] = std::min(baked.report().cells_log2, finest_log2_);
      while (log2 < finest_log2_ && baked.errorOfCells(static_cast<uint32_t>(p), log2) > close_mm) ++log2;
    });
  }
  size_t patches() const { return cells_log2_.size(); }
  size_t triangles(size_t patch) const { return size_t{2} << 2 * cells_log2_[patch]; }
  // Of the patches [first, end).
  TriMesh part(size_t first, size_t end) const {
    struct Place {
      size_t vertex = 0, triangle = 0;
    };
    std::vector<Place> places(end - first);
    Place all;
    for (size_t p = first; p < end; ++p) {
      const size_t row = (size_t{1} << cells_log2_[p]) + 1;
      places[p - first] = all;
      all.vertex += row * row;
      all.triangle += triangles(p);
    }
    TriMesh out;
    out.origin_mm = baked_.base().origin_mm;
    out.positions_mm.resize(all.vertex);
    out.triangles.resize(all.triangle);
    parallelFor(places.size(), run_.workers, run_.interrupted,
                [&](size_t i) { fill(static_cast<uint32_t>(first + i), out, places[i].vertex, places[i].triangle); });
    return out;
  }

 private:
  void fill(uint32_t p, TriMesh& out, size_t first_vertex, size_t first_triangle) const {
    const BaseMesh& base = baked_.base();
    const size_t n = size_t{1} << cells_log2_[p], row = n + 1, finest_row = (size_t{1} << finest_log2_) + 1,
                 step = (finest_row - 1) / n;
    std::vector<uint16_t> q(finest_row * finest_row);
    (void)baked_.heights(p, q);
    glm::vec3* vertex = out.positions_mm.data() + first_vertex;
    for (size_t y = 0; y <= n; ++y) {
      for (size_t x = 0; x <= n; ++x) {
        const double u = static_cast<double>(x) / static_cast<double>(n),
                     v = static_cast<double>(y) / static_cast<double>(n);
        const double height = baked_.reliefOffsetMm() + baked_.reliefScaleMm() * q[(y * finest_row + x) * step];
        *vertex++ = glm::vec3(base.point(p, u, v) + height * base.normal(p, u, v));
      }
    }
    auto* triangle = out.triangles.data() + first_triangle;
    for (size_t y = 0; y < n; ++y) {
      for (size_t x = 0; x < n; ++x) {
        const auto a = static_cast<uint32_t>(first_vertex + y * row + x), b = a + 1, c = a + static_cast<uint32_t>(row),
                   d = c + 1;
        *triangle++ = {a, d, b};
        *triangle++ = {a, c, d};
      }
    }
  }

  const MeshBake& baked_;
  const DistanceRun& run_;
  int finest_log2_;
  std::vector<int> cells_log2_;
};

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
  const BakedSurface surface(baked, run);
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
  const BakedSurface surface(baked, run);
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
