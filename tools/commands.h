// commands.h - relievo's sub-commands; each cmd_*.cpp adds its own to the command line.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "src/base/result.h"

namespace CLI {
class App;
}

namespace relievo {

// A sub-command's callback runs after parsing; it leaves its exit code here (0 ok).
struct CommandContext {
  int exit_code = 0;
  // Prints "relievo: error: TEXT" to standard error and keeps the exit code.
  void fail(const Error& error);
};

void addSampleCommand(CLI::App& app, CommandContext& context);
void addBuildCommand(CLI::App& app, CommandContext& context);
void addInfoCommand(CLI::App& app, CommandContext& context);
void addVerifyCommand(CLI::App& app, CommandContext& context);
void addExportCommand(CLI::App& app, CommandContext& context);
void addRenderCommand(CLI::App& app, CommandContext& context);
void addViewCommand(CLI::App& app, CommandContext& context);
void addBenchCommand(CLI::App& app, CommandContext& context);
void addCompareCommand(CLI::App& app, CommandContext& context);
void addAccuracyCommand(CLI::App& app, CommandContext& context);
void addSelftestCommand(CLI::App& app, CommandContext& context);
void addPlanCommand(CLI::App& app, CommandContext& context);

// Prints "relievo: warning: TEXT" to standard error, control characters escaped.
void warn(const std::string& text);
Error usageError(const std::string& message, const std::string& hint = "");
// "1920x1080" -> {1920, 1080}; a usage error otherwise.
Result<std::pair<int64_t, int64_t>> parseSize(const std::string& text);
// "a,b,c" -> "a", "b", "c"; of an empty text one that is empty.
std::vector<std::string> commaParts(const std::string& list);
// "a,b,c" -> that many finite numbers; nothing where it is something else.
std::optional<std::vector<double>> numbersOf(const std::string& text, size_t count);
// "a,b,c" -> three doubles.
Result<std::array<double, 3>> parseTriple(const std::string& text, const char* option, const char* example);
std::string tripleText(const std::array<double, 3>& triple);  // and back, with as many digits as they need

}  // namespace relievo
