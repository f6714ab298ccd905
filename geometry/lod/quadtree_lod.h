// quadtree_lod.h - which squares of a forest of quadtrees to draw, and with how many segments along each edge: the one
// selection behind planar_lod.h (a strip of square patches) and mesh_lod.h (the patches of a base mesh). What these
// differ in is a forest: where squares are and meet, what the view makes of them, which levels their sides want, and
// how large an error is in pixels. Internal to geometry/. The order of the work:
//   1. roots in view, which the forest names,
//   2. refine: a node that wants more is split, after the coarser neighbours that the 2:1 rule asks for; where levels
//      are whole, a node is also divided where its quarters take fewer triangles,
//   3. one level per edge, both sides answering from the same data,
//   4. grid levels, relief pages, requests, the error that is promised.
// Bounded: when refining asks for more than kMaxLodNodes below the roots, everything starts again with twice the error,
// so detail falls evenly.
//
// Levels of places: a grid of level n on a node of level l has vertices of the absolute level L = l + n, 2^(U - L)
// units apart, U the log2 of a patch's side in units. A relief page of level lr has the samples of absolute level lr
// + 7.
#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <concepts>
#include <cstdint>
#include <utility>
#include <vector>

#include "geometry/lod/bound_search.h"
#include "geometry/lod/desired_level.h"
#include "geometry/lod/forest_view.h"
#include "geometry/lod/lod_common.h"
#include "geometry/lod/square.h"
#include "src/artwork/base_mesh.h"
#include "src/base/key_index.h"

namespace relievo {

// A drawn node as the bound of a part of it depends on it. Levels are desired levels (desired_level.h).
struct DrawnNode {
  int level = 0;      // of its square, whole
  int inside = 0;     // of its inside
  int edge = 0;       // the coarsest that triangles in the part have vertices of (coarsestAround())
  uint32_t info = 0;  // of its square
};

// What the selection asks of a forest. Every answer is a function of the view and of squares, never of the tree. So the
// two nodes at an edge agree, and a list does not depend on the order in which its nodes were made.
//
// Places. Squares that are passed in exist. exists() is asked of children, which the artwork's border may cut off.
//   key()              names a square of any level
//   neighbour()        the square of the same level across a side; false where there is none
//   hasUnitsToSplit()  the children's grids of level 1 have whole units
//   originUnits()      PatchInstance::x0, y0
//   kLeastGrid         the least PatchInstance::grid_level
//   kPlane             without relief the surface is a plane, and has no error
// Heights.
//   reliefDepth()      the level of the finest pages; below 0 without relief
//   hasTails()         grids of 2^kTailCellsLog2 cells a patch's side have heights without a page
//   asksForRoots()     pages of level 0 are among the requests
//   kNeedsAddUp        the pages that a split rests on include those that its parent's split rests on
// The view. A try is one tree for one error: beginTry(error_px, max_node_px) forgets the levels of the last one.
//   beginView()        comes first; where the camera is not valid nothing else of the view is asked for
//   addRoots(add)      calls add(root) for every tree; the answer is true where the root became a node by that call
//   addAround(p, add)  the same for all roots that children of patch p's root may meet
//   infoOf()           a handle of what the forest keeps of a square within a try
//   isCulled()         nothing of the square is in view: it is no node
//   isWide()           the square must be split, whatever its error
//   centre()           a point of the square, for the priority of its requests
//   isHidden()         the patch is selected as others are, but not drawn
//   backsAreHidden()   LodResult
// Levels. They are desired levels (desired_level.h).
//   sideLevel()        of a whole side; the square across says the same of its own side there
//   levelWithin()      what the square asks for beside its sides
//   childLevels()      see ForestView
// Errors.
//   boundPx()          an upper bound of the error within a square that is part of a drawn node, in pixels; 0 if culled
template <class F>
concept LodForest = requires(F& f, const F& c, const Square& s, Square& other, uint32_t patch, uint32_t info, int side,
                             double px, const LodSettings& settings, const DrawnNode& drawn, bool (*add)(Square)) {
  { c.patchCount() } -> std::same_as<uint32_t>;
  { c.unitLog2() } -> std::same_as<int>;
  { c.key(s) } -> std::same_as<uint64_t>;
  { c.exists(s) } -> std::same_as<bool>;
  { c.neighbour(s, side, other) } -> std::same_as<bool>;
  { c.hasUnitsToSplit(s) } -> std::same_as<bool>;
  { c.originUnits(s) } -> std::same_as<std::array<int32_t, 2>>;
  { F::kLeastGrid } -> std::convertible_to<int>;
  { F::kPlane } -> std::convertible_to<bool>;

  { c.reliefDepth() } -> std::same_as<int>;
  { c.hasTails() } -> std::same_as<bool>;
  { c.asksForRoots() } -> std::same_as<bool>;
  { F::kNeedsAddUp } -> std::convertible_to<bool>;

  f.beginView(settings);
  f.beginTry(px, px);
  f.addRoots(add);
  f.addAround(patch, add);
  { f.infoOf(s) } -> std::same_as<uint32_t>;
  { c.isCulled(info) } -> std::same_as<bool>;
  { c.isWide(info) } -> std::same_as<bool>;
  { f.centre(s, info) } -> std::same_as<glm::dvec3>;
  { c.isHidden(patch) } -> std::same_as<bool>;
  { c.backsAreHidden() } -> std::same_as<bool>;

  { f.sideLevel(s, side) } -> std::same_as<int>;
  { f.levelWithin(s) } -> std::same_as<int>;
  { f.childLevels(s) } -> std::same_as<std::array<int, 4>>;

  { f.boundPx(s, drawn) } -> std::same_as<double>;
};

// A forest that draws most of its patches by itself, as their roots (mesh_roots.h); trees begin at the others alone.
template <class F>
concept DrawsRest = requires(F& f, uint32_t patch, const std::vector<PatchInstance>& sorted) {
  f.leaveOut(patch);                                                   // drawn by nodes
  { f.levelRest() } -> std::same_as<double>;                           // the largest error of the rest, in pixels
  { f.withRest(sorted) } -> std::same_as<std::vector<PatchInstance>>;  // all of them, sorted
};

// An object is used for one view after the other, so that its vectors keep their capacity. Hysteresis remembers levels
// from view to view, and a forest what the oracle said; nothing else lasts. Not for several threads at once.
template <LodForest Forest>
class QuadtreeLod {
 public:
  template <class... Args>
  explicit QuadtreeLod(Args&&... args) : forest_(std::forward<Args>(args)...) {}

