// foreign_format.h - files of this field that relievo does not read, told by name, so that nobody takes them for
// damaged ones.
#pragma once

#include <optional>
#include <string>

#include "src/base/result.h"

namespace relievo {

// What a file or folder is, if it is a known one that no reader here takes: an .rti or .hsh, a folder of the program
// relight or its info.json, a list of light directions. By a few bytes of it and by its name; anything else, and what
// cannot be read: nothing. kUnsupported.
std::optional<Error> foreignFormat(const std::string& path);

}  // namespace relievo
