// fault_report.h - what fault_library.cpp counts, in a file that both sides map.
#pragma once

#include <atomic>
#include <cstdint>

namespace relievo::testing_support {

struct FaultReport {
  std::atomic<uint64_t> calls{0};  // of the chosen kinds
  std::atomic<uint64_t> bytes{0};  // asked to be written
  std::atomic<uint64_t> hit{0};    // faults that happened
};

}  // namespace relievo::testing_support
