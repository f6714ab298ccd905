// tail_heights.h - the heights of patches' tails, some hundred patches at a time, for tail_code.cpp: as relief pages
// have them (relief_levels.h); models learn from patch to patch. An encoder and a decoder are the same code over
// another Coder.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <type_traits>
#include <unordered_map>
#include <utility>

#include "texturing/codec/relief_levels.h"
#include "texturing/codec/tail_code.h"

namespace relievo::tail_heights {

using relief_levels::codeSymbol;

inline constexpr int kLevels = kTailCodeCellsLog2, kCells = 1 << kLevels, kSide = kCells + 1;
inline constexpr size_t kHeights = size_t{kSide} * kSide;

// What relief pages state plainly is the same in most patches of a scan.
template <class Coder>
class HeadCode {
 public:
  explicit HeadCode(Coder& coder) : coder_(coder) {}
  void step(relief_levels::Head& head) {
    if (coder_.bit(other_step_, head.step != step_)) step_ = coder_.plain(head.step, 16);
    head.step = step_ = std::max(step_, 1u);  // 0: of damaged bytes
    head.levels =
        std::min(static_cast<int>(codeSymbol<3>(coder_, levels_, static_cast<uint32_t>(head.levels))), kLevels);
  }
  void predictions(relief_levels::Head& head) {
    for (size_t l = 0; l < static_cast<size_t>(head.levels); ++l) {
      head.how[l] = codeSymbol<2>(coder_, how_[l], head.how[l]);
      head.times[l] = codeSymbol<3>(coder_, times_[l], head.times[l]);
    }
  }

 private:
  Coder& coder_;
  uint32_t step_ = 1;
  BitModel other_step_;
  std::array<BitModel, 8> levels_;
  std::array<std::array<BitModel, 4>, kLevels> how_;
  std::array<std::array<BitModel, 8>, kLevels> times_;
};

template <class Coder>
inline constexpr bool kEncodes = std::is_same_v<Coder, relief_levels::EncodingCoder>;
template <class Coder>
using Samples = std::span<std::conditional_t<kEncodes<Coder>, const uint16_t, uint16_t>>;
struct Never {
  bool operator()() const { return false; }
};

// Each patch by itself.
template <class Coder>
class PlainCode {
 public:
  PlainCode(Coder& coder, ReliefCodeScratch& s) : coder_(coder), s_(s), head_(coder), grid_(coder, models_, s) {}
  // stop(): what is read is no code of so many patches.
  template <class Stop = Never>
  void run(Samples<Coder> heights, Stop&& stop = {}) {
    for (size_t at = 0; at < heights.size() && !stop(); at += kHeights) {
      const auto samples = heights.subspan(at, kHeights);
      relief_levels::Head head;
      if constexpr (kEncodes<Coder>) head = relief_levels::headOf<kLevels>(samples, s_);
      head_.step(head);
      head.stepped_corners = coder_.bit(stepped_corners_, head.stepped_corners);
      head_.predictions(head);
      grid_.run(head, samples);
    }
  }

 private:
  Coder& coder_;
  ReliefCodeScratch& s_;
  HeadCode<Coder> head_;
  BitModel stepped_corners_;
  relief_levels::Models models_ = relief_levels::kFirstModels;
  relief_levels::GridCode<kLevels, Coder> grid_;
};

// Samples of corners and sides that patches before have as well are not coded again.
template <class Coder>
class SharedCode {
 public:
  SharedCode(Coder& coder, ReliefCodeScratch& s, PatchCorners corners)
      : coder_(coder), s_(s), corners_(corners), head_(coder), grid_(coder, models_, s) {}
  template <class Stop = Never>
  void run(Samples<Coder> heights, Stop&& stop = {}) {
    shared_ = coder_.plain(kEncodes<Coder> && areShared(heights), 1) != 0;
    forget();
    for (size_t p = 0; p < corners_.size() && !stop(); ++p) {
      findGiven(heights, p);
      const auto samples = heights.subspan(p * kHeights, kHeights);
      codeCorners(samples);
      relief_levels::Head head;
      if constexpr (kEncodes<Coder>) head = relief_levels::headOf<kLevels>(samples, s_, given_);
      head_.step(head);
      head_.predictions(head);
      grid_.run(head, samples, 0, given_);
      remember(p);
      last_ = samples[0];
    }
  }

