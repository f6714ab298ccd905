// How a build runs.
//
// The artwork's levels are images over the whole strip (patch origins are multiples of the patch size, so level l of a
// patch is a window of level l of the strip). A *stage* takes one level L, cut into tiles of 8 x 8 pages, and makes
// from each tile, with 16 texels around it, the pages of the levels L, L-1 and L-2 (16 = 4 levels' worth: a border of 4
// at L-2) and the texels of level L-3, which it spills for the next stage. So the finest texels are read once (6 %
// twice), every level is the mean of the whole level before, and memory depends on the tile alone. Beyond the artwork's
// border the edge texel of each level is repeated, at that level: tiles know nothing that the whole image would not.
//
// Relief is cut the same way on the grid of vertices: 1024 x 1024 cells a tile, shared samples computed from the same
// inputs by both tiles. Where texture and relief have the same depth, one tile does both and their pages lie together.
//
// Tiles are independent: workers take them in the file's order and the caller's thread writes what they made in that
// order, so the bytes do not depend on the workers. At most kPartsAhead finished tiles a worker wait to be written.
#include "texturing/package/package_builder.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "src/base/simd_dispatch.h"
#include "texturing/codec/mip.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/build_reporter.h"
#include "texturing/package/checkpointed_writer.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_writer.h"

namespace relievo {
namespace {

constexpr int kTilePages = 8;
constexpr int kTilePx = kTilePages * kPagePx;                   // 1024
constexpr int kStageLevels = 3;                                 // levels L, L-1, L-2 get their pages in one stage
constexpr int kMarginPx = kPageBorderPx << (kStageLevels - 1);  // 16
constexpr int kSpillPx = kTilePx >> kStageLevels;               // 128
constexpr double kSpacingSlack = 1.01;  // a height map wider than the texture by rounding stays at its depth

struct TextureStage {
  int level = -1;                         // L; -1: none
  const TextureSource* source = nullptr;  // the first stage reads this, the others `in`
  const SpillStore* in = nullptr;
  SpillStore* out = nullptr;  // level L-3, blocks of kSpillPx^2 texels, channel-major; null: nothing left to do
  uint64_t in_columns = 0, out_columns = 0;  // blocks a row
};
struct ReliefStage {
  int level = -1;
  const HeightSource* source = nullptr;
  const SpillStore* in = nullptr;  // blocks of 129^2 samples, one a node of level L
  SpillStore* out = nullptr;
  const std::vector<NodeRange>* in_ranges = nullptr;
  std::vector<NodeRange>* out_ranges = nullptr;
  uint64_t in_columns = 0, out_columns = 0;
};
struct Stage {
  TextureStage texture;
  ReliefStage relief;
  uint64_t tile_columns = 0, tile_rows = 0;
};

// Tiles in Z-order, in squares along the strip.
class TileOrder {
 public:
  TileOrder(uint64_t columns, uint64_t rows) : columns_(columns), rows_(rows) {
    while ((uint64_t{1} << side_log2_) < std::min(columns, rows)) ++side_log2_;
    uint64_t squares = (std::max(columns, rows) + (uint64_t{1} << side_log2_) - 1) >> side_log2_;
    end_ = squares << (2 * side_log2_);
  }
  bool next(uint64_t* x, uint64_t* y) {
    for (; code_ < end_; ++code_) {
      uint64_t in_square = code_ & ((uint64_t{1} << (2 * side_log2_)) - 1);
      uint64_t square = code_ >> (2 * side_log2_) << side_log2_;
      *x = even(in_square) + (columns_ >= rows_ ? square : 0);
      *y = even(in_square >> 1) + (columns_ >= rows_ ? 0 : square);
      if (*x < columns_ && *y < rows_) {
        ++code_;
        return true;
      }
    }
    return false;
  }

 private:
  static uint64_t even(uint64_t v) {  // the bits at even places, packed
    uint64_t out = 0;
    for (int b = 0; b < 32; ++b) out |= (v >> (2 * b) & 1) << b;
    return out;
  }
  uint64_t columns_, rows_, code_ = 0, end_ = 0;
  int side_log2_ = 0;
};

// The relief grid of one level: vertices at texel positions i * patch_px / (128 * 2^level), clamped to the artwork.
struct ReliefGrid {
  int64_t whole_x, whole_y;  // cells that lie wholly inside the artwork
  int64_t cells_x, cells_y;  // cells that meet it
  ReliefGrid(const FlatDomain& d, int level) {
    auto count = [&](uint64_t extent, bool up) {
      int shift = level - d.texture_depth;
      if (shift >= 0) return static_cast<int64_t>(extent << shift);
      return static_cast<int64_t>((extent + (up ? (uint64_t{1} << -shift) - 1 : 0)) >> -shift);
    };
    whole_x = count(d.width_px, false), cells_x = count(d.width_px, true);
    whole_y = count(d.height_px, false), cells_y = count(d.height_px, true);
  }
};

struct BuildContext {
  const TextureSource& texture;
  const HeightSource* relief;
  FlatDomain domain;
  TextureFormat format;
  PackageLayout layout;
  MipFilter mip;
  PlaneEncodings encodings;
};

// One worker's memory.
class TileWorker {
 public:
  TileWorker(const BuildContext& context, int zstd_level) : context_(context), encoder_(zstd_level) {}
  static uint64_t spillBlockBytes(int channels) { return uint64_t{2} * kSpillPx * kSpillPx * channels; }

