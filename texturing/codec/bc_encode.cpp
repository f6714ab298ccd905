// bc_encode.cpp - a block's texels lie near a line (or two) in the space of its channels: the principal axis gives the
// first ends, and the least squares of the indices so found give better ones, two or three times over. BC7's modes are
// tried in turn, as far as an estimate of what they leave over does not rule them out.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "src/base/simd_dispatch.h"
#include "texturing/codec/bc7_layout.h"
#include "texturing/codec/bc_blocks.h"

namespace relievo {
namespace {

constexpr int kRefinements = 3;

struct Point {
  float c[3];
};

// Largest eigenvalue's direction of the points' covariance, by power iteration; a zero covariance gives some direction.
Point principalAxis(const Point* points, int n, const Point& mean) {
  float xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  for (int i = 0; i < n; ++i) {
    float x = points[i].c[0] - mean.c[0], y = points[i].c[1] - mean.c[1], z = points[i].c[2] - mean.c[2];
    xx += x * x, xy += x * y, xz += x * z, yy += y * y, yz += y * z, zz += z * z;
  }
  // The column of the largest variance cannot be orthogonal to the axis.
  Point v = xx >= yy && xx >= zz ? Point{{xx, xy, xz}} : yy >= zz ? Point{{xy, yy, yz}} : Point{{xz, yz, zz}};
  for (int i = 0; i < 4; ++i) {
    Point w{{xx * v.c[0] + xy * v.c[1] + xz * v.c[2], xy * v.c[0] + yy * v.c[1] + yz * v.c[2],
             xz * v.c[0] + yz * v.c[1] + zz * v.c[2]}};
    float size = std::max({std::abs(w.c[0]), std::abs(w.c[1]), std::abs(w.c[2])});
    if (!(size > 0)) break;
    for (float& x : w.c) x /= size;
    v = w;
  }
  float length = std::sqrt(v.c[0] * v.c[0] + v.c[1] * v.c[1] + v.c[2] * v.c[2]);
  if (!(length > 0)) return {{1, 0, 0}};
  for (float& x : v.c) x /= length;
  return v;
}

struct Segment {
  Point a, b;
};

// From the extremes along the principal axis.
Segment firstSegment(const Point* points, int n) {
  Point mean{};
  for (int i = 0; i < n; ++i)
    for (int c = 0; c < 3; ++c) mean.c[c] += points[i].c[c];
  for (float& x : mean.c) x /= static_cast<float>(n);
  Point axis = principalAxis(points, n, mean);
  float low = 0, high = 0;
  for (int i = 0; i < n; ++i) {
    float t = 0;
    for (int c = 0; c < 3; ++c) t += (points[i].c[c] - mean.c[c]) * axis.c[c];
    low = std::min(low, t), high = std::max(high, t);
  }
  Segment s;
  for (int c = 0; c < 3; ++c) s.a.c[c] = mean.c[c] + low * axis.c[c], s.b.c[c] = mean.c[c] + high * axis.c[c];
  return s;
}

// Ends that fit best when point i lies at weight[i] (0 at a, 1 at b). False: the weights do not tell the ends apart.
bool leastSquares(const Point* points, const float* weight, int n, Segment* s) {
  float aa = 0, ab = 0, bb = 0;
  Point pa{}, pb{};
  for (int i = 0; i < n; ++i) {
    const float w = weight[i], v = 1 - w;
    aa += v * v, ab += v * w, bb += w * w;
    for (int c = 0; c < 3; ++c) pa.c[c] += v * points[i].c[c], pb.c[c] += w * points[i].c[c];
  }
  const float determinant = aa * bb - ab * ab;
  if (!(determinant > 1e-4f)) return false;
  for (int c = 0; c < 3; ++c) {
    s->a.c[c] = std::clamp((bb * pa.c[c] - ab * pb.c[c]) / determinant, 0.0f, 255.0f);
    s->b.c[c] = std::clamp((aa * pb.c[c] - ab * pa.c[c]) / determinant, 0.0f, 255.0f);
  }
  return true;
}

int rounded(float v) { return static_cast<int>(v + 0.5f); }

// ---- BC1 ----

struct Bc1Block {
  uint16_t c0 = 0, c1 = 0;
  uint32_t indices = 0;
  int error = std::numeric_limits<int>::max();
};

uint16_t to565(const Point& p) {
  return static_cast<uint16_t>(rounded(p.c[0] * 31 / 255) << 11 | rounded(p.c[1] * 63 / 255) << 5 |
                               rounded(p.c[2] * 31 / 255));
}

// The best indices for two ends; weight: where each texel then lies between c0 and c1.
Bc1Block bc1Indices(uint16_t c0, uint16_t c1, const uint8_t* texels, float* weight) {
  Bc1Block out;
  if (c0 < c1) std::swap(c0, c1);
  out.c0 = c0, out.c1 = c1, out.error = 0;
  uint8_t block[8], palette[64];
  // The palette as a decoder sees it: the indices 0 1 2 3 in the first row.
  const uint32_t order = 0xE4;
  std::memcpy(block, &c0, 2);
  std::memcpy(block + 2, &c1, 2);
  std::memcpy(block + 4, &order, 4);
  decodeBc1(block, palette, 16);
  const int entries = c0 == c1 ? 1 : 4;  // equal ends mean another palette: only their own colour is used
  static constexpr float kPlace[4] = {0, 1, 1.0f / 3, 2.0f / 3};
  for (uint32_t i = 0; i < 16; ++i) {
    int best = std::numeric_limits<int>::max();
    uint32_t index = 0;
    for (int k = 0; k < entries; ++k) {
      int e = 0;
      for (int c = 0; c < 3; ++c) {
        int d = texels[4 * i + c] - palette[4 * k + c];
        e += d * d;
      }
      if (e < best) best = e, index = static_cast<uint32_t>(k);
    }
    out.indices |= index << (2 * i);
    out.error += best;
    weight[i] = kPlace[index];
  }
  return out;
}

// ---- BC7 ----

enum class PBits { kNone, kEach, kShared };

// One subset: its ends as stored, with their p bits, and its texels' indices.
struct Line {
  std::array<std::array<uint8_t, 3>, 2> ends{};
  std::array<uint8_t, 2> p{};
  std::array<uint8_t, 16> indices{};
  int error = std::numeric_limits<int>::max();
};

int expand(int v, int bits) { return v << (8 - bits) | v >> (2 * bits - 8); }

struct NearestIndex {
  uint8_t of[3][65];  // by weight in 64ths, for 2, 3 and 4 bits
};
constexpr NearestIndex nearestIndices() {
  NearestIndex out{};
  for (int bits = 2; bits <= 4; ++bits) {
    for (int w = 0; w <= 64; ++w) {
      int best = 0;
      for (int k = 1; k < 1 << bits; ++k) {
        int d = bc7::weights(bits)[k] - w, e = bc7::weights(bits)[best] - w;
        if (d * d < e * e) best = k;
      }
      out.of[bits - 2][w] = static_cast<uint8_t>(best);
    }
  }
  return out;
}
constexpr NearestIndex kNearest = nearestIndices();

// An end at v as it can be stored: channel by channel the nearest value with that p bit.
struct End {
  std::array<uint8_t, 3> stored{};
  int value[3] = {};
  float error = 0;
};
End quantise(const Point& v, int channels, int bits, bool has_p, int p) {
  End out;
  for (int c = 0; c < channels; ++c) {
    if (has_p) {
      const float scaled = v.c[c] * static_cast<float>((2 << bits) - 1) / 255;
      const int stored = std::clamp(rounded((scaled - static_cast<float>(p)) / 2), 0, (1 << bits) - 1);
      out.stored[c] = static_cast<uint8_t>(stored);
      out.value[c] = expand(stored << 1 | p, bits + 1);
    } else {
      out.stored[c] = static_cast<uint8_t>(rounded(v.c[c] * static_cast<float>((1 << bits) - 1) / 255));
      out.value[c] = expand(out.stored[c], bits);
    }
    const float e = v.c[c] - static_cast<float>(out.value[c]);
    out.error += e * e;
  }
  return out;
}

// channels: how many of the three count (the rest are 0 and stay 0).
Line fitLine(const Point* points, int n, int channels, int bits, PBits p_bits, int index_bits) {
  const uint8_t* weights = bc7::weights(index_bits);
  const uint8_t* nearest = kNearest.of[index_bits - 2];
  const bool has_p = p_bits != PBits::kNone;
  Segment s = firstSegment(points, n);
  for (Point* p : {&s.a, &s.b})
    for (float& x : p->c) x = std::clamp(x, 0.0f, 255.0f);
  Line best;
  for (int round = 0; round < kRefinements; ++round) {
    // Of the p bits those that bring the ends nearest to where they should be.
    End a[2], b[2];
    for (int p = 0; p < (has_p ? 2 : 1); ++p)
      a[p] = quantise(s.a, channels, bits, has_p, p), b[p] = quantise(s.b, channels, bits, has_p, p);
    int pa = 0, pb = 0;
    if (p_bits == PBits::kEach) pa = a[1].error < a[0].error, pb = b[1].error < b[0].error;
    if (p_bits == PBits::kShared) pa = pb = a[1].error + b[1].error < a[0].error + b[0].error;
    const End &from = a[pa], &to = b[pb];
    Line line;
    line.ends = {from.stored, to.stored};
    line.p = {static_cast<uint8_t>(pa), static_cast<uint8_t>(pb)};
    float d[3], length2 = 0;
    for (int c = 0; c < 3; ++c) {
      d[c] = static_cast<float>(to.value[c] - from.value[c]);
      length2 += d[c] * d[c];
    }
    const float per_length2 = length2 > 0 ? 64 / length2 : 0;
    float palette[16][3];
    for (int k = 0; k < 1 << index_bits; ++k)
      for (int c = 0; c < 3; ++c)
        palette[k][c] = static_cast<float>(((64 - weights[k]) * from.value[c] + weights[k] * to.value[c] + 32) >> 6);
    float error = 0;
    for (int i = 0; i < n; ++i) {
      float t = 0;
      for (int c = 0; c < 3; ++c) t += (points[i].c[c] - static_cast<float>(from.value[c])) * d[c];
      const int k = nearest[rounded(std::clamp(t * per_length2, 0.0f, 64.0f))];
      line.indices[i] = static_cast<uint8_t>(k);
      for (int c = 0; c < 3; ++c) {
        const float e = points[i].c[c] - palette[k][c];
        error += e * e;
      }
    }
    line.error = static_cast<int>(error);  // of whole numbers, exactly
    if (line.error >= best.error) break;
    best = line;
    if (best.error == 0 || round + 1 == kRefinements) break;
    float weight[16];
    for (int i = 0; i < n; ++i) weight[i] = static_cast<float>(weights[best.indices[i]]) / 64;
    if (!leastSquares(points, weight, n, &s)) break;
  }
  return best;
}

// Bits from the lowest on.
struct BitWriter {
  uint8_t* out;
  int at = 0;
  void put(uint32_t v, int n) {
    for (int i = 0; i < n; ++i, ++at) out[at >> 3] = static_cast<uint8_t>(out[at >> 3] | (v >> i & 1) << (at & 7));
  }
};

// The anchor's index must not have its highest bit: then the line is turned round.
void anchor(Line* line, int place, int n, int index_bits) {
  if (!(line->indices[place] >> (index_bits - 1))) return;
  std::swap(line->ends[0], line->ends[1]);
  std::swap(line->p[0], line->p[1]);
  for (int i = 0; i < n; ++i) line->indices[i] = static_cast<uint8_t>((1 << index_bits) - 1 - line->indices[i]);
}

void splitPoints(const Point* points, int partition, Point (*subset)[16], uint8_t (*at)[16], int* n) {
  n[0] = n[1] = 0;
  for (int i = 0; i < 16; ++i) {
    const int s = bc7::kTwoSubsets[partition] >> i & 1;
    at[s][n[s]] = static_cast<uint8_t>(i);
    subset[s][n[s]++] = points[i];
  }
}

// What a line through each half would leave over: the covariance's trace without its largest eigenvalue, for every
// partition.
void partitionResiduals(const Point* points, float* residual) {
  Point mean{};
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 3; ++c) mean.c[c] += points[i].c[c] / 16;
  // Sums of x y z xx yy zz xy xz yz.
  float sums[16][9], total[9] = {};
  for (int i = 0; i < 16; ++i) {
    const float x = points[i].c[0] - mean.c[0], y = points[i].c[1] - mean.c[1], z = points[i].c[2] - mean.c[2];
    const float v[9] = {x, y, z, x * x, y * y, z * z, x * y, x * z, y * z};
    for (int k = 0; k < 9; ++k) sums[i][k] = v[k], total[k] += v[k];
  }
  for (int p = 0; p < 64; ++p) {
    float half[2][9] = {};
    int n = 0;
    for (int i = 0; i < 16; ++i) {
      const int in = bc7::kTwoSubsets[p] >> i & 1;
      n += in;
      const float f = static_cast<float>(in);
      for (int k = 0; k < 9; ++k) half[1][k] += f * sums[i][k];
    }
    for (int k = 0; k < 9; ++k) half[0][k] = total[k] - half[1][k];
    residual[p] = 0;
    for (int s = 0; s < 2; ++s) {
      const float* h = half[s];
      const float count = static_cast<float>(s ? n : 16 - n);
      const float xx = h[3] - h[0] * h[0] / count, yy = h[4] - h[1] * h[1] / count, zz = h[5] - h[2] * h[2] / count;
      const float xy = h[6] - h[0] * h[1] / count, xz = h[7] - h[0] * h[2] / count, yz = h[8] - h[1] * h[2] / count;
      Point v = xx >= yy && xx >= zz ? Point{{xx, xy, xz}} : yy >= zz ? Point{{xy, yy, yz}} : Point{{xz, yz, zz}};
      float eigenvalue = 0;
      for (int k = 0; k < 3; ++k) {
        const Point w{{xx * v.c[0] + xy * v.c[1] + xz * v.c[2], xy * v.c[0] + yy * v.c[1] + yz * v.c[2],
                       xz * v.c[0] + yz * v.c[1] + zz * v.c[2]}};
        const float vv = v.c[0] * v.c[0] + v.c[1] * v.c[1] + v.c[2] * v.c[2];
        if (!(vv > 0)) break;
        eigenvalue = (v.c[0] * w.c[0] + v.c[1] * w.c[1] + v.c[2] * w.c[2]) / vv;
        v = w;
        const float scale = 1 / (std::abs(v.c[0]) + std::abs(v.c[1]) + std::abs(v.c[2]) + 1e-20f);
        for (float& x : v.c) x *= scale;
      }
      residual[p] += std::max(0.0f, xx + yy + zz - eigenvalue);
    }
  }
}

void writeMode6(Line line, uint8_t* block) {
  anchor(&line, 0, 16, 4);
  std::memset(block, 0, 16);
  BitWriter w{block};
  w.put(1u << 6, 7);
  for (int c = 0; c < 3; ++c)
    for (int k = 0; k < 2; ++k) w.put(line.ends[k][c], 7);
  w.put(127, 7), w.put(127, 7);
  w.put(line.p[0], 1), w.put(line.p[1], 1);
  for (int i = 0; i < 16; ++i) w.put(line.indices[i], i == 0 ? 3 : 4);
}

// Modes 1 and 3.
void writeTwoSubsets(int mode, int partition, Line* lines, const uint8_t (*at)[16], const int* n, uint8_t* block) {
  const bc7::Mode& m = bc7::kModes[mode];
  std::array<uint8_t, 16> indices{};
  for (int s = 0; s < 2; ++s) {
    const int place = bc7::anchorOf(2, partition, s);
    anchor(&lines[s], static_cast<int>(std::find(at[s], at[s] + n[s], place) - at[s]), n[s], m.index_bits);
    for (int i = 0; i < n[s]; ++i) indices[at[s][i]] = lines[s].indices[i];
  }
  std::memset(block, 0, 16);
  BitWriter w{block};
  w.put(1u << mode, mode + 1);
  w.put(static_cast<uint32_t>(partition), 6);
  for (int c = 0; c < 3; ++c)
    for (int s = 0; s < 2; ++s)
      for (int k = 0; k < 2; ++k) w.put(lines[s].ends[k][c], m.colour_bits);
  for (int s = 0; s < 2; ++s) {
    w.put(lines[s].p[0], 1);
    if (m.endpoint_p) w.put(lines[s].p[1], 1);
  }
  for (int i = 0; i < 16; ++i) w.put(indices[i], m.index_bits - (i == 0 || i == bc7::anchorOf(2, partition, 1)));
}

// Modes 4 and 5: channel `apart` (0..2) in alpha's place, which goes where it was, as 255.
void writeApart(int mode, int apart, bool selection, Line pair, Line single, uint8_t* block) {
  const bc7::Mode& m = bc7::kModes[mode];
  const int pair_bits = selection ? m.index2_bits : m.index_bits,
            single_bits = selection ? m.index_bits : m.index2_bits;
  anchor(&pair, 0, 16, pair_bits);
  anchor(&single, 0, 16, single_bits);
  std::memset(block, 0, 16);
  BitWriter w{block};
  w.put(1u << mode, mode + 1);
  w.put(static_cast<uint32_t>(apart) + 1, 2);
  if (m.selection_bits) w.put(selection, 1);
  for (int c = 0, from = 0; c < 3; ++c) {
    const int channel = c == apart ? -1 : from++;
    for (int k = 0; k < 2; ++k) w.put(channel < 0 ? (1u << m.colour_bits) - 1 : pair.ends[k][channel], m.colour_bits);
  }
  for (int k = 0; k < 2; ++k) w.put(single.ends[k][0], m.alpha_bits);
  const Line &first = selection ? single : pair, &second = selection ? pair : single;
  for (int i = 0; i < 16; ++i) w.put(first.indices[i], m.index_bits - (i == 0));
  for (int i = 0; i < 16; ++i) w.put(second.indices[i], m.index2_bits - (i == 0));
}

}  // namespace

