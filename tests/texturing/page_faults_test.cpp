// The streamer on bad storage, in a cache that is too small, and under random operations.
#include "tests/texturing/page_simulation.h"

#include <cmath>

namespace relievo {
namespace page_faults_test {

using namespace fake;

// --- faults ---

double dice(PageId id, uint64_t seed) { return static_cast<double>(mix(id.bits * 31 + seed) >> 11) * 0x1p-53; }

TEST(StreamerFaults, FailingShortCorruptAndLateReads) {
  for (uint64_t seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    auto failing = std::make_shared<FailingSource>(
        std::make_shared<ProceduralSource>(),
        FailingSource::Rates{.fail = 0.1, .truncate = 0.1, .corrupt = 0.1, .permanent = 0.05}, seed);
    Simulation sim(failing, Simulation::options(2048));
    sim.texels_matter = seed == 1;
    sim.delay_s = [&](PageId id) { return dice(id, seed) < 0.1 ? 5.0 : 0.02; };
    sim.in_flight = 16;
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    int late = 0;
    for (uint32_t i = 0; i < 120 && !HasFatalFailure(); ++i) {  // a camera that drifts
      sim.texture = square(5, i / 8, 3, 5);
      sim.step();
      for (const NodeRequest& w : sim.texture) ASSERT_TRUE(sim.shown(w.node)) << "a look-up must end somewhere";
      late += static_cast<int>(std::count_if(sim.flights.begin(), sim.flights.end(),
                                             [&](const auto& f) { return f.finish_s > sim.now_s + 1; }));
    }
    EXPECT_GT(late, 100) << "no read was late";
    // A still one: what shows never becomes coarser, whatever fails.
    std::map<PageId, uint32_t> shown;
    int frames = 0;
    do {
      sim.step();
      ASSERT_FALSE(HasFatalFailure());
      for (const NodeRequest& w : sim.texture) {
        uint32_t level = sim.shown(w.node)->level;
        uint32_t& before = shown[PageId(texturePlane(0), w.node)];
        ASSERT_GE(level, before) << "an ancestor went";
        before = level;
      }
    } while (!sim.streamer.settled() && ++frames < 3000);
    EXPECT_LT(frames, 3000);
    expectFinal(sim, *failing);
    EXPECT_GT(sim.streamer.stats().failed_pages, 0u);
    EXPECT_GT(sim.streamer.stats().retries, 10u);
    uint64_t reads = sim.taken.size();
    sim.run(300);
    EXPECT_EQ(sim.taken.size(), reads) << "a retry storm";
  }
}

TEST(StreamerFaults, ASourceThatNeverAnswersStopsNothing) {
  auto options = Simulation::options(256);
  options.ready_limit = 12;
  Simulation sim(std::make_shared<ProceduralSource>(), options);
  sim.in_flight = 100;
  sim.delay_s = [](PageId) { return 1e12; };
  sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
  for (uint32_t i = 0; i < 500 && !HasFatalFailure(); ++i) {
    sim.texture = square(5, i % 20, i % 17, 4);
    sim.relief = square(5, i % 20, i % 17, 2);
    sim.predicted = square(5, (i + 7) % 20, i % 17, 4);
    if (i % 50 == 0) sim.streamer.setLight(frontLight(0.01 * i, 0));
    sim.step();
    for (const NodeRequest& w : sim.texture) ASSERT_EQ(sim.shown(w.node), kRoot);
    EXPECT_FALSE(sim.streamer.settled());
  }
  EXPECT_EQ(sim.taken.size(), 12u) << "bounded by the buffers";
  EXPECT_GT(sim.streamer.stats().cancelled_before_read, 1000u);
}  // and so does the destructor not wait: nobody reads

// --- pressure ---

// A view that follows the bias three frames later: eight strips, each an eighth of a level coarser than the last, as a
// surface that tilts away from the eye.
struct TiltedView {
  uint32_t level = 6, strips = 8;
  double scale = 1;  // of the view's size
  std::vector<double> biases = std::vector<double>(4, 0.0);
  std::vector<NodeRequest> requested(double bias) {
    biases.push_back(bias);
    double seen = biases[biases.size() - 4];
    std::vector<NodeId> nodes;
    for (uint32_t s = 0; s < strips; ++s) {
      auto coarser = static_cast<uint32_t>(std::floor(seen + s / 8.0));
      uint32_t l = level - std::min(level, coarser), size = 1u << l;
      auto width = static_cast<uint32_t>(std::ceil(size * scale * 0.5)), row = s * size / 64;
      for (uint32_t y = row; y <= row + size / 16; ++y)
        for (uint32_t x = 0; x < width; ++x)
          if (y < size) nodes.push_back({0, l, x, y});
    }
    return withAncestors(nodes);
  }
};

TEST(StreamerPressure, AQuarterOfTheWorkingSetEndsStillWithin60FramesAndRecoversWithin30) {
  for (double share : {0.9, 0.5, 0.25, 0.1, 0.06}) {
    SCOPED_TRACE("a cache of " + std::to_string(share) + " of the working set");
    TiltedView view;
    size_t working_set = 3 * view.requested(0).size();
    Simulation sim(std::make_shared<ProceduralSource>(),
                   Simulation::options(static_cast<uint32_t>(share * static_cast<double>(working_set))));
    sim.texels_matter = false;
    sim.in_flight = 64;
    sim.delay_s = [](PageId) { return 0.0; };
    sim.streamer.pinRoots({{kRoot}}, {});
    double low = 1e9, high = 0;
    size_t loads = 0;
    auto run = [&](int frames, int from) {
      low = 1e9, high = 0, loads = 0;
      for (int i = 0; i < frames && !HasFatalFailure(); ++i) {
        sim.texture = view.requested(sim.streamer.detailBias());
        size_t before = sim.taken.size();
        sim.step();
        for (const NodeRequest& w : sim.texture) ASSERT_TRUE(sim.shown(w.node));
        if (i < from) continue;
        loads += sim.taken.size() - before;
        low = std::min(low, sim.streamer.detailBias());
        high = std::max(high, sim.streamer.detailBias());
      }
    };
    run(160, 60);
    EXPECT_EQ(loads, 0u) << "a still camera loads nothing";
    EXPECT_LE(high - low, 0.05);
    EXPECT_GT(low, 0);
    EXPECT_EQ(sim.streamer.stats().deferred, 0u);
    EXPECT_TRUE(sim.streamer.settled());
    EXPECT_GT(sim.streamer.stats().wanted, 0.5 * sim.pool.size()) << "the cache is put to use";
    std::printf("cache %.2f of the working set: bias %.2f, %llu of %zu slots wanted\n", share, low,
                static_cast<unsigned long long>(sim.streamer.stats().wanted), sim.pool.size());
    view.scale = 0.04 * share;
    run(60, 30);
    EXPECT_EQ(high, 0) << "all detail is back";
    EXPECT_TRUE(sim.streamer.settled());
    view.scale = 1;
    run(160, 60);
    EXPECT_EQ(loads, 0u) << "and under pressure again";
  }
}

TEST(StreamerPressure, TheCheckSeesAViewThatIsNotStill) {
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(60, {texturePlane(0)}));
  sim.delay_s = [](PageId) { return 0.0; };
  size_t loads = 0;
  for (int i = 0; i < 160; ++i) {
    sim.texture = square(6, i % 2 ? 0 : 40, 0, 6);
    size_t before = sim.taken.size();
    sim.step();
    if (i >= 60) loads += sim.taken.size() - before;
  }
  EXPECT_GT(loads, 100u);
}

TEST(StreamerPressure, TheSmallestCacheStillDraws) {
  for (uint32_t beyond_roots : {0u, 1u, 2u, 3u, 16u}) {
    TiltedView view;
    Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(4 + beyond_roots));
    sim.delay_s = [](PageId) { return 0.0; };
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    for (int i = 0; i < 300 && !HasFatalFailure(); ++i) {
      sim.texture = view.requested(sim.streamer.detailBias());
      sim.relief = square(4, 0, 0, 3);
      sim.step();
      for (const NodeRequest& w : sim.texture) ASSERT_TRUE(sim.shown(w.node));
      EXPECT_NE(sim.streamer.findRelief(kRoot), kNoSlot);
    }
    size_t loads = sim.taken.size();
    for (int i = 0; i < 50; ++i) {
      sim.texture = view.requested(sim.streamer.detailBias());
      sim.step();
    }
    EXPECT_EQ(sim.taken.size(), loads) << "still";
  }
}

