#include "texturing/codec/texel_code.h"

#include <algorithm>
#include <cassert>
#include <cstdlib>
#include <type_traits>

#include "src/base/simd_dispatch.h"
#include "texturing/codec/relief_levels.h"
#include "texturing/codec/residual_code.h"

namespace relievo {
namespace texel_code {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;

// Level l = 0..5 makes a grid of every 2^(5 - l)th texel of one of every 2^(6 - l)th; it is kept without gaps.
constexpr int kLevels = 6, kFirstApart = 1 << kLevels;
constexpr int kFull = kPageFullPx;
constexpr int sideOf(int apart) { return (kFull + apart - 1) / apart; }
constexpr int apartOf(int level) { return 1 << (kLevels - 1 - level); }
constexpr int kRow = static_cast<int>(TexelCodeScratch::kRow);
constexpr size_t kChannel = TexelCodeScratch::kChannel;
constexpr int kBlock = 16;  // a side of a block that may be all zero, in texels of the level's grid
constexpr int kMostInRow = kFull / 2;
constexpr int kReachBits = 5;
constexpr uint32_t kUnknownAround = 40;  // of the first texels

// Steps are odd, so that they leave as much on either side: 2 n + 1, n the reach of the finest level's. That of other
// levels in 16ths of it: what is predicted from a texel inherits what it lacks.
constexpr int kReachParts[kLevels] = {2, 2, 3, 5, 10, 16};
constexpr int stepOf(int reach, int level) { return 2 * ((reach * kReachParts[level] + 8) >> 4) + 1; }

struct Head {
  int reach = 0;
  bool alike = false;  // channels differ from their predictions alike: colours
};

// The texels of a grid's row that a level adds: from x = first on every second one. Middles: x and y are odd.
struct Row {
  int y, first, side;  // side: of the grid
  bool middles;
  int count() const { return (side - first + 1) / 2; }
  // Which rows of texels lie above and below: beyond the page mirrored.
  int above() const { return y > 0 ? y - 1 : y + 1; }
  int below() const { return y + 1 < side ? y + 1 : y - 1; }
  bool mirrored() const { return y == 0 || y + 1 == side; }
};
struct Predictions {
  std::array<std::array<int16_t, kMostInRow>, 3> of;  // channel by channel
};

// Four known texels lie next to one: a and b opposite one another, and c and d. Its prediction is the mean of all, or
// of the pair whose texels are much closer to one another than the other pair's, as along a crease. Always of all where
// `mean` is set: next to the page's border the pairs tell little.
inline int16_t predictedBy(int16_t first, int16_t second, int16_t apart_first, int16_t apart_second, bool mean) {
  constexpr int kMuch = 2, kNoise = 16;
  const bool by_first = !mean && kMuch * apart_first + kNoise < apart_second,
             by_second = !mean && kMuch * apart_second + kNoise < apart_first;
  const auto all = static_cast<int16_t>((first + second + 2) >> 2);
  const auto one = static_cast<int16_t>(((by_first ? first : second) + 1) >> 1);
  return by_first || by_second ? one : all;
}

// The row's inner texels, which have two neighbours along x: from x = first on.
RELIEVO_SIMD_CLONES void predictInner(const uint8_t* texels, const Row& row, int first, int count, int16_t* out,
                                      ptrdiff_t channel_out) noexcept {
  int16_t sums[2][3][kMostInRow], apart[2][kMostInRow] = {};
  const bool mean = row.mirrored();
  for (int k = 0; k < 3; ++k) {
    const uint8_t* channel = texels + static_cast<size_t>(k) * kChannel + first;
    const uint8_t *above = channel + row.above() * kRow, *below = channel + row.below() * kRow,
                  *own = channel + row.y * kRow;
    const uint8_t *a = row.middles ? above - 1 : own - 1, *b = row.middles ? below + 1 : own + 1,
                  *c = row.middles ? above + 1 : above, *d = row.middles ? below - 1 : below;
    for (int i = 0; i < count; ++i) {
      const auto va = static_cast<int16_t>(a[2 * i]), vb = static_cast<int16_t>(b[2 * i]),
                 vc = static_cast<int16_t>(c[2 * i]), vd = static_cast<int16_t>(d[2 * i]);
      sums[0][k][i] = static_cast<int16_t>(va + vb);
      sums[1][k][i] = static_cast<int16_t>(vc + vd);
      apart[0][i] = static_cast<int16_t>(apart[0][i] + (va > vb ? va - vb : vb - va));
      apart[1][i] = static_cast<int16_t>(apart[1][i] + (vc > vd ? vc - vd : vd - vc));
    }
  }
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < count; ++i)
      out[k * channel_out + i] = predictedBy(sums[0][k][i], sums[1][k][i], apart[0][i], apart[1][i], mean);
}
// One at the page's left or right border.
void predictOuter(const uint8_t* texels, const Row& row, int x, size_t place, Predictions& out) {
  const int left = x > 0 ? x - 1 : x + 1, right = x + 1 < row.side ? x + 1 : x - 1;
  for (size_t k = 0; k < 3; ++k) {
    const uint8_t *channel = texels + k * kChannel, *above = channel + row.above() * kRow,
                  *below = channel + row.below() * kRow, *own = channel + row.y * kRow;
    const int sum = row.middles ? above[left] + above[right] + below[left] + below[right]
                                : own[left] + own[right] + above[x] + below[x];
    out.of[k][place] = static_cast<int16_t>((sum + 2) >> 2);
  }
}
void predict(const uint8_t* texels, const Row& row, Predictions& out) {
  int begin = 0, end = row.count();
  if (row.first == 0) predictOuter(texels, row, 0, static_cast<size_t>(begin++), out);
  if (const int last = row.first + 2 * (end - 1); last + 1 == row.side && end > begin)
    predictOuter(texels, row, last, static_cast<size_t>(--end), out);
  if (end > begin) predictInner(texels, row, row.first + 2 * begin, end - begin, out.of[0].data() + begin, kMostInRow);
}

constexpr int blocksASide(int level) { return (sideOf(apartOf(level)) + kBlock - 1) / kBlock; }
constexpr int kMostBlocks = blocksASide(kLevels - 1) * blocksASide(kLevels - 1);
using Blocks = std::array<uint8_t, kMostBlocks>;

// Calls visit(row) for the rows of a level, those of middles first.
template <class Visit>
void forRows(int level, Visit visit) {
  const int side = sideOf(apartOf(level));
  for (int y = 1; y < side; y += 2) visit(Row{y, 1, side, true});
  for (int y = 0; y < side; ++y) visit(Row{y, y & 1 ? 0 : 1, side, false});
}

// From the grid of the level before, in place.
template <class T>
void spread(T* grid, int level) {
  const int coarse = sideOf(2 * apartOf(level));
  for (int y = coarse - 1; y >= 0; --y)
    for (int x = coarse - 1; x >= 0; --x) grid[2 * y * kRow + 2 * x] = grid[y * kRow + x];
}

int firstPrediction(const uint8_t* texels, int x, int y) {
  return x > 0 ? texels[y * kRow + x - 1] : y > 0 ? texels[(y - 1) * kRow] : 128;
}

// ---- what an encoder does first ----

// Residuals in whole steps, and what comes of them.
class Rounding {
 public:
  Rounding(const uint8_t* channels, TexelCodeScratch& s) : from_(channels), s_(s) {}
  void run(const Head& head) {
    for (Blocks& b : open) b.fill(0);
    constexpr int kSide = sideOf(kFirstApart);
    const int first_step = stepOf(head.reach, 0);
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x)
        for (size_t k = 0; k < 3; ++k) {
          uint8_t* texels = s_.texels.data() + k * kChannel;
          const int predicted = firstPrediction(texels, x, y);
          const int off = from_[k * kChannel + static_cast<size_t>((y * kRow + x) * kFirstApart)] - predicted,
                    steps = (2 * std::abs(off) + first_step) / (2 * first_step), e = off < 0 ? -steps : steps;
          first[k][static_cast<size_t>(y * kSide + x)] = e;
          texels[y * kRow + x] = static_cast<uint8_t>(std::clamp(predicted + e * first_step, 0, 255));
        }
    for (int level = 0; level < kLevels; ++level) {
      for (size_t k = 0; k < 3; ++k) spread(s_.texels.data() + k * kChannel, level);
      forRows(level, [&](const Row& row) { round(head, level, row); });
    }
  }
  std::array<std::array<int, sideOf(kFirstApart) * sideOf(kFirstApart)>, 3> first;
  std::array<Blocks, kLevels> open;  // which of a level's have any that is not 0

