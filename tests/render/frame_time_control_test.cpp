// The controller of a moving frame's time, on a simulated clock: frames take load x 2^(-saved x pressure) ms, shown a
// frame late, with noise.
#include "src/viewer/frame_time_control.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

namespace relievo {
namespace frame_time_control_test {

constexpr double kTargetMs = 33;

// What frames took, and the pressure after each.
struct Simulation {
  double saved = 0.8, noise = 0;
  FrameTimeControl control{kTargetMs};
  std::mt19937 random{3};
  double shown_pressure = 0;
  std::vector<double> ms, pressures;

  void run(double load_ms, int frames) {
    for (int k = 0; k < frames; ++k) {
      const double factor = 1 + noise * (2.0 * (random() % 1000) / 999.0 - 1);
      ms.push_back(load_ms * std::exp2(-saved * shown_pressure) * factor);
      shown_pressure = control.pressure();
      control.observe(ms.back(), true);
      pressures.push_back(control.pressure());
    }
  }
  // Changes of the pressure's direction among the last frames.
  int turns(size_t last) const {
    int count = 0;
    double before = 0;
    for (size_t k = pressures.size() - last; k < pressures.size(); ++k) {
      const double change = pressures[k] - pressures[k - 1];
      if (change == 0) continue;
      count += change * before < 0;
      before = change;
    }
    return count;
  }
};

TEST(FrameTimeControl, SettlesInTenFramesAfterStepsOfFour) {
  for (double saved : {0.5, 0.7, 0.9, 1.1}) {
    Simulation s{.saved = saved};
    double load = kTargetMs;
    for (double step : {4.0, 0.25, 4.0, 0.5, 2.0}) {
      load *= step;
      // What three units of pressure cannot save is not asked for.
      if (load * std::exp2(-saved * FrameTimeControl::kMostPressure) > kTargetMs) {
        load /= step;
        continue;
      }
      s.run(load, 10);
      s.run(load, 20);
      for (size_t k = s.ms.size() - 20; k < s.ms.size(); ++k) {
        EXPECT_LE(s.ms[k], 1.02 * kTargetMs) << saved << " after a step of " << step;
        if (s.pressures[k] > 0) {
          EXPECT_GE(s.ms[k], 0.65 * kTargetMs) << saved << " after a step of " << step;
        }
      }
      EXPECT_EQ(s.turns(20), 0) << "it oscillates";
    }
  }
}

TEST(FrameTimeControl, NoiseWithinTheBandChangesNothing) {
  Simulation s{.noise = 0.1};
  s.run(3 * kTargetMs, 30);
  const double settled = s.control.pressure();
  s.run(3 * kTargetMs, 200);
  EXPECT_NEAR(s.control.pressure(), settled, 0.3);
  EXPECT_LE(s.turns(200), 20);
}

TEST(FrameTimeControl, ALightLoadGivesUpNothing) {
  Simulation s;
  s.run(0.3 * kTargetMs, 50);
  EXPECT_EQ(s.control.pressure(), 0);
  EXPECT_STREQ(s.control.givenUp(), "");
  Scene exact;
  exact.sampling = Sampling::kAnisotropic;
  EXPECT_EQ(s.control.spend(exact).error_px, exact.error_px);
  EXPECT_EQ(s.control.spend(exact).sampling, Sampling::kAnisotropic);
  EXPECT_EQ(s.control.size(1280, 720), (std::array{1280, 720}));
  s.run(1.65 * kTargetMs, 20);  // control: a heavy one does, and gives it back
  EXPECT_STREQ(s.control.givenUp(), "geometry");
  EXPECT_GT(s.control.spend(exact).error_px, exact.error_px);
  EXPECT_EQ(s.control.spend(exact).sampling, Sampling::kBilinear);
  s.run(0.1 * kTargetMs, 20);
  EXPECT_EQ(s.control.pressure(), 0);
}

TEST(FrameTimeControl, WhatStandsStillIsNotJudged) {
  FrameTimeControl control(kTargetMs);
  for (int k = 0; k < 50; ++k) control.observe(20 * kTargetMs, false);
  EXPECT_EQ(control.pressure(), 0);
  control.observe(std::nan(""), true);
  control.observe(0, true);
  EXPECT_EQ(control.pressure(), 0);
  control.observe(20 * kTargetMs, true);
  EXPECT_GT(control.pressure(), 0) << "control";
  for (int k = 0; k < 50; ++k) control.observe(1e9, true);
  EXPECT_EQ(control.pressure(), FrameTimeControl::kMostPressure);
}

// Each at its pressure, and each only after the one before: no more geometry is given up while pixels are.
TEST(FrameTimeControl, GivesUpSamplingThenGeometryThenResolution) {
  Scene exact;
  exact.sampling = Sampling::kAnisotropic;
  exact.error_px = 1;
  struct Step {
    double load;
    const char* given_up;
    double least_error_px, most_error_px;  // of the window
    int least_width_px, most_width_px;
  };
  // Loads for which a simulated frame, which saves 2^-0.5 a unit of pressure, needs some 0.2, 1, 2.5 and all of it.
  for (const Step& step : {Step{0.765, "sampling", 1, 1, 1600, 1600}, Step{1.09, "geometry", 2, 4, 1600, 1600},
                           Step{1.82, "resolution", 4, 4, 900, 1300}, Step{50, "resolution", 16, 16, 800, 800}}) {
    FrameTimeControl control(kTargetMs);
    double shown = 0;
    for (int k = 0; k < 60; ++k) {
      const double ms = 1.12 * step.load * kTargetMs * std::exp2(-0.5 * shown);
      shown = control.pressure();
      control.observe(ms, true);
    }
    EXPECT_STREQ(control.givenUp(), step.given_up) << control.pressure();
    const auto [width, height] = control.size(1600, 900);
    EXPECT_GE(width, step.least_width_px) << control.pressure();
    EXPECT_LE(width, step.most_width_px) << control.pressure();
    EXPECT_NEAR(height * 16.0 / 9, width, 1);
    const Scene spent = control.spend(exact);
    EXPECT_EQ(spent.sampling, Sampling::kBilinear);
    const double of_window = spent.error_px * 1600 / width;
    EXPECT_GE(of_window, 0.999 * step.least_error_px) << control.pressure();
    EXPECT_LE(of_window, 1.001 * step.most_error_px) << control.pressure();
  }
  EXPECT_EQ(FrameTimeControl(kTargetMs).size(1, 1), (std::array{1, 1}));
}

// A controller without pause after a change goes to and fro on the same clock: what the tests above would see.
TEST(FrameTimeControl, WithoutAPauseItWouldOscillate) {
  double pressure = 0, shown = 0, before = 0;
  int turns = 0;
  for (int k = 0; k < 40; ++k) {
    const double ms = 4 * kTargetMs * std::exp2(-1.1 * shown);
    shown = pressure;
    const double change = FrameTimeControl::kGain * std::log2(ms / (FrameTimeControl::kAim * kTargetMs));
    turns += change * before < 0;
    before = change;
    pressure += change;
  }
  EXPECT_GT(turns, 5);
}

}  // namespace frame_time_control_test
}  // namespace relievo
