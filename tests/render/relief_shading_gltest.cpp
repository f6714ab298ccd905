// Slope, curvature and depth against references in double precision: of flat artworks computed cell by cell from all
// samples of the relief, of scans from a ball. And that a scene without them is what it was, and reads what it read.
#include <gtest/gtest.h>

#include <chrono>
#include <numbers>
#include <thread>

#include "src/base/srgb.h"
#include "src/engine/effects/relief_shading.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/lit_ball.h"
#include "tests/render/made_engine.h"

namespace relievo {
namespace relief_shading_gltest {

using namespace test;
using Kind = ReliefShading::Kind;
using Map = ReliefShading::Map;

constexpr int64_t kSide = 256;
constexpr double kMmPerPx = 0.1;  // denseSubject's

const Subject& subject(Basis basis = Basis::kPtmRgb) { return noiseSubjectOnce(kSide, kSide, basis, 3, 41); }

// `level`: so many times twice as many texels a pixel; from above each pixel's centre is a texel's of that level.
OrbitCamera above(int level) {
  OrbitCamera c;
  c.orthographic = true;
  c.distance_mm = distanceForScale(c, std::ldexp(kMmPerPx, level), static_cast<int>(kSide >> level));
  return c;
}
std::vector<uint8_t> fromAbove(Engine& engine, const Scene& scene, int level = 0) {
  engine.resize(static_cast<int>(kSide >> level), static_cast<int>(kSide >> level));
  engine.setCamera(above(level));
  auto set = engine.setScene(scene);
  EXPECT_TRUE(set.ok()) << (set.ok() ? "" : set.error().text());
  auto settled = engine.settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  return engine.readPixels();
}

// The value at each texel of a level, from its samples: every 2^level-th of the finest, mm. No code is shared with the
// pages: sums run over every cell of the disc, and slopes are those of the bilinear surface.
class Measured {
 public:
  Measured(const DenseRelief& relief, int level) : cells_(kSide >> level), side_mm_(std::ldexp(kMmPerPx, level)) {
    const auto step = int64_t{1} << level;
    for (int64_t j = 0; j <= cells_; ++j)
      for (int64_t i = 0; i <= cells_; ++i)
        heights_.push_back(relief.offset_mm +
                           relief.scale_mm * relief.samples[static_cast<size_t>(j * step * relief.width + i * step)]);
  }
  double slope(int64_t x, int64_t y) const {
    const double right = (sample(x + 1, y) + sample(x + 1, y + 1) - sample(x, y) - sample(x, y + 1)) / (2 * side_mm_),
                 down = (sample(x, y + 1) + sample(x + 1, y + 1) - sample(x, y) - sample(x + 1, y)) / (2 * side_mm_);
    return std::atan(std::sqrt(right * right + down * down)) * 180 / std::numbers::pi;
  }
  double height(int64_t x, int64_t y) const {
    x = std::clamp<int64_t>(x, 0, cells_ - 1);
    y = std::clamp<int64_t>(y, 0, cells_ - 1);
    return (sample(x, y) + sample(x + 1, y) + sample(x, y + 1) + sample(x + 1, y + 1)) / 4;
  }
  double curvature(int64_t x, int64_t y, double radius_mm) const {
    const double radius = std::max(radius_mm / side_mm_, 1.5);
    const auto [outer, outer_square] = mean(x, y, radius);
    const auto [inner, inner_square] = mean(x, y, radius / 2);
    return -2 * (outer - inner) / ((outer_square - inner_square) * side_mm_ * side_mm_);
  }
  int64_t cells() const { return cells_; }

