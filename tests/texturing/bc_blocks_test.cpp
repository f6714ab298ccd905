// Block decoders against the specification in double precision, written from its text and sharing nothing with them;
// encoders against bounds that follow from the formats.
#include "texturing/codec/bc_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

namespace relievo {
namespace bc_blocks_test {

constexpr uint32_t kSeed = 20261121;

struct Colour {
  double r, g, b;
};

// Khronos Data Format Specification 1.3, 18.1: BC1 without alpha.
std::array<Colour, 16> specBc1(const uint8_t* block) {
  const int c0 = block[0] | block[1] << 8, c1 = block[2] | block[3] << 8;
  auto colour = [](int c) { return Colour{(c >> 11) / 31.0, (c >> 5 & 63) / 63.0, (c & 31) / 31.0}; };
  auto mix = [](Colour a, Colour b, double w) {
    return Colour{(1 - w) * a.r + w * b.r, (1 - w) * a.g + w * b.g, (1 - w) * a.b + w * b.b};
  };
  Colour a = colour(c0), b = colour(c1);
  Colour table[4] = {a, b, c0 > c1 ? mix(a, b, 1 / 3.0) : mix(a, b, 0.5),
                     c0 > c1 ? mix(a, b, 2 / 3.0) : Colour{0, 0, 0}};
  std::array<Colour, 16> out;
  for (int i = 0; i < 16; ++i) out[static_cast<size_t>(i)] = table[block[4 + i / 4] >> (2 * (i % 4)) & 3];
  return out;
}

// 19.1: BC4, unsigned.
std::array<double, 16> specBc4(const uint8_t* block) {
  const double a = block[0] / 255.0, b = block[1] / 255.0;
  uint64_t codes = 0;
  for (int i = 0; i < 6; ++i) codes |= static_cast<uint64_t>(block[2 + i]) << (8 * i);
  std::array<double, 16> out;
  for (int i = 0; i < 16; ++i) {
    const int code = static_cast<int>(codes >> (3 * i) & 7);
    double v;
    if (code < 2) v = code == 0 ? a : b;
    else if (block[0] > block[1]) v = (a * (8 - code) + b * (code - 1)) / 7;
    else if (code < 6) v = (a * (6 - code) + b * (code - 1)) / 5;
    else v = code == 6 ? 0 : 1;
    out[static_cast<size_t>(i)] = v;
  }
  return out;
}

// 20: BC7, the one mode with a single line and no partition: mode 6, in real numbers (weights as the fractions that
// they round).
std::array<Colour, 16> specBc7Mode6(const uint8_t* block) {
  auto bits = [&](int from, int n) {
    int v = 0;
    for (int i = 0; i < n; ++i) v |= (block[(from + i) / 8] >> ((from + i) % 8) & 1) << i;
    return v;
  };
  int end[2][3];
  for (int c = 0; c < 3; ++c)
    for (int e = 0; e < 2; ++e) end[e][c] = bits(7 + 14 * c + 7 * e, 7) << 1 | bits(63 + e, 1);
  std::array<Colour, 16> out;
  for (int i = 0, at = 65; i < 16; ++i) {
    const int n = i == 0 ? 3 : 4;
    const double w = std::round(bits(at, n) * 64 / 15.0) / 64;
    at += n;
    auto mix = [&](int c) { return ((1 - w) * end[0][c] + w * end[1][c]) / 255; };
    out[static_cast<size_t>(i)] = {mix(0), mix(1), mix(2)};
  }
  return out;
}

std::vector<uint8_t> randomBytes(std::mt19937& random, size_t n) {
  std::vector<uint8_t> out(n);
  for (uint8_t& b : out) b = static_cast<uint8_t>(random());
  return out;
}

int roundedByte(double v) { return static_cast<int>(std::floor(v * 255 + 0.5)); }

TEST(BcDecode, Bc1IsTheSpecificationRounded) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 20000; ++n) {
    auto block = randomBytes(random, 8);
    if (n % 7 == 0) block[2] = block[0], block[3] = block[1];  // equal ends
    uint8_t texels[64];
    decodeBc1(block.data(), texels, 16);
    auto truth = specBc1(block.data());
    for (size_t i = 0; i < 16; ++i) {
      // A value within rounding errors of a half may go either way.
      for (auto [v, t] :
           {std::pair{texels[4 * i], truth[i].r}, {texels[4 * i + 1], truth[i].g}, {texels[4 * i + 2], truth[i].b}})
        ASSERT_NEAR(v, t * 255, 0.5 + 1e-9) << "seed " << kSeed << " block " << n;
      ASSERT_EQ(texels[4 * i + 3], 255);
    }
  }
}

TEST(BcDecode, Bc4IsTheSpecificationRounded) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 20000; ++n) {
    auto block = randomBytes(random, 8);
    uint8_t texels[64] = {};
    decodeBc4(block.data(), texels + 1, 4, 16);
    auto truth = specBc4(block.data());
    for (size_t i = 0; i < 16; ++i) {
      ASSERT_EQ(texels[4 * i + 1], roundedByte(truth[i])) << "seed " << kSeed << " block " << n << " texel " << i;
      ASSERT_EQ(texels[4 * i] + texels[4 * i + 2], 0) << "other channels are left alone";
    }
  }
}

