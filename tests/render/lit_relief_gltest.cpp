// Colour with relief is lit by the relief's normals. Truth is analytic: planes and waves seen from above, Lambert's
// law. Under --unlit the colour is as it is: the control fails every comparison with a light.
#include <gtest/gtest.h>

#include <fstream>

#include "src/viewer/hud.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"
#include "tests/tools/cli_fixture.h"
#include "texturing/stream/page_sources.h"

namespace relievo {
namespace lit_relief_gltest {

using namespace test;

constexpr int64_t kSide = 256;
constexpr double kMmPerPx = 0.1;  // denseSubject's
constexpr std::array<double, 3> kAlbedo{200, 150, 100};

class PlainColour final : public TextureSource {
 public:
  int64_t width() const override { return kSide; }
  int64_t height() const override { return kSide; }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    const auto texels = static_cast<size_t>(r.width * r.height);
    for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint8_t>(kAlbedo[i / texels]);
    return {};
  }
};

// Heights and slopes in mm and by mm, x to the right and y up from the artwork's centre.
struct Shape {
  double min_mm, max_mm;
  std::function<double(double x, double y)> height;
  std::function<glm::dvec2(double x, double y)> slope;
};
Shape tilted(double right, double up) {
  const double most = kSide * kMmPerPx / 2 * (std::abs(right) + std::abs(up));
  return {-most, most, [=](double x, double y) { return right * x + up * y; },
          [=](double, double) { return glm::dvec2(right, up); }};
}
// Along x; a wave of 64 px. mirror: of x.
Shape waves(double steepness, bool mirror) {
  const double k = 2 * 3.14159265358979 / (64 * kMmPerPx), a = steepness / k, sign = mirror ? -1 : 1;
  return {-a, a, [=](double x, double) { return a * std::sin(k * sign * x + 0.6); },
          [=](double x, double) { return glm::dvec2(a * k * sign * std::cos(k * sign * x + 0.6), 0); }};
}

class ShapeHeight final : public HeightSource {
 public:
  explicit ShapeHeight(const Shape& shape) : shape_(shape) {}
  int64_t width() const override { return kSide; }
  int64_t height() const override { return kSide; }
  double minMm() const override { return shape_.min_mm; }
  double maxMm() const override { return shape_.max_mm; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    size_t at = 0;
    for (int64_t y = r.y; y < r.y + r.height; ++y)
      for (int64_t x = r.x; x < r.x + r.width; ++x)
        out[at++] = static_cast<float>(shape_.height((static_cast<double>(x) + 0.5 - kSide / 2) * kMmPerPx,
                                                     (kSide / 2 - static_cast<double>(y) - 0.5) * kMmPerPx));
    return {};
  }