 private:
  double sample(int64_t x, int64_t y) const { return heights_[static_cast<size_t>(y * (cells_ + 1) + x)]; }
  std::pair<double, double> mean(int64_t x, int64_t y, double radius) const {
    double sum = 0, square = 0, count = 0;
    const auto reach = static_cast<int64_t>(radius);
    for (int64_t j = -reach; j <= reach; ++j)
      for (int64_t i = -reach; i <= reach; ++i) {
        const double distance = static_cast<double>(i * i + j * j);
        if (distance > radius * radius) continue;
        sum += height(x + i, y + j);
        square += distance;
        count += 1;
      }
    return {sum / count, square / count};
  }
  int64_t cells_;
  double side_mm_;
  std::vector<double> heights_;
};

// Every fifth pixel along each axis; the largest difference, of 255.
double largestError(const std::vector<uint8_t>& pixels, const Measured& measured, const ShadingScale& scale,
                    const std::function<double(int64_t, int64_t)>& value) {
  double largest = 0;
  for (int64_t y = 0; y < measured.cells(); y += 5)
    for (int64_t x = 0; x < measured.cells(); x += 5) {
      const glm::dvec3 colour = 255.0 * shadedColour(scale, value(x, y));
      for (int c = 0; c < 3; ++c)
        largest =
            std::max(largest, std::abs(pixels[static_cast<size_t>((y * measured.cells() + x) * 4 + c)] - colour[c]));
    }
  return largest;
}

TEST(ReliefShading, OfFlatArtworksIsItsReference) {
  const Subject& s = subject();
  auto engine = makeEngine(s.artwork, {}, {}, 64, 64);
  ASSERT_TRUE(engine);
  for (const int level : {0, 1}) {
    const Measured measured(*s.relief, level);
    const auto check = [&](const ReliefShading& shading, double off, const char* what,
                           const std::function<double(int64_t, int64_t)>& value,
                           const std::function<double(int64_t, int64_t)>& wrong) {
      // Neither how the geometry is drawn, nor what is no setting of it, changes a value.
      const Scene scene{.light = {1, 0, 0.1}, .shading = shading, .filter = Filter::kFast, .exaggerate = 3};
      const auto pixels = fromAbove(*engine, scene, level);
      const ShadingScale scale = scaleOf(shading, s.artwork.manifest);
      const double error = largestError(pixels, measured, scale, value);
      EXPECT_LE(error, off) << what << " at level " << level;
      EXPECT_GT(largestError(pixels, measured, scale, wrong), 6) << "the control: " << what;
      EXPECT_EQ(engine->stats().planes_read, std::vector<std::string>{"relief"});
      std::printf("[ shading  ] %s, level %d: off by at most %.2f of 255\n", what, level, error);
    };
    // A GPU's conversion to bytes (0.6 of a step as Direct3D has it, 0.5 in software), and what 16 bits of the value
    // are.
    const double kOff = gl::currentContextInfo().software ? 0.55 : 0.65;
    const auto slope = [&](int64_t x, int64_t y) { return measured.slope(x, y); };
    const auto height = [&](int64_t x, int64_t y) { return measured.height(x, y); };
    const auto bent = [&](double radius_mm) {
      return [&measured, radius_mm](int64_t x, int64_t y) { return measured.curvature(x, y, radius_mm); };
    };
    check({.kind = Kind::kSlope, .full_deg = 70}, kOff, "slope", slope,
          [&](int64_t x, int64_t y) { return measured.slope(x, y) + 2; });
    check({.kind = Kind::kSlope, .map = Map::kColour, .full_deg = 20}, kOff, "steeper slope", slope,
          [&](int64_t x, int64_t y) { return measured.slope(x, std::max<int64_t>(y - 1, 0)); });
    check({.kind = Kind::kCurvature, .radius_mm = 0.55, .full_per_mm = 0.7}, kOff, "curvature", bent(0.55), bent(0.7));
    check({.kind = Kind::kCurvature, .map = Map::kColour, .radius_mm = 1.7, .full_per_mm = 0.1}, kOff, "wide curvature",
          bent(1.7), [&](int64_t x, int64_t y) { return -measured.curvature(x, y, 1.7); });
    check({.kind = Kind::kDepth}, kOff, "depth", height, slope);
    check({.kind = Kind::kDepth, .map = Map::kColour, .low_mm = 0.4, .high_mm = -0.6}, kOff, "turned depth", height,
          [&](int64_t x, int64_t y) { return measured.height(x, y) + 0.05; });
  }
  // No page of the texture was read since the first scene's.
  EXPECT_EQ(engine->stats().streamer.pages_read[0], 0u);
  EXPECT_EQ(engine->stats().streamer.pages_read[static_cast<size_t>(kNormalPlane)], 0u) << "made, not read";
  EXPECT_GT(engine->stats().streamer.pages_uploaded[static_cast<size_t>(kNormalPlane)], 0u);
}

// A ball's normal is known everywhere, and it bends by 1 / radius. Only the normals are read for its slope, and nothing
// for its depth.
TEST(ReliefShading, OfABallIsMeasuredAgainstADirection) {
  const auto base = std::make_shared<const BaseMesh>(cubeSphere(2, kRadius));
  const glm::dvec3 up = glm::normalize(glm::dvec3(0.3, -0.5, 0.8));
  // Pinned root pages, or tails in their place.
  for (const bool tails : {false, true}) {
    const EngineOptions options{.most_pinned_patches = tails ? 1u : 64u, .reversed_depth = tails};
    ReliefShading slope{.kind = Kind::kSlope, .full_deg = 80, .up = {0.6, -1.0, 1.6}},
        depth = slope, bent{.kind = Kind::kCurvature, .radius_mm = 4, .full_per_mm = 0.06};
    slope.map = Map::kColour;
    depth.kind = Kind::kDepth;
    auto engine = makeEngine(ballArtwork(base, 1, 7), {.shading = slope, .error_px = 0.3}, options, kWidth, kHeight);
    ASSERT_TRUE(engine);
    OrbitCamera camera = engine->camera();
    camera.azimuth_deg = 40;
    camera.elevation_deg = 25;
    engine->setCamera(camera);
    for (const ReliefShading& shading : {slope, depth, bent}) {
      Scene scene{.error_px = 0.3};
      scene.shading = shading;
      ASSERT_TRUE(engine->setScene(scene).ok());
      ASSERT_TRUE(engine->settle(60).ok());
      const auto pixels = engine->readPixels();
      const ShadingScale scale = scaleOf(shading, engine->manifest());
      const auto differenceOf = [&](const glm::dvec3& towards) {
        return compareWithBall(pixels, engine->view(), kRadius, [&](const glm::dvec3& n) -> std::optional<glm::dvec3> {
          if (shading.kind == Kind::kCurvature) return 255.0 * shadedColour(scale, towards == up ? 1 / kRadius : 0);
          const double degrees = std::acos(std::clamp(glm::dot(n, towards), -1.0, 1.0)) * 180 / std::numbers::pi;
          return 255.0 * shadedColour(scale, shading.kind == Kind::kSlope ? degrees : kRadius * glm::dot(n, towards));
        });
      };
      const BallDifference d = differenceOf(up);
      EXPECT_GT(d.inside, 3000u);
      EXPECT_EQ(d.holes, 0u);
      EXPECT_EQ(d.strays, 0u);
      // Normals are bytes: half a step is 0.4 degrees, or 2 of a scale's 255 colours, and more of a difference.
      EXPECT_LE(d.largest, shading.kind == Kind::kDepth ? 1 : 4) << shadingName(shading.kind) << tails;
      EXPECT_GT(differenceOf(glm::dvec3(0, 0, 1)).largest, 20) << "the control";
      const auto& read = engine->stats().streamer.pages_read;
      EXPECT_EQ(read[0], 0u) << "no albedo";
      if (shading.kind == Kind::kDepth) {
        EXPECT_EQ(read[static_cast<size_t>(kNormalPlane)], 0u);
        EXPECT_EQ(engine->stats().planes_read, std::vector<std::string>{"relief"});
        EXPECT_EQ(engine->stats().passes, (std::vector<std::string>{"surface", "kept depth", "shade"}));
      }
    }
  }
}

// A wave z = kHighMm (1 + sin(k x)) over one square patch, so that curvature differs from place to place and between
// the two ways at a place.
constexpr double kSquareMm = 60, kHighMm = 3, kWave = 2 * std::numbers::pi / 30;
double waveZ(double x) { return kHighMm * (1 + std::sin(kWave * x)); }
glm::dvec3 waveNormal(double x) { return glm::normalize(glm::dvec3(-kHighMm * kWave * std::cos(kWave * x), 0, 1)); }

class WavePages final : public PageSource {
 public:
  Result<EncodedPage> read(PageId id) const override {
    const NodeId n = id.node();
    if (id.plane() == Plane::kRelief)
      return madeReliefPage(n, [](double u, double) {
        return static_cast<uint16_t>(std::lround(waveZ(kSquareMm * (u - 0.5)) / (2 * kHighMm) * 65535));
      });
    const double nodes = std::ldexp(1.0, static_cast<int>(n.level));
    std::vector<uint8_t> channels(kTexturePageBytes);
    constexpr size_t plane = size_t{kPageFullPx} * kPageFullPx;
    for (size_t at = 0; at < plane; ++at) {
      const double u = (n.x + (static_cast<double>(at % kPageFullPx) + 0.5 - kPageBorderPx) / kPagePx) / nodes;
      const glm::dvec3 normal = waveNormal(kSquareMm * (u - 0.5));
      for (size_t c = 0; c < 3; ++c)
        channels[c * plane + at] = static_cast<uint8_t>(std::lround(127.5 * (normal[static_cast<int>(c)] + 1)));
    }
    return madeTexturePage(channels);
  }
};

TEST(ReliefShading, CurvatureOfAScanIsItsReference) {
  auto base = std::make_shared<BaseMesh>();
  for (const glm::vec2 at : {glm::vec2(-1, 1), {1, 1}, {-1, -1}, {1, -1}})
    base->corners.push_back({glm::vec3(at, 0) * static_cast<float>(kSquareMm / 2), glm::vec3(0, 0, 1)});
  base->patches.push_back({0, 1, 2, 3});
  Artwork artwork;
  artwork.manifest = madeManifest(base, 1, 1, 2 * kHighMm);
  artwork.source = std::make_shared<WavePages>();
  artwork.oracle = std::make_shared<test::MadeUpMeshOracle>(test::MeshRelief{1, 0, 2 * kHighMm / 65535}, 9, 0.05);
  const ReliefShading shading{.kind = Kind::kCurvature, .radius_mm = 2.5, .full_per_mm = 0.08};
  auto engine = makeEngine(artwork, {.shading = shading, .error_px = 0.3}, {}, kWidth, kHeight);
  ASSERT_TRUE(engine);
  OrbitCamera camera = engine->camera();
  camera.orthographic = true;
  camera.azimuth_deg = 20;
  camera.elevation_deg = -15;
  camera.distance_mm = distanceForScale(camera, 0.25, kHeight);
  engine->setCamera(camera);
  ASSERT_TRUE(engine->settle(60).ok());
  EXPECT_EQ(engine->stats().passes,
            (std::vector<std::string>{"surface", "kept depth", "normals", "shade", "feedback"}));
  EXPECT_EQ(engine->stats().streamer.pages_read[0], 0u) << "no albedo";
  const auto pixels = engine->readPixels();
  const glm::dmat4 world_from_clip = glm::inverse(engine->view().clip_from_world);
  const auto place = [&](double x, double y, double z) {
    const glm::dvec4 p = world_from_clip * glm::dvec4(x / kWidth * 2 - 1, 1 - y / kHeight * 2, z, 1);
    return glm::dvec3(p) / p.w;
  };
  const glm::dvec3 sight = glm::normalize(place(9, 9, 0.5) - place(9, 9, -0.5));
  // Where a line of sight through p meets the wave: Newton's method.
  const auto seen = [&](glm::dvec3 p) {
    for (int i = 0; i < 12; ++i) {
      const glm::dvec3 n = waveNormal(p.x);
      p += (waveZ(p.x) - p.z) * n.z / glm::dot(n, sight) * sight;
    }
    return p;
  };
  // The sum over a disc of many places, in double precision. round: else it is an ellipse twice as long along the wave.
  const auto expected = [&](const glm::dvec3& at, double radius, bool round) {
    const glm::dvec3 n = waveNormal(at.x), side = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), n)),
                     other = glm::cross(n, side);
    std::vector<glm::dvec3> places, normals;
    constexpr int kHalf = 7;
    for (int i = -kHalf; i <= kHalf; ++i)
      for (int j = -kHalf; j <= kHalf; ++j) {
        if (i * i + j * j > kHalf * kHalf) continue;
        const double along = (round ? 1 : 2) * static_cast<double>(i);
        places.push_back(seen(at + radius / (kHalf + 0.5) * (along * side + static_cast<double>(j) * other)));
        normals.push_back(waveNormal(places.back().x));
      }
    return scanCurvature(n, at, normals, places);
  };
  const ShadingScale scale = scaleOf(shading, engine->manifest());
  double largest = 0, longer = 0, wide = 0, darkest = 255, lightest = 0;
  int compared = 0;
  for (int y = 4; y < kHeight; y += 11)
    for (int x = 4; x < kWidth; x += 11) {
      const uint8_t* p = &pixels[static_cast<size_t>(y * kWidth + x) * 4];
      const glm::dvec3 at = seen(place(x + 0.5, y + 0.5, 0));
      if (std::max(std::abs(at.x), std::abs(at.y)) > kSquareMm / 2 - 4) continue;  // its disc would be cut
      ASSERT_EQ(p[3], 255);
      const auto off = [&](double radius, bool round) {
        return std::abs(p[0] - 255 * shadedColour(scale, expected(at, radius, round)).x);
      };
      largest = std::max(largest, off(2.5, true));
      longer = std::max(longer, off(2.5, false));
      wide = std::max(wide, off(5, true));
      darkest = std::min<double>(darkest, p[0]);
      lightest = std::max<double>(lightest, p[0]);
      ++compared;
    }
  std::printf("[ shading  ] curvature of a wave: off by at most %.2f of 255, %d places from %g to %g\n", largest,
              compared, darkest, lightest);
  EXPECT_GT(compared, 200);
  EXPECT_LE(largest, 4);
  EXPECT_GT(lightest - darkest, 150);
  // Controls: a longer disc, and a wider one.
  EXPECT_GT(longer, 8);
  EXPECT_GT(wide, 8);
}

