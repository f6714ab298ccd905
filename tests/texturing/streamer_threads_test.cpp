// The streamer with threads: faults, the end of its life, workers beside its own. Run under ThreadSanitizer by
// tools/check.
#include <atomic>
#include <thread>

#include "tests/texturing/page_simulation.h"

namespace relievo {
namespace streamer_threads_test {

using namespace fake;

void failingShortCorruptAndLateReads(StreamerOptions options) {
  auto failing = std::make_shared<FailingSource>(
      std::make_shared<ProceduralSource>(),
      FailingSource::Rates{
          .fail = 0.1, .truncate = 0.1, .corrupt = 0.1, .permanent = 0.02, .late = 0.1, .late_s = 0.02},
      3);
  options.workers = 4;
  Simulation sim(failing, options);
  sim.texels_matter = false;
  sim.in_flight = 0;  // the threads work
  sim.frame_s = 0.05;
  sim.streamer.pinRoots({{kRoot}}, {});
  sim.texture = square(5, 3, 3, 8);
  uint64_t frames = 0;
  do {
    sim.step();
    ASSERT_FALSE(::testing::Test::HasFatalFailure());
    for (const NodeRequest& w : sim.texture) ASSERT_TRUE(sim.shown(w.node));
    std::this_thread::sleep_for(std::chrono::microseconds(500));
    ++frames;
  } while (!sim.streamer.settled());
  expectFinal(sim, *failing);
  EXPECT_GT(frames, 3u);
}
TEST(StreamerThreads, FailingShortCorruptAndLateReads) { failingShortCorruptAndLateReads(Simulation::options(1024)); }
TEST(StreamerThreads, TheSameWithBlocks) { failingShortCorruptAndLateReads(Simulation::blockOptions(1024, 64)); }

TEST(StreamerThreads, TheDestructorWaitsForTheReadsUnderWayAndForNothingElse) {
  auto gate = std::make_shared<GatedSource>(std::make_shared<ProceduralSource>());
  auto record = std::make_shared<RecordingSource>(gate);
  std::atomic<int> decoded{0};
  auto options = Simulation::options(256);
  options.workers = 2;
  auto streamer = std::make_unique<PageStreamer>(
      record, options, [&](Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) {
        ++decoded;
        return fakeDecode(plane, encoded, texels);
      });
  streamer->beginFrame(1, 0);
  streamer->requestTexture(square(4, 0, 0, 8));
  streamer->placeReady(8);
  gate->waitForReaders(2);
  std::atomic<bool> gone{false};
  std::thread owner([&] {
    streamer.reset();
    gone = true;
  });
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_FALSE(gone) << "the reads use the source";
  gate->open();
  owner.join();
  EXPECT_EQ(record->reads().size(), 2u) << "what was queued is not read";
  EXPECT_EQ(decoded, 0) << "what nobody will see is not decoded";
}

// Counts the reads that are under way at a time; each waits until the gate opens.
class CrowdedGate final : public PageSource {
 public:
  Result<EncodedPage> read(PageId id) const override {
    int now = ++under_way, before = most;
    while (before < now && !most.compare_exchange_weak(before, now)) {
    }
    while (!open) std::this_thread::sleep_for(std::chrono::microseconds(200));
    --under_way;
    return inner_.read(id);
  }
  mutable std::atomic<int> under_way{0}, most{0};
  std::atomic<bool> open{false};

 private:
  ProceduralSource inner_;
};

// While all threads wait for a slow source, more are added, as many as may read; a source that answers at once has the
// workers alone.
TEST(StreamerThreads, ASlowSourceIsAskedForManyPagesAtATime) {
  struct Case {
    int max_reads;
    bool open;
    int least, most;
  };
  for (const Case& c : {Case{16, false, 16, 16}, Case{0, false, 2, 2} /* negative control */, Case{16, true, 1, 8}}) {
    auto gate = std::make_shared<CrowdedGate>();
    gate->open = c.open;
    auto options = Simulation::options(400);
    options.workers = 2;
    options.max_reads = c.max_reads;
    std::atomic<int> decoding{0}, most_decoding{0};
    auto streamer = std::make_unique<PageStreamer>(
        gate, options, [&](Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) {
          int now = ++decoding, before = most_decoding;
          while (before < now && !most_decoding.compare_exchange_weak(before, now)) {
          }
          auto done = fakeDecode(plane, encoded, texels);
          --decoding;
          return done;
        });
    uint64_t frame = 0;
    for (; frame < 40 || (gate->most < c.least && frame < 5000); ++frame) {
      streamer->beginFrame(frame + 1, static_cast<double>(frame) / 60);
      streamer->requestTexture(square(5, 3, 3, 8));
      streamer->placeReady(64);
      std::this_thread::sleep_for(std::chrono::milliseconds(c.open ? 5 : 1));
    }
    EXPECT_GE(gate->most, c.least) << "max_reads " << c.max_reads;
    EXPECT_LE(gate->most, c.most) << "max_reads " << c.max_reads << (c.open ? ", open" : "");
    gate->open = true;
    streamer.reset();
    EXPECT_LE(most_decoding, 2) << "decoding stays with the workers";
  }
}

// Own workers, and callers who do the same, while the camera jumps, the light moves and predictions change.
TEST(StreamerThreads, WorkersOfItsOwnAndCallersShareTheJobs) {
  for (bool fixed_light : {false, true}) {
    auto options = Simulation::options(200, fixed_light ? std::vector{Plane::kResolved} : kThreePlanes);
    options.workers = 2;
    options.ready_limit = 20;
    auto failing = std::make_shared<FailingSource>(std::make_shared<ProceduralSource>(),
                                                   FailingSource::Rates{.fail = 0.05, .corrupt = 0.05}, 11);
    Simulation sim(failing, options);
    sim.texels_matter = false;
    sim.in_flight = 0;
    sim.max_uploads = 12;
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    std::atomic<bool> stop{false};
    std::atomic<int> finished{0}, unwanted{0};
    std::vector<std::thread> callers;
    for (int i = 0; i < 2; ++i)
      callers.emplace_back([&] {
        while (!stop) {
          if (auto job = sim.streamer.takeJob()) {
            unwanted += !sim.streamer.jobWanted(*job);
            sim.streamer.finishJob(*job);
            ++finished;
          } else {
            std::this_thread::yield();
          }
        }
      });
    std::mt19937_64 random(4);
    for (int i = 0; i < 200 && !HasFatalFailure(); ++i) {
      auto x = static_cast<uint32_t>(random() % 12), y = static_cast<uint32_t>(random() % 12);
      if (i % 2) sim.texture = square(4, x, y, 1 + random() % 4);
      if (i % 3) sim.predicted = square(4, y, x, 1 + random() % 4);
      if (i % 5 == 0) sim.relief = square(4, x, x, 2);
      if (i % 7 == 0) sim.streamer.setLight(frontLight(0.001 * i, 0.3));
      sim.step();
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    }
    stop = true;
    for (std::thread& t : callers) t.join();
    EXPECT_GT(finished, 0);
    sim.predicted.clear();
    sim.frame_s = 0.5;
    do {
      sim.step();
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    } while (!HasFatalFailure() && !sim.streamer.settled());
    for (const NodeRequest& w : sim.texture) EXPECT_TRUE(sim.shown(w.node));
  }
}

}  // namespace streamer_threads_test
}  // namespace relievo
