// The engine over storage that is slow, damaged or dead: frames go on and show at least the ancestors, what failed is
// tried so many times and named once, and a small cache ends still. Time is the frames' own; where a thread's turn is
// needed, a frame is followed by a short sleep.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include "src/engine/engine.h"
#include "src/gl/context.h"
#include "tests/render/made_engine.h"
#include "tests/render/test_artwork.h"
#include "tests/texturing/fake_sources.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/page_sources.h"

namespace relievo {
namespace engine_faults_gltest {

constexpr int kWidth = 320, kHeight = 180;
constexpr uint32_t kSeed = 20261121;

// Opens the gate when whoever needs it opened did not come back for a while: a blocked render thread fails instead of
// hanging.
class Rescue {
 public:
  Rescue(std::shared_ptr<const fake::GatedSource> gate, std::chrono::milliseconds after)
      : gate_(gate), thread_([this, gate, after] {
          std::unique_lock lock(mutex_);
          if (changed_.wait_for(lock, after, [&] { return over_; })) return;
          needed_ = true;
          gate->open();
        }) {}
  // A test that gives up early must not hang in the engine's end.
  ~Rescue() {
    end();
    gate_->open();
  }
  // True: the gate had to be opened by force.
  bool end() {
    {
      std::lock_guard lock(mutex_);
      over_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
    return needed_;
  }

 private:
  std::shared_ptr<const fake::GatedSource> gate_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool over_ = false;
  std::atomic<bool> needed_{false};
  std::thread thread_;
};
constexpr std::chrono::seconds kPatience{120};  // far beyond what any machine needs for the frames between

// A clock that the frames drive.
struct FrameClock {
  struct State {
    std::mutex mutex;
    std::condition_variable changed;
    double now = 0;
    bool over = false;
    int asleep = 0, slept = 0;
  };
  std::shared_ptr<State> state = std::make_shared<State>();
  SourceClock clock() const {
    return {[s = state] {
              std::lock_guard lock(s->mutex);
              return s->now;
            },
            [s = state](double until_s) {
              std::unique_lock lock(s->mutex);
              ++s->asleep, ++s->slept;
              s->changed.wait(lock, [&] { return s->over || s->now >= until_s; });
              --s->asleep;
            }};
  }
  void set(double now_s, bool over = false) const {
    {
      std::lock_guard lock(state->mutex);
      state->now = now_s;
      state->over = over;
    }
    state->changed.notify_all();
  }
  int asleep() const {
    std::lock_guard lock(state->mutex);
    return state->asleep;
  }
  int slept() const {
    std::lock_guard lock(state->mutex);
    return state->slept;
  }
};

struct Defects {
  uint64_t inside = 0, background = 0, black = 0;
};

// A ray that crosses the planes of the highest and of the lowest height both within the artwork meets the surface
// between them: such a pixel is artwork. The test artwork is nowhere black under a light from the front.
Defects defectsOf(const std::vector<uint8_t>& pixels, int width, int height, const ViewTransform& view,
                  const FlatDomain& d, bool relief) {
  glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
  double half_w = 0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
         half_h = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px;
  double low = relief ? d.relief_offset_mm : 0, high = relief ? low + 65535 * d.relief_scale_mm : 0;
  Defects defects;
  if (view.eye_mm.z <= high) return defects;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      glm::dvec4 far_point = world_from_clip * glm::dvec4((x + 0.5) / width * 2 - 1, 1 - (y + 0.5) / height * 2, 1, 1);
      glm::dvec3 direction = glm::dvec3(far_point) / far_point.w - view.eye_mm;
      if (direction.z >= -1e-12) continue;
      bool in = true;
      for (double z : {low, high}) {
        glm::dvec3 p = view.eye_mm + direction * ((z - view.eye_mm.z) / direction.z);
        // Two pixels' footprint away from the outline.
        double margin =
            2 * glm::length(p - view.eye_mm) / view.pixels_per_radian * glm::length(direction) / -direction.z;
        in = in && std::abs(p.x) < half_w - margin && std::abs(p.y) < half_h - margin;
      }
      if (!in) continue;
      ++defects.inside;
      const uint8_t* p = &pixels[(static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)) * 4];
      defects.background += p[3] == 0;
      defects.black += p[3] != 0 && p[0] < 4 && p[1] < 4 && p[2] < 4;
    }
  }
  return defects;
}

