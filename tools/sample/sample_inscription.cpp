// A Roman inscription: capitals cut with a V-shaped chisel groove into limestone, worn, pitted, cracked, with remains
// of minium in the cuts. 600 mm on the shorter side; cuts are 4 to 6 mm deep.
#include "tools/sample/sample_font.h"
#include "tools/sample/sample_kinds.h"

namespace relievo::sample {
namespace {

constexpr double kInscriptionShortMm = 600;
constexpr float kSlope = 1.65f;  // a V of some 62 degrees
constexpr float kDeepestMm = 5.8f;
constexpr double kReachMm = 2.2;  // beyond a stroke's border nothing is touched: edge rounding + wobble < reach
constexpr float kCrackDeepMm = 2.2f;

class Inscription final : public Kind {
 public:
  explicit Inscription(const SampleOptions& o)
      : seed_(mix32(static_cast<uint32_t>(o.seed) * 7919u + static_cast<uint32_t>(o.seed >> 32) + 11)) {
    short_mm = kInscriptionShortMm;
    const double mm = kInscriptionShortMm / static_cast<double>(std::min(o.width, o.height));
    const double w = static_cast<double>(o.width) * mm, h = static_cast<double>(o.height) * mm;
    layOut(w, h, mm);
    layCracks(w, h, o.seed);
    max_mm = kReliefMm;
    min_mm = -(kReliefMm + kDeepestMm + 0.3f + kCrackDeepMm + kSpallMm + 4 * (0.9f + 0.7f + 0.3f + 0.12f));
    gloss_strength = 0.25f;
  }

  void eval(const Block& b, bool colour, Layers& out) const override {
    const Stone s{out.height, out.tmp[1], out.tmp[2], out.tmp[3], out.tmp[4], out.tmp[5], out.tmp[6], out.tmp[7]};
    hew(b, s);
    const bool letters = strokes_.eval(b, out.tmp[0], out.found);
    if (letters) cutLetters(b, out.tmp[0], s);
    else fill(b, s.cut, 0);
    if (cracks_.eval(b, s.crack, out.found)) crack(b, s);
    else fill(b, s.crack, 0);
    weather(b, s);
    if (letters) {
      // Chisel marks across the faces of the cut.
      Plane& marks = s.fine;
      fill(b, marks, 0);
      addNoise(b, marks, 14, 2.6, 0.16f, seed_ + 10);
      addNoise(b, marks, 5, 0.8, 0.06f, seed_ + 11);
      forPixels(b, [&](int i, int, int) { s.height[i] += marks[i] * clamp01(s.cut[i] * 0.8f); });
    }
    if (colour) paint(b, s, out);
  }

 private:
  // The stone's planes of a block; fine is each step's own.
  struct Stone {
    Plane &height, &low, &grain, &fine, &cut, &crack, &spall, &pits;
  };

  // A hewn, worn face.
  void hew(const Block& b, const Stone& s) const {
    fill(b, s.low, 0);
    addFbm(b, s.low, 190, 0.62f, 0.52f, 5, seed_ + 1);
    fill(b, s.grain, 0);
    addFbm(b, s.grain, 13, 0.17f, 0.66f, 10, seed_ + 2);
    // Flaked places: where a slow noise is high, a skin of stone has come off, with a ragged rim.
    fill(b, s.spall, 0);
    addFbm(b, s.spall, 120, 0.55f, 0.5f, 8, seed_ + 3);
    forPixels(b, [&](int i, int, int) { s.spall[i] = smooth01((s.spall[i] - 0.26f) * 18.0f); });
  }

  // sd: the distance inside the strokes, mm.
  void cutLetters(const Block& b, const Plane& sd, const Stone& s) const {
    Plane& wobble = s.fine;
    fill(b, wobble, 0);
    addFbm(b, wobble, 9, 0.36f, 0.58f, 7, seed_ + 4);
    forPixels(b, [&](int i, int, int) {
      float edge = 0.55f + 0.5f * s.low[i];  // rounding of the rim, mm: 0.1 .. 1.2
      edge = edge < 0.18f ? 0.18f : (edge > 1.2f ? 1.2f : edge);
      float inside = sd[i] + wobble[i];
      float t = inside + edge;
      float round = t * t / (4.0f * edge);
      float v = inside >= edge ? inside : (t > 0.0f ? round : 0.0f);
      v = v * kSlope;
      s.cut[i] = v < kDeepestMm ? v : kDeepestMm;
    });
  }

