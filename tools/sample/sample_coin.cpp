// A struck coin of 24 mm on dark cloth: an owl between two branches of laurel, a legend, a rim of beads; worn,
// scratched. Odd seeds strike gold, even ones silver. The picture's shorter side is 31 mm.
//
// The relief is the highest of many small forms (domes, leaves, rods) over a dished field; only those near a block
// count.
#include <numbers>

#include "tools/sample/sample_font.h"
#include "tools/sample/sample_kinds.h"

namespace relievo::sample {
namespace {

constexpr double kCoinShortMm = 31, kRadius = 12.0;
constexpr float kClothMm = -1.9f, kThreadMm = 0.10f, kMaxReliefMm = 1.35f;

enum class Shape { kDome, kLeaf, kRod };
struct Form {
  Shape shape;
  double x, y, c, s;   // centre, direction
  double rx, ry;       // half length, half width
  float base, height;  // mm above the coin's field
  float tilt = 0;      // added from the tail (0) to the tip (1)
  float ridge = 0;     // a shaft along the middle (> 0) or a groove (< 0)
  bool flat = false;   // a soft swelling rather than a dome
};

class Coin final : public Kind {
 public:
  explicit Coin(const SampleOptions& o)
      : seed_(mix32(static_cast<uint32_t>(o.seed) * 69621u + static_cast<uint32_t>(o.seed >> 32) + 17)),
        gold_(o.seed % 2 == 1) {
    short_mm = kCoinShortMm;
    metal = true;
    gloss_strength = 0.75f;
    const double mm = kCoinShortMm / static_cast<double>(std::min(o.width, o.height));
    cx_ = 0.5 * static_cast<double>(o.width) * mm, cy_ = 0.5 * static_cast<double>(o.height) * mm;
    min_mm = kClothMm - 3 * kThreadMm - 0.5f;
    max_mm = kMaxReliefMm + 0.25f;
    Dice dice(o.seed * 131 + 9);
    turn_ = dice.range(-0.10, 0.10);  // a coin never lies quite straight
    layOwl();
    // The owl is drawn about its breast; here it gets its size and place.
    enlarge(1.22, 0.85);
    layWreath();
    layBeads();
    layLegend(mm);
    layScratches(dice);
    std::vector<BoxGrid::Box> boxes;
    for (const Form& f : forms_) {
      double r = std::max(f.rx, f.ry) * 1.001;
      boxes.push_back({f.x - r, f.y - r, f.x + r, f.y + r});
    }
    grid_.build(boxes);
  }

  void eval(const Block& b, bool colour, Layers& out) const override {
    // How far the block's pixels can be from the coin's centre.
    const double dx = b.centreX() - cx_, dy = b.centreY() - cy_, d = std::hypot(dx, dy), r = b.radius();
    const bool any_coin = d - r<kRadius + kBorder, any_cloth = d + r> kRadius - kBorder - 0.6;
    if (any_cloth) cloth(b, colour, out);
    if (any_coin) coin(b, colour, out, any_cloth);
  }

 private:
  static constexpr double kBorder = 0.35;  // the outline wanders by less
  uint32_t seed_;
  bool gold_;
  double cx_, cy_, turn_;
  std::vector<Form> forms_;
  BoxGrid grid_;
  StrokeField legend_, scratches_;

  // Places in the die's own system (mm, y up, centre 0) to the picture's.
  void place(double x, double y, double& px, double& py) const {
    double c = std::cos(turn_), s = std::sin(turn_);
    px = cx_ + c * x - s * y, py = cy_ - (s * x + c * y);
  }
  void enlarge(double k, double up) {
    for (Form& f : forms_) {
      double dx = f.x - cx_, dy = f.y - cy_;
      f.x = cx_ + k * dx - up * std::sin(turn_), f.y = cy_ + k * dy - up * std::cos(turn_);
      f.rx *= k, f.ry *= k;
    }
  }
  // angle: of the form's long axis, degrees, counter-clockwise.
  void add(Shape shape, double x, double y, double angle, double rx, double ry, double base, double height,
           double tilt = 0, double ridge = 0, bool flat = false) {
    Form f{shape,
           0,
           0,
           std::cos(angle * std::numbers::pi / 180 + turn_),
           -std::sin(angle * std::numbers::pi / 180 + turn_),
           rx,
           ry,
           static_cast<float>(base),
           static_cast<float>(height),
           static_cast<float>(tilt),
           static_cast<float>(ridge),
           flat};
    place(x, y, f.x, f.y);
    forms_.push_back(f);
  }
  void rod(double x0, double y0, double x1, double y1, double r, double base, double height) {
    double len = std::hypot(x1 - x0, y1 - y0);
    add(Shape::kRod, 0.5 * (x0 + x1), 0.5 * (y0 + y1), std::atan2(y1 - y0, x1 - x0) * 180 / std::numbers::pi,
        0.5 * len + r, r, base, height);
  }

