// fault_report.h - what fault_library.cpp counts, in a file that both sides map.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstring>

namespace relievo::testing_support {

// Kinds of calls: fault_library.cpp says which calls those are.
enum FaultKind {
  kOpen,
  kRead,
  kWrite,
  kSync,
  kRename,
  kUnlink,
  kClose,
  kTruncate,
  kMap,
  kLock,
  kAlloc,
  kString,
  kThread,
  kFaultKinds
};
inline constexpr const char* kFaultKindNames[kFaultKinds] = {"open",   "read",   "write",    "sync", "rename",
                                                             "unlink", "close",  "truncate", "map",  "lock",
                                                             "alloc",  "string", "thread"};

// The kinds that a list names, separated by commas, as bits.
inline unsigned faultKindsOf(const char* list) {
  unsigned kinds = 0;
  for (int k = 0; k < kFaultKinds; ++k) {
    const size_t length = strlen(kFaultKindNames[k]);
    for (const char* at = list; (at = strstr(at, kFaultKindNames[k])); at += length)
      if ((at == list || at[-1] == ',') && (at[length] == 0 || at[length] == ',')) kinds |= 1u << k;
  }
  return kinds;
}

struct FaultReport {
  std::atomic<uint64_t> calls{0};                 // of the chosen kinds
  std::atomic<uint64_t> calls_of[kFaultKinds]{};  // of each kind, chosen or not
  std::atomic<uint64_t> bytes{0};                 // asked to be written
  std::atomic<uint64_t> hit{0};                   // faults that happened
};

}  // namespace relievo::testing_support
