// Depth: the GPU's matrix against the camera's, and what reversed depth buys: two panels of 10 m, one close behind the
// other, that an eye sees from 10 m away with a near plane a million times closer than the far one. Control:
// conventional depth, which shows the wrong one. Without clip control (depth_gltest_bare_*) only the conventional path
// is there, and it is taken.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "src/engine/engine.h"
#include "src/render/depth.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/made_engine.h"
#include "tests/render/made_pages.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace depth_gltest {

constexpr int kWidth = 320, kHeight = 180;

// A colour a patch (grey 20, 30, ..), heights of noise.
class PatchColours final : public PageSource {
 public:
  explicit PatchColours(test::MeshHeight height) : height_(std::move(height)) {}
  Result<EncodedPage> read(PageId id) const override {
    const NodeId n = id.node();
    if (id.plane() != Plane::kRelief)
      return test::madeTexturePage(std::vector<uint8_t>(kTexturePageBytes, static_cast<uint8_t>(20 + 10 * n.patch)));
    return test::madeReliefPage(n, [&](double u, double v) {
      return height_(n.patch, static_cast<uint32_t>(u * kPagePx), static_cast<uint32_t>(v * kPagePx));
    });
  }

 private:
  test::MeshHeight height_;
};

Artwork artworkOver(BaseMesh mesh, double relief_mm) {
  Artwork artwork;
  auto base = std::make_shared<const BaseMesh>(std::move(mesh));
  Manifest& m = artwork.manifest;
  m.base = base;
  m.domain = PatchDomain::overMesh(static_cast<uint32_t>(base->patches.size()));
  m.domain.relief_depth = 0;
  m.domain.relief_offset_mm = -relief_mm / 2;
  m.domain.relief_scale_mm = relief_mm / 65535;
  auto oracle = std::make_shared<test::MadeUpMeshOracle>(
      test::MeshRelief{0, m.domain.relief_offset_mm, m.domain.relief_scale_mm}, 1, relief_mm);
  m.coarse_errors = oracle->coarse(base->patches.size());
  artwork.oracle = oracle;
  artwork.source = std::make_shared<PatchColours>(
      [base](uint32_t patch, uint32_t x, uint32_t y) { return test::noiseOver(*base, 7, 5)(patch, x, y); });
  return artwork;
}

std::unique_ptr<Engine> engineFor(const Artwork& artwork, bool reversed) {
  return test::makeEngine(artwork, {}, {.reversed_depth = reversed}, kWidth, kHeight);
}

// 2 x 2 patches of a sheet that faces the eye, 10 m wide, and the same gap_mm behind it; and a small one behind the
// eye, so that the eye lies within the bounds and the near plane is a thousandth of the distance to the target.
// front_first: which sheet is drawn first.
BaseMesh twoPanels(double gap_mm, bool front_first) {
  BaseMesh mesh;
  auto append = [&](const BaseMesh& part, double z) {
    const auto first = static_cast<uint32_t>(mesh.corners.size());
    for (BaseCorner c : part.corners) mesh.corners.push_back({c.position_mm + glm::vec3(0, 0, z), {0, 0, 1}});
    for (auto p : part.patches) {
      for (uint32_t& k : p) k += first;
      mesh.patches.push_back(p);
    }
  };
  const BaseMesh panel = test::openSheet(2, 2, 5000, 0);
  append(panel, front_first ? 0 : -gap_mm);
  append(panel, front_first ? -gap_mm : 0);
  append(test::openSheet(1, 1, 10, 0), 10'100);
  return mesh;
}

struct Seen {
  uint64_t front = 0, back = 0;
};
// Frames from 10 m away, askew: pixels that must show the front one; those that do not.
Seen look(bool reversed, double gap_mm, bool front_first) {
  Seen seen;
  auto engine = engineFor(artworkOver(twoPanels(gap_mm, front_first), 0.01), reversed);
  if (!engine) return seen;
  for (double tilt_deg : {0.0, 17.0, 40.0}) {
    OrbitCamera camera;
    camera.azimuth_deg = tilt_deg;
    camera.elevation_deg = -tilt_deg / 3;
    const glm::dvec3 back = glm::normalize(eyePosition(camera));
    camera.distance_mm = 10;
    camera.target_mm = 9990.0 * back;
    engine->setCamera(camera);
    EXPECT_TRUE(engine->settle(60).ok());
    const ViewTransform view = engine->view();
    EXPECT_GT(view.far_mm / view.near_mm, 1e6);
    const auto pixels = engine->readPixels();
    const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        // Where the line of sight meets the front panel, a pixel within its outline.
        const glm::dvec4 p =
            world_from_clip * glm::dvec4((x + 0.5) / kWidth * 2 - 1, 1 - (y + 0.5) / kHeight * 2, 0.5, 1);
        const glm::dvec3 sight = glm::dvec3(p) / p.w - view.eye_mm,
                         at = view.eye_mm - sight * (view.eye_mm.z / sight.z);
        if (std::max(std::abs(at.x), std::abs(at.y)) > 4900) continue;
        const size_t i = 4 * static_cast<size_t>(y * kWidth + x);
        const bool first = pixels[i] < 55;  // of the first four patches' greys
        ++(pixels[i + 3] != 0 && first == front_first ? seen.front : seen.back);
      }
    }
  }
  return seen;
}

