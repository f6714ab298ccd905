// relievo verify: reads and decodes every page of a package.
#include <chrono>
#include <cstdio>
#include <memory>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "src/base/progress.h"
#include "texturing/package.h"
#include "tools/commands.h"

namespace relievo {
namespace {

struct VerifyArguments {
  std::string file;
  int workers = 0;
  bool json = false;
};

ProgressLine* progress_line = nullptr;

Result<void> verify(const VerifyArguments& o) {
  auto start = std::chrono::steady_clock::now();
  auto package = Package::open(o.file);
  if (!package) return package.error();
  Result<VerifyReport> report = VerifyReport{};
  {
    ProgressLine line("verify");
    progress_line = &line;
    report = verifyPackage(**package, o.workers, [](uint64_t done, uint64_t total) {
      progress_line->update(total ? static_cast<double>(done) / static_cast<double>(total) : 1.0,
                            std::to_string(done) + " of " + std::to_string(total) + " pages");
    }, &interruptedFlag());
    progress_line = nullptr;
  }
  if (!report) return report.error();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (o.json) {
    nlohmann::ordered_json json;
    json["file"] = o.file;
    json["pages"] = report->pages;
    json["page_bytes"] = report->bytes;
    json["seconds"] = seconds;
    json["damaged"] = nlohmann::ordered_json::array();
    for (const DamagedPage& page : report->damaged) {
      NodeId n = page.id.node();
      json["damaged"].push_back({{"plane", static_cast<int>(page.id.plane())}, {"patch", n.patch}, {"level", n.level}, {"x", n.x}, {"y", n.y}, {"what", page.what}});
    }
    json["other"] = report->other;
    std::printf("%s\n", json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  } else {
    for (const std::string& other : report->other) std::printf("damaged: %s\n", other.c_str());
    for (const DamagedPage& page : report->damaged) std::printf("damaged: %s\n", page.what.c_str());
    std::printf("%s: %llu pages, %.1f MiB, %.1f s, %.0f pages/s: ", o.file.c_str(), static_cast<unsigned long long>(report->pages),
                static_cast<double>(report->bytes) / (1 << 20), seconds, static_cast<double>(report->pages) / std::max(seconds, 1e-9));
    if (report->damaged.empty() && report->other.empty()) {
      std::printf("sound\n");
    } else {
      std::printf("%zu damaged pages, %zu other faults\n", report->damaged.size(), report->other.size());
    }
    std::fflush(stdout);
  }
  if (!report->damaged.empty() || !report->other.empty()) {
    return Error{ErrorKind::kInvalidData, o.file, "the package is damaged", "rebuild it, or get a whole copy", {}};
  }
  return {};
}

}  // namespace

void addVerifyCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<VerifyArguments>();
  auto* c = app.add_subcommand("verify", "Check every page of a package: its checksum, and that it decodes");
  c->footer("Example:\n  relievo verify tablet.relievo\n\nNames each damaged page: plane, patch, level, x, y and its place in the file. Exit code 3 when damaged.");
  c->add_option("FILE", o->file, "Package to check")->required();
  c->add_option("--workers", o->workers, "Threads; 0: one per core")->check(CLI::Range(0, 1024))->capture_default_str();
  c->add_flag("--json", o->json, "Print JSON");
  c->callback([o, &context] {
    if (auto done = verify(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
