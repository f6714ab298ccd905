#include "tools/accuracy/accuracy_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "tools/accuracy/accuracy_front.h"
#include "tools/accuracy/accuracy_html.h"
#include "tools/accuracy/accuracy_plots.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

double sixDigits(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", v);
  return std::strtod(text, nullptr);
}

Json spreadJson(const Spread& s) {
  return {{"median", sixDigits(s.median)}, {"low", sixDigits(s.low)}, {"high", sixDigits(s.high)}, {"count", s.count}};
}

Json settingJson(const AccuracySetting& s) {
  Json json = Json::parse(settingsText(s.draw, ""));
  json.erase("format");
  json.erase("version");
  json["encoding"] = s.encoding.empty() ? "as it is" : s.encoding;
  json["coefficient_bits"] = s.coefficient_bits;
  json["relief_bits"] = s.relief_bits;
  return json;
}

Json rowJson(const AccuracyRow& row) {
  const AccuracyFigures& f = row.figures;
  if (!row.problem.empty())
    return {{"knob", row.knob}, {"value", row.label}, {"setting", settingJson(row.setting)}, {"problem", row.problem}};
  return {{"knob", row.knob},
          {"value", row.label},
          {"setting", settingJson(row.setting)},
          {"psnr_db", sixDigits(f.psnr_db)},
          {"largest_of_255", sixDigits(f.largest)},
          {"moving_psnr_db", sixDigits(f.moving_psnr_db)},
          {"geometry_px", sixDigits(f.geometry_px)},
          {"geometry_p99_px", sixDigits(f.geometry_p99_px)},
          {"geometry_mm", sixDigits(f.geometry_mm)},
          {"predicted_px", sixDigits(f.predicted_px)},
          {"triangles", f.triangles},
          {"moving_ms", spreadJson(f.moving_ms)},
          {"still_ms", spreadJson(f.still_ms)},
          {"cold_ms", spreadJson(f.cold_ms)},
          {"bytes_read", f.bytes_read},
          {"bytes_resident", f.bytes_resident},
          {"build_s", f.build_s < 0 ? Json(nullptr) : Json(sixDigits(f.build_s))},
          {"missing_pixels", f.missing_pixels}};
}

Json knobsJson(const AccuracyPlan& plan) {
  Json out = Json::array();
  for (const AccuracyKnob& k : plan.knobs)
    out.push_back({{"name", k.name},
                   {"title", k.title},
                   {"unit", k.unit},
                   {"meaning", k.meaning},
                   {"measured", k.why_not.empty()},
                   {"why_not", k.why_not.empty() ? Json(nullptr) : Json(k.why_not)}});
  return out;
}

std::string jsonText(const AccuracyPlan& plan, const AccuracyResult& r, const AccuracyProvenance& made,
                     const std::vector<AccuracyAdvice>& advice) {
  Json json = {{"tool_version", "relievo " RELIEVO_VERSION},
               {"command", made.command},
               {"date", made.date},
               {"cpu", made.cpu},
               {"renderer", r.renderer},
               {"gl_version", r.version},
               {"package", {{"file", made.package_name}, {"xxh3_64", made.package_hash}}},
               {"path",
                {{"of", plan.cameras.empty() ? "flights" : "scene"},
                 {"seed", plan.seed},
                 {"views", plan.views},
                 {"width_px", plan.width_px},
                 {"height_px", plan.height_px},
                 {"light", plan.light}}},
               {"truth",
                {{"pixels", r.truth_pixels},
                 {"one_of_px", plan.one_of * plan.one_of},
                 {"covered_pixels", r.covered_pixels},
                 {"edge_pixels", r.edge_pixels},
                 {"unsolved_pixels", r.unsolved_pixels},
                 {"every_triangle", r.truth_whole}}},
               {"uncertainty",
                {{"base_moving_ms", spreadJson(r.control_moving_ms)},
                 {"base_still_ms", spreadJson(r.control_still_ms)},
                 {"base_cold_ms", spreadJson(r.control_cold_ms)},
                 {"base_psnr_db_differs_by", sixDigits(r.control_psnr_db)}}},
               {"knobs", knobsJson(plan)}};
  Json columns = Json::object(), rows = Json::array(), advised = Json::array();
  for (const AccuracyColumn& c : accuracyColumns()) columns[c.name] = {{"unit", c.unit}, {"meaning", c.meaning}};
  for (const AccuracyRow& row : r.rows) rows.push_back(rowJson(row));
  for (const AccuracyAdvice& a : advice)
    advised.push_back({{"goal", a.goal},
                       {"file", a.row ? Json(a.file) : Json(nullptr)},
                       {"row", a.row ? Json(*a.row) : Json(nullptr)},
                       {"text", a.text}});
  json["columns"] = std::move(columns);
  json["rows"] = std::move(rows);
  json["front"] = accuracyFront(r);
  json["recommendations"] = std::move(advised);
  return json.dump(1) + "\n";
}

