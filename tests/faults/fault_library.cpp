// fault_library.cpp - makes chosen calls of a program fail, to see what the program makes of it. Loaded with
// LD_PRELOAD.
//
// What it does is said by environment variables:
//   RELIEVO_FAULT_KINDS    which calls are counted, separated by commas:
//                            open, read, write, sync, rename, unlink, close, truncate, map, lock
//                                    calls on files under RELIEVO_FAULT_FOLDER, by name or by descriptor;
//                                    stdio's and the standard library's streams included
//                            alloc   malloc, operator new and their relatives called by the program's own code
//                            string  operator new called by the C++ standard library
//                            thread  threads of the program's own code (not those of the libraries it uses)
//   RELIEVO_FAULT_FOLDER   an absolute path
//   RELIEVO_FAULT_NTH      the call that fails, from 1 on; 0 or missing: none, calls are only counted
//   RELIEVO_FAULT_BYTE     instead: the call that writes this byte (from 0 on, counted over all writes); the bytes
//                          before it are written first, as by a disk that fills up, or a process that is killed
//   RELIEVO_FAULT_ACTION   the name of an errno (EIO, ENOSPC, EMFILE, ENOMEM, EAGAIN, EINTR, EINVAL), KILL (SIGKILL),
//                          INT (SIGINT, and the call goes on), or SHORT (half of the bytes are read or written, which
//                          is no error)
//   RELIEVO_FAULT_ALL      1: every call from the chosen one on fails
//   RELIEVO_FAULT_REPORT   a file of at least sizeof(FaultReport) bytes, into which the counts are written as they
//                          grow, so that they survive a kill (fault_report.h)
//
// Counting starts and ends with main(): what static constructors and destructors do, all of them libraries', is not the
// program's to mend. A failing close() closes, as the kernel's does. A failing stream loses what it has buffered, as a
// stream does whose buffer cannot be written.
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <malloc.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdio_ext.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <new>

#include "tests/faults/fault_report.h"

extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
}

namespace {

using namespace relievo::testing_support;

constexpr int kKill = -1, kShort = -2, kInterrupt = -3;
constexpr int kMaxDescriptors = 4096;

bool armed = false;
unsigned kinds = 0;
uint64_t nth = 0, at_byte = ~uint64_t{0};
bool by_byte = false, all = false;
int action = EIO;
char folder[PATH_MAX];
size_t folder_size = 0;
std::atomic<bool> tracked[kMaxDescriptors];
FaultReport own_report;
FaultReport* report = &own_report;
uintptr_t program_begin = ~uintptr_t{0}, program_end = 0, library_begin = ~uintptr_t{0}, library_end = 0;

#define REAL(name) static decltype(&::name) real_##name = reinterpret_cast<decltype(&::name)>(dlsym(RTLD_NEXT, #name))

bool inProgram(const void* p) { return reinterpret_cast<uintptr_t>(p) - program_begin < program_end - program_begin; }
bool inStandardLibrary(const void* p) {
  return reinterpret_cast<uintptr_t>(p) - library_begin < library_end - library_begin;
}

int onModule(dl_phdr_info* info, size_t, void* data) {
  int& serial = *static_cast<int*>(data);
  const bool program = serial++ == 0;
  const bool library = info->dlpi_name && strstr(info->dlpi_name, "libstdc++");
  uintptr_t& begin = program ? program_begin : library_begin;
  uintptr_t& end = program ? program_end : library_end;
  if (!program && !library) return 0;
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const ElfW(Phdr)& h = info->dlpi_phdr[i];
    if (h.p_type != PT_LOAD) continue;
    begin = std::min<uintptr_t>(begin, info->dlpi_addr + h.p_vaddr);
    end = std::max<uintptr_t>(end, info->dlpi_addr + h.p_vaddr + h.p_memsz);
  }
  return 0;
}

