#include "texturing/package/kept_tails.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cstdlib>

namespace relievo {
namespace {

// A texel of a level as one that is `finer` levels coarser shows it along a row of `side` texels: between the texels
// `first` and the next, the second's share in units of 1 / whole, 2^(finer + 1). Beyond their centres the row goes on
// as it is.
struct RowShare {
  int first = 0, second_share = 0, whole = 1;
};
constexpr RowShare betweenTexels(int x, int finer, int side) {
  const int whole = 2 << finer, at = 2 * x + 1 - (1 << finer);
  const int first = std::clamp(at < 0 ? -1 : at / whole, 0, side - 2);
  return {first, at - first * whole, whole};
}

// Of a value in units of 1 / whole^2.
constexpr int rounded(int value, int finer) {
  const int log2 = 2 * (finer + 1);
  return std::clamp((value + (1 << (log2 - 1))) >> log2, 0, 255);
}

// The first level's rows as one that is `finer` levels coarser shows them. Calls row(y, values) for each, until it
// answers false.
template <class Row>
bool shownRows(const uint8_t* coarse, int finer, int side, Row&& row) {
  const int coarse_side = side >> finer;
  std::array<std::array<int, kTailTexels>, kTailTexels / 2> across;
  for (int x = 0; x < side; ++x) {
    const RowShare b = betweenTexels(x, finer, coarse_side);
    for (int y = 0; y < coarse_side; ++y) {
      const uint8_t* at = coarse + y * coarse_side + b.first;
      across[static_cast<size_t>(y)][static_cast<size_t>(x)] =
          at[0] * (b.whole - b.second_share) + at[1] * b.second_share;
    }
  }
  std::array<int, kTailTexels> values;
  for (int y = 0; y < side; ++y) {
    const RowShare b = betweenTexels(y, finer, coarse_side);
    const auto &above = across[static_cast<size_t>(b.first)], &below = across[static_cast<size_t>(b.first) + 1];
    for (size_t x = 0; x < static_cast<size_t>(side); ++x)
      values[x] = rounded(above[x] * (b.whole - b.second_share) + below[x] * b.second_share, finer);
    if (!row(y, values)) return false;
  }
  return true;
}

size_t texelsOf(int level) { return size_t{1} << (2 * (4 - level)); }
static_assert(kTailTexels == 1 << 4);

bool areAll(const uint8_t* texels, size_t count, uint8_t value) {
  return std::all_of(texels, texels + count, [&](uint8_t t) { return t == value; });
}

// The coarsest level that shows the finest one.
int coarsestThatShows(const PatchTails& tails, uint32_t patch, int plane, int tolerance) {
  auto shows = [&](int level, int channel) {
    const uint8_t* finest = tails.level(patch, 0, channel);
    const uint8_t* coarse = tails.level(patch, level, channel);
    if (areAll(finest, texelsOf(0), finest[0]) && areAll(coarse, texelsOf(level), finest[0])) return true;
    return shownRows(coarse, level, kTailTexels, [&](int y, const auto& values) {
      int largest = 0;
      for (size_t x = 0; x < kTailTexels; ++x)
        largest = std::max(largest, std::abs(values[x] - finest[static_cast<size_t>(y) * kTailTexels + x]));
      return largest <= tolerance;
    });
  };
  int level = kTailLevels - 1;
  for (; level > 0; --level)
    if (shows(level, 3 * plane) && shows(level, 3 * plane + 1) && shows(level, 3 * plane + 2)) break;
  return level;
}

// Bytes of three channels' levels from `finest` on, before `level`.
size_t levelAt(int finest, int level) {
  return 3 * (kTailLevelAt[static_cast<size_t>(level)] - kTailLevelAt[static_cast<size_t>(finest)]);
}

}  // namespace

int KeptTailTolerance::ofPlane(int plane) const {
  constexpr int kPlane = kNormalChannel / 3;
  return normals && plane == kPlane ? kTailNormals * of_255 : of_255;
}

KeptTails::KeptTails(uint32_t patches, int channels, KeptTailTolerance tolerance)
    : patches_(patches),
      channels_(channels),
      tolerance_(tolerance),
      chunks_((patches + kChunkPatches - 1) / kChunkPatches) {
  // Until they are kept, all of a chunk's planes share one that is 0.
  for (Chunk& chunk : chunks_) {
    chunk.finest.assign(kChunkPatches * planesSize(), kTailLevels - 1);
    chunk.at.assign(kChunkPatches * planesSize(), 0);
    chunk.texels.assign(3 * texelsOf(kTailLevels - 1), 0);
    chunk.heights.assign(1, 0);
  }
}

KeptTails::KeptTails(const PatchTails& tails, KeptTailTolerance tolerance)
    : KeptTails(tails.patches, tails.channels, tolerance) {
  for (uint32_t first = 0; first < patches_; first += kChunkPatches) {
    const uint32_t count = std::min(kChunkPatches, patches_ - first);
    PatchTails chunk(count, channels_);
    std::copy_n(tails.heights.begin() + static_cast<ptrdiff_t>(first * kTailHeights), count * kTailHeights,
                chunk.heights.begin());
    std::copy_n(tails.texels.begin() + static_cast<ptrdiff_t>(first * tails.patchTexels()), count * tails.patchTexels(),
                chunk.texels.begin());
    keep(first, chunk);
  }
  failures_ = tails.failures;
}

KeptTails::Chunk& KeptTails::startChunk(uint32_t first, const PatchTails& tails) {
  assert(first % kChunkPatches == 0 && tails.patches <= kChunkPatches && tails.channels == channels_);
  Chunk& chunk = chunks_[first / kChunkPatches];
  chunk = {};
  chunk.finest.reserve(tails.patches * planesSize());
  chunk.at.reserve(tails.patches * planesSize());
  const std::vector<uint16_t>& heights = tails.heights;
  if (std::all_of(heights.begin(), heights.end(), [&](uint16_t h) { return h == heights[0]; }))
    chunk.heights.assign(1, heights.empty() ? uint16_t{0} : heights[0]);
  else chunk.heights = heights;
  return chunk;
}

void KeptTails::keepPlane(Chunk& chunk, const PatchTails& tails, uint32_t patch, int plane, int finest) {
  chunk.finest.push_back(static_cast<uint8_t>(finest));
  chunk.at.push_back(static_cast<uint32_t>(chunk.texels.size()));
  for (int level = finest; level < kTailLevels; ++level) {
    const uint8_t* first = tails.level(patch, level, 3 * plane);
    chunk.texels.insert(chunk.texels.end(), first, first + 3 * texelsOf(level));
  }
}

void KeptTails::keep(uint32_t first, const PatchTails& tails) {
  Chunk& chunk = startChunk(first, tails);
  std::vector<int> finest;
  size_t texels = 0;
  for (uint32_t p = 0; p < tails.patches; ++p)
    for (int plane = 0; plane < planes(); ++plane) {
      finest.push_back(coarsestThatShows(tails, p, plane, tolerance_.ofPlane(plane)));
      texels += levelAt(finest.back(), kTailLevels);
    }
  chunk.texels.reserve(texels);
  for (size_t i = 0; i < finest.size(); ++i)
    keepPlane(chunk, tails, static_cast<uint32_t>(i / planesSize()), static_cast<int>(i % planesSize()), finest[i]);
}

const uint8_t* KeptTails::Plane::level(int level, int channel) const {
  return texels + levelAt(finest, level) + static_cast<size_t>(channel) * texelsOf(level);
}

uint8_t KeptTails::Plane::at(int level, int channel, int x, int y) const {
  const int from = std::max(level, finest), side = PatchTails::side(from);
  const uint8_t* at = this->level(from, channel);
  if (from == level) return at[y * side + x];
  const RowShare u = betweenTexels(x, from - level, side), v = betweenTexels(y, from - level, side);
  auto across = [&](int row) {
    const uint8_t* two = at + row * side + u.first;
    return two[0] * (u.whole - u.second_share) + two[1] * u.second_share;
  };
  return static_cast<uint8_t>(
      rounded(across(v.first) * (v.whole - v.second_share) + across(v.first + 1) * v.second_share, from - level));
}

std::array<uint8_t, 3> KeptTails::Plane::at(int level, int x, int y) const {
  if (level < finest) return {at(level, 0, x, y), at(level, 1, x, y), at(level, 2, x, y)};
  const uint8_t* first = this->level(level, 0) + y * PatchTails::side(level) + x;
  const size_t channel = texelsOf(level);
  return {first[0], first[channel], first[2 * channel]};
}

bool KeptTails::heightsAreEven() const {
  return std::all_of(chunks_.begin(), chunks_.end(), [&](const Chunk& chunk) {
    return chunk.heights.size() == 1 && chunk.heights[0] == chunks_[0].heights[0];
  });
}

PatchTails KeptTails::whole(uint32_t first, uint32_t count) const {
  PatchTails out(count, channels_);
  for (uint32_t p = 0; p < count; ++p) {
    const uint32_t patch = first + p;
    for (size_t i = 0; i < kTailHeights; ++i) out.heights[p * kTailHeights + i] = height(patch, i);
    for (int c = 0; c < channels_; ++c) {
      const Plane of = plane(patch, c / 3);
      for (int level = of.finest; level < kTailLevels; ++level)
        std::copy_n(of.level(level, c % 3), texelsOf(level), out.level(p, level, c));
      for (int level = 0; level < of.finest; ++level) {
        uint8_t* to = out.level(p, level, c);
        const int side = PatchTails::side(level);
        shownRows(of.level(of.finest, c % 3), of.finest - level, side, [&](int y, const auto& values) {
          std::transform(values.begin(), values.begin() + side, to + y * side,
                         [](int value) { return static_cast<uint8_t>(value); });
          return true;
        });
      }
    }
  }
  return out;
}

uint64_t KeptTails::bytes() const {
  uint64_t out = 0;
  for (const Chunk& c : chunks_)
    out += c.finest.size() + 4 * c.at.size() + c.texels.size() + 2 * c.heights.size() + sizeof c;
  return out;
}

namespace {

// make(whole tails of a chunk): those of one plane, without heights. finest(patch): its level.
template <class Make, class Finest>
KeptTails onePlane(const KeptTails& tails, Make&& make, Finest&& finest) {
  KeptTails out(tails.patches(), 3);
  for (uint32_t first = 0; first < tails.patches(); first += KeptTails::kChunkPatches) {
    const uint32_t count = std::min(KeptTails::kChunkPatches, tails.patches() - first);
    out.keepLevels(first, make(tails.whole(first, count)), finest);
  }
  return out;
}

}  // namespace

KeptTails resolvedTails(const KeptTails& tails, const TextureFormat& format, const std::array<double, 3>& light) {
  return onePlane(
      tails, [&](const PatchTails& chunk) { return resolvedTails(chunk, format, light); },
      [&](uint32_t patch) {
        int finest = kTailLevels;
        for (int plane = 0; plane < format.planes(); ++plane)
          finest = std::min(finest, tails.plane(patch, plane).finest);
        return finest;
      });
}

KeptTails planeOfTails(const KeptTails& tails, int plane) {
  return onePlane(
      tails, [&](const PatchTails& chunk) { return planeOfTails(chunk, plane); },
      [&](uint32_t patch) { return tails.plane(patch, plane).finest; });
}

TailBlocks::TailBlocks(const KeptTails& tails, const BaseMesh& base, GutterEnds ends)
    : tails_(tails),
      base_(base),
      ends_(ends),
      neighbours_(patchNeighbours(base)),
      first_(base.corners.size() + 1, 0),
      at_(base.patches.size() * 4) {
  for (const auto& patch : base.patches)
    for (uint32_t corner : patch) ++first_[corner + 1];
  for (size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
  std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
  for (uint32_t i = 0; i < at_.size(); ++i) at_[next[base.patches[i / 4][i % 4]]++] = i;
  for (int plane = 0; plane < tails.planes(); ++plane) {
    even_.push_back(evenTexel(plane));
    std::vector<Texel>& corners = coarsest_corners_.emplace_back();
    if (even_.back()) continue;
    corners.reserve(at_.size());
    for (uint32_t patch = 0; patch < tails.patches(); ++patch)
      for (size_t k = 0; k < 4; ++k) corners.push_back(onCorner(tails.plane(patch, plane), kCoarsest, k, true));
  }
}

std::optional<TailBlocks::Texel> TailBlocks::evenTexel(int plane) const {
  if (tails_.patches() == 0) return std::nullopt;
  const Texel first = tails_.plane(0, plane).at(kCoarsest, 0, 0);
  for (uint32_t patch = 0; patch < tails_.patches(); ++patch) {
    const KeptTails::Plane of = tails_.plane(patch, plane);
    for (int level = of.finest; level < kTailLevels; ++level)
      for (int c = 0; c < 3; ++c) {
        const uint8_t* texels = of.level(level, c);
        if (!areAll(texels, texelsOf(level), first[static_cast<size_t>(c)])) return std::nullopt;
      }
  }
  return first;
}

namespace {

using Texel = std::array<uint8_t, 3>;

uint32_t wordOf(const Texel& texel) { return texel[0] | uint32_t{texel[1]} << 8 | uint32_t{texel[2]} << 16; }

// Into a block, from -1 on.
void put(uint32_t* block, int level, int x, int y, const Texel& texel) {
  const auto row = static_cast<int>(tailBlockSide(level));
  block[(y + 1) * row + x + 1] = wordOf(texel);
}

Texel texelOf(const std::array<int, 3>& value) {
  Texel out;
  for (size_t c = 0; c < 3; ++c) out[c] = static_cast<uint8_t>(std::clamp(value[c], 0, 255));
  return out;
}

// Where a line of texels goes on to, half a texel beyond the first.
Texel halfBeyond(const Texel& first, const Texel& second) {
  std::array<int, 3> out;
  for (size_t c = 0; c < 3; ++c) out[c] = (3 * first[c] - second[c] + 1) / 2;
  return texelOf(out);
}

}  // namespace

// A texel on a patch's side, or what the patch goes on to at the side itself there.
TailBlocks::Texel TailBlocks::onSide(const KeptTails::Plane& of, int level, size_t side, int along, bool itself) const {
  const bool upright = side == kLeft || side == kRight, after = side == kRight || side == kBottom;
  const int last = PatchTails::side(level) - 1, edge = after ? last : 0, inwards = after ? last - 1 : 1;
  auto at = [&](int across) { return of.at(level, upright ? across : along, upright ? along : across); };
  return itself ? halfBeyond(at(edge), at(inwards)) : at(edge);
}

TailBlocks::Texel TailBlocks::onCorner(const KeptTails::Plane& of, int level, size_t corner, bool itself) const {
  const int last = PatchTails::side(level) - 1, x = corner % 2 ? last : 0, y = corner / 2 ? last : 0;
  if (!itself) return of.at(level, x, y);
  const int in_x = corner % 2 ? last - 1 : 1, in_y = corner / 2 ? last - 1 : 1;
  return halfBeyond(halfBeyond(of.at(level, x, y), of.at(level, in_x, y)),
                    halfBeyond(of.at(level, x, in_y), of.at(level, in_x, in_y)));
}

// As a page's border has it: what makes the mean of the four texels around the corner the same from all patches that
// meet there. Of the finest level that is kept: what they go on to at the corner itself, in the mean.
TailBlocks::Texel TailBlocks::beyondCorner(uint32_t patch, size_t k, int level, int plane, bool itself) const {
  const uint32_t corner = base_.patches[patch][k];
  const auto first_channel = static_cast<size_t>(3 * plane);
  const KeptTails::Plane of = tails_.plane(patch, plane);
  auto goesOnTo = [&](uint32_t patch_corner) {
    if (itself && level == kCoarsest) return coarsest_corners_[static_cast<size_t>(plane)][patch_corner];
    return onCorner(tails_.plane(patch_corner / 4, plane), level, patch_corner % 4, itself);
  };
  const Texel own = goesOnTo(patch * 4 + static_cast<uint32_t>(k));
  std::array<int, 3> sum{};
  auto meet = static_cast<int>(first_[corner + 1] - first_[corner]);
  for (uint32_t i = first_[corner]; i < first_[corner + 1]; ++i) {
    const Texel theirs = goesOnTo(at_[i]);
    if (ends_.anyOf(first_channel) && ends_.between(first_channel, own, theirs)) {
      if (!itself) return own;
      for (size_t c = 0; c < 3; ++c) sum[c] = own[c];
      meet = 1;
      break;
    }
    for (size_t c = 0; c < 3; ++c) sum[c] += theirs[c];
  }
  const int last = PatchTails::side(level) - 1;
  // Without what ends there, but for what the patches go on to.
  auto beyondEnd = [&](size_t side, bool at_last) {
    return beyond(patch, side, at_last ? last : 0, level, plane, itself, itself ? ends_ : GutterEnds{});
  };
  const Texel edge = onCorner(of, level, k, false), beside = beyondEnd(k % 2 ? kRight : kLeft, k / 2),
              above = beyondEnd(k / 2 ? kBottom : kTop, k % 2);
  std::array<int, 3> out;
  for (size_t c = 0; c < 3; ++c) out[c] = (8 * sum[c] + meet) / (2 * meet) - edge[c] - beside[c] - above[c];
  return texelOf(out);
}

// Beyond a texel of a side: the neighbour's. itself: what makes the mean of both that of what both go on to at the
// side.
TailBlocks::Texel TailBlocks::beyond(uint32_t patch, size_t side, int along, int level, int plane, bool itself,
                                     const GutterEnds& ends) const {
  const KeptTails::Plane of = tails_.plane(patch, plane);
  const PatchNeighbour& n = neighbours_[patch][side];
  const Texel own = onSide(of, level, side, along, itself);
  Texel theirs = own;
  if (n.patch != PatchNeighbour::kNone) {
    const int t = n.reversed ? PatchTails::side(level) - 1 - along : along;
    const auto first_channel = static_cast<size_t>(3 * plane);
    theirs = onSide(tails_.plane(n.patch, plane), level, static_cast<size_t>(n.side), t, itself);
    if (ends.anyOf(first_channel) && ends.between(first_channel, own, theirs)) theirs = own;
  }
  if (!itself) return theirs;
  const Texel edge = onSide(of, level, side, along, false);
  std::array<int, 3> out;
  for (size_t c = 0; c < 3; ++c) out[c] = own[c] + theirs[c] - edge[c];
  return texelOf(out);
}

void TailBlocks::write(uint32_t patch, int level, int plane, uint32_t* out) const {
  if (const auto& even = even_[static_cast<size_t>(plane)]) {
    std::fill_n(out, tailBlockTexels(level), wordOf(*even));
    return;
  }
  const int side = PatchTails::side(level);
  const KeptTails::Plane own = tails_.plane(patch, plane);
  const bool itself = level > 0 && level == own.finest;
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) put(out, level, x, y, own.at(level, x, y));
  for (size_t s = 0; s < 4; ++s) {
    const bool upright = s == kLeft || s == kRight;
    const int border = s == kRight || s == kBottom ? side : -1;
    for (int i = 0; i < side; ++i)
      put(out, level, upright ? border : i, upright ? i : border, beyond(patch, s, i, level, plane, itself, ends_));
  }
  for (size_t k = 0; k < 4; ++k)
    put(out, level, k % 2 ? side : -1, k / 2 ? side : -1, beyondCorner(patch, k, level, plane, itself));
}

}  // namespace relievo
