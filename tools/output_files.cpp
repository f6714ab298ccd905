#include "tools/output_files.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

namespace relievo {
namespace {

bool named(const NamedFile& file, bool output) { return !file.path.empty() && !(output && file.path == "-"); }

}  // namespace

bool sameFile(const std::string& a, const std::string& b) {
  struct stat sa {}, sb {};
  const bool there = ::stat(a.c_str(), &sa) == 0, also = ::stat(b.c_str(), &sb) == 0;
  if (there && also) return sa.st_dev == sb.st_dev && sa.st_ino == sb.st_ino;
  if (there || also) return false;
  std::error_code bad;
  const auto path_a = std::filesystem::weakly_canonical(std::filesystem::absolute(a, bad), bad);
  const auto path_b = std::filesystem::weakly_canonical(std::filesystem::absolute(b, bad), bad);
  return !bad && path_a == path_b;
}

Result<void> checkApart(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs) {
  for (size_t i = 0; i < outputs.size(); ++i) {
    if (!named(outputs[i], true)) continue;
    const auto refused = [&](const NamedFile& other, const char* is) {
      return Error{ErrorKind::kUsage, outputs[i].path, outputs[i].option + " would overwrite " + is + other.option, "choose another name for " + outputs[i].option, {}};
    };
    for (const NamedFile& input : inputs)
      if (named(input, false) && sameFile(outputs[i].path, input.path)) return refused(input, "an input: ");
    for (size_t k = 0; k < i; ++k)
      if (named(outputs[k], true) && sameFile(outputs[i].path, outputs[k].path)) return refused(outputs[k], "another output: ");
  }
  return {};
}

Result<void> checkWritable(const std::vector<NamedFile>& outputs) {
  for (const NamedFile& output : outputs) {
    if (!named(output, true)) continue;
    struct stat st {};
    if (::stat(output.path.c_str(), &st) == 0 && S_ISDIR(st.st_mode))
      return Error{ErrorKind::kIo, output.path, output.option + " is a folder, expected the name of a file to write", "name a file", {}};
    std::string folder = std::filesystem::path(output.path).parent_path().string();
    if (folder.empty()) folder = ".";
    if (::access(folder.c_str(), W_OK | X_OK) == 0) continue;
    const int why = errno;
    return Error{ErrorKind::kIo, output.path, output.option + " cannot be written into the folder " + folder + ": " + std::strerror(why),
                 why == ENOENT ? "make the folder first, or check the path" : "check the permissions, or name another folder", {}};
  }
  return {};
}

Result<void> checkOutputs(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs) {
  if (auto apart = checkApart(outputs, inputs); !apart) return apart;
  return checkWritable(outputs);
}

}  // namespace relievo