  void layOwl() {
    // Body and head first; everything else sits on them.
    add(Shape::kDome, 0, -0.9, 90, 3.9, 2.55, -0.15, 0.80);
    add(Shape::kDome, 0, 2.35, 0, 2.35, 1.85, -0.05, 0.86);
    // Tail.
    for (int i = -2; i <= 2; ++i) add(Shape::kLeaf, 0.34 * i, -4.55, -90 + 7.0 * i, 1.55, 0.30, 0.10, 0.26, 0.12, 0.05);
    // Breast: rows of small feathers, the upper over the lower.
    for (int row = 0; row < 9; ++row) {
      double y = -3.55 + row * 0.52, half = 1.55 * std::sqrt(std::max(0.05, 1 - std::pow((y + 1.0) / 3.6, 2)));
      int n = std::max(2, static_cast<int>(half * 2 / 0.44));
      for (int i = 0; i <= n; ++i) {
        double x = -half + 2 * half * (i + (row % 2 ? 0.5 : 0.0) - 0.25) / n;
        if (std::abs(x) > half) continue;
        double on_body =
            -0.15 + 0.80 * std::sqrt(std::max(0.0, 1 - std::pow(x / 2.55, 2) - std::pow((y + 0.9) / 3.9, 2)));
        add(Shape::kDome, x, y, -90 + x * 9, 0.42, 0.25, on_body - 0.015, 0.085, 0.07, -0.03);
      }
    }
    // Wings: coverts over long pinions, both sides.
    for (int side : {-1, 1}) {
      for (int i = 0; i < 6; ++i) {
        double t = i / 5.0, angle = side > 0 ? -(97 - 13 * (1 - t)) : -(83 + 13 * (1 - t));
        add(Shape::kLeaf, side * (1.35 + 1.35 * t - 0.05), -2.35 + 0.42 * t * t + 0.25 * t, angle, 2.35 - 0.35 * t,
            0.36, 0.24 - 0.12 * t + 0.02 * i, 0.30, 0.10, 0.07);
      }
      for (int row = 0; row < 4; ++row)
        for (int i = 0; i < 4; ++i) {
          double t = i / 3.0, x = side * (1.62 + 0.98 * t - 0.05 * row),
                 y = -0.95 + 0.50 * row - 0.25 * t * t - 0.05 * row * t;
          if (row == 3 && i > 2) continue;
          add(Shape::kDome, x, y, -90 + side * (8 + 10 * t), 0.52, 0.29, 0.36 + 0.045 * row - 0.12 * t, 0.14, 0.10,
              0.045);
        }
      add(Shape::kDome, side * 1.78, 0.45, side * 58 + 90, 1.25, 0.72, 0.30, 0.20);  // shoulder
      // Ear tufts.
      add(Shape::kLeaf, side * 1.62, 3.72, 90 - side * 34, 0.95, 0.34, 0.34, 0.34, 0.06, 0.06);
      add(Shape::kLeaf, side * 1.12, 3.86, 90 - side * 20, 0.66, 0.24, 0.40, 0.28, 0.04, 0.05);
      // Face discs: a fan of fine feathers around each eye, the eye in its ring.
      for (int i = 0; i < 26; ++i) {
        double a = i * 360.0 / 26;
        add(Shape::kLeaf, side * 0.94 + 0.93 * std::cos(a * std::numbers::pi / 180),
            2.42 + 0.93 * std::sin(a * std::numbers::pi / 180), a, 0.36, 0.105, 0.70, 0.17, 0.05, 0.0);
      }
      for (int i = 0; i < 150; ++i) {
        double a = i * 2.4, q = (i + 1) * 2.4;
        rod(side * 0.94 + 0.60 * std::cos(a * std::numbers::pi / 180),
            2.42 + 0.60 * std::sin(a * std::numbers::pi / 180),
            side * 0.94 + 0.60 * std::cos(q * std::numbers::pi / 180),
            2.42 + 0.60 * std::sin(q * std::numbers::pi / 180), 0.085, 0.78, 0.20);
      }
      add(Shape::kDome, side * 0.94, 2.42, 0, 0.47, 0.47, 0.76, 0.34);
      add(Shape::kDome, side * 0.94, 2.42, 0, 0.17, 0.17, 1.04, 0.11);
      // Brows.
      add(Shape::kLeaf, side * 0.98, 3.30, side > 0 ? 27 : 153, 1.15, 0.24, 0.74, 0.26, 0.0, 0.0);
      // Legs and talons on the branch.
      add(Shape::kDome, side * 0.78, -4.28, 90, 0.62, 0.36, 0.20, 0.34);
      for (int t = -1; t <= 1; ++t)
        add(Shape::kDome, side * 0.78 + 0.27 * t, -4.95, 90 + 12 * t, 0.42, 0.13, 0.34, 0.26);
    }
    add(Shape::kLeaf, 0, 1.98, -90, 0.74, 0.26, 0.86, 0.36, 0.06, 0.0);  // beak
    for (int i = 0; i < 5; ++i)
      add(Shape::kDome, 0, 2.75 + 0.26 * i, 90, 0.26, 0.15, 0.80 - 0.02 * i * i, 0.16, 0.05, 0.0);
    // The branch, with two leaves.
    double px = -3.6, py = -5.0;
    for (int i = 1; i <= 24; ++i) {
      double x = -3.6 + 7.2 * i / 24, y = -5.22 + 0.16 * std::cos(x * 0.9);
      rod(px, py, x, y, 0.23, 0.06, 0.34);
      px = x, py = y;
    }
    add(Shape::kLeaf, 3.75, -4.55, 48, 0.85, 0.32, 0.05, 0.32, 0.0, -0.05);
    add(Shape::kLeaf, -3.75, -4.5, 128, 0.85, 0.32, 0.05, 0.32, 0.0, -0.05);
  }

