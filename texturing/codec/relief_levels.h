// relief_levels.h - what relief_code.h and tail_code.h share: a square grid of heights, level by level. Each level's
// samples are predicted from those of coarser grids, and what they differ by is coded in contexts
// (texturing/PACKAGE.md, "Hierarchical relief"). An encoder and a decoder are the same code over another Coder.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <numeric>
#include <span>
#include <type_traits>

#include "src/artwork/relief_lattice.h"
#include "texturing/codec/range_coder.h"
#include "texturing/codec/relief_code.h"

namespace relievo::relief_levels {

inline constexpr int kMostLevels = kPageCellsLog2;
inline constexpr int kRow = static_cast<int>(ReliefCodeScratch::kRow),
                     kMargin = static_cast<int>(ReliefCodeScratch::kMargin);
inline constexpr int kBlockCells = 8;  // of a level's coarser grid, a side of a block that may be all zero
inline constexpr int kBuckets = 24, kClasses = 18, kMostSize = 2047;

// A grid inside its margin.
constexpr int at(int x, int y) { return (y + kMargin) * kRow + x + kMargin; }

// How a level's samples are predicted.
enum Prediction : uint32_t { kLine = 0, kFour = 1, kTwelve = 2, kCubic = 3, kPredictions = 4 };

// What a page begins to learn from: a page of a scan is some hundred bytes, of which learning from nothing would take a
// quarter. Probabilities of a 0 in 256ths, as scans' pages have them; any page can unlearn them.
inline constexpr uint8_t kFirstSeen = 6;
inline constexpr uint8_t kZeros[kBuckets] = {252, 247, 237, 226, 211, 193, 171, 147, 126, 104, 86, 66,
                                             52,  40,  28,  18,  14,  12,  10,  8,   8,   8,   8,  8};
// Nothing is known around: by class. Else by bucket - 2 class, from -3 or below to 17 or above.
inline constexpr uint8_t kLargerAlone[] = {191, 60, 70, 95, 126, 157, 213};
inline constexpr int kLeastLarger = -3;
inline constexpr uint8_t kLarger[] = {235, 238, 240, 232, 225, 215, 205, 188, 170, 146, 122,
                                      100, 78,  62,  48,  40,  33,  26,  20,  16,  12};
inline constexpr uint8_t kOpenCoarse[8] = {60, 30, 30, 20, 8, 8, 8, 8},
                         kOpenMiddle[8] = {165, 210, 211, 235, 93, 75, 72, 17},
                         kOpenFine[8] = {246, 225, 250, 230, 187, 72, 72, 14};
inline constexpr uint8_t kSigns[3] = {62, 128, 194}, kMantissas[2] = {180, 155};

constexpr void begin(BitModel& m, uint8_t zero_256ths) {
  m.zero = static_cast<uint16_t>(zero_256ths << 8);
  m.seen = kFirstSeen;
}

struct Models {
  BitModel block[kMostLevels][8];
  BitModel zero[3][2][kBuckets];
  BitModel larger[kBuckets][kClasses];
  BitModel sign[3];
  BitModel mantissa[kClasses][2];

