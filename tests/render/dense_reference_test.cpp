// The oracle itself, against analytic truth and hand computation; each with a negative control.
#include "tests/render/dense_reference.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <iostream>
#include <random>

#include <gtest/gtest.h>
#include <glm/gtc/matrix_transform.hpp>

namespace relievo {
namespace dense_reference_test {

struct FunctionTexture final : TextureSource {
  int64_t w = 1, h = 1;
  TextureFormat f;
  std::function<uint8_t(int64_t x, int64_t y, int c)> value;
  FunctionTexture(int64_t width, int64_t height, TextureFormat fmt, std::function<uint8_t(int64_t, int64_t, int)> fn)
      : w(width), h(height), f(fmt), value(std::move(fn)) {}
  int64_t width() const override { return w; }
  int64_t height() const override { return h; }
  TextureFormat format() const override { return f; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    for (int c = 0; c < f.channels(); ++c)
      for (int64_t y = 0; y < r.height; ++y)
        for (int64_t x = 0; x < r.width; ++x) out[(c * r.height + y) * r.width + x] = value(r.x + x, r.y + y, c);
    return {};
  }
};

struct FunctionHeights final : HeightSource {
  int64_t w = 1, h = 1;
  double lo = 0, hi = 1;
  std::function<double(int64_t x, int64_t y)> value;
  FunctionHeights(int64_t width, int64_t height, double low, double high, std::function<double(int64_t, int64_t)> fn)
      : w(width), h(height), lo(low), hi(high), value(std::move(fn)) {}
  int64_t width() const override { return w; }
  int64_t height() const override { return h; }
  double minMm() const override { return lo; }
  double maxMm() const override { return hi; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    for (int64_t y = 0; y < r.height; ++y)
      for (int64_t x = 0; x < r.width; ++x) out[y * r.width + x] = static_cast<float>(value(r.x + x, r.y + y));
    return {};
  }
};

TextureFormat colourFormat() { return {}; }
TextureFormat ptmFormat(Basis basis) {
  TextureFormat f;
  f.basis = basis;
  f.scale = {2, 2, 1, 1, 1, 1};
  f.bias = {128, 128, 128, 100, 100, 0};
  return f;
}

uint8_t noise(int64_t x, int64_t y, int c) {
  uint64_t h = static_cast<uint64_t>(x) * 0x9E3779B97F4A7C15ull ^ static_cast<uint64_t>(y) * 0xC2B2AE3D27D4EB4Full ^
               static_cast<uint64_t>(c + 1) * 0x165667B19E3779F9ull;
  h ^= h >> 29;
  h *= 0xBF58476D1CE4E5B9ull;
  return static_cast<uint8_t>(h >> 56);
}

DenseTexture dense(const FunctionTexture& source, const HeightSource* relief = nullptr, double mm_per_px = 1.0) {
  auto t = buildDenseTexture(source, denseDomain(source, relief, mm_per_px));
  EXPECT_TRUE(t.ok());
  return std::move(t.value());
}

// Orthographic from the front: the image's top left corner shows texel position (x0, y0), `texels` texels a pixel.
// Heights shift what is seen by shear texels per mm to the right; higher is nearer.
DenseView frontView(const FlatDomain& d, int width, int height, double texels, double x0 = 0, double y0 = 0,
                    double shear = 0) {
  DenseView v;
  v.width_px = width;
  v.height_px = height;
  const double sx = 2.0 / (width * texels), sy = 2.0 / (height * texels);  // ndc per texel
  const double half_w = 0.5 * static_cast<double>(d.width_px), half_h = 0.5 * static_cast<double>(d.height_px);
  glm::dmat4 m{0.0};  // columns
  m[0][0] = sx / d.mm_per_px;
  m[1][1] = sy / d.mm_per_px;
  m[2][0] = sx * shear;
  m[2][2] = -0.001;
  m[3] = {(half_w - x0) * sx - 1, 1 - (half_h - y0) * sy, 0, 1};
  v.clip_from_world = m;
  return v;
}

struct Perspective {
  glm::dvec3 eye, right, up, forward;
  double tan_half = 0, aspect = 1;
  DenseView view;
};
Perspective perspectiveView(glm::dvec3 eye, glm::dvec3 target, double fov, int width, int height, double near_mm,
                            double far_mm) {
  Perspective p;
  p.eye = eye;
  p.forward = glm::normalize(target - eye);
  p.right = glm::normalize(glm::cross(p.forward, glm::dvec3(0, 1, 0)));
  p.up = glm::cross(p.right, p.forward);
  p.tan_half = std::tan(0.5 * fov);
  p.aspect = double(width) / height;
  p.view.width_px = width;
  p.view.height_px = height;
  p.view.clip_from_world =
      glm::perspective(fov, p.aspect, near_mm, far_mm) * glm::lookAt(eye, target, glm::dvec3(0, 1, 0));
  return p;
}

double largestDifference(const DenseImage& a, const DenseImage& b) {
  double worst = 0;
  for (size_t i = 0; i < a.pixels.size(); ++i) {
    if (!a.pixels[i].covered() || !b.pixels[i].covered() || a.pixels[i].edge || b.pixels[i].edge) continue;
    for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(a.pixels[i].rgb[c] - b.pixels[i].rgb[c]));
  }
  return worst;
}

// --- flat, front-parallel

TEST(DenseReference, MagnifiedRampIsExact) {
  // 64 x 64, four grey levels a texel; between centres a bilinear filter must give the very line, outside them the
  // border.
  FunctionTexture source(64, 64, colourFormat(), [](int64_t x, int64_t y, int c) {
    return uint8_t(4 * (c == 0 ? x : c == 1 ? y : 20));
  });
  DenseTexture t = dense(source);
  auto instances = uniformInstances(t.domain, 0, 3);
  DenseView view = frontView(t.domain, 256, 256, 0.25);
  DenseImage image = renderDense(t, nullptr, instances, view);
  EXPECT_EQ(image.coveredPixels(), 256u * 256u);
  double worst = 0;
  for (int y = 0; y < 256; ++y)
    for (int x = 0; x < 256; ++x) {
      const DensePixel& p = image.at(x, y);
      const double X = (x + 0.5) / 4, Y = (y + 0.5) / 4;
      ASSERT_NEAR(p.texel.x, X, 1e-11);
      ASSERT_NEAR(p.texel.y, Y, 1e-11);
      EXPECT_EQ(p.lambda, 0);
      const glm::dvec3 expected{4 * std::clamp(X - 0.5, 0.0, 63.0), 4 * std::clamp(Y - 0.5, 0.0, 63.0), 80};
      worst = std::max(worst, glm::length(p.rgb - expected));
    }
  EXPECT_LT(worst, 1e-9);

  // Negative control: half a texel to the side is two grey levels here.
  DenseImage shifted = renderDense(t, nullptr, instances, frontView(t.domain, 256, 256, 0.25, 0.5, 0));
  EXPECT_NEAR(largestDifference(image, shifted), 2.0, 1e-9);
}

TEST(DenseReference, CheckerAtOneToOneIsTheTexelsThemselves) {
  // Odd sizes, three patches, the last one cut by the border on both sides.
  FunctionTexture source(301, 99, colourFormat(),
                         [](int64_t x, int64_t y, int c) { return uint8_t(((x + y + c) & 1) ? 255 : 0); });
  DenseTexture t = dense(source);
  EXPECT_EQ(t.domain.patchColumns(), 3u);
  auto instances = uniformInstances(t.domain, 0, 5);
  DenseImage image = renderDense(t, nullptr, instances, frontView(t.domain, 301, 99, 1));
  for (int y = 0; y < 99; ++y)
    for (int x = 0; x < 301; ++x)
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(image.at(x, y).rgb[c], source.value(x, y, c), 1e-8) << x << " " << y;
  EXPECT_EQ(image.coveredPixels(), 301u * 99u);

  DenseImage shifted = renderDense(t, nullptr, instances, frontView(t.domain, 301, 99, 1, 0.5, 0));
  EXPECT_NEAR(shifted.at(100, 50).rgb[0], 127.5, 1e-8);
}

TEST(DenseReference, OutsideTheArtworkIsBackground) {
  FunctionTexture source(100, 60, colourFormat(), [](int64_t, int64_t, int) { return uint8_t(200); });
  DenseTexture t = dense(source);
  DenseImage image =
      renderDense(t, nullptr, uniformInstances(t.domain, 0, 4), frontView(t.domain, 200, 120, 1, -50.25, -30.25));
  size_t covered = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 200; ++x) {
      const double X = x + 0.5 - 50.25, Y = y + 0.5 - 30.25;
      const bool inside = X > 0 && X < 100 && Y > 0 && Y < 60;
      ASSERT_EQ(image.at(x, y).covered(), inside) << x << " " << y;
      covered += inside;
    }
  EXPECT_EQ(image.coveredPixels(), covered);
  EXPECT_EQ(image.edgePixels(), 0u);  // the border lies a quarter of a pixel from every centre
  // The border 1/128 px from the centres of one column and one row: both sides' pixels there are undetermined.
  image = renderDense(t, nullptr, uniformInstances(t.domain, 0, 4),
                      frontView(t.domain, 200, 120, 1, -50.5 - 1.0 / 128, -30));
  size_t edges = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 200; ++x) {
      const double X = x + 0.5 - 50.5 - 1.0 / 128, Y = y + 0.5 - 30;
      const bool near = std::min(std::abs(X), std::abs(X - 100)) < 1.0 / 64 && Y > 0 && Y < 60;
      ASSERT_EQ(image.at(x, y).edge, near ? kEdgeSilhouette : 0) << x << " " << y;
      edges += near;
    }
  EXPECT_EQ(edges, 120u);
}

