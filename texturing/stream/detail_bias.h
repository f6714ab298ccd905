// detail_bias.h - how many levels coarser a view should request so that its requests fit the cache. Pure.
//
// Model: demand falls with the bias, by default by a factor of 4 for each level (a level is twice the size in each
// direction; ancestors add a third at every level, which cancels out). After one evaluated request list, the bias that
// fits is log4(demand / room) away: proportional control, at kBiasSlew steps for each list. Later evaluations correct
// the model where demand falls in whole levels or by less than 4. The bias is the root of a monotone function between
// the finest bias that fitted and the coarsest that overflowed, and is found by bisection. So the search ends after a
// bounded number of steps at a bias that fits and is within 0.3 levels of the finest. A bias that overflowed is not
// tried again until the demand at the same bias shows that the view has changed.
//
// If the caller says that the view moved, the bounds found on the way are forgotten once it stands still, since for a
// few lists the effect of a move cannot be told from that of the bias.
//
// A list is evaluated at the bias with which it was made. If the caller does not know that bias, lists count from the
// (kLatencyLists + 1)th after a change.
#pragma once

#include <cstdint>
#include <optional>

namespace relievo {

inline constexpr double kBiasStep = 0.05;  // in levels
inline constexpr int kMaxBiasSteps = 120;
inline constexpr double kMaxDetailBias = kMaxBiasSteps * kBiasStep;
inline constexpr int kBiasSlew = 4;      // largest number of steps for each list: a level takes five frames
inline constexpr int kLatencyLists = 4;  // largest number of lists between a bias and the requests that follow it

struct DetailDemand {
  double pages = 0;       // requested pages, without those that are never evicted
  double room = 0;        // slots for these pages
  bool overflow = false;  // some pages found no slot
  bool moved = false;     // the view has changed since the previous list
};

class DetailBias {
 public:
  // Faults for negative controls in tests.
  struct FaultInjection {
    bool no_dead_band = false;  // a fitting view is always tried one step finer, and overflows are forgotten
    bool no_latency = false;    // lists are evaluated as if made with the current bias
  };
  DetailBias() = default;
  explicit DetailBias(FaultInjection faults) : faults_(faults) {}

  // Call once for each frame with a new request list. request_bias: the bias with which the list was made; nothing:
  // unknown.
  void observe(const DetailDemand& demand, std::optional<double> request_bias);
  double value() const { return steps_ * kBiasStep; }  // 0..kMaxDetailBias
  // The last lists gave no reason to change the bias, and they are of the current view.
  bool isStill() const { return still_ && !bounds_from_old_view_; }

 private:
  void evaluate(double room);
  void moveTo(int steps);

  FaultInjection faults_;
  int steps_ = 0, target_ = 0;
  bool still_ = true;
  int stale_lists_ = 0;  // lists of the old bias that are still expected
  // The lists at this bias since the last evaluation.
  int lists_ = 0, overflows_ = 0;
  double max_pages_ = 0;
  int evaluations_ = 0, noisy_evaluations_ = 0;
  int last_rise_ = 0;  // steps of the last change, if it was a rise
  // The coarsest bias that overflowed and the finest that fitted, in this view.
  int coarsest_overflow_ = -1, finest_fit_ = kMaxBiasSteps + 1;
  bool bounds_from_old_view_ = false;  // some of these bounds precede the view's last move
  int lists_since_move_ = 0;           // lists since that move
  double reference_ = 0;               // the demand at the current bias
  int evaluated_steps_ = -1;
  double evaluated_pages_ = 0;
  double slope_ = 1.3862943611198906;  // of log(demand) for each level: log 4
};

}  // namespace relievo