  constexpr Models() {
    for (int l = 0; l < kMostLevels; ++l)
      for (int k = 0; k < 8; ++k) begin(block[l][k], (l < 4 ? kOpenCoarse : l == 4 ? kOpenMiddle : kOpenFine)[k]);
    for (auto& of_level : zero)
      for (auto& of_kind : of_level)
        for (int b = 0; b < kBuckets; ++b) begin(of_kind[b], kZeros[b]);
    for (int c = 1; c < kClasses; ++c) {
      begin(larger[0][c], kLargerAlone[std::min(c, 7) - 1]);
      for (int b = 1; b < kBuckets; ++b) {
        const int beyond = std::clamp(b - 2 * c - kLeastLarger, 0, static_cast<int>(std::size(kLarger)) - 1);
        begin(larger[b][c], kLarger[beyond]);
      }
      for (int k = 0; k < 2; ++k) begin(mantissa[c][k], kMantissas[k]);
    }
    for (int k = 0; k < 3; ++k) begin(sign[k], kSigns[k]);
  }
};
inline constexpr Models kFirstModels;

// Of the sum of sizes around.
inline int bucketOf(uint32_t around) {
  if (around < 4) return static_cast<int>(around);
  const int width = static_cast<int>(std::bit_width(around));  // 3 and up
  return std::min(kBuckets - 1, 2 * width - 2 + static_cast<int>(around >> (width - 2) & 1));
}

// A level's prediction for a sample beside what the lattice says. n: the finer grid's cells a side.
template <Prediction kHow>
int predicted(const int32_t* h, int x, int y, int n, int line) {
  if constexpr (kHow == kLine) return line;
  const int32_t* p = h + at(x, y);
  if (x & y & 1) {
    const int four = p[-kRow - 1] + p[-kRow + 1] + p[kRow - 1] + p[kRow + 1];
    if (kHow == kFour || x < 3 || y < 3 || x > n - 3 || y > n - 3) return (four + 2) >> 2;
    const int eight = p[-kRow - 3] + p[-kRow + 3] + p[kRow - 3] + p[kRow + 3] + p[-3 * kRow - 1] + p[-3 * kRow + 1] +
                      p[3 * kRow - 1] + p[3 * kRow + 1];
    return (10 * four - eight + 16) >> 5;
  }
  const bool along_x = x & 1;
  const int along = along_x ? 1 : kRow, across = along_x ? kRow : 1;
  const int u = along_x ? x : y, v = along_x ? y : x;
  if (kHow == kCubic || v == 0 || v == n) {
    if (u < 3 || u > n - 3) return line;
    return (9 * (p[-along] + p[along]) - p[-3 * along] - p[3 * along] + 8) >> 4;
  }
  const int four = p[-along] + p[along] + p[-across] + p[across];
  if (kHow == kFour || u < 2 || u > n - 2 || v < 2 || v > n - 2) return (four + 2) >> 2;
  const int eight = p[-2 * across - along] + p[-2 * across + along] + p[2 * across - along] + p[2 * across + along] +
                    p[-2 * along - across] + p[-2 * along + across] + p[2 * along - across] + p[2 * along + across];
  return (10 * four - eight + 16) >> 5;
}

inline int lineOf(const int32_t* h, int x, int y) {
  const int32_t* p = h + at(x, y);
  if (x & y & 1) return midHeight(p[-kRow - 1], p[kRow + 1]);
  return x & 1 ? midHeight(p[-1], p[1]) : midHeight(p[-kRow], p[kRow]);
}

// A level's step is so many times the page's.
inline constexpr uint32_t kTimes[8] = {1, 2, 3, 4, 6, 8, 12, 16};

struct Head {
  uint32_t step = 1;
  std::array<uint32_t, kMostLevels> times{};  // of each level: which of kTimes
  int stepOf(int level) const { return static_cast<int>(step * kTimes[times[static_cast<size_t>(level)]]); }
  int levels = 0;  // the finest ones are as the lattice says
  bool stepped_corners = false;
  std::array<uint32_t, kMostLevels> how{};
};

// What both ways have in common. Coder: codes bits either way; what is given to it counts in one of them only. The
// models go on learning from one grid to the next that they are given to.
template <class Coder>
class Pass {
 public:
  Pass(Coder& coder, Models& models, ReliefCodeScratch& s)
      : coder_(coder), h_(s.heights.data()), e_(s.sizes.data()), m_(models) {}

