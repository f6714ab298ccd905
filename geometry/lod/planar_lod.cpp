// planar_lod.cpp - see the header. The order of the work:
//   1. roots in view (the strip is culled as a binary tree of ranges),
//   2. refine: a node that wants more is split, after the coarser neighbours that the 2:1 rule asks for,
//   3. one level per edge, both sides answering from the same record,
//   4. grid levels, relief pages, wants, predicted error.
// Bounded: when refining asks for more than kMaxLodNodes, everything starts again with twice the error, so detail falls
// evenly.
//
// Levels of places: a grid of level n on a node of level l has vertices of the absolute level L = l + n, 2^(U - L)
// units apart, U the log2 of a patch's side in units. A relief page of level lr has the samples of absolute level lr
// + 7.
#include "geometry/lod/planar_lod.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include "geometry/lod/bound_search.h"
#include "geometry/lod/desired_level.h"
#include "geometry/lod/lod_common.h"

namespace relievo {
namespace {

constexpr int kAnyLevel = 127;  // the finest relief page is resident: vertices at every level

// A square of the forest by its place along the whole strip, so that patch seams are places like any other.
struct Square {
  int level = 0;
  int64_t x = 0, y = 0;
  Square ancestor(int coarser) const { return {coarser, x >> (level - coarser), y >> (level - coarser)}; }
};

struct Box {
  glm::dvec3 centre{0}, half{0};
};

class Selection {
 public:
  Selection(const PlanarDomain& domain, const ReliefOracle& oracle, const LodView& view, const ReliefSet& resident,
            DesiredLevelMemory& memory)
      : domain_(domain), oracle_(oracle), resident_(resident), camera_(view), memory_(memory) {
    unit_log2_ = domain.texture_depth + kPageLog2 + kUnitsPerTexelLog2;
    width_units_ = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
    height_units_ = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
    mm_per_unit_ = domain.mm_per_px / (1 << kUnitsPerTexelLog2);
    flat_ = !view.relief || domain.relief_depth < 0;
    exaggerate_ = std::isfinite(view.exaggerate) ? view.exaggerate : 1.0;
    error_px_ = view.error_px > kMinErrorPx ? view.error_px : kMinErrorPx;
    min_cell_px_ = view.min_cell_px > 0 ? view.min_cell_px : 0;
    morph_ = view.morph && !flat_ && camera_.valid;
    hysteresis_ = view.hysteresis > 0 && std::isfinite(view.hysteresis) ? view.hysteresis : 0;
    memory_.nextView(hysteresis_);
  }

  PlanarLodResult run() {
    // Four times the error until it fits, then back to twice if that fits too.
    double asked_px = error_px_, scale = 1;
    while (!fits(asked_px, scale, !camera_.valid || scale > 1e12)) scale *= 4;
    if (scale > 1 && scale <= 1e12 && !fits(asked_px, scale / 2, false)) fits(asked_px, scale, true);
    return finish();
  }

 private:
  enum class State : uint8_t { kLeaf, kSplit };
  static constexpr int kUnknown = -1;
  struct Node {
    Square square;
    State state = State::kLeaf;
    bool blocked = false;        // would be split if more pages were resident
    bool barren = false;         // split, and no child is in view
    bool rough = false;          // an edge wants more than its grid can give
    uint8_t resident_level = 0;  // vertices up to this absolute level have samples
    int8_t needs_level = 0;      // absolute level that must stay (or become) resident, whatever its edges want
    uint8_t grid_level = 1;
    int drawn = 0;  // absolute, of the grid's inside; levels here and in edges are desired levels: kOneLevel a level
                    // (desired_level.h)
    std::array<std::array<uint32_t, 2>, 4> edge{};  // indices into edges_
    SideLevels levels{};                            // absolute, of edges as drawn
  };
  // One segment between two squares of one level (the finer node's whole edge), keyed by the right or lower square.
  struct Edge {
    Square low, high;  // the squares left of (above) and right of (below) it
    bool has_low = false, has_high = false;
    bool counted = false;
    int wanted = 0;                            // absolute; at most the squares' level + kPageLog2
    int floored = kUnknown, level = kUnknown;  // of flooredLevel(), levelOf()
    double px_per_mm = 0;                      // what a millimetre near it can be on the screen
    double range_mm = 0;                       // of the heights in both squares
  };

