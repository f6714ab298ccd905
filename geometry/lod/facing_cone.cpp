#include "geometry/lod/facing_cone.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace relievo {
namespace {

// Of sines: what fp32 vertices and a rasteriser's fixed point may turn a triangle by, and the rounding of axes that are
// not.
constexpr double kSlack = 0.01;

struct Range {
  double low = 0, high = 0;
  void add(double x) { low = std::min(low, x), high = std::max(high, x); }
  double largest() const { return std::max(std::abs(low), std::abs(high)); }
};
Range operator+(const Range& a, const Range& b) { return {a.low + b.low, a.high + b.high}; }
Range operator-(const Range& a, const Range& b) { return {a.low - b.high, a.high - b.low}; }
Range operator*(const Range& a, const Range& b) {
  const auto [low, high] = std::minmax({a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high});
  return {low, high};
}

}  // namespace

FacingCone facingCone(const BaseMesh& mesh, uint32_t patch, double min_mm, double max_mm, const HeightSlopes& slopes) {
  std::array<glm::dvec3, 4> p, n;
  for (size_t k = 0; k < 4; ++k) {
    p[k] = mesh.corners[mesh.patches[patch][k]].position_mm;
    n[k] = mesh.corners[mesh.patches[patch][k]].normal;
  }
  const glm::dvec3 along_u = (p[1] - p[0]) + (p[3] - p[2]), along_v = (p[2] - p[0]) + (p[3] - p[1]),
                   out = glm::cross(along_v, along_u);
  const double length_u = glm::length(along_u), area = glm::length(out);
  if (!(area > 0) || !(length_u > 0)) return {};
  const glm::dvec3 axis = out / area, x = along_u / length_u, y = glm::cross(axis, x);
  const std::array<glm::dvec3, 3> frame{x, y, axis};
  const Range height{min_mm, max_mm};
  std::array<Range, 3> u, v;
  for (size_t k = 0; k < 3; ++k) {
    auto at = [&](const glm::dvec3& q) { return glm::dot(q, frame[k]); };
    auto of = [&](const glm::dvec3& a, const glm::dvec3& b) {
      Range r{at(a), at(a)};
      r.add(at(b));
      return r;
    };
    Range normal = of(n[0], n[1]);
    normal.add(at(n[2]));
    normal.add(at(n[3]));
    u[k] = of(p[1] - p[0], p[3] - p[2]) + Range{slopes.min_u, slopes.max_u} * normal +
           height * of(n[1] - n[0], n[3] - n[2]);
    v[k] = of(p[2] - p[0], p[3] - p[1]) + Range{slopes.min_v, slopes.max_v} * normal +
           height * of(n[2] - n[0], n[3] - n[1]);
  }
  // v x u, outwards.
  const double ahead = (v[0] * u[1] - v[1] * u[0]).low;
  const double aside = std::hypot((v[1] * u[2] - v[2] * u[1]).largest(), (v[2] * u[0] - v[0] * u[2]).largest());
  if (!(ahead > 0) || !std::isfinite(aside)) return {};
  return {axis, aside / std::hypot(ahead, aside) + kSlack};
}

FacingCone joined(std::span<const FacingCone> cones) {
  FacingCone all;
  for (const FacingCone& c : cones) {
    if (!(c.sine < 1)) return {};
    all.axis += c.axis;
  }
  const double length = glm::length(all.axis);
  if (!(length > 0)) return {};
  all.axis /= length;
  double angle = 0;
  for (const FacingCone& c : cones)
    angle = std::max(angle, std::acos(std::clamp(glm::dot(c.axis, all.axis), -1.0, 1.0)) + std::asin(c.sine));
  all.sine = angle < 1.57 ? std::sin(angle) + kSlack : 2;
  return all;
}

uint32_t packCone(const FacingCone& cone) {
  constexpr uint32_t kUnknown = 127u << 24;
  if (!(cone.sine < 1)) return kUnknown;
  uint32_t bytes = 0;
  glm::dvec3 axis;
  for (int k = 0; k < 3; ++k) {
    const auto q = static_cast<int>(std::lround(cone.axis[k] * 127));
    axis[k] = q / 127.0;
    bytes |= (static_cast<uint32_t>(q) & 0xFF) << (8 * k);
  }
  const double sine = std::ceil((cone.sine + glm::length(axis - cone.axis)) * 127);
  return sine < 127 ? bytes | static_cast<uint32_t>(sine) << 24 : kUnknown;
}

bool isClosedBody(const BaseMesh& mesh, std::span<const PatchNeighbours> neighbours) {
  // Around the patch with u to the right and v down, clockwise, a side runs along its parameter or against it.
  constexpr std::array<bool, 4> kAlong{false, true, true, false};
  std::vector<uint32_t> part(mesh.patches.size());
  std::iota(part.begin(), part.end(), 0u);
  auto find = [&](uint32_t i) {
    while (part[i] != i) i = part[i] = part[part[i]];
    return i;
  };
  for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
    for (size_t side = 0; side < 4; ++side) {
      const PatchNeighbour& n = neighbours[p][side];
      if (n.patch == PatchNeighbour::kNone) return false;
      if ((kAlong[side] != kAlong[static_cast<size_t>(n.side)]) == n.reversed)
        return false;  // both walk it the same way
      part[find(p)] = find(n.patch);
    }
  }
  std::vector<double> volume(mesh.patches.size());
  const glm::dvec3 origin = mesh.corners[mesh.patches[0][0]].position_mm;
  for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
    auto at = [&](size_t k) { return glm::dvec3(mesh.corners[mesh.patches[p][k]].position_mm) - origin; };
    // Triangles (0,0), (1,1), (1,0) and (0,0), (0,1), (1,1): outwards counter-clockwise.
    volume[find(p)] += glm::dot(at(0), glm::cross(at(3), at(1))) + glm::dot(at(0), glm::cross(at(2), at(3)));
  }
  for (uint32_t p = 0; p < mesh.patches.size(); ++p)
    if (find(p) == p && !(volume[p] > 0)) return false;
  return true;
}

}  // namespace relievo