  void residual(int context_level, bool middle, uint32_t around, int fraction, int& e) {
    const int bucket = bucketOf(around);
    if (!coder_.bit(m_.zero[context_level][middle][bucket], e != 0)) {
      e = 0;
      return;
    }
    const bool negative = coder_.bit(m_.sign[fraction < -1 ? 0 : fraction > 1 ? 2 : 1], e < 0);
    const auto size = static_cast<uint32_t>(std::abs(e));
    // 1, 2..3, 4..7, ...
    const int known = static_cast<int>(std::bit_width(size));
    int width = 1;
    while (width < kClasses - 1 && coder_.bit(m_.larger[bucket][width], known > width)) ++width;
    uint32_t value = 1;
    int left = width - 1;
    for (int k = 0; k < 2 && left > 0; ++k) {
      --left;
      const size_t slot = k == 0 ? 0 : 1;
      value = value << 1 | static_cast<uint32_t>(coder_.bit(m_.mantissa[width][slot], size >> left & 1));
    }
    if (left > 0) value = value << left | coder_.plain(size & ((1u << left) - 1), left);
    e = negative ? -static_cast<int>(value) : static_cast<int>(value);
  }

  uint32_t aroundMiddle(int i) const {
    return 2u * (e_[i - 2] + e_[i - 2 * kRow]) + e_[i - 2 * kRow - 2] + e_[i - 2 * kRow + 2] + e_[i - kRow - 1] +
           e_[i - kRow + 1] + e_[i + kRow - 1] + e_[i + kRow + 1];
  }
  uint32_t aroundEdge(int i, bool along_x) const {
    const int along = along_x ? 1 : kRow, across = along_x ? kRow : 1;
    return 2u * (e_[i - across] + e_[i + across] + e_[i - 2]) + e_[i - kRow - 1] + e_[i - kRow + 1] + e_[i - along] +
           e_[i + along];
  }

  Coder& coder_;
  int32_t* h_;
  uint16_t* e_;
  Models& m_;
};

// From the coarser grid, in place: n cells a side become 2 n; e alike. New samples are 0.
inline void spread(ReliefCodeScratch& s, int n) {
  for (int y = n; y >= 0; --y) {
    for (int x = n; x >= 0; --x) {
      s.heights[static_cast<size_t>(at(2 * x, 2 * y))] = s.heights[static_cast<size_t>(at(x, y))];
      s.sizes[static_cast<size_t>(at(2 * x, 2 * y))] = s.sizes[static_cast<size_t>(at(x, y))];
    }
  }
  for (int y = 0; y <= 2 * n; ++y)
    for (int x = y & 1 ? 0 : 1; x <= 2 * n; x += y & 1 ? 1 : 2) s.sizes[static_cast<size_t>(at(x, y))] = 0;
}

// In whole steps, halves away from the lattice's rule towards what is smaller.
struct Steps {
  int whole, fraction;  // in eighths of a step, -4..3
};
inline Steps stepsOf(int beside, int step) {
  if (step == 1) return {beside, 0};
  const int eighths = (beside * 8) / step;
  const int whole = (eighths + 4) >> 3;
  return {whole, eighths - 8 * whole};
}

// Modulo 2^16: what damaged bytes say may be far beyond.
inline int stepsFrom(int from, int steps, int step) {
  return static_cast<int>((static_cast<uint32_t>(from) + static_cast<uint32_t>(steps) * static_cast<uint32_t>(step)) &
                          0xFFFF);
}

struct EncodingCoder {
  RangeEncoder rc;
  bool bit(BitModel& m, bool b) { return rc.bit(m, b), b; }
  uint32_t plain(uint32_t v, int count) { return rc.plain(v, count), v; }
};
struct DecodingCoder {
  RangeDecoder rc;
  bool bit(BitModel& m, bool) { return rc.bit(m); }
  uint32_t plain(uint32_t, int count) { return rc.plain(count); }
};

// A number of kBits bits, the highest first, each by a model of its own for what the bits before it were.
template <int kBits, class Coder>
uint32_t codeSymbol(Coder& coder, std::array<BitModel, 1 << kBits>& models, uint32_t symbol) {
  uint32_t node = 1;
  for (int i = kBits - 1; i >= 0; --i) node = node << 1 | coder.bit(models[node], symbol >> i & 1);
  return node - (1u << kBits);
}

inline constexpr int32_t kNotGiven = -1;

constexpr int blocksASide(int n) { return std::max(1, n / (2 * kBlockCells)); }

// A grid of 2^kLevels cells a side, but for its head, which the caller codes before it.
// kGiven: some samples are known already, of any grid, its corners among them.
template <int kLevels, class Coder, bool kGiven = false>
class GridCode : Pass<Coder> {
  using P = Pass<Coder>;
  static constexpr int kCells = 1 << kLevels, kSide = kCells + 1;
  static_assert(kLevels <= kMostLevels);
  static constexpr bool kEncodes = std::is_same_v<Coder, EncodingCoder>;