  void crack(const Block& b, const Stone& s) const {
    Plane& jag = s.fine;
    fill(b, jag, 0);
    addFbm(b, jag, 7, 0.35f, 0.62f, 7, seed_ + 5);
    forPixels(b, [&](int i, int, int) {
      float v = (s.crack[i] + jag[i]) * 3.2f;
      v = v > 0.0f ? v : 0.0f;
      s.crack[i] = v < kCrackDeepMm ? v : kCrackDeepMm;
    });
  }

  // Dents of all sizes; the cut faces are younger and cleaner.
  void weather(const Block& b, const Stone& s) const {
    fill(b, s.pits, 0);
    addDents(b, s.pits, 34, 0.05f, 0.9f, seed_ + 6);
    addDents(b, s.pits, 12, 0.22f, 0.7f, seed_ + 7);
    addDents(b, s.pits, 4.2, 0.34f, 0.3f, seed_ + 8);
    addDents(b, s.pits, 1.3, 0.40f, 0.12f, seed_ + 9);
    forPixels(b, [&](int i, int, int) {
      float clean = 1.0f - 0.55f * clamp01(s.cut[i] * 0.6f);
      float ragged = 0.72f + 4.0f * s.grain[i];
      ragged = ragged < 0.1f ? 0.1f : (ragged > 1.0f ? 1.0f : ragged);
      s.pits[i] *= ragged;
      s.height[i] =
          s.low[i] + clean * s.grain[i] + clean * s.pits[i] - s.cut[i] - s.crack[i] - kSpallMm * s.spall[i] * clean;
    });
  }

  // Warm limestone, grey-veined; patina in what is low; minium left in patches of the cuts.
  void paint(const Block& b, const Stone& s, Layers& out) const {
    Plane &tone = out.tmp[0], &vein = s.fine;
    fill(b, tone, 0);
    addFbm(b, tone, 150, 0.55f, 0.62f, 7, seed_ + 20);
    fill(b, vein, 0);
    addFbm(b, vein, 210, 0.6f, 0.55f, 9, seed_ + 21);
    forPixels(b, [&](int i, int, int) {
      float v = vein[i] < 0 ? -vein[i] : vein[i];
      v = 1.0f - clamp01(v * 16.0f);
      v = v * v * 0.34f;
      float g = s.grain[i] * 70.0f;
      float deep = clamp01(s.cut[i] * 0.30f);
      float hollow = clamp01(-s.pits[i] * 1.4f) * 0.6f;
      float dirt = clamp01(0.30f + 1.1f * tone[i]);
      float shade = 1.0f - 0.20f * dirt - 0.34f * hollow - 0.22f * deep;
      float r = (238.0f + 16.0f * tone[i] + g) * shade;
      float gr = (226.0f + 10.0f * tone[i] + g) * shade;
      float bl = (202.0f - 6.0f * tone[i] + g) * shade;
      r = mixf(r, 142.0f, v), gr = mixf(gr, 138.0f, v), bl = mixf(bl, 136.0f, v);
      // Fresh stone where it flaked.
      float f = 0.45f * s.spall[i];
      r = mixf(r, 231.0f + g, f), gr = mixf(gr, 217.0f + g, f), bl = mixf(bl, 190.0f + g, f);
      float red = clamp01(deep * 1.6f - 0.25f) * clamp01(0.62f - 2.2f * tone[i] + 1.3f * s.grain[i]);
      r = mixf(r, 158.0f, 0.72f * red), gr = mixf(gr, 66.0f, 0.72f * red), bl = mixf(bl, 44.0f, 0.72f * red);
      float dark = clamp01(s.crack[i] * 0.7f) * 0.7f;
      out.red[i] = mixf(r, 58.0f, dark), out.green[i] = mixf(gr, 50.0f, dark), out.blue[i] = mixf(bl, 42.0f, dark);
      out.cavity[i] = 1.0f - 0.42f * clamp01(s.cut[i] * 0.19f) - 0.30f * clamp01(s.crack[i] * 0.6f) - 0.18f * hollow;
      out.cavity[i] = out.cavity[i] < kMinCavity ? kMinCavity : out.cavity[i];
      out.gloss[i] = clamp01(0.22f + 0.2f * tone[i] - 0.2f * dirt - 0.2f * deep);
    });
  }

