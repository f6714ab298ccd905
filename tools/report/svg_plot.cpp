#include "tools/report/svg_plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>

namespace relievo {
namespace {

constexpr double kWidth = 560, kHeight = 400, kLeftPx = 64, kRightPx = 16, kTopPx = 34, kBottomPx = 50;  // one plot

// The first seven by Okabe and Ito 2008, told apart with any colour vision; the others lie between them. Shapes tell
// series apart besides: colour and shape together come again after 70 series.
constexpr std::array<const char*, 14> kColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9",
                                                  "#e69f00", "#8a8a8a", "#a08c00", "#7b3fb0", "#b3261e",
                                                  "#7cb518", "#6d4c41", "#4a5a8a", "#e0559b"};
constexpr size_t kShapes = 5;

std::string marker(size_t index, double x, double y) {
  std::string out;
  const char* colour = kColours[index % kColours.size()];
  switch (index % kShapes) {
    case 0:
      appendf(out, "<circle cx='%.1f' cy='%.1f' r='4.5' fill='%s'>", x, y, colour);
      break;
    case 1:
      appendf(out, "<rect x='%.1f' y='%.1f' width='8' height='8' fill='%s'>", x - 4, y - 4, colour);
      break;
    case 2:
      appendf(out, "<path d='M%.1f %.1fl5 9h-10z' fill='%s'>", x, y - 5.5, colour);
      break;
    case 3:
      appendf(out, "<path d='M%.1f %.1fl5.5 5.5l-5.5 5.5l-5.5 -5.5z' fill='%s'>", x, y - 5.5, colour);
      break;
    default:
      appendf(out, "<path d='M%.1f %.1fl5 -9h-10z' fill='%s'>", x, y + 5.5, colour);
  }
  return out;
}
const char* markerEnd(size_t index) {
  return index % kShapes == 0 ? "</circle>" : index % kShapes == 1 ? "</rect>" : "</path>";
}

// Values from low to high lie between two places, px.
struct AxisScale {
  double low, high, from, to;
  bool logarithmic;
  double place(double v) const {
    const double t =
        logarithmic ? (std::log(v) - std::log(low)) / (std::log(high) - std::log(low)) : (v - low) / (high - low);
    return from + (to - from) * t;
  }
  std::vector<double> ticks() const {
    std::vector<double> out;
    if (logarithmic) {
      for (double decade = 1e-3; decade < 1e12; decade *= 10)
        for (double digit : {1.0, 2.0, 5.0})
          if (decade * digit >= low && decade * digit <= high && (digit == 1 || high / low < 200))
            out.push_back(decade * digit);
      return out;
    }
    const double rough = (high - low) / 6, decade = std::pow(10, std::floor(std::log10(rough)));
    const double step = decade * (rough > 5 * decade ? 10 : rough > 2 * decade ? 5 : rough > decade ? 2 : 1);
    for (double k = std::ceil(low / step); k * step <= high; ++k) out.push_back(k * step);
    return out;
  }
};

AxisScale scaleOf(const PlotAxis& axis, const std::vector<PlotPoint>& points, double PlotPoint::*value, double from,
                  double to) {
  double low = 1e300, high = -1e300;
  for (const PlotPoint& p : points) low = std::min(low, p.*value), high = std::max(high, p.*value);
  if (axis.logarithmic) return {low / axis.margin, high * axis.margin, from, to, true};
  const double room = std::max(0.1 * (high - low), 1e-6 + 0.01 * std::abs(high));
  return {low - room, high + room, from, to, false};
}

std::string tickText(double v) {
  std::string out;
  if (v >= 1e6) appendf(out, "%gM", v / 1e6);
  else if (v >= 1e3) appendf(out, "%gk", v / 1e3);
  else appendf(out, "%g", std::abs(v) < 1e-12 ? 0.0 : v);
  return out;
}

void addGrid(std::string& out, const AxisScale& x, const AxisScale& y) {
  for (double v : x.ticks()) {
    appendf(out, "<line class='grid' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", x.place(v), kTopPx, x.place(v),
            kHeight - kBottomPx);
    appendf(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%s</text>\n", x.place(v), kHeight - kBottomPx + 17,
            tickText(v).c_str());
  }
  for (double v : y.ticks()) {
    appendf(out, "<line class='grid' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", kLeftPx, y.place(v), kWidth - kRightPx,
            y.place(v));
    appendf(out, "<text x='%.1f' y='%.1f' text-anchor='end'>%s</text>\n", kLeftPx - 6, y.place(v) + 4,
            tickText(v).c_str());
  }
  appendf(out, "<rect class='frame' x='%.1f' y='%.1f' width='%.1f' height='%.1f'/>\n", kLeftPx, kTopPx,
          kWidth - kLeftPx - kRightPx, kHeight - kTopPx - kBottomPx);
}

struct LabelBox {
  double x0, y0, x1, y1;
  bool meets(const LabelBox& o) const { return x0 < o.x1 && o.x0 < x1 && y0 < o.y1 && o.y0 < y1; }
};

// Labels take the first of eight places round their point that is free; without a free one they are left out.
void addLabels(std::string& out, const Plot& plot, const AxisScale& x, const AxisScale& y) {
  std::vector<LabelBox> taken;
  for (const PlotPoint& p : plot.points) {
    const double cx = x.place(p.x), cy = y.place(p.y);
    taken.push_back({cx - 5, cy - 5, cx + 5, cy + 5});
  }
  for (const PlotPoint& p : plot.points) {
    if (p.label.empty()) continue;
    const double cx = x.place(p.x), cy = y.place(p.y), width = 6.0 * static_cast<double>(p.label.size());
    const std::array<std::array<double, 2>, 8> places{{{8, -14},
                                                       {-8 - width, -14},
                                                       {8, 3},
                                                       {-8 - width, 3},
                                                       {-width / 2, -19},
                                                       {-width / 2, 7},
                                                       {8, -26},
                                                       {-8 - width, 16}}};
    for (const auto& [dx, dy] : places) {
      const LabelBox box{cx + dx, cy + dy, cx + dx + width, cy + dy + 12};
      const bool inside =
          box.x0 > kLeftPx && box.x1 < kWidth - kRightPx && box.y0 > kTopPx && box.y1 < kHeight - kBottomPx;
      if (!inside || std::any_of(taken.begin(), taken.end(), [&](const LabelBox& b) { return b.meets(box); })) continue;
      taken.push_back(box);
      appendf(out, "<text class='label' x='%.1f' y='%.1f'>%s</text>\n", box.x0, box.y1 - 2,
              escapedHtml(p.label).c_str());
      break;
    }
  }
}

}  // namespace

