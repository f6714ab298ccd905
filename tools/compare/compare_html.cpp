// The report as a page: curves of error against triangles and time, a table, and the error painted on the relief.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>

#include "tools/compare/compare_report.h"
#include "tools/report/svg_plot.h"

namespace relievo {
namespace {

constexpr double kLeastPx = 0.01;  // what is below is drawn there: measuring is not finer
constexpr int kPicturePx = 640;    // at most, wide

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
    out += "<span>" + plotKey(s) + " " + escapedHtml(last->title) + (last->control ? " (control)" : "") +
           (run.available ? "" : ": not available here") + "</span> ";
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
    appendf(out, "<tr><td>%s</td><td>%g</td>", escapedHtml(run.strategy->title).c_str(), run.budget_px);
    if (!run.available) {
      out += "<td colspan='14' class='left'>not available here: " + escapedHtml(run.why_not) + "</td></tr>\n";
      continue;
    }
    RunSummary s = summaryOf(run, all);
    if (s.predicted_px >= 0)
      appendf(out, "<td%s>%.3g</td>", s.above_bound_frames ? " class='bad'" : "", s.predicted_px);
    else out += "<td>none</td>";
    appendf(out, "<td>%.3g</td><td>%.3g</td><td>%.3g</td><td>%.3g</td>", s.max_px, s.p99_px, s.rms_px, s.pop_px);
    appendf(out, "<td%s>%llu</td>", s.crack_pixels ? " class='bad'" : "",
            static_cast<unsigned long long>(s.crack_pixels));
    if (s.seams_known)
      appendf(out, "<td%s>%llu</td>", s.seams_mismatched ? " class='bad'" : "",
              static_cast<unsigned long long>(s.seams_mismatched));
    else out += "<td>not known</td>";
    appendf(out, "<td>%llu</td><td>%.0f</td><td>%u</td>", static_cast<unsigned long long>(s.silhouette_pixels),
            s.triangles, s.max_draw_calls);
    appendf(out, "<td>%.2f<small> %.2f to %.2f</small></td><td>%.1f<small> %.1f to %.1f</small></td>",
            s.select_ms.median, s.select_ms.low, s.select_ms.high, s.frame_ms.median, s.frame_ms.low, s.frame_ms.high);
    appendf(out, "<td>%.2f</td><td>%.2f</td></tr>\n", static_cast<double>(s.max_resident_bytes) / 1048576.0,
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
    appendf(out, "<stop offset='%d%%' stop-color='rgb(%.0f,%.0f,%.0f)'/>", 10 * k, c[0], c[1], c[2]);
  }
  out += "</linearGradient></defs><rect x='10' y='2' width='400' height='14' fill='url(#ramp)'/>";
  for (int k = 0; k <= 4; ++k)
    appendf(out, "<text x='%d' y='32' text-anchor='%s'>%g px</text>", 10 + 100 * k,
            k == 0   ? "start"
            : k == 4 ? "end"
                     : "middle",
            budget_px * k / 2);
  return out + "</svg>\n";
}

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
  std::string name = escapedHtml(std::filesystem::path(plan.package->path()).filename().string());
  std::string out =
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
      "content='width=device-width'>\n<title>relievo compare: " +
      name + "</title>\n<style>" + kReportStyle + "</style></head><body>\n<h1>LOD strategies over " + name + "</h1>\n";
  if (d.isFlat())
    appendf(out, "<p>%llu x %llu px, %g mm a px", static_cast<unsigned long long>(d.flat().width_px),
            static_cast<unsigned long long>(d.flat().height_px), d.mm_per_px);
  else
    appendf(out, "<p>%u patches of %d x %d cells over a base mesh", d.patchCount(), kPagePx << d.relief_depth,
            kPagePx << d.relief_depth);
  appendf(out, ", heights x %g; %zu frames of %d x %d px along ", plan.exaggerate, all.frame_count, plan.width_px,
          plan.height_px);
  out += escapedHtml(std::filesystem::path(plan.path).filename().string()) + "; " + escapedHtml(all.renderer) + ", " +
         escapedHtml(all.version) + ".</p>\n";
  appendf(
      out,
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
  appendf(
      out,
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
    Plot plot{p.title, {.title = p.x_title}, {.title = p.y_title}, {}, {}};
    for (const StrategyEntry& e : lodStrategies()) plot.series.push_back({.title = e.title, .dashed = e.control});
    for (const StrategyFigures& run : all.runs) {
      if (!run.available) continue;
      RunSummary s = summaryOf(run, all);
      char text[200];
      std::snprintf(text, sizeof text, "%s, budget %g px: max %.3g px, p99 %.3g px, %.0f triangles, %.2f + %.1f ms",
                    run.strategy->title.c_str(), run.budget_px, s.max_px, s.p99_px, s.triangles, s.select_ms.median,
                    s.frame_ms.median);
      plot.points.push_back({indexOf(run.strategy), std::max(p.x(s), 1e-3), std::max(p.y(s), kLeastPx), text, ""});
    }
    out += plotSvg(plot);
  }
  appendf(
      out,
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
    out += "<dt>" + escapedHtml(last->title) + " <small>" + escapedHtml(last->name) + "</small></dt><dd>" +
           escapedHtml(last->purpose) + (last->control ? " (a negative control)" : "") + "</dd>\n";
  }
  out += "</dl>\n";
  if (pictures.empty()) return out + "</body></html>\n";
  appendf(out, "<h2>Where the error is</h2>\n<p>Frame %d, budget %g px. Chequered: nothing is drawn.</p>\n",
          all.picture_frame, pictures[0].run->budget_px);
  out += rampKey(pictures[0].run->budget_px) + "<div class='panels'>\n";
  for (const ReportPicture& p : pictures) {
    const FrameFigures& f = p.run->frames[static_cast<size_t>(all.picture_frame)];
    std::string title = escapedHtml(p.run->strategy->title);
    out += "<figure><img alt='Error of " + title + "' src='" + p.uri + "'><figcaption>" + title;
    appendf(out, ": max %.3g px, p99 %.3g px, %llu triangles</figcaption></figure>\n", f.error.max_px, f.error.p99_px,
            static_cast<unsigned long long>(f.triangles));
  }
  return out + "</div>\n</body></html>\n";
}

}  // namespace relievo
