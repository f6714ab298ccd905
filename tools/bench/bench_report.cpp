#include "tools/bench/bench_report.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "tools/report/machine.h"

namespace relievo {
namespace {

// Text for one cell of a Markdown table. A bar would end the cell, and a renderer would take the others for markup.
std::string cell(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '\\' || c == '|' || c == '*' || c == '<' || c == '`' || c == '[') escaped += '\\';
    escaped += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
  return escaped;
}

std::string markdownRow(const std::vector<std::string>& cells) {
  std::string row = "|";
  for (const std::string& text : cells) row += text.empty() ? " |" : " " + cell(text) + " |";
  return row + "\n";
}

std::string sentence(const std::string& text) {
  std::string escaped = cell(text) + ".";
  escaped[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(escaped[0])));
  return escaped;
}

std::string goalText(const BenchRow& row) {
  return row.goal ? (row.at_most ? "at most " : "at least ") + figureText(*row.goal) : "";
}

std::string verdict(const BenchRow& row) { return !row.goal ? "" : meetsGoal(row) ? "ok" : "missed"; }

nlohmann::ordered_json jsonRow(const std::string& group, const BenchRow& row) {
  nlohmann::ordered_json j = {{"group", group}, {"what", row.what}, {"measured", row.measured}, {"unit", row.unit}};
  if (row.goal) {
    j["goal"] = *row.goal;
    j["goal_is"] = row.at_most ? "at most" : "at least";
    j["met"] = meetsGoal(row);
  }
  if (row.baseline) {
    j["baseline"] = *row.baseline;
    j["baseline_name"] = row.baseline_name;
  }
  if (!row.note.empty()) j["note"] = row.note;
  return j;
}

}  // namespace

std::string figureText(double value) {
  char text[40];
  const double size = std::abs(value);
  std::snprintf(text, sizeof text, size >= 1000 ? "%.0f" : size >= 10 ? "%.1f" : size >= 0.1 ? "%.2f" : "%.4f", value);
  return text;
}

bool meetsGoal(const BenchRow& row) { return row.at_most ? row.measured <= *row.goal : row.measured >= *row.goal; }

std::string benchLine(const BenchRow& row) {
  const std::string goal = row.goal ? (row.at_most ? "<= " : ">= ") + figureText(*row.goal) : "";
  const std::string reached = !row.goal ? "" : meetsGoal(row) ? "ok" : "MISS";
  const std::string baseline = row.baseline ? figureText(*row.baseline) + " " + row.baseline_name : "";
  auto padded = [](std::string text, size_t width) {
    text.resize(std::max(width, text.size()), ' ');
    return text;
  };
  std::string measured = figureText(row.measured);
  measured.insert(0, measured.size() < 10 ? 10 - measured.size() : 0, ' ');
  return "  " + padded(row.what, 58) + " " + measured + " " + padded(row.unit, 9) + " " + padded(goal, 10) + " " +
         padded(reached, 4) + "  " + baseline + (row.note.empty() || baseline.empty() ? "" : "; ") + row.note + "\n";
}

std::string benchJson(const BenchRun& run) {
  nlohmann::ordered_json json = {{"renderer", run.renderer}, {"tool_version", run.version}, {"quick", run.quick}};
  auto rows = nlohmann::ordered_json::array();
  for (const BenchGroupRows& group : run.groups)
    for (const BenchRow& row : group.rows) rows.push_back(jsonRow(group.name, row));
  json["rows"] = std::move(rows);
  return json.dump(2) + "\n";
}

std::string benchMarkdown(const BenchRun& run) {
  std::string page =
      "# Figures of one run of `relievo bench`\n\n"
      "Written by `relievo bench --markdown`. Times are medians. A verdict compares the value with the goal. A "
      "baseline "
      "was measured in the same run.\n\n";
  page += markdownRow({"machine", ""}) + "|---|---|\n";
  page += markdownRow({"processor", run.processor}) + markdownRow({"cores", std::to_string(run.cores)}) +
          markdownRow({"GL renderer", run.renderer}) +
          markdownRow({"load average before the run", run.load < 0 ? "unknown" : figureText(run.load)}) +
          markdownRow({"artwork", run.artwork}) + markdownRow({"repetitions", run.quick ? "fewer (--quick)" : "all"}) +
          markdownRow({"version", run.version}) + markdownRow({"date", utcText(run.started)});
  for (const BenchGroupRows& group : run.groups) {
    page += "\n## " + group.name + "\n\n" + sentence(group.purpose) + "\n\n";
    if (group.rows.empty()) {
      page += "This artwork gives the group nothing to measure.\n";
      continue;
    }
    page += markdownRow({"figure", "value", "unit", "goal", "verdict", "baseline", "what the baseline is", "notes"}) +
            "|---|---|---|---|---|---|---|---|\n";
    for (const BenchRow& row : group.rows)
      page +=
          markdownRow({row.what, figureText(row.measured), row.unit, goalText(row), verdict(row),
                       row.baseline ? figureText(*row.baseline) : "", row.baseline ? row.baseline_name : "", row.note});
  }
  return page;
}

}  // namespace relievo
