// The report as a page: curves of error against triangles and time, a table, and the error painted on the relief.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <filesystem>
#include <functional>

#include "tools/compare/compare_report.h"

namespace relievo {
namespace {

constexpr double kWidth = 560, kHeight = 400, kLeftPx = 64, kRightPx = 16, kTopPx = 34, kBottomPx = 50;  // one panel
constexpr double kLeastPx = 0.01;  // what is below is drawn there: measuring is not finer
constexpr int kPicturePx = 640;    // at most, wide

// Okabe and Ito 2008, told apart with any colour vision, and shapes besides; the last two are for controls.
constexpr std::array<const char*, 8> kColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                 "#56b4e9", "#e69f00", "#8a8a8a", "#a08c00"};

__attribute__((format(printf, 2, 3))) void add(std::string& out, const char* format, ...) {
  char text[1024];
  va_list values;
  va_start(values, format);
  std::vsnprintf(text, sizeof text, format, values);
  va_end(values);
  out += text;
}

std::string escaped(const std::string& text) {
  std::string out;
  for (char c : text) {
    if (c == '<') out += "&lt;";
    else if (c == '>') out += "&gt;";
    else if (c == '&') out += "&amp;";
    else if (c == '"') out += "&quot;";
    else out += c;
  }
  return out;
}

std::string marker(size_t index, double x, double y) {
  std::string out;
  const char* colour = kColours[index % kColours.size()];
  switch (index % 4) {
    case 0:
      add(out, "<circle cx='%.1f' cy='%.1f' r='4.5' fill='%s'>", x, y, colour);
      break;
    case 1:
      add(out, "<rect x='%.1f' y='%.1f' width='8' height='8' fill='%s'>", x - 4, y - 4, colour);
      break;
    case 2:
      add(out, "<path d='M%.1f %.1fl5 9h-10z' fill='%s'>", x, y - 5.5, colour);
      break;
    default:
      add(out, "<path d='M%.1f %.1fl5.5 5.5l-5.5 5.5l-5.5 -5.5z' fill='%s'>", x, y - 5.5, colour);
  }
  return out;
}
const char* markerEnd(size_t index) { return index % 4 == 0 ? "</circle>" : index % 4 == 1 ? "</rect>" : "</path>"; }

struct Axis {
  double low, high, from, to;
  double place(double v) const {
    return from + (to - from) * (std::log(v) - std::log(low)) / (std::log(high) - std::log(low));
  }
};

struct Point {
  size_t strategy;
  double budget_px, x, y;
  std::string text;
};

std::string panel(const char* title, const char* x_title, const char* y_title, const std::vector<Point>& points) {
  std::string out;
  double x0 = 1e300, x1 = 0, y0 = 1e300, y1 = 0;
  for (const Point& p : points) {
    x0 = std::min(x0, p.x), x1 = std::max(x1, p.x);
    y0 = std::min(y0, p.y), y1 = std::max(y1, p.y);
  }
  if (points.empty()) return out;
  Axis x{x0 / 1.4, x1 * 1.4, kLeftPx, kWidth - kRightPx}, y{y0 / 1.4, y1 * 1.4, kHeight - kBottomPx, kTopPx};
  add(out,
      "<svg viewBox='0 0 %.0f %.0f' role='img' aria-label='%s'>\n<text x='%.0f' y='20' class='title' "
      "text-anchor='middle'>%s</text>\n",
      kWidth, kHeight, title, (kLeftPx + kWidth - kRightPx) / 2, title);
  for (double decade = 1e-3; decade < 1e9; decade *= 10)
    for (double digit : {1.0, 2.0, 5.0}) {
      double v = decade * digit;
      if (v >= x.low && v <= x.high && (digit == 1 || x.high / x.low < 200)) {
        add(out, "<line class='grid' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", x.place(v), kTopPx, x.place(v),
            kHeight - kBottomPx);
        if (v >= 1e6)
          add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%gM</text>\n", x.place(v), kHeight - kBottomPx + 17,
              v / 1e6);
        else if (v >= 1e3)
          add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%gk</text>\n", x.place(v), kHeight - kBottomPx + 17,
              v / 1e3);
        else
          add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%g</text>\n", x.place(v), kHeight - kBottomPx + 17, v);
      }
      if (v >= y.low && v <= y.high) {
        add(out, "<line class='grid' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", kLeftPx, y.place(v), kWidth - kRightPx,
            y.place(v));
        add(out, "<text x='%.1f' y='%.1f' text-anchor='end'>%g</text>\n", kLeftPx - 6, y.place(v) + 4, v);
      }
    }
  add(out, "<rect class='frame' x='%.1f' y='%.1f' width='%.1f' height='%.1f'/>\n", kLeftPx, kTopPx,
      kWidth - kLeftPx - kRightPx, kHeight - kTopPx - kBottomPx);
  add(out, "<text x='%.1f' y='%.1f' text-anchor='middle'>%s</text>\n", (kLeftPx + kWidth - kRightPx) / 2, kHeight - 10,
      x_title);
  add(out, "<text transform='translate(15 %.1f) rotate(-90)' text-anchor='middle'>%s</text>\n",
      (kTopPx + kHeight - kBottomPx) / 2, y_title);
  for (size_t s = 0; s < lodStrategies().size(); ++s) {
    std::string line;
    for (const Point& p : points)
      if (p.strategy == s) add(line, "%s%.1f %.1f", line.empty() ? "M" : "L", x.place(p.x), y.place(p.y));
    if (line.empty()) continue;
    add(out, "<path d='%s' fill='none' stroke='%s' stroke-width='2'%s/>\n", line.c_str(), kColours[s % kColours.size()],
        lodStrategies()[s].control ? " stroke-dasharray='3 4'" : "");
    for (const Point& p : points) {
      if (p.strategy != s) continue;
      out += marker(s, x.place(p.x), y.place(p.y)) + "<title>" + escaped(p.text) + "</title>" + markerEnd(s);
    }
    out += "\n";
  }
  return out + "</svg>\n";
}

