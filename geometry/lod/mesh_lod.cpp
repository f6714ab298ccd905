// mesh_lod.cpp - see the header. The order of the work is that of planar_lod.cpp: roots in view, refinement with 2:1
// balance, one level an edge, the list. What differs:
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
// segment between two bilinear patches, either of which lies in the hull of its corners.
//
// Levels of places: a grid of level n on a node of level l has vertices of the absolute level L = l + n, 2^(U - L)
// units apart, U the log2 of a patch's side in units. A relief page of level lr has the samples of absolute level lr
// + 7.
#include "geometry/lod/mesh_lod.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>

#include "geometry/lod/bound_search.h"
#include "geometry/lod/desired_level.h"
#include "geometry/lod/lod_common.h"
#include "geometry/lod/mesh_forest.h"
#include "geometry/lod/mesh_roots.h"

namespace relievo {
namespace {

constexpr uint32_t kNone = IndexTable::kNone;
// savesBySplit(): no coarser grids (log2 of the cells a side) are divided; what three more instances are worth.
constexpr int kLeastDivided = 3;
constexpr int64_t kTrianglesForSplit = 64;

// Of each view anew; kept for its memory.
class Selection {
 public:
  explicit Selection(MeshForest& forest) : forest_(forest) { tree_.root_node.resize(forest.patchCount(), kNone); }

  PlanarLodResult run(const LodView& view, const ReliefSet& resident) {
    camera_ = LodCamera(view);
    resident_ = &resident;
    assume_resident_ = view.as_if_resident;
    flat_ = !view.relief || !forest_.hasRelief();
    exaggerate_ = flat_ ? 0 : std::isfinite(view.exaggerate) ? view.exaggerate : 1.0;
    min_cell_px_ = view.min_cell_px > 0 ? view.min_cell_px : 0;
    hide_backs_ = view.hide_backs;
    limited_ = 0;
    requests_.clear();
    request_index_.clear();
    error_px_ = view.error_px > kMinErrorPx ? view.error_px : kMinErrorPx;
    morph_ = view.morph;
    hysteresis_ = view.hysteresis > 0 && std::isfinite(view.hysteresis) ? view.hysteresis : 0;
    memory_.nextView(hysteresis_);
    if (!camera_.valid) return rootsAlone();
    // The roots' tables know whole levels, and this view alone: then they tell which patches are single cells whatever
    // was before.
    whole_levels_ = !morph_ && hysteresis_ == 0;
    roots_.prepare(forest_, exaggerate_);
    // Four times the error until it fits, then back to twice if that fits too.
    double asked_px = error_px_, scale = 1;
    while (!fits(asked_px, scale, scale > 1e12)) scale *= 4;
    if (scale > 1 && scale <= 1e12 && !fits(asked_px, scale / 2, false)) fits(asked_px, scale, true);
    return finish();
  }

