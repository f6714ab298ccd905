// tail_fixture.h - tails of patches for tests of their codes: smooth ones, noise, and what lies between.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "src/artwork/relief_lattice.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/patch_tails.h"

namespace relievo::tail_fixture {

inline constexpr uint32_t kSeed = 20261127;

struct Tails {
  int channels = 6;
  std::vector<uint16_t> heights;
  std::vector<uint8_t> texels;
  size_t patches() const { return heights.size() / kTailHeights; }
};

inline Tails empty(size_t patches, int channels) {
  return {channels, std::vector<uint16_t>(patches * kTailHeights),
          std::vector<uint8_t>(patches * kTailPatchTexels * static_cast<size_t>(channels))};
}

inline Tails noise(size_t patches, int channels) {
  Tails t = empty(patches, channels);
  std::mt19937 random(kSeed);
  for (uint16_t& h : t.heights) h = static_cast<uint16_t>(random());
  for (uint8_t& b : t.texels) b = static_cast<uint8_t>(random());
  return t;
}

// A wavy surface's heights, in steps of `step`, and normals; albedo of one colour, or with a hue that differs.
inline Tails smooth(size_t patches, bool painted, int step = 1) {
  Tails t = empty(patches, 6);
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> number(-3, 3);
  for (size_t p = 0; p < patches; ++p) {
    std::array<std::array<double, 3>, 4> waves;  // of this patch: along u, along v, phase
    for (auto& wave : waves) wave = {number(random), number(random), number(random)};
    auto height = [&](double u, double v) {
      double sum = 30000;
      for (const auto& [a, b, phase] : waves) sum += 800 * std::sin(a * u + b * v + phase);
      return sum;
    };
    for (int y = 0; y <= 16; ++y)
      for (int x = 0; x <= 16; ++x)
        t.heights[p * kTailHeights + static_cast<size_t>(17 * y + x)] =
            static_cast<uint16_t>(step * std::lround(height(x / 16.0, y / 16.0) / step));
    PatchTails tail(1, 6);
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x) {
        const double u = (x + 0.5) / 16, v = (y + 0.5) / 16, d = 1e-4;
        const double dx = (height(u + d, v) - height(u, v)) / d / 4000,
                     dy = (height(u, v + d) - height(u, v)) / d / 4000;
        const double length = std::sqrt(dx * dx + dy * dy + 1);
        const double n[3] = {-dx / length, dy / length, 1 / length};
        const double light = painted ? 100 + 60 * std::sin(waves[0][0] * u + waves[1][1] * v) : 200;
        for (int c = 0; c < 3; ++c) {
          tail.level(0, 0, c)[y * 16 + x] = static_cast<uint8_t>(std::lround(light * (1 - 0.2 * c)));
          tail.level(0, 0, 3 + c)[y * 16 + x] = static_cast<uint8_t>(std::lround(127.5 * (n[c] + 1)));
        }
      }
    for (int level = 1; level < kTailLevels; ++level)
      for (int c = 0; c < 6; ++c) {
        const int side = PatchTails::side(level);
        for (int i = 0; i < side * side; ++i) {
          const uint8_t* from = tail.level(0, level - 1, c) + i / side * 4 * side + i % side * 2;
          const int sum = from[0] + from[1] + from[2 * side] + from[2 * side + 1];
          tail.level(0, level, c)[i] = static_cast<uint8_t>((sum + 2 + (i % 7 == 0)) / 4);
        }
      }
    std::copy(tail.texels.begin(), tail.texels.end(),
              t.texels.begin() + static_cast<std::ptrdiff_t>(p * kTailPatchTexels * 6));
  }
  return t;
}