  // ---- places
  uint64_t key(const Square& s) const {
    auto along = static_cast<uint64_t>(domain_.alongX() ? s.x : s.y);
    auto across = static_cast<uint64_t>(domain_.alongX() ? s.y : s.x);
    return (static_cast<uint64_t>(s.level) << 58) | (along << 28) | across;
  }
  NodeId nodeId(const Square& s) const {
    int64_t along = domain_.alongX() ? s.x : s.y;
    int64_t within = along & ((int64_t{1} << s.level) - 1);
    return {static_cast<uint32_t>(along >> s.level), static_cast<uint32_t>(s.level),
            static_cast<uint32_t>(domain_.alongX() ? within : s.x),
            static_cast<uint32_t>(domain_.alongX() ? s.y : within)};
  }
  bool exists(const Square& s) const {
    return s.x >= 0 && s.y >= 0 && (s.x << (unit_log2_ - s.level)) < width_units_ &&
           (s.y << (unit_log2_ - s.level)) < height_units_;
  }
  static Square neighbour(const Square& s, int side) {
    static constexpr int kDx[4] = {-1, 1, 0, 0}, kDy[4] = {0, 0, -1, 1};
    return {s.level, s.x + kDx[side], s.y + kDy[side]};
  }

  // ---- heights
  const HeightBounds& pageBounds(const Square& page) {
    uint64_t k = key(page);
    if (uint32_t found = bounds_index_.find(k); found != IndexTable::kNone) return bounds_[found];
    HeightBounds b = oracle_.bounds(nodeId(page));
    if (!(b.min_mm <= b.max_mm) || !std::isfinite(b.min_mm) || !std::isfinite(b.max_mm)) {
      b.min_mm = static_cast<float>(domain_.relief_offset_mm);
      b.max_mm = static_cast<float>(domain_.relief_offset_mm + 65535 * domain_.relief_scale_mm);
      if (b.min_mm > b.max_mm) std::swap(b.min_mm, b.max_mm);
    }
    if (!(b.error_mm >= 0 && b.error_mm <= b.max_mm - b.min_mm)) b.error_mm = b.max_mm - b.min_mm;
    bounds_index_.insert(k, static_cast<uint32_t>(bounds_.size()));
    return bounds_.emplace_back(b);
  }
  // Of the surface through the samples of a page level, over a square: what the page knows of its parts.
  Deviation deviationWithin(const Square& s, int page_level) {
    Square page = s.ancestor(std::min(page_level, s.level));
    double whole = pageBounds(page).error_mm;
    int depth = std::min(s.level - page.level, kErrorBlocksLog2);
    if (depth == 0 || whole == 0) return Deviation::eitherSide(whole);
    uint64_t k = key(page);
    uint32_t found = parts_index_.find(k);
    if (found == IndexTable::kNone) {
      found = static_cast<uint32_t>(parts_.size());
      parts_index_.insert(k, found);
      parts_.emplace_back().read(oracle_, nodeId(page), static_cast<float>(whole));
    }
    Square part = s.ancestor(page.level + depth);
    return parts_[found].at(depth, part.x - (page.x << depth), part.y - (page.y << depth)).deviation();
  }
  HeightBounds heights(const Square& s) { return pageBounds(s.ancestor(std::min(s.level, domain_.relief_depth))); }

  Box boxOf(int64_t x0, int64_t y0, int64_t x1, int64_t y1, double z0_mm, double z1_mm) const {
    x1 = std::min(x1, width_units_);
    y1 = std::min(y1, height_units_);
    double left = (static_cast<double>(x0) - 0.5 * static_cast<double>(width_units_)) * mm_per_unit_;
    double right = (static_cast<double>(x1) - 0.5 * static_cast<double>(width_units_)) * mm_per_unit_;
    double top = (0.5 * static_cast<double>(height_units_) - static_cast<double>(y0)) * mm_per_unit_;
    double bottom = (0.5 * static_cast<double>(height_units_) - static_cast<double>(y1)) * mm_per_unit_;
    z0_mm *= exaggerate_;
    z1_mm *= exaggerate_;
    return {{0.5 * (left + right), 0.5 * (top + bottom), 0.5 * (z0_mm + z1_mm)},
            {0.5 * (right - left), 0.5 * (top - bottom), 0.5 * std::abs(z1_mm - z0_mm)}};
  }
  Box boxOf(const Square& s) {
    HeightBounds h = flat_ ? HeightBounds{} : heights(s);
    int shift = unit_log2_ - s.level;
    return boxOf(s.x << shift, s.y << shift, (s.x + 1) << shift, (s.y + 1) << shift, h.min_mm, h.max_mm);
  }

