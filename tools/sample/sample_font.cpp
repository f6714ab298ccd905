#include "tools/sample/sample_font.h"

#include <numbers>

namespace relievo::sample {
namespace {

constexpr double kThick = 0.058, kThin = 0.034;  // half-widths: a stem is 1/9 of its height, hairlines 3/5 of a stem

struct Pen {
  std::vector<Segment>& out;
  double x;
  int steps;

  void line(double x0, double y0, double x1, double y1, double r0, double r1) {
    out.push_back({x + x0, y0, x + x1, y1, r0, r1});
  }
  // A horizontal serif: full at the stem, fine at its tips.
  void serif(double cx, double y, double left, double right) {
    double inner = 0.028, tip = 0.011, lift = y < 0.5 ? 1 : -1;
    line(cx, y + lift * inner, cx - left, y + lift * tip, inner, tip);
    line(cx, y + lift * inner, cx + right, y + lift * tip, inner, tip);
  }
  // An upright tick at the end of an arm.
  void tick(double cx, double y, double reach) { line(cx, y, cx + 0.012, y + reach, 0.030, 0.010); }
  // A straight stroke, waisted, flared towards ends that carry a serif.
  void stroke(double x0, double y0, double x1, double y1, double r, bool serif0, bool serif1, double l0 = 0.105,
              double l1 = 0.105) {
    auto px = [&](double t) { return x0 + (x1 - x0) * t; };
    auto py = [&](double t) { return y0 + (y1 - y0) * t; };
    double end0 = serif0 ? r * 0.95 : 0, end1 = serif1 ? r * 0.95 : 0, len = std::hypot(x1 - x0, y1 - y0);
    double a = end0 / len, d = 1 - end1 / len;
    double f0 = serif0 ? 1.18 : 1.0, f1 = serif1 ? 1.18 : 1.0, waist = 0.94;
    double b = a + 0.16, c = d - 0.16;
    line(px(a), py(a), px(b), py(b), r * f0, r);
    line(px(b), py(b), px(0.5), py(0.5), r, r * waist);
    line(px(0.5), py(0.5), px(c), py(c), r * waist, r);
    line(px(c), py(c), px(d), py(d), r, r * f1);
    double s = r / kThick * 0.35 + 0.65;
    if (serif0) serif(x0, y0, l0 * s, l0 * s);
    if (serif1) serif(x1, y1, l1 * s, l1 * s);
  }
  void stem(double sx) { stroke(sx, 0, sx, 1, kThick, true, true); }
  void thin(double x0, double y0, double x1, double y1) { line(x0, y0, x1, y1, kThin, kThin); }
  // Angles in degrees, counter-clockwise; the stress leans a little, as a broad brush leaves it.
  void arc(double cx, double cy, double rx, double ry, double a0, double a1, double lean = 12,
           double thick = kThick * 1.06) {
    int n = std::max(6, static_cast<int>(std::abs(a1 - a0) / 360 * steps));
    auto half = [&](double a) {
      double k = std::abs(std::cos((a - lean) * std::numbers::pi / 180));
      return kThin * 0.92 + (thick - kThin * 0.92) * std::pow(k, 1.35);
    };
    for (int i = 0; i < n; ++i) {
      double p = a0 + (a1 - a0) * i / n, q = a0 + (a1 - a0) * (i + 1) / n;
      line(cx + rx * std::cos(p * std::numbers::pi / 180), cy + ry * std::sin(p * std::numbers::pi / 180),
           cx + rx * std::cos(q * std::numbers::pi / 180), cy + ry * std::sin(q * std::numbers::pi / 180), half(p),
           half(q));
    }
  }
  // The spine of an S: thin at its ends, full in the middle.
  void spine() {
    const double top = 1 - kThin;
    int n = std::max(12, steps);
    auto at = [&](double t, double& sx, double& sy, double& r) {
      double a = t < 0.5 ? 38 + (272 - 38) * (t / 0.5) : 92 - (92 + 142) * ((t - 0.5) / 0.5);
      double upper_y = 0.742, ry1 = top - upper_y, ry2 = (upper_y - ry1 - kThin * 0.9) / 2,
             lower_y = upper_y - ry1 - ry2;
      if (t < 0.5)
        sx = 0.275 + 0.185 * std::cos(a * std::numbers::pi / 180),
        sy = upper_y + ry1 * std::sin(a * std::numbers::pi / 180);
      else
        sx = 0.275 + 0.215 * std::cos(a * std::numbers::pi / 180),
        sy = lower_y + ry2 * std::sin(a * std::numbers::pi / 180);
      double k = 1 - std::abs(2 * t - 1);
      r = kThin * 0.92 +
          (kThick * 1.05 - kThin * 0.92) * std::pow(std::sin(std::min(1.0, k * 1.15) * std::numbers::pi / 2), 1.4);
    };
    for (int i = 0; i < n; ++i) {
      double x0, y0, r0, x1, y1, r1;
      at(static_cast<double>(i) / n, x0, y0, r0);
      at(static_cast<double>(i + 1) / n, x1, y1, r1);
      line(x0, y0, x1, y1, r0, r1);
    }
  }
};

}  // namespace

// Long because it is a table: a case a letter.
// NOLINTNEXTLINE(readability-function-size)
double appendGlyph(char c, double x, int arc_steps, std::vector<Segment>& out) {
  Pen p{out, x, arc_steps};
  const double top = 1 - kThin, low = kThin;
  switch (c) {
    case 'A':
      p.stroke(0.04, 0, 0.41, 0.985, kThin * 1.05, true, false, 0.095);
      p.stroke(0.395, 0.96, 0.80, 0, kThick, false, true);
      p.thin(0.185, 0.355, 0.645, 0.355);
      return 0.86;
    case 'B':
      p.stem(0.10);
      p.thin(0.10, top, 0.28, top);
      p.arc(0.28, 0.755, 0.185, 1 - kThin - 0.755, 90, -90, 0);
      p.thin(0.28, 0.755 - (top - 0.755), 0.10, 0.755 - (top - 0.755));
      p.arc(0.29, 0.282, 0.245, 0.282 - kThin, 90, -90, 0);
      p.thin(0.29, low, 0.10, low);
      return 0.66;
    case 'C':
      p.arc(0.49, 0.5, 0.46, 0.5 - kThin * 0.9, 42, 318);
      p.line(0.832, 0.82, 0.838, 0.66, 0.035, 0.010);
      p.line(0.832, 0.18, 0.838, 0.34, 0.035, 0.010);
      return 0.92;
    case 'D':
      p.stem(0.10);
      p.thin(0.10, top, 0.36, top);
      p.arc(0.36, 0.5, 0.46, 0.5 - kThin, 90, -90, 0);
      p.thin(0.36, low, 0.10, low);
      return 0.94;
    case 'E':
    case 'F':
      p.stem(0.10);
      p.thin(0.10, top, 0.48, top);
      p.tick(0.485, top, -0.12);
      p.thin(0.10, 0.515, 0.43, 0.515);
      p.tick(0.432, 0.515, 0.075);
      p.tick(0.432, 0.515, -0.075);
      if (c == 'F') return 0.57;
      p.thin(0.10, low, 0.51, low);
      p.tick(0.515, low, 0.13);
      return 0.61;
    case 'G':
      p.arc(0.49, 0.5, 0.46, 0.5 - kThin * 0.9, 42, 312);
      p.line(0.832, 0.82, 0.838, 0.66, 0.035, 0.010);
      p.line(0.825, 0.09, 0.825, 0.36, kThick * 0.95, kThick);
      p.serif(0.825, 0.44, 0.10, 0.08);
      return 0.95;
    case 'H':
      p.stem(0.10);
      p.stem(0.70);
      p.thin(0.10, 0.51, 0.70, 0.51);
      return 0.82;
    case 'I':
    case 'J':
      p.stem(0.10);
      return 0.22;
    case 'K':
      p.stem(0.10);
      p.stroke(0.13, 0.43, 0.56, 1, kThin, false, true, 0, 0.09);
      p.stroke(0.25, 0.56, 0.66, 0, kThick, false, true);
      return 0.72;
    case 'L':
      p.stem(0.10);
      p.thin(0.10, low, 0.50, low);
      p.tick(0.505, low, 0.14);
      return 0.58;
    case 'M':
      p.stroke(0.06, 0, 0.18, 0.97, kThin * 1.05, true, false, 0.09);
      p.stroke(0.17, 0.97, 0.49, 0.03, kThick * 0.96, false, false);
      p.stroke(0.49, 0.03, 0.80, 0.97, kThin, false, false);
      p.stroke(0.80, 0.96, 0.92, 0, kThick, false, true);
      return 1.0;
    case 'N':
      p.stroke(0.10, 0, 0.10, 0.97, kThin * 1.1, true, false, 0.09);
      p.stroke(0.09, 0.97, 0.72, 0.03, kThick, false, false);
      p.stroke(0.73, 0.03, 0.73, 1, kThin * 1.1, false, true, 0.09, 0.09);
      p.serif(0.08, 1, 0.09, 0.02);
      return 0.84;
    case 'O':
      p.arc(0.50, 0.5, 0.465, 0.5 - kThin * 0.9, 0, 360);
      return 1.0;
    case 'P':
      p.stem(0.10);
      p.thin(0.10, top, 0.28, top);
      p.arc(0.28, 0.735, 0.22, top - 0.735, 90, -80, 0);
      return 0.56;
    case 'Q':
      p.arc(0.50, 0.5, 0.465, 0.5 - kThin * 0.9, 0, 360);
      p.line(0.50, 0.04, 0.78, -0.13, 0.03, 0.056);
      p.line(0.78, -0.13, 1.10, -0.20, 0.056, 0.012);
      return 1.0;
    case 'R':
      p.stem(0.10);
      p.thin(0.10, top, 0.28, top);
      p.arc(0.28, 0.745, 0.215, top - 0.745, 90, -90, 0);
      p.thin(0.28, 0.745 - (top - 0.745), 0.10, 0.745 - (top - 0.745));
      p.stroke(0.30, 0.52, 0.68, 0, kThick, false, true, 0, 0.09);
      return 0.73;
    case 'S':
      p.spine();
      p.line(0.418, 0.885, 0.425, 0.74, 0.032, 0.010);
      p.line(0.105, 0.12, 0.092, 0.29, 0.034, 0.010);
      return 0.55;
    case 'T':
      p.stroke(0.36, 0, 0.36, 0.97, kThick, true, false);
      p.thin(0.04, top, 0.68, top);
      p.tick(0.035, top, -0.12);
      p.tick(0.675, top, -0.12);
      return 0.72;
    case 'U':
    case 'V':
      p.stroke(0.04, 1, 0.42, 0.03, kThick, true, false);
      p.stroke(0.42, 0.03, 0.78, 1, kThin, false, true, 0, 0.09);
      return 0.82;
    case 'W': {
      double first = appendGlyph('V', x, arc_steps, out) * 0.85;
      return first + appendGlyph('V', x + first, arc_steps, out);
    }
    case 'X':
      p.stroke(0.05, 1, 0.70, 0, kThick, true, true);
      p.stroke(0.67, 1, 0.07, 0, kThin, true, true, 0.09, 0.09);
      return 0.75;
    case 'Y':
      p.stroke(0.04, 1, 0.37, 0.46, kThick, true, false);
      p.stroke(0.37, 0.46, 0.70, 1, kThin, false, true, 0, 0.09);
      p.stroke(0.37, 0, 0.37, 0.47, kThick, true, false);
      return 0.74;
    case 'Z':
      p.thin(0.07, top, 0.62, top);
      p.stroke(0.62, 0.95, 0.08, 0.05, kThick, false, false);
      p.thin(0.08, low, 0.65, low);
      p.tick(0.075, top, -0.12);
      p.tick(0.65, low, 0.13);
      return 0.7;
    case '.':
      p.line(0.055, 0.535, 0.075, 0.44, 0.062, 0.008);
      return 0.15;
    default:
      return 0.35;
  }
}

double lineWidth(const std::string& text, double letter_space) {
  std::vector<Segment> none;
  double x = 0;
  for (char c : text) x += appendGlyph(c, x, 8, none) + letter_space;
  return text.empty() ? 0 : x - letter_space;
}

}  // namespace relievo::sample
