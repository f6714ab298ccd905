// How a build runs: several times over the patches, which are independent in each pass
// (texturing/package/package_writer.h).
//
//   heights   asks the source for the patch's heights and their errors: the base mesh's section stands before the pages
//   texels    asks the source for the patch's texels; keeps them, of all levels and of the tail, as bytes, and of each
//             level and side the 4 rows of texels that the neighbour's pages have as their border; but for channels
//             that are the same everywhere, of which one texel is kept
//   depths    looks for texture levels that show nothing which coarser ones do not (texture_depths.h). The base mesh's
//             section says which levels there are, and the index, before the pages, has entries for these only
//   relief    asks the source for the patch's heights again and writes its relief pages, which need no other patch
//   texture   writes the texture pages, their borders from the neighbours' strips, turned as the sides lie
//
// Where the border lies diagonally beyond a patch's corner there is one patch only if four meet there. Any number may,
// so what stands there is what makes the mean of the four texels around the corner the same from all patches: that of
// all their corner texels.
//
// So the source is asked for each patch's texels once, and no page waits for a neighbour's.
#include "texturing/package/patch_package_builder.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "src/base/parallel_for.h"
#include "texturing/codec/mip.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/base_code.h"
#include "texturing/package/build_reporter.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_writer.h"
#include "texturing/package/patch_tails.h"
#include "texturing/package/texture_depths.h"

namespace relievo {
namespace {

constexpr int kGutterPx = kPageBorderPx;
constexpr int kBaseZstdLevel = 19;  // a few hundred KiB at most for a scan of some thousand patches

// Where a patch's levels and strips lie in what is kept of it, in bytes. Level kTail is the tail's finest.
constexpr int kTail = -1;
struct PatchStore {
  int channels, depth;
  static uint64_t side(int level) { return level == kTail ? uint64_t{kTailTexels} : uint64_t{kPagePx} << level; }
  uint64_t levelOffset(int level) const {
    uint64_t texels = 0;
    for (int l = kTail; l < level; ++l) texels += side(l) * side(l);
    return texels * static_cast<uint64_t>(channels);
  }
  uint64_t finestBytes() const { return levelBytes() - levelOffset(depth); }
  uint64_t levelBytes() const { return levelOffset(depth + 1); }
  uint64_t gutterBytes(int level) const { return static_cast<uint64_t>(channels) * kGutterPx * side(level); }
  uint64_t gutterOffset(int level, int s) const {
    uint64_t bytes = 0;
    for (int l = kTail; l < level; ++l) bytes += 4 * gutterBytes(l);
    return bytes + static_cast<uint64_t>(s) * gutterBytes(level);
  }
  uint64_t guttersBytes() const { return gutterOffset(depth + 1, 0); }
};

struct Context {
  const PatchSource& source;
  const PackageHeader& header;
  PackageLayout layout;
  MipFilter mip;
  PatchStore store;
  std::vector<PatchNeighbours> neighbours;
  std::unique_ptr<SpillStore> levels, strips, tails;
  // Of each patch, written by whoever works on it.
  std::vector<CoarseErrors> coarse_errors;
  std::vector<CoarseBlocks> coarse_blocks;
  std::vector<CoarseShapes> coarse_shapes;
  std::vector<HeightSlopes> slopes;
  std::vector<std::array<uint64_t, 4>> side_hash;  // of the heights along a side, from the corner of the lower index on
  std::vector<std::array<uint16_t, 4>> corner_height;
  std::vector<uint8_t> corner_texels;  // by patch, level, corner and channel
  std::vector<uint8_t> even;  // 1: the level's channel is its corner's texel everywhere, and not kept otherwise
  TextureDepths texture_depths;
  // The corners of patches that meet at corner c of the mesh: at[first[c]] .. at[first[c + 1]], as patch * 4 + corner.
  std::vector<uint32_t> first, at;