// Where nobody looks at colours, but for holes.
const Scene kPlain{.sampling = Sampling::kNearest};

class EngineFaults : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string why;
    package_ = test::noisePackageOnce(2001, 1101, Basis::kPtmLrgb, 12, 5, &why);
    ASSERT_TRUE(package_) << why;
  }
  std::unique_ptr<Engine> makeEngine(std::shared_ptr<const PageSource> source, EngineOptions options = {},
                                     Scene scene = {}) {
    Artwork artwork = artworkFromPackage(package_);
    artwork.source = source;
    return test::makeEngine(artwork, scene, options, kWidth, kHeight);
  }
  static OrbitCamera camera(double turn) {
    OrbitCamera c;
    c.azimuth_deg = 40 * std::sin(turn);
    c.elevation_deg = 25 * std::cos(1.7 * turn);
    c.distance_mm = 90 + 50 * std::sin(2.3 * turn);
    c.target_mm = {60 * std::cos(turn), 25 * std::sin(turn), 0};
    return c;
  }
  // The picture just drawn has no defect.
  void expectSound(Engine& e, uint64_t* inside = nullptr) {
    Defects d = defectsOf(e.readPixels(), e.width(), e.height(), e.view(), e.manifest().domain.flat(), e.plan().relief);
    EXPECT_EQ(d.background, 0u) << "of " << d.inside;
    EXPECT_EQ(d.black, 0u) << "of " << d.inside;
    if (inside) *inside += d.inside;
  }
  std::vector<uint8_t> settledPicture(const Scene& scene, const OrbitCamera& c) {
    auto e = makeEngine(package_, {}, scene);
    e->setCamera(c);
    auto settled = e->settle(60);
    EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
    return e->readPixels();
  }

  std::shared_ptr<const Package> package_;
};

// An oracle whose answers, and so the LOD worker's, can be held up.
class GatedOracle final : public ReliefOracle {
 public:
  explicit GatedOracle(std::shared_ptr<const ReliefOracle> inner) : inner_(std::move(inner)) {}
  HeightBounds bounds(const NodeId& page) const override {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return open_; });
    return inner_->bounds(page);
  }
  void open(bool is_open) const {
    {
      std::lock_guard lock(mutex_);
      open_ = is_open;
    }
    changed_.notify_all();
  }

 private:
  std::shared_ptr<const ReliefOracle> inner_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  mutable bool open_ = true;
};

// Each picture but the first is drawn with a list that was asked for before; how long is counted, frame by frame. A
// worker that is held up for 7 frames makes it 1 to 7; one whose answer is waited for before each frame makes it 1.
TEST_F(EngineFaults, TheAgeOfPatchListsIsCounted) {
  Artwork artwork = artworkFromPackage(package_);
  auto gate = std::make_shared<GatedOracle>(artwork.oracle);
  artwork.oracle = gate;
  EngineOptions options;
  options.prefetch = false;  // asks the oracle, too
  auto engine = test::makeEngine(artwork, {}, options, kWidth, kHeight);
  ASSERT_TRUE(engine);
  int frames = 0;
  auto draw = [&] {
    engine->setCamera(camera(0.05 * frames));
    engine->frame(0.016 * frames++);
  };
  draw();
  EXPECT_EQ(engine->stats().lod_lag_frames.count, 0u);
  gate->open(false);
  constexpr int kHeld = 7, kWaited = 8;
  for (int i = 0; i < kHeld; ++i) draw();
  const LatencySummary held = engine->stats().lod_lag_frames;
  gate->open(true);
  EXPECT_EQ(held.count, uint64_t{kHeld});
  EXPECT_EQ(held.p50, (kHeld + 1) / 2);
  EXPECT_EQ(held.max, kHeld);
  for (int i = 0; i < kWaited; ++i) {
    ASSERT_TRUE(engine->settle(60).ok());
    draw();
  }
  const LatencySummary age = engine->stats().lod_lag_frames;
  EXPECT_EQ(age.count, uint64_t{kHeld + kWaited});
  EXPECT_EQ(age.p50, 1);  // 9 of 15
  EXPECT_EQ(age.max, kHeld);
}

