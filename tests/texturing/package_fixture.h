// package_fixture.h - small artworks in memory and a naive reference of what their packages must hold: plain loops over
// whole images, written from PACKAGE.md and sharing nothing with the builder.
#pragma once

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/bases/ptm.h"
#include "src/artwork/patch_domain.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/raster_source.h"

namespace relievo::testing_support {

inline uint64_t mixBits(uint64_t v) {
  v = (v ^ (v >> 30)) * 0xBF58476D1CE4E5B9ull;
  v = (v ^ (v >> 27)) * 0x94D049BB133111EBull;
  return v ^ (v >> 31);
}

inline TextureFormat sampleFormat(Basis basis) {
  TextureFormat f;
  f.basis = basis;
  if (isPtm(basis)) {
    f.scale = {2, 2, 2, 2, 2, 4};
    f.bias = {160, 150, 128, 120, 128, 20};
  }
  return f;
}

// Smooth shapes with noise of a few units; any rectangle from its coordinates alone.
class NoisyTexture final : public TextureSource {
 public:
  NoisyTexture(int64_t width, int64_t height, Basis basis, uint64_t seed, int noise = 8)
      : width_(width), height_(height), seed_(seed), noise_(noise), format_(sampleFormat(basis)) {}
  int64_t width() const override { return width_; }
  int64_t height() const override { return height_; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return {"noise, seed " + std::to_string(seed_), "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t i = 0;
    for (int c = 0; c < format_.channels(); ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) out[i++] = at(c, x, y);
    return {};
  }
  uint8_t at(int c, int64_t x, int64_t y) const {
    uint64_t h = mixBits(seed_ * 1000003 + static_cast<uint64_t>(c) + static_cast<uint64_t>(x) * 0x9E3779B97F4A7C15ull +
                         static_cast<uint64_t>(y) * 0xC2B2AE3D27D4EB4Full);
    int base = 128 + static_cast<int>(90 * std::sin(0.03 * static_cast<double>(x) + c) *
                                      std::cos(0.021 * static_cast<double>(y) - c));
    return static_cast<uint8_t>(
        std::clamp(base + static_cast<int>(h % static_cast<uint64_t>(2 * noise_ + 1)) - noise_, 0, 255));
  }

 private:
  int64_t width_, height_;
  uint64_t seed_;
  int noise_;
  TextureFormat format_;
};

class NoisyHeights final : public HeightSource {
 public:
  NoisyHeights(int64_t width, int64_t height, uint64_t seed, double amplitude = 1.0)
      : width_(width), height_(height), seed_(seed), amplitude_(amplitude) {}
  int64_t width() const override { return width_; }
  int64_t height() const override { return height_; }
  double minMm() const override { return -1.5 * amplitude_ - 0.25; }
  double maxMm() const override { return 1.5 * amplitude_ + 0.5; }
  Provenance provenance() const override { return {"heights, seed " + std::to_string(seed_), "", "test"}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    size_t i = 0;
    for (int64_t y = r.y; y < r.y + r.height; ++y)
      for (int64_t x = r.x; x < r.x + r.width; ++x) out[i++] = at(x, y);
    return {};
  }
  float at(int64_t x, int64_t y) const {
    uint64_t h = mixBits(seed_ * 7919 + static_cast<uint64_t>(x) * 0x9E3779B97F4A7C15ull +
                         static_cast<uint64_t>(y) * 0xC2B2AE3D27D4EB4Full);
    double noise = static_cast<double>(h % 1001) / 1000.0 - 0.5;
    return static_cast<float>(
        amplitude_ * (std::sin(0.05 * static_cast<double>(x)) * std::cos(0.04 * static_cast<double>(y)) + noise));
  }

