// relievo bench: what the engine's parts cost, each beside a baseline of the same run.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <thread>

#include <CLI/CLI.hpp>

#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/gl/context.h"
#include "texturing/package/package_builder.h"
#include "tools/bench/bench.h"
#include "tools/bench/bench_groups.h"
#include "tools/bench/bench_report.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/report/machine.h"
#include "tools/sample/sample_artwork.h"
#include "tools/scene/scene_file.h"

namespace relievo {
namespace {

struct BenchOptions {
  std::string file, json_file, markdown_file, plots;
  std::vector<std::string> only;
  bool quick = false;
};

// Removed with everything in it, whatever happens.
struct ScratchFolder {
  std::string path;
  ScratchFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "relievo-bench-XXXXXX").string();
    if (mkdtemp(pattern.data())) path = pattern;
  }
  ~ScratchFolder() {
    std::error_code ignored;
    if (!path.empty()) std::filesystem::remove_all(path, ignored);
  }
};

Result<std::shared_ptr<const Package>> openArtwork(const BenchOptions& o, const std::string& folder) {
  std::string path = o.file;
  if (path.empty()) {
    SampleOptions so;
    so.kind = SampleKind::kInscription;
    so.width = so.height = o.quick ? 2048 : 4096;
    SampleArtwork artwork(so);
    auto texture = artwork.ptmSource(Basis::kPtmLrgb);
    auto heights = artwork.heightSource();
    BuildOptions bo;
    bo.output = path = folder + "/inscription.relievo";
    bo.mm_per_px = artwork.mmPerPx();
    bo.interrupted = &interruptedFlag();
    if (auto built = buildPackage(*texture, heights.get(), bo); !built) return built.error();
  }
  auto package = Package::open(path);
  if (!package) return package.error();
  const bool any_will_do = !o.only.empty() && std::all_of(o.only.begin(), o.only.end(), [](const std::string& group) {
    return group == "relief-memory" || group == "frame-time";
  });
  if (!(*package)->manifest().domain.isFlat() && !any_will_do)
    return Error{ErrorKind::kUnsupported,
                 path,
                 "expected a flat artwork to measure with, found a scan",
                 "--only relief-memory and frame-time measure scans, too; mesh-lod, mesh-patches and mesh-build "
                 "measure those that they make",
                 {}};
  return std::shared_ptr<const Package>(*package);
}

BenchRun describeRun(const std::string& renderer, const Package& package, bool quick) {
  const Manifest& m = package.manifest();
  BenchRun run;
  run.processor = processorName();
  run.cores = std::thread::hardware_concurrency();
  run.renderer = renderer;
  run.version = "relievo " RELIEVO_VERSION;
  run.artwork = (m.domain.isFlat() ? std::to_string(m.domain.flat().width_px) + " x " +
                                         std::to_string(m.domain.flat().height_px) + " px, "
                                   : std::to_string(m.domain.patchCount()) + " patches, ") +
                basisName(m.texture.basis) + (m.domain.relief_depth >= 0 ? " with relief" : "");
  run.started = std::time(nullptr);
  if (double load = 0; getloadavg(&load, 1) == 1) run.load = load;
  run.quick = quick;
  return run;
}

