// deviation.h - how far a coarser surface lies from the finest one at the same (u, v), and on which side of it: a smooth surface lies on one side of
// its coarser ones, and mostly along its normal. What the errors of relief pages and of their parts say.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace relievo {

// Finest minus coarser, d: |d| <= mm, and with n the direction of the base's normal at that (u, v) (src/base/base_mesh.h; z of a flat artwork),
// -below_mm <= dot(d, n) <= above_mm, |d - dot(d, n) n| <= aside_mm at every finest vertex; between vertices d is a mix of those around. All >= 0;
// nothing but mm is known where all are mm.
struct Deviation {
  double mm = 0, below_mm = 0, above_mm = 0, aside_mm = 0;

  static Deviation anyDirection(double mm) { return {mm, mm, mm, mm}; }
  double largestAlong() const { return std::max(below_mm, above_mm); }
  // Both lie in it.
  friend Deviation joined(const Deviation& a, const Deviation& b) {
    return {std::max(a.mm, b.mm), std::max(a.below_mm, b.below_mm), std::max(a.above_mm, b.above_mm), std::max(a.aside_mm, b.aside_mm)};
  }
  // All of d times a number.
  friend Deviation operator*(double t, const Deviation& d) {
    const double s = std::abs(t);
    return {s * d.mm, s * (t < 0 ? d.above_mm : d.below_mm), s * (t < 0 ? d.below_mm : d.above_mm), s * d.aside_mm};
  }
  friend Deviation operator+(const Deviation& a, const Deviation& b) {
    return {a.mm + b.mm, a.below_mm + b.below_mm, a.above_mm + b.above_mm, a.aside_mm + b.aside_mm};
  }
};

// The last three as shares of the first, in 255ths, rounded up.
struct DeviationShape {
  uint8_t below = 255, above = 255, aside = 255;
  friend bool operator==(const DeviationShape&, const DeviationShape&) = default;
};
static_assert(sizeof(DeviationShape) == 3);

inline DeviationShape shapeOf(const Deviation& d) {
  if (!(d.mm > 0)) return {0, 0, 0};
  auto share = [&](double mm) { return static_cast<uint8_t>(std::min(255.0, std::ceil(255 * (1 + 1e-6) * mm / d.mm))); };
  return {share(d.below_mm), share(d.above_mm), share(d.aside_mm)};
}
inline Deviation deviationOf(double mm, const DeviationShape& s) { return {mm, mm * (s.below / 255.0), mm * (s.above / 255.0), mm * (s.aside / 255.0)}; }

}  // namespace relievo
