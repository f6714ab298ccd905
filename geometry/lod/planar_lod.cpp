// planar_lod.cpp - see the header; the selection is that of quadtree_lod.h. Here is its forest: a flat artwork as a
// strip of square patches. Levels are held by edges: what one wants is a function of the segment's two squares, whose
// heights and errors are those of relief pages, and of the box around both.
#include "geometry/lod/planar_lod.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/lod/page_facts.h"
#include "geometry/lod/quadtree_lod.h"
#include "src/base/key_index.h"

namespace relievo {
namespace {

struct Box {
  glm::dvec3 centre{0}, half{0};
};
struct StripSquare : SquareInView {
  int level = 0;
  Box box;
  double px_per_mm = 0;
};

class StripForest : public ForestView<StripForest, StripSquare> {
 public:
  static constexpr int kLeastGrid = 1;
  static constexpr bool kPlane = true, kNeedsAddUp = false;

  StripForest(const FlatDomain& domain, const ReliefOracle& oracle) : domain_(domain), oracle_(oracle) {
    unit_log2_ = domain.texture_depth + kPageLog2 + kUnitsPerTexelLog2;
    width_units_ = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
    height_units_ = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
    mm_per_unit_ = domain.mm_per_px / (1 << kUnitsPerTexelLog2);
  }

  // ---- places
  uint32_t patchCount() const { return domain_.patchCount(); }
  int unitLog2() const { return unit_log2_; }
  int reliefDepth() const { return domain_.relief_depth; }
  static bool hasTails() { return false; }
  static bool asksForRoots() { return true; }
  static bool isHidden(uint32_t /*patch*/) { return false; }
  static bool backsAreHidden() { return false; }
  bool hasUnitsToSplit(const Square& s) const { return s.level + 2 <= unit_log2_; }
  // By the place along the whole strip.
  uint64_t key(const Square& s) const {
    const uint64_t along = (uint64_t{s.patch} << s.level) + (domain_.alongX() ? s.x : s.y);
    const uint64_t across = domain_.alongX() ? s.y : s.x;
    return (static_cast<uint64_t>(s.level) << 58) | (along << 28) | across;
  }
  bool exists(const Square& s) const { return left(s) < width_units_ && top(s) < height_units_; }
  bool neighbour(const Square& s, int side, Square& out) const { return step(s, side, out) && exists(out); }
  std::array<int32_t, 2> originUnits(const Square& s) const {
    return {static_cast<int32_t>(left(s)), static_cast<int32_t>(top(s))};
  }

  // ---- the view
  void beginView(const LodSettings& settings) {
    facts_.forgetSome();
    ForestView::beginView(settings);
  }
  void beginTry(double error_px, double max_node_px) {
    ForestView::beginTry(error_px, max_node_px);
    edges_.clear();
    edge_index_.clear();
  }
  // Culled as a binary tree of ranges.
  template <class Add>
  void addRoots(Add&& add) const {
    addRootsOf(0, patchCount(), add);
  }
  template <class Add>
  static void addAround(uint32_t /*patch*/, Add&& /*add*/) {}  // every root in view is a node
  StripSquare look(const Square& s) {
    StripSquare in;
    in.level = s.level;
    in.box = boxOf(s);
    in.culled = culled(in.box);
    if (in.culled && !settings_.morph) return in;
    in.px_per_mm = pxPerMm(in.box);
    in.width_px = 2 * std::max(in.box.half.x, in.box.half.y) * in.px_per_mm;
    return in;
  }
  glm::dvec3 centre(const Square& /*s*/, uint32_t info) const { return infos_[info].box.centre; }

  // ---- levels
  int sideLevel(const Square& s, int side) { return levelOf(edgeAt(s, side)); }
  static int levelWithin(const Square& s) { return s.level * kOneLevel; }
  int mostOfChildren(const Square& s) { return innerLevel(s); }
  double cellPx(const StripSquare& in) const { return in.culled ? 0 : cellPx(in.box, in.level); }
  double childErrorPx(const StripSquare& in, const Square& child, int level) {
    const HeightBounds h = heights(child);
    return deviationOf(child, level, double{h.max_mm} - h.min_mm).mm * std::abs(settings_.exaggerate) * in.px_per_mm;
  }

