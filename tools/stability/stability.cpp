#include "tools/stability/stability.h"

#include <cstdio>

namespace relievo {
namespace {

std::string number(double v) {
  if (std::isinf(v)) return "no number";
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", v);
  return text;
}
std::string marginText(const StabilityRow& row) {
  if (row.errors.measured == 0) return "exact";
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", row.margin());
  return text;
}
std::string withUnit(double v, std::string_view unit) {
  return number(v) + (std::isinf(v) || unit.empty() ? "" : " " + std::string(unit));
}

std::string plainTable(std::span<const StabilityRow> rows) {
  size_t widest = 0;
  for (const StabilityRow& row : rows) widest = std::max(widest, row.hard_case->name.size());
  std::string out;
  char line[400];
  std::snprintf(line, sizeof line, "%-9s %-*s %-18s %-18s %8s  %-18s %s\n", "part", static_cast<int>(widest), "case",
                "bound", "measured", "margin", "naive method", "verdict");
  out += line;
  for (const StabilityRow& row : rows) {
    const StabilityCase& c = *row.hard_case;
    std::snprintf(line, sizeof line, "%-9s %-*s %-18s %-18s %8s  %-18s %s\n", std::string(row.part).c_str(),
                  static_cast<int>(widest), std::string(c.name).c_str(), withUnit(c.bound, c.unit).c_str(),
                  withUnit(row.errors.measured, c.unit).c_str(), marginText(row).c_str(),
                  withUnit(row.errors.naive, c.unit).c_str(),
                  !row.holds()       ? "FAILS"
                  : row.naiveFails() ? "holds"
                                     : "HOLDS, BUT SO DOES THE NAIVE METHOD");
    out += line;
  }
  return out;
}

std::string markdownTable(std::span<const StabilityRow> rows) {
  std::string out =
      "# Hard cases\n\n"
      "Written by `relievo selftest --stability --markdown FILE`; [README](README.md) says what is promised and "
      "why.\n\n"
      "| part | hard case | expected | bound | measured | margin | naive method | its error |\n"
      "|---|---|---|---|---|---|---|---|\n";
  for (const StabilityRow& row : rows) {
    const StabilityCase& c = *row.hard_case;
    out += "| " + std::string(row.part) + " | " + std::string(c.name) + " | " + std::string(c.expected) + " | " +
           withUnit(c.bound, c.unit) + " | " + withUnit(row.errors.measured, c.unit) + " | " + marginText(row) + " | " +
           std::string(c.naive) + " | " + withUnit(row.errors.naive, c.unit) + " |\n";
  }
  return out;
}

}  // namespace

std::vector<StabilityPart> stabilityParts() {
  return {{"textures", textureStability()}, {"geometry", geometryStability()}, {"light", lightStability()},
          {"sums", sumStability()},         {"colour", colourStability()},     {"time", timeStability()}};
}

std::vector<StabilityRow> runStability(std::span<const StabilityPart> parts) {
  std::vector<StabilityRow> rows;
  for (const StabilityPart& part : parts)
    for (const StabilityCase& c : part.cases) rows.push_back({part.name, &c, c.run()});
  return rows;
}

std::string stabilityTable(std::span<const StabilityRow> rows, bool markdown) {
  return markdown ? markdownTable(rows) : plainTable(rows);
}

}  // namespace relievo
