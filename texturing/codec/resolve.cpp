// resolve.cpp - the sums of basis.h with the light folded in: every coefficient's scale, bias and function of the light
// become one weight and one constant (computed in double precision), so that a texel costs a multiplication and an
// addition a coefficient.
#include "texturing/codec/resolve.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>

#include "src/base/simd_dispatch.h"
#include "texturing/codec/page_codec.h"

// Vectors are passed between inlined functions of this file only, so that how they are passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace relievo {
namespace {

using shader::kAmbientShare;
using shader::kDisplayGamma;

// Eight texels at a time, in the vector types of g++ and clang (which split them where the machine's are narrower):
// left to itself g++ 12 does not vectorise the clamping of floats, as comparisons may trap.
typedef float Floats __attribute__((vector_size(32)));
typedef int32_t Ints __attribute__((vector_size(32)));
constexpr size_t kLanes = 8;
constexpr size_t kTexels = kSlotBytes / 4;
static_assert(kTexels % kLanes == 0);
constexpr int32_t kOpaque = static_cast<int32_t>(0xFF000000u);

// Of a linear basis under a light.
struct Weights {
  std::array<float, 3 * kMaxTexturePlanes> of_channel{};
  std::array<float, 4> constant{};  // red, green, blue, luminance
};

// gain: on every weight.
Weights weightsFor(const TextureFormat& format, const std::array<double, 3>& light, double gain) {
  const BasisDescription& basis = describe(format.basis);
  std::array<double, kMaxCoefficients> functions;
  basis.functions(light, std::span(functions).first(static_cast<size_t>(basis.coefficients)));
  Weights out;
  std::array<double, 4> constant{};
  for (size_t i = 0; i < static_cast<size_t>(3 * basis.planes); ++i) {
    const BasisChannel& c = basis.channels[i];
    if (c.holds != BasisChannel::Holds::kCoefficient) continue;
    out.of_channel[i] = static_cast<float>(format.scale[c.coefficient] * functions[c.coefficient] * gain);
    // Of the weight as rounded: what the two roundings would differ by is multiplied by the bias otherwise.
    constant[c.of] -= format.bias[c.coefficient] * static_cast<double>(out.of_channel[i]);
  }
  std::ranges::transform(constant, out.constant.begin(), [](double v) { return static_cast<float>(v); });
  return out;
}

Ints load(const uint8_t* slot, size_t texel) {
  Ints out;
  std::memcpy(&out, slot + 4 * texel, sizeof out);
  return out;
}

template <int kChannel>
Floats channel(Ints texels) {
  return __builtin_convertvector(texels >> 8 * kChannel & 255, Floats);
}

// Rounded half up, as everywhere in the engine, and packed.
void store(Floats red, Floats green, Floats blue, uint8_t* out, size_t texel) {
  auto toByte = [](Floats v) {
    v = v > 0.0f ? v : Floats{};
    v = v < 255.0f ? v : Floats{} + 255.0f;
    return __builtin_convertvector(v + 0.5f, Ints);
  };
  Ints packed = toByte(red) | toByte(green) << 8 | toByte(blue) << 16 | kOpaque;
  std::memcpy(out + 4 * texel, &packed, sizeof packed);
}

// Two kernels for the usual packing. kPlanes: how many planes of coefficients there are, where the compiler is to
// unroll the loop over them, as is worth while for a PTM's; 0: as many as slots says.

// A luminance whose colour is in the last plane, all other channels being coefficients (or nothing, of weight 0).
template <size_t kPlanes>
inline void sumLuminance(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  const size_t planes = kPlanes != 0 ? kPlanes : slots.size() - 1;
  for (size_t i = 0; i < kTexels; i += kLanes) {
    Floats lum{};
    for (size_t p = 0; p < planes; ++p) {
      const Ints texels = load(slots[p], i);
      const float* w = s.of_channel.data() + 3 * p;
      lum = lum + channel<0>(texels) * w[0] + channel<1>(texels) * w[1] + channel<2>(texels) * w[2];
    }
    lum += s.constant[BasisChannel::kLuminance];
    const Ints colour = load(slots[planes], i);
    store(channel<0>(colour) * lum, channel<1>(colour) * lum, channel<2>(colour) * lum, out, i);
  }
}
RELIEVO_SIMD_CLONES void resolveLuminance(const Weights& s, std::span<const uint8_t* const> slots,
                                          uint8_t* out) noexcept {
  if (slots.size() == 3) sumLuminance<2>(s, slots, out);
  else sumLuminance<0>(s, slots, out);
}

// Each plane is one coefficient, of red, green and blue.
template <size_t kPlanes>
inline void sumColours(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  const size_t planes = kPlanes != 0 ? kPlanes : slots.size();
  for (size_t i = 0; i < kTexels; i += kLanes) {
    Floats red = Floats{} + s.constant[0], green = Floats{} + s.constant[1], blue = Floats{} + s.constant[2];
    for (size_t p = 0; p < planes; ++p) {
      const Ints texels = load(slots[p], i);
      const float w = s.of_channel[3 * p];
      red += channel<0>(texels) * w;
      green += channel<1>(texels) * w;
      blue += channel<2>(texels) * w;
    }
    store(red, green, blue, out, i);
  }
}
RELIEVO_SIMD_CLONES void resolveColours(const Weights& s, std::span<const uint8_t* const> slots,
                                        uint8_t* out) noexcept {
  if (slots.size() == 6) sumColours<6>(s, slots, out);
  else sumColours<0>(s, slots, out);
}

// Channels in any order.
RELIEVO_SIMD_CLONES void resolveScattered(const Weights& s, const BasisDescription& basis,
                                          std::span<const uint8_t* const> slots, uint8_t* out) noexcept {
  const bool luminance = basis.shading == Shading::kLuminance;
  for (size_t i = 0; i < kTexels; i += kLanes) {
    Floats sum[4], colour[3] = {};
    for (size_t c = 0; c < 4; ++c) sum[c] = Floats{} + s.constant[c];
    for (size_t n = 0; n < 3 * slots.size(); ++n) {
      const BasisChannel& c = basis.channels[n];
      if (c.holds == BasisChannel::Holds::kNothing) continue;
      const Ints texels = load(slots[n / 3], i) >> static_cast<int>(8 * (n % 3));
      if (c.holds == BasisChannel::Holds::kColour) colour[c.of] = channel<0>(texels);
      else sum[c.of] += channel<0>(texels) * s.of_channel[n];
    }
    for (size_t c = 0; luminance && c < 3; ++c) sum[c] = colour[c] * sum[BasisChannel::kLuminance];
    store(sum[0], sum[1], sum[2], out, i);
  }
}

// Do the first two kernels know this order of the channels?
bool isPacked(const BasisDescription& basis) {
  using enum BasisChannel::Holds;
  const bool luminance = basis.shading == Shading::kLuminance;
  for (size_t i = 0; i < static_cast<size_t>(3 * basis.planes); ++i) {
    const BasisChannel& c = basis.channels[i];
    const bool last = i / 3 + 1 == static_cast<size_t>(basis.planes);
    if (luminance && !last) {
      if (c.holds == kColour) return false;
    } else if (c.holds != (luminance ? kColour : kCoefficient) || c.of != i % 3 ||
               c.coefficient != basis.channels[i - i % 3].coefficient) {
      return false;
    }
  }
  return true;
}

void resolveLinear(const TextureFormat& format, const std::array<double, 3>& light,
                   std::span<const uint8_t* const> slots, uint8_t* out) {
  const BasisDescription& basis = describe(format.basis);
  const bool luminance = basis.shading == Shading::kLuminance;
  // pixel = RGB * L / 255: the division is in the weights.
  const Weights weights = weightsFor(format, light, luminance ? 1.0 / 255 : 1);
  if (!isPacked(basis)) resolveScattered(weights, basis, slots, out);
  else if (luminance) resolveLuminance(weights, slots, out);
  else resolveColours(weights, slots, out);
}

// x^(1/2.2) by a table over the values that L takes: interpolated linearly it is off by at most 35.9 h^2 / 8 < 1e-6, h
// its spacing and 35.9 the second derivative at the ambient share, where it is largest.
class GainTable {
 public:
  GainTable() {
    for (int i = 0; i <= kSteps + 1; ++i)
      values_[static_cast<size_t>(i)] = static_cast<float>(std::pow(kAmbientShare + i / kPerUnit, 1 / kDisplayGamma));
  }
  float at(float above_ambient) const {  // of kAmbientShare + above_ambient
    const float place = above_ambient * static_cast<float>(kPerUnit);
    const int i = std::min(static_cast<int>(place), kSteps);
    const float t = place - static_cast<float>(i);
    return values_[static_cast<size_t>(i)] +
           t * (values_[static_cast<size_t>(i) + 1] - values_[static_cast<size_t>(i)]);
  }