TEST(Depth, PanelsCloseToEachOtherStayApart) {
  const bool available = depthMode().reversed, software = gl::currentContextInfo().software;
  for (double gap_mm : {0.02, 0.1, 1.0, 10.0, 100.0}) {
    for (bool front_first : {true, false}) {
      const Seen conventional = look(false, gap_mm, front_first);
      std::printf(
          "[ figures  ] panels %6.2f mm apart, the %s one drawn first: conventional depth shows the back one in %5llu "
          "of %llu pixels",
          gap_mm, front_first ? "front" : "back", static_cast<unsigned long long>(conventional.back),
          static_cast<unsigned long long>(conventional.front + conventional.back));
      ASSERT_GT(conventional.front + conventional.back, 3u * kWidth * kHeight / 2);
      if (gap_mm < 100 && front_first) {
        EXPECT_GT(conventional.back, 1000u) << "the control";
      }
      if (available) {
        const Seen reversed = look(true, gap_mm, front_first);
        std::printf(", reversed depth in %llu", static_cast<unsigned long long>(reversed.back));
        // What a GPU interpolates is less fine than what it stores: an H100 confuses 0.2 % of the pixels at two
        // millionths of the distance.
        if (software || gap_mm >= 0.1) {
          EXPECT_EQ(reversed.back, 0u) << gap_mm;
        } else EXPECT_LT(100 * reversed.back, reversed.front);
        EXPECT_GE(reversed.front, 3u * kWidth * kHeight / 2);
      }
      std::printf("\n");
    }
  }
}

TEST(Depth, TheModeInUseIsTheOneAskedForWhereItIsThere) {
  const DepthMode best = depthMode(), plain = depthMode(false);
  EXPECT_FALSE(plain.reversed);
  EXPECT_EQ(best.reversed, best.clip_control);
  const Artwork ball = artworkOver(test::cubeSphere(1, 60), 2);
  EXPECT_EQ(engineFor(ball, true)->stats().reversed_depth, best.reversed);
  EXPECT_FALSE(engineFor(ball, false)->stats().reversed_depth);
  const std::string json = engineStatsJson(engineFor(ball, true)->stats(), ball.manifest);
  EXPECT_NE(json.find(best.reversed ? "\"depth\": \"reversed, 32-bit float\"" : "\"depth\": \"conventional, 24-bit\""),
            std::string::npos)
      << json;
}

