#include "geometry/remesh/base_fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "src/base/parallel_for.h"

namespace relievo {

namespace {

// Who lies further away than this many kMaxFitDistance is lost; how far does not matter.
constexpr double kSoughtDistance = 1.01;

double areaOfQuad(const std::array<glm::dvec3, 4>& p) { return glm::length(glm::cross(p[2] - p[0], p[3] - p[1])) / 2; }

}  // namespace

namespace {

// What lines along a quad's normals meet, on a grid of cells.
struct DisplacedQuad {
  std::vector<glm::vec3> vertices;
  std::vector<Triangle> triangles;                    // of these vertices
  std::vector<std::pair<uint32_t, float>> unmatched;  // samples of the base beyond the scan's borders, or over its
                                                      // holes, which meet nothing: the nearest triangle, how far it is
};

DisplacedQuad displacedQuad(const QuadMesh& quads, const SmartFaceHandle& q, const ScanSurface& scan, int cells,
                            bool detailed) {
  const auto p = pointsOf<4>(quads, q);
  const auto corners = cornersOf<4>(q);
  const double reach = std::max(glm::length(p[2] - p[0]), glm::length(p[3] - p[1]));
  const auto side = static_cast<uint32_t>(cells + 1);
  std::vector<Line> lines(size_t{side} * side);
  std::vector<SurfacePoint> hits(lines.size());
  for (uint32_t j = 0; j < side; ++j) {
    for (uint32_t i = 0; i < side; ++i) {
      const double u = static_cast<double>(i) / cells, v = static_cast<double>(j) / cells;
      auto bilinear = [&](auto&& x) { return (x(0) * (1 - u) + x(3) * u) * (1 - v) + (x(1) * (1 - u) + x(2) * u) * v; };
      const glm::dvec3 n = bilinear([&](size_t k) { return quads.normal(corners[k]); });
      const double length = glm::length(n);
      lines[j * side + i] = {bilinear([&](size_t k) { return p[k]; }), length > 0 ? n / length : glm::dvec3(0, 0, 1),
                             reach};
    }
  }
  scan.scene.nearestOnLines(lines, Facing::kAlong, hits);
  DisplacedQuad out;
  out.vertices.reserve(lines.size());
  for (size_t k = 0; k < lines.size(); ++k) {
    double height = hits[k].along;
    if (!hits[k]) {
      const SurfacePoint near = scan.scene.closestPoint(lines[k].at);
      const glm::dvec3 to_surface = near ? scan.point(near) - lines[k].at : glm::dvec3(0);
      height = glm::dot(to_surface, lines[k].direction);
      const double offset = glm::length(to_surface - height * lines[k].direction);
      if (near && offset > kMaxFitDistance) out.unmatched.push_back({near.triangle, static_cast<float>(offset)});
    }
    out.vertices.push_back(glm::vec3(lines[k].at + height * lines[k].direction));
  }
  out.triangles.reserve(2 * size_t{side - 1} * (side - 1));
  for (uint32_t j = 0; j + 1 < side; ++j) {
    for (uint32_t i = 0; i + 1 < side; ++i) {
      const uint32_t a = j * side + i;
      out.triangles.push_back({a, a + side, a + side + 1});
      out.triangles.push_back({a, a + side + 1, a + 1});
      if (!detailed) continue;
      // If neighbouring lines met different parts of the scan, the surface between them spans a gap. Steps of one
      // surface leave less than half a cell.
      const glm::dvec3 middle = 0.5 * (glm::dvec3(out.vertices[a]) + glm::dvec3(out.vertices[a + side + 1]));
      const SurfacePoint near = scan.scene.closestPoint(middle);
      if (!near || near.along < kMaxFitDistance + 0.6 * reach / cells) continue;
      out.unmatched.push_back({near.triangle, static_cast<float>(near.along)});
    }
  }
  return out;
}

}  // namespace

Fit measureFit(const QuadMesh& quads, const TriangleMesh& s, const ScanSurface& scan, size_t total_cells, bool detailed,
               int workers) {
  double base_area = 0;
  for (const auto q : quads.faces()) base_area += areaOfQuad(pointsOf<4>(quads, q));
  auto shareOf = [&](const SmartFaceHandle& q) {
    return detailed && base_area > 0 ? areaOfQuad(pointsOf<4>(quads, q)) / base_area
                                     : 1.0 / static_cast<double>(quads.n_faces());
  };
  std::vector<DisplacedQuad> displaced_quads(quads.n_faces());
  parallelFor(displaced_quads.size(), workers, nullptr, [&](size_t i) {
    const SmartFaceHandle q = OpenMesh::make_smart(FaceHandle(static_cast<int>(i)), quads);
    const int cells =
        std::clamp(static_cast<int>(std::sqrt(shareOf(q) * static_cast<double>(total_cells))), 4, detailed ? 64 : 1024);
    displaced_quads[i] = displacedQuad(quads, q, scan, cells, detailed);
  });
  TriMesh displaced;
  std::vector<std::pair<uint32_t, float>> unmatched;
  double unmatched_area = 0;
  for (size_t i = 0; i < displaced_quads.size(); ++i) {
    const DisplacedQuad& d = displaced_quads[i];
    const auto first = static_cast<uint32_t>(displaced.positions_mm.size());
    displaced.positions_mm.insert(displaced.positions_mm.end(), d.vertices.begin(), d.vertices.end());
    for (const Triangle& t : d.triangles) displaced.triangles.push_back({first + t[0], first + t[1], first + t[2]});
    const double of_sample = shareOf(OpenMesh::make_smart(FaceHandle(static_cast<int>(i)), quads)) * base_area /
                             static_cast<double>(d.vertices.size());
    for (size_t k = 0; k < d.unmatched.size(); ++k) unmatched_area += of_sample;
    unmatched.insert(unmatched.end(), d.unmatched.begin(), d.unmatched.end());
  }
  Fit fit;
  fit.vertex_error.assign(s.n_vertices(), 0.0f);
  auto scene = RayScene::create(displaced);
  if (!scene) return fit;
  constexpr size_t kVerticesPerJob = 512;
  parallelFor((s.n_vertices() + kVerticesPerJob - 1) / kVerticesPerJob, workers, nullptr, [&](size_t job) {
    for (size_t v = job * kVerticesPerJob; v < std::min(s.n_vertices(), (job + 1) * kVerticesPerJob); ++v) {
      const SurfacePoint near =
          (*scene)->closestPoint(s.point(VertexHandle(static_cast<int>(v))), kSoughtDistance * kMaxFitDistance);
      fit.vertex_error[v] = near ? static_cast<float>(near.along) : 1.0f;
    }
  });
  double area = 0;
  for (const auto t : s.faces()) {
    const double a = glm::length(areaVector(s, t));
    area += a;
    for (const auto v : t.vertices()) fit.lost_area += fit.vertex_error[v.idx()] > kMaxFitDistance ? a / 3 : 0;
  }
  if (area > 0) fit.lost_area /= area;
  fit.lost_area += unmatched_area / std::max(base_area, 1e-300);
  for (auto [triangle, offset] : unmatched) {
    for (const auto v : s.fv_range(FaceHandle(static_cast<int>(triangle))))
      fit.vertex_error[v.idx()] = std::max(fit.vertex_error[v.idx()], offset);
  }
  return fit;
}

void raiseWeights(const Fit& fit, const QuadMesh& quads, const TriangleMesh& s, const Regions& regions,
                  std::vector<float>& weight) {
  std::vector<float> factor(s.n_vertices(), 1.0f), next;
  for (const auto v : s.vertices()) {
    const VertexHandle corner = regions[v.idx()];
    // The weight 16 halves the sides where the surface is lost.
    if (fit.vertex_error[v.idx()] > kMaxFitDistance ||
        (corner.is_valid() && isFolded(quads, OpenMesh::make_smart(corner, quads))))
      factor[v.idx()] = 16.0f;
  }
  for (int ring = 0; ring < 6; ++ring) {
    next = factor;
    for (const auto v : s.vertices()) {
      for (const auto w : v.vertices()) next[v.idx()] = std::max(next[v.idx()], 0.75f * factor[w.idx()]);
    }
    factor.swap(next);
  }
  weight.resize(s.n_vertices(), 1.0f);
  for (size_t v = 0; v < weight.size(); ++v) weight[v] = std::min(weight[v] * factor[v], std::max(weight[v], 256.0f));
}

}  // namespace relievo
