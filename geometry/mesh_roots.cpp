// mesh_roots.cpp - see the header. Compiled without errno from sqrt, which would keep the loop from becoming SIMD.
#include "geometry/mesh_roots.h"

namespace relievo {
namespace {

// Of the sphere's distance: above it, the parts of the patch differ too much in what a millimetre is on the screen.
constexpr float kSmallRadius = 1.0f / 16;
constexpr float kRoundUp = 1 + 1e-5f;  // what sums and products of floats may have lost

}  // namespace

void MeshRoots::prepare(MeshForest& forest, double exaggerate) {
  if (prepared_ && exaggerate == exaggerate_) return;
  prepared_ = true;
  exaggerate_ = exaggerate;
  count_ = forest.patchCount();
  extent_ = 0;
  for (auto* v : {&x_, &y_, &z_, &radius_, &longest_, &px_per_mm_}) v->resize(count_);
  for (auto& e : errors_) e.resize(count_);
  codes_.resize(count_);
  neighbours_.resize(count_);
  for (uint32_t p = 0; p < count_; ++p) {
    const Square root{p, 0, 0, 0};
    const SquareHull hull = forest.hull(root, exaggerate);
    glm::dvec3 low = hull[0], high = low;
    for (const glm::dvec3& point : hull) low = glm::min(low, point), high = glm::max(high, point);
    const glm::vec3 centre(0.5 * (low + high));
    double radius = 0, longest = 0;
    for (const glm::dvec3& point : hull) radius = std::max(radius, glm::length(point - glm::dvec3(centre)));
    for (size_t a : {0, 4})
      for (auto [i, j] : {std::array<size_t, 2>{0, 1}, std::array<size_t, 2>{2, 3}, std::array<size_t, 2>{0, 2}, std::array<size_t, 2>{1, 3}})
        longest = std::max(longest, glm::length(hull[a + i] - hull[a + j]));
    x_[p] = centre.x, y_[p] = centre.y, z_[p] = centre.z;
    radius_[p] = static_cast<float>(radius) * kRoundUp;
    longest_[p] = static_cast<float>(longest);
    extent_ = std::max({extent_, std::abs(double{centre.x}), std::abs(double{centre.y}), std::abs(double{centre.z})});
    for (int k = 0; k < kLevels; ++k)
      errors_[static_cast<size_t>(k)][p] = static_cast<float>(std::min(forest.error(root, k, exaggerate), 2 * radius)) * kRoundUp;
    for (size_t side = 0; side < 4; ++side) {
      const PatchNeighbour& n = forest.patchNeighboursOf(p)[side];
      neighbours_[p][side] = n.patch == PatchNeighbour::kNone ? p : n.patch;
    }
  }
}

void MeshRoots::evaluate(const LodCamera& camera, const RootView& view) {
  if (camera.orthographic) evaluateAll<true>(camera, view);
  else evaluateAll<false>(camera, view);
}

template <bool kOrthographic>
void MeshRoots::evaluateAll(const LodCamera& camera, const RootView& view) {
  struct Plane {
    float x, y, z, w;
  };
  // Distances in mm, moved outwards by what floats of that size lose.
  const double eye_extent = std::max({std::abs(camera.eye.x), std::abs(camera.eye.y), std::abs(camera.eye.z)});
  auto planeOf = [&](const glm::dvec4& row, bool outwards) {
    const double length = glm::length(glm::dvec3(row));
    // No direction: in front or behind alike.
    if (!(length > 1e-12 * std::abs(row.w))) return Plane{0, 0, 0, row.w >= 0 ? 1e30f : -1e30f};
    const double lost = 4e-7 * (3 * extent_ + std::abs(row.w) / length);
    return Plane{static_cast<float>(row.x / length), static_cast<float>(row.y / length), static_cast<float>(row.z / length),
                 static_cast<float>(row.w / length + (outwards ? lost : -lost))};
  };
  std::array<Plane, 7> planes;
  for (size_t k = 0; k < planes.size(); ++k) planes[k] = planeOf(camera.planes[k], true);
  const Plane depth = kOrthographic ? Plane{} : planeOf(camera.depth_row, false);
  const float ex = static_cast<float>(camera.eye.x), ey = static_cast<float>(camera.eye.y), ez = static_cast<float>(camera.eye.z);
  const float lost = static_cast<float>(4e-7 * (extent_ + eye_extent));
  const float near_mm = static_cast<float>(camera.near_mm) * kRoundUp, scale = static_cast<float>(camera.scale) * kRoundUp,
              max_secant = static_cast<float>(camera.max_secant) * kRoundUp, error_px = static_cast<float>(view.error_px),
              max_node_px = static_cast<float>(view.max_node_px);
  std::array<float, kLevels> min_cell_px;
  for (int k = 0; k < kLevels; ++k) min_cell_px[static_cast<size_t>(k)] = static_cast<float>(std::ldexp(view.min_cell_px, k));
  const float* __restrict x = x_.data();
  const float* __restrict y = y_.data();
  const float* __restrict z = z_.data();
  const float* __restrict radius = radius_.data();
  const float* __restrict longest = longest_.data();
  const float* __restrict e0 = errors_[0].data();
  const float* __restrict e1 = errors_[1].data();
  const float* __restrict e2 = errors_[2].data();
  const float* __restrict e3 = errors_[3].data();
  const float* __restrict e4 = errors_[4].data();
  float* __restrict px_per_mm = px_per_mm_.data();
  uint8_t* __restrict codes = codes_.data();
  for (size_t p = 0; p < count_; ++p) {
    const float r = radius[p];
    float inside = 1e30f;
    for (const Plane& plane : planes) {
      const float at = plane.x * x[p] + plane.y * y[p] + plane.z * z[p] + plane.w;
      inside = at < inside ? at : inside;
    }
    const int culled = inside < -r;
    float nearest_px_per_mm = scale, px = scale;
    int careful = 0;
    if constexpr (!kOrthographic) {
      const float ahead = depth.x * x[p] + depth.y * y[p] + depth.z * z[p] + depth.w, nearest = ahead - r;
      const float depth_mm = nearest > near_mm ? nearest : near_mm;
      const float dx = x[p] - ex, dy = y[p] - ey, dz = z[p] - ez;
      const float furthest = std::sqrt(dx * dx + dy * dy + dz * dz) * kRoundUp + r + lost;
      nearest_px_per_mm = scale / depth_mm;
      const float secant = furthest / depth_mm;
      px = nearest_px_per_mm * (secant < max_secant ? secant : max_secant);
      careful = static_cast<int>(!(r < ahead * kSmallRadius)) | static_cast<int>(!(nearest > near_mm));
    }
    const float allowed_mm = error_px / px;
    const float cell_px = longest[p] * nearest_px_per_mm;
    auto wants = [&](const float* error, size_t k) { return static_cast<int>(error[p] > allowed_mm) & static_cast<int>(cell_px > min_cell_px[k]); };
    const int level = wants(e0, 0) + wants(e1, 1) + wants(e2, 2) + wants(e3, 3) + wants(e4, 4);
    careful |= static_cast<int>(level == kLevels) | static_cast<int>(!(cell_px <= max_node_px));
    const int code = culled ? kCulled : careful ? kCareful : level;
    px_per_mm[p] = culled ? 0 : px;
    codes[p] = static_cast<uint8_t>(code);
  }
}

}  // namespace relievo
