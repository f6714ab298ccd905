// page_simulation.h - a page streamer without threads, on a clock of its own: jobs are taken as a link with so many
// reads in flight would, and finish when the simulated time has come. Same seed, same run. With the checks of every
// frame.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "tests/texturing/fake_sources.h"
#include "texturing/stream/page_streamer.h"

namespace relievo::fake {

inline const std::vector<Plane> kThreePlanes{texturePlane(0), texturePlane(1), texturePlane(2)};
inline const NodeId kRoot{0, 0, 0, 0};

// With all ancestors, coarse before fine, and nearest to (0, 0) of its level first.
inline std::vector<NodeRequest> withAncestors(const std::vector<NodeId>& nodes) {
  std::set<NodeId> all;
  for (NodeId n : nodes)
    for (uint32_t l = 0; l <= n.level; ++l) all.insert(n.ancestor(l));
  std::vector<NodeRequest> requests;
  for (const NodeId& n : all) requests.push_back({n, 1, static_cast<float>(n.x + n.y) / (2 << n.level)});
  std::stable_sort(requests.begin(), requests.end(),
                   [](const NodeRequest& a, const NodeRequest& b) { return a.node.level < b.node.level; });
  return requests;
}
inline std::vector<NodeRequest> square(uint32_t level, uint32_t x, uint32_t y, uint32_t size) {
  std::vector<NodeId> nodes;
  for (uint32_t j = 0; j < size; ++j)
    for (uint32_t i = 0; i < size; ++i) nodes.push_back({0, level, x + i, y + j});
  return withAncestors(nodes);
}

// What is wrong with the counts of a streamer: a change of state that the diagram does not know, or pages that came
// into a state and neither left nor are there; or nothing.
inline std::string stateCountError(const StreamerStats& s) {
  for (size_t from = 0; from < kPageStates; ++from)
    for (size_t to = 0; to < kPageStates; ++to)
      if (s.moves[from][to] > 0 && !isLegal(static_cast<PageState>(from), static_cast<PageState>(to)))
        return std::string(kPageStateNames[from]) + " -> " + std::string(kPageStateNames[to]);
  for (size_t state = 1; state < kPageStates; ++state) {
    uint64_t now = 0, came = 0, left = 0;
    for (uint64_t n : s.pages[state]) now += n;
    for (size_t other = 0; other < kPageStates; ++other) came += s.moves[other][state], left += s.moves[state][other];
    if (came != left + now) return std::string(kPageStateNames[state]) + " does not add up";
  }
  return {};
}

struct Simulation {
  struct Flight {
    double finish_s;
    PageJob job;
  };

  std::shared_ptr<const PageSource> source;
  PageStreamer streamer;
  std::vector<Plane> planes;
  PageCodec upload;
  std::vector<PageId> pool,
      relief_pool;  // what was uploaded into each slot; relief_pool: where relief has slots of its own
  uint64_t frame = 0;
  double now_s = 0, frame_s = 1.0 / 60;
  uint32_t max_uploads = 64;
  size_t in_flight = 8;
  std::function<double(PageId)> delay_s = [](PageId) { return 0.02; };
  std::vector<Flight> flights;
  std::vector<NodeRequest> texture, relief;
  std::vector<NodeRequest> predicted;
  std::vector<std::string> messages;
  std::vector<PageId> taken;     // in order
  std::vector<PageId> uploaded;  // in the last frame
  bool texels_matter = true;

  // decoder: of texels that name their page, where none is given.
  Simulation(std::shared_ptr<const PageSource> s, StreamerOptions options, SlotDecoder decoder = {})
      : source(s),
        streamer(
            s, options,
            decoder ? std::move(decoder)
                    : [upload = options.upload](
                          Plane plane, std::span<const uint8_t> encoded,
                          std::span<uint8_t> texels) { return fakeDecodeFor(upload, plane, encoded, texels); }),
        planes(options.texture_planes),
        upload(options.upload),
        pool(options.slot_count),
        relief_pool(options.relief_slot_count) {}

  static StreamerOptions options(uint32_t slots, std::vector<Plane> of = kThreePlanes) {
    StreamerOptions o;
    o.slot_count = slots;
    o.workers = 0;
    o.texture_planes = std::move(of);
    o.format.basis = Basis::kPtmLrgb;
    return o;
  }

  // Texture pages as blocks, relief beside them.
  static StreamerOptions blockOptions(uint32_t slots, uint32_t relief_slots, PageCodec codec = PageCodec::kBc5) {
    StreamerOptions o = options(slots);
    o.upload = codec;
    o.relief_slot_count = relief_slots;
    return o;
  }

