#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <functional>
#include <vector>

#include "texturing/package/package.h"
#include "texturing/package/package_sections.h"

namespace relievo {
namespace {

// A package that is written in place: whole or not at all does not apply here, see repairPackage.
class WritableFile {
 public:
  static Result<WritableFile> open(const std::string& path) {
    WritableFile file(path);
    file.fd_ = ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK);
    if (file.fd_ < 0) return file.failed("opening for repair", errno);
    struct stat st {};
    if (::fstat(file.fd_, &st) != 0) return file.failed("examining", errno);
    if (!S_ISREG(st.st_mode)) return Error{ErrorKind::kIo, path, "expected a regular file", "name a package", {}};
    if (::flock(file.fd_, LOCK_EX | LOCK_NB) != 0)
      return Error{ErrorKind::kIo, path, "another program has locked it", "wait until that has ended", {}};
    file.size_ = static_cast<uint64_t>(st.st_size);
    return file;
  }
  WritableFile(WritableFile&& other) noexcept
      : path_(std::move(other.path_)), fd_(std::exchange(other.fd_, -1)), size_(other.size_) {}
  WritableFile& operator=(WritableFile&&) = delete;
  ~WritableFile() {
    if (fd_ >= 0) ::close(fd_);
  }
  uint64_t size() const { return size_; }
  Result<void> read(uint64_t offset, std::span<uint8_t> out) const {
    for (size_t done = 0; done < out.size();) {
      const ssize_t n = ::pread(fd_, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return failed("reading", errno);
      if (n == 0) return Error{ErrorKind::kInvalidData, path_, "the file ends too early", "get a whole copy", offset};
      done += static_cast<size_t>(n);
    }
    return {};
  }
  Result<void> write(uint64_t offset, std::span<const uint8_t> bytes) const {
    for (size_t done = 0; done < bytes.size();) {
      const ssize_t n = ::pwrite(fd_, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return failed("repairing", errno);
      done += static_cast<size_t>(n);
    }
    return {};
  }
  Result<void> sync() const { return ::fsync(fd_) == 0 ? Result<void>() : failed("repairing", errno); }

 private:
  explicit WritableFile(std::string path) : path_(std::move(path)) {}
  Error failed(const char* doing, int error_number) const {
    return {ErrorKind::kIo,
            path_,
            std::string(doing) + " failed: " + std::strerror(error_number),
            error_number == EACCES || error_number == EROFS || error_number == EPERM
                ? "check the permissions"
                : "copy the package to another disk",
            {}};
  }
  std::string path_;
  int fd_ = -1;
  uint64_t size_ = 0;
};

// The section as it is at `from`, piece by piece; only pieces that differ are written.
Result<void> copyWithin(const WritableFile& file, const SectionFault& fault, const std::atomic<bool>* interrupted) {
  constexpr uint64_t kPieceBytes = uint64_t{1} << 20;
  std::vector<uint8_t> sound, present;
  for (uint64_t done = 0; done < fault.bytes; done += sound.size()) {
    if (interrupted && interrupted->load())
      return Error{ErrorKind::kInterrupted, "", "interrupted", "start it again to go on", {}};
    sound.assign(std::min(kPieceBytes, fault.bytes - done), 0);
    present.resize(sound.size());
    if (fault.mend == SectionFault::Mend::kCopy)
      if (auto got = file.read(fault.from + done, sound); !got) return got;
    if (fault.mend == SectionFault::Mend::kBytes)
      std::copy_n(fault.sound.begin() + static_cast<std::ptrdiff_t>(done), sound.size(), sound.begin());
    if (auto got = file.read(fault.offset + done, present); !got) return got;
    if (sound == present) continue;
    if (auto put = file.write(fault.offset + done, sound); !put) return put;
  }
  return {};
}

}  // namespace

Result<std::vector<std::string>> repairPackage(const std::string& path, const std::atomic<bool>* interrupted) {
  auto package = Package::open(path);
  if (!package) return package.error();
  // What has nothing to repair may be read-only.
  const ReadBytes present = [&](uint64_t offset, std::span<uint8_t> out) { return (*package)->readBytes(offset, out); };
  auto known = sectionFaults({(*package)->header(), (*package)->fileBytes()}, present, interrupted);
  if (!known) return known.error();
  if (std::none_of(known->begin(), known->end(),
                   [](const SectionFault& fault) { return fault.mend != SectionFault::Mend::kNone; }))
    return std::vector<std::string>();
  auto file = WritableFile::open(path);
  if (!file) return file.error();
  const ReadBytes read = [&](uint64_t offset, std::span<uint8_t> out) { return file->read(offset, out); };
  // A sound header of the very file that is written tells the places: by now another one may have that name.
  std::vector<uint8_t> bytes(kHeaderBytes);
  auto headerAt = [&](uint64_t offset) -> Result<PackageHeader> {
    if (auto got = file->read(offset, bytes); !got) return got.error();
    return decodeHeader(bytes, path);
  };
  auto header = headerAt(0);
  if (!header && file->size() >= kHeaderBytes) {
    header = headerAt(file->size() - kHeaderBytes);
    if (header && header->file_bytes != file->size())
      return Error{ErrorKind::kInvalidData, path, "no copy of the header is sound", "get a whole copy", {}};
  }
  if (!header) return header.error();
  auto faults = sectionFaults({*header, file->size()}, read, interrupted);
  if (!faults) return faults.error();
  std::vector<std::string> repaired;
  for (const SectionFault& fault : *faults) {
    if (fault.mend == SectionFault::Mend::kNone) continue;
    if (auto done = copyWithin(*file, fault, interrupted); !done) return done.error();
    if (auto done = file->sync(); !done) return done.error();
    repaired.push_back(fault.what +
                       (fault.mend == SectionFault::Mend::kZeros ? ": zeros written" : ": written anew from there"));
  }
  return repaired;
}

}  // namespace relievo