 public:
  // An encoder reads them, a decoder writes them.
  using Samples = std::span<std::conditional_t<kEncodes, const uint16_t, uint16_t>>;
  GridCode(Coder& coder, Models& models, ReliefCodeScratch& s) : P(coder, models, s), s_(s) {}

  // known: how many levels the samples have already, which are not coded. given: samples, kNotGiven where they are not.
  void run(const Head& head, Samples samples, int known = 0, std::span<const int32_t> given = {}) {
    std::fill_n(s_.sizes.begin(), (kSide + 2 * kMargin) * kRow, uint16_t{0});
    parent_side_ = 0;
    given_ = given;
    if (kGiven)
      for (int k = 0; k < 4; ++k) this->h_[at(k & 1, k >> 1)] = givenAt(k & 1, k >> 1, 1);
    else if (known == 0) corners(head, samples);
    else load(1 << known, samples);
    for (int level = known; level < kLevels; ++level) {
      const int n = 2 << level;
      spread(s_, n / 2);
      if (level >= head.levels) {
        fill(n);
        continue;
      }
      if constexpr (kEncodes) load(n, samples);
      switch (head.how[static_cast<size_t>(level)]) {
        case kLine:
          codeLevel<kLine>(level, n, head.stepOf(level));
          break;
        case kFour:
          codeLevel<kFour>(level, n, head.stepOf(level));
          break;
        case kTwelve:
          codeLevel<kTwelve>(level, n, head.stepOf(level));
          break;
        default:
          codeLevel<kCubic>(level, n, head.stepOf(level));
          break;
      }
    }
    if constexpr (!kEncodes)
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x)
          samples[static_cast<size_t>(y * kSide + x)] = static_cast<uint16_t>(this->h_[at(x, y)]);
  }

 private:
  void corners(const Head& head, std::span<const uint16_t> samples) {
    const int step = head.stepped_corners ? head.stepOf(0) : 1;
    int first = 0;
    for (int k = 0; k < 4; ++k) {
      int32_t& h = this->h_[at(k & 1, k >> 1)];
      if constexpr (kEncodes) h = samples[static_cast<size_t>((k >> 1) * kCells * kSide + (k & 1) * kCells)];
      if (k == 0) {
        first = h = static_cast<int32_t>(this->coder_.plain(static_cast<uint32_t>(h), 16));
        continue;
      }
      int e = kEncodes ? (h - first) / step : 0;
      const uint32_t folded = static_cast<uint32_t>(e < 0 ? -2 * e - 1 : 2 * e);  // at most 17 bits
      const auto width = static_cast<int>(this->coder_.plain(static_cast<uint32_t>(std::bit_width(folded)), 5));
      const uint32_t top = width > 0 ? 1u << (std::min(width, 17) - 1) : 0;
      const uint32_t value = width > 1 ? top | this->coder_.plain(folded & (top - 1), std::min(width, 17) - 1) : top;
      e = value & 1 ? -static_cast<int>(value >> 1) - 1 : static_cast<int>(value >> 1);
      h = stepsFrom(first, e, step);
    }
  }

