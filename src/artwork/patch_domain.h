// patch_domain.h - the square patches that an artwork consists of, each the root of a quadtree.
//
// A patch is a square of kPagePx << texture_depth texels. Over a base mesh each quadrilateral is one, and every node of
// its quadtree exists. A flat artwork of W x H texels is a strip of patches, which FlatDomain describes; nodes beyond
// its border do not exist. PatchDomain is either of the two: what depends on the size of a flat artwork is asked of
// PatchDomain::flat() alone.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/node_id.h"

namespace relievo {

inline constexpr int kPagePx = 128;      // payload texels (and relief cells) a page side
inline constexpr int kPageBorderPx = 4;  // on every side: bilinear needs 1, anisotropy 4 needs 4
inline constexpr int kPageFullPx = kPagePx + 2 * kPageBorderPx;  // 136
inline constexpr int kReliefSamples = kPagePx + 1;               // 129 a side
inline constexpr int kPageCellsLog2 = 7;                         // of a relief page's cells a side
static_assert(1 << kPageCellsLog2 == kPagePx);

// What is said of both kinds: how deep the quadtrees of all patches are, and what their texels and samples measure.
// Levels: one texel of level l is 2^(texture_depth - l) texels of the finest level wide; a relief page has (kPagePx +
// 1)^2 samples over its node's square, both ends included.
struct PatchMeasures {
  double mm_per_px = 1.0;  // of the finest texels; over a base mesh their mean along the patches' sides
  int texture_depth = 0;   // finest texture level
  int relief_depth = -1;   // finest relief level (may exceed texture_depth); -1: no relief
  // Relief height in mm = relief_offset_mm + q * relief_scale_mm, q the 16-bit sample: one range for the artwork.
  double relief_offset_mm = 0.0;
  double relief_scale_mm = 0.0;

  uint64_t patchPx() const { return uint64_t{kPagePx} << texture_depth; }
  // Nodes of a level that meet [0, extent) texels: ceil(extent * 2^level / patchPx).
  uint64_t nodesAlong(uint64_t extent_px, int level) const {
    return ((extent_px << level) + patchPx() - 1) / patchPx();
  }
  friend bool operator==(const PatchMeasures&, const PatchMeasures&) = default;
};

struct FlatExtent {
  uint64_t width_px = 1;
  uint64_t height_px = 1;
  friend bool operator==(const FlatExtent&, const FlatExtent&) = default;
};
struct NodeGrid {
  uint64_t columns = 0, rows = 0;
};

// How a flat artwork of W x H texels lies on a strip of square patches.
//
// A patch is the smallest one that covers the artwork's shorter side; the strip lies along its longer side and starts
// at its top left corner. Texels are never resampled: the part of a patch beyond the artwork's right and bottom border
// has no pages, and geometry is clamped to the border.
//
// Coordinates: x to the right, y down, origin at the artwork's top left corner; continuous texels: texel (i, j) covers
// [i, i+1) x [j, j+1), its centre is (i + 0.5, j + 0.5).
struct FlatDomain : PatchMeasures, FlatExtent {
  uint32_t patchColumns() const { return static_cast<uint32_t>((width_px + patchPx() - 1) / patchPx()); }
  uint32_t patchRows() const { return static_cast<uint32_t>((height_px + patchPx() - 1) / patchPx()); }
  uint32_t patchCount() const { return patchColumns() * patchRows(); }
  // One of patchColumns, patchRows is 1, so a patch's index is its place along the strip.
  bool alongX() const { return patchColumns() >= patchRows(); }
  uint64_t patchOriginX(uint32_t patch) const { return alongX() ? patch * patchPx() : 0; }
  uint64_t patchOriginY(uint32_t patch) const { return alongX() ? 0 : patch * patchPx(); }
  uint64_t levelWidth(int level) const { return ceilShift(width_px, texture_depth - level); }
  uint64_t levelHeight(int level) const { return ceilShift(height_px, texture_depth - level); }
  // All nodes of a level, over the whole strip.
  NodeGrid nodeGrid(int level) const { return {nodesAlong(width_px, level), nodesAlong(height_px, level)}; }
  // The node at a column and row of that grid.
  NodeId nodeAt(int level, uint64_t column, uint64_t row) const {
    const uint64_t mask = (uint64_t{1} << level) - 1, along = alongX() ? column : row;
    return {static_cast<uint32_t>(along >> level), static_cast<uint32_t>(level), static_cast<uint32_t>(column & mask),
            static_cast<uint32_t>(row & mask)};
  }

  // Does the node's (open) square meet the artwork? Only such nodes have pages and are drawn.
  bool nodeExists(const NodeId& n) const {
    if (n.patch >= patchCount() || n.level > kMaxNodeLevel) return false;
    if ((n.x >> n.level) != 0 || (n.y >> n.level) != 0) return false;
    // Compared in units of 2^-level patches, so that nodes deeper than a texel work too.
    auto inside = [&](uint64_t origin, uint32_t i, uint64_t extent) {
      return ((extent - origin) << n.level) > uint64_t{i} * patchPx();
    };
    return patchOriginX(n.patch) < width_px && patchOriginY(n.patch) < height_px &&
           inside(patchOriginX(n.patch), n.x, width_px) && inside(patchOriginY(n.patch), n.y, height_px);
  }

