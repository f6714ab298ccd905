// The streamer on a simulated clock: order of service, prefetching, cancellation, counters, the states of a page.
#include "tests/texturing/page_simulation.h"

#include <cctype>
#include <cmath>
#include <fstream>
#include <sstream>

namespace relievo {
namespace page_life_test {

using namespace fake;

PageId page0(NodeId node) { return PageId(texturePlane(0), node); }

// --- states ---

TEST(StreamerStates, EveryLegalChangeOccursAndNoOther) {
  std::array<std::array<uint64_t, kPageStates>, kPageStates> seen{};
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    auto failing = std::make_shared<FailingSource>(
        std::make_shared<ProceduralSource>([](PageId id) { return id.node().level < 5; }),
        FailingSource::Rates{.fail = 0.2, .truncate = 0.05, .corrupt = 0.05}, seed);
    bool fixed_light = seed % 2 == 0;
    auto options = Simulation::options(40 + random() % 100, fixed_light ? std::vector{Plane::kResolved} : kThreePlanes);
    options.ready_limit = 1 + random() % 20;
    Simulation sim(failing, options);
    sim.texels_matter = !fixed_light;
    sim.streamer.pinRoots({{kRoot}}, {{kRoot}});
    sim.delay_s = [&](PageId) { return 0.001 * static_cast<double>(random() % 100); };
    for (int i = 0; i < 300 && !HasFatalFailure(); ++i) {
      auto x = static_cast<uint32_t>(random() % 12), y = static_cast<uint32_t>(random() % 12);
      if (random() % 3 == 0) sim.texture = square(4, x, y, 1 + random() % 4);
      if (random() % 3 == 0) sim.relief = square(4, x, y, 1 + random() % 3);
      if (random() % 3 == 0) sim.predicted = square(4, x, y, 1 + random() % 4);
      if (random() % 20 == 0) sim.texture = square(5, x, y, 1);
      if (random() % 10 == 0) sim.streamer.setLight(frontLight(0.001 * i, 0.1));
      sim.max_uploads = random() % 12;
      sim.step();
    }
    const auto& moves = sim.streamer.stats().moves;
    for (size_t from = 0; from < kPageStates; ++from)
      for (size_t to = 0; to < kPageStates; ++to) seen[from][to] += moves[from][to];
  }
  for (size_t from = 0; from < kPageStates; ++from)
    for (size_t to = 0; to < kPageStates; ++to) {
      auto a = static_cast<PageState>(from), b = static_cast<PageState>(to);
      bool rare = a == PageState::kFailed && b == PageState::kAbsent;  // only beyond 65,536 failures
      EXPECT_TRUE(rare || (seen[from][to] > 0) == isLegal(a, b))
          << kPageStateNames[from] << " -> " << kPageStateNames[to];
    }
}

// Every arrow of the diagram is in the table, and the other way round.
TEST(StreamerStates, TheDiagramInTheReadmeIsTheTable) {
  std::ifstream readme(RELIEVO_PAGE_LIFE);
  ASSERT_TRUE(readme) << RELIEVO_PAGE_LIFE;
  auto stateOf = [](std::string name) {
    if (!name.empty()) name[0] = static_cast<char>(std::tolower(name[0]));
    return std::find(kPageStateNames.begin(), kPageStateNames.end(), name) - kPageStateNames.begin();
  };
  std::set<std::pair<long, long>> drawn, table;
  std::string line;
  bool inside = false;
  while (std::getline(readme, line)) {
    if (line.starts_with("```")) inside = line == "```mermaid";
    std::istringstream words(line);
    std::string from, arrow, to;
    if (!inside || !(words >> from >> arrow >> to) || arrow != "-->" || from == "[*]") continue;
    if (to.ends_with(':')) to.pop_back();
    ASSERT_LT(stateOf(from), static_cast<long>(kPageStates)) << line;
    ASSERT_LT(stateOf(to), static_cast<long>(kPageStates)) << line;
    drawn.insert({stateOf(from), stateOf(to)});
  }
  for (const PageTransition& t : kPageTransitions) table.insert({static_cast<long>(t.from), static_cast<long>(t.to)});
  EXPECT_EQ(drawn, table);
}

TEST(StreamerStates, FailuresAreForgottenBeyondABound) {
  Simulation sim(std::make_shared<ProceduralSource>([](PageId) { return false; }),
                 Simulation::options(65535, {texturePlane(0)}));
  sim.in_flight = 4096;
  sim.delay_s = [](PageId) { return 0.0; };
  uint32_t patch = 0;
  auto failed = [&] {
    uint64_t n = 0;
    for (uint64_t of : sim.streamer.stats().pages[static_cast<size_t>(PageState::kFailed)]) n += of;
    return n;
  };
  uint64_t most = 0;
  auto moves = [&] { return sim.streamer.stats().moves; };
  while (moves()[static_cast<size_t>(PageState::kFailed)][0] == 0 && patch < 400000) {
    sim.texture.clear();
    for (int i = 0; i < 4000; ++i) sim.texture.push_back({{patch++, 0, 0, 0}, 1, 0.f});
    sim.streamer.beginFrame(++sim.frame, 0);
    sim.streamer.requestTexture(sim.texture);
    sim.streamer.placeReady(0);
    sim.work();
    most = std::max(most, failed());
  }
  EXPECT_LT(patch, 400000u) << "never forgotten";
  EXPECT_LE(most, 65536u + 3 * 4000u);
  EXPECT_EQ(stateCountError(sim.streamer.stats()), "");
}

TEST(StreamerStates, TheCheckSeesAnIllegalChangeAndALostPage) {
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(64));
  sim.texture = square(2, 0, 0, 2);
  ASSERT_TRUE(sim.settle(100));
  StreamerStats s = sim.streamer.stats();
  ASSERT_EQ(stateCountError(s), "");
  StreamerStats skipped = s;
  ++skipped.moves[static_cast<size_t>(PageState::kQueued)][static_cast<size_t>(PageState::kResident)];
  EXPECT_NE(stateCountError(skipped), "");
  StreamerStats lost = s;
  --lost.pages[static_cast<size_t>(PageState::kResident)][0];
  EXPECT_NE(stateCountError(lost), "");
}

