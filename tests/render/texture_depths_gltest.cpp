// Packages whose patches have texture pages of some levels only, or none (texturing/package/texture_depths.h): the
// picture is that of a package with all pages, and no page is asked for that does not exist.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "tests/render/made_engine.h"
#include "tests/texturing/patch_fixture.h"
#include "tests/view_share.h"
#include "texturing/package/package.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo {
namespace texture_depths_gltest {

using testing_support::MostlySmoothPatches;
using testing_support::ScratchFolder;

constexpr uint64_t kSeed = 20261126;
constexpr int kSide = 256;
constexpr double kTolerance = 1.5;
constexpr uint32_t kMany = 1000;  // more than there are patches: roots are pinned where all patches have some

class TextureDepths : public ::testing::Test {
 protected:
  std::shared_ptr<Package> built(const char* name, double tolerance) {
    BuildOptions o;
    o.output = folder_.file(name);
    o.texture_tolerance = tolerance;
    auto done = buildPatchPackage(MostlySmoothPatches(kSeed), o);
    EXPECT_TRUE(done.ok()) << done.error().text();
    auto package = Package::open(o.output);
    EXPECT_TRUE(package.ok()) << package.error().text();
    return *package;
  }
  static std::unique_ptr<Engine> engineOf(const std::shared_ptr<Package>& package, const Scene& scene,
                                          uint32_t most_pinned) {
    EngineOptions options;
    options.most_pinned_patches = most_pinned;
    options.cache_mib = 128;
    return test::makeEngine(artworkFromPackage(package), scene, options, kSide, kSide);
  }
  static OrbitCamera cameraAt(double azimuth, double elevation, double radii) {
    OrbitCamera c;
    c.azimuth_deg = azimuth;
    c.elevation_deg = elevation;
    c.distance_mm = radii * MostlySmoothPatches::kRadiusMm;
    c.fov_deg = 30;
    return c;
  }

  ScratchFolder folder_;
};

struct Difference {
  int most = 0;  // of 255
  uint64_t covered_differently = 0, seen = 0;
};
Difference compare(Engine& a, Engine& b, const OrbitCamera& camera) {
  Difference out;
  std::vector<uint8_t> picture[2];
  for (Engine* e : {&a, &b}) {
    e->setCamera(camera);
    auto settled = e->settle(60);
    EXPECT_TRUE(settled.ok()) << settled.error().text();
    picture[e == &b] = e->readPixels();
  }
  for (size_t i = 0; i < picture[0].size(); i += 4) {
    out.seen += picture[0][i + 3] != 0;
    out.covered_differently += (picture[0][i + 3] == 0) != (picture[1][i + 3] == 0);
    for (size_t c = 0; c < 3; ++c) out.most = std::max(out.most, std::abs(picture[0][i + c] - picture[1][i + c]));
  }
  return out;
}

// From far to near; the last ones straight above the patches that have pages.
std::vector<std::array<double, 3>> views() {
  std::vector<std::array<double, 3>> out{{0, 0, 8},      {33, 21, 4},   {120, -40, 2.5},
                                         {200, 60, 1.5}, {20, 30, 1.2}, {310, -10, 1.1}};
  const MostlySmoothPatches source(kSeed, 0);
  for (uint32_t patch : {MostlySmoothPatches::kWeak, MostlySmoothPatches::kStrong, MostlySmoothPatches::kWaves}) {
    const glm::dvec3 d = glm::normalize(source.base().point(patch, 0.5, 0.5));
    out.push_back({glm::degrees(std::atan2(d.x, d.z)), glm::degrees(std::asin(d.y)), 1.5});
  }
  return out;
}

// A texel may be 1.5 steps off, in colour and in normals, whose steps count up to five times where light grazes.
constexpr int kMostOff = 6;

TEST_F(TextureDepths, ThePictureIsThatOfAllPages) {
  const auto whole = built("whole.relievo", -1), package = built("a.relievo", kTolerance),
             careless = built("careless.relievo", 60);
  const PatchDomain& d = package->manifest().domain;
  ASSERT_TRUE(d.hasUntexturedPatch());
  struct Case {
    Sampling sampling;
    uint32_t most_pinned;
    bool controlled = false;
  };
  for (const Case& c : {Case{Sampling::kTrilinear, kMany, true}, Case{Sampling::kTrilinear, 0},
                        Case{Sampling::kBilinear, kMany}, Case{Sampling::kAnisotropic, 0}}) {
    Scene scene;
    scene.sampling = c.sampling;
    scene.error_px = 1;
    // With tails, as the other ones: pinned roots are the coarsest that there is.
    auto all = engineOf(whole, scene, 0), some = engineOf(package, scene, c.most_pinned),
         few = c.controlled ? engineOf(careless, scene, c.most_pinned) : nullptr;
    ASSERT_TRUE(all && some && (few || !c.controlled));
    int careless_off = 0;
    for (const auto& v : views()) {
      const Difference difference = compare(*all, *some, cameraAt(v[0], v[1], v[2]));
      EXPECT_GT(difference.seen, 1000u);
      EXPECT_EQ(difference.covered_differently, 0u);
      EXPECT_LE(difference.most, kMostOff) << v[0] << " " << v[2] << " sampling " << static_cast<int>(c.sampling);
      for (const NodeRequest& r : some->textureRequests()) EXPECT_TRUE(d.hasTexturePage(r.node));
      EXPECT_EQ(some->stats().missing_pages, 0u);
      if (few) careless_off = std::max(careless_off, compare(*all, *few, cameraAt(v[0], v[1], v[2])).most);
    }
    EXPECT_EQ(some->failures().pages, 0u);
    EXPECT_TRUE(some->takeMessages().empty());
    const auto pages = [](Engine& e) { return e.stats().streamer.pages_read[static_cast<size_t>(Plane::kTexture0)]; };
    EXPECT_LT(pages(*some), pages(*all));
    if (few) {
      EXPECT_GT(careless_off, 3 * kMostOff) << "the negative control: pages that matter are missed";
    }
  }
}

// What is too small for a page, or has none, shows without any look-up.
TEST_F(TextureDepths, PatchesWithoutPagesAskForNothing) {
  const auto package = built("a.relievo", 255);
  const PatchDomain& d = package->manifest().domain;
  ASSERT_EQ(d.texturedNodeCount(0), 0u);
  auto engine = engineOf(package, {}, kMany);
  ASSERT_TRUE(engine);
  engine->setCamera(cameraAt(20, 30, 1.2));
  ASSERT_TRUE(engine->settle(60).ok());
  EXPECT_TRUE(engine->textureRequests().empty());
  const EngineStats stats = engine->stats();
  EXPECT_EQ(stats.streamer.pages_read[static_cast<size_t>(Plane::kTexture0)], 0u);
  EXPECT_EQ(stats.missing_pages, 0u);
}

}  // namespace texture_depths_gltest
}  // namespace relievo
