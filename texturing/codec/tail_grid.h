// tail_grid.h - the texels of a patch's tail by ever finer grids (texturing/PACKAGE.md, "Tails by grids"), for
// tail_code.cpp: the corners, then texels between those that are known, each predicted from these. Normals and colours
// that run evenly over a patch, as over a scan's own triangles, take little more than their corners. An encoder and a
// decoder are the same code over another Coder (relief_levels.h). All in integers: the same texels on every machine.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <span>
#include <type_traits>
#include <unordered_map>

#include "texturing/codec/relief_levels.h"
#include "texturing/codec/residual_code.h"

namespace relievo::tail_grid {

inline constexpr int kSide = 16, kLevels = 4;
inline constexpr size_t kFinest = kSide * kSide;
inline constexpr size_t kHalved = 64 + 16 + 4;  // texels of the levels of 8, 4 and 2 a side
// Steps by which an encoder may change a texel.
inline constexpr std::array<int, 8> kReaches{0, 1, 2, 3, 5, 8, 12, 18};
using Channels = std::array<std::array<uint8_t, kFinest>, 3>;

// How a patch's three channels depend on one another.
enum class Kind : uint8_t {
  kAlone,
  kAlike,   // they differ from their predictions alike: colours
  kLength,  // the largest component follows from the other two, at the neighbours' length: normals
};
inline constexpr int kKinds = 3;

// Index 16 of 0 .. 16 stands for the last texel, 15 for none, so that grids of every 8th, 4th, 2nd index end at texels.
constexpr size_t texelAt(int x, int y) {
  return static_cast<size_t>(std::min(y, kSide - 1) * kSide + std::min(x, kSide - 1));
}
inline constexpr std::array<size_t, 4> kCorners{texelAt(0, 0), texelAt(16, 0), texelAt(0, 16), texelAt(16, 16)};

// A texel that a level adds, and the four known ones that it lies between: a and b on one line, c and d on another.
struct Texel {
  uint8_t at = 0, a = 0, b = 0, c = 0, d = 0;
  uint8_t right = 128, below = 128;  // how far from a to b, or of a middle along x and y, in 256ths
  bool middle = false;               // its line a b is a diagonal; c d the other one
  bool pair = false;                 // no middle: there are no c and d
  bool edge = false;                 // on the patch's border
  std::array<uint16_t, 8> around{};  // places of Sizes
};
// Sizes of residuals, of 17 x 17 indices and a place that is always 0.
inline constexpr size_t kSizes = 17 * 17 + 1, kNoSize = kSizes - 1;

inline constexpr size_t kAdded = kFinest - 4;
struct Texels {
  std::array<Texel, kAdded> all{};
  std::array<size_t, kLevels + 1> first{};  // of each level

  constexpr Texels() {
    size_t n = 0;
    for (int level = 0; level < kLevels; ++level) {
      const int d = 8 >> level;
      first[static_cast<size_t>(level)] = n;
      for (int y = d; y < 16; y += 2 * d)
        for (int x = d; x < 16; x += 2 * d)
          if (x != 15 && y != 15) all[n++] = middleAt(x, y, d);
      for (int y = 0; y <= 16; y += d)
        for (int x = y / d % 2 ? 0 : d; x <= 16; x += 2 * d)
          if (x != 15 && y != 15) all[n++] = betweenAt(x, y, d);
    }
    first[kLevels] = n;
  }

