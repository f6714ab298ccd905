// strategy_bintree.cpp - longest-edge bisection: a binary tree of right triangles over a flat artwork, each split at
// the middle of its hypotenuse. Duchaineau et al. 1997, "ROAMing Terrain: Real-time Optimally Adapting Meshes", with
// the refinement of Lindstrom, Pascucci 2002, "Terrain Simplification Simplified": whether a triangle is split depends
// on the vertex that the split adds, by an error and a box that hold those of all vertices below it. Then both
// triangles of a hypotenuse are split or neither is, and there are no cracks and no forced splits.
//
// The bound. The error of a vertex is how far adding it moves the surface (the height at the hypotenuse's middle less
// the mean of its ends) plus the largest error of the vertices below: ROAM's wedge (their section 4). So a triangle
// left whole is off by its vertex's error at most. At the finest level half of the cells are cut along the other
// diagonal than the relief's surface (lod.h): that difference is the error of what cannot be split.
//
// Squares that the artwork's border cuts are split down to the finest cells, since clamped vertices lie on no middle.
// Memory: 8 bytes a sample.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <unordered_map>

#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

// A sample's place, counted in samples from the artwork's corner; it may lie beyond the border.
struct BintreePlace {
  int64_t x = 0, y = 0;
  friend BintreePlace middle(const BintreePlace& a, const BintreePlace& b) {
    return {(a.x + b.x) / 2, (a.y + b.y) / 2};
  }
};

// Of a vertex and all below it: error and heights, in steps of a sample's range.
struct BintreeVertex {
  float error = 0;
  uint16_t low = 65535, high = 0;
  void hold(const BintreeVertex& below) {
    error = std::max(error, below.error);
    low = std::min(low, below.low);
    high = std::max(high, below.high);
  }
  void hold(uint16_t height) {
    low = std::min(low, height);
    high = std::max(high, height);
  }
};

class BintreeVertices {
 public:
  explicit BintreeVertices(const ReliefField& field)
      : field_(field),
        side_(int64_t{kPagePx} << std::max(0, field.domain.relief_depth)),
        columns_(field.domain.patchColumns() * side_ + 1),
        rows_(field.domain.patchRows() * side_ + 1),
        vertices_(static_cast<size_t>(columns_ * rows_)) {
    // Vertices in the middle of a square's side, then in the middle of squares twice as large, and so on.
    for (int64_t half = 1; half < side_; half *= 2) {
      forEachSideVertex(half, [&](const BintreePlace& m) { fillSideVertex(m, half); });
      for (int64_t y = half; y < rows_; y += 2 * half)
        for (int64_t x = half; x < columns_; x += 2 * half) fillSquareVertex({x, y}, half);
    }
  }
  int64_t side() const { return side_; }  // of a patch, samples
  const BintreeVertex& at(const BintreePlace& p) const { return vertices_[static_cast<size_t>(p.y * columns_ + p.x)]; }
  uint16_t height(const BintreePlace& p) const {
    return field_.at(std::min(p.x, field_.columns - 1), std::min(p.y, field_.rows - 1));
  }
  // A finest cell by its lower corner: the error where it is cut along the diagonal that the relief's surface has not.
  BintreeVertex cell(const BintreePlace& p) const {
    BintreeVertex out;
    for (const int64_t k : {0, 1, 2, 3}) out.hold(height({p.x + k % 2, p.y + k / 2}));
    if ((p.x + p.y) % 2 != 0)
      out.error = 0.5f * static_cast<float>(std::abs(height(p) + height({p.x + 1, p.y + 1}) - height({p.x + 1, p.y}) -
                                                     height({p.x, p.y + 1})));
    return out;
  }
  // The ends of the diagonal that a square is split along: in squares of its size from the corner, those of which both
  // coordinates are even or both are odd.
  static std::array<BintreePlace, 2> diagonalOf(const BintreePlace& m, int64_t half) {
    const bool falls = ((m.x - half) / (2 * half) + (m.y - half) / (2 * half)) % 2 == 0;
    const BintreePlace a{m.x - half, falls ? m.y - half : m.y + half}, b{m.x + half, falls ? m.y + half : m.y - half};
    return {a, b};
  }

