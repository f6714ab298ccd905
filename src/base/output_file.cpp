// output_file.cpp - files that appear whole or not at all (OutputFile of file.h): what a path stands for, part files
// beside it, and how they take its place.
#include <dirent.h>
#include <fcntl.h>
#include <limits.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <functional>
#include <mutex>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "src/base/file.h"
#include "src/base/file_error.h"
#include "src/base/standard_output.h"

namespace relievo {
namespace {

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

// "FOLDER/" or "": where the last part of a path stands.
std::string folderOf(const std::string& path) { return path.substr(0, path.find_last_of('/') + 1); }

int openFolder(const std::string& folder) {
  return ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
}

bool sameInode(const struct stat& a, const struct stat& b) { return a.st_dev == b.st_dev && a.st_ino == b.st_ino; }

// The file's entry in its folder is on the disk. named: the path that an error tells.
Result<void> writeFolderOf(const std::string& file, const std::string& named, const char* doing) {
  const int folder = openFolder(folderOf(file));
  if (folder < 0) return {};  // it may be written to but not read: nothing to ask
  const int synced = ::fsync(folder), why = errno;
  ::close(folder);
  if (synced != 0 && why != EINVAL) return ioError(named, doing, why);
  return {};
}

// ---- What a path stands for ----

struct Target {
  OutputKind kind = OutputKind::kFile;
  std::string path;    // of the file that is replaced, with symbolic links followed
  bool there = false;  // it exists:
  struct stat status {};
};

Result<Target> targetOf(const std::string& path) {
  Target target{.path = path};
  if (path == "-") {
    target.kind = OutputKind::kStandardOutput;
    return target;
  }
  // The kernel follows links first: it refuses those that others planted in a folder that all may write to.
  target.there = ::stat(path.c_str(), &target.status) == 0;
  if (!target.there && errno != ENOENT) return ioError(path, "examining", errno);
  bool of_process = false;  // through /proc/self/fd: a descriptor, whatever file that is
  for (int links = 0;; ++links) {
    char to[PATH_MAX];
    const ssize_t size = ::readlink(target.path.c_str(), to, sizeof to);
    if (size < 0) break;
    of_process |= target.path.rfind("/proc/", 0) == 0 || target.path.rfind("/dev/fd/", 0) == 0;
    if (of_process) break;
    if (links == 40 || size == sizeof to) return ioError(path, "following links", ELOOP);
    const std::string text(to, static_cast<size_t>(size));
    target.path = text.rfind('/', 0) == 0 ? text : folderOf(target.path) + text;
  }
  if (!target.there) return target;
  const mode_t mode = target.status.st_mode;
  struct stat out {};
  if (of_process && ::fstat(STDOUT_FILENO, &out) == 0 && sameInode(out, target.status)) {
    target.kind = OutputKind::kStandardOutput;
  } else if (S_ISFIFO(mode) || S_ISCHR(mode)) {
    target.kind = OutputKind::kStream;
  } else if (S_ISDIR(mode)) {
    return Error{ErrorKind::kIo, path, "is a folder, expected the name of a file to write", "name a file", {}};
  } else if (!S_ISREG(mode) || of_process) {
    return Error{ErrorKind::kIo,
                 path,
                 std::string("is ") + (of_process ? "a file open elsewhere" : fileKindName(mode)) +
                     ", expected the name of a file to write",
                 of_process ? "name the file itself, or - for standard output" : "name a file",
                 {}};
  }
  return target;
}

// ---- Part files ----

constexpr std::string_view kPartMark = ".part-";
constexpr size_t kRandomDigits = 16;
// Names end at 255 bytes; a target's longer name is cut in its part file's.
constexpr size_t kMaxPartStem = 255 - kPartMark.size() - 10 - 1 - kRandomDigits;

// What a part file's name begins with, before kPartMark.
std::string partStem(const std::string& target) {
  return target.substr(folderOf(target).size()).substr(0, kMaxPartStem);
}

std::string randomDigits() {
  uint64_t random = 0;
  if (::getrandom(&random, sizeof random, 0) != sizeof random) {
    // Before Linux 3.17. Not secret, but O_EXCL refuses a name that is taken.
    timespec now{};
    ::clock_gettime(CLOCK_REALTIME, &now);
    random = static_cast<uint64_t>(now.tv_nsec) * 0x9E3779B97F4A7C15u ^ static_cast<uint64_t>(now.tv_sec);
  }
  char text[kRandomDigits + 1];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(random));
  return text;
}

// The target's name in that of its part file, followed by digits, "-" and kRandomDigits hexadecimal digits: a name that
// create() makes. Empty where it is none.
std::string_view targetOfPart(std::string_view name) {
  const size_t mark = name.rfind(kPartMark);
  if (mark == name.npos) return {};
  std::string_view rest = name.substr(mark + kPartMark.size());
  const size_t digits = rest.find_first_not_of("0123456789");
  if (digits == 0 || digits == rest.npos || rest[digits] != '-') return {};
  rest.remove_prefix(digits + 1);
  const bool part = rest.size() == kRandomDigits && rest.find_first_not_of("0123456789abcdef") == rest.npos;
  return part ? name.substr(0, mark) : std::string_view();
}

// Calls take(folder, name, fd) for each part file in the folder whose writer was killed and whose target has a name
// that ours() tells: regular files of this user that nobody holds locked. They are locked by fd, which is closed unless
// take returns true.
template <class Ours, class Take>
void forEachOrphan(const std::string& in_folder, Ours&& ours, int access, Take&& take) {
  const int folder = openFolder(in_folder);
  DIR* entries = folder < 0 ? nullptr : ::fdopendir(folder);
  if (!entries) {
    if (folder >= 0) ::close(folder);
    return;  // it cannot be listed; writing into it may be possible
  }
  while (const dirent* entry = ::readdir(entries)) {
    struct stat named {
    }, opened{};
    const std::string_view target = targetOfPart(entry->d_name);
    if (target.empty() || !ours(target) || ::fstatat(folder, entry->d_name, &named, AT_SYMLINK_NOFOLLOW) != 0 ||
        !S_ISREG(named.st_mode) || named.st_uid != ::geteuid())
      continue;
    const int fd = ::openat(folder, entry->d_name, access | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) continue;
    const bool orphan = ::fstat(fd, &opened) == 0 && sameInode(named, opened) && ::flock(fd, LOCK_EX | LOCK_NB) == 0;
    if (!orphan || !take(folder, entry->d_name, fd)) ::close(fd);
  }
  ::closedir(entries);
}

template <class Take>
void forEachOrphanOf(const std::string& target, int access, Take&& take) {
  const std::string stem = partStem(target);
  forEachOrphan(
      folderOf(target), [&](std::string_view name) { return name == stem; }, access, std::forward<Take>(take));
}

bool removeOrphan(int folder, const char* name, int /*fd*/) {
  ::unlinkat(folder, name, 0);
  return false;
}

// A file without a name, for what goes to a stream once it is whole.
int openUnnamed() {
  const char* named = ::getenv("TMPDIR");
  const std::string folder = named && *named ? named : "/tmp";
  int fd = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (fd >= 0) return fd;
  std::string name = folder + "/.relievo-XXXXXX";
  fd = ::mkostemp(name.data(), O_CLOEXEC);
  if (fd >= 0) ::unlink(name.c_str());
  return fd;
}

}  // namespace