// From light to shading, from one shading to another, and back: the picture of an engine that was made for it.
TEST(ReliefShading, ComesAndGoes) {
  const Subject& s = subject();
  auto engine = makeEngine(s.artwork, {.light = {-0.7, 0.2, 0.6}}, {}, 64, 64);
  ASSERT_TRUE(engine);
  std::vector<Scene> scenes(6, Scene{.light = {-0.7, 0.2, 0.6}});
  scenes[1].shading = {.kind = Kind::kSlope};
  scenes[2].shading = {.kind = Kind::kCurvature, .radius_mm = 0.5};
  scenes[3].shading = {.kind = Kind::kCurvature, .radius_mm = 1};
  scenes[4].shading = {.kind = Kind::kDepth};
  scenes[4].relief = false;
  std::vector<std::vector<uint8_t>> pictures;
  for (const Scene& scene : scenes) {
    pictures.push_back(fromAbove(*engine, scene, 1));
    auto fresh = makeEngine(s.artwork, scene, {}, 64, 64);
    ASSERT_TRUE(fresh);
    EXPECT_EQ(fromAbove(*fresh, scene, 1), pictures.back()) << pictures.size();
    for (size_t i = 0; i + 1 < pictures.size() && pictures.size() < scenes.size(); ++i)
      EXPECT_NE(pictures[i], pictures.back()) << i;
  }
  EXPECT_EQ(pictures.front(), pictures.back());
  // Another scale is no other plan, and reads nothing again.
  Scene steeper = scenes[1];
  const auto gentle = fromAbove(*engine, steeper, 1);
  const auto uploaded = [&] { return engine->stats().streamer.pages_uploaded[static_cast<size_t>(kNormalPlane)]; };
  // A settled picture may leave pages on their way that it does not need.
  uint64_t made = uploaded();
  for (int quiet = 0; quiet < 20; ++quiet) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    (void)fromAbove(*engine, steeper, 1);
    if (uploaded() == made) continue;
    made = uploaded();
    quiet = 0;
  }
  steeper.shading.full_deg = 20;
  EXPECT_NE(fromAbove(*engine, steeper, 1), gentle);
  EXPECT_EQ(uploaded(), made);
}

