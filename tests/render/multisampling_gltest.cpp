// Several samples a pixel: a settled picture is the average, in linear light, of the view through the standard sample
// locations, and alpha is the share of them that show the artwork. The truth is computed in double precision: the area
// of the artwork's outline in each pixel, and the dense oracle's pictures (dense_reference.h) through each location.
// Negative controls: one sample, samples at other places, an average of the bytes.
#include <glm/gtc/matrix_transform.hpp>

#include "src/base/srgb.h"
#include "src/engine/effects/effects.h"
#include "src/render/sample_stack.h"
#include "tests/render/dense_subjects.h"
#include "tests/render/made_engine.h"
#include "tests/view_share.h"

namespace relievo {
namespace multisampling_gltest {

using namespace test;

constexpr int kWidth = 200, kHeight = 120;

// Sixteenths of a pixel from its centre, x right, y down, as the specifications of Vulkan and Direct3D 11 have them.
std::vector<glm::dvec2> standardLocations(int samples) {
  std::vector<glm::dvec2> at;
  if (samples == 1) at = {{0, 0}};
  if (samples == 4) at = {{-2, -6}, {6, -2}, {-6, 2}, {2, 6}};
  if (samples == 8) at = {{1, -3}, {-1, 3}, {5, 1}, {-3, -5}, {-5, 5}, {-7, -1}, {3, 7}, {7, -7}};
  for (glm::dvec2& p : at) p /= 16.0;
  return at;
}

Scene sceneOf(int samples) {
  Scene scene;
  scene.light = {-0.4, 0.5, 1};
  scene.samples = samples;
  return scene;
}

// Frames until the picture is that of the engine's camera, which is a frame late at best.
void drawUntilSeen(Engine& engine, double now_s) {
  const ViewTransform wanted = viewTransform(
      engine.camera(), artworkExtent(engine.manifest(), engine.plan().relief ? engine.scene().exaggerate : 0),
      engine.width(), engine.height());
  for (int i = 0; i < 2000; ++i) {
    engine.frame(now_s);
    if (engine.view().clip_from_world == wanted.clip_from_world) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ADD_FAILURE() << "the camera's picture never came";
}

std::vector<uint8_t> settledPicture(Engine& engine, const OrbitCamera& camera) {
  engine.setCamera(camera);
  auto settled = engine.settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  return engine.readPixels();
}

// All of the artwork in view, at a slant.
OrbitCamera slantedCamera(const Artwork& artwork, double azimuth_deg, double elevation_deg, bool orthographic = false) {
  const Extent extent = artworkExtent(artwork.manifest);
  OrbitCamera camera = fitCamera(extent, kWidth, kHeight);
  camera.azimuth_deg = azimuth_deg;
  camera.elevation_deg = elevation_deg;
  camera.orthographic = orthographic;
  camera.distance_mm = fitDistance(camera, extent, kWidth, kHeight);
  return camera;
}

// --- the outline

using Polygon = std::vector<glm::dvec2>;

// The outline of a flat artwork without relief, px from the picture's upper left corner.
Polygon outlineOf(const Engine& engine) {
  const FlatDomain d = engine.manifest().domain.flat();
  const double w = 0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
               h = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px;
  Polygon outline;
  for (const glm::dvec2 corner : {glm::dvec2(-w, -h), glm::dvec2(w, -h), glm::dvec2(w, h), glm::dvec2(-w, h)}) {
    const glm::dvec4 clip = engine.view().clip_from_world * glm::dvec4(corner.x, corner.y, 0, 1);
    EXPECT_GT(clip.w, 0);
    outline.push_back({(clip.x / clip.w + 1) / 2 * kWidth, (1 - clip.y / clip.w) / 2 * kHeight});
  }
  return outline;
}

// What of the polygon has normal . p <= limit.
Polygon clipped(const Polygon& polygon, glm::dvec2 normal, double limit) {
  Polygon out;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const glm::dvec2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
    const double da = glm::dot(normal, a) - limit, db = glm::dot(normal, b) - limit;
    if (da <= 0) out.push_back(a);
    if ((da < 0 && db > 0) || (da > 0 && db < 0)) out.push_back(a + (b - a) * (da / (da - db)));
  }
  return out;
}

double areaOf(const Polygon& p) {
  double twice = 0;
  for (size_t i = 0; i < p.size(); ++i) {
    const glm::dvec2 a = p[i], b = p[(i + 1) % p.size()];
    twice += a.x * b.y - a.y * b.x;
  }
  return std::abs(twice) / 2;
}

Polygon inPixel(const Polygon& outline, int x, int y) {
  Polygon p = clipped(outline, {-1, 0}, -x);
  p = clipped(p, {1, 0}, x + 1);
  p = clipped(p, {0, -1}, -y);
  return clipped(p, {0, 1}, y + 1);
}

// The most by which the share of locations on one side of a straight line through a pixel differs from the area there:
// reached where the line passes a location, on either side of it. Lines of 1440 directions.
double worstOfLines(const std::vector<glm::dvec2>& locations) {
  const Polygon pixel{{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};
  double worst = 0;
  for (int k = 0; k < 1440; ++k) {
    const double angle = glm::radians(k / 4.0);
    const glm::dvec2 normal(std::cos(angle), std::sin(angle));
    for (const glm::dvec2& at : locations) {
      const double limit = glm::dot(normal, at), area = areaOf(clipped(pixel, normal, limit));
      double before = 0, with = 0;
      for (const glm::dvec2& other : locations) {
        before += glm::dot(normal, other) < limit - 1e-9;
        with += glm::dot(normal, other) < limit + 1e-9;
      }
      const auto all = static_cast<double>(locations.size());
      worst = std::max({worst, std::abs(before / all - area), std::abs(with / all - area)});
    }
  }
  return worst;
}

// How far within the convex outline a place lies, px; below 0: outside.
double depthWithin(const Polygon& outline, glm::dvec2 place) {
  double depth = 1e300, side = 0;
  for (size_t i = 0; i < outline.size(); ++i) {
    const glm::dvec2 a = outline[i], b = outline[(i + 1) % outline.size()], along = glm::normalize(b - a);
    const double distance = along.x * (place.y - a.y) - along.y * (place.x - a.x);
    if (side == 0) {
      const glm::dvec2 inside = (outline[0] + outline[1] + outline[2] + outline[3]) / 4.0;
      side = along.x * (inside.y - a.y) - along.y * (inside.x - a.x) > 0 ? 1 : -1;
    }
    depth = std::min(depth, side * distance);
  }
  return depth;
}

struct BorderErrors {
  size_t border = 0, wrong = 0, uncertain = 0;
  double max = 0, sum = 0;  // max: but for the outline's corners
  double mean() const { return sum / static_cast<double>(std::max<size_t>(border, 1)); }
};

// Alpha against the area of the outline in border pixels; and, everywhere, against the number of `locations` within the
// outline. GL snaps corners to 2^-8 px or less: a location so near to the outline may be either. Half of 255 is no
// byte: drivers round it either way.
void compareAlpha(const Engine& engine, std::span<const uint8_t> rgba, const std::vector<glm::dvec2>& locations,
                  BorderErrors& errors) {
  const Polygon outline = outlineOf(engine);
  GLint snap_bits = 4;
  glGetIntegerv(GL_SUBPIXEL_BITS, &snap_bits);
  const double snap_px = std::ldexp(1.0, -snap_bits);
  const bool software = snappedPx() == 0;  // asked once: OpenGL ES takes a millisecond to say
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const int alpha = rgba[4 * (static_cast<size_t>(y) * kWidth + static_cast<size_t>(x)) + 3];
      const double area = areaOf(inPixel(outline, x, y));
      if (area > 1e-9 && area < 1 - 1e-9) {
        const bool corner = std::any_of(outline.begin(), outline.end(), [&](const glm::dvec2& p) {
          return std::abs(p.x - x - 0.5) < 1 && std::abs(p.y - y - 0.5) < 1;
        });
        ++errors.border;
        if (!corner) errors.max = std::max(errors.max, std::abs(alpha / 255.0 - area));
        errors.sum += std::abs(alpha / 255.0 - area);
      }
      int surely = 0, perhaps = 0;
      for (const glm::dvec2& at : locations) {
        const double depth = depthWithin(outline, glm::dvec2(x + 0.5, y + 0.5) + at);
        surely += depth > snap_px;
        perhaps += depth > -snap_px;
      }
      const double each = 255.0 / static_cast<double>(locations.size());
      errors.uncertain += surely != perhaps;
      errors.wrong += !software ? alpha < surely * each - 0.5 || alpha > perhaps * each + 0.5
                                : alpha < std::lround(surely * each) || alpha > std::lround(perhaps * each);
    }
}

TEST(Multisampling, AlphaIsTheCoverageOfBorders) {
  const Subject subject = noiseSubject(300, 200, Basis::kColour, 0, 31);
  std::map<int, BorderErrors> errors;
  BorderErrors elsewhere;
  for (int samples : {1, 4, 8}) {
    auto engine = makeEngine(subject.artwork, sceneOf(samples), {}, kWidth, kHeight);
    ASSERT_NE(engine, nullptr);
    for (double azimuth : {-50.0, 8.0, 33.0, 61.0})
      for (bool orthographic : {false, true}) {
        const auto picture =
            settledPicture(*engine, slantedCamera(subject.artwork, azimuth, 0.4 * azimuth + 9, orthographic));
        EXPECT_EQ(engine->stats().samples, samples);
        compareAlpha(*engine, picture, standardLocations(samples), errors[samples]);
        if (samples == 8) {
          std::vector<glm::dvec2> mirrored = standardLocations(8);
          for (glm::dvec2& at : mirrored) at.y = -at.y;
          compareAlpha(*engine, picture, mirrored, elsewhere);
        }
      }
    const BorderErrors& e = errors[samples];
    const double bound = worstOfLines(standardLocations(samples));
    std::printf(
        "[ samples ] %d: %zu border pixels, error of alpha at most %.3f (of any line %.3f), %.4f on average; %zu "
        "uncertain\n",
        samples, e.border, e.max, bound, e.mean(), e.uncertain);
    EXPECT_EQ(e.wrong, 0u) << samples << " samples";
    EXPECT_LE(e.max, bound + 1 / 510.0 + 0.01) << "rounding of alpha; corners snapped, directions in between";
    EXPECT_GT(e.border, 1500u);
    EXPECT_LT(e.uncertain, e.border / 8);
  }
  EXPECT_LE(worstOfLines(standardLocations(8)), 0.23);
  EXPECT_LE(errors[8].mean(), 0.05);
  EXPECT_LE(errors[4].mean(), 0.09);
  EXPECT_GT(errors[1].max, 0.45) << "control";
  EXPECT_GT(errors[1].mean(), 5 * errors[8].mean()) << "control";
  EXPECT_GT(elsewhere.wrong, 100u) << "control: the locations mirrored";
}

// --- colours

// What a sample's byte may be off by on a GPU, beside the half of rounding: its conversion (the Direct3D 11.3
// functional specification allows 0.6 in all, section 3.2.3.6; OpenGL states nothing), and where vertices are snapped
// the oracle's colour.
constexpr double kConversion = 0.11, kSnapped = 0.5;

// The oracle's pictures through the locations, and what the engine's is against their average.
class Averages {
 public:
  Averages(const Subject& subject, const Engine& engine, const std::vector<glm::dvec2>& locations) {
    const Scene& scene = engine.scene();
    DenseView v;
    v.width_px = kWidth;
    v.height_px = kHeight;
    v.exaggerate = scene.exaggerate;
    v.light = normalizedLight(scene.light);
    v.sampling = static_cast<DenseSampling>(scene.sampling);
    v.anisotropy = engine.plan().anisotropy;
    v.snapped_px = snappedPx();
    for (const glm::dvec2& at : locations) {
      const glm::dvec3 moved(-2 * at.x / kWidth, 2 * at.y / kHeight, 0);
      v.clip_from_world = glm::translate(glm::dmat4(1), moved) * engine.view().clip_from_world;
      images_.push_back(
          renderDense(*subject.texture, engine.plan().relief ? subject.relief.get() : nullptr, engine.instances(), v));
    }
  }
  struct Difference {
    size_t compared = 0, wrong = 0;
    double max = 0, sum = 0;
    void add(const Difference& d) {
      compared += d.compared;
      wrong += d.wrong;
      max = std::max(max, d.max);
      sum += d.sum;
    }
    double mean() const { return sum / static_cast<double>(std::max<size_t>(compared, 1)); }
  };
  // Of channels of the pixels in which every sample shows the artwork, no edge near it, how far they are from what the
  // samples' bytes may average to. bytes: the average is that of the display's numbers.
  Difference difference(std::span<const uint8_t> rgba, bool bytes = false) const {
    Difference d;
    // In software half for rounding, and half for samples whose bytes are off by one.
    const bool gpu = snappedPx() > 0;
    const double either_way = gpu ? kConversion + kSnapped : 0, bound = gpu ? 0.5 + kConversion : 1.01;
    for (size_t i = 0; i < images_[0].pixels.size(); ++i) {
      bool inside = true;
      for (const DenseImage& image : images_) inside &= image.pixels[i].covered() && image.pixels[i].edge == 0;
      if (!inside) continue;
      for (int c = 0; c < 3; ++c) {
        const auto average = [&](double off) {
          double sum = 0;
          for (const DenseImage& image : images_) {
            const double shown = std::clamp(std::floor(image.pixels[i].rgb[c] + off + 0.5), 0.0, 255.0);
            sum += bytes ? shown : linearFromSrgb(shown / 255);
          }
          const double mean = sum / static_cast<double>(images_.size());
          return bytes ? mean : 255 * srgbFromLinear(mean);
        };
        const double shown = rgba[4 * i + static_cast<size_t>(c)];
        const double error = std::max({average(-either_way) - shown, shown - average(either_way), 0.0});
        ++d.compared;
        d.wrong += error > bound;
        d.max = std::max(d.max, error);
        d.sum += error;
      }
    }
    return d;
  }

