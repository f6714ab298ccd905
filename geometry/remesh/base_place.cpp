#include "geometry/remesh/base_place.h"

#include <algorithm>
#include <cmath>
#include <queue>
#include <span>

namespace relievo {

namespace {

// Eigenvalues and eigenvectors (columns) of a symmetric matrix by Jacobi rotations.
void eigen(glm::dmat3 a, glm::dvec3& values, glm::dmat3& vectors) {
  vectors = glm::dmat3(1);
  for (int sweep = 0; sweep < 12; ++sweep) {
    for (int p = 0; p < 2; ++p) {
      for (int q = p + 1; q < 3; ++q) {
        if (std::abs(a[p][q]) < 1e-300) continue;
        const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        glm::dmat3 r(1);
        r[p][p] = c, r[q][q] = c, r[q][p] = s, r[p][q] = -s;
        a = glm::transpose(r) * a * r;
        vectors = vectors * r;
      }
    }
  }
  values = {a[0][0], a[1][1], a[2][2]};
}

}  // namespace

Fans::Fans(const Surface& s) : begin(s.points.size() + 1, 0), fan(3 * s.triangles.size()) {
  for (const Triangle& t : s.triangles) {
    for (uint32_t v : t) ++begin[v + 1];
  }
  for (size_t v = 1; v < begin.size(); ++v) begin[v] += begin[v - 1];
  std::vector<uint32_t> fill(begin.begin(), begin.end() - 1);
  for (uint32_t t = 0; t < s.triangles.size(); ++t) {
    for (uint32_t v : s.triangles[t]) fan[fill[v]++] = t;
  }
}

std::vector<uint32_t> cornerRegions(const QuadMesh& quads, const Surface& s, const Fans& fans, const ScanLookup& scan) {
  struct Front {
    float distance;
    uint32_t vertex, corner;
    bool operator<(const Front& o) const {
      if (distance != o.distance) return distance > o.distance;
      return vertex != o.vertex ? vertex > o.vertex : corner > o.corner;
    }
  };
  std::vector<Front> fronts;
  for (uint32_t c = 0; c < quads.points.size(); ++c) {
    SurfacePoint at = scan.project(quads.points[c], quads.normals[c], 0.1);
    if (!at) at = scan.scene.closestPoint(quads.points[c]);
    if (!at) continue;
    for (uint32_t v : s.triangles[at.triangle])
      fronts.push_back({static_cast<float>(glm::length(glm::dvec3(s.points[v]) - scan.point(at))), v, c});
  }
  std::priority_queue<Front> queue(std::less<Front>(), std::move(fronts));
  std::vector<uint32_t> owner(s.points.size(), kNoIndex);
  std::vector<float> distance(s.points.size(), 1e30f);
  while (!queue.empty()) {
    const Front f = queue.top();
    queue.pop();
    if (owner[f.vertex] != kNoIndex) continue;
    owner[f.vertex] = f.corner;
    for (uint32_t i = fans.begin[f.vertex]; i < fans.begin[f.vertex + 1]; ++i) {
      for (uint32_t w : s.triangles[fans.fan[i]]) {
        const float d = f.distance + glm::length(s.points[w] - s.points[f.vertex]);
        if (owner[w] != kNoIndex || d >= distance[w]) continue;
        distance[w] = d;
        queue.push({d, w, f.corner});
      }
    }
  }
  return owner;
}

void placeCorners(QuadMesh& quads, const Surface& s, const std::vector<uint32_t>& regions, const ScanLookup& scan) {
  struct Region {
    glm::dmat3 planes{0};  // sum of area n n^T
    glm::dvec3 pull{0};    // sum of area n (n . q)
    double area = 0;
  };
  std::vector<Region> all(quads.points.size());
  for (const Triangle& t : s.triangles) {
    const glm::dvec3 a = s.points[t[0]],
                     cross = glm::cross(glm::dvec3(s.points[t[1]]) - a, glm::dvec3(s.points[t[2]]) - a);
    const double twice = glm::length(cross);
    if (!(twice > 0)) continue;
    const glm::dvec3 n = cross / twice;
    const double share = twice / 6;
    for (uint32_t v : t) {
      if (regions[v] == kNoIndex) continue;
      Region& r = all[regions[v]];
      r.planes += share * glm::outerProduct(n, n);
      r.pull += share * glm::dot(n, a - quads.points[regions[v]]) * n;
      r.area += share;
    }
  }
  const QuadStars stars(quads);
  quads.slide.resize(quads.points.size(), glm::dmat3(1));
  for (uint32_t c = 0; c < all.size(); ++c) {
    const Region& r = all[c];
    if (quads.place[c].curve != kNoIndex || quads.fixed[c] || !(r.area > 0) || quads.slide[c] == glm::dmat3(0))
      continue;  // where creases meet: for good
    quads.slide[c] = glm::dmat3(1);
    glm::dvec3 spread;
    glm::dmat3 axes;
    eigen(r.planes / r.area, spread, axes);
    // A second direction of normals: a crease of some 60 degrees through the middle has 0.25 there; a sphere's cap of
    // +-35 degrees has 0.09.
    glm::dvec3 move{0};
    int stiff = 0;
    for (int k = 0; k < 3; ++k) {
      if (spread[k] < 0.15) continue;
      ++stiff;
      move += axes[k] * (glm::dot(axes[k], r.pull / r.area) / spread[k]);
      quads.slide[c] -= glm::outerProduct(axes[k], axes[k]);
    }
    if (stiff == 3) quads.slide[c] = glm::dmat3(0);
    if (stiff < 2) {
      quads.slide[c] = glm::dmat3(1);
      continue;
    }
    const double radius = std::sqrt(r.area), length = glm::length(move);
    if (length > radius) move *= radius / length;
    const glm::dvec3 was = quads.points[c];
    const double before = stars.leastSine(quads, c);
    if (const SurfacePoint hit = scan.project(was + move, quads.normals[c], radius)) quads.points[c] = scan.point(hit);
    if (stars.leastSine(quads, c) < std::min(before, 0.4)) {
      quads.points[c] = was;
      quads.slide[c] = glm::dmat3(1);
    }
  }
}

std::vector<glm::dvec3> cornerNormals(const QuadMesh& quads, const Surface& s, const std::vector<uint32_t>& regions,
                                      const ScanLookup& scan) {
  // Each region's triangles' shares: (corner, area vector), by corner.
  std::vector<uint32_t> begin(quads.points.size() + 1, 0);
  for (const Triangle& t : s.triangles) {
    for (uint32_t v : t) {
      if (regions[v] != kNoIndex) ++begin[regions[v] + 1];
    }
  }
  for (size_t c = 1; c < begin.size(); ++c) begin[c] += begin[c - 1];
  std::vector<uint32_t> fill(begin.begin(), begin.end() - 1);
  std::vector<glm::dvec3> shares(begin.back());
  for (const Triangle& t : s.triangles) {
    const glm::dvec3 a = s.points[t[0]],
                     cross = glm::cross(glm::dvec3(s.points[t[1]]) - a, glm::dvec3(s.points[t[2]]) - a);
    for (uint32_t v : t) {
      if (regions[v] != kNoIndex) shares[fill[regions[v]]++] = cross;
    }
  }
  // What turns more than some 70 degrees away from the mean counts for more, step by step; the least of such turning is
  // kept.
  constexpr double kSteep = 0.35;
  std::vector<glm::dvec3> normals(quads.points.size());
  std::vector<double> weight, area;
  for (size_t c = 0; c < normals.size(); ++c) {
    const std::span<const glm::dvec3> region(shares.data() + begin[c], begin[c + 1] - begin[c]);
    weight.assign(region.size(), 1.0);
    area.resize(region.size());
    for (size_t i = 0; i < region.size(); ++i) area[i] = glm::length(region[i]);
    normals[c] = quads.normals[c];
    double least = 1e300;
    for (int step = 0; step < 16 && least > 0; ++step) {
      glm::dvec3 sum{0};
      for (size_t i = 0; i < region.size(); ++i) sum += weight[i] * region[i];
      const double length = glm::length(sum);
      if (!(length > 0)) break;
      double steep = 0;
      for (size_t i = 0; i < region.size(); ++i) {
        const double missing = kSteep - glm::dot(sum, region[i]) / (length * std::max(area[i], 1e-300));
        if (missing <= 0) continue;
        steep += area[i] * missing * missing;
        weight[i] *= 1 + missing;
      }
      if (steep < least) normals[c] = sum / length;
      least = std::min(least, steep);
    }
    // Neither a region nor quads with an area: the surface's own.
    if (normals[c] == glm::dvec3(0)) {
      const SurfacePoint near = scan.scene.closestPoint(quads.points[c]);
      if (near) normals[c] = scan.normal(near.triangle);
      if (normals[c] == glm::dvec3(0)) normals[c] = {0, 0, 1};
    }
  }
  return normals;
}

}  // namespace relievo
