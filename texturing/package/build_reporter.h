// build_reporter.h - reports a build's progress to BuildOptions::progress, at most five times a second. Internal to
// texturing/. One thread.
#pragma once

#include <chrono>
#include <cstdint>

#include "texturing/package/package_writer.h"

namespace relievo {

class BuildReporter {
 public:
  explicit BuildReporter(const BuildOptions& options) : options_(options) {}

  void expect(uint64_t pages, uint64_t texels) { progress_.pages_total = pages, progress_.texels_total = texels; }
  // A part is done, or (null) nothing is yet.
  void report(const BuildPart* part) {
    if (part) progress_.pages_done += part->pages.size(), progress_.texels_done += part->texels;
    if (seconds() - last_report_s_ >= kSecondsBetween) tell();
  }
  // So many finest texels are done so far.
  void reportTexels(uint64_t done) {
    progress_.texels_done = done;
    report(nullptr);
  }
  void reportEnd() { tell(); }

  uint64_t pagesDone() const { return progress_.pages_done; }
  double seconds() const {  // since the reporter was made
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  static constexpr double kSecondsBetween = 0.2;
  void tell() {
    if (!options_.progress) return;
    progress_.seconds = last_report_s_ = seconds();
    options_.progress(progress_);
  }

  const BuildOptions& options_;
  const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  BuildProgress progress_;
  double last_report_s_ = -1;
};

}  // namespace relievo
