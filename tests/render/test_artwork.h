// test_artwork.h - a small procedural artwork for engine tests: cheap, seamless, with relief at every scale and a
// texture that leaves no error unseen. Built into a package in a temporary folder.
#pragma once

#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
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

// Value noise, 0..1, one lattice point every `cell` px, along the row at y: the corners of a cell are hashed once for
// all of its places that are asked for in a row.
class NoiseRow {
 public:
  NoiseRow(double y, double cell, uint32_t seed) : cell_(cell), seed_(seed) {
    const double gy = y / cell;
    row_ = static_cast<int64_t>(std::floor(gy));
    fy_ = gy - static_cast<double>(row_);
  }
  float operator()(double x) {
    const double gx = x / cell_;
    auto column = static_cast<int64_t>(gx);
    column -= gx < static_cast<double>(column);
    if (column != column_) {
      column_ = column;
      for (size_t k = 0; k < 4; ++k) corners_[k] = at(column + (k & 1), row_ + (k >> 1));
    }
    const double fx = gx - static_cast<double>(column);
    const double a = corners_[0] * (1 - fx) + corners_[1] * fx, b = corners_[2] * (1 - fx) + corners_[3] * fx;
    return static_cast<float>(a * (1 - fy_) + b * fy_);
  }

 private:
  double at(int64_t i, int64_t j) const {
    return static_cast<double>(mixBits(static_cast<uint32_t>(i), static_cast<uint32_t>(j), seed_) >> 8) / 16777216.0;
  }
  double cell_, fy_ = 0;
  uint32_t seed_;
  int64_t row_ = 0, column_ = std::numeric_limits<int64_t>::min();
  std::array<double, 4> corners_{};
};

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
      for (int64_t y = r.y; y < r.y + r.height; ++y) {
        const uint32_t s = seed_ + static_cast<uint32_t>(c) * 7919u;
        NoiseRow coarse(double(y), 37, s), middle(double(y), 7, s + 1), fine(double(y), 2, s + 2);
        for (int64_t x = r.x; x < r.x + r.width; ++x) {
          const float v = 0.5f * coarse(double(x)) + 0.3f * middle(double(x)) + 0.2f * fine(double(x));
          out[at++] = static_cast<uint8_t>(40 + 170 * v);
        }
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
    for (int64_t y = r.y; y < r.y + r.height; ++y) {
      NoiseRow where(double(y), 331, seed_ + 9), hills(double(y), 211, seed_), bumps(double(y), 19, seed_ + 1),
          grain(double(y), 3, seed_ + 2);
      for (int64_t x = r.x; x < r.x + r.width; ++x) {
        // Rough in places only, so that neighbouring nodes want different levels.
        const float above = where(double(x)) - 0.55f, rough = above * 2;
        float v = 0.6f * hills(double(x));
        if (above > 0) v = v + 0.25f * rough * bumps(double(x)) + 0.15f * rough * grain(double(x));
        out[at++] = static_cast<float>((v - 0.5) * range_);
      }
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