  BuildPart run(const Stage& stage, uint64_t tile_x, uint64_t tile_y) {
    BuildPart out;
    stage_ = &stage;
    tile_x_ = tile_x, tile_y_ = tile_y;
    if (stage.texture.level >= 0) out.status = prepareTexture(out);
    if (out.status.ok() && stage.relief.level >= 0) out.status = prepareRelief(out);
    if (!out.status.ok()) return out;
    int level = std::max(stage.texture.level, stage.relief.level);
    int coarsest = std::min(kStageLevels - 1, level);
    int side = kTilePages >> coarsest;
    for (int code = 0; code < side * side; ++code) {
      int x = (code & 1) | (code >> 1 & 2) | (code >> 2 & 4), y = (code >> 1 & 1) | (code >> 2 & 2) | (code >> 3 & 4);
      emit(level, coarsest, x, y, out);
    }
    if (stage.texture.source) out.texels = static_cast<uint64_t>(valid_.width) * static_cast<uint64_t>(valid_.height);
    return out;
  }

 private:
  // ---- texture ----
  // Level images of the region: the tile's pages and kMarginPx around, halved from level to level.
  struct Region {
    int width = 0, height = 0;
  };
  Region regionAt(int down) const { return {region_.width >> down, region_.height >> down}; }

  Result<void> prepareTexture(BuildPart& out_part) {
    const TextureStage& s = stage_->texture;
    const FlatDomain& d = context_.domain;
    const int channels = context_.format.channels();
    const int64_t level_width = static_cast<int64_t>(d.levelWidth(s.level)),
                  level_height = static_cast<int64_t>(d.levelHeight(s.level));
    const int64_t x0 = static_cast<int64_t>(tile_x_) * kTilePx, y0 = static_cast<int64_t>(tile_y_) * kTilePx;
    // Whole pages at every level of the stage, and whole 2 x 2 squares down to the spill.
    const int64_t page = kPagePx << std::min(kStageLevels - 1, s.level);
    auto wholePages = [&](int64_t texels) {
      return static_cast<int>(std::min<int64_t>(kTilePx, (texels + page - 1) / page * page));
    };
    const int payload_width = wholePages(level_width - x0), payload_height = wholePages(level_height - y0);
    region_ = {payload_width + 2 * kMarginPx, payload_height + 2 * kMarginPx};
    valid_ = {x0, y0, std::min<int64_t>(payload_width, level_width - x0),
              std::min<int64_t>(payload_height, level_height - y0)};
    const size_t texels = static_cast<size_t>(region_.width) * region_.height;
    // The part of the region that lies on the artwork.
    Rect rect;
    rect.x = std::max<int64_t>(0, x0 - kMarginPx), rect.y = std::max<int64_t>(0, y0 - kMarginPx);
    rect.width = std::min(level_width, x0 - kMarginPx + region_.width) - rect.x;
    rect.height = std::min(level_height, y0 - kMarginPx + region_.height) - rect.y;
    const int rx = static_cast<int>(rect.x - (x0 - kMarginPx)), ry = static_cast<int>(rect.y - (y0 - kMarginPx));
    const int rw = static_cast<int>(rect.width), rh = static_cast<int>(rect.height);

    if (s.source) {
      bytes_.resize(texels * channels);
      if (rw == region_.width && rh == region_.height) {
        if (auto read = s.source->read(rect, bytes_); !read) return read;
      } else {
        size_t part = static_cast<size_t>(rw) * rh;
        part_.resize(part * channels);
        if (auto read = s.source->read(rect, part_); !read) return read;
        for (int c = 0; c < channels; ++c)
          for (int y = 0; y < rh; ++y)
            std::memcpy(bytes_.data() + c * texels + static_cast<size_t>(ry + y) * region_.width + rx,
                        part_.data() + c * part + static_cast<size_t>(y) * rw, rw);
        repeatBorder(bytes_.data(), region_.width, region_.height, channels, rx, ry, rx + rw, ry + rh);
      }
    } else {
      levels_[0].resize(texels * channels);
      if (auto read = readSpill(rect, rx, ry); !read) return read;
      repeatBorder(levels_[0].data(), region_.width, region_.height, channels, rx, ry, rx + rw, ry + rh);
    }
    for (int down = 1; down <= kStageLevels && s.level - down >= 0; ++down) {
      Region from = regionAt(down - 1), to = regionAt(down);
      auto& out = levels_[down];
      out.resize(static_cast<size_t>(to.width) * to.height * channels);
      if (down == 1 && s.source) {
        context_.mip.downsample(bytes_.data(), from.width, from.height, out.data());
      } else {
        context_.mip.downsample(levels_[down - 1].data(), from.width, from.height, out.data());
      }
      // What lies beyond this level's border is its own edge texel, not the mean of the finer level's repeats.
      int64_t left = (x0 - kMarginPx) >> down, top = (y0 - kMarginPx) >> down;
      int64_t lw = static_cast<int64_t>(d.levelWidth(s.level - down)),
              lh = static_cast<int64_t>(d.levelHeight(s.level - down));
      repeatBorder(out.data(), to.width, to.height, channels, static_cast<int>(std::max<int64_t>(0, -left)),
                   static_cast<int>(std::max<int64_t>(0, -top)),
                   static_cast<int>(std::min<int64_t>(to.width, lw - left)),
                   static_cast<int>(std::min<int64_t>(to.height, lh - top)));
    }
    if (s.out) spillInto(out_part.texture_spill);
    return {};
  }

