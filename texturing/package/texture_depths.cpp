#include "texturing/package/texture_depths.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>
#include <vector>

namespace relievo {
namespace {

// Where the centre of a fine texel lies between the centres of two coarse ones: at `first` and behind it, weights in
// parts of 2 ratio.
struct Between {
  size_t first;
  int64_t weight, next_weight;
};

// Of the texels -1 .. fine.side.
std::vector<Between> placesAlong(const BorderedLevel& fine, const BorderedLevel& coarse) {
  const auto ratio = static_cast<int64_t>(fine.side / coarse.side), parts = 2 * ratio;
  std::vector<Between> out;
  for (int64_t i = -1; i <= static_cast<int64_t>(fine.side); ++i) {
    // (i + 1/2) / ratio - 1/2 coarse texels, shifted by one so that nothing is negative.
    const int64_t at = 2 * i + 1 - ratio + parts;
    out.push_back({static_cast<size_t>(at / parts) + coarse.border - 1, parts - at % parts, at % parts});
  }
  return out;
}

}  // namespace

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
  const auto parts = static_cast<int64_t>(2 * (fine.side / coarse.side)), whole = parts * parts;
  const size_t stride = coarse.stride();
  for (size_t channel = 0; channel < tolerances.size(); ++channel) {
    const auto most = static_cast<int64_t>(std::floor(tolerances[channel].most * static_cast<double>(whole)));
    double squares = 0;
    const uint8_t* texel = fine.texels.data() + channel * fine.stride() * fine.stride() +
                           (fine.border - 1) * fine.stride() + fine.border - 1;
    const uint8_t* plane = coarse.texels.data() + channel * stride * stride;
    for (const Between& y : places) {
      const uint8_t *above = plane + y.first * stride, *below = above + stride;
      for (size_t i = 0; i < places.size(); ++i) {
        const Between& x = places[i];
        const int64_t shown = (above[x.first] * x.weight + above[x.first + 1] * x.next_weight) * y.weight +
                              (below[x.first] * x.weight + below[x.first + 1] * x.next_weight) * y.next_weight;
        const int64_t off = texel[i] * whole - shown;
        if (std::abs(off) > most) return false;
        squares += static_cast<double>(off) * static_cast<double>(off);
      }
      texel += fine.stride();
    }
    const auto count = static_cast<double>(places.size() * places.size());
    if (std::sqrt(squares / count) > tolerances[channel].rms * static_cast<double>(whole)) return false;
  }
  return true;
}

}  // namespace relievo
