#include "tools/sample/sample_artwork.h"

#include <cassert>
#include <cmath>

#include "src/base/simd_dispatch.h"
#include "tools/sample/sample_kinds.h"
#include "tools/sample/sample_shading.h"

// Vectors are passed between inlined functions of this file only, so that how they are passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace relievo {

using sample::Block;
using sample::kBlockPx;
using sample::Layers;

struct SampleArtwork::Impl {
  SampleOptions options;
  std::unique_ptr<sample::Kind> kind;
  double mm = 1;

  // visit(block, layers, colour wanted) for every block that meets the rectangle, cut to it. `core` is where colour is
  // wanted.
  template <class F>
  void forBlocks(const Rect& rect, const Rect* core, F visit) const {
    auto layers = std::make_unique<Layers>();
    const int64_t x1 = rect.x + rect.width, y1 = rect.y + rect.height;
    for (int64_t by = rect.y / kBlockPx * kBlockPx; by < y1; by += kBlockPx)
      for (int64_t bx = rect.x / kBlockPx * kBlockPx; bx < x1; bx += kBlockPx) {
        auto cut = [](int64_t v) { return static_cast<int>(std::clamp<int64_t>(v, 0, kBlockPx)); };
        Block b(bx, by, cut(rect.x - bx), cut(x1 - bx), cut(rect.y - by), cut(y1 - by), mm);
        bool colour = core && core->x < bx + kBlockPx && core->x + core->width > bx && core->y < by + kBlockPx &&
                      core->y + core->height > by;
        kind->eval(b, colour, *layers);
        visit(b, *layers, colour);
      }
  }

  // The wanted pixels of a block's row: x in [first, last) relative to the block, cut to the rectangle.
  static std::pair<int, int> columns(const Block& b, const Rect& r) {
    return {static_cast<int>(std::max<int64_t>(b.x0, r.x - b.px)),
            static_cast<int>(std::min<int64_t>(b.x1, r.x + r.width - b.px))};
  }

  // Heights with a border of one pixel all around (repeated at the artwork's border): (width + 2) * (height + 2).
  struct Tile {
    Rect rect;
    std::vector<float> heights, cavity, gloss;
    std::vector<uint8_t> rgb;  // planar: r, g, b
    std::vector<float> inv_dx,
        inv_dy;  // 1 / distance of the two samples that a slope is taken from; 0 where there is one
    const float* row(int64_t y) const { return heights.data() + (y + 1) * (rect.width + 2) + 1; }  // y in [-1, height]
  };
  void evalTile(const Rect& rect, bool colour, Tile& t) const;
};

namespace {

inline uint8_t toByte(float v) {
  v = v < 0.0f ? 0.0f : (v > 255.0f ? 255.0f : v);
  return static_cast<uint8_t>(static_cast<int>(v + 0.5f));
}

std::vector<float> inverseSteps(int64_t first, int64_t count, int64_t size, double mm) {
  std::vector<float> out(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i) {
    int64_t lo = std::max<int64_t>(first + i - 1, 0), hi = std::min(first + i + 1, size - 1);
    out[static_cast<size_t>(i)] = hi > lo ? static_cast<float>(1.0 / (static_cast<double>(hi - lo) * mm)) : 0.0f;
  }
  return out;
}

// Rectangles are worked through in tiles of this size, to stay within the caches.
constexpr int64_t kTilePx = 512;

template <class F>
void forTiles(const Rect& rect, F f) {
  const int64_t x1 = rect.x + rect.width, y1 = rect.y + rect.height;
  for (int64_t y = rect.y; y < y1;) {
    int64_t ny = std::min(y1, (y / kTilePx + 1) * kTilePx);
    for (int64_t x = rect.x; x < x1;) {
      int64_t nx = std::min(x1, (x / kTilePx + 1) * kTilePx);
      f(Rect{x, y, nx - x, ny - y});
      x = nx;
    }
    y = ny;
  }
}

}  // namespace

