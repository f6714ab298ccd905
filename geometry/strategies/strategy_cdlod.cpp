// strategy_cdlod.cpp - a quadtree with vertex morphing: Strugar 2010, "Continuous Distance-Dependent Level of Detail
// for Rendering Heightmaps". Every level of vertices L has a distance R[L] up to which it is used; in the last part of
// it its vertices slide onto those of the next coarser level, so that they are there where that one begins. Nodes are
// grids of 32 x 32 cells; a quarter of a node that lies beyond the finer level's range is drawn at the node's own level
// (his section 3.3). He chooses the ranges by hand. Here a level's range begins where the typical error of the next
// coarser one (root mean square over the artwork's pages) is within the budget: one range for all places is the
// method's nature, so places rougher than most exceed the budget, and what bound that leaves is told. (By the worst
// page, a single step in the relief would have everything drawn at full resolution.)
//
// The bound. An odd vertex slides along an edge (or the diagonal) of its own grid to a vertex of the coarser one: it
// stays on the finer surface F, and within its triangle of the coarser surface C. So the drawn triangle is C plus an
// interpolation of F - C, and lies within |C - true| + |F - C| <= 2 e[L - 1] of the relief; e[L] where nothing has
// begun to slide, e[L - 1] where all has arrived. Where a range begins, both sides must agree: a finer node that
// reaches into R[L + 1] ends within a diagonal of it, and the coarser level slides only beyond.
//
// Over a base mesh: the same quadtree in every patch, nodes of fewer cells where there are many patches, diagonals and
// ranges those of the largest. An odd vertex on a patch's side slides towards the side's corner with the smaller index,
// from whichever patch it is seen (shaders/compare_morph.vert): still along an edge of its own grid and within the same
// coarser triangle, so the bound is the same.
#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

constexpr double kUnmorphed = 0.7;    // of a range; Strugar morphs in the last 15 to 30 per cent
constexpr double kRangeSlack = 1.01;  // fp32 distances in the shader
constexpr double kRootCells = 2048;   // of all patches of a base mesh together, at the coarsest

class Cdlod final : public LodStrategy {
 public:
  explicit Cdlod(const StrategyScene& scene) : scene_(scene), bounds_(scene) {
    finest_ = bounds_.finestLevel();
    coarsest_ = std::min(kMaxGridLevel, finest_);
    if (!scene.domain.isFlat()) {
      const auto patches = static_cast<double>(scene.body->base->patches.size());
      coarsest_ = std::clamp(static_cast<int>(std::lround(0.5 * std::log2(kRootCells / patches))), 1, coarsest_);
      measureSides(*scene.body);
    }
    range_mm_.assign(static_cast<size_t>(std::max(0, scene.domain.relief_depth)) + 1, 0);
    for (const NodeId& page : *scene.resident)
      range_mm_[page.level] = std::max(range_mm_[page.level], bounds_.rangeMm(page));
  }

  StrategyResult select(const LodView& view) override {
    ViewBounds screen(view);
    StrategyResult result;
    result.rule = GridRule::kMorphed;
    result.error_px = view.error_px;
    // Orthographic: a range is 0 or endless, so one level is for all, and nothing slides: the eye is far away,
    // whichever way.
    result.morph_eye_mm = view.eye_mm + glm::dvec3(0, 0, screen.orthographic() ? ViewBounds::kFarEyeMm : 0.0);
    setRanges(view, screen);
    for (int level = coarsest_; level <= finest_; ++level)
      result.morph[static_cast<size_t>(level)] = {static_cast<float>(start_[level]), static_cast<float>(end_[level])};
    for (uint32_t p = 0; p < scene_.domain.patchCount(); ++p)
      add({p, 0, 0, 0}, coarsest_, screen, view.exaggerate, result);
    sortInstances(result.instances);
    result.predicted_px = 0;
    for (const PatchInstance& p : result.instances)
      result.predicted_px = std::max(result.predicted_px, boundOf(p, screen, view.exaggerate));
    return result;
  }