  LodResult select(const LodView& view, const ReliefSet& resident) {
    settings_ = LodSettings(view, forest_.reliefDepth() >= 0, Forest::kPlane);
    resident_ = &resident;
    assume_resident_ = view.as_if_resident;
    divides_ = settings_.wholeLevels() && (!Forest::kPlane || view.divide_flat);
    limited_ = 0;
    requests_.clear();
    request_index_.clear();
    forest_.beginView(settings_);
    if (!settings_.camera.valid) return rootsAlone();
    // Four times the error until it fits, then back to twice if that fits too.
    const double asked_px = settings_.error_px;
    double scale = 1;
    while (!fits(asked_px, scale, scale > 1e12)) scale *= 4;
    if (scale > 1 && scale <= 1e12 && !fits(asked_px, scale / 2, false)) fits(asked_px, scale, true);
    return finish();
  }

 private:
  static constexpr uint32_t kNone = KeyIndex::kNone;
  static constexpr int kAllLevels = 127;  // the finest relief page is resident: vertices of every level have heights
  // savesBySplit(): no coarser grids (log2 of the cells a side) are divided; what three more instances are worth.
  static constexpr int kLeastDivided = 3;
  static constexpr int64_t kTrianglesForSplit = 64;

  enum class State : uint8_t { kLeaf, kSplit };
  struct Node {
    Square square;
    State state = State::kLeaf;
    bool blocked = false;    // would be split if more pages were resident
    bool barren = false;     // split, and no child is in view
    bool rough = false;      // an edge wants more than its grid can give
    int resident_level = 0;  // vertices up to this absolute level have samples
    int needs_level = 0;     // absolute level that must stay (or become) resident, whatever its edges want
    int grid_level = 0;
    int wanted = 0;  // the largest of its edges'; levels here and below are desired levels
    int drawn = 0;   // of its inside
    uint32_t info = 0;
    std::array<int, 4> across{kUnknownLevel, kUnknownLevel, kUnknownLevel, kUnknownLevel};  // of whole sides, if known
    SideLevels edges{};                                                                     // as drawn
  };
  struct Tree {
    std::vector<Node> nodes;
    KeyIndex index;
    size_t roots = 0;  // among the nodes
    void clear() {
      nodes.clear();
      index.clear();
      roots = 0;
    }
  };
  struct Part {
    double px = 0;
    Square square;
    uint32_t node = kNone;  // none: of what the forest draws by itself
  };

