// mesh_lod.cpp - see the header; the selection is that of quadtree_lod.h. Here is its forest: the patches of a base
// mesh.
//
// Many patches. All roots are looked at together (mesh_roots.h); where neither a root nor a neighbour needs more than a
// root's grid, it is drawn from there. Only the others become nodes of a tree.
//
// Levels of squares, not of edges: the level that a square wants, W, is the coarsest whose error is small enough on the
// screen, a function of the square alone. An edge between two squares of one level wants the larger of their two; so
// does either side, whoever asks, and neither side's triangles are worse than that side asks for.
//
// Pixels of an error. A point X of the finest surface and the drawn one of the same (u, v), X', lie e apart at most. In
// the picture of a perspective view (x / z, y / z) they lie |(dx, dy) - dz (x, y) / z| / z' <= e sqrt(1 + tan^2 a) / z'
// apart, a the angle of the one that is in the picture off the axis, z' the other one's depth: exact, not a first
// order. Both lie in the hull of the square's displaced corners P + h N, h in {min, max}: for one (u, v) S is on the
// segment between two patches, bilinear or cut, either of which lies in the hull of its corners.
#include "geometry/lod/mesh_lod.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "geometry/lod/mesh_forest.h"
#include "geometry/lod/mesh_roots.h"
#include "geometry/lod/quadtree_lod.h"

namespace relievo {
namespace {

// What a square alone determines. Culled: no error shows; nothing is wanted but with geomorph, where what comes into
// view is as it will be.
struct MeshSquare : SquareInView, LevelHolder {
  Square square;
  PxPerMm px;
  double diameter_mm = 0;
  glm::dvec3 centre{0};
};

class MeshForestView : public ForestView<MeshForestView, MeshSquare> {
 public:
  static constexpr int kLeastGrid = 0;
  static constexpr bool kPlane = false, kNeedsAddUp = true;

  explicit MeshForestView(MeshForest forest) : forest_(std::move(forest)) {}

  // ---- places
  uint32_t patchCount() const { return forest_.patchCount(); }
  int unitLog2() const { return forest_.unitLog2(); }
  int reliefDepth() const { return forest_.hasRelief() ? forest_.depth() : -1; }
  bool hasTails() const { return forest_.hasTails(); }
  bool asksForRoots() const { return forest_.hasTails(); }
  uint64_t key(const Square& s) const { return forest_.key(s); }
  static bool exists(const Square& /*s*/) { return true; }
  bool neighbour(const Square& s, int side, Square& out) const { return forest_.neighbour(s, side, out); }
  bool hasUnitsToSplit(const Square& s) const {
    return s.level + 2 <= forest_.unitLog2() && s.level + 1 <= forest_.maxLevel();
  }
  std::array<int32_t, 2> originUnits(const Square& s) const {
    const int shift = forest_.unitLog2() - s.level;
    return {static_cast<int32_t>(s.x << shift), static_cast<int32_t>(s.y << shift)};
  }

  // ---- the view
  void beginView(const LodSettings& settings) {
    forest_.forgetSome();
    ForestView::beginView(settings);
    if (settings.camera.valid) roots_.prepare(forest_, settings.exaggerate);
  }
  void beginTry(double error_px, double max_node_px) {
    ForestView::beginTry(error_px, max_node_px);
    roots_.evaluate(settings_.camera, {error_px / (1 + settings_.hysteresis), settings_.min_cell_px, max_node_px,
                                       settings_.hide_backs, !settings_.wholeLevels()});
  }
  template <class Add>
  void addRoots(Add&& add) {
    const std::span<const uint8_t> codes = roots_.codes();
    if (!settings_.wholeLevels()) return addRootsOneByOne(codes, add);
    for (uint32_t p = 0; p < codes.size() && roots_.anyCareful(); ++p)
      if (codes[p] & MeshRoots::kCareful) add(rootOf(p)), addAround(p, add);
  }
  template <class Add>
  void addAround(uint32_t patch, Add&& add) {
    for (uint32_t p : roots_.neighbours(patch))
      if (settings_.wholeLevels() || !(roots_.codes()[p] & (MeshRoots::kCulled | MeshRoots::kHidden))) add(rootOf(p));
  }
  MeshSquare look(const Square& s) {
    const int code = s.level == 0 ? roots_.codes()[s.patch] : MeshRoots::kCareful;
    return code & toLookAt() ? evaluate(s) : ofRoot(s, code);
  }
  glm::dvec3 centre(const Square& s, uint32_t info) {
    if (!forest_.hasTails()) return infos_[info].centre;
    // Roots that MeshRoots sufficed for have no centre as yet.
    const SquareHull hull = forest_.hull(s, settings_.exaggerate);
    return 0.5 * (hull[0] + hull[7]);
  }
  bool isHidden(uint32_t patch) const { return (roots_.codes()[patch] & MeshRoots::kHidden) != 0; }
  bool backsAreHidden() const { return roots_.backsAreHidden(); }