 private:
  void round(const Head& head, int level, const Row& row) {
    const int apart = apartOf(level), count = row.count(), step = stepOf(head.reach, level);
    Predictions p;
    predict(s_.texels.data(), row, p);
    std::array<int16_t, kMostInRow> before{};
    for (size_t k = 0; k < 3; ++k) {
      const uint8_t* from = from_ + k * kChannel + (row.y * kRow + row.first) * apart;
      uint8_t* texel = s_.texels.data() + k * kChannel + row.y * kRow + row.first;
      roundChannel(from, 2 * apart, p.of[k].data(), count, step, head.alike, before.data(), texel);
      int16_t* e = s_.planned.data() + k * kChannel + (row.y * kRow + row.first) * apart;
      for (int i = 0; i < count; ++i) {
        e[2 * apart * i] = before[static_cast<size_t>(i)];
        if (before[static_cast<size_t>(i)] != 0) openAt(level, row.first + 2 * i, row.y);
      }
    }
  }
  void openAt(int level, int x, int y) {
    open[static_cast<size_t>(level)][static_cast<size_t>(y / kBlock * blocksASide(level) + x / kBlock)] = 1;
  }
  // before: residuals of the channel before; then of this one.
  RELIEVO_SIMD_CLONES static void roundChannel(const uint8_t* from, int apart, const int16_t* predicted, int count,
                                               int step, bool alike, int16_t* before, uint8_t* texel) noexcept {
    // n inverse >> 16 is n / (2 step) for all n that occur: at most 510 + step.
    const auto inverse = static_cast<uint16_t>((65535 + 2 * step) / (2 * step));
    int16_t own[kMostInRow], shown[kMostInRow];
    for (int i = 0; i < count; ++i) own[i] = from[i * apart];
    const auto s = static_cast<int16_t>(step), of_before = static_cast<int16_t>(alike ? step : 0);
    for (int i = 0; i < count; ++i) {
      auto p = static_cast<int16_t>(predicted[i] + before[i] * of_before);
      p = p < 0 ? int16_t{0} : p > 255 ? int16_t{255} : p;
      const auto off = static_cast<int16_t>(own[i] - p);
      const auto size = static_cast<uint16_t>(off < 0 ? -off : off);
      const auto n = static_cast<uint16_t>(2 * size + s);
      const auto steps = static_cast<int16_t>((uint32_t{n} * inverse) >> 16);
      const auto e = static_cast<int16_t>(off < 0 ? -steps : steps);
      before[i] = e;
      const auto v = static_cast<int16_t>(p + e * s);
      shown[i] = v < 0 ? int16_t{0} : v > 255 ? int16_t{255} : v;
    }
    for (int i = 0; i < count; ++i) texel[2 * i] = static_cast<uint8_t>(shown[i]);
  }
  const uint8_t* from_;
  TexelCodeScratch& s_;
};