size_t indexOf(const StrategyEntry* entry) {
  for (size_t s = 0; s < lodStrategies().size(); ++s)
    if (&lodStrategies()[s] == entry) return s;
  return 0;
}

std::string legend(const CompareFigures& all) {
  std::string out = "<p class='legend'>";
  const StrategyEntry* last = nullptr;
  for (const StrategyFigures& run : all.runs) {
    if (run.strategy == last) continue;
    last = run.strategy;
    size_t s = indexOf(last);
    out += "<span><svg viewBox='0 0 14 14' class='key'>" + marker(s, 7, 7) + markerEnd(s) + "</svg> " +
           escaped(last->title) + (last->control ? " (control)" : "") + (run.available ? "" : ": not available here") +
           "</span> ";
  }
  return out + "</p>\n";
}

std::string table(const CompareFigures& all) {
  std::string out =
      "<div "
      "class='scroll'><table><thead><tr><th>strategy</th><th>budget<br>px</th><th>predicted<br>px</th><th>max<br>px</"
      "th><th>p99<br>px</th><th>RMS<br>px</th>"
      "<th>pop<br>px</th><th>crack<br>pixels</th><th>bits "
      "that<br>differ</th><th>silhouette<br>pixels</th><th>triangles<br>median</th><th>draw<br>calls</th>"
      "<th>select<br>ms</th><th>frame<br>ms</th><th>resident<br>MiB</th><th>streamed<br>MiB</th></tr></thead><tbody>\n";
  for (const StrategyFigures& run : all.runs) {
    add(out, "<tr><td>%s</td><td>%g</td>", escaped(run.strategy->title).c_str(), run.budget_px);
    if (!run.available) {
      out += "<td colspan='14' class='left'>not available here: " + escaped(run.why_not) + "</td></tr>\n";
      continue;
    }
    RunSummary s = summaryOf(run, all);
    if (s.predicted_px >= 0) add(out, "<td%s>%.3g</td>", s.above_bound_frames ? " class='bad'" : "", s.predicted_px);
    else out += "<td>none</td>";
    add(out, "<td>%.3g</td><td>%.3g</td><td>%.3g</td><td>%.3g</td>", s.max_px, s.p99_px, s.rms_px, s.pop_px);
    add(out, "<td%s>%llu</td>", s.crack_pixels ? " class='bad'" : "", static_cast<unsigned long long>(s.crack_pixels));
    if (s.seams_known)
      add(out, "<td%s>%llu</td>", s.seams_mismatched ? " class='bad'" : "",
          static_cast<unsigned long long>(s.seams_mismatched));
    else out += "<td>not known</td>";
    add(out, "<td>%llu</td><td>%.0f</td><td>%u</td>", static_cast<unsigned long long>(s.silhouette_pixels), s.triangles,
        s.max_draw_calls);
    add(out, "<td>%.2f<small> %.2f to %.2f</small></td><td>%.1f<small> %.1f to %.1f</small></td>", s.select_ms.median,
        s.select_ms.low, s.select_ms.high, s.frame_ms.median, s.frame_ms.low, s.frame_ms.high);
    add(out, "<td>%.2f</td><td>%.2f</td></tr>\n", static_cast<double>(s.max_resident_bytes) / 1048576.0,
        static_cast<double>(s.streamed_bytes) / 1048576.0);
  }
  return out + "</tbody></table></div>\n";
}

