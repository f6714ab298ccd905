// mesh_roots.cpp - see the header. Compiled without errno from sqrt, which would keep loops from becoming SIMD.
#include "geometry/lod/mesh_roots.h"

#include <bit>

#include "geometry/lod/desired_level.h"
#include "geometry/lod/facing_cone.h"
#include "src/base/simd_dispatch.h"

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
constexpr float kNowhere = -1e30f;     // a radius that is outside of every plane

struct Plane {
  float x, y, z, w;
};

// See packCone(). n: the byte from below.
inline float coneByte(uint32_t cone, int n) {
  return static_cast<float>(static_cast<int32_t>(cone << (24 - 8 * n)) >> 24) * (1.0f / 127);
}

}  // namespace

// A camera in floats.
struct MeshRoots::Eye {
  std::array<Plane, 6> planes;  // distances in mm, moved outwards by what floats of that size lose
  Plane depth{};                // perspective: mm ahead of the eye, moved the other way
  float x, y, z, lost;
  float ahead_x = 0, ahead_y = 0, ahead_z = 0;  // orthographic: where the eye looks
  float near_mm, scale, max_secant, error_px, max_node_px;
  std::array<float, kLevels> min_cell_px;
  int levels = kLevels;  // that are not careful

  template <bool kOrthographic>
  static Eye of(const LodCamera& camera, const RootView& view, double extent) {
    auto planeOf = [&](const glm::dvec4& row, bool outwards) {
      const double length = glm::length(glm::dvec3(row));
      // No direction: in front or behind alike.
      if (!(length > 1e-12 * std::abs(row.w))) return Plane{0, 0, 0, row.w >= 0 ? 1e30f : -1e30f};
      const double lost_mm = 4e-7 * (3 * extent + std::abs(row.w) / length);
      return Plane{static_cast<float>(row.x / length), static_cast<float>(row.y / length),
                   static_cast<float>(row.z / length),
                   static_cast<float>(row.w / length + (outwards ? lost_mm : -lost_mm))};
    };
    Eye e;
    for (size_t k = 0; k < e.planes.size(); ++k) e.planes[k] = planeOf(camera.planes[k], true);
    if (!kOrthographic) e.depth = planeOf(camera.depth_row, false);
    const Plane ahead = planeOf(camera.planes[4], true);
    e.ahead_x = ahead.x, e.ahead_y = ahead.y, e.ahead_z = ahead.z;
    e.x = static_cast<float>(camera.eye.x), e.y = static_cast<float>(camera.eye.y),
    e.z = static_cast<float>(camera.eye.z);
    e.lost = static_cast<float>(
        4e-7 * (extent + std::max({std::abs(camera.eye.x), std::abs(camera.eye.y), std::abs(camera.eye.z)})));
    e.near_mm = static_cast<float>(camera.near_mm) * kRoundUp, e.scale = static_cast<float>(camera.scale) * kRoundUp;
    e.max_secant = static_cast<float>(camera.max_secant) * kRoundUp, e.error_px = static_cast<float>(view.error_px);
    e.max_node_px = static_cast<float>(view.max_node_px);
    for (int k = 0; k < kLevels; ++k)
      e.min_cell_px[static_cast<size_t>(k)] = static_cast<float>(std::ldexp(view.min_cell_px, k + 1));
    if (!view.still) return e;
    // Cells of any width that geomorph may want (desired_level.h), and squares from which on it prepares to split them.
    e.levels = 1;
    e.max_node_px *= 0.5f;
    for (float& cell : e.min_cell_px) cell *= 0.25f;
    return e;
  }
  // Of a sphere, the least of the planes' distances.
  float inside(float px, float py, float pz) const {
    float least = 1e30f;
    for (const Plane& plane : planes) {
      const float at = plane.x * px + plane.y * py + plane.z * pz + plane.w;
      least = at < least ? at : least;
    }
    return least;
  }
  // Which way a cone's normals point, from a sphere at (dx, dy, dz) from the eye, `distance` away (rounded up): where
  // ahead > needed, backs alone are seen, where -ahead > needed, fronts alone.
  struct Facing {
    float ahead, needed;
  };
  template <bool kOrthographic>
  Facing facing(float dx, float dy, float dz, float distance, float radius, uint32_t cone) const {
    const float a = coneByte(cone, 0), b = coneByte(cone, 1), c = coneByte(cone, 2), sine = coneByte(cone, 3);
    const float far = kOrthographic ? 1.0f : distance, room = kOrthographic ? 0.0f : radius + lost;
    const float ahead = kOrthographic ? a * ahead_x + b * ahead_y + c * ahead_z : a * dx + b * dy + c * dz;
    return {ahead, sine < 0.995f ? sine * far + room : 1e30f};
  }
};

