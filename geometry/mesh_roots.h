// mesh_roots.h - what most patches of a large base mesh need, all at once: are they in view, and how fine a grid do they want? By bounding
// spheres in flat arrays of floats, without a branch, so that compilers turn it into SIMD. What spheres cannot tell well enough is
// marked careful and left to the caller. Internal to mesh_lod.cpp.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/mesh_forest.h"

namespace relievo {

struct RootView {
  double error_px = 1, min_cell_px = 0, max_node_px = 1024;
};

class MeshRoots {
 public:
  // A patch's code: the level wanted, 0 .. kLevels - 1, and some of these.
  static constexpr int kCulled = 0x80;   // out of view, and no level wanted
  static constexpr int kCareful = 0x40;  // near the eye, or wants more than a root's grid gives
  static constexpr int kOthers = 0x20;   // drawn by others, see leaveOut()
  static constexpr int kLevel = 0x07;
  static constexpr int kLevels = 5;          // 0 .. 4: kMaxSplitLevel

  // Takes what depends on the exaggeration from the forest, if that changed.
  void prepare(MeshForest& forest, double exaggerate);
  // Fills codes() and pxPerMm(). The camera must be valid.
  void evaluate(const LodCamera& camera, const RootView& view);

  const std::vector<int32_t>& codes() const { return codes_; }
  const std::vector<float>& pxPerMm() const { return px_per_mm_; }  // 0: culled
  float diameter(uint32_t patch) const { return 2 * radius_[patch]; }
  std::array<uint32_t, 4> neighbours(uint32_t p) const { return {across_[0][p], across_[1][p], across_[2][p], across_[3][p]}; }  // itself at a border

  // The rest as it is drawn: edges with the larger of both sides' levels, grids with the largest of four.
  void leaveOut(uint32_t patch) { codes_[patch] |= kOthers; }
  void levelEdges();
  double maxErrorPx() const { return max_error_px_; }
  // Of grid level n, after levelEdges(), growing.
  std::span<const uint32_t> drawn(int n) const { return std::span(order_).subspan(first_[static_cast<size_t>(n)], first_[static_cast<size_t>(n) + 1] - first_[static_cast<size_t>(n)]); }
  // By Side, a byte each, the first lowest.
  uint32_t segments(uint32_t patch) const { return segments_[patch]; }

 private:
  template <bool kOrthographic>
  void evaluateAll(const LodCamera& camera, const RootView& view);

  bool prepared_ = false;
  double exaggerate_ = 0;
  size_t count_ = 0;
  double extent_ = 0;  // the largest coordinate of a sphere
  std::vector<float> x_, y_, z_, radius_, longest_;  // spheres; the longest side
  std::array<std::vector<float>, kLevels> errors_;   // of grids of 2^k cells a side
  std::array<std::vector<uint32_t>, 4> across_;      // by side
  std::vector<float> px_per_mm_;
  std::vector<int32_t> codes_;
  std::vector<uint32_t> segments_, grid_, order_;
  std::array<size_t, kMaxGridLevel + 3> first_{};    // in order_, by grid level; the last are those not drawn
  double max_error_px_ = 0;
};

}  // namespace relievo
