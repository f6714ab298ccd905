// resolve.cpp - the sums of basis.h with the light folded in: every coefficient's scale, bias and basis function become one
// weight and one constant (computed in double precision), so that a texel costs six multiplications and additions a colour.
// Texels are handled as 32-bit words of four bytes; the loops are plain so that the compiler makes SIMD code of them.
#include "texturing/resolve.h"

#include <algorithm>
#include <cassert>
#include <cstring>

#include "texturing/page_codec.h"

namespace relievo {
namespace {

constexpr size_t kTexels = kSlotBytes / 4;
constexpr size_t kBlock = 136;  // texels at a time: a row; what lies between the passes stays in the first-level cache
static_assert(kTexels % kBlock == 0);
constexpr uint32_t kOpaque = 0xFF000000u;

struct Weights {
  float w[6];
  float constant;
};

Weights weightsFor(const TextureFormat& format, double u, double v, double gain) {
  Weights out{};
  double constant = 0;
  auto basis = ptmBasis(u, v);
  for (int k = 0; k < 6; ++k) {
    double w = format.scale[k] * basis[k] * gain;
    out.w[k] = static_cast<float>(w);
    // Of the weight as rounded: what the two roundings would differ by is multiplied by the bias otherwise.
    constant -= format.bias[k] * static_cast<double>(out.w[k]);
  }
  out.constant = static_cast<float>(constant);
  return out;
}

inline float byteAt(uint32_t texel, int channel) { return static_cast<float>(static_cast<int32_t>(texel >> 8 * channel & 255u)); }

// Round half up, as everywhere in the engine.
inline uint32_t toByte(float value) {
  return static_cast<uint32_t>(static_cast<int32_t>(std::min(std::max(value, 0.0f), 255.0f) + 0.5f));
}

void loadBlock(const uint8_t* slot, size_t first, uint32_t* texels) { std::memcpy(texels, slot + 4 * first, 4 * kBlock); }

void resolveLrgb(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  uint32_t high[kBlock], low[kBlock], colour[kBlock];
  for (size_t first = 0; first < kTexels; first += kBlock) {
    loadBlock(slots[0], first, high);
    loadBlock(slots[1], first, low);
    loadBlock(slots[2], first, colour);
    for (size_t i = 0; i < kBlock; ++i) {
      float lum = s.constant + byteAt(high[i], 0) * s.w[0] + byteAt(high[i], 1) * s.w[1] + byteAt(high[i], 2) * s.w[2] +
                  byteAt(low[i], 0) * s.w[3] + byteAt(low[i], 1) * s.w[4] + byteAt(low[i], 2) * s.w[5];
      colour[i] = toByte(byteAt(colour[i], 0) * lum) | toByte(byteAt(colour[i], 1) * lum) << 8 |
                  toByte(byteAt(colour[i], 2) * lum) << 16 | kOpaque;
    }
    std::memcpy(out + 4 * first, colour, 4 * kBlock);
  }
}

void resolveRgb(const Weights& s, std::span<const uint8_t* const> slots, uint8_t* out) {
  uint32_t texels[kBlock];
  float sum[3][kBlock];
  for (size_t first = 0; first < kTexels; first += kBlock) {
    for (auto& colour : sum) std::fill(colour, colour + kBlock, s.constant);
    for (int k = 0; k < 6; ++k) {
      loadBlock(slots[k], first, texels);
      const float w = s.w[k];
      for (size_t i = 0; i < kBlock; ++i) {
        sum[0][i] += byteAt(texels[i], 0) * w;
        sum[1][i] += byteAt(texels[i], 1) * w;
        sum[2][i] += byteAt(texels[i], 2) * w;
      }
    }
    for (size_t i = 0; i < kBlock; ++i) {
      texels[i] = toByte(sum[0][i]) | toByte(sum[1][i]) << 8 | toByte(sum[2][i]) << 16 | kOpaque;
    }
    std::memcpy(out + 4 * first, texels, 4 * kBlock);
  }
}

}  // namespace

void resolvePage(const TextureFormat& format, double u, double v, std::span<const uint8_t* const> slots, uint8_t* out) {
  assert(slots.size() >= static_cast<size_t>(format.planes()));
  switch (format.basis) {
    case Basis::kColour: {
      uint32_t texels[kBlock];
      for (size_t first = 0; first < kTexels; first += kBlock) {
        loadBlock(slots[0], first, texels);
        for (uint32_t& texel : texels) texel |= kOpaque;
        std::memcpy(out + 4 * first, texels, 4 * kBlock);
      }
      break;
    }
    // pixel = RGB * L / 255: the division is in the weights.
    case Basis::kPtmLrgb: resolveLrgb(weightsFor(format, u, v, 1.0 / 255), slots, out); break;
    case Basis::kPtmRgb: resolveRgb(weightsFor(format, u, v, 1), slots, out); break;
  }
}

}  // namespace relievo