  // Blocks that meet rect, into levels_[0] with rect's corner at (rx, ry).
  Result<void> readSpill(const Rect& rect, int rx, int ry) {
    const TextureStage& s = stage_->texture;
    const int channels = context_.format.channels();
    spill_.resize(static_cast<size_t>(kSpillPx) * kSpillPx * channels);
    for (int64_t by = rect.y / kSpillPx; by * kSpillPx < rect.y + rect.height; ++by) {
      for (int64_t bx = rect.x / kSpillPx; bx * kSpillPx < rect.x + rect.width; ++bx) {
        uint64_t offset =
            (static_cast<uint64_t>(by) * s.in_columns + static_cast<uint64_t>(bx)) * spillBlockBytes(channels);
        if (auto read = s.in->read(offset, spill_.data(), spill_.size() * 2); !read) return read;
        int64_t left = std::max(rect.x, bx * kSpillPx), right = std::min(rect.x + rect.width, (bx + 1) * kSpillPx);
        int64_t top = std::max(rect.y, by * kSpillPx), bottom = std::min(rect.y + rect.height, (by + 1) * kSpillPx);
        for (int c = 0; c < channels; ++c) {
          for (int64_t y = top; y < bottom; ++y) {
            const uint16_t* from =
                spill_.data() +
                (static_cast<size_t>(c) * kSpillPx + static_cast<size_t>(y - by * kSpillPx)) * kSpillPx +
                (left - bx * kSpillPx);
            uint16_t* to =
                levels_[0].data() +
                (static_cast<size_t>(c) * region_.height + static_cast<size_t>(y - rect.y + ry)) * region_.width +
                (left - rect.x + rx);
            std::memcpy(to, from, static_cast<size_t>(right - left) * 2);
          }
        }
      }
    }
    return {};
  }

  // The tile's texels of level L-3, without the margin, as one block.
  void spillInto(SpillBlock& block) {
    const TextureStage& s = stage_->texture;
    const int channels = context_.format.channels();
    Region r = regionAt(kStageLevels);
    const int margin = kMarginPx >> kStageLevels;
    block.offset = (tile_y_ * s.out_columns + tile_x_) * spillBlockBytes(channels);
    block.bytes.assign(spillBlockBytes(channels), 0);
    for (int c = 0; c < channels; ++c)
      for (int y = 0; y < r.height - 2 * margin; ++y)
        std::memcpy(block.bytes.data() + (static_cast<size_t>(c) * kSpillPx + static_cast<size_t>(y)) * kSpillPx * 2,
                    levels_[kStageLevels].data() + (static_cast<size_t>(c) * r.height + y + margin) * r.width + margin,
                    static_cast<size_t>(r.width - 2 * margin) * 2);
  }

  // Page (x, y) of the tile, `down` levels below L.
  void cutTexture(int down, int x, int y, int plane) {
    Region r = regionAt(down);
    const int margin = kMarginPx >> down;
    const size_t corner =
        static_cast<size_t>(y * kPagePx + margin - kPageBorderPx) * r.width + (x * kPagePx + margin - kPageBorderPx);
    uint8_t* out = page_.data();
    for (int c = 3 * plane; c < 3 * plane + 3; ++c) {
      const size_t from = static_cast<size_t>(c) * r.width * r.height + corner;
      for (int row = 0; row < kPageFullPx; ++row, out += kPageFullPx) {
        const size_t place = from + static_cast<size_t>(row) * r.width;
        if (down == 0 && stage_->texture.source) {
          std::memcpy(out, bytes_.data() + place, kPageFullPx);
        } else {
          const uint16_t* in = levels_[down].data() + place;
          for (int i = 0; i < kPageFullPx; ++i) out[i] = byteFromLevel(in[i]);
        }
      }
    }
  }

  // ---- relief ----
  static constexpr int gridSide(int down) { return (kTilePx >> down) + 1; }

