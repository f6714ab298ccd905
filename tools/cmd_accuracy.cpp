// relievo accuracy: what accuracy costs in time, setting by setting, and the best combinations.
#include <algorithm>
#include <charconv>
#include <ctime>
#include <filesystem>
#include <memory>
#include <thread>

#include <CLI/CLI.hpp>

#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/gl/context.h"
#include "tools/accuracy/accuracy_report.h"
#include "tools/accuracy/accuracy_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/report/machine.h"
#include "tools/scene/scene_file.h"
#include "tools/scene_path.h"

namespace relievo {
namespace {

constexpr int64_t kMostAccuracyPx = 4096;

struct AccuracyOptions {
  std::string scene, path = "flights", file, folder, knobs, size, light = "-0.6,0.5,0.6", psnr = "35,40,45",
                     frame_ms = "16.7,33.3";
  int views = 0, passes = 0, combinations = -1, workers = 2;
  uint32_t seed = 1;
  double memory_mib = 1024;
  bool quick = false;
};

Result<std::vector<double>> goalsOf(const std::string& list, const char* option, const char* unit) {
  std::vector<double> out;
  for (const std::string& text : commaParts(list)) {
    double v = 0;
    const auto [end, bad] = std::from_chars(text.data(), text.data() + text.size(), v);
    if (bad != std::errc() || end != text.data() + text.size() || !(v > 0 && v < 1e6) || out.size() >= 32)
      return usageError("expected numbers above 0, at most 32, for " + std::string(option) + ", found '" + text + "'",
                        "in " + std::string(unit) + ", separated by commas");
    if (std::find(out.begin(), out.end(), v) == out.end()) out.push_back(v);
  }
  return out;
}

// Those of --knobs; others are reported as not asked for.
Result<void> chooseKnobs(const std::string& list, std::vector<AccuracyKnob>& knobs) {
  if (list.empty()) return {};
  std::string names;
  for (const AccuracyKnob& k : knobs) names += (names.empty() ? "" : ", ") + k.name;
  const std::vector<std::string> wanted = commaParts(list);
  for (const std::string& w : wanted)
    if (std::none_of(knobs.begin(), knobs.end(), [&](const AccuracyKnob& k) { return k.name == w; }))
      return usageError("there is no knob '" + w + "'", "there are: " + names);
  for (AccuracyKnob& k : knobs)
    if (k.why_not.empty() && std::find(wanted.begin(), wanted.end(), k.name) == wanted.end())
      k.why_not = "left out by --knobs";
  return {};
}

Result<AccuracyPlan> accuracyPlan(const AccuracyOptions& o) {
  AccuracyPlan plan;
  auto size = parseSize(o.size.empty() ? (o.quick ? "400x225" : "1280x720") : o.size);
  if (!size) return size.error();
  if (size->first > kMostAccuracyPx || size->second > kMostAccuracyPx || size->first < 16 || size->second < 16)
    return usageError("expected a --size from 16x16 to 4096x4096 px, found " + o.size);
  plan.width_px = static_cast<int>(size->first);
  plan.height_px = static_cast<int>(size->second);
  auto light = parseTriple(o.light, "--light", "X,Y,Z towards the light: -0.6,0.5,0.6");
  if (!light) return light.error();
  if ((*light)[0] == 0 && (*light)[1] == 0 && (*light)[2] == 0)
    return usageError("the light's direction is zero", "for example --light -0.6,0.5,0.6");
  plan.light = *light;
  plan.seed = o.seed;
  plan.views = o.views > 0 ? o.views : o.quick ? 3 : 6;
  plan.passes = o.passes > 0 ? o.passes : o.quick ? 2 : 3;
  plan.combinations = o.combinations >= 0 ? o.combinations : o.quick ? 8 : 40;
  plan.workers = o.workers;
  plan.memory_bytes = static_cast<uint64_t>(o.memory_mib * 1048576.0);
  if (o.quick) {
    plan.moving_frames = 5;
    plan.still_frames = 3;
    plan.cold_starts = 1;
    plan.one_of = 2;
    plan.reference_triangles = 4'000'000;
  }
  plan.interrupted = &interruptedFlag();
  return plan;
}

std::string commandLine(const AccuracyOptions& o) {
  std::string out = "relievo accuracy " + std::filesystem::path(o.file).filename().string();
  auto add = [&](const char* option, const std::string& value) { out += " " + std::string(option) + " " + value; };
  if (o.quick) out += " --quick";
  if (!o.size.empty()) add("--size", o.size);
  if (!o.knobs.empty()) add("--knobs", o.knobs);
  if (o.path != "flights") add("--path", o.path);
  if (o.views > 0) add("--views", std::to_string(o.views));
  if (o.passes > 0) add("--passes", std::to_string(o.passes));
  if (o.combinations >= 0) add("--combinations", std::to_string(o.combinations));
  add("--seed", std::to_string(o.seed));
  add("--light", o.light);
  add("--psnr", o.psnr);
  add("--frame-ms", o.frame_ms);
  return out;
}

void printRows(const AccuracyResult& result, const AccuracyGoals& goals, const std::string& folder) {
  printOutf("%-18s %-14s %8s %8s %8s %9s %9s %9s %9s %9s %9s\n", "knob", "value", "PSNR dB", "max/255", "geom px",
            "moving ms", "still ms", "cold ms", "read MiB", "res. MiB", "build s");
  for (const AccuracyRow& row : result.rows) {
    const AccuracyFigures& f = row.figures;
    if (!row.problem.empty()) {
      printOutf("%-18s %-14s not measured: %s\n", row.knob.c_str(), row.label.c_str(), row.problem.c_str());
      continue;
    }
    std::string build = "-";
    if (f.build_s >= 0) build = std::to_string(f.build_s).substr(0, 5);
    printOutf("%-18s %-14s %8.2f %8.0f %8.3g %9.2f %9.2f %9.0f %9.2f %9.2f %9s\n", row.knob.c_str(), row.label.c_str(),
              f.psnr_db, f.largest, f.geometry_px, f.moving_ms.median, f.still_ms.median, f.cold_ms.median,
              static_cast<double>(f.bytes_read) / 1048576.0, static_cast<double>(f.bytes_resident) / 1048576.0,
              build.c_str());
  }
  for (const AccuracyAdvice& a : adviceFor(result, goals))
    printOutf("%s: %s%s\n", a.goal.c_str(), a.text.c_str(), a.row ? (" -> " + folder + "/" + a.file).c_str() : "");
}

Result<void> accuracy(const AccuracyOptions& o) {
  auto plan = accuracyPlan(o);
  if (!plan) return plan.error();
  auto psnr = goalsOf(o.psnr, "--psnr", "dB");
  if (!psnr) return psnr.error();
  auto frame_ms = goalsOf(o.frame_ms, "--frame-ms", "ms");
  if (!frame_ms) return frame_ms.error();
  const AccuracyGoals goals{*psnr, *frame_ms};
  if (auto good = checkFolder("-o", o.folder); !good) return good;
  auto package = Package::open(o.file);
  if (!package) return package.error();
  plan->package = *package;
  if (o.path == "scene") {
    if (o.scene.empty()) return usageError("--path scene needs a scene as FILE", "or give flights");
    constexpr int kMoments = 96;  // of which views are drawn
    auto cameras = scenePath(o.scene, (*package)->manifest(), kMoments, plan->width_px, plan->height_px);
    if (!cameras) return cameras.error();
    plan->cameras = std::move(*cameras);
  }
  plan->knobs = accuracyKnobs((*package)->manifest(), o.quick);
  if (auto chosen = chooseKnobs(o.knobs, plan->knobs); !chosen) return chosen;
  std::error_code bad;
  std::filesystem::create_directories(o.folder, bad);
  if (bad) return Error{ErrorKind::kIo, o.folder, "cannot make the folder: " + bad.message(), "", {}};
  for (const char* name : {"report.html", "accuracy.json", "accuracy.csv"})
    if (auto good = checkOutputs({{"-o", o.folder + "/" + name}}, {{"FILE", o.file}}); !good) return good;
  auto hash = hashFile(o.file, &interruptedFlag());
  if (!hash) return hash.error();
  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();
  std::vector<std::string> notices;
  if (auto fitted = fitCache(*plan, notices); !fitted) return fitted.error();
  for (const std::string& notice : notices) warn(notice);
  Result<AccuracyResult> result = Error{};
  {
    ProgressLine line("measuring");
    plan->progress = [&](double fraction, const std::string& what) { line.update(fraction, what); };
    result = runAccuracy(*plan, (*context)->info());
  }
  if (!result) return result.error();
  const AccuracyProvenance made{commandLine(o), utcText(std::time(nullptr)),
                                processorName() + ", " + std::to_string(std::thread::hardware_concurrency()) + " cores",
                                std::filesystem::path(o.file).filename().string(), *hash};
  if (auto written = writeReportFiles(accuracyReport(*plan, *result, made, goals), o.folder); !written) return written;
  printRows(*result, goals, o.folder);
  return {};
}

std::string accuracyFooter() {
  std::string text =
      "The truth is every finest triangle and every texel of a pixel's footprint, in double precision. Each knob is "
      "turned with the\nothers at the default and the sharpest sampling; then promising combinations are measured, not "
      "computed.\n\nDIR gets report.html (light and dark, no other file needed), accuracy.json, accuracy.csv, an .svg "
      "for each plot, and a\nsettings-*.json for each goal of --psnr and --frame-ms that a setting reaches: for "
      "--settings of render, view and compare.\n\nKnobs:\n";
  for (const AccuracyKnob& k : accuracyKnobs(Manifest{}, true))
    text += "  " + k.name + (k.unit.empty() ? "" : " (" + k.unit + ")") + ": " + k.meaning + "\n";
  text += "\naccuracy.csv, by column:\n";
  for (const AccuracyColumn& c : accuracyColumns())
    text += "  " + std::string(c.name) + (*c.unit ? " (" + std::string(c.unit) + ")" : "") + ": " + c.meaning + "\n";
  return text +
         "\nExample:\n  relievo accuracy coin.relievo --quick -o accuracy\n"
         "  relievo accuracy coin.relievo --psnr 42 --frame-ms 33 -o accuracy\n"
         "  relievo render coin.relievo --settings accuracy/settings-42-db.json -o coin.png";
}

}  // namespace

void addAccuracyCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<AccuracyOptions>();
  auto* c = app.add_subcommand("accuracy", "Measure what accuracy costs in time: every setting, and the best ones");
  c->footer(accuracyFooter());
  c->add_option("FILE", o->file, "Package of an artwork with relief, or a scene of it, whose light is taken")
      ->required();
  c->add_option("-o,--output", o->folder, "Folder for the report, its figures, plots and settings files")->required();
  c->add_option("--psnr", o->psnr, "Accuracies to recommend the cheapest setting for, dB, separated by commas")
      ->capture_default_str();
  c->add_option("--frame-ms", o->frame_ms,
                "Times of a moving frame to recommend the most accurate setting for, ms, separated by commas")
      ->capture_default_str();
  c->add_option("--knobs", o->knobs, "Knobs to turn, separated by commas; names are below [all]");
  c->add_option("--combinations", o->combinations, "Combinations to measure, at most [40; --quick: 8]")
      ->check(CLI::Range(0, 10000));
  c->add_option(
       "--path", o->path,
       "Camera path: flights (around, over at a slant, close) or scene [flights; scene where FILE is one with a "
       "camera_path]")
      ->check(CLI::IsMember({"flights", "scene"}));
  c->add_option("--views", o->views, "Views of the camera path [6; --quick: 3]")->check(CLI::Range(1, 96));
  c->add_option("--passes", o->passes, "How often each setting flies the path, from a cold start [3; --quick: 2]")
      ->check(CLI::Range(1, 100));
  c->add_option("--size", o->size, "Picture, WIDTHxHEIGHT in px [1280x720; --quick: 400x225]");
  c->add_option("--seed", o->seed, "Of the moments of the flights, and of the truth's pixels")->capture_default_str();
  c->add_option("--light", o->light, "X,Y,Z towards the light: right, up, to the viewer")->capture_default_str();
  c->add_option("--workers", o->workers, "Threads that decode pages")->check(CLI::Range(1, 64))->capture_default_str();
  c->add_option("--memory-mib", o->memory_mib,
                "Refuse an artwork whose relief pages take more than this, MiB; the truth's texture pages take as much "
                "again at most")
      ->check(CLI::Range(1.0, 65536.0))
      ->capture_default_str();
  c->add_flag("--quick", o->quick,
              "Fewer values, views and frames, a smaller picture, every fourth pixel of the truth: one to two minutes "
              "where software draws, on two idle cores");
  c->callback([o, c, &context] {
    if (namesScene(o->file)) {
      auto scene = readScene(o->file);
      if (!scene) return context.fail(scene.error());
      auto only = onlyArtwork(*scene, o->file);
      if (!only) return context.fail(only.error());
      o->scene = std::exchange(o->file, *only);
      if (!scene->animation.camera.empty() && c->count("--path") == 0) o->path = "scene";
      if (!scene->lights.empty() && c->count("--light") == 0)
        return context.fail(usageError("accuracy is measured under one white light, and the scene has others",
                                       "give one in their place with --light"));
      if (scene->shading.isOn())
        return context.fail(usageError("accuracy is measured of colour and light, and the scene has a shading",
                                       "leave out its \"shading\""));
      if (scene->pose.isOn() && c->count("--light") == 0)
        return context.fail(usageError("accuracy is measured of an artwork as it is, and the scene has a pose",
                                       "say with --light where the light is, as the artwork sees it"));
      if (scene->light && c->count("--light") == 0) o->light = tripleText(*scene->light);
    }
    if (auto done = accuracy(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
