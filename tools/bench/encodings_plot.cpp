#include "tools/bench/encodings_plot.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace relievo {
namespace {

constexpr double kPanelWidth = 520, kPanelHeight = 420, kPanelLeft = 62, kPanelRight = 18, kPanelTop = 46,
                 kPanelBottom = 52;  // one panel

template <class... A>
void add(std::string& out, const char* format, A... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  out += text;
}

const char* colourOf(const std::string& name) {
  if (name.find('+') != std::string::npos) return "#7a5195";
  return name[0] == 'q' ? "#1f77b4" : name[0] == 'j' ? "#d95f02" : name[0] == 'b' ? "#2a8c4a" : "#333333";
}

// A logarithmic axis, or a linear one.
struct Axis {
  double low, high;
  bool logarithmic;
  double place(double v) const {
    return logarithmic ? (std::log(v) - std::log(low)) / (std::log(high) - std::log(low)) : (v - low) / (high - low);
  }
};

struct Box {
  double x0, y0, x1, y1;
  bool meets(const Box& o) const { return x0 < o.x1 && o.x0 < x1 && y0 < o.y1 && o.y0 < y1; }
};

// One panel with its origin at (ox, 0): PSNR over x(figure).
template <class X>
void panel(std::string& out, double ox, const char* title, const char* x_title,
           const std::vector<EncodingFigures>& figures, const Axis& y, X x_of) {
  double low = 1e300, high = 0;
  for (const auto& f : figures) low = std::min(low, x_of(f)), high = std::max(high, x_of(f));
  const Axis x{low / 1.25, high * 1.3, true};
  const double w = kPanelWidth - kPanelLeft - kPanelRight, h = kPanelHeight - kPanelTop - kPanelBottom;
  auto px = [&](double v) { return ox + kPanelLeft + w * x.place(v); };
  auto py = [&](double v) { return kPanelTop + h * (1 - y.place(v)); };
  add(out, "<text x='%.0f' y='26' font-size='15' font-weight='600' text-anchor='middle'>%s</text>\n",
      ox + kPanelLeft + w / 2, title);
  for (double v = y.low; v <= y.high + 0.1; v += 5) {
    add(out, "<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='#e4e4e4'/>", ox + kPanelLeft, py(v),
        ox + kPanelLeft + w, py(v));
    add(out, "<text x='%.1f' y='%.1f' text-anchor='end'>%.0f</text>\n", ox + kPanelLeft - 7, py(v) + 4, v);
  }
  for (double decade = 0.001; decade < 1e6; decade *= 10) {
    for (double digit : {1.0, 2.0, 5.0}) {
      const double v = decade * digit;
      if (v < x.low || v > x.high) continue;
      add(out, "<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='#e4e4e4'/>", px(v), kPanelTop, px(v),
          kPanelTop + h);
      add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%g</text>\n", px(v), kPanelTop + h + 18, v);
    }
  }
  add(out, "<rect x='%.1f' y='%.1f' width='%.1f' height='%.1f' fill='none' stroke='#888'/>\n", ox + kPanelLeft,
      kPanelTop, w, h);
  add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%s</text>\n", ox + kPanelLeft + w / 2, kPanelHeight - 12,
      x_title);
  add(out,
      "<text transform='translate(%.1f %.1f) rotate(-90)' text-anchor='middle'>PSNR of relit pictures, dB</text>\n",
      ox + 16, kPanelTop + h / 2);
  // Labels take the first of eight places round their point that is free.
  std::vector<Box> taken;
  for (const auto& f : figures)
    if (!f.exact) taken.push_back({px(x_of(f)) - 5, py(f.psnr_db) - 5, px(x_of(f)) + 5, py(f.psnr_db) + 5});
  for (const auto& f : figures) {
    const double cx = px(x_of(f));
    if (f.exact) {
      add(out, "<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='%s' stroke-dasharray='5 4'/>", cx, kPanelTop, cx,
          kPanelTop + h, colourOf(f.name));
      add(out, "<text transform='translate(%.1f %.1f) rotate(-90)' text-anchor='end' fill='%s'>%s: exact</text>\n",
          cx - 5, kPanelTop + 8, colourOf(f.name), f.name.c_str());
      taken.push_back({cx - 18, kPanelTop, cx + 2, kPanelTop + 100});
      taken.push_back({cx - 2, kPanelTop, cx + 2, kPanelTop + h});
      continue;
    }
    const double cy = py(f.psnr_db), width = 6.4 * static_cast<double>(f.name.size());
    add(out, "<circle cx='%.1f' cy='%.1f' r='4' fill='%s'/>", cx, cy, colourOf(f.name));
    struct Place {
      double dx, dy;
    };
    const Place places[] = {{8, -10},          {-8 - width, -10}, {8, 2},   {-8 - width, 2},
                            {-width / 2, -20}, {-width / 2, 8},   {8, -22}, {-8 - width, 14}};
    Box best{};
    for (const Place& p : places) {
      best = {cx + p.dx, cy + p.dy, cx + p.dx + width, cy + p.dy + 12};
      const bool inside =
          best.x0 > ox + kPanelLeft && best.x1 < ox + kPanelLeft + w && best.y0 > kPanelTop && best.y1 < kPanelTop + h;
      if (inside && std::none_of(taken.begin(), taken.end(), [&](const Box& b) { return b.meets(best); })) break;
    }
    taken.push_back(best);
    add(out, "<text x='%.1f' y='%.1f' fill='%s'>%s</text>\n", best.x0, best.y1 - 2, colourOf(f.name), f.name.c_str());
  }
}

}  // namespace

