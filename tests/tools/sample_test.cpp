// Sample artworks: seamless whatever rectangle is asked for, bounded, true to their normals and to their shading.
#include "tools/sample/sample_artwork.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "src/artwork/bases/ptm.h"
#include "src/base/file.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "tools/sample/sample_shading.h"
#include "tools/sample/sample_writer.h"

namespace relievo {
namespace sample_test {

constexpr SampleKind kKinds[] = {SampleKind::kInscription, SampleKind::kCoin, SampleKind::kPainting};

struct Layers {
  std::vector<float> heights;
  std::vector<uint8_t> albedo, lrgb, rgb;
  friend bool operator==(const Layers&, const Layers&) = default;
};

Layers readLayers(const SampleArtwork& a, const Rect& r) {
  const auto n = static_cast<size_t>(r.width * r.height);
  Layers l{std::vector<float>(n), std::vector<uint8_t>(3 * n), std::vector<uint8_t>(9 * n),
           std::vector<uint8_t>(18 * n)};
  a.heights(r, l.heights);
  a.albedo(r, l.albedo);
  EXPECT_TRUE(a.ptmSource(Basis::kPtmLrgb)->read(r, l.lrgb));
  EXPECT_TRUE(a.ptmSource(Basis::kPtmRgb)->read(r, l.rgb));
  return l;
}

// A part of `whole`, cut out of its arrays.
Layers cut(const Layers& whole, const Rect& of, const Rect& r) {
  Layers l;
  const auto area = static_cast<size_t>(of.width * of.height);
  auto plane = [&](auto& from, auto& to, size_t channels, size_t stride_channels, size_t planes) {
    for (size_t p = 0; p < planes; ++p)
      for (int64_t y = 0; y < r.height; ++y) {
        auto begin = from.begin() +
                     static_cast<std::ptrdiff_t>(
                         p * area + stride_channels * static_cast<size_t>((r.y - of.y + y) * of.width + r.x - of.x));
        to.insert(to.end(), begin, begin + static_cast<std::ptrdiff_t>(channels * static_cast<size_t>(r.width)));
      }
  };
  plane(whole.heights, l.heights, 1, 1, 1);
  plane(whole.albedo, l.albedo, 3, 3, 1);
  plane(whole.lrgb, l.lrgb, 1, 1, 9);
  plane(whole.rgb, l.rgb, 1, 1, 18);
  return l;
}

// Bytes, so that a NaN or a sign of zero would show.
bool sameBits(const Layers& a, const Layers& b) {
  return a.heights.size() == b.heights.size() &&
         std::memcmp(a.heights.data(), b.heights.data(), a.heights.size() * 4) == 0 && a.albedo == b.albedo &&
         a.lrgb == b.lrgb && a.rgb == b.rgb;
}

TEST(Sample, SamePixelSameBitsWhateverTheRectangle) {
  for (SampleKind kind : kKinds) {
    for (int64_t side : {int64_t{700}, int64_t{65536}}) {
      SampleArtwork a({.kind = kind, .width = side, .height = side + 31, .seed = 5});
      std::mt19937 random(17);
      // Around the middle, where there is most to see, and not on a block's border.
      const Rect whole{side / 2 - 181, side / 2 - 77, 333, 270};
      const Layers all = readLayers(a, whole);
      for (int i = 0; i < 16; ++i) {
        Rect r;
        r.width = 1 + static_cast<int64_t>(random() % 150), r.height = 1 + static_cast<int64_t>(random() % 120);
        if (i % 5 == 0) r.width = 1;
        if (i % 7 == 0) r.height = 1;
        r.x = whole.x + static_cast<int64_t>(random()) % (whole.width - r.width + 1);
        r.y = whole.y + static_cast<int64_t>(random()) % (whole.height - r.height + 1);
        const Layers part = readLayers(a, r);
        ASSERT_TRUE(sameBits(part, cut(all, whole, r)))
            << sampleKindName(kind) << " " << side << ": " << r.x << "," << r.y << " " << r.width << "x" << r.height;
        // Control: the same comparison must see a rectangle that is one pixel off.
        if (r.width * r.height >= 64 && r.x + r.width < whole.x + whole.width) {
          Rect off = r;
          ++off.x;
          EXPECT_FALSE(sameBits(part, cut(all, whole, off))) << sampleKindName(kind);
        }
      }
    }
  }
}

TEST(Sample, SameBitsFromManyThreads) {
  for (SampleKind kind : kKinds) {
    SampleArtwork a({.kind = kind, .width = 900, .height = 700, .seed = 2});
    const Rect whole{100, 90, 520, 400};
    const Layers alone = readLayers(a, whole);
    std::vector<Layers> parts(16);
    auto rectOf = [&](int i) { return Rect{whole.x + (i % 4) * 130, whole.y + (i / 4) * 100, 130, 100}; };
    {
      std::vector<std::jthread> threads;
      for (int t = 0; t < 4; ++t)
        threads.emplace_back([&, t] {
          for (int i = t; i < 16; i += 4) parts[static_cast<size_t>(i)] = readLayers(a, rectOf(i));
        });
    }
    for (int i = 0; i < 16; ++i)
      EXPECT_TRUE(sameBits(parts[static_cast<size_t>(i)], cut(alone, whole, rectOf(i))))
          << sampleKindName(kind) << " part " << i;
  }
}

TEST(Sample, HeightsStayWithinTheirBounds) {
  for (SampleKind kind : kKinds)
    for (uint64_t seed : {1u, 2u, 77u, 4096u}) {
      SampleArtwork a({.kind = kind, .width = 640, .height = 640, .seed = seed});
      std::vector<float> mm(640 * 640);
      a.heights({0, 0, 640, 640}, mm);
      auto [lo, hi] = std::minmax_element(mm.begin(), mm.end());
      EXPECT_GE(*lo, a.minMm()) << sampleKindName(kind) << " seed " << seed;
      EXPECT_LE(*hi, a.maxMm()) << sampleKindName(kind) << " seed " << seed;
      EXPECT_GT(*hi - *lo, 0.08 * (a.maxMm() - a.minMm())) << "the bounds say nothing";
      for (float v : mm) ASSERT_TRUE(std::isfinite(v));
    }
}

TEST(Sample, CutsAreFourToSixMillimetresDeep) {
  SampleArtwork a({.kind = SampleKind::kInscription, .width = 1500, .height = 1500, .seed = 1});
  std::vector<float> mm(1500 * 1500);
  a.heights({0, 0, 1500, 1500}, mm);
  std::vector<float> sorted = mm;
  std::sort(sorted.begin(), sorted.end());
  float face = sorted[sorted.size() / 2], deep = sorted[sorted.size() / 500];
  EXPECT_GT(face - deep, 4.0);
  EXPECT_LT(face - deep, 6.5);
}

TEST(Sample, NormalsAreCentralDifferences) {
  for (SampleKind kind : kKinds) {
    const int64_t w = 173, h = 140;
    SampleArtwork a({.kind = kind, .width = w, .height = h, .seed = 3});
    std::vector<float> mm(static_cast<size_t>(w * h)), normals(static_cast<size_t>(3 * w * h));
    a.heights({0, 0, w, h}, mm);
    a.normals({0, 0, w, h}, normals);
    double worst = 0, flipped = 0;
    for (int64_t y = 0; y < h; ++y)
      for (int64_t x = 0; x < w; ++x) {
        int64_t x0 = std::max<int64_t>(x - 1, 0), x1 = std::min(x + 1, w - 1), y0 = std::max<int64_t>(y - 1, 0),
                y1 = std::min(y + 1, h - 1);
        double sx = (double{mm[static_cast<size_t>(y * w + x1)]} - mm[static_cast<size_t>(y * w + x0)]) /
                    (static_cast<double>(x1 - x0) * a.mmPerPx());
        double sy = (double{mm[static_cast<size_t>(y1 * w + x)]} - mm[static_cast<size_t>(y0 * w + x)]) /
                    (static_cast<double>(y1 - y0) * a.mmPerPx());
        double len = std::sqrt(1 + sx * sx + sy * sy);
        const double request[3] = {-sx / len, sy / len, 1 / len};
        for (int c = 0; c < 3; ++c)
          worst = std::max(worst, std::abs(request[c] - normals[static_cast<size_t>(3 * (y * w + x) + c)]));
        flipped = std::max(flipped, std::abs(-request[1] - normals[static_cast<size_t>(3 * (y * w + x) + 1)]));
      }
    EXPECT_LT(worst, 1e-5) << sampleKindName(kind);
    EXPECT_GT(flipped, 0.01) << "the check would not see y pointing down";
  }
}

TEST(Sample, OtherSeedsAreOtherArtworks) {
  for (SampleKind kind : kKinds) {
    const Rect r{0, 0, 300, 300};
    auto of = [&](uint64_t seed) {
      return readLayers(SampleArtwork({.kind = kind, .width = 300, .height = 300, .seed = seed}), r);
    };
    Layers one = of(1);
    EXPECT_TRUE(sameBits(one, of(1)));
    for (uint64_t seed : {uint64_t{2}, uint64_t{3}, uint64_t{1} << 40}) {
      Layers other = of(seed);
      EXPECT_NE(one.heights, other.heights) << sampleKindName(kind) << " seed " << seed;
      EXPECT_NE(one.albedo, other.albedo) << sampleKindName(kind) << " seed " << seed;
    }
  }
}

TEST(Sample, SmallAndLongArtworks) {
  for (SampleKind kind : kKinds)
    for (auto [w, h] : {std::pair<int64_t, int64_t>{1, 1}, {1, 7}, {7, 1}, {127, 129}, {1 << 20, 2}, {3, 1 << 20}}) {
      SampleArtwork a({.kind = kind, .width = w, .height = h, .seed = 1});
      Rect r{std::max<int64_t>(0, w - 130), std::max<int64_t>(0, h - 130), std::min<int64_t>(w, 130),
             std::min<int64_t>(h, 130)};
      Layers l = readLayers(a, r);
      for (float v : l.heights) {
        ASSERT_GE(v, a.minMm()) << sampleKindName(kind) << " " << w << "x" << h;
        ASSERT_LE(v, a.maxMm()) << sampleKindName(kind) << " " << w << "x" << h;
      }
    }
}

TEST(Sample, TheLargestSizesKeepTheirDetail) {
  // At 2^20 px a side neighbouring pixels still differ, and by little: places are not rounded away.
  for (SampleKind kind : kKinds) {
    const int64_t side = 1 << 20;
    SampleArtwork a({.kind = kind, .width = side, .height = side, .seed = 1});
    std::vector<float> mm(100 * 100);
    a.heights({side - 200, side - 200, 100, 100}, mm);
    int equal = 0;
    double largest = 0;
    for (size_t i = 1; i < mm.size(); ++i)
      if (i % 100) equal += mm[i] == mm[i - 1], largest = std::max(largest, std::abs(double{mm[i]} - mm[i - 1]));
    EXPECT_LT(equal, 3000) << sampleKindName(kind);
    EXPECT_LT(largest, 0.02) << sampleKindName(kind);
  }
}

// How a pixel answers, straight from the definition in sample_shading.h, in 0..255 for one channel.
double shade(const sample::Vec3& n, const sample::Vec3& l, double albedo, double cavity, double sg, bool white_gloss) {
  double gloss_colour = white_gloss ? 0.9 * 255 : albedo;
  return cavity * ((1 - sg) * albedo * sample::diffuseTerm(n, l) + sg * gloss_colour * sample::glossTerm(n, l));
}

struct PtmCheck {
  double psnr_fit = 0;      // against the least-squares fit itself: table and quantisation
  double psnr_shading = 0;  // against the shading: what a PTM can't say comes on top
  int at_curve = 0;
};

PtmCheck checkPtm(SampleKind kind, Basis basis) {
  const int64_t side = 512;
  SampleArtwork a({.kind = kind, .width = side, .height = side, .seed = 1});
  const Rect r{140, 150, 200, 180};
  const auto n = static_cast<size_t>(r.width * r.height);
  auto source = a.ptmSource(basis);
  const TextureFormat f = source->format();
  const auto channels = static_cast<size_t>(f.channels());
  std::vector<uint8_t> raw(n * channels), albedo(3 * n);
  EXPECT_TRUE(source->read(r, raw));
  std::vector<float> normals(3 * n), cavity(n), gloss(n);
  a.normals(r, normals);
  a.albedo(r, albedo);
  a.material(r, cavity, gloss);
  const auto lights = sample::domeLights(sample::kFitLights);
  PtmCheck check;
  double squares_fit = 0, squares_shading = 0, count = 0;
  for (size_t i = 0; i < n; i += 7) {
    std::array<double, 18> pixel{};
    for (size_t c = 0; c < channels; ++c) {
      pixel[c] = raw[c * n + i];
      const bool coefficient = basis == Basis::kPtmRgb || c < 6;
      const size_t k = basis == Basis::kPtmRgb ? c / 3 : c;
      // What was asked of the byte must lie within it; 0 and 255 are reached without clipping only by the extremes.
      if (coefficient && ((raw[c * n + i] == 0 && f.bias[k] != 0) || raw[c * n + i] == 255)) ++check.at_curve;
    }
    sample::Vec3 normal{normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]};
    const double sg = a.glossStrength() * gloss[i];
    const bool white = basis == Basis::kPtmRgb && kind != SampleKind::kCoin;
    for (int c = 0; c < 3; ++c) {
      std::vector<double> truth;
      for (const auto& l : lights)
        truth.push_back(shade(normal, l, albedo[3 * i + static_cast<size_t>(c)], cavity[i], sg, white));
      const auto fit = sample::fitPtm(lights, truth);
      for (size_t k = 0; k < lights.size(); ++k) {
        auto basis_values = ptmBasis(lights[k][0], lights[k][1]);
        double fitted = 0;
        for (size_t j = 0; j < 6; ++j) fitted += fit[j] * basis_values[j];
        double got = evaluatePixel(f, pixel.data(), lights[k][0], lights[k][1])[static_cast<size_t>(c)];
        squares_fit += std::pow(got - std::clamp(fitted, 0.0, 255.0), 2);
        squares_shading += std::pow(got - std::clamp(truth[k], 0.0, 255.0), 2);
        ++count;
      }
    }
  }
  auto psnr = [&](double squares) { return 10 * std::log10(255.0 * 255.0 / (squares / count)); };
  check.psnr_fit = psnr(squares_fit), check.psnr_shading = psnr(squares_shading);
  return check;
}

TEST(Sample, PtmIsTheFitOfTheShadingAndNeverClips) {
  for (SampleKind kind : kKinds)
    for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
      PtmCheck c = checkPtm(kind, basis);
      std::printf("  %s %s: %.1f dB to the fit, %.1f dB to the shading\n", sampleKindName(kind), basisName(basis),
                  c.psnr_fit, c.psnr_shading);
      EXPECT_EQ(c.at_curve, 0) << sampleKindName(kind) << " " << basisName(basis);
      EXPECT_GT(c.psnr_fit, 40.0) << sampleKindName(kind) << " " << basisName(basis);
      EXPECT_GT(c.psnr_shading, 27.0) << sampleKindName(kind) << " " << basisName(basis);
    }
}