void MeshRoots::clear(size_t patches) {
  count_ = patches;
  blocks_ = (count_ + kBlock - 1) / kBlock;
  active_.reserve(blocks_);  // evaluateBlocks() may not allocate
  padded_ = blocks_ * kBlock;
  extent_ = 0;
  box_ = {glm::dvec3(1e300), glm::dvec3(-1e300)};
  auto resize = [](Spheres& s, size_t n) {
    for (auto* v : {&s.x, &s.y, &s.z, &s.longest}) v->assign(n, 0);
    s.radius.assign(n, kNowhere);
    s.cone.assign(n, packCone({}));
  };
  resize(of_patches_, padded_);
  resize(of_blocks_, blocks_);
  for (auto* of : {&errors_, &between_})
    for (auto& e : *of) e.assign(padded_, 0);
  across_.assign(padded_, {});
  px_per_mm_.assign(padded_, 0);
  codes_.assign(padded_, kCulled);
  block_state_.assign(blocks_, kSkipped);
  block_levels_.assign(blocks_, {0, 0});
  block_patch_radius_.assign(blocks_, 0);
  block_error_.assign(blocks_, 0);
  still_errors_.assign(padded_, 0);
  block_still_error_.assign(blocks_, 0);
  for (auto& list : lists_) list.resize(padded_);
}

