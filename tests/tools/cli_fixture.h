// cli_fixture.h - the program run as its users run it, in a folder of its own.
#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace relievo::testing_support {

namespace fs = std::filesystem;

struct Outcome {
  int exit_code = -1;
  std::string output;  // stdout and stderr
};

inline Outcome run(const std::string& command) {
  Outcome r;
  FILE* pipe = popen((command + " 2>&1 </dev/null").c_str(), "r");
  if (!pipe) return r;
  char buffer[4096];
  while (size_t n = fread(buffer, 1, sizeof buffer, pipe)) r.output.append(buffer, n);
  int status = pclose(pipe);
  r.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return r;
}

// Did the program end because there is no GL here? A test that says so may skip, but not where GL is required
// (tools/check): there, and where the exit code has another reason, this is a failure.
inline bool noGl(const Outcome& r) {
  if (r.exit_code != 4) return false;
  const char* required = std::getenv("RELIEVO_REQUIRE_GL");
  if (required && std::string(required) == "1")
    ADD_FAILURE() << "GL is required, and the program has none: " << r.output;
  else if (r.output.find("no GL context") == std::string::npos)
    ADD_FAILURE() << "exit code 4, and not for want of GL: " << r.output;
  return true;
}

// Interrupted as by Ctrl-C, a second after there is a file or folder of that name.
inline Outcome runUntil(const std::string& there, const std::string& command) {
  return run("( " + command + " & pid=$!; n=0; until [ -e " + there +
             " ] || [ $((n += 1)) -gt 600 ]; do sleep 0.1; done; sleep 1; kill -INT $pid; wait $pid )");
}

class Cli : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "relievo-cli-XXXXXX").string();
    folder_ = mkdtemp(pattern.data());
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string file(const std::string& name) const { return folder_ + "/" + name; }
  Outcome relievo(const std::string& arguments) const { return run(std::string(RELIEVO_PROGRAM) + " " + arguments); }
  void write(const std::string& name, const std::string& bytes) const {
    std::ofstream(file(name), std::ios::binary) << bytes;
  }
  int filesNamed(const std::string& part) const {
    int n = 0;
    for (const auto& e : fs::directory_iterator(folder_))
      n += e.path().filename().string().find(part) != std::string::npos;
    return n;
  }
  std::string folder_;
};

}  // namespace relievo::testing_support