 private:
  Shape shape_;
};

Artwork artworkOf(const Shape& shape) {
  const ShapeHeight heights(shape);
  return denseSubject(PlainColour(), &heights).artwork;
}

// A texel a pixel, from above.
std::vector<uint8_t> fromAbove(const Artwork& artwork, const Scene& scene, EngineStats* stats = nullptr) {
  auto engine = makeEngine(artwork, scene, {}, kSide, kSide);
  if (!engine) return {};
  OrbitCamera c;
  c.orthographic = true;
  c.distance_mm = distanceForScale(c, kMmPerPx, kSide);
  engine->setCamera(c);
  auto settled = engine->settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  if (stats) *stats = engine->stats();
  return engine->readPixels();
}

// Away from the artwork's border, where heights are clamped.
constexpr int kInset = 4;
double largestError(const std::vector<uint8_t>& pixels, const Shape& shape, const Scene& scene) {
  const auto light = normalizedLight(scene.light);
  double largest = 0;
  for (int y = kInset; y < kSide - kInset; ++y) {
    for (int x = kInset; x < kSide - kInset; ++x) {
      const glm::dvec2 slope =
          scene.exaggerate * shape.slope((x + 0.5 - kSide / 2) * kMmPerPx, (kSide / 2 - y - 0.5) * kMmPerPx);
      const double lit =
          std::max(0.0, glm::dot(glm::normalize(glm::dvec3(-slope, 1)), glm::dvec3(light[0], light[1], light[2])));
      if (lit > 0 && lit < 0.02) continue;  // near the terminator a normal's last bit is many grey levels
      const uint8_t* p = &pixels[static_cast<size_t>(y * kSide + x) * 4];
      for (size_t c = 0; c < 3; ++c)
        largest = std::max(largest, std::abs(p[c] - kAlbedo[c] * std::pow(0.04 + 0.96 * lit, 1 / 2.2)));
    }
  }
  return largest;
}

int largestDifference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  int largest = 0;
  EXPECT_EQ(a.size(), b.size());
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

TEST(LitRelief, isLambertsLawOnPlanesAndWaves) {
  double largest = 0;
  for (const Shape& shape : {tilted(0, 0), tilted(0.7, 0), tilted(-0.2, 0.9), tilted(0.3, -0.1), waves(0.5, false)}) {
    const Artwork artwork = artworkOf(shape);
    for (const std::array<double, 3>& light :
         {std::array{0.0, 0.0, 1.0}, {-0.7, 0.2, 0.6}, {0.7, -0.2, 0.6}, {0.1, 0.9, 0.3}}) {
      for (double exaggerate : {1.0, -1.5}) {
        const Scene scene{.light = light, .exaggerate = exaggerate};
        const double error = largestError(fromAbove(artwork, scene), shape, scene);
        EXPECT_LE(error, 2.0) << light[0] << " " << light[1] << " exaggerated " << exaggerate;
        largest = std::max(largest, error);
      }
    }
    // Control: without a light the colour stays as it is.
    const Scene unlit{.light = {0.1, 0.9, 0.3}, .unlit = true};
    EXPECT_GT(largestError(fromAbove(artwork, unlit), shape, unlit), 10);
  }
  std::printf("[ lit      ] off by at most %.2f of 255\n", largest);
}

TEST(LitRelief, oppositeLightsDifferAndSwapWhereTheReliefIsMirrored) {
  const Artwork artwork = artworkOf(waves(0.5, false)), mirrored = artworkOf(waves(0.5, true));
  const Scene left{.light = {-0.7, 0, 0.6}}, right{.light = {0.7, 0, 0.6}};
  const auto from_left = fromAbove(artwork, left), from_right = fromAbove(artwork, right);
  EXPECT_GT(largestDifference(from_left, from_right), 60);
  auto flipped = fromAbove(mirrored, right);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide / 2; ++x)
      for (int c = 0; c < 4; ++c)
        std::swap(flipped[static_cast<size_t>((y * kSide + x) * 4 + c)],
                  flipped[static_cast<size_t>((y * kSide + kSide - 1 - x) * 4 + c)]);
  EXPECT_LE(largestDifference(from_left, flipped), 2);
}

// From above a place is at its pixel whatever the triangles, so the picture does not depend on them.
TEST(LitRelief, doesNotDependOnTheGeometrysLevelOfDetail) {
  const Subject noise = noiseSubject(kSide, kSide, Basis::kColour, 3, 31);
  std::vector<uint8_t> first;
  std::vector<uint32_t> triangles;
  for (double error_px : {0.05, 2.0, 40.0}) {
    EngineStats stats;
    const auto pixels = fromAbove(noise.artwork, {.light = {-0.7, 0.2, 0.6}, .error_px = error_px}, &stats);
    triangles.push_back(stats.triangles);
    if (first.empty()) first = pixels;
    EXPECT_LE(largestDifference(first, pixels), 1) << error_px;
  }
  EXPECT_GT(triangles.front(), 10 * triangles.back());
}

