// deviation.h - how far a coarser surface lies from the finest one at the same (u, v), and on which side of it: a
// smooth surface lies on one side of its coarser ones, and mostly along its normal. What the errors of relief pages and
// of their parts say.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace relievo {

// Finest minus coarser, d: |d| <= mm, and with n the direction of the base's normal at that (u, v)
// (src/artwork/base_mesh.h; z of a flat artwork), -below_mm <= dot(d, n) <= above_mm, |d - dot(d, n) n| <= aside_mm at
// every finest vertex; between vertices d is a mix of those around. Over one cell of the coarser surface, its border
// and 0 included, the values of dot(d, n) lie within between_mm of one another, and those of d within apart_mm: less
// than below_mm + above_mm and 2 mm where cells on one side lie beside cells on the other, and where d is much the same
// all over a cell. All >= 0; nothing but mm is known where the first four are mm and the others twice that.
struct Deviation {
  double mm = 0, below_mm = 0, above_mm = 0, aside_mm = 0, between_mm = 0, apart_mm = 0;

  static Deviation anyDirection(double mm) { return {mm, mm, mm, mm, 2 * mm, 2 * mm}; }
  // Heights of a flat artwork, of which no more is known.
  static Deviation eitherSide(double mm) { return {mm, mm, mm, 0, 2 * mm, 2 * mm}; }
  double largestAlong() const { return std::max(below_mm, above_mm); }
  // Nothing of it is larger, whatever is known.
  Deviation atMost(double most_mm) const {
    Deviation d{std::min(mm, most_mm),
                std::min(below_mm, most_mm),
                std::min(above_mm, most_mm),
                std::min(aside_mm, most_mm),
                0,
                0};
    d.between_mm = std::min(between_mm, d.below_mm + d.above_mm);
    d.apart_mm = std::min(apart_mm, 2 * d.mm);
    return d;
  }
  // The last two between points of different cells; and between any point and one of the coarser surface itself.
  Deviation overCells() const { return {mm, below_mm, above_mm, aside_mm, below_mm + above_mm, 2 * mm}; }
  Deviation fromNone() const { return {mm, below_mm, above_mm, aside_mm, largestAlong(), mm}; }
  // Both lie in it.
  friend Deviation joined(const Deviation& a, const Deviation& b) {
    return {std::max(a.mm, b.mm),
            std::max(a.below_mm, b.below_mm),
            std::max(a.above_mm, b.above_mm),
            std::max(a.aside_mm, b.aside_mm),
            std::max(a.between_mm, b.between_mm),
            std::max(a.apart_mm, b.apart_mm)};
  }
  // All of d times a number.
  friend Deviation operator*(double t, const Deviation& d) {
    const double s = std::abs(t);
    return {s * d.mm,
            s * (t < 0 ? d.above_mm : d.below_mm),
            s * (t < 0 ? d.below_mm : d.above_mm),
            s * d.aside_mm,
            s * d.between_mm,
            s * d.apart_mm};
  }
  friend Deviation operator+(const Deviation& a, const Deviation& b) {
    return {a.mm + b.mm,
            a.below_mm + b.below_mm,
            a.above_mm + b.above_mm,
            a.aside_mm + b.aside_mm,
            a.between_mm + b.between_mm,
            a.apart_mm + b.apart_mm};
  }
};

// In 255ths, rounded up: the first three as shares of mm, between as one of below and above together, apart as one of
// twice mm.
struct DeviationShape {
  uint8_t below = 255, above = 255, aside = 255, between = 255, apart = 255;
  friend bool operator==(const DeviationShape&, const DeviationShape&) = default;
};
static_assert(sizeof(DeviationShape) == 5);

inline Deviation deviationOf(double mm, const DeviationShape& s) {
  const double below = mm * (s.below / 255.0), above = mm * (s.above / 255.0);
  return {mm, below, above, mm * (s.aside / 255.0), (below + above) * (s.between / 255.0), 2 * mm * (s.apart / 255.0)};
}
inline DeviationShape shapeOf(const Deviation& d) {
  if (!(d.mm > 0)) return {0, 0, 0, 0, 0};
  auto share = [](double part, double whole) {
    return whole > 0 ? static_cast<uint8_t>(std::min(255.0, std::ceil(255 * (1 + 1e-6) * part / whole))) : uint8_t{0};
  };
  DeviationShape s{share(d.below_mm, d.mm), share(d.above_mm, d.mm), share(d.aside_mm, d.mm), 0,
                   share(d.apart_mm, 2 * d.mm)};
  s.between = share(d.between_mm, d.mm * ((s.below + s.above) / 255.0));
  return s;
}

}  // namespace relievo