 private:
  BintreeVertex& own(const BintreePlace& p) { return vertices_[static_cast<size_t>(p.y * columns_ + p.x)]; }
  bool inside(const BintreePlace& p) const { return p.x >= 0 && p.y >= 0 && p.x < columns_ && p.y < rows_; }
  template <class F>
  void forEachSideVertex(int64_t half, F&& f) {
    for (int64_t y = 0; y < rows_; y += half)
      for (int64_t x = y / half % 2 == 0 ? half : 0; x < columns_; x += 2 * half) f(BintreePlace{x, y});
  }
  float moved(const BintreePlace& m, const BintreePlace& a, const BintreePlace& b) const {
    return std::abs(static_cast<float>(height(m)) -
                    0.5f * (static_cast<float>(height(a)) + static_cast<float>(height(b))));
  }
  void fillSideVertex(const BintreePlace& m, int64_t half) {
    BintreeVertex& v = own(m);
    const bool level = m.x / half % 2 != 0;  // the side runs along x
    const BintreePlace a{level ? m.x - half : m.x, level ? m.y : m.y - half},
        b{level ? m.x + half : m.x, level ? m.y : m.y + half};
    for (const int64_t k : {0, 1, 2, 3}) {
      const int64_t dx = k % 2 ? 1 : -1, dy = k / 2 ? 1 : -1;
      if (half > 1) {
        if (const BintreePlace below{m.x + dx * half / 2, m.y + dy * half / 2}; inside(below)) v.hold(at(below));
      } else if (const BintreePlace corner{m.x + (dx - 1) / 2, m.y + (dy - 1) / 2};
                 inside(corner) && inside({corner.x + 1, corner.y + 1})) {
        v.hold(cell(corner));
      }
    }
    const BintreePlace across{level ? 0 : half, level ? half : 0};
    add(v, m, {a, b}, {BintreePlace{m.x - across.x, m.y - across.y}, {m.x + across.x, m.y + across.y}});
  }
  void fillSquareVertex(const BintreePlace& m, int64_t half) {
    BintreeVertex& v = own(m);
    for (const BintreePlace& below :
         {BintreePlace{m.x - half, m.y}, {m.x + half, m.y}, {m.x, m.y - half}, {m.x, m.y + half}})
      v.hold(at(below));
    const auto ends = diagonalOf(m, half);
    add(v, m, ends, {BintreePlace{ends[0].x, ends[1].y}, {ends[1].x, ends[0].y}});
    // Cut by the border, or beyond it in part.
    const auto cut = [half](int64_t place, int64_t count) {
      return place - half < count - 1 && place + half > count - 1;
    };
    if (cut(m.x, field_.columns) || cut(m.y, field_.rows)) v.error = std::numeric_limits<float>::infinity();
  }
  // ends: of the hypotenuse; apexes: where the right angles of its two triangles are.
  void add(BintreeVertex& v, const BintreePlace& m, const std::array<BintreePlace, 2>& ends,
           const std::array<BintreePlace, 2>& apexes) {
    v.error += moved(m, ends[0], ends[1]);
    v.hold(height(m));
    for (size_t k : {0, 1}) {
      v.hold(height(ends[k]));
      if (inside(apexes[k])) v.hold(height(apexes[k]));
    }
  }

  const ReliefField& field_;
  int64_t side_, columns_, rows_;
  std::vector<BintreeVertex> vertices_;
};

class Bintree final : public LodStrategy {
 public:
  explicit Bintree(const StrategyScene& scene) : scene_(scene), bounds_(scene), vertices_(*scene.field) {}

  StrategyResult select(const LodView& view) override {
    const ViewBounds screen(view);
    StrategyResult out;
    out.rule = GridRule::kTrianglesOnly;
    out.error_px = view.error_px;
    out.predicted_px = 0;
    std::unordered_map<NodeId, uint32_t> instances;
    const Descent descent{*this, screen, view.error_px, view.exaggerate, out, instances};
    const int64_t half = vertices_.side() / 2;
    for (const NodeId& patch : bounds_.nodesInView(screen, 0, view.exaggerate)) {
      const bool along_x = scene_.domain.flat().alongX();
      const int64_t from = int64_t{patch.patch} * vertices_.side();
      const BintreePlace m{(along_x ? from : 0) + half, (along_x ? 0 : from) + half};
      const auto [a, b] = BintreeVertices::diagonalOf(m, half);
      descent.refine({a, {b.x, a.y}, b}, half, false);
      descent.refine({b, {a.x, b.y}, a}, half, false);
    }
    return out;
  }

 private:
  // The right angle is at `apex`.
  struct Triangle {
    BintreePlace from, apex, to;
  };
  struct Descent {
    Bintree& tree;
    const ViewBounds& screen;
    double budget_px, exaggerate;
    StrategyResult& out;
    std::unordered_map<NodeId, uint32_t>& instances;