  void layWreath() {
    const double r = 6.35;
    for (int side : {-1, 1}) {
      double px = 0, py = -r;
      for (int i = 1; i <= 240; ++i) {
        double a = (-90 + side * 158.0 * i / 240) * std::numbers::pi / 180, x = r * std::cos(a), y = r * std::sin(a);
        rod(px, py, x, y, 0.14 - 0.0003 * i, 0.0, 0.20);
        px = x, py = y;
      }
      for (int i = 0; i < 15; ++i) {
        double a = -90 + side * (10 + 150.0 * i / 15), size = 1.0 - 0.022 * i;
        double along = a + side * 90;  // the way the branch grows
        for (int leaf : {-1, 1}) {
          double angle = along + side * leaf * -31.0, lx = (r + leaf * 0.36) * std::cos(a * std::numbers::pi / 180),
                 ly = (r + leaf * 0.36) * std::sin(a * std::numbers::pi / 180);
          add(Shape::kLeaf, lx + 0.55 * size * std::cos(angle * std::numbers::pi / 180),
              ly + 0.55 * size * std::sin(angle * std::numbers::pi / 180), angle, 1.02 * size, 0.32 * size, 0.05, 0.36,
              0.08, -0.045);
        }
        if (i % 2) {
          double q = (a + side * 5) * std::numbers::pi / 180;
          add(Shape::kDome, (r + 0.62) * std::cos(q), (r + 0.62) * std::sin(q), 0, 0.15, 0.15, 0.06, 0.20);
        }
      }
    }
    // The knot.
    add(Shape::kDome, 0, -r, 0, 0.36, 0.30, 0.08, 0.30);
    for (int side : {-1, 1}) {
      add(Shape::kLeaf, side * 0.62, -r - 0.25, side > 0 ? -38 : 218, 0.62, 0.17, 0.05, 0.24, 0, -0.04);
      add(Shape::kLeaf, side * 0.50, -r + 0.26, side > 0 ? 25 : 155, 0.45, 0.16, 0.05, 0.22, 0, -0.04);
    }
  }

