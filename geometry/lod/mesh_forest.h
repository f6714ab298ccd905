// mesh_forest.h - what of an artwork over a base mesh does not change from view to view: where squares meet, and what
// the oracle said of their heights and errors, kept once asked for. Internal to mesh_lod.cpp.
#pragma once

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "geometry/lod/facing_cone.h"
#include "geometry/lod/lod_common.h"
#include "geometry/lod/page_facts.h"
#include "geometry/lod/square.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// 1 / 2^times, up to 1,022 times.
inline double halved(int times) { return std::bit_cast<double>(static_cast<uint64_t>(1023 - times) << 52); }

// Corners of a square at its lowest and at its highest height: the displaced square lies in their hull (see
// mesh_lod.cpp).
using SquareHull = std::array<glm::dvec3, 8>;

// Of grids coarser than a root page's, by parts: grids of 2^4 to 2^6 cells a patch's side have 2, 4, 8 blocks a side.
class CoarseParts {
 public:
  static constexpr int kFirst = 4, kLast = kPageLog2 - 1;
  static constexpr int depthOf(int cells_log2) { return cells_log2 - 3; }
  // whole_mm: by cells_log2, what unknown and impossible blocks count for. Blocks of more cells are around those
  // inside.
  void read(const ReliefOracle& oracle, uint32_t patch, const CoarseErrors& whole_mm) {
    std::array<float, 64> mm;
    std::array<DeviationShape, 64> shapes;
    for (int k = kFirst; k <= kLast; ++k) {
      const float whole = whole_mm[static_cast<size_t>(k)];
      const int finest = depthOf(k);
      const size_t count = size_t{1} << (2 * finest);
      const bool known = oracle.coarseBlocks(patch, k, std::span(mm).first(count)),
                 shaped = known && oracle.coarseShapes(patch, k, std::span(shapes).first(count));
      for (size_t i = 0; i < count; ++i)
        parts_[first(k, finest) + i] = partError(whole, known ? mm[i] : -1, shaped ? shapes[i] : DeviationShape{});
      for (int depth = finest - 1; depth > 0; --depth) {
        const uint32_t side = 1u << depth;
        for (uint32_t y = 0; y < side; ++y)
          for (uint32_t x = 0; x < side; ++x) {
            auto finer = [&](uint32_t i, uint32_t j) { return at(k, depth + 1, 2 * x + i, 2 * y + j); };
            parts_[first(k, depth) + y * side + x] = joined(finer(0, 0), finer(1, 0), finer(0, 1), finer(1, 1));
          }
      }
    }
  }
  // Part (x, y) of 2^depth a side, 1 <= depth <= depthOf(cells_log2).
  const PartError& at(int cells_log2, int depth, uint32_t x, uint32_t y) const {
    return parts_[first(cells_log2, depth) + (y << depth) + x];
  }

 private:
  // Those of each grid one after the other, the coarsest parts first.
  static constexpr size_t first(int cells_log2, int depth) {
    size_t at = static_cast<size_t>(firstPart(depth));
    for (int k = kFirst; k < cells_log2; ++k) at += static_cast<size_t>(firstPart(depthOf(k) + 1));
    return at;
  }
  static constexpr size_t kCount = 4 + (4 + 16) + (4 + 16 + 64);
  std::array<PartError, kCount> parts_;
};

