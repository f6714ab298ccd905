// standard_output.h - the one way in which the program prints to standard output: what cannot be written is an error.
// Text is buffered (a line at most where standard output is a terminal). The first error stays: what is printed after
// it is left out, and flushOut(), which main() calls at the end, returns it. Not for several threads at once.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "src/base/result.h"

namespace relievo {

// First of all in main(): descriptors 0 to 2 that are closed become /dev/null, or the next file that is opened would
// get their number and what is printed. Printing to a standard output that was closed stays an error.
void openStandardDescriptors();

Result<void> printOut(std::string_view text);
__attribute__((format(printf, 1, 2))) void printOutf(const char* format, ...);
// All that was printed is written; the first error since the program started, if there was one.
Result<void> flushOut();

// A file goes to standard output ("-"): what is printed besides it goes to standard error from now on.
void claimOut();
// The bytes of that file.
Result<void> writeOut(std::span<const uint8_t> bytes);

// All the bytes, however many calls that takes. 0, or errno; EINTR only once Ctrl-C or another signal asked the program
// to end.
int writeAll(int descriptor, std::span<const uint8_t> bytes);

}  // namespace relievo