 private:
  enum class State : uint8_t { kLeaf, kSplit };
  // What a square alone determines. Culled: no error shows; nothing is wanted but with geomorph, where what comes into
  // view is as it will be. Levels here and in nodes are desired levels: kOneLevel a level (desired_level.h).
  static constexpr int kUnknown = -1;
  struct Info {
    PxPerMm px;
    double diameter_mm = 0, cell_px = 0;  // cell_px: of the whole square, as one cell
    glm::dvec3 centre{0};
    int wanted = 0;  // absolute
    bool culled = false;
    int floored = kUnknown, level = kUnknown, inner = kUnknown;           // of flooredLevel(), levelOf(), innerLevel()
    std::array<int, 4> children{kUnknown, kUnknown, kUnknown, kUnknown};  // of childLevels()
  };
  struct Node {
    Square square;
    State state = State::kLeaf;
    bool blocked = false;    // would be split if more pages were resident
    bool barren = false;     // split, and no child is in view
    bool rough = false;      // an edge wants more than its grid can give
    int resident_level = 0;  // vertices up to this absolute level have samples
    int needs_level = 0;     // absolute level that must stay (or become) resident, whatever its edges want
    int grid_level = 0;
    int wanted = 0;  // the largest of its edges'
    int drawn = 0;   // of its inside
    uint32_t info = 0;
    std::array<int, 4> across{kUnknown, kUnknown, kUnknown, kUnknown};  // what its sides want, if they are whole
    SideLevels edges{};                                                 // absolute
  };
  struct Tree {
    std::vector<Node> nodes;
    std::vector<uint32_t> root_node;  // by patch; none: drawn from the roots' tables, or culled
    IndexTable index;                 // of the other nodes
    size_t roots = 0;                 // among the nodes
    void clear() {
      for (const Node& n : nodes)
        if (n.square.level == 0) root_node[n.square.patch] = kNone;
      nodes.clear();
      index.clear();
      roots = 0;
    }
  };
  // ---- squares
  uint32_t infoIndex(const Square& s) {
    const uint64_t k = forest_.key(s);
    if (uint32_t found = info_index_.find(k); found != kNone) return found;
    const auto index = static_cast<uint32_t>(infos_.size());
    info_index_.insert(k, index);
    const int code = s.level == 0 ? roots_.codes()[s.patch] : MeshRoots::kCareful;
    infos_.push_back(code & toLookAt() ? evaluate(s) : ofRoot(s.patch, code));
    return index;
  }
  // It is far away and coarse: nobody asks where it is, nor for the size of its cells.
  Info ofRoot(uint32_t patch, int code) const {
    Info in;
    in.culled = (code & MeshRoots::kCulled) != 0;
    in.wanted = (code & MeshRoots::kLevel) * kOneLevel;
    in.px.head_on = roots_.pxPerMm(patch);
    in.diameter_mm = roots_.diameter(patch);
    return in;
  }
  // Roots with one of these in their codes. What is out of view is in no table; with geomorph it is as it will be when
  // it comes into view.
  int toLookAt() const { return whole_levels_ ? MeshRoots::kCareful : MeshRoots::kCareful | MeshRoots::kCulled; }
  int wantedLevel(const Square& s) {
    if (s.level == 0)
      if (const int code = roots_.codes()[s.patch]; !(code & toLookAt())) return (code & MeshRoots::kLevel) * kOneLevel;
    return infos_[infoIndex(s)].wanted;
  }
  // What the view makes of a square, and of all within so many mm of its hull.
  struct Seen {
    bool culled = false;
    glm::dvec3 centre{0};
    double diameter_mm = 0;
    PxPerMm px;
  };
  Seen look(const Square& s, const SquareHull& hull, double around_mm) const {
    Seen seen;
    for (const glm::dvec4& plane : camera_.planes) {
      double reach = std::numeric_limits<double>::lowest(), terms = 0;
      for (const glm::dvec3& p : hull) {
        reach = std::max(reach, LodCamera::value(plane, p));
        terms = std::max(
            terms, std::abs(plane.x * p.x) + std::abs(plane.y * p.y) + std::abs(plane.z * p.z) + std::abs(plane.w));
      }
      // Vertices are computed in floats: what is on the plane stays.
      if (reach + around_mm * glm::length(glm::dvec3(plane)) < -1e-6 * terms) {
        seen.culled = true;
        if (!morph_) return seen;
        break;
      }
    }
    glm::dvec3 low = hull[0], high = low;
    for (const glm::dvec3& p : hull) low = glm::min(low, p), high = glm::max(high, p);
    seen.centre = 0.5 * (low + high);
    seen.diameter_mm = glm::length(high - low);
    const MeshForest::NormalRange normals = forest_.normals(s);
    seen.px.turn = normals.turn;
    seen.px.head_on = camera_.scale;
    if (camera_.orthographic) {
      seen.px.along =
          std::max(kMinSine, glm::length(normals.axis - glm::dot(normals.axis, camera_.forward) * camera_.forward));
      return seen;
    }
    double depth = std::numeric_limits<double>::max(), secant = 1;
    for (const glm::dvec3& p : hull) {
      const double z = LodCamera::value(camera_.depth_row, p) - around_mm;
      depth = std::min(depth, z);
      secant =
          std::max(secant, z >= camera_.near_mm ? (glm::length(p - camera_.eye) + around_mm) / z : camera_.max_secant);
    }
    depth = std::max(camera_.near_mm, depth);
    seen.px.head_on = camera_.scale / depth;
    seen.px.any_way = seen.px.along = std::min(secant, camera_.max_secant);
    // A move along n is |n - (n f) r| to be seen, f forward and r from the eye, as far as 1 ahead; r is known in the
    // hull's middle, and within R of it differs by at most R |r| / depth.
    const double middle = LodCamera::value(camera_.depth_row, seen.centre);
    if (!(middle > camera_.near_mm)) return seen;
    const glm::dvec3 ray = (seen.centre - camera_.eye) / middle;
    const double ahead = glm::dot(normals.axis, camera_.forward), reach = 0.5 * seen.diameter_mm + around_mm;
    const double at_centre = glm::length(normals.axis - ahead * ray),
                 differs = std::abs(ahead) * reach * glm::length(ray) / depth;
    seen.px.along = std::min(seen.px.any_way, std::max(kMinSine, at_centre + differs));
    return seen;
  }
  Info evaluate(const Square& s) {
    Info in;
    in.wanted = s.level * kOneLevel;
    const SquareHull hull = forest_.hull(s, exaggerate_);
    const Seen seen = look(s, hull, 0);
    in.culled = seen.culled;
    if (in.culled && !morph_) return in;
    in.centre = seen.centre;
    in.diameter_mm = seen.diameter_mm;
    in.px = seen.px;
    double longest = 0;
    for (size_t a : {0, 4})
      for (auto [i, j] : {std::array<size_t, 2>{0, 1}, std::array<size_t, 2>{2, 3}, std::array<size_t, 2>{0, 2},
                          std::array<size_t, 2>{1, 3}})
        longest = std::max(longest, glm::length(hull[a + i] - hull[a + j]));
    in.cell_px = longest * seen.px.head_on;
    const int finest = std::min(s.level + kPageLog2, forest_.unitLog2());
    const DesiredLevelView desired{error_px_, min_cell_px_, hysteresis_, morph_};
    in.wanted = memory_.held(forest_.key(s),
                             desiredLevel(s.level, finest, in.cell_px, in.cell_px / max_node_px_, desired,
                                          [&](int level) { return in.px.of(deviation(s, level, in.diameter_mm)); }));
    return in;
  }
  // Nothing of a square lies further from anything of it.
  Deviation deviation(const Square& s, int level, double diameter_mm) {
    return forest_.deviation(s, level, exaggerate_).atMost(diameter_mm);
  }
  // ---- levels with geomorph: continuous functions of the view, of squares alone, so that it does not matter which of
  // them are nodes. A square's own desired level, and what is left of its parent's.
  int flooredLevel(const Square& s) {
    const uint32_t at = infoIndex(s);
    if (infos_[at].floored != kUnknown) return infos_[at].floored;
    int level = infos_[at].wanted;
    if (s.level > 0) {
      const Square parent = s.ancestor(s.level - 1);
      level = std::max(level, childFloor(parent.level, levelOf(parent), progressOf(parent)));
    }
    return infos_[at].floored = level;
  }
  // Not so far below a neighbour's that its edges' middles would be missing when that one has it split.
  int levelOf(const Square& s) {
    if (!morph_) return wantedLevel(s);
    const uint32_t at = infoIndex(s);
    if (infos_[at].level != kUnknown) return infos_[at].level;
    int level = flooredLevel(s);
    for (int side = 0; side < 4; ++side)
      if (Square other; forest_.neighbour(s, side, other))
        level = std::max(level, flooredLevel(other) - kMostBeyondNeighbour);
    return infos_[at].level = level;
  }
  // Of the side of a square that another of its level lies across, whoever asks; at the border that of the square
  // alone.
  int levelOfSide(const Square& s, int side) {
    int level = levelOf(s);
    Square other;
    if (!forest_.neighbour(s, side, other)) return level;
    level = std::max(level, levelOf(other));
    if (!morph_ || s.level == 0 || other.patch != s.patch || other.x >> 1 != s.x >> 1 || other.y >> 1 != s.y >> 1)
      return level;
    // Inside the parent.
    const Square parent = s.ancestor(s.level - 1);
    return std::max(level, childFloor(parent.level, innerLevel(parent), progressOf(parent)));
  }
  // What a square's inside is drawn with if all its sides are whole.
  int innerLevel(const Square& s) {
    const uint32_t at = infoIndex(s);
    if (infos_[at].inner != kUnknown) return infos_[at].inner;
    int level = 0;
    for (int side = 0; side < 4; ++side) level = std::max(level, levelOfSide(s, side));
    return infos_[at].inner = level;
  }
  int progressOf(const Square& s) {
    const int inner = innerLevel(s);
    return splitProgress(s.level, inner, infos_[infoIndex(s)].cell_px / max_node_px_);
  }
  int wantedOnSide(Node& n, int side) {
    int& known = n.across[static_cast<size_t>(side)];
    if (known == kUnknown) known = levelOfSide(n.square, side);
    return known;
  }