  static uint64_t ceilShift(uint64_t v, int shift) { return (v + (uint64_t{1} << shift) - 1) >> shift; }
  // The depth for which one patch covers the shorter side.
  static int depthFor(uint64_t width_px, uint64_t height_px) {
    uint64_t shorter = std::min(width_px, height_px);
    int depth = 0;
    while ((uint64_t{kPagePx} << depth) < shorter) ++depth;
    return depth;
  }
};

// Of each patch over a base mesh its finest texture level, at most texture_depth. A patch without any page has
// kNoTexturePage: its tail (texturing/package/patch_tails.h) shows all that there is.
using TextureDepths = std::vector<int8_t>;
inline constexpr int8_t kNoTexturePage = -1;
// Texels along a side of a patch at a level of its texture; at kNoTexturePage those of its tail.
constexpr size_t texelsASide(int level) {
  return level == kNoTexturePage ? size_t{kTailTexels} : size_t{kPagePx} << level;
}

class PatchDomain : public PatchMeasures {
 public:
  PatchDomain() : PatchDomain(FlatDomain{}) {}
  // Implicit: a flat artwork's domain is one.
  PatchDomain(const FlatDomain& flat) : PatchMeasures(flat), extent_(flat) {}
  static PatchDomain overMesh(uint32_t patches, const PatchMeasures& measures = {}) {
    PatchDomain domain;
    static_cast<PatchMeasures&>(domain) = measures;
    domain.extent_.reset();
    domain.mesh_patches_ = patches;
    return domain;
  }

  bool isFlat() const { return extent_.has_value(); }
  // Of a flat artwork only; over a base mesh it throws std::bad_optional_access, for the caller is wrong.
  FlatDomain flat() const { return {static_cast<const PatchMeasures&>(*this), extent_.value()}; }

  uint32_t patchCount() const { return isFlat() ? flat().patchCount() : mesh_patches_; }
  // Only nodes that exist have pages and are drawn.
  bool nodeExists(const NodeId& n) const {
    if (isFlat()) return flat().nodeExists(n);
    return n.patch < mesh_patches_ && n.level <= kMaxNodeLevel && (n.x >> n.level) == 0 && (n.y >> n.level) == 0;
  }
  // Texture pages of a patch may end at a coarser level than texture_depth: where nothing finer exists, the coarser
  // level or the tail shows the same. Null: all patches have all levels.
  void setTextureDepths(std::shared_ptr<const TextureDepths> depths) {
    texture_depths_ = std::move(depths);
    untextured_patch_ = texture_depths_ && std::find(texture_depths_->begin(), texture_depths_->end(),
                                                     kNoTexturePage) != texture_depths_->end();
  }
  const std::shared_ptr<const TextureDepths>& textureDepths() const { return texture_depths_; }
  int textureDepthOf(uint32_t patch) const { return texture_depths_ ? (*texture_depths_)[patch] : texture_depth; }
  // The node itself, or its finest ancestor that has texture pages. Nothing: its patch has none.
  std::optional<NodeId> texturedNode(const NodeId& n) const {
    const int depth = textureDepthOf(n.patch);
    if (depth < 0) return std::nullopt;
    return n.ancestor(std::min(n.level, static_cast<uint32_t>(depth)));
  }
  bool hasTexturePage(const NodeId& n) const {
    return nodeExists(n) && static_cast<int>(n.level) <= textureDepthOf(n.patch);
  }
  // Is there a patch that only its tail shows?
  bool hasUntexturedPatch() const { return untextured_patch_; }

  // Existing nodes of a level, in all patches.
  uint64_t nodeCount(int level) const {
    if (!isFlat()) return uint64_t{mesh_patches_} << (2 * level);
    const NodeGrid grid = flat().nodeGrid(level);
    return grid.columns * grid.rows;
  }
  // Those that have texture pages.
  uint64_t texturedNodeCount(int level) const {
    if (!texture_depths_) return level <= texture_depth ? nodeCount(level) : 0;
    const auto patches = std::count_if(texture_depths_->begin(), texture_depths_->end(),
                                       [level](int8_t depth) { return depth >= level; });
    return static_cast<uint64_t>(patches) << (2 * level);
  }
  // Nodes of level 0 .. texture_depth that have none.
  uint64_t untexturedNodeCount() const {
    uint64_t nodes = 0;
    for (int level = 0; level <= texture_depth; ++level) nodes += nodeCount(level) - texturedNodeCount(level);
    return nodes;
  }
  // Texels of the finest level, those of all patches.
  double texelCount() const {
    if (!isFlat()) return static_cast<double>(mesh_patches_) * static_cast<double>(patchPx() * patchPx());
    return static_cast<double>(extent_->width_px) * static_cast<double>(extent_->height_px);
  }
  friend bool operator==(const PatchDomain& a, const PatchDomain& b) {
    const bool same_depths = a.texture_depths_ == b.texture_depths_ ||
                             (a.texture_depths_ && b.texture_depths_ && *a.texture_depths_ == *b.texture_depths_);
    return same_depths && static_cast<const PatchMeasures&>(a) == static_cast<const PatchMeasures&>(b) &&
           a.extent_ == b.extent_ && a.mesh_patches_ == b.mesh_patches_;
  }

 private:
  std::optional<FlatExtent> extent_;
  uint32_t mesh_patches_ = 0;  // over a base mesh
  std::shared_ptr<const TextureDepths> texture_depths_;
  bool untextured_patch_ = false;  // of texture_depths_
};

}  // namespace relievo