  // A patch's tail: heights, then texels.
  size_t tailBytes() const { return 2 * kTailHeights + static_cast<size_t>(store.channels) * kTailPatchTexels; }
  size_t levelPlace(uint32_t patch, int level) const {
    const auto level_count = static_cast<size_t>(store.depth - kTail + 1);
    return (patch * level_count + static_cast<size_t>(level - kTail)) * static_cast<size_t>(store.channels);
  }
  size_t cornerPlace(uint32_t patch, int level, size_t corner) const {
    return 4 * levelPlace(patch, level) + corner * static_cast<size_t>(store.channels);
  }
  // What was kept of a patch's level at that place, channel after channel.
  Result<void> readKept(const SpillStore& from, uint64_t place, uint32_t patch, int level,
                        std::span<uint8_t> out) const {
    const auto channels = static_cast<size_t>(store.channels);
    const size_t plane = out.size() / channels;
    for (size_t c = 0; c < channels; ++c)
      if (even[levelPlace(patch, level) + c])
        std::memset(out.data() + c * plane, corner_texels[cornerPlace(patch, level, 0) + c], plane);
    return forKept(patch, level, [&](size_t begin, size_t end) {
      return from.read(place + begin * plane, out.data() + begin * plane, (end - begin) * plane);
    });
  }
  // Calls use(begin, end) for runs of a level's channels that are kept.
  template <class Use>
  Result<void> forKept(uint32_t patch, int level, Use&& use) const {
    const uint8_t* is_even = even.data() + levelPlace(patch, level);
    const auto channels = static_cast<size_t>(store.channels);
    for (size_t begin = 0, end = 0; begin < channels; begin = end + 1) {
      for (end = begin; end < channels && !is_even[end];) ++end;
      if (end > begin)
        if (auto used = use(begin, end); !used) return used;
    }
    return {};
  }
};

void listCorners(Context& c) {
  const BaseMesh& base = c.source.base();
  c.first.assign(base.corners.size() + 1, 0);
  c.at.resize(base.patches.size() * 4);
  for (const auto& patch : base.patches)
    for (uint32_t corner : patch) ++c.first[corner + 1];
  for (size_t i = 1; i < c.first.size(); ++i) c.first[i] += c.first[i - 1];
  std::vector<uint32_t> next(c.first.begin(), c.first.end() - 1);
  for (uint32_t i = 0; i < c.at.size(); ++i) c.at[next[base.patches[i / 4][i % 4]]++] = i;
}

Error invalid(uint32_t patch, const std::string& what) {
  return {ErrorKind::kInvalidData, "", "patch " + std::to_string(patch) + ": " + what, "", {}};
}

// ---- what is known of a patch's relief ----
// In a compact package bounds are rounded, away from what they bound, to few values: they take far fewer bytes so, and
// are hardly larger.
constexpr int kMantissaBits = 6, kShareSteps = 15, kShapeSteps = 7;
// The next number away from 0 (up) or towards it that has so many bits behind the point.
float rounded(float v, bool up) {
  constexpr uint32_t kBelow = (1u << (23 - kMantissaBits)) - 1;
  const auto bits = std::bit_cast<uint32_t>(v);
  return std::bit_cast<float>(up ? (bits + kBelow) & ~kBelow : bits & ~kBelow);
}
float roundedUp(float v) { return rounded(v, v > 0); }
float roundedDown(float v) { return rounded(v, v < 0); }
uint8_t roundedShare(uint8_t share, int steps) {
  const int step = (share * steps + 254) / 255;
  return static_cast<uint8_t>((step * 255 + steps - 1) / steps);
}
DeviationShape roundedShape(const DeviationShape& s) {
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
    if (auto known = read(patch); !known) return known;
    noteBorder(patch, sideSamples() - 1);
    noteSlopes(patch, sideSamples() - 1);
    return describeCoarse(patch);
  }
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

// ---- the pass over texels ----
class TexelKeeper {
 public:
  explicit TexelKeeper(Context& context) : c_(context) {}

  Result<void> run(uint32_t patch) {
    const PatchStore& store = c_.store;
    int side = static_cast<int>(PatchStore::side(store.depth));
    texels_.resize(store.finestBytes());
    if (auto made = c_.source.texels(patch, texels_); !made) return made;
    for (int level = store.depth;; --level, side /= 2) {
      if (auto kept = keepLevel(patch, level, texels_); !kept) return kept;
      if (level == 0) return keepTail(patch);
      coarser_.resize(texels_.size() / 4);
      if (level == store.depth) {
        c_.mip.downsample(texels_.data(), side, side, coarser_.data());
      } else {
        c_.mip.downsample(level_.data(), side, side, coarser_.data());
      }
      level_.swap(coarser_);
      texels_.resize(level_.size());
      for (size_t i = 0; i < level_.size(); ++i) texels_[i] = byteFromLevel(level_[i]);
    }
  }

  // The patch's tail once more as its root level has it, in place of one that was rounded.
  Result<void> keepExactTail(uint32_t patch) {
    texels_.resize(static_cast<size_t>(c_.store.channels) * kPagePx * kPagePx);
    const uint64_t place = patch * c_.store.levelBytes() + c_.store.levelOffset(0);
    if (auto read = c_.readKept(*c_.levels, place, patch, 0, texels_); !read) return read;
    return keepTail(patch);
  }
  Result<void> keepRoundedTail(uint32_t patch, std::span<const uint8_t> tail) {
    tail_.assign(tail.begin(), tail.end());
    return keepTailTexels(patch);
  }

 private:
  Result<void> keepLevel(uint32_t patch, int level, std::span<const uint8_t> texels) {
    const PatchStore& store = c_.store;
    const auto channels = static_cast<size_t>(store.channels);
    const size_t plane = texels.size() / channels;
    for (size_t c = 0; c < channels; ++c)
      c_.even[c_.levelPlace(patch, level) + c] = isEven(texels.subspan(c * plane, plane));
    keepCorners(patch, level, texels);
    const uint64_t place = patch * store.levelBytes() + store.levelOffset(level);
    auto kept = c_.forKept(patch, level, [&](size_t begin, size_t end) {
      return c_.levels->write(place + begin * plane, texels.data() + begin * plane, (end - begin) * plane);
    });
    return kept ? keepGutters(patch, level, texels) : kept;
  }

  Result<void> keepTail(uint32_t patch) {
    tail_.resize(c_.tailBytes() - 2 * kTailHeights);
    tailTexels(c_.mip, texels_, tail_);
    return keepTailTexels(patch);
  }
  Result<void> keepTailTexels(uint32_t patch) {
    const uint64_t finest = static_cast<uint64_t>(c_.store.channels) * kTailTexels * kTailTexels;
    if (auto kept = keepLevel(patch, kTail, std::span(tail_).first(finest)); !kept) return kept;
    return c_.tails->write(patch * c_.tailBytes() + 2 * kTailHeights, tail_.data(), tail_.size());
  }