 private:
  static constexpr uint8_t place(int x, int y) { return static_cast<uint8_t>(texelAt(x, y)); }
  static constexpr uint8_t share(int i, int d) {
    return static_cast<uint8_t>(i + d == 16 ? (256 * d + d - 1) / (2 * d - 1) : 128);
  }
  static constexpr uint16_t size(int x, int y) {
    const bool known = x >= 0 && y >= 0 && x <= 16 && y <= 16 && x != 15 && y != 15;
    return static_cast<uint16_t>(known ? static_cast<size_t>(17 * y + x) : kNoSize);
  }
  static constexpr int mirrored(int i) { return i < 0 ? -i : i > 16 ? 32 - i : i; }
  static constexpr bool isEdge(int x, int y) { return x == 0 || y == 0 || x == 16 || y == 16; }
  static constexpr Texel middleAt(int x, int y, int d) {
    Texel t;
    t.at = place(x, y);
    t.a = place(x - d, y - d), t.b = place(x + d, y + d), t.c = place(x + d, y - d), t.d = place(x - d, y + d);
    t.right = share(x, d), t.below = share(y, d);
    t.middle = true, t.edge = isEdge(x, y);
    t.around = {size(x - d, y - d),         size(x + d, y - d),         size(x - d, y + d), size(x + d, y + d),
                size(x - 2 * d, y - 2 * d), size(x + 2 * d, y - 2 * d), size(x - 2 * d, y), size(x, y - 2 * d)};
    return t;
  }
  static constexpr Texel betweenAt(int x, int y, int d) {
    const bool along_x = x / d % 2,
               pair = along_x ? y == 0 || y == 16 || y + d == 15 : x == 0 || x == 16 || x + d == 15;
    const int dx = along_x ? d : 0, dy = along_x ? 0 : d;
    Texel t;
    t.at = place(x, y);
    t.a = place(x - dx, y - dy), t.b = place(x + dx, y + dy);
    t.pair = pair;
    if (!pair) t.c = place(x - dy, y - dx), t.d = place(x + dy, y + dx);
    t.right = share(along_x ? x : y, d);
    t.edge = isEdge(x, y);
    t.around = {size(mirrored(x - d), y), size(mirrored(x + d), y), size(x, mirrored(y - d)), size(x, mirrored(y + d)),
                size(x - d, y - d),       size(x + d, y - d),       size(x - 2 * d, y),       size(x, y - 2 * d)};
    return t;
  }
};
inline constexpr Texels kTexels;

// Steps are odd, so that they leave as much on either side: 2 n + 1. Coarser levels' are smaller, as what is predicted
// from a texel inherits what it lacks, and so are those of the border, which the next patch shows as well.
inline constexpr std::array<int, kLevels> kReachParts{3, 5, 10, 16};  // 16ths
constexpr int stepOf(int reach, size_t level, bool edge) {
  return 2 * (((edge ? (reach + 1) / 2 : reach) * kReachParts[level] + 8) >> 4) + 1;
}

// What the four neighbours say. The pair whose texels are much closer to one another than the other pair's counts
// alone, as along a crease.
inline std::array<int, 3> predicted(const Channels& texels, const Texel& t) {
  std::array<int, 3> out{};
  constexpr int kMuch = 2, kNoise = 16;
  int first = 0, second = 0;
  if (!t.pair)
    for (const auto& of : texels) first += std::abs(of[t.a] - of[t.b]), second += std::abs(of[t.c] - of[t.d]);
  const bool by_first = t.pair || kMuch * first + kNoise < second, by_second = kMuch * second + kNoise < first;
  for (size_t k = 0; k < 3; ++k) {
    const auto& of = texels[k];
    const int a = of[t.a], b = of[t.b], c = of[t.c], d = of[t.d];
    if (t.middle && (t.right != 128 || t.below != 128)) {
      const int above = a * (256 - t.right) + c * t.right, below = d * (256 - t.right) + b * t.right;
      out[k] = (above * (256 - t.below) + below * t.below + (1 << 15)) >> 16;
      continue;
    }
    const int one = t.middle ? 128 * (a + b) : a * (256 - t.right) + b * t.right, other = 128 * (c + d);
    out[k] = by_first ? (one + 128) >> 8 : by_second ? (other + 128) >> 8 : (one + other + 256) >> 9;
  }
  return out;
}

inline int component(int value) { return 2 * value - 255; }
inline int squared(const Channels& texels, size_t at) {
  int sum = 0;
  for (const auto& of : texels) sum += component(of[at]) * component(of[at]);
  return sum;
}
inline int squaredAround(const Channels& texels, const Texel& t) {
  const int line = squared(texels, t.a) + squared(texels, t.b);
  return t.middle ? (line + squared(texels, t.c) + squared(texels, t.d)) >> 2 : line >> 1;
}
// The channels from the smallest component on, the first of equals first.
inline std::array<size_t, 3> bySize(const std::array<int, 3>& expected) {
  std::array<size_t, 3> order{0, 1, 2};
  auto swapIf = [&](size_t i, size_t j) {
    if (std::abs(component(expected[order[i]])) > std::abs(component(expected[order[j]])))
      std::swap(order[i], order[j]);
  };
  swapIf(0, 1), swapIf(1, 2), swapIf(0, 1);
  return order;
}
// Of the component that is left of a normal of that squared length.
inline int fromLength(int squared_length, const std::array<int, 3>& values, const std::array<size_t, 3>& order,
                      int expected) {
  for (size_t k = 0; k < 2; ++k) squared_length -= component(values[order[k]]) * component(values[order[k]]);
  if (squared_length <= 0) return expected;
  const int root = static_cast<int>(std::sqrt(static_cast<double>(squared_length)));  // exact: as IEEE 754 rounds
  return std::clamp(((component(expected) < 0 ? -root : root) + 256) >> 1, 0, 255);
}

// Calls residual(place in the order, predicted value) for three channels in turn; it says by how many steps.
template <class Residual>
void codeTexel(Channels& texels, size_t at, const std::array<int, 3>& expected, int squared_length, Kind kind, int step,
               Residual&& residual) {
  const std::array<size_t, 3> order = kind == Kind::kLength ? bySize(expected) : std::array<size_t, 3>{0, 1, 2};
  std::array<int, 3> values{};
  int before = 0;
  for (size_t k = 0; k < 3; ++k) {
    const size_t c = order[k];
    int from = expected[c];
    if (kind == Kind::kAlike) from = std::clamp(from + before * step, 0, 255);
    if (kind == Kind::kLength && k == 2) from = fromLength(squared_length, values, order, from);
    before = residual(k, c, from);
    texels[c][at] = static_cast<uint8_t>(values[c] = std::clamp(from + before * step, 0, 255));
  }
}

// ---- what an encoder does first ----

// A patch's texels in whole steps, and what comes of them.
struct Plan {
  Kind kind = Kind::kAlone;
  size_t reach = 0;  // of kReaches
  Channels texels;
  std::array<std::array<int16_t, kAdded>, 3> residuals;  // by place in the order
  std::array<bool, kLevels> open{};                      // levels that have any that is not 0

