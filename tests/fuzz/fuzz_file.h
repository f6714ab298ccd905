// fuzz_file.h - what the fuzz targets share: inputs as files, since readers take paths, and a way to fail that
// libFuzzer counts as a crash.
#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <span>
#include <string>

#include "src/base/result.h"

namespace relievo::fuzz {

// A property that holds for every input, or the input is kept as a crash.
inline void require(bool holds, const std::string& what) {
  if (holds) return;
  std::fprintf(stderr, "fuzz: broken: %s\n", what.c_str());
  std::abort();
}
// Every refusal says what is wrong.
inline void requireExplained(const Error& error) { require(!error.message.empty(), "an error without a message"); }

// A folder of this process's own, in memory where the system has /dev/shm; gone when the process ends by itself.
class Folder {
 public:
  Folder() {
    const bool in_memory = access("/dev/shm", W_OK) == 0;
    std::string pattern = (in_memory ? std::string("/dev/shm") : std::filesystem::temp_directory_path().string()) +
                          "/relievo-fuzz-XXXXXX";
    if (!mkdtemp(pattern.data())) {
      std::perror("fuzz: a folder for the inputs");
      std::abort();
    }
    path_ = pattern;
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::string file(const std::string& name) const { return path_ + "/" + name; }
  // Overwrites in place: a file a run, tens of thousands a second.
  std::string put(const std::string& name, std::span<const uint8_t> bytes) const {
    const std::string path = file(name);
    const int fd = open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    bool good = fd >= 0;
    for (size_t at = 0; good && at < bytes.size();) {
      const ssize_t n = write(fd, bytes.data() + at, bytes.size() - at);
      good = n > 0;
      if (good) at += static_cast<size_t>(n);
    }
    if (fd >= 0) close(fd);
    if (!good) {
      std::perror("fuzz: writing an input");
      std::abort();
    }
    return path;
  }

 private:
  std::string path_;
};
inline const Folder& folder() {
  static const Folder folder;
  return folder;
}

}  // namespace relievo::fuzz