TEST(Sample, CoefficientRangeHoldsEveryNormal) {
  // Every normal, the extreme cavities and glosses, dark and bright: what the format can't hold would clip.
  SampleArtwork a({.kind = SampleKind::kCoin, .width = 64, .height = 64, .seed = 1});
  const auto lights = sample::domeLights(sample::kFitLights);
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    const TextureFormat f = a.ptmSource(basis)->format();
    auto clips = [&](const TextureFormat& format) {
      int count = 0;
      for (double tilt = 0; tilt < 89; tilt += 4)
        for (double turn = 0; turn < 360; turn += 15)
          for (double cavity : {0.35, 1.0})
            for (double sg : {0.0, 1.0}) {
              double t = tilt * M_PI / 180, u = turn * M_PI / 180;
              sample::Vec3 n{std::sin(t) * std::cos(u), std::sin(t) * std::sin(u), std::cos(t)};
              std::vector<double> values;
              for (const auto& l : lights) values.push_back(shade(n, l, 255, cavity, sg, false));
              auto fit = sample::fitPtm(lights, values);
              for (size_t k = 0; k < 6; ++k) {
                double raw = fit[k] / format.scale[k] + format.bias[k];
                count += raw < -0.5 || raw > 255.5;
              }
            }
      return count;
    };
    EXPECT_EQ(clips(f), 0) << basisName(basis);
    TextureFormat narrow = f;
    for (double& s : narrow.scale) s *= 0.6;
    EXPECT_GT(clips(narrow), 0) << "control: a range too narrow must show";
  }
}

