#include "tools/compare/compare_merge.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <nlohmann/json.hpp>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "tools/compare/compare_plots.h"
#include "tools/compare/compare_tables.h"

namespace relievo {
namespace {

using MergedJson = nlohmann::ordered_json;
constexpr uint64_t kMostReportBytes = uint64_t{64} << 20;
constexpr size_t kMostRows = 10'000;

std::string textAt(const MergedJson& of, const char* member) {
  const auto at = of.is_object() ? of.find(member) : of.end();
  return at != of.end() && at->is_string() ? at->get<std::string>() : "";
}
const MergedJson* memberAt(const MergedJson& of, const char* member) {
  if (!of.is_object()) return nullptr;
  const auto at = of.find(member);
  return at == of.end() ? nullptr : &*at;
}

// Reads numbers; the first that is missing or none is remembered.
struct NumberReader {
  std::string missing;
  double at(const MergedJson* of, const char* member) {
    const MergedJson* value = of ? memberAt(*of, member) : nullptr;
    if (value && value->is_number()) {
      const double v = value->get<double>();
      if (std::isfinite(v) && v >= 0) return v;
    }
    if (missing.empty()) missing = member;
    return 0;
  }
  uint64_t count(const MergedJson* of, const char* member) {
    return static_cast<uint64_t>(std::min(at(of, member), 1e18));
  }
  Timing timing(const MergedJson* of, const char* member) {
    const MergedJson* value = of ? memberAt(*of, member) : nullptr;
    return {at(value, "median"), at(value, "fastest"), at(value, "slowest")};
  }
};

CompareRow rowFrom(const MergedJson& run, const MergedJson& timings, NumberReader& numbers) {
  CompareRow r;
  r.strategy = textAt(run, "strategy");
  r.title = textAt(run, "title");
  r.purpose = textAt(run, "purpose");
  if (r.strategy.empty() || r.title.empty()) numbers.missing = "strategy";
  const MergedJson *control = memberAt(run, "control"), *summary = memberAt(run, "summary");
  r.control = control && control->is_boolean() && control->get<bool>();
  r.budget_px = numbers.at(&run, "error_px");
  if (!summary) {
    r.available = false;
    r.why_not = textAt(run, "why");
    return r;
  }
  const MergedJson* predicted = memberAt(*summary, "predicted_px");
  r.predicted_px = predicted && predicted->is_number() ? numbers.at(summary, "predicted_px") : -1;
  r.max_px = numbers.at(summary, "max_px");
  r.p99_px = numbers.at(summary, "p99_px");
  r.rms_px = numbers.at(summary, "rms_px");
  r.pop_px = numbers.at(summary, "pop_px");
  r.crack_pixels = numbers.count(summary, "crack_px");
  r.silhouette_pixels = numbers.count(summary, "silhouette_px");
  const MergedJson *seams = memberAt(*summary, "seam_mismatches"),
                   *above = memberAt(*summary, "frames_above_the_promise");
  r.seams_known = seams && seams->is_number();
  if (r.seams_known) r.seam_mismatches = numbers.count(summary, "seam_mismatches");
  if (above && above->is_number()) r.frames_above_bound = numbers.count(summary, "frames_above_the_promise");
  r.triangles = numbers.at(summary, "triangles_median");
  r.draw_calls = static_cast<uint32_t>(std::min(numbers.at(summary, "draw_calls_max"), 4e9));
  r.resident_bytes = numbers.count(summary, "resident_bytes_max");
  r.streamed_bytes = numbers.count(summary, "streamed_bytes");
  const bool cold = memberAt(*summary, "cold_bytes_median") != nullptr;  // older reports have none
  if (cold) r.cold.bytes = numbers.at(summary, "cold_bytes_median");
  for (const MergedJson& t : timings)
    if (textAt(t, "strategy") == r.strategy && memberAt(t, "error_px") && *memberAt(t, "error_px") == run["error_px"]) {
      r.select_ms = numbers.timing(&t, "select_ms");
      r.frame_ms = numbers.timing(&t, "frame_ms");
      if (cold) r.cold.decode_ms = numbers.at(&t, "cold_decode_ms");
      return r;
    }
  numbers.missing = "timings";
  return r;
}

std::string titleOf(const MergedPart& part) {
  return part.artwork + (part.renderer.empty() ? "" : ", " + part.renderer);
}

// Of strategies that every part has at its equal error: how many times the fewest triangles, geometric mean; and the
// same for times.
struct MeanCost {
  std::string title;
  double triangles = 0, ms = 0;
};
std::vector<MeanCost> meanCosts(const std::vector<MergedPart>& parts) {
  struct Sums {
    std::string title;
    double triangles = 0, ms = 0;
    size_t parts = 0;
  };
  std::map<std::string, Sums> sums;
  std::vector<std::string> order;
  for (const MergedPart& part : parts) {
    const EqualError equal = equalError(part.rows);
    double few = 1e300, quick = 1e300;
    for (const EqualErrorCost& c : equal.costs) few = std::min(few, c.triangles), quick = std::min(quick, c.ms);
    for (const EqualErrorCost& c : equal.costs) {
      if (!sums.count(c.strategy)) order.push_back(c.strategy);
      Sums& s = sums[c.strategy];
      s.title = c.title;
      s.triangles += std::log(c.triangles / few);
      s.ms += std::log(c.ms / quick);
      ++s.parts;
    }
  }
  std::vector<MeanCost> out;
  const auto count = static_cast<double>(parts.size());
  for (const std::string& name : order)
    if (const Sums& s = sums[name]; s.parts == parts.size())
      out.push_back({s.title, std::exp(s.triangles / count), std::exp(s.ms / count)});
  std::stable_sort(out.begin(), out.end(), [](auto& a, auto& b) { return a.triangles < b.triangles; });
  return out;
}

}  // namespace

Result<MergedPart> parseComparison(const std::string& text, const std::string& path) {
  auto parsed = parseJson(text, path);
  if (!parsed) return parsed.error();
  auto wrong = [&](const std::string& what) {
    return Error{ErrorKind::kInvalidData, path, what, "give the report.json that relievo compare -o DIR wrote", {}};
  };
  const MergedJson *runs = memberAt(*parsed, "runs"), *all_timings = memberAt(*parsed, "timings"),
                   *artwork = memberAt(*parsed, "artwork"), *view = memberAt(*parsed, "view");
  const MergedJson* timings = all_timings ? memberAt(*all_timings, "runs") : nullptr;
  if (!runs || !runs->is_array() || !timings || !timings->is_array() || !artwork)
    return wrong("it is no report of relievo compare: it lacks runs, timings or artwork");
  if (runs->size() > kMostRows) return wrong("it has more than 10000 runs");
  MergedPart part;
  part.file = path;
  part.artwork = textAt(*artwork, "file");
  part.renderer = textAt(*parsed, "renderer");
  if (const MergedJson* origin = memberAt(*parsed, "origin"))
    part.origin = {textAt(*origin, "command"), textAt(*origin, "date"), textAt(*origin, "cpu"),
                   textAt(*origin, "package_xxh3_64"), textAt(*origin, "source")};
  NumberReader numbers;
  if (view)
    appendf(part.view, "%s, %.0f frames of %.0f x %.0f px", textAt(*view, "path").c_str(), numbers.at(view, "frames"),
            numbers.at(view, "width_px"), numbers.at(view, "height_px"));
  for (const MergedJson& run : *runs) {
    part.rows.push_back(rowFrom(run, *timings, numbers));
    if (!numbers.missing.empty())
      return wrong("run " + std::to_string(part.rows.size() - 1) + " lacks " + numbers.missing +
                   ", or it is out of range");
  }
  return part;
}

Result<MergedPart> readComparison(const std::string& path) {
  auto text = readTextFile(path, kMostReportBytes);
  if (!text) return text.error();
  return parseComparison(*text, path);
}

std::string mergedConclusion(const std::vector<MergedPart>& parts) {
  const std::vector<MeanCost> means = meanCosts(parts);
  std::string out;
  if (means.size() < 2) return "No two strategies reach an equal error in all of these comparisons.";
  appendf(out,
          "Over %zu comparisons at equal error, on the geometric mean: %s draws the fewest triangles, %.2f times the "
          "fewest of each; %s draws %.2f times",
          parts.size(), means[0].title.c_str(), means[0].triangles, means[1].title.c_str(), means[1].triangles);
  if (means.size() > 2) appendf(out, ", %s %.2f times", means.back().title.c_str(), means.back().triangles);
  out += " the fewest. ";
  const auto quick = std::min_element(means.begin(), means.end(), [](auto& a, auto& b) { return a.ms < b.ms; });
  appendf(out, "%s takes the least time, %.2f times the least of each.", quick->title.c_str(), quick->ms);
  return out;
}

std::string mergedHtml(const std::vector<MergedPart>& parts, const std::string& command, const std::string& date) {
  std::string out =
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
      "content='width=device-width'>\n<title>relievo compare --merge</title>\n<style>" +
      std::string(kReportStyle) +
      "</style></head><body>\n<h1>LOD strategies over several artworks or machines</h1>\n<dl>";
  auto term = [&](const char* what, const std::string& text) {
    if (!text.empty()) out += "<dt>" + std::string(what) + "</dt><dd>" + escapedHtml(text) + "</dd>\n";
  };
  term("Command", command);
  term("Date", date);
  out += "</dl>\n<h2>At equal error</h2>\n<p>" + escapedHtml(mergedConclusion(parts)) + "</p>\n";
  out +=
      "<div class='scroll'><table><thead><tr><th>strategy</th><th>triangles, times<br>the fewest</th><th>time, "
      "times<br>the least</th></tr></thead><tbody>\n";
  for (const MeanCost& m : meanCosts(parts))
    appendf(out, "<tr><td>%s</td><td>%.2f</td><td>%.2f</td></tr>\n", escapedHtml(m.title).c_str(), m.triangles, m.ms);
  out +=
      "</tbody></table></div>\n<p><small>Geometric means; strategies that every comparison has at its equal error. "
      "Times are compared within a comparison, never between machines.</small></p>\n";
  for (const MergedPart& part : parts) {
    out += "<h2>" + escapedHtml(titleOf(part)) + "</h2>\n<dl>";
    term("Report", part.file);
    term("Measured", part.origin.date);
    term("Processor", part.origin.cpu);
    term("Package", part.origin.package_hash.empty() ? "" : part.artwork + ", xxh3-64 " + part.origin.package_hash);
    term("Source", part.origin.source);
    term("View", part.view);
    const EqualError equal = equalError(part.rows);
    out += "</dl>\n<p>" + escapedHtml(conclusionText(equal)) + "</p>\n" + compareLegend(part.rows) +
           "<div class='panels'>\n";
    for (const ComparePlot& p : costPlots(part.rows)) out += plotSvg(p.plot);
    out += "</div>\n" + errorTableHtml(part.rows) + costTableHtml(part.rows);
  }
  return out + "</body></html>\n";
}

std::string mergedCsv(const std::vector<MergedPart>& parts) {
  std::string out;
  for (const MergedPart& part : parts) out += rowsCsv(part.rows, titleOf(part), out.empty());
  return out;
}

std::string mergedLatex(const std::vector<MergedPart>& parts) {
  std::string out;
  for (const MergedPart& part : parts) out += rowsLatex(part.rows, "LOD strategies over " + titleOf(part)) + "\n";
  return out;
}

}  // namespace relievo
