// The life of a page: invariants that hold in every frame, whatever the threads do.
#include "texturing/stream/page_streamer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <unordered_map>

#include "tests/texturing/fake_sources.h"
#include "texturing/codec/resolve.h"

namespace relievo {
namespace page_streamer_test {

using namespace fake;

const std::vector<Plane> kThreePlanes{texturePlane(0), texturePlane(1), texturePlane(2)};
const NodeId kRoot{0, 0, 0, 0};

std::vector<NodeRequest> withAncestors(const std::vector<NodeId>& nodes) {
  std::vector<NodeId> all;
  for (NodeId n : nodes)
    for (uint32_t l = 0; l <= n.level; ++l) all.push_back(n.ancestor(l));
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  std::stable_sort(all.begin(), all.end(), [](const NodeId& a, const NodeId& b) { return a.level < b.level; });
  std::vector<NodeRequest> requests;
  for (const NodeId& n : all) requests.push_back({n, 1, 0.5f});
  return requests;
}
std::vector<NodeRequest> square(uint32_t level, uint32_t x, uint32_t y, uint32_t size) {
  std::vector<NodeId> nodes;
  for (uint32_t j = 0; j < size; ++j)
    for (uint32_t i = 0; i < size; ++i) nodes.push_back({0, level, x + i, y + j});
  return withAncestors(nodes);
}

// A streamer with the page pool and table that a renderer would have, and the invariants of every frame.
struct Rig {
  std::shared_ptr<const PageSource> source;
  PageStreamer streamer;
  std::vector<Plane> planes;
  std::vector<PageId> pool;  // what was uploaded into each slot
  uint64_t frame = 0;
  double now_s = 0;
  double frame_s = 1.0 / 60;
  uint32_t max_uploads = 16;
  bool check_texels = true;
  std::vector<NodeRequest> texture, relief;
  std::vector<std::string> messages;

  Rig(std::shared_ptr<const PageSource> s, StreamerOptions options, SlotDecoder decoder = fakeDecode)
      : source(s), streamer(s, options, std::move(decoder)), planes(options.texture_planes), pool(options.slot_count) {}

