// strategy_discrete.cpp - discrete LOD: the whole artwork as some meshes, each of half the triangles of the one before,
// of which one is drawn for a view. Clark 1976, "Hierarchical Geometric Models for Visible Surface Algorithms"; Luebke
// et al. 2003, "Level of Detail for 3D Graphics", section 1.2. surface_simplify.h says how they are simplified.
//
// The bound. A level's error is how far its triangles lie from the finest relief above the same places, at all of them
// (FineSurface::deviationMm). The coarsest level is drawn whose error, where what is in view is nearest, is within the
// budget. Then the budget is kept, unless the artwork has so many samples that the finest level is not the relief
// itself: error_px says so.
//
// A level is drawn in pieces of about 2,000 triangles that lie together, and only those in view.
//
// Made when the first view asks, for all budgets at once. At most kMostVertices samples are vertices of the finest
// level, else every second one along both axes, and so on. Memory: about 150 bytes a vertex with all levels, 250 while
// they are made.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "geometry/strategies/encoded_parts.h"
#include "geometry/strategies/strategy_bounds.h"
#include "geometry/strategies/strategy_list.h"
#include "geometry/strategies/surface_simplify.h"

namespace relievo {
namespace {

constexpr size_t kPieceTriangles = 2048;
constexpr size_t kLeastTriangles = 64;  // of the coarsest level

struct DiscretePiece {
  IndexRange range;
  WorldBox box;
};
struct DiscreteLevel {
  std::shared_ptr<StrategyMesh> mesh;
  double error_mm = 0;
  std::vector<DiscretePiece> pieces;
};
struct DiscreteLevels {
  std::vector<DiscreteLevel> levels;  // fine to coarse, errors never falling
};

// Places of triangles along a Z-shaped curve, patch after patch, so that pieces are compact.
std::vector<uint32_t> inCompactOrder(const FineSurface& surface, const std::vector<uint32_t>& triangles) {
  std::vector<std::pair<uint64_t, uint32_t>> order(triangles.size() / 3);
  for (uint32_t t = 0; t < order.size(); ++t) {
    const auto a = surface.place(triangles[3 * t]), b = surface.place(triangles[3 * t + 1]),
               c = surface.place(triangles[3 * t + 2]);
    uint64_t key = 0;
    for (int bit = 17; bit >= 0; --bit)
      key = key << 2 | ((static_cast<uint64_t>((a.j + b.j + c.j) / 3) >> bit & 1) << 1) |
            (static_cast<uint64_t>((a.i + b.i + c.i) / 3) >> bit & 1);
    order[t] = {uint64_t{a.patch} << 40 | key, t};
  }
  std::sort(order.begin(), order.end());
  std::vector<uint32_t> out;
  out.reserve(triangles.size());
  for (const auto& [key, t] : order) out.insert(out.end(), triangles.begin() + 3 * t, triangles.begin() + 3 * t + 3);
  return out;
}

DiscreteLevel discreteLevel(const FineSurface& surface, const std::vector<uint32_t>& triangles, double exaggerate) {
  DiscreteLevel level;
  level.mesh = std::make_shared<StrategyMesh>();
  level.error_mm = surface.mmFor(surface.deviationMm(triangles), exaggerate);
  double samples = 0;  // squares of samples that a triangle takes, on average
  for (size_t k = 0; k < triangles.size(); k += 3) samples += surface.samplesOf(&triangles[k]);
  const double cell = std::sqrt(2 * samples / static_cast<double>(std::max<size_t>(1, triangles.size() / 3)));
  const std::vector<uint32_t> ordered = inCompactOrder(surface, triangles);
  surface.append(ordered, cell, *level.mesh);
  for (size_t first = 0; first < ordered.size(); first += 3 * kPieceTriangles) {
    const size_t count = std::min(3 * kPieceTriangles, ordered.size() - first);
    level.pieces.push_back({{static_cast<uint32_t>(first), static_cast<uint32_t>(count)},
                            surface.box(std::span(ordered).subspan(first, count), exaggerate, level.error_mm)});
  }
  std::vector<std::vector<IndexRange>> parts;
  for (const DiscretePiece& piece : level.pieces) parts.push_back({piece.range});
  encodeParts(*level.mesh, std::move(parts), 0);
  return level;
}

DiscreteLevels makeDiscreteLevels(const StrategyScene& scene, double exaggerate) {
  DiscreteLevels out;
  const FineSurface surface(scene, exaggerate, kMostVertices);
  std::vector<uint32_t> triangles = surface.triangles(6);
  SurfaceSimplifier simplifier(surface, triangles, {});
  while (true) {
    out.levels.push_back(discreteLevel(surface, triangles, exaggerate));
    DiscreteLevel& level = out.levels.back();
    if (out.levels.size() > 1) level.error_mm = std::max(level.error_mm, (&level - 1)->error_mm);
    const size_t count = triangles.size() / 3;
    if (count <= kLeastTriangles) break;
    simplifier.reduce(count / 2);
    triangles = simplifier.triangles();
    if (triangles.size() / 3 > count * 9 / 10) break;  // what is left is corners and sides
  }
  return out;
}

class Discrete final : public LodStrategy {
 public:
  explicit Discrete(const StrategyScene& scene) : scene_(scene) {}

  StrategyResult select(const LodView& view) override {
    prepare(view.exaggerate);
    const ViewBounds screen(view);
    const auto& levels = levels_->levels;
    StrategyResult out;
    out.rule = GridRule::kTrianglesOnly;
    for (size_t l = levels.size(); l-- > 0;) {
      out.predicted_px = 0;
      out.ranges.clear();
      for (const DiscretePiece& piece : levels[l].pieces) {
        if (screen.culled(piece.box)) continue;
        out.predicted_px = std::max(out.predicted_px, levels[l].error_mm * screen.pxPerMm(piece.box));
        if (out.predicted_px > view.error_px && l > 0) break;
        if (!out.ranges.empty() && out.ranges.back().first + out.ranges.back().count == piece.range.first)
          out.ranges.back().count += piece.range.count;
        else out.ranges.push_back(piece.range);
      }
      if (out.predicted_px > view.error_px && l > 0) continue;
      out.mesh = levels[l].mesh;
      out.instances = out.mesh->instances;
      break;
    }
    out.error_px = std::max(view.error_px, out.predicted_px);
    return out;
  }

 private:
  void prepare(double exaggerate) {
    if (levels_ && exaggerate == exaggerate_) return;
    exaggerate_ = exaggerate;
    levels_ = scene_.preparedOnce<DiscreteLevels>("discrete levels", exaggerate,
                                                  [&] { return makeDiscreteLevels(scene_, exaggerate); });
  }

  StrategyScene scene_;
  std::shared_ptr<const DiscreteLevels> levels_;
  double exaggerate_ = 0;
};

}  // namespace

StrategyEntry discreteStrategy() {
  StrategyEntry e;
  e.name = "discrete";
  e.title = "Discrete LOD";
  e.purpose =
      "the whole artwork as meshes, each of half the triangles of the one before, simplified by least measured error; "
      "the "
      "coarsest that keeps the budget where it is nearest, culled in pieces";
  e.keeps_budget = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Discrete>(scene); };
  return e;
}

}  // namespace relievo
