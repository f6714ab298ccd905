#include "geometry/remesh/base_fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace relievo {

Fit judgeFit(const QuadMesh& quads, const std::vector<glm::dvec3>& normals, const Surface& s, const ScanLookup& scan,
             int cells) {
  const auto side = static_cast<uint32_t>(cells + 1);
  TriMesh displaced;
  displaced.positions_mm.reserve(quads.quads.size() * side * side);
  displaced.triangles.reserve(quads.quads.size() * cells * cells * 2);
  std::vector<Line> lines(side * side);
  std::vector<SurfacePoint> hits(lines.size());
  // Beyond the borders there is nothing for lines to meet: base where the scan has a hole.
  std::vector<std::pair<uint32_t, float>> beyond;
  for (const auto& q : quads.quads) {
    const double reach = std::max(glm::length(quads.points[q[2]] - quads.points[q[0]]),
                                  glm::length(quads.points[q[3]] - quads.points[q[1]]));
    for (uint32_t j = 0; j < side; ++j) {
      for (uint32_t i = 0; i < side; ++i) {
        const double u = static_cast<double>(i) / cells, v = static_cast<double>(j) / cells;
        auto bilinear = [&](const std::vector<glm::dvec3>& x) {
          return (x[q[0]] * (1 - u) + x[q[3]] * u) * (1 - v) + (x[q[1]] * (1 - u) + x[q[2]] * u) * v;
        };
        const glm::dvec3 n = bilinear(normals);
        const double length = glm::length(n);
        lines[j * side + i] = {bilinear(quads.points), length > 0 ? n / length : glm::dvec3(0, 0, 1), reach};
      }
    }
    scan.scene.nearestOnLines(lines, Facing::kAlong, hits);
    const auto first = static_cast<uint32_t>(displaced.positions_mm.size());
    for (size_t k = 0; k < lines.size(); ++k) {
      double height = hits[k].along;
      if (!hits[k]) {
        const SurfacePoint near = scan.scene.closestPoint(lines[k].at);
        const glm::dvec3 way = near ? scan.point(near) - lines[k].at : glm::dvec3(0);
        height = glm::dot(way, lines[k].direction);
        const double off = glm::length(way - height * lines[k].direction);
        if (near && off > kLostDistance) beyond.push_back({near.triangle, static_cast<float>(off)});
      }
      displaced.positions_mm.push_back(glm::vec3(lines[k].at + height * lines[k].direction));
    }
    for (uint32_t j = 0; j + 1 < side; ++j) {
      for (uint32_t i = 0; i + 1 < side; ++i) {
        const uint32_t a = first + j * side + i;
        displaced.triangles.push_back({a, a + side, a + side + 1});
        displaced.triangles.push_back({a, a + side + 1, a + 1});
      }
    }
  }
  Fit fit;
  fit.error.assign(s.points.size(), 0.0f);
  auto scene = RayScene::create(displaced);
  if (!scene) return fit;
  for (uint32_t v = 0; v < s.points.size(); ++v) {
    const SurfacePoint near = (*scene)->closestPoint(s.points[v]);
    fit.error[v] = near ? static_cast<float>(near.along) : 1.0f;
  }
  double area = 0;
  for (const Triangle& t : s.triangles) {
    const double a = glm::length(glm::cross(s.points[t[1]] - s.points[t[0]], s.points[t[2]] - s.points[t[0]]));
    area += a;
    for (uint32_t v : t) fit.lost += fit.error[v] > kLostDistance ? a / 3 : 0;
  }
  if (area > 0) fit.lost /= area;
  fit.lost += static_cast<double>(beyond.size()) / static_cast<double>(displaced.positions_mm.size());
  for (auto [triangle, off] : beyond) {
    for (uint32_t v : s.triangles[triangle]) fit.error[v] = std::max(fit.error[v], off);
  }
  return fit;
}

std::vector<uint8_t> foldedCorners(const QuadMesh& quads, const std::vector<glm::dvec3>& normals) {
  std::vector<uint8_t> folded(quads.points.size(), 0);
  for (const auto& q : quads.quads) {
    for (int k = 0; k < 4; ++k) {
      const glm::dvec3 a = quads.points[q[(k + 1) % 4]] - quads.points[q[k]],
                       b = quads.points[q[(k + 3) % 4]] - quads.points[q[k]];
      if (glm::dot(glm::cross(a, b), normals[q[k]]) < 0.02 * glm::length(a) * glm::length(b)) folded[q[k]] = 1;
    }
  }
  return folded;
}

void raiseWeights(const Fit& fit, const std::vector<uint8_t>& folded, const std::vector<uint32_t>& regions,
                  const Surface& s, std::vector<float>& weight) {
  std::vector<float> factor(s.points.size(), 1.0f), next;
  for (uint32_t v = 0; v < s.points.size(); ++v) {
    // Half as long sides where it is lost.
    if (fit.error[v] > kLostDistance || (regions[v] != kNoIndex && folded[regions[v]])) factor[v] = 16.0f;
  }
  for (int ring = 0; ring < 6; ++ring) {
    next = factor;
    for (const Triangle& t : s.triangles) {
      const float most = 0.75f * std::max({factor[t[0]], factor[t[1]], factor[t[2]]});
      for (uint32_t v : t) next[v] = std::max(next[v], most);
    }
    factor.swap(next);
  }
  weight.resize(s.points.size(), 1.0f);
  for (uint32_t v = 0; v < s.points.size(); ++v) weight[v] = std::min(weight[v] * factor[v], 256.0f);
}

}  // namespace relievo