TEST(Sample, FrontalLightShowsTheAlbedo) {
  // A level place of albedo 200 under head-on light is about 200: what a least-squares PTM makes of it.
  const auto lights = sample::domeLights(sample::kFitLights);
  std::vector<double> values;
  for (const auto& l : lights) values.push_back(shade({0, 0, 1}, l, 200, 1, 0, false));
  auto fit = sample::fitPtm(lights, values);
  EXPECT_NEAR(fit[5], 200, 16);  // a parabola over a hemisphere's cosine overshoots at its top by 7.5 %
}

TEST(Sample, LightsAreUnitAndLieAbove) {
  for (int n : {6, 49, 200})
    for (const auto& l : sample::domeLights(n)) {
      EXPECT_NEAR(l[0] * l[0] + l[1] * l[1] + l[2] * l[2], 1, 1e-12);
      EXPECT_GT(l[2], std::sin(9.9 * M_PI / 180));
    }
}

TEST(Sample, AWallCastsTheShadowThatGeometrySays) {
  // A wall 5 mm high across a plane, 0.5 mm per px: under light at 45 degrees its shadow is 5 mm = 10 px long, on the
  // far side.
  for (int side = 0; side < 4; ++side) {
    const int64_t n = 96;
    std::vector<float> mm(static_cast<size_t>(n * n), 0.0f);
    const bool upright = side % 2 == 0;  // the wall runs along y, light from +-x
    for (int64_t i = 0; i < n; ++i) mm[static_cast<size_t>(upright ? i * n + 48 : 48 * n + i)] = 5.0f;
    const double c = std::sqrt(0.5);
    const std::array<double, 3> light = side == 0   ? std::array<double, 3>{c, 0, c}
                                        : side == 1 ? std::array<double, 3>{0, c, c}
                                        : side == 2 ? std::array<double, 3>{-c, 0, c}
                                                    : std::array<double, 3>{0, -c, c};
    auto lit = castShadows(mm, n, n, 0.5, light);
    const int away = side == 0 || side == 3 ? -1 : 1;  // from the wall, away from the light, in pixels (y down)
    auto at = [&](int64_t d) {
      return lit[static_cast<size_t>(upright ? 50 * n + 48 + away * d : (48 + away * d) * n + 50)];
    };
    EXPECT_EQ(at(5), 0) << side;
    EXPECT_EQ(at(8), 0) << side;
    EXPECT_EQ(at(12), 255) << side;
    EXPECT_EQ(at(-5), 255) << "the lit side, " << side;
  }
}

