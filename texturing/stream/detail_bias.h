// detail_bias.h - how many levels coarser a view should ask so that its requests fit the cache. Pure: numbers in, a
// bias out.
//
// Demand is taken to fall with the bias, and as a rule by a factor of 4 a level (a level is twice the size in each
// direction; ancestors are a third more at every level and cancel out). From one judged request list the bias that fits
// is then log4(demand / room) away, where the bias moves at kBiasSlew a list: proportional control. What the model gets
// wrong (demand by whole levels, or by less than 4) the next judgements mend: the bias is the root of a monotone
// function, known to lie between the finest bias that did fit and the coarsest that did not, and is looked for by that
// bracket. So it ends after a bounded number of moves at a bias that fits and is within 0.3 levels of the finest, and
// there it stays: what did not fit is not tried again until the demand at the same bias says that the view is another
// one.
//
// The same where the caller says that the view has moved: once it stands still, what was learned of it on the way is
// forgotten, as a move within a few lists of a change of the bias cannot be told from what that change did.
//
// A list is judged by the bias that it was made with. Where the caller does not know that, lists count from the
// (kLatencyLists + 1)th after a change.
#pragma once

#include <cstdint>
#include <optional>

namespace relievo {

inline constexpr double kBiasStep = 0.05;  // levels
inline constexpr int kMaxBiasSteps = 120;
inline constexpr double kMaxDetailBias = kMaxBiasSteps * kBiasStep;
inline constexpr int kBiasSlew = 4;      // steps a list at most: a level takes five frames
inline constexpr int kLatencyLists = 4;  // between a bias and the requests that follow it, at most

struct DetailDemand {
  double pages = 0;       // that the view wants, without those that never leave
  double room = 0;        // slots for them
  bool overflow = false;  // some found no room
  bool moved = false;     // the view is another one than that of the list before
};

class DetailBias {
 public:
  // For negative controls in tests: each makes the controller worse in its own way.
  struct FaultInjection {
    bool no_dead_band = false;  // a view that fits exactly is tried one step finer, and what failed is forgotten
    bool no_latency = false;    // lists are judged as if made with the current bias
  };
  DetailBias() = default;
  explicit DetailBias(FaultInjection faults) : broken_(faults) {}

  // Once a frame with a new request list. made_at: the bias that the list was made with; nothing: not known.
  void observe(const DetailDemand& demand, std::optional<double> made_at);
  double value() const { return steps_ * kBiasStep; }  // 0..kMaxDetailBias
  // The last lists gave no reason to move, and are of the view as it is.
  bool isStill() const { return still_ && !learned_elsewhere_; }

 private:
  void judge(double room);
  void moveTo(int steps);

  FaultInjection broken_;
  int steps_ = 0, target_ = 0;
  bool still_ = true;
  int stale_lists_ = 0;  // still to come
  // The lists at this bias since the last judgement.
  int lists_ = 0, overflows_ = 0;
  double largest_ = 0;
  int windows_ = 0, noisy_windows_ = 0;
  int rise_ = 0;  // steps of the last move, if it was one
  // Of this view: the coarsest bias that overflowed, the finest that fitted, the demand last judged.
  int low_ = -1, high_ = kMaxBiasSteps + 1;
  bool learned_elsewhere_ = false;  // some of it before the view moved last
  int lists_of_view_ = 0;           // since then
  double reference_ = 0;            // at the current bias
  int judged_steps_ = -1;
  double judged_pages_ = 0;
  double slope_ = 1.3862943611198906;  // of log(demand), a level: log 4
};

}  // namespace relievo
