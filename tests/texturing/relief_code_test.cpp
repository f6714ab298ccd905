// Hierarchical relief pages, by themselves and over their tails, read by what PACKAGE.md says, in its words and with
// nothing of the codec's.
#include "texturing/codec/relief_code.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <tuple>
#include <vector>

#include "tests/texturing/format_coder.h"

namespace relievo {
namespace relief_code_test {

using format_coder::Coder;
using format_coder::Model;

constexpr int kSide = 129;
using Samples = std::vector<int>;  // rows top first

class Reader {
 public:
  // tail: the samples that are known, of which every 8th counts; or empty.
  Reader(std::span<const uint8_t> bytes, const Samples& tail) : coder_(bytes), over_tail_(!tail.empty()) {
    if (over_tail_) value_ = tail;
  }
  Samples read() {
    step_ = static_cast<int>(coder_.plain(16));
    levels_ = static_cast<int>(coder_.plain(3));
    const bool coarse_corners = !over_tail_ && coder_.plain(1) == 1;
    const int first = over_tail_ ? 4 : 0;
    for (int l = first; l < levels_; ++l) prediction_[static_cast<size_t>(l)] = static_cast<int>(coder_.plain(2));
    for (int l = first; l < levels_; ++l) {
      static const int times[] = {1, 2, 3, 4, 6, 8, 12, 16};
      of_level_[static_cast<size_t>(l)] = step_ * times[coder_.plain(3)];
    }
    if (!over_tail_) corners(coarse_corners ? levels_ > 0 ? of_level_[0] : step_ : 1);
    for (int l = first; l < 7; ++l) level(l);
    return value_;
  }
  bool ended() const { return coder_.ended(); }

