#include "geometry/mesh_distance.h"

#include <algorithm>
#include <cmath>

#include "geometry/parallel_for.h"
#include "geometry/ray_scene.h"
#include "src/base/planar_domain.h"

namespace relievo {
namespace {

// Points k of n in a triangle: the plastic number's sequence, folded into it (Roberts 2018): even for every n.
glm::dvec2 placeInTriangle(int k) {
  constexpr double kPlastic = 1.32471795724474602596;
  double b1 = std::fmod(0.5 + k / kPlastic, 1.0), b2 = std::fmod(0.5 + k / (kPlastic * kPlastic), 1.0);
  if (b1 + b2 > 1) {
    b1 = 1 - b1;
    b2 = 1 - b2;
  }
  return {b1, b2};
}

// From every vertex of `from`, and places in its triangles, to `to`; mm.
std::vector<float> distances(const TriMesh& from, const TriMesh& to, const RayScene& scene, int places, int workers) {
  const size_t vertices = from.positions_mm.size(), total = vertices + from.triangles.size() * static_cast<size_t>(places);
  std::vector<float> out(total);
  const glm::dvec3 shift = from.origin_mm - to.origin_mm;
  constexpr size_t kAJob = 4096;
  parallelFor((total + kAJob - 1) / kAJob, workers, nullptr, [&](size_t job) {
    for (size_t i = job * kAJob; i < std::min(total, (job + 1) * kAJob); ++i) {
      glm::dvec3 p;
      if (i < vertices) {
        p = glm::dvec3(from.positions_mm[i]);
      } else {
        const size_t place = i - vertices;
        const auto& t = from.triangles[place / static_cast<size_t>(places)];
        const glm::dvec2 w = placeInTriangle(static_cast<int>(place % static_cast<size_t>(places)));
        const glm::dvec3 a(from.positions_mm[t[0]]), b(from.positions_mm[t[1]]), c(from.positions_mm[t[2]]);
        p = a + w.x * (b - a) + w.y * (c - a);
      }
      out[i] = static_cast<float>(scene.closestPoint(p + shift).along);
    }
  });
  return out;
}

DistanceStats stats(std::vector<float> mm) {
  DistanceStats out;
  out.samples = mm.size();
  if (mm.empty()) return out;
  double sum = 0;
  for (float d : mm) sum += static_cast<double>(d) * d;
  out.rms_mm = std::sqrt(sum / static_cast<double>(mm.size()));
  std::sort(mm.begin(), mm.end());
  out.max_mm = mm.back();
  constexpr std::array<double, 5> kShares{0.5, 0.9, 0.95, 0.99, 0.999};
  for (size_t i = 0; i < kShares.size(); ++i) {
    const double rank = std::ceil(kShares[i] * static_cast<double>(mm.size())) - 1;  // nearest rank
    out.percentiles_mm[i] = mm[static_cast<size_t>(std::max(rank, 0.0))];
  }
  return out;
}

}  // namespace

TriMesh bakedTriangles(const MeshBake& baked) {
  TriMesh out;
  const BaseMesh& base = baked.base();
  out.origin_mm = base.origin_mm;
  const size_t n = size_t{kPagePx} << baked.reliefDepth(), row = n + 1;
  std::vector<uint16_t> q(row * row);
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto first = static_cast<uint32_t>(out.positions_mm.size());
    (void)baked.heights(p, q);
    for (size_t y = 0; y < row; ++y) {
      for (size_t x = 0; x < row; ++x) {
        const double u = static_cast<double>(x) / static_cast<double>(n), v = static_cast<double>(y) / static_cast<double>(n);
        out.positions_mm.push_back(glm::vec3(base.point(p, u, v) + (baked.reliefOffsetMm() + baked.reliefScaleMm() * q[y * row + x]) * base.normal(p, u, v)));
      }
    }
    for (size_t y = 0; y < n; ++y) {
      for (size_t x = 0; x < n; ++x) {
        const uint32_t a = first + static_cast<uint32_t>(y * row + x), b = a + 1, c = a + static_cast<uint32_t>(row), d = c + 1;
        out.triangles.push_back({a, d, b});
        out.triangles.push_back({a, c, d});
      }
    }
  }
  return out;
}

Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle, int workers) {
  MeshDistance out;
  glm::vec3 low = scan.positions_mm.at(0), high = low;
  for (const glm::vec3& p : scan.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  out.diagonal_mm = glm::length(glm::dvec3(high) - glm::dvec3(low));
  const TriMesh surface = bakedTriangles(baked);
  auto surface_scene = RayScene::create(surface);
  if (!surface_scene) return surface_scene.error();
  auto scan_scene = RayScene::create(scan);
  if (!scan_scene) return scan_scene.error();
  std::vector<float> there = distances(scan, surface, **surface_scene, samples_per_triangle, workers);
  out.scan_vertex_mm.assign(there.begin(), there.begin() + static_cast<ptrdiff_t>(scan.positions_mm.size()));
  out.to_baked = stats(std::move(there));
  out.to_scan = stats(distances(surface, scan, **scan_scene, samples_per_triangle, workers));
  out.psnr_db = 20 * std::log10(out.diagonal_mm / std::max(out.to_baked.rms_mm, out.to_scan.rms_mm));
  return out;
}

}  // namespace relievo
