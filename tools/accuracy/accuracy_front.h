// accuracy_front.h - what follows from the figures of many settings: which of them no other beats, which combinations
// are worth running, and what to recommend. Pure.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <vector>

namespace relievo {

struct CostAndGain {
  double ms = 0;       // what it takes; less is better
  double psnr_db = 0;  // how accurate it is; more is better
};

// The points that no other one beats: none takes at most as long and is more accurate, or is as accurate and takes less
// long. By growing time, and so by growing accuracy; of equal points the first. What is not finite is left out.
std::vector<size_t> paretoFront(std::span<const CostAndGain> points);
// The cheapest that is at least so accurate; of equal times the more accurate. Nothing: none is.
std::optional<size_t> cheapestWithin(std::span<const CostAndGain> points, double psnr_db);
// The most accurate that takes at most so long; of equal accuracies the cheaper. Nothing: none does.
std::optional<size_t> mostAccurateWithin(std::span<const CostAndGain> points, double ms);

// The values of one knob, as they were measured with all others at the base.
struct MeasuredKnob {
  CostAndGain base;
  std::vector<CostAndGain> values;
};
// Which combinations of values (an index a knob) to run: those on the front that a model predicts, then on the front of
// what is left, and so on, `most` of them. The model multiplies times; of mean square errors it multiplies what makes
// the base's smaller and adds what makes it larger. It only chooses what is run: where a front has more
// than are wanted, at even steps of accuracy along it. Each knob gives the values on its own
// front. known: combinations that need not be run; may be empty.
std::vector<std::vector<size_t>> promisingCombinations(std::span<const MeasuredKnob> knobs, size_t most,
                                                       const std::function<bool(std::span<const size_t>)>& known);

}  // namespace relievo
