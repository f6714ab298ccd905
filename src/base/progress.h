// progress.h - a progress line on a terminal (standard error), and the flag that Ctrl-C and other signals set.
#pragma once

#include <atomic>
#include <string>

namespace relievo {

// Rewrites one line, at most five times a second, when standard error is a terminal; else prints nothing.
class ProgressLine {
 public:
  explicit ProgressLine(std::string label);
  ~ProgressLine();  // ends the line, if one was printed
  void update(double fraction, const std::string& detail);

 private:
  std::string label_;
  double last_s_ = -1;
  bool printed_ = false;
};

// Installs handlers for SIGINT, SIGTERM, SIGALRM and SIGHUP (unless nohup ignores it) that set the flag; a second
// signal removes part files and exits at once (130). Files that may not grow further (ulimit -f) and pipes without a
// reader are errors of writing them, no signals.
void installInterruptHandler();
const std::atomic<bool>& interruptedFlag();

}  // namespace relievo