TEST(BcDecode, Bc7Mode6IsTheSpecificationRounded) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 20000; ++n) {
    auto block = randomBytes(random, 16);
    block[0] = static_cast<uint8_t>((block[0] & 0x80) | 0x40);
    uint8_t texels[64];
    decodeBc7(block.data(), texels, 16);
    auto truth = specBc7Mode6(block.data());
    for (size_t i = 0; i < 16; ++i) {
      ASSERT_EQ(texels[4 * i], roundedByte(truth[i].r)) << "seed " << kSeed << " block " << n;
      ASSERT_EQ(texels[4 * i + 1], roundedByte(truth[i].g));
      ASSERT_EQ(texels[4 * i + 2], roundedByte(truth[i].b));
    }
  }
  // The reserved mode is black and transparent.
  uint8_t reserved[16] = {0, 1, 2, 3}, texels[64];
  std::fill(texels, texels + 64, uint8_t{7});
  decodeBc7(reserved, texels, 16);
  EXPECT_EQ(std::count(texels, texels + 64, 0), 64);
}

// Negative control: blocks whose ends are swapped are other texels.
TEST(BcDecode, SwappedEndsAreSeen) {
  std::mt19937 random(kSeed);
  int different = 0;
  for (int n = 0; n < 100; ++n) {
    auto block = randomBytes(random, 8);
    auto truth = specBc4(block.data());
    uint8_t texels[16];
    std::swap(block[0], block[1]);
    decodeBc4(block.data(), texels, 1, 4);
    for (size_t i = 0; i < 16; ++i) different += texels[i] != roundedByte(truth[i]);
  }
  EXPECT_GT(different, 500);
}

// Natural blocks: a gradient of some direction in space and colour, with noise.
std::array<uint8_t, 64> naturalBlock(std::mt19937& random, int noise) {
  std::array<uint8_t, 64> out{};
  double base[3], dx[3], dy[3];
  for (int c = 0; c < 3; ++c)
    base[c] = 30 + random() % 190, dx[c] = static_cast<int>(random() % 17) - 8,
    dy[c] = static_cast<int>(random() % 17) - 8;
  for (size_t i = 0; i < 16; ++i) {
    for (size_t c = 0; c < 3; ++c) {
      double v = base[c] + dx[c] * static_cast<double>(i % 4) + dy[c] * static_cast<double>(i / 4);
      if (noise) v += static_cast<int>(random() % static_cast<unsigned>(2 * noise + 1)) - noise;
      out[4 * i + c] = static_cast<uint8_t>(std::clamp(v, 0.0, 255.0));
    }
    out[4 * i + 3] = static_cast<uint8_t>(random());  // alpha is ignored
  }
  return out;
}

// Ends at the extremes leave a step of a seventh of the range, so at most half of it and the rounding of the value.
TEST(BcEncode, Bc4IsWithinAFourteenthOfTheBlocksRange) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 20000; ++n) {
    uint8_t values[16], block[8], out[16];
    const int low = static_cast<int>(random() % 256),
              range = static_cast<int>(random() % static_cast<unsigned>(256 - low)) + 1;
    for (uint8_t& v : values) v = static_cast<uint8_t>(low + static_cast<int>(random() % static_cast<unsigned>(range)));
    encodeBc4(values, block);
    decodeBc4(block, out, 1, 4);
    const int found = *std::max_element(values, values + 16) - *std::min_element(values, values + 16);
    for (int i = 0; i < 16; ++i)
      ASSERT_LE(std::abs(values[i] - out[i]), found / 14 + 1)
          << "seed " << kSeed << " block " << n << " range " << found;
  }
}

double meanSquare(const uint8_t* a, const uint8_t* b) {
  double sum = 0;
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 3; ++c) sum += (a[4 * i + c] - b[4 * i + c]) * (a[4 * i + c] - b[4 * i + c]);
  return sum / 48;
}

TEST(BcEncode, OneColourComesBackAsWellAsTheFormatCan) {
  for (int v = 0; v < 256; ++v) {
    std::array<uint8_t, 64> in{}, out{};
    for (size_t i = 0; i < 16; ++i)
      in[4 * i] = static_cast<uint8_t>(v), in[4 * i + 1] = static_cast<uint8_t>(255 - v),
             in[4 * i + 2] = static_cast<uint8_t>(v ^ 85);
    uint8_t block[16];
    encodeBc1(in.data(), block);
    decodeBc1(block, out.data(), 16);
    auto worst = [&] {
      int most = 0;
      for (size_t i = 0; i < 64; ++i) most = std::max(most, i % 4 == 3 ? 0 : std::abs(in[i] - out[i]));
      return most;
    };
    EXPECT_LE(worst(), 4) << v;  // half a step of 5 bits
    encodeBc7(in.data(), block);
    decodeBc7(block, out.data(), 16);
    EXPECT_LE(worst(), 1) << v;
    std::array<uint8_t, 16> flat, back;
    flat.fill(static_cast<uint8_t>(v));
    encodeBc4(flat.data(), block);
    decodeBc4(block, back.data(), 1, 4);
    EXPECT_EQ(flat, back);
  }
}

