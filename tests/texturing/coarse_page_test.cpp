// Texture pages in fewer texels: what is drawn of them lies within the tolerances, or they are stored as they are.
#include "texturing/codec/coarse_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "tests/texturing/page_of.h"
#include "texturing/codec/page_codec.h"

namespace relievo::coarse_page_test {
namespace {

constexpr uint32_t kSeed = 20261127;
constexpr int kSide = kPageFullPx;
constexpr size_t kChannel = size_t{kSide} * kSide;
using Page = std::vector<uint8_t>;

using testing_support::pageOf;

Page waves(double per_page) {
  return pageOf([=](int c, int x, int y) {
    return 128 + 60 * std::sin(6.28 * per_page * x / kSide + c) * std::cos(6.28 * per_page * y / kSide);
  });
}
Page noise() {
  std::mt19937 random(kSeed);
  return pageOf([&](int, int, int) { return static_cast<double>(random() % 256); });
}

// A bilinear filter in double precision, of a texture that goes on in a straight line beyond the outermost centres.
double filtered(std::span<const uint8_t> channel, int side, double x, double y) {
  auto texel = [&](double i, double j) {
    return static_cast<double>(channel[static_cast<size_t>(j) * static_cast<size_t>(side) + static_cast<size_t>(i)]);
  };
  const double i = std::clamp(std::floor(x - 0.5), 0.0, side - 2.0),
               j = std::clamp(std::floor(y - 0.5), 0.0, side - 2.0), u = x - 0.5 - i, v = y - 0.5 - j;
  const double value = (texel(i, j) * (1 - u) + texel(i + 1, j) * u) * (1 - v) +
                       (texel(i, j + 1) * (1 - u) + texel(i + 1, j + 1) * u) * v;
  return std::clamp(value, 0.0, 255.0);
}

struct Off {
  double most = 0, rms = 0;
  bool within(const ChannelTolerance& t) const { return most <= t.most && rms <= t.rms; }
};
Off offOf(const Page& a, const Page& b, size_t channel) {
  Off out;
  double squares = 0;
  for (size_t i = channel * kChannel; i < (channel + 1) * kChannel; ++i) {
    const double d = std::abs(static_cast<double>(a[i]) - b[i]);
    out.most = std::max(out.most, d);
    squares += d * d;
  }
  out.rms = std::sqrt(squares / kChannel);
  return out;
}

constexpr std::array<ChannelTolerance, 3> kTolerances{{{2, 1}, {8, 1}, {8, 1}}};

TEST(CoarsePage, EnlargesAsABilinearFilterDoes) {
  std::mt19937 random(kSeed);
  for (int factor : kCoarseFactors) {
    const int side = coarseSide(factor);
    Page coarse(size_t{3} * static_cast<size_t>(side * side)), page(kTexturePageBytes);
    for (uint8_t& b : coarse) b = static_cast<uint8_t>(random());
    enlargePage(coarse, factor, page);
    double worst = 0;
    for (size_t c = 0; c < 3; ++c)
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x) {
          const double expected = filtered(std::span(coarse).subspan(c * coarse.size() / 3, coarse.size() / 3), side,
                                           (x + 0.5) / factor, (y + 0.5) / factor);
          worst = std::max(worst, std::abs(expected - page[c * kChannel + static_cast<size_t>(y * kSide + x)]));
        }
    EXPECT_LE(worst, 0.5) << factor;
    // Negative control: the nearest texel is no filter.
    double nearest = 0;
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x)
        nearest = std::max(nearest,
                           std::abs(static_cast<double>(coarse[static_cast<size_t>(y / factor * side + x / factor)]) -
                                    page[static_cast<size_t>(y * kSide + x)]));
    EXPECT_GT(nearest, 20);
  }
}

TEST(CoarsePage, WhatIsFoundLiesWithinTheTolerances) {
  int found = 0, refused = 0;
  for (int factor : kCoarseFactors)
    for (double per_page = 0.5; per_page < 40; per_page *= 1.5) {
      const Page page = waves(per_page);
      Page coarse(size_t{3} * static_cast<size_t>(coarseSide(factor) * coarseSide(factor))), shown(kTexturePageBytes);
      if (!reducePage(page, factor, kTolerances, coarse)) {
        ++refused;
        continue;
      }
      ++found;
      enlargePage(coarse, factor, shown);
      for (size_t c = 0; c < 3; ++c) {
        const Off off = offOf(page, shown, c);
        EXPECT_TRUE(off.within(kTolerances[c])) << per_page << " " << c << ": " << off.most << ", " << off.rms;
      }
    }
  EXPECT_GE(found, 5);
  EXPECT_GE(refused, 5);
}