  // ---- levels
  int levelWithin(const Square& s) {
    if (settings_.morph) return heldLevel(infoOf(s));
    if (s.level == 0)
      if (const int code = roots_.codes()[s.patch]; !(code & toLookAt())) return (code & MeshRoots::kLevel) * kOneLevel;
    return infos_[infoOf(s)].wanted;
  }
  // At the border that of the square alone.
  int sideLevel(const Square& s, int side) {
    int level = levelWithin(s);
    Square other;
    if (!forest_.neighbour(s, side, other)) return level;
    level = std::max(level, levelWithin(other));
    if (!settings_.morph || s.level == 0 || other.patch != s.patch || other.x >> 1 != s.x >> 1 ||
        other.y >> 1 != s.y >> 1)
      return level;
    // Inside the parent.
    const Square parent = s.ancestor(s.level - 1);
    return std::max(level, childFloor(parent.level, innerLevel(parent), progressOf(parent)));
  }
  int mostOfChildren(const Square& s) { return infos_[infoOf(s)].wanted; }
  static double cellPx(const MeshSquare& in) { return in.width_px; }
  double childErrorPx(const MeshSquare& in, const Square& child, int level) {
    return in.px.of(deviation(child, level, in.diameter_mm));
  }

  // At an edge with a coarser level all vertices lie where that one's deviation may lead to from its surface, which is
  // flat within each drawn triangle; so does the finest surface.
  double boundPx(const Square& s, const DrawnNode& node) {
    const MeshSquare& whole = infos_[node.info];
    const double diameter_mm = whole.diameter_mm;
    const bool snapped = node.edge < node.inside || node.edge % kOneLevel != 0;
    auto of = [&](int level) { return deviation(s, level, diameter_mm); };
    const Deviation own = deviationInside(node.inside, of),
                    edge = snapped ? deviationOnEdge(node.edge, node.inside, of) : Deviation{};
    auto bound = [&](const PxPerMm& px) {
      return std::min(std::max(px.of(own), px.between(edge)), diameter_mm * px.head_on * px.any_way);
    };
    if (s.level == node.level) return whole.culled ? 0 : bound(whole.px);
    // Drawn triangles that reach beyond the part are those with vertices on edges that are coarser; they stay within a
    // square of that one's level.
    const int reaches = std::max(node.level, node.edge / kOneLevel);
    const bool beyond = snapped && s.level > reaches;
    Seen part = seen(s, forest_.hull(s, settings_.exaggerate), beyond ? edge.mm : 0);
    if (beyond && !part.culled) {
      const Square around = s.ancestor(reaches);
      const Seen all = seen(around, forest_.hull(around, settings_.exaggerate), 0);
      part.culled = all.culled;
      part.px.head_on = std::min(part.px.head_on, all.px.head_on);
    }
    return part.culled ? 0 : bound(part.px);
  }

  // ---- what is drawn from the roots' tables
  void leaveOut(uint32_t patch) { roots_.leaveOut(patch); }
  double levelRest() {
    roots_.levelEdges();
    return roots_.maxErrorPx();
  }
  // Both lists are in order; a patch is in one of them alone.
  std::vector<PatchInstance> withRest(const std::vector<PatchInstance>& drawn) const {
    std::vector<PatchInstance> all;
    size_t count = drawn.size(), next = 0;
    for (int level = 0; level <= kMaxGridLevel; ++level) count += roots_.drawn(level).size();
    all.reserve(count);
    for (int level = 0; level <= kMaxGridLevel; ++level) {
      std::span<const MeshRoots::Drawn> roots = roots_.drawn(level);
      for (; next < drawn.size() && drawn[next].grid_level == level; ++next) {
        size_t before = 0;
        while (before < roots.size() && roots[before].patch < drawn[next].node.patch) ++before;
        copyRoots(all, level, roots.first(before));
        roots = roots.subspan(before);
        all.push_back(drawn[next]);
      }
      copyRoots(all, level, roots);
    }
    return all;
  }

 private:
  friend ForestView;

