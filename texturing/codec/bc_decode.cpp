#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include "texturing/codec/bc7_layout.h"
#include "texturing/codec/bc_blocks.h"

namespace relievo {
namespace {

static_assert(std::endian::native == std::endian::little);

template <class T>
T load(const uint8_t* p) {
  T v;
  std::memcpy(&v, p, sizeof v);
  return v;
}

// round(255 i / n) for i = 0..n.
template <int kSteps>
constexpr std::array<uint8_t, kSteps + 1> roundedScale() {
  std::array<uint8_t, kSteps + 1> out{};
  for (int i = 0; i <= kSteps; ++i)
    out[static_cast<size_t>(i)] = static_cast<uint8_t>((2 * 255 * i + kSteps) / (2 * kSteps));
  return out;
}
// A channel of 5 or 6 bits, in thirds (two weights that add up to 3) and in halves.
constexpr auto kThirds5 = roundedScale<93>();
constexpr auto kHalves5 = roundedScale<62>();
constexpr auto kThirds6 = roundedScale<189>();
constexpr auto kHalves6 = roundedScale<126>();

constexpr uint32_t pack(uint32_t r, uint32_t g, uint32_t b) { return r | g << 8 | b << 16 | 0xFF000000u; }

}  // namespace

void decodeBc1(const uint8_t* block, uint8_t* first, size_t row_bytes) {
  const uint32_t c0 = load<uint16_t>(block), c1 = load<uint16_t>(block + 2);
  uint32_t indices = load<uint32_t>(block + 4);
  const uint32_t r0 = c0 >> 11, g0 = c0 >> 5 & 63, b0 = c0 & 31, r1 = c1 >> 11, g1 = c1 >> 5 & 63, b1 = c1 & 31;
  auto thirds = [&](uint32_t w0, uint32_t w1) {
    return pack(kThirds5[w0 * r0 + w1 * r1], kThirds6[w0 * g0 + w1 * g1], kThirds5[w0 * b0 + w1 * b1]);
  };
  uint32_t palette[4] = {thirds(3, 0), thirds(0, 3), 0, pack(0, 0, 0)};
  if (c0 > c1) {
    palette[2] = thirds(2, 1);
    palette[3] = thirds(1, 2);
  } else {
    palette[2] = pack(kHalves5[r0 + r1], kHalves6[g0 + g1], kHalves5[b0 + b1]);
  }
  for (int y = 0; y < 4; ++y, first += row_bytes) {
    uint32_t row[4];
    for (int x = 0; x < 4; ++x, indices >>= 2) row[x] = palette[indices & 3];
    std::memcpy(first, row, sizeof row);
  }
}

void decodeBc4(const uint8_t* block, uint8_t* first, size_t texel_bytes, size_t row_bytes) {
  uint64_t bits = load<uint64_t>(block);
  const uint32_t a = bits & 255, b = bits >> 8 & 255;
  bits >>= 16;
  // Rounded to the nearest: 7 and 5 are odd, so nothing lies halfway.
  uint8_t palette[8] = {static_cast<uint8_t>(a), static_cast<uint8_t>(b)};
  if (a > b) {
    for (uint32_t k = 1; k < 7; ++k) palette[k + 1] = static_cast<uint8_t>(((7 - k) * a + k * b + 3) / 7);
  } else {
    for (uint32_t k = 1; k < 5; ++k) palette[k + 1] = static_cast<uint8_t>(((5 - k) * a + k * b + 2) / 5);
    palette[6] = 0;
    palette[7] = 255;
  }
  for (int y = 0; y < 4; ++y, first += row_bytes)
    for (size_t x = 0; x < 4; ++x, bits >>= 3) first[x * texel_bytes] = palette[bits & 7];
}

void decodeBc7(const uint8_t* block, uint8_t* first, size_t row_bytes) {
  __extension__ typedef unsigned __int128 Bits;
  Bits bits = load<Bits>(block);
  auto take = [&bits](int n) {
    uint32_t v = static_cast<uint32_t>(bits) & ((1u << n) - 1);
    bits >>= n;
    return v;
  };
  uint32_t out[16] = {};
  auto store = [&] {
    for (int y = 0; y < 4; ++y) std::memcpy(first + static_cast<size_t>(y) * row_bytes, out + 4 * y, 16);
  };
  if (block[0] == 0) return store();  // reserved: all zeros
  const int mode_number = std::countr_zero(block[0]);
  const bc7::Mode& m = bc7::kModes[mode_number];
  bits >>= mode_number + 1;
  const int partition = static_cast<int>(take(m.partition_bits));
  const int rotation = static_cast<int>(take(m.rotation_bits));
  const bool selection = take(m.selection_bits) != 0;
  const int ends = 2 * m.subsets;
  uint32_t e[6][4];
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < ends; ++i) e[i][c] = take(m.colour_bits);
  for (int i = 0; i < ends; ++i) e[i][3] = m.alpha_bits ? take(m.alpha_bits) : 255;
  int colour_bits = m.colour_bits, alpha_bits = m.alpha_bits;
  if (m.endpoint_p || m.shared_p) {
    uint32_t p = 0;
    for (int i = 0; i < ends; ++i) {
      if (m.endpoint_p || i % 2 == 0) p = take(1);
      for (int c = 0; c < (alpha_bits ? 4 : 3); ++c) e[i][c] = e[i][c] << 1 | p;
    }
    ++colour_bits;
    if (alpha_bits) ++alpha_bits;
  }
  for (int i = 0; i < ends; ++i) {
    for (int c = 0; c < 3; ++c) e[i][c] = e[i][c] << (8 - colour_bits) | e[i][c] >> (2 * colour_bits - 8);
    if (alpha_bits) e[i][3] = e[i][3] << (8 - alpha_bits) | e[i][3] >> (2 * alpha_bits - 8);
  }
  auto mix = [](uint32_t a, uint32_t b, uint32_t w) { return ((64 - w) * a + w * b + 32) >> 6; };
  if (m.index2_bits == 0) {
    const uint8_t* weight = bc7::weights(m.index_bits);
    uint32_t palette[3][16];
    for (int s = 0; s < m.subsets; ++s) {
      const uint32_t *a = e[2 * s], *b = e[2 * s + 1];
      for (int k = 0; k < 1 << m.index_bits; ++k) {
        uint32_t w = weight[k];
        palette[s][k] =
            mix(a[0], b[0], w) | mix(a[1], b[1], w) << 8 | mix(a[2], b[2], w) << 16 | mix(a[3], b[3], w) << 24;
      }
    }
    uint64_t indices = static_cast<uint64_t>(bits);  // at most 63 bits
    const int anchor1 = m.subsets > 1 ? bc7::anchorOf(m.subsets, partition, 1) : 0;
    const int anchor2 = m.subsets > 2 ? bc7::anchorOf(m.subsets, partition, 2) : 0;
    for (int i = 0; i < 16; ++i) {
      const int n = m.index_bits - (i == 0 || i == anchor1 || i == anchor2);
      out[i] = palette[bc7::subsetOf(m.subsets, partition, i)][indices & ((1u << n) - 1)];
      indices >>= n;
    }
    return store();
  }
  // Modes 4 and 5: colour and alpha have indices of their own; then alpha may change places with a colour.
  uint64_t first_indices = static_cast<uint64_t>(bits) & ((uint64_t{1} << (16 * m.index_bits - 1)) - 1);
  uint64_t second_indices = static_cast<uint64_t>(bits >> (16 * m.index_bits - 1));
  for (int i = 0; i < 16; ++i) {
    const int n1 = m.index_bits - (i == 0), n2 = m.index2_bits - (i == 0);
    uint32_t w1 = bc7::weights(m.index_bits)[first_indices & ((1u << n1) - 1)];
    uint32_t w2 = bc7::weights(m.index2_bits)[second_indices & ((1u << n2) - 1)];
    first_indices >>= n1;
    second_indices >>= n2;
    if (selection) std::swap(w1, w2);
    uint32_t t[4] = {mix(e[0][0], e[1][0], w1), mix(e[0][1], e[1][1], w1), mix(e[0][2], e[1][2], w1),
                     mix(e[0][3], e[1][3], w2)};
    if (rotation) std::swap(t[3], t[rotation - 1]);
    out[i] = t[0] | t[1] << 8 | t[2] << 16 | t[3] << 24;
  }
  store();
}

}  // namespace relievo
