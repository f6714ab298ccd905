#include "src/engine/eye_guard.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "texturing/package/patch_tails.h"

namespace relievo {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Columns of the relief's nodes, from their greatest height down without end.
class FlatGuard final : public EyeGuard {
 public:
  FlatGuard(const FlatDomain& domain, std::shared_ptr<const ReliefOracle> oracle, double exaggerate)
      : domain_(domain), oracle_(std::move(oracle)), exaggerate_(domain.relief_depth < 0 ? 0 : exaggerate) {}

  double distance(const glm::dvec3& p) const override {
    double best = kInfinity;
    for (uint32_t patch = 0; patch < domain_.patchCount(); ++patch) look({patch, 0, 0, 0}, p, best);
    return best;
  }
  bool behind(const glm::dvec3&) const override { return false; }  // what is behind has no distance

 private:
  // Below the top of a column its distance is how far below, negative. At least `enough`: how much farther is not
  // asked.
  double toColumn(const NodeId& n, const glm::dvec3& p, double enough) const {
    const double mm = domain_.mm_per_px,
                 side = std::ldexp(static_cast<double>(domain_.patchPx()), -static_cast<int>(n.level));
    const double width = static_cast<double>(domain_.width_px), height = static_cast<double>(domain_.height_px);
    const double left = static_cast<double>(domain_.patchOriginX(n.patch)) + n.x * side,
                 top = static_cast<double>(domain_.patchOriginY(n.patch)) + n.y * side;
    const double x = p.x / mm + width / 2, y = height / 2 - p.y / mm;  // texels
    const double aside = mm * std::max({left - x, x - std::min(left + side, width), 0.0});
    const double along = mm * std::max({top - y, y - std::min(top + side, height), 0.0});
    const double beside = std::hypot(aside, along);
    if (beside >= enough) return beside;
    double high = 0;
    if (exaggerate_ != 0) {
      const HeightBounds bounds = oracle_->bounds(n);
      high = std::max(bounds.min_mm * exaggerate_, bounds.max_mm * exaggerate_);
    }
    const double above = p.z - high;
    return beside == 0 ? above : std::hypot(beside, std::max(above, 0.0));
  }
  void look(const NodeId& n, const glm::dvec3& p, double& best) const {
    if (!domain_.nodeExists(n)) return;
    const double to = toColumn(n, p, best);
    if (to >= best) return;
    if (exaggerate_ == 0 || static_cast<int>(n.level) >= domain_.relief_depth) {
      best = to;
      return;
    }
    // The nearest first: it lets the others be left out.
    std::array<std::pair<double, NodeId>, 4> children;
    for (uint32_t k = 0; k < 4; ++k) {
      const NodeId child = n.child(k & 1, k >> 1);
      children[k] = {domain_.nodeExists(child) ? toColumn(child, p, best) : kInfinity, child};
    }
    std::sort(children.begin(), children.end());
    for (const auto& [distance, child] : children)
      if (distance < best) look(child, p, best);
  }

  FlatDomain domain_;
  std::shared_ptr<const ReliefOracle> oracle_;
  double exaggerate_;
};

double squaredDistance(const glm::dvec3& p, const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  // The nearest point of a triangle by its Voronoi regions (Ericson 2005, section 5.1.5).
  const auto squared = [](const glm::dvec3& v) { return glm::dot(v, v); };
  const glm::dvec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap), d3 = glm::dot(ab, bp), d4 = glm::dot(ac, bp),
               d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
  if (d1 <= 0 && d2 <= 0) return squared(ap);
  if (d3 >= 0 && d4 <= d3) return squared(bp);
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return squared(ap - ab * (d1 > d3 ? d1 / (d1 - d3) : 0));
  if (d6 >= 0 && d5 <= d6) return squared(cp);
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return squared(ap - ac * (d2 > d6 ? d2 / (d2 - d6) : 0));
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 >= d3 && d5 >= d6) {
    const double along = (d4 - d3) + (d5 - d6);
    return squared(bp - (c - b) * (along > 0 ? (d4 - d3) / along : 0));
  }
  const double sum = va + vb + vc;
  return sum > 0 ? squared(ap - ab * (vb / sum) - ac * (vc / sum)) : squared(ap);
}