class MeshForest {
 public:
  MeshForest(std::shared_ptr<const BaseMesh> mesh, int relief_depth, double offset_mm, double scale_mm,
             std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse, bool tails)
      : base_(std::move(mesh)),
        oracle_(std::move(oracle)),
        coarse_errors_(std::move(coarse)),
        depth_(std::max(relief_depth, 0)),
        has_relief_(relief_depth >= 0),
        tails_(tails) {
    assert(base_ && oracle_);
    const double ends[2] = {offset_mm, offset_mm + 65535 * scale_mm};
    whole_range_.min_mm = static_cast<float>(std::min(ends[0], ends[1]));
    whole_range_.max_mm = static_cast<float>(std::max(ends[0], ends[1]));
    neighbours_ = patchNeighbours(*base_);
    // A square's key has 5 bits of level; places have what patches leave.
    place_bits_ = (58 - std::bit_width(std::max<size_t>(patchCount(), 2) - 1)) / 2;
    root_bounds_.assign(patchCount(), {1, 0, 0});
    coarse_index_.assign(patchCount(), kNotAsked);
    whole_shapes_.resize(patchCount());
    twist_mm_.reserve(patchCount());
    for (uint32_t p = 0; p < patchCount(); ++p) twist_mm_.push_back(glm::length(base_->twist(p)));
    // Not below those of finer grids, whatever the table says.
    if (coarse_errors_.size() != patchCount()) coarse_errors_.clear();
    for (CoarseErrors& errors : coarse_errors_)
      for (size_t k = errors.size(); k-- > 0;) {
        const float finer = k + 1 < errors.size() ? errors[k + 1] : 0;
        errors[k] = errors[k] >= 0 ? std::max(errors[k], finer) : std::numeric_limits<float>::infinity();
      }
  }

  uint32_t patchCount() const { return static_cast<uint32_t>(base_->patches.size()); }
  bool hasRelief() const { return has_relief_; }
  int depth() const { return depth_; }  // of the relief's pages
  // Heights that are there without pages: those of the patches' tails; else those of the root pages, which are then
  // always resident.
  bool hasTails() const { return tails_; }
  int leastResidentLevel() const { return tails_ ? kTailCellsLog2 : kPageLog2; }
  int unitLog2() const { return depth_ + kPageLog2; }                           // of a patch's side in finest cells
  int maxLevel() const { return std::min({place_bits_, unitLog2() - 1, 31}); }  // of squares

  // ---- places
  uint64_t key(const Square& s) const {
    return (static_cast<uint64_t>(s.level) << 58) | (uint64_t{s.patch} << (2 * place_bits_)) |
           (uint64_t{s.x} << place_bits_) | s.y;
  }
  const PatchNeighbours& patchNeighboursOf(uint32_t patch) const { return neighbours_[patch]; }
  // The square of the same level across a side; false: the mesh's border.
  bool neighbour(const Square& s, int side, Square& out) const {
    static constexpr int kDx[4] = {-1, 1, 0, 0}, kDy[4] = {0, 0, -1, 1};
    const uint32_t last = (1u << s.level) - 1;
    const bool upright = side == kLeft || side == kRight;
    const uint32_t across = upright ? s.x : s.y, along = upright ? s.y : s.x;
    if (across != (side == kRight || side == kBottom ? last : 0)) {
      out = {s.patch, s.level, s.x + static_cast<uint32_t>(kDx[side]), s.y + static_cast<uint32_t>(kDy[side])};
      return true;
    }
    const PatchNeighbour& n = neighbours_[s.patch][static_cast<size_t>(side)];
    if (n.patch == PatchNeighbour::kNone) return false;
    const uint32_t t = n.reversed ? last - along : along, edge = n.side == kRight || n.side == kBottom ? last : 0;
    out = n.side == kLeft || n.side == kRight ? Square{n.patch, s.level, edge, t} : Square{n.patch, s.level, t, edge};
    return true;
  }