  void upload(std::span<const PageUpload> uploads) {
    for (const PageUpload& u : uploads) {
      const SlotPart part = partOf(u.slot);
      ASSERT_LT(part.slot, pool.size());
      ASSERT_EQ(part.level > 0, u.id.plane() == Plane::kRelief);
      ASSERT_EQ(streamer.cache().pageIn(u.slot), u.id);
      ASSERT_TRUE(!check_texels || texelsAreOf(u.id, u.texels)) << "the texels of another page";
      pool[part.slot] = part.level == 0 ? u.id : PageId();
    }
  }
  void step() {
    streamer.beginFrame(++frame, now_s += frame_s);
    streamer.requestTexture(texture);
    if (!relief.empty()) streamer.requestRelief(relief);
    std::vector<PageId> before;
    for (const NodeRequest& w : texture)
      for (Plane p : planes)
        if (streamer.state(PageId(p, w.node)) == PageState::kResident) before.push_back(PageId(p, w.node));
    for (const NodeRequest& w : relief)
      if (streamer.findRelief(w.node) != kNoSlot) before.push_back(PageId(Plane::kRelief, w.node));
    auto uploads = streamer.placeReady(max_uploads);
    upload(uploads);
    std::string why;
    ASSERT_TRUE(streamer.cache().checkInvariants(&why)) << why;
    for (PageId id : before) ASSERT_EQ(streamer.state(id), PageState::kResident) << "wanted now, yet evicted";
    for (auto& m : streamer.takeMessages()) messages.push_back(m);
  }
  // What a shader would read is what was uploaded: the first difference, or nothing.
  std::string tableError(const std::vector<NodeRequest>& nodes, const std::vector<Plane>& of) {
    for (const NodeRequest& w : nodes) {
      bool whole = true;
      for (Plane p : of) whole = whole && streamer.cache().find(PageId(p, w.node)) != kNoSlot;
      auto entry = streamer.table().find(w.node);
      if (entry.has_value() != whole) return whole ? "a whole node is not entered" : "half a node is entered";
      if (!entry) continue;
      for (size_t i = 0; i < of.size(); ++i)
        if (pool[entry->slots[i]] != PageId(of[i], w.node)) return "a slot holds another page";
    }
    return {};
  }
  // Frames until settled; the test program's time limit ends a run that never is.
  int settle() {
    int frames = 0;
    do {
      step();
      if (::testing::Test::HasFatalFailure()) return frames;
      ++frames;
      std::this_thread::sleep_for(std::chrono::microseconds(50));
    } while (!streamer.settled());
    return frames;
  }
};

StreamerOptions threePlanes(uint32_t slots, int workers = 2) {
  StreamerOptions o;
  o.slot_count = slots;
  o.workers = workers;
  o.texture_planes = kThreePlanes;
  o.format.basis = Basis::kPtmLrgb;
  return o;
}

TEST(PageStreamer, LoadsWhatIsWantedAndEntersWholeNodesOnly) {
  Rig rig(std::make_shared<ProceduralSource>(), threePlanes(256));
  rig.streamer.pinRoots({{kRoot}}, {});
  rig.texture = square(3, 2, 2, 3);
  rig.max_uploads = 1;  // so that nodes are half resident for a while
  while (!rig.streamer.settled() || rig.frame == 0) {
    rig.step();
    ASSERT_FALSE(HasFatalFailure());
    ASSERT_EQ(rig.tableError(rig.texture, kThreePlanes), "");
    ASSERT_TRUE(rig.streamer.table().find(kRoot)) << "a look-up must end somewhere";
  }
  for (const NodeRequest& w : rig.texture) EXPECT_TRUE(rig.streamer.table().find(w.node));
  const StreamerStats& s = rig.streamer.stats();
  for (int p = 0; p < 3; ++p) {
    EXPECT_EQ(s.pages_read[p], rig.texture.size());
    EXPECT_EQ(s.pages_uploaded[p], rig.texture.size());
    EXPECT_EQ(s.bytes_read[p], 24 * rig.texture.size());
  }
  EXPECT_EQ(s.pages_read[8], 0u);
  EXPECT_EQ(s.evictions, 0u);
  EXPECT_EQ(s.resident, 3 * rig.texture.size());
  EXPECT_TRUE(rig.messages.empty());
}

TEST(PageStreamer, TheTableCheckSeesAWrongSlot) {
  Rig rig(std::make_shared<ProceduralSource>(), threePlanes(64));
  rig.texture = square(1, 0, 0, 2);
  rig.settle();
  ASSERT_EQ(rig.tableError(rig.texture, kThreePlanes), "");
  std::swap(rig.pool[3], rig.pool[4]);
  EXPECT_NE(rig.tableError(rig.texture, kThreePlanes), "");
  std::swap(rig.pool[3], rig.pool[4]);
  rig.streamer.table().erase(kRoot);
  EXPECT_NE(rig.tableError(rig.texture, kThreePlanes), "");
}

// --- order of service ---

TEST(PageStreamer, NewestListFirstThenCoarseBeforeFineThenNearTheCentre) {
  auto gate = std::make_shared<GatedSource>(std::make_shared<ProceduralSource>());
  auto record = std::make_shared<RecordingSource>(gate);
  StreamerOptions options = threePlanes(256, 1);
  options.texture_planes = {texturePlane(0)};
  Rig rig(record, options);
  rig.texture = {{{1, 0, 0, 0}, 1, 0.f}};
  rig.step();
  gate->waitForReaders(1);  // the only worker is busy; what follows waits in the queue
  rig.texture = {{{1, 0, 0, 0}, 1, 0.f}, {{0, 5, 0, 0}, 1, 0.1f}, {{0, 2, 0, 0}, 1, 0.9f}};
  rig.step();
  rig.texture = {{{0, 4, 3, 3}, 1, 0.7f}, {{0, 3, 1, 1}, 1, 0.8f}, {{0, 4, 1, 1}, 1, 0.2f}, {{0, 3, 2, 1}, 1, 0.3f}};
  rig.step();
  gate->open();
  rig.texture.clear();
  for (int i = 0; i < 1000 && record->reads().size() < 7; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  std::vector<NodeId> order;
  for (PageId id : record->reads()) order.push_back(id.node());
  std::vector<NodeId> expected{{1, 0, 0, 0}, {0, 3, 2, 1}, {0, 3, 1, 1}, {0, 4, 1, 1},
                               {0, 4, 3, 3}, {0, 2, 0, 0}, {0, 5, 0, 0}};
  EXPECT_EQ(order, expected);
}

TEST(PageStreamer, WhatTheNewestTwoListsDoNotRequestIsNeverRead) {
  auto gate = std::make_shared<GatedSource>(std::make_shared<ProceduralSource>());
  auto record = std::make_shared<RecordingSource>(gate);
  Rig rig(record, threePlanes(256, 1));
  rig.texture = square(4, 0, 0, 4);
  rig.step();
  gate->waitForReaders(1);
  auto old_list = rig.texture;
  rig.texture = {{{9, 0, 0, 0}, 1, 0.f}};
  rig.step();
  EXPECT_EQ(rig.streamer.stats().cancelled, 0u) << "one list later they may still be served";
  EXPECT_EQ(rig.streamer.state(PageId(texturePlane(1), old_list.back().node)), PageState::kQueued);
  rig.step();
  EXPECT_EQ(rig.streamer.stats().cancelled, 3 * old_list.size() - 1);
  EXPECT_EQ(rig.streamer.state(PageId(texturePlane(1), old_list.back().node)), PageState::kAbsent);
  gate->open();
  rig.settle();
  EXPECT_EQ(record->reads().size(), 1u + 3u);
  EXPECT_TRUE(rig.streamer.table().find({9, 0, 0, 0}));
}

// --- bounds ---

TEST(PageStreamer, DecodedPagesInFlightAreBounded) {
  auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
  StreamerOptions options = threePlanes(1024, 2);
  options.ready_limit = 5;
  Rig rig(record, options);
  rig.max_uploads = 0;
  rig.texture = square(5, 0, 0, 8);
  do {
    rig.step();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  } while (record->reads().size() < 7);
  for (int i = 0; i < 20; ++i) {
    rig.step();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(record->reads().size(), 7u) << "2 workers + 5 waiting";
  EXPECT_EQ(rig.streamer.bufferBytes(), 7 * kSlotBytes);
  EXPECT_FALSE(rig.streamer.settled());
  rig.max_uploads = 3;
  rig.step();
  size_t uploads = 0;
  while (!rig.streamer.settled()) {
    rig.streamer.beginFrame(++rig.frame, 1);
    rig.streamer.requestTexture(rig.texture);
    auto list = rig.streamer.placeReady(3);
    EXPECT_LE(list.size(), 3u);
    uploads += list.size();
  }
  EXPECT_EQ(uploads + 3, 3 * rig.texture.size());
}

// A view that follows the detail bias: `size` pages a side at bias 0, at a uniform level (the hardest case: a level's
// step changes the demand fourfold at once).
std::vector<NodeRequest> uniformView(double bias, uint32_t level, uint32_t size) {
  auto coarser = static_cast<uint32_t>(std::floor(bias));
  coarser = std::min(coarser, level);
  return square(level - coarser, 0, 0, std::max(1u, size >> coarser));
}

TEST(PageStreamer, AWorkingSetLargerThanTheCacheEndsStill) {
  for (uint32_t slots : {3u, 10u, 40u, 100u, 250u}) {
    auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
    Rig rig(record, threePlanes(slots));
    rig.check_texels = false;
    rig.streamer.pinRoots({{kRoot}}, {});
    // Deaf to the bias: what finds room is loaded once, and that is all.
    rig.texture = square(4, 0, 0, 12);
    rig.settle();
    ASSERT_FALSE(HasFatalFailure());
    EXPECT_GT(rig.streamer.stats().deferred, 0u);
    EXPECT_NEAR(rig.streamer.detailBias(), kMaxDetailBias, 1e-9);
    EXPECT_EQ(rig.streamer.stats().evictions, 0u) << "thrash";
    EXPECT_GT(rig.streamer.cache().residentCount() + 3, slots) << "the room there is was used";
    EXPECT_EQ(rig.tableError(rig.texture, kThreePlanes), "");
    EXPECT_LE(rig.streamer.table().size() * 3, slots);
    EXPECT_GE(rig.streamer.table().size(), slots / 3) << "only whole nodes are asked for";
    size_t reads = record->reads().size();
    for (int i = 0; i < 50; ++i) rig.step();
    EXPECT_EQ(record->reads().size(), reads) << "a still camera loads nothing";
  }
}

TEST(PageStreamer, DetailFallsUntilTheViewFitsAndComesBack) {
  constexpr int kLatency = 3;  // frames between a bias and the requests that follow it
  for (uint32_t slots : {30u, 100u, 200u, 400u}) {
    auto record = std::make_shared<RecordingSource>(std::make_shared<ProceduralSource>());
    Rig rig(record, threePlanes(slots));
    rig.check_texels = false;
    rig.streamer.pinRoots({{kRoot}}, {});
    std::vector<double> biases(kLatency, 0.0);
    // So many frames, and more while pages are on the way: threads get their turns late on a machine that does much
    // else.
    auto run = [&](uint32_t level, uint32_t size, int frames) {
      for (int i = 0; i < frames || (i < 100 * frames && !rig.streamer.settled()); ++i) {
        biases.push_back(rig.streamer.detailBias());
        rig.texture = uniformView(biases[biases.size() - 1 - kLatency], level, size);
        rig.step();
        ASSERT_FALSE(HasFatalFailure());
        std::this_thread::sleep_for(std::chrono::microseconds(300));
      }
    };
    run(5, 16, 250);
    double bias = rig.streamer.detailBias();
    EXPECT_GT(bias, 0.0) << "3 x 341 pages do not fit " << slots;
    EXPECT_EQ(rig.streamer.stats().deferred, 0u) << "the view fits now";
    EXPECT_TRUE(rig.streamer.settled());
    for (size_t i = 1; i < biases.size(); ++i)
      EXPECT_LE(std::abs(biases[i] - biases[i - 1]), 0.2 + 1e-9) << "smoothly: a level takes five frames";
    size_t reads = record->reads().size();
    run(5, 16, 200);
    EXPECT_EQ(rig.streamer.detailBias(), bias) << "a still camera: no swinging";
    EXPECT_EQ(record->reads().size(), reads) << "a still camera: no loads";
    run(5, 1, 250);
    EXPECT_EQ(rig.streamer.detailBias(), 0.0) << "a small view has all of its detail";
    EXPECT_TRUE(rig.streamer.settled());
    run(5, 16, 250);
    EXPECT_NEAR(rig.streamer.detailBias(), bias, 0.2 + 1e-9);
  }
}

TEST(PageStreamer, TextureAndReliefEvictEachOther) {
  Rig rig(std::make_shared<ProceduralSource>(), threePlanes(27));
  uint64_t empty = rig.streamer.reliefGeneration();
  rig.relief = square(5, 0, 0, 4);  // 16 + 4 + 1 + 1 + 1 + 1 = 24 pages, two a slot
  rig.settle();
  EXPECT_EQ(rig.streamer.residentRelief().size(), rig.relief.size());
  EXPECT_GT(rig.streamer.reliefGeneration(), empty);
  uint64_t full = rig.streamer.reliefGeneration();

  rig.relief = {{kRoot, 1, 0.f}};
  rig.texture = square(3, 0, 0, 2);  // 4 + 1 + 1 + 1 nodes of 3 planes
  rig.settle();
  for (const NodeRequest& w : rig.texture) EXPECT_TRUE(rig.streamer.table().find(w.node));
  EXPECT_LE(rig.streamer.residentRelief().size(), 2 * (27u - 21u));
  EXPECT_GT(rig.streamer.reliefGeneration(), full);
  EXPECT_NE(rig.streamer.findRelief(kRoot), kNoSlot);

  auto texture = rig.texture;
  rig.texture = {{kRoot, 1, 0.f}};
  rig.relief = square(5, 20, 20, 4);
  rig.settle();
  EXPECT_EQ(rig.tableError(texture, kThreePlanes), "") << "evicting one plane takes the node out of the table";
  EXPECT_LT(rig.streamer.table().size(), texture.size());
  for (const NodeRequest& w : rig.relief) EXPECT_NE(rig.streamer.findRelief(w.node), kNoSlot);
  EXPECT_GT(rig.streamer.stats().evictions, 0u);
}

TEST(PageStreamer, PinnedReliefStaysUntilReleased) {
  Rig rig(std::make_shared<ProceduralSource>(), threePlanes(12));
  NodeId held{0, 3, 1, 1};
  EXPECT_FALSE(rig.streamer.pinRelief(held)) << "not resident";
  rig.relief = {{held, 1, 0.f}};
  rig.settle();
  ASSERT_TRUE(rig.streamer.pinRelief(held));
  ASSERT_TRUE(rig.streamer.pinRelief(held));
  rig.streamer.unpinRelief(held);
  rig.relief.clear();
  rig.streamer.beginFrame(++rig.frame, rig.now_s);
  rig.streamer.requestRelief({});
  for (uint32_t i = 0; i < 10; ++i) {
    rig.texture = {{{i, 2, 0, 0}, 1, 0.f}, {{i, 2, 1, 0}, 1, 0.f}, {{i, 2, 1, 1}, 1, 0.f}};
    rig.settle();
    EXPECT_NE(rig.streamer.findRelief(held), kNoSlot);
  }
  rig.streamer.unpinRelief(held);
  for (uint32_t i = 0; i < 10; ++i) {
    rig.texture = {{{i, 4, 0, 0}, 1, 0.f}, {{i, 4, 1, 0}, 1, 0.f}, {{i, 4, 1, 1}, 1, 0.f}, {{i, 4, 1, 2}, 1, 0.f}};
    rig.settle();
  }
  EXPECT_EQ(rig.streamer.findRelief(held), kNoSlot);
}

// --- faults ---

TEST(PageStreamer, FaultsEndResidentOrFailedAndAreNamedOnce) {
  for (uint64_t seed : {1u, 2u, 3u}) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    auto failing = std::make_shared<FailingSource>(
        std::make_shared<ProceduralSource>(),
        FailingSource::Rates{.fail = 0.1, .truncate = 0.1, .corrupt = 0.1, .permanent = 0.1}, seed);
    Rig rig(failing, threePlanes(1024));
    rig.check_texels = seed == 1;
    rig.streamer.pinRoots({{kRoot}}, {{kRoot}});
    rig.texture = square(4, 1, 1, 9);
    rig.relief = square(5, 3, 3, 9);
    rig.settle();
    ASSERT_FALSE(HasFatalFailure());
    uint64_t failed = 0, loaded = 0;
    auto check = [&](PageId id, bool sibling_failed) {
      PageState state = rig.streamer.state(id);
      bool is_root = id.node().level == 0;
      failed += state == PageState::kFailed;
      loaded += state == PageState::kResident;
      EXPECT_TRUE(state == PageState::kResident || state == PageState::kFailed || sibling_failed)
          << static_cast<int>(state);
      // A sibling's failure for good ends a page's retries early: the node will never be whole.
      EXPECT_TRUE(state != PageState::kFailed || sibling_failed || failing->attempts(id) == kMaxAttempts);
      EXPECT_TRUE(state == PageState::kResident || !is_root);
    };
    for (const NodeRequest& w : rig.texture) {
      bool any_failed = false;
      for (Plane p : kThreePlanes)
        any_failed = any_failed || rig.streamer.state(PageId(p, w.node)) == PageState::kFailed;
      for (Plane p : kThreePlanes) check(PageId(p, w.node), any_failed);
      EXPECT_EQ(rig.streamer.table().find(w.node).has_value(), !any_failed);
    }
    for (const NodeRequest& w : rig.relief) check(PageId(Plane::kRelief, w.node), false);
    EXPECT_GT(failed, 10u);
    EXPECT_GT(loaded, 150u);
    EXPECT_LE(failing->maxAttempts(), kMaxAttempts);
    EXPECT_TRUE(rig.streamer.table().find(kRoot)) << "a look-up must end somewhere";
    EXPECT_EQ(rig.messages.size(), rig.streamer.stats().failed_pages);
    EXPECT_EQ(std::set(rig.messages.begin(), rig.messages.end()).size(), rig.messages.size()) << "named twice";
    EXPECT_GT(rig.streamer.stats().retries, 0u);
    uint64_t read = rig.streamer.stats().pages_read[0];
    for (int i = 0; i < 300; ++i) rig.step();
    EXPECT_EQ(rig.streamer.stats().pages_read[0], read);
    EXPECT_LE(failing->maxAttempts(), kMaxAttempts) << "no retry storm";
  }
}

TEST(PageStreamer, RetriesBackOff) {
  auto failing =
      std::make_shared<FailingSource>(std::make_shared<ProceduralSource>(), FailingSource::Rates{.permanent = 1}, 1);
  StreamerOptions options = threePlanes(16);
  options.texture_planes = {texturePlane(0)};
  Rig rig(failing, options);
  rig.frame_s = 0;
  rig.texture = {{kRoot, 1, 0.f}};
  PageId page(texturePlane(0), kRoot);
  auto attemptsAt = [&](double now_s) {
    rig.now_s = now_s;
    rig.step();
    do {
      std::this_thread::sleep_for(std::chrono::microseconds(100));
      rig.step();
    } while (rig.streamer.stats().queued + rig.streamer.stats().decoding > 0);
    return failing->attempts(page);
  };
  EXPECT_EQ(attemptsAt(1.00), 1);
  EXPECT_FALSE(rig.streamer.settled()) << "it may still come";
  EXPECT_EQ(attemptsAt(1.09), 1);
  EXPECT_EQ(attemptsAt(1.11), 2);
  EXPECT_EQ(attemptsAt(1.50), 2);
  EXPECT_EQ(attemptsAt(1.52), 3);
  EXPECT_EQ(attemptsAt(3.11), 3);
  EXPECT_EQ(rig.messages.size(), 0u);
  EXPECT_EQ(attemptsAt(3.13), 4);
  EXPECT_EQ(attemptsAt(1e6), 4);
  EXPECT_TRUE(rig.streamer.settled());
  EXPECT_EQ(rig.messages.size(), 1u);
  EXPECT_EQ(rig.streamer.stats().retries, 3u);
  EXPECT_EQ(rig.streamer.stats().failed_pages, 1u);
  EXPECT_EQ(rig.streamer.failures().pages, 1u) << "tried often, failed once";
}

TEST(PageStreamer, NodesThatDoNotExistFailAtOnce) {
  auto record = std::make_shared<RecordingSource>(
      std::make_shared<ProceduralSource>([](PageId id) { return id.node().level < 3; }));
  Rig rig(record, threePlanes(256, 1));
  rig.texture = square(4, 0, 0, 2);
  rig.settle();
  for (int i = 0; i < 200; ++i) rig.step();
  EXPECT_EQ(rig.streamer.stats().retries, 0u);
  std::map<PageId, int> reads;
  for (PageId id : record->reads()) EXPECT_EQ(++reads[id], 1);
  for (const NodeRequest& w : rig.texture) EXPECT_EQ(rig.streamer.table().find(w.node).has_value(), w.node.level < 3);
  EXPECT_FALSE(rig.messages.empty());
}

TEST(PageStreamer, ASourceThatNeverAnswersStopsNothing) {
  auto gate = std::make_shared<GatedSource>(std::make_shared<ProceduralSource>(), true);
  {
    Rig rig(gate, threePlanes(256));
    rig.streamer.pinRoots({{kRoot}}, {{kRoot}});
    gate->open(false);
    for (uint32_t i = 0; i < 300; ++i) {
      rig.texture = square(4, i % 8, i % 7, 5);
      rig.relief = square(4, i % 8, i % 7, 5);
      rig.step();
      EXPECT_FALSE(rig.streamer.settled());
      EXPECT_TRUE(rig.streamer.table().find(kRoot));
      EXPECT_EQ(rig.streamer.residentRelief().size(), 1u);
    }
    EXPECT_LE(rig.streamer.stats().decoding, 2u);
    gate->open();  // the destructor waits for the reads under way
  }
  SUCCEED();
}

TEST(PageStreamer, DamagedRootsAreReplacedByNeutralPages) {
  StreamerOptions options = threePlanes(64);
  options.format.scale = {2, 2, 2, 2, 2, 2};
  options.format.bias = {100, 101, 102, 103, 104, 50};
  auto failing =
      std::make_shared<FailingSource>(std::make_shared<ProceduralSource>(), FailingSource::Rates{.permanent = 1}, 1);
  PageStreamer streamer(failing, options, fakeDecode);
  std::vector<NodeId> roots{{0, 0, 0, 0}, {1, 0, 0, 0}};
  streamer.pinRoots(roots, roots);
  EXPECT_EQ(streamer.stats().failed_pages, 8u);
  EXPECT_EQ(streamer.takeMessages().size(), 8u);
  EXPECT_EQ(streamer.failures().pages, 8u);
  EXPECT_EQ(streamer.failures().unreadable, 8u) << "input/output errors";
  EXPECT_NE(streamer.failures().first.find("plane 0 patch 0 level 0 x 0 y 0"), std::string::npos)
      << streamer.failures().first;
  streamer.beginFrame(1, 0);
  auto uploads = streamer.placeReady(1);
  ASSERT_EQ(uploads.size(), 8u) << "the roots come at once";
  std::vector<double> raw(kMaxTexturePlanes * 3, -1);
  for (const PageUpload& u : uploads) {
    if (u.id.plane() == Plane::kRelief) {
      EXPECT_EQ(std::count(u.texels, u.texels + kSlotBytes, 0), static_cast<std::ptrdiff_t>(kSlotBytes));
    } else {
      for (int c = 0; c < 3; ++c) raw[3 * static_cast<size_t>(u.id.plane()) + c] = u.texels[4 * 5000 + c];
    }
  }
  auto grey = evaluatePixel(options.format, raw.data(), 0.3, -0.6);
  for (double c : grey) EXPECT_NEAR(c, 128, 1.0) << "under every light";
  // Neither tried nor named again.
  for (uint64_t frame = 2; frame < 300; ++frame) {
    streamer.beginFrame(frame, 0.1 * frame);
    std::vector<NodeRequest> requests{{roots[0], 1, 0.f}, {roots[1], 1, 0.f}};
    streamer.requestTexture(requests);
    streamer.requestRelief(requests);
    streamer.placeReady(8);
  }
  EXPECT_TRUE(streamer.settled());
  EXPECT_EQ(streamer.takeMessages().size(), 0u);
  EXPECT_EQ(failing->maxAttempts(), kMaxAttempts);
}

// --- a fixed light ---

TextureFormat ptmFormat() {
  TextureFormat f;
  f.basis = Basis::kPtmLrgb;
  f.scale = {1.5, 2, 1, 2, 2.5, 1};
  f.bias = {120, 128, 100, 130, 128, 10};
  return f;
}

struct ResolvedRig {
  std::shared_ptr<GatedSource> gate = std::make_shared<GatedSource>(std::make_shared<ProceduralSource>(), true);
  std::shared_ptr<RecordingSource> record = std::make_shared<RecordingSource>(gate);
  Rig rig;
  double u = 0.25, v = 0.5;
  std::unordered_map<PageId, std::vector<uint8_t>> shown;

  static StreamerOptions options() {
    StreamerOptions o;
    o.slot_count = 64;
    o.texture_planes = {Plane::kResolved};
    o.format = ptmFormat();
    o.light = frontLight(0.25, 0.5);
    return o;
  }
  ResolvedRig() : rig(record, options()) { rig.check_texels = false; }
  void settle() {
    do {
      rig.streamer.beginFrame(++rig.frame, rig.now_s += rig.frame_s);
      rig.streamer.requestTexture(rig.texture);
      for (const PageUpload& up : rig.streamer.placeReady(8)) shown[up.id].assign(up.texels, up.texels + kSlotBytes);
      std::this_thread::sleep_for(std::chrono::microseconds(50));
    } while (!rig.streamer.settled());
  }
  // The largest difference from the formula in double precision, over every wanted node.
  double worst(double light_u, double light_v) {
    double worst = 0;
    for (const NodeRequest& w : rig.texture) {
      const auto& texels = shown[PageId(Plane::kResolved, w.node)];
      if (texels.empty()) return 1e9;
      for (size_t i = 0; i < kSlotBytes / 4; i += 37) {
        double raw[18] = {};
        for (int k = 0; k < 9; ++k) raw[k] = texelByte(PageId(texturePlane(k / 3), w.node), 4 * i + k % 3);
        auto rgb = evaluatePixel(ptmFormat(), raw, light_u, light_v);
        for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(rgb[c] - texels[4 * i + c]));
      }
    }
    return worst;
  }
};

TEST(PageStreamer, AFixedLightIsResolvedOncePerPage) {
  ResolvedRig r;
  r.rig.streamer.pinRoots({{kRoot}}, {});
  r.rig.texture = square(2, 0, 0, 3);
  r.settle();
  EXPECT_LE(r.worst(0.25, 0.5), 0.51);
  EXPECT_GT(r.worst(0.35, 0.5), 2.0) << "the check does not see another light";
  const StreamerStats& s = r.rig.streamer.stats();
  size_t nodes = r.rig.texture.size();
  for (int p = 0; p < 3; ++p) {
    EXPECT_EQ(s.pages_read[p], nodes);
    EXPECT_EQ(s.pages_decoded[p], nodes);
    EXPECT_EQ(s.pages_uploaded[p], 0u);
  }
  EXPECT_EQ(s.pages_uploaded[9], nodes);
  EXPECT_EQ(s.pages_read[9], 0u);
  EXPECT_EQ(r.rig.streamer.cache().residentCount(), nodes) << "one slot a node";
  EXPECT_EQ(r.rig.streamer.bufferBytes(), (2 + 64 + 2 * 3) * kSlotBytes);

  r.rig.streamer.setLight(frontLight(-0.5, 0.1));
  EXPECT_FALSE(r.rig.streamer.settled());
  EXPECT_TRUE(r.rig.streamer.table().find(kRoot)) << "a look-up must end somewhere";
  EXPECT_EQ(r.rig.streamer.table().size(), 1u) << "nothing else shows the old light";
  r.settle();
  EXPECT_LE(r.worst(-0.5, 0.1), 0.51);
  EXPECT_EQ(r.rig.streamer.table().size(), nodes);
}

TEST(PageStreamer, PagesUnderWayWhenTheLightMovesAreDropped) {
  ResolvedRig r;
  r.rig.texture = square(1, 0, 0, 2);
  r.gate->open(false);
  r.rig.step();
  r.gate->waitForReaders(2);
  r.rig.streamer.setLight(frontLight(0.7, -0.1));
  r.gate->open();
  r.settle();
  EXPECT_LE(r.worst(0.7, -0.1), 0.51);
  while (r.rig.streamer.stats().cancelled < 2) r.settle();  // the late answers; settled() does not wait for them
  EXPECT_EQ(r.rig.streamer.stats().cancelled, 2u);
  // Moved in every frame, as by a hand: the last light counts.
  for (int i = 0; i <= 60; ++i) {
    r.rig.streamer.setLight(frontLight(0.01 * i, 0.2));
    r.rig.streamer.beginFrame(++r.rig.frame, r.rig.now_s);
    r.rig.streamer.requestTexture(r.rig.texture);
    for (const PageUpload& up : r.rig.streamer.placeReady(2)) r.shown[up.id].assign(up.texels, up.texels + kSlotBytes);
  }
  r.settle();
  EXPECT_LE(r.worst(0.6, 0.2), 0.51);
}

// --- the real codec ---

TEST(PageStreamer, RealPagesArriveUnchanged) {
  auto memory = std::make_shared<MapSource>();
  PageEncoder encoder(1);
  std::map<PageId, std::vector<uint8_t>> channels;
  std::map<PageId, std::vector<uint16_t>> samples;
  auto requests = square(2, 0, 0, 2);
  std::mt19937 random(7);
  for (const NodeRequest& w : requests) {
    for (Plane p : kThreePlanes) {
      auto& c = channels[PageId(p, w.node)];
      c.resize(kTexturePageBytes);
      for (size_t i = 0; i < c.size(); ++i) c[i] = static_cast<uint8_t>(i / 7 + random() % 9);
      auto bytes = encoder.encodeTexture(c);
      memory->pages[PageId(p, w.node)].assign(bytes.begin(), bytes.end());
    }
    auto& s = samples[PageId(Plane::kRelief, w.node)];
    s.resize(kReliefPageSamples);
    for (size_t i = 0; i < s.size(); ++i) s[i] = static_cast<uint16_t>(i * 3 + random() % 99);
    auto bytes = encoder.encodeRelief(s);
    memory->pages[PageId(Plane::kRelief, w.node)].assign(bytes.begin(), bytes.end());
  }
  PageStreamer streamer(memory, threePlanes(64));
  std::map<PageId, std::vector<uint8_t>> shown;
  for (uint64_t frame = 1; frame == 1 || !streamer.settled(); ++frame) {
    streamer.beginFrame(frame, frame / 60.0);
    streamer.requestTexture(requests);
    streamer.requestRelief(requests);
    for (const PageUpload& u : streamer.placeReady(8)) shown[u.id].assign(u.texels, u.texels + kSlotBytes);
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  }
  EXPECT_TRUE(streamer.takeMessages().empty());
  ASSERT_EQ(shown.size(), memory->pages.size());
  constexpr size_t kPlane = size_t{kPageFullPx} * kPageFullPx;
  for (const auto& [id, c] : channels)
    for (size_t i = 0; i < kPlane; ++i)
      for (size_t k = 0; k < 3; ++k) ASSERT_EQ(shown[id][4 * i + k], c[k * kPlane + i]);
  for (const auto& [id, s] : samples)
    for (size_t j = 0; j < kReliefSamples; ++j)
      for (size_t i = 0; i < kReliefSamples; ++i) {
        const uint8_t* t = &shown[id][4 * (j * kPageFullPx + i)];
        ASSERT_EQ(t[0] << 8 | t[1], s[j * kReliefSamples + i]);
      }
}

// --- everything at once ---

// Cameras that jump and drift, over a slow and faulty source, in caches that are often too small. The invariants of
// every frame are the rig's; at the end, what is shown depends on the last view alone.
std::set<PageId> wander(uint64_t seed, int workers, int frames) {
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  auto slow = std::make_shared<SlowSource>(std::make_shared<ProceduralSource>(), std::chrono::microseconds(100));
  auto failing = std::make_shared<FailingSource>(
      slow, FailingSource::Rates{.fail = 0.05, .truncate = 0.02, .corrupt = 0.02}, seed);
  StreamerOptions options = threePlanes(120 + random() % 300, workers);
  options.ready_limit = 1 + random() % 16;
  Rig rig(failing, options);
  rig.check_texels = seed % 2 == 0;
  rig.max_uploads = 1 + random() % 12;
  rig.streamer.pinRoots({{kRoot}}, {{kRoot}});
  std::vector<NodeId> pinned;
  uint32_t x = 0, y = 0;
  for (int i = 0; i < frames && !::testing::Test::HasFatalFailure(); ++i) {
    if (random() % 10 == 0) x = random() % 24, y = random() % 24;
    x = std::min<uint32_t>(24, x + random() % 2);
    if (random() % 4) rig.texture = square(5, x, y, 1 + random() % 7);
    if (random() % 4) rig.relief = square(5, x, y, 1 + random() % 7);
    for (const NodeId& n : pinned) rig.streamer.unpinRelief(n);
    pinned.clear();
    for (const NodeId& n : rig.streamer.residentRelief())
      if (random() % 3 == 0 && rig.streamer.pinRelief(n)) pinned.push_back(n);
    rig.step();
    EXPECT_EQ(rig.tableError(rig.texture, kThreePlanes), "");
    EXPECT_TRUE(rig.streamer.table().find(kRoot));
    for (const NodeId& n : pinned) EXPECT_NE(rig.streamer.findRelief(n), kNoSlot);
  }
  for (const NodeId& n : pinned) rig.streamer.unpinRelief(n);
  rig.texture = square(5, 3, 4, 4);
  rig.relief = square(5, 3, 4, 4);
  rig.frame_s = 0.2;
  rig.settle();
  EXPECT_EQ(rig.tableError(rig.texture, kThreePlanes), "");
  std::set<PageId> shown;
  for (const NodeRequest& w : rig.texture)
    if (rig.streamer.table().find(w.node)) shown.insert(PageId(texturePlane(0), w.node));
  for (const NodeRequest& w : rig.relief)
    if (rig.streamer.findRelief(w.node) != kNoSlot) shown.insert(PageId(Plane::kRelief, w.node));
  return shown;
}

TEST(PageStreamer, InvariantsHoldWhateverTheThreadsDo) {
  for (uint64_t seed = 1; seed <= 6; ++seed) {
    auto one = wander(seed, 1, 60), four = wander(seed, 4, 60);
    EXPECT_EQ(one.size(), 2 * square(5, 3, 4, 4).size()) << "seed " << seed;
    EXPECT_EQ(one, four) << "seed " << seed << ": what is shown depends on the threads";
  }
}

}  // namespace page_streamer_test
}  // namespace relievo