 private:
  // Of the largest box around a node of that level.
  double diagonalMm(uint32_t node_level, double exaggerate) const {
    if (!scene_.domain.isFlat()) {
      // Sides of a bilinear patch's squares are halved with each level, those of its normals too.
      const double sides =
          std::ldexp(side_mm_ + reach_mm_ * std::abs(exaggerate) * side_normal_, -static_cast<int>(node_level));
      return std::sqrt(3.0) *
             (sides + range_mm_[std::min<size_t>(node_level, range_mm_.size() - 1)] * std::abs(exaggerate));
    }
    double side = std::ldexp(static_cast<double>(scene_.domain.patchPx()) * scene_.domain.mm_per_px,
                             -static_cast<int>(node_level));
    double height = range_mm_[std::min<size_t>(node_level, range_mm_.size() - 1)] * std::abs(exaggerate);
    return std::sqrt(2 * side * side + height * height);
  }
  void measureSides(const BodyField& body) {
    for (const auto& c : body.base->patches) {
      auto longer = [&](glm::vec3 BaseCorner::*field, size_t a, size_t b, size_t d, size_t e) {
        auto at = [&](size_t k) { return glm::dvec3(body.base->corners[c[k]].*field); };
        return std::max(glm::length(at(a) - at(b)), glm::length(at(d) - at(e)));
      };
      auto sides = [&](glm::vec3 BaseCorner::*field) { return longer(field, 0, 1, 2, 3) + longer(field, 0, 2, 1, 3); };
      side_mm_ = std::max(side_mm_, sides(&BaseCorner::position_mm));
      side_normal_ = std::max(side_normal_, sides(&BaseCorner::normal));
    }
    const PatchDomain& d = scene_.domain;
    reach_mm_ = std::max(std::abs(d.relief_offset_mm), std::abs(d.relief_offset_mm + 65535 * d.relief_scale_mm));
  }
  void setRanges(const LodView& view, const ViewBounds& screen) {
    constexpr double kFar = 1e30;
    double reach = 0;  // R of the finer level
    for (int level = finest_; level >= coarsest_; --level) {
      // No morphing at the coarsest level: there is nothing beyond it.
      start_[level] = end_[level] = kFar;
      if (level == coarsest_) break;
      double coarser_mm = bounds_.typicalErrorMm(level - 1) * std::abs(view.exaggerate);
      double needed = std::min(screen.distanceFor(coarser_mm, view.error_px), kFar / 16);
      double clear =
          level == finest_
              ? 0
              : kRangeSlack * (reach + diagonalMm(static_cast<uint32_t>(level + 1 - coarsest_), view.exaggerate));
      start_[level] = std::max({needed, clear, reach, 1e-3});
      end_[level] = reach + (start_[level] - reach) / kUnmorphed;
      reach = end_[level];
    }
  }
  // False: too far for this level.
  bool add(const NodeId& node, int level, const ViewBounds& screen, double exaggerate, StrategyResult& out) {
    if (!scene_.domain.nodeExists(node)) return true;
    WorldBox box = bounds_.box(node, exaggerate);
    double nearest = screen.nearestMm(box);
    if (nearest > end_[level]) return false;
    if (screen.culled(box)) return true;
    if (level == finest_ || nearest > end_[level + 1]) {
      out.instances.push_back(bounds_.instance(node, coarsest_));
      return true;
    }
    for (uint32_t k = 0; k < 4; ++k) {
      NodeId child = node.child(k & 1, k >> 1);
      if (!add(child, level + 1, screen, exaggerate, out) && !screen.culled(bounds_.box(child, exaggerate)))
        out.instances.push_back(bounds_.instance(child, coarsest_ - 1));
    }
    return true;
  }
  double boundOf(const PatchInstance& p, const ViewBounds& screen, double exaggerate) {
    int level = static_cast<int>(p.node.level) + p.grid_level;
    WorldBox box = bounds_.box(p.node, exaggerate);
    double error = bounds_.errorMm(p.node, level, exaggerate);
    if (level > coarsest_ && kRangeSlack * screen.farthestMm(box) > start_[level]) {
      double coarser = bounds_.errorMm(p.node, level - 1, exaggerate);
      error = screen.nearestMm(box) > kRangeSlack * end_[level]
                  ? coarser
                  : std::min(2 * coarser, bounds_.largestMm(p.node, exaggerate));
    }
    return error > 0 ? error * screen.pxPerMm(box) : 0;
  }

  StrategyScene scene_;
  ReliefBounds3d bounds_;
  int finest_ = 0, coarsest_ = 0;  // absolute levels of vertices
  std::vector<double> range_mm_;   // of heights within a page, the largest, by page level
  // Over a base mesh, the largest: two sides of a patch, the same of its normals; a height.
  double side_mm_ = 0, side_normal_ = 0, reach_mm_ = 0;
  std::array<double, kMorphLevels + 2> start_{}, end_{};
};

}  // namespace

StrategyEntry cdlodStrategy() {
  StrategyEntry e;
  e.name = "cdlod";
  e.title = "CDLOD quadtree, morphing";
  e.purpose =
      "a quadtree by distance, one range a level for the whole artwork by its typical error, vertices slide onto the "
      "next level before it begins";
  e.make = [](const StrategyScene& scene) { return std::make_unique<Cdlod>(scene); };
  return e;
}

}  // namespace relievo
