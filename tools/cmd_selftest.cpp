// relievo selftest: hard cases on this machine, with this build.
#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "src/base/standard_output.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

struct SelftestOptions {
  bool stability = false;
  std::string only, json_file, markdown_file;
};

Result<std::vector<StabilityPart>> chosenParts(const std::string& only) {
  std::vector<StabilityPart> parts = stabilityParts();
  if (only.empty()) return parts;
  std::string names;
  for (const StabilityPart& part : parts) {
    if (part.name == only) return std::vector{part};
    names += (names.empty() ? "" : ", ") + std::string(part.name);
  }
  return usageError("there is no part '" + only + "'", "there are: " + names);
}

std::string stabilityJson(const std::vector<StabilityRow>& rows) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const StabilityRow& row : rows) {
    const StabilityCase& c = *row.hard_case;
    list.push_back({{"part", row.part},
                    {"case", c.name},
                    {"expected", c.expected},
                    {"unit", c.unit},
                    {"bound", c.bound},
                    {"measured", row.errors.measured},
                    {"naive_method", c.naive},
                    {"naive", row.errors.naive},  // null: no number
                    {"holds", row.holds()},
                    {"naive_fails", row.naiveFails()}});
  }
  return nlohmann::ordered_json{{"version", RELIEVO_VERSION}, {"cases", list}}.dump(2) + "\n";
}

Result<void> selftest(const SelftestOptions& o) {
  if (auto good = checkOutputs({{"--json", o.json_file}, {"--markdown", o.markdown_file}}, {}); !good) return good;
  auto parts = chosenParts(o.only);
  if (!parts) return parts.error();
  const std::vector<StabilityRow> rows = runStability(*parts);
  if (auto printed = printOut(stabilityTable(rows, false)); !printed) return printed;
  if (auto written = writeTextOutput(o.json_file, stabilityJson(rows)); !written) return written;
  if (auto written = writeTextOutput(o.markdown_file, stabilityTable(rows, true)); !written) return written;
  size_t failures = 0, blunt = 0;
  for (const StabilityRow& row : rows) failures += !row.holds(), blunt += !row.naiveFails();
  printOutf("%zu cases: %zu hold, %zu fail; the naive method fails in %zu\n", rows.size(), rows.size() - failures,
            failures, rows.size() - blunt);
  if (failures + blunt > 0)
    return Error{ErrorKind::kDifference,
                 "",
                 "some hard cases do not come out as analysis says",
                 "this build computes otherwise than others: compile without -ffast-math and without contraction",
                 {}};
  return {};
}

}  // namespace

void addSelftestCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<SelftestOptions>();
  auto* c = app.add_subcommand("selftest", "Hard cases on this machine: errors beside their bounds, in seconds");
  c->footer(
      "Each case has an answer that analysis gives, a bound in its own unit (px, mm, texels, of 255), this program's "
      "error,\nand that of the method one would write first, which must break the bound: else the case is not hard. No "
      "display and\nno OpenGL are needed.\nExit code 7: a case does not hold.\n\n"
      "Example:\n  relievo selftest --stability\n  relievo selftest --stability --only geometry --json stability.json");
  c->add_flag("--stability", o->stability, "Numerical stability; the only test there is, and the default");
  c->add_option("--only", o->only, "One part of the table");
  c->add_option("--json", o->json_file, "Write the table to this JSON file; - for standard output");
  c->add_option("--markdown", o->markdown_file, "Write the table to this Markdown file; - for standard output");
  c->callback([o, &context] {
    if (auto done = selftest(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
