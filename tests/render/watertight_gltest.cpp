// Watertight: vertices that patches share have the same bits, whatever their levels, pages and arrival order, and no
// background shows through the artwork. Each has a negative control: snapping off.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <random>
#include <thread>

#include "geometry/lod/planar_lod.h"
#include "geometry/lod/snap.h"
#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "tests/render/test_artwork.h"
#include "tests/view_share.h"

namespace relievo {
namespace watertight_gltest {

constexpr int kWidth = 320, kHeight = 180;
constexpr uint32_t kSeed = 20261121;

class Watertight : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string why;
    // Two patches along the strip, sizes that are no multiple of anything.
    package_ = test::noisePackageOnce(3001, 1501, Basis::kColour, 24, 5, &why);
    ASSERT_TRUE(package_) << why;
  }
  std::unique_ptr<Engine> makeEngine(double error_px) {
    Scene scene;
    scene.error_px = error_px;
    scene.sampling = Sampling::kNearest;  // nobody looks at colours
    scene.unlit = true;
    EngineOptions options;
    options.cache_mib = 12;         // small: pages come and go
    options.uploads_per_frame = 6;  // slow: most frames see a mix of levels
    auto engine = Engine::create(artworkFromPackage(package_), scene, options);
    EXPECT_TRUE(engine.ok()) << (engine.ok() ? "" : engine.error().text());
    (*engine)->resize(kWidth, kHeight);
    return std::move(*engine);
  }
  OrbitCamera randomCamera(std::mt19937& random) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    OrbitCamera c;
    c.azimuth_deg = uniform(-78, 78);
    c.elevation_deg = uniform(-70, 70);
    c.fov_deg = uniform(15, 90);
    c.distance_mm = std::exp(uniform(std::log(6.0), std::log(600.0)));
    c.target_mm = {uniform(-140, 140), uniform(-70, 70), uniform(-8, 8)};
    return c;
  }

  std::shared_ptr<const Package> package_;
};

// Frames until the newest camera's list is drawn, and at least three: pages are still coming then.
void drawUntilSeen(Engine& engine, double now_s) {
  const glm::dmat4 older = engine.view().clip_from_world;
  for (int i = 0; i < 3 || (i < 2000 && engine.view().clip_from_world == older); ++i) {
    if (i >= 3) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    engine.frame(now_s + 0.001 * i);
  }
}

struct SharedVertex {
  uint64_t key;  // its global integer place
  uint32_t bits[4];
};

struct Comparison {
  uint64_t compared = 0, different = 0, captured = 0;
};

// Every pair of vertices at one place, within one captured list.
void compareShared(Engine& engine, Comparison* total) {
  const auto& instances = engine.instances();
  auto floats = engine.captureVertices(40'000'000);
  if (instances.empty()) return;
  ASSERT_FALSE(floats.empty());
  const FlatDomain domain = engine.manifest().domain.flat();
  auto limit_x = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2,
       limit_y = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
  std::vector<SharedVertex> shared;
  size_t at = 0;
  bool any_nonzero = false;
  for (const PatchInstance& p : instances) {
    uint32_t last = 1u << p.grid_level;
    for (uint32_t j = 0; j <= last; ++j) {
      for (uint32_t i = 0; i <= last; ++i, at += 4) {
        any_nonzero = any_nonzero || floats[at + 3] != 0;
        if (i != 0 && j != 0 && i != last && j != last) continue;
        auto s = snapVertex(i, j, p);
        int64_t x = std::min(p.x0 + (int64_t{s[0]} << p.step_log2), limit_x),
                y = std::min(p.y0 + (int64_t{s[1]} << p.step_log2), limit_y);
        SharedVertex v{static_cast<uint64_t>(x) << 32 | static_cast<uint64_t>(y), {}};
        std::memcpy(v.bits, &floats[at], 16);
        shared.push_back(v);
      }
    }
  }
  ASSERT_EQ(at, floats.size());
  ASSERT_TRUE(any_nonzero) << "transform feedback answered zeros";
  total->captured += shared.size();
  std::sort(shared.begin(), shared.end(), [](const SharedVertex& a, const SharedVertex& b) { return a.key < b.key; });
  for (size_t i = 1; i < shared.size(); ++i) {
    if (shared[i].key != shared[i - 1].key) continue;
    ++total->compared;
    total->different += std::memcmp(shared[i].bits, shared[i - 1].bits, 16) != 0;
  }
}