// Means of squares alone blur what is bent; the search gives it back.
TEST(CoarsePage, FindsMoreThanMeansOfSquares) {
  const Page page = waves(2.5);
  constexpr int kFactor = 4, kCoarse = coarseSide(kFactor);
  Page means(size_t{3} * kCoarse * kCoarse), coarse = means, shown(kTexturePageBytes);
  for (int i = 0; i < 3 * kCoarse * kCoarse; ++i) {
    int sum = 0;
    for (int k = 0; k < kFactor * kFactor; ++k)
      sum += page[static_cast<size_t>(((i / kCoarse) * kFactor + k / kFactor) * kSide + i % kCoarse * kFactor +
                                      k % kFactor)];
    means[static_cast<size_t>(i)] = static_cast<uint8_t>((sum + 8) / 16);
  }
  enlargePage(means, kFactor, shown);
  EXPECT_GT(offOf(page, shown, 1).rms, kTolerances[1].rms);
  EXPECT_TRUE(reducePage(page, kFactor, {{{8, 1}, {8, 1}, {8, 1}}}, coarse));
}

TEST(CoarsePage, RefusesWhatFewerTexelsDoNotShow) {
  for (int factor : kCoarseFactors) {
    Page coarse(size_t{3} * static_cast<size_t>(coarseSide(factor) * coarseSide(factor)));
    auto reduces = [&](const Page& page) { return reducePage(page, factor, kTolerances, coarse); };
    const Page flat = pageOf([](int, int, int) { return 100; });
    EXPECT_TRUE(reduces(flat));
    EXPECT_FALSE(reduces(noise()));
    // A single texel, also in the corner of the gutter; an edge; shallow relief everywhere.
    for (size_t at : {size_t{0}, kChannel - 1, kChannel + 70 * kSide + 70, 3 * kChannel - 1}) {
      Page spike = flat;
      spike[at] = 124;
      EXPECT_FALSE(reduces(spike)) << at;
    }
    EXPECT_FALSE(reduces(pageOf([](int, int x, int) { return x < 70 ? 100 : 160; })));
    EXPECT_FALSE(reduces(pageOf([](int, int x, int y) { return 100 + 4 * ((x ^ y) & 1); })));
    // Of one channel alone.
    EXPECT_FALSE(reduces(pageOf([](int c, int x, int y) { return c == 2 && (x ^ y) & 1 ? 110 : 100; })));
  }
}

// A line that differs hardly is left out within the page, but not where the page meets its neighbours.
TEST(CoarsePage, KeepsTheEdgeOfThePageBetter) {
  constexpr int kFactor = 4;
  Page coarse(size_t{3} * coarseSide(kFactor) * coarseSide(kFactor));
  auto reduces = [&](int line) {
    return reducePage(pageOf([=](int c, int x, int y) { return c == 1 && (x == line || y == line) ? 107 : 100; }),
                      kFactor, kTolerances, coarse);
  };
  EXPECT_TRUE(reduces(61)) << "control";
  for (int line : {kPageBorderPx - 1, kPageBorderPx, kPagePx + kPageBorderPx - 1, kPagePx + kPageBorderPx})
    EXPECT_FALSE(reduces(line)) << line;
}

// Pages of one picture: where they overlap beside their common edge they show the same within the tolerance.
TEST(CoarsePage, NeighboursMeetWithinTheTolerance) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  double furthest = 0;
  for (double per_page : {1.0, 1.7, 3.0}) {
    std::array<Page, 2> shown{Page(kTexturePageBytes), Page(kTexturePageBytes)};
    for (int k = 0; k < 2; ++k) {
      const Page page = pageOf([=](int c, int x, int y) {
        const double at = x + k * kPagePx;
        return 128 + 25 * std::sin(6.28 * per_page * at / kSide + c) * std::cos(6.28 * per_page * y / kSide);
      });
      ASSERT_TRUE(
          decoder.decodeTexture(encoder.encodeTextureWithin(page, kTolerances, false), shown[static_cast<size_t>(k)])
              .ok());
    }
    for (size_t c = 0; c < 3; ++c)
      for (int y = kPageBorderPx; y < kPagePx + kPageBorderPx; ++y)
        for (int x : {kPageBorderPx - 1, kPageBorderPx}) {
          const size_t row = c * kChannel + static_cast<size_t>(y * kSide);
          const double off = std::abs(static_cast<double>(shown[0][row + static_cast<size_t>(x + kPagePx)]) -
                                      shown[1][row + static_cast<size_t>(x)]);
          EXPECT_LE(off, kTolerances[c].most);
          furthest = std::max(furthest, off);
        }
  }
  EXPECT_GT(furthest, 0) << "control: they are not the same";
}

