// The life of a page: invariants that hold in every frame, whatever the threads do.
#include "texturing/page_streamer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <unordered_map>

#include "tests/texturing/fake_sources.h"
#include "texturing/resolve.h"

namespace relievo {
namespace {

using namespace fake;

const std::vector<Plane> kThreePlanes{texturePlane(0), texturePlane(1), texturePlane(2)};
const NodeId kRoot{0, 0, 0, 0};

std::vector<NodeWant> withAncestors(const std::vector<NodeId>& nodes) {
  std::vector<NodeId> all;
  for (NodeId n : nodes)
    for (uint32_t l = 0; l <= n.level; ++l) all.push_back(n.ancestor(l));
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  std::stable_sort(all.begin(), all.end(), [](const NodeId& a, const NodeId& b) { return a.level < b.level; });
  std::vector<NodeWant> wants;
  for (const NodeId& n : all) wants.push_back({n, 1, 0.5f});
  return wants;
}
std::vector<NodeWant> square(uint32_t level, uint32_t x, uint32_t y, uint32_t size) {
  std::vector<NodeId> nodes;
  for (uint32_t j = 0; j < size; ++j)
    for (uint32_t i = 0; i < size; ++i) nodes.push_back({0, level, x + i, y + j});
  return withAncestors(nodes);
}

// A streamer with the page pool and table that a renderer would have, and the invariants of every frame.
struct Rig {
  std::shared_ptr<const PageSource> source;
  PageStreamer streamer;
  std::vector<PageId> pool;       // what was uploaded into each slot
  uint64_t frame = 0;
  double now_s = 0;
  double frame_s = 1.0 / 60;
  uint32_t max_uploads = 16;
  bool check_texels = true;
  std::vector<NodeWant> texture, relief;
  std::vector<std::string> messages;

  Rig(std::shared_ptr<const PageSource> s, StreamerOptions options, SlotDecoder decoder = fakeDecode)
      : source(s), streamer(s, options, std::move(decoder)), pool(options.slot_count) {}

  void upload(std::span<const PageUpload> uploads) {
    for (const PageUpload& u : uploads) {
      ASSERT_LT(u.slot, pool.size());
      ASSERT_EQ(streamer.cache().pageIn(u.slot), u.id);
      ASSERT_TRUE(!check_texels || texelsAreOf(u.id, u.texels)) << "the texels of another page";
      pool[u.slot] = u.id;
    }
  }
  void step() {
    streamer.beginFrame(++frame, now_s += frame_s);
    streamer.wantTexture(texture);
    if (!relief.empty()) streamer.wantRelief(relief);
    std::vector<PageId> before;
    for (const NodeWant& w : texture)
      for (Plane p : kThreePlanes)
        if (streamer.state(PageId(p, w.node)) == PageState::kResident) before.push_back(PageId(p, w.node));
    auto uploads = streamer.placeReady(max_uploads);
    upload(uploads);
    std::string why;
    ASSERT_TRUE(streamer.cache().checkInvariants(&why)) << why;
    for (PageId id : before) ASSERT_EQ(streamer.state(id), PageState::kResident) << "wanted now, yet evicted";
    for (auto& m : streamer.takeMessages()) messages.push_back(m);
  }
  // What a shader would read is what was uploaded.
  void checkTable(const std::vector<NodeWant>& nodes, const std::vector<Plane>& planes) {
    for (const NodeWant& w : nodes) {
      bool whole = true;
      for (Plane p : planes) whole = whole && streamer.cache().find(PageId(p, w.node)) != kNoSlot;
      auto entry = streamer.table().find(w.node);
      ASSERT_EQ(entry.has_value(), whole);
      if (!entry) continue;
      for (size_t i = 0; i < planes.size(); ++i) ASSERT_EQ(pool[entry->slots[i]], PageId(planes[i], w.node));
    }
  }
  // Frames until settled; the test program's time limit ends a run that never is.
  int settle() {
    int frames = 0;
    do {
      step();
      if (::testing::Test::HasFatalFailure()) return frames;
      ++frames;
      std::this_thread::yield();
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
    rig.checkTable(rig.texture, kThreePlanes);
    ASSERT_TRUE(rig.streamer.table().find(kRoot)) << "a look-up must end somewhere";
  }
  for (const NodeWant& w : rig.texture) EXPECT_TRUE(rig.streamer.table().find(w.node));
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

}  // namespace
}  // namespace relievo