  Result<void> prepareRelief(BuildPart& out_part) {
    const ReliefStage& s = stage_->relief;
    grid_[0].resize(static_cast<size_t>(gridSide(0)) * gridSide(0));
    NodeGrid nodes = context_.domain.nodeGrid(s.level);
    relief_columns_ = static_cast<int>(std::min<uint64_t>(kTilePages, nodes.columns - tile_x_ * kTilePages));
    relief_rows_ = static_cast<int>(std::min<uint64_t>(kTilePages, nodes.rows - tile_y_ * kTilePages));
    if (auto filled = s.source ? sampleHeights() : readReliefSpill(); !filled) return filled;
    // Coarser pages reach beyond the finest ones, where every vertex lies clamped on the artwork's border.
    const int full = gridSide(0), used_x = relief_columns_ * kPagePx + 1, used_y = relief_rows_ * kPagePx + 1;
    for (int y = 0; y < used_y; ++y) {
      uint16_t* row = grid_[0].data() + static_cast<size_t>(y) * full;
      std::fill(row + used_x, row + full, row[used_x - 1]);
    }
    for (int y = used_y; y < full; ++y)
      std::memcpy(grid_[0].data() + static_cast<size_t>(y) * full,
                  grid_[0].data() + static_cast<size_t>(used_y - 1) * full, full * sizeof(uint16_t));
    int columns = relief_columns_, rows = relief_rows_;
    for (int down = 1; down <= kStageLevels && s.level - down >= 0; ++down) {
      // Coarser samples are finer ones.
      const int side = gridSide(down), finer_side = gridSide(down - 1);
      grid_[down].resize(static_cast<size_t>(side) * side);
      for (int y = 0; y < side; ++y)
        for (int x = 0; x < side; ++x)
          grid_[down][static_cast<size_t>(y) * side + x] =
              grid_[down - 1][static_cast<size_t>(2 * y) * finer_side + 2 * x];
      const int finer_columns = columns, finer_rows = rows;
      columns = (columns + 1) / 2, rows = (rows + 1) / 2;
      for (int y = 0; y < rows; ++y) {
        for (int x = 0; x < columns; ++x) {
          NodeRange r;
          std::array<const NodeRange*, 4> children{};
          for (int child = 0; child < 4; ++child) {
            int cx = 2 * x + (child & 1), cy = 2 * y + (child >> 1);
            if (cx >= finer_columns || cy >= finer_rows) continue;
            const NodeRange& c = ranges_[down - 1][static_cast<size_t>(cy) * kTilePages + cx];
            children[child] = &c;
            r.min = std::min(r.min, c.min);
            r.max = std::max(r.max, c.max);
          }
          boundErrors(down, x, y, children, r);
          ranges_[down][static_cast<size_t>(y) * kTilePages + x] = r;
        }
      }
    }
    if (!s.out) return {};
    out_part.spill_node = tile_y_ * s.out_columns + tile_x_;
    out_part.spill_range = ranges_[kStageLevels][0];
    out_part.relief_spill.offset = out_part.spill_node * kReliefPageSamples * 2;
    const auto* samples = reinterpret_cast<const uint8_t*>(grid_[kStageLevels].data());
    out_part.relief_spill.bytes.assign(samples, samples + kReliefPageSamples * 2);
    return {};
  }

  // A block's error: what the finer level's blocks below it leave out, and how far that level lies from this one. Both
  // surfaces lie between the finest samples' extremes.
  void boundErrors(int down, int node_x, int node_y, const std::array<const NodeRange*, 4>& children,
                   NodeRange& r) const {
    constexpr int kHalf = kErrorBlocks / 2;
    const uint32_t range = static_cast<uint32_t>(r.max - r.min);
    for (int by = 0; by < kErrorBlocks; ++by) {
      for (int bx = 0; bx < kErrorBlocks; ++bx) {
        BlockError inside;
        if (const NodeRange* child = children[(by >= kHalf ? 2 : 0) + (bx >= kHalf ? 1 : 0)]) {
          const BlockError* finer = child->blocks.data() + 2 * (by % kHalf) * kErrorBlocks + 2 * (bx % kHalf);
          inside = joined(joined(finer[0], finer[1]), joined(finer[kErrorBlocks], finer[kErrorBlocks + 1]));
        }
        const Step step = deviation(down, node_x, node_y, bx, by);
        BlockError& block = r.blocks[static_cast<size_t>(by * kErrorBlocks + bx)];
        block.below = static_cast<uint16_t>(std::min(inside.below + step.below, range));
        block.above = static_cast<uint16_t>(std::min(inside.above + step.above, range));
        block.error = std::max(block.below, block.above);
        block.apart = block.between =
            std::min<uint32_t>(inside.below + inside.above + step.between, block.below + block.above);
        r.error = std::max(r.error, block.error);
      }
    }
  }

  // How far the samples of the next finer level lie, at most, from this level's surface over a block of node (x, y) of
  // the tile, below it and above: cells split along the (0,0)-(1,1) diagonal, or bilinear; and from the lowest to the
  // highest of one cell (split). Rounded up. A cell that the artwork's border cuts is squeezed onto it, so its finer
  // samples lie at other parameters than the halves: there the cell's range of samples is the bound.
  struct Step {
    uint32_t below = 0, above = 0, between = 0;
  };
  RELIEVO_SIMD_CLONES Step deviation(int down, int node_x, int node_y, int block_x, int block_y) const noexcept {
    constexpr int kCells = kPagePx / kErrorBlocks;
    const ReliefStage& s = stage_->relief;
    ReliefGrid cells(context_.domain, s.level - down);
    const int64_t first_x = (static_cast<int64_t>(tile_x_) * kTilePx >> down) + node_x * kPagePx + block_x * kCells;
    const int64_t first_y = (static_cast<int64_t>(tile_y_) * kTilePx >> down) + node_y * kPagePx + block_y * kCells;
    auto local = [](int64_t end, int64_t first) {
      return static_cast<int>(std::clamp<int64_t>(end - first, 0, kCells));
    };
    const int whole_x = local(cells.whole_x, first_x), whole_y = local(cells.whole_y, first_y);
    const int cells_x = local(cells.cells_x, first_x), cells_y = local(cells.cells_y, first_y);
    const int side = gridSide(down - 1);
    const uint16_t* g = grid_[down - 1].data() + static_cast<size_t>(2 * (node_y * kPagePx + block_y * kCells)) * side +
                        2 * (node_x * kPagePx + block_x * kCells);
    int most = 0, least = 0, apart = 0;  // in quarters
    auto note = [&](int quarters) {
      most = std::max(most, quarters);
      least = std::min(least, quarters);
    };
    if (whole_x > 0 && whole_y > 0) {
      for (int y = 0; y <= whole_y; ++y) {
        const uint16_t *r0 = g + static_cast<size_t>(2 * y) * side, *r1 = r0 + side, *r2 = r1 + side;
        for (int x = 0; x < whole_x; ++x) note(2 * (2 * r0[2 * x + 1] - r0[2 * x] - r0[2 * x + 2]));
        if (y == whole_y) break;
        for (int x = 0; x <= whole_x; ++x) note(2 * (2 * r1[2 * x] - r0[2 * x] - r2[2 * x]));
        for (int x = 0; x < whole_x; ++x) {
          int a = r0[2 * x], b = r0[2 * x + 2], c = r2[2 * x], d = r2[2 * x + 2], m = r1[2 * x + 1];
          note(2 * (2 * m - a - d));
          note(4 * m - a - b - c - d);
          const std::array<int, 5> of_cell{2 * r0[2 * x + 1] - a - b, 2 * r2[2 * x + 1] - c - d, 2 * r1[2 * x] - a - c,
                                           2 * r1[2 * x + 2] - b - d, 2 * m - a - d};
          const auto [lowest, highest] = std::minmax_element(of_cell.begin(), of_cell.end());
          apart = std::max(apart, 2 * (std::max(*highest, 0) - std::min(*lowest, 0)));
        }
      }
    }
    int above = (most + 3) / 4, below = (3 - least) / 4, between = (apart + 3) / 4;
    for (int y = 0; y < cells_y; ++y) {
      for (int x = y < whole_y ? whole_x : 0; x < cells_x; ++x) {
        int low = 65535, high = 0;
        for (int j = 0; j <= 2; ++j) {
          for (int i = 0; i <= 2; ++i) {
            int v = g[static_cast<size_t>(2 * y + j) * side + 2 * x + i];
            low = std::min(low, v), high = std::max(high, v);
          }
        }
        above = std::max(above, high - low), below = std::max(below, high - low),
        between = std::max(between, 2 * (high - low));
      }
    }
    return {static_cast<uint32_t>(below), static_cast<uint32_t>(above), static_cast<uint32_t>(between)};
  }

