// build_checkpoint.h - what a build keeps beside its part file, so that it can go on after it was killed. Internal to
// texturing/.
//
// The journal is a second part file of the same target (src/base/file.h): locked while its writer lives, removed with
// it, and an orphan when it was killed. It is a list of records, each with a checksum that depends on its number:
//   header      the build's identity, and the name of the part file that holds the pages
//   part        what a part of the build left besides its pages: their places and checksums, and the next stage's input
//   checkpoint  the pages of all parts so far are on the disk, and end here
// Records behind the last whole checkpoint are ignored. A resumed build takes the parts before it from the journal
// instead of computing them, and computes the rest as any build does, so the package has the same bytes.
//
// Trust: a journal is believed only if its identity is the build's (inputs by digest, options, and the program by its
// own digest), the records' checksums match, and each page in the part file matches its own. Else the build starts
// anew. What stands before the pages is written by the end of a build alone, so to go on it is made blank again,
// whatever it holds.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "src/base/file.h"
#include "src/base/result.h"
#include "texturing/package/package_writer.h"

namespace relievo {

class BuildJournal {
 public:
  static Result<BuildJournal> create(const std::string& output, uint64_t identity, const std::string& pages_part);

  struct Found;
  // What a killed build of this output left; everything else that killed builds left of it is removed. Nothing: found
  // is empty, and why says so as a sentence.
  static Result<Found> find(const std::string& output, uint64_t identity, const PackageHeader& header,
                            const std::atomic<bool>* interrupted);

  // The next part of this stage, without the bytes of its pages; null: none left.
  Result<std::unique_ptr<BuildPart>> replay(uint32_t stage);
  bool replaying() const { return parts_left_ > 0; }

  Result<void> add(uint32_t stage, const BuildPart& part);
  // Pages up to pages_end are on the disk: the build can go on from here.
  Result<void> checkpoint(uint64_t pages_end);
  OutputFile& file() { return file_; }

 private:
  explicit BuildJournal(OutputFile file) : file_(std::move(file)) {}
  enum Type : uint32_t { kHeader = 0x4A4C4552, kPart, kCheckpoint };  // "RELJ"
  struct Record {
    uint32_t type = 0;
    std::vector<uint8_t> body;
  };
  Result<void> write(Type type, const std::vector<uint8_t>& body);
  std::optional<Record> read();  // nothing: the end, or a damaged record

  OutputFile file_;
  uint64_t at_ = 0, serial_ = 0;  // of the next record
  uint64_t parts_left_ = 0;       // to be replayed
};

struct BuildJournal::Found {
  struct Both {
    BuildJournal journal;
    OutputFile pages;
  };
  std::optional<Both> found;
  uint64_t pages_done = 0;
  std::string why;
};

}  // namespace relievo