    // half: of the hypotenuse's extent along an axis. side: the hypotenuse is a square's side, else its diagonal.
    void refine(const Triangle& t, int64_t half, bool side) const {
      if (half == 0) return finest(t);
      const BintreePlace m = middle(t.from, t.to);
      const BintreeVertex& v = tree.vertices_.at(m);
      // Vertices below: from a square's middle `half` along an axis, then half / 2 along both, then as from the middle
      // of a square half as large, and so on; in all 3 half from a square's middle and 2 half from that of a side. The
      // box so holds those of all vertices below.
      const WorldBox box = tree.boxOf(m, (side ? 2 : 3) * half, v, exaggerate);
      if (screen.culled(box)) return;
      const double error_px = tree.errorPx(v, box, screen, exaggerate);
      if (error_px > budget_px) {
        refine({t.from, m, t.apex}, side ? half / 2 : half, !side);
        refine({t.apex, m, t.to}, side ? half / 2 : half, !side);
        return;
      }
      add(t, half, error_px);
    }
    void finest(const Triangle& t) const {
      const BintreePlace corner{std::min(t.from.x, t.to.x), std::min(t.from.y, t.to.y)};
      const BintreeVertex v = tree.vertices_.cell(corner);
      const WorldBox box = tree.boxOf(corner, 1, v, exaggerate);
      if (!screen.culled(box)) add(t, 1, tree.errorPx(v, box, screen, exaggerate));
    }
    // The instance that a triangle's places count in: a node of grids whose cells are as wide as half a hypotenuse.
    uint32_t instanceOf(const Triangle& t, int64_t half) const {
      const int level = tree.bounds_.finestLevel() - std::countr_zero(static_cast<uint64_t>(half)),
                node_level = std::max(0, level - kMaxGridLevel);
      const int64_t size = tree.vertices_.side() >> node_level;
      const NodeId node = tree.scene_.domain.flat().nodeAt(
          node_level, static_cast<uint64_t>(std::min({t.from.x, t.apex.x, t.to.x}) / size),
          static_cast<uint64_t>(std::min({t.from.y, t.apex.y, t.to.y}) / size));
      const auto [known, added] = instances.try_emplace(node, static_cast<uint32_t>(out.instances.size()));
      if (added) out.instances.push_back(tree.bounds_.instance(node, std::max(1, level - node_level)));
      return known->second;
    }
    void add(const Triangle& t, int64_t half, double error_px) const {
      // All beyond the border, where it has no area.
      const ReliefField& field = *tree.scene_.field;
      if (std::min({t.from.x, t.apex.x, t.to.x}) >= field.columns - 1 ||
          std::min({t.from.y, t.apex.y, t.to.y}) >= field.rows - 1)
        return;
      out.predicted_px = std::max(out.predicted_px, error_px);
      const uint32_t instance = instanceOf(t, half);
      for (const BintreePlace& p : {t.from, t.apex, t.to})
        out.triangles.push_back({static_cast<int32_t>(p.x << field.spacing_log2),
                                 static_cast<int32_t>(p.y << field.spacing_log2),
                                 static_cast<float>(tree.vertices_.height(p)), instance});
    }
  };

  WorldBox boxOf(const BintreePlace& p, int64_t reach, const BintreeVertex& v, double exaggerate) const {
    const ReliefField& field = *scene_.field;
    const double unit = std::ldexp(1.0, field.spacing_log2), low = heightMm(v.low) * exaggerate,
                 high = heightMm(v.high) * exaggerate;
    WorldBox box;
    box.centre = field.worldMm(static_cast<double>(p.x) * unit, static_cast<double>(p.y) * unit, 0.5 * (low + high));
    const double reach_mm = static_cast<double>(reach) * unit * field.mmPerUnit();
    box.half = {reach_mm, reach_mm, 0.5 * std::abs(high - low)};
    return box;
  }
  double heightMm(uint16_t steps) const {
    return scene_.domain.relief_offset_mm + scene_.domain.relief_scale_mm * steps;
  }
  double errorPx(const BintreeVertex& v, const WorldBox& box, const ViewBounds& screen, double exaggerate) const {
    const double mm = double{v.error} * std::abs(exaggerate * scene_.domain.relief_scale_mm);
    return mm > 0 ? mm * screen.pxPerMm(box) : 0;
  }

  StrategyScene scene_;
  ReliefBounds3d bounds_;
  BintreeVertices vertices_;
};

}  // namespace

StrategyEntry bintreeStrategy() {
  StrategyEntry e;
  e.name = "bintree";
  e.title = "Longest-edge bisection";
  e.purpose =
      "right triangles split at the middle of their hypotenuses until the budget holds (ROAM, refined as by Lindstrom "
      "and Pascucci), rebuilt for every view";
  e.flat_only = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Bintree>(scene); };
  return e;
}

}  // namespace relievo
