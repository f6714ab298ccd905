// resolvePage against basis.h in double precision.
#include "texturing/codec/resolve.h"

#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <random>
#include <vector>

#include "src/artwork/bases/ptm.h"
#include "tests/other_bases.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace resolve_test {

constexpr size_t kTexels = kSlotBytes / 4;

struct Comparison {
  int worst = 0;  // bytes
  size_t different = 0, channels = 0;
  size_t different_off_ties = 0;  // where the exact value is further than `ties` from a tie
};

Comparison compare(const TextureFormat& f, const std::array<double, 3>& light, std::mt19937& random,
                   const TextureFormat& oracle_format, const std::array<double, 3>& oracle_light, double ties = 1e-4) {
  std::vector<std::vector<uint8_t>> slots(static_cast<size_t>(f.planes()), std::vector<uint8_t>(kSlotBytes));
  std::vector<const uint8_t*> pointers;
  for (auto& slot : slots) {
    for (auto& byte : slot) byte = static_cast<uint8_t>(random());
    pointers.push_back(slot.data());
  }
  std::vector<uint8_t> out(kSlotBytes);
  resolvePage(f, light, pointers, out.data());
  Comparison result;
  for (size_t i = 0; i < kTexels; ++i) {
    double raw[3 * kMaxTexturePlanes] = {};
    for (int c = 0; c < f.channels(); ++c)
      raw[c] = slots[static_cast<size_t>(c / 3)][4 * i + static_cast<size_t>(c % 3)];
    auto exact = evaluatePixel(oracle_format, raw, oracle_light);
    for (size_t c = 0; c < 3; ++c) {
      const int expected = static_cast<int>(std::floor(exact[c] + 0.5)), found = out[4 * i + c];
      ++result.channels;
      result.worst = std::max(result.worst, std::abs(expected - found));
      if (expected == found) continue;
      ++result.different;
      if (std::abs(exact[c] + 0.5 - std::round(exact[c] + 0.5)) > ties) ++result.different_off_ties;
    }
    EXPECT_EQ(out[4 * i + 3], 255);
  }
  return result;
}

// A light in front of the artwork.
Comparison compare(const TextureFormat& f, double u, double v, std::mt19937& random,
                   const TextureFormat& oracle_format) {
  const std::array<double, 3> light{u, v, std::sqrt(std::max(0.0, 1 - u * u - v * v))};
  return compare(f, light, random, oracle_format, light);
}

TextureFormat format(Basis basis) {
  TextureFormat f;
  f.basis = basis;
  if (isPtm(basis)) {
    f.scale = {2, 2, 2, 1.5, 0.7, 1.3};
    f.bias = {160, 160, 150, 127, 127, 0};
  }
  return f;
}

TEST(Resolve, EqualsTheDoublePrecisionPixel) {
  const uint32_t seed = 5;
  std::cout << "seed " << seed << "\n";
  std::mt19937 random(seed);
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, Basis::kPtmRgb}) {
    for (auto [u, v] : {std::pair{0.0, 0.0}, {0.3, -0.4}, {-0.99, 0.05}, {0.0, 1.0}, {-0.2, -0.77}}) {
      const auto f = format(basis);
      auto r = compare(f, u, v, random, f);
      EXPECT_LE(r.worst, 1) << basisName(basis);
      EXPECT_EQ(r.different_off_ties, 0u)
          << basisName(basis) << ": " << r.different << " of " << r.channels << " differ";
    }
  }
}

// Bases that the program is not built with. The reference shares the functions of the light alone.
TEST(Resolve, EqualsTheDoublePrecisionPixelOfOtherBases) {
  std::mt19937 random(6);
  for (Basis basis : test::otherBases()) {
    const TextureFormat f = test::otherFormat(basis);
    for (auto [u, v] : {std::pair{0.0, 0.0}, {0.3, -0.4}, {-0.99, 0.05}, {-0.2, -0.77}}) {
      const auto r = compare(f, u, v, random, f);
      EXPECT_LE(r.worst, 1) << basisName(basis);
      EXPECT_EQ(r.different_off_ties, 0u)
          << basisName(basis) << ": " << r.different << " of " << r.channels << " differ";
    }
    TextureFormat wrong = f;
    wrong.bias[3] += 1;
    EXPECT_GT(compare(f, 0.3, -0.4, random, wrong).different_off_ties, 1000u) << "control: a bias off by one";
  }
}

// Scans are lit from every side. Single precision and a table of powers: 5e-4 of a byte's step from a tie counts as
// one.
TEST(Resolve, AlbedoAndNormalUnderLightsFromAllAround) {
  std::mt19937 random(8);
  const auto f = format(Basis::kAlbedoNormal);
  for (std::array<double, 3> light :
       {std::array{0.0, 0.0, 1.0}, {0.0, 0.0, -1.0}, {0.6, 0.0, -0.8}, {-0.48, 0.64, 0.6}, {1.0, 0.0, 0.0}}) {
    auto r = compare(f, light, random, f, light, 5e-4);
    EXPECT_LE(r.worst, 1);
    EXPECT_EQ(r.different_off_ties, 0u) << r.different << " of " << r.channels << " differ";
    // Negative control: the comparison notices a light from the other side.
    EXPECT_GT(compare(f, light, random, f, {-light[0], -light[1], -light[2]}, 5e-4).different_off_ties, kTexels);
  }
  // White, lit face on: as it is; from behind: the ambient share. Half the normal's length: half the light.
  auto grey = [&](double nz, double lz) {
    const double raw[18] = {255, 255, 255, 127.5, 127.5, 127.5 * (nz + 1)};
    return evaluatePixel(f, raw, {0, 0, lz})[0];
  };
  EXPECT_DOUBLE_EQ(grey(1, 1), 255);
  EXPECT_DOUBLE_EQ(grey(1, -1), 255 * std::pow(0.04, 1 / 2.2));
  EXPECT_DOUBLE_EQ(grey(0.5, 1), 255 * std::pow(0.52, 1 / 2.2));
}

