// compare_rows.h - a comparison in one row for each strategy and budget, as reports show it and report.json keeps it;
// and what follows from rows alone: which ones no other beats, and what the strategies cost at equal error. Pure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tools/compare/compare_report.h"

namespace relievo {

struct CompareRow {
  std::string strategy, title, purpose;
  bool control = false, available = true;
  std::string why_not;
  double budget_px = 0, predicted_px = -1, max_px = 0, p99_px = 0, rms_px = 0, pop_px = 0;
  uint64_t crack_pixels = 0, seam_mismatches = 0, silhouette_pixels = 0, frames_above_bound = 0;
  bool seams_known = false;
  double triangles = 0;  // median over the frames
  uint32_t draw_calls = 0;
  uint64_t resident_bytes = 0, streamed_bytes = 0;
  ColdStart cold;              // medians over the frames; no bytes: the report does not say
  Timing select_ms, frame_ms;  // medians over the frames; of the frames' medians the least and the largest
  double totalMs() const { return select_ms.median + frame_ms.median; }
};
std::vector<CompareRow> compareRows(const CompareFigures& figures);

// No other row of a strategy that is no control has both no more cost and no more error, and one of them less.
using RowFigure = double (*)(const CompareRow&);
std::vector<bool> bestRows(const std::vector<CompareRow>& rows, RowFigure cost, RowFigure error);

// What a strategy costs where 99 % of its pixels are off by at most error_px, interpolated between its budgets along
// straight lines of logarithms. Strategies whose budgets do not reach to both sides of error_px are left out, controls
// too.
struct EqualErrorCost {
  std::string strategy, title;
  double triangles = 0, ms = 0;
  double ms_low = 0, ms_high = 0;  // by the fastest and the slowest frames
  ColdStart cold;
};
struct EqualError {
  double error_px = 0;
  std::vector<EqualErrorCost> costs;  // in the rows' order
  std::vector<std::string> left_out;  // titles
};
EqualError equalError(const std::vector<CompareRow>& rows, double error_px);
// At the error, of 1/16, 1/8, ... 8 px, that most strategies reach; of those the one nearest to 1 px.
EqualError equalError(const std::vector<CompareRow>& rows);
// In sentences: who draws least, who is quickest and who is there first from an empty cache, and by how much; a lead in
// time within the frames' spread is none.
std::string conclusionText(const EqualError& equal);

}  // namespace relievo
