// Watertight over a base mesh: vertices that patches share have the same bits, whatever their levels, orientations,
// pages and arrival order, and no background shows through a closed body. Negative controls: snapping off; sides
// interpolated in the patch's own direction.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <functional>
#include <random>
#include <thread>

#include "geometry/lod/snap.h"
#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/render/made_engine.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace mesh_watertight_gltest {

constexpr int kWidth = 320, kHeight = 180;
constexpr uint64_t kSeed = 20261121;

// Pages of noise over a base mesh, made when they are asked for; one colour a patch.
class NoisePages final : public PageSource {
 public:
  NoisePages(test::MeshHeight height, int unit_log2) : height_(std::move(height)), unit_log2_(unit_log2) {}
  Result<EncodedPage> read(PageId id) const override {
    PageEncoder encoder(1);
    const NodeId n = id.node();
    std::span<const uint8_t> bytes;
    if (id.plane() == Plane::kRelief) {
      std::vector<uint16_t> samples(kReliefPageSamples);
      const int step_log2 = unit_log2_ - 7 - static_cast<int>(n.level);
      for (uint32_t y = 0; y <= kPagePx; ++y)
        for (uint32_t x = 0; x <= kPagePx; ++x)
          samples[y * kReliefSamples + x] =
              height_(n.patch, (n.x * kPagePx + x) << step_log2, (n.y * kPagePx + y) << step_log2);
      bytes = encoder.encodeRelief(samples);
    } else {
      std::vector<uint8_t> channels(kTexturePageBytes);
      for (size_t i = 0; i < channels.size(); ++i)
        channels[i] = static_cast<uint8_t>(60 + (n.patch * 37 + i / (channels.size() / 3) * 91) % 150);
      bytes = encoder.encodeTexture(channels);
    }
    return EncodedPage{{bytes.begin(), bytes.end()}};
  }

 private:
  test::MeshHeight height_;
  int unit_log2_;
};

struct Body {
  std::shared_ptr<const BaseMesh> mesh;
  Artwork artwork;
};
// Heights of which every (1 << up)-th sample is `fine`'s; between them, on the cells' triangles, rounded, as
// MeshBake::heights() has it. In every third patch only along the sides. Patches of 2^7 cells.
test::MeshHeight fewerCells(test::MeshHeight fine, int up) {
  return [fine, up](uint32_t patch, uint32_t x, uint32_t y) -> uint16_t {
    const bool on_side = x == 0 || y == 0 || x == kPagePx || y == kPagePx;
    if (patch % 3 == 0 && !on_side) return fine(patch, x, y);
    const uint32_t cells = 1u << up, x0 = std::min(x & ~(cells - 1), kPagePx - cells),
                   y0 = std::min(y & ~(cells - 1), kPagePx - cells);
    const uint32_t fx = x - x0, fy = y - y0;
    const auto at = [&](uint32_t i, uint32_t j) { return uint32_t{fine(patch, x0 + i * cells, y0 + j * cells)}; };
    const uint32_t sum = fx >= fy ? at(0, 0) * (cells - fx) + at(1, 0) * (fx - fy) + at(1, 1) * fy
                                  : at(0, 0) * (cells - fy) + at(0, 1) * (fy - fx) + at(1, 1) * fx;
    return static_cast<uint16_t>((sum + cells / 2) >> up);
  };
}

// `fine`'s upper ten bits, about the middle: pages of them fit their compact form. In every fourth patch only along the
// sides.
test::MeshHeight gentle(test::MeshHeight fine, int unit_log2) {
  return [fine, side = 1u << unit_log2](uint32_t patch, uint32_t x, uint32_t y) -> uint16_t {
    const bool on_side = x == 0 || y == 0 || x == side || y == side;
    const uint16_t q = fine(patch, x, y);
    return patch % 4 == 0 && !on_side ? q : static_cast<uint16_t>(30000 + (q >> 6));
  };
}