  // ---- the tree
  bool isResident(const Square& page) const {
    return assume_resident_ || (page.level == 0 && !forest_.hasTails()) ||
           (page.level <= forest_.depth() && resident_->count(page.id()) != 0);
  }
  int residentLevel(const Square& s, int inherited) const {
    if (flat_) return forest_.unitLog2();
    return s.level <= forest_.depth() && isResident(s) ? s.level + kPageLog2 : inherited;
  }
  uint32_t findNode(const Square& s) const {
    return s.level == 0 ? tree_.root_node[s.patch] : tree_.index.find(forest_.key(s));
  }
  void addNode(const Square& s, int inherited, int needs_level) {
    const uint32_t info = infoIndex(s);
    if (infos_[info].culled) return;  // a node that is not in the table is not drawn
    const auto index = static_cast<uint32_t>(tree_.nodes.size());
    if (s.level == 0) tree_.root_node[s.patch] = index, ++tree_.roots;
    else tree_.index.insert(forest_.key(s), index);
    Node& n = tree_.nodes.emplace_back();
    n.square = s;
    n.info = info;
    n.resident_level = residentLevel(s, inherited);
    n.needs_level = needs_level;
  }
  void addRootAndNeighbours(uint32_t patch) {
    auto add = [&](uint32_t p) {
      if (tree_.root_node[p] == kNone) addNode({p, 0, 0, 0}, forest_.leastResidentLevel(), 0);
    };
    add(patch);
    for (uint32_t p : roots_.neighbours(patch))
      if (whole_levels_ || !(roots_.codes()[p] & (MeshRoots::kCulled | MeshRoots::kHidden))) add(p);
  }
  // Levels that are continuous, or remembered. Single cells among single cells stay in the roots' tables: not those
  // next to what must be looked at, whose sides are its sides, nor those next to what its levels raise (levelOf()).
  void addRootsOneByOne(std::span<const uint8_t> codes) {
    for (uint32_t p = 0; p < codes.size(); ++p) {
      if (codes[p] & (MeshRoots::kCulled | MeshRoots::kHidden)) continue;
      int around = codes[p];
      for (uint32_t n : roots_.neighbours(p)) around |= codes[n];
      if (around & toLookAt() && tree_.root_node[p] == kNone) addNode({p, 0, 0, 0}, forest_.leastResidentLevel(), 0);
    }
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i)
      if (const Square s = tree_.nodes[i].square; levelOf(s) > 0) addRootAndNeighbours(s.patch);
  }
  // Children need at least the grid of level 1: whole units, and samples for it.
  bool hasUnitsToSplit(const Square& s) const {
    return s.level + 2 <= forest_.unitLog2() && s.level + 1 <= forest_.maxLevel();
  }
  bool hasSamplesToSplit(const Node& n) const {
    bool all = true;
    for (uint32_t k = 0; k < 4 && n.resident_level < n.square.level + 2; ++k)
      all = all && isResident(n.square.child(k));
    return all;
  }
  bool maySplit(uint32_t index) {
    Node& n = tree_.nodes[index];
    if (!hasUnitsToSplit(n.square)) return false;
    const bool all = hasSamplesToSplit(n);
    if (!all) {
      limited_tree_ = true;
      n.needs_level = std::max(n.needs_level, n.square.level + 2);
      n.blocked = true;
    }
    return all;
  }
  // A coarser node across a side, which must be split first.
  uint32_t coarserAcross(const Square& s, int side) const {
    Square other;
    if (s.level == 0 || !forest_.neighbour(s, side, other) || findNode(other) != kNone) return kNone;
    const uint32_t coarser = findNode(other.ancestor(s.level - 1));
    return coarser == kNone || tree_.nodes[coarser].state == State::kSplit ? kNone : coarser;  // none: out of view
  }
  // With what is there; nothing is asked for.
  bool canSplit(uint32_t index) const {
    const Node& n = tree_.nodes[index];
    if (!hasUnitsToSplit(n.square) || !hasSamplesToSplit(n)) return false;
    for (int side = 0; side < 4; ++side)
      if (const uint32_t coarser = coarserAcross(n.square, side); coarser != kNone && !canSplit(coarser)) return false;
    return true;
  }
  bool requestsSplit(uint32_t index) {
    const Square s = tree_.nodes[index].square;
    const int limit = s.level + kMaxSplitLevel;
    Node& n = tree_.nodes[index];
    if (infos_[n.info].cell_px > max_node_px_) return true;
    bool wants = false;
    for (int side = 0; side < 4 && !wants; ++side) wants = wantedOnSide(n, side) > limit * kOneLevel;
    n.rough = wants;
    if (!wants || n.resident_level > limit || n.resident_level >= forest_.unitLog2()) return wants;
    // Without finer pages smaller nodes would only cut the same triangles into more instances.
    bool finer = false;
    for (uint32_t k = 0; k < 4; ++k) finer = finer || isResident(s.child(k));
    limited_tree_ = limited_tree_ || !finer;
    return finer;
  }
  // Whole levels that a square's children will want at most, nearly: by their own errors, seen as the square is, which
  // costs a fraction of a look at each.
  std::array<int, 4> childLevels(const Square& s) {
    const uint32_t at = infoIndex(s);
    if (infos_[at].children[0] != kUnknown) return infos_[at].children;
    const Info in = infos_[at];
    std::array<int, 4> levels;
    levels.fill(wholeLevels(in.wanted));
    for (uint32_t k = 0; k < 4 && in.cell_px > 0; ++k) {  // else one of the roots' tables
      auto suffices = [&](int level) {
        const double px = in.px.of(deviation(s.child(k), level, in.diameter_mm));
        return px <= error_px_ ||
               !(std::ldexp(in.cell_px, s.level - level) > 2 * leastCellPx(min_cell_px_, px / error_px_));
      };
      while (levels[k] > s.level + 1 && suffices(levels[k] - 1)) --levels[k];
    }
    return infos_[at].children = levels;
  }
  // A node's grid is everywhere as fine as the finest of its sides asks for, and as its roughest part. Would its
  // children take so many triangles fewer that three more instances pay? All is drawn as finely as it is asked for
  // either way. No page is asked for for that alone. Not where a square's own desired level must tell when it splits:
  // with geomorph, and where lists hold still under a camera that trembles.
  bool savesBySplit(uint32_t index) {
    const Square s = tree_.nodes[index].square;
    if (tree_.nodes[index].rough) return false;  // waits for pages
    int finest = levelOf(s);
    for (int side = 0; side < 4; ++side) finest = std::max(finest, wantedOnSide(tree_.nodes[index], side));
    if (wholeLevels(finest) < s.level + kLeastDivided) return false;
    auto triangles = [](int cells_log2) { return int64_t{2} << (2 * cells_log2); };
    const std::array<int, 4> own = childLevels(s);
    std::array<int, 4> inside;
    for (uint32_t k = 0; k < 4; ++k) inside[k] = std::max({s.level + 1, own[k], own[k ^ 1], own[k ^ 2]});
    for (int side = 0; side < 4; ++side)
      for (uint32_t half = 0; half < 2; ++half) {
        const Square mine = s.childAt(side, half);
        Square theirs;
        if (!forest_.neighbour(mine, side, theirs)) continue;
        int& in = inside[(mine.x & 1) + 2 * (mine.y & 1)];
        in = std::max(in, childLevels(theirs.ancestor(s.level))[(theirs.x & 1) + 2 * (theirs.y & 1)]);
      }
    int64_t saved = triangles(wholeLevels(finest) - s.level) - kTrianglesForSplit;
    for (int level : inside) saved -= triangles(level - s.level - 1);
    return saved >= 0;
  }
  bool split(uint32_t index) {
    if (tree_.nodes[index].state == State::kSplit) return true;
    if (!maySplit(index)) return false;
    const Square s = tree_.nodes[index].square;
    if (s.level == 0) addRootAndNeighbours(s.patch);
    for (int side = 0; side < 4; ++side) {
      const uint32_t coarser = coarserAcross(s, side);
      if (coarser != kNone && !split(coarser)) {
        tree_.nodes[index].blocked = tree_.nodes[coarser].blocked;
        return false;
      }
    }
    Node& n = tree_.nodes[index];
    n.state = State::kSplit;
    const int inherited = n.resident_level;
    // The pages that this split rests on must stay wanted, even if the children, which are known better, want less:
    // else they would be evicted, the split undone, and the pages asked for again.
    const int needs = std::max(n.needs_level, s.level + (n.rough ? kMaxSplitLevel + 1 : 2));
    const size_t before = tree_.nodes.size();
    for (uint32_t k = 0; k < 4; ++k) addNode(s.child(k), inherited, needs);
    if (tree_.nodes.size() == before) {  // known better, it is out of view: it still wants the pages that tell
      tree_.nodes[index].barren = true;
      tree_.nodes[index].needs_level = needs;
    }
    return true;
  }
  // Builds the tree for a scaled error. Whether it fits is asked of the tree that all pages together would give: else
  // arriving pages would coarsen the error, the pages would no longer be wanted, be evicted, and the error refine
  // again.
  bool fits(double asked_px, double scale, bool anyway) {
    error_px_ = asked_px * scale;
    max_node_px_ = kMaxNodePx * scale;
    infos_.clear();
    info_index_.clear();
    memory_.again();
    roots_.evaluate(camera_, {error_px_ / (1 + hysteresis_), min_cell_px_, max_node_px_, hide_backs_, !whole_levels_});
    if (!refine(anyway)) return false;
    if (!limited_tree_ || anyway) return true;
    other_tree_.root_node.resize(tree_.root_node.size(), kNone);
    std::swap(tree_, other_tree_);
    assume_resident_ = true;
    bool whole_tree_fits = refine(false);
    assume_resident_ = false;  // as it was: of a view as if all were resident no tree is limited
    std::swap(tree_, other_tree_);
    return whole_tree_fits;
  }
  // False: too many nodes for this error.
  bool refine(bool anyway) {
    tree_.clear();
    limited_tree_ = false;
    const std::span<const uint8_t> codes = roots_.codes();
    for (uint32_t p = 0; p < codes.size() && whole_levels_ && roots_.anyCareful(); ++p)
      if (codes[p] & MeshRoots::kCareful) addRootAndNeighbours(p);
    if (!whole_levels_) addRootsOneByOne(codes);
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i) {
      if (tree_.nodes.size() - tree_.roots > kMaxLodNodes) return anyway;
      if (tree_.nodes[i].state == State::kLeaf && requestsSplit(i)) split(i);
    }
    for (uint32_t i = 0; i < tree_.nodes.size() && whole_levels_ && tree_.nodes.size() - tree_.roots < kMaxLodNodes;
         ++i)
      if (tree_.nodes[i].state == State::kLeaf && savesBySplit(i) && canSplit(i)) split(i);
    return true;
  }

