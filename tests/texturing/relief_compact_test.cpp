// Relief pages in compact form: every sample comes back, whatever the page; what is in the texels, to the bit; which
// pages fit which part.
#include "texturing/codec/relief_compact.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include "texturing/stream/relief_subslots.h"

namespace relievo {
namespace relief_compact_test {

using Height = std::function<int(int x, int y)>;  // of a page's cells

// A page of so many cells a side; samples between are others, so that they would be seen.
std::vector<uint8_t> pageOf(int cells, const Height& height) {
  std::vector<uint8_t> texels(kSlotBytes, 0x5A);
  const int step = kPagePx / cells;
  for (int y = 0; y <= kPagePx; ++y)
    for (int x = 0; x <= kPagePx; ++x) {
      const int q = x % step == 0 && y % step == 0 ? height(x / step, y / step) : 65535 * ((x + y) % 2);
      uint8_t* t = texels.data() + 4 * (y * kPageFullPx + x);
      t[0] = static_cast<uint8_t>(q >> 8);
      t[1] = static_cast<uint8_t>(q & 255);
    }
  return texels;
}

int differing(const std::vector<uint8_t>& packed, int cells, const Height& height) {
  int count = 0;
  for (int y = 0; y <= cells; ++y)
    for (int x = 0; x <= cells; ++x) count += compactSample(packed, cells, x, y) != height(x, y);
  return count;
}

// Packed into exactly the texels that it says; what is behind them stays.
std::vector<uint8_t> packed(const std::vector<uint8_t>& page, int cells) {
  const auto texels = compactTexels(page, cells);
  EXPECT_TRUE(texels);
  if (!texels) return {};
  std::vector<uint8_t> out(size_t{4} * *texels + 8, 0xC3);
  packCompact(page, cells, out);
  for (size_t i = out.size() - 8; i < out.size(); ++i) EXPECT_EQ(out[i], 0xC3) << "beyond its texels";
  return out;
}

struct Case {
  const char* name;
  Height height;
  bool sixteen_bits = false;  // all residuals: of 128 cells more than headers can say the places of
};
std::vector<Case> cases() {
  auto noise = [](int x, int y, int bits) {
    return static_cast<int>(
        (static_cast<uint32_t>(x) * 73856093u ^ static_cast<uint32_t>(y) * 19349663u) * 2654435761u >> (32 - bits));
  };
  return {{"flat", [](int, int) { return 1234; }},
          {"all 0", [](int, int) { return 0; }},
          {"all 65535", [](int, int) { return 65535; }},
          {"a ramp along x", [](int x, int) { return x * 511; }},
          {"a ramp down along y", [](int, int y) { return 65535 - y * 511; }},
          {"steep, beyond what slopes can say", [](int x, int y) { return (x * 1900 + y * 1100) % 65536; }},
          {"saw teeth of the whole range", [](int x, int y) { return (x + y) % 2 * 65535; }, true},
          {"a dip on a slope: the plane's base lies below 0",
           [](int x, int y) { return std::max(0, 100 + 400 * (x % 8) - (x % 8 == 7 ? 5000 : 0) + y); }},
          {"noise of 3 bits on a slope", [=](int x, int y) { return 20000 + 37 * x - 90 * y + noise(x, y, 3); }},
          {"noise of 10 bits", [=](int x, int y) { return 30000 + noise(x, y, 10); }},
          {"noise of 13 bits", [=](int x, int y) { return noise(x, y, 13); }},
          {"noise of 15 bits", [=](int x, int y) { return noise(x, y, 15); }, true},
          {"waves",
           [](int x, int y) { return static_cast<int>(32768 + 32000 * std::sin(0.021 * x) * std::cos(0.013 * y)); }},
          {"one sample apart", [](int x, int y) { return x == 9 && y == 15 ? 65535 : 0; }}};
}

TEST(ReliefCompact, EverySampleComesBack) {
  for (int cells : {128, 64, 32})
    for (const Case& c : cases()) {
      if (c.sixteen_bits && cells == 128) {
        EXPECT_FALSE(compactTexels(pageOf(cells, c.height), cells)) << c.name;
        continue;
      }
      const auto out = packed(pageOf(cells, c.height), cells);
      ASSERT_FALSE(out.empty()) << c.name << ", " << cells << " cells";
      EXPECT_EQ(differing(out, cells, c.height), 0) << c.name << ", " << cells << " cells";
    }
}

// A twin that took a width for one less, or a slope for one more, reads other samples.
// Bytes that end where memory does.
class AtTheEnd {
 public:
  explicit AtTheEnd(const std::vector<uint8_t>& bytes) : page_(static_cast<size_t>(sysconf(_SC_PAGESIZE))) {
    all_ = (bytes.size() / page_ + 2) * page_;
    void* at = mmap(nullptr, all_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    begin_ = at == MAP_FAILED ? nullptr : static_cast<uint8_t*>(at);
    if (!begin_ || mprotect(begin_ + all_ - page_, page_, PROT_NONE) != 0) return;
    bytes_ = std::span(begin_ + all_ - page_ - bytes.size(), bytes.size());
    std::copy(bytes.begin(), bytes.end(), bytes_.begin());
  }
  ~AtTheEnd() {
    if (begin_) munmap(begin_, all_);
  }
  std::span<const uint8_t> bytes() const { return bytes_; }

 private:
  size_t page_, all_ = 0;
  uint8_t* begin_ = nullptr;
  std::span<uint8_t> bytes_;
};

// A page whose last block has no residuals: nothing of them is read.
TEST(ReliefCompact, NothingIsReadBehindTheTexels) {
  for (const int cells : {128, 64, 32}) {
    for (const int slope : {0, 8}) {
      const Height height = [&](int x, int y) { return 1000 + slope * (x + 2 * y); };
      std::vector<uint8_t> whole = packed(pageOf(cells, height), cells);
      whole.resize(whole.size() - 8);
      const AtTheEnd end(whole);
      ASSERT_EQ(end.bytes().size(), whole.size());
      for (int y = 0; y <= cells; ++y)
        for (int x = 0; x <= cells; ++x) ASSERT_EQ(compactSample(end.bytes(), cells, x, y), height(x, y));
    }
  }
}

TEST(ReliefCompact, AWrongWidthOrSlopeIsSeen) {
  const Case noisy = cases()[8];
  for (int cells : {128, 64, 32}) {
    auto out = packed(pageOf(cells, noisy.height), cells);
    const int own = kCompactBlock * kCompactBlock;  // of block 0
    out[5] ^= 1;                                    // its width's lowest bit
    EXPECT_GE(differing(out, cells, noisy.height), own / 2);
    EXPECT_LE(differing(out, cells, noisy.height), own);
    out[5] ^= 1;
    out[2] ^= 1;  // its slope along x
    EXPECT_EQ(differing(out, cells, noisy.height), own - kCompactBlock) << "all but its first column";
    out[2] ^= 1;
    out[3] ^= 1;  // along y
    EXPECT_EQ(differing(out, cells, noisy.height), own - kCompactBlock) << "all but its first row";
    out[3] ^= 1;
    out[7] ^= 16;  // where block 1's residuals begin, by two texels
    EXPECT_GE(differing(out, cells, noisy.height), own / 2);
    out[7] ^= 16;
    EXPECT_EQ(differing(out, cells, noisy.height), 0);
  }
}

// What it takes, by hand: 3 texels for two headers, 2 w texels for a block of 8 x 8 samples; planes take nothing more.
TEST(ReliefCompact, TexelsAreThoseOfTheFormat) {
  for (int cells : {128, 64, 32}) {
    const auto blocks = static_cast<uint32_t>(cells / kCompactBlock);
    EXPECT_EQ(compactTexels(pageOf(cells, [](int x, int y) { return 16 * x + 24 * y; }), cells),
              blocks * blocks * 3 / 2);
    // Every block has two heights 1 apart: a bit a sample, 64, 72 or 81 of them, in pairs of texels.
    EXPECT_EQ(compactTexels(pageOf(cells, [](int x, int y) { return 500 + (x + y) % 2; }), cells),
              blocks * blocks * 3 / 2 + 2 * blocks * blocks + 2 * (2 * blocks - 1));
  }
  const auto out = packed(pageOf(32, [](int x, int y) { return 1000 + 16 * x - 24 * y; }), 32);
  EXPECT_EQ(out[0] | out[1] << 8, 1000);
  EXPECT_EQ(out[2], 2);                      // 16 steps of height
  EXPECT_EQ(out[3], 253);                    // -24
  EXPECT_EQ(out[4] << 8 | out[5], 12 << 4);  // no bits, from the twelfth pair on: behind 16 headers
  EXPECT_EQ(out[6] << 8 | out[7], 12 << 4);  // block 1's
  EXPECT_EQ(out[8] | out[9] << 8, 1000 + 128);
}

TEST(ReliefCompact, WhatFitsAPartTakesIt) {
  std::mt19937 random(20261122);
  for (int coarser = 0; coarser <= 2; ++coarser) {
    const int cells = kPagePx >> coarser, level = kThirds + coarser;
    // Pages of which every (1 << coarser)-th sample is kept and the others follow; noise of so many bits.
    auto page = [&](int bits) {
      std::vector<int> q(static_cast<size_t>((cells + 1) * (cells + 1)));
      for (int& h : q) h = static_cast<int>(random() >> (32 - bits));
      const int up = coarser;
      return pageOf(kPagePx, [&q, cells, up](int x, int y) {
        const int x0 = std::min(x >> up, cells - 1), y0 = std::min(y >> up, cells - 1), fx = x - (x0 << up),
                  fy = y - (y0 << up), n = 1 << up;
        const int* c = q.data() + y0 * (cells + 1) + x0;
        const int sum = fx >= fy ? c[0] * (n - fx) + c[1] * (fx - fy) + c[cells + 2] * fy
                                 : c[0] * (n - fy) + c[cells + 1] * (fy - fx) + c[cells + 2] * fx;
        return (sum + n / 2) >> up;
      });
    };
    for (int bits = 1; bits <= 16; ++bits) {
      const auto texels = page(bits);
      const int found = reliefPartLevel(texels, ReliefParts::kCompact);
      ASSERT_EQ(reliefStepLog2(found), coarser);
      EXPECT_EQ(reliefPartLevel(texels, ReliefParts::kSmall), plainLevel(level));
      EXPECT_EQ(reliefPartLevel(texels, ReliefParts::kOnlyHalves), kHalves);
      if (bits <= 9) {
        EXPECT_EQ(found, level) << bits;
      }
      if (bits >= 12) {
        EXPECT_EQ(found, plainLevel(level)) << "noise of " << bits << " bits stays as it is";
      }
      if (!isThird(found)) continue;
      std::vector<uint8_t> part(partBytes(found), 0xEE);
      packRelief(texels, found, part);
      for (int y = 0; y <= cells; ++y)
        for (int x = 0; x <= cells; ++x) {
          const uint8_t* t = texels.data() + 4 * ((y << coarser) * kPageFullPx + (x << coarser));
          ASSERT_EQ(compactSample(part, cells, x, y), t[0] << 8 | t[1]) << x << ", " << y;
        }
    }
  }
  // Every other sample is 0 or 65535: more bits than a part has, but no harm done.
  EXPECT_EQ(reliefPartLevel(pageOf(kPagePx, [](int x, int y) { return (x + y) % 2 * 65535; }), ReliefParts::kCompact),
            kHalves);
}

// compactPlace() of shaders/compact_relief.glsl divides by multiplying.
TEST(ReliefCompact, RowsOfTexelsAsTheShaderFindsThem) {
  for (int level = kThirds; level < kPartLevels; ++level) {
    const int coarser = reliefStepLog2(level), columns = kPageFullPx >> coarser;
    ASSERT_EQ(partColumns(level), columns);
    for (int i = 0; i <= partColumns(level) * partRows(level); ++i)
      ASSERT_EQ(((i << coarser) * 7711) >> 20, i / columns) << i;
  }
}

}  // namespace relief_compact_test
}  // namespace relievo
