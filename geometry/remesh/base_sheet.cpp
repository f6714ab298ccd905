#include "geometry/remesh/base_sheet.h"

#include <algorithm>
#include <cmath>

#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/coarse_mesh.h"
#include "src/base/parallel_for.h"

namespace relievo {

namespace {

constexpr double kMaxSag = 0.03;  // largest distance of a side from its chord, over the chord's length

bool isStraight(const FeatureCurve& curve) {
  const glm::dvec3 a = curve.points.front(), side = curve.points.back() - a;
  const double length = glm::length(side);
  return length > 0 && std::all_of(curve.points.begin(), curve.points.end(), [&](const glm::dvec3& p) {
           return glm::length(glm::cross(p - a, side)) <= kMaxSag * length * length;
         });
}

}  // namespace

ViewDirection viewDirectionOf(std::span<const glm::vec3> points, std::span<const Triangle> triangles, int workers,
                              const std::atomic<bool>* interrupted) {
  auto area = [&](const Triangle& t) {
    const glm::dvec3 a = points[t[0]];
    return glm::cross(glm::dvec3(points[t[1]]) - a, glm::dvec3(points[t[2]]) - a);
  };
  // Summed in equal parts, in order, so that the result is the same for any number of workers.
  constexpr size_t kPart = size_t{1} << 16;
  struct Part {
    glm::dvec3 sum{0};
    double all = 0, hidden[2] = {0, 0};
  };
  std::vector<Part> parts((triangles.size() + kPart - 1) / kPart);
  auto forEachTriangle = [&](auto&& add) {
    parallelFor(parts.size(), workers, interrupted, [&](size_t i) {
      Part part = parts[i];
      for (size_t t = i * kPart; t < std::min(triangles.size(), (i + 1) * kPart); ++t) add(part, area(triangles[t]));
      parts[i] = part;
    });
  };
  forEachTriangle([](Part& part, const glm::dvec3& a) {
    part.sum += a;
    part.all += glm::length(a);
  });
  glm::dvec3 sum{0};
  double all = 0;
  for (const Part& part : parts) {
    sum += part.sum;
    all += part.all;
  }
  ViewDirection best;
  if (!(glm::length(sum) > 0)) return best;
  const glm::dvec3 size = glm::abs(sum);
  const int k = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
  glm::dvec3 axis{0};
  axis[k] = sum[k] > 0 ? 1 : -1;
  const glm::dvec3 directions[2] = {axis, glm::normalize(sum)};
  if (!isRelief({directions[1], 0, glm::length(sum) / all})) return {directions[1], 1, glm::length(sum) / all};
  forEachTriangle([&](Part& part, const glm::dvec3& a) {
    for (int d = 0; d < 2; ++d) part.hidden[d] += glm::dot(a, directions[d]) > 0 ? 0 : glm::length(a);
  });
  double hidden[2] = {0, 0};
  for (const Part& part : parts)
    for (int d = 0; d < 2; ++d) hidden[d] += part.hidden[d];
  const int d = hidden[0] <= hidden[1] ? 0 : 1;
  return {directions[d], hidden[d] / all, glm::dot(sum, directions[d]) / all};
}

QuadMesh sheetQuads(std::span<const FeatureCurve> curves, size_t pieces, const ScanSurface& scan, uint32_t patches,
                    uint32_t multiple) {
  QuadMesh m;
  if (pieces != 1 || curves.size() != 4) return m;
  for (size_t k = 0; k < 4; ++k) {
    if (!curves[k].border || curves[k].points.back() != curves[(k + 1) % 4].points.front() || !isStraight(curves[k]))
      return m;
  }
  const double width = (curves[0].length() + curves[2].length()) / 2,
               height = (curves[1].length() + curves[3].length()) / 2;
  uint32_t columns, rows;
  if (patches) {
    rows = std::max(1u, static_cast<uint32_t>(std::lround(std::sqrt(patches * height / width))));
    columns = std::max(1u, static_cast<uint32_t>(std::lround(static_cast<double>(patches) / rows)));
  } else {
    const double unit = std::min(width, height);
    columns = static_cast<uint32_t>(std::lround(std::min(width / unit, 256.0))) * multiple;
    rows = static_cast<uint32_t>(std::lround(std::min(height / unit, 256.0))) * multiple;
  }
  // The border runs counter-clockwise: along the bottom, up the right side, back along the top and down the left side.
  auto side = [&](size_t k, double t) { return curves[k].point((k < 2 ? t : 1 - t) * curves[k].length()); };
  const glm::dvec3 corner[4] = {side(0, 0), side(0, 1), side(2, 0), side(2, 1)};  // bottom left, right; top left, right
  const glm::dvec3 up = glm::cross(corner[3] - corner[0], corner[2] - corner[1]);
  const double size = glm::length(up);
  if (!(size > 0)) return m;
  for (uint32_t j = 0; j <= rows; ++j) {
    for (uint32_t i = 0; i <= columns; ++i) {
      const double s = static_cast<double>(i) / columns, t = static_cast<double>(j) / rows;
      // A Coons patch between the four sides (Coons 1967).
      glm::dvec3 p = side(0, s) * (1 - t) + side(2, s) * t + side(3, t) * (1 - s) + side(1, t) * s -
                     ((corner[0] * (1 - s) + corner[1] * s) * (1 - t) + (corner[2] * (1 - s) + corner[3] * s) * t);
      const bool left_or_right = i == 0 || i == columns, bottom_or_top = j == 0 || j == rows;
      if (!left_or_right && !bottom_or_top) {
        if (const SurfacePoint hit = scan.scene.nearestOnLine({p, up / size, 0.5}, Facing::kAlong)) p = scan.point(hit);
      }
      m.data(m.add_vertex(p)).fixed = left_or_right && bottom_or_top;
    }
  }
  auto at = [&](uint32_t i, uint32_t j) { return VertexHandle(static_cast<int>(j * (columns + 1) + i)); };
  for (uint32_t j = 0; j < rows; ++j) {
    for (uint32_t i = 0; i < columns; ++i) m.add_face(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
  }
  for (uint32_t k = 0; k < 4; ++k) {
    const uint32_t n = k % 2 ? rows : columns, across = k == 1 ? columns : k == 2 ? rows : 0;
    auto on = [&](uint32_t i) { return k % 2 ? at(across, i) : at(i, across); };
    auto along = [&](uint32_t i) { return curves[k].length() * (k < 2 ? i : n - i) / n; };
    for (uint32_t i = 0; i < n; ++i) setCurvePosition(m, on(i), on(i + 1), k, along(i), along(i + 1));
  }
  updateNormals(m);
  return m;
}

}  // namespace relievo