// --- two pools ---

// Neither pool takes from the other, and the one in greater need decides on the detail.
TEST(StreamerPressure, EachOfTwoPoolsLowersTheDetail) {
  const auto highest_bias = [](uint32_t texture_slots, uint32_t relief_slots) {
    TiltedView view;
    Simulation sim(std::make_shared<ProceduralSource>(), Simulation::blockOptions(texture_slots, relief_slots));
    sim.delay_s = [](PageId) { return 0.0; };
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    double highest = 0;
    for (int i = 0; i < 200 && !::testing::Test::HasFatalFailure(); ++i) {
      const double bias = sim.streamer.detailBias();
      sim.texture = view.requested(bias);
      sim.relief = sim.texture;
      sim.step();
      highest = std::max(highest, bias);
      for (const NodeRequest& w : sim.texture) EXPECT_TRUE(sim.shown(w.node));
    }
    size_t loads = sim.taken.size();
    for (int i = 0; i < 50; ++i) {
      sim.texture = sim.relief = view.requested(sim.streamer.detailBias());
      sim.step();
    }
    EXPECT_EQ(sim.taken.size(), loads) << "still";
    return highest;
  };
  EXPECT_EQ(highest_bias(3000, 1000), 0);
  EXPECT_GT(highest_bias(100, 1000), 0.3);
  EXPECT_GT(highest_bias(3000, 34), 0.3);
}

