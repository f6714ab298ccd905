// Texture pages level by level: what is shown lies within the tolerances, in few bytes; damaged bytes are refused; and
// all is as PACKAGE.md says, by a reader of its own.
#include "texturing/codec/texel_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <map>
#include <memory>
#include <random>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "tests/texturing/format_coder.h"
#include "tests/texturing/page_of.h"
#include "texturing/codec/page_codec.h"

namespace relievo::texel_code_test {
namespace {

using format_coder::Coder;
using format_coder::Model;

constexpr uint32_t kSeed = 20261127;
constexpr int kSide = kPageFullPx;
constexpr size_t kChannel = size_t{kSide} * kSide;
using Page = std::vector<uint8_t>;
using Tolerances = std::array<ChannelTolerance, 3>;
constexpr Tolerances kOfNormals{{{8, 1}, {8, 1}, {8, 1}}}, kOfColours{{{2, 1}, {2, 1}, {2, 1}}}, kExact{};

using testing_support::pageOf;

// Normals of a wavy surface, beyond an oblique line tilted: a crease.
Page normals(double waves, bool creased) {
  return pageOf([=](int c, int x, int y) {
    const double u = waves * x / kSide, v = waves * y / kSide, tilt = creased && 3 * x + y > 2 * kSide ? 0.9 : 0,
                 dx = 0.3 * std::sin(6.28 * u) + tilt, dy = 0.3 * std::cos(6.28 * v + u),
                 length = std::sqrt(dx * dx + dy * dy + 1);
    return 127.5 * ((c == 0 ? -dx : c == 1 ? -dy : 1) / length + 1);
  });
}
// A brown's shades: what one channel differs by, the others do, too.
Page painted() {
  std::mt19937 random(kSeed);
  std::vector<double> grain(kChannel);
  for (double& g : grain) g = static_cast<double>(random() % 13) - 6;
  return pageOf([&](int c, int x, int y) {
    return 120 - 20 * c + 40 * std::sin(x / 20.0) + grain[static_cast<size_t>(y * kSide + x)];
  });
}
Page noise() {
  std::mt19937 random(kSeed);
  return pageOf([&](int, int, int) { return static_cast<double>(random() % 256); });
}
Page flatWithSpikes() {
  return pageOf(
      [](int c, int x, int y) { return (x % 50 == 7 && y % 60 == 11) || (x == 0 && y == 135) ? 255 : 90 * c; });
}

struct Off {
  double most = 0, rms = 0, at_edges = 0;
  bool within(const ChannelTolerance& t) const { return most <= t.most && rms <= t.rms && at_edges <= t.most / 2; }
};
Off offOf(const Page& a, const Page& b, size_t channel) {
  auto isEdge = [](int i) { return i == 3 || i == 4 || i == 131 || i == 132; };
  Off out;
  double squares = 0;
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) {
      const size_t i = channel * kChannel + static_cast<size_t>(y * kSide + x);
      const double d = std::abs(static_cast<double>(a[i]) - b[i]);
      out.most = std::max(out.most, d);
      if (isEdge(x) || isEdge(y)) out.at_edges = std::max(out.at_edges, d);
      squares += d * d;
    }
  out.rms = std::sqrt(squares / kChannel);
  return out;
}

std::vector<uint8_t> encoded(const Page& page, const Tolerances& tolerances) {
  const auto scratch = std::make_unique<TexelCodeScratch>();
  std::vector<uint8_t> out;
  encodeTexelCode(page, tolerances, *scratch, out);
  return out;
}
Page decoded(std::span<const uint8_t> bytes) {
  const auto scratch = std::make_unique<TexelCodeScratch>();
  scratch->texels.fill(77), scratch->sizes.fill(99), scratch->planned.fill(1234);
  Page out(kTexturePageBytes, 55);
  EXPECT_TRUE(decodeTexelCode(bytes, *scratch, out));
  return out;
}

struct Contents {
  const char* name;
  Page page;
  Tolerances tolerances;
};
std::vector<Contents> contents() {
  return {{"smooth", normals(0.7, false), kOfNormals},
          {"creased", normals(2, true), kOfNormals},
          {"rough", normals(9, true), kOfNormals},
          {"exactly", normals(2, true), kExact},
          {"painted", painted(), kOfColours},
          {"noise", noise(), kOfNormals},
          {"noise, exactly", noise(), kExact},
          {"spikes", flatWithSpikes(), kOfColours},
          {"one value", pageOf([](int, int, int) { return 255; }), kOfNormals},
          {"anything", noise(), {{{255, 255}, {255, 255}, {255, 255}}}}};
}

TEST(TexelCode, ShowsPagesWithinTheirTolerances) {
  bool differs = false;
  for (const Contents& c : contents()) {
    const Page shown = decoded(encoded(c.page, c.tolerances));
    for (size_t k = 0; k < 3; ++k) {
      const Off off = offOf(c.page, shown, k);
      EXPECT_TRUE(off.within(c.tolerances[k]))
          << c.name << " " << k << ": " << off.most << ", " << off.rms << ", " << off.at_edges;
      differs = differs || off.most > 2;
    }
    if (c.tolerances[0].most == 0) {
      EXPECT_TRUE(shown == c.page) << c.name;
    }
  }
  EXPECT_TRUE(differs) << "control: tolerances are used";
}

// Each of the three bounds is one: what keeps it alone takes more bytes than what keeps none.
TEST(TexelCode, EachToleranceCounts) {
  const Page page = normals(6, true);
  const size_t free = encoded(page, {{{64, 64}, {64, 64}, {64, 64}}}).size();
  EXPECT_GT(encoded(page, {{{64, 64}, {64, 1}, {64, 64}}}).size(), free);
  EXPECT_GT(encoded(page, {{{64, 64}, {64, 64}, {4, 64}}}).size(), free);
  const Off off = offOf(page, decoded(encoded(page, {{{12, 64}, {12, 64}, {12, 64}}})), 0);
  EXPECT_LE(off.at_edges, 6);
}

TEST(TexelCode, SmoothAndCreasedPagesTakeAFractionOfLosslessOnes) {
  PageEncoder encoder(9);
  auto lossless = [&](const Page& page) { return encoder.encodeTexture(page).size(); };
  for (const bool creased : {false, true}) {
    const Page page = normals(2, creased);
    EXPECT_LT(4 * encoded(page, kOfNormals).size(), lossless(page)) << creased;
  }
  // A crease takes few bytes beside what is smooth, be it the whole page.
  EXPECT_LT(encoded(normals(1, true), kOfNormals).size(), encoded(normals(1, false), kOfNormals).size() + 500);
  // Colours whose channels have nothing to do with one another take more.
  Page mixed = painted();
  std::reverse(mixed.begin() + kChannel, mixed.begin() + 2 * kChannel);
  EXPECT_LT(4 * encoded(painted(), kOfColours).size(), 3 * encoded(mixed, kOfColours).size());
  // Noise takes what it takes.
  EXPECT_LT(encoded(noise(), kExact).size(), kTexturePageBytes * 110 / 100);
}

TEST(TexelCode, EncodersStoreWhatIsSmallest) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  constexpr uint8_t kHierarchical = 12;
  const Page page = normals(2, true);
  auto bytes = encoder.encodeTextureWithin(page, kOfNormals, true);
  ASSERT_EQ(bytes[0], kHierarchical);
  Page shown(kTexturePageBytes), slot(kSlotBytes);
  ASSERT_TRUE(decoder.decodeTexture(bytes, shown).ok());
  EXPECT_TRUE(shown == decoded(bytes.subspan(1)));
  ASSERT_TRUE(decoder.decodeToSlot(Plane::kTexture0, bytes, slot).ok());
  for (size_t i = 0; i < kChannel; i += 97)
    for (size_t c = 0; c < 3; ++c) ASSERT_EQ(slot[4 * i + c], shown[c * kChannel + i]);
  // Older readers know no such pages; what has no order and must be exact, or hardly anything to it, is stored as it
  // was.
  EXPECT_NE(encoder.encodeTextureWithin(page, kOfNormals, false)[0], kHierarchical);
  EXPECT_NE(encoder.encodeTextureWithin(noise(), kExact, true)[0], kHierarchical);
  EXPECT_LT(encoder.encodeTextureWithin(pageOf([](int c, int, int) { return 60 * c; }), kOfNormals, true).size(), 20u);
  // Not a relief page, and not without its code.
  std::vector<uint16_t> samples(kReliefPageSamples);
  bytes = encoder.encodeTextureWithin(page, kOfNormals, true);
  EXPECT_FALSE(decoder.decodeRelief(bytes, samples).ok());
  const auto cut = decoder.decodeTexture(bytes.first(bytes.size() - 1), shown);
  ASSERT_FALSE(cut.ok());
  EXPECT_NE(cut.error().text().find("hierarchical texels has too few bytes or too many"), std::string::npos);
}

