#include "tools/output_files.h"

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>

#include "src/base/file.h"
#include "src/base/standard_output.h"

namespace relievo {
namespace {

bool named(const NamedFile& file, bool output) { return !file.path.empty() && !(output && file.path == "-"); }

// Devices such as /dev/null take any number of files.
bool isDevice(const std::string& path) {
  struct stat st {};
  return ::stat(path.c_str(), &st) == 0 && S_ISCHR(st.st_mode);
}

}  // namespace

bool sameFile(const std::string& a, const std::string& b) {
  struct stat sa {
  }, sb{};
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
      return Error{ErrorKind::kUsage,
                   outputs[i].path,
                   outputs[i].option + " would overwrite " + is + other.option,
                   "choose another name for " + outputs[i].option,
                   {}};
    };
    for (const NamedFile& input : inputs)
      if (named(input, false) && sameFile(outputs[i].path, input.path)) return refused(input, "an input: ");
    for (size_t k = 0; k < i; ++k)
      if (named(outputs[k], true) && !isDevice(outputs[i].path) && sameFile(outputs[i].path, outputs[k].path))
        return refused(outputs[k], "another output: ");
  }
  return {};
}

Result<void> checkWritable(const std::vector<NamedFile>& outputs) {
  const NamedFile* first_out = nullptr;
  for (const NamedFile& output : outputs) {
    if (output.path.empty()) continue;
    auto kind = OutputFile::check(output.path);
    if (!kind) {
      Error error = kind.error();
      error.message = output.option + " " + error.message;
      return error;
    }
    const auto refused = [&](const std::string& why, const char* hint) {
      return Error{ErrorKind::kUsage, output.path, output.option + " " + why, hint, {}};
    };
    if (*kind != OutputKind::kFile && output.content == Content::kPackage)
      return refused("is a package, which only a file can hold", "name a file");
    if (*kind != OutputKind::kStandardOutput) continue;
    if (first_out)
      return refused("cannot go to standard output: " + first_out->option + " goes there",
                     "name a file for one of them");
    if (output.content == Content::kPicture && ::isatty(STDOUT_FILENO))
      return refused("is a picture, and standard output is a terminal", "redirect it, or name a file");
    first_out = &output;
  }
  return {};
}

Result<void> checkFolder(const std::string& option, const std::string& path) {
  if (path != "-") return {};
  return Error{ErrorKind::kUsage, "", option + " names a folder, and standard output is none", "name a folder", {}};
}

Result<void> checkOutputs(const std::vector<NamedFile>& outputs, const std::vector<NamedFile>& inputs) {
  if (auto apart = checkApart(outputs, inputs); !apart) return apart;
  if (auto good = checkWritable(outputs); !good) return good;
  for (const NamedFile& output : outputs) {
    if (output.path.empty()) continue;
    if (auto kind = OutputFile::check(output.path); kind && *kind == OutputKind::kStandardOutput) claimOut();
  }
  return {};
}

Result<void> writeReportFiles(const std::vector<ReportFile>& reports, const std::string& folder) {
  std::vector<OutputFile> files;
  for (const ReportFile& r : reports) {
    auto file = OutputFile::create(folder + "/" + r.name);
    if (!file) return file.error();
    files.push_back(std::move(*file));
    if (auto done = files.back().append({reinterpret_cast<const uint8_t*>(r.text.data()), r.text.size()}); !done)
      return done;
    if (auto done = files.back().finish(); !done) return done;
  }
  for (OutputFile& file : files)
    if (auto done = file.commit(); !done) return done;
  return {};
}

Result<void> writeTextOutput(const std::string& path, const std::string& text) {
  if (path.empty()) return {};
  return writeFile(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

}  // namespace relievo