  // ---- the tree
  bool isResident(const Square& page) const {
    return assume_resident_ || (page.level == 0 && !forest_.hasTails()) ||
           (page.level <= forest_.reliefDepth() && page.level <= static_cast<int>(kMaxNodeLevel) &&
            resident_->count(page.id()) != 0);
  }
  int residentLevel(const Square& s, int inherited) const {
    if (settings_.flat) return kAllLevels;
    if (s.level > forest_.reliefDepth() || !isResident(s)) return inherited;
    return s.level == forest_.reliefDepth() ? kAllLevels : s.level + kPageLog2;
  }
  uint32_t findNode(const Square& s) const { return tree_.index.find(forest_.key(s)); }
  // False: out of view. A square that is not in the table is not drawn.
  bool addNode(const Square& s, int inherited, int needs_level) {
    const uint32_t info = forest_.infoOf(s);
    if (forest_.isCulled(info)) return false;
    [[maybe_unused]] const uint32_t index = tree_.index.findOrAdd(forest_.key(s));
    assert(index == tree_.nodes.size());
    Node& n = tree_.nodes.emplace_back();
    n.square = s;
    n.info = info;
    n.resident_level = residentLevel(s, inherited);
    n.needs_level = needs_level;
    return true;
  }
  // True: it is a new node.
  bool addRoot(const Square& root) {
    if (findNode(root) != kNone) return false;
    const bool added = addNode(root, forest_.hasTails() ? kTailCellsLog2 : kPageLog2, 0);
    tree_.roots += added;
    return added;
  }
  template <class F>
  void forChildren(const Square& s, F&& f) const {
    for (uint32_t k = 0; k < 4; ++k)
      if (const Square child = s.child(k); forest_.exists(child)) f(child);
  }
  bool hasSamplesToSplit(const Node& n) const {
    bool all = true;
    if (n.resident_level < n.square.level + 2)
      forChildren(n.square, [&](const Square& child) { all = all && isResident(child); });
    return all;
  }
  bool maySplit(uint32_t index) {
    Node& n = tree_.nodes[index];
    if (!forest_.hasUnitsToSplit(n.square)) return false;
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
    if (!forest_.hasUnitsToSplit(n.square) || !hasSamplesToSplit(n)) return false;
    for (int side = 0; side < 4; ++side)
      if (const uint32_t coarser = coarserAcross(n.square, side); coarser != kNone && !canSplit(coarser)) return false;
    return true;
  }
  int wantedOnSide(Node& n, int side) {
    int& known = n.across[static_cast<size_t>(side)];
    if (known == kUnknownLevel) known = forest_.sideLevel(n.square, side);
    return known;
  }
  bool requestsSplit(uint32_t index) {
    Node& n = tree_.nodes[index];
    if (forest_.isWide(n.info)) return true;
    const int limit = n.square.level + kMaxSplitLevel;
    bool wants = false;
    for (int side = 0; side < 4 && !wants; ++side) wants = wantedOnSide(n, side) > limit * kOneLevel;
    n.rough = wants;
    if (!wants || n.resident_level > limit) return wants;
    // Without finer pages smaller nodes would only cut the same triangles into more instances.
    bool finer = false;
    forChildren(n.square, [&](const Square& child) { finer = finer || isResident(child); });
    limited_tree_ = limited_tree_ || !finer;
    return finer;
  }
  // A node's grid is everywhere as fine as the finest of its sides asks for, and as its roughest part. Would its
  // children take so many triangles fewer that three more instances pay? All is drawn as finely as it is asked for
  // either way. No page is asked for for that alone. Not where a square's own desired level must tell when it splits:
  // with geomorph, and where lists hold still under a camera that trembles.
  bool savesBySplit(uint32_t index) {
    Node& n = tree_.nodes[index];
    const Square s = n.square;
    if (n.rough) return false;  // waits for pages
    int finest = forest_.levelWithin(s);
    for (int side = 0; side < 4; ++side) finest = std::max(finest, wantedOnSide(n, side));
    if (wholeLevels(finest) < s.level + kLeastDivided) return false;
    auto triangles = [](int cells_log2) { return int64_t{2} << (2 * cells_log2); };
    const std::array<int, 4> own = forest_.childLevels(s);
    std::array<int, 4> inside;
    for (uint32_t k = 0; k < 4; ++k) inside[k] = std::max({s.level + 1, own[k], own[k ^ 1], own[k ^ 2]});
    for (int side = 0; side < 4; ++side)
      for (uint32_t half = 0; half < 2; ++half) {
        const Square mine = s.childAt(side, half);
        Square theirs;
        if (!forest_.exists(mine) || !forest_.neighbour(mine, side, theirs)) continue;
        int& in = inside[(mine.x & 1) + 2 * (mine.y & 1)];
        in = std::max(in, forest_.childLevels(theirs.ancestor(s.level))[(theirs.x & 1) + 2 * (theirs.y & 1)]);
      }
    int64_t saved = triangles(wholeLevels(finest) - s.level) - kTrianglesForSplit;
    for (uint32_t k = 0; k < 4; ++k)
      if (forest_.exists(s.child(k))) saved -= triangles(inside[k] - s.level - 1);
    return saved >= 0;
  }
  bool split(uint32_t index) {
    if (tree_.nodes[index].state == State::kSplit) return true;
    if (!maySplit(index)) return false;
    const Square s = tree_.nodes[index].square;
    if (s.level == 0) forest_.addAround(s.patch, [&](const Square& root) { return addRoot(root); });
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
    const int needs = std::max(Forest::kNeedsAddUp ? n.needs_level : 0, s.level + (n.rough ? kMaxSplitLevel + 1 : 2));
    const size_t before = tree_.nodes.size();
    forChildren(s, [&](const Square& child) { addNode(child, inherited, needs); });
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
    settings_.error_px = asked_px * scale;
    settings_.max_node_px = kMaxNodePx * scale;
    forest_.beginTry(settings_.error_px, settings_.max_node_px);
    if (!refine(anyway)) return false;
    if (!limited_tree_ || anyway) return true;
    std::swap(tree_, other_tree_);
    assume_resident_ = true;
    const bool whole_tree_fits = refine(false);
    assume_resident_ = false;  // as it was: of a view as if all were resident no tree is limited
    std::swap(tree_, other_tree_);
    return whole_tree_fits;
  }
  bool isOverBudget() const { return tree_.nodes.size() - tree_.roots > kMaxLodNodes; }
  // False: too many nodes for this error.
  bool refine(bool anyway) {
    tree_.clear();
    limited_tree_ = false;
    forest_.addRoots([&](const Square& root) { return addRoot(root); });
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i) {
      if (isOverBudget()) return anyway;
      if (tree_.nodes[i].state == State::kLeaf && requestsSplit(i)) split(i);
    }
    for (uint32_t i = 0; i < tree_.nodes.size() && divides_ && tree_.nodes.size() - tree_.roots < kMaxLodNodes; ++i)
      if (tree_.nodes[i].state == State::kLeaf && savesBySplit(i) && canSplit(i)) split(i);
    return true;
  }

