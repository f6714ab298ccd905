// patch_texels.h - a patch's texels as a package has them: kept level by level until their neighbours are known, the
// levels that are left out, rounded tails, and pages. Internal to texturing/.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "texturing/codec/page_codec.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/patch_build.h"
#include "texturing/package/texture_depths.h"

namespace relievo::patch_build {

// A channel's texels, rows of `width`, of which `before` lie before the first of `height`.
struct TexelRows {
  const uint8_t* texels;
  size_t width, height, before = 0;
};
// The first `rows` of 2^log2 times as many texels a side, by a bilinear filter; beyond what there is lies its border.
inline void enlarge(const TexelRows& in, int log2, size_t rows, uint8_t* out) {
  const uint32_t whole = uint32_t{2} << log2;
  struct Place {
    size_t low, high;
    uint32_t to_high;  // of `whole`
  };
  auto placeOf = [&](size_t i, size_t count, size_t before) {
    const int64_t halves = 2 * static_cast<int64_t>(i) + 1 - (int64_t{1} << log2);  // of a fine texel
    const int64_t low = (halves >> (log2 + 1)) + static_cast<int64_t>(before), last = static_cast<int64_t>(count) - 1;
    return Place{static_cast<size_t>(std::clamp<int64_t>(low, 0, last)),
                 static_cast<size_t>(std::clamp<int64_t>(low + 1, 0, last)),
                 static_cast<uint32_t>(halves & (int64_t{whole} - 1))};
  };
  const size_t width = in.width << log2;
  for (size_t y = 0; y < rows; ++y) {
    const Place v = placeOf(y, in.before + in.height, in.before);
    const uint8_t *above = in.texels + v.low * in.width, *below = in.texels + v.high * in.width;
    for (size_t x = 0; x < width; ++x) {
      const Place u = placeOf(x, in.width, 0);
      const uint32_t top = above[u.low] * (whole - u.to_high) + above[u.high] * u.to_high,
                     bottom = below[u.low] * (whole - u.to_high) + below[u.high] * u.to_high;
      out[y * width + x] =
          static_cast<uint8_t>((top * (whole - v.to_high) + bottom * v.to_high + whole * whole / 2) / (whole * whole));
    }
  }
}

// By how much a level is larger than a coarser one.
inline int enlargedLog2(int coarse, int fine) {
  return std::countr_zero(PatchStore::side(fine)) - std::countr_zero(PatchStore::side(coarse));
}

class TexelKeeper {
 public:
  explicit TexelKeeper(Context& context) : c_(context) {}

  Result<void> run(uint32_t patch) {
    const PatchStore store = c_.storeOf(patch);
    int side = static_cast<int>(PatchStore::side(store.depth));
    if (c_.tailIsMade(patch)) {
      tail_.resize(c_.tailBytes() - 2 * kTailHeights);
      tailOfImages(c_.image_of_patch[patch], c_.imagesOf(patch), c_.mip, tail_, c_.normalsOf(patch));
      return keepTailTexels(patch);
    }
    if (auto made = finest(patch); !made) return made;
    if (store.depth == kTail) return keepTail(patch);
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
    if (c_.own_depth[patch] == kTail) return run(patch);
    texels_.resize(static_cast<size_t>(c_.store.channels) * kPagePx * kPagePx);
    if (auto read = c_.readKept(*c_.levels, c_.levelAt(patch, 0), patch, 0, texels_); !read) return read;
    return keepTail(patch);
  }
  Result<void> keepRoundedTail(uint32_t patch, std::span<const uint8_t> tail) {
    tail_.assign(tail.begin(), tail.end());
    return keepTailTexels(patch);
  }