Manifest manifestOf(Basis basis, int relief_depth = 2, bool mesh = false) {
  Manifest m;
  m.texture.basis = basis;
  m.domain.relief_depth = relief_depth;
  if (!mesh) return m;
  m.base = std::make_shared<const BaseMesh>(cubeSphere(1, 10));
  m.domain = PatchDomain::overMesh(static_cast<uint32_t>(m.base->patches.size()), m.domain);
  return m;
}

// Off, whatever its parameters are, it leaves no trace: no define, uniform, pass or plane.
TEST(ReliefShading, ThatIsOffLeavesNoTrace) {
  const Manifest m = manifestOf(Basis::kPtmRgb);
  const auto variant = [&](const Scene& scene) { return shadingSource(scene, m); };
  Scene off, on;
  off.shading = {.full_deg = 10, .radius_mm = 3, .low_mm = 1};
  on.shading = {.kind = Kind::kSlope};
  EXPECT_EQ(planEffects(off, m), planEffects({}, m));
  EXPECT_EQ(variant(off), variant({}));
  EXPECT_EQ(variant({}).find("u_shading"), std::string::npos);
  EXPECT_NE(variant(on).find("u_shading"), std::string::npos);
  // It takes the place of light, shadows and texture, and of a light that is fixed.
  Scene lit{.relight = false, .shadows = true};
  lit.lights = {{.near = true, .place = {0, 0, 9}}};
  lit.shading = on.shading;
  EXPECT_EQ(planEffects(lit, m), planEffects(on, m));
  EXPECT_EQ(planEffects(on, m).planesRead(), std::vector<std::string>{"relief"});
  EXPECT_EQ(planEffects(on, m).nameOf(kNormalPlane), "slope");
  EXPECT_EQ(planEffects({}, m).nameOf(kNormalPlane), "rgb-a1");
  const Manifest scan = manifestOf(Basis::kAlbedoNormal, 2, true);
  EXPECT_EQ(planEffects(on, scan).planesRead(), (std::vector<std::string>{"normal", "relief"}));
  on.shading.kind = Kind::kCurvature;
  EXPECT_EQ(planEffects(on, scan).planesRead(), (std::vector<std::string>{"normal", "relief"}));
  on.shading.kind = Kind::kDepth;
  EXPECT_EQ(planEffects(on, scan).planesRead(), std::vector<std::string>{"relief"});
  EXPECT_FALSE(planEffects(on, scan).readsTexture());
}