TEST(DenseReference, LevelOfDetailOfAPlane) {
  FunctionTexture source(512, 512, colourFormat(), noise);
  DenseTexture t = dense(source);
  ASSERT_EQ(t.domain.texture_depth, 2);
  auto instances = uniformInstances(t.domain, 1, 2);
  for (auto [texels, lambda] :
       {std::pair{0.5, 0.0}, {1.0, 0.0}, {std::sqrt(2.0), 0.5}, {2.0, 1.0}, {4.0, 2.0}, {8.0, 2.0}}) {
    for (auto derivatives : {DenseDerivatives::kExact, DenseDerivatives::kQuad}) {
      DenseView view = frontView(t.domain, 64, 64, texels);
      view.derivatives = derivatives;
      DenseImage image = renderDense(t, nullptr, instances, view);
      for (const DensePixel& p : image.pixels) ASSERT_NEAR(p.lambda, lambda, 1e-9);
    }
  }
  // The same plane from a perspective camera: at twice the distance lambda is larger by one.
  auto centreLambda = [&](double distance) {
    auto p = perspectiveView({0, 0, distance}, {0, 0, 0}, 0.5, 101, 101, 1, 1e5);
    return renderDense(t, nullptr, instances, p.view).at(50, 50).lambda;
  };
  const double at_one = 101 / (2 * std::tan(0.25));  // where a pixel is a texel
  EXPECT_NEAR(centreLambda(at_one), 0, 1e-9);
  EXPECT_NEAR(centreLambda(2 * at_one), 1, 1e-9);
  EXPECT_NEAR(centreLambda(2.5 * at_one), std::log2(2.5), 1e-9);
  EXPECT_NEAR(centreLambda(20 * at_one), 2, 1e-9);
}

