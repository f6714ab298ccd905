// monotone_cubic.h - curves through values at times that never leave the range of the two values beside them, and whose
// speed is continuous: cubic Hermite pieces (Fritsch, Carlson 1980, Monotone Piecewise Cubic Interpolation) with slopes
// of Fritsch, Butland 1984, A Method for Constructing Local Monotone Piecewise Cubic Interpolants.
#pragma once

namespace relievo {

// At an inner value; before, after: slopes of the straight lines to its neighbours, which are so far away in time. 0 at
// peaks.
inline double monotoneSlope(double before, double after, double before_s, double after_s) {
  if (before * after <= 0) return 0;
  const double w1 = 2 * after_s + before_s, w2 = after_s + 2 * before_s;
  return (w1 + w2) / (w1 / before + w2 / after);
}

// Between the values a and b, width_s apart, with these slopes; t: 0..1.
inline double cubicBetween(double a, double b, double slope_a, double slope_b, double width_s, double t) {
  const double u = 1 - t;
  return a * (u * u * (1 + 2 * t)) + b * (t * t * (1 + 2 * u)) +
         width_s * (slope_a * (t * u * u) - slope_b * (t * t * u));
}

}  // namespace relievo