 private:
  // The patch's texels at its own depth, or the level that is kept if that is finer.
  Result<void> finest(uint32_t patch) {
    const int depth = c_.source.textureDepthOf(patch);
    texels_.resize(PatchStore{c_.store.channels, depth}.finestBytes());
    if (c_.showsImage(patch)) {
      // Its tail is made of its root page, as others' are.
      texels_.resize(static_cast<size_t>(c_.store.channels) * kPagePx * kPagePx);
      const PatchImage& shown = c_.image_of_patch[patch];
      const ShownTexels which{kPageCellsLog2, 0, 0, size_t{kPagePx}};
      showImages(shown, c_.imagesOf(patch), which, texels_);
      showNormals(shown, which, std::span(texels_).subspan(texels_.size() / 2), c_.normalsOf(patch));
      return {};
    }
    if (auto made = c_.source.texels(patch, texels_); !made) return made;
    for (int level = depth; level < c_.own_depth[patch]; ++level) {
      coarse_texels_.swap(texels_);
      const size_t side = PatchStore::side(level), larger = PatchStore::side(level + 1);
      texels_.resize(static_cast<size_t>(c_.store.channels) * larger * larger);
      for (size_t c = 0; c < static_cast<size_t>(c_.store.channels); ++c)
        enlarge({coarse_texels_.data() + c * side * side, side, side}, enlargedLog2(level, level + 1), larger,
                texels_.data() + c * larger * larger);
    }
    return {};
  }

  Result<void> keepLevel(uint32_t patch, int level, std::span<const uint8_t> texels) {
    const auto channels = static_cast<size_t>(c_.store.channels);
    const size_t plane = texels.size() / channels;
    for (size_t c = 0; c < channels; ++c)
      c_.even[c_.levelPlace(patch, level) + c] = isEven(texels.subspan(c * plane, plane));
    keepCorners(patch, level, texels);
    if (level == kTail && !c_.tailIsRead(patch)) return {};
    const uint64_t place = c_.levelAt(patch, level);
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
    if (c_.tailIsMade(patch)) return {};
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
      const uint64_t place = c_.stripAt(patch, level, s);
      const size_t plane = strip_.size() / static_cast<size_t>(c_.store.channels);
      auto kept = c_.forKept(patch, level, [&](size_t begin, size_t end) {
        return c_.strips->write(place + begin * plane, strip_.data() + begin * plane, (end - begin) * plane);
      });
      if (!kept) return kept;
    }
    return {};
  }

  Context& c_;
  std::vector<uint8_t> texels_, coarse_texels_, strip_, tail_;
  std::vector<uint16_t> level_, coarser_;
};