// A body's patches as grids of cells, each cell with how far the finest surface may lie from it, in a tree of boxes.
class BodyGuard final : public EyeGuard {
 public:
  BodyGuard(const Artwork& artwork, double exaggerate, int workers) {
    const Manifest& m = artwork.manifest;
    const BaseMesh& base = *m.base;
    const auto patches = static_cast<uint32_t>(base.patches.size());
    const bool relief = m.domain.relief_depth >= 0 && exaggerate != 0;
    const bool even = m.domain.relief_scale_mm == 0;  // every height is the least one
    KeptTails tails;
    if (relief && !even) {
      if (artwork.tails) {
        tails = artwork.tails(workers, nullptr);
      } else {
        PatchTails made(patches, m.texture.channels());
        tailsFromPages(*artwork.source, m.texture, true, 0, workers, made, nullptr);
        tails = made;
      }
    }
    constexpr size_t kMostCells = size_t{1} << 18;
    int log2 = kTailCellsLog2;
    while (log2 > 0 && (size_t{patches} << (2 * log2)) > kMostCells) --log2;
    cells_a_side_ = 1u << log2;
    const double low = m.domain.relief_offset_mm, range = 65535 * m.domain.relief_scale_mm;
    const uint32_t side = cells_a_side_ + 1;
    points_.reserve(size_t{patches} * side * side);
    slack_mm_.reserve(patches);
    for (uint32_t p = 0; p < patches; ++p) {
      const float error_mm = p < m.coarse_errors.size() ? m.coarse_errors[p][static_cast<size_t>(log2)] : -1;
      const bool known = relief && error_mm >= 0 && std::isfinite(error_mm);
      for (uint32_t j = 0; j < side; ++j) {
        for (uint32_t i = 0; i < side; ++i) {
          const double u = static_cast<double>(i) / cells_a_side_, v = static_cast<double>(j) / cells_a_side_;
          double height = 0;
          if (known) {
            const uint32_t stride = (1u << kTailCellsLog2) / cells_a_side_;
            const size_t sample = size_t{j} * stride * kTailSamples + i * stride;
            height = low + (even ? 0 : tails.height(p, sample) * m.domain.relief_scale_mm);
          } else if (relief) {
            height = low + range / 2;
          }
          points_.push_back(glm::vec3(base.point(p, u, v) + base.normal(p, u, v) * (height * exaggerate)));
        }
      }
      // A patch lies within a quarter of its twist from the triangles of its cells. The error that the package
      // states includes it, for heights as they are. Unknown heights lie within their range.
      const glm::vec3* at = &points_[size_t{p} * side * side];
      const glm::dvec3 drawn_twist = glm::dvec3(at[0]) - glm::dvec3(at[side - 1]) -
                                     glm::dvec3(at[size_t{side} * (side - 1)]) +
                                     glm::dvec3(at[size_t{side} * side - 1]);
      const double slack =
          known ? std::abs(exaggerate) * error_mm + std::abs(1 - exaggerate) * glm::length(base.twist(p)) / 4
                : glm::length(drawn_twist) / 4 + (relief ? std::abs(range * exaggerate) / 2 : 0);
      slack_mm_.push_back(static_cast<float>(slack * 1.0001 + 1e-6));
    }
    std::vector<uint32_t> cells(size_t{patches} << (2 * log2));
    for (size_t i = 0; i < cells.size(); ++i) cells[i] = static_cast<uint32_t>(i);
    cells_ = std::move(cells);
    build(0, cells_.size());
  }

  double distance(const glm::dvec3& p) const override {
    double best = kInfinity;
    nearest(0, p, best);
    return best;
  }
  // Most lines from a place behind the surface meet it from behind.
  bool behind(const glm::dvec3& p) const override {
    int backs = 0;
    for (int i = 0; i < kLooks; ++i) {
      // Evenly over the sphere (a Fibonacci lattice).
      const double z = 1 - (2 * i + 1.0) / kLooks, around = i * 2.399963229728653, r = std::sqrt(1 - z * z);
      Hit hit;
      cast(0, p, {r * std::cos(around), r * std::sin(around), z}, hit);
      backs += hit.back;
    }
    return 2 * backs > kLooks;
  }

 private:
  static constexpr size_t kLeaf = 4;
  static constexpr int kLooks = 32;
  struct Node {
    glm::vec3 low{std::numeric_limits<float>::infinity()}, high{-std::numeric_limits<float>::infinity()};
    float slack_mm = 0;   // the largest within
    uint32_t second = 0;  // the first child follows its parent; 0: a leaf
    uint32_t first_cell = 0, cells = 0;
  };
  struct Hit {
    double at = kInfinity;
    bool back = false;
  };