  // At an edge with a coarser level, or one that goes another part of the way, all vertices lie where that one's
  // deviation may lead to from its surface, which is flat within each drawn triangle; so does the finest surface. Never
  // more than the range of heights.
  double boundPx(const Square& s, const DrawnNode& node) {
    if (settings_.flat) return 0;
    // Of heights, in a square around the cells of the coarsest level.
    const HeightBounds h = heights(s.ancestor(std::clamp(node.edge / kOneLevel, node.level, s.level)));
    const double range_mm = double{h.max_mm} - h.min_mm;
    auto of = [&](int level) { return deviationOf(s, level, range_mm); };
    const Deviation own = deviationInside(node.inside, of), there = deviationOnEdge(node.edge, node.inside, of);
    const double rounded = settings_.morph ? 1 + 1.0 / kOneLevel : 1;  // heights between levels
    double mm = own.mm * rounded;
    const bool apart = node.edge < node.inside || node.edge % kOneLevel != 0;
    if (apart) mm = std::max(mm, std::min(2 * there.mm, there.between_mm * rounded));
    mm = std::min(mm, range_mm) * std::abs(settings_.exaggerate);
    Box box = boxOf(s);
    if (s.level > node.level && apart) box.half.z += mm;  // triangles may reach beyond the part
    return culled(box) ? 0 : mm * pxPerMm(box);
  }

 private:
  friend ForestView;
  // One segment between two squares of one level (the finer node's whole edge).
  struct Edge : LevelHolder {
    Square low, high;  // the squares left of (above) and right of (below) it; beyond the border neither exists
    bool upright = false, has_low = false, has_high = false;
    double px_per_mm = 0;  // what a millimetre near it can be on the screen
    double range_mm = 0;   // of the heights in both squares
  };

  // ---- places
  int64_t left(const Square& s) const { return unitsAt(s, s.x, domain_.alongX()); }
  int64_t top(const Square& s) const { return unitsAt(s, s.y, !domain_.alongX()); }
  int64_t unitsAt(const Square& s, uint32_t place, bool along) const {
    return (along ? int64_t{s.patch} << unit_log2_ : 0) + (int64_t{place} << (unit_log2_ - s.level));
  }
  // To the next place, whether there is anything or not. False: left of or above all places.
  bool step(const Square& s, int side, Square& out) const {
    const bool upright = side == kLeft || side == kRight, along = upright == domain_.alongX();
    const uint32_t count = 1u << s.level;
    out = s;
    uint32_t& place = upright ? out.x : out.y;
    if (side == kRight || side == kBottom) {
      if (++place == count && along) place = 0, ++out.patch;
      return true;
    }
    if (place == 0 && (!along || s.patch == 0)) return false;
    if (place == 0) place = count, --out.patch;
    --place;
    return true;
  }

  // ---- heights
  const HeightBounds& pageBounds(const Square& page) {
    return facts_.bounds(key(page), [&] {
      HeightBounds b = oracle_.bounds(page.id());
      if (!(b.min_mm <= b.max_mm) || !std::isfinite(b.min_mm) || !std::isfinite(b.max_mm)) {
        b.min_mm = static_cast<float>(domain_.relief_offset_mm);
        b.max_mm = static_cast<float>(domain_.relief_offset_mm + 65535 * domain_.relief_scale_mm);
        if (b.min_mm > b.max_mm) std::swap(b.min_mm, b.max_mm);
      }
      if (!(b.error_mm >= 0 && b.error_mm <= b.max_mm - b.min_mm)) b.error_mm = b.max_mm - b.min_mm;
      return b;
    });
  }
  HeightBounds heights(const Square& s) { return pageBounds(s.ancestor(std::min(s.level, domain_.relief_depth))); }
  // Of the surface through the samples of a page level, over a square: what the page knows of its parts.
  Deviation deviationWithin(const Square& s, int page_level) {
    const Square page = s.ancestor(std::min(page_level, s.level));
    return facts_.within(s, page, key(page), oracle_, Deviation::eitherSide(pageBounds(page).error_mm));
  }
  // Of the surface through the vertices of a level, within a square.
  Deviation deviationOf(const Square& s, int level, double range_mm) {
    if (level - kPageLog2 >= domain_.relief_depth) return {};
    Deviation d =
        (level < kPageLog2 ? Deviation::eitherSide(range_mm) : deviationWithin(s, level - kPageLog2)).atMost(range_mm);
    d.aside_mm = 0;
    return d;
  }

