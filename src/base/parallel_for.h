// parallel_for.h - one loop on several threads, the caller's among them. Jobs are taken in order; what they write must
// not overlap. The caller's thread takes jobs, too: the loop ends even where the system gives no other thread. What a
// job throws ends the loop, and is thrown to the caller.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <utility>

#include "src/base/worker_threads.h"

namespace relievo {

// job(state, i) for i in [0, count); each thread makes a state of its own, as makeState() gives it, before its first
// job. Between its own jobs the caller's thread calls between(jobs taken so far). False: interrupted.
template <class MakeState, class Job, class Between>
bool parallelForWith(size_t count, int workers, const std::atomic<bool>* interrupted, MakeState&& makeState, Job&& job,
                     Between&& between) {
  std::atomic<size_t> next{0};
  std::atomic<bool> failed{false};
  auto interruptedNow = [&] { return interrupted && interrupted->load(std::memory_order_relaxed); };
  auto take = [&](auto&& after) {
    try {
      size_t i = next++;
      auto goesOn = [&] { return i < count && !failed.load(std::memory_order_relaxed) && !interruptedNow(); };
      if (!goesOn()) return;
      for (auto state = makeState(); goesOn(); i = next++) {
        job(state, i);
        after();
      }
    } catch (...) {
      failed.store(true, std::memory_order_relaxed);
      throw;
    }
  };
  const size_t threads = std::min(count, static_cast<size_t>(workerCount(workers)));
  WorkerThreads others("relievo-loop");  // ends before what its threads use
  if (threads > 1) others.start(threads - 1, [&take] { take([] {}); });
  take([&] { between(std::min(next.load(), count)); });
  others.join();
  others.rethrow();
  return !interruptedNow();
}
template <class MakeState, class Job>
bool parallelForWith(size_t count, int workers, const std::atomic<bool>* interrupted, MakeState&& makeState,
                     Job&& job) {
  return parallelForWith(count, workers, interrupted, makeState, job, [](size_t) {});
}

// job(i) for i in [0, count).
template <class Job, class Between>
bool parallelFor(size_t count, int workers, const std::atomic<bool>* interrupted, Job&& job, Between&& between) {
  struct Nothing {};
  return parallelForWith(
      count, workers, interrupted, [] { return Nothing{}; }, [&](Nothing&, size_t i) { job(i); }, between);
}
template <class Job>
bool parallelFor(size_t count, int workers, const std::atomic<bool>* interrupted, Job&& job) {
  return parallelFor(count, workers, interrupted, job, [](size_t) {});
}

}  // namespace relievo
