// accuracy_html.h - report.html of `relievo accuracy`: one file that needs no other one.
#pragma once

#include "tools/accuracy/accuracy_plots.h"
#include "tools/accuracy/accuracy_report.h"

namespace relievo {

std::string accuracyHtml(const AccuracyPlan& plan, const AccuracyResult& result, const AccuracyProvenance& made,
                         const std::vector<AccuracyAdvice>& advice, const std::vector<NamedPlot>& plots);

}  // namespace relievo
