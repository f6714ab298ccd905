// recent_use.h - which slots were used in the last kSparedFrames frames, and how many: prefetching does not evict
// these. O(1) for each use.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace relievo {

inline constexpr uint32_t kSparedFrames = 8;  // a use in so many frames, the current one included, is recent

class RecentUse {
 public:
  explicit RecentUse(size_t slots) : last_(slots, 0) {}
  void beginFrame(uint64_t frame) {  // frame > 0, growing
    for (uint64_t f = frame_ + 1; f <= frame && f <= frame_ + kSparedFrames; ++f) count_[f % kSparedFrames] = 0;
    uint64_t passed = frame - frame_;
    frame_ = frame;
    // Marks are frames modulo kCycle. Old marks are cleared within half a cycle, before they could look recent again.
    size_t steps = passed < kCycle / 4 ? passed * (last_.size() * 4 / kCycle + 1) : last_.size();
    for (steps = steps < last_.size() ? steps : last_.size(); steps > 0; --steps) {
      if (next_to_clear_ >= last_.size()) next_to_clear_ = 0;
      if (passed >= kCycle / 4 || !isRecent(next_to_clear_)) last_[next_to_clear_] = 0;
      ++next_to_clear_;
    }
  }
  void use(size_t slot) {
    forget(slot);
    last_[slot] = static_cast<uint8_t>(frame_ % kCycle + 1);
    ++count_[frame_ % kSparedFrames];
  }
  void forget(size_t slot) {
    if (isRecent(slot)) --count_[(last_[slot] - 1u) % kSparedFrames];
    last_[slot] = 0;
  }
  bool isRecent(size_t slot) const {
    return last_[slot] != 0 && (frame_ % kCycle + kCycle + 1 - last_[slot]) % kCycle < kSparedFrames;
  }
  size_t bytes() const { return last_.capacity(); }
  // Slots used recently, but not in the current frame.
  uint64_t idleCount() const {
    uint64_t sum = 0;
    for (uint64_t n : count_) sum += n;
    return sum - count_[frame_ % kSparedFrames];
  }

 private:
  static constexpr uint64_t kCycle = 128;
  static_assert(kCycle % kSparedFrames == 0);

  std::vector<uint8_t> last_;  // frame % kCycle + 1; 0: long ago
  size_t next_to_clear_ = 0;
  std::array<uint64_t, kSparedFrames> count_{};
  uint64_t frame_ = 0;
};

}  // namespace relievo