// Do neighbours differ less if what the channel before differs by is taken away?
RELIEVO_SIMD_CLONES bool areAlike(const uint8_t* channels) noexcept {
  int alone = 0, together = 0;  // at most 2 * 136^2 * 510
  for (size_t k = 0; k < 2; ++k) {
    const uint8_t *before = channels + k * kChannel, *own = before + kChannel;
    for (size_t i = 1; i < kChannel; ++i) {
      const int of_own = own[i] - own[i - 1], apart = of_own - (before[i] - before[i - 1]);
      alone += of_own < 0 ? -of_own : of_own;
      together += apart < 0 ? -apart : apart;
    }
  }
  return together < alone;
}

// ---- the code ----

template <class Coder>
class PageCode {
  static constexpr bool kEncodes = std::is_same_v<Coder, EncodingCoder>;

 public:
  // texels: a decoder's. rounding: an encoder's.
  PageCode(Coder& coder, TexelCodeScratch& s, uint8_t* texels, const Rounding* rounding)
      : coder_(coder), s_(s), texels_(texels), rounding_(rounding) {
    for (auto& of_class : models_)
      for (auto& of_kind : of_class)
        for (residual_code::Models& m : of_kind) m = kFirst;
  }
  void run(Head head) {
    head.reach = static_cast<int>(coder_.plain(static_cast<uint32_t>(head.reach), kReachBits));
    head.alike = coder_.plain(head.alike, 1) != 0;
    firstTexels(head);
    for (int level = 0; level < kLevels; ++level) {
      for (size_t k = 0; k < 3; ++k) {
        spread(s_.sizes.data() + k * kChannel, level);
        if constexpr (!kEncodes) spread(texels_ + k * kChannel, level);
      }
      clearNew(level);
      Blocks open{};
      if constexpr (kEncodes) open = rounding_->open[static_cast<size_t>(level)];
      codeBlocks(level, open);
      forRows(level, [&](const Row& row) { codeRow(head, level, row, open); });
      parent_ = open;
      parent_side_ = blocksASide(level);
    }
  }

