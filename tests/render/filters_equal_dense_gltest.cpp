// Virtual equals dense with every way of sampling: at all sizes from one texel to 2^24 a side, at page edges and
// corners, in extreme magnification and at grazing angles. The texture is rough: every texel differs from its
// neighbours by as much as the snapping of vertices allows. Negative controls: pages without borders, taps that do not
// look up their own node, and an oracle that is wrong by a little.
#include "src/engine/fault_injection.h"
#include "tests/render/dense_subjects.h"
#include "tests/view_share.h"

namespace relievo {
namespace filters_equal_dense_gltest {

using namespace test;

// White noise over a slow drift, so that what is a texel, a page or a level off shows.
class RoughTexture final : public TextureSource {
 public:
  RoughTexture(int64_t w, int64_t h, Basis basis) : w_(w), h_(h) {
    format_.basis = basis;
    if (basis != Basis::kColour) {
      format_.scale = {1.5, 1.5, 1.2, 1.3, 1.3, 1.1};
      format_.bias = {128, 128, 128, 128, 128, 20};
    }
  }
  int64_t width() const override { return w_; }
  int64_t height() const override { return h_; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return {"rough", "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t at = 0;
    for (int c = 0; c < format_.channels(); ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) {
          const auto xi = static_cast<uint32_t>(x), yi = static_cast<uint32_t>(y), ci = static_cast<uint32_t>(c);
          out[at++] = static_cast<uint8_t>(90 + mixBits(xi / 16, yi / 16, ci) % 80 + mixBits(xi, yi, ci + 50) % 48);
        }
    return {};
  }

 private:
  int64_t w_, h_;
  TextureFormat format_;
};

const std::pair<const char*, Sampling> kModes[] = {{"nearest", Sampling::kNearest},
                                                   {"bilinear", Sampling::kBilinear},
                                                   {"trilinear", Sampling::kTrilinear},
                                                   {"anisotropic", Sampling::kAnisotropic}};

void everyMode(const Subject& subject, const std::string& what, const Views& run) {
  for (const auto& [name, sampling] : kModes) {
    Scene scene;
    scene.sampling = sampling;
    expectEqual(compare(subject, scene, run), (what + ", " + name).c_str());
  }
}

double oneToOne(const FlatDomain& d, int height_px, double fov_deg) {
  return d.mm_per_px * height_px / (2 * std::tan(fov_deg * 3.14159265358979 / 360));
}

// The point of the artwork at a place in texels.
glm::dvec3 pointAt(const FlatDomain& d, double x, double y) {
  return {(x - 0.5 * static_cast<double>(d.width_px)) * d.mm_per_px,
          (0.5 * static_cast<double>(d.height_px) - y) * d.mm_per_px, 0};
}

// A corner of pages of some level, or one of the artwork's.
glm::dvec3 someCorner(std::mt19937& random, const FlatDomain& d, int turn) {
  if (turn % 3 == 0)
    return pointAt(d, random() % 2 ? static_cast<double>(d.width_px) : 0.0,
                   random() % 2 ? static_cast<double>(d.height_px) : 0.0);
  const double page = static_cast<double>(kPagePx << (random() % 2));
  auto place = [&](uint64_t extent) {
    return page * std::floor(uniform(random, 0, static_cast<double>(extent) / page + 1));
  };
  const double x = place(d.width_px), y = place(d.height_px);
  return pointAt(d, std::min(x, static_cast<double>(d.width_px)), std::min(y, static_cast<double>(d.height_px)));
}

TEST(FiltersEqualDense, SizesFromOneTexel) {
  for (auto [w, h] : {std::pair<int64_t, int64_t>{1, 1}, {1, 300}, {300, 1}, {127, 127}, {128, 128}, {129, 129}}) {
    const Subject subject = denseSubject(RoughTexture(w, h, Basis::kPtmLrgb), nullptr);
    Views run{.views = 4, .width = 160, .height = 90};
    run.camera = [&](std::mt19937& random) { return nearCamera(random, subject.texture->domain, 90, -5, 1); };
    everyMode(subject, std::to_string(w) + " x " + std::to_string(h), run);
  }
}

TEST(FiltersEqualDense, JustOverAPowerOfTwo) {
  for (auto [w, h] : {std::pair<int64_t, int64_t>{4097, 129}, {129, 4097}, {1100, 4097}}) {
    const Subject subject = denseSubject(RoughTexture(w, h, Basis::kColour), nullptr);
    Views run{.views = 6, .width = 240, .height = 135};
    run.camera = [&, n = 0](std::mt19937& random) mutable {
      const FlatDomain& d = subject.texture->domain;
      OrbitCamera c = nearCamera(random, d, 135, -2, 3);
      if (n++ % 2 == 0)
        c.target_mm = pointAt(d, static_cast<double>(d.width_px) - 1, static_cast<double>(d.height_px) - 1);
      return c;
    };
    everyMode(subject, std::to_string(w) + " x " + std::to_string(h), run);
  }
}

TEST(FiltersEqualDense, ToTwoToThe24Texels) {
  for (int64_t side : {int64_t{1} << 20, int64_t{1} << 24}) {
    const Subject subject = periodicSubject(side, side, Basis::kPtmLrgb);
    Views run{.views = 6};
    run.camera = [&, n = 0](std::mt19937& random) mutable {
      OrbitCamera c = nearCamera(random, subject.texture->domain, 180, -4, 6);
      if (n++ % 2 == 0) c.target_mm = {0.005 * double(side), -0.005 * double(side), 0};
      return c;
    };
    everyMode(subject, std::to_string(side) + " a side", run);
  }
}

TEST(FiltersEqualDense, PageEdgesAndCorners) {
  // Three patches in a row, the last one cut by the border: edges of pages, of patches and of the artwork.
  const Subject subject = denseSubject(RoughTexture(1301, 509, Basis::kPtmLrgb), nullptr);
  Views run{.views = 12, .width = 240, .height = 135};
  run.camera = [&, n = 0](std::mt19937& random) mutable {
    OrbitCamera c = nearCamera(random, subject.texture->domain, 135, -3, 1);
    c.target_mm = someCorner(random, subject.texture->domain, n++);
    return c;
  };
  everyMode(subject, "corners", run);
}

TEST(FiltersEqualDense, ExtremeMagnification) {
  const Subject subject = denseSubject(RoughTexture(600, 300, Basis::kPtmLrgb), nullptr);
  Views run{.views = 6, .width = 160, .height = 90};
  run.camera = [&, n = 0](std::mt19937& random) mutable {
    const FlatDomain& d = subject.texture->domain;
    OrbitCamera c = nearCamera(random, d, 90, -1, 0);
    c.distance_mm = oneToOne(d, 90, c.fov_deg) / uniform(random, 1000, 1500);  // px a texel
    c.azimuth_deg *= 0.5;
    c.elevation_deg *= 0.5;
    c.target_mm = someCorner(random, d, n++);
    return c;
  };
  everyMode(subject, "a texel over 1000 px", run);
}

OrbitCamera grazingCamera(std::mt19937& random, const FlatDomain& d, int height_px) {
  OrbitCamera c = nearCamera(random, d, height_px, 0, 2);
  c.azimuth_deg = uniform(random, 80, 89.5) * (random() % 2 ? 1 : -1);
  c.elevation_deg = uniform(random, -1, 1);
  if (random() % 2) std::swap(c.azimuth_deg, c.elevation_deg);
  c.elevation_deg = std::clamp(c.elevation_deg, -89.0, 89.0);
  return c;
}

TEST(FiltersEqualDense, GrazingViews) {
  for (auto [w, h] : {std::pair<int64_t, int64_t>{2048, 2048}, {3001, 700}, {500, 2100}}) {
    const Subject subject = denseSubject(RoughTexture(w, h, Basis::kPtmLrgb), nullptr);
    Views run{.views = 6, .width = 240, .height = 135};
    run.camera = [&](std::mt19937& random) { return grazingCamera(random, subject.texture->domain, 135); };
    everyMode(subject, "grazing, " + std::to_string(w) + " x " + std::to_string(h), run);
  }
}

TEST(FiltersEqualDense, EveryNumberOfTaps) {
  const Subject subject = denseSubject(RoughTexture(1301, 509, Basis::kPtmLrgb), nullptr);
  for (int n : {1, 2, 3, 4, 5, 6, 7, kUsualAnisotropy, 15, kMaxAnisotropy}) {
    Views run{.views = 4, .width = 240, .height = 135};
    run.camera = [&](std::mt19937& random) { return grazingCamera(random, subject.texture->domain, 135); };
    Scene scene;
    scene.sampling = Sampling::kAnisotropic;
    scene.anisotropy = n;
    expectEqual(compare(subject, scene, run), ("anisotropy " + std::to_string(n)).c_str());
  }
}

TEST(FiltersEqualDense, AnisotropicOverRelief) {
  const Subject subject = noiseSubject(1501, 1103, Basis::kPtmLrgb, 12, 7);
  Scene scene;
  scene.sampling = Sampling::kAnisotropic;
  expectEqual(compare(subject, scene, {.views = 8}), "anisotropic, relief");
  scene.relight = false;
  expectEqual(compare(subject, scene, {.views = 4}), "anisotropic, relief, resolved pages");
}

// --- negative controls

TEST(FiltersEqualDense, NegativeControls) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  const Subject subject = denseSubject(RoughTexture(1301, 509, Basis::kPtmLrgb), nullptr);
  auto off = [&](const std::string& what, Sampling sampling, const Views& base) {
    Views run = base;
    run.width = 240;
    run.height = 135;
    run.camera = [&](std::mt19937& random) { return grazingCamera(random, subject.texture->domain, 135); };
    Scene scene;
    scene.sampling = sampling;
    const Totals t = compare(subject, scene, run);
    t.print(what.c_str());
    EXPECT_GT(t.max_difference, 1) << what;
    EXPECT_GT(t.above_1, 100u) << what;
  };
  Views borders{.views = 6}, lookup{.views = 30};  // few pixels have taps that far from their page
  borders.faults.no_borders = true;
  lookup.faults.one_lookup = true;
  for (const auto& [name, sampling] : kModes) {
    Views level{.views = 6};
    level.wrong_oracle = [](DenseView& v) { v.lod_bias = 1; };
    off(std::string("a level off, ") + name, sampling, level);
    if (sampling != Sampling::kNearest) off(std::string("without borders, ") + name, sampling, borders);
  }
  off("taps clamped to the fragment's page", Sampling::kAnisotropic, lookup);
  Views seven{.views = 6}, none{.views = 6}, bilinear{.views = 6};
  seven.wrong_oracle = [](DenseView& v) { v.anisotropy = 7; };
  none.wrong_oracle = [](DenseView& v) { v.sampling = DenseSampling::kTrilinear; };
  bilinear.wrong_oracle = [](DenseView& v) { v.sampling = DenseSampling::kBilinear; };
  off("anisotropy 7 for 8", Sampling::kAnisotropic, seven);
  off("trilinear for anisotropic", Sampling::kAnisotropic, none);
  off("bilinear for nearest", Sampling::kNearest, bilinear);
}

}  // namespace filters_equal_dense_gltest
}  // namespace relievo
