// mesh_lod.cpp - see the header. The order of the work is that of planar_lod.cpp: roots in view, refinement with 2:1 balance, one level
// an edge, the list. What differs:
//
// Levels of squares, not of edges: the level that a square wants, W, is the coarsest whose error is small enough on the screen, a
// function of the square alone. An edge between two squares of one level wants the larger of their two; so does either side, whoever
// asks, and neither side's triangles are worse than that side asks for.
//
// Pixels of an error. A point X of the finest surface and the drawn one of the same (u, v), X', lie e apart at most. In the picture
// of a perspective view (x / z, y / z) they lie |(dx, dy) - dz (x, y) / z| / z' <= e sqrt(1 + tan^2 a) / z' apart, a the angle of
// the one that is in the picture off the axis, z' the other one's depth: exact, not a first order. Both lie in the hull of the
// square's displaced corners P + h N, h in {min, max}: for one (u, v) S is on the segment between two bilinear patches, either of
// which lies in the hull of its corners.
//
// Levels of places: a grid of level n on a node of level l has vertices of the absolute level L = l + n, 2^(U - L) units
// apart, U the log2 of a patch's side in units. A relief page of level lr has the samples of absolute level lr + 7.
#include "geometry/mesh_lod.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>

#include "geometry/lod_common.h"

namespace relievo {
namespace {

constexpr size_t kMaxParts = 16384;  // of pages, 1.4 KB each, kept from view to view

struct Square {
  uint32_t patch = 0;
  int level = 0;
  uint32_t x = 0, y = 0;
  Square ancestor(int coarser) const { return {patch, coarser, x >> (level - coarser), y >> (level - coarser)}; }
  Square child(uint32_t cx, uint32_t cy) const { return {patch, level + 1, 2 * x + cx, 2 * y + cy}; }
  NodeId id() const { return {patch, static_cast<uint32_t>(level), x, y}; }
};

// Corners of a square at its lowest and at its highest height.
struct Hull {
  std::array<glm::dvec3, 8> points;
};

bool soundHeights(const HeightBounds& b) { return b.min_mm <= b.max_mm && std::isfinite(b.min_mm) && std::isfinite(b.max_mm); }

// What does not change from view to view.
struct Forest {
  Forest(std::shared_ptr<const BaseMesh> mesh, int relief_depth, double offset_mm, double scale_mm, std::shared_ptr<const ReliefOracle> source,
       std::vector<CoarseErrors> coarse)
      : base(std::move(mesh)), oracle(std::move(source)), coarse_errors(std::move(coarse)), depth(std::max(relief_depth, 0)) {
    assert(base && oracle);
    has_relief = relief_depth >= 0;
    unit_log2 = depth + kPageLog2;
    double ends[2] = {offset_mm, offset_mm + 65535 * scale_mm};
    whole_range.min_mm = static_cast<float>(std::min(ends[0], ends[1]));
    whole_range.max_mm = static_cast<float>(std::max(ends[0], ends[1]));
    neighbours = patchNeighbours(*base);
    patch_bits = std::bit_width(std::max<size_t>(base->patches.size(), 2) - 1);
    // A square's key has 5 bits of level; places as fine as what is left.
    max_level = std::min({(58 - patch_bits) / 2, unit_log2 - 1, 31});
    twist_mm.reserve(base->patches.size());
    for (const auto& c : base->patches) {
      auto at = [&](int k) { return glm::dvec3(base->corners[c[k]].position_mm); };
      twist_mm.push_back(glm::length(at(0) - at(1) - at(2) + at(3)));
    }
    if (coarse_errors.size() != base->patches.size()) coarse_errors.clear();
  }

  std::shared_ptr<const BaseMesh> base;
  std::shared_ptr<const ReliefOracle> oracle;
  std::vector<CoarseErrors> coarse_errors;
  std::vector<PatchNeighbours> neighbours;
  std::vector<double> twist_mm;  // |c00 - c10 - c01 + c11|
  int depth = 0, unit_log2 = 0, patch_bits = 0, max_level = 0;
  bool has_relief = false;
  HeightBounds whole_range;
  // What the oracle said, kept.
  std::vector<HeightBounds> bounds;
  std::vector<PartErrors> parts;
  IndexTable bounds_index, parts_index;