TEST(DenseReference, LevelsAreTheLevelImages) {
  FunctionTexture source(512, 512, colourFormat(), noise);
  DenseTexture t = dense(source);
  auto instances = uniformInstances(t.domain, 0, 1);
  auto at = [&](int level, int x, int y, int c) {
    return double(t.levels[level].texels[(y * t.levels[level].width + x) * 3 + c]);
  };
  DenseImage half = renderDense(t, nullptr, instances, frontView(t.domain, 256, 256, 2));
  DenseImage quarter = renderDense(t, nullptr, instances, frontView(t.domain, 128, 128, 4));
  for (int y = 0; y < 128; ++y)
    for (int x = 0; x < 128; ++x)
      for (int c = 0; c < 3; ++c) {
        ASSERT_NEAR(half.at(x, y).rgb[c], at(1, x, y, c), 1e-7);
        ASSERT_NEAR(quarter.at(x, y).rgb[c], at(0, x, y, c), 1e-7);
      }
  // Half way between two levels: their mean.
  DenseView view = frontView(t.domain, 512, 512, 1);
  view.lod_bias = 0.5;
  DenseImage between = renderDense(t, nullptr, instances, view);
  view.lod_bias = 1;
  DenseImage biased = renderDense(t, nullptr, instances, view);
  view.lod_bias = 0;
  DenseImage sharp = renderDense(t, nullptr, instances, view);
  for (size_t i = 0; i < between.pixels.size(); ++i)
    ASSERT_LT(glm::length(between.pixels[i].rgb - 0.5 * (sharp.pixels[i].rgb + biased.pixels[i].rgb)), 1e-9);
  // Negative control: a bias off by one is far from the truth.
  EXPECT_GT(largestDifference(sharp, biased), 50);

  view.sampling = DenseSampling::kBilinear;
  view.lod_bias = 0.49;
  EXPECT_LT(largestDifference(renderDense(t, nullptr, instances, view), sharp), 1e-9);
  view.lod_bias = 0.51;
  EXPECT_LT(largestDifference(renderDense(t, nullptr, instances, view), biased), 1e-9);
  view.lod_bias = 0.5;  // undetermined: every pixel says so, as far as its colour depends on it
  DenseImage tie = renderDense(t, nullptr, instances, view);
  EXPECT_GT(tie.edgeShare(), 0.95);
}

// --- perspective

TEST(DenseReference, TiltedPlaneHasTheClosedFormMapping) {
  FunctionTexture source(512, 384, colourFormat(), noise);
  DenseTexture t = dense(source, nullptr, 0.5);
  struct Case {
    glm::dvec3 eye, target;
    double near_mm;
  };
  size_t compared = 0, near_cut = 0;
  for (const Case& k : {Case{{30, -150, 120}, {5, 3, 0}, 1}, Case{{-90, 10, 60}, {20, 30, 0}, 1},
                        Case{{0, -80, 6}, {0, 60, 0}, 30}, Case{{3, 20, 4}, {5, 90, -1}, 0.01}}) {
    auto p = perspectiveView(k.eye, k.target, 0.9, 161, 93, k.near_mm, 1000);
    for (int level : {0, 2}) {
      DenseImage image = renderDense(t, nullptr, uniformInstances(t.domain, level, 3), p.view);
      for (int y = 0; y < 93; ++y) {
        for (int x = 0; x < 161; ++x) {
          // Ray through the pixel: d = forward + a * right + b * up; it meets z = 0 at eye - eye.z * d / d.z.
          const double a = ((x + 0.5) / 161 * 2 - 1) * p.tan_half * p.aspect, b = (1 - (y + 0.5) / 93 * 2) * p.tan_half;
          const glm::dvec3 d = p.forward + a * p.right + b * p.up;
          const glm::dvec3 d_dx = p.right * (2.0 / 161 * p.tan_half * p.aspect), d_dy = p.up * (-2.0 / 93 * p.tan_half);
          const DensePixel& pixel = image.at(x, y);
          const double distance = -p.eye.z / d.z;  // along forward
          const glm::dvec3 hit = p.eye + distance * d;
          const double X = hit.x / 0.5 + 256, Y = 192 - hit.y / 0.5;
          const bool covered =
              d.z < 0 && distance >= k.near_mm && distance <= 1000 && X >= 0 && X <= 512 && Y >= 0 && Y <= 384;
          ASSERT_EQ(pixel.covered(), covered) << x << " " << y << " X " << X << " Y " << Y;
          near_cut += !covered && d.z < 0 && distance < k.near_mm && X >= 0 && X <= 512 && Y >= 0 && Y <= 384;
          if (!covered) continue;
          ++compared;
          auto slope = [&](const glm::dvec3& dd) {  // of hit
            return glm::dvec2(-p.eye.z * (dd.x * d.z - d.x * dd.z) / (d.z * d.z),
                              -p.eye.z * (dd.y * d.z - d.y * dd.z) / (d.z * d.z));
          };
          const glm::dvec2 sx = slope(d_dx), sy = slope(d_dy);
          ASSERT_NEAR(pixel.texel.x, X, 1e-9);
          ASSERT_NEAR(pixel.texel.y, Y, 1e-9);
          ASSERT_NEAR(pixel.texel_dx.x, sx.x / 0.5, 1e-9);
          ASSERT_NEAR(pixel.texel_dx.y, -sx.y / 0.5, 1e-9);
          ASSERT_NEAR(pixel.texel_dy.x, sy.x / 0.5, 1e-9 * (1 + std::abs(sy.x)));
          ASSERT_NEAR(pixel.texel_dy.y, -sy.y / 0.5, 1e-9 * (1 + std::abs(sy.y)));
        }
      }
    }
  }
  EXPECT_GT(compared, 30000u);
  EXPECT_GT(near_cut, 100u);  // the near plane did cut

  // Negative control: affine interpolation of a triangle (what forgetting the division by w gives) is far off.
  auto p = perspectiveView({0, -150, 60}, {0, 0, 0}, 0.9, 160, 90, 1, 1000);
  DenseImage image = renderDense(t, nullptr, uniformInstances(t.domain, 0, 1), p.view);
  EXPECT_GT(std::abs(image.at(80, 40).texel_dy.y), 1.3 * std::abs(image.at(80, 70).texel_dy.y));
}

