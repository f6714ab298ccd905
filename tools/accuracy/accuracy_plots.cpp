#include "tools/accuracy/accuracy_plots.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <initializer_list>

namespace relievo {
namespace {

constexpr double kLeastGeometryPx = 0.01;  // what is below is drawn there: measuring is not finer

std::string textOf(const AccuracyRow& row) {
  char text[400];
  const AccuracyFigures& f = row.figures;
  std::snprintf(text, sizeof text,
                "%s: %.2f dB, at most %.0f of 255, geometry %.3g px; %.2f ms moving, %.2f ms still, %.0f ms cold",
                settingText(row.setting).c_str(), f.psnr_db, f.largest, f.geometry_px, f.moving_ms.median,
                f.still_ms.median, f.cold_ms.median);
  return text;
}

double plottedMib(uint64_t bytes) { return std::max(static_cast<double>(bytes) / 1048576.0, 1e-3); }

// As it begins a title.
std::string capital(std::string text) {
  if (!text.empty() && text[0] >= 'a' && text[0] <= 'z') text[0] = static_cast<char>(text[0] - 'a' + 'A');
  return text;
}

std::vector<const AccuracyRow*> rowsOf(const AccuracyKnob& knob, const AccuracyResult& result) {
  std::vector<const AccuracyRow*> out;
  for (const AccuracyRow& row : result.rows)
    if (row.knob == knob.name && row.problem.empty()) out.push_back(&row);
  return out;
}

Plot emptyPlot(const std::string& title, const PlotAxis& x, const PlotAxis& y,
               std::initializer_list<const char*> series) {
  Plot plot;
  plot.title = title;
  plot.x = x;
  plot.y = y;
  for (const char* s : series) plot.series.push_back({.title = s});
  return plot;
}

// One point a value and time: moving and still.
Plot timesPlot(const std::string& title, const std::vector<const AccuracyRow*>& rows, const PlotAxis& y,
               double (*value)(const AccuracyFigures&)) {
  Plot plot = emptyPlot(title, {.title = "ms a frame (median of the rounds)"}, y, {"moving camera", "still camera"});
  for (const AccuracyRow* row : rows) {
    const AccuracyFigures& f = row->figures;
    plot.points.push_back({0, std::max(f.moving_ms.median, 1e-3), value(f), textOf(*row), row->label});
    plot.points.push_back({1, std::max(f.still_ms.median, 1e-3), value(f), textOf(*row), row->label});
  }
  return plot;
}

}  // namespace

NamedPlot frontPlot(const AccuracyResult& result, const std::vector<size_t>& front) {
  Plot plot =
      emptyPlot("Accuracy and time of all settings", {.title = "ms for each position of a moving camera (median)"},
                {.title = "PSNR of settled pictures, dB", .logarithmic = false},
                {"on the front: no other setting beats it", "a combination", "one knob turned", "the default"});
  for (size_t s = 1; s < plot.series.size(); ++s) plot.series[s].joined = false;
  auto add = [&](size_t series, const AccuracyRow& row, const std::string& label) {
    plot.points.push_back(
        {series, std::max(row.figures.moving_ms.median, 1e-3), row.figures.psnr_db, textOf(row), label});
  };
  for (const AccuracyRow& row : result.rows) {
    if (row.setting.rebuilt() || !row.problem.empty()) continue;
    if (row.knob == "base" && row.label == "default") add(3, row, "default");
    else add(row.knob == "combination" ? 1 : 2, row, "");
  }
  for (size_t i : front) add(0, result.rows[i], "");
  return {"front", std::move(plot)};
}

std::vector<NamedPlot> knobPlots(const AccuracyKnob& knob, const AccuracyResult& result) {
  const auto rows = rowsOf(knob, result);
  std::vector<NamedPlot> out;
  if (rows.empty()) return out;
  const PlotAxis db{.title = "PSNR of settled pictures, dB", .logarithmic = false};
  auto psnr = [](const AccuracyFigures& f) { return f.psnr_db; };
  const bool streaming = knob.name == "feedback-scale" || knob.name == "feedback-interval" || knob.name == "prefetch" ||
                         knob.name == "cache-mib";
  if (streaming) {
    out.push_back({knob.name, timesPlot(capital(knob.title) + ": accuracy while moving", rows,
                                        {.title = "PSNR of moving pictures, dB", .logarithmic = false},
                                        [](const AccuracyFigures& f) { return f.moving_psnr_db; })});
  } else {
    out.push_back({knob.name, timesPlot(capital(knob.title) + ": accuracy and time", rows, db, psnr)});
  }
  if (knob.name == "error-px" || knob.name == "least-cell" || knob.name == "relief-bits")
    out.push_back({knob.name + "-geometry",
                   timesPlot(capital(knob.title) + ": geometry", rows, {.title = "largest geometric error, px"},
                             [](const AccuracyFigures& f) { return std::max(f.geometry_px, kLeastGeometryPx); })});
  if (knob.name == "detail-bias" || knob.name == "cache-mib" || knob.name == "encoding" ||
      knob.name == "coefficient-bits" || knob.name == "relief-bits") {
    Plot plot = emptyPlot(capital(knob.title) + ": accuracy and bytes", {.title = "MiB over the path"}, db,
                          {"read", "resident, at most"});
    for (const AccuracyRow* row : rows) {
      plot.points.push_back({0, plottedMib(row->figures.bytes_read), row->figures.psnr_db, textOf(*row), row->label});
      plot.points.push_back(
          {1, plottedMib(row->figures.bytes_resident), row->figures.psnr_db, textOf(*row), row->label});
    }
    out.push_back({knob.name + "-bytes", std::move(plot)});
  }
  return out;
}

}  // namespace relievo