// The polynomial by the definition in words (PACKAGE.md), from the light's azimuth: from the front (u, v) are x and y;
// from behind the light grazes from the same side; straight from behind, where there is no side, the mean over all
// grazing lights, here over 720 of them.
std::array<double, 6> basisInWords(const std::array<double, 3>& light) {
  auto terms = [](double u, double v) { return std::array<double, 6>{u * u, v * v, u * v, u, v, 1}; };
  if (light[2] >= 0) return terms(light[0], light[1]);
  std::array<double, 6> mean{};
  for (int i = 0; i < 720; ++i) {
    const auto grazing = terms(std::cos(i * 3.14159265358979 / 360), std::sin(i * 3.14159265358979 / 360));
    for (size_t k = 0; k < 6; ++k) mean[k] += grazing[k] / 720;
  }
  const double angle = std::atan2(light[1], light[0]),
               share = std::min(1.0, std::sqrt(light[0] * light[0] + light[1] * light[1]) / 0.02);
  const auto side = terms(std::cos(angle), std::sin(angle));
  std::array<double, 6> out{};
  for (size_t k = 0; k < 6; ++k) out[k] = mean[k] * (1 - share) + side[k] * share;
  return out;
}

TEST(Resolve, PolynomialsUnderLightsOverTheWholeSphere) {
  std::mt19937 random(11);
  std::vector<std::array<double, 3>> lights{{0, 0, 1},     {0, 0, -1},          {1, 0, 0},     {0, -1, 0},
                                            {0.6, 0.8, 0}, {0.0995, 0, -0.995}, {1e-9, 0, -1}, {0.01, 0, -0.99995}};
  for (int i = 0; i < 24; ++i) {  // evenly over z, the golden angle around
    const double z = 1 - (2 * i + 1) / 24.0, r = std::sqrt(1 - z * z), angle = 2.39996 * i;
    lights.push_back({r * std::cos(angle), r * std::sin(angle), z});
  }
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    const auto f = format(basis);
    for (const auto& light : lights) {
      // The reference itself, and then the resolver against it.
      const auto terms = basisInWords(light);
      double largest = 0;
      for (int n = 0; n < 50; ++n) {
        double raw[18];
        for (double& r : raw) r = static_cast<double>(random() % 256);
        const auto pixel = evaluatePixel(f, raw, light);
        for (size_t c = 0; c < 3; ++c) {
          double sum = 0;
          for (size_t k = 0; k < 6; ++k)
            sum += (raw[basis == Basis::kPtmLrgb ? k : 3 * k + c] - f.bias[k]) * f.scale[k] * terms[k];
          if (basis == Basis::kPtmLrgb) sum *= raw[6 + c] / 255;
          largest = std::max(largest, std::abs(pixel[c] - std::clamp(sum, 0.0, 255.0)));
        }
      }
      EXPECT_LT(largest, 1e-3) << basisName(basis) << " " << light[0] << " " << light[1] << " " << light[2];
      const auto r = compare(f, light, random, f, light);
      EXPECT_LE(r.worst, 1);
      EXPECT_EQ(r.different_off_ties, 0u) << light[0] << " " << light[1] << " " << light[2];
      // Control: x and y alone do not tell a light behind the artwork from one in front of it.
      if (light[2] < -0.1) {
        EXPECT_GT(compare(f, light, random, f, {light[0], light[1], -light[2]}).different_off_ties, kTexels / 2);
      }
    }
  }
  // A rounding error of the direction changes nothing that can be seen.
  double raw[18];
  for (double& r : raw) r = static_cast<double>(random() % 256);
  for (const auto& off : {std::array{1e-7, 0.0, -1.0}, {-1e-7, 0.0, -1.0}, {0.0, 1e-7, -1.0}}) {
    const auto there = evaluatePixel(format(Basis::kPtmRgb), raw, {0, 0, -1}),
               beside = evaluatePixel(format(Basis::kPtmRgb), raw, off);
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(there[c], beside[c], 0.05);
  }
}

TEST(Resolve, ClampsAndNeverWraps) {
  // Coefficients far outside what a display shows: all results are 0 or 255.
  std::mt19937 random(6);
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    auto f = format(basis);
    f.scale = {1e6, 1e6, 1e6, 1e6, 1e6, 1e6};
    f.bias = {127.5, 127.5, 127.5, 127.5, 127.5, 127.5};
    auto r = compare(f, 0.31, 0.47, random, f);
    EXPECT_LE(r.different, 100u);  // only where the sum of huge numbers nearly cancels
    f.scale = {1e12, 1e12, 1e12, 1e12, 1e12, 1e12};
    compare(f, 0.31, 0.47, random, f);  // does not trap (sanitizers)
  }
}

TEST(Resolve, TheComparisonNoticesASwappedTermAndAForgottenBias) {
  std::mt19937 random(7);
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    auto f = format(basis), wrong = f;
    std::swap(wrong.scale[3], wrong.scale[4]);
    EXPECT_GT(compare(f, 0.3, -0.4, random, wrong).different_off_ties, kTexels / 2);
    wrong = f;
    wrong.bias[4] += 1;
    EXPECT_GT(compare(f, 0.3, -0.4, random, wrong).different_off_ties, kTexels / 10);
  }
}

}  // namespace resolve_test
}  // namespace relievo
