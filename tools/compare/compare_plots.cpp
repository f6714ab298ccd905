#include "tools/compare/compare_plots.h"

#include <algorithm>
#include <cstdio>

namespace relievo {
namespace {

constexpr double kLeastPlottedPx = 0.01;  // what is below is drawn there: measuring is not finer

// One for each strategy, in the order of rows.
std::vector<PlotSeries> seriesOf(const std::vector<CompareRow>& rows, std::vector<size_t>& series_of_row) {
  std::vector<PlotSeries> series;
  std::vector<std::string> names;
  for (const CompareRow& r : rows) {
    auto at = std::find(names.begin(), names.end(), r.strategy);
    series_of_row.push_back(static_cast<size_t>(at - names.begin()));
    if (at != names.end()) continue;
    names.push_back(r.strategy);
    series.push_back({.title = r.title, .dashed = r.control});
  }
  return series;
}

}  // namespace

std::vector<ComparePlot> costPlots(const std::vector<CompareRow>& rows) {
  struct Panel {
    const char *name, *title, *x_title, *y_title;
    RowFigure x, y;
  };
  const RowFigure triangles = [](const CompareRow&r) { return r.triangles; },
                  ms = [](const CompareRow&r) { return r.totalMs(); },
                  cold_ms = [](const CompareRow&r) { return r.cold.ms(kLinkRates[1]); },
                  largest = [](const CompareRow&r) { return r.max_px; },
                  most = [](const CompareRow&r) { return r.p99_px; };
  const char *counted = "triangles, median over the frames", *timed = "choosing and drawing a frame, ms (medians)",
             *from_empty = "reading and decoding at 20 MB/s, ms (medians)", *of_all = "largest error, px",
             *of_most = "p99 of the error, worst frame, px";
  const Panel panels[] = {
      {"largest-triangles", "Largest error against triangles", counted, of_all, triangles, largest},
      {"largest-time", "Largest error against time", timed, of_all, ms, largest},
      {"p99-triangles", "Error of 99 % of pixels against triangles", counted, of_most, triangles, most},
      {"p99-time", "Error of 99 % of pixels against time", timed, of_most, ms, most},
      {"p99-cold", "Error of 99 % of pixels from an empty cache", from_empty, of_most, cold_ms, most}};
  std::vector<size_t> series_of_row;
  const auto series = seriesOf(rows, series_of_row);
  std::vector<ComparePlot> out;
  const bool cold = std::any_of(rows.begin(), rows.end(), [](const CompareRow& r) { return r.cold.known(); });
  for (const Panel& p : panels) {
    if (p.x == cold_ms && !cold) continue;
    Plot plot{p.title, {.title = p.x_title}, {.title = p.y_title}, series, {}};
    const std::vector<bool> best = bestRows(rows, p.x, p.y);
    for (size_t k = 0; k < rows.size(); ++k) {
      const CompareRow& r = rows[k];
      if (!r.available) continue;
      char text[240];
      std::snprintf(text, sizeof text, "%s, budget %g px: max %.3g px, p99 %.3g px, %.0f triangles, %.2f + %.1f ms",
                    r.title.c_str(), r.budget_px, r.max_px, r.p99_px, r.triangles, r.select_ms.median,
                    r.frame_ms.median);
      plot.points.push_back({.series = series_of_row[k],
                             .x = std::max(p.x(r), 1e-3),
                             .y = std::max(p.y(r), kLeastPlottedPx),
                             .text = text,
                             .front = best[k]});
    }
    out.push_back({p.name, std::move(plot)});
  }
  return out;
}

std::vector<ComparePlot> framePlots(const CompareFigures& figures, double budget_px) {
  struct Panel {
    const char *name, *title, *y_title;
    double (*y)(const FrameFigures&);
    double least;
  };
  const Panel panels[] = {{"frames-error", "Largest error, frame by frame", "largest error, px",
                           [](const FrameFigures& f) { return f.error.max_px; }, kLeastPlottedPx},
                          {"frames-triangles", "Triangles, frame by frame", "triangles",
                           [](const FrameFigures& f) { return static_cast<double>(f.triangles); }, 1},
                          {"frames-time", "Time, frame by frame", "choosing and drawing, ms",
                           [](const FrameFigures& f) { return f.select_ms.median + f.frame_ms.median; }, 1e-3}};
  std::vector<size_t> series_of_row;
  const auto series = seriesOf(compareRows(figures), series_of_row);
  std::vector<ComparePlot> out;
  for (const Panel& p : panels) {
    Plot plot{p.title, {.title = "frame", .logarithmic = false}, {.title = p.y_title}, series, {}};
    for (size_t r = 0; r < figures.runs.size(); ++r) {
      const StrategyFigures& run = figures.runs[r];
      if (run.budget_px != budget_px) continue;
      for (size_t frame = 0; frame < run.frames.size(); ++frame) {
        const double y = p.y(run.frames[frame]);
        std::string text = run.strategy->title;
        appendf(text, ", frame %zu: %.4g", frame, y);
        plot.points.push_back(
            {.series = series_of_row[r], .x = static_cast<double>(frame), .y = std::max(y, p.least), .text = text});
      }
    }
    out.push_back({p.name, std::move(plot)});
  }
  return out;
}

std::string compareLegend(const std::vector<CompareRow>& rows) {
  std::vector<size_t> series_of_row;
  const auto series = seriesOf(rows, series_of_row);
  std::string out = "<p class='legend'>";
  for (size_t s = 0; s < series.size(); ++s) {
    const CompareRow& r =
        rows[static_cast<size_t>(std::find(series_of_row.begin(), series_of_row.end(), s) - series_of_row.begin())];
    out += "<span>" + plotKey(s) + " " + escapedHtml(r.title) + (r.control ? " (control)" : "") +
           (r.available ? "" : ": not available here") + "</span> ";
  }
  return out + "</p>\n";
}

}  // namespace relievo
