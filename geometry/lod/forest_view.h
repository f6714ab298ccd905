// forest_view.h - what a forest (quadtree_lod.h) keeps of its squares within one view, and with geomorph the continuous
// levels. Internal to geometry/.
//
// With geomorph levels are continuous functions of the view and of places alone, so that it does not matter which of
// the squares are nodes. What has a level of its own is its holder: an edge of a flat artwork, a square of a base mesh.
// A holder's level is the largest of
//   what it wants itself (desired_level.h),
//   what is left of its parent's level while that one's children sink to what they want,
//   a level so far below those of the holders around it that, when a square splits, its sides' middles are in place.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "geometry/lod/desired_level.h"
#include "geometry/lod/lod_common.h"
#include "geometry/lod/square.h"
#include "src/base/key_index.h"

namespace relievo {

inline constexpr int kUnknownLevel = -1;

// Levels are desired levels: kOneLevel a level (desired_level.h).
struct LevelHolder {
  int wanted = 0;
  int floored = kUnknownLevel, level = kUnknownLevel;  // of flooredLevel(), heldLevel()
};

struct SquareInView {
  bool culled = false;        // nothing of it is in the picture
  double width_px = 0;        // at most, as a single cell
  int inner = kUnknownLevel;  // of innerLevel()
  std::array<int, 4> children{kUnknownLevel, kUnknownLevel, kUnknownLevel, kUnknownLevel};  // of childLevels()
};

// Forest derives from ForestView<Forest, Info>, Info from SquareInView. It has, beside what LodForest asks for:
//   Info look(s)                         what the view makes of a square; asks for no other square's
//   LevelHolder& holder(i)               by the forest's own index
//   int floorFromParent(i)               childFloor() of the holder's parent, or of the square that it crosses
//   void forHoldersAround(i, f)          f(index), the holder's own among them or not
//   int mostOfChildren(s)                no child is worth a finer level
//   double cellPx(info)                  the square as one cell, seen head on
//   double childErrorPx(info, s, level)  of a child s, seen as its parent is
template <class Forest, class Info>
class ForestView {
 public:
  void beginView(const LodSettings& settings) {
    settings_ = settings;
    memory_.nextView(settings.hysteresis);
  }
  // The same view with another error.
  void beginTry(double error_px, double max_node_px) {
    settings_.error_px = error_px;
    settings_.max_node_px = max_node_px;
    infos_.clear();
    info_index_.clear();
    memory_.again();
  }
  uint32_t infoOf(const Square& s) {
    const uint32_t index = info_index_.findOrAdd(self().key(s));
    if (index == infos_.size()) infos_.push_back(self().look(s));
    return index;
  }
  bool isCulled(uint32_t info) const { return infos_[info].culled; }
  // Larger than a node may be, whatever its error.
  bool isWide(uint32_t info) const { return infos_[info].width_px > settings_.max_node_px; }

  // Whole levels that a square's children will want at most, nearly: by their own errors, seen as the square is, which
  // costs a fraction of a look at each.
  std::array<int, 4> childLevels(const Square& s) {
    const uint32_t at = infoOf(s);
    if (infos_[at].children[0] != kUnknownLevel) return infos_[at].children;
    std::array<int, 4> levels;
    levels.fill(wholeLevels(self().mostOfChildren(s)));
    const Info info = infos_[at];
    const double cell_px = self().cellPx(info);
    for (uint32_t k = 0; k < 4 && cell_px > 0; ++k) {  // else one of the roots' tables (mesh_roots.h)
      auto suffices = [&](int level) {
        const double px = self().childErrorPx(info, s.child(k), level);
        return px <= settings_.error_px || !(std::ldexp(cell_px, s.level - level) >
                                             2 * leastCellPx(settings_.min_cell_px, px / settings_.error_px));
      };
      while (levels[k] > s.level + 1 && suffices(levels[k] - 1)) --levels[k];
    }
    return infos_[at].children = levels;
  }

 protected:
  // A holder's own desired level, and what is left of its parent's.
  int flooredLevel(uint32_t holder) {
    if (const int known = self().holder(holder).floored; known != kUnknownLevel) return known;
    const int floor = self().floorFromParent(holder);
    LevelHolder& h = self().holder(holder);
    return h.floored = std::max(h.wanted, floor);
  }
  int heldLevel(uint32_t holder) {
    if (const int known = self().holder(holder).level; known != kUnknownLevel) return known;
    int level = flooredLevel(holder);
    self().forHoldersAround(
        holder, [&](uint32_t other) { level = std::max(level, flooredLevel(other) - kMostBeyondNeighbour); });
    return self().holder(holder).level = level;
  }
  // What a square's inside is drawn with if all its sides are whole.
  int innerLevel(const Square& s) {
    const uint32_t at = infoOf(s);
    if (infos_[at].inner != kUnknownLevel) return infos_[at].inner;
    int level = 0;
    for (int side = 0; side < 4; ++side) level = std::max(level, self().sideLevel(s, side));
    return infos_[at].inner = level;
  }
  int progressOf(const Square& s) {
    const int inner = innerLevel(s);
    return splitProgress(s.level, inner, infos_[infoOf(s)].width_px / settings_.max_node_px);
  }

  LodSettings settings_;
  DesiredLevelMemory memory_;
  std::vector<Info> infos_;

 private:
  Forest& self() { return static_cast<Forest&>(*this); }

  KeyIndex info_index_;
};

}  // namespace relievo