  Result<void> sampleHeights() {
    const FlatDomain& d = context_.domain;
    const HeightSource& source = *stage_->relief.source;
    const int side = gridSide(0);
    const int used_x = relief_columns_ * kPagePx + 1, used_y = relief_rows_ * kPagePx + 1;
    struct Tap {
      int64_t low;
      double fraction;
    };
    // Texel position -> place among the map's pixel centres.
    auto taps = [&](uint64_t tile, int count, uint64_t extent, int64_t pixels) {
      std::vector<Tap> out(static_cast<size_t>(count));
      const double spacing = std::ldexp(1.0, d.texture_depth - d.relief_depth);
      for (int i = 0; i < count; ++i) {
        double texel = std::min(static_cast<double>(tile * kTilePx + static_cast<uint64_t>(i)) * spacing,
                                static_cast<double>(extent));
        double at = std::clamp(texel * static_cast<double>(pixels) / static_cast<double>(extent) - 0.5, 0.0,
                               static_cast<double>(pixels - 1));
        int64_t low = std::min(static_cast<int64_t>(at), std::max<int64_t>(pixels - 2, 0));
        out[static_cast<size_t>(i)] = {low, at - static_cast<double>(low)};
      }
      return out;
    };
    auto tx = taps(tile_x_, used_x, d.width_px, source.width());
    auto ty = taps(tile_y_, used_y, d.height_px, source.height());
    Rect rect{tx.front().low, ty.front().low, 0, 0};
    rect.width = std::min(tx.back().low + 2, source.width()) - rect.x;
    rect.height = std::min(ty.back().low + 2, source.height()) - rect.y;
    heights_.resize(static_cast<size_t>(rect.width) * static_cast<size_t>(rect.height));
    if (auto read = source.read(rect, heights_); !read) return read;
    const double offset = d.relief_offset_mm;
    const double per_mm = d.relief_scale_mm > 0 ? 1.0 / d.relief_scale_mm : 0.0;
    const bool one_column = source.width() == 1, one_row = source.height() == 1;
    for (int y = 0; y < used_y; ++y) {
      const float* row0 = heights_.data() + static_cast<size_t>(ty[y].low - rect.y) * static_cast<size_t>(rect.width);
      const float* row1 = one_row ? row0 : row0 + rect.width;
      const double fy = ty[y].fraction;
      uint16_t* out = grid_[0].data() + static_cast<size_t>(y) * side;
      for (int x = 0; x < used_x; ++x) {
        const int64_t i = tx[x].low - rect.x, j = one_column ? i : i + 1;
        const double fx = tx[x].fraction;
        double mm = (1 - fy) * ((1 - fx) * row0[i] + fx * row0[j]) + fy * ((1 - fx) * row1[i] + fx * row1[j]);
        double q = (mm - offset) * per_mm + 0.5;
        out[x] = q > 0 ? static_cast<uint16_t>(std::min(q, 65535.0)) : uint16_t{0};  // not a number: 0
      }
    }
    for (int py = 0; py < relief_rows_; ++py) {
      for (int px = 0; px < relief_columns_; ++px) {
        NodeRange r;
        for (int y = 0; y < kReliefSamples; ++y) {
          const uint16_t* row = grid_[0].data() + static_cast<size_t>(py * kPagePx + y) * side + px * kPagePx;
          for (int x = 0; x < kReliefSamples; ++x) r.min = std::min(r.min, row[x]), r.max = std::max(r.max, row[x]);
        }
        ranges_[0][static_cast<size_t>(py) * kTilePages + px] = r;
      }
    }
    return {};
  }