__attribute__((constructor)) void configure() {
  int serial = 0;
  dl_iterate_phdr(onModule, &serial);
  if (const char* list = getenv("RELIEVO_FAULT_KINDS")) kinds = faultKindsOf(list);
  if (const char* f = getenv("RELIEVO_FAULT_FOLDER")) folder_size = strlen(strncpy(folder, f, sizeof folder - 1));
  if (const char* n = getenv("RELIEVO_FAULT_NTH")) nth = strtoull(n, nullptr, 10);
  if (const char* n = getenv("RELIEVO_FAULT_BYTE")) by_byte = true, at_byte = strtoull(n, nullptr, 10);
  if (const char* n = getenv("RELIEVO_FAULT_ALL")) all = *n == '1';
  if (const char* a = getenv("RELIEVO_FAULT_ACTION")) {
    constexpr struct {
      const char* name;
      int value;
    } kActions[] = {{"EIO", EIO},     {"ENOSPC", ENOSPC}, {"EMFILE", EMFILE}, {"ENOMEM", ENOMEM}, {"EAGAIN", EAGAIN},
                    {"EINTR", EINTR}, {"EINVAL", EINVAL}, {"KILL", kKill},    {"SHORT", kShort},  {"INT", kInterrupt}};
    for (const auto& known : kActions)
      if (strcmp(a, known.name) == 0) action = known.value;
  }
  if (const char* path = getenv("RELIEVO_FAULT_REPORT")) {
    REAL(open);
    const int fd = real_open(path, O_RDWR | O_CLOEXEC);
    if (fd >= 0) {
      REAL(mmap);
      void* p = real_mmap(nullptr, sizeof(FaultReport), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
      if (p != MAP_FAILED) report = static_cast<FaultReport*>(p);
      REAL(close);
      real_close(fd);
    }
  }
}

void stopHere() {
  kill(getpid(), SIGKILL);
  for (;;) pause();
}

// Counts a call. True: it is to fail (or to be cut short).
bool fails(FaultKind kind) {
  if (!armed) return false;
  report->calls_of[kind].fetch_add(1);
  if (!(kinds & 1u << kind)) return false;
  const uint64_t n = report->calls.fetch_add(1) + 1;
  if (by_byte || nth == 0 || (all ? n < nth : n != nth)) return false;
  report->hit.fetch_add(1);
  if (action == kKill) stopHere();
  if (action == kInterrupt) {
    kill(getpid(), SIGINT);
    return false;
  }
  return true;
}
template <class T>
T failed(T value) {
  errno = action > 0 ? action : EIO;
  return value;
}

bool under(const char* path) {
  if (!folder_size || !path) return false;
  char whole[PATH_MAX];
  if (path[0] != '/') {
    if (!getcwd(whole, sizeof whole)) return false;
    const size_t n = strlen(whole);
    if (n + 1 + strlen(path) + 1 > sizeof whole) return false;
    whole[n] = '/';
    strcpy(whole + n + 1, path[0] == '.' && path[1] == '/' ? path + 2 : path);
    path = whole;
  }
  return strncmp(path, folder, folder_size) == 0 && (path[folder_size] == '/' || path[folder_size] == 0);
}
bool under(int at, const char* path) {
  return at == AT_FDCWD || (path && path[0] == '/') ? under(path)
                                                    : at >= 0 && at < kMaxDescriptors && tracked[at].load();
}
bool isTracked(int fd) { return fd >= 0 && fd < kMaxDescriptors && tracked[fd].load(); }
bool isTracked(FILE* f) { return f && isTracked(fileno(f)); }
template <class T>
T track(T fd) {
  if (fd >= 0 && fd < kMaxDescriptors) tracked[fd].store(true);
  return fd;
}
FILE* track(FILE* f) {
  if (f) track(fileno(f));
  return f;
}
bool failsOn(FaultKind kind, int fd) { return isTracked(fd) && fails(kind); }

// How many bytes of a write are to be written: all of them, some (then the disk is full or the process ends), or an
// error.
struct WriteFault {
  bool fail = false, then_kill = false;
  size_t bytes = 0;
};
WriteFault onWrite(int fd, size_t bytes) {
  WriteFault out{.bytes = bytes};
  if (!armed || !isTracked(fd)) return out;
  if (!(kinds & 1u << kWrite)) return fails(kWrite), out;
  const uint64_t begin = report->bytes.fetch_add(bytes), end = begin + bytes;
  if (by_byte) {
    report->calls.fetch_add(1), report->calls_of[kWrite].fetch_add(1);
    if (at_byte >= end || (at_byte < begin && !all)) return out;
    report->hit.fetch_add(1);
    out.bytes = static_cast<size_t>(at_byte > begin ? at_byte - begin : 0);
    if (action == kKill) out.then_kill = true;
    else out.fail = out.bytes == 0;
    return out;
  }
  if (!fails(kWrite)) return out;
  if (action == kShort) out.bytes = std::max<size_t>(1, bytes / 2);
  else out.fail = true;
  return out;
}
template <class Write>
ssize_t faultyWrite(int fd, size_t bytes, Write&& write) {
  const WriteFault f = onWrite(fd, bytes);
  if (f.fail) return failed<ssize_t>(-1);
  const ssize_t n = f.bytes == 0 && f.then_kill ? 0 : write(f.bytes);
  if (f.then_kill) stopHere();
  return n;
}
template <class Read>
ssize_t faultyRead(int fd, size_t bytes, Read&& read) {
  if (!failsOn(kRead, fd)) return read(bytes);
  if (action == kShort) return read(std::max<size_t>(1, bytes / 2));
  return failed<ssize_t>(-1);
}
size_t sizeOf(const iovec* parts, int count) {
  size_t n = 0;
  for (int i = 0; i < count; ++i) n += parts[i].iov_len;
  return n;
}
bool allocationFails(const void* caller) { return armed && inProgram(caller) && fails(kAlloc); }
bool newFails(const void* caller) {
  return armed && ((inProgram(caller) && fails(kAlloc)) || (inStandardLibrary(caller) && fails(kString)));
}
void* newBytes(size_t size, size_t alignment, const void* caller) {
  if (newFails(caller)) return nullptr;
  return alignment ? __libc_memalign(alignment, size ? size : 1) : __libc_malloc(size ? size : 1);
}
// An error flag as a stream has that could not write.
size_t failStream(FILE* f) {
  f->_flags |= 0x20;  // _IO_ERR_SEEN
  return failed<size_t>(0);
}

using Main = int (*)(int, char**, char**);
Main program_main = nullptr;
int armedMain(int argc, char** argv, char** environment) {
  armed = true;
  const int code = program_main(argc, argv, environment);
  armed = false;
  return code;
}

}  // namespace

