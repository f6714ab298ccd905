#include "texturing/stream/cache_budget.h"

#include <gtest/gtest.h>

#include <array>
#include <random>

namespace relievo {
namespace cache_budget_test {

constexpr std::array kUploads{PageCodec::kLossless, PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc5, PageCodec::kBc7};

TEST(CacheBudget, SlotsAreWhatTheFormatsTake) {
  EXPECT_EQ(slotBytes(PageCodec::kLossless, texturePlane(0)), 73984u);
  EXPECT_EQ(slotBytes(PageCodec::kBc1, texturePlane(2)), 9248u);
  EXPECT_EQ(slotBytes(PageCodec::kBc7, texturePlane(2)), 18496u);
  EXPECT_EQ(slotBytes(PageCodec::kBc4, texturePlane(2)), 27744u);
  EXPECT_EQ(slotBytes(PageCodec::kBc5, texturePlane(2)), 27744u);
  for (PageCodec upload : kUploads) {
    EXPECT_EQ(slotBytes(upload, Plane::kRelief), kSlotBytes);
    EXPECT_EQ(slotBytes(upload, Plane::kResolved), kSlotBytes);
  }
}

TEST(CacheBudget, NeverExceededAndRootsAlwaysFit) {
  constexpr uint32_t kSeed = 20261121;
  std::mt19937 random(kSeed);
  int scarce = 0, layers_checked = 0;
  for (int i = 0; i < 20000; ++i) {
    CacheNeeds n;
    n.upload = kUploads[random() % kUploads.size()];
    n.texture_planes = static_cast<int>(std::array{1u, 2u, 3u, 6u}[random() % 4]);
    n.relief = random() % 4 > 0;
    n.roots = 1 + random() % 60;
    n.texture_pages = (uint64_t{1} << random() % 24) * static_cast<uint64_t>(n.texture_planes);
    n.relief_pages = uint64_t{1} << random() % 24;
    n.max_slots = random() % 3 ? 65535 : 16384;
    const uint64_t least = minCacheBytes(n);
    const uint64_t budget = least + (uint64_t{random()} << random() % 4) * (random() % 4 > 0);
    const CacheSlots s = cacheSlots(n, budget);
    const std::string what = "seed " + std::to_string(kSeed) + ", case " + std::to_string(i);
    ASSERT_LE(s.bytes(), budget) << what;
    ASSERT_LE(std::max(s.texture, s.relief), n.max_slots) << what;
    const bool blocks = isBlockCodec(n.upload);
    ASSERT_EQ(isBlockCodec(s.upload), blocks) << what;
    ASSERT_GE(s.texture, n.roots * static_cast<uint32_t>(n.texture_planes + (blocks ? 0 : n.relief)) + 1) << what;
    ASSERT_EQ(s.relief > 0, blocks && n.relief) << what;
    ASSERT_TRUE(s.relief == 0 || s.relief > n.roots) << what;
    // What is left over would not hold another layer of slots for pages that there are.
    const bool full = s.texture + 64 > std::min<uint64_t>(n.max_slots, n.texture_pages);
    ASSERT_TRUE(!blocks || full || budget - s.bytes() < 64 * slotBytes(n.upload, texturePlane(0))) << what;
    // The textures that hold the slots take no more than the budget, either, where it is for a layer of each.
    const auto layered = [](uint64_t slots) { return (slots + 63) / 64 * 64; };
    const CacheSlots memory{s.upload, static_cast<uint32_t>(layered(s.texture)),
                            static_cast<uint32_t>(layered(s.relief))};
    const bool small = s.texture < 64 || (s.relief > 0 && s.relief < 64) ||
                       n.roots * static_cast<uint32_t>(n.texture_planes) + 16 > 64;
    if (blocks && !small) {
      ASSERT_LE(memory.bytes(), budget) << what;
      ++layers_checked;
    }
    scarce += blocks && !full;
  }
  EXPECT_GT(scarce, 1000);
  EXPECT_GT(layers_checked, 1000);
}

TEST(CacheBudget, BlocksHoldSeveralTimesAsManyPages) {
  CacheNeeds n{.texture_planes = 3, .relief = false};
  const uint64_t budget = uint64_t{256} << 20;
  const double rgba8 = cacheSlots(n, budget).texture;
  for (auto [codec, times] : {std::pair{PageCodec::kBc1, 8.0}, {PageCodec::kBc7, 4.0}, {PageCodec::kBc4, 8.0 / 3}}) {
    n.upload = codec;
    EXPECT_NEAR(cacheSlots(n, budget).texture / rgba8, times, 0.02);
  }
  n.relief = true;  // relief takes its share
  const CacheSlots s = cacheSlots(n, budget);
  EXPECT_NEAR(s.relief, s.texture / 3.0 / 2, 64);
  EXPECT_GT(s.texture, rgba8);
}

}  // namespace cache_budget_test
}  // namespace relievo