  // ---- the surface. exaggerate: of heights; 0: the base mesh
  SquareHull hull(const Square& s, double exaggerate) {
    double low = 0, high = 0;
    if (exaggerate != 0) {
      const HeightBounds& h = pageBounds(s.ancestor(std::min(s.level, depth_)));
      low = h.min_mm * exaggerate, high = h.max_mm * exaggerate;
    }
    const double step = halved(s.level);
    SquareHull hull;
    for (uint32_t k = 0; k < 4; ++k) {
      const double u = (s.x + (k & 1)) * step, v = (s.y + (k >> 1)) * step;
      const glm::dvec3 p = base_->point(s.patch, u, v), n = base_->normal(s.patch, u, v);
      hull[k] = p + low * n;
      hull[4 + k] = p + high * n;
    }
    return hull;
  }
  // Which way the base's normals point within a square: all within `turn` of the axis, both of length 1. More than 1:
  // any way.
  struct NormalRange {
    glm::dvec3 axis{0};
    double turn = 2;
  };
  NormalRange normals(const Square& s) const {
    const double step = halved(s.level), u = s.x * step, v = s.y * step;
    NormalRange range;
    glm::dvec3 n = base_->normal(s.patch, u + 0.5 * step, v + 0.5 * step);
    const double length = glm::length(n);
    if (!(length > 1e-3)) return range;
    range.axis = n / length;
    double turn = 0;
    for (uint32_t k = 0; k < 4; ++k) {
      n = base_->normal(s.patch, u + (k & 1) * step, v + (k >> 1) * step);
      const double corner = glm::length(n);
      // Mixes of normals less than a right angle from the axis stay as near to it as these.
      turn = std::max(turn, corner > 1e-3 ? glm::length(n / corner - range.axis) : 2.0);
    }
    range.turn = turn * (1 + 1e-6) + 1e-7;
    return range;
  }
  bool isClosed() const { return isClosedBody(*base_, neighbours_); }
  FacingCone facing(uint32_t patch, double exaggerate) {
    if (exaggerate == 0) return facingCone(*base_, patch, 0, 0, {});
    HeightSlopes slopes;
    if (!oracle_->heightSlopes(patch, slopes)) return {};
    const HeightBounds& h = pageBounds({patch, 0, 0, 0});
    const double low = h.min_mm * exaggerate, high = h.max_mm * exaggerate;
    auto times = [&](float a, float b) {
      return std::array{static_cast<float>(std::min(a * exaggerate, b * exaggerate)),
                        static_cast<float>(std::max(a * exaggerate, b * exaggerate))};
    };
    const auto u = times(slopes.min_u, slopes.max_u), v = times(slopes.min_v, slopes.max_v);
    return facingCone(*base_, patch, std::min(low, high), std::max(low, high), {u[0], u[1], v[0], v[1]});
  }
  // Of the surface through the vertices of an absolute level, within a square. Infinite: nothing is known.
  // Exaggerated x times, S = P + x h N = x (P + h N) + (1 - x) P: what was baked x times, and what is left of P's. The
  // latter: a bilinear P's mixed term d u v, cut along the diagonal of cells of width w, is off by |d| w^2 / 4 in their
  // middle.
  Deviation deviation(const Square& s, int level, double exaggerate) {
    if (level >= unitLog2()) return {};
    const Deviation twist =
        Deviation::anyDirection(std::abs(1 - exaggerate) * 0.25 * twist_mm_[s.patch] * halved(2 * level));
    return exaggerate != 0 ? twist + exaggerate * bakedDeviation(s, level) : twist;
  }
  double error(const Square& s, int level, double exaggerate) { return deviation(s, level, exaggerate).mm; }
  // Between two views.
  void forgetSome() { facts_.forgetSome(); }