TEST(DenseReference, QuadDerivativesAreDifferencesInGlQuads) {
  FunctionTexture source(256, 256, colourFormat(), noise);
  DenseTexture t = dense(source);
  auto p = perspectiveView({0, -250, 90}, {0, 0, 0}, 0.7, 64, 49, 1, 1000);  // odd height: quads count from below
  auto instances = uniformInstances(t.domain, 0, 1);
  p.view.derivatives = DenseDerivatives::kQuad;
  DenseImage image = renderDense(t, nullptr, instances, p.view);
  int same_triangle = 0;
  for (int y = 1; y + 1 < 49; y += 2) {  // rows (y, y + 1) are a quad: GL rows 49 - 1 - y are 47, 45, ...
    for (int x = 0; x < 64; x += 2) {
      const DensePixel &a = image.at(x, y), &b = image.at(x + 1, y), &c = image.at(x, y + 1);
      if (!a.covered() || a.triangle != b.triangle || a.triangle != c.triangle) continue;
      ++same_triangle;
      const bool upper_of_quad = ((49 - 1 - y) & 1) != 0;
      EXPECT_LT(glm::length(a.texel_dx - (b.texel - a.texel)), 1e-9);
      EXPECT_LT(glm::length(b.texel_dx - a.texel_dx), 1e-9);
      if (upper_of_quad) {
        EXPECT_LT(glm::length(a.texel_dy - (c.texel - a.texel)), 1e-9);
      }
    }
  }
  EXPECT_GT(same_triangle, 200);
}

// --- anisotropic taps

// Orthographic from the front with other scales along x and y: a pixel is texels.x by texels.y texels.
DenseView stretchedView(const FlatDomain& d, int width, int height, glm::dvec2 texels, glm::dvec2 from) {
  DenseView v = frontView(d, width, height, 1);
  const double half_w = 0.5 * static_cast<double>(d.width_px), half_h = 0.5 * static_cast<double>(d.height_px);
  const double sx = 2 / (width * texels.x), sy = 2 / (height * texels.y);
  v.clip_from_world[0][0] = sx;
  v.clip_from_world[1][1] = sy;
  v.clip_from_world[3] = {(half_w - from.x) * sx - 1, 1 - (half_h - from.y) * sy, 0, 1};
  v.sampling = DenseSampling::kAnisotropic;
  return v;
}

TEST(DenseReference, AnisotropicTapsByHand) {
  FunctionTexture source(256, 128, colourFormat(), noise);
  DenseTexture t = dense(source);
  auto instances = uniformInstances(t.domain, 0, 1);
  auto texel = [&](int x, int y, int c) { return double(noise(std::clamp(x, 0, 255), std::clamp(y, 0, 127), c)); };
  // A pixel of 4 x 1 texels whose centre lies between two texels' centres: the mean of the four texels it covers.
  DenseView view = stretchedView(t.domain, 32, 16, {4, 1}, {40, 30});
  DenseImage four = renderDense(t, nullptr, instances, view);
  // 3 x 1: the two nearest taps whole, half a texel of the next two; centres between texels' centres: 0.5 + 1 + 1 +
  // 0.5.
  DenseImage three = renderDense(t, nullptr, instances, stretchedView(t.domain, 32, 16, {3, 1}, {40.5, 30}));
  // The same upright.
  DenseImage upright = renderDense(t, nullptr, instances, stretchedView(t.domain, 32, 16, {1, 4}, {40, 30}));
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 32; ++x)
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        for (int i = 0; i < 4; ++i) sum += texel(40 + 4 * x + i, 30 + y, c);
        ASSERT_NEAR(four.at(x, y).rgb[c], sum / 4, 1e-7);
        const int middle = 40 + 3 * x + 2;  // the pixel's centre, an integer
        sum = 0.5 * texel(middle - 2, 30 + y, c) + texel(middle - 1, 30 + y, c) + texel(middle, 30 + y, c) +
              0.5 * texel(middle + 1, 30 + y, c);
        ASSERT_NEAR(three.at(x, y).rgb[c], sum / 3, 1e-7);
        sum = 0;
        for (int i = 0; i < 4; ++i) sum += texel(40 + x, 30 + 4 * y + i, c);
        ASSERT_NEAR(upright.at(x, y).rgb[c], sum / 4, 1e-7);
      }
  for (const DensePixel& p : four.pixels) ASSERT_NEAR(p.lambda, 0, 1e-12);
  // Taps beyond the left border repeat its texels: a pixel of 8 x 1 around the border.
  DenseImage border = renderDense(t, nullptr, instances, stretchedView(t.domain, 8, 4, {8, 1}, {-3, 30}));
  for (int c = 0; c < 3; ++c) {
    double sum = 3 * texel(0, 30, c);
    for (int i = 0; i < 5; ++i) sum += texel(i, 30, c);
    ASSERT_NEAR(border.at(0, 0).rgb[c], sum / 8, 1e-7);
  }
  // Negative control: trilinear of the same view is another picture.
  view.sampling = DenseSampling::kTrilinear;
  EXPECT_GT(largestDifference(renderDense(t, nullptr, instances, view), four), 20);
}

TEST(DenseReference, AnisotropicIsContinuousAndEndsAtTrilinear) {
  FunctionTexture source(1024, 1024, colourFormat(), noise);
  DenseTexture t = dense(source);
  for (int n = 2; n <= 8; ++n) {
    DenseView view;
    view.sampling = DenseSampling::kAnisotropic;
    view.anisotropy = n;
    const glm::dvec2 place{517.3, 301.8};
    glm::dvec3 before{0};
    double largest = 0;
    for (int i = 0; i <= 20000; ++i) {
      const double major = 1 + 11.0 * i / 20000, turn = 0.7;
      const glm::dvec2 along{std::cos(turn), std::sin(turn)}, across{-along.y, along.x};
      // A rotated basis of the same ellipse.
      const glm::dvec2 dx = along * (major * 0.6) + across * 0.8, dy = along * (major * -0.8) + across * 0.6;
      const glm::dvec3 rgb = shadeDense(t, place, dx, dy, view);
      if (i == 0) {
        view.sampling = DenseSampling::kTrilinear;
        EXPECT_LT(glm::length(rgb - shadeDense(t, place, dx, dy, view)), 1e-9);
        view.sampling = DenseSampling::kAnisotropic;
      } else {
        largest = std::max(largest, glm::length(rgb - before));
      }
      before = rgb;
    }
    EXPECT_LT(largest, 1.0) << n;  // a step is 0.00055 texels
  }
}