  // ---- the view
  static double extent(const glm::dvec4& row, const Box& b) {
    return std::abs(row.x) * b.half.x + std::abs(row.y) * b.half.y + std::abs(row.z) * b.half.z;
  }
  bool culled(const Box& b) const {
    if (!camera_.valid) return false;
    for (const glm::dvec4& plane : camera_.planes) {
      double middle = LodCamera::value(plane, b.centre), reach = extent(plane, b);
      // Rounding of the sums above is below 1e-12 of their terms; what is on the plane stays.
      if (middle + reach < -1e-9 * (std::abs(middle) + reach)) return true;
    }
    return false;
  }
  // An upper bound of how many pixels a millimetre of height (along z), anywhere in the box, can be on the screen.
  // The perspective image f X / Z of a point moves by f / Z |n - (n . forward) d / Z| when the point moves along n; d /
  // Z, d from the eye to the point and Z its depth, is taken at the box's centre and differs within the box by at most
  // |half| / (Z cos a), a the angle off the axis. So a height that points at the eye counts for what the rest of its
  // neighbourhood shows of it, and never for nothing (kMinSine). In front of the near plane nothing is drawn.
  // Orthographic, it is the same sine for all.
  double pxPerMm(const Box& b) const {
    if (!camera_.valid) return 0;
    const glm::dvec3 &forward = camera_.forward, up(0, 0, 1);
    if (camera_.orthographic) return camera_.scale * std::max(kMinSine, glm::length(up - forward.z * forward));
    double centre_depth = LodCamera::value(camera_.depth_row, b.centre);
    double depth = std::max(camera_.near_mm, centre_depth - extent(camera_.depth_row, b));
    glm::dvec3 d = b.centre - camera_.eye;
    double reach = glm::length(b.half);
    double aside = std::sqrt(std::max(0.0, glm::dot(d, d) - centre_depth * centre_depth)) + reach;
    double secant = std::min(camera_.max_secant, std::sqrt(1 + (aside / depth) * (aside / depth)));
    double factor = secant;
    if (centre_depth > camera_.near_mm) {
      double at_centre = glm::length(up - forward.z * d / centre_depth);
      double wholly = std::sqrt(1 + (aside / depth) *
                                        (aside / depth));  // not cut at the picture's corner: the box may reach beyond
      factor = std::min(secant, std::max(kMinSine, at_centre + std::abs(forward.z) * reach * wholly / depth));
    }
    return camera_.scale / depth * factor;
  }

  // How wide, seen head on, a cell between vertices of this level is on the screen where the box is nearest.
  double cellPx(const Box& b, int level) const {
    if (!camera_.valid) return 0;
    double cell_mm = std::ldexp(domain_.mm_per_px, unit_log2_ - kUnitsPerTexelLog2 - level);
    if (camera_.orthographic) return cell_mm * camera_.scale;
    return cell_mm * camera_.scale /
           std::max(camera_.near_mm, LodCamera::value(camera_.depth_row, b.centre) - extent(camera_.depth_row, b));
  }

  // ---- edges
  // The error of a surface through the samples of an absolute level: from the page of that level.
  double errorMm(const Edge& e, int level) {
    if (flat_) return 0;
    int page_level = level - kPageLog2;
    if (page_level >= domain_.relief_depth) return 0;
    if (page_level < 0) return e.range_mm;  // coarser than a root page: only the range is known
    double error = 0;
    if (e.has_low) error = deviationWithin(e.low, page_level).mm;
    if (e.has_high) error = std::max(error, deviationWithin(e.high, page_level).mm);
    return std::min(error, e.range_mm);
  }
  double errorPx(const Edge& e, int level) { return errorMm(e, level) * std::abs(exaggerate_) * e.px_per_mm; }

