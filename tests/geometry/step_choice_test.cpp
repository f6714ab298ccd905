// Steps that a build's heights are rounded to: as large as the target allows, whatever a measurement finds, and
// confirmed at all places. What steps do is made up here, as formulas that the choice does not know.
#include "geometry/bake/step_choice.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

namespace relievo {
namespace step_choice_test {

constexpr double kTarget = 3e-5;  // RMS

Fidelity with(double rms, double p99_9_share = 0.3, double area_beyond = 0) {
  Fidelity f{.diagonal_mm = 1, .target = FidelityTarget::of(1), .to_drawn = {}, .to_scan = {}, .violations = {}};
  for (OneSidedFidelity* way : {&f.to_drawn, &f.to_scan})
    *way = {.samples = 50'000, .rms_mm = rms, .p99_9_mm = p99_9_share * f.target.p99_9_mm, .area_beyond = area_beyond};
  return f;
}

struct Scan {
  double missed = 0.5 * kTarget;  // without steps
  double per_move = 1;            // how much of a move is measured
  double few = 1;                 // what few places find of the RMS
  std::function<double(double)> moved = [](double step) { return step / 6; };
  std::function<Fidelity(double, double)> found = [](double, double rms) { return with(rms); };  // of a step, an RMS
};
struct Outcome {
  StepChoice choice;
  int measured = 0, few = 0;
  double last_set = -1;
};
Outcome outcomeOf(const Scan& scan, int tries = 4) {
  Outcome out;
  double move = 0;
  auto rms = [&] { return std::hypot(scan.missed, scan.per_move * move); };
  auto chosen = chooseStepFor(
      scan.found(0, scan.missed), with(scan.few * scan.missed), tries,
      [&](double step) -> Result<double> {
        out.last_set = step;
        return move = scan.moved(step);
      },
      [&]() -> Result<Fidelity> {
        ++out.few;
        return with(scan.few * rms());
      },
      [&]() -> Result<Fidelity> {
        ++out.measured;
        return scan.found(out.last_set, rms());
      });
  EXPECT_TRUE(chosen.ok());
  out.choice = std::move(*chosen);
  return out;
}

// The step that the target's RMS, less a margin of some percent, leaves room for: by the formulas.
double largest(const Scan& scan, double share) {
  double low = 0, high = 8 * kTarget;
  for (int i = 0; i < 60; ++i) {
    const double step = (low + high) / 2;
    (std::hypot(scan.missed, scan.per_move * scan.moved(step)) <= share * kTarget ? low : high) = step;
  }
  return low;
}

TEST(StepChoice, isNearlyTheLargestThatIsKept) {
  for (const double missed : {0.1, 0.4, 0.7, 0.85})
    for (const double per_move : {0.7, 1.0, 1.1})
      for (const bool leaps : {false, true}) {
        Scan scan{.missed = missed * kTarget, .per_move = per_move};
        if (leaps) scan.moved = [](double step) { return std::floor(step / kTarget * 3) / 3 * kTarget / 6; };
        const Outcome r = outcomeOf(scan);
        ASSERT_TRUE(r.choice.measured);
        EXPECT_TRUE(r.choice.fidelity.kept());
        EXPECT_EQ(r.choice.fidelity.to_scan.samples, 50'000u);
        EXPECT_EQ(r.choice.fidelity.to_scan.rms_mm, std::hypot(scan.missed, per_move * scan.moved(r.choice.step_mm)))
            << "what is told is what was measured with the step that is chosen";
        EXPECT_GE(r.choice.step_mm, (leaps ? 0.85 : 0.93) * largest(scan, 0.95)) << missed << " " << per_move;
        EXPECT_LE(r.choice.step_mm, largest(scan, 1));
        EXPECT_EQ(r.few, 1);
        EXPECT_LE(r.measured, leaps ? 3 : 1);
      }
}

// Few places that find too little make the first choice too large; all places refuse it, and a smaller one is taken.
TEST(StepChoice, fewPlacesDecideNothing) {
  Scan scan;
  scan.few = 0.8;
  const Outcome r = outcomeOf(scan);
  EXPECT_TRUE(r.choice.measured);
  EXPECT_TRUE(r.choice.fidelity.kept());
  EXPECT_GT(r.choice.step_mm, 0);
  EXPECT_GT(r.measured, 1) << "control: the first choice was refused";
}

// Another measure than the RMS is missed with any steps: none are chosen, and nobody says that they were measured.
TEST(StepChoice, noStepsWhereNoneAreKept) {
  Scan scan;
  scan.found = [](double step, double rms) { return with(rms, step > 0 ? 1.5 : 0.9); };
  const Outcome r = outcomeOf(scan, 3);
  EXPECT_EQ(r.choice.step_mm, 0);
  EXPECT_FALSE(r.choice.measured);
  EXPECT_EQ(r.measured, 4) << "the finest steps, too";
  scan.found = [](double, double rms) { return with(rms, 0.9); };  // control
  EXPECT_GT(outcomeOf(scan, 3).choice.step_mm, 0);
}

// The target is kept, and leaves hardly any room: fine steps take few bits, unrounded heights many.
TEST(StepChoice, fineStepsWhereThereIsHardlyRoom) {
  Scan scan{.missed = 0.995 * kTarget};
  const Outcome r = outcomeOf(scan);
  EXPECT_TRUE(r.choice.measured);
  EXPECT_TRUE(r.choice.fidelity.kept());
  EXPECT_NEAR(r.choice.step_mm, 0.08 * kTarget, 1e-12);
  EXPECT_EQ(r.last_set, r.choice.step_mm);
  scan.missed = 0.99999 * kTarget;
  EXPECT_EQ(outcomeOf(scan).choice.step_mm, 0) << "control: no room at all";
}

// Some is missed by large steps only: those below are chosen.
TEST(StepChoice, smallerStepsWhereLargeOnesMiss) {
  Scan scan;
  const double most = 0.8 * largest(scan, 0.95);
  scan.found = [&](double step, double rms) { return with(rms, 0.5, step > most ? 2e-4 : 0); };
  const Outcome r = outcomeOf(scan);
  EXPECT_TRUE(r.choice.measured);
  EXPECT_TRUE(r.choice.fidelity.kept());
  EXPECT_LE(r.choice.step_mm, most);
  EXPECT_GE(r.choice.step_mm, 0.75 * most);
}

// What misses the target anyway is rounded so that it misses it by hardly more.
TEST(StepChoice, aMissStaysOne) {
  Scan scan{.missed = 3 * kTarget};
  const Outcome r = outcomeOf(scan);
  EXPECT_TRUE(r.choice.measured);
  EXPECT_GT(r.choice.step_mm, 2 * kTarget);
  EXPECT_LE(r.choice.fidelity.to_scan.rms_mm, 1.1 * scan.missed);
  // Where even that is too much, by the least steps.
  scan.found = [&](double step, double rms) { return with(rms, step > 0 ? 50 : 5); };
  const Outcome least = outcomeOf(scan);
  EXPECT_NEAR(least.choice.step_mm, 0.3 * kTarget, 1e-12);
  EXPECT_EQ(least.last_set, least.choice.step_mm);
}

TEST(StepChoice, errorsAreHandedOn) {
  const Error stopped{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  for (int at = 0; at < 3; ++at) {
    int calls = 0;
    auto next = [&](auto value) -> Result<decltype(value)> {
      if (calls++ == at) return stopped;
      return value;
    };
    auto chosen = chooseStepFor(
        with(0.5 * kTarget), with(0.5 * kTarget), 4,
        [&](double step) { return at == 0 ? next(step / 6) : Result<double>(step / 6); },
        [&] { return at == 1 ? (calls = 1, next(with(0.9 * kTarget))) : Result<Fidelity>(with(0.9 * kTarget)); },
        [&] { return at == 2 ? (calls = 2, next(with(0.9 * kTarget))) : Result<Fidelity>(with(0.9 * kTarget)); });
    ASSERT_FALSE(chosen.ok()) << at;
    EXPECT_EQ(chosen.error().kind, ErrorKind::kInterrupted);
  }
}

}  // namespace step_choice_test
}  // namespace relievo