// The more bits, the better; each at least as good as a plain method with the format's bits would be.
TEST(BcEncode, NaturalBlocksKeepTheirQuality) {
  std::mt19937 random(kSeed);
  double bc1 = 0, bc4 = 0, bc7 = 0, single = 0;
  const int count = 2000;
  for (int n = 0; n < count; ++n) {
    auto in = naturalBlock(random, 4);
    std::array<uint8_t, 64> out{};
    uint8_t block[16];
    encodeBc1(in.data(), block);
    decodeBc1(block, out.data(), 16);
    bc1 += meanSquare(in.data(), out.data());
    encodeBc7(in.data(), block);
    decodeBc7(block, out.data(), 16);
    bc7 += meanSquare(in.data(), out.data());
    for (size_t c = 0; c < 3; ++c) {
      uint8_t values[16];
      for (size_t i = 0; i < 16; ++i) values[i] = in[4 * i + c];
      encodeBc4(values, block);
      decodeBc4(block, out.data() + c, 4, 16);
    }
    bc4 += meanSquare(in.data(), out.data());
    // Peer: the block's mean.
    double mean[3] = {};
    for (size_t i = 0; i < 64; ++i)
      if (i % 4 < 3) mean[i % 4] += in[i] / 16.0;
    for (size_t i = 0; i < 64; ++i) out[i] = i % 4 < 3 ? static_cast<uint8_t>(mean[i % 4] + 0.5) : 255;
    single += meanSquare(in.data(), out.data());
  }
  auto psnr = [&](double sum) { return 10 * std::log10(255 * 255 / (sum / count)); };
  RecordProperty("bc1_db", static_cast<int>(psnr(bc1) * 100));
  EXPECT_GT(psnr(bc1), 32);
  EXPECT_GT(psnr(bc7), 39);
  EXPECT_GT(psnr(bc4), 43);
  EXPECT_LT(psnr(single), psnr(bc1) - 3) << "the mean alone is worse than any of them";
}

TEST(BcEncode, AlphaIsIgnoredAndTheSameTexelsGiveTheSameBytes) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 500; ++n) {
    auto in = naturalBlock(random, n % 40), other = in;
    for (size_t i = 3; i < 64; i += 4) other[i] = static_cast<uint8_t>(random());
    uint8_t a[16], b[16];
    encodeBc7(in.data(), a);
    encodeBc7(other.data(), b);
    ASSERT_TRUE(std::equal(a, a + 16, b));
    encodeBc1(in.data(), a);
    encodeBc1(other.data(), b);
    ASSERT_TRUE(std::equal(a, a + 8, b));
  }
}

// What the encoder claims is what the decoder finds: no mode is written with its bits in the wrong place, which would
// show as an error much larger than the best single line's.
TEST(BcEncode, Bc7UsesItsModesAndEachPaysOff) {
  std::mt19937 random(kSeed);
  std::array<int, 9> used{};
  for (int n = 0; n < 6000; ++n) {
    auto in = naturalBlock(random, n % 3 == 0 ? 2 : 12);
    if (n % 3 == 1)  // two materials
      for (size_t i = 0; i < 64; ++i)
        if (i % 16 >= 8 && i % 4 < 3) in[i] = static_cast<uint8_t>(255 - in[i]);
    if (n % 3 == 2)  // a channel of its own
      for (size_t i = 0; i < 16; ++i)
        in[4 * i] = static_cast<uint8_t>(random()), in[4 * i + 1] = 40, in[4 * i + 2] = static_cast<uint8_t>(i * 9);
    uint8_t block[16];
    std::array<uint8_t, 64> out{};
    encodeBc7(in.data(), block);
    decodeBc7(block, out.data(), 16);
    ++used[static_cast<size_t>(block[0] ? __builtin_ctz(block[0]) : 8)];
    // No channel spans more than its range, so one line and 16 steps could not do worse than the block's own spread.
    double spread = 0;
    for (size_t c = 0; c < 3; ++c) {
      double mean = 0, sum = 0;
      for (size_t i = 0; i < 16; ++i) mean += in[4 * i + c] / 16.0;
      for (size_t i = 0; i < 16; ++i) sum += (in[4 * i + c] - mean) * (in[4 * i + c] - mean);
      spread += sum / 48;
    }
    ASSERT_LE(meanSquare(in.data(), out.data()), spread * 0.7 + 2)
        << "seed " << kSeed << " block " << n << " mode " << __builtin_ctz(block[0] | 256);
  }
  for (size_t mode : {1u, 3u, 6u}) EXPECT_GT(used[mode], 20) << mode;
  EXPECT_GT(used[4] + used[5], 20);
  EXPECT_EQ(used[8], 0);
}

}  // namespace bc_blocks_test
}  // namespace relievo