  // A function of the segment alone: its two squares, never of who asks.
  uint32_t edgeAt(const Square& s, int side) {
    Square high = side == kRight || side == kBottom ? neighbour(s, side) : s;
    bool upright = side == kLeft || side == kRight;
    uint64_t k = key(high) * 2 + (upright ? 0 : 1);
    if (uint32_t found = edge_index_.find(k); found != IndexTable::kNone) return found;
    Edge e;
    e.high = high;
    e.low = neighbour(high, upright ? kLeft : kTop);
    e.has_high = exists(e.high);
    e.has_low = exists(e.low);
    if (!flat_) {
      double z0 = std::numeric_limits<double>::max(), z1 = std::numeric_limits<double>::lowest();
      for (const Square* q : {&e.low, &e.high}) {
        if (!(q == &e.low ? e.has_low : e.has_high)) continue;
        HeightBounds h = heights(*q);
        z0 = std::min<double>(z0, h.min_mm);
        z1 = std::max<double>(z1, h.max_mm);
        e.range_mm = std::max<double>(e.range_mm, double{h.max_mm} - h.min_mm);
      }
      const Square& first = e.has_low ? e.low : e.high;
      const Square& last = e.has_high ? e.high : e.low;
      int shift = unit_log2_ - s.level;
      Box box = boxOf(first.x << shift, first.y << shift, (last.x + 1) << shift, (last.y + 1) << shift, z0, z1);
      e.px_per_mm = pxPerMm(box);
      const DesiredLevelView desired{error_px_, min_cell_px_, hysteresis_, morph_};
      double widest = 0;
      if (morph_) widest = std::max(e.has_low ? ofWidest(e.low) : 0, e.has_high ? ofWidest(e.high) : 0);
      e.wanted = memory_.held(k, desiredLevel(s.level, s.level + kPageLog2, cellPx(box, s.level), widest, desired,
                                              [&](int level) { return errorPx(e, level); }));
    } else {
      e.wanted = s.level * kOneLevel;
    }
    auto index = static_cast<uint32_t>(edges_.size());
    edges_.push_back(e);
    edge_index_.insert(k, index);
    return index;
  }

  // ---- levels with geomorph: continuous functions of the view, of edges alone, so that it does not matter which
  // squares are nodes. What an edge wants, and what is left of what its parent, or the square that it crosses, was
  // drawn with.
  int flooredLevel(uint32_t edge) {
    const Edge e = edges_[edge];
    if (e.floored != kUnknown) return e.floored;
    int level = e.wanted;
    if (e.high.level > 0) {
      const int up = e.high.level - 1;
      const Square low = e.low.ancestor(up), high = e.high.ancestor(up);
      const bool inside = low.x == high.x && low.y == high.y;
      const int from = inside ? innerLevel(high) : levelOf(edgeBetween(low, high));
      int progress = 0;
      if (exists(high)) progress = progressOf(high);
      if (!inside && exists(low)) progress = std::max(progress, progressOf(low));
      level = std::max(level, childFloor(up, from, progress));
    }
    return edges_[edge].floored = level;
  }
  // Not so far below the others of its squares that its middle would be missing when these are split.
  int levelOf(uint32_t edge) {
    if (!morph_) return edges_[edge].wanted;
    const Edge e = edges_[edge];
    if (e.level != kUnknown) return e.level;
    int level = flooredLevel(edge);
    for (const Square* s : {&e.low, &e.high})
      for (int side = 0; side < 4 && exists(*s); ++side)
        level = std::max(level, flooredLevel(edgeAt(*s, side)) - kMostBeyondNeighbour);
    return edges_[edge].level = level;
  }
  uint32_t edgeBetween(const Square& low, const Square& high) { return edgeAt(high, low.x != high.x ? kLeft : kTop); }
  // What a square's inside is drawn with if all its sides are whole.
  int innerLevel(const Square& s) {
    const uint64_t k = key(s);
    if (uint32_t found = inner_index_.find(k); found != IndexTable::kNone) return inner_[found];
    int level = 0;
    for (int side = 0; side < 4; ++side) level = std::max(level, levelOf(edgeAt(s, side)));
    inner_index_.insert(k, static_cast<uint32_t>(inner_.size()));
    inner_.push_back(level);
    return level;
  }
  double ofWidest(const Square& s) {
    const Box box = boxOf(s);
    return 2 * std::max(box.half.x, box.half.y) * pxPerMm(box) / max_node_px_;
  }
  int progressOf(const Square& s) { return splitProgress(s.level, innerLevel(s), ofWidest(s)); }