 private:
  static constexpr int kClasses = 3;  // of levels: the finest, the next, the others
  static constexpr residual_code::Models kFirst = residual_code::firstModels();

  void firstTexels(const Head& head) {
    constexpr int kSide = sideOf(kFirstApart);
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        for (size_t k = 0; k < 3; ++k) {
          int e = 0;
          if constexpr (kEncodes) e = rounding_->first[k][static_cast<size_t>(y * kSide + x)];
          e = residual_code::code(coder_, models_[kClasses - 1][k][0], kUnknownAround, 0, e);
          s_.sizes[k * kChannel + static_cast<size_t>(y * kRow + x)] = 0;
          if constexpr (!kEncodes) {
            uint8_t* texels = texels_ + k * kChannel;
            texels[y * kRow + x] = shown(firstPrediction(texels, x, y) + e * stepOf(head.reach, 0));
          }
        }
      }
    }
  }
  static uint8_t shown(int value) { return static_cast<uint8_t>(std::clamp(value, 0, 255)); }

  // Sizes of what is not known yet are 0.
  void clearNew(int level) {
    forRows(level, [&](const Row& row) {
      for (size_t k = 0; k < 3; ++k)
        for (int x = row.first; x < row.side; x += 2)
          s_.sizes[k * kChannel + static_cast<size_t>(row.y * kRow + x)] = 0;
    });
  }
  void codeRow(const Head& head, int level, const Row& row, const Blocks& open) {
    const int step = stepOf(head.reach, level), apart = apartOf(level);
    Predictions from;
    if constexpr (!kEncodes) predict(texels_, row, from);
    const uint8_t* open_row = open.data() + row.y / kBlock * blocksASide(level);
    for (int i = 0, x = row.first; x < row.side; ++i, x += 2) {
      const auto at = static_cast<size_t>(row.y * kRow + x), place = static_cast<size_t>(i);
      if (!open_row[x / kBlock]) {
        if constexpr (!kEncodes)
          for (size_t k = 0; k < 3; ++k) texels_[at + k * kChannel] = static_cast<uint8_t>(from.of[k][place]);
        continue;
      }
      int before = 0;
      for (size_t k = 0; k < 3; ++k) {
        uint8_t& size = s_.sizes[at + k * kChannel];
        const uint32_t around = sizesAround(&size, row, x) + (k > 0 ? 6u * static_cast<uint32_t>(std::abs(before)) : 0);
        int e = 0;
        if constexpr (kEncodes) e = s_.planned[k * kChannel + at * static_cast<size_t>(apart)];
        auto& models = models_[static_cast<size_t>(std::min(kLevels - 1 - level, kClasses - 1))][k][row.middles];
        e = residual_code::code(coder_, models, around, 0, e);
        size = static_cast<uint8_t>(std::abs(e));
        if constexpr (!kEncodes) {
          int value = from.of[k][place];
          if (head.alike) value = std::clamp(value + before * step, 0, 255);
          texels_[at + k * kChannel] = shown(value + e * step);
        }
        before = e;
      }
    }
  }
  // Of the four known texels next to it; of the last of its kind to the left and above, twice; and of the two between
  // these: of a middle those of its kind, else the others.
  static uint32_t sizesAround(const uint8_t* size, const Row& row, int x) {
    const int left = x > 0 ? -1 : 1, right = x + 1 < row.side ? 1 : -1, above = (row.above() - row.y) * kRow,
              below = (row.below() - row.y) * kRow;
    uint32_t sum = row.middles
                       ? uint32_t{size[above + left]} + size[above + right] + size[below + left] + size[below + right]
                       : uint32_t{size[left]} + size[right] + size[above] + size[below];
    if (x >= 2) sum += 2u * size[-2];
    if (row.y >= 2) sum += 2u * size[-2 * kRow];
    const int aside = row.middles ? 2 : 1;
    if (row.y >= aside) {
      if (x >= aside) sum += size[-aside * kRow - aside];
      if (x + aside < row.side) sum += size[-aside * kRow + aside];
    }
    return sum;
  }
  void codeBlocks(int level, Blocks& open) {
    const int side = blocksASide(level);
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        const int left = x > 0 ? open[static_cast<size_t>(y * side + x - 1)] : 0,
                  above = y > 0 ? open[static_cast<size_t>((y - 1) * side + x)] : 0,
                  coarser = parent_side_ == 0 ? 1 : parent_[static_cast<size_t>(y / 2 * parent_side_ + x / 2)];
        uint8_t& b = open[static_cast<size_t>(y * side + x)];
        b = coder_.bit(blocks_[static_cast<size_t>(level)][4 * coarser + 2 * above + left], b);
      }
    }
  }

  Coder& coder_;
  TexelCodeScratch& s_;
  uint8_t* texels_;
  const Rounding* rounding_;
  residual_code::Models models_[kClasses][3][2];
  BitModel blocks_[kLevels][8];
  Blocks parent_{};
  int parent_side_ = 0;
};

