#include "src/base/progress.h"

#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>

#include "src/base/file.h"

namespace relievo {
namespace {

std::atomic<bool> interrupted{false};

void onSignal(int) {
  if (interrupted.exchange(true)) {
    removePartFiles();
    _exit(130);
  }
}

double nowSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

ProgressLine::ProgressLine(std::string label) : label_(std::move(label)) {}

ProgressLine::~ProgressLine() {
  if (printed_) std::fputc('\n', stderr);
}

void ProgressLine::update(double fraction, const std::string& detail) {
  static const bool terminal = ::isatty(STDERR_FILENO) != 0;
  if (!terminal) return;
  double now = nowSeconds();
  if (fraction < 1.0 && now - last_s_ < 0.2) return;
  last_s_ = now;
  printed_ = true;
  constexpr int kWidth = 24;
  int filled = static_cast<int>(fraction * kWidth + 0.5);
  std::string bar(static_cast<size_t>(filled), '#');
  bar.resize(kWidth, '.');
  std::fprintf(stderr, "\r%s [%s] %3d %%  %s\033[K", label_.c_str(), bar.c_str(), static_cast<int>(fraction * 100),
               detail.c_str());
  std::fflush(stderr);
}

void installInterruptHandler() {
  struct sigaction action {};
  action.sa_handler = onSignal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGALRM, &action, nullptr);
  struct sigaction before {};
  // What nohup started goes on when its terminal is closed.
  if (sigaction(SIGHUP, nullptr, &before) == 0 && before.sa_handler != SIG_IGN) sigaction(SIGHUP, &action, nullptr);
  std::signal(SIGXFSZ, SIG_IGN);  // a file grown beyond `ulimit -f` is an error of writing it
  std::signal(SIGPIPE, SIG_IGN);  // and so is a pipe whose reader has gone
}

const std::atomic<bool>& interruptedFlag() { return interrupted; }

}  // namespace relievo
