// mesh_roots.h - what most patches of a large base mesh need, all at once: are they in view, and how fine a grid do
// they want? By bounding spheres in flat arrays of floats, without a branch, so that compilers turn it into SIMD. What
// spheres cannot tell well enough is marked careful and left to the caller. Internal to mesh_lod.cpp.
//
// Blocks of kBlock patches, successive in the base mesh, which are neighbours mostly, have a sphere and a cone of
// normals too: what is out of view or turned away costs a look at its block. Of a patch that faces away from the eye,
// on a closed body seen from outside (facing_cone.h), the level is still known wherever a patch that is drawn may ask
// for it: leaving it out changes no other patch.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/lod/mesh_forest.h"

namespace relievo {

struct RootView {
  double error_px = 1, min_cell_px = 0, max_node_px = 1024;
  bool hide_backs = true;
  // Levels are continuous, or remembered: what is not for certain a single cell, with room to spare for its width, is
  // careful.
  bool still = false;
};

class MeshRoots {
 public:
  // A patch's code: the level wanted, 0 .. kLevels - 1, and some of these.
  static constexpr int kCulled = 0x80;  // out of view, and no level wanted
  static constexpr int kCareful =
      0x40;                             // near the eye, or wants more than a root's grid gives; RootView::still: or may
  static constexpr int kOthers = 0x20;  // drawn by others, see leaveOut()
  static constexpr int kHidden = 0x10;  // faces away: not drawn, whatever else is said
  static constexpr int kNotShown = kCulled | kCareful | kOthers | kHidden;
  static constexpr int kLevel = 0x07;
  static constexpr int kLevels = 4;  // 0 .. 3: finer grids are worth a close look (mesh_lod.cpp, savesBySplit)
  static constexpr uint32_t kBlock = 16;

  // Takes what depends on the exaggeration from the forest, if that changed.
  void prepare(MeshForest& forest, double exaggerate);
  // Fills codes() and pxPerMm(). The camera must be valid.
  void evaluate(const LodCamera& camera, const RootView& view);

  std::span<const uint8_t> codes() const { return std::span(codes_).first(count_); }
  bool anyCareful() const { return any_careful_; }
  // The eye is outside a closed body, all of which is beyond the near plane: backs are behind fronts everywhere.
  bool backsAreHidden() const { return backs_are_hidden_; }
  float pxPerMm(uint32_t patch) const { return px_per_mm_[patch]; }  // undefined where culled
  float diameter(uint32_t patch) const { return 2 * of_patches_.radius[patch]; }
  const std::array<uint32_t, 4>& neighbours(uint32_t patch) const { return across_[patch]; }  // itself at a border

  // The rest as it is drawn: edges with the larger of both sides' levels, grids with the largest of four.
  void leaveOut(uint32_t patch) { codes_[patch] |= kOthers; }
  void levelEdges() noexcept;
  double maxErrorPx() const { return max_error_px_; }
  struct Drawn {
    uint32_t patch = 0;
    uint32_t segments = 0;  // by Side, a byte each, the first lowest
  };
  // Of grid level n, after levelEdges(), patches growing.
  std::span<const Drawn> drawn(int n) const {
    return std::span(lists_[static_cast<size_t>(n)]).first(drawn_[static_cast<size_t>(n)]);
  }

 private:
  void clear(size_t patches);  // empty tables of that many
  void listAdjacentBlocks();   // from across_
  struct Eye;
  enum BlockState : uint8_t {
    kSkipped = 0,
    kEvaluated = 1,
    kCutsFrustum = 2,
    kMayFaceAway = 4,
    kFacesAway = 8,
    kMayBeCareful = 16
  };
  // What a camera makes of blocks: which of them there is anything to do for.
  template <bool kOrthographic>
  void evaluateBlocks(const Eye& eye) noexcept;
  template <bool kOrthographic, bool kCuts, bool kFacing>
  int evaluatePatches(const Eye& eye, size_t block) noexcept;
  template <bool kOrthographic>
  void evaluateAll(const LodCamera& camera, const RootView& view);
  bool allBeyondNear(const glm::dvec4& near_row) const;

  bool prepared_ = false, any_careful_ = false, closed_ = false, backs_are_hidden_ = false, leaves_out_ = false;
  double exaggerate_ = 0;
  size_t count_ = 0, padded_ = 0, blocks_ = 0;  // padded: whole blocks; what is added is always culled
  double extent_ = 0;                           // the largest coordinate of a sphere
  std::array<glm::dvec3, 2> box_;               // around everything
  // Spheres, of patches and then of blocks; the longest side; errors of grids of 2^k cells a side. Of blocks: the
  // largest inside.
  struct Spheres {
    std::vector<float> x, y, z, radius, longest;
    std::vector<uint32_t> cone;
  };
  Spheres of_patches_, of_blocks_;
  std::array<std::vector<float>, kLevels> errors_,
      between_;  // between: where vertices snapped to that level, see mesh_lod.cpp
  std::vector<float> still_errors_, block_patch_radius_, block_error_,
      block_still_error_;                        // still: of single cells, as geomorph counts them (desired_level.h)
  std::vector<std::array<uint32_t, 4>> across_;  // by side
  std::vector<uint32_t> first_adjacent_, adjacent_;  // blocks that meet a block
  std::vector<float> px_per_mm_;
  std::vector<uint8_t> codes_, block_state_;
  std::vector<std::array<uint8_t, 2>> block_levels_;  // the lowest and the highest wanted in each
  std::vector<uint32_t> active_;                      // blocks with something to draw, or that others ask for
  std::array<std::vector<Drawn>, kMaxGridLevel + 1> lists_;
  std::array<size_t, kMaxGridLevel + 1> drawn_{};
  double max_error_px_ = 0;
};

}  // namespace relievo
