#include "src/base/worker_threads.h"

#include <pthread.h>

#include <algorithm>
#include <new>
#include <system_error>

namespace relievo {

int workerCount(int wanted) {
  return wanted > 0 ? wanted : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

ThreadStartFailure::ThreadStartFailure(const std::string& cause)
    : std::runtime_error("could not start a thread: " + cause + " (" + kHint + ")") {}

void WorkerThreads::run(const std::function<void()>& body) {
  pthread_setname_np(pthread_self(), name_);
  try {
    body();
  } catch (...) {
    std::lock_guard lock(mutex_);
    if (!failure_) failure_ = std::current_exception();
    failed_.store(true, std::memory_order_release);
  }
}

size_t WorkerThreads::start(size_t count, const std::function<void()>& body) {
  size_t started = 0;
  try {
    threads_.reserve(threads_.size() + count);
    for (; started < count; ++started) {
      threads_.emplace_back([this, body] { run(body); });
    }
  } catch (const std::system_error& refused) {
    cause_ = refused.code().message();
  } catch (const std::bad_alloc&) {
    cause_ = "out of memory";
  }
  return started;
}

size_t threadsToBeHad(size_t count) {
  std::mutex held;
  std::unique_lock hold(held);
  WorkerThreads threads("relievo-probe");
  const size_t started = threads.start(count, [&held] { std::lock_guard wait(held); });
  hold.unlock();
  threads.join();
  return started;
}

size_t WorkerThreads::startAtLeastOne(size_t count, const std::function<void()>& body) {
  const size_t started = start(count, body);
  if (started == 0) throw ThreadStartFailure(cause_);
  return started;
}

void WorkerThreads::join() {
  for (std::thread& t : threads_) t.join();
  threads_.clear();
}

void WorkerThreads::rethrow() const {
  if (!failed_.load(std::memory_order_acquire)) return;
  std::lock_guard lock(mutex_);
  std::rethrow_exception(failure_);
}

}  // namespace relievo