  static constexpr float kReliefMm = 1.6f;  // low + grain, both bounded by their sums of amplitudes
  static constexpr float kSpallMm = 1.1f;
  uint32_t seed_;
  StrokeField strokes_, cracks_;

  void layOut(double w, double h, double mm) {
    static const char* const kLines[] = {"LVX.ET.VMBRA", "FORMAM.DANT", "QVOD.MANVS", "FECIT.OCVLVS", "TANGIT"};
    constexpr double kPitch = 1.62, kSpace = 0.12;
    double widest = 0;
    for (const char* line : kLines) widest = std::max(widest, lineWidth(line, kSpace));
    const double cap = std::min({0.82 * w / widest, 0.80 * h / (4 * kPitch + 1), 0.11 * kInscriptionShortMm});
    const int steps = mm < 0.08 ? 220 : 96;
    std::vector<Segment> all;
    double y = 0.5 * h - 0.5 * (4 * kPitch + 1) * cap + cap;  // first baseline
    for (const char* line : kLines) {
      std::vector<Segment> glyphs;
      double x = 0;
      for (const char* c = line; *c; ++c) x += appendGlyph(*c, x, steps, glyphs) + kSpace;
      const double left = 0.5 * w - 0.5 * (x - kSpace) * cap;
      for (const Segment& s : glyphs)
        all.push_back({left + s.ax * cap, y - s.ay * cap, left + s.bx * cap, y - s.by * cap, s.ra * cap, s.rb * cap});
      y += kPitch * cap;
    }
    // A double rule around the field.
    for (double inset : {0.045 * kInscriptionShortMm, 0.062 * kInscriptionShortMm}) {
      double r = inset > 30 ? 0.9 : 2.1;
      double x0 = inset, y0 = inset, x1 = w - inset, y1 = h - inset;
      all.push_back({x0, y0, x1, y0, r, r});
      all.push_back({x1, y0, x1, y1, r, r});
      all.push_back({x1, y1, x0, y1, r, r});
      all.push_back({x0, y1, x0, y0, r, r});
    }
    strokes_.build(std::move(all), kReachMm);
  }

  void layCracks(double w, double h, uint64_t seed) {
    Dice dice(seed * 31 + 5);
    std::vector<Segment> all;
    // From border to border by halving, each middle moved aside by a share of the length.
    auto crack = [&](double ax, double ay, double bx, double by, double ra, double rb) {
      struct Point {
        double x, y;
      };
      std::vector<Point> line{{ax, ay}, {bx, by}};
      for (int level = 0; level < 7; ++level) {
        std::vector<Point> finer;
        for (size_t i = 0; i + 1 < line.size(); ++i) {
          Point p = line[i], q = line[i + 1];
          double k = dice.range(-0.16, 0.16);
          finer.push_back(p);
          finer.push_back({0.5 * (p.x + q.x) - k * (q.y - p.y), 0.5 * (p.y + q.y) + k * (q.x - p.x)});
        }
        finer.push_back(line.back());
        line = std::move(finer);
      }
      for (size_t i = 0; i + 1 < line.size(); ++i) {
        double t0 = static_cast<double>(i) / static_cast<double>(line.size() - 1),
               t1 = static_cast<double>(i + 1) / static_cast<double>(line.size() - 1);
        all.push_back({line[i].x, line[i].y, line[i + 1].x, line[i + 1].y, ra + (rb - ra) * t0, ra + (rb - ra) * t1});
      }
      return line[line.size() / 2 + line.size() / 8];
    };
    double s = kInscriptionShortMm;
    auto fork = crack(w - s * dice.range(0.20, 0.34), -5, w + 5, s * dice.range(0.36, 0.55), 1.0, 0.7);
    crack(fork.x, fork.y, w - s * dice.range(0.02, 0.06), std::min(h, fork.y + s * dice.range(0.25, 0.4)), 0.55, -0.25);
    crack(-5, h - s * dice.range(0.22, 0.3), s * dice.range(0.24, 0.36), h - s * dice.range(0.03, 0.08), 0.75, -0.3);
    cracks_.build(std::move(all), 1.6);
  }
};

}  // namespace

std::unique_ptr<Kind> makeInscription(const SampleOptions& options) { return std::make_unique<Inscription>(options); }

}  // namespace relievo::sample