  // ---- roots
  static Square rootOf(uint32_t patch) { return {patch, 0, 0, 0}; }
  // Levels that are continuous, or remembered. Single cells among single cells stay in the roots' tables: not those
  // next to what must be looked at, whose sides are its sides, nor those next to what its levels raise (heldLevel()).
  template <class Add>
  void addRootsOneByOne(std::span<const uint8_t> codes, Add& add) {
    added_.clear();
    auto addOne = [&](const Square& root) {
      const bool added = add(root);
      if (added) added_.push_back(root);
      return added;
    };
    for (uint32_t p = 0; p < codes.size(); ++p) {
      if (codes[p] & (MeshRoots::kCulled | MeshRoots::kHidden)) continue;
      int around = codes[p];
      for (uint32_t n : roots_.neighbours(p)) around |= codes[n];
      if (around & toLookAt()) addOne(rootOf(p));
    }
    for (size_t i = 0; i < added_.size(); ++i)
      if (const Square root = added_[i]; levelWithin(root) > 0) addAround(root.patch, addOne);
  }
  // Roots with one of these in their codes. What is out of view is in no table; with geomorph it is as it will be when
  // it comes into view.
  int toLookAt() const {
    return settings_.wholeLevels() ? MeshRoots::kCareful : MeshRoots::kCareful | MeshRoots::kCulled;
  }
  // It is far away and coarse: nobody asks where it is, nor for the size of its cells.
  MeshSquare ofRoot(const Square& s, int code) const {
    MeshSquare in;
    in.square = s;
    in.culled = (code & MeshRoots::kCulled) != 0;
    in.wanted = (code & MeshRoots::kLevel) * kOneLevel;
    in.px.head_on = roots_.pxPerMm(s.patch);
    in.diameter_mm = roots_.diameter(s.patch);
    return in;
  }
  // Roots of one grid level: what they have in common is copied, what differs is written into a batch that stays in the
  // cache. Put together from its bytes an instance would be read back in words that wait for them.
  void copyRoots(std::vector<PatchInstance>& to, int grid_level, std::span<const MeshRoots::Drawn> roots) const {
    static_assert(std::endian::native == std::endian::little);
    if (roots.empty()) return;
    PatchInstance common;
    if (forest_.hasTails()) common.relief_page.level = kTailLevel;
    common.grid_level = static_cast<uint8_t>(grid_level);
    common.step_log2 = static_cast<uint8_t>(forest_.unitLog2() - grid_level);
    std::array<PatchInstance, 64> batch;
    batch.fill(common);
    while (!roots.empty()) {
      const size_t n = std::min(roots.size(), batch.size());
      for (size_t i = 0; i < n; ++i) {
        batch[i].node.patch = batch[i].relief_page.patch = roots[i].patch;
        // Bytes of segments, each followed by kWholeEdge.
        uint64_t edges = roots[i].segments;
        edges = (edges | edges << 16) & 0x0000FFFF0000FFFF;
        edges = (edges | edges << 8) & 0x00FF00FF00FF00FF;
        batch[i].edges =
            std::bit_cast<decltype(PatchInstance::edges)>(edges | 0x0100010001000100 * PatchInstance::kWholeEdge);
      }
      to.insert(to.end(), batch.begin(), batch.begin() + static_cast<std::ptrdiff_t>(n));
      roots = roots.subspan(n);
    }
  }

