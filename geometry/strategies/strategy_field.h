// strategy_field.h - a flat artwork's finest relief held in full: the truth that strategies are measured against.
// The surface is that of lod.h: cells cut along (i, j) - (i + 1, j + 1), the last ones clamped to the artwork's
// border.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/lod/patch_vertex.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

struct ReliefField {
  FlatDomain domain;
  int spacing_log2 = 0;           // units between samples
  int64_t columns = 0, rows = 0;  // samples; the last ones lie on or beyond the border
  std::vector<uint16_t> samples;

  explicit ReliefField(const FlatDomain& d) : domain(d) {
    spacing_log2 = reliefSpacingLog2(d, static_cast<uint32_t>(std::max(0, d.relief_depth)));
    auto count = [&](uint64_t px) {
      return static_cast<int64_t>(FlatDomain::ceilShift(px << kUnitsPerTexelLog2, spacing_log2)) + 1;
    };
    columns = count(d.width_px);
    rows = count(d.height_px);
    samples.resize(static_cast<size_t>(columns * rows));
  }
  int64_t widthUnits() const { return static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2; }
  int64_t heightUnits() const { return static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2; }
  double mmPerUnit() const { return domain.mm_per_px / (1 << kUnitsPerTexelLog2); }
  uint16_t at(int64_t i, int64_t j) const { return samples[static_cast<size_t>(j * columns + i)]; }
  // What a finest page says of its square, as far as it lies within.
  template <class Samples>
  void setPage(const NodeId& page, const Samples& page_samples) {
    auto side = static_cast<int64_t>(uint64_t{kPagePx} << domain.relief_depth);
    int64_t i0 = (domain.alongX() ? page.patch * side : 0) + int64_t{page.x} * kPagePx,
            j0 = (domain.alongX() ? 0 : page.patch * side) + int64_t{page.y} * kPagePx;
    for (int64_t j = j0; j < std::min<int64_t>(j0 + kReliefSamples, rows); ++j)
      for (int64_t i = i0; i < std::min<int64_t>(i0 + kReliefSamples, columns); ++i)
        samples[static_cast<size_t>(j * columns + i)] =
            page_samples[static_cast<size_t>((j - j0) * kReliefSamples + (i - i0))];
  }
  // Height at a place in units, in steps of a sample's range.
  double heightSteps(double x, double y) const {
    int64_t s = int64_t{1} << spacing_log2;
    auto cell = [s](double place, int64_t cells) {
      return std::clamp<int64_t>(static_cast<int64_t>(place / static_cast<double>(s)), 0, cells - 1);
    };
    int64_t i = cell(x, columns - 1), j = cell(y, rows - 1);
    auto part = [&](double place, int64_t k, int64_t border) {
      double from = static_cast<double>(k * s), to = static_cast<double>(std::min((k + 1) * s, border));
      return std::clamp((place - from) / (to - from), 0.0, 1.0);
    };
    double u = part(x, i, widthUnits()), v = part(y, j, heightUnits());
    double z00 = at(i, j), z10 = at(i + 1, j), z01 = at(i, j + 1), z11 = at(i + 1, j + 1);
    return u >= v ? z00 + u * (z10 - z00) + v * (z11 - z10) : z00 + v * (z01 - z00) + u * (z11 - z01);
  }
  double heightMm(double x, double y) const {
    return domain.relief_offset_mm + domain.relief_scale_mm * heightSteps(x, y);
  }
  glm::dvec3 worldMm(double x, double y, double height_mm) const {
    return {(x - 0.5 * static_cast<double>(widthUnits())) * mmPerUnit(),
            (0.5 * static_cast<double>(heightUnits()) - y) * mmPerUnit(), height_mm};
  }
};

}  // namespace relievo
