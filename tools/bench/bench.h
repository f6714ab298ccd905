// bench.h - what `relievo bench` is made of: groups, one a file (bench_*.cpp), each of which measures some rows with a
// baseline or peer in the same run. A time is a median; what is not a time is deterministic.
#pragma once

#include <time.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

struct BenchRow {
  std::string what;  // "analysis of one feedback, 160x90 px"
  double measured = 0;
  std::string unit;  // "ms", "pages/s", "B", "x", "%"
  std::optional<double> goal;
  bool at_most = true;             // the goal is an upper bound; false: a lower bound
  std::string baseline_name;       // "readback that waits", "LRU"
  std::optional<double> baseline;  // in the same unit, from the same run
  std::string note;                // spread, counts, conditions; may be empty
};

struct BenchContext {
  std::shared_ptr<const Package>
      package;         // the artwork to measure with: LRGB PTM with relief, 4096x4096 unless a FILE was given
  std::string folder;  // for files of the run; removed afterwards
  std::string plots;   // folder for plots; empty: none are wanted
  bool quick = false;  // fewer repetitions, a minute in all
  const std::atomic<bool>* interrupted = nullptr;
  std::function<void(const BenchRow&)> row;  // call for each row, as soon as it is known
  bool stopped() const { return interrupted && interrupted->load(); }
};

// A headless GL context is current while a group runs.
struct BenchGroup {
  const char* name;
  const char* purpose;
  Result<void> (*run)(BenchContext& context);
};
const std::vector<BenchGroup>& benchGroups();  // cmd_bench.cpp

inline double benchSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}
// CPU time, so that other work on the machine does not count: the process's, or that of CLOCK_THREAD_CPUTIME_ID.
inline double benchCpuSeconds(clockid_t whose = CLOCK_PROCESS_CPUTIME_ID) {
  timespec t{};
  clock_gettime(whose, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

inline constexpr int kBenchWidth = 1280, kBenchHeight = 720;  // of frames

// q 0..1; nearest rank.
double quantile(std::vector<double> values, double q);
inline double median(std::vector<double> values) { return quantile(std::move(values), 0.5); }

}  // namespace relievo
