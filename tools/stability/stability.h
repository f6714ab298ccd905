// stability.h - hard cases, each with an answer that analysis gives: how far the program's own code is off, and how far
// the method is that one would write first. `relievo selftest --stability` prints the table. Deterministic; no GL.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace relievo {

// The largest errors over a case's inputs, in the case's unit. What is not a number is infinitely far off.
struct StabilityErrors {
  double measured = 0, naive = 0;

  void add(double measured_error, double naive_error) {
    measured = worse(measured, measured_error);
    naive = worse(naive, naive_error);
  }
  static double worse(double a, double b) {
    return std::isnan(b) ? std::numeric_limits<double>::infinity() : std::max(a, std::abs(b));
  }
};

struct StabilityCase {
  std::string_view name;      // what is hard: "the far corner of 2^24 texels a side"
  std::string_view expected;  // what analysis says, in words
  std::string_view naive;     // the method of the control
  std::string_view unit;
  double bound = 0;  // the largest error allowed; above 0
  StabilityErrors (*run)() = nullptr;
};

struct StabilityPart {
  std::string_view name;  // "textures"
  std::span<const StabilityCase> cases;
};
// One file a part: stability_NAME.cpp.
std::span<const StabilityCase> textureStability();
std::span<const StabilityCase> geometryStability();
std::span<const StabilityCase> lightStability();
std::span<const StabilityCase> sumStability();
std::span<const StabilityCase> colourStability();
std::span<const StabilityCase> timeStability();
std::vector<StabilityPart> stabilityParts();

struct StabilityRow {
  std::string_view part;
  const StabilityCase* hard_case = nullptr;
  StabilityErrors errors;

  // How many times the error fits into the bound; infinite where there is none.
  double margin() const { return hard_case->bound / errors.measured; }
  bool holds() const { return errors.measured <= hard_case->bound; }
  bool naiveFails() const { return errors.naive > hard_case->bound; }
};
// The rows of the parts, in their order.
std::vector<StabilityRow> runStability(std::span<const StabilityPart> parts);

// A table for terminals, or of a Markdown page.
std::string stabilityTable(std::span<const StabilityRow> rows, bool markdown);

}  // namespace relievo