inline GutterEnds gutterEnds(const PackageHeader& header, int level) {
  const bool normals = hasNormals(header.texture);
  return {.colours = header.tail_edges && level == kTail, .normals = normals};
}

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
    if (auto read = c_.readKept(*c_.levels, c_.levelAt(patch, level), patch, level, inside_); !read) return read;
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
      if (auto read = readStrip(patch, s, n, level); !read) return read;
      const bool upright = s == kLeft || s == kRight;
      // Texel i of the nearest row of our side, and of the neighbour's strip.
      auto ownTexel = [&](size_t i) {
        const size_t edge = s == kRight || s == kBottom ? side_ - 1 : 0;
        return upright ? i * side_ + edge : edge * side_ + i;
      };
      auto theirTexel = [&](size_t i) { return n.reversed ? side_ - 1 - i : i; };
      const GutterEnds ends = gutterEnds(c_.header, level);
      auto three = [](const std::vector<uint8_t>& texels, size_t first, size_t plane_texels, size_t at) {
        std::array<uint8_t, 3> out;
        for (size_t k = 0; k < 3; ++k) out[k] = texels[(first + k) * plane_texels + at];
        return out;
      };
      const uint8_t* in = strip_.data();
      // Of a patch that shows an image there are no such texels as ours but in the tail: our own colours go on.
      const size_t first = c_.showsPages(n.patch) && level != kTail ? kNormalChannel : 0;
      in += first * kGutterPx * side_;
      for (size_t c = first; c < channels; ++c) {
        if (c % 3 == 0) {
          ended_.assign(side_, 0);
          for (size_t i = 0; ends.anyOf(c) && i < side_; ++i)
            ended_[i] = ends.between(c, three(inside_, c, side_ * side_, ownTexel(i)),
                                     three(strip_, c, kGutterPx * side_, theirTexel(i)));
        }
        for (size_t d = 0; d < kGutterPx; ++d, in += side_) {
          // Texel i along the side, d + 1 texels beyond it.
          const size_t across = s == kLeft || s == kTop ? kPageBorderPx - 1 - d : kPageBorderPx + side_ + d;
          uint8_t* out = bordered_.data() + c * plane +
                         (upright ? kPageBorderPx * stride() + across : across * stride() + kPageBorderPx);
          const size_t step = upright ? stride() : 1;
          for (size_t i = 0; i < side_; ++i)
            out[i * step] = ended_[i] ? inside_[c * side_ * side_ + ownTexel(i)] : in[theirTexel(i)];
        }
      }
    }
    for (size_t k = 0; k < 4; ++k) fillCorner(patch, level, k);
    return {};
  }

 private:
  // The neighbour's rows along side s; where it has no level that fine, what its finest shows there, which reaches over
  // to our texels of that level.
  Result<void> readStrip(uint32_t patch, int s, const PatchNeighbour& n, int level) {
    const int kept = c_.keptLevel(n.patch, level);
    strip_.resize(c_.store.gutterBytes(level));
    if (kept == level) return c_.readKept(*c_.strips, c_.stripAt(n.patch, level, n.side), n.patch, level, strip_);
    const size_t side = PatchStore::side(kept), rows = 1 + kGutterPx;
    for (auto* strip : {&own_strip_, &coarse_strip_}) strip->resize(c_.store.gutterBytes(kept));
    if (auto read = c_.readKept(*c_.strips, c_.stripAt(patch, kept, s), patch, kept, own_strip_); !read) return read;
    if (auto read = c_.readKept(*c_.strips, c_.stripAt(n.patch, kept, n.side), n.patch, kept, coarse_strip_); !read)
      return read;
    coarse_rows_.resize(rows * side);
    for (size_t c = 0; c < static_cast<size_t>(c_.store.channels); ++c) {
      const uint8_t* own = own_strip_.data() + c * kGutterPx * side;
      if (n.reversed) std::reverse_copy(own, own + side, coarse_rows_.begin());
      else std::copy_n(own, side, coarse_rows_.begin());
      std::copy_n(coarse_strip_.data() + c * kGutterPx * side, kGutterPx * side,
                  coarse_rows_.begin() + static_cast<std::ptrdiff_t>(side));
      enlarge({coarse_rows_.data(), side, kGutterPx, 1}, enlargedLog2(kept, level), kGutterPx,
              strip_.data() + c * kGutterPx * side_);
    }
    return {};
  }

  // The square of the border beyond corner k.
  void fillCorner(uint32_t patch, int level, size_t k) {
    const uint32_t corner = c_.source.base().patches[patch][k];
    const size_t meet = c_.first[corner + 1] - c_.first[corner];
    const size_t x_in = kPageBorderPx + (k % 2 ? side_ - 1 : 0), y_in = kPageBorderPx + (k / 2 ? side_ - 1 : 0);
    const size_t x_out = k % 2 ? x_in + 1 : x_in - 1, y_out = k / 2 ? y_in + 1 : y_in - 1;
    auto cornerTexels = [&](uint32_t i) {
      const uint32_t of_patch = c_.at[i] / 4;
      return c_.corner_texels.data() + c_.cornerPlace(of_patch, c_.keptLevel(of_patch, level), c_.at[i] % 4);
    };
    const GutterEnds ends = gutterEnds(c_.header, level);
    bool ended = false;  // three channels end alike
    for (size_t c = 0; c < static_cast<size_t>(c_.store.channels); ++c) {
      if (c % 3 == 0) {
        ended = false;
        std::array<uint8_t, 3> own, theirs;
        for (size_t i = 0; i < 3; ++i) own[i] = bordered_[((c + i) * stride() + y_in) * stride() + x_in];
        for (uint32_t i = c_.first[corner]; ends.anyOf(c) && i < c_.first[corner + 1]; ++i) {
          std::copy_n(cornerTexels(i) + c, 3, theirs.begin());
          ended = ended || ends.between(c, own, theirs);
        }
      }
      uint8_t* plane = bordered_.data() + c * stride() * stride();
      auto at = [&](size_t x, size_t y) -> uint8_t& { return plane[y * stride() + x]; };
      size_t sum = 0;
      for (uint32_t i = c_.first[corner]; i < c_.first[corner + 1]; ++i) sum += cornerTexels(i)[c];
      const int four_means = static_cast<int>((8 * sum + meet) / (2 * meet));
      const int beyond =
          ended ? at(x_in, y_in) : std::clamp(four_means - at(x_in, y_in) - at(x_out, y_in) - at(x_in, y_out), 0, 255);
      for (size_t j = 0; j < kPageBorderPx; ++j)
        for (size_t i = 0; i < kPageBorderPx; ++i)
          at(k % 2 ? x_out + i : x_out - i, k / 2 ? y_out + j : y_out - j) = static_cast<uint8_t>(beyond);
    }
  }

  const Context& c_;
  size_t side_ = 0;
  std::vector<uint8_t> inside_, bordered_, strip_, own_strip_, coarse_strip_, coarse_rows_;
  std::vector<uint8_t> ended_;  // for each texel along a side: 1 where three channels end
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
    for (; depth < c_.own_depth[patch]; ++depth) {
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
    for (int finer = depth + 1; finer <= c_.own_depth[patch]; ++finer) {
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

  Result<void> run(uint32_t patch, BuildPart& out) {
    for (int level = 0; level <= c_.header.domain.textureDepthOf(patch); ++level) {
      if (auto loaded = reader_.load(patch, level); !loaded) return loaded;
      cut(patch, level, out);
    }
    return {};
  }

 private:
  void cut(uint32_t patch, int level, BuildPart& out) {
    const size_t stride = reader_.stride(), plane_texels = stride * stride;
    const int depth = c_.header.domain.textureDepthOf(patch);
    const int stands_for_finer = depth < c_.own_depth[patch] ? depth : -1;
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

// Texels of tails that take fewer bytes, within the tolerance. Where a tail stands for all levels, these are within the
// tolerance of it, as before: where rounding leads beyond, the patch is rounded less, then those around it, as its
// border shows their texels, in the end not at all.
class TailRounding {
 public:
  TailRounding(Context& context, const BuildOptions& options, int workers)
      : c_(context),
        options_(options),
        workers_(workers),
        tolerances_(channelTolerances(context.header.texture, options.texture_tolerance)),
        grades_(context.header.light_patches ? std::vector<double>{0, 1.0 / 3, 2.0 / 3, 1} : std::vector<double>{0, 1}),
        grade_(context.header.domain.patchCount(), static_cast<uint8_t>(grades_.size() - 1)) {
    for (uint32_t patch = 0; patch < grade_.size(); ++patch)
      if (context.tailIsMade(patch)) grade_[patch] = 0;
  }

  Result<void> run() {
    if (auto done = roundAll(); !done) return done;
    std::vector<uint8_t> changed(grade_.size(), 1);
    // Grades only sink: this ends.
    for (;;) {
      std::vector<uint8_t> beyond(grade_.size(), 0);
      auto found = forEachPatch(
          c_, options_, workers_, [&] { return DepthFinder(c_, options_.texture_tolerance); },
          [&](DepthFinder& finder, uint32_t patch) -> Result<void> {
            if (!standsForAll(patch) || c_.own_depth[patch] == kTail) return {};
            if (!anyAround(patch, changed) || !anyAround(patch, grade_)) return {};
            auto shows = finder.showsAllFiner(patch, kTail);
            if (!shows) return shows.error();
            beyond[patch] = !*shows;
            return {};
          },
          [](size_t) {});
      if (!found || std::find(beyond.begin(), beyond.end(), 1) == beyond.end()) return found;
      changed = roundedLess(beyond);
      auto rounded = forEachPatch(
          c_, options_, workers_, [&] { return TexelKeeper(c_); },
          [&](TexelKeeper& keeper, uint32_t patch) {
            return changed[patch] ? roundAnew(keeper, patch) : Result<void>{};
          },
          [](size_t) {});
      if (!rounded) return rounded;
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
    const size_t patches = grade_.size(), chunks = tailsChunks(static_cast<uint32_t>(patches));
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
    std::vector<uint32_t> stored;
    for (uint32_t patch = first; patch < first + count; ++patch)
      if (!c_.tailIsMade(patch)) stored.push_back(patch);
    PatchTails tails(static_cast<uint32_t>(stored.size()), c_.store.channels);
    for (uint32_t i = 0; i < stored.size(); ++i)
      if (auto read = readTail(stored[i], tails.texelsOf(i)); !read) return read;
    round(tails.texels, grades_.back());
    TexelKeeper keeper(c_);
    for (uint32_t i = 0; i < stored.size(); ++i)
      if (auto kept = keeper.keepRoundedTail(stored[i], tails.texelsOf(i)); !kept) return kept;
    return {};
  }
  Result<void> readTail(uint32_t patch, std::span<uint8_t> texels) const {
    return c_.tails->read(patch * c_.tailBytes() + 2 * kTailHeights, texels.data(), texels.size());
  }
  void round(std::span<uint8_t> texels, double grade) const {
    const bool grids = c_.header.light_patches;
    for (int plane = 0; plane < c_.store.channels / 3; ++plane) {
      const ChannelTolerance& tolerance = tolerances_[static_cast<size_t>(3 * plane)];
      // Of rows, errors that are spread evenly up to this have that root mean square.
      const double most = std::min(std::floor((grids ? 3 : std::sqrt(3.0)) * grade * tolerance.rms), tolerance.most);
      roundTailTexels(texels, c_.store.channels, plane,
                      {grids, static_cast<int>(std::min(most, 127.0)), grade * tolerance.rms});
    }
  }

  // Which grades sank.
  std::vector<uint8_t> roundedLess(const std::vector<uint8_t>& beyond) {
    std::vector<uint8_t> sinks(beyond.size(), 0);
    for (uint32_t patch = 0; patch < beyond.size(); ++patch) {
      if (!beyond[patch]) continue;
      if (grade_[patch] > 0) sinks[patch] = 1;
      else around(patch, [&](uint32_t p) { sinks[p] = grade_[p] > 0; });
    }
    for (size_t patch = 0; patch < sinks.size(); ++patch)
      grade_[patch] = static_cast<uint8_t>(grade_[patch] - sinks[patch]);
    return sinks;
  }
  Result<void> roundAnew(TexelKeeper& keeper, uint32_t patch) const {
    if (auto kept = keeper.keepExactTail(patch); !kept || grade_[patch] == 0) return kept;
    PatchTails tail(1, c_.store.channels);
    if (auto read = readTail(patch, tail.texels); !read) return read;
    round(tail.texels, grades_[grade_[patch]]);
    return keeper.keepRoundedTail(patch, tail.texels);
  }

  Context& c_;
  const BuildOptions& options_;
  const int workers_;
  const std::vector<ChannelTolerance> tolerances_;  // by channel
  const std::vector<double> grades_;                // shares of the tolerance
  std::vector<uint8_t> grade_;                      // by patch, which of these
};

// Into the header, unless all patches have all levels.
inline Result<void> findTextureDepths(Context& context, PackageHeader& header, const BuildOptions& options,
                                      int workers) {
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

}  // namespace relievo::patch_build
