#include "geometry/mesh_distance.h"

#include <algorithm>
#include <cmath>

#include "geometry/parallel_for.h"
#include "geometry/ray_scene.h"
#include "src/base/planar_domain.h"

namespace relievo {
namespace {

// The k-th place in a triangle: the plastic number's sequence, folded into it (Roberts 2018): any run of them is spread evenly.
glm::dvec2 placeInTriangle(size_t k) {
  constexpr double kPlastic = 1.32471795724474602596;
  double b1 = std::fmod(0.5 + static_cast<double>(k) / kPlastic, 1.0), b2 = std::fmod(0.5 + static_cast<double>(k) / (kPlastic * kPlastic), 1.0);
  if (b1 + b2 > 1) {
    b1 = 1 - b1;
    b2 = 1 - b2;
  }
  return {b1, b2};
}

// In mm: from every vertex of `from` if these are asked for, then from `spread` places, evenly over its area, to `to`. Interrupted: some.
std::vector<float> distances(const TriMesh& from, const TriMesh& to, const RayScene& scene, bool with_vertices, size_t spread, const DistanceRun& run) {
  const size_t vertices = with_vertices ? from.positions_mm.size() : 0;
  std::vector<double> area_before{0.0};
  area_before.reserve(from.triangles.size() + 1);
  for (const auto& t : from.triangles) {
    const glm::dvec3 a(from.positions_mm[t[0]]), b(from.positions_mm[t[1]]), c(from.positions_mm[t[2]]);
    area_before.push_back(area_before.back() + glm::length(glm::cross(b - a, c - a)));
  }
  if (!(area_before.back() > 0)) spread = 0;
  std::vector<float> out(vertices + spread);
  const glm::dvec3 shift = from.origin_mm - to.origin_mm;
  constexpr size_t kAJob = 4096;
  const size_t jobs = (out.size() + kAJob - 1) / kAJob;
  auto progress = [&](size_t taken) {
    if (run.progress) run.progress(static_cast<double>(taken) / static_cast<double>(jobs));
  };
  auto measure = [&](size_t job) {
    SurfacePoint last;  // where the sample before was closest: seldom far from where this one is
    size_t triangle = 0;
    for (size_t i = job * kAJob; i < std::min(out.size(), (job + 1) * kAJob); ++i) {
      glm::dvec3 p;
      if (i < vertices) {
        p = glm::dvec3(from.positions_mm[i]);
      } else {
        const size_t k = i - vertices;
        const double area = (static_cast<double>(k) + 0.5) / static_cast<double>(spread) * area_before.back();
        if (area >= area_before[triangle + 1])
          triangle = static_cast<size_t>(std::upper_bound(area_before.begin(), area_before.end(), area) - area_before.begin()) - 1;
        triangle = std::min(triangle, from.triangles.size() - 1);
        const auto& t = from.triangles[triangle];
        const glm::dvec2 w = placeInTriangle(k);
        const glm::dvec3 a(from.positions_mm[t[0]]), b(from.positions_mm[t[1]]), c(from.positions_mm[t[2]]);
        p = a + w.x * (b - a) + w.y * (c - a);
      }
      last = scene.closestPoint(p + shift, last);
      out[i] = static_cast<float>(last.along);
    }
  };
  parallelFor(jobs, run.workers, run.interrupted, measure, progress);
  return out;
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

}  // namespace

TriMesh bakedTriangles(const MeshBake& baked, const DistanceRun& run) {
  const BaseMesh& base = baked.base();
  glm::dvec3 low(base.corners[0].position_mm), high = low;
  for (const BaseCorner& c : base.corners) {
    low = glm::min(low, glm::dvec3(c.position_mm));
    high = glm::max(high, glm::dvec3(c.position_mm));
  }
  const double close_mm = std::max(5e-6 * glm::length(high - low), baked.reliefScaleMm());
  const int finest_log2 = 7 + baked.reliefDepth();
  struct Part {
    int cells_log2 = 0;
    size_t first_vertex = 0, first_triangle = 0;
  };
  std::vector<Part> parts(base.patches.size());
  parallelFor(parts.size(), run.workers, run.interrupted, [&](size_t p) {
    int& log2 = parts[p].cells_log2 = std::min(baked.report().cells_log2, finest_log2);
    while (log2 < finest_log2 && baked.errorOfCells(static_cast<uint32_t>(p), log2) > close_mm) ++log2;
  });
  size_t vertices = 0, triangles = 0;
  for (Part& part : parts) {
    const size_t n = size_t{1} << part.cells_log2;
    part.first_vertex = vertices;
    part.first_triangle = triangles;
    vertices += (n + 1) * (n + 1);
    triangles += 2 * n * n;
  }
  TriMesh out;
  out.origin_mm = base.origin_mm;
  out.positions_mm.resize(vertices);
  out.triangles.resize(triangles);
  parallelFor(parts.size(), run.workers, run.interrupted, [&](size_t index) {
    const auto p = static_cast<uint32_t>(index);
    const Part& part = parts[p];
    const size_t n = size_t{1} << part.cells_log2, row = n + 1, finest_row = (size_t{1} << finest_log2) + 1, step = (finest_row - 1) / n;
    std::vector<uint16_t> q(finest_row * finest_row);
    (void)baked.heights(p, q);
    glm::vec3* vertex = out.positions_mm.data() + part.first_vertex;
    for (size_t y = 0; y <= n; ++y) {
      for (size_t x = 0; x <= n; ++x) {
        const double u = static_cast<double>(x) / static_cast<double>(n), v = static_cast<double>(y) / static_cast<double>(n);
        const double height = baked.reliefOffsetMm() + baked.reliefScaleMm() * q[(y * finest_row + x) * step];
        *vertex++ = glm::vec3(base.point(p, u, v) + height * base.normal(p, u, v));
      }
    }
    auto* triangle = out.triangles.data() + part.first_triangle;
    for (size_t y = 0; y < n; ++y) {
      for (size_t x = 0; x < n; ++x) {
        const auto a = static_cast<uint32_t>(part.first_vertex + y * row + x), b = a + 1, c = a + static_cast<uint32_t>(row), d = c + 1;
        *triangle++ = {a, d, b};
        *triangle++ = {a, c, d};
      }
    }
  });
  return out;
}

Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle, const DistanceRun& run) {
  MeshDistance out;
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  auto stopped = [&] { return run.interrupted && run.interrupted->load(std::memory_order_relaxed); };
  // Building what is looked up takes a twelfth of the time, either way about half of the rest.
  auto part = [&](double from, double to) {
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
  const TriMesh surface = bakedTriangles(baked, run);
  if (stopped()) return interrupted;
  auto surface_scene = RayScene::create(surface, run.interrupted);
  if (!surface_scene) return surface_scene.error();
  const size_t spread = scan.triangles.size() * static_cast<size_t>(std::max(samples_per_triangle, 0));
  std::vector<float> there = distances(scan, surface, **surface_scene, true, spread, part(0.08, 0.54));
  if (stopped()) return interrupted;
  surface_scene->reset();
  out.scan_vertex_mm.assign(there.begin(), there.begin() + static_cast<ptrdiff_t>(scan.positions_mm.size()));
  out.to_baked = stats(there);
  std::vector<float>().swap(there);
  auto scan_scene = RayScene::create(scan, run.interrupted);
  if (!scan_scene) return scan_scene.error();
  std::vector<float> back = distances(surface, scan, **scan_scene, false, out.to_baked.samples, part(0.58, 1));
  if (stopped()) return interrupted;
  out.to_scan = stats(back);
  // No more than 240 dB: a number even where both are the same.
  const double rms = std::max({out.to_baked.rms_mm, out.to_scan.rms_mm, 1e-12 * out.diagonal_mm});
  out.psnr_db = out.diagonal_mm > 0 ? 20 * std::log10(out.diagonal_mm / rms) : 0;
  return out;
}

}  // namespace relievo
