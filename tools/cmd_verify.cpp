// relievo verify: reads and decodes every page of a package, and whatever else it holds; restores what is there twice.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "texturing/package/package.h"
#include "texturing/stream/page_sources.h"
#include "tools/commands.h"
#include "tools/scene/scene_file.h"

namespace relievo {
namespace {

constexpr size_t kShownProblems = 10;
constexpr size_t kListedOthers = 100'000;  // in JSON; more are counted only. Pages are all listed

struct VerifyArguments {
  std::string file;
  int workers = 0;
  bool json = false, repair = false;
  double fail_percent = 0;  // for tests
};

struct Found {
  uint64_t pages = 0, others = 0, unreadable = 0, repairable = 0;
  uint64_t all() const { return pages + others + unreadable; }
  void add(const VerifyProblem& problem) {
    ++(problem.unreadable ? unreadable : problem.page ? pages : others);
    repairable += problem.repairable;
  }
};

void emit(const std::string& text) { (void)printOut(text); }  // the error stays: flushOut() returns it
std::string jsonText(const nlohmann::ordered_json& json) {
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

// Damaged pages are printed as they are found: there may be as many as a large file has room for.
class JsonReport {
 public:
  explicit JsonReport(const std::string& file) { emit("{\n  \"file\": " + jsonText(file) + ",\n  \"damaged\": ["); }
  void add(const VerifyProblem& problem) {
    if (problem.page && !problem.unreadable) {
      const NodeId n = problem.page->node();
      emit(std::string(first_ ? "" : ",") + "\n    " +
           jsonText({{"plane", static_cast<int>(problem.page->plane())},
                     {"patch", n.patch},
                     {"level", n.level},
                     {"x", n.x},
                     {"y", n.y},
                     {"what", problem.what}}));
      first_ = false;
    } else if (auto& list = problem.unreadable ? unreadable_ : other_; list.size() < kListedOthers) {
      list.push_back(problem.what);
    }
  }
  void finish(const Found& found, const VerifyReport& report, const std::vector<std::string>& repaired,
              double seconds) {
    emit(std::string(first_ ? "]" : "\n  ]") + ",\n");
    list("other", other_);
    list("unreadable", unreadable_);
    list("repaired", repaired);
    emit("  \"damaged_pages\": " + std::to_string(found.pages) + ",\n  \"other_faults\": " +
         std::to_string(found.others) + ",\n  \"unreadable_parts\": " + std::to_string(found.unreadable) +
         ",\n  \"repairable\": " + std::to_string(found.repairable) +
         ",\n  \"pages\": " + std::to_string(report.pages) + ",\n  \"page_bytes\": " + std::to_string(report.bytes) +
         ",\n  \"seconds\": " + jsonText(seconds) + "\n}\n");
  }

 private:
  static void list(const char* name, const std::vector<std::string>& texts) {
    emit(std::string("  \"") + name + "\": [");
    for (size_t i = 0; i < texts.size(); ++i) emit(std::string(i ? "," : "") + "\n    " + jsonText(texts[i]));
    emit(texts.empty() ? "],\n" : "\n  ],\n");
  }
  bool first_ = true;
  std::vector<std::string> other_, unreadable_;
};

Result<void> verify(const VerifyArguments& o) {
  auto start = std::chrono::steady_clock::now();
  std::vector<std::string> repaired;
  if (o.repair) {
    auto done = repairPackage(o.file, &interruptedFlag());
    if (!done) return done.error();
    repaired = std::move(*done);
  }
  auto package = Package::open(o.file);
  if (!package) return package.error();
  std::unique_ptr<JsonReport> json;
  if (o.json) json = std::make_unique<JsonReport>(o.file);
  Found found;
  std::vector<std::string> shown;
  VerifyOptions options;
  options.workers = o.workers;
  options.interrupted = &interruptedFlag();
  options.problem = [&](const VerifyProblem& problem) {
    found.add(problem);
    if (json) json->add(problem);
    else if (shown.size() < kShownProblems)
      shown.push_back((problem.unreadable ? "unreadable: " : "damaged: ") + problem.what);
  };
  const FailingSource failing(*package, {.fail = o.fail_percent / 100}, 1);
  if (o.fail_percent > 0) options.pages = &failing;
  Result<VerifyReport> report = VerifyReport{};
  {
    ProgressLine line("verify");
    options.progress = [&](uint64_t done, uint64_t total) {
      line.update(total ? static_cast<double>(done) / static_cast<double>(total) : 1.0,
                  std::to_string(done) + " of " + std::to_string(total) + " pages");
    };
    report = verifyPackage(**package, options);
  }
  if (!report) return report.error();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (json) {
    json->finish(found, *report, repaired, seconds);
  } else {
    for (const std::string& what : repaired) printOutf("repaired: %s\n", what.c_str());
    for (const std::string& what : shown) printOutf("%s\n", what.c_str());
    if (found.all() > shown.size())
      printOutf("and %llu more (--json lists all)\n", static_cast<unsigned long long>(found.all() - shown.size()));
    printOutf("%s: %llu pages, %.1f MiB, %.1f s, %.0f pages/s: ", o.file.c_str(),
              static_cast<unsigned long long>(report->pages), static_cast<double>(report->bytes) / (1 << 20), seconds,
              static_cast<double>(report->pages) / std::max(seconds, 1e-9));
    if (found.all() == 0) {
      printOutf("sound\n");
    } else {
      printOutf("%llu damaged pages, %llu other faults", static_cast<unsigned long long>(found.pages),
                static_cast<unsigned long long>(found.others));
      if (found.unreadable) printOutf(", %llu parts unreadable", static_cast<unsigned long long>(found.unreadable));
      printOutf("\n");
    }
  }
  (void)flushOut();
  if (found.unreadable > 0) {
    return Error{ErrorKind::kIo,
                 o.file,
                 "input/output errors: " + std::to_string(found.unreadable) +
                     " parts could not be read, so nobody knows whether they are sound",
                 "check the disk, copy the package to another one and verify it there",
                 {}};
  }
  if (found.all() > 0) {
    std::string hint = "rebuild it, or get a whole copy";
    if (found.repairable == found.all()) hint = "relievo verify --repair restores it";
    else if (found.repairable > 0)
      hint += "; relievo verify --repair restores " + std::to_string(found.repairable) + " of its " +
              std::to_string(found.all()) + " faults";
    return Error{ErrorKind::kInvalidData, o.file, "the package is damaged", hint, {}};
  }
  return {};
}

}  // namespace

void addVerifyCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<VerifyArguments>();
  auto* c = app.add_subcommand(
      "verify", "Check all of a package: that every page is whole and decodes, and both copies of what is there twice");
  c->footer(
      "Example:\n  relievo verify tablet.relievo\n\nNames the first ten faults, for pages: plane, patch, level, x, y "
      "and the place in the file; --json names all. "
      "Exit code 3 when damaged,\n2 where the file could not be read. --repair writes a damaged copy of the header or "
      "the base mesh anew from the sound one, and\n"
      "zeros into damaged padding: in place, only bytes that nothing reads while the other copy is sound; then the "
      "package is verified.");
  c->add_option("FILE", o->file, "Package to check, or a scene of it")->required();
  c->add_option("--workers", o->workers, "Threads; 0: one per core")->check(CLI::Range(0, 1024))->capture_default_str();
  c->add_flag("--json", o->json, "Print JSON");
  c->add_flag("--repair", o->repair, "Restore what is there twice from its sound copy");
  c->add_option("--source-fail", o->fail_percent, "")->check(CLI::Range(0.0, 100.0))->group("");
  c->callback([o, &context] {
    if (auto named = takeArtwork(o->file); !named) return context.fail(named.error());
    if (auto done = verify(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