  // keeps(channel, texel, value) says no: it ends. The corners stay as they are.
  template <class Keeps>
  bool make(const Channels& from, Kind of_kind, size_t of_reach, Keeps&& keeps) {
    kind = of_kind, reach = of_reach;
    for (size_t c = 0; c < 3; ++c)
      for (size_t corner : kCorners) texels[c][corner] = from[c][corner];
    for (size_t level = 0; level < kLevels; ++level) {
      open[level] = false;
      for (size_t i = kTexels.first[level]; i < kTexels.first[level + 1]; ++i) {
        const Texel& t = kTexels.all[i];
        const int step = stepOf(kReaches[reach], level, t.edge);
        codeTexel(texels, t.at, predicted(texels, t), kind == Kind::kLength ? squaredAround(texels, t) : 0, kind, step,
                  [&](size_t k, size_t c, int expected) {
                    const int off = from[c][t.at] - expected, steps = (2 * std::abs(off) + step) / (2 * step),
                              e = off < 0 ? -steps : steps;
                    residuals[k][i] = static_cast<int16_t>(e);
                    open[level] = open[level] || e != 0;
                    return e;
                  });
        for (size_t c = 0; c < 3; ++c)
          if (!keeps(from[c][t.at], texels[c][t.at])) return false;
      }
    }
    return true;
  }
  // About how many bits the residuals take.
  double cost() const {
    static constexpr std::array<double, 4> kBits{0.4, 2.5, 4.5, 5.7};  // of sizes 0 to 3
    double bits = 0;
    for (size_t level = 0; level < kLevels; ++level) {
      if (!open[level]) continue;
      for (size_t i = kTexels.first[level]; i < kTexels.first[level + 1]; ++i)
        for (const auto& of : residuals)
          bits += kBits[static_cast<size_t>(std::min(std::abs(static_cast<int>(of[i])), 3))];
    }
    return bits;
  }
};

// The plan of fewest bits among each kind's of the farthest reach that make(plan, kind, reach) accepts; of 0 it does.
template <class Make>
void bestPlan(Plan& best, Make&& make) {
  double least = std::numeric_limits<double>::infinity();
  Plan tried;
  for (int kind = 0; kind < kKinds; ++kind) {
    size_t reach = kReaches.size() - 1;
    while (!make(tried, static_cast<Kind>(kind), reach)) --reach;
    if (const double cost = tried.cost(); cost < least) least = cost, best = tried;
  }
}

// Of texels that are to stay what they are.
inline void planExactly(const Channels& from, Plan& plan) {
  bestPlan(plan, [&](Plan& tried, Kind kind, size_t reach) {
    return tried.make(from, kind, reach, [](uint8_t a, uint8_t b) { return a == b; });
  });
}
// None farther off than `most`, no channel farther than `rms` in the root mean square.
inline void planWithin(const Channels& from, int most, double rms, Plan& plan) {
  bestPlan(plan, [&](Plan& tried, Kind kind, size_t reach) {
    if (reach == 0) return tried.make(from, kind, 0, [](uint8_t, uint8_t) { return true; });
    if (kReaches[reach] > most || !tried.make(from, kind, reach, [](uint8_t, uint8_t) { return true; })) return false;
    for (size_t c = 0; c < 3; ++c) {
      int squares = 0;
      for (size_t i = 0; i < kFinest; ++i) {
        const int off = from[c][i] - tried.texels[c][i];
        squares += off * off;
      }
      if (squares > rms * rms * kFinest) return false;
    }
    return true;
  });
}

// ---- the code ----

// The mean of four texels of the finer level, whose rows have twice `side`; sum: with 2 added.
inline int sumOfFour(const uint8_t* fine, int side, int x, int y) {
  const uint8_t* f = fine + 4 * y * side + 2 * x;
  return f[0] + f[1] + f[2 * side] + f[2 * side + 1] + 2;
}

// The three channels of a plane, patch after patch of a chunk.
template <class Coder>
class PlaneCode {
  static constexpr bool kEncodes = std::is_same_v<Coder, relief_levels::EncodingCoder>;
  using Byte = std::conditional_t<kEncodes, const uint8_t, uint8_t>;