  Box boxOf(int64_t x0, int64_t y0, int64_t x1, int64_t y1, double z0_mm, double z1_mm) const {
    x1 = std::min(x1, width_units_);
    y1 = std::min(y1, height_units_);
    double left = (static_cast<double>(x0) - 0.5 * static_cast<double>(width_units_)) * mm_per_unit_;
    double right = (static_cast<double>(x1) - 0.5 * static_cast<double>(width_units_)) * mm_per_unit_;
    double top = (0.5 * static_cast<double>(height_units_) - static_cast<double>(y0)) * mm_per_unit_;
    double bottom = (0.5 * static_cast<double>(height_units_) - static_cast<double>(y1)) * mm_per_unit_;
    z0_mm *= settings_.exaggerate;
    z1_mm *= settings_.exaggerate;
    return {{0.5 * (left + right), 0.5 * (top + bottom), 0.5 * (z0_mm + z1_mm)},
            {0.5 * (right - left), 0.5 * (top - bottom), 0.5 * std::abs(z1_mm - z0_mm)}};
  }
  Box boxOf(const Square& s) {
    const HeightBounds h = settings_.flat ? HeightBounds{} : heights(s);
    const int64_t side = int64_t{1} << (unit_log2_ - s.level);
    return boxOf(left(s), top(s), left(s) + side, top(s) + side, h.min_mm, h.max_mm);
  }

