// sample_noise.h - the building stones of the procedural artworks: 64 x 64 pixel blocks at absolute places, lattice
// noise, tapered strokes, dents, and a grid that finds what touches a block.
//
// Seamlessness: a block lies at a multiple of kBlockPx, whatever rectangle was asked for; only the pixels wanted inside
// it are computed. Everything that a pixel depends on is a function of its block, and what is culled contributes
// exactly nothing, so a pixel has the same bits in every rectangle. Lengths in mm; x to the right, y down.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

namespace relievo::sample {

inline constexpr int kBlockPx = 64;
inline constexpr int kBlockArea = kBlockPx * kBlockPx;

struct Plane {
  alignas(64) float v[kBlockArea];
  float& operator[](int i) { return v[i]; }
  float operator[](int i) const { return v[i]; }
};

// The block of pixels [x0, x1) x [y0, y1) relative to its anchor; x0 and x1 are multiples of 8, for full vectors.
struct Block {
  Block(int64_t anchor_x, int64_t anchor_y, int first_x, int last_x, int first_y, int last_y, double mm_per_px);
  int64_t px, py;  // anchor
  int x0, x1, y0, y1;
  double mm;                         // per pixel
  double left_mm, top_mm;            // centre of the anchor pixel
  double size_mm;                    // centre to centre, first to last pixel of the whole block
  alignas(64) float x_mm[kBlockPx];  // pixel centres relative to the anchor's
  double centreX() const { return left_mm + 0.5 * size_mm; }
  double centreY() const { return top_mm + 0.5 * size_mm; }
  double radius() const { return 0.7072 * size_mm; }
};

// f(i, x, y) for every wanted pixel; i indexes planes.
template <class F>
inline __attribute__((always_inline)) void forPixels(const Block& b, F f) {
  for (int y = b.y0; y < b.y1; ++y) {
    const int row = y * kBlockPx, x1 = b.x1;
#pragma GCC ivdep
    for (int x = b.x0; x < x1; ++x) f(row + x, x, y);
  }
}

inline void fill(const Block& b, Plane& p, float value) {
  forPixels(b, [&](int i, int, int) { p[i] = value; });
}

inline uint32_t mix32(uint32_t h) {
  h ^= h >> 16;
  h *= 0x7feb352du;
  h ^= h >> 15;
  h *= 0x846ca68bu;
  h ^= h >> 16;
  return h;
}
inline uint32_t hash2(int32_t x, int32_t y, uint32_t seed) {
  return mix32(static_cast<uint32_t>(x) * 0x9E3779B1u ^ mix32(static_cast<uint32_t>(y) * 0x85EBCA77u + seed));
}
inline float unit(uint32_t h) { return static_cast<float>(h >> 8) * (1.0f / 16777216.0f); }  // [0, 1)
inline float clamp01(float t) { return t < 0.0f ? 0.0f : (t > 1.0f ? 1.0f : t); }
inline float smooth01(float t) {
  t = clamp01(t);
  return t * t * (3.0f - 2.0f * t);
}
inline float mixf(float a, float b, float t) { return a * (1.0f - t) + b * t; }

// A stream of numbers from a seed, for what is laid out once per artwork.
class Dice {
 public:
  explicit Dice(uint64_t seed) : state_(seed * 0x9E3779B97F4A7C15ull + 0x1234567) {}
  double operator()() {  // [0, 1)
    state_ += 0x9E3779B97F4A7C15ull;
    uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
  }
  double range(double a, double b) { return a + (b - a) * (*this)(); }

 private:
  uint64_t state_;
};

// plane += amplitude * n, |n| <= 1: a quadratic B-spline over hashed lattice values (C1, convex, hence bounded).
// A lattice finer than two pixels adds nothing: that is what a larger size has more of. From 2 to 3 pixels it fades in.
void addNoise(const Block& b, Plane& plane, double cell_x_mm, double cell_y_mm, float amplitude,
              uint32_t seed) noexcept;
inline void addNoise(const Block& b, Plane& plane, double cell_mm, float amplitude, uint32_t seed) {
  addNoise(b, plane, cell_mm, cell_mm, amplitude, seed);
}
// octaves of it: cells halve (by 0.53, so that lattices do not line up), amplitudes shrink by gain. Bound: fbmBound.
void addFbm(const Block& b, Plane& plane, double cell_mm, float amplitude, float gain, int octaves, uint32_t seed);
inline float fbmBound(float amplitude, float gain, int octaves) {
  float sum = 0;
  for (int o = 0; o < octaves; ++o, amplitude *= gain) sum += amplitude;
  return sum;
}
// The same noise at one point, in double (for what is laid out by it). Never fades.
double noiseAt(double x_mm, double y_mm, double cell_mm, uint32_t seed);

// Round dents (1 - d^2/r^2)^2, one at most per lattice cell, with the given share; radius in [0.25, 0.5] of the cell.
// plane -= depth, at most depth_mm. Where two cells' dents overlap they add up: at most 4 * depth_mm.
void addDents(const Block& b, Plane& plane, double cell_mm, float share, float depth_mm, uint32_t seed) noexcept;

// A stroke's piece: half-width ra at a, rb at b.
struct Segment {
  double ax, ay, bx, by, ra, rb;
};

// Boxes in bins; candidates(...) answers in ascending order, each once.
class BoxGrid {
 public:
  struct Box {
    double x0, y0, x1, y1;
  };
  void build(const std::vector<Box>& boxes);
  void candidates(const Box& query, std::vector<int>& out) const;

 private:
  static constexpr int kBins = 96;
  Box all_{};
  double bin_w_ = 1, bin_h_ = 1;
  std::vector<Box> boxes_;
  std::vector<std::vector<int>> bins_;
};

// sd = max(-reach, half-width - distance) over segments: positive inside a stroke.
class StrokeField {
 public:
  void build(std::vector<Segment> segments, double reach_mm);
  // false: nothing within reach, the plane is not touched.
  bool eval(const Block& b, Plane& sd, std::vector<int>& scratch) const;
  double maxHalfWidth() const;

 private:
  // Of the segments that may touch the block. upper_mm: room for a number of each.
  bool draw(const Block& b, Plane& sd, std::span<const int> candidates, std::span<double> upper_mm) const noexcept;

  std::vector<Segment> segments_;
  BoxGrid grid_;
  double reach_ = 0;
};

}  // namespace relievo::sample