// Plasma (matplotlib, CC0), light for small: told apart in grey, too.
std::array<double, 3> rampAt(double t) {
  static constexpr double kStops[6][3] = {{240, 240, 240}, {253, 202, 38}, {251, 143, 62},
                                          {203, 70, 121},  {125, 3, 168},  {20, 8, 120}};
  t = std::clamp(t, 0.0, 1.0) * 5;
  int k = std::min(static_cast<int>(t), 4);
  double f = t - k;
  std::array<double, 3> c{};
  for (size_t i = 0; i < 3; ++i) c[i] = kStops[k][i] * (1 - f) + kStops[k + 1][i] * f;
  return c;
}

std::string rampKey(double budget_px) {
  std::string out = "<svg viewBox='0 0 420 40' class='ramp'><defs><linearGradient id='ramp'>";
  for (int k = 0; k <= 10; ++k) {
    auto c = rampAt(k / 10.0);
    add(out, "<stop offset='%d%%' stop-color='rgb(%.0f,%.0f,%.0f)'/>", 10 * k, c[0], c[1], c[2]);
  }
  out += "</linearGradient></defs><rect x='10' y='2' width='400' height='14' fill='url(#ramp)'/>";
  for (int k = 0; k <= 4; ++k)
    add(out, "<text x='%d' y='32' text-anchor='%s'>%g px</text>", 10 + 100 * k,
        k == 0   ? "start"
        : k == 4 ? "end"
                 : "middle",
        budget_px * k / 2);
  return out + "</svg>\n";
}

constexpr const char* kStyle = R"(
:root{color-scheme:light dark;--ink:#1b1b1b;--soft:#666;--line:#ddd;--paper:#fff;--bad:#b3261e}
@media(prefers-color-scheme:dark){:root{--ink:#e8e8e8;--soft:#a5a5a5;--line:#3d3d3d;--paper:#161616;--bad:#ff8a80}}
body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);background:var(--paper);
max-width:1240px;margin:24px auto;padding:0 16px}
h1{font-size:24px}h2{font-size:18px;margin-top:32px}p{max-width:90ch}small{color:var(--soft)}
.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:12px}
svg text{fill:var(--ink);font:12px system-ui,sans-serif}svg .title{font-size:15px;font-weight:600}
svg .grid{stroke:var(--line)}svg .frame{fill:none;stroke:var(--soft)}
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

}  // namespace

