// Tails by grids: without loss whatever patches share, small where texels run evenly over patches, rounded within what
// was asked for, refused where bytes are damaged, and as PACKAGE.md says, by a reader of its own.
#include "texturing/codec/tail_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "tests/texturing/format_tails.h"
#include "tests/texturing/tail_fixture.h"
#include "texturing/codec/tail_code.h"

namespace relievo::tail_grid_test {
namespace {

using namespace format_tails;
using namespace tail_fixture;

using Quads = std::vector<std::array<uint32_t, 4>>;

// Patches in rows of `columns`, of which every third is turned: sides run either way.
Quads inRows(size_t patches, uint32_t columns) {
  Quads out;
  for (uint32_t p = 0; p < patches; ++p) {
    const uint32_t at = p / columns * (columns + 1) + p % columns;
    std::array<uint32_t, 4> q{at, at + 1, at + columns + 1, at + columns + 2};
    if (p % 3 == 1) q = {q[1], q[3], q[0], q[2]};
    out.push_back(q);
  }
  return out;
}
Quads apart(size_t patches) {
  Quads out;
  for (uint32_t p = 0; p < patches; ++p) out.push_back({4 * p, 4 * p + 1, 4 * p + 2, 4 * p + 3});
  return out;
}

constexpr std::array<std::array<size_t, 2>, 4> kSides{{{0, 1}, {2, 3}, {0, 2}, {1, 3}}};
size_t cornerSample(size_t k) { return k % 2 * 16 + k / 2 * 272; }
size_t sideSample(size_t side, size_t i) { return cornerSample(kSides[side][0]) + i * (side < 2 ? 1 : 17); }

// What a patch before has of this one's samples; -1 elsewhere. The last one counts.
std::array<int, 289> sharedWith(std::span<const uint16_t> heights, const Quads& quads, size_t patch) {
  std::array<int, 289> out;
  out.fill(-1);
  for (size_t before = 0; before < patch; ++before) {
    const uint16_t* there = heights.data() + before * 289;
    for (size_t k = 0; k < 4; ++k)
      for (size_t j = 0; j < 4; ++j)
        if (quads[patch][k] == quads[before][j]) out[cornerSample(k)] = there[cornerSample(j)];
    for (size_t s = 0; s < 4; ++s)
      for (size_t t = 0; t < 4; ++t) {
        auto ends = [](const std::array<uint32_t, 4>& q, size_t side) {
          return std::pair(q[kSides[side][0]], q[kSides[side][1]]);
        };
        const auto here = ends(quads[patch], s), other = ends(quads[before], t);
        const bool reversed = here == std::pair(other.second, other.first);
        if (here != other && !reversed) continue;
        for (size_t i = 1; i < 16; ++i) out[sideSample(s, i)] = there[sideSample(t, reversed ? 16 - i : i)];
      }
  }
  return out;
}
// The same heights where patches meet.
void share(Tails& t, const Quads& quads) {
  for (size_t p = 0; p < t.patches(); ++p) {
    const auto shared = sharedWith(t.heights, quads, p);
    for (size_t i = 0; i < 289; ++i)
      if (shared[i] >= 0) t.heights[p * 289 + i] = static_cast<uint16_t>(shared[i]);
  }
}

uint8_t& texelOf(Tails& t, size_t patch, int level, int channel, int x, int y) {
  const int side = 16 >> level;
  return t.texels[patch * kTailPatchTexels * static_cast<size_t>(t.channels) +
                  static_cast<size_t>(t.channels) * kTailLevelAt[static_cast<size_t>(level)] +
                  static_cast<size_t>((channel * side + y) * side + x)];
}
void halve(Tails& t) {
  for (size_t p = 0; p < t.patches(); ++p)
    for (int level = 1; level < 4; ++level)
      for (int c = 0; c < t.channels; ++c)
        for (int i = 0; i < (16 >> level) * (16 >> level); ++i) {
          const int x = i % (16 >> level), y = i / (16 >> level);
          int sum = 2;
          for (int k = 0; k < 4; ++k) sum += texelOf(t, p, level - 1, c, 2 * x + k % 2, 2 * y + k / 2);
          texelOf(t, p, level, c, x, y) = static_cast<uint8_t>(sum >> 2);
        }
}
// Normals as a scan's own triangles have them: from corner to corner, the same at one corner in all patches. Heights 0.
Tails triangles(const Quads& quads, int fold) {
  Tails t = empty(quads.size(), 6);
  std::mt19937 random(kSeed);
  std::map<uint32_t, std::array<double, 3>> normals;
  for (size_t p = 0; p < quads.size(); ++p) {
    std::array<std::array<double, 3>, 4> n;
    for (size_t k = 0; k < 4; ++k) {
      auto [it, made] = normals.try_emplace(quads[p][k]);
      if (made) {
        auto some = [&] { return (static_cast<int>(random() % 201) - 100) * 0.004; };
        it->second = {some(), some(), 1};
      }
      n[k] = it->second;
    }
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x) {
        const double u = (x + 0.5) / 16, v = (y + 0.5) / 16;
        std::array<double, 3> at{};
        for (size_t c = 0; c < 3; ++c)
          at[c] = n[0][c] * (1 - std::max(u, v)) + n[3][c] * std::min(u, v) +
                  (u > v ? n[1][c] * (u - v) : n[2][c] * (v - u));
        if (fold && u > v) at[0] += 0.4;  // a crease along the diagonal
        const double length = std::sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2]);
        for (int c = 0; c < 3; ++c) {
          texelOf(t, p, 0, c, x, y) = 200;
          texelOf(t, p, 0, 3 + c, x, y) =
              static_cast<uint8_t>(std::lround(127.5 * (at[static_cast<size_t>(c)] / length + 1)));
        }
      }
  }
  halve(t);
  return t;
}