// --- order of service ---

// --- room for relief ---

// Relief of all forms, by the page's name: noise, which is plain; a little noise, which is compact; flat, which is
// compact in 32 cells. share: of a hundred pages, the plain ones.
SlotDecoder formsDecoder(uint32_t share) {
  return [share](Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) -> Result<void> {
    if (auto done = fakeDecode(plane, encoded, texels); !done || plane != Plane::kRelief) return done;  // noise
    PageId id;
    std::memcpy(&id.bits, encoded.data(), 8);
    const uint64_t form = mix(id.bits) % 100;
    if (form < share) return {};
    for (size_t i = 0; i < texels.size(); i += 4) {
      texels[i] = 1;
      texels[i + 1] &= form % 2 == 0 ? 7 : 0;
    }
    return {};
  };
}
StreamerOptions formsOptions(uint32_t slots) {
  StreamerOptions options = Simulation::options(slots, {texturePlane(0)});
  options.relief_parts = ReliefParts::kCompact;
  return options;
}
uint64_t inVain(const Simulation& sim) { return sim.streamer.stats().cancelled; }

// Half a slot is counted for a page that is to come, and whatever form it then has, it is placed: nothing is read in
// vain.
TEST(StreamerRoom, ReliefOfEveryFormFindsWhatWasCountedForIt) {
  for (uint32_t share : {0u, 30u, 70u, 100u})
    for (uint32_t slots : {1u, 2u, 5u, 16u}) {
      const std::string what = std::to_string(share) + " % plain, " + std::to_string(slots) + " slots";
      Simulation sim(std::make_shared<ProceduralSource>(), formsOptions(slots), formsDecoder(share));
      sim.texels_matter = false;
      sim.in_flight = 5;
      for (uint32_t i = 0; i < 2 * slots; ++i)
        sim.relief.push_back({{0, 10, i, 0}, 1, 0.1f * static_cast<float>(i % 7)});
      EXPECT_TRUE(sim.settle(600)) << what;
      ASSERT_FALSE(HasFatalFailure()) << what;
      EXPECT_EQ(sim.streamer.residentRelief().size(), 2 * slots) << what;
      EXPECT_EQ(sim.taken.size(), 2 * slots) << what << ": each is read once";
      EXPECT_EQ(inVain(sim), 0u) << what;
    }
}

