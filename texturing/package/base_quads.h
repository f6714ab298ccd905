// base_quads.h - which corners the patches of a coded base mesh have (base_code.h), in three ways: by how long ago a
// corner was named; by the open sides of the patches before (src/artwork/open_sides.h); and by these in contexts of the
// two patches before, where corners that are far from there lie along the border of what was taken.
// texturing/PACKAGE.md: "Coded base mesh", "Base mesh by sides", "Base mesh by its border".
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "src/artwork/open_sides.h"
#include "texturing/codec/range_coder.h"
#include "texturing/codec/relief_levels.h"
#include "texturing/package/base_code.h"
#include "texturing/package/package_layout.h"

namespace relievo::base_code {

template <class Coder>
class QuadCode {
  static constexpr bool kEncodes = std::is_same_v<Coder, relief_levels::EncodingCoder>;

 public:
  // quads: read by an encoder, and written by both.
  QuadCode(Coder& coder, std::span<std::array<uint32_t, 4>> quads, uint32_t corners, BaseCodeKind kind)
      : coder_(coder), quads_(quads), corners_(corners), kind_(kind), open_(corners) {
    if (kind == BaseCodeKind::kByBorder) by_two_.resize(kPatterns * kPatterns);
  }

  // False: damaged.
  bool run() {
    for (std::array<uint32_t, 4>& quad : quads_) {
      size_t reached_by = 0;  // side of the patch's loop
      bool found = false;
      if (kind_ != BaseCodeKind::kByCorners && !quadAtSide(quad, found, reached_by)) return false;
      for (size_t k = 0; k < 4 && !found; ++k)
        if (!anyCorner(quad[k], k)) return false;
      if (kind_ != BaseCodeKind::kByCorners) open_.take(quad, reached_by);
    }
    return true;
  }

 private:
  template <int kBits, size_t kSize>
  uint32_t symbol(std::array<BitModel, kSize>& models, uint32_t v) {
    static_assert(kSize == 1 << kBits);
    return relief_levels::codeSymbol<kBits>(coder_, models, v);
  }
  bool byBorder() const { return kind_ == BaseCodeKind::kByBorder; }

  // A corner of a patch that is at no side. False: damaged.
  bool anyCorner(uint32_t& at, size_t k) {
    if (!byBorder()) return recentCorner(at, k);
    return coder_.bit(first_new_, kEncodes && at == next_) ? named(at, next_) : plainCorner(at);
  }

  // ---- by how long ago they were named ----
  // A corner that comes for the first time is the next one.
  static constexpr uint32_t kRecent = 62;
  bool recentCorner(uint32_t& at, size_t k) {
    uint32_t corner = at, rank = 0;
    if constexpr (kEncodes) {
      const auto found = std::find(recent_.rbegin(), recent_.rend(), corner);
      rank = corner == next_           ? 0
             : found != recent_.rend() ? 1 + static_cast<uint32_t>(found - recent_.rbegin())
                                       : kRecent + 1;
    }
    rank = symbol<6>(rank_[k][last_new_], rank);
    last_new_ = rank == 0;
    if (rank == kRecent + 1) corner = coder_.plain(corner, 32);
    else if (rank == 0) corner = next_;
    else if (rank > recent_.size()) return false;
    else corner = recent_[recent_.size() - rank];
    return named(at, corner);
  }
  bool named(uint32_t& at, uint32_t corner) {
    if (corner >= corners_) return false;
    if (corner == next_) ++next_;
    at = corner;
    if (byBorder()) return true;
    if (const auto found = std::find(recent_.begin(), recent_.end(), corner); found != recent_.end())
      recent_.erase(found);
    recent_.push_back(corner);
    if (recent_.size() > kRecent) recent_.erase(recent_.begin());
    return true;
  }

  // ---- by sides ----
  // A patch at the newest open side, or one of few before it, has two corners of that; those before it are closed. The
  // other two are new, or at the end of another open side, or any. found: it is such a patch. False: damaged.
  bool quadAtSide(std::array<uint32_t, 4>& own, bool& found, size_t& reached_by) {
    uint32_t skipped = kNoSide;
    if constexpr (kEncodes) {
      uint32_t newest = open_.newest();
      for (uint32_t n = 0; n < kNoSide && newest != OpenSides::kNone && skipped == kNoSide; ++n) {
        for (size_t i = 0; i < 4; ++i)
          if (open_.between(own[OpenSides::corner(i)], own[OpenSides::corner(i + 1)]) == newest)
            reached_by = i, skipped = n;
        newest = open_[newest].older;
      }
    }
    skipped = sidesSkipped(skipped);
    found = skipped != kNoSide;
    if (!found) return decided(0), true;
    for (; skipped > 0 && open_.newest() != OpenSides::kNone; --skipped) open_.close(open_.newest());
    const uint32_t side = open_.newest();
    if (side == OpenSides::kNone) return false;
    const uint32_t from = open_[side].from, to = open_[side].to;
    reached_by = sideReachedBy(reached_by);
    const size_t first = OpenSides::corner(reached_by), second = OpenSides::corner(reached_by + 1);
    // Patches that face alike run along their common side in opposite directions.
    const bool alike = coder_.bit(alike_, kEncodes && own[first] == to);
    std::array<uint32_t, 4> quad{OpenSides::kNone, OpenSides::kNone, OpenSides::kNone, OpenSides::kNone};
    quad[first] = alike ? to : from;
    quad[second] = alike ? from : to;
    size_t so_far = reached_by;
    for (size_t k = 0; k < 4; ++k) {
      if (k == first || k == second) {
        if (!named(own[k], quad[k])) return false;
        continue;
      }
      const uint32_t beside = quad[k == OpenSides::corner(reached_by + 2) ? second : first];
      const uint32_t expected = open_.beyond(beside, quad);
      Which which = Which::kExpected;
      if (!(byBorder() ? cornerByBorder(own[k], expected, so_far, which) : cornerBeside(own[k], k, expected)))
        return false;
      const auto decided_so = static_cast<size_t>(which);
      so_far = so_far < kSides ? kSides + kWhich * so_far + decided_so : kWhich * (so_far - kSides) + decided_so;
      quad[k] = own[k];
    }
    decided(1 + so_far);
    return true;
  }
  static constexpr uint32_t kNoSide = 63;
  uint32_t sidesSkipped(uint32_t skipped) {
    if (byBorder() && !bit(0, skipped != 0)) return 0;
    return symbol<6>(skipped_, skipped);
  }
  size_t sideReachedBy(size_t side) {
    if (byBorder()) {
      const bool high = bit(1, side >= 2);
      return 2 * size_t{high} + bit(2 + size_t{high}, side % 2 != 0);
    }
    return last_reached_by_ = symbol<2>(reached_by_[last_reached_by_], static_cast<uint32_t>(side));
  }
  bool cornerBeside(uint32_t& at, size_t k, uint32_t expected) {
    const bool known = expected != OpenSides::kNone;
    const uint32_t own = at;
    if (!known || !coder_.bit(expected_[last_expected_], kEncodes && own == expected)) {
      last_expected_ = known ? 0 : last_expected_;
      const bool is_new = coder_.bit(new_[known], kEncodes && own == next_);
      return is_new ? named(at, next_) : recentCorner(at, k);
    }
    last_expected_ = 1;
    return named(at, expected);
  }