  // ---- one level per edge
  // Between squares of base_level: as wanted, as far as both sides have samples for it.
  int edgeLevel(Node& n, const Node* across, int wanted, int base_level, int cap, bool counts) {
    const int available = across ? std::min(n.resident_level, across->resident_level) : n.resident_level;
    const int level =
        std::max(std::min(wanted, std::min({available, base_level + cap, forest_.unitLog2()}) * kOneLevel),
                 base_level * kOneLevel);
    const bool blocked = n.blocked || (across && across->blocked);
    n.wanted = std::max(n.wanted, wanted);
    n.drawn = std::max(n.drawn, level);
    if (counts && level < wanted && (available * kOneLevel < wanted || blocked)) ++limited_;
    return level;
  }
  // across: none where nothing is drawn, or where the forest draws a root by itself (which has samples for all that it
  // can want). An edge is counted once: by the finer node, or by the first of two.
  void levelWholeSide(uint32_t index, int side, int cap, uint32_t across) {
    Node& n = tree_.nodes[index];
    const Node* a = across == kNone ? nullptr : &tree_.nodes[across];
    const bool counts = !a || a->square.level < n.square.level || index < across;
    n.edges[static_cast<size_t>(side)] = {edgeLevel(n, a, wantedOnSide(n, side), n.square.level, cap, counts),
                                          kWholeSide};
  }
  // Two half edges, each the whole edge of a finer node, or of nothing if that one is out of view. Where the border
  // cuts the second half off, it is drawn as the first is.
  void levelHalfSides(Node& n, int side) {
    for (uint32_t half = 0; half < 2; ++half) {
      Square mine = n.square.childAt(side, half), theirs;
      const bool cut_off = !forest_.exists(mine);
      if (cut_off) mine = n.square.childAt(side, 0);
      const uint32_t finer = forest_.neighbour(mine, side, theirs) ? findNode(theirs) : kNone;
      const Node* f = finer != kNone ? &tree_.nodes[finer] : nullptr;
      assert(!f || f->state == State::kLeaf);
      n.edges[static_cast<size_t>(side)][half] =
          edgeLevel(n, f, forest_.sideLevel(mine, side), n.square.level + 1, kMaxGridLevel - 1, !f && !cut_off);
    }
  }
  void levelSides(uint32_t index) {
    Node& n = tree_.nodes[index];
    const Square s = n.square;
    n.wanted = forest_.levelWithin(s);
    n.drawn = s.level * kOneLevel;
    for (int side = 0; side < 4; ++side) {
      Square other;
      if (!forest_.neighbour(s, side, other)) {
        levelWholeSide(index, side, kMaxGridLevel, kNone);
        continue;
      }
      const uint32_t same = findNode(other);
      if (same != kNone && tree_.nodes[same].state == State::kSplit) {
        levelHalfSides(n, side);
        continue;
      }
      uint32_t coarser = same == kNone && s.level > 0 ? findNode(other.ancestor(s.level - 1)) : kNone;
      if (coarser != kNone && tree_.nodes[coarser].state == State::kSplit) coarser = kNone;
      if (coarser != kNone) levelWholeSide(index, side, kMaxGridLevel - 1, coarser);
      else levelWholeSide(index, side, kMaxGridLevel, same);
    }
    // With geomorph the middle of a grid that none of its sides asks for comes from where a single cell has it.
    n.grid_level = std::max<int>(Forest::kLeastGrid, wholeLevels(n.drawn) - s.level);
    if (!settings_.morph) n.drawn = (s.level + n.grid_level) * kOneLevel;
  }