// Where depth decides nothing, it changes nothing; engines of both kinds share a context, turn by turn.
TEST(Depth, OrdinaryPicturesAreTheSame) {
  const Artwork ball = artworkOver(test::cubeSphere(3, 60), 4);
  auto reversed = engineFor(ball, true), conventional = engineFor(ball, false);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  uint64_t differ = 0, covered = 0;
  for (int view = 0; view < 6; ++view) {
    Scene scene;
    scene.wireframe = view % 3 == 2;
    OrbitCamera camera;
    camera.azimuth_deg = 360 * uniform(random);
    camera.elevation_deg = 160 * uniform(random) - 80;
    camera.distance_mm = 90 + 200 * uniform(random);
    camera.fov_deg = 10 + 60 * uniform(random);
    std::vector<uint8_t> pictures[2];
    Engine* const engines[2] = {reversed.get(), conventional.get()};
    for (int k = 0; k < 2; ++k) {
      ASSERT_TRUE(engines[k]->setScene(scene).ok());
      engines[k]->setCamera(camera);
      ASSERT_TRUE(engines[k]->settle(60).ok());
      pictures[k] = engines[k]->readPixels();
    }
    for (size_t i = 0; i < pictures[0].size(); i += 4) {
      covered += pictures[0][i + 3] != 0;
      differ += !std::equal(pictures[0].begin() + static_cast<std::ptrdiff_t>(i),
                            pictures[0].begin() + static_cast<std::ptrdiff_t>(i + 4),
                            pictures[1].begin() + static_cast<std::ptrdiff_t>(i));
    }
  }
  std::printf("[ figures  ] %llu of %llu covered pixels differ between reversed and conventional depth\n",
              static_cast<unsigned long long>(differ), static_cast<unsigned long long>(covered));
  EXPECT_GT(covered, 25'000u);
  EXPECT_LE(differ, covered / 10'000);  // on outlines, where surfaces meet at a slant
}

TEST(Depth, TheMatrixIsTheCamerasInTheGlsOrder) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 200; ++i) {
    OrbitCamera camera;
    camera.azimuth_deg = 360 * uniform(random);
    camera.elevation_deg = 170 * uniform(random) - 85;
    camera.distance_mm = std::exp(12 * uniform(random));
    camera.fov_deg = 1 + 169 * uniform(random);
    camera.target_mm = {1e7 * uniform(random), 100, -50};
    const Extent extent{camera.target_mm - 100.0, camera.target_mm + 200.0, 1, false};
    const ViewTransform view = viewTransform(camera, extent, 640, 360);
    for (bool reversed : {false, true}) {
      const DepthMode mode{.reversed = reversed, .clip_control = true};
      const auto m = glClipFrom(view.clip_from_world, view.eye_mm, mode);
      double before = reversed ? 2 : -2;
      for (double t : {0.0, 0.001, 0.3, 1.0}) {
        const double depth_mm = view.near_mm + t * (view.far_mm - view.near_mm);
        const glm::dvec3 from_eye = view.world_from_camera * glm::dvec3(0.1 * depth_mm, 0.05 * depth_mm, -depth_mm);
        glm::dvec4 clip(0);
        for (int r = 0; r < 4; ++r)
          clip[r] = m[static_cast<size_t>(r)] * from_eye.x + m[static_cast<size_t>(4 + r)] * from_eye.y +
                    m[static_cast<size_t>(8 + r)] * from_eye.z + m[static_cast<size_t>(12 + r)];
        ASSERT_NEAR(clip.w / depth_mm, 1, 1e-6);
        const double z = clip.z / clip.w, n = view.near_mm, f = view.far_mm;
        // The float's rounding: of what is close to -1 or 1 (conventional), of the number itself (reversed).
        const double expected =
            reversed ? n * (f - depth_mm) / (depth_mm * (f - n)) : 1 - 2 * n * (f - depth_mm) / (depth_mm * (f - n));
        ASSERT_NEAR(z, expected, reversed ? 1e-6 * (expected + n / f) : 1e-6) << depth_mm << " of " << n << " to " << f;
        ASSERT_TRUE(reversed ? z < before : z > before);
        before = z;
      }
    }
  }
}

}  // namespace depth_gltest
}  // namespace relievo