 private:
  static constexpr std::array<size_t, 4> kCorners{0, kCells, kCells* kSide, kHeights - 1};
  static constexpr int kSideCorners[4][2] = {{0, 1}, {2, 3}, {0, 2}, {1, 3}};
  struct Side {
    size_t patch;
    int side;
  };
  static uint64_t keyOf(uint32_t a, uint32_t b) { return uint64_t{std::min(a, b)} << 32 | std::max(a, b); }
  static size_t sampleOf(int side, int i) {
    return kCorners[static_cast<size_t>(kSideCorners[side][0])] + static_cast<size_t>(i * (side < 2 ? 1 : kSide));
  }

  void forget() {
    of_corner_.clear();
    of_side_.clear();
  }
  void remember(size_t p) {
    const auto& c = corners_[p];
    for (size_t k = 0; k < 4; ++k) of_corner_[c[k]] = p * kHeights + kCorners[k];
    for (int s = 0; s < 4; ++s) of_side_[keyOf(c[kSideCorners[s][0]], c[kSideCorners[s][1]])] = {p, s};
  }
  // What patches before say of this one's.
  void findGiven(std::span<const uint16_t> heights, size_t p) {
    given_.fill(relief_levels::kNotGiven);
    if (!shared_) return;
    const auto& c = corners_[p];
    for (size_t k = 0; k < 4; ++k)
      if (const auto found = of_corner_.find(c[k]); found != of_corner_.end())
        given_[kCorners[k]] = heights[found->second];
    for (int s = 0; s < 4; ++s) {
      const uint32_t first = c[kSideCorners[s][0]];
      const auto found = of_side_.find(keyOf(first, c[kSideCorners[s][1]]));
      if (found == of_side_.end()) continue;
      const auto [patch, side] = found->second;
      const bool same_way = corners_[patch][kSideCorners[side][0]] == first;
      for (int i = 1; i < kCells; ++i)
        given_[sampleOf(s, i)] = heights[patch * kHeights + sampleOf(side, same_way ? i : kCells - i)];
    }
  }
  bool areShared(std::span<const uint16_t> heights) {
    shared_ = true;
    for (size_t p = 0; p < corners_.size(); ++p) {
      findGiven(heights, p);
      for (size_t i = 0; i < kHeights; ++i)
        if (given_[i] != relief_levels::kNotGiven && given_[i] != heights[p * kHeights + i]) return false;
      remember(p);
    }
    return true;
  }

  void codeCorners(std::span<const uint16_t> samples) {
    for (size_t k = 0; k < 4; ++k) {
      int32_t& h = given_[kCorners[k]];
      if (h != relief_levels::kNotGiven) continue;
      const int32_t from = k == 0  ? last_
                           : k < 3 ? given_[kCorners[0]]
                                   : given_[kCorners[1]] + given_[kCorners[2]] - given_[kCorners[0]];
      h = (from + signedNumber(number_[k > 0], kEncodes<Coder> ? samples[kCorners[k]] - from : 0)) & 0xFFFF;
    }
  }
  // Of up to 18 bits.
  struct NumberModels {
    std::array<BitModel, 32> width;
    std::array<std::array<BitModel, 2>, 32> top;
  };
  int32_t signedNumber(NumberModels& m, int32_t v) {
    const uint32_t folded = v < 0 ? ~(static_cast<uint32_t>(v) << 1) : static_cast<uint32_t>(v) << 1;
    const auto width = static_cast<int>(codeSymbol<5>(coder_, m.width, static_cast<uint32_t>(std::bit_width(folded))));
    uint32_t value = width > 0;
    int left = std::max(width - 1, 0);
    for (size_t k = 0; k < 2 && left > 0; ++k) {
      --left;
      value = value << 1 | coder_.bit(m.top[static_cast<size_t>(width)][k], folded >> left & 1);
    }
    if (left > 0) value = value << left | coder_.plain(folded & ((1u << left) - 1), left);
    return static_cast<int32_t>(value & 1 ? ~(value >> 1) : value >> 1);
  }

  Coder& coder_;
  ReliefCodeScratch& s_;
  PatchCorners corners_;
  HeadCode<Coder> head_;
  relief_levels::Models models_ = relief_levels::kFirstModels;
  relief_levels::GridCode<kLevels, Coder, true> grid_;
  bool shared_ = false;
  int32_t last_ = 0;
  std::array<int32_t, kHeights> given_;
  std::unordered_map<uint32_t, size_t> of_corner_;  // the sample of a patch before
  std::unordered_map<uint64_t, Side> of_side_;
  std::array<NumberModels, 2> number_;
};

}  // namespace relievo::tail_heights