  int32_t givenAt(int x, int y, int n) const { return given_[static_cast<size_t>((y * kSide + x) * (kCells / n))]; }
  bool isGiven(int x, int y, int n) const { return kGiven && givenAt(x, y, n) != kNotGiven; }
  void fill(int n) {
    for (int y = 0; y <= n; ++y)
      for (int x = y & 1 ? 0 : 1; x <= n; x += y & 1 ? 1 : 2)
        this->h_[at(x, y)] = isGiven(x, y, n) ? givenAt(x, y, n) : lineOf(this->h_, x, y);
  }
  void load(int n, std::span<const uint16_t> samples) {
    const int step = kCells / n;
    for (int y = 0; y <= n; ++y)
      for (int x = 0; x <= n; ++x) this->h_[at(x, y)] = samples[static_cast<size_t>(y * step * kSide + x * step)];
  }

  template <Prediction kHow>
  bool one(int x, int y, int n, int step, int context_level, bool middle, bool open) {
    const int i = at(x, y), line = lineOf(this->h_, x, y);
    const Steps hint = stepsOf(predicted<kHow>(this->h_, x, y, n, line) - line, step);
    int e = 0;
    const bool given = isGiven(x, y, n);
    if (given) this->h_[i] = givenAt(x, y, n);
    if (kEncodes || given) e = (this->h_[i] - line) / step - hint.whole;
    if (open && !given) {
      const uint32_t around = middle ? P::aroundMiddle(i) : P::aroundEdge(i, x & 1);
      P::residual(context_level, middle, around, hint.fraction, e);
    }
    this->e_[i] = static_cast<uint16_t>(std::min(std::abs(e), kMostSize));
    if (!kEncodes && !given) this->h_[i] = stepsFrom(line, hint.whole + e, step);
    return e != 0;
  }

  template <Prediction kHow>
  void codeLevel(int level, int n, int step) {
    const int context_level = std::min(kLevels - 1 - level, 2);
    const int side = blocksASide(n), samples_a_block = n / side;
    std::array<uint8_t, 64> open{};
    if constexpr (kEncodes) {
      for (int y = 0; y <= n; ++y) {
        for (int x = y & 1 ? 0 : 1; x <= n; x += y & 1 ? 1 : 2) {
          if (isGiven(x, y, n)) continue;
          const int line = lineOf(this->h_, x, y);
          const Steps hint = stepsOf(predicted<kHow>(this->h_, x, y, n, line) - line, step);
          if ((this->h_[at(x, y)] - line) / step != hint.whole)
            open[static_cast<size_t>(blockOf(x, y, side, samples_a_block))] = 1;
        }
      }
    }
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        const int left = x > 0 ? open[static_cast<size_t>(y * side + x - 1)] : 0,
                  above = y > 0 ? open[static_cast<size_t>((y - 1) * side + x)] : 0;
        const int coarser =
            parent_side_ == 0
                ? 1
                : parent_[static_cast<size_t>(y * parent_side_ / side * parent_side_ + x * parent_side_ / side)];
        uint8_t& b = open[static_cast<size_t>(y * side + x)];
        b = this->coder_.bit(this->m_.block[level][4 * coarser + 2 * above + left], b);
      }
    }
    for (int y = 1; y < n; y += 2)
      for (int x = 1; x < n; x += 2)
        one<kHow>(x, y, n, step, context_level, true, open[static_cast<size_t>(blockOf(x, y, side, samples_a_block))]);
    for (int y = 0; y <= n; ++y)
      for (int x = y & 1 ? 0 : 1; x <= n; x += 2)
        one<kHow>(x, y, n, step, context_level, false, open[static_cast<size_t>(blockOf(x, y, side, samples_a_block))]);
    parent_ = open;
    parent_side_ = side;
  }
  static int blockOf(int x, int y, int side, int samples) {
    return std::min(y / samples, side - 1) * side + std::min(x / samples, side - 1);
  }

  ReliefCodeScratch& s_;
  std::span<const int32_t> given_;
  std::array<uint8_t, 64> parent_{};
  int parent_side_ = 0;
};