// More pages than fit, of a cache that is empty: compact ones come to share slots in three all the same.
TEST(StreamerRoom, CompactPagesShareSlotsUnderPressure) {
  constexpr uint32_t kSlots = 12;
  for (uint32_t share : {0u, 50u, 100u}) {
    Simulation sim(std::make_shared<ProceduralSource>(), formsOptions(kSlots), formsDecoder(share));
    sim.texels_matter = false;
    for (uint32_t i = 0; i < 8 * kSlots; ++i) sim.relief.push_back({{0, 10, i, 0}, 1, 0});
    for (int i = 0; i < 200; ++i) sim.step();
    ASSERT_FALSE(HasFatalFailure());
    const auto resident = static_cast<uint32_t>(sim.streamer.residentRelief().size());
    if (share == 0) {
      EXPECT_GE(resident, 5 * kSlots / 2) << "of pages that are all compact";
    }
    if (share == 50) {
      EXPECT_GT(resident, 2 * kSlots);
    }
    if (share == 100) {
      EXPECT_EQ(resident, 2 * kSlots);
    }
    EXPECT_EQ(inVain(sim), 0u) << share << " % plain";
  }
}

// Whatever was resident before: views that change, with texture, that fit or not. Each is read for what it has room
// for, and ends still.
TEST(StreamerRoom, ViewsOfReliefOfEveryFormEndStill) {
  uint64_t thirds = 0, halves = 0, deferred = 0;
  for (uint64_t seed = 1; seed <= 60; ++seed) {
    std::mt19937_64 random(seed);
    auto upTo = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
    const uint32_t slots = 3 + upTo(24);
    Simulation sim(std::make_shared<ProceduralSource>(), formsOptions(slots), formsDecoder(10 * upTo(11)));
    sim.texels_matter = false;
    for (int view = 0; view < 8; ++view) {
      const std::string what = "seed " + std::to_string(seed) + ", view " + std::to_string(view);
      sim.relief.clear();
      sim.texture.clear();
      for (int i = 0; i < 40; ++i) sim.step();  // what was under way comes to its end
      const uint64_t vain = inVain(sim);
      sim.taken.clear();
      for (uint32_t i = upTo(3 * slots); i > 0; --i) sim.relief.push_back({{0, 10, upTo(6 * slots), 0}, 1, 0});
      for (uint32_t i = upTo(slots / 2 + 1); i > 0; --i) sim.texture.push_back({{0, 10, upTo(3 * slots), 0}, 1, 0});
      EXPECT_TRUE(sim.settle(400)) << what;
      ASSERT_FALSE(HasFatalFailure()) << what;
      EXPECT_EQ(inVain(sim), vain) << what << ": read, and no room for it";
      EXPECT_EQ(std::set(sim.taken.begin(), sim.taken.end()).size(), sim.taken.size()) << what << ": read twice";
      const SubslotCache& cache = sim.streamer.cache(Plane::kRelief);
      for (const NodeId& node : sim.streamer.residentRelief())
        ++(isThird(partOf(cache.find(PageId(Plane::kRelief, node))).level) ? thirds : halves);
      deferred += sim.streamer.stats().deferred;
    }
  }
  EXPECT_GT(thirds, 1500u);
  EXPECT_GT(halves, 1500u);
  EXPECT_GT(deferred, 300u);
}

TEST(StreamerTiers, WantedThenPredictedThenRecent) {
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(256, {texturePlane(0)}));
  sim.in_flight = 0;
  NodeId recent{0, 1, 0, 0}, now_fine{0, 6, 1, 1}, now_coarse{0, 5, 2, 2}, soon_near{0, 2, 0, 0}, soon_far{0, 2, 3, 3},
      both{0, 7, 0, 0};
  sim.texture = {{recent, 1, 0.f}, {both, 1, 0.9f}};
  sim.step();
  sim.texture = {{now_fine, 1, 0.f}, {now_coarse, 1, 0.5f}};
  sim.predicted = {{soon_far, 0, 0.8f}, {soon_near, 0, 0.1f}, {both, 0, 0.f}};
  sim.step();
  std::vector<NodeId> order;
  for (int i = 0; i < 6; ++i) {
    auto job = sim.streamer.takeJob();
    ASSERT_TRUE(job) << i;
    order.push_back(job->id.node());
    sim.streamer.finishJob(*job);
  }
  EXPECT_FALSE(sim.streamer.takeJob());
  EXPECT_EQ(order, (std::vector<NodeId>{now_coarse, now_fine, soon_near, soon_far, both, recent}));
}