 private:
  std::vector<DenseImage> images_;
};

// Texels of black and white, of which no pattern repeats soon: bytes and light have different averages.
class BlackAndWhite final : public TextureSource {
 public:
  int64_t width() const override { return 700; }
  int64_t height() const override { return 500; }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t i = 0;
    for (int c = 0; c < 3; ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) out[i++] = (x * x + 3 * y * y + x * y + c) % 7 < 3 ? 255 : 0;
    return {};
  }
};

TEST(Multisampling, ColoursAreTheAverageInLinearLight) {
  const Subject flat = denseSubject(BlackAndWhite(), nullptr), relief = noiseSubject(900, 700, Basis::kPtmLrgb, 8, 33);
  Averages::Difference one, of_bytes, mirrored;
  for (const Subject* subject : {&flat, &relief}) {
    for (int samples : {4, 8}) {
      Averages::Difference d;
      auto engine = makeEngine(subject->artwork, sceneOf(samples), {}, kWidth, kHeight);
      auto single = makeEngine(subject->artwork, sceneOf(1), {}, kWidth, kHeight);
      ASSERT_TRUE(engine && single);
      std::vector<double> distances{0.4, 0.1, 1.0};
      distances.resize(esShare(distances.size()));
      for (double distance : distances) {
        OrbitCamera camera = slantedCamera(subject->artwork, 35, 20);
        camera.distance_mm *= distance;
        const auto picture = settledPicture(*engine, camera);
        const Averages expected(*subject, *engine, standardLocations(samples));
        d.add(expected.difference(picture));
        if (samples != 8 || controlledWithOpenGl()) continue;
        one.add(expected.difference(settledPicture(*single, camera)));
        of_bytes.add(expected.difference(picture, true));
        std::vector<glm::dvec2> others = standardLocations(samples);
        for (glm::dvec2& at : others) at.y = -at.y;
        mirrored.add(Averages(*subject, *engine, others).difference(picture));
      }
      std::printf("[ samples ] %s, %d: %zu channels, at most %.2f/255, %.3f on average, %zu wrong\n",
                  subject == &flat ? "flat" : "relief", samples, d.compared, d.max, d.mean(), d.wrong);
      EXPECT_GT(d.compared, snappedPx() > 0 ? 15000u : 20000u);  // more lies at an edge where vertices are snapped
      // Few samples look at a page that no pixel's centre asked for, in the picture's outermost pixels: its ancestor
      // shows.
      EXPECT_LE(d.wrong, d.compared / 20000);
      EXPECT_LE(d.mean(), 0.3) << "a quarter for rounding";
    }
  }
  if (controlledWithOpenGl()) return;
  std::printf("[ samples ] controls: one sample %zu wrong, of bytes %zu, mirrored %zu\n", one.wrong, of_bytes.wrong,
              mirrored.wrong);
  EXPECT_GT(one.wrong, 5000u) << "control";
  EXPECT_GT(of_bytes.wrong, snappedPx() > 0 ? 1000u : 5000u) << "control";
  EXPECT_GT(mirrored.wrong, 500u) << "control";
}

// --- the engine

// In the first view some samples want a page that no pixel's centre does. A slightly farther view makes that page
// resident: it must not show (three bytes would change).
TEST(Multisampling, DependsOnNeitherWorkersNorHistory) {
  const Subject subject = noiseSubject(900, 700, Basis::kPtmLrgb, 8, 33);
  for (double distance : {0.302739, 0.7}) {
    OrbitCamera camera = slantedCamera(subject.artwork, 35, 20);
    camera.distance_mm *= distance;
    std::vector<uint8_t> first;
    for (int workers : {1, 3}) {
      EngineOptions options;
      options.workers = workers;
      auto engine = makeEngine(subject.artwork, sceneOf(8), options, kWidth, kHeight);
      ASSERT_NE(engine, nullptr);
      const auto picture = settledPicture(*engine, camera);
      if (first.empty()) first = picture;
      EXPECT_TRUE(picture == first) << workers << " workers";
      OrbitCamera farther = camera;
      farther.distance_mm *= 1.02;
      EXPECT_TRUE(settledPicture(*engine, farther) != first) << "control";
      EXPECT_TRUE(settledPicture(*engine, camera) == first) << "more pages are resident by now";
    }
  }
}

TEST(Multisampling, OneSampleIsAsEver) {
  const Subject subject = noiseSubject(700, 500, Basis::kPtmLrgb, 5, 35);
  const OrbitCamera camera = slantedCamera(subject.artwork, 40, 25);
  auto plain = makeEngine(subject.artwork, sceneOf(1), {}, kWidth, kHeight),
       many = makeEngine(subject.artwork, sceneOf(8), {}, kWidth, kHeight);
  ASSERT_TRUE(plain && many);
  EXPECT_EQ(planEffects(sceneOf(1), plain->manifest()).passes(),
            (std::vector<std::string>{"surface", "shade", "feedback"}));
  EXPECT_EQ(planEffects(sceneOf(8), plain->manifest()).passes(),
            (std::vector<std::string>{"surface", "shade", "average", "feedback"}));
  EXPECT_EQ(many->plan().defines(), plain->plan().defines()) << "the shading's variant is the same";
  const auto as_ever = settledPicture(*plain, camera), averaged = settledPicture(*many, camera);
  const uint32_t calls = plain->stats().draw_calls;
  EXPECT_TRUE(averaged != as_ever) << "control";
  // A frame of a moving camera is one sample through the centres, for the cost of one.
  OrbitCamera elsewhere = camera;
  elsewhere.azimuth_deg -= 3;
  settledPicture(*many, elsewhere);
  many->setCamera(camera);
  drawUntilSeen(*many, 0);
  EXPECT_EQ(many->stats().samples, 1);
  EXPECT_TRUE(many->readPixels() == as_ever);
  // Off again.
  EXPECT_TRUE(many->setScene(sceneOf(1)).ok());
  EXPECT_TRUE(settledPicture(*many, camera) == as_ever);
  EXPECT_EQ(many->stats().draw_calls, calls);
  EXPECT_FALSE(many->refine(0));
  EXPECT_EQ(many->stats().streamer.pages_uploaded, plain->stats().streamer.pages_uploaded);
}

TEST(Multisampling, AStillPictureIsRefinedAndStaysUntilSomethingChanges) {
  const Subject subject = noiseSubject(700, 500, Basis::kPtmLrgb, 5, 36);
  const OrbitCamera camera = slantedCamera(subject.artwork, 40, 25);
  Scene lit = sceneOf(8);
  lit.light = {0.8, 0.1, 0.5};
  auto truth = makeEngine(subject.artwork, lit, {}, kWidth, kHeight),
       engine = makeEngine(subject.artwork, sceneOf(8), {}, kWidth, kHeight);
  ASSERT_TRUE(truth && engine);
  const auto expected = settledPicture(*truth, camera), before = settledPicture(*engine, camera);
  EXPECT_TRUE(expected != before);
  EXPECT_FALSE(engine->refine(0)) << "all samples are in";
  engine->frame(0);
  EXPECT_TRUE(engine->readPixels() == before) << "a frame that shows the same keeps them";
  // Another light: one sample, then one more at a time.
  EXPECT_TRUE(engine->setScene(lit).ok());
  engine->frame(1);
  EXPECT_EQ(engine->stats().samples, 1);
  for (int i = 1; i <= 8; ++i) {
    EXPECT_TRUE(engine->refine(1));
    EXPECT_EQ(engine->stats().samples, i);
    EXPECT_EQ(engine->readPixels() == expected, i == 8) << i;
  }
  EXPECT_FALSE(engine->refine(1));
  for (int i = 0; i < 5; ++i) engine->frame(2 + i);
  EXPECT_EQ(engine->stats().samples, 8);
  EXPECT_TRUE(engine->readPixels() == expected);
  // What changes the picture starts over: the camera, the size.
  OrbitCamera moved = camera;
  moved.azimuth_deg += 0.01;
  engine->setCamera(moved);
  drawUntilSeen(*engine, 8);
  EXPECT_EQ(engine->stats().samples, 1);
  EXPECT_TRUE(engine->refine(11));
  EXPECT_TRUE(engine->refine(11));
  EXPECT_EQ(engine->stats().samples, 2);
  engine->resize(kWidth / 2, kHeight / 2);
  drawUntilSeen(*engine, 12);
  EXPECT_EQ(engine->stats().samples, 1);
  while (engine->refine(15)) continue;
  EXPECT_EQ(engine->readPixels().size(), static_cast<size_t>(kWidth * kHeight));
}

// The place that a pixel shows is seen in that pixel, whichever sample was drawn last; overlays and lines are averaged
// as the rest is.
TEST(Multisampling, PlacesAndOverlays) {
  const Subject subject = noiseSubject(700, 500, Basis::kPtmLrgb, 5, 37);
  const OrbitCamera camera = slantedCamera(subject.artwork, 40, 25);
  auto engine = makeEngine(subject.artwork, sceneOf(8), {}, kWidth, kHeight);
  ASSERT_NE(engine, nullptr);
  const auto plain = settledPicture(*engine, camera);
  double furthest_px = 0;
  for (int x = 70; x < 130; x += 20) {
    const auto place = engine->surfacePoint(x + 0.5, kHeight / 2.0 + 0.5);
    ASSERT_TRUE(place.has_value());
    const glm::dvec4 clip = engine->view().clip_from_world * glm::dvec4(*place, 1);
    const glm::dvec2 px((clip.x / clip.w + 1) / 2 * kWidth, (1 - clip.y / clip.w) / 2 * kHeight);
    furthest_px = std::max(furthest_px, glm::length(px - glm::dvec2(x + 0.5, kHeight / 2.0 + 0.5)));
  }
  EXPECT_LE(furthest_px, 0.7 + 1e-3) << "the half diagonal of a pixel";
  EXPECT_FALSE(engine->surfacePoint(0, 0).has_value());
  Scene lines = sceneOf(8), pages = sceneOf(8);
  lines.wireframe = true;
  pages.overlay = &kPagesEffect;
  for (const Scene& scene : {lines, pages}) {
    EXPECT_TRUE(engine->setScene(scene).ok());
    const auto shown = settledPicture(*engine, camera);
    EXPECT_TRUE(shown != plain);
    Scene one = scene;
    one.samples = 1;
    EXPECT_TRUE(engine->setScene(one).ok());
    EXPECT_TRUE(settledPicture(*engine, camera) != shown);
  }
}

}  // namespace multisampling_gltest
}  // namespace relievo
