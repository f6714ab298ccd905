#include "texturing/codec/coarse_page.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "src/base/simd_dispatch.h"

namespace relievo {
namespace coarse_page {
namespace {

constexpr int kFull = kPageFullPx;

// Texel i of a page lies between the coarse texels `first` and `first` + 1, of weights 2 factor - w and w in parts of
// 2 factor; before the first one's centre and behind the last one's on the line through the outermost two.
struct Between {
  int first, weight;
};
template <int kFactor>
constexpr std::array<Between, kFull> kPlaces = [] {
  std::array<Between, kFull> out{};
  for (int i = 0; i < kFull; ++i) {
    const int at = 2 * i + 1 - kFactor;
    const int first = at < 0 ? 0 : std::min(at / (2 * kFactor), kFull / kFactor - 2);
    out[static_cast<size_t>(i)] = {first, at - 2 * kFactor * first};
  }
  return out;
}();

// One channel. Between the outermost coarse texels' centres every run of kFactor texels lies between the same two, with
// the same weights: they are computed side by side.
template <int kFactor>
RELIEVO_SIMD_CLONES void enlarge(const uint8_t* coarse, uint8_t* out) noexcept {
  constexpr int kSide = kFull / kFactor, kParts = 2 * kFactor, kShift = kFactor == 2 ? 4 : 6,
                kRound = 1 << (kShift - 1), kHalf = kFactor / 2;
  static_assert(1 << kShift == kParts * kParts);
  std::array<int, kSide> column;
  for (int y = 0; y < kFull; ++y, out += kFull) {
    const Between rows = kPlaces<kFactor>[static_cast<size_t>(y)];
    const uint8_t *above = coarse + rows.first * kSide, *below = above + kSide;
    for (size_t i = 0; i < kSide; ++i) column[i] = above[i] * (kParts - rows.weight) + below[i] * rows.weight;
    auto between = [&](size_t x) {
      const Between at = kPlaces<kFactor>[x];
      const int* c = column.data() + at.first;
      const int value = (c[0] * (kParts - at.weight) + c[1] * at.weight + kRound) >> kShift;
      out[x] = static_cast<uint8_t>(value < 0 ? 0 : value > 255 ? 255 : value);
    };
    for (size_t x = 0; x < kHalf; ++x) between(x);
    for (size_t x = kFull - kHalf; x < kFull; ++x) between(x);
    const int* c = column.data();
    uint8_t* to = out + kHalf;
    for (size_t i = 0; i + 1 < kSide; ++i) {
      const int from = c[i] * kParts + kRound, step = c[i + 1] - c[i];
      for (int k = 0; k < kFactor; ++k) {
        const int value = (from + step * (2 * k + 1)) >> kShift;
        to[i * kFactor + static_cast<size_t>(k)] = static_cast<uint8_t>(value < 0 ? 0 : value > 255 ? 255 : value);
      }
    }
  }
}

void enlargeChannel(const uint8_t* coarse, int factor, uint8_t* out) {
  if (factor == 2) enlarge<2>(coarse, out);
  else enlarge<4>(coarse, out);
}

struct Off {
  int most = 0, squares = 0;
};
RELIEVO_SIMD_CLONES Off offOf(const uint8_t* channel, const uint8_t* shown) noexcept {
  Off off;
  for (int i = 0; i < kFull * kFull; ++i) {
    const int d = channel[i] - shown[i], size = d < 0 ? -d : d;
    off.most = off.most > size ? off.most : size;
    off.squares += d * d;  // at most 136^2 255^2, within 31 bits
  }
  return off;
}
// Of the rows and columns on both sides of the page's edge.
int mostAtEdges(const uint8_t* channel, const uint8_t* shown) {
  constexpr int kFirst = kPageBorderPx, kLast = kFull - kPageBorderPx;
  int most = 0;
  for (const int line : {kFirst - 1, kFirst, kLast - 1, kLast})
    for (int i = 0; i < kFull; ++i)
      for (const int at : {line * kFull + i, i * kFull + line})
        most = std::max(most, std::abs(channel[at] - shown[at]));
  return most;
}

double rmsOf(const Off& off) { return std::sqrt(static_cast<double>(off.squares) / (kFull * kFull)); }
bool within(const Off& off, const uint8_t* channel, const uint8_t* shown, const ChannelTolerance& tolerance) {
  return off.most <= tolerance.most && rmsOf(off) <= tolerance.rms &&
         mostAtEdges(channel, shown) <= kEdgeShare * tolerance.most;
}

// In eighths of a step. Each round adds to a coarse texel what its square lacks in the mean.
bool reduceChannel(const uint8_t* channel, int factor, const ChannelTolerance& tolerance, uint8_t* coarse) {
  constexpr int kRounds = 4;
  constexpr double kHopeless = 4;  // times the tolerance, after the first round
  const int side = coarseSide(factor), texels = factor * factor;
  std::vector<int> value(static_cast<size_t>(side * side));
  std::array<uint8_t, kFull * kFull> shown{};
  for (int round = 0; round < kRounds; ++round) {
    for (int y = 0; y < side; ++y)
      for (int x = 0; x < side; ++x) {
        int lacks = 0;
        for (int j = 0; j < factor; ++j) {
          const int row = (y * factor + j) * kFull + x * factor;
          for (int i = 0; i < factor; ++i) lacks += channel[row + i] - shown[static_cast<size_t>(row + i)];
        }
        int& v = value[static_cast<size_t>(y * side + x)];
        v += (8 * lacks + texels / 2) / texels;
        coarse[y * side + x] = static_cast<uint8_t>(std::clamp((v + 4) >> 3, 0, 255));
      }
    enlargeChannel(coarse, factor, shown.data());
    const Off off = offOf(channel, shown.data());
    if (within(off, channel, shown.data(), tolerance)) return true;
    if (off.most > kHopeless * tolerance.most || rmsOf(off) > kHopeless * tolerance.rms) return false;
  }
  return false;
}

}  // namespace
}  // namespace coarse_page

bool isWithin(const uint8_t* channel, const uint8_t* shown, const ChannelTolerance& tolerance) {
  return coarse_page::within(coarse_page::offOf(channel, shown), channel, shown, tolerance);
}

void enlargePage(std::span<const uint8_t> coarse, int factor, std::span<uint8_t> channels) {
  const size_t of_coarse = coarse.size() / 3, of_page = channels.size() / 3;
  assert(of_coarse == static_cast<size_t>(coarseSide(factor) * coarseSide(factor)));
  for (size_t c = 0; c < 3; ++c)
    coarse_page::enlargeChannel(coarse.data() + c * of_coarse, factor, channels.data() + c * of_page);
}

bool reducePage(std::span<const uint8_t> channels, int factor, std::span<const ChannelTolerance> tolerances,
                std::span<uint8_t> coarse) {
  const size_t of_coarse = coarse.size() / 3, of_page = channels.size() / 3;
  for (size_t c = 0; c < 3; ++c)
    if (!coarse_page::reduceChannel(channels.data() + c * of_page, factor, tolerances[c],
                                    coarse.data() + c * of_coarse))
      return false;
  return true;
}

}  // namespace relievo