struct Case {
  std::string name;
  Tails tails;
  Quads quads;
};
std::vector<Case> cases() {
  std::vector<Case> all;
  for (Contents& c : contents()) {
    all.push_back({std::string(c.name) + ", apart", c.tails, apart(c.tails.patches())});
    all.push_back({std::string(c.name) + ", not the same where patches meet", c.tails, inRows(c.tails.patches(), 3)});
    for (const uint32_t columns : {2u, 3u}) {
      Tails shared = c.tails;
      share(shared, inRows(c.tails.patches(), columns));
      all.push_back({std::string(c.name) + ", shared", shared, inRows(c.tails.patches(), columns)});
    }
  }
  for (int fold : {0, 1}) {
    Tails t = triangles(inRows(40, 7), fold);
    all.push_back({"triangles", t, inRows(40, 7)});
    roundTailTexels(t.texels, 6, 1, {true, 3, 1});
    all.push_back({"rounded triangles", t, inRows(40, 7)});
  }
  for (const int most : {1, 2, 8, 40}) {
    Tails t = smooth(12, true);
    for (int plane : {0, 1}) roundTailTexels(t.texels, 6, plane, {true, most, 1.0 * most});
    all.push_back({"rounded by up to " + std::to_string(most), t, apart(12)});
  }
  // A side that three patches share, and two patches with two sides in common.
  Tails three = smooth(4, false);
  const Quads quads{{0, 1, 2, 3}, {0, 1, 4, 5}, {1, 0, 6, 7}, {0, 1, 2, 8}};
  share(three, quads);
  all.push_back({"three at a side", three, quads});
  return all;
}

std::vector<uint8_t> encoded(const Tails& t, const Quads& quads) {
  std::vector<uint8_t> out;
  encodeTailCode(t.heights, t.texels, t.channels, quads, out);
  return out;
}
size_t bytesOfTexels(const Tails& t, const Quads& quads) {
  const auto bytes = encoded(t, quads);
  return bytes.size() - tailCodeHeightBytes(bytes);
}

TEST(TailGrid, DecodesToWhatWasEncoded) {
  for (const Case& c : cases()) {
    Tails back = noise(c.tails.patches(), c.tails.channels);
    const auto bytes = encoded(c.tails, c.quads);
    ASSERT_TRUE(decodeTailCode(bytes, c.tails.channels, c.quads, back.heights, back.texels)) << c.name;
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
    Tails heights = noise(c.tails.patches(), c.tails.channels);
    ASSERT_TRUE(decodeTailHeights(bytes, c.quads, heights.heights)) << c.name;
    EXPECT_TRUE(heights.heights == c.tails.heights) << c.name;
  }
}

