#include "src/base/heap.h"

#include <malloc.h>
#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <utility>

namespace relievo {
namespace {

constexpr int kLargestBlock = 32 << 20;  // glibc's largest threshold: larger blocks are mapped one by one
constexpr int kKept = 512 << 20;

}  // namespace

HeapWarmer::HeapWarmer(size_t bytes) {
#ifdef RELIEVO_ADDRESS_SANITIZER
  bytes = 0;  // its heap keeps what is freed from being used again soon: warmed, it would only take longer
#endif
  mallopt(M_MMAP_THRESHOLD, kLargestBlock);
  mallopt(M_TRIM_THRESHOLD, kKept);
  const size_t block = std::min<size_t>(bytes / blocks_.size(), kLargestBlock - 4096);
  for (void*& b : blocks_) b = std::malloc(block);
  // Without a thread the memory comes as the driver asks for it.
  thread_.start(1, [blocks = blocks_, block] {
    const uintptr_t page = 4096, huge = 2 << 20;
    for (void* b : blocks) {
      if (!b) continue;
      const uintptr_t begin = reinterpret_cast<uintptr_t>(b), end = begin + block;
      const uintptr_t first = (begin + huge - 1) / huge * huge;
      if (first < end) madvise(reinterpret_cast<void*>(first), (end - first) / huge * huge, MADV_HUGEPAGE);
      for (uintptr_t at = (begin + page - 1) / page * page; at < end; at += page)
        *reinterpret_cast<volatile char*>(at) = 0;
    }
  });
}

void HeapWarmer::finish(bool keep) {
  thread_.join();
  if (!std::exchange(held_, false)) return;
  for (void* b : blocks_) std::free(b);
  if (!keep) malloc_trim(0);
}

}  // namespace relievo