  // ---- the answer
  // One edge between squares of base_level: as wanted, as far as both sides have samples for it.
  int edgeLevel(Node& n, const Node* across, int wanted, int base_level, int cap, bool counts) {
    int available = across ? std::min(n.resident_level, across->resident_level) : n.resident_level;
    int level = std::max(std::min(wanted, std::min({available, base_level + cap, forest_.unitLog2()}) * kOneLevel),
                         base_level * kOneLevel);
    bool blocked = n.blocked || (across && across->blocked);
    n.wanted = std::max(n.wanted, wanted);
    if (counts && level < wanted && (available * kOneLevel < wanted || blocked)) ++limited_;
    return level;
  }
  void levelSides(uint32_t index) {
    Node& n = tree_.nodes[index];
    const Square s = n.square;
    n.wanted = levelOf(s);
    n.drawn = s.level * kOneLevel;
    for (int side = 0; side < 4; ++side) {
      // across: none where nothing is drawn, or where a root is that is no node (it has samples for all that it can
      // want).
      auto whole = [&](int cap, uint32_t across) {
        const Node* a = across == kNone ? nullptr : &tree_.nodes[across];
        // An edge is counted once: by the finer node, or by the first of two.
        const int level =
            edgeLevel(n, a, wantedOnSide(n, side), s.level, cap, !a || a->square.level < s.level || index < across);
        n.edges[static_cast<size_t>(side)] = {level, kWholeSide};
        n.drawn = std::max(n.drawn, level);
      };
      Square other;
      if (!forest_.neighbour(s, side, other)) {
        whole(kMaxGridLevel, kNone);
        continue;
      }
      const uint32_t same = findNode(other);
      if (same == kNone || tree_.nodes[same].state == State::kLeaf) {
        uint32_t coarser = same == kNone && s.level > 0 ? findNode(other.ancestor(s.level - 1)) : kNone;
        if (coarser != kNone && tree_.nodes[coarser].state == State::kSplit) coarser = kNone;
        if (coarser != kNone) whole(kMaxGridLevel - 1, coarser);
        else whole(kMaxGridLevel, same);
        continue;
      }
      // Two half edges, each the whole edge of a finer node (or of nothing, if that one is out of view).
      for (uint32_t half = 0; half < 2; ++half) {
        Square mine = s.childAt(side, half), theirs;
        forest_.neighbour(mine, side, theirs);
        const uint32_t finer = findNode(theirs);
        const Node* f = finer != kNone ? &tree_.nodes[finer] : nullptr;
        assert(!f || f->state == State::kLeaf);
        const int level = edgeLevel(n, f, std::max(levelOf(mine), levelOf(theirs)), s.level + 1, kMaxGridLevel - 1, !f);
        n.edges[static_cast<size_t>(side)][half] = level;
        n.drawn = std::max(n.drawn, level);
      }
    }
    n.grid_level = wholeLevels(n.drawn) - s.level;
  }
  // The surface that is drawn at a level: between those of two whole ones, in one proportion everywhere.
  Deviation deviationAt(const Square& s, int desired, double diameter_mm) {
    const int level = wholeLevels(desired);
    return betweenLevels(
        desired, [&] { return deviation(s, level - 1, diameter_mm); }, deviation(s, level, diameter_mm));
  }
  Deviation deviationOnEdge(const Square& s, int desired, int inside, double diameter_mm) {
    const int level = wholeLevels(desired);
    return betweenLevels(
        desired, [&] { return deviation(s, level - 1, diameter_mm); },
        slidAlong(desired, inside, deviation(s, level, diameter_mm)));
  }
  // ---- what is promised: by parts of what is drawn, those with the largest bound alone divided until they are out of
  // view or single cells (bound_search.h).
  struct Part {
    double px = 0;
    Square square;
    uint32_t node = kNone;  // none: a root of the roots' tables
  };
  // At an edge with a coarser level all vertices lie where that one's deviation may lead to from its surface, which is
  // flat within each drawn triangle; so does the finest surface.
  Part partOf(uint32_t index, const Square& s) {
    const Node& n = tree_.nodes[index];
    const int depth = s.level - n.square.level,
              edge_level = coarsestAround(n.edges, n.drawn, n.square.level, depth, s.x - (n.square.x << depth),
                                          s.y - (n.square.y << depth));
    const Info& whole = infos_[n.info];
    const double diameter_mm = whole.diameter_mm;
    const bool slides = edge_level % kOneLevel != 0, snapped = edge_level < n.drawn || slides;
    const Deviation own = deviationAt(s, n.drawn, diameter_mm),
                    edge = snapped ? deviationOnEdge(s, edge_level, n.drawn, diameter_mm) : Deviation{};
    auto bound = [&](const PxPerMm& px) {
      return std::min(std::max(px.of(own), px.between(edge)), diameter_mm * px.head_on * px.any_way);
    };
    if (depth == 0) return {whole.culled ? 0 : bound(whole.px), s, index};
    // Drawn triangles that reach beyond the part are those with vertices on edges that are coarser; they stay within a
    // square of that one's level.
    const int reaches = std::max(n.square.level, edge_level / kOneLevel);
    const bool beyond = snapped && s.level > reaches;
    Seen seen = look(s, forest_.hull(s, exaggerate_), beyond ? edge.mm : 0);
    if (beyond && !seen.culled) {
      const Square around = s.ancestor(reaches);
      const Seen all = look(around, forest_.hull(around, exaggerate_), 0);
      seen.culled = all.culled;
      seen.px.head_on = std::min(seen.px.head_on, all.px.head_on);
    }
    return {seen.culled ? 0 : bound(seen.px), s, index};
  }
  double promisedPx() {
    return searchBound(parts_, [&](const Part& part, auto add) {
      if (part.node == kNone || part.square.level >= wholeLevels(tree_.nodes[part.node].drawn)) return false;
      for (uint32_t k = 0; k < 4; ++k) add(partOf(part.node, part.square.child(k)));
      return true;
    });
  }
  Square reliefPage(const Node& n) const {
    if (forest_.hasTails() && n.square.level + n.grid_level <= kTailCellsLog2)
      return {n.square.patch, static_cast<int>(kTailLevel), 0, 0};
    int level = std::clamp(n.square.level + n.grid_level - kPageLog2, 0, forest_.depth());
    for (; level < std::min(n.square.level, forest_.depth()); ++level)
      if (isResident(n.square.ancestor(level))) break;
    assert(isResident(n.square.ancestor(level)));
    return n.square.ancestor(level);
  }
  // The page that a node would like, the one it uses, and a ancestor stride above: see planar_lod.cpp. Roots, or what
  // does for them, are always there.
  void addRequests(const Node& n, int wanted_level, int used_level) {
    const Square& s = n.square;
    const int level = std::clamp(wanted_level - kPageLog2, 0, std::min(s.level, forest_.depth()));
    const int tail = static_cast<int>(kTailLevel);
    if (forest_.hasTails()) {
      if (used_level == tail && wanted_level <= kTailCellsLog2) return;
      // Roots that MeshRoots sufficed for have no centre as yet.
      const SquareHull hull = forest_.hull(s, exaggerate_);
      const float priority = camera_.priority(0.5 * (hull[0] + hull[7]));
      if (used_level != tail && used_level != level) addRequest(s.ancestor(used_level), priority);
      for (int at = level; at > 0; at -= kRequestAncestorStride) addRequest(s.ancestor(at), priority);
      addRequest(s.ancestor(0), priority);
      return;
    }
    if (level == 0 && used_level == 0) return;
    const float priority = camera_.priority(infos_[n.info].centre);
    for (int at = level; at > 0; at -= kRequestAncestorStride) addRequest(s.ancestor(at), priority);
    if (used_level != level && used_level > 0) addRequest(s.ancestor(used_level), priority);
  }
  void addRequest(const Square& page, float priority) {
    const uint64_t k = forest_.key(page);
    if (uint32_t found = request_index_.find(k); found != kNone) {
      requests_[found].priority = std::min(requests_[found].priority, priority);
      return;
    }
    request_index_.insert(k, static_cast<uint32_t>(requests_.size()));
    requests_.push_back({page.id(), priority});
  }

