// sample_shading.h - how a sample artwork answers to light, and the PTM that comes nearest to it.
// Shading without cast shadows, relative to the albedo: cavity * ((1 - s g) D + s g S), with gloss g and the kind's
// strength s,
//   D = 0.06 + 0.94 max(0, n.l)      S = max(0, n.h)^8, h halfway between light and viewer (the viewer looks along -z).
// Head-on light on a level place gives 1. The PTM is the least-squares fit over 49 lights spread evenly over the
// hemisphere.
#pragma once

#include <array>
#include <vector>

namespace relievo::sample {

using Vec3 = std::array<double, 3>;

inline constexpr double kAmbient = 0.06;
inline constexpr int kFitLights = 49;

// n lights, evenly over the part of the hemisphere that lies more than 10 degrees above the horizon, on a spiral.
std::vector<Vec3> domeLights(int n);
double diffuseTerm(const Vec3& n, const Vec3& l);
double glossTerm(const Vec3& n, const Vec3& l, double exponent = 8);
// Coefficients of a function of the light, in units of 1.
std::array<double, 6> fitPtm(const std::vector<Vec3>& lights, const std::vector<double>& values);

// Fitted D and S by normal: entry (i, j) is the normal (i, j) / kHalf - 1 in x and y, kept inside the unit disc.
// Eight floats for D and eight for S: six coefficients in 0..255 units, two zeros.
struct ShadingTable {
  static constexpr int kSide = 65;
  static constexpr float kHalf = 32;
  std::vector<float> entries;                 // kSide * kSide * 16, and room to align
  const float* data = nullptr;                // 64-byte aligned
  std::array<double, 6> lowest{}, highest{};  // over D and S and every normal
};
const ShadingTable& shadingTable();

}  // namespace relievo::sample