 public:
  explicit PlaneCode(Coder& coder) : coder_(coder) {
    first_.fill(128);
    for (auto& of_level : residual_)
      for (auto& of_kind : of_level)
        for (residual_code::Models& m : of_kind) m = residual_code::firstModels();
  }

  // levels[l]: the three channels of the level of 16 >> l texels a side, one after the other. corners: the base's.
  void patch(const std::array<Byte*, kLevels>& levels, const std::array<uint32_t, 4>& corners) {
    even_ = coder_.bit(even_model_[even_], kEncodes && isEven(levels));
    if (even_) {
      if constexpr (!kEncodes) fill(levels);
      for (uint32_t corner : corners) seen_[corner] = first_;
      return;
    }
    if constexpr (kEncodes) {
      for (size_t c = 0; c < 3; ++c) std::copy_n(levels[0] + c * kFinest, kFinest, plan_.texels[c].begin());
      const Channels from = plan_.texels;
      planExactly(from, plan_);
      if (std::none_of(plan_.open.begin(), plan_.open.end(), [](bool open) { return open; })) plan_.reach = reach_;
    }
    kind_ = std::min(relief_levels::codeSymbol<2>(coder_, kind_model_[kind_], static_cast<uint32_t>(plan_.kind)),
                     uint32_t{kKinds - 1});
    reach_ = relief_levels::codeSymbol<3>(coder_, reach_model_[reach_], static_cast<uint32_t>(plan_.reach));
    codeCorners(corners);
    codeLevels();
    if constexpr (!kEncodes)
      for (size_t c = 0; c < 3; ++c) std::copy(texels_[c].begin(), texels_[c].end(), levels[0] + c * kFinest);
    codeHalved(levels);
    for (size_t c = 0; c < 3; ++c) first_[c] = texels_[c][kCorners[0]];
    for (size_t k = 0; k < 4; ++k)
      for (size_t c = 0; c < 3; ++c) seen_[corners[k]][c] = texels_[c][kCorners[k]];
  }