  void keepCorners(uint32_t patch, int level, std::span<const uint8_t> texels) {
    const size_t side = PatchStore::side(level);
    for (size_t k = 0; k < 4; ++k) {
      const size_t x = k % 2 ? side - 1 : 0, y = k / 2 ? side - 1 : 0, place = c_.cornerPlace(patch, level, k);
      for (size_t c = 0; c < static_cast<size_t>(c_.store.channels); ++c)
        c_.corner_texels[place + c] = texels[(c * side + y) * side + x];
    }
  }

  // Channel after channel, the rows (or columns) from the side inwards, each in the direction of growing u or v.
  Result<void> keepGutters(uint32_t patch, int level, std::span<const uint8_t> texels) {
    const int side = static_cast<int>(PatchStore::side(level));
    strip_.resize(c_.store.gutterBytes(level));
    for (int s = 0; s < 4; ++s) {
      uint8_t* out = strip_.data();
      for (int channel = 0; channel < c_.store.channels; ++channel) {
        const uint8_t* in = texels.data() + static_cast<size_t>(channel) * side * side;
        for (int d = 0; d < kGutterPx; ++d, out += side) {
          const int at = s == kLeft || s == kTop ? d : side - 1 - d;
          if (s == kTop || s == kBottom) {
            std::memcpy(out, in + static_cast<size_t>(at) * side, static_cast<size_t>(side));
          } else {
            for (int i = 0; i < side; ++i) out[i] = in[static_cast<size_t>(i) * side + at];
          }
        }
      }
      const uint64_t place = patch * c_.store.guttersBytes() + c_.store.gutterOffset(level, s);
      const size_t plane = strip_.size() / static_cast<size_t>(c_.store.channels);
      auto kept = c_.forKept(patch, level, [&](size_t begin, size_t end) {
        return c_.strips->write(place + begin * plane, strip_.data() + begin * plane, (end - begin) * plane);
      });
      if (!kept) return kept;
    }
    return {};
  }

  Context& c_;
  std::vector<uint8_t> texels_, strip_, tail_;
  std::vector<uint16_t> level_, coarser_;
};

// ---- the pass over relief ----
class ReliefWriter {
 public:
  ReliefWriter(Context& context, const BuildOptions& options)
      : c_(context), encoder_(options.zstd_level), relief_(context) {}

  BuildPart run(uint32_t patch) {
    BuildPart out;
    out.status = write(patch, out);
    return out;
  }

 private:
  Result<void> write(uint32_t patch, BuildPart& out) {
    if (auto read = relief_.read(patch); !read) return read;
    const int depth = c_.header.domain.relief_depth;
    const size_t side = relief_.sideSamples();
    const auto encoding = c_.header.compact ? ReliefEncoding::kHierarchical : ReliefEncoding::kRows;
    for (int level = 0; level <= depth; ++level) {
      const uint32_t nodes = 1u << level;
      const size_t step = size_t{1} << (depth - level);
      for (uint32_t y = 0; y < nodes; ++y) {
        for (uint32_t x = 0; x < nodes; ++x) {
          for (size_t j = 0; j < kReliefSamples; ++j) {
            const uint16_t* row = relief_.heights().data() + (y * kPagePx + j) * step * side + x * kPagePx * step;
            for (size_t i = 0; i < kReliefSamples; ++i) samples_[j * kReliefSamples + i] = row[i * step];
          }
          if (level == 0) {
            std::array<uint16_t, kTailHeights> tail;
            tailHeights(samples_, tail);
            if (auto kept = c_.tails->write(patch * c_.tailBytes(), tail.data(), sizeof tail); !kept) return kept;
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
                    encoder_.encodeRelief(samples_,
                                          level == 0 && c_.header.coded_index ? ReliefEncoding::kOverTail : encoding));
        }
      }
    }
    return {};
  }

  Context& c_;
  PageEncoder encoder_;
  PatchRelief relief_;
  std::array<uint16_t, kReliefPageSamples> samples_;
};

// ---- the passes over what was kept of texels ----
// A level of a patch with its border, as wide as that of pages.
class LevelReader {
 public:
  explicit LevelReader(const Context& context) : c_(context) {}

  size_t stride() const { return side_ + 2 * kPageBorderPx; }
  const std::vector<uint8_t>& texels() const { return bordered_; }  // channel after channel
  BorderedLevel level() const { return {bordered_, side_, kPageBorderPx}; }

