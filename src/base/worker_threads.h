// worker_threads.h - the one place that starts threads. Where the system refuses some, those that started do the work;
// what the user reads where none starts is said here once. What a thread throws is kept for its owner: it never ends
// the process.
#pragma once

#include <atomic>
#include <cstddef>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace relievo {

// wanted, or one per core where wanted is 0.
int workerCount(int wanted);

// No thread could be started where one is needed. Its text says why and what to do; the process's exit code is 4.
class ThreadStartFailure : public std::runtime_error {
 public:
  explicit ThreadStartFailure(const std::string& cause);
  static constexpr const char* kHint =
      "close other programs, or raise the limits of processes and memory: ulimit -u, ulimit -v";
};

// Threads that run one function. The owner tells that function to return (stop = close, then join) before it destroys
// this object, or joins; the object is the owner's last member, so that its threads end before what they use.
class WorkerThreads {
 public:
  explicit WorkerThreads(const char* name) : name_(name) {}  // as debuggers and `top -H` show it: at most 15 characters
  WorkerThreads(const WorkerThreads&) = delete;
  WorkerThreads& operator=(const WorkerThreads&) = delete;
  ~WorkerThreads() { join(); }

  // Starts `count` more threads, or as many as the system gives; how many. `body` may run before this returns.
  size_t start(size_t count, const std::function<void()>& body);
  // Throws ThreadStartFailure where not one starts.
  size_t startAtLeastOne(size_t count, const std::function<void()>& body);
  void join();  // waits until every body has returned
  // Throws what a body threw, the first that did. Bodies end by an exception on their own: this does not wait for the
  // others.
  void rethrow() const;

  // Of the owner's thread.
  size_t size() const { return threads_.size(); }
  bool empty() const { return threads_.empty(); }

 private:
  void run(const std::function<void()>& body);

  const char* name_;
  std::string cause_;  // why the last thread was refused
  std::atomic<bool> failed_{false};
  mutable std::mutex mutex_;
  std::exception_ptr failure_;  // guarded by mutex_
  std::vector<std::thread> threads_;
};

// How many of `count` threads the system gives beside those that there are: they are started all at once, and end. For
// libraries that start threads of their own and end the process where they cannot.
size_t threadsToBeHad(size_t count);

// One piece of work on a thread of its own; where none can be started, it is done by the thread that first asks for its
// result.
template <class T>
class BackgroundTask {
  using Value = std::conditional_t<std::is_void_v<T>, std::monostate, T>;

 public:
  // beside = false: no thread is started, the work is done when its result is asked for.
  template <class Work>
  BackgroundTask(const char* name, Work work, bool beside = true) : threads_(name) {
    auto held = std::make_shared<Work>(std::move(work));
    work_ = [this, held]() mutable {
      if constexpr (std::is_void_v<T>) {
        (*held)();
        value_.emplace();
      } else {
        value_.emplace((*held)());
      }
      held.reset();  // what the work holds ends with it, on the thread that did it
    };
    if (beside) threads_.start(1, [this] { runOnce(); });
  }
  // Waits for the thread. Work that no thread does and nobody asked for is left undone.
  ~BackgroundTask() { threads_.join(); }

  // The result can be had now: without waiting, or because no thread works on it.
  bool ready() const { return done_.load(std::memory_order_acquire) || threads_.empty(); }
  // The result, or throws what the work threw. Any thread, any number of times.
  Value& get() {
    std::call_once(ended_, [this] {
      if (threads_.empty()) runOnce();
      else threads_.join();
    });
    if (failure_) std::rethrow_exception(failure_);
    return *value_;
  }

 private:
  void runOnce() {
    try {
      work_();
    } catch (...) {
      failure_ = std::current_exception();
    }
    done_.store(true, std::memory_order_release);
  }

  std::function<void()> work_;
  std::optional<Value> value_;
  std::exception_ptr failure_;
  std::atomic<bool> done_{false};
  std::once_flag ended_;
  WorkerThreads threads_;  // last
};

}  // namespace relievo