TEST(StreamerTiers, PrefetchingLeavesHalfOfTheBuffersToWhatIsWanted) {
  auto options = Simulation::options(512, {texturePlane(0)});
  options.ready_limit = 10;
  Simulation sim(std::make_shared<ProceduralSource>(), options);
  sim.in_flight = 100;
  sim.delay_s = [](PageId) { return 1e9; };
  sim.predicted = square(4, 0, 0, 6);
  sim.run(3);
  EXPECT_EQ(sim.taken.size(), 5u);
  sim.texture = square(4, 8, 8, 6);
  sim.run(3);
  EXPECT_EQ(sim.taken.size(), 10u);
  for (size_t i = 5; i < 10; ++i) {
    NodeId node = sim.taken[i].node();
    EXPECT_TRUE(
        std::any_of(sim.texture.begin(), sim.texture.end(), [&](const NodeRequest& w) { return w.node == node; }));
  }
}

// --- prefetching ---

TEST(StreamerPrefetch, WhatBecomesWantedIsNotReadAgainAndWhatDoesNotIsCounted) {
  auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
  Simulation sim(record, Simulation::options(256));
  sim.texture = square(4, 0, 0, 2);
  ASSERT_TRUE(sim.settle(100));
  size_t before = record->reads().size();
  sim.predicted = square(4, 8, 8, 2);
  sim.run(30);
  EXPECT_TRUE(sim.streamer.settled());
  size_t fresh = record->reads().size() - before;
  EXPECT_EQ(fresh, 3u * 7) << "4 nodes and 3 ancestors of three planes; the root was there";
  const StreamerStats& s = sim.streamer.stats();
  EXPECT_EQ(s.prefetched, fresh);
  EXPECT_EQ(s.prefetch_used, 0u);
  for (const NodeRequest& w : sim.predicted) EXPECT_TRUE(sim.streamer.table().find(w.node)) << "ready to be shown";
  uint64_t hits = s.hits, misses = s.misses;
  sim.texture = sim.predicted;
  sim.predicted.clear();
  sim.step();
  EXPECT_EQ(record->reads().size(), before + fresh);
  EXPECT_EQ(sim.streamer.stats().prefetch_used, fresh);
  EXPECT_EQ(sim.streamer.stats().hits - hits, 3 * sim.texture.size());
  EXPECT_EQ(sim.streamer.stats().misses, misses);

  // Wanted while it is under way: the same read serves.
  sim.in_flight = 1;
  sim.delay_s = [](PageId) { return 0.1; };
  NodeId node{0, 5, 30, 0};
  sim.predicted = {{node, 0, 0.f}};
  sim.run(2);
  ASSERT_EQ(sim.streamer.state(page0(node)), PageState::kDecoding);
  sim.texture.push_back({node, 1, 0.f});
  sim.predicted.clear();
  ASSERT_TRUE(sim.settle(100));
  auto reads = record->reads();
  EXPECT_EQ(std::count(reads.begin(), reads.end(), page0(node)), 1);
  EXPECT_EQ(sim.streamer.stats().prefetch_used, fresh + 1) << "the other two planes were only queued: not prefetched";
  EXPECT_EQ(sim.streamer.stats().prefetch_wasted, 0u);
}

TEST(StreamerPrefetch, WhatIsNoLongerPredictedIsCancelledBeforeItIsRead) {
  auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
  Simulation sim(record, Simulation::options(256, {texturePlane(0)}));
  sim.in_flight = 0;
  sim.predicted = square(4, 8, 8, 2);
  sim.step();
  EXPECT_EQ(sim.streamer.stats().queued, sim.predicted.size());
  auto job = sim.streamer.takeJob();
  ASSERT_TRUE(job);
  EXPECT_TRUE(sim.streamer.jobWanted(*job));
  size_t asked = sim.predicted.size();
  sim.predicted.clear();
  sim.step();
  EXPECT_FALSE(sim.streamer.jobWanted(*job)) << "the first list that does not name it";
  EXPECT_EQ(sim.streamer.stats().cancelled_before_read, asked - 1);
  sim.streamer.finishJob(*job);
  sim.step();
  EXPECT_EQ(sim.streamer.stats().cancelled_before_read, asked);
  EXPECT_EQ(record->reads().size(), 0u);
  EXPECT_EQ(sim.streamer.stats().prefetched, 1u);
  EXPECT_EQ(sim.streamer.stats().prefetch_wasted, 1u);
  EXPECT_TRUE(sim.streamer.settled());
}