  // Roots of one grid level: what they have in common is copied, what differs is written into a batch that stays in the
  // cache. Put together from its bytes an instance would be read back in words that wait for them.
  void addRoots(std::vector<PatchInstance>& to, int grid_level, std::span<const MeshRoots::Drawn> roots) const {
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
  PlanarLodResult rootsAlone() const {
    PlanarLodResult result;
    result.error_px = error_px_;
    for (uint32_t p = 0; p < forest_.patchCount(); ++p)
      addRoots(result.instances, 0, std::array{MeshRoots::Drawn{p, 0}});
    return result;
  }

  static void setEdges(PatchInstance& p, const Node& n) {
    p.morph = morphOf(n.drawn);
    for (size_t side = 0; side < 4; ++side) {
      const auto& levels = n.edges[side];
      const bool whole = levels[1] == kWholeSide;
      for (size_t half = 0; half < (whole ? 1 : 2); ++half) {
        p.edges[side][half] = static_cast<uint8_t>(wholeLevels(levels[half]) - n.square.level - (whole ? 0 : 1));
        p.edge_morph[side][half] = slideOf(levels[half]);
      }
      if (whole) p.edges[side][1] = PatchInstance::kWholeEdge;
    }
  }
  PlanarLodResult finish() {
    PlanarLodResult result;
    parts_.clear();
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i)
      if (tree_.nodes[i].state == State::kLeaf) levelSides(i);
    for (const Node& n : tree_.nodes)
      if (n.square.level == 0) roots_.leaveOut(n.square.patch);
    roots_.levelEdges();
    parts_.push_back({roots_.maxErrorPx(), {}, kNone});
    std::vector<PatchInstance>& drawn = of_nodes_.instances;
    drawn.clear();
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i) {
      const Node& n = tree_.nodes[i];
      if (n.barren && !flat_) addRequests(n, n.needs_level, forest_.hasTails() ? static_cast<int>(kTailLevel) : 0);
      if (n.state != State::kLeaf) continue;
      const bool hidden = (roots_.codes()[n.square.patch] & MeshRoots::kHidden) != 0;
      PatchInstance p;
      p.node = n.square.id();
      const int shift = forest_.unitLog2() - n.square.level;
      p.x0 = static_cast<int32_t>(n.square.x << shift);
      p.y0 = static_cast<int32_t>(n.square.y << shift);
      p.grid_level = static_cast<uint8_t>(n.grid_level);
      p.step_log2 = static_cast<uint8_t>(shift - n.grid_level);
      setEdges(p, n);
      p.relief_page = {p.node.patch, 0, 0, 0};
      if (!hidden) parts_.push_back(partOf(i, n.square));
      if (!flat_) {
        Square page = reliefPage(n);
        p.relief_page = page.id();
        addRequests(n, std::max({n.square.level + n.grid_level, n.needs_level, wholeLevels(n.wanted)}), page.level);
      }
      if (!hidden) drawn.push_back(p);
    }
    result.max_error_px = promisedPx();
    sortInstances(drawn);
    sortRequests(requests_);
    result.requests = requests_;
    result.backs_are_hidden = roots_.backsAreHidden();
    result.limited_by_residency = limited_;
    result.error_px = error_px_;
    // Both lists are in order; a patch is in one of them alone.
    size_t count = drawn.size(), next = 0;
    for (int level = 0; level <= kMaxGridLevel; ++level) count += roots_.drawn(level).size();
    result.instances.reserve(count);
    for (int level = 0; level <= kMaxGridLevel; ++level) {
      std::span<const MeshRoots::Drawn> roots = roots_.drawn(level);
      for (; next < drawn.size() && drawn[next].grid_level == level; ++next) {
        size_t before = 0;
        while (before < roots.size() && roots[before].patch < drawn[next].node.patch) ++before;
        addRoots(result.instances, level, roots.first(before));
        roots = roots.subspan(before);
        result.instances.push_back(drawn[next]);
      }
      addRoots(result.instances, level, roots);
    }
    return result;
  }

  MeshForest& forest_;
  MeshRoots roots_;
  const ReliefSet* resident_ = nullptr;
  LodCamera camera_;
  bool flat_ = false;
  bool hide_backs_ = true;
  double exaggerate_ = 1, error_px_ = 1, max_node_px_ = kMaxNodePx, min_cell_px_ = 0, hysteresis_ = 0;
  bool morph_ = false, whole_levels_ = true;
  DesiredLevelMemory memory_;
  Tree tree_, other_tree_;
  std::vector<Info> infos_;
  std::vector<Part> parts_;
  std::vector<ReliefRequest> requests_;
  PlanarLodResult of_nodes_;
  IndexTable info_index_, request_index_;
  bool assume_resident_ = false;  // what would be drawn if every page were here
  bool limited_tree_ = false;     // a split did not happen for want of pages
  uint32_t limited_ = 0;
  static_assert(kTailCellsLog2 >= kMaxSplitLevel, "roots that are no nodes have samples for all that they can want");
};

}  // namespace

struct MeshLod::Impl {
  MeshForest forest;
  Selection selection{forest};
};

MeshLod::MeshLod(std::shared_ptr<const BaseMesh> base, int relief_depth, double relief_offset_mm,
                 double relief_scale_mm, std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse,
                 bool tails)
    : impl_(new Impl{MeshForest(std::move(base), relief_depth, relief_offset_mm, relief_scale_mm, std::move(oracle),
                                std::move(coarse), tails)}) {}
MeshLod::~MeshLod() = default;

PlanarLodResult MeshLod::select(const LodView& view, const ReliefSet& resident) {
  impl_->forest.forgetSome();
  return impl_->selection.run(view, resident);
}

}  // namespace relievo