  // ---- what is promised, by parts: those with the largest bound alone are divided, until they are out of view or
  // single cells (bound_search.h)
  Part partOf(uint32_t index, const Square& s) {
    const Node& n = tree_.nodes[index];
    const int depth = s.level - n.square.level;
    const int edge = coarsestAround(n.edges, n.drawn, n.square.level, depth, s.x - (n.square.x << depth),
                                    s.y - (n.square.y << depth));
    return {forest_.boundPx(s, {n.square.level, n.drawn, edge, n.info}), s, index};
  }
  double promisedPx() {
    return searchBound(parts_, [&](const Part& part, auto add) {
      if (part.node == kNone || part.square.level >= wholeLevels(tree_.nodes[part.node].drawn)) return false;
      forChildren(part.square, [&](const Square& child) { add(partOf(part.node, child)); });
      return true;
    });
  }

  // ---- relief pages
  static constexpr int kTail = static_cast<int>(kTailLevel);
  // The coarsest page that has a node's samples; a tail instead of pages where that does.
  int usedPageLevel(const Node& n) const {
    const int needed = n.square.level + n.grid_level, depth = forest_.reliefDepth();
    if (forest_.hasTails() && needed <= kTailCellsLog2) return kTail;
    int level = std::clamp(needed - kPageLog2, 0, depth);
    for (; level < std::min(n.square.level, depth); ++level)
      if (isResident(n.square.ancestor(level))) break;
    assert(isResident(n.square.ancestor(level)));
    return level;
  }
  // The page that a node would like, the one it uses, and an ancestor stride above: descending needs a resident page at
  // least every few levels, and the ancestor stride is what a missing page falls back to (1.6 % more pages).
  void addRequests(const Node& n, int wanted_level, int used_level) {
    const Square& s = n.square;
    const int level = std::clamp(wanted_level - kPageLog2, 0, std::min(s.level, forest_.reliefDepth()));
    if (used_level == kTail && wanted_level <= kTailCellsLog2) return;
    if (!forest_.asksForRoots() && level == 0 && used_level == 0) return;
    const float priority = settings_.camera.priority(forest_.centre(s, n.info));
    for (int at = level; at > 0; at -= kRequestAncestorStride) addRequest(s.ancestor(at), priority);
    if (used_level != level && used_level > 0 && used_level != kTail) addRequest(s.ancestor(used_level), priority);
    if (forest_.asksForRoots()) addRequest(s.ancestor(0), priority);
  }
  void addRequest(const Square& page, float priority) {
    const uint32_t index = request_index_.findOrAdd(forest_.key(page));
    if (index < requests_.size()) requests_[index].priority = std::min(requests_[index].priority, priority);
    else requests_.push_back({page.id(), priority});
  }