// A camera that drifts in a small cache, with predictions that are often wrong. A page that a prefetched one drives out
// must not have been wanted in the last kSparedFrames frames.
int recentEvictions(bool as_requests) {
  int recent = 0;
  std::mt19937_64 random(5);
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(120, {texturePlane(0)}));
  sim.texels_matter = false;
  sim.delay_s = [](PageId) { return 0.0; };
  std::map<PageId, uint64_t> last_wanted;
  std::set<PageId> there;
  for (int i = 0; i < 1500 && !::testing::Test::HasFatalFailure(); ++i) {
    auto x = static_cast<uint32_t>(20 + 15 * std::sin(i * 0.02)),
         y = static_cast<uint32_t>(20 + 15 * std::cos(i * 0.03));
    auto view = square(6, x, y, 4);
    auto guess = square(6, static_cast<uint32_t>(random() % 60), static_cast<uint32_t>(random() % 60), 3);
    sim.texture = view;
    std::set<PageId> wanted;
    for (const NodeRequest& w : view) last_wanted[page0(w.node)] = sim.frame + 1, wanted.insert(page0(w.node));
    if (as_requests) {
      sim.texture.insert(sim.texture.end(), guess.begin(), guess.end());
    } else {
      sim.predicted = guess;
    }
    sim.step();
    std::set<PageId> now;
    sim.streamer.cache().forEach([&](PageId id) { now.insert(id); });
    bool only_guesses =
        std::none_of(sim.uploaded.begin(), sim.uploaded.end(), [&](PageId id) { return wanted.count(id); });
    for (PageId id : there) {
      if (now.count(id) || !only_guesses) continue;
      auto it = last_wanted.find(id);
      recent += it != last_wanted.end() && it->second + kSparedFrames > sim.frame;
    }
    there = std::move(now);
  }
  const StreamerStats& s = sim.streamer.stats();
  EXPECT_GT(s.evictions, 500u);
  if (!as_requests) {
    EXPECT_GT(s.prefetched, 500u);
    EXPECT_GE(s.prefetched, s.prefetch_used + s.prefetch_wasted);
    EXPECT_LE(s.prefetched, s.prefetch_used + s.prefetch_wasted + 120 + 64) << "the rest is there or under way";
    EXPECT_EQ(s.deferred, 0u);
  }
  return recent;
}
TEST(StreamerPrefetch, NeverEvictsWhatWasWantedInTheLastFrames) { EXPECT_EQ(recentEvictions(false), 0); }
TEST(StreamerPrefetch, TheCheckSeesPredictionsThatPoseAsRequests) { EXPECT_GT(recentEvictions(true), 0); }

// What is wanted arrives as it would without prefetching.
TEST(StreamerPrefetch, DoesNotDisplaceWhatIsWanted) {
  auto run = [](bool prefetch) {
    std::mt19937_64 random(9);
    Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(150, {texturePlane(0)}));
    sim.texels_matter = false;
    sim.delay_s = [](PageId) { return 0.0; };
    uint64_t missing = 0;
    for (int i = 0; i < 800; ++i) {
      sim.texture = square(6, static_cast<uint32_t>(i / 16), 20, 5);  // never where it was
      auto guess = square(6, static_cast<uint32_t>(random() % 60), static_cast<uint32_t>(random() % 60), 6);
      if (prefetch) sim.predicted = guess;
      sim.step();
      missing += sim.texture.size() - sim.wantedResident().size();
    }
    return missing;
  };
  uint64_t with = run(true), without = run(false);
  EXPECT_GT(without, 0u);
  EXPECT_LE(with, without) << "a guess may be right";
}

TEST(StreamerPrefetch, HasNoRoomUnderPressure) {
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(40, {texturePlane(0)}));
  sim.predicted = square(6, 40, 40, 3);
  sim.texture = square(4, 0, 0, 8);  // deaf to the bias
  sim.run(100);
  EXPECT_GT(sim.streamer.detailBias(), 0);
  EXPECT_EQ(sim.streamer.stats().prefetched, 0u);
  sim.texture = square(4, 0, 0, 2);
  sim.run(100);
  EXPECT_EQ(sim.streamer.detailBias(), 0);
  EXPECT_GT(sim.streamer.stats().prefetched, 0u) << "and some when it is over";
}

