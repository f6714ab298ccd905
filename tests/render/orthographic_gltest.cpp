// What orthographic pictures promise: every place of the artwork is in the picture where its millimetres over the scale
// say, whatever its depth and however near the eye is said to be; the error promised is kept; and the picture is the
// one that ever longer lenses come to. With both kinds of depth buffers. (Equality with the dense reference:
// virtual_equals_dense_gltest.cpp; with an analytic ball: mesh_picture_gltest.cpp.)
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>

#include "geometry/lod/patch_vertex.h"
#include "src/engine/lod_views.h"
#include "tests/geometry/true_relief.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"
#include "tests/render/made_pages.h"
#include "tests/render/true_patches.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo {
namespace orthographic_gltest {

using namespace test;

constexpr int kWidth = 480, kHeight = 270;

// ---- a sheet with a known grid

constexpr int64_t kSheet = 640, kEvery = 32;  // texels; a line of one texel at 16, 48, 80 ...
constexpr double kTexelMm = 0.1;

class GridSheet final : public TextureSource {
 public:
  int64_t width() const override { return kSheet; }
  int64_t height() const override { return kSheet; }
  TextureFormat format() const override {
    TextureFormat f;
    f.basis = Basis::kColour;
    return f;
  }
  Provenance provenance() const override { return {"grid", "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t at = 0;
    for (int c = 0; c < 3; ++c)  // red: lines along y, at their x; green: along x; blue: all of it
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x)
          out[at++] = c == 2 || (c == 0 ? x : y) % kEvery == kEvery / 2 ? 255 : 0;
    return {};
  }
};

struct Lines {
  int found = 0;
  double furthest_px = 0;  // from where they belong
};
// How far lines are beside their places, along the picture's axis on which they are told apart. A line's profile is a
// tent (bilinear between texels); where it lies is the shift that fits its pixels best, by least squares. truth: pixels
// of a place on the sheet (mm), an affine function.
template <class Truth>
Lines measure(const std::vector<uint8_t>& pixels, int axis, Truth&& truth) {
  Lines lines;
  const glm::dvec2 origin = truth(glm::dvec2(0)), dx = truth(glm::dvec2(1, 0)) - origin,
                   dy = truth(glm::dvec2(0, 1)) - origin;
  const glm::dmat2 mm_from_px = glm::inverse(glm::dmat2(dx, dy));
  // The sheet's place, in texels, of a pixel's centre.
  auto texelOf = [&](double x, double y) {
    const glm::dvec2 mm = mm_from_px * (glm::dvec2(x + 0.5, y + 0.5) - origin);
    return axis == 0 ? mm.x / kTexelMm + 0.5 * kSheet : 0.5 * kSheet - mm.y / kTexelMm;
  };
  const int across = axis == 0 ? kWidth : kHeight, along = axis == 0 ? kHeight : kWidth;
  for (int row = 3; row < along; row += 29) {
    struct Fit {
      double top = 0, bottom = 0;
      int pixels = 0;
    };
    std::vector<Fit> fits(static_cast<size_t>(kSheet / kEvery));
    for (int i = 0; i < across; ++i) {
      const int x = axis == 0 ? i : row, y = axis == 0 ? row : i;
      const uint8_t* p = &pixels[4 * static_cast<size_t>(y * kWidth + x)];
      const double texel = texelOf(x, y), slope = axis == 0 ? texelOf(x + 1, y) - texel : texelOf(x, y + 1) - texel;
      const auto line = static_cast<int64_t>(std::floor(texel / kEvery));
      const double off = texel - (static_cast<double>(line * kEvery) + kEvery / 2.0 + 0.5);
      if (!p[3] || line < 0 || line >= kSheet / kEvery || std::abs(off) > 2) continue;
      Fit& fit = fits[static_cast<size_t>(line)];
      const double wanted = 255 * std::max(0.0, 1 - std::abs(off)),
                   change = std::abs(off) < 1 ? 255 * slope * (off < 0 ? -1 : 1) : 0;  // for a shift to the right
      fit.top += (p[axis] - wanted) * change;
      fit.bottom += change * change;
      fit.pixels += p[axis] > 0 || change != 0;
    }
    for (const Fit& f : fits) {
      if (f.pixels < 4) continue;
      ++lines.found;
      lines.furthest_px = std::max(lines.furthest_px, std::abs(f.top / f.bottom));
    }
  }
  return lines;
}

TEST(Orthographic, AGridIsWhereItsMillimetresSay) {
  const Subject sheet = denseSubject(GridSheet(), nullptr);
  ASSERT_EQ(sheet.texture->domain.mm_per_px, kTexelMm);
  for (bool reversed : {true, false}) {
    auto engine = makeEngine(sheet.artwork, Scene{}, {.reversed_depth = reversed}, kWidth, kHeight);
    ASSERT_TRUE(engine);
    std::mt19937 random(kSeed);
    Lines all;
    double nearer = 0, wrong_scale = 0;
    for (double mm_per_px : {0.043, 0.03, 0.021}) {
      for (int round = 0; round < 4; ++round) {
        OrbitCamera c;
        c.orthographic = true;
        c.fov_deg = std::array{35.0, 1.0, 170.0, 60.0}[static_cast<size_t>(round)];
        c.distance_mm = distanceForScale(c, mm_per_px, kHeight);
        // From the front, then at a slant; the target on the sheet, then before and behind it.
        if (round > 1) c.azimuth_deg = uniform(random, -40, 40), c.elevation_deg = uniform(random, -40, 40);
        c.target_mm = {uniform(random, -10, 10), uniform(random, -10, 10), round % 2 ? uniform(random, -50, 50) : 0};
        const double az = glm::radians(c.azimuth_deg), el = glm::radians(c.elevation_deg);
        const glm::dvec3 right{std::cos(az), 0, -std::sin(az)},
            up{-std::sin(az) * std::sin(el), std::cos(el), -std::cos(az) * std::sin(el)};
        auto at = [&](double scale) {
          return [&, scale](const glm::dvec2& mm) {
            const glm::dvec3 p = glm::dvec3(mm, 0) - c.target_mm;
            return glm::dvec2(kWidth / 2.0 + glm::dot(p, right) / scale, kHeight / 2.0 - glm::dot(p, up) / scale);
          };
        };
        engine->setCamera(c);
        ASSERT_TRUE(engine->settle(60).ok());
        const auto pixels = engine->readPixels();
        for (int axis : {0, 1}) {
          const Lines lines = measure(pixels, axis, at(mm_per_px));
          all.found += lines.found;
          all.furthest_px = std::max(all.furthest_px, lines.furthest_px);
          wrong_scale = std::max(wrong_scale, measure(pixels, axis, at(1.001 * mm_per_px)).furthest_px);
        }
        EXPECT_NEAR(engine->stats().mm_per_px, mm_per_px, 1e-12);
        if (round > 0) continue;
        c.orthographic = false;
        c.target_mm.z = -0.2;
        engine->setCamera(c);
        ASSERT_TRUE(engine->settle(60).ok());
        nearer = std::max(nearer, measure(engine->readPixels(), 0, at(mm_per_px)).furthest_px);
      }
    }
    std::printf(
        "[ picture  ] seed %u, %s depth: %d places of lines, at most %.4f px beside theirs; with a scale 0.1 %% off "
        "%.2f, in perspective, 0.2 mm nearer, %.2f\n",
        kSeed, reversed ? "reversed" : "conventional", all.found, all.furthest_px, wrong_scale, nearer);
    EXPECT_GT(all.found, 1000);
    EXPECT_LT(all.furthest_px, 0.01);
    EXPECT_GT(wrong_scale, 0.1) << "control";
    EXPECT_GT(nearer, 0.1) << "control";
  }
}

// ---- a relief

// The texture is a colour; heights are those of reliefHeight().
class ReliefSource final : public PageSource {
 public:
  explicit ReliefSource(const FlatDomain& domain) : pages_(domain, reliefHeight) {}
  Result<EncodedPage> read(PageId id) const override {
    const NodeId n = id.node();
    if (id.plane() != Plane::kRelief) return madeTexturePage(std::vector<uint8_t>(kTexturePageBytes, 150));
    const auto page = pages_(n);
    size_t at = 0;
    return madeReliefPage(n, [&](double, double) { return page[at++]; });
  }