std::vector<ReportPicture> reportPictures(const ComparePlan& plan, const CompareFigures& all) {
  std::vector<ReportPicture> out;
  double budget = plan.budgets_px[(plan.budgets_px.size() - 1) / 2];
  int block = (plan.width_px + kPicturePx - 1) / kPicturePx;
  for (const StrategyFigures& run : all.runs) {
    if (!run.available || run.budget_px != budget || run.picture_error_px.empty()) continue;
    ReportPicture p;
    p.run = &run;
    p.width_px = plan.width_px / block;
    p.height_px = plan.height_px / block;
    if (p.width_px == 0 || p.height_px == 0) continue;
    p.rgba.assign(static_cast<size_t>(p.width_px) * static_cast<size_t>(p.height_px) * 4, 0);
    for (int y = 0; y < p.height_px; ++y)
      for (int x = 0; x < p.width_px; ++x) {
        double error = -1, shade = 0;
        bool hole = false;
        for (int j = 0; j < block; ++j)
          for (int i = 0; i < block; ++i) {
            size_t at = static_cast<size_t>(plan.height_px - 1 - (y * block + j)) * static_cast<size_t>(plan.width_px) +
                        static_cast<size_t>(x * block + i);
            float e = run.picture_error_px[at];
            hole = hole || std::isnan(e);
            if (!(e > error)) continue;
            error = e;
            shade = run.picture_shade[at];
          }
        if (hole || error < 0) continue;  // a crack of one pixel shows
        auto colour = rampAt(error / (2 * budget));
        uint8_t* to = &p.rgba[4 * (static_cast<size_t>(y) * static_cast<size_t>(p.width_px) + static_cast<size_t>(x))];
        for (size_t c = 0; c < 3; ++c) to[c] = static_cast<uint8_t>(std::clamp(colour[c] * shade, 0.0, 255.0));
        to[3] = 255;
      }
    out.push_back(std::move(p));
  }
  return out;
}

std::string base64(std::span<const uint8_t> bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    size_t count = std::min<size_t>(3, bytes.size() - i);
    uint32_t v = 0;
    for (size_t k = 0; k < 3; ++k) v = v << 8 | (k < count ? bytes[i + k] : 0u);
    for (size_t k = 0; k < 4; ++k) out += k <= count ? kDigits[(v >> (18 - 6 * k)) & 63] : '=';
  }
  return out;
}

