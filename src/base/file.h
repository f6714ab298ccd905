// file.h - files by offset, and files that appear whole or not at all.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "src/base/result.h"

namespace relievo {

// Reads at any offset (pread); const and thread-safe.
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

// Written as PATH.part-PID beside the target and renamed over it by commit(). Until then the target is untouched; the
// destructor removes an uncommitted part file, and removePartFiles() (async-signal-safe) removes all of this process's.
class OutputFile {
 public:
  static Result<OutputFile> create(const std::string& path);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  ~OutputFile();

  const std::string& path() const { return path_; }
  // The file beside the target, created and empty: for libraries that write by name (they may truncate it, not rename it).
  const std::string& partPath() const;
  Result<void> append(std::span<const uint8_t> bytes);  // buffered
  // Straight to the file (what append still buffers is written first if the two overlap). Several threads may call it at
  // once, as long as none appends.
  Result<void> writeAt(uint64_t offset, std::span<const uint8_t> bytes);
  uint64_t size() const;                                // bytes appended so far
  // All of it on the disk, still under partPath(): of several files that belong together none takes its place before each has been finished.
  Result<void> finish();
  Result<void> commit();                                // finish, rename

 private:
  struct Impl;
  OutputFile();
  std::string path_;
  std::unique_ptr<Impl> impl_;
};

// Writes a whole small file this way.
Result<void> writeFile(const std::string& path, std::span<const uint8_t> bytes);
Result<std::string> readTextFile(const std::string& path, uint64_t max_bytes);
// Unlinks every part file of this process that is not yet committed. Async-signal-safe.
void removePartFiles();
// xxh3-64 of a whole file's bytes as 16 hex digits. Gives up (kInterrupted) soon after *stop is set.
Result<std::string> hashFile(const std::string& path, const std::atomic<bool>* stop = nullptr);

}  // namespace relievo
