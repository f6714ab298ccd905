// step_choice.h - the largest steps (height_steps.h) that keep a fidelity's target. Steps move heights by a root mean
// square that is known without a measurement, and independent of what the heights missed before, so that squares add:
// steps are found by that, and one measurement at all places confirms them. Pure. Units: mm.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "geometry/bake/fidelity.h"
#include "src/base/result.h"

namespace relievo {

struct StepChoice {
  double step_mm = 0;  // 0: heights as they were baked
  bool measured = false;
  Fidelity fidelity;  // with these steps, where it was measured
};

// Which steps move heights by how much: the largest ones within a given move are found. Steps are whole heights, and
// coarser grids' are parts of them: moves change by leaps.
template <class Change>
class StepSolver {
 public:
  StepSolver(Change change, double most_step_mm) : change_(change), most_(most_step_mm) {}
  struct Found {
    double step_mm = 0, moved_mm = 0;
  };
  // The largest step below `below_mm` that moves heights by at most moved_mm, about, and set last; from a guess. The
  // step is 0 where none is as small. What is known from calls before is not set again.
  Result<Found> within(double moved_mm, double guess_mm, double below_mm) {
    constexpr int kTries = 4;
    constexpr double kClose = 0.97, kHardlyOver = 1.01, kBetween = 0.25;
    Found best, over{std::min(below_mm, most_ * kAbove), std::numeric_limits<double>::infinity()};
    auto take = [&](const Found& f) {
      if (f.moved_mm > kHardlyOver * moved_mm || f.step_mm >= below_mm) {
        if (f.step_mm < over.step_mm) over = f;
      } else if (f.step_mm > best.step_mm) {
        best = f;
      }
    };
    for (const Found& f : known_) take(f);
    auto close = [&] {
      return best.step_mm > 0 && (best.moved_mm >= kClose * moved_mm || best.step_mm * kAbove >= over.step_mm);
    };
    double step = std::min(guess_mm, most_);
    for (int i = 0; i < kTries && !close(); ++i) {
      // In proportion, but well between the two.
      const Found& from = best.step_mm > 0 ? best : over;
      if (from.moved_mm > 0 && std::isfinite(from.moved_mm))
        step = from.step_mm * (1 + kClose) / 2 * moved_mm / from.moved_mm;
      const double apart = over.step_mm - best.step_mm;
      if (i > 0 || best.step_mm > 0)
        step = std::clamp(step, best.step_mm + kBetween * apart, over.step_mm - kBetween * apart);
      step = std::min(step, most_);
      const Result<double> moved = set(step);
      if (!moved) return moved.error();
      take({step, *moved});
    }
    if (best.step_mm > 0 && set_ != best.step_mm)
      if (const Result<double> moved = set(best.step_mm); !moved) return moved.error();
    return best;
  }
  Result<double> set(double step_mm) {
    set_ = step_mm;
    Result<double> moved = change_(step_mm);
    if (moved) known_.push_back({step_mm, *moved});
    return moved;
  }

 private:
  static constexpr double kAbove = 1.03;  // steps that are hardly different
  Change change_;
  double most_, set_ = 0;
  std::vector<Found> known_;
};

// exact: of the heights as they were baked; exact_at_few: at few places, maybe the same. tries: measurements at all
// places, at most.
// change(step) sets steps, and answers by how much they moved the heights; measureFew() and measure() measure what is
// set, at few places and at all of them. What is set last need not be the choice. All may answer with an error, which
// is handed on.
template <class Change, class MeasureFew, class Measure>
Result<StepChoice> chooseStepFor(const Fidelity& exact, const Fidelity& exact_at_few, int tries, Change change,
                                 MeasureFew measureFew, Measure measure) {
  // Steps of s move heights by some s/6: less than s/sqrt(12), as most heights are what the coarser grid shows. kMargin
  // leaves room for another choice of samples; more than kNear of the target is near enough.
  constexpr double kNoise = 0.165, kSmaller = 0.9, kMargin = 0.95, kNear = 0.92, kLeast = 0.3, kFinest = 0.08,
                   kMost = 8, kWorthwhile = 1.05, kNextLeap = 0.985;
  auto rmsOf = [](const Fidelity& f) { return std::max(f.to_drawn.rms_mm, f.to_scan.rms_mm); };
  const double target = exact.target.rms_mm, rms = rmsOf(exact), most = std::max(1.1 * rms, kMargin * target);
  auto roomFor = [&](double with_steps) { return std::sqrt(std::max(0.0, with_steps * with_steps - rms * rms)); };
  // Where the target is missed, it is to be missed by hardly more.
  auto keeps = [&](const Fidelity& f) {
    constexpr double kHardly = 1.1;
    return exact.kept() ? f.kept() : f.excess() <= kHardly * exact.excess() && rmsOf(f) <= most;
  };
  auto added = [&](const Fidelity& to, const Fidelity& by) {
    return std::sqrt(std::max(0.0, rmsOf(by) * rmsOf(by) - rmsOf(to) * rmsOf(to)));
  };
  StepSolver<Change> solver(change, kMost * target);
  StepChoice chosen;
  double below = std::numeric_limits<double>::infinity();
  double per_move = 1;  // what is measured, for each mm that heights moved: less where the surface is steep
  double guess = roomFor(most) / kNoise;
  for (int i = 0; i <= tries; ++i) {
    // Where leaps leave much room, the next one may come closer to the target.
    const double room = roomFor(chosen.step_mm > 0 ? std::max(most, kNextLeap * target) : most);
    auto found = solver.within(room / per_move, guess, below);
    if (!found) return found.error();
    guess = found->step_mm;
    if (guess <= kLeast * target || (chosen.step_mm > 0 && guess < kWorthwhile * chosen.step_mm)) break;
    Result<Fidelity> now = i == 0 ? measureFew() : measure();
    if (!now) return now.error();
    if (const double by_steps = added(i == 0 ? exact_at_few : exact, *now); by_steps > 0)
      per_move = std::clamp(by_steps / found->moved_mm, 0.5, 2.0);
    if (i == 0) continue;
    if (!keeps(*now)) {
      below = kSmaller * guess;
      if (chosen.step_mm > 0) break;
      continue;
    }
    chosen = {guess, true, std::move(*now)};
    if (!exact.kept() || chosen.fidelity.excess() > kNear) break;
  }
  if (chosen.step_mm > 0) return chosen;
  // Unrounded heights take many times the bits. Where the target is missed anyway steps hardly change by how much;
  // where it is kept only just, finer ones may leave it so.
  const double step = (exact.kept() ? kFinest : kLeast) * target;
  if (const Result<double> set = solver.set(step); !set) return set.error();
  Result<Fidelity> now = measure();
  if (!now) return now.error();
  if (!exact.kept() || now->kept()) chosen = {step, true, std::move(*now)};
  return chosen;
}

}  // namespace relievo
