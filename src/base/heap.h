// heap.h - memory that malloc hands out later without page faults. A driver in software takes more than 100 MiB for a
// first picture, piece by piece: 4 KiB at a time that is 50 ms of faults. Here another thread takes them at once, in
// huge pages where the system has them, while the caller does something else (making a GL context, say).
#pragma once

#include <atomic>
#include <cstddef>

#include "src/base/worker_threads.h"

namespace relievo {

// What a first picture of 1280x720 px takes with Mesa's llvmpipe: 36 MiB of page pool, 26 of surface buffer, picture
// and feedback, 30 of vertices and binned triangles, 25 of decoded pages.
inline constexpr size_t kFirstPictureBytes = size_t{128} << 20;

class HeapWarmer {
 public:
  // On the thread that will use the memory, while the process has no other thread that allocates much. All threads
  // share one heap from then on, so that those that decode pages use this memory, too. The memory is malloc's from the
  // beginning: who is faster than the warming thread takes it cold.
  explicit HeapWarmer(size_t bytes);
  ~HeapWarmer() = default;  // waits until all of it is warm
  // Gives back to the system what malloc has no use for yet.
  void giveBack();

 private:
  std::atomic<bool> stop_{false};
  WorkerThreads thread_{"relievo-heap"};  // last
};

}  // namespace relievo