Body makeBody(BaseMesh mesh, int depth, double relief_mm, int coarser = 0, bool compact = false) {
  Body body;
  body.mesh = std::make_shared<const BaseMesh>(std::move(mesh));
  Manifest& m = body.artwork.manifest;
  m.base = body.mesh;
  m.domain = PatchDomain::overMesh(static_cast<uint32_t>(body.mesh->patches.size()));
  m.domain.mm_per_px = 0.2;
  m.domain.relief_depth = depth;
  m.domain.relief_offset_mm = -relief_mm / 2;
  m.domain.relief_scale_mm = relief_mm / 65535;
  test::MeshRelief relief{depth, m.domain.relief_offset_mm, m.domain.relief_scale_mm};
  test::MeshHeight height = [mesh = body.mesh, noise = test::noiseOver(*body.mesh, depth + 7, kSeed)](
                                uint32_t patch, uint32_t x, uint32_t y) { return noise(patch, x, y); };
  if (compact) height = gentle(height, depth + 7);
  auto oracle = std::make_shared<test::MadeUpMeshOracle>(relief, kSeed, relief_mm);
  m.coarse_errors = oracle->coarse(body.mesh->patches.size());
  body.artwork.oracle = oracle;
  body.artwork.source = std::make_shared<NoisePages>(coarser == 0 ? height : fewerCells(height, coarser), depth + 7);
  return body;
}

const bool kFewer = test::openGlEs() && !test::longTests();

// With OpenGL ES every third. Patches are cut in every other one.
std::vector<test::NamedMesh> meshes() {
  std::vector<test::NamedMesh> all = test::wellShapedMeshes(), some;
  for (size_t k = 0; k < all.size(); ++k) all[k].mesh.cut = k / (kFewer ? 3 : 1) % 2 == 0;
  if (!kFewer) return all;
  for (size_t k = 1; k < all.size(); k += 3) some.push_back(std::move(all[k]));
  return some;
}

class MeshWatertight : public ::testing::Test {
 protected:
  // tails: no root is pinned, patches' tails do for them (texturing/package/patch_tails.h).
  static std::unique_ptr<Engine> makeEngine(const Body& body, double error_px, bool tails = false,
                                            bool geomorph = false, bool small_relief = true,
                                            bool compact_relief = true) {
    Scene scene;
    scene.geomorph = geomorph;
    scene.error_px = error_px;
    EngineOptions options;
    options.cache_mib = 4 + 0.16 * static_cast<double>(body.mesh->patches.size());  // pages come and go
    options.most_pinned_patches = tails ? 0 : kMaxPatches;
    options.small_relief = small_relief;
    options.compact_relief = compact_relief;
    options.uploads_per_frame = 6;  // most frames see a mix of levels
    return test::makeEngine(body.artwork, scene, options, kWidth, kHeight);
  }
  static OrbitCamera randomCamera(const BaseMesh& mesh, std::mt19937& random) {
    auto uniform = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    auto [low, high] = test::boxOf(mesh);
    const double size = glm::length(high - low);
    OrbitCamera c;
    c.azimuth_deg = uniform(-180, 180);
    c.elevation_deg = uniform(-89, 89);
    c.fov_deg = uniform(10, 100);
    c.distance_mm = std::exp(uniform(std::log(0.02 * size), std::log(3 * size)));
    auto patch = static_cast<uint32_t>(uniform(0, static_cast<double>(mesh.patches.size()) - 0.001));
    c.target_mm = mesh.point(patch, uniform(0, 1), uniform(0, 1));
    return c;
  }
};

struct Comparison {
  uint64_t compared = 0, different = 0, across_patches = 0;
};

