// compare_plots.h - the plots of `relievo compare`: error against cost for all strategies, and figures frame by frame.
#pragma once

#include "tools/compare/compare_rows.h"
#include "tools/report/svg_plot.h"

namespace relievo {

struct ComparePlot {
  std::string name;  // of its file, without .svg
  Plot plot;
};
// series: a strategy has the same mark in all plots of a page. Rows that no other beats are ringed.
std::vector<ComparePlot> costPlots(const std::vector<CompareRow>& rows);
// At one budget: error, triangles and time of each frame.
std::vector<ComparePlot> framePlots(const CompareFigures& figures, double budget_px);
// The legend for either.
std::string compareLegend(const std::vector<CompareRow>& rows);

}  // namespace relievo
