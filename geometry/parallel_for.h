// parallel_for.h - one loop on several threads, the caller's among them. Jobs are taken in order; what they write must not overlap.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace relievo {

inline int workerCount(int wanted) {
  return wanted > 0 ? wanted : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

// job(i) for i in [0, count); between its own jobs the caller's thread calls between(jobs taken so far). False: interrupted.
template <class Job, class Between>
bool parallelFor(size_t count, int workers, const std::atomic<bool>* interrupted, Job&& job, Between&& between) {
  std::atomic<size_t> next{0};
  auto stop = [&] { return interrupted && interrupted->load(std::memory_order_relaxed); };
  auto take = [&] {
    for (size_t i = next++; i < count && !stop(); i = next++) job(i);
  };
  std::vector<std::thread> others;
  const size_t threads = std::min(count, static_cast<size_t>(workerCount(workers)));
  for (size_t i = 1; i < threads; ++i) others.emplace_back(take);
  for (size_t i = next++; i < count && !stop(); i = next++) {
    job(i);
    between(std::min(next.load(), count));
  }
  for (std::thread& t : others) t.join();
  return !stop();
}
template <class Job>
bool parallelFor(size_t count, int workers, const std::atomic<bool>* interrupted, Job&& job) {
  return parallelFor(count, workers, interrupted, job, [](size_t) {});
}

}  // namespace relievo
