#include "src/base/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "src/base/file_error.h"

namespace relievo {

Error ioError(const std::string& path, const char* doing, int error_number) {
  std::string hint;
  if (error_number == ENOSPC || error_number == EDQUOT) hint = "free some disk space, or write to another disk";
  if (error_number == EFBIG) hint = "files may not be so large here: see ulimit -f, or write to another disk";
  if (error_number == ENOENT) hint = "check the path";
  if (error_number == EACCES || error_number == EROFS) hint = "check the permissions";
  return {ErrorKind::kIo, path, std::string(doing) + " failed: " + std::strerror(error_number), hint, {}};
}

const char* fileKindName(mode_t mode) {
  return S_ISDIR(mode)    ? "a folder"
         : S_ISFIFO(mode) ? "a pipe"
         : S_ISSOCK(mode) ? "a socket"
         : S_ISCHR(mode)  ? "a character device"
         : S_ISBLK(mode)  ? "a block device"
                          : "no regular file";
}

Result<InputFile> InputFile::open(const std::string& path) {
  InputFile file;
  file.path_ = path;
  struct stat st {};
  const auto refused = [&]() -> std::optional<Error> {
    if (S_ISREG(st.st_mode)) return std::nullopt;
    const bool stream = S_ISFIFO(st.st_mode) || S_ISCHR(st.st_mode);
    return Error{ErrorKind::kIo,
                 path,
                 std::string("is ") + fileKindName(st.st_mode) + ", expected a file",
                 stream ? "it is read at any place, so write its bytes into a file first" : "name a file",
                 {}};
  };
  // Before it is opened: opening a pipe waits for its writer, and opening a device may make it act. After: the path may
  // stand for something else by now.
  if (::stat(path.c_str(), &st) != 0) return ioError(path, "opening", errno);
  if (auto no = refused()) return *no;
  file.fd_ = ::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
  if (file.fd_ < 0) return ioError(path, "opening", errno);
  if (::fstat(file.fd_, &st) != 0) return ioError(path, "examining", errno);
  if (auto no = refused()) return *no;
  file.size_ = static_cast<uint64_t>(st.st_size);
  return file;
}

InputFile::InputFile(InputFile&& other) noexcept
    : path_(std::move(other.path_)), fd_(std::exchange(other.fd_, -1)), size_(other.size_) {}

InputFile& InputFile::operator=(InputFile&& other) noexcept {
  if (this != &other) {
    if (fd_ >= 0) ::close(fd_);
    path_ = std::move(other.path_);
    fd_ = std::exchange(other.fd_, -1);
    size_ = other.size_;
  }
  return *this;
}

InputFile::~InputFile() {
  if (fd_ >= 0) ::close(fd_);
}

Result<void> InputFile::read(uint64_t offset, std::span<uint8_t> out) const {
  size_t done = 0;
  while (done < out.size()) {
    ssize_t n = ::pread(fd_, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return ioError(path_, "reading", errno);
    if (n == 0) {
      return Error{
          ErrorKind::kInvalidData, path_,
          "the file ends too early: expected " + std::to_string(out.size()) + " bytes, found " + std::to_string(done),
          "it is truncated; get a whole copy", offset};
    }
    done += static_cast<size_t>(n);
  }
  return {};
}

bool InputFile::readIfCached(uint64_t offset, std::span<uint8_t> out) const {
#ifdef RWF_NOWAIT
  iovec part{out.data(), out.size()};
  return ::preadv2(fd_, &part, 1, static_cast<off_t>(offset), RWF_NOWAIT) == static_cast<ssize_t>(out.size());
#else
  (void)offset, (void)out;
  return false;
#endif
}

void InputFile::willNeed(uint64_t offset, uint64_t bytes) const {
  ::posix_fadvise(fd_, static_cast<off_t>(offset), static_cast<off_t>(bytes), POSIX_FADV_WILLNEED);
}

Result<std::string> readTextFile(const std::string& path, uint64_t max_bytes) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() > max_bytes) {
    return Error{ErrorKind::kInvalidData,
                 path,
                 "expected at most " + std::to_string(max_bytes) + " bytes, found " + std::to_string(file->size()),
                 "is this the right file?",
                 {}};
  }
  std::string text(file->size(), '\0');
  auto read = file->read(0, {reinterpret_cast<uint8_t*>(text.data()), text.size()});
  if (!read) return read.error();
  return text;
}

Result<std::string> hashFile(const std::string& path, const std::atomic<bool>* stop) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  XXH3_state_t* state = XXH3_createState();
  XXH3_64bits_reset(state);
  std::vector<uint8_t> buffer(std::min<uint64_t>(file->size(), uint64_t{4} << 20));
  for (uint64_t offset = 0; offset < file->size(); offset += buffer.size()) {
    if (stop && stop->load()) {
      XXH3_freeState(state);
      return Error{ErrorKind::kInterrupted, path, "interrupted", "", {}};
    }
    std::span<uint8_t> chunk(buffer.data(), std::min<uint64_t>(buffer.size(), file->size() - offset));
    if (auto read = file->read(offset, chunk); !read) {
      XXH3_freeState(state);
      return read.error();
    }
    XXH3_64bits_update(state, chunk.data(), chunk.size());
  }
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(XXH3_64bits_digest(state)));
  XXH3_freeState(state);
  return std::string(text);
}

}  // namespace relievo