 private:
  ReliefPages pages_;
};

struct Relief {
  FlatDomain domain = makeDomain(900, 700, 0);
  std::shared_ptr<TrueRelief> truth;
  Artwork artwork;
  Relief() {
    domain.relief_scale_mm = 3.0 / 65535;
    domain.relief_offset_mm = -1;
    truth = std::make_shared<TrueRelief>(domain, reliefHeight);
    artwork.manifest.domain = domain;
    artwork.manifest.texture.basis = Basis::kColour;
    artwork.source = std::make_shared<ReliefSource>(domain);
    artwork.oracle = truth;
  }
  OrbitCamera camera(std::mt19937& random) const {
    OrbitCamera c;
    c.orthographic = true;
    c.azimuth_deg = uniform(random, -70, 70);
    c.elevation_deg = uniform(random, -70, 70);
    c.target_mm = {uniform(random, -15, 15), uniform(random, -12, 12), uniform(random, -20, 20)};
    c.distance_mm = distanceForScale(c, std::exp(uniform(random, std::log(0.02), std::log(0.3))), kHeight);
    return c;
  }
};

// What the GL computes in floats, from the camera on, against the analytic place of each vertex.
TEST(Orthographic, VerticesOfAReliefAreWhereTheirMillimetresSay) {
  const Relief relief;
  auto engine = makeEngine(relief.artwork, Scene{}, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  ReliefPages pages(relief.domain, reliefHeight);
  std::mt19937 random(kSeed);
  uint64_t vertices = 0;
  double furthest = 0, without_heights = 0;
  for (int view = 0; view < 12; ++view) {
    const OrbitCamera c = relief.camera(random);
    const double az = glm::radians(c.azimuth_deg), el = glm::radians(c.elevation_deg), scale = mmPerPx(c, kHeight);
    const glm::dvec3 right{std::cos(az), 0, -std::sin(az)},
        up{-std::sin(az) * std::sin(el), std::cos(el), -std::cos(az) * std::sin(el)};
    engine->setCamera(c);
    ASSERT_TRUE(engine->settle(60).ok());
    const auto captured = engine->captureVertices(10'000'000);
    ASSERT_FALSE(captured.empty());
    const double mm_per_unit = relief.domain.mm_per_px / (1 << kUnitsPerTexelLog2);
    const glm::dvec2 half(static_cast<double>(relief.domain.width_px << kUnitsPerTexelLog2) / 2,
                          static_cast<double>(relief.domain.height_px << kUnitsPerTexelLog2) / 2);
    size_t at = 0;
    for (const PatchInstance& p : engine->instances()) {
      const uint32_t last = 1u << p.grid_level;
      for (uint32_t j = 0; j <= last; ++j)
        for (uint32_t i = 0; i <= last; ++i, at += 4) {
          const PatchVertex v = patchVertex(relief.domain, p, i, j, true, pages);
          const double z = relief.domain.relief_offset_mm + relief.domain.relief_scale_mm * v.height_q8 / 256;
          const glm::dvec3 from_target = glm::dvec3((static_cast<double>(v.x) - half.x) * mm_per_unit,
                                                    (half.y - static_cast<double>(v.y)) * mm_per_unit, z) -
                                         c.target_mm;
          const glm::dvec2 truth = glm::dvec2(glm::dot(from_target, right), glm::dot(from_target, up)) / scale;
          const glm::dvec2 found = glm::dvec2(captured[at], captured[at + 1]) / static_cast<double>(captured[at + 3]) *
                                   glm::dvec2(kWidth, kHeight) / 2.0;
          ASSERT_EQ(captured[at + 3], 1.0f);
          if (std::abs(truth.x) > kWidth || std::abs(truth.y) > kHeight) continue;
          ++vertices;
          furthest = std::max(furthest, glm::length(found - truth));
          without_heights =
              std::max(without_heights, glm::length(found - truth + glm::dvec2(right.z, up.z) * (z / scale)));
        }
    }
  }
  std::printf("[ picture  ] seed %u: %llu vertices, at most %.5f px from their places; heights set aside %.1f\n", kSeed,
              static_cast<unsigned long long>(vertices), furthest, without_heights);
  EXPECT_GT(vertices, 20'000u);
  EXPECT_LT(furthest, 0.01);
  EXPECT_GT(without_heights, 10) << "control";
}

// What was promised of pictures, and what was measured.
struct Promises {
  uint64_t samples = 0;
  int views = 0, above = 0, above_a_third = 0;
  double largest = 0, tightest = 0;
  void note(const Measured& m, double promised) {
    ++views;
    samples += m.samples;
    above += m.max_px > promised * (1 + 1e-6) + 1e-6;
    above_a_third += m.max_px > promised / 3;
    largest = std::max(largest, m.max_px);
    if (promised > 0) tightest = std::max(tightest, m.max_px / promised);
  }
  void expectKept(const char* of, uint64_t least_samples) const {
    std::printf(
        "[ picture  ] seed %u, %s: %d views, %llu samples: errors of up to %.2f px, %d above its promise; %.2f of it "
        "at most\n",
        kSeed, of, views, static_cast<unsigned long long>(samples), largest, above, tightest);
    EXPECT_GT(samples, least_samples);
    EXPECT_EQ(above, 0);
    EXPECT_GT(above_a_third, 0) << "control: a third of it is no promise";
  }
};

TEST(Orthographic, ThePromisedErrorIsKept) {
  const Relief relief;
  Scene scene;
  ReliefPages pages(relief.domain, reliefHeight);
  std::mt19937 random(kSeed);
  Promises promises;
  auto engine = makeEngine(relief.artwork, scene, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  for (int k = 0; k < 16; ++k) {
    OrbitCamera c = relief.camera(random);
    if (k % 4 == 1) c.azimuth_deg = c.elevation_deg = uniform(random, -2, 2);  // heights point at the eye
    engine->setCamera(c);
    scene.error_px = std::exp(uniform(random, -1, 2));
    scene.exaggerate = k % 4 == 3 ? 2 : 1;
    ASSERT_TRUE(engine->setScene(scene).ok());
    ASSERT_TRUE(engine->settle(60).ok());
    LodView view = lodViewFrom(engine->view());
    view.exaggerate = scene.exaggerate;
    const Camera picture{.aspect = static_cast<double>(kWidth) / kHeight, .viewport_height_px = kHeight};
    const Measured m = measureError(relief.domain, *relief.truth, view, picture, engine->instances(), pages);
    promises.note(m, engine->stats().predicted_error_px);
  }
  promises.expectKept("a sheet", 100'000);
}

// Over a base mesh: a ball of turned patches, smooth with a rough part, through a package.
TEST(Orthographic, ThePromisedErrorIsKeptOnABody) {
  BaseMesh mesh = cubeSphere(2, 40);
  Random turns(kSeed);
  turnPatches(mesh, turns);
  const MeshRelief relief{1, -2, 6.0 / 65535};
  auto height = [](const glm::dvec3& p, const Place& place) {
    const double waves = 0.4 + 0.2 * std::sin(0.12 * p.x + 1) * std::cos(0.1 * p.y) + 0.1 * std::sin(0.2 * p.z);
    return waves + (p.x + p.y > 25 ? 0.08 * static_cast<double>(hashOf(place, 5) & 1023) / 1023 : 0);
  };
  TemporaryFolder folder;
  BuildOptions build;
  build.output = folder.file("ball.relievo");
  ASSERT_TRUE(buildPatchPackage(TruePatches(mesh, relief, height), build).ok());
  auto package = Package::open(build.output);
  ASSERT_TRUE(package.ok());
  const TrueMeshRelief truth(mesh, relief, height);
  Scene scene;
  auto engine = makeEngine(artworkFromPackage(*package), scene, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  std::mt19937 random(kSeed);
  Promises promises;
  for (int view = 0; view < 12; ++view) {
    OrbitCamera c;
    c.orthographic = true;
    c.azimuth_deg = uniform(random, -180, 180), c.elevation_deg = uniform(random, -85, 85);
    c.target_mm = {uniform(random, -30, 30), uniform(random, -30, 30), uniform(random, -30, 30)};
    c.distance_mm = distanceForScale(c, std::exp(uniform(random, std::log(0.05), std::log(0.5))), kHeight);
    engine->setCamera(c);
    scene.error_px = std::exp(uniform(random, -1, 1.5));
    ASSERT_TRUE(engine->setScene(scene).ok());
    ASSERT_TRUE(engine->settle(60).ok());
    const Camera picture{.aspect = static_cast<double>(kWidth) / kHeight, .viewport_height_px = kHeight};
    const Measured m =
        measureError(truth, relief.unitLog2(), lodViewFrom(engine->view()), picture, engine->instances());
    promises.note(m, engine->stats().predicted_error_px);
  }
  promises.expectKept("a body", 50'000);
}

// ---- a long lens

struct Difference {
  uint64_t seen = 0, other_cover = 0;
  double mean = 0;
  int most_of_999 = 0;  // what 99.9 % of the pixels keep to, of 255
};
// Of the pixels up to so far from the picture's middle, along either axis.
Difference difference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b, int reach_px) {
  Difference d;
  std::array<uint64_t, 256> of{};
  for (size_t i = 0; i < a.size(); i += 4) {
    const int x = static_cast<int>(i / 4 % kWidth) - kWidth / 2, y = static_cast<int>(i / 4 / kWidth) - kHeight / 2;
    if (std::max(std::abs(x), std::abs(y)) > reach_px) continue;
    d.other_cover += (a[i + 3] != 0) != (b[i + 3] != 0);
    if (!a[i + 3] || !b[i + 3]) continue;
    int most = 0;
    for (size_t c = 0; c < 3; ++c) most = std::max(most, std::abs(a[i + c] - b[i + c]));
    ++d.seen;
    ++of[static_cast<size_t>(most)];
    d.mean += most;
  }
  d.mean /= static_cast<double>(std::max<uint64_t>(1, d.seen));
  for (uint64_t sum = 0; d.most_of_999 < 255; ++d.most_of_999)
    if (sum += of[static_cast<size_t>(d.most_of_999)]; static_cast<double>(sum) >= 0.999 * static_cast<double>(d.seen))
      break;
  return d;
}

// What lies h before the plane through the target is drawn larger by h over the distance. From the front at one degree,
// with 2 mm of relief, 150 mm of artwork and 7 m: by 0.03 px at the picture's border. At a slant the sheet itself comes
// nearer, by as much in the 20 px around the middle. Colours a pixel apart differ by up to some 60 of 255: 3 in all but
// a thousandth of the pixels.
TEST(Orthographic, IsWhatALongLensComesTo) {
  const Subject subject = noiseSubject(1501, 1103, Basis::kPtmLrgb, 2, 7);
  Scene scene;
  scene.error_px = 0.25;
  scene.light = {-0.5, 0.3, 0.8};
  auto engine = makeEngine(subject.artwork, scene, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  std::mt19937 random(kSeed);
  auto picture = [&](const OrbitCamera& c) {
    engine->setCamera(c);
    EXPECT_TRUE(engine->settle(60).ok());
    return engine->readPixels();
  };
  for (int view = 0; view < 4; ++view) {
    OrbitCamera c = fitCamera(subject.texture->domain, kWidth, kHeight, 1);
    c.azimuth_deg = view ? uniform(random, -40, 40) : 0;
    c.elevation_deg = view ? uniform(random, -40, 40) : 0;
    const double mm_per_px = mmPerPx(c, kHeight);
    const auto lens = picture(c);
    c.orthographic = true;
    const auto parallel = picture(c);
    c.orthographic = false;
    c.fov_deg = 35;
    c.distance_mm = distanceForScale(c, mm_per_px, kHeight);
    const auto wide = picture(c);
    const int reach_px = view ? 20 : kWidth;
    const Difference d = difference(parallel, lens, reach_px), control = difference(parallel, wide, reach_px);
    std::printf(
        "[ picture  ] seed %u: %llu pixels, 1 degree: mean %.3f, 99.9 %% within %d of 255, %llu at the border; 35 "
        "degrees: mean %.2f, %d, %llu\n",
        kSeed, static_cast<unsigned long long>(d.seen), d.mean, d.most_of_999,
        static_cast<unsigned long long>(d.other_cover), control.mean, control.most_of_999,
        static_cast<unsigned long long>(control.other_cover));
    EXPECT_GT(d.seen, view ? 1'600u : 20'000u);
    EXPECT_LE(d.most_of_999, 3);
    EXPECT_LE(d.other_cover, 20u);
    EXPECT_GT(control.most_of_999, 6) << "control";
  }
}

}  // namespace orthographic_gltest
}  // namespace relievo