// --- mip levels

TEST(DensePyramid, ConstantsStayConstant) {
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, Basis::kPtmRgb}) {
    for (int value : {0, 1, 7, 64, 127, 128, 200, 254, 255}) {
      FunctionTexture source(331, 300, basis == Basis::kColour ? colourFormat() : ptmFormat(basis),
                             [&](int64_t, int64_t, int c) { return uint8_t(value ^ (c & 1)); });
      DenseTexture t = dense(source);
      ASSERT_EQ(t.levels.size(), 3u);
      for (const DenseLevel& level : t.levels)
        for (size_t i = 0; i < level.texels.size(); ++i)
          ASSERT_EQ(level.texels[i], value ^ int((i % t.format.channels()) & 1)) << basisName(basis);
    }
  }
}

TEST(DensePyramid, SizesAndOddBorders) {
  // 5 x 3 coefficients by hand: the third column and the second row of the coarser level repeat the border.
  const uint8_t in[3][5] = {{10, 20, 30, 41, 50}, {12, 22, 32, 42, 51}, {7, 9, 11, 13, 15}};
  TextureFormat f = ptmFormat(Basis::kPtmRgb);
  std::vector<uint16_t> fixed(5 * 3 * 18);
  for (int y = 0; y < 3; ++y)
    for (int x = 0; x < 5; ++x)
      for (int c = 0; c < 18; ++c) fixed[(y * 5 + x) * 18 + c] = uint16_t((in[y][x] + c) << 8);
  auto out = denseDownsample(f, fixed, 5, 3);
  ASSERT_EQ(out.size(), 3u * 2u * 18u);
  const double expected[2][3] = {{16, 36.25, 50.5}, {8, 12, 15}};
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 3; ++x)
      for (int c = 0; c < 18; ++c) EXPECT_EQ(out[(y * 3 + x) * 18 + c], uint16_t((expected[y][x] + c) * 256));
}

TEST(DensePyramid, CoefficientRampsStayRamps) {
  // 512 wide: value x / 2 in steps; level k's texel is the mean of 2^k finer ones, exactly, before rounding to bytes.
  FunctionTexture source(512, 256, ptmFormat(Basis::kPtmRgb), [](int64_t x, int64_t, int) { return uint8_t(x / 2); });
  DenseTexture t = dense(source);
  ASSERT_EQ(t.levels.size(), 2u);
  for (int64_t x = 0; x < 256; ++x) EXPECT_EQ(t.levels[0].texels[x * 18], x);
  FunctionTexture steep(256, 256, ptmFormat(Basis::kPtmRgb), [](int64_t x, int64_t, int) { return uint8_t(x); });
  t = dense(steep);
  for (int64_t x = 0; x < 128; ++x) EXPECT_EQ(t.levels[0].texels[x * 18], 2 * x + 1);  // 2x + 0.5 rounds up
}

TEST(DensePyramid, ColourIsAveragedInLinearLight) {
  // Black and white in equal parts: half the light, sRGB 187.52; the mean of the numbers would be 127.5.
  auto out = denseDownsample(colourFormat(), {0, 0, 0, 65280, 65280, 65280, 65280, 65280, 65280, 0, 0, 0}, 2, 2);
  for (uint16_t v : out) EXPECT_NEAR(v / 256.0, 187.516, 0.01);
}

TEST(DensePyramid, LrgbColourIsWeightedByLuminance) {
  // By hand: weights 4 * ((a0 + a1) / 3 + a5) = 4 * 100, 4 * 20, 4 * 20, 4 * 20 (raw a0, a1 at their bias).
  TextureFormat f = ptmFormat(Basis::kPtmLrgb);
  std::vector<uint16_t> in;
  for (int i = 0; i < 4; ++i)
    for (int v : {128, 128, 50, 60, 70, i == 0 ? 100 : 20, i == 0 ? 200 : 40, 90, 0}) in.push_back(uint16_t(v << 8));
  auto out = denseDownsample(f, in, 2, 2);
  EXPECT_NEAR(out[6] / 256.0, (100 * 200 + 60 * 40) / 160.0, 0.2);  // not 80, the mean
  EXPECT_EQ(out[5], (100 + 60) * 64);
  EXPECT_EQ(out[7], 90 << 8);
  // The product under the diffuse light is kept: mean of products = product of the level's texel.
  EXPECT_NEAR(out[5] / 256.0 * out[6] / 256.0, (100 * 200 + 3 * 20 * 40) / 4.0, 10);
  // Dark all over (weights below the smallest): a plain mean, no division by zero.
  for (size_t i = 5; i < in.size(); i += 9) in[i] = 0;
  out = denseDownsample(f, in, 2, 2);
  EXPECT_EQ(out[6], (200 + 3 * 40) * 64);
}

