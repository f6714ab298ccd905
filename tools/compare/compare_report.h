// compare_report.h - what `relievo compare` writes: report.json, frames.csv (compare_report.cpp) and report.html
// (compare_html.cpp); tables and plots for papers come from compare_tables.h and compare_plots.h.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "tools/compare/compare_run.h"

namespace relievo {

// Over the frames of a run.
struct RunSummary {
  double max_px = 0, p99_px = 0, rms_px = 0;  // the largest of the frames' maxima and p99, the RMS over all pixels
  double predicted_px = -1;                   // the largest; negative: nothing is promised
  double budget_px = 0;                       // the largest that was kept to
  double pop_px = 0;
  uint64_t pixels = 0, edge_on_pixels = 0;  // measured; not measured
  uint64_t above_bound_frames = 0;  // frames whose error is above what was promised, by more than measuring is off by
  uint64_t crack_pixels = 0, silhouette_pixels = 0, seams_compared = 0, seams_mismatched = 0, streamed_bytes = 0;
  bool seams_known = false;
  double triangles = 0;  // median over the frames
  uint64_t max_triangles = 0, max_resident_bytes = 0;
  uint32_t max_draw_calls = 0;
  ColdStart cold;              // medians over the frames
  Timing select_ms, frame_ms;  // of the frames' medians: median, fastest, slowest
};
RunSummary summaryOf(const StrategyFigures& run, const CompareFigures& all);
// Measuring may be off by this much: twice what the reference shows, and never less than 1/64 px.
double measuringSlackPx(const CompareFigures& all);

struct ReportColumn {
  const char* name;
  const char* unit;
  const char* meaning;
};
const std::vector<ReportColumn>& reportColumns();  // of frames.csv; for --help, too

// What is not in its members "timings" and "origin" is the same whenever the same is compared.
std::string reportJson(const ComparePlan& plan, const CompareFigures& figures);
std::string reportCsv(const CompareFigures& figures);

// The error painted on the relief: 4 channels, rows top first, transparent where nothing is drawn. Every pixel shows
// the largest error of the square of pixels that it stands for.
struct ReportPicture {
  const StrategyFigures* run = nullptr;
  int width_px = 0, height_px = 0;
  std::vector<uint8_t> rgba;
  std::string uri;  // "data:image/png;base64,...", for who writes the report to fill in
};
std::vector<ReportPicture> reportPictures(const ComparePlan& plan, const CompareFigures& figures);
// One file that needs no other one.
std::string reportHtml(const ComparePlan& plan, const CompareFigures& figures,
                       const std::vector<ReportPicture>& pictures);
std::string base64(std::span<const uint8_t> bytes);

}  // namespace relievo