  // ---- the view
  static double extent(const glm::dvec4& row, const Box& b) {
    return std::abs(row.x) * b.half.x + std::abs(row.y) * b.half.y + std::abs(row.z) * b.half.z;
  }
  bool culled(const Box& b) const {
    for (const glm::dvec4& plane : settings_.camera.planes) {
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
  // neighbourhood shows of it, and never for nothing (LodCamera::least_sine). In front of the near plane nothing is
  // drawn. Orthographic, it is the same sine for all.
  double pxPerMm(const Box& b) const {
    const glm::dvec3 &forward = settings_.camera.forward, up(0, 0, 1);
    if (settings_.camera.orthographic)
      return settings_.camera.scale * std::max(settings_.camera.least_sine, glm::length(up - forward.z * forward));
    double centre_depth = LodCamera::value(settings_.camera.depth_row, b.centre);
    double depth = std::max(settings_.camera.near_mm, centre_depth - extent(settings_.camera.depth_row, b));
    glm::dvec3 d = b.centre - settings_.camera.eye;
    double reach = glm::length(b.half);
    double aside = std::sqrt(std::max(0.0, glm::dot(d, d) - centre_depth * centre_depth)) + reach;
    double secant = std::min(settings_.camera.max_secant, std::sqrt(1 + (aside / depth) * (aside / depth)));
    double factor = secant;
    if (centre_depth > settings_.camera.near_mm) {
      double at_centre = glm::length(up - forward.z * d / centre_depth);
      double wholly = std::sqrt(1 + (aside / depth) *
                                        (aside / depth));  // not cut at the picture's corner: the box may reach beyond
      factor = std::min(
          secant, std::max(settings_.camera.least_sine, at_centre + std::abs(forward.z) * reach * wholly / depth));
    }
    return settings_.camera.scale / depth * factor;
  }

  // How wide, seen head on, a cell between vertices of this level is on the screen where the box is nearest.
  double cellPx(const Box& b, int level) const {
    const LodCamera& camera = settings_.camera;
    const double cell_mm = std::ldexp(domain_.mm_per_px, unit_log2_ - kUnitsPerTexelLog2 - level);
    if (camera.orthographic) return cell_mm * camera.scale;
    return cell_mm * camera.scale /
           std::max(camera.near_mm, LodCamera::value(camera.depth_row, b.centre) - extent(camera.depth_row, b));
  }
  template <class Add>
  void addRootsOf(uint32_t first, uint32_t last, Add& add) const {
    const int64_t side = int64_t{1} << unit_log2_, a = first * side, b = last * side;
    const double z0 = settings_.flat ? 0 : domain_.relief_offset_mm,
                 z1 = settings_.flat ? 0 : z0 + 65535 * domain_.relief_scale_mm;
    if (culled(domain_.alongX() ? boxOf(a, 0, b, side, z0, z1) : boxOf(0, a, side, b, z0, z1))) return;
    if (last - first > 1) {
      const uint32_t middle = first + (last - first) / 2;
      addRootsOf(first, middle, add);
      addRootsOf(middle, last, add);
      return;
    }
    add(Square{first, 0, 0, 0});
  }

  // ---- edges
  // The error of a surface through the samples of an absolute level: from the page of that level.
  double errorMm(const Edge& e, int level) {
    const int page_level = level - kPageLog2;
    if (page_level >= domain_.relief_depth) return 0;
    if (page_level < 0) return e.range_mm;  // coarser than a root page: only the range is known
    double error = 0;
    if (e.has_low) error = deviationWithin(e.low, page_level).mm;
    if (e.has_high) error = std::max(error, deviationWithin(e.high, page_level).mm);
    return std::min(error, e.range_mm);
  }
  double errorPx(const Edge& e, int level) { return errorMm(e, level) * std::abs(settings_.exaggerate) * e.px_per_mm; }
  // A function of the segment alone: its two squares, never of who asks.
  uint32_t edgeAt(const Square& s, int side) {
    Edge e;
    e.upright = side == kLeft || side == kRight;
    e.high = s;
    if (side == kRight || side == kBottom) step(s, side, e.high);
    const uint64_t k = key(e.high) * 2 + (e.upright ? 0 : 1);
    if (const uint32_t found = edge_index_.find(k); found != KeyIndex::kNone) return found;
    e.has_high = exists(e.high);
    e.has_low = neighbour(e.high, e.upright ? kLeft : kTop, e.low);
    e.wanted = s.level * kOneLevel;
    if (!settings_.flat) e.wanted = memory_.held(k, desiredOf(e));
    edges_.push_back(e);
    return edge_index_.findOrAdd(k);
  }
  LevelRange desiredOf(Edge& e) {
    double z0 = std::numeric_limits<double>::max(), z1 = std::numeric_limits<double>::lowest(), widest_px = 0;
    for (const auto& [square, is_there] : {std::pair{e.low, e.has_low}, std::pair{e.high, e.has_high}}) {
      if (!is_there) continue;
      const HeightBounds h = heights(square);
      z0 = std::min<double>(z0, h.min_mm);
      z1 = std::max<double>(z1, h.max_mm);
      e.range_mm = std::max<double>(e.range_mm, double{h.max_mm} - h.min_mm);
      if (settings_.morph) widest_px = std::max(widest_px, infos_[infoOf(square)].width_px);
    }
    const Square& first = e.has_low ? e.low : e.high;
    const Square& last = e.has_high ? e.high : e.low;
    const int64_t side = int64_t{1} << (unit_log2_ - first.level);
    const Box box = boxOf(left(first), top(first), left(last) + side, top(last) + side, z0, z1);
    e.px_per_mm = pxPerMm(box);
    const DesiredLevelView desired{settings_.error_px, settings_.min_cell_px, settings_.hysteresis, settings_.morph};
    return desiredLevel(first.level, first.level + kPageLog2, cellPx(box, first.level),
                        widest_px / settings_.max_node_px, desired, [&](int level) { return errorPx(e, level); });
  }
  int levelOf(uint32_t edge) { return settings_.morph ? heldLevel(edge) : edges_[edge].wanted; }

  // ---- for ForestView: edges hold levels
  LevelHolder& holder(uint32_t edge) { return edges_[edge]; }
  // Of the edge that this one is half of, or of the square that it crosses.
  int floorFromParent(uint32_t edge) {
    const Edge e = edges_[edge];
    if (e.high.level == 0) return 0;
    const int up = e.high.level - 1;
    const Square high = e.high.ancestor(up);
    if (e.has_low && e.low.ancestor(up) == high) return childFloor(up, innerLevel(high), progressOf(high));
    const int from = levelOf(edgeAt(high, e.upright ? kLeft : kTop));
    int progress = exists(high) ? progressOf(high) : 0;
    if (e.has_low) progress = std::max(progress, progressOf(e.low.ancestor(up)));
    return childFloor(up, from, progress);
  }
  template <class F>
  void forHoldersAround(uint32_t edge, F&& f) {
    const Edge e = edges_[edge];
    for (int side = 0; side < 4; ++side) {
      if (e.has_low) f(edgeAt(e.low, side));
      if (e.has_high) f(edgeAt(e.high, side));
    }
  }

  const FlatDomain& domain_;
  const ReliefOracle& oracle_;
  int unit_log2_ = 0;  // log2 of a patch's side in units
  int64_t width_units_ = 0, height_units_ = 0;
  double mm_per_unit_ = 1;
  PageFacts facts_;
  std::vector<Edge> edges_;
  KeyIndex edge_index_;
};

}  // namespace

LodResult selectPlanarLod(const FlatDomain& domain, const ReliefOracle& oracle, const LodView& view,
                          const ReliefSet& resident) {
  return QuadtreeLod<StripForest>(domain, oracle).select(view, resident);
}

struct PlanarLod::Impl {
  FlatDomain domain;
  std::shared_ptr<const ReliefOracle> oracle;
  QuadtreeLod<StripForest> lod{domain, *oracle};
};
PlanarLod::PlanarLod(const FlatDomain& domain, std::shared_ptr<const ReliefOracle> oracle)
    : impl_(new Impl{domain, std::move(oracle)}) {}
PlanarLod::~PlanarLod() = default;
LodResult PlanarLod::select(const LodView& view, const ReliefSet& resident) {
  return impl_->lod.select(view, resident);
}

}  // namespace relievo