  void layBeads() {
    constexpr int n = 96;
    for (int i = 0; i < n; ++i) {
      double a = 2 * std::numbers::pi * i / n;
      add(Shape::kDome, 10.72 * std::cos(a), 10.72 * std::sin(a), 0, 0.265, 0.265, 0.02, 0.30);
    }
  }

  void layLegend(double mm) {
    std::vector<Segment> all;
    const std::string text = "RELIEVO.LVX.ET.VMBRA.FORMAM.DANT.";
    const double foot = 8.05, cap = 1.62, space = 0.14;
    // Letters stand on the inner circle, heads outwards, clockwise from the left of the foot.
    double total = lineWidth(text, space) + space, scale = 2 * std::numbers::pi * (foot + 0.35 * cap) / (total * cap);
    double x = 0;
    for (char c : text) {
      std::vector<Segment> glyph;
      double advance = appendGlyph(c, 0, mm < 0.004 ? 160 : 72, glyph);
      double a = (-112 - 360.0 * (x + 0.5 * advance) / total) * std::numbers::pi / 180;
      double ux = std::cos(a), uy = std::sin(a);  // outwards
      for (const Segment& g : glyph) {
        auto put = [&](double gx, double gy, double& ox, double& oy) {
          double along = (gx - 0.5 * advance) * cap * std::min(scale, 1.1), up = foot + gy * cap;
          place(ux * up + uy * along, uy * up - ux * along, ox, oy);
        };
        Segment s{};
        put(g.ax, g.ay, s.ax, s.ay);
        put(g.bx, g.by, s.bx, s.by);
        s.ra = g.ra * cap * 1.45, s.rb = g.rb * cap * 1.45;
        all.push_back(s);
      }
      x += advance + space;
    }
    legend_.build(std::move(all), 0.1);
  }

  void layScratches(Dice& dice) {
    std::vector<Segment> all;
    for (int i = 0; i < 90; ++i) {
      double r = kRadius * std::sqrt(dice()), a = dice.range(0, 2 * std::numbers::pi),
             len = dice.range(0.4, 1.0) * dice.range(0.3, 5.5), dir = dice.range(0, std::numbers::pi);
      double x = cx_ + r * std::cos(a), y = cy_ + r * std::sin(a), bend = dice.range(-0.15, 0.15);
      double w = dice.range(0.006, 0.024);
      for (int k = 0; k < 4; ++k) {
        auto at = [&](double t, double& ox, double& oy) {
          double u = (t - 0.5) * len, v = bend * u * u * 0.3;
          ox = x + u * std::cos(dir) - v * std::sin(dir), oy = y + u * std::sin(dir) + v * std::cos(dir);
        };
        Segment s{};
        at(k / 4.0, s.ax, s.ay);
        at((k + 1) / 4.0, s.bx, s.by);
        double t0 = std::sin(std::numbers::pi * k / 4.0), t1 = std::sin(std::numbers::pi * (k + 1) / 4.0);
        s.ra = w * t0, s.rb = w * t1;
        all.push_back(s);
      }
    }
    scratches_.build(std::move(all), 0.012);
  }

