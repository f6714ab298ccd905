// mesh_roots.cpp - see the header. Compiled without errno from sqrt, which would keep the loop from becoming SIMD.
#include "geometry/mesh_roots.h"

#include <bit>

// What the following loop writes, none of its other turns reads.
#if defined(__GNUC__) && !defined(__clang__)
#define RELIEVO_NO_LOOP_DEPENDENCE _Pragma("GCC ivdep")
#else
#define RELIEVO_NO_LOOP_DEPENDENCE
#endif

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
  for (auto& a : across_) a.resize(count_);
  for (auto* v : {&segments_, &grid_, &order_}) v->resize(count_);
  codes_.resize(count_);
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
      across_[side][p] = n.patch == PatchNeighbour::kNone ? p : n.patch;
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
  for (int k = 0; k < kLevels; ++k) min_cell_px[static_cast<size_t>(k)] = static_cast<float>(std::ldexp(view.min_cell_px, k + 1));
  const float* x = x_.data();
  const float* y = y_.data();
  const float* z = z_.data();
  const float* radius = radius_.data();
  const float* longest = longest_.data();
  const float* e0 = errors_[0].data();
  const float* e1 = errors_[1].data();
  const float* e2 = errors_[2].data();
  const float* e3 = errors_[3].data();
  const float* e4 = errors_[4].data();
  float* px_per_mm = px_per_mm_.data();
  int32_t* codes = codes_.data();
  const int count = static_cast<int>(count_);
  RELIEVO_NO_LOOP_DEPENDENCE
  for (int p = 0; p < count; ++p) {
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
    auto wants = [&](const float* error, size_t k) {
      float least = error[p] > 4 * allowed_mm ? 0.5f : 1.0f;  // leastCellPx()
      least = error[p] > 16 * allowed_mm ? 0.25f : least;
      return static_cast<int>(error[p] > allowed_mm) & static_cast<int>(cell_px > least * min_cell_px[k]);
    };
    const int level = wants(e0, 0) + wants(e1, 1) + wants(e2, 2) + wants(e3, 3) + wants(e4, 4);
    careful |= static_cast<int>(level == kLevels) | static_cast<int>(!(cell_px <= max_node_px));
    const int code = culled ? kCulled : careful ? kCareful : level;
    px_per_mm[p] = culled ? 0 : px;
    codes[p] = code;
  }
}

void MeshRoots::levelEdges() {
  const float* e0 = errors_[0].data();
  const float* e1 = errors_[1].data();
  const float* e2 = errors_[2].data();
  const float* e3 = errors_[3].data();
  const float* e4 = errors_[4].data();
  const float* radius = radius_.data();
  const float* px_per_mm = px_per_mm_.data();
  const int32_t* codes = codes_.data();
  const uint32_t *left = across_[0].data(), *right = across_[1].data(), *top = across_[2].data(), *bottom = across_[3].data();
  uint32_t* segments = segments_.data();
  uint32_t* grid = grid_.data();
  const int count = static_cast<int>(count_);
  auto* error_bits = reinterpret_cast<int32_t*>(order_.data());  // room that is free as yet; the bits of a float not below 0 grow with it
  RELIEVO_NO_LOOP_DEPENDENCE
  for (int p = 0; p < count; ++p) {
    const int own = codes[p] & kLevel, shown = (codes[p] & (kCulled | kCareful | kOthers)) == 0;
    auto larger = [](int a, int b) { return a > b ? a : b; };
    auto smaller = [](int a, int b) { return a < b ? a : b; };
    const int a = larger(own, codes[left[p]] & kLevel), b = larger(own, codes[right[p]] & kLevel), c = larger(own, codes[top[p]] & kLevel),
              d = larger(own, codes[bottom[p]] & kLevel);
    const int finest = larger(larger(a, b), larger(c, d)), coarsest = smaller(smaller(a, b), smaller(c, d));
    // One select after another: chains of them would become branches.
    float at_finest = e0[p], at_coarsest = e0[p];
    at_finest = finest > 0 ? e1[p] : at_finest;
    at_finest = finest > 1 ? e2[p] : at_finest;
    at_finest = finest > 2 ? e3[p] : at_finest;
    at_finest = finest > 3 ? e4[p] : at_finest;
    at_coarsest = coarsest > 0 ? e1[p] : at_coarsest;
    at_coarsest = coarsest > 1 ? e2[p] : at_coarsest;
    at_coarsest = coarsest > 2 ? e3[p] : at_coarsest;
    at_coarsest = coarsest > 3 ? e4[p] : at_coarsest;
    // Where vertices snapped, see mesh_lod.cpp.
    const float doubled = 2 * (at_coarsest < radius[p] ? at_coarsest : radius[p]), snapped = coarsest < finest ? doubled : 0.0f;
    const float error_px = (at_finest > snapped ? at_finest : snapped) * px_per_mm[p];
    const int32_t bits = shown ? std::bit_cast<int32_t>(error_px) : 0;
    error_bits[p] = bits;
    segments[p] = static_cast<uint32_t>(a | b << 8 | c << 16 | d << 24);
    grid[p] = static_cast<uint32_t>(shown ? finest : kMaxGridLevel + 1);
  }
  int32_t worst = 0;
  std::array<uint32_t, kMaxGridLevel + 2> counts{};
  for (int p = 0; p < count; ++p) worst = worst > error_bits[p] ? worst : error_bits[p];
  max_error_px_ = std::bit_cast<float>(worst);
  for (uint32_t n = 0; n < counts.size(); ++n) {
    uint32_t of_level = 0;
    for (int p = 0; p < count; ++p) of_level += grid[p] == n;
    counts[n] = of_level;
  }
  first_.fill(0);
  for (size_t n = 0; n < counts.size(); ++n) first_[n + 1] = counts[n];
  for (size_t n = 1; n < first_.size(); ++n) first_[n] += first_[n - 1];
  std::array<size_t, kMaxGridLevel + 3> next = first_;
  uint32_t* order = order_.data();
  for (int p = 0; p < count; ++p) order[next[grid[p]]++] = static_cast<uint32_t>(p);
}

}  // namespace relievo