void MeshRoots::prepare(MeshForest& forest, double exaggerate) {
  if (prepared_ && exaggerate == exaggerate_) return;
  const bool first = !prepared_;
  prepared_ = true;
  exaggerate_ = exaggerate;
  clear(forest.patchCount());
  if (first) closed_ = forest.isClosed();
  std::array<FacingCone, kBlock> cones;
  for (size_t b = 0; b < blocks_; ++b) {
    glm::dvec3 block_low(1e300), block_high(-1e300);
    const auto begin = static_cast<uint32_t>(b * kBlock),
               end = static_cast<uint32_t>(std::min<size_t>(count_, begin + kBlock));
    for (uint32_t p = begin; p < end; ++p) {
      const Square root{p, 0, 0, 0};
      const SquareHull hull = forest.hull(root, exaggerate);
      glm::dvec3 low = hull[0], high = low;
      for (const glm::dvec3& point : hull) low = glm::min(low, point), high = glm::max(high, point);
      const glm::vec3 centre(0.5 * (low + high));
      double radius = 0, longest = 0;
      for (const glm::dvec3& point : hull) radius = std::max(radius, glm::length(point - glm::dvec3(centre)));
      for (size_t a : {0, 4})
        for (auto [i, j] : {std::array<size_t, 2>{0, 1}, std::array<size_t, 2>{2, 3}, std::array<size_t, 2>{0, 2},
                            std::array<size_t, 2>{1, 3}})
          longest = std::max(longest, glm::length(hull[a + i] - hull[a + j]));
      of_patches_.x[p] = centre.x, of_patches_.y[p] = centre.y, of_patches_.z[p] = centre.z;
      of_patches_.radius[p] = static_cast<float>(radius) * kRoundUp;
      of_patches_.longest[p] = static_cast<float>(longest);
      extent_ = std::max({extent_, std::abs(double{centre.x}), std::abs(double{centre.y}), std::abs(double{centre.z})});
      PxPerMm any_view{1};
      any_view.turn = forest.normals(root).turn;
      for (size_t k = 0; k < kLevels; ++k) {
        const Deviation d = forest.deviation(root, static_cast<int>(k), exaggerate);
        errors_[k][p] = static_cast<float>(std::min(d.mm, 2 * radius)) * kRoundUp;
        between_[k][p] = static_cast<float>(std::min(any_view.between(d), 2 * radius)) * kRoundUp;
      }
      // Where finer grids are hardly better, geomorph begins before the error is reached.
      double plateau = 1;
      for (int k = 0; k <= std::min(kPageLog2, forest.unitLog2()); ++k, plateau *= kPlateau)
        still_errors_[p] = std::max(
            still_errors_[p],
            static_cast<float>(plateau * std::min(forest.deviation(root, k, exaggerate).mm, 2 * radius)) * kRoundUp);
      for (size_t side = 0; side < 4; ++side) {
        const PatchNeighbour& n = forest.patchNeighboursOf(p)[side];
        across_[p][side] = n.patch == PatchNeighbour::kNone ? p : n.patch;
      }
      cones[p - begin] = closed_ ? forest.facing(p, exaggerate) : FacingCone{};
      of_patches_.cone[p] = packCone(cones[p - begin]);
      block_low = glm::min(block_low, low), block_high = glm::max(block_high, high);
    }
    box_ = {glm::min(box_[0], block_low), glm::max(box_[1], block_high)};
    const glm::vec3 centre(0.5 * (block_low + block_high));
    of_blocks_.x[b] = centre.x, of_blocks_.y[b] = centre.y, of_blocks_.z[b] = centre.z;
    of_blocks_.cone[b] = packCone(joined(std::span(cones).first(end - begin)));
    double radius = 0;
    for (uint32_t p = begin; p < end; ++p) {
      const glm::dvec3 d(double{of_patches_.x[p]} - centre.x, double{of_patches_.y[p]} - centre.y,
                         double{of_patches_.z[p]} - centre.z);
      radius = std::max(radius, glm::length(d) + of_patches_.radius[p]);
      block_patch_radius_[b] = std::max(block_patch_radius_[b], of_patches_.radius[p]);
      of_blocks_.longest[b] = std::max(of_blocks_.longest[b], of_patches_.longest[p]);
      block_error_[b] = std::max(block_error_[b], errors_[kLevels - 1][p]);
      block_still_error_[b] = std::max(block_still_error_[b], still_errors_[p]);
    }
    of_blocks_.radius[b] = static_cast<float>(radius) * kRoundUp;
  }
  if (first) listAdjacentBlocks();
}

void MeshRoots::listAdjacentBlocks() {
  first_adjacent_.assign(1, 0);
  std::vector<uint32_t> of_block;
  for (size_t b = 0; b < blocks_; ++b) {
    of_block.clear();
    for (size_t p = b * kBlock; p < std::min(count_, (b + 1) * kBlock); ++p)
      for (uint32_t n : across_[p])
        if (n / kBlock != b) of_block.push_back(n / kBlock);
    std::sort(of_block.begin(), of_block.end());
    adjacent_.insert(adjacent_.end(), of_block.begin(), std::unique(of_block.begin(), of_block.end()));
    first_adjacent_.push_back(static_cast<uint32_t>(adjacent_.size()));
  }
}