  // ---- the tree
  bool isResident(const Square& page) const {
    return page.level == 0 || (page.level <= domain_.relief_depth && page.level <= static_cast<int>(kMaxNodeLevel) &&
                               resident_.count(nodeId(page)) != 0);
  }
  int residentLevel(const Square& s, int inherited) const {
    if (flat_ || inherited == kAnyLevel) return kAnyLevel;
    if (!isResident(s)) return inherited;
    return s.level == domain_.relief_depth ? kAnyLevel : s.level + kPageLog2;
  }
  uint32_t findNode(const Square& s) const { return node_index_.find(key(s)); }
  void addNode(const Square& s, int resident_level, int needs_level = 0) {
    if (culled(boxOf(s))) return;  // a node that is not in the table is not drawn
    node_index_.insert(key(s), static_cast<uint32_t>(nodes_.size()));
    Node n;
    n.square = s;
    n.resident_level = static_cast<uint8_t>(resident_level);
    n.needs_level = static_cast<int8_t>(needs_level);
    nodes_.push_back(n);
  }
  void addRoots(uint32_t first, uint32_t last) {
    int64_t side = int64_t{1} << unit_log2_;
    double z0 = flat_ ? 0 : domain_.relief_offset_mm, z1 = flat_ ? 0 : z0 + 65535 * domain_.relief_scale_mm;
    int64_t a = first * side, b = last * side;
    if (culled(domain_.alongX() ? boxOf(a, 0, b, side, z0, z1) : boxOf(0, a, side, b, z0, z1))) return;
    if (last - first > 1) {
      uint32_t middle = first + (last - first) / 2;
      addRoots(first, middle);
      addRoots(middle, last);
      return;
    }
    Square root{0, domain_.alongX() ? first : 0, domain_.alongX() ? 0 : first};
    addNode(root, flat_ || assume_resident_ || domain_.relief_depth == 0 ? kAnyLevel : kPageLog2);
  }

  template <class F>
  void forChildren(const Square& s, F&& f) const {
    for (int cy = 0; cy < 2; ++cy)
      for (int cx = 0; cx < 2; ++cx)
        if (Square c{s.level + 1, 2 * s.x + cx, 2 * s.y + cy}; exists(c)) f(c);
  }
  // Children need at least the grid of level 1: whole units, and samples for it.
  bool maySplit(uint32_t index) {
    Node& n = nodes_[index];
    if (n.square.level + 2 > unit_log2_) return false;
    if (n.resident_level >= n.square.level + 2) return true;
    bool all = true;
    forChildren(n.square, [&](const Square& c) { all = all && isResident(c); });
    if (!all) {
      limited_tree_ = true;
      n.needs_level = std::max(n.needs_level, static_cast<int8_t>(n.square.level + 2));
      n.blocked = true;
    }
    return all;
  }
  bool requestsSplit(uint32_t index) {
    const Node n = nodes_[index];
    if (ofWidest(n.square) > 1) return true;
    if (flat_) return false;
    int limit = n.square.level + kMaxSplitLevel;
    bool wants = false;
    for (int side = 0; side < 4 && !wants; ++side) wants = levelOf(edgeAt(n.square, side)) > limit * kOneLevel;
    nodes_[index].rough = wants;
    if (!wants || n.resident_level > limit) return wants;
    // Without finer pages smaller nodes would only cut the same triangles into more instances.
    bool finer = false;
    forChildren(n.square, [&](const Square& c) { finer = finer || isResident(c); });
    limited_tree_ = limited_tree_ || !finer;
    return finer;
  }
  bool split(uint32_t index) {
    if (nodes_[index].state == State::kSplit) return true;
    if (!maySplit(index)) return false;
    const Square s = nodes_[index].square;
    for (int side = 0; side < 4 && s.level > 0; ++side) {
      Square other = neighbour(s, side);
      if (!exists(other) || findNode(other) != IndexTable::kNone) continue;
      uint32_t coarser = findNode(other.ancestor(s.level - 1));
      if (coarser == IndexTable::kNone || nodes_[coarser].state == State::kSplit) continue;  // out of view
      if (!split(coarser)) {
        nodes_[index].blocked = nodes_[coarser].blocked;
        return false;
      }
    }
    nodes_[index].state = State::kSplit;
    int inherited = nodes_[index].resident_level;
    // The pages that this split rests on must stay wanted, even if the children, whose edges are known better, want
    // less: else they would be evicted, the split undone, and the pages asked for again.
    int needs = s.level + (nodes_[index].rough ? kMaxSplitLevel + 1 : 2);
    size_t before = nodes_.size();
    forChildren(s, [&](const Square& c) { addNode(c, residentLevel(c, inherited), needs); });
    if (nodes_.size() == before) {  // known better, it is out of view: it still wants the pages that tell
      nodes_[index].barren = true;
      nodes_[index].needs_level = static_cast<int8_t>(needs);
    }
    return true;
  }
  // Builds the tree for a scaled error. Whether it fits is asked of the tree that all pages together would give: else
  // arriving pages would coarsen the error, the pages would no longer be wanted, be evicted, and the error refine
  // again.
  bool fits(double asked_px, double scale, bool anyway) {
    error_px_ = asked_px * scale;
    max_node_px_ = kMaxNodePx * scale;
    edges_.clear();
    edge_index_.clear();
    inner_.clear();
    inner_index_.clear();
    memory_.again();
    if (!refine(anyway)) return false;
    if (!limited_tree_ || anyway) return true;
    std::vector<Node> nodes;
    IndexTable index;
    nodes.swap(nodes_);
    std::swap(index, node_index_);
    assume_resident_ = true;
    bool whole_tree_fits = refine(false);
    assume_resident_ = false;
    nodes.swap(nodes_);
    std::swap(index, node_index_);
    return whole_tree_fits;
  }
  // False: too many nodes for this error.
  bool refine(bool anyway) {
    nodes_.clear();
    node_index_.clear();
    limited_tree_ = false;
    addRoots(0, domain_.patchCount());
    size_t limit = nodes_.size() + kMaxLodNodes;
    if (!camera_.valid) return true;
    for (uint32_t i = 0; i < nodes_.size(); ++i) {
      if (nodes_.size() > limit) return anyway;
      if (nodes_[i].state == State::kLeaf && requestsSplit(i)) split(i);
    }
    return true;
  }