// --- a source that never answers ---

TEST_F(EngineFaults, ASourceThatNeverAnswersStopsNoFrame) {
  auto gate = std::make_shared<fake::GatedSource>(package_, true);
  auto engine = makeEngine(gate, {}, kPlain);
  ASSERT_TRUE(engine);
  gate->open(false);
  Rescue rescue(gate, kPatience);
  Engine& e = *engine;
  uint64_t inside = 0;
  double now_s = 0;
  for (int i = 0; i < 150; ++i) {
    e.setCamera(camera(i * 0.05));
    Scene scene = e.scene();
    scene.light = {0.2 * std::sin(0.1 * i), 0.1, 1};
    if (i % 10 == 3) scene.relight = !scene.relight;  // other planes: their roots never come
    if (i % 10 == 6) scene.relief = !scene.relief;
    if (i % 10 == 8) scene.wireframe = !scene.wireframe;
    ASSERT_TRUE(e.setScene(scene).ok());
    if (i % 20 == 10) e.resize(kWidth + i, kHeight - i / 10);
    e.frame(now_s += 0.016);
    if (!scene.wireframe) expectSound(e, &inside);
    ASSERT_FALSE(HasFailure()) << "frame " << i;
  }
  EXPECT_GT(inside, 1'000'000u);
  EngineStats s = e.stats();
  EXPECT_EQ(s.frames, 150u);
  EXPECT_GT(s.missing_pages, 0u) << "was anything asked for?";
  EXPECT_TRUE(e.takeMessages().empty()) << "late is not failed";
  EXPECT_FALSE(rescue.end()) << "the render thread waited for the source";
  gate->open();  // the engine's end waits for the reads under way
}

TEST_F(EngineFaults, TheRescueSeesAThreadThatWaits) {
  auto gate = std::make_shared<fake::GatedSource>(package_, false);
  Rescue rescue(gate, std::chrono::milliseconds(200));
  auto engine = makeEngine(gate);  // starting waits for the coarsest pages
  EXPECT_TRUE(rescue.end());
}

TEST_F(EngineFaults, ADefectIsSeen) {
  auto e = makeEngine(package_);
  e->setCamera(camera(1));
  ASSERT_TRUE(e->settle(60).ok());
  auto pixels = e->readPixels();
  auto defects = [&] { return defectsOf(pixels, kWidth, kHeight, e->view(), e->manifest().domain.flat(), true); };
  ASSERT_EQ(defects().background + defects().black, 0u);
  uint8_t* middle = &pixels[(kHeight / 2 * kWidth + kWidth / 2) * 4];
  std::fill(middle, middle + 3, uint8_t{0});
  EXPECT_EQ(defects().black, 1u);
  middle[3] = 0;
  EXPECT_EQ(defects().background, 1u);
}

