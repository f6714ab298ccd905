#include "tools/compare/compare_tables.h"

#include <algorithm>

#include "tools/report/svg_plot.h"

namespace relievo {
namespace {

std::string openTable(std::initializer_list<const char*> heads) {
  std::string out = "<div class='scroll'><table><thead><tr>";
  for (const char* head : heads) out += "<th>" + std::string(head) + "</th>";
  return out + "</tr></thead><tbody>\n";
}
std::string firstCells(const CompareRow& r, int others) {
  std::string out;
  appendf(out, "<tr><td>%s</td><td>%g</td>", escapedHtml(r.title).c_str(), r.budget_px);
  if (!r.available) {
    appendf(out, "<td colspan='%d' class='left'>", others);
    out += "not available here: " + escapedHtml(r.why_not) + "</td></tr>\n";
  }
  return out;
}
void count(std::string& out, uint64_t v, bool bad) {
  appendf(out, "<td%s>%llu</td>", bad ? " class='bad'" : "", static_cast<unsigned long long>(v));
}
void time(std::string& out, const Timing& t) {
  appendf(out, "<td>%.2f<small> %.2f to %.2f</small></td>", t.median, t.low, t.high);
}
double mib(uint64_t bytes) { return static_cast<double>(bytes) / 1048576.0; }

std::string latexText(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') out += "\\textbackslash{}";
    else if (c == '~' || c == '^') out += std::string("\\") + c + "{}";
    else {
      if (std::string("&%$#_{}").find(c) != std::string::npos) out += '\\';
      out += c;
    }
  }
  return out;
}
std::string csvText(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? "\"\"" : std::string(1, c);
  return out + "\"";
}

}  // namespace

std::string errorTableHtml(const std::vector<CompareRow>& rows) {
  std::string out =
      openTable({"strategy", "budget<br>px", "predicted<br>px", "largest<br>px", "99 %<br>px", "RMS<br>px", "pop<br>px",
                 "crack<br>pixels", "bits that<br>differ", "silhouette<br>pixels"});
  for (const CompareRow& r : rows) {
    out += firstCells(r, 8);
    if (!r.available) continue;
    if (r.predicted_px >= 0)
      appendf(out, "<td%s>%.3g</td>", r.frames_above_bound ? " class='bad'" : "", r.predicted_px);
    else out += "<td>none</td>";
    appendf(out, "<td>%.3g</td><td>%.3g</td><td>%.3g</td><td>%.3g</td>", r.max_px, r.p99_px, r.rms_px, r.pop_px);
    count(out, r.crack_pixels, r.crack_pixels > 0);
    if (r.seams_known) count(out, r.seam_mismatches, r.seam_mismatches > 0);
    else out += "<td>not known</td>";
    count(out, r.silhouette_pixels, false);
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string costTableHtml(const std::vector<CompareRow>& rows) {
  std::string out = openTable({"strategy", "budget<br>px", "triangles<br>median", "draw<br>calls", "select<br>ms",
                               "frame<br>ms", "resident<br>MiB", "streamed<br>MiB", "cold<br>MiB"});
  for (const CompareRow& r : rows) {
    out += firstCells(r, 7);
    if (!r.available) continue;
    appendf(out, "<td>%.0f</td><td>%u</td>", r.triangles, r.draw_calls);
    time(out, r.select_ms);
    time(out, r.frame_ms);
    appendf(out, "<td>%.2f</td><td>%.2f</td>", mib(r.resident_bytes), mib(r.streamed_bytes));
    if (r.cold.known()) appendf(out, "<td>%.3f</td></tr>\n", r.cold.bytes / 1048576);
    else out += "<td>not known</td></tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string equalErrorTableHtml(const EqualError& equal) {
  std::string out = openTable({"strategy", "triangles", "times the<br>fewest", "select and frame<br>ms", "cold,<br>KiB",
                               "cold at<br>5 MB/s, ms", "cold at<br>20 MB/s, ms", "cold at<br>100 MB/s, ms"});
  std::vector<EqualErrorCost> costs = equal.costs;
  std::stable_sort(costs.begin(), costs.end(), [](auto& a, auto& b) { return a.triangles < b.triangles; });
  for (const EqualErrorCost& c : costs) {
    appendf(out, "<tr><td>%s</td><td>%.0f</td><td>%.2f</td><td>%.2f<small> %.2f to %.2f</small></td>",
            escapedHtml(c.title).c_str(), c.triangles, c.triangles / costs[0].triangles, c.ms, c.ms_low, c.ms_high);
    if (!c.cold.known()) {
      out += "<td colspan='4'>not known</td></tr>\n";
      continue;
    }
    appendf(out, "<td>%.1f</td>", c.cold.bytes / 1024);
    for (const int rate : kLinkRates) appendf(out, "<td>%.3g</td>", c.cold.ms(rate));
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string rowsCsv(const std::vector<CompareRow>& rows, const std::string& artwork, bool head) {
  std::string out;
  if (head) {
    out += artwork.empty() ? "" : "artwork,";
    out +=
        "strategy,error_px,predicted_px,max_px,p99_px,rms_px,pop_px,crack_px,seam_mismatches,triangles,draw_calls,"
        "select_ms,frame_ms,resident_bytes,streamed_bytes,cold_bytes,cold_decode_ms\n";
  }
  for (const CompareRow& r : rows) {
    if (!r.available) continue;
    if (!artwork.empty()) out += csvText(artwork) + ",";
    appendf(out, "%s,%g,", r.strategy.c_str(), r.budget_px);
    if (r.predicted_px >= 0) appendf(out, "%.6g", r.predicted_px);
    appendf(out, ",%.6g,%.6g,%.6g,%.6g,%llu,", r.max_px, r.p99_px, r.rms_px, r.pop_px,
            static_cast<unsigned long long>(r.crack_pixels));
    if (r.seams_known) appendf(out, "%llu", static_cast<unsigned long long>(r.seam_mismatches));
    appendf(out, ",%.0f,%u,%.6g,%.6g,%llu,%llu,", r.triangles, r.draw_calls, r.select_ms.median, r.frame_ms.median,
            static_cast<unsigned long long>(r.resident_bytes), static_cast<unsigned long long>(r.streamed_bytes));
    if (r.cold.known()) appendf(out, "%.6g,%.6g\n", r.cold.bytes, r.cold.decode_ms);
    else out += ",\n";
  }
  return out;
}

std::string rowsLatex(const std::vector<CompareRow>& rows, const std::string& caption) {
  std::string out =
      "% Needs \\usepackage{booktabs}.\n\\begin{table}\n\\centering\n\\caption{" + latexText(caption) +
      "}\n\\begin{tabular}{lrrrrrrr}\n\\toprule\nStrategy & Budget & Bound & Largest & 99\\,\\% & Triangles & Select & "
      "Frame \\\\\n & px & px & px & px & & ms & ms \\\\\n\\midrule\n";
  std::string last;
  for (const CompareRow& r : rows) {
    if (!r.available) continue;
    if (!last.empty() && last != r.strategy) out += "\\addlinespace\n";
    out += last == r.strategy ? "" : latexText(r.title);
    last = r.strategy;
    appendf(out, " & %g & ", r.budget_px);
    if (r.predicted_px >= 0) appendf(out, "%.3g", r.predicted_px);
    else out += "--";
    appendf(out, " & %.3g & %.3g & %.0f & %.2f & %.2f \\\\\n", r.max_px, r.p99_px, r.triangles, r.select_ms.median,
            r.frame_ms.median);
  }
  return out + "\\bottomrule\n\\end{tabular}\n\\end{table}\n";
}

}  // namespace relievo
