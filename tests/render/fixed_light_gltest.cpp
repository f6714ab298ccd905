// A fixed light, resolved once per page or tail, shows what live relighting shows, from wherever the light comes: over
// flat artworks and over patches. Coefficients are the same all over a patch, so that filtering before or after the
// evaluation is one; the control takes the light's z away.
#include <gtest/gtest.h>

#include "src/artwork/bases/ptm.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/other_bases.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"
#include "tests/render/made_pages.h"
#include "tests/texturing/fake_sources.h"

namespace relievo {
namespace fixed_light_gltest {

using namespace test;

constexpr int kWidth = 200, kHeight = 120;
constexpr std::array<uint8_t, 18> kRaw{150, 110, 140, 170, 90,  118, 220, 160, 90,
                                       190, 60,  130, 100, 140, 120, 80,  110, 140};

TextureFormat formatOf(Basis basis) {
  if (basis > Basis::kAlbedoNormal) return otherFormat(basis);
  TextureFormat f{.basis = basis};
  if (isPtm(basis)) {
    f.scale = {1, 1, 1, 1, 1, 1};
    f.bias = {128, 128, 128, 128, 128, 0};
  }
  return f;
}

class PlainTexture final : public TextureSource {
 public:
  explicit PlainTexture(Basis basis) : basis_(basis) {}
  int64_t width() const override { return 300; }
  int64_t height() const override { return 200; }
  TextureFormat format() const override { return formatOf(basis_); }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    const auto texels = static_cast<size_t>(r.width * r.height);
    for (size_t i = 0; i < out.size(); ++i) out[i] = kRaw[i / texels % kRaw.size()];
    return {};
  }

 private:
  Basis basis_;
};

class PlainPatches final : public PageSource {
 public:
  Result<EncodedPage> read(PageId id) const override {
    if (id.plane() == Plane::kRelief) return madeReliefPage(id.node(), [](double, double) { return uint16_t{0}; });
    std::vector<uint8_t> channels(kTexturePageBytes);
    constexpr size_t plane = size_t{kPageFullPx} * kPageFullPx;
    for (size_t i = 0; i < channels.size(); ++i)
      channels[i] = static_cast<uint8_t>(
          kRaw[(3 * static_cast<size_t>(texturePlaneIndex(id.plane())) + i / plane) % kRaw.size()] +
          id.node().patch % 5);
    return madeTexturePage(channels);
  }
};

Artwork patches(Basis basis) {
  auto base = std::make_shared<const BaseMesh>(cubeSphere(2, 50));
  Artwork a;
  a.manifest = madeManifest(base, 1, 1, 1);
  a.manifest.texture = formatOf(basis);
  a.source = std::make_shared<PlainPatches>();
  a.oracle = std::make_shared<MadeUpMeshOracle>(MeshRelief{1, 0, 1.0 / 65535}, 3, 0.05);
  return a;
}

std::vector<std::array<double, 3>> lightsAround() {
  std::vector<std::array<double, 3>> lights{{0, 0, 1},    {0, 0, -1},         {1, 0, 0},        {0, -1, 0},
                                            {0.1, 0, -1}, {-0.01, 0.005, -1}, {0.8, 0.6, -0.05}};
  for (int i = 0; i < 6; ++i) {
    const double z = 1 - (2 * i + 1) / 6.0, r = std::sqrt(1 - z * z);
    lights.push_back({r * std::cos(2.39996 * i), r * std::sin(2.39996 * i), z});
  }
  return lights;
}

std::vector<uint8_t> picture(Engine& engine, Scene scene, bool relight, const std::array<double, 3>& light) {
  scene.relight = relight;
  scene.light = light;
  EXPECT_TRUE(engine.setScene(scene).ok());
  auto settled = engine.settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  return engine.readPixels();
}

int largestDifference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  int largest = 0;
  EXPECT_EQ(a.size(), b.size());
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

// most_pinned: patches above which tails stand for the roots.
// limit: of 255. Tails blend into neighbouring patches, and there filtering before and after the evaluation differ in
// the dark of Lambert's law.
void expectSame(const Artwork& artwork, const std::string& what, uint32_t most_pinned = 64, int limit = 1) {
  EngineOptions options;
  options.most_pinned_patches = most_pinned;
  auto live = makeEngine(artwork, {}, options, kWidth, kHeight),
       fixed = makeEngine(artwork, {.relight = false}, options, kWidth, kHeight);
  ASSERT_TRUE(live && fixed);
  bool seen = false;
  for (const auto& light : lightsAround()) {
    const auto lit = picture(*live, {}, true, light), resolved = picture(*fixed, {}, false, light);
    EXPECT_LE(largestDifference(lit, resolved), limit)
        << what << ": " << light[0] << " " << light[1] << " " << light[2];
    // Control: a light in front of the artwork with the same x and y.
    if (light[2] < -0.3)
      seen = seen || largestDifference(picture(*live, {}, true, {light[0], light[1], -light[2]}), resolved) > 20;
  }
  EXPECT_TRUE(seen) << what << ": control";
}

TEST(FixedLight, OfAFlatArtworkIsTheLiveOne) {
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, otherBases()[0], otherBases()[1]})
    expectSame(denseSubject(PlainTexture(basis), nullptr).artwork, basisName(basis));
}

// Every page is 50 ms late: by then all of the rest is ready to be shown under the light before. Of this view only the
// roots are wanted, which show that light meanwhile.
TEST(FixedLight, IsWaitedForWhereItsPagesAreLate) {
  Artwork late = denseSubject(PlainTexture(Basis::kPtmRgb), nullptr).artwork;
  const Artwork prompt = late;
  late.source = std::make_shared<fake::SlowSource>(late.source, std::chrono::milliseconds(50));
  auto waits = makeEngine(late, {.relight = false}, {}, kWidth, kHeight);
  ASSERT_TRUE(waits);
  OrbitCamera camera = waits->camera();
  camera.distance_mm *= 4;
  waits->setCamera(camera);
  std::vector<uint8_t> before;
  for (const std::array<double, 3>& light : {std::array{0.8, 0.6, 0.3}, {-0.8, 0.1, 0.4}, {0.0, 0.0, 1.0}}) {
    auto fresh = makeEngine(prompt, {.light = light, .relight = false}, {}, kWidth, kHeight);
    ASSERT_TRUE(fresh);
    fresh->setCamera(camera);
    const std::vector<uint8_t> now = picture(*waits, {}, false, light);
    EXPECT_EQ(now, picture(*fresh, {}, false, light));
    EXPECT_NE(now, before) << "control: the light changes the picture";
    before = now;
    for (const NodeRequest& wanted : waits->textureRequests()) EXPECT_EQ(wanted.node.level, 0u);
  }
}

TEST(FixedLight, OverPatchesIsTheLiveOneSeenFromTheFront) {
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kAlbedoNormal, otherBases()[0], otherBases()[1]}) {
    expectSame(patches(basis), basisName(basis));
    expectSame(patches(basis), std::string(basisName(basis)) + ", tails", 4, basis == Basis::kAlbedoNormal ? 4 : 1);
  }
}

}  // namespace fixed_light_gltest
}  // namespace relievo