 private:
  void corners(int step) {
    int& first = value_[0];
    first = static_cast<int>(coder_.plain(16));
    for (const auto& [x, y] : {std::pair(128, 0), std::pair(0, 128), std::pair(128, 128)}) {
      const auto width = static_cast<int>(coder_.plain(5));
      int folded = width > 0 ? 1 : 0;
      for (int k = 1; k < width; ++k) folded = 2 * folded + static_cast<int>(coder_.plain(1));
      const int e = folded % 2 == 0 ? folded / 2 : -(folded + 1) / 2;
      value_[static_cast<size_t>(kSide * y + x)] = (first + e * step) & 0xFFFF;
    }
  }
  // By the grid of n cells a side.
  int& v(int n, int x, int y) { return value_[static_cast<size_t>((kSide * y + x) * (128 / n))]; }
  int s(int n, int x, int y) const {
    if (x < 0 || y < 0 || x > n || y > n) return 0;
    return size_[static_cast<size_t>((kSide * y + x) * (128 / n))];
  }
  Model& model(char name, int a, int b = 0, int c = 0) {
    auto [it, made] = models_.try_emplace({name, a, b, c});
    if (!made) return it->second;
    static const int block[3][8] = {{60, 30, 30, 20, 8, 8, 8, 8},
                                    {165, 210, 211, 235, 93, 75, 72, 17},
                                    {246, 225, 250, 230, 187, 72, 72, 14}},
                     zero[] = {252, 247, 237, 226, 211, 193, 171, 147, 126, 104, 86, 66,
                               52,  40,  28,  18,  14,  12,  10,  8,   8,   8,   8,  8},
                     alone[] = {191, 60, 70, 95, 126, 157, 213},
                     larger[] = {235, 238, 240, 232, 225, 215, 205, 188, 170, 146, 122,
                                 100, 78,  62,  48,  40,  33,  26,  20,  16,  12},
                     sign[] = {62, 128, 194}, lower[] = {180, 155};
    const int begins = name == 'b'   ? block[a < 4    ? 0
                                             : a == 4 ? 1
                                                      : 2][b]
                       : name == 'z' ? zero[c]
                       : name == 'l' ? (a == 0 ? alone[std::min(b, 7) - 1] : larger[std::clamp(a - 2 * b + 3, 0, 20)])
                       : name == 's' ? sign[a]
                                     : lower[b];
    it->second = {256 * begins, 6};
    return it->second;
  }
  int residual(int l, bool middle, int sum, int f) {
    const int k = std::bit_width(static_cast<unsigned>(sum));
    const int b = sum < 4 ? sum : std::min(23, 2 * k - 2 + (sum >> (k - 2) & 1));
    if (!coder_.bit(model('z', l == 6 ? 0 : l == 5 ? 1 : 2, middle, b))) return 0;
    const bool negative = coder_.bit(model('s', f < -1 ? 0 : f > 1 ? 2 : 1));
    int c = 1;
    while (c <= 16 && coder_.bit(model('l', b, c))) ++c;
    int size = 1;
    for (int i = 0; i < c - 1; ++i)
      size = 2 * size + (i < 2 ? coder_.bit(model('m', c, i)) : static_cast<int>(coder_.plain(1)));
    return negative ? -size : size;
  }
  // What a level's prediction makes of the samples around; line: the first of them.
  int predicted(int how, int n, int x, int y, int line) {
    const bool middle = x % 2 == 1 && y % 2 == 1, along_x = x % 2 == 1;
    if (how == 0) return line;
    const int along = along_x ? x : y, across = along_x ? y : x;
    const bool border = !middle && (across == 0 || across == n);
    if (border || (how == 3 && !middle)) {
      if (along < 3 || along > n - 3) return line;
      auto on = [&](int d) { return along_x ? v(n, x + d, y) : v(n, x, y + d); };
      return (9 * (on(-1) + on(1)) - on(-3) - on(3) + 8) >> 4;
    }
    using Places = std::vector<std::pair<int, int>>;
    auto sum = [&](const Places& places) {
      int of = 0;
      for (const auto& [dx, dy] : places) of += v(n, x + dx, y + dy);
      return of;
    };
    auto onGrid = [&](const Places& places) {
      return std::all_of(places.begin(), places.end(), [&](const auto& p) {
        return x + p.first >= 0 && x + p.first <= n && y + p.second >= 0 && y + p.second <= n;
      });
    };
    Places four, eight;
    for (int i : {-1, 1})
      for (int j : {-1, 1}) {
        if (middle) four.emplace_back(i, j);
        if (middle) eight.insert(eight.end(), {{3 * i, j}, {i, 3 * j}});
        else eight.insert(eight.end(), {{2 * i, j}, {i, 2 * j}});
      }
    if (!middle) four = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}};
    if (how == 1 || !onGrid(eight)) return (sum(four) + 2) >> 2;
    return (10 * sum(four) - sum(eight) + 16) >> 5;
  }
  void level(int l) {
    const int n = 2 << l, blocks = std::max(1, n / 16), cells = std::min(n, 16);
    const bool coded = l < levels_;
    std::vector<int> open(static_cast<size_t>(blocks * blocks));
    for (int y = 0; coded && y < blocks; ++y)
      for (int x = 0; x < blocks; ++x) {
        auto at = [&](int i, int j) { return i < 0 || j < 0 ? 0 : open[static_cast<size_t>(j * blocks + i)]; };
        const int ratio = blocks_before_ > 0 ? blocks / blocks_before_ : 0;
        const int parent = ratio == 0 ? 1 : before_[static_cast<size_t>(y / ratio * blocks_before_ + x / ratio)];
        open[static_cast<size_t>(y * blocks + x)] =
            coder_.bit(model('b', l, 4 * parent + 2 * at(x, y - 1) + at(x - 1, y)));
      }
    for (const bool middle : {true, false})
      for (int y = 0; y <= n; ++y)
        for (int x = 0; x <= n; ++x) {
          const bool is_new = x % 2 == 1 || y % 2 == 1, is_middle = x % 2 == 1 && y % 2 == 1;
          if (!is_new || is_middle != middle) continue;
          const int line = is_middle    ? (v(n, x - 1, y - 1) + v(n, x + 1, y + 1) + 1) >> 1
                           : x % 2 == 1 ? (v(n, x - 1, y) + v(n, x + 1, y) + 1) >> 1
                                        : (v(n, x, y - 1) + v(n, x, y + 1) + 1) >> 1;
          if (!coded) {
            v(n, x, y) = line;
            continue;
          }
          const int d = of_level_[static_cast<size_t>(l)],
                    p = predicted(prediction_[static_cast<size_t>(l)], n, x, y, line);
          int w = p - line, f = 0;
          if (d != 1) {
            const int t = 8 * (p - line) / d;
            w = (t + 4) >> 3, f = t - 8 * w;
          }
          int e = 0;
          const int block = std::min(y / cells, blocks - 1) * blocks + std::min(x / cells, blocks - 1);
          if (open[static_cast<size_t>(block)]) {
            auto size = [&](int dx, int dy) { return s(n, x + dx, y + dy); };
            int sum = 0;
            if (middle)
              sum = 2 * (size(-2, 0) + size(0, -2)) + size(-2, -2) + size(2, -2) + size(-1, -1) + size(1, -1) +
                    size(-1, 1) + size(1, 1);
            else if (x % 2 == 1)
              sum =
                  2 * (size(-2, 0) + size(0, -1) + size(0, 1)) + size(-1, -1) + size(1, -1) + size(-1, 0) + size(1, 0);
            else
              sum =
                  2 * (size(-2, 0) + size(-1, 0) + size(1, 0)) + size(-1, -1) + size(1, -1) + size(0, -1) + size(0, 1);
            e = residual(l, middle, sum, f);
          }
          size_[static_cast<size_t>((kSide * y + x) * (128 / n))] = std::min(std::abs(e), 2047);
          v(n, x, y) = (line + (w + e) * d) & 0xFFFF;
        }
    if (coded) before_ = open, blocks_before_ = blocks;
  }