// Level 0 has what no line shows and the mean of four neighbours does, so that nothing of it is left to be coded; finer
// levels are as the lattice says.
inline void makeSaddle(Tails& t, size_t patch) {
  uint16_t* h = t.heights.data() + patch * kTailHeights;
  auto at = [&](int x, int y) -> uint16_t& { return h[17 * y + x]; };
  for (int k = 0; k < 4; ++k) at(k % 2 * 16, k / 2 * 16) = k == 0 || k == 3 ? 3000 : 3800;
  for (int step = 16; step > 1; step /= 2)
    for (int y = 0; y < 17; y += step / 2)
      for (int x = 0; x < 17; x += step / 2) {
        const int dx = x % step, dy = y % step;
        if (dx || dy) at(x, y) = static_cast<uint16_t>(midHeight(at(x - dx, y - dy), at(x + dx, y + dy)));
        if (step == 16 && dx && dy) at(x, y) = 3400;
      }
}

struct Contents {
  const char* name;
  Tails tails;
};
inline std::vector<Contents> contents() {
  Tails extremes = noise(7, 3);
  for (uint16_t& h : extremes.heights) h = h & 1 ? 65535 : 0;
  for (uint8_t& b : extremes.texels) b = b & 1 ? 255 : 0;
  Tails changing = empty(9, 6);  // patches of one colour, of which some have another one
  for (size_t i = 0; i < changing.texels.size(); ++i)
    changing.texels[i] = static_cast<uint8_t>(i / (kTailPatchTexels * 6) / 3 * 100);
  Tails saddles = smooth(9, false);
  for (size_t p = 0; p < 9; p += 2) makeSaddle(saddles, p);
  return {{"saddles", saddles},
          {"noise", noise(5, 6)},
          {"one patch of a PTM", noise(1, 9)},
          {"zeros", empty(3, 6)},
          {"extremes", extremes},
          {"colours that change", changing},
          {"smooth", smooth(40, false)},
          {"smooth and painted", smooth(40, true)},
          {"in steps", smooth(20, true, 24)}};
}

// good: a code of 12 patches of two planes with those corners; fewer, more: corners of 11 and of 13.
inline void expectDamageIsRefused(const std::vector<uint8_t>& good, PatchCorners corners, PatchCorners fewer,
                                  PatchCorners more) {
  auto decodes = [&](std::span<const uint8_t> bytes, size_t patches, int channels, PatchCorners of) {
    Tails back = empty(patches, channels);
    return decodeTailCode(bytes, channels, of, back.heights, back.texels);
  };
  EXPECT_TRUE(decodes(good, 12, 6, corners)) << "control";
  for (size_t length = 0; length < good.size(); length += length < 64 ? 1 : 37)
    EXPECT_FALSE(decodes(std::span(good).first(length), 12, 6, corners)) << length;
  std::vector<uint8_t> longer = good;
  longer.push_back(0);
  EXPECT_FALSE(decodes(longer, 12, 6, corners));
  EXPECT_FALSE(decodes(good, 11, 6, fewer));
  EXPECT_FALSE(decodes(good, 13, 6, more));
  EXPECT_FALSE(decodes(good, 12, 9, corners));
  std::mt19937 random(kSeed);
  size_t refused = 0, tried = 0;
  for (size_t i = 0; i < good.size(); i += 1 + good.size() / 400, ++tried) {
    std::vector<uint8_t> bad = good;
    bad[i] ^= static_cast<uint8_t>(1u << random() % 8);
    refused += !decodes(bad, 12, 6, corners);
  }
  EXPECT_GT(refused, tried / 2) << "most leave too few bytes or too many";
  size_t refused_junk = 0;
  std::vector<uint8_t> junk(3000);
  for (int i = 0; i < 50; ++i) {
    for (uint8_t& b : junk) b = static_cast<uint8_t>(random());
    // Streams of lengths that fit, of anything.
    size_t at = 0;
    for (uint32_t length : {900u, 1000u, 1088u}) {
      for (size_t k = 0; k < 4; ++k) junk[at + k] = static_cast<uint8_t>(length >> 8 * k);
      junk[at + 4] = static_cast<uint8_t>(i % 5);
      at += 4 + length;
    }
    refused_junk += !decodes(junk, 12, 6, corners);
  }
  EXPECT_GE(refused_junk, 49u) << "hardly any junk ends where its last bit does";
}

}  // namespace relievo::tail_fixture
