#include "texturing/stream/detail_bias.h"

#include <algorithm>
#include <cmath>

namespace relievo {

namespace {

constexpr int kWindow = 2;        // lists that are judged together
constexpr int kNoisyWindows = 4;  // with some overflow in each, in a row: as bad as an overflow in all lists
constexpr int kStride = 4;
constexpr double kPlateau = 0.98;
constexpr int kCloseEnough = 5;     // steps between a bias that fits and a finer one that does not
constexpr double kMargin = 0.95;    // of the room that a finer view may be expected to need
constexpr double kOtherView = 0.1;  // more or less demand at the same bias
constexpr int kSettlingWindows =
    4;  // after a move, in which relief and what is remembered of older requests still follow it
constexpr int kListsOfOldView =
    12;  // after the view moved: requests follow it late, and some of what was wanted before is remembered
// One level finer has at most four nodes for each, and their parents.
constexpr double kMostAtOnce = 5;
constexpr int kLevel = 20;  // steps
static_assert(kLevel * kBiasStep == 1);
// A slope is learned from judgements this far apart, and is that of a surface seen edge on (2) to flat on (4).
constexpr double kLeastSlope = 0.6931471805599453, kMostSlope = 1.3862943611198906;

}  // namespace

void DetailBias::observe(const DetailDemand& demand, std::optional<double> made_at) {
  if (demand.moved) lists_of_view_ = 0;
  else if (lists_of_view_ < kListsOfOldView) ++lists_of_view_;
  learned_elsewhere_ = (learned_elsewhere_ || demand.moved) && (steps_ > 0 || target_ > 0);
  if (steps_ != target_) {
    steps_ += std::clamp(target_ - steps_, -kBiasSlew, kBiasSlew);
    return;
  }
  if (made_at) {
    if (std::abs(*made_at - value()) > kBiasStep / 4) return;
    stale_lists_ = 0;
  } else if (stale_lists_ > 0 && !broken_.no_latency) {
    --stale_lists_;
    return;
  }
  if (steps_ > 0 && std::abs(demand.pages - reference_) > kOtherView * reference_) still_ = false;
  if (demand.overflow && steps_ < kMaxBiasSteps) still_ = false;
  ++lists_;
  overflows_ += demand.overflow;
  largest_ = std::max(largest_, demand.pages);
  if (lists_ >= kWindow) judge(std::max(1.0, demand.room));
}

void DetailBias::judge(double room) {
  double pages = std::max(1.0, largest_);
  bool some = overflows_ > 0, overflow = overflows_ == lists_;
  noisy_windows_ = some ? noisy_windows_ + 1 : 0;
  if (noisy_windows_ >= kNoisyWindows) overflow = true;
  lists_ = overflows_ = 0;
  largest_ = 0;

  if (learned_elsewhere_ && lists_of_view_ >= kListsOfOldView) {
    learned_elsewhere_ = false;
    low_ = -1;
    high_ = kMaxBiasSteps + 1;
    rise_ = 0;
  }
  bool contradiction = overflow ? steps_ >= high_ : !some && steps_ <= low_;
  bool another = ++windows_ > kSettlingWindows && std::abs(pages - reference_) > kOtherView * reference_;
  if (contradiction || another || kMostAtOnce * pages <= room) {
    low_ = -1;
    high_ = kMaxBiasSteps + 1;
    rise_ = 0;
  }
  reference_ = pages;
  if (judged_steps_ >= 0 && !another && std::abs(judged_steps_ - steps_) >= kLevel) {
    double levels = (steps_ - judged_steps_) * kBiasStep;
    slope_ = std::clamp(std::log(judged_pages_ / pages) / levels, kLeastSlope, kMostSlope);
  }

  auto stepsFor = [&](double ratio) { return std::log(ratio) / slope_ / kBiasStep; };
  int to = steps_;
  if (overflow) {
    low_ = steps_;
    // A rise that changed nothing is followed by a larger one: the demand falls by whole levels.
    int least = rise_ > 0 && pages > kPlateau * judged_pages_ ? std::min(kStride * rise_, kLevel) : 1;
    to = steps_ + std::max(least, static_cast<int>(std::ceil(stepsFor(pages / room) - 1e-9)));
    if (high_ <= kMaxBiasSteps) to = (low_ + high_ + 1) / 2;
    rise_ = to - steps_;
  } else if (!some) {
    high_ = std::min(high_, steps_);
    rise_ = 0;
    int finer = static_cast<int>(std::floor(stepsFor(kMargin * room / pages)));
    if (broken_.no_dead_band) {
      low_ = -1;
      finer = std::max(1, finer);
    }
    if (finer > 0) to = std::max(0, steps_ - finer);
    bool plateau = steps_ < judged_steps_ && pages < judged_pages_ / kPlateau;
    if (finer > 0 && plateau && low_ >= 0) to = std::min(to, (low_ + steps_ + 1) / 2);
    if (to <= low_) to = steps_ - low_ <= kCloseEnough ? steps_ : (low_ + steps_ + 1) / 2;
  }
  judged_steps_ = steps_;
  judged_pages_ = pages;
  moveTo(std::clamp(to, 0, kMaxBiasSteps));
}

void DetailBias::moveTo(int steps) {
  still_ = steps == steps_;
  if (still_) return;
  target_ = steps;
  stale_lists_ = kLatencyLists;
  reference_ = 0;
  windows_ = 0;
  noisy_windows_ = 0;
}

}  // namespace relievo
