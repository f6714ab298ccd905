// mesh_roots.h - what most patches of a large base mesh need, all at once: are they in view, and how fine a grid do they want? By bounding
// spheres in flat arrays of floats, without a branch, so that compilers turn it into SIMD. What spheres cannot tell well enough is
// marked careful and left to the caller. Internal to mesh_lod.cpp.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "geometry/mesh_forest.h"

namespace relievo {

struct RootView {
  double error_px = 1, min_cell_px = 0, max_node_px = 1024;
};

class MeshRoots {
 public:
  // A patch's code: the level wanted, 0 .. kLevels - 1, or one of these.
  static constexpr uint8_t kCulled = 0x80;   // out of view, and no level wanted
  static constexpr uint8_t kCareful = 0x40;  // near the eye, or wants more than a root's grid gives
  static constexpr uint8_t kLevel = 0x07;
  static constexpr int kLevels = 5;          // 0 .. 4: kMaxSplitLevel

  // Takes what depends on the exaggeration from the forest, if that changed.
  void prepare(MeshForest& forest, double exaggerate);
  // Fills codes() and pxPerMm(). The camera must be valid.
  void evaluate(const LodCamera& camera, const RootView& view);

  const std::vector<uint8_t>& codes() const { return codes_; }
  const std::vector<float>& pxPerMm() const { return px_per_mm_; }         // 0: culled
  float error(int level, uint32_t patch) const { return errors_[static_cast<size_t>(level)][patch]; }
  float diameter(uint32_t patch) const { return 2 * radius_[patch]; }
  const std::array<uint32_t, 4>& neighbours(uint32_t patch) const { return neighbours_[patch]; }  // itself at a border

 private:
  template <bool kOrthographic>
  void evaluateAll(const LodCamera& camera, const RootView& view);

  bool prepared_ = false;
  double exaggerate_ = 0;
  size_t count_ = 0;
  double extent_ = 0;  // the largest coordinate of a sphere
  std::vector<float> x_, y_, z_, radius_, longest_;  // spheres; the longest side
  std::array<std::vector<float>, kLevels> errors_;   // of grids of 2^k cells a side
  std::vector<std::array<uint32_t, 4>> neighbours_;
  std::vector<float> px_per_mm_;
  std::vector<uint8_t> codes_;
};

}  // namespace relievo