std::string encodingsPlot(const std::vector<EncodingFigures>& figures) {
  double low = 1e9, high = 0;
  for (const auto& f : figures)
    if (!f.exact) low = std::min(low, f.psnr_db), high = std::max(high, f.psnr_db);
  if (high == 0) low = 30, high = 50;
  const Axis y{5 * std::floor(low / 5), 5 * std::ceil((high + 0.5) / 5), false};
  std::string out;
  add(out,
      "<svg xmlns='http://www.w3.org/2000/svg' width='%.0f' height='%.0f' viewBox='0 0 %.0f %.0f' "
      "font-family='sans-serif' font-size='12'>\n",
      2 * kPanelWidth, kPanelHeight, 2 * kPanelWidth, kPanelHeight);
  add(out, "<rect width='100%%' height='100%%' fill='white'/>\n");
  panel(out, 0, "What accuracy costs in size", "texture bytes per pixel in the package, mip levels included", figures,
        y, [](const EncodingFigures& f) { return f.bytes_per_px; });
  panel(out, kPanelWidth, "What accuracy costs in time", "microseconds to decode a page, one thread", figures, y,
        [](const EncodingFigures& f) { return f.decode_us; });
  return out + "</svg>\n";
}

std::string encodingsTable(const std::vector<EncodingFigures>& figures) {
  std::string out =
      "| encoding | PSNR, dB | largest error | bytes per px | decode, pages/s a thread | resident B/texel: rgba8, "
      "blocks | frame, CPU ms: rgba8, blocks | "
      "to settled, CPU ms: rgba8, blocks | encode, CPU s |\n|---|---|---|---|---|---|---|---|---|\n";
  for (const auto& f : figures) {
    const auto pair = [&](const char* format, double rgba8, double blocks) {
      std::string text;
      add(text, format, rgba8);
      if (f.as_blocks) add(text, (", " + std::string(format)).c_str(), blocks);
      return text;
    };
    char psnr[32];
    std::snprintf(psnr, sizeof psnr, "%.1f", f.psnr_db);
    add(out, "| %s | %s | %d | %.2f | %.0f | %s | %s | %s | %.1f |\n", f.name.c_str(), f.exact ? "exact" : psnr,
        f.max_error, f.bytes_per_px, 1e6 / f.decode_us, pair("%.3g", f.rgba8.resident, f.blocks.resident).c_str(),
        pair("%.0f", f.rgba8.frame_cpu_ms, f.blocks.frame_cpu_ms).c_str(),
        pair("%.0f", f.rgba8.settle_cpu_ms, f.blocks.settle_cpu_ms).c_str(), f.encode_cpu_s);
  }
  return out;
}

}  // namespace relievo