TEST(CoarsePage, PagesTakeFewerBytesOrAreLossless) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  Page shown(kTexturePageBytes), slot(kSlotBytes);
  auto decoded = [&](std::span<const uint8_t> bytes) {
    EXPECT_TRUE(decoder.decodeTexture(bytes, shown).ok());
    EXPECT_TRUE(decoder.decodeToSlot(Plane::kTexture0, bytes, slot).ok());
    for (size_t i = 0; i < kChannel; ++i)
      for (size_t c = 0; c < 3; ++c)
        if (slot[4 * i + c] != shown[c * kChannel + i]) {
          ADD_FAILURE() << i;
          return shown;
        }
    return shown;
  };
  for (double per_page : {1.0, 3.0, 8.0, 30.0}) {
    const Page page = waves(per_page);
    const size_t lossless = encoder.encodeTexture(page).size();
    const auto bytes = encoder.encodeTextureWithin(page, kTolerances, false);
    EXPECT_LE(bytes.size(), lossless);
    if (per_page < 4) {
      EXPECT_LT((per_page < 2 ? 4 : 2) * bytes.size(), lossless) << per_page;
    }
    const Page back = decoded(bytes);
    for (size_t c = 0; c < 3; ++c) EXPECT_TRUE(offOf(page, back, c).within(kTolerances[c]));
    if (per_page > 20) {
      EXPECT_TRUE(back == page);
    }
  }
  EXPECT_TRUE(decoded(encoder.encodeTextureWithin(noise(), kTolerances, false)) == noise());
  // Where a coarse page would be exact, none is needed: what is constant takes next to nothing.
  const Page flat = pageOf([](int c, int, int) { return 50 * c; });
  EXPECT_LT(encoder.encodeTextureWithin(flat, kTolerances, false).size(), 20u);
  EXPECT_TRUE(decoded(encoder.encodeTextureWithin(flat, kTolerances, false)) == flat);
  // Nothing may differ: what differs is stored as it is.
  const Page page = waves(3);
  EXPECT_TRUE(decoded(encoder.encodeTextureWithin(page, std::array<ChannelTolerance, 3>{}, false)) == page);
}

TEST(CoarsePage, DamagedPagesAreRefused) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  Page shown(kTexturePageBytes);
  const auto encoded = encoder.encodeTextureWithin(waves(1), kTolerances, false);
  const std::vector<uint8_t> good(encoded.begin(), encoded.end());
  ASSERT_TRUE(good[0] == 10 || good[0] == 11) << "control";
  ASSERT_EQ(good[1], 4);
  for (size_t length = 0; length < good.size(); ++length)
    EXPECT_FALSE(decoder.decodeTexture({good.data(), length}, shown).ok()) << length;
  for (int factor : {0, 1, 2, 3, 5, 8, 255}) {
    std::vector<uint8_t> bad = good;
    bad[1] = static_cast<uint8_t>(factor);
    EXPECT_FALSE(decoder.decodeTexture(bad, shown).ok()) << factor << ": of another number of texels, or of none";
  }
  for (uint8_t packing : {9, 12, 13}) {
    std::vector<uint8_t> bad = good;
    bad[0] = packing;
    EXPECT_FALSE(decoder.decodeTexture(bad, shown).ok());
  }
  std::vector<uint8_t> bad = good;
  bad[3] = 6;
  EXPECT_FALSE(decoder.decodeTexture(bad, shown).ok()) << "there is no such predictor";
  std::vector<uint16_t> samples(kReliefPageSamples);
  EXPECT_FALSE(decoder.decodeRelief(good, samples).ok());
}

}  // namespace
}  // namespace relievo::coarse_page_test