// Every pair of vertices at one place, within one captured list.
void compareShared(Engine& engine, Comparison* total, test::SnapFunction snap = snapVertex) {
  struct Shared {
    test::Place place;
    uint32_t patch;
    std::array<uint32_t, 4> bits;
  };
  const auto& instances = engine.instances();
  auto floats = engine.captureVertices(40'000'000);
  if (instances.empty()) return;
  ASSERT_FALSE(floats.empty());
  const BaseMesh& mesh = *engine.manifest().base;
  const int unit_log2 = 7 + engine.manifest().domain.relief_depth;
  std::vector<Shared> shared;
  size_t at = 0;
  bool any_nonzero = false;
  for (const PatchInstance& p : instances) {
    const uint32_t last = 1u << p.grid_level;
    for (uint32_t j = 0; j <= last; ++j) {
      for (uint32_t i = 0; i <= last; ++i, at += 4) {
        any_nonzero = any_nonzero || floats[at + 3] != 0;
        if (i != 0 && j != 0 && i != last && j != last) continue;
        auto s = snap(i, j, p);
        Shared v{test::placeOf(mesh, unit_log2, p.node.patch, static_cast<uint32_t>(p.x0) + (s[0] << p.step_log2),
                               static_cast<uint32_t>(p.y0) + (s[1] << p.step_log2)),
                 p.node.patch,
                 {}};
        for (size_t k = 0; k < 4; ++k) v.bits[k] = std::bit_cast<uint32_t>(floats[at + k] + 0.0f);  // -0 is 0
        shared.push_back(v);
      }
    }
  }
  ASSERT_EQ(at, floats.size());
  ASSERT_TRUE(any_nonzero) << "transform feedback answered zeros";
  std::sort(shared.begin(), shared.end(), [](const Shared& a, const Shared& b) { return a.place < b.place; });
  for (size_t i = 1; i < shared.size(); ++i) {
    if (shared[i].place != shared[i - 1].place) continue;
    ++total->compared;
    total->across_patches += shared[i].patch != shared[i - 1].patch;
    total->different += shared[i].bits != shared[i - 1].bits;
  }
}