 private:
  static constexpr size_t texelsOf(size_t level) { return kFinest >> (2 * level); }
  // All as the last patch's first texel.
  bool isEven(const std::array<Byte*, kLevels>& levels) const {
    for (size_t level = 0; level < kLevels; ++level)
      for (size_t c = 0; c < 3; ++c) {
        const auto* from = levels[level] + c * texelsOf(level);
        if (std::any_of(from, from + texelsOf(level), [&](uint8_t t) { return t != first_[c]; })) return false;
      }
    return true;
  }
  void fill(const std::array<Byte*, kLevels>& levels) const {
    for (size_t level = 0; level < kLevels; ++level)
      for (size_t c = 0; c < 3; ++c) std::fill_n(levels[level] + c * texelsOf(level), texelsOf(level), first_[c]);
  }
  void codeCorners(const std::array<uint32_t, 4>& corners) {
    for (size_t k = 0; k < 4; ++k) {
      const auto found = seen_.find(corners[k]);
      const bool known = found != seen_.end();
      std::array<int, 3> expected{};
      for (size_t c = 0; c < 3; ++c) {
        const auto& t = texels_[c];
        expected[c] = known    ? found->second[c]
                      : k == 0 ? first_[c]
                      : k < 3  ? t[kCorners[0]]
                               : std::clamp(t[kCorners[1]] + t[kCorners[2]] - t[kCorners[0]], 0, 255);
      }
      int squared_length = 0, before = 0;
      for (int v : expected) squared_length += component(v) * component(v);
      codeTexel(texels_, kCorners[k], expected, squared_length, static_cast<Kind>(kind_), 1,
                [&](size_t place, size_t c, int from) {
                  const int e = kEncodes ? plan_.texels[c][kCorners[k]] - from : 0;
                  return before = residual_code::code(coder_, corner_[known][k][place],
                                                      6u * static_cast<uint32_t>(std::abs(before)), 0, e);
                });
    }
  }
  void codeLevels() {
    sizes_ = {};
    bool open = true;
    for (size_t level = 0; level < kLevels; ++level) {
      open = coder_.bit(open_[level][open], kEncodes && plan_.open[level]);
      for (size_t i = kTexels.first[level]; i < kTexels.first[level + 1]; ++i) code(level, i, open);
    }
  }
  void code(size_t level, size_t i, bool open) {
    const Texel& t = kTexels.all[i];
    const Kind kind = static_cast<Kind>(kind_);
    int before = 0;
    codeTexel(texels_, t.at, predicted(texels_, t), kind == Kind::kLength ? squaredAround(texels_, t) : 0, kind,
              stepOf(kReaches[reach_], level, t.edge), [&](size_t k, size_t, int) {
                if (!open) return 0;
                uint32_t around = 6u * static_cast<uint32_t>(std::abs(before));
                for (size_t n = 0; n < t.around.size(); ++n) around += (n < 6 ? 1u : 2u) * sizes_[k][t.around[n]];
                before = residual_code::code(coder_, residual_[level][t.middle][k], around, 0,
                                             kEncodes ? plan_.residuals[k][i] : 0);
                sizes_[k][sizeAt(t.at)] = static_cast<uint8_t>(std::min(std::abs(before), 255));
                return before;
              });
  }
  static size_t sizeAt(size_t texel) {
    const size_t x = texel % kSide, y = texel / kSide;
    return 17 * (y == kSide - 1 ? 16 : y) + (x == kSide - 1 ? 16 : x);
  }

  // The means of the finer level's texels, but for their rounding, and for what colours' halving adds.
  void codeHalved(const std::array<Byte*, kLevels>& levels) {
    if constexpr (kEncodes) other_ = !areMeans(levels);
    other_ = coder_.bit(other_model_[was_other_], other_);
    was_other_ = other_;
    for (size_t level = 1; level < kLevels; ++level) {
      const int side = kSide >> level;
      for (size_t c = 0; c < 3; ++c) {
        const uint8_t* fine = levels[level - 1] + c * texelsOf(level - 1);
        Byte* to = levels[level] + c * texelsOf(level);
        for (int y = 0; y < side; ++y)
          for (int x = 0; x < side; ++x, ++to) {
            const int sum = sumOfFour(fine, side, x, y), from = sum >> 2;
            int e = kEncodes ? *to - from : 0;
            if (other_) e = residual_code::code(coder_, halved_[sum & 3], 0, 0, e);
            if constexpr (!kEncodes) *to = static_cast<uint8_t>(std::clamp(from + e, 0, 255));
          }
      }
    }
  }
  static bool areMeans(const std::array<Byte*, kLevels>& levels) {
    for (size_t level = 1; level < kLevels; ++level) {
      const int side = kSide >> level;
      for (size_t c = 0; c < 3; ++c)
        for (int y = 0; y < side; ++y)
          for (int x = 0; x < side; ++x)
            if (levels[level][c * texelsOf(level) + static_cast<size_t>(y * side + x)] !=
                sumOfFour(levels[level - 1] + c * texelsOf(level - 1), side, x, y) >> 2)
              return false;
    }
    return true;
  }

  Coder& coder_;
  Plan plan_;  // an encoder's
  Channels texels_{};
  std::array<std::array<uint8_t, kSizes>, 3> sizes_{};  // by place in the order
  std::array<uint8_t, 3> first_;
  std::unordered_map<uint32_t, std::array<uint8_t, 3>> seen_;  // by corner of the base
  bool even_ = false, other_ = false, was_other_ = false;
  uint32_t kind_ = 0, reach_ = 0;
  BitModel even_model_[2], other_model_[2], open_[kLevels][2];
  std::array<std::array<BitModel, 4>, kKinds> kind_model_;
  std::array<std::array<BitModel, 8>, kReaches.size()> reach_model_;
  residual_code::Models corner_[2][4][3], residual_[kLevels][2][3], halved_[4];
};

}  // namespace relievo::tail_grid