  // ---- the answer
  // One edge: as wanted, as far as both sides have samples for it.
  int edgeLevel(uint32_t edge, int base_level, int cap, int resident_a, int resident_b, bool blocked) {
    const int wanted = levelOf(edge), available = std::min(resident_a, resident_b);
    const int level = std::max(std::min(wanted, std::min({available, base_level + cap, unit_log2_}) * kOneLevel),
                               base_level * kOneLevel);
    Edge& e = edges_[edge];
    if (level < wanted && (available * kOneLevel < wanted || blocked) && !e.counted) {
      e.counted = true;
      ++limited_;
    }
    return level;
  }
  void levelSides(Node& n) {
    n.drawn = n.square.level * kOneLevel;
    for (int side = 0; side < 4; ++side) {
      const Square& s = n.square;
      Square other = neighbour(s, side);
      auto whole = [&](int cap, const Node* neighbour_node) {
        uint32_t e = edgeAt(s, side);
        n.edge[side] = {e, e};
        const int level =
            edgeLevel(e, s.level, cap, n.resident_level, neighbour_node ? neighbour_node->resident_level : kAnyLevel,
                      n.blocked || (neighbour_node && neighbour_node->blocked));
        n.levels[side] = {level, kWholeSide};
        n.drawn = std::max(n.drawn, level);
      };
      if (!exists(other)) {
        whole(kMaxGridLevel, nullptr);
        continue;
      }
      if (uint32_t same = findNode(other); same != IndexTable::kNone) {
        if (nodes_[same].state == State::kLeaf) {
          whole(kMaxGridLevel, &nodes_[same]);
          continue;
        }
        // Two half edges, each the whole edge of a finer node (or of nothing, if that one is out of view).
        bool upright = side == kLeft || side == kRight;
        for (int half = 0; half < 2; ++half) {
          Square mine{s.level + 1, 2 * s.x + (upright ? (side == kRight) : half),
                      2 * s.y + (upright ? half : (side == kBottom))};
          if (!exists(mine))
            mine = Square{s.level + 1, 2 * s.x + (upright && side == kRight), 2 * s.y + (!upright && side == kBottom)};
          uint32_t e = edgeAt(mine, side);
          uint32_t finer = findNode(neighbour(mine, side));
          const Node* f = finer != IndexTable::kNone ? &nodes_[finer] : nullptr;
          assert(!f || f->state == State::kLeaf);
          const int level = edgeLevel(e, s.level + 1, kMaxGridLevel - 1, n.resident_level,
                                      f ? f->resident_level : kAnyLevel, n.blocked || (f && f->blocked));
          n.edge[side][half] = e;
          n.levels[side][half] = level;
          n.drawn = std::max(n.drawn, level);
        }
        continue;
      }
      const Node* coarser = nullptr;
      if (s.level > 0)
        if (uint32_t up = findNode(other.ancestor(s.level - 1));
            up != IndexTable::kNone && nodes_[up].state == State::kLeaf)
          coarser = &nodes_[up];
      whole(coarser ? kMaxGridLevel - 1 : kMaxGridLevel, coarser);
    }
  }
  // A grid has four cells at least; with geomorph its middle comes from where a single cell has it.
  void levelInside(Node& n) {
    n.grid_level = static_cast<uint8_t>(std::max(1, wholeLevels(n.drawn) - n.square.level));
    if (!morph_) n.drawn = (n.square.level + n.grid_level) * kOneLevel;
  }
  void setEdges(PatchInstance& p, const Node& n) const {
    p.morph = wholeLevels(n.drawn) > n.square.level ? morphOf(n.drawn) : 0;
    for (size_t side = 0; side < 4; ++side) {
      const bool whole = n.levels[side][1] == kWholeSide;
      for (size_t half = 0; half < (whole ? 1 : 2); ++half) {
        p.edges[side][half] =
            static_cast<uint8_t>(wholeLevels(n.levels[side][half]) - n.square.level - (whole ? 0 : 1));
        p.edge_morph[side][half] = slideOf(n.levels[side][half]);
      }
      if (whole) p.edges[side][1] = PatchInstance::kWholeEdge;
    }
  }
  // Of the surface through the vertices of a level, within a square.
  Deviation deviationOf(const Square& s, int level, double range_mm) {
    if (level - kPageLog2 >= domain_.relief_depth) return {};
    Deviation d =
        (level < kPageLog2 ? Deviation::eitherSide(range_mm) : deviationWithin(s, level - kPageLog2)).atMost(range_mm);
    d.aside_mm = 0;
    return d;
  }
  // Of the one that is drawn: between those of two levels, in one proportion everywhere.
  Deviation deviationAt(const Square& s, int desired, double range_mm) {
    const int level = wholeLevels(desired);
    return betweenLevels(
        desired, [&] { return deviationOf(s, level - 1, range_mm); }, deviationOf(s, level, range_mm));
  }
  Deviation deviationOnEdge(const Square& s, int desired, int inside, double range_mm) {
    const int level = wholeLevels(desired);
    return betweenLevels(
        desired, [&] { return deviationOf(s, level - 1, range_mm); },
        slidAlong(desired, inside, deviationOf(s, level, range_mm)));
  }
  // ---- what is promised, by parts (bound_search.h)
  struct Part {
    double px = 0;
    Square square;
    uint32_t node = 0;
  };
  // At an edge with a coarser level, or one that goes another part of the way, all vertices lie where that one's
  // deviation may lead to from its surface, which is flat within each drawn triangle; so does the finest surface. Never
  // more than the range of heights.
  Part partOf(uint32_t index, const Square& s) {
    const Node& n = nodes_[index];
    const int depth = s.level - n.square.level;
    const int edge =
        coarsestAround(n.levels, n.drawn, n.square.level, depth, static_cast<uint32_t>(s.x - (n.square.x << depth)),
                       static_cast<uint32_t>(s.y - (n.square.y << depth)));
    // Of heights, in a square around the cells of the coarsest level.
    const HeightBounds h = heights(s.ancestor(std::clamp(edge / kOneLevel, n.square.level, s.level)));
    const double range_mm = double{h.max_mm} - h.min_mm;
    const Deviation own = deviationAt(s, n.drawn, range_mm), there = deviationOnEdge(s, edge, n.drawn, range_mm);
    const double rounded = morph_ ? 1 + 1.0 / kOneLevel : 1;  // heights between levels
    double mm = own.mm * rounded;
    const bool apart = edge < n.drawn || edge % kOneLevel != 0;
    if (apart) mm = std::max(mm, std::min(2 * there.mm, there.between_mm * rounded));
    mm = std::min(mm, range_mm) * std::abs(exaggerate_);
    Box box = boxOf(s);
    if (depth > 0 && apart) box.half.z += mm;  // triangles may reach beyond the part
    return {culled(box) ? 0 : mm * pxPerMm(box), s, index};
  }
  double promisedPx() {
    return searchBound(search_, [&](const Part& part, auto add) {
      if (part.square.level >= wholeLevels(nodes_[part.node].drawn)) return false;
      forChildren(part.square, [&](const Square& child) { add(partOf(part.node, child)); });
      return true;
    });
  }
  NodeId reliefPage(const Node& n) const {
    int needed = n.square.level + n.grid_level;
    int level = std::clamp(needed - kPageLog2, 0, domain_.relief_depth);
    for (; level < std::min(n.square.level, domain_.relief_depth); ++level)
      if (isResident(n.square.ancestor(level))) break;
    assert(isResident(n.square.ancestor(level)));
    return nodeId(n.square.ancestor(level));
  }
  // The page that a node would like, the one it uses, and a ancestor stride above: descending needs a resident page at
  // least every few levels, and the ancestor stride is what a missing page falls back to (1.6 % more pages).
  void addRequests(const Node& n, int wanted_level, const NodeId& used) {
    const Square& s = n.square;
    float priority = camera_.priority(boxOf(s).centre);
    int finest = std::min(s.level, domain_.relief_depth);
    int level = std::clamp(wanted_level - kPageLog2, 0, finest);
    for (int at = level; at >= 0; at = at > 0 ? std::max(0, at - kRequestAncestorStride) : -1)
      addRequest(s.ancestor(at), priority);
    if (static_cast<int>(used.level) != level) addRequest(s.ancestor(static_cast<int>(used.level)), priority);
  }
  void addRequest(const Square& page, float priority) {
    uint64_t k = key(page);
    uint32_t found = request_index_.find(k);
    if (found == IndexTable::kNone) {
      request_index_.insert(k, static_cast<uint32_t>(requests_.size()));
      requests_.push_back({nodeId(page), priority});
    } else {
      requests_[found].priority = std::min(requests_[found].priority, priority);
    }
  }