  std::array<glm::dvec3, 4> corners(uint32_t cell) const {
    const uint32_t side = cells_a_side_ + 1, patch = cell / (cells_a_side_ * cells_a_side_),
                   in = cell % (cells_a_side_ * cells_a_side_);
    const size_t at = size_t{patch} * side * side + size_t{in / cells_a_side_} * side + in % cells_a_side_;
    return {points_[at], points_[at + 1], points_[at + side], points_[at + side + 1]};
  }
  float slackOf(uint32_t cell) const { return slack_mm_[cell / (cells_a_side_ * cells_a_side_)]; }
  glm::vec3 centre(uint32_t cell) const {
    const auto c = corners(cell);
    return glm::vec3(c[0] + c[3]) * 0.5f;
  }

  uint32_t build(size_t first, size_t last) {
    const auto index = static_cast<uint32_t>(nodes_.size());
    nodes_.emplace_back();
    Node node;
    glm::vec3 low(std::numeric_limits<float>::infinity()), high(-std::numeric_limits<float>::infinity());
    for (size_t i = first; i < last; ++i) {
      for (const glm::dvec3& c : corners(cells_[i])) {
        node.low = glm::min(node.low, glm::vec3(c));
        node.high = glm::max(node.high, glm::vec3(c));
      }
      node.slack_mm = std::max(node.slack_mm, slackOf(cells_[i]));
      low = glm::min(low, centre(cells_[i]));
      high = glm::max(high, centre(cells_[i]));
    }
    node.first_cell = static_cast<uint32_t>(first);
    node.cells = static_cast<uint32_t>(last - first);
    if (last - first > kLeaf) {
      const glm::vec3 size = high - low;
      const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
      const size_t middle = (first + last) / 2;
      std::nth_element(cells_.begin() + static_cast<std::ptrdiff_t>(first),
                       cells_.begin() + static_cast<std::ptrdiff_t>(middle),
                       cells_.begin() + static_cast<std::ptrdiff_t>(last),
                       [&](uint32_t a, uint32_t b) { return centre(a)[axis] < centre(b)[axis]; });
      build(first, middle);
      node.second = build(middle, last);
    }
    nodes_[index] = node;
    return index;
  }
  double toBox(const Node& n, const glm::dvec3& p) const {
    return glm::length(glm::max(glm::max(glm::dvec3(n.low) - p, p - glm::dvec3(n.high)), glm::dvec3(0))) - n.slack_mm;
  }
  void nearest(uint32_t index, const glm::dvec3& p, double& best) const {
    const Node& n = nodes_[index];
    if (n.second == 0) {
      for (uint32_t i = n.first_cell; i < n.first_cell + n.cells; ++i) {
        const auto c = corners(cells_[i]);
        // Cut as it is drawn, along (0,0) - (1,1).
        const double squared = std::min(squaredDistance(p, c[0], c[1], c[3]), squaredDistance(p, c[0], c[3], c[2]));
        best = std::min(best, std::sqrt(squared) - slackOf(cells_[i]));
      }
      return;
    }
    uint32_t near = index + 1, far = n.second;
    double to_near = toBox(nodes_[near], p), to_far = toBox(nodes_[far], p);
    if (to_far < to_near) std::swap(near, far), std::swap(to_near, to_far);
    if (to_near < best) nearest(near, p, best);
    if (to_far < best) nearest(far, p, best);
  }
  static void castTriangle(const glm::dvec3& p, const glm::dvec3& d, const glm::dvec3& a, const glm::dvec3& b,
                           const glm::dvec3& c, Hit& hit) {
    // Moeller and Trumbore 1997. a, b, c run so that (b - a) x (c - a) points inwards (base_mesh.h: P_v x P_u points
    // outwards).
    const glm::dvec3 ab = b - a, ac = c - a, h = glm::cross(d, ac);
    const double determinant = glm::dot(ab, h);
    if (determinant == 0) return;
    const glm::dvec3 s = (p - a) / determinant, q = glm::cross(s, ab);
    const double u = glm::dot(s, h), v = glm::dot(d, q), t = glm::dot(ac, q);
    if (u < 0 || v < 0 || u + v > 1 || t <= 0 || t >= hit.at) return;
    hit = {t, glm::dot(d, glm::cross(ab, ac)) < 0};
  }
  void cast(uint32_t index, const glm::dvec3& p, const glm::dvec3& d, Hit& hit) const {
    const Node& n = nodes_[index];
    double enter = 0, leave = hit.at;
    for (int k = 0; k < 3; ++k) {
      const double a = (n.low[k] - p[k]) / d[k], b = (n.high[k] - p[k]) / d[k];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    if (!(enter <= leave)) return;
    if (n.second != 0) {
      cast(index + 1, p, d, hit);
      cast(n.second, p, d, hit);
      return;
    }
    for (uint32_t i = n.first_cell; i < n.first_cell + n.cells; ++i) {
      const auto c = corners(cells_[i]);
      castTriangle(p, d, c[0], c[1], c[3], hit);
      castTriangle(p, d, c[0], c[3], c[2], hit);
    }
  }

  uint32_t cells_a_side_ = 1;
  std::vector<glm::vec3> points_;
  std::vector<float> slack_mm_;  // by patch
  std::vector<uint32_t> cells_;  // in the tree's order
  std::vector<Node> nodes_;
};

class PlacedGuard final : public EyeGuard {
 public:
  PlacedGuard(std::unique_ptr<const EyeGuard> guard, const PlacedExtent& placed)
      : guard_(std::move(guard)), placed_(placed) {}
  double distance(const glm::dvec3& place_mm) const override {
    const glm::dvec3 place = placeInArtwork(placed_.pose, place_mm);
    const double before = guard_->distance(place);
    if (!placed_.extent.flat || !placed_.pose.turns()) return before;
    return std::max(before, std::min(placed_.extent.min_mm.z, placed_.extent.max_mm.z) - place.z);
  }
  bool behind(const glm::dvec3& place_mm) const override {
    return guard_->behind(placeInArtwork(placed_.pose, place_mm));
  }

