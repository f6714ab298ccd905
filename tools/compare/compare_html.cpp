// The report as a page: curves of error against triangles and time, a table, and the error painted on the relief.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "tools/compare/compare_plots.h"
#include "tools/compare/compare_report.h"
#include "tools/compare/compare_rows.h"
#include "tools/compare/compare_tables.h"
#include "tools/report/svg_plot.h"

namespace relievo {
namespace {

constexpr int kPicturePx = 640;  // at most, wide

double middleBudget(const ComparePlan& plan) { return plan.budgets_px[(plan.budgets_px.size() - 1) / 2]; }

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

std::string originHtml(const ComparePlan& plan, const CompareFigures& all) {
  std::string out = "<dl>";
  auto term = [&](const char* what, const std::string& text) {
    if (!text.empty()) out += "<dt>" + std::string(what) + "</dt><dd>" + escapedHtml(text) + "</dd>\n";
  };
  const std::string name = std::filesystem::path(plan.package->path()).filename().string();
  term("Command", plan.origin.command);
  term("Date", plan.origin.date);
  term("Processor", plan.origin.cpu);
  term("OpenGL", all.renderer + ", " + all.version);
  term("Package", name + (plan.origin.package_hash.empty() ? "" : ", xxh3-64 " + plan.origin.package_hash));
  term("Source", plan.origin.source);
  return out + "</dl>\n";
}

// What was measured, and what measuring itself is off by.
std::string measuredHtml(const ComparePlan& plan, const CompareFigures& all) {
  const PatchDomain& d = plan.package->manifest().domain;
  std::string out;
  if (d.isFlat())
    appendf(out, "<p>%llu x %llu px, %g mm a px", static_cast<unsigned long long>(d.flat().width_px),
            static_cast<unsigned long long>(d.flat().height_px), d.mm_per_px);
  else
    appendf(out, "<p>%u patches of %d x %d cells over a base mesh", d.patchCount(), kPagePx << d.relief_depth,
            kPagePx << d.relief_depth);
  appendf(out, ", heights x %g; %zu frames of %d x %d px along ", plan.exaggerate, all.frame_count, plan.width_px,
          plan.height_px);
  out += escapedHtml(std::filesystem::path(plan.path).filename().string()) + ".</p>\n";
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
  return out;
}

}  // namespace

std::vector<ReportPicture> reportPictures(const ComparePlan& plan, const CompareFigures& all) {
  std::vector<ReportPicture> out;
  const double budget = middleBudget(plan);
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
  std::string name = escapedHtml(std::filesystem::path(plan.package->path()).filename().string());
  std::string out =
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
      "content='width=device-width'>\n<title>relievo compare: " +
      name + "</title>\n<style>" + kReportStyle + "</style></head><body>\n<h1>LOD strategies over " + name + "</h1>\n";
  out += originHtml(plan, all) + measuredHtml(plan, all);
  const std::vector<CompareRow> rows = compareRows(all);
  const EqualError equal = equalError(rows);
  out += "<h2>At equal error</h2>\n<p>" + escapedHtml(conclusionText(equal)) + "</p>\n";
  if (!equal.costs.empty())
    out +=
        equalErrorTableHtml(equal) +
        "<p><small>Interpolated between each strategy's budgets. Times: medians over the frames, with the fastest "
        "and the slowest frame. Cold: from an empty cache, all that a frame draws from, encoded (relief pages as the "
        "package holds them; parts of simplified meshes by meshoptimizer's codecs and zstd), and how long it takes to "
        "read at that rate or, beside it, to decode by one thread, whichever is longer.</small></p>\n";
  out += "<h2>What accuracy costs</h2>\n" + compareLegend(rows) + "<div class='panels'>\n";
  for (const ComparePlot& p : costPlots(rows)) out += plotSvg(p.plot);
  out +=
      "</div>\n<p><small>Down and to the left is better. A point a budget, ringed where no other one is better; errors "
      "below 0.01 px are drawn there. Times are for geometry alone, without shading.</small></p>\n";
  const double budget = middleBudget(plan);
  if (all.frame_count > 1) {
    appendf(out, "<h2>Frame by frame</h2>\n<p>Along the path, at a budget of %g px.</p>\n<div class='panels'>\n",
            budget);
    for (const ComparePlot& p : framePlots(all, budget)) out += plotSvg(p.plot);
    out += "</div>\n";
  }
  out += "<h2>Errors</h2>\n" + errorTableHtml(rows) + "<h2>Costs</h2>\n" + costTableHtml(rows);
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