  PlanarLodResult finish() {
    PlanarLodResult result;
    for (Node& n : nodes_)
      if (n.state == State::kLeaf) levelSides(n), levelInside(n);
    for (uint32_t i = 0; i < nodes_.size(); ++i) {
      const Node& n = nodes_[i];
      if (n.barren && !flat_ && camera_.valid) addRequests(n, n.needs_level, nodeId(n.square.ancestor(0)));
      if (n.state != State::kLeaf) continue;
      PatchInstance p;
      p.node = nodeId(n.square);
      int shift = unit_log2_ - n.square.level;
      p.x0 = static_cast<int32_t>(n.square.x << shift);
      p.y0 = static_cast<int32_t>(n.square.y << shift);
      p.grid_level = n.grid_level;
      p.step_log2 = static_cast<uint8_t>(shift - n.grid_level);
      setEdges(p, n);
      p.relief_page = {p.node.patch, 0, 0, 0};
      if (!flat_) {
        p.relief_page = reliefPage(n);
        int wanted = std::max<int>(n.square.level + n.grid_level, n.needs_level);
        for (int side = 0; side < 4; ++side) {
          bool halves = n.levels[side][1] != kWholeSide;
          for (int half = 0; half < (halves ? 2 : 1); ++half) {
            const Edge& e = edges_[n.edge[side][half]];
            wanted = std::max(wanted, wholeLevels(morph_ ? e.level : e.wanted));
          }
        }
        search_.push_back(partOf(i, n.square));
        if (camera_.valid) addRequests(n, wanted, p.relief_page);
      }
      result.instances.push_back(p);
    }
    if (camera_.valid) result.max_error_px = promisedPx();
    result.requests = std::move(requests_);
    sortLists(result);
    result.limited_by_residency = limited_;
    result.error_px = error_px_;
    return result;
  }

