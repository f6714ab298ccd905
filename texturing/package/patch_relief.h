// patch_relief.h - a patch's relief as a package has it: bounds of its heights and errors, and its pages. Internal to
// texturing/.
#pragma once

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "src/artwork/deviation.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/patch_build.h"

namespace relievo::patch_build {

// In a compact package bounds are rounded, away from what they bound, to few values: they take far fewer bytes so, and
// are hardly larger.
inline constexpr int kMantissaBits = 6, kShareSteps = 15, kShapeSteps = 7;
// The next number away from 0 (up) or towards it that has so many bits behind the point.
inline float rounded(float v, bool up) {
  constexpr uint32_t kBelow = (1u << (23 - kMantissaBits)) - 1;
  const auto bits = std::bit_cast<uint32_t>(v);
  return std::bit_cast<float>(up ? (bits + kBelow) & ~kBelow : bits & ~kBelow);
}
inline float roundedUp(float v) { return rounded(v, v > 0); }
inline float roundedDown(float v) { return rounded(v, v < 0); }
inline uint8_t roundedShare(uint8_t share, int steps) {
  const int step = (share * steps + 254) / 255;
  return static_cast<uint8_t>((step * 255 + steps - 1) / steps);
}
inline DeviationShape roundedShape(const DeviationShape& s) {
  auto up = [](uint8_t v) { return roundedShare(v, kShapeSteps); };
  DeviationShape out{up(s.below), up(s.above), up(s.aside), s.between, up(s.apart)};
  // It is a share of the first two, which are larger now.
  if (const int both = out.below + out.above; both > 0)
    out.between = static_cast<uint8_t>((s.between * (s.below + s.above) + both - 1) / both);
  out.between = up(out.between);
  return out;
}

class PatchRelief {
 public:
  explicit PatchRelief(Context& context) : c_(context) {}

  // Its heights, and what nodes know of those below.
  Result<void> read(uint32_t patch) {
    if (isEven() && !ranges_.empty()) return {};  // as those of the patch before
    const int depth = c_.header.domain.relief_depth;
    const size_t side = sideSamples();
    heights_.resize(side * side);
    if (auto made = c_.source.heights(patch, heights_); !made) return made;
    if (auto read = readErrors(patch, depth); !read) return read;
    ranges_.resize(static_cast<size_t>(depth) + 1);
    for (int level = depth; level >= 0; --level) {
      const uint32_t nodes = 1u << level;
      ranges_[static_cast<size_t>(level)].resize(size_t{nodes} * nodes);
      for (uint32_t y = 0; y < nodes; ++y)
        for (uint32_t x = 0; x < nodes; ++x)
          ranges_[static_cast<size_t>(level)][size_t{y} * nodes + x] = rangeOf(level, x, y);
    }
    return {};
  }
  // What the base mesh's section says of it, into the context.
  Result<void> describe(uint32_t patch) {
    if (isEven() && patch > 0) return {};
    if (auto known = read(patch); !known) return known;
    if (isEven()) {
      std::array<uint16_t, kReliefPageSamples> page;
      page.fill(heights_[0]);
      tailHeights(page, c_.even_tail);
    }
    noteBorder(patch, sideSamples() - 1);
    noteSlopes(patch, sideSamples() - 1);
    return describeCoarse(patch);
  }
  bool isEven() const { return c_.even_patches; }
  size_t sideSamples() const { return (size_t{kPagePx} << c_.header.domain.relief_depth) + 1; }
  std::span<const uint16_t> heights() const { return heights_; }
  const NodeRange& range(int level, uint32_t x, uint32_t y) const {
    return ranges_[static_cast<size_t>(level)][(size_t{y} << level) + x];
  }

 private:
  Result<void> describeCoarse(uint32_t patch) {
    auto coarse = c_.source.coarseErrors(patch);
    if (!coarse) return coarse.error();
    CoarseShapes& shapes = c_.coarse_shapes[patch];
    // Of the whole patch: never below what is finer, as the page's own error was rounded up.
    const double page_mm = ranges_[0][0].error * c_.source.errorUnitMm();
    float least = page_mm > 0 ? std::nextafter(static_cast<float>(page_mm), INFINITY) : 0.0f;
    for (size_t k = coarse->size(); k-- > 0;) {
      float& e = (*coarse)[k];
      if (!std::isfinite(e) || e < 0)
        return invalid(patch, "its error at " + std::to_string(1 << k) + " cells a side is not a number of mm");
      const float mm = std::exchange(e, std::max(e, least));
      if (c_.header.compact) e = roundedUp(e);
      least = e;
      if (k >= kFirstShapedBlock) continue;
      if (!c_.source.errorShapes(patch, static_cast<int>(k), std::span(shapes).subspan(k, 1))) shapes[k] = {};
      shapes[k] = stored(reshaped(mm, shapes[k], e), e);
    }
    c_.coarse_errors[patch] = *coarse;
    return readCoarseBlocks(patch);
  }