  Result<void> readReliefSpill() {
    const ReliefStage& s = stage_->relief;
    const int side = gridSide(0);
    std::array<uint16_t, kReliefPageSamples> block;
    for (int py = 0; py < relief_rows_; ++py) {
      for (int px = 0; px < relief_columns_; ++px) {
        uint64_t n = (tile_y_ * kTilePages + static_cast<uint64_t>(py)) * s.in_columns + tile_x_ * kTilePages +
                     static_cast<uint64_t>(px);
        if (auto read = s.in->read(n * kReliefPageSamples * 2, block.data(), sizeof block); !read) return read;
        for (int y = 0; y < kReliefSamples; ++y)
          std::memcpy(grid_[0].data() + static_cast<size_t>(py * kPagePx + y) * side + px * kPagePx,
                      block.data() + static_cast<size_t>(y) * kReliefSamples, kReliefSamples * 2);
        ranges_[0][static_cast<size_t>(py) * kTilePages + px] = (*s.in_ranges)[n];
      }
    }
    return {};
  }

  // ---- pages ----
  // Children first (Z-order), then the node: its texture planes, then its relief.
  void emit(int level, int down, int x, int y, BuildPart& out) {
    const uint64_t column = (tile_x_ * kTilePages >> down) + static_cast<uint64_t>(x);
    const uint64_t row = (tile_y_ * kTilePages >> down) + static_cast<uint64_t>(y);
    NodeGrid nodes = context_.domain.nodeGrid(level - down);
    if (column >= nodes.columns || row >= nodes.rows) return;
    if (down > 0)
      for (int child = 0; child < 4; ++child) emit(level, down - 1, 2 * x + (child & 1), 2 * y + (child >> 1), out);
    const NodeId node = context_.domain.nodeAt(level - down, column, row);
    if (stage_->texture.level >= 0) {
      auto at = context_.layout.texture.find(node);
      for (int plane = 0; plane < context_.format.planes(); ++plane) {
        cutTexture(down, x, y, plane);
        out.place(
            {.index_offset = at.block_offset + at.node_offset + static_cast<uint64_t>(plane) * kTextureEntryBytes},
            encoder_.encodeTexture(page_, context_.encodings[static_cast<size_t>(plane)]));
      }
    }
    if (stage_->relief.level >= 0) {
      auto at = context_.layout.relief.find(node), detail = context_.layout.relief_detail.find(node);
      const int side = gridSide(down);
      for (int j = 0; j < kReliefSamples; ++j)
        std::memcpy(samples_.data() + static_cast<size_t>(j) * kReliefSamples,
                    grid_[down].data() + static_cast<size_t>(y * kPagePx + j) * side + x * kPagePx, kReliefSamples * 2);
      out.place({.index_offset = at.block_offset + at.node_offset,
                 .relief = true,
                 .detail_offset = detail.block_offset + detail.node_offset,
                 .range = ranges_[down][static_cast<size_t>(y) * kTilePages + x]},
                encoder_.encodeRelief(samples_));
    }
  }

  const BuildContext& context_;
  PageEncoder encoder_;
  const Stage* stage_ = nullptr;
  uint64_t tile_x_ = 0, tile_y_ = 0;

  Region region_;
  Rect valid_;                         // the tile's texels on the artwork, level L
  std::vector<uint8_t> bytes_, part_;  // level L of the first stage
  std::array<std::vector<uint16_t>, kStageLevels + 1> levels_;
  std::vector<uint16_t> spill_;
  std::array<uint8_t, kTexturePageBytes> page_;

