// accuracy_report.h - what `relievo accuracy` writes of its figures: report.html, accuracy.json, accuracy.csv, plots
// and recommended settings. What is not a time, and nothing that follows from times, is the same whenever the same is
// measured.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "tools/accuracy/accuracy_run.h"
#include "tools/report/report_file.h"

namespace relievo {

// Where and when it was measured.
struct AccuracyProvenance {
  std::string command, date, cpu, package_name, package_hash;
};

struct AccuracyGoals {
  std::vector<double> psnr_db;   // the cheapest setting that is at least so accurate
  std::vector<double> frame_ms;  // the most accurate setting whose moving frames take at most so long
};

struct AccuracyAdvice {
  std::string goal;           // "at least 40 dB"
  std::string file;           // "settings-40-db.json"
  std::optional<size_t> row;  // in AccuracyResult::rows; nothing: no setting that was measured does it
  std::string text;           // for people: what it takes and gives
};

// Settings that a file can hold: those of the package as it is. By AccuracyResult::rows.
std::vector<size_t> adviceCandidates(const AccuracyResult& result);
std::vector<size_t> accuracyFront(const AccuracyResult& result);
std::vector<AccuracyAdvice> adviceFor(const AccuracyResult& result, const AccuracyGoals& goals);

// All files, in the order in which they are written.
std::vector<ReportFile> accuracyReport(const AccuracyPlan& plan, const AccuracyResult& result,
                                       const AccuracyProvenance& made, const AccuracyGoals& goals);

struct AccuracyColumn {
  const char *name, *unit, *meaning;
};
const std::vector<AccuracyColumn>& accuracyColumns();  // of accuracy.csv; for --help, too

}  // namespace relievo
