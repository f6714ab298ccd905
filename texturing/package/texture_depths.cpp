#include "texturing/package/texture_depths.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

// The fine texels whose centres lie between the centres of the same two coarse ones, `first` and the one behind it: the
// weights of the latter in parts of 2 ratio are `weight`, `weight` + 2, and so on.
struct Between {
  size_t first;
  int32_t weight;
  size_t begin, end;  // of the fine texels, the first of the border being 0
};

// Of the texels -1 .. fine.side.
std::vector<Between> placesAlong(const BorderedLevel& fine, const BorderedLevel& coarse) {
  const auto ratio = static_cast<int64_t>(fine.side / coarse.side), parts = 2 * ratio;
  std::vector<Between> out;
  for (int64_t i = -1; i <= static_cast<int64_t>(fine.side); ++i) {
    // (i + 1/2) / ratio - 1/2 coarse texels, shifted by one so that nothing is negative.
    const int64_t at = 2 * i + 1 - ratio + parts;
    const auto first = static_cast<size_t>(at / parts) + coarse.border - 1, texel = static_cast<size_t>(i + 1);
    if (out.empty() || out.back().first != first)
      out.push_back({first, static_cast<int32_t>(at % parts), texel, texel});
    out.back().end = texel + 1;
  }
  return out;
}

// What a filter gives at the fine texels of a row, in parts of `whole`. column: for each coarse texel what the rows
// above and below give at the height of the row. kCount: of the texels of a place, where that is known beforehand.
template <size_t kCount>
inline void placeOfRow(const int32_t* column, const Between& p, int32_t parts, int32_t* shown) noexcept {
  const int32_t from = column[p.first], step = column[p.first + 1] - from,
                start = from * parts + step * p.weight;  // of the first texel; each further one adds 2 steps
  const auto count = static_cast<int32_t>(kCount > 0 ? kCount : p.end - p.begin);
  for (int32_t i = 0; i < count; ++i) shown[p.begin + static_cast<size_t>(i)] = start + 2 * step * i;
}

// Differences of a row of fine texels from what is shown, in parts of `whole`: their largest size, and the sum of their
// squares.
struct Differences {
  int32_t largest = 0;
  int64_t squares = 0;
};
RELIEVO_SIMD_CLONES Differences differencesOfRow(const uint8_t* texel, const int32_t* column,
                                                 std::span<const Between> places, int32_t parts,
                                                 std::span<int32_t> shown) noexcept {
  constexpr size_t kRun = 8;  // of a tail's texels under a page's
  for (const Between& p : places) {
    if (p.end - p.begin == kRun) placeOfRow<kRun>(column, p, parts, shown.data());
    else placeOfRow<0>(column, p, parts, shown.data());
  }
  const int32_t whole = parts * parts;
  Differences out;
  for (size_t i = 0; i < shown.size(); ++i) {
    const int32_t off = texel[i] * whole - shown[i];
    const int32_t size = off < 0 ? -off : off;
    out.largest = out.largest > size ? out.largest : size;
    out.squares += static_cast<int64_t>(off) * off;
  }
  return out;
}

std::span<const uint8_t> channelOf(const BorderedLevel& level, size_t channel) {
  const size_t texels = level.stride() * level.stride();
  return level.texels.subspan(channel * texels, texels);
}

}  // namespace

bool isEven(std::span<const uint8_t> texels) {
  return std::memcmp(texels.data(), texels.data() + 1, texels.size() - 1) == 0;
}

std::vector<ChannelTolerance> channelTolerances(const TextureFormat& format, double tolerance) {
  std::vector<ChannelTolerance> out(static_cast<size_t>(format.channels()), {tolerance, kRmsTolerance * tolerance});
  constexpr size_t kFirstOfNormal = 3;
  if (format.basis == Basis::kAlbedoNormal)
    for (size_t channel = kFirstOfNormal; channel < out.size(); ++channel)
      out[channel].most = kNormalTolerance * tolerance;
  return out;
}

bool showsTheSame(const BorderedLevel& fine, const BorderedLevel& coarse,
                  std::span<const ChannelTolerance> tolerances) {
  assert(fine.border >= 1 && coarse.border >= 1 && coarse.side <= fine.side && fine.side % coarse.side == 0);
  const std::vector<Between> places = placesAlong(fine, coarse);
  const auto ratio = static_cast<int32_t>(fine.side / coarse.side), parts = 2 * ratio, whole = parts * parts;
  assert(ratio <= 1024);  // so that 255 parts^2 fits 32 bits
  const size_t stride = coarse.stride(), rows = fine.side + 2;
  std::vector<int32_t> column(stride), shown(rows);
  for (size_t channel = 0; channel < tolerances.size(); ++channel) {
    const auto most = static_cast<int64_t>(std::floor(tolerances[channel].most * static_cast<double>(whole)));
    double squares = 0;
    const uint8_t* texel = fine.texels.data() + channel * fine.stride() * fine.stride() +
                           (fine.border - 1) * fine.stride() + fine.border - 1;
    const uint8_t* plane = coarse.texels.data() + channel * stride * stride;
    if (*texel == *plane && isEven(channelOf(fine, channel)) && isEven(channelOf(coarse, channel))) continue;
    for (const Between& y : places) {
      const uint8_t *above = plane + y.first * stride, *below = above + stride;
      int32_t weight = y.weight;
      for (size_t row = y.begin; row < y.end; ++row, weight += 2) {
        for (size_t i = 0; i < stride; ++i) column[i] = above[i] * (parts - weight) + below[i] * weight;
        const Differences off = differencesOfRow(texel, column.data(), places, parts, shown);
        if (off.largest > most) return false;
        squares += static_cast<double>(off.squares);
        texel += fine.stride();
      }
    }
    const auto count = static_cast<double>(rows * rows);
    if (std::sqrt(squares / count) > tolerances[channel].rms * static_cast<double>(whole)) return false;
  }
  return true;
}

}  // namespace relievo