// What patches share is told once: patches that meet take less than the same patches apart, and heights that are 0
// everywhere next to nothing. Control: where they differ where they meet, nothing is gained.
TEST(TailGrid, WhatIsSharedIsToldOnce) {
  auto heightBytes = [](const Tails& t, const Quads& quads) { return tailCodeHeightBytes(encoded(t, quads)); };
  Tails t = smooth(200, false);
  const Quads rows = inRows(200, 20);
  const size_t differ = heightBytes(t, rows);
  EXPECT_LT(heightBytes(t, apart(200)), differ + 200) << "control";
  EXPECT_GT(heightBytes(t, apart(200)), differ - 200) << "control";
  share(t, rows);
  EXPECT_LT(heightBytes(t, rows) * 100, heightBytes(t, apart(200)) * 95);
  const Tails flat = triangles(rows, 0);
  EXPECT_LT(heightBytes(flat, rows), 200 / 4) << "less than two bits a patch";
  EXPECT_LT(bytesOfTexels(flat, rows) * 100, bytesOfTexels(flat, apart(200)) * 97) << "corners of normals";
}

// Normals that run from corner to corner take a third of what rows of texels take, once both are rounded.
TEST(TailGrid, EvenTexelsTakeFarFewerBytesThanInRows) {
  const Quads rows = inRows(200, 20);
  const Tails exact = triangles(rows, 0);
  Tails by_grids = exact, in_rows = exact;
  roundTailTexels(by_grids.texels, 6, 1, {true, 3, 1});
  roundTailTexels(in_rows.texels, 6, 1, {false, 1, 1});
  EXPECT_LT(3 * bytesOfTexels(by_grids, rows), bytesOfTexels(in_rows, {}));
  // What has no order gains nothing, and loses little.
  const Tails random = noise(20, 6);
  EXPECT_LT(bytesOfTexels(random, apart(20)) * 10, bytesOfTexels(random, {}) * 11);
}

TEST(TailGrid, RoundedTexelsStayWithinWhatWasAskedFor) {
  for (const bool fold : {false, true}) {
    const Tails exact = fold ? triangles(inRows(60, 9), 1) : smooth(60, false);
    const size_t before = bytesOfTexels(exact, apart(60));
    for (const auto& [most, rms] : {std::pair{0, 1.0}, {1, 1.0}, {3, 1.0}, {8, 2.0}, {8, 100.0}}) {
      Tails t = exact;
      roundTailTexels(t.texels, 6, 1, {true, most, rms});
      int furthest = 0, at_border = 0;
      double worst = 0;
      for (size_t p = 0; p < 60; ++p)
        for (int c = 0; c < 6; ++c) {
          double squares = 0;
          for (int y = 0; y < 16; ++y)
            for (int x = 0; x < 16; ++x) {
              const int off = std::abs(texelOf(t, p, 0, c, x, y) - texelOf(const_cast<Tails&>(exact), p, 0, c, x, y));
              if (c < 3) {
                ASSERT_EQ(off, 0) << "the other plane";
              }
              furthest = std::max(furthest, off);
              if (x % 15 == 0 || y % 15 == 0) at_border = std::max(at_border, off);
              squares += off * off;
            }
          worst = std::max(worst, std::sqrt(squares / 256));
        }
      EXPECT_LE(furthest, most);
      EXPECT_LE(at_border, (most + 1) / 2);
      EXPECT_LE(worst, rms);
      const size_t bytes = bytesOfTexels(t, apart(60));
      if (most == 0) {
        EXPECT_EQ(bytes, before);
      } else {
        EXPECT_LT(bytes, before) << most << " " << rms;
      }
      if (rms == 100) {
        EXPECT_GT(worst, 1.1) << "control: the other limit counts, too";
        EXPECT_GT(furthest, 3);
      }
    }
  }
  Tails ends = noise(5, 3);
  for (uint8_t& texel : ends.texels) texel = texel < 128 ? texel % 4 : 255 - texel % 4;
  const Tails same = ends;
  roundTailTexels(ends.texels, 3, 0, {true, 3, 100});
  for (size_t i = 0; i < ends.texels.size(); ++i) ASSERT_LE(std::abs(ends.texels[i] - same.texels[i]), 3);
}

