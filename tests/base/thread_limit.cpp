#include "tests/base/thread_limit.h"

#include <dlfcn.h>
#include <pthread.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <memory>

namespace {

std::atomic<long> most{-1}, alive{0}, refused{0};

// At once: the program may end without a call of destructors.
void writeRefused() {
  const char* path = std::getenv("RELIEVO_THREADS_REFUSED");
  if (FILE* file = path ? std::fopen(path, "w") : nullptr) {
    std::fprintf(file, "%ld\n", refused.load());
    std::fclose(file);
  }
}

struct FromEnvironment {
  FromEnvironment() {
    if (const char* text = std::getenv("RELIEVO_MOST_THREADS")) most = std::atol(text);
    writeRefused();
  }
} from_environment;

struct Start {
  void* (*body)(void*);
  void* argument;
};

void* run(void* argument) {
  const Start start = *std::unique_ptr<Start>(static_cast<Start*>(argument));
  void* result = nullptr;
  pthread_cleanup_push([](void*) { --alive; }, nullptr);
  result = start.body(start.argument);
  pthread_cleanup_pop(1);
  return result;
}

}  // namespace

namespace relievo::testing_support {

void setMostThreads(long count) { most = count; }
long threadsRefused() { return refused; }

}  // namespace relievo::testing_support

#ifndef __SANITIZE_THREAD__  // which has that place itself
extern "C" __attribute__((visibility("default"))) int pthread_create(pthread_t* thread,
                                                                     const pthread_attr_t* attributes,
                                                                     void* (*body)(void*), void* argument) {
  static const auto next = reinterpret_cast<decltype(&pthread_create)>(dlsym(RTLD_NEXT, "pthread_create"));
  if (const long now = ++alive, limit = most; limit >= 0 && now > limit) {
    --alive;
    ++refused;
    writeRefused();
    return EAGAIN;
  }
  auto start = std::make_unique<Start>(Start{body, argument});
  const int failed = next(thread, attributes, run, start.get());
  if (failed) --alive;
  else start.release();
  return failed;
}
#endif