void SampleArtwork::Impl::evalTile(const Rect& rect, bool colour, Tile& t) const {
  t.rect = rect;
  const int64_t w = rect.width + 2, h = rect.height + 2;
  t.heights.resize(static_cast<size_t>(w * h));
  const auto area = static_cast<size_t>(rect.width * rect.height);
  if (colour) {
    t.cavity.resize(area);
    t.gloss.resize(area);
    t.rgb.resize(area * 3);
  }
  t.inv_dx = inverseSteps(rect.x, rect.width, options.width, mm);
  t.inv_dy = inverseSteps(rect.y, rect.height, options.height, mm);
  Rect outer{std::max<int64_t>(rect.x - 1, 0), std::max<int64_t>(rect.y - 1, 0), 0, 0};
  outer.width = std::min(rect.x + rect.width + 1, options.width) - outer.x;
  outer.height = std::min(rect.y + rect.height + 1, options.height) - outer.y;
  float* at = t.heights.data();
  forBlocks(outer, colour ? &rect : nullptr, [&](const Block& b, const Layers& l, bool coloured) {
    auto [x0, x1] = columns(b, outer);
    for (int y = b.y0; y < b.y1; ++y) {
      float* to = at + (b.py + y - rect.y + 1) * w + (b.px - rect.x + 1);
      std::copy(l.height.v + y * kBlockPx + x0, l.height.v + y * kBlockPx + x1, to + x0);
    }
    if (!coloured) return;
    auto [c0, c1] = columns(b, rect);
    for (int y = b.y0; y < b.y1; ++y) {
      int64_t row = b.py + y - rect.y;
      if (row < 0 || row >= rect.height) continue;
      const int64_t to = row * rect.width + (b.px - rect.x);
      const int from = y * kBlockPx;
      uint8_t *r = t.rgb.data() + to, *g = r + area, *bl = g + area;
      float *cavity = t.cavity.data() + to, *gloss = t.gloss.data() + to;
#pragma GCC ivdep
      for (int x = c0; x < c1; ++x)
        r[x] = toByte(l.red[from + x]), g[x] = toByte(l.green[from + x]), bl[x] = toByte(l.blue[from + x]);
#pragma GCC ivdep
      for (int x = c0; x < c1; ++x) cavity[x] = l.cavity[from + x], gloss[x] = l.gloss[from + x];
    }
  });
  // Beyond the artwork: its border again.
  if (rect.x == 0)
    for (int64_t y = 0; y < h; ++y) at[y * w] = at[y * w + 1];
  if (rect.x + rect.width == options.width)
    for (int64_t y = 0; y < h; ++y) at[y * w + w - 1] = at[y * w + w - 2];
  if (rect.y == 0) std::copy(at + w, at + 2 * w, at);
  if (rect.y + rect.height == options.height) std::copy(at + (h - 2) * w, at + (h - 1) * w, at + (h - 1) * w);
}

SampleArtwork::SampleArtwork(const SampleOptions& options) : impl_(std::make_unique<Impl>()) {
  assert(options.width > 0 && options.height > 0);
  impl_->options = options;
  impl_->kind = options.kind == SampleKind::kInscription ? sample::makeInscription(options)
                : options.kind == SampleKind::kCoin      ? sample::makeCoin(options)
                                                         : sample::makePainting(options);
  impl_->mm = impl_->kind->short_mm / static_cast<double>(std::min(options.width, options.height));
}
SampleArtwork::~SampleArtwork() = default;
const SampleOptions& SampleArtwork::options() const { return impl_->options; }
double SampleArtwork::mmPerPx() const { return impl_->mm; }
double SampleArtwork::minMm() const { return impl_->kind->min_mm; }
double SampleArtwork::maxMm() const { return impl_->kind->max_mm; }
double SampleArtwork::glossStrength() const { return impl_->kind->gloss_strength; }

void SampleArtwork::heights(const Rect& rect, std::span<float> out) const {
  assert(out.size() >= static_cast<size_t>(rect.width * rect.height));
  impl_->forBlocks(rect, nullptr, [&](const Block& b, const Layers& l, bool) {
    auto [x0, x1] = Impl::columns(b, rect);
    for (int y = b.y0; y < b.y1; ++y)
      std::copy(l.height.v + y * kBlockPx + x0, l.height.v + y * kBlockPx + x1,
                out.data() + (b.py + y - rect.y) * rect.width + (b.px - rect.x) + x0);
  });
}