  // What was a shape of an error of mm, of a larger one.
  static DeviationShape reshaped(double mm, const DeviationShape& shape, double larger_mm) {
    Deviation d = deviationOf(mm, shape);
    d.mm = larger_mm;
    return shapeOf(d);
  }
  bool slight(float mm) const { return mm <= c_.source.slightErrorMm(); }
  // Of an error of mm, as the package has it.
  DeviationShape stored(const DeviationShape& shape, float mm) const {
    if (!c_.header.compact) return shape;
    return slight(mm) ? DeviationShape{} : roundedShape(shape);
  }
  // No block's error is below those of the finer blocks inside it, as they come back from the package.
  Result<void> readCoarseBlocks(uint32_t patch) {
    const size_t root = kErrorBlocks;
    std::vector<float> finer(root * root), mm;
    for (size_t i = 0; i < finer.size(); ++i)
      finer[i] = static_cast<float>(ranges_[0][0].blocks[i].error * c_.source.errorUnitMm()) * (1 + 1e-6f);
    CoarseBlocks& shares = c_.coarse_blocks[patch];
    for (int grid = kBlockedGrids - 1; grid >= 0; --grid) {
      const int cells_log2 = kFirstBlockedGrid + grid;
      const float whole = c_.coarse_errors[patch][static_cast<size_t>(cells_log2)];
      const size_t blocks = size_t{1} << (cells_log2 - 3);
      mm.assign(blocks * blocks, whole);
      if (auto known = c_.source.coarseBlocks(patch, cells_log2, mm); !known) {
        return known.error();
      } else if (!*known) {
        mm.assign(blocks * blocks, whole);
      }
      const size_t first = kFirstCoarseBlock[static_cast<size_t>(grid)];
      const std::span<DeviationShape> shapes =
          std::span(c_.coarse_shapes[patch]).subspan(kFirstShapedBlock + first, blocks * blocks);
      if (!c_.source.errorShapes(patch, cells_log2, shapes)) std::fill(shapes.begin(), shapes.end(), DeviationShape{});
      for (size_t y = 0; y < blocks; ++y) {
        for (size_t x = 0; x < blocks; ++x) {
          float& e = mm[y * blocks + x];
          if (!std::isfinite(e) || e < 0)
            return invalid(patch, "its error by blocks at " + std::to_string(1 << cells_log2) +
                                      " cells a side is not a number of mm");
          const float own = e;
          const float* inside = finer.data() + 2 * y * 2 * blocks + 2 * x;
          e = std::min(whole, std::max({e, inside[0], inside[1], inside[2 * blocks], inside[2 * blocks + 1]}));
          uint8_t share = whole > 0 ? static_cast<uint8_t>(std::min(255.0, std::ceil(255.0 * e / whole))) : 0;
          while (share < 255 && coarseBlockMm(whole, share) < e) ++share;
          if (c_.header.compact) share = slight(whole) ? 255 : roundedShare(share, kShareSteps);
          shares[first + y * blocks + x] = share;
          e = coarseBlockMm(whole, share);
          DeviationShape& shape = shapes[y * blocks + x];
          shape = stored(own <= e ? reshaped(own, shape, e) : DeviationShape{}, e);
        }
      }
      finer = mm;
    }
    return {};
  }