TEST(LitRelief, onlyWhatTheSceneCallsFor) {
  const Subject noise = noiseSubject(kSide, kSide, Basis::kColour, 3, 32),
                flat = noiseSubject(kSide, kSide, Basis::kColour, 0, 33);
  const Scene left{.light = {-0.7, 0, 0.6}}, right{.light = {0.7, 0, 0.6}};
  auto unlit = [](Scene s) { return s.unlit = true, s; };
  auto flatOf = [](Scene s) { return s.relief = false, s; };
  EngineStats lit, bare, without, plain;
  fromAbove(noise.artwork, left, &lit);
  EXPECT_EQ(lit.planes_read, (std::vector<std::string>{"colour", "relief"}));
  EXPECT_GT(lit.streamer.pages_uploaded[static_cast<size_t>(kNormalPlane)], 0u);
  EXPECT_EQ(lit.streamer.pages_read[static_cast<size_t>(kNormalPlane)], 0u) << "made, not read";

  EXPECT_EQ(fromAbove(noise.artwork, unlit(left), &bare), fromAbove(noise.artwork, unlit(right)));
  EXPECT_EQ(bare.streamer.pages_uploaded[static_cast<size_t>(kNormalPlane)], 0u);
  EXPECT_LT(bare.streamer.pages_read[static_cast<size_t>(Plane::kRelief)],
            lit.streamer.pages_read[static_cast<size_t>(Plane::kRelief)]);
  EXPECT_EQ(bare.streamer.pages_read[0], lit.streamer.pages_read[0]);

  // Flat geometry reads no relief page, so there is nothing to be lit by. Colour alone is unlit anyway.
  EXPECT_EQ(fromAbove(noise.artwork, flatOf(left), &without), fromAbove(noise.artwork, flatOf(right)));
  EXPECT_EQ(without.streamer.pages_read[static_cast<size_t>(Plane::kRelief)], 0u);
  EXPECT_EQ(fromAbove(flat.artwork, left, &plain), fromAbove(flat.artwork, right));
  EXPECT_FALSE(planEffects(left, flat.artwork.manifest).lit());
  EXPECT_FALSE(planEffects(unlit(left), noise.artwork.manifest).lit());
  EXPECT_TRUE(planEffects(left, noise.artwork.manifest).lit());
  // Of a scan the albedo alone.
  Manifest scan = noise.artwork.manifest;
  scan.texture.basis = Basis::kAlbedoNormal;
  EXPECT_EQ(planEffects(unlit(left), scan).planesRead(), (std::vector<std::string>{"albedo", "relief"}));
  EXPECT_EQ(planEffects(left, scan).planesRead(), (std::vector<std::string>{"albedo", "normal", "relief"}));

  // A scene that changes on the way: the same pictures.
  auto engine = makeEngine(noise.artwork, unlit(left), {}, kSide, kSide);
  ASSERT_TRUE(engine);
  OrbitCamera c;
  c.orthographic = true;
  c.distance_mm = distanceForScale(c, kMmPerPx, kSide);
  engine->setCamera(c);
  for (const Scene& scene : {left, unlit(left), right, Scene{.light = {0.7, 0, 0.6}, .exaggerate = 3},
                             Scene{.light = {0.7, 0, 0.6}, .relight = false}}) {
    ASSERT_TRUE(engine->setScene(scene).ok());
    ASSERT_TRUE(engine->settle(60).ok());
    EXPECT_EQ(engine->readPixels(), fromAbove(noise.artwork, scene));
  }
}

TEST(LitRelief, aPtmCannotBeUnlit) {
  const Subject ptm = noiseSubject(200, 200, Basis::kPtmLrgb, 0, 34);
  auto made = Engine::create(ptm.artwork, {.unlit = true}, {});
  ASSERT_FALSE(made.ok());
  EXPECT_EQ(made.error().kind, ErrorKind::kUsage);
}