void SampleArtwork::albedo(const Rect& rect, std::span<uint8_t> out) const {
  assert(out.size() >= static_cast<size_t>(rect.width * rect.height * 3));
  impl_->forBlocks(rect, &rect, [&](const Block& b, const Layers& l, bool) {
    auto [x0, x1] = Impl::columns(b, rect);
    for (int y = b.y0; y < b.y1; ++y) {
      uint8_t* to = out.data() + 3 * ((b.py + y - rect.y) * rect.width + (b.px - rect.x));
      for (int x = x0; x < x1; ++x) {
        to[3 * x] = toByte(l.red[y * kBlockPx + x]);
        to[3 * x + 1] = toByte(l.green[y * kBlockPx + x]);
        to[3 * x + 2] = toByte(l.blue[y * kBlockPx + x]);
      }
    }
  });
}

void SampleArtwork::normals(const Rect& rect, std::span<float> out) const {
  assert(out.size() >= static_cast<size_t>(rect.width * rect.height * 3));
  Impl::Tile t;
  forTiles(rect, [&](const Rect& part) {
    impl_->evalTile(part, false, t);
    for (int64_t y = 0; y < part.height; ++y) {
      const float *up = t.row(y - 1), *mid = t.row(y), *down = t.row(y + 1);
      float* to = out.data() + 3 * ((part.y + y - rect.y) * rect.width + part.x - rect.x);
      const float inv_dy = t.inv_dy[static_cast<size_t>(y)];
      for (int64_t x = 0; x < part.width; ++x) {
        float sx = (mid[x + 1] - mid[x - 1]) * t.inv_dx[static_cast<size_t>(x)], sy = (down[x] - up[x]) * inv_dy;
        float inv = 1.0f / std::sqrt(1.0f + sx * sx + sy * sy);
        to[3 * x] = -sx * inv, to[3 * x + 1] = sy * inv, to[3 * x + 2] = inv;
      }
    }
  });
}

void SampleArtwork::material(const Rect& rect, std::span<float> cavity, std::span<float> gloss) const {
  impl_->forBlocks(rect, &rect, [&](const Block& b, const Layers& l, bool) {
    auto [x0, x1] = Impl::columns(b, rect);
    for (int y = b.y0; y < b.y1; ++y) {
      const int64_t to = (b.py + y - rect.y) * rect.width + (b.px - rect.x);
      std::copy(l.cavity.v + y * kBlockPx + x0, l.cavity.v + y * kBlockPx + x1, cavity.data() + to + x0);
      std::copy(l.gloss.v + y * kBlockPx + x0, l.gloss.v + y * kBlockPx + x1, gloss.data() + to + x0);
    }
  });
}

namespace {

class SampleSource {
 public:
  explicit SampleSource(const SampleArtwork& a) : artwork(a) {}
  const SampleArtwork& artwork;
  Provenance where() const {
    const SampleOptions& o = artwork.options();
    std::string name = std::string(sampleKindName(o.kind)) + " seed " + std::to_string(o.seed);
    return {.name = name, .xxh3 = "", .generator = "relievo sample"};
  }
};

class ColourSource final : public TextureSource, SampleSource {
 public:
  using SampleSource::SampleSource;
  int64_t width() const override { return artwork.options().width; }
  int64_t height() const override { return artwork.options().height; }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return where(); }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    const auto area = static_cast<size_t>(rect.width * rect.height);
    std::vector<uint8_t> rgb(area * 3);
    artwork.albedo(rect, rgb);
    for (size_t i = 0; i < area; ++i)
      out[i] = rgb[3 * i], out[area + i] = rgb[3 * i + 1], out[2 * area + i] = rgb[3 * i + 2];
    return {};
  }
};

class ReliefSource final : public HeightSource, SampleSource {
 public:
  using SampleSource::SampleSource;
  int64_t width() const override { return artwork.options().width; }
  int64_t height() const override { return artwork.options().height; }
  double minMm() const override { return artwork.minMm(); }
  double maxMm() const override { return artwork.maxMm(); }
  Provenance provenance() const override { return where(); }
  Result<void> read(const Rect& rect, std::span<float> out) const override {
    artwork.heights(rect, out);
    return {};
  }
};