  void noteSlopes(uint32_t patch, size_t cells) {
    const size_t side = cells + 1;
    std::array<int, 4> q{65535, -65535, 65535, -65535};  // least and largest step along u, and along v
    for (size_t y = 0; y < side; ++y) {
      const uint16_t* row = heights_.data() + y * side;
      for (size_t x = 0; x < cells; ++x) {
        const int step = row[x + 1] - row[x];
        q[0] = std::min(q[0], step), q[1] = std::max(q[1], step);
      }
      for (size_t x = 0; y < cells && x < side; ++x) {
        const int step = row[x + side] - row[x];
        q[2] = std::min(q[2], step), q[3] = std::max(q[3], step);
      }
    }
    auto least = [](double a, double b) { return std::nextafter(static_cast<float>(std::min(a, b)), -INFINITY); };
    auto largest = [](double a, double b) { return std::nextafter(static_cast<float>(std::max(a, b)), INFINITY); };
    const double mm = c_.source.reliefScaleMm() * static_cast<double>(cells);
    HeightSlopes& s = c_.slopes[patch];
    s = {least(q[0] * mm, q[1] * mm), largest(q[0] * mm, q[1] * mm), least(q[2] * mm, q[3] * mm),
         largest(q[2] * mm, q[3] * mm)};
    if (c_.header.compact) s = {roundedDown(s.min_u), roundedUp(s.max_u), roundedDown(s.min_v), roundedUp(s.max_v)};
  }

  void noteBorder(uint32_t patch, size_t cells) {
    const size_t side = cells + 1, last = cells * side;
    const std::array<size_t, 4> corner{0, cells, last, last + cells};
    const auto& index = c_.source.base().patches[patch];
    for (size_t k = 0; k < 4; ++k) c_.corner_height[patch][k] = heights_[corner[k]];
    std::vector<uint16_t> along(side);
    for (size_t s = 0; s < 4; ++s) {
      const size_t a = static_cast<size_t>(kSideCorners[s][0]), b = static_cast<size_t>(kSideCorners[s][1]),
                   step = (corner[b] - corner[a]) / cells;
      for (size_t i = 0; i < side; ++i) along[i] = heights_[corner[a] + i * step];
      if (index[a] > index[b]) std::reverse(along.begin(), along.end());
      c_.side_hash[patch][s] = XXH3_64bits(along.data(), along.size() * 2);
    }
  }

  // In units of the package, rounded up; a block's never below those of finer blocks inside.
  Result<void> readErrors(uint32_t patch, int depth) {
    const double unit = c_.source.errorUnitMm();
    errors_.resize(static_cast<size_t>(depth) + 1);
    for (int level = depth; level >= 0; --level) {
      const size_t blocks = size_t{kErrorBlocks} << level;
      error_mm_.resize(blocks * blocks);
      shapes_.assign(blocks * blocks, {});
      if (auto read = c_.source.errors(patch, level, error_mm_); !read) return read;
      if (!c_.source.errorShapes(patch, std::countr_zero(unsigned{kPagePx}) + level, shapes_))
        shapes_.assign(blocks * blocks, {});
      auto& out = errors_[static_cast<size_t>(level)];
      out.resize(blocks * blocks);
      for (size_t i = 0; i < out.size(); ++i) {
        auto stepsOf = [&](double mm) {
          const double steps = mm == 0 ? 0 : std::ceil(mm / unit);
          return steps * unit < mm ? steps + 1 : steps;
        };
        const double mm = error_mm_[i];
        if (!(mm >= 0) || !(stepsOf(mm) <= 65535)) {
          return invalid(patch, "its error of " + std::to_string(mm) + " mm at level " + std::to_string(level) +
                                    " is not within 0 and 65535 times " + std::to_string(unit) + " mm");
        }
        const Deviation d = deviationOf(mm, shapes_[i]);
        auto steps = [&](double part_mm) { return static_cast<uint16_t>(std::min(65535.0, stepsOf(part_mm))); };
        out[i] = {steps(d.mm),
                  steps(d.below_mm),
                  steps(d.above_mm),
                  steps(d.aside_mm),
                  static_cast<uint32_t>(stepsOf(d.between_mm)),
                  static_cast<uint32_t>(stepsOf(d.apart_mm))};
        if (level == depth) continue;
        const BlockError* finer =
            errors_[static_cast<size_t>(level) + 1].data() + 2 * (i / blocks) * 2 * blocks + 2 * (i % blocks);
        out[i] = joined(out[i], joined(joined(finer[0], finer[1]), joined(finer[2 * blocks], finer[2 * blocks + 1])));
      }
    }
    return {};
  }

