#include "tools/compare/compare_report.h"
#include "tools/compare/compare_rows.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include <nlohmann/json.hpp>

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

// Six digits: the last ones of a float are nobody's.
double rounded(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", v);
  return std::strtod(text, nullptr);
}

Json orNull(bool known, double v) { return known ? Json(rounded(v)) : Json(nullptr); }

Json timingJson(const Timing& t) {
  return {{"median", rounded(t.median)}, {"fastest", rounded(t.low)}, {"slowest", rounded(t.high)}};
}

std::string number(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", v);
  return text;
}

}  // namespace

double measuringSlackPx(const CompareFigures& all) { return std::max(1.0 / 64, 2 * all.floor.max_px); }

RunSummary summaryOf(const StrategyFigures& run, const CompareFigures& all) {
  RunSummary s;
  std::vector<double> triangles, cold_bytes, cold_decode_ms, select_ms, frame_ms;
  double squares = 0, pixels = 0;
  for (const FrameFigures& f : run.frames) {
    s.max_px = std::max(s.max_px, f.error.max_px);
    s.p99_px = std::max(s.p99_px, f.error.p99_px);
    squares += f.error.rms_px * f.error.rms_px * static_cast<double>(f.error.pixels);
    pixels += static_cast<double>(f.error.pixels);
    s.predicted_px = std::max(s.predicted_px, f.predicted_px);
    s.budget_px = std::max(s.budget_px, f.budget_px);
    s.pop_px = std::max(s.pop_px, f.pop_px);
    s.edge_on_pixels += f.edge_on_pixels;
    s.pixels += f.error.pixels;
    s.above_bound_frames += f.predicted_px >= 0 && f.error.max_px > f.predicted_px + measuringSlackPx(all);
    s.crack_pixels += f.coverage.crack_pixels;
    s.silhouette_pixels += f.coverage.silhouette_pixels;
    s.seams_compared += f.seams.compared;
    s.seams_mismatched += f.seams.mismatched;
    s.seams_known = s.seams_known || f.seams_known;
    s.streamed_bytes += f.streamed_bytes;
    s.max_triangles = std::max(s.max_triangles, f.triangles);
    s.max_resident_bytes = std::max(s.max_resident_bytes, f.resident_bytes);
    s.max_draw_calls = std::max(s.max_draw_calls, f.draw_calls);
    triangles.push_back(static_cast<double>(f.triangles));
    cold_bytes.push_back(static_cast<double>(f.cold_bytes));
    cold_decode_ms.push_back(f.cold_decode_ms);
    select_ms.push_back(f.select_ms.median);
    frame_ms.push_back(f.frame_ms.median);
  }
  auto timing = [](std::vector<double> v) -> Timing {
    if (v.empty()) return {};
    std::sort(v.begin(), v.end());
    return {v[v.size() / 2], v.front(), v.back()};
  };
  s.rms_px = pixels > 0 ? std::sqrt(squares / pixels) : 0;
  s.triangles = timing(triangles).median;
  s.cold = {timing(cold_bytes).median, timing(cold_decode_ms).median};
  s.select_ms = timing(select_ms);
  s.frame_ms = timing(frame_ms);
  return s;
}

const std::vector<ReportColumn>& reportColumns() {
  static const std::vector<ReportColumn> columns = {
      {"strategy", "", "name, as --strategies takes it"},
      {"error_px", "px", "the budget asked for"},
      {"frame", "", "0 .. frames - 1"},
      {"kept_px", "px", "the budget kept to: more than asked for where a node budget ran out"},
      {"predicted_px", "px", "upper bound that the strategy gives for max_px; empty: it promises nothing"},
      {"max_px", "px", "largest error of a pixel: from it to where full resolution has the place that it shows"},
      {"p99_px", "px", "99 of 100 pixels are off by no more"},
      {"rms_px", "px", "root of the mean square"},
      {"edge_on_px", "pixels",
       "not measured: more than 64 cells wide, seen edge-on, where a rasteriser knows no place"},
      {"pop_px", "px",
       "largest change of a pixel's error against the choice of a sixtieth of a second before, camera motion taken "
       "out; what comes into view from behind a rim counts, too"},
      {"crack_px", "pixels",
       "background inside full resolution's silhouette, 1 px and the bounds of both away from it (of a closed body a "
       "crack shows the far side: see seam_mismatches)"},
      {"silhouette_px", "pixels", "drawn by one of strategy and full resolution only"},
      {"seam_vertices", "", "vertices compared on sides that two drawn nodes share; empty: not known"},
      {"seam_mismatches", "", "of them, those whose bits one side lacks"},
      {"triangles", "", "drawn"},
      {"draw_calls", "", "made"},
      {"instances", "", "grids drawn"},
      {"resident_bytes", "B",
       "of the relief pages displaced from, in the page cache; or of the mesh that the GPU keeps instead, all of it"},
      {"streamed_bytes", "B", "of what the frame before did not draw from: relief pages or parts of a mesh, encoded"},
      {"cold_bytes", "B", "of all that is drawn from, encoded: what an empty cache has to read"},
      {"cold_decode_ms", "ms", "decoding that, one thread"},
      {"select_ms", "ms", "CPU time of the choice, wall clock: median of the repeats"},
      {"select_ms_fastest", "ms", "fastest repeat"},
      {"select_ms_slowest", "ms", "slowest repeat"},
      {"frame_ms", "ms", "instances uploaded, geometry drawn without shading, glFinish: median of the repeats"},
      {"frame_ms_fastest", "ms", "fastest repeat"},
      {"frame_ms_slowest", "ms", "slowest repeat"}};
  return columns;
}