struct OutputFile::Impl {
  static constexpr size_t kBufferBytes = size_t{4} << 20;
  Target target;
  std::string part_path;  // empty: the bytes are in a file without a name
  int fd = -1;
  int stream = -1;  // where they go then, unless to standard output
  int part_index = -1;
  uint64_t flushed = 0;
  std::atomic<uint64_t> end{0};  // of the last byte written
  std::vector<uint8_t> buffer;
  std::mutex failing;
  std::optional<Error> failed;  // the first write that failed: nothing is committed after it

  ~Impl() {
    if (part_index >= 0) {  // before the lock goes with the descriptor
      ::unlink(part_path.c_str());
      unregisterPartFile(part_index);
    }
    if (fd >= 0) ::close(fd);
    if (stream >= 0) ::close(stream);
  }
  Error fail(Error error) {
    std::lock_guard lock(failing);
    if (!failed) failed = error;
    return error;
  }
  Result<void> write(const std::string& path, uint64_t offset, std::span<const uint8_t> bytes) {
    size_t done = 0;
    while (done < bytes.size()) {
      ssize_t n = ::pwrite(fd, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return fail(ioError(path, "writing", n < 0 ? errno : ENOSPC));
      done += static_cast<size_t>(n);
    }
    for (uint64_t seen = end; seen < offset + done && !end.compare_exchange_weak(seen, offset + done);) {
    }
    return {};
  }
  Result<void> flush(const std::string& path) {
    auto written = write(path, flushed, buffer);
    if (!written) return written;
    flushed += buffer.size();
    buffer.clear();
    return written;
  }
  Result<void> createPart(const std::string& path) {
    // As open() to everybody does where there is no file yet; where there is one, what it permits is known only by
    // fchmod below.
    const mode_t mode = target.there ? 0600 : 0666;
    for (int attempt = 0; attempt < 100; ++attempt) {
      part_path = folderOf(target.path) + partStem(target.path) + std::string(kPartMark) + std::to_string(::getpid()) +
                  "-" + randomDigits();
      // Registered first: a signal between open and register would leave the file behind.
      part_index = registerPartFile(part_path);
      if (part_index < 0)
        return Error{
            ErrorKind::kRuntime, path, "too many files are being written at once, or the path is too long", "", {}};
      fd = ::open(part_path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, mode);
      if (fd < 0) {
        const int why = errno;
        unregisterPartFile(part_index);
        part_index = -1;
        if (why == EEXIST) continue;
        return ioError(path, "creating", why);
      }
      // Where the file system has no locks nobody can take one either, and nothing is mistaken for an orphan.
      while (::flock(fd, LOCK_EX) != 0 && errno == EINTR) {
      }
      struct stat st {};
      if (::fstat(fd, &st) == 0 && st.st_nlink > 0) return keepAccess(path, st);
      // Another process took it for an orphan before it was locked.
      unregisterPartFile(part_index);
      part_index = -1;
      ::close(fd);
      fd = -1;
    }
    return Error{ErrorKind::kIo, path, "no name for a file beside it is free", "write to another folder", {}};
  }
  // The part file gets owner, group and access mode of the file whose place it takes. A group that may not be given
  // away gets no access.
  Result<void> keepAccess(const std::string& path, const struct stat& part) {
    if (!target.there) return {};
    mode_t mode = target.status.st_mode & 0777;
    const gid_t group = target.status.st_gid;
    const bool owned = part.st_uid != target.status.st_uid && ::fchown(fd, target.status.st_uid, group) == 0;
    const bool grouped = owned || part.st_gid == group || ::fchown(fd, static_cast<uid_t>(-1), group) == 0;
    if (!grouped) mode &= ~static_cast<mode_t>(S_IRWXG);
    if (::fchmod(fd, mode) != 0 && errno != EPERM && errno != ENOTSUP)
      return ioError(path, "setting the access mode", errno);
    return {};
  }
  Result<void> openStream(const std::string& path) {
    if (target.kind == OutputKind::kStream) {
      // A pipe that nobody reads would be waited for.
      stream = ::open(path.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
      if (stream < 0 && errno == ENXIO && S_ISFIFO(target.status.st_mode))
        return Error{ErrorKind::kIo, path, "is a pipe that nobody reads", "start its reader first", {}};
      if (stream < 0) return ioError(path, "opening", errno);
      ::fcntl(stream, F_SETFL, ::fcntl(stream, F_GETFL) & ~O_NONBLOCK);
    } else {
      claimOut();
    }
    fd = openUnnamed();
    if (fd < 0) return ioError(path, "creating a temporary file (in TMPDIR or /tmp) for it", errno);
    return {};
  }
  Result<void> copyToStream(const std::string& path) {
    std::vector<uint8_t> piece(size_t{1} << 20);
    for (uint64_t offset = 0; offset < end;) {
      const size_t size = static_cast<size_t>(std::min<uint64_t>(piece.size(), end - offset));
      if (auto read = readBack(path, offset, {piece.data(), size}); !read) return read;
      if (target.kind == OutputKind::kStandardOutput) {
        if (auto written = writeOut({piece.data(), size}); !written) return written;
      } else if (int bad = writeAll(stream, {piece.data(), size})) {
        if (bad == EINTR) return Error{ErrorKind::kInterrupted, path, "interrupted", "", {}};
        return ioError(path, "writing", bad);
      }
      offset += size;
    }
    if (stream >= 0 && ::close(std::exchange(stream, -1)) != 0) return ioError(path, "writing", errno);
    return {};
  }
  Result<void> readBack(const std::string& path, uint64_t offset, std::span<uint8_t> out) const {
    for (size_t done = 0; done < out.size();) {
      const ssize_t n = ::pread(fd, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return ioError(path, "reading it back", errno);
      if (n == 0)
        return Error{ErrorKind::kIo,
                     path,
                     "reading it back failed: it ends too early",
                     "something else changes it, or the disk is damaged",
                     {}};
      done += static_cast<size_t>(n);
    }
    return {};
  }
};

void OutputFile::removeOrphans(const std::string& folder, const std::function<bool(std::string_view)>& ours) {
  forEachOrphan(folder, ours, O_RDONLY, removeOrphan);
}

OutputFile::OutputFile() = default;
OutputFile::OutputFile(OutputFile&&) noexcept = default;
OutputFile& OutputFile::operator=(OutputFile&&) noexcept = default;
OutputFile::~OutputFile() = default;

Result<OutputKind> OutputFile::check(const std::string& path) {
  auto target = targetOf(path);
  if (!target) return target.error();
  if (target->kind == OutputKind::kStream && ::access(path.c_str(), W_OK) != 0) return ioError(path, "opening", errno);
  if (target->kind != OutputKind::kFile) return target->kind;
  std::string folder = folderOf(target->path);
  if (folder.empty()) folder = "./";
  if (::access(folder.c_str(), W_OK | X_OK) == 0) return target->kind;
  const int why = errno;
  if (folder.size() > 1) folder.pop_back();
  return Error{
      ErrorKind::kIo,
      path,
      "cannot be written into the folder " + folder + ": " + std::strerror(why),
      why == ENOENT ? "make the folder first, or check the path" : "check the permissions, or name another folder",
      {}};
}

Result<OutputFile> OutputFile::create(const std::string& path) {
  auto target = targetOf(path);
  if (!target) return target.error();
  OutputFile file;
  file.path_ = path;
  file.impl_ = std::make_unique<Impl>();
  file.impl_->target = std::move(*target);
  if (file.impl_->target.kind != OutputKind::kFile) {
    if (auto opened = file.impl_->openStream(path); !opened) return opened.error();
    return file;
  }
  forEachOrphanOf(file.impl_->target.path, O_RDONLY, removeOrphan);
  if (auto created = file.impl_->createPart(path); !created) return created.error();
  return file;
}

Result<std::vector<OutputFile>> OutputFile::orphans(const std::string& path) {
  std::vector<OutputFile> found;
  auto target = targetOf(path);
  if (!target) return target.error();
  if (target->kind != OutputKind::kFile) return found;
  forEachOrphanOf(target->path, O_RDWR, [&](int, const char* name, int fd) {
    struct stat st {};
    if (::fstat(fd, &st) != 0) return false;
    OutputFile file;
    file.path_ = path;
    file.impl_ = std::make_unique<Impl>();
    Impl& impl = *file.impl_;
    impl.target = *target;
    impl.part_path = folderOf(target->path) + name;
    impl.part_index = registerPartFile(impl.part_path);
    if (impl.part_index < 0) return false;
    impl.flushed = static_cast<uint64_t>(st.st_size);
    impl.end = impl.flushed;
    found.push_back(std::move(file));
    found.back().impl_->fd = fd;
    return true;
  });
  return found;
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

Result<void> OutputFile::readBack(uint64_t offset, std::span<uint8_t> out) {
  if (auto flushed = impl_->flush(path_); !flushed) return flushed;
  return impl_->readBack(path_, offset, out);
}

Result<void> OutputFile::finish() {
  Impl& impl = *impl_;
  if (impl.failed) return *impl.failed;
  if (auto flushed = impl.flush(path_); !flushed) return flushed;
  if (::fsync(impl.fd) != 0 && errno != EINVAL) return impl.fail(ioError(path_, "writing", errno));
  struct stat st {};
  if (::fstat(impl.fd, &st) != 0) return impl.fail(ioError(path_, "examining", errno));
  if (static_cast<uint64_t>(st.st_size) != impl.end) {
    return impl.fail({ErrorKind::kIo,
                      path_,
                      "expected " + std::to_string(impl.end) + " bytes written, found " + std::to_string(st.st_size),
                      "something else changes the file, or the disk is damaged",
                      {}});
  }
  return {};
}

Result<void> OutputFile::commit() {
  Impl& impl = *impl_;
  if (auto finished = finish(); !finished) return finished;
  if (impl.part_path.empty()) return impl.copyToStream(path_);
  // Some file systems tell only here that the disk is full. The lock stays until the file has its place: a second
  // descriptor keeps it.
  const int lock = ::fcntl(impl.fd, F_DUPFD_CLOEXEC, 0);
  if (lock < 0) return ioError(path_, "closing", errno);
  const int closed = ::close(impl.fd);
  impl.fd = lock;
  if (closed != 0 && errno != EINTR) return impl.fail(ioError(path_, "writing", errno));
  if (::rename(impl.part_path.c_str(), impl.target.path.c_str()) != 0)
    return impl.fail(ioError(path_, "renaming into place", errno));
  unregisterPartFile(impl.part_index);
  impl.part_index = -1;
  ::close(impl.fd);
  impl.fd = -1;
  return writeFolderOf(impl.target.path, path_, "it is in its place, but writing its folder to the disk");
}

Result<void> OutputFile::truncate(uint64_t size) {
  Impl& impl = *impl_;
  if (auto flushed = impl.flush(path_); !flushed) return flushed;
  if (::ftruncate(impl.fd, static_cast<off_t>(size)) != 0) return impl.fail(ioError(path_, "cutting", errno));
  impl.flushed = size;
  impl.end = size;
  return {};
}

Result<void> OutputFile::syncFolder() {
  return writeFolderOf(impl_->target.path, path_, "writing its folder to the disk");
}

void OutputFile::keep() { unregisterPartFile(std::exchange(impl_->part_index, -1)); }

void OutputFile::remove() {
  if (impl_->part_path.empty()) return;
  ::unlink(impl_->part_path.c_str());
  keep();
}

Result<void> writeFile(const std::string& path, std::span<const uint8_t> bytes) {
  auto file = OutputFile::create(path);
  if (!file) return file.error();
  if (auto appended = file->append(bytes); !appended) return appended;
  return file->commit();
}

Result<void> renameFile(const std::string& from, const std::string& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) return ioError(to, "renaming into place", errno);
  return writeFolderOf(to, to, "it is in its place, but writing its folder to the disk");
}

void removePartFiles() {
  for (PartFile& part : part_files) {
    if (part.named.load()) ::unlink(part.path);
  }
}

}  // namespace relievo
