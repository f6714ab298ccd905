#include "geometry/bake/baked_surface.h"

#include <algorithm>
#include <cmath>

#include "src/artwork/patch_domain.h"
#include "src/base/parallel_for.h"

namespace relievo {

BakedSurface::BakedSurface(const MeshBake& baked, int workers, const std::atomic<bool>* interrupted)
    : baked_(baked), workers_(workers), interrupted_(interrupted), finest_log2_(7 + baked.reliefDepth()) {
  const BaseMesh& base = baked.base();
  glm::dvec3 low(base.corners[0].position_mm), high = low;
  for (const BaseCorner& c : base.corners) {
    low = glm::min(low, glm::dvec3(c.position_mm));
    high = glm::max(high, glm::dvec3(c.position_mm));
  }
  const double tolerance_mm = std::max(5e-6 * glm::length(high - low), baked.reliefScaleMm());
  cells_log2_.resize(base.patches.size());
  parallelFor(cells_log2_.size(), workers, interrupted, [&](size_t p) {
    int& log2 = cells_log2_[p] = std::min(baked.report().cells_log2, finest_log2_);
    while (log2 < finest_log2_ && baked.errorOfGrid(static_cast<uint32_t>(p), log2) > tolerance_mm) ++log2;
  });
}

TriMesh BakedSurface::part(size_t first, size_t end) const {
  struct Offsets {
    size_t vertex = 0, triangle = 0;
  };
  std::vector<Offsets> offsets(end - first);
  Offsets total;
  for (size_t p = first; p < end; ++p) {
    const size_t row = (size_t{1} << cells_log2_[p]) + 1;
    offsets[p - first] = total;
    total.vertex += row * row;
    total.triangle += triangles(p);
  }
  TriMesh out;
  out.origin_mm = baked_.base().origin_mm;
  out.positions_mm.resize(total.vertex);
  out.triangles.resize(total.triangle);
  parallelFor(offsets.size(), workers_, interrupted_,
              [&](size_t i) { fill(static_cast<uint32_t>(first + i), out, offsets[i].vertex, offsets[i].triangle); });
  return out;
}

void BakedSurface::fill(uint32_t p, TriMesh& out, size_t first_vertex, size_t first_triangle) const {
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

}  // namespace relievo
