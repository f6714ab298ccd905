#include "geometry/remesh/corner_placement.h"

#include <algorithm>
#include <cmath>
#include <queue>

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

RegionTables::RegionTables(const TriangleMesh& s) {
  points.reserve(s.n_vertices());
  first.reserve(s.n_vertices() + 1);
  neighbours.reserve(2 * s.n_edges());
  for (const auto v : s.vertices()) {
    points.push_back(s.point(v));
    first.push_back(static_cast<uint32_t>(neighbours.size()));
    for (const auto w : s.vv_range(v))
      neighbours.push_back(
          {static_cast<uint32_t>(w.idx()), glm::length(glm::vec3(s.point(w)) - glm::vec3(s.point(v)))});
  }
  first.push_back(static_cast<uint32_t>(neighbours.size()));
  faces.reserve(s.n_faces());
  for (const auto f : s.faces()) {
    Face face{};
    size_t k = 0;
    for (const auto v : f.vertices()) face.vertices[k++] = static_cast<uint32_t>(v.idx());
    const auto p = pointsOf<3>(s, f);
    const glm::dvec3 cross = areaVector(p);
    face.point = p[0];
    face.area = cross;
    face.twice_area = glm::length(cross);
    if (face.twice_area > 0) face.normal = cross / face.twice_area;
    faces.push_back(face);
  }
}

Regions cornerRegions(const QuadMesh& quads, const RegionTables& s, const ScanSurface& scan) {
  struct FrontEntry {
    float distance;
    uint32_t vertex;
    VertexHandle corner;
    bool operator<(const FrontEntry& o) const {
      if (distance != o.distance) return distance > o.distance;
      return vertex != o.vertex ? o.vertex < vertex : o.corner < corner;
    }
  };
  std::vector<FrontEntry> seeds;
  for (const auto c : quads.vertices()) {
    SurfacePoint at = scan.project(quads.point(c), quads.normal(c), 0.1);
    if (!at) at = scan.scene.closestPoint(quads.point(c));
    if (!at) continue;
    for (const uint32_t v : s.faces[at.triangle].vertices)
      seeds.push_back({static_cast<float>(glm::length(s.points[v] - scan.point(at))), v, c});
  }
  std::priority_queue<FrontEntry> queue(std::less<FrontEntry>(), std::move(seeds));
  Regions nearest_corner(s.points.size());
  std::vector<float> distance(s.points.size(), 1e30f);
  while (!queue.empty()) {
    const FrontEntry f = queue.top();
    queue.pop();
    if (nearest_corner[f.vertex].is_valid()) continue;
    nearest_corner[f.vertex] = f.corner;
    for (uint32_t i = s.first[f.vertex]; i < s.first[f.vertex + 1]; ++i) {
      const auto [w, length] = s.neighbours[i];
      const float d = f.distance + length;
      if (nearest_corner[w].is_valid() || d >= distance[w]) continue;
      distance[w] = d;
      queue.push({d, w, f.corner});
    }
  }
  return nearest_corner;
}

void placeCorners(QuadMesh& quads, const RegionTables& s, const Regions& regions, const ScanSurface& scan) {
  struct Region {
    glm::dmat3 planes{0};      // sum of area n n^T
    glm::dvec3 right_side{0};  // sum of area n (n . q)
    double area = 0;
  };
  std::vector<Region> all(quads.n_vertices());
  for (const RegionTables::Face& f : s.faces) {
    if (!(f.twice_area > 0)) continue;
    const glm::dvec3 n = f.normal;
    const double share = f.twice_area / 6;
    for (const uint32_t v : f.vertices) {
      const VertexHandle corner = regions[v];
      if (!corner.is_valid()) continue;
      Region& r = all[corner.idx()];
      r.planes += share * glm::outerProduct(n, n);
      r.right_side += share * glm::dot(n, f.point - quads.point(corner)) * n;
      r.area += share;
    }
  }
  for (const auto c : quads.vertices()) {
    const Region& r = all[c.idx()];
    auto& data = quads.data(c);
    if (data.on_curve || data.fixed || !(r.area > 0) || data.free_directions == glm::dmat3(0))
      continue;  // corners where creases meet stay
    data.free_directions = glm::dmat3(1);
    glm::dvec3 eigenvalues;
    glm::dmat3 axes;
    eigen(r.planes / r.area, eigenvalues, axes);
    // A second large eigenvalue means a crease: one of 60 degrees through the middle has 0.25, a sphere's cap of +-35
    // degrees has 0.09.
    glm::dvec3 move{0};
    int constrained = 0;
    for (int k = 0; k < 3; ++k) {
      if (eigenvalues[k] < 0.15) continue;
      ++constrained;
      move += axes[k] * (glm::dot(axes[k], r.right_side / r.area) / eigenvalues[k]);
      data.free_directions -= glm::outerProduct(axes[k], axes[k]);
    }
    if (constrained == 3) data.free_directions = glm::dmat3(0);
    if (constrained < 2) {
      data.free_directions = glm::dmat3(1);
      continue;
    }
    const double radius = std::sqrt(r.area), length = glm::length(move);
    if (length > radius) move *= radius / length;
    const glm::dvec3 old_position = quads.point(c);
    const double old_sine = minSine(quads, c);
    if (const SurfacePoint hit = scan.project(old_position + move, quads.normal(c), radius))
      quads.set_point(c, scan.point(hit));
    if (minSine(quads, c) < std::min(old_sine, 0.4)) {
      quads.set_point(c, old_position);
      data.free_directions = glm::dmat3(1);
    }
  }
}

void assignNormals(QuadMesh& quads, const RegionTables& s, const Regions& regions, const ScanSurface& scan) {
  // For each corner, the area vectors of its triangles.
  std::vector<std::vector<glm::dvec3>> region_areas(quads.n_vertices());
  for (const RegionTables::Face& f : s.faces)
    for (const uint32_t v : f.vertices)
      if (regions[v].is_valid()) region_areas[regions[v].idx()].push_back(f.area);
  // Triangles that turn more than 70 degrees away from the mean get more weight in each step; the best step is kept.
  constexpr double kSteepCosine = 0.35;
  std::vector<double> weight, area;
  for (const auto c : quads.vertices()) {
    const std::vector<glm::dvec3>& region = region_areas[c.idx()];
    weight.assign(region.size(), 1.0);
    area.resize(region.size());
    for (size_t i = 0; i < region.size(); ++i) area[i] = glm::length(region[i]);
    glm::dvec3 normal = quads.normal(c);
    double least_steep = 1e300;
    for (int step = 0; step < 16 && least_steep > 0; ++step) {
      glm::dvec3 sum{0};
      for (size_t i = 0; i < region.size(); ++i) sum += weight[i] * region[i];
      const double length = glm::length(sum);
      if (!(length > 0)) break;
      double steep = 0;
      for (size_t i = 0; i < region.size(); ++i) {
        const double missing = kSteepCosine - glm::dot(sum, region[i]) / (length * std::max(area[i], 1e-300));
        if (missing <= 0) continue;
        steep += area[i] * missing * missing;
        weight[i] *= 1 + missing;
      }
      if (steep < least_steep) normal = sum / length;
      least_steep = std::min(least_steep, steep);
    }
    // If neither the region nor the quads have an area, the surface's own normal is taken.
    if (normal == glm::dvec3(0)) {
      const SurfacePoint near = scan.scene.closestPoint(quads.point(c));
      if (near) normal = scan.normal(near.triangle);
      if (normal == glm::dvec3(0)) normal = {0, 0, 1};
    }
    quads.set_normal(c, normal);
  }
}

}  // namespace relievo
