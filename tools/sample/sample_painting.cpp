// An oil painting with thick paint: cypresses, hills and a field of wheat under a turning sky, in some thousands of
// brush strokes that lie over one another. 400 mm on the shorter side; paint up to 1.5 mm; a panel bowed by 1 mm; fine
// craquelure.
//
// Strokes are not stored: a layer is a lattice of cells, a stroke a cell, made from the cell's hash when a block needs
// it. A later stroke replaces what lies under it (h = h (1 - a) + stroke a), so where one covers a block wholly (a = 1
// exactly) all earlier ones are left out, without a change of a bit.
#include <array>
#include <numbers>

#include "src/base/simd_dispatch.h"
#include "tools/sample/sample_kinds.h"

namespace relievo::sample {
namespace {

constexpr double kPaintingShortMm = 400;
constexpr float kBowMm = 1.0f, kCrackMm = 0.05f, kPaintMm = 1.5f, kGroundMm = 0.06f;
constexpr int kBristles = 4096;  // samples of the brush's profile, periodic
constexpr float kSamplesPerMm = 64;

struct Rgb {
  double r, g, b;
};
Rgb blend(const Rgb& a, const Rgb& b, double t) {
  return {a.r + (b.r - a.r) * t, a.g + (b.g - a.g) * t, a.b + (b.b - a.b) * t};
}
double step(double a, double b, double x) {
  double t = std::clamp((x - a) / (b - a), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

// What the painter saw at a place, and how the brush went there.
struct Motif {
  Rgb colour{};
  double angle = 0;      // of the stroke, radians
  double thickness = 1;  // of the paint, relative
  double size = 1;       // of the stroke, relative
};

struct BrushLayer {
  double cell_mm, length_mm, width_mm, share;
  float paint_mm;
};
constexpr BrushLayer kLayers[] = {
    {13, 44, 12, 1.0, 0.22f}, {8, 27, 6.4, 1.0, 0.42f}, {5.0, 17, 3.9, 1.0, 0.62f}, {4.0, 12, 2.5, 0.75, 0.80f}};
constexpr double kLongest = 1.35;  // of a stroke's length and width, relative to its layer's

struct Stroke {
  double x, y;  // centre
  double c, s;  // direction
  double half_length, half_width, bend_mm;
  Rgb light, dark;  // two pigments, not quite mixed
  float paint_mm;
  uint32_t order, hash;
};

class Painting final : public Kind {
 public:
  explicit Painting(const SampleOptions& o)
      : seed_(mix32(static_cast<uint32_t>(o.seed) * 40503u + static_cast<uint32_t>(o.seed >> 32) + 3)) {
    short_mm = kPaintingShortMm;
    const double mm = kPaintingShortMm / static_cast<double>(std::min(o.width, o.height));
    width_ = static_cast<double>(o.width) * mm, height_ = static_cast<double>(o.height) * mm;
    min_mm = -kCrackMm - kGroundMm - 0.08f;
    max_mm = kBowMm + kPaintMm + kGroundMm + 0.08f;
    gloss_strength = 0.22f;
    // The brush: hairs of a third of a millimetre and finer, in bundles.
    auto wave = [&](double cell, uint32_t salt, double at) {
      double n = kBristles / cell, g = at / cell;
      auto i = static_cast<int>(std::floor(g));
      double t = g - i;
      t = t * t * (3 - 2 * t);
      auto value = [&](int k) { return unit(hash2(k % static_cast<int>(n), 7, seed_ + salt)); };
      return value(i) * (1 - t) + value(i + 1) * t;
    };
    bristle_.resize(kBristles);
    auto sample = [&](int i) {
      double at = i % kBristles;
      return static_cast<uint32_t>(
          65535 * (0.34 * wave(64, 1, at) + 0.33 * wave(32, 2, at) + 0.21 * wave(16, 3, at) + 0.12 * wave(8, 4, at)));
    };
    for (int i = 0; i < kBristles; ++i) bristle_[static_cast<size_t>(i)] = sample(i) | sample(i + 1) << 16;
  }

  void eval(const Block& b, bool colour, Layers& out) const override {
    Plane &h = out.height, &paint = out.tmp[0], &wet = out.tmp[1];
    // The ground: a thin warm wash over a sized panel.
    fill(b, paint, 0);
    addFbm(b, paint, 3, 0.03f, 0.6f, 5, seed_ + 1);
    if (colour)
      forPixels(b, [&](int i, int, int) { out.red[i] = 150, out.green[i] = 112, out.blue[i] = 74, wet[i] = 0.3f; });
    layStrokes(b, colour, out, paint, wet);

    // The panel's bow, dust and the grain of the paint.
    Plane& grain = out.tmp[2];
    fill(b, grain, 0);
    addFbm(b, grain, 2.4, 0.028f, 0.55f, 8, seed_ + 2);
    const auto inv_w = 2.0 / width_, inv_h = 2.0 / height_;
    alignas(64) float bow_x[kBlockPx];
    for (int x = 0; x < kBlockPx; ++x) {
      double u = std::min(1.0, std::abs((b.left_mm + x * b.mm) * inv_w - 1.0));
      bow_x[x] = static_cast<float>(0.5 * kBowMm * (1 - u * u));
    }
    for (int y = b.y0; y < b.y1; ++y) {
      double v = std::min(1.0, std::abs((b.top_mm + y * b.mm) * inv_h - 1.0));
      const auto bow_y = static_cast<float>(0.5 * kBowMm * (1 - v * v));
      const int row = y * kBlockPx, x1 = b.x1;
#pragma GCC ivdep
      for (int x = b.x0; x < x1; ++x) h[row + x] = paint[row + x] + grain[row + x] + (bow_x[x] + bow_y);
    }
    const bool cracked = craquelure(b, out, out.tmp[3]);
    if (cracked) forPixels(b, [&](int i, int, int) { h[i] -= kCrackMm * out.tmp[3][i]; });
    if (!colour) return;
    // Varnish, yellowed unevenly.
    Plane& varnish = out.tmp[4];
    fill(b, varnish, 0);
    addFbm(b, varnish, 140, 0.5f, 0.5f, 3, seed_ + 3);
    forPixels(b, [&](int i, int, int) {
      float g = 1.0f + grain[i] * 1.2f;
      float y = 0.03f + 0.04f * varnish[i];
      out.red[i] = out.red[i] * g * (1.0f - 0.4f * y);
      out.green[i] = out.green[i] * g * (1.0f - 0.8f * y);
      out.blue[i] = out.blue[i] * g * (1.0f - 2.2f * y);
      out.cavity[i] = 0.90f + 0.10f * clamp01(wet[i]);
      out.gloss[i] = clamp01(0.55f + 0.35f * varnish[i] + 0.2f * wet[i]);
    });
    if (cracked)
      forPixels(b, [&](int i, int, int) {
        float c = out.tmp[3][i], k = 1.0f - 0.62f * c;
        out.red[i] *= k, out.green[i] *= k, out.blue[i] *= k;
        out.cavity[i] *= 1.0f - 0.35f * c;
      });
  }

 private:
  uint32_t seed_;
  double width_, height_;
  std::vector<uint32_t> bristle_;  // two neighbouring samples in 16 bits each: one load fetches both

  double noise(double x, double y, double cell, uint32_t salt) const { return noiseAt(x, y, cell, seed_ + 100 + salt); }

  Motif motif(double x_mm, double y_mm) const {
    const double k = std::max(1.0, std::min(width_, height_));
    const double x = x_mm / width_, y = y_mm / height_;       // place in the picture
    const double X = x_mm / k, Y = y_mm / k, W = width_ / k;  // lengths, shorter side 1
    const double n1 = noise(x_mm, y_mm, 70, 1), n2 = noise(x_mm, y_mm, 26, 2);
    Motif m;
    // Sky: the air turns around the sun and in two eddies.
    const double sun_x = 0.70 * W, sun_y = 0.215 * height_ / k;
    const double dx = X - sun_x, dy = Y - sun_y, d = std::hypot(dx, dy);
    auto eddy = [&](double ex, double ey, double r, double& vx, double& vy, double turn) {
      double ax = X - ex, ay = Y - ey, q = std::exp(-(ax * ax + ay * ay) / (r * r));
      vx += -ay / r * q * turn, vy += ax / r * q * turn;
    };
    double vx = 0.42, vy = 0.13 * std::sin(9 * X + 2 * n1) + 0.22 * n1;
    eddy(sun_x, sun_y, 0.17, vx, vy, 3.2);
    eddy(0.36 * W, 0.20 * height_ / k, 0.12, vx, vy, -2.8);
    eddy(0.52 * W, 0.37 * height_ / k, 0.085, vx, vy, 2.2);
    m.angle = std::atan2(vy, vx);
    m.colour = blend({38, 72, 148}, {118, 170, 196}, step(0.02, 0.46, y + 0.12 * n1));
    m.colour = blend(m.colour, {222, 218, 178}, step(0.36, 0.60, y + 0.05 * n2));
    double cloud = step(0.08, 0.42, noise(x_mm, y_mm * 1.9, 90, 3) + 0.35 * n2);
    m.colour = blend(m.colour, {232, 230, 218}, 0.75 * cloud * step(0.05, 0.2, d));
    double ring = 0.5 + 0.5 * std::cos(d * 62 + n1);
    m.colour = blend(m.colour, ring > 0.5 ? Rgb{250, 226, 130} : Rgb{196, 206, 170}, 0.85 * (1 - step(0.06, 0.24, d)));
    m.thickness = 0.75 + 0.25 * cloud;
    if (d < 0.068) {
      m.colour = blend({255, 244, 190}, {252, 190, 52}, step(0.015, 0.066, d));
      m.thickness = 1.25, m.size = 0.7;
    }
    // Far hills, one behind the other.
    double far = 0.555 + 0.030 * std::sin(7.3 * x + 0.6) + 0.018 * std::sin(17 * x + 2);
    double mid = 0.620 + 0.026 * std::sin(5.1 * x + 2.4) + 0.012 * std::sin(15 * x);
    double near = 0.690 + 0.022 * std::sin(4.2 * x + 4.2);
    if (y > far) {
      m = {};
      m.colour = blend({92, 112, 168}, {132, 152, 176}, step(0, 0.08, y - far + 0.03 * n2));
      m.angle = 0.35 * std::cos(7.3 * x + 0.6) + 0.3 * n1, m.thickness = 0.6;
    }
    if (y > mid) {
      m = {};
      bool grove = noise(x_mm, y_mm * 1.6, 30, 5) > 0.10;
      m.colour = grove ? blend({44, 84, 62}, {96, 128, 76}, 0.5 + n2) : blend({122, 150, 92}, {176, 176, 96}, 0.5 + n1);
      m.angle = grove ? 6.283 * noise(x_mm, y_mm, 18, 6) : 0.25 * n1 + 0.12, m.thickness = grove ? 0.95 : 0.6;
      m.size = grove ? 0.75 : 1;
    }
    // The wheat: bent by the wind, in bands of light, with poppies in front.
    if (y > near) {
      m = {};
      double depth = (y - near) / (1.0 - near);
      double wind = std::sin(11 * X + 5 * Y + 2.5 * n1);
      m.colour = blend({206, 156, 52}, {244, 206, 98}, 0.5 + 0.5 * wind);
      m.colour = blend(m.colour, {150, 128, 52}, 0.55 * step(0.05, 0.5, n2));
      m.colour = blend(m.colour, {122, 84, 36}, 0.45 * depth * step(-0.2, 0.5, n1));
      m.angle = std::numbers::pi / 2 + 0.38 + 0.34 * wind, m.thickness = 0.85 + 0.3 * depth;
      m.size = 0.7 + 0.45 * depth;
      // A path winds towards the hills.
      double path = 0.60 + 0.16 * std::sin(3.4 * (1 - depth) + 0.4) - 0.12 * (1 - depth), half = 0.012 + 0.075 * depth;
      if (std::abs(x - path) < half) {
        m.colour = blend({214, 190, 160}, {170, 140, 128}, 0.5 + n2), m.angle = 0.25 * n1 - 0.05, m.thickness = 0.7,
        m.size = 0.8;
      }
    }
    // Cypresses: flames from the field into the sky.
    auto cypress = [&](double cx, double top, double foot, double w) {
      double t = (y - top) / (foot - top);
      if (t < 0 || t > 1) return;
      double sway = 0.012 * std::sin(9 * t + cx * 20),
             half = w * std::pow(std::sin(std::numbers::pi * std::pow(t, 0.62) * 0.93 + 0.05), 0.8);
      half *= 1 + 0.35 * n2;
      double off = X - cx * W - sway;
      if (std::abs(off) > half) return;
      double side = off / std::max(half, 1e-6);
      m = {};
      m.colour = blend({22, 52, 42}, {64, 104, 58}, step(-0.3, 0.9, side + 0.8 * n2));
      m.colour = blend(m.colour, {112, 110, 46}, 0.6 * step(0.35, 0.9, side + n2));
      m.angle = -std::numbers::pi / 2 + 0.55 * side * (1 - 0.6 * t) + 0.5 * n2, m.thickness = 1.05, m.size = 0.78;
    };
    cypress(0.275, 0.36, 0.80, 0.030);
    cypress(0.175, 0.085, 0.90, 0.060);
    return m;
  }

  Stroke make(const BrushLayer& layer, uint32_t index, int32_t cx, int32_t cy) const {
    Stroke s{};
    s.hash = hash2(cx, cy, seed_ + 7 * index + 1000);
    auto dice = [&](uint32_t i) { return unit(mix32(s.hash + i * 0x9E3779B9u)); };
    s.order = mix32(s.hash + 99);
    if (dice(0) >= layer.share) {
      s.half_length = 0;
      return s;
    }
    s.x = (cx + dice(1)) * layer.cell_mm, s.y = (cy + dice(2)) * layer.cell_mm;
    Motif m = motif(s.x, s.y);
    double size = m.size * (0.82 + 0.36 * dice(3));
    size = std::min(size, kLongest);
    double angle = m.angle + (dice(4) - 0.5) * 0.5;
    s.c = std::cos(angle), s.s = std::sin(angle);
    s.half_length = 0.5 * layer.length_mm * size, s.half_width = 0.5 * layer.width_mm * size;
    s.bend_mm = (dice(5) - 0.5) * 0.30 * s.half_length;
    double tone = (dice(6) - 0.5) * (14 + 14.0 * index), warm = (dice(7) - 0.5) * (8 + 8.0 * index);
    Rgb c{m.colour.r + tone + warm, m.colour.g + tone, m.colour.b + tone - warm};
    // Poppies: single dabs of the finest brush in the near field.
    if (index == 3 && s.y > 0.80 * height_ && dice(8) < 0.085) {
      c = {206, 48, 34};
      s.half_length *= 0.45;
      m.thickness = 1.25;
    }
    s.light = {c.r + 18, c.g + 18, c.b + 15}, s.dark = {c.r - 20, c.g - 21, c.b - 17};
    s.paint_mm = static_cast<float>(layer.paint_mm * std::min(1.25, m.thickness) * (0.8 + 0.2 * dice(9)));
    return s;
  }

  // Neighbouring blocks need the same strokes: the ones made last are kept, one a place in a small table.
  struct Memo {
    struct Entry {
      int64_t key = -1;
      Stroke stroke;
    };
    std::vector<Entry> entries{kEntries};
    std::vector<Stroke> layer, stack;
    std::vector<const Stroke*> chosen;
    static constexpr size_t kEntries = 1024;
    const Stroke& find(const Painting& p, const BrushLayer& l, uint32_t index, int32_t x, int32_t y) {
      int64_t key = (int64_t{index} << 58) | (int64_t{x & 0x1fffffff} << 29) | (y & 0x1fffffff);
      Entry& e = entries[(static_cast<uint32_t>(x) * 19 + static_cast<uint32_t>(y) * 353 + index * 97) % kEntries];
      if (e.key != key) e.stroke = p.make(l, index, x, y), e.key = key;
      return e.stroke;
    }
  };

  void layStrokes(const Block& b, bool colour, Layers& out, Plane& paint, Plane& wet) const {
    if (!out.memo) out.memo = std::make_shared<Memo>();
    Memo& memo = *static_cast<Memo*>(out.memo.get());
    std::vector<Stroke>&strokes = memo.stack, &layer_strokes = memo.layer;
    strokes.clear();
    const double x0 = b.left_mm, x1 = b.left_mm + b.size_mm, y0 = b.top_mm, y1 = b.top_mm + b.size_mm;
    const double cx = b.centreX(), cy = b.centreY(), radius = b.radius() + 1e-6;
    // Newest layer first: once a stroke covers the block, nothing under it is needed.
    bool covered = false;
    uint32_t index = static_cast<uint32_t>(std::size(kLayers));
    while (index-- > 0 && !covered) {
      const BrushLayer& layer = kLayers[index];
      if (layer.width_mm < 1.5 * b.mm) continue;
      const double half_l = 0.5 * kLongest * layer.length_mm,
                   reach = half_l + 0.5 * kLongest * layer.width_mm + 0.15 * half_l;
      auto cell = [&](double v) { return static_cast<int32_t>(std::floor(v / layer.cell_mm)); };
      layer_strokes.clear();
      for (int32_t gy = cell(y0 - reach); gy <= cell(y1 + reach); ++gy)
        for (int32_t gx = cell(x0 - reach); gx <= cell(x1 + reach); ++gx) {
          // Far from the block whatever its direction?
          double nx = std::clamp(cx, gx * layer.cell_mm, (gx + 1) * layer.cell_mm) - cx;
          double ny = std::clamp(cy, gy * layer.cell_mm, (gy + 1) * layer.cell_mm) - cy;
          if (nx * nx + ny * ny > (reach + radius) * (reach + radius)) continue;
          const Stroke& s = memo.find(*this, layer, index, gx, gy);
          if (s.half_length == 0) continue;
          double px = cx - s.x, py = cy - s.y, along = px * s.c + py * s.s, across = py * s.c - px * s.s;
          if (std::abs(along) > s.half_length + radius ||
              std::abs(across) > s.half_width + std::abs(s.bend_mm) + radius)
            continue;
          layer_strokes.push_back(s);
        }
      std::sort(layer_strokes.begin(), layer_strokes.end(), [](const Stroke& p, const Stroke& q) {
        return p.order != q.order ? p.order > q.order
                                  : (p.hash != q.hash ? p.hash > q.hash : (p.y != q.y ? p.y > q.y : p.x > q.x));
      });
      for (const Stroke& s : layer_strokes) {
        strokes.push_back(s);
        if (covers(s, cx, cy, radius)) {
          covered = true;
          break;
        }
      }
    }
    // By quarters (where a block is several millimetres wide, the fewer strokes the smaller the place).
    constexpr int kQuarter = kBlockPx / 2;
    for (int qy = 0; qy < kBlockPx; qy += kQuarter)
      for (int qx = 0; qx < kBlockPx; qx += kQuarter) {
        const Range range{std::max(b.x0, qx), std::min(b.x1, qx + kQuarter), std::max(b.y0, qy),
                          std::min(b.y1, qy + kQuarter)};
        if (range.x0 >= range.x1 || range.y0 >= range.y1) continue;
        const double half = 0.5 * (kQuarter - 1) * b.mm, mx = b.left_mm + qx * b.mm + half,
                     my = b.top_mm + qy * b.mm + half;
        const double r = half * std::numbers::sqrt2 * 1.001 + 1e-6;
        memo.chosen.clear();
        for (const Stroke& s : strokes) {
          double px = mx - s.x, py = my - s.y, along = px * s.c + py * s.s, across = py * s.c - px * s.s;
          if (std::abs(along) > s.half_length + r || std::abs(across) > s.half_width + std::abs(s.bend_mm) + r)
            continue;
          memo.chosen.push_back(&s);
          if (covers(s, mx, my, r)) break;
        }
        for (size_t i = memo.chosen.size(); i-- > 0;) lay(*memo.chosen[i], b, range, colour, out, paint, wet);
      }
  }

  struct Range {
    int x0, x1, y0, y1;
  };

  static constexpr float kEdge = 3.2f;  // opacity rises over the outer third of the half-width
  static constexpr float kEnd = 6.0f;   // and over the last sixth of the length, from where the hairs lift

  // Is it opaque (alpha exactly 1) everywhere within `radius` of a place?
  static bool covers(const Stroke& s, double x, double y, double radius) {
    double px = x - s.x, py = y - s.y, r = radius * 1.01 + 1e-4;
    double along = px * s.c + py * s.s, across = py * s.c - px * s.s;
    double a = std::abs(along) + r;
    if (a > 0.5 * s.half_length) return false;  // 1 - 0.3 (hairs lift) - 1/6 (fading) > 0.5
    double q = a / s.half_length;
    double bend_lo = along * along > r * r ? (std::abs(along) - r) / s.half_length : 0.0;
    double middle_lo = s.bend_mm * bend_lo * bend_lo, middle_hi = s.bend_mm * q * q;
    double off = std::max(std::abs(across - middle_lo), std::abs(across - middle_hi)) + r;
    double half = s.half_width * (1 - 0.35 * q * q * q * q);
    return off < half * (1 - 1.0 / kEdge - 0.08);  // rim >= 1/kEdge whatever the hairs take from it
  }

  // A stroke as its rows are computed: in a block's coordinates.
  struct Brush {
    float ox, oy, c, s, inv_length, half_width, bend, thick;
    float first_hair, other_hair;  // where in the brush's profile its two hairs' profiles begin
    const uint32_t* hairs;
  };
  Brush brushOf(const Stroke& s, const Block& b) const {
    return {static_cast<float>(s.x - b.left_mm),
            static_cast<float>(s.y - b.top_mm),
            static_cast<float>(s.c),
            static_cast<float>(s.s),
            static_cast<float>(1.0 / s.half_length),
            static_cast<float>(s.half_width),
            static_cast<float>(s.bend_mm),
            s.paint_mm,
            static_cast<float>(1024 + (s.hash & 1023)),
            static_cast<float>(1024 + (s.hash >> 10 & 1023)),
            bristle_.data()};
  }

  // The columns of a row where the stroke can be: between its ends and between its sides. Elsewhere alpha is exactly 0.
  static std::pair<int, int> columns(const Stroke& s, const Brush& brush, const Block& b, const Range& range,
                                     float py) {
    const double reach_l = s.half_length * 1.001, reach_w = (s.half_width + std::abs(s.bend_mm)) * 1.001;
    double lo = -1e9, hi = 1e9;
    auto between = [&](double k, double offset, double reach) {  // |k x + offset| <= reach
      if (std::abs(k) < 1e-6) return;
      double a = (-reach - offset) / k, z = (reach - offset) / k;
      lo = std::max(lo, std::min(a, z)), hi = std::min(hi, std::max(a, z));
    };
    between(s.c, double{py} * s.s, reach_l);
    between(-s.s, double{py} * s.c, reach_w);
    if (lo > hi) return {0, 0};
    const double inv_mm = 1.0 / b.mm, ox = brush.ox;
    return {std::max(range.x0, static_cast<int>(std::clamp((lo + ox) * inv_mm - 1.0, 0.0, 64.0)) & ~7),
            std::min(range.x1, (static_cast<int>(std::clamp((hi + ox) * inv_mm + 2.0, 0.0, 64.0)) + 7) & ~7)};
  }

  // Of a row's columns [x0, x1): how opaque the paint is, how high, and which of the two pigments it is.
  static void drag(const Brush& brush, const float* xs, float py, int x0, int x1, float* alpha, float* level,
                   float* mixture) {
#pragma GCC ivdep
    for (int x = x0; x < x1; ++x) {
      float px = xs[x] - brush.ox;
      float q = (px * brush.c + py * brush.s) * brush.inv_length;  // -1 .. 1 along
      float q2 = q * q;
      float t = py * brush.c - px * brush.s - brush.bend * q2;  // mm across
      float limit = q2 < 1.21f ? q2 : 1.21f;
      float half = brush.half_width * (1.0f - 0.35f * limit * limit);
      float at = t < 0 ? -t : t;
      float rim = 1.0f - at / half;  // 0 at the border, 1 in the middle
      // Two hairs' profiles, the second taking over along the stroke, so that ridges come and go.
      float p = (t < -20.0f ? -20.0f : (t > 20.0f ? 20.0f : t)) * kSamplesPerMm;
      float p0 = p + brush.first_hair + 512.0f, p1 = p * 0.83f + brush.other_hair + 512.0f;
      // Positive: where a hair begins and 512 more than outweigh p.
      const int n0 = static_cast<int>(p0), n1 = static_cast<int>(p1);
      int i0 = n0 & (kBristles - 1), i1 = n1 & (kBristles - 1);
      float f0 = p0 - static_cast<float>(n0), f1 = p1 - static_cast<float>(n1);
      const auto pair0 = static_cast<int32_t>(brush.hairs[i0]), pair1 = static_cast<int32_t>(brush.hairs[i1]);
      float a0 = static_cast<float>(pair0 & 0xffff), b0 = static_cast<float>(pair0 >> 16 & 0xffff);
      float a1 = static_cast<float>(pair1 & 0xffff), b1 = static_cast<float>(pair1 >> 16 & 0xffff);
      float h0 = a0 + (b0 - a0) * f0, h1 = a1 + (b1 - a1) * f1;
      float blend01 = clamp01(0.5f + 0.7f * q);
      float hair = (h0 + (h1 - h0) * blend01) * (1.0f / 65535.0f);
      float aq = q < 0 ? -q : q;
      float end = 1.0f - 0.3f * hair - aq;  // the hairs lift one by one
      alpha[x] = clamp01((rim + 0.14f * hair - 0.07f) * kEdge) * clamp01(end * kEnd);
      // Pushed aside at the rim, heaped where the brush was set down, thin where it lifted.
      float ridge = clamp01(rim * 4.0f) * clamp01(1.9f - rim * 3.0f);
      float load = 0.76f - 0.22f * q + 0.2f * clamp01(-q * 3.0f - 1.6f);
      float belly = clamp01(rim * 1.6f);
      level[x] = brush.thick * load * (0.30f + 0.60f * hair + 0.16f * ridge + 0.14f * belly * (2.0f - belly));
      mixture[x] = hair * 1.5f - 0.25f;
    }
  }

  RELIEVO_SIMD_CLONES void lay(const Stroke& s, const Block& b, const Range& range, bool colour, Layers& out,
                               Plane& paint, Plane& wet) const noexcept {
    const Brush brush = brushOf(s, b);
    const auto lr = static_cast<float>(s.light.r), lg = static_cast<float>(s.light.g),
               lb = static_cast<float>(s.light.b);
    const auto dr = static_cast<float>(s.dark.r), dg = static_cast<float>(s.dark.g), db = static_cast<float>(s.dark.b);
    alignas(64) float alpha[kBlockPx], level[kBlockPx], mixture[kBlockPx];
    for (int y = range.y0; y < range.y1; ++y) {
      const float py = b.x_mm[y] - brush.oy;
      const auto [x0, x1] = columns(s, brush, b, range, py);
      if (x0 >= x1) continue;
      drag(brush, b.x_mm, py, x0, x1, alpha, level, mixture);
      const int row = y * kBlockPx;
      float* to = paint.v + row;
#pragma GCC ivdep
      for (int x = x0; x < x1; ++x) to[x] = to[x] * (1.0f - alpha[x]) + level[x] * alpha[x];
      if (!colour) continue;
      float *r = out.red.v + row, *g = out.green.v + row, *bl = out.blue.v + row, *w = wet.v + row;
#pragma GCC ivdep
      for (int x = x0; x < x1; ++x) {
        float a = alpha[x], m = mixture[x], n = 1.0f - a;
        r[x] = r[x] * n + (dr + (lr - dr) * m) * a;
        g[x] = g[x] * n + (dg + (lg - dg) * m) * a;
        bl[x] = bl[x] * n + (db + (lb - db) * m) * a;
        w[x] = w[x] * n + m * a;
      }
    }
  }

  static constexpr double kCell = 9.0, kWarpCell = 7.0;
  static constexpr float kHalfWidth = 0.085f, kWarp = 1.3f, kWarpGain = 0.48f;
  static constexpr int kWarpOctaves = 6;

  std::pair<double, double> site(int32_t gx, int32_t gy) const {
    uint32_t k = hash2(gx, gy, seed_ + 51);
    return {(gx + 0.15 + 0.7 * unit(k)) * kCell, (gy + 0.15 + 0.7 * unit(mix32(k + 1))) * kCell};
  }

  // Can a crack cross the block at all? From its centre's place, and how far the warp can carry the others from it: a
  // B-spline of values in [-a, a] on cells of c has slopes of at most 2 a / c a direction.
  bool crackNear(const Block& b) const {
    double x = b.centreX(), y = b.centreY(), cell = kWarpCell, a = kWarp, slope = 1.0;
    for (int o = 0; o < kWarpOctaves; ++o) {
      if (cell < 3.0 * b.mm) return true;  // this octave fades with size: not what noiseAt says
      x += a * noiseAt(b.centreX(), b.centreY(), cell, seed_ + 31 + static_cast<uint32_t>(o) * 0x51ED27u);
      y += a * noiseAt(b.centreX(), b.centreY(), cell, seed_ + 41 + static_cast<uint32_t>(o) * 0x51ED27u);
      slope += 2.0 * std::numbers::sqrt2 * a / cell;
      cell *= 0.53, a *= kWarpGain;
    }
    const double away = slope * std::numbers::sqrt2 * b.radius() + 1e-3;
    const auto cx = static_cast<int32_t>(std::floor(x / kCell)), cy = static_cast<int32_t>(std::floor(y / kCell));
    double first = 1e18, second = 1e18;
    for (int32_t gy = cy - 2; gy <= cy + 2; ++gy)
      for (int32_t gx = cx - 2; gx <= cx + 2; ++gx) {
        auto [sx, sy] = site(gx, gy);
        double d = std::hypot(sx - x, sy - y);
        if (d < first) second = first, first = d;
        else if (d < second) second = d;
      }
    return second - first <= 2 * away + 2 * kHalfWidth;
  }

  // Cracks run where two cells of a jittered lattice meet; places are moved by noise first. 0..1 into `crack`.
  RELIEVO_SIMD_CLONES bool craquelure(const Block& b, Layers& out, Plane& crack) const noexcept {
    if (kHalfWidth * 4 < b.mm) return false;
    if (!crackNear(b)) return false;
    Plane &wx = out.tmp[5], &wy = out.tmp[6], &second = out.tmp[7];
    fill(b, wx, 0);
    fill(b, wy, 0);
    addFbm(b, wx, kWarpCell, kWarp, kWarpGain, kWarpOctaves, seed_ + 31);
    addFbm(b, wy, kWarpCell, kWarp, kWarpGain, kWarpOctaves, seed_ + 41);
    float lo_x = 1e9f, hi_x = -1e9f, lo_y = 1e9f, hi_y = -1e9f;
    for (int y = b.y0; y < b.y1; ++y)
      for (int x = b.x0; x < b.x1; ++x) {
        int i = y * kBlockPx + x;
        wx[i] += b.x_mm[x], wy[i] += b.x_mm[y];
        lo_x = std::min(lo_x, wx[i]), hi_x = std::max(hi_x, wx[i]), lo_y = std::min(lo_y, wy[i]),
        hi_y = std::max(hi_y, wy[i]);
      }
    struct Site {
      double x, y, nearest, farthest;
    };
    Site sites[1024];
    int count = 0;
    double least_far = 1e18;
    auto cell = [&](double v) { return static_cast<int32_t>(std::floor(v / kCell)); };
    for (int32_t gy = cell(b.top_mm + lo_y) - 2; gy <= cell(b.top_mm + hi_y) + 2; ++gy)
      for (int32_t gx = cell(b.left_mm + lo_x) - 2; gx <= cell(b.left_mm + hi_x) + 2 && count < 1024; ++gx) {
        auto [site_x, site_y] = site(gx, gy);
        Site s{site_x - b.left_mm, site_y - b.top_mm, 0, 0};
        double nx = std::clamp(s.x, double{lo_x}, double{hi_x}) - s.x,
               ny = std::clamp(s.y, double{lo_y}, double{hi_y}) - s.y;
        double fx = std::max(std::abs(s.x - lo_x), std::abs(s.x - hi_x)),
               fy = std::max(std::abs(s.y - lo_y), std::abs(s.y - hi_y));
        s.nearest = std::hypot(nx, ny), s.farthest = std::hypot(fx, fy);
        least_far = std::min(least_far, s.farthest);
        sites[count++] = s;
      }
    // A site matters where it can come within a crack's width of being the nearest.
    int kept = 0;
    for (int k = 0; k < count; ++k)
      if (sites[k].nearest <= least_far + 2.5 * kHalfWidth + 1e-4) sites[kept++] = sites[k];
    if (kept < 2) return false;
    fill(b, crack, 1e6f);
    fill(b, second, 1e6f);
    for (int k = 0; k < kept; ++k) {
      const auto sx = static_cast<float>(sites[k].x), sy = static_cast<float>(sites[k].y);
      forPixels(b, [&](int i, int, int) {
        float dx = wx[i] - sx, dy = wy[i] - sy, d = std::sqrt(dx * dx + dy * dy);
        float near = crack[i] < d ? crack[i] : d, far = crack[i] < d ? d : crack[i];
        second[i] = second[i] < far ? second[i] : far;
        crack[i] = near;
      });
    }
    forPixels(b, [&](int i, int, int) {
      float t = clamp01(1.0f - (second[i] - crack[i]) * (0.5f / kHalfWidth));
      crack[i] = t * t * (3.0f - 2.0f * t);
    });
    return true;
  }
};

}  // namespace

std::unique_ptr<Kind> makePainting(const SampleOptions& options) { return std::make_unique<Painting>(options); }

}  // namespace relievo::sample
