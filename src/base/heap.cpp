#include "src/base/heap.h"

#include <malloc.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>

namespace relievo {
namespace {

constexpr size_t kLargestBlock = size_t{32} << 20;  // glibc's largest threshold: larger blocks are mapped one by one
constexpr int kKept = 512 << 20;
constexpr int kUsualPad = 128 << 10;  // glibc's, of M_TOP_PAD
constexpr uintptr_t kPage = 4096, kHugePage = 2 << 20;

struct Range {
  uintptr_t begin = 0, end = 0;
};

// Lets the heap grow by so many bytes in one piece, none of which malloc has written to: a page that was touched keeps
// the 2 MiB around it from being a huge page. Empty: malloc is not glibc's.
Range growHeap(size_t bytes) {
  const size_t block = std::min(bytes, kLargestBlock) - kPage;  // more than is free: so it comes from the end
  mallopt(M_TOP_PAD, static_cast<int>(bytes - block));
  void* const first = std::malloc(block);
  const auto begin = reinterpret_cast<uintptr_t>(first), end = reinterpret_cast<uintptr_t>(sbrk(0));
  std::free(first);
  mallopt(M_TOP_PAD, kUsualPad);
  const bool at_the_end = first && begin < end && end - begin >= block && end - begin <= bytes + kLargestBlock;
  return at_the_end ? Range{begin, end} : Range{};
}

// Changes nothing, as malloc may have handed the memory out meanwhile, or given it back to the system: then, and where
// the system cannot do this, false.
bool warm(uintptr_t at, size_t bytes) { return madvise(reinterpret_cast<void*>(at), bytes, MADV_POPULATE_WRITE) == 0; }

}  // namespace

HeapWarmer::HeapWarmer(size_t bytes) {
  mallopt(M_MMAP_THRESHOLD, kLargestBlock);
  mallopt(M_TRIM_THRESHOLD, kKept);
  mallopt(M_ARENA_MAX, 1);
  const Range range = growHeap(bytes);
  const uintptr_t first = (range.begin + kHugePage - 1) / kHugePage * kHugePage,
                  last = range.end / kHugePage * kHugePage;
  if (first < last) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
  // Without a thread the memory comes as it is asked for.
  thread_.start(1, [this, range] {
    uintptr_t at = (range.begin + kPage - 1) / kPage * kPage;
    const uintptr_t end = range.end / kPage * kPage;
    for (size_t piece = 0; at < end && !stop_; at += piece) {
      piece = std::min(kHugePage - at % kHugePage, end - at);
      if (!warm(at, piece)) return;
    }
  });
}

void HeapWarmer::giveBack() {
  stop_ = true;
  thread_.join();
  malloc_trim(0);
}

}  // namespace relievo
