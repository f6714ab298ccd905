// lod_common.h - what the LOD selections of flat artworks and of base meshes share: the view in numbers, errors of a
// page's parts. Internal to geometry/.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/lod/lod.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

inline constexpr int kPageLog2 = 7;  // kPagePx cells a relief page's side
static_assert(1 << kPageLog2 == kPagePx);
inline constexpr size_t kMaxLodNodes = 20000;  // nodes below the roots
inline constexpr double kMaxNodePx = 1024;     // keeps a node's varyings exact to a small part of a texel in fp32
// LodView::min_cell_px where the error is so many times what was asked for: walls, which are few, may have narrower
// cells, or their rims would look like combs.
inline double leastCellPx(double min_cell_px, double error_over_budget) {
  return error_over_budget > 16 ? 0.25 * min_cell_px : error_over_budget > 4 ? 0.5 * min_cell_px : min_cell_px;
}

inline constexpr int kMaxSplitLevel =
    kMaxGridLevel - 1;                            // above it a node splits; the last level is for sides of half edges
inline constexpr int kRequestAncestorStride = 3;  // wants keep every third page above the wanted one
inline constexpr double kMinErrorPx = 1.0 / 64;
inline constexpr double kMinSine =
    1.0 / 32;  // of the angle between a normal and the line of sight, in the error metric

// Of the parts of 2^depth a side in PartErrors.
constexpr int firstPart(int depth) { return ((1 << (2 * depth)) - 4) / 3; }

// One part of a page or of a patch's grid.
struct PartError {
  float mm = 0;
  DeviationShape shape;
  Deviation deviation() const { return deviationOf(mm, shape); }
};
// As an oracle tells it; whole_mm: what unknown, impossible and larger errors count for.
inline PartError partError(float whole_mm, float mm, const DeviationShape& shape) {
  if (mm >= 0 && mm <= whole_mm) return {mm, shape};
  if (!(mm >= 0 && std::isfinite(mm))) return {whole_mm, {}};
  Deviation d = deviationOf(mm, shape);
  d.mm = whole_mm;
  return {whole_mm, shapeOf(d)};
}
// Around four of them.
inline PartError joined(const PartError& a, const PartError& b, const PartError& c, const PartError& d) {
  const Deviation all = joined(joined(a.deviation(), b.deviation()), joined(c.deviation(), d.deviation()));
  return {std::max({a.mm, b.mm, c.mm, d.mm}), shapeOf(all)};
}

// A page's errors by parts: level after level of ever smaller ones, the coarsest four first.
class PartErrors {
 public:
  // whole_mm: of the page, what unknown and impossible parts count for.
  void read(const ReliefOracle& oracle, const NodeId& page, float whole_mm) {
    constexpr size_t kBlocks = size_t{1} << (2 * kErrorBlocksLog2);
    std::array<float, kBlocks> mm;
    std::array<DeviationShape, kBlocks> shapes;
    const bool known = oracle.errorBlocks(page, mm), shaped = known && oracle.errorShapes(page, shapes);
    PartError* finest = parts_.data() + firstPart(kErrorBlocksLog2);
    for (size_t i = 0; i < kBlocks; ++i)
      finest[i] = partError(whole_mm, known ? mm[i] : -1, shaped ? shapes[i] : DeviationShape{});
    for (int depth = kErrorBlocksLog2 - 1; depth > 0; --depth) {
      const PartError* finer = parts_.data() + firstPart(depth + 1);
      PartError* at = parts_.data() + firstPart(depth);
      const int side = 1 << depth;
      for (int y = 0; y < side; ++y)
        for (int x = 0; x < side; ++x) {
          const PartError* q = finer + 4 * y * side + 2 * x;
          at[y * side + x] = joined(q[0], q[1], q[2 * side], q[2 * side + 1]);
        }
    }
  }
  // Part (x, y) of 2^depth a side, 1 <= depth <= kErrorBlocksLog2.
  const PartError& at(int depth, int64_t x, int64_t y) const {
    return parts_[static_cast<size_t>(firstPart(depth) + (y << depth) + x)];
  }

 private:
  std::array<PartError, firstPart(kErrorBlocksLog2 + 1)> parts_;
};

// A LodView in the numbers that selections work with.
struct LodCamera {
  static constexpr double kCullSlack =
      1.0 / 512;  // of the screen: the GPU's fp32 may move what doubles put just outside
  bool valid = false, orthographic = false;
  glm::dvec3 eye{0};
  double near_mm = 1, scale = 1;       // pixels per radian; orthographic: per mm
  double least_sine = kMinSine;        // that a move of the surface counts with, whichever way it points
  double max_secant = 1;               // of the angle off the axis, in the picture's corner
  std::array<glm::dvec4, 7> planes{};  // value < 0: outside
  std::array<glm::dvec4, 4> clip_rows{};
  glm::dvec4 depth_row{0};       // perspective: mm ahead of the eye
  glm::dvec3 forward{0, 0, -1};  // of length 1; orthographic: either way along it