  int relief_columns_ = 0, relief_rows_ = 0;  // pages of level L in the tile
  std::vector<float> heights_;
  std::array<std::vector<uint16_t>, kStageLevels + 1> grid_;
  std::array<std::array<NodeRange, kTilePages * kTilePages>, kStageLevels + 1> ranges_;
  std::array<uint16_t, kReliefPageSamples> samples_;
};

Result<std::string> manifestOf(const PackageHeader& h, const TextureSource& texture, const HeightSource* relief,
                               const std::string& tool_version) {
  nlohmann::ordered_json json = manifestJson(h, tool_version);
  if (auto added = addSource(json, texture.provenance(), "texture"); !added) return added.error();
  if (relief)
    if (auto added = addSource(json, relief->provenance(), "relief"); !added) return added.error();
  return manifestText(json);
}

// A height map lies over the texture border to border: it has the texture's proportions, but for rounding to whole
// pixels.
constexpr double kAspectTolerance = 0.01;
Result<void> checkProportions(const TextureSource& texture, const HeightSource& relief) {
  const double w = static_cast<double>(texture.width()), h = static_cast<double>(texture.height());
  const double relief_w = static_cast<double>(relief.width()), relief_h = static_cast<double>(relief.height());
  const double stretch = relief_w * h / (relief_h * w);
  if (std::abs(stretch - 1) <= kAspectTolerance || std::abs(relief_w - relief_h * w / h) <= 1 ||
      std::abs(relief_h - relief_w * h / w) <= 1)
    return {};
  char text[200];
  std::snprintf(text, sizeof text,
                "expected the proportions of the texture, %lld x %lld px, within 1 %% or one pixel, found a height map "
                "of %lld x %lld px, off by %.1f %%",
                static_cast<long long>(texture.width()), static_cast<long long>(texture.height()),
                static_cast<long long>(relief.width()), static_cast<long long>(relief.height()),
                100 * (std::max(stretch, 1 / stretch) - 1));
  return Error{ErrorKind::kInvalidData,
               relief.provenance().name,
               text,
               "cut both to the same part of the artwork; --stretch-relief stretches it all the same",
               {}};
}

Result<FlatDomain> planDomain(const TextureSource& texture, const HeightSource* relief, double mm_per_px,
                              bool stretch_relief) {
  FlatDomain d;
  if (texture.width() < 1 || texture.height() < 1) return usage("the texture is empty");
  d.width_px = static_cast<uint64_t>(texture.width());
  d.height_px = static_cast<uint64_t>(texture.height());
  d.mm_per_px = mm_per_px;
  if (std::min(d.width_px, d.height_px) > (uint64_t{kPagePx} << kMaxNodeLevel))
    return Error{
        ErrorKind::kUnsupported, "", "the texture's shorter side exceeds 2^24 texels", "split the artwork", {}};
  d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
  if (relief) {
    if (relief->width() < 1 || relief->height() < 1) return usage("the height map is empty");
    if (!stretch_relief)
      if (auto alike = checkProportions(texture, *relief); !alike) return alike.error();
    if (!std::isfinite(relief->minMm()) || !std::isfinite(relief->maxMm()) || relief->maxMm() < relief->minMm())
      return usage("the height map's range is not one: " + std::to_string(relief->minMm()) + " to " +
                   std::to_string(relief->maxMm()) + " mm");
    double pixel = std::min(static_cast<double>(d.width_px) / static_cast<double>(relief->width()),
                            static_cast<double>(d.height_px) / static_cast<double>(relief->height()));
    d.relief_depth = 0;
    while (std::ldexp(1.0, d.texture_depth - d.relief_depth) > pixel * kSpacingSlack) ++d.relief_depth;
    if (d.relief_depth > static_cast<int>(kMaxNodeLevel))
      return Error{ErrorKind::kUnsupported,
                   "",
                   "the height map is too fine for the texture",
                   "scale it down to the texture's size",
                   {}};
    d.relief_offset_mm = relief->minMm();
    d.relief_scale_mm = (relief->maxMm() - relief->minMm()) / 65535.0;
  }
  if (std::string problem = domainProblem(d); !problem.empty()) return usage("cannot build this: " + problem);
  return d;
}

Result<PackageHeader> planHeader(const TextureSource& texture, const HeightSource* relief,
                                 const BuildOptions& options) {
  auto planned = planDomain(texture, relief, options.size_known ? options.mm_per_px : 1, options.stretch_relief);
  if (!planned) return planned.error();
  PackageHeader header;
  header.domain = *planned;
  header.size_known = options.size_known;
  header.texture = texture.format();
  header.encodings = planeEncodings(header.texture, options.coefficients, options.colour);
  for (size_t k = 0; k < header.texture.scale.size(); ++k)
    if (!std::isfinite(header.texture.scale[k]) || !std::isfinite(header.texture.bias[k]))
      return usage("a coefficient's scale or bias is not a number");
  header.relief_detail = header.relief_shapes = header.domain.relief_depth >= 0;
  header.page_count = packageLayout(header.domain, header.texture, 0, 0).page_count;
  return header;
}

// A worker's share: the region in bytes (twice, at borders) and its levels, and the finished tiles that wait.
uint64_t workerBytes(const TextureFormat& format, bool relief) {
  const auto channels = static_cast<uint64_t>(format.channels()), planes = static_cast<uint64_t>(format.planes());
  const uint64_t region_texels = uint64_t{kTilePx + 2 * kMarginPx} * (kTilePx + 2 * kMarginPx);
  const uint64_t tile_pages = kTilePages * kTilePages * 4 / 3;
  return region_texels * channels * 3 + (relief ? region_texels * 8 : 0) +
         uint64_t{kSpillPx * kSpillPx} * 2 * channels * (1 + kPartsAhead) +
         tile_pages * (kTexturePageBytes * planes + (relief ? kReliefPageSamples * 2 : 0)) * (1 + kPartsAhead);
}

// All stages, from the finest level on.
class StagedBuild {
 public:
  StagedBuild(const BuildContext& context, const BuildOptions& options, int workers, SpillBudget& spills,
              CheckpointedWriter& writer, BuildReporter& reporter)
      : context_(context),
        options_(options),
        workers_(workers),
        spills_(spills),
        writer_(writer),
        reporter_(reporter) {}

  Result<void> run() {
    const int texture_depth = context_.domain.texture_depth, relief_depth = context_.domain.relief_depth;
    if (texture_depth == relief_depth) return pass(texture_depth, {.texture = true, .relief = true});
    if (auto ran = pass(texture_depth, {.texture = true}); !ran || relief_depth < 0) return ran;
    return pass(relief_depth, {.relief = true});
  }

 private:
  struct Planes {
    bool texture = false, relief = false;
  };
  struct Tile {
    uint64_t x = 0, y = 0;
  };
  // What one stage writes and the next one reads.
  struct Spills {
    std::unique_ptr<SpillStore> texture, relief;
    std::vector<NodeRange> ranges;
  };