  Result<void> load(uint32_t patch, int level) {
    const PatchStore& store = c_.store;
    side_ = PatchStore::side(level);
    const size_t channels = static_cast<size_t>(store.channels), plane = stride() * stride();
    bordered_.resize(channels * plane);
    inside_.resize(channels * side_ * side_);
    if (auto read =
            c_.readKept(*c_.levels, patch * store.levelBytes() + store.levelOffset(level), patch, level, inside_);
        !read)
      return read;
    for (size_t c = 0; c < channels; ++c)
      for (size_t y = 0; y < side_; ++y)
        std::memcpy(bordered_.data() + c * plane + (y + kPageBorderPx) * stride() + kPageBorderPx,
                    inside_.data() + (c * side_ + y) * side_, side_);
    const int begin = kPageBorderPx, end = begin + static_cast<int>(side_), width = static_cast<int>(stride());
    repeatBorder(bordered_.data(), width, width, store.channels, begin, begin, end, end);
    strip_.resize(store.gutterBytes(level));
    for (int s = 0; s < 4; ++s) {
      const PatchNeighbour& n = c_.neighbours[patch][static_cast<size_t>(s)];
      if (n.patch == PatchNeighbour::kNone) continue;
      const uint64_t place = n.patch * store.guttersBytes() + store.gutterOffset(level, n.side);
      if (auto read = c_.readKept(*c_.strips, place, n.patch, level, strip_); !read) return read;
      const bool upright = s == kLeft || s == kRight;
      // Texel i of the nearest row of our side, and of the neighbour's strip.
      auto ownTexel = [&](size_t i) {
        const size_t edge = s == kRight || s == kBottom ? side_ - 1 : 0;
        return upright ? i * side_ + edge : edge * side_ + i;
      };
      auto theirTexel = [&](size_t i) { return n.reversed ? side_ - 1 - i : i; };
      creased_.assign(side_, 0);
      if (hasNormals(c_.header.texture))
        for (size_t i = 0; i < side_; ++i) {
          std::array<uint8_t, 3> own, theirs;
          for (size_t k = 0; k < 3; ++k) {
            own[k] = inside_[(kNormalChannel + k) * side_ * side_ + ownTexel(i)];
            theirs[k] = strip_[(kNormalChannel + k) * kGutterPx * side_ + theirTexel(i)];
          }
          creased_[i] = isCrease(own, theirs);
        }
      const uint8_t* in = strip_.data();
      for (size_t c = 0; c < channels; ++c) {
        for (size_t d = 0; d < kGutterPx; ++d, in += side_) {
          // Texel i along the side, d + 1 texels beyond it.
          const size_t across = s == kLeft || s == kTop ? kPageBorderPx - 1 - d : kPageBorderPx + side_ + d;
          uint8_t* out = bordered_.data() + c * plane +
                         (upright ? kPageBorderPx * stride() + across : across * stride() + kPageBorderPx);
          const size_t step = upright ? stride() : 1;
          for (size_t i = 0; i < side_; ++i)
            out[i * step] =
                creased_[i] && c >= kNormalChannel ? inside_[c * side_ * side_ + ownTexel(i)] : in[theirTexel(i)];
        }
      }
    }
    for (size_t k = 0; k < 4; ++k) fillCorner(patch, level, k);
    return {};
  }

 private:
  // The square of the border beyond corner k.
  void fillCorner(uint32_t patch, int level, size_t k) {
    const uint32_t corner = c_.source.base().patches[patch][k];
    const size_t meet = c_.first[corner + 1] - c_.first[corner];
    const size_t x_in = kPageBorderPx + (k % 2 ? side_ - 1 : 0), y_in = kPageBorderPx + (k / 2 ? side_ - 1 : 0);
    const size_t x_out = k % 2 ? x_in + 1 : x_in - 1, y_out = k / 2 ? y_in + 1 : y_in - 1;
    auto cornerTexels = [&](uint32_t i) {
      return c_.corner_texels.data() + c_.cornerPlace(c_.at[i] / 4, level, c_.at[i] % 4);
    };
    bool crease = false;
    if (hasNormals(c_.header.texture)) {
      std::array<uint8_t, 3> own, theirs;
      for (size_t c = 0; c < 3; ++c) own[c] = bordered_[((kNormalChannel + c) * stride() + y_in) * stride() + x_in];
      for (uint32_t i = c_.first[corner]; i < c_.first[corner + 1]; ++i) {
        std::copy_n(cornerTexels(i) + kNormalChannel, 3, theirs.begin());
        crease |= isCrease(own, theirs);
      }
    }
    for (size_t c = 0; c < static_cast<size_t>(c_.store.channels); ++c) {
      uint8_t* plane = bordered_.data() + c * stride() * stride();
      auto at = [&](size_t x, size_t y) -> uint8_t& { return plane[y * stride() + x]; };
      size_t sum = 0;
      for (uint32_t i = c_.first[corner]; i < c_.first[corner + 1]; ++i) sum += cornerTexels(i)[c];
      const int four_means = static_cast<int>((8 * sum + meet) / (2 * meet));
      const int beyond = crease && c >= kNormalChannel
                             ? at(x_in, y_in)
                             : std::clamp(four_means - at(x_in, y_in) - at(x_out, y_in) - at(x_in, y_out), 0, 255);
      for (size_t j = 0; j < kPageBorderPx; ++j)
        for (size_t i = 0; i < kPageBorderPx; ++i)
          at(k % 2 ? x_out + i : x_out - i, k / 2 ? y_out + j : y_out - j) = static_cast<uint8_t>(beyond);
    }
  }

  const Context& c_;
  size_t side_ = 0;
  std::vector<uint8_t> inside_, bordered_, strip_;
  std::vector<uint8_t> creased_;  // for each texel along a side: 1 where the patches meet at a crease
};

class DepthFinder {
 public:
  DepthFinder(Context& context, double tolerance)
      : c_(context),
        tolerances_(channelTolerances(context.header.texture, tolerance)),
        coarse_(context),
        fine_(context) {}

  // Notes the coarsest level that shows all finer ones within the tolerance.
  Result<void> run(uint32_t patch) {
    int depth = kTail;
    for (; depth < c_.store.depth; ++depth) {
      auto enough = showsAllFiner(patch, depth);
      if (!enough) return enough.error();
      if (*enough) break;
    }
    static_assert(kTail == kNoTexturePage);
    c_.texture_depths[patch] = static_cast<int8_t>(depth);
    return {};
  }