void encode(std::span<const uint8_t> channels, std::span<const ChannelTolerance> tolerances, TexelCodeScratch& scratch,
            std::vector<uint8_t>& out) {
  assert(channels.size() == 3 * kChannel && tolerances.size() == 3);
  Rounding rounding(channels.data(), scratch);
  Head head{.reach = 0, .alike = areAlike(channels.data())};
  auto isGood = [&](int reach) {
    head.reach = reach;
    rounding.run(head);
    for (size_t k = 0; k < 3; ++k)
      if (!isWithin(channels.data() + k * kChannel, scratch.texels.data() + k * kChannel, tolerances[k])) return false;
    return true;
  };
  // The largest that is good, as far as smaller ones are. 0 is exact.
  int good = 0, bad = 1 << kReachBits;
  while (bad - good > 1) {
    const int between = good + (bad - good) / 4 + 1;  // most are small
    (isGood(between) ? good : bad) = between;
  }
  if (head.reach != good) isGood(good);
  EncodingCoder coder{RangeEncoder(out)};
  PageCode<EncodingCoder>(coder, scratch, nullptr, &rounding).run(head);
  coder.rc.finish();
}

bool decode(std::span<const uint8_t> bytes, TexelCodeScratch& scratch, std::span<uint8_t> channels) {
  assert(channels.size() == 3 * kChannel);
  DecodingCoder coder{RangeDecoder(bytes)};
  PageCode<DecodingCoder>(coder, scratch, channels.data(), nullptr).run({});
  return coder.rc.whole();
}

}  // namespace
}  // namespace texel_code

void encodeTexelCode(std::span<const uint8_t> channels, std::span<const ChannelTolerance> tolerances,
                     TexelCodeScratch& scratch, std::vector<uint8_t>& out) {
  texel_code::encode(channels, tolerances, scratch, out);
}

bool decodeTexelCode(std::span<const uint8_t> bytes, TexelCodeScratch& scratch, std::span<uint8_t> channels) {
  return texel_code::decode(bytes, scratch, channels);
}

}  // namespace relievo
