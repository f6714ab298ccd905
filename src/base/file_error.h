// file_error.h - what errors about files say, for the two that open files: file.cpp and output_file.cpp.
#pragma once

#include <sys/stat.h>

#include <string>

#include "src/base/result.h"

namespace relievo {

// error_number: errno of the call that failed. doing: "opening", say. The hint fits the errors that users meet.
Error ioError(const std::string& path, const char* doing, int error_number);
// "a folder", "a pipe": st_mode of what is no regular file.
const char* fileKindName(mode_t mode);

}  // namespace relievo