std::string reportHtml(const ComparePlan& plan, const CompareFigures& all, const std::vector<ReportPicture>& pictures) {
  const PatchDomain& d = plan.package->manifest().domain;
  std::string name = escaped(std::filesystem::path(plan.package->path()).filename().string());
  std::string out =
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
      "content='width=device-width'>\n<title>relievo compare: " +
      name + "</title>\n<style>" + kStyle + "</style></head><body>\n<h1>LOD strategies over " + name + "</h1>\n";
  if (d.isFlat())
    add(out, "<p>%llu x %llu px, %g mm a px", static_cast<unsigned long long>(d.flat().width_px),
        static_cast<unsigned long long>(d.flat().height_px), d.mm_per_px);
  else
    add(out, "<p>%u patches of %d x %d cells over a base mesh", d.patchCount(), kPagePx << d.relief_depth,
        kPagePx << d.relief_depth);
  add(out, ", heights x %g; %zu frames of %d x %d px along ", plan.exaggerate, all.frame_count, plan.width_px,
      plan.height_px);
  out += escaped(std::filesystem::path(plan.path).filename().string()) + "; " + escaped(all.renderer) + ", " +
         escaped(all.version) + ".</p>\n";
  add(out,
      "<p>The error of a pixel is its distance to where the full-resolution relief has the place that it shows. "
      "Measuring itself is off by at most %.3g px (full "
      "resolution measured like a strategy). Silhouettes are compared with %s of at most %llu triangles a frame.</p>\n",
      all.floor.max_px, all.reference_whole ? "full resolution," : "a uniform grid, coarser than full resolution,",
      static_cast<unsigned long long>(all.reference_triangles));
  uint64_t pixels = 0, edge_on = 0;
  for (const StrategyFigures& run : all.runs) {
    RunSummary s = summaryOf(run, all);
    pixels += s.pixels;
    edge_on += s.edge_on_pixels;
  }
  add(out,
      "<p>%llu pixels are measured; %llu more show triangles so edge-on (a pixel is more than %.0f cells wide) that no "
      "rasteriser knows their place.</p>\n",
      static_cast<unsigned long long>(pixels), static_cast<unsigned long long>(edge_on), kMostCellsAPixel);
  out += "<h2>What accuracy costs</h2>\n" + legend(all) + "<div class='panels'>\n";
  struct Panel {
    const char *title, *x_title, *y_title;
    std::function<double(const RunSummary&)> x, y;
  };
  const Panel panels[] = {
      {"Largest error against triangles", "triangles, median over the frames", "largest error, px",
       [](const RunSummary& s) { return s.triangles; }, [](const RunSummary& s) { return s.max_px; }},
      {"Largest error against time", "choosing and drawing a frame, ms (medians)", "largest error, px",
       [](const RunSummary& s) { return s.select_ms.median + s.frame_ms.median; },
       [](const RunSummary& s) { return s.max_px; }},
      {"Error of 99 % of pixels against triangles", "triangles, median over the frames",
       "p99 of the error, worst frame, px", [](const RunSummary& s) { return s.triangles; },
       [](const RunSummary& s) { return s.p99_px; }},
      {"Error of 99 % of pixels against time", "choosing and drawing a frame, ms (medians)",
       "p99 of the error, worst frame, px", [](const RunSummary& s) { return s.select_ms.median + s.frame_ms.median; },
       [](const RunSummary& s) { return s.p99_px; }}};
  for (const Panel& p : panels) {
    std::vector<Point> points;
    for (const StrategyFigures& run : all.runs) {
      if (!run.available) continue;
      RunSummary s = summaryOf(run, all);
      char text[200];
      std::snprintf(text, sizeof text, "%s, budget %g px: max %.3g px, p99 %.3g px, %.0f triangles, %.2f + %.1f ms",
                    run.strategy->title.c_str(), run.budget_px, s.max_px, s.p99_px, s.triangles, s.select_ms.median,
                    s.frame_ms.median);
      points.push_back(
          {indexOf(run.strategy), run.budget_px, std::max(p.x(s), 1e-3), std::max(p.y(s), kLeastPx), text});
    }
    out += panel(p.title, p.x_title, p.y_title, points);
  }
  add(out,
      "</div>\n<p><small>Down and to the left is better. A point a budget; errors below %g px are drawn there. Times "
      "are for geometry alone, without shading.</small></p>\n",
      kLeastPx);
  out += "<h2>Figures</h2>\n" + table(all);
  out +=
      "<p><small>Over all frames: largest values; RMS over all pixels; sums of pixels, bits and streamed bytes; "
      "medians of triangles and times, with the fastest and "
      "slowest frame. What is in colour is a defect: above the bound, a crack, a vertex that both sides of a seam do "
      "not share bit for bit.</small></p>\n<dl>\n";
  const StrategyEntry* last = nullptr;
  for (const StrategyFigures& run : all.runs) {
    if (run.strategy == last) continue;
    last = run.strategy;
    out += "<dt>" + escaped(last->title) + " <small>" + escaped(last->name) + "</small></dt><dd>" +
           escaped(last->purpose) + (last->control ? " (a negative control)" : "") + "</dd>\n";
  }
  out += "</dl>\n";
  if (pictures.empty()) return out + "</body></html>\n";
  add(out, "<h2>Where the error is</h2>\n<p>Frame %d, budget %g px. Chequered: nothing is drawn.</p>\n",
      all.picture_frame, pictures[0].run->budget_px);
  out += rampKey(pictures[0].run->budget_px) + "<div class='panels'>\n";
  for (const ReportPicture& p : pictures) {
    const FrameFigures& f = p.run->frames[static_cast<size_t>(all.picture_frame)];
    std::string title = escaped(p.run->strategy->title);
    out += "<figure><img alt='Error of " + title + "' src='" + p.uri + "'><figcaption>" + title;
    add(out, ": max %.3g px, p99 %.3g px, %llu triangles</figcaption></figure>\n", f.error.max_px, f.error.p99_px,
        static_cast<unsigned long long>(f.triangles));
  }
  return out + "</div>\n</body></html>\n";
}

}  // namespace relievo