TEST(TailGrid, DamagedBytesAreRefusedOrDecodeToSomething) {
  const Quads quads = inRows(12, 4);
  Tails t = smooth(12, true);
  share(t, quads);
  expectDamageIsRefused(encoded(t, quads), quads, inRows(11, 4), inRows(13, 4));
}

// ---- a reader by what PACKAGE.md says ----

int readNumber(Coder& coder, ModelBook& book, int of) {
  const int width = symbol(coder, book, 'w', of, 5);
  int value = width > 0;
  for (int k = 0; k < width - 1; ++k)
    value = 2 * value + (k < 2 ? coder.bit(book.at('b', of, width, k)) : static_cast<int>(coder.plain(1)));
  return value % 2 ? -(value / 2) - 1 : value / 2;
}

void readHeights(std::span<const uint8_t> bytes, const Quads& quads, std::vector<uint16_t>& heights) {
  Coder coder(bytes);
  HeightsReader reader{coder, {}, 1, {}, {}, {}, true};
  reader.book.of_heights = true;
  ModelBook numbers;
  const bool shared = coder.plain(1);
  for (size_t p = 0; p < quads.size(); ++p) {
    if (shared) reader.given = sharedWith(heights, quads, p);
    else reader.given.fill(-1);
    auto& given = reader.given;
    for (size_t k = 0; k < 4; ++k) {
      int& h = given[cornerSample(k)];
      if (h >= 0) continue;
      const int x = k == 0   ? (p == 0 ? 0 : heights[(p - 1) * 289])
                    : k == 3 ? given[16] + given[272] - given[0]
                             : given[0];
      h = (x + readNumber(coder, numbers, k > 0)) & 0xFFFF;
    }
    reader.patch(heights.data() + p * 289);
  }
  EXPECT_TRUE(coder.ended());
}

class TexelsReader {
 public:
  TexelsReader(std::span<const uint8_t> bytes, Tails& t, int plane) : coder_(bytes), t_(t), plane_(plane) {
    levels_.of_texels = true;
  }
  void run(const Quads& quads) {
    for (patch_ = 0; patch_ < quads.size(); ++patch_) {
      even_ = coder_.bit(book_.at('p', even_));
      if (even_) {
        for (int level = 0; level < 4; ++level)
          for (int i = 0; i < (16 >> level) * (16 >> level); ++i)
            for (int c = 0; c < 3; ++c) at(c, i % (16 >> level), i / (16 >> level), level) = first(c);
      } else {
        patch(quads);
      }
      for (size_t c = 0; c < 3; ++c) first_[c] = at(static_cast<int>(c), 0, 0);
      for (size_t k = 0; k < 4; ++k)
        for (int c = 0; c < 3; ++c) corner_texels_[{quads[patch_][k], c}] = at(c, 15 * (k % 2), 15 * (k / 2));
    }
    EXPECT_TRUE(coder_.ended());
  }

 private:
  uint8_t first(int c) const { return static_cast<uint8_t>(first_[static_cast<size_t>(c)]); }
  uint8_t& at(int c, size_t x, size_t y, int level = 0) {
    return texelOf(t_, patch_, level, 3 * plane_ + c, static_cast<int>(x), static_cast<int>(y));
  }
  // By indices, of which 16 is the last texel.
  uint8_t& of(int c, int x, int y) {
    return at(c, static_cast<size_t>(std::min(x, 15)), static_cast<size_t>(std::min(y, 15)));
  }
  static int squared(int v) { return (2 * v - 255) * (2 * v - 255); }