TEST(DensePyramid, APeriodicTextureIsTheSameAsItsRepetition) {
  FunctionTexture period(64, 32, ptmFormat(Basis::kPtmLrgb), noise);
  FunctionTexture whole(448, 352, ptmFormat(Basis::kPtmLrgb),
                        [](int64_t x, int64_t y, int c) { return noise(x % 64, y % 32, c); });
  DenseTexture full = dense(whole);
  auto periodic = buildPeriodicTexture(period, full.domain);
  ASSERT_TRUE(periodic.ok());
  ASSERT_EQ(full.levels.size(), periodic->levels.size());
  for (size_t l = 0; l < full.levels.size(); ++l) {
    ASSERT_EQ(full.levels[l].width, periodic->levels[l].width);
    ASSERT_EQ(full.levels[l].height, periodic->levels[l].height);
    for (int64_t y = 0; y < full.levels[l].height; ++y)
      for (int64_t x = 0; x < full.levels[l].width; ++x)
        for (int c = 0; c < 9; ++c) ASSERT_EQ(full.levels[l].texel(x, y, 9)[c], periodic->levels[l].texel(x, y, 9)[c]);
  }
}

// --- relief

TEST(DenseRelief, SamplesArePlacedOnTexelCorners) {
  // A ramp of 1 mm a texel: pixel centres at +0.5, so sample i (texel position i) is i - 0.5 below; clamped at the
  // borders.
  FunctionTexture texture(200, 130, colourFormat(), noise);
  FunctionHeights heights(200, 130, 0, 200, [](int64_t x, int64_t) { return double(x); });
  FlatDomain d = denseDomain(texture, &heights);
  auto relief = buildDenseRelief(heights, d);
  ASSERT_TRUE(relief.ok());
  EXPECT_EQ(relief->width, 201);
  EXPECT_EQ(relief->height, 131);
  for (int64_t i = 0; i <= 200; ++i) {
    const double mm = std::clamp(double(i) - 0.5, 0.0, 199.0);
    EXPECT_EQ(relief->samples[i], std::floor(mm / 200 * 65535 + 0.5)) << i;
  }
  // A height map of a quarter of the size, and relief two levels coarser and finer than the texture.
  FunctionHeights quarter(50, 65, 0, 50, [](int64_t x, int64_t) { return double(x); });
  d.relief_depth = d.texture_depth - 1;
  relief = buildDenseRelief(quarter, d);
  ASSERT_TRUE(relief.ok());
  EXPECT_EQ(relief->width, 101);
  EXPECT_EQ(relief->samples[10], std::floor((20 / 4.0 - 0.5) / 50 * 65535 + 0.5));
  d.relief_depth = d.texture_depth + 2;
  relief = buildDenseRelief(quarter, d);
  ASSERT_TRUE(relief.ok());
  EXPECT_EQ(relief->width, 801);
  EXPECT_EQ(relief->samples[43], std::floor((43 / 16.0 - 0.5) / 50 * 65535 + 0.5));
}

TEST(DenseRelief, BetweenSamplesTwoTriangles) {
  FunctionTexture texture(100, 100, colourFormat(), noise);
  FlatDomain d = denseDomain(texture, nullptr);
  d.relief_depth = 0;
  DenseRelief r;
  r.width = r.height = 101;
  r.offset_mm = -1;
  r.scale_mm = 0.5;
  r.samples.assign(101 * 101, 0);
  r.samples[0] = 10;     // q00
  r.samples[1] = 20;     // q10
  r.samples[101] = 40;   // q01
  r.samples[102] = 100;  // q11
  auto q = [&](int64_t x, int64_t y) { return (denseHeightMm(r, d, x, y) + 1) / 0.5; };
  EXPECT_EQ(q(0, 0), 10);
  EXPECT_EQ(q(16, 0), 20);
  EXPECT_EQ(q(8, 0), 15);
  EXPECT_EQ(q(0, 8), 25);
  EXPECT_EQ(q(8, 8), 55);  // on the diagonal; bilinear would be 42.5
  EXPECT_EQ(q(12, 4), 10 + 0.75 * 10 + 0.25 * 80);
  EXPECT_EQ(q(4, 12), 10 + 0.75 * 30 + 0.25 * 60);
}

TEST(DenseRelief, BeyondTheBorderTheNextSample) {
  // 101 texels wide, samples every 2 texels: the border lies between samples 50 (X = 100) and 51 (X = 101, clamped from
  // 102).
  FunctionTexture texture(101, 100, colourFormat(), noise);
  FunctionHeights heights(101, 100, 0, 200, [](int64_t x, int64_t) { return double(x); });
  FlatDomain d = denseDomain(texture, &heights);
  d.relief_depth = -1;
  d.texture_depth = 0;
  FlatDomain coarse = d;
  coarse.texture_depth = 1;
  coarse.relief_depth = 0;
  auto relief = buildDenseRelief(heights, coarse);
  ASSERT_TRUE(relief.ok());
  ASSERT_EQ(relief->width, 52);
  const double last = relief->offset_mm + relief->scale_mm * relief->samples[51];
  EXPECT_EQ(denseHeightMm(*relief, coarse, 101 * 16, 0), last);
  EXPECT_EQ(denseHeightMm(*relief, coarse, 102 * 16, 0), last);
  EXPECT_EQ(denseHeightMm(*relief, coarse, 500 * 16, 0), last);
  EXPECT_LT(denseHeightMm(*relief, coarse, 100 * 16, 0), last);
}

