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

// Changes nothing, as malloc may have handed the memory out meanwhile.
__attribute__((no_sanitize("thread"))) void touch(uintptr_t at) {
  __atomic_fetch_or(reinterpret_cast<char*>(at), 0, __ATOMIC_RELAXED);
}

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
    for (uintptr_t at = (range.begin + kPage - 1) / kPage * kPage; at < range.end && !stop_; at += kPage) touch(at);
  });
}

void HeapWarmer::giveBack() {
  stop_ = true;
  thread_.join();
  malloc_trim(0);
}

}  // namespace relievo