  // ---- the list
  PatchInstance instanceOf(const Square& s, int grid_level) const {
    PatchInstance p;
    p.node = s.id();
    const std::array<int32_t, 2> origin = forest_.originUnits(s);
    p.x0 = origin[0];
    p.y0 = origin[1];
    p.grid_level = static_cast<uint8_t>(grid_level);
    p.step_log2 = static_cast<uint8_t>(forest_.unitLog2() - s.level - grid_level);
    p.relief_page = {s.patch, 0, 0, 0};
    return p;
  }
  static void setEdges(PatchInstance& p, const Node& n) {
    p.morph = wholeLevels(n.drawn) - n.square.level >= Forest::kLeastGrid ? morphOf(n.drawn) : 0;
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
  // Of a view that is not finite.
  LodResult rootsAlone() const {
    LodResult result;
    result.error_px = settings_.error_px;
    for (uint32_t patch = 0; patch < forest_.patchCount(); ++patch) {
      PatchInstance& p = result.instances.emplace_back(instanceOf({patch, 0, 0, 0}, Forest::kLeastGrid));
      if (forest_.hasTails()) p.relief_page.level = kTailLevel;
      for (auto& side : p.edges) side[1] = PatchInstance::kWholeEdge;
    }
    return result;
  }
  void addInstance(uint32_t index) {
    const Node& n = tree_.nodes[index];
    PatchInstance p = instanceOf(n.square, n.grid_level);
    setEdges(p, n);
    const bool hidden = forest_.isHidden(n.square.patch);
    if (!hidden && !(settings_.flat && Forest::kPlane)) parts_.push_back(partOf(index, n.square));
    if (!settings_.flat) {
      const int used = usedPageLevel(n);
      p.relief_page = used == kTail ? NodeId{n.square.patch, kTailLevel, 0, 0} : n.square.ancestor(used).id();
      addRequests(n, std::max({n.square.level + n.grid_level, n.needs_level, wholeLevels(n.wanted)}), used);
    }
    if (!hidden) instances_.push_back(p);
  }
  LodResult finish() {
    LodResult result;
    parts_.clear();
    instances_.clear();
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i)
      if (tree_.nodes[i].state == State::kLeaf) levelSides(i);
    if constexpr (DrawsRest<Forest>) {
      for (const Node& n : tree_.nodes)
        if (n.square.level == 0) forest_.leaveOut(n.square.patch);
      parts_.push_back({forest_.levelRest(), {}, kNone});
    }
    for (uint32_t i = 0; i < tree_.nodes.size(); ++i) {
      const Node& n = tree_.nodes[i];
      if (n.barren && !settings_.flat) addRequests(n, n.needs_level, forest_.hasTails() ? kTail : 0);
      if (n.state == State::kLeaf) addInstance(i);
    }
    result.max_error_px = promisedPx();
    sortRequests(requests_);
    result.requests = requests_;
    sortInstances(instances_);
    if constexpr (DrawsRest<Forest>) result.instances = forest_.withRest(instances_);
    else result.instances = instances_;
    result.backs_are_hidden = forest_.backsAreHidden();
    result.limited_by_residency = limited_;
    result.error_px = settings_.error_px;
    return result;
  }

  Forest forest_;
  LodSettings settings_;
  const ReliefSet* resident_ = nullptr;
  Tree tree_, other_tree_;
  std::vector<Part> parts_;
  std::vector<PatchInstance> instances_;
  std::vector<ReliefRequest> requests_;
  KeyIndex request_index_;
  bool assume_resident_ = false;  // what would be drawn if every page were here
  bool divides_ = false;
  bool limited_tree_ = false;  // a split did not happen for want of pages
  uint32_t limited_ = 0;
  static_assert(kTailCellsLog2 >= kMaxSplitLevel, "roots that are no nodes have samples for all that they can want");
};

}  // namespace relievo