bool MeshRoots::allBeyondNear(const glm::dvec4& near_row) const {
  const double length = glm::length(glm::dvec3(near_row));
  if (!(length > 0)) return false;
  const double lost = 4e-7 * (3 * extent_ + std::abs(near_row.w) / length);
  auto beyond = [&](const glm::dvec3& centre, double radius) {
    return LodCamera::value(near_row, centre) / length > radius + lost;
  };
  bool box = true;
  for (size_t k = 0; k < 8; ++k) box = box && beyond({box_[k & 1].x, box_[(k >> 1) & 1].y, box_[k >> 2].z}, 0);
  if (box) return true;
  for (size_t b = 0; b < blocks_; ++b) {
    if (beyond({of_blocks_.x[b], of_blocks_.y[b], of_blocks_.z[b]}, of_blocks_.radius[b])) continue;
    for (size_t p = b * kBlock; p < std::min(count_, (b + 1) * kBlock); ++p)
      if (!beyond({of_patches_.x[p], of_patches_.y[p], of_patches_.z[p]}, of_patches_.radius[p])) return false;
  }
  return true;
}

void MeshRoots::evaluate(const LodCamera& camera, const RootView& view) {
  backs_are_hidden_ = closed_ && allBeyondNear(camera.planes[4]);
  leaves_out_ = backs_are_hidden_ && view.hide_backs;
  if (camera.orthographic) evaluateAll<true>(camera, view);
  else evaluateAll<false>(camera, view);
}

template <bool kOrthographic>
void MeshRoots::evaluateAll(const LodCamera& camera, const RootView& view) {
  const Eye eye = Eye::of<kOrthographic>(camera, view, extent_);
  evaluateBlocks<kOrthographic>(eye);
  int any = 0;
  for (uint32_t b : active_) {
    const int state = block_state_[b];
    const bool cuts = (state & kCutsFrustum) != 0;
    if (state & kFacesAway) {
      any |= cuts ? evaluatePatches<kOrthographic, true, false>(eye, b)
                  : evaluatePatches<kOrthographic, false, false>(eye, b);
      for (size_t p = b * kBlock; p < (b + 1) * kBlock; ++p) codes_[p] |= kHidden;
    } else if (state & kMayFaceAway) {
      any |= cuts ? evaluatePatches<kOrthographic, true, true>(eye, b)
                  : evaluatePatches<kOrthographic, false, true>(eye, b);
    } else {
      any |= cuts ? evaluatePatches<kOrthographic, true, false>(eye, b)
                  : evaluatePatches<kOrthographic, false, false>(eye, b);
    }
  }
  any_careful_ = (any & kCareful) != 0;
}

