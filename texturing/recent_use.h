// recent_use.h - how many slots were used in the last few frames, and which: what prefetching leaves alone. O(1) a use.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace relievo {

inline constexpr uint32_t kSparedFrames = 8;  // what was used in as many frames, the current one included, is recent

class RecentUse {
 public:
  explicit RecentUse(size_t slots) : last_(slots, 0) {}
  void beginFrame(uint64_t frame) {  // > 0, growing
    for (uint64_t f = frame_ + 1; f <= frame && f <= frame_ + kSparedFrames; ++f) count_[f % kSparedFrames] = 0;
    frame_ = frame;
  }
  void use(size_t slot) {
    forget(slot);
    last_[slot] = frame_;
    ++count_[frame_ % kSparedFrames];
  }
  void forget(size_t slot) {
    if (isRecent(slot)) --count_[last_[slot] % kSparedFrames];
    last_[slot] = 0;
  }
  bool isRecent(size_t slot) const { return last_[slot] != 0 && last_[slot] + kSparedFrames > frame_; }
  // Used recently, but not in the current frame.
  uint64_t idleCount() const {
    uint64_t sum = 0;
    for (uint64_t n : count_) sum += n;
    return sum - count_[frame_ % kSparedFrames];
  }

 private:
  std::vector<uint64_t> last_;
  std::array<uint64_t, kSparedFrames> count_{};
  uint64_t frame_ = 0;
};

}  // namespace relievo
