// Lossless on every kind of content; any bytes decode or fail cleanly.
#include "texturing/codec/page_codec.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

namespace relievo {
namespace {

constexpr int kSide = kPageFullPx;
using Fill = std::function<int(std::mt19937&, int c, int x, int y)>;

struct Content {
  const char* name;
  Fill fill;
};

std::vector<Content> contents() {
  return {
      {"zero", [](auto&, int, int, int) { return 0; }},
      {"constants", [](auto&, int c, int, int) { return 77 * c; }},
      {"one constant channel", [](auto& r, int c, int x, int) { return c == 1 ? 200 : x + static_cast<int>(r() % 3); }},
      {"ramps", [](auto&, int c, int x, int y) { return c == 0   ? x
                                                        : c == 1 ? 2 * y
                                                                 : x + 3 * y; }},
      {"smooth and noisy",
       [](auto& r, int c, int x, int y) {
         return static_cast<int>(128 + 90 * std::sin(0.05 * x + c) * std::cos(0.04 * y)) + static_cast<int>(r() % 9);
       }},
      {"noise", [](auto& r, int, int, int) { return static_cast<int>(r()); }},
      {"black and white", [](auto& r, int, int, int) { return r() % 2 ? 0 : 65535; }},
      {"checker", [](auto&, int, int x, int y) { return (x + y) % 2 ? 65535 : 0; }},
      {"last texel differs", [](auto&, int, int x, int y) { return x >= 128 && y >= 128; }},
  };
}

std::vector<uint8_t> texturePage(const Fill& fill, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<uint8_t> out;
  for (int c = 0; c < 3; ++c)
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) out.push_back(static_cast<uint8_t>(fill(random, c, x, y)));
  return out;
}
std::vector<uint16_t> reliefPage(const Fill& fill, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<uint16_t> out;
  for (int y = 0; y < kReliefSamples; ++y)
    for (int x = 0; x < kReliefSamples; ++x) out.push_back(static_cast<uint16_t>(37 * fill(random, 1, x, y)));
  return out;
}

TEST(PageCodec, textureComesBackBitForBit) {
  for (int level : {-5, 1, 9}) {
    PageEncoder encoder(level);
    PageDecoder decoder;
    for (const Content& content : contents()) {
      auto page = texturePage(content.fill, 1);
      auto encoded = encoder.encodeTexture(page);
      EXPECT_LE(encoded.size(), kTexturePageBytes + 4) << content.name;
      std::vector<uint8_t> out(kTexturePageBytes, 0xAA);
      auto decoded = decoder.decodeTexture(encoded, out);
      ASSERT_TRUE(decoded.ok()) << content.name << ": " << decoded.error().text();
      EXPECT_EQ(out, page) << content.name;
    }
  }
}

TEST(PageCodec, reliefComesBackBitForBit) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  for (const Content& content : contents()) {
    auto page = reliefPage(content.fill, 2);
    auto encoded = encoder.encodeRelief(page);
    EXPECT_LE(encoded.size(), kReliefPageSamples * 2 + 2) << content.name;
    std::vector<uint16_t> out(kReliefPageSamples, 0xAAAA);
    auto decoded = decoder.decodeRelief(encoded, out);
    ASSERT_TRUE(decoded.ok()) << content.name << ": " << decoded.error().text();
    EXPECT_EQ(out, page) << content.name;
  }
}

TEST(PageCodec, smoothPagesShrinkAndNoiseDoesNotGrow) {
  PageEncoder encoder(1);
  auto all = contents();
  EXPECT_LT(encoder.encodeTexture(texturePage(all[1].fill, 1)).size(), 32u);
  EXPECT_LT(encoder.encodeTexture(texturePage(all[3].fill, 1)).size(), 3000u);
  EXPECT_LT(encoder.encodeTexture(texturePage(all[4].fill, 1)).size(), kTexturePageBytes * 6 / 10);
  EXPECT_EQ(encoder.encodeTexture(texturePage(all[5].fill, 1)).size(), kTexturePageBytes + 4);
}

TEST(PageCodec, theSameBytesAgain) {
  PageEncoder a(1), b(1);
  auto all = contents();
  auto page = texturePage(all[4].fill, 7), other = texturePage(all[5].fill, 8);
  auto first = a.encodeTexture(page);
  std::vector<uint8_t> kept(first.begin(), first.end());
  b.encodeTexture(other);  // what an encoder did before leaves no trace
  auto second = b.encodeTexture(page);
  EXPECT_TRUE(std::equal(kept.begin(), kept.end(), second.begin(), second.end()));
}