void appendf(std::string& out, const char* format, ...) {
  char text[4096];
  va_list values;
  va_start(values, format);
  std::vsnprintf(text, sizeof text, format, values);
  va_end(values);
  out += text;
}

std::string escapedHtml(const std::string& text) {
  std::string out;
  for (char c : text) {
    if (c == '<') out += "&lt;";
    else if (c == '>') out += "&gt;";
    else if (c == '&') out += "&amp;";
    else if (c == '"') out += "&quot;";
    else if (c == '\'') out += "&#39;";
    else out += c;
  }
  return out;
}

std::string plotKey(size_t series) {
  return "<svg viewBox='0 0 14 14' class='key'>" + marker(series, 7, 7) + markerEnd(series) + "</svg>";
}

std::string plotSvg(const Plot& plot) {
  std::string out;
  if (plot.points.empty()) return out;
  const AxisScale x = scaleOf(plot.x, plot.points, &PlotPoint::x, kLeftPx, kWidth - kRightPx),
                  y = scaleOf(plot.y, plot.points, &PlotPoint::y, kHeight - kBottomPx, kTopPx);
  const std::string title = escapedHtml(plot.title);
  appendf(out,
          "<svg viewBox='0 0 %.0f %.0f' role='img' aria-label='%s'>\n<text x='%.0f' y='20' class='title' "
          "text-anchor='middle'>%s</text>\n",
          kWidth, kHeight, title.c_str(), (kLeftPx + kWidth - kRightPx) / 2, title.c_str());
  addGrid(out, x, y);
  appendf(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%s</text>\n", (kLeftPx + kWidth - kRightPx) / 2,
          kHeight - 10, escapedHtml(plot.x.title).c_str());
  appendf(out, "<text transform='translate(15 %.1f) rotate(-90)' text-anchor='middle'>%s</text>\n",
          (kTopPx + kHeight - kBottomPx) / 2, escapedHtml(plot.y.title).c_str());
  for (size_t s = 0; s < plot.series.size(); ++s) {
    std::string line, marks;
    for (const PlotPoint& p : plot.points) {
      if (p.series != s) continue;
      appendf(line, "%s%.1f %.1f", line.empty() ? "M" : "L", x.place(p.x), y.place(p.y));
      if (p.front)
        appendf(marks, "<circle class='ring' cx='%.1f' cy='%.1f' r='8.5' fill='none' stroke-width='1.5'/>",
                x.place(p.x), y.place(p.y));
      marks += marker(s, x.place(p.x), y.place(p.y)) + "<title>" + escapedHtml(p.text) + "</title>" + markerEnd(s);
    }
    if (line.empty()) continue;
    if (plot.series[s].joined)
      out += "<path d='" + line + "' fill='none' stroke='" + kColours[s % kColours.size()] + "' stroke-width='2'" +
             (plot.series[s].dashed ? " stroke-dasharray='3 4'" : "") + "/>\n";
    out += marks + "\n";
  }
  addLabels(out, plot, x, y);
  return out + "</svg>\n";
}