RELIEVO_SIMD_CLONES void encodeBc1(const uint8_t* texels, uint8_t* block) noexcept {
  Point points[16];
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 3; ++c) points[i].c[c] = texels[4 * i + c];
  Segment s = firstSegment(points, 16);
  for (Point* p : {&s.a, &s.b})
    for (float& x : p->c) x = std::clamp(x, 0.0f, 255.0f);
  Bc1Block best;
  for (int round = 0; round < kRefinements; ++round) {
    float weight[16];
    Bc1Block tried = bc1Indices(to565(s.a), to565(s.b), texels, weight);
    if (tried.error >= best.error) break;
    best = tried;
    if (!leastSquares(points, weight, 16, &s)) break;
  }
  std::memcpy(block, &best.c0, 2);
  std::memcpy(block + 2, &best.c1, 2);
  std::memcpy(block + 4, &best.indices, 4);
}

RELIEVO_SIMD_CLONES void encodeBc4(const uint8_t* values, uint8_t* block) noexcept {
  const int low = *std::min_element(values, values + 16), high = *std::max_element(values, values + 16);
  // Ends at the extremes bound the error by a fourteenth of their distance; least squares may only do better than that.
  int best_error = std::numeric_limits<int>::max();
  uint64_t best = 0;
  int ends[2] = {high, low};
  const int worst_allowed = (high - low) / 14 + 1;
  for (int round = 0; round < kRefinements; ++round) {
    uint64_t bits = static_cast<uint64_t>(ends[0]) | static_cast<uint64_t>(ends[1]) << 8;
    int error = 0, worst = 0;
    float aa = 0, ab = 0, bb = 0, pa = 0, pb = 0;
    const int range = ends[0] - ends[1];
    for (int i = 0; i < 16; ++i) {
      const int step = range ? std::clamp(((ends[0] - values[i]) * 14 + range) / (2 * range), 0, 7) : 0;
      const int value = ((7 - step) * ends[0] + step * ends[1] + 3) / 7, e = values[i] - value;
      error += e * e;
      worst = std::max(worst, std::abs(e));
      bits |= static_cast<uint64_t>(step == 0 ? 0 : step == 7 ? 1 : step + 1) << (16 + 3 * i);
      const float w = static_cast<float>(step) / 7, v = 1 - w;
      aa += v * v, ab += v * w, bb += w * w, pa += v * values[i], pb += w * values[i];
    }
    if (round > 0 && (error >= best_error || worst > worst_allowed)) break;
    best_error = error, best = bits;
    const float determinant = aa * bb - ab * ab;
    if (error == 0 || !(determinant > 1e-4f)) break;
    ends[0] = std::clamp(rounded((bb * pa - ab * pb) / determinant), 0, 255);
    ends[1] = std::clamp(rounded((aa * pb - ab * pa) / determinant), 0, 255);
    if (ends[0] <= ends[1]) break;
  }
  std::memcpy(block, &best, 8);
}