TEST(TexelCode, DamagedBytesAreRefusedOrDecodeToSomething) {
  const std::vector<uint8_t> good = encoded(normals(4, true), kOfNormals);
  const auto scratch = std::make_unique<TexelCodeScratch>();
  Page out(kTexturePageBytes);
  for (size_t length = 0; length < good.size(); length += length < 32 ? 1 : 41)
    EXPECT_FALSE(decodeTexelCode({good.data(), length}, *scratch, out)) << length;
  std::vector<uint8_t> longer = good;
  longer.push_back(0);
  EXPECT_FALSE(decodeTexelCode(longer, *scratch, out));
  std::mt19937 random(kSeed);
  size_t refused = 0, tried = 0;
  for (size_t i = 0; i < good.size(); i += 1 + good.size() / 100, ++tried) {
    std::vector<uint8_t> bad = good;
    bad[i] ^= static_cast<uint8_t>(1u << random() % 8);
    refused += !decodeTexelCode(bad, *scratch, out);
  }
  EXPECT_GT(refused, tried / 2) << "most leave too few bytes or too many";
  for (int i = 0; i < 20; ++i) {
    std::vector<uint8_t> junk(400 + static_cast<size_t>(i) * 700);
    for (uint8_t& b : junk) b = static_cast<uint8_t>(i % 3 == 0 ? 255 : random());
    EXPECT_FALSE(decodeTexelCode(junk, *scratch, out)) << "hardly any junk ends where its last bit does";
  }
}