  Result<bool> showsAllFiner(uint32_t patch, int depth) {
    if (auto loaded = coarse_.load(patch, depth); !loaded) return loaded.error();
    for (int finer = depth + 1; finer <= c_.store.depth; ++finer) {
      if (auto loaded = fine_.load(patch, finer); !loaded) return loaded.error();
      if (!showsTheSame(fine_.level(), coarse_.level(), tolerances_)) return false;
    }
    return true;
  }

 private:
  Context& c_;
  const std::vector<ChannelTolerance> tolerances_;  // by channel
  LevelReader coarse_, fine_;
};

class TextureWriter {
 public:
  TextureWriter(const Context& context, const BuildOptions& options)
      : c_(context),
        encoder_(options.zstd_level),
        reader_(context),
        tolerances_(channelTolerances(context.header.texture, options.texture_tolerance)),
        coarse_pages_(context.header.coded_tails && options.texture_tolerance >= 0) {}

  BuildPart run(uint32_t patch) {
    BuildPart out;
    for (int level = 0; level <= c_.header.domain.textureDepthOf(patch) && out.status.ok(); ++level) {
      out.status = reader_.load(patch, level);
      if (out.status.ok()) cut(patch, level, out);
    }
    return out;
  }

 private:
  void cut(uint32_t patch, int level, BuildPart& out) {
    const size_t stride = reader_.stride(), plane_texels = stride * stride;
    const int depth = c_.header.domain.textureDepthOf(patch);
    const int stands_for_finer = depth < c_.store.depth ? depth : -1;
    for (uint32_t y = 0; y < 1u << level; ++y) {
      for (uint32_t x = 0; x < 1u << level; ++x) {
        const auto at = c_.layout.texture.find({patch, static_cast<uint32_t>(level), x, y});
        for (size_t plane = 0; plane < static_cast<size_t>(c_.header.texture.planes()); ++plane) {
          uint8_t* to = page_.data();
          for (size_t c = 3 * plane; c < 3 * plane + 3; ++c) {
            const uint8_t* from = reader_.texels().data() + c * plane_texels + y * kPagePx * stride + x * kPagePx;
            for (int row = 0; row < kPageFullPx; ++row, to += kPageFullPx, from += stride)
              std::memcpy(to, from, kPageFullPx);
          }
          out.place({.index_offset = at.block_offset + at.node_offset + plane * kTextureEntryBytes},
                    encode(plane, level == stands_for_finer));
        }
      }
    }
  }

  // A level that stands for finer ones has used the tolerance for that.
  std::span<const uint8_t> encode(size_t plane, bool exactly) {
    const PageEncoding encoding = c_.header.encodings[plane];
    if (exactly || !coarse_pages_ || encoding.codec != PageCodec::kLossless)
      return encoder_.encodeTexture(page_, encoding);
    return encoder_.encodeTextureWithin(page_, std::span(tolerances_).subspan(3 * plane, 3), c_.header.coded_texels);
  }

