// package_sections.h - checks the parts of a package that are neither index entries nor pages: the file's length, both
// copies of header and base mesh, or this and its parity, and the bytes between the sections. For verifyPackage and
// repairPackage; internal to texturing/.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package_layout.h"

namespace relievo {

// The bytes of a file, from wherever they come.
using ReadBytes = std::function<Result<void>(uint64_t offset, std::span<uint8_t> out)>;

struct SectionFault {
  enum class Mend {
    kNone,   // nothing in the file tells what belongs there
    kCopy,   // `bytes` bytes at `from` are what belongs at `offset`
    kZeros,  // zeros belong there
    kBytes,  // `sound` belongs there
  };
  std::string what;         // names the section and its place
  bool unreadable = false;  // an input/output error, which says nothing of the package
  Mend mend = Mend::kNone;
  uint64_t offset = 0, bytes = 0, from = 0;
  std::vector<uint8_t> sound;
};

// The header in use, and the length of the file that it was found in.
struct SectionsOf {
  PackageHeader header;
  uint64_t file_bytes = 0;
};
// kInterrupted soon after *stop is set (it may be null). Reads the header's and the base mesh's copies, or this and its
// parity, and padding, which is short.
Result<std::vector<SectionFault>> sectionFaults(const SectionsOf& package, const ReadBytes& read,
                                                const std::atomic<bool>* stop);

}  // namespace relievo