extern "C" {

int __libc_start_main(Main main, int argc, char** argv, void (*init)(), void (*fini)(), void (*rtld_fini)(),
                      void* stack_end) {
  using Start = int (*)(Main, int, char**, void (*)(), void (*)(), void (*)(), void*);
  const Start start = reinterpret_cast<Start>(dlsym(RTLD_NEXT, "__libc_start_main"));
  program_main = main;
  return start(armedMain, argc, argv, init, fini, rtld_fini, stack_end);
}

// ---- opening ----
#define OPEN(name)                                           \
  int name(const char* path, int flags, ...) {               \
    va_list list;                                            \
    va_start(list, flags);                                   \
    const mode_t mode = va_arg(list, mode_t);                \
    va_end(list);                                            \
    REAL(name);                                              \
    if (!under(path)) return real_##name(path, flags, mode); \
    if (fails(kOpen)) return failed(-1);                     \
    return track(real_##name(path, flags, mode));            \
  }
OPEN(open)
OPEN(open64)
#define OPENAT(name)                                                 \
  int name(int at, const char* path, int flags, ...) {               \
    va_list list;                                                    \
    va_start(list, flags);                                           \
    const mode_t mode = va_arg(list, mode_t);                        \
    va_end(list);                                                    \
    REAL(name);                                                      \
    if (!under(at, path)) return real_##name(at, path, flags, mode); \
    if (fails(kOpen)) return failed(-1);                             \
    return track(real_##name(at, path, flags, mode));                \
  }
OPENAT(openat)
OPENAT(openat64)
// What fortified libraries call instead.
int __open_2(const char* path, int flags) { return open(path, flags, 0); }
int __open64_2(const char* path, int flags) { return open64(path, flags, 0); }
int mkostemp(char* pattern, int flags) {
  REAL(mkostemp);
  if (!under(pattern)) return real_mkostemp(pattern, flags);
  return fails(kOpen) ? failed(-1) : track(real_mkostemp(pattern, flags));
}
int mkstemp(char* pattern) { return mkostemp(pattern, 0); }
FILE* fopen(const char* path, const char* mode) {
  REAL(fopen);
  if (!under(path)) return real_fopen(path, mode);
  return fails(kOpen) ? failed<FILE*>(nullptr) : track(real_fopen(path, mode));
}
FILE* fopen64(const char* path, const char* mode) { return fopen(path, mode); }

int close(int fd) {
  REAL(close);
  const bool fail = failsOn(kClose, fd);
  if (fd >= 0 && fd < kMaxDescriptors) tracked[fd].store(false);
  const int closed = real_close(fd);
  return fail ? failed(-1) : closed;
}
// Its descriptor's number is the next file's, whoever opens that.
int closedir(DIR* entries) {
  REAL(closedir);
  if (const int fd = dirfd(entries); fd >= 0 && fd < kMaxDescriptors) tracked[fd].store(false);
  return real_closedir(entries);
}
int fclose(FILE* f) {
  REAL(fclose);
  const int fd = f ? fileno(f) : -1;
  // A stream's last write happens here.
  const bool lost = isTracked(fd) && __fpending(f) > 0 && onWrite(fd, __fpending(f)).fail;
  const bool fail = failsOn(kClose, fd);
  if (fd >= 0 && fd < kMaxDescriptors) tracked[fd].store(false);
  if (lost) __fpurge(f);
  const int closed = real_fclose(f);
  return lost || fail ? failed(EOF) : closed;
}

// ---- reading ----
ssize_t read(int fd, void* out, size_t size) {
  REAL(read);
  return faultyRead(fd, size, [&](size_t n) { return real_read(fd, out, n); });
}
ssize_t __read_chk(int fd, void* out, size_t size, size_t) { return read(fd, out, size); }
ssize_t pread(int fd, void* out, size_t size, off_t at) {
  REAL(pread);
  return faultyRead(fd, size, [&](size_t n) { return real_pread(fd, out, n, at); });
}
ssize_t pread64(int fd, void* out, size_t size, off64_t at) { return pread(fd, out, size, at); }
ssize_t __pread_chk(int fd, void* out, size_t size, off_t at, size_t) { return pread(fd, out, size, at); }
ssize_t __pread64_chk(int fd, void* out, size_t size, off64_t at, size_t) { return pread(fd, out, size, at); }
ssize_t readv(int fd, const iovec* parts, int count) {
  REAL(readv);
  return failsOn(kRead, fd) && action != kShort ? failed<ssize_t>(-1) : real_readv(fd, parts, count);
}
ssize_t preadv2(int fd, const iovec* parts, int count, off_t at, int flags) {
  REAL(preadv2);
  return failsOn(kRead, fd) && action != kShort ? failed<ssize_t>(-1) : real_preadv2(fd, parts, count, at, flags);
}
ssize_t preadv64v2(int fd, const iovec* parts, int count, off64_t at, int flags) {
  return preadv2(fd, parts, count, at, flags);
}
size_t fread(void* out, size_t size, size_t count, FILE* f) {
  REAL(fread);
  if (isTracked(f) && fails(kRead) && action != kShort) return failStream(f);
  return real_fread(out, size, count, f);
}
size_t __fread_chk(void* out, size_t, size_t size, size_t count, FILE* f) { return fread(out, size, count, f); }
char* fgets(char* out, int size, FILE* f) {
  REAL(fgets);
  if (isTracked(f) && fails(kRead) && action != kShort) return failStream(f), nullptr;
  return real_fgets(out, size, f);
}

// ---- writing ----
ssize_t write(int fd, const void* bytes, size_t size) {
  REAL(write);
  return faultyWrite(fd, size, [&](size_t n) { return real_write(fd, bytes, n); });
}
ssize_t pwrite(int fd, const void* bytes, size_t size, off_t at) {
  REAL(pwrite);
  return faultyWrite(fd, size, [&](size_t n) { return real_pwrite(fd, bytes, n, at); });
}
ssize_t pwrite64(int fd, const void* bytes, size_t size, off64_t at) { return pwrite(fd, bytes, size, at); }
ssize_t writev(int fd, const iovec* parts, int count) {
  REAL(writev);
  if (!isTracked(fd)) return real_writev(fd, parts, count);
  return faultyWrite(fd, sizeOf(parts, count), [&](size_t n) {
    ssize_t done = 0;
    for (int i = 0; i < count && n > 0; ++i) {
      REAL(write);
      const size_t part = std::min(n, parts[i].iov_len);
      const ssize_t w = real_write(fd, parts[i].iov_base, part);
      if (w < 0) return done ? done : w;
      done += w, n -= part;
    }
    return done;
  });
}
size_t fwrite(const void* bytes, size_t size, size_t count, FILE* f) {
  REAL(fwrite);
  if (!isTracked(f)) return real_fwrite(bytes, size, count, f);
  const WriteFault fault = onWrite(fileno(f), size * count);
  if (fault.fail) return failStream(f);
  if (fault.then_kill) {
    real_fwrite(bytes, 1, fault.bytes, f);
    fflush(f);
    stopHere();
  }
  return real_fwrite(bytes, size, count, f);
}
int fputs(const char* text, FILE* f) {
  REAL(fputs);
  if (!isTracked(f)) return real_fputs(text, f);
  return fwrite(text, 1, strlen(text), f) == strlen(text) ? 1 : EOF;
}

// ---- what makes it last ----
int fsync(int fd) {
  REAL(fsync);
  return failsOn(kSync, fd) ? failed(-1) : real_fsync(fd);
}
int fdatasync(int fd) {
  REAL(fdatasync);
  return failsOn(kSync, fd) ? failed(-1) : real_fdatasync(fd);
}
int sync_file_range(int fd, off64_t at, off64_t size, unsigned flags) {
  REAL(sync_file_range);
  return failsOn(kSync, fd) ? failed(-1) : real_sync_file_range(fd, at, size, flags);
}
int rename(const char* from, const char* to) {
  REAL(rename);
  return (under(from) || under(to)) && fails(kRename) ? failed(-1) : real_rename(from, to);
}
int renameat(int from_at, const char* from, int to_at, const char* to) {
  REAL(renameat);
  return (under(from_at, from) || under(to_at, to)) && fails(kRename) ? failed(-1)
                                                                      : real_renameat(from_at, from, to_at, to);
}
int renameat2(int from_at, const char* from, int to_at, const char* to, unsigned flags) {
  REAL(renameat2);
  return (under(from_at, from) || under(to_at, to)) && fails(kRename) ? failed(-1)
                                                                      : real_renameat2(from_at, from, to_at, to, flags);
}
int link(const char* from, const char* to) {
  REAL(link);
  return (under(from) || under(to)) && fails(kRename) ? failed(-1) : real_link(from, to);
}
int linkat(int from_at, const char* from, int to_at, const char* to, int flags) {
  REAL(linkat);
  return (under(from_at, from) || under(to_at, to)) && fails(kRename) ? failed(-1)
                                                                      : real_linkat(from_at, from, to_at, to, flags);
}
int unlink(const char* path) {
  REAL(unlink);
  return under(path) && fails(kUnlink) ? failed(-1) : real_unlink(path);
}
int ftruncate(int fd, off_t size) {
  REAL(ftruncate);
  return failsOn(kTruncate, fd) ? failed(-1) : real_ftruncate(fd, size);
}
int ftruncate64(int fd, off64_t size) { return ftruncate(fd, size); }
// By another name here, because fcntl.h has a struct of the same one.
int faultyFlock(int fd, int operation) __asm__("flock");
int faultyFlock(int fd, int operation) {
  using Flock = int (*)(int, int);
  static const Flock real_flock = reinterpret_cast<Flock>(dlsym(RTLD_NEXT, "flock"));
  return failsOn(kLock, fd) ? failed(-1) : real_flock(fd, operation);
}
void* mmap(void* address, size_t size, int protection, int flags, int fd, off_t at) {
  REAL(mmap);
  return failsOn(kMap, fd) ? failed(MAP_FAILED) : real_mmap(address, size, protection, flags, fd, at);
}
void* mmap64(void* address, size_t size, int protection, int flags, int fd, off64_t at) {
  REAL(mmap64);
  return failsOn(kMap, fd) ? failed(MAP_FAILED) : real_mmap64(address, size, protection, flags, fd, at);
}

// ---- memory ----
void* malloc(size_t size) {
  if (allocationFails(__builtin_return_address(0))) return errno = ENOMEM, nullptr;
  return __libc_malloc(size);
}
void* calloc(size_t count, size_t size) {
  if (allocationFails(__builtin_return_address(0))) return errno = ENOMEM, nullptr;
  return __libc_calloc(count, size);
}
void* realloc(void* p, size_t size) {
  if (size && allocationFails(__builtin_return_address(0))) return errno = ENOMEM, nullptr;
  return __libc_realloc(p, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  if (allocationFails(__builtin_return_address(0))) return errno = ENOMEM, nullptr;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** out, size_t alignment, size_t size) {
  if (allocationFails(__builtin_return_address(0))) return ENOMEM;
  void* p = __libc_memalign(alignment, size);
  if (!p) return ENOMEM;
  *out = p;
  return 0;
}

// ---- threads ----
int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*start)(void*), void* argument) {
  REAL(pthread_create);
  // std::thread hands over an object whose class is known only to the code that started it.
  const bool own = inProgram(reinterpret_cast<void*>(start)) || (inStandardLibrary(reinterpret_cast<void*>(start)) &&
                                                                 argument && inProgram(*static_cast<void**>(argument)));
  if (own && fails(kThread)) return action > 0 ? action : EAGAIN;
  return real_pthread_create(thread, attributes, start, argument);
}

}  // extern "C"

void* operator new(size_t size) {
  if (void* p = newBytes(size, 0, __builtin_return_address(0))) return p;
  throw std::bad_alloc();
}
void* operator new[](size_t size) {
  if (void* p = newBytes(size, 0, __builtin_return_address(0))) return p;
  throw std::bad_alloc();
}
void* operator new(size_t size, std::align_val_t alignment) {
  if (void* p = newBytes(size, static_cast<size_t>(alignment), __builtin_return_address(0))) return p;
  throw std::bad_alloc();
}
void* operator new[](size_t size, std::align_val_t alignment) {
  if (void* p = newBytes(size, static_cast<size_t>(alignment), __builtin_return_address(0))) return p;
  throw std::bad_alloc();
}
void* operator new(size_t size, const std::nothrow_t&) noexcept {
  return newBytes(size, 0, __builtin_return_address(0));
}
void* operator new[](size_t size, const std::nothrow_t&) noexcept {
  return newBytes(size, 0, __builtin_return_address(0));
}
