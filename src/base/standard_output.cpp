#include "src/base/standard_output.h"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <optional>

#include "src/base/progress.h"

namespace relievo {
namespace {

constexpr size_t kBufferBytes = size_t{64} << 10;

struct Out {
  std::string buffer;
  bool claimed = false;
  std::optional<Error> error;
};
Out& out() {
  static Out the_one;
  return the_one;
}

Error outError(int error_number) {
  std::string hint;
  if (error_number == ENOSPC || error_number == EDQUOT) hint = "free some disk space, or redirect it to another disk";
  if (error_number == EFBIG) hint = "files may not be so large here: see ulimit -f";
  if (error_number == EPIPE) hint = "whoever was to read it has ended";
  if (error_number == EBADF) hint = "it is closed; redirect it to a file or to /dev/null";
  if (error_number == EINTR) return {ErrorKind::kInterrupted, "standard output", "interrupted", "", {}};
  return {ErrorKind::kIo, "standard output", std::string("writing failed: ") + std::strerror(error_number), hint, {}};
}

Result<void> writeBuffered() {
  Out& o = out();
  if (!o.error && !o.buffer.empty()) {
    if (int bad = writeAll(STDOUT_FILENO, {reinterpret_cast<const uint8_t*>(o.buffer.data()), o.buffer.size()}))
      o.error = outError(bad);
  }
  o.buffer.clear();
  if (o.error) return *o.error;
  return {};
}

}  // namespace

void openStandardDescriptors() {
  for (int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (::fcntl(fd, F_GETFD) >= 0 || errno != EBADF) continue;
    // The lowest number that is free is fd's own. Standard output is opened for reading, so that writing to it fails.
    if (::open("/dev/null", fd == STDERR_FILENO ? O_WRONLY : O_RDONLY) != fd)
      std::_Exit(static_cast<int>(ErrorKind::kIo));
  }
}

int writeAll(int descriptor, std::span<const uint8_t> bytes) {
  for (size_t done = 0; done < bytes.size();) {
    const ssize_t n = ::write(descriptor, bytes.data() + done, bytes.size() - done);
    if (n > 0) {
      done += static_cast<size_t>(n);
    } else if (n == 0) {
      return ENOSPC;
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      pollfd ready{descriptor, POLLOUT, 0};
      if (::poll(&ready, 1, -1) < 0 && errno != EINTR) return errno;
      if (interruptedFlag()) return EINTR;
    } else if (errno != EINTR || interruptedFlag()) {
      return errno;
    }
  }
  return 0;
}

Result<void> printOut(std::string_view text) {
  Out& o = out();
  if (o.claimed) {
    std::fwrite(text.data(), 1, text.size(), stderr);
    return {};
  }
  static const bool terminal = ::isatty(STDOUT_FILENO) != 0;
  if (!o.error) o.buffer += text;
  if (o.buffer.size() >= kBufferBytes || (terminal && text.find('\n') != std::string_view::npos))
    return writeBuffered();
  if (o.error) return *o.error;
  return {};
}

void printOutf(const char* format, ...) {
  va_list arguments, again;
  va_start(arguments, format);
  va_copy(again, arguments);
  const int size = std::vsnprintf(nullptr, 0, format, arguments);
  va_end(arguments);
  std::string text(size > 0 ? static_cast<size_t>(size) : 0, '\0');
  if (size > 0) std::vsnprintf(text.data(), text.size() + 1, format, again);
  va_end(again);
  (void)printOut(text);  // the error stays: flushOut() returns it
}

Result<void> flushOut() {
  auto flushed = writeBuffered();
  if (!flushed) return flushed;
  // A file system over the network may tell only a close that the disk is full.
  if (const int again = ::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3);
      again >= 0 && ::close(again) != 0 && errno != EINTR) {
    out().error = outError(errno);
    return *out().error;
  }
  return {};
}

void claimOut() {
  (void)writeBuffered();  // printed before, so it stands before; its error stays
  out().claimed = true;
}

Result<void> writeOut(std::span<const uint8_t> bytes) {
  Out& o = out();
  if (o.error) return *o.error;
  if (int bad = writeAll(STDOUT_FILENO, bytes)) {
    const Error error = outError(bad);
    return error;  // told by whoever writes the file; flushOut() need not tell it again
  }
  return {};
}

}  // namespace relievo