 private:
  static constexpr double kPerUnit = 2400;
  static constexpr int kSteps = 4096;  // > 2400 * 0.96 * sqrt(3): the corners of the cube of bytes
  std::array<float, kSteps + 2> values_;
};

RELIEVO_SIMD_CLONES void resolveAlbedo(const std::array<double, 3>& light, std::span<const uint8_t* const> slots,
                                       uint8_t* out) noexcept {
  static const GainTable gains;
  float w[3], constant = 0;
  for (int c = 0; c < 3; ++c) {
    w[c] = static_cast<float>((1 - kAmbientShare) * light[static_cast<size_t>(c)] / 127.5);
    constant -= w[c] * 127.5f;
  }
  for (size_t i = 0; i < kTexels; i += kLanes) {
    const Ints colour = load(slots[0], i), normal = load(slots[1], i);
    Floats lit = channel<0>(normal) * w[0] + channel<1>(normal) * w[1] + channel<2>(normal) * w[2] + constant, gain{};
    lit = lit > 0.0f ? lit : Floats{};
    for (size_t k = 0; k < kLanes; ++k) gain[k] = gains.at(lit[k]);
    store(channel<0>(colour) * gain, channel<1>(colour) * gain, channel<2>(colour) * gain, out, i);
  }
}

}  // namespace

void resolvePage(const TextureFormat& format, const std::array<double, 3>& light, std::span<const uint8_t* const> slots,
                 uint8_t* out) {
  assert(slots.size() >= static_cast<size_t>(format.planes()));
  slots = slots.first(static_cast<size_t>(format.planes()));
  switch (describe(format.basis).shading) {
    case Shading::kColour:
      for (size_t i = 0; i < kTexels; i += kLanes) {
        Ints texels = load(slots[0], i) | kOpaque;
        std::memcpy(out + 4 * i, &texels, sizeof texels);
      }
      break;
    case Shading::kLuminance:
    case Shading::kColours:
      resolveLinear(format, light, slots, out);
      break;
    case Shading::kAlbedoNormal:
      resolveAlbedo(light, slots, out);
      break;
  }
}

}  // namespace relievo