std::string csvText(const AccuracyResult& r) {
  std::string out;
  for (const AccuracyColumn& c : accuracyColumns()) out += (out.empty() ? "" : ",") + std::string(c.name);
  out += "\n";
  for (const AccuracyRow& row : r.rows) {
    if (!row.problem.empty()) continue;  // accuracy.json and report.html say why
    const AccuracyFigures& f = row.figures;
    out += row.knob + "," + row.label + ",\"" + settingText(row.setting) + "\"";
    for (double v : {f.psnr_db, f.largest, f.moving_psnr_db, f.geometry_px, f.geometry_p99_px, f.geometry_mm,
                     f.predicted_px, f.triangles})
      appendf(out, ",%.6g", v);
    for (const Spread* s : {&f.moving_ms, &f.still_ms, &f.cold_ms})
      appendf(out, ",%.6g,%.6g,%.6g", s->median, s->low, s->high);
    out += "," + std::to_string(f.bytes_read) + "," + std::to_string(f.bytes_resident) + ",";
    if (f.build_s >= 0) appendf(out, "%.6g", f.build_s);
    out += "\n";
  }
  return out;
}

std::string numberWord(double v) {
  std::string out;
  appendf(out, "%g", v);
  std::replace(out.begin(), out.end(), '.', '-');
  return out;
}

}  // namespace

const std::vector<AccuracyColumn>& accuracyColumns() {
  static const std::vector<AccuracyColumn> columns = {
      {"knob", "", "the setting that is turned; base: none of them; combination: several"},
      {"value", "", "what it is turned to"},
      {"setting", "", "all settings, in words"},
      {"psnr_db", "dB",
       "PSNR of the settled pictures against the truth, over all views; 58.9 is perfect but for rounding"},
      {"largest_of_255", "of 255", "largest error of a pixel's channel"},
      {"moving_psnr_db", "dB",
       "PSNR of the pictures as the moving camera arrives, with what has been streamed by then"},
      {"geometry_px", "px", "largest distance of a pixel from where full resolution has the place that it shows"},
      {"geometry_p99_px", "px", "99 of 100 pixels are off by no more, in the worst view"},
      {"geometry_mm", "mm", "the largest such distance, across the line of sight"},
      {"predicted_px", "px", "the bound that the renderer states for it"},
      {"triangles", "", "drawn, median over the views"},
      {"moving_ms", "ms",
       "for each position of a moving camera that is shown: mean of the views, median of the rounds"},
      {"moving_ms_low", "ms", "first quartile of the rounds"},
      {"moving_ms_high", "ms", "third quartile of the rounds"},
      {"still_ms", "ms", "a frame of a still camera: median of a view, mean of the views, median of the rounds"},
      {"still_ms_low", "ms", "first quartile of the rounds"},
      {"still_ms_high", "ms", "third quartile of the rounds"},
      {"cold_ms", "ms", "from no page in memory to a settled picture, GL context excepted: median"},
      {"cold_ms_low", "ms", "first quartile"},
      {"cold_ms_high", "ms", "third quartile"},
      {"bytes_read", "B", "pages read over the path, as the package holds them"},
      {"bytes_resident", "B", "pages in the cache, at most"},
      {"build_s", "s", "CPU time of encoding every page so, extrapolated; empty: the package is as it is"}};
  return columns;
}