  // ---- places
  uint64_t key(const Square& s) const {
    const int place_bits = (58 - patch_bits) / 2;
    return (static_cast<uint64_t>(s.level) << 58) | (uint64_t{s.patch} << (2 * place_bits)) | (uint64_t{s.x} << place_bits) | s.y;
  }
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
    const PatchNeighbour& n = neighbours[s.patch][static_cast<size_t>(side)];
    if (n.patch == PatchNeighbour::kNone) return false;
    const uint32_t t = n.reversed ? last - along : along, edge = n.side == kRight || n.side == kBottom ? last : 0;
    out = n.side == kLeft || n.side == kRight ? Square{n.patch, s.level, edge, t} : Square{n.patch, s.level, t, edge};
    return true;
  }

  // ---- heights and errors, at exaggeration 1
  const HeightBounds& pageBounds(const Square& page) {
    uint64_t k = key(page);
    if (uint32_t found = bounds_index.find(k); found != IndexTable::kNone) return bounds[found];
    HeightBounds b = oracle->bounds(page.id());
    if (!soundHeights(b)) b.min_mm = whole_range.min_mm, b.max_mm = whole_range.max_mm;
    if (!(b.error_mm >= 0 && std::isfinite(b.error_mm))) b.error_mm = std::numeric_limits<float>::infinity();
    bounds_index.insert(k, static_cast<uint32_t>(bounds.size()));
    return bounds.emplace_back(b);
  }
  HeightBounds heights(const Square& s) { return pageBounds(s.ancestor(std::min(s.level, depth))); }
  double bakedError(const Square& s, int level) {
    if (level >= unit_log2) return 0;
    int page_level = level - kPageLog2;
    if (page_level < 0) {
      if (coarse_errors.empty()) return std::numeric_limits<double>::infinity();
      const auto& table = coarse_errors[s.patch];
      // Not below those of finer grids, whatever the table says.
      double error = pageBounds({s.patch, 0, 0, 0}).error_mm;
      for (int k = level; k < kPageLog2; ++k) error = table[k] >= 0 ? std::max<double>(error, table[k]) : std::numeric_limits<double>::infinity();
      return error;
    }
    Square page = s.ancestor(std::min(page_level, s.level));
    double whole = pageBounds(page).error_mm;
    int part_depth = std::min(s.level - page.level, kErrorBlocksLog2);
    if (part_depth == 0 || whole == 0) return whole;
    uint64_t k = key(page);
    uint32_t found = parts_index.find(k);
    if (found == IndexTable::kNone) {
      found = static_cast<uint32_t>(parts.size());
      parts_index.insert(k, found);
      parts.emplace_back().read(*oracle, page.id(), static_cast<float>(whole));
    }
    Square part = s.ancestor(page.level + part_depth);
    return parts[found].at(part_depth, part.x - (page.x << part_depth), part.y - (page.y << part_depth));
  }
};

class Selection {
 public:
  Selection(Forest& mesh, const LodView& view, const ReliefSet& resident) : m_(mesh), resident_(resident), camera_(view) {
    flat_ = !view.relief || !mesh.has_relief;
    exaggerate_ = flat_ ? 0 : std::isfinite(view.exaggerate) ? view.exaggerate : 1.0;
    error_px_ = view.error_px > kMinErrorPx ? view.error_px : kMinErrorPx;
    min_cell_px_ = view.min_cell_px > 0 ? view.min_cell_px : 0;
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
  // What a square alone determines.
  struct Info {
    double px_per_mm = 0, diameter_mm = 0, cell_px = 0;  // cell_px: of the whole square, as one cell
    glm::dvec3 centre{0};
    int wanted_level = 0;  // absolute
    bool culled = false;
  };
  struct Node {
    Square square;
    State state = State::kLeaf;
    bool blocked = false;    // would be split if more pages were resident
    bool barren = false;     // split, and no child is in view
    bool rough = false;      // an edge wants more than its grid can give
    int resident_level = 0;  // vertices up to this absolute level have samples
    int needs_level = 0;     // absolute level that must stay (or become) resident, whatever its edges want
    int grid_level = 1;
    int wanted_level = 0;    // the largest of its edges'
    std::array<std::array<uint8_t, 2>, 4> segments{};
  };

  // ---- squares
  Hull hullOf(const Square& s) {
    HeightBounds h{};
    if (!flat_) h = m_.heights(s);
    double low = flat_ ? 0 : h.min_mm * exaggerate_, high = flat_ ? 0 : h.max_mm * exaggerate_;
    double step = std::ldexp(1.0, -s.level);
    Hull hull;
    for (int k = 0; k < 4; ++k) {
      double u = (s.x + (k & 1)) * step, v = (s.y + (k >> 1)) * step;
      glm::dvec3 p = m_.base->point(s.patch, u, v), n = m_.base->normal(s.patch, u, v);
      hull.points[k] = p + low * n;
      hull.points[4 + k] = p + high * n;
    }
    return hull;
  }
  const Info& info(const Square& s) {
    uint64_t k = m_.key(s);
    if (uint32_t found = info_index_.find(k); found != IndexTable::kNone) return infos_[found];
    info_index_.insert(k, static_cast<uint32_t>(infos_.size()));
    return infos_.emplace_back(evaluate(s));
  }
  Info evaluate(const Square& s) {
    Info in;
    in.wanted_level = s.level;
    if (!camera_.valid) return in;
    Hull hull = hullOf(s);
    glm::dvec3 low = hull.points[0], high = low;
    for (const glm::dvec3& p : hull.points) low = glm::min(low, p), high = glm::max(high, p);
    in.centre = 0.5 * (low + high);
    in.diameter_mm = glm::length(high - low);
    for (const glm::dvec4& plane : camera_.planes) {
      double reach = std::numeric_limits<double>::lowest(), terms = 0;
      for (const glm::dvec3& p : hull.points) {
        reach = std::max(reach, LodCamera::value(plane, p));
        terms = std::max(terms, std::abs(plane.x * p.x) + std::abs(plane.y * p.y) + std::abs(plane.z * p.z) + std::abs(plane.w));
      }
      // Vertices are computed in floats: what is on the plane stays.
      in.culled = in.culled || reach < -1e-6 * terms;
    }
    in.px_per_mm = camera_.scale;
    double nearest_px_per_mm = camera_.scale;
    if (!camera_.orthographic) {
      double depth = std::numeric_limits<double>::max(), secant = 1;
      for (const glm::dvec3& p : hull.points) {
        double z = LodCamera::value(camera_.depth_row, p);
        depth = std::min(depth, z);
        secant = std::max(secant, z >= camera_.near_mm ? glm::length(p - camera_.eye) / z : camera_.max_secant);
      }
      nearest_px_per_mm = camera_.scale / std::max(camera_.near_mm, depth);
      in.px_per_mm = nearest_px_per_mm * std::min(secant, camera_.max_secant);
    }
    double longest = 0;
    for (int a : {0, 4})
      for (auto [i, j] : {std::array{0, 1}, std::array{2, 3}, std::array{0, 2}, std::array{1, 3}})
        longest = std::max(longest, glm::length(hull.points[a + i] - hull.points[a + j]));
    in.cell_px = longest * nearest_px_per_mm;
    int level = s.level;
    double cell_px = in.cell_px;
    const int finest = std::min(s.level + kPageLog2, m_.unit_log2);
    for (; level < finest && !(errorMm(s, level, in) * in.px_per_mm <= error_px_) && cell_px > min_cell_px_; ++level) cell_px *= 0.5;
    in.wanted_level = level;
    return in;
  }
  // Of the surface through the vertices of an absolute level, within a square.
  // Exaggerated x times, S = P + x h N = x (P + h N) + (1 - x) P: the baked error x times, and what is left of the bilinear P's.
  // The latter: P's mixed term d u v, cut along the diagonal of cells of width w, is off by |d| w^2 / 4 in their middle.
  double errorMm(const Square& s, int level, const Info& in) {
    if (level >= m_.unit_log2) return 0;
    double error = std::abs(1 - exaggerate_) * std::ldexp(0.25 * m_.twist_mm[s.patch], -2 * level);
    if (!flat_) error += std::abs(exaggerate_) * m_.bakedError(s, level);
    return std::isnan(error) ? in.diameter_mm : std::min(error, in.diameter_mm);
  }
  // Of an edge between two squares of one level, or at the border.
  int edgeWants(const Square& s, const Square* other) {
    int wanted = info(s).wanted_level;
    return other ? std::max(wanted, info(*other).wanted_level) : wanted;
  }

  // ---- the tree
  bool isResident(const Square& page) const {
    return assume_resident_ || page.level == 0 || (page.level <= m_.depth && resident_.count(page.id()) != 0);
  }
  int residentLevel(const Square& s, int inherited) const {
    if (flat_) return m_.unit_log2;
    return s.level <= m_.depth && isResident(s) ? s.level + kPageLog2 : inherited;
  }
  uint32_t findNode(const Square& s) const { return node_index_.find(m_.key(s)); }
  void addNode(const Square& s, int inherited, int needs_level) {
    if (info(s).culled) return;  // a node that is not in the table is not drawn
    node_index_.insert(m_.key(s), static_cast<uint32_t>(nodes_.size()));
    Node n;
    n.square = s;
    n.resident_level = residentLevel(s, inherited);
    n.needs_level = needs_level;
    nodes_.push_back(n);
  }
  // Children need at least the grid of level 1: whole units, and samples for it.
  bool maySplit(uint32_t index) {
    Node& n = nodes_[index];
    if (n.square.level + 2 > m_.unit_log2 || n.square.level + 1 > m_.max_level) return false;
    if (n.resident_level >= n.square.level + 2) return true;
    bool all = true;
    for (uint32_t k = 0; k < 4; ++k) all = all && isResident(n.square.child(k & 1, k >> 1));
    if (!all) {
      limited_tree_ = true;
      n.needs_level = std::max(n.needs_level, n.square.level + 2);
      n.blocked = true;
    }
    return all;
  }
  bool wantsSplit(uint32_t index) {
    const Square s = nodes_[index].square;
    const int limit = s.level + kMaxSplitLevel;
    if (info(s).cell_px > max_node_px_) return true;
    bool wants = false;
    for (int side = 0; side < 4 && !wants; ++side) {
      Square other;
      wants = edgeWants(s, m_.neighbour(s, side, other) ? &other : nullptr) > limit;
    }
    Node& n = nodes_[index];
    n.rough = wants;
    if (!wants || n.resident_level > limit || n.resident_level >= m_.unit_log2) return wants;
    // Without finer pages smaller nodes would only cut the same triangles into more instances.
    bool finer = false;
    for (uint32_t k = 0; k < 4; ++k) finer = finer || isResident(s.child(k & 1, k >> 1));
    limited_tree_ = limited_tree_ || !finer;
    return finer;
  }
  bool split(uint32_t index) {
    if (nodes_[index].state == State::kSplit) return true;
    if (!maySplit(index)) return false;
    const Square s = nodes_[index].square;
    for (int side = 0; side < 4 && s.level > 0; ++side) {
      Square other;
      if (!m_.neighbour(s, side, other) || findNode(other) != IndexTable::kNone) continue;
      uint32_t coarser = findNode(other.ancestor(s.level - 1));
      if (coarser == IndexTable::kNone || nodes_[coarser].state == State::kSplit) continue;  // out of view
      if (!split(coarser)) {
        nodes_[index].blocked = nodes_[coarser].blocked;
        return false;
      }
    }
    nodes_[index].state = State::kSplit;
    const int inherited = nodes_[index].resident_level;
    // The pages that this split rests on must stay wanted, even if the children, which are known better, want less:
    // else they would be evicted, the split undone, and the pages asked for again.
    const int needs = s.level + (nodes_[index].rough ? kMaxSplitLevel + 1 : 2);
    size_t before = nodes_.size();
    for (uint32_t k = 0; k < 4; ++k) addNode(s.child(k & 1, k >> 1), inherited, needs);
    if (nodes_.size() == before) {  // known better, it is out of view: it still wants the pages that tell
      nodes_[index].barren = true;
      nodes_[index].needs_level = needs;
    }
    return true;
  }
  // Builds the tree for a scaled error. Whether it fits is asked of the tree that all pages together would give: else arriving
  // pages would coarsen the error, the pages would no longer be wanted, be evicted, and the error refine again.
  bool fits(double asked_px, double scale, bool anyway) {
    error_px_ = asked_px * scale;
    max_node_px_ = kMaxNodePx * scale;
    infos_.clear();
    info_index_.clear();
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
    for (uint32_t patch = 0; patch < m_.base->patches.size(); ++patch) addNode({patch, 0, 0, 0}, flat_ ? m_.unit_log2 : kPageLog2, 0);
    size_t limit = nodes_.size() + kMaxLodNodes;
    if (!camera_.valid) return true;
    for (uint32_t i = 0; i < nodes_.size(); ++i) {
      if (nodes_.size() > limit) return anyway;
      if (nodes_[i].state == State::kLeaf && wantsSplit(i)) split(i);
    }
    return true;
  }

  // ---- the answer
  // The segments' level of one edge between squares of base_level: as wanted, as far as both sides have samples for it.
  uint8_t segmentsOf(Node& n, const Node* across, int wanted, int base_level, int cap, bool counts) {
    int available = across ? std::min(n.resident_level, across->resident_level) : n.resident_level;
    int level = std::max(std::min({wanted, available, base_level + cap, m_.unit_log2}), base_level);
    bool blocked = n.blocked || (across && across->blocked);
    n.wanted_level = std::max(n.wanted_level, wanted);
    if (counts && level < wanted && (available < wanted || blocked)) ++limited_;
    return static_cast<uint8_t>(level - base_level);
  }
  void levelSides(uint32_t index) {
    Node& n = nodes_[index];
    const Square s = n.square;
    n.wanted_level = info(s).wanted_level;
    for (int side = 0; side < 4; ++side) {
      auto whole = [&](int cap, const Square* other, uint32_t across) {
        const Node* a = across == IndexTable::kNone ? nullptr : &nodes_[across];
        // An edge is counted once: by the finer node, or by the first of two.
        uint8_t level = segmentsOf(n, a, edgeWants(s, other), s.level, cap, !a || a->square.level < s.level || index < across);
        n.segments[side] = {level, PatchInstance::kWholeEdge};
        n.grid_level = std::max<int>(n.grid_level, level);
      };
      Square other;
      if (!m_.neighbour(s, side, other)) {
        whole(kMaxGridLevel, nullptr, IndexTable::kNone);
        continue;
      }
      uint32_t same = findNode(other);
      if (same != IndexTable::kNone && nodes_[same].state == State::kLeaf) {
        whole(kMaxGridLevel, &other, same);
        continue;
      }
      if (same != IndexTable::kNone) {
        // Two half edges, each the whole edge of a finer node (or of nothing, if that one is out of view).
        bool upright = side == kLeft || side == kRight;
        for (uint32_t half = 0; half < 2; ++half) {
          Square mine = s.child(upright ? (side == kRight) : half, upright ? half : (side == kBottom)), theirs;
          m_.neighbour(mine, side, theirs);
          uint32_t finer = findNode(theirs);
          const Node* f = finer != IndexTable::kNone ? &nodes_[finer] : nullptr;
          assert(!f || f->state == State::kLeaf);
          uint8_t level = segmentsOf(n, f, edgeWants(mine, &theirs), s.level + 1, kMaxGridLevel - 1, !f);
          n.segments[side][half] = level;
          n.grid_level = std::max(n.grid_level, level + 1);
        }
        continue;
      }
      uint32_t coarser = s.level > 0 ? findNode(other.ancestor(s.level - 1)) : IndexTable::kNone;
      if (coarser != IndexTable::kNone && nodes_[coarser].state == State::kSplit) coarser = IndexTable::kNone;
      whole(coarser != IndexTable::kNone ? kMaxGridLevel - 1 : kMaxGridLevel, &other, coarser);
    }
  }
  double predictedPx(const Node& n) {
    const Info& in = info(n.square);
    int drawn = n.square.level + n.grid_level;
    double error = errorMm(n.square, drawn, in);
    for (const auto& side : n.segments) {
      bool halves = side[1] != PatchInstance::kWholeEdge;
      for (int half = 0; half < (halves ? 2 : 1); ++half) {
        // Where vertices snapped, a triangle has corners of two levels: each may be off by the coarser level's error, to
        // opposite sides.
        int level = n.square.level + side[half] + (halves ? 1 : 0);
        if (level < drawn) error = std::max(error, std::min(2 * errorMm(n.square, level, in), in.diameter_mm));
      }
    }
    return error * in.px_per_mm;
  }
  Square reliefPage(const Node& n) const {
    int level = std::clamp(n.square.level + n.grid_level - kPageLog2, 0, m_.depth);
    for (; level < std::min(n.square.level, m_.depth); ++level)
      if (isResident(n.square.ancestor(level))) break;
    assert(isResident(n.square.ancestor(level)));
    return n.square.ancestor(level);
  }
  // The page that a node would like, the one it uses, and a ladder above: see planar_lod.cpp.
  void addWants(const Node& n, int wanted_level, const Square& used) {
    const Square& s = n.square;
    float priority = camera_.priority(info(s).centre);
    int finest = std::min(s.level, m_.depth);
    int level = std::clamp(wanted_level - kPageLog2, 0, finest);
    for (int at = level; at >= 0; at = at > 0 ? std::max(0, at - kWantLadder) : -1) addWant(s.ancestor(at), priority);
    if (used.level != level) addWant(used, priority);
  }
  void addWant(const Square& page, float priority) {
    uint64_t k = m_.key(page);
    uint32_t found = want_index_.find(k);
    if (found == IndexTable::kNone) {
      want_index_.insert(k, static_cast<uint32_t>(wants_.size()));
      wants_.push_back({page.id(), priority});
    } else {
      wants_[found].priority = std::min(wants_[found].priority, priority);
    }
  }

  PlanarLodResult finish() {
    PlanarLodResult result;
    for (uint32_t i = 0; i < nodes_.size(); ++i)
      if (nodes_[i].state == State::kLeaf) levelSides(i);
    const bool asks = !flat_ && camera_.valid;
    for (const Node& n : nodes_) {
      if (n.barren && asks) addWants(n, n.needs_level, n.square.ancestor(0));
      if (n.state != State::kLeaf) continue;
      PatchInstance p;
      p.node = n.square.id();
      int shift = m_.unit_log2 - n.square.level;
      p.x0 = static_cast<int32_t>(n.square.x << shift);
      p.y0 = static_cast<int32_t>(n.square.y << shift);
      p.grid_level = static_cast<uint8_t>(n.grid_level);
      p.step_log2 = static_cast<uint8_t>(shift - n.grid_level);
      p.edges = n.segments;
      p.relief_page = {p.node.patch, 0, 0, 0};
      if (camera_.valid) result.max_error_px = std::max(result.max_error_px, predictedPx(n));
      if (!flat_) {
        Square page = reliefPage(n);
        p.relief_page = page.id();
        if (asks) addWants(n, std::max({n.square.level + n.grid_level, n.needs_level, n.wanted_level}), page);
      }
      result.instances.push_back(p);
    }
    result.wants = std::move(wants_);
    sortLists(result);
    result.limited_by_residency = limited_;
    result.error_px = error_px_;
    return result;
  }

  Forest& m_;
  const ReliefSet& resident_;
  const LodCamera camera_;
  bool flat_ = false;
  double exaggerate_ = 1, error_px_ = 1, max_node_px_ = kMaxNodePx, min_cell_px_ = 0;
  std::vector<Node> nodes_;
  std::vector<Info> infos_;
  std::vector<ReliefWant> wants_;
  IndexTable node_index_, info_index_, want_index_;
  bool assume_resident_ = false;  // what would be drawn if every page were here
  bool limited_tree_ = false;     // a split did not happen for want of pages
  uint32_t limited_ = 0;
};

}  // namespace

struct MeshLod::Impl {
  Forest forest;
};

MeshLod::MeshLod(std::shared_ptr<const BaseMesh> base, int relief_depth, double relief_offset_mm, double relief_scale_mm,
                 std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse)
    : impl_(new Impl{Forest(std::move(base), relief_depth, relief_offset_mm, relief_scale_mm, std::move(oracle), std::move(coarse))}) {}
MeshLod::~MeshLod() = default;

PlanarLodResult MeshLod::select(const LodView& view, const ReliefSet& resident) {
  Forest& forest = impl_->forest;
  if (forest.parts.size() > kMaxParts) {
    forest.parts.clear();
    forest.parts_index.clear();
  }
  return Selection(forest, view, resident).run();
}

}  // namespace relievo
