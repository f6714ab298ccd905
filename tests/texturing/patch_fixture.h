// patch_fixture.h - small procedural artworks over base meshes whose patches lie every way round.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "package_fixture.h"
#include "texturing/package/patch_source.h"

namespace relievo::testing_support {

// The quads of a cube's faces, n x n each, pushed onto a sphere; each patch turned or mirrored at random. open: without
// the last face.
inline BaseMesh cubeSphere(int n, double radius_mm, uint64_t seed, bool open = false) {
  BaseMesh mesh;
  mesh.origin_mm = {1000, -2000, 3000};
  std::mt19937 random(static_cast<uint32_t>(seed));
  std::map<std::array<int, 3>, uint32_t> corner_at;
  auto corner = [&](std::array<int, 3> at) {
    auto [found, added] = corner_at.emplace(at, static_cast<uint32_t>(mesh.corners.size()));
    if (added) {
      glm::dvec3 d = glm::normalize(glm::dvec3(at[0], at[1], at[2]) * 2.0 / double(n) - 1.0);
      mesh.corners.push_back({glm::vec3(d * radius_mm), glm::normalize(glm::vec3(d))});
    }
    return found->second;
  };
  for (int face = 0; face < (open ? 5 : 6); ++face) {
    const size_t axis = static_cast<size_t>(face % 3), ua = (axis + 1) % 3, va = (axis + 2) % 3;
    for (int y = 0; y < n; ++y) {
      for (int x = 0; x < n; ++x) {
        std::array<uint32_t, 4> c{};
        for (int k = 0; k < 4; ++k) {
          std::array<int, 3> at{};
          at[axis] = face < 3 ? 0 : n;
          at[ua] = x + k % 2;
          at[va] = y + k / 2;
          c[static_cast<size_t>(k)] = corner(at);
        }
        if (random() % 2) std::swap(c[1], c[2]);                         // along the diagonal
        if (random() % 2) std::swap(c[0], c[1]), std::swap(c[2], c[3]);  // left for right
        if (random() % 2) std::swap(c[0], c[2]), std::swap(c[1], c[3]);  // up for down
        mesh.patches.push_back(c);
      }
    }
  }
  return mesh;
}

// Noise in every texel and sample; what lies on a side or corner is named by the corners' indices, so that neighbours
// agree.
class NoisyPatches : public PatchSource {
 public:
  NoisyPatches(BaseMesh base, int texture_depth, int relief_depth, uint64_t seed, Basis basis = Basis::kAlbedoNormal)
      : base_(std::move(base)),
        texture_depth_(texture_depth),
        relief_depth_(relief_depth),
        seed_(seed),
        format_(sampleFormat(basis)) {}
  const BaseMesh& base() const override { return base_; }
  int textureDepth() const override { return texture_depth_; }
  int reliefDepth() const override { return relief_depth_; }
  TextureFormat format() const override { return format_; }
  double reliefOffsetMm() const override { return -1.25; }
  double reliefScaleMm() const override { return 3.0 / 65535; }
  double errorUnitMm() const override { return 1.0 / 3000; }
  std::vector<Provenance> provenance() const override { return {{"noise, seed " + std::to_string(seed_), "", "test"}}; }