  // ---- squares
  // What the view makes of a square, and of all within so many mm of its hull.
  struct Seen {
    bool culled = false;
    glm::dvec3 centre{0};
    double diameter_mm = 0;
    PxPerMm px;
  };
  Seen seen(const Square& s, const SquareHull& hull, double around_mm) const {
    Seen in;
    for (const glm::dvec4& plane : settings_.camera.planes) {
      double reach = std::numeric_limits<double>::lowest(), terms = 0;
      for (const glm::dvec3& p : hull) {
        reach = std::max(reach, LodCamera::value(plane, p));
        terms = std::max(
            terms, std::abs(plane.x * p.x) + std::abs(plane.y * p.y) + std::abs(plane.z * p.z) + std::abs(plane.w));
      }
      // Vertices are computed in floats: what is on the plane stays.
      if (reach + around_mm * glm::length(glm::dvec3(plane)) < -1e-6 * terms) {
        in.culled = true;
        if (!settings_.morph) return in;
        break;
      }
    }
    glm::dvec3 low = hull[0], high = low;
    for (const glm::dvec3& p : hull) low = glm::min(low, p), high = glm::max(high, p);
    in.centre = 0.5 * (low + high);
    in.diameter_mm = glm::length(high - low);
    const MeshForest::NormalRange normals = forest_.normals(s);
    in.px.turn = normals.turn;
    in.px.head_on = settings_.camera.scale;
    if (settings_.camera.orthographic) {
      in.px.along = std::max(
          settings_.camera.least_sine,
          glm::length(normals.axis - glm::dot(normals.axis, settings_.camera.forward) * settings_.camera.forward));
      return in;
    }
    double depth = std::numeric_limits<double>::max(), secant = 1;
    for (const glm::dvec3& p : hull) {
      const double z = LodCamera::value(settings_.camera.depth_row, p) - around_mm;
      depth = std::min(depth, z);
      secant = std::max(secant, z >= settings_.camera.near_mm ? (glm::length(p - settings_.camera.eye) + around_mm) / z
                                                              : settings_.camera.max_secant);
    }
    depth = std::max(settings_.camera.near_mm, depth);
    in.px.head_on = settings_.camera.scale / depth;
    in.px.any_way = in.px.along = std::min(secant, settings_.camera.max_secant);
    // A move along n is |n - (n f) r| to be seen, f forward and r from the eye, as far as 1 ahead; r is known in the
    // hull's middle, and within R of it differs by at most R |r| / depth.
    const double middle = LodCamera::value(settings_.camera.depth_row, in.centre);
    if (!(middle > settings_.camera.near_mm)) return in;
    const glm::dvec3 ray = (in.centre - settings_.camera.eye) / middle;
    const double ahead = glm::dot(normals.axis, settings_.camera.forward), reach = 0.5 * in.diameter_mm + around_mm;
    const double at_centre = glm::length(normals.axis - ahead * ray),
                 differs = std::abs(ahead) * reach * glm::length(ray) / depth;
    in.px.along = std::min(in.px.any_way, std::max(settings_.camera.least_sine, at_centre + differs));
    return in;
  }
  MeshSquare evaluate(const Square& s) {
    MeshSquare in;
    in.square = s;
    in.wanted = s.level * kOneLevel;
    const SquareHull hull = forest_.hull(s, settings_.exaggerate);
    const Seen whole = seen(s, hull, 0);
    in.culled = whole.culled;
    if (in.culled && !settings_.morph) return in;
    in.centre = whole.centre;
    in.diameter_mm = whole.diameter_mm;
    in.px = whole.px;
    double longest = 0;
    for (size_t a : {0, 4})
      for (auto [i, j] : {std::array<size_t, 2>{0, 1}, std::array<size_t, 2>{2, 3}, std::array<size_t, 2>{0, 2},
                          std::array<size_t, 2>{1, 3}})
        longest = std::max(longest, glm::length(hull[a + i] - hull[a + j]));
    in.width_px = longest * whole.px.head_on;
    const int finest = std::min(s.level + kPageLog2, forest_.unitLog2());
    const DesiredLevelView desired{settings_.error_px, settings_.min_cell_px, settings_.hysteresis, settings_.morph};
    in.wanted = memory_.held(forest_.key(s),
                             desiredLevel(s.level, finest, in.width_px, in.width_px / settings_.max_node_px, desired,
                                          [&](int level) { return in.px.of(deviation(s, level, in.diameter_mm)); }));
    return in;
  }
  // Nothing of a square lies further from anything of it.
  Deviation deviation(const Square& s, int level, double diameter_mm) {
    return forest_.deviation(s, level, settings_.exaggerate).atMost(diameter_mm);
  }

  // ---- for ForestView: squares hold levels
  LevelHolder& holder(uint32_t info) { return infos_[info]; }
  int floorFromParent(uint32_t info) {
    const Square s = infos_[info].square;
    if (s.level == 0) return 0;
    const Square parent = s.ancestor(s.level - 1);
    const int from = levelWithin(parent);
    return childFloor(parent.level, from, progressOf(parent));
  }
  template <class F>
  void forHoldersAround(uint32_t info, F&& f) {
    const Square s = infos_[info].square;
    for (int side = 0; side < 4; ++side)
      if (Square other; forest_.neighbour(s, side, other)) f(infoOf(other));
  }

  MeshForest forest_;
  MeshRoots roots_;
  std::vector<Square> added_;
};

}  // namespace

struct MeshLod::Impl {
  QuadtreeLod<MeshForestView> lod;
};

MeshLod::MeshLod(std::shared_ptr<const BaseMesh> base, int relief_depth, double relief_offset_mm,
                 double relief_scale_mm, std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse,
                 bool tails)
    : impl_(new Impl{
          QuadtreeLod<MeshForestView>(MeshForest(std::move(base), relief_depth, relief_offset_mm, relief_scale_mm,
                                                 std::move(oracle), std::move(coarse), tails))}) {}
MeshLod::~MeshLod() = default;

LodResult MeshLod::select(const LodView& view, const ReliefSet& resident) { return impl_->lod.select(view, resident); }

}  // namespace relievo