  // Dark twill: threads of 0.33 mm, raised and sunk in turn, each twisted from finer ones.
  void cloth(const Block& b, bool colour, Layers& out) const {
    constexpr double kPitch = 0.33;
    Plane &h = out.height, &fuzz = out.tmp[0], &fold = out.tmp[1];
    fill(b, fuzz, 0);
    addFbm(b, fuzz, 0.55, 0.055f, 0.62f, 8, seed_ + 61);
    fill(b, fold, 0);
    addFbm(b, fold, 11, 0.22f, 0.45f, 3, seed_ + 62);
    auto fraction = [](double v) { return v - std::floor(v); };
    alignas(64) float crest_x[kBlockPx], ply_x[kBlockPx];
    int32_t column[kBlockPx];
    for (int x = 0; x < kBlockPx; ++x) {
      double u = (b.left_mm + x * b.mm) / kPitch;
      crest_x[x] = static_cast<float>(std::sin(std::numbers::pi * fraction(u)));
      ply_x[x] = static_cast<float>(fraction(u * 3));
      column[x] = static_cast<int32_t>(std::floor(u));
    }
    for (int y = b.y0; y < b.y1; ++y) {
      double v = (b.top_mm + y * b.mm) / kPitch;
      const auto crest_y = static_cast<float>(std::sin(std::numbers::pi * fraction(v)));
      const auto ply_y = static_cast<float>(fraction(v * 3));
      const auto row = static_cast<int32_t>(std::floor(v));
      const int at = y * kBlockPx, x1 = b.x1;
#pragma GCC ivdep
      for (int x = b.x0; x < x1; ++x) {
        // Warp on top in two of four crossings, shifted by one a row.
        bool warp = ((column[x] + row) & 3) < 2;
        float over = warp ? crest_x[x] * (0.72f + 0.28f * crest_y) : crest_y * (0.72f + 0.28f * crest_x[x]);
        float ply = ply_x[x] + ply_y;
        ply = ply - std::floor(ply);
        ply = ply * (1.0f - ply) * 4.0f;
        h[at + x] = kClothMm + fold[at + x] + kThreadMm * (over * 1.6f + 0.22f * ply * over) + fuzz[at + x];
        fold[at + x] = over;
      }
    }
    if (!colour) return;
    forPixels(b, [&](int i, int, int) {
      float k = 0.50f + 0.55f * fold[i] + 2.2f * fuzz[i];
      out.red[i] = 112.0f * k + 8.0f, out.green[i] = 30.0f * k + 6.0f, out.blue[i] = 40.0f * k + 8.0f;
      out.cavity[i] = 0.62f + 0.36f * fold[i];
      out.gloss[i] = 0.05f;
    });
  }

  // The coin's planes of a block.
  struct Face {
    Plane &relief, &radius, &soft, &fine, &sd, &scratch;
  };

  void coin(const Block& b, bool colour, Layers& out, bool cut_out) const {
    const Face f{out.tmp[2], out.tmp[3], out.tmp[4], out.tmp[5], out.tmp[6], out.tmp[7]};
    strike(b, f, out.found);
    scratch(b, f, out.found);
    if (colour) tone(b, f, cut_out, out);
    if (!cut_out) {
      forPixels(b, [&](int i, int, int) { out.height[i] = f.relief[i]; });
      return;
    }
    // The edge: rounded above, then upright to where the cloth takes over.
    forPixels(b, [&](int i, int, int) {
      float q = clamp01((f.radius[i] - 11.80f) * 3.3f);
      float edge = f.relief[i] - 0.35f * q * q;
      float wall = smooth01((12.12f - f.radius[i]) * 9.0f);
      float mixed = out.height[i] * (1.0f - wall) + edge * wall;
      out.height[i] = wall > 0.0f ? mixed : out.height[i];
    });
  }