  int texelSide() const { return kPagePx << texture_depth_; }
  int cells() const { return kPagePx << relief_depth_; }
  uint8_t texel(uint32_t patch, int c, int x, int y) const {
    return texel(patch, c, x, y, waveAlong(patch, x) * waveAcross(c, y));
  }
  virtual uint16_t height(uint32_t patch, int x, int y) const {
    const int n = cells();
    const auto& c = base_.patches[patch];
    const bool on_x = x == 0 || x == n, on_y = y == 0 || y == n;
    const size_t slot = static_cast<size_t>((x == n) + 2 * (y == n));
    if (on_x && on_y) return static_cast<uint16_t>(hash(1, c[slot], 0, 0));
    if (on_x || on_y) {
      uint64_t a = c[slot], b = c[slot + (on_x ? 2 : 1)], i = static_cast<uint64_t>(on_x ? y : x);
      if (a > b) std::swap(a, b), i = static_cast<uint64_t>(n) - i;
      return static_cast<uint16_t>(hash(2, a, b, i));
    }
    return static_cast<uint16_t>(hash(3 + patch, 77, static_cast<uint64_t>(x), static_cast<uint64_t>(y)) % 40000);
  }
  // Falls with the level, but for noise: the package's may not.
  float error(uint32_t patch, int level, size_t block) const {
    if (level == relief_depth_) return 0;
    return static_cast<float>(
        (0.2 + 0.001 * static_cast<double>(hash(patch, 5, static_cast<uint64_t>(level), block) % 1000)) / (1 << level));
  }
  float coarseError(uint32_t patch, size_t k) const {
    return static_cast<float>(2.0 - 0.2 * static_cast<double>(k) +
                              0.01 * static_cast<double>(hash(patch, 6, k, 0) % 10));
  }

  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    ++texel_calls;
    const int side = texelSide();
    std::vector<double> along(static_cast<size_t>(side));
    for (int x = 0; x < side; ++x) along[static_cast<size_t>(x)] = waveAlong(patch, x);
    size_t i = 0;
    for (int c = 0; c < format_.channels(); ++c)
      for (int y = 0; y < side; ++y) {
        const double across = waveAcross(c, y);
        for (int x = 0; x < side; ++x) out[i++] = texel(patch, c, x, y, along[static_cast<size_t>(x)] * across);
      }
    return {};
  }
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const override {
    size_t i = 0;
    for (int y = 0; y <= cells(); ++y)
      for (int x = 0; x <= cells(); ++x) out[i++] = height(patch, x, y);
    return {};
  }
  Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const override {
    for (size_t i = 0; i < out_mm.size(); ++i) out_mm[i] = error(patch, level, i);
    return {};
  }
  float coarseBlock(uint32_t patch, int cells_log2, size_t block) const {
    return coarseError(patch, static_cast<size_t>(cells_log2)) *
           static_cast<float>(hash(patch, 7, static_cast<uint64_t>(cells_log2), block) % 1000) / 1000;
  }
  Result<bool> coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out_mm) const override {
    for (size_t i = 0; i < out_mm.size(); ++i) out_mm[i] = coarseBlock(patch, cells_log2, i);
    return true;
  }
  DeviationShape shape(uint32_t patch, int cells_log2, size_t block) const {
    auto byte = [&](uint64_t k) {
      return static_cast<uint8_t>(hash(patch, 8 + k, static_cast<uint64_t>(cells_log2), block));
    };
    return {byte(0), byte(1), byte(2), byte(3), byte(4)};
  }
  bool errorShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> out) const override {
    for (size_t i = 0; i < out.size(); ++i) out[i] = shape(patch, cells_log2, i);
    return true;
  }
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override {
    CoarseErrors e;
    for (size_t k = 0; k < e.size(); ++k) e[k] = coarseError(patch, k);
    return e;
  }
  mutable std::atomic<int> texel_calls{0};
  bool partly_even = false;  // half of the patches' channels are the same everywhere

 private:
  static double waveAlong(uint32_t patch, int x) { return 80 * std::sin(0.05 * x + patch); }
  static double waveAcross(int c, int y) { return std::cos(0.04 * y + c); }
  uint8_t texel(uint32_t patch, int c, int x, int y, double wave) const {
    if (const uint64_t even = hash(patch, static_cast<uint64_t>(c), 9, 9); partly_even && even % 2)
      return static_cast<uint8_t>(even >> 8);
    const uint64_t h = hash(patch, static_cast<uint64_t>(c), static_cast<uint64_t>(x), static_cast<uint64_t>(y));
    return static_cast<uint8_t>(std::clamp(128 + static_cast<int>(wave) + static_cast<int>(h % 61) - 30, 0, 255));
  }
  uint64_t hash(uint64_t a, uint64_t b, uint64_t c, uint64_t d) const {
    return mixBits(mixBits(mixBits(mixBits(seed_ * 31 + a) + b) + c) + d);
  }
  BaseMesh base_;
  int texture_depth_, relief_depth_;
  uint64_t seed_;
  TextureFormat format_;
};

// A ball of 54 patches with smooth texels, but for four: two of noise, one of noise in its normals alone, and one of
// waves that texture level 0 can show and a tail cannot. The other patches, unless they meet one of these, need no
// texture pages.
class MostlySmoothPatches final : public NoisyPatches {
 public:
  static constexpr uint32_t kWeak = 0, kStrong = 22, kBent = 31, kWaves = 40;
  static constexpr double kRadiusMm = 100;
  explicit MostlySmoothPatches(uint64_t seed, int texture_depth = 1)
      : NoisyPatches(cubeSphere(3, kRadiusMm, seed), texture_depth, 0, seed) {}
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }  // about 0 mm
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    size_t i = 0;
    const double side = texelSide();
    std::vector<glm::dvec3> places;
    for (int y = 0; y < texelSide(); ++y)
      for (int x = 0; x < texelSide(); ++x)
        places.push_back(glm::normalize(base().point(patch, (x + 0.5) / side, (y + 0.5) / side) / kRadiusMm));
    for (int c = 0; c < format().channels(); ++c)
      for (int y = 0; y < texelSide(); ++y)
        for (int x = 0; x < texelSide(); ++x, ++i) {
          const glm::dvec3& at = places[i % places.size()];
          double value = c < 3 ? 128 + 40 * at[c] : 127.5 + 100 * at[c - 3];
          const auto random = static_cast<double>(mixBits(i * 131 + patch) % 1000) / 1000 - 0.5;
          if (patch == kWeak) value += 12 * random;
          if (patch == kBent && c >= 3) value += 14 * random;
          if (patch == kStrong) value += 50 * random;
          if (patch == kWaves)  // fading towards the sides
            value += 40 * std::sin(20 * x / side) * std::sin(3.1416 * (x + 0.5) / side) *
                     std::sin(3.1416 * (y + 0.5) / side) * std::sin(3.1416 * (x + 0.5) / side);
          out[i] = static_cast<uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
        }
    return {};
  }
};

}  // namespace relievo::testing_support