TEST(DenseRelief, AStepHidesWhatItShould) {
  // Ground at 0 mm for X <= 64, 10 mm from X = 65 on, seen obliquely: a mm of height moves a point by one texel to the
  // left.
  FunctionTexture texture(128, 128, colourFormat(), [](int64_t x, int64_t, int) { return uint8_t(2 * x); });
  DenseTexture t = dense(texture);
  t.domain.relief_depth = 0;
  DenseRelief r;
  r.width = r.height = 129;
  r.scale_mm = 0.01;
  for (int64_t j = 0; j < 129; ++j)
    for (int64_t i = 0; i < 129; ++i) r.samples.push_back(i <= 64 ? 0 : 1000);
  auto instances = uniformInstances(t.domain, 2, 5);  // a vertex on every sample
  DenseView view = frontView(t.domain, 512, 64, 0.25, 0, 0, -1);
  DenseImage image = renderDense(t, &r, instances, view);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 512; ++x) {
      const double u = (x + 0.5) / 4;  // on screen: X - z
      const DensePixel& p = image.at(x, y);
      if (u > 118) {
        EXPECT_FALSE(p.covered());
        continue;
      }
      ASSERT_TRUE(p.covered());
      ASSERT_NEAR(p.texel.x, u < 55 ? u : u + 10, 1e-9) << x;
      ASSERT_NEAR(p.depth, u < 55 ? 0 : -0.01, 1e-12);
      ASSERT_EQ(p.edge, 0) << x << " " << int(p.edge);
    }
  // The silhouette within 1/64 px of pixel centres: those pixels, and no others, are undetermined.
  view = frontView(t.domain, 512, 64, 0.25, 0.125 + 0.25 / 128, 0, -1);
  image = renderDense(t, &r, instances, view);
  size_t occlusions = 0;
  for (const DensePixel& p : image.pixels) occlusions += (p.edge & kEdgeOcclusion) != 0;
  EXPECT_EQ(occlusions, 64u);
  // Exaggerated twice, the step hides twice as much.
  view = frontView(t.domain, 512, 64, 0.25, 0, 0, -1);
  view.exaggerate = 2;
  image = renderDense(t, &r, instances, view);
  EXPECT_NEAR(image.at(4 * 44, 10).texel.x, 44.125, 1e-9);
  EXPECT_NEAR(image.at(4 * 46, 10).texel.x, 66.125, 1e-9);
  // Negative control: without relief nothing is hidden.
  image = renderDense(t, nullptr, instances, view);
  EXPECT_NEAR(image.at(4 * 60, 10).texel.x, 60.125, 1e-9);
}

TEST(DenseRelief, SurfacesAtOneDepthAreUndetermined) {
  // The step of the test above, with heights and thus depths squeezed by e and the slant stretched by as much: the same
  // picture. Behind the top (screen place u from 55 on, depth -0.01 e) lie the riser, by 0.01 e (u - 55) / 9, and the
  // ground, by 0.01 e.
  FunctionTexture texture(128, 128, colourFormat(), [](int64_t x, int64_t, int) { return uint8_t(2 * x); });
  DenseTexture t = dense(texture);
  t.domain.relief_depth = 0;
  DenseRelief r;
  r.width = r.height = 129;
  r.scale_mm = 0.01;
  for (int64_t j = 0; j < 129; ++j)
    for (int64_t i = 0; i < 129; ++i) r.samples.push_back(i <= 64 ? 0 : 1000);
  auto instances = uniformInstances(t.domain, 2, 5);
  auto undeterminedColumns = [&](double e) {
    DenseView view = frontView(t.domain, 512, 64, 0.25, 0, 0, -1 / e);
    view.exaggerate = e;
    const DenseImage image = renderDense(t, &r, instances, view);
    std::vector<int> columns;
    for (int x = 0; x < 512; ++x) {
      const double u = (x + 0.5) / 4;
      int marked = 0;
      for (int y = 0; y < 64; ++y) {
        const DensePixel& p = image.at(x, y);
        marked += (p.edge & kEdgeOcclusion) != 0;
        if (u < 118) {
          EXPECT_NEAR(p.texel.x, u < 55 ? u : u + 10, 1e-6);
        }
      }
      EXPECT_TRUE(marked == 0 || marked == 64) << x;
      if (marked != 0) columns.push_back(x);
    }
    return columns;
  };
  // 2^-21 is 0.01 e (u - 55) / 9 at u = 55.43: two columns of a quarter of a texel.
  EXPECT_EQ(undeterminedColumns(1e-3), (std::vector<int>{220, 221}));
  // The ground is 4e-7 behind the top: all of the overlap, columns 220 to 255.
  const auto all = undeterminedColumns(4e-5);
  EXPECT_EQ(all.size(), 36u);
  EXPECT_EQ(all.front(), 220);
  EXPECT_EQ(all.back(), 255);
  // Negative controls: far enough apart, nothing.
  EXPECT_TRUE(undeterminedColumns(1).empty());
  EXPECT_TRUE(undeterminedColumns(0.01).empty());
}

TEST(DenseRelief, ACrackShows) {
  // A ridge across a node border that one side resolves and the other does not, and whose edge levels disagree.
  FunctionTexture texture(256, 128, colourFormat(), [](int64_t, int64_t, int) { return uint8_t(90); });
  DenseTexture t = dense(texture);
  t.domain.relief_depth = 0;
  DenseRelief r;
  r.width = 257;
  r.height = 129;
  r.scale_mm = 0.01;
  for (int64_t j = 0; j < 129; ++j)
    for (int64_t i = 0; i < 257; ++i) r.samples.push_back(static_cast<uint16_t>(1500 + 1500 * std::sin(j * 0.3)));
  auto count = [&](int right_edge, int left_edge) {
    auto instances = uniformInstances(t.domain, 0, 5);
    instances[0].edges[kRight] = {uint8_t(right_edge), PatchInstance::kWholeEdge};
    instances[1].edges[kLeft] = {uint8_t(left_edge), PatchInstance::kWholeEdge};
    // From the front, heights moving points to the left and right: along the border x = 128 each side is a curve.
    DenseImage image = renderDense(t, &r, instances, frontView(t.domain, 400, 400, 0.25, 90, 14, -1));
    int holes = 0;
    for (const DensePixel& pixel : image.pixels) holes += !pixel.covered();
    return holes;
  };
  EXPECT_EQ(count(5, 5), 0);
  EXPECT_EQ(count(3, 3), 0);
  EXPECT_EQ(count(1, 1), 0);
  EXPECT_GT(count(1, 5), 100);
}

// --- light