  NodeRange rangeOf(int level, uint32_t x, uint32_t y) const {
    const int depth = c_.header.domain.relief_depth;
    NodeRange r;
    if (level == depth) {
      const size_t side = (size_t{kPagePx} << depth) + 1;
      for (size_t j = 0; j < kReliefSamples; ++j) {
        const uint16_t* row = heights_.data() + (y * kPagePx + j) * side + x * kPagePx;
        const auto [low, high] = std::minmax_element(row, row + kReliefSamples);
        r.min = std::min(r.min, *low), r.max = std::max(r.max, *high);
      }
    } else {
      for (size_t child = 0; child < 4; ++child) {
        const NodeRange& c =
            ranges_[static_cast<size_t>(level) + 1][((2 * y + child / 2) << (level + 1)) + 2 * x + child % 2];
        r.min = std::min(r.min, c.min), r.max = std::max(r.max, c.max);
      }
    }
    const size_t blocks = size_t{kErrorBlocks} << level;
    for (size_t i = 0; i < r.blocks.size(); ++i) {
      r.blocks[i] = errors_[static_cast<size_t>(level)]
                           [(y * kErrorBlocks + i / kErrorBlocks) * blocks + x * kErrorBlocks + i % kErrorBlocks];
      r.error = std::max(r.error, r.blocks[i].error);
    }
    return r;
  }

  Context& c_;
  std::vector<uint16_t> heights_;
  std::vector<float> error_mm_;
  std::vector<DeviationShape> shapes_;
  std::vector<std::vector<BlockError>> errors_;  // by level and block
  std::vector<std::vector<NodeRange>> ranges_;   // by level and node
};

// Many of one page each, mostly without bytes, make a part: what threads tell one another takes longer than they do.
inline size_t reliefPatchesAPart(const PackageHeader& header) { return header.domain.relief_depth == 0 ? 32 : 1; }

class ReliefWriter {
 public:
  ReliefWriter(Context& context, const BuildOptions& options)
      : c_(context), encoder_(options.zstd_level), relief_(context) {}

  Result<void> run(uint32_t patch, BuildPart& out) {
    if (auto read = relief_.read(patch); !read) return read;
    const int depth = c_.header.domain.relief_depth;
    const size_t side = relief_.sideSamples();
    const auto encoding = c_.header.compact ? ReliefEncoding::kHierarchical : ReliefEncoding::kRows;
    const auto of_root = c_.header.light_patches ? ReliefEncoding::kBeyondTail
                         : c_.header.coded_index ? ReliefEncoding::kOverTail
                                                 : encoding;
    const bool again = relief_.isEven() && !encoded_.empty();  // the same page for all nodes of a level
    encoded_.resize(static_cast<size_t>(depth) + 1);
    for (int level = 0; level <= depth; ++level) {
      const uint32_t nodes = 1u << level;
      const size_t step = size_t{1} << (depth - level);
      std::vector<uint8_t>& encoded = encoded_[static_cast<size_t>(level)];
      for (uint32_t y = 0; y < nodes; ++y) {
        for (uint32_t x = 0; x < nodes; ++x) {
          for (size_t j = 0; j < kReliefSamples && !again; ++j) {
            const uint16_t* row = relief_.heights().data() + (y * kPagePx + j) * step * side + x * kPagePx * step;
            for (size_t i = 0; i < kReliefSamples; ++i) samples_[j * kReliefSamples + i] = row[i * step];
          }
          if (level == 0 && !c_.even_patches) {
            tailHeights(samples_, tail_);
            if (auto kept = c_.tails->write(patch * c_.tailBytes(), tail_.data(), sizeof tail_); !kept) return kept;
          }
          if (!again) {
            const auto bytes = encoder_.encodeRelief(samples_, level == 0 ? of_root : encoding);
            encoded.assign(bytes.begin(), bytes.end());
          }
          const NodeId node{patch, static_cast<uint32_t>(level), x, y};
          const auto at = c_.layout.relief.find(node);
          uint64_t detail_offset = 0;
          if (c_.layout.relief_detail.contains(node)) {
            const auto detail = c_.layout.relief_detail.find(node);
            detail_offset = detail.block_offset + detail.node_offset;
          }
          out.place({.index_offset = at.block_offset + at.node_offset,
                     .relief = true,
                     .detail_offset = detail_offset,
                     .range = relief_.range(level, x, y)},
                    encoded);
        }
      }
    }
    return {};
  }

 private:
  Context& c_;
  PageEncoder encoder_;
  PatchRelief relief_;
  std::array<uint16_t, kReliefPageSamples> samples_;
  std::array<uint16_t, kTailHeights> tail_;
  std::vector<std::vector<uint8_t>> encoded_;  // by level, its last page
};

}  // namespace relievo::patch_build