std::vector<size_t> adviceCandidates(const AccuracyResult& result) {
  std::vector<size_t> out;
  for (size_t i = 0; i < result.rows.size(); ++i) {
    // The caching knobs change what is seen on the way, which settled pictures do not show.
    const std::string& knob = result.rows[i].knob;
    const bool streaming =
        knob == "feedback-scale" || knob == "feedback-interval" || knob == "prefetch" || knob == "cache-mib";
    if (result.rows[i].problem.empty() && !result.rows[i].setting.rebuilt() && !streaming) out.push_back(i);
  }
  return out;
}

std::vector<size_t> accuracyFront(const AccuracyResult& result) {
  const auto rows = adviceCandidates(result);
  std::vector<CostAndGain> points;
  for (size_t i : rows) points.push_back({result.rows[i].figures.moving_ms.median, result.rows[i].figures.psnr_db});
  std::vector<size_t> out;
  for (size_t k : paretoFront(points)) out.push_back(rows[k]);
  return out;
}

std::vector<AccuracyAdvice> adviceFor(const AccuracyResult& result, const AccuracyGoals& goals) {
  const auto rows = adviceCandidates(result);
  std::vector<CostAndGain> points;
  for (size_t i : rows) points.push_back({result.rows[i].figures.moving_ms.median, result.rows[i].figures.psnr_db});
  std::vector<AccuracyAdvice> out;
  auto add = [&](std::string goal, std::string file, std::optional<size_t> found, const char* none) {
    AccuracyAdvice a{std::move(goal), std::move(file), {}, none};
    if (found) {
      a.row = rows[*found];
      const AccuracyFigures& f = result.rows[*a.row].figures;
      a.text.clear();
      appendf(a.text, "%.1f dB, geometry within %.2g px; %.1f ms a moving frame, %.1f ms a still one: %s", f.psnr_db,
              f.geometry_px, f.moving_ms.median, f.still_ms.median, settingText(result.rows[*a.row].setting).c_str());
    }
    out.push_back(std::move(a));
  };
  for (double db : goals.psnr_db) {
    std::string goal;
    appendf(goal, "the cheapest of at least %g dB", db);
    add(goal, "settings-" + numberWord(db) + "-db.json", cheapestWithin(points, db),
        "no setting that was measured is as accurate");
  }
  for (double ms : goals.frame_ms) {
    std::string goal;
    appendf(goal, "the most accurate of at most %g ms a moving frame", ms);
    add(goal, "settings-" + numberWord(ms) + "-ms.json", mostAccurateWithin(points, ms),
        "no setting that was measured is as fast");
  }
  return out;
}

std::vector<ReportFile> accuracyReport(const AccuracyPlan& plan, const AccuracyResult& result,
                                       const AccuracyProvenance& made, const AccuracyGoals& goals) {
  const auto advice = adviceFor(result, goals);
  std::vector<NamedPlot> plots{frontPlot(result, accuracyFront(result))};
  for (const AccuracyKnob& knob : plan.knobs)
    for (NamedPlot& p : knobPlots(knob, result)) plots.push_back(std::move(p));
  std::vector<ReportFile> out{{"accuracy.csv", csvText(result)},
                              {"accuracy.json", jsonText(plan, result, made, advice)}};
  for (const AccuracyAdvice& a : advice)
    if (a.row) out.push_back({a.file, settingsText(result.rows[*a.row].setting.draw, a.goal + ": " + a.text)});
  for (const NamedPlot& p : plots) out.push_back({p.name + ".svg", standaloneSvg(p.plot)});
  out.push_back({"report.html", accuracyHtml(plan, result, made, advice, plots)});
  return out;
}

}  // namespace relievo
