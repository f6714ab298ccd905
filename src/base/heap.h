// heap.h - memory that malloc hands out later without page faults. A driver in software takes tens of MiB for a first
// picture, piece by piece: 4 KiB at a time that is 50 ms of faults. Here another thread takes them at once, in huge
// pages where the system has them, while the caller does something else (making a GL context, say).
#pragma once

#include <array>
#include <cstddef>

#include "src/base/worker_threads.h"

namespace relievo {

// What Mesa's llvmpipe takes for a first picture of 1280x720 px.
inline constexpr size_t kFirstPictureBytes = size_t{64} << 20;

class HeapWarmer {
 public:
  // On the thread that will use the memory, while the process has no other thread that allocates much.
  explicit HeapWarmer(size_t bytes);
  ~HeapWarmer() { finish(true); }
  // Waits, and leaves the memory to malloc; keep false: gives it back to the system.
  void finish(bool keep);

 private:
  std::array<void*, 4> blocks_{};
  bool held_ = true;
  WorkerThreads thread_{"relievo-heap"};
};

}  // namespace relievo
