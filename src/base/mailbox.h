// mailbox.h - a newest-wins hand-over between two threads: a later post replaces one that was not yet taken.
// Neither side waits for what the other does with a message, but at most while it exchanges one for another: messages
// are destroyed after that, by whoever replaces them. close() wakes the taker.
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
    std::optional<T> replaced(std::move(value));
    {
      std::lock_guard lock(mutex_);
      message_.swap(replaced);
    }
    ready_.notify_one();
  }
  // Does not wait for a message.
  std::optional<T> tryTake() {
    std::lock_guard lock(mutex_);
    return std::exchange(message_, std::nullopt);
  }
  // Waits for a message; nothing once closed.
  std::optional<T> take() {
    std::unique_lock lock(mutex_);
    ready_.wait(lock, [&] { return closed_ || message_.has_value(); });
    if (closed_) return std::nullopt;
    return std::exchange(message_, std::nullopt);
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
  std::optional<T> message_;
  bool closed_ = false;
};

}  // namespace relievo
