// output_files.h - files that a command is going to write, checked before it reads or computes anything: none takes the
// place of an input or of another output, and each can be made.
#pragma once

#include <string>
#include <vector>

#include "src/base/result.h"
#include "tools/report/report_file.h"

namespace relievo {

// "-" as an output's name is standard output, for every option that writes one text or one picture. Packages are read
// again where they were written and folders hold several files: they are refused. What the command prints besides then
// goes to standard error.
enum class Content { kText, kPicture, kPackage };
struct NamedFile {
  std::string option, path;  // "--report"; an empty path: no file
  Content content = Content::kText;
};
// The same file, whatever the paths look like; one that is not there yet, too.
bool sameFile(const std::string& a, const std::string& b);
// kUsage names both options where an output is an input or another output.
Result<void> checkApart(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs);
// kIo: an output or its folder cannot be written to. kUsage: standard output takes one file, no package, and no picture
// if it is a terminal. Makes nothing.
Result<void> checkWritable(const std::vector<NamedFile>& outputs);
// Of an option that names a folder: kUsage if it is "-".
Result<void> checkFolder(const std::string& option, const std::string& path);
// Both of outputs; an output that goes to standard output has it from now on (claimOut).
Result<void> checkOutputs(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs);
// Into a folder that is there: all stand beside their places before the first one takes it, in this order.
Result<void> writeReportFiles(const std::vector<ReportFile>& reports, const std::string& folder);
// The whole text under its name; an empty path: no file.
Result<void> writeTextOutput(const std::string& path, const std::string& text);

}  // namespace relievo