  // The stages of these planes. A spill lives from the stage that writes it to the one that reads it.
  Result<void> pass(int finest, Planes planes) {
    Spills in;
    for (int level = finest; level >= 0; level -= kStageLevels) {
      Spills out;
      const NodeGrid nodes = context_.domain.nodeGrid(level);
      Stage stage;
      stage.tile_columns = (nodes.columns + kTilePages - 1) / kTilePages;
      stage.tile_rows = (nodes.rows + kTilePages - 1) / kTilePages;
      if (level >= kStageLevels)
        if (auto made = makeRoom(stage.tile_columns * stage.tile_rows, planes, out); !made) return made;
      if (planes.texture)
        stage.texture = {.level = level,
                         .source = level == finest ? &context_.texture : nullptr,
                         .in = in.texture.get(),
                         .out = out.texture.get(),
                         .in_columns = nodes.columns,
                         .out_columns = stage.tile_columns};
      if (planes.relief)
        stage.relief = {.level = level,
                        .source = level == finest ? context_.relief : nullptr,
                        .in = in.relief.get(),
                        .out = out.relief.get(),
                        .in_ranges = &in.ranges,
                        .out_ranges = &out.ranges,
                        .in_columns = nodes.columns,
                        .out_columns = stage.tile_columns};
      if (auto ran = runStage(stage); !ran) return ran;
      in = std::move(out);
    }
    return {};
  }

  Result<void> makeRoom(uint64_t tiles, Planes planes, Spills& out) {
    if (planes.texture) {
      auto made = spills_.create(tiles * TileWorker::spillBlockBytes(context_.format.channels()));
      if (!made) return made.error();
      out.texture = std::move(*made);
    }
    if (planes.relief) {
      auto made = spills_.create(tiles * kReliefPageSamples * 2);
      if (!made) return made.error();
      out.relief = std::move(*made);
      out.ranges.assign(tiles, {});
    }
    return {};
  }

  Result<void> runStage(const Stage& stage) {
    const uint32_t serial = stages_done_++;
    TileOrder order(stage.tile_columns, stage.tile_rows);
    uint64_t tiles = stage.tile_columns * stage.tile_rows;
    if (auto replayed = replay(stage, serial, order, tiles); !replayed) return replayed;
    if (tiles == 0) return {};
    OrderedWorkers<Tile> runner(
        static_cast<int>(std::min<uint64_t>(static_cast<uint64_t>(workers_), tiles)), kPartsAhead, options_.interrupted,
        [&](Tile* tile) { return order.next(&tile->x, &tile->y); },
        [&] {
          auto worker = std::make_shared<TileWorker>(context_, options_.zstd_level);
          return [&stage, worker](const Tile& tile) { return worker->run(stage, tile.x, tile.y); };
        });
    return writeParts(
        runner, tiles, writer_.pages(), options_, [&](const BuildPart* part) { reporter_.report(part); },
        [&](const BuildPart& part) {
          if (auto spilled = spill(stage, part); !spilled) return spilled;
          return writer_.record(serial, part);
        });
  }

  // The tiles that an earlier build has made are passed over.
  Result<void> replay(const Stage& stage, uint32_t serial, TileOrder& order, uint64_t& tiles) {
    for (; tiles > 0; --tiles) {
      auto part = writer_.replay(serial);
      if (!part) return part.error();
      if (!*part) break;
      Tile passed;
      order.next(&passed.x, &passed.y);
      if (auto spilled = spill(stage, **part); !spilled) return spilled;
      reporter_.report(part->get());
    }
    return {};
  }

  // The next stage's input.
  static Result<void> spill(const Stage& stage, const BuildPart& part) {
    if (stage.texture.out)
      if (auto written = stage.texture.out->write(part.texture_spill.offset, part.texture_spill.bytes.data(),
                                                  part.texture_spill.bytes.size());
          !written)
        return written;
    if (!stage.relief.out) return {};
    if (part.spill_node < stage.relief.out_ranges->size())
      (*stage.relief.out_ranges)[part.spill_node] = part.spill_range;
    return stage.relief.out->write(part.relief_spill.offset, part.relief_spill.bytes.data(),
                                   part.relief_spill.bytes.size());
  }

  const BuildContext& context_;
  const BuildOptions& options_;
  const int workers_;
  SpillBudget& spills_;
  CheckpointedWriter& writer_;
  BuildReporter& reporter_;
  uint32_t stages_done_ = 0;
};

}  // namespace

Result<BuildReport> buildPackage(const TextureSource& texture, const HeightSource* relief,
                                 const BuildOptions& options) {
  BuildReporter reporter(options);
  auto planned = planHeader(texture, relief, options);
  if (!planned) return planned.error();
  PackageHeader& header = *planned;
  const FlatDomain d = header.domain.flat();
  reporter.expect(header.page_count, d.width_px * d.height_px);
  const auto manifest = manifestOf(header, texture, relief, options.tool_version);
  if (!manifest) return manifest.error();
  if (auto placed = placeSections(header, *manifest, {}); !placed) return placed.error();

  const BuildContext context{
      texture, relief, d, header.texture, packageLayout(header), MipFilter(header.texture), header.encodings};
  const Workforce force = workersThatFit(workerBytes(header.texture, relief), options);
  SpillBudget spills{force.left_bytes, options.output};
  auto writer = CheckpointedWriter::open(header, *manifest, options, reporter, spills);
  if (!writer) return writer.error();
  if (auto ran = StagedBuild(context, options, force.workers, spills, **writer, reporter).run(); !ran)
    return (*writer)->stopped(ran.error());
  assert(reporter.pagesDone() == header.page_count);

  // The last moment for a checkpoint: finish() writes before and after the pages.
  if (options.interrupted && options.interrupted->load())
    return (*writer)->stopped({ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}});
  auto file_bytes = (*writer)->finish();
  if (!file_bytes) return file_bytes.error();
  reporter.reportEnd();
  return BuildReport{header.page_count, *file_bytes, reporter.seconds()};
}

}  // namespace relievo
