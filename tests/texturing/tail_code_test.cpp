// Tails in few bytes: without loss, small where patches are smooth, refused where bytes are damaged, and as PACKAGE.md
// says, by a reader of its own.
#include "texturing/codec/tail_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <random>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "tests/texturing/format_tails.h"
#include "tests/texturing/tail_fixture.h"
#include "texturing/package/package_tails.h"

namespace relievo::tail_code_test {
namespace {

using namespace format_tails;
using namespace tail_fixture;

std::vector<uint8_t> encoded(const Tails& t) {
  std::vector<uint8_t> out;
  encodeTailCode(t.heights, t.texels, t.channels, {}, out);
  return out;
}

TEST(TailCode, DecodesToWhatWasEncoded) {
  for (const Contents& c : contents()) {
    Tails back = noise(c.tails.patches(), c.tails.channels);
    ASSERT_TRUE(decodeTailCode(encoded(c.tails), c.tails.channels, {}, back.heights, back.texels)) << c.name;
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
  }
}

TEST(TailCode, TakesLessThanHalfOfDifferencesWherePatchesAreSmooth) {
  auto ofDifferences = [](const Tails& t) {
    PatchTails tails(static_cast<uint32_t>(t.patches()), t.channels);
    tails.heights = t.heights;
    tails.texels = t.texels;
    return encodeTailsChunk(tails, 0, tails.patches, TailsStorage::kZstd, {}, 19).size();
  };
  for (bool painted : {false, true}) {
    const Tails t = smooth(200, painted, 8);
    const size_t coded = encoded(t).size(), differences = ofDifferences(t);
    EXPECT_LT(2 * coded, differences) << painted;
    EXPECT_GT(tailCodeHeightBytes(encoded(t)), coded / 20);
    EXPECT_LT(tailCodeHeightBytes(encoded(t)), coded);
  }
  // What has no order takes what it takes: nothing is gained, and hardly anything lost.
  const Tails random = noise(20, 6);
  EXPECT_GT(encoded(random).size(), ofDifferences(random) * 95 / 100);
  EXPECT_LT(encoded(random).size(), ofDifferences(random) * 115 / 100);
}

// Normals, whose largest component follows from the others, take fewer bytes than the same numbers whose channels have
// nothing to do with one another; and so do colours whose channels change alike.
TEST(TailCode, ChannelsThatDependOnOneAnotherTakeLess) {
  auto bytesOfTexels = [](const Tails& t) { return encoded(t).size() - tailCodeHeightBytes(encoded(t)); };
  const Tails normals = smooth(64, false);
  const size_t of_patch = kTailPatchTexels * 6;
  // Each channel from another patch.
  auto mixed = [&](const Tails& t) {
    Tails out = t;
    for (size_t p = 0; p < t.patches(); ++p)
      for (int level = 0; level < kTailLevels; ++level)
        for (size_t c = 0; c < 6; ++c) {
          const size_t n = static_cast<size_t>(PatchTails::side(level) * PatchTails::side(level)),
                       at = 6 * kTailLevelAt[static_cast<size_t>(level)] + c * n,
                       from = (p + 11 * (c % 3)) % t.patches();
          std::copy_n(t.texels.begin() + static_cast<std::ptrdiff_t>(from * of_patch + at), n,
                      out.texels.begin() + static_cast<std::ptrdiff_t>(p * of_patch + at));
        }
    return out;
  };
  EXPECT_LT(bytesOfTexels(normals) * 10, bytesOfTexels(mixed(normals)) * 9);
  Tails greys = smooth(64, true);
  for (size_t p = 0; p < greys.patches(); ++p)
    for (int level = 0; level < kTailLevels; ++level)
      for (size_t c = 0; c < 6; ++c) {
        const size_t n = static_cast<size_t>(PatchTails::side(level) * PatchTails::side(level)),
                     at = p * of_patch + 6 * kTailLevelAt[static_cast<size_t>(level)];
        std::copy_n(greys.texels.begin() + static_cast<std::ptrdiff_t>(at), n,
                    greys.texels.begin() + static_cast<std::ptrdiff_t>(at + c * n));
      }
  EXPECT_LT(bytesOfTexels(greys) * 10, bytesOfTexels(mixed(greys)) * 7);
}

// Within the steps and the root mean square that were asked for, level by level.
TEST(TailCode, RoundedTexelsTakeFewerBytes) {
  const Tails exact = smooth(100, false);  // all of one colour
  const auto texelBytes = [](const Tails& t) {
    const auto bytes = encoded(t);
    return bytes.size() - tailCodeHeightBytes(bytes);
  };
  const size_t before = texelBytes(exact);
  for (const auto& [most, rms] : {std::pair{1, 1.0}, {4, 1.0}, {4, 100.0}, {0, 1.0}}) {
    Tails t = exact;
    roundTailTexels(t.texels, 6, 1, {false, most, rms});
    int furthest = 0;
    double worst = 0;
    for (size_t p = 0; p < t.patches(); ++p)
      for (size_t i = 0; i < kTailPatchTexels * 6; ++i) {
        const size_t at = p * kTailPatchTexels * 6 + i;
        const int off = std::abs(t.texels[at] - exact.texels[at]);
        furthest = std::max(furthest, off);
        const size_t finest = 6 * 256;
        if (i < finest / 2 || (i >= finest && off > 0 && i < finest + 3 * 64)) {
          ASSERT_EQ(off, 0) << "the other plane";
        }
      }
    for (size_t p = 0; p < t.patches(); ++p)
      for (size_t c = 3; c < 6; ++c) {
        double squares = 0;
        for (size_t i = 0; i < 256; ++i) {
          const size_t at = p * kTailPatchTexels * 6 + c * 256 + i;
          squares += std::pow(t.texels[at] - exact.texels[at], 2);
        }
        worst = std::max(worst, std::sqrt(squares / 256));
      }
    EXPECT_LE(furthest, most);
    EXPECT_LE(worst, rms);
    const size_t bytes = texelBytes(t);
    if (most == 0) {
      EXPECT_EQ(bytes, before);
    } else {
      EXPECT_LT(bytes * 4, before * 3);
    }
    if (rms == 100) {
      EXPECT_GT(worst, 1.1) << "control: the other limit counts, too";
      EXPECT_EQ(furthest, most);
    }
  }
  // Texels at the ends of their range stay within it.
  Tails ends = noise(5, 3);
  for (uint8_t& texel : ends.texels) texel = texel < 128 ? texel % 4 : 255 - texel % 4;
  const Tails same = ends;
  roundTailTexels(ends.texels, 3, 0, {false, 3, 100});
  for (size_t i = 0; i < ends.texels.size(); ++i) ASSERT_LE(std::abs(ends.texels[i] - same.texels[i]), 3);
}

TEST(TailCode, DamagedBytesAreRefusedOrDecodeToSomething) {
  const Tails t = smooth(12, true);
  const std::vector<uint8_t> good = encoded(t);
  expectDamageIsRefused(good, {}, {}, {});
  Tails back = empty(12, 6);
  std::vector<uint8_t> other_kind = good;  // of the first plane: there are 0, 1 and 2
  const size_t kind_at = tailCodeHeightBytes(good) + kTailCodeHeadBytes;
  EXPECT_LE(good[kind_at], 2);
  other_kind[kind_at] = 3;
  EXPECT_FALSE(decodeTailCode(other_kind, 6, {}, back.heights, back.texels));
}

// ---- a reader by what PACKAGE.md says, in its words and with nothing of ours but what relief pages have ----

void readPlane(std::span<const uint8_t> bytes, int channels, int plane, size_t patches, std::vector<uint8_t>& texels) {
  const int kind = bytes[0];
  Coder coder(bytes.subspan(1));
  ModelBook book;
  int bit = 0;
  std::array<int, 3> first{128, 128, 128};
  for (size_t patch = 0; patch < patches; ++patch) {
    auto at = [&](int level, int c, int x, int y) -> uint8_t& {
      const int side = 16 >> level;
      size_t place = patch * static_cast<size_t>(channels) * 340;
      for (int l = 0; l < level; ++l) place += static_cast<size_t>(channels * (16 >> l) * (16 >> l));
      return texels[place + static_cast<size_t>(((3 * plane + c) * side + y) * side + x)];
    };
    bit = coder.bit(book.at('p', bit));
    std::map<std::tuple<int, int, int>, int> e;  // of (channel, x, y)
    for (int level = 0; level < 4; ++level) {
      const int side = 16 >> level;
      if (bit) {
        for (int c = 0; c < 3; ++c)
          for (int i = 0; i < side * side; ++i)
            at(level, c, i % side, i / side) = static_cast<uint8_t>(first[static_cast<size_t>(c)]);
        continue;
      }
      if (level > 0) {
        for (int c = 0; c < 3; ++c)
          for (int y = 0; y < side; ++y)
            for (int x = 0; x < side; ++x) {
              const int s = at(level - 1, c, 2 * x, 2 * y) + at(level - 1, c, 2 * x + 1, 2 * y) +
                            at(level - 1, c, 2 * x, 2 * y + 1) + at(level - 1, c, 2 * x + 1, 2 * y + 1) + 2;
              at(level, c, x, y) =
                  static_cast<uint8_t>((s >> 2) + readE(coder, book, 10 + s % 4, 10 + s % 4, 10 + s % 4, 0, 1, 8));
            }
        continue;
      }
      for (int y = 0; y < 16; ++y)
        for (int x = 0; x < 16; ++x) {
          std::array<int, 3> p, order{0, 1, 2};
          for (int c = 0; c < 3; ++c) {
            auto v = [&](int dx, int dy) -> int { return at(0, c, x + dx, y + dy); };
            int value;
            if (x == 0 && y == 0) value = first[static_cast<size_t>(c)];
            else if (y == 0) value = v(-1, 0) + ((v(-1, 0) - v(x > 1 ? -2 : -1, 0)) >> 1);
            else if (x == 0) value = v(0, -1) + ((v(0, -1) - v(0, y > 1 ? -2 : -1)) >> 1);
            else
              value = (16 * v(-1, 0) + 7 * v(0, -1) - 4 * v(-1, -1) + 4 * v(x < 15 ? 1 : 0, -1) -
                       4 * v(x > 1 ? -2 : -1, 0) - 3 * v(0, y > 1 ? -2 : -1) + 8) >>
                      4;
            p[static_cast<size_t>(c)] = std::clamp(value, 0, 255);
          }
          auto off = [&](size_t k) { return std::abs(2 * p[static_cast<size_t>(order[k])] - 255); };
          if (kind == 2)
            for (size_t k : {0u, 1u, 0u})
              if (off(k) > off(k + 1)) std::swap(order[k], order[k + 1]);
          int before = 0;
          for (int k = 0; k < 3; ++k) {
            const int c = order[static_cast<size_t>(k)];
            int guess = p[static_cast<size_t>(c)];
            if (kind == 1) guess = std::clamp(guess + before, 0, 255);
            auto square = [&](int i, int dx, int dy) {
              const int n = 2 * at(0, i, x + dx, y + dy) - 255;
              return n * n;
            };
            if (kind == 2 && k == 2) {
              auto whole = [&](int dx, int dy) { return square(0, dx, dy) + square(1, dx, dy) + square(2, dx, dy); };
              int q = x > 0 && y > 0 ? (whole(-1, 0) + whole(0, -1)) / 2
                      : x > 0        ? whole(-1, 0)
                      : y > 0        ? whole(0, -1)
                                     : 255 * 255;
              q -= square(order[0], 0, 0) + square(order[1], 0, 0);
              if (q > 0) {
                int r = 0;
                while ((r + 1) * (r + 1) <= q) ++r;
                if (2 * guess - 255 < 0) r = -r;
                guess = std::clamp((256 + r) >> 1, 0, 255);
              }
            }
            auto known = [&](int dx, int dy) {
              const auto it = e.find({c, x + dx, y + dy});
              return it == e.end() ? 0 : it->second;
            };
            int sum = 2 * (std::abs(known(-1, 0)) + std::abs(known(0, -1))) + std::abs(known(-1, -1)) +
                      std::abs(known(1, -1));
            if (x == 0 && y == 0) sum = 40;
            else if (y == 0) sum *= 2;
            else if (x == 0) sum = sum * 3 / 2;
            if (kind == 2 ? k == 1 : k > 0) sum += 2 * std::abs(before);
            const int slope = known(-1, 0) + known(0, -1);
            before = readE(coder, book, k, k, k, std::min(15, bucket(sum)), slope < 0 ? 0 : slope > 0 ? 2 : 1, 8);
            e[{c, x, y}] = before;
            at(0, c, x, y) = static_cast<uint8_t>(guess + before);
          }
        }
    }
    for (int c = 0; c < 3; ++c) first[static_cast<size_t>(c)] = at(0, c, 0, 0);
  }
  EXPECT_TRUE(coder.ended());
}

TEST(TailCode, IsAsThePackageFormatSays) {
  for (const Contents& c : contents()) {
    const std::vector<uint8_t> bytes = encoded(c.tails);
    size_t at = 0;
    Tails back = noise(c.tails.patches(), c.tails.channels);
    Coder coder(nextStream(bytes, at));
    HeightsReader heights{coder, {}, 1, {}, {}, {}, false};
    heights.book.of_heights = true;
    for (size_t p = 0; p < back.patches(); ++p) heights.patch(back.heights.data() + p * kTailHeights);
    EXPECT_TRUE(coder.ended()) << c.name;
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    for (int plane = 0; plane < c.tails.channels / 3; ++plane)
      readPlane(nextStream(bytes, at), c.tails.channels, plane, back.patches(), back.texels);
    EXPECT_EQ(at, bytes.size()) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
  }
}

}  // namespace
}  // namespace relievo::tail_code_test
