#include "tools/compare/compare_rows.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "tools/report/svg_plot.h"

namespace relievo {
namespace {

constexpr double kLeastErrorPx = 1e-3;  // what is below counts as that: measuring is not finer

bool takesPart(const CompareRow& r) { return r.available && !r.control && r.triangles > 0; }

// Of a value that goes with an error, between two budgets; both logarithmic.
double between(double error_px, double e0, double e1, double v0, double v1) {
  const double t = e0 == e1 ? 0 : std::log(error_px / e0) / std::log(e1 / e0);
  return std::exp(std::log(std::max(v0, 1e-6)) * (1 - t) + std::log(std::max(v1, 1e-6)) * t);
}

}  // namespace

std::vector<CompareRow> compareRows(const CompareFigures& all) {
  std::vector<CompareRow> rows;
  for (const StrategyFigures& run : all.runs) {
    CompareRow r;
    r.strategy = run.strategy->name;
    r.title = run.strategy->title;
    r.purpose = run.strategy->purpose;
    r.control = run.strategy->control;
    r.available = run.available;
    r.why_not = run.why_not;
    r.budget_px = run.budget_px;
    if (run.available) {
      const RunSummary s = summaryOf(run, all);
      r.predicted_px = s.predicted_px;
      r.max_px = s.max_px;
      r.p99_px = s.p99_px;
      r.rms_px = s.rms_px;
      r.pop_px = s.pop_px;
      r.crack_pixels = s.crack_pixels;
      r.silhouette_pixels = s.silhouette_pixels;
      r.frames_above_bound = s.above_bound_frames;
      r.seams_known = s.seams_known;
      r.seam_mismatches = s.seams_mismatched;
      r.triangles = s.triangles;
      r.draw_calls = s.max_draw_calls;
      r.resident_bytes = s.max_resident_bytes;
      r.streamed_bytes = s.streamed_bytes;
      r.cold = s.cold;
      r.select_ms = s.select_ms;
      r.frame_ms = s.frame_ms;
    }
    rows.push_back(std::move(r));
  }
  return rows;
}

std::vector<bool> bestRows(const std::vector<CompareRow>& rows, RowFigure cost, RowFigure error) {
  std::vector<bool> best(rows.size(), false);
  for (size_t i = 0; i < rows.size(); ++i) {
    if (!takesPart(rows[i])) continue;
    best[i] = std::none_of(rows.begin(), rows.end(), [&](const CompareRow& other) {
      if (!takesPart(other)) return false;
      const double dc = cost(other) - cost(rows[i]), de = error(other) - error(rows[i]);
      return dc <= 0 && de <= 0 && (dc < 0 || de < 0);
    });
  }
  return best;
}

EqualError equalError(const std::vector<CompareRow>& rows, double error_px) {
  EqualError out;
  out.error_px = error_px;
  std::vector<std::string> order;
  std::map<std::string, std::vector<const CompareRow*>> by_name;
  for (const CompareRow& r : rows) {
    if (!takesPart(r)) continue;
    if (by_name[r.strategy].empty()) order.push_back(r.strategy);
    by_name[r.strategy].push_back(&r);
  }
  auto errorOf = [](const CompareRow* r) { return std::max(r->p99_px, kLeastErrorPx); };
  for (const std::string& name : order) {
    auto& of = by_name[name];
    std::stable_sort(of.begin(), of.end(), [&](auto* a, auto* b) { return errorOf(a) < errorOf(b); });
    const auto above = std::find_if(of.begin(), of.end(), [&](auto* r) { return errorOf(r) >= error_px; });
    if (above == of.end() || (above == of.begin() && errorOf(*above) > error_px)) {
      out.left_out.push_back(of[0]->title);
      continue;
    }
    const CompareRow &b = **above, &a = above == of.begin() ? b : **(above - 1);
    auto at = [&](auto value) { return between(error_px, errorOf(&a), errorOf(&b), value(a), value(b)); };
    out.costs.push_back({name,
                         b.title,
                         at([](const CompareRow& r) { return r.triangles; }),
                         at([](const CompareRow& r) { return r.totalMs(); }),
                         at([](const CompareRow& r) { return r.select_ms.low + r.frame_ms.low; }),
                         at([](const CompareRow& r) { return r.select_ms.high + r.frame_ms.high; }),
                         {at([](const CompareRow& r) { return r.cold.bytes; }),
                          at([](const CompareRow& r) { return r.cold.decode_ms; })}});
  }
  return out;
}

EqualError equalError(const std::vector<CompareRow>& rows) {
  EqualError best;
  for (const double px : {1.0, 0.5, 2.0, 0.25, 4.0, 0.125, 8.0, 0.0625}) {
    EqualError here = equalError(rows, px);
    if (best.error_px == 0 || here.costs.size() > best.costs.size()) best = std::move(here);
  }
  return best;
}

std::string conclusionText(const EqualError& equal) {
  std::string out;
  if (equal.costs.size() < 2) return "No error is reached by two strategies with these budgets: compare more of them.";
  auto ranked = [&](auto less) {
    std::vector<const EqualErrorCost*> order;
    for (const EqualErrorCost& c : equal.costs) order.push_back(&c);
    std::stable_sort(order.begin(), order.end(), [&](auto* a, auto* b) { return less(*a, *b); });
    return order;
  };
  const auto few = ranked([](auto&a, auto&b) { return a.triangles < b.triangles; }),
             quick = ranked([](auto&a, auto&b) { return a.ms < b.ms; });
  appendf(out, "For %g px at 99 %% of pixels: %s draws the fewest triangles, %.0f; %s draws %.2f times as many",
          equal.error_px, few[0]->title.c_str(), few[0]->triangles, few[1]->title.c_str(),
          few[1]->triangles / few[0]->triangles);
  if (few.size() > 2)
    appendf(out, ", %s %.2f times", few.back()->title.c_str(), few.back()->triangles / few[0]->triangles);
  out += ". ";
  appendf(out, "%s takes the least time to choose and draw, %.2f ms; %s takes %.2f times as long",
          quick[0]->title.c_str(), quick[0]->ms, quick[1]->title.c_str(), quick[1]->ms / quick[0]->ms);
  // Frames differ among one another; what every frame agrees on is a lead.
  if (quick[1]->ms_low > quick[0]->ms_high) out += ", in all frames. ";
  else appendf(out, ", which is within the frames' spread (%.2f to %.2f ms). ", quick[0]->ms_low, quick[0]->ms_high);
  constexpr int kRate = kLinkRates[1];
  const auto first = ranked([](auto& a, auto& b) { return a.cold.ms(kRate) < b.cold.ms(kRate); });
  if (first[0]->cold.known())
    appendf(
        out,
        "From an empty cache, over a link of %d MB/s, %s is there first, after %.3g ms; %s takes %.2f times as long. ",
        kRate, first[0]->title.c_str(), first[0]->cold.ms(kRate), first[1]->title.c_str(),
        first[1]->cold.ms(kRate) / first[0]->cold.ms(kRate));
  if (!equal.left_out.empty()) {
    out += "Not reached with these budgets by: ";
    for (size_t k = 0; k < equal.left_out.size(); ++k) out += (k ? "; " : "") + equal.left_out[k];
    out += ".";
  }
  return out;
}

}  // namespace relievo
