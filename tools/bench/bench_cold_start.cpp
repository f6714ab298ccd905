// bench_cold_start.cpp - from starting the program to its first picture, which the roots' pages show, and to a settled
// one: the whole process, as a user waits for it. The first picture is that of the engine's first frame, which the
// viewer presents, read back. The package is in the file cache; the driver's compiled shaders are in its own cache, as
// from the second start on.
#include <spawn.h>
#include <sys/wait.h>

#include <cstdio>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "tools/bench/bench_groups.h"

extern char** environ;

namespace relievo {
namespace {

struct Start {
  double picture_ms = 0, context_ms = 0;
};

Result<Start> startOnce(const BenchContext& context, std::vector<std::string> arguments) {
  const std::string stats = context.folder + "/cold.json", picture = context.folder + "/cold.png";
  arguments.insert(arguments.begin(), {"relievo", "render", context.package->path(), "-o", picture, "--size",
                                       "1280x720", "--stats", stats});
  std::vector<char*> argv;
  for (std::string& a : arguments) argv.push_back(a.data());
  argv.push_back(nullptr);
  const double start_s = benchSeconds();
  pid_t child = 0;
  int status = posix_spawn(&child, "/proc/self/exe", nullptr, nullptr, argv.data(), environ);
  if (status == 0) waitpid(child, &status, 0);
  if (status != 0)
    return Error{
        ErrorKind::kRuntime, "", "the program that is to be timed did not run", "run relievo render by itself", {}};
  auto text = readTextFile(stats, 1 << 20);
  if (!text) return text.error();
  auto json = parseJson(*text, stats);
  if (!json) return json.error();
  if (!json->is_object() || !json->contains("settled_at_s") || !json->contains("context_ms"))
    return Error{ErrorKind::kInvalidData, stats, "expected the time of the picture", "", {}};
  return Start{((*json)["settled_at_s"].get<double>() - start_s) * 1000, (*json)["context_ms"].get<double>()};
}

}  // namespace

Result<void> coldStartBench(BenchContext& context) {
  struct Case {
    const char* what;
    std::vector<std::string> arguments;
    double beyond_context_ms;  // the goal; 0: none
  };
  const Case cases[] = {{"program started to first coarse picture, 1280x720", {"--no-settle"}, 50},
                        {"program started to settled picture, 1280x720", {}, 100},
                        {"the same without relief", {"--no-relief"}, 0},
                        {"the same, geometric error up to 2 px", {"--error-px", "2"}, 0}};
  for (const Case& c : cases) {
    std::vector<double> shown, made, beyond;
    for (int i = -1; i < (context.quick ? 5 : 15) && !context.stopped(); ++i) {  // the first fills the caches
      auto start = startOnce(context, c.arguments);
      if (!start) return start.error();
      if (i < 0) continue;
      shown.push_back(start->picture_ms);
      made.push_back(start->context_ms);
      beyond.push_back(start->picture_ms - start->context_ms);
    }
    if (context.stopped()) return {};
    char note[120];
    std::snprintf(note, sizeof note, "%+.0f ms, of one start; fastest %.0f, slowest %.0f ms of %zu", median(beyond),
                  quantile(shown, 0), quantile(shown, 1), shown.size());
    BenchRow row{.what = c.what,
                 .measured = median(shown),
                 .unit = "ms",
                 .baseline_name = "the driver's context alone",
                 .baseline = median(made),
                 .note = note};
    if (c.beyond_context_ms > 0) row.goal = median(made) + c.beyond_context_ms;
    context.row(row);
  }
  return {};
}

}  // namespace relievo
