// accuracy_measure.h - one setting, measured along the path. Needs a current GL context.
#pragma once

#include "tools/accuracy/accuracy_run.h"
#include "tools/accuracy/reencoded_pages.h"

namespace relievo {

// Error of a picture (RGBA, rows top first, height rows) against the truth.
struct PictureError {
  double squares = 0;  // summed over pixels and channels
  double largest = 0;
  uint64_t pixels = 0, missing = 0;
  void add(const ViewTruth& truth, std::span<const uint8_t> rgba, int width_px, int height_px);
  double psnrDb() const;
};

// What is kept of a setting from round to round.
struct SettingSamples {
  std::vector<double> moving_ms, still_ms;  // a round: the mean of its views
  std::vector<double> cold_ms, triangles;
  PictureError settled, moving;
  AccuracyFigures figures;  // what needs no samples
  int rounds = 0;
};
AccuracyFigures figuresOf(const SettingSamples& samples);

class SettingMeasure {
 public:
  SettingMeasure(const AccuracyPlan& plan, const std::vector<CompareCamera>& path, const std::vector<ViewTruth>& truths,
                 AccuracyTruth& truth, gl::Api api)
      : plan_(plan), path_(path), truths_(truths), truth_(truth), api_(api) {}
  // Cold starts, and once along the path. The first round finds what is the same in each, too.
  Result<void> round(const AccuracySetting& setting, SettingSamples& samples);

 private:
  Result<std::unique_ptr<Engine>> coldStart(const AccuracySetting& setting, SettingSamples* samples);
  Result<void> passOverPath(Engine& engine, SettingSamples& samples, bool compared);
  // Returns what it took to show a position of the camera, ms.
  Result<double> arrive(Engine& engine, size_t view);
  double stillFrameMs(Engine& engine) const;
  Result<void> measureGeometry(Engine& engine, const ViewTruth& truth, AccuracyFigures& out);
  Result<void> prepare(const AccuracySetting& setting);
  Result<void> prepareRelief(const AccuracySetting& setting);

  const AccuracyPlan& plan_;
  const std::vector<CompareCamera>& path_;
  const std::vector<ViewTruth>& truths_;
  AccuracyTruth& truth_;
  gl::Api api_;
  Artwork artwork_;
  std::shared_ptr<ReencodedPages> rebuilt_;
  std::unique_ptr<StrategyPass> rebuilt_pass_;  // of relief of fewer bits
};

}  // namespace relievo
