// checkpointed_writer.h - the part file of a build and, where checkpoints are asked for, the journal beside it: going
// on from what an earlier build left, checkpoints on time, and what stays on the disk when the build stops. Internal to
// texturing/. One thread.
//
// If the journal cannot be written, the build goes on without checkpoints (BuildOptions::note says so). If pages cannot
// be written, the build ends.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "src/base/result.h"
#include "texturing/package/build_checkpoint.h"
#include "texturing/package/build_reporter.h"
#include "texturing/package/package_writer.h"

namespace relievo {

class CheckpointedWriter {
 public:
  // header: as placeSections left it. options, clock and spills outlive the writer.
  static Result<std::unique_ptr<CheckpointedWriter>> open(const PackageHeader& header, const std::string& manifest,
                                                          const BuildOptions& options, const BuildReporter& clock,
                                                          SpillBudget& spills);
  PackageWriter& pages() { return *writer_; }

  // The next part of this stage that an earlier build made, its pages in place; null: none left.
  Result<std::unique_ptr<BuildPart>> replay(uint32_t stage);
  // After the part was appended to pages(): into the journal; a checkpoint if it is time.
  Result<void> record(uint32_t stage, const BuildPart& part);
  // Completes the package, renames it and removes the journal. Returns the file's size in bytes.
  Result<uint64_t> finish();
  // Call it before the build ends with this error. Writes a last checkpoint if an interrupted build may be resumed.
  // Returns the error, with a hint where something was kept.
  Error stopped(Error error);

 private:
  CheckpointedWriter(const BuildOptions& options, const BuildReporter& clock) : options_(options), clock_(clock) {}
  void note(const std::string& text) const;
  Result<std::optional<OutputFile>> find(const PackageHeader& header, uint64_t identity);
  void startJournal(uint64_t identity);
  Result<void> checkpoint();
  void endCheckpoints(const Error& why);
  Error hinted(Error error);

  const BuildOptions& options_;
  const BuildReporter& clock_;
  std::optional<BuildJournal> journal_;
  std::unique_ptr<PackageWriter> writer_;
  bool kept_ = false;  // the files stay where the build stops
  double last_checkpoint_s_ = 0;
};

}  // namespace relievo
