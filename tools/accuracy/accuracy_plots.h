// accuracy_plots.h - the plots of `relievo accuracy`.
#pragma once

#include "tools/accuracy/accuracy_run.h"
#include "tools/report/svg_plot.h"

namespace relievo {

struct NamedPlot {
  std::string name;  // of its file, without .svg
  Plot plot;
};
// All settings and their front: accuracy against time.
NamedPlot frontPlot(const AccuracyResult& result, const std::vector<size_t>& front);
// Of a knob, what it has to show: accuracy against time (or, where it changes neither, against what it changes).
std::vector<NamedPlot> knobPlots(const AccuracyKnob& knob, const AccuracyResult& result);

}  // namespace relievo
