// The engine's side of the way to the oracle, piece by piece and without GL: mip levels and pages.
#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include "tests/other_bases.h"
#include "tests/render/dense_pages.h"
#include "tests/render/dense_reference.h"
#include "texturing/codec/mip.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace dense_agrees_test {

constexpr uint32_t kSeed = 4711;

// Formats as files have them, and ones that reach the rule's limits.
std::vector<TextureFormat> formats(std::mt19937& random) {
  std::vector<TextureFormat> out;
  TextureFormat f;
  out.push_back(f);
  f.basis = Basis::kPtmRgb;
  out.push_back(f);
  f.basis = Basis::kPtmLrgb;
  out.push_back(f);
  f.scale = {2, 2, 1, 1.5, 1.5, 1.25};
  f.bias = {172, 155, 121, 110, 98, 3};
  out.push_back(f);
  for (double magnitude : {0.01, 1.0, 30.0, 1e6}) {
    for (int k = 0; k < 6; ++k) {
      f.scale[k] = magnitude * std::uniform_real_distribution<double>(-1, 1)(random);
      f.bias[k] = std::uniform_real_distribution<double>(-50, 300)(random);
    }
    out.push_back(f);
  }
  for (Basis basis : test::otherBases()) out.push_back(test::otherFormat(basis));
  return out;
}

TEST(DenseAgrees, MipFilterEqualsTheOracle) {
  std::cout << "seed " << kSeed << "\n";
  std::mt19937 random(kSeed);
  uint64_t compared = 0;
  for (const TextureFormat& f : formats(random)) {
    for (int repeat = 0; repeat < 20; ++repeat) {
      const int w = 2 * (1 + static_cast<int>(random() % 40)), h = 2 * (1 + static_cast<int>(random() % 40)),
                n = f.channels();
      const int range = repeat % 3 == 0 ? 65281 : repeat % 3 == 1 ? 2000 : 65281;
      std::vector<uint16_t> planes(size_t(w) * h * n), interleaved(planes.size());
      for (auto& v : planes) v = static_cast<uint16_t>(random() % static_cast<uint32_t>(range));
      if (repeat % 3 == 2)  // as at the finest level
        for (auto& v : planes) v &= 0xFF00;
      for (int c = 0; c < n; ++c)
        for (int i = 0; i < w * h; ++i) interleaved[size_t(i) * n + c] = planes[size_t(c) * w * h + i];
      const auto expected = denseDownsample(f, interleaved, w, h);
      std::vector<uint16_t> found(planes.size() / 4);
      MipFilter(f).downsample(planes.data(), w, h, found.data());
      for (int c = 0; c < n; ++c)
        for (int i = 0; i < w * h / 4; ++i, ++compared)
          ASSERT_EQ(found[size_t(c) * w * h / 4 + i], expected[size_t(i) * n + c])
              << basisName(f.basis) << " channel " << c;
    }
  }
  EXPECT_GT(compared, 100000u);
}

TEST(DenseAgrees, NegativeControlPlainMeansAreNotTheRule) {
  std::mt19937 random(kSeed);
  TextureFormat lrgb, numbers;
  lrgb.basis = Basis::kPtmLrgb;
  numbers.basis = Basis::kPtmRgb;
  std::vector<uint16_t> in(4 * 9), wide(4 * 18);
  size_t different = 0;
  for (int repeat = 0; repeat < 100; ++repeat) {
    for (int i = 0; i < 4; ++i)
      for (int c = 0; c < 9; ++c) wide[i * 18 + c] = in[i * 9 + c] = static_cast<uint16_t>((random() & 255) << 8);
    const auto weighted = denseDownsample(lrgb, in, 2, 2), plain = denseDownsample(numbers, wide, 2, 2);
    for (int c = 0; c < 9; ++c) different += weighted[c] != plain[c];
  }
  EXPECT_GT(different, 200u);
}

}  // namespace dense_agrees_test
}  // namespace relievo
