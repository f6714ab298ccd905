// printable.h - text that comes from a file, a folder or a command line, as it may be sent to a terminal.
#pragma once

#include <string>
#include <string_view>

namespace relievo {

// One line of valid UTF-8 in which nothing steers a terminal or reorders what is read. Escaped are control characters
// (\n, \t, \x1b, \u009b), the separators and direction marks of Unicode (\u202e), and bytes that are no UTF-8 (\xff).
// Everything else, backslashes included, stays as it is.
std::string printable(std::string_view text);

}  // namespace relievo