template <bool kOrthographic>
RELIEVO_SIMD_CLONES void MeshRoots::evaluateBlocks(const Eye& eye) noexcept {
  const bool hide = leaves_out_;
  const float* x = of_blocks_.x.data();
  const float* y = of_blocks_.y.data();
  const float* z = of_blocks_.z.data();
  const float* radius = of_blocks_.radius.data();
  const float* longest = of_blocks_.longest.data();
  const uint32_t* cone = of_blocks_.cone.data();
  const float* patch_radius = block_patch_radius_.data();
  const float* error = (eye.levels == kLevels ? block_error_ : block_still_error_).data();
  uint8_t* states = block_state_.data();
  const int count = static_cast<int>(blocks_);
  int careful_backs = 0;
  RELIEVO_NO_LOOP_DEPENDENCE
  for (int b = 0; b < count; ++b) {
    const float r = radius[b], inside = eye.inside(x[b], y[b], z[b]);
    const float dx = x[b] - eye.x, dy = y[b] - eye.y, dz = z[b] - eye.z;
    const Eye::Facing facing =
        eye.facing<kOrthographic>(dx, dy, dz, std::sqrt(dx * dx + dy * dy + dz * dz) * kRoundUp, r, cone[b]);
    const int seen = inside >= -r, cuts = inside < r;
    const int hidden = static_cast<int>(hide) & static_cast<int>(facing.ahead > facing.needed);
    // May one of its patches be careful? Each is no nearer than the block's sphere.
    float depth_mm = 1, secant = 1;
    int careful = 0;
    if constexpr (!kOrthographic) {
      const float nearest = eye.depth.x * x[b] + eye.depth.y * y[b] + eye.depth.z * z[b] + eye.depth.w - r;
      careful = static_cast<int>(!(nearest > eye.near_mm)) |
                static_cast<int>(!(patch_radius[b] * kRoundUp < nearest * kSmallRadius));
      depth_mm = nearest > eye.near_mm ? nearest : eye.near_mm;
      secant = eye.max_secant;
    }
    const float px_per_mm = eye.scale / depth_mm * kRoundUp;
    careful |= static_cast<int>(!(longest[b] * px_per_mm < eye.max_node_px)) |
               static_cast<int>(!(error[b] * px_per_mm * secant * kRoundUp < eye.error_px));
    const int may_face = static_cast<int>(hide) & static_cast<int>(!(facing.ahead > facing.needed)) &
                         static_cast<int>(!(-facing.ahead > facing.needed));
    careful_backs |= seen & hidden & careful;
    const int state =
        kEvaluated | (cuts ? kCutsFrustum : 0) | (may_face ? kMayFaceAway : 0) | (hidden ? kFacesAway : 0);
    states[b] = static_cast<uint8_t>(seen ? state : kSkipped);
  }
  // Of what faces away, those next to others are looked at, for the levels of common edges. All of them, should some
  // become squares of a tree, which reach further.
  active_.clear();
  for (uint32_t b = 0; b < blocks_; ++b) {
    int state = states[b];
    if ((state & kFacesAway) && !careful_backs) {
      bool asked = false;
      for (uint32_t k = first_adjacent_[b]; k < first_adjacent_[b + 1] && !asked; ++k) {
        const int other = states[adjacent_[k]];
        asked = (other & kEvaluated) && !(other & kFacesAway);
      }
      if (!asked) state = kSkipped;
    }
    if (state != kSkipped) {
      active_.push_back(b);
      continue;
    }
    std::fill_n(codes_.begin() + b * kBlock, kBlock, static_cast<uint8_t>(kCulled));
    block_levels_[b] = {0, 0};
  }
}