TEST_F(Watertight, SharedVerticesAreBitIdentical) {
  auto engine = makeEngine(0.125);
  std::mt19937 random(kSeed);
  Comparison total;
  int frames = 0;
  const uint64_t wanted = test::glShare(uint64_t{10'000'000});
  for (; total.compared < wanted && frames < 6000; ++frames) {
    if (frames % 3 == 0) engine->setCamera(randomCamera(random));
    engine->frame(frames * 0.016);
    compareShared(*engine, &total);
    if (HasFatalFailure()) return;
  }
  std::printf("[ watertight ] seed %u: %llu comparisons over %d frames, %llu differ\n", kSeed,
              (unsigned long long)total.compared, frames, (unsigned long long)total.different);
  EXPECT_GE(total.compared, wanted);
  EXPECT_EQ(total.different, 0u);
}

TEST_F(Watertight, SnappingOffBreaksTheBits) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  auto engine = makeEngine(0.125);
  ASSERT_TRUE(injectFaults(*engine, {.no_snapping = true}).ok());
  std::mt19937 random(kSeed);
  Comparison total;
  for (int frames = 0; frames < 30 && total.different == 0; ++frames) {
    if (frames % 3 == 0) engine->setCamera(randomCamera(random));
    engine->frame(frames * 0.016);
    compareShared(*engine, &total);
  }
  EXPECT_GT(total.different, 0u) << "of " << total.compared;
}

// A ray that crosses the planes of the highest and of the lowest height both within the artwork's outline must meet the
// surface between them: such a pixel can't be background.
uint64_t holes(Engine& engine, uint64_t* inside) {
  auto pixels = engine.readPixels();
  ViewTransform view = engine.view();
  const FlatDomain d = engine.manifest().domain.flat();
  glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
  double half_w = 0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
         half_h = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px;
  double low = d.relief_offset_mm, high = low + 65535 * d.relief_scale_mm;
  if (view.eye_mm.z <= high) return 0;  // the eye is inside the relief's slab: nothing is promised
  uint64_t count = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      glm::dvec4 far_point =
          world_from_clip * glm::dvec4((x + 0.5) / kWidth * 2 - 1, 1 - (y + 0.5) / kHeight * 2, 1, 1);
      glm::dvec3 direction = glm::dvec3(far_point) / far_point.w - view.eye_mm;
      if (direction.z >= -1e-12) continue;
      bool in = true;
      for (double z : {low, high}) {
        glm::dvec3 p = view.eye_mm + direction * ((z - view.eye_mm.z) / direction.z);
        // Half a pixel's footprint away from the outline.
        double footprint =
            glm::length(p - view.eye_mm) / view.pixels_per_radian * glm::length(direction) / -direction.z;
        in = in && std::abs(p.x) < half_w - footprint && std::abs(p.y) < half_h - footprint;
        glm::dvec4 clip = view.clip_from_world * glm::dvec4(p, 1);
        in = in && clip.w > 0 && clip.z > -clip.w && clip.z < clip.w;
      }
      if (!in) continue;
      ++*inside;
      count += pixels[static_cast<size_t>(y * kWidth + x) * 4 + 3] == 0;
    }
  }
  return count;
}

TEST_F(Watertight, NoBackgroundShowsThrough) {
  auto engine = makeEngine(1.0);
  std::mt19937 random(kSeed + 1);
  uint64_t inside = 0, background = 0;
  const int views = test::glShare(1000);
  for (int view = 0; view < views; ++view) {
    engine->setCamera(randomCamera(random));
    drawUntilSeen(*engine, view * 0.1);
    background += holes(*engine, &inside);
  }
  std::printf("[ watertight ] seed %u: %d views, %llu pixels inside, %llu of them background\n", kSeed + 1, views,
              (unsigned long long)inside, (unsigned long long)background);
  EXPECT_GT(inside, test::glShare(uint64_t{10'000'000}));
  EXPECT_EQ(background, 0u);
}

TEST_F(Watertight, SnappingOffLetsTheBackgroundThrough) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  auto engine = makeEngine(1.0);
  ASSERT_TRUE(injectFaults(*engine, {.no_snapping = true}).ok());
  std::mt19937 random(kSeed + 1);
  uint64_t inside = 0, background = 0;
  for (int view = 0; view < 300 && background == 0; ++view) {
    engine->setCamera(randomCamera(random));
    for (int k = 0; k < 3; ++k) engine->frame(view * 0.1 + k * 0.01);
    background += holes(*engine, &inside);
  }
  EXPECT_GT(background, 0u) << "of " << inside;
}

}  // namespace watertight_gltest
}  // namespace relievo