  LodCamera() = default;
  explicit LodCamera(const LodView& view) {
    eye = view.eye_mm;
    near_mm = view.near_mm > 1e-9 ? view.near_mm : 1e-9;
    scale = view.pixels_per_radian;
    if (view.any_direction) least_sine = 1;
    glm::dmat4 rows = glm::transpose(view.clip_from_world);
    valid = finite(rows) && std::isfinite(scale) && scale > 0 && std::isfinite(near_mm) && std::isfinite(eye.x) &&
            std::isfinite(eye.y) && std::isfinite(eye.z);
    if (!valid) return;
    double w_length = glm::length(glm::dvec3(rows[3]));
    orthographic = w_length <= 1e-12 * std::abs(rows[3].w);
    planes = {rows[3] * (1 + kCullSlack) + rows[0],
              rows[3] * (1 + kCullSlack) - rows[0],
              rows[3] * (1 + kCullSlack) + rows[1],
              rows[3] * (1 + kCullSlack) - rows[1],
              rows[3] + rows[2],
              rows[3] - rows[2],
              rows[3]};
    for (int i = 0; i < 4; ++i) clip_rows[i] = rows[i];
    valid = orthographic ? rows[3].w > 0 : w_length > 0;
    if (orthographic) {
      const glm::dvec3 along = glm::cross(glm::dvec3(rows[0]), glm::dvec3(rows[1]));
      if (const double length = glm::length(along); length > 0) forward = along / length;
    }
    if (orthographic || !valid) return;
    depth_row = rows[3] / w_length;
    forward = glm::dvec3(depth_row);
    // The largest secant in the picture: its corner. An off-centre row is a side part and a forward part.
    auto tangent = [&](const glm::dvec4& row) {
      glm::dvec3 r = glm::dvec3(row) / w_length;
      double ahead = glm::dot(r, forward), aside = glm::length(r - ahead * forward);
      return aside > 1e-9 ? (1 + std::abs(ahead)) / aside : 1e9;
    };
    double tx = tangent(rows[0]), ty = tangent(rows[1]);
    max_secant = std::sqrt(1 + tx * tx + ty * ty);
  }
  static double value(const glm::dvec4& row, const glm::dvec3& p) {
    return row.x * p.x + row.y * p.y + row.z * p.z + row.w;
  }
  // 0 in the picture's middle, 1 in its corner and beyond.
  float priority(const glm::dvec3& p) const {
    double w = value(clip_rows[3], p);
    if (!(w > 0)) return 1;
    double x = value(clip_rows[0], p) / w, y = value(clip_rows[1], p) / w;
    auto priority = static_cast<float>(std::min(1.0, std::sqrt(0.5 * (x * x + y * y))));
    return priority >= 0 ? priority : 1;
  }
  static bool finite(const glm::dmat4& m) {
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 4; ++r)
        if (!std::isfinite(m[c][r])) return false;
    return true;
  }
};

// A LodView as selections work with it: what is not finite, or below its least, counts for its default.
struct LodSettings {
  LodCamera camera;
  bool flat = true;  // no relief, or none asked for
  bool morph = false, hide_backs = true;
  double exaggerate = 0;  // 0 where flat
  double min_cell_px = 0, hysteresis = 0;
  double error_px = 1, max_node_px = kMaxNodePx;  // larger where the budget of nodes ran out

  LodSettings() = default;
  // plane: without relief the surface is a plane, where nothing can be on its way.
  LodSettings(const LodView& view, bool has_relief, bool plane)
      : camera(view), flat(!view.relief || !has_relief), hide_backs(view.hide_backs) {
    morph = view.morph && camera.valid && !(flat && plane);
    exaggerate = flat ? 0 : std::isfinite(view.exaggerate) ? view.exaggerate : 1.0;
    min_cell_px = view.min_cell_px > 0 ? view.min_cell_px : 0;
    hysteresis = view.hysteresis > 0 && std::isfinite(view.hysteresis) ? view.hysteresis : 0;
    error_px = view.error_px > kMinErrorPx ? view.error_px : kMinErrorPx;
  }
  // Levels are whole, and of this view alone.
  bool wholeLevels() const { return !morph && hysteresis == 0; }
};

// What a millimetre can be in the picture, anywhere in some part of the surface.
struct PxPerMm {
  double head_on = 0;  // across the line of sight, where the part is nearest
  double any_way = 1;  // times that: moved in any direction, up to the secant of the angle off the axis
  double along = 1;  // times that: moved along the base's normal of the part's middle; a height that points at the eye
                     // counts for little
  double turn = 0;   // how far other normals of the part lie from that one (MeshForest::NormalRange)

  // How far a deviation is to be seen.
  double of(const Deviation& d) const {
    const double shaped = d.largestAlong() * (along + turn * any_way) + d.aside_mm * any_way;
    return head_on * std::min(d.mm * any_way, shaped);
  }
  // How far two of the points that a deviation may lead to within a cell of the coarser surface are from one another.
  double between(const Deviation& d) const {
    // Along two normals, a and b of them: |a - b| along, and |a| + |b| turned, which is |a - b| where they lie on two
    // sides.
    const double turned = turn * any_way,
                 shaped = std::max(d.between_mm * (along + turned), 2 * d.largestAlong() * turned) +
                          2 * d.aside_mm * any_way;
    return head_on * std::min(d.apart_mm * any_way, shaped);
  }
};

// The order that the results' lists promise.
inline void sortInstances(std::vector<PatchInstance>& instances) {
  std::sort(instances.begin(), instances.end(), [](const PatchInstance& a, const PatchInstance& b) {
    return a.grid_level != b.grid_level ? a.grid_level < b.grid_level : a.node < b.node;
  });
}
inline void sortRequests(std::vector<ReliefRequest>& requests) {
  std::sort(requests.begin(), requests.end(), [](const ReliefRequest& a, const ReliefRequest& b) {
    if (a.page.level != b.page.level) return a.page.level < b.page.level;
    return a.priority != b.priority ? a.priority < b.priority : a.page < b.page;
  });
}

}  // namespace relievo
