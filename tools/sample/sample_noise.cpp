#include "tools/sample/sample_noise.h"

#include "src/base/simd_dispatch.h"

namespace relievo::sample {

Block::Block(int64_t anchor_x, int64_t anchor_y, int first_x, int last_x, int first_y, int last_y, double mm_per_px)
    : px(anchor_x), py(anchor_y), x0(first_x & ~7), x1((last_x + 7) & ~7), y0(first_y), y1(last_y), mm(mm_per_px) {
  left_mm = (static_cast<double>(px) + 0.5) * mm;
  top_mm = (static_cast<double>(py) + 0.5) * mm;
  size_mm = (kBlockPx - 1) * mm;
  for (int i = 0; i < kBlockPx; ++i) x_mm[i] = static_cast<float>(i * mm);
}

namespace {

struct LatticeAxis {
  double inv_cell, offset;
  LatticeAxis(double cell_mm, uint32_t seed) : inv_cell(1.0 / cell_mm), offset(16.0 + unit(mix32(seed))) {}
  double at(double mm) const { return mm * inv_cell + offset; }
};

inline float latticeValue(int32_t x, int32_t y, uint32_t seed) {
  return static_cast<float>(static_cast<int32_t>(hash2(x, y, seed))) * (1.0f / 2147483648.0f);
}

}  // namespace

RELIEVO_SIMD_CLONES void addNoise(const Block& b, Plane& plane, double cell_x_mm, double cell_y_mm, float amplitude,
                                  uint32_t seed) noexcept {
  const double finest_px = std::min(cell_x_mm, cell_y_mm) / b.mm;
  if (finest_px <= 2.0) return;
  if (finest_px < 3.0) amplitude *= static_cast<float>(finest_px - 2.0);

  // Rows of the lattice are spread over the pixels' columns first; then a pixel costs three products.
  constexpr int kMaxLattice = kBlockPx / 2 + 5;
  const LatticeAxis along_x(cell_x_mm, seed * 2 + 1), along_y(cell_y_mm, seed * 2 + 2);
  int column[kBlockPx];
  alignas(64) float w0[kBlockPx], w1[kBlockPx], w2[kBlockPx];
  const auto first_column = static_cast<int32_t>(along_x.at(b.left_mm + b.x0 * b.mm));
  int32_t last_column = first_column;
  for (int x = b.x0; x < b.x1; ++x) {
    double g = along_x.at(b.left_mm + x * b.mm);
    auto c = static_cast<int32_t>(g);
    auto t = static_cast<float>(g - c);
    column[x] = c - first_column;
    last_column = c;
    w0[x] = 0.5f * (1.0f - t) * (1.0f - t);
    w1[x] = 0.5f + t - t * t;
    w2[x] = 0.5f * t * t;
  }
  const int columns = last_column - first_column + 3;
  const auto first_row = static_cast<int32_t>(along_y.at(b.top_mm + b.y0 * b.mm));
  const auto last_row = static_cast<int32_t>(along_y.at(b.top_mm + (b.y1 - 1) * b.mm));
  alignas(64) float rows[kMaxLattice][kBlockPx];
  for (int32_t r = first_row; r <= last_row + 2; ++r) {
    float values[kMaxLattice + 8];
    for (int c = 0; c < columns; ++c) values[c] = amplitude * latticeValue(first_column + c, r, seed);
    float* out = rows[r - first_row];
    for (int x = b.x0; x < b.x1; ++x) {
      const float* p = values + column[x];
      out[x] = w0[x] * p[0] + w1[x] * p[1] + w2[x] * p[2];
    }
  }
  for (int y = b.y0; y < b.y1; ++y) {
    double g = along_y.at(b.top_mm + y * b.mm);
    auto r = static_cast<int32_t>(g);
    auto t = static_cast<float>(g - r);
    const float v0 = 0.5f * (1.0f - t) * (1.0f - t), v1 = 0.5f + t - t * t, v2 = 0.5f * t * t;
    const float *r0 = rows[r - first_row], *r1 = rows[r - first_row + 1], *r2 = rows[r - first_row + 2];
    float* out = plane.v + y * kBlockPx;
    const int x1 = b.x1;
#pragma GCC ivdep
    for (int x = b.x0; x < x1; ++x) out[x] += v0 * r0[x] + v1 * r1[x] + v2 * r2[x];
  }
}

void addFbm(const Block& b, Plane& plane, double cell_mm, float amplitude, float gain, int octaves, uint32_t seed) {
  for (int o = 0; o < octaves; ++o) {
    addNoise(b, plane, cell_mm, amplitude, seed + static_cast<uint32_t>(o) * 0x51ED27u);
    cell_mm *= 0.53;
    amplitude *= gain;
  }
}

double noiseAt(double x_mm, double y_mm, double cell_mm, uint32_t seed) {
  const LatticeAxis along_x(cell_mm, seed * 2 + 1), along_y(cell_mm, seed * 2 + 2);
  double gx = along_x.at(x_mm), gy = along_y.at(y_mm);
  double cx = std::floor(gx), cy = std::floor(gy);
  double sum = 0;
  auto weights = [](double t, double* w) {
    w[0] = 0.5 * (1 - t) * (1 - t);
    w[1] = 0.5 + t - t * t;
    w[2] = 0.5 * t * t;
  };
  double wx[3], wy[3];
  weights(gx - cx, wx);
  weights(gy - cy, wy);
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      sum += wx[i] * wy[j] * latticeValue(static_cast<int32_t>(cx) + i, static_cast<int32_t>(cy) + j, seed);
  return sum;
}

RELIEVO_SIMD_CLONES void addDents(const Block& b, Plane& plane, double cell_mm, float share, float depth_mm,
                                  uint32_t seed) noexcept {
  if (cell_mm * 0.25 < 0.8 * b.mm) return;
  const double x_lo = b.left_mm + b.x0 * b.mm, x_hi = b.left_mm + (b.x1 - 1) * b.mm;
  const double y_lo = b.top_mm + b.y0 * b.mm, y_hi = b.top_mm + (b.y1 - 1) * b.mm;
  const auto c0 = static_cast<int32_t>(std::floor(x_lo / cell_mm - 0.5)),
             c1 = static_cast<int32_t>(std::floor(x_hi / cell_mm + 0.5));
  const auto r0 = static_cast<int32_t>(std::floor(y_lo / cell_mm - 0.5)),
             r1 = static_cast<int32_t>(std::floor(y_hi / cell_mm + 0.5));
  for (int32_t r = r0; r <= r1; ++r)
    for (int32_t c = c0; c <= c1; ++c) {
      uint32_t h = hash2(c, r, seed);
      if (unit(h) >= share) continue;
      float a = unit(mix32(h + 1));
      double cx = (c + unit(mix32(h + 2))) * cell_mm, cy = (r + unit(mix32(h + 3))) * cell_mm;
      double radius = cell_mm * (0.25 + 0.25 * a * a);
      double stretch = 0.7 + 0.6 * unit(mix32(h + 4));  // of y; at most 1 after the bound below
      double ry = radius * std::min(1.0, stretch);
      if (cx + radius < x_lo || cx - radius > x_hi || cy + ry < y_lo || cy - ry > y_hi) continue;
      const auto ox = static_cast<float>(cx - b.left_mm), oy = static_cast<float>(cy - b.top_mm);
      const auto ix = static_cast<float>(1.0 / radius), iy = static_cast<float>(1.0 / ry);
      const float depth = depth_mm * (0.3f + 0.7f * unit(mix32(h + 5)));
      int ya = std::max(b.y0, static_cast<int>(std::floor((cy - ry - b.top_mm) / b.mm)));
      int yb = std::min(b.y1, static_cast<int>(std::ceil((cy + ry - b.top_mm) / b.mm)) + 1);
      int xa = std::max(b.x0, static_cast<int>(std::floor((cx - radius - b.left_mm) / b.mm)) & ~7);
      int xb = std::min(b.x1, static_cast<int>(std::ceil((cx + radius - b.left_mm) / b.mm)) + 1);
      for (int y = ya; y < yb; ++y) {
        float dy = (b.x_mm[y] - oy) * iy;
        float* out = plane.v + y * kBlockPx;
        for (int x = xa; x < xb; ++x) {
          float dx = (b.x_mm[x] - ox) * ix;
          float q = 1.0f - dx * dx - dy * dy;
          q = q > 0.0f ? q : 0.0f;
          out[x] -= depth * q * q;
        }
      }
    }
}

void BoxGrid::build(const std::vector<Box>& boxes) {
  boxes_ = boxes;
  bins_.assign(kBins * kBins, {});
  if (boxes.empty()) return;
  all_ = boxes[0];
  for (const Box& box : boxes) {
    all_.x0 = std::min(all_.x0, box.x0), all_.y0 = std::min(all_.y0, box.y0);
    all_.x1 = std::max(all_.x1, box.x1), all_.y1 = std::max(all_.y1, box.y1);
  }
  bin_w_ = std::max(1e-9, (all_.x1 - all_.x0) / kBins);
  bin_h_ = std::max(1e-9, (all_.y1 - all_.y0) / kBins);
  auto bin = [](double v, double lo, double w) { return std::clamp(static_cast<int>((v - lo) / w), 0, kBins - 1); };
  for (size_t i = 0; i < boxes.size(); ++i) {
    const Box& box = boxes[i];
    for (int y = bin(box.y0, all_.y0, bin_h_); y <= bin(box.y1, all_.y0, bin_h_); ++y)
      for (int x = bin(box.x0, all_.x0, bin_w_); x <= bin(box.x1, all_.x0, bin_w_); ++x)
        bins_[static_cast<size_t>(y * kBins + x)].push_back(static_cast<int>(i));
  }
}

void BoxGrid::candidates(const Box& q, std::vector<int>& out) const {
  out.clear();
  if (boxes_.empty() || q.x1 < all_.x0 || q.x0 > all_.x1 || q.y1 < all_.y0 || q.y0 > all_.y1) return;
  auto bin = [](double v, double lo, double w) {
    return static_cast<int>(std::clamp((v - lo) / w, 0.0, static_cast<double>(kBins - 1)));
  };
  const int x0 = bin(q.x0, all_.x0, bin_w_), x1 = bin(q.x1, all_.x0, bin_w_);
  const int y0 = bin(q.y0, all_.y0, bin_h_), y1 = bin(q.y1, all_.y0, bin_h_);
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x)
      for (int i : bins_[static_cast<size_t>(y * kBins + x)]) {
        const Box& box = boxes_[static_cast<size_t>(i)];
        if (box.x0 <= q.x1 && box.x1 >= q.x0 && box.y0 <= q.y1 && box.y1 >= q.y0) out.push_back(i);
      }
  if (x0 != x1 || y0 != y1) {
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
  }
}