// One step a coefficient for the whole artwork, from the range that the shading can reach at all: nothing clips.
TextureFormat ptmFormat(Basis basis) {
  TextureFormat f;
  f.basis = basis;
  const auto& table = sample::shadingTable();
  for (size_t k = 0; k < 6; ++k) {
    // A hundredth more on both sides: between the table's normals the fit reaches a little further.
    const double more = 0.01 * (table.highest[k] - table.lowest[k]);
    double lo = table.lowest[k] - more, hi = table.highest[k] + more;
    // LRGB scales by the cavity, RGB by cavity and albedo.
    double least = basis == Basis::kPtmLrgb ? sample::kMinCavity : 0.0;
    lo = std::min(lo, lo * least), hi = std::max(hi, hi * least);
    f.scale[k] = std::ceil((hi - lo) / 254.0 * 1e4) / 1e4;  // four decimals, so that a text header holds it
    f.bias[k] = std::clamp(std::ceil(-lo / f.scale[k]), 0.0, 255.0);
  }
  return f;
}

using Vec8 [[gnu::vector_size(32)]] = float;
using Int8 [[gnu::vector_size(32)]] = int32_t;
using Byte8 [[gnu::vector_size(8)]] = uint8_t;

}  // namespace

class SamplePtmSource final : public TextureSource, SampleSource {
 public:
  SamplePtmSource(const SampleArtwork& a, const SampleArtwork::Impl& impl, Basis basis)
      : SampleSource(a), impl_(impl), format_(ptmFormat(basis)) {}
  int64_t width() const override { return artwork.options().width; }
  int64_t height() const override { return artwork.options().height; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return where(); }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    SampleArtwork::Impl::Tile t;
    ShadedRow row;
    forTiles(rect, [&](const Rect& part) {
      impl_.evalTile(part, true, t);
      row.resize(static_cast<size_t>(t.rect.width));
      if (format_.basis == Basis::kPtmLrgb) shade<false>(t, rect, row, out.data());
      else shade<true>(t, rect, row, out.data());
    });
    return {};
  }

 private:
  const SampleArtwork::Impl& impl_;
  TextureFormat format_;

  // Of each texel of a row: where its normal lies in the shading table, and its coefficients.
  struct ShadedRow {
    std::vector<float> fx, fy;
    std::vector<int32_t> entry;
    std::vector<uint8_t> bytes;
    void resize(size_t width) {
      for (auto* values : {&fx, &fy}) values->resize(width);
      entry.resize(width);
      bytes.resize(width * 8 * 3);
    }
  };

  template <bool kRgb>
  RELIEVO_SIMD_CLONES void shade(const SampleArtwork::Impl::Tile& t, const Rect& rect, ShadedRow& shaded,
                                 uint8_t* out) const noexcept {
    using sample::ShadingTable;
    const float* table = sample::shadingTable().data;
    const auto tile_area = static_cast<size_t>(t.rect.width * t.rect.height),
               area = static_cast<size_t>(rect.width * rect.height);
    const auto w = static_cast<size_t>(t.rect.width);
    Vec8 step{}, half{};
    for (int k = 0; k < 6; ++k) {
      step[k] = static_cast<float>(1.0 / format_.scale[static_cast<size_t>(k)]);
      half[k] = static_cast<float>(format_.bias[static_cast<size_t>(k)]) + 0.5f;
    }
    const float strength = impl_.kind->gloss_strength;
    const bool metal = impl_.kind->metal;
    uint8_t* bytes = shaded.bytes.data();
    for (int64_t y = 0; y < t.rect.height; ++y) {
      const float *up = t.row(y - 1), *mid = t.row(y), *down = t.row(y + 1);
      const float inv_dy = t.inv_dy[static_cast<size_t>(y)];
      const float* inv_dx = t.inv_dx.data();
      float *fxs = shaded.fx.data(), *fys = shaded.fy.data();
      int32_t* entries = shaded.entry.data();
      const int n = static_cast<int>(w);
#pragma GCC ivdep
      for (int x = 0; x < n; ++x) {
        float sx = (mid[x + 1] - mid[x - 1]) * inv_dx[x], sy = (down[x] - up[x]) * inv_dy;
        float inv = ShadingTable::kHalf / std::sqrt(1.0f + sx * sx + sy * sy);
        float gx = ShadingTable::kHalf - sx * inv, gy = ShadingTable::kHalf + sy * inv;  // 0 .. 64
        int ix = static_cast<int>(gx), iy = static_cast<int>(gy);
        ix = ix > ShadingTable::kSide - 2 ? ShadingTable::kSide - 2 : ix;
        iy = iy > ShadingTable::kSide - 2 ? ShadingTable::kSide - 2 : iy;
        fxs[x] = gx - static_cast<float>(ix);
        fys[x] = gy - static_cast<float>(iy);
        entries[x] = (iy * ShadingTable::kSide + ix) * 16;
      }
      const size_t from = static_cast<size_t>(y) * w;
      const float *cavity = t.cavity.data() + from, *gloss = t.gloss.data() + from;
      const uint8_t* rgb[3] = {t.rgb.data() + from, t.rgb.data() + tile_area + from,
                               t.rgb.data() + 2 * tile_area + from};
      for (size_t x = 0; x < w; ++x) {
        auto load = [](const float* p) {
          Vec8 v;
          __builtin_memcpy(&v, __builtin_assume_aligned(p, 32), sizeof v);
          return v;
        };
        const float* e = table + entries[x];
        const float u = fxs[x], v = fys[x];
        const float w11 = u * v, w10 = u - w11, w01 = v - w11, w00 = 1.0f - u - v + w11;
        constexpr int kNext = 16, kDown = ShadingTable::kSide * 16;
        Vec8 d = load(e) * w00 + load(e + kNext) * w10 + load(e + kDown) * w01 + load(e + kDown + kNext) * w11;
        Vec8 s = load(e + 8) * w00 + load(e + kNext + 8) * w10 + load(e + kDown + 8) * w01 +
                 load(e + kDown + kNext + 8) * w11;
        const float sg = strength * gloss[x];
        auto put = [&](Vec8 a, size_t at) {
          Byte8 raw = __builtin_convertvector(__builtin_convertvector(a * step + half, Int8), Byte8);
          __builtin_memcpy(bytes + at, &raw, 8);
        };
        d *= cavity[x] * (1.0f - sg);
        s *= cavity[x] * sg;
        if constexpr (kRgb) {
          for (size_t c = 0; c < 3; ++c) {
            float colour = static_cast<float>(rgb[c][x]) * (1.0f / 255.0f);
            put(d * colour + s * (metal ? colour : 0.9f), (x * 3 + c) * 8);
          }
        } else {
          put(d + s, x * 8);
        }
      }
      uint8_t* to = out + (t.rect.y + y - rect.y) * rect.width + (t.rect.x - rect.x);
      if constexpr (kRgb) {
        for (size_t k = 0; k < 6; ++k)
          for (size_t c = 0; c < 3; ++c) {
            uint8_t* plane = to + (3 * k + c) * area;
            const uint8_t* p = bytes + c * 8 + k;
            for (size_t x = 0; x < w; ++x) plane[x] = p[x * 24];
          }
      } else {
        for (size_t k = 0; k < 6; ++k) {
          uint8_t* plane = to + k * area;
          const uint8_t* p = bytes + k;
          for (size_t x = 0; x < w; ++x) plane[x] = p[x * 8];
        }
        for (size_t c = 0; c < 3; ++c) std::copy(rgb[c], rgb[c] + w, to + (6 + c) * area);
      }
    }
  }
};

std::unique_ptr<TextureSource> SampleArtwork::ptmSource(Basis basis) const {
  if (basis == Basis::kColour) return colourSource();
  return std::make_unique<SamplePtmSource>(*this, *impl_, basis);
}
std::unique_ptr<TextureSource> SampleArtwork::colourSource() const { return std::make_unique<ColourSource>(*this); }
std::unique_ptr<HeightSource> SampleArtwork::heightSource() const { return std::make_unique<ReliefSource>(*this); }

Result<SampleKind> parseSampleKind(const std::string& name) {
  for (SampleKind kind : {SampleKind::kInscription, SampleKind::kCoin, SampleKind::kPainting})
    if (name == sampleKindName(kind)) return kind;
  return Error{.kind = ErrorKind::kUsage,
               .message = "expected a kind of artwork, found '" + name + "'",
               .hint = "inscription, coin or painting"};
}

const char* sampleKindName(SampleKind kind) {
  return kind == SampleKind::kInscription ? "inscription" : kind == SampleKind::kCoin ? "coin" : "painting";
}

}  // namespace relievo