template <bool kOrthographic, bool kCuts, bool kFacing>
RELIEVO_SIMD_CLONES int MeshRoots::evaluatePatches(const Eye& eye, size_t block) noexcept {
  const size_t first = block * kBlock;
  const float* x = of_patches_.x.data() + first;
  const float* y = of_patches_.y.data() + first;
  const float* z = of_patches_.z.data() + first;
  const float* radius = of_patches_.radius.data() + first;
  const float* longest = of_patches_.longest.data() + first;
  const uint32_t* cone = of_patches_.cone.data() + first;
  const float* e0 = (eye.levels == kLevels ? errors_[0] : still_errors_).data() + first;
  const float* e1 = errors_[1].data() + first;
  const float* e2 = errors_[2].data() + first;
  const float* e3 = errors_[3].data() + first;
  float* px_per_mm = px_per_mm_.data() + first;
  std::array<int32_t, kBlock> codes;
  int any = 0, least = kLevels, most = 0;
  RELIEVO_NO_LOOP_DEPENDENCE
  for (size_t p = 0; p < kBlock; ++p) {
    const float r = radius[p];
    int culled = r < 0;
    if constexpr (kCuts) culled |= static_cast<int>(eye.inside(x[p], y[p], z[p]) < -r);
    float nearest_px_per_mm = eye.scale, px = eye.scale;
    int careful = 0;
    const float dx = x[p] - eye.x, dy = y[p] - eye.y, dz = z[p] - eye.z;
    const float distance = kOrthographic ? 1.0f : std::sqrt(dx * dx + dy * dy + dz * dz) * kRoundUp;
    if constexpr (!kOrthographic) {
      const float ahead = eye.depth.x * x[p] + eye.depth.y * y[p] + eye.depth.z * z[p] + eye.depth.w,
                  nearest = ahead - r;
      const float depth_mm = nearest > eye.near_mm ? nearest : eye.near_mm;
      const float furthest = distance + r + eye.lost;
      nearest_px_per_mm = eye.scale / depth_mm;
      const float secant = furthest / depth_mm;
      px = nearest_px_per_mm * (secant < eye.max_secant ? secant : eye.max_secant);
      careful = static_cast<int>(!(r < ahead * kSmallRadius)) | static_cast<int>(!(nearest > eye.near_mm));
    }
    const float allowed_mm = eye.error_px / px;
    const float cell_px = longest[p] * nearest_px_per_mm;
    auto wants = [&](const float* error, size_t k) {
      float cells = error[p] > 4 * allowed_mm ? 0.5f : 1.0f;  // leastCellPx()
      cells = error[p] > 16 * allowed_mm ? 0.25f : cells;
      return static_cast<int>(error[p] > allowed_mm) & static_cast<int>(cell_px > cells * eye.min_cell_px[k]);
    };
    const int level = wants(e0, 0) + wants(e1, 1) + wants(e2, 2) + wants(e3, 3);
    careful |= static_cast<int>(level >= eye.levels) | static_cast<int>(!(cell_px <= eye.max_node_px));
    int hidden = 0;
    if constexpr (kFacing) {
      const Eye::Facing facing = eye.facing<kOrthographic>(dx, dy, dz, distance, r, cone[p]);
      hidden = facing.ahead > facing.needed ? kHidden : 0;
    }
    const int code = culled ? kCulled : (careful ? kCareful : level) | hidden;
    px_per_mm[p] = px;
    codes[p] = code;
    any |= code;
    const int wanted = code & kLevel;
    least = wanted < least ? wanted : least;
    most = wanted > most ? wanted : most;
  }
  block_levels_[block] = {static_cast<uint8_t>(least), static_cast<uint8_t>(most)};
  uint8_t* out = codes_.data() + first;
  for (size_t p = 0; p < kBlock; ++p) out[p] = static_cast<uint8_t>(codes[p]);
  return any;
}