  const Context& c_;
  PageEncoder encoder_;
  LevelReader reader_;
  const std::vector<ChannelTolerance> tolerances_;  // by channel
  const bool coarse_pages_;
  std::array<uint8_t, kTexturePageBytes> page_;
};

// ---- around both ----
double meanSideMm(const BaseMesh& base) {
  double sum = 0;
  for (const auto& p : base.patches)
    for (const auto& side : kSideCorners)
      sum += glm::length(glm::dvec3(base.corners[p[static_cast<size_t>(side[0])]].position_mm) -
                         glm::dvec3(base.corners[p[static_cast<size_t>(side[1])]].position_mm));
  return sum / (4.0 * static_cast<double>(base.patches.size()));
}

Result<PatchDomain> planDomain(const PatchSource& source) {
  if (std::string problem = baseMeshProblem(source.base()); !problem.empty()) return usage("the base mesh: " + problem);
  if (source.base().corners.size() > 4 * source.base().patches.size())
    return usage("the base mesh: there are more corners than its patches can name");
  PatchMeasures d;
  d.texture_depth = source.textureDepth();
  d.relief_depth = source.reliefDepth();
  const int deepest = static_cast<int>(kMaxNodeLevel);
  if (d.texture_depth < 0 || d.texture_depth > deepest || d.relief_depth < 0)
    return usage("the patches' depth is out of range");
  d.mm_per_px = std::max(meanSideMm(source.base()) / static_cast<double>(d.patchPx()), 1e-12);
  d.relief_offset_mm = source.reliefOffsetMm();
  d.relief_scale_mm = source.reliefScaleMm();
  const auto domain = PatchDomain::overMesh(static_cast<uint32_t>(source.base().patches.size()), d);
  if (std::string problem = domainProblem(domain); !problem.empty()) return usage("cannot build this: " + problem);
  if (!std::isfinite(source.errorUnitMm()) || source.errorUnitMm() < 0)
    return usage("the unit of errors is not a number of mm");
  return domain;
}

Result<std::string> manifestOf(const PackageHeader& h, const PatchSource& source, const BuildOptions& options) {
  nlohmann::ordered_json json = manifestJson(h, options.tool_version);
  const BaseMesh& base = source.base();
  json["base"] = {{"corners", base.corners.size()},
                  {"patches", base.patches.size()},
                  {"origin_mm", {base.origin_mm.x, base.origin_mm.y, base.origin_mm.z}},
                  {"error_unit_mm", source.errorUnitMm()}};
  auto extra =
      nlohmann::ordered_json::parse(options.manifest_extra.empty() ? "{}" : options.manifest_extra, nullptr, false);
  if (extra.is_object()) json.update(extra);
  const char* role = "mesh";
  for (const Provenance& p : source.provenance()) {
    if (auto added = addSource(json, p, role); !added) return added.error();
    role = "texture";
  }
  return manifestText(json);
}

Result<void> writeTails(const Context& c, const BuildOptions& options, PackageWriter& writer) {
  const auto patches = static_cast<uint32_t>(c.source.base().patches.size());
  std::vector<uint8_t> bytes(c.tailBytes());
  for (uint32_t first = 0; first < patches; first += kTailsChunkPatches) {
    const uint32_t count = std::min(kTailsChunkPatches, patches - first);
    PatchTails tails(count, c.store.channels);
    for (uint32_t i = 0; i < count; ++i) {
      if (auto read = c.tails->read((first + i) * c.tailBytes(), bytes.data(), bytes.size()); !read) return read;
      std::memcpy(tails.heightsOf(i).data(), bytes.data(), 2 * kTailHeights);
      std::copy(bytes.begin() + 2 * kTailHeights, bytes.end(), tails.texelsOf(i).begin());
    }
    const auto storage = c.header.coded_tails ? TailsStorage::kCoded : TailsStorage::kZstd;
    if (auto written = writer.appendTails(encodeTailsChunk(tails, 0, count, storage, options.zstd_level)); !written)
      return written;
  }
  return {};
}

// Calls run(worker, patch) for each patch; each thread's worker is what makeWorker() gives. Calls between(patches taken
// so far) on the caller's thread.
template <class MakeWorker, class Run, class Between>
Result<void> forEachPatch(const Context& context, const BuildOptions& options, int workers, MakeWorker&& makeWorker,
                          Run&& run, Between&& between) {
  constexpr size_t kPatchesAJob = 16;
  const size_t patches = context.header.domain.patchCount();
  std::vector<std::optional<Error>> failed((patches + kPatchesAJob - 1) / kPatchesAJob);
  const bool whole = parallelForWith(
      failed.size(), workers, options.interrupted, makeWorker,
      [&](auto& worker, size_t job) {
        for (size_t p = job * kPatchesAJob; p < std::min(patches, (job + 1) * kPatchesAJob) && !failed[job]; ++p)
          if (auto done = run(worker, static_cast<uint32_t>(p)); !done) failed[job] = done.error();
      },
      [&](size_t jobs) { between(std::min(patches, jobs * kPatchesAJob)); });
  for (const std::optional<Error>& error : failed)
    if (error) return *error;
  if (!whole) return Error{ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}};
  return {};
}

// Samples on shared sides and corners are the same from all sides, or the surface has a crack.
Result<void> checkBorders(const Context& c) {
  const BaseMesh& base = c.source.base();
  auto differ = [](uint32_t a, uint32_t b, const std::string& where) {
    return Error{ErrorKind::kInvalidData,
                 "",
                 "the heights of patches " + std::to_string(a) + " and " + std::to_string(b) + " differ " + where,
                 "",
                 {}};
  };
  std::vector<uint32_t> first(base.corners.size(), PatchNeighbour::kNone);
  std::vector<uint16_t> height(base.corners.size());
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    for (size_t s = 0; s < 4; ++s) {
      const PatchNeighbour& n = c.neighbours[p][s];
      if (n.patch != PatchNeighbour::kNone && c.side_hash[p][s] != c.side_hash[n.patch][n.side])
        return differ(p, n.patch, "along the side that they share");
    }
    for (size_t k = 0; k < 4; ++k) {
      const uint32_t corner = base.patches[p][k];
      if (first[corner] == PatchNeighbour::kNone) first[corner] = p, height[corner] = c.corner_height[p][k];
      if (height[corner] != c.corner_height[p][k])
        return differ(first[corner], p, "at corner " + std::to_string(corner));
    }
  }
  return {};
}

void makeRoom(Context& context) {
  const PatchDomain& d = context.header.domain;
  const uint32_t patches = d.patchCount();
  context.coarse_errors.resize(patches);
  context.slopes.resize(patches);
  context.coarse_blocks.resize(patches);
  context.coarse_shapes.resize(patches);
  context.side_hash.resize(patches);
  context.corner_height.resize(patches);
  context.corner_texels.resize(context.cornerPlace(patches, kTail, 0));
  context.even.resize(context.levelPlace(patches, kTail));
  context.texture_depths.resize(patches);
}

// A worker's share: texels and a coarser level twice, or a level with and without border; heights, errors, and its
// finished parts.
uint64_t workerBytes(const Context& context) {
  const PatchStore& store = context.store;
  const uint64_t cells = uint64_t{kPagePx} << context.header.domain.relief_depth;
  const uint64_t part_bytes = store.levelBytes() + cells * cells * 3;
  return store.levelBytes() * 2 + cells * cells * 3 + part_bytes * (1 + kPartsAhead);
}

Result<PackageHeader> planHeader(const PatchSource& source, const BuildOptions& options) {
  auto planned = planDomain(source);
  if (!planned) return planned.error();
  PackageHeader header;
  header.domain = *planned;
  header.texture = source.format();
  header.encodings = planeEncodings(header.texture, options.coefficients, options.colour);
  header.relief_detail = header.relief_shapes = true;
  header.compact = options.compact;
  header.coded_tails = options.compact && options.coded_tails;
  header.coded_base = header.coded_tails && options.coded_base;
  header.coded_texels = header.coded_base && options.coded_texels;
  header.page_count = packageLayout(header.domain, header.texture, 0, 0).page_count;
  header.base_bytes = baseSectionBytes(source.base().corners.size(), header.domain.patchCount());
  return header;
}

