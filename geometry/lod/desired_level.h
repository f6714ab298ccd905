// desired_level.h - how fine a square wants to be drawn, as a continuous level: 1 / 256 of a level is a step nobody
// sees, and an integer is the same everywhere. Level n with weight w (geometry/lod/morph.h) is (n - 1) + w. Internal to
// geometry/.
//
// Where errors of two levels are E > budget >= e, the drawn surface is (1 - w) times the coarser one plus w times the
// finer one, and so is the bound of its error: w = (E - budget) / (E - e) keeps it at the budget.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "geometry/lod/lod_common.h"
#include "src/base/key_index.h"

namespace relievo {

inline constexpr int kOneLevel = 256;
inline int wholeLevels(int desired) { return (desired + kOneLevel - 1) / kOneLevel; }  // the grid that draws it
// PatchInstance::morph of it.
inline uint8_t morphOf(int desired) {
  return static_cast<uint8_t>(desired - (wholeLevels(desired) - 1) * kOneLevel - 1);
}

// PatchInstance::edge_morph: how far a segment's vertices have slid (morph.h), rounded up, so that the segment is no
// further from the finer one.
inline uint8_t slideOf(int desired) {
  const int weight = morphOf(desired) + 1, whole = kOneLevel + weight;
  return static_cast<uint8_t>((2 * kOneLevel * weight + whole - 1) / whole - 1);
}

// Of the surface on the way from a level's to the next finer one's.
template <class Coarser>
Deviation betweenLevels(int desired, Coarser&& coarser, const Deviation& finer) {
  const double weight = (morphOf(desired) + 1) / double{kOneLevel};
  return weight < 1 ? (1 - weight) * coarser() + weight * finer : finer;
}
// Of an edge's finer level, while its vertices slide: triangles then reach over two of its cells, in one of the coarser
// level. Where the inside is of that level, too, its own vertices do not deviate from it.
inline Deviation slidAlong(int edge, int inside, const Deviation& finer) {
  if (edge % kOneLevel == 0) return finer;
  return wholeLevels(edge) < wholeLevels(inside) ? finer.overCells() : finer.fromNone();
}

// Of what is drawn at a desired level, inside a node and along an edge of one that is drawn `inside`: of(level) is that
// of the surface through the vertices of a whole level.
template <class OfLevel>
Deviation deviationInside(int desired, OfLevel&& of) {
  const int level = wholeLevels(desired);
  return betweenLevels(
      desired, [&] { return of(level - 1); }, of(level));
}
template <class OfLevel>
Deviation deviationOnEdge(int desired, int inside, OfLevel&& of) {
  const int level = wholeLevels(desired);
  return betweenLevels(
      desired, [&] { return of(level - 1); }, slidAlong(desired, inside, of(level)));
}

// Steps and cracks keep their error over many levels. So that these come one after the other, a level counts for at
// least so many times the next finer one's error: 6 per cent of a zoom each. Less would make them come faster, more
// refines what needs no refinement.
inline constexpr double kPlateau = 1.0625;
// Over what part of a doubling of cells, where their width is what holds a level back, vertices reach their places.
inline constexpr double kCellRamp = 0.75;

struct DesiredLevelView {
  double budget_px = 1, min_cell_px = 0;
  double hysteresis = 0;  // of the budget
  bool morph = false;
};
struct LevelRange {
  int low = 0, high = 0;  // what the budget asks for; what it would with the hysteresis taken off it
};

// A square of a level, as one cell so many px wide, of the widest that may be drawn as one node. error_px(level) falls
// or stays, finest >= level.
template <class ErrorPx>
LevelRange desiredLevel(int level, int finest, double cell_px, double of_widest, const DesiredLevelView& view,
                        ErrorPx&& error_px) {
  std::array<double, 2 * kPageLog2 + 2> px;
  const size_t last = std::min<size_t>(static_cast<size_t>(finest - level), px.size() - 1);
  size_t count = 0;
  if (!view.morph) {
    auto coarsest = [&](double budget) {
      double cells = cell_px;
      for (size_t k = 0;; ++k, cells *= 0.5) {
        if (k == last) return level + static_cast<int>(k);
        if (k == count) px[count++] = error_px(level + static_cast<int>(k));
        if (px[k] <= budget || !(cells > 2 * leastCellPx(view.min_cell_px, px[k] / budget)))
          return level + static_cast<int>(k);
      }
    };
    LevelRange range;
    range.low = range.high = coarsest(view.budget_px) * kOneLevel;
    if (view.hysteresis > 0) range.high = coarsest(view.budget_px / (1 + view.hysteresis)) * kOneLevel;
    return range;
  }
  const double least_budget = view.budget_px / (1 + view.hysteresis);
  // As leastCellPx(), without its steps.
  auto leastCell = [&](double error_over_budget) {
    return view.min_cell_px * std::clamp(1.5 / std::sqrt(error_over_budget), 0.25, 1.0);
  };
  // Of the next finer level, as far as its cells go: 0 where they are too narrow.
  auto byCells = [&](size_t k, double budget) {
    if (!(view.min_cell_px > 0)) return 1.0;
    const double narrowest = 2 * leastCell(std::max(1.0, px[k] / budget));
    return std::clamp((std::ldexp(cell_px, -static_cast<int>(k)) / narrowest - 1) / kCellRamp, 0.0, 1.0);
  };
  const double beyond = std::pow(kPlateau, static_cast<double>(last));
  while (count <= last) {
    px[count] = error_px(level + static_cast<int>(count));
    ++count;
    if (px[count - 1] * beyond <= least_budget || byCells(count - 1, least_budget) == 0) break;
  }
  for (size_t k = count - 1; k-- > 0;) px[k] = std::max(px[k], kPlateau * px[k + 1]);
  auto desired = [&](double budget) {
    int at = level * kOneLevel;
    for (size_t k = 0; k + 1 < count && px[k] > budget; ++k) {
      const double by_error = px[k + 1] >= budget    ? 1.0
                              : std::isfinite(px[k]) ? (px[k] - budget) / (px[k] - px[k + 1])
                                                     : 1.0;
      const double step = std::min(by_error, byCells(k, budget));
      at += static_cast<int>(std::ceil(step * kOneLevel));
      if (step < 1) break;
    }
    // Wide squares are split whatever their error; the next level's vertices are in place by then.
    const double wide = std::clamp(2 * of_widest - 1, 0.0, 1.0);
    return std::max(at, level * kOneLevel + static_cast<int>(std::ceil(wide * kOneLevel)));
  };
  return {desired(view.budget_px), view.hysteresis > 0 ? desired(least_budget) : desired(view.budget_px)};
}

// ---- a square's children
// Before it splits they are drawn as it is, at its own level; once it has, they sink to what they want themselves.
// progress: of the split, 0 .. kOneLevel.
inline int splitProgress(int level, int drawn, double of_widest) {
  const int by_error = drawn - (level + kMaxSplitLevel) * kOneLevel;
  const double by_width = (of_widest - 1) * kOneLevel;
  return std::clamp(std::max(by_error, by_width > kOneLevel ? kOneLevel
                                       : by_width > 0       ? static_cast<int>(by_width)
                                                            : 0),
                    0, kOneLevel);
}
inline int childFloor(int level, int of_parent, int progress) {
  const int from = std::min(of_parent, (level + kMaxSplitLevel) * kOneLevel);
  return std::max((level + 1) * kOneLevel, from - (kMaxSplitLevel - 1) * progress);
}
// A square's edges are at most so much coarser than its inside: when it splits, their middles are in place.
inline constexpr int kMostBeyondNeighbour = (kMaxSplitLevel - 1) * kOneLevel;

// ---- from view to view
// Hysteresis: a square keeps its level while it lies within the range that it may have. Without any, what was is
// forgotten.
class DesiredLevelMemory {
 public:
  void nextView(double hysteresis) {
    remembers_ = hysteresis > 0;
    std::swap(before_, now_);
    if (!remembers_) before_.clear();
    now_.clear();
  }
  // The same view once more.
  void again() { now_.clear(); }
  int held(uint64_t square, const LevelRange& range) {
    if (!remembers_) return range.low;
    const uint32_t found = before_.index.find(square);
    const int desired = found == KeyIndex::kNone ? range.low : std::clamp(before_.levels[found], range.low, range.high);
    if (now_.index.findOrAdd(square) == now_.levels.size()) now_.levels.push_back(desired);
    return desired;
  }

 private:
  struct Table {
    KeyIndex index;
    std::vector<int> levels;
    void clear() {
      index.clear();
      levels.clear();
    }
  };
  Table before_, now_;
  bool remembers_ = false;
};

}  // namespace relievo
