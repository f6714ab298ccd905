// open_sides.h - the sides of a base mesh's patches, taken one after the other, that no further patch has met yet:
// along the border of what was taken. Whoever takes next the patch at the newest of them winds around corners, so that
// it mostly has two corners of that side, one of the next side at its end, and one new one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory_resource>
#include <unordered_map>
#include <vector>

namespace relievo {

class OpenSides {
 public:
  static constexpr uint32_t kNone = ~uint32_t{0};
  // A patch's corners around it; side i lies between those of kLoop[i] and kLoop[i + 1].
  static constexpr std::array<size_t, 4> kLoop{0, 1, 3, 2};
  static constexpr size_t corner(size_t i) { return kLoop[i % 4]; }
  struct Side {
    uint32_t from = 0, to = 0;  // corners of the base, in the direction in which its patch's loop runs
    uint32_t older = kNone, newer = kNone;
    bool open = true;
    uint32_t older_at_from = kNone, older_at_to = kNone;  // at those corners, some closed ones left out
  };

  // corners: of the base.
  explicit OpenSides(size_t corners) : at_corner_(corners) {}

  uint32_t newest() const { return newest_; }
  const Side& operator[](uint32_t side) const { return sides_[side]; }
  uint32_t between(uint32_t a, uint32_t b) const {
    const auto found = by_ends_.find(keyOf(a, b));
    return found == by_ends_.end() ? kNone : found->second;
  }
  void close(uint32_t side) {
    Side& s = sides_[side];
    if (!s.open) return;
    s.open = false;
    (s.newer == kNone ? newest_ : sides_[s.newer].older) = s.older;
    if (s.older != kNone) sides_[s.older].newer = s.newer;
    by_ends_.erase(keyOf(s.from, s.to));
  }
  // The side itself, or if it was closed the oldest of the open ones that are newer; else the newest of all. Whoever
  // asks only for a side that was open when it was last asked for passes each closed one at most once.
  uint32_t openFrom(uint32_t side) const {
    while (side < sides_.size() && !sides_[side].open) {
      const uint32_t newer = sides_[side].newer;  // of those that were there when it was closed
      side = newer == kNone ? side + 1 : newer;
    }
    return side < sides_.size() ? side : newest_;
  }
  // The newest of all sides of which the corner is the first, if it is open; else kNone.
  uint32_t beginningAt(uint32_t corner) const {
    const uint32_t begins = corner < at_corner_.size() ? at_corner_[corner].begins : kNone;
    return begins != kNone && sides_[begins].open ? begins : kNone;
  }
  // The patch was reached by side i of its loop, which then is the oldest of its sides.
  void take(const std::array<uint32_t, 4>& patch, size_t i) {
    for (size_t k = 4; k > 0; --k) {
      const uint32_t from = patch[corner(i + k)], to = patch[corner(i + k + 1)], met = between(from, to);
      if (met == kNone) open(from, to);
      else close(met);
    }
  }
  // The far end of the newest open side at that corner which has none of the others; kNone: there is no such.
  uint32_t beyond(uint32_t corner, const std::array<uint32_t, 4>& others) {
    for (uint32_t* at = &at_corner_[corner].newest; *at != kNone;) {
      Side& s = sides_[*at];
      uint32_t& older = s.from == corner ? s.older_at_from : s.older_at_to;
      if (!s.open) {
        *at = older;
        continue;
      }
      const uint32_t end = s.from == corner ? s.to : s.from;
      if (end != others[0] && end != others[1] && end != others[2] && end != others[3]) return end;
      at = &older;
    }
    return kNone;
  }

 private:
  static uint64_t keyOf(uint32_t a, uint32_t b) { return a < b ? uint64_t{a} << 32 | b : uint64_t{b} << 32 | a; }
  void open(uint32_t from, uint32_t to) {
    const auto side = static_cast<uint32_t>(sides_.size());
    sides_.push_back({from, to, newest_, kNone, true, at_corner_[from].newest, at_corner_[to].newest});
    if (newest_ != kNone) sides_[newest_].newer = side;
    newest_ = side;
    by_ends_[keyOf(from, to)] = side;
    at_corner_[from].newest = at_corner_[to].newest = at_corner_[from].begins = side;
  }

  std::vector<Side> sides_;
  uint32_t newest_ = kNone;
  std::pmr::unsynchronized_pool_resource nodes_;
  std::pmr::unordered_map<uint64_t, uint32_t> by_ends_{&nodes_};
  struct AtCorner {
    uint32_t newest = kNone;  // side, some closed ones left out
    uint32_t begins = kNone;  // the newest one of which it is the first
  };
  std::vector<AtCorner> at_corner_;
};

}  // namespace relievo