// --- cancellation ---

// What a source does between being asked and answering.
class HookedSource : public PageSource {
 public:
  explicit HookedSource(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  std::function<void(PageId)> on_read;
  Result<EncodedPage> read(PageId id) const override {
    if (on_read) on_read(id);
    return inner_->read(id);
  }

 private:
  std::shared_ptr<const PageSource> inner_;
};

TEST(StreamerCancellation, BeforeReadingBeforeDecodingAndAfter) {
  auto hooked = std::make_shared<HookedSource>(std::make_shared<ProceduralSource>());
  Simulation sim(hooked, Simulation::options(64, {texturePlane(0)}));
  sim.in_flight = 0;
  auto away = [&] {  // two lists without it
    sim.texture = {{{9, 0, 0, 0}, 1, 0.f}};
    sim.run(2);
  };
  auto jobFor = [&](NodeId node) {
    sim.texture = {{node, 1, 0.f}};
    sim.step();
    auto job = sim.streamer.takeJob();
    EXPECT_TRUE(job && job->id == page0(node));
    return *job;
  };
  const StreamerStats& s = sim.streamer.stats();
  NodeId a{1, 0, 0, 0}, b{2, 0, 0, 0}, c{3, 0, 0, 0}, d{4, 0, 0, 0};

  PageJob before_read = jobFor(a);
  sim.texture.clear();
  sim.step();
  EXPECT_TRUE(sim.streamer.jobWanted(before_read)) << "it is in the list before the newest";
  sim.step();
  EXPECT_FALSE(sim.streamer.jobWanted(before_read));
  sim.streamer.finishJob(before_read);
  sim.step();
  EXPECT_EQ(s.pages_read[0], 0u);
  EXPECT_EQ(sim.streamer.stats().cancelled_before_read, 1u);
  EXPECT_EQ(sim.streamer.state(page0(a)), PageState::kAbsent);

  PageJob before_decode = jobFor(b);
  hooked->on_read = [&](PageId) { away(); };
  sim.streamer.finishJob(before_decode);
  hooked->on_read = {};
  sim.step();
  EXPECT_EQ(sim.streamer.stats().cancelled_before_decode, 1u);
  EXPECT_EQ(s.pages_read[0], 1u);
  EXPECT_EQ(s.pages_decoded[0], 0u);

  // Decoded, and no longer wanted when there is no upload left for it: dropped. With one to spare, it is placed.
  for (NodeId node : {c, d}) {
    auto next = sim.streamer.takeJob();  // what away() wanted
    if (next) sim.streamer.finishJob(*next);
    PageJob late = jobFor(node);
    sim.streamer.finishJob(late);
    sim.max_uploads = 0;
    sim.texture.clear();
    sim.step();
    if (node == d) sim.max_uploads = 8;
    sim.step();
    EXPECT_EQ(sim.streamer.state(page0(node)), node == d ? PageState::kResident : PageState::kAbsent);
    sim.max_uploads = 64;
  }
  EXPECT_GE(sim.streamer.stats().cancelled_after_decode, 1u);
  EXPECT_EQ(s.cancelled, s.cancelled_before_read + s.cancelled_before_decode + s.cancelled_after_decode);
}

TEST(StreamerCancellation, WantedAgainInTimeIsNotCancelled) {
  auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
  Simulation sim(record, Simulation::options(64, {texturePlane(0)}));
  sim.in_flight = 0;
  NodeId node{1, 0, 0, 0};
  sim.texture = {{node, 1, 0.f}};
  sim.step();
  PageJob job = *sim.streamer.takeJob();
  auto requested = std::exchange(sim.texture, {});
  sim.run(3);
  EXPECT_FALSE(sim.streamer.jobWanted(job));
  sim.texture = requested;
  sim.step();
  EXPECT_TRUE(sim.streamer.jobWanted(job));
  sim.streamer.finishJob(job);
  sim.step();
  EXPECT_EQ(sim.streamer.state(page0(node)), PageState::kResident);
  EXPECT_EQ(record->reads().size(), 1u);
}

// --- counters ---

TEST(StreamerCounters, AddUp) {
  auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
  Simulation sim(record, Simulation::options(64));
  sim.texture = square(2, 0, 0, 2);  // 4 + 1 + 1 nodes of 3 planes
  sim.relief = {{kRoot, 1, 0.f}};
  sim.in_flight = 0;
  sim.step();
  const StreamerStats& s = sim.streamer.stats();
  EXPECT_EQ(s.misses, 19u);
  EXPECT_EQ(s.hits, 0u);
  EXPECT_EQ(s.wanted, 19u);
  EXPECT_EQ(s.pages[static_cast<size_t>(PageState::kQueued)][0], 6u);
  EXPECT_EQ(s.pages[static_cast<size_t>(PageState::kQueued)][8], 1u);
  auto job = sim.streamer.takeJob();
  sim.streamer.beginFrame(++sim.frame, sim.now_s);
  EXPECT_EQ(sim.streamer.stats().decoding, 1u);
  sim.streamer.finishJob(*job);
  sim.streamer.beginFrame(++sim.frame, sim.now_s);
  EXPECT_EQ(sim.streamer.stats().ready, 1u);
  EXPECT_EQ(s.misses, 19u) << "no new list";
  sim.in_flight = 8;
  ASSERT_TRUE(sim.settle(100));
  uint64_t hits = sim.streamer.stats().hits;
  sim.step();
  sim.streamer.stats();
  EXPECT_EQ(s.hits, hits + 19) << "each page once a list";
  for (size_t p : {0, 1, 2, 8}) {
    uint64_t pages = p == 8 ? 1 : 6;
    EXPECT_EQ(s.pages[static_cast<size_t>(PageState::kResident)][p], pages);
    EXPECT_EQ(s.bytes_read[p], 24 * pages);
    EXPECT_EQ(s.bytes_decoded[p], kSlotBytes * pages);
    EXPECT_EQ(s.bytes_uploaded[p], (p == 8 ? kSlotBytes / 2 : kSlotBytes) * pages);
  }
  EXPECT_EQ(s.latency_ms.count, 19u);
  EXPECT_EQ(s.detail_bias, 0);
}

TEST(StreamerCounters, LatencyIsThatOfTheLink) {
  Simulation sim(std::make_shared<ProceduralSource>(), Simulation::options(600, {texturePlane(0)}));
  sim.in_flight = 600;
  sim.delay_s = [](PageId id) { return id.node().x % 10 == 0 ? 0.495 : 0.049; };  // a tenth takes 30 frames, the rest 3
  sim.texture.clear();
  for (uint32_t i = 0; i < 60; ++i) sim.texture.push_back({{0, 10, i, 0}, 1, 0.f});
  sim.run(60);
  LatencySummary frames = sim.streamer.stats().latency_frames, ms = sim.streamer.stats().latency_ms;
  EXPECT_EQ(frames.count, 60u);
  // Taken after the frame that wants it, done in the work of the third, placed in the fourth.
  EXPECT_EQ(frames.p50, 4);
  EXPECT_EQ(frames.p90, 4);
  EXPECT_EQ(frames.p99, 31);
  EXPECT_EQ(frames.max, 31);
  EXPECT_NEAR(ms.p50, 4000.0 / 60, 4000.0 / 60 / 16);
  EXPECT_NEAR(ms.max, 31000.0 / 60, 0.01);
}

TEST(StreamerCounters, PercentilesAreThoseOfTheSortedSeries) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(seed);
    LatencyHistogram h;
    std::vector<uint64_t> all;
    for (int i = 0; i < 2000; ++i) {
      all.push_back(random() >> (32 + random() % 32));
      h.add(all.back());
    }
    std::sort(all.begin(), all.end());
    for (double share : {0.01, 0.5, 0.9, 0.99, 1.0}) {
      auto exact = static_cast<double>(all[static_cast<size_t>(std::ceil(share * 2000)) - 1]);
      auto said = static_cast<double>(h.percentile(share));
      EXPECT_GE(said, exact);
      EXPECT_LE(said, exact * (1 + 1.0 / 16));
    }
    EXPECT_EQ(h.max(), all.back());
  }
  LatencyHistogram empty;
  EXPECT_EQ(empty.percentile(0.5), 0u);
  for (uint64_t huge : {uint64_t{1} << 32, ~uint64_t{0}}) {
    LatencyHistogram h;
    h.add(huge);
    EXPECT_EQ(h.percentile(0.99), huge);
  }
}

}  // namespace page_life_test
}  // namespace relievo