  void patch(const Quads& quads) {
    static const int kReaches[] = {0, 1, 2, 3, 5, 8, 12, 18};
    kind_ = std::min(symbol(coder_, book_, 'K', kind_, 2), 2);
    reach_ = symbol(coder_, book_, 'R', reach_, 3);
    sizes_.clear();
    for (int k = 0; k < 4; ++k) {
      const bool known = corner_texels_.contains({quads[patch_][static_cast<size_t>(k)], 0});
      std::array<int, 3> p;
      int q = 0;
      for (int c = 0; c < 3; ++c) {
        p[static_cast<size_t>(c)] = known    ? corner_texels_[{quads[patch_][static_cast<size_t>(k)], c}]
                                    : k == 0 ? first(c)
                                    : k < 3  ? at(c, 0, 0)
                                             : std::clamp(at(c, 15, 0) + at(c, 0, 15) - at(c, 0, 0), 0, 255);
        q += squared(p[static_cast<size_t>(c)]);
      }
      texel(k % 2 * 16, k / 2 * 16, p, q, 1, [&](int place, int before) {
        const int models = 1000 + (known * 4 + k) * 3 + place;
        return readE(coder_, book_, models, models, models, std::min(15, bucket(6 * std::abs(before))), 1, 8);
      });
    }
    bool open = true;
    for (int level = 0; level < 4; ++level) {
      const int d = 8 >> level;
      open = coder_.bit(book_.at('o', level, open));
      for (bool middle : {true, false})
        for (int y = 0; y <= 16; y += d)
          for (int x = 0; x <= 16; x += d) {
            if (x == 15 || y == 15) continue;
            const bool odd_x = x / d % 2, odd_y = y / d % 2;
            if (middle ? odd_x && odd_y : odd_x != odd_y) added(x, y, level, d, middle, open, kReaches[reach_]);
          }
    }
    other_ = coder_.bit(book_.at('c', other_));
    for (int level = 1; level < 4; ++level)
      for (int c = 0; c < 3; ++c)
        for (size_t y = 0; y < (16u >> level); ++y)
          for (size_t x = 0; x < (16u >> level); ++x) {
            int s = 2;
            for (size_t k = 0; k < 4; ++k) s += at(c, 2 * x + k % 2, 2 * y + k / 2, level - 1);
            const int e = other_ ? readE(coder_, book_, 2000 + s % 4, 2000 + s % 4, 2000 + s % 4, 0, 1, 8) : 0;
            at(c, x, y, level) = static_cast<uint8_t>(std::clamp((s >> 2) + e, 0, 255));
          }
  }