  // The field, forms and letters on it, and the rim, all rubbed down where they stand highest.
  void strike(const Block& b, const Face& f, std::vector<int>& found) const {
    const auto ox = static_cast<float>(b.left_mm - cx_), oy = static_cast<float>(b.top_mm - cy_);
    fill(b, f.soft, 0);
    addFbm(b, f.soft, 5.5, 0.55f, 0.5f, 4, seed_ + 71);
    fill(b, f.fine, 0);
    addFbm(b, f.fine, 0.9, 0.020f, 0.58f, 10, seed_ + 72);
    // The outline is not a true circle, nor is the rim evenly broad.
    forPixels(b, [&](int i, int x, int y) {
      float dx = b.x_mm[x] + ox, dy = b.x_mm[y] + oy;
      float r = std::sqrt(dx * dx + dy * dy);
      f.radius[i] = r + 0.22f * f.soft[i];
      f.relief[i] = 0.0022f * r * r - 0.12f;  // the dished field
    });
    grid_.candidates({b.left_mm, b.top_mm, b.left_mm + b.size_mm, b.top_mm + b.size_mm}, found);
    for (int k : found) raise(forms_[static_cast<size_t>(k)], b, f.relief);
    if (legend_.eval(b, f.sd, found))
      forPixels(b, [&](int i, int, int) {
        // A rod with a blunt crest: struck letters stand steep and end flat.
        float t = f.sd[i] * 9.0f;
        t = clamp01(0.1f + t);
        float z = 0.33f * t * (2.0f - t) + 0.03f;
        f.relief[i] = f.sd[i] > -0.012f && z > f.relief[i] ? z : f.relief[i];
      });
    // The rim, then the edge falling to the cloth.
    forPixels(b, [&](int i, int, int) {
      float q = (f.radius[i] - 11.52f) * 2.1f;
      float z = 0.58f * (1.0f - q * q * q * q);
      float inner = (f.radius[i] - 10.28f) * 14.0f;  // a fine circle inside the beads
      float line = 0.17f * (1.0f - inner * inner);
      float v = f.relief[i] > z ? f.relief[i] : z;
      v = v > line ? v : line;
      // Wear: the highest parts are rubbed down, unevenly.
      float top = 0.80f + 0.16f * f.soft[i];
      float over = v - top;
      v = over > 0.0f ? top + over / (1.0f + 1.1f * over) : v;
      f.relief[i] = v;
    });
  }

  // Digs from a life among coins; the field keeps flow lines and pits of corrosion.
  void scratch(const Block& b, const Face& f, std::vector<int>& found) const {
    fill(b, f.scratch, 0);
    addDents(b, f.scratch, 2.3, 0.12f, 0.05f, seed_ + 73);
    addDents(b, f.scratch, 0.55, 0.14f, 0.018f, seed_ + 74);
    addDents(b, f.scratch, 0.12, 0.16f, 0.006f, seed_ + 75);
    if (scratches_.eval(b, f.sd, found))
      forPixels(b, [&](int i, int, int) {
        float t = f.sd[i] + 0.010f;
        float groove = f.sd[i] > 0.0f ? -1.3f * f.sd[i] : 0.0f;
        float lip = t > 0.0f ? (f.sd[i] > 0.0f ? 0.0f : 0.35f * t) : 0.0f;
        f.scratch[i] += groove + lip;
      });
    forPixels(b, [&](int i, int, int) {
      f.relief[i] += f.scratch[i] + f.fine[i] * 0.55f;
      f.relief[i] = f.relief[i] < kMaxReliefMm + 0.2f ? f.relief[i] : kMaxReliefMm + 0.2f;
    });
  }

  // The metal's colour: toning lies in the recesses and fades on what is rubbed. cut_out: over the cloth's.
  void tone(const Block& b, const Face& f, bool cut_out, Layers& out) const {
    const float r0 = gold_ ? 250.0f : 226.0f, g0 = gold_ ? 202.0f : 224.0f, b0 = gold_ ? 118.0f : 218.0f;
    const float r1 = gold_ ? 108.0f : 66.0f, g1 = gold_ ? 70.0f : 64.0f, b1 = gold_ ? 34.0f : 68.0f;
    forPixels(b, [&](int i, int, int) {
      float outside = cut_out ? clamp01((f.radius[i] - 11.97f) * 9.0f) : 0.0f;
      float high = clamp01(f.relief[i] * 1.9f + 0.05f);
      float patina = clamp01((1.0f - high) * (0.18f + 0.50f * f.soft[i]) + 0.06f - f.scratch[i] * 3.0f -
                             f.fine[i] * 6.0f + 0.25f * outside);
      float bright = 1.0f + 0.06f * high + f.fine[i] * 1.5f;
      float r = mixf(r0, r1, patina) * bright, g = mixf(g0, g1, patina) * bright, bl = mixf(b0, b1, patina) * bright;
      float keep = cut_out ? smooth01((12.12f - f.radius[i]) * 16.0f) : 1.0f;
      float cavity = 0.78f + 0.22f * high;
      float gloss = 0.86f - 0.62f * patina + 0.10f * high;
      if (cut_out) {
        float shadow = 0.45f + 0.55f * clamp01((f.radius[i] - 12.0f) * 1.1f);  // of the coin on the cloth
        out.red[i] = mixf(out.red[i] * shadow, r, keep);
        out.green[i] = mixf(out.green[i] * shadow, g, keep);
        out.blue[i] = mixf(out.blue[i] * shadow, bl, keep);
        out.cavity[i] = mixf(out.cavity[i], cavity, keep);
        out.gloss[i] = mixf(out.gloss[i], gloss, keep);
      } else {
        out.red[i] = r, out.green[i] = g, out.blue[i] = bl, out.cavity[i] = cavity, out.gloss[i] = gloss;
      }
      out.cavity[i] = out.cavity[i] < kMinCavity ? kMinCavity : out.cavity[i];
      out.gloss[i] = clamp01(out.gloss[i]);
    });
  }

