// large_blocks.cpp - large arrays of the program in huge pages, where Linux has them for whoever asks
// (/sys/kernel/mm/transparent_hugepage/enabled: madvise). A scan's arrays and images are taken, filled and given back
// many times: 4 KiB at a time their page faults, and misses of the TLB, take a sixth to a third of a build.
//
// The linker puts these in the place of operator new, in the code of the program and its modules alone (ld's --wrap;
// CMakeLists.txt): libraries keep theirs, and operator delete frees both.
#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>

// Names are ld's, of operator new(size_t) and operator new[](size_t).
extern "C" {
void* __real__Znwm(size_t bytes);
void* __real__Znam(size_t bytes);
void* __wrap__Znwm(size_t bytes);
void* __wrap__Znam(size_t bytes);
}

namespace {

constexpr size_t kHugePage = size_t{2} << 20;
constexpr size_t kLarge = 2 * kHugePage;  // half of it would lie in none

// Null: there is no such block.
void* largeBlock(size_t bytes) {
  void* const block = std::aligned_alloc(kHugePage, bytes);
  if (block) madvise(block, bytes / kHugePage * kHugePage, MADV_HUGEPAGE);
  return block;
}

}  // namespace

// Those of the standard library say that memory is short.
void* __wrap__Znwm(size_t bytes) {
  void* const block = bytes < kLarge ? nullptr : largeBlock(bytes);
  return block ? block : __real__Znwm(bytes);
}

void* __wrap__Znam(size_t bytes) {
  void* const block = bytes < kLarge ? nullptr : largeBlock(bytes);
  return block ? block : __real__Znam(bytes);
}
