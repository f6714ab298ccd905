#include "tools/accuracy/accuracy_front.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace relievo {
namespace {

constexpr size_t kMostPredicted = 20000;  // combinations that the model looks at

bool finite(const CostAndGain& p) { return std::isfinite(p.ms) && std::isfinite(p.psnr_db); }

double squareError(double psnr_db) { return std::pow(10, -psnr_db / 10); }

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

std::vector<std::vector<size_t>> promisingCombinations(std::span<const MeasuredKnob> knobs, size_t most) {
  std::vector<std::vector<size_t>> all{{}};
  std::vector<double> errors{0}, factors{1};
  for (const MeasuredKnob& knob : knobs) {
    // With room for the other knobs' values: the fewer of one, the more knobs there are.
    std::vector<size_t> values = paretoFront(knob.values);
    const size_t room = std::max<size_t>(1, kMostPredicted / all.size());
    if (values.size() > room) values.resize(room);
    std::vector<std::vector<size_t>> next;
    std::vector<double> next_errors, next_factors;
    for (size_t c = 0; c < all.size(); ++c)
      for (size_t v : values) {
        next.push_back(all[c]);
        next.back().push_back(v);
        next_errors.push_back(errors[c] + squareError(knob.values[v].psnr_db) - squareError(knob.base.psnr_db));
        next_factors.push_back(factors[c] * knob.values[v].ms / std::max(knob.base.ms, 1e-9));
      }
    all = std::move(next), errors = std::move(next_errors), factors = std::move(next_factors);
  }
  // Below the base's own error none is predicted: its sources are not known one by one.
  const double base = knobs.empty() ? 0 : squareError(knobs[0].base.psnr_db);
  std::vector<CostAndGain> left;
  for (size_t c = 0; c < all.size(); ++c)
    left.push_back({factors[c], -10 * std::log10(std::max(base + errors[c], 0.25 * base + 1e-12))});
  std::vector<std::vector<size_t>> chosen;
  while (chosen.size() < most) {
    const auto front = paretoFront(left);
    if (front.empty()) break;
    // Where a layer is larger than what is left to choose, evenly along it.
    const size_t take = std::min(front.size(), most - chosen.size());
    for (size_t k = 0; k < take; ++k) {
      const size_t at = front[take == 1 ? 0 : k * (front.size() - 1) / (take - 1)];
      chosen.push_back(all[at]);
    }
    for (size_t i : front) left[i].psnr_db = std::nan("");
  }
  return chosen;
}

}  // namespace relievo