// ---- a reader by what PACKAGE.md says, in its words ----

class Reader {
 public:
  explicit Reader(std::span<const uint8_t> bytes) : coder_(bytes) {
    value_.assign(3, std::vector<int>(kChannel));
    size_.assign(3, std::vector<int>(kChannel));
  }
  Page read() {
    reach_ = static_cast<int>(coder_.plain(5));
    alike_ = coder_.plain(1) == 1;
    for (int y = 0; y < 3; ++y)
      for (int x = 0; x < 3; ++x)
        for (int c = 0; c < 3; ++c) {
          const int p = x > 0 ? v(c, 64 * x - 64, 64 * y) : y > 0 ? v(c, 0, 64 * y - 64) : 128;
          v(c, 64 * x, 64 * y) = std::clamp(p + e(c, 2, 0, 40) * step(0), 0, 255);
        }
    for (int l = 0; l < 6; ++l) level(l);
    Page out;
    for (int c = 0; c < 3; ++c)
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x) out.push_back(static_cast<uint8_t>(v(c, x, y)));
    return out;
  }
  bool ended() const { return coder_.ended(); }

 private:
  int step(int l) const {
    static const int w[] = {2, 2, 3, 5, 10, 16};
    return 2 * ((reach_ * w[l] + 8) >> 4) + 1;
  }
  // By texels of the page.
  int& v(int c, int x, int y) { return value_[static_cast<size_t>(c)][static_cast<size_t>(y * kSide + x)]; }
  int s(int c, int x, int y) {
    if (x < 0 || y < 0 || x >= kSide || y >= kSide) return 0;
    return size_[static_cast<size_t>(c)][static_cast<size_t>(y * kSide + x)];
  }
  Model& model(char name, int a, int b, int c = 0) {
    auto [it, made] = models_.try_emplace({name, a, b, c});
    static const int zero[] = {252, 247, 237, 226, 211, 193, 171, 147, 126, 104, 86, 66, 52, 40, 28, 18},
                     alone[] = {191, 60, 70, 95, 126, 157, 213},
                     larger[] = {235, 238, 240, 232, 225, 215, 205, 188, 170, 146, 122,
                                 100, 78,  62,  48,  40,  33,  26,  20,  16,  12};
    if (made && name == 'z') it->second = {256 * zero[b], 6};
    if (made && name == 'l') it->second = {256 * (b == 0 ? alone[c - 1] : larger[std::clamp(b - 2 * c + 3, 0, 20)]), 6};
    return it->second;
  }
  int e(int c, int of_level, int middle, int sum) {
    const int kind = (of_level * 3 + c) * 2 + middle, k = std::bit_width(static_cast<unsigned>(sum));
    const int b = std::min(15, sum < 4 ? sum : 2 * k - 2 + (sum >> (k - 2) & 1));
    if (!coder_.bit(model('z', kind, b))) return 0;
    const bool negative = coder_.bit(model('s', kind, 0));
    int bits = 1;
    while (bits < 8 && coder_.bit(model('l', kind, b, bits))) ++bits;
    int size = 1;
    for (int i = 0; i < bits - 1; ++i)
      size = 2 * size +
             static_cast<int>(i < 2 ? static_cast<uint32_t>(coder_.bit(model('m', kind, bits, i))) : coder_.plain(1));
    return negative ? -size : size;
  }
  static int mirrored(int at, int d, int step) {
    const int there = at + d * step;
    return there < 0 || there >= kSide ? at - d * step : there;
  }
  void level(int l) {
    const int d = 1 << (5 - l), side = 135 / d + 1, blocks = (side + 15) / 16;
    std::vector<int> open(static_cast<size_t>(blocks * blocks));
    for (int y = 0; y < blocks; ++y)
      for (int x = 0; x < blocks; ++x) {
        auto at = [&](int i, int j) { return i < 0 || j < 0 ? 0 : open[static_cast<size_t>(j * blocks + i)]; };
        const int parent = l == 0 ? 1 : before_[static_cast<size_t>((y >> 1) * blocks_before_ + (x >> 1))];
        open[static_cast<size_t>(y * blocks + x)] =
            coder_.bit(model('b', l, 4 * parent + 2 * at(x, y - 1) + at(x - 1, y)));
      }
    for (const bool middle : {true, false})
      for (int y = 0; y < side; ++y)
        for (int x = 0; x < side; ++x) {
          const bool is_new = x % 2 == 1 || y % 2 == 1, is_middle = x % 2 == 1 && y % 2 == 1;
          if (is_new && is_middle == middle)
            texel(l, d, d * x, d * y, middle, open[static_cast<size_t>(y / 16 * blocks + x / 16)] != 0);
        }
    before_ = open;
    blocks_before_ = blocks;
  }
  void texel(int l, int d, int x, int y, bool middle, bool open) {
    const int left = mirrored(x, -1, d), right = mirrored(x, 1, d), above = mirrored(y, -1, d),
              below = mirrored(y, 1, d);
    const bool border = left > x || right < x || above > y || below < y;
    const std::array<std::array<int, 2>, 4> around =
        middle ? std::array<std::array<int, 2>, 4>{{{left, above}, {right, below}, {right, above}, {left, below}}}
               : std::array<std::array<int, 2>, 4>{{{left, y}, {right, y}, {x, above}, {x, below}}};
    auto value = [&](int c, size_t i) { return v(c, around[i][0], around[i][1]); };
    int first = 0, second = 0, before = 0;
    for (int c = 0; c < 3; ++c) {
      first += std::abs(value(c, 0) - value(c, 1));
      second += std::abs(value(c, 2) - value(c, 3));
    }
    for (int c = 0; c < 3; ++c) {
      int p = (value(c, 0) + value(c, 1) + value(c, 2) + value(c, 3) + 2) >> 2;
      if (!border && 2 * first + 16 < second) p = (value(c, 0) + value(c, 1) + 1) >> 1;
      else if (!border && 2 * second + 16 < first) p = (value(c, 2) + value(c, 3) + 1) >> 1;
      int residual = 0;
      if (open) {
        const int aside = middle ? 2 : 1;
        int sum = 2 * s(c, x - 2 * d, y) + 2 * s(c, x, y - 2 * d) + s(c, x - aside * d, y - aside * d) +
                  s(c, x + aside * d, y - aside * d);
        for (const auto& [i, j] : around) sum += s(c, i, j);
        if (c > 0) sum += 6 * std::abs(before);
        residual = e(c, l == 5 ? 0 : l == 4 ? 1 : 2, middle, sum);
        if (alike_ && c > 0) p = std::clamp(p + before * step(l), 0, 255);
      }
      v(c, x, y) = std::clamp(p + residual * step(l), 0, 255);
      size_[static_cast<size_t>(c)][static_cast<size_t>(y * kSide + x)] = std::abs(residual);
      before = residual;
    }
  }

  Coder coder_;
  std::map<std::tuple<char, int, int, int>, Model> models_;
  std::vector<std::vector<int>> value_, size_;
  std::vector<int> before_;
  int reach_ = 0, blocks_before_ = 0;
  bool alike_ = false;
};

TEST(TexelCode, IsAsThePackageFormatSays) {
  for (const Contents& c : contents()) {
    const std::vector<uint8_t> bytes = encoded(c.page, c.tolerances);
    Reader reader(bytes);
    EXPECT_TRUE(reader.read() == decoded(bytes)) << c.name;
    EXPECT_TRUE(reader.ended()) << c.name;
  }
}

}  // namespace
}  // namespace relievo::texel_code_test
