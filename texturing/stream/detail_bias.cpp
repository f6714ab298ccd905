#include "texturing/stream/detail_bias.h"

#include <algorithm>
#include <cmath>

namespace relievo {

namespace {

constexpr int kListsPerEvaluation = 2;  // lists of one evaluation
constexpr int kNoisyEvaluations = 4;    // so many evaluations in a row with a partial overflow count as an overflow
constexpr int kRiseFactor = 4;
constexpr double kPlateau = 0.98;
constexpr int kMaxGap = 5;           // steps between a bias that fits and a finer one that does not
constexpr double kMargin = 0.95;     // share of the room that a finer view may be expected to need
constexpr double kViewChange = 0.1;  // relative change of the demand at the same bias that means another view
// After a change of the bias, since relief and remembered requests still follow it.
constexpr int kSettlingEvaluations = 4;
// After a move of the view, since requests follow late and older ones are remembered.
constexpr int kListsAfterMove = 12;
// A level has at most four times the nodes of the next coarser one, plus their parents.
constexpr double kMaxGrowth = 5;
constexpr int kStepsPerLevel = 20;
static_assert(kStepsPerLevel * kBiasStep == 1);
// The slope is measured between evaluations at least a level apart. It lies between that of a surface seen edge on (log
// 2) and flat on (log 4).
constexpr double kMinSlope = 0.6931471805599453, kMaxSlope = 1.3862943611198906;

}  // namespace

void DetailBias::observe(const DetailDemand& demand, std::optional<double> request_bias) {
  if (demand.moved) lists_since_move_ = 0;
  else if (lists_since_move_ < kListsAfterMove) ++lists_since_move_;
  bounds_from_old_view_ = (bounds_from_old_view_ || demand.moved) && (steps_ > 0 || target_ > 0);
  if (steps_ != target_) {
    steps_ += std::clamp(target_ - steps_, -kBiasSlew, kBiasSlew);
    return;
  }
  if (request_bias) {
    if (std::abs(*request_bias - value()) > kBiasStep / 4) return;
    stale_lists_ = 0;
  } else if (stale_lists_ > 0 && !faults_.no_latency) {
    --stale_lists_;
    return;
  }
  if (steps_ > 0 && std::abs(demand.pages - reference_) > kViewChange * reference_) still_ = false;
  if (demand.overflow && steps_ < kMaxBiasSteps) still_ = false;
  ++lists_;
  overflows_ += demand.overflow;
  max_pages_ = std::max(max_pages_, demand.pages);
  if (lists_ >= kListsPerEvaluation) evaluate(std::max(1.0, demand.room));
}

void DetailBias::evaluate(double room) {
  double pages = std::max(1.0, max_pages_);
  bool any_overflow = overflows_ > 0, overflow = overflows_ == lists_;
  noisy_evaluations_ = any_overflow ? noisy_evaluations_ + 1 : 0;
  if (noisy_evaluations_ >= kNoisyEvaluations) overflow = true;
  lists_ = overflows_ = 0;
  max_pages_ = 0;

  if (bounds_from_old_view_ && lists_since_move_ >= kListsAfterMove) {
    bounds_from_old_view_ = false;
    coarsest_overflow_ = -1;
    finest_fit_ = kMaxBiasSteps + 1;
    last_rise_ = 0;
  }
  bool contradiction = overflow ? steps_ >= finest_fit_ : !any_overflow && steps_ <= coarsest_overflow_;
  bool view_changed = ++evaluations_ > kSettlingEvaluations && std::abs(pages - reference_) > kViewChange * reference_;
  if (contradiction || view_changed || kMaxGrowth * pages <= room) {
    coarsest_overflow_ = -1;
    finest_fit_ = kMaxBiasSteps + 1;
    last_rise_ = 0;
  }
  reference_ = pages;
  if (evaluated_steps_ >= 0 && !view_changed && std::abs(evaluated_steps_ - steps_) >= kStepsPerLevel) {
    double levels = (steps_ - evaluated_steps_) * kBiasStep;
    slope_ = std::clamp(std::log(evaluated_pages_ / pages) / levels, kMinSlope, kMaxSlope);
  }

  auto stepsFor = [&](double ratio) { return std::log(ratio) / slope_ / kBiasStep; };
  int to = steps_;
  if (overflow) {
    coarsest_overflow_ = steps_;
    // A rise without effect is followed by a larger one, since demand falls by whole levels.
    int min_rise =
        last_rise_ > 0 && pages > kPlateau * evaluated_pages_ ? std::min(kRiseFactor * last_rise_, kStepsPerLevel) : 1;
    to = steps_ + std::max(min_rise, static_cast<int>(std::ceil(stepsFor(pages / room) - 1e-9)));
    if (finest_fit_ <= kMaxBiasSteps) to = (coarsest_overflow_ + finest_fit_ + 1) / 2;
    last_rise_ = to - steps_;
  } else if (!any_overflow) {
    finest_fit_ = std::min(finest_fit_, steps_);
    last_rise_ = 0;
    int finer = static_cast<int>(std::floor(stepsFor(kMargin * room / pages)));
    if (faults_.no_dead_band) {
      coarsest_overflow_ = -1;
      finer = std::max(1, finer);
    }
    if (finer > 0) to = std::max(0, steps_ - finer);
    bool plateau = steps_ < evaluated_steps_ && pages < evaluated_pages_ / kPlateau;
    if (finer > 0 && plateau && coarsest_overflow_ >= 0) to = std::min(to, (coarsest_overflow_ + steps_ + 1) / 2);
    if (to <= coarsest_overflow_)
      to = steps_ - coarsest_overflow_ <= kMaxGap ? steps_ : (coarsest_overflow_ + steps_ + 1) / 2;
  }
  evaluated_steps_ = steps_;
  evaluated_pages_ = pages;
  moveTo(std::clamp(to, 0, kMaxBiasSteps));
}

void DetailBias::moveTo(int steps) {
  still_ = steps == steps_;
  if (still_) return;
  target_ = steps;
  stale_lists_ = kLatencyLists;
  reference_ = 0;
  evaluations_ = 0;
  noisy_evaluations_ = 0;
}

}  // namespace relievo