TEST(PageCodec, slotsHoldWhatThePagePoolUploads) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto page = texturePage(contents()[4].fill, 3);
  std::vector<uint8_t> slot(kSlotBytes, 0xAA);
  ASSERT_TRUE(decoder.decodeToSlot(Plane::kTexture0, encoder.encodeTexture(page), slot).ok());
  const size_t n = size_t{kSide} * kSide;
  for (size_t i = 0; i < n; ++i) {
    ASSERT_EQ(slot[4 * i], page[i]);
    ASSERT_EQ(slot[4 * i + 1], page[n + i]);
    ASSERT_EQ(slot[4 * i + 2], page[2 * n + i]);
    ASSERT_EQ(slot[4 * i + 3], 255);
  }
  auto relief = reliefPage(contents()[4].fill, 4);
  std::fill(slot.begin(), slot.end(), uint8_t{0xAA});
  ASSERT_TRUE(decoder.decodeToSlot(Plane::kRelief, encoder.encodeRelief(relief), slot).ok());
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const uint8_t* t = slot.data() + 4 * (static_cast<size_t>(j) * kSide + static_cast<size_t>(i));
      int v = i < kReliefSamples && j < kReliefSamples ? relief[static_cast<size_t>(j * kReliefSamples + i)] : 0;
      ASSERT_EQ(t[0], v >> 8);
      ASSERT_EQ(t[1], v & 255);
      ASSERT_EQ(t[2] + t[3], 0);
    }
  }
}

TEST(PageCodec, everyTruncationFails) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  std::vector<uint8_t> out(kTexturePageBytes), slot(kSlotBytes);
  std::vector<uint16_t> samples(kReliefPageSamples);
  for (int which : {1, 2, 3}) {
    auto span = encoder.encodeTexture(texturePage(contents()[static_cast<size_t>(which)].fill, 1));
    std::vector<uint8_t> whole(span.begin(), span.end());
    size_t step = std::max<size_t>(1, whole.size() / 3000);
    for (size_t n = 0; n < whole.size(); n += step) {
      std::vector<uint8_t> cut(
          whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));  // its own allocation: ASan sees an overrun
      EXPECT_FALSE(decoder.decodeTexture(cut, out).ok()) << n;
    }
    EXPECT_TRUE(decoder.decodeTexture(whole, out).ok());
    whole.push_back(0);
    EXPECT_FALSE(decoder.decodeTexture(whole, out).ok()) << "a byte too many";
    auto relief = encoder.encodeRelief(reliefPage(contents()[static_cast<size_t>(which)].fill, 1));
    std::vector<uint8_t> whole_relief(relief.begin(), relief.end());
    step = std::max<size_t>(1, whole_relief.size() / 3000);
    for (size_t n = 0; n < whole_relief.size(); n += step) {
      std::vector<uint8_t> cut(whole_relief.begin(), whole_relief.begin() + static_cast<std::ptrdiff_t>(n));
      EXPECT_FALSE(decoder.decodeRelief(cut, samples).ok()) << n;
    }
  }
}

TEST(PageCodec, anyBytesDecodeOrFailCleanly) {
  const uint32_t seed = 99;
  RecordProperty("seed", static_cast<int>(seed));
  std::mt19937 random(seed);
  PageEncoder encoder(1);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes);
  auto texture = encoder.encodeTexture(texturePage(contents()[4].fill, 1));
  std::vector<uint8_t> good_texture(texture.begin(), texture.end());
  auto relief = encoder.encodeRelief(reliefPage(contents()[4].fill, 1));
  std::vector<uint8_t> good_relief(relief.begin(), relief.end());
  int decoded = 0;
  for (int i = 0; i < 4000; ++i) {
    std::vector<uint8_t> bytes = i % 2 ? good_texture : good_relief;
    int flips = 1 + static_cast<int>(random() % 8);
    for (int f = 0; f < flips; ++f)
      bytes[random() % (random() % 4 ? bytes.size() : 24)] ^= static_cast<uint8_t>(1u << (random() % 8));
    if (random() % 16 == 0) bytes.resize(random() % 64);
    decoded += decoder.decodeToSlot(i % 4 < 2 ? Plane::kTexture0 : Plane::kRelief, bytes, slot).ok();
  }
  // The codec alone cannot see every flip (the package's checksum does): some decode, to other texels.
  EXPECT_GT(decoded, 0);
  EXPECT_LT(decoded, 4000);
}

}  // namespace
}  // namespace relievo
