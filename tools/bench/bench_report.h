// bench_report.h - what `relievo bench` writes of its rows: a table on the terminal, JSON for programs, and a page of
// Markdown for readers. Pure: the same run gives the same text.
#pragma once

#include <ctime>
#include <string>
#include <vector>

#include "tools/bench/bench.h"

namespace relievo {

struct BenchGroupRows {
  std::string name, purpose;  // of BenchGroup
  std::vector<BenchRow> rows;
};

struct BenchRun {
  std::string processor;  // "AMD EPYC"
  unsigned cores = 0;     // that the process may use
  std::string renderer;   // GL_RENDERER
  std::string version;    // of the program, "relievo 0.1.0"
  std::string artwork;    // "4096 x 4096 px, ptm-lrgb with relief"
  std::time_t started = 0;
  double load = -1;  // average number of threads that wanted a core in the minute before the run; negative: not known
  bool quick = false;
  std::vector<BenchGroupRows> groups;  // those that ran, in their order
};

// Four significant digits or so: "3195", "66.5", "0.77", "0.0511".
std::string figureText(double value);
// Whether a row reaches its goal; it must have one.
bool meetsGoal(const BenchRow& row);

// A line for the terminal, with its end.
std::string benchLine(const BenchRow& row);
std::string benchJson(const BenchRun& run);
// Machine, date in UTC and version, then one table per group of the run. A group that did not run is not mentioned.
std::string benchMarkdown(const BenchRun& run);

}  // namespace relievo
