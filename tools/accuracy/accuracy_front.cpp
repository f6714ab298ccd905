#include "tools/accuracy/accuracy_front.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace relievo {
namespace {

constexpr size_t kMostPredicted = 20000;  // combinations that the model looks at

bool finite(const CostAndGain& p) { return std::isfinite(p.ms) && std::isfinite(p.psnr_db); }

double squareError(double psnr_db) { return std::pow(10, -psnr_db / 10); }

// So many of a front, both ends and what lies at even steps of accuracy between them; all where there are no more.
std::vector<size_t> evenlyAlong(std::span<const CostAndGain> points, const std::vector<size_t>& front, size_t most) {
  if (front.size() <= most) return front;
  std::vector<size_t> out;
  const double low = points[front.front()].psnr_db, high = points[front.back()].psnr_db;
  size_t at = 0;
  for (size_t k = 0; k < most; ++k) {
    const double wanted =
        most == 1 ? high : low + (high - low) * static_cast<double>(k) / static_cast<double>(most - 1);
    // As many must be left as are still to be chosen.
    while (at + 1 < front.size() - (most - 1 - k) && points[front[at]].psnr_db < wanted) ++at;
    out.push_back(front[at++]);
  }
  return out;
}

}  // namespace

std::vector<size_t> paretoFront(std::span<const CostAndGain> points) {
  std::vector<size_t> order(points.size()), front;
  std::iota(order.begin(), order.end(), size_t{0});
  std::erase_if(order, [&](size_t i) { return !finite(points[i]); });
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return points[a].ms != points[b].ms ? points[a].ms < points[b].ms : points[a].psnr_db > points[b].psnr_db;
  });
  for (size_t i : order)
    if (front.empty() || points[i].psnr_db > points[front.back()].psnr_db) front.push_back(i);
  return front;
}

std::optional<size_t> cheapestWithin(std::span<const CostAndGain> points, double psnr_db) {
  for (size_t i : paretoFront(points))
    if (points[i].psnr_db >= psnr_db) return i;
  return {};
}

std::optional<size_t> mostAccurateWithin(std::span<const CostAndGain> points, double ms) {
  std::optional<size_t> best;
  for (size_t i : paretoFront(points))
    if (points[i].ms <= ms) best = i;
  return best;
}

std::vector<std::vector<size_t>> promisingCombinations(std::span<const MeasuredKnob> knobs, size_t most,
                                                       const std::function<bool(std::span<const size_t>)>& known) {
  struct Predicted {
    std::vector<size_t> values;
    double factor = 1, kept_error = 1, added_error = 0;  // of time; of the base's error; of its own
  };
  std::vector<Predicted> all(1);
  for (const MeasuredKnob& knob : knobs) {
    // The more combinations there are already, the fewer values of a knob have room.
    std::vector<size_t> values = paretoFront(knob.values);
    const size_t room = std::max<size_t>(1, kMostPredicted / all.size());
    if (values.size() > room) values.resize(room);
    std::vector<Predicted> next;
    for (const Predicted& from : all)
      for (size_t v : values) {
        Predicted& p = next.emplace_back(from);
        const double base = squareError(knob.base.psnr_db), error = squareError(knob.values[v].psnr_db);
        p.values.push_back(v);
        p.factor *= knob.values[v].ms / std::max(knob.base.ms, 1e-9);
        if (error < base) p.kept_error *= error / base;
        else p.added_error += error - base;
      }
    all = std::move(next);
  }
  if (known) std::erase_if(all, [&](const Predicted& p) { return known(p.values); });
  const double base = knobs.empty() ? 1 : squareError(knobs[0].base.psnr_db);
  std::vector<CostAndGain> left;
  for (const Predicted& p : all) left.push_back({p.factor, -10 * std::log10(base * p.kept_error + p.added_error)});
  std::vector<std::vector<size_t>> chosen;
  while (chosen.size() < most) {
    const auto front = paretoFront(left);
    if (front.empty()) break;
    for (size_t i : evenlyAlong(left, front, most - chosen.size())) chosen.push_back(all[i].values);
    for (size_t i : front) left[i].psnr_db = std::nan("");
  }
  return chosen;
}

}  // namespace relievo