 private:
  const HeightBounds& pageBounds(const Square& page) {
    if (page.level == 0) {
      HeightBounds& b = root_bounds_[page.patch];
      if (!(b.min_mm <= b.max_mm)) b = askBounds(page);
      return b;
    }
    return facts_.bounds(key(page), [&] { return askBounds(page); });
  }
  HeightBounds askBounds(const Square& page) const {
    HeightBounds b = oracle_->bounds(page.id());
    if (!(b.min_mm <= b.max_mm) || !std::isfinite(b.min_mm) || !std::isfinite(b.max_mm))
      b.min_mm = whole_range_.min_mm, b.max_mm = whole_range_.max_mm;
    if (!(b.error_mm >= 0)) b.error_mm = std::numeric_limits<float>::infinity();
    return b;
  }
  // A patch's grids as a whole, asked for once: their shapes are around those of their blocks.
  DeviationShape wholeShape(uint32_t patch, int level, float whole_mm) {
    WholeShapes& whole = whole_shapes_[patch];
    if (!(whole.known >> level & 1)) {
      whole.known |= static_cast<uint8_t>(1 << level);
      whole.of[static_cast<size_t>(level)] = askWholeShape(patch, level, whole_mm);
    }
    return whole.of[static_cast<size_t>(level)];
  }
  DeviationShape askWholeShape(uint32_t patch, int level, float whole_mm) const {
    std::array<float, 64> mm;
    std::array<DeviationShape, 64> shapes;
    const size_t count = level < CoarseParts::kFirst ? 1 : size_t{1} << (2 * CoarseParts::depthOf(level));
    if (!oracle_->coarseShapes(patch, level, std::span(shapes).first(count))) return {};
    if (count == 1) return shapes[0];
    if (!oracle_->coarseBlocks(patch, level, std::span(mm).first(count))) return {};
    Deviation all;
    for (size_t i = 0; i < count; ++i) all = joined(all, deviationOf(mm[i], shapes[i]));
    all.mm = whole_mm;
    return shapeOf(all);
  }
  Deviation coarseDeviation(const Square& s, int level) {
    const CoarseErrors& whole = coarse_errors_[s.patch];
    const float whole_mm = whole[static_cast<size_t>(level)];
    const int part_depth = std::min(s.level, CoarseParts::depthOf(level));
    if (!(whole_mm > 0)) return {};
    if (!std::isfinite(whole_mm)) return Deviation::anyDirection(whole_mm);
    if (part_depth <= 0) return deviationOf(whole_mm, wholeShape(s.patch, level, whole_mm));
    uint32_t& index = coarse_index_[s.patch];
    if (index == kNotAsked) {
      index = static_cast<uint32_t>(coarse_parts_.size());
      coarse_parts_.emplace_back().read(*oracle_, s.patch, whole);
    }
    const Square part = s.ancestor(part_depth);
    return coarse_parts_[index].at(level, part_depth, part.x, part.y).deviation();
  }
  Deviation bakedDeviation(const Square& s, int level) {
    const int page_level = level - kPageLog2;
    if (page_level < 0) {
      if (coarse_errors_.empty()) return Deviation::anyDirection(std::numeric_limits<double>::infinity());
      const Deviation d = coarseDeviation(s, level);
      // Not below that of the root page, of this part.
      return depth_ == 0 ? d : joined(d, bakedDeviation(s, kPageLog2));
    }
    const Square page = s.ancestor(std::min(page_level, s.level));
    return facts_.within(s, page, key(page), *oracle_, Deviation::anyDirection(pageBounds(page).error_mm));
  }

  std::shared_ptr<const BaseMesh> base_;
  std::shared_ptr<const ReliefOracle> oracle_;
  std::vector<CoarseErrors> coarse_errors_;
  std::vector<PatchNeighbours> neighbours_;
  std::vector<double> twist_mm_;  // |BaseMesh::twist()|
  int depth_ = 0, place_bits_ = 0;
  bool has_relief_ = false, tails_ = false;
  HeightBounds whole_range_;
  std::vector<HeightBounds> root_bounds_;  // by patch; min above max: not asked for yet
  PageFacts facts_;                        // of the other pages, and of all pages' parts
  struct WholeShapes {
    std::array<DeviationShape, std::tuple_size_v<CoarseErrors>> of;
    uint8_t known = 0;  // a bit each
  };
  std::vector<WholeShapes> whole_shapes_;  // by patch
  static constexpr uint32_t kNotAsked = ~0u;
  std::vector<uint32_t> coarse_index_;  // by patch, in the following
  std::vector<CoarseParts> coarse_parts_;
};

}  // namespace relievo