  static int share(int x, int d) { return x + d == 16 ? (256 * d + d - 1) / (2 * d - 1) : 128; }
  void added(int x, int y, int level, int d, bool middle, bool open, int n) {
    using Place = std::array<int, 2>;
    std::array<Place, 4> near;  // the first pair, the second
    bool second = true;
    int w = 128;
    const bool along_x = !middle && x / d % 2;
    if (middle) {
      near = {Place{x - d, y - d}, {x + d, y + d}, {x + d, y - d}, {x - d, y + d}};
    } else if (along_x) {
      near = {Place{x - d, y}, {x + d, y}, {x, y - d}, {x, y + d}};
      second = y - d >= 0 && y + d <= 16 && y + d != 15;
      w = share(x, d);
    } else {
      near = {Place{x, y - d}, {x, y + d}, {x - d, y}, {x + d, y}};
      second = x - d >= 0 && x + d <= 16 && x + d != 15;
      w = share(y, d);
    }
    auto value = [&](int c, size_t k) -> int { return of(c, near[k][0], near[k][1]); };
    int s = 0, t = 0;
    for (int c = 0; c < 3 && second; ++c)
      s += std::abs(value(c, 0) - value(c, 1)), t += std::abs(value(c, 2) - value(c, 3));
    std::array<int, 3> p;
    for (int c = 0; c < 3; ++c) {
      int& to = p[static_cast<size_t>(c)];
      const int one = value(c, 0) * (256 - w) + value(c, 1) * w;
      if (middle && (share(x, d) != 128 || share(y, d) != 128)) {
        const int wx = share(x, d), wy = share(y, d), above = value(c, 0) * (256 - wx) + value(c, 2) * wx,
                  below = value(c, 3) * (256 - wx) + value(c, 1) * wx;
        to = (above * (256 - wy) + below * wy + 32768) / 65536;
      } else if (!second || 2 * s + 16 < t) {
        to = (one + 128) / 256;
      } else {
        const int two = 128 * (value(c, 2) + value(c, 3));
        to = 2 * t + 16 < s ? (two + 128) / 256 : (one + two + 256) / 512;
      }
    }
    int q = 0;
    for (size_t k = 0; k < (middle ? 4u : 2u); ++k)
      for (int c = 0; c < 3; ++c) q += squared(value(c, k));
    const bool border = x == 0 || y == 0 || x == 16 || y == 16;
    const int reach = border ? (n + 1) >> 1 : n, m = (const int[]){3, 5, 10, 16}[level];
    texel(x, y, p, q / (middle ? 4 : 2), 2 * ((reach * m + 8) >> 4) + 1, [&](int place, int before) {
      if (!open) return 0;
      auto size = [&](int dx, int dy) {
        const auto it = sizes_.find({place, x + dx * d, y + dy * d});
        return it == sizes_.end() ? 0 : it->second;
      };
      auto mirrored = [&](int dx, int dy) {
        const int a = x + dx * d, b = y + dy * d;
        return size(a < 0 || a > 16 ? -dx : dx, b < 0 || b > 16 ? -dy : dy);
      };
      int sum = 6 * std::abs(before) + 2 * size(-2, 0) + 2 * size(0, -2);
      if (middle) sum += size(-1, -1) + size(1, -1) + size(-1, 1) + size(1, 1) + size(-2, -2) + size(2, -2);
      else sum += mirrored(-1, 0) + mirrored(1, 0) + mirrored(0, -1) + mirrored(0, 1) + size(-1, -1) + size(1, -1);
      const int models = (level * 2 + middle) * 3 + place;
      const int e = readE(coder_, levels_, models, models, models, std::min(15, bucket(sum)), 1, 8);
      sizes_[{place, x, y}] = std::min(std::abs(e), 255);
      return e;
    });
  }
  // Reads three channels in their order.
  template <class Read>
  void texel(int x, int y, const std::array<int, 3>& p, int q, int step, Read&& read) {
    std::array<int, 3> order{0, 1, 2};
    auto off = [&](size_t k) { return std::abs(2 * p[static_cast<size_t>(order[k])] - 255); };
    if (kind_ == 2)
      for (size_t k : {0u, 1u, 0u})
        if (off(k) > off(k + 1)) std::swap(order[k], order[k + 1]);
    int before = 0;
    for (int place = 0; place < 3; ++place) {
      const int c = order[static_cast<size_t>(place)];
      int guess = p[static_cast<size_t>(c)];
      if (kind_ == 1) guess = std::clamp(guess + before * step, 0, 255);
      if (kind_ == 2 && place == 2) {
        q -= squared(of(order[0], x, y)) + squared(of(order[1], x, y));
        if (q > 0) {
          int r = 0;
          while ((r + 1) * (r + 1) <= q) ++r;
          guess = std::clamp((256 + (2 * guess < 255 ? -r : r)) >> 1, 0, 255);
        }
      }
      before = read(place, before);
      of(c, x, y) = static_cast<uint8_t>(std::clamp(guess + before * step, 0, 255));
    }
  }

  Coder coder_;
  Tails& t_;
  const int plane_;
  ModelBook book_, levels_;  // those of levels begin as relief's
  size_t patch_ = 0;
  int even_ = 0, kind_ = 0, reach_ = 0, other_ = 0;
  std::array<int, 3> first_{128, 128, 128};
  std::map<std::pair<uint32_t, int>, int> corner_texels_;
  std::map<std::tuple<int, int, int>, int> sizes_;
};

TEST(TailGrid, IsAsThePackageFormatSays) {
  for (const Case& c : cases()) {
    const std::vector<uint8_t> bytes = encoded(c.tails, c.quads);
    size_t at = 0;
    Tails back = noise(c.tails.patches(), c.tails.channels);
    readHeights(nextStream(bytes, at), c.quads, back.heights);
    EXPECT_TRUE(back.heights == c.tails.heights) << c.name;
    for (int plane = 0; plane < c.tails.channels / 3; ++plane)
      TexelsReader(nextStream(bytes, at), back, plane).run(c.quads);
    EXPECT_EQ(at, bytes.size()) << c.name;
    EXPECT_TRUE(back.texels == c.tails.texels) << c.name;
  }
}

}  // namespace
}  // namespace relievo::tail_grid_test
