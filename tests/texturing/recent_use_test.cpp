// One byte a slot says the same as the whole frame number would.
#include "texturing/stream/recent_use.h"

#include <gtest/gtest.h>

#include <random>
#include <string>

namespace relievo {
namespace recent_use_test {

// Compares with a plain record; `spared` other than kSparedFrames is the control.
std::string compare(uint64_t seed, uint64_t spared) {
  std::mt19937_64 random(seed);
  auto upTo = [&](uint64_t n) { return random() % n; };
  size_t slots = 1 + upTo(300);
  RecentUse recent(slots);
  std::vector<uint64_t> last(slots, 0);
  uint64_t frame = 0;
  for (int step = 0; step < 2000; ++step) {
    frame += upTo(50) == 0 ? 1 + upTo(400) : upTo(8) == 0 ? 1 + upTo(40) : 1;
    recent.beginFrame(frame);
    for (uint64_t n = upTo(6); n > 0; --n) {
      size_t slot = upTo(slots);
      if (upTo(5) == 0) {
        recent.forget(slot);
        last[slot] = 0;
      } else {
        recent.use(slot);
        last[slot] = frame;
      }
    }
    uint64_t idle = 0;
    for (size_t s = 0; s < slots; ++s) {
      bool is_recent = last[s] != 0 && last[s] + spared > frame;
      if (recent.isRecent(s) != is_recent) return "step " + std::to_string(step) + ", slot " + std::to_string(s);
      idle += is_recent && last[s] != frame;
    }
    if (recent.idleCount() != idle) return "step " + std::to_string(step) + ": another count";
  }
  return {};
}

TEST(RecentUse, AgreesWithAPlainRecord) {
  for (uint64_t seed = 1; seed <= 30; ++seed) ASSERT_EQ(compare(seed, kSparedFrames), "") << "seed " << seed;
}
TEST(RecentUse, TheComparisonSeesAnotherSpan) {
  for (uint64_t seed = 1; seed <= 5; ++seed) EXPECT_NE(compare(seed, kSparedFrames + 1), "") << "seed " << seed;
}

}  // namespace recent_use_test
}  // namespace relievo
