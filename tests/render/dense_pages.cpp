#include "tests/render/dense_pages.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "texturing/codec/page_codec.h"
#include "texturing/codec/page_id.h"

namespace relievo {
namespace {

// Sample (i, j) of a page, in samples of the finest level; beyond the border the last one.
uint16_t reliefSample(const DenseRelief& r, const FlatDomain& d, const NodeId& node, int64_t i, int64_t j) {
  const int to_finest = d.relief_depth - static_cast<int>(node.level);
  auto place = [&](uint64_t origin_px, uint32_t n, int64_t k, int64_t extent) {
    const auto origin = static_cast<int64_t>(std::ldexp(static_cast<double>(origin_px), r.samples_per_texel_log2));
    return std::min(origin + ((int64_t{n} * kPagePx + k) << to_finest), extent - 1);
  };
  return r.samples[place(d.patchOriginY(node.patch), node.y, j, r.height) * r.width +
                   place(d.patchOriginX(node.patch), node.x, i, r.width)];
}

class DensePages final : public PageSource {
 public:
  DensePages(std::shared_ptr<const DenseTexture> texture, std::shared_ptr<const DenseRelief> relief)
      : texture_(std::move(texture)), relief_(std::move(relief)) {}

  Result<EncodedPage> read(PageId id) const override {
    const NodeId node = id.node();
    const FlatDomain& d = texture_->domain;
    const bool relief = id.plane() == Plane::kRelief;
    const int depth = relief ? d.relief_depth : d.texture_depth;
    const int plane = texturePlaneIndex(id.plane());
    const bool known = relief ? relief_ != nullptr : isTexturePlane(id.plane()) && plane < texture_->format.planes();
    if (!known || static_cast<int>(node.level) > depth || !d.nodeExists(node))
      return Error{ErrorKind::kInvalidData, "dense pages", "no such page", "", {}};
    PageEncoder encoder(1);
    std::span<const uint8_t> bytes;
    if (relief) {
      std::vector<uint16_t> samples(kReliefPageSamples);
      for (int j = 0; j < kReliefSamples; ++j)
        for (int i = 0; i < kReliefSamples; ++i)
          samples[j * kReliefSamples + i] = reliefSample(*relief_, d, node, i, j);
      bytes = encoder.encodeRelief(samples);
      return EncodedPage{{bytes.begin(), bytes.end()}};
    }
    const DenseLevel& level = texture_->levels[node.level];
    const int shift = d.texture_depth - static_cast<int>(node.level);
    const int64_t x0 =
        static_cast<int64_t>(d.patchOriginX(node.patch) >> shift) + int64_t{node.x} * kPagePx - kPageBorderPx;
    const int64_t y0 =
        static_cast<int64_t>(d.patchOriginY(node.patch) >> shift) + int64_t{node.y} * kPagePx - kPageBorderPx;
    std::vector<uint8_t> channels(kTexturePageBytes);
    for (int y = 0; y < kPageFullPx; ++y) {
      for (int x = 0; x < kPageFullPx; ++x) {
        const uint8_t* texel =
            level.texel(std::clamp<int64_t>(x0 + x, 0, level.width - 1),
                        std::clamp<int64_t>(y0 + y, 0, level.height - 1), texture_->format.channels());
        for (int c = 0; c < 3; ++c) channels[(c * kPageFullPx + y) * kPageFullPx + x] = texel[3 * plane + c];
      }
    }
    bytes = encoder.encodeTexture(channels);
    return EncodedPage{{bytes.begin(), bytes.end()}};
  }

 private:
  std::shared_ptr<const DenseTexture> texture_;
  std::shared_ptr<const DenseRelief> relief_;
};

class DenseBounds final : public ReliefOracle {
 public:
  DenseBounds(const DenseRelief& r, const FlatDomain& d) {
    whole_ = {static_cast<float>(r.offset_mm), static_cast<float>(r.offset_mm + 65535 * r.scale_mm),
              static_cast<float>(65535 * r.scale_mm)};
    for (int level = d.relief_depth; level >= 0; --level)
      for (uint32_t patch = 0; patch < d.patchCount(); ++patch)
        for (uint32_t y = 0; y < 1u << level; ++y)
          for (uint32_t x = 0; x < 1u << level; ++x) {
            const NodeId node{patch, static_cast<uint32_t>(level), x, y};
            if (d.nodeExists(node)) pages_[node] = measure(r, d, node);
          }
  }
  HeightBounds bounds(const NodeId& page) const override {
    auto found = pages_.find(page);
    return found == pages_.end() ? whole_ : found->second;
  }

 private:
  HeightBounds measure(const DenseRelief& r, const FlatDomain& d, const NodeId& node) const {
    const int s = d.relief_depth - static_cast<int>(node.level);
    const int64_t fine = int64_t{1} << s;
    const double step = std::ldexp(1.0, -s);
    double low = 65535, high = 0, error = 0;
    const NodeId deepest{node.patch, static_cast<uint32_t>(d.relief_depth), node.x << s, node.y << s};
    for (int j = 0; j < kPagePx; ++j) {
      for (int i = 0; i < kPagePx; ++i) {
        const double q00 = reliefSample(r, d, node, i, j), q10 = reliefSample(r, d, node, i + 1, j);
        const double q01 = reliefSample(r, d, node, i, j + 1), q11 = reliefSample(r, d, node, i + 1, j + 1);
        low = std::min({low, q00, q10, q01, q11});
        high = std::max({high, q00, q10, q01, q11});
        for (int64_t b = 0; s > 0 && b <= fine; ++b) {
          for (int64_t a = 0; a <= fine; ++a) {
            const double q = reliefSample(r, d, deepest, (int64_t{i} << s) + a, (int64_t{j} << s) + b);
            const double fx = static_cast<double>(a) * step, fy = static_cast<double>(b) * step;
            const double falling =
                fx >= fy ? q00 + fx * (q10 - q00) + fy * (q11 - q10) : q00 + fy * (q01 - q00) + fx * (q11 - q01);
            const double rising = fx + fy <= 1 ? q00 + fx * (q10 - q00) + fy * (q01 - q00)
                                               : q11 + (1 - fx) * (q01 - q11) + (1 - fy) * (q10 - q11);
            low = std::min(low, q);
            high = std::max(high, q);
            error = std::max({error, std::abs(q - falling), std::abs(q - rising)});
          }
        }
      }
    }
    HeightBounds out{static_cast<float>(r.offset_mm + low * r.scale_mm),
                     static_cast<float>(r.offset_mm + high * r.scale_mm), static_cast<float>(error * r.scale_mm)};
    for (uint32_t c = 0; s > 0 && c < 4; ++c) {
      auto child = pages_.find(node.child(c & 1, c >> 1));
      if (child != pages_.end()) out.error_mm = std::max(out.error_mm, child->second.error_mm);
    }
    return out;
  }

  HeightBounds whole_;
  std::unordered_map<NodeId, HeightBounds> pages_;
};

}  // namespace

std::shared_ptr<const PageSource> densePages(std::shared_ptr<const DenseTexture> texture,
                                             std::shared_ptr<const DenseRelief> relief) {
  return std::make_shared<DensePages>(std::move(texture), std::move(relief));
}

std::shared_ptr<const ReliefOracle> denseReliefBounds(const DenseRelief& relief, const FlatDomain& domain) {
  return std::make_shared<DenseBounds>(relief, domain);
}

}  // namespace relievo