// While nothing arrives, the picture is the one of an artwork that has no finer pages.
TEST_F(EngineFaults, WhatIsLateShowsItsAncestor) {
  class RootsOnly final : public PageSource {
   public:
    explicit RootsOnly(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
    Result<EncodedPage> read(PageId id) const override {
      if (id.node().level > 0) return Error{ErrorKind::kInvalidData, "", "there is no such page", "", {}};
      return inner_->read(id);
    }

   private:
    std::shared_ptr<const PageSource> inner_;
  };
  auto gate = std::make_shared<fake::GatedSource>(package_, true);
  auto late = makeEngine(gate), coarse = makeEngine(std::make_shared<RootsOnly>(package_)),
       whole = makeEngine(package_);
  gate->open(false);
  for (double turn : {0.3, 2.0, 4.4}) {
    for (Engine* e : {late.get(), coarse.get()}) {
      e->setCamera(camera(turn));
      for (int i = 0; i < 40; ++i) {
        e->frame(0.02 * i);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the LOD worker's turn: its newest list is drawn
      }
    }
    EXPECT_EQ(late->readPixels(), coarse->readPixels());
    whole->setCamera(camera(turn));
    ASSERT_TRUE(whole->settle(60).ok());
    EXPECT_NE(whole->readPixels(), coarse->readPixels()) << "are the finer pages in view at all?";
  }
  gate->open();
  ASSERT_TRUE(late->settle(60).ok());
  EXPECT_EQ(late->readPixels(), whole->readPixels()) << "once it answers, nothing is left of it";
}

// --- a change of planes ---

TEST_F(EngineFaults, AnotherSetOfPlanesShowsOnceItsRootsAreThere) {
  auto gate = std::make_shared<fake::GatedSource>(package_, true);
  auto engine = makeEngine(gate);
  Engine& e = *engine;
  e.setCamera(camera(1));
  ASSERT_TRUE(e.settle(60).ok());
  auto before = e.readPixels();
  gate->open(false);
  Rescue rescue(gate, kPatience);
  Scene fixed;
  fixed.relight = false;
  ASSERT_TRUE(e.setScene(fixed).ok());
  for (int i = 0; i < 10; ++i) e.frame(0.02 * i);
  EXPECT_TRUE(e.stats().switching);
  EXPECT_FALSE(e.scene().relight) << "what was asked for";
  EXPECT_FALSE(e.plan().resolve) << "what is shown";
  EXPECT_EQ(e.readPixels(), before);
  EXPECT_FALSE(rescue.end());
  gate->open();
  for (Scene scene :
       {fixed, Scene{.relief = false}, Scene{}, Scene{.light = {0.4, 0.2, 0.7}, .relief = false, .relight = false}}) {
    ASSERT_TRUE(e.setScene(scene).ok());
    ASSERT_TRUE(e.settle(60).ok());
    EXPECT_FALSE(e.stats().switching);
    EXPECT_EQ(e.plan().resolve, !scene.relight);
    EXPECT_EQ(e.plan().relief, scene.relief);
    EXPECT_EQ(e.readPixels(), settledPicture(scene, e.camera())) << "something is left of the planes before";
  }
}

TEST_F(EngineFaults, ScenesThatChangeFasterThanPlanesArriveEndWithTheLast) {
  auto gate = std::make_shared<fake::GatedSource>(package_, true);
  auto engine = makeEngine(gate);
  Engine& e = *engine;
  e.setCamera(camera(2));
  gate->open(false);
  Scene scene;
  for (int i = 0; i < 40; ++i) {
    scene.relight = i % 2 == 0;
    scene.relief = i % 3 == 0;
    scene.exaggerate = i % 5 == 0 ? 0 : 1.5;
    ASSERT_TRUE(e.setScene(scene).ok());
    e.frame(0.02 * i);
  }
  gate->open();
  ASSERT_TRUE(e.settle(60).ok());
  EXPECT_EQ(e.readPixels(), settledPicture(scene, e.camera()));
  // Back before the others came: nothing changes.
  gate->open(false);
  auto before = e.readPixels();
  Scene other = scene;
  other.relight = !other.relight;
  ASSERT_TRUE(e.setScene(other).ok());
  e.frame(1);
  ASSERT_TRUE(e.setScene(scene).ok());
  EXPECT_FALSE(e.stats().switching);
  for (int i = 0; i < 5; ++i) e.frame(1.1);
  EXPECT_EQ(e.readPixels(), before);
  gate->open();
}

// --- reads that go wrong ---

// How often each page failed.
class CountingSource final : public PageSource {
 public:
  explicit CountingSource(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  Result<EncodedPage> read(PageId id) const override {
    auto page = inner_->read(id);
    std::lock_guard lock(mutex_);
    if (!page) most_ = std::max(most_, ++failures_[id]);
    return page;
  }
  int most() const {
    std::lock_guard lock(mutex_);
    return most_;
  }

 private:
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::map<PageId, int> failures_;
  mutable int most_ = 0;
};

TEST_F(EngineFaults, FramesGoOnWhileReadsFailAndWhatFailedIsNamedOnce) {
  FrameClock time;
  FailingSource::Rates rates{.fail = 0.1, .truncate = 0.1, .corrupt = 0.1, .permanent = 0.02, .late = 0.1, .late_s = 5};
  auto failing = std::make_shared<FailingSource>(package_, rates, kSeed, time.clock());
  auto checked = std::make_shared<CheckedSource>(failing, checksumsOf(package_));
  auto counting = std::make_shared<CountingSource>(checked);
  time.set(0, true);  // the roots come without delay
  EngineOptions options;
  options.workers = 8;
  auto engine = makeEngine(counting, options, kPlain);
  Engine& e = *engine;
  std::vector<std::string> messages = e.takeMessages();
  time.set(0);
  uint64_t inside = 0;
  int frames = 0, frames_with_late_reads = 0;
  double now_s = 0;
  auto run = [&](int count, bool moving) {
    for (int i = 0; i < count; ++i, ++frames) {
      if (moving) e.setCamera(camera(i * 0.04));
      time.set(now_s += 0.1);
      e.frame(now_s);
      frames_with_late_reads += time.asleep() > 0;
      if (i % 5 == 0) expectSound(e, &inside);
      for (auto& m : e.takeMessages()) messages.push_back(m);
    }
  };
  run(200, true);
  int still = 0;
  do {  // until everything has come or failed for good
    run(20, false);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  } while (++still < 1000 && (e.stats().streamer.queued + e.stats().streamer.decoding > 0 ||
                              e.stats().missing_pages > e.stats().streamer.failed_pages));
  const StreamerStats s = e.stats().streamer;
  std::printf(
      "[ faults ] seed %u: %d frames, %d while a read was 5 s late (%d such reads), %llu retries, %llu pages failed\n",
      kSeed, frames, frames_with_late_reads, time.slept(), static_cast<unsigned long long>(s.retries),
      static_cast<unsigned long long>(s.failed_pages));
  EXPECT_GT(frames_with_late_reads, 50);
  EXPECT_GT(inside, 1'000'000u);
  EXPECT_GT(checked->caught(), 20u);
  EXPECT_GT(s.retries, 20u);
  EXPECT_LE(counting->most(), kMaxAttempts);
  EXPECT_GT(s.failed_pages, 0u);
  EXPECT_EQ(messages.size(), s.failed_pages);
  EXPECT_EQ(std::set(messages.begin(), messages.end()).size(), messages.size()) << "named twice";
  uint64_t retries = s.retries;
  run(100, false);
  EXPECT_EQ(e.stats().streamer.retries, retries) << "no retry storm";
  EXPECT_EQ(messages.size(), s.failed_pages) << "named again";
  time.set(0, true);
}

// Faults that pass leave no trace: the picture is that of sound storage. Without the checksum it is not (the negative
// control).
TEST_F(EngineFaults, FaultsThatPassLeaveNoTrace) {
  const OrbitCamera view = camera(0.8);
  const auto sound = settledPicture({}, view);
  auto picture = [&](bool with_check) {
    auto failing = std::make_shared<FailingSource>(
        package_, FailingSource::Rates{.fail = 0.04, .truncate = 0.03, .corrupt = 0.05}, kSeed);
    std::shared_ptr<const PageSource> source = failing;
    if (with_check) source = std::make_shared<CheckedSource>(source, checksumsOf(package_));
    auto e = makeEngine(source);
    e->setCamera(view);
    auto settled = e->settle(60);
    EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
    EXPECT_EQ(e->stats().streamer.failed_pages, 0u) << "another seed, please: " << e->takeMessages().front();
    return e->readPixels();
  };
  EXPECT_EQ(picture(true), sound);
  EXPECT_NE(picture(false), sound) << "damage shows without the check: is it needed?";
}

// --- small caches ---

uint64_t uploadsOf(const StreamerStats& s) {
  uint64_t sum = 0;
  for (uint64_t n : s.pages_uploaded) sum += n;
  return sum;
}

// Nobody chose the cache's size: it becomes what the artwork needs and some more, which is said, but never more than
// may be taken.
TEST_F(EngineFaults, ACacheThatIsTooSmallGrows) {
  EngineOptions options;
  options.cache_mib = 0.5;
  const Artwork artwork = artworkFromPackage(package_);
  options.most_cache_mib = kSpareCacheMib + 0.5;
  auto refused = Engine::create(artwork, {}, options);
  ASSERT_FALSE(refused.ok());
  EXPECT_NE(refused.error().text().find("of 0.5 MiB is too small"), std::string::npos) << refused.error().text();
  options.most_cache_mib = 1024;
  auto engine = Engine::create(artwork, {}, options);
  ASSERT_TRUE(engine.ok()) << engine.error().text();
  const auto notices = (*engine)->takeNotices();
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_NE(notices[0].find("the page cache takes"), std::string::npos) << notices[0];
  EXPECT_GT((*engine)->stats().cache_bytes, uint64_t{40} << 20);
  EXPECT_LT((*engine)->stats().cache_bytes, uint64_t{80} << 20);
  options.cache_mib = 64;
  EXPECT_TRUE((*Engine::create(artwork, {}, options))->takeNotices().empty()) << "the control: it is large enough";
}

TEST_F(EngineFaults, TheSmallestLegalCacheDraws) {
  EngineOptions options;
  const FlatDomain d = package_->manifest().domain.flat();
  auto mib = [](double slots) { return slots * static_cast<double>(kSlotBytes) / (1024 * 1024); };
  const uint32_t least = d.patchCount() * 4 + 16;
  options.cache_mib = mib(least - 0.5);
  EXPECT_FALSE(Engine::create(artworkFromPackage(package_), {}, options).ok()) << "is it the smallest?";
  options.cache_mib = mib(least + 0.5);
  auto engine = makeEngine(package_, options, kPlain);
  ASSERT_TRUE(engine);
  uint64_t inside = 0;
  for (int i = 0; i < 100; ++i) {
    engine->setCamera(camera(i * 0.06));
    engine->frame(0.02 * i);
    expectSound(*engine, &inside);
    ASSERT_LE(engine->stats().resident, least);
  }
  EXPECT_GT(inside, 1'000'000u);
  EXPECT_GT(uploadsOf(engine->stats().streamer), least) << "does it stream at all?";
}

// Relief alone that the cache has no place for: the view gives up detail until it fits. What exceeds the cache with the
// least detail, too, ends with an error as soon as no page is under way, long before this timeout.
TEST_F(EngineFaults, AViewOfMoreReliefThanTheCacheHoldsEnds) {
  if (test::openGlEs() && !test::longTests()) return;  // nothing here depends on what draws
  constexpr double kWithoutEnd_s = 1e6;
  EngineOptions options;
  options.cache_mib = (package_->manifest().domain.flat().patchCount() * 4 + 16.5) * double{kSlotBytes} / (1024 * 1024);
  Scene scene = kPlain;
  scene.least_cell = 0;
  const auto settle = [&](double error_px, std::shared_ptr<const PageSource> source) {
    scene.error_px = error_px;
    auto engine = makeEngine(std::move(source), options, scene);
    OrbitCamera near;
    near.distance_mm = 150;
    engine->setCamera(near);
    const auto settled = engine->settle(kWithoutEnd_s);
    return std::pair(settled ? "" : settled.error().text(), engine->stats().detail_bias);
  };
  const auto [problem, bias] = settle(0.2, package_);
  EXPECT_EQ(problem, "");
  EXPECT_GT(bias, 0.3) << "is there any pressure?";
  EXPECT_LT(bias, kMaxDetailBias / 2) << "it gives up no more than it must";
  const std::string unsettled = settle(0, package_).first;
  EXPECT_NE(unsettled.find("cannot settle: 0 pages under way"), std::string::npos) << unsettled;
  EXPECT_NE(unsettled.find("raise --cache-mib"), std::string::npos) << unsettled;
  // Reads that fail, and wait to be tried again, end nothing.
  const auto failing =
      std::make_shared<FailingSource>(package_, FailingSource::Rates{.fail = 0.04, .truncate = 0.04}, kSeed);
  EXPECT_EQ(settle(0.2, failing).first, "");
  EXPECT_GT(failing->maxAttempts(), 1) << "another seed, please";
}

TEST_F(EngineFaults, ACacheOfAQuarterOfTheWorkingSetEndsStill) {
  // The whole picture a little finer than the screen, so that hundreds of pages are in view.
  constexpr int kWide = 960, kHigh = 540;
  OrbitCamera near;
  near.distance_mm = 100;
  uint32_t working_set = 0;
  {
    auto e = makeEngine(package_, {}, kPlain);
    e->resize(kWide, kHigh);
    e->setCamera(near);
    ASSERT_TRUE(e->settle(60).ok());
    working_set = e->stats().resident;
  }
  EngineOptions options;
  options.cache_mib = 0.25 * working_set * static_cast<double>(kSlotBytes) / (1024 * 1024);
  auto engine = makeEngine(package_, options, kPlain);
  ASSERT_TRUE(engine);
  Engine& e = *engine;
  e.resize(kWide, kHigh);
  double now_s = 0;
  auto step = [&] {
    e.frame(now_s += 0.016);
    e.readPixels();  // as a display would, so that the workers' time is a frame's
  };
  e.setCamera(near);
  int last_load = 0, frames = 0;
  uint64_t loads = uploadsOf(e.stats().streamer);
  double low = 99, high = 0;
  for (; frames < (test::longTests() ? 160 : 100); ++frames) {
    step();
    uint64_t now_loads = uploadsOf(e.stats().streamer);
    if (now_loads != loads) last_load = frames;
    loads = now_loads;
    if (frames >= 60) low = std::min(low, e.stats().detail_bias), high = std::max(high, e.stats().detail_bias);
  }
  expectSound(e);
  std::printf(
      "[ pressure ] working set %u pages, cache %u: last load in frame %d, bias %.2f, from frame 60 on within "
      "%.3f..%.3f\n",
      working_set, e.stats().slots, last_load, e.stats().detail_bias, low, high);
  EXPECT_GT(e.stats().detail_bias, 0.3) << "is there any pressure?";
  EXPECT_LT(last_load, 60);
  EXPECT_LE(high - low, 0.05 + 1e-9);
  // Relief: a view that fits.
  OrbitCamera far = near;
  far.distance_mm = 4000;
  e.setCamera(far);
  int calm = 0;
  for (; calm < 120 && e.stats().detail_bias > 0; ++calm) step();
  std::printf("[ pressure ] bias 0 again after %d frames\n", calm);
  EXPECT_LE(calm, 30);
}

}  // namespace engine_faults_gltest
}  // namespace relievo
