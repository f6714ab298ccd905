// output_files.h - files that a command is going to write, checked before it reads or computes anything: none takes the place of an
// input or of another output, and each can be made.
#pragma once

#include <string>
#include <vector>

#include "src/base/result.h"

namespace relievo {

struct NamedFile {
  std::string option, path;  // "--report"; an empty path, or of an output "-" (standard output): no file
};
// The same file, whatever the paths look like; one that is not there yet, too.
bool sameFile(const std::string& a, const std::string& b);
// kUsage names both options where an output is an input or another output.
Result<void> checkApart(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs);
// kIo: the folder of an output is not there or must not be written to. Makes nothing.
Result<void> checkWritable(const std::vector<NamedFile>& outputs);
// Both.
Result<void> checkOutputs(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs);

}  // namespace relievo
