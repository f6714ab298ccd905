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

#include "src/artwork/relief_lattice.h"
#include "tests/texturing/format_coder.h"
#include "texturing/package/package_tails.h"

namespace relievo::tail_code_test {
namespace {

using format_coder::Coder;
using format_coder::Model;

constexpr uint32_t kSeed = 20261127;

struct Tails {
  int channels = 6;
  std::vector<uint16_t> heights;
  std::vector<uint8_t> texels;
  size_t patches() const { return heights.size() / kTailHeights; }
};

Tails empty(size_t patches, int channels) {
  return {channels, std::vector<uint16_t>(patches * kTailHeights),
          std::vector<uint8_t>(patches * kTailPatchTexels * static_cast<size_t>(channels))};
}

Tails noise(size_t patches, int channels) {
  Tails t = empty(patches, channels);
  std::mt19937 random(kSeed);
  for (uint16_t& h : t.heights) h = static_cast<uint16_t>(random());
  for (uint8_t& b : t.texels) b = static_cast<uint8_t>(random());
  return t;
}

// A wavy surface's heights, in steps of `step`, and normals; albedo of one colour, or with a hue that differs.
Tails smooth(size_t patches, bool painted, int step = 1) {
  Tails t = empty(patches, 6);
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> number(-3, 3);
  for (size_t p = 0; p < patches; ++p) {
    std::array<std::array<double, 3>, 4> waves;  // of this patch: along u, along v, phase
    for (auto& wave : waves) wave = {number(random), number(random), number(random)};
    auto height = [&](double u, double v) {
      double sum = 30000;
      for (const auto& [a, b, phase] : waves) sum += 800 * std::sin(a * u + b * v + phase);
      return sum;
    };
    for (int y = 0; y <= 16; ++y)
      for (int x = 0; x <= 16; ++x)
        t.heights[p * kTailHeights + static_cast<size_t>(17 * y + x)] =
            static_cast<uint16_t>(step * std::lround(height(x / 16.0, y / 16.0) / step));
    PatchTails tail(1, 6);
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x) {
        const double u = (x + 0.5) / 16, v = (y + 0.5) / 16, d = 1e-4;
        const double dx = (height(u + d, v) - height(u, v)) / d / 4000,
                     dy = (height(u, v + d) - height(u, v)) / d / 4000;
        const double length = std::sqrt(dx * dx + dy * dy + 1);
        const double n[3] = {-dx / length, dy / length, 1 / length};
        const double light = painted ? 100 + 60 * std::sin(waves[0][0] * u + waves[1][1] * v) : 200;
        for (int c = 0; c < 3; ++c) {
          tail.level(0, 0, c)[y * 16 + x] = static_cast<uint8_t>(std::lround(light * (1 - 0.2 * c)));
          tail.level(0, 0, 3 + c)[y * 16 + x] = static_cast<uint8_t>(std::lround(127.5 * (n[c] + 1)));
        }
      }
    for (int level = 1; level < kTailLevels; ++level)
      for (int c = 0; c < 6; ++c) {
        const int side = PatchTails::side(level);
        for (int i = 0; i < side * side; ++i) {
          const uint8_t* from = tail.level(0, level - 1, c) + i / side * 4 * side + i % side * 2;
          const int sum = from[0] + from[1] + from[2 * side] + from[2 * side + 1];
          tail.level(0, level, c)[i] = static_cast<uint8_t>((sum + 2 + (i % 7 == 0)) / 4);
        }
      }
    std::copy(tail.texels.begin(), tail.texels.end(),
              t.texels.begin() + static_cast<std::ptrdiff_t>(p * kTailPatchTexels * 6));
  }
  return t;
}

// Level 0 has what no line shows and the mean of four neighbours does, so that nothing of it is left to be coded; finer
// levels are as the lattice says.
void makeSaddle(Tails& t, size_t patch) {
  uint16_t* h = t.heights.data() + patch * kTailHeights;
  auto at = [&](int x, int y) -> uint16_t& { return h[17 * y + x]; };
  for (int k = 0; k < 4; ++k) at(k % 2 * 16, k / 2 * 16) = k == 0 || k == 3 ? 3000 : 3800;
  for (int step = 16; step > 1; step /= 2)
    for (int y = 0; y < 17; y += step / 2)
      for (int x = 0; x < 17; x += step / 2) {
        const int dx = x % step, dy = y % step;
        if (dx || dy) at(x, y) = static_cast<uint16_t>(midHeight(at(x - dx, y - dy), at(x + dx, y + dy)));
        if (step == 16 && dx && dy) at(x, y) = 3400;
      }
}

std::vector<uint8_t> encoded(const Tails& t) {
  std::vector<uint8_t> out;
  encodeTailCode(t.heights, t.texels, t.channels, out);
  return out;
}

struct Contents {
  const char* name;
  Tails tails;
};
std::vector<Contents> contents() {
  Tails extremes = noise(7, 3);
  for (uint16_t& h : extremes.heights) h = h & 1 ? 65535 : 0;
  for (uint8_t& b : extremes.texels) b = b & 1 ? 255 : 0;
  Tails changing = empty(9, 6);  // patches of one colour, of which some have another one
  for (size_t i = 0; i < changing.texels.size(); ++i)
    changing.texels[i] = static_cast<uint8_t>(i / (kTailPatchTexels * 6) / 3 * 100);
  Tails saddles = smooth(9, false);
  for (size_t p = 0; p < 9; p += 2) makeSaddle(saddles, p);
  return {{"saddles", saddles},
          {"noise", noise(5, 6)},
          {"one patch of a PTM", noise(1, 9)},
          {"zeros", empty(3, 6)},
          {"extremes", extremes},
          {"colours that change", changing},
          {"smooth", smooth(40, false)},
          {"smooth and painted", smooth(40, true)},
          {"in steps", smooth(20, true, 24)}};
}

TEST(TailCode, DecodesToWhatWasEncoded) {
  for (const Contents& c : contents()) {
    Tails back = noise(c.tails.patches(), c.tails.channels);
    ASSERT_TRUE(decodeTailCode(encoded(c.tails), c.tails.channels, back.heights, back.texels)) << c.name;
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
  }
}

TEST(TailCode, TakesLessThanHalfOfDifferencesWherePatchesAreSmooth) {
  auto ofDifferences = [](const Tails& t) {
    PatchTails tails(static_cast<uint32_t>(t.patches()), t.channels);
    tails.heights = t.heights;
    tails.texels = t.texels;
    return encodeTailsChunk(tails, 0, tails.patches, TailsStorage::kZstd, 19).size();
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
    roundTailTexels(t.texels, 6, 1, most, rms);
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
  roundTailTexels(ends.texels, 3, 0, 3, 100);
  for (size_t i = 0; i < ends.texels.size(); ++i) ASSERT_LE(std::abs(ends.texels[i] - same.texels[i]), 3);
}

TEST(TailCode, DamagedBytesAreRefusedOrDecodeToSomething) {
  const Tails t = smooth(12, true);
  const std::vector<uint8_t> good = encoded(t);
  Tails back = empty(12, 6);
  for (size_t length = 0; length < good.size(); length += length < 64 ? 1 : 37)
    EXPECT_FALSE(decodeTailCode({good.data(), length}, 6, back.heights, back.texels)) << length;
  std::vector<uint8_t> longer = good;
  longer.push_back(0);
  EXPECT_FALSE(decodeTailCode(longer, 6, back.heights, back.texels));
  Tails fewer = empty(11, 6), more = empty(13, 6), other = empty(12, 9);
  EXPECT_FALSE(decodeTailCode(good, 6, fewer.heights, fewer.texels));
  EXPECT_FALSE(decodeTailCode(good, 6, more.heights, more.texels));
  EXPECT_FALSE(decodeTailCode(good, 9, other.heights, other.texels));
  std::vector<uint8_t> other_kind = good;  // of the first plane: there are 0, 1 and 2
  const size_t kind_at = tailCodeHeightBytes(good) + kTailCodeHeadBytes;
  EXPECT_LE(good[kind_at], 2);
  other_kind[kind_at] = 3;
  EXPECT_FALSE(decodeTailCode(other_kind, 6, back.heights, back.texels));
  std::mt19937 random(kSeed);
  size_t refused = 0, tried = 0;
  for (size_t i = 0; i < good.size(); i += 1 + good.size() / 400, ++tried) {
    std::vector<uint8_t> bad = good;
    bad[i] ^= static_cast<uint8_t>(1u << random() % 8);
    refused += !decodeTailCode(bad, 6, back.heights, back.texels);
  }
  EXPECT_GT(refused, tried / 2) << "most leave too few bytes or too many";
  size_t refused_junk = 0;
  std::vector<uint8_t> junk(3000);
  for (int i = 0; i < 50; ++i) {
    for (uint8_t& b : junk) b = static_cast<uint8_t>(random());
    // Streams of lengths that fit, of anything.
    const uint32_t lengths[3] = {900, 1000, 1088};
    size_t at = 0;
    for (uint32_t length : lengths) {
      for (size_t k = 0; k < 4; ++k) junk[at + k] = static_cast<uint8_t>(length >> 8 * k);
      junk[at + 4] = static_cast<uint8_t>(i % 5);
      at += 4 + length;
    }
    refused_junk += !decodeTailCode(junk, 6, back.heights, back.texels);
  }
  EXPECT_GE(refused_junk, 49u) << "hardly any junk ends where its last bit does";
}

// ---- a reader by what PACKAGE.md says, in its words and with nothing of ours but what relief pages have ----

// Models by a name and numbers; they begin as `begin` says of these.
class ModelBook {
 public:
  using Key = std::tuple<char, int, int, int>;
  Model& at(char name, int a = 0, int b = 0, int c = 0) {
    auto [it, made] = models_.try_emplace({name, a, b, c});
    if (made)
      if (const int zero = begin(name, a, b, c); zero >= 0) it->second = {zero * 256, 6};
    return it->second;
  }
  bool of_heights = false;

 private:
  int begin(char name, int a, int b, int) const {
    if (!of_heights) return -1;
    static const int open[] = {60, 30, 30, 20, 8, 8, 8, 8},
                     zero[] = {252, 247, 237, 226, 211, 193, 171, 147, 126, 104, 86, 66,
                               52,  40,  28,  18,  14,  12,  10,  8,   8,   8,   8,  8},
                     alone[] = {191, 60, 70, 95, 126, 157, 213},
                     larger[] = {235, 238, 240, 232, 225, 215, 205, 188, 170, 146, 122,
                                 100, 78,  62,  48,  40,  33,  26,  20,  16,  12};
    if (name == 'o') return open[b];
    if (name == 'z') return zero[b];
    if (name == 'l') return a == 0 ? alone[std::min(b, 7) - 1] : larger[std::clamp(a - 2 * b + 3, 0, 20)];
    if (name == 's') return (const int[]){62, 128, 194}[a];
    if (name == 'm') return b == 0 ? 180 : 155;
    return -1;
  }
  std::map<Key, Model> models_;
};

int symbol(Coder& coder, ModelBook& book, char name, int of, int bits) {
  int node = 1;
  for (int i = 0; i < bits; ++i) node = 2 * node + coder.bit(book.at(name, of, node));
  return node - (1 << bits);
}

int bucket(int sum) {
  if (sum < 4) return sum;
  const int k = std::bit_width(static_cast<unsigned>(sum));
  return std::min(23, 2 * k - 2 + (sum >> (k - 2) & 1));
}

// kind, or level and middle, choose the models of "is it 0".
int readE(Coder& coder, ModelBook& book, int zero_model, int sign_kind, int kind, int b, int sign, int most) {
  if (!coder.bit(book.at('z', zero_model, b))) return 0;
  const int negative = coder.bit(book.at('s', sign, sign_kind));
  int c = 1;
  while (c < most && coder.bit(book.at('l', b, c, kind))) ++c;
  int value = 1;
  for (int k = 0; k < c - 1; ++k) value = 2 * value + (k < 2 ? coder.bit(book.at('m', c, k, kind)) : coder.plain(1));
  return negative ? -value : value;
}

struct HeightsReader {
  Coder& coder;
  ModelBook book;
  int step = 1;
  int h[17][17], e[17][17];

  int wrapped(int v) const { return v & 0xFFFF; }
  void patch(uint16_t* out) {
    static const int kTimes[] = {1, 2, 3, 4, 6, 8, 12, 16};
    if (coder.bit(book.at('S'))) step = coder.plain(16);
    const int levels = std::min(4, symbol(coder, book, 'L', 0, 3)), g = coder.bit(book.at('g'));
    int how[4], d[4] = {step * kTimes[0], step, step, step};
    for (int l = 0; l < levels; ++l) {
      how[l] = symbol(coder, book, 'h', l, 2);
      d[l] = step * kTimes[symbol(coder, book, 't', l, 3)];
    }
    std::fill(&e[0][0], &e[0][0] + 17 * 17, 0);
    h[0][0] = coder.plain(16);
    const int corner = g ? d[0] : 1;
    for (int k = 1; k < 4; ++k) {
      const int width = coder.plain(5);
      const int folded = width == 0 ? 0 : (1 << (width - 1)) + coder.plain(width - 1);
      h[k / 2 * 16][k % 2 * 16] = wrapped(h[0][0] + corner * (folded & 1 ? -(folded / 2) - 1 : folded / 2));
    }
    int parent = 1;
    for (int l = 0; l < 4; ++l) {
      const int s = 8 >> l, n = 2 << l;  // samples of the grid lie s apart
      bool open = false;
      if (l < levels) open = coder.bit(book.at('o', l, 4 * parent));
      if (l < levels) parent = open;
      for (bool middle : {true, false})
        for (int y = 0; y <= n; ++y)
          for (int x = 0; x <= n; ++x)
            if (middle ? (x & y & 1) : ((x ^ y) & 1)) sample(x, y, s, n, l, l < levels, open, how, d, middle);
    }
    for (int y = 0; y < 17; ++y)
      for (int x = 0; x < 17; ++x) *out++ = static_cast<uint16_t>(h[y][x]);
  }
  void sample(int x, int y, int s, int n, int l, bool coded, bool open, const int* how, const int* d, bool middle) {
    auto at = [&](int dx, int dy) { return h[(y + dy) * s][(x + dx) * s]; };
    const bool along_x = x & 1;
    auto turned = [&](int u, int v) { return along_x ? at(u, v) : at(v, u); };  // u along the line, v across
    const int line = middle ? midHeight(at(-1, -1), at(1, 1)) : midHeight(turned(-1, 0), turned(1, 0));
    int& to = h[y * s][x * s];
    if (!coded) {
      to = line;
      return;
    }
    int p = line;
    const int u = along_x ? x : y, v = along_x ? y : x;
    if (middle) {
      if (how[l] > 0) {
        const int f = at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1);
        p = (f + 2) >> 2;
        if (how[l] > 1 && x >= 3 && y >= 3 && x <= n - 3 && y <= n - 3) {
          int sum = 0;
          for (int a : {-3, 3})
            for (int b : {-1, 1}) sum += at(a, b) + at(b, a);
          p = (10 * f - sum + 16) >> 5;
        }
      }
    } else if (how[l] == 3 || (how[l] > 0 && (v == 0 || v == n))) {
      if (u >= 3 && u <= n - 3) p = (9 * (turned(-1, 0) + turned(1, 0)) - turned(-3, 0) - turned(3, 0) + 8) >> 4;
    } else if (how[l] > 0) {
      const int f = turned(-1, 0) + turned(1, 0) + turned(0, -1) + turned(0, 1);
      p = (f + 2) >> 2;
      if (how[l] == 2 && u >= 2 && v >= 2 && u <= n - 2 && v <= n - 2) {
        int sum = 0;
        for (int a : {-2, 2})
          for (int b : {-1, 1}) sum += at(a, b) + at(b, a);
        p = (10 * f - sum + 16) >> 5;
      }
    }
    int w = p - line, f = 0;
    if (d[l] != 1) {
      const int t = 8 * (p - line) / d[l];
      w = (t + 4) >> 3;
      f = t - 8 * w;
    }
    int found = 0;
    if (open) {
      auto size = [&](int dx, int dy) {
        const int a = x + dx, b = y + dy;
        return a < 0 || b < 0 || a > n || b > n ? 0 : std::min(std::abs(e[b * s][a * s]), 2047);
      };
      int sum = 0;
      if (middle)
        sum = 2 * (size(-2, 0) + size(0, -2)) + size(-2, -2) + size(2, -2) + size(-1, -1) + size(1, -1) + size(-1, 1) +
              size(1, 1);
      else
        sum = 2 * (size(-2, 0) + size(!along_x, along_x) + size(-!along_x, -along_x)) + size(-1, -1) + size(1, -1) +
              size(along_x, !along_x) + size(-along_x, -!along_x);
      found = readE(coder, book, 2 * std::min(3 - l, 2) + middle, 0, 0, bucket(sum), f < -1 ? 0 : f > 1 ? 2 : 1, 17);
    }
    e[y * s][x * s] = found;
    to = wrapped(line + (w + found) * d[l]);
  }
};

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
    auto stream = [&] {
      uint32_t length = 0;
      for (size_t k = 0; k < 4; ++k) length |= uint32_t{bytes[at + k]} << 8 * k;
      at += 4 + length;
      return std::span(bytes).subspan(at - length, length);
    };
    Tails back = noise(c.tails.patches(), c.tails.channels);
    Coder coder(stream());
    HeightsReader heights{coder, {}, 1, {}, {}};
    heights.book.of_heights = true;
    for (size_t p = 0; p < back.patches(); ++p) heights.patch(back.heights.data() + p * kTailHeights);
    EXPECT_TRUE(coder.ended()) << c.name;
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    for (int plane = 0; plane < c.tails.channels / 3; ++plane)
      readPlane(stream(), c.tails.channels, plane, back.patches(), back.texels);
    EXPECT_EQ(at, bytes.size()) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
  }
}

}  // namespace
}  // namespace relievo::tail_code_test