  // ---- by the border ----
  enum class Which : uint8_t { kExpected, kNew, kOther };
  static constexpr size_t kSides = 4, kWhich = 3;
  // What a patch was found by: nothing, or a side and which the other two corners are.
  static constexpr size_t kPatterns = 1 + kSides * kWhich * kWhich;
  // Whether sides are skipped, by which side it is reached, and of each corner, by what is known of the patch and
  // whether one is expected, whether it is that, and whether it is new.
  static constexpr size_t kKnown = kSides + kSides * kWhich, kFirstOfCorners = 4,
                          kDecisions = kFirstOfCorners + 3 * kKnown;

  // By the two patches before, or by the one before where that was rare.
  bool bit(size_t decision, bool value) {
    constexpr int kRarely = 5;
    BitModel &by_two = by_two_[kPatterns * before_last_ + last_][decision], &by_one = by_one_[last_][decision];
    const bool rare = by_two.seen < kRarely;
    value = coder_.bit(rare ? by_one : by_two, value);
    (rare ? by_two : by_one).learn(value);
    return value;
  }
  void decided(size_t pattern) {
    before_last_ = last_;
    last_ = pattern;
  }
  // known: of the patch, less than kKnown.
  bool cornerByBorder(uint32_t& at, uint32_t expected, size_t known, Which& which) {
    const bool expects = expected != OpenSides::kNone;
    const size_t first = kFirstOfCorners + 3 * known;
    if (expects && bit(first, kEncodes && at == expected)) return which = Which::kExpected, named(at, expected);
    if (bit(first + 1 + expects, kEncodes && at == next_)) return which = Which::kNew, named(at, next_);
    which = Which::kOther;
    return cornerOfBorder(at);
  }
  // Other parts of the border are met along them: mostly the next side is met after the one that was met last.
  bool cornerOfBorder(uint32_t& at) {
    constexpr uint32_t kNotNear = 15;
    met_ = open_.openFrom(met_);
    uint32_t near = kNotNear;
    if constexpr (kEncodes) {
      for (near = 0; near < kNotNear; ++near)
        if (const uint32_t side = sideNear(near); side != OpenSides::kNone && open_[side].from == at) break;
    }
    near = symbol<4>(near_, near);
    if (near == kNotNear) return plainCorner(at);
    met_ = sideNear(near);
    return met_ != OpenSides::kNone && named(at, open_[met_].from);
  }
  // 0: the one that was met last; then in turn those after it and before it.
  uint32_t sideNear(uint32_t n) const {
    uint32_t side = met_;
    for (uint32_t steps = (n + 1) / 2; steps > 0 && side != OpenSides::kNone; --steps)
      side = n % 2 ? open_[side].newer : open_[side].older;
    return side;
  }
  bool plainCorner(uint32_t& at) {
    const uint32_t corner = coder_.plain(at, static_cast<int>(std::bit_width(corners_)));
    if (const uint32_t side = open_.beginningAt(corner); side != OpenSides::kNone) met_ = side;
    return named(at, corner);
  }

  Coder& coder_;
  const std::span<std::array<uint32_t, 4>> quads_;
  const uint32_t corners_;
  const BaseCodeKind kind_;
  OpenSides open_;
  uint32_t next_ = 0;
  std::vector<uint32_t> recent_;  // corners, the latest last
  std::array<std::array<std::array<BitModel, 64>, 2>, 4> rank_;
  size_t last_new_ = 0;
  std::array<BitModel, 64> skipped_;
  std::array<std::array<BitModel, 4>, 4> reached_by_;
  size_t last_reached_by_ = 0, last_expected_ = 0;
  BitModel alike_, expected_[2], new_[2], first_new_;
  using Decisions = std::array<BitModel, kDecisions>;
  std::vector<Decisions> by_two_;
  std::array<Decisions, kPatterns> by_one_;
  size_t last_ = 0, before_last_ = 0;  // patterns
  uint32_t met_ = OpenSides::kNone;    // side
  std::array<BitModel, 16> near_;
};

}  // namespace relievo::base_code