// What waits for its neighbours.
Result<void> makeSpills(Context& context, SpillBudget& spills) {
  const uint64_t patches = context.header.domain.patchCount();
  for (auto [kept, bytes] : {std::pair<std::unique_ptr<SpillStore>*, uint64_t>{&context.tails, context.tailBytes()},
                             {&context.strips, context.store.guttersBytes()},
                             {&context.levels, context.store.levelBytes()}}) {
    auto made = spills.create(bytes * patches);
    if (!made) return made.error();
    *kept = std::move(*made);
  }
  return {};
}

// Texels of tails that take fewer bytes, within the tolerance. Where a tail stands for all levels, these are within the
// tolerance of it, as before: what leads beyond is taken back, around the patch as well, as its border shows those
// texels.
class TailRounding {
 public:
  TailRounding(Context& context, const BuildOptions& options, int workers)
      : c_(context),
        options_(options),
        workers_(workers),
        rounded_(context.header.domain.patchCount(), 1),
        tolerances_(channelTolerances(context.header.texture, options.texture_tolerance)) {}

  Result<void> run() {
    if (auto done = roundAll(); !done) return done;
    std::vector<uint8_t> changed(rounded_.size(), 1);
    // What is taken back stays so: this ends.
    for (;;) {
      std::vector<uint8_t> beyond(rounded_.size(), 0);
      auto found = forEachPatch(
          c_, options_, workers_, [&] { return DepthFinder(c_, options_.texture_tolerance); },
          [&](DepthFinder& finder, uint32_t patch) -> Result<void> {
            if (!standsForAll(patch) || !anyAround(patch, changed) || !anyAround(patch, rounded_)) return {};
            auto shows = finder.showsAllFiner(patch, kTail);
            if (!shows) return shows.error();
            beyond[patch] = !*shows;
            return {};
          },
          [](size_t) {});
      if (!found || std::find(beyond.begin(), beyond.end(), 1) == beyond.end()) return found;
      if (auto done = takeBack(beyond, changed); !done) return done;
    }
  }

 private:
  bool standsForAll(uint32_t patch) const { return c_.texture_depths[patch] == kTail; }
  // Calls f(patch) for those that share a corner with the patch, and for itself.
  template <class F>
  void around(uint32_t patch, F&& f) const {
    for (const uint32_t corner : c_.source.base().patches[patch])
      for (uint32_t i = c_.first[corner]; i < c_.first[corner + 1]; ++i) f(c_.at[i] / 4);
  }
  bool anyAround(uint32_t patch, const std::vector<uint8_t>& of_patches) const {
    bool any = false;
    around(patch, [&](uint32_t p) { any |= of_patches[p] != 0; });
    return any;
  }

  Result<void> roundAll() {
    const size_t patches = rounded_.size(), chunks = tailsChunks(static_cast<uint32_t>(patches));
    std::vector<Result<void>> done(chunks);
    const bool whole = parallelFor(chunks, workers_, options_.interrupted, [&](size_t chunk) {
      const size_t first = chunk * kTailsChunkPatches, count = std::min<size_t>(kTailsChunkPatches, patches - first);
      done[chunk] = roundChunk(static_cast<uint32_t>(first), static_cast<uint32_t>(count));
    });
    for (const Result<void>& result : done)
      if (!result) return result;
    if (!whole) return Error{ErrorKind::kInterrupted, options_.output, "interrupted", "nothing was written", {}};
    return {};
  }
  Result<void> roundChunk(uint32_t first, uint32_t count) {
    PatchTails tails(count, c_.store.channels);
    for (uint32_t i = 0; i < count; ++i) {
      const auto texels = tails.texelsOf(i);
      const uint64_t place = (first + i) * c_.tailBytes() + 2 * kTailHeights;
      if (auto read = c_.tails->read(place, texels.data(), texels.size()); !read) return read;
    }
    for (int plane = 0; plane < c_.store.channels / 3; ++plane) {
      const ChannelTolerance& tolerance = tolerances_[static_cast<size_t>(3 * plane)];
      // Errors that are spread evenly up to this have that root mean square.
      const double most = std::min(std::floor(std::sqrt(3.0) * tolerance.rms), tolerance.most);
      roundTailTexels(tails.texels, c_.store.channels, plane, static_cast<int>(std::min(most, 127.0)), tolerance.rms);
    }
    TexelKeeper keeper(c_);
    for (uint32_t i = 0; i < count; ++i)
      if (auto kept = keeper.keepRoundedTail(first + i, tails.texelsOf(i)); !kept) return kept;
    return {};
  }

  // changed: the patches whose tails are no longer rounded.
  Result<void> takeBack(const std::vector<uint8_t>& beyond, std::vector<uint8_t>& changed) {
    TexelKeeper keeper(c_);
    changed.assign(beyond.size(), 0);
    for (uint32_t patch = 0; patch < beyond.size(); ++patch) {
      Result<void> done;
      if (beyond[patch])
        around(patch, [&](uint32_t p) {
          if (!done || !std::exchange(rounded_[p], uint8_t{0})) return;
          changed[p] = 1;
          done = keeper.keepExactTail(p);
        });
      if (!done) return done;
    }
    return {};
  }

