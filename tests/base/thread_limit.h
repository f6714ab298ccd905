// thread_limit.h - a system that gives few threads, for tests. The library takes pthread_create's place in the program
// that it is linked with, or preloaded into: as with `ulimit -u`, no more threads than the limit live at a time. (That
// limit itself does not bind root.) Preloaded: RELIEVO_MOST_THREADS is the limit, and RELIEVO_THREADS_REFUSED names a
// file that says how many starts were refused so far.
#pragma once

namespace relievo::testing_support {

extern "C" void setMostThreads(long most);  // beside the main one; below 0: no limit
extern "C" long threadsRefused();           // starts, so far

}  // namespace relievo::testing_support
