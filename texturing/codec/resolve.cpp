// resolve.cpp - the sums of basis.h with the light folded in: every coefficient's scale, bias and basis function become
// one weight and one constant (computed in double precision), so that a texel costs six multiplications and additions a
// colour.
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

// Eight texels at a time, in the vector types of g++ and clang (which split them where the machine's are narrower):
// left to itself g++ 12 does not vectorise the clamping of floats, as comparisons may trap.
typedef float Floats __attribute__((vector_size(32)));
typedef int32_t Ints __attribute__((vector_size(32)));
constexpr size_t kLanes = 8;
constexpr size_t kTexels = kSlotBytes / 4;
static_assert(kTexels % kLanes == 0);
constexpr int32_t kOpaque = static_cast<int32_t>(0xFF000000u);

struct Weights {
  float w[6];
  float constant;
};

Weights weightsFor(const TextureFormat& format, const std::array<double, 3>& light, double gain) {
  Weights out{};
  double constant = 0;
  const auto basis = ptmBasis(light);
  for (int k = 0; k < 6; ++k) {
    double w = format.scale[k] * basis[k] * gain;
    out.w[k] = static_cast<float>(w);
    // Of the weight as rounded: what the two roundings would differ by is multiplied by the bias otherwise.
    constant -= format.bias[k] * static_cast<double>(out.w[k]);
  }
  out.constant = static_cast<float>(constant);
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

RELIEVO_SIMD_CLONES void resolveLrgb(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  for (size_t i = 0; i < kTexels; i += kLanes) {
    Ints high = load(slots[0], i), low = load(slots[1], i), colour = load(slots[2], i);
    Floats lum = channel<0>(high) * s.w[0] + channel<1>(high) * s.w[1] + channel<2>(high) * s.w[2] +
                 channel<0>(low) * s.w[3] + channel<1>(low) * s.w[4] + channel<2>(low) * s.w[5] + s.constant;
    store(channel<0>(colour) * lum, channel<1>(colour) * lum, channel<2>(colour) * lum, out, i);
  }
}

RELIEVO_SIMD_CLONES void resolveRgb(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  for (size_t i = 0; i < kTexels; i += kLanes) {
    Floats red = Floats{} + s.constant, green = red, blue = red;
    for (int k = 0; k < 6; ++k) {
      Ints texels = load(slots[k], i);
      red += channel<0>(texels) * s.w[k];
      green += channel<1>(texels) * s.w[k];
      blue += channel<2>(texels) * s.w[k];
    }
    store(red, green, blue, out, i);
  }
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
                                       uint8_t* out) {
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
  switch (format.basis) {
    case Basis::kColour:
      for (size_t i = 0; i < kTexels; i += kLanes) {
        Ints texels = load(slots[0], i) | kOpaque;
        std::memcpy(out + 4 * i, &texels, sizeof texels);
      }
      break;
    // pixel = RGB * L / 255: the division is in the weights.
    case Basis::kPtmLrgb:
      resolveLrgb(weightsFor(format, light, 1.0 / 255), slots, out);
      break;
    case Basis::kPtmRgb:
      resolveRgb(weightsFor(format, light, 1), slots, out);
      break;
    case Basis::kAlbedoNormal:
      resolveAlbedo(light, slots, out);
      break;
  }
}

}  // namespace relievo