namespace {

// What was compared, and how: all but the runs.
Json headJson(const ComparePlan& plan, const CompareFigures& all) {
  const PatchDomain& d = plan.package->manifest().domain;
  return {{"tool_version", "relievo " RELIEVO_VERSION},
          {"origin",
           {{"command", plan.origin.command},
            {"date", plan.origin.date},
            {"cpu", plan.origin.cpu},
            {"package_xxh3_64", plan.origin.package_hash},
            {"source", plan.origin.source}}},
          {"renderer", all.renderer},
          {"gl_version", all.version},
          {"artwork",
           {{"file", std::filesystem::path(plan.package->path()).filename().string()},
            {"width_px", d.isFlat() ? Json(d.flat().width_px) : Json(nullptr)},
            {"height_px", d.isFlat() ? Json(d.flat().height_px) : Json(nullptr)},
            {"mm_per_px", d.mm_per_px},
            {"relief_pages", all.relief_pages},
            {"relief_bytes", all.relief_bytes},
            {"base_patches", d.isFlat() ? Json(nullptr) : Json(d.patchCount())}}},
          {"view",
           {{"path", plan.path},
            {"frames", all.frame_count},
            {"width_px", plan.width_px},
            {"height_px", plan.height_px},
            {"exaggerate", plan.exaggerate}}},
          {"reference",
           {{"full_resolution", all.reference_whole},
            {"triangles_at_most", all.reference_triangles},
            {"bound_px", rounded(all.reference_bound_px)},
            {"measuring_max_px", rounded(all.floor.max_px)},
            {"measuring_p99_px", rounded(all.floor.p99_px)},
            {"measuring_slack_px", rounded(measuringSlackPx(all))}}}};
}

Json summaryJson(const RunSummary& s) {
  const bool promised = s.predicted_px >= 0;
  return {{"kept_px", rounded(s.budget_px)},
          {"predicted_px", orNull(promised, s.predicted_px)},
          {"max_px", rounded(s.max_px)},
          {"p99_px", rounded(s.p99_px)},
          {"rms_px", rounded(s.rms_px)},
          {"edge_on_px", s.edge_on_pixels},
          {"pop_px", rounded(s.pop_px)},
          {"frames_above_the_promise", promised ? Json(s.above_bound_frames) : Json(nullptr)},
          {"crack_px", s.crack_pixels},
          {"silhouette_px", s.silhouette_pixels},
          {"seam_vertices", s.seams_known ? Json(s.seams_compared) : Json(nullptr)},
          {"seam_mismatches", s.seams_known ? Json(s.seams_mismatched) : Json(nullptr)},
          {"triangles_median", rounded(s.triangles)},
          {"triangles_max", s.max_triangles},
          {"draw_calls_max", s.max_draw_calls},
          {"resident_bytes_max", s.max_resident_bytes},
          {"streamed_bytes", s.streamed_bytes},
          {"cold_bytes_median", rounded(s.cold.bytes)}};
}

Json frameJson(const FrameFigures& f) {
  return {{"kept_px", rounded(f.budget_px)},
          {"predicted_px", orNull(f.predicted_px >= 0, f.predicted_px)},
          {"max_px", rounded(f.error.max_px)},
          {"p99_px", rounded(f.error.p99_px)},
          {"rms_px", rounded(f.error.rms_px)},
          {"pixels", f.error.pixels},
          {"edge_on_px", f.edge_on_pixels},
          {"pop_px", rounded(f.pop_px)},
          {"crack_px", f.coverage.crack_pixels},
          {"silhouette_px", f.coverage.silhouette_pixels},
          {"seam_vertices", f.seams_known ? Json(f.seams.compared) : Json(nullptr)},
          {"seam_mismatches", f.seams_known ? Json(f.seams.mismatched) : Json(nullptr)},
          {"triangles", f.triangles},
          {"draw_calls", f.draw_calls},
          {"instances", f.instances},
          {"resident_bytes", f.resident_bytes},
          {"streamed_bytes", f.streamed_bytes},
          {"cold_bytes", f.cold_bytes}};
}

}  // namespace