TEST(DenseReference, PtmUnderLightByHand) {
  // One texel colour everywhere: L = sum (raw - bias) * scale * basis.
  const uint8_t lrgb[9] = {138, 118, 130, 140, 90, 180, 200, 100, 50};
  FunctionTexture source(64, 64, ptmFormat(Basis::kPtmLrgb), [&](int64_t, int64_t, int c) { return lrgb[c]; });
  DenseTexture t = dense(source);
  DenseView view = frontView(t.domain, 16, 16, 1, 8, 8);
  view.light = frontLight(0.5, -0.25);
  const double lum = 20 * 0.25 - 20 * 0.0625 + 2 * -0.125 + 40 * 0.5 - 10 * -0.25 + 180;
  auto instances = uniformInstances(t.domain, 0, 1);
  DenseImage image = renderDense(t, nullptr, instances, view);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(image.at(3, 4).rgb[c], std::min(255.0, lrgb[6 + c] * lum / 255), 1e-9);
  view.resolved = true;
  DenseImage resolved = renderDense(t, nullptr, instances, view);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(resolved.at(3, 4).rgb[c], std::floor(std::min(255.0, lrgb[6 + c] * lum / 255) + 0.5), 1e-9);
  // Negative control: u and v swapped.
  std::swap(view.light[0], view.light[1]);
  view.resolved = false;
  EXPECT_GT(largestDifference(image, renderDense(t, nullptr, instances, view)), 1);

  const uint8_t rgb_base[6] = {138, 118, 130, 140, 90, 100};
  FunctionTexture rgb(64, 64, ptmFormat(Basis::kPtmRgb),
                      [&](int64_t, int64_t, int c) { return uint8_t(rgb_base[c / 3] + c % 3); });
  t = dense(rgb);
  std::swap(view.light[0], view.light[1]);
  image = renderDense(t, nullptr, instances, view);
  for (int c = 0; c < 3; ++c) {
    const double expected =
        (20 + 2 * c) * 0.25 + (-20 + 2 * c) * 0.0625 + (2 + c) * -0.125 + (40 + c) * 0.5 + (-10 + c) * -0.25 + 100 + c;
    EXPECT_NEAR(image.at(3, 4).rgb[c], expected, 1e-9);
  }
}

TEST(DenseReference, ResolvedFiltersProductsUnresolvedFiltersCoefficients) {
  // Two columns: dark grey under bright light, white under none. Half way between texel centres:
  // coefficients give mean colour x mean luminance, pages resolved once give the mean of the products.
  FunctionTexture source(64, 64, ptmFormat(Basis::kPtmLrgb), [](int64_t x, int64_t, int c) {
    const bool odd = x & 1;
    if (c == 5) return uint8_t(odd ? 200 : 0);
    if (c >= 6) return uint8_t(odd ? 50 : 250);
    return uint8_t(c < 3 ? 128 : 100);
  });
  DenseTexture t = dense(source);
  DenseView view = frontView(t.domain, 32, 32, 1, 0.5, 0);
  auto instances = uniformInstances(t.domain, 0, 1);
  EXPECT_NEAR(renderDense(t, nullptr, instances, view).at(10, 10).rgb[0], 150 * 100 / 255.0, 1e-9);
  view.resolved = true;
  EXPECT_NEAR(renderDense(t, nullptr, instances, view).at(10, 10).rgb[0], (std::floor(50 * 200 / 255.0 + 0.5) + 0) / 2,
              1e-9);
}

// --- comparison

std::vector<uint8_t> asRgba(const DenseImage& image, bool bottom_up) {
  std::vector<uint8_t> out(image.pixels.size() * 4);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const int row = bottom_up ? image.height - 1 - y : y;
      const auto bytes = image.at(x, y).bytes();
      uint8_t* p = &out[(size_t(row) * image.width + x) * 4];
      for (int c = 0; c < 3; ++c) p[c] = bytes[c];
      p[3] = image.at(x, y).covered() ? 255 : 0;
    }
  return out;
}

TEST(CompareImages, SeesEveryKindOfDifference) {
  FunctionTexture source(128, 100, colourFormat(),
                         [](int64_t x, int64_t y, int c) { return uint8_t(20 + noise(x, y, c) / 2); });
  DenseTexture t = dense(source);
  DenseImage image =
      renderDense(t, nullptr, uniformInstances(t.domain, 0, 4), frontView(t.domain, 150, 120, 1, -10.3, -10.3));
  for (bool bottom_up : {false, true}) {
    auto rgba = asRgba(image, bottom_up);
    auto d = compareImages(image, rgba, bottom_up);
    EXPECT_EQ(d.maxDifference(), 0) << d.text();
    EXPECT_LE(d.max_exact, 0.5);
    EXPECT_TRUE(d.within(0));
    EXPECT_EQ(d.compared, 128u * 100u);
    EXPECT_FALSE(compareImages(image, rgba, !bottom_up).within(1));  // upside down

    auto offset = [&](int x, int y) { return (size_t(bottom_up ? 119 - y : y) * 150 + x) * 4; };
    auto damaged = rgba;
    damaged[offset(60, 33) + 1] = uint8_t(damaged[offset(60, 33) + 1] + 3);
    d = compareImages(image, damaged, bottom_up);
    EXPECT_EQ(d.max_difference, (std::array<int, 3>{0, 3, 0}));
    EXPECT_EQ(d.count_above_1, 1u);
    EXPECT_EQ(d.worst.x, 60);
    EXPECT_EQ(d.worst.y, 33);
    EXPECT_EQ(d.worst.channel, 1);
    EXPECT_FALSE(d.within(1));
    EXPECT_LE(d.percentile_999, 0.5);

    damaged = rgba;
    damaged[offset(60, 33) + 3] = 0;
    d = compareImages(image, damaged, bottom_up);
    EXPECT_EQ(d.holes, 1u);
    EXPECT_FALSE(d.within(255));

    damaged = rgba;
    damaged[offset(2, 2) + 3] = 255;
    d = compareImages(image, damaged, bottom_up);
    EXPECT_EQ(d.extras, 1u);
    EXPECT_FALSE(d.within(255));
  }
}

}  // namespace dense_reference_test
}  // namespace relievo