// The samples' residuals by the lattice's rule: what they have in common, and the finest level that has any.
// Those of given samples (GridCode) do not count, and stepped_corners is not set where some are.
template <int kLevels>
Head headOf(std::span<const uint16_t> samples, ReliefCodeScratch& s, std::span<const int32_t> given = {}) {
  constexpr int kCells = 1 << kLevels, kSide = kCells + 1;
  Head head;
  auto sample = [&](int x, int y) { return static_cast<int>(samples[static_cast<size_t>(y * kSide + x)]); };
  auto isGiven = [&](int x, int y) { return !given.empty() && given[static_cast<size_t>(y * kSide + x)] != kNotGiven; };
  std::array<int, kLevels> common{};
  for (int level = 0; level < kLevels; ++level) {
    const int n = 2 << level, h = kCells / n;
    int& of_level = common[static_cast<size_t>(level)];
    for (int y = 0; y <= n; ++y) {
      for (int x = y & 1 ? 0 : 1; x <= n; x += y & 1 ? 1 : 2) {
        if (isGiven(x * h, y * h)) continue;
        const int dx = x & 1 ? h : 0, dy = y & 1 ? h : 0;
        const int line = midHeight(sample(x * h - dx, y * h - dy), sample(x * h + dx, y * h + dy));
        if (const int r = sample(x * h, y * h) - line; of_level != 1 && r != 0) of_level = std::gcd(of_level, r);
      }
    }
    if (of_level != 0) head.levels = level + 1;
  }
  const int all = std::accumulate(common.begin(), common.end(), 0, [](int a, int b) { return std::gcd(a, b); });
  head.step = all == 0 ? 1 : static_cast<uint32_t>(all);
  for (size_t level = 0; level < static_cast<size_t>(head.levels); ++level)
    for (uint32_t k = 0; k < std::size(kTimes); ++k)
      if (common[level] % static_cast<int>(head.step * kTimes[k]) == 0) head.times[level] = k;
  const int c0 = sample(0, 0), step = head.stepOf(0);
  head.stepped_corners = given.empty() && (sample(kCells, 0) - c0) % step == 0 &&
                         (sample(0, kCells) - c0) % step == 0 && (sample(kCells, kCells) - c0) % step == 0;
  // The prediction that leaves least, level by level.
  for (int level = 0; level < head.levels; ++level) {
    const int n = 2 << level, h = kCells / n;
    const int own = head.stepOf(level);
    int32_t* grid = s.heights.data();
    for (int y = 0; y <= n; ++y)
      for (int x = 0; x <= n; ++x) grid[at(x, y)] = sample(x * h, y * h);
    uint64_t cost[kPredictions] = {};
    for (int y = 0; y <= n; ++y) {
      for (int x = y & 1 ? 0 : 1; x <= n; x += y & 1 ? 1 : 2) {
        if (isGiven(x * h, y * h)) continue;
        const int line = lineOf(grid, x, y), k = (grid[at(x, y)] - line) / own;
        auto add = [&](Prediction how, int value) {
          cost[how] += static_cast<uint64_t>(std::abs(k - stepsOf(value - line, own).whole));
        };
        add(kLine, line);
        add(kFour, predicted<kFour>(grid, x, y, n, line));
        add(kTwelve, predicted<kTwelve>(grid, x, y, n, line));
        add(kCubic, predicted<kCubic>(grid, x, y, n, line));
      }
    }
    head.how[static_cast<size_t>(level)] = static_cast<uint32_t>(std::min_element(cost, cost + kPredictions) - cost);
  }
  return head;
}

}  // namespace relievo::relief_levels
