// Parity in the place of a base mesh's copy: what damages less than a block is made good, whatever lies around it.
#include "texturing/package/base_parity.h"

#include <gtest/gtest.h>

#include <random>

namespace relievo {
namespace base_parity_test {

constexpr uint64_t kSeed = 20261129;

std::vector<uint8_t> bytesOf(size_t size) {
  std::mt19937_64 random(kSeed + size);
  std::vector<uint8_t> out(size);
  for (uint8_t& b : out) b = static_cast<uint8_t>(random());
  return out;
}

// Inverts bytes, each so that it differs.
void damage(std::vector<uint8_t>& bytes, size_t first, size_t count) {
  for (size_t i = first; i < std::min(bytes.size(), first + count); ++i) bytes[i] ^= 0xA5;
}

TEST(BaseParity, ARunOfABlockIsMadeGoodWhereverItLies) {
  for (const size_t size : {1, 2, 15, 16, 17, 31, 100, 1000, 4097}) {
    const std::vector<uint8_t> base = bytesOf(size), parity = parityOf(base);
    EXPECT_EQ(parity.size(), parityBytes(size));
    const size_t block = parityBlockBytes(size);
    for (size_t first = 0; first < size; ++first) {
      std::vector<uint8_t> broken = base;
      damage(broken, first, block);
      ASSERT_NE(broken, base);
      mendByParity(parity, broken);
      ASSERT_EQ(broken, base) << size << " bytes, from " << first << " on";
    }
    std::vector<uint8_t> sound = base;
    mendByParity(parity, sound);
    EXPECT_EQ(sound, base) << "what is sound stays";
  }
}

// Negative controls: two blocks of one kind, and hashes that are damaged themselves.
TEST(BaseParity, MoreThanABlockOfEachKindIsLost) {
  const std::vector<uint8_t> base = bytesOf(1600), parity = parityOf(base);
  std::vector<uint8_t> broken = base;
  damage(broken, 100, 1);
  damage(broken, 400, 1);  // blocks 1 and 4
  mendByParity(parity, broken);
  EXPECT_EQ(broken, base);
  damage(broken, 100, 1);
  damage(broken, 310, 1);  // 1 and 3, at other places in them
  const std::vector<uint8_t> lost = broken;
  mendByParity(parity, broken);
  EXPECT_EQ(broken, lost) << "nothing is made up";
  std::vector<uint8_t> other = parity;
  other[3] ^= 1;
  broken = base;
  damage(broken, 100, 1);
  const std::vector<uint8_t> left = broken;
  mendByParity(other, broken);
  EXPECT_EQ(broken, left);
}

TEST(BaseParity, TakesAnEighthOfTheBase) {
  EXPECT_LT(parityBytes(400'000), 400'000 / 8 + 200);
  EXPECT_EQ(parityBytes(0), 8u * 17);
}

}  // namespace base_parity_test
}  // namespace relievo