Result<void> bench(const BenchOptions& o) {
  if (auto good = checkOutputs({{"--json", o.json_file}, {"--markdown", o.markdown_file}}, {{"FILE", o.file}}); !good)
    return good;
  if (auto good = checkFolder("--plots", o.plots); !good) return good;
  ScratchFolder scratch;
  if (scratch.path.empty())
    return Error{ErrorKind::kIo, "", "cannot make a temporary folder", "set TMPDIR to a folder with space", {}};
  auto package = openArtwork(o, scratch.path);
  if (!package) return package.error();
  if (!o.plots.empty()) {
    std::error_code bad;
    std::filesystem::create_directories(o.plots, bad);
    if (bad) return Error{ErrorKind::kIo, o.plots, "cannot make the folder: " + bad.message(), "", {}};
  }
  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();

  BenchRun run = describeRun((*context)->info().renderer, **package, o.quick);
  printOutf("%s, %u threads; %s\n", run.renderer.c_str(), run.cores, run.artwork.c_str());
  BenchContext bc;
  bc.package = *package;
  bc.folder = scratch.path;
  bc.plots = o.plots;
  bc.quick = o.quick;
  bc.interrupted = &interruptedFlag();
  bc.row = [&](const BenchRow& row) {
    (void)printOut(benchLine(row));
    (void)flushOut();
    run.groups.back().rows.push_back(row);
  };
  for (const BenchGroup& group : benchGroups()) {
    if (!o.only.empty() && std::find(o.only.begin(), o.only.end(), group.name) == o.only.end()) continue;
    printOutf("%s: %s\n", group.name, group.purpose);
    (void)flushOut();
    run.groups.push_back({group.name, group.purpose, {}});
    auto done = group.run(bc);
    if (interruptedFlag()) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
    if (const PageFailures failures = (*package)->readFailures(); failures.pages > 0) {
      return Error{failures.unreadable > 0 ? ErrorKind::kIo : ErrorKind::kInvalidData,
                   (*package)->path(),
                   std::to_string(failures.pages) +
                       " reads of pages failed, so that what was measured is not that of a sound package; the first: " +
                       failures.first,
                   "relievo verify names them all",
                   {}};
    }
    if (!done) return done;
  }
  if (auto written = writeTextOutput(o.json_file, benchJson(run)); !written) return written;
  return writeTextOutput(o.markdown_file, benchMarkdown(run));
}

}  // namespace

double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  auto rank = static_cast<std::ptrdiff_t>(std::ceil(q * static_cast<double>(values.size()))) - 1;
  rank = std::clamp<std::ptrdiff_t>(rank, 0, static_cast<std::ptrdiff_t>(values.size()) - 1);
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<size_t>(rank)];
}

const std::vector<BenchGroup>& benchGroups() {
  static const std::vector<BenchGroup> groups = {
#define RELIEVO_GROUP(name, function, purpose) {name, purpose, function##Bench},
      RELIEVO_BENCH_GROUPS(RELIEVO_GROUP)
#undef RELIEVO_GROUP
  };
  return groups;
}

void addBenchCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<BenchOptions>();
  auto* c = app.add_subcommand("bench", "Measure what the engine's parts cost, beside a baseline in the same run");
  std::string groups;
  std::vector<std::string> names;
  for (const BenchGroup& g : benchGroups()) {
    groups += "  " + std::string(g.name) + ": " + g.purpose + "\n";
    names.emplace_back(g.name);
  }
  c->footer(
      "Groups:\n" + groups +
      "\nTimes are medians. MISS: a goal that this machine does not reach; the exit code stays 0.\n"
      "--markdown writes processor, cores, GL renderer, load, artwork, version and date (UTC), then one table per\n"
      "group that ran: figure, value, unit, goal, verdict, baseline. A group that did not run is left out.\n\n"
      "Example:\n  relievo bench --only feedback page-table --json bench.json\n"
      "  relievo bench --quick --only page-table decode --markdown figures.md");
  c->add_option("FILE", o->file, "Package to measure with [an inscription of 4096x4096 px made for the run]");
  c->add_option("--only", o->only, "Groups to run [all]")->check(CLI::IsMember(names));
  c->add_flag("--quick", o->quick, "Fewer repetitions, a smaller artwork: about a minute");
  c->add_option("--plots", o->plots, "Write plots (SVG) into this folder");
  c->add_option("--json", o->json_file, "Write the rows to this JSON file; - for standard output");
  c->add_option("--markdown", o->markdown_file,
                "Write the machine and one table per group that ran to this Markdown file; - for standard output");
  c->callback([o, &context] {
    if (auto named = takeArtwork(o->file); !named) return context.fail(named.error());
    if (auto done = bench(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
