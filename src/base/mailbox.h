// mailbox.h - a newest-wins hand-over between two threads: a later post replaces one that was not yet taken.
// The poster never waits for the taker. close() wakes the taker.
#pragma once

#include <condition_variable>
#include <mutex>
#include <optional>
#include <utility>

namespace relievo {

template <class T>
class Mailbox {
 public:
  void post(T value) {
    {
      std::lock_guard lock(mutex_);
      letter_ = std::move(value);
    }
    ready_.notify_one();
  }
  // Never waits.
  std::optional<T> tryTake() {
    std::lock_guard lock(mutex_);
    return std::exchange(letter_, std::nullopt);
  }
  // Waits for a letter; nothing once closed.
  std::optional<T> take() {
    std::unique_lock lock(mutex_);
    ready_.wait(lock, [&] { return closed_ || letter_.has_value(); });
    if (closed_) return std::nullopt;
    return std::exchange(letter_, std::nullopt);
  }
  void close() {
    {
      std::lock_guard lock(mutex_);
      closed_ = true;
    }
    ready_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable ready_;
  std::optional<T> letter_;
  bool closed_ = false;
};

}  // namespace relievo
