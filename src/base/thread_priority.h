// thread_priority.h - for threads whose work may wait a little: they step back where others want the processor.
#pragma once

#include <sys/resource.h>
#include <unistd.h>

namespace relievo {

// Of the calling thread, as `nice` does; 0..19. That it fails (it cannot, on Linux) is of no consequence.
inline void stepBack(int nice) { (void)setpriority(PRIO_PROCESS, static_cast<id_t>(gettid()), nice); }

}  // namespace relievo
