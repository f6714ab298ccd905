#include "tools/sample/sample_shading.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "src/artwork/bases/ptm.h"
#include "src/artwork/basis.h"

namespace relievo::sample {

std::vector<Vec3> domeLights(int n) {
  std::vector<Vec3> lights;
  const double lowest = std::sin(10.0 * std::numbers::pi / 180), golden = std::numbers::pi * (3 - std::sqrt(5.0));
  for (int i = 0; i < n; ++i) {
    double z = 1 - (1 - lowest) * (i + 0.5) / n, r = std::sqrt(1 - z * z);
    lights.push_back({r * std::cos(golden * i), r * std::sin(golden * i), z});
  }
  return lights;
}

double diffuseTerm(const Vec3& n, const Vec3& l) {
  return kAmbient + (1 - kAmbient) * std::max(0.0, n[0] * l[0] + n[1] * l[1] + n[2] * l[2]);
}

double glossTerm(const Vec3& n, const Vec3& l, double exponent) {
  Vec3 h{l[0], l[1], l[2] + 1};
  double len = std::sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]);
  return std::pow(std::max(0.0, (n[0] * h[0] + n[1] * h[1] + n[2] * h[2]) / len), exponent);
}

std::array<double, 6> fitPtm(const std::vector<Vec3>& lights, const std::vector<double>& values) {
  // Normal equations by Gauss with pivots: six unknowns, well conditioned for lights all around.
  double a[6][7] = {};
  for (size_t k = 0; k < lights.size(); ++k) {
    auto p = ptmBasis(lights[k][0], lights[k][1]);
    for (size_t i = 0; i < 6; ++i) {
      for (size_t j = 0; j < 6; ++j) a[i][j] += p[i] * p[j];
      a[i][6] += p[i] * values[k];
    }
  }
  for (int c = 0; c < 6; ++c) {
    int best = c;
    for (int r = c + 1; r < 6; ++r)
      if (std::abs(a[r][c]) > std::abs(a[best][c])) best = r;
    std::swap(a[c], a[best]);
    for (int r = 0; r < 6; ++r) {
      if (r == c) continue;
      double f = a[r][c] / a[c][c];
      for (int j = c; j < 7; ++j) a[r][j] -= f * a[c][j];
    }
  }
  std::array<double, 6> out{};
  for (size_t i = 0; i < 6; ++i) out[i] = a[i][6] / a[i][i];
  return out;
}

const ShadingTable& shadingTable() {
  static const ShadingTable table = [] {
    ShadingTable t;
    constexpr int n = ShadingTable::kSide;
    t.entries.assign(n * n * 16 + 16, 0.0f);
    auto address = reinterpret_cast<uintptr_t>(t.entries.data());
    float* data = t.entries.data() + ((64 - address % 64) % 64) / sizeof(float);
    t.data = data;
    t.lowest.fill(1e9);
    t.highest.fill(-1e9);
    const auto lights = domeLights(kFitLights);
    // The fit is linear in the values: one unit vector a light gives its matrix.
    std::vector<std::array<double, 6>> column;
    for (size_t k = 0; k < lights.size(); ++k) {
      std::vector<double> one(lights.size(), 0.0);
      one[k] = 255.0;
      column.push_back(fitPtm(lights, one));
    }
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i) {
        Vec3 normal{i / 32.0 - 1, j / 32.0 - 1, 0};
        double r = std::hypot(normal[0], normal[1]);
        if (r > 0.999) normal[0] *= 0.999 / r, normal[1] *= 0.999 / r;
        normal[2] = std::sqrt(1 - normal[0] * normal[0] - normal[1] * normal[1]);
        std::array<double, 6> d{}, s{};
        for (size_t k = 0; k < lights.size(); ++k) {
          double dv = diffuseTerm(normal, lights[k]), sv = glossTerm(normal, lights[k]);
          for (size_t c = 0; c < 6; ++c) d[c] += column[k][c] * dv, s[c] += column[k][c] * sv;
        }
        float* e = data + (j * n + i) * 16;
        for (size_t c = 0; c < 6; ++c) {
          e[c] = static_cast<float>(d[c]);
          e[8 + c] = static_cast<float>(s[c]);
          t.lowest[c] = std::min({t.lowest[c], d[c], s[c]});
          t.highest[c] = std::max({t.highest[c], d[c], s[c]});
        }
      }
    return t;
  }();
  return table;
}

}  // namespace relievo::sample