std::string reportJson(const ComparePlan& plan, const CompareFigures& all) {
  Json json = headJson(plan, all);
  Json columns = Json::object();
  for (const ReportColumn& c : reportColumns()) columns[c.name] = {{"unit", c.unit}, {"meaning", c.meaning}};
  json["columns"] = columns;
  Json runs = Json::array(), timings = Json::array();
  for (const StrategyFigures& run : all.runs) {
    Json r = {{"strategy", run.strategy->name},
              {"title", run.strategy->title},
              {"purpose", run.strategy->purpose},
              {"control", run.strategy->control},
              {"error_px", run.budget_px}};
    if (!run.available) {
      r["available"] = false;
      r["why"] = "not available here: " + run.why_not;
      runs.push_back(r);
      continue;
    }
    const RunSummary s = summaryOf(run, all);
    r["summary"] = summaryJson(s);
    Json frames = Json::array(), frame_timings = Json::array();
    for (const FrameFigures& f : run.frames) {
      frames.push_back(frameJson(f));
      frame_timings.push_back({{"select_ms", timingJson(f.select_ms)},
                               {"frame_ms", timingJson(f.frame_ms)},
                               {"cold_decode_ms", rounded(f.cold_decode_ms)}});
    }
    r["frames"] = frames;
    runs.push_back(r);
    timings.push_back({{"strategy", run.strategy->name},
                       {"error_px", run.budget_px},
                       {"select_ms", timingJson(s.select_ms)},
                       {"frame_ms", timingJson(s.frame_ms)},
                       {"cold_decode_ms", rounded(s.cold.decode_ms)},
                       {"frames", frame_timings}});
  }
  json["runs"] = runs;
  const EqualError equal = equalError(compareRows(all));
  Json at_equal = Json::array(), ms_at_equal = Json::array();
  for (const EqualErrorCost& c : equal.costs) {
    at_equal.push_back(
        {{"strategy", c.strategy}, {"triangles", rounded(c.triangles)}, {"cold_bytes", rounded(c.cold.bytes)}});
    Json cold_ms = Json::object();
    for (const int rate : kLinkRates) cold_ms[std::to_string(rate) + " MB/s"] = rounded(c.cold.ms(rate));
    ms_at_equal.push_back(
        {{"strategy", c.strategy}, {"ms", timingJson({c.ms, c.ms_low, c.ms_high})}, {"cold_ms", cold_ms}});
  }
  json["equal_error"] = {{"p99_px", equal.error_px}, {"strategies", at_equal}};
  json["timings"] = {{"repeats", plan.repeats},
                     {"conclusion", conclusionText(equal)},
                     {"equal_error", ms_at_equal},
                     {"runs", timings}};
  return json.dump(1) + "\n";
}

std::string reportCsv(const CompareFigures& all) {
  std::string out;
  for (const ReportColumn& c : reportColumns()) out += (out.empty() ? "" : ",") + std::string(c.name);
  out += "\n";
  for (const StrategyFigures& run : all.runs) {
    int frame = 0;
    for (const FrameFigures& f : run.frames) {
      out += run.strategy->name;
      auto cell = [&](bool known, double v) { out += known ? "," + number(v) : std::string(","); };
      auto count = [&](uint64_t v) { out += "," + std::to_string(v); };
      cell(true, run.budget_px);
      count(static_cast<uint64_t>(frame++));
      cell(true, f.budget_px);
      cell(f.predicted_px >= 0, f.predicted_px);
      for (double v : {f.error.max_px, f.error.p99_px, f.error.rms_px}) cell(true, v);
      count(f.edge_on_pixels);
      cell(true, f.pop_px);
      count(f.coverage.crack_pixels);
      count(f.coverage.silhouette_pixels);
      cell(f.seams_known, static_cast<double>(f.seams.compared));
      cell(f.seams_known, static_cast<double>(f.seams.mismatched));
      for (uint64_t v : {f.triangles, uint64_t{f.draw_calls}, uint64_t{f.instances}, f.resident_bytes, f.streamed_bytes,
                         f.cold_bytes})
        count(v);
      cell(true, f.cold_decode_ms);
      for (const Timing* t : {&f.select_ms, &f.frame_ms})
        for (double v : {t->median, t->low, t->high}) cell(true, v);
      out += "\n";
    }
  }
  return out;
}

}  // namespace relievo
