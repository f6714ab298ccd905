// large_blocks.cpp - large arrays of the program in huge pages, where Linux has them for whoever asks
// (/sys/kernel/mm/transparent_hugepage/enabled: madvise). A scan's arrays and images are taken, filled and given back
// many times: 4 KiB at a time their page faults, and misses of the TLB, take a sixth to a third of a build.
//
// The linker puts these in the place of operator new, in the code of the program and its modules alone (ld's --wrap;
// CMakeLists.txt): libraries keep theirs, and operator delete frees both.
#include <sys/mman.h>

#include <cstddef>
#include <cstdint>

// Names are ld's, of operator new(size_t) and operator new[](size_t).
extern "C" {
void* __real__Znwm(size_t bytes);
void* __real__Znam(size_t bytes);
void* __wrap__Znwm(size_t bytes);
void* __wrap__Znam(size_t bytes);
}

namespace {

constexpr uintptr_t kPage = 4096;
constexpr size_t kLarge = size_t{4} << 20;  // two huge pages: one that is smaller may have none of its own

// The pages that begin in the block, and the one that it begins in, as malloc's own word lies there.
void* inHugePages(void* block, size_t bytes) {
  if (bytes < kLarge) return block;
  const auto at = reinterpret_cast<uintptr_t>(block);
  const uintptr_t first = at / kPage * kPage, last = (at + bytes) / kPage * kPage;
  madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);  // without any it stays as it is
  return block;
}

}  // namespace

void* __wrap__Znwm(size_t bytes) { return inHugePages(__real__Znwm(bytes), bytes); }
void* __wrap__Znam(size_t bytes) { return inHugePages(__real__Znam(bytes), bytes); }
