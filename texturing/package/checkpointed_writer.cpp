#include "texturing/package/checkpointed_writer.h"

#include <xxhash.h>
#include <zstd.h>
#include <string_view>
#include <utility>
#include <vector>

#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

// What decides a package's bytes: where it differs, a checkpoint of the one is none of the other. Nothing where it is
// not known.
std::optional<uint64_t> identityOf(const PackageHeader& header, const std::string& manifest,
                                   const BuildOptions& options) {
  auto program = hashFile("/proc/self/exe");
  if (!program) return std::nullopt;
  std::vector<uint8_t> bytes(kHeaderBytes);
  encodeHeader(header, bytes);
  auto add = [&](std::string_view text) { bytes.insert(bytes.end(), text.begin(), text.end()); };
  add(manifest);
  add(*program);
  for (const PageEncoding& e : header.encodings)
    add(std::to_string(static_cast<int>(e.codec)) + "/" + std::to_string(e.parameter) + " ");
  add(std::to_string(options.zstd_level) + " " + std::to_string(ZSTD_versionNumber()));
  return XXH3_64bits(bytes.data(), bytes.size());
}

}  // namespace

Result<std::unique_ptr<CheckpointedWriter>> CheckpointedWriter::open(const PackageHeader& header,
                                                                     const std::string& manifest,
                                                                     const BuildOptions& options,
                                                                     const BuildReporter& clock, SpillBudget& spills) {
  std::unique_ptr<CheckpointedWriter> out(new CheckpointedWriter(options, clock));
  std::optional<uint64_t> identity;
  if (options.checkpoint_s >= 0 || options.resume) {
    identity = identityOf(header, manifest, options);
    if (!identity) out->note("this build leaves no checkpoints: the program cannot be read");
  }
  std::optional<OutputFile> pages;
  if (options.resume && identity) {
    auto found = out->find(header, *identity);
    if (!found) return found.error();
    pages = std::move(*found);
  }
  auto writer = pages ? PackageWriter::resume(std::move(*pages), header, manifest, spills)
                      : PackageWriter::create(options.output, header, manifest, {}, spills);
  if (!writer) return writer.error();
  out->writer_ = std::move(*writer);
  if (!out->journal_ && identity && !out->pages().file().partPath().empty()) out->startJournal(*identity);
  return out;
}

void CheckpointedWriter::note(const std::string& text) const {
  if (options_.note) options_.note(text);
}

// The file of the pages that an earlier build left, if it left a journal with them.
Result<std::optional<OutputFile>> CheckpointedWriter::find(const PackageHeader& header, uint64_t identity) {
  auto found = BuildJournal::find(options_.output, identity, header, options_.interrupted);
  if (!found) return found.error();
  if (!found->found) {
    note("building from the start: " + found->why);
    return std::optional<OutputFile>();
  }
  journal_ = std::move(found->found->journal);
  journal_->file().keep(), found->found->pages.keep();
  kept_ = true;
  note("going on from a checkpoint: " + std::to_string(found->pages_done) + " of " + std::to_string(header.page_count) +
       " pages are done");
  return std::optional(std::move(found->found->pages));
}

void CheckpointedWriter::startJournal(uint64_t identity) {
  auto made = BuildJournal::create(options_.output, identity, pages().file().partPath());
  if (made) journal_ = std::move(*made);
  else note("this build leaves no checkpoints: " + made.error().text());
}

Result<std::unique_ptr<BuildPart>> CheckpointedWriter::replay(uint32_t stage) {
  if (!journal_ || !options_.resume) return std::unique_ptr<BuildPart>();
  if (options_.interrupted && options_.interrupted->load())
    return Error{ErrorKind::kInterrupted, options_.output, "interrupted", "", {}};
  auto part = journal_->replay(stage);
  if (!part || !*part) return part;
  if (auto placed = pages().place(**part); !placed) return placed.error();
  return part;
}

Result<void> CheckpointedWriter::record(uint32_t stage, const BuildPart& part) {
  if (!journal_) return {};
  if (auto added = journal_->add(stage, part); !added) {
    endCheckpoints(added.error());
    return {};
  }
  const double between_s = options_.checkpoint_s >= 0 ? options_.checkpoint_s : kCheckpointSeconds;
  return clock_.seconds() - last_checkpoint_s_ >= between_s ? checkpoint() : Result<void>();
}

Result<void> CheckpointedWriter::checkpoint() {
  if (!journal_) return {};
  if (auto synced = pages().file().finish(); !synced) return synced;
  auto written = journal_->checkpoint(pages().file().size());
  if (written && !kept_) written = journal_->file().syncFolder();
  if (written && options_.resume && !kept_) {
    pages().file().keep(), journal_->file().keep();
    kept_ = true;
  }
  last_checkpoint_s_ = clock_.seconds();
  if (!written) endCheckpoints(written.error());
  return {};
}

void CheckpointedWriter::endCheckpoints(const Error& why) {
  note("this build leaves no more checkpoints: " + why.text());
  journal_->file().remove();
  journal_.reset();
}

Result<uint64_t> CheckpointedWriter::finish() {
  auto file_bytes = pages().finish(options_.interrupted);
  if (!file_bytes) return hinted(file_bytes.error());
  if (journal_) journal_->file().remove();
  return file_bytes;
}

Error CheckpointedWriter::stopped(Error error) {
  if (options_.resume && error.kind == ErrorKind::kInterrupted && journal_ && !journal_->replaying())
    (void)checkpoint();
  return hinted(std::move(error));
}

Error CheckpointedWriter::hinted(Error error) {
  if (kept_ && !journal_) pages().file().remove(), kept_ = false;  // nobody could go on with the pages alone
  if (kept_)
    error.hint += (error.hint.empty() ? "" : "; ") + std::string("what is done is kept: build again with --resume");
  return error;
}

}  // namespace relievo