TEST_F(MeshWatertight, SharedVerticesAreBitIdentical) {
  Comparison total;
  int frames = 0;
  for (const test::NamedMesh& named : meshes()) {
    std::mt19937 random(static_cast<uint32_t>(kSeed + named.mesh.patches.size()));
    BaseMesh mesh = named.mesh;
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    Body body = makeBody(mesh, 2, 8);
    auto engine = makeEngine(body, 0.25);
    for (int frame = 0; frame < std::max(3, test::glShare(12)); ++frame, ++frames) {
      if (frame % 3 == 0) engine->setCamera(randomCamera(mesh, random));
      engine->frame(frame * 0.016);
      compareShared(*engine, &total);
      if (HasFatalFailure()) return;
    }
    EXPECT_EQ(total.different, 0u) << named.name;
  }
  std::printf("[ watertight ] seed %llu: %llu comparisons over %d frames, %llu of them across patches, %llu differ\n",
              (unsigned long long)kSeed, (unsigned long long)total.compared, frames,
              (unsigned long long)total.across_patches, (unsigned long long)total.different);
  EXPECT_GE(total.compared, test::glShare(2'000'000u));
  EXPECT_GE(total.across_patches, test::glShare(100'000u));
}

// The same where most patches are drawn from their tails, some from pages: beside each other, and each in turn while
// pages come and go; some bodies with geomorph.
TEST_F(MeshWatertight, TailsAndPagesHaveTheSameBits) {
  Comparison total;
  uint64_t of_tails = 0, of_pages = 0;
  for (const test::NamedMesh& named : meshes()) {
    std::mt19937 random(static_cast<uint32_t>(kSeed + 7 * named.mesh.patches.size()));
    BaseMesh mesh = named.mesh;
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    const bool geomorph = mesh.patches.size() % 4 != 0;
    auto engine = makeEngine(makeBody(mesh, 2, 8), 0.25, true, geomorph);
    const uint64_t pages_before = of_pages;
    // Six frames, and as many as it takes until pages have come: a GPU draws hundreds meanwhile.
    for (int frame = 0; frame < 6 || (of_pages == pages_before && frame < 2000); ++frame) {
      if (frame < 6 && frame % 3 == 0) engine->setCamera(randomCamera(mesh, random));
      engine->frame(frame * 0.016);
      if (frame > 6) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      const bool any_page = std::any_of(engine->instances().begin(), engine->instances().end(),
                                        [](const PatchInstance& p) { return p.relief_page.level != kTailLevel; });
      if (frame >= 6 && !any_page) continue;
      compareShared(*engine, &total, geomorph ? test::ownVertex : snapVertex);
      if (HasFatalFailure()) return;
      for (const PatchInstance& p : engine->instances()) ++(p.relief_page.level == kTailLevel ? of_tails : of_pages);
    }
    EXPECT_EQ(total.different, 0u) << named.name;
  }
  std::printf(
      "[ watertight ] %llu comparisons, %llu across patches, %llu differ; %llu instances from tails, %llu from pages\n",
      (unsigned long long)total.compared, (unsigned long long)total.across_patches, (unsigned long long)total.different,
      (unsigned long long)of_tails, (unsigned long long)of_pages);
  // How many depends on when pages come.
  EXPECT_GE(total.across_patches, test::esShare(5'000u));
  EXPECT_GE(of_tails, test::esShare(200u));
  EXPECT_GE(of_pages, test::esShare(200u));
}

// Were a tail's samples others than the page's, it would show.
TEST_F(MeshWatertight, TailsOfOtherHeightsAreSeen) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  BaseMesh mesh = test::cubeSphere(3, 60);
  Body body = makeBody(mesh, 2, 8);
  body.artwork.tails = [artwork = body.artwork](int, std::vector<std::string>*) {
    const Manifest& m = artwork.manifest;
    PatchTails tails(m.domain.patchCount(), m.texture.channels());
    tailsFromPages(*artwork.source, m.texture, true, 0, 2, tails, nullptr);
    for (uint16_t& h : tails.heightsOf(4)) ++h;
    return tails;
  };
  auto engine = makeEngine(body, 0.25, true);
  std::mt19937 random(static_cast<uint32_t>(kSeed));
  Comparison total;
  for (int frame = 0; frame < 12 && total.different == 0; ++frame) {
    if (frame % 3 == 0) engine->setCamera(randomCamera(mesh, random));
    engine->frame(frame * 0.016);
    compareShared(*engine, &total);
  }
  EXPECT_GT(total.different, 0u) << "of " << total.compared;
}

// Pages of which every second or fourth sample is kept, beside whole ones, beside tails: as if all were whole, every
// vertex of every list.
TEST_F(MeshWatertight, SmallPagesHaveTheBitsOfWholeOnes) {
  Comparison total;
  uint64_t vertices = 0, fine = 0;
  for (int coarser = 1; coarser <= (kFewer ? 1 : 2); ++coarser) {
    BaseMesh mesh = test::cubeSphere(3, 60);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    const Body body = makeBody(mesh, 0, 8, coarser);
    std::mt19937 random(static_cast<uint32_t>(kSeed));
    std::array<std::unique_ptr<Engine>, 2> engines{makeEngine(body, 0.25, true),
                                                   makeEngine(body, 0.25, true, false, false)};
    for (int view = 0; view < 2; ++view) {
      const OrbitCamera camera = randomCamera(mesh, random);
      std::array<std::vector<float>, 2> captured;
      for (size_t k = 0; k < 2; ++k) {
        engines[k]->setCamera(camera);
        ASSERT_TRUE(engines[k]->settle(60).ok());
        compareShared(*engines[k], &total);
        captured[k] = engines[k]->captureVertices(40'000'000);
      }
      ASSERT_EQ(engines[0]->instances(), engines[1]->instances());
      ASSERT_EQ(captured[0].size(), captured[1].size());
      EXPECT_EQ(std::memcmp(captured[0].data(), captured[1].data(), captured[0].size() * sizeof(float)), 0)
          << "view " << view << ", 2^" << 7 - coarser << " cells";
      vertices += captured[0].size() / 4;
      for (const PatchInstance& p : engines[0]->instances())
        fine += p.step_log2 < coarser && p.relief_page.level != kTailLevel && p.node.patch % 3 != 0;
    }
    EXPECT_LT(engines[0]->stats().streamer.relief_bytes, engines[1]->stats().streamer.relief_bytes);
    ASSERT_TRUE(injectFaults(*engines[0], {.one_sample_a_texel = true}).ok());
    Comparison broken;
    compareShared(*engines[0], &broken);
    EXPECT_GT(broken.different, 0u) << "of " << broken.compared << ", samples read from elsewhere";
  }
  std::printf(
      "[ watertight ] %llu vertices from small pages as from whole ones; %llu instances between their samples; %llu "
      "shared, %llu differ\n",
      (unsigned long long)vertices, (unsigned long long)fine, (unsigned long long)total.compared,
      (unsigned long long)total.different);
  EXPECT_EQ(total.different, 0u);
  EXPECT_GE(vertices, test::esShare(100'000u));
  EXPECT_GE(fine, test::esShare(50u));
}

// Pages in compact form, beside plain ones, beside tails: as if all were plain, every vertex of every list.
TEST_F(MeshWatertight, CompactPagesHaveTheBitsOfPlainOnes) {
  Comparison total;
  uint64_t vertices = 0;
  std::vector<std::tuple<int, int, bool>> cases{{0, 2, true}, {1, 0, true}, {0, 1, false}};
  cases.resize(test::esShare(cases.size()));
  for (const auto& [depth, coarser, geomorph] : cases) {
    BaseMesh mesh = test::cubeSphere(depth == 0 ? 3 : 2, 60);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    const Body body = makeBody(mesh, depth, 8, coarser, true);
    std::mt19937 random(static_cast<uint32_t>(kSeed));
    std::array<std::unique_ptr<Engine>, 2> engines{makeEngine(body, 0.25, true, geomorph),
                                                   makeEngine(body, 0.25, true, geomorph, true, false)};
    const std::string what = "2^" + std::to_string(7 - coarser) + " cells, depth " + std::to_string(depth);
    const OrbitCamera camera = randomCamera(mesh, random);
    std::array<std::vector<float>, 2> captured;
    for (size_t k = 0; k < 2; ++k) {
      engines[k]->setCamera(camera);
      ASSERT_TRUE(engines[k]->settle(60).ok());
      compareShared(*engines[k], &total, geomorph ? test::ownVertex : snapVertex);
      captured[k] = engines[k]->captureVertices(40'000'000);
    }
    ASSERT_EQ(engines[0]->instances(), engines[1]->instances());
    ASSERT_EQ(captured[0].size(), captured[1].size());
    EXPECT_EQ(std::memcmp(captured[0].data(), captured[1].data(), captured[0].size() * sizeof(float)), 0) << what;
    vertices += captured[0].size() / 4;
    EXPECT_LT(engines[0]->stats().streamer.relief_bytes, engines[1]->stats().streamer.relief_bytes) << what;
    for (FaultInjection broken : {FaultInjection{.narrow_residuals = true}, FaultInjection{.flat_blocks = true}}) {
      for (auto& engine : engines) ASSERT_TRUE(injectFaults(*engine, broken).ok());
      EXPECT_NE(engines[0]->captureVertices(40'000'000), captured[0])
          << what << (broken.flat_blocks ? ": slopes left out" : ": widths less one");
      EXPECT_EQ(engines[1]->captureVertices(40'000'000), captured[1]) << "plain pages have neither";
    }
  }
  std::printf("[ watertight ] %llu vertices from compact pages as from plain ones; %llu shared, %llu differ\n",
              (unsigned long long)vertices, (unsigned long long)total.compared, (unsigned long long)total.different);
  EXPECT_EQ(total.different, 0u);
  EXPECT_GE(vertices, test::esShare(100'000u));
}

// Patches of one cell in a program of their own, beside finer ones: as if one program computed all, every vertex of
// every list.
TEST_F(MeshWatertight, RootCellsHaveTheBitsOfAllOthers) {
  Comparison total;
  uint64_t cells = 0, finer = 0;
  for (bool geomorph : {false, true}) {
    BaseMesh mesh = test::cubeSphere(9, 60);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    auto engine = makeEngine(makeBody(mesh, 0, 8), 12, true, geomorph);
    std::mt19937 random(static_cast<uint32_t>(kSeed));
    for (int view = 0; view < (kFewer ? 4 : 8); ++view) {
      engine->setCamera(randomCamera(mesh, random));
      ASSERT_TRUE(engine->settle(60).ok());
      uint64_t of_view = 0;
      bool all_roots = true;
      for (const PatchInstance& p : engine->instances()) {
        of_view += p.grid_level == 0;
        all_roots = all_roots && (p.grid_level > 0 || (p.node.level == 0 && p.relief_page.level == kTailLevel));
      }
      if (of_view == 0 || !all_roots) continue;
      cells += of_view;
      finer += engine->instances().size() - of_view;
      compareShared(*engine, &total, geomorph ? test::ownVertex : snapVertex);
      const std::vector<float> captured = engine->captureVertices(40'000'000);
      ASSERT_TRUE(injectFaults(*engine, {.call_a_patch = true}).ok());
      const std::vector<float> general = engine->captureVertices(40'000'000);
      ASSERT_EQ(captured.size(), general.size());
      uint64_t different = 0;
      for (size_t i = 0; i < captured.size(); ++i)
        different += std::bit_cast<uint32_t>(captured[i] + 0.0f) != std::bit_cast<uint32_t>(general[i] + 0.0f);
      EXPECT_EQ(different, 0u) << "view " << view;
      ASSERT_TRUE(injectFaults(*engine, {.cells_without_heights = true}).ok());
      EXPECT_NE(engine->captureVertices(40'000'000), captured) << "view " << view << ": heights left out";
      ASSERT_TRUE(injectFaults(*engine, {}).ok());
    }
  }
  std::printf(
      "[ watertight ] %llu patches of one cell beside %llu instances of more: %llu comparisons, %llu across patches, "
      "%llu differ\n",
      (unsigned long long)cells, (unsigned long long)finer, (unsigned long long)total.compared,
      (unsigned long long)total.across_patches, (unsigned long long)total.different);
  EXPECT_EQ(total.different, 0u);
  EXPECT_GE(cells, test::esShare(500u));
  EXPECT_GE(finer, test::esShare(500u));
}

TEST_F(MeshWatertight, WhatIsBrokenOnPurposeIsSeen) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  for (FaultInjection broken : {FaultInjection{.no_snapping = true}, FaultInjection{.unordered_ends = true},
                                FaultInjection{.one_sample_a_texel = true}}) {
    BaseMesh mesh = test::cubeSphere(3, 60);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    auto engine = makeEngine(makeBody(mesh, 2, 8), 0.25);
    ASSERT_TRUE(injectFaults(*engine, broken).ok());
    std::mt19937 random(static_cast<uint32_t>(kSeed));
    const OrbitCamera first = randomCamera(mesh, random);
    Comparison total;
    for (int frame = 0; frame < 15 && total.different == 0; ++frame) {
      if (frame % 3 == 0) engine->setCamera(frame == 0 ? first : randomCamera(mesh, random));
      engine->frame(frame * 0.016);
      compareShared(*engine, &total);
    }
    // A GPU draws fifteen frames before the first page has come. Samples of one page a texel agree with each other:
    // what shows the defect is pages of several depths side by side, while they come.
    for (int frame = 0; frame < 200 && total.different == 0; ++frame) {
      if (frame % 20 == 0) engine->setCamera(frame == 0 ? first : randomCamera(mesh, random));
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      engine->frame(frame * 0.016);
      compareShared(*engine, &total);
    }
    EXPECT_GT(total.different, 0u) << "of " << total.compared
                                   << (broken.no_snapping      ? ", no snapping"
                                       : broken.unordered_ends ? ", unordered ends"
                                                               : ", one sample a texel");
  }
}

// Open bodies, so that a crack shows the background and not the other side. `inside`: must the surface be seen along a
// ray, whatever the relief does?
struct OpenBody {
  std::string name;
  BaseMesh mesh;
  double relief_mm = 8;
  std::function<bool(const glm::dvec3& eye_mm, const glm::dvec3& direction)> inside;
};

// A ray that meets a ball within the body at its front must meet the body's surface before.
OpenBody halfBall() {
  constexpr double kRadius = 60;
  OpenBody body{"half a ball", test::cubeSphere(3, kRadius), 8, {}};
  std::erase_if(body.mesh.patches, [&](const auto& c) {
    return std::all_of(c.begin(), c.end(), [&](uint32_t k) { return body.mesh.corners[k].position_mm.z < 1e-3f; });
  });
  // The surface keeps outside of the smallest |P + h N| of the base: P is a chord of the ball.
  double least = kRadius;
  for (uint32_t p = 0; p < body.mesh.patches.size(); ++p)
    for (int k = 0; k <= 64; ++k) least = std::min(least, glm::length(body.mesh.point(p, k % 9 / 8.0, k / 9 / 8.0)));
  const double ball = 0.9 * (least - body.relief_mm / 2);
  body.inside = [ball](const glm::dvec3& eye, const glm::dvec3& d) {
    const double along = -glm::dot(eye, d), aside = glm::length(eye + along * d);
    if (along <= 0 || aside > ball) return false;
    return (eye + (along - std::sqrt(ball * ball - aside * aside)) * d).z >= 0.4 * ball;
  };
  return body;
}

// A sheet between two heights that hangs in its border: a ray that goes through from the one to the other and keeps
// clear of the border must meet it, however it folds. The clear part: a circle around the middle, as wide as the border
// leaves it.
OpenBody sheet(std::string name, BaseMesh mesh) {
  OpenBody body{std::move(name), std::move(mesh), 8, {}};
  auto [low, high] = test::boxOf(body.mesh);
  const double reach = body.relief_mm / 2;
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(body.mesh);
  double clear = 1e9;
  for (uint32_t p = 0; p < body.mesh.patches.size(); ++p)
    for (size_t side = 0; side < 4; ++side) {
      if (neighbours[p][side].patch != PatchNeighbour::kNone) continue;
      auto corner = [&](int end) {
        return glm::dvec2(
            body.mesh.corners[body.mesh.patches[p][static_cast<size_t>(kSideCorners[side][static_cast<size_t>(end)])]]
                .position_mm);
      };
      const glm::dvec2 a = corner(0), along = corner(1) - a;
      const double t = std::clamp(-glm::dot(a, along) / glm::dot(along, along), 0.0, 1.0);
      clear = std::min(clear, glm::length(a + t * along));
    }
  clear -= reach;
  body.inside = [clear, bottom = low.z - reach, top = high.z + reach](const glm::dvec3& eye, const glm::dvec3& d) {
    if (std::abs(d.z) < 1e-6 || (eye.z < top && eye.z > bottom)) return false;
    for (double z : {bottom, top}) {
      const double t = (z - eye.z) / d.z;
      if (t <= 0 || glm::length(glm::dvec2(eye + t * d)) > clear) return false;
    }
    return true;
  };
  return body;
}

std::vector<OpenBody> openBodies() {
  std::vector<OpenBody> all;
  all.push_back(halfBall());
  all.push_back(sheet("sheet of 3 x 4", test::openSheet(3, 4, 30)));
  for (int valence : {3, 5, 8, 20}) all.push_back(sheet("fan of " + std::to_string(valence), test::fan(valence, 60)));
  return all;
}

class MeshBackground : public MeshWatertight {
 protected:
  static constexpr int kSmallWidth = 128, kSmallHeight = 72;
  // Pixels inside and background ones among them over random views, from either side of a sheet; three frames a view,
  // so that pages are still coming and going.
  std::pair<uint64_t, uint64_t> look(OpenBody open, int views, bool snapping) {
    test::Random turns(kSeed);
    test::turnPatches(open.mesh, turns);
    auto engine = makeEngine(makeBody(open.mesh, 2, open.relief_mm), 1);
    engine->resize(kSmallWidth, kSmallHeight);
    if (!snapping) {
      EXPECT_TRUE(injectFaults(*engine, {.no_snapping = true}).ok());
    }
    std::mt19937 random(static_cast<uint32_t>(kSeed + 1));
    std::uniform_real_distribution<double> uniform(0, 1);
    const double reach = glm::length(artworkExtent(engine->manifest()).max_mm);
    const bool both_sides = open.name != "half a ball";
    uint64_t inside = 0, background = 0;
    for (int view = 0; view < views && (snapping || background == 0); ++view) {
      OrbitCamera c;
      c.azimuth_deg = 100 * uniform(random) - 50 + (both_sides && view % 4 == 3 ? 180 : 0);
      c.elevation_deg = 100 * uniform(random) - 50;
      c.distance_mm = reach * (1.05 + 3 * uniform(random));
      c.fov_deg = 8 + 60 * uniform(random);
      c.target_mm = 0.25 * reach * glm::dvec3(uniform(random) - 0.3, uniform(random) - 0.3, 0);
      engine->setCamera(c);
      for (int k = 0; k < 3; ++k) engine->frame(view * 0.1 + k * 0.01);
      background += holes(*engine, open, &inside);
    }
    return {inside, background};
  }

 private:
  static uint64_t holes(Engine& engine, const OpenBody& body, uint64_t* inside) {
    const ViewTransform view = engine.view();
    auto pixels = engine.readPixels();
    const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
    uint64_t count = 0;
    for (int y = 0; y < kSmallHeight; ++y) {
      for (int x = 0; x < kSmallWidth; ++x) {
        glm::dvec4 far_point =
            world_from_clip * glm::dvec4((x + 0.5) / kSmallWidth * 2 - 1, 1 - (y + 0.5) / kSmallHeight * 2, 0.5, 1);
        if (!body.inside(view.eye_mm, glm::normalize(glm::dvec3(far_point) / far_point.w - view.eye_mm))) continue;
        ++*inside;
        count += pixels[static_cast<size_t>(y * kSmallWidth + x) * 4 + 3] == 0;
      }
    }
    return count;
  }
};

// RELIEVO_LONG_TESTS=1: 10,002 views.
TEST_F(MeshBackground, NoneShowsThrough) {
  uint64_t inside_all = 0;
  int views_all = 0;
  for (OpenBody& body : openBodies()) {
    const int views = test::longTests() ? 1667 : test::glShare(60);
    const std::string name = body.name;
    auto [inside, background] = look(std::move(body), views, true);
    std::printf("[ watertight ] %s, seed %llu: %d views, %llu pixels inside, %llu of them background\n", name.c_str(),
                (unsigned long long)kSeed + 1, views, (unsigned long long)inside, (unsigned long long)background);
    EXPECT_EQ(background, 0u) << name;
    EXPECT_GT(inside, 300u * static_cast<uint64_t>(views)) << name;
    inside_all += inside;
    views_all += views;
  }
  std::printf("[ watertight ] %d views, %llu pixels inside\n", views_all, (unsigned long long)inside_all);
}

TEST_F(MeshBackground, ItDoesWithoutSnapping) {
  for (OpenBody& body : openBodies()) {
    const std::string name = body.name;
    auto [inside, background] = look(std::move(body), 300, false);
    EXPECT_GT(background, 0u) << name << ", of " << inside;
  }
}

}  // namespace mesh_watertight_gltest
}  // namespace relievo