RELIEVO_SIMD_CLONES void MeshRoots::levelEdges() noexcept {
  const uint8_t* all_codes = codes_.data();
  std::array<Drawn*, kMaxGridLevel + 2> next;  // the last: not drawn
  std::array<Drawn, kBlock> nowhere;
  for (size_t n = 0; n <= kMaxGridLevel; ++n) next[n] = lists_[n].data();
  int32_t worst = 0;  // the bits of a float not below 0 grow with it
  for (uint32_t b : active_) {
    if (block_state_[b] & kFacesAway) continue;
    const size_t first = size_t{b} * kBlock;
    const uint8_t* codes = all_codes + first;
    const float* px_per_mm = px_per_mm_.data() + first;
    // Most blocks want one level, and those around them no more: no need to look across each side.
    const auto [lowest, highest] = block_levels_[b];
    bool alike = lowest == highest;
    for (uint32_t k = first_adjacent_[b]; k < first_adjacent_[b + 1]; ++k)
      alike = alike & (block_levels_[adjacent_[k]][1] <= lowest);
    if (alike) {
      const float* error = errors_[lowest].data() + first;
      int32_t block_worst = 0, any = 0, all = 0xFF;
      for (size_t p = 0; p < kBlock; ++p) {
        const int code = codes[p];
        const int32_t bits = code & kNotShown ? 0 : std::bit_cast<int32_t>(error[p] * px_per_mm[p]);
        block_worst = block_worst > bits ? block_worst : bits;
        any |= code;
        all &= code;
      }
      worst = worst > block_worst ? worst : block_worst;
      Drawn*& to = next[lowest];
      const uint32_t segments = lowest * 0x01010101u;
      if (!(any & kNotShown)) {
        for (uint32_t p = 0; p < kBlock; ++p) to[p] = {static_cast<uint32_t>(first) + p, segments};
        to += kBlock;
        continue;
      }
      if (all & kNotShown) continue;
      for (uint32_t p = 0; p < kBlock; ++p)
        if (!(codes[p] & kNotShown)) *to++ = {static_cast<uint32_t>(first) + p, segments};
      continue;
    }
    const std::array<uint32_t, 4>* across = across_.data() + first;
    std::array<uint32_t, kBlock> theirs;
    for (size_t p = 0; p < kBlock; ++p) {
      const auto& n = across[p];
      theirs[p] = static_cast<uint32_t>(all_codes[n[0]]) | static_cast<uint32_t>(all_codes[n[1]]) << 8 |
                  static_cast<uint32_t>(all_codes[n[2]]) << 16 | static_cast<uint32_t>(all_codes[n[3]]) << 24;
    }
    const float* e0 = errors_[0].data() + first;
    const float* e1 = errors_[1].data() + first;
    const float* e2 = errors_[2].data() + first;
    const float* e3 = errors_[3].data() + first;
    const float* b0 = between_[0].data() + first;
    const float* b1 = between_[1].data() + first;
    const float* b2 = between_[2].data() + first;
    std::array<int32_t, kBlock> own_codes, grids;
    for (size_t p = 0; p < kBlock; ++p) own_codes[p] = codes[p];
    std::array<uint32_t, kBlock> segments;
    int32_t block_worst = 0, least = kMaxGridLevel + 1, most = 0;
    for (size_t p = 0; p < kBlock; ++p) {
      const int own = own_codes[p] & kLevel, shown = (own_codes[p] & kNotShown) == 0;
      auto larger = [](int u, int v) { return u > v ? u : v; };
      auto smaller = [](int u, int v) { return u < v ? u : v; };
      auto level = [&](int shift) { return larger(own, static_cast<int>(theirs[p] >> shift) & kLevel); };
      const int a = level(0), bb = level(8), c = level(16), d = level(24);
      const int finest = larger(larger(a, bb), larger(c, d)), coarsest = smaller(smaller(a, bb), smaller(c, d));
      // One select after another: chains of them would become branches.
      float at_finest = e0[p], at_coarsest = b0[p];
      at_finest = finest > 0 ? e1[p] : at_finest;
      at_finest = finest > 1 ? e2[p] : at_finest;
      at_finest = finest > 2 ? e3[p] : at_finest;
      at_coarsest = coarsest > 0 ? b1[p] : at_coarsest;
      at_coarsest = coarsest > 1 ? b2[p] : at_coarsest;
      const float snapped = coarsest < finest ? at_coarsest : 0.0f;
      const float error_px = (at_finest > snapped ? at_finest : snapped) * px_per_mm[p];
      const int32_t bits = shown ? std::bit_cast<int32_t>(error_px) : 0;
      block_worst = larger(block_worst, bits);
      segments[p] = static_cast<uint32_t>(a | bb << 8 | c << 16 | d << 24);
      const int grid = shown ? finest : kMaxGridLevel + 1;
      grids[p] = grid;
      least = smaller(least, grid);
      most = larger(most, grid);
    }
    worst = worst > block_worst ? worst : block_worst;
    const auto patch = static_cast<uint32_t>(first);
    if (least == most) {
      if (most > kMaxGridLevel) continue;
      Drawn* to = next[static_cast<size_t>(most)];
      for (uint32_t p = 0; p < kBlock; ++p) to[p] = {patch + p, segments[p]};
      next[static_cast<size_t>(most)] = to + kBlock;
      continue;
    }
    next[kMaxGridLevel + 1] = nowhere.data();
    for (uint32_t p = 0; p < kBlock; ++p) *next[static_cast<size_t>(grids[p])]++ = {patch + p, segments[p]};
  }
  max_error_px_ = std::bit_cast<float>(worst);
  for (size_t n = 0; n <= kMaxGridLevel; ++n) drawn_[n] = static_cast<size_t>(next[n] - lists_[n].data());
}

}  // namespace relievo
