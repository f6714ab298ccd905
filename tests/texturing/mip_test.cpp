// The mip rule against a naive reading of its documentation, and against what it is for: light that adds up.
#include "texturing/codec/mip.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "package_fixture.h"

namespace relievo {
namespace mip_test {

using namespace testing_support;

// Even size by repeating the border, as the builder does.
std::vector<uint16_t> padded(const NaiveImage& image, int width, int height) {
  std::vector<uint16_t> out;
  for (size_t c = 0; c < image.channels.size(); ++c)
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) out.push_back(static_cast<uint16_t>(image.at(static_cast<int>(c), x, y)));
  return out;
}

TEST(Mip, equalsTheNaiveRuleOnOddSizesAtEveryLevel) {
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kAlbedoNormal}) {
    for (auto [w, h] : {std::pair{1, 1}, {2, 1}, {3, 7}, {64, 48}, {101, 37}}) {
      NoisyTexture source(w, h, basis, 5, 60);
      MipFilter filter(source.format());
      NaiveImage level = naiveFinest(source);
      for (bool first = true; level.width > 1 || level.height > 1 || first; first = false) {
        int width = static_cast<int>(level.width + 1) / 2 * 2, height = static_cast<int>(level.height + 1) / 2 * 2;
        auto in = padded(level, width, height);
        std::vector<uint16_t> out(in.size() / 4);
        filter.downsample(in.data(), width, height, out.data());
        NaiveImage coarser = naiveCoarser(level, source.format());
        ASSERT_EQ(out, padded(coarser, width / 2, height / 2)) << basisName(basis) << " " << width << " x " << height;
        if (first) {  // the byte form of the finest level
          std::vector<uint8_t> bytes;
          for (uint16_t v : in) bytes.push_back(static_cast<uint8_t>(v >> 8));
          std::vector<uint16_t> from_bytes(out.size());
          filter.downsample(bytes.data(), width, height, from_bytes.data());
          ASSERT_EQ(from_bytes, out);
        }
        level = coarser;
      }
    }
  }
}

// So bright that many weights are the largest that there is.
TEST(Mip, equalsTheNaiveRuleWhereWeightsAreClamped) {
  NoisyTexture source(64, 48, Basis::kPtmLrgb, 5, 120);
  TextureFormat format = source.format();
  format.scale[5] = 8;
  const NaiveImage level = naiveFinest(source);
  const auto in = padded(level, 64, 48);
  std::vector<uint16_t> out(in.size() / 4);
  MipFilter(format).downsample(in.data(), 64, 48, out.data());
  EXPECT_EQ(out, padded(naiveCoarser(level, format), 32, 24));
}

TEST(Mip, aBorderRepeatsTheNearestTexel) {
  constexpr int kWidth = 7, kHeight = 6, kX0 = 2, kX1 = 5, kY0 = 1, kY1 = 4;
  std::vector<uint8_t> data(size_t{2} * kWidth * kHeight);
  for (size_t i = 0; i < data.size(); ++i) data[i] = static_cast<uint8_t>(3 * i + 1);
  const std::vector<uint8_t> before = data;
  repeatBorder(data.data(), kWidth, kHeight, 2, kX0, kY0, kX1, kY1);
  for (int c = 0; c < 2; ++c)
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const int from_x = std::clamp(x, kX0, kX1 - 1), from_y = std::clamp(y, kY0, kY1 - 1);
        EXPECT_EQ(data[static_cast<size_t>((c * kHeight + y) * kWidth + x)],
                  before[static_cast<size_t>((c * kHeight + from_y) * kWidth + from_x)])
            << c << " " << x << " " << y;
      }
}

TEST(Mip, constantImagesStayAsTheyAre) {
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kAlbedoNormal}) {
    TextureFormat format = sampleFormat(basis);
    MipFilter filter(format);
    for (int value = 0; value < 256; ++value) {
      std::vector<uint16_t> in(static_cast<size_t>(format.channels()) * 64 * 64, static_cast<uint16_t>(value << 8));
      for (int size = 64; size > 1; size /= 2) {
        std::vector<uint16_t> out(in.size() / 4);
        filter.downsample(in.data(), size, size, out.data());
        for (uint16_t v : out) ASSERT_EQ(byteFromLevel(v), value) << basisName(basis);
        in = out;
      }
    }
  }
}

TEST(Mip, colourAveragesInLinearLight) {
  TextureFormat colour;
  MipFilter filter(colour);
  std::vector<uint16_t> in;
  for (int c = 0; c < 3; ++c) in.insert(in.end(), {0, 65280, 65280, 0});
  std::vector<uint16_t> out(3);
  filter.downsample(in.data(), 2, 2, out.data());
  // Half the light of white is sRGB 187.5 of 255; a mean of the numbers (the negative control) would be 127.5.
  EXPECT_NEAR(out[0] / 256.0, 255 * (1.055 * std::pow(0.5, 1 / 2.4) - 0.055), 0.05);
  EXPECT_GT(out[0] / 256.0, 180);
}

TEST(Mip, lrgbChromaWeightedByLuminanceKeepsTheProduct) {
  // A bright red texel beside dark blue ones: what is seen from afar is red.
  TextureFormat format = sampleFormat(Basis::kPtmLrgb);
  MipFilter filter(format);
  const uint64_t seed = 3;
  std::mt19937 random(seed);
  double weighted_error = 0, plain_error = 0;
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<uint16_t> in(9 * 4);
    for (auto& v : in) v = static_cast<uint16_t>((random() % 256) << 8);
    std::vector<uint16_t> out(9);
    filter.downsample(in.data(), 2, 2, out.data());
    for (int c = 6; c < 9; ++c) {
      double truth = 0, luminance = 0, plain = 0;
      for (int i = 0; i < 4; ++i) {
        double l = 0;
        const double mean[6] = {1.0 / 3, 1.0 / 3, 0, 0, 0, 1};
        for (int k = 0; k < 6; ++k)
          l += mean[k] * (in[static_cast<size_t>(4 * k + i)] / 256.0 - format.bias[static_cast<size_t>(k)]) *
               format.scale[static_cast<size_t>(k)];
        l = std::max(l, 0.25);
        truth += l * in[static_cast<size_t>(4 * c + i)] / 256.0 / 4;
        luminance += l / 4;
        plain += in[static_cast<size_t>(4 * c + i)] / 256.0 / 4;
      }
      weighted_error += std::abs(luminance * out[static_cast<size_t>(c)] / 256.0 - truth) / 255;
      plain_error += std::abs(luminance * plain - truth) / 255;
    }
  }
  EXPECT_LT(weighted_error, plain_error / 20);
}

TEST(Mip, extremeScalesAndBiasesAreHarmless) {
  for (double scale : {0.0, 1e-30, -3.0, 1e6, 1e300}) {
    for (double bias : {0.0, 255.0, -1e9, 1e300}) {
      TextureFormat format = sampleFormat(Basis::kPtmLrgb);
      format.scale.fill(scale);
      format.bias.fill(bias);
      MipFilter filter(format);
      std::vector<uint16_t> in(9 * 16, 65280), out(9 * 4);
      for (size_t i = 0; i < in.size(); i += 3) in[i] = 0;
      filter.downsample(in.data(), 4, 4, out.data());
      for (uint16_t v : out) EXPECT_LE(v, 65280);
    }
  }
}

}  // namespace mip_test
}  // namespace relievo