std::string standaloneSvg(const Plot& plot) {
  std::string out = plotSvg(plot), head, legend;
  if (out.empty()) return out;
  constexpr double kRow = 20;
  double y = kHeight + 4;
  for (size_t s = 0; s < plot.series.size(); ++s) {
    const double x = s % 2 == 0 ? kLeftPx : (kLeftPx + kWidth) / 2;
    legend += marker(s, x + 5, y) + markerEnd(s);
    appendf(legend, "<text x='%.0f' y='%.0f'>%s</text>\n", x + 16, y + 4, escapedHtml(plot.series[s].title).c_str());
    if (s % 2 == 1 || s + 1 == plot.series.size()) y += kRow;
  }
  if (std::any_of(plot.points.begin(), plot.points.end(), [](const PlotPoint& p) { return p.front; })) {
    appendf(legend, "<circle class='ring' cx='%.0f' cy='%.0f' r='8.5' fill='none' stroke-width='1.5'/>", kLeftPx + 5,
            y);
    appendf(legend, "<text x='%.0f' y='%.0f'>no other point is better on both axes</text>\n", kLeftPx + 16, y + 4);
    y += kRow;
  }
  appendf(head, "<svg xmlns='http://www.w3.org/2000/svg' width='%.0f' height='%.0f' viewBox='0 0 %.0f %.0f'", kWidth, y,
          kWidth, y);
  out.replace(0, out.find('>'), head);
  // A page's colours are variables, which not every viewer of SVG files knows: here they are written out.
  const std::string style =
      "<style>text{fill:#1b1b1b;font:12px sans-serif}.title{font-size:15px;font-weight:600}"
      ".label{font-size:11px;fill:#666}.grid{stroke:#ddd}.frame{fill:none;stroke:#666}.ring{stroke:#1b1b1b}.paper{fill:"
      "#fff}"
      "@media(prefers-color-scheme:dark){text{fill:#e8e8e8}.label{fill:#a5a5a5}.grid{stroke:#3d3d3d}"
      ".frame{stroke:#a5a5a5}.ring{stroke:#e8e8e8}.paper{fill:#161616}}</style>\n<rect class='paper' width='100%' "
      "height='100%'/>\n";
  out.insert(out.find('\n') + 1, style);
  return out.insert(out.rfind("</svg>"), legend);
}

const char* const kReportStyle = R"(
:root{color-scheme:light dark;--ink:#1b1b1b;--soft:#666;--line:#ddd;--paper:#fff;--bad:#b3261e}
@media(prefers-color-scheme:dark){:root{--ink:#e8e8e8;--soft:#a5a5a5;--line:#3d3d3d;--paper:#161616;--bad:#ff8a80}}
body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);background:var(--paper);
max-width:1240px;margin:24px auto;padding:0 16px}
h3.knob::first-letter{text-transform:uppercase}
h1{font-size:24px}h2{font-size:18px;margin-top:32px}p{max-width:90ch}small{color:var(--soft)}
.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:12px}
svg text{fill:var(--ink);font:12px system-ui,sans-serif}svg .title{font-size:15px;font-weight:600}
svg .grid{stroke:var(--line)}svg .frame{fill:none;stroke:var(--soft)}svg .ring{stroke:var(--ink)}
svg .label{font-size:11px;fill:var(--soft)}svg .front{stroke-width:2.5}
.key{width:14px;height:14px;vertical-align:-2px}
.legend span{white-space:nowrap;margin-right:14px}.ramp{width:420px;max-width:100%}
.scroll{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:13px}
th,td{padding:3px 9px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child,.left{text-align:left}
.bad{color:var(--bad);font-weight:600}
figure{margin:0}
figure img{width:100%;height:auto;border:1px solid var(--line);
background:repeating-conic-gradient(#0000 0 25%,#8883 0 50%) 0 0/16px 16px}
figcaption{font-size:13px}dt{font-weight:600}dd{margin:0 0 6px 0}
)";

}  // namespace relievo