RELIEVO_SIMD_CLONES void encodeBc7(const uint8_t* texels, uint8_t* block) noexcept {
  Point points[16];
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 3; ++c) points[i].c[c] = texels[4 * i + c];
  Line whole = fitLine(points, 16, 3, 7, PBits::kEach, 4);
  writeMode6(whole, block);
  int best = whole.error;
  if (best <= 16) return;  // a third of a unit a channel: rounding

  float residual[64];
  partitionResiduals(points, residual);
  const int partition = static_cast<int>(std::min_element(residual, residual + 64) - residual);
  if (residual[partition] < static_cast<float>(best)) {
    Point subset[2][16];
    uint8_t at[2][16];
    int n[2];
    splitPoints(points, partition, subset, at, n);
    for (int mode : {1, 3}) {
      Line lines[2];
      int error = 0;
      for (int s = 0; s < 2; ++s) {
        lines[s] = fitLine(subset[s], n[s], 3, bc7::kModes[mode].colour_bits, mode == 1 ? PBits::kShared : PBits::kEach,
                           bc7::kModes[mode].index_bits);
        error += lines[s].error;
      }
      if (error >= best) continue;
      best = error;
      writeTwoSubsets(mode, partition, lines, at, n, block);
    }
  }

  // The channel that has least to do with the other two goes apart.
  int apart = 0;
  float least = std::numeric_limits<float>::max();
  for (int k = 0; k < 3; ++k) {
    const int a = k == 0, b = k == 2 ? 1 : 2;
    float ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
    for (const Point& p : points) ma += p.c[a] / 16, mb += p.c[b] / 16;
    for (const Point& p : points)
      aa += (p.c[a] - ma) * (p.c[a] - ma), bb += (p.c[b] - mb) * (p.c[b] - mb), ab += (p.c[a] - ma) * (p.c[b] - mb);
    const float smaller = (aa + bb - std::sqrt((aa - bb) * (aa - bb) + 4 * ab * ab)) / 2;
    if (smaller < least) least = smaller, apart = k;
  }
  if (least >= static_cast<float>(best)) return;
  Point pair[16] = {}, single[16] = {};
  for (int i = 0; i < 16; ++i) {
    pair[i] = {{points[i].c[apart == 0], points[i].c[apart == 2 ? 1 : 2], 0}};
    single[i] = {{points[i].c[apart], 0, 0}};
  }
  struct Variant {
    int mode;
    bool selection;
  };
  for (Variant v : {Variant{5, false}, {4, false}, {4, true}}) {
    const bc7::Mode& m = bc7::kModes[v.mode];
    Line a = fitLine(pair, 16, 2, m.colour_bits, PBits::kNone, v.selection ? m.index2_bits : m.index_bits);
    if (a.error >= best) continue;
    Line b = fitLine(single, 16, 1, m.alpha_bits, PBits::kNone, v.selection ? m.index_bits : m.index2_bits);
    if (a.error + b.error >= best) continue;
    best = a.error + b.error;
    writeApart(v.mode, apart, v.selection, a, b, block);
  }
}

}  // namespace relievo
