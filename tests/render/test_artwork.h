// test_artwork.h - a small procedural artwork for engine tests: cheap, seamless, with relief at every scale and a
// texture that leaves no error unseen. Built into a package in a temporary folder.
#pragma once

#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <tuple>

#include "texturing/package/package.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/raster_source.h"

namespace relievo::test {

inline uint32_t mixBits(uint32_t x, uint32_t y, uint32_t seed) {
  uint32_t h = x * 0x9E3779B1u ^ y * 0x85EBCA77u ^ seed * 0xC2B2AE3Du;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return h ^ (h >> 15);
}

// Value noise, 0..1, one lattice point every `cell` px.
inline float valueNoise(double x, double y, double cell, uint32_t seed) {
  double gx = x / cell, gy = y / cell;
  auto ix = static_cast<int64_t>(std::floor(gx)), iy = static_cast<int64_t>(std::floor(gy));
  double fx = gx - static_cast<double>(ix), fy = gy - static_cast<double>(iy);
  auto at = [&](int64_t i, int64_t j) {
    return static_cast<double>(mixBits(static_cast<uint32_t>(i), static_cast<uint32_t>(j), seed) >> 8) / 16777216.0;
  };
  double a = at(ix, iy) * (1 - fx) + at(ix + 1, iy) * fx, b = at(ix, iy + 1) * (1 - fx) + at(ix + 1, iy + 1) * fx;
  return static_cast<float>(a * (1 - fy) + b * fy);
}

class NoiseTexture final : public TextureSource {
 public:
  NoiseTexture(int64_t w, int64_t h, Basis basis, uint32_t seed) : w_(w), h_(h), seed_(seed) {
    format_.basis = basis;
    if (basis != Basis::kColour) {
      format_.scale = {1.5, 1.5, 1.2, 1.3, 1.3, 1.1};
      format_.bias = {190, 190, 128, 110, 110, 20};
    }
  }
  int64_t width() const override { return w_; }
  int64_t height() const override { return h_; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return {"noise", "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t at = 0;
    for (int c = 0; c < format_.channels(); ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) {
          auto s = seed_ + static_cast<uint32_t>(c) * 7919u;
          float v = 0.5f * valueNoise(double(x), double(y), 37, s) + 0.3f * valueNoise(double(x), double(y), 7, s + 1) +
                    0.2f * valueNoise(double(x), double(y), 2, s + 2);
          out[at++] = static_cast<uint8_t>(40 + 170 * v);
        }
    return {};
  }

 private:
  int64_t w_, h_;
  uint32_t seed_;
  TextureFormat format_;
};

class NoiseHeight final : public HeightSource {
 public:
  NoiseHeight(int64_t w, int64_t h, double range_mm, uint32_t seed) : w_(w), h_(h), range_(range_mm), seed_(seed) {}
  int64_t width() const override { return w_; }
  int64_t height() const override { return h_; }
  double minMm() const override { return -range_ / 2; }
  double maxMm() const override { return range_ / 2; }
  Provenance provenance() const override { return {"noise", "", "test"}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    size_t at = 0;
    for (int64_t y = r.y; y < r.y + r.height; ++y)
      for (int64_t x = r.x; x < r.x + r.width; ++x) {
        // Rough in places only, so that neighbouring nodes want different levels.
        float rough = valueNoise(double(x), double(y), 331, seed_ + 9);
        rough = rough > 0.55f ? (rough - 0.55f) * 2 : 0;
        float v = 0.6f * valueNoise(double(x), double(y), 211, seed_) +
                  0.25f * rough * valueNoise(double(x), double(y), 19, seed_ + 1) +
                  0.15f * rough * valueNoise(double(x), double(y), 3, seed_ + 2);
        out[at++] = static_cast<float>((v - 0.5) * range_);
      }
    return {};
  }

 private:
  int64_t w_, h_;
  double range_;
  uint32_t seed_;
};

class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "relievo-test-XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  std::string file(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

// mm_per_px is 0.1: a 2048 px artwork is some 205 mm wide.
inline std::shared_ptr<const Package> noisePackage(const TemporaryFolder& folder, int64_t w, int64_t h, Basis basis,
                                                   double range_mm, uint32_t seed, std::string* why) {
  NoiseTexture texture(w, h, basis, seed);
  NoiseHeight heights(w, h, range_mm, seed + 100);
  BuildOptions options;
  options.output = folder.file("noise-" + std::to_string(seed) + ".relievo");
  options.mm_per_px = 0.1;
  auto built = buildPackage(texture, range_mm > 0 ? &heights : nullptr, options);
  if (!built) {
    *why = built.error().text();
    return nullptr;
  }
  auto package = Package::open(options.output);
  if (!package) {
    *why = package.error().text();
    return nullptr;
  }
  return *package;
}

// The same, built once a program: it takes seconds, and most tests only read it. In a folder of its own, for as long as
// the program runs.
inline std::shared_ptr<const Package> noisePackageOnce(int64_t w, int64_t h, Basis basis, double range_mm,
                                                       uint32_t seed, std::string* why) {
  struct Built {
    TemporaryFolder folder;
    std::shared_ptr<const Package> package;
  };
  static std::map<std::tuple<int64_t, int64_t, Basis, double, uint32_t>, Built> all;
  Built& built = all[{w, h, basis, range_mm, seed}];
  if (!built.package) built.package = noisePackage(built.folder, w, h, basis, range_mm, seed, why);
  return built.package;
}

}  // namespace relievo::test