// --- random operations ---

void holdUnderRandomOperations(bool blocks) {
  for (uint64_t seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    auto dice_of = [&](uint64_t n) { return static_cast<uint32_t>(random() % n); };
    auto failing =
        std::make_shared<FailingSource>(std::make_shared<ProceduralSource>(),
                                        FailingSource::Rates{.fail = 0.1, .truncate = 0.05, .corrupt = 0.05}, seed);
    bool fixed_light = seed % 3 == 0 && !blocks;
    auto options = Simulation::options(30 + dice_of(200), fixed_light ? std::vector{Plane::kResolved} : kThreePlanes);
    options.ready_limit = 1 + dice_of(30);
    if (blocks) {
      options.upload = std::array{PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc7}[seed % 3];
      options.relief_slot_count = 12 + dice_of(60);
    }
    Simulation sim(failing, options);
    sim.texels_matter = !fixed_light && seed % 2 == 0;
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    sim.in_flight = 1 + dice_of(40);
    sim.delay_s = [&](PageId) { return 0.001 * dice_of(120); };
    std::map<NodeId, int> pins;
    auto set_before = sim.streamer.residentRelief();
    uint64_t generation = sim.streamer.reliefGeneration();
    for (int i = 0; i < 250 && !::testing::Test::HasFatalFailure(); ++i) {
      auto x = dice_of(12), y = dice_of(12);
      switch (dice_of(8)) {
        case 0:
          sim.texture = square(4, x, y, 1 + dice_of(4));
          break;
        case 1:
          sim.relief = square(4, x, y, 1 + dice_of(4));
          break;
        case 2:
          sim.predicted = square(4, x, y, dice_of(5));
          break;
        case 3:
          sim.texture.insert(sim.texture.end(), sim.predicted.begin(), sim.predicted.end());
          break;  // duplicates
        case 4:
          sim.streamer.setLight(frontLight(0.01 * dice_of(90), 0.1));
          break;
        case 5:
          sim.now_s += 3;
          break;
        case 6:
          for (const NodeId& n : sim.streamer.residentRelief())
            if (pins.size() < 8 && sim.streamer.pinRelief(n)) ++pins[n];
          break;
        default:
          for (auto it = pins.begin(); it != pins.end();) {
            sim.streamer.unpinRelief(it->first);
            it = --it->second == 0 ? pins.erase(it) : std::next(it);
          }
      }
      sim.max_uploads = dice_of(20);
      sim.step();
      // Roots and pins stay; every look-up ends resident, at what was uploaded for it.
      ASSERT_TRUE(sim.streamer.table().find(kRoot));
      ASSERT_NE(sim.streamer.findRelief(kRoot), kNoSlot);
      for (const auto& [n, count] : pins) ASSERT_NE(sim.streamer.findRelief(n), kNoSlot);
      std::set<SlotIndex> used;
      for (const NodeRequest& w : sim.texture) {
        auto node = sim.shown(w.node);
        ASSERT_TRUE(node);
        auto entry = sim.streamer.table().find(*node);
        for (size_t p = 0; p < sim.planes.size(); ++p)
          ASSERT_EQ(sim.pool[entry->slots[p]], PageId(sim.planes[p], *node));
      }
      // The generation tells every change of the set.
      auto set_now = sim.streamer.residentRelief();
      ASSERT_TRUE(set_now == set_before || sim.streamer.reliefGeneration() != generation);
      set_before = std::move(set_now);
      generation = sim.streamer.reliefGeneration();
      ASSERT_LE(sim.streamer.stats().ready + sim.streamer.stats().decoding, options.ready_limit);
    }
    for (auto& [n, count] : pins)
      while (count-- > 0) sim.streamer.unpinRelief(n);
    sim.predicted.clear();
    sim.texture = square(3, 1, 1, 2);
    sim.relief.clear();
    sim.max_uploads = 16;
    sim.frame_s = 0.2;
    EXPECT_TRUE(sim.settle(1000));
  }
}

TEST(StreamerProperties, HoldUnderRandomOperations) { holdUnderRandomOperations(false); }
TEST(StreamerProperties, HoldWithBlocksInSlotsOfTheirOwn) { holdUnderRandomOperations(true); }

}  // namespace page_faults_test
}  // namespace relievo
