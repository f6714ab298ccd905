// relievo - view, preprocess and compare relief artworks. One sub-command a file: cmd_*.cpp.
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <new>

#include <CLI/CLI.hpp>

#include "src/base/progress.h"
#include "tools/commands.h"

namespace relievo {

void CommandContext::fail(const Error& error) {
  std::fprintf(stderr, "relievo: error: %s\n", error.text().c_str());
  exit_code = error.exitCode();
}

Error usageError(const std::string& message, const std::string& hint) { return {ErrorKind::kUsage, "", message, hint, {}}; }

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

Result<std::array<double, 3>> parseTriple(const std::string& text, const char* option) {
  std::array<double, 3> values{};
  const char* at = text.data();
  const char* end = at + text.size();
  for (int i = 0; i < 3; ++i) {
    auto [after, bad] = std::from_chars(at, end, values[i]);
    bool separator = i == 2 ? after == end : after < end && *after == ',';
    if (bad != std::errc() || !separator || !std::isfinite(values[i])) {
      return usageError(std::string("expected three numbers X,Y,Z for ") + option + ", found '" + text + "'", "for example -0.7,0.4,0.6");
    }
    at = after + 1;
  }
  return values;
}

}  // namespace relievo

int main(int argc, char** argv) {
  using namespace relievo;
  installInterruptHandler();
  CLI::App app{"Relievo shows relief artworks in true 3D, at any size, under any light."};
  app.footer(
      "Example:\n  relievo sample inscription --size 4096x4096 --package inscription.relievo -o sample\n"
      "  relievo render inscription.relievo -o picture.png --azimuth 25 --light -0.8,0.3,0.4\n\n"
      "Exit codes: 0 ok, 1 usage, 2 input/output, 3 invalid data, 4 runtime or GL, 5 unsupported, 7 difference found,\n"
      "130 interrupted.");
  app.set_version_flag("--version", "relievo " RELIEVO_VERSION);
  app.require_subcommand(1);
  app.set_help_all_flag("--help-all", "Print the help of every sub-command and exit");
  CommandContext context;
  addSampleCommand(app, context);
  addBuildCommand(app, context);
  addInfoCommand(app, context);
  addVerifyCommand(app, context);
  addRenderCommand(app, context);
  addViewCommand(app, context);
  addBenchCommand(app, context);
  addCompareCommand(app, context);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  } catch (const std::bad_alloc&) {
    context.fail({ErrorKind::kRuntime, "", "out of memory", "close other programs, or lower --cache-mib and --workers", {}});
  } catch (const std::exception& e) {
    context.fail({ErrorKind::kRuntime, "", e.what(), "", {}});
  }
  return context.exit_code;
}