  Coder coder_;
  bool over_tail_;
  int step_ = 0, levels_ = 0, blocks_before_ = 0;
  std::array<int, 7> prediction_{}, of_level_{};
  std::map<std::tuple<char, int, int, int>, Model> models_;
  Samples value_ = Samples(kSide * kSide), size_ = Samples(kSide * kSide), before_;
};

struct Case {
  const char* name;
  Samples samples;
};
std::vector<Case> cases() {
  std::mt19937 random(7);
  auto page = [](const char* name, auto height) {
    Case c{name, {}};
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) c.samples.push_back(static_cast<int>(height(x, y)) & 0xFFFF);
    return c;
  };
  auto waves = [](int x, int y) {
    return static_cast<int>(30000 + 9000 * std::sin(0.11 * x + 0.3) * std::cos(0.07 * y) + 4000 * std::sin(0.4 * y));
  };
  return {page("flat", [](int, int) { return 777; }),
          page("all of the range, along x", [](int x, int) { return 511 * x; }),
          page("waves", waves),
          page("waves in steps of 24", [&](int x, int y) { return waves(x, y) / 24 * 24; }),
          page("steps of 5 on a coarse grid, of 15 on finer ones",
               [&](int x, int y) { return x % 4 == 0 && y % 4 == 0 ? waves(x, y) / 5 * 5 : 15 * (waves(x, y) / 15); }),
          page("waves and a wall", [&](int x, int y) { return waves(x, y) + (x * 2 + y > 170 ? 18000 : 0); }),
          page("waves in one corner", [&](int x, int y) { return x < 40 && y < 30 ? waves(x, y) : 30000; }),
          page("noise of 3 bits", [&](int, int) { return 30000 + random() % 8; }),
          page("noise of 16 bits", [&](int, int) { return random(); })};
}

std::vector<uint8_t> encoded(const Samples& samples, bool over_tail) {
  const auto scratch = std::make_unique<ReliefCodeScratch>();
  const std::vector<uint16_t> of(samples.begin(), samples.end());
  std::vector<uint8_t> out;
  if (over_tail) encodeReliefCodeOverTail(of, *scratch, out);
  else encodeReliefCode(of, *scratch, out);
  return out;
}
Samples tailOf(const Samples& samples) {
  Samples tail(samples.size(), 0x5555);  // of what is no tail's nothing may be read
  for (size_t y = 0; y < kSide; y += 8)
    for (size_t x = 0; x < kSide; x += 8) tail[kSide * y + x] = samples[kSide * y + x];
  return tail;
}

TEST(ReliefCode, IsReadByWhatTheFormatSays) {
  for (const Case& c : cases()) {
    const auto bytes = encoded(c.samples, false);
    Reader reader(bytes, {});
    EXPECT_TRUE(reader.read() == c.samples) << c.name;
    EXPECT_TRUE(reader.ended()) << c.name << ": " << bytes.size() << " bytes";
  }
}

TEST(ReliefCode, OverATailIsReadByWhatTheFormatSays) {
  for (const Case& c : cases()) {
    const auto bytes = encoded(c.samples, true);
    EXPECT_LT(bytes.size(), encoded(c.samples, false).size()) << c.name << ": what a tail has is in the page once more";
    Reader reader(bytes, tailOf(c.samples));
    EXPECT_TRUE(reader.read() == c.samples) << c.name;
    EXPECT_TRUE(reader.ended()) << c.name << ": " << bytes.size() << " bytes";
    // Control: over another tail it is another page.
    Samples other = tailOf(c.samples);
    other[kSide * 64 + 64] ^= 0x40;
    EXPECT_FALSE(Reader(bytes, other).read() == c.samples) << c.name;
  }
}

}  // namespace relief_code_test
}  // namespace relievo