void StrokeField::build(std::vector<Segment> segments, double reach_mm) {
  segments_ = std::move(segments);
  reach_ = reach_mm;
  std::vector<BoxGrid::Box> boxes;
  boxes.reserve(segments_.size());
  for (const Segment& s : segments_) {
    double r = std::max(s.ra, s.rb) + reach_;
    boxes.push_back(
        {std::min(s.ax, s.bx) - r, std::min(s.ay, s.by) - r, std::max(s.ax, s.bx) + r, std::max(s.ay, s.by) + r});
  }
  grid_.build(boxes);
}

double StrokeField::maxHalfWidth() const {
  double r = 0;
  for (const Segment& s : segments_) r = std::max({r, s.ra, s.rb});
  return r;
}

bool StrokeField::eval(const Block& b, Plane& sd, std::vector<int>& scratch) const {
  grid_.candidates({b.left_mm, b.top_mm, b.left_mm + b.size_mm, b.top_mm + b.size_mm}, scratch);
  if (scratch.empty()) return false;
  std::vector<double> upper_mm(scratch.size());
  return draw(b, sd, scratch, upper_mm);
}

RELIEVO_SIMD_CLONES bool StrokeField::draw(const Block& b, Plane& sd, std::span<const int> candidates,
                                           std::span<double> upper) const noexcept {
  // At the block's centre, +- what a pixel can lie away from it: who can't be the largest anywhere is left out.
  double floor_mm = -reach_;
  for (size_t k = 0; k < candidates.size(); ++k) {
    const Segment& s = segments_[static_cast<size_t>(candidates[k])];
    double ex = s.bx - s.ax, ey = s.by - s.ay, px = b.centreX() - s.ax, py = b.centreY() - s.ay;
    double len2 = ex * ex + ey * ey;
    double t = len2 > 0 ? std::clamp((px * ex + py * ey) / len2, 0.0, 1.0) : 0.0;
    double f = s.ra + t * (s.rb - s.ra) - std::hypot(px - t * ex, py - t * ey);
    double lipschitz = 1.0 + (len2 > 0 ? std::abs(s.rb - s.ra) / std::sqrt(len2) : 0.0);
    double away = lipschitz * b.radius() * 1.001 + 1e-6;
    upper[k] = f + away;
    floor_mm = std::max(floor_mm, f - away);
  }
  bool any = false;
  for (size_t k = 0; k < candidates.size(); ++k) {
    if (upper[k] < floor_mm) continue;
    if (!any) fill(b, sd, static_cast<float>(-reach_));
    any = true;
    const Segment& s = segments_[static_cast<size_t>(candidates[k])];
    const auto ax = static_cast<float>(s.ax - b.left_mm), ay = static_cast<float>(s.ay - b.top_mm);
    const auto ex = static_cast<float>(s.bx - s.ax), ey = static_cast<float>(s.by - s.ay);
    const double len2 = (s.bx - s.ax) * (s.bx - s.ax) + (s.by - s.ay) * (s.by - s.ay);
    const float inv = len2 > 0 ? static_cast<float>(1.0 / len2) : 0.0f;
    const auto ra = static_cast<float>(s.ra), dr = static_cast<float>(s.rb - s.ra);
    const float* xs = b.x_mm;
    for (int y = b.y0; y < b.y1; ++y) {
      const float py = b.x_mm[y] - ay;
      float* out = sd.v + y * kBlockPx;
      const int x1 = b.x1;
#pragma GCC ivdep
      for (int x = b.x0; x < x1; ++x) {
        float px = xs[x] - ax;
        float t = clamp01((px * ex + py * ey) * inv);
        float dx = px - t * ex, dy = py - t * ey;
        float f = ra + t * dr - std::sqrt(dx * dx + dy * dy);
        out[x] = out[x] > f ? out[x] : f;
      }
    }
  }
  return any;
}

}  // namespace relievo::sample
