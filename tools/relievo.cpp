// relievo - view, preprocess and compare relief artworks. One sub-command a file: cmd_*.cpp.
#include <cxxabi.h>

#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <new>
#include <sstream>
#include <typeinfo>

#include <CLI/CLI.hpp>

#include "src/base/file.h"
#include "src/base/foreign_format.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "tools/commands.h"

namespace relievo {

void CommandContext::fail(const Error& failure) {
  // Whichever reader gave it up: a format that is known by name is said to be what it is.
  const bool of_file = failure.kind == ErrorKind::kInvalidData || failure.kind == ErrorKind::kUnsupported ||
                       failure.kind == ErrorKind::kIo;
  const std::optional<Error> foreign = of_file && !failure.file.empty() ? foreignFormat(failure.file) : std::nullopt;
  const Error& error = foreign ? *foreign : failure;
  std::fprintf(stderr, "relievo: error: %s\n", error.text().c_str());
  exit_code = error.exitCode();
}

void warn(const std::string& text) { std::fprintf(stderr, "relievo: warning: %s\n", printable(text).c_str()); }

Error usageError(const std::string& message, const std::string& hint) {
  return {ErrorKind::kUsage, "", message, hint, {}};
}

Result<std::pair<int64_t, int64_t>> parseSize(const std::string& text) {
  int64_t width = 0, height = 0;
  const char* end = text.data() + text.size();
  auto [after_width, bad_width] = std::from_chars(text.data(), end, width);
  if (bad_width == std::errc() && after_width < end && (*after_width == 'x' || *after_width == 'X')) {
    auto [after_height, bad_height] = std::from_chars(after_width + 1, end, height);
    if (bad_height == std::errc() && after_height == end && width > 0 && height > 0) return std::pair{width, height};
  }
  return usageError("expected a size as WIDTHxHEIGHT in px, found '" + text + "'", "for example 1280x720");
}

std::vector<std::string> commaParts(const std::string& list) {
  std::vector<std::string> out;
  size_t from = 0;
  for (size_t comma; (comma = list.find(',', from)) != std::string::npos; from = comma + 1)
    out.push_back(list.substr(from, comma - from));
  out.push_back(list.substr(from));
  return out;
}

std::optional<std::vector<double>> numbersOf(const std::string& text, size_t count) {
  std::vector<double> values(count);
  const char* at = text.data();
  const char* end = at + text.size();
  for (size_t i = 0; i < count; ++i) {
    auto [after, bad] = std::from_chars(at, end, values[i]);
    const bool separator = i + 1 == count ? after == end : after < end && *after == ',';
    if (bad != std::errc() || !separator || !std::isfinite(values[i])) return std::nullopt;
    at = after + 1;
  }
  return values;
}

std::string tripleText(const std::array<double, 3>& triple) {
  char text[96];
  std::snprintf(text, sizeof text, "%.17g,%.17g,%.17g", triple[0], triple[1], triple[2]);
  return text;
}

Result<std::array<double, 3>> parseTriple(const std::string& text, const char* option, const char* example) {
  if (const auto values = numbersOf(text, 3)) return std::array{(*values)[0], (*values)[1], (*values)[2]};
  return usageError(std::string("expected three numbers for ") + option + ", found '" + text + "'",
                    std::string("for example ") + example);
}

}  // namespace relievo

namespace {

void runCommand(int argc, char** argv, relievo::CommandContext& context) {
  using namespace relievo;
  CLI::App app{"Relievo shows relief artworks in true 3D, at any size, under any light."};
  app.footer(
      "Example:\n  relievo sample inscription --size 4096x4096 --package inscription.relievo -o sample\n"
      "  relievo render inscription.relievo -o picture.png --azimuth 25 --light -0.8,0.3,0.4\n\n"
      "Exit codes: 0 ok, 1 usage, 2 input/output, 3 invalid data, 4 runtime or GL, 5 unsupported,\n"
      "7 difference found or tolerance missed, 130 interrupted.\n\n"
      "- as the name of a picture, a report or a JSON file is standard output; what is printed besides then goes to "
      "standard error.\n"
      "Packages and folders have names of their own. A file appears under its name once it is whole; until then, and "
      "when something\n"
      "fails, what was there before stays.");
  app.set_version_flag("--version", "relievo " RELIEVO_VERSION);
  app.require_subcommand(1);
  app.set_help_all_flag("--help-all", "Print the help of every sub-command and exit");
  addSampleCommand(app, context);
  addBuildCommand(app, context);
  addInfoCommand(app, context);
  addVerifyCommand(app, context);
  addExportCommand(app, context);
  addRenderCommand(app, context);
  addViewCommand(app, context);
  addBenchCommand(app, context);
  addCompareCommand(app, context);
  addAccuracyCommand(app, context);
  addSelftestCommand(app, context);
  addPlanCommand(app, context);
  std::string names;
  bool known = argc < 2 || argv[1][0] == '-';
  for (const CLI::App* command : app.get_subcommands({})) {
    names += (names.empty() ? "" : ", ") + command->get_name();
    known = known || command->get_name() == argv[1];
  }
  if (!known)
    return context.fail(usageError("expected a sub-command, found '" + std::string(argv[1]) + "'",
                                   "one of " + names + "; see relievo --help"));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    std::ostringstream out, err;
    context.exit_code = app.exit(e, out, err) == 0 ? 0 : 1;
    (void)printOut(out.str());  // the error stays: flushOut() returns it
    std::fputs(err.str().c_str(), stderr);
  }
  if (auto flushed = flushOut(); !flushed) {
    const int before = context.exit_code;
    context.fail(flushed.error());
    if (before != 0) context.exit_code = before;
  }
}

// No more memory is asked for to say so.
void sayOutOfMemory() {
  std::fputs("relievo: error: out of memory (close other programs, or lower --memory-mib, --cache-mib and --workers)\n",
             stderr);
}

// Where memory runs out in a destructor, such as that of a JSON document, which asks for some, no exception reaches
// main().
[[noreturn]] void onTerminate() {
  const std::type_info* type = abi::__cxa_current_exception_type();
  if (!type || *type != typeid(std::bad_alloc)) std::abort();
  relievo::removePartFiles();
  sayOutOfMemory();
  std::_Exit(static_cast<int>(relievo::ErrorKind::kRuntime));
}

}  // namespace

int main(int argc, char** argv) {
  std::set_terminate(onTerminate);
  relievo::openStandardDescriptors();
  relievo::installInterruptHandler();
  constexpr int kRuntime = static_cast<int>(relievo::ErrorKind::kRuntime);
  int exit_code = kRuntime;
  try {
    relievo::CommandContext context;
    runCommand(argc, argv, context);
    exit_code = context.exit_code;
  } catch (const std::bad_alloc&) {
    sayOutOfMemory();
  } catch (const std::exception& e) {
    std::fprintf(stderr, "relievo: error: %s\n", e.what());
  }
  // What ran out of memory within a library may leave it in a state that its destructors do not expect: OpenImageIO's
  // tables then find a lock held, and end the process. None of them is called.
  if (exit_code == kRuntime) {
    std::fflush(nullptr);
    std::_Exit(exit_code);
  }
  return exit_code;
}