  const PlanarDomain& domain_;
  const ReliefOracle& oracle_;
  const ReliefSet& resident_;
  int unit_log2_ = 0;  // U: log2 of a patch's side in units
  int64_t width_units_ = 0, height_units_ = 0;
  double mm_per_unit_ = 1;
  const LodCamera camera_;
  DesiredLevelMemory& memory_;
  bool flat_ = false, morph_ = false;
  double exaggerate_ = 1, error_px_ = 1, max_node_px_ = kMaxNodePx, min_cell_px_ = 0, hysteresis_ = 0;
  // The tree, and what was looked up for it.
  std::vector<Node> nodes_;
  std::vector<Edge> edges_;
  std::vector<HeightBounds> bounds_;
  std::vector<PartErrors> parts_;
  std::vector<ReliefRequest> requests_;
  std::vector<Part> search_;
  IndexTable node_index_, edge_index_, bounds_index_, parts_index_, request_index_, inner_index_;
  std::vector<int> inner_;
  bool assume_resident_ = false;  // what would be drawn if every page were here
  bool limited_tree_ = false;     // a split did not happen for want of pages
  uint32_t limited_ = 0;
};

}  // namespace

PlanarLodResult selectPlanarLod(const PlanarDomain& domain, const ReliefOracle& oracle, const LodView& view,
                                const ReliefSet& resident) {
  DesiredLevelMemory memory;
  return Selection(domain, oracle, view, resident, memory).run();
}

struct PlanarLod::Impl {
  PlanarDomain domain;
  std::shared_ptr<const ReliefOracle> oracle;
  DesiredLevelMemory memory;
};
PlanarLod::PlanarLod(const PlanarDomain& domain, std::shared_ptr<const ReliefOracle> oracle)
    : impl_(new Impl{domain, std::move(oracle), {}}) {}
PlanarLod::~PlanarLod() = default;
PlanarLodResult PlanarLod::select(const LodView& view, const ReliefSet& resident) {
  return Selection(impl_->domain, *impl_->oracle, view, resident, impl_->memory).run();
}

}  // namespace relievo
