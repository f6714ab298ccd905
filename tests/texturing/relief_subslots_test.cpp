// Relief pages in parts of slots: which part is enough, and that every sample comes back bit for bit, as patch.vert
// reads it.
#include "texturing/stream/relief_subslots.h"

#include <gtest/gtest.h>

#include <array>
#include <random>
#include <vector>

namespace relievo {
namespace relief_subslots_test {

using Samples = std::vector<int>;  // kReliefSamples a side

std::vector<uint8_t> slotOf(const Samples& samples) {
  std::vector<uint8_t> texels(kSlotBytes);
  for (int y = 0; y < kReliefSamples; ++y)
    for (int x = 0; x < kReliefSamples; ++x) {
      const int q = samples[static_cast<size_t>(y * kReliefSamples + x)];
      uint8_t* t = texels.data() + 4 * (y * kPageFullPx + x);
      t[0] = static_cast<uint8_t>(q >> 8);
      t[1] = static_cast<uint8_t>(q & 255);
    }
  return texels;
}

// reliefSample() of shaders/common.glsl. one_a_texel: as if a texel held one sample, for the control.
int sampleIn(const std::vector<uint8_t>& part, int level, int x, int y, bool one_a_texel) {
  const uint8_t* texel = part.data() + 4 * (y * partColumns(level) + (x >> 1));
  if (!one_a_texel) texel += 2 * (x & 1);
  return texel[0] * 256 + texel[1];
}

// heightQ8() of shaders/patch.vert over a base mesh, at a place of the whole page. rounded: false: as elsewhere, for
// the control.
int heightQ8(const std::vector<uint8_t>& part, int level, int x, int y, bool one_a_texel = false, bool rounded = true) {
  const int bits = level - kReliefPartLevel, mask = (1 << bits) - 1;
  const int sx = x >> bits, sy = y >> bits, fx = x & mask, fy = y & mask;
  const int q00 = sampleIn(part, level, sx, sy, one_a_texel);
  if ((fx | fy) == 0) return q00 << 8;
  const int tx = std::min(sx + 1, kPagePx), ty = std::min(sy + 1, kPagePx);
  const int q11 = sampleIn(part, level, tx, ty, one_a_texel);
  int value = q00 << bits;
  if (fx >= fy) {
    const int q10 = sampleIn(part, level, tx, sy, one_a_texel);
    value += fx * (q10 - q00) + fy * (q11 - q10);
  } else {
    const int q01 = sampleIn(part, level, sx, ty, one_a_texel);
    value += fy * (q01 - q00) + fx * (q11 - q01);
  }
  return rounded ? ((value + (1 << (bits - 1))) >> bits) << 8 : value << (8 - bits);
}

int differing(const Samples& samples, int level, bool one_a_texel = false, bool rounded = true) {
  std::vector<uint8_t> part(partBytes(level), 0xEE);
  packRelief(slotOf(samples), level, part);
  int count = 0;
  for (int y = 0; y < kReliefSamples; ++y)
    for (int x = 0; x < kReliefSamples; ++x)
      count += heightQ8(part, level, x, y, one_a_texel, rounded) != samples[static_cast<size_t>(y * kReliefSamples + x)]
                                                                        << 8;
  return count;
}

// Random samples every 2^up a side, between them as MeshBake::heights() puts them there.
Samples coarsePage(std::mt19937& random, int up) {
  const int n = kPagePx >> up, cells = 1 << up;
  Samples coarse(static_cast<size_t>((n + 1) * (n + 1))), out(kReliefPageSamples);
  for (int& q : coarse) q = static_cast<int>(random() % 65536);
  for (int y = 0; y <= kPagePx; ++y)
    for (int x = 0; x <= kPagePx; ++x) {
      const int cx = std::min(x >> up, n - 1), cy = std::min(y >> up, n - 1), fx = x - (cx << up), fy = y - (cy << up);
      const int* c = coarse.data() + cy * (n + 1) + cx;
      const int sum = fx >= fy ? c[0] * (cells - fx) + c[1] * (fx - fy) + c[n + 2] * fy
                               : c[0] * (cells - fy) + c[n + 1] * (fy - fx) + c[n + 2] * fx;
      out[static_cast<size_t>(y * kReliefSamples + x)] = (sum + cells / 2) >> up;
    }
  return out;
}

TEST(ReliefParts, EverySampleComesBackFromTheSmallestPart) {
  std::mt19937 random(20261122);
  for (int up = 0; up <= 2; ++up)
    for (int i = 0; i < 20; ++i) {
      const Samples samples = coarsePage(random, up);
      ASSERT_EQ(reliefPartLevel(slotOf(samples), ReliefParts::kSmall), kReliefPartLevel + up);
      for (int level : {kReliefPartLevel, kReliefPartLevel + up}) {  // the first: where no smaller one was to be had
        ASSERT_EQ(differing(samples, level), 0) << "2^" << 7 - up << " cells, level " << level;
        EXPECT_GT(differing(samples, level, true), 1000) << "a texel taken for one sample is seen";
      }
      if (up == 0) continue;
      EXPECT_GT(differing(samples, kReliefPartLevel + up, false, false), 1000) << "heights left unrounded are seen";
    }
}

TEST(ReliefParts, OneSampleThatDoesNotFollowKeepsTheWholePage) {
  std::mt19937 random(7);
  const Samples flat(kReliefPageSamples, 1234);
  EXPECT_EQ(reliefPartLevel(slotOf(flat), ReliefParts::kSmall), 3);
  for (int i = 0; i < 300; ++i) {
    const int up = 1 + i % 2;
    Samples samples = coarsePage(random, up);
    int x = 0, y = 0;
    while (((x | y) & ((1 << up) - 1)) == 0)
      x = static_cast<int>(random() % kReliefSamples), y = static_cast<int>(random() % kReliefSamples);
    int& q = samples[static_cast<size_t>(y * kReliefSamples + x)];
    q += q < 32768 ? 1 : -1;
    const int level = reliefPartLevel(slotOf(samples), ReliefParts::kSmall);
    ASSERT_LT(level, kReliefPartLevel + up) << x << ", " << y;
    ASSERT_EQ(differing(samples, level), 0);
  }
}

}  // namespace relief_subslots_test
}  // namespace relievo
