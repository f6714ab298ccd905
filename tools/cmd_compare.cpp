// relievo compare: geometry LOD strategies over one artwork, measured against full resolution.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <memory>
#include <thread>

#include <CLI/CLI.hpp>

#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/gl/context.h"
#include "texturing/import/image_io.h"
#include "tools/commands.h"
#include "tools/compare/compare_merge.h"
#include "tools/compare/compare_path.h"
#include "tools/compare/compare_plots.h"
#include "tools/compare/compare_report.h"
#include "tools/compare/compare_run.h"
#include "tools/compare/compare_tables.h"
#include "tools/output_files.h"
#include "tools/report/machine.h"
#include "tools/scene/scene_file.h"
#include "tools/scene/settings_file.h"
#include "tools/scene_path.h"

namespace relievo {
namespace {

constexpr int64_t kMaxSidePx = 8192;
constexpr double kLeastBudgetPx = 0.05, kMostBudgetPx = 1000;
constexpr std::array kReportFiles{"frames.csv", "report.json", "report.html", "summary.csv", "summary.tex"};

struct CompareOptions {
  std::vector<std::string> merge;
  std::string scene, file, folder, path = "orbit", strategies, budgets, size, settings_file;
  int frames = 0, repeats = 0;
  double exaggerate = 1, memory_mib = 1024;
  bool quick = false;
};

std::string strategyNames() {
  std::string names;
  for (const StrategyEntry& e : lodStrategies()) names += (names.empty() ? "" : ", ") + e.name;
  return names;
}

Result<ComparePlan> planOf(const CompareOptions& o) {
  ComparePlan plan;
  plan.path = o.path;
  plan.exaggerate = o.exaggerate;
  plan.memory_bytes = static_cast<uint64_t>(o.memory_mib * 1048576.0);
  if (o.strategies.empty()) {
    for (const StrategyEntry& e : lodStrategies()) plan.strategies.push_back(&e);
  } else {
    for (const std::string& name : commaParts(o.strategies)) {
      const StrategyEntry* e = findStrategy(name);
      if (!e) return usageError("there is no strategy '" + name + "'", "there are: " + strategyNames());
      plan.strategies.push_back(e);
    }
  }
  for (const std::string& text : commaParts(o.budgets.empty() ? (o.quick ? "1,2,4" : "0.5,1,2,4,8") : o.budgets)) {
    double px = 0;
    auto [end, bad] = std::from_chars(text.data(), text.data() + text.size(), px);
    if (bad != std::errc() || end != text.data() + text.size() || !(px >= kLeastBudgetPx && px <= kMostBudgetPx))
      return usageError("expected budgets from 0.05 to 1000 px, found '" + text + "'",
                        "for example --error-px 0.5,1,2,4");
    plan.budgets_px.push_back(px);
  }
  bool recorded = o.path == "orbit" || o.path == "flyover" || o.path == "zoom" || o.path == "scene";
  plan.frames = o.frames > 0 ? o.frames : o.quick ? 6 : recorded ? 24 : 0;
  plan.repeats = o.repeats > 0 ? o.repeats : o.quick ? 3 : 5;
  plan.repeat_s = o.quick ? 0.2 : 3;
  if (o.quick) plan.reference_triangles = plan.seam_vertices = 4'000'000;
  auto size = parseSize(o.size.empty() ? (o.quick ? "640x360" : "1280x720") : o.size);
  if (!size) return size.error();
  if (size->first > kMaxSidePx || size->second > kMaxSidePx)
    return usageError("expected a --size of at most 8192x8192 px, found " + o.size);
  plan.width_px = static_cast<int>(size->first);
  plan.height_px = static_cast<int>(size->second);
  plan.interrupted = &interruptedFlag();
  return plan;
}

Result<std::vector<ReportPicture>> encodedPictures(const ComparePlan& plan, const CompareFigures& figures) {
  std::vector<ReportPicture> pictures = reportPictures(plan, figures);
  for (ReportPicture& p : pictures) {
    auto png = encodePng(p.width_px, p.height_px, 4, p.rgba);
    if (!png) return png.error();
    p.uri = "data:image/png;base64," + base64(*png);
  }
  return pictures;
}

Result<void> writeReports(const ComparePlan& plan, const CompareFigures& figures, const std::string& folder) {
  auto pictures = encodedPictures(plan, figures);
  if (!pictures) return pictures.error();
  const std::vector<CompareRow> rows = compareRows(figures);
  std::vector<ReportFile> pages = {
      {"frames.csv", reportCsv(figures)},
      {"report.json", reportJson(plan, figures)},
      {"summary.csv", rowsCsv(rows, "", true)},
      {"summary.tex",
       rowsLatex(rows, "LOD strategies over " + std::filesystem::path(plan.package->path()).filename().string())}};
  for (const ComparePlot& p : costPlots(rows)) pages.push_back({p.name + ".svg", standaloneSvg(p.plot)});
  if (figures.frame_count > 1)
    for (const ComparePlot& p : framePlots(figures, plan.budgets_px[(plan.budgets_px.size() - 1) / 2]))
      pages.push_back({p.name + ".svg", standaloneSvg(p.plot)});
  pages.push_back({"report.html", reportHtml(plan, figures, *pictures)});
  return writeReportFiles(pages, folder);
}

Result<void> makeFolder(const std::string& folder) {
  std::error_code bad;
  std::filesystem::create_directories(folder, bad);
  if (bad) return Error{ErrorKind::kIo, folder, "cannot make the folder: " + bad.message(), "", {}};
  return {};
}

// Names without folders, which are nobody's business in a report; but those of reports to merge, which all have one
// name.
std::string commandOf(const CompareOptions& o) {
  auto name = [](const std::string& path) { return std::filesystem::path(path).filename().string(); };
  std::string out = "relievo compare";
  auto add = [&](const char* option, const std::string& value) {
    if (!value.empty()) out += " " + std::string(option) + " " + value;
  };
  auto number = [](double v) {
    char text[40];
    std::snprintf(text, sizeof text, "%g", v);
    return std::string(text);
  };
  for (const std::string& part : o.merge) out += (out.back() == 'e' ? " --merge " : " ") + part;
  if (!o.file.empty()) out += " " + name(o.file);
  if (o.quick) out += " --quick";
  if (o.path != "orbit") add("--path", name(o.path));
  add("--strategies", o.strategies);
  add("--error-px", o.budgets);
  add("--size", o.size);
  add("--settings", name(o.settings_file));
  if (o.frames > 0) add("--frames", std::to_string(o.frames));
  if (o.repeats > 0) add("--repeats", std::to_string(o.repeats));
  if (o.exaggerate != 1) add("--exaggerate", number(o.exaggerate));
  if (o.memory_mib != 1024) add("--memory-mib", number(o.memory_mib));
  return out;
}

Result<CompareOrigin> originOf(const CompareOptions& o, const Manifest& manifest) {
  auto hash = hashFile(o.file, &interruptedFlag());
  if (!hash) return hash.error();
  CompareOrigin origin{commandOf(o), utcText(std::time(nullptr)),
                       processorName() + ", " + std::to_string(std::thread::hardware_concurrency()) + " cores", *hash,
                       ""};
  // Texture and relief may come from the same one.
  std::vector<std::string> sources;
  for (const Provenance& p : manifest.sources) {
    const std::string text = p.name + (p.generator.empty() ? "" : ", " + p.generator);
    if (std::find(sources.begin(), sources.end(), text) == sources.end()) sources.push_back(text);
  }
  for (const std::string& text : sources) origin.source += (origin.source.empty() ? "" : "; ") + text;
  return origin;
}

Result<void> mergeReports(const CompareOptions& o) {
  if (!o.file.empty())
    return usageError("--merge takes reports alone, found FILE " + o.file, "give the reports behind --merge");
  if (auto good = checkFolder("-o", o.folder); !good) return good;
  std::vector<MergedPart> parts;
  for (const std::string& path : o.merge) {
    for (const char* name : {"report.html", "summary.csv", "summary.tex"})
      if (auto good = checkApart({{"-o", o.folder + "/" + name}}, {{"--merge", path}}); !good) return good;
    auto part = readComparison(path);
    if (!part) return part.error();
    parts.push_back(std::move(*part));
  }
  if (auto made = makeFolder(o.folder); !made) return made;
  std::vector<ReportFile> pages = {{"summary.csv", mergedCsv(parts)}, {"summary.tex", mergedLatex(parts)}};
  for (size_t k = 0; k < parts.size(); ++k)
    for (const ComparePlot& p : costPlots(parts[k].rows))
      pages.push_back({std::to_string(k + 1) + "-" + p.name + ".svg", standaloneSvg(p.plot)});
  pages.push_back({"report.html", mergedHtml(parts, commandOf(o), utcText(std::time(nullptr)))});
  if (auto written = writeReportFiles(pages, o.folder); !written) return written;
  printOutf("%s\n", mergedConclusion(parts).c_str());
  return {};
}

// Of a settings file compare takes what concerns geometry: one budget, unless --error-px is given, and the least cell.
Result<void> takeCompareSettings(const CompareOptions& o, ComparePlan& plan) {
  if (o.settings_file.empty()) return {};
  auto settings = readSettings(o.settings_file);
  if (!settings) return settings.error();
  if (settings->error_px && o.budgets.empty()) {
    if (*settings->error_px < kLeastBudgetPx || *settings->error_px > kMostBudgetPx)
      return Error{ErrorKind::kUsage,
                   o.settings_file,
                   "compare measures budgets from 0.05 to 1000 px, the file's error_px lies beyond",
                   "give --error-px",
                   {}};
    plan.budgets_px = {*settings->error_px};
  }
  if (settings->least_cell) plan.least_cell = *settings->least_cell;
  return {};
}

Result<void> compare(const CompareOptions& o) {
  if (!o.merge.empty()) return mergeReports(o);
  if (o.file.empty()) return usageError("FILE is missing: the package of an artwork", "or give --merge and reports");
  auto plan = planOf(o);
  if (!plan) return plan.error();
  if (auto taken = takeCompareSettings(o, *plan); !taken) return taken;
  if (auto good = checkFolder("-o", o.folder); !good) return good;
  for (const char* name : kReportFiles)
    if (auto good = checkApart({{"-o", o.folder + "/" + name}},
                               {{"FILE", o.file}, {"--path", o.path}, {"--settings", o.settings_file}});
        !good)
      return good;
  auto package = Package::open(o.file);
  if (!package) return package.error();
  plan->package = *package;
  // Before anything takes time: is there something to compare, a path, and a place for the report?
  const Manifest& m = (*package)->manifest();
  if (!m.domain.isFlat() && o.quick && o.frames == 0)
    plan->frames = std::min(plan->frames, 4);  // full resolution is millions of triangles
  if (m.domain.relief_depth < 0)
    return Error{ErrorKind::kUnsupported,
                 o.file,
                 "the artwork has no relief: there is no geometry to compare",
                 "build it with --relief",
                 {}};
  if (std::none_of(m.coarse_errors.begin(), m.coarse_errors.end(), [](const auto& errors) { return errors[0] > 0; }) &&
      !m.domain.isFlat() && m.domain.relief_depth == 0)
    warn(o.file +
         ": its patches are the scan's own triangles, without heights, so that no strategy has anything to leave out; "
         "`relievo build --mesh FILE --patches 200` makes larger ones, to compare strategies on");
  if (o.path == "scene") {
    if (o.scene.empty()) return usageError("--path scene needs a scene as FILE", "or give orbit, flyover or zoom");
    auto cameras = scenePath(o.scene, m, plan->frames, plan->width_px, plan->height_px);
    if (!cameras) return cameras.error();
    plan->cameras = std::move(*cameras);
    plan->path = o.scene;
  } else if (auto cameras = compareCameras(plan->path, plan->frames, m, plan->width_px, plan->height_px); !cameras) {
    return cameras.error();
  }
  if (auto made = makeFolder(o.folder); !made) return made;
  auto origin = originOf(o, m);
  if (!origin) return origin.error();
  plan->origin = *origin;
  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();
  Result<CompareFigures> figures = Error{};
  {
    ProgressLine line("comparing");
    plan->progress = [&](double fraction, const std::string& what) { line.update(fraction, what); };
    figures = runCompare(*plan, (*context)->info());
  }
  if (!figures) return figures.error();
  if (auto written = writeReports(*plan, *figures, o.folder); !written) return written;
  printOutf("%-16s %9s %9s %9s %9s %9s %8s %9s %10s %9s %9s\n", "strategy", "budget px", "predicted", "max px",
            "p99 px", "pop px", "crack px", "bit diffs", "triangles", "select ms", "frame ms");
  for (const StrategyFigures& run : figures->runs) {
    if (!run.available) {
      printOutf("%-16s %9.3g not available here: %s\n", run.strategy->name.c_str(), run.budget_px, run.why_not.c_str());
      continue;
    }
    RunSummary s = summaryOf(run, *figures);
    char predicted[32] = "-", mismatches[32] = "-";
    if (s.predicted_px >= 0) std::snprintf(predicted, sizeof predicted, "%.3g", s.predicted_px);
    if (s.seams_known)
      std::snprintf(mismatches, sizeof mismatches, "%llu", static_cast<unsigned long long>(s.seams_mismatched));
    printOutf("%-16s %9.3g %9s %9.3g %9.3g %9.3g %8llu %9s %10.0f %9.2f %9.1f\n", run.strategy->name.c_str(),
              run.budget_px, predicted, s.max_px, s.p99_px, s.pop_px, static_cast<unsigned long long>(s.crack_pixels),
              mismatches, s.triangles, s.select_ms.median, s.frame_ms.median);
  }
  printOutf("%s\n", conclusionText(equalError(compareRows(*figures))).c_str());
  return {};
}

std::string footer() {
  std::string text = "Strategies:\n";
  for (const StrategyEntry& e : lodStrategies())
    text += "  " + e.name + ": " + e.purpose + (e.control ? " (a negative control)" : "") + "\n";
  text +=
      "\nEach pixel of each frame says which place of the artwork it shows; its error is its distance to where the "
      "full-resolution relief\n"
      "has that place on screen, in double precision. Everything is drawn from the same relief pages, all of them "
      "resident.\n\n"
      "frames.csv, by column (report.json has the same, and sums over the frames):\n";
  for (const ReportColumn& c : reportColumns())
    text += "  " + std::string(c.name) + (*c.unit ? " (" + std::string(c.unit) + ")" : "") + ": " + c.meaning + "\n";
  text +=
      "\nA FILE.json for --path:\n"
      "  {\"cameras\": [{\"azimuth_deg\": 20, \"elevation_deg\": 10, \"distance_mm\": 400, \"fov_deg\": 35, "
      "\"orthographic\": false, \"target_mm\": [0, 0, 0]}, ...]}\n"
      "What a camera leaves out is that of one which sees the whole artwork from the front. Other members are refused, "
      "but for the light that\n"
      "relievo view --print-view prints with a camera.\n\n"
      "Example:\n  relievo compare inscription.relievo --path orbit --error-px 0.5,1,2,4 -o comparison\n"
      "  relievo compare inscription.relievo --quick --strategies edge-lod,uniform -o comparison\n"
      "  relievo compare --merge stone/report.json coin/report.json -o all";
  return text;
}

}  // namespace

void addCompareCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<CompareOptions>();
  auto* c =
      app.add_subcommand("compare", "Measure geometry LOD strategies against full resolution: error, triangles, time");
  c->footer(footer());
  c->add_option("FILE", o->file, "Package of an artwork with relief, or a scene of it");
  c->add_option(
       "-o,--output", o->folder,
       "Folder for report.html, report.json, frames.csv, summary.csv, summary.tex (LaTeX) and an .svg for each "
       "plot")
      ->required();
  c->add_option("--merge", o->merge,
                "In place of FILE: report.json files of earlier comparisons, of other artworks or machines, for one "
                "report of all")
      ->expected(1, 1000);
  c->add_option(
      "--path", o->path,
      "Camera path: orbit, flyover, zoom, scene or a FILE.json of cameras [orbit; scene where FILE is one with a "
      "camera_path]");
  c->add_option("--strategies", o->strategies, "Names, separated by commas [all]");
  c->add_option("--error-px", o->budgets, "Error budgets, px, separated by commas [0.5,1,2,4,8; --quick: 1,2,4]");
  c->add_option(
      "--settings", o->settings_file,
      "JSON file of settings that relievo accuracy recommends: its error_px in place of [0.5,1,2,4,8], and its "
      "least_cell; the rest is not about geometry. --error-px wins");
  c->add_option("--frames", o->frames,
                "Frames, at even distances along the path, of a scene at even times [24; --quick: 6, over a scan 4; of "
                "a file: all]")
      ->check(CLI::Range(1, 100000));
  c->add_option("--size", o->size, "Picture, WIDTHxHEIGHT in px [1280x720; --quick: 640x360]");
  c->add_option("--repeats", o->repeats,
                "How often a choice and a frame are timed, at most for 3 s (--quick: 0.2 s) [5; --quick: 3]")
      ->check(CLI::Range(1, 1000));
  c->add_option("--exaggerate", o->exaggerate, "Multiply heights by this")
      ->check(CLI::Range(-10000.0, 10000.0))
      ->capture_default_str();
  c->add_option(
       "--memory-mib", o->memory_mib,
       "Refuse an artwork whose relief pages take more than this, MiB; strategies that simplify meshes take up to "
       "1 GiB each besides")
      ->check(CLI::Range(1.0, 65536.0))
      ->capture_default_str();
  c->add_flag("--quick", o->quick,
              "Fewer frames and budgets, a smaller picture: about four minutes for a 2048x2048 artwork where software "
              "draws, on two idle cores, of which half is the making of simplified meshes");
  c->callback([o, c, &context] {
    if (o->merge.empty() && !o->file.empty()) {
      if (namesScene(o->file)) {
        o->scene = o->file;
        auto moves = hasCameraPath(o->scene);
        if (!moves) return context.fail(moves.error());
        if (*moves && c->count("--path") == 0) o->path = "scene";
      }
      if (auto named = takeArtwork(o->file); !named) return context.fail(named.error());
    }
    if (auto done = compare(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
