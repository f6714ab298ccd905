// machine.h - where and when figures were measured, for every report.
#pragma once

#include <ctime>
#include <string>

namespace relievo {

// The processor's name as the system gives it (/proc/cpuinfo); "unknown" where it gives none.
std::string processorName();
// "2026-01-31 09:05 UTC"
std::string utcText(std::time_t time);

}  // namespace relievo
