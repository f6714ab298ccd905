#include "src/base/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <vector>

namespace relievo {
namespace {

Error ioError(const std::string& path, const char* doing, int error_number) {
  std::string hint;
  if (error_number == ENOSPC) hint = "free some disk space, or write to another disk";
  if (error_number == EFBIG) hint = "files may not be so large here: see ulimit -f, or write to another disk";
  if (error_number == ENOENT) hint = "check the path";
  if (error_number == EACCES || error_number == EROFS) hint = "check the permissions";
  return {ErrorKind::kIo, path, std::string(doing) + " failed: " + std::strerror(error_number), hint, {}};
}

// Part files of this process that are not yet committed: fixed storage, because a signal handler reads it.
constexpr int kMaxPartFiles = 64;
constexpr size_t kMaxPathBytes = 4096;
struct PartFile {
  std::atomic<bool> used{false}, named{false};
  char path[kMaxPathBytes];
};
PartFile part_files[kMaxPartFiles];

int registerPartFile(const std::string& path) {
  if (path.size() + 1 > kMaxPathBytes) return -1;
  for (int i = 0; i < kMaxPartFiles; ++i) {
    bool expected = false;
    if (!part_files[i].used.compare_exchange_strong(expected, true)) continue;
    std::memcpy(part_files[i].path, path.c_str(), path.size() + 1);
    part_files[i].named.store(true);
    return i;
  }
  return -1;
}

void unregisterPartFile(int index) {
  if (index < 0) return;
  part_files[index].named.store(false);
  part_files[index].used.store(false);
}

}  // namespace

Result<InputFile> InputFile::open(const std::string& path) {
  InputFile file;
  file.path_ = path;
  file.fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file.fd_ < 0) return ioError(path, "opening", errno);
  struct stat st {};
  if (::fstat(file.fd_, &st) != 0) return ioError(path, "examining", errno);
  if (S_ISDIR(st.st_mode)) return Error{ErrorKind::kIo, path, "is a folder, expected a file", "name a file", {}};
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
      return Error{ErrorKind::kInvalidData, path_,
                   "the file ends too early: expected " + std::to_string(out.size()) + " bytes, found " +
                       std::to_string(done),
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

struct OutputFile::Impl {
  static constexpr size_t kBufferBytes = size_t{4} << 20;
  std::string part_path;
  int fd = -1;
  int part_index = -1;
  uint64_t flushed = 0;
  std::vector<uint8_t> buffer;

  ~Impl() {
    if (fd >= 0) ::close(fd);
    if (part_index >= 0) {
      ::unlink(part_path.c_str());
      unregisterPartFile(part_index);
    }
  }
  Result<void> write(const std::string& path, uint64_t offset, std::span<const uint8_t> bytes) {
    size_t done = 0;
    while (done < bytes.size()) {
      ssize_t n = ::pwrite(fd, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return ioError(path, "writing", errno);
      done += static_cast<size_t>(n);
    }
    return {};
  }
  Result<void> flush(const std::string& path) {
    auto written = write(path, flushed, buffer);
    if (!written) return written;  // what is buffered stays: a later commit writes all of it or fails again
    flushed += buffer.size();
    buffer.clear();
    return written;
  }
};

OutputFile::OutputFile() = default;
OutputFile::OutputFile(OutputFile&&) noexcept = default;
OutputFile& OutputFile::operator=(OutputFile&&) noexcept = default;
OutputFile::~OutputFile() = default;

Result<OutputFile> OutputFile::create(const std::string& path) {
  static std::atomic<int> serial{0};
  OutputFile file;
  file.path_ = path;
  file.impl_ = std::make_unique<Impl>();
  Impl& impl = *file.impl_;
  impl.part_path = path + ".part-" + std::to_string(::getpid());
  if (int n = serial++; n > 0) impl.part_path += "-" + std::to_string(n);
  struct stat st {};
  if (::stat(path.c_str(), &st) == 0 && S_ISDIR(st.st_mode)) {
    return Error{ErrorKind::kIo, path, "is a folder, expected the name of a file to write", "name a file", {}};
  }
  // Registered first: a signal between open and register would leave the file behind.
  impl.part_index = registerPartFile(impl.part_path);
  if (impl.part_index < 0) {
    return Error{ErrorKind::kRuntime, path, "too many files are being written at once, or the path is too long", "", {}};
  }
  impl.fd = ::open(impl.part_path.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (impl.fd < 0) return ioError(path, "creating", errno);
  return file;
}

Result<void> OutputFile::append(std::span<const uint8_t> bytes) {
  Impl& impl = *impl_;
  if (impl.buffer.size() + bytes.size() > Impl::kBufferBytes) {
    if (auto flushed = impl.flush(path_); !flushed) return flushed;
  }
  impl.buffer.insert(impl.buffer.end(), bytes.begin(), bytes.end());
  return {};
}

Result<void> OutputFile::writeAt(uint64_t offset, std::span<const uint8_t> bytes) {
  if (!impl_->buffer.empty() && offset + bytes.size() > impl_->flushed) {
    if (auto flushed = impl_->flush(path_); !flushed) return flushed;
  }
  return impl_->write(path_, offset, bytes);
}

const std::string& OutputFile::partPath() const { return impl_->part_path; }

uint64_t OutputFile::size() const { return impl_->flushed + impl_->buffer.size(); }

Result<void> OutputFile::finish() {
  Impl& impl = *impl_;
  if (auto flushed = impl.flush(path_); !flushed) return flushed;
  if (::fsync(impl.fd) != 0 && errno != EINVAL) return ioError(path_, "writing", errno);
  return {};
}

Result<void> OutputFile::commit() {
  Impl& impl = *impl_;
  if (auto finished = finish(); !finished) return finished;
  int closed = ::close(impl.fd);
  impl.fd = -1;
  if (closed != 0) return ioError(path_, "writing", errno);
  if (::rename(impl.part_path.c_str(), path_.c_str()) != 0) return ioError(path_, "renaming into place", errno);
  unregisterPartFile(impl.part_index);
  impl.part_index = -1;
  return {};
}

Result<void> writeFile(const std::string& path, std::span<const uint8_t> bytes) {
  auto file = OutputFile::create(path);
  if (!file) return file.error();
  if (auto appended = file->append(bytes); !appended) return appended;
  return file->commit();
}

Result<std::string> readTextFile(const std::string& path, uint64_t max_bytes) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() > max_bytes) {
    return Error{ErrorKind::kInvalidData, path,
                 "expected at most " + std::to_string(max_bytes) + " bytes, found " + std::to_string(file->size()),
                 "is this the right file?", {}};
  }
  std::string text(file->size(), '\0');
  auto read = file->read(0, {reinterpret_cast<uint8_t*>(text.data()), text.size()});
  if (!read) return read.error();
  return text;
}

void removePartFiles() {
  for (PartFile& part : part_files) {
    if (part.named.load()) ::unlink(part.path);
  }
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