 private:
  std::unique_ptr<const EyeGuard> guard_;
  PlacedExtent placed_;
};

class GuardOfAll final : public EyeGuard {
 public:
  explicit GuardOfAll(std::vector<std::unique_ptr<const EyeGuard>> guards) : guards_(std::move(guards)) {}
  double distance(const glm::dvec3& place_mm) const override {
    double nearest = kInfinity;
    for (const auto& guard : guards_) nearest = std::min(nearest, guard->distance(place_mm));
    return nearest;
  }
  bool behind(const glm::dvec3& place_mm) const override {
    return std::any_of(guards_.begin(), guards_.end(), [&](const auto& guard) { return guard->behind(place_mm); });
  }

 private:
  std::vector<std::unique_ptr<const EyeGuard>> guards_;
};

}  // namespace

double EyeGuard::freeShare(const glm::dvec3& from_mm, const glm::dvec3& to_mm, double clear_mm) const {
  const double way_mm = glm::length(to_mm - from_mm);
  if (!(way_mm > 0)) return 1;
  double here = distance(from_mm), at = 0;
  const double keep = std::min(clear_mm, here);
  // Where nothing is nearer than `here`, a step of here - keep is free; steps have a least width, so that the way along
  // a surface ends, too.
  constexpr int kMaxSteps = 256;
  const double least_mm = 0.02 * clear_mm;
  for (int i = 0; i < kMaxSteps; ++i) {
    const double next = std::min(way_mm, at + std::max(here - keep, least_mm));
    const double there = distance(from_mm + (to_mm - from_mm) * (next / way_mm));
    if (there < keep) break;
    if (next == way_mm) return 1;
    at = next;
    here = there;
  }
  return at / way_mm;
}

std::unique_ptr<const EyeGuard> makeEyeGuard(const Artwork& artwork, double exaggerate, int workers) {
  const PatchDomain& domain = artwork.manifest.domain;
  if (domain.isFlat()) return std::make_unique<FlatGuard>(domain.flat(), artwork.oracle, exaggerate);
  return std::make_unique<BodyGuard>(artwork, exaggerate, workers);
}

std::unique_ptr<const EyeGuard> placedGuard(std::unique_ptr<const EyeGuard> guard, const PlacedExtent& placed) {
  if (!placed.pose.isOn()) return guard;
  return std::make_unique<PlacedGuard>(std::move(guard), placed);
}

std::unique_ptr<const EyeGuard> guardOfAll(std::vector<std::unique_ptr<const EyeGuard>> guards) {
  if (guards.size() == 1) return std::move(guards[0]);
  return std::make_unique<GuardOfAll>(std::move(guards));
}

}  // namespace relievo