  void work() {
    for (;;) {
      std::stable_sort(flights.begin(), flights.end(),
                       [](const Flight& a, const Flight& b) { return a.finish_s < b.finish_s; });
      if (!flights.empty() && flights.front().finish_s <= now_s) {
        streamer.finishJob(flights.front().job);
        flights.erase(flights.begin());
        continue;
      }
      if (flights.size() >= in_flight) return;
      auto job = streamer.takeJob();
      if (!job) return;
      taken.push_back(job->id);
      flights.push_back({now_s + delay_s(job->id), *job});
    }
  }
  bool resident(PageId id) const { return streamer.cache(id.plane()).find(id) != kNoSlot; }
  // Of nodes that can be shown whole: what is there of others need not stay.
  std::vector<PageId> wantedResident() const {
    std::vector<PageId> pages;
    for (const NodeRequest& w : texture) {
      bool failed = std::any_of(planes.begin(), planes.end(),
                                [&](Plane p) { return streamer.state(PageId(p, w.node)) == PageState::kFailed; });
      for (Plane p : planes)
        if (!failed && resident(PageId(p, w.node))) pages.push_back(PageId(p, w.node));
    }
    for (const NodeRequest& w : relief)
      if (resident(PageId(Plane::kRelief, w.node))) pages.push_back(PageId(Plane::kRelief, w.node));
    return pages;
  }
  // A frame with all checks.
  void step() {
    streamer.beginFrame(++frame, now_s += frame_s);
    streamer.requestTexture(texture);
    streamer.requestRelief(relief);
    streamer.requestPrefetch(predicted, {});
    auto before = wantedResident();
    uploaded.clear();
    for (const PageUpload& u : streamer.placeReady(max_uploads)) {
      auto& slots = isBlockCodec(upload) && u.id.plane() == Plane::kRelief ? relief_pool : pool;
      const SlotPart part = partOf(u.slot);
      ASSERT_LT(part.slot, slots.size());
      ASSERT_EQ(part.level > 0, u.id.plane() == Plane::kRelief);
      ASSERT_EQ(streamer.cache(u.id.plane()).pageIn(u.slot), u.id);
      ASSERT_TRUE(!texels_matter || texelsAreOf(u.id, u.texels, upload)) << "the texels of another page";
      slots[part.slot] = part.level == 0 ? u.id : PageId();
      uploaded.push_back(u.id);
    }
    for (PageId id : before) ASSERT_TRUE(resident(id)) << "wanted now, yet evicted";
    std::string why;
    for (Plane plane : {texturePlane(0), Plane::kRelief}) {
      const SubslotCache& cache = streamer.cache(plane);
      ASSERT_TRUE(cache.checkInvariants(&why)) << why;
      ASSERT_LE(cache.residentCount(), cache.slotCount());
      if (isBlockCodec(upload))
        cache.forEach([&](PageId id) {
          ASSERT_EQ(id.plane() == Plane::kRelief, plane == Plane::kRelief) << "in another's slot";
        });
    }
    ASSERT_LE(streamer.stats().resident_bytes,
              pool.size() * slotBytes(upload, texturePlane(0)) + relief_pool.size() * kSlotBytes);
    ASSERT_EQ(stateCountError(streamer.stats()), "");
    for (auto& m : streamer.takeMessages()) messages.push_back(m);
    work();
  }
  void run(int frames) {
    for (int i = 0; i < frames && !::testing::Test::HasFatalFailure(); ++i) step();
  }
  // At most so many frames; true when settled.
  bool settle(int frames) {
    for (int i = 0; i < frames && !::testing::Test::HasFatalFailure(); ++i) {
      step();
      if (streamer.settled()) return true;
    }
    return false;
  }
  // What a look-up ends at; nothing: a look-up that ends nowhere.
  std::optional<NodeId> shown(NodeId node) {
    for (uint32_t l = node.level + 1; l-- > 0;)
      if (streamer.table().find(node.ancestor(l))) return node.ancestor(l);
    return {};
  }
};

// Settled on storage that fails: each wanted page is there or has failed for good, and each that has is named once.
inline void expectFinal(Simulation& sim, const FailingSource& source) {
  uint64_t failed = 0;
  for (const NodeRequest& w : sim.texture) {
    bool whole = true, any_failed = false;
    for (Plane p : sim.planes) {
      PageState state = sim.streamer.state(PageId(p, w.node));
      whole = whole && state == PageState::kResident;
      any_failed = any_failed || state == PageState::kFailed;
    }
    // One page at least for good; another that failed and could come with a further try is not asked for any more.
    failed += any_failed;
    EXPECT_EQ(whole, !any_failed) << "a page that may still come";
    EXPECT_EQ(sim.streamer.table().find(w.node).has_value(), whole);
  }
  EXPECT_LE(source.maxAttempts(), kMaxAttempts);
  EXPECT_LE(failed, sim.streamer.stats().failed_pages);
  EXPECT_EQ(sim.messages.size(), sim.streamer.stats().failed_pages);
  EXPECT_EQ(std::set(sim.messages.begin(), sim.messages.end()).size(), sim.messages.size()) << "named twice";
}

}  // namespace relievo::fake