// A relief page that cannot be read: its ancestor's normals show, and the page is named.
class WithoutAPage final : public PageSource {
 public:
  explicit WithoutAPage(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  Result<EncodedPage> read(PageId id) const override {
    if (id == PageId(Plane::kRelief, {0, 1, 1, 0}))
      return Error{ErrorKind::kInvalidData, "x.relievo", "the page is damaged", "", {}};
    return inner_->read(id);
  }

 private:
  std::shared_ptr<const PageSource> inner_;
};
TEST(LitRelief, aDamagedReliefPageShowsItsAncestor) {
  Artwork artwork = artworkOf(tilted(0.5, 0));
  artwork.source = std::make_shared<WithoutAPage>(artwork.source);
  const Scene scene{.light = {-0.7, 0, 0.6}};
  EngineStats stats;
  // A plane has the same normals at every level.
  EXPECT_LE(largestError(fromAbove(artwork, scene, &stats), tilted(0.5, 0), scene), 2.0);
  EXPECT_GT(stats.streamer.failed_pages, 0u);
}

TEST(LitRelief, theHeadUpDisplaySaysUnlit) {
  HudState s;
  EXPECT_EQ(hudLine(s).find("unlit"), std::string::npos);
  s.unlit = true;
  EXPECT_NE(hudLine(s).find("unlit"), std::string::npos);
}

// Through the program as its users run it.
class LitReliefCli : public testing_support::Cli {
 protected:
  std::string bytes(const std::string& name) const {
    std::ifstream in(file(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
};
TEST_F(LitReliefCli, imageAndHeightMapFollowTheLight) {
  auto ok = [&](const std::string& command) {
    const auto r = relievo(command);
    EXPECT_EQ(r.exit_code, 0) << command << "\n" << r.output;
  };
  ok("sample painting -o " + file("p") + " --size 300x200 --write height,albedo");
  ok("build --image " + file("p/albedo.png") + " --relief " + file("p/height_float.tif") + " --mm-per-pixel 0.3 -o " +
     file("a.relievo"));
  ok("build --image " + file("p/albedo.png") + " --mm-per-pixel 0.3 -o " + file("flat.relievo"));
  write("m.obj", "v 0 0 0\nv 50 0 0\nv 50 40 10\nv 0 40 10\nf 1 2 3\nf 1 3 4\n");
  ok("build --mesh " + file("m.obj") + " -o " + file("scan.relievo"));
  for (const char* package : {"a", "flat", "scan"}) {
    for (const char* lit : {"", " --unlit"}) {
      auto draw = [&](const char* light, const char* to) {
        ok("render " + file(std::string(package) + ".relievo") + " -o " + file(to) +
           " --size 200x150 --settle --light=" + light + lit);
        return bytes(to);
      };
      const bool same = draw("-0.7,0.3,0.5", "1.png") == draw("0.7,-0.3,0.5", "2.png");
      EXPECT_EQ(same, std::string(package) == "flat" || *lit != 0) << package << lit;
    }
  }
  // Told once where a light has nothing to shine on.
  auto warned = [&](const std::string& arguments) {
    return relievo("render " + arguments + " -o " + file("4.png")).output.find("--light changes nothing") !=
           std::string::npos;
  };
  EXPECT_TRUE(warned(file("flat.relievo") + " --light 1,0,1"));
  EXPECT_TRUE(warned(file("a.relievo") + " --no-relief --light 1,0,1"));
  EXPECT_FALSE(warned(file("a.relievo") + " --light 1,0,1"));
  EXPECT_FALSE(warned(file("flat.relievo")));
  ok("sample coin -o " + file("c") + " --size 128x128 --write ptm-lrgb");
  ok("build --ptm " + file("c/ptm_lrgb.ptm") + " -o " + file("ptm.relievo"));
  const auto refused = relievo("render " + file("ptm.relievo") + " -o " + file("3.png") + " --unlit");
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_NE(refused.output.find("--unlit"), std::string::npos) << refused.output;
}

}  // namespace lit_relief_gltest
}  // namespace relievo
