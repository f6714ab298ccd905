// The LOD worker: newest view in, newest list out, the same list as the plain function, a clean stop at any time.
#include <gtest/gtest.h>

#include <thread>

#include "geometry/lod/lod_worker.h"
#include "tests/geometry/lod_fixture.h"

namespace relievo::test {
namespace lod_worker_test {

struct LodSetup {
  FlatDomain domain = makeDomain(30000, 20000, 0);
  std::shared_ptr<MadeUpOracle> oracle = std::make_shared<MadeUpOracle>(domain, 5);
  LodRequest request(uint64_t frame) const {
    Random random(frame);
    LodRequest r;
    r.frame = frame;
    r.view = makeView(randomCamera(domain, random));
    auto resident = std::make_shared<ReliefSet>();
    resident->insert({0, 0, 0, 0});
    r.resident = resident;
    return r;
  }
};

TEST(LodWorker, AnswersWithWhatThePlainFunctionGives) {
  LodSetup s;
  LodWorker worker(s.domain, s.oracle);
  for (uint64_t frame = 1; frame <= 20; ++frame) {
    LodRequest request = s.request(frame);
    worker.post(request);
    LodAnswer answer = worker.waitFor(frame);
    ASSERT_EQ(answer.frame, frame);
    LodResult direct = selectPlanarLod(s.domain, *s.oracle, request.view, *request.resident);
    ASSERT_EQ(answer.lod.instances.size(), direct.instances.size());
    for (size_t i = 0; i < direct.instances.size(); ++i) {
      ASSERT_EQ(answer.lod.instances[i].node, direct.instances[i].node);
      ASSERT_EQ(answer.lod.instances[i].edges, direct.instances[i].edges);
    }
    EXPECT_GE(answer.evaluate_ms, 0);
  }
}

TEST(LodWorker, NewestWinsAndFramesNeverGoBack) {
  LodSetup s;
  LodWorker worker(s.domain, s.oracle);
  uint64_t last = 0;
  for (uint64_t frame = 1; frame <= 300; ++frame) {
    worker.post(s.request(frame));
    if (std::optional<LodAnswer> answer = worker.tryTake()) {
      ASSERT_GT(answer->frame, last);
      last = answer->frame;
    }
  }
  EXPECT_EQ(worker.waitFor(300).frame, 300u);
  // Already taken: answered again rather than waited for in vain.
  EXPECT_EQ(worker.waitFor(300).frame, 300u);
  EXPECT_EQ(worker.waitFor(7).frame, 300u);
}

TEST(LodWorker, StopsAtAnyTime) {
  LodSetup s;
  for (int k = 0; k < 20; ++k) {
    LodWorker worker(s.domain, s.oracle);
    for (int i = 0; i < k % 4; ++i) worker.post(s.request(static_cast<uint64_t>(i) + 1));
    if (k % 3 == 0) std::this_thread::yield();
  }
  LodWorker idle(s.domain, s.oracle);
  EXPECT_FALSE(idle.tryTake().has_value());
}

TEST(LodWorker, NamesTextureNodesWhenAsked) {
  LodSetup s;
  LodWorker worker(s.domain, s.oracle);
  LodRequest request = s.request(1);
  worker.post(request);
  EXPECT_FALSE(worker.waitFor(1).texture.has_value());
  TextureView view;
  view.clip_from_world = request.view.clip_from_world;
  view.eye_mm = request.view.eye_mm;
  view.near_mm = request.view.near_mm;
  view.width_px = 320;
  view.height_px = 200;
  request.frame = 2;
  request.texture = view;
  worker.post(request);
  LodAnswer answer = worker.waitFor(2);
  ASSERT_TRUE(answer.texture.has_value());
  std::vector<TextureRequest> direct = selectTextureNodes(s.domain, *s.oracle, view);
  ASSERT_EQ(answer.texture->size(), direct.size());
  for (size_t i = 0; i < direct.size(); ++i) EXPECT_EQ((*answer.texture)[i].node, direct[i].node);
}

TEST(LodWorker, NoResidencyMeansRootsOnly) {
  LodSetup s;
  LodWorker worker(s.domain, s.oracle);
  LodRequest request = s.request(1);
  request.resident = nullptr;
  worker.post(request);
  for (const PatchInstance& p : worker.waitFor(1).lod.instances) EXPECT_EQ(p.relief_page.level, 0u);
}

}  // namespace lod_worker_test
}  // namespace relievo::test