 private:
  int64_t width_, height_;
  uint64_t seed_;
  double amplitude_;
};

// ---- the naive pyramid ----
struct NaiveImage {
  int64_t width = 0, height = 0;
  std::vector<std::vector<int64_t>> channels;  // 8.8 fixed point
  int64_t at(int c, int64_t x, int64_t y) const {
    x = std::clamp<int64_t>(x, 0, width - 1);
    y = std::clamp<int64_t>(y, 0, height - 1);
    return channels[static_cast<size_t>(c)][static_cast<size_t>(y * width + x)];
  }
};

inline NaiveImage naiveFinest(const TextureSource& source) {
  NaiveImage image{source.width(), source.height(), {}};
  int n = source.format().channels();
  std::vector<uint8_t> bytes(static_cast<size_t>(n * image.width * image.height));
  (void)source.read({0, 0, image.width, image.height}, bytes);
  size_t i = 0;
  for (int c = 0; c < n; ++c) {
    image.channels.emplace_back();
    for (int64_t k = 0; k < image.width * image.height; ++k) image.channels.back().push_back(int64_t{bytes[i++]} * 256);
  }
  return image;
}

inline int64_t floorShift(int64_t v, int s) { return v >= 0 ? v >> s : -((-v + (int64_t{1} << s) - 1) >> s); }

inline NaiveImage naiveCoarser(const NaiveImage& fine, const TextureFormat& format) {
  NaiveImage out{(fine.width + 1) / 2, (fine.height + 1) / 2, {}};
  out.channels.assign(fine.channels.size(), std::vector<int64_t>(static_cast<size_t>(out.width * out.height)));
  auto lin = [](int64_t v) {
    double s = static_cast<double>(v) / 65280.0;
    return std::llround(65535 * (s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4)));
  };
  auto enc = [](int64_t n) {
    double l = static_cast<double>(n) / 65535.0;
    return std::llround(65280 * (l <= 0.0031308 ? 12.92 * l : 1.055 * std::pow(l, 1 / 2.4) - 0.055));
  };
  const double f[6] = {1.0 / 3, 1.0 / 3, 0, 0, 0, 1};
  int64_t m[6] = {}, offset = 0;
  for (int s = 0;; ++s) {
    bool fits = true;
    offset = 0;
    for (int k : {0, 1, 5}) {
      double factor = 4096 * f[k] * format.scale[static_cast<size_t>(k)] / std::ldexp(1.0, s);
      if (std::abs(factor) > 65536) fits = false;
      m[k] = std::llround(factor);
      offset -= m[k] * std::llround(16 * format.bias[static_cast<size_t>(k)]);
    }
    if (fits) break;
  }
  offset = std::clamp<int64_t>(offset, -800000000, 800000000);
  auto weight = [&](int64_t x, int64_t y) {
    int64_t sum = offset;
    for (int k : {0, 1, 5}) sum += m[k] * (fine.at(k, x, y) >> 4);
    return std::clamp<int64_t>(floorShift(sum, 14), 1, 4095);
  };
  for (size_t c = 0; c < fine.channels.size(); ++c) {
    for (int64_t y = 0; y < out.height; ++y) {
      for (int64_t x = 0; x < out.width; ++x) {
        int64_t v[4], w[4], i = 0;
        for (int dy = 0; dy < 2; ++dy) {
          for (int dx = 0; dx < 2; ++dx, ++i) {
            v[i] = fine.at(static_cast<int>(c), 2 * x + dx, 2 * y + dy);
            // at() clamps: the border's texel is repeated
            w[i] = format.basis == Basis::kPtmLrgb && c >= 6
                       ? weight(std::min(2 * x + dx, fine.width - 1), std::min(2 * y + dy, fine.height - 1))
                       : 1;
          }
        }
        int64_t r;
        if (format.basis == Basis::kColour || (format.basis == Basis::kAlbedoNormal && c < 3)) {
          r = enc((lin(v[0]) + lin(v[1]) + lin(v[2]) + lin(v[3]) + 2) / 4);
        } else if (format.basis == Basis::kPtmLrgb && c >= 6) {
          int64_t total = w[0] + w[1] + w[2] + w[3];
          r = (w[0] * v[0] + w[1] * v[1] + w[2] * v[2] + w[3] * v[3] + total / 2) / total;
        } else {
          r = (v[0] + v[1] + v[2] + v[3] + 2) / 4;
        }
        out.channels[c][static_cast<size_t>(y * out.width + x)] = r;
      }
    }
  }
  return out;
}

// Levels 0..depth.
inline std::vector<NaiveImage> naivePyramid(const TextureSource& source, int depth) {
  std::vector<NaiveImage> levels(static_cast<size_t>(depth) + 1);
  levels[static_cast<size_t>(depth)] = naiveFinest(source);
  for (int l = depth - 1; l >= 0; --l)
    levels[static_cast<size_t>(l)] = naiveCoarser(levels[static_cast<size_t>(l) + 1], source.format());
  return levels;
}

// The page's three channels; border: what lies beyond the page comes from its neighbours (false: the page's own edge,
// as a builder without borders would have it - a negative control).
inline std::vector<uint8_t> naivePage(const std::vector<NaiveImage>& levels, const FlatDomain& d, const NodeId& node,
                                      int plane, bool border = true) {
  const NaiveImage& image = levels[node.level];
  int shift = d.texture_depth - static_cast<int>(node.level);
  int64_t x0 = static_cast<int64_t>(d.patchOriginX(node.patch) >> shift) + int64_t{node.x} * kPagePx;
  int64_t y0 = static_cast<int64_t>(d.patchOriginY(node.patch) >> shift) + int64_t{node.y} * kPagePx;
  std::vector<uint8_t> out;
  for (int c = 3 * plane; c < 3 * plane + 3; ++c) {
    for (int j = -kPageBorderPx; j < kPagePx + kPageBorderPx; ++j) {
      for (int i = -kPageBorderPx; i < kPagePx + kPageBorderPx; ++i) {
        int pi = border ? i : std::clamp(i, 0, kPagePx - 1), pj = border ? j : std::clamp(j, 0, kPagePx - 1);
        out.push_back(static_cast<uint8_t>(std::min<int64_t>(255, (image.at(c, x0 + pi, y0 + pj) + 128) / 256)));
      }
    }
  }
  return out;
}

// ---- naive relief ----
inline int naiveReliefDepth(const FlatDomain& d, const HeightSource& h) {
  double pixel = std::min(static_cast<double>(d.width_px) / static_cast<double>(h.width()),
                          static_cast<double>(d.height_px) / static_cast<double>(h.height()));
  int depth = 0;
  while (static_cast<double>(d.patchPx()) / (128.0 * std::ldexp(1.0, depth)) > pixel * 1.01) ++depth;
  return depth;
}

// The height in 16-bit units at a texel position, from the whole map.
inline double naiveHeightMm(const HeightSource& source, const std::vector<float>& map, const FlatDomain& d, double tx,
                            double ty) {
  auto place = [](double texel, uint64_t extent, int64_t pixels, int64_t* low, double* f) {
    double at = std::clamp(
        std::min(texel, static_cast<double>(extent)) * static_cast<double>(pixels) / static_cast<double>(extent) - 0.5,
        0.0, static_cast<double>(pixels - 1));
    *low = static_cast<int64_t>(std::floor(at));
    *f = at - static_cast<double>(*low);
  };
  int64_t x, y;
  double fx, fy;
  place(tx, d.width_px, source.width(), &x, &fx);
  place(ty, d.height_px, source.height(), &y, &fy);
  auto at = [&](int64_t i, int64_t j) {
    return static_cast<double>(
        map[static_cast<size_t>(std::min(j, source.height() - 1) * source.width() + std::min(i, source.width() - 1))]);
  };
  return (1 - fy) * ((1 - fx) * at(x, y) + fx * at(x + 1, y)) + fy * ((1 - fx) * at(x, y + 1) + fx * at(x + 1, y + 1));
}

// Heights in 16-bit units (unrounded) of a page's samples.
inline std::vector<double> naiveReliefPage(const HeightSource& source, const std::vector<float>& map,
                                           const FlatDomain& d, const NodeId& node) {
  double scale = (source.maxMm() - source.minMm()) / 65535.0;
  double step = static_cast<double>(d.patchPx()) / (128.0 * std::ldexp(1.0, static_cast<int>(node.level)));
  std::vector<double> out;
  for (int j = 0; j <= 128; ++j)
    for (int i = 0; i <= 128; ++i) {
      double mm =
          naiveHeightMm(source, map, d, static_cast<double>(d.patchOriginX(node.patch)) + (node.x * 128.0 + i) * step,
                        static_cast<double>(d.patchOriginY(node.patch)) + (node.y * 128.0 + j) * step);
      out.push_back(scale > 0 ? (mm - source.minMm()) / scale : 0.0);
    }
  return out;
}

inline std::vector<uint8_t> readAll(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
inline void writeAll(const std::string& path, std::span<const uint8_t> bytes) {
  std::ofstream out(path, std::ios::binary);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

// A folder that goes away with its contents.
class ScratchFolder {
 public:
  ScratchFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "relievo-test-XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  ~ScratchFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::string file(const std::string& name) const { return (path_ / name).string(); }
  size_t entries() const { return static_cast<size_t>(std::distance(std::filesystem::directory_iterator(path_), {})); }

 private:
  std::filesystem::path path_;
};

// Every node of a forest of the given depth.
template <class F>
void forEachNode(const PatchDomain& d, int depth, F&& f) {
  for (uint32_t patch = 0; patch < d.patchCount(); ++patch)
    for (int l = 0; l <= depth; ++l)
      for (uint32_t y = 0; y < (1u << l); ++y)
        for (uint32_t x = 0; x < (1u << l); ++x) {
          NodeId n{patch, static_cast<uint32_t>(l), x, y};
          if (d.nodeExists(n)) f(n);
        }
}

}  // namespace relievo::testing_support