class SampleFiles : public testing::Test {
 protected:
  std::string folder = testing::TempDir() + "relievo_sample_" +
                       std::to_string(::testing::UnitTest::GetInstance()->random_seed()) + "_" +
                       ::testing::UnitTest::GetInstance()->current_test_info()->name();
  void TearDown() override { std::filesystem::remove_all(folder); }
};

TEST_F(SampleFiles, AreWhatTheGeneratorSays) {
  const int64_t w = 150, h = 131;
  SampleArtwork a({.kind = SampleKind::kCoin, .width = w, .height = h, .seed = 4});
  auto files = writeSample(a, {.folder = folder,
                               .height = true,
                               .albedo = true,
                               .normals = true,
                               .ptm_lrgb = true,
                               .ptm_rgb = true,
                               .photos = true,
                               .mesh = true,
                               .lights = 7});
  ASSERT_TRUE(files) << files.error().text();
  for (const std::string& f : *files) EXPECT_TRUE(std::filesystem::exists(folder + "/" + f)) << f;
  const Rect all{0, 0, w, h};
  const Layers truth = readLayers(a, all);

  auto exact = openHeightImage(folder + "/height_float.tif", std::nullopt);
  ASSERT_TRUE(exact) << exact.error().text();
  std::vector<float> mm(truth.heights.size());
  ASSERT_TRUE((*exact)->read(all, mm));
  EXPECT_EQ(std::memcmp(mm.data(), truth.heights.data(), mm.size() * 4), 0);

  auto json = nlohmann::json::parse(*readTextFile(folder + "/truth.json", 1 << 20));
  const double lo = json["relief_mm"][0], hi = json["relief_mm"][1];
  auto coarse = openHeightImage(folder + "/height_16.tif", std::pair{lo, hi});
  ASSERT_TRUE(coarse) << coarse.error().text();
  ASSERT_TRUE((*coarse)->read(all, mm));
  for (size_t i = 0; i < mm.size(); ++i) ASSERT_NEAR(mm[i], truth.heights[i], 0.51 * (hi - lo) / 65535 + 1e-6);

  auto albedo = readImage8(folder + "/albedo.png");
  ASSERT_TRUE(albedo);
  EXPECT_EQ(albedo->pixels, truth.albedo);

  for (auto [name, basis, request] :
       {std::tuple{"ptm_lrgb.ptm", Basis::kPtmLrgb, &truth.lrgb}, {"ptm_rgb.ptm", Basis::kPtmRgb, &truth.rgb}}) {
    auto ptm = openPtm(folder + "/" + name);
    ASSERT_TRUE(ptm) << ptm.error().text();
    EXPECT_EQ((*ptm)->format().basis, basis);
    std::vector<uint8_t> raw(request->size());
    ASSERT_TRUE((*ptm)->read(all, raw));
    EXPECT_EQ(raw, *request) << name;
    for (size_t k = 0; k < 6; ++k) {
      EXPECT_NEAR((*ptm)->format().scale[k], a.ptmSource(basis)->format().scale[k], 1e-9) << name;
      EXPECT_EQ((*ptm)->format().bias[k], a.ptmSource(basis)->format().bias[k]) << name;
    }
  }
  auto photo = readImage8(folder + "/photos/light_007.jpg");
  ASSERT_TRUE(photo);
  EXPECT_EQ(photo->width, w);
  EXPECT_EQ(photo->height, h);
  auto list = readTextFile(folder + "/photos/lights.lp", 1 << 16);
  ASSERT_TRUE(list);
  EXPECT_EQ(list->substr(0, 2), "7\n");
  EXPECT_EQ(std::filesystem::file_size(folder + "/mesh.ply") >
                static_cast<uintmax_t>(w * h * 15 + 2 * (w - 1) * (h - 1) * 13),
            true);
}

TEST_F(SampleFiles, InterruptionStopsAndSaysSo) {
  SampleArtwork a({.kind = SampleKind::kPainting, .width = 200, .height = 100});
  std::atomic<bool> interrupted{true};
  auto files = writeSample(a, {.folder = folder, .height = true, .interrupted = &interrupted});
  ASSERT_FALSE(files);
  EXPECT_EQ(files.error().kind, ErrorKind::kInterrupted);
  EXPECT_FALSE(std::filesystem::exists(folder + "/height_float.tif"));
}

}  // namespace sample_test
}  // namespace relievo
