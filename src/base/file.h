// file.h - files by offset, and files that appear whole or not at all.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "src/base/result.h"

namespace relievo {

// Reads at any offset (pread); const and thread-safe.
// Only regular files are opened: a pipe, a device, a socket or a folder is refused without waiting for it.
class InputFile {
 public:
  static Result<InputFile> open(const std::string& path);
  InputFile(InputFile&& other) noexcept;
  InputFile& operator=(InputFile&& other) noexcept;
  ~InputFile();

  const std::string& path() const { return path_; }
  uint64_t size() const { return size_; }
  // Exactly out.size() bytes, or an Error with the offset (kInvalidData when the file ends before, kIo otherwise).
  Result<void> read(uint64_t offset, std::span<uint8_t> out) const;
  // Hints for many small reads to come. False: reading would wait for the disk (or nobody knows); nothing was read.
  bool readIfCached(uint64_t offset, std::span<uint8_t> out) const;
  void willNeed(uint64_t offset, uint64_t bytes) const;  // starts reading in the background

 private:
  InputFile() = default;
  std::string path_;
  int fd_ = -1;
  uint64_t size_ = 0;
};

enum class OutputKind { kFile, kStream, kStandardOutput };

// A file that appears whole or not at all, the one way in which the program writes any. It is written beside its target
// as PATH.part-PID-RANDOM, a new file that nobody could have put there before, and takes the target's place by
// commit(), once every byte is on the disk and counted. Until then the target is untouched; after an error it stays so.
// The destructor removes an uncommitted part file, and removePartFiles() (async-signal-safe) removes all of this
// process's. A part file is locked (flock) while its writer lives; one whose lock can be taken was left by a process
// that was killed, and the next create() of the same target removes it.
//
// A target that exists keeps its access mode, and its owner where that is permitted. A symbolic link stays: what it
// points to is replaced. Streams get the bytes at commit(), in order, from a temporary file without a name: "-"
// (standard output), what leads there (/dev/stdout), pipes and character devices such as /dev/null. Folders, sockets
// and block devices are refused.
class OutputFile {
 public:
  static Result<OutputFile> create(const std::string& path);
  // What create() would refuse of the target or its folder, or what the target is. Makes nothing.
  static Result<OutputKind> check(const std::string& path);
  // The part files of this target whose writers were killed, taken over: locked, and appended to at their ends. Those
  // that are not kept are removed by their destructors. Empty where the target is a stream.
  static Result<std::vector<OutputFile>> orphans(const std::string& path);
  // Removes the part files in this folder whose writers were killed, of every target whose name ours() tells: for
  // targets that no two processes name alike, which create() would never meet again.
  static void removeOrphans(const std::string& folder, const std::function<bool(std::string_view)>& ours);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  ~OutputFile();

  const std::string& path() const { return path_; }
  // The file beside the target; empty where the target is a stream.
  const std::string& partPath() const;
  Result<void> append(std::span<const uint8_t> bytes);  // buffered
  // Straight to the file (what append still buffers is written first if the two overlap). Several threads may call it
  // at once, as long as none appends.
  Result<void> writeAt(uint64_t offset, std::span<const uint8_t> bytes);
  uint64_t size() const;  // bytes appended so far
  // What was written, for those who check it before they commit.
  Result<void> readBack(uint64_t offset, std::span<uint8_t> out);
  // All of it on the disk and as long as what was written, still under partPath(): of several files that belong
  // together none takes its place before each has been finished. After any write that failed this fails, too: a file
  // with a hole is never committed.
  Result<void> finish();
  Result<void> commit();                 // finish, close, rename, and the folder's entry on the disk
  Result<void> truncate(uint64_t size);  // what was written from there on is taken back; appending goes on there
  Result<void> syncFolder();             // the part file's entry in its folder is on the disk
  bool ownsPart() const { return impl_ != nullptr; }  // not moved from
  void keep();  // from now on neither the destructor nor removePartFiles() removes the part file: it becomes an orphan
  void remove();  // the part file, kept or not

 private:
  struct Impl;
  OutputFile();
  std::string path_;
  std::unique_ptr<Impl> impl_;
};

// Writes a whole small file this way.
Result<void> writeFile(const std::string& path, std::span<const uint8_t> bytes);
// A file that is whole takes another name in its folder, in place of what had that name; the folder's entry is on the
// disk then.
Result<void> renameFile(const std::string& from, const std::string& to);
Result<std::string> readTextFile(const std::string& path, uint64_t max_bytes);
// Unlinks every part file of this process that is not yet committed. Async-signal-safe.
void removePartFiles();
// xxh3-64 of a whole file's bytes as 16 hex digits. Gives up (kInterrupted) soon after *stop is set.
Result<std::string> hashFile(const std::string& path, const std::atomic<bool>* stop = nullptr);

}  // namespace relievo