  Context& c_;
  const BuildOptions& options_;
  const int workers_;
  std::vector<uint8_t> rounded_;                    // by patch
  const std::vector<ChannelTolerance> tolerances_;  // by channel
};

// Into the header, unless all patches have all levels.
Result<void> findTextureDepths(Context& context, PackageHeader& header, const BuildOptions& options, int workers) {
  const double tolerance = options.texture_tolerance;
  if (header.compact && tolerance >= 0) {
    auto found = forEachPatch(
        context, options, workers, [&] { return DepthFinder(context, tolerance); },
        [](DepthFinder& finder, uint32_t patch) { return finder.run(patch); }, [](size_t) {});
    if (!found) return found;
    if (header.coded_tails && options.rounded_tails)
      if (auto rounded = TailRounding(context, options, workers).run(); !rounded) return rounded;
    const auto less = [&](int8_t depth) { return depth < header.domain.texture_depth; };
    header.texture_depths = std::any_of(context.texture_depths.begin(), context.texture_depths.end(), less);
  }
  if (header.texture_depths) {
    header.domain.setTextureDepths(std::make_shared<const TextureDepths>(context.texture_depths));
    header.page_count = packageLayout(header.domain, header.texture, 0, 0).page_count;
  } else {
    context.texture_depths.clear();
  }
  return {};
}

// Each patch once, by workers of this kind.
template <class PatchWorker>
Result<void> passOver(Context& context, const BuildOptions& options, int workers, PackageWriter& writer,
                      BuildReporter& reporter) {
  const uint32_t patches = context.header.domain.patchCount();
  uint32_t next = 0;
  OrderedWorkers<uint32_t> runner(
      workers, kPartsAhead, options.interrupted,
      [&](uint32_t* patch) {
        if (next == patches) return false;
        *patch = next++;
        return true;
      },
      [&] {
        auto worker = std::make_shared<PatchWorker>(context, options);
        return [worker](const uint32_t& patch) { return worker->run(patch); };
      });
  return writeParts(runner, patches, writer, options, [&](const BuildPart* part) { reporter.report(part); });
}

}  // namespace

Result<BuildReport> buildPatchPackage(const PatchSource& source, const BuildOptions& options) {
  BuildReporter reporter(options);
  auto planned = planHeader(source, options);
  if (!planned) return planned.error();
  PackageHeader& header = *planned;
  const PatchDomain& d = header.domain;
  const uint32_t patches = d.patchCount();
  reporter.expect(header.page_count, patches * d.patchPx() * d.patchPx());

  Context context{source,
                  header,
                  {},
                  MipFilter(header.texture),
                  {header.texture.channels(), d.texture_depth},
                  patchNeighbours(source.base())};
  makeRoom(context);
  listCorners(context);
  const Workforce force = workersThatFit(workerBytes(context), options, patches);
  auto described = forEachPatch(
      context, options, force.workers, [&] { return PatchRelief(context); },
      [](PatchRelief& relief, uint32_t patch) { return relief.describe(patch); }, [](size_t) {});
  if (!described) return described.error();
  if (auto sound = checkBorders(context); !sound) return sound.error();
  // Before the longest part, not behind it.
  if (auto writable = OutputFile::check(options.output); !writable) return writable.error();
  SpillBudget spills{std::min(force.left_bytes, options.kept_bytes), options.output};
  if (auto made = makeSpills(context, spills); !made) return made.error();
  const uint64_t patch_texels = d.patchPx() * d.patchPx();
  auto kept = forEachPatch(
      context, options, force.workers, [&] { return TexelKeeper(context); },
      [](TexelKeeper& keeper, uint32_t patch) { return keeper.run(patch); },
      [&](size_t done) { reporter.reportTexels(done * patch_texels); });
  if (!kept) return kept.error();
  if (auto found = findTextureDepths(context, header, options, force.workers); !found) return found.error();
  header.coded_index = header.coded_texels && options.coded_index && header.page_count <= kMostCodedPages;
  reporter.expect(header.page_count, patches * patch_texels);

  std::vector<uint8_t> base = encodeBaseSection(
      {source.base(), std::move(context.coarse_errors), std::move(context.coarse_blocks), std::move(context.slopes),
       std::move(context.coarse_shapes), source.errorUnitMm(), std::move(context.texture_depths)});
  if (header.coded_base) base = encodeBaseCode(base, source.baseStepMm());
  else if (header.compact) base = packBaseSection(base, kBaseZstdLevel);
  const auto manifest = manifestOf(header, source, options);
  if (!manifest) return manifest.error();
  if (auto placed = placeSections(header, *manifest, base); !placed) return placed.error();
  context.layout = packageLayout(header);
  auto writer = PackageWriter::create(options.output, header, *manifest, std::move(base), spills);
  if (!writer) return writer.error();

  if (auto ran = passOver<ReliefWriter>(context, options, force.workers, **writer, reporter); !ran) return ran.error();
  if (auto ran = passOver<TextureWriter>(context, options, force.workers, **writer, reporter); !ran) return ran.error();

  if (auto written = writeTails(context, options, **writer); !written) return written.error();
  auto file_bytes = (*writer)->finish(options.interrupted);
  if (!file_bytes) return file_bytes.error();
  reporter.reportEnd();
  return BuildReport{header.page_count, *file_bytes, reporter.seconds()};
}

}  // namespace relievo