TEST(ReliefShading, ThatCannotBeShownIsNamed) {
  const auto problem = [](Kind kind, const Manifest& m) { return sceneProblem({.shading = {.kind = kind}}, m); };
  for (const Kind kind : {Kind::kSlope, Kind::kCurvature, Kind::kDepth}) {
    EXPECT_EQ(problem(kind, manifestOf(Basis::kColour)), "");
    EXPECT_NE(problem(kind, manifestOf(Basis::kPtmLrgb, -1)).find("the artwork has no relief"), std::string::npos);
  }
  EXPECT_EQ(problem(Kind::kSlope, manifestOf(Basis::kAlbedoNormal, 2, true)), "");
  for (const Kind kind : {Kind::kSlope, Kind::kCurvature})
    EXPECT_NE(problem(kind, manifestOf(Basis::kPtmLrgb, 2, true)).find("without normals"), std::string::npos);
  EXPECT_EQ(problem(Kind::kDepth, manifestOf(Basis::kPtmLrgb, 2, true)), "");
  EXPECT_EQ(problem(Kind::kCurvature, manifestOf(Basis::kAlbedoNormal, 2, true)), "");
}

// CIE 1976 lightness of a colour, 0..100.
double lightness(const glm::dvec3& c) {
  const double y = 0.2126 * linearFromSrgb(c.r) + 0.7152 * linearFromSrgb(c.g) + 0.0722 * linearFromSrgb(c.b);
  return y > 0.008856 ? 116 * std::cbrt(y) - 16 : 903.3 * y;
}
TEST(ReliefShading, HasEvenScales) {
  const Manifest m = manifestOf(Basis::kColour);
  const ShadingScale viridis = scaleOf({.kind = Kind::kSlope, .map = Map::kColour}, m),
                     warm = scaleOf({.kind = Kind::kCurvature, .map = Map::kColour}, m);
  const double step = (lightness(viridis.colours[8]) - lightness(viridis.colours[0])) / 8;
  EXPECT_GT(step, 8);
  for (size_t k = 0; k < 8; ++k)
    EXPECT_NEAR(lightness(viridis.colours[k + 1]) - lightness(viridis.colours[k]), step, 0.15 * step) << k;
  for (size_t k = 0; k < 4; ++k) {
    EXPECT_GT(lightness(warm.colours[k + 1]), lightness(warm.colours[k]) + 4);
    EXPECT_NEAR(lightness(warm.colours[8 - k]), lightness(warm.colours[k]), 4) << k;
  }
  // Values beyond the scale have the colours of its ends; between two of its colours it is linear.
  EXPECT_EQ(shadedColour(viridis, -5), viridis.colours[0]);
  EXPECT_EQ(shadedColour(viridis, 90), viridis.colours[8]);
  const glm::dvec3 between = shadedColour(viridis, 60 * 2.5 / 8),
                   mean = (viridis.colours[2] + viridis.colours[3]) / 2.0;
  EXPECT_LT(glm::length(between - mean), 1e-9);
  EXPECT_EQ(shadingText({.kind = Kind::kSlope}, m),
            "slope: 0 degrees is RGB 255 255 255, 30 degrees is RGB 128 128 128, 60 degrees is RGB 0 0 0");
}

}  // namespace relief_shading_gltest
}  // namespace relievo