  static void raise(const Form& f, const Block& b, Plane& relief) {
    const auto ox = static_cast<float>(f.x - b.left_mm), oy = static_cast<float>(f.y - b.top_mm);
    const auto c = static_cast<float>(f.c), s = static_cast<float>(f.s);
    const auto ix = static_cast<float>(1 / f.rx), iy = static_cast<float>(1 / f.ry);
    const float base = f.base, height = f.height, tilt = f.tilt, ridge = f.ridge;
    const double r = std::max(f.rx, f.ry);
    // Only the rows and columns that it can touch; beyond, nothing is raised.
    const int ya = std::max(b.y0, static_cast<int>(std::floor((f.y - r - b.top_mm) / b.mm))),
              yb = std::min<int>(b.y1, static_cast<int>(std::ceil((f.y + r - b.top_mm) / b.mm)) + 1);
    const int xa = std::max(b.x0, static_cast<int>(std::floor((f.x - r - b.left_mm) / b.mm)) & ~7),
              xb = std::min<int>(b.x1, (static_cast<int>(std::ceil((f.x + r - b.left_mm) / b.mm)) + 8) & ~7);
    const auto straight = static_cast<float>(1.0 - f.ry / f.rx), inv_round = static_cast<float>(f.rx / f.ry);
    for (int y = ya; y < yb; ++y) {
      const float py = b.x_mm[y] - oy;
      float* out = relief.v + y * kBlockPx;
      const float* xs = b.x_mm;
      auto each = [&](auto inside_of) {
#pragma GCC ivdep
        for (int x = xa; x < xb; ++x) {
          float px = xs[x] - ox;
          float u = (px * c + py * s) * ix, v = (py * c - px * s) * iy;
          float av = v < 0 ? -v : v;
          float in = inside_of(u, v, av);
          float dome = std::sqrt(in > 0.0f ? in : 0.0f);
          float shaft = 1.0f - av * 5.0f;
          shaft = shaft > 0.0f ? shaft * shaft : 0.0f;
          float z = base + height * dome + tilt * u + ridge * shaft * dome;
          float higher = out[x] > z ? out[x] : z;
          out[x] = in > 0.0f ? higher : out[x];
        }
      };
      if (f.shape == Shape::kDome) each([](float u, float v, float) { return 1.0f - u * u - v * v; });
      else if (f.shape == Shape::kLeaf)
        each([](float u, float v, float) { return 1.02f - u * u - std::sqrt(v * v + 0.0018f); });  // a rubbed crest
      else
        each([=](float u, float v, float) {
          float au = u < 0 ? -u : u;
          float over = (au - straight) * inv_round;  // beyond the straight part, in radii
          over = over > 0.0f ? over : 0.0f;
          return 1.0f - over * over - v * v;
        });
    }
  }
};

}  // namespace

std::unique_ptr<Kind> makeCoin(const SampleOptions& options) { return std::make_unique<Coin>(options); }

}  // namespace relievo::sample
