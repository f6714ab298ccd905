#include "tools/accuracy/accuracy_html.h"

#include <algorithm>
#include <cmath>

namespace relievo {
namespace {

double mib(uint64_t bytes) { return static_cast<double>(bytes) / 1048576.0; }

std::string spreadCell(const Spread& s, const char* format) {
  std::string out = "<td>";
  appendf(out, format, s.median);
  if (s.count > 1) {
    out += "<small> ";
    appendf(out, format, s.low);
    out += " to ";
    appendf(out, format, s.high);
    out += "</small>";
  }
  return out + "</td>";
}

std::string tableHead(bool built) {
  std::string out =
      "<div class='scroll'><table><thead><tr><th>setting</th><th>PSNR<br>dB</th><th>largest<br>of 255</th>"
      "<th>PSNR<br>moving, dB</th><th>geometry<br>px</th><th>99 %<br>px</th><th>geometry<br>mm</th>"
      "<th>bound<br>px</th><th>triangles</th><th>moving<br>ms</th><th>still<br>ms</th><th>cold start<br>ms</th>"
      "<th>read<br>MiB</th><th>resident<br>MiB</th>";
  if (built) out += "<th>build<br>CPU s</th>";
  return out + "</tr></thead><tbody>\n";
}

std::string tableRow(const AccuracyRow& row, const std::string& name, bool built) {
  const AccuracyFigures& f = row.figures;
  std::string out = "<tr><td>" + escapedHtml(name) + "</td>";
  if (!row.problem.empty())
    return out + "<td class='left' colspan='14'>not measured: " + escapedHtml(row.problem) + "</td></tr>\n";
  appendf(out, "<td>%.2f</td><td>%.0f</td><td>%.2f</td><td>%.3g</td><td>%.2g</td><td>%.3g</td><td>%.3g</td>", f.psnr_db,
          f.largest, f.moving_psnr_db, f.geometry_px, f.geometry_p99_px, f.geometry_mm, f.predicted_px);
  appendf(out, "<td>%.0f</td>", f.triangles);
  out += spreadCell(f.moving_ms, "%.2f") + spreadCell(f.still_ms, "%.2f") + spreadCell(f.cold_ms, "%.0f");
  appendf(out, "<td>%.2f</td><td>%.2f</td>", mib(f.bytes_read), mib(f.bytes_resident));
  if (built && f.build_s >= 0) appendf(out, "<td>%.2g</td>", f.build_s);
  else if (built) out += "<td>as it is</td>";
  return out + "</tr>\n";
}

std::string legendOf(const Plot& plot) {
  std::string out = "<p class='legend'>";
  for (size_t s = 0; s < plot.series.size(); ++s)
    out += "<span>" + plotKey(s) + " " + escapedHtml(plot.series[s].title) + "</span> ";
  return out + "</p>\n";
}

std::string heading(const AccuracyPlan& plan, const AccuracyResult& r, const AccuracyProvenance& made) {
  const std::string name = escapedHtml(made.package_name);
  std::string out =
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
      "content='width=device-width'>\n<title>relievo accuracy: " +
      name + "</title>\n<style>" + kReportStyle + "</style></head><body>\n<h1>What accuracy costs in time: " + name +
      "</h1>\n<dl>";
  auto term = [&](const char* what, const std::string& text) {
    out += "<dt>" + std::string(what) + "</dt><dd>" + escapedHtml(text) + "</dd>\n";
  };
  std::string path;
  appendf(path, "%zu views of %d x %d px, drawn with seed %u from %s", r.cameras.size(), plan.width_px, plan.height_px,
          plan.seed,
          plan.cameras.empty() ? "three flights: around, over at a slant, close" : "the scene's camera path");
  term("Command", made.command);
  term("Date", made.date);
  term("Processor", made.cpu);
  term("OpenGL", r.renderer + ", " + r.version);
  term("Package", made.package_name + ", xxh3-64 " + made.package_hash);
  term("Camera path", path);
  return out + "</dl>\n";
}

std::string truthParagraph(const AccuracyPlan& plan, const AccuracyResult& r) {
  std::string out = "<h2>The truth</h2>\n<p>";
  appendf(
      out,
      "Settings are compared with %llu pixels in double precision: the point of the finest relief that each pixel's "
      "centre shows, the mean of all texels in the pixel's footprint (up to 64 trilinear taps along it), and the "
      "light's formula, not rounded. ",
      static_cast<unsigned long long>(r.truth_pixels));
  if (plan.one_of > 1)
    appendf(out, "They are a sample: one pixel, drawn by lot, of every %d x %d. ", plan.one_of, plan.one_of);
  else out += "They are all pixels but those left out. ";
  appendf(out,
          "Of %llu pixels that show the artwork %llu on outlines and inner edges are left out, where a hair's breadth "
          "decides between far parts, and %llu on walls seen edge-on whose place could not be solved for. ",
          static_cast<unsigned long long>(r.covered_pixels), static_cast<unsigned long long>(r.edge_pixels),
          static_cast<unsigned long long>(r.unsolved_pixels));
  out += r.truth_whole ? "Every finest triangle takes part in deciding what is visible.</p>\n"
                       : "What is visible is decided by a uniform grid coarser than the finest triangles, since these "
                         "are too many.</p>\n";
  return out +
         "<p>Geometric errors are distances of all measured pixels from where the finest relief has the place "
         "that each shows. The best PSNR that bytes allow is 58.9 dB.</p>\n";
}

std::string uncertainty(const AccuracyPlan& plan, const AccuracyResult& r) {
  std::string out = "<h2>What measuring is uncertain by</h2>\n<p>";
  const AccuracyFigures& base = r.rows.front().figures;
  appendf(
      out,
      "All settings were measured in %zu rounds, so that what else the machine did in the meantime fell on all alike; "
      "combinations came after the knobs. A time is the median of the rounds, and of %zu cold starts; small figures "
      "beside it are the quartiles. In a round, moving is the mean over the views of the time for each position of the "
      "camera that was shown, still the mean of each view's median of %d frames. The base was measured %zu times in "
      "all, between the others: it took %.2f to %.2f ms moving, %.2f to %.2f ms still, %.0f to %.0f ms cold. Smaller "
      "differences mean nothing. Its PSNR differed by at most %.3f dB.",
      base.moving_ms.count, base.cold_ms.count, plan.still_frames, r.control_moving_ms.count, r.control_moving_ms.low,
      r.control_moving_ms.high, r.control_still_ms.low, r.control_still_ms.high, r.control_cold_ms.low,
      r.control_cold_ms.high, r.control_psnr_db);
  out += " Cold starts read files that the system may hold in memory.";
  return out + "</p>\n";
}

std::string adviceSection(const std::vector<AccuracyAdvice>& advice) {
  std::string out =
      "<h2>Recommended settings</h2>\n<p>Of the settings that were measured. A file is used as <code>relievo render "
      "FILE --settings settings-40-db.json</code>; view and compare take it, too.</p>\n<div "
      "class='scroll'><table><thead><tr><th>goal</th><th class='left'>file</th><th "
      "class='left'>setting</th></tr></thead><tbody>\n";
  for (const AccuracyAdvice& a : advice)
    out += "<tr><td>" + escapedHtml(a.goal) + "</td><td class='left'>" + (a.row ? escapedHtml(a.file) : "none") +
           "</td><td class='left'>" + escapedHtml(a.text) + "</td></tr>\n";
  return out + "</tbody></table></div>\n";
}

std::string frontSection(const AccuracyResult& r, const NamedPlot& plot) {
  std::string out = "<h2>The front</h2>\n" + legendOf(plot.plot) + plotSvg(plot.plot);
  out +=
      "<p>Up and to the left is better. Of the settings on the front no other one is as fast and more accurate. "
      "Combinations were chosen by a model (errors add, times multiply) and then measured like the others.</p>\n";
  out += tableHead(false);
  for (size_t i : accuracyFront(r)) out += tableRow(r.rows[i], settingText(r.rows[i].setting), false);
  return out + "</tbody></table></div>\n";
}

// Of a knob that a settled picture does not show: do moving pictures not show it either?
bool lateNothing(const AccuracyKnob& knob, const AccuracyResult& r) {
  if (knob.name != "feedback-scale" && knob.name != "feedback-interval" && knob.name != "prefetch") return false;
  constexpr double kSameDb = 0.01;
  return std::all_of(r.rows.begin(), r.rows.end(), [&](const AccuracyRow& row) {
    return row.knob != knob.name || !row.problem.empty() ||
           std::abs(row.figures.moving_psnr_db - row.figures.psnr_db) < kSameDb;
  });
}

std::string knobSection(const AccuracyKnob& knob, const AccuracyResult& r, const std::vector<NamedPlot>& plots) {
  std::string out = "<h3 class='knob'>" + escapedHtml(knob.title) + "</h3>\n<p>" + escapedHtml(knob.meaning) +
                    (knob.unit.empty() ? "" : "; " + escapedHtml(knob.unit)) + ".</p>\n";
  bool built = false;
  for (const AccuracyRow& row : r.rows) built = built || (row.knob == knob.name && row.setting.rebuilt());
  if (lateNothing(knob, r))
    out += "<p>No value of it made a moving picture worse here: on this path and storage no page came late.</p>\n";
  out += "<div class='panels'>\n";
  for (const NamedPlot& p : plots)
    if (p.name == knob.name || p.name.starts_with(knob.name + "-"))
      out += "<div>" + plotSvg(p.plot) + legendOf(p.plot) + "</div>";
  out += "</div>\n" + tableHead(built);
  for (const AccuracyRow& row : r.rows)
    if (row.knob == knob.name) out += tableRow(row, row.label, built);
  return out + "</tbody></table></div>\n";
}

std::string notMeasured(const AccuracyPlan& plan) {
  std::string out;
  for (const AccuracyKnob& k : plan.knobs)
    if (!k.why_not.empty()) out += "<dt>" + escapedHtml(k.title) + "</dt><dd>" + escapedHtml(k.why_not) + ".</dd>\n";
  return out.empty() ? out : "<h2>Not measured</h2>\n<dl>" + out + "</dl>\n";
}

}  // namespace

std::string accuracyHtml(const AccuracyPlan& plan, const AccuracyResult& r, const AccuracyProvenance& made,
                         const std::vector<AccuracyAdvice>& advice, const std::vector<NamedPlot>& plots) {
  std::string out = heading(plan, r, made) + adviceSection(advice) + frontSection(r, plots.front());
  out += "<h2>One knob at a time</h2>\n<p>The others stand at: " + escapedHtml(settingText(knobBase(plan.cache_mib))) +
         ". That is the default but for its sampling (trilinear), whose blur would hide what the others do.</p>\n" +
         tableHead(false);
  for (const AccuracyRow& row : r.rows)
    if (row.knob == "base") out += tableRow(row, row.label, false);
  out += "</tbody></table></div>\n";
  for (const AccuracyKnob& knob : plan.knobs)
    if (knob.why_not.empty()) out += knobSection(knob, r, plots);
  out += notMeasured(plan) + truthParagraph(plan, r) + uncertainty(plan, r);
  out += "<h2>Columns</h2>\n<dl>";
  for (const AccuracyColumn& c : accuracyColumns())
    out += "<dt>" + std::string(c.name) + (*c.unit ? ", " + std::string(c.unit) : "") + "</dt><dd>" +
           escapedHtml(c.meaning) + "</dd>\n";
  return out + "</dl>\n</body></html>\n";
}

}  // namespace relievo
